"""The C files of a program: source, header and test; pieces that cannot be anything but that."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
import re
import textwrap
from pathlib import Path
from string import Template

import numpy as np

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._c_program import function
from sklearn_raacmm.export._program import hash_program, pruned
from sklearn_raacmm.export._proof import TOLERANCE
from sklearn_raacmm.export._steps import but_slides

# C99 promises 63 significant characters within a file; the rest is for what is appended.
_MAX_NAME = 40
_PARTS = re.split(
    r"^//// (\w+)\n",
    Path(__file__).with_name("_templates.c").read_text(encoding="utf-8"),
    flags=re.MULTILINE,
)
_TEMPLATES = dict(zip(_PARTS[1::2], map(Template, _PARTS[2::2]), strict=True))
# What the functions return.
STATUS = ("OK", "FADED", "NOT_FINITE")
# A pose is called faded where less than this share of a stage is left: its uncertainty is then
# larger than the residuals that it was fitted on.
_FADED_BELOW = 0.5


def sources(program, name, stem, dtype, card=None, notes=()):
    """Text of the C file and of the header.

    Names of functions begin with `name`, those of the files with `stem`. Fields of a `card` that is
    a dict become macros, too; `notes` are more lines for the comment at the top.
    """
    about, tables = program.about, Tables(dtype)
    functions = _functions(program, name, dtype)
    text = function(pruned(program, ("y", "point", "trust")), tables, "evaluate", _FADED_BELOW)
    if "std" in program.outputs:
        with_std = pruned(program, ("y", "trust", "std"))
        text += "\n" + function(with_std, tables, "evaluate_std", _FADED_BELOW)
    text = f"{tables.text}\n{text}"
    digest = hash_program(program)
    used = re.findall(r"\b(sin|cos|sqrt|atan2|exp|log|fabs|isfinite)f?\(", text)
    facts = [f"fingerprint {digest}", f"written by sklearn_raacmm {__version__}"]
    facts += [about["arm"]] if "arm" in about else []
    facts += [*about["steps"], *notes, f"functions of math.h: {', '.join(sorted({*used}))}"]
    banner = comment(facts + ([] if card is None else ["", *str(card).splitlines()]))
    macros = _macros(program, name, digest, card if isinstance(card, dict) else {}, tables)
    # Of all that the two files hold: one of each of two exports do not fit together.
    pair = hashlib.sha256("\0".join([banner, macros, text, *map(str, functions)]).encode())
    pair = f"{name.upper()}_PAIR_{pair.hexdigest()[:16]}"
    guard = f"{name.upper()}_H"
    declared = "".join(f"/* {what} */\n{head};\n\n" for head, what, _ in functions)
    defined = "\n\n".join(f"{head}\n{{\n{body}}}" for head, _, body in functions)
    given = {"stem": stem, "banner": banner, "pair": pair}
    header = template("header", guard=guard, macros=macros, declared=declared, **given)
    return template("source", text=text, defined=defined, **given), header


def _macros(program, name, digest, card, tables):
    """``#define`` lines: what the caller's code may ask the compiler."""
    about = program.about
    values = {
        "VERSION": f'"{__version__}"',
        "FINGERPRINT": f'"{digest}"',
        "N_INPUTS": program.n_inputs,
        "N_OUTPUTS": program.n_outputs,
        "TABLE_BYTES": tables.n_bytes,
        "INPUT_UNIT": f'"{about["angle_unit"]}{but_slides(about["slides"])}"'
        if "arm" in about
        else None,
        "OUTPUT_UNIT": '"mm"' if about["corrects"] else None,
    }
    if "training" in card:
        values["DATA_FINGERPRINT"] = f'"{plain(card["training"]["data_fingerprint"])}"'
    values |= {k.upper(): repr(float(v)) for k, v in card.get("standard_deviation", {}).items()}
    values |= {status: i for i, status in enumerate(STATUS)}
    return "".join(f"#define {name.upper()}_{k} {v}\n" for k, v in values.items() if v is not None)


def _functions(program, name, real):
    """Public functions: of each its head, what it does, and its body."""
    about, n, q = program.about, program.n_inputs, program.n_outputs
    corrects, fades = about["corrects"], "trust" in program.outputs
    x = "joint_angles" if "arm" in about else "features"
    verb, out, spread = "predict", "prediction", "std"
    if corrects:
        verb, out, spread = "correct", "correction_mm", "std_mm"
    given, result = f"const {real} {x}[{n}]", f"{real} {out}[{q}]"
    # What evaluate() computes beside the result.
    point, trust = [f"{real} point_mm[3];"] * corrects, [f"{real} trust[1];"] * fades
    call = f"evaluate({', '.join([x, out, *['point_mm'] * corrects, *['trust'] * fades])});"
    found = []

    def add(head, what, *lines):
        body = "".join(f"    {line}\n" for line in lines)
        found.append((head, texts[what], body))

    then = f";\n   then {', '.join(map(plain, about['extra']))}" if about.get("extra") else ""
    unit = "degrees" if about.get("angle_unit") == "deg" else "rad"
    unit += but_slides(about.get("slides", ()))
    texts = comments(
        x=x.replace("_", " "), out=out, n=n, q=q, unit=unit, then=then, upper=name.upper()
    )
    texts[verb] += "\n   " + texts["status"] + texts["faded"] * fades
    head = f"int {name}_{verb}({given}, {result})"
    add(head, verb, *point, *trust, f"return {call}")
    add(
        f"int {name}_{verb}_n(const {real} *{x}, {real} *{out}, size_t n)",
        "rows",
        *template("many", function=f"{name}_{verb}", x=x, out=out, n=n, q=q).splitlines(),
    )
    if corrects:
        head = f"int {name}_point({given}, {real} point_mm[3])"
        add(head, "point", f"{result};", *trust, f"return {call}")
        texts["std"] += texts["deviations"]
    if fades:
        lines = [f"{result};", *point, *trust, f"(void){call}", "return trust[0];"]
        add(f"{real} {name}_trust({given})", "trust", *lines)
    if "std" in program.outputs:
        call = f"evaluate_std({', '.join([x, out, *['trust'] * fades, spread])});"
        head = f"int {name}_{verb}_std({given}, {result}, {real} {spread}[{q}])"
        add(head, "std", *trust, f"return {call}")
    fingerprint = f"return {name.upper()}_FINGERPRINT;"
    add(f"const char *{name}_fingerprint(void)", "fingerprint", fingerprint)
    return found


def make_test(rows, gap, name, stem, dtype, corrects):
    """Text of the test program of ``<stem>.c``.

    `rows` are test rows and their answers, from which the same operations in Python are `gap` away.
    ``corrects`` says whether the function is ``correct``, not ``predict``.
    """
    write, X, expected = Tables(dtype), rows["X"], rows["y"]
    refused = np.isnan(expected).any(axis=1)
    kind = np.select([np.isnan(X), np.inf == X, -np.inf == X], [1, 2, 3], 0)
    tolerance = TOLERANCE[dtype] * np.abs(expected[~refused]).max(initial=1e-3)
    tolerance = max(tolerance, 10 * gap)
    tables = write.table("input", np.where(kind == 0, X, 0.0))
    tables += write.table("input_kind", kind, "0 a number, 1 NaN, 2 infinity, 3 -infinity")
    tables += write.table("expected", np.where(refused[:, None], 0.0, expected))
    tables += write.table("refused", refused, "1 where all outputs have to be NaN")
    tables += f"static const {dtype} tolerance = {write.literal(tolerance)};\n"
    n, q = expected.shape
    return write.c(
        "test", tables=tables, n=n, d=X.shape[1], q=q, total=expected.size,
        verb="correct" if corrects else "predict", name=name, upper=name.upper(), stem=stem,
        command=f"cc -std=c99 -O2 -o {stem}_test {stem}_test.c {stem}.c -lm && ./{stem}_test",
    )  # fmt: skip


# -- pieces of text ------------------------------------------------------------------------------


def template(name, /, **given):
    """One part of ``_templates.c``, its places filled."""
    return _TEMPLATES[name].substitute(given)


def check_name(name):
    """A prefix for C functions, or one clear sentence."""
    fits = isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name, re.ASCII)
    if not fits or "__" in name or len(name) > _MAX_NAME:
        raise ValueError(
            "name must be a C identifier: a letter, then letters, digits or single underscores, "
            f"at most {_MAX_NAME} characters; got {name!r:.60}."
        )
    return name


def comments(**given):
    """Comments on the public functions, by name."""
    return dict(
        re.findall(r"^= (\w+): (.*(?:\n   .*)*)", template("comments", **given), re.MULTILINE)
    )


def plain(text):
    """Text that may stand in a comment or between quotes: it cannot end it, nor splice lines.

    Letters, digits and what is no part of a trigraph, an escape or a quotation; the rest becomes
    underscores.
    """
    return re.sub(r"[^A-Za-z0-9 _.,:;=+()\[\]'|#%<>/-]", "_", str(text))


def comment(lines):
    """Lines of a C comment, without its ends; long ones go on in the next line."""
    text = ""
    for line in lines:
        wrapped = textwrap.wrap(plain(line), 96, initial_indent=" * ", subsequent_indent=" *     ")
        text += "\n".join(wrapped or [" *"]) + "\n"
    return text


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
