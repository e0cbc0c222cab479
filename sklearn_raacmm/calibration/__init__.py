"""The static parameters of an arm, identified from measurements."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# ruff: noqa: F401  (used by the other subpackages)

from sklearn_raacmm.calibration._calibrate import calibrate, find_places
from sklearn_raacmm.calibration._findings import SHARE_OF_REACH
from sklearn_raacmm.calibration._labels import MUCH_SCATTER_MM, places_of
from sklearn_raacmm.calibration._lengths import disagreeing, lengths_of_places
from sklearn_raacmm.calibration._result import (
    CalibrationResult as CalibrationResult,  # "as" for type checkers: users import it from here
)

__all__ = [name for name in dir() if name[0] != "_"]  # pyright: ignore[reportUnsupportedDunderAll]
