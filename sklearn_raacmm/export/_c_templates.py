"""C99 source of what has a loop of its own, with places in braces for names and sizes."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

HELPERS = {
    "max": """\
static inline {real} larger({real} a, {real} b)
{{
    return a < b ? b : a; /* NaN if a is */
}}
""",
    "min": """\
static inline {real} smaller({real} a, {real} b)
{{
    return a > b ? b : a;
}}
""",
    "less": """\
static inline {real} less({real} a, {real} b)
{{
    return a < b ? 1 : 0;
}}
""",
}
ALL_FINITE = """\
/* 0 for NaN and infinity, too. */
static int all_finite(const {real} *v, int n)
{{
    for (int i = 0; i < n; ++i)
        if (!(v[i] >= -{most} && v[i] <= {most}))
            return 0;
    return 1;
}}
"""
FRAMES = """\
for (int i = 0; i < 12; ++i)
    {v}[i] = i % 4 == 0 && i < 9 ? 1 : 0;
for (int i = 0; i < {n}; ++i) {{
    const {real} *dh = {table}[i], *from = {v} + 12 * i;
    const {real} c = cos{f}({theta}[i]), s = sin{f}({theta}[i]);
    {real} *to = {v} + 12 * i + 12;
    for (int k = 0; k < 3; ++k) {{
        const {real} x0 = from[k], y0 = from[3 + k], z0 = from[6 + k];
{turn}
    }}
}}
"""
TURNS = {
    "standard": """\
        const {real} x = c * x0 + s * y0, y = c * y0 - s * x0;
        to[k] = x;
        to[3 + k] = dh[0] * y + dh[1] * z0;
        to[6 + k] = dh[0] * z0 - dh[1] * y;
        to[9 + k] = from[9 + k] + dh[3] * z0 + dh[2] * x;""",
    "modified": """\
        const {real} y = dh[0] * y0 + dh[1] * z0, z = dh[0] * z0 - dh[1] * y0;
        to[k] = c * x0 + s * y;
        to[3 + k] = c * y - s * x0;
        to[6 + k] = z;
        to[9 + k] = from[9 + k] + dh[2] * x0 + dh[3] * z;""",
}
# Columns that share a vector are summed first: that leaves one product of each entry, not three.
VARIANCES = """\
{{
    {real} dot[3][{r}] = {{{{0}}}};
    const {real} *row = {root};
    for (int c = 0; c < {m};) {{
        const int a = {vector}[c];
        {real} shared[{r}] = {{0}};
        int filled = 0;
        do {{
            {length}
            const {real} size = ({real}){sizes}[c];
            for (int i = 0; i < n; ++i)
                shared[i] += size * row[i];
            filled = n;
            row += n;
            ++c;
        }} while (c < {m} && {vector}[c] == a);
        for (int k = 0; k < 3; ++k) {{
            const {real} along = ({real}){vectors}[{axes} * k + a];
            for (int i = 0; i < filled; ++i)
                dot[k][i] += along * shared[i];
        }}
    }}
    for (int k = 0; k < 3; ++k) {{
        {real} sum = 0;
        for (int i = 0; i < {more}; ++i)
            sum += dot[k][i] * dot[k][i];{less}
        {v}[k] = sum;
    }}
}}
"""
LESS = """
        for (int i = {more}; i < {r}; ++i)
            sum -= dot[k][i] * dot[k][i];"""
# From the squared scaled distance in v[c] to the radial function. {f} is the suffix of the
# precision; beyond {most} the exponential is 0, and 0 times what overflows would be NaN.
_MATERN = """\
    const {real} d = {root} * sqrt{f}({v}[c]), r = d > {most} ? {most} : d;
"""
KERNELS = {
    "gaussian": "    {v}[c] = exp{f}(-0.5{f} * {v}[c]);",
    "matern32": _MATERN + "    {v}[c] = (1 + r) * exp{f}(-r);",
    "matern52": _MATERN + "    {v}[c] = (1 + r + r * r / 3) * exp{f}(-r);",
}
ROOTS = {"gaussian": 1, "matern32": 3, "matern52": 5}
# The smallest normal number is exp(-708.4) in double precision.
MOST = {"double": 708.0, "float": 87.0}
