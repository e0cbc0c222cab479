"""The C99 source of the arm's own error model: its columns as tables, and the sum of the stages."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.error_model import column_table

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
            {real} dot[{r}] = {{0}};
            for (int c = 0; c < {m}; ++c)
                for (int i = 0; i < {r}; ++i)
                    dot[i] += column[c][k] * column_half[c][i];
            v[k] = 0;
            for (int i = 0; i < {r}; ++i)
                v[k] += dot[i] * dot[i];
        }}
"""
# Columns of zeros fill up whole vectors of the processor.
_VECTOR = 8


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
    text = numbers.integers("column_kind", table.kind, note)
    text += numbers.integers("column_frame", table.frame)
    text += numbers.integers("column_axis", table.axis)
    text += numbers.integers("column_of", table.of, "joint of the wave, or load")
    note = "of the wave: cosine if positive, sine if negative"
    text += numbers.integers("column_order", table.order, note)
    text += numbers.table("column_unit", table.unit, "rad or mm per unit coefficient")
    text += numbers.table("column_coef", linear.coef)
    variance = ""
    if std:
        half = linear.gauge_free_half
        half = np.pad(half, ((0, 0), (0, -half.shape[1] % _VECTOR)))
        text += numbers.table("column_half", half, "root of the coefficients' covariance")
        variance = _VARIANCE.format(real=real, m=m, r=half.shape[1])
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


_FADED = """\
/* Add a stage, shrunk by its variance against the size of the residuals, mm^2; returns the share of
   it that is left. */
static {real} add_faded(const {real} y1[3], const {real} v1[3], {real} known, {real} y[3])
{{
    const {real} size = {square}, doubt = v1[0] + v1[1] + v1[2] - known;
    const {real} sum = size + (doubt > 0 ? {fade} * doubt : 0);
    const {real} factor = {faded} ? size / (sum < {tiny} ? {tiny} : sum) : 1;
    for (int k = 0; k < 3; ++k)
        y[k] += y1[k] * factor;
    return factor;
}}

"""
_CAPPED = """\
    {{
        const {real} cap = {cap}; /* mm: no correction is longer */
        const {real} length = sqrt{f}(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
        if (length > cap)
            for (int k = 0; k < 3; ++k)
                y[k] *= cap / length;
    }}
"""


def guarded_sum(numbers, step, std):
    """``guarded_sum(arm, y, v)`` of one of the arm's estimators: its stages, faded and capped.

    It returns the smallest share of a stage that the fading leaves.
    """
    real, literal = numbers.real, numbers.literal
    head = f"static {real} guarded_sum(const struct arm_state *arm, {real} y[3]"
    head += f", {real} *v)" if std else ")"
    start = ["y[0] = y[1] = y[2] = 0;", *(["if (v)", "    v[0] = v[1] = v[2] = 0;"] * std)]
    use, fadings = getattr(step, "use_", "harmonics"), _fadings(step)
    cap = getattr(step, "cap_mm_", np.inf)
    if use == "none":
        lines = ["(void)arm;", *start, "return 1;"]
        return "\n".join([head, "{", *(f"    {line}" for line in lines), "}\n"])
    doubted = std or fadings[0].factor > 0
    declared = [f"{real} y1[3] = {{0, 0, 0}};"]
    declared += [f"{real} v1[3] = {{0, 0, 0}};", f"{real} trust = 1, factor;"] * doubted
    v = ", v1" if doubted else ""
    stages = [[f"error_model(arm, y1{v});"]]
    if use == "harmonics+network":
        declared += [f"{real} cs[2];", *([f"{real} x[3];"] if step.joints != "all" else [])]
        pose = ["pose_features(arm, x);"] if step.joints != "all" else []
        inputs = "x" if pose else "arm->angle"
        network = [f"network({inputs}, y1{v});", f"to_cartesian(cs, y1{v});"]
        stages.append(["azimuth_direction(arm, cs);", *pose, *network])
    trust = "trust = factor < trust ? factor : trust;"
    variance = f"        v[k] += {literal(step.linear_model_.std_scale**2)} * v1[k];"
    lines = [*declared, *start]
    for stage, fading in zip(stages, fadings, strict=False):
        add = [f"factor = add_faded(y1, v1, {literal(fading.known_mm**2)}, y);", trust]
        if not doubted:
            add = ["for (int k = 0; k < 3; ++k)", "    y[k] += y1[k];"]
        lines += [*stage, *add, *(["if (v)", "    for (int k = 0; k < 3; ++k)", variance] * std)]
    body = "".join(f"    {line}\n" for line in lines)
    if np.isfinite(cap):
        body += _CAPPED.format(real=real, f=numbers.suffix, cap=literal(cap))
    body += f"    return {'trust' if doubted else '1'};\n"
    faded = _FADED.format(
        real=real,
        square=literal(fadings[0].size_mm ** 2),
        fade=literal(fadings[0].factor ** 2),
        faded=int(fadings[0].factor > 0 and fadings[0].size_mm > 0),
        tiny=literal(max(1e-300, np.finfo(numbers.literal_type).tiny)),
    )
    return f"{faded * doubted}{head}\n{{\n{body}}}\n"


def _fadings(step):
    """How each stage of one of the arm's estimators fades; all have one size and one factor."""
    return step.fadings_ if hasattr(step, "fadings_") else [step.fading_]
