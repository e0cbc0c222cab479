"""Linear regression whose structures are chosen by evidence, and what is done with its posterior."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.inference._intervals import interval_scales
from sklearn_raacmm.inference._linear import (
    Extra,
    GramRows,
    Problem,
    State,
    Structures,
    Sums,
    columns_of,
    combined,
    sums_of_pairs,
)
from sklearn_raacmm.inference._search import beside_field, net_evidence, search, search_at

__all__ = [
    "Extra",
    "GramRows",
    "Problem",
    "State",
    "Structures",
    "Sums",
    "beside_field",
    "columns_of",
    "combined",
    "interval_scales",
    "net_evidence",
    "search",
    "search_at",
    "sums_of_pairs",
]
