"""Robust scales and weights: rows far off say nothing of the size of the errors, or of a fit.

References
----------
.. [1] A. E. Beaton, J. W. Tukey, "The fitting of power series, meaning polynomials, illustrated on
   band-spectroscopic data", Technometrics 16 (1974), 147-185.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator

import numpy as np
from scipy.special import chdtri

from sklearn_raacmm.utils._findings import Finding

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


def robust_scale(
    distances: np.ndarray, n_coordinates: int, weights: np.ndarray | None = None
) -> float:
    """Standard deviation of a coordinate, from the median distance over that of chi.

    `distances` (n,) are lengths of vectors of so many coordinates, of which some are no part of the
    normal distribution of the others. An integer weight is worth that many repeats of the row.
    """
    if weights is None:
        median = np.median(distances)
    else:
        counted = weights > 0
        rule: dict = {"q": 0.5, "weights": weights[counted], "method": "inverted_cdf"}
        # The mean of the lower and the upper median, as of rows without weights.
        lower, upper = (sign * np.quantile(sign * distances[counted], **rule) for sign in (1, -1))
        median = (lower + upper) / 2
    return float(median / np.sqrt(chdtri(n_coordinates, 0.5)))


def tukey_weights(
    residuals: np.ndarray,
    weights: np.ndarray | None = None,
    *,
    least_scale: float = 0.0,
    weighed: bool = False,
) -> np.ndarray:
    """Factors (n,) of the rows' weights by Tukey's biweight, (1 - (r / c)^2)^2 below c [1]_.

    r are the lengths of the residuals (n, q), c is 5.5 standard deviations of a coordinate by
    `robust_scale`, in which rows count by `weights`. The standard deviation is at least
    `least_scale`: that of the noise, where a model of few rows follows them closely. All factors
    are 1 where no row that counts is as far off as c, unless the fit has `weighed` before, lest its
    weights come and go; and where at least half of the rows are met exactly.
    """
    distances = np.linalg.norm(residuals, axis=1)
    scale = max(robust_scale(distances, residuals.shape[1], weights), least_scale)
    counted = slice(None) if weights is None else weights > 0
    cut = TUKEY_CUT * scale
    if not (cut > 0 and (weighed or np.any(distances[counted] >= cut))):
        return np.ones(len(distances))
    # Cut off before it is squared: of next to nothing, no overflow.
    return np.square(1 - np.square(np.minimum(distances, cut) / cut))


def slip_factors(
    values: np.ndarray, codes: np.ndarray, weights: np.ndarray | None = None
) -> np.ndarray:
    """Factors (n,) of the rows' weights in the means of their groups: slips take no part.

    Groups in which no row is farther than 11 standard deviations from the others, by the median of
    the group and of all, stay as they are; in others rows are weighed by Tukey's biweight. Errors
    of an arm have longer tails than normal ones: poses in which it bends most are no slips. Rows of
    weight 0 have a factor of 1.
    """
    factor = np.ones(len(values))
    used = np.arange(len(values)) if weights is None else np.flatnonzero(weights > 0)
    rows = [used[codes[used] == code] for code in range(int(codes.max(initial=-1)) + 1)]
    rows = [of for of in rows if len(of) >= _LEAST_OF_SLIPS]
    if not rows:
        return factor
    far = [np.linalg.norm(values[of] - np.median(values[of], axis=0), axis=1) for of in rows]
    usual = robust_scale(np.concatenate(far), values.shape[1])
    for of, away in zip(rows, far, strict=True):
        scale = _SLIP * max(usual, robust_scale(away, values.shape[1]))
        centre = np.median(values[of], axis=0)
        for _ in range(_ROUNDS):
            left = values[of] - centre
            factor[of] = tukey_weights(left, least_scale=scale)
            centre = np.average(values[of], axis=0, weights=factor[of])
    return factor


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
