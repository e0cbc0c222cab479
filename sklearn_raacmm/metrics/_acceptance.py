"""Measures of acceptance tests with gauges and spheres; public in `sklearn_raacmm.metrics`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.metrics import _spheres
from sklearn_raacmm.utils import Groups, floats


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
                centers[i] = _spheres.fit_sphere(points[position == i])[0]
            except ValueError as error:
                raise ValueError(f"Articulation {label!r}: {error}") from error
    if len(centers) < 2:
        raise ValueError(f"At least 2 centres are compared, got {len(centers)}.")
    return float(2 * _spheres.minimum_enclosing_sphere(centers)[1])


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
