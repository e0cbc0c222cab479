"""Repeatability before and after a correction; public in `sklearn_raacmm.display`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.display._drawing import AFTER, axes_grid, check_model
from sklearn_raacmm.metrics import difference, repeatability_interval, single_point_repeatability

_NAMES = {"2s": "2S", "max": "largest deviation", "mean": "mean deviation"}
# Places have no order, so that no line joins them.
_BEFORE = {"color": "#D55E00", "marker": "o", "linestyle": "", "markersize": 5}
_FLOOR = {"color": "0.2", "marker": "_", "linestyle": "", "markersize": 10}
# How far before and after stand to the left and right of their place, so that neither hides.
_SHIFT = 0.12
# Mean size of the values up to which a figure is in micrometres, mm. The mean, because one outlier
# says nothing of the size of the others.
_MICROMETRES_UP_TO = 0.1


@dataclass(kw_only=True, eq=False, repr=False)
class RepeatabilityDisplay:
    """Single-point repeatability of every position, before and after the correction.

    Make one with :meth:`from_estimator` or :meth:`from_predictions`. Judge a correction at
    positions that its model was not fitted on.

    Parameters
    ----------
    before, after : ndarray of shape (n_positions,)
        Repeatability, mm.
    positions : array-like of shape (n_positions,), default=None
        Labels of the positions. None: 1, 2, ...
    floor : ndarray of shape (n_positions,), default=None
        What a perfect correction would leave, mm; known in simulations only.
    statistic : {"2s", "max", "mean"}, default="2s"
        See :func:`~sklearn_raacmm.metrics.single_point_repeatability`.
    name : str, default="after"
        Name of the correction in the legend.
    before_interval, after_interval : ndarray of shape (n_positions, 2), default=None
        Lower and upper ends of their intervals, mm, drawn as vertical lines: see
        :func:`~sklearn_raacmm.metrics.repeatability_interval`.

    Attributes
    ----------
    ax_ : matplotlib Axes
        Axes of the figure.
    figure_ : matplotlib Figure
        The figure.
    unit_ : str
        Unit of the figure: "µm" where the values are below 0.1 mm on average, else "mm".

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> from sklearn_raacmm.display import RepeatabilityDisplay
    >>> test = make_single_point(n_positions=3, n_poses=10)  # simulated
    >>> display = RepeatabilityDisplay.from_predictions(
    ...     test.points, test.simulation.perfect_correction, groups=test.groups
    ... )
    >>> display.before.shape
    (3,)
    >>> plt.close(display.figure_)
    """

    before: np.ndarray
    after: np.ndarray
    positions: ArrayLike | None = None
    floor: np.ndarray | None = None
    statistic: str = "2s"
    name: str = "after"
    before_interval: np.ndarray | None = None
    after_interval: np.ndarray | None = None
    unit_ = ""  # known when it is drawn

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise TypeError(f"name must be a text for the legend, got {self.name!r:.60}.")

    @classmethod
    def from_estimator(cls, estimator: Any, X: ArrayLike, y: ArrayLike, **options: Any) -> Self:
        """Draw what a fitted model corrects.

        Parameters
        ----------
        estimator : object
            Fitted model whose ``predict(X)`` gives the residuals dx, dy, dz in mm.
        X : array-like of shape (n_rows, n_features)
            What the model takes, such as joint angles.
        y : array-like of shape (n_rows, 3)
            Measured points or Cartesian residuals, mm, as in :meth:`from_predictions`.
        **options : dict
            The other parameters of :meth:`from_predictions`.

        Returns
        -------
        RepeatabilityDisplay
        """
        check_model(estimator)
        return cls.from_predictions(y, estimator.predict(X), **options)

    @classmethod
    def from_predictions(
        cls,
        points: ArrayLike,
        y_pred: ArrayLike,
        *,
        groups: ArrayLike,
        perfect: ArrayLike | None = None,
        statistic: str = "2s",
        name: str = "after",
        interval: float | None = 0.95,
        ax: Any = None,
    ) -> Self:
        """Draw the repeatability of points before and after a given correction.

        Parameters
        ----------
        points, y_pred : array-like of shape (n_points, 3)
            Measured points (or their residuals), and predicted residuals to be subtracted, mm.
        groups : array-like of shape (n_points,)
            Label of the position of each point.
        perfect : array-like of shape (n_points, 3), default=None
            What a perfect model would predict, mm, for the noise floor. Known in simulations only.
        statistic, name : str
            As for the class.
        interval : float or None, default=0.95
            Probability of the intervals, between 0 and 1. None: no intervals, as of "max", which
            has none.
        ax : matplotlib Axes, default=None
            Axes to draw on. None: new ones.

        Returns
        -------
        RepeatabilityDisplay

        Raises
        ------
        ValueError
            If shapes differ, values are not finite, a position holds a single point, or `interval`
            is not between 0 and 1.
        """
        sides = {"before": points, "after": difference(3, points=points, y_pred=y_pred)}
        if perfect is not None:
            sides["floor"] = difference(3, points=points, perfect=perfect)
        options: dict = {"groups": groups, "statistic": statistic, "aggregate": None}
        values = {side: single_point_repeatability(some, **options) for side, some in sides.items()}
        if interval is not None and statistic != "max":
            for side in ("before", "after"):
                ends = repeatability_interval(sides[side], probability=interval, **options)
                values[f"{side}_interval"] = ends
        display = cls(positions=np.unique(groups), statistic=statistic, name=name, **values)
        return display.plot(ax)

    def plot(self, ax: Any = None) -> Self:
        """Draw the figure.

        Parameters
        ----------
        ax : matplotlib Axes, default=None
            Axes to draw on. None: new ones.

        Returns
        -------
        self : object
            The display, with `ax_` and `figure_`.
        """
        ax = axes_grid(ax, (1, 1), figsize=(7, 3.6))[0, 0]
        shown = (self.before, self.after, self.floor, self.before_interval, self.after_interval)
        largest = max(np.max(values) for values in shown if values is not None)
        size = np.mean(np.abs([self.before, self.after])) if len(self.before) else 0.0
        factor, self.unit_ = (1000.0, "µm") if size < _MICROMETRES_UP_TO else (1.0, "mm")
        digits = ".1f" if self.unit_ == "µm" else ".3f"
        for values, label, style, shift, interval in (
            (self.before, "before", _BEFORE, -_SHIFT, self.before_interval),
            (self.after, self.name, AFTER, _SHIFT, self.after_interval),
            (self.floor, "noise floor", _FLOOR, 0.0, None),
        ):
            if values is None:
                continue
            drawn = factor * np.asarray(values)
            place = np.arange(1, len(drawn) + 1) + shift
            text = f"{label}: {np.mean(np.abs(drawn)):{digits}} {self.unit_}"
            ax.plot(place, drawn, label=text, **style)
            if interval is not None:
                ends = factor * np.transpose(interval)
                ax.vlines(place, *ends, color=style["color"], linewidth=1.2)
        labels = np.arange(1, len(self.before) + 1) if self.positions is None else self.positions
        labels = [str(label) for label in np.asarray(labels)]
        step = -(-len(labels) // 20)  # about twenty names at most
        turn = 45 * (max(map(len, labels)) > 4)
        ax.set_xticks(np.arange(1, len(labels) + 1)[::step], labels[::step], rotation=turn)
        for label in ax.get_xticklabels():
            label.set_parse_math(False)  # a dollar sign in a label is one
        if largest > 0:
            ax.set_ylim(0.0, factor * 1.35 * largest)
        ax.legend(fontsize="small", loc="upper left", title="mean", title_fontsize="small")
        ax.set(xlabel="position", ylabel=f"repeatability, {_NAMES[self.statistic]} ({self.unit_})")
        self.ax_: Any = ax
        self.figure_: Any = ax.figure
        return self
