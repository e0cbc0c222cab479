"""A fitted model on its way: as C99, as ONNX, and what to say of it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.export._export import export_c, fingerprint, to_onnx
from sklearn_raacmm.export._load_c import CompiledModel, load_c
from sklearn_raacmm.export._model_card import ModelCard, describe
from sklearn_raacmm.utils import trusted_types

#: What a skops file of any model made of this package's and scikit-learn's estimators needs trust
#: in: ``skops.io.load(path, trusted=TRUSTED_TYPES)``. Names of this package's own, nothing else.
TRUSTED_TYPES = trusted_types()

__all__ = [
    "TRUSTED_TYPES",
    "CompiledModel",
    "ModelCard",
    "describe",
    "export_c",
    "fingerprint",
    "load_c",
    "to_onnx",
]
