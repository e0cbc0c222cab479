"""The C files of a program: source and header, with public functions, and a test program."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
import re

import numpy as np

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._c_program import function
from sklearn_raacmm.export._c_text import Tables, comment, comments, plain, template
from sklearn_raacmm.export._program import hash_program, pruned
from sklearn_raacmm.export._proof import TOLERANCE

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
        "INPUT_UNIT": f'"{about["angle_unit"]}"' if "arm" in about else None,
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
