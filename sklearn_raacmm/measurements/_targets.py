"""Whether targets can be residuals of this arm, as the caller has it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np

from sklearn_raacmm.arm import Arm, parameter_jacobian, points_of, reach_mm
from sklearn_raacmm.measurements._explanations import of_own_points
from sklearn_raacmm.measurements._set_ups import base_motions
from sklearn_raacmm.utils import Finding, align, centred

# Part of their spread by which measured points may differ from the arm's, after a motion of the
# base: no calibrated arm is that far off.
_SHARE_OF_SPREAD = 0.05
# Median residual, as a share of the arm's reach, that is no residual; where the arm is not known,
# that of an arm of two metres, mm.
_SHARE_OF_REACH, _LARGEST_MM = 0.05, 100.0
# A motion of the base is worth a word where it leaves no more than this part of the residuals, and
# they are larger than this share of the reach (or so many mm).
_LEFT, _STRIKING_SHARE, _STRIKING_MM = 0.1, 1e-3, 1.0
# With fewer rows, a motion (six numbers) explains anything; so do factors and tables.
_LEAST_ROWS, _COORDINATES_OF_TABLES = 4, 3
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
    """Findings on the targets of a model: of the first kind that there is.

    The others would say the same in other words. y (n, 3) are in mm, weights (n,); angles (n,
    n_joints) in rad, where it is known of which arm they are; codes (n,) the position of each row,
    and `offsets` whether positions have constants that nobody knows; `probes` (n, 3) those of the
    rows in the last frame, mm, where they are not the arm's.
    """
    numbers = np.flatnonzero(weights > 0)
    y, weights = y[numbers], weights[numbers]
    parts = angles, codes, probes
    angles, codes, probes = (None if v is None else v[numbers] for v in parts)
    about_means = centred(y, codes, weights) if offsets else y  # offsets may be of any size
    checks: list[Any] = [_are_too_large(about_means, np.inf if arm is None else reach_mm(arm))]
    if arm is None:
        checks.append(_are_of_another_frame(y, None, _STRIKING_MM))
    else:
        points, reach = points_of(arm, angles, probes), reach_mm(arm)
        checks.insert(0, _are_points(y, points, reach))
        if not offsets:
            checks.append(_are_of_another_frame(y, points, _STRIKING_SHARE * reach))
        if codes is not None:
            # In another order their means are not 0, but they are as long.
            ours, given = (np.sort(np.linalg.norm(v, axis=1)) for v in (centred(points, codes), y))
            if offsets or np.allclose(given, ours, rtol=1e-6, atol=1e-9):
                checks.append(of_own_points(y, codes, arm, angles, numbers, probes)[1])
        checks.append(_are_what_calibration_takes(y, arm, angles, points, codes, offsets, weights))
    for check in checks:
        found = list(check)
        if found:
            return found
    if y.size and not y.any():
        said = "All residuals are 0: there is nothing to learn."
        advice = "Are the measured points the arm's own, arm.forward(angles)?"
        return [Finding("residuals-all-zero", said, advice, "note")]
    return []


def _are_points(y, points, reach):
    """The probe's points, in whatever frame, are refused."""
    if len(y) < _LEAST_ROWS:
        return
    rotation, shift = align(points, y)
    left, spread = _rms(y - points @ rotation.T - shift), _rms(points - points.mean(axis=0))
    # The points of a single position are residuals but for a shift.
    if left < _SHARE_OF_SPREAD * spread and spread > _SHARE_OF_REACH * reach:
        yield Finding(
            "points-for-residuals",
            "y are points, not residuals: up to a motion of the base they are where the arm "
            f"says that its probe is, with a root mean square difference of {left:.4g} mm.",
            HOW_TO,
            "refuse",
        )


def _are_too_large(y, reach):
    """Half of the targets are longer than any residual."""
    half, known = np.median(np.linalg.norm(y, axis=1)), np.isfinite(reach)
    if half > (_SHARE_OF_REACH * reach if known else _LARGEST_MM):
        of_what = f"of an arm that reaches {reach:.4g} mm" if known else "in mm"
        yield Finding(
            "no-residuals",
            f"y are no residuals {of_what}: half of them are longer than {half:.4g} mm.",
            f"Are they points, differences between two frames, or in another unit? {HOW_TO}",
            "refuse",
            size_mm=half,
        )


def _are_of_another_frame(y, points, striking):
    """A motion of the base explains nearly all of them; without the arm, a shift."""
    size = _rms(y)
    if len(y) < _LEAST_ROWS or size < striking:
        return
    left, n_found, about = y - y.mean(axis=0), 3, ""
    if points is not None:
        rotation, shift = align(points, points - y)
        turn = np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))
        left, n_found = points - y - points @ rotation.T - shift, 6
        about = f"a turn by {turn:.2g} rad and "
    rest = _rms(left) * np.sqrt(y.size / (y.size - n_found))
    if rest < _LEFT * size:
        mean = np.linalg.norm(y.mean(axis=0))
        yield Finding(
            "another-frame",
            f"The residuals of {size:.4g} mm (root mean square) are nearly one motion of the base: "
            f"{about}a shift by {mean:.4g} mm on the average leave {rest:.4g} mm.",
            f"Is the reference in another frame? {HOW_TO}",
            "repair",
            size_mm=size,
        )


def _are_what_calibration_takes(y, arm, angles, points, codes, offsets, weights):
    """The arm's static parameters explain nearly all: it has not been calibrated."""
    reach = reach_mm(arm)
    # In a small part of the volume a table explains whatever is smooth.
    if _rms(y) < _LARGE_MM or _rms(points - points.mean(axis=0)) < _WIDE * reach:
        return
    # An arm without lengths has no deviations at all, but tables change by millimetres only.
    sizes = [_TABLE_MM, _TABLE_RAD, _TABLE_MM, _TABLE_RAD, _PROBE_MM]
    jac = parameter_jacobian(arm, angles)[1] * np.repeat(sizes, [arm.n_joints] * 4 + [3])
    if offsets:
        y, jac = (centred(v, codes, weights) for v in (y, jac))
    else:  # a base that stands elsewhere is another finding
        base = base_motions(points, reach)
        place = np.linalg.qr(base.reshape(-1, 6))[0]
        y = y - (place @ (place.T @ y.ravel())).reshape(y.shape)
        jac = np.concatenate([jac, 1e3 * base], axis=2)
    n_columns = jac.shape[2]
    # Every second position by the others: those at hand could be imitated.
    fold = (np.arange(len(y)) if codes is None else codes) % 2 == 0
    if min(fold.sum(), (~fold).sum()) * 3 < _COORDINATES_OF_TABLES * n_columns:
        return
    off, ridge = np.empty_like(y), _LEFT_OF_TABLE / 3 * _rms(y) * np.eye(n_columns)
    for rows in (fold, ~fold):
        columns = np.concatenate([jac[~rows].reshape(-1, n_columns), ridge])
        coef = np.linalg.lstsq(columns, np.r_[y[~rows].ravel(), np.zeros(n_columns)])[0]
        off[rows] = y[rows] - jac[rows] @ coef
    size, left = _rms(y), _rms(off)
    if size > _LARGE_MM and left < _LEFT_OF_TABLE * size:
        yield Finding(
            "not-calibrated",
            f"The residuals of {size:.3g} mm (root mean square) are nearly what a calibration "
            f"of the arm takes away: other lengths and zeros leave {left:.3g} mm.",
            "Calibrate the arm first, and give its residuals and result.arm.",
            size_mm=size,
        )


def _rms(vectors):
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean())) if len(vectors) else 0.0
