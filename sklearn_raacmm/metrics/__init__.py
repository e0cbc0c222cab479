"""Measures that an articulated arm is judged by, and scorers for model selection.

Lengths are in mm. The measures follow secondary sources on the standards ("after"), which were not
at hand: a number from this module is no statement of conformance to any of them.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.metrics._acceptance import (
    articulated_location_error,
    gauge_lengths,
    length_error,
)
from sklearn_raacmm.metrics._repeatability import (
    axis_repeatability,
    difference as difference,
    repeatability_interval,
    repeatability_scorer,
    single_point_repeatability,
    within_position_r2_score,
)
from sklearn_raacmm.metrics._spheres import fit_sphere

__all__ = [
    "articulated_location_error",
    "axis_repeatability",
    "fit_sphere",
    "gauge_lengths",
    "length_error",
    "repeatability_interval",
    "repeatability_scorer",
    "single_point_repeatability",
    "within_position_r2_score",
]
