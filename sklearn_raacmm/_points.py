"""Points in groups: what the measures check at the door, and their sums by group."""

import numpy as np
from sklearn.utils import check_array, column_or_1d

from sklearn_raacmm._input import refuse_disguised, refuse_huge, refuse_masked
from sklearn_raacmm._residuals import _encode_groups


def check_option(name, value, options):
    if not (value is None or isinstance(value, str)) or value not in options:
        raise ValueError(f"{name}={value!r} is not one of {', '.join(map(repr, options))}.")


def check_points(points, n_coordinates=None):
    refuse_disguised("points", points)
    points = check_array(points, dtype=np.float64, ensure_2d=False, input_name="points")
    if points.ndim == 1:
        points = points[:, None]
    refuse_huge("points", points)
    if n_coordinates not in (None, points.shape[1]):
        raise ValueError(f"points has shape {points.shape}; (n_points, {n_coordinates}) is needed.")
    return points


def check_groups(groups, n_points):
    """Labels of the positions, sorted, and the position of each point as an index into them."""
    if groups is None:
        return np.zeros(1, dtype=int), np.zeros(n_points, dtype=int)
    refuse_masked("groups", groups)
    try:
        column = column_or_1d(groups)
    except ValueError:
        raise ValueError(
            f"groups must be one label per point, got an array of shape {np.shape(groups)}."
        ) from None
    labels, position = _encode_groups(column)
    if len(position) != n_points:
        raise ValueError(f"groups names {len(position)} points, but there are {n_points}.")
    return labels, position


def group_means(points, position, counts):
    origin = points[0]  # sums of small differences: no digits lost to a large mean
    sums = np.zeros((len(counts), points.shape[1]))
    np.add.at(sums, position, points - origin)
    return sums / counts[:, None] + origin


def deviations_by_group(points, groups):
    """Deviation of each point from its position's mean, its position, counts and labels."""
    points = check_points(points)
    labels, position = check_groups(groups, len(points))
    counts = np.bincount(position)
    if counts.min() < 2:
        raise ValueError(
            f"{(counts < 2).sum()} of {len(counts)} positions hold a single point (the first: "
            f"{labels[counts < 2][0]!s}); a scatter needs at least 2."
        )
    return points - group_means(points, position, counts)[position], position, counts, labels
