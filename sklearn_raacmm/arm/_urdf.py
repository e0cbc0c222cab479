"""Chains of revolute joints in URDF files, exactly as a Denavit-Hartenberg table, and back."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import math
import re
import xml.etree.ElementTree as ET
from os import PathLike
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from sklearn_raacmm.utils import show, warn_user, write_whole

_MM_PER_M = 1000.0
# Axes whose directions differ by less are parallel: rounding of products of rotations.
_PARALLEL = 1e-12
# Feet of a common normal farther than so many lengths of the arm make no sense of two axes that
# somebody meant to be parallel.
_FARTHEST_FOOT = 10.0
# The arm's base frame is the file's where the first axis is so near to what the table can say, mm.
_SAME_MM = 1e-10
# A number with so many decimals that is pi/2 (or pi/4) rounded is meant to be it.
_DECIMALS = {2: 2, 4: 4}
# With so many, a few units of the last decimal off is still meant to be it.
_MANY_DECIMALS, _LAST_UNITS = 6, 3
_BRANCHES_SHOWN = 6


def read_urdf(cls, source, base=None, tip=None):
    """Arm of class `cls` from a file or from text; see `Arm.from_urdf`."""
    if not isinstance(source, str | PathLike):
        raise TypeError(f"source must be a path or the text of a URDF file, got {show(source)}.")
    is_text = isinstance(source, str) and source.lstrip().startswith("<")
    where = "the URDF text" if is_text else str(source)
    joints, name = _joints(source if is_text else _text_of(source), where)
    chain = _chain(joints, base, tip, where)
    directions, points, tip_point = _axes(chain, where)
    if len(directions) < 2:
        raise ValueError(f"{where}: the chain has {len(directions)} revolute joints, not several.")
    directions, points, tip_point = _straighten(directions, points, tip_point)
    table, probe = _table(directions, points, tip_point)
    n = len(directions)
    pose = {"pose_joints": (1, 2), "pose_frames": (0, n)}
    if n >= 5:
        pose = {"pose_joints": (3, 4), "pose_frames": (2, 5)}
        if np.linalg.norm(np.cross(directions[1], directions[2])) < _PARALLEL:
            # No swivel between shoulder and elbow, as on a UR10: see Arm.from_name.
            pose = {"pose_joints": (4, 3), "pose_frames": (2, 4)}
    return cls(**table, probe=probe, convention="modified", name=name, **pose)


def _text_of(path):
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not UTF-8 text.") from None


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
        raise ValueError(f"{where} is not a URDF: its outermost element is {root.tag!r}.")
    if re.search(r"<xacro:|\$\{", text):
        raise ValueError(f"{where} holds xacro macros: expand it first (xacro file.xacro).")
    joints = root.findall("joint")
    for joint in joints:
        if joint.find("parent") is None or joint.find("child") is None:
            raise ValueError(f"{where}: joint {joint.get('name')!r} has no parent or no child.")
    if not joints:
        raise ValueError(f"{where} has no joints.")
    return joints, root.get("name", "")


def _chain(joints, base, tip, where):
    """Joints from base to tip."""
    by_child = {}
    for joint in joints:
        child = joint.find("child").get("link")
        if child in by_child:
            raise ValueError(f"{where}: link {child!r} has two parents.")
        by_child[child] = joint
    parents = {joint.find("parent").get("link") for joint in joints}
    tip = _one_of(sorted(set(by_child) - parents), tip, "tip", {*by_child}, where)
    roots = sorted(parents - set(by_child))
    base = _one_of(roots, base, "base", parents, where)
    chain, link = [], tip
    while link != base:
        if link not in by_child or len(chain) > len(joints):
            raise ValueError(f"{where}: no chain leads from {base!r} to {tip!r}.")
        chain.append(by_child[link])
        link = chain[-1].find("parent").get("link")
    return chain[::-1]


def _one_of(ends, given, what, links, where):
    if given is not None:
        if given not in links:
            raise ValueError(f"{where} has no link {given!r} that could be the {what}.")
        return given
    if len(ends) != 1:
        shown = ", ".join(ends[:_BRANCHES_SHOWN]) or "none"
        more = ", ..." if len(ends) > _BRANCHES_SHOWN else ""
        raise ValueError(
            f"{where} branches: it has {len(ends)} links that could be the {what} ({shown}{more}); "
            f"say which with {what}=."
        )
    return ends[0]


def _axes(chain, where):
    """Direction and a point of each axis, and the tip, at zero angles in the base frame, mm."""
    rotation, origin = np.eye(3), np.zeros(3)
    directions, points = [], []
    for joint in chain:
        name, kind = joint.get("name"), joint.get("type")
        if kind not in ("revolute", "continuous", "fixed"):
            raise ValueError(f"{where}: joint {name!r} is {kind}; only revolute joints are known.")
        if joint.find("mimic") is not None:
            raise ValueError(f"{where}: joint {name!r} mimics another; the arm has no such joints.")
        xyz, rpy = (
            _numbers(joint.find("origin"), key, (0.0, 0.0, 0.0), name, where)
            for key in ("xyz", "rpy")
        )
        origin = origin + rotation @ (_MM_PER_M * np.array(xyz))
        rotation = rotation @ _from_rpy(*rpy)
        if kind != "fixed":
            axis = np.array(_numbers(joint.find("axis"), "xyz", (1.0, 0.0, 0.0), name, where))
            length = np.linalg.norm(axis)
            if not length > 0:
                raise ValueError(f"{where}: the axis of joint {name!r} has no direction.")
            directions.append(rotation @ (axis / length))
            points.append(origin)
    return directions, points, origin


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


def _from_rpy(roll, pitch, yaw):
    """Rotation of a URDF: about the fixed axes x, y and z in this order."""
    cr, sr, cp, sp = _cos(roll), _sin(roll), _cos(pitch), _sin(pitch)
    cy, sy = _cos(yaw), _sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _cos(angle):
    """Cosine that is exactly 0 at pi/2, so that parallel axes stay parallel."""
    return 0.0 if abs(math.remainder(angle, math.pi)) == math.pi / 2 else math.cos(angle)


def _sin(angle):
    return 0.0 if math.remainder(angle, math.pi) == 0 else math.sin(angle)


def _straighten(directions, points, tip):
    """Make axes parallel that are all but parallel, and say by how much the arm changes."""
    directions, points = list(directions), list(points)
    size = sum(np.linalg.norm(b - a) for a, b in zip(points, [*points[1:], tip], strict=True))
    for i in range(len(directions) - 1):
        u, v = directions[i], directions[i + 1]
        normal = np.cross(u, v)
        sine = np.linalg.norm(normal)
        if sine < _PARALLEL:
            continue
        gap = points[i + 1] - points[i]
        foot = abs(np.cross(gap, v) @ normal) / sine**2
        if foot <= _FARTHEST_FOOT * max(size, 1.0):
            continue
        turn = _turn(v, u if u @ v > 0 else -u)
        about = points[i + 1]
        for j in range(i + 1, len(directions)):
            directions[j] = turn @ directions[j]
            points[j] = about + turn @ (points[j] - about)
        tip = about + turn @ (tip - about)
        warn_user(
            f"The axes of joints {i + 1} and {i + 2} are {sine:.2g} rad from parallel, and their "
            f"common normal is {foot:.3g} mm away: they are taken as parallel, which moves the "
            f"probe by up to {sine * size:.2g} mm."
        )
    return directions, points, tip


def _turn(v, u):
    """Rotation that takes the unit vector v to u, nearly the same one."""
    x, y, z = np.cross(v, u)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + cross + cross @ cross / (1 + u @ v)


def _table(directions, points, tip):
    """Modified table of these axes, and the probe in the last frame."""
    x, z, origin = _base_frame(directions[0], points[0])
    n = len(directions)
    a, alpha, d, offset = np.zeros((4, n))
    for i, (u, point) in enumerate(zip(directions, points, strict=True)):
        alpha[i] = math.atan2(np.cross(z, u) @ x, z @ u)
        gap = point - origin
        a[i] = (gap - (gap @ u) * u) @ x
        foot = origin + a[i] * x
        following = x, foot
        if i + 1 < n:
            following = _common_normal(u, foot, x, directions[i + 1], points[i + 1])
        offset[i] = math.atan2(np.cross(x, following[0]) @ u, x @ following[0])
        d[i] = (following[1] - foot) @ u
        (x, origin), z = following, u
    gap = tip - origin
    probe = np.array([gap @ x, gap @ np.cross(z, x), gap @ z])
    return {"a": a, "alpha": alpha, "d": d, "theta_offset": offset}, probe


def _base_frame(u, point):
    """Directions x and z and the origin of frame 0: the file's base frame where that can be."""
    across = point - (point @ u) * u
    # The first row, Rx(alpha) Tx(a) Rz(theta) Tz(d), reaches axes across x that meet it.
    if abs(u[0]) < _PARALLEL and np.linalg.norm(across[1:]) < _SAME_MM:
        return *np.eye(3)[[0, 2]], np.zeros(3)
    x = np.array([1.0, 0.0, 0.0]) if abs(u[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = x - (x @ u) * u
    warn_user(
        "The first axis does not start from the file's base as a Denavit-Hartenberg table has it: "
        f"the arm's own base has its z axis along the first axis, {np.round(u, 6).tolist()}, and "
        f"its origin at {np.round(across, 4).tolist()} mm. Points differ by this fixed "
        "transformation."
    )
    return x / np.linalg.norm(x), u, across


def _common_normal(u, foot, x, v, point):
    """Direction of the common normal from axis u to axis v, and its foot on u."""
    normal = np.cross(u, v)
    sine = np.linalg.norm(normal)
    gap = point - foot
    if sine < _PARALLEL:  # any normal serves: the one through the foot of the last
        across = gap - (gap @ u) * u
        distance = np.linalg.norm(across)
        return (_along_x(across / distance, x, 1.0) if distance > _SAME_MM else x), foot
    normal = normal / sine
    at = foot + (np.cross(gap, v) @ normal / sine) * u
    return _along_x(normal, x, gap @ normal), at


def _along_x(normal, x, distance):
    """Sense of a common normal: along the last one, for small offsets; else towards the axis."""
    along = normal @ x
    return -normal if (along if abs(along) > _PARALLEL else distance) < 0 else normal


# -- writing --------------------------------------------------------------------------------------


def write_urdf(arm, path=None):
    """Text of an arm as URDF, and the file if a path is given; see `Arm.to_urdf`."""
    rows = []
    before = np.eye(4)
    for i in range(arm.n_joints):
        link = _along(arm.a[i], arm.alpha[i])
        spin = _about(arm.theta_offset[i], 0.0)
        rise = _about(0.0, arm.d[i])
        if arm.convention == "standard":
            origin, before = before @ spin, rise @ link
        else:
            # A rotation about z and a shift along it change places.
            origin, before = link @ spin @ rise, np.eye(4)
        rows.append((f"joint{i + 1}", "continuous", origin, arm.joint_signs[i]))
    last = before.copy()
    last[:3, 3] += last[:3, :3] @ arm.probe
    rows.append(("probe_joint", "fixed", last, None))
    links = ["base_link", *(f"link{i + 1}" for i in range(arm.n_joints)), "probe"]
    lines = ['<?xml version="1.0" encoding="utf-8"?>', f"<robot name={quoteattr(arm.name)}>"]
    lines += [f'  <link name="{link}"/>' for link in links]
    for parent, child, (name, kind, origin, sign) in zip(links[:-1], links[1:], rows, strict=True):
        xyz, rpy = (
            " ".join(repr(float(v)) for v in values)
            for values in (origin[:3, 3] / _MM_PER_M, _to_rpy(origin[:3, :3]))
        )
        lines += [
            f'  <joint name="{name}" type="{kind}">',
            f'    <parent link="{parent}"/>',
            f'    <child link="{child}"/>',
            f'    <origin xyz="{xyz}" rpy="{rpy}"/>',
            *([] if sign is None else [f'    <axis xyz="0 0 {sign:.0f}"/>']),
            "  </joint>",
        ]
    text = "\n".join([*lines, "</robot>"]) + "\n"
    if path is not None:
        write_whole({path: text})
    return text


def _along(length, angle):
    """Shift along x and rotation about it."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0, length], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


def _about(angle, length):
    """Rotation about z and shift along it."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, length], [0, 0, 0, 1.0]])


def _to_rpy(rotation):
    """Angles about the fixed axes x, y, z; at a pitch of a right angle the roll is 0."""
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    if math.hypot(rotation[0, 0], rotation[1, 0]) < 1e-9:
        return 0.0, pitch, math.atan2(-rotation[0, 1], rotation[1, 1])
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    return roll, pitch, math.atan2(rotation[1, 0], rotation[0, 0])
