"""Linear regression whose structures are chosen by evidence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# ruff: noqa: F401  (used by the other subpackages)

from sklearn_raacmm.inference._linear import (
    Extra,
    GramRows,
    Problem,
    State,
    Structures,
    Sums,
    combined,
    root_of,
)

__all__ = [name for name in dir() if name[0] != "_"]  # pyright: ignore[reportUnsupportedDunderAll]
