"""Standard deviations of corrected points: within a position, of a coordinate, of a distance.

Cones do not show the common scale k of all lengths, which moves every point by k times its distance
from the shoulder S, and every distance L by k L; nor how the arm gives way as a function of the
place. The base frame is the arm's own: z along the first axis, x where its encoder says, the origin
below S by what the table says.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model import unseen_variance
from sklearn_raacmm.utils import Finding

#: What a standard deviation of a corrected point may be of.
STD_OF = ("coordinate", "position")
# Coverage factor of uncertainties that are said in words.
_K = 2.0


def corrected_points(
    arm: Arm, model: Any, X: Any, facts: dict[str, Any], std_of: str = "coordinate"
) -> tuple[np.ndarray, np.ndarray]:
    """Corrected points and the standard deviations of their coordinates.

    Parameters
    ----------
    arm : Arm
    model : estimator
    X : ndarray of shape (n_samples, n_joints + n_causes)
        Angles in rad, then the causes that the model takes.
    facts : dict
        ``noise_mm``, ``std_factor`` and ``scale_sd``, as `LearnedCorrection.facts` has them.
    std_of : {"coordinate", "position"}, default="coordinate"
        Of a coordinate in the base frame, or of the deviation within a position alone.

    Returns
    -------
    points, std : ndarray of shape (n_samples, 3)
        In mm.
    """
    correction, std = predict_with_std(model, X, facts["noise_mm"])
    points = arm.forward(X[:, : arm.n_joints]) - correction
    within = facts["std_factor"] * std
    if std_of == "position":
        return points, within
    return points, _of_coordinate(arm, model, X, points, within, facts)


def distances(first, second, scale_sd):
    """Distances between corrected points and their standard deviations.

    Parameters
    ----------
    first, second : (ndarray of shape (n, 3), ndarray of shape (n, 3))
        Points, and the standard deviations of their coordinates within a position, mm.
    scale_sd : float
        Relative standard deviation of the common scale.

    Returns
    -------
    lengths, std : ndarray of shape (n,)
        In mm. The errors of two readings are taken as independent.
    """
    apart = second[0] - first[0]
    lengths = np.linalg.norm(apart, axis=1)
    along = apart / np.maximum(lengths, 1e-300)[:, None]
    ends = np.sum(along**2 * (first[1] ** 2 + second[1] ** 2), axis=1)
    return lengths, np.sqrt(ends + (scale_sd * lengths) ** 2)


def corrected_columns(arm: Arm, model: Any, facts: Any, X: ArrayLike) -> np.ndarray:
    """What a corrected table gets, (n_samples, 10); parameters as of `corrected_points`.

    Points; standard deviations of the coordinates in the base frame and within a position; that of
    a distance of 1 m from here to a point that is known as well.
    """
    points, within = corrected_points(arm, model, X, facts, "position")
    of_metre = np.sqrt(2 * np.mean(within**2, axis=1) + (1000 * facts["scale_sd"]) ** 2)
    of_coordinate = _of_coordinate(arm, model, X, points, within, facts)
    return np.column_stack([points, of_coordinate, within, of_metre])


def _of_coordinate(arm, model, X, points, within, facts):
    variance = within**2 + (facts["scale_sd"] * (points - _shoulder(arm))) ** 2
    linear = getattr(model, "linear_model_", None)
    if linear is not None and model.helps_:
        variance += unseen_variance(linear, X)
    return np.sqrt(variance)


def _shoulder(arm):
    """The point of the first axis that the scale of the links leaves where it is, (3,), mm."""
    if arm.convention == "standard":
        return np.array([0.0, 0.0, arm.d[0]])
    return arm.frames(np.zeros((1, arm.n_joints)))[0, 1, :, 3]


def length_findings(calibration):
    """What a calibration does not know of lengths.

    Parameters
    ----------
    calibration : CalibrationResult

    Returns
    -------
    list of Finding
        "lengths-unknown", where the scale of the arm is that of its table.
    """
    if "scale" not in calibration.unidentified:
        return []
    per_metre = _K * 1000 * calibration.scale_sd
    return [
        Finding(
            "lengths-unknown",
            f"Lengths are not known to better than {per_metre:.2g} mm per metre (k = {_K:g}).",
            "Measure a known distance: a bar in two cones, or a cone plate moved by a known step.",
            weight="note",
            size_mm=per_metre,
        )
    ]


def predict_with_std(model, angles, noise):
    """Prediction (n, 3) and standard deviation of a new measurement (n, 3), mm."""
    try:
        mean, std = model.predict(angles, return_std=True)
        std = np.broadcast_to(std, mean.shape)
    except (TypeError, ValueError):  # a regressor without standard deviations of this form
        mean = model.predict(angles)
        std = np.zeros_like(mean)
    return mean, np.hypot(std, noise)
