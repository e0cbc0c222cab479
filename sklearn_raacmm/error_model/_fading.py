"""How much of a correction is used: one share, and less of it where little is known."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sklearn_raacmm.utils import Finding, centred, group_means, report_findings

# Factor of the standard deviation: Wiener's. With 2 instead 25 simulated errors at poses of real
# arms leave 3 % and 11 % more. In single-point tests so many times the factor by which errors at
# positions left out have widened the standard deviation, where that is less
# (``benchmarks/bench_few_poses.py``).
_MOST, _OF_WIDENED = 1.0, 0.3
# The fewest positions at which a share is found: of three the rest is hardly the model that is
# judged. With fewer a correction is used as a whole, if it helped at each of them.
LEAST_POSITIONS = 4
# A gain of less than this share of the deviation is none.
_LEAST_GAIN = 1e-3
# predict warns where less than this share is left of more than half of the corrections.
_WARN_SHARE = 0.1


@dataclass(frozen=True)
class Fading:
    """Share of a correction that is used, by how little is known: of any model of residuals.

    With s the doubt at a pose, mm, it is ``most size^2 / (size^2 + factor^2 max(0, s^2 -
    known^2))``: Wiener's factor for errors of the size of the residuals, known to this uncertainty.

    Attributes
    ----------
    size_mm : float
        Root mean square length of the training residuals.
    factor : float
        Factor of the doubt; 0 for no fading.
    known_mm : float
        Doubt up to which nothing fades: the largest at poses that have shown so.
    most : float
        Share where nothing fades: found at positions left out, 0 where the correction did not help.
    """

    size_mm: float
    factor: float
    known_mm: float = 0.0
    most: float = 1.0

    def share(self, doubt: np.ndarray) -> np.ndarray:
        """Share from 0 to 1 of each correction, (n,), by its doubt (n,) in mm."""
        if not (self.factor > 0 and self.size_mm > 0):
            return np.full(len(doubt), self.most)
        size = self.size_mm**2
        beyond = np.maximum(np.square(doubt) - self.known_mm**2, 0.0)
        return self.most * size / np.maximum(size + self.factor**2 * beyond, 1e-300)


class Judgement(NamedTuple):
    """Whether a correction helps at positions that were left out; means over positions."""

    mean_before_mm: float  # without correction
    mean_after_mm: float  # with it
    gain_se_mm: float  # standard error over positions of the difference
    n_positions: int
    helps: bool


def find_fading(y, weights, codes, factor: Any = "auto", widening=1.0):
    """Fading of a correction of residuals (n, 3) in mm.

    Errors at positions left out are `widening` times as large as the standard deviation says.
    """
    y = centred(y, codes, weights)
    if factor == "auto":
        factor = _MOST
        if codes is not None and codes.max() + 1 >= LEAST_POSITIONS:
            # A flat optimum has few reliable digits; corrections must not depend on the others.
            factor = min(round(_OF_WIDENED * widening, 3), _MOST)
    size = np.sqrt(np.average(np.square(y).sum(axis=1), weights=weights))
    return Fading(float(size), float(factor))


def judge(
    y: np.ndarray,
    correction: np.ndarray,
    doubt: np.ndarray,
    fading: Fading,
    weights: np.ndarray,
    codes: np.ndarray | None,
    positions: np.ndarray,
    before: float | None = None,
) -> tuple[Fading, Judgement]:
    """How much of a correction is used, by positions that were left out of the fit.

    With y the residuals (n, 3) and f what of the `correction` has not faded, the share is ``sum
    y.f / sum f.f``, from 0 to 1: that of least squares. Poses that slipped have no `weights` (n,).
    With fewer than four `positions` it is 1 or 0, by whether the mean deviation falls at each. A
    share that was known `before` moves as far as it is more than a standard error away.

    Returns the fading with this share, and how well it did.
    """
    kept = weights > 0
    fading = replace(fading, most=1.0)
    used = centred(fading.share(doubt)[:, None] * correction, codes, weights)
    y = centred(y, codes, weights)
    places = np.unique(positions[kept], return_inverse=True)[1].ravel()
    n = int(places.max()) + 1

    def deviations(left):
        return group_means(np.linalg.norm(left, axis=1)[kept], places, weights[kept])

    def gains_of(share):
        gains = without - deviations(y - share * used)
        return gains, gains.std(ddof=1) / np.sqrt(n) if n > 1 else np.inf

    without = deviations(y)
    if n < LEAST_POSITIONS:
        gains, error = gains_of(1.0)
        most = float(gains.mean() > max(error, _LEAST_GAIN * without.mean()) and gains.min() > 0)
    else:
        size = max(weights @ np.square(used).sum(axis=1), 1e-300)
        most = weights @ (y * used).sum(axis=1) / size
        if before is not None:
            pulls = np.bincount(places, (weights * ((y - most * used) * used).sum(axis=1))[kept])
            error = np.linalg.norm(pulls) / size
            most = np.clip(before, most - error, most + error)
        most = float(np.clip(most, 0.0, 1.0))
    gains, error = gains_of(most)
    means = float(without.mean()), float((without - gains).mean())
    return replace(fading, most=most), Judgement(*means, float(error), n, most > 0)


def warn_where_unknown(share, most):
    """Warn where nothing, or next to nothing, is left of most corrections."""
    if most == 0:
        said = "The correction is 0: it did not help at positions that were left out."
        advice = "Update it with new poses, or learn again."
        report_findings([Finding("share-of-zero", said, advice)])
        return
    faded = np.count_nonzero(share < _WARN_SHARE * most)
    if 2 * faded > len(share):
        said = (
            f"{faded} of {len(share)} poses lie where the model knows little: their corrections "
            "are reduced to less than a tenth."
        )
        advice = "Measure there before you correct, or see `fading`."
        report_findings([Finding("little-known", said, advice)])
