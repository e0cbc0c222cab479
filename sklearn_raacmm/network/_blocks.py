"""Rows that are read block by block: too many to be sorted, or in the memory of other machines.

A first pass draws a sample of distinct rows, by a hash of the rows' content, so that it depends
neither on their order nor on how they are split into blocks nor on repeats. Everything else is a
sum over blocks, or a triangular factor of them, like that of rows in memory.
"""

from functools import partial, reduce
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from sklearn.utils import check_array

from sklearn_raacmm.network._least_squares import stack_triangles, triangle_of_all
from sklearn_raacmm.network._rows import (
    Block,
    Merged,
    Problem,
    block_rows,
    merge,
    prepare,
)
from sklearn_raacmm.utils import chunks, floats, one_blas_thread

# Rows looked at together.
CHUNK_ROWS = 2**16
# Results that are combined in one task.
_FAN_IN = 8
_UNKNOWN = np.empty((0, 0))


class ArrayChunks:
    """Blocks of rows of arrays, in memory or mapped from a file; `start` numbers the first row."""

    def __init__(self, X, Y, weights, start=0):
        self.X, self.Y, self.weights, self.start = X, Y, weights, start

    def __len__(self):
        return len(self.X)

    def reduce(self, function, combine, width):
        """Combine function(X, Y, weights, start) of blocks, which holds `width` numbers a row."""
        size = min(block_rows(width), CHUNK_ROWS)
        parts = chunks(len(self.X), size)
        rows = ((*(np.asarray(a[p]) for a in (self.X, self.Y, self.weights)), p) for p in parts)
        return reduce(combine, (function(X, Y, w, self.start + p.start) for X, Y, w, p in rows))


class DaskChunks:
    """Chunks of dask arrays with the same chunks of rows, each worked on where it is."""

    def __init__(self, X, Y, weights):
        self.rows = X.chunks[0]
        arrays = (X.rechunk({1: -1}), Y.rechunk({0: self.rows, 1: -1}), weights.rechunk(self.rows))
        self.parts = list(zip(*(a.to_delayed().ravel() for a in arrays), strict=True))

    def __len__(self):
        return sum(self.rows)

    def reduce(self, function, combine, width):
        """As `ArrayChunks.reduce`; results are combined by a tree of tasks."""
        from dask.delayed import delayed

        starts = np.cumsum([0, *self.rows[:-1]])
        results = [
            delayed(_of_chunk, pure=False)(*part, int(start), function, combine, width)
            for part, start, size in zip(self.parts, starts, self.rows, strict=True)
            if size
        ]
        while len(results) > 1:
            results = [
                delayed(_combined, pure=False)(combine, results[i : i + _FAN_IN])
                for i in range(0, len(results), _FAN_IN)
            ]
        return results[0].compute()


@one_blas_thread
def _of_chunk(X, Y, weights, start, function, combine, width):
    X = check_array(X, dtype=np.float64, input_name="X")
    Y = check_array(Y, dtype=np.float64, input_name="y")
    weights = check_array(
        weights,
        dtype=np.float64,
        ensure_2d=False,
        ensure_non_negative=True,
        input_name="sample_weight",
    )
    for name, array in (("X", X), ("y", Y), ("sample_weight", weights)):
        floats(name, array, finite=True)
    return ArrayChunks(X, Y, weights, start).reduce(function, combine, width)


@one_blas_thread
def _combined(combine, results):
    return reduce(combine, results)


def is_dask(X):
    """Whether X is a dask array, which is not imported for the question."""
    return type(X).__module__.startswith("dask.array") and hasattr(X, "to_delayed")


def dask_chunks(X, y, sample_weight):
    """Chunks of a dask array, and of targets and weights that may be arrays in memory."""
    import dask.array as da

    if X.ndim != 2 or X.shape[1] == 0 or not np.all(np.isfinite(X.shape)):
        raise ValueError(
            f"X must be of shape (n_samples, n_features) with chunks of known size; got {X.shape}. "
            "X.compute_chunk_sizes() finds them."
        )
    n, rows = X.shape[0], X.chunks[0]
    sample_weight = da.ones(n, chunks=rows) if sample_weight is None else sample_weight
    arrays = []
    for name, given, dimensions in (("y", y, (1, 2)), ("sample_weight", sample_weight, (1,))):
        array = da.asarray(given)
        if array.ndim not in dimensions or array.shape[0] != n:
            raise ValueError(f"{name} has shape {array.shape}, but X has {n} rows.")
        arrays.append(array)
    y, sample_weight = arrays
    return DaskChunks(X, y[:, None] if y.ndim == 1 else y, sample_weight)


class _Summary(NamedTuple):
    """What a first pass over the rows tells."""

    n_rows: int  # of positive weight
    weight: float
    sample: Merged  # of rows with the smallest hashes
    complete: bool  # whether the sample holds all rows


def _hash(X, seed):
    """A number for each row that depends on its content only (the finaliser of splitmix64)."""
    h = np.full(len(X), seed, dtype=np.uint64)
    for column in np.ascontiguousarray(X.T).view(np.uint64):
        h = (h ^ column) + np.uint64(0x9E3779B97F4A7C15)
        h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        h ^= h >> np.uint64(31)
    return h


def _cut(sample, seed, size):
    """The rows of the smallest hashes, still sorted, and whether these are all."""
    if len(sample.X) <= size:
        return sample, True
    kept = np.sort(np.argsort(_hash(sample.X, seed), kind="stable")[:size])
    return Merged(*(a[kept] for a in sample[:6])), False


def _summarise(X, Y, weights, start, seed, size):
    sample = merge(X, Y, weights)
    sample, complete = _cut(sample._replace(first=start + sample.first), seed, size)
    return _Summary(int(np.sum(weights > 0)), weights.sum(), sample, complete)


def _join(one, other, seed, size):
    parts = zip(one.sample[:6], other.sample[:6], strict=True)
    both = Merged(*(np.concatenate(pair) for pair in parts))
    joined = merge(both.X, both.Y, both.weights, both.within, both.observed)
    sample, complete = _cut(joined._replace(first=both.first[joined.first]), seed, size)
    complete = complete and one.complete and other.complete
    return _Summary(one.n_rows + other.n_rows, one.weight + other.weight, sample, complete)


class _Elsewhere(NamedTuple):
    """Rows of a problem that are not held, and are not merged where they are repeated."""

    sample: Problem  # distinct rows, a part of all
    chunks: ArrayChunks | DaskChunks
    n_rows: int
    unit: float  # of weights
    outputs: np.ndarray  # the targets that the problem has
    root: np.ndarray  # (p, p) triangular factor of the polynomial on all rows; empty until known

    def of_outputs(self, outputs):
        return self._replace(sample=self.sample.of_outputs(outputs), outputs=self.outputs[outputs])

    def with_tail(self, degree, ridged):
        sample = self.sample.with_tail(degree, ridged)
        return _of_all_rows(self._replace(sample=sample, root=_UNKNOWN))

    def reduce(self, function, combine, width):
        """As `Problem.reduce`."""
        return self.chunks.reduce(partial(self._on_block, function), combine, width)

    def _on_block(self, function, X, Y, weights, start):
        kept = weights > 0
        X, root = X[kept] + 0.0, np.sqrt(weights[kept] / self.unit)[:, None]
        tail = root * self.sample.polynomial.columns(X)
        basis = tail
        if tail.size and self.root.size:
            basis = solve_triangular(self.root, tail.T, trans="T", check_finite=False).T
        return function(Block(X, root, tail, basis, root * Y[kept][:, self.outputs], None))


def chunked_problem(chunks, n_features, degree, size, seed, ridged=False):
    """Set up a problem by one pass over the rows.

    `size` distinct rows are held, drawn by a hash with a seed. If `ridged`, the linear part of the
    polynomial has a ridge: that of the sample.
    """
    options = {"seed": np.uint64(seed), "size": size}
    width = 4 * n_features
    summary = chunks.reduce(partial(_summarise, **options), partial(_join, **options), width)
    if not summary.n_rows:
        raise ValueError("Sample weights must contain at least one non-zero number.")
    sample = prepare(summary.sample, degree, ridged)
    if summary.complete:
        return sample
    n, outputs = summary.n_rows, np.arange(len(sample.spread))
    return _of_all_rows(_Elsewhere(sample, chunks, n, summary.weight / n, outputs, _UNKNOWN))


def _of_all_rows(rows):
    """The problem of all rows, of which a sample has its polynomial already."""
    sample, p, q = rows.sample, rows.sample.n_tail, len(rows.outputs)
    R = triangle_of_all(rows, _tail_and_targets, p + q)
    if sample.tail_ridge:
        R = stack_triangles(R, np.pad(sample.tail_rows, ((0, 0), (0, q))))
    basis_rows = solve_triangular(R[:p, :p], sample.tail_rows.T, trans="T").T if p else R[:0, :p]
    spread = np.sqrt(np.square(R[p:, p:]).sum(axis=0) / rows.n_rows)
    # What is left of a constant by rounding is not variation.
    spread[spread <= 1e-13 * np.sqrt(np.square(R[:, p:]).sum(axis=0) / rows.n_rows)] = 0.0
    return sample._replace(
        unit=rows.unit,
        n_total=rows.n_rows,
        within=np.zeros(q),
        projection=R[:p, p:],
        spread=spread,
        basis_rows=basis_rows,
        tail_dof=p - np.square(basis_rows).sum(),
        elsewhere=rows._replace(root=R[:p, :p]),
    )


def _tail_and_targets(block):
    return np.hstack([block.tail, block.targets])
