"""Two representations of the candidates that `_selection` chooses from.

`WhitenedCandidates` holds coordinates in which the inner product of the selection is the Euclidean
one: few where the kernel is smooth. `SymmetricCandidates` holds the kernel matrix itself.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import blas, lapack, qr, solve_triangular

from sklearn_raacmm.network._kernels import kernel_matrix, pivoted_cholesky
from sklearn_raacmm.network._least_squares import divide, stack_triangles, triangle_of_all

# A candidate that has shrunk to this part of its length is a combination of the chosen ones to
# working precision, and weights would be lost in rounding; where a ridge holds them, to this part.
DEPENDENT = 1e-10
DEPENDENT_RIDGED = 1e-13
# Rank at which the factor of a rough kernel is cut where nothing else limits it: 240 MB for 10 000
# rows, and a step costs as much memory traffic.
MAX_RANK = 3000
# Samples whose whole kernel matrix is held: 800 MB.
MAX_SYMMETRIC = 10_000
# Where a sample of the rows are candidates and the number of centres is given: the factor's rank,
# in centres and at the least. With 2.5 the residual was up to 4 % larger than with an exact factor,
# with 3.5 up to 2 % (three draws of candidates).
RANK_PER_CENTER, MIN_RANK = 3.5, 256
# A factor that leaves more than this of the diagonal does not ask for the last digits.
COARSE = 1e-5


class WhitenedCandidates:
    """Candidates as rows of coordinates whose Euclidean inner product is the selection's.

    Parameters
    ----------
    coordinates : ndarray of shape (n_candidates, rank)
    target : ndarray of shape (rank, n_outputs)
        Coordinates of the projection of the targets onto the candidates' span.
    resolution : float
        Part of a candidate's length below which its coordinates are not to be trusted.
    """

    def __init__(self, coordinates, target, resolution=DEPENDENT):
        self.coordinates, self.target, self.resolution = coordinates, target, resolution
        self.rank = coordinates.shape[1]

    def squared_norms(self):
        return np.einsum("ij,ij->i", self.coordinates, self.coordinates)

    def correlations(self):
        return self.coordinates @ self.target

    def column(self, j):
        """A candidate, and its dual, whose products with others are inner products."""
        u = self.coordinates[j].copy()
        return u, u

    def inner(self, v):
        """Inner products (n_candidates,) of all candidates with a direction of the dual v."""
        return self.coordinates @ v


class SymmetricCandidates:
    """Every sample is a candidate, and the symmetric kernel matrix itself is worked on.

    Parameters
    ----------
    K : ndarray of shape (n, n), Fortran order
        Kernel matrix of the samples.
    weights : ndarray of shape (n,)
    tail : ndarray of shape (n, n_tail)
        Orthonormal basis of the weighted polynomial (rows times root weight).
    Y : ndarray of shape (n, n_outputs)
        Targets with the polynomial projected out, times root weight.
    alpha : float
    """

    coordinates = None

    def __init__(self, K, weights, tail, Y, alpha):
        self.K, self.tail, self.alpha = K, tail, alpha
        # Running squared lengths are all there is: they are good to the root of machine epsilon.
        self.resolution = 1e-6
        self.root = np.sqrt(weights)
        self.target = self.root[:, None] * Y
        self.rank = len(K)

    def squared_norms(self):
        norms = self.alpha + np.einsum("ij,ij,i->j", self.K, self.K, self.root**2)
        along = self.K @ (self.root[:, None] * self.tail)
        return norms - np.square(along).sum(axis=1)

    def correlations(self):
        return self.K @ self.target

    def column(self, j):
        u = self.K[:, j].copy()
        v = self.root * u
        v -= self.tail @ (v @ self.tail)
        v *= self.root
        v[j] += self.alpha
        return u, v

    def inner(self, v):
        # The product that reads one half of the matrix only.
        return blas.dsymv(1.0, self.K, v, lower=1)


class Features:
    """Columns that span the candidates' ones, on any rows: a function of a block.

    The result is to be read only: where no row has a weight, it is the known columns themselves.

    Parameters
    ----------
    Z : ndarray of shape (m, d)
        Where they are centred, in units of the widths.
    shift, length_scale : ndarray of shape (d,)
        From rows to such units.
    kernel : str
    root : ndarray of shape (m, m), optional
        Lower triangular; the columns are multiplied by its inverse.
    rows : ndarray of shape (n, m), optional
        The result on all rows, where it is known.
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
        if self.root is not None:
            K = divide(K, self.root.T)
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


def whiten(problem, view, factor, features, members, alphas):
    """Coordinates of candidates for `forward_selection`, for every ridge.

    Parameters
    ----------
    problem : Problem
    view : View
    factor : LowRankFactor
        Of the candidates' kernel matrix. Its rows are overwritten.
    features : Features
        The same factor's on all rows.
    members : list of ndarray
        Outputs of each group.
    alphas : list of float
        Ridge of each group.

    Returns
    -------
    groups : list of WhitenedCandidates
    degrees_of_freedom : list of float
        Trace of the smoother that uses all candidates.
    """
    rows, rank = factor.rows, factor.rows.shape[1]
    coarse = factor.residual > COARSE
    # A factor that is complete leaves rounding, in which nothing can be told apart. What one of
    # limited rank leaves says nothing of the candidates as far as they are represented.
    resolution = factor.residual if factor.complete else 0.0
    function = partial(_products, features=features, view=view)
    gram, cross, along = problem.reduce(function, _add, rank)
    gram = gram.T  # of which BLAS takes the lower triangle
    if len(along):
        gram = blas.dsyrk(-1.0, along, trans=1, beta=1.0, c=gram, lower=1, overwrite_c=1)
    exact = None
    groups, degrees = [], []
    for alpha, of in zip(alphas, members, strict=True):
        # The root of a Gram matrix is quick, but tells candidates apart only down to the root of
        # machine epsilon; a ridge, or a coarse factor, does not ask for more.
        last = len(groups) == len(alphas) - 1
        trusted = max(resolution, DEPENDENT_RIDGED if alpha else DEPENDENT)
        root, failed = gram, True
        strong = alpha > 1e-8 * gram.diagonal().max(initial=0.0)
        if strong or coarse or (alpha == 0 and resolution >= 1e-9):
            trusted = max(resolution, 1e-7)
            gram[np.diag_indices(rank)] += alpha
            root, failed = lapack.dpotrf(gram, lower=1, clean=1, overwrite_a=last)
            if not last:
                gram[np.diag_indices(rank)] -= alpha
        if not failed:
            projected = solve_triangular(root, cross[:, of], lower=True, check_finite=False)
        else:
            exact = exact or _projected_triangle(problem, features, view, rank)
            triangle, rotated = exact
            ridge = np.sqrt(alpha) * np.eye(rank if alpha else 0, rank)
            Q, R = qr(np.vstack([triangle, ridge]), mode="economic", check_finite=False)
            root, projected = R.T, Q[:rank].T @ rotated[:, of]
        # The last group's take the rows' place, which nobody needs any more.
        coordinates = blas.dtrmm(1.0, root, rows, side=1, lower=1, overwrite_b=last)
        groups.append(WhitenedCandidates(coordinates, projected, trusted))
        inverse = lapack.dtrtri(root, lower=1)[0] if alpha else 0.0
        degrees.append(rank - alpha * float(np.sum(np.square(inverse))))
    return groups, degrees


class RadialFunctions(NamedTuple):
    """Kernel and widths that were chosen, and the middle of the rows."""

    kernel: str
    shift: np.ndarray  # (d,)
    length_scale: np.ndarray  # (d,)


class CandidateSet(NamedTuple):
    """Candidates as groups of outputs see them, and what their representation leaves out."""

    groups: list  # of WhitenedCandidates or SymmetricCandidates, one for each group
    degrees_of_freedom: list | None  # trace of the smoother of all candidates, where it is known
    unseen: float  # mean part of the prior variance outside the factor, if its rank was limited


def candidate_groups(
    problem, view, rows, functions, members, alphas, n_select=None, *, max_rank=MAX_RANK
):
    """The representation of the candidates that makes a step of the selection cheapest.

    A smooth kernel has a factor of low rank: a step costs the number of candidates times the rank.
    Where the rank is high, a product with the symmetric kernel matrix is cheaper for a given, small
    number of steps.

    Parameters
    ----------
    problem : Problem or ChunkedProblem
    view : View
        How the targets are seen.
    rows : ndarray of shape (n_candidates,)
        Sorted indices of the candidates among the problem's rows.
    functions : RadialFunctions
    members : list of ndarray
        Outputs of each group.
    alphas : list of float
        Ridge of each group.
    n_select : int, optional
        Number of steps, where it is known.
    max_rank : int
        Rank at which the factor of a rough kernel is cut where nothing else limits it.

    Returns
    -------
    CandidateSet
    """
    n, (kernel, shift, length_scale) = problem.n_rows, functions
    Z = (problem.X[rows] - shift) / length_scale
    least, every = min(alphas), len(rows) == n
    tol = 1e-6 if least == 0 else min(1e-3 * least, 1e-6)
    may_be_symmetric = n_select is not None and every and n <= MAX_SYMMETRIC
    may_be_symmetric = may_be_symmetric and problem.codes is None
    if may_be_symmetric:
        # From about this rank on a step on the matrix itself makes up for the factor's price.
        max_rank = max(64, int(np.sqrt(n * n_select)))
    elif n_select is not None and not every:
        # Candidates are a sample anyway, and every row is multiplied by the factor's square.
        max_rank = max(MIN_RANK, int(RANK_PER_CENTER * n_select))
    resolve = n_select if least == 0 else None
    limits = {"max_rank": max_rank, "all_or_nothing": may_be_symmetric}
    factor = pivoted_cholesky(Z, kernel, tol=tol, resolve=resolve, **limits)
    if may_be_symmetric and not factor.complete:
        block = problem.block(slice(None))
        basis, targets = view.of(block)
        K, weights = kernel_matrix(Z, Z, kernel).T, block.root[:, 0] ** 2
        pairs = zip(members, alphas, strict=True)
        groups = [SymmetricCandidates(K, weights, basis, targets[:, of], a) for of, a in pairs]
        return CandidateSet(groups, None, 0.0)
    unseen = 0.0
    if not factor.complete:
        unseen = 1 - np.einsum("ij,ij->", factor.rows, factor.rows) / len(rows)
    root = np.asfortranarray(factor.rows[factor.pivots])
    known = factor.rows if every else None
    features = Features(Z[factor.pivots], shift, length_scale, kernel, root, known)
    groups, degrees = whiten(problem, view, factor, features, members, alphas)
    return CandidateSet(groups, degrees, unseen)
