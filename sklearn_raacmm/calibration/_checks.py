"""What `calibrate` is given, checked before the fit."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from typing import Any

import numpy as np

from sklearn_raacmm.calibration._problem import Problem, rows_of
from sklearn_raacmm.measurements import (
    UNITS,
    angle_faults,
    check_features,
    check_length,
    find_poses,
    probe_offsets,
    touch_findings,
)
from sklearn_raacmm.utils import Finding, encode_groups, floats

# Spread of measured points over that of the arm's: beyond, one of them is in another unit.
_SPREAD = 1.5
# Measuring arms reach from half a metre on, robots are not much smaller.
_LEAST_REACH_MM, _REACH_IN_METRES = 200.0, 10.0
_IN_MM = "Give millimetres; in a file name the unit in the header, such as {} [m]."


def check_problem(
    angles, groups, points, lengths, tools, stations, features: Any = (), tip_diameter=0.0
):
    """The data of a calibration as a `Problem`."""
    n = len(angles)
    if n == 0:
        raise ValueError("angles are empty: there is nothing to calibrate with.")
    if (groups is None) == (points is None):
        raise ValueError("give either groups, or points that were measured.")
    labels = {}
    for name, given in (("tool", tools), ("station", stations)):
        if given is not None:
            found, labels[f"{name}s"] = encode_groups(given, n, f"{name}s")
            labels[f"{name}_labels"] = tuple(found.tolist())
    if points is not None:
        points = floats("points", points, 3)
        if len(points) != n:
            raise ValueError(f"points must have shape ({n}, 3), got {points.shape}.")
        if lengths or features:
            what = "lengths are between groups" if lengths else "features are groups of touches"
            raise ValueError(f"{what}; measured points have no use for them.")
        return Problem(None, points, [], **labels)
    if stations is not None:
        raise ValueError(
            "stations are of measured points. In a test without a tracker, a fixed point that is "
            "measured from another place is another group: give it a label of its own."
        )
    positions, index = encode_groups(groups, n)
    positions = positions.tolist()
    lengths = [check_length(entry, positions) for entry in lengths]
    if features:
        kinds, sizes = check_features(features, positions)
        for finding in touch_findings(kinds, index, None, positions):
            finding.report()
        ends = [[kinds[i][0] for i in entry[:2]] for entry in lengths]
        labels["offsets"] = [probe_offsets(pair, tip_diameter) for pair in ends]
        labels["offsets"] += [probe_offsets(["sphere"], tip_diameter, e[4]) for e in sizes]
        lengths += [entry[:4] for entry in sizes]
        labels["features"] = kinds
    problem = Problem(index, None, lengths, **labels)
    if problem.n_informative == 0:
        raise ValueError(f"each of the {len(positions)} groups has one point: none can scatter.")
    tied = [i for entry in lengths for i in entry[:2]]
    lonely = np.setdiff1d(np.flatnonzero(np.bincount(index) == 1), tied)
    if len(lonely):
        names = tuple(positions[i] for i in lonely)
        text = f"{len(lonely)} groups have one point and say nothing, such as {names[0]}."
        Finding("lonely-position", text, positions=names).report()
    return problem


def check_correction(correction, angles, angle_unit):
    """Angles as a fitted model takes them; one that cannot predict them is refused."""
    if not hasattr(correction, "predict"):
        raise TypeError(
            "correction must be a fitted model with predict(angles), got "
            f"{type(correction).__name__}."
        )
    angles, unit = np.asarray(angles, dtype=float), getattr(correction, "angle_unit", "rad")
    if unit != angle_unit:
        angles = np.rad2deg(angles) if unit == "deg" else np.deg2rad(angles)
    residuals = np.asarray(correction.predict(angles), dtype=float)
    if residuals.shape != (len(angles), 3) or not np.all(np.isfinite(residuals)):
        raise ValueError(
            f"correction.predict must give finite residuals of shape ({len(angles)}, 3) in mm, "
            f"got shape {residuals.shape}."
        )
    return angles


def predicted(correction, angles, problem, probes):
    """Residuals (n, 3) that a model predicts at rows, with the probe of each tool (n_tools, 3)."""
    residuals = np.empty((len(angles), 3))
    for tool, probe in enumerate(probes):
        rows, model = rows_of(problem.tools, tool), correction
        # Only a model of the arm's own causes can be moved to another probe.
        if hasattr(correction, "with_arm"):
            model = model.with_arm(model.arm_.replace(probe=probe))
        residuals[rows] = model.predict(angles[rows])
    return residuals


def one_row_a_pose(angles, problem):
    """Poses that rows are of, their angles, and the problem with one row each."""
    labels = (problem.index, problem.tools, problem.stations)
    labels = [np.zeros(len(angles)), *(v for v in labels if v is not None)]
    codes = np.unique(np.column_stack(labels), axis=0, return_inverse=True)[1].ravel()
    poses = find_poses(angles, codes, problem.points)
    if not poses.merges:
        return poses, angles, problem
    for finding in poses.findings():
        finding.report()
    names = ("index", "points", "correction", "tools", "stations")
    problem = replace(problem, **{name: poses.mean(getattr(problem, name)) for name in names})
    if problem.points is None and problem.n_informative == 0:
        raise ValueError("each group has one pose: none can scatter.")
    return poses, poses.mean_angles(angles), problem


def wrong_units(arm, angles, problem):
    """Measured points, or the arm's table, are in another unit."""
    reach, points = arm.reach_mm, problem.points
    yield from angle_faults(angles, reach)
    if points is not None and len(points) > 1:
        shown = arm.forward(angles)
        sizes = [np.sqrt(np.square(p - p.mean(axis=0)).sum(axis=1).mean()) for p in (shown, points)]
        ratio = sizes[0] / max(sizes[1], 1e-300)
        unit = min(UNITS, key=lambda u: abs(np.log(ratio / u)))
        if abs(np.log(ratio / unit)) < np.log(_SPREAD):
            text = (
                f"The measured points spread over {sizes[1]:.4g}, the arm's over {sizes[0]:.4g} "
                f"mm: they are most likely in {UNITS[unit]}."
            )
            yield Finding("unit-of-points", text, _IN_MM.format("x"), "refuse")
        elif np.abs(shown - points).max() < 1e-9 * reach:
            text = "The measured points are those that the arm itself shows."
            advice = "Give the points that a tracker has measured, or the labels of positions."
            yield Finding("points-of-the-arm", text, advice, "repair")
    if reach < _LEAST_REACH_MM:
        unit = "metres" if reach < _REACH_IN_METRES else "inches or centimetres"
        text = f"The nominal arm reaches {reach:.3g} mm: its lengths are most likely in {unit}."
        yield Finding("unit-of-table", text, _IN_MM.format("d"), "repair")
