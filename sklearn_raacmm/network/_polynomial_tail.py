"""The polynomial tail: its columns, the ridge of its linear part, and the evidence for it."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import qr

from sklearn_raacmm.network._likelihood import evidence_constant, left_out
from sklearn_raacmm.network._width_objective import DOUBT, SILENT
from sklearn_raacmm.utils import centred

# Ridges that are tried: powers of 2, whose choice no rounding changes.
TAIL_RIDGES = 2.0 ** np.arange(-40, 41)


def tail_columns(X, weights, degree, codes=None, ridged=False):
    """Columns of the tail, in features centred and scaled so that they are well conditioned.

    Where groups have offsets there is no constant, and features are taken less their group's mean.
    With fewer rows than features some are combinations of others by chance: `ridged` keeps them,
    because a ridge tells them apart.
    """
    n, d = X.shape
    if degree < 0:
        return np.empty((n, 0)), np.empty((0, d + 1))
    if codes is not None:
        center, inner = np.average(X, axis=0, weights=weights), centred(X, codes, weights)
        _, scale_map = tail_columns(inner, weights, degree, ridged=ridged)
        used = np.flatnonzero(scale_map[1:, 1:].any(axis=0))
        used = used[np.ptp(inner[:, used], axis=0) > 1e-13 * np.abs(X[:, used]).max(axis=0)]
        scale = np.sqrt(np.average(np.square(inner), axis=0, weights=weights))
        return inner[:, used] / scale[used], tail_coefficients(d, used, center, scale)[1:]
    center = np.average(X, axis=0, weights=weights)
    scale = np.sqrt(np.average(np.square(X - center), axis=0, weights=weights))
    if degree == 0:
        used = np.empty(0, dtype=int)
    elif ridged and n <= d:
        used = np.flatnonzero(scale > 1e-13 * np.abs(X).max(axis=0))
    else:
        used = independent_features(X, center, scale, np.abs(X).max(axis=0))
    tail = np.column_stack([np.ones(n), (X[:, used] - center[used]) / scale[used]])
    return tail, tail_coefficients(d, used, center, scale)


def independent_features(X, center, scale, largest):
    """Features that vary and are not combinations of others, which add nothing to the span."""
    used = np.flatnonzero(scale > 1e-13 * largest)
    R, order = qr((X[:, used] - center[used]) / scale[used], mode="r", pivoting=True)
    size = np.abs(R.diagonal())
    return np.sort(used[order[: np.sum(size > 1e-10 * size.max(initial=0))]])


def tail_coefficients(d, used, center, scale):
    """From coefficients of (1, (x - center) / scale) to those of (1, x), (1 + used, d + 1)."""
    tail_map = np.zeros((1 + len(used), d + 1))
    tail_map[0, 0] = 1.0
    tail_map[1:, 0] = -center[used] / scale[used]
    tail_map[np.arange(1, 1 + len(used)), 1 + used] = 1 / scale[used]
    return tail_map


def ridge_rows(n_tail, ridge, constant=True):
    """Rows that, below those of the tail, give its linear part a ridge: one a linear column.

    `constant` says whether the first column is a constant, which has none.
    """
    return np.sqrt(ridge) * np.eye(n_tail)[int(constant) :] if ridge else np.empty((0, n_tail))


class LinearEvidence(NamedTuple):
    """Evidence of a linear model whose coefficients have a ridge."""

    ridge: float  # in units of an observation; 0 where there is nothing to be found
    objective: float  # as `_width_objective` has it, without the price of features
    log_likelihood: float  # its logarithm


def linear_ridge(tail, targets, within, n_total):
    """Ridge of a linear model, the same for all features and outputs, by its likelihood.

    The coefficients of an output have independent normal priors of one variance, the noise variance
    over the ridge; the noise variance is at its optimum for every output [1]_, and has the prior
    that it has beside radial functions.

    Parameters
    ----------
    tail : ndarray of shape (n, d)
        Features, centred, in units of their spread, times the root of the weights.
    targets : ndarray of shape (n, q)
        About their mean, times the root of the weights.
    within : ndarray of shape (q,)
        Sum of squares that merging repeated rows took out of them.
    n_total : float
        Number of observations, less one where the mean was taken out: as many features as rows
        would otherwise have no ridge, whatever the noise.

    Returns
    -------
    float
        In units of an observation; 0 where there is nothing to be found.

    References
    ----------
    .. [1] D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4 (1992), 415-447.
    """
    return linear_evidence(tail, targets, within, n_total, n_total).ridge


def linear_evidence(tail, targets, within, n_free, n_total):
    """The ridge, found with `n_free` observations, and the evidence of `n_total`.

    Parameters and source: see `linear_ridge`.

    Returns
    -------
    LinearEvidence
    """
    nothing = LinearEvidence(0.0, np.inf, -np.inf)
    if not tail.size:
        return nothing
    U, d, _ = np.linalg.svd(tail, full_matrices=False)
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

    ridge = min(TAIL_RIDGES, key=lambda ridge: sum(likelihood(ridge, n_free)))
    value, doubt = likelihood(ridge, n_total)
    return LinearEvidence(ridge, value + doubt, -value)


def linear_process(data):
    """Evidence of the linear model, comparable with that of a process of radial functions.

    Parameters
    ----------
    data : Data
        Targets about their mean.

    Returns
    -------
    LinearEvidence
    """
    n, has_mean = data.n_total, data.codes is None
    targets = np.sqrt(data.weights)[:, None] * data.Y
    found = linear_evidence(linear_columns(data), targets, data.within, n - has_mean, n)
    constant = data.Y.shape[1] * evidence_constant(data)
    return found._replace(log_likelihood=found.log_likelihood - constant)


def linear_left_out(data, ridge):
    """Leave-one-out predictions of the linear model, as `leave_one_out` has them."""
    tail = linear_columns(data)
    return left_out(data, tail @ tail.T / ridge, np.ones(data.Y.shape[1]))


def linear_columns(data):
    """Features about their mean, or that of their group, in units of their spread, times root."""
    tail = tail_columns(data.X, data.weights, 1, data.codes, ridged=True)[0]
    return np.sqrt(data.weights)[:, None] * tail[:, int(data.codes is None) :]
