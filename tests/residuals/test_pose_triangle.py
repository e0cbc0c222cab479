"""Equations (2) and (3) against their closed forms, and against frames on other arms."""

import numpy as np
import pytest

from sklearn_raacmm import Arm, elbow_angle, shoulder_wrist_distance

A2, A4, D3, D5 = 62.0, 40.0, 750.0, 500.0


def ideal():
    return Arm.from_degrees(
        a=[0, A2, 0, A4, 0, 0],
        alpha=[-90, -90, 90, -90, 90, -90],
        d=[376.5, 0, D3, 0, D5, 15],
        probe=(0, 0, 98),
    )


def test_both_are_functions_of_the_elbow_alone():
    angles = np.random.default_rng(0).uniform(-3, 3, (200, 6))
    elbow = angles[:, 3]
    first, second, phi = D3, np.hypot(A4, D5), np.arctan2(A4, D5)
    squared = first**2 + second**2 + 2 * first * second * np.cos(elbow - phi)
    distance = shoulder_wrist_distance(ideal(), angles)
    np.testing.assert_allclose(distance, np.sqrt(squared), rtol=1e-12)
    gamma = elbow_angle(ideal(), angles)
    by_cosines = (first**2 + second**2 - squared) / (2 * first * second)
    np.testing.assert_allclose(np.cos(gamma), by_cosines, atol=1e-12)
    # theta4 = phi +- (pi - gamma), up to whole turns.
    turn = 2 * np.pi
    miss = [np.abs((elbow - phi - s * (np.pi - gamma) + 3) % turn - 3) for s in (1, -1)]
    assert np.minimum(*miss).max() < 1e-12


def test_a_straight_arm_keeps_its_digits():
    straight = np.zeros((1, 6))
    straight[0, 3] = np.arctan2(A4, D5) + 1e-9
    assert np.pi - elbow_angle(ideal(), straight)[0] == pytest.approx(1e-9, rel=1e-5)


@pytest.mark.parametrize(("name", "elbow_frame"), [("aacmm6", 3), ("ur10", 2), ("panda", 4)])
def test_other_arms_by_their_frames(name, elbow_frame):
    arm = Arm.from_name(name)
    angles = np.random.default_rng(1).uniform(-2, 2, (20, arm.n_joints))
    origins = arm.frames(angles)[..., 3]
    shoulder, wrist = (origins[:, frame] for frame in arm.pose_frames)
    elbow = origins[:, elbow_frame]
    distance = shoulder_wrist_distance(arm, np.rad2deg(angles), angle_unit="deg")
    np.testing.assert_allclose(distance, np.linalg.norm(wrist - shoulder, axis=1))
    first, second = (np.linalg.norm(end - elbow, axis=1) for end in (shoulder, wrist))
    gamma = np.arccos((first**2 + second**2 - distance**2) / (2 * first * second))
    np.testing.assert_allclose(elbow_angle(arm, angles), gamma, atol=1e-6)
    # The elbow turns about its own joint: the sides stay as long as they are.
    assert np.ptp(first) < 1e-9
    bent = angles.copy()
    bent[:, arm.pose_joints[1] - 1] += 0.3
    change = elbow_angle(arm, bent) - elbow_angle(arm, angles)
    assert np.abs(change).min() > 0.01


def test_no_rows_and_no_triangle():
    assert shoulder_wrist_distance(ideal(), np.empty((0, 6))).shape == (0,)
    assert elbow_angle(ideal(), np.empty((0, 6))).shape == (0,)
    with pytest.raises(ValueError, match="leaves its angle undefined"):
        elbow_angle(ideal().replace(pose_frames=(3, 5)), np.zeros((1, 6)))
    with pytest.raises(ValueError, match="6 joints"):
        elbow_angle(ideal(), np.zeros((1, 5)))
