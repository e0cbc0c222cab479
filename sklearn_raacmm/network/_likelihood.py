r"""Marginal likelihood of a Gaussian process, and its gradient by widths, ridge and constants.

With kernel matrix K, weights w and ridge :math:`\alpha` (noise variance over signal variance) the
targets of an output have the covariance :math:`s^2 (K + \alpha (W^{-1} + r G))`, where G is 1
within a group of rows whose targets have a common constant (`_rows`). The signal variance
:math:`s^2` of every output is set to its optimum, so that outputs of any scale count alike. What
remains is a smooth function of the logarithms of the widths, of :math:`\alpha` and of r [1]_.

References
----------
.. [1] C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT Press
   2006, sections 5.4 and 8.3.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, lapack

from sklearn_raacmm.network._kernels import KERNELS, squared_distances
from sklearn_raacmm.network._linear import without_constants
from sklearn_raacmm.utils import group_sums, invert_triangle

# Least ridge for which a Cholesky factor of all rows is taken. Below, the rounding of a kernel
# matrix of 1000 rows (1e-13 of an eigenvalue of up to 1000) is no longer small beside the ridge.
LEAST_RIDGE = 1e-9
TINY = np.finfo(float).tiny


class Data(NamedTuple):
    """Rows and targets of a likelihood."""

    X: np.ndarray  # (n, d)
    Y: np.ndarray  # (n, q) without their polynomial
    weights: np.ndarray  # (n,)
    within: np.ndarray  # (q,) sum of squares that merging repeated rows took out of Y
    codes: np.ndarray | None = None  # (n,) group of each row, sorted, where groups have constants

    @property
    def n_total(self):
        """Number of observations."""
        return self.weights.sum()

    @property
    def targets(self):
        """Targets times the root of the weights."""
        return np.sqrt(self.weights)[:, None] * self.Y

    def rows(self, rows):
        """Some of them; what merging took out is shared in proportion."""
        X, Y, weights, codes = self.X[rows], self.Y[rows], self.weights[rows], self.codes
        if codes is not None:
            codes = np.unique(codes[rows], return_inverse=True)[1]
        share = weights.sum() / self.weights.sum()
        return Data(X, Y, weights, self.within * share, codes)

    def draw(self, size, random_state):
        """About `size` rows drawn at random, sorted, groups as a whole; all where no more."""
        n = len(self.X)
        if n <= size:
            return np.arange(n)
        if self.codes is None:
            return np.sort(random_state.permutation(n)[:size])
        order = random_state.permutation(self.codes.max() + 1)
        ends = np.cumsum(np.bincount(self.codes)[order])
        # Of the last group a part: data of a few large groups would otherwise be one of them.
        rows = [np.flatnonzero(self.codes == g) for g in order[: np.searchsorted(ends, size) + 1]]
        rows[-1] = random_state.permutation(rows[-1])[: size - sum(map(len, rows[:-1]))]
        return np.sort(np.concatenate(rows))

    def whiten(self, columns, ratio):
        """Columns times root weights, without groups' constants: a symmetric matrix's product."""
        if self.codes is None or not ratio:
            return columns
        root = np.sqrt(self.weights)[:, None]
        return root * without_constants(columns / root, self.codes, self.weights, ratio)

    def log_det(self, ratio):
        """Logarithm of the determinant of this matrix, times -2."""
        if self.codes is None or not ratio:
            return 0.0
        return np.log1p(ratio * np.bincount(self.codes, self.weights)).sum()


def log_likelihood(data, value):
    """Logarithm of a marginal likelihood, with its constants, summed over outputs."""
    n = data.n_total
    constant = 0.5 * n * (1 + np.log(2 * np.pi / n)) - 0.5 * np.log(data.weights).sum()
    return -value - data.Y.shape[1] * constant


def noise_likelihood(data, ratio=0.0):
    """Negative log marginal likelihood where all is noise: the limit of an infinite ridge."""
    total = np.square(data.whiten(data.targets, ratio)).sum(axis=0) + data.within
    value = data.n_total * np.log(np.maximum(total, TINY)) + data.log_det(ratio)
    return 0.5 * value.sum()


def noise_density(data):
    """Leave-one-out density where all is noise, as `leave_one_out` gives it."""
    square = data.weights[:, None] * np.square(data.Y)
    variance = np.maximum((square.sum(axis=0) + data.within) / data.n_total, 1e-300)
    return 0.5 * (np.sum(square / variance) + len(data.X) * np.sum(np.log(variance)))


def covariance(data, kernel, log_width, ratio=0.0):
    """Kernel matrix of the whitened rows, and its derivative by squared distances, not whitened."""
    root, Xs = np.sqrt(data.weights), data.X * np.exp(-log_width)
    K, slope = KERNELS[kernel](squared_distances(Xs, Xs), slope=True)
    for matrix in (K, slope) if np.any(root != 1.0) else ():
        matrix *= root[:, None]
        matrix *= root
    return data.whiten(data.whiten(K, ratio).T, ratio), slope, Xs


def exact_likelihood(data, kernel, log_width, log_alpha, ratio=0.0):
    """Negative log marginal likelihood of the process, up to a constant, with its gradient.

    The logarithms are of widths (d,) and ridges (q,); `ratio` is the variance of groups' constants
    over that of the noise. Returns the value; its gradient by log_width, log_alpha and the
    logarithm of the ratio, (d + q + 1,); the signal variance (q,) of every output; and the gradient
    of that, (q, d + q + 1).
    """
    (n, d), q = data.X.shape, len(log_alpha)
    n_total, Y = data.n_total, data.whiten(data.targets, ratio)
    K, slope, Xs = covariance(data, kernel, log_width, ratio)
    value, gradient, signal = 0.0, np.zeros(d + q + 1), np.empty(q)
    by_theta = np.zeros((q, d + q + 1))
    for i, alpha in enumerate(np.exp(log_alpha)):
        solved, log_det, half = solve_and_invert(K, Y[:, i], alpha)
        of_noise = data.within[i] / alpha
        quadratic = max(Y[:, i] @ solved + of_noise, TINY)
        value += log_det + (n_total - n) * log_alpha[i] + n_total * np.log(quadratic)
        value += data.log_det(ratio)
        gradient[d + i] = 0.5 * (alpha * 2 * np.trace(half) + n_total - n)
        by_theta[i, d + i] = -alpha * solved @ solved - of_noise
        if data.codes is not None and ratio:
            by_ratio, by_theta[i, -1] = _by_ratio(data, ratio, alpha, solved, half)
            gradient[-1] += by_ratio
            half = np.asfortranarray(data.whiten(data.whiten(half, ratio).T, ratio))
            solved = data.whiten(solved[:, None], ratio)[:, 0]
        half *= slope.T  # symmetric, and the half is in Fortran's order
        gradient[:d] += width_gradient(half, Xs)
        # Of the quadratic form: a'K'a, the weights a being the solution.
        by_theta[i, :d] = -rank_one_gradient(slope, solved, Xs)
        gradient += 0.5 * n_total * by_theta[i] / quadratic
        signal[i] = quadratic / n_total
    return 0.5 * value, gradient, signal, by_theta / n_total


def _by_ratio(data, ratio, alpha, solved, half):
    """Derivatives by the logarithm of `ratio`: of half the log determinant, and of the form."""
    total = np.bincount(data.codes, data.weights)
    # The constants' columns, whitened.
    along = np.sqrt(data.weights) / np.sqrt(1 + ratio * total)[data.codes]
    inside = group_sums(group_sums(half, data.codes, along).T, data.codes, along)
    form = np.square(group_sums(solved, data.codes, along)).sum()
    # The inverse is the half and its transpose.
    return ratio * alpha * np.trace(inside), -ratio * alpha * form


def solve_and_invert(K, y, alpha):
    """Solve (K + alpha I) x = y, with the log determinant.

    The third is a matrix (n, n) in Fortran's order that with its transpose is the inverse.
    """
    C = K.T.copy(order="F")
    C[np.diag_indices(len(C))] += alpha
    factor, failed = lapack.dpotrf(C, lower=1, clean=1, overwrite_a=1)
    if failed:
        raise LinAlgError("kernel matrix is not positive definite to working precision")
    log_det = 2 * np.log(factor.diagonal()).sum()
    solved = lapack.dpotrs(factor, y, lower=1)[0]
    invert_triangle(factor)
    half = lapack.dlauum(factor, lower=1, overwrite_c=1)[0]  # the lower triangle of the inverse
    half[np.diag_indices(len(C))] *= 0.5
    return solved, log_det, half


def leave_one_out(data, kernel, log_width, log_alpha, ratio=0.0):
    """Leave-one-out predictions in closed form (section 5.4.2 of the reference)."""
    return left_out(data, covariance(data, kernel, log_width, ratio)[0], np.exp(log_alpha), ratio)


def left_out(data, K, alphas, ratio=0.0):
    """The same, of a kernel matrix of whitened rows.

    Returns the weighted sum of squared errors, over rows and outputs, and the negative logarithm of
    the density of the targets, summed, up to a constant.
    """
    Y = data.whiten(data.targets, ratio)
    error, density = 0.0, 0.0
    for i, alpha in enumerate(alphas):
        solved, _, half = solve_and_invert(K, Y[:, i], alpha)
        signal = (Y[:, i] @ solved + data.within[i] / alpha) / data.n_total
        if data.codes is not None and ratio:
            half = data.whiten(data.whiten(half + half.T, ratio).T, ratio) / 2
            solved = data.whiten(solved[:, None], ratio)[:, 0]
        share = 2 * half.diagonal()
        residual, variance = solved / share, np.maximum(signal / share, TINY)
        error += np.sum(np.square(residual))
        density += 0.5 * np.sum(np.square(residual) / variance + np.log(variance))
    return error, density


def width_gradient(G, A):
    """Sum over pairs of rows of G_ij times d s_ij / d log width, for every feature."""
    square = A * A
    sums = G.sum(axis=1) @ square + G.sum(axis=0) @ square
    return -2 * (sums - 2 * np.einsum("ik,ik->k", A, G @ A))


def rank_one_gradient(slope, a, A):
    """The same of the symmetric G = slope * a a', without forming it."""
    aA = a[:, None] * A
    along = slope @ np.column_stack([a, aA])
    return -2 * (2 * (a * along[:, 0]) @ (A * A) - 2 * np.einsum("ik,ik->k", aA, along[:, 1:]))
