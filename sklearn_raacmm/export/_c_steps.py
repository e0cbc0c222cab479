"""The C99 source of each step of a model: constant tables and one function."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, RobustScaler

from sklearn_raacmm.arm import MIN_LENGTH_MM
from sklearn_raacmm.export._c_text import plain
from sklearn_raacmm.residuals import NORM_TOLERANCE

_KINEMATICS = """\
{tables}
/* Where the arm is: joint angles in rad; x, y and z axis and origin of every frame, and the
   centre of the probe, in the base frame, mm. */
struct arm_state {{
    {real} angle[{n}];
    {real} frame[{n1}][4][3];
    {real} probe[3];
{extra}}};

/* {convention} Denavit-Hartenberg parameters, frame by frame from the base. */
static void kinematics(const {real} joint_angles[{n_inputs}], struct arm_state *arm)
{{
{copied}    for (int i = 0; i < 4; ++i)
        for (int k = 0; k < 3; ++k)
            arm->frame[0][i][k] = i == k ? 1 : 0;
    for (int i = 0; i < {n}; ++i) {{
        const {real} angle = joint_angles[i]{to_rad};
        const {real} theta = angle * joint_sign[i] + theta_offset[i];
        const {real} c = cos{f}(theta), s = sin{f}(theta);
        arm->angle[i] = angle;
        for (int k = 0; k < 3; ++k) {{
            const {real} x0 = arm->frame[i][0][k];
            const {real} y0 = arm->frame[i][1][k];
            const {real} z0 = arm->frame[i][2][k];
            const {real} origin = arm->frame[i][3][k];
{turn}
        }}
    }}
    for (int k = 0; k < 3; ++k)
        arm->probe[k] = arm->frame[{n}][3][k] + (probe_vector[0] * arm->frame[{n}][0][k]
            + probe_vector[1] * arm->frame[{n}][1][k] + probe_vector[2] * arm->frame[{n}][2][k]);
}}
"""
_TURNS = {
    "standard": """\
            const {real} x = c * x0 + s * y0;
            const {real} y = c * y0 - s * x0;
            arm->frame[i + 1][0][k] = x;
            arm->frame[i + 1][1][k] = cos_alpha[i] * y + sin_alpha[i] * z0;
            arm->frame[i + 1][2][k] = cos_alpha[i] * z0 - sin_alpha[i] * y;
            arm->frame[i + 1][3][k] = origin + link_d[i] * z0 + link_a[i] * x;""",
    "modified": """\
            const {real} y = cos_alpha[i] * y0 + sin_alpha[i] * z0;
            const {real} z = cos_alpha[i] * z0 - sin_alpha[i] * y0;
            arm->frame[i + 1][0][k] = c * x0 + s * y;
            arm->frame[i + 1][1][k] = c * y - s * x0;
            arm->frame[i + 1][2][k] = z;
            arm->frame[i + 1][3][k] = origin + link_a[i] * x0 + link_d[i] * z;""",
}


def kinematics(numbers, arm, angle_unit, extra=()):
    """Tables of the arm, its state, and the function that fills it; `extra` are names of inputs."""
    tables = "".join(
        numbers.table(name, values, note)
        for name, values, note in (
            ("joint_sign", arm.joint_signs, ""),
            ("theta_offset", arm.theta_offset, "rad"),
            ("link_a", arm.a, "mm"),
            ("link_d", arm.d, "mm"),
            ("cos_alpha", np.cos(arm.alpha), ""),
            ("sin_alpha", np.sin(arm.alpha), ""),
            ("probe_vector", arm.probe, "mm, in the last frame"),
        )
    )
    to_rad = "" if angle_unit == "rad" else f" * {numbers.literal(np.pi / 180)}"
    n_extra, state, copied = len(extra), "", ""
    if extra:
        names = ", ".join(plain(name) for name in extra)
        state = f"    {numbers.real} extra[{n_extra}]; /* {names} */\n"
        copied = f"    for (int i = 0; i < {n_extra}; ++i)\n"
        copied += f"        arm->extra[i] = joint_angles[{arm.n_joints} + i];\n"
    return _KINEMATICS.format(
        n_inputs=arm.n_joints + n_extra,
        extra=state,
        copied=copied,
        real=numbers.real,
        f=numbers.suffix,
        n=arm.n_joints,
        n1=arm.n_joints + 1,
        tables=tables,
        convention=arm.convention.capitalize(),
        to_rad=to_rad,
        turn=_TURNS[arm.convention].format(real=numbers.real),
    )


def pose_features(numbers, step):
    """``pose_features(arm, x)`` and the names of the features."""
    arm, f = step.arm_, numbers.suffix
    lines = []
    if step.joints == "all":
        angles = [f"arm->angle[{i}]" for i in range(arm.n_joints)]
    else:
        shoulder, wrist = arm.pose_frames
        lines += [
            f"const {numbers.real} *shoulder = arm->frame[{shoulder}][3];",
            f"const {numbers.real} *wrist = arm->frame[{wrist}][3];",
            f"const {numbers.real} reach = "
            f"hypot{f}(wrist[0] - shoulder[0], wrist[1] - shoulder[1]);",
            f"const {numbers.real} height = wrist[2] - shoulder[2];",
            f"const {numbers.real} theta_dis = hypot{f}(reach, height) < "
            f"{numbers.literal(MIN_LENGTH_MM)} ? ({numbers.real})NAN : atan2{f}(height, reach);",
        ]
        angles = [f"arm->angle[{joint - 1}]" for joint in arm.pose_joints] + ["theta_dis"]
    if step.encoding == "periodic":
        angles = [f"{part}{f}({angle})" for angle in angles for part in ("cos", "sin")]
    if step.append_azimuth:
        lines += [
            f"const {numbers.real} radius = hypot{f}(arm->probe[0], arm->probe[1]);",
            f"const int on_axis = radius < {numbers.literal(MIN_LENGTH_MM)};",
        ]
        angles += [f"on_axis ? ({numbers.real})NAN : arm->probe[{i}] / radius" for i in (0, 1)]
    names = step._names()
    lines += [
        f"x[{i}] = {angle}; /* {name} */"
        for i, (angle, name) in enumerate(zip(angles, names, strict=True))
    ]
    body = "\n".join("    " + line for line in lines)
    text = (
        f"static void pose_features(const struct arm_state *arm, {numbers.real} x[{len(angles)}])"
        f"\n{{\n{body}\n}}\n"
    )
    return text, names


def scaler(numbers, step, size, tag):
    """``scaler_<tag>(x)``, in place."""
    shift, factor, offset, clip = None, None, None, None
    if isinstance(step, MinMaxScaler):
        factor, offset = step.scale_, step.min_
        clip = step.feature_range if step.clip else None
    elif isinstance(step, MaxAbsScaler):
        factor = None
    elif isinstance(step, RobustScaler):
        shift = step.center_
    else:
        shift = step.mean_ if step.with_mean else None
    divisor = None if isinstance(step, MinMaxScaler) else step.scale_
    if isinstance(step, MaxAbsScaler):
        clip = (-1, 1) if getattr(step, "clip", False) else None
    text, value = "", "x[i]"
    for values, name, operation in (
        (shift, "shift", "({} - {})"),
        (divisor, "scale", "{} / {}"),
        (factor, "factor", "{} * {}"),
        (offset, "offset", "{} + {}"),
    ):
        if values is not None:
            text += numbers.table(f"{name}_{tag}", values)
            value = operation.format(value, f"{name}_{tag}[i]")
    lines = [f"x[i] = {value};"]
    if clip:
        low, high = map(numbers.literal, clip)
        lines += [f"if (x[i] < {low}) x[i] = {low};", f"if (x[i] > {high}) x[i] = {high};"]
    body = "\n".join(f"        {line}" for line in lines)
    return text + (
        f"\nstatic void scaler_{tag}({numbers.real} x[{size}])\n{{\n"
        f"    for (int i = 0; i < {size}; ++i) {{\n{body}\n    }}\n}}\n"
    )


def linear(numbers, step, size):
    """``linear(x, y)`` of a linear model, and its number of outputs."""
    coef = np.atleast_2d(step.coef_)
    q = len(coef)
    intercept = np.broadcast_to(np.atleast_1d(step.intercept_), (q,))
    text = numbers.table("linear_coef", coef) + numbers.table("intercept", intercept)
    return (
        text
        + f"""
static void linear(const {numbers.real} x[{size}], {numbers.real} y[{q}])
{{
    for (int j = 0; j < {q}; ++j) {{
        y[j] = intercept[j];
        for (int i = 0; i < {size}; ++i)
            y[j] += linear_coef[j][i] * x[i];
    }}
}}
""",
        q,
    )


def azimuth_direction(numbers):
    """``azimuth_direction(arm, cs)``: cosine and sine of the probe's azimuth.

    On the axis that of azimuth 0, for which atan2(0, 0) is taken.
    """
    return (
        f"static void azimuth_direction(const struct arm_state *arm, {numbers.real} cs[2])\n{{\n"
        f"    const {numbers.real} radius = hypot{numbers.suffix}(arm->probe[0], arm->probe[1]);\n"
        "    cs[0] = radius > 0 ? arm->probe[0] / radius : 1;\n"
        "    cs[1] = radius > 0 ? arm->probe[1] / radius : 0;\n}\n"
    )


def given_direction(numbers):
    """``given_direction(x, cs)``: copies a direction and says whether its norm is 1."""
    return (
        f"static int given_direction(const {numbers.real} x[2], {numbers.real} cs[2])\n{{\n"
        "    cs[0] = x[0];\n    cs[1] = x[1];\n"
        f"    return fabs{numbers.suffix}(hypot{numbers.suffix}(x[0], x[1]) - 1) "
        f"<= {numbers.literal(NORM_TOLERANCE)};\n}}\n"
    )


def all_finite(numbers):
    """``all_finite(v, n)``."""
    return (
        f"static int all_finite(const {numbers.real} *v, int n)\n{{\n"
        "    for (int i = 0; i < n; ++i)\n        if (!isfinite(v[i]))\n            return 0;\n"
        "    return 1;\n}\n"
    )


def rotation(numbers, std):
    """``to_cartesian(cs, y, v)``: radial, tangential, axial to x, y, z in place; v if `std`."""
    real = numbers.real
    variances = (
        f"    if (v) {{\n        const {real} v0 = v[0], v1 = v[1];\n"
        "        v[0] = v0 * (cs[0] * cs[0]) + v1 * (cs[1] * cs[1]);\n"
        "        v[1] = v0 * (cs[1] * cs[1]) + v1 * (cs[0] * cs[0]);\n    }\n"
    )
    return (
        f"/* Radial, tangential and axial to x, y and z. */\n"
        f"static void to_cartesian(const {real} cs[2], {real} y[3]"
        f"{', ' + real + ' *v' if std else ''})\n{{\n"
        f"    const {real} radial = y[0], tangential = y[1];\n"
        "    y[0] = radial * cs[0] - tangential * cs[1];\n"
        "    y[1] = radial * cs[1] + tangential * cs[0];\n"
        f"{variances if std else ''}}}\n"
    )
