"""Angles that reach points and orientations: forward kinematics says whether they do."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm


def poses(name, n=60, seed=0):
    """An arm, poses of it, and their points and orientations."""
    arm = Arm.from_name(name, joint_signs=-1, probe=(3, 5, 90))
    angles = np.random.default_rng(seed).uniform(-2, 2, (n, arm.n_joints))
    return arm, angles, arm.forward(angles), arm.frames(angles)[:, -1, :, :3]


@pytest.mark.parametrize("name", ["aacmm6", "panda", "ur10"])
@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_points_and_orientations_are_reached(name, unit):
    arm, angles, points, turned = poses(name)
    start = angles + np.random.default_rng(1).normal(0, 0.02, angles.shape)
    start = np.rad2deg(start) if unit == "deg" else start
    found = arm.angles_for(points, start, turned, angle_unit=unit)
    assert_allclose(arm.forward(found, angle_unit=unit), points, atol=1e-6)
    assert_allclose(arm.frames(found, angle_unit=unit)[:, -1, :, :3], turned, atol=1e-9)
    # A point alone leaves the other joints where they are as nearly as may be.
    alone = arm.angles_for(points, start, angle_unit=unit)
    assert_allclose(arm.forward(alone, angle_unit=unit), points, atol=1e-6)
    assert np.linalg.norm(alone - start) < np.linalg.norm(found - start)


@pytest.mark.parametrize("name", ["aacmm6", "iiwa7"])
def test_a_start_is_found(name):
    arm, _, points, turned = poses(name, 20)
    found = arm.angles_for(points, orientations=turned)
    assert_allclose(arm.forward(found), points, atol=1e-6)
    assert_allclose(arm.frames(found)[:, -1, :, :3], turned, atol=1e-9)


def test_half_a_turn_and_limits():
    """Where the orientation is opposite there is no nearest way; limits end ways that there are."""
    arm, angles, points, turned = poses("iiwa7", 3)
    start = angles + np.pi * np.eye(7)[6]
    found = arm.angles_for(points, start, turned)
    assert_allclose(arm.frames(found)[:, -1, :, :3], turned, atol=1e-9)
    short = arm.replace(limits=np.tile([-0.01, 0.01], (7, 1)))
    with pytest.warns(UserWarning, match=r"3 of 3 points .* row 0, .* mm and \d[.\d]* degrees\."):
        assert np.isnan(short.angles_for(points, start, turned)).all()
    inside = arm.replace(limits=np.tile([-2.0, 2.0], (7, 1)))
    found = inside.angles_for(points, orientations=turned)
    assert np.abs(found).max() <= 2.0


def test_a_start_beyond_the_limits_is_whole_turns_away():
    """Such as readings from 0 to a turn, of an arm whose limits are half a turn to either side."""
    arm, angles, points, turned = poses("ur10_rail", 10)
    angles[:, 0] += 1000
    arm = arm.replace(limits=[(0, 4000)] + 6 * [(-2.5, 2.5)], joint_signs=1)
    points, turned = arm.forward(angles), arm.frames(angles)[:, -1, :, :3]
    start = angles + 2 * np.pi * arm.by_type(1.0, 0.0) * np.resize([1, -1, 0, 1, -1], (10, 7))
    assert_allclose(arm.angles_for(points, start, turned), angles, atol=1e-6)


def test_limits_beyond_half_a_turn_are_kept():
    """Such as those of a wrist that counts from 0 to two turns, or that has one limit only."""
    limits = [(-np.inf, 0.5), (-np.inf, np.inf), (3.5, 6), (-7, -4), (-3, 3), (4, np.inf)]
    arm = Arm.from_name("ur10", probe=(0, 0, 100), limits=limits)
    points = arm.forward([[0.1, -1.2, 4.0, -5.5, -1.4, 4.5], [-2.0, -1.0, 5.0, -4.5, 1.0, 5.0]])
    found = arm.angles_for(points)
    assert_allclose(arm.forward(found), points, atol=1e-6)
    assert np.all((found >= arm.limits[:, 0]) & (found <= arm.limits[:, 1]))


def test_a_correction_may_leave_orientations_as_they_are():
    arm = Arm.from_name("ur10")
    pose = np.array([[0.1, -1.0, 1.2, -0.5, -1.4, 0.3]])
    shift, turned = np.array([[0.2, -0.1, 0.3]]), arm.frames(pose)[:, -1, :, :3]
    found = arm.angles_for(
        arm.forward(pose) - shift, pose, turned, correction=lambda angles, rows: (shift, None)
    )
    assert_allclose(arm.forward(found), arm.forward(pose), atol=1e-6)
    assert_allclose(arm.frames(found)[:, -1, :, :3], turned, atol=1e-8)


def test_what_is_out_of_reach_asks_for_few_corrections():
    """Of a model that takes long: a way that leads no nearer ends, and so does what is too far."""
    arm, angles, points, turned = poses("ur10", 12)
    far, beside = points.copy(), points.copy()
    far *= 1.01 * arm.reach_mm / np.linalg.norm(far, axis=1, keepdims=True)
    beside *= 0.99 * arm.reach_mm / np.linalg.norm(beside, axis=1, keepdims=True)
    every = np.concatenate([points, far, beside])
    asked = np.zeros(36, dtype=int)

    def correction(angles, rows):
        asked[rows] += 1
        return np.full((len(rows), 3), 0.1), np.full((len(rows), 3), 1e-4)

    start = np.tile(angles + 0.02, (3, 1))
    with pytest.warns(UserWarning, match="24 of 36 points are not reached: first that of row 12,"):
        found = arm.angles_for(every, start, np.tile(turned, (3, 1, 1)), correction=correction)
    assert_allclose(arm.forward(found[:12]), points + 0.1, atol=1e-6)
    assert np.isnan(found[12:]).all()
    assert asked[:12].max() <= 3
    assert asked[12:24].max() <= 5
    assert asked[24:].max() <= 30


def test_a_slide_without_limits_has_no_reach():
    arm = Arm.from_name("ur10_rail", limits=None)
    angles = arm.random_poses(40, np.random.default_rng(5))  # two of which the zero does not find
    angles[:, 0] = np.linspace(4500, 9000, 40)
    points, turned = arm.forward(angles), arm.frames(angles)[:, -1, :, :3]
    found = arm.angles_for(points, orientations=turned)
    assert_allclose(arm.forward(found), points, atol=1e-6)
