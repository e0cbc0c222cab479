"""What the displays share: checks, axes, lines and their styles."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.utils import check_points, show

# Colours of Okabe and Ito, which colour-blind readers tell apart; shapes differ as well. Places
# have no order, so that no line joins them.
BEFORE = {"color": "#D55E00", "marker": "o", "linestyle": "", "markersize": 5}
AFTER = {"color": "#0072B2", "marker": "D", "linestyle": "", "markersize": 5}
FLOOR = {"color": "0.2", "marker": "_", "linestyle": "", "markersize": 10}
# How far before and after stand to the left and right of their place, so that neither hides.
SHIFT = 0.12
# Mean size of the values up to which a figure is in micrometres, mm. The mean, because one outlier
# says nothing of the size of the others.
_MICROMETRES_UP_TO = 0.1


def subtract(points, correction):
    """Take a correction (n, 3) off points (n, 3), both checked."""
    correction = check_points(correction, n_coordinates=3)
    if len(correction) != len(points):
        raise ValueError(f"{len(points)} points, but a correction for {len(correction)}.")
    return points - correction


def pyplot():
    try:
        import matplotlib.pyplot as plt
    except ImportError:
        raise ImportError("Displays need matplotlib: pip install matplotlib.") from None
    return plt


def check_model(estimator):
    """Refuse what is no fitted model."""
    if not hasattr(estimator, "predict"):
        raise TypeError(f"estimator must be a fitted model, got {show(estimator)}.")
    check_is_fitted(estimator)


def check_name(name):
    """Text for a legend."""
    if not isinstance(name, str):
        raise TypeError(f"name must be a text for the legend, got {show(name)}.")
    return name


def new_axes(ax, figsize):
    """Given axes, or new ones."""
    return axes_grid(ax, (1, 1), figsize=figsize)[0, 0]


def axes_grid(axes, shape, **options):
    """Given axes in this shape, or new ones."""
    if axes is None:
        return pyplot().subplots(*shape, squeeze=False, layout="constrained", **options)[1]
    axes = np.asarray(axes, dtype=object)
    if axes.size != np.prod(shape):
        raise ValueError(f"{axes.size} axes were given, but {np.prod(shape)} are needed.")
    for ax in axes.flat:
        if not hasattr(ax, "axhline"):
            raise TypeError(f"Axes of matplotlib are needed to draw on, got {show(ax)}.")
    return axes.reshape(shape)


def unit_of(values):
    """One unit for a figure: how many of it a mm has, and its name."""
    size = np.mean(np.abs(values)) if np.size(values) else 0.0
    return (1000.0, "µm") if size < _MICROMETRES_UP_TO else (1.0, "mm")


def marks(ax, place, values, label, style, unit, kwargs=None, interval=None):
    """Draw a value (mm) at each place, with its interval (n, 2) where that is known."""
    factor, name = unit
    mean = factor * np.mean(np.abs(values))
    digits = ".1f" if name == "µm" else ".3f"
    style = style | {"label": f"{label}: {mean:{digits}} {name}"} | (kwargs or {})
    (drawn,) = ax.plot(place, factor * np.asarray(values), **style)
    if interval is not None:
        low, high = factor * np.asarray(interval).T
        ax.vlines(place, low, high, color=drawn.get_color(), linewidth=1.2)


def name_places(ax, place, labels):
    """Name every place, or about twenty of them where they are more."""
    step = -(-len(place) // 20)
    long = max(len(str(label)) for label in labels) > 4
    ax.set_xticks(place[::step], [str(label) for label in labels][::step], rotation=45 * long)


def room_for_legend(ax, low, high, share):
    """Limit the vertical axis, with this share of the range left free above."""
    if high > low:
        ax.set_ylim(low, high + share * (high - low))
