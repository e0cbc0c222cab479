"""The fitted network as a value: its functions, weights and their posterior."""

from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from sklearn_raacmm.network._candidates import Features
from sklearn_raacmm.network._kernels import (
    KERNELS,
    kernel_matrix,
    psd_inverse_root,
    psd_root,
    squared_distances,
)
from sklearn_raacmm.network._nested_fits import (
    beside_centers,
    nested_least_squares,
    penalise,
    stack_triangles,
    triangle_of_all,
)
from sklearn_raacmm.utils import check_shapes, chunks

# Degrees of freedom at the least by which the sum of squares is divided. With 1 instead 85 % of new
# observations, not 91 %, were inside the 95 % intervals of 10 rows of 20 features (the worst of
# seven simulated functions).
_FEWEST_DEGREES = 0.5
# Of two observations, which leave one degree: 95 % of Student's variable are within 12.7 then, of a
# normal one within 1.96. With 0.5 degrees 70 % of new observations were inside (45 functions).
_OF_TWO = (1.96 / 12.706) ** 2
# Kernel values held at a time while predicting: they stay in a core's cache.
_CHUNK = 2**18


class RadialFunctions(NamedTuple):
    """Kernel and widths that were chosen, and the middle of the rows."""

    kernel: str
    shift: np.ndarray  # (d,)
    length_scale: np.ndarray  # (d,)


@dataclass(frozen=True, eq=False)
class Posterior:
    """What the posteriors of a network and of a whole process have in common.

    Those that inherit say how a point is seen: `_whitened`, and the derivatives of it, `_slopes`.
    """

    kernel: str
    centers: np.ndarray
    length_scale: np.ndarray
    coef: np.ndarray
    polynomial: np.ndarray
    alpha: np.ndarray
    weight_unit: float
    noise_variance: np.ndarray
    signal_variance: np.ndarray
    tail_map: np.ndarray

    # Shapes of further arrays, and kernel values held at a time for standard deviations.
    _further, _chunk_of_std = MappingProxyType({}), _CHUNK

    def __getstate__(self):
        # Without what `_roots` keeps from one call to the next.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __setstate__(self, state):
        vars(self).update(state)
        name = type(self).__name__
        shapes = {"centers": ("k", "d"), "length_scale": ("d",), "coef": ("k", "q")}
        shapes |= {"polynomial": ("d1", "q"), "tail_map": ("p", "d1")}
        shapes |= dict.fromkeys(("alpha", "noise_variance", "signal_variance"), ("q",))
        infinite = ("length_scale", "noise_variance")
        check_shapes(name, state, shapes | self._further, {}, infinite)
        if len(self.polynomial) != 1 + len(self.length_scale):
            raise ValueError(
                f"The file is damaged: polynomial of {name} has {len(self.polynomial)} "
                f"rows, where {1 + len(self.length_scale)} would fit the other arrays."
            )

    @cached_property
    def _scaled_centers(self):
        """Middle of the centres, and the centres about it in units of the widths."""
        shift = self.centers.mean(axis=0) if len(self.centers) else 0.0
        return shift, (self.centers - shift) / self.length_scale

    @property
    def output_groups(self):
        """Group of every output: all are of one, see `GroupedPosterior`."""
        return np.zeros(len(self.alpha), dtype=int)

    def with_noise(self, factor):
        """The same with a larger variance of the noise, for one that was estimated too small."""
        return replace(self, noise_variance=factor * self.noise_variance)

    def scaled(self, X):
        """Rows as the radial functions see them, (n, d)."""
        return (X - self._scaled_centers[0]) / self.length_scale

    def radial(self, X):
        """Values of the radial functions, (n, k)."""
        return kernel_matrix(self.scaled(X), self._scaled_centers[1], self.kernel)

    def tail(self, X):
        """Columns of the polynomial in the fit, (n, p)."""
        return np.column_stack([np.ones(len(X)), X]) @ self.tail_map.T

    @cached_property
    def prior_root(self):
        """W such that ``|W k(x)|^2`` is the part of the prior variance in the centres' span."""
        centers = self._scaled_centers[1]
        return psd_inverse_root(kernel_matrix(centers, centers, self.kernel))

    def predict(self, X, return_std=False, with_noise=True):
        """Mean and standard deviation.

        Parameters
        ----------
        X : ndarray of shape (n, d)

        return_std : bool, default=False

        with_noise : bool, default=True
            Whether the deviation is that of an observation.

        Returns
        -------
        mean : ndarray of shape (n, q)

        std : ndarray of shape (n, q) or None
        """
        n, k = len(X), len(self.centers)
        mean = np.tile(self.polynomial[0], (n, 1))
        if np.any(self.polynomial[1:]):
            mean += X @ self.polynomial[1:]
        variance = np.empty_like(mean) if return_std else None
        for part in chunks(n, (self._chunk_of_std if return_std else _CHUNK) // max(k, 1)):
            K = self.radial(X[part])
            mean[part] += K @ self.coef
            if return_std:
                variance[part] = self._variance(X[part], K, with_noise)
        return mean, np.sqrt(variance) if return_std else None

    def _variance(self, X, K, with_noise):
        """Variance of the weights' part, and of what lies outside the centres' span, (n, q)."""
        variance = np.empty((len(X), len(self.alpha)))
        for of, _, inside, solved in self._whitened(X, K):
            outside = np.maximum(1 - np.square(inside).sum(axis=1), 0.0)
            of_weights = np.square(solved).sum(axis=0) + float(with_noise)
            variance[:, of] = np.outer(outside, self.signal_variance[of])
            variance[:, of] += np.outer(of_weights, self.noise_variance[of])
        return variance

    def covariance(self, X, with_noise=True):
        """Covariance of predictions at some rows.

        Parameters
        ----------
        X : ndarray of shape (n, d)

        with_noise : bool, default=True
            Whether the noise of the observations is on the diagonal.

        Returns
        -------
        ndarray of shape (n, n, q)
        """
        n, Z, K = len(X), self.scaled(X), self.radial(X)
        found = np.empty((n, n, len(self.alpha)))
        prior, diagonal = kernel_matrix(Z, Z, self.kernel), np.diag_indices(n)
        for of, _, inside, solved in self._whitened(X, K):
            outside = prior - inside @ inside.T
            outside[diagonal] = np.maximum(1 - np.square(inside).sum(axis=1), 0.0)
            of_weights = solved.T @ solved
            of_weights[diagonal] += float(with_noise)
            for i in of:
                found[:, :, i] = self.signal_variance[i] * outside
                found[:, :, i] += self.noise_variance[i] * of_weights
        return found

    def sample(self, X, n_samples, rng, with_noise=True):
        """Draws from the posterior at some rows.

        Parameters
        ----------
        X : ndarray of shape (n, d)

        n_samples : int

        rng : numpy.random.RandomState

        with_noise : bool, default=True
            Whether to draw observations, or values of the function.

        Returns
        -------
        ndarray of shape (n, q, n_samples)

        Raises
        ------
        ValueError
            If the noise variance is infinite.
        """
        if not np.all(np.isfinite(self.noise_variance)):
            raise ValueError("The noise variance is infinite: there is nothing to draw from.")
        covariance = self.covariance(X, with_noise=False)
        mean = self.predict(X)[0]
        draws = np.empty((*mean.shape, n_samples))
        for i in range(mean.shape[1]):
            values, vectors = np.linalg.eigh(covariance[:, :, i])
            half = vectors * np.sqrt(np.maximum(values, 0.0))
            draws[:, i] = mean[:, i, None] + half @ rng.standard_normal((len(X), n_samples))
            if with_noise:
                noise = np.sqrt(self.noise_variance[i])
                draws[:, i] += noise * rng.standard_normal((len(X), n_samples))
        return draws

    def gradient(self, X, of_variance=False):
        """Derivatives of the mean, and of the variance, by the features.

        Parameters
        ----------
        X : ndarray of shape (n, d)

        of_variance : bool, default=False

        Returns
        -------
        of_mean : ndarray of shape (n, q, d)

        of_variance : ndarray of shape (n, q, d) or None

        Raises
        ------
        ValueError
            If that of the variance is asked for and the noise variance is infinite.
        """
        if of_variance and not np.all(np.isfinite(self.noise_variance)):
            raise ValueError("The noise variance is infinite: it has no derivatives.")
        n, (q, k) = len(X), self.coef.T.shape
        d = len(self.length_scale)
        of_mean = np.empty((n, q, d))
        found = np.empty((n, q, d)) if of_variance else None
        for part in chunks(n, _CHUNK // max(k, 1)):
            Z = self.scaled(X[part])
            K, slope = KERNELS[self.kernel].with_slope(
                squared_distances(Z, self._scaled_centers[1])
            )
            for i in range(q):
                of_mean[part, i] = self.polynomial[1:, i] + self._along(Z, slope * self.coef[:, i])
            if of_variance:
                found[part] = self._variance_gradient(X[part], Z, K, slope)
        return of_mean, found

    def _along(self, Z, G):
        """Sum over centres j of G_ij d s_ij / d x_i, s the squared distance, (n, d)."""
        along = Z * G.sum(axis=1, keepdims=True) - G @ self._scaled_centers[1]
        return 2 * along / self.length_scale

    def _variance_gradient(self, X, Z, K, slope):
        """Derivatives of the variance, whose noise does not depend on x, (n, q, d)."""
        p, found = len(self.tail_map), np.empty((len(X), len(self.alpha), X.shape[1]))
        for of, root, inside, solved in self._whitened(X, K):
            # Where the span explains all of the prior variance its part is rounding, held at 0.
            positive = np.square(inside).sum(axis=1) < 1
            of_inside, of_solved = self._slopes(root, inside, solved)
            of_inside *= positive[:, None]
            for i in of:
                by_columns = 2 * self.noise_variance[i] * of_solved
                by_kernel = by_columns[:, p:] - 2 * self.signal_variance[i] * of_inside
                found[:, i] = self._along(Z, by_kernel * slope)
                found[:, i] += by_columns[:, :p] @ self.tail_map[:, 1:]
        return found


@dataclass(frozen=True, eq=False)
class NetworkPosterior(Posterior):
    """Posterior of a network of k centres, d features and q outputs.

    `RBFNetRegressor` holds it, exporters read it, and files keep it. It does not change;
    ``dataclasses.replace`` makes another one.

    Attributes
    ----------
    kernel : str
        Radial function.

    centers : ndarray of shape (k, d)
        In the units of X.

    length_scale : ndarray of shape (d,)
        Widths.

    coef : ndarray of shape (k, q)
        Posterior mean of the weights.

    polynomial : ndarray of shape (1 + d, q)
        Constant and linear term.

    alpha : ndarray of shape (q,)
        Ridge, in units of an observation.

    weight_unit : float
        Weight of an observation.

    noise_variance, signal_variance : ndarray of shape (q,)
        In squared units of y.

    tail_map : ndarray of shape (p, 1 + d)
        From the coefficients of the polynomial's p columns in the fit to those of (1, x).

    triangle : ndarray of one dimension
        Triangular factor of the columns at the training rows, polynomial first, packed by rows.
        Trapezoidal where there were fewer rows than columns.
    """

    triangle: np.ndarray

    def design_triangle(self):
        """Triangular factor of the columns at the training rows, polynomial first."""
        n = len(self.tail_map) + len(self.centers)
        size = next(m for m in range(n + 1) if m * n - m * (m - 1) // 2 == len(self.triangle))
        rows = np.zeros((size, n))
        rows[np.triu_indices(size, m=n)] = self.triangle
        return rows

    @cached_property
    def _roots(self):
        """For each output R such that ``(R' R)^-1`` is the weights' covariance, over the noise."""
        centers = self._scaled_centers[1]
        root = psd_root(kernel_matrix(centers, centers, self.kernel))
        rows, p = self.design_triangle(), len(self.tail_map)
        triangles = {a: penalise(rows, p, root, a)[1] for a in np.unique(self.alpha)}
        return [triangles[a] for a in self.alpha]

    def outside(self, X):
        """Part of the prior variance at some rows that the centres do not explain, (n,)."""
        found = np.empty(len(X))
        for part in chunks(len(X), _CHUNK // max(len(self.centers), 1)):
            found[part] = 1 - np.square(self.radial(X[part]) @ self.prior_root.T).sum(axis=1)
        return np.maximum(found, 0.0)

    def _whitened(self, X, K):
        """How points are seen: outputs of one ridge, their root, and the two parts of the variance.

        Yields
        ------
        of : ndarray
            Outputs.
        root : ndarray
        inside : ndarray of shape (n, m)
            Its squared length is the part of the prior variance that is known of.
        solved : ndarray of shape (m, n)
            Its squared length is the variance of the weights' part, over the noise's.
        """
        columns, inside = np.hstack([self.tail(X), K]).T, K @ self.prior_root.T
        for alpha in np.unique(self.alpha):
            of = np.flatnonzero(self.alpha == alpha)
            root = self._roots[of[0]]
            yield of, root, inside, solve_triangular(root, columns, trans="T", check_finite=False)

    def _slopes(self, root, inside, solved):
        """Half the derivatives of the squared lengths.

        Returns
        -------
        of_inside : ndarray of shape (n, k)
            By the values of the radial functions.
        of_solved : ndarray of shape (n, p + k)
            By the columns of the polynomial, and by these values.
        """
        return inside @ self.prior_root, solve_triangular(root, solved, check_finite=False).T


def fit_path(problem, order, alpha, functions):
    """Fit the networks with the first 0, 1, ... of some rows as centres.

    Parameters
    ----------
    problem : Problem
    order : ndarray of shape (m,)
        Rows of the problem, in order of selection.
    alpha : ndarray of shape (q,)
        Ridge of every output, in units of an observation.
    functions : RadialFunctions

    Returns
    -------
    NestedFits
    """
    kernel, shift, length_scale = functions
    Z = (problem.X[order] - shift) / length_scale
    root = psd_root(kernel_matrix(Z, Z, kernel))
    columns = Features(Z, shift, length_scale, kernel)
    p = problem.n_tail
    beside = partial(beside_centers, columns)
    R = triangle_of_all(problem, beside, p + len(order) + len(problem.spread))
    if len(problem.tail_rows):
        below = np.zeros((len(problem.tail_rows), R.shape[1]))
        below[:, :p] = problem.tail_rows
        R = stack_triangles(R, below)
    return nested_least_squares(R, p, root, alpha, problem.within, problem.tail_dof)


def variances(problem, alpha, objective, n_found, plain=None):
    """Variances of the noise and of the signal, by the likelihood.

    Parameters
    ----------
    problem : Problem
    alpha : ndarray of shape (q,)
        Ridge of every output, in units of an observation.
    objective : ndarray of shape (q,)
        Sum of squares with the penalty.
    n_found : float
        Parameters of each output that the data have decided on beside the variances.
    plain : ndarray of shape (q,), optional
        Variance of the noise where there is no ridge.

    Returns
    -------
    noise, signal : ndarray of shape (q,)
    """
    # Without a ridge the residual, and the targets' own variance.
    ridged = alpha > 0
    # A linear part with a ridge has a prior as the radial functions do, and takes nothing away.
    free = problem.n_total - problem.n_tail + len(problem.tail_rows)
    # What was found fits these rows better than others: the mean of an inverse gamma variable.
    fewest = _FEWEST_DEGREES if free > 1 else _OF_TWO
    degrees = max(free - n_found - 2, fewest) if n_found else max(free, 1)
    noise = objective / degrees if plain is None else np.where(ridged, objective / degrees, plain)
    known = free > 0  # one observation says nothing of its error
    noise = noise if known else np.full(len(noise), np.inf)
    signal = np.where(ridged & known, noise / np.where(ridged, alpha, 1.0), problem.spread**2)
    return noise, signal


def posterior_of(problem, path, centers, alpha, functions, n_found=0.0):
    """The network of the first centres of a path.

    Parameters
    ----------
    problem : Problem
    path : NestedFits
    centers : ndarray of shape (k,)
        Rows of the problem: the first k of those of the path.
    alpha : ndarray of shape (q,)
        Ridge of every output, in units of an observation.
    functions : RadialFunctions
    n_found : float, default=0.0
        Parameters of each output that the data have decided on beside the variances.

    Returns
    -------
    NetworkPosterior
    """
    p, k = problem.n_tail, len(centers)
    solution = path.coefficients(k)
    plain = path.rss[k] / np.maximum(problem.n_total - path.dof[k], 1)
    noise, signal = variances(problem, alpha, path.objective[k], n_found, plain)
    rows, tail_map = path.rows[: p + k, : p + k], problem.tail_map
    if problem.codes is not None:
        constant = _constant_column(problem, centers, functions, p)
        solution = np.vstack([-constant[1:] @ solution / constant[0], solution])
        rows = np.vstack([constant, np.pad(rows, ((0, 0), (1, 0)))])
        tail_map = np.vstack([np.eye(1, tail_map.shape[1]), tail_map])
        p += 1
    # One triangle, packed, from which those of all outputs follow.
    size = len(rows)
    return NetworkPosterior(
        functions.kernel,
        problem.X[centers],
        functions.length_scale,
        np.ascontiguousarray(solution[p:]),
        tail_map.T @ solution[:p],
        alpha,
        float(problem.unit),
        noise,
        signal,
        tail_map,
        rows[np.triu_indices(size, m=p + k)],
    )


def _constant_column(problem, centers, functions, n_linear):
    """Row of the triangle that takes the mean over the training rows out of all columns.

    Where groups have offsets, the level of the function is not known. Its mean over the rows is set
    to 0, and standard deviations are those of the difference from this mean.
    """
    kernel, shift, length_scale = functions
    Z, weights = (problem.X[centers] - shift) / length_scale, problem.root[:, 0] ** 2
    total = np.zeros(1 + n_linear + len(centers))
    total[0] = weights.sum()
    for part in chunks(len(weights), _CHUNK // max(len(centers), 1)):
        rows = (problem.X[part] - shift) / length_scale
        total[1 + n_linear :] += weights[part] @ kernel_matrix(rows, Z, kernel)
    return total / np.sqrt(total[0])
