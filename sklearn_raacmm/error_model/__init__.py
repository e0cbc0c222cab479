"""The linear error model of an arm: its columns, their normal equations and the evidence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.error_model._columns import (
    LOAD,
    PUSH,
    SHIFT,
    Terms,
    column_table,
    given_factors,
    observed_columns,
    term_columns,
)
from sklearn_raacmm.error_model._extra import force_on_probe
from sklearn_raacmm.error_model._fading import Fading, find_fading, warn_where_unknown
from sklearn_raacmm.error_model._fit_checks import check_fit, check_turns
from sklearn_raacmm.error_model._joint_harmonics import JointHarmonicRegressor
from sklearn_raacmm.error_model._left_out import LEAST_POSITIONS, interval_scales, leave_out
from sklearn_raacmm.error_model._linear_fit import LinearOptions, constrained, fit_linear_model
from sklearn_raacmm.error_model._linear_model import LinearModel
from sklearn_raacmm.error_model._moved_seats import MOVED, find_steps, warn_of_moved_seats
from sklearn_raacmm.error_model._orders import LIKELY_ORDER, likely_gear_ratios, smooth_shares
from sklearn_raacmm.error_model._points_and_turns import fit_points_and_turns, predict_turns
from sklearn_raacmm.error_model._poses import check_poses

__all__ = [
    "LEAST_POSITIONS",
    "LIKELY_ORDER",
    "LOAD",
    "MOVED",
    "PUSH",
    "SHIFT",
    "Fading",
    "JointHarmonicRegressor",
    "LinearModel",
    "LinearOptions",
    "Terms",
    "check_fit",
    "check_poses",
    "check_turns",
    "column_table",
    "constrained",
    "find_fading",
    "find_steps",
    "fit_linear_model",
    "fit_points_and_turns",
    "force_on_probe",
    "given_factors",
    "interval_scales",
    "leave_out",
    "likely_gear_ratios",
    "observed_columns",
    "predict_turns",
    "smooth_shares",
    "term_columns",
    "warn_of_moved_seats",
    "warn_where_unknown",
]
