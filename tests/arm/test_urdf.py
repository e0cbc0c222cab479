"""URDF files against a forward kinematics written from the format's own words; usual layouts."""

import math
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm


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


def forward(text, angles, right_angles=True):
    """Points of the last link: origin by xyz and rpy (fixed axes), then a turn about the axis."""
    points = []
    for row in angles:
        left = iter(row)
        pose = np.eye(4)
        for joint in ET.fromstring(text).findall("joint"):
            origin, axis = joint.find("origin"), joint.find("axis")
            step = np.eye(4)
            step[:3, 3] = [1000 * float(v) for v in origin.get("xyz").split()]
            rpy = [float(v) for v in origin.get("rpy").split()]
            if right_angles:
                exact = [round(v / (math.pi / 2)) * math.pi / 2 for v in rpy]
                rpy = [e if abs(v - e) < 1e-4 else v for v, e in zip(rpy, exact, strict=True)]
            step[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
            pose = pose @ step
            if joint.get("type") != "fixed":
                unit = np.array([1.0, 0, 0])
                if axis is not None:
                    unit = np.array([float(v) for v in axis.get("xyz").split()])
                turn = np.eye(4)
                turn[:3, :3] = Rotation.from_rotvec(
                    next(left) * unit / np.linalg.norm(unit)
                ).as_matrix()
                pose = pose @ turn
        points.append(pose[:3, 3])
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
UR10 = urdf(
    ("shoulder_pan", "revolute", "0 0 0.1273", "0 0 0", "0 0 1"),
    ("shoulder_lift", "revolute", "0 0.220941 0", "0 1.570796325 0", "0 1 0"),
    ("elbow", "revolute", "0 -0.1719 0.612", "0 0 0", "0 1 0"),
    ("wrist_1", "revolute", "0 0 0.5723", "0 1.570796325 0", "0 1 0"),
    ("wrist_2", "continuous", "0 0.1149 0", "0 0 0", "0 0 1"),
    ("wrist_3", "revolute", "0 0 0.1157", "0 0 0", "0 1 0"),
    ("ee_fixed", "fixed", "0 0.0922 0", "0 0 1.570796325", ""),
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


@pytest.mark.parametrize("text", [PANDA, UR10, IIWA], ids=["panda", "ur10", "iiwa"])
def test_points_are_those_of_the_file(text, angles):
    arm = Arm.from_urdf(text)
    q = angles[:, : arm.n_joints]
    np.testing.assert_allclose(arm.forward(q), forward(text, q), rtol=0, atol=1e-9)
    assert max(np.abs(arm.a).max(), np.abs(arm.d).max()) < 2000  # no origin far away


def test_built_in_arms_are_these_files(angles):
    panda = Arm.from_urdf(PANDA)
    assert panda.name == "panda"
    for field in ("a", "alpha", "d", "theta_offset", "probe"):
        expected = getattr(Arm.from_name("panda"), field)
        np.testing.assert_allclose(getattr(panda, field), expected, atol=1e-9)
    # The UR10's file has another zero and counts the tool's frame otherwise: distances agree.
    ur10, built_in = Arm.from_urdf(UR10), Arm.from_name("ur10")
    assert (ur10.pose_joints, ur10.pose_frames) == ((4, 3), (2, 4))
    np.testing.assert_allclose(np.abs(ur10.a[[2, 3]]), np.abs(built_in.a[[1, 2]]), atol=1e-9)


def test_a_robot_drawn_without_care(angles):
    """Random frames: no axes cross, none are parallel, and the base is nobody's."""
    rng = np.random.default_rng(3)
    joints = [
        (
            f"j{i}",
            "revolute",
            " ".join(map(str, rng.uniform(-0.5, 0.5, 3) * (i > 0))),
            " ".join(map(str, rng.uniform(-3, 3, 3) * (i > 0))),
            " ".join(map(str, rng.normal(size=3))) if i else "0 0 1",
        )
        for i in range(6)
    ]
    text = urdf(*joints, ("tip", "fixed", "0.1 0.2 0.3", "1 2 3", ""))
    arm = Arm.from_urdf(text)
    np.testing.assert_allclose(
        arm.forward(angles[:, :6]), forward(text, angles[:, :6]), rtol=0, atol=1e-9
    )


def test_a_base_beside_the_first_axis_is_said(angles):
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
    np.testing.assert_allclose(turn.apply(ours - ours[0]), theirs - theirs[0], atol=1e-6)


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
    [
        ("1.57", math.pi / 2),
        ("-1.5707963", -math.pi / 2),
        ("3.14159", math.pi),
        ("0.7854", math.pi / 4),
        ("0.79", 0.79),
        ("1.58", 1.58),
        ("1.571", math.pi / 2),
        ("1.5", 1.5),
        ("1.5709", 1.5709),
        ("0.0001", 0.0001),
    ],
)
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
    np.testing.assert_allclose(forward(text, q, False), arm.forward(q), rtol=0, atol=1e-9)
    again = Arm.from_urdf(tmp_path / "arm.urdf", base="base_link", tip="probe")
    np.testing.assert_allclose(again.forward(q), arm.forward(q), rtol=0, atol=1e-9)


def change(text, old, new):
    assert old in text
    return text.replace(old, new, 1)


FORK = '<joint name="f" type="fixed"><parent link="l3"/><child link="finger"/></joint></robot>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (change(PANDA, 'name="j3" type="revolute"', 'name="j3" type="prismatic"'), "'j3' is prism"),
        (
            change(PANDA, "</robot>", FORK),
            r"branches: it has 2 links .* tip \(finger, l8\); say which is the tip",
        ),
        (change(PANDA, "<robot", "<!DOCTYPE robot><robot"), "document type or entities"),
        (change(PANDA, "</robot>", ""), "not valid XML"),
        (change(PANDA, "0 0 0.333", "0 0 up"), r"joint 'j1': xyz='0 0 up' must be three numbers"),
        (change(PANDA, "0 0 0.333", "0 0 ${d}"), "holds xacro macros"),
        (change(PANDA, 'axis xyz="0 0 1"', 'axis xyz="0 0 0"'), "axis of joint 'j1' has no direc"),
        (change(PANDA, '<parent link="l0"/>', ""), "joint 'j1' has no parent"),
        (change(PANDA, '<child link="l8"/>', '<child link="l7"/>'), "link 'l7' has two parents"),
        (change(PANDA, '<axis xyz="0 0 1"/>', '<mimic joint="j2"/>'), "'j1' mimics another"),
        ("<sdf></sdf>", "not a URDF: its outermost element is 'sdf'"),
        ("<robot></robot>", "has no joints"),
        (urdf(("j", "revolute", "0 0 1", "0 0 0", "")), "has 1 revolute joints"),
    ],
)
def test_what_is_no_such_arm_is_named(text, message):
    with pytest.raises(ValueError, match=message):
        Arm.from_urdf(text)


def test_a_part_of_a_branching_robot(angles):
    arm = Arm.from_urdf(change(PANDA, "</robot>", FORK), tip="l8")
    np.testing.assert_allclose(arm.forward(angles), forward(PANDA, angles), rtol=0, atol=1e-9)
    for ends in ({"tip": "l9"}, {"tip": "l4", "base": "l9"}, {"tip": "l2", "base": "l4"}):
        with pytest.raises(ValueError, match=r"no link 'l9'|no chain leads from 'l4' to 'l2'"):
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
    np.testing.assert_allclose(rolled, straight, atol=1e-9)
    for elbow in (0.3, 1.2):
        bent = arm.forward([[0.5, 0.2, 0.9, elbow, 0.1, 0]])[0]
        cosines = math.sqrt(750**2 + 600**2 + 2 * 750 * 600 * math.cos(elbow))
        assert np.linalg.norm(bent - shoulder) == pytest.approx(cosines)
    seven = Arm.from_lengths("2-2-3", 375, 750, 500, 100, elbow_offset=5, name="mine")
    assert (seven.n_joints, seven.name) == (7, "mine")
    q = np.array([[0.5, 0.2, 0.9, 0.3, 0.1, 0.2, 0.0]])
    np.testing.assert_allclose(seven.forward(q), seven.forward(q + np.eye(7)[[6]]), atol=1e-9)
    six = Arm.from_lengths("2-2-2", 375, 750, 500, 100, elbow_offset=5)
    np.testing.assert_allclose(seven.forward(q), six.forward(q[:, :6]), atol=1e-9)
    with pytest.raises(
        ValueError, match=r"layout must be one of \['2-2-2', '2-2-3'\], got '3-2-2'"
    ):
        Arm.from_lengths("3-2-2", 1, 1, 1, 1)


@pytest.mark.parametrize("source", [None, 3, b"<robot/>", ["arm.urdf"], {}])
def test_what_is_no_path_and_no_text_gets_a_sentence(source):
    with pytest.raises(TypeError, match="source must be a path or the text of a URDF file, got"):
        Arm.from_urdf(source)
