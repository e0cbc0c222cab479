"""The C99 source of each step of a model: constant tables and one function."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, RobustScaler

from sklearn_raacmm.arm import MIN_LENGTH_MM
from sklearn_raacmm.export._steps import n_outputs
from sklearn_raacmm.residuals import NORM_TOLERANCE

# The radial functions of the squared scaled distance s; {f} is the suffix of the precision.
_KERNEL_BODIES = {
    "gaussian": "return exp{f}(-0.5{f} * s);",
    "matern32": "const {real} d = {sqrt3} * sqrt{f}(s);\n    return (1 + d) * exp{f}(-d);",
    "matern52": (
        "const {real} d = {sqrt5} * sqrt{f}(s);\n    return (1 + d + 5 / 3.0{f} * s) * exp{f}(-d);"
    ),
    "rational_quadratic": "return 1 / (1 + 0.5{f} * s);",
    "inverse_multiquadric": "return 1 / sqrt{f}(1 + s);",
}

_KINEMATICS = """\
{tables}
/* Where the arm is: joint angles in rad; x, y and z axis and origin of every frame, and the
   centre of the probe, in the base frame, mm. */
struct arm_state {{
    {real} angle[{n}];
    {real} frame[{n1}][4][3];
    {real} probe[3];
}};

/* {convention} Denavit-Hartenberg parameters, frame by frame from the base. */
static void kinematics(const {real} joint_angles[{n}], struct arm_state *arm)
{{
    for (int i = 0; i < 4; ++i)
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


def kinematics(numbers, arm, angle_unit):
    """Tables of the arm, its state, and the function that fills it."""
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
    return _KINEMATICS.format(
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


def network(numbers, step, std, with_noise=True):
    """``network(x, y, v)`` of an `RBFNetRegressor`, and its number of outputs.

    v takes the variances; it is there with `std` only.
    """
    real, d, k, q = numbers.real, step.n_features_in_, len(step.centers_), n_outputs(step)
    text = numbers.table("intercept", np.atleast_1d(step.intercept_))
    linear_coef = np.atleast_2d(step.linear_coef_)
    lines = ["(void)x;"] if not k else [f"{real} z[{d}];", f"{real} phi[{k}];"]
    lines += [f"for (int j = 0; j < {q}; ++j)", "    y[j] = intercept[j];"]
    if np.any(linear_coef):
        text += numbers.table("linear_coef", linear_coef)
        lines += [
            f"for (int j = 0; j < {q}; ++j)",
            f"    for (int i = 0; i < {d}; ++i)",
            "        y[j] += linear_coef[j][i] * x[i];",
        ]
    if k:
        # Centred as predict does it: the rounding is the same.
        shift = step.centers_.mean(axis=0)
        text += numbers.table("center_shift", shift, "middle of the centres")
        text += numbers.table(
            "inverse_width",
            1 / step.length_scale_,
            "1 / length scale; 0 for a feature that did not vary",
        )
        text += numbers.table(
            "center",
            (step.centers_ - shift) / step.length_scale_,
            "centres, less their middle, in units of the length scales",
        )
        text += numbers.table("weight", np.atleast_2d(step.coef_).T, "one row a centre")
        text += _kernel(numbers, step.kernel_)
        lines += [
            f"for (int i = 0; i < {d}; ++i)",
            "    z[i] = (x[i] - center_shift[i]) * inverse_width[i];",
            f"for (int c = 0; c < {k}; ++c) {{",
            f"    {real} s = 0;",
            f"    for (int i = 0; i < {d}; ++i)",
            "        s += (z[i] - center[c][i]) * (z[i] - center[c][i]);",
            "    phi[c] = radial_function(s);",
            f"    for (int j = 0; j < {q}; ++j)",
            "        y[j] += weight[c][j] * phi[c];",
            "}",
        ]
    if std:
        text += "\n" + _network_variance(numbers, step, with_noise)
        lines += ["if (v)", f"    network_variance(x, {'phi' if k else '0'}, v);"]
    body = "\n".join(f"    {line}" for line in lines)
    head = f"static void network(const {real} x[{d}], {real} y[{q}]{_optional(real, std)})"
    return f"{text}\n{head}\n{{\n{body}\n}}\n", q


def _optional(real, std):
    return f", {real} *v" if std else ""


def _network_variance(numbers, step, with_noise):
    """``network_variance(x, phi, v)``: the arithmetic of ``RBFNetRegressor._variance``."""
    real, d, k, q = numbers.real, step.n_features_in_, len(step.centers_), n_outputs(step)
    shift = step.centers_.mean(axis=0) if k else 0.0
    inside, triangles = step._posterior((step.centers_ - shift) / step.length_scale_)
    tail, p = step._tail_map, len(step._tail_map)
    m = p + k
    distinct = list({id(R): R for R in triangles}.values())
    ids = [id(R) for R in distinct]
    of = [ids.index(id(R)) for R in triangles]
    text = numbers.table("noise_variance", np.atleast_1d(step.noise_variance_))
    text += numbers.table("signal_variance", np.atleast_1d(step.signal_variance_))
    lines = []
    if m:
        lines.append(f"{real} row[{m}];")
        text += numbers.integers("triangle_of", of, "which triangle each output has")
        packed = [R.T[np.tril_indices(m)] for R in distinct]
        text += numbers.table("triangle", np.stack(packed), "rows of the transposed triangles")
    lines.append(f"{real} outside = 1;")
    lines.append(f"{real} of_weights[{len(distinct)}];")
    if p:
        text += numbers.table("tail_map", tail, "polynomial: constant, then one a feature")
        lines += [
            f"for (int i = 0; i < {p}; ++i) {{",
            "    row[i] = tail_map[i][0];",
            f"    for (int j = 0; j < {d}; ++j)",
            "        row[i] += tail_map[i][1 + j] * x[j];",
            "}",
        ]
    else:
        lines.append("(void)x;")
    if k:
        lines += [f"for (int c = 0; c < {k}; ++c)", f"    row[{p} + c] = phi[c];"]
    else:
        lines.append("(void)phi;")
    if k:
        text += numbers.table("span", inside, "root of the inverse kernel matrix of the centres")
        lines += [
            f"for (int i = 0; i < {len(inside)}; ++i) {{",
            f"    {real} dot = 0;",
            f"    for (int c = 0; c < {k}; ++c)",
            "        dot += span[i][c] * phi[c];",
            "    outside -= dot * dot;",
            "}",
            "if (outside < 0)",
            "    outside = 0;",
        ]
    lines.append(f"for (int t = 0; t < {len(distinct)}; ++t) {{")
    lines.append(f"    of_weights[t] = {int(with_noise)};")
    if m:
        lines += [
            f"    {real} solved[{m}];",
            f"    const {real} *entry = triangle[t];",
            f"    for (int i = 0; i < {m}; ++i) {{",
            "        solved[i] = row[i];",
            "        for (int j = 0; j < i; ++j)",
            "            solved[i] -= *entry++ * solved[j];",
            "        solved[i] /= *entry++;",
            "        of_weights[t] += solved[i] * solved[i];",
            "    }",
        ]
    lines += ["}", f"for (int j = 0; j < {q}; ++j)"]
    which = "triangle_of[j]" if m else "0"
    lines.append(
        f"    v[j] = outside * signal_variance[j] + noise_variance[j] * of_weights[{which}];"
    )
    body = "\n".join(f"    {line}" for line in lines)
    return (
        f"{text}\nstatic void network_variance(const {real} *x, const {real} *phi, {real} v[{q}])"
        f"\n{{\n{body}\n}}\n"
    )


def _kernel(numbers, kernel):
    body = _KERNEL_BODIES[kernel].format(
        f=numbers.suffix,
        real=numbers.real,
        sqrt3=numbers.literal(np.sqrt(3)),
        sqrt5=numbers.literal(np.sqrt(5)),
    )
    return (
        f"\n/* {kernel}, of the squared distance in units of the length scales */\n"
        f"static {numbers.real} radial_function({numbers.real} s)\n{{\n    {body}\n}}\n"
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
        f"static void to_cartesian(const {real} cs[2], {real} y[3]{_optional(real, std)})\n{{\n"
        f"    const {real} radial = y[0], tangential = y[1];\n"
        "    y[0] = radial * cs[0] - tangential * cs[1];\n"
        "    y[1] = radial * cs[1] + tangential * cs[0];\n"
        f"{variances if std else ''}}}\n"
    )
