"""Labels by geometry: at which places rows are, whatever these are called."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist, pdist

from sklearn_raacmm.measurements import Explanation
from sklearn_raacmm.utils import Finding, Groups

# Places are farther apart than the points of a nominal arm scatter: of four real Pandas 40 mm give
# the right places (``tests/calibration/test_labels.py``).
APART_MM = 40.0
# Rows of which all distances are looked at: of 3000 they take 36 MB.
MOST_ROWS = 3000
# Nats by which a row that is not at its own place has to be likelier at another one: fewer than
# `Explanation.PRICE`, as by chance few slips end at another place.
_PRICE_OF_ROW = 3.0
# Rows or places that a sentence names.
_NAMED = 4
# Scatter after calibration beyond which the arm's table is probably wrong: measuring arms have
# hundredths of a mm, the real robots of the tests 0.2 to 0.4.
MUCH_SCATTER_MM = 1.0
# Limits of outliers, in standard deviations of a coordinate, where no tail is longer than a normal
# one's: of 100 rows 4.3, of 1000 4.9.
_LIMIT_SDS = 4.5
_ONE_VALUE = 1e-9  # rad: joints that all have the same value


def places_of(points: np.ndarray, apart_mm: float = APART_MM) -> np.ndarray | None:
    """Code of the place of each point (n, 3), from 0: no two of a place are farther apart, mm.

    Clusters of complete linkage. None for more points than can be looked at.
    """
    if not 2 <= len(points) <= MOST_ROWS:
        return None
    return np.asarray(fcluster(linkage(points, "complete"), apart_mm, "distance")) - 1


def _renamed(places, codes):
    """Places (n,) by the codes that most of their rows have been given; -1 for places without."""
    shared = np.zeros((places.max() + 1, codes.max() + 1))
    np.add.at(shared, (places, codes), 1)
    name = np.full(len(shared), -1)
    one, other = linear_sum_assignment(-shared)
    name[one] = np.where(shared[one, other] > 0, other, -1)
    return name[places]


def _other_labels(points, codes, far, sigma):
    """Codes (n,) in which rows that are `far` (n,) from their place have that of another one.

    A slip may be anywhere, a row of another place is at one of the P places: log P is its price.
    """
    found = codes.copy()
    near = ~far & (np.bincount(codes[~far], minlength=codes.max() + 1)[codes] > 1)
    if near.any() and far.any():
        known = np.unique(codes[near])
        centres = Groups(np.searchsorted(known, codes[near])).means(points[near])
        apart = cdist(points[far], centres)
        is_there = apart.min(axis=1) < _one_place_mm(centres, sigma, _PRICE_OF_ROW, len(known))
        found[far] = np.where(is_there, known[apart.argmin(axis=1)], codes[far])
    return found


def _one_place_mm(centres, sigma, price, n_tried):
    r"""Distance (mm) up to which two points are likelier at one place than anywhere.

    Places (n, 3) scatter by S. With d the distance and s the scatter of a coordinate, one place is
    likelier by :math:`3 \log(S / s) - d^2 / 2 s^2` nats, less the logarithm of how many are tried.
    """
    spread = np.sqrt(np.square(centres - centres.mean(axis=0)).mean())
    nats = 3 * np.log(max(spread, sigma) / sigma) - price - np.log(n_tried)
    return sigma * np.sqrt(2 * max(nats, 0.0))


def label_findings(fit, result, numbers, scatter) -> Iterator[Finding]:
    """Labels that do not fit where the probe was, and one place under two.

    `numbers` (n,) are what the rows are called, `scatter` is the mean of poses in mm.
    """
    if fit.measured.points is None:
        labels = fit.measured.labels
        far = np.isin(numbers, result.outliers)
        if fit.measured.features:
            known = fit.points(), labels.tolist(), fit.measured.lengths
            yield from fit.measured.touched.findings(*known)
            yield from _no_readings(fit.angles, far, numbers)
            return
        right = _right_labels(fit) if scatter > MUCH_SCATTER_MM else None
        sigma = result.outlier_limit_mm / _LIMIT_SDS
        yield from _wrong_labels(fit, right, labels, numbers, far, sigma)
        yield from _no_readings(fit.angles, far, numbers)
        centres = fit.groups.means(fit.points(), fit.weights)
        yield from _same_places(centres, labels, fit.sigma)


def _right_labels(fit):
    """Labels by the places of the nominal arm's points, then twice of the calibrated ones.

    None where rows scatter by no less with them, or most have another one.
    """
    index, sigma = fit.measured.index, fit.sigma
    # The probe may not be known: as most of the labels have it.
    codes = places_of(fit.of(free=["probe"], loss="cauchy").points())
    for _ in range(2):
        if codes is None or 2 * np.sum(_renamed(codes, index) != index) > len(index):
            return None
        fit = fit.of(index=codes, lengths=[])
        codes = places_of(fit.points())
    right = _renamed(codes, index)
    n_wrong = np.sum(right != index)
    gain = 3 * len(index) * np.log(sigma / fit.sigma) - n_wrong * np.log(index.max() + 1.0)
    return right if n_wrong < len(index) / 2 and gain > 0 else None


def _wrong_labels(fit, right, labels, numbers, far, sigma):
    """The finding that some rows are at other places than their labels say.

    `right` (n,) index the `labels` by geometry; -1 is no place that has a label. Where it is None,
    rows that are `far` (n,) may be at another place, of points that scatter by `sigma`, mm.
    """
    codes = fit.measured.index
    many = right is not None
    right = right if many else _other_labels(fit.points(), codes, far, sigma)
    rows = np.flatnonzero(codes != right)
    if not len(rows):
        return
    parts: list[str] = []
    left, names = rows, labels.tolist()
    for i in rows:
        pair = left[(codes[left] == right[i]) & (right[left] == codes[i])]
        if i in left and len(pair):
            left = np.setdiff1d(left, [i, pair[0]])
            first, second = Finding.row_numbers(numbers[[i, pair[0]]])
            parts.append(f"rows {first} and {second} look exchanged")
    for given, place in np.unique(np.column_stack([codes, right])[left], axis=0):
        of = left[(codes[left] == given) & (right[left] == place)]
        where = "no place of the others" if place < 0 else f"of {names[place]!r}"
        named = f"{_in_words(numbers[of])} of {names[given]!r}"
        parts.append(f"{named} look{'s' * (len(of) == 1)} to be {where}")
    more = f"; and {len(parts) - _NAMED} more" * (len(parts) > _NAMED)
    yield Finding(
        "wrong-label",
        f"The labels of {len(rows)} of {len(codes)} rows do not fit where the probe was: "
        f"{'; '.join(parts[:_NAMED])}{more}.",
        "Mend the labels of these rows.",
        "repair" if many else "doubt",
        positions=tuple(labels[np.unique(codes[rows])]),
        rows=Finding.row_numbers(numbers[rows]),
    )


def _no_readings(angles, far, numbers):
    """The finding that rows that are `far` (n,) from their place hold one value in every joint."""
    rows = np.flatnonzero(far & (np.ptp(angles, axis=1) < _ONE_VALUE))
    if len(rows):
        named = _in_words(numbers[rows])
        text = f"The angles of {named} have one value in every joint, far from their places."
        advice = "They are no readings of the encoders, and are not learnt from: leave them out."
        yield Finding("no-reading", text, advice, rows=Finding.row_numbers(numbers[rows]))


def _same_places(centres, labels, sigma):
    """Findings of one place under several labels, by the mean points of positions (n, 3), mm."""
    n = len(centres)
    if n < 3 or not sigma > 0:
        return
    near = _one_place_mm(centres, sigma, Explanation.PRICE, n * (n - 1) / 2)
    place = fcluster(linkage(centres, "single"), near, "distance")
    for code in np.flatnonzero(np.bincount(place) > 1):
        of = np.flatnonzero(place == code)
        names = " and ".join(map(repr, labels[of[:_NAMED]].tolist()))
        size = pdist(centres[of]).max()
        text = (
            f"{names} are one place: their mean points are {size:.2g} mm apart. They count as one "
            "where positions are left out."
        )
        positions = tuple(labels[of])
        yield Finding("one-place", text, weight="note", positions=positions, size_mm=size)


def _in_words(rows):
    """The first of some rows by their numbers, and how many there are."""
    named = [str(number) for number in Finding.row_numbers(rows[:_NAMED])]
    more = f" and {len(rows) - _NAMED} more" * (len(rows) > _NAMED)
    return f"row{'s' * (len(rows) > 1)} {', '.join(named)}{more}"
