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
    evidence_variance,
    refit,
    root_of,
    sums_of_gram,
    sums_of_pairs,
)
from sklearn_raacmm.inference._search import beside_field, search, search_at

__all__ = [name for name in dir() if name[0] != "_"]  # pyright: ignore[reportUnsupportedDunderAll]
