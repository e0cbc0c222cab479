"""Residuals of the probe: in the cylindrical frame, and as targets of a regressor.

Equation numbers are those of Gao et al., International Journal of Advanced Robotic Systems, 2020,
doi 10.1177/1729881420925638. The printed equations are lost in every copy at hand; the formulas
here are reconstructions, checked numerically.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.measurements import position_residuals
from sklearn_raacmm.residuals._cylindrical import (
    NORM_TOLERANCE,
    cartesian_to_cylindrical,
    cylindrical_to_cartesian,
)
from sklearn_raacmm.residuals._pose_features import (
    PoseFeatures,
    elbow_angle,
    shoulder_wrist_distance,
)
from sklearn_raacmm.residuals._target import CylindricalResidualTarget

__all__ = [
    "NORM_TOLERANCE",
    "CylindricalResidualTarget",
    "PoseFeatures",
    "cartesian_to_cylindrical",
    "cylindrical_to_cartesian",
    "elbow_angle",
    "position_residuals",
    "shoulder_wrist_distance",
]
