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

How candidates are represented is `_candidates`' business.

References
----------
.. [1] S. Chen, C. F. N. Cowan, P. M. Grant, "Orthogonal least squares learning algorithm for radial
   basis function networks", IEEE Transactions on Neural Networks 2(2), 1991, 302-309.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import qr, qr_delete, qr_insert, solve_triangular

from sklearn_raacmm.network._candidates import WhitenedCandidates

# Running squared lengths are differences: below this part of what they were, only half their digits
# are left, and they are computed anew.
STALE = 1e-7


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
        self.floor = candidates.resolution**2 * self.norms
        self.fresh = self.norms.copy()
        self.correlations = candidates.correlations()
        self.whitened = isinstance(candidates, WhitenedCandidates)
        self.U = _Basis(candidates.rank)
        self.V = self.U if self.whitened else _Basis(candidates.rank)
        self.target = candidates.target.copy()

    def dependent(self):
        return self.norms <= self.floor

    def gains(self):
        """By how much each candidate would lower the objective of each output."""
        usable = np.where(self.norms > self.floor, self.norms, np.inf)
        return np.square(self.correlations) / usable[:, None]

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
        norm = self.norms[j]
        return norm > self.floor[j] and abs(squared_norm - norm) > 0.1 * norm

    def correct(self, j, u, _, squared_norm):
        """Put the truth about candidate j in the place of the running figures."""
        self.norms[j] = squared_norm
        self.correlations[j] = u @ self.target

    def choose(self, j, u, v, squared_norm):
        """Project candidate j out; return by how much it lowers each output's objective."""
        if self.norms[j] <= self.floor[j]:
            # Dependent in this group's eyes, chosen for another's: nothing is left to project.
            return np.zeros(self.target.shape[1])
        u /= np.sqrt(squared_norm)
        self.U.append(u)
        if v is not u:
            v /= np.sqrt(squared_norm)
            self.V.append(v)
        on_target = u @ self.target
        self.target -= np.outer(v, on_target)
        h = self.candidates.inner(v)
        self.norms -= h * h
        self.correlations -= h[:, None] * on_target
        self.norms[j] = 0.0
        if self.whitened:
            self._refresh()
        return on_target**2

    def _refresh(self):
        """Compute anew what has become a small difference of large numbers."""
        stale = np.flatnonzero((self.norms < STALE * self.fresh) & (self.fresh > self.floor))
        if len(stale):
            left = self.candidates.coordinates[stale]
            left -= (left @ self.U().T) @ self.U()
            self.norms[stale] = self.fresh[stale] = np.einsum("ij,ij->i", left, left)
            self.correlations[stale] = left @ self.target


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
    indices, reductions, summed = [], [], 0.0
    stop = "n_select"
    while len(indices) < n_select:
        scores = score(np.hstack([one.gains() for one in passes]))
        scores[np.all([one.dependent() for one in passes], axis=0)] = -1.0
        j = int(np.argmax(scores))
        if scores[j] < 0:
            stop = "dependent"
            break
        ways = [one.direction(j) for one in passes]
        lost = [one.lost(j, way[2]) for one, way in zip(passes, ways, strict=True)]
        if any(lost):
            # Choose again, with the truth about this candidate.
            for i in np.flatnonzero(lost):
                passes[i].correct(j, *ways[i])
            continue
        chosen = [one.choose(j, *way) for one, way in zip(passes, ways, strict=True)]
        indices.append(j)
        reductions.append(np.concatenate(chosen))
        summed = summed + reductions[-1]
        if enough is not None and np.all(summed >= enough):
            stop = "enough"
            break
    n_outputs = sum(one.target.shape[1] for one in passes)
    reduction = np.reshape(reductions, (len(indices), n_outputs))
    return Selection(np.array(indices, dtype=np.intp), reduction, stop)


class _Subset:
    """Least squares on a subset that trades members, with the gains of all candidates at hand."""

    def __init__(self, candidates, members):
        self.D, self.t = candidates.coordinates, candidates.target
        # Lengths that are differences are good to the root of machine epsilon.
        self.floor = max(candidates.resolution, 1e-6) ** 2 * candidates.squared_norms()
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
    chosen = [WhitenedCandidates(c.coordinates[members], c.target, c.resolution) for c in groups]
    order = forward_selection(chosen, len(members)).indices
    return members[order], n_swaps
