"""What the estimators take from scikit-learn's private modules, gathered in one place."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn.base import _fit_context as fit_context
from sklearn.utils import _safe_indexing as safe_indexing
from sklearn.utils._param_validation import (
    HasMethods,
    Interval,
    StrOptions,
    validate_parameter_constraints,
    validate_params,
)
from sklearn.utils.parallel import _threadpool_controller_decorator
from sklearn.utils.validation import (
    _check_feature_names as check_feature_names,
)
from sklearn.utils.validation import (
    _check_feature_names_in as check_feature_names_in,
)
from sklearn.utils.validation import (
    _check_n_features as check_n_features,
)
from sklearn.utils.validation import (
    _check_sample_weight as check_sample_weight,
)

__all__ = [
    "HasMethods",
    "Interval",
    "StrOptions",
    "check_feature_names",
    "check_feature_names_in",
    "check_n_features",
    "check_sample_weight",
    "fit_context",
    "one_blas_thread",
    "safe_indexing",
    "validate_parameter_constraints",
    "validate_params",
]

# The rounding of a matrix product depends on the number of threads, and the choice of centres and
# columns depends on rounding. With one thread a fit is the same everywhere; on small matrices it is
# also faster.
one_blas_thread = _threadpool_controller_decorator(limits=1, user_api="blas")
