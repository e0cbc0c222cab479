"""A model as one list of simple operations on arrays: C and ONNX are written from it.

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

from sklearn_raacmm.utils import chunks

# Numbers that a value of many rows may hold at a time while a program runs.
_CHUNK = 2**20


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
                found_here = OPERATIONS[op.name].compute(op.given, *inputs)
                values[number] = np.broadcast_to(found_here, (len(X[rows]), op.size))
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
        raise ValueError(f"{name!r:.60} is no operation: only {', '.join(OPERATIONS)} are")
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


# They are written for arrays of NumPy and for what `_onnx` makes of them: arithmetic, `where`,
# `concatenate`, `reshape`, `sum` and columns by their numbers.


def _dots(given, rows, x):
    """Dot products of every run of a row's numbers with x."""
    n = x.shape[1]
    if rows.shape[1] == n:
        return (rows * x).sum(axis=1, keepdims=True)
    return (rows.reshape(-1, rows.shape[1] // n, n) * x.reshape(-1, 1, n)).sum(axis=2)


def _finite(given, y, x):
    return y + (0.0 * x).sum(axis=1, keepdims=True)


def _within(given, y, x):
    inside = (x >= given["low"]) & (x <= given["high"])
    return y + np.where(inside, 0.0, np.nan).sum(axis=1, keepdims=True)


def _frames(given, theta):
    """x, y and z axis and origin of the base and of every frame: Denavit and Hartenberg's table."""
    cosines, sines, rest = _steps(**given)
    k = len(rest)
    if k != theta.shape[1]:
        raise ValueError(f"{k} rows of a table for {theta.shape[1]} angles")
    theta = theta.reshape(-1, k, 1, 1)
    steps = (np.cos(theta) * cosines + np.sin(theta) * sines + rest).reshape(-1, 16 * k)
    pose, found = None, [0.0 * steps[:, np.arange(16)] + np.eye(4).ravel()]
    for i in range(k):
        step = steps[:, 16 * i + np.arange(16)].reshape(-1, 4, 4)
        pose = step if pose is None else pose @ step
        found.append(pose.reshape(-1, 16))
    axes = np.arange(12).reshape(3, 4).T.ravel()  # the columns of a matrix of 4 by 4
    return np.concatenate(found, axis=1)[:, np.add.outer(16 * np.arange(k + 1), axes).ravel()]


def _steps(table, convention):
    """From each frame to the next: factors of the angles' cosines and sines, and the rest."""
    turn = np.zeros((3, 4, 4))
    turn[0, 0, 0] = turn[0, 1, 1] = turn[1, 1, 0] = turn[2, 2, 2] = turn[2, 3, 3] = 1.0
    turn[1, 0, 1] = -1.0
    twist, along = (np.tile(np.eye(4), (len(table), 1, 1)) for _ in range(2))
    c, s, twist[:, 0, 3], along[:, 2, 3] = table.T
    twist[:, 1:3, 1:3] = np.stack([c, -s, s, c], axis=1).reshape(-1, 2, 2)
    turn = turn[:, None]
    return turn @ along @ twist if convention == "standard" else twist @ turn @ along


def _waves(given, angles):
    """Cosine of a multiple of an angle, sine where the order is negative, 1 where it is 0."""
    joint, order = given["joint"], given["order"]
    (of, multiple), place = np.unique([joint, np.abs(order)], axis=1, return_inverse=True)
    phase = angles[:, of] * multiple.astype(float)
    both = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
    return both[:, place.ravel() + len(of) * (order < 0)]


_RADIAL = {
    "gaussian": lambda s: np.exp(-0.5 * s),
    "matern32": lambda s: (1.0 + np.sqrt(3.0 * s)) * np.exp(-np.sqrt(3.0 * s)),
    "matern52": lambda s: (1.0 + np.sqrt(5.0 * s) + 5 / 3 * s) * np.exp(-np.sqrt(5.0 * s)),
    "rational_quadratic": lambda s: 1.0 / (1.0 + 0.5 * s),
    "inverse_multiquadric": lambda s: 1.0 / np.sqrt(1.0 + s),
}


def _radial(given, x):
    """Radial functions of the distances from centres, in units of widths.

    The rows of `centers` are scaled already; x is not: shift and inverse widths do that.
    """
    z, centers = (x - given["shift"]) * given["inverse_width"], given["centers"]
    # |z|^2 + |c|^2 - 2 z.c, as predict has it.
    s = z @ (-2.0 * centers.T) + np.square(centers).sum(axis=1)
    s = np.maximum(s + (z * z).sum(axis=1, keepdims=True), 0.0)
    return _RADIAL[given["kernel"]](s)


def _variances(given, vectors, sizes):
    """Squared lengths of ``root' columns``, for x, y and z.

    Column c is its size times one of the vectors. Those of x come first: (3, number of vectors).
    """
    vector, n = given["vector"], vectors.shape[1] // 3
    columns = vectors[:, np.add.outer(n * np.arange(3), vector).ravel()].reshape(-1, 3, len(vector))
    dots = (columns * sizes.reshape(-1, 1, len(vector))) @ given["root"]
    return (dots * dots).sum(axis=2)


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
    "less": _of(lambda a, b: np.where(a < b, 1.0, 0.0)),
    "sqrt": _of(np.sqrt),
    "sin": _of(np.sin),
    "cos": _of(np.cos),
    # Of a point in the right half plane: its height, then its distance from the axis.
    "elevation": _of(np.arctan2),
    "take": Operation(("index",), lambda given, x: x[:, given["index"]]),
    "join": _of(lambda *values: np.concatenate(values, axis=1)),
    "dots": Operation((), _dots),
    "affine": Operation(("matrix", "shift"), lambda g, x: x @ g["matrix"].T + g["shift"]),
    "finite": Operation((), _finite),
    "within": Operation(("low", "high"), _within),
    "frames": Operation(("table", "convention"), _frames),
    "waves": Operation(("joint", "order"), _waves),
    "radial": Operation(("kernel", "centers", "shift", "inverse_width"), _radial),
    "variances": Operation(("vector", "root"), _variances),
}
