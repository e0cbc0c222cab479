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

from typing import Any, NamedTuple

import numpy as np

# Running squared lengths are differences: below this part of what they were, only half their digits
# are left, and they are computed anew.
STALE = 1e-7
# In place of the square of a length that is nothing.
SMALLEST = 1e-300


class Selection(NamedTuple):
    """An ordered subset of candidates."""

    indices: np.ndarray  # (k,)
    reduction: np.ndarray  # (k, n_outputs), by how much each step lowered the objective
    stop: str  # why it ended: "n_select", "enough" or "dependent"


class _ForwardPass:
    """What a group of outputs knows of every candidate while the chosen ones are projected out."""

    def __init__(self, candidates):
        self.candidates = candidates
        self.norms = candidates.squared_norms()
        self.floor = candidates.resolution**2 * self.norms
        self.fresh = self.norms.copy()
        self.correlations = candidates.correlations()
        self.target = candidates.target.copy()
        self.whitened = candidates.coordinates is not None
        # Orthonormal directions, a row each, and their duals, in arrays that grow.
        self.size, self.U = 0, np.empty((16, candidates.rank))
        self.V = self.U if self.whitened else np.empty_like(self.U)

    def gains(self):
        """By how much candidates would lower the objective of each output, (n, n_outputs)."""
        left = np.where(self.dependent(), np.inf, self.norms)
        return np.square(self.correlations) / left[:, None]

    def dependent(self):
        """Candidates of which nothing that can be trusted is left."""
        return self.norms <= self.floor

    def _project(self, u, v):
        """Make u, with its dual v, orthogonal to what was chosen, in place."""
        c = self.V[: self.size] @ u
        u -= c @ self.U[: self.size]
        if v is not u:
            v -= c @ self.V[: self.size]

    def direction(self, j):
        """Unit direction of candidate j, its dual, and what is left of its squared length."""
        u, v = self.candidates.column(j)
        squared_norm = 1.0
        # Twice is enough for orthogonality to working precision (Giraud et al. 2005).
        for _ in range(2):
            self._project(u, v)
            left = u @ v
            length = np.sqrt(max(left, SMALLEST))
            u /= length
            if v is not u:
                v /= length
            squared_norm *= left
        return u, v, squared_norm

    def corrected(self, j, u, squared_norm):
        """Whether running figures of candidate j had to be put right: subtraction lost them."""
        norm = self.norms[j]
        if norm <= self.floor[j] or abs(squared_norm - norm) <= 0.1 * norm:
            return False
        self.norms[j] = squared_norm
        self.correlations[j] = np.sqrt(max(squared_norm, 0.0)) * (u @ self.target)
        return True

    def choose(self, j, u, v):
        """Project out candidate j; return the objectives' falls."""
        if self.norms[j] <= self.floor[j]:
            # Dependent in this group's eyes, chosen for another's: nothing is left to project.
            return np.zeros(self.target.shape[1])
        if self.size == len(self.U):
            self.U = np.concatenate([self.U, np.empty_like(self.U)])
            self.V = self.U if self.whitened else np.concatenate([self.V, np.empty_like(self.V)])
        self.U[self.size] = u
        self.V[self.size] = v
        self.size += 1
        products, on_target = self.candidates.inner(v), u @ self.target
        self.target -= np.outer(v, on_target)
        self.norms -= products * products
        self.correlations -= products[:, None] * on_target
        self.norms[j] = self.fresh[j] = 0.0
        if self.whitened:
            self._refresh()
        return on_target**2

    def _refresh(self):
        """Compute anew what has become a small difference of large numbers."""
        stale = np.flatnonzero((self.norms < STALE * self.fresh) & (self.fresh > self.floor))
        if len(stale):
            left = self.candidates.coordinates[stale]
            left -= (left @ self.U[: self.size].T) @ self.U[: self.size]
            self.norms[stale] = self.fresh[stale] = np.einsum("ij,ij->i", left, left)
            self.correlations[stale] = left @ self.target


def forward_selection(groups, n_select, *, units: Any = 1.0, enough=None):
    """Choose candidates one at a time, each the one that lowers the objective most.

    Parameters
    ----------
    groups : list of WhitenedCandidates or SymmetricCandidates
        The same candidates as seen by groups of outputs that differ in their ridge.
    n_select : int
        Stop after this many.
    units : ndarray of shape (n_outputs,), optional
        By which the outputs' gains are divided before they are summed: the trace of the error
        reduction [1]_. The lower index wins among equals. Outputs are in the order of the groups.
    enough : callable, optional
        From the summed reduction of every output to whether to stop.

    Returns
    -------
    Selection
    """
    passes = [_ForwardPass(candidates) for candidates in groups]
    indices: list[int] = []
    reductions: list[np.ndarray] = []
    summed: Any = 0.0
    stop = None
    while stop is None and len(indices) < n_select:
        scores = (np.hstack([one.gains() for one in passes]) / units).sum(axis=1)
        scores[np.all([one.dependent() for one in passes], axis=0)] = -1.0
        j = int(np.argmax(scores))
        if scores[j] < 0:
            stop = "dependent"
            break
        ways = [one.direction(j) for one in passes]
        wrong = [one.corrected(j, way[0], way[2]) for one, way in zip(passes, ways, strict=True)]
        if any(wrong):
            continue  # choose again, with the truth about this candidate
        falls = [one.choose(j, *way[:2]) for one, way in zip(passes, ways, strict=True)]
        indices.append(j)
        reductions.append(np.concatenate(falls))
        summed = summed + reductions[-1]
        if enough is not None and enough(summed):
            stop = "enough"
    n_outputs = sum(one.target.shape[1] for one in passes)
    reduction = np.reshape(reductions, (len(indices), n_outputs))
    return Selection(np.array(indices, dtype=np.intp), reduction, stop or "n_select")
