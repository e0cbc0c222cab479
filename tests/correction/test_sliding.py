"""Corrections of arms with joints that slide: checked, updated and planned, and searches."""

import numpy as np
import pytest

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    Correction,
    Measurements,
    directions_of,
    learn_correction,
    plan_poses,
    search_table,
)

RAIL = Arm.from_name("ur10_rail").replace(probe=(20, 30, 100))
ARCSEC = np.pi / 180 / 3600


def measured(n, seed, scale=0.0):
    """Joints and a tracker's points of a rail whose straightness is off, and perhaps its scale."""
    rng = np.random.default_rng(seed)
    q = RAIL.random_poses(n, rng)
    given = q + 15 * ARCSEC * np.cos(q) * (np.arange(7) > 0)
    given[:, 0] += scale * q[:, 0]
    off = 0.05 * np.sin(1.5 * np.pi * q[:, 0] / 4000)
    points = RAIL.forward(given) + np.outer(off, [1.0, 0.0, 0.0])
    return q, points + rng.normal(0, 0.02, (n, 3))


@pytest.fixture(scope="module")
def learnt():
    q, points = measured(200, 1)
    return learn_correction(RAIL, q, points=points, model=ArmResidualRegressor(orders=20), cv=2)


def test_a_check_names_the_scale_of_the_rail_and_an_update_takes_it(learnt, tmp_path):
    learnt.save(tmp_path / "saved")
    learnt = Correction.load(tmp_path / "saved")
    q, points = measured(60, 2)
    assert learnt.check(q, points=points).holds
    q, points = measured(60, 3, scale=20e-6)
    check = learnt.check(q, points=points)
    assert not check.holds
    assert check.suspect == "scale of joint 1"
    updated = learnt.update(q, points=points)
    q, points = measured(300, 4, scale=20e-6)
    bare = [one.residuals(q, points) - one.model.predict(q) for one in (learnt, updated)]
    left = [np.sqrt(np.mean(part**2)) for part in bare]
    assert left[1] < 0.8 * left[0]


def test_a_search_finds_a_joint_that_is_reversed():
    q, points = measured(60, 5)
    wrong = RAIL.replace(joint_signs=[1, 1, 1, -1, 1, 1, 1])
    assert search_table(wrong, q, points=points).options == "--take reversed-4"


def test_planned_poses_are_along_the_rail_and_reach_their_cones():
    plan = plan_poses(RAIL, 4, 6, random_state=0)
    assert np.all((plan.angles[:, 0] >= 0) & (plan.angles[:, 0] <= 4000))
    assert np.ptp(plan.angles[:, 0]) > 1000
    cones = np.repeat(plan.positions, 6, axis=0)
    np.testing.assert_allclose(RAIL.forward(plan.angles), cones, atol=1e-6)


def test_steps_of_a_slide_are_no_turns():
    assert directions_of([[0.0], [4.0], [3.0]], joint_types="P").ravel().tolist() == [0, 1, -1]


def test_measurements_of_angles_are_none_of_a_rail(learnt):
    q, points = measured(30, 6)
    with pytest.warns(UserWarning, match="more than two turns"):
        measurements = Measurements.of(q, points=points)
    with pytest.raises(ValueError, match="takes mm for no angles"):
        learnt.check(measurements)
