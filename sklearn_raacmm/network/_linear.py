"""What of a network is linear: groups' constants, the polynomial, its evidence, least squares.

All that the numerics need of the rows is a sum over blocks of them, or a triangular factor.

Where targets are known up to a constant of each group of rows, its variance is `ratio` times that
of the noise, whose covariance is ``W^-1 + ratio G``, where G is 1 within a group. Rows less
``1 - 1 / sqrt(1 + ratio w_g)`` times their group's weighted mean, times the root of their weights,
have independent noise of unit variance: that is done to all columns and targets alike.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import qr, solve_triangular

from sklearn_raacmm.network._ranks import to_ranks
from sklearn_raacmm.network._rows import Rows
from sklearn_raacmm.utils import Groups

# Ridges that are tried: powers of 2, whose choice no rounding changes.
RIDGES = 2.0 ** np.arange(-40, 41)
# The prior of the noise variance: below this share of an output's variance each power of e costs so
# many nats, as much as two observations say.
SILENT, DOUBT = 0.05, 1.0


def polynomial_of(X, weights, degree, ridged=False):
    """Polynomial of rows (n, d), its p columns as linear functions of (1, x): (p, 1 + d).

    Features are centred and scaled; those that do not vary or are combinations of others are left
    out. With fewer rows than features some are so by chance: a ridge (`ridged`) tells them apart.
    """
    d = X.shape[1]
    if degree < 1:
        return np.eye(1 + d)[: degree + 1]
    center = np.average(X, axis=0, weights=weights)
    scale = np.sqrt(np.average(np.square(X - center), axis=0, weights=weights))
    used = np.flatnonzero(scale > 1e-13 * np.abs(X).max(axis=0))
    if not (ridged and len(X) <= d):
        R, order = qr((X[:, used] - center[used]) / scale[used], mode="r", pivoting=True)
        size = np.abs(R.diagonal())
        used = np.sort(used[order[: np.sum(size > 1e-10 * size.max(initial=0))]])
    linear = np.eye(d)[used] / scale[used, None]
    return np.vstack([np.eye(1, 1 + d), np.column_stack([-linear @ center, linear])])


def polynomial_at(polynomial, X):
    """Columns (n, p) of a polynomial at rows."""
    return polynomial[:, 0] + X @ polynomial[:, 1:].T


def ridge_rows(n_tail, ridge):
    """Rows that, below those of the polynomial, give its linear part a ridge; the constant none."""
    return np.sqrt(ridge) * np.eye(n_tail)[1:] if ridge else np.empty((0, n_tail))


def without_constants(columns, codes, weights, ratio):
    """Columns less that share of their groups' means which makes the noise independent."""
    if codes is None or not ratio:
        return columns
    share = 1 - 1 / np.sqrt(1 + ratio * np.bincount(codes, weights))
    return columns - (share[:, None] * Groups(codes).means(columns, weights))[codes]


def linear_evidence(columns, targets, within, n_free, n_total):
    """Ridge of a linear model, the same for all features and outputs, by its likelihood.

    Of columns (n, d), centred and in units of their spread, and targets (n, q), times root weights.
    Coefficients have normal priors of one variance, the noise variance over the ridge (MacKay,
    Neural Comput. 4, 1992). Returns the ridge, 0 where there is nothing to be found; the objective
    as `_likelihood` has it, without the price; and the negative log likelihood. The ridge is found
    by `n_free` observations, without the mean: as many features as rows would else have none.
    """
    nothing = 0.0, np.inf, np.inf
    if not columns.size:
        return nothing
    U, d, _ = np.linalg.svd(columns, full_matrices=False)
    along = U.T @ targets
    left = np.square(targets - U @ along).sum(axis=0) + within
    along, d2 = np.square(along), np.square(d)
    total = left + along.sum(axis=0)
    varying = total > 0
    if not np.any(varying):
        return nothing
    left, along, share = left[varying], along[:, varying], SILENT * total[varying] / n_total

    def likelihood(ridge, n):
        misfit = np.maximum(left + (ridge / (d2 + ridge)) @ along, np.finfo(float).tiny)
        log_det = varying.sum() * np.log1p(d2 / ridge).sum()
        doubt = np.log1p(share / (misfit / n_total)).sum()
        return 0.5 * (n * np.log(misfit).sum() + log_det), DOUBT * doubt

    ridge = min(RIDGES, key=lambda ridge: sum(likelihood(ridge, n_free)))
    value, doubt = likelihood(ridge, n_total)
    return ridge, value + doubt, value


def triangular_factor(rows):
    """R of the QR factorisation, upper triangular or trapezoidal; its signs are arbitrary."""
    return qr(rows, mode="r", overwrite_a=True, check_finite=False)[0][: rows.shape[1]]


def stack_triangles(upper, lower):
    """The triangular factor of two blocks of rows from those of each."""
    return triangular_factor(np.vstack([upper, lower]))


class Block(NamedTuple):
    """Some rows of a problem: columns less groups' constants, times the root of the weights."""

    X: np.ndarray  # (n, d)
    root: np.ndarray  # (n, 1) root of the weights, in units of an observation's
    tail: np.ndarray  # (n, p) polynomial
    targets: np.ndarray  # (n, q)
    codes: np.ndarray | None = None  # (n,) groups, where these have constants
    start: int | None = None  # which of the problem's rows the first one is


class Problem:
    """A polynomial and targets at distinct rows, or at more rows, of which these are a sample.

    Of these rows, `everywhere`, there are the source, their number and weight, and the columns of
    the targets.
    """

    def __init__(self, rows, polynomial, tail_ridge=0.0, ratio=0.0, everywhere=None):
        self.rows: Rows = rows
        self.polynomial: np.ndarray = polynomial  # (p, 1 + d)
        self.ratio: float = ratio  # variance of groups' constants over that of the noise
        # The ridge of the linear part, in units of an observation, as further rows of the tail.
        self.tail_ridge: float = tail_ridge
        self.tail_rows: np.ndarray = ridge_rows(len(polynomial), tail_ridge)
        self.everywhere = everywhere
        if everywhere is None:
            # Number of observations, and of rows; mean weight of an observation.
            self.n_total, self.n_rows = rows.observed.sum(), rows.n_rows
            self.unit: float = rows.weights.sum() / self.n_total
            self.within: np.ndarray = rows.lost / self.unit  # (q,) sum of squares lost by merging
        else:
            _, self.n_rows, weight, outputs = everywhere
            self.n_total, self.unit = self.n_rows, weight / self.n_rows
            self.within = np.zeros(len(outputs))
        p = self.n_tail = len(polynomial)
        R = self.triangle(
            lambda block: np.hstack([block.tail, block.targets]), p + len(self.within)
        )
        self.tail_root = R[:p, :p]
        self.projection = R[:p, p:]  # of the targets along the polynomial's basis
        size, left = (np.square(part).sum(axis=0) for part in (R[:, p:], R[p:, p:]))
        # Root mean square (q,) of targets about the tail, 0 for a constant: what is left of one by
        # rounding is not variation.
        self.spread = np.sqrt((left + self.within) / self.n_total)
        self.spread[self.spread <= 1e-13 * np.sqrt(size / self.n_total)] = 0.0
        self.varying = np.flatnonzero(self.spread > 0)

    def block(self, rows: Rows, start: int | None = None) -> Block:
        """Rows as the numerics want them."""
        weights = rows.weights / self.unit
        root, arrays = np.sqrt(weights)[:, None], (polynomial_at(self.polynomial, rows.X), rows.Y)
        tail, targets = (
            root * without_constants(a, rows.codes, weights, self.ratio) for a in arrays
        )
        return Block(rows.X, root, tail, targets, rows.codes, start)

    def basis(self, block: Block) -> np.ndarray:
        """Columns (n, p) of the polynomial made orthonormal on all rows."""
        return solve_triangular(self.tail_root, block.tail.T, trans="T", check_finite=False).T

    def about_tail(self, block: Block) -> np.ndarray:
        """Targets that vary, about the polynomial and in units of their spread."""
        of = self.varying
        return (block.targets[:, of] - self.basis(block) @ self.projection[:, of]) / self.spread[of]

    def scaled(self, structure: Any) -> np.ndarray:
        """Rows as radial functions see them, about their middle in units of the widths."""
        X = to_ranks(structure.ranks, self.rows.X)
        return (X - X.mean(axis=0)) / structure.length_scale

    def weigh(self, columns: np.ndarray, block: Block) -> np.ndarray:
        """Columns at a block's rows, less groups' constants, times root; may overwrite them."""
        weights = np.square(block.root[:, 0])
        columns = without_constants(columns, block.codes, weights, self.ratio)
        columns *= block.root
        return columns

    def reduce(self, function: Callable, combine: Callable, width: int) -> Any:
        """Combine the function of every block of rows, which holds `width` numbers a row."""
        if self.everywhere is None:
            source, outputs = self.rows, slice(None)
        else:
            source, *_, outputs = self.everywhere
        found = source.reduce(
            lambda rows, start: function(self.block(rows._replace(Y=rows.Y[:, outputs]), start)),
            combine,
            width,
        )
        m = len(self.tail_rows)
        if not m:
            return found
        # The ridge of the polynomial, as rows without weight.
        X, targets = (np.zeros((m, a.shape[1])) for a in (self.rows.X, self.rows.Y))
        return combine(found, function(Block(X, np.zeros((m, 1)), self.tail_rows, targets)))

    def triangle(self, columns: Callable, width: int) -> np.ndarray:
        """Triangular factor (<= width, width) of columns, a function of a block, on all rows."""
        return self.reduce(lambda block: triangular_factor(columns(block)), stack_triangles, width)


def prepare(rows: Rows, degree: int, ridged: bool = False, ratio: float = 0.0) -> Problem:
    """Set up the polynomial of a degree at distinct rows; if `ridged`, by the likelihood."""
    polynomial = polynomial_of(rows.X, rows.weights, degree, ridged)
    problem = Problem(rows, polynomial, 0.0, ratio)
    if not (ridged and degree == 1):
        return problem
    block, n = problem.block(rows), problem.n_total
    about = block.targets - block.tail[:, :1] * np.average(rows.Y, axis=0, weights=rows.weights)
    ridge = linear_evidence(block.tail[:, 1:], about, problem.within, n - 1, n)[0]
    return Problem(rows, polynomial, ridge, ratio) if ridge else prepare(rows, degree, ratio=ratio)


def nested_least_squares(R, n_tail, penalty_root, alphas, within):
    """Solve every nested subset, with no use of the running figures of the selection.

    R (<= p + k + q, p + k + q) is the triangular factor of the tail, the k members in order and the
    q targets; ``penalty_root.T @ penalty_root`` times `alphas` (q,) the members' penalty. Returns
    of the first 0, 1, ... k members the sum of squared residuals, and the same with the penalty,
    (k + 1, q); and for `first_weights` the rotated targets and triangles.
    """
    q, p, k = len(alphas), n_tail, penalty_root.shape[1]
    columns, targets = R[: p + k, : p + k], R[: p + k, p + k :]
    beyond = np.square(R[p + k :, p + k :]).sum(axis=0)
    rss, objective, rotated = np.empty((k + 1, q)), np.empty((k + 1, q)), np.empty((p + k, q))
    triangles = {}
    for alpha in np.unique(alphas):
        of = np.flatnonzero(alphas == alpha)
        Q, triangle = penalise(columns, p, penalty_root, alpha)
        Q = Q[: len(columns)]
        rotated[:, of] = Q.T @ targets[:, of]
        triangles |= dict.fromkeys(of, triangle)
        # Residuals of all sizes at once: what each further direction takes away.
        taken = np.cumsum(Q[:, None, :] * rotated[:, of].T, axis=2)
        left = targets[:, of, None] - np.pad(taken, ((0, 0), (0, 0), (1, 0)))
        rss[:, of] = np.square(left[:, :, p:]).sum(axis=0).T + beyond[of]
        gained = np.cumsum(np.square(rotated[p:, of]), axis=0)
        objective[:, of] = rss[0, of] - np.pad(gained, ((1, 0), (0, 0)))
    # A difference of large numbers: the objective is never below its own first part.
    objective = np.maximum(objective, rss)
    return rss + within, objective + within, rotated, triangles


def first_weights(rotated, triangles, size):
    """Weights (size, q) of the first columns, the tail's and some members', see above."""
    solution = rotated[:size].copy()
    for i, R in triangles.items() if size else ():
        solution[:, i] = solve_triangular(R[:size, :size], solution[:, i], check_finite=False)
    return solution


def penalise(rows, n_tail, penalty_root, alpha):
    """Q and R (p + k, p + k) of the rows' triangle with the penalty of its members below it."""
    penalty = np.sqrt(alpha) * penalty_root if alpha > 0 else penalty_root[:0]
    stacked = np.vstack([rows, np.pad(penalty, ((0, 0), (n_tail, 0)))])
    if not rows.shape[1]:
        return stacked, stacked[:0]
    return qr(stacked, mode="economic", check_finite=False)
