"""Fading: a correction is shrunk where its standard deviation says that little is known."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass
from typing import Any

import numpy as np

from sklearn_raacmm.utils import Finding, centred, say_findings

# Factor of the standard deviation with a reference for every pose: Wiener's. What was left of 25
# simulated errors at poses of real arms, learnt at new goals, in regions or in one octant, as a
# geometric mean: 12 of them 0.076 with 1, 0.078 with 2; 13 others 0.144 and 0.160. None did harm.
_OF_TRACKER = 1.0
# In single-point tests, where the standard deviation has a part that positions share and deviations
# from their means do not show: half of the deviation that errors at positions left out have
# widened, 1.2 to 2 times as a rule; and twice what 99 % of the training poses stay below counts as
# known, for fading by less would also shrink what is known. Chosen on simulated arms
# (``benchmarks/bench_guards.py``), by the deviations elsewhere over those without correction
# (geometric mean, worst): 120 trainings at 4 to 8 positions 0.49 (0.90) without fading, 0.59 (0.97)
# with it; 90 at 4 or 6 positions in one part of the volume 0.61 (1.46), and 0.62 (1.03).
_OF_WIDENED = 0.5
_KNOWN_SHARE, _KNOWN_FACTOR = 0.99, 2.0
# predict warns where less than this share is left of more than half of the corrections.
_WARN_SHARE = 0.1


@dataclass(frozen=True)
class Fading:
    """Share of a correction that is left, by its standard deviation: of any model of residuals.

    With s the length of the standard deviation at a pose the share is

        size^2 / (size^2 + factor^2 max(0, s^2 - known^2)),

    Wiener's factor for errors of the size of the residuals, known to this uncertainty. With the
    length of the correction for their size it would not vanish far away, where both grow.

    Attributes
    ----------
    size_mm : float
        Root mean square length of the training residuals.

    factor : float
        Factor of the standard deviation; 0 for no fading.

    known_mm : float, default=0
        Standard deviation up to which nothing fades.
    """

    size_mm: float
    factor: float
    known_mm: float = 0.0

    def share(self, std: np.ndarray) -> np.ndarray:
        """Share that is left of each correction.

        Parameters
        ----------
        std : ndarray of shape (n, 3)
            In mm.

        Returns
        -------
        ndarray of shape (n,)
            From 0 to 1.
        """
        if not (self.factor > 0 and self.size_mm > 0):
            return np.ones(len(std))
        doubt = np.maximum(np.square(std).sum(axis=1) - self.known_mm**2, 0.0)
        size = self.size_mm**2
        return size / np.maximum(size + self.factor**2 * doubt, 1e-300)


def find_fading(y, std, weights, codes, factor: Any = "auto", widening=1.0):
    """Fading of a correction by what is known at its training poses.

    Parameters
    ----------
    y : ndarray of shape (n, 3)
        Training residuals, mm.
    std : ndarray of shape (n, 3)
        Standard deviation of the correction there, mm.
    weights : ndarray of shape (n,)
    codes : ndarray of shape (n,) or None
        Position of each row, from 0, where positions have unknown offsets.
    factor : float or "auto", default="auto"
        Factor of the standard deviation.
    widening : float, default=1
        How much wider than `std` errors at positions left out ask for: in a single-point test
        "auto" takes half of the widened deviation, but at most `std`.

    Returns
    -------
    Fading
    """
    y = centred(y, codes, weights)
    if factor == "auto":
        factor = _OF_TRACKER
        if codes is not None:  # never more than with a tracker: outliers widen intervals, too
            # A flat optimum has few reliable digits; corrections must not depend on the others.
            factor = min(round(_OF_WIDENED * widening, 3), _OF_TRACKER)
    size = np.sqrt(np.average(np.square(y).sum(axis=1), weights=weights))
    known = 0.0
    if codes is not None:
        of_most = {"q": _KNOWN_SHARE, "weights": weights, "method": "inverted_cdf"}
        known = _KNOWN_FACTOR * np.quantile(np.linalg.norm(std, axis=1), **of_most)
    return Fading(float(size), float(factor), float(known))


def warn_where_unknown(share):
    """Warn where next to nothing is left of most corrections."""
    faded = np.count_nonzero(share < _WARN_SHARE)
    if 2 * faded > len(share):
        said = (
            f"{faded} of {len(share)} poses lie where the model knows little: their corrections "
            "are reduced to less than a tenth."
        )
        advice = "Measure there before you correct, or see `fading`."
        say_findings([Finding("little-known", said, advice)])
