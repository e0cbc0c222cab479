"""The C99 source of the arm's own error model: its columns as tables, and the sum of the stages."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.error_model import LOAD, PUSH, SHIFT, column_table, given_factors
from sklearn_raacmm.export._c_text import plain
from sklearn_raacmm.export._steps import fadings_of, force_of

_COLUMNS = """\
/* Each column of the model is a vector, mm, that several share, times a size: what one unit of its
   coefficient does to the probe. */
static void error_columns(
    const struct arm_state *arm, {real} vector[{n_vectors}][3], {real} size[{m}])
{{
    for (int a = 0; a < {n_axes}; ++a) {{ /* turns about all axes, then shifts along them */
        const {real} *u = arm->frame[a / 3][a % 3];
        {real} r[3];
        for (int k = 0; k < 3; ++k)
            r[k] = arm->probe[k] - arm->frame[a / 3][3][k];
        vector[a][0] = u[1] * r[2] - u[2] * r[1];
        vector[a][1] = u[2] * r[0] - u[0] * r[2];
        vector[a][2] = u[0] * r[1] - u[1] * r[0];
        for (int k = 0; k < 3; ++k)
            vector[{n_axes} + a][k] = u[k];
    }}
    for (int c = 0; c < {m}; ++c) {{
        const int of = column_of[c], order = column_order[c];
        size[c] = column_unit[c];
        if (column_loaded[c] == 1) {{ /* the torque of a load: gravity is along -z */
            const {real}(*frame)[3] = arm->frame[column_vector[c] / 3];
            const {real} *u = frame[column_vector[c] % 3];
            const {real} *load = of > {n} ? arm->probe : arm->frame[of][3];
            size[c] *= u[1] * (load[0] - frame[3][0]) - u[0] * (load[1] - frame[3][1]);
        }}
        if (order > 0)
            size[c] *= cos{f}(({real})order * arm->angle[of]);
        if (order < 0)
            size[c] *= sin{f}(({real})-order * arm->angle[of]);
{extra}    }}
}}

static void error_model(const struct arm_state *arm, {real} y[3]{v})
{{
    {real} vector[{n_vectors}][3], size[{m}];
    error_columns(arm, vector, size);
    y[0] = y[1] = y[2] = 0;
    for (int c = 0; c < {m}; ++c)
        for (int k = 0; k < 3; ++k)
            y[k] += size[c] * column_coef[c] * vector[column_vector[c]][k];
{variance}}}
"""
# What the columns of X after the angles do.
_PUSH = """\
        if (column_loaded[c] == 2) {{ /* the torque of a force on the probe */
            {real} torque = 0;
            for (int e = 0; e < {n_extra}; ++e)
                for (int k = 0; k < 3; ++k)
                    torque += force[k][e] * vector[column_vector[c]][k]
                        * (arm->extra[e] - extra_mean[e]);
            size[c] *= torque;
        }}
"""
_GIVEN = """\
        if (column_by[c] >= 0) {{ /* 1 for one tool, 0 for others; or the difference to the mean */
            const {real} given = arm->extra[column_by[c]] - column_reference[c];
            const {real} known = given > 0 || given < 0 ? 0 : 1;
            size[c] *= column_of_tool[c] ? known : given;
        }}
"""
# Columns that share a vector are summed first: that leaves one product of each entry, not three.
_VARIANCE = """\
    if (v) {{
        {real} dot[3][{r}] = {{{{0}}}};
        const {of_root} *row = column_root;
        for (int c = 0; c < {m};) {{
            const {real} *u = vector[column_vector[c]];
            {of_root} shared[{r}] = {{0}};
            int n = 0; /* entries of a row, up to the diagonal and to the end of a vector */
            do {{
                n = c / {vector} * {vector} + {vector};
                n = n < {r} ? n : {r};
                for (int i = 0; i < n; ++i)
                    shared[i] += ({of_root})size[c] * row[i];
                row += n;
                ++c;
            }} while (c < {m} && column_vector[c] == column_vector[c - 1]);
            for (int k = 0; k < 3; ++k)
                for (int i = 0; i < n; ++i)
                    dot[k][i] += u[k] * ({real})shared[i];
        }}
        for (int k = 0; k < 3; ++k) {{
            v[k] = 0;
            for (int i = 0; i < {r}; ++i) {{
                const {real} sum = {unit}dot[k][i];
                v[k] += sum * sum;
            }}
        }}
    }}
"""


# Entries that are computed together: a multiple of those in a processor's vector. Where compilers
# know that the number of entries is one, they need no remainder: 15 -> 10 us for 177 columns.
_VECTOR = 8
# A root of so many entries, of about 450 columns, is written as whole numbers: 2 instead of 7 MB of
# text for the 821 columns of a UR10. Standard deviations were then good to 7e-6 at training poses,
# and to 3e-6 at random ones, where no more than the share may be lost; so many are tried.
_LARGE, _SHARE, _MEASURED_POSES = 200_000, 3e-5, 100


def error_model(numbers, linear, std):
    """``error_model(arm, y, v)`` of a `LinearModel`; v, the variances, if `std`."""
    arm, real = linear.arm, numbers.real
    table = column_table(arm, linear.terms)
    m, n_axes = len(table.kind), 3 * (arm.n_joints + 1)
    if not m:
        return _no_columns(real, std)
    vector = _vector_of(linear)
    order = np.argsort(vector, kind="stable")
    text = numbers.integers("column_vector", vector[order], "turns about axes, then shifts")
    loaded = np.select([table.kind == LOAD, table.kind == PUSH], [1, 2], 0)
    text += numbers.integers("column_loaded", loaded[order])
    text += numbers.integers("column_of", table.of[order], "joint of the wave, or load")
    note = "of the wave: cosine if positive, sine if negative"
    text += numbers.integers("column_order", table.order[order], note)
    text += numbers.table("column_unit", table.unit[order], "rad or mm per unit coefficient")
    text += numbers.table("column_coef", linear.coef[order])
    variance = ""
    if std:
        root = _root_of(linear, order)
        note = "root of the coefficients' covariance: a triangle, row by row"
        of_root = unit = ""
        if _is_coarse(linear, root, order):
            whole, factor = _as_whole_numbers(root)
            text += numbers.whole("column_root", _packed(whole), f"{note}, whole numbers")
            text += numbers.table("root_unit", factor, "of each column of it")
            of_root, unit = "float", "root_unit[i] * "
        else:
            text += numbers.table("column_root", _packed(root), note)
        variance = _VARIANCE.format(
            real=real, of_root=of_root or real, unit=unit, m=m, r=root.shape[1], vector=_VECTOR
        )
    tables, extra = _of_extra_columns(numbers, linear, order)
    return f"{text}{tables}\n" + _COLUMNS.format(
        real=real,
        extra=extra,
        f=numbers.suffix,
        m=m,
        n=arm.n_joints,
        n_axes=n_axes,
        n_vectors=2 * n_axes,
        v=f", {real} *v" if std else "",
        variance=variance,
    )


def _of_extra_columns(numbers, linear, order):
    """Tables of what the columns of X after the angles do, and the lines that do it."""
    names = linear.terms.extra
    if not names:
        return "", ""
    text = lines = ""
    if np.any(column_table(linear.arm, linear.terms).kind == PUSH):
        mean = np.array([reference[0] for _, reference in names])
        note = f"of {', '.join(plain(name) for name, _ in names)}"
        text += numbers.table("extra_mean", mean, note)
        text += numbers.table("force", force_of(names), "x, y and z of one of each, base frame")
        lines += _PUSH.format(real=numbers.real, n_extra=len(names))
    factors = given_factors(linear.arm, linear.terms)
    if len(factors.column):
        by, of_tool = np.full(len(order), -1), np.zeros(len(order), dtype=int)
        reference = np.zeros(len(order))
        by[factors.column], of_tool[factors.column] = factors.by, factors.of_tool
        reference[factors.column] = factors.reference
        text += numbers.integers("column_by", by[order], "which extra column; -1: none")
        text += numbers.integers("column_of_tool", of_tool[order])
        text += numbers.table("column_reference", reference[order], "mean, or number of the tool")
        lines += _GIVEN.format(real=numbers.real)
    return text, lines


def _no_columns(real, std):
    """``error_model(arm, y, v)`` of a model without terms."""
    unused = "    (void)arm;\n" + "    if (v)\n        v[0] = v[1] = v[2] = 0;\n" * std
    return (
        f"static void error_model(const struct arm_state *arm, {real} y[3]"
        f"{f', {real} *v' if std else ''})\n{{\n{unused}    y[0] = y[1] = y[2] = 0;\n}}\n"
    )


def in_few_digits(linear):
    """Whether standard deviations of a `LinearModel` are written in single precision."""
    order = np.argsort(_vector_of(linear), kind="stable")
    return _is_coarse(linear, _root_of(linear, order), order)


def _is_coarse(linear, root, order):
    """Whether a root is large, and whole numbers in its place cost no standard deviation much."""
    if np.size(root) < _LARGE:
        return False
    whole, factor = _as_whole_numbers(root)
    turns = np.random.default_rng(0).uniform(-np.pi, np.pi, (_MEASURED_POSES, linear.arm.n_joints))
    known = [reference[0] for _, reference in linear.terms.extra]
    poses = np.hstack([turns, np.tile(known, (_MEASURED_POSES, 1))])
    columns = linear.columns(poses)[:, :, order]
    dots = (columns.astype(np.float32) @ whole.astype(np.float32)) * factor
    exact, found = (np.square(d).sum(axis=2) for d in (columns @ root, dots))
    return bool(np.all(np.abs(np.sqrt(found) - np.sqrt(exact)) <= _SHARE * np.sqrt(exact)))


def _vector_of(linear):
    """Which vector each column of the model shares with others: turns about axes, then shifts."""
    table = column_table(linear.arm, linear.terms)
    shifts = np.where(table.kind == SHIFT, 3 * (linear.arm.n_joints + 1), 0)
    return shifts + 3 * table.frame + table.axis


def _root_of(linear, order):
    """Triangular root of the covariance, (m, r), filled up with zeros to whole vectors.

    Any root gives the same variances; a triangle has half the entries.
    """
    root = np.linalg.qr(linear.gauge_free_half[order].T, mode="r").T
    return np.pad(root, ((0, 0), (0, -root.shape[1] % _VECTOR)))


def _as_whole_numbers(root):
    """Whole numbers of 24 bits, and one factor per column of the root."""
    largest = np.maximum(np.abs(root).max(axis=0), np.finfo(np.float32).tiny)
    factor = largest / (2**24 - 1)
    return np.round(root / factor), factor


def _packed(root):
    """Rows of a triangle one after another, each up to the whole vector with the diagonal."""
    lengths = np.arange(len(root)) // _VECTOR * _VECTOR + _VECTOR
    return np.concatenate([row[:n] for row, n in zip(root, lengths, strict=True)])


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
    use, fadings = getattr(step, "use_", "harmonics"), fadings_of(step)
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
