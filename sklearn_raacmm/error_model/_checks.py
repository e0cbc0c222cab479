"""What the models of an arm ask of the rows they are given; each fault gets one clear sentence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model._columns import CAUSES, parse_extra
from sklearn_raacmm.error_model._sums import Rows
from sklearn_raacmm.measurements import (
    Features,
    check_length,
    check_targets,
    find_dwells,
    found_positions,
)
from sklearn_raacmm.utils import (
    Finding,
    Groups,
    check_data,
    check_features,
    check_weights,
    floats,
    listed,
)

# Repeats that no row has. Rows, in units of those given, that weights may add up to without a word:
# those of weights that add up to 1 are too few, those of inverse variances too many.
_MOST_REPEATS, _LEAST_WORTH, _LARGEST_WORTH = 1e9, 0.1, 100.0
# Reaches of the arm beyond which a residual is in another unit, or no residual at all.
_LARGEST_REACHES = 10.0
# Share of the means, of that of independent rows, that is rounding: y are deviations from them.
_NO_MEANS = 1e-9
# Part of the range of a column in the fit by which values may lie beyond it without a word.
_BEYOND = 0.5
# For names that are read before the arm is known.
_MOST_JOINTS = 10**6


def check_fit(estimator, X, y, sample_weight, groups, lengths, probes, features=()) -> Any:
    """Rows of all that `fit` of an estimator is given, those of weight 0 among them.

    And the position of each row, (n,) from 0, given or found; None: each row is one.
    """
    X, y = check_data(estimator, X, y)
    extra, lengths = check_extra(estimator.extra), listed("lengths", lengths)
    features = listed("features", features)
    arm = Arm.or_default(estimator.arm, type(estimator).__name__, X.shape[1], extra=extra)
    check_extra(extra, arm.n_joints)
    unknown = [one for one in estimator.causes if not callable(one) and one not in CAUSES]
    if unknown:
        raise ValueError(
            f"causes must be some of {', '.join(CAUSES)}, or functions, got {unknown[0]!r:.60}."
        )
    X = in_rad(X, arm, estimator.angle_unit)
    y = _check_vectors(y, arm)
    weights = _check_repeats(check_weights(sample_weight, X))
    warn_of_constants(extra, X[:, arm.n_joints :], weights)
    if probes is not None:
        probes = floats("probes", probes, finite=True)
        if probes.shape != (len(X), 3):
            raise ValueError(f"probes must have shape ({len(X)}, 3), in mm, got {probes.shape}.")
    if groups is None and not lengths and not features:
        groups = found_positions(arm.points_at(X[:, : arm.n_joints], probes), y, weights)
    groups = None if groups is False else groups
    labels: Any = None
    positions: Any = None
    if groups is not None:
        labels, positions = Groups.encoded(groups, len(y))
        positions, old = Groups(positions).numbered(np.argsort(weights == 0, kind="stable"))
        labels = labels[old]
    if features:
        if positions is None or estimator.offsets is False:
            raise ValueError(
                "features need groups, the label of the feature of each sample, and offsets that "
                "are not False."
            )
        points = arm.points_at(X[:, : arm.n_joints], probes)
        y, touched = touched_rows(features, labels, positions, points, y, weights)
        codes = positions
        deviations = True
    elif positions is None:
        if estimator.offsets is True:
            raise ValueError("offsets=True needs groups: the position of each sample.")
        codes, touched, deviations = None, {}, False
    else:
        # Deviations from anything but the mean keep a constant for each position, and are none the
        # less asked what deviations are asked.
        is_auto, share = estimator.offsets == "auto", Groups(positions).share_of_means(y, weights)
        has_offsets = share < _NO_MEANS if is_auto else estimator.offsets
        codes, touched = positions if has_offsets else None, {}
        deviations = has_offsets or (is_auto and share < Groups.CENTRED)
    angles = X[:, : arm.n_joints]
    held = np.ones(len(y), bool) if not features else touched.pop("held")
    if held.any():  # touches of a surface are not of one point
        of = None if positions is None else np.unique(positions[held], return_inverse=True)[1]
        given = y[held], weights[held], arm, angles[held], of, deviations
        for finding in check_targets(*given, None if probes is None else probes[held]):
            finding.report()
    lengths = _check_lengths(lengths, codes, labels, "kinematics" in estimator.causes)
    lengths += touched.pop("sizes", [])
    X = X if probes is None else np.hstack([X, probes])
    return Rows(arm, X, y, weights, codes, tuple(lengths), **touched), positions


def touched_rows(
    features: Any,
    labels: np.ndarray,
    codes: np.ndarray,
    points: np.ndarray,
    y: np.ndarray,
    weights: np.ndarray,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Residuals (n, 3), those of touches from the arm's own points, and what `Rows` need of these.

    And which rows are `held` in one point, (n,), and the `sizes` that are stated, as lengths.
    """
    touched = Features.stated(features, labels.tolist(), codes)
    weights = weights * touched.weights(points)
    rows = touched.linearised(points, weights)
    held = np.array([kind == "cone" for kind in touched.kinds])
    for finding in touched.findings(points, labels.tolist()):
        finding.report()
    value, axes = np.linalg.eigh(rows.directions)
    shown = np.where(value[:, :, None] > 0.5, axes.swapaxes(1, 2), 0.0)
    y = np.where(held[codes][:, None], y, rows.residual)
    of_surfaces = tuple(None if one else form for one, form in zip(held, rows.forms, strict=True))
    of_rows = {"root": shown, "shown": shown, "unknowns": rows.unknowns, "forms": of_surfaces}
    return y, of_rows | {"held": held[codes], "sizes": [entry[:4] for entry in touched.sizes]}


def _check_repeats(weights):
    """Weights (n,), which are numbers of repeats."""
    if weights.max() > _MOST_REPEATS:
        raise ValueError(
            f"sample_weight holds {weights.max():.4g}, but a weight is worth that many repeats of "
            f"its row: more than {_MOST_REPEATS:g} are refused."
        )
    n, worth = np.count_nonzero(weights), weights.sum()
    if not _LEAST_WORTH * n <= worth <= _LARGEST_WORTH * n:
        said = f"By their sample_weight the {n} rows are worth {worth:.3g} rows: too little or too"
        advice = "A weight counts repeats: give weights of about 1."
        Finding("worth-of-rows", f"{said} much will be learnt.", advice).report()
    return weights


def _check_vectors(y, arm):
    """Residuals (n, 3) as float64."""
    if y.ndim != 2 or y.shape[1] != 3:
        raise ValueError(
            f"y has shape {y.shape}; Cartesian residuals (n_samples, 3) in mm are needed."
        )
    y = y.astype(np.float64, copy=False)
    largest, limit = np.linalg.norm(y, axis=1).max(initial=0.0), _LARGEST_REACHES * arm.reach_mm
    if largest > limit:
        raise ValueError(
            f"y holds a residual of {largest:.4g} mm, but the arm reaches {arm.reach_mm:.4g} mm: "
            "residuals in mm are needed."
        )
    return y


def _check_lengths(lengths, codes, labels, kinematics):
    """Known lengths as (position, position, length, sd), positions by their index in `codes`."""
    if lengths and codes is None:
        raise ValueError(
            "lengths are for positions with offsets; residuals against a reference, or without "
            "groups, have no use for them."
        )
    if not lengths and codes is not None and not kinematics:
        said = (
            "Without the cause kinematics nothing holds the distances between positions with "
            "offsets: they may come out worse than without correction."
        )
        advice = "Keep it, give known lengths, or do not measure lengths with this model."
        Finding("distances-not-held", said, advice).report()
    return [check_length(entry, labels.tolist()) for entry in lengths]


def poses_of(rows, extra):
    """Rows (of weights above 0) in which the arm stood still as one pose each.

    A pose has one probe, and one direction, which `extra` names. Returns the `Dwells`, and the
    `Rows`.
    """
    n_joints = rows.arm.n_joints
    kinds = [
        n_joints + i
        for i, name in enumerate(extra)
        if parse_extra(name, n_joints)[0] == "direction"
    ]
    kinds += range(n_joints + len(extra), rows.X.shape[1])
    codes = np.zeros(len(rows.X)) if rows.codes is None else rows.codes
    codes = np.unique(np.column_stack([codes, rows.X[:, kinds]]), axis=0, return_inverse=True)[1]
    dwells = find_dwells(rows.X[:, :n_joints], codes.ravel(), True, rows.arm.joint_types)
    if not dwells.merges:
        return dwells, rows
    for finding in dwells.findings():
        finding.report()
    angles = dwells.mean_angles(rows.X[:, :n_joints])
    X = np.hstack([angles, dwells.mean(rows.X[:, n_joints:])])
    means = {"X": X, "y": dwells.mean(rows.y), "weights": dwells.mean(rows.weights)}
    return dwells, rows.at(dwells.first)._replace(**means)


def check_extra(extra: str | Iterable[str], n_joints: int = _MOST_JOINTS) -> Any:
    """Names of the extra columns as a tuple: each is known, and none stands there twice."""
    if isinstance(extra, str):
        raise ValueError(f"extra must be a list of names, one for each column, got {extra!r:.60}.")
    names = tuple(extra)
    found = [parse_extra(name, n_joints) for name in names]
    for i, one in enumerate(found):
        if one in found[:i]:
            raise ValueError(f"extra names {names[i]!r} twice.")
    return names


def with_references(extra, values, weights):
    """Names of the extra columns with what rows of the training data (n, n_extra) say of them.

    Pairs of a name and numbers: the weighted mean, from which the model counts, the least and the
    largest value.
    """
    found = []
    for name, column in zip(extra, values.T, strict=True):
        numbers = np.average(column, weights=weights), column.min(), column.max()
        found.append((name, tuple(map(float, numbers))))
    return tuple(found)


def warn_of_constants(extra, values, weights):
    """Warn of extra columns from which nothing can be learnt."""
    for name, column in zip(extra, values[weights > 0].T, strict=True):
        if np.ptp(column) == 0:
            said = (
                f"The extra column {name!r} is {column[0]:g} in all rows: nothing can be learnt "
                "of it, and predictions will not depend on it."
            )
            Finding("constant-column", said, "Does the sensor work?").report()


def check_values(extra, values):
    """Name values far beyond those of the fit.

    `extra` is as `with_references` has made it; `values` (n, n_extra).
    """
    for (name, (_, low, high)), column in zip(extra, values.T, strict=True):
        margin = _BEYOND * (high - low)
        far = np.flatnonzero((column < low - margin) | (column > high + margin))
        if margin > 0 and len(far):
            rows = Finding.row_numbers(far)
            said = (
                f"The column {name!r} is {column[far[0]]:g} in row {rows[0]}, and in the fit it "
                f"was from {low:g} to {high:g}."
            )
            advice = "Does the sensor work, and is the unit the same as in the fit?"
            Finding("column-out-of-range", said, advice, rows=rows).report()


def check_poses(model: Any, X: ArrayLike) -> np.ndarray:
    """Rows of X as a fitted `LinearModel` takes them: angles in rad, then the extra columns."""
    if "linear_model_" not in vars(model):
        check_is_fitted(model)  # which takes a tenth of the prediction of one row
    arm, terms = model.linear_model_.layout.arm, model.linear_model_.layout.terms
    if model.arm is not None and model.arm != arm:
        raise ValueError(
            f"arm is {model.arm!r}, but the model was fitted with {arm!r}: a fitted model "
            "is moved to another probe by with_arm, and to another table by a new fit."
        )
    X = check_features(model, X, dtype=np.float64, reset=False)
    check_values(terms.extra, X[:, arm.n_joints :])
    return in_rad(X, arm, model.angle_unit)


def in_rad(X, arm, angle_unit):
    """The same rows with their first columns, the angles, in rad."""
    n = arm.n_joints
    angles = arm.check_angles(X[:, :n], angle_unit)
    return angles if n == X.shape[1] else np.hstack([angles, X[:, n:]])
