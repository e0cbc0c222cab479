"""What a fit that has settled is worth: what the data say of its parameters, and its result."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.spatial.transform import Rotation

from sklearn_raacmm.calibration._fit import (
    DOUBTED,
    UNKNOWN_PLACE_MM,
    in_brackets,
    outlier_limit,
    triangle,
)
from sklearn_raacmm.calibration._result import ANGLES, CalibrationResult

# A parameter whose standard deviation the data did not halve is the prior's, not the data's.
_IDENTIFIED = 0.5
# What counts as knowing nothing of a base, a reach and a turn of one radian; its coordinates.
_BASE_MM, _BASE_RAD = UNKNOWN_PLACE_MM, 1.0
_BASE = ("rx", "ry", "rz", "x", "y", "z")
# Singular values below this part of the largest are rounding.
_RANK = 1e-9
# Terms of a combination that move the probe by less than this part of its largest are not written.
_SMALL_TERM = 0.05
# Columns whose sizes differ by less than this part are equal.
_TIE = 1e-6
# A combination is open where its posterior standard deviation is above half the prior's, which is
# 1 / sqrt(1 + s^2) of it for a singular value s of the data in prior units.
_OPEN = np.sqrt(3.0)


def result_of(fit, given, before):
    """Everything that is to be known of a fit that has settled, of rows as they were given."""
    measured, pose = fit.measured, fit.measured.poses.pose
    stations = in_brackets(measured.station_labels, measured.n_stations)
    names = [*fit.names, *(f"base_{c}{at}" for at in stations for c in _BASE)]
    values, bases = fit.x.copy(), []
    for s, rotation in enumerate(fit.rotations):
        turn, shift = np.split(fit.base_columns(s), 2)
        values[turn] = Rotation.from_matrix(rotation).as_rotvec()
        bases.append((rotation, values[shift]))
    # Outliers are farther from their weighted mean: the plain one, they draw towards themselves.
    distances = fit.robust_distances()
    robust = fit.as_of_three(distances)
    informative = robust[measured.informative]
    limit = float(outlier_limit(informative, fit.sigma))
    farthest = np.argsort(-robust, kind="stable")
    doubtful = robust > min(limit, outlier_limit(informative, fit.sigma, **DOUBTED))
    outliers = [i for i in farthest if robust[i] > limit]
    rows = tuple(row for i in outliers for row in np.flatnonzero(pose == i).tolist())
    if outliers:  # of touches that show one coordinate a shorter distance is as rare
        limit = min(limit, float(distances[outliers].min()))
    errors, sd_of_ends = fit.lengths_found()
    # What the table does not explain is much the same in all touches of a feature.
    common = fit.sigma * bool(measured.features)
    return CalibrationResult(
        arm=fit.arm(),
        names=tuple(names),
        nominal=np.r_[fit.nominal, np.full(len(names) - len(fit.names), np.nan)],
        values=values,
        prior_sd={kind: float(sd) for kind, sd in zip(fit.kind, fit.prior_sd, strict=True)},
        n_coordinates=max(measured.n_coordinates, 0),
        scatter_given_mm=float(given),
        scatter_before_mm=float(before),
        scatter_after_mm=float(fit.distances().mean()),
        residuals_mm=fit.residuals(fit.first_weights())[pose],
        length_errors_mm=errors,
        length_sd_mm=np.sqrt(fit.stated_sd**2 + sd_of_ends**2 + common**2),
        sigma_mm=float(fit.sigma),
        outliers=rows,
        outlier_limit_mm=limit,
        sample_weight=np.where(doubtful, 0.0, 1.0)[pose],
        groups=None if fit.n_stations else measured.labels[measured.index[pose]],
        features=measured.stated,
        arms={label: fit.arm(i) for i, label in enumerate(measured.tool_labels)},
        bases=dict(zip(measured.station_labels, bases, strict=False)),
        base_rotation=bases[0][0] if bases else None,
        base_translation=bases[0][1] if bases else None,
        converged=fit.converged,
        **_identified(fit, names),
    )


def _identified(fit, names):
    """What the data say of the free parameters, as fields of a `CalibrationResult`."""
    mask = fit.mask
    is_free, reach = mask[: len(fit.nominal)], max(fit.nominal_arm.reach_mm, 1e-3)
    free_names = [name for name, is_in in zip(names, mask, strict=True) if is_in]
    angle = np.array([name.startswith(ANGLES) for name in names])
    wide = np.where(angle, _BASE_RAD, _BASE_MM)
    wide[: len(fit.nominal)] = fit.prior_sd
    per_reach = angle | np.array([name.startswith("scale") for name in names])
    unit = np.where(per_reach, 1 / reach, 1.0)
    root, covariance = np.zeros((0, 0)), np.zeros((0, 0))
    larger: float | np.ndarray = 0.0
    if mask.any():
        root = triangle(fit.rows(fit.x, mask, with_prior=False))[:, :-1]
        covariance, larger = fit.covariance(), fit.scaled_by_misfit()
    seen = _observability(root, fit, free_names, wide[mask], unit[mask])
    sd = np.zeros(len(mask))
    sd[mask] = np.sqrt(np.diag(covariance))
    scale, of_free = fit.scale[is_free], slice(0, is_free.sum())
    corrected = float(np.sqrt(scale @ covariance[of_free, of_free] @ scale))
    scale_sd = float(np.hypot(corrected, np.linalg.norm(larger)))
    prior = float(np.linalg.norm(scale * fit.prior_sd[is_free]))
    scale_is_open = prior > 0 and corrected > _IDENTIFIED * prior
    if seen["rank"] and fit.measured.n_coordinates <= seen["rank"]:  # nothing to tell noise from
        sd[mask], scale_sd, corrected = np.nan, np.nan, np.nan
    is_open = mask & ~(sd <= _IDENTIFIED * wide) & ~np.isnan(sd)
    unidentified = tuple(name for name, is_in in zip(names, is_open, strict=True) if is_in)
    return seen | {
        "standard_deviations": sd,
        "unidentified": unidentified + (("scale",) if scale_is_open else ()),
        "n_free": len(free_names),
        "scale_sd": scale_sd,
        "scale_sd_corrected": corrected,
    }


def _observability(root, fit, names, prior_sd, unit):
    """Rank, condition, observability index and open combinations.

    `root` (<= p, p) is the triangular factor of the derivatives of the data, in standard
    deviations, by the free parameters; `prior_sd` (p,) counts as knowing nothing of each, and
    `unit` (p,) moves the probe by about 1 mm. As fields of a `CalibrationResult`.
    """
    values = np.linalg.svd(root * unit * fit.sigma, compute_uv=False)
    rank = int(np.sum(values > _RANK * values.max(initial=0.0)))
    values = values[:rank]
    condition = np.inf if rank < len(names) else 1.0
    index, n_points = 0.0, len(fit.angles) + len(fit.measured.lengths) / 3
    if rank:
        condition *= float(values[0] / values[-1])
        index = float(np.exp(np.log(values).mean()) / np.sqrt(n_points))
    _, strength, directions = np.linalg.svd(root * prior_sd, full_matrices=True)
    strength = np.r_[strength, np.zeros(len(names) - len(strength))]
    combinations = _readable(directions[strength < _OPEN], names, prior_sd, unit)
    return {
        "rank": rank,
        "condition_number": condition,
        "observability_index": index,
        "unidentified_combinations": combinations,
    }


def _readable(basis, names, prior_sd, unit):
    """A basis (k, p), in prior units, as sums with few terms: its reduced echelon form."""
    lines, pivots, rest = [], [], basis.copy()
    for _ in range(len(basis)):
        # What is left of each column beside those chosen: that does not depend on which basis of
        # the space was given. Of equal ones the first, whatever rounding says.
        size = np.linalg.norm(rest, axis=0)
        pivots.append(int(np.argmax(size > (1 - _TIE) * size.max())))
        along = rest[:, pivots[-1]] / size[pivots[-1]]
        rest = rest - np.outer(along, along @ rest)
        rest[:, pivots] = 0.0
    basis = np.linalg.solve(basis[:, pivots], basis)
    for row, pivot in sorted(zip(basis, pivots, strict=True), key=lambda pair: pair[1]):
        moves = np.abs(row * prior_sd / unit)  # mm at the probe, about
        large = moves > _SMALL_TERM * moves.max()
        factors, text = row * prior_sd / prior_sd[pivot], ""
        for i in [pivot, *(i for i in np.flatnonzero(large) if i != pivot)]:
            minus, plus = (" - ", " + ") if text else ("-", "")
            size = abs(factors[i])
            text += minus if factors[i] < 0 else plus
            text += names[i] if abs(size - 1) < 0.005 else f"{size:.3g} {names[i]}"
        lines.append(text)
    return tuple(lines)
