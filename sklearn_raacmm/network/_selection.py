r"""Forward selection of basis functions by orthogonal least squares (OLS).

Candidates :math:`j` have columns :math:`\phi_j` (kernel values on the samples, the polynomial
projected out, rows scaled by the root of their weights), targets :math:`Y`, and a subset :math:`S`
is judged by the penalised objective

.. math:: J(S) = \min_w \|Y - \Phi_S w\|_F^2 + \alpha\, \mathrm{tr}(w^\top K_{SS}\, w).

In the inner product :math:`\langle i, j \rangle = \phi_i^\top \phi_j + \alpha K_{ij}` this is an
ordinary projection: forward selection is the Gram-Schmidt process of Chen, Cowan and Grant, and the
candidate that lowers J most has the largest :math:`\sum_o \langle j, y_o \rangle^2 / \langle j, j
\rangle` after both have been made orthogonal to what was chosen before. Candidates come as
coordinates in which that inner product is the Euclidean one (`_candidates`).
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np

# Running squared lengths are differences: below this part of what they were, only half their digits
# are left, and they are computed anew.
STALE = 1e-7
# Gains that differ by less than this part are equal to rounding: the first row wins.
TIE = 1e-9


def forward_selection(coordinates, target, resolution, n_select, *, units: Any = 1.0, enough=None):
    """Choose candidates one at a time, each the one that lowers the objective most.

    Of coordinates (n, rank) and a target (rank, q). `resolution` is the part of a candidate's
    length that is not to be trusted, `units` (q,) divide the outputs' gains, and `enough` says by
    the number and the summed reduction of every output whether to stop. Returns indices, the
    reduction of each step (k, q), and why it stopped.
    """
    norms = np.einsum("ij,ij->i", coordinates, coordinates)
    floor, fresh = resolution**2 * norms, norms.copy()
    target, correlations = target.copy(), coordinates @ target
    directions = np.empty((16, coordinates.shape[1]))  # orthonormal, a row each; it grows
    indices: list[int] = []
    reduction = np.empty((n_select, target.shape[1]))
    stop = "n_select"
    while len(indices) < n_select:
        k, dependent = len(indices), norms <= floor
        if np.all(dependent):
            stop = "dependent"
            break
        gains = np.square(correlations) / np.where(dependent, np.inf, norms)[:, None] / units
        gain = np.where(dependent, -1.0, gains.sum(axis=1))
        j = int(np.argmax(gain >= (1 - TIE) * gain.max()))
        if k == len(directions):
            directions = np.concatenate([directions, np.empty_like(directions)])
        u = coordinates[j].copy()
        # Twice is enough for orthogonality to working precision (Giraud et al. 2005).
        for _ in range(2):
            u -= (directions[:k] @ u) @ directions[:k]
            u /= np.linalg.norm(u)
        directions[k], on_target = u, u @ target
        target -= np.outer(u, on_target)
        products = coordinates @ u
        norms -= np.square(products)
        correlations -= products[:, None] * on_target
        norms[j] = fresh[j] = 0.0
        stale = np.flatnonzero((norms < STALE * fresh) & (fresh > floor))
        if len(stale):
            left = coordinates[stale]
            left -= (left @ directions[: k + 1].T) @ directions[: k + 1]
            norms[stale] = fresh[stale] = np.einsum("ij,ij->i", left, left)
            correlations[stale] = left @ target
        indices.append(j)
        reduction[k] = np.square(on_target)
        if enough is not None and enough(k + 1, reduction[: k + 1].sum(axis=0)):
            stop = "enough"
            break
    return np.array(indices, dtype=np.intp), reduction[: len(indices)], stop
