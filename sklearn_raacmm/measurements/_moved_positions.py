"""Steps in the residuals of one position: its socket, or the arm's base, moved during the test."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.utils import Finding, chunks, encode_groups, row_numbers

# Poses on either side of a step that are compared: what lasts for fewer than three is an outlier;
# beyond ten a slow change of the residuals counts as much as a step.
_WINDOWS, _LEAST = (3, 5, 10), 3
# Squared size of a step over its variance from which on it is one. The largest of 12 000 poses of a
# UR10 is 112; two sockets of a Panda that did move have 889 and 521.
_LIMIT = 150.0
# Ratios that are looked at, their quantile that is compared, and what it is of independent normal
# errors.
_TRIED, _QUANTILE, _USUAL = 200, 0.7, 4.8
# Orders of the rows that are tried, and how many of them may look as orderly as the one given.
_ORDERS, _AS_ORDERLY = 1999, 4
# Rows beside the step whose order is tried: the table of their distances stays small.
_BESIDE = 100
# Rows closer than this in joint space, in rad, are one pose that was recorded several times.
_SAME_POSE = 0.01
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
    spread = _semivariogram(poses, noise_variance)
    kept = poses[~_alone(poses, _OUTLIER * np.sqrt(spread[1][-1]))]
    spread = _widened(spread, kept)
    found = []
    for code in np.unique(kept.codes[_contrasts(kept, spread, _LIMIT) > _LIMIT]).tolist():
        one = kept[kept.codes == code]
        cuts, clearest = _cuts(one, spread)
        if not cuts:
            continue
        sizes = _sizes(one.left, cuts)
        if _in_order(poses[poses.codes == code], one.first[clearest[0]], max(sizes)):
            rows = [(int(one.last[k - 1]), int(one.first[k])) for k in cuts]
            found += [Step(code, *pair, size) for pair, size in zip(rows, sizes, strict=True)]
    return found


def moved_positions(
    left: np.ndarray,
    angles: np.ndarray,
    weights: np.ndarray,
    groups: ArrayLike,
    noise_variance: float,
    numbers: np.ndarray | None = None,
) -> Iterator[Finding]:
    """Positions that have moved during the test, in one finding.

    As `find_steps`, of all rows; those without weight do not count. `numbers` (n,) are what the
    rows are called; None: from 0.
    """
    labels, codes = encode_groups(groups)
    rows = np.flatnonzero(weights > 0)
    steps = find_steps(left[rows], angles[rows], codes[rows], noise_variance)
    rows = rows if numbers is None else numbers[rows]
    if not steps:
        return
    moved = sorted({step.code for step in steps})
    named = []
    for code in moved[:_NAMED]:
        of = [step for step in steps if step.code == code]
        named.append(f"position {labels[code].item()!r} by {_in_words(of, rows)}")
    more = f"; and {len(moved) - _NAMED} others" * (len(moved) > _NAMED)
    yield Finding(
        "moved-position",
        f"{MOVED} {'; '.join(named)}{more}.",
        "No model of the arm can follow that: fasten the socket and the arm's base and measure "
        "again, or give the rows after each step a label of their own.",
        "repair",
        positions=tuple(labels[moved]),
        rows=row_numbers(rows[step.after] for step in steps),
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
    left, codes = left[rows], codes[rows]
    place = np.hstack([np.cos(angles[rows]), np.sin(angles[rows])])
    way = np.linalg.norm(np.diff(place, axis=0, prepend=place[:1]), axis=1)
    new = np.diff(np.floor(np.cumsum(way) / _SAME_POSE), prepend=-1) != 0
    new[1:] |= np.diff(codes) != 0
    first = np.flatnonzero(new)
    kinds = [("left", float, 3), ("place", float, place.shape[1])]
    kinds += [(name, int) for name in ("codes", "first", "last")]
    poses: Any = np.recarray(len(first), kinds)
    if len(first):
        size = np.diff(first, append=len(rows))[:, None]
        poses.left = np.add.reduceat(left, first, axis=0) / size
        poses.place, poses.codes = place[first], codes[first]
        poses.first, poses.last = rows[first], rows[np.r_[first[1:], len(rows)] - 1]
    return poses


def _semivariogram(poses, noise_variance):
    """Half of the mean square difference of a coordinate at two poses, by their distance.

    Distances between which a class lies, and mm^2 of each class: from all pairs that windows may
    hold, by medians, since steps are in few of them.
    """
    distance, square = [], []
    for lag in range(1, 2 * max(_WINDOWS)):
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


def _widened(spread, poses):
    """A semivariogram such that most differences of runs of poses are as large as expected.

    A model that is far from complete leaves errors that change faster in some directions of joint
    space than the distance shows.
    """
    edges, half = spread
    tried = np.linspace(0, len(poses), _TRIED, endpoint=False).astype(int)
    ratio = _contrasts(poses, spread, 0.0, np.unique(tried))
    ratio = ratio[ratio >= 0]
    wider = np.quantile(ratio, _QUANTILE) / _USUAL if len(ratio) else 1.0
    return edges, half * max(wider, 1.0)


def _variance_of_difference(place, n_before, spread):
    """Variance of a coordinate of the difference of the means of two runs of poses."""
    edges, half = spread
    apart = np.linalg.norm(place[:, None] - place, axis=2)
    between = half[np.searchsorted(edges, apart)]
    np.fill_diagonal(between, 0.0)
    a, b = slice(n_before), slice(n_before, None)
    found = 2 * between[a, b].mean() - between[a, a].mean() - between[b, b].mean()
    return max(found, half[0] * (1 / n_before + 1 / (len(place) - n_before)))


def _alone(poses, limit):
    """Poses that differ from the median of the five about them: a step of three is kept."""
    start, end = _bounds(poses.codes)
    middle = np.clip(np.arange(len(start)), start + 2, end - 3)
    about = np.median(poses.left[middle[:, None] + np.arange(-2, 3)], axis=1)
    return np.linalg.norm(poses.left - about, axis=1) > limit


def _bounds(codes):
    """First row of the position of each row, and the row behind its last."""
    first = np.flatnonzero(np.diff(codes, prepend=-1) != 0)
    size = np.diff(first, append=len(codes))
    return np.repeat(first, size), np.repeat(first + size, size)


def _contrasts(poses, spread, limit, k=None):
    """Squared step before each pose over its variance; a bound of it where that is below `limit`.

    The largest of three lengths of the windows; negative where a position has too few poses on
    one side.
    """
    k = np.arange(len(poses.codes)) if k is None else k
    start, end = (ends[k] for ends in _bounds(poses.codes))
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(poses.left, axis=0)])
    largest = np.full(len(k), -np.inf)
    for window in _WINDOWS:
        low, high = np.maximum(start, k - window), np.minimum(end, k + window)
        before, after = np.maximum(k - low, 1), high - k
        step = (sums[high] - sums[k]) / after[:, None] - (sums[k] - sums[low]) / before[:, None]
        square = np.square(step).sum(axis=1)
        square[(k - start < _LEAST) | (end - k < _LEAST)] = -1.0
        bound = square / (spread[1][0] * (1 / before + 1 / after))
        for i in np.flatnonzero(bound > np.maximum(limit, largest)):
            place = poses.place[low[i] : high[i]]
            bound[i] = square[i] / _variance_of_difference(place, before[i], spread)
        largest = np.maximum(largest, bound)
    return largest


def _cuts(poses, spread):
    """First poses behind the steps of one position, in their order, and that of the clearest."""
    found, parts = [], [(0, len(poses.codes))]
    while parts:
        low, high = parts.pop()
        if high - low < 2 * _LEAST:
            continue
        ratio = _contrasts(poses[low:high], spread, _LIMIT)
        k = int(np.argmax(ratio))
        if ratio[k] > _LIMIT:
            k = _sharpest(poses.left, low, low + k, high)
            found.append(k)
            parts += [(low, k), (k, high)]
    return sorted(found), found[:1]


def _sharpest(left, low, k, high):
    """Of the cuts near k that with the least distances from the medians on its two sides."""
    width = max(_WINDOWS)
    a, b = max(low, k - width), min(high, k + width)
    tried = range(max(low + _LEAST, k - _LEAST), min(high - _LEAST, k + _LEAST) + 1)

    def distances(i):
        sides = np.split(left[a:b], [i - a])
        return sum(np.linalg.norm(s - np.median(s, axis=0), axis=1).sum() for s in sides)

    return min(tried, key=distances)


def _sizes(left, cuts):
    """How far the means on either side of each cut are apart, between it and its neighbours."""
    n, found = max(_WINDOWS), []
    for before, after in pairwise(np.split(left, cuts)):
        step = after[:n].mean(axis=0) - before[-n:].mean(axis=0)
        found.append(float(np.linalg.norm(step)))
    return found


def _in_order(poses, row, size):
    """Whether few other orders of the poses about a row make a way as short as theirs.

    Outliers, farther off than the size of the step, count as though they were as far.
    """
    k = int(np.searchsorted(poses.first, row))
    left = poses.left[max(0, k - _BESIDE) : k + _BESIDE]
    apart = np.minimum(np.linalg.norm(left[:, None] - left, axis=2), size)
    rng, n = np.random.default_rng(0), len(left)
    way = apart[np.arange(n - 1), np.arange(1, n)].sum()
    shorter = 0
    for tried in chunks(_ORDERS, 200):
        order = rng.permuted(np.tile(np.arange(n), (tried.stop - tried.start, 1)), axis=1)
        shorter += np.count_nonzero(apart[order[:, :-1], order[:, 1:]].sum(axis=1) <= way)
    return shorter <= _AS_ORDERLY
