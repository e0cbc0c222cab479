"""Standard deviations of corrected points: within a position, of a coordinate, of a distance.

Cones do not show the common scale k of all lengths, which moves every point by k times its distance
from the shoulder S, and every distance L by k L; nor how the arm gives way as a function of the
place. The base frame is the arm's own: z along the first axis, x where its encoder says, the origin
below S by what the table says.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.error_model import unseen_variance
from sklearn_raacmm.utils import Finding

# Share of a standard deviation that is the arm's at least, whatever a reference states: a
# choice.
_LEAST_SHARE = 0.2
# Coverage factor of uncertainties that are said in words.
_K = 2.0


def predict_with_std(model, X, noise):
    """Prediction (n, 3) and standard deviation of a new measurement (n, 3), mm."""
    try:
        mean, std = model.predict(X, return_std=True)
        std = np.broadcast_to(np.reshape(std, (len(mean), -1)), mean.shape)
    except (TypeError, ValueError):  # a regressor without standard deviations of this form
        mean = model.predict(X)
        std = np.zeros_like(mean)
    if (linear := linear_in_use(model)) is not None:
        noise = noise * linear.noise_ratio(X)
    return mean, np.hypot(std, noise)


def without_reference(facts, std):
    """Standard deviations against a reference as intervals ask for, less the reference's own."""
    variance = np.square(facts["std_factor"] * std) - facts.get("points_sd_mm", 0.0) ** 2
    return np.sqrt(np.maximum(variance, np.square(_LEAST_SHARE * std)))


def of_coordinate(correction, X, points, within):
    """Standard deviations of coordinates in the base frame, (n, 3) mm, from those in a position."""
    scale = correction.scale_sd * (points - _shoulder(correction.arm))
    variance = within**2 + scale**2
    if (linear := linear_in_use(correction.model)) is not None:
        variance += unseen_variance(linear, X)
    return np.sqrt(variance)


def linear_in_use(model):
    """The linear error model, or None where there is none, or where it is of no help."""
    return getattr(model, "linear_model_", None) if getattr(model, "helps_", False) else None


def _shoulder(arm):
    """The point of the first axis that the scale of the links leaves where it is, (3,), mm."""
    if arm.convention == "standard":
        return np.array([0.0, 0.0, arm.d[0]])
    return arm.frames(np.zeros((1, arm.n_joints)))[0, 1, :, 3]


def distances(correction, first, second):
    """Distances between corrected readings at two poses each and their deviations, (n,) mm each.

    A model of the arm knows how the errors of both ends belong together, and how much positions did
    not show of them; those of another regressor are taken as independent.
    """
    one, other = (correction._within_positions(X) for X in (first, second))
    apart = other[0] - one[0]
    lengths = np.linalg.norm(apart, axis=1)
    along = apart / np.maximum(lengths, 1e-300)[:, None]
    variance = np.sum(along**2 * (one[1] ** 2 + other[1] ** 2), axis=1)
    if (linear := linear_in_use(correction.model)) is not None:
        variance = linear.distance_std(first, second) ** 2
        for X in (first, second):
            noise = without_reference(correction.facts, correction.noise * linear.noise_ratio(X))
            variance += np.sum(np.square(along * noise), axis=1)
    return lengths, np.sqrt(variance + (correction.scale_sd * lengths) ** 2)


def length_findings(calibration):
    """Findings on a calibration that has the scale of the arm from its table alone."""
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
