"""Columns of the linear model: what each cause does to the probe, by forward kinematics."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from sklearn_raacmm.datasets import SimulatedArm
from sklearn_raacmm.error_model._columns import ARCSEC, Terms, columns_of
from sklearn_raacmm.error_model._sums import Rows, length_equations

from ._arms import ARMS, NONE, columns_by_name, displaced, draw_angles, turned


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_harmonic_columns_are_angle_errors(arm):
    theta = draw_angles(arm, 20)
    pairs = np.array([(j, k) for j in range(arm.n_joints) for k in (1, 2, 17)])
    columns = columns_of(arm, Terms(pairs, False, False, False)).at(theta)
    for i, (joint, order) in enumerate(pairs):
        for part, wave in enumerate((np.cos, np.sin)):
            error = np.zeros_like(theta)
            error[:, joint] = wave(order * theta[:, joint])
            assert_allclose(columns[:, :, 2 * i + part], displaced(arm, theta, error), atol=1e-7)


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_kinematic_columns_are_changes_of_the_table_and_of_the_base(arm):
    theta = draw_angles(arm, 20)
    columns = columns_by_name(arm, theta, False, True, False)
    for name, column in columns.items():
        if name.startswith(("base", "beta")):
            continue
        if name.startswith("probe"):
            field, index = "probe", "xyz".index(name[-1])
        else:
            field, index = name[:-1], int(name[-1]) - 1
        step = ARCSEC * (1 if field in ("alpha", "theta_offset") else arm.reach_mm)
        value = getattr(arm, field).copy()
        value[index] += step
        moved = arm.replace(**{field: value}).forward(theta) - arm.forward(theta)
        assert_allclose(column, moved, atol=1e-7)
    # Those that place the base, and turns about y.
    for axis, name in enumerate(("base_x", "base_y")):
        assert_allclose(columns[name], np.tile(ARCSEC * arm.reach_mm * np.eye(3)[axis], (20, 1)))
    one = np.full(20, ARCSEC)
    assert_allclose(columns["base_alpha"], turned(arm, theta, 0, 0, one), atol=1e-7)
    assert_allclose(columns["base_beta"], turned(arm, theta, 0, 1, one), atol=1e-7)
    for joint in range(arm.n_joints):
        # about y of the frame whose x alpha turns about
        frame = joint + (arm.convention == "standard")
        assert_allclose(columns[f"alpha{joint + 1}"], turned(arm, theta, frame, 0, one), atol=1e-7)
        assert_allclose(columns[f"beta{joint + 1}"], turned(arm, theta, frame, 1, one), atol=1e-7)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (2, -1, 0.5)])
@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_gravity_columns_follow_potential_energy(arm, up):
    """The torque of a load about an axis is what lifting it by a turn about that axis costs.

    A load before the frame stands for the slope of a cantilever's end: half of its turn.
    """
    arm = arm.replace(up=up)
    theta = draw_angles(arm, 20)
    columns = columns_by_name(arm, theta, True, False, False)
    frames = arm.frames(theta)
    small = 1e-6
    for name, column in columns.items():
        words = name.split()
        load = arm.n_joints + 1 if words[2] == "probe" else int(words[3])
        place = arm.forward(theta) if words[2] == "probe" else frames[:, load, :, 3]
        frame, axis = int(words[-3]), "xyz".index(words[-1])
        origin = frames[:, frame, :, 3]
        lifted = Rotation.from_rotvec(small * frames[:, frame, :, axis]).apply(place - origin)
        torque = -(lifted + origin - place) @ arm.up / small / arm.reach_mm
        share = 0.5 if load < frame else 1.0
        expected = turned(arm, theta, frame, axis, share * torque * ARCSEC)
        assert_allclose(column, expected, atol=2e-7, err_msg=name)
    # About three axes: every load beyond a frame, and one before it but for the first and last.
    n = arm.n_joints
    assert len(columns) == 3 * (n + 1) * (n + 2) // 2 + 3 * (n - 1)


@pytest.mark.parametrize("up", [(0, 0, 1), (1, 0, 0), (0.3, -0.5, 0.2)])
def test_gravity_columns_hold_twist_and_sag_of_the_textbooks_cantilever(up):
    """The simulation bends tubes by beam theory, about another arm's frames: nothing is left."""
    machine = SimulatedArm("gravity", random_state=0, up=up)
    theta = draw_angles(machine.true_arm, 60)
    terms = Terms(NONE, True, False, False)
    columns = columns_of(machine.true_arm, terms).at(theta).reshape(180, -1)
    moved = machine.deviations(theta, payload_n=5.0)
    for source in ("torsion", "sag", "payload"):
        moves = moved[source].ravel()
        left = moves - columns @ np.linalg.lstsq(columns, moves, rcond=1e-12)[0]
        assert np.abs(left).max() < 1e-9 + 1e-9 * np.abs(moves).max(), source


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_wobble_columns_tilt_the_joint_axis(arm):
    theta = draw_angles(arm, 20)
    for name, column in columns_by_name(arm, theta, False, False, True).items():
        joint, axis = int(name.split()[1]) - 1, "xy".index(name.split(",")[0][-1])
        wave = np.cos if "cos" in name else np.sin
        order = int(name.split("(")[1][0])
        frame = joint if arm.convention == "standard" else joint + 1
        expected = turned(arm, theta, frame, axis, ARCSEC * wave(order * theta[:, joint]))
        assert_allclose(column, expected, atol=1e-7)


def test_length_rows_are_changes_of_the_distance():
    """Against the distance of the corrected mean points."""
    arm = ARMS["modified"]
    rng = np.random.default_rng(0)
    theta, weights = draw_angles(arm, 60), rng.uniform(0.5, 2, 60)
    codes = np.repeat(np.arange(4), 15)
    terms = Terms(np.array([(0, 1), (3, 2)]), True, True, True)
    lengths = ((0, 2, 100.0, 1), (3, 1, 90.0, 2))
    rows = Rows(arm, theta, np.zeros((60, 3)), weights, codes, lengths)
    found = length_equations(rows, columns_of(arm, terms))
    w = rng.normal(size=found.rows.shape[1])

    def distances(points):
        mean = [np.average(points[codes == i], 0, weights[codes == i]) for i in range(4)]
        return np.array([np.linalg.norm(mean[0] - mean[2]), np.linalg.norm(mean[3] - mean[1])])

    points = arm.forward(theta)
    assert_allclose(found.values, distances(points) - [100, 90])
    assert_array_equal(found.variance, [1, 4])
    corrected = distances(points - columns_of(arm, terms).at(theta) @ (1e-3 * w))
    assert_allclose(1e-3 * found.rows @ w, distances(points) - corrected, atol=1e-7)
