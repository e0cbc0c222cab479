"""What joint angles say of themselves: rounded ones."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator

import numpy as np

from sklearn_raacmm.utils import Finding

# Steps that angles are rounded to, deg, and how far a multiple may be off, as a part of it.
_STEPS, _OFF = (1.0, 0.5, 0.1, 0.05, 0.01), 1e-4
# Different angles of a joint that may lie on a grid by intention, and the error of rounding at the
# stretched arm that is worth a word, mm.
_LEAST, _LARGE_MM = 10, 0.02


def coarse_angles(angles: np.ndarray, reach: float) -> Iterator[Finding]:
    """All angles (n, n_joints), in rad, are multiples of a coarse step; `reach` in mm."""
    degrees = np.rad2deg(angles)
    if not any(len(np.unique(column)) >= _LEAST for column in degrees.T[:, : 10 * _LEAST]):
        return
    for step in _STEPS:
        size = np.deg2rad(step) / np.sqrt(12) * reach
        parts = degrees / step
        if np.abs(parts - np.round(parts)).max() < _OFF and size > _LARGE_MM:
            yield Finding(
                "coarse-angles",
                f"All angles are multiples of {step:g} degrees: rounding alone moves the probe by "
                f"{size:.2g} mm.",
                "Take them with all digits that the encoders have.",
                size_mm=size,
            )
            return
