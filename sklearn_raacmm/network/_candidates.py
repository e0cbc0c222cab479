"""Candidate centres as coordinates in which the selection's inner product is the Euclidean one.

A smooth kernel has a factor of low rank, and a step of the selection costs the number of candidates
times the rank. Of a rough kernel the factor is cut.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import blas, lapack, qr, solve_triangular

from sklearn_raacmm.network._kernels import kernel_matrix, pivoted_cholesky
from sklearn_raacmm.network._least_squares import stack_triangles, triangle_of_all

# A candidate that has shrunk to this part of its length is a combination of the chosen ones to
# working precision, and weights would be lost in rounding; where a ridge holds them, to this part.
DEPENDENT = 1e-10
DEPENDENT_RIDGED = 1e-13
# A factor that leaves more than this of the diagonal does not ask for the last digits.
COARSE = 1e-5


class Features:
    """Columns that span the candidates' ones, on any rows: a function of a block.

    The functions are centred at Z (m, d), in units of the widths, and multiplied by the inverse of
    the lower triangular root (m, m). Where all rows are candidates these columns are known, as
    `rows` (n, m). The result is to be read only: where no row has a weight, it is these themselves.
    """

    def __init__(self, Z, shift, length_scale, kernel, root=None, rows=None):
        self.Z, self.shift, self.length_scale, self.kernel = Z, shift, length_scale, kernel
        self.root, self.rows = root, rows

    def __call__(self, block):
        if self.rows is not None:
            known = self.rows[block.part]
            plain = block.codes is None and np.all(block.root == 1)
            return known if plain else block.weigh(known.copy(order="K"))
        K = kernel_matrix(self.Z, (block.X - self.shift) / self.length_scale, self.kernel).T
        if self.root is not None and len(K):
            K = blas.dtrsm(1.0, self.root, K, side=1, lower=1, trans_a=1, overwrite_b=1)
        return block.weigh(K)


def _products(block, features, view):
    """Inner products of features with themselves, the targets and the tail, over some rows."""
    basis, targets = view.of(block)
    F = features(block)
    return F.T @ F, F.T @ targets, basis.T @ F


def _add(one, other):
    return tuple(a + b for a, b in zip(one, other, strict=True))


def _beside(block, features, view):
    """The tail, the features and the targets on some rows, side by side."""
    basis, targets = view.of(block)
    return np.hstack([basis, features(block), targets])


def _projected_triangle(problem, features, view, rank):
    """R of the features with the tail projected out, and the targets in Q's coordinates."""
    p = len(view.projection)
    columns = partial(_beside, features=features, view=view)
    R = triangle_of_all(problem, columns, p + rank + len(view.outputs))
    if p and len(problem.basis_rows):
        # The ridge of the tail: further rows of it, where the features are 0, and the targets, too.
        below = np.zeros((len(problem.basis_rows), R.shape[1]))
        below[:, :p] = problem.basis_rows
        below[:, p + rank :] = -problem.basis_rows @ view.projection / view.scale
        R = stack_triangles(R, below)
    padded = np.zeros((R.shape[1], R.shape[1]))
    padded[: len(R)] = R
    inner = slice(p, p + rank)
    return padded[inner, inner], padded[inner, p + rank :]


class RadialFunctions(NamedTuple):
    """Kernel and widths that were chosen, and the middle of the rows."""

    kernel: str
    shift: np.ndarray  # (d,)
    length_scale: np.ndarray  # (d,)


class Candidates(NamedTuple):
    """Candidates as `forward_selection` takes them, and what this leaves out."""

    coordinates: np.ndarray  # (n_candidates, rank)
    target: np.ndarray  # (rank, n_outputs) of the targets' projection onto the candidates' span
    resolution: float  # part of a candidate's length below which coordinates are not to be trusted
    degrees_of_freedom: float  # trace of the smoother that uses all candidates
    unseen: float  # mean part of the prior variance outside the factor, if its rank was limited


def candidates_of(problem, view, rows, functions, alpha, max_rank, n_select=None):
    """Coordinates of candidates, the sorted indices `rows` among the problem's.

    The factor of a rough kernel is cut at `max_rank`. `n_select` is the number of steps, if known.
    """
    kernel, shift, length_scale = functions
    Z = (problem.X[rows] - shift) / length_scale
    tol = 1e-6 if alpha == 0 else min(1e-3 * alpha, 1e-6)
    resolve = n_select if alpha == 0 else None
    factor = pivoted_cholesky(Z, kernel, tol=tol, resolve=resolve, max_rank=max_rank)
    unseen = 0.0
    if not factor.complete:
        unseen = 1 - np.einsum("ij,ij->", factor.rows, factor.rows) / len(rows)
    root = np.asfortranarray(factor.rows[factor.pivots])
    known = factor.rows if len(rows) == problem.n_rows else None
    features = Features(Z[factor.pivots], shift, length_scale, kernel, root, known)
    return Candidates(*_whiten(problem, view, factor, features, alpha), unseen)


def _whiten(problem, view, factor, features, alpha):
    """Coordinates, targets, resolution and degrees of freedom; the factor's rows are overwritten.

    `factor` is of the candidates' kernel matrix, `features` are the same factor's on all rows.
    """
    rank = factor.rows.shape[1]
    # A factor that is complete leaves rounding, in which nothing can be told apart. What one of
    # limited rank leaves says nothing of the candidates as far as they are represented.
    resolution = factor.residual if factor.complete else 0.0
    function = partial(_products, features=features, view=view)
    gram, cross, along = problem.reduce(function, _add, rank)
    gram = gram.T  # of which BLAS takes the lower triangle
    if len(along):
        gram = blas.dsyrk(-1.0, along, trans=1, beta=1.0, c=gram, lower=1, overwrite_c=1)
    # The root of a Gram matrix is quick, but tells candidates apart only down to the root of
    # machine epsilon; a ridge, or a coarse factor, does not ask for more.
    trusted = max(resolution, DEPENDENT_RIDGED if alpha else DEPENDENT)
    strong, root, failed = alpha > 1e-8 * gram.diagonal().max(initial=0.0), gram, True
    if strong or factor.residual > COARSE or (alpha == 0 and resolution >= 1e-9):
        trusted = max(resolution, 1e-7)
        gram[np.diag_indices(rank)] += alpha
        root, failed = lapack.dpotrf(gram, lower=1, clean=1, overwrite_a=1)
    if not failed:
        target = solve_triangular(root, cross, lower=True, check_finite=False)
    else:
        triangle, rotated = _projected_triangle(problem, features, view, rank)
        ridge = np.sqrt(alpha) * np.eye(rank if alpha else 0, rank)
        Q, R = qr(np.vstack([triangle, ridge]), mode="economic", check_finite=False)
        root, target = R.T, Q[:rank].T @ rotated
    coordinates = blas.dtrmm(1.0, root, factor.rows, side=1, lower=1, overwrite_b=True)
    inverse = lapack.dtrtri(root, lower=1)[0] if alpha else 0.0
    return coordinates, target, trusted, rank - alpha * float(np.sum(np.square(inverse)))
