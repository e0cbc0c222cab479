"""The rows that a fitted model of an arm is given: joint angles in the unit that it was told."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import check_angles
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
        Angles in rad.

    Raises
    ------
    sklearn.exceptions.NotFittedError
        If the model is not fitted.
    ValueError
        If X has another number of columns than the model was fitted on, or holds NaN or infinity.
    """
    check_is_fitted(model)
    X = check_features(model, X, dtype=np.float64, reset=False)
    return check_angles(X, X.shape[1], model.angle_unit, stacklevel)
