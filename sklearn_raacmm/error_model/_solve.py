"""The other way round: joint angles that bring a corrected probe to a point."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from typing import Any

import numpy as np

from sklearn_raacmm.arm import Arm, axis_vectors, points_of

# Corrected points are within this of the wanted ones, mm.
_REACHED_MM = 1e-7
# Rounds, each with a correction of its own, and steps of the bare arm in each. The first round may
# come from far away; a step turns no joint further than this, in rad.
_ROUNDS, _STEPS, _LARGEST_STEP = 20, 30, 0.5
# Least ratio of the singular values of the Jacobian that is divided by: a stretched arm cannot move
# outwards.
_LEAST_RATIO = 1e-4


def angles_for(
    arm: Arm, correction: Callable, points: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n, n_joints) in rad of poses whose corrected probe is at given points (n, 3) in mm.

    `correction` takes angles (m, n_joints) in rad and the numbers of their rows; it gives what is
    to be subtracted from the arm's points, (m, 3). A point that is not reached has NaN; the second
    value returned is a structured array of `row` and distance `off_mm` of these.
    """
    low, high = limits_of(arm)
    angles = np.clip(start, low, high)
    open_, off = np.arange(len(points)), np.zeros(len(points))
    for _ in range(_ROUNDS):
        aim = points[open_] + correction(angles[open_], open_)
        off[open_] = np.linalg.norm(points_of(arm, angles[open_]) - aim, axis=1)
        going = off[open_] > _REACHED_MM
        open_, aim = open_[going], aim[going]
        if not len(open_):
            break
        angles[open_] = _bare(arm, aim, angles[open_], low, high)
    missed = np.array(
        [(row, off[row]) for row in open_.tolist()], dtype=[("row", "i8"), ("off_mm", "f8")]
    )
    angles[open_] = np.nan
    return angles, missed


def limits_of(arm: Arm) -> Any:
    """Lowest and highest angle of each joint in rad, infinite where the arm has no limits."""
    if arm.limits is None:
        return np.full(arm.n_joints, -np.inf), np.full(arm.n_joints, np.inf)
    return np.asarray(arm.limits, dtype=float).T


def _bare(arm, aim, angles, low, high):
    """The same for the arm without a correction, by shortest steps."""
    turns = 3 * (np.arange(arm.n_joints) + (arm.convention == "modified")) + 2
    angles, open_ = angles.copy(), np.arange(len(aim))
    for _ in range(_STEPS):
        own = angles[open_]
        gap = aim[open_] - points_of(arm, own)
        going = np.linalg.norm(gap, axis=1) > _REACHED_MM / 10
        open_, own, gap = open_[going], own[going], gap[going]
        if not len(open_):
            break
        jacobian = axis_vectors(arm, own)[0][:, :, turns] * arm.joint_signs
        # A joint at its limit that is pushed further does not help.
        step = _shortest(jacobian, gap)
        stuck = ((own <= low) & (step < 0)) | ((own >= high) & (step > 0))
        if stuck.any():
            step = _shortest(jacobian * ~stuck[:, None], gap)
        size = np.abs(step).max(axis=1, keepdims=True)
        angles[open_] = np.clip(own + step * np.minimum(1, _LARGEST_STEP / size), low, high)
    return angles


def _shortest(jacobian, gap):
    """Shortest steps (n, n_joints) that close gaps (n, 3), as far as the Jacobian lets them."""
    gram = jacobian @ jacobian.swapaxes(1, 2)
    value, axes = np.linalg.eigh(gram)
    value = np.maximum(value, (_LEAST_RATIO**2 * value[:, -1:]) + 1e-300)
    along = np.einsum("nij,ni->nj", axes, gap) / value
    return np.einsum("nij,ni->nj", jacobian, np.einsum("nij,nj->ni", axes, along))
