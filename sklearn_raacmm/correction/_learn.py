"""The one call: calibrate, learn the rest, and say whether it helps."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm._version import __version__
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import MUCH_SCATTER_MM, SHARE_OF_REACH, find_places
from sklearn_raacmm.correction._correction import Correction
from sklearn_raacmm.correction._one_fit import Data, refuse_one_pose, usual_values
from sklearn_raacmm.correction._scores import folds_of, scores_of, share_of
from sklearn_raacmm.correction._table_search import (
    ask_whether_mirrored,
    search_table,
    shifted_rows,
    with_change,
)
from sklearn_raacmm.error_model import ArmResidualRegressor
from sklearn_raacmm.measurements import Measurements, drift_of, moved_positions, within_turn
from sklearn_raacmm.utils import Finding, FindingError, Groups, listed, param_checks

_CONSTRAINTS = {
    "angle_unit": [param_checks.StrOptions({"rad", "deg"})],
    "model": [param_checks.HasMethods(["fit", "predict", "get_params"]), None],
    "cv": [param_checks.Interval(Integral, 2, None, closed="left"), None],
    "n_jobs": [Integral, None],
    "progress": [callable, None],
    "points_sd": [param_checks.Interval(Real, 0, None, closed="left")],
    "accept": ["array-like", str],
    "take": ["array-like", str],
}
# Known lengths that the report names.
_LENGTHS_SAID = 3
# Scores that are kept as they are.
_KEPT = (
    "verdict",
    "helps",
    "calibration_helps",
    "changes",
    "measure",
    "std_factor",
    "coverage",
    "share",
    "n_folds",
)


def learn_correction(
    arm: Arm,
    angles: ArrayLike | Measurements,
    positions: ArrayLike | None = None,
    points: ArrayLike | None = None,
    lengths: Iterable[Sequence[object]] = (),
    *,
    angle_unit: str = "rad",
    model: Any = None,
    cv: int | None = None,
    n_jobs: int | None = None,
    progress: Callable[..., object] | None = None,
    extra: Mapping[str, ArrayLike] | None = None,
    like: Sequence[ArmResidualRegressor] = (),
    tools: ArrayLike | None = None,
    points_sd: float = 0.0,
    blocks: ArrayLike | None = None,
    stations: ArrayLike | None = None,
    accept: str | Sequence[str] = (),
    take: str | Sequence[str] = (),
    features: Iterable[Sequence[object]] = (),
    tip_diameter: float = 0.0,
) -> Correction:
    """Calibrate an arm, learn what calibration leaves, and judge both at positions left out.

    The ``scores`` of the result are a cross-validation of any model, calibration included.

    Parameters
    ----------
    arm : Arm
        The nominal arm, or one calibrated on other data.
    angles : array-like of shape (n_samples, n_joints) or Measurements
        Joint angles, or all that was measured.
    positions : array-like of shape (n_samples,), default=None
        Label of the position at which the probe was held. None with `points`: regions of
        neighbouring points take their place, as where each row has its own label. None without:
        the places that :func:`calibrate` finds.
    points : array-like of shape (n_samples, 3), default=None
        Positions measured by a tracker in a frame of its own, mm. None: a single-point test.
    lengths : iterable of (label, label, length, standard deviation), default=()
        Known distances between two positions, mm, at 20 degrees C or with their temperature, as
        in :func:`calibrate`; those that disagree are named and not used. Positions joined by a
        known length are left out together, while at least three blocks remain.
    angle_unit : {"rad", "deg"}, default="rad"
        Unit of `angles`.
    model : estimator, default=None
        Takes joint angles in rad and predicts residuals (n_samples, 3) in mm. Its parameters called
        `arm` are set to the arm calibrated in each fold, those called `angle_unit` to "rad";
        `groups` and `lengths` are given to its `fit` where it takes them. None:
        ``ArmResidualRegressor(arm)``.
    cv : int, default=None
        Number of folds of whole positions or `blocks`. None: five.
    n_jobs : int, default=None
        Folds computed at the same time, as in scikit-learn.
    progress : callable, default=None
        Called as ``progress(done, n_folds)`` when a fold is done.
    extra : dict of str to array-like of shape (n_samples,), default=None
        Causes that were written down with the angles, by the names that
        :class:`ArmResidualRegressor` has for them, such as "direction 2" of
        :func:`directions_of`.
    like : list of ArmResidualRegressor, default=()
        Models of earlier arms of the make. The mean and the spread of their coefficients become the
        prior of the new model where the evidence prefers that to a fit of these rows alone (by
        4 nats with fewer than four positions). Positions left out say how much of it is used;
        ``learned.model.updates_`` keeps `gain_nats`. One that
        does not fit to this arm is passed over with a warning. Not with `model`; known lengths are
        then used by the calibration only.
    tools : array-like of shape (n_samples,), default=None
        Label of the probe of each row, where several took turns: their vectors are found, and the
        causes are learnt from all of them. `arm` and `model` are then those of the label that sorts
        first, and ``learned.with_tool(label)`` those of another. Where balls of different
        sizes sit in one cone, it is a position for each. Only with an
        :class:`ArmResidualRegressor`.
    points_sd : float, default=0.0
        Standard deviation of a coordinate of `points` as the tracker states it, mm: the noise that
        is not the arm's, which standard deviations of corrected points then leave out.
    blocks : array-like of shape (n_samples,), default=None
        Label of what carries the position of each row, and others with it: the plate of a socket,
        the placement of a bar. Positions of one block are left out
        together, and the intervals count blocks. With the number of blocks as `cv` they are the
        folds.
    stations : array-like of shape (n_samples,), default=None
        Label of the set-up of each row, where tracker or arm were moved. Corrected points are in
        the arm's base frame; ``learned.at_station(label)`` knows the tracker's.
    accept : str or list of str, default=()
        Codes of findings, such as "moved-position", in spite of which the correction is returned.
        "mirror-image" says that the arm is as it was taken, see `take`.
    take : str or list of str, default=()
        Codes by which :func:`search_table` proposes to change `arm`, one after the other, such as
        "reversed-2-4", "zero-2-180", "coupled-2-3" (joint 3 stands at J3 + J2), "zeros" (all of
        them are found from the data) or "other-convention". Where the data fit the mirror image of
        such an arm as well, the finding "mirror-image" asks what decides.
    features, tip_diameter
        As in :func:`calibrate`. Planes and spheres are left out as positions are, and judged by how
        far their touches are from the form that fits these best.

    Returns
    -------
    Correction
        With ``scores``, ``calibration``, and the angles and positions that it was learnt from.

    Raises
    ------
    ValueError
        If shapes, labels or numbers do not fit together, a position has one row, or there are fewer
        than three blocks of positions; if the points of the calibrated arm scatter by more than 2 %
        of its reach: labels, table or unit are then wrong, and the sentence says what
        :func:`search_table` has found; if `points_sd` is more than twice what the points differ by
        from the corrected ones; FindingError, as :func:`calibrate` and if a position has moved
        during the test.

    Warns
    -----
    UserWarning
        As :func:`calibrate` and :meth:`ArmResidualRegressor.fit`.

    Notes
    -----
    A correction helps if the upper end of the 95 % interval of mean after over mean before is
    below 1, and at least five positions say so. Outliers are neither learnt from nor counted.

    Examples
    --------
    >>> from sklearn_raacmm import ArmResidualRegressor, learn_correction
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> test = make_single_point(n_positions=6, n_poses=25, random_state=1)  # simulated
    >>> learned = learn_correction(
    ...     test.nominal_arm, test.data, test.groups,
    ...     model=ArmResidualRegressor(orders=4), cv=3,
    ... )
    >>> learned.helps, learned.scores.measure
    (True, '2S')
    >>> points, std = learned.correct(test.data[:5])
    >>> points.shape, std.shape
    ((5, 3), (5, 3))
    """
    # `validate_params` would name this function where a parameter of the model is wrong.
    given = {"angle_unit": angle_unit, "model": model, "cv": cv, "n_jobs": n_jobs}
    param_checks.validate_parameter_constraints(
        _CONSTRAINTS,
        given | {"progress": progress, "points_sd": points_sd, "accept": accept, "take": take},
        "learn_correction",
    )
    if points_sd and points is None and getattr(angles, "points", None) is None:
        raise ValueError("points_sd is of the points that a tracker measured: there are none.")

    raw: Any = (angles, positions, points)
    given_arm, codes = arm, listed("take", take)
    features = listed("features", features)
    if codes and (features or getattr(angles, "features", None)):
        raise ValueError("take needs positions or measured points: features cannot show it.")
    if isinstance(angles, Measurements):
        labels = None if angles.labels is None else angles.labels[angles.index]
        raw, angle_unit = (angles.angles, labels, angles.points), "rad"
    for code in codes:
        arm = with_change(arm, code, (*raw, angle_unit))

    def measured():
        """What was measured, of a single-point test without labels at the places of its points."""
        Arm.check(arm)
        given: dict[str, Any] = {"points": points, "lengths": lengths, "tools": tools}
        given |= {"stations": stations, "extra": extra}
        given |= {"features": features, "tip_diameter": tip_diameter}
        if isinstance(angles, Measurements):
            return Measurements.taken(angles, positions, **given)
        checked = within_turn(arm.check_angles(angles, angle_unit), arm.joint_types)
        refuse_one_pose(checked)
        given["joint_types"] = arm.joint_types
        no_labels = positions is None and points is None and not features
        return Measurements.of(
            checked, find_places(arm, checked) if no_labels else positions, **given
        )

    def inside():
        data = Data(arm, measured(), like, blocks)
        calibration = _calibrated(data, raw[0], angle_unit, accept)
        if codes and "mirror-image" not in listed("accept", accept):
            with Finding.numbered(Finding.row_numbers(data.rows)):
                ask_whether_mirrored(given_arm, arm, *data.as_given(raw[0]), angle_unit)
        data, outliers = data.seen_by(calibration).without_outliers(calibration)
        folds = folds_of(data, outliers, cv)
        rows = data.without_lonely(np.delete(np.arange(len(data.angles)), outliers))[0]
        calibration = data.at_stations(model, calibration, rows)
        fitted, noise = data.fit(model, calibration, rows)
        parts = data.along_vertical_of(fitted)
        scores = scores_of(parts, calibration, model, outliers, folds, n_jobs, progress)
        _report_what_moved(data, calibration, fitted, rows)
        # A fit would have to take three quarters of what is free to leave half of the noise.
        if points_sd > 2 * noise:
            raise ValueError(
                f"points_sd is {points_sd:.3g} mm, and the tracker's points differ from the "
                f"corrected ones by {noise:.3g} mm a coordinate only: the tracker is better."
            )
        return data, calibration, scores, fitted, noise

    (data, calibration, scores, fitted, noise), findings = Finding.of_call(inside, accept)
    if (linear := getattr(fitted, "linear_model_", None)) is not None:
        fitted.linear_model_ = linear.with_scale_sd(calibration.scale_sd_corrected)
    scores = replace(scores, findings=tuple(findings), share=share_of(fitted))
    base = (
        None if data.points is None else (calibration.base_rotation, calibration.base_translation)
    )
    facts = _facts(data, calibration, scores) | {"noise_mm": noise, "points_sd_mm": points_sd}
    data_of = data.angles, data.positions
    return Correction(calibration.arm, fitted, base, facts, scores, calibration, *data_of)


def _report_what_moved(data, calibration, model, rows):
    """Say which positions moved, and by how much the run drifted, of what a model leaves.

    Touches of surfaces, each at a place of its own, cannot say so.
    """
    rows, held = rows[data.held[rows]], data.held
    if not len(rows):
        return
    expected = data.at_probes(model, calibration, slice(None)).predict(data.inputs)
    if data.points is None and "moved-position" not in {f.code for f in calibration.findings}:
        # Of all rows: those after a step may be outliers.
        left = calibration.residuals_mm[data.rows] - expected
        turns = calibration.arm.phases(data.angles)
        own = (part[held] for part in (left, turns, data.positions, data.rows))
        for finding in moved_positions(*own):
            finding.report()
    left = data.residuals(calibration, rows) - expected[rows]
    codes = None if data.points is not None else Groups.encoded(data.positions[rows])[1]
    for finding in drift_of(calibration.arm, data.angles[rows], left, codes):
        finding.report()


def _calibrated(data, angles, angle_unit, accept):
    """Calibration of all rows; refuses points that cannot be those of this arm."""
    calibration = data.calibrate(accept=accept)
    reach, scatter = calibration.arm.reach_mm, calibration.typical_scatter_mm
    if scatter <= MUCH_SCATTER_MM:
        return calibration
    for finding in calibration.findings:
        if finding.code == "wrong-label" and finding.weight == "repair":
            raise FindingError(finding)
    with Finding.numbered(Finding.row_numbers(data.rows)):
        if data.points is not None and data.stations is None:
            finding = shifted_rows(data.arm, data.angles, data.points)
            if finding is not None:
                finding.report()
        change = None
        if not data.kinds:
            change = search_table(data.arm, *data.as_given(angles), angle_unit=angle_unit)
    if change or scatter > SHARE_OF_REACH * reach:  # they belong to another table
        said = (
            f"the points scatter by {scatter:.3g} mm after calibration, and the arm reaches "
            f"{reach:.4g} mm: labels, the table of the arm, the order or sense of its joints, or "
            "the unit of the angles are wrong."
        )
        advice = str(
            change
            or "Other senses and zeros of joints, two joints exchanged or all reversed, the other "
            "convention of the table and the other unit do not explain it. Not tried: more columns "
            "of angles out of order; they must be those of the joints from the base on."
        )
        advice = "Cones, or a tracker, would show which." if data.kinds else advice
        raise FindingError(Finding("another-table", said, advice, "refuse", size_mm=scatter))
    said = f"The points scatter by {scatter:.1f} mm after calibration."
    advice = "The table of the arm is probably wrong: look at it before you use the correction."
    Finding("much-scatter", said, advice, size_mm=scatter).report()
    return calibration


def _facts(data, calibration, scores):
    """What is worth keeping of a correction without its data, as plain values fit for JSON."""
    rows, labels = data.rows[scores.outliers], data.positions[scores.outliers]
    distance = np.linalg.norm(calibration.residuals_mm[rows], axis=1)
    farthest = np.argsort(-distance, kind="stable")
    columns = (part[farthest].tolist() for part in (rows, labels, distance))
    return {name: getattr(scores, name) for name in _KEPT} | {
        "written_by": f"sklearn_raacmm {__version__}",
        "findings": [finding.facts() for finding in scores.findings],
        "scale_sd": calibration.scale_sd_corrected,
        "scale_set_by": _scale_of(data),
        "n_rows": len(data.angles),
        "causes": usual_values(data.causes, data.values),
        "tools": {str(tool): arm.probe.tolist() for tool, arm in calibration.arms.items()},
        "stations": {
            str(label): [part.tolist() for part in base]
            for label, base in calibration.bases.items()
        },
        "summary": {name: list(values) for name, values in scores.summary.items()},
        "positions": {name: column.tolist() for name, column in scores.table.items()},
        "outliers": [list(row) for row in zip(*columns, strict=True)],
    }


def _scale_of(data):
    """What set the common scale of all links, for people."""
    if data.points is not None:
        return "the points of a tracker"
    said = [
        f"{f'{a} to {b}' if a != b else f'diameter of {a}'}, {mm:.3f} mm (sd {sd:.3g} mm)"
        for a, b, mm, sd in data.lengths
    ]
    more = [f"and {len(said) - _LENGTHS_SAID} more"] * (len(said) > _LENGTHS_SAID)
    return "; ".join(said[:_LENGTHS_SAID] + more) or "the arm's table: no length was known"
