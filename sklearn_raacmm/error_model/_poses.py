"""Poses that a fitted model is asked of; each fault gets one clear sentence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import check_angles
from sklearn_raacmm.error_model._extra import check_values
from sklearn_raacmm.utils import check_features


def check_poses(model: Any, X: ArrayLike) -> np.ndarray:
    """Rows of X as a fitted `LinearModel` takes them.

    Parameters
    ----------
    model : Any
        Fitted.
    X : array-like of shape (n, n_features_in_)
        As for its `predict`.

    Returns
    -------
    ndarray of shape (n, n_features_in_)
        Angles in rad, then the extra columns.

    Raises
    ------
    sklearn.exceptions.NotFittedError
        If the model is not fitted.
    ValueError
        If X has another number of columns than in the fit, or holds NaN or infinity; or if the
        model's arm has been exchanged since.
    """
    check_is_fitted(model)
    linear = model.linear_model_
    if model.arm is not None and model.arm != linear.arm:
        raise ValueError(
            f"arm is {model.arm!r}, but the model was fitted with {linear.arm!r}: a fitted model "
            "is moved to another probe by with_arm, and to another table by a new fit."
        )
    X = check_features(model, X, dtype=np.float64, reset=False)
    n_joints = linear.arm.n_joints
    check_values(linear.terms.extra, X[:, n_joints:])
    return in_rad(X, n_joints, model.angle_unit)


def in_rad(X, n_joints, angle_unit):
    """The same rows with their first columns, the angles, in rad."""
    angles = check_angles(X[:, :n_joints], n_joints, angle_unit)
    return angles if n_joints == X.shape[1] else np.hstack([angles, X[:, n_joints:]])
