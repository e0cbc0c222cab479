"""What `calibrate` is given, checked, and what it warns of."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any, NamedTuple

import numpy as np

from sklearn_raacmm.arm import FIELDS, MAX_LENGTH_MM, check_angles, reach_mm
from sklearn_raacmm.calibration._problem import Problem
from sklearn_raacmm.calibration._result import is_angle
from sklearn_raacmm.measurements import within_turn
from sklearn_raacmm.utils import Finding, encode_groups, floats, listed, say_findings

# Standard deviations of a known length beyond which it disagrees: once in 1.7 million.
_LENGTH_OUTLIER = 5.0
# A picometre: smaller than any length is known, large enough to divide by.
_LEAST_SD_MM = 1e-9
# Standard errors by which a correction has to enlarge the scatter: of corrections that change
# nothing on the average one in forty does by chance.
_HARM = 2.0
# What no calibration of an arm comes to: a scatter, as a part of the reach.
SHARE_OF_REACH = 0.02
# Scatter after calibration beyond which the arm's table is probably wrong: measuring arms have
# hundredths of a mm, the real robots of the tests 0.2 to 0.4.
MUCH_SCATTER_MM = 1.0
_MOST_NAMED = 4
_MEANING = {
    "a": "the length of link",
    "d": "the offset of joint",
    "alpha": "the twist of link",
    "theta_offset": "the zero of joint",
}


def check_problem(angles, groups, points, lengths, tools, stations):
    """The data of a calibration as a `Problem`, and the labels of tools and stations."""
    n = len(angles)
    if n == 0:
        raise ValueError("angles are empty: there is nothing to calibrate with.")
    if (groups is None) == (points is None):
        raise ValueError("give either groups, or points that were measured.")
    tool_labels, tools = (None, None) if tools is None else encode_groups(tools, n, "tools")
    station_labels, stations = (
        (None, None) if stations is None else encode_groups(stations, n, "stations")
    )
    if points is not None:
        points = _check_points(points, n, lengths)
        problem = Problem(None, points, [], tools=tools, stations=stations)
        return problem, tool_labels, station_labels
    if stations is not None:
        raise ValueError(
            "stations are of measured points. In a test without a tracker, a fixed point that is "
            "measured from another place is another group: give it a label of its own."
        )
    labels, index = encode_groups(groups, n)
    labels = labels.tolist()
    lengths = [check_length(entry, labels) for entry in lengths]
    problem = Problem(index, None, lengths, tools=tools)
    if problem.n_informative == 0:
        raise ValueError(f"each of the {len(labels)} groups has one point: none can scatter.")
    tied = {i for entry in lengths for i in entry[:2]}
    lonely = [i for i, c in enumerate(np.bincount(index)) if c == 1 and i not in tied]
    if lonely:
        said = f"{len(lonely)} groups have one point and say nothing, such as {labels[lonely[0]]}."
        names = [labels[i] for i in lonely]
        say_findings([Finding("lonely-position", said, positions=tuple(names))])
    return problem, tool_labels, None


def _check_points(points, n, lengths):
    points = floats("points", points, finite=True)
    if points.shape != (n, 3):
        raise ValueError(f"points must have shape ({n}, 3), got {points.shape}.")
    if lengths:
        raise ValueError("lengths are between groups; measured points have no use for them.")
    return points


class Correction(NamedTuple):
    """A fitted model, and the rows at which it is asked."""

    model: Any
    X: np.ndarray  # as the model takes them

    def of_poses(self, poses):
        """The same at the first row of each pose."""
        return self._replace(X=self.X[poses.first]) if poses.merges else self

    def at(self, probes, problem):
        """Predicted residuals (n, 3) of rows with the probe of each tool, (n_tools, 3)."""
        residuals = np.empty((len(self.X), 3))
        for tool, probe in enumerate(probes):
            rows, model = problem.rows_of_tool(tool), self.model
            if can_be_moved(model):
                model = model.with_arm(model.arm_.replace(probe=probe))
            residuals[rows] = _finite_residuals(model, self.X[rows])
        return residuals


def can_be_moved(model):
    """Whether a fitted model can be moved to another probe."""
    return hasattr(model, "with_arm")


def checked_correction(correction, angles, angle_unit):
    """A `Correction` of the rows; one that cannot predict them is refused."""
    if not hasattr(correction, "predict"):
        raise TypeError(
            "correction must be a fitted model with predict(angles), got "
            f"{type(correction).__name__}."
        )
    angles = np.asarray(angles, dtype=float)
    # A model that was trained in degrees is asked in degrees.
    if getattr(correction, "angle_unit", "rad") == "deg":
        angles = angles if angle_unit == "deg" else np.rad2deg(angles)
    elif angle_unit == "deg":
        angles = np.deg2rad(angles)
    _finite_residuals(correction, angles)
    return Correction(correction, angles)


def _finite_residuals(model, angles):
    residuals = np.asarray(model.predict(angles), dtype=float)
    if residuals.shape != (len(angles), 3) or not np.all(np.isfinite(residuals)):
        raise ValueError(
            f"correction.predict must give finite residuals of shape ({len(angles)}, 3) in mm, "
            f"got shape {residuals.shape}."
        )
    return residuals


def check_arm_angles(arm, angles, angle_unit):
    """Angles in rad within one turn, lest a warning of far angles be said again by what follows."""
    angles = check_angles(angles, arm.n_joints, angle_unit)
    return within_turn(angles)


def check_free(free):
    free = listed("free", free)
    if not all(isinstance(name, str) and name in FIELDS for name in free):
        raise ValueError(f"free must name some of {', '.join(FIELDS)}, got {free!r:.60}.")
    return free


def check_length(entry: Any, labels: Any) -> Any:
    """A known length as (position, position, length, sd), positions by their index."""
    try:
        first, second, length, sd = entry
        length, sd = float(length), float(sd)
    except (TypeError, ValueError):
        raise ValueError(
            "each of lengths must be (label, label, length, standard deviation), got "
            f"{entry!r:.60}."
        ) from None
    for label in (first, second):
        if label not in labels:
            raise ValueError(f"lengths name the group {label!r}, which has no samples.")
    in_bounds = 0 < length <= 2 * MAX_LENGTH_MM and _LEAST_SD_MM <= sd < np.inf
    if not in_bounds or first == second:
        raise ValueError(
            f"a length must join two different groups, it must be positive and at most "
            f"{2 * MAX_LENGTH_MM:g} mm and its standard deviation at least {_LEAST_SD_MM:g} mm, "
            f"got {entry!r:.60}."
        )
    return labels.index(first), labels.index(second), length, sd


def warn_of_wrong_lengths(lengths, errors, sigma):
    wrong = [
        f"{first} to {second} is {float(length) + error:.6g} mm, given as {float(length):g} +- "
        f"{float(sd):g} mm"
        for (first, second, length, sd), error in zip(lengths, errors, strict=True)
        if abs(error) > _LENGTH_OUTLIER * max(float(sd), sigma)
    ]
    if wrong:
        said = (
            f"{len(wrong)} of {len(lengths)} known lengths disagree with the rest of the data: "
            f"{'; '.join(wrong[:3])}{'; ...' if len(wrong) > 3 else ''}."
        )
        size = max(abs(error) for error in errors)
        say_findings([Finding("wrong-length", said, size_mm=size)])


def warn_of_few_rows(seen, names, problem):
    """Say that the rows cannot carry what is asked of them."""
    n, rank, spare = problem.n_coordinates, seen.rank, problem.n_coordinates - seen.rank
    if not names or spare >= rank:
        return
    rows = int(np.ceil((n + rank - spare) / n * problem.n_informative))
    what = "measured points" if problem.points is not None else "groups of points"
    known = (
        "The noise, and with it every standard deviation, is unknown."
        if spare <= 0
        else "The noise and the standard deviations are hardly known, and the arm may be far off "
        "at other poses."
    )
    said = (
        f"{problem.n_informative} {what} give {max(n, 0)} coordinates for {len(names)} free "
        f"parameters, of which they could show {rank}: {max(spare, 0)} are left to check them "
        f"with. {known}"
    )
    advice = f"Measure about {rows} rows or more, or let fewer fields change (free=)."
    say_findings([Finding("few-rows", said, advice)])


def warn_of_what_no_arm_is(arm, before, after):
    """Say that a fit which has settled makes no sense; returns whether it was said."""
    reach = reach_mm(arm)
    if after <= min(SHARE_OF_REACH * reach, 2 * before + 1e-6 * reach):
        return False
    said = (
        f"The points still scatter by {after:.4g} mm ({before:.4g} mm before; the arm reaches "
        f"{reach:.4g} mm)."
    )
    advice = (
        "Look at the labels, known lengths, the order and sense of the joints, the convention of "
        "the table, and the unit of the angles."
    )
    say_findings([Finding("no-such-arm", said, advice, "repair", size_mm=after)])
    return True


def table_findings(names, nominal, values, sd, far, lengths, scatter_mm=0.0):
    """Findings on a table that the data contradict: an offset forgotten, a link mistyped.

    Arrays (n_parameters,), mm and rad: before, after and its standard deviation, and how far apart
    they may be. Known lengths may be what is wrong.
    """
    departure = np.abs(values - nominal)
    # Parameters that only others determine wander: an offset along the last axis and the probe.
    is_wrong = (departure > far) & ~(departure < _LENGTH_OUTLIER * sd)
    wrong = [i for i in np.argsort(-departure / far) if is_wrong[i]]
    if not wrong:
        return []
    said, joints = [], []
    for i in wrong:
        field = names[i].rstrip("0123456789")
        joints.append(int(names[i].removeprefix(field)))
        factor, unit = (180 / np.pi, "°") if is_angle(names[i]) else (1.0, " mm")
        said.append(
            f"{_MEANING[field]} {joints[-1]} ({names[i]}) is {factor * values[i]:.1f}{unit}, "
            f"the table says {factor * nominal[i]:.6g}{unit}"
        )
    if scatter_mm > MUCH_SCATTER_MM:
        advice = (
            f"But with it the points scatter by {scatter_mm:.1f} mm: search_table finds joints "
            "that are reversed or exchanged."
        )
    else:
        advice = "If it is built so, take the calibrated arm as the new table (arm.json)"
        advice += "; if not, look at the known lengths and their unit." if lengths else "."
    return [
        Finding(
            "table-off",
            f"The arm is not that of the table: {'; '.join(said[:_MOST_NAMED])}.",
            advice,
            joints=tuple(sorted(set(joints))),
            size_mm=float(max((departure[i] for i in wrong if not is_angle(names[i])), default=0)),
        )
    ]


def warn_of_harm(corrected, bare):
    """Say that the points scatter more with a correction than without it, distances (n,) in mm."""
    more = corrected - bare
    if more.mean() > _HARM * more.std() / np.sqrt(len(more)) + 1e-9 * bare.mean():
        said = (
            f"With the correction the points scatter by {corrected.mean():.4g} mm, without it by "
            f"{bare.mean():.4g} mm: do not use it here."
        )
        advice = "Is it of this arm, and is the table that of the arm that it was learnt with?"
        say_findings([Finding("harmful-correction", said, advice, size_mm=corrected.mean())])
