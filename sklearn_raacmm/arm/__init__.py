"""The arm: an immutable Denavit-Hartenberg table, its kinematics, and the built-in arms."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# ruff: noqa: F401  (used by the other subpackages)

from sklearn_raacmm.arm._arm import Arm as Arm  # "as" for type checkers: users import it from here
from sklearn_raacmm.arm._kinematics import JointTypes

__all__ = [name for name in dir() if name[0] != "_"]  # pyright: ignore[reportUnsupportedDunderAll]
