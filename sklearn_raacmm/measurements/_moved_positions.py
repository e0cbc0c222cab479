"""Steps in the residuals of one position: its socket, or the arm's base, moved during the test."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.measurements._dwells import find_dwells
from sklearn_raacmm.measurements._explanations import Explanation
from sklearn_raacmm.utils import Finding, Groups

# Poses that are looked at together, and the fewest on either side of a step: what lasts for fewer
# than three is an outlier.
_WINDOWS, _LEAST = (10, 20), 3
# What a model leaves of the arm: its variance in units of that of the noise, and the distance of
# two poses, in cosines and sines of the angles, at which it fades. A step has to be likely by each.
# Poses that the noise of the whole test counts as, beside those of a window. Of 32 clean tests in
# three orders none is named, of steps of 0.3 mm 9 of 12 (``benchmarks/bench_check.py steps``).
_MISFITS, _USUAL = ((3.0, 1.0), (300.0, 4.0)), 10
# Medians of all poses beyond which a pose that differs from those about it is left out.
_OUTLIER = 8.0
# Orders of the rows that are tried, and how many of them may look as orderly as the one given.
_ORDERS, _AS_ORDERLY = 1999, 4
# Rows beside the step whose order is tried: the table of their distances stays small.
_BESIDE = 100
# Poses on either side whose means are the size of a step: beyond ten a slow change counts as much.
_MOST = 10
# No arm measures with less noise, in mm: rounding is no step.
_LEAST_NOISE_MM = 1e-3
_NAMED = 3  # positions that the sentence names
MOVED = "The fixed point seems to have moved during the test:"


class Step(NamedTuple):
    """A step of the residuals between two rows of one position."""

    code: int
    before: int  # the last row before it
    after: int  # the first row after it
    size_mm: float


def find_steps(left: np.ndarray, angles: np.ndarray, codes: np.ndarray) -> list[Step]:
    """Steps of residuals (n, 3) in mm in the order of the rows, position by position.

    What a model leaves at two poses of one position differs the more, the farther the poses are
    apart, but it does not jump between two rows. So a step is as likely as a constant that changes
    there, beside a process of the pose and noise, see `_nats`. Positions are divided at the
    likeliest step, then their parts. Outliers are no steps; in rows that were shuffled neighbours
    differ as much as others do, and nothing is found.
    """
    whole: Any = [one for one in _sorted_poses(left, angles, codes) if len(one) >= 2 * _LEAST]
    if not whole:
        return []
    away = []
    for one in whole:  # from the median of the five poses about each: a step of three is kept
        middle = np.clip(np.arange(len(one)), 2, len(one) - 3)
        about = np.median(one.left[middle[:, None] + np.arange(-2, 3)], axis=1)
        away.append(np.linalg.norm(one.left - about, axis=1))
    limit = _OUTLIER * max(np.median(np.concatenate(away)), _LEAST_NOISE_MM)
    pairs = [(one, one[far <= limit]) for one, far in zip(whole, away, strict=True)]
    looked_at = [(*pair, _squares(pair[1])) for pair in pairs if len(pair[1]) >= 2 * _LEAST]
    if not looked_at:
        return []
    # As large as noise in most of the windows: steps are in few of them.
    spread = np.concatenate([rest / n_free for *_, (_, n_free, rest, _) in looked_at], axis=1)
    usual = np.maximum(np.median(spread, axis=1, keepdims=True), _LEAST_NOISE_MM**2)
    found = []
    for every_pose, one, of_all in looked_at:
        cuts: list[int] = []
        parts: Any = [(0, one, of_all)]
        while parts:
            low, part, squares = parts.pop()
            for cut in Explanation.likeliest(_nats(squares, usual, len(left)))[:1]:
                cuts.append(low + cut)
                halves = (low, part[:cut]), (low + cut, part[cut:])
                parts += [
                    (*half, _squares(half[1])) for half in halves if len(half[1]) >= 2 * _LEAST
                ]
        steps = []
        divided: Any = np.split(one, sorted(cuts))
        for before, after in pairwise(divided):
            step = after.left[:_MOST].mean(axis=0) - before.left[-_MOST:].mean(axis=0)
            rows = int(before.last[-1]), int(after.first[0])
            steps.append(Step(int(one.codes[0]), *rows, float(np.linalg.norm(step))))
        if steps and _in_order(every_pose, one.first[cuts[0]], max(s.size_mm for s in steps)):
            found += steps
    return found


def moved_positions(
    left: np.ndarray, angles: np.ndarray, groups: ArrayLike, numbers: np.ndarray
) -> Iterator[Finding]:
    """Positions that have moved during the test, in one finding.

    As `find_steps`; `numbers` (n,) are what the rows are called.
    """
    labels, codes = Groups.encoded(groups)
    steps = find_steps(left, angles, codes)
    if not steps:
        return
    moved = sorted({step.code for step in steps})
    named = []
    for code in moved[:_NAMED]:
        largest = max((one for one in steps if one.code == code), key=lambda one: one.size_mm)
        before, after = Finding.row_numbers(numbers[[largest.before, largest.after]])
        where = f"{largest.size_mm:.3g} mm between rows {before} and {after}"
        named.append(f"position {labels.tolist()[code]!r} by {where}")
    more = f"; and {len(moved) - _NAMED} others" * (len(moved) > _NAMED)
    yield Finding(
        "moved-position",
        f"{MOVED} {'; '.join(named)}{more}.",
        "No model of the arm can follow that: fasten the socket and the arm's base and measure "
        "again, or give the rows after each step a label of their own.",
        "repair",
        positions=tuple(labels[moved]),
        rows=Finding.row_numbers(numbers[step.after] for step in steps),
        size_mm=max(step.size_mm for step in steps),
    )


def _sorted_poses(left, angles, codes):
    """Poses of each position in the order of their rows; rows in a row at one pose are one.

    Record arrays: `left` (n, 3) mm, `place` (n, 2 n_joints) cosines and sines of the angles,
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
    return np.split(poses, np.flatnonzero(np.diff(poses.codes)) + 1)


def _squares(one):
    """Of every step in some window of poses, how it changes the squares in its direction.

    The pose behind it and how many coordinates are free, (n,), and for each misfit the squares that
    are left and those taken away, (2, n), beside a constant, in units of the noise.
    """
    found = []
    for m in sorted({min(m, len(one)) for m in _WINDOWS}):
        at = np.arange(len(one) - m + 1)[:, None] + np.arange(m)
        place, cuts = one.place[at], np.arange(_LEAST, m - _LEAST + 1)
        apart = place.shape[2] - 2 * place @ place.swapaxes(1, 2)
        steps = np.broadcast_to(np.arange(m)[:, None] >= cuts, (len(at), m, len(cuts)))
        columns = np.concatenate([np.ones((len(at), m, 1)), steps, one.left[at]], axis=2)
        both = []
        for size, fades in _MISFITS:
            root = np.linalg.cholesky(np.eye(m) + size * np.exp(-apart / (2 * fades**2)))
            white = np.linalg.solve(root, columns)
            constant = white[:, :, :1] / np.linalg.norm(white[:, :, :1], axis=1, keepdims=True)
            white = white - constant @ (constant.swapaxes(1, 2) @ white)
            steps, y = white[:, :, 1:-3], white[:, :, -3:]
            move = (steps / np.linalg.norm(steps, axis=1, keepdims=True)).swapaxes(1, 2) @ y
            taken = np.square(move).sum(axis=2)
            along = y @ (move / np.sqrt(np.maximum(taken, 1e-300))[:, :, None]).swapaxes(1, 2)
            rest = np.maximum(np.square(along).sum(axis=1) - taken, 0.0)
            both.append([rest.ravel(), taken.ravel()])
        behind = (at[:, :1] + cuts).ravel()
        found.append((behind, np.full(len(behind), m - 2), *np.stack(both, axis=1)))
    return [np.concatenate(part, axis=-1) for part in zip(*found, strict=True)]


def _nats(squares, usual, n_tried):
    """By how much every step of `_squares` is likelier than none, nats, and the pose behind it.

    The noise is found with it and without it, of the window beside so many poses of the `usual`
    variance, mm^2.
    """
    behind, n_free, rest, taken = squares
    nats = (n_free + _USUAL) / 2 * np.log1p(taken / (rest + _USUAL * usual)) - np.log(n_tried)
    return zip(nats.min(axis=0).tolist(), behind.tolist(), strict=True)


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
