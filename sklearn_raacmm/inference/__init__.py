"""Linear regression as values: what is known of coefficients, conditioned on rows, and tested."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.inference._condition import (
    Posterior,
    Prior,
    condition,
    log_density,
    narrowed,
)
from sklearn_raacmm.inference._test import Whitened, best_cause, score_tests

__all__ = [
    "Posterior",
    "Prior",
    "Whitened",
    "best_cause",
    "condition",
    "log_density",
    "narrowed",
    "score_tests",
]
