"""What the displays share: checks, axes, lines and their styles."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.utils import check_points

BEFORE = {"color": "0.55", "marker": "o", "linestyle": ":", "markersize": 5}
AFTER = {"color": "tab:blue", "marker": "D", "linestyle": ":", "markersize": 5}
FLOOR = {"color": "0.2", "linestyle": "--", "linewidth": 1}


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


def new_axes(ax, figsize):
    """Given axes, or new ones."""
    return pyplot().subplots(figsize=figsize, layout="constrained")[1] if ax is None else ax


def axes_grid(axes, shape, **options):
    """Given axes in this shape, or new ones."""
    if axes is None:
        return pyplot().subplots(*shape, squeeze=False, layout="constrained", **options)[1]
    axes = np.asarray(axes, dtype=object)
    if axes.size != np.prod(shape):
        raise ValueError(f"{axes.size} axes were given, but {np.prod(shape)} are needed.")
    return axes.reshape(shape)


def line(ax, place, values, label, style, kwargs):
    mean = np.mean(np.abs(values))
    ax.plot(place, values, **(style | {"label": f"{label}: {mean:.4f} mm"} | (kwargs or {})))


def name_places(ax, place, labels):
    """Name every place, or about twenty of them where they are more."""
    step = -(-len(place) // 20)
    long = max(len(str(label)) for label in labels) > 4
    ax.set_xticks(place[::step], [str(label) for label in labels][::step], rotation=45 * long)


def room_for_legend(ax, low, high, share):
    """Limit the vertical axis, with this share of the range left free above."""
    if high > low:
        ax.set_ylim(low, high + share * (high - low))
