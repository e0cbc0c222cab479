"""C99 source of what has a loop of its own, with places in braces for names and sizes."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from math import factorial

import numpy as np

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
# From the squared scaled distance s in v[c] to the radial function, a loop over all centres for
# each line: only loops without branches and calls are computed for several centres at once.
# {f} is the suffix of the precision, {most} where falling_exp ends.
_BOUND = "{v}[c] = {v}[c] > {most} ? {most} : {v}[c];"
KERNEL_LOOPS = {
    "gaussian": ["{v}[c] *= 0.5{f};", _BOUND, "{v}[c] = falling_exp(-{v}[c]);"],
    "matern32": [
        "{v}[c] = {sqrt3} * sqrt{f}({v}[c]);",
        _BOUND,
        "{v}[c] = (1 + {v}[c]) * falling_exp(-{v}[c]);",
    ],
    "matern52": [
        "{v}[c] = {sqrt5} * sqrt{f}({v}[c]);",
        _BOUND,
        "{v}[c] = (1 + {v}[c] + {v}[c] * {v}[c] / 3) * falling_exp(-{v}[c]);",
    ],
}
_FALLING_EXP = """
/* exp(x) for {least} <= x <= 0, to {error} of itself: libm's cannot be computed for several x at
   once. x = n log 2 + r; the power series of exp(r); 2^n by its bits. */
#if FLT_EVAL_METHOD == 0 && FLT_RADIX == 2 && {digits_macro} == {digits}
static inline {real} falling_exp({real} x)
{{
    /* The sum is rounded to a whole number, which its last bits then are. */
    const {real} shifted = x * {log2e} + {shifter};
    const {real} n = shifted - {shifter};
    const {real} r = (x - n * {high}) - n * {low};
    {real} p = {last};
{series}
    uint{bits}_t power;
    {real} scale;
    memcpy(&power, &shifted, sizeof power);
    power = (power + {bias}) << {shift};
    memcpy(&scale, &power, sizeof scale);
    return p * scale;
}}
#else
static inline {real} falling_exp({real} x)
{{
    return exp{f}(x);
}}
#endif
"""
# high + low = log 2; high has so few digits that its product with n is exact (W. J. Cody, W. Waite,
# "Software manual for the elementary functions", 1980). The first term left out of the series is
# 4e-18 and 5e-9 of the sum. The tests measure the error against decimals of 40 digits.
_FACTS = {
    "least": (-708.0, -87.0),  # the smallest normal number is exp(-708.4)
    "error": ("3e-16", "2e-7"),
    "digits_macro": ("DBL_MANT_DIG", "FLT_MANT_DIG"),
    "digits": (53, 24),
    "bits": (64, 32),
    "shifter": (1.5 * 2.0**52, 1.5 * 2.0**23),
    "high": (6.93147180369123816490e-01, 0.693359375),
    "low": (1.90821492927058770002e-10, -2.12194440e-4),
    "degree": (13, 7),
    "bias": (1023, 127),
    "shift": (52, 23),
}
EXP = {real: {k: v[i] for k, v in _FACTS.items()} for i, real in enumerate(("double", "float"))}


def exponential(tables):
    """``falling_exp(x)`` in C."""
    facts = dict(EXP[tables.real])
    degree = facts.pop("degree")
    factors = [tables.literal(1 / factorial(i)) for i in range(degree + 1)]
    for name in ("least", "shifter", "high", "low"):
        facts[name] = tables.literal(facts[name])
    return _FALLING_EXP.format(
        real=tables.real,
        f=tables.suffix,
        log2e=tables.literal(1 / np.log(2)),
        last=factors[-1],
        series="\n".join(f"    p = p * r + {factor};" for factor in factors[-2::-1]),
        **facts,
    )
