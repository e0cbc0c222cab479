"""The C99 source of a network: its radial functions, its sum and its variance."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from math import factorial

import numpy as np

from sklearn_raacmm.export._steps import n_outputs, posterior_spectrum
from sklearn_raacmm.network import kernel_matrix

# Centres that are computed together: a multiple of the numbers in a processor's vector.
_VECTOR = 8
# Share of a standard deviation that rounding may cost, a third of what is promised, measured at so
# many rows; units in the last place that are tried, the coarsest first.
_SHARE, _MEASURED_ROWS = 1e-3 / 3, 400
_STEPS = 10.0 ** np.arange(-4, -12, -0.25)
# From the squared scaled distance s in phi[c] to the radial function, a loop over all centres for
# each line: only loops without branches and calls are computed for several centres at once.
# {f} is the suffix of the precision, {most} where falling_exp ends.
_BOUND = "phi[c] = phi[c] > {most} ? {most} : phi[c];"
_KERNEL_LOOPS = {
    "gaussian": ["phi[c] *= 0.5{f};", _BOUND, "phi[c] = falling_exp(-phi[c]);"],
    "matern32": [
        "phi[c] = {sqrt3} * sqrt{f}(phi[c]);",
        _BOUND,
        "phi[c] = (1 + phi[c]) * falling_exp(-phi[c]);",
    ],
    "matern52": [
        "phi[c] = {sqrt5} * sqrt{f}(phi[c]);",
        _BOUND,
        "phi[c] = (1 + phi[c] + phi[c] * phi[c] / 3) * falling_exp(-phi[c]);",
    ],
    "rational_quadratic": ["phi[c] = 1 / (1 + 0.5{f} * phi[c]);"],
    "inverse_multiquadric": ["phi[c] = 1 / sqrt{f}(1 + phi[c]);"],
}


# Names at file level that every group of outputs has its own of.
_OWN_NAMES = (
    "network", "network_variance", "intercept", "linear_coef", "center_shift", "inverse_width",
    "center", "weight", "noise_variance", "signal_variance", "tail_map", "turn", "turn_unit",
    "shrunk", "tail_shift",
)  # fmt: skip
_OWN_NAME = re.compile(rf"\b({'|'.join(_OWN_NAMES)})(?=[\[(])")


def network(numbers, step, std, with_noise=True, exact=False):
    """``network(x, y, v)`` of an `RBFNetRegressor`, and its number of outputs.

    v takes the variances; it is there with `std` only. They are good to 1e-3 of the standard
    deviation, or with `exact` to rounding: where a correction depends on them.
    """
    return _network(numbers, step, std, with_noise, exact)


def _network(numbers, step, std, with_noise, exact):
    """The same of the features as the network sees them."""
    groups, real, d, q = step.networks_, numbers.real, step.n_features_in_, n_outputs(step)
    if len(groups) == 1:
        return _group_network(numbers, groups[0], std, with_noise, exact)
    exp, text, lines = _exponential(numbers), "", []
    for number, part in enumerate(groups, start=1):
        of = part.outputs
        own = _group_network(numbers, part, std, with_noise, exact)[0]
        own = _OWN_NAME.sub(rf"\1_{number}", own)
        # All use the same exponential.
        text += (own.replace(exp, "") if exp in text else own) + "\n"
        m = len(of)
        lines += ["{", f"    {real} part[{m}];"]
        lines += [f"    {real} of_part[{m}];"] if std else []
        call = ", v ? of_part : 0" if std else ""
        lines.append(f"    network_{number}(x, part{call});")
        lines += [f"    y[{j}] = part[{i}];" for i, j in enumerate(of)]
        if std:
            lines += [
                "    if (v) {",
                *(f"        v[{j}] = of_part[{i}];" for i, j in enumerate(of)),
            ]
            lines.append("    }")
        lines.append("}")
    body = "\n".join(f"    {line}" for line in lines)
    return f"{text}\n{_head(real, d, q, std)}\n{{\n{body}\n}}\n", q


def _head(real, d, q, std):
    head = f"static void network(const {real} x[{d}], {real} y[{q}]"
    return head + (f", {real} *v)" if std else ")")


def _group_network(numbers, step, std, with_noise, exact):
    """The same of outputs that share centres."""
    real, d, q = numbers.real, len(step.length_scale), len(step.outputs)
    k = len(step.centers)
    full = _whole_vectors(k)
    text = numbers.table("intercept", step.polynomial[0])
    linear_coef = step.polynomial[1:].T
    lines = [f"{real} phi[{full}];"] if k else ["(void)x;"]
    lines += [f"for (int j = 0; j < {q}; ++j)", "    y[j] = intercept[j];"]
    if np.any(linear_coef):
        text += numbers.table("linear_coef", linear_coef)
        lines += [
            f"for (int j = 0; j < {q}; ++j)",
            f"    for (int i = 0; i < {d}; ++i)",
            "        y[j] += linear_coef[j][i] * x[i];",
        ]
    if k:
        tables, radial = _radial_functions(numbers, step, full)
        text += tables
        lines += [
            *radial,
            f"for (int j = 0; j < {q}; ++j) {{",
            f"    {real} sum[{_VECTOR}] = {{0}};",
            f"    for (int c = 0; c < {full}; c += {_VECTOR})",
            f"        for (int i = 0; i < {_VECTOR}; ++i)",
            "            sum[i] += weight[j][c + i] * phi[c + i];",
            f"    for (int i = 0; i < {_VECTOR}; ++i)",
            "        y[j] += sum[i];",
            "}",
        ]
    if std:
        text += "\n" + _network_variance(numbers, step, with_noise, exact)
        lines += ["if (v)", f"    network_variance(x, {'phi' if k else '0'}, v);"]
    body = "\n".join(f"    {line}" for line in lines)
    return f"{text}\n{_head(real, d, q, std)}\n{{\n{body}\n}}\n", q


def _whole_vectors(n):
    """The next multiple of `_VECTOR`: zeros fill up the rest, and compilers need no remainder."""
    return -(-n // _VECTOR) * _VECTOR


def _radial_functions(numbers, step, full):
    """Tables of the centres, and lines that compute phi of all of them."""
    d, centers = len(step.length_scale), step.centers
    fill = ((0, 0), (0, full - len(centers)))
    # Centred as predict does it: the rounding is the same.
    shift = centers.mean(axis=0)
    text = numbers.table("center_shift", shift, "middle of the centres")
    note = "1 / length scale; 0 for a feature that did not vary"
    text += numbers.table("inverse_width", 1 / step.length_scale, note)
    centers = ((centers - shift) / step.length_scale).T
    note = "one column a centre, less their middle, in units of the length scales"
    text += numbers.table("center", np.pad(centers, fill), note)
    weights = np.pad(step.coef.T, fill)
    text += numbers.table("weight", weights, "one column a centre")
    exp, loops = _kernel(numbers, step.kernel, full)
    lines = [
        f"for (int c = 0; c < {full}; ++c)",
        "    phi[c] = 0;",
        f"for (int i = 0; i < {d}; ++i) {{",
        f"    const {numbers.real} z = (x[i] - center_shift[i]) * inverse_width[i];",
        f"    for (int c = 0; c < {full}; ++c)",
        "        phi[c] += (z - center[i][c]) * (z - center[i][c]);",
        "}",
        *loops,
    ]
    return text + exp, lines


def _in_few_digits(step, turn, shift, tail, shrunk, with_noise):
    """`turn` as whole numbers times one factor a row, which cost the variances next to nothing.

    Neither can directions be left out (at 266 centres 5 % of them are 3 % of a standard deviation)
    nor are all digits needed. How many are, the centres themselves tell: training rows, where
    variances are smallest; and the middles between them. A row is rounded the finer, the larger it
    is there.

    Returns
    -------
    whole : ndarray of shape (r, k)
        Below 2^24: exact in single precision, in which the error was measured.
    factor : ndarray of shape (r, 1)
        None, None where single precision is not enough, as for data without noise.
    """
    rows = _rows_to_measure(step.centers)
    scaled = (rows / step.length_scale, step.centers / step.length_scale)
    phi = kernel_matrix(*scaled, step.kernel).T
    u = tail @ np.vstack([np.ones(len(rows)), rows.T])
    noise, signal = (np.reshape(v, (-1, 1)) for v in (step.noise_variance, step.signal_variance))

    def variances(g):
        h = np.square(g - shift @ u)
        outside = np.maximum(1 - np.square(g).sum(axis=0), 0.0)
        common = float(with_noise) + np.square(u).sum(axis=0)
        return signal * outside + noise * (common + shrunk @ h)

    exact = turn @ phi
    expected, size = variances(exact), np.sqrt(np.square(exact).mean(axis=1, keepdims=True))
    for step_size in _STEPS:
        factor = step_size / np.maximum(size, np.finfo(float).tiny)
        whole = np.round(turn / factor)
        if np.abs(whole).max() >= 2**24:
            break
        g = factor * (whole.astype(np.float32) @ phi.astype(np.float32))
        if np.all(np.abs(np.sqrt(variances(g)) - np.sqrt(expected)) <= _SHARE * np.sqrt(expected)):
            return whole, factor
    return None, None


def _rows_to_measure(centers):
    """Some of the centres, and points half way between two of them."""
    rows = [centers]
    for shift in range(1, -(-_MEASURED_ROWS // len(centers)) + 1):
        rows.append((centers + np.roll(centers, shift, axis=0)) / 2)
    rows = np.concatenate(rows)
    return rows[np.linspace(0, len(rows) - 1, _MEASURED_ROWS).astype(int)]


def _network_variance(numbers, step, with_noise, exact):
    """``network_variance(x, phi, v)``: the variance as `NetworkPosterior` computes it."""
    real, d, q = numbers.real, len(step.length_scale), len(step.outputs)
    k = len(step.centers)
    text = numbers.table("noise_variance", step.noise_variance)
    text += numbers.table("signal_variance", step.signal_variance)
    p = len(step.tail_map)
    turn, shift, tail, shrunk = posterior_spectrum(step)
    lines = [f"{real} outside = 1, common = {int(with_noise)};"]
    if p:
        text += numbers.table("tail_map", tail, "polynomial: constant, then one a feature")
        lines += [
            f"{real} tail[{p}];",
            f"for (int i = 0; i < {p}; ++i) {{",
            "    tail[i] = tail_map[i][0];",
            f"    for (int j = 0; j < {d}; ++j)",
            "        tail[i] += tail_map[i][1 + j] * x[j];",
            "    common += tail[i] * tail[i];",
            "}",
        ]
    else:
        lines.append("(void)x;")
    inner = []
    if k:
        few = (None, None) if exact else _in_few_digits(step, turn, shift, tail, shrunk, with_noise)
        tables, spectrum, inner = _spectral_sum(numbers, turn, shift, shrunk, *few)
        text += tables
        lines += spectrum
    else:
        lines.append("(void)phi;")
    lines += [
        f"for (int j = 0; j < {q}; ++j) {{",
        f"    {real} sum = common;",
        *inner,
        "    v[j] = outside * signal_variance[j] + noise_variance[j] * sum;",
        "}",
    ]
    body = "\n".join(f"    {line}" for line in lines)
    return (
        f"{text}\nstatic void network_variance(const {real} *x, const {real} *phi, {real} v[{q}])"
        f"\n{{\n{body}\n}}\n"
    )


def _spectral_sum(numbers, turn, shift, shrunk, whole, factor):
    """Tables of the posterior's directions, lines that compute g and h, and the sum over them."""
    real, (rank, p), n = numbers.real, shift.shape, _whole_vectors(len(turn))
    fill = ((0, 0), (0, n - rank))
    note = "one row a centre, one column a direction"
    if whole is None:
        text = numbers.table("turn", np.pad(turn.T, fill), note)
        of_float = real
    else:
        text = numbers.whole("turn", np.pad(whole.T, fill), f"{note}, whole numbers")
        text += numbers.table("turn_unit", np.pad(factor[:, 0], fill[1]), "of each direction")
        of_float = "float"
    text += numbers.table("shrunk", np.pad(shrunk, fill), "per direction and output")
    sums = "g" if whole is None else "sums"
    lines = [
        f"{of_float} {sums}[{n}] = {{0}};",
        # Centres that the kernel cannot tell apart have fewer directions than there are of them.
        f"for (int c = 0; c < {turn.shape[1]}; ++c)",
        f"    for (int i = 0; i < {n}; ++i)",
        f"        {sums}[i] += turn[c][i] * ({of_float})phi[c];",
    ]
    if whole is not None:
        lines += [
            f"{real} g[{n}];",
            f"for (int i = 0; i < {n}; ++i)",
            f"    g[i] = turn_unit[i] * ({real})sums[i];",
        ]
    lines += [
        f"for (int i = 0; i < {n}; ++i)",
        "    outside -= g[i] * g[i];",
        "if (outside < 0)",
        "    outside = 0;",
    ]
    if p:
        text += numbers.table("tail_shift", np.pad(shift.T, fill))
        lines += [
            f"for (int j = 0; j < {p}; ++j)",
            f"    for (int i = 0; i < {n}; ++i)",
            "        g[i] -= tail_shift[j][i] * tail[j];",
        ]
    inner = [f"    for (int i = 0; i < {n}; ++i)"]
    inner.append("        sum += shrunk[j][i] * (g[i] * g[i]);")
    return text, lines, inner


_FALLING_EXP = """
/* exp(x) for {least} <= x <= 0, to {error} of itself: libm's cannot be computed for several x at
   once. x = n log 2 + r; the power series of exp(r); 2^n by its bits. */
#if FLT_EVAL_METHOD == 0 && FLT_RADIX == 2 && {digits_macro} == {digits}
static {real} falling_exp({real} x)
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
static {real} falling_exp({real} x)
{{
    return exp{f}(x);
}}
#endif
"""
# high + low = log 2; high has so few digits that its product with n is exact (W. J. Cody, W. Waite,
# "Software manual for the elementary functions", 1980). The first term left out of the series is
# 4e-18 and 5e-9 of the sum. The tests measure the error against decimals of 40 digits.
_EXP = {
    "double": {
        "least": -708.0,  # the smallest normal number is exp(-708.4)
        "error": "3e-16",
        "digits_macro": "DBL_MANT_DIG",
        "digits": 53,
        "bits": 64,
        "shifter": 1.5 * 2.0**52,
        "high": 6.93147180369123816490e-01,
        "low": 1.90821492927058770002e-10,
        "degree": 13,
        "bias": 1023,
        "shift": 52,
    },
    "float": {
        "least": -87.0,
        "error": "2e-7",
        "digits_macro": "FLT_MANT_DIG",
        "digits": 24,
        "bits": 32,
        "shifter": 1.5 * 2.0**23,
        "high": 0.693359375,
        "low": -2.12194440e-4,
        "degree": 7,
        "bias": 127,
        "shift": 23,
    },
}


def _exponential(numbers):
    """``falling_exp(x)`` in C."""
    facts = dict(_EXP[numbers.real])
    degree = facts.pop("degree")
    factors = [numbers.literal(1 / factorial(i)) for i in range(degree + 1)]
    for name in ("least", "shifter", "high", "low"):
        facts[name] = numbers.literal(facts[name])
    return _FALLING_EXP.format(
        real=numbers.real,
        f=numbers.suffix,
        log2e=numbers.literal(1 / np.log(2)),
        last=factors[-1],
        series="\n".join(f"    p = p * r + {factor};" for factor in factors[-2::-1]),
        **facts,
    )


def _kernel(numbers, kernel, n):
    """Functions that a kernel needs, and its loops over n centres as lines."""
    lines = _KERNEL_LOOPS[kernel]
    most = numbers.literal(-_EXP[numbers.real]["least"])
    loops = [f"/* {kernel}, of the squared distance in units of the length scales */"]
    for line in lines:
        roots = {f"sqrt{i}": numbers.literal(np.sqrt(i)) for i in (3, 5)}
        body = line.format(f=numbers.suffix, most=most, **roots)
        loops += [f"for (int c = 0; c < {n}; ++c)", f"    {body}"]
    return _exponential(numbers) if any("falling_exp" in line for line in lines) else "", loops
