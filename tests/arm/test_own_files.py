"""A calibrated arm in the robot's own file: the same points in other libraries, nothing lost."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, calibrate
from sklearn_raacmm.datasets import make_single_point

# A robot as people draw them: axes along y and -z, fixed frames between, a gripper, meshes,
# comments, attributes in another order, a joint without origin, and one without limits.
ROBOT = """<?xml version="1.0" encoding="utf-8"?>
<!-- <joint name="j2"> in a comment is none; "ü" takes two bytes -->
<robot name="own">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="world"/><link name="base"/>
  <link name="l1"><visual><origin xyz="0 0 0.1" rpy="0 0 0"/>
    <geometry><mesh filename="package://own/l1.stl"/></geometry></visual></link>
  <link name="l2"/><link name="l3"/><link name="mid"/><link name="l4"/><link name="l5"/>
  <link name="l6"/><link name="flange"/><link name="ball"/><link name="finger"/>
  <joint name="foot" type="fixed"><parent link="world"/><child link="base"/>
    <origin xyz="0 0 0.02"/></joint>
  <joint name="waist" type="revolute"><parent link="base"/><child link="l1"/>
    <origin rpy="0 0 0" xyz="0 0 0.3"/><axis xyz="0 0 1"/>
    <limit lower="-2.9" upper="2.8" effort="300" velocity="2"/></joint>
  <joint name="shoulder" type="revolute"><parent link="l1"/><child link="l2"/>
    <origin xyz='0.15 0 0' rpy='0 1.5707963 0'/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="2" effort="300" velocity="2"/></joint>
  <joint name="elbow" type="revolute"><parent link="l2"/><child link="l3"/>
    <origin xyz="-0.7 0 0" rpy="0 0 0"></origin><axis xyz="0 -1 0"/>
    <limit lower="-1" upper="3" effort="300" velocity="2"/></joint>
  <joint name="mid" type="fixed"><parent link="l3"/><child link="mid"/>
    <origin xyz="0.001 0.002 0.003" rpy="0.01 -0.02 0.03"/></joint>
  <joint name="roll" type="continuous"><parent link="mid"/><child link="l4"/>
    <axis xyz="1 0 0"/></joint>
  <joint name="pitch" type="revolute"><parent link="l4"/><child link="l5"/>
    <origin xyz="0.6 0.01 0" rpy="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="50" velocity="2"/></joint>
  <joint name="yaw" type="revolute"><parent link="l5"/><child link="l6"/>
    <origin xyz="0.08 0 0" rpy="0 1.57079632679 0"/><axis xyz="0 0 -1"/>
    <limit lower="-6" upper="6" effort="50" velocity="2"/></joint>
  <joint name="to_flange" type="fixed"><parent link="l6"/><child link="flange"/></joint>
  <joint name="to_ball" type="fixed"><parent link="flange"/><child link="ball"/>
    <origin xyz="0.03 0 0.12" rpy="0 0 0.5"/></joint>
  <joint name="to_finger" type="prismatic"><parent link="flange"/><child link="finger"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.04" effort="1" velocity="1"/></joint>
</robot>
"""
ENDS = {"base": "world", "tip": "ball"}
NAMES = ("waist", "shoulder", "elbow", "roll", "pitch", "yaw")
# Kinematics of a UR5e in the form of the package ur_description; nominal lengths of the maker's
# article "DH parameters for calculations of kinematics and dynamics".
UR5E = """# of the robot in cell 3
kinematics:
  shoulder:
    x: 0
    y: 0
    z: 0.1625  # m
    roll: -0
    pitch: 0
    yaw: -0
""" + "".join(
    f"  {key}:\n" + "".join(f"    {k}: {v}\n" for k, v in zip(
        ("x", "y", "z", "roll", "pitch", "yaw"), values, strict=True))
    for key, values in {
        "upper_arm": (0, 0, 0, 1.570796327, 0, 0),
        "forearm": (-0.425, 0, 0, 0, 0, 0),
        "wrist_1": (-0.3922, 0, 0.1333, 0, 0, 0),
        "wrist_2": (0, -0.0997, 0, 1.570796327, 0, 0),
        "wrist_3": (0, 0.0996, 0, 1.570796326589793, 3.141592653589793, 3.141592653589793),
    }.items()
) + "  hash: calib_12788084448423163542\n"  # fmt: skip


@pytest.fixture(scope="module")
def angles():
    return np.random.default_rng(0).uniform(-2.5, 2.5, (30, 6))


def calibrated(arm, seed=0):
    """The arm with every number changed by what calibrations find."""
    rng = np.random.default_rng(seed)
    lengths, turns = (scale * rng.normal(size=(2, arm.n_joints)) for scale in (0.5, 5e-3))
    return arm.replace(
        a=arm.a + lengths[0], d=arm.d + lengths[1], alpha=arm.alpha + turns[0],
        theta_offset=arm.theta_offset + turns[1], probe=arm.probe + rng.normal(size=3),
    )  # fmt: skip


def test_names_and_limits_are_read_and_kept(tmp_path):
    arm = Arm.from_urdf(ROBOT, **ENDS)
    assert arm.names == NAMES
    assert arm.limits[0].tolist() == [-2.9, 2.8]
    assert arm.limits[3].tolist() == [-np.inf, np.inf]
    for again in (
        Arm.from_json(arm.to_json(tmp_path / "arm.json")),
        calibrated(arm),
        Arm.from_urdf(arm.to_urdf()),
    ):
        assert again.names == NAMES
        np.testing.assert_array_equal(again.limits, arm.limits)
    assert Arm.from_json(tmp_path / "arm.json") == arm
    assert arm.replace(limits=None) != arm
    assert not arm.limits.flags.writeable


def test_calibrate_keeps_them():
    data = make_single_point(n_positions=5, n_poses=10, random_state=0)
    names, limits = [f"A{i}" for i in range(1, 7)], [[-3, 3]] * 6
    arm = calibrate(
        data.nominal_arm.replace(names=names, limits=limits), data.data, data.groups
    ).arm
    assert arm.names == tuple(names)
    assert arm.limits.tolist() == limits


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"names": ["a"]}, "names must be 6 different names of joints, got"),
        ({"names": ["a", "a", "b", "c", "d", "e"]}, "names must be 6 different"),
        ({"names": "abcdef"}, "names must be 6 different"),
        ({"names": ["a", "b", "c", "d", "e", 3]}, "names must be 6 different"),
        ({"limits": [[0, 1]]}, r"limits must have shape \(6, 2\), got \(1, 2\)"),
        ({"limits": [[1, 0]] + [[0, 1]] * 5}, "limits of joint 1 must go from low to high"),
        ({"limits": [[0, 1]] * 5 + [[np.nan, 0]]}, "limits"),
    ],
)
def test_wrong_names_and_limits(changes, message):
    with pytest.raises(ValueError, match=message):
        Arm.from_name("aacmm6", **changes)


def test_the_file_has_the_calibrated_points_and_everything_else(angles, tmp_path):
    arm = calibrated(Arm.from_urdf(ROBOT, **ENDS))
    (tmp_path / "own.urdf").write_text(ROBOT, encoding="utf-8")
    text = arm.update_urdf(tmp_path / "own.urdf", tmp_path / "new.urdf", **ENDS)
    assert (tmp_path / "new.urdf").read_text(encoding="utf-8") == text
    again = Arm.from_urdf(text, **ENDS)
    np.testing.assert_allclose(again.forward(angles), arm.forward(angles), rtol=0, atol=1e-9)
    assert (again.names, again.limits.tolist()) == (arm.names, arm.limits.tolist())
    # But for the origins of the chain's moving joints and of the tip, the text is the same.
    moved = "|".join([*NAMES, "to_ball"])
    bare = re.compile(rf'(<joint name="(?:{moved})".*?</joint>)', re.DOTALL)
    parts, others = bare.split(text), bare.split(ROBOT)
    assert parts[::2] == others[::2]
    for new, old in zip(parts[1::2], others[1::2], strict=True):
        origin = re.compile(r"\s*<origin[^>]*?(/>|></origin>)")
        assert origin.sub("", new) == origin.sub("", old)
    # Links move by what calibrations find, so meshes stay where they were.
    for old, new in zip(origins_of(ROBOT), origins_of(text), strict=True):
        assert np.abs(new[0] - old[0]).max() < 0.02
        assert (new[1] * old[1].inv()).magnitude() < 0.05


def origins_of(text):
    """Shift in m and rotation of each joint of the file."""
    found = []
    for joint in ET.fromstring(text).findall("joint"):
        origin = joint.find("origin")
        xyz, rpy = (
            np.array(("" if origin is None else origin.get(key) or "").split() or [0, 0, 0], float)
            for key in ("xyz", "rpy")
        )
        found.append((xyz, Rotation.from_euler("xyz", rpy)))
    return found


def test_an_unchanged_arm_changes_nothing():
    text = Arm.from_urdf(ROBOT, **ENDS).update_urdf(ROBOT, **ENDS)
    for old, new in zip(origins_of(ROBOT), origins_of(text), strict=True):
        np.testing.assert_allclose(new[0], old[0], atol=1e-12)
        assert (new[1] * old[1].inv()).magnitude() < 1e-7  # "1.5707963" is pi/2


def test_the_text_has_the_points_by_its_own_words(angles):
    """Origins and turns one after the other, as the format says, without any table."""
    arm = calibrated(Arm.from_urdf(ROBOT, **ENDS), 1)
    text = arm.update_urdf(ROBOT, **ENDS)
    points = []
    for row in angles:
        place, turn, left = np.zeros(3), Rotation.identity(), iter(row)
        for joint, (xyz, rpy) in zip(
            ET.fromstring(text).findall("joint"), origins_of(text), strict=True
        ):
            if joint.get("type") == "prismatic":  # the finger, which is no part of the chain
                continue
            place, turn = place + turn.apply(xyz), turn * rpy
            if joint.get("type") != "fixed":
                axis = np.array(joint.find("axis").get("xyz").split(), float)
                turn = turn * Rotation.from_rotvec(next(left) * axis)
        points.append(place)
    np.testing.assert_allclose(points, arm.forward(angles) / 1000, rtol=0, atol=1e-9)


def test_kinematics_of_a_ur(angles, tmp_path):
    (tmp_path / "ur.yaml").write_text(UR5E)
    arm = Arm.from_urdf(tmp_path / "ur.yaml")
    assert arm.names == Arm.from_name("ur10").names
    table = Arm.from_name("ur5e")  # the maker's standard table, of the controller's base
    np.testing.assert_allclose(arm.forward(angles), table.forward(angles), rtol=0, atol=1e-9)
    other = calibrated(arm)
    other = other.replace(probe=(0, 0, other.probe[2]))  # a tool is no part of these files
    text = other.update_urdf(tmp_path / "ur.yaml", tmp_path / "new.yaml")
    again = Arm.from_urdf(text)
    np.testing.assert_allclose(again.forward(angles), other.forward(angles), rtol=0, atol=1e-9)
    for line in ("# of the robot in cell 3", "  # m", "  hash: calib_12788084448423163542"):
        assert line in text
    yaml = pytest.importorskip("yaml")
    assert list(yaml.safe_load(text)["kinematics"]) == list(yaml.safe_load(UR5E)["kinematics"])
    with pytest.raises(ValueError, match="the joint 'wrist_3' needs the numbers x, y, z, roll"):
        Arm.from_urdf(UR5E.replace("    y: 0.0996\n", ""))
    with pytest.raises(ValueError, match="kinematics of a UR robot, which has no links"):
        Arm.from_urdf(UR5E, tip="tool0")


def test_only_an_arm_of_the_file_is_written_back():
    arm = Arm.from_urdf(ROBOT, **ENDS)
    with pytest.raises(ValueError, match="only an arm that was read from this file"):
        Arm.from_name("panda").update_urdf(ROBOT, **ENDS)
    with pytest.raises(ValueError, match="axis of joint 'elbow' is another one in the arm"):
        arm.replace(alpha=arm.alpha + np.eye(6)[2]).update_urdf(ROBOT, **ENDS)
    short = {"base": "world", "tip": "l6"}
    wrist = Arm.from_urdf(ROBOT, **short)
    with pytest.raises(ValueError, match=r"probe is 1 mm beside the last axis, and no fixed joint"):
        wrist.replace(probe=wrist.probe + np.eye(3)[0]).update_urdf(ROBOT, **short)


# Axes and points on them at zero, m: of the packages abb_irb120_support and of the joint tables of
# explicit-robotics (iiwa); the flange last.
AXES = {
    "irb120": (
        [("z", 0, 0), ("y", 0, 0.29), ("y", 0, 0.56), ("x", 0, 0.63), ("y", 0.302, 0.63),
         ("x", 0, 0.63)],
        (0.374, 0, 0.63),
    ),
    "iiwa7": (
        [("z", 0, 0), ("y", 0, 0.34), ("z", 0, 0), ("-y", 0, 0.74), ("z", 0, 0), ("y", 0, 1.14),
         ("z", 0, 0)],
        (0, 0, 1.266),
    ),
    "iiwa14": (
        [("z", 0, 0), ("y", 0, 0.36), ("z", 0, 0), ("-y", 0, 0.78), ("z", 0, 0), ("y", 0, 1.18),
         ("z", 0, 0)],
        (0, 0, 1.306),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", AXES)
def test_built_in_arms_turn_about_the_makers_axes(name):
    """A product of rotations about the axes, from the last to the first, in place of a table."""
    axes, flange = AXES[name]
    arm = Arm.from_name(name)
    rows = np.random.default_rng(1).uniform(-2, 2, (20, len(axes)))
    points = []
    for row in rows:
        point = np.array(flange, float)
        for (axis, x, z), angle in reversed(list(zip(axes, row, strict=True))):
            unit = np.eye(3)["xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1)
            through = np.array([x, 0, z])
            point = through + Rotation.from_rotvec(angle * unit).apply(point - through)
        points.append(1000 * point)
    np.testing.assert_allclose(arm.forward(rows), points, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "reach"),
    [("ur3", 500), ("ur5", 850), ("ur10", 1300), ("ur3e", 500), ("ur5e", 850), ("ur10e", 1300),
     ("ur16e", 900)],
)  # fmt: skip
def test_ur_arms_reach_what_their_maker_says(name, reach):
    """The data sheet's reach is beyond the stretched arm's first wrist, and within d5 of it."""
    arm = Arm.from_name(name)
    stretched = -arm.a.sum()
    assert stretched < reach < np.hypot(stretched + arm.d[4], arm.d[3])
    assert arm.names == Arm.from_name("ur10").names
