"""The C99 source of the arm's own error model: its columns as tables, and the sum of the stages."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.error_model import column_table
from sklearn_raacmm.export._c_text import whole_table

_COLUMNS = """\
/* What one unit of each coefficient does to the probe, mm. */
static void error_columns(const struct arm_state *arm, {real} column[{m}][3])
{{
    {real} lever[{n1}][3][3];
    for (int i = 0; i < {n1}; ++i) {{
        {real} r[3];
        for (int k = 0; k < 3; ++k)
            r[k] = arm->probe[k] - arm->frame[i][3][k];
        for (int j = 0; j < 3; ++j) {{
            const {real} *u = arm->frame[i][j];
            lever[i][j][0] = u[1] * r[2] - u[2] * r[1];
            lever[i][j][1] = u[2] * r[0] - u[0] * r[2];
            lever[i][j][2] = u[0] * r[1] - u[1] * r[0];
        }}
    }}
    for (int c = 0; c < {m}; ++c) {{
        const int i = column_frame[c], j = column_axis[c], of = column_of[c];
        const int order = column_order[c];
        const {real} *u = arm->frame[i][j];
        const {real} *vector = column_kind[c] == 1 ? u : lever[i][j];
        {real} size = column_unit[c];
        if (column_kind[c] == 2) {{ /* the torque of a load: gravity is along -z */
            const {real} *load = of > {n} ? arm->probe : arm->frame[of][3];
            size *= u[1] * (load[0] - arm->frame[i][3][0]) - u[0] * (load[1] - arm->frame[i][3][1]);
        }}
        if (order > 0)
            size *= cos{f}(({real})order * arm->angle[of]);
        if (order < 0)
            size *= sin{f}(({real})-order * arm->angle[of]);
        for (int k = 0; k < 3; ++k)
            column[c][k] = size * vector[k];
    }}
}}

static void error_model(const struct arm_state *arm, {real} y[3]{v})
{{
    {real} column[{m}][3];
    error_columns(arm, column);
    for (int k = 0; k < 3; ++k) {{
        y[k] = 0;
        for (int c = 0; c < {m}; ++c)
            y[k] += column[c][k] * column_coef[c];
    }}
{variance}}}
"""
_VARIANCE = """\
    if (v)
        for (int k = 0; k < 3; ++k) {{
            v[k] = 0;
            for (int i = 0; i < {r}; ++i) {{
                {real} dot = 0;
                for (int c = 0; c < {m}; ++c)
                    dot += column[c][k] * column_half[i][c];
                v[k] += dot * dot;
            }}
        }}
"""


def error_model(numbers, linear, std):
    """``error_model(arm, y, v)`` of a `LinearModel`; v, the variances, if `std`."""
    arm, real = linear.arm, numbers.real
    table = column_table(arm, linear.terms)
    m = len(table.kind)
    if not m:
        unused = "    (void)arm;\n" + "    if (v)\n        v[0] = v[1] = v[2] = 0;\n" * std
        return (
            f"static void error_model(const struct arm_state *arm, {real} y[3]"
            f"{f', {real} *v' if std else ''})\n{{\n{unused}    y[0] = y[1] = y[2] = 0;\n}}\n"
        )
    note = "0 a turn about the axis, 1 a shift along it, 2 a turn by the torque of a load about it"
    text = whole_table("column_kind", table.kind, note)
    text += whole_table("column_frame", table.frame)
    text += whole_table("column_axis", table.axis)
    text += whole_table("column_of", table.of, "joint of the wave, or load")
    note = "of the wave: cosine if positive, sine if negative"
    text += whole_table("column_order", table.order, note)
    text += numbers.table("column_unit", table.unit, "rad or mm per unit coefficient")
    text += numbers.table("column_coef", linear.coef)
    variance = ""
    if std:
        text += numbers.table(
            "column_half", linear.gauge_free_half.T, "root of the coefficients' covariance"
        )
        variance = _VARIANCE.format(real=real, m=m, r=linear.gauge_free_half.shape[1])
    n = arm.n_joints
    return (
        text
        + "\n"
        + _COLUMNS.format(
            real=real,
            f=numbers.suffix,
            m=m,
            n=n,
            n1=n + 1,
            v=f", {real} *v" if std else "",
            variance=variance,
        )
    )


def guarded_sum(numbers, step, std):
    """``guarded_sum(arm, y, v)`` of an `ArmResidualRegressor`: its stages, faded and capped."""
    real, f, literal = numbers.real, numbers.suffix, numbers.literal
    networked = step.use_ == "harmonics+network"
    harmonic = step.use_ != "none"
    doubted = std or step.fade_ > 0
    size = "arm->angle" if step.features == "all" else "x"
    features = step.n_features_in_ if step.features == "all" else 3
    v = ", v1" if doubted else ""
    lines = [f"{real} y1[3] = {{0, 0, 0}};"]
    if doubted:
        lines.append(f"{real} v1[3] = {{0, 0, 0}};")
    if networked and step.features != "all":
        lines.append(f"{real} x[{features}];")
    if networked:
        lines.append(f"{real} cs[2];")
    lines.append("y[0] = y[1] = y[2] = 0;")
    if std:
        lines += ["if (v)", "    v[0] = v[1] = v[2] = 0;"]
    stages = []
    if harmonic:
        stages.append([f"error_model(arm, y1{v});"])
    if networked:
        stage = ["azimuth_direction(arm, cs);"]
        if step.features != "all":
            stage.append("pose_features(arm, x);")
        stages.append([*stage, f"network({size}, y1{v});", f"to_cartesian(cs, y1{v});"])
    for stage in stages:
        lines += [*stage, f"add_faded(y1, {'v1, ' if doubted else ''}y);"]
        if std:
            lines += ["if (v)", "    for (int k = 0; k < 3; ++k)", "        v[k] += v1[k];"]
    if not stages:
        lines = ["(void)arm;", "y[0] = y[1] = y[2] = 0;"]
        lines += ["if (v)", "    v[0] = v[1] = v[2] = 0;"] if std else []
    if np.isfinite(step.cap_mm_) and stages:
        lines += [
            "{",
            f"    const {real} cap = {literal(step.cap_mm_)}; /* mm: no correction is longer */",
            f"    const {real} length = sqrt{f}(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);",
            "    if (length > cap)",
            "        for (int k = 0; k < 3; ++k)",
            "            y[k] *= cap / length;",
            "}",
        ]
    body = "\n".join(f"    {line}" for line in lines)
    faded = ""
    if stages:
        square = literal(step.residual_rms_mm_**2)
        fade = literal(step.fade_**2)
        tiny = literal(max(1e-300, np.finfo(numbers.literal_type).tiny))
        faded = (
            "/* Add a stage, shrunk by its variance against the size of the residuals, mm^2. */\n"
            f"static void add_faded(const {real} y1[3], {f'const {real} v1[3], ' * doubted}"
            f"{real} y[3])\n{{\n"
        )
        if doubted:
            faded += (
                f"    const {real} size = {square};\n"
                f"    const {real} sum = size + {fade} * (v1[0] + v1[1] + v1[2]);\n"
                f"    const {real} factor = size / (sum < {tiny} ? {tiny} : sum);\n"
                "    for (int k = 0; k < 3; ++k)\n        y[k] += y1[k] * factor;\n}\n\n"
            )
        else:
            faded += "    for (int k = 0; k < 3; ++k)\n        y[k] += y1[k];\n}\n\n"
    parameter = f", {real} *v" if std else ""
    return (
        f"{faded}static void guarded_sum(const struct arm_state *arm, {real} y[3]{parameter})"
        f"\n{{\n{body}\n}}\n"
    )
