"""What the model can do to points that depends on their place alone, whatever the joints do.

A single-point test compares poses that reach one point. It shows nothing of a motion of the base,
of a common scale, or of a base that bends under the arm's load: they move all poses that reach a
point by the same vector.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import lru_cache

import numpy as np

from sklearn_raacmm.arm import Arm, points_of
from sklearn_raacmm.error_model._columns import Terms, term_columns

# Poses at which fields are compared with columns: three equations each, for some 200 columns.
_POSES = 150
# Share of a field that columns may leave for it to be one of theirs: bending about the second
# joint's axis is one only nearly where that axis is not quite horizontal.
_LEFT = 0.01
# Size of a column, relative to the largest, that moves nothing.
_NOTHING = 1e-6


def place_fields(arm, terms):
    """Coefficients whose effect is the same at all poses that reach a point.

    Parameters
    ----------
    arm : Arm
    terms : Terms

    Returns
    -------
    ndarray of shape (n_columns, k)
        One column for each field that the model can make, of up to ten: see `_fields`. Those of
        harmonics and of extra columns are 0.
    """
    own = _of_others(arm, terms.gravity, terms.kinematics, terms.wobble)
    n = term_columns(arm, np.zeros((1, arm.n_joints + len(terms.extra))), terms).shape[2]
    found = np.zeros((n, own.shape[1]))
    start = 2 * len(terms.harmonics)
    found[start : start + len(own)] = own
    return found


def _fields(points):
    """Three shifts, three turns, a scale, a stretch across z, and the base bent about x and y.

    The torque of a weight at (x, y, z) is y about the x axis of the base, and -x about y. The
    second joint's axis is horizontal and turns with the arm: to bend about it is the two together
    with a stretch, for it lies above the base.

    Parameters
    ----------
    points : ndarray of shape (n, 3)

    Returns
    -------
    ndarray of shape (3 n, 10)
        Each of length 1.
    """
    x, y, z = points.T
    none = np.zeros_like(x)
    fields = [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
    fields += [np.cross(axis, points) for axis in np.eye(3)]
    bends = (x, y, none), (none, -y * z, y * y), (x * z, none, -x * x)
    fields += [points, *(np.column_stack(bend) for bend in bends)]
    flat = np.stack(fields, axis=2).reshape(3 * len(points), -1)
    return flat / np.linalg.norm(flat, axis=0)


@lru_cache(maxsize=64)
def _of_others(arm: Arm, gravity, kinematics, wobble):
    """The same for the columns that are neither harmonics nor extra."""
    terms = Terms(np.empty((0, 2), dtype=int), gravity, kinematics, wobble)
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSES, arm.n_joints))
    fields = _fields(points_of(arm, angles))
    columns = term_columns(arm, angles, terms).reshape(len(fields), -1)
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > _NOTHING * size.max(initial=0.0), size, np.inf)
    coef = np.linalg.lstsq(columns / size, fields, rcond=1e-10)[0]
    left = np.linalg.norm(fields - columns / size @ coef, axis=0)
    found = (coef / size[:, None])[:, left < _LEFT]
    found.setflags(write=False)
    return found
