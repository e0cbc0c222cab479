"""Residual correction for articulated arm coordinate measuring machines."""

from sklearn_raacmm._planning import next_poses
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import CalibrationResult, calibrate
from sklearn_raacmm.correction import ArmResidualRegressor
from sklearn_raacmm.harmonics import JointHarmonicRegressor
from sklearn_raacmm.pose import PoseFeatures
from sklearn_raacmm.rbf import RBFNetRegressor
from sklearn_raacmm.target import (
    CylindricalResidualTarget,
    cartesian_to_cylindrical,
    cylindrical_to_cartesian,
    position_residuals,
)

__version__ = "0.1.0.dev0"

__all__ = [
    "Arm",
    "ArmResidualRegressor",
    "CalibrationResult",
    "CylindricalResidualTarget",
    "JointHarmonicRegressor",
    "PoseFeatures",
    "RBFNetRegressor",
    "calibrate",
    "cartesian_to_cylindrical",
    "cylindrical_to_cartesian",
    "next_poses",
    "position_residuals",
]
