"""A fitted model taken apart into its steps: their names, their arm, rows that they may see."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

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

LINEAR = (LinearRegression, Ridge)
REGRESSORS = (RBFNetRegressor, ArmResidualRegressor, *LINEAR)
KNOWN = (PoseFeatures, StandardScaler, CylindricalResidualTarget, *REGRESSORS)


def leaves(model, path=None):
    """Path and estimator of each step in the order in which data pass; a wrapper comes first.

    The path is what a message calls the step; `path` is that of the model.
    """
    path = type(model).__name__ if path is None else path
    if isinstance(model, Pipeline):
        for name, step in model.steps:
            if step is not None and not (isinstance(step, str) and step == "passthrough"):
                yield from leaves(step, name if path == "Pipeline" else f"{path}.{name}")
        return
    yield path, model
    if isinstance(model, CylindricalResidualTarget) and hasattr(model, "regressor_"):
        yield from leaves(model.regressor_, f"{path}.regressor")


def check_fitted(model: object) -> None:
    """Refuse a class, or an estimator that is not fitted."""
    for _, step in leaves(model):
        check_is_fitted(step)


def find_arm(model) -> tuple[Any, Any]:
    """Arm and angle unit of a chain, (None, None) without one; ValueError if steps disagree."""
    found = []
    for path, step in leaves(model):
        if isinstance(step, CylindricalResidualTarget) and callable(step.azimuth):
            owner = getattr(step.azimuth, "__self__", None)
            if not isinstance(owner, Arm) or step.azimuth != owner.azimuth:
                raise ValueError(
                    f"{path} takes its azimuth from {step.azimuth!r}, which cannot be exported: "
                    "only the method of an Arm can, azimuth=arm.azimuth."
                )
            found.append((path, owner, "rad"))
        elif isinstance(arm := getattr(step, "arm_", None), Arm):
            found.append((path, arm, getattr(step, "angle_unit", "rad")))
    for path, arm, unit in found[1:]:
        if (arm, unit) != found[0][1:]:
            what = "arms" if arm != found[0][1] else "angle units"
            raise ValueError(
                f"{found[0][0]} and {path} have different {what}, so the model cannot be exported: "
                f"{found[0][1]!r} in {found[0][2]}, {arm!r} in {unit}."
            )
    return found[0][1:] if found else (None, None)


def extra_columns(model) -> Any:
    """Name and reference of each column after the angles, as `Terms` has them."""
    for _, step in leaves(model):
        if isinstance(step, ArmResidualRegressor):
            return step.linear_model_.terms.extra
    return ()


def described(step):
    """What a step is, in a few words for people."""
    name = type(step).__name__
    if isinstance(step, RBFNetRegressor):
        kernels = [getattr(part.kernel, "__name__", part.kernel) for part in step.networks_]
        sizes = [len(part.centers) for part in step.networks_]
        texts = [f"{kernel}, {n} centres" for kernel, n in zip(kernels, sizes, strict=True)]
        if len(texts) > 1:
            named = (", ".join(map(str, part.outputs)) for part in step.networks_)
            texts = [f"outputs {of}: {text}" for of, text in zip(named, texts, strict=True)]
        return f"{name}: {'; '.join(texts)}"
    if isinstance(step, PoseFeatures):
        return f"{name}: {', '.join(step.get_feature_names_out())}"
    if isinstance(step, ArmResidualRegressor):
        return f"{name}: {len(step.linear_model_.coef)} terms"
    return name


def but_slides(slides):
    """What follows the unit of angles where joints (from 0) slide."""
    joints = ", ".join(str(i + 1) for i in slides)
    return f", mm of joint {joints}, which slides" if joints else ""


def n_inputs(model):
    """Number of inputs of the first step."""
    return int(next(leaves(model))[1].n_features_in_)


def typical_rows(model, n, seed=0):
    """Rows (n, n_inputs) that a fitted model may see: angles, or features like those of the fit."""
    rng = np.random.default_rng(seed)
    arm, unit = find_arm(model)
    size = n_inputs(model)
    if arm is not None and size >= arm.n_joints:
        turns = arm.random_poses(n, rng)
        extra = [rng.choice(known, n) for _, known in extra_columns(model)]
        return np.column_stack([arm.in_unit(turns, unit), *extra])
    rows = rng.normal(size=(n, size))
    for _, step in leaves(model):
        if isinstance(step, StandardScaler):
            of_scaler = slice(step.n_features_in_)
            rows[:, of_scaler] = step.inverse_transform(rows[:, of_scaler])
            break
        if isinstance(step, RBFNetRegressor):
            centers = step.centers_
            if len(centers):
                inside = centers[rng.integers(0, len(centers), (2, n))].mean(axis=0)
                rows[:, : inside.shape[1]] = inside
        if isinstance(step, CylindricalResidualTarget) and step._drops_direction:
            turns = rng.uniform(-np.pi, np.pi, n)
            rows[:, -2:] = np.column_stack([np.cos(turns), np.sin(turns)])
    return rows
