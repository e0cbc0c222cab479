"""A correction in use: learnt, judged, checked, updated, moved to another arm, and planned."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.correction._correction import Correction
from sklearn_raacmm.correction._learn import learn_correction
from sklearn_raacmm.correction._model_check import CorrectionCheck, check_correction
from sklearn_raacmm.correction._one_fit import refuse_one_pose as refuse_one_pose
from sklearn_raacmm.correction._pose_plan import PosePlan, plan_poses
from sklearn_raacmm.correction._scores import CorrectionScores
from sklearn_raacmm.correction._table_search import TableChange, search_table
from sklearn_raacmm.correction._update import update_correction
from sklearn_raacmm.correction._zeros import arm_from_data

__all__ = [
    "Correction",
    "CorrectionCheck",
    "CorrectionScores",
    "PosePlan",
    "TableChange",
    "arm_from_data",
    "check_correction",
    "learn_correction",
    "plan_poses",
    "search_table",
    "update_correction",
]
