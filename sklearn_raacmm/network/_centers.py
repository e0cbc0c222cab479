r"""The choice of centres: forward selection of basis functions by orthogonal least squares (OLS).

Candidates :math:`j` have columns :math:`\phi_j` (kernel values on the samples, the polynomial
projected out, rows scaled by the root of their weights), targets :math:`Y`, and a subset :math:`S`
is judged by the penalised objective

.. math:: J(S) = \min_w \|Y - \Phi_S w\|_F^2 + \alpha\, \mathrm{tr}(w^\top K_{SS}\, w).

In the inner product :math:`\langle i, j \rangle = \phi_i^\top \phi_j + \alpha K_{ij}` this is an
ordinary projection: forward selection is the Gram-Schmidt process of Chen, Cowan and Grant, and the
candidate that lowers J most has the largest :math:`\sum_o \langle j, y_o \rangle^2 / \langle j, j
\rangle` after both have been made orthogonal to what was chosen before. Candidates come as
coordinates in which that inner product is the Euclidean one. A smooth kernel has a factor of low
rank, and a step costs the number of candidates times the rank. Of a rough kernel the factor is cut.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral

import numpy as np
from scipy.linalg import blas, lapack, solve_triangular
from sklearn.exceptions import ConvergenceWarning

from sklearn_raacmm.network._kernels import kernel_matrix, pivoted_cholesky
from sklearn_raacmm.network._linear import penalise
from sklearn_raacmm.network._ranks import to_ranks
from sklearn_raacmm.utils import warn_user

# Share of the error that noise causes anyway which leaving out candidates may add, about.
TOLERANCE = 0.02
# Share of the variance of the noise that more centres than `MODERATE` have to be worth.
MODERATE, WORTH = 300, 0.02
# Centres tried where their number is not given; and where all rows may become centres, which they
# do where half of them, or this number, would not be enough.
MAX_CENTERS, MOST_TRIED = 2000, 500
# Rank at which the candidates' factor is cut, 240 MB for 10 000 rows, or per centre that may be
# tried. Mean part of the prior variance outside of it that is passed over in silence.
MAX_RANK, RANK_PER_CENTER, UNSEEN = 3000, 1.5, 0.01
# The same where the number of centres is given: in centres, and at the least, of all rows and of a
# sample, where every row is multiplied by the factor's square.
RANK_PER_GIVEN, LEAST_RANK, LEAST_RANK_OF_SAMPLE = 3.5, 1000, 256
# Parameters of the process below which its function is none.
NO_FUNCTION = 0.5
# A candidate that has shrunk to this part of its length is a combination of the chosen ones to
# working precision, and weights would be lost in rounding; where a ridge holds them, to this part.
DEPENDENT = 1e-10
DEPENDENT_RIDGED = 1e-13
# A factor that leaves more than this of the diagonal does not ask for the last digits.
COARSE = 1e-5

# Running squared lengths are differences: below this part of what they were, only half their digits
# are left, and they are computed anew.
STALE = 1e-7
# Gains that differ by less than this part are equal to rounding: the first row wins.
TIE = 1e-9


def choose_centers(problem, rows, structure, n_centers, max_centers, or_all, scaled=False):
    """Indices of centres among `rows`, in order of how much they explain, and why it ended.

    Outputs count in their own units, or, if `scaled`, in units of their spread. Where all rows may
    become centres (`or_all`) None is returned if half of them are not enough.
    """
    asked = int(n_centers) if isinstance(n_centers, Integral) else 0
    if asked > len(rows):
        warn_user(
            f"n_centers={asked}, but there are only {len(rows)} distinct candidate rows: all of "
            "them are taken."
        )
    tried = min(max(MODERATE, len(rows) // 2), MOST_TRIED) if or_all else max_centers or MAX_CENTERS
    most, of = min(asked or tried, len(rows)), problem.varying
    if not len(of):
        # Nothing varies: no centre is needed, and any is as good as another.
        return (rows[:most], "n_centers") if asked else (rows[:0], "criterion")
    # Outputs that share centres see the candidates alike: as the one that needs most of them.
    ridge = float(structure.alpha[of].min())
    rank = _largest_rank(problem, rows, asked, most, or_all)
    coordinates, target, resolution, degrees, unseen = candidates_of(
        problem, rows, structure, ridge, rank, asked or None
    )
    units, goal, enough = _criterion(problem, target, n_centers, degrees, scaled)
    order, reduction, why = forward_selection(
        coordinates, target, resolution, most, units=units, enough=enough
    )
    if why == "n_select":
        if or_all:
            return None, ""
        if max_centers is None:
            _warn_of_limit(goal, reduction)
    if unseen > UNSEEN and not or_all:
        _warn_of_narrow(unseen, coordinates.shape[1], asked)
    free = problem.n_rows - problem.n_tail
    if structure.alpha.min() == 0 and len(order) > free:
        return rows[order[:free]], "dependent"
    reasons = {
        "n_select": "n_centers" if asked else "max_centers",
        "enough": "criterion",
        "dependent": "rank" if unseen > 0 else "dependent",
    }
    return rows[order], reasons[why]


def _largest_rank(problem, rows, asked, most, or_all):
    """Rank at which the candidates' factor is cut."""
    if asked:
        least = LEAST_RANK if len(rows) == problem.n_rows else LEAST_RANK_OF_SAMPLE
        return max(least, int(RANK_PER_GIVEN * asked))
    return LEAST_RANK if or_all else max(MAX_RANK, int(RANK_PER_CENTER * most))


def _criterion(problem, target, n_centers, degrees, scaled):
    """What divides the gains of outputs, what these are to reach, and whether it is enough."""
    spread, total = problem.spread[problem.varying], float(problem.n_total)
    if n_centers != "auto":
        # The trace of the error reduction, of which a part may be left.
        units = np.ones(len(spread)) if scaled else np.square(spread.max() / spread)

        def is_left(_, summed):
            return np.sum((total - summed) / units) <= n_centers * np.sum(total / units)

        enough = None if isinstance(n_centers, Integral) else is_left
        return units, np.zeros(len(spread)), enough
    # Centres are enough as soon as what further ones could still gain, summed over all samples, is
    # below `TOLERANCE` times the noise variance times the effective number of parameters of the
    # network that has all candidates: leaving them out then costs about this share of the error of
    # the noise. Many of them have to be worth a share of the noise itself.
    explained = np.square(target).sum(axis=0)
    units = np.maximum(total - explained, 1e-14 * total) / total
    goal = np.zeros(len(spread))
    if degrees > NO_FUNCTION:
        goal = explained - TOLERANCE * degrees * units
    moderate = np.minimum(goal, explained - WORTH * total * units)
    return units, goal, lambda k, summed: np.all(summed >= (moderate if k >= MODERATE else goal))


def _warn_of_limit(goal, reduction):
    summed = np.sum(reduction, axis=0)
    missed = np.max((goal - summed)[goal > 0] / goal[goal > 0], initial=0.0)
    if missed > 0:
        warn_user(
            f"The number of centres is the default limit of {len(reduction)}; {100 * missed:.2g} % "
            "of what they could explain is not reached. Give a larger max_centers, or set it to "
            "this number if the network is good enough.",
            ConvergenceWarning,
        )


def _warn_of_narrow(unseen, rank, asked):
    more = "They are not those of exact orthogonal least squares."
    if not asked:
        more = f"A larger max_centers raises their number, to {RANK_PER_CENTER:g} times as many."
    warn_user(
        f"The widths are narrow for so many rows: {100 * unseen:.2g} % of the prior variance at "
        f"the candidates lies outside the {rank} dimensions from which centres are chosen. {more}",
        ConvergenceWarning,
    )


def features_at(problem, Z, structure, root=None, known=None):
    """Columns that span the candidates' ones, on any rows: a function of a block, to be read only.

    The functions are centred at Z (m, d), in units of the widths, and multiplied by the inverse of
    a lower triangular root (m, m). Where all rows are candidates the columns are `known`.
    """
    shift = to_ranks(structure.ranks, problem.rows.X).mean(axis=0)

    def columns(block):
        if known is not None and block.start is not None:
            rows = known[block.start : block.start + len(block.X)]
            plain = block.codes is None and np.all(block.root == 1)
            return rows if plain else problem.weigh(rows.copy(order="K"), block)
        X = (to_ranks(structure.ranks, block.X) - shift) / structure.length_scale
        K = kernel_matrix(Z, X, structure.kernel).T
        if root is not None and len(K):
            K = blas.dtrsm(1.0, root, K, side=1, lower=1, trans_a=1, overwrite_b=1)
        return problem.weigh(K, block)

    return columns


def candidates_of(problem, rows, structure, alpha, max_rank, n_select=None):
    """Coordinates of candidates, the sorted indices `rows` among the problem's, (n, rank).

    A rough kernel's factor is cut at `max_rank`; plain least squares of `n_select` steps on rows in
    memory then works with the columns themselves. Returns besides them the projection of the
    targets (rank, q); the part of a candidate's length that is not to be trusted; the trace of the
    smoother with all candidates; and the mean part of the prior variance outside of a cut factor.
    """
    Z = problem.scaled(structure)[rows]
    tol = 1e-6 if alpha == 0 else min(1e-3 * alpha, 1e-6)
    resolve = n_select if alpha == 0 else None
    factor, pivots, residual, complete = pivoted_cholesky(
        Z, structure.kernel, tol=tol, resolve=resolve, max_rank=max_rank
    )
    known, unseen = len(rows) == problem.n_rows, 0.0
    if not complete and alpha == 0 and known and n_select is not None:
        return _columns(problem, features_at(problem, Z, structure))
    if not complete:
        unseen = 1 - np.einsum("ij,ij->", factor, factor) / len(rows)
    root = np.asfortranarray(factor[pivots])
    features = features_at(problem, Z[pivots], structure, root, factor if known else None)
    # A factor that is complete leaves rounding, in which nothing can be told apart. What one of
    # limited rank leaves says nothing of the candidates as far as they are represented.
    resolution = residual if complete else 0.0
    return *_whiten(problem, factor, features, alpha, residual, resolution), unseen


def _columns(problem, features):
    """The candidates' own columns as coordinates, where all rows of a problem are candidates."""
    n = problem.n_rows
    columns, basis, target = problem.reduce(
        lambda block: (features(block), problem.basis(block), problem.about_tail(block)),
        lambda one, other: tuple(map(np.vstack, zip(one, other, strict=True))),
        n,
    )
    columns -= basis @ (basis.T @ columns)
    return np.ascontiguousarray(columns.T), target, DEPENDENT, float(n), 0.0


def _whiten(problem, rows, features, alpha, residual, resolution):
    """Coordinates, in place of the factor's `rows`, targets, resolution and degrees of freedom."""
    rank = rows.shape[1]

    def products(block):
        F = features(block)
        return F.T @ F, F.T @ problem.about_tail(block), problem.basis(block).T @ F

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

        def columns(block):
            return np.hstack([problem.basis(block), features(block), problem.about_tail(block)])

        R = problem.triangle(columns, p + rank + q)
        R = np.pad(R, ((0, p + rank + q - len(R)), (0, 0)))[p : p + rank, p:]
        Q, triangle = penalise(R[:, :rank], 0, np.eye(rank), alpha)
        root, target = triangle.T, Q[:rank].T @ R[:, rank:]
    coordinates = blas.dtrmm(1.0, root, rows, side=1, lower=1, overwrite_b=True)
    inverse = lapack.dtrtri(root, lower=1)[0] if alpha else 0.0
    return coordinates, target, trusted, rank - alpha * float(np.sum(np.square(inverse)))


def forward_selection(
    coordinates, target, resolution, n_select, *, units: float | np.ndarray = 1.0, enough=None
):
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
