"""How far a repeatability hangs on the poses that happened to be taken."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_random_state, check_scalar

from sklearn_raacmm.metrics._repeatability import single_point_repeatability
from sklearn_raacmm.utils import check_option, encode_groups, floats

_ROWS_AT_ONCE = 250_000  # about 20 MB with their labels


def repeatability_interval(
    points: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    statistic: str = "2s",
    aggregate: str | None = "mean",
    probability: float = 0.95,
    n_resamples: int = 400,
    random_state: int | np.random.RandomState | None = 0,
) -> np.ndarray:
    """Bootstrap interval of the single-point repeatability.

    Points of every position are drawn again with replacement: the interval shows what another
    choice of poses at the same positions would change.

    Parameters
    ----------
    points, groups, statistic, aggregate
        As in :func:`single_point_repeatability`.
    probability : float, default=0.95
        Probability of the interval, between 0 and 1.
    n_resamples : int, default=400
        Number of draws. With 400 the ends vary by a few per cent of the interval's length.
    random_state : int, RandomState instance or None, default=0
        Of the draws.

    Returns
    -------
    interval : ndarray of shape (2,) or (n_positions, 2)
        Lower and upper end, mm; for each position with ``aggregate=None``, in the order of
        ``np.unique(groups)``.

    Raises
    ------
    ValueError
        As :func:`single_point_repeatability`, or for an option out of range.

    Notes
    -----
    Percentile intervals (B. Efron, R. J. Tibshirani, "An Introduction to the Bootstrap", 1993,
    section 13.3). The mean square of a draw of n points about its mean is smaller by (n - 1) / n on
    average; "2s" and "mean" are corrected for that.

    Examples
    --------
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> from sklearn_raacmm.metrics import repeatability_interval, single_point_repeatability
    >>> test = make_single_point(n_positions=4, n_poses=30, random_state=0)  # simulated
    >>> low, high = repeatability_interval(test.points, test.groups)
    >>> bool(low < single_point_repeatability(test.points, test.groups) < high)
    True
    """
    check_option("aggregate", aggregate, ("mean", "max", None))
    check_scalar(n_resamples, "n_resamples", Integral, min_val=2)
    if not (isinstance(probability, Real) and 0 < probability < 1):
        raise ValueError(f"probability must be between 0 and 1, got {probability!r:.60}.")
    points = floats("points", points, -1)
    options = {"statistic": statistic, "aggregate": None}
    single_point_repeatability(points, groups, **options)  # refuses what cannot be judged
    codes = np.zeros(len(points), dtype=int) if groups is None else encode_groups(groups)[1]
    n_positions = codes.max() + 1
    found = []
    rng = check_random_state(random_state)
    draws = np.empty((n_resamples, len(codes)), dtype=np.intp)
    for code in range(n_positions):  # each row replaced by one of its own position
        rows = np.flatnonzero(codes == code)
        draws[:, rows] = rows[rng.randint(len(rows), size=(n_resamples, len(rows)))]
    for some in np.array_split(draws, -(-draws.size // _ROWS_AT_ONCE)):
        # Every position of every draw is a group of its own.
        labels = n_positions * np.arange(len(some))[:, None] + codes
        found.append(single_point_repeatability(points[some.ravel()], labels.ravel(), **options))
    found = np.concatenate(found).reshape(n_resamples, n_positions)
    if statistic != "max":
        counts = np.bincount(codes)
        found *= np.sqrt(counts / (counts - 1))
    if aggregate is not None:
        found = getattr(np, aggregate)(found, axis=1)
    return np.quantile(found, [(1 - probability) / 2, (1 + probability) / 2], axis=0).T
