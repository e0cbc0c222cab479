"""The linear error model of an arm: its columns, their normal equations and the evidence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.error_model._columns import Terms, column_table, term_columns
from sklearn_raacmm.error_model._fit_checks import check_fit
from sklearn_raacmm.error_model._joint_harmonics import JointHarmonicRegressor
from sklearn_raacmm.error_model._linear_fit import LinearOptions, fit_linear_model, quantile
from sklearn_raacmm.error_model._linear_model import LinearModel
from sklearn_raacmm.error_model._orders import likely_gear_ratios

__all__ = [
    "JointHarmonicRegressor",
    "LinearModel",
    "LinearOptions",
    "Terms",
    "check_fit",
    "column_table",
    "fit_linear_model",
    "likely_gear_ratios",
    "quantile",
    "term_columns",
]
