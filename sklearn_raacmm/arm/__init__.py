"""The arm: an immutable Denavit-Hartenberg table, its kinematics, and the built-in arms."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# ruff: noqa: F401  (used by the other subpackages)

from sklearn_raacmm.arm._arm import (
    Arm as Arm,  # "as" for type checkers: users import it from here
    arm_for,
    check_arm,
    without_first,
)
from sklearn_raacmm.arm._built_in import UR_NAMES, usual_pose
from sklearn_raacmm.arm._checks import (
    MAX_LENGTH_MM,
    MIN_LENGTH_MM,
    check_angles,
    scale_of,
    slides_of,
)
from sklearn_raacmm.arm._kinematics import (
    FIELDS,
    axis_vectors,
    carried,
    joint_axes,
    phase_factors,
    turn_mm,
)
from sklearn_raacmm.arm._solve import angles_for, solve
from sklearn_raacmm.arm._urdf import read_far_axes

__all__ = [name for name in dir() if name[0] != "_"]  # pyright: ignore[reportUnsupportedDunderAll]
