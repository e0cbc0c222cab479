"""What the displays share: checks, axes, lines and their styles."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.utils import floats

# Colours of Okabe and Ito, which colour-blind readers tell apart; shapes differ as well. Places
# have no order, so that no line joins them.
BEFORE = {"color": "#D55E00", "marker": "o", "linestyle": "", "markersize": 5}
AFTER = {"color": "#0072B2", "marker": "D", "linestyle": "", "markersize": 5}
# Mean size of the values up to which a figure is in micrometres, mm. The mean, because one outlier
# says nothing of the size of the others.
_MICROMETRES_UP_TO = 0.1


@dataclass(kw_only=True, eq=False, repr=False)
class FittedDisplay:
    """What a correction does, drawn of given predictions or of those of a fitted model."""

    before: np.ndarray
    name: str = "after"
    unit_ = ""  # known when it is drawn
    # Whether `from_predictions` takes the joint angles beside the points or residuals.
    _draws_poses = False

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
        object
            The display.
        """
        check_model(estimator)
        display: Any = cls
        given = (X, y) if cls._draws_poses else (y,)
        return display.from_predictions(*given, estimator.predict(X), **options)


def subtract(points, correction):
    """Take a correction (n, 3) off points (n, 3), both checked."""
    correction = floats("correction", correction, 3)
    if len(correction) != len(points):
        raise ValueError(f"{len(points)} points, but a correction for {len(correction)}.")
    return points - correction


def check_model(estimator):
    """Refuse what is no fitted model."""
    if not hasattr(estimator, "predict"):
        raise TypeError(f"estimator must be a fitted model, got {estimator!r:.60}.")
    check_is_fitted(estimator)


def axes_grid(axes, shape, **options):
    """Given axes in this shape, or new ones."""
    if axes is None:
        try:
            import matplotlib.pyplot as plt
        except ImportError:
            raise ImportError("Displays need matplotlib: pip install matplotlib.") from None
        return plt.subplots(*shape, squeeze=False, layout="constrained", **options)[1]
    axes = np.asarray(axes, dtype=object)
    if axes.size != np.prod(shape):
        raise ValueError(f"{axes.size} axes were given, but {np.prod(shape)} are needed.")
    for ax in axes.flat:
        if not hasattr(ax, "axhline"):
            raise TypeError(f"Axes of matplotlib are needed to draw on, got {ax!r:.60}.")
    return axes.reshape(shape)


def unit_of(values):
    """One unit for a figure: how many of it a mm has, and its name."""
    size = np.mean(np.abs(values)) if np.size(values) else 0.0
    return (1000.0, "µm") if size < _MICROMETRES_UP_TO else (1.0, "mm")
