"""Rows of data: in chunks, in groups, whitened, with robust weights, and one set onto another.

Robust scales and weights: rows far off say nothing of the size of the errors, or of a fit.

References
----------
.. [1] A. E. Beaton, J. W. Tukey, "The fitting of power series, meaning polynomials, illustrated on
   band-spectroscopic data", Technometrics 16 (1974), 147-185.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csc_array
from scipy.special import chdtri

from sklearn_raacmm.utils._findings import Finding

# Upper bound of the rows of every chunk, for the tests only (``pytest --chunk-rows 7``): data of
# a few rows then cross the borders of chunks, too. None: the sizes that the callers ask for.
LIMIT = None
# How a missing label that is no text prints: NaN, None, and those of pandas.
_MISSING = ("nan", "None", "NaT", "<NA>")
# Numbers of a matrix of sums that are multiplied sooner than a sparse matrix is made.
_SMALL = 2**14
# Share of a sum that is rounding.
_ROUNDING = 1e-9
# Share of what is known best of a feature's unknowns that is rounding: a ball touched on one side.
_UNKNOWN = 1e-12
# Divides sums of no weight: the mean of a group without weight is then 0, not NaN.
_TINY = 1e-300
# Standard deviations of a coordinate from which a row has no weight; while none is as far off, all
# have theirs in full. Of normal errors in space one in 800 000 is, of those of one coordinate one
# in 26 million.
TUKEY_CUT = 5.5
# Share of rows without weight that slips do not come to, and of how many. A choice.
_MOST_WITHOUT, _LEAST_ROWS = 0.1, 30
# Rows of a group of which one may be a slip, and rounds of the weights that leave it out.
_LEAST_OF_SLIPS, _ROUNDS = 4, 5
# Standard deviations of a slip, in units of those from which on a fit gives rows no weight.
_SLIP = 2.0


def chunks(n_rows: int, size: int) -> list[slice]:
    """Slices of at most `size` rows that cover `n_rows` rows.

    Callers choose a size for which what they compute stays in the processor's cache.
    """
    # Not `sklearn.utils.gen_batches`: its checks take as long as the pose of one row.
    step = max(1, size if LIMIT is None else min(size, LIMIT))
    return [slice(start, min(start + step, n_rows)) for start in range(0, n_rows, step)]


class Groups:
    """Rows that belong together, such as those of a position, by the number of each row's group.

    Parameters
    ----------
    codes : ndarray of shape (n,)
        Number of each row's group, from 0. None: rows of no group, which have no mean.
    n_groups : int, default=None
        How many there are. None: as many as `codes` names.
    """

    # Mean residuals of positions, as a share of what the scatter within positions explains, below
    # which they count as zero: 0 where all rows of a single-point test are here, 0.4 where 60 % of
    # them are, 1 for independent residuals against a reference, more where neighbours err alike.
    CENTRED = 0.5

    def __init__(self, codes: Any, n_groups: int | None = None) -> None:
        self.codes: Any = codes
        self.n_groups: int | None = n_groups

    @staticmethod
    def encoded(
        groups: ArrayLike | None, n_samples: int | None = None, name: str = "groups"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Different labels, sorted (n_groups,), and the index of each row's label (n_samples,).

        Labels are numbers or text. The texts "nan" and "None" are labels as any others; an empty
        text, NaN, None and pandas' NA are missing, which is refused.
        """
        if groups is None:
            raise ValueError(f"{name} must give the position of each point, got None.")
        if np.ma.is_masked(groups):
            raise ValueError(f"{name} has {np.ma.count_masked(groups)} masked labels.")
        labels = _labels(groups, name)
        if n_samples is not None and len(labels) != n_samples:
            raise ValueError(f"{name} names {len(labels)} samples, but there are {n_samples}.")
        missing = _missing(labels)
        if missing.any():
            raise ValueError(
                f"{name} has {missing.sum()} missing labels among {labels.size} "
                f"(the first in row {np.flatnonzero(missing)[0]})."
            )
        try:
            return np.unique(labels, return_inverse=True)
        except TypeError:
            kinds = sorted({type(label).__name__ for label in labels})
            raise ValueError(
                f"{name} must be labels of one kind, got {' and '.join(kinds)} mixed."
            ) from None

    @staticmethod
    def in_order(labels: Iterable[object]) -> list[int]:
        """Indices of labels in the order in which cone 2 comes before cone 10."""
        parts = [re.split(r"(\d+)", str(label)) for label in labels]
        keys = [[int(part) if i % 2 else part for i, part in enumerate(each)] for each in parts]
        return sorted(range(len(keys)), key=keys.__getitem__)

    def numbered(self, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Codes (n,) of the same groups, numbered as their first rows come in an order of rows.

        What is computed then is the same to the last digit, whatever the groups are called. The old
        code of each new one comes with them.
        """
        old, first = np.unique(self.codes[order], return_index=True)
        old = old[np.argsort(first)]
        return np.argsort(old)[self.codes], old

    def of_slices(self, slices: Iterable[slice]) -> list["Groups"]:
        """Those of slices of rows, counted from 0; rows of a group follow each other."""
        starts = np.cumsum(np.diff(self.codes, prepend=self.codes[:1]) != 0)
        return [Groups(starts[of] - starts[of.start]) for of in slices]

    def matrix(self, weights: np.ndarray | None = None) -> np.ndarray | csc_array:
        """Matrix (n_groups, n) whose product with rows is their sums, sparse unless it is small."""
        n = len(self.codes)
        n_groups = int(self.codes.max()) + 1 if self.n_groups is None else self.n_groups
        weights = np.ones(n) if weights is None else weights
        if n_groups * n <= _SMALL:
            matrix = np.zeros((n_groups, n))
            matrix[self.codes, np.arange(n)] = weights
            return matrix
        return csc_array((weights, self.codes, np.arange(n + 1)), shape=(n_groups, n))

    @cached_property
    def total(self) -> np.ndarray | csc_array:
        """The `matrix` of rows without weights, made once."""
        return self.matrix()

    def sums(self, values: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
        """Weighted sum of the rows (n, ...) of each group, (n_groups, ...)."""
        matrix = self.total if weights is None else self.matrix(weights)
        sums = matrix @ values.reshape(len(values), -1)
        return sums.reshape(len(sums), *values.shape[1:])

    def means(self, values: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
        """Weighted mean of the rows (n, ...) of each group, (n_groups, ...)."""
        # Sums of differences from the first row, so that a large mean costs no digits.
        origin = values[0]
        total = np.maximum(np.bincount(self.codes, weights), _TINY)
        total = total.reshape(-1, *[1] * (values.ndim - 1))
        return self.sums(values - origin, weights) / total + origin

    def centred(self, values: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
        """Rows less the weighted mean of their group."""
        return values if self.codes is None else values - self.means(values, weights)[self.codes]

    def medians(self, values: np.ndarray) -> np.ndarray:
        """Median of the group of each row (n, q): a slipped pose pulls the mean; 0 without any."""
        middle = np.zeros_like(values)
        if self.codes is None:
            return middle
        _, of, counts = np.unique(self.codes, return_inverse=True, return_counts=True)
        first = np.cumsum(counts) - counts
        for i, column in enumerate(values.T):
            column = column[np.lexsort((column, of))]  # by position, and there by size
            median = (column[first + (counts - 1) // 2] + column[first + counts // 2]) / 2
            middle[:, i] = median[of]
        return middle

    def are_deviations(self, y: np.ndarray, weights: np.ndarray) -> bool:
        """Whether residuals (n, ...) are known up to a constant in each group: means are small."""
        return self.share_of_means(y, weights) < self.CENTRED

    def share_of_means(self, y: np.ndarray, weights: np.ndarray) -> float:
        """Mean squares of groups' means of residuals (n, ...), over what scatter alone explains.

        Of means with slips or without them, whichever is less: they may be deviations from either.
        """
        y, factor = y.reshape(len(y), -1), self.slip_factors(y.reshape(len(y), -1), weights)
        share = self._share_of_means(y, weights)
        return min(share, self._share_of_means(y, weights * factor)) if factor.min() < 1 else share

    def _share_of_means(self, y, weights):
        """The share; infinite where nothing scatters."""
        # Weights above 1 are repeats; smaller ones are no parts of a row: few would be left.
        weights = weights / min(weights[weights > 0].mean(), 1.0)
        total = np.bincount(self.codes, weights)
        used, means = total > 0, self.means(y, weights)
        n_free = total.sum() - used.sum()
        within = weights @ np.square(y - means[self.codes]).sum(axis=1) / max(n_free, _TINY)
        between = np.mean((total * np.square(means).sum(axis=1))[used])
        # Positions of one row each: their deviations from themselves are rounding.
        if not (n_free > _ROUNDING * total.sum() and within > _ROUNDING**2 * between):
            return np.inf
        return float(between / within)

    def slip_factors(self, values: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
        """Factors (n,) of the rows' weights in the means of their groups: slips take no part.

        Groups in which no row is farther than 11 standard deviations from the others, by the median
        of the group and of all, stay as they are; in others rows are weighed by Tukey's biweight.
        Errors of an arm have longer tails than normal ones: poses in which it bends most are no
        slips. Rows of weight 0 have a factor of 1.
        """
        factor = np.ones(len(values))
        used = np.arange(len(values)) if weights is None else np.flatnonzero(weights > 0)
        used = used[np.argsort(self.codes[used], kind="stable")]
        rows = np.split(used, np.flatnonzero(np.diff(self.codes[used])) + 1)
        rows = [of for of in rows if len(of) >= _LEAST_OF_SLIPS]
        if not rows:
            return factor
        counts, used = np.array([len(of) for of in rows]), np.concatenate(rows)
        first = np.cumsum(counts) - counts
        own = Groups(np.repeat(np.arange(len(rows)), counts))
        centres, n_coordinates = own.medians(values[used]), values.shape[1]
        far = np.linalg.norm(values[used] - centres, axis=1)
        alone = own.medians(far[:, None] / np.sqrt(chdtri(n_coordinates, 0.5)))[first, 0]
        scales = _SLIP * np.maximum(robust_scale(far, n_coordinates), alone)
        # No row is far from the median, nor from the mean, the next centre, in most groups.
        off = np.linalg.norm(own.means(values[used]) - centres[first], axis=1)
        is_near = np.maximum.reduceat(far, first) + off < TUKEY_CUT * scales
        for i in np.flatnonzero(~is_near):
            of, scale, centre = rows[i], scales[i], centres[first[i]]
            for _ in range(_ROUNDS):
                left = values[of] - centre
                factor[of] = tukey_weights(left, least_scale=scale)
                centre = np.average(values[of], axis=0, weights=factor[of])
        return factor


class Whitening:
    r"""What whitens rows of three coordinates: their noise is then independent and of one size.

    A row says :math:`y = A w + B u + e` along some directions. The unknowns u of the feature that
    the row belongs to are of no interest: the constant of a position, the plane that was touched.
    With W the root of the row (:math:`W'W` is the inverse covariance of e, times the weight of the
    row), :math:`T = \sum (W B)' W B` over the rows of a feature and :math:`E E' = T^{-1}`, the
    columns :math:`W B E` are a basis of all that the unknowns explain. What is left of whitened
    columns beside it takes the unknowns out exactly (Frisch-Waugh theorem). What is known of the
    unknowns beforehand is added to T, and draws them to 0.

    Rows of some weights (n,), whose noise has the `root` (n, 3, 3) or is I. `unknowns` (n, 3, q)
    are what one of each unknown of the `feature` (n,) does to a row: None is a shift, of which
    `ridge` is the precision beforehand. `rank` says how many numbers a row shows.
    """

    def __init__(
        self,
        weights: np.ndarray,
        root: np.ndarray | None = None,
        feature: np.ndarray | None = None,
        unknowns: np.ndarray | None = None,
        ridge: float = 0.0,
        rank: np.ndarray | float = 3.0,
    ) -> None:
        # With the root of the weight, 0 along what a row does not show.
        self.root: np.ndarray = np.sqrt(weights)[:, None, None] * (
            np.eye(3) if root is None else root
        )
        self.groups: Groups = Groups(feature)  # by the feature of each row; None: no unknowns
        self.unit: Any = None  # (n_features, q, q) E: unknowns by what makes their precision 1
        self.moves: Any = None  # (n, 3, q) B E
        self.basis: Any = None  # (n, 3, q) W B E
        self.precision: Any = None  # (n_features, q) of the unknowns, along those of E
        # Numbers that a row shows, less its part of those that the unknowns take.
        self.observations: np.ndarray = rank * weights
        if feature is None:
            return
        side = self.root if unknowns is None else self.root @ unknowns
        value, axes = np.linalg.eigh(self.groups.sums(side.swapaxes(1, 2) @ side))
        shown = value > _UNKNOWN * np.maximum(value[:, -1:], 1e-300)
        if not ridge:
            taken = np.count_nonzero(shown, axis=1) / np.maximum(np.bincount(feature), 1)
            self.observations = self.observations - taken[feature]
        self.precision = value = np.where(shown, value, 0.0) + ridge
        size = np.where(value > 0, 1 / np.sqrt(np.where(value > 0, value, 1.0)), 0.0)
        self.unit = axes * size[:, None]
        of_row = self.unit[feature]
        self.moves = of_row if unknowns is None else unknowns @ of_row
        self.basis = side @ of_row

    @property
    def n_observations(self) -> float:
        """How many numbers all rows show, less those that the unknowns take."""
        return max(float(self.observations.sum()), 0.0)

    def explained(self, whitened: np.ndarray) -> np.ndarray:
        """Sums over each feature of products of the basis with columns, (n_features, q, m)."""
        return self.groups.sums(self.basis.swapaxes(1, 2) @ whitened)

    def deviations(self, columns: np.ndarray) -> np.ndarray:
        """Columns (n, 3, m), whitened, less what unknowns explain of them."""
        whitened = self.root @ columns
        if self.basis is None:
            return whitened
        return whitened - self.basis @ self.explained(whitened)[self.groups.codes]

    def centred(self, columns: np.ndarray) -> np.ndarray:
        """Columns (n, 3) or (n, 3, m) in their own unit, less what unknowns explain of them."""
        if self.moves is None:
            return columns
        flat = columns.reshape(len(columns), 3, -1)
        found = self.explained(self.root @ flat)[self.groups.codes]
        return columns - (self.moves @ found).reshape(columns.shape)

    def unknowns(self, columns: np.ndarray) -> np.ndarray:
        """The unknowns (n_features, q, m) that explain columns (n, 3, m)."""
        return self.unit @ self.explained(self.root @ columns)


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
    if labels.dtype.kind in "iubfmM":
        return labels != labels  # NaN and NaT are unlike themselves
    if labels.dtype.kind in "US":
        return labels == labels.dtype.type()
    return np.array(
        [x == "" if isinstance(x, str) else str(x) in _MISSING for x in labels], dtype=bool
    )


def robust_scale(
    distances: np.ndarray, n_coordinates: ArrayLike, weights: np.ndarray | None = None
) -> float:
    """Standard deviation of a coordinate, from the median distance over that of chi.

    `distances` (n,) are lengths of vectors of so many coordinates, one number or one of each, of
    which some are no part of the normal distribution of the others. An integer weight is worth
    that many repeats of the row.
    """
    distances = distances / np.sqrt(chdtri(n_coordinates, 0.5))
    if weights is None:
        median = np.median(distances)
    else:
        counted = weights > 0
        rule: dict = {"q": 0.5, "weights": weights[counted], "method": "inverted_cdf"}
        # The mean of the lower and the upper median, as of rows without weights.
        lower, upper = (sign * np.quantile(sign * distances[counted], **rule) for sign in (1, -1))
        median = (lower + upper) / 2
    return float(median)


def tukey_weights(
    residuals: np.ndarray,
    weights: np.ndarray | None = None,
    *,
    least_scale: float = 0.0,
    weighed: bool = False,
    n_coordinates: ArrayLike | None = None,
) -> np.ndarray:
    """Factors (n,) of the rows' weights by Tukey's biweight, (1 - (r / c)^2)^2 below c [1]_.

    r are the lengths of the residuals (n, q), c is 5.5 standard deviations of a coordinate by
    `robust_scale`, in which rows count by `weights`. The standard deviation is at least
    `least_scale`: that of the noise, where a model of few rows follows them closely. All factors
    are 1 where no row that counts is as far off as c, unless the fit has `weighed` before, lest its
    weights come and go; and where at least half of the rows are met exactly. `n_coordinates` says
    how many of the q coordinates each row has, where the others are 0.
    """
    distances = np.linalg.norm(residuals, axis=1)
    n = residuals.shape[1] if n_coordinates is None else n_coordinates
    scale = max(robust_scale(distances, n, weights), least_scale)
    counted = slice(None) if weights is None else weights > 0
    cut = TUKEY_CUT * scale
    if not (cut > 0 and (weighed or np.any(distances[counted] >= cut))):
        return np.ones(len(distances))
    # Cut off before it is squared: of next to nothing, no overflow.
    return np.square(1 - np.square(np.minimum(distances, cut) / cut))


def many_without_weight(factor: np.ndarray) -> Iterator[Finding]:
    """Finding of more rows without weight than slips can be, by their robust factors (n,)."""
    none = np.sum(factor == 0)
    if none > _MOST_WITHOUT * len(factor) and len(factor) >= _LEAST_ROWS:
        yield Finding(
            "many-without-weight",
            f"{none} of {len(factor)} poses lie so far off that they have no weight.",
            "These are more than slips are: look at labels, references and set-up.",
            "note",
        )


def align(points: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and shift (3,) that take points (n, 3) to target by least squares.

    ``points @ rotation.T + shift`` is next to `target`.
    """
    centre, target_centre = points.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((target - target_centre).T @ (points - centre))
    rotation = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return rotation, target_centre - rotation @ centre
