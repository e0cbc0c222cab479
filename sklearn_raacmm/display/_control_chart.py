"""Control chart of the checks of a correction; public in `sklearn_raacmm.display`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from os import PathLike
from typing import Any, Self

import numpy as np

from sklearn_raacmm.correction import read_check_records
from sklearn_raacmm.display._drawing import AFTER, FLOOR, axes_grid, name_places
from sklearn_raacmm.utils import listed

_ALARM = {"color": "tab:red", "linestyle": "", "marker": "o", "markersize": 11, "fillstyle": "none"}


class ControlChartDisplay:
    """Mean and range of what a correction leaves, check by check, with their limits.

    Make one with :meth:`from_file`, or of the `record` of several checks. Dashed lines are the
    limits of a correction that holds, at the rate of false alarms of the check. A circle marks a
    check that raised an alarm, with the suspected cause beside it.

    Parameters
    ----------
    records : list of dict
        Records of :func:`check_correction`, in order of time.

    Attributes
    ----------
    alarms : ndarray of int
        Numbers of the checks that named a suspect.
    axes_ : ndarray of matplotlib Axes of shape (2, 1)
        Means and ranges.
    figure_ : matplotlib Figure
        The figure.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> from sklearn_raacmm.display import ControlChartDisplay
    >>> good = {"date": "2026-05-01", "n_poses": 40, "mean_mm": 0.02, "mean_low_mm": 0.015,
    ...         "mean_high_mm": 0.03, "range_mm": 0.05, "range_low_mm": 0.03,
    ...         "range_high_mm": 0.08, "p_value": 1.0, "suspect": "nothing"}
    >>> bad = good | {"date": "2026-06-01", "mean_mm": 0.05, "suspect": "probe"}
    >>> display = ControlChartDisplay(records=[good, bad]).plot()
    >>> display.alarms.tolist()
    [1]
    >>> plt.close(display.figure_)
    """

    axes_: Any
    figure_: Any

    def __init__(self, *, records: list[Any]) -> None:
        self.records: list[Any] = listed("records", records)
        if not self.records:
            raise ValueError("There are no records to draw: append those of some checks first.")
        if not all(isinstance(record, dict) and "suspect" in record for record in self.records):
            raise ValueError("records must be those of check_correction or read_check_records.")
        suspects = [record["suspect"] for record in self.records]
        self.alarms: np.ndarray = np.flatnonzero([suspect != "nothing" for suspect in suspects])

    @classmethod
    def from_file(cls, path: str | PathLike[str], *, axes: Any = None) -> Self:
        """Draw the records of a file.

        Parameters
        ----------
        path : str or path-like
            Written by :meth:`~sklearn_raacmm.CorrectionCheck.append_to`.
        axes : array-like of matplotlib Axes of shape (2, 1), default=None
            Axes to draw on. None: new ones.

        Returns
        -------
        ControlChartDisplay

        Raises
        ------
        ValueError
            If the file has no records, or other lines.
        """
        return cls(records=read_check_records(path)).plot(axes)

    def plot(self, axes: Any = None, *, line_kwargs: dict[str, Any] | None = None) -> Self:
        """Draw.

        Parameters
        ----------
        axes : array-like of matplotlib Axes of shape (2, 1), default=None
            Axes to draw on. None: new ones.
        line_kwargs : dict, default=None
            Passed to the calls of matplotlib's ``plot`` that draw means and ranges.

        Returns
        -------
        self : object
            The display, with `axes_` and `figure_`.
        """
        axes = axes_grid(axes, (2, 1), figsize=(7, 5), sharex=True)
        place = np.arange(len(self.records))
        for ax, name in zip(axes[:, 0], ("mean", "range"), strict=True):
            value, low, high = (
                np.array([record[f"{name}{part}_mm"] for record in self.records])
                for part in ("", "_low", "_high")
            )
            for limit in (low, high):
                ax.step(place, limit, where="mid", **FLOOR)
            ax.plot(place, value, **(AFTER | (line_kwargs or {})))
            ax.plot(self.alarms, value[self.alarms], **_ALARM)
            ax.set_ylabel(f"{name} (mm)")
            ax.set_ylim(0, 1.15 * max(value.max(), high.max()))
            ax.grid(axis="y", color="0.9")
            ax.set_axisbelow(True)
            # The limits of a single check are points, not lines.
            ax.set_xlim(-0.5, len(place) - 0.5)
        for i in self.alarms:
            record = self.records[i]
            if i > 0 and record["suspect"] == self.records[i - 1]["suspect"]:
                continue  # named once: the labels of neighbours would overlap
            axes[0, 0].annotate(
                record["suspect"], (i, record["mean_mm"]), xytext=(0, 9),
                textcoords="offset points", ha="center", fontsize="small", color="tab:red",
            )  # fmt: skip
        axes[0, 0].set_title("What the correction leaves, and its limits", fontsize="medium")
        name_places(axes[1, 0], place, [record["date"] for record in self.records])
        axes[1, 0].set_xlabel("check")
        self.axes_, self.figure_ = axes, axes[0, 0].figure
        return self
