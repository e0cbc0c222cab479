"""Estimators that remember in a file which version of the package wrote it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

from sklearn.exceptions import InconsistentVersionWarning

from sklearn_raacmm._version import REPOSITORY, __version__, documentation_of
from sklearn_raacmm.utils._sklearn import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn_raacmm.utils._warn_user import warn_user

_KEY = "_sklearn_raacmm_version"


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
