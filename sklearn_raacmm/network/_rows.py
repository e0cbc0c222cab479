"""Weighted data as the network's numerics want them: distinct rows, the polynomial projected out.

All that the numerics need of the rows is a sum over them, or a triangular factor, which blocks of
rows contribute to one after another. So they ask a `Problem` to `reduce` a function over blocks,
and do not know whether its rows are in memory or elsewhere (`_blocks`).

Where targets are known up to a constant of each group of rows, these are random: their variance is
`ratio` times that of the noise. With the weights w of the rows and the sum w_g of those of a group
the noise has the covariance ``W^-1 + ratio G``, where G is 1 within a group. Rows less
``1 - 1 / sqrt(1 + ratio w_g)`` times their group's weighted mean, times the root of their weights,
have independent noise of unit variance: that is done to all columns and targets alike. A ratio of 0
is no constants, an infinite one takes the whole mean out.
"""

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.linalg import qr

from sklearn_raacmm.network._linear import (
    Polynomial,
    linear_evidence,
    polynomial_of,
    ridge_rows,
    without_constants,
)
from sklearn_raacmm.utils import chunk_size, chunks

# Numbers in a block of rows: 4 MB stay in a core's cache while they are worked on. A block that is
# reduced to a triangle is to be higher than wide, as far as 64 MB allow.
SMALL_BLOCK, BLOCK = 2**19, 2**23
_LATER = np.empty((0, 0))


def block_rows(width):
    """Rows of a block that holds `width` numbers a row."""
    width = max(1, width)
    return chunk_size(max(SMALL_BLOCK // width, min(4 * width, BLOCK // width)))


class Block(NamedTuple):
    """Some rows of a problem."""

    X: np.ndarray  # (m, d) rows as given
    root: np.ndarray  # (m, 1) root of their weights
    tail: np.ndarray  # (m, p) polynomial times root
    basis: np.ndarray  # (m, p) the same, orthonormal over all rows
    targets: np.ndarray  # (m, q) targets times root
    part: slice | None  # which of the problem's rows, where it holds them
    codes: np.ndarray | None = None  # (m,) group of each row, where groups have constants
    ratio: float = 0.0

    def weigh(self, columns):
        """Columns at these rows, less groups' constants, times root; may overwrite them."""
        columns = without_constants(columns, self.codes, self.root[:, 0] ** 2, self.ratio)
        columns *= self.root
        return columns


class View(NamedTuple):
    """Targets as a selection wants to see them: about the polynomial, in units of their spread."""

    outputs: np.ndarray  # those that vary
    projection: np.ndarray  # (p, q) to project the polynomial out
    scale: np.ndarray  # (q,) by which they are divided
    within: np.ndarray  # (q,) sum of squares in these units that no model can explain
    total: np.ndarray  # (q,) sum of squares in these units, without the former

    def of(self, block):
        """Orthonormal basis of the polynomial, and targets."""
        targets = block.targets[:, self.outputs]
        return block.basis, (targets - block.basis @ self.projection) / self.scale


class Problem(NamedTuple):
    """Distinct rows in sorted order, with everything multiplied by the root of its weight."""

    X: np.ndarray  # (n, d) rows as given
    Y: np.ndarray  # (n, q) mean targets
    first: np.ndarray  # (n,) where each was first seen
    root: np.ndarray  # (n, 1) root of the weights, in units of `unit`
    unit: float  # mean weight of an observation
    n_total: float  # number of observations, the sum of the weights in these units
    within: np.ndarray  # (q,) sum of squares lost by taking means
    codes: np.ndarray | None  # (n,) group of each row, sorted, where groups have constants
    ratio: float = 0.0  # variance of these over that of an observation's noise
    # What `with_tail` adds.
    targets: np.ndarray = _LATER  # (n, q) targets times root
    tail: np.ndarray = _LATER  # (n, p) polynomial times root
    basis: np.ndarray = _LATER  # (n, p) orthonormal basis of it, together with `basis_rows`
    polynomial: Polynomial = Polynomial(None, _LATER, _LATER)
    projection: np.ndarray = _LATER  # (p, q) targets along the basis
    spread: np.ndarray = _LATER  # (q,) root mean square of targets about the tail, 0 for a constant
    tail_ridge: float = 0.0  # of the tail's linear part, in units of an observation
    basis_rows: np.ndarray = _LATER  # (p - 1, p) the ridge as further rows of the basis, if any
    tail_dof: float = 0.0  # effective number of the tail's columns
    # Where not all rows are held: `_blocks._Elsewhere`, of which those above are a sample.
    elsewhere: Any = None

    def view(self) -> View:
        """Targets that vary, about the polynomial and in units of their spread."""
        outputs = np.flatnonzero(self.spread > 0)
        scale = self.spread[outputs]
        within = self.within[outputs] / scale**2
        return View(outputs, self.projection[:, outputs], scale, within, self.n_total - within)

    @property
    def n_rows(self) -> int:
        return len(self.X) if self.elsewhere is None else self.elsewhere.n_rows

    @property
    def n_tail(self) -> int:
        return self.tail.shape[1]

    @property
    def tail_map(self) -> np.ndarray:
        """From coefficients of the polynomial's columns to those of (1, x), (p, d + 1)."""
        return self.polynomial.coefficients

    @property
    def tail_rows(self) -> np.ndarray:
        """The ridge as further rows of the polynomial."""
        return ridge_rows(self.n_tail, self.tail_ridge)

    @property
    def sample(self) -> Self:
        """Rows in memory that stand for all."""
        return self if self.elsewhere is None else self.elsewhere.sample

    def of_outputs(self, outputs: np.ndarray) -> Self:
        """The same rows with some of the outputs."""
        own = {name: getattr(self, name)[..., outputs] for name in ("within", "spread")}
        wide = ("Y", "targets", "projection")
        # In the order that they have where these outputs are all there are.
        own |= {name: np.ascontiguousarray(getattr(self, name)[:, outputs]) for name in wide}
        if self.elsewhere is not None:
            own["elsewhere"] = self.elsewhere.of_outputs(outputs)
        return self._replace(**own)

    def with_tail(self, degree: int, ridged: bool = False, ratio: float | None = None) -> Self:
        """The same rows with a polynomial of a degree, in place of the one they have.

        If `ridged`, its linear part has a ridge, found by the likelihood.
        """
        if self.elsewhere is not None:
            return self.elsewhere.with_tail(degree, ridged)
        ratio = self.ratio if ratio is None else ratio
        X, root, n_total = self.X, self.root, self.n_total
        weights = root[:, 0] ** 2
        polynomial = polynomial_of(X, weights, degree, ridged)

        def weigh(columns):
            return root * without_constants(columns, self.codes, weights, ratio)

        tail, targets, ridge = weigh(polynomial.columns(X)), weigh(self.Y), 0.0
        if ridged and degree == 1:
            about = weigh(self.Y - np.average(self.Y, axis=0, weights=weights))
            ridge = linear_evidence(tail[:, 1:], about, self.within, n_total - 1, n_total).ridge
            if not ridge:
                return self.with_tail(degree, ratio=ratio)
        basis = basis_rows = tail
        if tail.size:
            stacked = np.vstack([tail, ridge_rows(tail.shape[1], ridge)])
            basis = qr(stacked, mode="economic", check_finite=False)[0]
            basis, basis_rows = basis[: len(tail)], basis[len(tail) :]
        projection = basis.T @ targets
        left = np.square(targets - basis @ projection).sum(axis=0)
        if ridge:
            left += np.square(basis_rows @ projection).sum(axis=0)
        spread = np.sqrt((left + self.within) / n_total)
        # What is left of a constant by rounding is not variation.
        spread[spread <= 1e-13 * np.abs(self.Y).max(axis=0)] = 0.0
        return self._replace(
            ratio=ratio,
            targets=targets,
            tail=tail,
            basis=basis,
            polynomial=polynomial,
            projection=projection,
            spread=spread,
            tail_ridge=ridge,
            basis_rows=basis_rows,
            tail_dof=float(np.square(basis).sum()) if ridge else tail.shape[1],
        )

    def some(self, rows: np.ndarray) -> Self:
        """The problem of some rows, of which those left out say nothing."""
        names = ("X", "Y", "first", "root")
        arrays = {name: getattr(self, name)[rows] for name in names}
        n_total = np.square(arrays["root"]).sum()
        codes = None if self.codes is None else np.unique(self.codes[rows], return_inverse=True)[1]
        share = n_total / self.n_total
        bare = self._replace(**arrays, n_total=n_total, within=share * self.within, codes=codes)
        degree = -1 if not self.n_tail else int(self.n_tail > 1)
        return bare.with_tail(degree, bool(self.tail_ridge))

    def block(self, part: slice) -> Block:
        """Some rows, of whole groups."""
        codes = None if self.codes is None else self.codes[part] - self.codes[part][0]
        rows = {name: getattr(self, name)[part] for name in ("X", "root", "tail", "basis")}
        targets = self.targets[part]
        return Block(**rows, targets=targets, part=part, codes=codes, ratio=self.ratio)

    def reduce(self, function: Callable, combine: Callable, width: int) -> Any:
        """Combine the function of every block of rows, which holds `width` numbers a row."""
        if self.elsewhere is not None:
            return self.elsewhere.reduce(function, combine, width)
        parts = chunks(len(self.X), block_rows(width))
        if self.codes is not None:
            parts = _whole_groups(parts, self.codes)
        return reduce(combine, (function(self.block(part)) for part in parts))


def _whole_groups(parts, codes):
    """Slices of rows, each extended to the end of the group in which it ends."""
    start = 0
    for part in parts:
        stop = int(np.searchsorted(codes, codes[part.stop - 1], side="right"))
        if stop > start:
            yield slice(start, stop)
        start = max(start, stop)


class Merged(NamedTuple):
    """Distinct rows in sorted order: of their groups, if there are any, and then of X."""

    X: np.ndarray  # (n, d)
    first: np.ndarray  # (n,) where each was first seen
    weights: np.ndarray  # (n,) summed
    Y: np.ndarray  # (n, q) weighted means
    within: np.ndarray  # (n, q) weighted sum of squares about them
    observed: np.ndarray  # (n,) observations: rows of the same X that differ in Y
    codes: np.ndarray | None = None  # (n,) group of each row, from 0


def merge(X, Y, weights, within=None, count=None, codes=None):
    """Merge repeated rows, and drop rows without weight.

    The result depends on the weighted data alone: not on the order of the rows, and not on whether
    a row is repeated or weighted. A row that says again what another has said, target and all, adds
    weight but is not a further observation: that both have the same noise shows nothing of it. Rows
    of two groups (`codes`) are not merged. `within` (n, q) and `count` (n,) are of a merge before.
    """
    kept = np.flatnonzero(weights > 0)
    X, Y, weights = X[kept] + 0.0, Y[kept], weights[kept]  # adding 0 makes -0.0 and 0.0 one value
    keys = X if codes is None else np.column_stack([codes[kept], X])
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
        observed = np.ones(n)
        several = np.flatnonzero((np.bincount(inverse, minlength=n) > 1)[inverse])
        if len(several):
            pairs = np.unique(np.column_stack([inverse[several], Y[several]]), axis=0)[:, 0]
            observed = np.maximum(np.bincount(pairs.astype(np.intp), minlength=n), 1.0)
    else:
        alike = np.all(within == 0.0, axis=1)
        observed = np.where(alike, 1.0, summed(count[kept]))
    if codes is not None:
        codes = np.unique(codes[kept][first], return_inverse=True)[1]  # without groups of weight 0
    return Merged(distinct, kept[first], total, mean, within, observed, codes)


def prepare(merged, degree, ridged=False):
    """Set up the polynomial of merged rows, with a ridge for its linear part if `ridged`."""
    X, first, weights, Y, within, count, codes = merged
    unit = weights.sum() / count.sum()
    weights, within = weights / unit, within.sum(axis=0) / unit
    root = np.sqrt(weights)[:, None]
    bare = Problem(X, Y, first, root, unit, count.sum(), within, codes)
    return bare.with_tail(degree, ridged)
