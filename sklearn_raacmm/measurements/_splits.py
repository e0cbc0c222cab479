"""A set-up that changed between two rows: what another base or probe behind a row explains."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

# Rows on either side of a change.
LEAST_ROWS = 8
# Part of the squares of a move that is added: rows at one place cannot show a turn.
_RIDGE = 1e-4


def best_split(
    left: np.ndarray, columns: np.ndarray, ridge: np.ndarray, extra: np.ndarray, own: np.ndarray
) -> tuple[float, int, np.ndarray, np.ndarray]:
    r"""Share of the squares of `own` rows that a move behind one takes away, and where it does.

    Behind every row in turn what was left (n, 3) is given a move of its own: with H the normal
    matrix of the `columns` C (n, 3, p) of what was fitted, on its diagonal the `ridge` (p,), and E
    those `extra` (n, 3, q) of the move the squares fall by :math:`g' S^{-1} g`, :math:`g = E'r` and
    :math:`S = E'E - E'C H^{-1} C'E`.

    Returns the share, the number among the `own` rows (n_own,), at least three times `LEAST_ROWS`,
    the move (q,) and what is then left of all rows (n, 3).
    """
    flat = columns.reshape(-1, columns.shape[2])
    inverse = np.linalg.pinv(flat.T @ flat + np.diag(ridge), hermitian=True)
    move_of = extra[own]

    def behind(values):  # sums over the row and all after it
        return np.cumsum(values[::-1], axis=0)[::-1]

    squares = behind(np.einsum("ncq,ncr->nqr", move_of, move_of))
    shared = behind(np.einsum("ncq,ncp->nqp", move_of, columns[own]))
    slope = behind(np.einsum("ncq,nc->nq", move_of, left[own]))
    rows = np.arange(LEAST_ROWS, len(own) - LEAST_ROWS)
    rest = squares[rows] - shared[rows] @ inverse @ shared[rows].transpose(0, 2, 1)
    # What the rows cannot tell from the fit is no move.
    scale = np.trace(squares[rows], axis1=1, axis2=2)[:, None, None] * np.eye(extra.shape[2])
    moves = np.linalg.solve(rest + _RIDGE * scale, slope[rows][:, :, None])[:, :, 0]
    gains = np.einsum("nq,nq->n", slope[rows], moves)
    best = int(np.argmax(gains))
    row, move = int(rows[best]), moves[best]
    rest = left + columns @ (inverse @ (move @ shared[row]))
    rest[own[row:]] -= move_of[row:] @ move
    return float(gains[best] / max(np.square(left[own]).sum(), 1e-300)), row, move, rest
