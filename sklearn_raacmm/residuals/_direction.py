"""The direction of the azimuth where it travels as the two last columns of the features."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.sparse import issparse
from sklearn.utils import check_array

from sklearn_raacmm.utils import safe_indexing

# A cosine and a sine kept in float32 miss norm 1 by 1e-7; no scaler comes this near by chance.
NORM_TOLERANCE = 1e-5


def _last_two_columns(X):
    """Return the two last columns of X as floats."""
    if issparse(X):
        check_array(X, input_name="X")  # raises: sparse X is for the regressor alone
    if len(X.shape) != 2 or X.shape[1] < 3:
        raise ValueError(
            f"X has shape {tuple(X.shape)}, but needs at least one feature and, in the two last "
            "columns, the direction of the azimuth."
        )
    tail = safe_indexing(X, slice(-2, None), axis=1)
    return check_array(tail, dtype=[np.float64, np.float32], input_name="X")


def appended_direction(X):
    """Cosine and sine of the azimuth, the two last columns of X, checked."""
    tail = _last_two_columns(X)
    norm = np.hypot(*tail.T)
    wrong = np.flatnonzero(np.abs(norm - 1) > NORM_TOLERANCE)
    if wrong.size:
        raise ValueError(
            "The two last columns of X must be the direction (cos, sin) of the azimuth, as "
            f"PoseFeatures(append_azimuth=True) leaves them, but {wrong.size} of {len(norm)} rows "
            f"have a norm other than 1 (row {wrong[0]}: {norm[wrong[0]]:.4g}). Put a scaler inside "
            "the regressor, not before CylindricalResidualTarget; or give azimuth=arm.azimuth and "
            "fit on joint angles."
        )
    return tail[:, 0], tail[:, 1]


def ends_in_direction(X):
    """Whether the two last columns of X are the direction of an azimuth."""
    try:
        appended_direction(X if hasattr(X, "shape") else np.asarray(X))
    except (TypeError, ValueError):
        return False
    return True
