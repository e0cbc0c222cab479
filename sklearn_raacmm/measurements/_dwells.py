"""Poses of a log: rows in which the arm stood still are one, and angles that cannot be right."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import JointTypes
from sklearn_raacmm.utils import Finding, Groups

# A row joins the run while every joint is within this of the run's running mean, and runs of so
# many rows are one pose (``benchmarks/bench_check.py dwells``). Of 14 352 rows of real series none
# are merged (``tests/measurements/test_order.py``).
_STILL_RAD, _LEAST = 1e-3, 3
# What slides by less stands still, mm: a brake gives way by as much.
STILL_MM = 0.01
# No encoder has such digits: rows that are closer are copies.
_COPY_RAD = 1e-12
# Steps that angles are rounded to, deg, and how far a multiple may be off, as a part of it.
_STEPS, _OFF = (1.0, 0.5, 0.1, 0.05, 0.01), 1e-4
# Different angles of a joint that may lie on a grid by intention, and the error of rounding at the
# stretched arm that is worth a word, mm.
_LEAST_DIFFERENT, _LARGE_MM = 10, 0.02
# Share of all weights beyond which one pose decides what the others are weighed against: the median
# of the distances is then that of a third of the others, or of fewer. Poses that this is asked of.
_MOST_OF_ONE, _LEAST_POSES = 0.25, 10


class Dwells(NamedTuple):
    """Which rows are one pose."""

    pose: np.ndarray  # (n,) pose of each row, from 0 in the order of their first rows
    first: np.ndarray  # (n_poses,) first row of each
    n_copies: int = 0  # rows that are equal to another pose

    @property
    def merges(self) -> bool:
        return len(self.first) < len(self.pose)

    def mean(self, values: ArrayLike | None) -> Any:
        """Mean over the rows of each pose; of what are no numbers, the first."""
        if values is None or not self.merges:
            return values
        values = np.asarray(values)
        if values.dtype.kind != "f":
            return values[self.first]
        return Groups(self.pose).means(values)

    def mean_angles(self, angles: np.ndarray) -> np.ndarray:
        """Mean angles of each pose, whole turns apart or not."""
        if not self.merges:
            return angles
        origin = angles[self.first]
        return origin + Groups(self.pose).means(within_turn(angles - origin[self.pose]))

    def findings(self) -> Iterator[Finding]:
        """Findings on copies and dwells."""
        n, n_poses = len(self.pose), len(self.first)
        if self.n_copies:
            text = f"{self.n_copies} rows are copies of others, to the last digit: they count once."
            yield Finding("copied-rows", text, weight="note")
        if n_poses + self.n_copies < n:
            text = f"{n} rows are {n_poses} poses: of rows in which the arm stood still the mean"
            yield Finding("dwells", f"{text} counts, with the weight of one.", weight="note")


def find_dwells(
    angles: np.ndarray, codes: np.ndarray | None = None, copies_count: bool = False,
    joint_types: str = "",
) -> Dwells:  # fmt: skip
    """Find the rows that are one pose, by angles (n, n_joints) in rad or mm, in their order.

    Rows of different `codes` (n,) are different poses. Where copies count, runs of equal rows stay:
    a row that is repeated has the weight of its repeats.
    """
    n = len(angles)
    codes = np.zeros(n, dtype=int) if codes is None else codes
    if JointTypes(joint_types).slides:
        angles = angles * JointTypes(joint_types).by_type(1.0, _STILL_RAD / STILL_MM)
    step = np.abs(within_turn(np.diff(angles, axis=0), joint_types)).max(axis=1, initial=0.0)
    # Both ends of a step are within the limit of one mean.
    breaks = np.flatnonzero(~(step <= 2 * _STILL_RAD) | (np.diff(codes) != 0)) + 1
    new = np.ones(n, dtype=bool)
    for low, high in pairwise([0, *breaks, n]):
        if high - low < _LEAST:
            continue
        runs = _runs(within_turn(angles[low:high] - angles[low], joint_types))
        for first, end in pairwise([*low + np.array(runs), high]):
            is_copy = copies_count and np.ptp(angles[first:end], axis=0).max() < _COPY_RAD
            if end - first >= _LEAST and not is_copy:
                new[first + 1 : end] = False
    return Dwells(np.cumsum(new) - 1, np.flatnonzero(new))


def _runs(angles):
    """First rows of the runs within the limit of their running means."""
    if (np.ptp(angles, axis=0) <= _STILL_RAD).all():
        return [0]
    first, total, runs = 0, angles[0].copy(), [0]
    for i in range(1, len(angles)):
        if np.abs(angles[i] - total / (i - first)).max() > _STILL_RAD:
            first, total = i, np.zeros_like(total)
            runs.append(i)
        total += angles[i]
    return runs


def find_poses(
    angles: np.ndarray, codes: np.ndarray | None = None, points: np.ndarray | None = None,
    joint_types: str = "",
) -> Dwells:  # fmt: skip
    """Find the rows that are one pose, copies of rows among them.

    As `find_dwells`; rows are no copies if their measured points (n, 3) differ.
    """
    dwells = find_dwells(angles, codes, joint_types=joint_types)
    codes = np.zeros(len(angles)) if codes is None else codes
    columns = [dwells.mean_angles(angles), codes[dwells.first][:, None]]
    if points is not None:
        columns.append(dwells.mean(points))
    _, first, of = np.unique(np.hstack(columns), axis=0, return_index=True, return_inverse=True)
    if len(first) == len(dwells.first):
        return dwells
    order = np.argsort(first)  # in the order of the first rows again
    pose = np.argsort(order)[of.ravel()][dwells.pose]
    n_copies = len(angles) - int(np.bincount(dwells.pose)[first].sum())
    return Dwells(pose, dwells.first[first[order]], n_copies)


def within_turn(angles: np.ndarray, joint_types: str = "") -> np.ndarray:
    """Angles in rad from -pi to pi; what slides stays as it is, mm."""
    found, slides = np.remainder(angles + np.pi, 2 * np.pi) - np.pi, JointTypes(joint_types).slides
    found[..., slides] = angles[..., slides]
    return found


def angle_faults(
    angles: np.ndarray, reach: float, weights: np.ndarray | None = None
) -> Iterator[Finding]:
    """What is wrong with the angles (n, n_joints) of a fit, in rad, whatever was measured there.

    One pose has most of the weights (n,), or all angles are multiples of a coarse step; `reach` is
    the arm's, mm.
    """
    if weights is not None:
        numbers = np.flatnonzero(weights > 0)
        angles, weights = angles[numbers], weights[numbers]
        _, first, codes = np.unique(angles, axis=0, return_index=True, return_inverse=True)
        worth, total = np.bincount(codes.ravel(), weights), weights.sum()
        most = int(worth.argmax())
        if len(first) >= _LEAST_POSES and worth[most] > _MOST_OF_ONE * total:
            row = Finding.row_numbers(numbers[first[[most]]])
            text = (
                f"The pose of row {row[0]} has {worth[most]:.4g} of all weights, {total:.4g}: the "
                f"{len(first) - 1} other poses would be taken for slips."
            )
            advice = "Give it the weight of one pose, or leave its copies out."
            yield Finding("weight-of-one-pose", text, advice, "repair", rows=row)
    degrees = np.rad2deg(angles)
    n_different = max(len(set(column)) for column in degrees.T[:, : 10 * _LEAST_DIFFERENT])
    for step in _STEPS if n_different >= _LEAST_DIFFERENT else ():
        size = np.deg2rad(step) / np.sqrt(12) * reach
        parts = degrees / step
        if np.abs(parts - np.round(parts)).max() < _OFF and size > _LARGE_MM:
            text = f"All angles are multiples of {step:g} degrees: rounding alone moves the probe"
            advice = "Take them with all digits that the encoders have."
            yield Finding("coarse-angles", f"{text} by {size:.2g} mm.", advice, size_mm=size)
            return
