"""The stages of a correction: the linear model of the arm, and a network on what it leaves."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from sklearn.base import clone

from sklearn_raacmm.arm import Arm, points_of
from sklearn_raacmm.error_model import LinearModel
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.residuals import (
    direction_of,
    pose_columns,
    std_to_cartesian,
    to_cartesian,
    to_cylindrical,
)
from sklearn_raacmm.utils import centred


class NetworkInput(NamedTuple):
    """What the network needs of some poses."""

    features: np.ndarray  # (n, n_features)
    direction: tuple  # cosine and sine of the probe's azimuth, (n,) each


class TrainingData(NamedTuple):
    """All that the stages are fitted on, prepared once; the check takes rows of it."""

    angles: np.ndarray  # (n, n_joints) rad
    y: np.ndarray  # (n, 3) mm
    weights: np.ndarray  # (n,)
    codes: np.ndarray | None  # (n,) position of each row, where positions have offsets
    network: NetworkInput

    def rows(self, which):
        cos, sin = self.network.direction
        return TrainingData(
            self.angles[which],
            self.y[which],
            self.weights[which],
            None if self.codes is None else self.codes[which],
            NetworkInput(self.network.features[which], (cos[which], sin[which])),
        )


def network_input(arm, angles, joints):
    """Features of the poses, "all" joints or "pose", and the direction of the probe's azimuth."""
    angles = angles[:, : arm.n_joints]  # without extra columns
    if joints == "all":
        F, (x, y, _) = angles, points_of(arm, angles).T
    else:
        columns, (x, y, _) = pose_columns(arm, angles)
        F = np.stack(columns, axis=1)
    return NetworkInput(F, direction_of(x, y))


@dataclass(frozen=True, eq=False)
class Stages:
    """Fitted stages of a correction.

    Attributes
    ----------
    linear : LinearModel
    network : RBFNetRegressor or None
    joints : {"pose", "all"}
        What the network sees.
    """

    linear: LinearModel
    network: RBFNetRegressor | None
    joints: str

    @property
    def arm(self) -> Arm:
        return self.linear.arm

    def parts(self, angles, return_std=True, inputs=None):
        """Correction by each stage, and its standard deviation or None, (n, 3) each in mm."""
        parts = [self.linear.predict(angles, return_std)]
        if self.network is not None:
            inputs = network_input(self.arm, angles, self.joints) if inputs is None else inputs
            F, direction = inputs
            if return_std:
                value, std = self.network.predict(F, return_std=True, with_noise=False)
                parts.append((to_cartesian(value, direction), std_to_cartesian(std, direction)))
            else:
                parts.append((to_cartesian(self.network.predict(F), direction), None))
        return parts


def fit_network(network, linear, data, joints):
    """Fit the network on what the linear model leaves.

    Parameters
    ----------
    network : RBFNetRegressor
        Not fitted.
    linear : LinearModel
    data : TrainingData
        Its weights are those that the linear model's loss has left: outliers teach no network.
    joints : {"pose", "all"}

    Returns
    -------
    Stages
    """
    F, direction = data.network
    left = to_cylindrical(left_by(linear, data), direction)
    return Stages(linear, clone(network).fit(F, left, data.weights), joints)


def left_by(linear, data):
    """Residuals that the linear model leaves, (n, 3), of which each position's offset is free."""
    return data.y - centred(linear.predict(data.angles)[0], data.codes, data.weights)
