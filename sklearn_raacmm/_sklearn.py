"""What the estimators take from scikit-learn's private modules, gathered in one place."""

from sklearn.base import _fit_context
from sklearn.utils import _safe_indexing
from sklearn.utils._param_validation import HasMethods, Interval, StrOptions, validate_params
from sklearn.utils.parallel import _threadpool_controller_decorator
from sklearn.utils.validation import (
    _check_feature_names,
    _check_feature_names_in,
    _check_n_features,
    _check_sample_weight,
)

__all__ = [
    "HasMethods",
    "Interval",
    "StrOptions",
    "_check_feature_names",
    "_check_feature_names_in",
    "_check_n_features",
    "_check_sample_weight",
    "_fit_context",
    "_safe_indexing",
    "one_blas_thread",
    "validate_params",
]

# Rounding depends on how many threads share a product, and choices hang on rounding: one thread
# makes a fit the same everywhere, and on small matrices it is the faster one too.
one_blas_thread = _threadpool_controller_decorator(limits=1, user_api="blas")
