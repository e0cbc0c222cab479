"""Residual correction for articulated arm coordinate measuring machines."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import importlib
from typing import TYPE_CHECKING, Any

from sklearn_raacmm._version import __version__

if TYPE_CHECKING:
    from sklearn_raacmm.arm import Arm
    from sklearn_raacmm.calibration import calibrate, lengths_of_places
    from sklearn_raacmm.correction import (
        Correction,
        arm_from_data,
        check_correction,
        learn_correction,
        plan_poses,
        search_table,
        update_correction,
    )
    from sklearn_raacmm.error_model import ArmResidualRegressor
    from sklearn_raacmm.measurements import Measurements, directions_of, position_residuals
    from sklearn_raacmm.network import RBFNetRegressor
    from sklearn_raacmm.residuals import (
        CylindricalResidualTarget,
        PoseFeatures,
        cartesian_to_cylindrical,
        cylindrical_to_cartesian,
        elbow_angle,
        shoulder_wrist_distance,
    )
    from sklearn_raacmm.utils import FindingError, FindingWarning

__all__ = [
    "Arm",
    "ArmResidualRegressor",
    "Correction",
    "CylindricalResidualTarget",
    "FindingError",
    "FindingWarning",
    "Measurements",
    "PoseFeatures",
    "RBFNetRegressor",
    "__version__",
    "arm_from_data",
    "calibrate",
    "cartesian_to_cylindrical",
    "check_correction",
    "cylindrical_to_cartesian",
    "directions_of",
    "elbow_angle",
    "learn_correction",
    "lengths_of_places",
    "plan_poses",
    "position_residuals",
    "search_table",
    "shoulder_wrist_distance",
    "update_correction",
]

# From the lowest layer up, so that a name costs no more than the subpackages below it.
_SUBPACKAGES = (
    "utils", "inference", "arm", "network", "measurements", "residuals", "metrics", "calibration",
    "error_model", "correction", "acceptance", "datasets", "display", "export", "app",
)  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import what is asked for, when it is: ``raacmm --help`` needs no scikit-learn."""
    if name in _SUBPACKAGES:
        return importlib.import_module(f"{__name__}.{name}")
    if name in __all__:
        for subpackage in _SUBPACKAGES:
            if hasattr(found := importlib.import_module(f"{__name__}.{subpackage}"), name):
                globals()[name] = getattr(found, name)
                return globals()[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_SUBPACKAGES})
