"""Penalised least squares on nested subsets, from one QR of the true columns."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.linalg import lapack, qr, solve_triangular

# Columns that a triangular factorisation works on together; 16 and 64 were slower by a tenth.
_PANEL = 32


def triangular_factor(rows):
    """R of the QR factorisation, upper triangular or trapezoidal; its signs are arbitrary."""
    m, k = rows.shape
    if m < k or not k:
        return qr(rows, mode="r", overwrite_a=True, check_finite=False)[0][:k]
    return _stacked(np.zeros((k, k), order="F"), np.array(rows, order="F"), 0)


def _stacked(upper, lower, n_triangular):
    """R of the square triangle `upper` with rows below, the last a triangle; overwrites both.

    Twice as fast as the plain routine, whose blocks do not stay in the cache.
    """
    block = min(_PANEL, len(upper))
    return lapack.dtpqrt(n_triangular, block, upper, lower, overwrite_a=1, overwrite_b=1)[0]


def stack_triangles(upper, lower):
    """The triangular factor of two blocks of rows from those of each."""
    k = upper.shape[1]
    if len(upper) < k or not k:
        return triangular_factor(np.vstack([upper, lower]))
    triangular = not np.any(np.tril(lower, -1))
    upper, lower = np.array(upper, order="F"), np.array(lower, order="F")
    return _stacked(upper, lower, len(lower) if triangular else 0)


def nested_least_squares(R, n_tail, penalty_root, alphas, within, tail_dof=None):
    """Solve every nested subset, with no use of the running figures of the selection.

    R (<= p + k + q, p + k + q) is the triangular factor of the tail, the k members in order and the
    q targets; ``penalty_root.T @ penalty_root`` times `alphas` (q,) the members' penalty. Returns
    of the first 0, 1, ... k members the sum of squared residuals, the same with the penalty and the
    trace of the smoother, (k + 1, q); and for `first_weights` the rotated targets and triangles.
    """
    q, p, k = len(alphas), n_tail, penalty_root.shape[1]
    columns, targets = R[: p + k, : p + k], R[:, p + k :]
    beyond = np.square(targets[p + k :]).sum(axis=0)
    targets = targets[: p + k]
    rss, objective, dof = (np.empty((k + 1, q)) for _ in range(3))
    rotated = np.zeros((p + k, q))
    triangles = [rotated] * q  # until they are there
    for alpha in np.unique(alphas):
        of = np.flatnonzero(alphas == alpha)
        Q, triangle = penalise(columns, p, penalty_root, alpha)
        Q = Q[: len(columns)]
        size = Q.shape[1]
        rotated[:size, of] = Q.T @ targets[:, of]
        # Residuals of all sizes at once: what each further direction takes away.
        residual = targets[:, of, None] - np.cumsum(
            Q[:, None, :] * rotated[:size, of].T[None], axis=2
        )
        residual = np.concatenate([targets[:, of, None], residual], axis=2)[:, :, p : p + k + 1]
        rss[:, of] = np.square(residual).sum(axis=0).T + beyond[of]
        gained = np.cumsum(np.square(rotated[p:, of]), axis=0)
        objective[0, of] = rss[0, of]
        objective[1:, of] = rss[0, of] - gained
        dof[0, of] = p if tail_dof is None else tail_dof
        dof[1:, of] = dof[0, of] + np.cumsum(np.square(Q[:, p:]).sum(axis=0))[:, None]
        for i in of:
            triangles[i] = triangle
    # A difference of large numbers: the objective is never below its own first part.
    objective = np.maximum(objective, rss)
    return rss + within, objective + within, dof, rotated, triangles


def first_weights(rotated, triangles, size):
    """Weights (size, q) of the first columns, the tail's and some members', see above."""
    solution = rotated[:size].copy()
    for i, R in enumerate(triangles if size else ()):
        solution[:, i] = solve_triangular(R[:size, :size], solution[:, i], check_finite=False)
    return solution


def penalise(rows, n_tail, penalty_root, alpha):
    """Q and R (p + k, p + k) of the rows' triangle with the penalty of its members below it."""
    penalty = np.sqrt(alpha) * penalty_root if alpha > 0 else penalty_root[:0]
    stacked = np.zeros((len(rows) + len(penalty), rows.shape[1]))
    stacked[: len(rows)], stacked[len(rows) :, n_tail:] = rows, penalty
    if not rows.shape[1]:
        return stacked, stacked[:0]
    return qr(stacked, mode="economic", check_finite=False)
