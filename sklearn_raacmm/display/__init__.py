"""Figures of a correction, in the form of scikit-learn's displays.

That of repeatability is after Gao et al. (2020), doi 10.1177/1729881420925638, in a layout of our
own. matplotlib is imported when something is drawn.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.display._harmonics import HarmonicDisplay
from sklearn_raacmm.display._repeatability import RepeatabilityDisplay

__all__ = [
    "HarmonicDisplay",
    "RepeatabilityDisplay",
]
