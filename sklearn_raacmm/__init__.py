"""Residual correction for articulated arm coordinate measuring machines."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm._version import __version__
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import CalibrationResult, calibrate
from sklearn_raacmm.correction import (
    CorrectionCheck,
    CorrectionScores,
    LearnedCorrection,
    TableChange,
    check_correction,
    cross_validate_correction,
    learn_correction,
    next_poses,
    read_check_records,
    search_table,
    transfer_correction,
    update_correction,
)
from sklearn_raacmm.error_model import ArmResidualRegressor
from sklearn_raacmm.measurements import Finding, FindingError, FindingWarning
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.residuals import (
    CylindricalResidualTarget,
    PoseFeatures,
    cartesian_to_cylindrical,
    cylindrical_to_cartesian,
    elbow_angle,
    position_residuals,
    shoulder_wrist_distance,
)

__all__ = [
    "Arm",
    "ArmResidualRegressor",
    "CalibrationResult",
    "CorrectionCheck",
    "CorrectionScores",
    "CylindricalResidualTarget",
    "Finding",
    "FindingError",
    "FindingWarning",
    "LearnedCorrection",
    "PoseFeatures",
    "RBFNetRegressor",
    "TableChange",
    "__version__",
    "calibrate",
    "cartesian_to_cylindrical",
    "check_correction",
    "cross_validate_correction",
    "cylindrical_to_cartesian",
    "elbow_angle",
    "learn_correction",
    "next_poses",
    "position_residuals",
    "read_check_records",
    "search_table",
    "shoulder_wrist_distance",
    "transfer_correction",
    "update_correction",
]
