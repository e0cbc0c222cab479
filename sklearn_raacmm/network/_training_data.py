"""Weighted data as the network's numerics want them: distinct rows, the tail projected out.

All that the numerics need of the rows is a sum over them, or a triangular factor, which blocks of
rows contribute to one after another. So they ask a problem to `reduce` a function over blocks, and
do not know whether the rows are in memory (`Problem`) or elsewhere (`_large_data.ChunkedProblem`).
"""

from functools import reduce
from typing import NamedTuple

import numpy as np
from scipy.linalg import qr

from sklearn_raacmm.network._group_noise import whiteners
from sklearn_raacmm.network._polynomial_tail import linear_ridge, ridge_rows, tail_columns
from sklearn_raacmm.utils import centred, chunk_size, chunks

# Numbers in a block of rows: 4 MB stay in a core's cache while they are worked on. A block that is
# reduced to a triangle is to be higher than wide, as far as 64 MB allow.
SMALL_BLOCK, BLOCK = 2**19, 2**23


def block_rows(width):
    """Rows of a block that holds `width` numbers a row."""
    width = max(1, width)
    return chunk_size(max(SMALL_BLOCK // width, min(4 * width, BLOCK // width)))


class Block(NamedTuple):
    """Some rows of a problem."""

    X: np.ndarray  # (m, d) rows as given
    root: np.ndarray  # (m, 1) root of their weights
    tail: np.ndarray  # (m, p) polynomial tail times root
    basis: np.ndarray  # (m, p) the same, orthonormal over all rows
    targets: np.ndarray  # (m, q) targets times root
    part: slice  # which of the problem's rows, where it holds them
    codes: np.ndarray | None = None  # (m,) group of each row, where groups have offsets
    whiteners: list | None = None  # matrix of each of these groups, see `with_group_noise`

    def weigh(self, columns):
        """Columns at these rows, less the offsets of groups, times root; may overwrite them."""
        if self.whiteners is not None:
            return _whitened(self.whiteners, columns)
        columns = centred(columns, self.codes, self.root[:, 0] ** 2)
        columns *= self.root
        return columns


class View(NamedTuple):
    """Targets as a selection wants to see them."""

    outputs: np.ndarray  # those that vary
    projection: np.ndarray | None  # (p, q) to project the tail out; None to leave it where it is
    scale: np.ndarray  # (q,) by which they are divided
    within: np.ndarray  # (q,) sum of squares in these units that no model can explain
    total: np.ndarray  # (q,) sum of squares in these units, without the former

    def of(self, block):
        """Orthonormal basis of the tail, and targets."""
        targets = block.targets[:, self.outputs]
        if self.projection is None:
            return block.basis[:, :0], targets / self.scale
        return block.basis, (targets - block.basis @ self.projection) / self.scale


def view_of(problem, centred=True):
    """Targets that vary, about the tail and in units of their spread; or as they are."""
    outputs = np.flatnonzero(problem.spread > 0)
    scale = problem.spread[outputs] if centred else np.ones(len(outputs))
    within = problem.within[outputs] / scale**2
    total = problem.n_total * (problem.spread[outputs] / scale) ** 2 - within
    projection = problem.projection[:, outputs]
    if not centred:
        total += np.square(projection).sum(axis=0)
    return View(outputs, projection if centred else None, scale, within, total)


class Problem(NamedTuple):
    """Distinct rows in sorted order, with everything multiplied by the root of its weight.

    Where groups of rows have unknown offsets, everything is taken less its weighted mean over the
    group, before it is multiplied: for a linear model this is the same as to fit an offset to each
    (the theorem of Frisch and Waugh).
    """

    X: np.ndarray  # (n, d) rows as given
    first: np.ndarray  # (n,) where each was first seen
    root: np.ndarray  # (n, 1) root of the weights, in units of `unit`
    unit: float  # mean weight of an observation
    n_total: float  # number of observations, the sum of the weights in these units, less offsets
    targets: np.ndarray  # (n, q) mean targets times root
    within: np.ndarray  # (q,) sum of squares lost by taking means
    codes: np.ndarray | None  # (n,) group of each row, sorted, where groups have offsets
    # What `with_tail` adds.
    tail: np.ndarray = None  # (n, p) polynomial tail times root
    basis: np.ndarray = None  # (n, p) orthonormal basis of it, together with `basis_rows`
    tail_map: np.ndarray = None  # (p, d + 1) its coefficients to those of (1, x)
    projection: np.ndarray = None  # (p, q) targets along the basis
    spread: np.ndarray = None  # (q,) root mean square of targets about the tail, 0 for a constant
    tail_ridge: float = 0.0  # of the tail's linear part, in units of an observation
    basis_rows: np.ndarray = None  # (p - 1, p) the ridge as further rows of the basis, if any
    tail_dof: float = 0.0  # effective number of the tail's columns
    # What `with_group_noise` adds: a matrix of each group, in place of centring and root.
    whiteners: list | None = None

    view = view_of

    @property
    def n_rows(self):
        return len(self.X)

    @property
    def tail_rows(self):
        """The ridge as further rows of the tail."""
        return ridge_rows(self.n_tail, self.tail_ridge, self.codes is None)

    @property
    def n_tail(self):
        return self.tail.shape[1]

    @property
    def sample(self):
        """Rows that stand for all: all."""
        return self

    def of_outputs(self, outputs):
        """The same rows with some of the outputs."""
        own = {name: getattr(self, name)[..., outputs] for name in ("within", "spread")}
        wide = {name: getattr(self, name)[:, outputs] for name in ("targets", "projection")}
        # In the order that they have where these outputs are all there are.
        return self._replace(**own, **{k: np.ascontiguousarray(v) for k, v in wide.items()})

    def block(self, part):
        """Some rows."""
        arrays = self.X, self.root, self.tail, self.basis, self.targets
        codes, whiteners = self.codes, self.whiteners
        if codes is not None:
            codes = codes[part]
            if whiteners is not None:
                whiteners = whiteners[codes[0] : codes[-1] + 1]
            codes = codes - codes[0]
        return Block(*(a[part] for a in arrays), part, codes, whiteners)

    def reduce(self, function, combine, width):
        """Combine the function of every block of rows, one after another.

        Parameters
        ----------
        function : callable
            Of a `Block`.
        combine : callable
            Of two results.
        width : int
            Numbers a row that the function holds in memory.
        """
        parts = chunks(len(self.X), block_rows(width))
        if self.codes is not None:
            parts = _whole_groups(parts, self.codes)
        return reduce(combine, (function(self.block(part)) for part in parts))


def _whitened(whiteners, columns):
    """The rows of each group multiplied by its matrix."""
    borders = np.cumsum([len(T) for T in whiteners])[:-1]
    parts = zip(whiteners, np.split(columns, borders), strict=True)
    return np.vstack([T @ rows for T, rows in parts])


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
    count: np.ndarray  # (n,) observations: rows of the same X that differ in Y
    codes: np.ndarray | None = None  # (n,) group of each row, from 0


def merge(X, Y, weights, within=None, count=None, codes=None):
    """Merge repeated rows, and drop rows without weight.

    The result depends on the weighted data alone: not on the order of the rows, and not on whether
    a row is repeated or weighted. A row that says again what another has said, target and all, adds
    weight but is not a further observation: that both have the same noise shows nothing of it.

    Parameters
    ----------
    X : ndarray of shape (n_samples, d)
    Y : ndarray of shape (n_samples, q)
    weights : ndarray of shape (n_samples,)
        Not negative.
    within : ndarray of shape (n_samples, q), optional
        Sum of squares lost when rows were merged before.
    count : ndarray of shape (n_samples,), optional
        Observations that were merged into a row before.
    codes : ndarray of shape (n_samples,), optional
        Group of each row. Rows of two groups are not merged.

    Returns
    -------
    Merged
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
    """Set up the polynomial tail.

    Parameters
    ----------
    merged : Merged
    degree : {-1, 0, 1}
    ridged : bool
        Whether the linear part has a ridge, found by the likelihood.

    Returns
    -------
    Problem
    """
    X, first, weights, Y, within, count, codes = merged
    unit = weights.sum() / count.sum()
    n_total = count.sum() - (0 if codes is None else codes.max() + 1)
    weights, within = weights / unit, within.sum(axis=0) / unit
    root = np.sqrt(weights)[:, None]
    targets = root * centred(Y, codes, weights)
    bare = Problem(X, first, root, unit, n_total, targets, within, codes)
    return with_tail(bare, degree, ridged)


def with_tail(problem, degree, ridged=False):
    """The same rows with a polynomial tail, in place of the one they have.

    Parameters
    ----------
    problem : Problem
    degree : {-1, 0, 1}
    ridged : bool or float
        Whether the linear part has a ridge, found by the likelihood; or this ridge, in units of an
        observation.

    Returns
    -------
    Problem
    """
    X, root, targets, within, codes = (
        getattr(problem, name) for name in ("X", "root", "targets", "within", "codes")
    )
    weights, Y, n_total = root[:, 0] ** 2, targets / root, problem.n_total
    tail, tail_map = tail_columns(X, weights, degree, codes, bool(ridged))
    tail = root * tail
    ridge = 0.0 if isinstance(ridged, bool) else ridged
    if ridged is True and degree == 1:
        constant = int(codes is None)
        about = targets - root * np.average(Y, axis=0, weights=weights)
        ridge = linear_ridge(tail[:, constant:], about, within, n_total - constant)
        if not ridge:
            return with_tail(problem, degree)
    return _projected(problem._replace(tail=tail, tail_map=tail_map, tail_ridge=ridge))


def _projected(problem):
    """The problem with what follows from its tail and targets: a basis, and the spread about it."""
    tail, targets, ridge = problem.tail, problem.targets, problem.tail_ridge
    basis = basis_rows = tail
    if tail.size:
        stacked = np.vstack([tail, problem.tail_rows])
        basis = qr(stacked, mode="economic", check_finite=False)[0]
        basis, basis_rows = basis[: len(tail)], basis[len(tail) :]
    projection = basis.T @ targets
    about = targets - basis @ projection
    left = np.square(about).sum(axis=0)
    if ridge:
        left += np.square(basis_rows @ projection).sum(axis=0)
    spread = np.sqrt((left + problem.within) / problem.n_total)
    # What is left of a constant by rounding is not variation.
    spread[spread <= 1e-13 * np.abs(targets / problem.root).max(axis=0)] = 0.0
    return problem._replace(
        basis=basis,
        projection=projection,
        spread=spread,
        basis_rows=basis_rows,
        tail_dof=float(np.square(basis).sum()) if ridge else tail.shape[1],
    )


def with_group_noise(problem, alpha, functions, share):
    """The problem where a share of the noise is a smooth function of each group's own.

    Its rows are multiplied by matrices that make the noise of a group independent, so that the
    ordinary least squares of all that follows are generalised ones.

    Parameters
    ----------
    problem : Problem
        Where groups have offsets.
    alpha : ndarray of shape (q,)
        Ridges of all noise of an observation.
    functions : RadialFunctions
    share : float
        Below 1.

    Returns
    -------
    problem : Problem
    alpha : ndarray of shape (q,)
        Ridges of the noise of a deviation: the constant of a group's own function is no noise.
    """
    kernel, shift, length_scale = functions
    Z, weights = (problem.X - shift) / length_scale, problem.root[:, 0] ** 2
    matrices, variance = whiteners(Z, kernel, weights, problem.codes, share)
    problem = problem._replace(
        targets=_whitened(matrices, problem.targets / problem.root),
        tail=_whitened(matrices, problem.tail / problem.root),
        within=problem.within * variance / (1 - share),
        whiteners=matrices,
    )
    return _projected(problem), alpha * variance
