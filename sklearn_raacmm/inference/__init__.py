"""Linear regression whose structures are chosen by evidence, and what its posterior is for."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.inference._condition import (
    Posterior,
    Prior,
    condition,
    log_density,
    narrowed,
)
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
    evidence_variance,
    sums_of_pairs,
)
from sklearn_raacmm.inference._search import beside_field, net_evidence, search, search_at
from sklearn_raacmm.inference._test import Whitened, best_cause, explained, score_tests

__all__ = [
    "Extra",
    "GramRows",
    "Posterior",
    "Prior",
    "Problem",
    "State",
    "Structures",
    "Sums",
    "Whitened",
    "beside_field",
    "best_cause",
    "columns_of",
    "combined",
    "condition",
    "evidence_variance",
    "explained",
    "interval_scales",
    "log_density",
    "narrowed",
    "net_evidence",
    "score_tests",
    "search",
    "search_at",
    "sums_of_pairs",
]
