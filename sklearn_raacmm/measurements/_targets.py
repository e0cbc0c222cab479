"""Whether targets can be residuals of this arm, as the caller has it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from itertools import chain
from typing import Any

import numpy as np

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.measurements._dwells import angle_faults
from sklearn_raacmm.measurements._explanations import of_own_points
from sklearn_raacmm.utils import Finding, Groups, align

# Part of their spread by which measured points may differ from the arm's, after a motion of the
# base: no calibrated arm is that far off.
_SHARE_OF_SPREAD = 0.05
# Median residual, as a share of the arm's reach, that is no residual; where the arm is not known,
# that of an arm of two metres, mm.
_SHARE_OF_REACH, _LARGEST_MM = 0.05, 100.0
# A motion of the base is worth a word where it leaves no more than this part of the residuals, and
# they are larger than this share of the reach (or so many mm).
_LEFT, _STRIKING_SHARE, _STRIKING_MM = 0.1, 1e-3, 1.0
# With fewer rows a motion (six numbers) explains anything; with fewer coordinates a number, tables.
_LEAST_ROWS, _COORDINATES_OF_TABLES = 4, 6
# A table explains what is left by less than this share, and is larger than this, mm.
_LEFT_OF_TABLE, _LARGE_MM = 0.3, 0.5
_WIDE = 0.1  # spread of the points, as a share of the reach
# What a table and a probe are off by as a rule.
_TABLE_MM, _TABLE_RAD, _PROBE_MM = 2.0, 3e-3, 20.0
HOW_TO = (
    "Give arm.forward(angles) minus the reference in the arm's base frame: "
    "calibrate(arm, angles, points=points).residuals(angles, points), or position_residuals."
)


def check_targets(
    y: np.ndarray,
    weights: np.ndarray,
    arm: Arm | None = None,
    angles: Any = None,
    codes: np.ndarray | None = None,
    offsets: bool = False,
    probes: np.ndarray | None = None,
) -> list[Finding]:
    """Findings on the angles, and the first on the targets: others would say it in other words.

    y (n, 3) are in mm, weights (n,); angles (n, n_joints) in rad, where it is known of which arm
    they are; codes (n,) the position of each row, and `offsets` whether positions have constants
    that nobody knows; `probes` (n, 3) those of the rows in the last frame, mm, where they are not
    the arm's.
    """
    faults = [] if arm is None else list(angle_faults(angles, arm.reach_mm, weights))
    numbers = np.flatnonzero(weights > 0)
    y, weights, parts = y[numbers], weights[numbers], (angles, codes, probes)
    angles, codes, probes = (None if v is None else v[numbers] for v in parts)
    about_means = Groups(codes).centred(y, weights) if offsets else y  # offsets may be of any size
    if arm is None:
        shift = np.broadcast_to(np.eye(3), (len(y), 3, 3))
        checks: list[Any] = [_are_too_large(about_means)]
        checks.append(_are_of_another_frame(y, shift, _STRIKING_MM))
    else:
        points, reach = arm.points_at(angles, probes), arm.reach_mm
        checks = [_are_points(y, points, reach), _are_too_large(about_means, reach)]
        if not offsets:
            moved = base_motions(points, reach)
            checks.append(_are_of_another_frame(y, moved, _STRIKING_SHARE * reach))
        if codes is not None:
            # In another order their means are not 0, but they are as long.
            ours, given = (
                np.sort(np.linalg.norm(v, axis=1)) for v in (Groups(codes).centred(points), y)
            )
            if offsets or np.allclose(given, ours, rtol=1e-6, atol=1e-9):
                found = of_own_points(y, codes, arm, angles, numbers, probes)[1]
                # Rounded angles are those of other points, and are named already.
                checks.append(one for one in found if not faults or one.code != "rows-unrelated")
        constants = (codes, weights) if offsets else None
        checks.append(_are_what_calibration_takes(y, arm, angles, points, constants))
    first = next(chain(*checks), None)
    if first is None and y.size and not y.any():
        text = "All residuals are 0: there is nothing to learn."
        advice = "Are the measured points the arm's own, arm.forward(angles)?"
        first = Finding("residuals-all-zero", text, advice, "note")
    return [*faults, first] if first else faults


def base_motions(points: np.ndarray, reach: float) -> np.ndarray:
    """What shifts of the base, and turns of one over the reach in mm, do to points: (n, 3, 6)."""
    turns = np.stack([np.cross(axis, points) / reach for axis in np.eye(3)], axis=2)
    return np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2)


def _are_points(y, points, reach):
    """The probe's points, in whatever frame, are refused."""
    if len(y) < _LEAST_ROWS:
        return
    rotation, shift = align(points, y)
    left, spread = _rms(y - points @ rotation.T - shift), _rms(points - points.mean(axis=0))
    # The points of a single position are residuals but for a shift.
    if left < _SHARE_OF_SPREAD * spread and spread > _SHARE_OF_REACH * reach:
        text = (
            "y are points, not residuals: up to a motion of the base they are where the arm "
            f"says that its probe is, with a root mean square difference of {left:.4g} mm."
        )
        yield Finding("points-for-residuals", text, HOW_TO, "refuse")


def _are_too_large(y, reach=None):
    """Half of the targets are longer than any residual."""
    half = np.median(np.linalg.norm(y, axis=1))
    if half > (_LARGEST_MM if reach is None else _SHARE_OF_REACH * reach):
        of_what = "in mm" if reach is None else f"of an arm that reaches {reach:.4g} mm"
        text = f"y are no residuals {of_what}: half of them are longer than {half:.4g} mm."
        advice = f"Are they points, differences between two frames, or in another unit? {HOW_TO}"
        yield Finding("no-residuals", text, advice, "refuse", size_mm=half)


def _are_of_another_frame(y, moved, striking):
    """A motion of the base, (n, 3, p) by its numbers, explains nearly all of them."""
    size = _rms(y)
    if len(y) < _LEAST_ROWS or size < striking:
        return
    rest = _beside(y, moved)
    if rest < _LEFT * size:
        text = (
            f"The residuals of {size:.4g} mm (root mean square) are nearly one motion of the base, "
            f"which leaves {rest:.4g} mm."
        )
        advice = f"Is the reference in another frame? {HOW_TO}"
        yield Finding("another-frame", text, advice, "repair", size_mm=size)


def _are_what_calibration_takes(y, arm, angles, points, constants):
    """The arm's static parameters explain nearly all: it has not been calibrated."""
    reach = arm.reach_mm
    # In a small part of the volume a table explains whatever is smooth.
    if _rms(y) < _LARGE_MM or _rms(points - points.mean(axis=0)) < _WIDE * reach:
        return
    # An arm without lengths has no deviations at all, but tables change by millimetres only.
    sizes = [_TABLE_MM, _TABLE_RAD, _TABLE_MM, _TABLE_RAD, _PROBE_MM]
    jac = arm.parameter_jacobian(angles)[1] * np.repeat(sizes, [arm.n_joints] * 4 + [3])
    if y.size < _COORDINATES_OF_TABLES * jac.shape[2]:
        return
    moved = base_motions(points, reach)  # a base that stands elsewhere is another finding
    if constants:
        y, jac, moved = (
            Groups(constants[0]).centred(y, constants[1]),
            Groups(constants[0]).centred(jac, constants[1]),
            moved[:, :, :0],
        )
    size = _beside(y, moved)
    left = _beside(y, moved, jac, _LEFT_OF_TABLE / 3 * size)
    if size > _LARGE_MM and left < _LEFT_OF_TABLE * size:
        text = (
            f"The residuals of {size:.3g} mm (root mean square) are nearly what a calibration "
            f"of the arm takes away: other lengths and zeros leave {left:.3g} mm."
        )
        advice = "Calibrate the arm first, and give its residuals and result.arm."
        yield Finding("not-calibrated", text, advice, size_mm=size)


def _beside(y, moved, table=None, ridge=0.0):
    """Root mean square length (mm) of what columns (n, 3, p) leave of y (n, 3), as of new rows.

    The numbers of the table are as small as the ridge has them.
    """
    columns = moved if table is None else np.concatenate([moved, table], axis=2)
    columns = columns.reshape(y.size, -1)
    n = columns.shape[1]
    rows = ridge * np.eye(n)[moved.shape[2] :]
    both = np.vstack([columns, rows]), np.r_[y.ravel(), np.zeros(len(rows))]
    left = y.ravel() - columns @ np.linalg.lstsq(*both)[0]
    return float(np.sqrt(3 * np.square(left).sum() / (y.size - n)))


def _rms(vectors):
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean())) if len(vectors) else 0.0
