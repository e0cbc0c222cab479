r"""Marginal likelihood of a Gaussian process, and its gradient by widths, ridge and constants.

With kernel matrix K, weights w and ridge :math:`\alpha` (noise variance over signal variance) the
targets of an output have the covariance :math:`s^2 (K + \alpha (W^{-1} + r G))`, where G is 1
within a group of rows whose targets have a common constant (`_rows`). The signal variance
:math:`s^2` of every output is set to its optimum, so that outputs of any scale count alike
(Rasmussen and Williams, sections 5.4 and 8.3).
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, lapack

from sklearn_raacmm.network._kernels import KERNELS, squared_distances

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

    def noise(self, ratio):
        """Covariance (n, n) of the noise, times root weights: 1, and r within groups."""
        matrix = np.eye(len(self.X))
        if self.codes is not None and ratio:
            root = np.sqrt(ratio * self.weights)
            for rows in self.groups:
                matrix[rows, rows] += np.outer(root[rows], root[rows])
        return matrix

    @property
    def groups(self):
        """Slices of the rows that are left out together."""
        codes = np.arange(len(self.X)) if self.codes is None else self.codes
        ends = [0, *(np.flatnonzero(np.diff(codes)) + 1), len(codes)]
        return [slice(*pair) for pair in pairwise(ends)]


def log_likelihood(data, value):
    """Logarithm of a marginal likelihood, with its constants, summed over outputs."""
    n = data.n_total
    constant = 0.5 * n * (1 + np.log(2 * np.pi / n)) - 0.5 * np.log(data.weights).sum()
    return -value - data.Y.shape[1] * constant


def of_noise(data):
    """Negative log likelihood where all is noise, and what `left_out` gives there."""
    square = np.square(data.targets)
    total = square.sum(axis=0) + data.within
    value = 0.5 * np.sum(data.n_total * np.log(np.maximum(total, TINY)))
    variance = np.maximum(total / data.n_total, 1e-300)
    return value, 0.5 * (np.sum(square / variance) + len(square) * np.sum(np.log(variance)))


def covariance(data, kernel, log_width):
    """Kernel matrix and its derivative by squared distances, times root weights; scaled rows."""
    root, Xs = np.sqrt(data.weights), data.X * np.exp(-log_width)
    K, slope = KERNELS[kernel](squared_distances(Xs, Xs), slope=True)
    for matrix in (K, slope) if np.any(root != 1.0) else ():
        matrix *= root[:, None]
        matrix *= root
    return K, slope, Xs


def exact_likelihood(data, kernel, log_width, log_alpha, ratio=0.0):
    """Negative log marginal likelihood of the process, up to a constant.

    Returns the value; its gradient by log_width, log_alpha and the logarithm of `ratio`, that of
    groups' constants to the noise, (d + q + 1,); the signal variance (q,); and its gradient.
    """
    (n, d), q = data.X.shape, len(log_alpha)
    n_total, Y, noise = data.n_total, data.targets, data.noise(ratio)
    K, slope, Xs = covariance(data, kernel, log_width)
    value, gradient, signal = 0.0, np.zeros(d + q + 1), np.empty(q)
    by_theta = np.zeros((q, d + q + 1))
    for i, alpha in enumerate(np.exp(log_alpha)):
        solved, log_det, half = solve_and_invert(K + alpha * noise, Y[:, i])
        of_noise = data.within[i] / alpha
        quadratic = max(Y[:, i] @ solved + of_noise, TINY)
        value += log_det + (n_total - n) * log_alpha[i] + n_total * np.log(quadratic)
        # Traces of the inverse, which is the half and its transpose, times parts of the noise.
        trace, square, alone = 2 * np.vdot(half, noise), solved @ noise @ solved, solved @ solved
        gradient[d + i] = 0.5 * (alpha * trace + n_total - n)
        gradient[-1] += 0.5 * alpha * (trace - 2 * np.trace(half))
        by_theta[i, d + i] = -alpha * square - of_noise
        by_theta[i, -1] = -alpha * (square - alone)
        half *= slope.T  # symmetric, and the half is in Fortran's order
        gradient[:d] += width_gradient(half, Xs)
        # Of the quadratic form: a'K'a, the weights a being the solution.
        by_theta[i, :d] = -rank_one_gradient(slope, solved, Xs)
        gradient += 0.5 * n_total * by_theta[i] / quadratic
        signal[i] = quadratic / n_total
    return 0.5 * value, gradient, signal, by_theta / n_total


def solve_and_invert(C, y):
    """Solution of C x = y, log determinant, and half of the inverse: with its transpose all."""
    factor, failed = lapack.dpotrf(C.T, lower=1, clean=1)
    if failed:
        raise LinAlgError("kernel matrix is not positive definite to working precision")
    log_det = 2 * np.log(factor.diagonal()).sum()
    solved = lapack.dpotrs(factor, y, lower=1)[0]
    factor = lapack.dtrtri(factor, lower=1, overwrite_c=1)[0]
    half = lapack.dlauum(factor, lower=1, overwrite_c=1)[0]  # the lower triangle of the inverse
    half[np.diag_indices(len(C))] *= 0.5
    return solved, log_det, half


def left_out(data, K, alphas, ratio=0.0):
    """Negative log density of each row, or group with a constant, that is left out.

    In closed form (section 5.4.2 of Rasmussen and Williams), up to a constant.
    """
    density, n, noise = 0.0, len(K), data.noise(ratio)
    for y, within, alpha in zip(data.targets.T, data.within, alphas, strict=True):
        solved, _, half = solve_and_invert(K + alpha * noise, y)
        signal = max((y @ solved + within / alpha) / data.n_total, TINY)
        if data.codes is None:
            share = 2 * half.diagonal()
            square, log_det = np.sum(np.square(solved) / share), np.log(share).sum()
        else:
            square = log_det = 0.0
            for rows in data.groups:
                root = np.linalg.cholesky(half[rows, rows] + half[rows, rows].T)
                along = np.linalg.solve(root, solved[rows])
                square += along @ along
                log_det += 2 * np.log(root.diagonal()).sum()
        density += 0.5 * (square / signal - log_det + n * np.log(signal))
    return density


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
