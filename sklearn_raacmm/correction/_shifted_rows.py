"""Points that stand one row off their poses from some row on: a lost row, or a doubled one."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.utils import Finding, row_numbers

# A shift is named where the steps between points then differ from those of the poses by less than
# this share of what they differ by as they stand, and those before them do: half of a metre and
# some centimetres, where the arm is known badly, are a tenth.
_LEFT = 0.2
_FEWEST_ROWS = 8


def shifted_rows(arm: Arm, angles: np.ndarray, points: np.ndarray) -> Finding | None:
    """Finding of points (n, 3), mm, that are those of the next or the last pose (n, n_joints), rad.

    Distances between points of neighbouring rows are compared with those that the arm has between
    their poses, so that neither the frame of the points nor the arm has to be known well.
    """
    n = len(angles)
    if n < _FEWEST_ROWS:
        return None
    measured, known = (
        np.linalg.norm(np.diff(p, axis=0), axis=1) for p in (points, arm.forward(angles))
    )
    most = np.median(known)  # a step that belongs to no pose counts so much
    as_given = np.minimum(np.abs(measured - known), most)
    found = []
    for shift in (1, -1):
        moved = np.minimum(np.abs(measured - np.roll(known, -shift)), most)
        moved[-1 if shift > 0 else 0] = most
        # From point k on: the steps before it, but for the last, which leads there, and from it on.
        before = np.r_[0.0, 0.0, np.cumsum(as_given)[:-1]]
        left = before + np.r_[np.cumsum(moved[::-1])[::-1], 0.0]
        k = int(np.argmin(left[: n - _FEWEST_ROWS // 2]))
        found.append((float(left[k]), k, shift, moved))
    _, k, shift, moved = min(found, key=lambda one: one[0])
    size = _LEFT * np.median(as_given[k:])
    if np.median(moved[k:]) > size or (k > 1 and np.median(as_given[: k - 1]) > size):
        return None
    k = 0 if k == 1 and moved[0] <= size else k
    row = row_numbers([k])[0]
    of, what = "last", "a point is there twice, or a pose is missing"
    if shift > 0:
        of, what = "next", "a point is missing there"
    said = f"From row {row} on each point is that of the {of} row: {what}."
    advice = "Give both files a column of names, or mend the rows."
    return Finding("shifted-rows", said, advice, "refuse", rows=(row,))
