"""The error model of arms with joints that slide."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate
from sklearn_raacmm.error_model._columns import Terms, columns_of

ARCSEC = np.pi / 180 / 3600
RAIL = Arm.from_name("ur10_rail").replace(probe=(20, 30, 100))
GANTRY = Arm.from_degrees(
    a=[0, 0, 0, 60, 0], alpha=[-90, 90, 0, -90, 0], d=[0, 0, 0, 0, 120],
    theta_offset=[0, -90, 0, 0, 0], joint_types="PPPRR", probe=(30, 20, 150),
    limits=[(0, 2000), (0, 1500), (0, 800), (-3, 3), (-2, 2)],
)  # fmt: skip


def errors(arm, q):
    """What is off at the probe, (n, 3) mm.

    Of each slide a pitch error of 20 um every 10 mm, 50 um of straightness and 8 arc seconds of
    pitch, and a scale of 30 ppm; of each other joint an eccentricity of 10 arc seconds.
    """
    given, frames = q.copy(), arm.frames(q)
    shift = np.zeros((len(q), 3))
    for i, kind in enumerate(arm.joint_types):
        if kind == "R":
            given[:, i] += 10 * ARCSEC * np.cos(q[:, i] + i)
            continue
        low, high = arm.limits[i]
        way, carriage = np.pi * (q[:, i] - low) / (high - low), frames[:, i, :, :3]
        given[:, i] += 30e-6 * q[:, i] + 0.02 * np.sin(2 * np.pi * q[:, i] / 10 + i)
        shift += 0.05 * np.sin(1.5 * way + i)[:, None] * carriage[:, :, 0]
        turn = 8 * ARCSEC * np.sin(2 * way + i)[:, None] * carriage[:, :, 1]
        shift += np.cross(turn, arm.forward(q) - frames[:, i + 1, :, 3])
    return arm.forward(given) + shift - arm.forward(q)


@pytest.fixture(scope="module", params=[RAIL, GANTRY], ids=["rail", "gantry"])
def learnt(request):
    """A machine, its calibration by a tracker of 20 um, and the model of what that leaves."""
    arm, rng = request.param, np.random.default_rng(1)
    q = arm.random_poses(600, rng)
    points = arm.forward(q) + errors(arm, q) + rng.normal(0, 0.02, (600, 3))
    result = calibrate(arm, q, points=points)
    model = ArmResidualRegressor(result.arm).fit(q, result.residuals(q, points), groups=False)
    return arm, result, model


@pytest.fixture
def fitted(learnt):
    return learnt[2]


def test_what_is_left_at_places_unseen_is_near_the_share_of_the_noise(learnt):
    arm, result, fitted = learnt
    q, rng = arm.random_poses(2000, np.random.default_rng(2)), np.random.default_rng(3)
    y = result.residuals(q, arm.forward(q) + errors(arm, q))
    mean, std = fitted.predict(q, return_std=True, with_noise=True)
    left = np.sqrt(np.mean((y - mean) ** 2))
    assert left < 1.3 * 0.02 * np.sqrt(fitted.n_determined_ / 1800)
    assert left < 0.3 * np.sqrt(np.mean(y**2))
    inside = np.abs(y + rng.normal(0, 0.02, y.shape) - mean) < 1.96 * std
    assert 0.90 < inside.mean() < 0.98


def test_pitches_are_found_as_waves_in_mm(fitted):
    """A turn of a slide is twice its travel: the pitch of 10 mm has that number of waves in it."""
    arm, found = fitted.arm_, {tuple(pair) for pair in fitted.linear_model_.terms.harmonics}
    for i, kind in enumerate(arm.joint_types):
        if kind == "P":
            assert (i, int(arm.turn_mm[i] / 10)) in found


def test_a_moved_probe_keeps_the_causes(learnt):
    arm, result, fitted = learnt
    q, longer = arm.random_poses(500, np.random.default_rng(3)), np.array([20, -60, 150])
    far = arm.replace(probe=arm.probe + longer)
    moved = fitted.with_arm(result.arm.replace(probe=result.arm.probe + longer))
    base = (far.forward(q) + errors(far, q) - result.base_translation) @ result.base_rotation
    bare, left = moved.arm_.forward(q) - base, moved.correct(q) - base
    assert np.sqrt(np.mean(left**2)) < 0.5 * np.sqrt(np.mean(bare**2))


def test_planned_joints_bring_the_corrected_probe_to_the_points(fitted):
    q = fitted.arm_.random_poses(20, np.random.default_rng(4))
    wanted = fitted.arm_.forward(q)
    found = fitted.angles_for(wanted, q)
    reached = ~np.isnan(found[:, 0])
    assert reached.sum() > 15
    assert_allclose(fitted.correct(found[reached]), wanted[reached], atol=1e-6)


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_columns_are_derivatives(convention):
    """Of zeros, scales and waves of the slides, by differences of what the arm shows."""
    arm = Arm.from_degrees(
        a=[0, 0, 50, 60], alpha=[20, 90, 0, -90], d=[30, 40, 20, 120], joint_types="PRPR",
        probe=(30, 20, 150), limits=[(0, 900), (-3, 3), (-100, 300), (-2, 2)],
        joint_signs=[1, 1, -1, 1], convention=convention,
    )  # fmt: skip
    q, step = arm.random_poses(15), 1e-3
    columns = columns_of(arm, Terms(np.array([[0, 7], [2, 3]]), False, True, True))
    values, table = columns.at(q), columns.table
    names = [""] * columns.n_waves + columns.names
    for j in (0, 2):
        unit, at = np.eye(4)[j], arm.d[j] + arm.joint_signs[j] * q[:, j]
        i = names.index(f"scale{j + 1}")
        grown = q + arm.joint_signs[j] * np.outer(at, unit) * step
        expected = (arm.forward(grown) - arm.forward(q)) / step
        assert_allclose(values[:, :, i] / table["unit"][i], expected, atol=1e-6)
        order = {0: 7, 2: 3}[j]
        for sign, wave in ((1, np.cos), (-1, np.sin)):
            (i,) = np.flatnonzero((table["order"] == sign * order) & (np.array(names) == ""))
            wavy = wave(2 * np.pi * order * q[:, j] / arm.turn_mm[j])
            moved = arm.forward(q + arm.reach_mm * ARCSEC * np.outer(wavy, unit))
            assert_allclose(values[:, :, i], moved - arm.forward(q), atol=1e-7)
