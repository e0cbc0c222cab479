"""What robots' real files hold beside joints: small files of our own, their points by hand."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm
from sklearn_raacmm.utils import collected_findings

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
ANGLES = np.random.default_rng(0).uniform(-1, 2, (20, 2))
TURN, LIFT = ANGLES.T
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


def change(text, *pairs):
    for old, new in zip(pairs[::2], pairs[1::2], strict=True):
        assert old in text
        text = text.replace(old, new, 1)
    return text


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
    assert_allclose(arm.forward(ANGLES), BY_HAND, atol=1e-10)
    # The same as a file with a byte-order mark, and what is written into it keeps the comments.
    (tmp_path / "robot.urdf").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert Arm.from_urdf(tmp_path / "robot.urdf", **ends) == arm
    moved = arm.replace(d=arm.d + np.array([7, 0]))
    again = moved.update_urdf(tmp_path / "robot.urdf", **ends)
    assert again.count(COMMENT) == text.count(COMMENT)
    assert_allclose(
        Arm.from_urdf(again, **ends).forward(ANGLES) - BY_HAND, 20 * [[0, 0, 7]], atol=1e-9
    )


@pytest.mark.parametrize(
    ("angle", "off", "weight"), [("1.5708", "3.7e-06", "note"), ("1.57", "0.0008", "doubt")]
)
def test_rounding_of_angles_is_told_with_its_size(angle, off, weight):
    """The second joint is tilted: half a metre of arm times the difference, 2 um and 0.4 mm."""
    text = change(PLAIN, '<origin xyz="0.3 0 0"/>', f'<origin xyz="0.3 0 0" rpy="{angle} 0 0"/>')
    with collected_findings() as found:
        arm = Arm.from_urdf(text)
    assert np.isin(np.round(arm.alpha, 12), np.round([-np.pi, 0, np.pi], 12)).all()
    (finding,) = found
    assert finding.weight == weight
    said = re.search(r"by up to (\S+) rad, which moves the probe by up to (\S+) mm", finding.text)
    assert said[1] == off
    assert 500 < float(said[2]) / abs(np.pi / 2 - float(angle)) < 600
