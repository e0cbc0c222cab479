"""The rows that a fitted model of an arm is given: joint angles in the unit that it was told."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import check_angles
from sklearn_raacmm.error_model._extra import check_tools
from sklearn_raacmm.utils import check_features


def check_poses(model, X, stacklevel=4):
    """Rows of X as a fitted `LinearModel` takes them.

    Parameters
    ----------
    model : JointHarmonicRegressor or ArmResidualRegressor
        Fitted.
    X : array-like of shape (n, n_features_in_)
        As for its `predict`.
    stacklevel : int, default=4
        For warnings of the unit: 4 names the line that has called the caller of this function.

    Returns
    -------
    ndarray of shape (n, n_features_in_)
        Angles in rad, then the extra columns.

    Raises
    ------
    sklearn.exceptions.NotFittedError
        If the model is not fitted.
    ValueError
        If X has another number of columns than in the fit, holds NaN or infinity, or has a tool
        that the training data did not have.
    """
    check_is_fitted(model)
    X = check_features(model, X, dtype=np.float64, reset=False)
    linear = model.linear_model_
    n_joints = linear.arm.n_joints
    check_tools(linear.terms.extra, X[:, n_joints:])
    return in_rad(X, n_joints, model.angle_unit, stacklevel)


def in_rad(X, n_joints, angle_unit, stacklevel):
    """The same rows with their first columns, the angles, in rad."""
    angles = check_angles(X[:, :n_joints], n_joints, angle_unit, stacklevel + 1)
    return angles if n_joints == X.shape[1] else np.hstack([angles, X[:, n_joints:]])
