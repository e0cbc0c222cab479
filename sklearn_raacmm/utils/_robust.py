"""Tukey's biweight: weights of rows by how far off they are."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.stats import chi

# Standard deviations of a coordinate from which on a row has no weight: of normal errors in space
# one in 200 000 is as far off.
TUKEY_LIMIT = 5.5


def tukey_weights(residuals, weights, least_scale=0.0):
    """Weights by Tukey's biweight; 1 for all rows where none is beyond the limit.

    The scale is the weighted median distance over that of normal errors.

    Parameters
    ----------
    residuals : ndarray of shape (n, q)
    weights : ndarray of shape (n,)
    least_scale : float, default=0
        Standard deviation of a coordinate that the scale does not fall below.

    Returns
    -------
    ndarray of shape (n,)
        ``(1 - (d / (5.5 s))^2)^2``, d the length of a residual and s the scale; 0 beyond 5.5 s.

    References
    ----------
    .. [1] A. E. Beaton, J. W. Tukey, "The fitting of power series, meaning polynomials, illustrated
       on band-spectroscopic data", Technometrics 16(2), 1974, 147-185.
    """
    distance = np.linalg.norm(residuals, axis=1)
    used = weights > 0
    median = np.quantile(distance[used], 0.5, weights=weights[used], method="inverted_cdf")
    limit = TUKEY_LIMIT * max(float(median) / chi.median(residuals.shape[1]), least_scale)
    if not (limit > 0 and np.any(distance[used] >= limit)):
        return np.ones(len(distance))
    share = np.minimum(distance, limit) / limit  # of next to nothing, no overflow
    return np.square(1 - np.square(share))
