"""Values of acceptance tests from whole sets of readings, each with the tester's uncertainty."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import chi2

from sklearn_raacmm.acceptance._run import FORM_IN_DIAMETER, FORM_IN_LOCATION
from sklearn_raacmm.metrics import (
    articulated_location_error,
    axis_repeatability,
    fit_sphere,
    repeatability_interval,
    single_point_repeatability,
)

_ISO12, _ASME, _ISO9283 = "ISO 10360-12:2016", "ASME B89.4.22-2004", "ISO 9283:1998"
# What of a standard was read: nobody could open the texts themselves.
OPEN_SOURCE, PRACTICE = "open secondary source", "common practice"
_TIMES, _ENDS = (("position", 7), ("repeat", 3)), ("end", ("a", "b"))
# Levels of a test: columns whose labels are all combined, with how many there are of each, or
# which; readings in each combination; whether there may be more of the first level, or of readings.
LAYOUTS: dict[str, Any] = {
    "probing": ((("position", 2),), 25, False),
    "articulation": ((("position", 1), ("articulation", 5)), 5, True),
    "length": ((("artefact", 5), *_TIMES, _ENDS), 1, False),
    "bidirectional": ((("artefact", 5), *_TIMES, _ENDS), 1, False),
    "diameter": ((("repeat", 3),), 9, False),
    "single-point": ((("position", ("near", "middle", "far")),), 10, True),
    "volumetric": ((("position", 20), _ENDS), 1, True),
    "pose": ((("position", 5),), 30, True),
}  # fmt: skip
SPHERES, BARS = ("probing", "articulation", "diameter"), ("length", "bidirectional", "volumetric")
_ZONES = LAYOUTS["single-point"][0][0][1]
# Values in the order of the sheet: test, formula, standard, what of it was read.
VALUES: dict[str, tuple[str, str, str, str]] = {
    "P_Size": ("probing", "D_fit - D_cal, the worse position", _ISO12, OPEN_SOURCE),
    "P_Form": ("probing", "r_max - r_min, the worse position", _ISO12, OPEN_SOURCE),
    "L_Dia": ("articulation", "diameter of the smallest sphere round 5 centres", _ISO12,
              OPEN_SOURCE),
    "E_Uni": ("length", "L - L_cal, the worst of 105", _ISO12, OPEN_SOURCE),
    "E_Bi": ("bidirectional", "L - L_cal over opposite faces, the worst of 105", _ISO12, PRACTICE),
    "effective diameter": ("diameter", "D_fit - D_cal, the worst of 3", _ASME, OPEN_SOURCE),
    **{f"2S {z}": ("single-point", "2 sqrt(sum d^2 / (n - 1))", _ASME, OPEN_SOURCE)
       for z in _ZONES},
    **{f"largest {z}": ("single-point", "max d", _ASME, OPEN_SOURCE) for z in _ZONES},
    **{f"half range {z}": ("single-point", "(max - min) / 2, the worst axis", "makers", PRACTICE)
       for z in _ZONES},
    "volumetric largest": ("volumetric", "max |L - L_cal|", _ASME, OPEN_SOURCE),
    "volumetric range": ("volumetric", "max (L - L_cal) - min (L - L_cal)", _ASME, OPEN_SOURCE),
    "volumetric 2 rms": ("volumetric", "2 sqrt(sum (L - L_cal)^2 / n)", _ASME, OPEN_SOURCE),
    "AP": ("pose", "|mean - commanded|, the worst pose", _ISO9283, OPEN_SOURCE),
    "RP": ("pose", "mean l + 3 S_l, the worst pose", _ISO9283, OPEN_SOURCE),
}  # fmt: skip


class Readings:
    """The rows of one test: labels, points, and the points that a controller believed in.

    `tip_mm` is what sizes are larger by than those of artefacts; of lengths along one way nothing.
    """

    def __init__(self, run, rows, points, believed=None):
        self.run, self.rows, self.points = run, rows, points[rows]
        self.test = str(run.test[rows[0]])
        self.tip_mm = 0.0 if self.test in ("length", "volumetric") else run.tip_mm
        self.believed = None if believed is None else believed[rows]

    def groups(self, *columns):
        """Rows (m,) of this test for each combination of labels, in the order of the file."""
        labels = [getattr(self.run, name)[self.rows].tolist() for name in columns]
        found: dict[tuple[str, ...], list[int]] = {}
        for i, label in enumerate(zip(*labels, strict=True)):
            found.setdefault(label, []).append(i)
        return {label: np.array(rows) for label, rows in found.items()}

    def artefact(self, rows):
        """The artefact of some rows, None if it is none of the run's."""
        return self.run.by_name.get(self.run.artefact[self.rows][rows[0]])

    def u_place(self, rows):
        """Standard uncertainty of a place, mm: that of the seat or tracker; 0 if not stated."""
        artefact = self.artefact(rows)
        return artefact.fixture_mm if artefact else 0.0

    def lengths(self):
        """Measured lengths (k,) mm, their artefacts, and the last row of each."""
        end = np.char.lower(self.run.end[self.rows])
        found = []
        for rows in self.groups("artefact", "position", "repeat").values():
            first, second = (self.points[rows[end[rows] == name]] for name in "ab")
            for one, other in zip(first, second, strict=False):
                found.append((np.linalg.norm(other - one), self.artefact(rows), rows[-1]))
        lengths, artefacts, last = zip(*found, strict=True)
        return np.array(lengths), artefacts, np.array(last)


def _spheres(readings, column, name, form_name=None):
    """Errors of diameters, each of the rows of one label, and their forms."""
    groups = list(readings.groups(column).values())
    artefacts = [readings.artefact(rows) for rows in groups]
    fits = [fit_sphere(readings.points[rows]) for rows in groups]
    at = np.array([a.size_in_test for a in artefacts])
    errors = 2 * np.array([radius for _, radius, _ in fits]) - readings.tip_mm - at
    u = [np.hypot(a.u_size, FORM_IN_DIAMETER * a.form_mm) for a in artefacts]
    found = {name: (errors, at, u)}
    if form_name:
        forms = [np.ptp(distances) for *_, distances in fits]
        found[form_name] = (forms, at, [a.form_mm / 2 for a in artefacts])
    return found


def _articulation(readings):
    labels, groups = readings.run.articulation[readings.rows], readings.groups("position").values()
    artefacts = [readings.artefact(rows) for rows in groups]
    found = [articulated_location_error(readings.points[rows], labels[rows]) for rows in groups]
    u = [np.hypot(FORM_IN_LOCATION * a.form_mm, a.fixture_mm) for a in artefacts]
    return {"L_Dia": (found, [a.size_in_test for a in artefacts], u)}


def _lengths(readings, name):
    lengths, artefacts, _ = readings.lengths()
    sizes = np.array([a.size_in_test for a in artefacts])
    errors = lengths - readings.tip_mm - sizes
    return {name: (errors, sizes, [np.hypot(a.u_size, a.fixture_mm) for a in artefacts])}


def _single_point(readings):
    found = {}
    for (zone,), rows in readings.groups("position").items():
        points, more = readings.points[rows], ([0.0], [readings.u_place(rows)])
        twice = single_point_repeatability(points)
        interval = tuple(repeatability_interval(points).tolist())
        largest = single_point_repeatability(points, statistic="max")
        found[f"2S {zone.lower()}"] = ([twice], *more, interval)
        found[f"largest {zone.lower()}"] = ([largest], *more)
        found[f"half range {zone.lower()}"] = ([axis_repeatability(points).max()], *more)
    return found


def _volumetric(readings):
    errors, sizes, u = _lengths(readings, "")[""]
    artefacts, n, rms = readings.lengths()[1], len(errors), np.sqrt(np.mean(errors**2))
    common, own = np.array([(a.u_size, a.fixture_mm) for a in artefacts]).T
    worst, ends = np.abs(errors).argmax(), [errors.argmax(), errors.argmin()]
    # Of 2 rms the derivative by an error of the bar, 2 mean / rms, and by that of one placement.
    slope = 2 * abs(errors.mean()) / max(rms, 1e-300)
    u_rms = np.hypot(slope * common.max(), 2 * own.max() / np.sqrt(n))
    interval = tuple((2 * rms * np.sqrt(n / chi2.ppf([0.975, 0.025], n))).tolist())
    # What the bar's size is off by drops out of a difference, if both were taken on one bar.
    one_bar = artefacts[ends[0]] is artefacts[ends[1]]
    u_range = np.linalg.norm(own[ends] if one_bar else np.array(u)[ends])
    return {
        "volumetric largest": ([abs(errors[worst])], [sizes[worst]], [u[worst]]),
        "volumetric range": ([np.ptp(errors)], [sizes.max()], [u_range]),
        "volumetric 2 rms": ([2 * rms], [sizes.max()], [u_rms], interval),
    }


def _pose(readings):
    accuracy, repeatability, u = [], [], []
    for rows in readings.groups("position").values():
        points, mean = readings.points[rows], readings.points[rows].mean(axis=0)
        u.append(readings.u_place(rows))
        off = np.linalg.norm(points - mean, axis=1)
        repeatability.append(off.mean() + 3 * off.std(ddof=1))
        accuracy.append(np.linalg.norm(mean - readings.believed[rows].mean(axis=0)))
    sizes = [0.0] * len(u)
    return {n: (v, sizes, u) for n, v in (("AP", accuracy), ("RP", repeatability))}


# What each value of a test is the worst of, by the names of the values: errors and sizes (k,) mm,
# standard uncertainties of the errors, and where it is known the interval of 95 % from one run.
FUNCTIONS: dict[str, Callable[[Readings], dict[str, tuple[Any, ...]]]] = {
    "probing": partial(_spheres, column="position", name="P_Size", form_name="P_Form"),
    "articulation": _articulation,
    "length": partial(_lengths, name="E_Uni"),
    "bidirectional": partial(_lengths, name="E_Bi"),
    "diameter": partial(_spheres, column="repeat", name="effective diameter"),
    "single-point": _single_point, "volumetric": _volumetric, "pose": _pose,
}  # fmt: skip
