"""Fading: a correction is shrunk where its standard deviation says that little is known."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass
from typing import Any

import numpy as np

from sklearn_raacmm.utils import Finding, centred, report_findings

# Factor of the standard deviation with a reference for every pose: Wiener's. With 2 instead 25
# simulated errors at poses of real arms leave 3 % and 11 % more.
_OF_TRACKER = 1.0
# In single-point tests: so many times the factor by which errors at positions left out have widened
# the standard deviation; 1 where too few positions can be left out, and at most 1
# (``benchmarks/bench_few_poses.py``).
_OF_WIDENED, _MOST, _LEAST_POSITIONS = 0.3, 1.0, 4
# predict warns where less than this share is left of more than half of the corrections.
_WARN_SHARE = 0.1


@dataclass(frozen=True)
class Fading:
    """Share of a correction that is left, by how little is known: of any model of residuals.

    With s the doubt at a pose, mm, the share is ``size^2 / (size^2 + factor^2 s^2)``: Wiener's
    factor for errors of the size of the residuals, known to this uncertainty. With the length of
    the correction for their size it would not vanish far away, where both grow.

    Attributes
    ----------
    size_mm : float
        Root mean square length of the training residuals.
    factor : float
        Factor of the doubt; 0 for no fading.
    """

    size_mm: float
    factor: float

    def share(self, doubt: np.ndarray) -> np.ndarray:
        """Share from 0 to 1 that is left of each correction, (n,), by its doubt (n,) in mm."""
        if not (self.factor > 0 and self.size_mm > 0):
            return np.ones(len(doubt))
        size = self.size_mm**2
        return size / np.maximum(size + self.factor**2 * np.square(doubt), 1e-300)


def find_fading(y, weights, codes, factor: Any = "auto", widening=1.0):
    """Fading of a correction of residuals (n, 3) in mm.

    Errors at positions left out are `widening` times as large as the standard deviation says.
    """
    y = centred(y, codes, weights)
    if factor == "auto":
        factor = _OF_TRACKER
        if codes is not None:
            # A flat optimum has few reliable digits; corrections must not depend on the others.
            few = codes.max() + 1 < _LEAST_POSITIONS
            factor = _MOST if few else min(round(_OF_WIDENED * widening, 3), _MOST)
    size = np.sqrt(np.average(np.square(y).sum(axis=1), weights=weights))
    return Fading(float(size), float(factor))


def warn_where_unknown(share):
    """Warn where next to nothing is left of most corrections."""
    faded = np.count_nonzero(share < _WARN_SHARE)
    if 2 * faded > len(share):
        said = (
            f"{faded} of {len(share)} poses lie where the model knows little: their corrections "
            "are reduced to less than a tenth."
        )
        advice = "Measure there before you correct, or see `fading`."
        report_findings([Finding("little-known", said, advice)])
