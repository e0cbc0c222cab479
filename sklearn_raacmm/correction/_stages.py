"""The stages of a correction: the linear model of the arm, and a network on what it leaves."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from sklearn.base import clone

from sklearn_raacmm.arm import Arm, points_of
from sklearn_raacmm.error_model import LinearModel, LinearOptions, fit_linear_model
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


def network_input(arm, angles, features):
    """Features of the poses, "all" joints or "pose", and the direction of the probe's azimuth."""
    if features == "all":
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
    pose_weight : ndarray of shape (n_samples,)
        What the loss of the linear model left of the weight of each training row.
    network : RBFNetRegressor or None
    features : {"pose", "all"}
        What the network sees.
    """

    linear: LinearModel
    pose_weight: np.ndarray
    network: RBFNetRegressor | None
    features: str

    @property
    def arm(self) -> Arm:
        return self.linear.arm

    def parts(self, angles, return_std=True, inputs=None):
        """Correction by each stage, and its standard deviation or None, (n, 3) each in mm."""
        parts = [self.linear.predict(angles, return_std)]
        if self.network is not None:
            inputs = network_input(self.arm, angles, self.features) if inputs is None else inputs
            F, direction = inputs
            if return_std:
                value, std = self.network.predict(F, return_std=True, with_noise=False)
                parts.append((to_cartesian(value, direction), std_to_cartesian(std, direction)))
            else:
                parts.append((to_cartesian(self.network.predict(F), direction), None))
        return parts

    def without_network(self):
        return replace(self, network=None)


def fit_stages(arm, data, lengths, options, network, features):
    """Fit the linear model, and the network on what that leaves.

    Parameters
    ----------
    arm : Arm
    data : TrainingData
    lengths : list
        As :func:`fit_linear_model`.
    options : LinearOptions
    network : RBFNetRegressor or None
        Not fitted; None for the linear model alone.
    features : {"pose", "all"}

    Returns
    -------
    Stages
    """
    linear, pose_weight = fit_linear_model(
        arm, data.angles, data.y, data.weights, data.codes, lengths, options
    )
    if network is not None:
        weights = data.weights * pose_weight  # outliers do not teach the network
        left = data.y - centred(linear.predict(data.angles)[0], data.codes, weights)
        F, direction = data.network
        network = clone(network).fit(F, to_cylindrical(left, direction), weights)
    return Stages(linear, pose_weight, network, features)


__all__ = ["LinearOptions", "NetworkInput", "Stages", "TrainingData", "fit_stages", "network_input"]
