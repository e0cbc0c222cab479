"""Features as mid-ranks of their training values: for values that are few, or spread unevenly.

The rank of a value is the share of the training rows below it and half of those that have it, so
that ties stand in the middle of their range; between training values it is interpolated. Beyond
them it goes on by the slope of the outer tenth, or the mean slope where that is less: rows far off
do not look like the last ones, and those that are just outside do not look far off.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

# Parts of equal weight in which a feature's training values are kept: the ends, one value a part,
# and whatever stands beside a value of more weight than a part.
_PARTS = 128
# Share of the rows by whose slope ranks go on beyond the last value.
_OUTER = 0.1
# Correlation of ranks with values from which on they are the same to any function.
_ALIKE = 0.99


def mid_ranks(X, weights):
    """Knots (m, 3): the number of a feature, its training values in order, and their ranks."""
    knots = []
    for number, column in enumerate(X.T):
        values, inverse = np.unique(column, return_inverse=True)
        share = np.bincount(inverse.ravel(), weights) / weights.sum()
        ends = np.cumsum(share)
        if len(values) > _PARTS:
            kept = np.searchsorted(ends[:-1], np.linspace(0, 1, _PARTS + 1))
            wide = np.flatnonzero(share > 1 / _PARTS)
            kept = np.concatenate([kept, wide - 1, wide + 1])
            kept = np.unique(np.clip(kept, 0, len(values) - 1))
        else:
            kept = np.arange(len(values))
        column_of = np.full(len(kept), float(number))
        knots.append(np.column_stack([column_of, values[kept], (ends - share / 2)[kept]]))
    return np.concatenate(knots)


def by_feature(knots):
    """Values (k,), ranks (k,), and the slopes below and above them, of every feature."""
    for part in np.split(knots, np.flatnonzero(np.diff(knots[:, 0])) + 1):
        values, ranks = part[:, 1], part[:, 2]
        yield values, ranks, _beyond(values, ranks), _beyond(-values[::-1], -ranks[::-1])


def _beyond(values, ranks):
    """Slope by which ranks go on below the least value."""
    if len(values) == 1:
        return 0.0
    inner = np.unique([np.searchsorted(ranks, ranks[0] + _OUTER), len(values) - 1])
    inner = np.clip(inner, 1, len(values) - 1)
    return np.min((ranks[inner] - ranks[0]) / (values[inner] - values[0]))


def to_ranks(knots, X):
    """Ranks (n, d) of rows (n, d), or without knots the rows as they are."""
    if knots is None:
        return X
    found = np.empty(X.shape)
    for i, (values, ranks, below, above) in enumerate(by_feature(knots)):
        x = X[:, i]
        found[:, i] = np.interp(x, values, ranks)
        found[:, i] += below * np.minimum(x - values[0], 0) + above * np.maximum(x - values[-1], 0)
    return found


def rank_slopes(knots, X):
    """Derivatives (n, d) of the ranks by the features; at a knot the mean of both sides'."""
    found = np.empty(X.shape)
    for i, (values, ranks, below, above) in enumerate(by_feature(knots)):
        slopes = np.concatenate([[below], np.diff(ranks) / np.diff(values), [above]])
        found[:, i] = slopes[np.searchsorted(values, X[:, i], side="left")]
        found[:, i] += slopes[np.searchsorted(values, X[:, i], side="right")]
    return 0.5 * found


def are_alike(X, ranks):
    """Whether features that are spread evenly are given by their ranks as well as by themselves."""
    X, ranks = X - X.mean(axis=0), ranks - ranks.mean(axis=0)
    both = np.sqrt(np.square(X).sum(axis=0) * np.square(ranks).sum(axis=0))
    return bool(np.all((X * ranks).sum(axis=0) >= _ALIKE * both))
