"""Penalised least squares on nested subsets, from one QR of the true columns."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import qr, solve_triangular


class Path(NamedTuple):
    """Fits with the first 0, 1, ... k members: row m has m of them."""

    rss: np.ndarray  # (k + 1, n_outputs) sum of squared residuals
    objective: np.ndarray  # (k + 1, n_outputs) the same with the penalty
    press: np.ndarray  # (k + 1, n_outputs) sum of squared leave-one-out residuals
    dof: np.ndarray  # (k + 1,) trace of the smoother, tail included
    R: np.ndarray  # (p + k, p + k) triangular factor, tail columns first
    rotated: np.ndarray  # (p + k, n_outputs) targets in its coordinates

    def coefficients(self, m):
        """Weights of the tail and of the first m members, (p + m, n_outputs)."""
        size = len(self.R) - len(self.dof) + 1 + m
        if not size:
            return self.rotated[:0]
        return solve_triangular(self.R[:size, :size], self.rotated[:size], check_finite=False)


def nested_least_squares(tail, columns, penalty_root, targets, within):
    """Solve every nested subset, with no use of the running figures of the selection.

    Parameters
    ----------
    tail : ndarray of shape (n, p)
        Polynomial tail, rows times root weight. It is not penalised.
    columns : ndarray of shape (n, k)
        Members in order, rows times root weight.
    penalty_root : ndarray of shape (m, k)
        ``penalty_root.T @ penalty_root`` is the penalty's matrix; m = 0 for none.
    targets : ndarray of shape (n, n_outputs)
        Rows times root weight.
    within : ndarray of shape (n_outputs,)
        Sum of squares that no model can explain, because repeated rows were merged.

    Returns
    -------
    Path
    """
    n, p = tail.shape
    k, q = columns.shape[1], targets.shape[1]
    stacked = np.zeros((n + len(penalty_root), p + k), order="F")
    stacked[:n, :p], stacked[:n, p:], stacked[n:, p:] = tail, columns, penalty_root
    if p + k:
        Q, R = qr(stacked, mode="economic", overwrite_a=True, check_finite=False)
    else:
        Q, R = stacked, np.empty((0, 0))
    Q = Q[:n]
    rotated = Q.T @ targets
    residual = targets - Q[:, :p] @ rotated[:p]
    leverage = np.square(Q[:, :p]).sum(axis=1)
    rss, press, objective = np.empty((k + 1, q)), np.empty((k + 1, q)), np.empty((k + 1, q))
    for m in range(k + 1):
        if m:
            direction = Q[:, p + m - 1]
            residual -= np.outer(direction, rotated[p + m - 1])
            leverage += direction * direction
            objective[m] = objective[m - 1] - rotated[p + m - 1] ** 2
        rss[m] = np.einsum("ij,ij->j", residual, residual)
        if not m:
            objective[0] = rss[0]
        press[m] = np.square(residual / np.maximum(1 - leverage, 1e-10)[:, None]).sum(axis=0)
    dof = p + np.concatenate([[0.0], np.cumsum(np.square(Q[:, p:]).sum(axis=0))])
    # A difference of large numbers: the objective is never below its own first part.
    objective = np.maximum(objective, rss)
    return Path(rss + within, objective + within, press + within, dof, R, rotated)
