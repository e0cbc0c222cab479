r"""Widths and ridge from the data, by the marginal likelihood of a low-rank Gaussian process.

The network with a ridge in the kernel's norm is the posterior mean of a Gaussian process whose
noise variance is `alpha` times its signal variance. The marginal likelihood of that process on a
few hundred inducing rows (the projected process of [1]_) is a smooth function of the logarithms of
the widths and of `alpha`; the signal variance of every output is profiled out, so that outputs of
any scale count alike. The inverse widths have a half-Cauchy prior, whose scale is a standard
deviation of the feature [2]_: with few or noisy rows the likelihood alone finds narrow widths, in
features that do not matter.

References
----------
.. [1] C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT Press
   2006, sections 5.4 and 8.3.
.. [2] D. Eriksson, M. Jankowiak, "High-dimensional Bayesian optimization with sparse axis-aligned
   subspaces", Uncertainty in Artificial Intelligence 2021.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, blas, cholesky, lapack
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from sklearn_raacmm.network._kernels import KERNELS, pivoted_cholesky, squared_distances

ALPHA_BOUNDS = (1e-12, 1e6)
# Below it inverses lose too many digits, and eigenvectors take their place.
SMALL_ALPHA = 1e-5
# Added to the inducing rows' kernel matrix for its Cholesky factor to exist: the first that does.
JITTER = (1e-10, 1e-8, 1e-6)
# In standard deviations of a feature: below, every sample is alone; above, the feature is ignored.
WIDTH_BOUNDS = (1e-2, 1e3)
# Rows of the first stage; rows and iterations of those that follow, and their inducing rows.
COARSE_ROWS = 300
FINE = ((1000, 40), (3000, 30), (3000, 30))
SAMPLE_ROWS = FINE[-1][0]
# Logarithm by which widths may fall before the inducing rows no longer do.
MARGIN = 0.35
INDUCING = 600
# Nats a target value by which the coarse stage's answer has to be better than noise alone, or the
# search starts once more: half of the variance explained.
WEAK = 0.5 * np.log(2)


class Tuned(NamedTuple):
    """What the likelihood chose."""

    length_scale: np.ndarray  # (n_features,)
    alpha: np.ndarray  # (n_outputs,)
    objective: float  # negative log posterior density per target value, on the rows used
    start: float  # the same at the heuristic start


def negative_log_likelihood(Z, X, Y, weights, n_total, within, kernel, log_width, log_alpha):
    """Negative log marginal likelihood of the projected process, and its gradient.

    Parameters
    ----------
    Z : ndarray of shape (m, d)
        Inducing rows.
    X : ndarray of shape (n, d)
    Y : ndarray of shape (n, q)
        Targets without their polynomial tail.
    weights : ndarray of shape (n,)
    n_total : float
        Number of observations, the sum of their weights.
    within : ndarray of shape (q,)
        Sum of squares that merging repeated rows took out of Y.
    kernel : str
    log_width : ndarray of shape (d,)
    log_alpha : ndarray of shape (q,)

    Returns
    -------
    value : float
    gradient : ndarray of shape (d + q,)
        With respect to `log_width` and `log_alpha`.
    """
    m, q = len(Z), Y.shape[1]
    inverse_width = np.exp(-log_width)
    alphas = np.exp(log_alpha)
    function, slope, definite = KERNELS[kernel]
    root = np.sqrt(weights)
    Zs, Xs = Z * inverse_width, X * inverse_width
    s_mn = squared_distances(Zs, Xs)
    slope_mn = slope(s_mn)
    Kw = function(s_mn) * root
    Yw = root[:, None] * Y
    if definite:
        s_mm = squared_distances(Zs, Zs)
        slope_mm = slope(s_mm)
        L = _root(function(s_mm))
        L_inverse = lapack.dtrtri(L, lower=1)[0]
        # A = L^-1 Kw, as its transpose, which is in the order that BLAS wants.
        A = blas.dtrsm(1.0, L, Kw.T, side=1, lower=1, trans_a=1).T
    else:
        A = Kw
    # The derivatives (the reference's section 5.4.1) go through S = alpha Kmm + Kw Kw', whose
    # inverse is L^-T B^-1 L^-1 with B = A A' + alpha I.
    shrunk = _shrink_stably if alphas.min() < SMALL_ALPHA else _shrink
    solved, log_det, trace, left, right, weighted = shrunk(A, Yw, alphas)
    beta = L_inverse.T @ solved if definite else solved
    residual = Yw - Kw.T @ beta
    prior = np.square(solved).sum(axis=0)
    # As a sum of squares, not as a difference: right to second order in what beta is off.
    unexplained = np.square(residual).sum(axis=0) + within
    quadratic = np.maximum(unexplained / alphas + prior, np.finfo(float).tiny)
    scale = n_total / quadratic
    value = 0.5 * np.sum(log_det + (n_total - m) * log_alpha + n_total * np.log(quadratic))
    d_log_alpha = 0.5 * (alphas * trace + n_total - m + scale * (prior - quadratic))
    G = (L_inverse.T @ left if definite else left) @ right
    G -= (beta * (scale / alphas)) @ residual.T
    G *= root
    G *= slope_mn
    gradient = _width_gradient(G, Zs, Xs)
    if definite:
        weighted[np.diag_indices(m)] -= q
        H = L_inverse.T @ weighted @ L_inverse
        H += (beta * scale) @ beta.T
        H *= 0.5 * slope_mm
        gradient += _width_gradient(H, Zs, Zs)
    return value, np.append(gradient, d_log_alpha)


def leave_one_out_error(X, Y, weights, kernel, log_width, log_alpha):
    """Mean squared leave-one-out residual of the process with every row inducing.

    The arguments are as for `negative_log_likelihood`.
    """
    root = np.sqrt(weights)
    Xs = X * np.exp(-log_width)
    K = KERNELS[kernel].function(squared_distances(Xs, Xs))
    A = (root[:, None] * K).T
    if KERNELS[kernel].positive_definite:
        A = blas.dtrsm(1.0, _root(K), A.T, side=1, lower=1, trans_a=1).T
    Yw = root[:, None] * Y
    values, vectors = np.linalg.eigh(A.T @ A)
    error = 0.0
    for i, alpha in enumerate(np.exp(log_alpha)):
        # Both as parts of what the smoother leaves, lest they be differences of near equals.
        left = alpha / (np.maximum(values, 0.0) + alpha)
        residual = vectors @ (left * (vectors.T @ Yw[:, i]))
        error += np.sum(np.square(residual / (np.square(vectors) @ left)))
    return error


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
        B = np.array(AA, order="F")
        B[np.diag_indices(m)] += alpha
        root = cholesky(B, lower=True, overwrite_a=True, check_finite=False)
        log_det[i] = 2 * np.log(root.diagonal()).sum()
        solved[:, i] = lapack.dpotrs(root, AY[:, i], lower=1)[0]
        inverse = lapack.dpotri(root, lower=1, overwrite_c=1)[0]
        lower = np.tril(inverse, -1)
        inverse = lower + lower.T + np.diag(inverse.diagonal())
        trace[i] = np.trace(inverse)
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


def _width_gradient(G, A, B):
    """Sum over pairs of G_ij times d s_ij / d log width, for every feature."""
    return -2 * (
        G.sum(axis=1) @ (A * A) + G.sum(axis=0) @ (B * B) - 2 * np.einsum("ik,ik->k", A, G @ B)
    )


def tune(
    X,
    Y,
    weights,
    within,
    kernel,
    *,
    length_scale=None,
    isotropic=False,
    alpha=None,
    random_state=None,
):
    """Maximise the marginal likelihood over what is not given, on few rows first, then on many.

    Parameters
    ----------
    X : ndarray of shape (n, d)
        Distinct rows.
    Y : ndarray of shape (n, q)
        Targets without their polynomial tail.
    weights : ndarray of shape (n,)
    within : ndarray of shape (q,)
        Sum of squares that merging repeated rows took out of Y.
    kernel : str
    length_scale : ndarray of shape (d,), optional
        Fixed widths; found where None.
    isotropic : bool
        One width, in units of each feature's standard deviation.
    alpha : float, optional
        Fixed ridge; found where None.
    random_state : numpy.random.RandomState
        Draws the rows of a stage where there are more than it uses.

    Returns
    -------
    Tuned
    """
    (n, d), q = X.shape, Y.shape[1]
    mean = np.average(X, axis=0, weights=weights)
    spread = np.sqrt(np.average((X - mean) ** 2, axis=0, weights=weights))
    varying = spread > 1e-13 * np.abs(mean)
    if length_scale is None and not np.all(varying):
        # Of a feature that does not vary nothing can be learnt: it is ignored.
        found = tune(
            X[:, varying],
            Y,
            weights,
            within,
            kernel,
            isotropic=isotropic,
            alpha=alpha,
            random_state=random_state,
        )
        length_scale = np.full(d, np.inf)
        length_scale[varying] = found.length_scale
        return found._replace(length_scale=length_scale)
    X = X - mean
    log_spread = np.log(np.where(varying, spread, 1.0))
    n_widths = 0 if length_scale is not None or not d else 1 if isotropic else d
    n_alphas = q if alpha is None else 0
    if not q:
        # Nothing varies, nothing can be learnt of the widths.
        return Tuned(np.exp(log_spread) * np.sqrt(d), np.empty(0), 0.0, 0.0)
    if not d:
        return Tuned(np.empty(0), np.full(q, 1.0 if alpha is None else alpha), 0.0, 0.0)

    def unpack(theta):
        log_width = log_spread + theta[:n_widths] if n_widths else np.log(length_scale)
        if n_alphas:
            return log_width, theta[n_widths:]
        return log_width, np.full(q, np.log(max(alpha, ALPHA_BOUNDS[0])))

    def objective(theta, rows, inducing):
        log_width, log_alpha = unpack(theta)
        w = weights[rows]
        n_total = w.sum()
        share = within * (n_total / weights.sum())
        data = X[inducing], X[rows], Y[rows], w, n_total, share
        try:
            value, gradient = negative_log_likelihood(*data, kernel, log_width, log_alpha)
        except LinAlgError:
            return np.inf, np.zeros(len(theta))
        by_width = gradient[:d] if n_widths == d else [gradient[:d].sum()] * n_widths
        gradient = np.append(by_width, gradient[d:] if n_alphas else [])
        narrow = np.exp(-2 * theta[:n_widths])
        value += np.log1p(narrow).sum()
        gradient[:n_widths] -= 2 * narrow / (1 + narrow)
        return value / (n_total * q), gradient / (n_total * q)

    bounds = [np.log(WIDTH_BOUNDS)] * n_widths + [np.log(ALPHA_BOUNDS)] * n_alphas

    def minimise(theta, rows, inducing, max_iter):
        # Small steps along a valley of the likelihood add up: the tolerance in nats is as small as
        # the cost of a step allows.
        nats = np.clip(1e-11 * len(inducing) ** 2 * len(rows), 1e-4, 1e-2)
        options = {"maxiter": max_iter, "ftol": nats / (weights[rows].sum() * q)}
        result = minimize(
            objective, theta, (rows, inducing), "L-BFGS-B", jac=True, bounds=bounds, options=options
        )
        start = objective(theta, rows, inducing)[0]
        return (result.x, result.fun, start) if result.fun < start else (theta, start, start)

    def draw(size):
        return np.arange(n) if n <= size else np.sort(random_state.permutation(n)[:size])

    most = min(n, SAMPLE_ROWS)
    # The whole process on few rows. Even the nearest of many neighbours is about sqrt(d) standard
    # deviations away, so that starts are in units of it.
    rows = draw(COARSE_ROWS)
    starts = [
        np.append(np.full(n_widths, np.log(c * np.sqrt(d))), np.full(n_alphas, np.log(a)))
        for c in (0.05, 0.2, 0.5, 1.0, 2.5)
        for a in (1e-3, 1e-1)
    ]
    # The likelihood may have several peaks: from the two best starts that differ in width.
    starts.sort(key=lambda theta: objective(theta, rows, rows)[0])
    second = [theta for theta in starts if n_widths and theta[0] != starts[0][0]][:1]
    ends = [minimise(theta, rows, rows, 60) for theta in [starts[0], *second]]
    if q > 1 and len(ends) > 1:
        # The likelihood may give up one output for the others' sake; the error of prediction,
        # averaged over outputs, does not.
        data = X[rows], Y[rows], weights[rows], kernel
        ends.sort(key=lambda end: leave_one_out_error(*data, *unpack(end[0])))
    else:
        ends.sort(key=lambda end: end[1])
    theta, value, start = ends[0]
    nothing = np.append(theta[:n_widths], np.full(n_alphas, np.log(ALPHA_BOUNDS[1])))
    unclear = n_widths and n > len(rows) and objective(nothing, rows, rows)[0] - value < WEAK

    def improve(theta, rows, max_iter):
        # Rows that would do for narrower widths too, lest the widths be held where they are, and
        # so many that what they leave unexplained is small beside the noise.
        log_width, log_alpha = unpack(theta)
        tol = min(0.03 * np.exp(log_alpha.min()), 1e-2)
        inducing = _inducing(X, rows, np.exp(log_width - MARGIN), kernel, tol)
        return minimise(theta, rows, inducing, max_iter)

    for size, max_iter in FINE if n > len(rows) else ():
        before, rows = theta, draw(size)
        theta, value, start = improve(theta, rows, max_iter)
        if unclear:
            # What few rows could not tell from noise: once more from a wide start on many.
            wide = np.append(
                np.full(n_widths, np.log(2.5 * np.sqrt(d))), np.full(n_alphas, np.log(0.1))
            )
            other = improve(wide, rows, max_iter)[0]
            other, at_other, from_other = improve(other, rows, max_iter)
            if at_other < value:
                theta, value, start = other, at_other, from_other
            unclear = False
        # The inducing rows did for what has been found, unless a width fell by more than they
        # allow for. Widths of ignored features drift without effect.
        fell = np.append(before[:n_widths] < np.log(20), [True] * n_alphas) * (before - theta)
        if len(rows) == most and not np.any(fell > MARGIN):
            break
    log_width, log_alpha = unpack(theta)
    if n_widths and n_alphas and n > 1 and _links_nothing(X / np.exp(log_width), kernel):
        # A kernel that links no row to another is noise by another name.
        log_width = log_spread + 0.5 * np.log(d)
        log_alpha = np.full(q, np.log(ALPHA_BOUNDS[1]))
    return Tuned(np.exp(log_width), np.exp(log_alpha), float(value), float(start))


def _links_nothing(Z, kernel):
    """Whether the kernel is all but 0 between most rows and their nearest neighbours."""
    if not KERNELS[kernel].positive_definite:
        return False
    some = Z[:: max(1, len(Z) // 1000)]
    nearest = cKDTree(Z).query(some, k=2)[0][:, 1]
    return np.median(KERNELS[kernel].function(nearest**2)) < 1e-3


def _inducing(X, rows, length_scale, kernel, tol):
    """Rows that the kernel spreads best: the first pivots of its Cholesky factor."""
    if not KERNELS[kernel].positive_definite:
        kernel = "gaussian"
    factor = pivoted_cholesky(X[rows] / length_scale, kernel, tol=tol, max_rank=INDUCING)
    return rows[factor.pivots]
