"""Repeatability at positions and its interval, what a correction leaves of it, and scorers."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from functools import partial
from numbers import Real
from typing import overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2
from sklearn import get_config

from sklearn_raacmm.utils import Floats, Groups, check_option, floats

_DISTANCES = ("2s", "max", "mean")


@overload
def single_point_repeatability(
    points: ArrayLike, groups: ArrayLike | None = ..., *, statistic: str = ..., aggregate: str = ...
) -> float: ...
@overload
def single_point_repeatability(
    points: ArrayLike, groups: ArrayLike | None = ..., *, statistic: str = ..., aggregate: None
) -> Floats: ...
def single_point_repeatability(
    points: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    statistic: str = "2s",
    aggregate: str | None = "mean",
) -> float | Floats:
    r"""Single-point articulation repeatability: how far points of one place lie apart.

    Parameters
    ----------
    points : array-like of shape (n_points, n_coordinates) or (n_points,)
        Measured or corrected points, mm. Of residuals less predictions it is what a correction
        leaves: the constant of a position, which a cone-hole test cannot show, has no part in it.
    groups : array-like of shape (n_points,), default=None
        Label of the position (the cone) of each point. None: all are of one position.
    statistic : {"2s", "max", "mean"}, default="2s"
        Of the distances :math:`\delta_i` from the mean of the n points of a position: "2s" is
        :math:`2\sqrt{\sum\delta_i^2 / (n - 1)}`; "max" grows with n.
    aggregate : {"mean", "max", None}, default="mean"
        How the positions are summarised. None gives one value per position, in the order of
        ``np.unique(groups)``.

    Returns
    -------
    repeatability : float or ndarray of shape (n_positions,)
        In mm.

    Raises
    ------
    ValueError
        If points are not finite, a position holds a single point, the lengths of points and
        groups differ, or an option is unknown.

    Notes
    -----
    Equation 15 of Gao et al. (2020), doi 10.1177/1729881420925638 (a reconstruction), after the
    single-point test of ASME B89.4.22-2004, which states "2s" and "max".

    Examples
    --------
    >>> from sklearn_raacmm.metrics import single_point_repeatability
    >>> points = [[0.0, 0, 0], [0.2, 0, 0], [5, 5, 5], [5, 5.4, 5]]
    >>> single_point_repeatability(points, [1, 1, 2, 2], statistic="max", aggregate=None)
    array([0.1, 0.2])
    """
    check_option("statistic", statistic, _DISTANCES)
    check_option("aggregate", aggregate, ("mean", "max", None))
    deviations, position, counts = _deviations(points, groups)
    distances = np.linalg.norm(deviations, axis=1, keepdims=True)
    values = _of_positions(distances, position, counts, statistic)[:, 0]
    return values if aggregate is None else float(getattr(np, aggregate)(values))


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
    poses are drawn at random (``benchmarks/bench_lengths.py repeatability``).

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
    deviations, position, counts = _deviations(points, groups)
    products = (deviations[:, :, None] * deviations[:, None, :]).reshape(len(deviations), -1)
    products = Groups(position).means(products)  # C but for a factor that drops out
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


def axis_repeatability(
    points: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    statistic: str = "half_range",
    aggregate: str | None = "mean",
) -> Floats:
    r"""Repeatability of each coordinate by itself.

    Parameters
    ----------
    points : array-like of shape (n_points, n_coordinates)
        Measured or corrected points, mm.
    groups, aggregate
        As in :func:`single_point_repeatability`.
    statistic : {"half_range", "2s"}, default="half_range"
        "half_range" is (max - min) / 2, the plus-or-minus figure of makers' certificates; "2s"
        is twice the standard deviation with n - 1.

    Returns
    -------
    repeatability : ndarray of shape (n_coordinates,) or (n_positions, n_coordinates)
        In mm.

    Raises
    ------
    ValueError
        As :func:`single_point_repeatability`.

    Examples
    --------
    >>> from sklearn_raacmm.metrics import axis_repeatability
    >>> axis_repeatability([[0.0, 1, 0], [0.2, 1, 0], [0.1, 1, 0.6]])
    array([0.1, 0. , 0.3])
    """
    check_option("statistic", statistic, ("half_range", "2s"))
    check_option("aggregate", aggregate, ("mean", "max", None))
    deviations, position, counts = _deviations(points, groups)
    values = _of_positions(deviations, position, counts, statistic)
    return values if aggregate is None else getattr(np, aggregate)(values, axis=0)


def within_position_r2_score(
    y_true: ArrayLike, y_pred: ArrayLike, *, groups: ArrayLike | None = None
) -> float:
    """Share of the variance within positions that a correction takes away.

    One minus the sum of squared deviations of ``y_true - y_pred`` from its mean at each position,
    over the same sum of ``y_true``: R2 with one free constant per position.

    Parameters
    ----------
    y_true : array-like of shape (n_points, n_coordinates) or (n_points,)
        Residuals (or points), mm.
    y_pred : array-like of the shape of y_true
        The model's predictions, mm.
    groups
        As in :func:`single_point_repeatability`.

    Returns
    -------
    score : float
        1 for a perfect correction, 0 for none, negative for one that does harm.

    Raises
    ------
    ValueError
        As :func:`single_point_repeatability`; if the shapes of y_true and y_pred differ; or if
        y_true does not vary within any position.

    Examples
    --------
    >>> from sklearn_raacmm.metrics import within_position_r2_score
    >>> within_position_r2_score([4.0, 0.0, 9.0, 5.0], [2.0, 0.0, 2.0, 0.0], groups=[1, 1, 2, 2])
    0.75
    """
    after = (_deviations(difference(y_true=y_true, y_pred=y_pred), groups)[0] ** 2).sum()
    before = (_deviations(y_true, groups)[0] ** 2).sum()
    if before == 0:
        raise ValueError("y_true does not vary within any position: there is nothing to explain.")
    return float(1 - after / before)


def repeatability_scorer(
    X: ArrayLike | None = None,
    groups: ArrayLike | None = None,
    *,
    statistic: str = "2s",
    aggregate: str = "mean",
) -> Callable[..., float]:
    """Scorer for model selection: minus the scatter within positions after the correction.

    Parameters
    ----------
    X : array-like of shape (n_samples, n_features), default=None
        Only where metadata routing is off: the data that will be cross-validated. The scorer then
        remembers the group of each row, because scikit-learn passes groups to the splitter only.
    groups : array-like of shape (n_samples,), default=None
        Only with X: the label of the position of each row of X.
    statistic, aggregate
        As in :func:`single_point_repeatability`, of a test fold; `aggregate` may not be None.

    Returns
    -------
    scorer : callable
        ``scorer(estimator, X, y)``: minus :func:`single_point_repeatability` of what is left of y,
        in mm, so that greater is better. Without X and groups, a scorer of
        :func:`~sklearn.metrics.make_scorer` that requests `groups`, for metadata routing, which has
        to be enabled by then.

    Raises
    ------
    ValueError
        If only one of X and groups is given, or if equal rows of X belong to different groups;
        when scoring, if groups were not routed, or if a row was not among those of X.
    RuntimeError
        If neither is given and metadata routing is off.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import Ridge
    >>> from sklearn.model_selection import GroupKFold, cross_val_score
    >>> from sklearn_raacmm.metrics import repeatability_scorer
    >>> rng = np.random.default_rng(0)
    >>> X, groups = rng.uniform(-1, 1, (60, 2)), np.repeat(np.arange(6), 10)
    >>> y = X @ [[0.1, 0, 0], [0, 0.2, 0]] + 0.001 * rng.normal(size=(60, 3))
    >>> scoring = repeatability_scorer(X, groups)
    >>> scores = cross_val_score(Ridge(), X, y, groups=groups, cv=GroupKFold(3), scoring=scoring)
    >>> bool(-0.02 < scores.min() < scores.max() < 0)
    True
    """
    check_option("statistic", statistic, _DISTANCES)
    check_option("aggregate", aggregate, ("mean", "max"))
    if (X is None) != (groups is None):
        raise ValueError("Give X and groups together (metadata routing off), or neither (on).")
    options: dict = {"statistic": statistic, "aggregate": aggregate}
    if X is not None:
        return partial(_minus_scatter, positions=_positions_of_rows(X, groups), **options)
    if not get_config()["enable_metadata_routing"]:
        raise RuntimeError(
            "repeatability_scorer() without arguments needs metadata routing, which is off. "
            "Enable it first by sklearn.set_config(enable_metadata_routing=True), or tell the "
            "scorer the groups: repeatability_scorer(X, groups)."
        )
    from sklearn.metrics import make_scorer  # here: it takes long to import

    scorer = make_scorer(_routed_scatter, greater_is_better=False, **options)
    return scorer.set_score_request(groups=True)


def _routed_scatter(y_true, y_pred, *, groups=None, **options):
    if groups is None:
        raise ValueError(
            "repeatability_scorer() got no groups. Enable metadata routing and pass groups, or "
            "tell the scorer beforehand: repeatability_scorer(X, groups)."
        )
    return single_point_repeatability(difference(y_true=y_true, y_pred=y_pred), groups, **options)


def _positions_of_rows(X, groups):
    """Number of the group of each row of X, by the row's content."""
    X = floats("X", X, -1)
    labels, position = _groups(groups, len(X))
    found: dict = {}
    for row, p in zip(X, position, strict=True):
        if found.setdefault(row.tobytes(), p) != p:
            raise ValueError(
                f"The same row of X, {row}, belongs to the groups {labels[found[row.tobytes()]]} "
                f"and {labels[p]}: the group does not follow from the content of a row. Use "
                "metadata routing."
            )
    return found


def _minus_scatter(estimator, X, y, *, positions, **options):
    rows = floats("X", X, -1)
    position = [positions.get(row.tobytes(), -1) for row in rows]
    n_unknown = position.count(-1)
    if n_unknown:
        raise ValueError(
            f"{n_unknown} of {len(rows)} rows were not in the X given to "
            "repeatability_scorer(X, groups), so their groups are unknown."
        )
    left = difference(y_true=y, y_pred=estimator.predict(X))
    return -single_point_repeatability(left, position, **options)


def difference(columns: int = -1, /, **both: ArrayLike) -> Floats:
    """What is left of points or residuals less a correction: two arrays, by their names.

    They are of shape (n, columns), by default of any number of columns, the same in both.
    """
    (name, points), (other, correction) = ((n, floats(n, v, columns)) for n, v in both.items())
    if points.shape != correction.shape:
        raise ValueError(f"{name} has shape {points.shape}, but {other} {correction.shape}.")
    return points - correction


def _groups(groups: ArrayLike | None, n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Labels and codes as `Groups.encoded`; None makes all rows one group."""
    if groups is None:
        return np.zeros(1, dtype=int), np.zeros(n_samples, dtype=int)
    return Groups.encoded(groups, n_samples)


def _deviations(
    points: ArrayLike, groups: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Deviation of each point from its position's mean, its position, and counts."""
    points = floats("points", points, -1)
    labels, codes = _groups(groups, len(points))
    counts = np.bincount(codes)
    if counts.min() < 2:
        raise ValueError(
            f"{(counts < 2).sum()} of {len(counts)} positions hold a single point (the first: "
            f"{labels[counts < 2][0]!s}); a scatter needs at least 2."
        )
    return Groups(codes).centred(points), codes, counts


def _of_positions(values, position, counts, statistic):
    """Statistic of values (n, q) about their position's mean, or of distances from it."""
    if statistic == "2s":
        counts = counts[:, None]
        return 2 * np.sqrt(Groups(position).means(values**2) * counts / (counts - 1))
    if statistic == "mean":
        return Groups(position).means(values)
    low, high = np.zeros((2, len(counts), values.shape[1]))  # 0, the mean, lies between
    np.minimum.at(low, position, values)
    np.maximum.at(high, position, values)
    return high if statistic == "max" else (high - low) / 2
