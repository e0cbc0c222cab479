"""The one call: calibrate, learn the rest, and say whether it helps."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm._version import __version__
from sklearn_raacmm.arm import Arm, reach_mm
from sklearn_raacmm.calibration import SHARE_OF_REACH, CalibrationResult
from sklearn_raacmm.correction._causes import (
    say_make,
    usual_values,
    with_kept_causes,
)
from sklearn_raacmm.correction._one_fit import Data
from sklearn_raacmm.correction._saved import SavedCorrection
from sklearn_raacmm.correction._scores import (
    CorrectionScores,
    check_judging,
    scored_and_fitted,
    with_verdict,
)
from sklearn_raacmm.correction._table_search import search_table
from sklearn_raacmm.error_model import ArmResidualRegressor
from sklearn_raacmm.measurements import drift_of
from sklearn_raacmm.utils import Finding, encode_groups, hear, say_findings

# Scatter after calibration beyond which the arm's table is probably wrong: measuring arms have
# hundredths of a mm, the real robots of the tests 0.2 to 0.4.
_MUCH_SCATTER_MM = 1.0


@dataclass(frozen=True, eq=False)
class LearnedCorrection:
    """A calibrated arm, a model of what calibration leaves, and what both are worth.

    Attributes
    ----------
    arm : Arm
        The calibrated arm.
    model : estimator
        Fitted on all rows but the outliers: ``model.predict(angles)``, in rad, is to be subtracted
        from ``arm.forward(angles)``.
    scores : CorrectionScores
        Positions left out, before and after.
    calibration : CalibrationResult
        Parameters with their standard deviations, and what could not be identified.
    outliers : structured ndarray of shape (n_outliers,)
        ``row``, ``position`` and ``distance`` in mm of the rows left out as outliers, the farthest
        first, see :class:`CorrectionScores`.
    noise : float
        Root mean square of a coordinate that the model leaves of its training rows, mm.
    angles, positions, points, lengths
        The data, angles in rad and within a turn.
    causes : dict of str to float
        The causes that the model takes after the angles, and what counts where they are not known:
        the mean, no direction, and of time the last value.

    See Also
    --------
    learn_correction : Makes one.
    """

    arm: Arm
    model: Any
    scores: CorrectionScores
    calibration: CalibrationResult = field(repr=False)
    outliers: np.ndarray = field(repr=False)
    noise: float
    angles: np.ndarray = field(repr=False)
    positions: np.ndarray = field(repr=False)
    points: np.ndarray | None = field(repr=False)
    lengths: list[Any] = field(repr=False)
    causes: dict[str, Any] = field(default_factory=dict)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What there is to say about the data, a tuple of :class:`Finding`."""
        return self.scores.findings

    @property
    def tools(self) -> dict[str, Any]:
        """Vectors of the probes by their labels, mm."""
        return {str(tool): arm.probe.tolist() for tool, arm in self.calibration.arms.items()}

    @property
    def helps(self) -> bool:
        """Whether the correction is worth using at new positions."""
        return self.scores.helps

    @property
    def verdict(self) -> str:
        """The same in one sentence."""
        return self.scores.verdict

    def correct(
        self,
        angles: ArrayLike,
        *,
        angle_unit: str = "rad",
        std_of: str = "coordinate",
        extra: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Corrected points, and how far to trust them.

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints)
            Joint angles.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `angles`.
        std_of : {"coordinate", "position"}, default="coordinate"
            What the standard deviations are of: a coordinate of one reading in the arm's base
            frame; or its deviation within a position, which is all that cones show: 95 % of the
            coordinates left out lay within 1.96 of them.
        extra : dict of str to array-like of shape (n_samples,), default=None
            The causes that `causes` names; for those that are missing it has what counts instead.

        Returns
        -------
        points : ndarray of shape (n_samples, 3)
            Corrected points in the arm's base frame, mm.
        std : ndarray of shape (n_samples, 3)
            Standard deviation of each coordinate of one reading, mm (k = 1). Beside that within a
            position, that of a coordinate in the base frame holds the scale, s (P - S) with P the
            point, S the shoulder and s ``calibration.scale_sd``, and how the arm may give way as a
            function of the place.

        Raises
        ------
        ValueError
            If `angles` do not fit the arm, or `extra` names what the model does not know.

        See Also
        --------
        distances : Distances, whose standard deviations are others.
        """
        return self.saved.correct(angles, angle_unit=angle_unit, std_of=std_of, extra=extra)

    def distances(
        self, angles: ArrayLike, others: ArrayLike, *, angle_unit: str = "rad"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distances between pairs of corrected readings, and how far to trust them.

        Parameters
        ----------
        angles, others : array-like of shape (n_samples, n_joints)
            Joint angles at both ends.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of both.

        Returns
        -------
        lengths : ndarray of shape (n_samples,)
            In mm.
        std : ndarray of shape (n_samples,)
            Standard deviation of a distance between two readings, mm (k = 1): of its ends along
            the line, and of the scale of the arm.

        Raises
        ------
        ValueError
            If the angles do not fit the arm or each other.
        """
        return self.saved.distances(angles, others, angle_unit=angle_unit)

    def save(
        self, folder: str | PathLike[str], others: Mapping[str, str | bytes] | None = None
    ) -> list[Any]:
        """Write the arm, the model and the scores into a folder.

        ``model.skops`` needs skops; without it ``model.joblib`` is written, which only its writer
        should load. Whatever interrupts the writing, the folder holds the old correction or this
        one: ``correction.json`` has the fingerprints of the files that belong to it.

        Parameters
        ----------
        folder : str or path-like
            Made if it does not exist.
        others : dict of str to str or bytes, default=None
            Names and contents of files to write with them, such as a report.

        Returns
        -------
        list of pathlib.Path
            ``correction.json`` with scores, verdict and versions, ``arm.json``, the model, and the
            others.
        """
        return self.saved.save(folder, others)

    @staticmethod
    def load(folder: str | PathLike[str]) -> SavedCorrection:
        """Load what `save` wrote, without the data: see `SavedCorrection`.

        Parameters
        ----------
        folder : str or path-like

        Returns
        -------
        SavedCorrection
            The arm, the model, the base, and the facts of ``correction.json``.

        Examples
        --------
        >>> from sklearn_raacmm import LearnedCorrection
        >>> saved = LearnedCorrection.load("my_arm")  # doctest: +SKIP
        """
        return SavedCorrection.load(folder)

    @cached_property
    def saved(self) -> SavedCorrection:
        """The same without the data: what `save` writes and `load` reads."""
        turned = self.calibration.base_rotation
        base = None if turned is None else (turned, self.calibration.base_translation)
        return SavedCorrection(self.arm, self.model, base, self.facts())

    def facts(self) -> dict[str, Any]:
        """Scores and verdict as plain values, fit for JSON."""
        scores = self.scores
        return {
            "written_by": f"sklearn_raacmm {__version__}",
            "verdict": scores.verdict,
            "helps": scores.helps,
            "judged": scores.judged,
            "findings": [finding.facts() for finding in scores.findings],
            "measure": scores.measure,
            "noise_mm": self.noise,
            "std_factor": scores.std_factor,
            "scale_sd": self.calibration.scale_sd,
            "coverage": scores.coverage,
            "n_rows": len(self.angles),
            "causes": self.causes,
            "tools": self.tools,
            "n_folds": scores.n_folds,
            "summary": {name: list(values) for name, values in scores.summary.items()},
            "positions": {name: column.tolist() for name, column in scores.table.items()},
            "outliers": [list(row) for row in self.outliers.tolist()],
        }

    def __str__(self) -> str:
        lines = [
            f"{self.arm!r}, {len(self.angles)} rows",
            f"calibration: mean scatter {self.calibration.scatter_before_mm:.3f} -> "
            f"{self.calibration.scatter_after_mm:.3f} mm",
            str(self.scores),
        ]
        for row, label, distance in self.outliers[:10].tolist():
            lines.append(f"  outlier: row {row} ({label}), {distance:.3g} mm")
        if len(self.outliers) > 10:
            lines.append(f"  and {len(self.outliers) - 10} more")
        return "\n".join(lines)

    def _repr_html_(self):
        outliers = [
            f"<br>outlier: row {row} ({escape(str(label))}), {distance:.3g} mm"
            for row, label, distance in self.outliers[:10].tolist()
        ]
        return f"{self.scores._repr_html_()}{''.join(outliers)}<p>{escape(repr(self.arm))}</p>"


def learn_correction(
    arm: Arm,
    angles: ArrayLike,
    positions: ArrayLike | None,
    points: ArrayLike | None = None,
    lengths: Iterable[Sequence[Any]] = (),
    *,
    angle_unit: str = "rad",
    model: Any = None,
    cv: Any = None,
    n_jobs: int | None = None,
    progress: Callable | None = None,
    extra: dict[str, Any] | None = None,
    in_order: bool = False,
    like: Sequence[ArmResidualRegressor] = (),
    tools: ArrayLike | None = None,
) -> LearnedCorrection:
    """Calibrate an arm, learn what calibration leaves, and judge both at positions left out.

    Parameters
    ----------
    arm : Arm
        The nominal arm, or one calibrated on other data.
    angles : array-like of shape (n_samples, n_joints)
        Joint angles.
    positions : array-like of shape (n_samples,) or None
        Label of the position at which the probe was held. None, with `points`: regions of
        neighbouring points take their place.
    points : array-like of shape (n_samples, 3), default=None
        Positions measured by a tracker in a frame of its own, mm. None: a single-point test.
    lengths : iterable of (label, label, length, standard deviation), default=()
        Known distances between two positions, mm.
    angle_unit : {"rad", "deg"}, default="rad"
        Unit of `angles`.
    model : estimator, default=None
        See :func:`cross_validate_correction`. None: ``ArmResidualRegressor(arm)``.
    cv : int, splitter or iterable of (train, test), default=None
        See :func:`cross_validate_correction`.
    n_jobs : int, default=None
        Folds computed at the same time, as in scikit-learn.
    progress : callable, default=None
        Called as ``progress(done, n_folds)`` when a fold is done.
    extra : dict of str to array-like of shape (n_samples,), default=None
        Causes that were written down with the angles, by the names that
        :class:`ArmResidualRegressor` has for them. They are kept where the evidence asks for them.
        "time" is refused where the angles tell the number of the row.
    in_order : bool, default=False
        Whether the rows are in the order in which they were measured. Then the directions from
        which joints came are offered, too, and the findings say what they are worth at positions
        left out.
    like : list of ArmResidualRegressor, default=()
        Models of earlier arms of the make, see :func:`transfer_correction`: what they have in
        common is where this one starts, if the evidence for it is at least 4 nats. Not with
        `model`; known lengths are then used by the calibration only.
    tools : array-like of shape (n_samples,), default=None
        Label of the probe of each row, where several took turns: their vectors are found, and the
        causes are learnt from all of them. `arm` and `model` are then those of the first label,
        and ``learned.saved.with_tool(label)`` those of another. Where balls of different sizes sit
        in one cone, it is a position for each. Only with an :class:`ArmResidualRegressor`.

    Returns
    -------
    LearnedCorrection
        The calibrated arm, the fitted model, the scores and the verdict.

    Raises
    ------
    ValueError
        As :func:`cross_validate_correction`; and if the points of the calibrated arm scatter by
        more than 2 % of its reach: labels, table or unit are then wrong, and the sentence says
        what :func:`search_table` has found.

    Warns
    -----
    UserWarning
        As :func:`calibrate`; and if a position has moved during a single-point test, as
        :meth:`ArmResidualRegressor.fit` says.

    See Also
    --------
    cross_validate_correction : The judgement alone.

    Notes
    -----
    Outliers are rows that :func:`calibrate` names and that :class:`ArmResidualRegressor` cannot
    explain either. They are not learnt from, nor counted in the scores, neither before nor after.

    Examples
    --------
    >>> from sklearn_raacmm import ArmResidualRegressor, learn_correction
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> test = make_single_point(n_positions=6, n_poses=25, random_state=1)  # simulated
    >>> learned = learn_correction(
    ...     test.nominal_arm, test.data, test.groups,
    ...     model=ArmResidualRegressor(orders=4), cv=3,
    ... )
    >>> learned.helps
    True
    >>> points, std = learned.correct(test.data[:5])
    >>> points.shape, std.shape
    ((5, 3), (5, 3))
    """
    check_judging(
        "learn_correction",
        angle_unit=angle_unit,
        model=model,
        cv=cv,
        n_jobs=n_jobs,
        progress=progress,
    )

    def inside():
        data = Data.checked(
            arm, angles, positions, points, lengths, angle_unit, extra, in_order, like, tools
        )
        calibration = _calibrated(data, angles, angle_unit)
        data = with_kept_causes(data, calibration)
        scores, fitted, noise = scored_and_fitted(data, calibration, model, cv, n_jobs, progress)
        if data.like and model is None:
            say_make(fitted)
        say_findings([_drift(data, calibration, fitted, scores.outliers)])
        return data, calibration, scores, fitted, noise

    (data, calibration, scores, fitted, noise), heard = hear(inside)
    return LearnedCorrection(
        arm=calibration.arm,
        model=fitted,
        scores=with_verdict(scores, heard),
        calibration=calibration,
        outliers=_outliers(calibration, data, scores.outliers),
        noise=noise,
        angles=data.angles,
        positions=data.positions,
        points=data.points,
        lengths=data.lengths,
        causes=usual_values(data.causes, data.values),
    )


def _drift(data, calibration, model, outliers):
    """By how much the run drifted, of what the model leaves of the rows that are no outliers."""
    rows = data.without_lonely(np.delete(np.arange(len(data.angles)), outliers))[0]
    there = data.at_probes(model, calibration, rows)
    left = data.residuals(calibration, rows) - there.predict(data.inputs[rows])
    codes = None if data.points is not None else encode_groups(data.positions[rows])[1]
    return drift_of(calibration.arm, data.angles[rows], left, codes)


def _calibrated(data, angles, angle_unit):
    """Calibration of all rows; refuses points that cannot be those of this arm."""
    calibration = data.calibrate_all()
    reach, scatter = reach_mm(calibration.arm), calibration.scatter_after_mm
    if scatter > SHARE_OF_REACH * reach:  # they belong to another table
        positions = data.positions if data.points is None else None
        angles = np.asarray(angles)[data.rows]
        change = search_table(data.arm, angles, positions, data.points, angle_unit=angle_unit)
        raise ValueError(
            f"the points scatter by {scatter:.3g} mm after calibration, and the arm reaches "
            f"{reach:.4g} mm: labels, the table of the arm, the order or sense of its joints, or "
            f"the unit of the angles are wrong. {change or 'No single change of these helps.'}"
        )
    if scatter > _MUCH_SCATTER_MM:
        said = f"The points scatter by {scatter:.1f} mm after calibration."
        advice = "The table of the arm is probably wrong: look at it before you use the correction."
        say_findings([Finding("much-scatter", said, advice, size_mm=scatter)])
    return calibration


def _outliers(calibration, data, poses):
    """Rows of outliers with their labels and distances, the farthest first."""
    rows, positions = data.rows[poses], data.given[1]
    distance = np.linalg.norm(calibration.residuals_mm[rows], axis=1)
    order = np.argsort(-distance, kind="stable")
    fields = [("row", "i8"), ("position", positions.dtype), ("distance", "f8")]
    table = np.empty(len(rows), dtype=fields)
    table["row"], table["position"] = rows[order], positions[rows[order]]
    table["distance"] = distance[order]
    return table
