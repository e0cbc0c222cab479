"""The C99 source of the arm's own error model: its columns as tables, and the sum of the stages.

Every column is of one of three kinds: a small turn about an axis of a frame, a small shift along
one, or a turn in proportion to the torque of a load about that axis.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.arm import dh_theta, frame_columns, probe_of, reach_mm
from sklearn_raacmm.error_model import ARCSEC, loads, term_columns, wobbles
from sklearn_raacmm.export._c_text import whole_table

_TURN, _SHIFT, _LOAD = range(3)


class Column(NamedTuple):
    """One column: mm per unit coefficient."""

    kind: int
    frame: int
    axis: int  # 0, 1, 2: x, y, z of the frame
    of: int  # joint of the wave from 0, or load: a frame's number, n_joints + 1 for the probe
    order: int  # of the wave: cosine if positive, sine if negative, none if 0
    unit: float


def columns_of(arm, terms):
    """Columns in the order of `_arm_terms.term_columns`."""
    n, reach = arm.n_joints, reach_mm(arm)
    standard = arm.convention == "standard"
    # The frames whose x and z axis row i of the table goes along.
    of_x, of_z = (1, 0) if standard else (0, 1)
    columns = []
    for joint, order in terms.harmonics.tolist():
        unit = arm.joint_signs[joint] * ARCSEC
        columns += [Column(_TURN, joint + of_z, 2, joint, k, unit) for k in (order, -order)]
    if terms.gravity:
        columns += [
            Column(_LOAD, frame, axis, load, 0, ARCSEC / reach)
            for frame, axis, load in loads(arm.n_joints)
        ]
    if terms.kinematics:
        length = ARCSEC * reach
        columns += [Column(_SHIFT, i + of_x, 0, 0, 0, length) for i in range(n)]
        columns += [Column(_TURN, i + of_x, 0, 0, 0, ARCSEC) for i in range(n)]
        columns += [Column(_SHIFT, i + of_z, 2, 0, 0, length) for i in range(n)]
        columns += [Column(_TURN, i + of_z, 2, 0, 0, ARCSEC) for i in range(n)]
        columns += [Column(_SHIFT, n, axis, 0, 0, length) for axis in range(3)]
        columns += [Column(_SHIFT, 0, axis, 0, 0, length) for axis in range(2)]
        columns += [Column(_TURN, 0, axis, 0, 0, ARCSEC) for axis in range(2)]
        columns += [Column(_TURN, i + of_x, 1, 0, 0, ARCSEC) for i in range(n)]
    if terms.wobble:
        columns += [
            Column(_TURN, joint + of_z, axis, joint, order if part == "cos" else -order, ARCSEC)
            for joint, axis, order, part in wobbles(arm.n_joints)
        ]
    _check(arm, terms, columns)
    return columns


def _check(arm, terms, columns):
    """Compare with the columns that `predict` has: whoever changes those is told here."""
    angles = np.random.default_rng(0).uniform(-3, 3, (3, arm.n_joints))
    expected = term_columns(arm, angles, terms)
    got = np.zeros((3, 3, len(columns)))
    frames = frame_columns(arm, dh_theta(arm, angles))
    probe = probe_of(arm, frames)
    for i, c in enumerate(columns):
        u, origin = frames[c.frame, c.axis], frames[c.frame, 3]
        value = u if c.kind == _SHIFT else np.cross(u, probe - origin, axis=0)
        if c.kind == _LOAD:
            r = (probe if c.of > arm.n_joints else frames[c.of, 3]) - origin
            value = value * (u[1] * r[0] - u[0] * r[1])
        if c.order:
            value = value * (np.cos if c.order > 0 else np.sin)(abs(c.order) * angles[:, c.of])
        got[:, :, i] = (c.unit * value).T
    same = got.shape == expected.shape
    if not same or not np.allclose(got, expected, rtol=0, atol=1e-12 * np.abs(expected).max()):
        raise RuntimeError("export_c does not know all columns of this JointHarmonicRegressor.")


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
    columns = columns_of(arm, linear.terms)
    m = len(columns)
    if not m:
        unused = "    (void)arm;\n" + "    if (v)\n        v[0] = v[1] = v[2] = 0;\n" * std
        return (
            f"static void error_model(const struct arm_state *arm, {real} y[3]"
            f"{f', {real} *v' if std else ''})\n{{\n{unused}    y[0] = y[1] = y[2] = 0;\n}}\n"
        )
    note = "0 a turn about the axis, 1 a shift along it, 2 a turn by the torque of a load about it"
    text = whole_table("column_kind", [c.kind for c in columns], note)
    text += whole_table("column_frame", [c.frame for c in columns])
    text += whole_table("column_axis", [c.axis for c in columns])
    text += whole_table("column_of", [c.of for c in columns], "joint of the wave, or load")
    text += whole_table(
        "column_order", [c.order for c in columns], "of the wave: cosine if positive, sine if < 0"
    )
    text += numbers.table("column_unit", [c.unit for c in columns], "rad or mm a unit")
    text += numbers.table("column_coef", linear.coef)
    variance = ""
    if std:
        text += numbers.table("column_half", linear.half.T, "root of the coefficients' covariance")
        variance = _VARIANCE.format(real=real, m=m, r=linear.half.shape[1])
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
