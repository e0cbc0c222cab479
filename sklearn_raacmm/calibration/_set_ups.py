"""Two set-ups in one table: the tracker, the base or the tool moved between two rows."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator

import numpy as np

from sklearn_raacmm.calibration._fit import rows_with
from sklearn_raacmm.measurements import Explanation, base_motions, best_split
from sklearn_raacmm.utils import Finding

# Share of the squares that a set-up of its own behind a row has to take away, beside what chance
# does (``benchmarks/bench_check.py set-ups``; parts of the real UR10 show up to 0.41).
_SHARE = 0.5
# Rows on either side of a move that are compared with and without it, and the nats by which they
# have to be likelier with it: log odds of one in a thousand, and 30 rows that it may be behind.
_BESIDE, _JUMP = 10, 10.0
# Rows that are looked at: of 20 000 the columns of a table take 16 MB for each coordinate.
_MOST_ROWS = 20_000
# No move is smaller: rounding is none.
_LEAST_MM = 0.005


def thinned(codes: np.ndarray | None, n: int) -> np.ndarray:
    """Numbers of the rows that are looked at, in their order: every kth of each code (n,), if any.

    All of few rows. What moves stays where it is for more than k rows.
    """
    order = np.arange(n) if codes is None else np.argsort(codes, kind="stable")
    return np.sort(order[:: max(-(-n // _MOST_ROWS), 1)])


def moved_set_up(fit, numbers) -> Iterator[Finding]:
    """A tracker, a base or a tool that moved during the measurement, a finding for each station.

    What was given as one station may be two. `numbers` (n,) are what the rows are called.
    """
    measured = fit.measured
    if measured.points is None or measured.n_tools > 1:
        return
    some = thinned(measured.stations, len(fit.angles))
    points, columns = fit.located_at(fit.x, some)
    columns, left, numbers = columns[:, :, fit.is_free], fit.residuals()[some], numbers[some]
    ridge = np.square(fit.sigma / fit.prior_sd[fit.is_free])  # of the priors, in the normal matrix
    root = np.sqrt(fit.weights[some])[:, None, None]
    # A tool moves with the last link.
    turns = fit.arm().frames(fit.angles[some])[:, -1, :3, :3]
    effects = {"stations": base_motions(points, np.abs(points).max()), "tools": turns}
    every, n_stations = np.arange(len(left)), measured.n_stations
    stations = None if measured.stations is None else measured.stations[some]
    of_stations = [every[rows_with(stations, one)] for one in range(n_stations)]
    bases = np.zeros((*left.shape, n_stations, 6))
    for one, own in enumerate(of_stations):
        bases[own, :, one] = effects["stations"][own]
    columns = root * np.concatenate([columns, bases.reshape(*left.shape, -1)], axis=2)
    ridge, left = np.r_[ridge, np.zeros(6 * n_stations)], root[:, :, 0] * left
    for own in of_stations:
        if len(own) >= 3 * Explanation.LEAST_ROWS:
            yield from _moved_in(own, left, columns, ridge, root, effects, numbers)


def _moved_in(own, left, columns, ridge, root, effects, numbers):
    """The finding that something moved between two of a station's `own` rows."""
    found = {w: best_split(left, columns, ridge, root * effects[w], own) for w in effects}
    what = max(found, key=lambda name: found[name][0])
    share, row, move, rest = found[what]
    usual = len(move) / (3 * len(own)) * np.log(len(own))  # the best of n splits of noise
    size = np.linalg.norm(effects[what][own[row:]] @ move, axis=1).mean()
    if share < _SHARE + usual or _jump(left[own], rest[own], row) < _JUMP or size < _LEAST_MM:
        return
    before, after = Finding.row_numbers(numbers[own[[row - 1, row]]])
    moved = "the tracker or the arm's base" if what == "stations" else "the probe or target"
    text = f"The measured points jump beside the arm's, as if {moved} had moved by {size:.3g} mm"
    advice = f"Give each part a label of its own, {what}=labels, or measure again."
    yield Finding(
        f"moved-{what.removesuffix('s')}",
        f"{text} between rows {before} and {after}.",
        advice,
        "repair",
        rows=(after,),
        size_mm=size,
    )


def _jump(left, rest, row):
    """Nats by which residuals about a row are likelier with a set-up behind it, (n, 3) each.

    Of a path that no model follows two halves are fitted better, too, but what is left then jumps
    where it did not: about the row, beside a line in the number of the row, it is compared.
    """
    rows = np.arange(max(row - _BESIDE, 0), min(row + _BESIDE, len(left)))
    line = np.linalg.qr(np.column_stack([np.ones(len(rows)), rows - row]))[0]
    squares = [np.square(part[rows] - line @ (line.T @ part[rows])).sum() for part in (left, rest)]
    return 1.5 * len(rows) * np.log(squares[0] / max(squares[1], 1e-300))
