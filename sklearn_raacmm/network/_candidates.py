"""Candidate centres as coordinates in which the selection's inner product is the Euclidean one.

A smooth kernel has a factor of low rank, and a step of the selection costs the number of candidates
times the rank. Of a rough kernel the factor is cut.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.linalg import blas, lapack, qr, solve_triangular

from sklearn_raacmm.network._kernels import kernel_matrix, pivoted_cholesky

# A candidate that has shrunk to this part of its length is a combination of the chosen ones to
# working precision, and weights would be lost in rounding; where a ridge holds them, to this part.
DEPENDENT = 1e-10
DEPENDENT_RIDGED = 1e-13
# A factor that leaves more than this of the diagonal does not ask for the last digits.
COARSE = 1e-5


class Features:
    """Columns that span the candidates' ones, on any rows: a function of a block, to be read only.

    The functions are centred at Z (m, d), in units of the widths, and multiplied by the inverse of
    a lower triangular root (m, m). Where all rows are candidates the columns are known: `rows`.
    """

    def __init__(self, Z, shift, length_scale, kernel, root=None, rows=None):
        self.Z, self.shift, self.length_scale, self.kernel = Z, shift, length_scale, kernel
        self.root, self.rows = root, rows

    def __call__(self, block):
        if self.rows is not None and block.part is not None:
            known = self.rows[block.part]
            plain = block.rows.codes is None and np.all(block.root == 1)
            return known if plain else block.weigh(known.copy(order="K"))
        K = kernel_matrix(self.Z, (block.rows.X - self.shift) / self.length_scale, self.kernel).T
        if self.root is not None and len(K):
            K = blas.dtrsm(1.0, self.root, K, side=1, lower=1, trans_a=1, overwrite_b=1)
        return block.weigh(K)


def candidates_of(problem, rows, structure, alpha, max_rank, n_select=None):
    """Coordinates of candidates, the sorted indices `rows` among the problem's, (n, rank).

    A rough kernel's factor is cut at `max_rank`; plain least squares of `n_select` steps on rows in
    memory then works with the columns themselves. Returns besides them the projection of the
    targets (rank, q); the part of a candidate's length that is not to be trusted; the trace of the
    smoother with all candidates; and the mean part of the prior variance outside of a cut factor.
    """
    kernel, length_scale = structure.kernel, structure.length_scale
    shift = problem.rows.X.mean(axis=0)
    Z = (problem.rows.X[rows] - shift) / length_scale
    tol = 1e-6 if alpha == 0 else min(1e-3 * alpha, 1e-6)
    resolve = n_select if alpha == 0 else None
    factor, pivots, residual, complete = pivoted_cholesky(
        Z, kernel, tol=tol, resolve=resolve, max_rank=max_rank
    )
    known, unseen = len(rows) == problem.n_rows, 0.0
    if not complete and alpha == 0 and known and n_select is not None:
        return _columns(problem, Features(Z, shift, length_scale, kernel))
    if not complete:
        unseen = 1 - np.einsum("ij,ij->", factor, factor) / len(rows)
    root = np.asfortranarray(factor[pivots])
    features = Features(Z[pivots], shift, length_scale, kernel, root, factor if known else None)
    # A factor that is complete leaves rounding, in which nothing can be told apart. What one of
    # limited rank leaves says nothing of the candidates as far as they are represented.
    resolution = residual if complete else 0.0
    return *_whiten(problem, factor, features, alpha, residual, resolution), unseen


def _columns(problem, features):
    """The candidates' own columns as coordinates, where all rows of a problem are candidates."""
    n = len(features.Z)
    both = problem.reduce(
        lambda block: (features(block), block.basis, block.about_tail),
        lambda one, other: tuple(map(np.vstack, zip(one, other, strict=True))),
        n,
    )
    columns, basis, target = both
    columns -= basis @ (basis.T @ columns)
    return np.ascontiguousarray(columns.T), target, DEPENDENT, float(n), 0.0


def _whiten(problem, rows, features, alpha, residual, resolution):
    """Coordinates, in place of the factor's `rows`, targets, resolution and degrees of freedom."""
    rank = rows.shape[1]

    def products(block):
        F = features(block)
        return F.T @ F, F.T @ block.about_tail, block.basis.T @ F

    gram, cross, along = problem.reduce(
        products, lambda one, other: [a + b for a, b in zip(one, other, strict=True)], rank
    )
    gram = gram.T  # of which BLAS takes the lower triangle
    if len(along):
        gram = blas.dsyrk(-1.0, along, trans=1, beta=1.0, c=gram, lower=1, overwrite_c=1)
    # The root of a Gram matrix is quick, but tells candidates apart only down to the root of
    # machine epsilon; a ridge, or a coarse factor, does not ask for more.
    trusted = max(resolution, DEPENDENT_RIDGED if alpha else DEPENDENT)
    strong, root, failed = alpha > 1e-8 * gram.diagonal().max(initial=0.0), gram, True
    if strong or residual > COARSE or (alpha == 0 and resolution >= 1e-9):
        trusted = max(resolution, 1e-7)
        gram[np.diag_indices(rank)] += alpha
        root, failed = lapack.dpotrf(gram, lower=1, clean=1, overwrite_a=1)
    if not failed:
        target = solve_triangular(root, cross, lower=True, check_finite=False)
    else:
        # Of the features with the tail projected out, and the targets in Q's coordinates.
        p, q = problem.n_tail, cross.shape[1]
        R = problem.triangle(
            lambda block: np.hstack([block.basis, features(block), block.about_tail]), p + rank + q
        )
        R = np.pad(R, ((0, p + rank + q - len(R)), (0, 0)))[p : p + rank, p:]
        ridge = np.sqrt(alpha) * np.eye(rank if alpha else 0, rank)
        Q, triangle = qr(np.vstack([R[:, :rank], ridge]), mode="economic", check_finite=False)
        root, target = triangle.T, Q[:rank].T @ R[:, rank:]
    coordinates = blas.dtrmm(1.0, root, rows, side=1, lower=1, overwrite_b=True)
    inverse = lapack.dtrtri(root, lower=1)[0] if alpha else 0.0
    return coordinates, target, trusted, rank - alpha * float(np.sum(np.square(inverse)))
