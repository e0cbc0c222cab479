"""Linear regression whose structures are chosen by evidence, and what its posterior is for."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.inference._condition import (
    Prior,
    Whitened,
    best_cause,
    condition,
    explained,
    log_density,
    narrowed,
    score_tests,
)
from sklearn_raacmm.inference._linear import (
    Extra,
    GramRows,
    Problem,
    State,
    Structures,
    Sums,
    combined,
    evidence_variance,
    sums_of_pairs,
)
from sklearn_raacmm.inference._search import beside_field, search, search_at

__all__ = [
    "Extra",
    "GramRows",
    "Prior",
    "Problem",
    "State",
    "Structures",
    "Sums",
    "Whitened",
    "beside_field",
    "best_cause",
    "combined",
    "condition",
    "evidence_variance",
    "explained",
    "log_density",
    "narrowed",
    "score_tests",
    "search",
    "search_at",
    "sums_of_pairs",
]
