"""The C files of a program: source and header, with public functions around what it computes."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
import re

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._c_program import function
from sklearn_raacmm.export._c_text import Tables, comment, plain, template
from sklearn_raacmm.export._program import hash_program, pruned

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
    corrects, fades, upper = about["corrects"], "trust" in program.outputs, name.upper()
    x = "joint_angles" if "arm" in about else "features"
    verb, out, spread = "predict", "prediction", "std"
    if corrects:
        verb, out, spread = "correct", "correction_mm", "std_mm"
    given, result = f"const {real} {x}[{n}]", f"{real} {out}[{q}]"
    # What evaluate() computes beside the result.
    point, trust = [f"{real} point_mm[3];"] * corrects, [f"{real} trust[1];"] * fades
    call = f"evaluate({', '.join([x, out, *['point_mm'] * corrects, *['trust'] * fades])});"
    found = []

    def add(head, about, *lines):
        found.append((head, about, "".join(f"    {line}\n" for line in lines)))

    what = f"What the model predicts from {x.replace('_', ' ')}."
    if corrects:
        unit = "degrees" if about["angle_unit"] == "deg" else "rad"
        then = f";\n   then {', '.join(map(plain, about['extra']))}" if about["extra"] else ""
        what = (
            "How far off the probe is, in the base frame, mm: subtract it from the measured\n"
            f"   point. Joint angles in {unit}, as the encoders give them{then}."
        )
    status = (
        f"Returns {upper}_OK, or {upper}_NOT_FINITE where all are NaN: an input\n"
        "   is NaN or infinite, or the model is not defined there."
    )
    if fades:
        status += (
            f" {upper}_FADED: the model\n   is less certain of this pose than the residuals that "
            "it was fitted on are large."
        )
    head = f"int {name}_{verb}({given}, {result})"
    add(head, f"{what}\n   {status}", *point, *trust, f"return {call}")
    add(
        f"int {name}_{verb}_n(const {real} *{x}, {real} *{out}, size_t n)",
        f"The same for n rows of {n} numbers, one after the other; {out} has n rows of {q}.\n"
        "   Returns the largest status of a row.",
        *template("many", function=f"{name}_{verb}", x=x, out=out, n=n, q=q).splitlines(),
    )
    if corrects:
        head = f"int {name}_point({given}, {real} point_mm[3])"
        what = "The corrected centre of the probe in the base frame, mm; status and NaN as above."
        add(head, what, f"{result};", *trust, f"return {call}")
    if fades:
        what = (
            "The share of the correction that the fading leaves, of its stages the smallest: 1 "
            "where\n   the model knows the pose, 0 far away, NaN as above."
        )
        lines = [f"{result};", *point, *trust, f"(void){call}", "return trust[0];"]
        add(f"{real} {name}_trust({given})", what, *lines)
    if "std" in program.outputs:
        what = (
            "The same with its standard deviation, as predict(return_std=True) gives it: it grows\n"
            "   away from the poses that the model was fitted on."
        )
        if corrects:
            what += template("deviations", upper=upper).rstrip()
        call = f"evaluate_std({', '.join([x, out, *['trust'] * fades, spread])});"
        head = f"int {name}_{verb}_std({given}, {result}, {real} {spread}[{q}])"
        add(head, what, *trust, f"return {call}")
    what = "SHA-256 of what the model computes: the same for the same model."
    add(f"const char *{name}_fingerprint(void)", what, f"return {upper}_FINGERPRINT;")
    return found
