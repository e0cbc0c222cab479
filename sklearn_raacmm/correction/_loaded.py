"""A correction that was saved: loaded, registered, brought up to date, moved, and saved again."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import Arm, check_angles
from sklearn_raacmm.calibration import CalibrationResult
from sklearn_raacmm.correction._causes import with_causes
from sklearn_raacmm.correction._deviations import STD_OF, corrected_points, distances
from sklearn_raacmm.correction._saved import read_correction, write_correction
from sklearn_raacmm.error_model import ArmResidualRegressor, Fading, Judgement, LinearModel, Terms
from sklearn_raacmm.network import Network, RBFNetRegressor
from sklearn_raacmm.residuals import CylindricalResidualTarget, PoseFeatures
from sklearn_raacmm.utils import Finding, check_option

#: What a skops file of any model made of this package's and scikit-learn's estimators needs trust
#: in: ``skops.io.load(path, trusted=TRUSTED_TYPES)``. Names of this package's own, nothing else.
TRUSTED_TYPES = [
    f"{kind.__module__}.{kind.__qualname__}"
    for kind in (
        Arm,
        Arm.azimuth,
        ArmResidualRegressor,
        CylindricalResidualTarget,
        Fading,
        Finding,
        Judgement,
        LinearModel,
        Network,
        PoseFeatures,
        RBFNetRegressor,
        Terms,
    )
]


@dataclass(frozen=True, eq=False)
class SavedCorrection:
    """What is needed to use a correction: the arm, the model, where the base stands, and facts.

    Attributes
    ----------
    arm : Arm
        The calibrated arm with the probe in use.
    model : estimator
        Fitted: ``model.predict(angles)``, in rad, is to be subtracted from ``arm.forward(angles)``.
    base : (ndarray of shape (3, 3), ndarray of shape (3,)) or None
        Rotation and translation in mm of the arm's base in the tracker's frame; None where no
        tracker has measured it.
    facts : dict
        What ``correction.json`` holds.

    See Also
    --------
    LearnedCorrection.load : Makes one.
    """

    arm: Arm
    model: Any
    base: tuple[Any, ...] | None
    facts: dict[str, Any]

    @classmethod
    def load(cls, folder: str | PathLike[str]) -> Self:
        """Read a folder that `LearnedCorrection.save` or `save` has written.

        Parameters
        ----------
        folder : str or path-like

        Returns
        -------
        SavedCorrection

        Raises
        ------
        ValueError
            If the files do not belong together, or are of another version.
        OSError
            If one is missing.
        ImportError
            If skops is not there.
        """
        facts, (arm, model) = read_correction(folder, ["arm.json", "model.skops"])
        try:
            import skops.io
        except ImportError:
            raise ImportError("To load a model, install skops: pip install skops.") from None
        try:
            model = skops.io.loads(model, trusted=TRUSTED_TYPES)
        except Exception as error:  # of a file of another version, anything
            raise ValueError(f"{folder} cannot be loaded: {error}") from None
        base = facts.get("base")
        if base is not None:
            base = np.array(base["rotation"]), np.array(base["translation_mm"])
        return cls(Arm.from_json(arm), model, base, facts)

    def save(
        self, folder: str | PathLike[str], others: Mapping[str, str | bytes] | None = None
    ) -> Any:
        """Write the folder, see `LearnedCorrection.save`."""
        try:
            import skops.io

            name, model = "model.skops", skops.io.dumps(self.model)
        except ImportError:
            import io

            import joblib

            file = io.BytesIO()
            joblib.dump(self.model, file)
            name, model = "model.joblib", file.getvalue()
        base = None
        if self.base is not None:
            rotation, translation = self.base
            base = {"rotation": rotation.tolist(), "translation_mm": translation.tolist()}
        contents = {"arm.json": self.arm.to_json(), name: model, **(others or {})}
        return write_correction(folder, self.facts | {"base": base}, contents)

    def inputs(self, angles: np.ndarray, extra: dict[str, Any] | None = None) -> Any:
        """What the model takes: angles in rad, (n, n_joints), and the causes that it knows."""
        return with_causes(angles, self.facts["causes"], extra)

    def correct(
        self,
        angles: ArrayLike,
        *,
        angle_unit: str = "rad",
        std_of: str = "coordinate",
        extra: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Corrected points and standard deviations, see `LearnedCorrection.correct`."""
        check_option("std_of", std_of, STD_OF)
        angles = check_angles(angles, self.arm.n_joints, angle_unit)
        X = self.inputs(angles, extra)
        return corrected_points(self.arm, self.model, X, self.facts, std_of)

    def distances(
        self, angles: ArrayLike, others: ArrayLike, *, angle_unit: str = "rad"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distances and their standard deviations, see `LearnedCorrection.distances`."""
        one, other = (
            self.correct(q, angle_unit=angle_unit, std_of="position") for q in (angles, others)
        )
        if len(one[0]) != len(other[0]):
            raise ValueError(f"There are {len(one[0])} angles, but {len(other[0])} others.")
        return distances(one, other, self.facts["scale_sd"])

    def residuals(self, angles: np.ndarray, points: np.ndarray) -> np.ndarray:
        """What the arm shows, in rad, less what a tracker measured, in the base frame, (n, 3) mm.

        Raises
        ------
        ValueError
            If no tracker has measured the base.
        """
        if self.base is None:
            raise ValueError(
                "this correction was learnt without a tracker and knows no frame of measured "
                "points: register it with some first."
            )
        rotation, translation = self.base
        return self.arm.forward(angles) - (points - translation) @ rotation

    def registered(self, calibration: CalibrationResult) -> Self:
        """The same with the probe, and the base if it was measured, of a registration.

        Parameters
        ----------
        calibration : CalibrationResult
            Of ``calibrate(arm, ..., correction=model, free=["probe"])``.

        Returns
        -------
        SavedCorrection
        """
        base = self.base
        if calibration.base_rotation is not None:
            base = calibration.base_rotation, calibration.base_translation
        model = self.model
        if hasattr(model, "with_arm"):
            model = model.with_arm(calibration.arm)
        return replace(self, arm=calibration.arm, model=model, base=base)
