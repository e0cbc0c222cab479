"""Weighted rows: distinct ones, and those too many to be sorted, or in other machines' memory.

Of the latter a first pass draws a sample of distinct rows, by a hash of the rows' content: it
depends neither on their order nor on the blocks nor on repeats. All else that the numerics need of
them is a sum over blocks, or a triangular factor.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import reduce
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_array

from sklearn_raacmm.utils import Groups, chunks, floats, one_blas_thread

# Data of more rows are read in blocks, and repeated rows not merged. Distinct rows held of these.
IN_MEMORY_ROWS, HELD_ROWS = 100_000, 10_000
# Numbers in a block of rows: 4 MB stay in a core's cache while they are worked on. A block that is
# reduced to a triangle is to be higher than wide, as far as 64 MB allow.
SMALL_BLOCK, BLOCK = 2**19, 2**23
# Results that are combined in one task.
_FAN_IN = 8


class Rows(NamedTuple):
    """Rows of data, in memory or mapped from a file.

    Once `merged` they are distinct, and sorted: by their groups, if there are any, and then by X.
    """

    X: np.ndarray  # (n, d)
    Y: np.ndarray  # (n, q) targets, where rows were merged weighted means of them
    weights: np.ndarray  # (n,) summed
    codes: np.ndarray | None = None  # (n,) group of each row, where groups have constants
    # Where rows were merged: where each was first seen (n,); the weighted sums of squares (n, q) of
    # the targets about these means; and observations (n,), rows of the same X that differ in Y.
    first: np.ndarray | None = None
    within: Any = None
    observed: np.ndarray | None = None

    @property
    def n_rows(self):
        return len(self.X)

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

    @property
    def groups(self):
        """Slices of the rows that are left out together."""
        codes = np.arange(self.n_rows) if self.codes is None else self.codes
        ends = [0, *(np.flatnonzero(np.diff(codes)) + 1), len(codes)]
        return [slice(*pair) for pair in pairwise(ends)]

    def some(self, kept: np.ndarray | slice) -> "Rows":
        """Some of them."""
        arrays: Any = (None if a is None else np.asarray(a[kept]) for a in self)
        rows = Rows(*arrays)
        if rows.codes is None:
            return rows
        return rows._replace(codes=np.unique(rows.codes, return_inverse=True)[1])

    def of_outputs(self, outputs: np.ndarray) -> "Rows":
        """The same rows, merged ones, with some of the outputs."""
        # In the order of memory that they have where these outputs are all there are.
        arrays: Any = self.Y, self.within
        Y, within = (np.ascontiguousarray(a[:, outputs]) for a in arrays)
        return self._replace(Y=Y, within=within)

    def merged(self, start: int = 0) -> "Rows":
        """Repeated rows of a group as one, without rows of no weight, whatever their order.

        Rows that have no numbers yet get theirs, from `start` on.

        A row that says again what another has said, target and all, adds weight but is no further
        observation.
        """
        kept = np.flatnonzero(self.weights > 0)
        # Adding 0 makes -0.0 and 0.0 one value.
        X, Y, weights, codes = self.X[kept] + 0.0, self.Y[kept], self.weights[kept], self.codes
        if codes is not None:  # by the rows themselves, not by their order or the names of groups
            codes = np.unique(codes[kept], return_inverse=True)[1]
            codes = Groups(codes).numbered(np.lexsort(np.column_stack([Y, X]).T))[0]
        keys = X if codes is None else np.column_stack([codes, X])
        _, place, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        inverse = inverse.ravel()
        total = np.bincount(inverse, weights)
        mean = np.column_stack([np.bincount(inverse, weights * y) for y in Y.T]) / total[:, None]
        about = weights[:, None] * np.square(Y - mean[inverse])
        if self.within is not None:
            about += self.within[kept]
        again = np.unique(np.column_stack([inverse, Y]), axis=0, return_index=True)[1]
        count = np.ones(len(kept)) if self.observed is None else self.observed[kept]
        return Rows(
            X[place],
            mean,
            total,
            None if codes is None else codes[place],
            first=(start + kept if self.first is None else self.first[kept])[place],
            within=np.column_stack([np.bincount(inverse, column) for column in about.T]),
            observed=np.bincount(inverse[again], count[again]),
        )

    def draw(self, size, random_state):
        """About `size` rows drawn at random, sorted, groups as a whole; all where no more."""
        n = self.n_rows
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

    def reduce(self, function, combine, width, start=0):
        """Combine function(rows, number of the first) of blocks, which holds `width` numbers a row.

        Groups are in one block as a whole; `start` numbers the first of all rows.
        """
        width = max(1, width)
        size = max(SMALL_BLOCK // width, min(4 * width, BLOCK // width))
        stops = np.array([part.stop for part in chunks(self.n_rows, size)])
        if self.codes is not None:
            stops = np.unique(np.searchsorted(self.codes, self.codes[stops - 1], side="right"))
        parts = pairwise([0, *stops.tolist()])
        return reduce(combine, (function(self.some(slice(*p)), start + p[0]) for p in parts))


class DaskRows:
    """Rows of a dask array, and targets and weights that may be arrays in memory.

    Each chunk is worked on where it is.
    """

    def __init__(self, X, y, sample_weight):
        import dask.array as da

        if X.ndim != 2 or X.shape[1] == 0 or not np.all(np.isfinite(X.shape)):
            raise ValueError(
                "X must be of shape (n_samples, n_features) with chunks of known size; got "
                f"{X.shape}. X.compute_chunk_sizes() finds them."
            )
        self.n_rows, self.sizes = X.shape[0], X.chunks[0]
        if sample_weight is None:
            sample_weight = da.ones(self.n_rows, chunks=self.sizes)
        arrays = [X.rechunk({1: -1})]
        for name, given, dimensions in (("y", y, (1, 2)), ("sample_weight", sample_weight, (1,))):
            array = da.asarray(given)
            if array.ndim not in dimensions or array.shape[0] != self.n_rows:
                raise ValueError(f"{name} has shape {array.shape}, but X has {self.n_rows} rows.")
            array = array[:, None] if name == "y" and array.ndim == 1 else array
            arrays.append(array.rechunk((self.sizes, -1)[: array.ndim]))
        self.parts = list(zip(*(a.to_delayed().ravel() for a in arrays), strict=True))

    def reduce(self, function, combine, width):
        """As `Rows.reduce`; results are combined by a tree of tasks."""
        from dask.delayed import delayed

        starts = np.cumsum([0, *self.sizes[:-1]]).tolist()
        results = [
            delayed(_of_chunk, pure=False)(*part, function, combine, width, start)
            for part, start, size in zip(self.parts, starts, self.sizes, strict=True)
            if size
        ]
        while len(results) > 1:
            results = [
                delayed(_combined, pure=False)(combine, results[i : i + _FAN_IN])
                for i in range(0, len(results), _FAN_IN)
            ]
        return results[0].compute()


@one_blas_thread
def _of_chunk(X, Y, weights, *how):
    arrays = []
    for name, given in (("X", X), ("y", Y), ("sample_weight", weights)):
        weighs = name == "sample_weight"
        options = {"ensure_2d": not weighs, "ensure_non_negative": weighs, "input_name": name}
        array = check_array(given, dtype=np.float64, **options)
        arrays.append(floats(name, array, finite=True))
    return Rows(*arrays).reduce(*how)


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


def distinct_rows(source, n_features, rng):
    """Distinct rows, and None; or a sample of them, and all rows, their number and weight."""
    if source.n_rows <= IN_MEMORY_ROWS:
        return source.merged(), None
    seed, size = np.uint64(rng.randint(2**31)), HELD_ROWS

    def cut(rows):
        """The rows of the smallest hashes, still sorted."""
        return rows.some(np.sort(np.argsort(_hash(rows.X, seed), kind="stable")[:size]))

    def summary(rows, start):
        sample = cut(rows.merged(start))
        return int(np.sum(rows.weights > 0)), rows.weights.sum(), sample

    def join(one, other):
        pairs = zip(one[2], other[2], strict=True)
        both: Any = (None if pair[0] is None else np.concatenate(pair) for pair in pairs)
        return one[0] + other[0], one[1] + other[1], cut(Rows(*both).merged())

    n, weight, sample = source.reduce(summary, join, 4 * n_features)
    if not n:
        raise ValueError("Sample weights must contain at least one non-zero number.")
    return sample, None if sample.n_rows < size else (source, n, weight)
