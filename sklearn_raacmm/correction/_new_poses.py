"""New poses that a fitted correction is updated, checked or transferred with."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from copy import copy

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import reach_mm
from sklearn_raacmm.error_model import ArmResidualRegressor, check_poses
from sklearn_raacmm.utils import check_weights, encode_groups, floats


class NewPoses:
    """New poses of a fitted model, checked; each fault gets one clear sentence.

    `angles` (n, n_joints + n_extra) in rad, then the extra columns; `residuals` (n, 3) in mm,
    without the correction; `weights` (n,); `codes` (n,), the position of each where positions have
    unknown offsets, or None.
    """

    def __init__(self, model, X, y, groups, sample_weight):
        angles = check_poses(model, X)
        y = floats("y", y, 3)
        if len(y) != len(angles):
            raise ValueError(f"X has {len(angles)} rows, but y has {len(y)}.")
        if groups is None and model.linear_model_.offsets:
            raise ValueError(
                "The model has an unknown offset at every position: give groups, the position of "
                "each new pose."
            )
        codes = None if groups is None else encode_groups(groups, len(y))[1]
        self.angles, self.residuals, self.codes = angles, y, codes
        self.weights = check_weights(sample_weight, angles)

    @property
    def positions(self):
        """Position of each pose, (n,); where none are told apart, each pose has its own."""
        return np.arange(len(self.angles)) if self.codes is None else self.codes

    def at(self, rows):
        """Some of the poses."""
        some = copy(self)
        some.angles, some.residuals = self.angles[rows], self.residuals[rows]
        some.weights = self.weights[rows]
        if self.codes is not None:
            some.codes = np.unique(self.codes[rows], return_inverse=True)[1].ravel()
        return some

    @property
    def n_coordinates(self):
        """Coordinates of the poses that count, less three for each unknown offset."""
        used = self.weights > 0
        n_offsets = 0 if self.codes is None else len(np.unique(self.codes[used]))
        return int(3 * (np.count_nonzero(used) - n_offsets))

    @property
    def too_few(self):
        """Why nothing can be learnt from these poses, or an empty string."""
        n_free = 9 if self.codes is None else 3  # of base and tool; cones show the tool's alone
        if self.n_coordinates > n_free:
            return ""
        return (
            f"{len(self.angles)} new poses give {self.n_coordinates} coordinates, fewer than would "
            f"show more than the {n_free} freedoms of base and tool"
        )


def linear_model_of(model, done):
    """The linear model of a fitted correction, whatever share of it is used."""
    if not isinstance(model, ArmResidualRegressor):
        raise TypeError(
            f"{type(model).__name__} holds no linear model and cannot be {done}: it has no "
            "posterior of causes. It can be registered, by calibrate(..., correction=model)."
        )
    check_is_fitted(model)
    return model.linear_model_


def place_columns(arm, angles, with_base):
    """What moves of the tool and shifts and turns of the base do to the probe, (n, 3, 3 or 9)."""
    angles = angles[:, : arm.n_joints]  # without extra columns
    tool = arm.frames(angles)[:, -1, :3, :3]
    if not with_base:  # of a single-point test the base shows nothing
        return tool
    points = arm.forward(angles)
    shift = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    turn = np.stack([np.cross(axis, points) for axis in np.eye(3)], axis=2) / reach_mm(arm)
    return np.concatenate([tool, shift, turn], axis=2)
