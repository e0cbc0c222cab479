"""Kinematics on arrays: each quantity is one contiguous row over the samples of a chunk."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np

from sklearn_raacmm.arm._checks import DHTable
from sklearn_raacmm.utils import chunks

# Fields of `Arm` that are its static parameters, in the order of `parameter_jacobian`.
FIELDS = ("a", "alpha", "d", "theta_offset", "probe")
# Rows computed at once: the working set of a chunk (about 30 rows of float64) stays in the cache.
CHUNK_ROWS = 4096
# Along x, y and z of the base: its own axes and its origin.
_BASE = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))


def joint_axes(arm: DHTable) -> np.ndarray:
    """Place of what each joint does to the probe, (n_joints,), among the `axis_vectors`."""
    n, turns = len(arm.a), 3 * (np.arange(len(arm.a)) + (arm.convention == "modified")) + 2
    turns[arm.slides] += 3 * (n + 1)
    return turns


def phase_factors(arm: DHTable) -> np.ndarray:
    """What makes `phases` of the `own_angles` of each joint, (n_joints,): rad for rad or mm."""
    factors = np.ones(len(arm.a))
    factors[arm.slides] = 2 * np.pi / turn_mm(arm)[arm.slides]
    return factors


def turn_mm(arm: DHTable) -> np.ndarray:
    """Travel in mm (n_joints,) that counts as one turn in `phases`, of the joints that slide."""
    low, high = arm.spans
    return 200.0 * np.maximum(np.ceil((high - low) / 100.0), 1.0)


def by_given_angles(arm: DHTable, jacobian: np.ndarray) -> np.ndarray:
    """Derivatives (..., n_joints) by what the encoders give, of those by theta of the table.

    Of joints that slide by d.
    """
    by_own = jacobian * arm.joint_signs
    jacobian = by_own.copy() if arm.couplings else by_own
    for joint, other, factor in arm.couplings:
        jacobian[..., other - 1] += factor * by_own[..., joint - 1]
    return jacobian


def _rows_of_table(arm, angles):
    """Of each joint: cosines and sines of theta (n_joints, n_samples), a, d, cos and sin alpha.

    Of a joint that slides d is (n_samples,), where there are several.
    """
    if arm.couplings:
        angles = arm.own_angles(angles)
    theta = np.ascontiguousarray(angles.T) * arm.joint_signs[:, None] + arm.theta_offset[:, None]
    # Python's numbers: of a few rows, NumPy's cost as much as the arrays.
    links = [part.tolist() for part in (arm.a, arm.d, np.cos(arm.alpha), np.sin(arm.alpha))]
    for i in arm.slides:
        theta[i] = arm.theta_offset[i]
        d = arm.d[i] + arm.joint_signs[i] * angles[:, i]
        links[1][i] = float(d[0]) if len(d) == 1 else d
    return np.cos(theta), np.sin(theta), *links


def carried(arm: DHTable, angles: np.ndarray, fixed: list[Any]) -> np.ndarray:
    """Points in the base frame, (len(fixed), 3, n_samples) mm, that are fixed in frames of the arm.

    `fixed` has the number of each point's frame and its three coordinates in it, mm. A point
    through 2 plane rotations a joint costs about a third of the products of 3x4 matrices.
    """
    cos, sin, a, d, cos_alpha, sin_alpha = _rows_of_table(arm, angles)
    if len(angles) == 1:
        # Python's numbers are ten times as fast as arrays of one number, and round alike.
        cos, sin = cos[:, 0].tolist(), sin[:, 0].tolist()
    points = np.empty((len(fixed), 3, len(angles)))
    for point, (frame, (x, y, z)) in zip(points, fixed, strict=True):
        for i in reversed(range(frame)):
            c, s, ca, sa = cos[i], sin[i], cos_alpha[i], sin_alpha[i]
            if arm.convention == "standard":
                y, z = ca * y - sa * z, sa * y + ca * z
                x, z = x + a[i], z + d[i]
                x, y = c * x - s * y, s * x + c * y
            else:
                x, y = c * x - s * y, s * x + c * y
                x, z = x + a[i], z + d[i]
                y, z = ca * y - sa * z, sa * y + ca * z
        point[0], point[1], point[2] = x, y, z
    return points


def points_of(arm: DHTable, angles: np.ndarray, probes: np.ndarray | None = None) -> np.ndarray:
    """Probe points (n_samples, 3) at angles that have been checked, a chunk at a time.

    `probes` (n_samples, 3) are those of the rows in the last frame, mm; None: all have the arm's.
    """
    points = np.empty((len(angles), 3))
    for rows in chunks(len(angles), CHUNK_ROWS):
        own = arm.probe.tolist() if probes is None else probes[rows].T
        points[rows] = carried(arm, angles[rows], [(len(arm.a), own)])[0].T
    return points


def frame_columns(arm: DHTable, angles: np.ndarray) -> np.ndarray:
    """Frames as (n_joints + 1, 4, 3, n_samples): the columns x, y, z, origin of each frame."""
    cos, sin, *links = _rows_of_table(arm, angles)
    if len(angles) == 1:  # by numbers, as in `carried`: a third of the time, and equal bits
        table = cos[:, 0].tolist(), sin[:, 0].tolist(), *links
        of_axes = [[*_frames(arm, table, axis)] for axis in _BASE]
        return np.array(of_axes).transpose(1, 2, 0)[..., None]
    out = np.zeros((len(cos) + 1, 4, 3, len(angles)))
    out[0, [0, 1, 2], [0, 1, 2]] = 1.0
    for frame, columns in zip(out, _frames(arm, (cos, sin, *links), out[0]), strict=True):
        frame[0], frame[1], frame[2], frame[3] = columns
    return out


def _frames(arm, table, base):
    """Yield x, y, z and origin of each frame: arrays, or numbers along one axis of the base."""
    x, y, z, origin = base
    yield x, y, z, origin
    for c, s, a, d, ca, sa in zip(*table, strict=True):
        if arm.convention == "standard":
            x, y = c * x + s * y, c * y - s * x
            origin = origin + d * z + a * x
            y, z = ca * y + sa * z, ca * z - sa * y
        else:
            y, z = ca * y + sa * z, ca * z - sa * y
            origin = origin + a * x + d * z
            x, y = c * x + s * y, c * y - s * x
        yield x, y, z, origin


def frame_poses(arm: DHTable, angles: np.ndarray) -> np.ndarray:
    """Frames (n, n_joints + 1, 3, 4) at angles that have been checked: see `Arm.frames`."""
    frames = np.empty((len(angles), len(arm.a) + 1, 3, 4))
    for rows in chunks(len(angles), CHUNK_ROWS):
        frames[rows] = frame_columns(arm, angles[rows]).transpose(3, 0, 2, 1)
    return frames


def probe_from_frames(arm, frames, probes=None):
    """Probe points (3, n_samples) from `frame_columns`; `probes` as of `points_of`."""
    own = arm.probe[:, None] if probes is None else probes.T
    return (own[:, None] * frames[-1, :3]).sum(axis=0) + frames[-1, 3]


def cross(u, v):
    """Cross product of (3, n_samples) arrays; np.cross costs several times as much."""
    # Not `np.stack`: of one row its checks cost as much as the products.
    return np.array(
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    )


def axis_vectors(
    arm: DHTable, angles: np.ndarray, probes: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """What turns and shifts by every axis of every frame do to the probe, and where things are.

    Of angles (n, n_joints) in rad: what a turn about each axis, x, y and z of the base, of frame 1
    and so on, does to the probe, mm per rad, then the axes themselves, (n, 3, 6 n_frames); and
    the frames' origins and the probe, (n, 3, n_frames + 1) mm.
    """
    frames = frame_columns(arm, angles)
    k, n = len(frames), len(angles)
    # Components first, then what there is, then rows: of one row, views are free.
    places = np.empty((3, k + 1, n))
    places[:, :k] = frames[:, 3].swapaxes(0, 1)
    places[:, k] = probe_from_frames(arm, frames, probes)
    # x, y, z, x, y: a cross product is two products of runs of three.
    lever, axes = np.empty((5, k, 1, n)), np.empty((5, k, 3, n))
    np.subtract(places[:, k:], places[:, :k], out=lever[:3, :, 0])
    axes[:3] = frames[:, :3].transpose(2, 0, 1, 3)
    lever[3:], axes[3:] = lever[:2], axes[:2]
    vectors = np.empty((3, 2, k, 3, n))
    np.multiply(axes[1:4], lever[2:], out=vectors[:, 0])
    vectors[:, 0] -= axes[2:] * lever[1:4]
    vectors[:, 1] = axes[:3]
    vectors = np.ascontiguousarray(vectors.reshape(3, 6 * k, n).transpose(2, 0, 1))
    return vectors, places.transpose(2, 0, 1)


def joint_jacobian(arm: DHTable, angles: np.ndarray) -> np.ndarray:
    """Derivative of the probe (n, 3, n_joints) by what the encoders give, mm per rad or per mm.

    Bit for bit that of `parameter_jacobian`, of which only these columns are made.
    """
    jac = np.empty((len(angles), 3, len(arm.a)))
    for rows in chunks(len(angles), CHUNK_ROWS):
        frames = frame_columns(arm, angles[rows])
        axes, turned = _along_and_about(frames, 2, arm, probe_from_frames(arm, frames))
        turned[:, arm.slides] = axes[:, arm.slides]
        jac[rows] = turned.transpose(2, 0, 1)
    return by_given_angles(arm, jac)


def parameter_jacobian(arm: DHTable, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Probe points (n, 3) and their derivatives (n, 3, 4 n_joints + 3) by the arm's `FIELDS`."""
    n = len(arm.a)
    points = np.empty((len(angles), 3))
    jac = np.empty((len(angles), 3, 4 * n + 3))
    for rows in chunks(len(angles), CHUNK_ROWS):
        frames = frame_columns(arm, angles[rows])
        probe = probe_from_frames(arm, frames)
        points[rows] = probe.T
        of_x, of_z = (_along_and_about(frames, axis, arm, probe) for axis in (0, 2))
        for i, moved in enumerate([*of_x, *of_z]):
            jac[rows, :, i * n : (i + 1) * n] = moved.transpose(2, 0, 1)
        jac[rows, :, 4 * n :] = frames[-1, :3].transpose(2, 1, 0)
    return points, jac


def _along_and_about(frames, axis, arm, probe):
    """What shifts along and turns about x or z (0 or 2) in each row of the table do to the probe.

    Both (3, n_joints, n_samples). A row goes along and about z of one of its two frames, and x of
    the other.
    """
    own = frames[1:] if (axis == 0) == (arm.convention == "standard") else frames[:-1]
    along, origins = own[:, axis].swapaxes(0, 1), own[:, 3].swapaxes(0, 1)
    return along, cross(along, probe[:, None] - origins)
