"""A correction in a folder: written whole or not at all, loaded, registered, and used."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any, Self

import joblib
import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import Arm, check_angles
from sklearn_raacmm.calibration import CalibrationResult
from sklearn_raacmm.correction._causes import with_causes
from sklearn_raacmm.correction._deviations import distances, of_coordinate, predict_with_std
from sklearn_raacmm.error_model import ArmResidualRegressor, Fading, Judgement, LinearModel, Terms
from sklearn_raacmm.network import Network, RBFNetRegressor
from sklearn_raacmm.residuals import CylindricalResidualTarget, PoseFeatures
from sklearn_raacmm.utils import Finding, check_option, digest_of, whole_file, write_whole

_FACTS = "correction.json"
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
    """What :meth:`LearnedCorrection.load` returns, and is needed to use a correction.

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
    ) -> list[Path]:
        """Write the folder, see `LearnedCorrection.save`."""
        try:
            import skops.io

            name, model = "model.skops", skops.io.dumps(self.model)
        except ImportError:
            file = BytesIO()
            joblib.dump(self.model, file)
            name, model = "model.joblib", file.getvalue()
        base = None
        if self.base is not None:
            rotation, translation = self.base
            base = {"rotation": rotation.tolist(), "translation_mm": translation.tolist()}
        contents = {"arm.json": self.arm.to_json(), name: model, **(others or {})}
        return write_correction(folder, self.facts | {"base": base}, contents)

    def with_tool(self, tool: str) -> Self:
        """The same with another of the probes that it was learnt with.

        Raises
        ------
        ValueError
            If there is none of this label.
        """
        tools = self.facts.get("tools", {})
        if str(tool) not in tools:
            known = ", ".join(tools) or "one only"
            raise ValueError(
                f"the correction knows no tool {str(tool)!r}; it was learnt with {known}."
            )
        arm = self.arm.replace(probe=tools[str(tool)])
        return replace(self, arm=arm, model=self.model.with_arm(arm))

    def inputs(self, angles: np.ndarray, extra: dict[str, Any] | None = None) -> np.ndarray:
        """What the model takes: angles in rad, (n, n_joints), then its causes."""
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
        check_option("std_of", std_of, ("coordinate", "position"))
        angles = check_angles(angles, self.arm.n_joints, angle_unit)
        X = self.inputs(angles, extra)
        points, within = self._within_positions(X)
        if std_of == "position":
            return points, within
        return points, of_coordinate(self, X, points, within)

    def columns(self, X: np.ndarray) -> np.ndarray:
        """What a corrected table gets, (n_samples, 10) in mm, of what `inputs` returns.

        Points; standard deviations of the coordinates in the base frame and within a position; that
        of a distance of 1 m from here to a point that is known as well.
        """
        points, within = self._within_positions(X)
        scale = 1000 * self.facts["scale_sd"]
        of_metre = np.sqrt(2 * np.mean(within**2, axis=1) + scale**2)
        return np.column_stack([points, of_coordinate(self, X, points, within), within, of_metre])

    def _within_positions(self, X):
        """Corrected points, and standard deviations of their coordinates within a position."""
        correction, std = predict_with_std(self.model, X, self.facts["noise_mm"])
        points = self.arm.forward(X[:, : self.arm.n_joints]) - correction
        return points, self.facts["std_factor"] * std

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
        """
        base, model = self.base, self.model
        if calibration.base_rotation is not None:
            base = calibration.base_rotation, calibration.base_translation
        if hasattr(model, "with_arm"):
            model = model.with_arm(calibration.arm)
        return replace(self, arm=calibration.arm, model=model, base=base)


def write_correction(
    folder: str | PathLike[str], facts: dict[str, Any], contents: Mapping[str, str | bytes]
) -> list[Path]:
    """Write ``correction.json``, with the fingerprints of all other files, and these files.

    Whatever interrupts the writing, the folder holds the old correction or this one.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    facts = facts | {"files": {name: digest_of(content) for name, content in contents.items()}}
    contents = {_FACTS: json.dumps(facts, indent=1, ensure_ascii=False) + "\n", **contents}
    paths = {folder / name: content for name, content in contents.items()}
    write_whole(paths)
    return list(paths)


def read_correction(
    folder: str | PathLike[str], names: Iterable[str]
) -> tuple[dict[str, Any], list[bytes]]:
    """Facts of ``correction.json``, and the contents of files that were written with it.

    Raises
    ------
    ValueError
        If ``correction.json`` is not what was written, or a file is not the one it was written
        with.
    OSError
        If there is no such file.
    """
    folder = Path(folder)
    if not (folder / _FACTS).is_file():
        raise FileNotFoundError(f"{folder} has no {_FACTS}; learning a correction writes one.")
    try:
        facts = json.loads((folder / _FACTS).read_text(encoding="utf-8"))
        digests = {name: facts["files"].get(name) for name in names}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ValueError(f"{folder / _FACTS} holds no correction: learn again.") from None
    contents = []
    for name, digest in digests.items():
        if not digest:
            raise FileNotFoundError(f"{folder} was written without {name}.")
        content = whole_file(folder / name, digest)
        if content is None:
            state = "not the one" if (folder / name).exists() else "missing, the one"
            raise ValueError(
                f"{folder}: {name} is {state} that {_FACTS} was written with: copy the whole "
                "folder again, or learn again."
            )
        contents.append(content)
    return facts, contents
