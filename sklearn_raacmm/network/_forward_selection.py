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
from sklearn_raacmm.network._lookahead import Pool, all_scores

# Running squared lengths are differences: below this part of what they were, only half their digits
# are left, and they are computed anew.
STALE = 1e-7
# Steps are taken together only while no length that may matter has fallen below the first part of
# what it was (its digits are worth 1e-6 then), and none at all below the second.
DOUBTFUL, LOST = 1e-9, 1e-11
# In place of the square of a length that is nothing.
SMALLEST = 1e-300


class Selection(NamedTuple):
    """An ordered subset of candidates."""

    indices: np.ndarray  # (k,)
    reduction: np.ndarray  # (k, n_outputs), by how much each step lowered the objective
    stop: str  # why it ended: "n_select", "enough" or "dependent"


def total_score(gains):
    """Trace of the error reduction (Chen et al. 1991, multi-output)."""
    return gains.sum(axis=1) if gains.shape[1] > 1 else gains[:, 0]


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


class _Steps(NamedTuple):
    """Candidates that are chosen one after the other, as a group of outputs sees them."""

    u: np.ndarray  # (n_steps, rank) orthonormal directions
    v: np.ndarray  # (n_steps, rank) their duals; the same array where they are the same
    squared_norms: np.ndarray  # (n_steps,) what is left of each when all before are projected out
    products: np.ndarray  # (n_steps, n_candidates) inner products with all candidates


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

    def state(self):
        """Arguments of `gains`."""
        return self.norms, self.floor, self.correlations

    def dependent(self, j):
        """Whether nothing that can be trusted is left of candidate j."""
        return self.norms[j] <= self.floor[j]

    def project(self, u, v):
        """Make rows u, with dual rows v, orthogonal to what was chosen, in place."""
        if self.U.size:
            c = u @ self.V().T
            u -= c @ self.U()
            if v is not u:
                v -= c @ self.V()

    def directions(self, picks):
        """Orthonormal directions of candidates that are chosen one after the other.

        Parameters
        ----------
        picks : list of int
            The candidates.

        Returns
        -------
        _Steps
        """
        u, v = self.candidates.columns(picks)
        self.project(u, v)
        if v is u:
            squared_norms = _orthonormalise(u)
        else:
            squared_norms = np.empty(len(picks))
            for i in range(len(picks)):
                # Twice is enough for orthogonality to working precision (Giraud et al. 2005).
                for _ in range(2 if i else 0):
                    c = v[:i] @ u[i]
                    u[i] -= c @ u[:i]
                    v[i] -= c @ v[:i]
                squared_norms[i] = u[i] @ v[i]
                _normalise(u[i], v[i], squared_norms[i], same=False)
        # The second time for the chosen ones before.
        self.project(u, v)
        left = np.einsum("ij,ij->i", u, v)[:, None]
        _normalise(u, v, left, u is v)
        return _Steps(u, v, squared_norms * left[:, 0], self.candidates.inner(v))

    def lost(self, j, squared_norm):
        """Whether repeated subtraction has lost the length of candidate j."""
        norm = self.norms[j]
        return norm > self.floor[j] and abs(squared_norm - norm) > 0.1 * norm

    def doubtful(self, scores, best):
        """Whether a candidate that matters, or may matter, is known to too few digits."""
        if not self.whitened:
            return False
        known = self.fresh > self.floor
        share = np.divide(self.norms, self.fresh, out=np.ones_like(self.norms), where=known)
        stale = np.flatnonzero(share < DOUBTFUL)
        return bool(np.any((scores[stale] > 0.1 * best) | (share[stale] < LOST)))

    def correct(self, j, u, squared_norm):
        """Put the truth about candidate j, of unit direction u, in place of the running figures."""
        self.norms[j] = squared_norm
        self.correlations[j] = np.sqrt(max(squared_norm, 0.0)) * (u @ self.target)

    def choose(self, j, steps, i):
        """Project out candidate j, number i of some steps; return the objectives' falls."""
        if self.dependent(j):
            # Dependent in this group's eyes, chosen for another's: nothing is left to project.
            return np.zeros(self.target.shape[1])
        u, v, h = steps.u[i], steps.v[i], steps.products[i]
        self.U.append(u)
        if not self.whitened:
            self.V.append(v)
        on_target = u @ self.target
        self.target -= np.outer(v, on_target)
        self.norms -= h * h
        self.correlations -= h[:, None] * on_target
        self.norms[j] = self.fresh[j] = 0.0
        return on_target**2

    def refresh(self):
        """Compute anew what has become a small difference of large numbers."""
        if not self.whitened:
            return
        stale = np.flatnonzero((self.norms < STALE * self.fresh) & (self.fresh > self.floor))
        if len(stale):
            left = self.candidates.coordinates[stale]
            left -= (left @ self.U().T) @ self.U()
            self.norms[stale] = self.fresh[stale] = np.einsum("ij,ij->i", left, left)
            self.correlations[stale] = left @ self.target


def _orthonormalise(u):
    """Make rows orthonormal one after the other, in place; return what was left of their squares.

    Householder reflections lose no digits where rows depend on those before.
    """
    Q, R = qr(u.T, mode="economic", check_finite=False)
    squared_norms = np.zeros(len(u))  # of rows beyond the dimension nothing is left
    left = R.diagonal()
    squared_norms[: len(left)] = np.square(left)
    u[len(left) :] = 0.0
    np.multiply(Q.T, np.where(left < 0, -1.0, 1.0)[:, None], out=u[: len(left)])
    return squared_norms


def _normalise(u, v, squared_norm, same):
    """Divide directions by their length, in place."""
    length = np.sqrt(np.maximum(squared_norm, SMALLEST))
    u /= length
    if not same:
        v /= length


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
    pool = Pool(passes, score, n_select)
    indices, reductions, summed = [], [], 0.0
    stop = None
    while stop is None and len(indices) < n_select:
        scores = all_scores(score, [one.state() for one in passes])
        j = int(np.argmax(scores))
        if scores[j] < 0:
            stop = "dependent"
            break
        picks = pool.guess(j, scores, n_select - len(indices))
        ways = [one.directions(picks) for one in passes]
        before, wrong = len(indices), False
        for i, j in enumerate(picks):
            if i:
                wrong, sure = _judged(j, passes, score)
                if wrong or not sure:
                    break
            if _corrected(j, i, passes, ways):
                break  # choose again, with the truth about this candidate
            dependent = [one.dependent(j) for one in passes]
            falls = [one.choose(j, way, i) for one, way in zip(passes, ways, strict=True)]
            for number in np.flatnonzero(np.logical_not(dependent)):
                pool.note(number, ways[number].products[i])
            indices.append(j)
            reductions.append(np.concatenate(falls))
            summed = summed + reductions[-1]
            if enough is not None and np.all(summed >= enough):
                stop = "enough"
            if stop is not None or any(dependent):
                break
        for one in passes:
            one.refresh()
        pool.count(len(indices) - before, wrong)
    n_outputs = sum(one.target.shape[1] for one in passes)
    reduction = np.reshape(reductions, (len(indices), n_outputs))
    return Selection(np.array(indices, dtype=np.intp), reduction, stop or "n_select")


def _judged(j, passes, score):
    """Whether a choice that was guessed is wrong, and whether running figures leave no doubt."""
    scores = all_scores(score, [one.state() for one in passes])
    wrong = int(np.argmax(scores)) != j
    return wrong, not any(one.doubtful(scores, scores[j]) for one in passes)


def _corrected(j, i, passes, ways):
    """Whether running figures of candidate j, number i of some steps, had to be put right."""
    lost = [one.lost(j, way.squared_norms[i]) for one, way in zip(passes, ways, strict=True)]
    for number in np.flatnonzero(lost):
        passes[number].correct(j, ways[number].u[i], ways[number].squared_norms[i])
    return any(lost)


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
