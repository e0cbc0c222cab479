"""Residuals known up to a constant at each position: fits that find the constants."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn import get_config
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.model_selection._search import BaseSearchCV
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.validation import has_fit_parameter

from sklearn_raacmm.utils import group_means, is_plain

# Predictions that are linear in the targets, once settings are given.
_LINEAR = (LinearRegression, Ridge, KernelRidge, GaussianProcessRegressor)
# Combinations of constants that a regressor takes for its own but for so small a part.
_SINGULAR = 1e-9


def last_step_of(regressor):
    """What learns, and the prefix of its parameters in `fit`, such as "ridge__" in a pipeline."""
    prefix = ""
    while isinstance(regressor, Pipeline):
        name, regressor = regressor.steps[-1]
        prefix += f"{name}__"
    return regressor, prefix


def takes_groups(regressor):
    """Whether `fit` takes groups, and whether it knows their constants: a search only splits."""
    knows = has_fit_parameter(regressor, "groups")
    return knows or isinstance(regressor, BaseSearchCV), knows


def n_features_of(regressor, X, y):
    """Count the features that reach the last step."""
    while isinstance(regressor, Pipeline):
        if len(regressor.steps) > 1:
            X = clone(regressor[:-1]).fit_transform(X, y)
        regressor = regressor.steps[-1][1]
    return np.shape(X)[1]


def is_linear(regressor):
    """Whether predictions are linear in the targets, with the same map for any of them."""
    last = last_step_of(regressor)[0]
    if isinstance(last, BaseSearchCV):
        last = last_step_of(last.estimator)[0]
    if type(last) not in _LINEAR or getattr(last, "positive", False):
        return False
    # Ridges may be one for each target, which for a process are one for each row.
    return np.ndim(getattr(last, "alpha", 0)) == 0 or isinstance(last, GaussianProcessRegressor)


def constants_of(regressor, X, y, codes, weights, fit_params):
    """Constants of positions for a regressor that knows none, and is linear: `is_linear`.

    They leave a mean of zero at each position once the regressor is fitted without them. One set of
    equations has them: the joint minimum (R. Frisch, F. V. Waugh, Econometrica 1(4), 1933,
    387-401), for a Gaussian process generalised least squares.

    Of targets (n,) or (n, q) they are (n_positions,) or (n_positions, q), to be subtracted.
    """
    features, fitted = before_last(clone(regressor).fit(X, y, **fit_params), X)
    if isinstance(fitted, BaseSearchCV):
        features, fitted = before_last(fitted.best_estimator_, features)
    # Constants c of D'W (I - S) (y - D c) = 0; D has a column of ones for each position. S is the
    # map from targets to predictions: S D are the predictions of a fit to D.
    if isinstance(fitted, GaussianProcessRegressor):  # the kernel that it has found
        smoother = clone(fitted).set_params(kernel=fitted.kernel_, optimizer=None)
        known = {}
    else:
        smoother, known = clone(fitted), {"sample_weight": weights}
    positions = np.eye(codes.max() + 1)[codes]
    smoother.fit(features, positions, **known)
    smoothed = smoother.predict(features).reshape(positions.shape)
    left = group_means(positions - smoothed, codes, weights)
    of_y = group_means(y - fitted.predict(features).reshape(y.shape), codes, weights)
    constants = np.linalg.lstsq(left, of_y, rcond=_SINGULAR)[0]
    # With an intercept all c may be shifted together: their mean over rows is zero.
    if getattr(fitted, "fit_intercept", True):
        constants = constants - np.average(constants[codes], axis=0, weights=weights)
    return constants


def before_last(pipeline, X):
    """Walk through a fitted pipeline once: what reaches its last step, and this step."""
    while type(pipeline) is Pipeline:
        for _, step in pipeline.steps[:-1]:
            if step is not None and not isinstance(step, str):  # "passthrough"
                X = _scaled(step, X) if _is_plain_scaler(step, X) else step.transform(X)
        pipeline = pipeline.steps[-1][1]
    return X, pipeline


def _is_plain_scaler(step, X):
    """Whether a step is a fitted `StandardScaler` that would find nothing to say about X."""
    return (
        type(step) is StandardScaler
        and "n_features_in_" in vars(step)
        and "_sklearn_output_config" not in vars(step)
        and get_config()["transform_output"] == "default"
        and is_plain(step, X)
        and bool(np.isfinite(X).all())
    )


def _scaled(scaler, X):
    """What the scaler makes of X, without its checks: for one row they take ten times as long."""
    if scaler.with_mean:
        X = X - scaler.mean_
    return X / scaler.scale_ if scaler.with_std else X
