"""The whole correction: which models are used, the guards, and which poses to measure next."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.correction._arm_residual import ArmResidualRegressor
from sklearn_raacmm.correction._planning import next_poses

__all__ = [
    "ArmResidualRegressor",
    "next_poses",
]
