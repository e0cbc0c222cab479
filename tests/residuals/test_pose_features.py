import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_raacmm import Arm, PoseFeatures, elbow_angle, shoulder_wrist_distance

NAMES = ["aacmm6", "panda", "ur10"]


def random_angles(arm, n=40, seed=0):
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (n, arm.n_joints))


@pytest.mark.parametrize("name", NAMES)
def test_pose_against_vectors(name):
    """theta_dis is what is left of a right angle between the line O2-O5 and the vertical."""
    arm = Arm.from_name(name)
    angles = random_angles(arm)
    shoulder, wrist = (arm.frames(angles)[:, frame, :, 3] for frame in arm.pose_frames)
    line = wrist - shoulder
    from_vertical = np.arccos(line[:, 2] / np.linalg.norm(line, axis=1))

    features = PoseFeatures(arm).fit_transform(angles)

    swivel, elbow = arm.pose_joints
    assert_array_equal(features[:, :2], angles[:, [swivel - 1, elbow - 1]])
    assert_allclose(features[:, 2], np.pi / 2 - from_vertical, atol=1e-7)


def test_pose_ignores_what_does_not_change_the_shape():
    """The base exactly, and on an ideal arm (a5 = 0) the forearm's roll and the wrist as well."""
    ideal = Arm.from_degrees(
        a=[0, 62, 0, 62, 0, 0], alpha=[-90, -90, 90, -90, 90, -90], d=[376, 0, 750, 0, 500, 15]
    )
    angles = random_angles(ideal)
    other = random_angles(ideal, seed=1)
    other[:, 1:4] = angles[:, 1:4]
    pose = PoseFeatures(ideal).fit(angles)
    assert_allclose(pose.transform(other), pose.transform(angles), atol=1e-12)
    # The shoulder does change it, so this is not a constant.
    other[:, 1] += 0.1
    assert not np.allclose(pose.transform(other), pose.transform(angles), atol=1e-3)


@pytest.mark.parametrize("joints", ["pose", "all"])
def test_periodic_is_cosine_and_sine_of_the_same_angles(joints):
    arm = Arm.from_name("aacmm6")
    angles = random_angles(arm)
    features = PoseFeatures(arm, encoding="periodic", joints=joints).fit_transform(angles)
    plain = PoseFeatures(arm, joints=joints).fit_transform(angles)
    assert_allclose(np.arctan2(features[:, 1::2], features[:, ::2]), plain, atol=1e-12)


@pytest.mark.parametrize("joints", ["pose", "all"])
@pytest.mark.parametrize("name", NAMES)
def test_appended_azimuth_is_that_of_the_arm(name, joints):
    arm = Arm.from_name(name)
    angles = random_angles(arm)
    features = PoseFeatures(arm, append_azimuth=True, joints=joints).fit_transform(angles)
    assert_array_equal(features[:, :-2], PoseFeatures(arm, joints=joints).fit_transform(angles))
    azimuth = arm.azimuth(angles)
    direction = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    assert_allclose(features[:, -2:], direction, atol=1e-14)


POSE = ["theta3", "theta4", "theta_dis"]


@pytest.mark.parametrize(
    ("params", "names"),
    [
        ({}, POSE),
        ({"arm": Arm.from_name("aacmm6", pose_joints=(4, 2))}, ["theta4", "theta2", "theta_dis"]),
        ({"append_azimuth": True}, [*POSE, "azimuth_cos", "azimuth_sin"]),
        ({"encoding": "periodic"}, [f"{a}_{part}" for a in POSE for part in ("cos", "sin")]),
        ({"joints": "all"}, [f"theta{i}" for i in range(1, 7)]),
    ],
)
def test_names_of_features(params, names):
    pose = PoseFeatures(**params).set_output(transform="pandas")
    assert pose.fit_transform(random_angles(Arm.from_name("aacmm6"))).columns.tolist() == names


def test_probe_on_the_base_axis():
    """A hinge at the base that can bring the probe straight above it."""
    arm = Arm(a=[0, 300, 300], alpha=[np.pi / 2, 0, 0], d=[400, 0, 0], pose_joints=(2, 3),
              pose_frames=(1, 2))  # fmt: skip
    pose = PoseFeatures(arm, append_azimuth=True).fit(np.zeros((1, 3)))
    upright = np.array([[0.0, 0, 0], [0.5, 1, 0], [0.3, np.pi / 2, 0]])
    with pytest.raises(ValueError, match=r"probe lies on the base axis, first in row 2 \(radius"):
        pose.transform(upright)
    # Without the azimuth nothing is undefined there.
    assert_allclose(PoseFeatures(arm).fit_transform(upright)[2, 2], np.pi / 2)


def test_shoulder_and_wrist_that_coincide():
    arm = Arm.from_name("panda").replace(pose_frames=(1, 2))  # d2 = a1 = 0: one point, always
    with pytest.raises(ValueError, match="frames 1 and 2 coincide, first in row 0"):
        PoseFeatures(arm).fit_transform(np.zeros((3, 7)))
    # Two links of one length, folded in the last row.
    arm = Arm(a=[0, 300, 300], alpha=[np.pi / 2, 0, 0], d=[400, 0, 0], pose_joints=(2, 3),
              pose_frames=(1, 3))  # fmt: skip
    angles = np.array([[0, 0, 0], [0.5, 1, 1], [0.3, 0.4, np.pi]])
    with pytest.raises(ValueError, match="frames 1 and 3 coincide, first in row 2"):
        PoseFeatures(arm).fit_transform(angles)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("encoding", ["angle", "periodic"])
def test_one_row_is_the_same_to_the_last_bit_as_among_others(name, encoding):
    arm = Arm.from_name(name)
    angles = random_angles(arm, n=300)
    pose = PoseFeatures(arm, encoding=encoding, append_azimuth=True).fit(angles)
    together = pose.transform(angles)
    alone = np.concatenate([pose.transform(row[None]) for row in angles])
    assert_array_equal(alone, together)


@pytest.mark.parametrize("unit", ["rad", "deg"])
@pytest.mark.parametrize("joints", ["pose", "all"])
@pytest.mark.parametrize("encoding", ["angle", "periodic"])
def test_a_whole_turn_is_no_difference(encoding, joints, unit):
    arm = Arm.from_name("aacmm6")
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (50, 6)) * [3, 1, 3, 1, 3, 1] + [0, -1.3, 2.5, 1.2, 0, -4]
    turned = X + 2 * np.pi * rng.integers(-1, 2, X.shape)
    if unit == "deg":
        X, turned = np.rad2deg(X), np.rad2deg(turned)
    pose = PoseFeatures(arm, encoding=encoding, joints=joints, angle_unit=unit).fit(X)
    assert_allclose(pose.transform(turned), pose.transform(X), atol=1e-12)


def test_angles_seen_in_fit_stay_as_they_are():
    """A joint whose range holds 180 degrees is not cut there, nor is one beyond a turn moved."""
    rng = np.random.default_rng(0)
    low = np.array([-3.1, 0.3, -6.0, 3.3, 5.0, -1.0])
    X = low + rng.uniform(0, 1, (200, 6)) * [6.2, 5.7, 2.5, 0.5, 5.0, 6.0]
    pose = PoseFeatures(joints="all").fit(X)
    assert_array_equal(pose.transform(X), X)
    assert np.all(pose.turn_start_ < X.min(axis=0))
    assert np.all(pose.turn_start_ + 2 * np.pi > X.max(axis=0))
    middle = (X.min(axis=0) + X.max(axis=0)) / 2 - np.pi
    assert_allclose(pose.turn_start_, middle, atol=1e-9)  # as far from both ends


# -- equations (2) and (3) against their closed forms, and against frames on other arms -----------

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
    assert_allclose(distance, np.sqrt(squared), rtol=1e-12)
    gamma = elbow_angle(ideal(), angles)
    by_cosines = (first**2 + second**2 - squared) / (2 * first * second)
    assert_allclose(np.cos(gamma), by_cosines, atol=1e-12)
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
    assert_allclose(distance, np.linalg.norm(wrist - shoulder, axis=1))
    first, second = (np.linalg.norm(end - elbow, axis=1) for end in (shoulder, wrist))
    gamma = np.arccos((first**2 + second**2 - distance**2) / (2 * first * second))
    assert_allclose(elbow_angle(arm, angles), gamma, atol=1e-6)
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
