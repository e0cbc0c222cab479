"""The fit of a linear model with intervals that hold, and which of two is better for points."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.error_model._left_out import (
    errors_left_out,
    leave_out,
    with_honest_intervals,
)
from sklearn_raacmm.error_model._linear_fit import fit_linear_model
from sklearn_raacmm.error_model._linear_model import LinearModel


class Fitted(NamedTuple):
    """A model, what its loss left of the weights, and its copies without one block each."""

    model: LinearModel
    pose_weight: np.ndarray  # (n,)
    left_out: list


def fit_with_intervals(arm, data, options, positions, turns=None):
    """Fit a model and widen its intervals by its errors at positions left out.

    Parameters
    ----------
    arm : Arm
    data : tuple
        X, y, weights, codes and lengths, as :func:`fit_linear_model` takes them.
    options : LinearOptions
    positions : ndarray of shape (n,)
        Position of each row.
    turns : ndarray of shape (n, 3), default=None
        Residuals of the orientation, rad.

    Returns
    -------
    Fitted
    """
    X, y, weights, codes, _ = data
    model, pose_weight = fit_linear_model(arm, *data, options, turns)
    both = y if turns is None else np.hstack([y, model.turn_mm * turns])
    left_out = leave_out(model, options, X, both, weights * pose_weight, codes, positions)
    model = with_honest_intervals(model, left_out, X, y, weights, codes, positions)
    return Fitted(model, pose_weight, left_out)


def clearly_better(new, old, X, y, weights):
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
