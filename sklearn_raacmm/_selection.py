r"""Forward selection of basis functions by orthogonal least squares (OLS).

The problem is the same throughout. Candidates :math:`j` have columns :math:`\phi_j` (kernel values
on the samples, the polynomial tail projected out, rows scaled by the root of their weights),
targets :math:`Y`, and a subset :math:`S` is judged by the penalised least-squares objective

.. math:: J(S) = \min_w \|Y - \Phi_S w\|_F^2 + \alpha\, \mathrm{tr}(w^\top K_{SS}\, w)

whose penalty is the norm of the function in the kernel's own space; :math:`\alpha = 0` is plain
OLS. In the inner product :math:`\langle i, j \rangle = \phi_i^\top \phi_j + \alpha K_{ij}` this is
an ordinary projection, so that forward selection is the Gram-Schmidt process of [1]_: the candidate
that lowers J most has the largest :math:`\sum_o \langle j, y_o \rangle^2 / \langle j, j \rangle`
after both have been made orthogonal to what was chosen before.

Two representations of the candidates serve: `WhitenedCandidates` holds coordinates in which that
inner product is the Euclidean one (few where the kernel is smooth), `SymmetricCandidates` the
kernel matrix itself.

References
----------
.. [1] S. Chen, C. F. N. Cowan, P. M. Grant, "Orthogonal least squares learning algorithm for radial
   basis function networks", IEEE Transactions on Neural Networks 2(2), 1991, 302-309.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import blas, cholesky, qr, qr_delete, qr_insert, solve_triangular

from sklearn_raacmm._kernels import KERNELS, kernel_matrix, pivoted_cholesky

# A candidate whose squared norm has shrunk by this factor is a combination of the chosen ones to
# working precision: the squared norms are differences of numbers known to about machine epsilon.
DEPENDENT = 1e-12
# Rank at which the factor of a rough kernel is cut where the number of steps is not known.
MAX_RANK = 3000
# Samples whose whole kernel matrix is held: 1.8 GB.
MAX_SYMMETRIC = 15_000


class WhitenedCandidates:
    """Candidates as rows of coordinates whose Euclidean inner product is the selection's.

    Parameters
    ----------
    coordinates : ndarray of shape (n_candidates, rank)
    target : ndarray of shape (rank, n_outputs)
        Coordinates of the projection of the targets onto the candidates' span.
    """

    def __init__(self, coordinates, target):
        self.coordinates, self.target = coordinates, target
        self.n_candidates, self.rank = coordinates.shape

    def squared_norms(self):
        return np.einsum("ij,ij->i", self.coordinates, self.coordinates)

    def correlations(self):
        return self.coordinates @ self.target

    def column(self, j):
        """Candidate j, and the vector whose product with another gives their inner product."""
        u = self.coordinates[j].copy()
        return u, u

    def inner(self, v):
        """Inner products of every candidate with the direction that has the dual vector v."""
        return self.coordinates @ v

    def target_inner(self, u):
        return u @ self.target


class SymmetricCandidates:
    """Every sample is a candidate: the kernel matrix is symmetric, one triangle is read a step.

    Parameters
    ----------
    K : ndarray of shape (n, n), Fortran order
        Kernel matrix; only the lower triangle is read after construction.
    weights : ndarray of shape (n,)
    tail : ndarray of shape (n, n_tail)
        Orthonormal basis of the weighted polynomial tail (rows times root weight).
    Y : ndarray of shape (n, n_outputs)
        Targets with the tail projected out, times root weight.
    alpha : float
    """

    def __init__(self, K, weights, tail, Y, alpha):
        self.K, self.tail, self.alpha = K, tail, alpha
        self.root = np.sqrt(weights)
        self.weighted_target = self.root[:, None] * Y
        self.n_candidates = self.rank = len(K)

    def _weigh(self, u):
        u = self.root * u
        u -= self.tail @ (self.tail.T @ u)
        return self.root * u

    def squared_norms(self):
        weighted = self.root[:, None] * self.K
        norms = np.einsum("ij,ij->j", weighted, weighted)
        if self.tail.shape[1]:
            norms -= ((self.tail.T @ weighted) ** 2).sum(axis=0)
        return norms + self.alpha * self.K.diagonal()

    def correlations(self):
        return self.K @ self.weighted_target

    def column(self, j):
        u = self.K[:, j].copy()
        v = self._weigh(u)
        v[j] += self.alpha
        return u, v

    def inner(self, v):
        return blas.dsymv(1.0, self.K, v, lower=1)

    def target_inner(self, u):
        return u @ self.weighted_target


class Selection(NamedTuple):
    """An ordered subset of candidates."""

    indices: np.ndarray  # (k,)
    reduction: np.ndarray  # (k, n_outputs), by how much each step lowered the objective
    stop: str  # why it ended: "n_select", "enough" or "dependent"


def total_score(gains):
    """Trace of the error reduction (Chen et al. 1991, multi-output)."""
    return gains.sum(axis=1)


def squared_ratio_score(squared_norms):
    """The score of MATLAB's newrb: the sum over outputs of squared error-reduction ratios.

    Parameters
    ----------
    squared_norms : ndarray of shape (n_outputs,)
        Squared norms of the targets.

    Returns
    -------
    callable
        For `forward_selection`.
    """
    return lambda gains: np.square(gains / squared_norms).sum(axis=1)


class _Basis:
    """Orthonormal directions, a row each, in an array that grows."""

    def __init__(self, width):
        self.rows, self.size = np.empty((16, width)), 0

    def append(self, row):
        if self.size == len(self.rows):
            self.rows = np.concatenate([self.rows, np.empty_like(self.rows)])
        self.rows[self.size] = row
        self.size += 1

    def __call__(self):
        return self.rows[: self.size]


def _orthogonalise(u, v, U, V):
    """Take the directions U (duals V) out of (u, v), in place, twice: once more is never needed."""
    if len(U):
        for _ in range(2):
            c = V @ u
            u -= c @ U
            if v is not u:
                v -= c @ V


def forward_selection(candidates, n_select, *, score=total_score, enough=None):
    """Choose candidates one at a time, each the one that lowers the objective most.

    Parameters
    ----------
    candidates : WhitenedCandidates or SymmetricCandidates
    n_select : int
        Stop after this many.
    score : callable
        From gains (n_candidates, n_outputs) to one figure a candidate; the largest wins, the lower
        index among equals.
    enough : ndarray of shape (n_outputs,), optional
        Stop when the summed reduction of every output has reached this.

    Returns
    -------
    Selection
    """
    norms = candidates.squared_norms()
    floor = DEPENDENT * norms
    correlations = candidates.correlations()
    alive = norms > 0
    U = _Basis(candidates.rank)
    V = U if isinstance(candidates, WhitenedCandidates) else _Basis(candidates.rank)
    indices, reductions, stop = [], [], "n_select"
    summed = np.zeros(correlations.shape[1])
    while len(indices) < n_select:
        alive &= norms > floor
        if not alive.any():
            stop = "dependent"
            break
        gains = np.square(correlations) / np.where(alive, norms, np.inf)[:, None]
        j = int(np.argmax(np.where(alive, score(gains), -1.0)))
        u, v = candidates.column(j)
        _orthogonalise(u, v, U(), V())
        true = u @ v
        if abs(true - norms[j]) > 0.1 * norms[j]:
            # Repeated subtraction has lost this candidate's length: put the truth in its place and
            # choose again.
            norms[j], correlations[j] = true, candidates.target_inner(u)
            alive[j] = true > floor[j]
            continue
        u /= np.sqrt(true)
        if v is not u:
            v /= np.sqrt(true)
            V.append(v)
        U.append(u)
        h, on_target = candidates.inner(v), candidates.target_inner(u)
        norms -= h * h
        correlations -= h[:, None] * on_target
        alive[j] = False
        indices.append(j)
        reductions.append(on_target**2)
        summed += on_target**2
        if enough is not None and np.all(summed >= enough):
            stop = "enough"
            break
    shape = (len(indices), correlations.shape[1])
    return Selection(np.array(indices, dtype=np.intp), np.reshape(reductions, shape), stop)


def exchange(candidates, indices, *, max_sweeps=10, tol=1e-4):
    """Improve a subset of fixed size: drop one, take the best in its place, until nothing improves.

    Dropping a member adds back one direction, the part of its column that no other member has; with
    it the gains of all candidates follow from one product, so that a sweep costs about what the
    forward pass did.

    Parameters
    ----------
    candidates : WhitenedCandidates
    indices : ndarray of shape (k,)
    max_sweeps : int
    tol : float
        A swap must lower the objective's reducible part by more than this share of it, over k.

    Returns
    -------
    indices : ndarray of shape (k,)
        In the order in which `forward_selection` would take them.
    n_swaps : int
    """
    D, t = candidates.coordinates, candidates.target
    floor = DEPENDENT * candidates.squared_norms()
    members = [int(i) for i in indices]
    n_swaps = 0
    for _ in range(max_sweeps):
        Q, R = qr(D[members].T, mode="economic", check_finite=False)
        remainder = t - Q @ (Q.T @ t)
        norms = candidates.squared_norms() - np.square(D @ Q).sum(axis=1)
        correlations = D @ remainder
        swapped = False
        for member in list(members):
            position = members.index(member)
            unit = np.zeros(len(members))
            unit[position] = 1.0
            u = Q @ solve_triangular(R, unit, trans="T", check_finite=False)
            u /= np.linalg.norm(u)
            h, on_target = D @ u, u @ t
            left = norms + h * h
            gains = np.square(correlations + h[:, None] * on_target).sum(axis=1)
            alive = left > floor
            alive[members] = False
            gains = np.divide(gains, left, out=np.full(len(D), -1.0), where=alive)
            j = int(np.argmax(gains))
            own = np.sum(on_target**2)
            reducible = np.sum(remainder**2) + own
            if gains[j] <= own + tol / len(members) * reducible:
                continue
            w = D[j] - Q @ (Q.T @ D[j]) + u * h[j]
            w -= Q @ (Q.T @ w) - u * (u @ w)
            true = w @ w
            if abs(true - left[j]) > 0.1 * left[j]:
                continue
            w /= np.sqrt(true)
            h_new, on_new = D @ w, w @ t
            norms = left - h_new**2
            correlations += h[:, None] * on_target - h_new[:, None] * on_new
            remainder += np.outer(u, on_target) - np.outer(w, on_new)
            Q, R = qr_delete(Q, R, position, which="col", check_finite=False)
            Q, R = qr_insert(Q, R, D[j], len(members) - 1, which="col", check_finite=False)
            members.pop(position)
            members.append(j)
            n_swaps += 1
            swapped = True
        if not swapped:
            break
    members = np.sort(members)
    order = forward_selection(WhitenedCandidates(D[members], t), len(members)).indices
    return members[order], n_swaps


def whiten(rows, features, target, alpha):
    """Coordinates of candidates for `forward_selection`.

    Parameters
    ----------
    rows : ndarray of shape (n_candidates, rank)
        Candidates in the factor's coordinates: ``rows @ rows.T`` is their kernel matrix.
    features : ndarray of shape (n, rank)
        Samples in the factor's coordinates, the tail projected out, times root weight.
    target : ndarray of shape (n, n_outputs)
        The same of the targets.
    alpha : float

    Returns
    -------
    WhitenedCandidates
    degrees_of_freedom : float
        Trace of the smoother that uses all candidates.
    """
    rank = rows.shape[1]
    gram = features.T @ features
    if alpha > 1e-10 * gram.diagonal().max():
        gram[np.diag_indices(rank)] += alpha
        root = cholesky(gram, lower=True, overwrite_a=True, check_finite=False)
        inverse = solve_triangular(root, np.eye(rank), lower=True, check_finite=False)
        t = inverse @ (features.T @ target)
        return WhitenedCandidates(rows @ root, t), rank - alpha * float(np.sum(inverse**2))
    # Without a ridge to carry them, directions below the root of machine epsilon would drown in the
    # Gram matrix.
    Q, R = qr(features, mode="economic", check_finite=False)
    return WhitenedCandidates(rows @ R.T, Q.T @ target), float(rank)


def candidates_from(Z, rows, root, basis, targets, kernel, alpha, n_select, *, whitened=False):
    """The representation of the candidates that makes a step of the selection cheapest.

    A smooth kernel has a factor of low rank: a step costs the number of candidates times the rank.
    Where the rank is high, a product with the symmetric kernel matrix is cheaper for a given, small
    number of steps.

    Parameters
    ----------
    Z : ndarray of shape (n, d)
        Samples divided by the length scales.
    rows : ndarray of shape (n_candidates,)
        Sorted indices of the candidates.
    root : ndarray of shape (n, 1)
        Root of the weights.
    basis : ndarray of shape (n, p)
        Orthonormal basis of the tail times root.
    targets : ndarray of shape (n, q)
        Targets with the tail projected out, times root.
    kernel : str
    alpha : float
    n_select : int or None
        Number of steps, where it is known.
    whitened : bool
        Ask for `WhitenedCandidates`.

    Returns
    -------
    candidates : WhitenedCandidates or SymmetricCandidates
    degrees_of_freedom : float or None
        Trace of the smoother that uses all candidates, without the tail, where it is known.
    """
    n = len(Z)
    if not KERNELS[kernel].positive_definite:
        # The ridge on the weights of such kernels is left to the last fit.
        columns = root * kernel_matrix(Z, Z[rows], kernel)
        columns -= basis @ (basis.T @ columns)
        return WhitenedCandidates(columns.T, targets), None
    tol = 1e-6 if alpha == 0 else min(max(1e-3 * alpha, 1e-10), 1e-6)
    may_be_symmetric = n_select is not None and not whitened and len(rows) == n <= MAX_SYMMETRIC
    max_rank = MAX_RANK if not may_be_symmetric else max(64, int(0.85 * np.sqrt(n * n_select)))
    factor = pivoted_cholesky(Z[rows], kernel, tol=tol, max_rank=max_rank)
    if may_be_symmetric and not factor.complete:
        K = kernel_matrix(Z, Z, kernel).T
        return SymmetricCandidates(K, root[:, 0] ** 2, basis, targets, alpha), None
    if len(rows) == n:
        features = root * factor.rows
    else:
        pivots = factor.pivots
        K = kernel_matrix(Z[rows[pivots]], Z, kernel)
        features = root * solve_triangular(factor.rows[pivots], K, lower=True, overwrite_b=True).T
    features -= basis @ (basis.T @ features)
    return whiten(factor.rows, features, targets, alpha)
