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
from sklearn_raacmm.utils import group_sums

# Least ridge for which a Cholesky factor of all rows is taken. Below, the rounding of a kernel
# matrix of 1000 rows (1e-13 of an eigenvalue of up to 1000) is no longer small beside the ridge.
LEAST_RIDGE = 1e-9
# Outputs from which one eigenvector decomposition (9 n^3) is cheaper than n^3 for each of them.
MANY_OUTPUTS = 8
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


class Likelihood(NamedTuple):
    """Value and gradient; gradients are by (log_width, log_alpha, log_ratio), (d + q + 1,)."""

    value: float  # negative log marginal likelihood, up to a constant
    gradient: np.ndarray
    signal: np.ndarray  # (q,) signal variance of every output
    signal_gradient: np.ndarray  # (q, d + q + 1)


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
    K, slope = KERNELS[kernel].with_slope(squared_distances(Xs, Xs))
    for matrix in (K, slope) if np.any(root != 1.0) else ():
        matrix *= root[:, None]
        matrix *= root
    return data.whiten(data.whiten(K, ratio).T, ratio), slope, Xs


def exact_likelihood(data, kernel, log_width, log_alpha, ratio=0.0):
    """Negative log marginal likelihood of the process, with its gradient.

    The logarithms are of widths (d,) and ridges (q,); `ratio` is the variance of groups' constants
    over that of the noise.
    """
    n, n_total, within = len(data.X), data.n_total, data.within
    if ratio and len(log_alpha) > 1:
        return _of_each_output(data, kernel, log_width, log_alpha, ratio)
    alphas = np.exp(log_alpha)
    Y = data.whiten(data.targets, ratio)
    K, slope, Xs = covariance(data, kernel, log_width, ratio)
    solved, log_det, trace, half = inverses(K, Y, alphas)
    by_ratio, form_by_ratio = 0.0, np.zeros(len(alphas))
    if data.codes is not None and ratio:
        by_ratio, form_by_ratio = _of_constants(data, ratio, alphas, solved, half)
        half = np.asfortranarray(data.whiten(data.whiten(half, ratio).T, ratio))
    of_noise = within / alphas
    quadratic = np.maximum((Y * solved).sum(axis=0) + of_noise, TINY)
    value = log_det + (n_total - n) * log_alpha + n_total * np.log(quadratic)
    value += data.log_det(ratio)
    # Derivatives of the quadratic form: a'K'a, the weights a being the solution.
    d_quadratic = -alphas * np.square(solved).sum(axis=0) - of_noise
    d_alpha = 0.5 * (alphas * trace + n_total - n + n_total * d_quadratic / quadratic)
    # Both are symmetric, and the half is in Fortran's order.
    half *= slope.T
    d_width = width_gradient(half, Xs)
    weights = data.whiten(solved, ratio)
    d_form = -np.array([rank_one_gradient(slope, a, Xs) for a in weights.T])
    d_width += 0.5 * n_total * (d_form / quadratic[:, None]).sum(axis=0)
    by_ratio += 0.5 * n_total * np.sum(form_by_ratio / quadratic)
    return Likelihood(
        0.5 * value.sum(),
        np.concatenate([d_width, d_alpha, [by_ratio]]),
        quadratic / n_total,
        np.hstack([d_form, np.diag(d_quadratic), form_by_ratio[:, None]]) / n_total,
    )


def _of_constants(data, ratio, alphas, solved, half):
    """Derivatives by the logarithm of `ratio`: of half the log determinant, and of the form."""
    total = np.bincount(data.codes, data.weights)
    # The constants' columns, whitened.
    along = np.sqrt(data.weights) / np.sqrt(1 + ratio * total)[data.codes]
    inside = group_sums(half, data.codes, along).T
    inside = group_sums(inside, data.codes, along)
    trace = 2 * np.trace(inside)  # the inverse is the half and its transpose
    forms = -ratio * alphas * np.square(group_sums(solved, data.codes, along)).sum(axis=0)
    return 0.5 * ratio * alphas[0] * trace, forms


def _of_each_output(data, kernel, log_width, log_alpha, ratio):
    """The likelihood of several outputs with constants as the sum of one of each."""
    d, q = data.X.shape[1], len(log_alpha)
    gradient, signal, by_theta = np.zeros(d + q + 1), np.empty(q), np.zeros((q, d + q + 1))
    value = 0.0
    for i in range(q):
        own = data._replace(Y=data.Y[:, i : i + 1], within=data.within[i : i + 1])
        found = exact_likelihood(own, kernel, log_width, log_alpha[i : i + 1], ratio)
        at = np.append(np.arange(d), [d + i, d + q])
        value, signal[i] = value + found.value, found.signal[0]
        gradient[at] += found.gradient
        by_theta[i, at] = found.signal_gradient[0]
    return Likelihood(value, gradient, signal, by_theta)


def inverses(K, Y, alphas):
    """Solve with every K + alpha_i I, K (n, n) and Y (n, q).

    Returns the solutions (n, q); of each matrix the log determinant and the trace of the inverse,
    (q,); and a matrix (n, n) in Fortran's order that with its transpose is the sum of the inverses.
    """
    n, q = Y.shape
    if alphas.min() < LEAST_RIDGE or q >= MANY_OUTPUTS:
        values, vectors = np.linalg.eigh(K)
        inverses = 1 / (np.maximum(values, 0.0)[:, None] + alphas)
        solved = vectors @ (inverses * (vectors.T @ Y))
        half = (vectors @ (0.5 * vectors * inverses.sum(axis=1)).T).T
        return solved, -np.log(inverses).sum(axis=0), inverses.sum(axis=0), half
    solved, log_det, trace = np.empty((n, q)), np.empty(q), np.empty(q)
    half = np.empty((n, n), order="F")
    for i, alpha in enumerate(alphas):
        C = K.T.copy(order="F")
        C[np.diag_indices(n)] += alpha
        factor, failed = lapack.dpotrf(C, lower=1, clean=1, overwrite_a=1)
        if failed:
            raise LinAlgError("kernel matrix is not positive definite to working precision")
        log_det[i] = 2 * np.log(factor.diagonal()).sum()
        solved[:, i] = lapack.dpotrs(factor, Y[:, i], lower=1)[0]
        factor[:] = lapack.dtrtri(factor, lower=1, overwrite_c=1)[0]
        one = lapack.dlauum(factor, lower=1, overwrite_c=1)[0]  # its lower triangle
        trace[i] = np.trace(one)
        half = np.add(half, one, out=half) if i else one
    half[np.diag_indices(n)] *= 0.5
    return solved, log_det, trace, half


class LeaveOneOut(NamedTuple):
    """What the process predicts for every row from all others."""

    squared_error: float  # weighted sum of squares, over rows and outputs
    negative_log_density: float  # of the targets, summed, up to a constant


def leave_one_out(data, kernel, log_width, log_alpha, ratio=0.0):
    """Leave-one-out predictions in closed form (section 5.4.2 of the reference)."""
    return left_out(data, covariance(data, kernel, log_width, ratio)[0], np.exp(log_alpha), ratio)


def left_out(data, K, alphas, ratio=0.0):
    """The same, of a kernel matrix of whitened rows."""
    Y = data.whiten(data.targets, ratio)
    error, density = 0.0, 0.0
    for i, alpha in enumerate(alphas):
        y, one = Y[:, i : i + 1], alphas[i : i + 1]
        solved, _, _, half = inverses(K, y, one)
        signal = ((y * solved).sum() + data.within[i] / alpha) / data.n_total
        if data.codes is not None and ratio:
            half = data.whiten(data.whiten(half + half.T, ratio).T, ratio) / 2
        share = 2 * half.diagonal()
        residual = data.whiten(solved, ratio)[:, 0] / share
        variance = np.maximum(signal / share, TINY)
        error += np.sum(np.square(residual))
        density += 0.5 * np.sum(np.square(residual) / variance + np.log(variance))
    return LeaveOneOut(error, density)


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
