"""Steps in the residuals of one position: its socket, or the arm's base, moved during the test."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.measurements._dwells import find_dwells
from sklearn_raacmm.utils import Finding, encode_groups, row_numbers

# Poses on either side of a step that are compared, and the fewest: what lasts for fewer than three
# is an outlier; beyond ten a slow change of the residuals counts as much as a step.
_MOST, _LEAST = 10, 3
# Squared size of a step over its variance from which on it is one. With the largest of windows of
# 3, 5 and 10 poses the largest of 12 000 poses of a UR10 was 112, and two sockets of a Panda that
# did move had 889 and 521; with windows of 10 `benchmarks/bench_check.py steps` has no false alarm.
_LIMIT = 150.0
# Ratios that are looked at, their quantile that is compared, and what it is of independent normal
# errors: chi-squared of three freedoms.
_TRIED, _QUANTILE, _USUAL = 200, 0.7, 3.66
# Orders of the rows that are tried, and how many of them may look as orderly as the one given.
_ORDERS, _AS_ORDERLY = 1999, 4
# Rows beside the step whose order is tried: the table of their distances stays small.
_BESIDE = 100
# Squared length of a normal error in three coordinates, in the median, in units of its variance.
_MEDIAN_SQUARE = 2.366
# Distances of poses are divided into so many classes, of at least so many pairs each.
_CLASSES, _PAIRS = 10, 50
# Standard deviations beyond which a pose that differs from its neighbours in the order is left out.
_OUTLIER = 8.0
# No arm measures with less noise, in mm: rounding is no step.
_LEAST_NOISE_MM = 1e-3
# Positions, and steps of each, that the sentence names.
_NAMED = 3
MOVED = "The fixed point seems to have moved during the test:"


class Step(NamedTuple):
    """A step of the residuals between two rows of one position."""

    code: int
    before: int  # the last row before it
    after: int  # the first row after it
    size_mm: float


def find_steps(
    left: np.ndarray, angles: np.ndarray, codes: np.ndarray, noise_variance: float = 0.0
) -> list[Step]:
    r"""Steps of residuals (n, 3) in mm in the order of the rows, position by position.

    What a model leaves at two poses of one position differs the more, the farther the poses are
    apart, but it does not jump between two rows while poses as far apart elsewhere agree. With A
    and B the poses before and after a possible step, :math:`\gamma(h)` half of the mean square
    difference of two poses at the distance h in joint space (the semivariogram, from medians of all
    positions), the difference of the two means has the variance

    .. math:: 2 \bar\gamma(A, B) - \bar\gamma(A, A) - \bar\gamma(B, B)

    in every coordinate, with at least the noise variance in :math:`\gamma`. Positions are divided
    at the largest ratio, then their parts. Outliers are no steps; in rows that were shuffled
    neighbours differ as much as others do, and nothing is found.
    """
    poses = _sorted_poses(left, angles, codes)
    poses = poses[np.bincount(poses.codes)[poses.codes] >= 2 * _LEAST]
    if not len(poses):
        return []
    edges, half = _semivariogram(poses, noise_variance)
    whole = [poses[poses.codes == code] for code in np.unique(poses.codes)]
    kept = [one[~_alone(one.left, _OUTLIER * np.sqrt(half[-1]))] for one in whole]
    # A model that is far from complete leaves errors that change faster in some directions of joint
    # space than the distance shows: most differences of runs are to be as large as expected.
    every = max(len(poses) // _TRIED, 1)
    usual = np.concatenate([_contrasts(one, (edges, half), 0.0, every)[0] for one in kept])
    wider = np.quantile(usual, _QUANTILE) / _USUAL if len(usual) else 1.0
    spread, found = (edges, half * max(wider, 1.0)), []
    for every_pose, one in zip(whole, kept, strict=True):
        cuts, steps = _cuts(one, spread), []
        parts: Any = np.split(one, sorted(cuts))
        for before, after in pairwise(parts):
            step = after.left[:_MOST].mean(axis=0) - before.left[-_MOST:].mean(axis=0)
            rows = int(before.last[-1]), int(after.first[0])
            steps.append(Step(int(one.codes[0]), *rows, float(np.linalg.norm(step))))
        largest = max((step.size_mm for step in steps), default=0.0)
        if steps and _in_order(every_pose, one.first[cuts[0]], largest):
            found += steps
    return found


def moved_positions(
    left: Any, angles: Any, groups: ArrayLike, noise_variance: float, numbers: Any
) -> Iterator[Finding]:
    """Positions that have moved during the test, in one finding.

    As `find_steps`; `numbers` (n,) are what the rows are called.
    """
    labels, codes = encode_groups(groups)
    steps = find_steps(left, angles, codes, noise_variance)
    if not steps:
        return
    moved = sorted({step.code for step in steps})
    named = []
    for code in moved[:_NAMED]:
        of = [step for step in steps if step.code == code]
        named.append(f"position {labels[code].item()!r} by {_in_words(of, numbers)}")
    more = f"; and {len(moved) - _NAMED} others" * (len(moved) > _NAMED)
    yield Finding(
        "moved-position",
        f"{MOVED} {'; '.join(named)}{more}.",
        "No model of the arm can follow that: fasten the socket and the arm's base and measure "
        "again, or give the rows after each step a label of their own.",
        "repair",
        positions=tuple(labels[moved]),
        rows=row_numbers(numbers[step.after] for step in steps),
        size_mm=max(step.size_mm for step in steps),
    )


def _in_words(steps, rows):
    """The largest steps, in their order."""
    largest = sorted(sorted(steps, key=lambda step: -step.size_mm)[:_NAMED], key=steps.index)
    parts = []
    for step in largest:
        before, after = row_numbers(rows[[step.before, step.after]])
        parts.append(f"{step.size_mm:.3g} mm between rows {before} and {after}")
    more = f" and {len(steps) - _NAMED} more times" * (len(steps) > _NAMED)
    return f"{', by '.join(parts)}{more}"


def _sorted_poses(left, angles, codes):
    """Poses, position by position in the order of their rows; rows in a row at one pose are one.

    A record array: `left` (n, 3) mm, `place` (n, 2 n_joints) cosines and sines of the angles,
    `codes`, and the `first` and the `last` row of each pose.
    """
    rows = np.argsort(codes, kind="stable")
    dwells = find_dwells(angles[rows], codes[rows])
    first, last = rows[dwells.first], np.append(rows[dwells.first[1:] - 1], rows[-1:])
    kinds = [("left", float, 3), ("place", float, 2 * angles.shape[1])]
    kinds += [(name, int) for name in ("codes", "first", "last")]
    poses: Any = np.recarray(len(first), kinds)
    poses.first, poses.last, poses.codes = first, last, codes[first]
    poses.left = dwells.mean(left[rows])
    poses.place = np.hstack([np.cos(angles[first]), np.sin(angles[first])])
    return poses


def _semivariogram(poses, noise_variance):
    """Half of the mean square difference of a coordinate at two poses, by their distance.

    Distances between which a class lies, and mm^2 of each class: from all pairs that windows may
    hold, by medians, since steps are in few of them.
    """
    distance, square = [], []
    for lag in range(1, 2 * _MOST):
        same = np.flatnonzero(poses.codes[lag:] == poses.codes[:-lag])
        for values, out in ((poses.place, distance), (poses.left, square)):
            out.append(np.square(values[same + lag] - values[same]).sum(axis=1))
    distance, square = np.sqrt(np.concatenate(distance)), np.concatenate(square)
    n = max(min(_CLASSES, len(distance) // _PAIRS), 1)
    edges = np.quantile(distance, np.arange(1, n) / n)
    of = np.searchsorted(edges, distance)
    medians = [np.median(square[of == i]) if np.any(of == i) else 0.0 for i in range(n)]
    half = np.maximum.accumulate(np.array(medians) / (2 * _MEDIAN_SQUARE))
    return edges, np.maximum(half, max(noise_variance, _LEAST_NOISE_MM**2))


def _variance_of_difference(place, n_before, spread):
    """Variance of a coordinate of the difference of the means of two runs of poses."""
    edges, half = spread
    apart = np.linalg.norm(place[:, None] - place, axis=2)
    between = half[np.searchsorted(edges, apart)]
    np.fill_diagonal(between, 0.0)
    a, b = slice(n_before), slice(n_before, None)
    found = 2 * between[a, b].mean() - between[a, a].mean() - between[b, b].mean()
    return max(found, half[0] * (1 / n_before + 1 / (len(place) - n_before)))


def _alone(left, limit):
    """Poses that differ from the median of the five about them: a step of three is kept."""
    middle = np.clip(np.arange(len(left)), 2, len(left) - 3)
    about = np.median(left[middle[:, None] + np.arange(-2, 3)], axis=1)
    return np.linalg.norm(left - about, axis=1) > limit


def _contrasts(one, spread, limit, every=1):
    """Squared steps in one position over their variances, and over those of noise alone.

    Before each pose from the fourth to the third from the end; the first are bounds where they are
    below `limit`.
    """
    k = np.arange(_LEAST, len(one) - _LEAST + 1, every)
    low, high = np.maximum(0, k - _MOST), np.minimum(len(one), k + _MOST)
    before, after = k - low, high - k
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(one.left, axis=0)])
    step = (sums[high] - sums[k]) / after[:, None] - (sums[k] - sums[low]) / before[:, None]
    square = np.square(step).sum(axis=1)
    of_noise = square / (spread[1][0] * (1 / before + 1 / after))
    ratio = of_noise.copy()
    for i in np.flatnonzero(of_noise > limit):
        ratio[i] = square[i] / _variance_of_difference(
            one.place[low[i] : high[i]], before[i], spread
        )
    return ratio, of_noise


def _cuts(one, spread):
    """First poses behind the steps of one position, the clearest first."""
    found, parts = [], [(0, len(one))]
    while parts:
        low, high = parts.pop()
        ratio, of_noise = _contrasts(one[low:high], spread, _LIMIT)
        if np.any(ratio > _LIMIT):
            k = low + _LEAST + int(np.argmax(np.where(ratio > _LIMIT, of_noise, 0.0)))
            found.append(k)
            parts += [(low, k), (k, high)]
    return found


def _in_order(poses, row, size):
    """Whether few other orders of the poses about a row make a way as short as theirs.

    Outliers, farther off than the size of the step, count as though they were as far.
    """
    k = int(np.searchsorted(poses.first, row))
    left = poses.left[max(0, k - _BESIDE) : k + _BESIDE]
    apart = np.minimum(np.linalg.norm(left[:, None] - left, axis=2), size)
    rng, n = np.random.default_rng(0), len(left)
    orders = (rng.permutation(n) for _ in range(_ORDERS))
    ways = np.array([apart[order[:-1], order[1:]].sum() for order in orders])
    return np.sum(ways <= np.diag(apart, 1).sum()) <= _AS_ORDERLY
