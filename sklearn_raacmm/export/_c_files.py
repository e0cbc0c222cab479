"""The C files of a program: source, header and test; pieces that cannot be anything but that."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
import textwrap

import numpy as np

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._c_program import Tables, function, template
from sklearn_raacmm.export._proof import TOLERANCE
from sklearn_raacmm.utils import digest_of

# C99 promises 63 significant characters within a file; the rest is for what is appended.
_MAX_NAME = 40
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
    tables, functions = Tables(dtype), _functions(program, name, dtype)
    text = function(program.pruned("y", "point", "trust"), tables, "evaluate", _FADED_BELOW)
    if "std" in program.outputs:
        with_std = program.pruned("y", "trust", "std")
        text += "\n" + function(with_std, tables, "evaluate_std", _FADED_BELOW)
    text = f"{tables.text}\n{text}"
    used = re.findall(r"\b(sin|cos|sqrt|atan2|exp|log|fabs|isfinite)f?\(", text)
    facts = [f"fingerprint {program.fingerprint}", f"written by sklearn_raacmm {__version__}"]
    arm, _ = program.chain.arm_and_unit
    if arm is not None:
        label = f" {arm.name}" if arm.name else ""
        facts.append(f"arm{label}: {arm.n_joints} joints, {arm.convention} DH, mm and rad")
    facts += [*program.chain.described(), *notes]
    facts.append(f"functions of math.h: {', '.join(sorted({*used}))}")
    banner = comment(facts + ([] if card is None else ["", *str(card).splitlines()]))
    macros = _macros(program, name, card if isinstance(card, dict) else {}, tables.n_bytes)
    # Of all that the two files hold: one of each of two exports do not fit together.
    pair = digest_of("\0".join([banner, macros, text, *map(str, functions)]))
    pair = f"{name.upper()}_PAIR_{pair[:16]}"
    guard = f"{name.upper()}_H"
    declared = "".join(f"/* {what} */\n{head};\n\n" for head, what, _ in functions)
    defined = "\n\n".join(f"{head}\n{{\n{body}}}" for head, _, body in functions)
    given = {"stem": stem, "banner": banner, "pair": pair}
    header = template("header", guard=guard, macros=macros, declared=declared, **given)
    return template("source", text=text, defined=defined, **given), header


def _macros(program, name, card, n_bytes):
    """``#define`` lines: what the caller's code may ask the compiler."""
    values = {
        "VERSION": f'"{__version__}"',
        "FINGERPRINT": f'"{program.fingerprint}"',
        "N_INPUTS": program.n_inputs,
        "N_OUTPUTS": program.n_outputs,
        "TABLE_BYTES": n_bytes,
    }
    if program.chain.arm_and_unit[0] is not None:
        values["INPUT_UNIT"] = f'"{program.chain.units}"'
    if "point" in program.outputs:
        values["OUTPUT_UNIT"] = '"mm"'
    if "training" in card:
        values["DATA_FINGERPRINT"] = f'"{plain(card["training"]["data_fingerprint"])}"'
    values |= {k.upper(): repr(float(v)) for k, v in card.get("standard_deviation", {}).items()}
    values |= {status: i for i, status in enumerate(STATUS)}
    return "".join(f"#define {name.upper()}_{key} {value}\n" for key, value in values.items())


def _functions(program, name, real):
    """Public functions: of each its head, what it does, and its body."""
    chain, n, q = program.chain, program.n_inputs, program.n_outputs
    corrects, fades = "point" in program.outputs, "trust" in program.outputs
    x, unit = "features", ""
    if chain.arm_and_unit[0] is not None:
        x, unit = "joint_angles", chain.units.replace("deg", "degrees", 1)
    verb, out, spread = "predict", "prediction", "std"
    if corrects:
        verb, out, spread = "correct", "correction_mm", "std_mm"
    given, result = f"const {real} {x}[{n}]", f"{real} {out}[{q}]"
    # What evaluate() computes beside the result.
    point, trust = [f"{real} point_mm[3];"] * corrects, [f"{real} trust[1];"] * fades
    call = f"evaluate({', '.join([x, out, *['point_mm'] * corrects, *['trust'] * fades])});"
    extra = ", ".join(plain(label) for label, _ in chain.extra)
    text = template(
        "comments", x=x.replace("_", " "), out=out, n=n, q=q, unit=unit, upper=name.upper(),
        then=f";\n   then {extra}" if extra else "",
    )  # fmt: skip
    texts = dict(re.findall(r"^= (\w+): (.*(?:\n   .*)*)", text, re.MULTILINE))
    texts[verb] += "\n   " + texts["status"] + texts["faded"] * fades
    found = []

    def add(head, what, *lines):
        found.append((head, texts[what], "".join(f"    {line}\n" for line in lines)))

    add(f"int {name}_{verb}({given}, {result})", verb, *point, *trust, f"return {call}")
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


def check_name(name):
    """A prefix for C functions, or one clear sentence."""
    fits = isinstance(name, str) and re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name, re.ASCII)
    if not fits or "__" in name or len(name) > _MAX_NAME:
        raise ValueError(
            "name must be a C identifier: a letter, then letters, digits or single underscores, "
            f"at most {_MAX_NAME} characters; got {name!r:.60}."
        )
    return name


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
