"""Denavit-Hartenberg tables of a robot's own files, exactly, and these files after calibration."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import math
from functools import reduce
from itertools import accumulate
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from sklearn_raacmm.arm._built_in import usual_pose
from sklearn_raacmm.arm._chain import (
    edited,
    pose_of,
    read_chain,
    rigid,
    turn_between,
    warn_of_losses,
    with_probe,
)
from sklearn_raacmm.arm._checks import are_rotations
from sklearn_raacmm.arm._kinematics import Chain
from sklearn_raacmm.utils import Finding, floats, warn_user

# Axes whose directions differ by less are parallel: rounding of products of rotations.
_PARALLEL = 1e-12
# Feet of a common normal farther than so many lengths of the arm make no sense of two axes that
# somebody meant to be parallel.
_FARTHEST_FOOT = 10.0
# The arm's base frame is the file's where the first axis is so near to what the table can say, mm.
_SAME_MM = 1e-10
# Angles that are taken as right ones are warned of from here on, mm at the probe.
_MUCH_MM = 1e-3
# Calibration turns axes by a degree or so: farther ones belong to another arm, rad.
_SAME_ARM = 0.2


def read_urdf(cls: Any, source: str | PathLike[str], base: str | None, tip: str | None) -> Any:
    """The arm of a robot's own file, see `Arm.from_urdf`, and how it stands in the file.

    That is the pose of its base in the file's base frame (4, 4), the chain of joints, the joints
    above the base, the text of the file, and its name for messages.
    """
    joints, mount, name, text, where = read_chain(source, base, tip)
    frames = _frames(joints)
    moving = [(f, joint) for f, joint in zip(frames, joints, strict=True) if joint.axis is not None]
    n = len(moving)
    if n < 2:
        raise ValueError(f"{where}: the chain has {n} moving joints, not several.")
    directions = [frame[:3, :3] @ joint.axis for frame, joint in moving]
    points, slides = [frame[:3, 3] for frame, _ in moving], [joint.slides for _, joint in moving]
    fields, placed = _fields_of_axes(directions, points, frames[-1][:3, 3], slides)
    limits = np.array([joint.limits for _, joint in moving])
    # The first link of a file stands upright: its z axis is the vertical.
    upright = reduce(np.matmul, (joint.origin for joint in mount), np.eye(4))
    up = placed[:3, :3].T @ upright[2, :3]
    arm = cls(
        **fields, name=name, names=tuple(joint.name for _, joint in moving),
        joint_types=["RP"[one] for one in slides],
        limits=limits,
        up=np.where(np.abs(up) > _PARALLEL, up, 0.0),
    )  # fmt: skip
    rounded = [joint.rounded for joint in joints if joint.rounded]
    if rounded:
        moved_mm = sum(rounded) * arm.reach_mm
        Finding(
            "rounded-angles",
            f"{where}: angles of {len(rounded)} joints are taken as the right or half right angles "
            f"that they are nearly: they differ by up to {max(rounded):.2g} rad, which moves the "
            f"probe by up to {moved_mm:.2g} mm.",
            weight="doubt" if moved_mm > _MUCH_MM else "note",
        ).report()  # fmt: skip
    return arm, placed, joints, mount, text, where


def fields_of_far_axes(table: np.ndarray, probe: ArrayLike) -> dict[str, Any]:
    """Fields of a modified table of the axes of a standard one: see `Arm.from_far_axes`."""
    frame, at, directions, points = np.eye(4), np.zeros(3), [], []
    for a, alpha, d, offset in table:
        u, origin = frame[:3, 2], frame[:3, 3]
        at = origin + ((at - origin) @ u) * u  # of each axis the point next to the one before
        directions.append(u)
        points.append(at)
        frame = frame @ pose_of((0, 0, d), (0, 0, offset)) @ pose_of((a, 0, 0), (alpha, 0, 0))
    tip = (frame @ np.append(probe, 1.0))[:3]
    return _fields_of_axes(directions, points, tip, [False] * len(points))[0]


def _fields_of_axes(directions, points, tip, slides):
    """Fields of `Arm` of these axes at zero angles and a probe, and the pose of its base."""
    if slides[0]:  # what slides along a line slides along all that are parallel to it
        points = [np.zeros(3), *points[1:]]
    directions, points, tip = _straighten(directions, points, tip, slides)
    table, probe, placed = _table(directions, points, tip)
    n = len(directions)
    parallel = n > 2 and bool(np.linalg.norm(np.cross(*directions[1:3])) < _PARALLEL)
    own = usual_pose(n, parallel, "modified")
    return {**table, **own, "probe": probe, "convention": "modified"}, placed


def seen_from(arm: Any, positioner: Chain, base: ArrayLike) -> Any:
    """The arm and the positioner that carries its part as one arm: see `Arm.seen_from`."""
    pose, m = floats("base", base, finite=True), positioner.n_joints
    if pose.shape != (4, 4) or np.any(pose[3] != [0, 0, 0, 1]) or not are_rotations(pose[:3, :3]):
        raise ValueError(
            "base must be the pose of the arm's base in that of the positioner, (4, 4): a "
            f"rotation, a shift in mm, and the row 0, 0, 0, 1; got {pose.tolist()!r:.200}."
        )
    if arm.up_frame or positioner.up_frame:
        raise ValueError("An arm that is seen from a positioner cannot be seen from another one.")
    table = _frames_at_zero(positioner)[-1] @ rigid(np.eye(3), positioner.probe)
    foot = np.linalg.inv(table)  # as the arm's base seen from the table
    pose = foot @ rigid(Rotation.from_matrix(pose[:3, :3]).as_matrix(), pose[:3, 3])
    # What turns back about an axis turns about the opposite axis.
    back = foot @ _axis_frames(positioner)[::-1] @ np.diag([1.0, -1.0, -1.0, 1.0])
    frames = np.concatenate([back, pose @ _axis_frames(arm)])
    tip = pose @ _frames_at_zero(arm)[-1] @ [*arm.probe, 1.0]
    types = positioner.joint_types[::-1] + arm.joint_types
    slides = [kind == "P" for kind in types]
    fields, placed = _fields_of_axes(frames[:, :3, 2], frames[:, :3, 3], tip[:3], slides)
    own = positioner.names or [f"E{i + 1}" for i in range(m)]
    couplings = [(m + 1 - i, m + 1 - j, factor) for i, j, factor in positioner.couplings]
    # The frames of the standard convention lie behind the links, those of the modified before.
    behind = m + (arm.convention == "standard")
    fields |= {
        "pose_joints": np.add(arm.pose_joints, m),
        "pose_frames": np.minimum(np.add(arm.pose_frames, behind), m + arm.n_joints),
        "name": arm.name,
        "names": (*own[::-1], *(arm.names or [f"J{i + 1}" for i in range(arm.n_joints)])),
        "joint_types": types,
        "joint_signs": np.concatenate([positioner.joint_signs[::-1], arm.joint_signs]),
        "limits": np.vstack([np.transpose(one.bounds) for one in (positioner, arm)]),
        "couplings": [*couplings, *((m + i, m + j, factor) for i, j, factor in arm.couplings)],
        "up_frame": m,
    }
    fields["limits"][:m] = fields["limits"][:m][::-1]
    chain = type(arm)(**fields)
    upright = _axis_frames(chain)[m - 1, :3, :3].T @ placed[:3, :3].T @ pose[:3, :3] @ arm.up
    return chain.replace(up=np.where(np.abs(upright) > _PARALLEL, upright, 0.0))


def write_into_urdf(
    arm: Chain, original: str | PathLike[str], base: str | None, tip: str | None
) -> str:
    """Text of a robot's own file with the numbers of an arm: see `Arm.update_urdf`."""
    nominal, placed, joints, mount, text, where = read_urdf(type(arm), original, base, tip)
    same = (nominal.convention, nominal.joint_types) == (arm.convention, arm.joint_types)
    if not same or np.any(nominal.joint_signs != np.sign(arm.joint_signs)):
        raise ValueError(
            f"{where} has {nominal.n_joints} joints in the modified convention, and the arm "
            f"is {arm!r}: only an arm that was read from this file can be written back into "
            "it."
        )
    warn_of_losses(arm)
    old, new = (placed @ _axis_frames(one) for one in (nominal, arm))
    axes = iter(zip(old, new, strict=True))
    point = (new[-1] @ [*arm.probe, 1.0])[:3]
    # Right angles of fixed joints as the arm has them: other programs read what is written.
    fixed = [joint for joint in (*mount, *joints) if joint.axis is None]
    origins = {joint.name: joint.origin for joint in fixed if joint.rounded}
    before = np.eye(4)
    for joint, file in zip(joints, _frames(joints), strict=True):
        if joint.axis is None:
            before = before @ joint.origin
            continue
        was, now = next(axes)
        if np.linalg.norm(np.cross(was[:3, 2], now[:3, 2])) > _SAME_ARM:
            raise ValueError(
                f"{where}: the axis of joint {joint.name!r} is another one in the arm, which "
                "was not read from this file, or from another base."
            )
        # The file's frame goes where the table's frame has gone, exactly onto the new axis.
        frame = now @ np.linalg.inv(was) @ file
        along = now[:3, 2] * np.sign(now[:3, 2] @ frame[:3, :3] @ joint.axis)
        frame[:3, :3] = turn_between(frame[:3, :3] @ joint.axis, along) @ frame[:3, :3]
        at, foot = point if joint is joints[-1] else frame[:3, 3], now[:3, 3]
        frame[:3, 3] = at if joint.slides else foot + ((at - foot) @ along) * along
        origins[joint.name] = np.linalg.inv(before) @ frame
        before = frame
    last, off_mm = joints[-1], np.linalg.norm(point - before[:3, 3])
    if last.axis is None:  # the probe: the last joint of the chain is fixed
        parent = before @ np.linalg.inv(last.origin)
        origins[last.name] = last.origin.copy()
        origins[last.name][:3, 3] = (np.linalg.inv(parent) @ [*point, 1.0])[:3]
    elif str(text).lstrip().startswith("<") and off_mm > _SAME_MM:
        place = rigid(np.eye(3), (np.linalg.inv(before) @ [*point, 1.0])[:3])
        text, name = with_probe(text, last.child, place)
        warn_user(
            f"{where}: the probe is {off_mm:.4g} mm beside the last axis: the link {name!r} was "
            f"added, fixed to {last.child!r}. Read the file with tip={name!r}."
        )
    if not arm.up_frame and np.abs(arm.up - nominal.up).max() > _SAME_MM:
        if mount:
            turn = turn_between(placed[:3, :3] @ arm.up, placed[:3, :3] @ nominal.up)
            origins[mount[-1].name] = mount[-1].origin @ rigid(turn, 0.0)
        else:
            warn_user(
                f"{where}: no fixed joint above the base could say that up is "
                f"{np.round(arm.up, 6).tolist()} there: only the arm's own file says so."
            )
    return edited(text, origins)


def _axis_frames(arm):
    """Frames of the table at zero angles, whose z axes are those of the joints (n, 4, 4)."""
    frames = _frames_at_zero(arm)
    return frames[1:] if arm.convention == "modified" else frames[:-1]


def _frames_at_zero(arm):
    """All frames of the table at zero angles, (n + 1, 4, 4)."""
    frames = np.tile(np.eye(4), (arm.n_joints + 1, 1, 1))
    frames[:, :3] = arm.frames_at(np.zeros((1, arm.n_joints)))[0]
    return frames


def _frames(joints):
    """Frames of all joints at zero angles in the base frame, mm."""
    return list(accumulate((joint.origin for joint in joints), np.matmul))


def _straighten(directions, points, tip, slides):
    """Make axes parallel that are all but parallel, and say by how much the arm changes.

    An axis along which a joint slides is moved to where it crosses the other one instead.
    """
    directions, points = list(directions), list(points)
    size = sum(np.linalg.norm(b - a) for a, b in zip(points, [*points[1:], tip], strict=True))
    moved = -1  # the joint whose axis has been moved last
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
        if slides[i + 1]:
            points[i + 1], moved = points[i], i + 1
            continue
        if slides[i] and moved != i:
            points[i] = points[i + 1]
            continue
        turn = turn_between(v, u if u @ v > 0 else -u)
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


def _table(directions, points, tip):
    """Modified table of these axes, the probe in the last frame, and the pose of the base."""
    x, z, origin = _base_frame(directions[0], points[0])
    placed = rigid(np.column_stack([x, np.cross(z, x), z]), origin)
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
    return {"a": a, "alpha": alpha, "d": d, "theta_offset": offset}, probe, placed


def _base_frame(u, point):
    """Directions x and z and the origin of frame 0: the file's base frame where that can be."""
    across = point - (point @ u) * u
    # The first row, Rx(alpha) Tx(a) Rz(theta) Tz(d), reaches axes across x that meet it.
    if abs(u[0]) < _PARALLEL and np.linalg.norm(across[1:]) < _SAME_MM:
        return *np.eye(3)[[0, 2]], np.zeros(3)
    x = np.array([1.0, 0.0, 0.0]) if abs(u[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    x = x - (x @ u) * u
    warn_user(
        "The first axis does not start from the given base as a Denavit-Hartenberg table has it: "
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
