"""Repeatability and length errors before and after; public in `sklearn_raacmm.display`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.display._drawing import (
    AFTER,
    BEFORE,
    FittedDisplay,
    axes_grid,
    subtract,
    unit_of,
)
from sklearn_raacmm.metrics import (
    gauge_lengths,
    length_error,
    repeatability_interval,
    single_point_repeatability,
)
from sklearn_raacmm.utils import floats

_NAMES = {"2s": "2S", "max": "largest deviation", "mean": "mean deviation"}
_FLOOR = {"color": "0.2", "marker": "_", "linestyle": "", "markersize": 10}
# How far before and after stand to the left and right of their place, so that neither hides.
_SHIFT = 0.12


@dataclass(kw_only=True, eq=False, repr=False)
class RepeatabilityDisplay(FittedDisplay):
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

    after: np.ndarray
    positions: ArrayLike | None = None
    floor: np.ndarray | None = None
    statistic: str = "2s"
    before_interval: np.ndarray | None = None
    after_interval: np.ndarray | None = None

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
        points = floats("points", points, 3)
        sides = {"before": points, "after": subtract(points, y_pred)}
        if perfect is not None:
            sides["floor"] = subtract(points, perfect)
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
        labels = np.arange(1, len(self.before) + 1) if self.positions is None else self.positions
        _draw_sides(self, ax, slice(None), labels, (0.0, 1.35 * largest), "mean")
        ax.set(xlabel="position", ylabel=f"repeatability, {_NAMES[self.statistic]} ({self.unit_})")
        self.ax_: Any = ax
        self.figure_: Any = ax.figure
        return self


@dataclass(kw_only=True, eq=False, repr=False)
class LengthErrorDisplay(FittedDisplay):
    """Length errors of gauges in several placements, before and after the correction.

    Make one with :meth:`from_estimator` or :meth:`from_predictions`. Each calibrated length gets
    axes of its own.

    Parameters
    ----------
    before, after : ndarray of shape (n_placements,)
        Measured minus calibrated length, mm.
    lengths : ndarray of shape (n_placements,)
        Calibrated lengths, mm.
    floor : ndarray of shape (n_placements,), default=None
        Errors that a perfect correction would leave, mm; known in simulations only.
    name : str, default="after"
        Name of the correction in the legend.

    Attributes
    ----------
    axes_ : ndarray of matplotlib Axes of shape (n_lengths,)
        Axes of each calibrated length, the shortest first.
    figure_ : matplotlib Figure
        The figure.
    unit_ : str
        Unit of the figure: "µm" where the errors are below 0.1 mm on average, else "mm".

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> from sklearn_raacmm.datasets import make_gauge
    >>> from sklearn_raacmm.display import LengthErrorDisplay
    >>> gauge = make_gauge((300, 500), n_placements=2)  # simulated
    >>> display = LengthErrorDisplay.from_predictions(
    ...     gauge.points, gauge.simulation.perfect_correction,
    ...     groups=gauge.groups, pairs=gauge.pairs, lengths=gauge.lengths,
    ... )
    >>> [ax.get_title() for ax in display.axes_]
    ['300 mm', '500 mm']
    >>> plt.close(display.figure_)
    """

    after: np.ndarray
    lengths: np.ndarray
    floor: np.ndarray | None = None

    @classmethod
    def from_predictions(
        cls,
        points: ArrayLike,
        y_pred: ArrayLike,
        *,
        groups: ArrayLike,
        pairs: ArrayLike,
        lengths: ArrayLike,
        perfect: ArrayLike | None = None,
        name: str = "after",
        axes: Any = None,
    ) -> Self:
        """Draw the length errors of gauges before and after a given correction.

        Parameters
        ----------
        points, y_pred, perfect
            As in :meth:`RepeatabilityDisplay.from_predictions`; measured points only.
        groups : array-like of shape (n_points,)
            Label of the gauge's end of each point.
        pairs : array-like of shape (n_placements, 2)
            Labels of the two ends of each placement.
        lengths : float or array-like of shape (n_placements,)
            Calibrated lengths, mm.
        name : str, default="after"
            As for the class.
        axes : array-like of matplotlib Axes of shape (n_lengths,), default=None
            Axes to draw on, one for each different length. None: new ones.

        Returns
        -------
        LengthErrorDisplay

        Raises
        ------
        ValueError
            If shapes differ, values are not finite, a pair names a group without points, a
            measured length is not within half of the calibrated one (residuals given as points?),
            or there are not as many axes as lengths.
        """
        points = floats("points", points, 3)

        def errors(correction):
            measured = gauge_lengths(subtract(points, correction), groups, pairs)
            error = length_error(measured, lengths)
            wrong = np.abs(error) > 0.5 * np.broadcast_to(lengths, error.shape)
            if wrong.any():
                raise ValueError(
                    f"{wrong.sum()} of {len(wrong)} measured lengths miss their calibrated one by "
                    f"more than half of it (the first by {error[wrong][0]:.4g} mm). Points must be "
                    "measured points in mm, not residuals."
                )
            return error

        before = errors(np.zeros_like(points))
        return cls(
            before=before,
            after=errors(y_pred),
            lengths=np.broadcast_to(np.asarray(lengths, dtype=np.float64), before.shape),
            floor=None if perfect is None else errors(perfect),
            name=name,
        ).plot(axes)

    def plot(self, axes: Any = None) -> Self:
        """Draw the figure.

        Parameters
        ----------
        axes : array-like of matplotlib Axes of shape (n_lengths,), default=None
            Axes to draw on. None: new ones.

        Returns
        -------
        self : object
            The display, with `axes_` and `figure_`.
        """
        sizes = np.unique(self.lengths)
        axes = axes_grid(axes, (1, len(sizes)), figsize=(4.2 * len(sizes), 3.8), sharey=True)[0]
        drawn = [self.before, self.after] + ([] if self.floor is None else [self.floor])
        low, high = np.min(drawn), np.max(drawn)
        span = low - 0.05 * (high - low), high + 0.5 * 1.05 * (high - low)
        for ax, size in zip(axes, sizes, strict=True):
            rows = np.flatnonzero(self.lengths == size)
            ax.axhline(0, color="0.8", linewidth=1, zorder=0)
            _draw_sides(self, ax, rows, np.arange(1, len(rows) + 1), span, "mean |error|")
            ax.set(xlabel="placement", title=f"{size:g} mm")
        axes[0].set_ylabel(f"measured - calibrated ({self.unit_})")
        self.axes_: Any = axes
        self.figure_: Any = axes[0].figure
        return self


def _draw_sides(display, ax, rows, labels, span, title):
    """Draw rows of a display's values before and after, and of the floor where it is known.

    Over the labels of their places, with a legend above them; `span` are the ends of the vertical
    axis in mm. Sets the display's unit.
    """
    factor, display.unit_ = unit_of([display.before, display.after])
    digits = ".1f" if display.unit_ == "µm" else ".3f"
    for side, label, style, shift in (
        ("before", "before", BEFORE, -_SHIFT),
        ("after", display.name, AFTER, _SHIFT),
        ("floor", "noise floor", _FLOOR, 0.0),
    ):
        if getattr(display, side) is None:
            continue
        shown = factor * np.asarray(getattr(display, side))[rows]
        place = np.arange(1, len(shown) + 1) + shift
        size = f"{np.mean(np.abs(shown)):{digits}} {display.unit_}"
        ax.plot(place, shown, label=f"{label}: {size}", **style)
        interval = getattr(display, f"{side}_interval", None)
        if interval is not None:
            ax.vlines(place, *factor * np.transpose(interval), color=style["color"], linewidth=1.2)
    labels = [str(label) for label in labels]
    step = -(-len(labels) // 20)  # about twenty names at most
    turn = 45 * (max(map(len, labels)) > 4)
    ax.set_xticks(np.arange(1, len(labels) + 1)[::step], labels[::step], rotation=turn)
    for label in ax.get_xticklabels():
        label.set_parse_math(False)  # a dollar sign in a label is one
    if span[1] > span[0]:
        ax.set_ylim(factor * span[0], factor * span[1])
    ax.legend(fontsize="small", loc="upper left", title=title, title_fontsize="small")
