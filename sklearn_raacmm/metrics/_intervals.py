"""How well a repeatability is known from the poses that happened to be taken."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Real

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from sklearn_raacmm.metrics._repeatability import single_point_repeatability
from sklearn_raacmm.utils import check_option, deviations_by_group, group_means


def repeatability_interval(
    points: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    statistic: str = "2s",
    aggregate: str | None = "mean",
    probability: float = 0.95,
) -> np.ndarray:
    r"""Interval of the single-point repeatability: what other poses at the places would change.

    Parameters
    ----------
    points, groups
        As in :func:`single_point_repeatability`.
    statistic : {"2s", "mean"}, default="2s"
        As there. A largest deviation has no interval from one test: it grows with the number of
        points.
    aggregate : {"mean", None}, default="mean"
        As there.
    probability : float, default=0.95
        Probability of the interval, between 0 and 1.

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
    With C the covariance of the n points of a position, :math:`4 \operatorname{tr} C` is the
    square of 2S. It is a chi-squared variable of :math:`\nu = (n - 1) (\operatorname{tr} C)^2 /
    \operatorname{tr} C^2` degrees of freedom (F. E. Satterthwaite, Biometrics Bulletin 2, 1946)
    where deviations are normal. A mean of positions has the degrees of freedom of its variance,
    and the bias of roots, :math:`1 / 4 \nu`, is taken out. Of normal
    deviations 94 to 99 % of the intervals hold what they promise; of simulated arms more where the
    elbow swings from left to right, as tests have it, and fewer, in the worst case 81 %, where
    poses are drawn at random (``benchmarks/bench_acceptance.py intervals``).

    Examples
    --------
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> from sklearn_raacmm.metrics import repeatability_interval, single_point_repeatability
    >>> test = make_single_point(n_positions=4, n_poses=30, random_state=0)  # simulated
    >>> low, high = repeatability_interval(test.points, test.groups)
    >>> bool(low < single_point_repeatability(test.points, test.groups) < high)
    True
    """
    check_option("statistic", statistic, ("2s", "mean"))
    check_option("aggregate", aggregate, ("mean", None))
    if not (isinstance(probability, Real) and 0 < probability < 1):
        raise ValueError(f"probability must be between 0 and 1, got {probability!r:.60}.")
    value = single_point_repeatability(points, groups, statistic=statistic, aggregate=None)
    deviations, position, counts, _ = deviations_by_group(points, groups)
    products = (deviations[:, :, None] * deviations[:, None, :]).reshape(len(deviations), -1)
    products = group_means(products, position)  # C but for a factor that drops out
    trace = products[:, :: deviations.shape[1] + 1].sum(axis=1)
    square = np.square(products).sum(axis=1)
    # Points that all coincide have an interval of no length, whatever their degrees of freedom.
    freedom = (counts - 1) * np.where(square > 0, trace**2 / np.maximum(square, 1e-300), 1.0)
    if aggregate is not None:
        sizes = np.maximum(value, 1e-100)
        value = np.mean(value * (1 + 0.25 / freedom))
        freedom = sizes.sum() ** 2 / np.sum(sizes**2 / freedom)
        value /= 1 + 0.25 / freedom  # which the quantiles of the mean hold
    tails = np.array([1 + probability, 1 - probability]) / 2
    ends = np.sqrt(freedom / chi2.ppf(tails[:, None], freedom)) * value
    return ends[:, 0] if aggregate is not None else ends.T
