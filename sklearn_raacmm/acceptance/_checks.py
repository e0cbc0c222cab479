"""Bad runs: what is missing, in another unit, of another artefact, or slipped."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import itertools
from collections import Counter
from typing import Any

import numpy as np

from sklearn_raacmm.acceptance._values import BARS, LAYOUTS, SPHERES
from sklearn_raacmm.metrics import fit_sphere
from sklearn_raacmm.utils import Finding, row_numbers

# Sizes that are off by more are of another artefact, mm; a calibrated arm is off by tenths.
_OTHER_MM = 2.0
# A reading that is off by so many standard deviations of its test, and by a tenth of a millimetre,
# has slipped. The standard deviation is that of normal errors with the same four fifths: a median
# would be that of few places only, and errors of an arm differ from place to place.
_SLIP_RATIO, _SLIP_MM, _SHARE = 8.0, 0.1, 0.8
_OF_SHARE = 1.2816  # standard deviations that hold this share
# Measured over stated size, and what that says.
_RATIOS = {
    "the points are in inches": 1 / 25.4,
    "the stated size, or the heading of the points, is in inches": 25.4,
    "the points are in metres": 1e-3,
    "the stated size is in metres": 1e3,
    "a radius was stated for a diameter": 2.0,
    "a diameter was stated for a radius": 0.5,
}


def find_faults(test: str, readings) -> list[Finding]:
    """What keeps a test from having values, the first kind of fault that is found."""
    if gap := next(_gaps(test, readings), ""):
        advice = "Measure what is missing: a test is whole or it has no value."
        return [_finding("acceptance-incomplete", f"{test}: {gap}", advice, readings.rows)]
    faults = []
    if test in (*SPHERES, *BARS):
        faults = _unknown(test, readings) or _wrong_sizes(test, readings)
    return faults or _slips(test, readings)


def _finding(code, text, advice, rows=(), size_mm=None):
    rows = row_numbers(rows)
    return Finding(code, text, advice, weight="repair", rows=rows, size_mm=size_mm)


def _gaps(test, readings):
    """Yield sentences on labels and readings that are missing, or too many."""
    levels, wanted, more = LAYOUTS[test]
    names, labels = [column for column, _ in levels], []
    columns = [np.char.lower(getattr(readings.run, name)[readings.rows]).tolist() for name in names]
    for (name, needed), column in zip(levels, columns, strict=True):
        there = sorted(set(column))
        labels.append(there)
        named: Any = needed if isinstance(needed, tuple) else ()
        least: Any = len(named) or needed
        enough = len(there) > least and more and name == names[0]
        if set(there) != set(named) if named else len(there) != least and not enough:
            asked = f" ({', '.join(named)})" if named else ""
            got = ", ".join(label or "without a label" for label in there[:8])
            yield f"{least} labels{asked} are needed in the column {name}; got {got}."
    counts = Counter(zip(*columns, strict=True))
    for key in itertools.product(*labels):
        n = counts[key]
        if n < wanted or (n > wanted and not (more and test in ("single-point", "pose"))):
            where = ", ".join(f"{column} {label}" for column, label in zip(names, key, strict=True))
            yield f"{where} has {n} readings, {wanted} are needed."


def _unknown(test, readings):
    """Artefacts of which nobody has stated what a value needs."""
    found = []
    for (name,), rows in readings.groups("artefact").items():
        artefact = readings.run.by_name.get(name)
        missing = ("everything",) if artefact is None else artefact.missing
        if missing:
            text = f"{test}: of the artefact {name!r} is not stated: {', '.join(missing)}."
            advice = "State what its certificate says, and its temperature."
            found.append(_finding("artefact-unknown", text, advice, readings.rows[rows]))
    return found


def _measured(test, readings):
    """Rows of each artefact or place, their measured size, and how far each is off it, mm."""
    if test in BARS:
        lengths, artefacts, last = readings.lengths()
        for artefact in dict.fromkeys(artefacts):
            own = np.array([one is artefact for one in artefacts])
            middle = float(np.median(lengths[own]))
            yield last[own], middle, np.abs(lengths[own] - middle)
        return
    # All articulations and repeats together: five points would bend their own sphere.
    for rows in readings.groups("artefact", "position").values():
        points = readings.points[rows]
        if test in SPHERES:
            _, radius, distances = fit_sphere(points)
            yield rows, 2 * radius, np.abs(distances - radius)
        else:
            yield rows, 0.0, np.linalg.norm(points - np.median(points, axis=0), axis=1)


def _wrong_sizes(test, readings):
    """Artefacts whose measured size is of another unit, or of another artefact."""
    tip = 0.0 if test in ("length", "volumetric") else readings.run.tip_mm
    for rows, raw, _ in _measured(test, readings):
        artefact = readings.artefact(rows)
        size = artefact.size_in_test
        off = abs(raw - tip - size)
        if off <= _OTHER_MM:
            continue
        # What is another artefact of the run is no unit.
        others = [f"it has the size of {a.name!r}" for a in readings.run.by_name.values()
                  if a.size_mm and abs(raw - tip - a.size_in_test) <= _OTHER_MM]  # fmt: skip
        if tip and abs(off - tip) <= _OTHER_MM:
            others.append("the probe's ball is compensated twice, or not at all")
        ratios = np.array([(raw - tip) / size, raw / (size + tip)])
        units = [what for what, ratio in _RATIOS.items()
                 if np.any(np.abs(ratios / ratio - 1) < 0.02)]  # fmt: skip
        code = "artefact-unit" if units and not others else "artefact-other"
        guess = [*others, *units, "it is another artefact"][0]
        text = (
            f"{test}: the artefact {artefact.name!r} measures {raw - tip:.4g} mm and is stated as "
            f"{size:.6g} mm: {guess}."
        )
        advice = "Correct the unit, the artefact's name or its size."
        return [_finding(code, text, advice, readings.rows[rows], off)]
    return []


def _slips(test, readings):
    """Readings that are so far off that the probe cannot have been where it should."""
    rows, _, off = zip(*_measured(test, readings), strict=True)
    rows, off = np.concatenate(rows), np.concatenate(off)
    limit = max(_SLIP_MM, _SLIP_RATIO / _OF_SHARE * float(np.quantile(off, _SHARE)))
    far = off > limit
    if not far.any():
        return []
    numbers = row_numbers(readings.rows[rows[far]])
    text = (
        f"{test}: {far.sum()} readings are off by up to {off.max():.3g} mm, where "
        f"{np.median(off):.2g} mm is usual (rows {', '.join(map(str, numbers[:8]))})."
    )
    advice = "Look whether the probe has slipped, and measure them again."
    return [_finding("slipped", text, advice, readings.rows[rows[far]], off.max())]
