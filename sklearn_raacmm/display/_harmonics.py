"""Harmonics of the encoders' errors; public in `sklearn_raacmm.display`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any, Self

import numpy as np

from sklearn_raacmm.display._drawing import AFTER, axes_grid, check_model

_DOTS = {"color": AFTER["color"], "linestyle": "", "marker": "o", "markersize": 4, "capsize": 2}

# Orders above this are those of gears, which show at their ratio and small multiples of it.
_COMMON_ORDER, _MULTIPLES = 72, np.array([1, 2, 3, 4])


class HarmonicDisplay:
    """Amplitude, phase and evidence of every harmonic found, joint by joint.

    Make one with :meth:`from_estimator`. Bars are one standard deviation either way. Where orders
    above 72 are multiples of one number, on this joint or on several, the joint's label names it:
    most likely the ratio of its gear.

    Parameters
    ----------
    harmonics : structured ndarray of shape (n_harmonics,)
        The table `harmonics_` of :class:`ArmResidualRegressor`.
    n_joints : int
        Number of joints of the arm.

    Attributes
    ----------
    amplitude_sd : ndarray of shape (n_harmonics,)
        Standard deviations of the amplitudes, arc seconds.
    phase_sd : ndarray of shape (n_harmonics,)
        Standard deviations of the phases, degrees.
    gear_ratios : ndarray of shape (n_joints,)
        Likely gear ratio of each joint, 0 where the orders show none.
    axes_ : ndarray of matplotlib Axes of shape (n_joints, 3)
        A row for each joint; amplitudes, phases and log Bayes factors.
    figure_ : matplotlib Figure
        The figure.

    Notes
    -----
    With c and s the coefficients of cosine and sine, the amplitude is ``hypot(c, s)`` and the phase
    ``atan2(s, c)``; standard deviations follow to first order, the covariance of c and s left out.
    The log Bayes factor of a harmonic is what it adds to the log evidence of the model, in nats.

    Examples
    --------
    >>> import matplotlib.pyplot as plt
    >>> from sklearn_raacmm import ArmResidualRegressor
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> from sklearn_raacmm.display import HarmonicDisplay
    >>> test = make_single_point(n_positions=6, n_poses=30, machine="eccentricity")  # simulated
    >>> model = ArmResidualRegressor(test.arm, orders=8)
    >>> _ = model.fit(test.data, test.target, groups=test.groups)
    >>> display = HarmonicDisplay.from_estimator(model)
    >>> display.axes_.shape
    (6, 3)
    >>> plt.close(display.figure_)
    """

    axes_: np.ndarray
    figure_: Any

    def __init__(self, *, harmonics: np.ndarray, n_joints: int) -> None:
        self.harmonics = harmonics
        self.n_joints = n_joints
        names = ("cos", "sin", "cos_sd", "sin_sd")
        cos, sin, cos_sd, sin_sd = (harmonics[f"{name}_arcsec"] for name in names)
        self.gear_ratios: np.ndarray = _likely_gear_ratios(
            harmonics["joint"], harmonics["order"], harmonics["log_bayes_factor"], n_joints
        )
        size = np.hypot(cos, sin)
        self.amplitude_sd: np.ndarray = np.hypot(cos * cos_sd, sin * sin_sd) / size
        self.phase_sd: np.ndarray = np.rad2deg(np.hypot(sin * cos_sd, cos * sin_sd) / size**2)

    @classmethod
    def from_estimator(cls, estimator: Any, *, axes: Any = None) -> Self:
        """Draw the harmonics that a fitted model found.

        Parameters
        ----------
        estimator : ArmResidualRegressor
            Fitted model.
        axes : array-like of matplotlib Axes of shape (n_joints, 3), default=None
            Axes to draw on. None: new ones.

        Returns
        -------
        HarmonicDisplay

        Raises
        ------
        sklearn.exceptions.NotFittedError
            If the model is not fitted.
        TypeError
            If it is a model of another kind.
        """
        check_model(estimator)
        if not hasattr(estimator, "harmonics_"):
            raise TypeError(
                f"Harmonics are drawn of an ArmResidualRegressor, got {type(estimator).__name__}."
            )
        return cls(harmonics=estimator.harmonics_, n_joints=estimator.arm_.n_joints).plot(axes)

    def plot(self, axes: Any = None) -> Self:
        """Draw.

        Parameters
        ----------
        axes : array-like of matplotlib Axes of shape (n_joints, 3), default=None
            Axes to draw on. None: new ones.

        Returns
        -------
        self : object
            The display, with `axes_` and `figure_`.
        """
        n = self.n_joints
        size = (10, 1.0 + 1.1 * n)
        axes = axes_grid(axes, (n, 3), figsize=size, sharex=True, sharey="col")
        for joint, (left, middle, right) in enumerate(axes, start=1):
            mine = self.harmonics["joint"] == joint
            some = self.harmonics[mine]
            ratio = self.gear_ratios[joint - 1]
            left.set_ylabel(f"joint {joint}" + (f"\ngear {ratio}?" if ratio else ""))
            for ax in (left, middle, right):
                ax.grid(axis="y", color="0.9")
                ax.set_axisbelow(True)
            if not len(some):
                at = {"color": "0.5", "ha": "right", "transform": left.transAxes}
                left.text(0.98, 0.8, "none found", **at)
                continue
            order = some["order"]
            left.vlines(order, 0, some["amplitude_arcsec"], color=_DOTS["color"], linewidth=1)
            left.errorbar(order, some["amplitude_arcsec"], self.amplitude_sd[mine], **_DOTS)
            middle.errorbar(order, some["phase_deg"], self.phase_sd[mine], **_DOTS)
            # From half a nat on, so that a logarithmic axis serves all: hundreds are common.
            evidence = np.maximum(some["log_bayes_factor"], 0.5)
            right.vlines(order, 0.5, evidence, color=_DOTS["color"], linewidth=1)
            right.errorbar(order, evidence, **_DOTS)
        titles = ("amplitude (arc seconds)", "phase (deg)", "log Bayes factor (nats)")
        for ax, title in zip(axes[0], titles, strict=True):
            ax.set_title(title, fontsize="medium")
        axes[0, 0].set_ylim(bottom=0)
        axes[0, 1].set(ylim=(-200, 200), yticks=[-180, 0, 180])
        axes[0, 2].set(yscale="log")
        axes[0, 2].set_ylim(bottom=0.5)
        for ax in axes[-1]:
            ax.set_xlabel("order: cycles a turn")
            ax.set_xlim(left=0)
        self.axes_, self.figure_ = axes, axes[0, 0].figure
        return self


def _likely_gear_ratios(joint, order, evidence, n_joints):
    """Gear ratio of each joint, 0 where none is likely, from joints, orders and log Bayes factors.

    The order above 72 for which the evidence of its multiples on all joints is largest, given that
    it has a multiple on this joint and one more anywhere.
    """
    ratios = np.zeros(n_joints, dtype=int)
    most = np.zeros(n_joints)
    for ratio in np.unique(order[order > _COMMON_ORDER]):
        members = np.isin(order, ratio * _MULTIPLES)
        support = evidence[members].sum()
        if np.count_nonzero(members) > 1:
            own = np.unique(joint[members].astype(int)) - 1
            better = own[support > most[own]]
            ratios[better], most[better] = ratio, support
    return ratios
