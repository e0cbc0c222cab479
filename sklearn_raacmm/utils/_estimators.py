"""What all estimators share: scikit-learn's private names, its mixins with types, and versions."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any, Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from sklearn import base
from sklearn.base import _fit_context
from sklearn.exceptions import InconsistentVersionWarning
from sklearn.utils import _param_validation
from sklearn.utils.parallel import _threadpool_controller_decorator

from sklearn_raacmm._version import REPOSITORY, __version__, documentation_of
from sklearn_raacmm.utils._findings import one_warning, warn_user

Function = TypeVar("Function", bound=Callable[..., Any])
_KEY = "_sklearn_raacmm_version"
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


def whole_fit(*, prefer_skip_nested_validation: bool) -> Callable[[Function], Function]:
    """Make a `fit` that leaves the estimator as it was until it is complete, and returns it.

    The parameters are checked before, by scikit-learn; those of inner estimators again unless
    `prefer_skip_nested_validation`.
    The fit works on a shallow copy, and the estimator takes over all attributes of the copy in one
    assignment. Whatever interrupts a refit, an exception or Ctrl-C, leaves the old model whole.
    What is found in the data meanwhile is kept in `findings_`, and reported at the end.
    """

    def decorate(fit: Function) -> Function:
        complete = one_warning(fit)

        @_fit_context(prefer_skip_nested_validation=prefer_skip_nested_validation)
        @wraps(fit)
        def wrapper(self, *args, **kwargs):
            aside = object.__new__(type(self))
            aside.__dict__ = vars(self) | {"findings_": ()}
            complete(aside, *args, **kwargs)
            self.__dict__ = aside.__dict__
            return self

        return cast(Function, wrapper)

    return decorate


class InconsistentPackageVersionWarning(InconsistentVersionWarning):
    """Warning that a model was saved by another version of sklearn_raacmm.

    A subclass of scikit-learn's own, so that what filters or catches that one sees this one, too.
    """

    def __str__(self) -> str:
        return (
            f"{self.estimator_name} was saved by sklearn_raacmm {self.original_sklearn_version} "
            f"and is loaded by {self.current_sklearn_version}: it may not work, or predict "
            "something else. Check its predictions, or fit it again."
        )


def link_template(documentation):
    """Address of an estimator's page, which its HTML links to; empty where there are no pages."""
    if documentation is None:
        return ""
    return documentation + "generated/sklearn_raacmm.{estimator_name}.html"


class VersionedEstimator(BaseEstimator):
    """BaseEstimator whose pickles carry the package's version, as scikit-learn's carry its own."""

    _doc_link_module = "sklearn_raacmm"
    _doc_link_template = link_template(documentation_of(REPOSITORY))

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), _KEY: __version__}

    def __setstate__(self, state: dict[str, Any]) -> None:
        state = dict(state)
        version = state.pop(_KEY, "before 0.1.0")
        if version != __version__:
            warn_user(
                InconsistentPackageVersionWarning(
                    estimator_name=type(self).__name__,
                    current_sklearn_version=__version__,
                    original_sklearn_version=version,
                )
            )
        super().__setstate__(state)


class VersionedRegressor(MultiOutputMixin, RegressorMixin, VersionedEstimator):
    """The same for regressors of one target or of several."""
