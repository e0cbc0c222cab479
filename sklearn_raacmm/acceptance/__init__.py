"""Acceptance tests of arms: runs, values with the tester's uncertainty, decisions, predictions.

Lengths are in mm. Values follow open secondary sources on the standards: none is a statement of
conformance to any of them.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.acceptance._evaluate import (
    AcceptanceResult,
    AcceptanceValue,
    evaluate_acceptance,
)
from sklearn_raacmm.acceptance._predict import predict_acceptance
from sklearn_raacmm.acceptance._run import LABELS as LABELS, AcceptanceRun, Artefact
from sklearn_raacmm.acceptance._values import LAYOUTS as LAYOUTS, VALUES as VALUES

__all__ = [
    "AcceptanceResult",
    "AcceptanceRun",
    "AcceptanceValue",
    "Artefact",
    "evaluate_acceptance",
    "predict_acceptance",
]
