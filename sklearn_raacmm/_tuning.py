r"""Widths and ridge from the data, by the marginal likelihood of a low-rank Gaussian process.

The network with a ridge in the kernel's norm is the posterior mean of a Gaussian process whose
noise variance is `alpha` times its signal variance. The marginal likelihood of that process on a
few hundred inducing rows (the projected process of [1]_) is a smooth function of the logarithms of
the widths and of `alpha`; the signal variance of every output is profiled out, so that outputs of
any scale count alike.

References
----------
.. [1] C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT Press
   2006, sections 5.4 and 8.3.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular
from scipy.optimize import minimize

from sklearn_raacmm._kernels import KERNELS, pivoted_cholesky, squared_distances

ALPHA_BOUNDS = (1e-9, 1e3)
# In standard deviations of a feature: below, every sample is alone; above, the feature is ignored.
WIDTH_BOUNDS = (1e-2, 1e3)


class Tuned(NamedTuple):
    """What the likelihood chose."""

    length_scale: np.ndarray  # (n_features,)
    alpha: float
    objective: float  # negative log marginal likelihood per target value, on the rows used
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
        Number of observations, the sum of the weights.
    within : ndarray of shape (q,)
        Sum of squares that merging repeated rows took out of Y.
    kernel : str
    log_width : ndarray of shape (d,)
    log_alpha : float

    Returns
    -------
    value : float
    gradient : ndarray of shape (d + 1,)
        With respect to `log_width` and `log_alpha`.
    """
    m, q = len(Z), Y.shape[1]
    inverse_width = np.exp(-log_width)
    alpha = np.exp(log_alpha)
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
        Kmm = function(s_mm)
        Kmm[np.diag_indices(m)] += 1e-8
        L = cholesky(Kmm, lower=True, check_finite=False)
        A = solve_triangular(L, Kw, lower=True, check_finite=False)
    else:
        L, A = None, Kw
    B = A @ A.T
    B[np.diag_indices(m)] += alpha
    LB = cholesky(B, lower=True, check_finite=False)
    LB_inverse = solve_triangular(LB, np.eye(m), lower=True, check_finite=False)
    c = LB_inverse @ (A @ Yw)
    total = np.square(Yw).sum(axis=0) + within
    quadratic = np.maximum(total - np.square(c).sum(axis=0), 1e-14 * total) / alpha
    value = (
        0.5 * q * (2 * np.log(LB.diagonal()).sum() + (n_total - m) * log_alpha)
        + 0.5 * n_total * np.log(quadratic).sum()
    )

    B_inverse = LB_inverse.T @ LB_inverse
    beta = LB_inverse.T @ c
    scale = n_total / quadratic
    # The three derivatives below are those of log det and of the quadratic form with respect to
    # the whitened weights' covariance; see the module's reference, section 5.4.1.
    d_log_alpha = 0.5 * q * (alpha * np.trace(B_inverse) + n_total - m) + 0.5 * (
        scale @ (np.square(beta).sum(axis=0) - quadratic)
    )
    T = B_inverse @ A
    if definite:
        beta_z = solve_triangular(L, beta, lower=True, trans="T", check_finite=False)
        T = solve_triangular(L, T, lower=True, trans="T", check_finite=False, overwrite_b=True)
    else:
        beta_z = beta
    residual = Yw - Kw.T @ beta_z
    G = q * T - (beta_z * (scale / alpha)) @ residual.T
    G *= root
    G *= slope_mn
    gradient = _width_gradient(G, Zs, Xs)
    if definite:
        L_inverse = solve_triangular(L, np.eye(m), lower=True, check_finite=False)
        H = 0.5 * q * (L_inverse.T @ ((alpha * B_inverse - np.eye(m)) @ L_inverse))
        H += 0.5 * (beta_z * scale) @ beta_z.T
        H *= slope_mm
        gradient += _width_gradient(H, Zs, Zs)
    return value, np.append(gradient, d_log_alpha)


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
    stages=((300, 300), (450, 3000)),
):
    """Maximise the marginal likelihood over what is not given.

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
    stages : sequence of (int, int)
        Inducing rows and rows of each stage, coarse to fine.

    Returns
    -------
    Tuned
    """
    n, d = X.shape
    spread = np.sqrt(
        np.average((X - np.average(X, axis=0, weights=weights)) ** 2, axis=0, weights=weights)
    )
    spread = np.where(spread > 0, spread, 1.0)
    fixed = length_scale is not None

    def unpack(theta):
        if fixed:
            log_width = np.log(length_scale)
        elif isotropic:
            log_width = np.log(spread) + theta[0]
        else:
            log_width = np.log(spread) + theta[:d]
        return log_width, np.log(alpha) if alpha is not None else theta[-1]

    n_widths = 0 if fixed else 1 if isotropic else d

    def objective(theta, rows, inducing):
        log_width, log_alpha = unpack(theta)
        total = n_total * weights[rows].sum() / weights.sum()
        share = within * total / n_total
        try:
            value, gradient = negative_log_likelihood(
                X[inducing],
                X[rows],
                Y[rows],
                weights[rows],
                total,
                share,
                kernel,
                log_width,
                log_alpha,
            )
        except LinAlgError:
            return np.inf, np.zeros(len(theta))
        by_width = gradient[:d] if n_widths == d else gradient[:d].sum(keepdims=True)[:n_widths]
        gradient = np.append(by_width, gradient[d] if alpha is None else [])
        return value / total / Y.shape[1], gradient / total / Y.shape[1]

    n_total = weights.sum()
    bounds = [np.log(WIDTH_BOUNDS)] * n_widths + [np.log(ALPHA_BOUNDS)] * (alpha is None)
    theta, start = None, None
    for m, n_rows in stages:
        rows = np.arange(n) if n <= n_rows else np.sort(random_state.permutation(n)[:n_rows])
        if theta is None:
            # Even the nearest of many neighbours is about a root of d standard deviations away.
            trials = [
                np.append(np.full(n_widths, np.log(c * np.sqrt(d))), [a] * (alpha is None))
                for c in (0.4, 1.0, 2.5)
                for a in np.log((1e-3, 1e-1))
            ]
        else:
            trials = [theta]
        scored = []
        for trial in trials:
            inducing = _inducing(X, rows, np.exp(unpack(trial)[0]), kernel, m)
            scored.append((objective(trial, rows, inducing)[0], tuple(trial), inducing))
        value, trial, inducing = min(scored, key=lambda s: s[0])
        result = minimize(
            objective,
            trial,
            (rows, inducing),
            jac=True,
            method="L-BFGS-B",
            bounds=bounds,
            options={"maxiter": 60},
        )
        theta = result.x if result.fun <= value else np.array(trial)
        start = value if start is None else start
        if n <= n_rows and m >= n:
            break
    log_width, log_alpha = unpack(theta)
    return Tuned(
        np.exp(log_width), float(np.exp(log_alpha)), float(min(result.fun, value)), float(start)
    )


def _inducing(X, rows, length_scale, kernel, m):
    """Rows that the kernel spreads best: the first m pivots of its Cholesky factor."""
    if not KERNELS[kernel].positive_definite:
        kernel = "gaussian"
    scaled = X[rows] / length_scale
    return rows[pivoted_cholesky(scaled, kernel, tol=1e-8, max_rank=m).pivots]
