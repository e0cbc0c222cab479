"""Figures of a correction, in the form of scikit-learn's displays.

They are those of Gao et al. (2020), doi 10.1177/1729881420925638: single-point repeatability,
gauge lengths before and after, and the residuals against the pose. No copy of the paper that we
have shows them, so the layout is our own. Three more figures show the poses in space, the harmonics
that a model found in the encoders, and a control chart of checks. matplotlib is imported when
something is drawn.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.display._before_after import LengthErrorDisplay, RepeatabilityDisplay
from sklearn_raacmm.display._control_chart import ControlChartDisplay
from sklearn_raacmm.display._harmonics import HarmonicDisplay
from sklearn_raacmm.display._poses import ArmPosesDisplay
from sklearn_raacmm.display._residuals import ResidualDisplay

__all__ = [
    "ArmPosesDisplay",
    "ControlChartDisplay",
    "HarmonicDisplay",
    "LengthErrorDisplay",
    "RepeatabilityDisplay",
    "ResidualDisplay",
]
