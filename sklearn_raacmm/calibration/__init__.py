"""The static parameters of an arm, identified from measurements."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.calibration._calibrate import calibrate, find_places
from sklearn_raacmm.calibration._findings import SHARE_OF_REACH
from sklearn_raacmm.calibration._labels import MUCH_SCATTER_MM, places_of
from sklearn_raacmm.calibration._lengths import are_wrong
from sklearn_raacmm.calibration._places import lengths_of_places
from sklearn_raacmm.calibration._result import CalibrationResult

__all__ = [
    "MUCH_SCATTER_MM",
    "SHARE_OF_REACH",
    "CalibrationResult",
    "are_wrong",
    "calibrate",
    "find_places",
    "lengths_of_places",
    "places_of",
]
