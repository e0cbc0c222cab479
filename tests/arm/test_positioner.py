"""Arms that are seen from a positioner, a table of one or two joints that carries the part."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm, PoseFeatures
from sklearn_raacmm.error_model._columns import Terms, columns_of

TABLES = {
    "tilts and turns": Arm.from_degrees(
        [0, 0], [-90, 90], [0, 300], convention="modified", probe=(0, 0, 50), joint_signs=[1, -1],
        limits=[(-2, 2), (None, 3)],
    ),
    "turns": Arm.from_degrees([0], [0], [700], probe=(0, 0, 20)),
    "turns on a lift": Arm.from_degrees(
        [0, 0], [0, 0], [100, 200], joint_types="PR", joint_signs=[1.0002, 1],
    ),
    "turns with its tilt": Arm.from_degrees([0, 0], [90, 0], [400, 200], couplings=[(2, 1, 1)]),
}  # fmt: skip
COS, SIN = np.cos(2.0), np.sin(2.0)
BASE = np.array([[COS, -SIN, 0, 1500], [SIN, COS, 0, 300], [0, 0, 1, -100], [0, 0, 0, 1]])


@pytest.fixture(params=["ur10", "panda", "irb120", "ur10_rail"])
def robot(request):
    robot = Arm.from_name(request.param)
    return robot.replace(probe=np.add(robot.probe, [10, 20, 30]))


@pytest.fixture(params=[*TABLES])
def table(request):
    return TABLES[request.param]


def test_points_and_the_vertical_are_those_of_homogeneous_matrices(robot, table, matrices):
    arm, m = robot.seen_from(table, BASE), table.n_joints
    q, e = robot.random_poses(40), table.random_poses(40, np.random.default_rng(1))
    both = np.hstack([e[:, ::-1], q])
    base = np.linalg.inv(matrices.ends(table, e)) @ BASE
    assert_allclose(
        arm.forward(both), (base @ matrices.ends(robot, q))[:, :3, 3], atol=1e-9, rtol=0
    )
    upright = arm.frames(both)[:, arm.up_frame, :, :3] @ arm.up
    assert_allclose(upright, base[:, :3, :3] @ robot.up, atol=1e-12)
    assert Arm.from_json(arm.to_json()) == arm
    assert arm.names[:m] == ("E2", "E1")[2 - m :]
    assert arm.joint_types == table.joint_types[::-1] + robot.joint_types
    limits = [one.limits for one in (table, robot)]
    if all(one is not None for one in limits):
        assert_allclose(arm.limits, [*limits[0][::-1], *limits[1]])


def test_gravity_bends_the_arm_as_without_a_positioner(robot, table, matrices):
    """What a load does to the arm is the same, whatever it is seen from."""
    robot = robot.replace(up=[0.1, 0.2, 1]) if robot.name == "panda" else robot
    if robot.convention == "standard":  # whose frames have other numbers
        robot = Arm.from_urdf(robot.replace(up=(0, 0, 1), limits=None).to_urdf())
    arm, m, terms = robot.seen_from(table, BASE), table.n_joints, (True, False, False)
    alone, seen = (columns_of(one, Terms(np.empty((0, 2), int), *terms)) for one in (robot, arm))
    q, e = robot.random_poses(10), table.random_poses(10, np.random.default_rng(1))
    turn = (np.linalg.inv(matrices.ends(table, e)) @ BASE)[:, :3, :3]
    own = turn @ alone.at(q) / alone.table["unit"]
    found = seen.at(np.hstack([e[:, ::-1], q])) / seen.table["unit"]
    assert len(alone.names) == len(seen.names)
    for i, name in enumerate(alone.names):
        if "frame 0" not in name:  # the base, whose frame lies elsewhere
            number = re.sub(r"frame (\d+)", lambda k: f"frame {int(k[1]) + m}", name)
            at = seen.names.index(number)
            assert_allclose(found[:, :, at], own[:, :, i], atol=1e-9 * np.abs(own).max(), rtol=0)


def test_axes_that_are_all_but_parallel_are_taken_as_such(matrices):
    """And the probe moves by no more than the warning says."""
    robot, table = Arm.from_name("ur10"), TABLES["turns"]
    leaning = matrices.pose([0, 1e-3, 0], [900, 0, 0])
    with pytest.warns(UserWarning, match="joints 1 and 2 are 0.001 rad from parallel") as caught:
        arm = robot.seen_from(table, leaning)
    q, e = robot.random_poses(40), table.random_poses(40, np.random.default_rng(1))
    wanted = (np.linalg.inv(matrices.ends(table, e)) @ leaning @ matrices.ends(robot, q))[:, :3, 3]
    off = np.linalg.norm(arm.forward(np.hstack([e, q])) - wanted, axis=1).max()
    stated = float(re.search(r"by up to (\S+) mm", str(caught[0].message))[1])
    assert 0.1 * stated < off < stated


def test_a_file_of_the_robot_says_that_something_is_lost():
    """The chain of joints is there, but not what stands still."""
    robot = Arm.from_name("panda")
    arm = robot.seen_from(TABLES["turns"], BASE)
    with pytest.warns(UserWarning, match="frame 1 of this arm does, which is seen from a positi"):
        again = Arm.from_urdf(arm.to_urdf())
    q = arm.random_poses(20)
    assert_allclose(again.forward(q), arm.forward(q), atol=1e-9)


def test_faults_have_one_sentence():
    robot, table = Arm.from_name("panda"), TABLES["tilts and turns"]
    arm = robot.seen_from(table, BASE)
    with pytest.raises(ValueError, match=r"base must be the pose of the arm's base in that of th"):
        robot.seen_from(table, np.diag([1, 1, -1, 1]))
    with pytest.raises(ValueError, match=r"base must be the pose of the arm's base in that of th"):
        robot.seen_from(table, BASE[:3])
    with pytest.raises(ValueError, match="cannot be seen from another one"):
        arm.seen_from(table, BASE)
    with pytest.raises(TypeError, match="arm must be an Arm"):
        robot.seen_from("table", BASE)
    with pytest.raises(ValueError, match="up_frame == 8, must be <= 7"):
        robot.replace(up_frame=8)
    with pytest.raises(ValueError, match=r"in frame 2, which is not along the base axis"):
        PoseFeatures(arm).fit(arm.random_poses(5))
