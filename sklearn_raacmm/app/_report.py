"""The report, one HTML file, of what a correction is worth; its figures, and pages of templates.

Figures are SVG text that takes the page's colour.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import datetime
import io
import platform
import re
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike
from scipy import stats

from sklearn_raacmm.correction import Correction
from sklearn_raacmm.display import HarmonicDisplay, RepeatabilityDisplay
from sklearn_raacmm.export import describe
from sklearn_raacmm.metrics import repeatability_interval
from sklearn_raacmm.utils import Groups, write_whole

# Rows shown of tables that may be long.
_MOST_ROWS = 40
_MOST_HARMONICS = 12
# Replaced by the colour of the page's text, so that figures are read in the dark, too.
_INK = "#010203"
_AFTER = "#0072B2"  # as the displays have it
_STYLE: Any = {"svg.fonttype": "none", "font.size": 9}
_STYLE |= dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor"), _INK)
_STYLE |= dict.fromkeys(("xtick.color", "ytick.color"), _INK)
_STYLE |= dict.fromkeys(("axes.facecolor", "figure.facecolor"), "none")
_STYLE |= dict.fromkeys(("legend.facecolor", "legend.edgecolor"), "none")
_STYLE |= dict.fromkeys(("axes.spines.top", "axes.spines.right"), False)
# Points drawn at most in a cloud: more make the file large and the cloud no clearer.
_MOST_POINTS = 600
_MOST_ARMS = 12


def write_report(
    result: Correction,
    path: str | PathLike[str] | None = None,
    *,
    facts: dict[str, str] | None = None,
    row_numbers: ArrayLike | None = None,
) -> str:
    """Write what was learnt as one HTML file that needs no network and prints on A4.

    Parameters
    ----------
    result : Correction
        What `learn_correction` returned.
    path : str or path-like, default=None
        File to write, beside its place and renamed when complete. None: nothing is written.
    facts : dict of str to str, default=None
        What else to put at the top, such as serial number and operator.
    row_numbers : array-like of shape (n_samples,), default=None
        Numbers that outliers are listed by, such as those of the rows in a file. None: from 0.

    Returns
    -------
    str
        The text of the file.

    Raises
    ------
    ImportError
        Without jinja2 or matplotlib: ``pip install -e ".[app]"`` in the project's folder.

    Notes
    -----
    Quantities are named as in ASME B89.4.22-2004 and ISO 10360-12:2016, as secondary sources
    describe these; the report is no statement of conformance to them.

    Examples
    --------
    ::

        from sklearn_raacmm import learn_correction
        from sklearn_raacmm.app import write_report

        learned = learn_correction(arm, angles, positions)
        write_report(learned, "report.html", facts={"serial number": "17"})
    """
    learnt: Any = result  # it has scores and data, which one that was loaded lacks
    scores, calibration = learnt.scores, learnt.calibration
    fitted = calibration.nominal, calibration.values, calibration.standard_deviations
    harmonics: list[tuple[np.void, float]] = []
    if getattr(learnt.model, "helps_", False):  # it is no other kind of model, and it helps
        waves, n_joints = learnt.model.harmonics_, learnt.arm.n_joints
        sds = HarmonicDisplay(harmonics=waves, n_joints=n_joints).amplitude_sd
        harmonics = list(zip(waves, sds, strict=True))[:_MOST_HARMONICS]
    off = np.linalg.norm(np.nan_to_num(scores.left_after), axis=1)
    numbers = np.arange(len(off)) if row_numbers is None else np.asarray(row_numbers)
    deviations = "Deviation of each position, before and after"
    cloud = "Points of the probe and poses of the arm"
    squares = np.mean(learnt.columns(learnt.inputs(learnt.angles)) ** 2, axis=0)
    text = render(
        "_report.html",
        result=learnt,
        scores=scores,
        facts=_facts(learnt) | (facts or {}),
        worst_first=np.argsort(-scores.table["after"], kind="stable"),
        # Mean squares over the poses learnt from, as `Correction.columns` has them.
        squares={
            "of a coordinate within a position": squares[6:9],
            "of a coordinate in the base frame": squares[3:6],
            "of a distance of 1 m": squares[9:],
        },
        parameters=zip(calibration.names, np.column_stack(fitted), strict=True),
        harmonics=harmonics,
        outliers=list_outliers(learnt, numbers),
        farthest=(numbers[off.argmax()], off.max()),
        row_numbers=row_numbers,
        figures={
            "positions": draw_svg("positions", deviations, draw_positions, scores),
            "volume": draw_svg("volume", cloud, draw_volume, learnt.arm, learnt.angles),
        },
        most_rows=_MOST_ROWS,
    )
    text = with_history(text, [])
    if path is not None:
        write_whole({path: text})
    return text


@cache
def _environment():
    import jinja2

    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
    )  # fmt: skip
    environment.filters["um"] = lambda mm: f"{1000 * mm:.1f}"
    # No minus before zero, and words for what nobody has stated.
    environment.filters["number"] = lambda value, digits: (
        "not stated" if np.isnan(value) else f"{round(value, digits) + 0.0:.{digits}f}"
    )
    return environment


def render(template, **values):
    """Page of a template in this folder."""
    return _environment().get_template(template).render(values)


def with_history(page, history):
    """A report, or a page without one, with its last step below its title and all at its end."""
    page = page or render("_page.html")
    steps = [step for step in history if step["what"] != "learn"]
    for name, template in (("last step", "_last_step.html"), ("steps", "_history.html")):
        first, last = f"<!-- {name} -->", f"<!-- end of {name} -->"
        if first not in page:  # it is no report of ours
            page = page.replace("</body>", "") + f"\n{first}{last}"
        before, rest = page.split(first, 1)
        page = f"{before}{first}\n{render(template, steps=steps)}{last}{rest.split(last, 1)[1]}"
    return page


def _facts(result):
    """What was measured, with what, and the fingerprints of both."""
    card = describe(result.model, result.inputs(result.angles), groups=result.positions)
    rows, model = card["training"], (card["fingerprint"] or "")[:16]
    return {
        "arm": result.arm.name or "without a name",
        "date": datetime.date.today().isoformat(),
        "rows": rows["rows"],
        "positions": rows["positions"],
        "fingerprint of the data": rows["data_fingerprint"][:16],
        "fingerprint of the model as learnt": model or "none for a model of this kind",
        "model": type(result.model).__name__,
        "versions": f"{card['written_by']}, NumPy {np.__version__}, SciPy {scipy.__version__}, "
        f"Python {platform.python_version()}",
    }


def list_outliers(result, row_numbers):
    """Number of the row, position and distance in mm of each outlier."""
    row, position, distance = (result.outliers[name] for name in result.outliers.dtype.names)
    return list(zip(row_numbers[row].tolist(), position, distance, strict=True))


# -- figures ---------------------------------------------------------------------------------------


def draw_svg(name, title, draw, *what):
    """SVG element of what `draw` makes of a figure; its names come from `name`."""
    import matplotlib
    from matplotlib.figure import Figure

    file = io.StringIO()
    about = {"Date": None, "Creator": None, "Title": title}
    with matplotlib.rc_context(_STYLE | {"svg.hashsalt": name}):
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
    return re.sub(r' (?:width|height)="[^"]*pt"', "", text, count=2)


def draw_positions(figure, scores):
    """2S, also from forms, or mean deviation of each position, before and after."""
    figure.set_size_inches(7.2, 3.2)
    order = Groups.in_order(scores.table["position"])
    RepeatabilityDisplay(
        before=scores.table["before"][order],
        after=scores.table["after"][order],
        positions=np.asarray(scores.table["position"])[order],
        statistic="2s" if scores.measure.startswith("2S") else "mean",
        before_interval=_intervals(scores, scores.left_before)[order],
        after_interval=_intervals(scores, scores.left_after)[order],
    ).plot(figure.subplots())


def _intervals(scores, left):
    """What another choice of poses at each position would change (95 %), mm; NaN of one pose."""
    intervals = np.full((len(scores.rows_by_position), 2), np.nan)
    for own, rows in zip(intervals, scores.rows_by_position, strict=True):
        if scores.measure.startswith("2S"):
            own[:] = repeatability_interval(left[rows])
        elif len(rows) > 1:
            far = np.linalg.norm(left[rows], axis=1)
            own[:] = stats.t.interval(0.95, len(far) - 1, far.mean(), stats.sem(far))
    return intervals


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
