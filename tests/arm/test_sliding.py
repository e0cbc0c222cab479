"""Arms with joints that slide: rails, gantries, columns and quills."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, PoseFeatures
from sklearn_raacmm.arm import JointTypes
from sklearn_raacmm.utils import Finding

X, Y, Z, DOWN, SKEW = (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (0.6, 0, 0.8)
R, P, F = "revolute", "prismatic", "fixed"
ELBOW = [
    (R, (0, 0, 0.3), (0, 0, 0), Z),
    (R, (0.1, 0, 0.2), (-1.2, 0, 0.3), Z),
    (R, (0.5, 0, 0), (0, 0.2, 0), Y),
    (F, (0.05, 0.02, 0.3), (0.1, 0.2, 0.3), None),
]
# Kind, origin in m, roll, pitch and yaw in rad, and axis of each joint.
MACHINES = {
    **{
        f"gantry {name}": [
            (P, (0, 0, 1.2), (0, 0, 0), axes[0]),
            (P, (0, 0.1, 0), (0, 0, 0), axes[1]),
            (P, (0.2, 0, 0), (0, 0, 0), axes[2]),
            (R, (0, 0, -0.3), (0, 0, 0), Z),
            (R, (0.1, 0, 0), (1.5707963267948966, 0, 0), Z),
            (F, (0.05, 0.1, 0.1), (0, 0, 0), None),
        ]
        for name, axes in {
            "xyz": (X, Y, Z), "yxz": (Y, X, DOWN), "zxy": (Z, X, Y), "skew": (SKEW, Y, Z),
        }.items()
    },
    **{
        f"rail along {name}": [(P, (0.2, 0.1, 0.4), rpy, axis), *ELBOW]
        for name, rpy, axis in (
            ("x", (0, 0, 0), X), ("y", (0, 0, 0), Y),
            ("-z turned", (1.5707963267948966, 0, 0), DOWN), ("x turned", (0, 0, 1.1), X),
            ("skew", (0.3, -0.2, 0.1), SKEW),
        )
    },
    **{
        f"column along {name}": [(R, (0, 0, 0.1), (0, 0, 0), Z), (P, at, rpy, axis), *ELBOW[1:]]
        for name, at, rpy, axis in (
            ("z", (0, 0, 0.2), (0, 0, 0), Z), ("z aside", (0.3, 0.1, 0.2), (0, 0, 0), Z),
            ("-z", (0.3, 0, 0), (0, 0, 0), DOWN), ("leaning z", (0.3, 0, 0), (0.02, -0.01, 0), Z),
            ("x", (0, 0, 0.2), (0.4, 0, 0), X),
        )
    },
    **{
        f"SCARA with {name}": [
            (R, (0, 0, 0.4), (0, 0, 0), Z),
            (R, (0.35, 0, 0), (0, 0, 0), Z),
            (P, at, (0, 0, 0), axis),
            (R, (0, 0, -0.05), (0, 0, 0), Z),
            (F, (0, 0.02, -0.1), (0, 0, 0), None),
        ]
        for name, at, axis in (
            ("a quill", (0.25, 0, 0), Z), ("a quill downwards", (0.25, 0, 0.1), DOWN),
            ("a quill aside", (0.25, 0.04, 0), DOWN),
        )
    },
    **{
        f"slide {name}": [*ELBOW[:k], (P, (0.1, 0.05, 0.2), rpy, axis), *ELBOW[k:]]
        for name, k, rpy, axis in (
            ("in the middle", 2, (0.3, 0.2, 0.1), X), ("of the forearm", 2, (0, 0, 0), Y),
            ("behind the elbow", 3, (0, 0.5, 0), Z), ("before the elbow", 1, (0, 0, 0), SKEW),
        )
    },
    "two rails in a row": [(P, (0, 0, 0), (0, 0, 0), Y), (P, (0.1, 0, 0), (0, 0, 0), Y), *ELBOW],
    "a slide at the end": [*ELBOW[:3], (P, (0.2, 0, 0), (0.2, 0.1, 0), Z)],
    "polar": [*ELBOW[:2], (P, (0.3, 0, 0.1), (0, 1.2, 0), X)],
    "slides alone": [(P, (0, 0, 0.3), (0, 0, 0), Y), (P, (0, 0, 0), (0, 0, 0), X)],
}  # fmt: skip


def text_of(joints):
    """URDF of a machine."""
    lines = ['<robot name="m">', *(f'  <link name="l{i}"/>' for i in range(len(joints) + 1))]
    for i, (kind, xyz, rpy, axis) in enumerate(joints):
        lines += [
            f'  <joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>',
            f'    <origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, rpy))}"/>',
        ]
        if axis:
            lines.append(f'    <axis xyz="{" ".join(map(str, axis))}"/>')
            lines.append('    <limit lower="-1.5" upper="2" effort="1" velocity="1"/>')
        lines.append("  </joint>")
    return "\n".join([*lines, "</robot>"])


def by_hand(joints, q):
    """Tips (n, 3) in mm by products of homogeneous matrices; slides of q are in mm."""
    tips = []
    for row in q:
        pose, values = np.eye(4), iter(row)
        for kind, xyz, rpy, axis in joints:
            origin = np.eye(4)
            origin[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
            origin[:3, 3] = 1000 * np.array(xyz)
            pose = pose @ origin
            if axis:
                move, value = np.eye(4), next(values)
                if kind == P:
                    move[:3, 3] = value * np.array(axis) / np.linalg.norm(axis)
                else:
                    turn = value * np.array(axis) / np.linalg.norm(axis)
                    move[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
                pose = pose @ move
        tips.append(pose[:3, 3])
    return np.array(tips)


def in_same_frame(points, others):
    """The points moved into the frame of others by the rigid motion that fits best."""
    middle, there = points.mean(axis=0), others.mean(axis=0)
    turn, _ = Rotation.align_vectors(others - there, points - middle)
    return turn.apply(points - middle) + there


@pytest.fixture(params=[*MACHINES])
def machine(request):
    joints = MACHINES[request.param]
    types = "".join("RP"[kind == P] for kind, *_ in joints if kind != F)
    rng = np.random.default_rng(3)
    q = rng.uniform(-1, 1.5, (30, len(types))) * JointTypes(types).by_type(1.0, 1000.0)
    return joints, types, q


@pytest.mark.filterwarnings("ignore:The first axis does not start from the given base")
def test_points_are_those_of_homogeneous_matrices(machine):
    joints, types, q = machine
    arm, wanted = Arm.from_urdf(text_of(joints)), by_hand(joints, q)
    assert arm.joint_types == types
    slides = np.array(list(types)) == "P"
    assert_allclose(arm.limits, np.where(slides[:, None], [-1500, 2000], [-1.5, 2]))
    # A table whose first axis is not across x has a base frame of its own.
    first = next(joint for joint in joints if joint[0] != F)
    own = abs((Rotation.from_euler("xyz", first[2]).apply(first[3]))[0]) > 1e-12
    found = arm.forward(q)
    assert_allclose(in_same_frame(found, wanted) if own else found, wanted, atol=1e-9, rtol=0)
    # Written as a file of its own, as JSON, and into the same file.
    for again in (Arm.from_urdf(arm.to_urdf()), Arm.from_json(arm.to_json())):
        assert_allclose(in_same_frame(again.forward(q), found), found, atol=1e-9, rtol=0)
        assert_allclose(again.limits, arm.limits)
    moved = arm.replace(d=arm.d + np.linspace(0.3, 0.1, len(types)), probe=arm.probe + 0.2)
    text = moved.update_urdf(text_of(joints))
    again = Arm.from_urdf(text, tip="probe" if 'name="probe"' in text else None)
    assert_allclose(
        in_same_frame(again.forward(q), moved.forward(q)), moved.forward(q), atol=1e-9, rtol=0
    )


@pytest.mark.filterwarnings("ignore:The first axis does not start from the given base")
def test_the_jacobian_is_that_of_differences(machine):
    joints, _, q = machine
    arm = Arm.from_urdf(text_of(joints))
    arm = arm.replace(joint_signs=np.resize([1, -1], arm.n_joints))
    jacobian, step = arm.jacobian(q), 1e-6
    for j, unit in enumerate(np.eye(arm.n_joints)):
        slope = (arm.forward(q + step * unit) - arm.forward(q - step * unit)) / (2 * step)
        assert_allclose(jacobian[:, :, j], slope, atol=1e-5)


@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_joints_are_found_for_points_and_orientations(unit):
    arm = Arm.from_name("ur10_rail")
    q = arm.random_poses(10) * arm.by_type(1.0 if unit == "rad" else 180 / np.pi)
    points, turns = arm.forward(q, angle_unit=unit), arm.frames(q, angle_unit=unit)[:, -1, :, :3]
    for start in (None, q + 0.05):
        found = arm.angles_for(points, start, turns, angle_unit=unit)
        assert_allclose(arm.forward(found, angle_unit=unit), points, atol=1e-6)
        assert_allclose(arm.frames(found, angle_unit=unit)[:, -1, :, :3], turns, atol=1e-8)
        assert np.all((found[:, 0] >= 0) & (found[:, 0] <= 4000))


def test_what_slides_is_in_mm_whatever_the_unit_of_angles():
    arm, q = Arm.from_name("ur10_rail"), np.array([[1234.5, 10, -60, 80, -30, 20, 5]])
    points = arm.forward(q, angle_unit="deg")
    q[:, 1:] = np.deg2rad(q[:, 1:])
    assert_allclose(arm.forward(q), points, rtol=1e-15)
    x, y, z = Arm.from_name("ur10").forward(q[:, 1:])[0]
    assert_allclose(points[0], [x, z, 1234.5 - y], atol=1e-9)  # the rail's base lies on its side


def test_faults_have_one_sentence():
    arm = Arm.from_name("ur10_rail")
    with pytest.raises(ValueError, match="joint 1 slides, and is at nan mm in row 0"):
        arm.forward([[np.nan, 0, 0, 0, 0, 0, 0]])
    with Finding.numbered([2]), pytest.raises(ValueError, match="is at nan mm in row 2: "):
        arm.forward([[np.nan, 0, 0, 0, 0, 0, 0]])
    with pytest.raises(ValueError, match="a letter for each of 7 joints, R where it turns"):
        arm.replace(joint_types="PRR")
    with pytest.raises(ValueError, match="joints 2 and 1 one turns and the other slides"):
        arm.replace(couplings=[(2, 1, 1)])
    with pytest.raises(ValueError, match="joint 1 of the arm slides, and these features are angl"):
        PoseFeatures(arm).fit(arm.random_poses(5))


def test_an_arm_that_only_turns_is_the_same_with_its_types_or_without():
    arm = Arm.from_name("panda")
    again = arm.replace(joint_types="RRRRRRR")
    assert again == arm
    assert "joint_types" not in arm.to_json()


def test_slides_between_turns_that_lean_by_little_are_read():
    """By 1e-5 rad, of which the two turns are made parallel: it moves the probe by micrometres."""
    joints = [
        (R, (0, 0, 0.3), (0, 0, 0), Z),
        (P, (0.3, 0.1, 0.1), (1e-5, 0, 0), Z),
        (R, (0.2, -0.3, 0.1), (0, 1e-5, 0), Z),
        (F, (0.1, 0, 0.1), (0, 0, 0), None),
    ]
    with pytest.warns(UserWarning, match="are taken as parallel, which moves the probe by up to"):
        arm = Arm.from_urdf(text_of(joints))
    q = arm.random_poses(20)
    assert_allclose(arm.forward(q), by_hand(joints, q), atol=0.002)


def test_limits_without_a_number_are_none():
    arm = Arm.from_name("ur10")
    assert arm.replace(limits=[(None, None)] * 6) == arm.replace(limits=None)


def test_an_end_without_a_limit_stays_free_in_a_file():
    """The format wants two numbers: where there is none a slide has 100 m, the most it may have."""
    limits = [(0, np.inf), (-np.inf, 2), (-1, 1), (-np.inf, np.inf), (-np.inf, 500)]
    arm = Arm.from_degrees(
        [0, 0, 300, 0, 50], [0, -90, 0, 90, 0], [0, 0, 200, 80, 0], joint_types="PRRPP",
        probe=(10, 40, 60), limits=limits,
    )  # fmt: skip
    text = arm.to_urdf()
    for pair in ('"0.0" upper="100.0"', '"-628.0" upper="2.0"', '"-100.0" upper="0.5"'):
        assert f"<limit lower={pair}" in text
    again = Arm.from_urdf(text)
    assert_allclose(again.limits, limits)
    q = arm.random_poses(10)
    found = again.angles_for(arm.forward(q))
    assert np.all((found >= again.limits[:, 0]) & (found <= again.limits[:, 1]))
    free = Arm.from_urdf(arm.replace(limits=None).to_urdf())
    assert free.limits is None


def test_slides_that_are_sums_reach_as_far():
    limits = [(0, 3000), (0, 3000), (-3, 3), (-3, 3)]
    arm = Arm(
        [0, 0, 0, 300], [0, np.pi / 2, np.pi / 2, 0], [100, 0, 0, 0], joint_types="PPRR",
        couplings=[(2, 1, 1)], limits=limits, pose_frames=(1, 4), pose_joints=(1, 4),
    )  # fmt: skip
    farthest = np.linalg.norm(arm.forward([[3000, 3000, 0.2, 0.3]]))
    assert 9000 < farthest <= arm.reach_mm
    assert arm.replace(couplings=()).reach_mm == 6400
