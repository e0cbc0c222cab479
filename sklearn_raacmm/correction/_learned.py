"""A learnt correction: the saved one, with the data, the calibration and the scores."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm._version import __version__
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import CalibrationResult
from sklearn_raacmm.correction._saved import SavedCorrection
from sklearn_raacmm.correction._scores import CorrectionScores
from sklearn_raacmm.utils import Finding


@dataclass(frozen=True, eq=False)
class LearnedCorrection:
    """What :func:`learn_correction` returns: arm, model of the rest, and what both are worth.

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
            function of the place. For distances see :meth:`distances`.

        Raises
        ------
        ValueError
            If `angles` do not fit the arm, or `extra` names what the model does not know.
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
        should load. Whatever interrupts the writing, the folder holds the old correction or this.

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
        calibration = self.calibration
        return "\n".join(
            [
                f"{self.arm!r}, {len(self.angles)} rows",
                f"calibration: mean scatter {calibration.scatter_before_mm:.3f} -> "
                f"{calibration.scatter_after_mm:.3f} mm",
                str(self.scores),
                *self._outlier_lines(),
            ]
        )

    def _outlier_lines(self):
        lines = [
            f"  outlier: row {row} ({label}), {distance:.3g} mm"
            for row, label, distance in self.outliers[:10].tolist()
        ]
        more = len(self.outliers) - len(lines)
        return lines + [f"  and {more} more"] * bool(more)

    def _repr_html_(self):
        lines = map(escape, [*self._outlier_lines(), repr(self.arm)])
        return f"{self.scores._repr_html_()}<p>{'<br>'.join(lines)}</p>"
