"""What a fitted chain computes, as C99: its tables and static functions, step by step."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
from typing import NamedTuple

import numpy as np

from sklearn_raacmm.correction import ArmResidualRegressor
from sklearn_raacmm.error_model import JointHarmonicRegressor
from sklearn_raacmm.export import _c_columns, _c_network, _c_steps
from sklearn_raacmm.export._c_text import Numbers
from sklearn_raacmm.export._steps import (
    KNOWN,
    LINEAR,
    SCALERS,
    STAGES,
    arm_of,
    check_fitted,
    described,
    extra_of,
    leaves,
)
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.residuals import CylindricalResidualTarget, PoseFeatures

# A pose is called faded where less than this share of a stage is left: its uncertainty is then
# larger than the residuals that it was fitted on.
_FADED_BELOW = 0.5


class Body(NamedTuple):
    """What a chain computes, without the names that its functions go by."""

    text: str  # tables and static functions, the last of which is evaluate()
    n_inputs: int
    n_outputs: int
    arm: object  # or None
    angle_unit: str
    extra: tuple  # names of inputs after the angles
    steps: tuple  # of text, for people
    table_bytes: int
    fades: bool

    @property
    def corrects(self):
        """Whether the outputs are a correction of the arm's point."""
        return self.arm is not None and self.n_outputs == 3


class _Writer:
    """Collects tables and functions, and the statements of evaluate(), step by step."""

    def __init__(self, model, numbers, std):
        self.numbers, self.std = numbers, std
        self.arm, self.angle_unit = arm_of(model)
        self.parts, self.statements, self.after, self.steps = [], [], [], []
        self.extra = ()
        self.n_inputs = int(next(leaves(model)).estimator.n_features_in_)
        self.size = self.x_size = self.n_inputs
        self.loaded = False  # whether x holds something by now
        self.n_scalers, self.n_outputs, self.fades = 0, None, False
        if self.arm is not None:
            self.extra = extra_of(model)
            self.parts.append(_c_steps.kinematics(numbers, self.arm, self.angle_unit, self.extra))
        self.parts.append(_c_steps.all_finite(numbers))
        for path, step in leaves(model):
            if self.n_outputs is not None:
                raise ValueError(f"{path} comes after the regressor, which cannot be exported.")
            self.add(path, step)
        if self.n_outputs is None:
            raise ValueError(f"The model has no regressor at its end: none of {KNOWN}.")
        self.statements += self.after

    def add(self, path, step):
        """One step: its text, and the statement that calls it."""
        if isinstance(step, PoseFeatures):
            if self.loaded:
                raise ValueError(
                    f"{path} comes after another transformer, which cannot be exported: "
                    "PoseFeatures has to see the joint angles."
                )
            text, names = _c_steps.pose_features(self.numbers, step)
            self.size = self.x_size = len(names)
            self._put(text, "pose_features(arm, x);", f"PoseFeatures: {', '.join(names)}")
            self.statements.append(f"valid = all_finite(x, {self.size}) && valid;")
            self.loaded = True
        elif isinstance(step, SCALERS):
            self._load()
            self.n_scalers += 1
            text = _c_steps.scaler(self.numbers, step, self.size, self.n_scalers)
            self._put(text, f"scaler_{self.n_scalers}(x);", type(step).__name__)
        elif isinstance(step, CylindricalResidualTarget):
            self._cylindrical(path, step)
        elif isinstance(step, RBFNetRegressor):
            self._load()
            text, self.n_outputs = _c_network.network(self.numbers, step, self.std)
            about = f"RBFNetRegressor: {described(step)}"
            self._put(text, f"network(x, y{self._v});", about)
        elif isinstance(step, LINEAR):
            if self.std:
                raise ValueError(
                    f"{path} is a {type(step).__name__}, which has no standard deviation: export "
                    "it with std=False."
                )
            self._load()
            text, self.n_outputs = _c_steps.linear(self.numbers, step, self.size)
            self._put(text, "linear(x, y);", type(step).__name__)
        elif isinstance(step, JointHarmonicRegressor | ArmResidualRegressor):
            self._of_angles(path, step)
        else:
            raise ValueError(
                f"{path} is a {type(step).__name__}, which cannot be exported: only {KNOWN} and "
                "pipelines of these can."
            )

    def _of_angles(self, path, step):
        if self.loaded:
            raise ValueError(
                f"{path} comes after another transformer, which cannot be exported: it has to see "
                "the joint angles."
            )
        self.n_outputs = 3
        for i, (name, known) in enumerate(step.linear_model_.terms.extra):
            if name == "tool":  # predict refuses others
                given = f"input[{step.arm_.n_joints + i}]"
                tools = " || ".join(f"{given} == {self.numbers.literal(tool)}" for tool in known)
                self.statements.append(f"valid = ({tools}) && valid;")
        if isinstance(step, JointHarmonicRegressor):
            self.fades = step.fading_.factor > 0
            doubted = self.std or self.fades
            self.parts.append(_c_columns.error_model(self.numbers, step.linear_model_, doubted))
            text = _c_columns.guarded_sum(self.numbers, step, self.std)
            result = "*trust =" if self.fades else "(void)"
            about = f"JointHarmonicRegressor: {len(step.coef_)} terms"
            self._put(text, f"{result} guarded_sum(arm, y{self._v});", about)
            return
        # How much a stage is trusted depends on its standard deviation.
        doubted = self.std or step.fade_ > 0
        stages = STAGES.index(step.use_)
        if stages > 0:
            self.parts.append(_c_columns.error_model(self.numbers, step.linear_model_, doubted))
        if stages > 1:
            if step.joints == "pose":
                pose = PoseFeatures(step.arm_).fit(np.zeros((1, step.arm_.n_joints)))
                self.parts.append(_c_steps.pose_features(self.numbers, pose)[0])
            self.parts.append(_c_steps.azimuth_direction(self.numbers))
            exact = step.fade_ > 0  # the correction itself depends on the standard deviation
            text, _ = _c_network.network(self.numbers, step.network_, doubted, False, exact)
            self.parts.append(text)
            self.parts.append(_c_steps.rotation(self.numbers, doubted))
        text = _c_columns.guarded_sum(self.numbers, step, self.std)
        self.fades = stages > 0 and step.fade_ > 0
        result = "*trust =" if self.fades else "(void)"
        call = f"{result} guarded_sum(arm, y{self._v});"
        self._put(text, call, f"ArmResidualRegressor: {step.use_}")
        # A pose without features has no correction at all.
        self.statements += [f"valid = all_finite(y, {self.n_outputs}) && valid;"]

    @property
    def _v(self):
        return ", v" if self.std else ""

    def _put(self, text, statement, about):
        self.parts.append(text)
        self.statements.append(statement)
        self.steps.append(about)

    def _load(self):
        if not self.loaded:
            self.statements += [f"for (int i = 0; i < {self.size}; ++i)", "    x[i] = input[i];"]
        self.loaded = True

    def _cylindrical(self, path, step):
        if self.after:
            raise ValueError(f"{path} is the second of its kind, which cannot be exported.")
        if step._drops_direction:
            self._load()
            self.size -= 2
            self.parts.append(_c_steps.given_direction(self.numbers))
            self.statements.append(f"valid = given_direction(x + {self.size}, cs) && valid;")
        elif step._rotates:
            if self.loaded:
                raise ValueError(
                    f"{path} takes its azimuth from the joint angles but comes after a "
                    "transformer, which cannot be exported."
                )
            self.parts.append(_c_steps.azimuth_direction(self.numbers))
            self.statements.append("azimuth_direction(arm, cs);")
        if step._rotates:
            self.parts.append(_c_steps.rotation(self.numbers, self.std))
            self.after.append(f"to_cartesian(cs, y{self._v});")
            self.steps.append("CylindricalResidualTarget: in the frame of the probe's azimuth")

    def evaluate(self):
        """The function that calls all others."""
        real, q = self.numbers.real, self.n_outputs
        arm = "struct arm_state *arm, " if self.arm is not None else ""
        lines = [f"{real} x[{self.x_size}];"] if self.loaded else []
        if any("cs" in statement for statement in self.statements):
            lines.append(f"{real} cs[2];")
        lines.append(f"int valid = all_finite(input, {self.n_inputs});")
        if self.arm is not None:
            lines.append("kinematics(input, arm);")
        lines += self.statements
        # Not each function asks for the standard deviation.
        no_std = ["        if (v)", f"            v[j] = ({real})NAN;"] if self.std else []
        lines += [
            "if (!valid)",
            f"    for (int j = 0; j < {q}; ++j) {{",
            f"        y[j] = ({real})NAN;",
            *no_std,
            "    }",
        ]
        status = "return valid ? 0 : 2;"
        if self.fades:
            lines += ["if (!valid)", f"    *trust = ({real})NAN;"]
            status = f"return !valid ? 2 : *trust < {self.numbers.literal(_FADED_BELOW)} ? 1 : 0;"
        lines.append(status)
        body = "\n".join(f"    {line}" for line in lines)
        return (
            "/* 0: fine, 1: faded, 2: not finite. */\n"
            f"static int evaluate(const {real} input[{self.n_inputs}], {arm}{real} y[{q}]"
            f"{', ' + real + ' *v' if self.std else ''}"
            f"{', ' + real + ' *trust' if self.fades else ''})\n"
            f"{{\n{body}\n}}\n"
        )


def body_of(model, dtype="double", std=False):
    """Everything that a chain computes, see `Body`; ValueError where it cannot be written."""
    check_fitted(model)
    numbers = Numbers(dtype)
    writer = _Writer(model, numbers, std)
    return Body(
        "\n".join([*writer.parts, writer.evaluate()]),
        writer.n_inputs,
        writer.n_outputs,
        writer.arm,
        writer.angle_unit,
        writer.extra,
        tuple(writer.steps),
        numbers.n_bytes,
        writer.fades,
    )


def fingerprint_of(model):
    """SHA-256 of what a chain computes: constants and operations, in double precision."""
    return hashlib.sha256(body_of(model).text.encode()).hexdigest()
