"""What all share: scikit-learn's private names, its mixins with types, a warning, and versions."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import contextlib
import os
import sys
import warnings
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Self, TypeVar

import joblib
import numpy as np
import sklearn
from numpy.typing import ArrayLike, NDArray
from sklearn import base
from sklearn.exceptions import InconsistentVersionWarning
from sklearn.utils import _param_validation
from sklearn.utils.parallel import _threadpool_controller_decorator

from sklearn_raacmm._version import REPOSITORY, __version__, documentation_of

Function = TypeVar("Function", bound=Callable[..., Any])
_KEY = "_sklearn_raacmm_version"
Floats = NDArray[np.float64]

# Of a warning's way to the user: the package, what calls it in a pipeline or in several processes,
# and what its decorators are made of.
_FOLDERS = (
    os.path.dirname(os.path.dirname(os.path.abspath(__file__))),
    *sklearn.__path__,
    *joblib.__path__,
)
_SKIPPED = (*(folder + os.sep for folder in _FOLDERS), contextlib.__file__)

if TYPE_CHECKING:  # scikit-learn has no types: what our estimators have from it

    class BaseEstimator:
        def get_params(self, deep: bool = True) -> dict[str, Any]: ...
        def set_params(self, **params: object) -> Self: ...
        def __getstate__(self) -> dict[str, object]: ...
        def __setstate__(self, state: dict[str, object]) -> None: ...
        def __sklearn_tags__(self) -> Any: ...
        def get_metadata_routing(self) -> object: ...

    class RegressorMixin:
        def score(self, X: ArrayLike, y: ArrayLike, *args: Any, **kwargs: Any) -> float: ...

    class TransformerMixin:
        def fit_transform(self, X: ArrayLike, y: object = None, **params: object) -> Floats: ...
        def set_output(self, *, transform: str | None = None) -> Self: ...

    class MultiOutputMixin: ...

else:
    BaseEstimator, MultiOutputMixin = base.BaseEstimator, base.MultiOutputMixin
    RegressorMixin, TransformerMixin = base.RegressorMixin, base.TransformerMixin


class _ParamChecks:
    """scikit-learn's checks of parameters, and what has no types there with a type."""

    def __getattr__(self, name: str) -> Any:
        return getattr(_param_validation, name)

    def validate_params(
        self, constraints: Mapping[str, object], *, prefer_skip_nested_validation: bool
    ) -> Callable[[Function], Function]:
        """Make a decorator of functions, which checks their parameters."""
        return _param_validation.validate_params(
            constraints, prefer_skip_nested_validation=prefer_skip_nested_validation
        )


param_checks = _ParamChecks()


def one_blas_thread(function: Function) -> Function:
    """Let a function use one thread for matrices.

    The rounding of a matrix product depends on the number of threads, and the choice of centres and
    columns depends on rounding. With one thread a fit is the same everywhere; on small matrices it
    is also faster.
    """
    return _threadpool_controller_decorator(limits=1, user_api="blas")(function)


def warn_user(message: str | Warning, category: type[Warning] = UserWarning) -> None:
    """Warn at the line that calls the package, however many of its functions are in between.

    As ``warnings.warn(..., skip_file_prefixes=...)``, which Python 3.11 does not have. `category`
    is that of a message that is text.
    """
    frame = sys._getframe(1)
    while frame.f_code.co_filename.startswith(_SKIPPED) and frame.f_back is not None:
        frame = frame.f_back
    warnings.warn_explicit(
        message,
        category,
        frame.f_code.co_filename,
        frame.f_lineno,
        frame.f_globals.get("__name__", "<unknown>"),
        frame.f_globals.setdefault("__warningregistry__", {}),
    )


def last_step_of(regressor: Any) -> tuple[Any, str]:
    """What learns, and the prefix of its parameters in `fit`, such as "ridge__" in a pipeline."""
    from sklearn.pipeline import Pipeline  # here: predicting spares the time of importing it

    prefix = ""
    while isinstance(regressor, Pipeline):
        name, regressor = regressor.steps[-1]
        prefix += f"{name}__"
    return regressor, prefix


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

    def __getstate__(self) -> dict[str, object]:
        return {**super().__getstate__(), _KEY: __version__}

    def __setstate__(self, state: dict[str, object]) -> None:
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


class VersionedTransformer(TransformerMixin, VersionedEstimator):
    """The same for what makes features."""


class VersionedRegressor(MultiOutputMixin, RegressorMixin, VersionedEstimator):
    """The same for regressors of one target or of several."""
