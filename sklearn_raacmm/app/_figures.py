"""Figures of the report, as SVG text that takes the page's colour."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import io
import re
from typing import Any

import numpy as np
from scipy import stats

from sklearn_raacmm.display import RepeatabilityDisplay
from sklearn_raacmm.metrics import repeatability_interval
from sklearn_raacmm.utils import natural_order

# Replaced by the colour of the page's text, so that figures are read in the dark, too.
_INK = "#010203"
_AFTER = "#0072B2"  # as the displays have it
_INKED = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
_EMPTY = ("axes.facecolor", "figure.facecolor", "legend.facecolor", "legend.edgecolor")
_STYLE: Any = {
    **dict.fromkeys(_INKED, _INK),
    **dict.fromkeys(_EMPTY, "none"),
    "axes.spines.top": False,
    "axes.spines.right": False,
}
# Points drawn at most in a cloud: more make the file large and the cloud no clearer.
_MOST_POINTS = 600
_MOST_ARMS = 12
_TITLES = {
    "positions": "Deviation of each position, before and after",
    "volume": "Points of the probe and poses of the arm",
    "plan": "Where the cones stand, and poses that reach them",
}


def draw_svg(name, draw, *what):
    """SVG element of what `draw` makes of a figure; its names and its title come from `name`."""
    import matplotlib
    from matplotlib.figure import Figure

    file = io.StringIO()
    plain: Any = {"svg.fonttype": "none", "svg.hashsalt": name, "font.size": 9}
    about = {"Date": None, "Creator": None, "Title": _TITLES[name]}
    with matplotlib.rc_context(plain | _STYLE):
        figure = Figure(layout="constrained")
        draw(figure, *what)
        figure.savefig(file, format="svg", metadata=about)
    text = file.getvalue()
    # The element alone, which screen readers name by its title.
    text = text[text.index("<svg") :].replace("<svg ", '<svg role="img" ', 1)
    text = text.replace(_INK, "currentColor")
    # Groups are named alike in every figure, and nothing refers to them.
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    # The figure is as wide as the page, not as matplotlib's inches.
    for side in ("width", "height"):
        text = re.sub(rf'(<svg[^>]*?) {side}="[^"]*"', r"\1", text, count=1)
    return text


def draw_positions(figure, scores):
    """2S or mean deviation of each position, before and after."""
    figure.set_size_inches(7.2, 3.2)
    order = natural_order(scores.table["position"])
    RepeatabilityDisplay(
        before=scores.table["before"][order],
        after=scores.table["after"][order],
        positions=np.asarray(scores.table["position"])[order],
        statistic="2s" if scores.measure == "2S" else "mean",
        before_interval=_intervals(scores, scores.left_before)[order],
        after_interval=_intervals(scores, scores.left_after)[order],
    ).plot(figure.subplots())


def _intervals(scores, left):
    """What another choice of poses at each position would change (95 %), mm."""
    if scores.measure == "2S":
        return np.array([repeatability_interval(left[rows]) for rows in scores.rows_by_position])
    sizes = [np.linalg.norm(left[rows], axis=1) for rows in scores.rows_by_position]
    return np.array([stats.t.interval(0.95, len(s) - 1, s.mean(), stats.sem(s)) for s in sizes])


def draw_volume(figure, arm, angles, places=()):
    """Where the probe has been, from above and from the side, with some poses, and places."""
    figure.set_size_inches(7.2, 3.4)
    angles = angles[:: -(-len(angles) // _MOST_POINTS)]
    points, some = arm.forward(angles), angles[:: max(1, len(angles) // _MOST_ARMS)]
    chains = np.concatenate([arm.frames(some)[..., 3], arm.forward(some)[:, None]], axis=1)
    above, side = figure.subplots(1, 2)
    for ax, view in (
        (above, lambda p: p[:, :2].T),
        (side, lambda p: (np.hypot(p[:, 0], p[:, 1]), p[:, 2])),
    ):
        for chain in chains:
            ax.plot(*view(chain), color="0.6", linewidth=0.8, alpha=0.6)
        ax.plot(*view(points), ".", color=_AFTER, markersize=3)
        for number, place in enumerate(places, start=1):
            at = np.ravel(view(place[None]))
            ax.annotate(str(number), at, xytext=(4, 4), textcoords="offset points")
    above.set(xlabel="x, mm", ylabel="y, mm", title="from above", aspect="equal")
    across = "distance from the base axis, mm"
    side.set(xlabel=across, ylabel="z, mm", title="from the side", aspect="equal")
