"""A model as one list of simple operations on arrays: C, ONNX and JSON are written from it.

Every value is a row of numbers. The first is the input; each operation makes one more from values
before it and from constants of its own. `OPERATIONS` says what each does, for many rows at once;
the writers know these operations and no kind of model.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sklearn_raacmm.utils import chunks, show

# Numbers that a value of many rows may hold at a time while a program runs.
_CHUNK = 2**22


class Op(NamedTuple):
    """One operation: its name in `OPERATIONS`, values that go in, its constants, its size."""

    name: str
    inputs: tuple  # of int: numbers of values before it
    given: dict  # of ndarray or str
    size: int  # numbers in a row of its result


class Program(NamedTuple):
    """Operations in their order, which of their results are wanted, and plain facts."""

    ops: tuple  # of Op; the first is the input
    outputs: dict  # of int: y, and where they exist point, trust and std
    about: dict  # fit for JSON

    @property
    def n_inputs(self):
        return self.ops[0].size

    @property
    def n_outputs(self):
        return self.ops[self.outputs["y"]].size


class Value(int):
    """The number of a value of a program that is being built."""


class Builder:
    """Collects operations: ``p("add", a, b)`` is the sum. Numbers and arrays become constants.

    The same operation on the same values is there once.
    """

    def __init__(self, n_inputs):
        self.ops, self._known, self.x = [], {}, Value(0)
        self._add("input", (), {}, n_inputs)

    def __call__(self, name, *inputs, **given):
        inputs = tuple(v if isinstance(v, Value) else self.constant(v) for v in inputs)
        given = {key: v if isinstance(v, str) else np.asarray(v) for key, v in given.items()}
        key = (name, inputs, _bytes(given))
        if key not in self._known:
            found = self.append(name, inputs, given)
            if inputs and all(self.ops[i].name == "constant" for i in inputs):
                self.ops.pop()
                values = (np.atleast_2d(self.ops[i].given["value"]) for i in inputs)
                found = self.constant(OPERATIONS[name].compute(given, *values))
            self._known[key] = found
        return self._known[key]

    def append(self, name, inputs, given):
        """One more operation; ValueError if it is none, or its sizes do not agree."""
        for key, value in given.items():
            if not isinstance(value, str) and not np.isfinite(value).all():
                raise ValueError(
                    f"The model holds NaN or infinity, a number that is not finite, among the "
                    f"{key} of an operation {name!r}: it cannot be exported."
                )
        size = size_of(name, given, [self.ops[i].size for i in inputs])
        return self._add(name, inputs, given, size)

    def _add(self, name, inputs, given, size):
        self.ops.append(Op(name, inputs, given, size))
        return Value(len(self.ops) - 1)

    def constant(self, value):
        """A row of constants."""
        return self("constant", value=np.ravel(np.asarray(value, dtype=float)))

    def size(self, value):
        """How many numbers a row of a value has."""
        return self.ops[value].size

    def take(self, x, *index):
        """Some columns of a value, by their numbers."""
        return self("take", x, index=np.concatenate([np.atleast_1d(i) for i in index]))

    def length(self, x):
        """Euclidean length, one number."""
        return self("sqrt", self("dots", x, x))

    def program(self, outputs, about):
        return pruned(Program(tuple(self.ops), outputs, about), outputs)


def pruned(program, names):
    """The program of some outputs: only what these need, in the same order."""
    outputs = {name: program.outputs[name] for name in names if name in program.outputs}
    used, pending = {0}, list(outputs.values())
    while pending:
        number = int(pending.pop())
        if number not in used:
            used.add(number)
            pending += program.ops[number].inputs
    place = {old: new for new, old in enumerate(sorted(used))}
    ops = tuple(
        op._replace(inputs=tuple(place[i] for i in op.inputs))
        for number, op in enumerate(program.ops)
        if number in used
    )
    return Program(ops, {name: place[int(i)] for name, i in outputs.items()}, program.about)


def fingerprint_of(program):
    """SHA-256 of every operation and constant that the prediction is made of."""
    digest = hashlib.sha256()
    for op in pruned(program, ("y",)).ops:
        digest.update(repr((op.name, op.inputs, op.size, _bytes(op.given))).encode())
    return digest.hexdigest()


def _bytes(given):
    """Constants as what can be compared: text, or shape and bytes of whole and real numbers."""
    found = []
    for key in sorted(given):
        value = given[key]
        if not isinstance(value, str):
            kind = "<i8" if value.dtype.kind in "iu" else "<f8"
            value = (kind, value.shape, np.ascontiguousarray(value, dtype=kind).tobytes())
        found.append((key, value))
    return tuple(found)


def run(program, X):
    """Outputs of a program at the rows of X, as a dict of arrays (n, size)."""
    X = np.asarray(X, dtype=float)
    sizes = {name: program.ops[i].size for name, i in program.outputs.items()}
    found = {name: np.empty((len(X), size)) for name, size in sizes.items()}
    last = {i: number for number, op in enumerate(program.ops) for i in op.inputs}
    last.update(dict.fromkeys(program.outputs.values(), len(program.ops)))
    widest = max(op.size for op in program.ops)
    with np.errstate(all="ignore"):  # a row that is refused comes out as NaN
        for rows in chunks(len(X), max(_CHUNK // widest, 1)):
            values = {0: X[rows]}
            for number, op in enumerate(program.ops[1:], start=1):
                inputs = [values[i] for i in op.inputs]
                values[number] = OPERATIONS[op.name].compute(op.given, *inputs)
                for i in set(op.inputs):
                    if last[i] == number:
                        del values[i]
            for name, i in program.outputs.items():
                found[name][rows] = values[i]
    return found


def size_of(name, given, sizes):
    """Numbers in a row of an operation's result; ValueError if it is no operation that fits."""
    known = OPERATIONS.get(name) if isinstance(name, str) else None
    if known is None:
        raise ValueError(f"{show(name)} is no operation: only {', '.join(OPERATIONS)} are")
    if set(given) != set(known.constants):
        raise ValueError(
            f"operation {name!r} has the constants {', '.join(sorted(given)) or 'none'} in place "
            f"of {', '.join(sorted(known.constants)) or 'none'}"
        )
    try:
        with np.errstate(all="ignore"):
            result = known.compute(given, *(np.zeros((1, size)) for size in sizes))
    except (TypeError, ValueError, IndexError, KeyError) as error:
        shapes = [f"{key} {np.shape(value)}" for key, value in given.items()]
        raise ValueError(
            f"sizes do not agree in an operation {name!r} of values of {sizes} numbers"
            f"{' with ' + ', '.join(shapes) if shapes else ''}: {error}"
        ) from None
    return result.shape[1]


# -- what the operations are ----------------------------------------------------------------------


class Operation(NamedTuple):
    """Names of its constants, and what it does: constants and values (n, size) to (n, size)."""

    constants: tuple
    compute: Callable


def _joined(given, *values):
    n = max(map(len, values))
    return np.hstack([np.broadcast_to(v, (n, v.shape[1])) for v in values])


def _dots(given, rows, x):
    """Dot products of every run of a row's numbers with x."""
    return np.einsum("nij,nj->ni", rows.reshape(len(rows), -1, x.shape[1]), x)


def _finite(given, y, x):
    return np.where(np.isfinite(x).all(axis=1, keepdims=True), y, np.nan)


def _within(given, y, x):
    inside = (x >= given["low"]) & (x <= given["high"])
    return np.where(inside.all(axis=1, keepdims=True), y, np.nan)


def _frames(given, theta):
    """x, y and z axis and origin of the base and of every frame: Denavit and Hartenberg's table."""
    n, k = theta.shape
    frames = np.zeros((n, k + 1, 4, 3))
    frames[:, 0, :3] = np.eye(3)
    ca, sa, a, d = given["table"].T
    if len(ca) != k:
        raise ValueError(f"{len(ca)} rows of a table for {k} angles")
    for i in range(k):
        x, y, z, origin = np.moveaxis(frames[:, i], 1, 0)
        c, s = np.cos(theta[:, i, None]), np.sin(theta[:, i, None])
        if given["convention"] == "standard":
            x, y = c * x + s * y, c * y - s * x
            axes = x, ca[i] * y + sa[i] * z, ca[i] * z - sa[i] * y, origin + d[i] * z + a[i] * x
        else:
            y, z = ca[i] * y + sa[i] * z, ca[i] * z - sa[i] * y
            axes = c * x + s * y, c * y - s * x, z, origin + a[i] * x + d[i] * z
        frames[:, i + 1] = np.stack(axes, axis=1)
    return frames.reshape(n, -1)


def _waves(given, angles):
    """Cosine of a multiple of an angle, sine where the order is negative, 1 where it is 0."""
    order = given["order"]
    phase = angles[:, given["joint"]] * np.abs(order)
    return np.where(order < 0, np.sin(phase), np.cos(phase))


_RADIAL = {
    "gaussian": lambda s: np.exp(-0.5 * s),
    "matern32": lambda s: (1 + np.sqrt(3 * s)) * np.exp(-np.sqrt(3 * s)),
    "matern52": lambda s: (1 + np.sqrt(5 * s) + 5 / 3 * s) * np.exp(-np.sqrt(5 * s)),
    "rational_quadratic": lambda s: 1 / (1 + 0.5 * s),
    "inverse_multiquadric": lambda s: 1 / np.sqrt(1 + s),
}


def _radial(given, x):
    """Radial functions of the distances from centres, in units of widths.

    The rows of `centers` are scaled already; x is not: shift and inverse widths do that.
    """
    z, centers = (x - given["shift"]) * given["inverse_width"], given["centers"]
    s = np.zeros((len(z), len(centers)))
    for of_x, of_centers in zip(z.T, centers.T, strict=True):
        s += np.square(of_x[:, None] - of_centers)
    return _RADIAL[given["kernel"]](s)


def _variances(given, vectors, sizes):
    """Squared lengths of ``root' columns``, for x, y and z.

    Column c is its size times one of the vectors. Those of x come first: (3, number of vectors).
    """
    found = []
    for of_coordinate in np.split(vectors, 3, axis=1):
        columns = sizes * of_coordinate[:, given["vector"]]
        found.append(np.square(columns @ given["root"]).sum(axis=1))
    return np.stack(found, axis=1)


def _of(function):
    return Operation((), lambda given, *values: function(*values))


OPERATIONS = {
    "constant": Operation(("value",), lambda given: np.atleast_2d(given["value"])),
    "add": _of(np.add),
    "sub": _of(np.subtract),
    "mul": _of(np.multiply),
    "div": _of(np.divide),
    "max": _of(np.maximum),
    "min": _of(np.minimum),
    "less": _of(lambda a, b: (a < b).astype(float)),
    "sqrt": _of(np.sqrt),
    "sin": _of(np.sin),
    "cos": _of(np.cos),
    # Of a point in the right half plane: its height, then its distance from the axis.
    "elevation": _of(np.arctan2),
    "take": Operation(("index",), lambda given, x: x[:, given["index"]]),
    "join": Operation((), _joined),
    "dots": Operation((), _dots),
    "affine": Operation(("matrix", "shift"), lambda g, x: x @ g["matrix"].T + g["shift"]),
    "finite": Operation((), _finite),
    "within": Operation(("low", "high"), _within),
    "frames": Operation(("table", "convention"), _frames),
    "waves": Operation(("joint", "order"), _waves),
    "radial": Operation(("kernel", "centers", "shift", "inverse_width"), _radial),
    "variances": Operation(("vector", "root"), _variances),
}
