"""Two set-ups in one table: the tracker, the base or the tool moved between two rows."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator
from typing import Any

import numpy as np

from sklearn_raacmm.measurements import base_motions
from sklearn_raacmm.utils import Finding, row_numbers

# Share of the squares that a set-up of its own behind a row has to take away, beside what chance
# does (``benchmarks/bench_check.py set-ups``; parts of the real UR10 show up to 0.41), and rows
# beside.
_SHARE, _LEAST_ROWS = 0.5, 8
# Rows on either side of a move that are compared with and without it, and the nats by which they
# have to be likelier with it: log odds of one in a thousand, and 30 rows that it may be behind.
_BESIDE, _JUMP = 10, 10.0
# No move is smaller: rounding is none.
_LEAST_MM = 0.005
# Part of the squares of a move that is added: rows at one place cannot show a turn.
_RIDGE = 1e-4


def moved_set_up(fit: Any, numbers: Any) -> Iterator[Finding]:
    r"""A tracker, a base or a tool that moved during the measurement, in one finding.

    A calibration of all rows takes up what it can of the move. Behind every row in turn the rest is
    given a base, or a probe, of its own: with H the normal matrix of the columns C of what was
    fitted and E those of the new set-up the squares fall by :math:`g' S^{-1} g`, :math:`g = E'r`
    and :math:`S = E'E - E'C H^{-1} C'E`. `numbers` (n,) are what the rows are called.
    """
    n, problem = len(fit.angles), fit.problem
    several = problem.points is None or problem.n_stations > 1 or problem.n_tools > 1
    if several or n < 3 * _LEAST_ROWS:
        return
    points, columns = fit.points_and_jacobian(fit.x)
    columns, left = columns[:, :, fit.is_free], fit.residuals()
    ridge = np.square(fit.sigma / fit.prior_sd[fit.is_free])  # of the priors, in the normal matrix
    # A tool moves with the last link.
    turns = fit.arm().frames(fit.angles)[:, -1, :3, :3]
    effects = {"stations": base_motions(points, np.abs(points).max()), "tools": turns}
    root = np.sqrt(fit.weights)[:, None, None]
    columns = root * np.concatenate([columns, effects["stations"]], axis=2)
    ridge, left = np.r_[ridge, np.zeros(6)], root[:, :, 0] * left
    found = {what: _best_split(left, columns, ridge, root * effects[what]) for what in effects}
    what = max(found, key=lambda name: found[name][0])
    share, row, move, rest = found[what]
    usual = len(move) / (3 * n) * np.log(n)  # the best of n splits of noise
    size = np.linalg.norm(effects[what][row:] @ move, axis=1).mean()
    if share < _SHARE + usual or _jump(left, rest, row) < _JUMP or size < _LEAST_MM:
        return
    before, after = row_numbers(numbers[[row - 1, row]])
    moved = "the tracker or the arm's base" if what == "stations" else "the probe or target"
    text = f"The measured points jump beside the arm's, as if {moved} had moved by {size:.3g} mm"
    advice = f"Give each part a label of its own, calibrate(..., {what}=labels), or measure again."
    yield Finding(
        f"moved-{what.removesuffix('s')}",
        f"{text} between rows {before} and {after}.",
        advice,
        "repair",
        rows=(after,),
        size_mm=size,
    )


def _best_split(left, columns, ridge, extra):
    """Share of the squares that a set-up behind a row takes away, the row, the move, the rest."""
    n, _, p = columns.shape
    flat = columns.reshape(-1, p)
    normal = flat.T @ flat + np.diag(ridge)
    inverse = np.linalg.pinv(normal, hermitian=True)

    def behind(values):  # sums over the row and all after it
        return np.cumsum(values[::-1], axis=0)[::-1]

    own = behind(np.einsum("ncq,ncr->nqr", extra, extra))
    shared = behind(np.einsum("ncq,ncp->nqp", extra, columns))
    slope = behind(np.einsum("ncq,nc->nq", extra, left))
    rows = np.arange(_LEAST_ROWS, n - _LEAST_ROWS)
    rest = own[rows] - shared[rows] @ inverse @ shared[rows].transpose(0, 2, 1)
    # What the rows cannot tell from the fit is no move.
    scale = np.trace(own[rows], axis1=1, axis2=2)[:, None, None] * np.eye(extra.shape[2])
    moves = np.linalg.solve(rest + _RIDGE * scale, slope[rows][:, :, None])[:, :, 0]
    gains = np.einsum("nq,nq->n", slope[rows], moves)
    best = int(np.argmax(gains))
    total = max(np.square(left).sum(), 1e-300)
    row, move = int(rows[best]), moves[best]
    rest = left + columns @ (inverse @ (move @ shared[row]))
    rest[row:] -= extra[row:] @ move
    return float(gains[best] / total), row, move, rest


def _jump(left, rest, row):
    """Nats by which residuals about a row are likelier with a set-up behind it, (n, 3) each.

    Of a path that no model follows two halves are fitted better, too, but what is left then jumps
    where it did not: about the row, beside a line in the number of the row, it is compared.
    """
    rows = np.arange(max(row - _BESIDE, 0), min(row + _BESIDE, len(left)))
    line = np.linalg.qr(np.column_stack([np.ones(len(rows)), rows - row]))[0]
    squares = [np.square(part[rows] - line @ (line.T @ part[rows])).sum() for part in (left, rest)]
    return 1.5 * len(rows) * np.log(squares[0] / max(squares[1], 1e-300))
