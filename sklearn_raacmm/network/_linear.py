"""What of a network is linear: groups' constants, the polynomial, and the evidence for it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import NamedTuple

import numpy as np
from scipy.linalg import qr

from sklearn_raacmm.utils import group_means

# Ridges that are tried: powers of 2, whose choice no rounding changes.
RIDGES = 2.0 ** np.arange(-40, 41)
# The prior of the noise variance: below this share of an output's variance each power of e costs so
# many nats, as much as two observations say.
SILENT, DOUBT = 0.05, 1.0


class Polynomial(NamedTuple):
    """Columns of a polynomial: 1 and features, centred and scaled to be well conditioned."""

    used: np.ndarray | None  # features of the linear part; None for no polynomial at all
    center: np.ndarray  # (d,)
    scale: np.ndarray  # (d,)

    def columns(self, X):
        """Its p columns at rows (n, d)."""
        if self.used is None:
            return np.empty((len(X), 0))
        linear = (X[:, self.used] - self.center[self.used]) / self.scale[self.used]
        return np.column_stack([np.ones(len(X)), linear])

    @property
    def coefficients(self):
        """From coefficients of its columns to those of (1, x), (p, 1 + d)."""
        d = len(self.center)
        if self.used is None:
            return np.empty((0, d + 1))
        linear = np.eye(d)[self.used] / self.scale[self.used, None]
        return np.vstack([np.eye(1, d + 1), np.column_stack([-linear @ self.center, linear])])


def polynomial_of(X, weights, degree, ridged=False):
    """Polynomial of rows, without features that do not vary or are combinations of others.

    With fewer rows than features some are so by chance: a ridge (`ridged`) tells them apart.
    """
    center, used = np.average(X, axis=0, weights=weights), np.empty(0, dtype=int)
    scale = np.sqrt(np.average(np.square(X - center), axis=0, weights=weights))
    if degree == 1:
        used = np.flatnonzero(scale > 1e-13 * np.abs(X).max(axis=0))
        if not (ridged and X.shape[0] <= X.shape[1]):
            R, order = qr((X[:, used] - center[used]) / scale[used], mode="r", pivoting=True)
            size = np.abs(R.diagonal())
            used = np.sort(used[order[: np.sum(size > 1e-10 * size.max(initial=0))]])
    return Polynomial(None if degree < 0 else used, center, scale)


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
    as `_objective` has it, without the price; and the negative log likelihood. The ridge is found
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
