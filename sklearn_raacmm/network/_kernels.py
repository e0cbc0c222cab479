"""Radial functions of scaled squared distances, kernel matrices and a low-rank factor of them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import blas, lapack

# A name of `KERNELS`, or a function that a user gives: see `radial`.
Kernel = str | Callable[..., Any]
# Pivot of a kernel matrix, whose diagonal is 1, that is far above the rounding of its eigenvalues.
_SOUND_PIVOT = 1e-6
# Numbers of a factor for which memory is taken from the start, 256 MB. To grow costs time.
_RESERVED = 2**25
# Squared distance from which a gaussian is nothing, and exp(-r): below 1e-307 an exponential takes
# a hundred times as long.
_FARTHEST, _FARTHEST_ROUGH = 1414.0, 5e5
# Squared distance up to which rows are the same to a function that is not smooth there.
_NEAR = 1e-12


def gaussian(s, slope=False):
    """``exp(-s / 2)``."""
    s = np.minimum(s, _FARTHEST, out=s)
    s *= -0.5
    K = np.exp(s, out=s)
    return (K, -0.5 * K) if slope else K


def matern52(s, slope=False):
    """``(1 + r + r^2 / 3) exp(-r)``, with ``r^2 = 5 s``."""
    s = np.clip(s, 0.0, _FARTHEST_ROUGH, out=s)  # rounding may make that of near rows negative
    r, decay = _decay(s, 5)
    r += 1
    s *= 5 / 3
    s += r
    s *= decay
    if not slope:
        return s
    r *= decay
    r *= -5 / 6
    return s, r


def matern32(s, slope=False):
    """``(1 + r) exp(-r)``, with ``r^2 = 3 s``."""
    r, decay = _decay(np.clip(s, 0.0, _FARTHEST_ROUGH, out=s), 3)
    r += 1
    r *= decay
    decay *= -3 / 2
    return (r, decay) if slope else r


def matern12(s, slope=False):
    """``exp(-r)``, with ``r^2 = s``."""
    s *= s >= _NEAR  # the distance of a row from itself is rounding, and its root would be seen
    r, decay = _decay(np.minimum(s, _FARTHEST_ROUGH, out=s), 1)
    if not slope:
        return decay
    # The slope has no limit at distance 0; where it is used, times a difference of rows, it has: of
    # opposite directions opposite ones, of which 0 is the mean.
    r[r == 0] = np.inf
    return decay, np.divide(-0.5 * decay, r, out=r)


def _decay(s, times):
    """The root r of a multiple of s, and exp(-r)."""
    r = np.sqrt(s)
    r *= np.sqrt(times)
    decay = np.negative(r)
    return r, np.exp(decay, out=decay)


# Functions of the squared scaled distance s, 1 at s = 0, with their slopes by s where asked for:
# all else follows from them, C and ONNX too. They may overwrite s: to fetch memory for a new matrix
# takes longer than to fill it. From smooth to rough: `kernel="auto"` tries them in this order.
KERNELS: dict[str, Callable[..., Any]] = {
    function.__name__: function for function in (gaussian, matern52, matern32, matern12)
}


def radial(kernel: Kernel, s: Any, slope: bool = False) -> Any:
    """Values of a kernel of `KERNELS`, by its name, or of a function that a user gives.

    A function of your own, which `RBFNetRegressor` takes as its `kernel`, is called as
    ``kernel(s)`` and ``kernel(s, True)``. Of an array s of squared scaled distances, which it may
    overwrite, it returns an array of the same shape, 1 where s is 0; with True also the derivative
    by s. It has to be positive definite: `fit` tries 60 rows, and the slope. In a list of kernels
    the smooth ones come first. Pickle, joblib and skops, which has to be told to trust it, keep a
    function's module and name alone; a lambda cannot be saved. Arithmetic, powers of whole numbers
    and halves, and NumPy's maximum, minimum, clip, sqrt, exp, sin and cos can be written as C and
    ONNX.

    >>> from sklearn_raacmm import RBFNetRegressor
    >>> def quadratic(s, slope=False):  # the rational quadratic kernel
    ...     K = 1 / (1 + 0.5 * s)
    ...     return (K, -0.5 * K * K) if slope else K
    >>> model = RBFNetRegressor(kernel=["gaussian", quadratic, "matern52"])
    """
    if isinstance(kernel, str):
        return KERNELS[kernel](s, slope)
    return kernel(np.maximum(s, 0.0, out=s), slope)


def squared_distances(A, B):
    """Squared distances (n, m) of rows as one product, ``[-2a, |a|^2, 1] . [b, 1, |b|^2]``."""
    left = np.empty((len(A), A.shape[1] + 2))
    np.multiply(A, -2.0, out=left[:, :-2])
    left[:, -2] = np.einsum("ij,ij->i", A, A)
    left[:, -1] = 1.0
    right = np.empty((len(B), B.shape[1] + 2))
    right[:, :-2] = B
    right[:, -2] = 1.0
    right[:, -1] = np.einsum("ij,ij->i", B, B)
    return left @ right.T


def kernel_matrix(A: np.ndarray, B: np.ndarray, kernel: Kernel) -> np.ndarray:
    """Kernel values (n, m) between scaled rows A (n, d) and B (m, d)."""
    return radial(kernel, squared_distances(A, B))


def rounding(Z):
    """Error of a factor's entries: distances err by epsilon times the largest squared norm."""
    largest = np.einsum("ij,ij->i", Z, Z).max(initial=0.0)
    return max(1e-13, 4 * np.finfo(float).eps * largest)


def pivoted_cholesky(Z, kernel, *, tol=1e-6, max_rank=None, resolve=None, block_size=96):
    """Low-rank factor of a positive definite kernel matrix by blocked, diagonally pivoted Cholesky.

    Each round takes those of the `block_size` rows that are explained least which the others do not
    explain (Harbrecht, Peters, Schneider, Applied Numerical Mathematics 62, 2012), until none is
    left above `tol`, or `rounding`; with `resolve` a small part of what so many pivots leave.

    Returns rows (n, rank) with ``kernel_matrix(Z, Z) ~ rows @ rows.T``, exact on the pivot rows;
    the pivots (rank,); the largest diagonal entry of what is left; and whether that is little.
    """
    n = len(Z)
    max_rank = min(n, max_rank or n)
    diagonal = np.ones(n)
    # The factor is kept transposed, one pivot a row, so that new pivots are appended without moving
    # the old ones.
    # Memory that is not written to yet is not taken yet.
    factor = np.empty((min(max_rank, max(4 * block_size, _RESERVED // n)), n))
    pivots = np.empty(max_rank, dtype=np.intp)
    rank = 0
    least = rounding(Z)
    aim = tol = max(tol, least)
    if resolve is not None:
        tol = least  # until it is known
    while rank < max_rank:
        if resolve is not None and rank >= resolve:
            tol, resolve = min(aim, max(1e-5 * diagonal.max(), least)), None
        top = np.argsort(-diagonal, kind="stable")[:block_size]
        top = top[diagonal[top] > tol]
        if not len(top):
            break
        part = np.take(factor[:rank], top, axis=1)
        inside = kernel_matrix(Z[top], Z[top], kernel)
        inside -= part.T @ part
        # As far as the factor knows it: by rounding the difference may be negative.
        inside[np.diag_indices(len(top))] = diagonal[top]
        most = min(max_rank - rank, max(1, rank))
        root, chosen, size, _ = lapack.dpstrf(inside, tol=max(tol, 0.2 * diagonal[top[0]]), lower=1)
        size = min(size, most)
        chosen, root = chosen[:size] - 1, np.tril(root[:size, :size])
        top = top[chosen]
        need = rank + len(top)
        if need > len(factor):
            # In place where the system can move pages: no copy, and not two factors at once.
            factor.resize((min(max_rank, max(need, len(factor) * 5 // 4)), n), refcheck=False)
        new = factor[rank:need]
        new[:] = kernel_matrix(Z[top], Z, kernel)
        # Transposed, for BLAS to work in place. The pivots of a round are alike in size, so that
        # the inverse of their root loses no digits; a product with it is faster than to solve.
        if rank:
            part = np.asfortranarray(part[:, chosen])
            blas.dgemm(-1.0, factor[:rank].T, part, beta=1.0, c=new.T, overwrite_c=True)
        inverse = lapack.dtrtri(root, lower=1)[0]
        blas.dtrmm(1.0, inverse, new.T, side=1, lower=1, trans_a=1, overwrite_b=True)
        pivots[rank:need] = top
        diagonal -= np.einsum("ij,ij->j", new, new)
        diagonal[pivots[:need]] = 0.0
        rank = need
    residual = float(max(diagonal.max(), 0.0))
    return factor[:rank].T, pivots[:rank].copy(), residual, residual <= tol


def psd_root(K):
    """A matrix U with ``U.T @ U = K`` for positive semidefinite K, singular or not.

    What is below rounding is raised to it: where a penalty is zero coefficients grow without limit.
    """
    root, failed = lapack.dpotrf(K, lower=0, clean=1)
    if not failed and np.square(root.diagonal()).min(initial=np.inf) > _SOUND_PIVOT:
        return root
    values, vectors = np.linalg.eigh(K)
    return np.sqrt(np.maximum(values, _rounding_of(values)))[:, None] * vectors.T


def psd_inverse_root(K):
    """A matrix W with ``W.T @ W`` the pseudo-inverse of positive semidefinite K."""
    values, vectors = np.linalg.eigh(K)
    kept = values > _rounding_of(values)
    return vectors[:, kept].T / np.sqrt(values[kept])[:, None]


def _rounding_of(values):
    """Error of the eigenvalues of a matrix."""
    return len(values) * np.finfo(float).eps * values.max(initial=0.0)
