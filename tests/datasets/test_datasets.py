"""The simulated arm against laws of physics and against independent models of the same thing."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from sklearn_raacmm import cartesian_to_cylindrical, metrics
from sklearn_raacmm.datasets import (
    ArmErrors,
    SimulatedArm,
    _simulation,
    make_gauge,
    make_single_point,
)

ARCSEC = np.pi / 648000
GRAVITY = {"sag_um": (128, 24), "joint_compliance_urad_per_nm": 33, "counterbalance": 0.85}
STRAIGHT_OUT = [[0.3, -np.pi / 2, 0, 0, 0, 0]]  # both tubes horizontal


@pytest.fixture
def poses():
    return np.random.default_rng(0).uniform(-3, 3, (50, 6))


def _moved(machine, angles):
    """Displacement of the probe by everything but the geometry, mm."""
    return machine.forward(angles) - machine.true_arm.forward(angles)


# -- the physics --------------------------------------------------------------------------------


def test_with_every_source_off_the_arm_is_its_drawing(poses):
    machine = SimulatedArm("none")
    assert machine.true_arm.replace(name="aacmm6") == machine.nominal_arm
    assert_array_equal(machine.forward(poses), machine.nominal_arm.forward(poses))


def test_torques_are_the_slopes_of_the_potential_energy(poses):
    machine = SimulatedArm("typical")
    tube_n, elbow_n, wrist_n = (
        _simulation._TUBE_WEIGHT_N_PER_M,
        _simulation._ELBOW_WEIGHT_N,
        _simulation._WRIST_WEIGHT_N,
    )

    def energy(q):  # N m
        z = machine.true_arm.frames(q)[..., 2, 3] / 1e3
        upper, forearm = tube_n * machine.nominal_arm.d[[2, 4]] / 1e3
        return (
            upper * (z[:, 2] + z[:, 3]) / 2
            + elbow_n * z[:, 3]
            + forearm * (z[:, 4] + z[:, 5]) / 2
            + wrist_n * z[:, 5]
        )

    step = 1e-5
    slopes = np.column_stack(
        [(energy(poses + e) - energy(poses - e)) / (2 * step) for e in step * np.eye(6)]
    )
    torques = _torques(machine, poses)
    assert_allclose(torques, -slopes, atol=1e-8)
    assert np.abs(torques).max() > 20


def _torques(machine, poses):
    """Torque of the arm's own weight about each joint, before any counterbalance, N m."""
    frames = machine.true_arm.frames(poses)
    return machine._torques(frames[:, :-1, :, 2], frames[..., 3])


def _cantilever(length, per_length, load, stiffness):
    """Sag in m and slope in rad of a horizontal cantilever: the textbook's sum."""
    sag = per_length * length**4 / 8 + load * length**3 / 3
    slope = per_length * length**3 / 6 + load * length**2 / 2
    return sag / stiffness, slope / stiffness


def test_tubes_sag_as_cantilevers_of_their_material():
    # Carbon tubes of 100 GPa, 75/71 and 60/56 mm: EI in N m2.
    stiffness = [1e11 * np.pi / 64 * (o**4 - i**4) for o, i in ((0.075, 0.071), (0.06, 0.056))]
    upper, _ = _cantilever(0.750742, 15.6, 9.8 + 15.6 * 0.500557 + 5.9, stiffness[0])
    fore, _ = _cantilever(0.500557, 15.6, 5.9, stiffness[1])
    assert ArmErrors().sag_um == pytest.approx((1e6 * upper, 1e6 * fore), rel=0.05)


def test_bending_and_torsion_against_finite_rotations(poses):
    """Exact rigid motions, part by part from wrist to base: the sum is their first order."""
    machine = SimulatedArm(ArmErrors.only(**GRAVITY))
    arm = machine.true_arm
    frames = arm.frames(poses)
    turns = 33e-6 * _torques(machine, poses) * [1, 0.15, 1, 1, 1, 1]
    assert_allclose(  # a turned joint is a joint at another angle
        machine.deviations(poses)["torsion"], arm.forward(poses + turns) - arm.forward(poses),
        atol=1e-4,
    )  # fmt: skip
    down = np.array([0, 0, -1.0])
    stiffness = 30580, 15340  # N m2, as published: what is compared are the directions and levers
    exact = arm.forward(poses)
    for k, (start, end, load) in reversed(list(enumerate([(2, 3, 23.5), (4, 5, 5.9)]))):
        tube = (frames[:, end, :, 3] - frames[:, start, :, 3]) / 1e3
        length = np.linalg.norm(tube, axis=1)[:, None]
        sag, slope = _cantilever(length, 15.6, load, stiffness[k])
        sag *= (128, 24)[k] / (1e6 * sag)
        slope *= (128, 24)[k] / (1e6 * _cantilever(length, 15.6, load, stiffness[k])[0])
        axis = np.cross(tube / length, down)  # as long as the cosine of the elevation
        across = down + tube[:, 2:] / length**2 * tube
        center = frames[:, end, :, 3]
        exact = center + Rotation.from_rotvec(slope * axis).apply(exact - center)
        exact += 1e3 * sag * across
    assert_allclose(machine.deviations(poses)["sag"], exact - arm.forward(poses), atol=5e-4)


def test_eccentricity_of_the_base_has_two_harmonics_of_the_right_size():
    machine = SimulatedArm(ArmErrors.only(eccentricity_arcsec=(4, 1.2)), random_state=3)
    n = 64
    angles = np.tile([0, -1.4, 0.3, 1.2, 0.4, -0.5], (n, 1))
    angles[:, 0] = 2 * np.pi * np.arange(n) / n
    points = machine.true_arm.forward(angles)
    moved = cartesian_to_cylindrical(_moved(machine, angles), machine.true_arm.azimuth(angles))
    spectrum = np.abs(np.fft.rfft(moved[:, 1])) / n * 2
    amplitude = spectrum / np.hypot(points[0, 0], points[0, 1]) / ARCSEC
    assert 0.5 * 4 <= amplitude[1] <= 1.5 * 4
    assert 0.5 * 1.2 <= amplitude[2] <= 1.5 * 1.2
    assert_allclose(amplitude[3:], 0, atol=1e-6)
    assert_allclose(moved[:, [0, 2]], moved[[0]][:, [0, 2]].repeat(n, 0), atol=1e-9)


def test_wobble_is_no_twist_error_in_disguise():
    """Twists, zeros and offsets of either side of joint 3 explain all but two turns per turn."""
    machine = SimulatedArm(ArmErrors.only(wobble_arcsec=3))
    n = 64
    angles = np.tile([0, -1.4, 0.3, 1.2, 0.4, -0.5], (n, 1))
    angles[:, 2] = 2 * np.pi * np.arange(n) / n
    frames, probe = machine.true_arm.frames(angles), machine.true_arm.forward(angles)
    levers = probe - frames[:, 2, :, 3]
    # Joints 1 and 2 move the housing, joints 4 to 6 the rest, by constant turns and shifts.
    constant = []
    for axis in np.moveaxis(frames[:, 2:4, :, :3], (1, 3), (0, 1)).reshape(6, n, 3):
        constant += [np.cross(axis, levers).ravel(), axis.ravel()]
    constant = np.stack(constant, axis=1)
    moved = machine.deviations(angles)["wobble"].ravel()
    left = moved - constant @ np.linalg.lstsq(constant, moved, rcond=None)[0]
    along_axis = levers[0] @ frames[0, 2, :, 2]
    assert along_axis > 500
    assert np.sqrt((left**2).sum() / n) == pytest.approx(3 * ARCSEC * along_axis, rel=1e-3)


def test_warming_of_a_stretched_arm_by_its_materials():
    machine = SimulatedArm(ArmErrors.only(warming_k=2))
    moved = _moved(machine, [[0, -np.pi / 2, 0, 0, 0, 0]])[0]
    carbon, aluminium = 750.74 + 500.56, 97.81
    assert moved[0] == pytest.approx(2 * (0.5e-6 * carbon + 23e-6 * aluminium), rel=0.01)
    assert moved[2] == pytest.approx(2 * 23e-6 * (376.5 + 62.1 + 62.1), rel=0.01)
    assert np.all(machine.forward(STRAIGHT_OUT, warming_k=0) ==
                  machine.true_arm.forward(STRAIGHT_OUT))  # fmt: skip


def test_small_errors_add_up_in_what_the_encoders_show():
    """Solved poses of the whole against the sum over sources, each solved by itself."""
    points = np.array([[500.0, 200, 150], [-300, 400, 300]])
    start = np.vstack([SimulatedArm("none").find_poses(p, 20, 0) for p in points])
    targets = np.repeat(points, 20, axis=0)

    def shown(errors):
        machine = SimulatedArm(errors, random_state=5)
        angles = machine.solve(start, targets)
        return machine.nominal_arm.forward(angles) - targets

    sources = [
        {"length_mm": 0.05}, {"angle_deg": 0.002}, {"eccentricity_arcsec": (4, 1.2)},
        {"wobble_arcsec": 3}, {"runout_um": 2}, {"sag_um": (128, 24)}, {"warming_k": 1},
        {"joint_compliance_urad_per_nm": 33, "counterbalance": 0.85},
    ]  # fmt: skip
    together = ArmErrors.only(**{k: v for source in sources for k, v in source.items()})
    whole, parts = shown(together), sum(shown(ArmErrors.only(**source)) for source in sources)
    assert np.abs(whole).max() > 0.1
    assert_allclose(parts, whole, atol=1e-3)


# -- sources that are off by default -----------------------------------------------------------


def test_play_lags_behind_the_direction_of_each_joint(poses):
    machine = SimulatedArm(ArmErrors.only(play_arcsec=20), random_state=2)
    arm = machine.true_arm
    assert_array_equal(machine.forward(poses), arm.forward(poses))  # in the middle
    moved = np.zeros((6, len(poses), 3))
    for joint in range(6):
        up = np.zeros(poses.shape)
        up[:, joint] = 1
        ends = [machine.forward(poses, directions=sign * up) for sign in (1, -1)]
        # The same two points that the arm has where this joint alone stands a little back.
        play = (
            np.linalg.norm(ends[0] - ends[1], axis=1).sum()
            / np.linalg.norm(arm.jacobian(poses)[:, :, joint], axis=1).sum()
        )
        assert 10 <= play / ARCSEC <= 30
        assert_allclose(ends[0], arm.forward(poses - play / 2 * up), atol=2e-5)
        moved[joint] = ends[0] - arm.forward(poses)
    together = machine.forward(poses, directions=np.ones(poses.shape))
    assert_allclose(together - arm.forward(poses), moved.sum(axis=0), atol=1e-9)


def test_softening_grows_with_the_cube_of_the_load():
    machine = SimulatedArm(ArmErrors.only(softening_arcsec=5))
    out = np.tile(STRAIGHT_OUT, (3, 1))
    out[:, 1] += [0, 0.5, 1.0]
    load = _torques(machine, out)[:, 3]
    moved = np.linalg.norm(_moved(machine, out), axis=1)
    beyond_elbow = 500.557 + 97.811
    assert moved[0] == pytest.approx(5 * ARCSEC * beyond_elbow, rel=0.01)
    assert_allclose(moved / moved[0], np.abs(load / load[0]) ** 3, rtol=1e-6)
    assert moved[2] < moved[0] / 2


@pytest.mark.exhaustive
def test_drift_is_the_warming_that_the_thermometer_shows():
    errors = ArmErrors.only(warming_k=1, drift_k=2)
    test = make_single_point(3, 10, machine=errors)
    assert test.temperature[[0, -1]] == pytest.approx([21, 23])
    assert np.all(np.diff(test.temperature, 2) < 0)
    machine = test.simulation.machine
    for row in (0, 7, 29):
        at = machine.forward(test.data[[row]], warming_k=test.temperature[row] - 20)
        assert_allclose(at, test.simulation.true_points[[row]], atol=2e-6)
    steady = make_single_point(3, 10, machine=ArmErrors.only(warming_k=1))
    assert set(steady.temperature) == {21.0}


def test_a_payload_bends_as_a_weight_at_the_probe():
    """Castigliano: how far it sinks is the slope of the bending energy by the force."""
    sizes = {"joint_compliance_urad_per_nm": 20, "counterbalance": 0.5}
    machine, newton = SimulatedArm(ArmErrors.only(**sizes)), np.array([0.0, 8.0])
    out = np.tile(STRAIGHT_OUT, (2, 1))
    bent = machine.deviations(out, payload_n=newton)["payload"]
    assert not bent[0].any()
    shoulder, beyond_elbow = 750.742 + 500.557 + 97.811, 500.557 + 97.811  # mm
    drop = 20e-6 * 8e-3 * (0.5 * shoulder**2 + beyond_elbow**2 + 97.811**2)
    assert bent[1, 2] == pytest.approx(-drop, rel=2e-3)
    # The cantilevers of both tubes, each with a load F at the end of what it carries.
    machine = SimulatedArm(ArmErrors.only(sag_um=(100, 20)))
    ei = [(15.6 * L / 8 + load / 3) * L**3 / sag for L, load, sag in (
        (0.750742, 9.8 + 15.6 * 0.500557 + 5.9, 100e-6), (0.500557, 5.9, 20e-6))]  # fmt: skip
    parts = [_cantilever(L, 0, 8.0, one) for L, one in zip((0.750742, 0.500557), ei, strict=True)]
    drop = sum(1e3 * sag + slope * arm for (sag, slope), arm in zip(
        parts, (beyond_elbow, 97.811), strict=True))  # fmt: skip
    bent = machine.deviations(out, payload_n=8.0)["payload"]
    assert bent[:, 2] == pytest.approx(-drop, rel=2e-3)


def test_a_perfect_model_knows_the_new_sources():
    """Their own errors are larger than what is left once they are known."""
    sources = {"play_arcsec": 10, "softening_arcsec": 5, "drift_k": 3, "payload_n": 9}
    errors = ArmErrors.only(**sources, joint_compliance_urad_per_nm=30)
    test = make_single_point(4, 10, machine=errors)
    perfect = test.points - test.simulation.perfect_correction
    assert metrics.single_point_repeatability(perfect, test.groups) < 1e-5
    assert metrics.single_point_repeatability(test.points, test.groups) > 1e-3


@pytest.mark.exhaustive
def test_slipped_poses_have_left_their_cone():
    errors = ArmErrors.only(slip_share=0.2, slip_mm=0.5)
    test = make_single_point(4, 50, machine=errors, random_state=1)
    slipped = test.simulation.slipped
    assert 25 <= slipped.sum() <= 55  # binomial: 40 +- 5.7
    apart = test.simulation.true_points - test.simulation.positions[test.groups]
    assert_allclose(np.linalg.norm(apart, axis=1), 0.5 * slipped, atol=1e-9)
    assert np.linalg.norm(apart[slipped].mean(axis=0)) < 0.2  # in all directions
    assert not make_single_point(2, 5).simulation.slipped.any()


def test_directions_are_those_in_which_the_rows_follow():
    test = make_single_point(2, 30, random_state=3)
    moved = np.diff(test.data, axis=0)
    clear = (np.abs(moved) > 0.01) & (np.abs(moved) < np.pi)
    assert_array_equal(test.directions[1:][clear], np.sign(moved[clear]))
    assert_array_equal(test.directions[0], test.directions[1])


def test_readings_are_noisy_and_quantised_as_asked():
    machine = SimulatedArm(ArmErrors.only(encoder_noise_arcsec=1.5, quantisation_arcsec=0.5))
    angles = np.random.default_rng(0).uniform(-3, 3, (3000, 6))
    readings = machine.read(angles, random_state=0)
    counts = readings / (0.5 * ARCSEC)
    assert_allclose(counts, counts.round(), atol=1e-6)
    # 18 000 draws: the standard deviation is known to half a percent; 0.5^2 / 12 is added.
    expected = np.hypot(1.5, 0.5 / np.sqrt(12))
    error = (readings - angles) / ARCSEC
    assert error.std() == pytest.approx(expected, rel=0.03)
    assert abs(error.mean()) < 4 * expected / np.sqrt(error.size)  # rounded, not cut off


def test_individuals_are_built_as_inaccurately_as_asked():
    arms = [SimulatedArm(ArmErrors(), random_state=s) for s in range(100)]
    sizes = dict.fromkeys(("a", "d", "probe"), 0.2)
    sizes |= dict.fromkeys(("alpha", "theta_offset"), np.deg2rad(0.02))
    for field, size in sizes.items():
        errors = np.array([getattr(m.true_arm, field) - getattr(m.nominal_arm, field)
                           for m in arms])  # fmt: skip
        if field in ("d", "theta_offset"):
            assert not errors[:, 0].any()  # they define the base frame
            errors = errors[:, 1:]
        assert errors.std() == pytest.approx(size, rel=0.2)
        assert np.all(errors.std(axis=0) > 0.6 * size)


# -- the poses ----------------------------------------------------------------------------------


def test_a_person_could_take_the_poses():
    machine = SimulatedArm("none")
    point = np.array([500.0, -300.0, 200.0])
    angles = machine.find_poses(point, 200, random_state=0)
    frames = machine.nominal_arm.frames(angles)
    probe = machine.nominal_arm.forward(angles)
    assert np.abs(probe - point).max() < 1e-6
    assert np.all(np.diff(angles[:, 2]) >= 0)
    # The elbow goes from one side of the shoulder-probe plane to the other, above the cone.
    side = np.cross([0, 0, 1], point - machine.shoulder)
    elbow = (frames[:, 3, :, 3] - machine.shoulder) @ side / np.linalg.norm(side)
    assert elbow.min() < -350
    assert elbow.max() > 350
    assert np.all(frames[:, 3:6, 2, 3] > point[2])
    stylus = (probe - frames[:, 6, :, 3]) / 97.811
    assert np.all(stylus[:, 2] < -np.cos(np.deg2rad(60.01)))


@pytest.mark.parametrize("mix", ["typical", "gravity", "eccentricity"])
def test_the_true_probe_sits_in_the_cone_within_the_seating_error(mix):
    test = make_single_point(4, 30, machine=mix, random_state=1)
    truth = test.simulation
    seating = (truth.true_points - truth.positions[test.groups]) * 1e3
    assert seating.std() == pytest.approx(3, rel=0.2)
    # Readings differ from the solved angles by noise and half a step only.
    reread = truth.machine.solve(test.data, truth.true_points)
    assert np.abs(truth.machine.forward(reread) - truth.true_points).max() < 1e-6
    reached = np.linalg.norm(truth.positions - truth.machine.shoulder, axis=1)
    assert np.all(np.abs(reached / truth.machine.reach - 0.5) <= 0.3)


# -- the data sets ------------------------------------------------------------------------------


def test_a_perfect_arm_does_not_scatter_and_measures_lengths_exactly():
    test = make_single_point(4, 20, machine="none")
    assert metrics.single_point_repeatability(test.points, test.groups, aggregate="max") < 1e-6
    gauge = make_gauge(n_placements=3, machine="none")
    measured = metrics.gauge_lengths(gauge.points, gauge.groups, gauge.pairs)
    assert abs(metrics.length_error(measured, gauge.lengths)).max() < 1e-6


def test_calibration_and_a_perfect_model_each_leave_less():
    test = make_single_point(6, 60)
    truth = test.simulation

    shown = test.nominal_arm.forward(test.data), test.points, test.points - truth.perfect_correction
    nominal, before, floor = (metrics.single_point_repeatability(p, test.groups) for p in shown)
    assert nominal > 10 * before > 20 * floor > 0
    # Calibrated on other data, without the true table: it cannot be it.
    assert test.arm != truth.machine.true_arm
    true_points = truth.machine.forward(test.data)
    assert_allclose(truth.perfect_correction + true_points, test.points)
    assert_allclose(test.arm.forward(test.data), test.points)
    means = np.stack([test.points[test.groups == i].mean(axis=0) for i in range(6)])
    assert_allclose(test.target, test.points - means[test.groups])


def test_noise_alone_makes_the_floor():
    noise = ArmErrors.only(encoder_noise_arcsec=1, seating_um=3)
    test = make_single_point(3, 400, machine=noise)
    perfect = test.points - test.simulation.perfect_correction
    floor = metrics.single_point_repeatability(perfect, test.groups)
    jacobian = test.simulation.machine.true_arm.jacobian(test.data)
    variance = (jacobian**2).sum(axis=(1, 2)) * ARCSEC**2 + 3 * 0.003**2  # propagated
    by_position = [2 * np.sqrt(variance[test.groups == g].mean()) for g in range(3)]
    assert floor == pytest.approx(np.mean(by_position), rel=0.05)


def test_gauges_have_their_lengths():
    gauge = make_gauge((300, 500), n_placements=4, n_poses=5)
    ends = gauge.simulation.positions
    assert gauge.pairs.shape == (8, 2)
    assert_allclose(
        np.linalg.norm(ends[gauge.pairs[:, 1]] - ends[gauge.pairs[:, 0]], axis=1), gauge.lengths
    )
    assert_array_equal(gauge.lengths, [300] * 4 + [500] * 4)
    assert np.all(np.bincount(gauge.groups) == 5)


def test_same_seed_same_data_whatever_ran_before():
    first = make_single_point(3, 10, random_state=1)
    np.random.seed(0)  # noqa: NPY002
    make_gauge(n_placements=2)
    again = make_single_point(3, 10, random_state=1)
    assert_array_equal(first.data, again.data)
    assert_array_equal(first.target, again.target)
    assert not np.array_equal(first.data, make_single_point(3, 10).data)
    # A seed is one individual, which both tests measure with, at other places.
    gauge = make_gauge(n_placements=2, random_state=1)
    assert gauge.arm == first.arm
    assert gauge.simulation.machine is first.simulation.machine


def test_an_individual_keeps_its_draws_when_sources_are_switched_off(poses):
    whole = SimulatedArm("typical", random_state=4).deviations(poses)
    alone = SimulatedArm(ArmErrors.only(wobble_arcsec=3, length_mm=0.2, angle_deg=0.02),
                         random_state=4).deviations(poses)  # fmt: skip
    assert_array_equal(whole["wobble"], alone["wobble"])
    assert not alone["sag"].any()


def test_one_machine_can_be_measured_again_and_again():
    machine = make_single_point(2, 10, machine="gravity").simulation.machine
    first, second = (make_single_point(2, 10, machine=machine, random_state=s) for s in (1, 2))
    assert first.arm == second.arm
    assert not np.array_equal(first.simulation.positions, second.simulation.positions)
    drawn = make_single_point(2, 5, random_state=np.random.RandomState(0))
    assert_array_equal(
        drawn.data, make_single_point(2, 5, random_state=np.random.RandomState(0)).data
    )
