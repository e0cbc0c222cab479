"""Residuals against the pose; public in `sklearn_raacmm.display`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.display._drawing import (
    AFTER,
    BEFORE,
    FittedDisplay,
    axes_grid,
    subtract,
    unit_of,
)
from sklearn_raacmm.residuals import PoseFeatures, cartesian_to_cylindrical
from sklearn_raacmm.utils import deviations_by_group, floats

_DOTS = {"linestyle": "", "marker": ".", "markersize": 4, "alpha": 0.5, "markeredgewidth": 0}
# The band in which nine of ten residuals lie, over bins of equal numbers of poses.
_TAILS, _MOST_BINS, _LEAST_PER_BIN = (0.05, 0.95), 12, 20
_COMPONENTS = ("radial", "tangential", "axial")


@dataclass(kw_only=True, eq=False, repr=False)
class ResidualDisplay(FittedDisplay):
    """Radial, tangential and axial residuals against the three angles of the pose.

    Dots are single poses. Where a correction is given, lines bound the band in which 90 % of the
    residuals lie before (dashed) and after it.

    Make one with :meth:`from_estimator` or :meth:`from_predictions`.

    Parameters
    ----------
    pose : ndarray of shape (n_points, 3)
        Angles of the pose, rad.
    before : ndarray of shape (n_points, 3)
        Radial, tangential and axial residuals, mm.
    after : ndarray of shape (n_points, 3), default=None
        What the correction leaves of them, mm.
    feature_names : sequence of str, default=("theta3", "theta4", "theta_dis")
        Names of the angles.
    name : str, default="after"
        Name of the correction in the legend.

    Attributes
    ----------
    axes_ : ndarray of matplotlib Axes of shape (3, 3)
        A row for each component, a column for each angle.
    figure_ : matplotlib Figure
        The figure.
    unit_ : str
        Unit of the figure: "µm" where the residuals are below 0.1 mm on average, else "mm".

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> from sklearn_raacmm.display import ResidualDisplay
    >>> test = make_single_point(n_positions=3, n_poses=10)  # simulated
    >>> display = ResidualDisplay.from_predictions(test.data, test.target, arm=test.arm)
    >>> [ax.get_xlabel() for ax in display.axes_[-1]]
    ['theta3 (deg)', 'theta4 (deg)', 'theta_dis (deg)']
    >>> plt.close(display.figure_)
    """

    _draws_poses = True
    pose: np.ndarray
    after: np.ndarray | None = None
    feature_names: Sequence[Any] = ("theta3", "theta4", "theta_dis")

    @classmethod
    def from_predictions(
        cls,
        X: ArrayLike,
        y: ArrayLike,
        y_pred: ArrayLike | None = None,
        *,
        arm: Arm | None = None,
        groups: ArrayLike | None = None,
        angle_unit: str = "rad",
        name: str = "after",
        axes: Any = None,
    ) -> Self:
        """Draw the residuals and what a given correction leaves of them.

        Parameters
        ----------
        X : array-like of shape (n_points, n_joints)
            Joint angles.
        y : array-like of shape (n_points, 3)
            Cartesian residuals dx, dy, dz, mm.
        y_pred : array-like of shape (n_points, 3), default=None
            Predicted residuals, mm. None: only `y` is drawn.
        arm : Arm, default=None
            The arm, as in :class:`~sklearn_raacmm.PoseFeatures`.
        groups : array-like of shape (n_points,), default=None
            Label of the position of each point, for a single-point test: the mean of what is left
            at each is taken away.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `X`.
        name : str, default="after"
            Name of the correction in the legend.
        axes : array-like of matplotlib Axes of shape (3, 3), default=None
            Axes to draw on. None: new ones.

        Returns
        -------
        ResidualDisplay

        Raises
        ------
        ValueError
            If shapes differ, values are not finite, or the arm has another number of joints.
        """
        features = PoseFeatures(arm, angle_unit=angle_unit, append_azimuth=True)
        columns = features.fit_transform(X)
        azimuth = np.arctan2(columns[:, 4], columns[:, 3])
        y, left = floats("y", y, 3), None
        if len(y) != len(columns):
            raise ValueError(f"X has {len(columns)} rows, but y {len(y)}.")
        if y_pred is not None:
            left = subtract(y, y_pred)
            left = left if groups is None else deviations_by_group(left, groups)[0]
        return cls(
            pose=columns[:, :3],
            before=cartesian_to_cylindrical(y, azimuth),
            after=None if left is None else cartesian_to_cylindrical(left, azimuth),
            feature_names=features.get_feature_names_out()[:3].tolist(),
            name=name,
        ).plot(axes)

    def plot(self, axes: Any = None) -> Self:
        """Draw the figure.

        Parameters
        ----------
        axes : array-like of matplotlib Axes of shape (3, 3), default=None
            Axes to draw on. None: new ones.

        Returns
        -------
        self : object
            The display, with `axes_` and `figure_`.
        """
        given = axes is not None
        axes = axes_grid(axes, (3, 3), figsize=(8, 6.5), sharex="col", sharey=True)
        # Rasterised: thousands of dots would make a vector file of megabytes.
        dots = _DOTS | {"rasterized": True}
        factor, unit = unit_of(self.before)
        sides = [(self.before, "before", BEFORE["color"], "--")]
        if self.after is not None:
            sides.append((self.after, self.name, AFTER["color"], "-"))
        for i, j in np.ndindex(3, 3):
            ax, angle = axes[i, j], np.rad2deg(self.pose[:, j])
            for values, label, color, _ in sides:
                ax.plot(angle, factor * values[:, i], color=color, label=label, **dots)
            if self.after is not None:
                for values, label, color, line in sides:
                    middle, band = _band(angle, factor * values[:, i])
                    name = [f"90 %, {label}"] + [None] * (len(band) - 1)
                    ax.plot(middle, band.T, color=color, linestyle=line, lw=1.4, label=name)
            if i == 2:
                ax.set_xlabel(f"{self.feature_names[j]} (deg)")
            if j == 0:
                ax.set_ylabel(f"{_COMPONENTS[i]} residual ({unit})")
        if self.after is not None and given:
            axes[0, 2].legend(fontsize="small", markerscale=3)
        elif self.after is not None:
            handles = axes[0, 0].get_legend_handles_labels()
            axes[0, 0].figure.legend(*handles, loc="outside lower center", ncols=4, markerscale=3)
        self.axes_: Any = axes
        self.figure_: Any = axes[0, 0].figure
        self.unit_: str = unit
        return self


def _band(angle, values):
    """Middles of bins of equal numbers of poses, and the quantiles (2, n_bins) in each."""
    n_bins = int(np.clip(len(angle) // _LEAST_PER_BIN, 1, _MOST_BINS))
    bins = np.array_split(np.argsort(angle, kind="stable"), n_bins)
    middle = np.array([np.median(angle[rows]) for rows in bins])
    return middle, np.array([np.quantile(values[rows], _TAILS) for rows in bins]).T
