"""The fitted network as a value: its radial functions, weights and their posterior."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from scipy.linalg import cholesky, lapack

from sklearn_raacmm.network._kernels import (
    Kernel,
    kernel_matrix,
    psd_inverse_root,
    psd_root,
    radial,
    squared_distances,
)
from sklearn_raacmm.network._linear import (
    penalise,
    polynomial_at,
    ridge_rows,
    triangular_factor,
    without_constants,
)
from sklearn_raacmm.network._ranks import rank_slopes, to_ranks
from sklearn_raacmm.utils import check_shapes, chunks, one_blas_thread

# Kernel values held at a time while predicting: they stay in a core's cache. For the standard
# deviation of thousands of centres a hundred points at once are 1.7 times as fast as 26.
_CHUNK, _CHUNK_OF_STD = 2**18, 2**20
_SHAPES: dict[str, tuple[str | int, ...]] = {
    **dict.fromkeys(("outputs", "alpha", "noise_variance", "signal_variance"), ("q",)),
    "centers": ("k", "d"),
    "length_scale": ("d",),
    "coef": ("k", "q"),
    "polynomial": ("d1", "q"),
    "tail_map": ("p", "d1"),
}
# Of what may be None.
_MORE_SHAPES: dict[str, tuple[str | int, ...]] = {
    "triangle": ("packed",),
    "codes": ("k",),
    "ranks": ("m", 3),
    "outlier_variance": ("q",),
}


@dataclass(frozen=True, eq=False)
class Network:
    r"""Radial functions of k centres that q outputs share, and the posterior of their weights.

    `RBFNetRegressor` holds one for each output, exporters read it, and files keep it. It does not
    change; ``dataclasses.replace`` makes another one. With the functions k(x), the polynomial's
    columns :math:`t(x) = \mathrm{tail\_map}\,(1, x)` and the matrices A and B of `roots` an
    output's mean and variance at x are

    .. math:: m = \mathrm{polynomial}^\top (1, x) + \mathrm{coef}^\top k(x), \qquad
       v = \mathrm{signal} \max(0, 1 - |A k|^2) + \mathrm{noise}\,(1 + |B (t, k)|^2).
    """

    outputs: np.ndarray  # (q,) which of the targets' columns
    kernel: Kernel
    length_scale: np.ndarray  # (d,) in the units of X; infinite for a feature that is ignored
    centers: np.ndarray  # (k, d) in the units of X
    coef: np.ndarray  # (k, q) posterior mean of the weights
    polynomial: np.ndarray  # (1 + d, q) constant and linear term
    alpha: np.ndarray  # (q,) ridge, in units of an observation
    weight_unit: float  # weight of an observation
    noise_variance: np.ndarray  # (q,) in squared units of y
    signal_variance: np.ndarray  # (q,)
    # From the coefficients of the polynomial's p columns in the fit to those of (1, x), (p, 1 + d).
    tail_map: np.ndarray
    ratio: float = 0.0  # variance of groups' constants over that of the noise
    # Triangular factor of the columns at the training rows, polynomial first, packed by rows;
    # trapezoidal where there were fewer rows than columns. None where all rows are centres: their
    # own factor follows from what is below.
    triangle: np.ndarray | None = None
    weights: Any = None  # (k,) of the centres as training rows, where there is no triangle
    codes: np.ndarray | None = None  # (k,) group of each of these, where groups have constants
    tail_ridge: float = 0.0  # of the polynomial's linear part, in units of an observation
    # Knots (m, 3), a feature's number, value and rank, where radial functions see ranks; else None.
    ranks: np.ndarray | None = None
    # What rows without weight add to the variance of a new observation, (q,) in squared units of y.
    outlier_variance: np.ndarray | None = None

    def __getstate__(self) -> dict[str, object]:
        # Without what `_roots` keeps from one call to the next.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        present = {n: shape for n, shape in _MORE_SHAPES.items() if state.get(n) is not None}
        shapes = _SHAPES | present | ({"weights": ("k",)} if self.all_rows else {})
        sizes = {"d1": 1 + np.size(state.get("length_scale", ()))}
        check_shapes("Network", state, shapes, sizes, ("length_scale", "noise_variance"))
        known = np.arange(sizes["d1"] - 1.0) if self.ranks is None else np.unique(self.ranks[:, 0])
        if not np.array_equal(known, np.arange(sizes["d1"] - 1.0)):
            raise ValueError("The file is damaged: ranks of Network are not those of its features.")

    @property
    def inputs(self) -> str:
        """What the radial functions see, "raw" or "ranks"."""
        return "raw" if self.ranks is None else "ranks"

    @property
    def all_rows(self) -> bool:
        """Whether every training row is a centre."""
        return self.triangle is None

    @cached_property
    def _scaled_centers(self):
        """Middle of the centres, and the centres about it in units of the widths, as seen."""
        centers = self.seen(self.centers)
        shift = centers.mean(axis=0) if len(centers) else 0.0
        return shift, (centers - shift) / self.length_scale

    def with_share(self, share: np.ndarray, left: np.ndarray) -> Self:
        """The same with a share (q,) of its function, where it leaves a mean square (q,)."""
        polynomial = np.vstack([self.polynomial[:1], share * self.polynomial[1:]])
        noise = np.maximum(left / self.noise_variance, 1.0)
        less = replace(self, coef=share * self.coef, polynomial=polynomial)
        return less.with_noise(np.where(share < 1, noise, 1.0))

    def with_noise(self, factor: float | np.ndarray) -> Self:
        """The same with a larger variance of the noise, for one that was estimated too small."""
        signal = self.signal_variance * (factor if self.all_rows else 1.0)
        return replace(self, noise_variance=factor * self.noise_variance, signal_variance=signal)

    def seen(self, X: np.ndarray) -> np.ndarray:
        """Rows (n, d) as the radial functions see them, not yet in units of the widths."""
        return to_ranks(self.ranks, X)

    def scaled(self, X: np.ndarray) -> np.ndarray:
        """The same about the middle of the centres, in units of the widths."""
        return (self.seen(X) - self._scaled_centers[0]) / self.length_scale

    def radial(self, X: np.ndarray) -> np.ndarray:
        """Values of the radial functions, (n, k)."""
        return kernel_matrix(self.scaled(X), self._scaled_centers[1], self.kernel)

    def tail(self, X: np.ndarray) -> np.ndarray:
        """Columns of the polynomial in the fit, (n, p)."""
        return polynomial_at(self.tail_map, X)

    def weigh(self, columns: np.ndarray) -> np.ndarray:
        """Columns at all training rows, which are the centres, as the fit sees them."""
        root = np.sqrt(self.weights)[:, None]
        return root * without_constants(columns, self.codes, self.weights, self.ratio)

    @cached_property
    def prior_root(self) -> np.ndarray:
        """W such that ``|W k(x)|^2`` is the part of the prior variance in the centres' span."""
        centers = self._scaled_centers[1]
        return psd_inverse_root(kernel_matrix(centers, centers, self.kernel))

    def design_triangle(self) -> np.ndarray:
        """Triangular factor of the columns at the training rows, polynomial first."""
        p = len(self.tail_map)
        n = p + len(self.centers)
        if self.triangle is None:
            rows = self.weigh(np.hstack([self.tail(self.centers), self.radial(self.centers)]))
            below = np.pad(ridge_rows(p, self.tail_ridge), ((0, 0), (0, len(self.centers))))
            return triangular_factor(np.vstack([rows, below]))
        size = next(m for m in range(n + 1) if m * n - m * (m - 1) // 2 == len(self.triangle))
        rows = np.zeros((size, n))
        rows[np.triu_indices(size, m=n)] = self.triangle
        return rows

    @cached_property
    @one_blas_thread
    def _roots(self):
        """A and B of every ridge."""
        find = self._roots_of_process if self.all_rows else self._roots_of_centers
        return {alpha: find(alpha) for alpha in np.unique(self.alpha)}

    def _roots_of_centers(self, alpha):
        centers, p = self._scaled_centers[1], len(self.tail_map)
        root = psd_root(kernel_matrix(centers, centers, self.kernel))
        R = penalise(self.design_triangle(), p, root, alpha)[1]
        return self.prior_root, lapack.dtrtri(R)[0].T if R.size else R.T

    def _roots_of_process(self, alpha):
        root, p = np.sqrt(self.weights)[:, None], len(self.tail_map)
        factor = covariance_factor(
            self._scaled_centers[1], self.kernel, self.weights, alpha, self.codes, self.ratio
        )
        factor[:] = lapack.dtrtri(factor, lower=1, overwrite_c=1)[0]
        # The matrix that whitens rows times their root is symmetric.
        A = factor * root.T if self.codes is None else (root * self.weigh(factor.T / root)).T
        along = A @ self.tail(self.centers)
        rows = [np.sqrt(alpha) * along, ridge_rows(p, self.tail_ridge)]
        inverse = np.linalg.inv(triangular_factor(np.vstack(rows))).T
        return A, inverse @ np.hstack([np.eye(p), -along.T @ A])

    def roots(self, output: int) -> tuple[np.ndarray, np.ndarray]:
        """Matrices A (r, k) and B (s, p + k) of an output's variance, see above."""
        return self._roots[self.alpha[output]]

    def _seen(self, X, K):
        """Outputs of one ridge, and A k and B (t, k) at some rows."""
        columns = np.hstack([self.tail(X), K])
        for alpha, (A, B) in self._roots.items():
            yield np.flatnonzero(self.alpha == alpha), K @ A.T, columns @ B.T

    def predict(self, X: np.ndarray) -> np.ndarray:
        """Mean (n, q) at rows (n, d)."""
        return predict_mean(pack([self]), X)

    def of_outliers(self, with_noise: bool = True, with_outliers: bool = True) -> np.ndarray:
        """What outliers add to the variance of an observation, (q,); 0 where they do not count."""
        if self.outlier_variance is None or not (with_noise and with_outliers):
            return np.zeros(len(self.alpha))
        return self.outlier_variance

    def std(self, X: np.ndarray, with_noise: bool = True, with_outliers: bool = True) -> np.ndarray:
        """Standard deviation (n, q) at rows (n, d), with noise or not, and with its outliers."""
        variance = np.empty((len(X), len(self.alpha)))
        size = _CHUNK_OF_STD if self.all_rows else _CHUNK
        for part in chunks(len(X), size // max(len(self.centers), 1)):
            for of, inside, solved in self._seen(X[part], self.radial(X[part])):
                outside = np.maximum(1 - np.square(inside).sum(axis=1), 0.0)
                of_weights = np.square(solved).sum(axis=1) + float(with_noise)
                variance[part, of] = np.outer(outside, self.signal_variance[of])
                variance[part, of] += np.outer(of_weights, self.noise_variance[of])
        return np.sqrt(variance + self.of_outliers(with_noise, with_outliers))

    def covariance(
        self, X: np.ndarray, with_noise: bool = True, with_outliers: bool = True
    ) -> np.ndarray:
        """Covariance (n, n, q) of predictions at some rows, with noise on its diagonal or not."""
        n, Z = len(X), self.scaled(X)
        found = np.empty((n, n, len(self.alpha)))
        prior, diagonal = kernel_matrix(Z, Z, self.kernel), np.diag_indices(n)
        for of, inside, solved in self._seen(X, self.radial(X)):
            outside = prior - inside @ inside.T
            outside[diagonal] = np.maximum(1 - np.square(inside).sum(axis=1), 0.0)
            of_weights = solved @ solved.T
            of_weights[diagonal] += float(with_noise)
            found[:, :, of] = np.multiply.outer(outside, self.signal_variance[of])
            found[:, :, of] += np.multiply.outer(of_weights, self.noise_variance[of])
        found[diagonal] += self.of_outliers(with_noise, with_outliers)
        return found

    def sample(
        self, X: np.ndarray, n_samples: int, rng: np.random.RandomState, with_noise: bool = True
    ) -> np.ndarray:
        """Draws from the posterior at some rows, (n, q, n_samples)."""
        if not np.all(np.isfinite(self.noise_variance)):
            raise ValueError("The noise variance is infinite: there is nothing to draw from.")
        covariance = self.covariance(X, with_noise=False)
        mean = self.predict(X)
        draws = np.empty((*mean.shape, n_samples))
        for i in range(mean.shape[1]):
            values, vectors = np.linalg.eigh(covariance[:, :, i])
            half = vectors * np.sqrt(np.maximum(values, 0.0))
            draws[:, i] = mean[:, i, None] + half @ rng.standard_normal((len(X), n_samples))
            if with_noise:
                noise = np.sqrt(self.noise_variance[i] + self.of_outliers()[i])
                draws[:, i] += noise * rng.standard_normal((len(X), n_samples))
        return draws

    def gradient(self, X: np.ndarray) -> np.ndarray:
        """Derivatives (n, q, d) of the mean by the features."""
        n, (q, k) = len(X), self.coef.T.shape
        found = np.empty((n, q, len(self.length_scale)))
        for part in chunks(n, _CHUNK // max(k, 1)):
            Z = self.scaled(X[part])
            s = squared_distances(Z, self._scaled_centers[1])
            slope = radial(self.kernel, s, slope=True)[1]
            for i in range(q):
                G = slope * self.coef[:, i]
                # The sum over centres j of G_ij d s_ij / d x_i, s the squared distance.
                along = Z * G.sum(axis=1, keepdims=True) - G @ self._scaled_centers[1]
                slopes = 2 * along / self.length_scale
                if self.ranks is not None:
                    slopes *= rank_slopes(self.ranks, X[part])
                found[part, i] = self.polynomial[1:, i] + slopes
        return found


def pack(networks):
    """What the means of some networks need, as few arrays.

    The knots of ranks, if some networks see these, which then stand beside the features; the middle
    of all centres; a matrix (k, 2 d + 1) whose product with (x^2, x, 1) are a row's squared scaled
    distances; the run of each kernel; weights (q, k); polynomial (1 + d, q).
    """
    networks = sorted(networks, key=lambda network: str(network.kernel))
    outputs = np.sort(np.concatenate([network.outputs for network in networks]))
    centers = np.concatenate([network.centers for network in networks])
    knots = next((network.ranks for network in networks if network.ranks is not None), None)
    widths = np.array([network.length_scale for network in networks])
    n_features = 1 + centers.shape[1]
    if knots is not None:
        # Each network sees one of the two, and the other with infinite widths.
        centers = np.hstack([centers, to_ranks(knots, centers)])
        own = np.array([network.ranks is not None for network in networks])[:, None]
        widths = np.hstack([np.where(own, np.inf, widths), np.where(own, widths, np.inf)])
    shift = centers.mean(axis=0) if len(centers) else np.zeros(centers.shape[1])
    sizes = [len(network.centers) for network in networks]
    inverse = np.repeat(1 / widths, sizes, axis=0)
    Z = (centers - shift) * inverse
    by_row = np.hstack([inverse**2, -2 * Z * inverse, np.square(Z).sum(axis=1, keepdims=True)])
    coef = np.zeros((len(outputs), len(centers)))
    polynomial = np.empty((n_features, len(outputs)))
    kernels: dict[Kernel, slice] = {}
    end = 0
    for network, size in zip(networks, sizes, strict=True):
        own, start, end = np.searchsorted(outputs, network.outputs), end, end + size
        coef[own, start:end], polynomial[:, own] = network.coef.T, network.polynomial
        kernels[network.kernel] = slice(kernels.get(network.kernel, slice(start, 0)).start, end)
    return knots, shift, by_row, tuple(kernels.items()), coef, polynomial


def predict_mean(packed, X):
    """Means (n, q) of packed networks at rows (n, d)."""
    knots, shift, by_row, kernels, coef, polynomial = packed
    mean = np.empty((len(X), len(coef)))
    mean[:] = polynomial[0]
    if np.any(polynomial[1:]):
        mean += X @ polynomial[1:]
    X = X if knots is None else np.hstack([X, to_ranks(knots, X)])
    d, k = X.shape[1], coef.shape[1]
    size = _CHUNK // max(k, 1)
    columns, buffer = np.ones((2 * d + 1, 0)), np.empty((k, 0))
    for part in chunks(len(X), size) if k else ():
        rows = X[part]
        if columns.shape[1] != len(rows):
            columns, buffer = np.ones((2 * d + 1, len(rows))), np.empty((k, len(rows)))
        np.subtract(rows.T, shift[:, None], out=columns[d:-1])
        np.square(columns[d:-1], out=columns[:d])
        s = np.matmul(by_row, columns, out=buffer)
        for kernel, own in kernels:
            values = radial(kernel, s[own])
            if values.base is not buffer:
                s[own] = values
        mean[part] += (coef @ s).T
    return mean


def covariance_factor(Z, kernel, weights, alpha, codes=None, ratio=0.0):
    """Lower Cholesky factor of a weighted kernel matrix with a ridge, in memory of one matrix."""
    n, root = len(Z), np.sqrt(weights)
    C = np.zeros((n, n), order="F")  # what is above may be anything but a cause of overflow
    for part in chunks(n, _CHUNK_OF_STD // max(n, 1)):
        below = slice(part.start if codes is None else 0, n)
        C[below, part] = kernel_matrix(Z[part], Z[below], kernel).T
    if codes is not None:
        C = without_constants(without_constants(C, codes, weights, ratio).T, codes, weights, ratio)
        C = np.asfortranarray(C)
    if np.any(root != 1.0):
        C *= root[:, None]
        C *= root
    C[np.diag_indices(n)] += alpha
    return cholesky(C, lower=True, overwrite_a=True, check_finite=False)
