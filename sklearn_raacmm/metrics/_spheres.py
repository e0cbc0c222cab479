"""Two spheres of metrology: the least-squares one and the smallest one that holds all points."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from sklearn_raacmm.utils import Floats, floats


def fit_sphere(points: ArrayLike) -> tuple[Floats, float, Floats]:
    """Least-squares (Gaussian) sphere through points.

    Parameters
    ----------
    points : array-like of shape (n_points, 3)
        At least four, not in one plane, mm.

    Returns
    -------
    center : ndarray of shape (3,)
        In mm.
    radius : float
        In mm.
    distances : ndarray of shape (n_points,)
        Of the points from the centre, mm.

    Raises
    ------
    ValueError
        If the points do not determine a sphere.

    Examples
    --------
    >>> from sklearn_raacmm.metrics import fit_sphere
    >>> center, radius, _ = fit_sphere([[6, 0, 0], [-4, 0, 0], [1, 5, 0], [1, 0, 5]])
    >>> center.round(6) + 0.0, round(radius, 6)
    (array([1., 0., 0.]), 5.0)
    """
    points = floats("points", points, 3)
    if len(points) < 4:
        raise ValueError(f"A sphere is fitted to at least 4 points, got {len(points)}.")
    mean = points.mean(axis=0)
    centred = points - mean
    spread = np.linalg.svd(centred, compute_uv=False)
    # 1e-7 of the spread: a cap that flat has a sagitta below the rounding of any real point.
    if spread[2] <= 1e-7 * spread[0]:
        raise ValueError(
            f"The {len(points)} points lie in one plane (spread {spread[2]:.3g} mm across, "
            f"{spread[0]:.3g} mm along it), which does not determine a sphere."
        )
    # |p|^2 = 2 p.c + (r^2 - |c|^2) is linear in its unknowns and starts the geometric fit.
    columns = np.column_stack([2 * centred, np.ones(len(points))])
    unknowns = np.linalg.lstsq(columns, (centred**2).sum(axis=1), rcond=None)[0]
    start = np.append(unknowns[:3], np.sqrt(max(unknowns[3] + unknowns[:3] @ unknowns[:3], 0)))

    def residuals(x):
        return np.linalg.norm(centred - x[:3], axis=1) - x[3]

    def jacobian(x):
        offsets = x[:3] - centred
        # A point at the centre has no direction: the distance is smallest there, whichever way.
        lengths = np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-300)
        return np.column_stack([offsets / lengths, -np.ones(len(points))])

    ends: dict = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
    x = least_squares(residuals, start, jac=jacobian, method="lm", **ends).x
    # The search ends where the sum of squares is flat to its rounding: one step further is exact.
    x = x - np.linalg.lstsq(jacobian(x), residuals(x), rcond=None)[0]
    return x[:3] + mean, float(x[3]), np.linalg.norm(centred - x[:3], axis=1)


def minimum_enclosing_sphere(points):
    """Centre and radius of the smallest sphere that holds all points (n, n_dims).

    At most n_dims + 1 points, the support, determine it. A point outside joins the support, whose
    smallest sphere then grows: so no support comes twice, and the search ends.
    """
    origin = points.mean(axis=0)
    points = points - origin
    center, radius = points[0], 0.0
    support = points[:1]
    while True:
        distances = np.linalg.norm(points - center, axis=1)
        farthest = distances.argmax()
        if distances[farthest] <= radius * (1 + 1e-12):
            return center + origin, radius
        found = _smallest_sphere(np.vstack([support, points[farthest]]))
        if found[1] <= radius:  # no growth left but rounding
            return center + origin, distances[farthest]
        center, radius, support = found


def _smallest_sphere(few):
    """Smallest enclosing sphere of at most n_dims + 2 points, by trying every subset."""
    found = []
    for size in range(1, min(len(few), few.shape[1] + 1) + 1):
        for subset in combinations(range(len(few)), size):
            edges = few[list(subset[1:])] - few[subset[0]]
            # The solution of least norm is the circumcentre inside the subset's affine hull.
            step = np.linalg.lstsq(2 * edges, (edges**2).sum(axis=1), rcond=None)[0]
            center = few[subset[0]] + step
            radius = np.linalg.norm(few - center, axis=1).max()
            found.append((center, radius, few[list(subset)]))
    return min(found, key=lambda one: one[1])
