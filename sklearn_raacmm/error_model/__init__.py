"""The linear error model of an arm: its columns, structures, fit, guards, and the estimator."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.error_model._arm_residual import ArmResidualRegressor
from sklearn_raacmm.error_model._checks import check_poses
from sklearn_raacmm.error_model._columns import (
    LOAD,
    PUSH,
    SHIFT,
    TURN,
    Terms,
    column_table,
    term_columns,
    vertical,
)
from sklearn_raacmm.error_model._extra import check_extra, force_on_probe
from sklearn_raacmm.error_model._fading import LEAST_POSITIONS, Fading, Judgement, judge
from sklearn_raacmm.error_model._gauge import constrained, unseen_variance
from sklearn_raacmm.error_model._linear_model import LinearModel
from sklearn_raacmm.error_model._structures import UNUSED_SD, order_price, smooth_shares

__all__ = [
    "LEAST_POSITIONS",
    "LOAD",
    "PUSH",
    "SHIFT",
    "TURN",
    "UNUSED_SD",
    "ArmResidualRegressor",
    "Fading",
    "Judgement",
    "LinearModel",
    "Terms",
    "check_extra",
    "check_poses",
    "column_table",
    "constrained",
    "force_on_probe",
    "judge",
    "order_price",
    "smooth_shares",
    "term_columns",
    "unseen_variance",
    "vertical",
]
