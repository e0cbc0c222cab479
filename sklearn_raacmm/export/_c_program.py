"""A program as C99: tables, and one static function that computes its outputs.

Operations on single numbers of a row are written as one expression as far as each result is used
once. The others have a loop of their own.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
import textwrap
from functools import partial
from pathlib import Path
from string import Template

import numpy as np

from sklearn_raacmm.utils import LARGEST

_PARTS = re.split(
    r"^//// (\w+)\n",
    Path(__file__).with_name("_templates.c").read_text(encoding="utf-8"),
    flags=re.MULTILINE,
)
_TEMPLATES = dict(zip(_PARTS[1::2], map(Template, _PARTS[2::2]), strict=True))
# Squared distance that is as good as any larger one, and whose square does not overflow.
_FARTHEST = 1e18
# Numbers that are computed together: a multiple of those in a processor's vector. Where compilers
# know that there are so many, they need no remainder: 15 -> 10 us for the variance of 177 columns.
_VECTOR = 8
# Of each number of a row by itself; {f} is the suffix of the precision.
_ELEMENTWISE = {
    "add": "({} + {})", "sub": "({} - {})", "mul": "({} * {})", "div": "({} / {})",
    "max": "larger({}, {})", "min": "smaller({}, {})", "less": "less({}, {})",
    "sqrt": "sqrt{f}({})", "exp": "exp{f}({})", "sin": "sin{f}({})",
    "cos": "cos{f}({})", "elevation": "atan2{f}({}, {})",
}  # fmt: skip
# Operations that take each number of a value once, so that it need not be an array; of the last two
# that is the first value.
_BY_NUMBER = {*_ELEMENTWISE, "join", "finite", "within"}


class _Writer:
    """Writes one program as a function."""

    def __init__(self, program, tables):
        self.ops, self.outputs, self.tables = program.ops, program.outputs, tables
        self.real, self.f = tables.real, tables.suffix
        self.users = [[] for _ in self.ops]
        for number, op in enumerate(self.ops):
            for place, i in enumerate(op.inputs):
                self.users[i].append((number, place))
        self.kept = set(self.outputs.values())
        self.lines = []
        for number in range(1, len(self.ops)):
            self._write(number)

    # -- what stands for a value

    def inline(self, number):
        """Whether a value is an expression in the one place where it is used."""
        op, users = self.ops[number], self.users[number]
        if op.name == "constant":
            return True
        scattered = op.name == "take" and not self._start(op)
        if not (op.name in _ELEMENTWISE or scattered) or number in self.kept or len(users) != 1:
            return False
        ((user, place),) = users
        by_number = self.ops[user].name in _BY_NUMBER
        if self.ops[user].name in ("finite", "within") and place == 1:
            return False
        return by_number and (self.ops[user].size == op.size or self.ops[user].name == "join")

    def _start(self, op):
        """First index of a `take` of numbers that follow each other, as text; else nothing."""
        index = op.given["index"]
        return f"{index[0]}" if np.all(np.diff(index) == 1) else ""

    def at(self, number, i):
        """Expression of one number of a value."""
        op = self.ops[number]
        i = "0" if op.size == 1 else i
        if op.name == "constant" and op.size == 1:
            return self.tables.literal(op.given["value"][0])
        if op.name == "constant" or not self.inline(number):
            return f"{self.array(number)}[{i}]"
        if op.name == "take":
            return self.at(op.inputs[0], self._index(op, i))
        return self._expression(op, i)

    def _expression(self, op, i):
        """An elementwise operation on the numbers i of its values."""
        name, operands = op.name, [self.at(source, i) for source in op.inputs]
        if name in ("max", "min", "less"):
            self.tables.help(name)
        return _ELEMENTWISE[name].format(*operands, f=self.f)

    def array(self, number):
        """Name of a value as an array."""
        op = self.ops[number]
        if op.name == "constant":
            return self.tables("constant", op.given["value"])
        return "input" if number == 0 else f"v{number}"

    # -- statements

    def put(self, *lines):
        self.lines += lines

    def fill(self, name, /, **given):
        """Lines of a template; a place for further lines may stay empty."""
        self.put(*filter(None, self.tables.c(name, **given).splitlines()))

    def assign(self, name, n, expression, start=0):
        """Numbers of an array, from `start` on, by the expression of each."""
        if n == 1:
            self.put(f"{name}[{start}] = {expression('0')};")
        else:
            place = f"{start} + i" if start else "i"
            self.put(f"for (int i = 0; i < {n}; ++i)", f"    {name}[{place}] = {expression('i')};")

    def _assign(self, number, expression):
        """A value of its own, by the expression of each of its numbers."""
        self.declare(number)
        self.assign(f"v{number}", self.ops[number].size, expression)

    def declare(self, number, n=None, fill=""):
        self.put(f"{self.real} v{number}[{n or self.ops[number].size}]{fill};")

    def _write(self, number):
        op = self.ops[number]
        if self.inline(number):
            return
        if op.name in _ELEMENTWISE:
            self._assign(number, lambda i: self._expression(op, i))
        else:
            getattr(self, f"_{op.name}")(number, op)

    def _take(self, number, op):
        start, source = self._start(op), op.inputs[0]
        if start and not (self.inline(source) and self.ops[source].name != "constant"):
            self.put(f"const {self.real} *const v{number} = {self.array(source)} + {start};")
            return
        self._assign(number, lambda i: self.at(source, self._index(op, i)))

    def _index(self, op, i):
        """Which number of its source a `take` has in place i."""
        if self.ops[op.inputs[0]].size == 1:
            return "0"
        return f"{self.tables('index', op.given['index'])}[{i}]"

    def _join(self, number, op):
        self.declare(number)
        start = 0
        for source in op.inputs:
            n = self.ops[source].size
            self.assign(f"v{number}", n, partial(self.at, source), start)
            start += n

    def _dots(self, number, op):
        (rows, x), r = (self.array(i) for i in op.inputs), op.size
        n = self.ops[op.inputs[1]].size
        self.declare(number)
        row = f"{rows}[i * {n} + j]" if r > 1 else f"{rows}[j]"
        self.put(f"for (int i = 0; i < {r}; ++i) {{")
        self._sum(n, f"{row} * {x}[j]", f"v{number}[i]")
        self.put("}")

    def _sum(self, n, term, result):
        """Sum up terms of j within a loop: several sums side by side where there are many."""
        full, c = n // _VECTOR * _VECTOR, self.tables.c
        if n < 4 * _VECTOR:
            lines = c("sum", n=n, term=term, result=result)
        else:
            rest = c("sum_rest", full=full, n=n, term=term) if full < n else ""
            part = term.replace("j]", "k + j]")
            lines = c("long_sum", width=_VECTOR, full=full, part=part, rest=rest, result=result)
        self.put(*(f"    {line}" for line in lines.splitlines() if line))

    def _finite(self, number, op):
        x = op.inputs[1]
        self._refused(number, op, f"all_finite({self.array(x)}, {self.ops[x].size})")

    def _refused(self, number, op, condition):
        self.put(f"const int ok{number} = {condition};")
        y = partial(self.at, op.inputs[0])
        self._assign(number, lambda i: f"ok{number} ? {y(i)} : ({self.real})NAN")

    def _within(self, number, op):
        x = self.array(op.inputs[1])
        low, high = (self.tables.literal(op.given[key]) for key in ("low", "high"))
        n = self.ops[op.inputs[1]].size
        parts = [f"{x}[{j}] >= {low} && {x}[{j}] <= {high}" for j in range(n)]
        self._refused(number, op, " && ".join(parts))

    def _affine(self, number, op):
        matrix, shift = op.given["matrix"], op.given["shift"]
        rows, columns = matrix.shape
        x = self.array(op.inputs[0])
        if not np.any(matrix):
            self._assign(number, lambda i: self._init(shift, i))
        elif 2 * np.count_nonzero(matrix) <= matrix.size:
            self._sparse(number, matrix, shift, x)
        elif rows < _VECTOR:
            self.declare(number)
            table = self.tables("rows", matrix)
            self.put(f"for (int i = 0; i < {rows}; ++i) {{")
            self._sum(columns, f"{table}[i][j] * {x}[j]", f"v{number}[i]")
            self.put(*([f"    v{number}[i] += {self._init(shift)};"] if np.any(shift) else []), "}")
        else:
            n, packed, length = _packed(matrix.T)
            table = self.tables("columns", packed.ravel())
            self.declare(number, n, " = {0}")
            if np.any(shift):
                self.assign(f"v{number}", rows, partial(self._init, shift))
            self.fill("columns", v=f"v{number}", x=x, table=table, columns=columns, length=length)

    def _init(self, shift, i="i"):
        if len(shift) == 1:
            return self.tables.literal(shift[0])
        return f"{self.tables('shift', np.asarray(shift, dtype=float))}[{i}]"

    def _sparse(self, number, matrix, shift, x):
        row, column = np.nonzero(matrix)
        start = self.tables("start", np.searchsorted(row, np.arange(len(matrix) + 1)))
        of, values = self.tables("column", column), self.tables("entry", matrix[row, column])
        self.declare(number)
        first = self._init(shift) if np.any(shift) else "0"
        self.fill(
            "sparse", v=f"v{number}", x=x, rows=len(matrix), first=first, start=start, of=of,
            values=values,
        )  # fmt: skip

    def _frames(self, number, op):
        table = op.given["table"]
        self.declare(number)
        self.fill(
            "frames", v=f"v{number}", theta=self.array(op.inputs[0]), n=len(table),
            table=self.tables("dh", table, "cos alpha, sin alpha, a mm, d mm"),
            turn=self.tables.c(op.given["convention"]),
        )  # fmt: skip

    def _waves(self, number, op):
        """Powers of ``exp(i angle)``: each is the product of two others."""
        joint, order = op.given["joint"], op.given["order"]
        firsts, products, place = _chain(joint, np.abs(order))
        out = np.where(order > 0, 2 * place, np.where(order < 0, 2 * place + 1, 0))
        first, products_text = self.tables("wave_joint", np.array(firsts, dtype=int)), ""
        if products:
            of = self.tables("wave_of", np.array(products, dtype=int))
            start = 2 * len(firsts) + 2
            products_text = self.tables.c("products", n=len(products), of=of, start=start)
        self.declare(number)
        self.fill(
            "waves", v=f"v{number}", angles=self.array(op.inputs[0]), n=len(order), first=first,
            n_firsts=len(firsts), size=2 * (len(firsts) + len(products)) + 2,
            products=products_text, at=self.tables("wave_at", out),
        )  # fmt: skip

    def _distances(self, number, op):
        centers = op.given["centers"].T
        d, k = centers.shape
        shift = self.tables("center_shift", op.given["shift"], "middle of the centres")
        note = "1 / length scale; 0 for a feature that did not vary"
        width = self.tables("inverse_width", op.given["inverse_width"], note)
        note = "one column a centre, less their middle, in units of the length scales"
        center = self.tables("center", centers, note)
        self.declare(number, fill=" = {0}")
        self.fill(
            "distances", v=f"v{number}", x=self.array(op.inputs[0]), d=d, k=k, shift=shift,
            width=width, center=center, most=self.tables.literal(_FARTHEST),
        )  # fmt: skip

    def _variances(self, number, op):
        self.declare(number)
        root, less = op.given["root"], int(op.given.get("less", 0))
        n, packed, length = _packed(root)
        more, whole = root.shape[1] - less if less else n, root.dtype == np.int16
        kind = "float" if whole or root.dtype == np.float32 else self.real
        note = "of the coefficients' covariance, row by row"
        self.fill(
            "variances", kind=kind, stored="short" if whole else kind, v=f"v{number}",
            m=len(root), r=n, more=more, axes=self.ops[op.inputs[0]].size // 3, length=length,
            less=self.tables.c("taken_off", more=more, r=n) if less else "",
            vectors=self.array(op.inputs[0]), sizes=self.array(op.inputs[1]),
            vector=self.tables("vector", op.given["vector"], "of each column"),
            root=self.tables("root", packed.ravel(), note),
        )  # fmt: skip


def function(program, tables, name, faded_below):
    """A static function that computes the outputs of a program; it returns a status."""
    writer = _Writer(program, tables)
    real, ops = tables.real, program.ops
    # What predict takes; single precision ends before.
    most = tables.literal(min(LARGEST, float(np.finfo(tables.dtype).max)))
    tables.help("all_finite", most=most)
    outputs = [f"{real} {out}_out[{ops[i].size}]" for out, i in program.outputs.items()]
    for out, i in program.outputs.items():
        writer.assign(f"{out}_out", ops[i].size, partial(writer.at, i))
    finite = f"all_finite(y_out, {program.n_outputs})"
    status = f"return {finite} ? 0 : 2;"
    if "trust" in program.outputs:
        limit = tables.literal(faded_below)
        status = f"return !{finite} ? 2 : trust_out[0] < {limit} ? 1 : 0;"
    body = "\n".join(f"    {line}" for line in [*writer.lines, status])
    return tables.c(
        "function", name=name, n=program.n_inputs, outputs=", ".join(outputs), body=body
    )


def _packed(rows):
    """Numbers in a row, the rows of a triangle one by one, and how many numbers row c has, in C.

    Rows are filled up with zeros to whole vectors. What is no triangle stays a matrix.
    """
    # The next multiple: zeros fill up the rest.
    n, last = -(-rows.shape[1] // _VECTOR) * _VECTOR, len(rows) - 1
    full, c = np.pad(rows, ((0, 0), (0, n - rows.shape[1]))), np.arange(len(rows))
    for at, text in ((c, "c"), (last - c, f"({last} - c)")):
        if not np.any(full[at[:, None] < np.arange(n)]):
            lengths = np.minimum(at // _VECTOR * _VECTOR + _VECTOR, n)
            parts = [row[:length] for row, length in zip(full, lengths, strict=True)]
            whole = f"{text} / {_VECTOR} * {_VECTOR} + {_VECTOR}"
            length = f"const int whole = {whole}, n = whole < {n} ? whole : {n};"
            return n, np.concatenate(parts), length
    return n, full, f"const int n = {n};"


def _chain(joint, order):
    """How powers of ``exp(i angle)`` follow from each other.

    Joints whose first power is taken from cosine and sine; where the two factors of each further
    one stand, as the first of two numbers (1 is at 0); which power each wave is, 0 without one.
    """
    wanted = {(int(j), int(k)) for j, k in zip(joint, order, strict=True) if k}
    firsts = sorted({j for j, _ in wanted})
    place = {(j, 1): 1 + i for i, j in enumerate(firsts)}
    products = []

    def reach(j, k):
        if (j, k) not in place:
            half = (k // 2, k - k // 2) if k % 2 == 0 else (1, k - 1)
            near = [reach(j, part) for part in half]
            products.append((2 * near[0], 2 * near[1]))
            place[j, k] = len(firsts) + len(products)
        return place[j, k]

    for j, k in sorted(wanted):
        reach(j, k)
    pairs = zip(joint, order, strict=True)
    return firsts, products, np.array([place.get((int(j), int(k)), 0) for j, k in pairs])


# -- pieces of text ------------------------------------------------------------------------------


def template(name, /, **given):
    """One part of ``_templates.c``, its places filled."""
    return _TEMPLATES[name].substitute(given)


class Tables:
    """Literals of one precision, and tables of constants and helping functions, each there once.

    Literals are the shortest decimals that read back as the same number. Tables of float32 are of
    single precision in any case.
    """

    def __init__(self, dtype):
        self.real, self.n_bytes = dtype, 0  # of all tables written so far
        self.dtype = np.float64 if dtype == "double" else np.float32
        self.suffix = "" if dtype == "double" else "f"
        self.helpers, self._texts, self._names = {}, [], {}

    def __call__(self, name, array, note=""):
        """Name of a table: of whole numbers, if its type is such."""
        array = np.asarray(array)
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._names:
            self._names[key] = f"{name}_{len(self._names)}"
            self._texts.append(self.table(self._names[key], array, note))
        return self._names[key]

    def c(self, name, /, **given):
        """One part of ``_templates.c`` in this precision."""
        return template(name, **{"real": self.real, "f": self.suffix, **given})

    def help(self, name, /, **given):
        """Add a function that others call."""
        self.helpers[name] = self.c(name, **given)

    @property
    def text(self):
        return "\n".join([*self.helpers.values(), *self._texts])

    def literal(self, value):
        """One number."""
        single = self.dtype is np.float32 or getattr(value, "dtype", None) == np.float32
        with np.errstate(over="ignore"):
            number = np.float32(value) if single else np.float64(value)
        if not np.isfinite(number):
            raise ValueError(
                f"The model holds {float(value):g}, which is not a finite {self.real}: it cannot "
                "be written as C."
            )
        text = np.format_float_scientific(number, trim="-", exp_digits=1)
        if 1e-4 <= abs(number) < 1e9 or number == 0:
            text = np.format_float_positional(number, trim="0")
        return text + "f" * single

    def table(self, name, array, note=""):
        """A static constant array of one or two dimensions, of numbers or of whole numbers."""
        array = np.asarray(array)
        kind, literal, size = "int", str, 4
        if array.dtype.kind == "f":
            kind = "float" if array.dtype == np.float32 else self.real
            literal, size = self.literal, 4 if kind == "float" else 8
        else:
            array = array.astype(int)
            if np.all(np.abs(array) < 2**15):
                kind, size = "short", 2
        self.n_bytes += size * array.size
        shape = "".join(f"[{n}]" for n in array.shape)
        if array.ndim == 1:
            body = _wrap(array, literal, "    ")
        else:
            rows = [_wrap(row, literal, "     ") for row in array]
            body = ",\n".join("    {" + text[5:] + "}" for text in rows)
        head = f"/* {note} */\n" if note else ""
        return f"{head}static const {kind} {name}{shape} = {{\n{body}\n}};\n"


def _wrap(values, literal, indent):
    """Values with commas, in lines of limited width."""
    return textwrap.fill(
        ", ".join(map(literal, values)), 95, initial_indent=indent, subsequent_indent=indent,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
