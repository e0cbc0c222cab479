"""Robots' own files, read and written, against a kinematics of the format's own words."""

import math
import re
import warnings
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, calibrate
from sklearn_raacmm.utils import Finding

# Of "1.5708" in these files something is said, as of any that is meant to be a right angle.
pytestmark = pytest.mark.filterwarnings(r"ignore:.*which moves the probe by up to 0\.0")


def urdf(*joints, name="robot"):
    """URDF text of a chain of (name, type, xyz, rpy, axis)."""
    lines = [f'<?xml version="1.0"?>\n<robot name="{name}">', '<link name="l0"/>']
    for i, (joint, kind, xyz, rpy, axis) in enumerate(joints):
        lines.append(
            f'<link name="l{i + 1}"/><joint name="{joint}" type="{kind}"><parent link="l{i}"/>'
            f'<child link="l{i + 1}"/><origin xyz="{xyz}" rpy="{rpy}"/>'
            + (f'<axis xyz="{axis}"/>' if axis else "")
            + "</joint>"
        )
    return "\n".join([*lines, "</robot>"])


def read_origins(text):
    """Each joint of the file, its shift in m, and its angles about fixed axes."""
    for joint in ET.fromstring(text).findall("joint"):
        origin = joint.find("origin")
        parts = ("" if origin is None else origin.get(key) or "" for key in ("xyz", "rpy"))
        yield joint, *(np.array(part.split() or [0, 0, 0], float) for part in parts)


def forward(text, angles, right_angles=True):
    """Points of the last link: origin by xyz and rpy (fixed axes), then a turn about the axis."""
    points = []
    for row in angles:
        place, turn, left = np.zeros(3), Rotation.identity(), iter(row)
        for joint, xyz, rpy in read_origins(text):
            exact = np.round(rpy / (math.pi / 2)) * math.pi / 2
            rpy = np.where(np.abs(rpy - exact) < 1e-4, exact, rpy) if right_angles else rpy
            place = place + turn.apply(1000 * xyz)
            turn = turn * Rotation.from_euler("xyz", rpy)
            if joint.get("type") != "fixed":
                axis = joint.find("axis")
                axis = np.array(["1", "0", "0"] if axis is None else axis.get("xyz").split(), float)
                turn = turn * Rotation.from_rotvec(next(left) * axis / np.linalg.norm(axis))
        points.append(place)
    return np.array(points)


PANDA = urdf(
    ("j1", "revolute", "0 0 0.333", "0 0 0", "0 0 1"),
    ("j2", "revolute", "0 0 0", "-1.5708 0 0", "0 0 1"),
    ("j3", "revolute", "0 -0.316 0", "1.5708 0 0", "0 0 1"),
    ("j4", "revolute", "0.0825 0 0", "1.5708 0 0", "0 0 1"),
    ("j5", "revolute", "-0.0825 0.384 0", "-1.5708 0 0", "0 0 1"),
    ("j6", "revolute", "0 0 0", "1.5708 0 0", "0 0 1"),
    ("j7", "revolute", "0.088 0 0", "1.5708 0 0", "0 0 1"),
    ("j8", "fixed", "0 0 0.107", "0 0 0", ""),
    name="panda",
)
IIWA = urdf(
    ("base", "fixed", "0 0 0.01", "0 0 0.3", ""),
    ("a1", "revolute", "0 0 0.1475", "0 0 0", "0 0 1"),
    ("a2", "revolute", "0 -0.0105 0.1925", "1.570796326794897 0 3.141592653589793", "0 0 1"),
    ("a3", "revolute", "0 0.2075 -0.0105", "1.570796326794897 0 3.141592653589793", "0 0 1"),
    ("a4", "revolute", "0 0.0105 0.1925", "1.570796326794897 0 0", "0 0 1"),
    ("mid", "fixed", "0.001 0.002 0.003", "0.01 -0.02 0.03", ""),
    ("a5", "revolute", "0 0.2075 -0.0105", "-1.570796326794897 3.141592653589793 0", "0 0 -1"),
    ("a6", "revolute", "0 0 0.1925", "1.570796326794897 0 0", ""),
    ("a7", "revolute", "0 0.081 0", "-1.570796326794897 3.141592653589793 0", "0.1 0.2 0.9"),
    ("tool", "fixed", "0.02 -0.03 0.126", "0.5 0.6 0.7", ""),
)


@pytest.fixture(scope="module")
def angles():
    return np.random.default_rng(0).uniform(-2.5, 2.5, (40, 7))


def drawn_without_care():
    """Random frames: no axes cross, none are parallel, and the base is nobody's."""
    rng, joints = np.random.default_rng(3), [("j0", "revolute", "0 0 0", "0 0 0", "0 0 1")]
    for i in range(1, 6):
        numbers = rng.uniform(-0.5, 0.5, 3), rng.uniform(-3, 3, 3), rng.normal(size=3)
        joints.append((f"j{i}", "revolute", *(" ".join(map(str, three)) for three in numbers)))
    return urdf(*joints, ("tip", "fixed", "0.1 0.2 0.3", "1 2 3", ""))


FILES = {"panda": PANDA, "iiwa": IIWA, "without care": drawn_without_care()}


@pytest.mark.parametrize("text", FILES.values(), ids=FILES)
def test_points_are_those_of_the_file(text, angles):
    arm = Arm.from_urdf(text)
    q = angles[:, : arm.n_joints]
    assert_allclose(arm.forward(q), forward(text, q), rtol=0, atol=1e-9)
    assert max(np.abs(arm.a).max(), np.abs(arm.d).max()) < 2000  # no origin far away


def test_a_built_in_arm_is_this_file():
    panda = Arm.from_urdf(PANDA)
    assert panda.name == "panda"
    for field in ("a", "alpha", "d", "theta_offset", "probe"):
        expected = getattr(Arm.from_name("panda"), field)
        assert_allclose(getattr(panda, field), expected, atol=1e-9)


def test_a_base_beside_the_first_axis_is_warned_of(angles):
    text = urdf(
        ("j1", "revolute", "0.1 0.2 0.3", "0 0 0", "0 1 0.5"),
        ("j2", "revolute", "0 0.1 0.4", "1 0 0", "1 0 0"),
        ("tip", "fixed", "0 0 0.3", "0 0 0", ""),
    )
    with pytest.warns(UserWarning, match=r"own base has its z axis along.*mm\. Points differ"):
        arm = Arm.from_urdf(text)
    ours, theirs = arm.forward(angles[:, :2]), forward(text, angles[:, :2])
    # The same but for a rigid motion.
    turn = Rotation.align_vectors(theirs - theirs[0], ours - ours[0])[0]
    assert_allclose(turn.apply(ours - ours[0]), theirs - theirs[0], atol=1e-6)


def test_axes_that_are_all_but_parallel_stay_near(angles):
    """A tilt of 4e-6 that no rounding explains would put the common normal at 1e5 mm."""
    text = urdf(
        ("j1", "revolute", "0 0 0.1", "0 0 0", "0 0 1"),
        ("j2", "revolute", "0 0 0", "1.5708 0 0", "0 0 1"),
        ("j3", "revolute", "0.6 0.1 0.05", "0 0.000004 0", "0 0 1"),
        ("tip", "fixed", "0.5 0 0", "0 0 0", ""),
    )
    with pytest.warns(UserWarning, match=r"joints 2 and 3 are 4e-06 rad from parallel.*0.00"):
        arm = Arm.from_urdf(text)
    assert max(np.abs(arm.a).max(), np.abs(arm.d).max()) < 2000
    off = arm.forward(angles[:, :3]) - forward(text, angles[:, :3])
    assert np.abs(off).max() < 0.006


@pytest.mark.parametrize(
    ("written", "meant"),
    [("1.57", math.pi / 2), ("-1.5707963", -math.pi / 2), ("3.14159", math.pi),
     ("0.7854", math.pi / 4), ("0.79", 0.79), ("1.58", 1.58), ("1.571", math.pi / 2), ("1.5", 1.5),
     ("1.5709", 1.5709), ("0.0001", 0.0001)],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:.*angles of 1 joints are taken as the right")
def test_rounded_right_angles(written, meant):
    text = urdf(
        ("j1", "revolute", "0 0 0", "0 0 0", "0 0 1"),
        ("j2", "revolute", "0.5 0 0", f"{written} 0 0", "0 0 1"),
        ("tip", "fixed", "0.1 0.5 0.1", "0 0 0", ""),
    )
    assert Arm.from_urdf(text).alpha[1] == pytest.approx(meant, abs=1e-15)


@pytest.mark.parametrize("arm", ["aacmm6", "panda", "ur10"])
def test_written_and_read_again(arm, angles, tmp_path):
    arm = Arm.from_name(arm, probe=(1, 2, 3), joint_signs=-1)
    text = arm.to_urdf(tmp_path / "arm.urdf")
    assert (tmp_path / "arm.urdf").read_text(encoding="utf-8") == text
    q = angles[:, : arm.n_joints]
    assert_allclose(forward(text, q, False), arm.forward(q), rtol=0, atol=1e-9)
    again = Arm.from_urdf(tmp_path / "arm.urdf", base="base_link", tip="probe")
    assert_allclose(again.forward(q), arm.forward(q), rtol=0, atol=1e-9)


def change(text, *pairs):
    for old, new in zip(pairs[::2], pairs[1::2], strict=True):
        assert old in text
        text = text.replace(old, new, 1)
    return text


FORK = '<joint name="f" type="fixed"><parent link="l3"/><child link="finger"/></joint></robot>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (change(PANDA, 'name="j3" type="revolute"', 'name="j3" type="planar"'), "'j3' is planar"),
        (change(PANDA, "</robot>", FORK), r"2 links .* tip \(finger, l8\); say which is the tip"),
        (change(PANDA, "<robot", "<!DOCTYPE robot><robot"), "document type or entities"),
        (change(PANDA, "</robot>", ""), "not valid XML"),
        (change(PANDA, "0 0 0.333", "0 0 up"), r"joint 'j1': xyz='0 0 up' must be three numbers"),
        (change(PANDA, "0 0 0.333", "0 0 ${d}"), "holds xacro macros"),
        (change(PANDA, 'axis xyz="0 0 1"', 'axis xyz="0 0 0"'), "axis of joint 'j1' has no direc"),
        (change(PANDA, '<parent link="l0"/>', ""), "joint 'j1' has no parent"),
        (change(PANDA, '<child link="l8"/>', '<child link="l7"/>'), "link 'l7' has two parents"),
        (change(PANDA, '<axis xyz="0 0 1"/>', '<mimic joint="j2"/>'), "'j1' mimics another"),
        ("<sdf></sdf>", "not a URDF: its outermost element is 'sdf'"),
        ('<mujoco model="a"/>', "'mujoco', that of MuJoCo's MJCF: take the URDF"),
        ("<robot></robot>", "has no joints"),
        (urdf(("j", "revolute", "0 0 1", "0 0 0", "")), "has 1 moving joints"),
    ],
)
def test_what_is_no_such_arm_is_named(text, message):
    with pytest.raises(ValueError, match=message):
        Arm.from_urdf(text)


def test_a_part_of_a_branching_robot(angles):
    arm = Arm.from_urdf(change(PANDA, "</robot>", FORK), tip="l8")
    assert_allclose(arm.forward(angles), forward(PANDA, angles), rtol=0, atol=1e-9)
    for ends, message in (
        ({"tip": "l9"}, r"no link 'l9' that could be the tip; try l\d"),
        ({"tip": "l4", "base": "l9"}, "no link 'l9'"),
        ({"tip": "l2", "base": "l4"}, "no chain leads from 'l4' to 'l2'"),
    ):
        with pytest.raises(ValueError, match=message):
            Arm.from_urdf(PANDA, **ends)


def test_a_file_of_another_encoding(tmp_path):
    (tmp_path / "latin.urdf").write_bytes("<robot name='Müller'/>".encode("latin-1"))
    with pytest.raises(ValueError, match=r"latin\.urdf is not UTF-8 text"):
        Arm.from_urdf(tmp_path / "latin.urdf")


def test_arms_from_lengths():
    """Stretched at zero: the probe is at the sum of the lengths; joints turn what they should."""
    arm = Arm.from_lengths("2-2-2", 375, 750, 500, 100)
    straight = arm.forward([[0, 0, 0, 0, 0, 0.0]])[0]
    shoulder = np.array([0, 0, 375])
    assert np.linalg.norm(straight - shoulder) == pytest.approx(1350)
    rolled = arm.forward([[0, 0, 0.7, 0, 0.4, 0]])[0]  # rolls alone move nothing
    assert_allclose(rolled, straight, atol=1e-9)
    for elbow in (0.3, 1.2):
        bent = arm.forward([[0.5, 0.2, 0.9, elbow, 0.1, 0]])[0]
        cosines = math.sqrt(750**2 + 600**2 + 2 * 750 * 600 * math.cos(elbow))
        assert np.linalg.norm(bent - shoulder) == pytest.approx(cosines)
    seven = Arm.from_lengths("2-2-3", 375, 750, 500, 100, elbow_offset=5, name="mine")
    assert (seven.n_joints, seven.name) == (7, "mine")
    q = np.array([[0.5, 0.2, 0.9, 0.3, 0.1, 0.2, 0.0]])
    assert_allclose(seven.forward(q), seven.forward(q + np.eye(7)[[6]]), atol=1e-9)
    six = Arm.from_lengths("2-2-2", 375, 750, 500, 100, elbow_offset=5)
    assert_allclose(seven.forward(q), six.forward(q[:, :6]), atol=1e-9)
    with pytest.raises(ValueError, match="layout='3-2-2' is not one of '2-2-2', '2-2-3'"):
        Arm.from_lengths("3-2-2", 1, 1, 1, 1)


# -- a calibrated arm in the robot's own file: the same points, nothing lost -----------------------

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


def moved_by(text):
    """Largest shift in m, and largest turn in rad, of a joint of ROBOT in a new file."""
    old, new = ([*zip(*read_origins(file), strict=True)] for file in (ROBOT, text))
    turns = [Rotation.from_euler("xyz", np.array(rpy)) for *_, rpy in (old, new)]
    shift = np.abs(np.array(new[1]) - np.array(old[1])).max()
    return shift, (turns[1] * turns[0].inv()).magnitude().max()


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
        assert_array_equal(again.limits, arm.limits)
    assert Arm.from_json(tmp_path / "arm.json") == arm
    assert arm.replace(limits=None) != arm
    assert not arm.limits.flags.writeable


def test_calibrate_keeps_them(angles):
    arm = Arm.from_name("aacmm6", names=tuple("ABCDEF"), limits=[[-3, 3]] * 6)
    points = arm.forward(angles[:, :6]) + np.array([900.0, 0, 0])
    again = calibrate(arm, angles[:, :6], points=points, free=["probe"]).arm
    assert again.names == arm.names
    assert again.limits.tolist() == arm.limits.tolist()


def test_the_file_has_the_calibrated_points_and_everything_else(angles, tmp_path):
    arm = calibrated(Arm.from_urdf(ROBOT, **ENDS))
    (tmp_path / "own.urdf").write_text(ROBOT, encoding="utf-8")
    text = arm.update_urdf(tmp_path / "own.urdf", tmp_path / "new.urdf", **ENDS)
    assert (tmp_path / "new.urdf").read_text(encoding="utf-8") == text
    angles = angles[:, :6]
    chain = re.sub('<joint name="to_finger".*</joint>', "", text, flags=re.DOTALL)
    points = forward(chain, angles, False)
    assert_allclose(points, arm.forward(angles), rtol=0, atol=1e-9)
    again = Arm.from_urdf(text, **ENDS)
    assert_allclose(again.forward(angles), arm.forward(angles), rtol=0, atol=1e-9)
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
    shift, turn = moved_by(text)
    assert shift < 0.02
    assert turn < 0.05


def test_an_unchanged_arm_changes_nothing():
    text = Arm.from_urdf(ROBOT, **ENDS).update_urdf(ROBOT, **ENDS)
    shift, turn = moved_by(text)
    assert shift < 1e-12
    assert turn < 1e-7  # "1.5707963" is pi/2


def test_kinematics_of_a_ur(angles, tmp_path):
    angles = angles[:, :6]
    (tmp_path / "ur.yaml").write_text(UR5E)
    arm = Arm.from_urdf(tmp_path / "ur.yaml")
    assert arm.names == Arm.from_name("ur10").names
    table = Arm.from_name("ur5e")  # the maker's standard table, of the controller's base
    assert_allclose(arm.forward(angles), table.forward(angles), rtol=0, atol=1e-9)
    other = calibrated(arm)
    other = other.replace(probe=(0, 0, other.probe[2]))  # a tool is no part of these files
    text = other.update_urdf(tmp_path / "ur.yaml", tmp_path / "new.yaml")
    again = Arm.from_urdf(text)
    assert_allclose(again.forward(angles), other.forward(angles), rtol=0, atol=1e-9)
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
    message = "axis of joint 'elbow' is another one in the arm, which .* or from another base"
    with pytest.raises(ValueError, match=message):
        arm.replace(alpha=arm.alpha + np.eye(6)[2]).update_urdf(ROBOT, **ENDS)
    short, robot = {"base": "world", "tip": "l6"}, change(ROBOT, "<robot", '<!-- "probe" --><robot')
    wrist = Arm.from_urdf(robot, **short)
    with pytest.warns(UserWarning, match=r"probe is 1 mm beside the last axis: the link 'probe_'"):
        text = wrist.replace(probe=wrist.probe + np.eye(3)[0]).update_urdf(robot, **short)
    off = Arm.from_urdf(text, base="world", tip="probe_").forward([[0.1] * 6])
    assert_allclose(np.linalg.norm(off - wrist.forward([[0.1] * 6])), 1, atol=1e-9)


def of_iiwa(shoulder, elbow, wrist, flange):
    """From heights in m: rolls about the upright, and bends between them."""
    bends = [("y", 0, shoulder), ("-y", 0, elbow), ("y", 0, wrist)]
    return [("z", 0, 0), *(one for bend in bends for one in (bend, ("z", 0, 0)))], (0, 0, flange)


# Axes and points on them at zero, m: of the packages abb_irb120_support and of the joint tables of
# explicit-robotics (iiwa); the flange last.
AXES = {
    "irb120": (
        [("z", 0, 0), ("y", 0, 0.29), ("y", 0, 0.56), ("x", 0, 0.63), ("y", 0.302, 0.63),
         ("x", 0, 0.63)],
        (0.374, 0, 0.63),
    ),
    "iiwa7": of_iiwa(0.34, 0.74, 1.14, 1.266),
    "iiwa14": of_iiwa(0.36, 0.78, 1.18, 1.306),
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
    assert_allclose(arm.forward(rows), points, rtol=0, atol=1e-9)


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


# -- the vertical: the z axis of the file's first link ---------------------------------------------


def mounted(*rpys):
    """The Panda on fixed mounts above each other, and the joints' own zero."""
    mounts = [(f"m{i}", "fixed", "0.1 0 0.2", rpy, "") for i, rpy in enumerate(rpys)]
    joints = [
        ("j1", "revolute", "0 0 0.333", "0 0 0", "0 0 1"),
        ("j2", "revolute", "0 0 0", "-1.5708 0 0", "0 0 1"),
        ("j3", "revolute", "0.1 -0.316 0", "1.5708 0 0", "0 0 1"),
        ("tool", "fixed", "0 0 0.107", "0 0 0", ""),
    ]
    return urdf(*mounts, *joints)


@pytest.mark.parametrize("rpys", [("1.5708 0 0",), ("0 -0.8 0.3", "3.1 0.2 -0.7"), ("0 0 0",)])
def test_heights_are_those_of_the_file(rpys, angles):
    """However the base is called, up and points say the same height above the file's first link."""
    text, q = mounted(*rpys), angles[:, :3]
    heights = forward(text, q)[:, 2]
    for base in ("l0", f"l{len(rpys)}"):
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "The first axis does not start")
            arm = Arm.from_urdf(text, base=base)
        assert_allclose(np.ptp(arm.forward(q) @ arm.up - heights), 0, atol=1e-9)


def test_up_is_written_and_read(angles):
    base, text = "base_link", Arm.from_name("panda", up=(1, 2, -3)).to_urdf()
    arm = Arm.from_urdf(text, base=base)
    assert_allclose(arm.up, np.array([1, 2, -3]) / np.sqrt(14), atol=1e-12)
    assert_allclose(arm.forward(angles), Arm.from_name("panda").forward(angles), atol=1e-9)
    for up in ((0, 0, 1), (-1, -2, 3), (0.1, 0, 0.9)):  # the second is the opposite
        again = Arm.from_urdf(arm.replace(up=up).update_urdf(text, base=base), base=base)
        assert_allclose(again.up, np.array(up) / np.linalg.norm(up), atol=1e-12)
        assert_allclose(again.forward(angles), arm.forward(angles), atol=1e-9)
    assert "world" not in Arm.from_name("panda").to_urdf()


@pytest.mark.parametrize("up", [(0, 0, -1), (1, 0, 0), (1, 2, -3)])
@pytest.mark.filterwarnings("ignore:The first axis does not start")
def test_an_arm_that_hangs_stands_where_it_stood(up, angles):
    """Its own file is read from the base that it has, without being told."""
    arm = Arm.from_name("panda", up=up)
    again = Arm.from_urdf(arm.to_urdf())
    assert_allclose(again.up, arm.up, atol=1e-12)
    assert_allclose(again.forward(angles), arm.forward(angles), atol=1e-9)
    room = Arm.from_urdf(arm.to_urdf(), base="world")
    assert_allclose(
        np.ptp(room.forward(angles) @ room.up - arm.forward(angles) @ arm.up), 0, atol=1e-9
    )


@pytest.mark.filterwarnings("ignore:.*which moves the probe by up to")
def test_a_file_is_written_with_the_right_angles_of_the_arm():
    """Other programs read what stands there: rounded angles of fixed joints, too, are replaced."""
    text = urdf(
        ("j1", "revolute", "0 0 0.3", "0 0 0", "0 0 1"),
        ("turned", "fixed", "0 0 0.1", "1.5708 0 0", ""),
        ("j2", "revolute", "0.2 0 0", "0 -1.57079 0", "0 0 1"),
        ("tool", "fixed", "0 0.1 0.9", "0 0 3.1416", ""),
    )
    arm, q = Arm.from_urdf(text), POSES
    assert np.abs(forward(text, q, False) - arm.forward(q)).max() > 0.003
    assert_allclose(forward(arm.update_urdf(text), q, False), arm.forward(q), atol=1e-9)


def test_a_file_without_a_mount_says_nothing_of_another_up():
    arm = Arm.from_urdf(PANDA)
    with pytest.warns(UserWarning, match="no fixed joint above the base could say that up is"):
        arm.replace(up=(1, 0, 0)).update_urdf(PANDA)


def test_a_base_that_moves_has_no_vertical():
    text = change(mounted("1.5708 0 0"), '"m0" type="fixed"', '"m0" type="revolute"')
    assert Arm.from_urdf(text, base="l1").up.tolist() == [0, 0, 1]


# -- what robots' real files hold beside joints: small files of our own, their points by hand ------

# Two joints, z then -y, 100 mm up, links of 300 and 200 mm: the points are written out below.
PLAIN = """<?xml version="1.0" encoding="utf-8"?>
<robot name="two">
  <link name="foot"/> <link name="upper"/> <link name="lower"/> <link name="hand"/>
  <joint name="turn" type="continuous">
    <origin xyz="0 0 0.1"/> <parent link="foot"/> <child link="upper"/> <axis xyz="0 0 1"/>
  </joint>
  <joint name="lift" type="revolute">
    <origin xyz="0.3 0 0"/> <parent link="upper"/> <child link="lower"/> <axis xyz="0 -1 0"/>
    <limit lower="-1" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="end" type="fixed">
    <origin xyz="0.2 0 0"/> <parent link="lower"/> <child link="hand"/>
  </joint>
</robot>
"""
POSES = np.random.default_rng(0).uniform(-1, 2, (20, 2))
TURN, LIFT = POSES.T
OUT = 300 + 200 * np.cos(LIFT)
BY_HAND = np.column_stack([OUT * np.cos(TURN), OUT * np.sin(TURN), 100 + 200 * np.sin(LIFT)])
COMMENT = '<!-- <xacro:arm d="${d}"/> made of $(find xarm)/urdf/xarm.xacro, ${pi/2}, "1.57" -->'
FINGER = """  <link name="finger"/> <link name="thumb"/>
  <joint name="close" type="prismatic"><parent link="hand"/><child link="finger"/></joint>
  <joint name="thumb" type="prismatic"><parent link="hand"/><child link="thumb"/>
    <mimic joint="close"/></joint>
</robot>"""
RAIL = """  <link name="hall"/>
  <joint name="rail" type="prismatic"><parent link="hall"/><child link="foot"/></joint>
</robot>"""
MESH = """<link name="lower">
  <visual><geometry><mesh filename="${here}/a.stl"/></geometry></visual></link>"""
GAZEBO = '<gazebo><plugin name="${p}"/></gazebo></robot>'
PREFIX = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name'


@pytest.mark.parametrize(
    ("text", "ends"),
    [
        (PLAIN, {}),
        (change(PLAIN, "<link", COMMENT + "<link", "</joint>", COMMENT + "</joint>"), {}),
        (change(PLAIN, "<robot name", COMMENT + PREFIX, '<link name="lower"/>', MESH), {}),
        (change(PLAIN, "</robot>", GAZEBO), {}),
        (change(PLAIN, "</robot>", FINGER), {"tip": "hand"}),
        (change(PLAIN, "</robot>", RAIL), {"base": "foot"}),
        (change(PLAIN, "<joint", "\r\n<joint").replace('"', "'"), {}),
    ],
    ids=["plain", "comments", "prefix and mesh", "gazebo", "fingers", "behind a rail", "quotes"],
)
def test_points_are_those_by_hand(text, ends, tmp_path):
    arm = Arm.from_urdf(text, **ends)
    assert arm.names == ("turn", "lift")
    assert_allclose(arm.forward(POSES), BY_HAND, atol=1e-10)
    # The same as a file with a byte-order mark, and what is written into it keeps the comments.
    (tmp_path / "robot.urdf").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert Arm.from_urdf(tmp_path / "robot.urdf", **ends) == arm
    moved = arm.replace(d=arm.d + np.array([7, 0]))
    again = moved.update_urdf(tmp_path / "robot.urdf", **ends)
    assert again.count(COMMENT) == text.count(COMMENT)
    assert_allclose(
        Arm.from_urdf(again, **ends).forward(POSES) - BY_HAND, 20 * [[0, 0, 7]], atol=1e-9
    )


@pytest.mark.parametrize(
    ("angle", "off", "weight"),
    [("1.570796", "3.3e-07", "note"), ("1.5708", "3.7e-06", "doubt"), ("1.57", "0.0008", "doubt")],
)
def test_rounding_of_angles_is_told_with_its_size(angle, off, weight):
    """The second joint is tilted: half a metre of arm times the difference: .2 um, 2 um, .4 mm."""
    text = change(PLAIN, '<origin xyz="0.3 0 0"/>', f'<origin xyz="0.3 0 0" rpy="{angle} 0 0"/>')
    with Finding.collected() as found:
        arm = Arm.from_urdf(text)
    assert np.isin(np.round(arm.alpha, 12), np.round([-np.pi, 0, np.pi], 12)).all()
    (finding,) = found
    assert finding.weight == weight
    said = re.search(r"by up to (\S+) rad, which moves the probe by up to (\S+) mm", finding.text)
    assert said[1] == off
    assert 500 < float(said[2]) / abs(np.pi / 2 - float(angle)) < 600


def test_a_macro_left_over_in_a_link_moves_nothing():
    text, space = Arm.from_name("ur10").to_urdf(), 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
    material = f"<visual><material><xacro:color {space}/></material></visual>"
    left = text.replace('<link name="link1"/>', f'<link name="link1">{material}</link>')
    assert left != text
    assert Arm.from_urdf(left) == Arm.from_urdf(text)
    with pytest.raises(ValueError, match="holds xacro macros"):
        Arm.from_urdf(text.replace("</robot>", f"<xacro:arm {space}/></robot>"))


def test_without_limits_a_joint_is_one_number_all_the_same():
    """Of a continuous joint some programs make two numbers, a cosine and a sine."""
    free = Arm.from_name("aacmm6").replace(limits=None)
    text = free.to_urdf()
    assert "continuous" not in text
    assert text.count('type="revolute"') == 6
    assert Arm.from_urdf(text).limits is None
    limits = np.tile([-2 * np.pi, 2 * np.pi], (6, 1))
    np.testing.assert_allclose(
        Arm.from_urdf(free.replace(limits=limits).to_urdf()).limits, limits, atol=1e-12
    )


def test_a_small_table_in_degrees_is_an_arm():
    arm = Arm.from_degrees([0, 0], [90, 0], [500, 120])
    np.testing.assert_allclose(arm.forward([[0.0, 0.0]]), [[0, -120, 500]], atol=1e-9)
    assert arm.pose_joints == (1, 2)
