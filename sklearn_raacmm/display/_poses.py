"""The arm's poses in space, over their residuals; public in `sklearn_raacmm.display`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_scalar

from sklearn_raacmm.arm import Arm, arm_or_built_in
from sklearn_raacmm.display._drawing import AFTER, BEFORE, FittedDisplay, before_and_after, pyplot

_STICKS = {"color": "0.75", "linewidth": 1.5, "marker": "o", "markersize": 2.5, "markevery": 1}
# The longest residual is drawn as long as this share of the arm, or a little shorter.
_LONGEST = 0.3
# Matplotlib leaves space around a box in space for any view; the usual ones need less.
_ZOOM = 1.05


@dataclass(kw_only=True, eq=False, repr=False)
class ArmPosesDisplay(FittedDisplay):
    """Poses of an arm as stick figures in space, over their residuals, magnified.

    In a single-point test all poses end at one point, and the residuals stand on it like bristles.
    In a window of matplotlib (or by ``%matplotlib widget``), the mouse turns the figure.

    Make one with :meth:`from_estimator` or :meth:`from_predictions`.

    Parameters
    ----------
    chains : ndarray of shape (n_poses, n_corners, 3)
        Corners of the arm from base to probe, mm.
    before : ndarray of shape (n_poses, 3)
        Cartesian residuals, mm.
    after : ndarray of shape (n_poses, 3), default=None
        What the correction leaves of them, mm.
    name : str, default="after"
        Name of the correction in the legend.

    Attributes
    ----------
    ax_ : matplotlib Axes3D
        Axes of the figure.
    figure_ : matplotlib Figure
        The figure.
    magnification_ : float
        How many times longer than in truth the residuals are drawn.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> from sklearn_raacmm.display import ArmPosesDisplay
    >>> test = make_single_point(n_positions=3, n_poses=10)  # simulated
    >>> first = test.groups == 0
    >>> display = ArmPosesDisplay.from_predictions(
    ...     test.data[first], test.target[first], arm=test.arm
    ... )
    >>> display.chains[:, -1].round(0).tolist() == test.points[first].round(0).tolist()
    True
    >>> plt.close(display.figure_)
    """

    _draws_poses = True
    chains: np.ndarray
    before: np.ndarray
    after: np.ndarray | None = None
    name: str = "after"

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
        ax: Any = None,
        **options: Any,
    ) -> Self:
        """Draw poses, their residuals, and what a given correction leaves of them.

        Parameters
        ----------
        X, y, y_pred, arm, groups, angle_unit, name
            As in :meth:`ResidualDisplay.from_predictions`.
        ax : matplotlib Axes3D, default=None
            Axes to draw on, made with ``projection="3d"``. None: new ones.
        **options : dict
            `max_poses` and `magnification` of :meth:`plot`.

        Returns
        -------
        ArmPosesDisplay

        Raises
        ------
        ValueError
            If shapes differ, values are not finite, or the axes are flat.
        """
        arm = arm_or_built_in(arm, cls.__name__)
        chains = arm_chains(arm, X, angle_unit)
        before, after = before_and_after(len(chains), y, y_pred, groups)
        return cls(chains=chains, before=before, after=after, name=name).plot(ax, **options)

    def plot(
        self,
        ax: Any = None,
        *,
        max_poses: int = 12,
        magnification: float | str = "auto",
    ) -> Self:
        """Draw the figure.

        Parameters
        ----------
        ax : matplotlib Axes3D, default=None
            Axes to draw on, made with ``projection="3d"``. None: new ones.
        max_poses : int, default=12
            Most stick figures, evenly spaced among the poses. All residuals are drawn.
        magnification : float or "auto", default="auto"
            How many times longer than in truth the residuals are drawn. "auto": 1, 2 or 5 times a
            power of ten, such that the longest is 12 to 30 % of the arm's extent.

        Returns
        -------
        self : object
            The display, with `ax_`, `figure_` and `magnification_`.
        """
        if ax is not None and not hasattr(ax, "get_zlim"):
            raise ValueError('The axes are flat; make them with projection="3d".')
        check_scalar(max_poses, "max_poses", Integral, min_val=1)
        if isinstance(magnification, str) and magnification == "auto":
            magnification = self._magnification()
        if not (isinstance(magnification, Real) and 0 < float(magnification) < np.inf):
            raise ValueError(
                f'magnification must be "auto" or positive, got {magnification!r:.60}.'
            )
        self.magnification_ = float(magnification)
        if ax is None:
            ax = pyplot().figure(figsize=(6.5, 6)).add_subplot(projection="3d")
        tips = self.chains[:, -1]
        shown = np.unique(np.linspace(0, len(tips) - 1, min(max_poses, len(tips))).astype(int))
        for chain in self.chains[shown]:
            ax.plot(*chain.T, **_STICKS)
        ends = tips + self.magnification_ * self.before
        sides = [(ends, "before", BEFORE["color"])]
        if self.after is not None:
            left = tips + self.magnification_ * self.after
            sides.append((left, self.name, AFTER["color"]))
        for each, label, color in sides:
            # One line goes from every tip along its residual, NaN between them.
            lines = np.stack([tips, each, np.full_like(tips, np.nan)], axis=1)
            ax.plot(*lines.reshape(-1, 3).T, label=label, color=color, linewidth=1.0)
        corners = np.vstack([self.chains[shown].reshape(-1, 3), [[0, 0, 0]], ends])
        ax.plot(*np.array([[0, 0, 0], [0, 0, 1e-9]]).T, "s", color="0.4", markersize=6)
        ax.set(
            xlabel="x (mm)",
            ylabel="y (mm)",
            zlabel="z (mm)",
            title=f"{len(shown)} of {len(tips)} poses; residuals x {self.magnification_:g}",
        )
        # Equal scales, limits close to the points, and a box that fills the axes. Arms that stand
        # in one plane still get a box that can be turned.
        low, high = corners.min(axis=0), corners.max(axis=0)
        half = 0.52 * np.maximum(high - low, 0.1 * np.max(high - low))
        for axis, middle, side in zip("xyz", (low + high) / 2, half, strict=True):
            ax.set(**{f"{axis}lim": (middle - side, middle + side)})
        ax.set_box_aspect(half, zoom=_ZOOM)
        ax.locator_params(nbins=5)
        ax.legend(fontsize="small", loc="upper left")
        self.ax_: Any = ax
        self.figure_: Any = ax.figure
        return self

    def _magnification(self):
        longest = np.linalg.norm(self.before, axis=1).max()
        if longest == 0:
            return 1.0
        most = _LONGEST * np.ptp(self.chains.reshape(-1, 3), axis=0).max() / longest
        power = 10.0 ** np.floor(np.log10(most))
        return float(power * max(digit for digit in (1, 2, 5) if digit * power <= most))


def arm_chains(arm, angles, angle_unit="rad"):
    """Corners of an arm from base to probe, (n_poses, 2 * n_joints + 2, 3), mm.

    Between the origins of two frames a link runs along two sides of a corner: d along the joint's
    axis and a across it, in the order of the convention.
    """
    frames = arm.frames(angles, angle_unit=angle_unit)
    origins = frames[..., 3]
    corners = np.empty((len(frames), 2 * arm.n_joints + 2, 3))
    corners[:, 0:-1:2] = origins
    lengths, axis = (arm.d, 2) if arm.convention == "standard" else (arm.a, 0)
    corners[:, 1:-1:2] = origins[:, :-1] + lengths[:, None] * frames[:, :-1, :, axis]
    corners[:, -1] = arm.forward(angles, angle_unit=angle_unit)
    return corners
