"""A model in JSON, computed by plain Python: what it takes to read one in any language."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# ruff: noqa: B905 - lengths are checked when a file is read; in other languages there is no `strict`

import math


def radial(kernel, s):
    """Radial function of a squared distance in units of the width."""
    if kernel == "gaussian":
        return math.exp(-s / 2)
    if kernel == "matern32":
        return (1 + math.sqrt(3 * s)) * math.exp(-math.sqrt(3 * s))
    if kernel == "matern52":
        return (1 + math.sqrt(5 * s) + 5 * s / 3) * math.exp(-math.sqrt(5 * s))
    return 1 / (1 + s / 2) if kernel == "rational_quadratic" else 1 / math.sqrt(1 + s)


def frames(theta, table, standard):
    """Axes and origin of the base and of every frame, 12 numbers each."""
    found = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    for angle, (ca, sa, a, d) in zip(theta, table):
        c, s, last, rows = math.cos(angle), math.sin(angle), found[-12:], []
        for x, y, z, o in zip(last[:3], last[3:6], last[6:9], last[9:]):
            if standard:
                x, y = c * x + s * y, c * y - s * x
                rows.append((x, ca * y + sa * z, ca * z - sa * y, o + d * z + a * x))
            else:
                y, z = ca * y + sa * z, ca * z - sa * y
                rows.append((c * x + s * y, c * y - s * x, z, o + a * x + d * z))
        found += [row[i] for i in range(4) for row in rows]
    return found


def variances(vectors, sizes, vector, root):
    """Squared lengths of root times columns, for x, y and z."""
    found, n = [], len(vectors) // 3
    for k in range(3):
        column = [size * vectors[n * k + a] for size, a in zip(sizes, vector)]
        dots = (sum(c * row[i] for c, row in zip(column, root)) for i in range(len(root[0])))
        found.append(sum(dot * dot for dot in dots))
    return found


NUMBERS = {
    "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b, "max": max, "min": min, "less": lambda a, b: float(a < b),
    "sqrt": math.sqrt, "sin": math.sin, "cos": math.cos,
    "elevation": math.atan2,
}  # fmt: skip


def compute(name, given, values):
    """The result of one operation, as a list of numbers; ValueError where it is not defined."""
    first, last = (values[0], values[-1]) if values else ((), ())
    if name in NUMBERS:
        n = max(map(len, values))
        return [NUMBERS[name](*row) for row in zip(*(v * n if len(v) == 1 else v for v in values))]
    if name == "constant":
        return given["value"]
    if name == "take":
        return [first[i] for i in given["index"]]
    if name == "join":
        return [x for value in values for x in value]
    if name == "dots":
        runs = range(0, len(first), len(last))
        return [sum(a * b for a, b in zip(first[i : i + len(last)], last)) for i in runs]
    if name == "affine":
        return [
            s + sum(a * b for a, b in zip(row, first))
            for row, s in zip(given["matrix"], given["shift"])
        ]
    if name in ("finite", "within"):
        low, high = (given["low"], given["high"]) if name == "within" else (-1e308, 1e308)
        if not all(low <= x <= high for x in last):
            raise ValueError("the model is not defined there")
        return first
    if name == "frames":
        return frames(first, given["table"], given["convention"] == "standard")
    if name == "waves":
        phases = [(abs(k) * first[j], k) for j, k in zip(given["joint"], given["order"])]
        return [math.sin(phase) if k < 0 else math.cos(phase) for phase, k in phases]
    if name == "radial":
        scaled = zip(first, given["shift"], given["inverse_width"])
        z = [(x - shift) * width for x, shift, width in scaled]
        squares = [sum((a - b) ** 2 for a, b in zip(z, c)) for c in given["centers"]]
        return [radial(given["kernel"], s) for s in squares]
    return variances(first, last, given["vector"], given["root"])


def run(model, row):
    """Outputs of a model, the content of its file, at one row of inputs, as a dict of lists."""
    arrays = model["arrays"]
    values: list = [list(row)]
    for name, inputs, given in model["operations"]:
        given = {k: v if isinstance(v, str) else arrays[v] for k, v in given.items()}
        values.append(compute(name, given, [values[i] for i in inputs]))
    return {name: values[i] for name, i in model["outputs"].items()}
