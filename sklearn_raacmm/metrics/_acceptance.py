"""Measures of acceptance tests with gauges and spheres; public in `sklearn_raacmm.metrics`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.metrics import _spheres
from sklearn_raacmm.utils import check_groups, check_option, floats, group_means

# Points of a face that are this close to a line, by its length, do not determine a plane.
_LEAST_SPREAD = 1e-3


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
    means, ends, *_ = _ends(points, groups, pairs)
    return np.linalg.norm(means[ends[:, 1]] - means[ends[:, 0]], axis=1)


def block_lengths(points: ArrayLike, groups: ArrayLike, pairs: ArrayLike) -> np.ndarray:
    """Measured lengths of gauge blocks: distances between their two parallel faces.

    Parameters
    ----------
    points, groups, pairs
        As in :func:`gauge_lengths`, of faces in place of cones; compensated for the radius of the
        probe.

    Returns
    -------
    lengths : ndarray of shape (n_lengths,)
        In mm.

    Raises
    ------
    ValueError
        As :func:`gauge_lengths`; or if the points of two faces do not determine a plane.

    Notes
    -----
    Both faces get planes with one common normal: the right singular vector of the least singular
    value of the points less the mean of their face. Errors across the normal do not count.

    Examples
    --------
    >>> from sklearn_raacmm.metrics import block_lengths
    >>> left = [[0, 0, 0], [0, 20, 0], [0, 0, 20]]
    >>> right = [[100, 5, 5], [100, 25, 5], [100, 5, 25]]
    >>> block_lengths([*left, *right], ["l", "l", "l", "r", "r", "r"], [["l", "r"]]).round(6)
    array([100.])
    """
    means, ends, labels, left, position = _ends(points, groups, pairs)
    lengths = []
    for first, second in ends:
        flat = left[np.isin(position, (first, second))]
        sizes, directions = np.linalg.svd(flat, full_matrices=False)[1:]
        if len(sizes) < 3 or sizes[1] < _LEAST_SPREAD * max(sizes[0], 1e-300):
            raise ValueError(
                f"The points on the faces {labels[first]} and {labels[second]} do not "
                "determine a plane: measure at least three points on a face, not in one line."
            )
        lengths.append(abs((means[second] - means[first]) @ directions[2]))
    return np.array(lengths)


def _ends(points, groups, pairs) -> Any:
    """Means of groups, both numbers (n_lengths, 2) of each pair, labels, deviations, codes."""
    points = floats("points", points, 3)
    labels, position = check_groups(groups, len(points))
    pairs = np.asarray(pairs)
    if pairs.ndim != 2 or pairs.shape[1] != 2:
        raise ValueError(f"pairs has shape {pairs.shape}; (n_lengths, 2) is needed.")
    index = {label: i for i, label in enumerate(labels.tolist())}
    found = [index.get(label) for label in pairs.ravel().tolist()]
    if None in found:
        unknown = pairs.ravel().tolist()[found.index(None)]
        raise ValueError(f"pairs names the group {unknown!r}, which has no points.")
    means = group_means(points, position)
    ends = np.array(found, dtype=int).reshape(-1, 2)
    return means, ends, labels, points - means[position], position


def length_error(
    measured: ArrayLike, calibrated: ArrayLike, *, statistic: str | None = None
) -> Any:
    r"""Length errors D = L - L_cal, or one number for them all.

    Parameters
    ----------
    measured : array-like of shape (n_lengths,)
        Measured lengths, mm.
    calibrated : float or array-like of shape (n_lengths,)
        Calibrated lengths, mm.
    statistic : {"max", "range", "2rms", "mean", None}, default=None
        None gives D itself, with its sign; "max" the largest :math:`|D|`, "mean" the mean
        :math:`|D|`, "range" :math:`\max D - \min D`, "2rms" :math:`2\sqrt{\sum D^2 / n}`.

    Returns
    -------
    error : ndarray of shape (n_lengths,) or float
        In mm.

    Raises
    ------
    ValueError
        If lengths are not finite and positive, or their numbers differ.

    Notes
    -----
    After the volumetric test of ASME B89.4.22-2004 (max, range and 2 rms over the placements of a
    ball bar) and E_Uni of ISO 10360-12:2016 (each D against its limit).

    Examples
    --------
    >>> from sklearn_raacmm.metrics import length_error
    >>> length_error([300.02, 499.97], [300, 500]).round(3)
    array([ 0.02, -0.03])
    """
    check_option("statistic", statistic, ("max", "range", "2rms", "mean", None))
    measured = _check_lengths("measured", measured)
    calibrated = _check_lengths("calibrated", calibrated)
    if len(calibrated) not in (1, len(measured)):
        raise ValueError(
            f"{len(measured)} measured lengths, but {len(calibrated)} calibrated ones."
        )
    error = measured - calibrated
    if statistic is None:
        return error
    if statistic == "range":
        return float(np.ptp(error))
    if statistic == "2rms":
        return float(2 * np.sqrt(np.mean(error**2)))
    return float(getattr(np, statistic)(np.abs(error)))


def probing_size_error(points: ArrayLike, diameter: float) -> float:
    """Diameter of the least-squares sphere minus the calibrated diameter.

    Parameters
    ----------
    points : array-like of shape (n_points, 3)
        Points probed on one sphere, mm. At least four, not in one plane.
    diameter : float
        Calibrated diameter of the sphere, mm.

    Returns
    -------
    error : float
        In mm.

    Raises
    ------
    ValueError
        If the points do not determine a sphere, or the diameter is not positive.

    Notes
    -----
    After P_Size.Sph.1x25 of ISO 10360-12:2016, which takes 25 points. Points and `diameter` must
    both be compensated for the radius of the probe's ball, or neither.

    Examples
    --------
    >>> from sklearn_raacmm.metrics import probing_size_error
    >>> octahedron = [[5, 0, 0], [-5, 0, 0], [0, 5, 0], [0, -5, 0], [0, 0, 5], [0, 0, -5]]
    >>> round(probing_size_error(octahedron, 9.99), 6)
    0.01
    """
    if np.ndim(diameter):
        raise ValueError(f"diameter must be one number, got shape {np.shape(diameter)}.")
    (diameter,) = _check_lengths("diameter", diameter)
    return float(2 * _spheres.fit_sphere(points)[1] - diameter)


def probing_form_error(points: ArrayLike) -> float:
    """Largest minus smallest distance of the points from the least-squares sphere's centre.

    Parameters
    ----------
    points : array-like of shape (n_points, 3)
        As in :func:`probing_size_error`.

    Returns
    -------
    error : float
        In mm.

    Raises
    ------
    ValueError
        If the points do not determine a sphere.

    Notes
    -----
    After P_Form.Sph.1x25 of ISO 10360-12:2016, which takes 25 points.

    Examples
    --------
    >>> from sklearn_raacmm.metrics import probing_form_error
    >>> points = [[5, 0, 0], [-5, 0, 0], [0, 5, 0], [0, -5, 0], [0, 0, 5.1], [0, 0, -5.1]]
    >>> round(probing_form_error(points), 6)
    0.1
    """
    return float(np.ptp(_spheres.fit_sphere(points)[2]))


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
        labels, position = check_groups(groups, len(centers))
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
