"""What `calibrate` is given, checked before the fit."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.calibration._fit import rows_with
from sklearn_raacmm.measurements import UNITS, angle_faults
from sklearn_raacmm.utils import Finding

# Spread of measured points over that of the arm's: beyond, one of them is in another unit.
_SPREAD = 1.5
# Measuring arms reach from half a metre on, robots are not much smaller.
_LEAST_REACH_MM, _REACH_IN_METRES = 200.0, 10.0
_IN_MM = "Give millimetres; in a file name the unit in the header, such as {} [m]."


def check_measured(arm, measured):
    """Whether a calibration of this arm can be made of these: they have rows, and some scatter."""
    measured.check_joints(arm)
    if not len(measured.angles):
        raise ValueError("angles are empty: there is nothing to calibrate with.")
    if measured.points is not None:
        return
    if measured.index is None:
        raise ValueError("there are neither groups nor points: nothing says where the probe was.")
    labels, given = measured.labels.tolist(), measured.index[measured.poses.pose]
    if measured.features:
        for finding in measured.touched.few(labels):
            finding.report()
    count = np.bincount(given)
    if not measured.informative.any():
        what = "pose" if count.max() > 1 else "point"
        groups = "each group has" if what == "pose" else f"each of the {len(labels)} groups has"
        raise ValueError(f"{groups} one {what}: none can scatter.")
    tied = [i for entry in measured.lengths for i in entry[:2]]
    lonely = np.setdiff1d(np.flatnonzero(count == 1), tied)
    if len(lonely):
        names = tuple(labels[i] for i in lonely)
        text = f"{len(lonely)} groups have one point and say nothing, such as {names[0]}."
        Finding("lonely-position", text, positions=names).report()


def inputs_of_model(correction, angles, angle_unit, arm):
    """Angles as a fitted model takes them; one that cannot predict them is refused."""
    if not hasattr(correction, "predict"):
        raise TypeError(
            "correction must be a fitted model with predict(angles), got "
            f"{type(correction).__name__}."
        )
    angles, unit = np.asarray(angles, dtype=float), getattr(correction, "angle_unit", "rad")
    if unit != angle_unit:
        angles = angles * arm.by_type(180 / np.pi if unit == "deg" else np.pi / 180)
    residuals = np.asarray(correction.predict(angles), dtype=float)
    if residuals.shape != (len(angles), 3) or not np.all(np.isfinite(residuals)):
        raise ValueError(
            f"correction.predict must give finite residuals of shape ({len(angles)}, 3) in mm, "
            f"got shape {residuals.shape}."
        )
    return angles


def predicted(correction, angles, measured, probes):
    """Residuals (n, 3) that a model predicts at rows, with the probe of each tool (n_tools, 3)."""
    residuals = np.empty((len(angles), 3))
    for tool, probe in enumerate(probes):
        rows, model = rows_with(measured.tools, tool), correction
        # Only a model of the arm's own causes can be moved to another probe.
        if hasattr(correction, "with_arm"):
            model = model.with_arm(model.arm_.replace(probe=probe))
        residuals[rows] = model.predict(angles[rows])
    return residuals


def wrong_units(arm, measured):
    """Measured points, or the arm's table, are in another unit."""
    reach, angles, points = arm.reach_mm, measured.angles, measured.points
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
