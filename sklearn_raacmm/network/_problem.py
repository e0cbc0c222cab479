"""What a network learns from weighted rows: targets about a polynomial and groups' constants.

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
from scipy.linalg import solve_triangular

from sklearn_raacmm.network._linear import (
    linear_evidence,
    polynomial_at,
    polynomial_of,
    ridge_rows,
    stack_triangles,
    triangular_factor,
    without_constants,
)
from sklearn_raacmm.network._ranks import to_ranks
from sklearn_raacmm.network._rows import Rows


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
