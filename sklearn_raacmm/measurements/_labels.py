"""Labels by geometry: at which places rows are, whatever these are called."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sklearn_raacmm.measurements._explanations import PRICE
from sklearn_raacmm.utils import Finding, group_means, row_numbers

# Places are farther apart than the points of a nominal arm scatter: of four real Pandas 40 mm give
# the right places (``tests/measurements/test_labels.py``).
APART_MM = 40.0
# Rows of which all distances are looked at: of 3000 they take 36 MB.
_MOST_ROWS = 3000
# Nats by which a row that is not at its own place has to be likelier at another one: fewer than
# `PRICE`, as by chance few slips end at another place.
_PRICE_OF_ROW = 3.0
# Rows or places that a sentence names.
_NAMED = 4
_ONE_VALUE = 1e-9  # rad: joints that all have the same value


def places_of(points: np.ndarray, apart_mm: float = APART_MM) -> np.ndarray | None:
    """Code of the place of each point (n, 3), from 0: no two of a place are farther apart, mm.

    Clusters of complete linkage. None for more points than can be looked at.
    """
    if not 2 <= len(points) <= _MOST_ROWS:
        return None
    return np.asarray(fcluster(linkage(points, "complete"), apart_mm, "distance")) - 1


def renamed(places: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Places (n,) by the codes that most of their rows have been given; -1 for places without."""
    shared = np.zeros((places.max() + 1, codes.max() + 1))
    np.add.at(shared, (places, codes), 1)
    name = np.full(len(shared), -1)
    one, other = linear_sum_assignment(-shared)
    name[one] = np.where(shared[one, other] > 0, other, -1)
    return name[places]


def other_labels(
    points: np.ndarray, codes: np.ndarray, far: np.ndarray, sigma: float
) -> np.ndarray:
    r"""Codes (n,) in which rows that are `far` (n,) from their place have that of another one.

    A slip may be anywhere among the places, which scatter by S; a row of another place is at one of
    the P places. With d its distance and s the scatter of a coordinate, the second is likelier by
    :math:`3 \log(S / s) - d^2 / 2 s^2 - \log P` nats.
    """
    found = codes.copy()
    near = ~far & (np.bincount(codes[~far], minlength=codes.max() + 1)[codes] > 1)
    if not near.any() or not far.any():
        return found
    known = np.unique(codes[near])
    centres = group_means(points[near], np.searchsorted(known, codes[near]))
    size = max(_spread(centres), sigma)
    square = np.square(points[far][:, None] - centres).sum(axis=2)
    gain = 3 * np.log(size / sigma) - square.min(axis=1) / (2 * sigma**2) - np.log(len(known))
    nearest = known[square.argmin(axis=1)]
    found[far] = np.where(gain > _PRICE_OF_ROW, nearest, codes[far])
    return found


def wrong_labels(
    codes: np.ndarray, right: np.ndarray, labels: Any, numbers: np.ndarray, many: bool
) -> Iterator[Finding]:
    """The finding that some rows are at other places than their labels say.

    `codes` and `right` (n,) index the `labels`, as given and by geometry; -1 is no place that has a
    label. `numbers` (n,) are what the rows are called.
    """
    rows = np.flatnonzero(codes != right)
    if not len(rows):
        return
    parts: list[str] = []
    left: Any = rows.tolist()
    for i in rows.tolist():
        pair = [j for j in left if codes[j] == right[i] and right[j] == codes[i]]
        if i in left and pair:
            left.remove(i)
            left.remove(pair[0])
            first, second = row_numbers(numbers[[i, pair[0]]])
            parts.append(f"rows {first} and {second} look exchanged")
    for given, place in np.unique(np.column_stack([codes, right])[left], axis=0):
        of = [i for i in left if codes[i] == given and right[i] == place]
        where = "no place of the others" if place < 0 else f"of {labels[place].item()!r}"
        named = f"{_in_words(numbers[of])} of {labels[given].item()!r}"
        parts.append(f"{named} look{'s' * (len(of) == 1)} to be {where}")
    more = f"; and {len(parts) - _NAMED} more" * (len(parts) > _NAMED)
    yield Finding(
        "wrong-label",
        f"The labels of {len(rows)} of {len(codes)} rows do not fit where the probe was: "
        f"{'; '.join(parts[:_NAMED])}{more}.",
        "Mend the labels of these rows.",
        "repair" if many else "doubt",
        positions=tuple(labels[np.unique(codes[rows])]),
        rows=row_numbers(numbers[rows]),
    )


def no_readings(angles: np.ndarray, far: np.ndarray, numbers: np.ndarray) -> Iterator[Finding]:
    """The finding that rows that are `far` (n,) from their place hold one value in every joint."""
    rows = np.flatnonzero(far & (np.ptp(angles, axis=1) < _ONE_VALUE))
    if len(rows):
        yield Finding(
            "no-reading",
            f"The angles of {_in_words(numbers[rows])} have one value in every joint, far from "
            "their places.",
            "They are no readings of the encoders, and are not learnt from: leave them out.",
            rows=row_numbers(numbers[rows]),
        )


def same_places(centres: np.ndarray, labels: Any, sigma: float) -> Iterator[Finding]:
    r"""Findings of one place under several labels, by the mean points of positions (n, 3), mm.

    Two places are anywhere among all, which scatter by S; one place is found to within the scatter
    s of a coordinate. With d their distance, one place is likelier by :math:`3 \log(S / s) - d^2 /
    2 s^2` nats, less the logarithm of how many pairs there are.
    """
    n = len(centres)
    if n < 3 or not sigma > 0:
        return
    square = np.square(centres[:, None] - centres).sum(axis=2)
    gain = 3 * np.log(max(_spread(centres), sigma) / sigma) - square / (2 * sigma**2)
    one = np.argwhere(np.triu(gain > PRICE + np.log(n * (n - 1) / 2), 1))
    graph = coo_array((np.ones(len(one)), one.T), shape=(n, n))
    place = connected_components(graph, directed=False)[1]
    for code in np.flatnonzero(np.bincount(place) > 1):
        of = np.flatnonzero(place == code)
        names = " and ".join(repr(label.item()) for label in labels[of[:_NAMED]])
        size = float(np.sqrt(square[np.ix_(of, of)].max()))
        yield Finding(
            "one-place",
            f"{names} are one place: their mean points are {size:.2g} mm apart. They count as one "
            "where positions are left out.",
            weight="note",
            positions=tuple(labels[of]),
            size_mm=size,
        )


def _in_words(rows):
    """The first of some rows by their numbers, and how many there are."""
    named = [str(number) for number in row_numbers(rows[:_NAMED])]
    more = f" and {len(rows) - _NAMED} more" * (len(rows) > _NAMED)
    return f"row{'s' * (len(rows) > 1)} {', '.join(named)}{more}"


def _spread(points):
    """Root mean square of a coordinate of points (n, 3) about their mean."""
    return float(np.sqrt(np.square(points - points.mean(axis=0)).mean()))
