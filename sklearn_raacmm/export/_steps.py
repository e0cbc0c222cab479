"""A fitted model taken apart into its steps: their names, their arm, rows that they may see."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import cached_property
from typing import Any

import numpy as np
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model import ArmResidualRegressor
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.residuals import CylindricalResidualTarget, PoseFeatures

REGRESSORS = (RBFNetRegressor, ArmResidualRegressor, LinearRegression, Ridge)


class Chain:
    """The steps of a fitted model in the order in which data pass; a wrapper comes first.

    A class, an estimator that is not fitted, or a chain without a step is refused.

    Attributes
    ----------
    steps : list of (str, estimator)
        Each with its path, which is what a message calls it.
    extra : sequence
        Name and reference of each column after the angles, as `Terms` has them.
    """

    def __init__(self, model):
        self.model, self.steps = model, list(_leaves(model, type(model).__name__))
        for _, step in self.steps:
            check_is_fitted(step)
        if not self.steps:
            raise ValueError(f"{model!r:.60} has no step that computes anything.")
        self.n_inputs = int(self.steps[0][1].n_features_in_)
        arm_models = (s for _, s in self.steps if isinstance(s, ArmResidualRegressor))
        self.extra: Any = next((s.linear_model_.terms.extra for s in arm_models), ())

    @cached_property
    def arm_and_unit(self) -> tuple[Any, Any]:
        """Arm and unit of its angles, (None, None) without one; ValueError if steps disagree."""
        found = []
        for path, step in self.steps:
            if isinstance(step, CylindricalResidualTarget) and callable(step.azimuth):
                owner = getattr(step.azimuth, "__self__", None)
                if not isinstance(owner, Arm) or step.azimuth != owner.azimuth:
                    raise ValueError(
                        f"{path} takes its azimuth from {step.azimuth!r}, which cannot be "
                        "exported: only the method of an Arm can, azimuth=arm.azimuth."
                    )
                found.append((path, owner, "rad"))
            elif isinstance(arm := getattr(step, "arm_", None), Arm):
                found.append((path, arm, getattr(step, "angle_unit", "rad")))
        for path, arm, unit in found[1:]:
            if (arm, unit) != found[0][1:]:
                what = "arms" if arm != found[0][1] else "angle units"
                raise ValueError(
                    f"{found[0][0]} and {path} have different {what}, so the model cannot be "
                    f"exported: {found[0][1]!r} in {found[0][2]}, {arm!r} in {unit}."
                )
        return found[0][1:] if found else (None, None)

    @property
    def units(self):
        """Unit of the angles, and which joints (from 1) slide."""
        arm, unit = self.arm_and_unit
        joints = ", ".join(str(i + 1) for i in arm.slides)
        return f"{unit}, mm of joint {joints}, which slides" if joints else unit

    def described(self):
        """What each step is, in a few words for people."""
        return [_described(step) for _, step in self.steps]

    def typical_rows(self, n, seed=0):
        """Rows (n, n_inputs) that the model may see: angles, or features like those of the fit."""
        rng = np.random.default_rng(seed)
        arm, unit = self.arm_and_unit
        if arm is not None and self.n_inputs >= arm.n_joints:
            turns = arm.random_poses(n, rng)
            extra = [rng.choice(known, n) for _, known in self.extra]
            return np.column_stack([arm.in_unit(turns, unit), *extra])
        rows = rng.normal(size=(n, self.n_inputs))
        for _, step in self.steps:
            if isinstance(step, StandardScaler):
                of_scaler = slice(step.n_features_in_)
                rows[:, of_scaler] = step.inverse_transform(rows[:, of_scaler])
                break
            if isinstance(step, RBFNetRegressor) and len(step.centers_):
                centers = step.centers_
                inside = centers[rng.integers(0, len(centers), (2, n))].mean(axis=0)
                rows[:, : inside.shape[1]] = inside
            if isinstance(step, CylindricalResidualTarget) and step._drops_direction:
                turns = rng.uniform(-np.pi, np.pi, n)
                rows[:, -2:] = np.column_stack([np.cos(turns), np.sin(turns)])
        return rows


def _leaves(model, path):
    """Path and estimator of each step; `path` is that of the model."""
    if isinstance(model, Pipeline):
        for name, step in model.steps:
            if step is not None and not (isinstance(step, str) and step == "passthrough"):
                yield from _leaves(step, name if path == "Pipeline" else f"{path}.{name}")
        return
    yield path, model
    if isinstance(model, CylindricalResidualTarget) and hasattr(model, "regressor_"):
        yield from _leaves(model.regressor_, f"{path}.regressor")


def _described(step):
    name = type(step).__name__
    if isinstance(step, RBFNetRegressor):
        texts = [
            f"{getattr(part.kernel, '__name__', part.kernel)}, {len(part.centers)} centres"
            for part in step.networks_
        ]
        if len(texts) > 1:
            named = (", ".join(map(str, part.outputs)) for part in step.networks_)
            texts = [f"outputs {of}: {text}" for of, text in zip(named, texts, strict=True)]
        return f"{name}: {'; '.join(texts)}"
    if isinstance(step, PoseFeatures):
        return f"{name}: {', '.join(step.get_feature_names_out())}"
    if isinstance(step, ArmResidualRegressor):
        return f"{name}: {len(step.linear_model_.coef)} terms"
    return name
