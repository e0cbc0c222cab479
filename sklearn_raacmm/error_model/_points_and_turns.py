"""Fits to points, and to points and orientations together, with intervals that hold."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.error_model._left_out import (
    N_BLOCKS,
    errors_left_out,
    leave_out,
    with_honest_intervals,
)
from sklearn_raacmm.error_model._linear_fit import fit_linear_model
from sklearn_raacmm.error_model._linear_model import LinearModel
from sklearn_raacmm.error_model._poses import check_poses
from sklearn_raacmm.utils import check_flags


class Fitted(NamedTuple):
    """A model, what its loss left of the weights, and its copies without one block each."""

    model: LinearModel
    pose_weight: np.ndarray  # (n,)
    left_out: list


def fit_points_and_turns(arm, data, options, positions, turns, n_blocks=N_BLOCKS):
    """Fit the model of points, and where there are orientations one of both.

    Parameters
    ----------
    arm : Arm
    data : tuple
        X, y, weights, codes and lengths, as :func:`fit_linear_model` takes them.
    options : LinearOptions
    positions : ndarray of shape (n,)
        Position of each row.
    turns : ndarray of shape (n, 3) or None
        Residuals of the orientation, rad.
    n_blocks : int, default=10
        Blocks of positions that are left out in turn.

    Returns
    -------
    fitted : Fitted
        The model of points; that of both where it is clearly better for points.
    orientation_model : LinearModel or None
        The model of both.
    """
    fitted = _fit_with_intervals(arm, data, options, positions, None, n_blocks)
    if turns is None:
        return fitted, None
    both = _fit_with_intervals(arm, data, options, positions, turns, n_blocks)
    X, y, weights = data[:3]
    better = _clearly_better(both, fitted, X, y, weights)
    return (both if better else fitted), both.model


def _fit_with_intervals(arm, data, options, positions, turns, n_blocks):
    """A model whose intervals are widened by its errors at positions left out."""
    X, y, weights, codes, _ = data
    model, pose_weight = fit_linear_model(arm, *data, options, turns)
    both = y if turns is None else np.hstack([y, model.turn_mm * turns])
    left_out = leave_out(model, options, X, both, weights * pose_weight, codes, positions, n_blocks)
    model = with_honest_intervals(model, left_out, X, y, weights, codes, positions)
    return Fitted(model, pose_weight, left_out)


def _clearly_better(new, old, X, y, weights):
    """Whether a fit is better for points than another one at the positions left out.

    Parameters
    ----------
    new, old : Fitted
        With the same blocks left out, and without offsets.
    X, y, weights
        Training data.

    Returns
    -------
    bool
        Whether the mean deviation over the blocks is less by more than the standard error of the
        difference; no, where there are no blocks.
    """
    if len(old.left_out) < 2 or len(new.left_out) != len(old.left_out):
        return False
    distances = [
        np.linalg.norm(errors_left_out(fit.left_out, X, y, None)[0], axis=1) for fit in (old, new)
    ]
    used = weights * old.pose_weight * new.pose_weight
    gains = [
        np.average(distances[0][rows] - distances[1][rows], weights=used[rows])
        for rows, _ in old.left_out
        if used[rows].any()
    ]
    return bool(np.mean(gains) > np.std(gains, ddof=1) / np.sqrt(len(gains)))


def predict_turns(estimator, X, return_std, with_noise):
    """What `predict_orientation` of either estimator returns, and how much of it is left.

    Parameters
    ----------
    estimator : JointHarmonicRegressor or ArmResidualRegressor
        Fitted.
    X : array-like of shape (n, n_features_in_)
    return_std, with_noise : bool

    Returns
    -------
    mean : ndarray of shape (n, 3)
        Rotation vectors in rad.
    std : ndarray of shape (n, 3) or None
    share : ndarray of shape (n,)
        What the fading leaves.
    """
    check_flags(return_std=return_std, with_noise=with_noise)
    X, points = check_poses(estimator, X, stacklevel=5), estimator.linear_model_
    both = estimator.orientation_model_
    model = points if both is None else both
    mean, std = model.predict_turn(X, return_std)
    fading = estimator.fading_ if hasattr(estimator, "fading_") else estimator.fadings_[0]
    share = np.ones(len(X))
    if fading.factor > 0:
        share = fading.share(points.predict(X, return_std=True)[1])
    if return_std:
        noise = model.turn_noise if with_noise and model.turn_mm > 0 else 0.0
        std = np.hypot(model.std_scale * std, noise)
    return share[:, None] * mean, std, share
