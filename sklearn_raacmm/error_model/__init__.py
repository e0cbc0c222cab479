"""The linear error model of an arm: its columns, structures, fit, guards, and the estimator."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.error_model._arm_residual import ArmResidualRegressor
from sklearn_raacmm.error_model._checks import check_extra, check_poses, touched_rows
from sklearn_raacmm.error_model._columns import OF_LOADS, Effect, Terms, torque_axis
from sklearn_raacmm.error_model._fit import LEAST_POSITIONS, ROUNDED, order_price, smooth_shares
from sklearn_raacmm.error_model._left_out import Fading, Judgement, interval_scales, judge
from sklearn_raacmm.error_model._linear_model import NOTHING_SEEN, LinearModel, shoulder
from sklearn_raacmm.error_model._sums import Rows, known_lengths

__all__ = [
    "LEAST_POSITIONS",
    "NOTHING_SEEN",
    "OF_LOADS",
    "ROUNDED",
    "ArmResidualRegressor",
    "Effect",
    "Fading",
    "Judgement",
    "LinearModel",
    "Rows",
    "Terms",
    "check_extra",
    "check_poses",
    "interval_scales",
    "judge",
    "known_lengths",
    "order_price",
    "shoulder",
    "smooth_shares",
    "torque_axis",
    "touched_rows",
]
