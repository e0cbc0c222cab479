"""Rows that are read block by block: too many to be sorted, or in the memory of other machines.

One pass tells what the numerics need beforehand: weighted moments of features and targets, and a
sample of distinct rows. The sample is drawn by a hash of the rows' content, so that it depends
neither on their order nor on how they are split into blocks nor on repeats. Everything else is a
sum over blocks, like that of rows in memory.
"""

from functools import partial, reduce
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from sklearn.utils import check_array

from sklearn_raacmm.network._linear import independent_features, ridge_rows, tail_coefficients
from sklearn_raacmm.network._rows import (
    Block,
    Merged,
    Problem,
    block_rows,
    merge,
    prepare,
)
from sklearn_raacmm.utils import chunks, one_blas_thread, refuse_huge

# Rows looked at together.
CHUNK_ROWS = 2**16
# Results that are combined in one task.
_FAN_IN = 8


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
        refuse_huge(name, array)
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
    """What one pass over the rows tells, with features and targets side by side."""

    n_rows: int  # of positive weight
    weight: float
    mean: np.ndarray  # (d + q,)
    scatter: np.ndarray  # (d + q, d + q) weighted sum of products about the mean
    largest: np.ndarray  # (d + q,) absolute value
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
    kept = np.flatnonzero(weights > 0)
    X, Y, weights = X[kept] + 0.0, Y[kept], weights[kept]
    V = np.hstack([X, Y])
    total = weights.sum()
    mean = weights @ V / total if len(V) else np.zeros(V.shape[1])
    about = V - mean
    scatter = (weights[:, None] * about).T @ about
    largest = np.abs(V).max(axis=0, initial=0.0)
    sample = merge(X, Y, weights)
    sample, complete = _cut(sample._replace(first=start + kept[sample.first]), seed, size)
    return _Summary(len(X), total, mean, scatter, largest, sample, complete)


def _join(one, other, seed, size):
    """Summary of two blocks (Chan, Golub, LeVeque 1983)."""
    weight = one.weight + other.weight
    share = other.weight / weight if weight else 0.0
    step = other.mean - one.mean
    scatter = one.scatter + other.scatter + one.weight * share * np.outer(step, step)
    parts = zip(one.sample[:6], other.sample[:6], strict=True)
    both = Merged(*(np.concatenate(pair) for pair in parts))
    joined = merge(both.X, both.Y, both.weights, both.within, both.observed)
    joined = joined._replace(first=both.first[joined.first])
    sample, complete = _cut(joined, seed, size)
    return _Summary(
        one.n_rows + other.n_rows,
        weight,
        one.mean + share * step,
        scatter,
        np.maximum(one.largest, other.largest),
        sample,
        complete and one.complete and other.complete,
    )


class _Tail(NamedTuple):
    """Polynomial of any rows, and the targets that a problem has."""

    used: np.ndarray | None  # features of the linear part; None for no polynomial at all
    center: np.ndarray
    scale: np.ndarray
    root: np.ndarray  # (p, p) triangular factor of the polynomial on all rows
    unit: float  # of weights
    outputs: np.ndarray

    def block(self, X, Y, weights):
        kept = weights > 0
        X, root = X[kept] + 0.0, np.sqrt(weights[kept] / self.unit)[:, None]
        Y = Y[kept][:, self.outputs]
        if self.used is None:
            tail = np.empty((len(X), 0))
        else:
            linear = (X[:, self.used] - self.center[self.used]) / self.scale[self.used]
            tail = root * np.column_stack([np.ones(len(X)), linear])
        basis = tail
        if tail.size:
            basis = solve_triangular(self.root, tail.T, trans="T", check_finite=False).T
        return Block(X, root, tail, basis, root * Y, None)


def _on_block(X, Y, weights, start, function, tail):
    return function(tail.block(X, Y, weights))


class _Elsewhere(NamedTuple):
    """Rows of a problem that are not held, and are not merged where they are repeated."""

    sample: Problem  # distinct rows, a part of all
    chunks: ArrayChunks | DaskChunks
    summary: _Summary
    tail: _Tail

    @property
    def n_rows(self):
        return self.summary.n_rows

    def of_outputs(self, outputs):
        tail = self.tail._replace(outputs=self.tail.outputs[outputs])
        return self._replace(sample=self.sample.of_outputs(outputs), tail=tail)

    def with_tail(self, degree, ridged):
        sample = self.sample.with_tail(degree, ridged)
        return _problem_of(self.chunks, self.summary, sample, degree, self.tail.outputs)

    def reduce(self, function, combine, width):
        of_block = partial(_on_block, function=function, tail=self.tail)
        return self.chunks.reduce(of_block, combine, width)


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
    outputs = np.arange(len(summary.mean) - n_features)
    return _problem_of(chunks, summary, sample, degree, outputs)


def _problem_of(chunks, summary, sample, degree, outputs):
    """The problem of some outputs, of which a sample has its polynomial already."""
    d, weight, unit = sample.X.shape[1], summary.n_rows, summary.weight / summary.n_rows
    at = np.append(np.arange(d), d + outputs)
    mean, largest = summary.mean[at], summary.largest[at]
    scatter = summary.scatter[np.ix_(at, at)] / unit
    center, scale = mean[:d], np.sqrt(scatter.diagonal()[:d] / weight)
    tail_map, used, root = np.empty((0, d + 1)), None, np.empty((0, 0))
    projection = np.empty((0, len(outputs)))
    total = scatter.diagonal()[d:] + weight * mean[d:] ** 2
    if degree >= 0:
        used = np.empty(0, dtype=int)
        if degree == 1:
            used = independent_features(sample.X, center, scale, largest[:d])
        tail_map = tail_coefficients(d, used, center, scale)
        root = np.zeros((1 + len(used),) * 2)
        root[0, 0] = np.sqrt(weight)
        correlation = scatter[np.ix_(used, used)] / np.outer(scale[used], scale[used])
        correlation[np.diag_indices(len(used))] += sample.tail_ridge
        root[1:, 1:] = cholesky(correlation) if len(used) else correlation
        along = scatter[used, d:] / scale[used, None]
        if len(used):
            along = solve_triangular(root[1:, 1:], along, trans="T")
        projection = np.vstack([np.sqrt(weight) * mean[None, d:], along])
        total = scatter.diagonal()[d:] - np.square(along).sum(axis=0)
    spread = np.sqrt(np.maximum(total, 0.0) / weight)
    # What is left of a constant by rounding is not variation.
    spread[spread <= 1e-13 * largest[d:]] = 0.0
    basis_rows = ridge_rows(len(root), sample.tail_ridge)
    basis_rows = solve_triangular(root, basis_rows.T, trans="T").T if len(root) else basis_rows
    return sample._replace(
        unit=unit,
        n_total=weight,
        within=np.zeros(len(outputs)),
        tail_map=tail_map,
        projection=projection,
        spread=spread,
        basis_rows=basis_rows,
        tail_dof=len(root) - np.square(basis_rows).sum(),
        elsewhere=_Elsewhere(
            sample, chunks, summary, _Tail(used, center, scale, root, unit, outputs)
        ),
    )
