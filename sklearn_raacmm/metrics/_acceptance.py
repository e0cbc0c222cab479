"""Measures of acceptance tests with gauges and spheres; public in `sklearn_raacmm.metrics`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from sklearn_raacmm.utils import Floats, Groups, floats


def gauge_lengths(points: ArrayLike, groups: ArrayLike, pairs: ArrayLike) -> np.ndarray:
    """Measured lengths: distances between the mean points of pairs of groups.

    Parameters
    ----------
    points : array-like of shape (n_points, 3)
        Measured or corrected points, mm.
    groups : array-like of shape (n_points,)
        Label of the gauge's end (the cone) of each point.
    pairs : array-like of shape (n_lengths, 2)
        Labels of the two ends of each placement of the gauge.

    Returns
    -------
    lengths : ndarray of shape (n_lengths,)
        In mm.

    Raises
    ------
    ValueError
        If a pair names a group without points, or shapes do not fit.

    Examples
    --------
    >>> from sklearn_raacmm.metrics import gauge_lengths
    >>> points = [[0, 0, 0], [0, 0, 0.2], [300, 0, 0.1], [300, 0, 0.1]]
    >>> gauge_lengths(points, ["a", "a", "b", "b"], [["a", "b"]])
    array([300.])
    """
    points = floats("points", points, 3)
    labels, position = Groups.encoded(groups, len(points))
    pairs = np.asarray(pairs)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise ValueError(f"pairs has shape {pairs.shape}; (n_lengths, 2) is needed.")
    index = {label: i for i, label in enumerate(labels.tolist())}
    found = [index.get(label) for label in pairs.ravel().tolist()]
    if None in found:
        unknown = pairs.ravel().tolist()[found.index(None)]
        raise ValueError(f"pairs names the group {unknown!r}, which has no points.")
    means = Groups(position).means(points)
    ends = np.array(found, dtype=int).reshape(-1, 2)
    return np.linalg.norm(means[ends[:, 1]] - means[ends[:, 0]], axis=1)


def length_error(measured: ArrayLike, calibrated: ArrayLike) -> np.ndarray:
    """Length errors D = L - L_cal.

    Parameters
    ----------
    measured : array-like of shape (n_lengths,)
        Measured lengths, mm.
    calibrated : float or array-like of shape (n_lengths,)
        Calibrated lengths, mm.

    Returns
    -------
    error : ndarray of shape (n_lengths,)
        In mm, with its sign.

    Raises
    ------
    ValueError
        If lengths are not finite and positive, or their numbers differ.

    Notes
    -----
    E_Uni of ISO 10360-12:2016 is each D against its limit; of the placements of a ball bar ASME
    B89.4.22-2004 takes the largest, the range and 2 rms:
    :func:`~sklearn_raacmm.acceptance.evaluate_acceptance` has them with their uncertainty.

    Examples
    --------
    >>> from sklearn_raacmm.metrics import length_error
    >>> length_error([300.02, 499.97], [300, 500]).round(3)
    array([ 0.02, -0.03])
    """
    measured = _check_lengths("measured", measured)
    calibrated = _check_lengths("calibrated", calibrated)
    if len(calibrated) not in (1, len(measured)):
        raise ValueError(
            f"{len(measured)} measured lengths, but {len(calibrated)} calibrated ones."
        )
    return measured - calibrated


def articulated_location_error(points: ArrayLike, groups: ArrayLike | None = None) -> float:
    """Diameter of the smallest sphere around centres found in different articulations.

    Parameters
    ----------
    points : array-like of shape (n_points, 3)
        Without groups, the centres themselves, mm: the means of a cone, or centres of spheres.
        With groups, points probed on one sphere.
    groups : array-like of shape (n_points,), default=None
        Label of the articulation of each point: a least-squares sphere is fitted to each group,
        which takes four points or more, not in one plane.

    Returns
    -------
    error : float
        In mm.

    Raises
    ------
    ValueError
        If there are fewer than two centres, or a group does not determine a sphere.

    Notes
    -----
    After L_Dia.5x5:Art of ISO 10360-12:2016: five articulations of five points each.

    Examples
    --------
    >>> from sklearn_raacmm.metrics import articulated_location_error
    >>> round(articulated_location_error([[0, 0, 0], [0.03, 0, 0], [0.01, 0.01, 0]]), 6)
    0.03
    """
    centers = floats("points", points, 3)
    if groups is not None:
        labels, position = Groups.encoded(groups, len(centers))
        points, centers = centers, np.empty((len(labels), 3))
        for i, label in enumerate(labels.tolist()):
            try:
                centers[i] = fit_sphere(points[position == i])[0]
            except ValueError as error:
                raise ValueError(f"Articulation {label!r}: {error}") from error
    if len(centers) < 2:
        raise ValueError(f"At least 2 centres are compared, got {len(centers)}.")
    return float(2 * minimum_enclosing_sphere(centers)[1])


def _check_lengths(name, lengths) -> np.ndarray:
    lengths = np.atleast_1d(floats(name, lengths, finite=True))
    if lengths.ndim != 1 or not len(lengths):
        raise ValueError(f"{name} has shape {lengths.shape}; one value per length is needed.")
    bad = lengths <= 0
    if bad.any():
        raise ValueError(
            f"{name} holds {bad.sum()} of {len(bad)} values that are not positive lengths "
            f"(the first: {lengths[bad][0]})."
        )
    return lengths


# -- two spheres: the least-squares one, and the smallest one that holds all points ----------------


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
