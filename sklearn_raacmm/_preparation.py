"""Weighted data as the network's numerics want them: distinct rows, the tail projected out."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import qr


class Problem(NamedTuple):
    """Distinct rows in sorted order, with everything multiplied by the root of its weight."""

    X: np.ndarray  # (n, d) rows as given
    first: np.ndarray  # (n,) where each was first seen
    root: np.ndarray  # (n, 1) root of the summed weights
    n_total: float  # sum of the weights, the number of observations
    targets: np.ndarray  # (n, q) mean targets times root
    within: np.ndarray  # (q,) sum of squares lost by taking means
    tail: np.ndarray  # (n, p) polynomial tail times root
    basis: np.ndarray  # (n, p) orthonormal basis of it
    tail_map: np.ndarray  # (p, d + 1) its coefficients to those of (1, x)
    spread: np.ndarray  # (q,) root mean square of the targets about the tail, 0 for a constant

    def centred(self):
        """Targets with the tail projected out, times root, in units of their spread.

        Outputs that do not vary about the tail are left out.
        """
        varying = self.spread > 0
        centred = self.targets[:, varying]
        centred = centred - self.basis @ (self.basis.T @ centred)
        return centred / self.spread[varying], (self.within[varying] / self.spread[varying] ** 2)


def prepare(X, Y, weights, degree):
    """Merge repeated rows and set up the polynomial tail.

    The result depends on the weighted data alone: not on the order of the rows, and not on whether
    a row is repeated or weighted.

    Parameters
    ----------
    X : ndarray of shape (n_samples, d)
    Y : ndarray of shape (n_samples, q)
    weights : ndarray of shape (n_samples,)
        Not negative, not all zero.
    degree : {-1, 0, 1}

    Returns
    -------
    Problem
    """
    kept = np.flatnonzero(weights > 0)
    X, Y, weights = X[kept] + 0.0, Y[kept], weights[kept]  # adding 0 makes -0.0 and 0.0 one value
    distinct, first, inverse = np.unique(X, axis=0, return_index=True, return_inverse=True)
    inverse = inverse.ravel()
    n = len(distinct)
    summed = np.bincount(inverse, weights=weights, minlength=n)
    mean = np.column_stack([np.bincount(inverse, weights=weights * y, minlength=n) for y in Y.T])
    mean /= summed[:, None]
    within = weights @ np.square(Y - mean[inverse])

    root = np.sqrt(summed)[:, None]
    tail, tail_map = _polynomial(distinct, summed, degree)
    tail = root * tail
    basis = qr(tail, mode="economic", check_finite=False)[0] if tail.size else tail
    targets = root * mean
    about = targets - basis @ (basis.T @ targets)
    n_total = summed.sum()
    spread = np.sqrt((np.square(about).sum(axis=0) + within) / n_total)
    # What is left of a constant by rounding is not variation.
    spread[spread <= 1e-13 * np.abs(mean).max(axis=0)] = 0.0
    return Problem(
        distinct, kept[first], root, n_total, targets, within, tail, basis, tail_map, spread
    )


def _polynomial(X, weights, degree):
    """Columns of the tail, in features centred and scaled so that they are well conditioned."""
    n, d = X.shape
    if degree < 0:
        return np.empty((n, 0)), np.empty((0, d + 1))
    center = np.average(X, axis=0, weights=weights)
    scale = np.sqrt(np.average(np.square(X - center), axis=0, weights=weights))
    if degree == 0:
        used = np.empty(0, dtype=int)
    else:
        used = np.flatnonzero(scale > 1e-13 * np.abs(X).max(axis=0))
        # Features that are combinations of others add nothing to the span.
        R, order = qr((X[:, used] - center[used]) / scale[used], mode="r", pivoting=True)
        size = np.abs(R.diagonal())
        used = np.sort(used[order[: np.sum(size > 1e-10 * size.max(initial=0))]])
    tail = np.column_stack([np.ones(n), (X[:, used] - center[used]) / scale[used]])
    tail_map = np.zeros((1 + len(used), d + 1))
    tail_map[0, 0] = 1.0
    tail_map[1:, 0] = -center[used] / scale[used]
    tail_map[np.arange(1, 1 + len(used)), 1 + used] = 1 / scale[used]
    return tail, tail_map
