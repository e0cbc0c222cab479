"""The other way round: joint angles that bring a probe to a point, and a frame into a direction."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from sklearn_raacmm.arm._checks import DHTable, are_rotations
from sklearn_raacmm.arm._kinematics import (
    axis_vectors,
    by_given_angles,
    frame_poses,
    joint_axes,
    points_of,
)
from sklearn_raacmm.utils import floats, warn_user

# Points are within this of the wanted ones, mm; an orientation's error counts times the reach.
_REACHED_MM = 1e-7
# Rounds, each with a correction of its own, and steps of the bare arm in each. The first round may
# come from far away; a step turns no joint further than this, in rad.
_ROUNDS, _STEPS, _LARGEST_STEP = 20, 30, 0.5
# Least ratio of the singular values of the Jacobian that is divided by: a stretched arm cannot move
# outwards. Nearer than this, mm, the least falls with the gap, so that singular poses are reached.
_LEAST_RATIO, _NEAR_MM = 1e-4, 0.1
# Poses tried where no start is given. Tries from a start and from so far beside it, rad: ways may
# end beside a singular pose.
_STARTS, _TRIES, _ASIDE = 20, 4, 0.1


def angles_for(
    arm: DHTable,
    points: ArrayLike,
    start: np.ndarray | None,
    orientations: ArrayLike | None,
    correction: Callable | None = None,
) -> np.ndarray:
    """See `Arm.angles_for`; angles and starts (n or 1, n_joints) in rad, correction as below."""
    points = floats("points", points, 3)
    turns = None if orientations is None else _check_orientations(orientations, len(points))
    low, high = arm.bounds
    if start is not None and len(start) not in (1, len(points)):
        raise ValueError(
            f"start has {len(start)} poses for {len(points)} points: give one, or one each."
        )
    rng, shape = np.random.default_rng(0), (len(points), arm.n_joints)
    first, last = np.clip(arm.spans, low, high)  # limits may be beyond half a turn
    aside = _ASIDE * arm.by_type(1.0, arm.reach_mm)
    angles, off = np.full(shape, np.nan), np.full((len(points), 2), np.inf)
    open_ = np.arange(len(points))
    for again in range(_STARTS if start is None else _TRIES):
        if start is None:
            own = rng.uniform(first, last) * (again > 0)
        else:
            own = start + rng.normal(0, aside, shape) * (again > 0)
        own, rows = np.broadcast_to(own, shape)[open_], open_
        wanted = None if turns is None else turns[open_]
        of_rows = correction and (lambda q, k, rows=rows: correction(q, rows[k]))
        reached, left = solve(arm, points[open_], own, wanted, of_rows)
        nearer = left[:, 0] < off[open_, 0]
        off[open_[nearer]] = left[nearer]
        angles[open_] = reached
        open_ = open_[np.isnan(reached[:, 0])]
        if not len(open_):
            break
    if len(open_):
        mm, rad = off[open_[0]]
        turned = f" and {np.rad2deg(rad):.3g} degrees" if orientations is not None else ""
        warn_user(
            f"{len(open_)} of {len(points)} points are not reached: first that of row {open_[0]}, "
            f"to which the probe came as near as {mm:.3g} mm{turned}. Their angles are NaN."
        )
    return angles


def solve(
    arm: DHTable,
    points: np.ndarray,
    start: np.ndarray,
    orientations: np.ndarray | None = None,
    correction: Callable | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n, n_joints) in rad of poses whose corrected probe is at given points (n, 3) in mm.

    And, where wanted, whose last frame has given orientations (n, 3, 3). `correction` takes angles
    (m, n_joints) in rad and the numbers of their rows; it gives what is to be subtracted from the
    arm's points, (m, 3) mm, and the rotation vectors that are to be taken off its orientations,
    (m, 3) rad. A row that is not reached has NaN; the second value returned is how far off each row
    was, (n, 2) in mm and rad.
    """
    low, high = arm.bounds
    angles, off = np.clip(start, low, high), np.zeros((len(points), 2))
    open_ = np.arange(len(points))
    for _ in range(_ROUNDS):
        aim, turned = points[open_], None if orientations is None else orientations[open_]
        if correction is not None:
            shift, turn = correction(angles[open_], open_)
            aim = aim + shift
            if turned is not None:
                turned = Rotation.from_rotvec(turn).as_matrix() @ turned
        gap = _gaps(arm, aim, turned, angles[open_])
        off[open_, 0] = np.linalg.norm(gap[:, :3], axis=1)
        off[open_, 1] = np.linalg.norm(gap[:, 3:], axis=1) / arm.reach_mm
        going = np.linalg.norm(gap, axis=1) > _REACHED_MM
        open_, aim = open_[going], aim[going]
        if not len(open_):
            break
        turned = None if turned is None else turned[going]
        angles[open_] = _bare(arm, aim, turned, angles[open_], low, high)
    angles[open_] = np.nan
    return angles, off


def _check_orientations(orientations, n):
    """Rotations (n, 3, 3) as float64."""
    turns = floats("orientations", orientations, finite=True)
    if turns.shape != (n, 3, 3):
        raise ValueError(
            "orientations must be a rotation matrix for each point, "
            f"({n}, 3, 3), got {turns.shape}."
        )
    wrong = np.flatnonzero(~are_rotations(turns))
    if len(wrong):
        raise ValueError(
            f"{len(wrong)} of {n} orientations are no rotations; the first is that of row "
            f"{wrong[0]}: {turns[wrong[0]].round(6).tolist()}."
        )
    return turns


def _gaps(arm, aim, turned, angles):
    """What is left to go, (n, 3) mm, and where orientations are wanted times the reach, (n, 6)."""
    gap = aim - points_of(arm, angles)
    if turned is None:
        return gap
    own = frame_poses(arm, angles)[:, -1, :, :3]
    left = Rotation.from_matrix(turned @ own.swapaxes(1, 2)).as_rotvec()
    return np.hstack([gap, arm.reach_mm * left])


def _bare(arm, aim, turned, angles, low, high):
    """The same for the arm without a correction, by shortest steps."""
    moves, turns = joint_axes(arm), arm.by_type(1.0, 0.0)
    n_turns = 3 * (arm.n_joints + 1)
    about = moves % n_turns + n_turns
    unit = arm.by_type(1.0, arm.reach_mm)  # of a slide: as large as one radian
    angles, open_ = angles.copy(), np.arange(len(aim))
    for _ in range(_STEPS):
        own = angles[open_]
        gap = _gaps(arm, aim[open_], None if turned is None else turned[open_], own)
        going = np.linalg.norm(gap, axis=1) > _REACHED_MM / 10
        open_, own, gap = open_[going], own[going], gap[going]
        if not len(open_):
            break
        vectors = axis_vectors(arm, own)[0]
        jacobian = by_given_angles(arm, vectors[:, :, moves] * unit)
        if turned is not None:
            axes = by_given_angles(arm, vectors[:, :, about] * turns)
            jacobian = np.concatenate([jacobian, arm.reach_mm * axes], axis=1)
        # A joint at its limit that is pushed further does not help.
        step = _shortest(jacobian, gap)
        stuck = ((own <= low) & (step < 0)) | ((own >= high) & (step > 0))
        if stuck.any():
            step = _shortest(jacobian * ~stuck[:, None], gap)
        size = np.abs(step).max(axis=1, keepdims=True)
        step *= _LARGEST_STEP / np.maximum(size, _LARGEST_STEP)
        angles[open_] = np.clip(own + step * unit, low, high)
    return angles


def _shortest(jacobian, gap):
    """Shortest steps (n, n_joints) that close gaps (n, k), as far as the Jacobian lets them."""
    gram = jacobian @ jacobian.swapaxes(1, 2)
    value, axes = np.linalg.eigh(gram)
    near = np.minimum(np.linalg.norm(gap, axis=1, keepdims=True) / _NEAR_MM, 1.0)
    value = np.maximum(value, near * _LEAST_RATIO**2 * value[:, -1:] + 1e-300)
    along = np.einsum("nij,ni->nj", axes, gap) / value
    return np.einsum("nij,ni->nj", jacobian, np.einsum("nij,nj->ni", axes, along))
