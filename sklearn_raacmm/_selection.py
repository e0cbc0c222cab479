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


class _ForwardPass:
    """What a group of outputs knows of every candidate while the chosen ones are projected out."""

    def __init__(self, candidates):
        self.candidates = candidates
        self.norms = candidates.squared_norms()
        self.floor = DEPENDENT * self.norms
        self.correlations = candidates.correlations()
        self.alive = self.norms > 0
        self.U = _Basis(candidates.rank)
        whitened = isinstance(candidates, WhitenedCandidates)
        self.V = self.U if whitened else _Basis(candidates.rank)

    def gains(self):
        self.alive &= self.norms > self.floor
        return np.square(self.correlations) / np.where(self.alive, self.norms, np.inf)[:, None]

    def direction(self, j):
        """Candidate j made orthogonal to the chosen ones, its dual, and its squared norm."""
        u, v = self.candidates.column(j)
        # Twice is enough for orthogonality to working precision (Giraud et al. 2005).
        for _ in range(2 if self.U.size else 0):
            c = self.V() @ u
            u -= c @ self.U()
            if v is not u:
                v -= c @ self.V()
        return u, v, u @ v

    def lost(self, j, squared_norm):
        """Whether repeated subtraction has lost the length of candidate j."""
        return self.alive[j] and abs(squared_norm - self.norms[j]) > 0.1 * self.norms[j]

    def correct(self, j, u, squared_norm):
        """Put the truth about candidate j in the place of the running figures."""
        self.norms[j], self.correlations[j] = squared_norm, self.candidates.target_inner(u)

    def add(self, j, u, v, squared_norm):
        """Choose candidate j; return by how much it lowers the objective of each output."""
        if not self.alive[j]:
            return np.zeros(self.correlations.shape[1])
        self.alive[j] = False
        u /= np.sqrt(squared_norm)
        self.U.append(u)
        if v is not u:
            v /= np.sqrt(squared_norm)
            self.V.append(v)
        h, on_target = self.candidates.inner(v), self.candidates.target_inner(u)
        self.norms -= h * h
        self.correlations -= h[:, None] * on_target
        return on_target**2


def forward_selection(groups, n_select, *, score=total_score, enough=None):
    """Choose candidates one at a time, each the one that lowers the objective most.

    Parameters
    ----------
    groups : list of WhitenedCandidates or SymmetricCandidates
        The same candidates as seen by groups of outputs that differ in their ridge.
    n_select : int
        Stop after this many.
    score : callable
        From gains (n_candidates, n_outputs) to one figure a candidate; the largest wins, the lower
        index among equals. Outputs are in the order of the groups.
    enough : ndarray of shape (n_outputs,), optional
        Stop when the summed reduction of every output has reached this.

    Returns
    -------
    Selection
    """
    passes = [_ForwardPass(candidates) for candidates in groups]
    open_ = np.ones(groups[0].n_candidates, dtype=bool)
    indices, reductions, stop = [], [], "n_select"
    while len(indices) < n_select:
        gains = np.hstack([one.gains() for one in passes])
        open_ &= np.any([one.alive for one in passes], axis=0)
        if not open_.any():
            stop = "dependent"
            break
        j = int(np.argmax(np.where(open_, score(gains), -1.0)))
        directions = [one.direction(j) for one in passes]
        lost = False
        for one, (u, _, squared_norm) in zip(passes, directions, strict=True):
            if one.lost(j, squared_norm):
                one.correct(j, u, squared_norm)
                lost = True
        if lost:
            continue
        reductions.append(
            np.concatenate([one.add(j, *way) for one, way in zip(passes, directions, strict=True)])
        )
        indices.append(j)
        open_[j] = False
        if enough is not None and np.all(np.sum(reductions, axis=0) >= enough):
            stop = "enough"
            break
    reduction = np.reshape(reductions, (len(indices), -1))
    return Selection(np.array(indices, dtype=np.intp), reduction, stop)


class _Subset:
    """Least squares on a subset that trades members, with the gains of all candidates at hand."""

    def __init__(self, candidates, members):
        self.D, self.t = candidates.coordinates, candidates.target
        self.floor = DEPENDENT * candidates.squared_norms()
        self.Q, self.R = qr(self.D[members].T, mode="economic", check_finite=False)
        self.remainder = self.t - self.Q @ (self.Q.T @ self.t)
        self.norms = candidates.squared_norms() - np.square(self.D @ self.Q).sum(axis=1)
        self.correlations = self.D @ self.remainder

    def without(self, position):
        """Gains of all candidates once the member at `position` has gone, and its own.

        With it goes one direction, the part of its column that no other member has.
        """
        unit = np.zeros(len(self.R))
        unit[position] = 1.0
        u = self.Q @ solve_triangular(self.R, unit, trans="T", check_finite=False)
        u /= np.linalg.norm(u)
        h, on_target = self.D @ u, u @ self.t
        left = self.norms + h * h
        gains = np.square(self.correlations + h[:, None] * on_target).sum(axis=1)
        gains = np.divide(gains, left, out=np.zeros(len(left)), where=left > self.floor)
        return gains, np.sum(on_target**2), (u, h, on_target, left)

    def direction(self, j, removal):
        """Candidate j made orthogonal to the others; None where its length is not trustworthy."""
        u, h, _, left = removal
        w = self.D[j] - self.Q @ (self.Q.T @ self.D[j]) + u * h[j]
        w -= self.Q @ (self.Q.T @ w) - u * (u @ w)
        squared_norm = w @ w
        if abs(squared_norm - left[j]) > 0.1 * left[j] or squared_norm <= self.floor[j]:
            return None
        return w / np.sqrt(squared_norm)

    def swap(self, position, j, removal, w):
        """Put candidate j at the end in the place of the member at `position`."""
        u, h, on_target, left = removal
        h_new, on_new = self.D @ w, w @ self.t
        self.norms = left - h_new**2
        self.correlations += h[:, None] * on_target - h_new[:, None] * on_new
        self.remainder += np.outer(u, on_target) - np.outer(w, on_new)
        k = len(self.R)
        Q, R = qr_delete(self.Q, self.R, position, which="col", check_finite=False)
        self.Q, self.R = qr_insert(Q, R, self.D[j], k - 1, which="col", check_finite=False)


def exchange(groups, indices, *, max_sweeps=10, tol=1e-4):
    """Improve a subset of fixed size: drop one, take the best in its place, until nothing improves.

    A sweep over all members costs about what the forward pass did.

    Parameters
    ----------
    groups : list of WhitenedCandidates
        As for `forward_selection`.
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
    members = [int(i) for i in indices]
    n_swaps = 0
    for _ in range(max_sweeps):
        subsets = [_Subset(candidates, members) for candidates in groups]
        before = n_swaps
        for member in list(members):
            position = members.index(member)
            gains, own, removals = zip(*(s.without(position) for s in subsets), strict=True)
            gains, own = np.sum(gains, axis=0), np.sum(own)
            gains[members] = -1.0
            j = int(np.argmax(gains))
            reducible = own + sum(np.sum(s.remainder**2) for s in subsets)
            if gains[j] <= own + tol / len(members) * reducible:
                continue
            ways = [s.direction(j, r) for s, r in zip(subsets, removals, strict=True)]
            if any(w is None for w in ways):
                continue
            for subset, removal, w in zip(subsets, removals, ways, strict=True):
                subset.swap(position, j, removal, w)
            members.pop(position)
            members.append(j)
            n_swaps += 1
        if n_swaps == before:
            break
    members = np.sort(members)
    chosen = [WhitenedCandidates(c.coordinates[members], c.target) for c in groups]
    order = forward_selection(chosen, len(members)).indices
    return members[order], n_swaps


def whiten(rows, features, target, alphas):
    """Coordinates of candidates for `forward_selection`, for every ridge.

    Parameters
    ----------
    rows : ndarray of shape (n_candidates, rank)
        Candidates in the factor's coordinates: ``rows @ rows.T`` is their kernel matrix.
    features : ndarray of shape (n, rank)
        Samples in the factor's coordinates, the tail projected out, times root weight.
    target : list of ndarray of shape (n, n_outputs)
        The same of the targets of each group.
    alphas : list of float

    Returns
    -------
    groups : list of WhitenedCandidates
    degrees_of_freedom : list of float
        Trace of the smoother that uses all candidates.
    """
    rank = rows.shape[1]
    gram = features.T @ features
    triangle = None
    groups, degrees = [], []
    for alpha, t in zip(alphas, target, strict=True):
        if alpha > 1e-10 * gram.diagonal().max(initial=0.0):
            ridged = gram.copy()
            ridged[np.diag_indices(rank)] += alpha
            root = cholesky(ridged, lower=True, overwrite_a=True, check_finite=False)
            inverse = solve_triangular(root, np.eye(rank), lower=True, check_finite=False)
            groups.append(WhitenedCandidates(rows @ root, inverse @ (features.T @ t)))
            degrees.append(rank - alpha * float(np.sum(inverse**2)))
        else:
            # Without a ridge to carry them, directions below the root of machine epsilon would
            # drown in the Gram matrix.
            if triangle is None:
                Q, triangle = qr(features, mode="economic", check_finite=False)
            groups.append(WhitenedCandidates(rows @ triangle.T, Q.T @ t))
            degrees.append(float(rank))
    return groups, degrees


def candidate_groups(Z, rows, root, basis, targets, kernel, alphas, n_select, *, whitened=False):
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
    targets : list of ndarray of shape (n, q)
        Targets of each group with the tail projected out, times root.
    kernel : str
    alphas : list of float
        Ridge of each group.
    n_select : int or None
        Number of steps, where it is known.
    whitened : bool
        Ask for `WhitenedCandidates`.

    Returns
    -------
    groups : list of WhitenedCandidates or SymmetricCandidates
    degrees_of_freedom : list of float or None
        Trace of the smoother that uses all candidates, without the tail, where it is known.
    """
    n = len(Z)
    if not KERNELS[kernel].positive_definite:
        # The ridge on the weights of such kernels is left to the last fit.
        columns = root * kernel_matrix(Z, Z[rows], kernel)
        columns -= basis @ (basis.T @ columns)
        return [WhitenedCandidates(columns.T, np.hstack(targets))], None
    least = min(alphas)
    tol = 1e-6 if least == 0 else min(max(1e-3 * least, 1e-10), 1e-6)
    may_be_symmetric = n_select is not None and not whitened and len(rows) == n <= MAX_SYMMETRIC
    max_rank = MAX_RANK if not may_be_symmetric else max(64, int(0.85 * np.sqrt(n * n_select)))
    factor = pivoted_cholesky(Z[rows], kernel, tol=tol, max_rank=max_rank)
    if may_be_symmetric and not factor.complete:
        K = kernel_matrix(Z, Z, kernel).T
        weights = root[:, 0] ** 2
        pairs = zip(targets, alphas, strict=True)
        return [SymmetricCandidates(K, weights, basis, t, alpha) for t, alpha in pairs], None
    if len(rows) == n:
        features = root * factor.rows
    else:
        pivots = factor.pivots
        K = kernel_matrix(Z[rows[pivots]], Z, kernel)
        features = root * solve_triangular(factor.rows[pivots], K, lower=True, overwrite_b=True).T
    features -= basis @ (basis.T @ features)
    return whiten(factor.rows, features, targets, alphas)
