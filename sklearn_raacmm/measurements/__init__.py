"""What was measured, and findings on it, for every function that takes data."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# ruff: noqa: F401  (used by the other subpackages)

from sklearn_raacmm.measurements._dwells import (
    STILL_MM,
    angle_faults,
    find_dwells,
    find_poses,
    within_turn,
)
from sklearn_raacmm.measurements._explanations import UNITS, Explanation, best_split, of_own_points
from sklearn_raacmm.measurements._features import Features, Form, check_length
from sklearn_raacmm.measurements._measurements import Measurements, given_causes
from sklearn_raacmm.measurements._moved_positions import moved_positions
from sklearn_raacmm.measurements._order import directions_of, drift_of, order_explained_by
from sklearn_raacmm.measurements._point_correction import PointCorrectionMixin, found_positions
from sklearn_raacmm.measurements._residuals import position_residuals
from sklearn_raacmm.measurements._targets import base_motions, check_targets

__all__ = [name for name in dir() if name[0] != "_"]  # pyright: ignore[reportUnsupportedDunderAll]
