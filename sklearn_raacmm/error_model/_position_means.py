"""Mean columns of positions, and known lengths between positions as rows of the linear model."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.arm import points_of
from sklearn_raacmm.error_model._columns import term_columns
from sklearn_raacmm.utils import chunks, group_means, group_sums, group_weights

# Poses whose columns are held at a time: 60 MB for all harmonics of six joints up to order 400.
_CHUNK = 512


def mean_columns(arm, angles, weights, codes, terms):
    """Mean of the model's columns over each position, (n_positions, 3, n_columns)."""
    total = group_weights(codes, weights)
    sums = 0.0
    for rows in chunks(len(angles), _CHUNK):
        columns = term_columns(arm, angles[rows], terms)
        sums = sums + group_sums(columns, codes[rows], weights[rows], len(total))
    return sums / total[:, None, None]


class Lengths(NamedTuple):
    """Known lengths as observations of the coefficients w: ``rows @ w`` is `errors` and noise."""

    rows: np.ndarray  # (n_lengths, p)
    errors: np.ndarray  # (n_lengths,) measured less known length, mm
    variance: np.ndarray  # (n_lengths,) of the known length, mm^2
    share: np.ndarray  # (n_lengths,) of the noise variance that the two mean points keep


def length_equations(arm, angles, weights, codes, terms, lengths):
    """Known lengths between positions as rows of the linear model.

    The mean points of two positions, corrected, are a known length apart: the difference of their
    corrections along the line between them is what the measured length is too long.

    Parameters
    ----------
    arm, angles, weights, codes, terms
        As :func:`candidate_sums`.
    lengths : list of (int, int, float, float)
        Two positions, their known distance and its standard deviation, mm.

    Returns
    -------
    Lengths
    """
    first, second, length, sd = (np.array(part) for part in zip(*lengths, strict=True))
    used, ends = np.unique([first, second], return_inverse=True)
    ends = ends.reshape(2, -1)
    rows = np.isin(codes, used)
    angles, weights, codes = angles[rows], weights[rows], np.searchsorted(used, codes[rows])
    total = group_weights(codes, weights)
    points = group_means(points_of(arm, angles[:, : arm.n_joints]), codes, weights)
    columns = mean_columns(arm, angles, weights, codes, terms)
    line = points[ends[1]] - points[ends[0]]
    measured = np.linalg.norm(line, axis=1)
    line /= measured[:, None]
    difference = columns[ends[1]] - columns[ends[0]]
    return Lengths(
        np.einsum("lc,lcp->lp", line, difference),
        measured - length,
        np.square(sd),
        1 / total[ends[0]] + 1 / total[ends[1]],
    )
