"""What of a network is linear: least squares, groups' constants, the polynomial, its evidence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.linalg import qr, solve_triangular

from sklearn_raacmm.utils import group_means

# Ridges that are tried: powers of 2, whose choice no rounding changes.
RIDGES = 2.0 ** np.arange(-40, 41)
# The prior of the noise variance: below this share of an output's variance each power of e costs so
# many nats, as much as two observations say.
SILENT, DOUBT = 0.05, 1.0


def polynomial_of(X, weights, degree, ridged=False):
    """Polynomial of rows (n, d), its p columns as linear functions of (1, x): (p, 1 + d).

    Features are centred and scaled; those that do not vary or are combinations of others are left
    out. With fewer rows than features some are so by chance: a ridge (`ridged`) tells them apart.
    """
    d = X.shape[1]
    if degree < 1:
        return np.eye(1 + d)[: degree + 1]
    center = np.average(X, axis=0, weights=weights)
    scale = np.sqrt(np.average(np.square(X - center), axis=0, weights=weights))
    used = np.flatnonzero(scale > 1e-13 * np.abs(X).max(axis=0))
    if not (ridged and len(X) <= d):
        R, order = qr((X[:, used] - center[used]) / scale[used], mode="r", pivoting=True)
        size = np.abs(R.diagonal())
        used = np.sort(used[order[: np.sum(size > 1e-10 * size.max(initial=0))]])
    linear = np.eye(d)[used] / scale[used, None]
    return np.vstack([np.eye(1, 1 + d), np.column_stack([-linear @ center, linear])])


def polynomial_at(polynomial, X):
    """Columns (n, p) of a polynomial at rows."""
    return polynomial[:, 0] + X @ polynomial[:, 1:].T


def ridge_rows(n_tail, ridge):
    """Rows that, below those of the polynomial, give its linear part a ridge; the constant none."""
    return np.sqrt(ridge) * np.eye(n_tail)[1:] if ridge else np.empty((0, n_tail))


def without_constants(columns, codes, weights, ratio):
    """Columns less that share of their groups' means which makes the noise independent."""
    if codes is None or not ratio:
        return columns
    share = 1 - 1 / np.sqrt(1 + ratio * np.bincount(codes, weights))
    return columns - (share[:, None] * group_means(columns, codes, weights))[codes]


def linear_evidence(columns, targets, within, n_free, n_total):
    """Ridge of a linear model, the same for all features and outputs, by its likelihood.

    Of columns (n, d), centred and in units of their spread, and targets (n, q), times root weights.
    Coefficients have normal priors of one variance, the noise variance over the ridge (MacKay,
    Neural Comput. 4, 1992). Returns the ridge, 0 where there is nothing to be found; the objective
    as `_likelihood` has it, without the price; and the negative log likelihood. The ridge is found
    by `n_free` observations, without the mean: as many features as rows would else have none.
    """
    nothing = 0.0, np.inf, np.inf
    if not columns.size:
        return nothing
    U, d, _ = np.linalg.svd(columns, full_matrices=False)
    along = U.T @ targets
    left = np.square(targets - U @ along).sum(axis=0) + within
    along, d2 = np.square(along), np.square(d)
    total = left + along.sum(axis=0)
    varying = total > 0
    if not np.any(varying):
        return nothing
    left, along, share = left[varying], along[:, varying], SILENT * total[varying] / n_total

    def likelihood(ridge, n):
        misfit = np.maximum(left + (ridge / (d2 + ridge)) @ along, np.finfo(float).tiny)
        log_det = varying.sum() * np.log1p(d2 / ridge).sum()
        doubt = np.log1p(share / (misfit / n_total)).sum()
        return 0.5 * (n * np.log(misfit).sum() + log_det), DOUBT * doubt

    ridge = min(RIDGES, key=lambda ridge: sum(likelihood(ridge, n_free)))
    value, doubt = likelihood(ridge, n_total)
    return ridge, value + doubt, value


def triangular_factor(rows):
    """R of the QR factorisation, upper triangular or trapezoidal; its signs are arbitrary."""
    return qr(rows, mode="r", overwrite_a=True, check_finite=False)[0][: rows.shape[1]]


def stack_triangles(upper, lower):
    """The triangular factor of two blocks of rows from those of each."""
    return triangular_factor(np.vstack([upper, lower]))


def nested_least_squares(R, n_tail, penalty_root, alphas, within):
    """Solve every nested subset, with no use of the running figures of the selection.

    R (<= p + k + q, p + k + q) is the triangular factor of the tail, the k members in order and the
    q targets; ``penalty_root.T @ penalty_root`` times `alphas` (q,) the members' penalty. Returns
    of the first 0, 1, ... k members the sum of squared residuals, and the same with the penalty,
    (k + 1, q); and for `first_weights` the rotated targets and triangles.
    """
    q, p, k = len(alphas), n_tail, penalty_root.shape[1]
    columns, targets = R[: p + k, : p + k], R[: p + k, p + k :]
    beyond = np.square(R[p + k :, p + k :]).sum(axis=0)
    rss, objective, rotated = np.empty((k + 1, q)), np.empty((k + 1, q)), np.empty((p + k, q))
    triangles = {}
    for alpha in np.unique(alphas):
        of = np.flatnonzero(alphas == alpha)
        Q, triangle = penalise(columns, p, penalty_root, alpha)
        Q = Q[: len(columns)]
        rotated[:, of] = Q.T @ targets[:, of]
        triangles |= dict.fromkeys(of, triangle)
        # Residuals of all sizes at once: what each further direction takes away.
        taken = np.cumsum(Q[:, None, :] * rotated[:, of].T, axis=2)
        left = targets[:, of, None] - np.pad(taken, ((0, 0), (0, 0), (1, 0)))
        rss[:, of] = np.square(left[:, :, p:]).sum(axis=0).T + beyond[of]
        gained = np.cumsum(np.square(rotated[p:, of]), axis=0)
        objective[:, of] = rss[0, of] - np.pad(gained, ((1, 0), (0, 0)))
    # A difference of large numbers: the objective is never below its own first part.
    objective = np.maximum(objective, rss)
    return rss + within, objective + within, rotated, triangles


def first_weights(rotated, triangles, size):
    """Weights (size, q) of the first columns, the tail's and some members', see above."""
    solution = rotated[:size].copy()
    for i, R in triangles.items() if size else ():
        solution[:, i] = solve_triangular(R[:size, :size], solution[:, i], check_finite=False)
    return solution


def penalise(rows, n_tail, penalty_root, alpha):
    """Q and R (p + k, p + k) of the rows' triangle with the penalty of its members below it."""
    penalty = np.sqrt(alpha) * penalty_root if alpha > 0 else penalty_root[:0]
    stacked = np.vstack([rows, np.pad(penalty, ((0, 0), (n_tail, 0)))])
    if not rows.shape[1]:
        return stacked, stacked[:0]
    return qr(stacked, mode="economic", check_finite=False)
