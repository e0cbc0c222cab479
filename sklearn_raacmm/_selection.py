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

from sklearn_raacmm._candidates import WhitenedCandidates
from sklearn_raacmm._kernels import largest

# Running squared lengths are differences: below this part of what they were, only half their digits
# are left, and they are computed anew.
STALE = 1e-7
# Candidates on the short list, and the most choices made ahead on it.
SHORT_LIST = 1024
MAX_AHEAD = 32


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

    def cut(self, size):
        self.size = size

    def append(self, row):
        if self.size == len(self.rows):
            self.rows = np.concatenate([self.rows, np.empty_like(self.rows)])
        self.rows[self.size] = row
        self.size += 1

    def __call__(self):
        return self.rows[: self.size]


class _ForwardPass:
    """What a group of outputs knows of every candidate while the chosen ones are projected out.

    `attempt` looks ahead on a short list of candidates, `settle` catches up with all of them.
    """

    def __init__(self, candidates):
        self.candidates = candidates
        self.norms = candidates.squared_norms()
        self.floor = candidates.resolution**2 * self.norms
        self.fresh = self.norms.copy()
        self.correlations = candidates.correlations()
        self.U = _Basis(candidates.rank)
        whitened = isinstance(candidates, WhitenedCandidates)
        self.V = self.U if whitened else _Basis(candidates.rank)
        self.settled = 0

    def figures(self):
        return self.norms, self.correlations, self.floor

    def list_figures(self):
        return self.list_norms, self.list_correlations, self.floor[self.listed]

    def start(self, listed):
        """Begin to look ahead on the candidates `listed`."""
        self.listed = listed
        self.rows = self.candidates.rows(listed)
        self.list_norms = self.norms[listed]
        self.list_correlations = self.correlations[listed]

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

    def lost(self, position, squared_norm):
        """Whether repeated subtraction has lost the length of a listed candidate."""
        norm = self.list_norms[position]
        return norm > self.floor[self.listed[position]] and abs(squared_norm - norm) > 0.1 * norm

    def correct(self, position, way):
        """Put the truth about a listed candidate in the place of the running figures."""
        u, _, squared_norm = way
        self.list_norms[position] = squared_norm
        self.list_correlations[position] = self.candidates.target_inner(u)
        return self.listed[position], squared_norm, self.list_correlations[position].copy()

    def attempt(self, position, u, v, squared_norm):
        """Choose a listed candidate, as far as the list is concerned."""
        if self.list_norms[position] <= self.floor[self.listed[position]]:
            # Dependent in this group's eyes, chosen for another's: a direction of no length.
            u, v, squared_norm = np.zeros_like(u), np.zeros_like(v), 1.0
        u /= np.sqrt(squared_norm)
        self.U.append(u)
        if self.V is not self.U:
            v /= np.sqrt(squared_norm)
            self.V.append(v)
        h = self.rows @ self.V()[-1]
        self.list_norms -= h * h
        self.list_correlations -= h[:, None] * self.candidates.target_inner(u)
        self.list_norms[position] = 0.0

    def look_up(self):
        """Inner products of all candidates with the directions attempted since `forget`."""
        self.h = self.candidates.inner(self.V()[self.settled :])
        self.on_target = self.candidates.target_inner(self.U()[self.settled :])

    def settle(self, step, j):
        """Choose candidate j in earnest; return by how much it lowers each output's objective."""
        h, on_target = self.h[:, step], self.on_target[step]
        self.norms -= h * h
        self.correlations -= h[:, None] * on_target
        self.norms[j] = 0.0
        return on_target**2

    def forget(self, n_kept):
        """Keep only the first directions of those attempted."""
        self.settled += n_kept
        self.U.cut(self.settled)
        self.V.cut(self.settled)
        usable = self.norms > self.floor
        stale = usable & (self.norms < STALE * self.fresh)
        if self.V is self.U and np.any(stale):
            self.candidates = self.candidates.without(self.U())
            self.norms = np.where(usable, self.candidates.squared_norms(), 0.0)
            self.correlations = self.candidates.correlations()
            self.fresh = self.norms.copy()


def _gains(norms, correlations, floor):
    return np.square(correlations) / np.where(norms > floor, norms, np.inf)[:, None]


def forward_selection(groups, n_select, *, score=total_score, enough=None):
    """Choose candidates one at a time, each the one that lowers the objective most.

    To update all candidates after every choice takes a matrix-vector product, which waits for
    memory. So choices are made ahead on a short list of the best candidates, then all are updated
    for several choices in one matrix product, and each choice is confirmed, or undone if a
    candidate off the list would have been better: the order is that of choosing one at a time.

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
    ahead, stop = 4, "n_select"

    def scores(figures):
        """One figure a candidate; negative where it is dependent on the chosen ones."""
        gains = score(np.hstack([_gains(*of_group) for of_group in figures]))
        gains[np.all([norms <= floor for norms, _, floor in figures], axis=0)] = -1.0
        return gains

    while len(indices) < n_select and stop == "n_select":
        gains = scores([one.figures() for one in passes])
        listed = np.sort(largest(gains, min(len(gains), SHORT_LIST)))
        for one in passes:
            one.start(listed)
        tried, corrections = [], []
        while len(tried) < min(ahead, n_select - len(indices)):
            gains = scores([one.list_figures() for one in passes])
            position = int(np.argmax(gains))
            if gains[position] < 0:
                break
            ways = [one.direction(listed[position]) for one in passes]
            lost = [one.lost(position, way[2]) for one, way in zip(passes, ways, strict=True)]
            if any(lost):
                # Repeated subtraction has lost this candidate's length: put the truth in its place
                # and choose again.
                for i in np.flatnonzero(lost):
                    corrections.append((len(tried), i, *passes[i].correct(position, ways[i])))
                continue
            for one, way in zip(passes, ways, strict=True):
                one.attempt(position, *way)
            tried.append(int(listed[position]))
        if not tried and not corrections:
            stop = "dependent"
            break
        for one in passes:
            one.look_up()
        kept = 0
        for step in range(len(tried) + 1):
            for _, i, j, norm, correlation in [c for c in corrections if c[0] == step]:
                passes[i].norms[j], passes[i].correlations[j] = norm, correlation
            if step == len(tried) or stop != "n_select":
                break
            if int(np.argmax(scores([one.figures() for one in passes]))) != tried[step]:
                break
            reductions.append(np.concatenate([one.settle(step, tried[step]) for one in passes]))
            indices.append(tried[step])
            summed = summed + reductions[-1]
            kept += 1
            if enough is not None and np.all(summed >= enough):
                stop = "enough"
        for one in passes:
            one.forget(kept)
        ahead = min(2 * ahead, MAX_AHEAD) if kept == ahead else max(kept, 2)
    n_outputs = sum(one.correlations.shape[1] for one in passes)
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
