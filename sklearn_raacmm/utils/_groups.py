"""Groups of rows: labels as indices, sums and means by group, and deviations from them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_array

from sklearn_raacmm.utils._checks import floats
from sklearn_raacmm.utils._robust import slip_factors

# How a missing label that is no text prints: NaN, None, and those of pandas.
_MISSING = ("nan", "None", "NaT", "<NA>")
# Mean residuals of positions, as a share of what the scatter within positions explains, below which
# they count as zero: 0 where all rows of a single-point test are here, 0.4 where 60 % of them are,
# 1 for independent residuals against a reference, more where neighbours err alike.
_CENTRED = 0.5
# Share of a sum that is rounding.
_ROUNDING = 1e-9
# Divides sums of no weight: the mean of a group without weight is then 0, not NaN.
_TINY = 1e-300


def encode_groups(
    groups: Any, n_samples: int | None = None, name: str = "groups"
) -> tuple[np.ndarray, np.ndarray]:
    """Different labels, sorted (n_groups,), and the index of each row's label (n_samples,).

    Labels are numbers or text. The texts "nan" and "None" are labels as any others; an empty text,
    NaN, None and pandas' NA are missing, which is refused.
    """
    if groups is None:
        raise ValueError(f"{name} must give the position of each point, got None.")
    if np.ma.is_masked(groups):
        raise ValueError(f"{name} has {np.ma.count_masked(groups)} masked labels.")
    groups = _labels(groups, name)
    if n_samples is not None and len(groups) != n_samples:
        raise ValueError(f"{name} names {len(groups)} samples, but there are {n_samples}.")
    missing = _missing(groups)
    if missing.any():
        raise ValueError(
            f"{name} has {missing.sum()} missing labels among {groups.size} "
            f"(the first in row {np.flatnonzero(missing)[0]})."
        )
    try:
        return np.unique(groups, return_inverse=True)
    except TypeError:
        kinds = sorted({type(label).__name__ for label in groups})
        raise ValueError(
            f"{name} must be labels of one kind, got {' and '.join(kinds)} mixed."
        ) from None


def _labels(groups, name):
    """Labels as an array of one dimension, in which what is missing differs from text."""
    try:
        array = np.asarray(groups)
        if array.dtype.kind == "U" and not isinstance(groups, np.ndarray):
            # NumPy writes the NaN and the numbers of a list that holds text as text, too.
            objects = np.array(groups, dtype=object)
            if not all(isinstance(label, str) for label in objects.flat):
                array = objects
    except ValueError:
        raise ValueError(
            f"{name} must be one label per point, got sequences of different lengths."
        ) from None
    if array.ndim == 2 and array.shape[1] == 1:  # a column of a table
        array = array.ravel()
    has_parts = array.dtype.kind == "O" and any(
        np.iterable(label) and not isinstance(label, str | bytes) for label in array.flat
    )
    if array.ndim != 1 or has_parts:
        got = "sequences" if has_parts else f"an array of shape {array.shape}"
        raise ValueError(
            f"{name} must be one label per point, got {got}. Of labels that have several parts, "
            "make one text each."
        )
    return array


def _missing(labels):
    """Which labels are missing."""
    if labels.dtype.kind in "iub":
        return np.zeros(len(labels), dtype=bool)
    if labels.dtype.kind == "f":
        return np.isnan(labels)
    if labels.dtype.kind in "mM":
        return np.isnat(labels)
    if labels.dtype.kind in "US":
        return labels == labels.dtype.type()
    return np.array(
        [x == "" if isinstance(x, str) else str(x) in _MISSING for x in labels], dtype=bool
    )


def group_sums(
    values: np.ndarray,
    codes: np.ndarray,
    weights: np.ndarray | None = None,
    n_groups: int | None = None,
) -> np.ndarray:
    """Weighted sum of the rows (n, ...) of each group, (n_groups, ...).

    Without `n_groups` there are as many as `codes` (n,) names, from 0.
    """
    n = len(values)
    n_groups = int(codes.max()) + 1 if n_groups is None else n_groups
    weights = np.ones(n) if weights is None else weights
    sum_up = csc_array((weights, codes, np.arange(n + 1)), shape=(n_groups, n))
    return (sum_up @ values.reshape(n, -1)).reshape(n_groups, *values.shape[1:])


def group_means(
    values: np.ndarray, codes: np.ndarray, weights: np.ndarray | None = None
) -> np.ndarray:
    """Weighted mean of the rows of each group, (n_groups, ...); see `group_sums`."""
    # The sums are those of differences from the first row, so that a large mean costs no digits.
    origin = values[0]
    total = np.maximum(np.bincount(codes, weights), _TINY)
    total = total.reshape(-1, *[1] * (values.ndim - 1))
    return group_sums(values - origin, codes, weights) / total + origin


def centred(
    values: np.ndarray, codes: np.ndarray | None, weights: np.ndarray | None = None
) -> np.ndarray:
    """Rows less the weighted mean of their group; as they are where `codes` is None."""
    return values if codes is None else values - group_means(values, codes, weights)[codes]


def are_deviations(
    y: np.ndarray, codes: np.ndarray, weights: np.ndarray, share: float = _CENTRED
) -> bool:
    """Whether residuals (n, ...) are known up to a constant at each position: small means there.

    By the mean squares of positions' means, as a share of what the scatter within positions
    explains; of means with slips or without them.
    """
    y = y.reshape(len(y), -1)
    if _share_of_means(y, codes, weights) < share:
        return True
    factor = slip_factors(y, codes, weights)
    # They may be deviations from means without slips.
    return bool(np.any(factor < 1) and _share_of_means(y, codes, weights * factor) < share)


def _share_of_means(y, codes, weights):
    """The share; infinite where nothing scatters."""
    # Weights above 1 are repeats; smaller ones are no parts of a row, or few rows would be left.
    weights = weights / min(weights[weights > 0].mean(), 1.0)
    total = np.bincount(codes, weights)
    used = total > 0
    left = centred(y, codes, weights)
    n_free = total.sum() - used.sum()
    within = weights @ np.square(left).sum(axis=1) / max(n_free, 1e-300)
    between = (total[:, None] * np.square(group_means(y, codes, weights)))[used].sum(axis=1)
    # Positions of one row each: their deviations from themselves are rounding.
    if not (n_free > _ROUNDING * total.sum() and within > _ROUNDING**2 * between.mean()):
        return np.inf
    return float(between.mean() / within)


def check_groups(groups: ArrayLike | None, n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Labels and codes as `encode_groups`; None makes all rows one group."""
    if groups is None:
        return np.zeros(1, dtype=int), np.zeros(n_samples, dtype=int)
    return encode_groups(groups, n_samples)


def deviations_by_group(
    points: ArrayLike, groups: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Deviation of each point from its position's mean, its position, counts and labels."""
    points = floats("points", points, -1)
    labels, codes = check_groups(groups, len(points))
    counts = np.bincount(codes)
    if counts.min() < 2:
        raise ValueError(
            f"{(counts < 2).sum()} of {len(counts)} positions hold a single point (the first: "
            f"{labels[counts < 2][0]!s}); a scatter needs at least 2."
        )
    return centred(points, codes), codes, counts, labels


def natural_order(labels: Iterable[Any]) -> list[int]:
    """Indices of labels in the order in which cone 2 comes before cone 10."""
    parts = [re.split(r"(\d+)", str(label)) for label in labels]
    keys = [[int(part) if i % 2 else part for i, part in enumerate(each)] for each in parts]
    return sorted(range(len(keys)), key=keys.__getitem__)
