"""Weighted data as the network's numerics want them: distinct rows, the polynomial projected out.

All that the numerics need of the rows is a sum over blocks of them, or a triangular factor.

Where targets are known up to a constant of each group of rows, its variance is `ratio` times that
of the noise, whose covariance is ``W^-1 + ratio G``, where G is 1 within a group. Rows less
``1 - 1 / sqrt(1 + ratio w_g)`` times their group's weighted mean, times the root of their weights,
have independent noise of unit variance: that is done to all columns and targets alike.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from functools import reduce
from itertools import chain, pairwise
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.linalg import qr

from sklearn_raacmm.network._linear import (
    Polynomial,
    linear_evidence,
    polynomial_of,
    ridge_rows,
    stack_triangles,
    triangular_factor,
    without_constants,
)
from sklearn_raacmm.network._ranks import to_ranks
from sklearn_raacmm.utils import chunks, numbered_by_rows

# Numbers in a block of rows: 4 MB stay in a core's cache while they are worked on. A block that is
# reduced to a triangle is to be higher than wide, as far as 64 MB allow.
SMALL_BLOCK, BLOCK = 2**19, 2**23


def block_rows(width):
    """Rows of a block that holds `width` numbers a row."""
    width = max(1, width)
    return max(SMALL_BLOCK // width, min(4 * width, BLOCK // width))


class Rows(NamedTuple):
    """Distinct rows in sorted order: of their groups, if there are any, and then of X."""

    X: np.ndarray  # (n, d)
    Y: np.ndarray  # (n, q) weighted mean targets
    first: np.ndarray  # (n,) where each was first seen
    weights: np.ndarray  # (n,) summed
    within: np.ndarray  # (n, q) weighted sum of squares of the targets about these means
    observed: np.ndarray  # (n,) observations: rows of the same X that differ in Y
    codes: np.ndarray | None = None  # (n,) group of each row, from 0, where groups have constants

    @property
    def n_total(self):
        """Number of observations, where a weight of 1 is one."""
        return self.weights.sum()

    @property
    def targets(self):
        """Targets times the root of the weights."""
        return np.sqrt(self.weights)[:, None] * self.Y

    @property
    def lost(self):
        """Sum of squares (q,) that merging took out of the targets."""
        return self.within.sum(axis=0)

    def some(self, kept: np.ndarray | slice) -> Self:
        """Some of them."""
        codes = None if self.codes is None else np.unique(self.codes[kept], return_inverse=True)[1]
        arrays = {name: getattr(self, name)[kept] for name in self._fields[:6]}
        return self._replace(**arrays, codes=codes)

    def of_outputs(self, outputs: np.ndarray) -> Self:
        """The same rows with some of the outputs."""
        # In the order of memory that they have where these outputs are all there are.
        Y, within = (np.ascontiguousarray(a[:, outputs]) for a in (self.Y, self.within))
        return self._replace(Y=Y, within=within)

    def draw(self, size, random_state):
        """About `size` rows drawn at random, sorted, groups as a whole; all where no more."""
        n = len(self.X)
        if n <= size:
            return np.arange(n)
        if self.codes is None:
            return np.sort(random_state.permutation(n)[:size])
        order = random_state.permutation(self.codes.max() + 1)
        ends = np.cumsum(np.bincount(self.codes)[order])
        # Of the last group a part: data of a few large groups would otherwise be one of them.
        rows = [np.flatnonzero(self.codes == g) for g in order[: np.searchsorted(ends, size) + 1]]
        rows[-1] = random_state.permutation(rows[-1])[: size - sum(map(len, rows[:-1]))]
        return np.sort(np.concatenate(rows))

    def add_noise(self, K, alpha, ratio):
        """A kernel matrix (n, n), times root weights, with the noise: a new matrix."""
        K = K.copy()
        K[np.diag_indices(len(K))] += alpha
        for rows, root in self.constants(ratio):
            K[rows, rows] += alpha * np.outer(root, root)
        return K

    def constants(self, ratio):
        """Slices of the groups that have constants, and what these add to a unit of noise.

        The covariance is the product of the roots, of the weights and of the ratio.
        """
        if self.codes is None or not ratio:
            return []
        root = np.sqrt(ratio * self.weights)
        return [(rows, root[rows]) for rows in self.groups]

    @property
    def groups(self):
        """Slices of the rows that are left out together."""
        codes = np.arange(len(self.X)) if self.codes is None else self.codes
        ends = [0, *(np.flatnonzero(np.diff(codes)) + 1), len(codes)]
        return [slice(*pair) for pair in pairwise(ends)]


class Block(NamedTuple):
    """Some rows of a problem: columns less groups' constants, times the root of the weights."""

    X: np.ndarray  # (n, d)
    root: np.ndarray  # (n, 1) root of the weights, in units of an observation's
    tail: np.ndarray  # (n, p) polynomial
    basis: np.ndarray  # (n, p) orthonormal basis of it on all rows
    targets: np.ndarray  # (n, q)
    codes: np.ndarray | None = None  # (n,) groups, where these have constants
    part: slice | None = None  # which of the rows that are held these are


class Problem(NamedTuple):
    """A polynomial and targets at distinct rows, or at more rows, of which these are a sample."""

    rows: Rows
    held: Block  # the same, as sums over rows take them
    unit: float  # mean weight of an observation
    n_total: float  # number of observations, the sum of the weights in these units
    within: np.ndarray  # (q,) sum of squares lost by taking means
    ratio: float  # variance of groups' constants over that of an observation's noise
    polynomial: Polynomial
    projection: np.ndarray  # (p, q) targets along the polynomial's basis
    spread: np.ndarray  # (q,) root mean square of targets about the tail, 0 for a constant
    tail_ridge: float  # of the tail's linear part, in units of an observation
    basis_rows: np.ndarray  # (p - 1, p) the ridge as further rows of the basis, if any
    # Combines a function of all blocks, as `reduce` does, where not all rows are held.
    of_read: Callable | None = None

    @property
    def n_rows(self) -> int:
        return len(self.rows.X) if self.of_read is None else int(self.n_total)

    @property
    def n_tail(self) -> int:
        return self.held.tail.shape[1]

    @property
    def tail_rows(self) -> np.ndarray:
        """The ridge as further rows of the polynomial."""
        return ridge_rows(self.n_tail, self.tail_ridge)

    @property
    def varying(self) -> np.ndarray:
        """The targets' columns that are no constants."""
        return np.flatnonzero(self.spread > 0)

    def about_tail(self, block: Block) -> np.ndarray:
        """Targets that vary, about the polynomial and in units of their spread."""
        of = self.varying
        return (block.targets[:, of] - block.basis @ self.projection[:, of]) / self.spread[of]

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
        if self.of_read is None:
            return reduce(combine, map(function, chain(self._of_held(width), self._of_ridge())))
        found = self.of_read(function, combine, width)
        return reduce(combine, map(function, self._of_ridge()), found)

    def triangle(self, columns: Callable, width: int) -> np.ndarray:
        """Triangular factor (<= width, width) of columns, a function of a block, on all rows."""
        return self.reduce(lambda block: triangular_factor(columns(block)), stack_triangles, width)

    def _of_held(self, width):
        """Blocks of the rows that are held; whole groups."""
        parts, codes = chunks(self.n_rows, block_rows(width)), self.held.codes
        arrays = self.held[:5]
        for part in parts if codes is None else _whole_groups(parts, codes):
            own = None if codes is None else codes[part] - codes[part.start]
            yield Block(*(array[part] for array in arrays), codes=own, part=part)

    def _of_ridge(self):
        """The ridge of the polynomial as rows without weight, if it has one."""
        m = len(self.basis_rows)
        if m:
            X, targets = (np.zeros((m, a.shape[1])) for a in (self.rows.X, self.held.targets))
            yield Block(X, np.zeros((m, 1)), self.tail_rows, self.basis_rows, targets)


def _whole_groups(parts, codes):
    """Slices of rows, each extended to the end of the group in which it ends."""
    start = 0
    for part in parts:
        stop = int(np.searchsorted(codes, codes[part.stop - 1], side="right"))
        if stop > start:
            yield slice(start, stop)
        start = max(start, stop)


def merge(X, Y, weights, within=None, count=None, codes=None):
    """Merge repeated rows of a group, and drop rows without weight, whatever their order.

    A row that says again what another has said, target and all, adds weight but is no further
    observation. `within` (n, q) and `count` (n,) are of a merge before.
    """
    kept = np.flatnonzero(weights > 0)
    X, Y, weights = X[kept] + 0.0, Y[kept], weights[kept]  # adding 0 makes -0.0 and 0.0 one value
    if codes is not None:  # by the rows themselves, not by their order or the names of groups
        codes = np.unique(codes[kept], return_inverse=True)[1]
        codes = numbered_by_rows(codes, np.lexsort(np.column_stack([Y, X]).T))[0]
    keys = X if codes is None else np.column_stack([codes, X])
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    inverse = inverse.ravel()
    distinct, n = X[first], len(first)

    def summed(values):
        return np.bincount(inverse, weights=values, minlength=n)

    total = summed(weights)
    mean = np.column_stack([summed(weights * y) for y in Y.T]) / total[:, None]
    about = weights[:, None] * np.square(Y - mean[inverse])
    if within is not None:
        about += within[kept]
    within = np.column_stack([summed(column) for column in about.T])
    if count is None:
        several = np.flatnonzero((np.bincount(inverse, minlength=n) > 1)[inverse])
        pairs = np.unique(np.column_stack([inverse[several], Y[several]]), axis=0)[:, 0]
        observed = np.maximum(np.bincount(pairs.astype(np.intp), minlength=n), 1.0)
    else:
        alike = np.all(within == 0.0, axis=1)
        observed = np.where(alike, 1.0, summed(count[kept]))
    if codes is not None:
        codes = codes[first]
    return Rows(distinct, mean, kept[first], total, within, observed, codes)


def prepare(rows: Rows, degree: int, ridged: bool = False, ratio: float = 0.0) -> Problem:
    """Set up the polynomial of a degree at distinct rows; if `ridged`, by the likelihood."""
    unit, n_total = rows.weights.sum() / rows.observed.sum(), rows.observed.sum()
    weights, within = rows.weights / unit, rows.within.sum(axis=0) / unit
    root, polynomial = np.sqrt(weights)[:, None], polynomial_of(rows.X, weights, degree, ridged)

    def weigh(columns):
        return root * without_constants(columns, rows.codes, weights, ratio)

    tail, targets, ridge = weigh(polynomial.columns(rows.X)), weigh(rows.Y), 0.0
    if ridged and degree == 1:
        about = weigh(rows.Y - np.average(rows.Y, axis=0, weights=weights))
        ridge = linear_evidence(tail[:, 1:], about, within, n_total - 1, n_total)[0]
        if not ridge:
            return prepare(rows, degree, ratio=ratio)
    basis, basis_rows = tail, tail[:0]
    if tail.size:
        stacked = np.vstack([tail, ridge_rows(tail.shape[1], ridge)])
        basis = qr(stacked, mode="economic", check_finite=False)[0]
        basis, basis_rows = basis[: len(tail)], basis[len(tail) :]
    projection = basis.T @ targets
    left = np.square(targets - basis @ projection).sum(axis=0) + within
    left += np.square(basis_rows @ projection).sum(axis=0)
    spread = np.sqrt(left / n_total)
    # What is left of a constant by rounding is not variation.
    spread[spread <= 1e-13 * np.abs(rows.Y).max(axis=0)] = 0.0
    held = Block(rows.X, root, tail, basis, targets, rows.codes)
    return Problem(
        rows, held, unit, n_total, within, ratio, polynomial, projection, spread, ridge, basis_rows
    )
