"""A centre at every row: the Gaussian process itself, by one Cholesky factor.

Where a function is rough a network needs so many centres that to choose them takes longer than to
solve for the weights of all rows. With the root R of the rows' weights and B the polynomial's
columns at the rows these are the solution of ``(K + alpha R^-2) w + B b = y`` for a given b, and b
is that of generalised least squares [1]_.

References
----------
.. [1] C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT Press
   2006, section 2.7.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, lapack, solve_triangular

from sklearn_raacmm.network._kernels import kernel_matrix, psd_inverse_root
from sklearn_raacmm.network._likelihood import LEAST_RIDGE
from sklearn_raacmm.network._nested_fits import triangular_factor
from sklearn_raacmm.network._network_posterior import Posterior, variances
from sklearn_raacmm.network._polynomial_tail import ridge_rows
from sklearn_raacmm.utils import chunks, invert_triangle, stage

# Rows whose kernel matrix is factored: 800 MB, and 10 s of one thread.
MOST_ROWS = 10_000
# Rows from which on it is asked whether all shall be centres. To choose among fewer takes no longer
# than to find the widths.
FEWEST_ROWS = 1000
# Rows of the first and of the largest sample from which that share is estimated.
_FIRST_SAMPLE, _LARGEST_SAMPLE = 500, 2000
# Kernel values computed at a time while a matrix is filled.
_CHUNK = 2**20


class _Root(NamedTuple):
    """What the posterior of the outputs of one ridge is computed with."""

    factor: np.ndarray  # (n, n) lower triangular: of R K R + alpha I
    tail: np.ndarray  # (n, p) the factor's inverse times the polynomial's columns
    triangle: np.ndarray  # (p, p) R such that (R' R)^-1 is the polynomial's covariance, over noise


@dataclass(frozen=True, eq=False)
class ProcessPosterior(Posterior):
    """Posterior of a Gaussian process with n rows, all of which are centres.

    It has the attributes and methods of `NetworkPosterior`, with k = n. In place of a triangular
    factor of n^2 / 2 numbers it keeps what the factor is made of; the first call that asks for a
    standard deviation makes it anew, in time cubic and memory quadratic in n, for every ridge.

    Attributes
    ----------
    weights : ndarray of shape (k,)
        Of the rows, in units of an observation.

    tail_ridge : float
        Ridge of the polynomial's linear part, in units of an observation.
    """

    weights: np.ndarray
    tail_ridge: float

    # Solving for a hundred points at once is 1.7 times as fast as for 26 (10 000 rows).
    _further, _chunk_of_std = MappingProxyType({"weights": ("k",)}), 2**20

    @cached_property
    def _roots(self):
        """For every ridge its outputs and their `_Root`."""
        root, Z = np.sqrt(self.weights), self._scaled_centers[1]
        tail = root[:, None] * self.tail(self.centers)
        below = ridge_rows(tail.shape[1], self.tail_ridge)
        found = []
        for alpha in np.unique(self.alpha):
            factor = covariance_factor(Z, self.kernel, root, alpha)
            half = solve_triangular(factor, tail, lower=True, check_finite=False)
            triangle = triangular_factor(np.vstack([np.sqrt(alpha) * half, below]))
            found.append((np.flatnonzero(self.alpha == alpha), _Root(factor, half, triangle)))
        return found

    def with_noise(self, factor):
        """The same with a larger variance of the noise, for one that was estimated too small.

        What the noise makes of the weights is a part of the prior's variance here, whose ratio to
        that of the noise is the ridge: both grow.
        """
        return replace(super().with_noise(factor), signal_variance=factor * self.signal_variance)

    def _whitened(self, X, K):
        tail, weighted = self.tail(X).T, (K * np.sqrt(self.weights)).T
        for of, root in self._roots:
            inside = solve_triangular(root.factor, weighted, lower=True, check_finite=False)
            left = tail - root.tail.T @ inside
            solved = solve_triangular(root.triangle, left, trans="T", check_finite=False)
            yield of, root, inside.T, solved

    def _slopes(self, root, inside, solved):
        by_tail = solve_triangular(root.triangle, solved, check_finite=False)
        both = np.hstack([inside.T, root.tail @ by_tail])
        both = solve_triangular(root.factor, both, lower=True, trans="T", check_finite=False).T
        both *= np.sqrt(self.weights)
        n = len(inside)
        return both[:n], np.hstack([by_tail.T, -both[n:]])

    def design_triangle(self):
        """Triangular factor of the columns at the training rows, polynomial first."""
        root, below = np.sqrt(self.weights)[:, None], len(self.tail_map)
        rows = root * np.hstack([self.tail(self.centers), self.radial(self.centers)])
        ridge = ridge_rows(below, self.tail_ridge)
        below = np.zeros((len(ridge), rows.shape[1]))
        below[:, : ridge.shape[1]] = ridge
        return triangular_factor(np.vstack([rows, below]))

    @property
    def prior_root(self):
        """W such that ``|W k(x)|^2`` is the part of the prior variance in the centres' span."""
        centers = self._scaled_centers[1]
        return psd_inverse_root(kernel_matrix(centers, centers, self.kernel))


def covariance_factor(Z, kernel, root, alpha):
    """Cholesky factor of a weighted kernel matrix with a ridge, in the memory of one matrix.

    Parameters
    ----------
    Z : ndarray of shape (n, d)
        Rows divided by the length scales.
    kernel : str
    root : ndarray of shape (n,)
        Root of the rows' weights.
    alpha : float

    Returns
    -------
    ndarray of shape (n, n), Fortran order
        Lower triangular.

    Raises
    ------
    LinAlgError
        If the matrix is not positive definite to working precision.
    """
    n = len(Z)
    C = np.empty((n, n), order="F")
    for part in chunks(n, _CHUNK // max(n, 1)):
        below = slice(part.start, n)
        K = kernel_matrix(Z[part], Z[below], kernel)
        K *= root[part, None]
        K *= root[below]
        C[below, part] = K.T
    C[np.diag_indices(n)] += alpha
    factor, failed = lapack.dpotrf(C, lower=1, clean=1, overwrite_a=1)
    if failed:
        raise LinAlgError("kernel matrix is not positive definite to working precision")
    return factor


def n_parameters(Z, kernel, root, alpha):
    """Effective number of parameters of a process: the trace of its smoother.

    Parameters
    ----------
    Z, kernel, root, alpha
        As for `covariance_factor`.

    Returns
    -------
    float
    """
    factor = covariance_factor(Z, kernel, root, alpha)
    invert_triangle(factor)
    return len(Z) - alpha * np.square(factor).sum()


def may_take_all(problem, alpha):
    """Whether a factor of all rows can be had: by their number, and by the size of the ridge.

    Parameters
    ----------
    problem : Problem or ChunkedProblem
    alpha : ndarray of shape (q,)
        Ridge of every output, in units of an observation.
    """
    if not FEWEST_ROWS <= problem.n_rows <= MOST_ROWS or problem.codes is not None:
        return False
    return bool(alpha.min() >= LEAST_RIDGE * np.square(problem.root).max())


def share_of_parameters(problem, alpha, functions, enough=0.0):
    """Effective number of parameters of a process over the number of its rows.

    It falls with every row that comes in. So a sample whose share is small decides already. Where
    it is large in a sample of 2000 rows, the last doubling is continued as a power of the number:
    with 6000 rows of three rough functions 6 to 14 % too many.

    Parameters
    ----------
    problem : Problem
    alpha : float
        In units of an observation.
    functions : RadialFunctions
    enough : float, default=0.0
        A share that is below needs no further digits.

    Returns
    -------
    float
        An upper bound where it is not above `enough`.
    """
    kernel, shift, length_scale = functions
    Z, root, n = (problem.X - shift) / length_scale, problem.root[:, 0], problem.n_rows
    # The same rows whatever `random_state` is: an outcome near the limit hangs on the data alone.
    order = np.random.RandomState(0).permutation(n)
    size, last = min(n, _FIRST_SAMPLE), None
    while True:
        rows = np.sort(order[:size])
        share = n_parameters(Z[rows], kernel, root[rows], alpha) / size
        if share <= enough or size == n:
            return share
        if size >= _LARGEST_SAMPLE:
            return share * (share / last) ** np.log2(n / size)
        size, last = min(n, 2 * size), share


@stage("centres of the network")
def process_of(problem, alpha, functions, n_found=0.0):
    """The process with a centre at every row.

    Parameters
    ----------
    problem : Problem
    alpha : ndarray of shape (q,)
        Ridge of every output, in units of an observation.
    functions : RadialFunctions
    n_found : float, default=0.0
        Parameters of each output that the data have decided on beside the variances.

    Returns
    -------
    ProcessPosterior
    """
    kernel, shift, length_scale = functions
    Z, root = (problem.X - shift) / length_scale, problem.root
    (n, p), q = problem.tail.shape, problem.targets.shape[1]
    coef, polynomial, objective = np.empty((n, q)), np.empty((p, q)), np.empty(q)
    for one in np.unique(alpha):
        of = np.flatnonzero(alpha == one)
        factor = covariance_factor(Z, kernel, root[:, 0], one)
        both = np.hstack([problem.tail, problem.targets[:, of]])
        both = solve_triangular(factor, both, lower=True, check_finite=False)
        # In units of the noise, the ridge of the tail as further rows.
        rows = np.zeros((n + len(problem.tail_rows), p + len(of)))
        rows[:n], rows[n:, :p] = np.sqrt(one) * both, problem.tail_rows
        R = triangular_factor(rows)
        polynomial[:, of] = solve_triangular(R[:p, :p], R[:p, p:], check_finite=False)
        objective[of] = np.square(R[p:, p:]).sum(axis=0)
        left = both[:, p:] - both[:, :p] @ polynomial[:, of]
        solved = solve_triangular(factor, left, lower=True, trans="T", check_finite=False)
        coef[:, of] = root * solved
        del factor  # two would not fit
    noise, signal = variances(problem, alpha, objective + problem.within, n_found)
    return ProcessPosterior(
        kernel,
        problem.X,
        length_scale,
        coef,
        problem.tail_map.T @ polynomial,
        alpha,
        float(problem.unit),
        noise,
        signal,
        problem.tail_map,
        np.square(root[:, 0]),
        float(problem.tail_ridge),
    )
