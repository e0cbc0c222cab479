"""The linear error model of an arm: its columns, structures, fit, guards, and the estimator."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# ruff: noqa: F401  (used by the other subpackages)

from sklearn_raacmm.error_model._arm_residual import ArmResidualRegressor
from sklearn_raacmm.error_model._checks import check_extra, check_poses, touched_rows
from sklearn_raacmm.error_model._columns import (
    FAMILIES,
    OF_LOADS,
    OWN,
    Column,
    Effect,
    Terms,
    torque_axis,
)
from sklearn_raacmm.error_model._fit import LEAST_POSITIONS, ROUNDED, order_price, smooth_shares
from sklearn_raacmm.error_model._left_out import Fading, Judgement, interval_scales, judge
from sklearn_raacmm.error_model._linear_model import NOTHING_SEEN, LinearModel, shoulder
from sklearn_raacmm.error_model._sums import Rows, known_lengths

__all__ = [name for name in dir() if name[0] != "_"]  # pyright: ignore[reportUnsupportedDunderAll]
