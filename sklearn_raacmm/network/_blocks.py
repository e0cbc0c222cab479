"""Rows that are read block by block: too many to be sorted, or in the memory of other machines.

A first pass draws a sample of distinct rows, by a hash of the rows' content: it depends neither on
their order nor on the blocks nor on repeats. All else is a sum over blocks, or a triangular factor.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import partial, reduce

import numpy as np
from scipy.linalg import solve_triangular
from sklearn.utils import check_array

from sklearn_raacmm.network._rows import Block, block_rows, merge
from sklearn_raacmm.utils import chunks, floats, one_blas_thread

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
    """Chunks of a dask array, and of targets and weights that may be arrays in memory.

    Each is worked on where it is.
    """

    def __init__(self, X, y, sample_weight):
        import dask.array as da

        if X.ndim != 2 or X.shape[1] == 0 or not np.all(np.isfinite(X.shape)):
            raise ValueError(
                "X must be of shape (n_samples, n_features) with chunks of known size; got "
                f"{X.shape}. X.compute_chunk_sizes() finds them."
            )
        n, self.rows = X.shape[0], X.chunks[0]
        sample_weight = da.ones(n, chunks=self.rows) if sample_weight is None else sample_weight
        arrays = [X.rechunk({1: -1})]
        for name, given, dimensions in (("y", y, (1, 2)), ("sample_weight", sample_weight, (1,))):
            array = da.asarray(given)
            if array.ndim not in dimensions or array.shape[0] != n:
                raise ValueError(f"{name} has shape {array.shape}, but X has {n} rows.")
            array = array[:, None] if name == "y" and array.ndim == 1 else array
            arrays.append(array.rechunk((self.rows, -1)[: array.ndim]))
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
    arrays = []
    for name, given in (("X", X), ("y", Y), ("sample_weight", weights)):
        weighs = name == "sample_weight"
        options = {"ensure_2d": not weighs, "ensure_non_negative": weighs, "input_name": name}
        array = check_array(given, dtype=np.float64, **options)
        arrays.append(floats(name, array, finite=True))
    X, Y, weights = arrays
    return ArrayChunks(X, Y, weights, start).reduce(function, combine, width)


@one_blas_thread
def _combined(combine, results):
    return reduce(combine, results)


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
    return sample.some(np.sort(np.argsort(_hash(sample.X, seed), kind="stable")[:size])), False


def summarise(X, Y, weights, start, seed, size):
    """Number of rows of positive weight, their weight, a sample, and whether it holds all rows."""
    sample = merge(X, Y, weights)
    sample, complete = _cut(sample._replace(first=start + sample.first), seed, size)
    return int(np.sum(weights > 0)), weights.sum(), sample, complete


def _join(one, other, seed, size):
    both = [np.concatenate(pair) for pair in zip(one[2][:6], other[2][:6], strict=True)]
    joined = merge(*(both[i] for i in (0, 1, 3, 4, 5)))
    sample, complete = _cut(joined._replace(first=both[2][joined.first]), seed, size)
    return one[0] + other[0], one[1] + other[1], sample, complete and one[3] and other[3]


def draw_rows(chunks, n_features, size, seed):
    """Number and weight of all rows, at most `size` distinct ones, and whether these are all."""
    options = {"seed": np.uint64(seed), "size": size}
    join = partial(_join, **options)
    summary = chunks.reduce(partial(summarise, **options), join, 4 * n_features)
    if not summary[0]:
        raise ValueError("Sample weights must contain at least one non-zero number.")
    return summary


def extend(sample, chunks, n_rows, weight, outputs):
    """The problem of all rows, of which a sample has its polynomial, and its ridge, already."""
    p, q, unit = sample.n_tail, len(outputs), weight / n_rows

    def of_read(function, combine, width, tail_root=None):
        def of_chunk(X, Y, weights, start):
            kept = weights > 0
            X, root = X[kept] + 0.0, np.sqrt(weights[kept] / unit)[:, None]
            basis = tail = root * sample.polynomial.columns(X)
            if tail.size and tail_root is not None:
                basis = solve_triangular(tail_root, tail.T, trans="T", check_finite=False).T
            return function(Block(X, root, tail, basis, root * Y[kept][:, outputs]))

        return chunks.reduce(of_chunk, combine, width)

    whole = sample._replace(unit=unit, n_total=n_rows, within=np.zeros(q), of_read=of_read)
    R = whole.triangle(lambda block: np.hstack([block.tail, block.targets]), p + q)
    basis_rows = solve_triangular(R[:p, :p], sample.tail_rows.T, trans="T").T if p else R[:0, :p]
    spread = np.sqrt(np.square(R[p:, p:]).sum(axis=0) / n_rows)
    # What is left of a constant by rounding is not variation.
    spread[spread <= 1e-13 * np.sqrt(np.square(R[:, p:]).sum(axis=0) / n_rows)] = 0.0
    of_read = partial(of_read, tail_root=R[:p, :p])
    return whole._replace(
        projection=R[:p, p:], spread=spread, basis_rows=basis_rows, of_read=of_read
    )
