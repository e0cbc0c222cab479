"""A plan of a first test: it is reached, spread, within limits, and in an order of short ways."""

import numpy as np
import pytest

from sklearn_raacmm import Arm, plan_poses

ARM = Arm.from_name("aacmm6")


def test_poses_reach_their_cones_from_above():
    plan = plan_poses(ARM, 4, 8, lean_deg=60, random_state=1)
    points = ARM.forward(plan.angles)
    assert np.abs(points - plan.positions[plan.groups - 1]).max() < 1e-6
    assert plan.minutes == pytest.approx((4 * 60 + 32 * 6) / 60)
    frames = ARM.frames(plan.angles)
    down = -(frames[:, -1, :, :3] @ ARM.probe)[:, 2] / np.linalg.norm(ARM.probe)
    # The line from the last frame to the cone's centre is the probe.
    assert (down >= np.cos(np.deg2rad(60)) - 1e-9).all()
    gaps = np.linalg.norm(plan.positions[:, None] - plan.positions, axis=2)
    assert gaps[np.triu_indices(4, 1)].min() > 300


def test_places_are_within_reach_and_the_plan_is_the_same_again():
    plan, again = (plan_poses(ARM, 3, 6) for _ in range(2))
    away = np.linalg.norm(plan.positions, axis=1) / ARM.reach_mm
    assert (away >= 0.25).all()
    assert (away <= 0.85).all()
    assert np.array_equal(plan.angles, again.angles)


def test_the_order_is_one_of_short_ways():
    plan = plan_poses(ARM, 3, 10)
    rng = np.random.default_rng(0)

    def way(order):
        steps = np.diff(plan.angles[order], axis=0)
        return np.abs(steps).max(axis=1).sum()

    within = [rng.permutation(30).tolist() for _ in range(20)]
    assert way(np.arange(30)) < min(map(way, within))


@pytest.mark.exhaustive
def test_what_cannot_be_reached_is_said():
    with pytest.raises(ValueError, match="only 0 of 8 places that were tried are reached"):
        plan_poses(ARM, 2, 5, lean_deg=0.0)


def test_a_bar_lies_level_and_its_seats_are_two_of_the_cones():
    plan = plan_poses(ARM, 4, 5, bar_mm=400, random_state=2)
    first, second = (plan.positions[i - 1] for i in plan.bar)
    assert np.linalg.norm(second - first) == pytest.approx(400)
    assert second[2] == first[2]
    assert np.abs(ARM.forward(plan.angles) - plan.positions[plan.groups - 1]).max() < 1e-6
    assert plan_poses(ARM, 2, 5).bar == ()


def test_a_bar_that_is_longer_than_the_arm_reaches_is_refused():
    with pytest.raises(ValueError, match="both ends of a bar of 9000 mm in 5 poses: give a short"):
        plan_poses(ARM, 2, 5, bar_mm=9000)
