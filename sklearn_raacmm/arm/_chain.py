"""Chains of moving joints in a robot's own files: URDF, and UR's calibration in YAML."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import math
import re
import xml.etree.ElementTree as ET
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

from sklearn_raacmm.arm._built_in import UR_NAMES
from sklearn_raacmm.arm._checks import MAX_LENGTH_MM
from sklearn_raacmm.utils import warn_user

MM_PER_M = 1000.0
# A number with so many decimals that is pi/2 (or pi/4) rounded is meant to be it.
_DECIMALS = {2: 2, 4: 4}
# With so many, a few units of the last decimal off is still meant to be it.
_MANY_DECIMALS, _LAST_UNITS = 6, 3
_BRANCHES_SHOWN = 6
# Descriptions of robots in other formats, by their outermost elements.
_OTHERS = {
    "mujoco": ", that of MuJoCo's MJCF: take the URDF that it was made of",
    "sdf": ", that of Gazebo's SDF: take the URDF that it was made of",
    "COLLADA": ", that of shapes: take the URDF that names them",
}
# Limits that are written where an arm has none: a hundred turns, in rad, and where an arm refuses
# a joint that slides, in m.
_FAR = {False: 628.0, True: MAX_LENGTH_MM / MM_PER_M}
# Digits of a rotation: the cosine of pi/2 is 0, so that parallel axes stay parallel.
_DIGITS = 15
# Cosines smaller than this are rounding.
_ROUNDING = 1e-12
# Cosine below which the shortest rotation between directions is one in two steps.
_OPPOSITE = -0.9
# Keys of Universal Robots' kinematics files and the joints that they belong to, as in the package
# ur_description: origins of joints about z, in m and rad.
_UR_PARTS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_UR_JOINTS: dict[str, str] = dict(zip(_UR_PARTS, UR_NAMES, strict=True))
_UR_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
# The link and the fixed joint by which a file of our own says how the arm stands: points are in the
# frame of the link behind them, as those of the arm that was written.
_WORLD, _MOUNT = "world", "mount"
_UR_FILE = re.compile(r"^kinematics:", re.MULTILINE)
_UR_LINE = re.compile(r"^(\s*)(\w+):[ \t]*([^#\s]*)(.*)$", re.MULTILINE)


class Joint(NamedTuple):
    """A joint of a chain; `axis` is None where it is fixed."""

    name: str
    origin: np.ndarray  # (4, 4): the joint's frame in that of its parent at zero, mm
    axis: np.ndarray | None
    limits: tuple
    child: str = ""  # the link behind it
    rounded: float = 0.0  # largest difference of an angle as it was meant from that written, rad
    slides: bool = False


def read_chain(source, base=None, tip=None):
    """Joints from base to tip of a URDF or of UR's kinematics, path or text.

    With those from the file's first link to the base if they are all fixed, else none; the robot's
    name, the file's text, and a name of the source for messages.
    """
    if not isinstance(source, str | PathLike):
        raise TypeError(f"source must be a path or the text of a URDF file, got {source!r:.60}.")
    is_text = isinstance(source, str) and bool(re.match(r"\s*<", source) or _UR_FILE.search(source))
    where = "the URDF text" if is_text else str(source)
    text: Any = source
    if not is_text:
        try:
            text = Path(source).read_text(encoding="utf-8-sig")
        except UnicodeDecodeError:
            raise ValueError(f"{source} is not UTF-8 text.") from None
    if _UR_FILE.search(text):
        if base or tip:
            raise ValueError(f"{where} holds the kinematics of a UR robot, which has no links.")
        return _ur_joints(text, where), [], "", text, where
    elements, name = _joints(text, where)
    chain, mount = _chain(elements, base, tip, where)
    if any(element.get("type") != "fixed" for element in mount):
        mount = []  # the base moves, and nobody knows where up is
    chain, mount = ([_joint(e, where) for e in part] for part in (chain, mount))
    return chain, mount, name, text, where


def _joints(text, where):
    """Joints of the file, as elements by name, and the robot's name."""
    # Entities can expand without end and name other files; no URDF needs them.
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError(f"{where} declares a document type or entities: such files are refused.")
    try:
        # Without the declaration, whose encoding is no longer that of the text.
        root = ET.fromstring(re.sub(r"^\s*<\?xml.*?\?>", "", text, flags=re.DOTALL))
    except ET.ParseError as error:
        raise ValueError(f"{where} is not valid XML: {error}.") from None
    if root.tag != "robot":
        other = _OTHERS.get(root.tag, "")
        raise ValueError(f"{where} is not a URDF: its outermost element is {root.tag!r}{other}.")
    joints = root.findall("joint")
    # Comments, and elements that are no joints, may hold what they like.
    parts = [part for joint in joints for part in joint.iter()]
    # Macros of joints would be missing; what is left of them in a link moves nothing.
    if any("xacro" in part.tag for part in [*root, *parts]) or any(
        "${" in value for part in parts for value in part.attrib.values()
    ):
        raise ValueError(f"{where} holds xacro macros: expand it first (xacro file.xacro).")
    for joint in joints:
        if joint.find("parent") is None or joint.find("child") is None:
            raise ValueError(f"{where}: joint {joint.get('name')!r} has no parent or no child.")
    if not joints:
        raise ValueError(f"{where} has no joints.")
    return joints, root.get("name", "")


def _chain(joints, base, tip, where):
    """Joints from base to tip, and those from the first link to the base."""
    by_child = {}
    for joint in joints:
        child = joint.find("child").get("link")
        if child in by_child:
            raise ValueError(f"{where}: link {child!r} has two parents.")
        by_child[child] = joint
    parents = {joint.find("parent").get("link") for joint in joints}
    tip = _one_of(sorted(set(by_child) - parents), tip, "tip", {*by_child}, where)
    roots = sorted(parents - set(by_child))
    first = [joint for joint in joints if joint.find("parent").get("link") in roots]
    if base is None and roots == [_WORLD] and [one.get("name") for one in first] == [_MOUNT]:
        base = first[0].find("child").get("link")
    base = _one_of(roots, base, "base", parents, where)
    chain, mount, link = [], [], tip
    while link != base:
        if link not in by_child or len(chain) > len(joints):
            raise ValueError(f"{where}: no chain leads from {base!r} to {tip!r}.")
        chain.append(by_child[link])
        link = chain[-1].find("parent").get("link")
    while link in by_child and len(mount) < len(joints):
        mount.append(by_child[link])
        link = mount[-1].find("parent").get("link")
    return chain[::-1], mount[::-1]


def _one_of(ends, given, what, links, where):
    if given in links:
        return given
    shown = ", ".join(ends[:_BRANCHES_SHOWN]) or "none"
    more = ", ..." if len(ends) > _BRANCHES_SHOWN else ""
    if given is not None:
        raise ValueError(
            f"{where} has no link {given!r} that could be the {what}; try {shown}{more}."
        )
    if len(ends) != 1:
        raise ValueError(
            f"{where} branches: it has {len(ends)} links that could be the {what} ({shown}{more}); "
            f"say which is the {what}."
        )
    return ends[0]


def _joint(element, where):
    """A joint as the file has it, in mm."""
    name, kind = element.get("name"), element.get("type")
    slides = kind == "prismatic"
    if not slides and kind not in ("revolute", "continuous", "fixed"):
        before, after = element.find("parent").get("link"), element.find("child").get("link")
        raise ValueError(
            f"{where}: joint {name!r} is {kind}; only joints that turn or slide are known. "
            f"base={after!r} begins behind it, tip={before!r} ends before it."
        )
    if element.find("mimic") is not None:
        raise ValueError(f"{where}: joint {name!r} mimics another; the arm has no such joints.")
    origin, zero = element.find("origin"), (0.0, 0.0, 0.0)
    xyz = _numbers(origin, "xyz", zero, name, where)
    rpy = _numbers(origin, "rpy", zero, name, where)
    written = "" if origin is None else origin.get("rpy", "")
    off = (abs(float(text) - angle) for text, angle in zip(written.split(), rpy, strict=False))
    axis, ends = None, (-np.inf, np.inf)
    if kind != "fixed":
        axis = np.array(_numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), name, where))
        if not np.linalg.norm(axis) > 0:
            raise ValueError(f"{where}: the axis of joint {name!r} has no direction.")
        axis = axis / np.linalg.norm(axis)
    limit = element.find("limit")
    if kind in ("revolute", "prismatic") and limit is not None:
        try:
            ends = tuple(float(limit.get(key, 0)) for key in ("lower", "upper"))
            ends = tuple(end if abs(end) < _FAR[slides] else end * np.inf for end in ends)
            ends = tuple(MM_PER_M * end for end in ends) if slides else ends
        except ValueError:
            raise ValueError(f"{where}: the limits of joint {name!r} are no numbers.") from None
    place, child = pose_of(MM_PER_M * np.array(xyz), rpy), element.find("child").get("link")
    return Joint(name, place, axis, ends, child, max(off, default=0.0), slides)


def rigid(turn, shift):
    """Pose (4, 4) of a rotation (3, 3) and a shift, mm."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = turn, shift
    return result


def pose_of(xyz, rpy):
    """Origin of a joint, from mm and rad."""
    turn = Rotation.from_euler("xyz", rpy).as_matrix()  # about the fixed axes, in this order
    return rigid(np.round(turn, _DIGITS), xyz)


def _ur_joints(text, where):
    values, part = {}, ""
    for _, key, value, _ in _UR_LINE.findall(text):
        part = key if not value else part
        values[part, key] = value
    joints = []
    for key, name in _UR_JOINTS.items():
        try:
            given = [values[key, one] for one in _UR_KEYS]
            xyz, rpy = [*map(float, given[:3])], [*map(_meant, given[3:])]
        except (KeyError, ValueError):
            raise ValueError(
                f"{where}: the joint {key!r} needs the numbers {', '.join(_UR_KEYS)}, one a line."
            ) from None
        place, off = pose_of(MM_PER_M * np.array(xyz), rpy), np.array(given[3:], dtype=float) - rpy
        rounded = float(np.abs(off).max())
        joints.append(Joint(name, place, np.eye(3)[2], (-np.inf, np.inf), rounded=rounded))
    return joints


def _numbers(element, key, default, name, where):
    text = None if element is None else element.get(key)
    if text is None:
        return default
    try:
        values = [_meant(part) if key == "rpy" else float(part) for part in text.split()]
    except ValueError:
        values = []
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError(f"{where}: joint {name!r}: {key}={text!r} must be three numbers.")
    return values


def _meant(text):
    """Angle as it was meant: "1.5708" is pi/2, which no file can hold in full."""
    value = float(text)
    match = re.fullmatch(r"[+-]?\d*\.(\d+)", text)
    for part, least in _DECIMALS.items():
        exact = round(value * part / math.pi) * math.pi / part
        if match and len(match[1]) >= least and value and exact:
            unit = 10.0 ** min(len(match[1]), 15)
            rounded, cut = round(abs(exact) * unit), math.floor(abs(exact) * unit)
            last = round(abs(value) * unit)
            # Half of a rounded pi, such as 1.570796325, is off by more than rounding.
            near = len(match[1]) >= _MANY_DECIMALS and abs(last - rounded) <= _LAST_UNITS
            if near or last in (rounded, cut):
                return exact
    return value


# -- writing --------------------------------------------------------------------------------------


def with_probe(text, parent, origin):
    """Text of a URDF with one more link at its end, "probe", fixed to a link at an origin, mm."""
    name = "probe"
    while f'"{name}"' in text:
        name += "_"
    xyz, _ = _xyz_rpy(origin)
    added = (
        f'  <link name="{name}"/>\n  <joint name="{name}_joint" type="fixed">\n'
        f"    <parent link={quoteattr(parent)}/>\n"
        f'    <child link="{name}"/>\n    <origin xyz="{xyz}"/>\n  </joint>\n'
    )
    whole, end, rest = text.rpartition("</robot>")
    return f"{whole}{added}{end}{rest}", name


def edited(text, origins):
    """Text of a file with other origins (4, 4), mm, of the joints named, and all else as it is."""
    if not text.lstrip().startswith("<"):
        return _edited_ur(text, origins)
    data, path, places = text.encode(), [], {}

    def start(tag, attributes):
        path.append((tag, attributes.get("name")))
        if [part[0] for part in path] in (["robot", "joint"], ["robot", "joint", "origin"]):
            places[path[1][1], tag] = parser.CurrentByteIndex

    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: path.pop()
    parser.Parse(data, True)
    changes = []
    for name, origin in origins.items():
        xyz, rpy = _xyz_rpy(origin)
        has_origin = (name, "origin") in places
        at = places[name, "origin" if has_origin else "joint"]
        tag = re.compile(rb"<(?:\"[^\"]*\"|'[^']*'|[^\"'>])*>").findall(data, at)[0].decode()
        if has_origin:
            rest = re.sub(
                r"\s(xyz|rpy)\s*=\s*(\"[^\"]*\"|'[^']*')", "", tag.removeprefix("<origin")
            )
            new = f'<origin xyz="{xyz}" rpy="{rpy}"{rest}'
        else:
            new = f'{tag}\n    <origin xyz="{xyz}" rpy="{rpy}"/>'
        changes.append((at, len(tag.encode()), new.encode()))
    for at, length, new in sorted(changes, reverse=True):
        data = data[:at] + new + data[at + length :]
    return data.decode()


def _edited_ur(text, origins):
    part = ""

    def line(match):
        nonlocal part
        indent, key, value, rest = match.groups()
        part = key if not value else part
        origin = origins.get(_UR_JOINTS.get(part))
        if not value or origin is None or key not in _UR_KEYS:
            return match[0]
        numbers = " ".join(_xyz_rpy(origin)).split()
        return f"{indent}{key}: {numbers[_UR_KEYS.index(key)]}{rest}"

    return _UR_LINE.sub(line, text)


def _xyz_rpy(origin):
    """Numbers of an origin in m and rad, to the last digit."""
    parts = origin[:3, 3] / MM_PER_M, _to_rpy(origin[:3, :3])
    return tuple(" ".join(repr(float(value)) for value in part) for part in parts)


def warn_of_losses(arm):
    """Say what a file leaves out: sums of angles, scales of slides, a base that turns."""
    if arm.up_frame:
        warn_user(
            f"A robot's own file has its first link stand still: it does not say that frame "
            f"{arm.up_frame} of this arm does, which is seen from a positioner."
        )
    if arm.couplings:
        sums = ", ".join(f"J{i} {'-+'[f > 0]} J{j}" for i, j, f in arm.couplings)
        warn_user(
            f"A robot's own file has no joints whose angles are sums: it takes the angles of the "
            f"joints themselves, {sums}, which whoever reads the file has to add."
        )
    scales = [i for i in range(arm.n_joints) if abs(arm.joint_signs[i]) != 1]
    if scales:
        said = ", ".join(f"J{i + 1} by {abs(arm.joint_signs[i]):.8g}" for i in scales)
        warn_user(
            "A robot's own file has no scale of a joint that slides: whoever reads the file has to "
            f"multiply {said}."
        )


def urdf_text(arm):
    """Text of an arm as URDF; see `Arm.to_urdf`."""
    warn_of_losses(arm)
    rows, before = [], np.eye(4)
    for i in range(arm.n_joints):
        link = pose_of((arm.a[i], 0, 0), (arm.alpha[i], 0, 0))
        if arm.convention == "standard":
            origin = before @ pose_of((0, 0, 0), (0, 0, arm.theta_offset[i]))
            before = pose_of((0, 0, arm.d[i]), (0, 0, 0)) @ link
        else:  # a rotation about z and a shift along it change places
            origin = link @ pose_of((0, 0, arm.d[i]), (0, 0, arm.theta_offset[i]))
        limits = arm.limits[i] if arm.limits is not None else (-np.inf, np.inf)
        name = arm.names[i] if arm.names else f"joint{i + 1}"
        kind, unit = ("prismatic", MM_PER_M) if arm.joint_types[i] == "P" else ("revolute", 1.0)
        rows.append((name, origin, kind, arm.joint_signs[i], np.divide(limits, unit)))
    rows.append(("probe_joint", before @ rigid(np.eye(3), arm.probe), "fixed", 0, ()))
    links = ["base_link", *(f"link{i + 1}" for i in range(arm.n_joints)), "probe"]
    if not arm.up_frame and arm.up.tolist() != [0, 0, 1]:  # the first link of a file stands upright
        mount = rigid(turn_between(arm.up, [0.0, 0.0, 1.0]), 0.0)
        rows, links = [(_MOUNT, mount, "fixed", 0, ()), *rows], [_WORLD, *links]
    lines = ['<?xml version="1.0" encoding="utf-8"?>', f"<robot name={quoteattr(arm.name)}>"]
    lines += [f'  <link name="{link}"/>' for link in links]
    for parent, child, (name, origin, kind, sign, limits) in zip(
        links, links[1:], rows, strict=False
    ):
        xyz, rpy = _xyz_rpy(origin)
        lines += [
            f'  <joint name={quoteattr(name)} type="{kind}">',
            f'    <parent link="{parent}"/>',
            f'    <child link="{child}"/>',
            f'    <origin xyz="{xyz}" rpy="{rpy}"/>',
            *([] if kind == "fixed" else [f'    <axis xyz="0 0 {sign:.0f}"/>']),
        ]
        if kind != "fixed":  # the format asks for effort and velocity, which nobody measured
            # Of a continuous joint some programs make two numbers: one without limits turns far.
            far = _FAR[kind == "prismatic"]
            low, high = map(float, np.clip(limits, -far, far))
            lines.append(f'    <limit lower="{low!r}" upper="{high!r}" effort="0" velocity="0"/>')
        lines.append("  </joint>")
    return "\n".join([*lines, "</robot>"]) + "\n"


def turn_between(first, second):
    """Shortest rotation (3, 3) that takes one unit vector to another."""
    # `Rotation.align_vectors` is off by a tenth where they are all but opposite.
    v, u = np.asarray(first), np.asarray(second)
    if u @ v < _OPPOSITE:  # half a turn on the way: about any axis across
        across = np.cross(v, np.eye(3)[np.argmin(np.abs(v))])
        across /= np.linalg.norm(across)
        return turn_between(across, u) @ turn_between(v, across)
    x, y, z = np.cross(v, u)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + u @ v)


def _to_rpy(rotation):
    """Angles about the fixed axes x, y, z; at a pitch of a right angle the roll is 0."""
    across = rotation[2, 1], rotation[2, 2]
    roll = math.atan2(*across) if math.hypot(*across) > _ROUNDING else 0.0
    s, c = math.sin(roll), math.cos(roll)
    pitch = math.atan2(-rotation[2, 0], s * rotation[2, 1] + c * rotation[2, 2])
    x, y = c * rotation[:2, 1] - s * rotation[:2, 2]
    return roll, pitch, math.atan2(-x, y)
