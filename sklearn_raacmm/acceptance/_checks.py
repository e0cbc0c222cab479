"""Bad runs: what is missing, in another unit, of another artefact, copied, or slipped."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import itertools
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from sklearn_raacmm.acceptance._values import BARS, LAYOUTS, SPHERES, Readings
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.metrics import fit_sphere
from sklearn_raacmm.utils import Finding

# Sizes that are off by more are of another artefact, mm; a calibrated arm is off by tenths.
_OTHER_MM = 2.0
# A reading that is off by so many standard deviations of its test, and by a tenth of a millimetre,
# has slipped. The standard deviation is that of normal errors with the same four fifths: a median
# would be that of few places only, and errors of an arm differ from place to place.
_SLIP_RATIO, _SLIP_MM, _SHARE = 8.0, 0.1, 0.8
_OF_SHARE = 1.2816  # standard deviations that hold this share
# What is stated of an artefact: least and largest number, their unit, and how many of it one of the
# field's unit is. An expansion is 0 or no less than 1e-9 / K: that of Zerodur is 5e-9. Uncertainty
# and form are this share of the limit at least, and at most the limit: without one, this many mm.
_RANGES = {
    "temperature_degc": (5.0, 45.0, "degC", 1.0),
    "expansion_per_k": (-2.0, 30.0, "1e-6/K", 1e6),
}
_LEAST_EXPANSION, _SHARE_OF_LIMIT, _NO_LIMIT_MM = 1e-9, 1e-4, 0.1
# Places that are nearer are one, mm. Turns of the first two joints, rad, by which the elbow has not
# swung. Cones far and near are apart by this part of the reach: simulated ones are by 0.18.
_ONE_PLACE_MM, _SWING_RAD, _ZONES_APART = 10.0, 0.1, 0.1
# Standard deviations of the mean, the tester's and the scatter's, beyond which sizes are off.
_OFF_RATIO = 10.0
# Measured over stated size, and what that says.
_RATIOS = {
    "the points are in inches": 1 / 25.4,
    "the stated size, or the heading of the points, is in inches": 25.4,
    "the points are in metres": 1e-3,
    "the stated size is in metres": 1e3,
    "a radius was stated for a diameter": 2.0,
    "a diameter was stated for a radius": 0.5,
}


def find_faults(
    readings: Readings, arm: Arm | None = None, limit: float | None = None
) -> list[Finding]:
    """What keeps a test from having values, the first kind of fault that is found; or a doubt.

    `limit` is the largest of the values' limits, mm.
    """
    if gap := next(_gaps(readings), ""):
        advice = "Measure what is missing: a test that is not complete gets no value."
        return [_finding(readings, "acceptance-incomplete", gap, advice)]
    faults: list[Finding] = []
    if readings.test in (*SPHERES, *BARS):
        faults = list(_artefacts(readings, limit)) or _wrong_sizes(readings)
    taken = itertools.chain(_copies(readings), _ways(readings, arm))
    return faults or list(taken) or _slips(readings) or list(_off_means(readings))


def _finding(readings, code, text, advice, rows: Any = slice(None), size_mm=None):
    """What is wrong with a test, of some of its readings or of all."""
    rows, text = Finding.row_numbers(readings.rows[rows]), f"{readings.test}: {text}"
    return Finding(code, text, advice, weight="repair", rows=rows, size_mm=size_mm)


def _gaps(readings):
    """Yield sentences on labels and readings that are missing, or too many."""
    levels, wanted, more = LAYOUTS[readings.test]
    names = [column for column, _ in levels]
    columns = [np.char.lower(getattr(readings.run, name)[readings.rows]).tolist() for name in names]
    labels = [sorted(set(column)) for column in columns]
    for (name, needed), there in zip(levels, labels, strict=True):
        named, least = (needed, len(needed)) if isinstance(needed, tuple) else ((), needed)
        enough = len(there) > least and more and name == names[0]
        if set(there) != set(named) if named else len(there) != least and not enough:
            asked = f" ({', '.join(named)})" if named else ""
            got = ", ".join(label or "without a label" for label in there[:8])
            yield f"{least} labels{asked} are needed in the column {name}; got {got}."
    counts = Counter(zip(*columns, strict=True))
    for key in itertools.product(*labels):
        n = counts[key]
        if n < wanted or (n > wanted and not (more and readings.test in ("single-point", "pose"))):
            where = ", ".join(f"{column} {label}" for column, label in zip(names, key, strict=True))
            yield f"{where} has {n} readings, {wanted} are needed."


def _artefacts(readings, limit):
    """Artefacts of which a value needs what nobody has stated, or stated in another unit."""
    most = 1e3 * (limit or _NO_LIMIT_MM)
    least = _SHARE_OF_LIMIT * most
    ranges = _RANGES | {"expanded_mm": (least, most, "um", 1e3)}
    ranges["form_mm"] = (least if readings.test in SPHERES else 0.0, most, "um", 1e3)
    for (name,), rows in readings.groups("artefact").items():
        artefact = readings.run.by_name.get(name)
        missing = ("everything",) if artefact is None else artefact.missing
        if readings.test in SPHERES and artefact is not None and not artefact.form_mm:
            missing = (*missing, "form_mm")
        if missing:
            text = f"of the artefact {name!r} is not stated: {', '.join(missing)}."
            advice = "State what its certificate says, and its temperature."
            yield _finding(readings, "artefact-unknown", text, advice, rows)
            continue
        for field, (low, high, unit, factor) in ranges.items():
            shown = factor * getattr(artefact, field)
            tiny = field == "expansion_per_k" and 0 < abs(shown) < factor * _LEAST_EXPANSION
            if tiny or not low <= shown <= high:
                text = (
                    f"of the artefact {name!r} {field} is {shown:.3g} {unit}, where "
                    f"{low:.3g} to {high:.3g} {unit} can be."
                )
                advice = "Is it in the unit that its heading names?"
                yield _finding(readings, "artefact-implausible", text, advice, rows)


def _copies(readings):
    """Readings that are others, to the last digit."""
    angles = readings.run.angles
    values = readings.points if angles is None else angles[readings.rows]
    first = np.unique(values, axis=0, return_index=True)[1]
    again = np.setdiff1d(np.arange(len(values)), first)
    if len(again) and readings.test != "pose":  # which commands one pose many times
        text = f"{len(again)} readings are copies of others, to the last digit."
        advice = "Each reading is taken anew: measure them again."
        yield _finding(readings, "copied-readings", text, advice, again)


def _ways(readings, arm):
    """Where readings were taken, and how differently, against what the test asks."""
    columns = ("artefact", "position", "end") if readings.test in BARS else ("position",)
    means = {k: readings.points[rows].mean(axis=0) for k, rows in readings.groups(*columns).items()}
    places: dict[tuple[str, ...], list[np.ndarray]] = {}
    for key, mean in means.items():  # of a bar both ends
        places.setdefault(key[:2] if readings.test in BARS else key, []).append(mean)
    for (key, one), (other, two) in itertools.combinations(places.items(), 2):
        if key[:-1] == other[:-1] and np.abs(np.subtract(one, two)).max() < _ONE_PLACE_MM:
            text = f"positions {key[-1]} and {other[-1]} are one place: nothing was moved"
            advice = "Move the artefact between positions, and measure them again."
            yield _finding(readings, "one-place", f"{text} by {_ONE_PLACE_MM:g} mm.", advice)
            return
    of_cones = readings.test in ("single-point", "articulation")
    if arm is None or readings.run.angles is None or not of_cones:
        return
    angles, far = readings.run.angles[readings.rows], {}
    for (name,), rows in readings.groups("position").items():
        frames = arm.frames(angles[rows])[:, arm.pose_frames[0], :3, 3]
        far[name.lower()] = np.linalg.norm((readings.believed[rows] - frames).mean(axis=0))
        if np.ptp(angles[rows][:, :2], axis=0).max() < _SWING_RAD:
            text = f"at position {name} the elbow was not swung: joints 1 and 2 stand still"
            advice = "Take each reading with another pose of the arm."
            yield _finding(readings, "one-pose", f"{text}.", advice, rows)
    zones = [far.get(zone, 0.0) / arm.reach_mm for zone in ("near", "middle", "far")]
    apart = np.diff(zones)
    if readings.test == "single-point" and (apart.min() <= 0 or apart.sum() < _ZONES_APART):
        shown = ", ".join(f"{zone:.2f}" for zone in zones)
        text = f"near, middle and far are at {shown} of the reach from the shoulder."
        advice = "Put the cone near, in the middle and far, and name the positions so."
        yield _finding(readings, "wrong-zones", text, advice)


def _off_means(readings):
    """Lengths that agree with one another, but not with what is stated."""
    for rows, middle, off in _measured(readings) if readings.test in BARS else ():
        artefact, scatter = readings.artefact(rows), off.std()
        error = middle + off.mean() - readings.tip_mm - artefact.size_in_test
        u = np.hypot(artefact.u_size, artefact.fixture_mm)
        if abs(error) > _OFF_RATIO * np.hypot(u, scatter / np.sqrt(len(off))):
            text = f"{len(off)} lengths of {artefact.name!r} are off by {error:.3g} mm on average"
            text += f", and agree to {scatter:.2g} mm."
            advice = "Look whether the stated size is this artefact's, or the arm's scale is off."
            finding = _finding(readings, "mean-off", text, advice, rows, error)
            yield replace(finding, weight="doubt")


def _measured(readings):
    """Rows of each artefact or place, their measured size, and how far each is off it, mm."""
    if readings.test in BARS:
        lengths, artefacts, last = readings.lengths()
        for artefact in dict.fromkeys(artefacts):
            own = np.array([one is artefact for one in artefacts])
            middle = float(np.median(lengths[own]))
            yield last[own], middle, lengths[own] - middle
        return
    # All articulations and repeats together: five points would bend their own sphere.
    for rows in readings.groups("artefact", "position").values():
        points, size = readings.points[rows], 0.0
        off = np.linalg.norm(points - np.median(points, axis=0), axis=1)
        if readings.test in SPHERES:
            _, radius, distances = fit_sphere(points)
            size, off = 2 * radius, distances - radius
        yield rows, size, off


def _wrong_sizes(readings):
    """Artefacts whose measured size is of another unit, or of another artefact."""
    tip = readings.tip_mm
    for rows, raw, _ in _measured(readings):
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
            f"the artefact {artefact.name!r} measures {raw - tip:.4g} mm and is stated as "
            f"{size:.6g} mm: {guess}."
        )
        advice = "Correct the unit, the artefact's name or its size."
        return [_finding(readings, code, text, advice, rows, off)]
    return []


def _slips(readings):
    """Readings that are so far off that the probe cannot have been where it should."""
    rows, _, off = zip(*_measured(readings), strict=True)
    rows, off = np.concatenate(rows), np.abs(np.concatenate(off))
    limit = max(_SLIP_MM, _SLIP_RATIO / _OF_SHARE * float(np.quantile(off, _SHARE)))
    far = off > limit
    if not far.any():
        return []
    numbers = Finding.row_numbers(readings.rows[rows[far]])
    text = (
        f"{far.sum()} readings are off by up to {off.max():.3g} mm, where "
        f"{np.median(off):.2g} mm is usual (rows {', '.join(map(str, numbers[:8]))})."
    )
    advice = "Look whether the probe has slipped, and measure them again."
    return [_finding(readings, "slipped", text, advice, rows[far], off.max())]
