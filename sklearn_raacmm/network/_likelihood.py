r"""Marginal likelihood of a Gaussian process, and its gradient with respect to widths and ridge.

With kernel matrix K, weights w and ridge :math:`\alpha` (noise variance over signal variance) the
targets of an output have the covariance :math:`s^2 (K + \alpha W^{-1})`. The signal variance
:math:`s^2` of every output is set to its optimum, so that outputs of any scale count alike. What
remains is a smooth function of the logarithms of the widths and of :math:`\alpha` [1]_.

`exact_likelihood` takes one Cholesky factor of all rows. `projected_likelihood` takes the process
that knows the function through its values on some inducing rows only: linear in the number of rows.

References
----------
.. [1] C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT Press
   2006, sections 5.4 and 8.3.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, blas, lapack

from sklearn_raacmm.network._kernels import KERNELS, squared_distances
from sklearn_raacmm.utils import centred, group_sums, invert_triangle

# Least ridge for which a Cholesky factor of all rows is taken. Below, the rounding of a kernel
# matrix of 1000 rows (1e-13 of an eigenvalue of up to 1000) is no longer small beside the ridge.
LEAST_RIDGE = 1e-9
# Outputs from which one eigenvector decomposition (9 n^3) is cheaper than n^3 for each of them.
MANY_OUTPUTS = 8
# Ridge below which the projected process is solved by eigenvectors: its normal equations square
# the condition, and with a Cholesky factor the gradient then agreed with differences to 1e-3 only.
LEAST_PROJECTED_RIDGE = 1e-5
# Added to the inducing rows' kernel matrix for its Cholesky factor to exist: the first that does.
JITTER = (1e-10, 1e-8, 1e-6)


class Data(NamedTuple):
    """Rows and targets of a likelihood."""

    X: np.ndarray  # (n, d)
    Y: np.ndarray  # (n, q) without their polynomial tail
    weights: np.ndarray  # (n,)
    within: np.ndarray  # (q,) sum of squares that merging repeated rows took out of Y
    codes: np.ndarray | None = None  # (n,) group of each row; Y is less its means over groups

    @property
    def n_total(self):
        """Number of observations, less the offsets of groups."""
        n_groups = 0 if self.codes is None else self.codes.max() + 1
        return self.weights.sum() - n_groups

    def rows(self, rows):
        """Some of them; what merging took out is shared in proportion."""
        X, Y, weights, codes = self.X[rows], self.Y[rows], self.weights[rows], self.codes
        if codes is not None:
            codes = np.unique(codes[rows], return_inverse=True)[1]
            Y = centred(Y, codes, weights)
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


class Likelihood(NamedTuple):
    """Value and gradient; gradients are with respect to (log_width, log_alpha), (d + q,)."""

    value: float  # negative log marginal likelihood, up to a constant
    gradient: np.ndarray
    signal: np.ndarray  # (q,) signal variance of every output
    signal_gradient: np.ndarray  # (q, d + q)


def noise_likelihood(data):
    """Negative log marginal likelihood where all is noise: the limit of an infinite ridge."""
    total = data.weights @ np.square(data.Y) + data.within
    return 0.5 * data.n_total * np.sum(np.log(np.maximum(total, np.finfo(float).tiny)))


def exact_likelihood(data, kernel, log_width, log_alpha):
    """Negative log marginal likelihood of the process itself.

    Parameters
    ----------
    data : Data
    kernel : str
    log_width : ndarray of shape (d,)
    log_alpha : ndarray of shape (q,)

    Returns
    -------
    Likelihood
    """
    X, Y, weights, within, _ = data
    n, n_total = len(X), data.n_total
    root, alphas = np.sqrt(weights), np.exp(log_alpha)
    Xs = X * np.exp(-log_width)
    K, slope = KERNELS[kernel].with_slope(squared_distances(Xs, Xs))
    weigh(K, root)
    weigh(slope, root)
    Yw = root[:, None] * Y
    K = centre(centre(K, data).T, data)
    solved, log_det, trace, half = inverses(K, Yw, alphas)
    if data.codes is not None:
        half = np.asfortranarray(centre(centre(half, data).T, data).T)
    of_noise = within / alphas
    quadratic = np.maximum((Yw * solved).sum(axis=0) + of_noise, np.finfo(float).tiny)
    value = log_det + (n_total - n) * log_alpha + n_total * np.log(quadratic)
    # Derivatives of the quadratic form: a'K'a, the weights a being the solution.
    d_quadratic = -alphas * np.square(solved).sum(axis=0) - of_noise
    d_alpha = 0.5 * (alphas * trace + n_total - n + n_total * d_quadratic / quadratic)
    # Both are symmetric, and the half is in Fortran's order.
    half *= slope.T
    d_width = width_gradient(half, Xs, Xs)
    d_form = -np.array([rank_one_gradient(slope, a, Xs) for a in solved.T])
    d_width += 0.5 * n_total * (d_form / quadratic[:, None]).sum(axis=0)
    return Likelihood(
        0.5 * value.sum(),
        np.append(d_width, d_alpha),
        quadratic / n_total,
        np.hstack([d_form, np.diag(d_quadratic)]) / n_total,
    )


def log_likelihood(data, kernel, log_width, log_alpha):
    """Logarithm of the marginal likelihood with its constants, summed over outputs."""
    found = exact_likelihood(data, kernel, log_width, log_alpha)
    return -found.value - data.Y.shape[1] * evidence_constant(data)


def evidence_constant(data):
    """What the values of this module leave out of the negative logarithm, for each output."""
    n = data.n_total
    return 0.5 * n * (1 + np.log(2 * np.pi / n)) - 0.5 * np.log(data.weights).sum()


def weigh(K, root):
    """Multiply the rows and columns of a kernel matrix, in place."""
    if np.any(root != 1.0):
        K *= root[:, None]
        K *= root


def centre(columns, data):
    """Columns of root weighted rows less what is constant in a group; as they are without groups.

    The likelihood is then that of the targets' deviations from their group's mean: it is the same
    for all offsets, and the limit of offsets of an infinite prior variance.
    """
    if data.codes is None:
        return columns
    root = np.sqrt(data.weights)
    along = group_sums(columns, data.codes, root) / np.bincount(data.codes, data.weights)[:, None]
    return columns - root[:, None] * along[data.codes]


def inverses(K, Y, alphas):
    """Solve with every K + alpha_i I.

    Returns
    -------
    solved : ndarray of shape (n, q)
    log_det, trace : ndarray of shape (q,)
        Of the matrix, and of its inverse.
    half : ndarray of shape (n, n), Fortran order
        The sum of the inverses is the sum of this and its transpose.
    """
    n, q = Y.shape
    if alphas.min() < LEAST_RIDGE or q >= MANY_OUTPUTS:
        values, vectors = np.linalg.eigh(K)
        inverses = 1 / (np.maximum(values, 0.0)[:, None] + alphas)
        solved = vectors @ (inverses * (vectors.T @ Y))
        half = (vectors @ (0.5 * vectors * inverses.sum(axis=1)).T).T
        return solved, -np.log(inverses).sum(axis=0), inverses.sum(axis=0), half
    solved, log_det, trace = np.empty((n, q)), np.empty(q), np.empty(q)
    half = None
    for i, alpha in enumerate(alphas):
        C = K.T.copy(order="F")
        C[np.diag_indices(n)] += alpha
        factor, failed = lapack.dpotrf(C, lower=1, clean=1, overwrite_a=1)
        if failed:
            raise LinAlgError("kernel matrix is not positive definite to working precision")
        log_det[i] = 2 * np.log(factor.diagonal()).sum()
        solved[:, i] = lapack.dpotrs(factor, Y[:, i], lower=1)[0]
        invert_triangle(factor)
        one = lapack.dlauum(factor, lower=1, overwrite_c=1)[0]  # its lower triangle
        trace[i] = np.trace(one)
        half = one if half is None else np.add(half, one, out=half)
    half[np.diag_indices(n)] *= 0.5
    return solved, log_det, trace, half


class LeaveOneOut(NamedTuple):
    """What the process predicts for every row from all others."""

    squared_error: float  # weighted sum of squares, over rows and outputs
    negative_log_density: float  # of the targets, summed, up to a constant


def leave_one_out(data, kernel, log_width, log_alpha):
    """Leave-one-out predictions in closed form (section 5.4.2 of the reference).

    Where groups have offsets, whole groups are left out, and the deviations from their means are
    predicted: what a block of the inverse says of a group is what it says of a row elsewhere.

    Parameters
    ----------
    data : Data
    kernel : str
    log_width : ndarray of shape (d,)
    log_alpha : ndarray of shape (q,)

    Returns
    -------
    LeaveOneOut
    """
    Xs = data.X * np.exp(-log_width)
    K = KERNELS[kernel].function(squared_distances(Xs, Xs))
    weigh(K, np.sqrt(data.weights))
    return left_out(data, centre(centre(K, data).T, data), np.exp(log_alpha))


def left_out(data, K, alphas):
    """The same, of a kernel matrix that is weighted, and without what is constant in a group."""
    Yw = np.sqrt(data.weights)[:, None] * data.Y
    error, density = 0.0, 0.0
    for i, alpha in enumerate(alphas):
        y, one = Yw[:, i : i + 1], alphas[i : i + 1]
        solved, _, _, half = inverses(K, y, one)
        signal = ((y * solved).sum() + data.within[i] / alpha) / data.n_total
        if data.codes is not None:
            found = _groups_left_out(half + half.T, solved[:, 0], data.codes, alpha, signal)
            error, density = error + found[0], density + found[1]
            continue
        share = 2 * half.diagonal()
        residual = solved[:, 0] / share
        variance = np.maximum(signal / share, np.finfo(float).tiny)
        error += np.sum(np.square(residual))
        density += 0.5 * np.sum(np.square(residual) / variance + np.log(variance))
    return LeaveOneOut(error, density)


def _groups_left_out(inverse, solved, codes, alpha, signal):
    """Squared error and negative log density of whole groups, each predicted from the others.

    Parameters
    ----------
    inverse : ndarray of shape (n, n)
        Of the covariance of the deviations, over the signal variance; constants of groups have the
        variance alpha in it.
    solved : ndarray of shape (n,)
        Its product with the targets.
    codes : ndarray of shape (n,)
        Sorted.
    alpha, signal : float

    Returns
    -------
    squared_error, negative_log_density : float
    """
    error, density, signal = 0.0, 0.0, max(signal, np.finfo(float).tiny)
    borders = np.flatnonzero(np.diff(codes, prepend=-1, append=codes[-1] + 1))
    for start, stop in pairwise(borders):
        own = slice(start, stop)
        block = inverse[own, own]
        residual = np.linalg.solve(block, solved[own])
        error += residual @ residual
        # Of one direction, the constant, nothing is predicted.
        log_det = (stop - start - 1) * np.log(signal) - np.linalg.slogdet(block)[1] - np.log(alpha)
        density += 0.5 * (residual @ solved[own] / signal + log_det)
    return error, density


def projected_likelihood(data, Z, kernel, log_width, log_alpha):
    """Negative log marginal likelihood of the projected process.

    Parameters
    ----------
    data : Data
    Z : ndarray of shape (m, d)
        Inducing rows.
    kernel : str
    log_width : ndarray of shape (d,)
    log_alpha : ndarray of shape (q,)

    Returns
    -------
    Likelihood
    """
    X, Y, weights, within, _ = data
    m, q, n_total = len(Z), Y.shape[1], data.n_total
    inverse_width, alphas = np.exp(-log_width), np.exp(log_alpha)
    with_slope = KERNELS[kernel].with_slope
    root = np.sqrt(weights)
    Zs, Xs = Z * inverse_width, X * inverse_width
    Kw, slope_mn = with_slope(squared_distances(Zs, Xs))
    Kw *= root
    slope_mn *= root
    Kw = centre(Kw.T, data).T
    Yw = root[:, None] * Y
    K, slope_mm = with_slope(squared_distances(Zs, Zs))
    L = _root(K)
    L_inverse = lapack.dtrtri(L, lower=1)[0]
    # A = L^-1 Kw, as its transpose, which is in the order that BLAS wants.
    A = blas.dtrsm(1.0, L, Kw.T, side=1, lower=1, trans_a=1).T
    # The derivatives (the reference's section 5.4.1) go through S = alpha Kmm + Kw Kw', whose
    # inverse is L^-T B^-1 L^-1 with B = A A' + alpha I.
    shrunk = _shrink_stably if alphas.min() < LEAST_PROJECTED_RIDGE else _shrink
    solved, log_det, trace, left, right, weighted = shrunk(A, Yw, alphas)
    beta = L_inverse.T @ solved
    residual = Yw - Kw.T @ beta
    prior = np.square(solved).sum(axis=0)
    # As a sum of squares, not as a difference: right to second order in what beta is off.
    unexplained = np.square(residual).sum(axis=0) + within
    quadratic = np.maximum(unexplained / alphas + prior, np.finfo(float).tiny)
    scale = n_total / quadratic
    value = 0.5 * np.sum(log_det + (n_total - m) * log_alpha + n_total * np.log(quadratic))
    d_quadratic = prior - quadratic
    d_alpha = 0.5 * (alphas * trace + n_total - m + scale * d_quadratic)

    G = (L_inverse.T @ left) @ right
    G -= (beta * (scale / alphas)) @ residual.T
    d_width = width_gradient(G * slope_mn, Zs, Xs)
    weighted[np.diag_indices(m)] -= q
    H = L_inverse.T @ weighted @ L_inverse
    H += (beta * scale) @ beta.T
    d_width += 0.5 * width_gradient(H * slope_mm, Zs, Zs)
    # The quadratic forms alone, for the signal variances.
    d_form = np.array(
        [
            rank_one_gradient(slope_mm, b, Zs) - 2 * _across_gradient(slope_mn, b / a, r, Zs, Xs)
            for a, b, r in zip(alphas, beta.T, residual.T, strict=True)
        ]
    )
    return Likelihood(
        value,
        np.append(d_width, d_alpha),
        quadratic / n_total,
        np.hstack([d_form, np.diag(d_quadratic)]) / n_total,
    )


def _root(K):
    """Lower Cholesky factor of a kernel matrix that may be singular to working precision."""
    for jitter in JITTER:
        jittered = np.array(K, order="F")
        jittered[np.diag_indices(len(K))] += jitter
        root, failed = lapack.dpotrf(jittered, lower=1, clean=1, overwrite_a=1)
        if not failed:
            return root
    raise LinAlgError("kernel matrix of the inducing rows is not positive definite")


def _shrink(A, Y, alphas):
    """What the likelihood needs of B_i = A A' + alpha_i I, by Cholesky.

    Returns
    -------
    solved : ndarray of shape (m, q)
        B_i^-1 A Y_i.
    log_det, trace : ndarray of shape (q,)
        Of B_i, and of its inverse.
    left, right : ndarray of shape (m, m) and (m, n)
        The product is the sum of B_i^-1 A.
    weighted : ndarray of shape (m, m)
        Sum of alpha_i B_i^-1.
    """
    m, q = len(A), len(alphas)
    AA, AY = A @ A.T, A @ Y
    solved, log_det, trace = np.empty((m, q)), np.empty(q), np.empty(q)
    summed, weighted = np.zeros((m, m)), np.zeros((m, m))
    for i, alpha in enumerate(alphas):
        one = slice(i, i + 1)
        of_output, log_det[one], trace[one], half = inverses(AA, AY[:, one], alphas[one])
        solved[:, one] = of_output
        inverse = half + half.T
        summed += inverse
        weighted += alpha * inverse
    return solved, log_det, trace, summed, A, weighted


def _shrink_stably(A, Y, alphas):
    """The same by eigenvectors, which lose nothing where alpha is small beside A A'."""
    values, vectors = np.linalg.eigh(A @ A.T)
    values = np.maximum(values, 0.0)
    rotated = vectors.T @ A
    inverse = 1 / (values[:, None] + alphas)
    solved = vectors @ (inverse * (rotated @ Y))
    weighted = (vectors * (inverse @ alphas)) @ vectors.T
    log_det = -np.log(inverse).sum(axis=0)
    left = vectors * inverse.sum(axis=1)
    return solved, log_det, inverse.sum(axis=0), left, rotated, weighted


def width_gradient(G, A, B):
    """Sum over pairs of G_ij times d s_ij / d log width, for every feature."""
    return -2 * (
        G.sum(axis=1) @ (A * A) + G.sum(axis=0) @ (B * B) - 2 * np.einsum("ik,ik->k", A, G @ B)
    )


def rank_one_gradient(slope, a, A):
    """The same of the symmetric G = slope * a a', without forming it."""
    aA = a[:, None] * A
    along = slope @ np.column_stack([a, aA])
    return -2 * (2 * (a * along[:, 0]) @ (A * A) - 2 * np.einsum("ik,ik->k", aA, along[:, 1:]))


def _across_gradient(slope, a, b, A, B):
    """The same of G = slope * a b' between two sets of rows, without forming it."""
    bB = b[:, None] * B
    along = slope @ np.column_stack([b, bB, b[:, None] * B * B])
    d = A.shape[1]
    square = (a * along[:, 0]) @ (A * A) + a @ along[:, d + 1 :]
    return -2 * (square - 2 * np.einsum("ik,ik->k", a[:, None] * A, along[:, 1 : d + 1]))
