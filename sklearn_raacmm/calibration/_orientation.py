"""Orientations of the last link, for measurements of position and orientation together."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sklearn_raacmm.arm import dh_theta, frame_columns
from sklearn_raacmm.utils import floats, nearest_rotation

# Departure from orthonormal of a rotation matrix that was written with four digits.
_NOT_ROTATION = 1e-3


def flange_turns(arm, angles):
    """Orientations (n, 3, 3) of the last link in the base frame, and the axes of the angles.

    The axes (n, 3, 2 n_joints) are those about which the last link turns where `alpha`, and then
    where `theta_offset`, of each joint increases.
    """
    n = arm.n_joints
    frames = frame_columns(arm, dh_theta(arm, angles))
    first, last = (0, 1) if arm.convention == "standard" else (1, 0)
    of_x = frames[np.arange(n) + last, 0]
    of_z = frames[np.arange(n) + first, 2]
    axes = np.concatenate([of_x, of_z]).transpose(2, 1, 0)
    # A column of the rotation matrix per axis of the frame.
    return frames[-1, :3].transpose(2, 1, 0), axes


def mean_turn(turns):
    """The rotation (3, 3) nearest to many (n, 3, 3) by least squares of the matrices."""
    return nearest_rotation(turns.sum(axis=0))


def turn_vectors(turns):
    """Rotation vectors (n, 3) in rad of rotation matrices."""
    return Rotation.from_matrix(turns).as_rotvec()


def check_turns(turns: Any, n: int) -> Any:
    """Rotation matrices (n, 3, 3), or rotation objects of SciPy."""
    turns = turns.as_matrix() if hasattr(turns, "as_matrix") else turns
    turns = floats("orientations", turns, finite=True)
    if turns.shape != (n, 3, 3):
        raise ValueError(
            f"orientations must be {n} rotation matrices, shape ({n}, 3, 3), got {turns.shape}."
        )
    error = np.abs(np.swapaxes(turns, 1, 2) @ turns - np.eye(3)).max(axis=(1, 2))
    bad = ~(error <= _NOT_ROTATION) | ~(np.linalg.det(turns) > 0)
    if bad.any():
        raise ValueError(
            f"orientations hold {bad.sum()} matrices that are no rotations, first in row "
            f"{np.argmax(bad)}."
        )
    return turns
