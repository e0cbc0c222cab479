"""From points to residuals."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.measurements._features import Features
from sklearn_raacmm.utils import Floats, Groups, check_weights, floats


def position_residuals(
    points: ArrayLike,
    groups: ArrayLike,
    sample_weight: ArrayLike | None = None,
    *,
    features: Iterable[Sequence[object]] = (),
) -> Floats:
    """Residual of each probe point from the mean point of its position, or from its feature.

    Parameters
    ----------
    points : array-like of shape (n_points, 3)
        Probe points in mm, as the arm's forward kinematics gives them.
    groups : array-like of shape (n_points,)
        Label of the position each point belongs to: numbers or text.
    sample_weight : array-like of shape (n_points,), default=None
        Weight of each point in the mean of its position; equal if None.
    features : iterable of (label, kind), default=()
        What was touched under the labels that are no cones: kind "plane" or "sphere", as
        :func:`calibrate` takes them. Sizes have no part in it.

    Returns
    -------
    residuals : ndarray of shape (n_points, 3)
        Point minus mean of its position, in mm, Cartesian: the `y` that
        :class:`CylindricalResidualTarget` is fitted on. Of a plane or a sphere, point minus the
        nearest point of the form that fits its touches best.

    Raises
    ------
    ValueError
        If points, groups or weights differ in length, hold NaN, infinity or missing labels, or if
        a position has fewer than two points of non-zero weight; if a feature is unknown.

    Notes
    -----
    The reference of equation (10), before the rotation. Points farther than 11 standard deviations
    from the others, slips of the probe, take no part in the mean (Tukey's biweight).

    Examples
    --------
    >>> position_residuals([[500.0, 0, 0], [500.2, 0, 0]], ["A", "A"]).round(3)
    array([[-0.1,  0. ,  0. ],
           [ 0.1,  0. ,  0. ]])
    """
    points = floats("points", points, 3)
    labels, codes = Groups.encoded(groups, len(points))
    weight = check_weights(sample_weight, points)
    # Denormal weights have few digits left, their products with points fewer.
    weight = weight / max(weight.max(), 1e-300) if weight.max() < 1e-200 else weight
    size = np.bincount(codes[weight > 0], minlength=len(labels))
    if np.any(size < 2):
        lonely = labels[size < 2]
        shown = ", ".join(map(repr, lonely[:5].tolist())) + (", ..." if len(lonely) > 5 else "")
        raise ValueError(
            f"{len(lonely)} of {len(labels)} positions have fewer than 2 points of non-zero "
            f"weight: {shown}. The residual of a lone point from its own mean is zero whatever "
            "the arm does; leave these positions out."
        )
    touched = Features.stated(features, labels.tolist(), codes)
    if set(touched.kinds) == {"cone"}:
        return Groups(codes).centred(points, weight * Groups(codes).slip_factors(points, weight))
    return touched.linearised(points, weight * touched.weights(points)).residual
