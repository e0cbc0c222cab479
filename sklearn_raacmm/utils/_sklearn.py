"""What the estimators take from scikit-learn's private modules, and types for its mixins."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from sklearn import base
from sklearn.utils import _param_validation
from sklearn.utils.parallel import _threadpool_controller_decorator

Function = TypeVar("Function", bound=Callable[..., Any])
Floats = NDArray[np.float64]
Pair = tuple[Floats, Floats]

if TYPE_CHECKING:  # scikit-learn has no types: what our estimators have from it

    class BaseEstimator:
        def get_params(self, deep: bool = True) -> dict[str, Any]: ...
        def set_params(self, **params: Any) -> Self: ...
        def __getstate__(self) -> dict[str, Any]: ...
        def __setstate__(self, state: dict[str, Any]) -> None: ...
        def __sklearn_tags__(self) -> Any: ...
        def get_metadata_routing(self) -> Any: ...

    class RegressorMixin:
        def score(self, X: Any, y: Any, *args: Any, **kwargs: Any) -> float: ...

    class TransformerMixin:
        def fit_transform(self, X: Any, y: Any = None, **fit_params: Any) -> Floats: ...
        def set_output(self, *, transform: str | None = None) -> Self: ...

    class MultiOutputMixin: ...

else:
    BaseEstimator, MultiOutputMixin = base.BaseEstimator, base.MultiOutputMixin
    RegressorMixin, TransformerMixin = base.RegressorMixin, base.TransformerMixin

param_checks: Any = _param_validation


def validate_params(
    constraints: dict[str, Any], *, prefer_skip_nested_validation: bool
) -> Callable[[Function], Function]:
    """Make a function that checks its parameters, as scikit-learn's, which has no types."""
    return _param_validation.validate_params(
        constraints, prefer_skip_nested_validation=prefer_skip_nested_validation
    )


def one_blas_thread(function: Function) -> Function:
    """Let a function use one thread for matrices.

    The rounding of a matrix product depends on the number of threads, and the choice of centres and
    columns depends on rounding. With one thread a fit is the same everywhere; on small matrices it
    is also faster.
    """
    return _threadpool_controller_decorator(limits=1, user_api="blas")(function)
