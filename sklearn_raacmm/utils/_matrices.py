"""Small matrices: rigid motions from one set of points to another."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) nearest to a matrix (3, 3) by least squares of the entries."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt


def align(points: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and shift (3,) that take points (n, 3) to target by least squares.

    ``points @ rotation.T + shift`` is next to `target`.
    """
    centre, target_centre = points.mean(axis=0), target.mean(axis=0)
    rotation = nearest_rotation((target - target_centre).T @ (points - centre))
    return rotation, target_centre - rotation @ centre
