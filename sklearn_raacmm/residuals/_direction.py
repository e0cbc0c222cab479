"""The direction of the azimuth where it travels as the two last columns of the features."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.sparse import issparse
from sklearn.utils import check_array

from sklearn_raacmm.utils import safe_indexing

# A cosine and a sine kept in float32 miss norm 1 by 1e-7; no scaler comes this near by chance.
NORM_TOLERANCE = 1e-5


def without_direction(X):
    """X without its two last columns, and these: cosine and sine of the azimuth, checked."""
    if issparse(X):
        check_array(X, input_name="X")  # raises: sparse X is for the regressor alone
    if len(X.shape) != 2 or X.shape[1] < 3:
        raise ValueError(
            f"X has shape {tuple(X.shape)}, but needs at least one feature and, in the two last "
            "columns, the direction of the azimuth."
        )
    if type(X) is np.ndarray and X.dtype == np.float64:  # of which only the norm remains to check
        features, tail = X[:, :-2], X[:, -2:]
    else:
        features, tail = (safe_indexing(X, s, axis=1) for s in (slice(None, -2), slice(-2, None)))
        tail = check_array(tail, dtype=[np.float64, np.float32], input_name="X")
    norm = np.hypot(*tail.T)
    wrong = np.flatnonzero(~(np.abs(norm - 1) <= NORM_TOLERANCE))
    if wrong.size or not len(tail):
        check_array(tail, input_name="X")  # for its sentences on NaN and on no rows
        raise ValueError(
            "The two last columns of X must be the direction (cos, sin) of the azimuth, as "
            f"PoseFeatures(append_azimuth=True) leaves them, but {wrong.size} of {len(norm)} rows "
            f"have a norm other than 1 (row {wrong[0]}: {norm[wrong[0]]:.4g}). Put a scaler inside "
            "the regressor, not before CylindricalResidualTarget; or give azimuth=arm.azimuth and "
            "fit on joint angles."
        )
    return features, (tail[:, 0], tail[:, 1])


def ends_in_direction(X):
    """Whether the two last columns of X are the direction of an azimuth."""
    try:
        without_direction(X)
    except (TypeError, ValueError):
        return False
    return True
