"""A model as one list of simple operations on arrays: C and ONNX are written from it.

Every value is a row of numbers. The first is the input; each operation makes one more from values
before it and from constants of its own. `OPERATIONS` says what each does, for many rows at once;
the writers know these operations and no kind of model.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import cached_property, reduce
from numbers import Real
from operator import mul
from typing import Any, NamedTuple

import numpy as np

from sklearn_raacmm.utils import LARGEST, digest_of

# Columns of one vector, from which on they are taken together.
_MANY = 24


class Op(NamedTuple):
    """One operation: its name in `OPERATIONS`, values that go in, its constants, its size."""

    name: str
    inputs: tuple  # of int: numbers of values before it
    given: dict  # of ndarray or str
    size: int  # numbers in a row of its result


class Program:
    """Operations in their order: ``p("add", a, b)`` adds one, and so does ``a + b``.

    Numbers and arrays become constants. The same operation on the same values is there once.

    Attributes
    ----------
    ops : list of Op
        The first is the input.
    outputs : dict of int
        Numbers of y and, where they exist, of point, trust and std.
    chain : object
        The model's steps, for what is said of them.
    exact : Program or None
        The program that this one is nearly.
    """

    def __init__(self, n_inputs, chain: Any, exact: "Program | None" = None):
        self.ops, self.outputs = [Op("input", (), {}, n_inputs)], dict[str, int]()
        self.chain, self.exact, self._known = chain, exact, dict[Any, Any]()
        self.x = Value(self, 0)

    @property
    def n_inputs(self):
        return self.ops[0].size

    @property
    def n_outputs(self):
        return self.ops[self.outputs["y"]].size

    def __call__(self, name, *inputs, **given):
        inputs = tuple((v if isinstance(v, Value) else self.constant(v)).number for v in inputs)
        given = {key: v if isinstance(v, str) else np.asarray(v) for key, v in given.items()}
        key = (name, inputs, _bytes(given))
        if key in self._known:
            return self._known[key]
        for label, value in given.items():
            if not (isinstance(value, str) or np.isfinite(value).all()):
                raise ValueError(
                    f"The model holds NaN or infinity, a number that is not finite, among the "
                    f"{label} of an operation {name!r}: it cannot be exported."
                )
        compute, before = OPERATIONS[name], [self.ops[i] for i in inputs]
        if inputs and all(op.name == "constant" for op in before):
            values = (np.atleast_2d(op.given["value"]) for op in before)
            found = self.constant(compute(*values, **given))
        else:
            with np.errstate(all="ignore"):
                result = compute(*(np.zeros((1, op.size)) for op in before), **given)
            self.ops.append(Op(name, inputs, given, result.shape[1]))
            found = Value(self, len(self.ops) - 1)
        self._known[key] = found
        return found

    def constant(self, value):
        """A row of constants."""
        return self("constant", value=np.ravel(np.asarray(value, dtype=float)))

    def pruned(self, *names):
        """The program of some outputs: only what these need, in the same order."""
        outputs = {name: self.outputs[name] for name in names if name in self.outputs}
        used, pending = {0}, list(outputs.values())
        while pending:
            number = pending.pop()
            if number not in used:
                used.add(number)
                pending += self.ops[number].inputs
        place = {old: new for new, old in enumerate(sorted(used))}
        found = Program(self.n_inputs, self.chain, self.exact)
        found.ops = [
            self.ops[number]._replace(inputs=tuple(place[i] for i in self.ops[number].inputs))
            for number in place
        ]
        found.outputs = {name: place[i] for name, i in outputs.items()}
        return found

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of every operation and constant that the prediction is made of.

        A program that is nearly another has that one's.
        """
        if self.exact is not None:
            return self.exact.fingerprint
        ops = self.pruned("y").ops
        return digest_of("".join(repr((o.name, o.inputs, o.size, _bytes(o.given))) for o in ops))

    def run(self, X):
        """Outputs at the rows of X, as a dict of arrays (n, size)."""
        values = [np.asarray(X, dtype=float)]
        with np.errstate(all="ignore"):  # a row that is refused comes out as NaN
            for op in self.ops[1:]:
                result = OPERATIONS[op.name](*(values[i] for i in op.inputs), **op.given)
                values.append(np.broadcast_to(result, (len(X), op.size)))
        return {name: values[i] for name, i in self.outputs.items()}


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


class Value(np.lib.mixins.NDArrayOperatorsMixin):
    """A value of a program that is being built: arithmetic and NumPy's functions add operations."""

    __iter__: Any = None  # its numbers are taken by `value[index]`

    def __init__(self, program, number):
        self.program, self.number = program, number

    @property
    def size(self):
        """How many numbers a row of it has."""
        return self.program.ops[self.number].size

    def __array_ufunc__(self, ufunc, method, *inputs, **_):
        if ufunc is np.greater_equal:
            return 1.0 - np.less(*inputs)
        if ufunc in (np.negative, np.square):
            ufunc, inputs = np.multiply, (*inputs, -1.0 if ufunc is np.negative else inputs[0])
        if ufunc is np.power:
            return _power(*inputs)
        if ufunc not in _FUNCTIONS:
            raise _unknown(ufunc)
        return self.program(_FUNCTIONS[ufunc], *inputs)

    def __array_function__(self, function, types, args, kwargs):
        if function is not np.clip:
            raise _unknown(function)
        return np.minimum(np.maximum(*args[:2]), args[2])

    def __getitem__(self, index):
        return self.program("take", self, index=np.atleast_1d(index))

    def dots(self, x):
        """Dot products of every run of its numbers with those of x."""
        return self.program("dots", self, x)

    def affine(self, matrix, shift=None):
        """A matrix times it, and a shift."""
        shift = np.zeros(len(matrix)) if shift is None else shift
        return self.program("affine", self, matrix=matrix, shift=shift)

    def length(self):
        """Euclidean length, one number."""
        return np.sqrt(self.dots(self))

    def within(self, x, low, high):
        """Itself, or NaN where a number of x is outside these bounds."""
        return self.program("within", self, x, low=low, high=high)


def _power(x, exponent):
    """A value to a power that is a whole number or a half of one: products, and a root."""
    power = float(exponent) if isinstance(exponent, Real) else np.nan
    if power % 0.5:
        raise _unknown(np.power, " but to whole numbers and halves")
    whole, half = divmod(abs(power), 1)
    found = reduce(mul, [x] * int(whole) + [np.sqrt(x)] * (half > 0) or [1.0])
    return found if power >= 0 else 1.0 / found


def _unknown(function, but=""):
    known = ", ".join(f.__name__ for f in (*_FUNCTIONS, np.negative, np.square, np.clip))
    return ValueError(
        f"A kernel uses numpy.{function.__name__}, which cannot be written as C or ONNX{but}; "
        f"{known} can."
    )


# -- what the operations are ----------------------------------------------------------------------


# They are written for arrays of NumPy and for what `_onnx` makes of them: arithmetic, `where`,
# `concatenate`, `reshape`, `sum` and columns by their numbers.


def _dots(rows, x):
    """Dot products of every run of a row's numbers with x."""
    n = x.shape[1]
    if rows.shape[1] == n:
        return (rows * x).sum(axis=1, keepdims=True)
    return (rows.reshape(-1, rows.shape[1] // n, n) * x.reshape(-1, 1, n)).sum(axis=2)


def _within(y, x, low, high):
    inside = (x >= low) & (x <= high)
    return y + np.where(inside, 0.0, np.nan).sum(axis=1, keepdims=True)


def _frames(theta, table, convention):
    """x, y and z axis and origin of the base and of every frame: Denavit and Hartenberg's table."""
    k = len(table)
    # From each frame to the next: factors of the angles' cosines and sines, and the rest.
    turn = np.zeros((3, 4, 4))
    turn[0, 0, 0] = turn[0, 1, 1] = turn[1, 1, 0] = turn[2, 2, 2] = turn[2, 3, 3] = 1.0
    turn[1, 0, 1] = -1.0
    turn = turn[:, None]
    twist, along = (np.tile(np.eye(4), (k, 1, 1)) for _ in range(2))
    c, s, twist[:, 0, 3], along[:, 2, 3] = table.T
    twist[:, 1:3, 1:3] = np.stack([c, -s, s, c], axis=1).reshape(-1, 2, 2)
    standard = convention == "standard"
    cosines, sines, rest = turn @ along @ twist if standard else twist @ turn @ along
    theta = theta.reshape(-1, k, 1, 1)
    steps = (np.cos(theta) * cosines + np.sin(theta) * sines + rest).reshape(-1, 16 * k)
    pose, found = None, [0.0 * steps[:, np.arange(16)] + np.eye(4).ravel()]
    for i in range(k):
        step = steps[:, 16 * i + np.arange(16)].reshape(-1, 4, 4)
        pose = step if pose is None else pose @ step
        found.append(pose.reshape(-1, 16))
    axes = np.arange(12).reshape(3, 4).T.ravel()  # the columns of a matrix of 4 by 4
    return np.concatenate(found, axis=1)[:, np.add.outer(16 * np.arange(k + 1), axes).ravel()]


def _waves(angles, joint, order):
    """Cosine of a multiple of an angle, sine where the order is negative, 1 where it is 0."""
    times = np.zeros((angles.shape[1], len(joint)))
    times[joint, np.arange(len(joint))] = np.abs(order)
    # A cosine is a sine a quarter of a turn further on: so one operation makes all of them in their
    # order, of columns that ONNX Runtime would take one by one.
    return np.sin(angles @ times + np.where(order < 0, 0.0, np.pi / 2))


def _distances(x, centers, shift, inverse_width):
    """Squared distances from centres, in units of widths.

    The rows of `centers` are scaled already; x is not: shift and inverse widths do that.
    """
    z = (x - shift) * inverse_width
    # |z|^2 + |c|^2 - 2 z.c, as predict has it.
    s = z @ (-2.0 * centers.T) + np.square(centers).sum(axis=1)
    return s + (z * z).sum(axis=1, keepdims=True)


def _variances(vectors, sizes, vector, root, less=0):
    """Squared lengths of ``root' columns``, for x, y and z; the last `less` are taken off.

    Column c is its size times one of the vectors. Those of x come first: (3, number of vectors).
    """
    n, r = vectors.shape[1] // 3, root.shape[1]
    signs = np.where(np.arange(r) < r - less, 1.0, -1.0)
    # Runs of many columns share the vector of a joint's waves.
    ends = np.flatnonzero(np.append(np.diff(vector), 1)) + 1
    spans = zip([0, *ends[:-1]], ends, strict=True)
    runs = [np.arange(start, end) for start, end in spans if end - start >= _MANY]
    alongs = [vectors[:, vector[run[0]] + n * np.arange(3)] for run in runs]
    alone = np.setdiff1d(np.arange(len(vector)), np.concatenate([[], *runs]).astype(int))
    # Columns of the root that columns beside these runs have; of a triangle, the first few.
    used = np.flatnonzero(root[alone].any(axis=0))
    own = used[-1] + 1 if len(used) else 0
    squares = []
    if own:
        places = np.add.outer(n * np.arange(3), vector[alone]).ravel()
        every = vectors[:, places].reshape(-1, 3, len(alone))
        parts = [(every * sizes[:, alone].reshape(-1, 1, len(alone))) @ root[alone, :own]]
        for run, along in zip(runs, alongs, strict=True):
            # One product, not one for each of x, y and z.
            shared = sizes[:, run] @ root[run, :own]
            parts.append(along.reshape(-1, 3, 1) * shared.reshape(-1, 1, own))
        dots = sum(parts[1:], parts[0])
        squares.append((dots * dots * signs[:own]).sum(axis=2))
    # What waves have beside that, by its covariance: one number for two runs.
    for i, run in enumerate(runs if own < r else ()):
        later = np.concatenate(runs[i:])
        covariance = (root[run, own:] * signs[own:]) @ root[later, own:].T.astype(float)
        if root.dtype != float:  # nor was the root better than that
            covariance = covariance.astype(np.float32)
        of_run = np.repeat(np.arange(i, len(runs)), [len(one) for one in runs[i:]])
        twice = (1.0 + (of_run > i)) * (of_run == np.arange(len(runs))[:, None])
        pairs = (sizes[:, run] @ covariance * sizes[:, later]) @ twice.T
        squares += [alongs[i] * alongs[j] * pairs[:, [j]] for j in range(i, len(runs))]
    return sum(squares[1:], squares[0])


# Values (n, size) go in, constants by their names, (n, size) comes out.
OPERATIONS = {
    "constant": lambda value: np.atleast_2d(value),
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "max": np.maximum,
    "min": np.minimum,
    "less": lambda a, b: np.where(a < b, 1.0, 0.0),
    "sqrt": np.sqrt,
    "exp": np.exp,
    "sin": np.sin,
    "cos": np.cos,
    # Of a point in the right half plane: its height, then its distance from the axis.
    "elevation": np.arctan2,
    "take": lambda x, index: x[:, index],
    "join": lambda *values: np.concatenate(values, axis=1),
    "dots": _dots,
    "affine": lambda x, matrix, shift: x @ matrix.T + shift,
    # NaN where a number is NaN or larger than ``predict`` takes.
    "finite": lambda y, x: _within(y, x, -LARGEST, LARGEST),
    "within": _within,
    "frames": _frames,
    "waves": _waves,
    "distances": _distances,
    "variances": _variances,
}

# Operations by the functions of NumPy that make them.
_FUNCTIONS: dict[np.ufunc, str] = {np.less: "less"}
_FUNCTIONS |= {f: name for name, f in OPERATIONS.items() if isinstance(f, np.ufunc)}
del _FUNCTIONS[np.arctan2]  # which holds in the right half plane only
