r"""Noise that the rows of a group have in common: a smooth function of each group's own.

Rows of one group resemble each other in more than the features tell: what is left of them is
smooth, too, and differs from group to group. A process that takes it for independent noise finds
widths that are too narrow and a ridge that is too small, and carries the group's own function to
other groups. Here the noise of an output has the covariance

.. math:: \alpha s^2 ((1 - \rho) W^{-1} + \rho\, K \circ G), \qquad G_{ij} = 1
   \text{ where i and j are of one group, else } 0,

with the same kernel matrix K as the function that all groups share. The share :math:`\rho` is one
more parameter of the likelihood.
"""

from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from sklearn_raacmm.network._kernels import KERNELS, kernel_matrix, squared_distances
from sklearn_raacmm.network._likelihood import (
    Likelihood,
    centre,
    inverses,
    rank_one_gradient,
    weigh,
    width_gradient,
)


def group_slices(codes):
    """Slices of the rows of each group; the codes are sorted."""
    borders = np.flatnonzero(np.diff(codes, prepend=-1, append=codes[-1] + 1))
    return [slice(start, stop) for start, stop in pairwise(borders)]


def group_likelihood(data, kernel, log_width, log_alpha, log_ratio):
    """Negative log marginal likelihood of the deviations from groups' means, and its gradient.

    Parameters
    ----------
    data : Data
        With `codes`, sorted.
    kernel : str
    log_width : ndarray of shape (d,)
    log_alpha : ndarray of shape (q,)
        Of all noise, the groups' own functions included.
    log_ratio : float
        Logarithm of the ratio of the own functions' variance to that of the rest of the noise.

    Returns
    -------
    Likelihood
        Gradients are with respect to (log_width, log_alpha, log_ratio), (d + q + 1,).
    """
    X, Y, weights, within, codes = data
    n, n_total, root, alphas = len(X), data.n_total, np.sqrt(weights), np.exp(log_alpha)
    share = 1 / (1 + np.exp(-log_ratio))
    Xs, same = X * np.exp(-log_width), np.equal.outer(codes, codes)
    K, slope = KERNELS[kernel].with_slope(squared_distances(Xs, Xs))
    weigh(K, root)
    weigh(slope, root)
    own = centre(centre(K * same, data).T, data)
    own[np.diag_indices(n)] -= 1.0
    K, Yw = centre(centre(K, data).T, data), root[:, None] * Y
    value, gradient, signal = 0.0, np.zeros(len(log_width) + len(alphas) + 1), []
    of_signal = np.zeros((len(alphas), len(gradient)))
    summed, by_noise = np.zeros((n, n)), np.zeros((n, n))
    for i, alpha in enumerate(alphas):
        y, d = Yw[:, i], len(log_width)
        a, log_det, _, half = inverses(K + alpha * share * own, y[:, None], alphas[i : i + 1])
        a, inverse, of_noise = a[:, 0], half + half.T, within[i] / (alpha * (1 - share))
        Q = max(y @ a + of_noise, np.finfo(float).tiny)
        value += 0.5 * log_det[0] + 0.5 * n_total * np.log(Q)
        value += 0.5 * (n_total - n) * (log_alpha[i] + np.log1p(-share))
        # Derivatives of the quadratic form: by widths, by ridge, by ratio.
        by_share = alpha * share * (1 - share)
        of_signal[i, :d] = -rank_one_gradient(slope * (1 + alpha * share * same), a, Xs)
        of_signal[i, d + i] = a @ K @ a - y @ a - of_noise
        of_signal[i, -1] = share * of_noise - by_share * (a @ own @ a)
        gradient += 0.5 * n_total / Q * of_signal[i]
        gradient[d + i] += 0.5 * (n_total - np.vdot(inverse, K))
        gradient[-1] += 0.5 * (by_share * np.vdot(inverse, own) - share * (n_total - n))
        summed += inverse
        by_noise += alpha * share * inverse
        signal.append(Q / n_total)
    W = centre(centre(summed, data).T, data)
    W += same * centre(centre(by_noise, data).T, data)
    gradient[: len(log_width)] += width_gradient(0.5 * W * slope, Xs, Xs)
    return Likelihood(value, gradient, np.array(signal), of_signal / n_total)


def group_errors(data, codes, kernel, log_width, log_alpha, share=0.0):
    """Squared errors of the deviations of each group, predicted from all other groups.

    In closed form: what a block of the inverse covariance says of a group is what it says of a row
    elsewhere (section 5.4.2 of the reference in `_likelihood`).

    Parameters
    ----------
    data : Data
        With offsets of groups, or without.
    codes : ndarray of shape (n,)
        Sorted.
    kernel : str
    log_width : ndarray of shape (d,)
    log_alpha : ndarray of shape (q,)
    share : float, default=0.0
        Of the noise variance: the groups' own functions.

    Returns
    -------
    ndarray of shape (n_groups,)
        Weighted sums over rows and outputs.
    """
    root, alphas = np.sqrt(data.weights), np.exp(log_alpha)
    Xs = data.X * np.exp(-log_width)
    K = kernel_matrix(Xs, Xs, kernel)
    weigh(K, root)
    own = centre(centre(K * np.equal.outer(codes, codes), data).T, data)
    own[np.diag_indices(len(K))] -= 1.0
    K = centre(centre(K, data).T, data)
    parts = group_slices(codes)
    errors = np.zeros(len(parts))
    for i, alpha in enumerate(alphas):
        y = root[:, None] * data.Y[:, i : i + 1]
        solved, _, _, half = inverses(K + alpha * share * own, y, alphas[i : i + 1])
        for g, part in enumerate(parts):
            block = half[part, part] + half[part, part].T
            residual = np.linalg.solve(block, solved[part, 0])
            constant = root[part] / np.linalg.norm(root[part])
            errors[g] += residual @ residual - (constant @ residual) ** 2
    return errors


def whiteners(Z, kernel, weights, codes, share):
    """Matrix of each group that makes its noise independent, and takes its constant out.

    Parameters
    ----------
    Z : ndarray of shape (n, d)
        Rows in units of the widths.
    kernel : str
    weights : ndarray of shape (n,)
    codes : ndarray of shape (n,)
        Sorted.
    share : float

    Returns
    -------
    matrices : list of ndarray of shape (m, m)
        Of m rows in the group. The independent noise has the variance of a deviation's noise.
    variance : float
        Of a deviation's noise, over that of all noise of an observation.
    """
    matrices, total, groups = [], 0.0, group_slices(codes)
    for part in groups:
        root = np.sqrt(weights[part])
        centring = np.diag(root) - np.outer(root, weights[part] / weights[part].sum())
        # The weighted deviations of a column f are `centring @ f`, and so is their covariance.
        own = share * centring @ kernel_matrix(Z[part], Z[part], kernel) @ centring.T
        total += np.trace(own) + (1 - share) * (len(own) - 1)
        own[np.diag_indices(len(own))] += 1 - share
        L = np.linalg.cholesky(own)
        matrices.append(solve_triangular(L, centring, lower=True, check_finite=False))
    variance = total / max(len(codes) - len(groups), 1)
    return [np.sqrt(variance) * T for T in matrices], variance
