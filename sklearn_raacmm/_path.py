"""Penalised least squares on nested subsets, from one QR of the true columns."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import qr, solve_triangular


class Path(NamedTuple):
    """Fits with the first 0, 1, ... k members: row m has m of them."""

    rss: np.ndarray  # (k + 1, n_outputs) sum of squared residuals
    objective: np.ndarray  # (k + 1, n_outputs) the same with the penalty
    press: np.ndarray  # (k + 1, n_outputs) sum of squared leave-one-out residuals
    dof: np.ndarray  # (k + 1, n_outputs) trace of the smoother, tail included
    triangles: list  # of (p + k, p + k) for each output, tail columns first
    rotated: np.ndarray  # (p + k, n_outputs) targets in their coordinates

    def coefficients(self, m):
        """Weights of the tail and of the first m members, (p + m, n_outputs)."""
        size = len(self.rotated) - len(self.dof) + 1 + m
        solution = self.rotated[:size].copy()
        for i, R in enumerate(self.triangles if size else ()):
            solution[:, i] = solve_triangular(R[:size, :size], solution[:, i], check_finite=False)
        return solution


def nested_least_squares(tail, columns, penalty_root, alphas, targets, within):
    """Solve every nested subset, with no use of the running figures of the selection.

    Parameters
    ----------
    tail : ndarray of shape (n, p)
        Polynomial tail, rows times root weight. It is not penalised.
    columns : ndarray of shape (n, k)
        Members in order, rows times root weight.
    penalty_root : ndarray of shape (m, k)
        ``penalty_root.T @ penalty_root`` is the penalty's matrix.
    alphas : ndarray of shape (n_outputs,)
        Factor of the penalty.
    targets : ndarray of shape (n, n_outputs)
        Rows times root weight.
    within : ndarray of shape (n_outputs,)
        Sum of squares that no model can explain, because repeated rows were merged.

    Returns
    -------
    Path
    """
    p, k, q = tail.shape[1], columns.shape[1], targets.shape[1]
    rss, objective, press, dof = (np.empty((k + 1, q)) for _ in range(4))
    triangles, rotated = [None] * q, np.empty((p + k, q))
    for alpha in np.unique(alphas):
        of = np.flatnonzero(alphas == alpha)
        root = np.sqrt(alpha) * penalty_root if alpha > 0 else penalty_root[:0]
        R, rotated[:, of], *figures = _one_penalty(tail, columns, root, targets[:, of])
        rss[:, of], objective[:, of], press[:, of], dof[:, of] = figures
        for i in of:
            triangles[i] = R
    return Path(rss + within, objective + within, press + within, dof, triangles, rotated)


def _one_penalty(tail, columns, penalty_root, targets):
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
    rss, press, objective = (np.empty((k + 1, q)) for _ in range(3))
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
    return R, rotated, rss, np.maximum(objective, rss), press, dof[:, None]
