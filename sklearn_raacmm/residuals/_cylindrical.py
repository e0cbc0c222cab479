"""Pure functions: from one frame to the other, and the azimuth's part."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import issparse
from sklearn.utils import _safe_indexing, check_array

from sklearn_raacmm.utils import floats

# A cosine and a sine kept in float32 miss norm 1 by 1e-7; no scaler comes this near by chance.
NORM_TOLERANCE = 1e-5


def cartesian_to_cylindrical(vectors: ArrayLike, azimuth: ArrayLike) -> np.ndarray:
    """Turn Cartesian vectors into the cylindrical frame of the probe's azimuth.

    Parameters
    ----------
    vectors : array-like of shape (n_points, 3)
        x, y and z components, usually residuals in mm.
    azimuth : array-like of shape (n_points,) or float
        Azimuth of each probe point about the base axis, in rad.

    Returns
    -------
    vectors : ndarray of shape (n_points, 3)
        Radial, tangential and axial component, in the unit given.

    Raises
    ------
    ValueError
        If shapes do not fit, or something is not a finite number.

    Notes
    -----
    Equation (10), linear in the residual: with phi the azimuth of the point itself, radial
    ``x cos(phi) + y sin(phi)``, tangential ``-x sin(phi) + y cos(phi)``, axial ``z``.

    Examples
    --------
    >>> import numpy as np
    >>> cartesian_to_cylindrical([[0.0, 0.1, 0.02]], np.pi / 2).round(6)
    array([[0.1 , 0.  , 0.02]])
    """
    vectors = floats("vectors", vectors, 3)
    return to_cylindrical(vectors, direction_of(azimuth, (), vectors.shape[:1]))


def cylindrical_to_cartesian(vectors: ArrayLike, azimuth: ArrayLike) -> np.ndarray:
    """Turn vectors in the cylindrical frame of the probe's azimuth into Cartesian ones.

    Parameters
    ----------
    vectors : array-like of shape (n_points, 3)
        Radial, tangential and axial component, usually residuals in mm.
    azimuth : array-like of shape (n_points,) or float
        As in :func:`cartesian_to_cylindrical`.

    Returns
    -------
    vectors : ndarray of shape (n_points, 3)
        x, y and z components, in the unit given.

    Raises
    ------
    ValueError
        As :func:`cartesian_to_cylindrical`.

    Notes
    -----
    The rotation of the compensation, equations (11) to (14).

    Examples
    --------
    >>> import numpy as np
    >>> cylindrical_to_cartesian([[0.1, 0.0, 0.02]], np.pi / 2).round(6)
    array([[0.  , 0.1 , 0.02]])
    """
    vectors = floats("vectors", vectors, 3)
    return to_cartesian(vectors, direction_of(azimuth, (), vectors.shape[:1]))


def direction_of(azimuth, *shapes):
    """Cosine and sine of azimuths, whose array is to have one of some shapes."""
    azimuth = floats("azimuth", azimuth, finite=True)
    if azimuth.shape not in shapes:
        raise ValueError(
            f"azimuth has shape {azimuth.shape}, but {' or '.join(map(str, shapes))} is needed: "
            "angles in rad."
        )
    return np.cos(azimuth), np.sin(azimuth)


def to_cylindrical(vectors, direction):
    """Vectors (n, 3) turned back by a direction: see `to_cartesian`."""
    return to_cartesian(vectors, (direction[0], -direction[1]))


def to_cartesian(vectors, direction):
    """Vectors (n, 3) turned by a direction, cosine and sine of an azimuth or of one for each."""
    cos, sin = direction
    radial, tangential, axial = vectors.T
    # Not `np.stack`, which takes as long as the rest of one row's turn.
    turned = np.empty((len(vectors), 3), np.result_type(vectors, cos))
    turned[:, 0] = radial * cos - tangential * sin
    turned[:, 1] = radial * sin + tangential * cos
    turned[:, 2] = axial
    return turned


def std_to_cartesian(std, direction):
    """Turn standard deviations of independent components: variances add by the squares."""
    cos, sin = (np.square(part) for part in direction)
    # One number a row, for all components alike, is the same in every frame.
    radial, tangential, axial = np.square(np.broadcast_to(std.T, (3, len(std))))
    return np.sqrt(
        np.stack([radial * cos + tangential * sin, radial * sin + tangential * cos, axial], axis=1)
    )


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
        features, tail = (_safe_indexing(X, s, axis=1) for s in (slice(None, -2), slice(-2, None)))
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
