"""The files that a model is written to: C source, header, C++ header, test program and project."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
import re
from typing import NamedTuple

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._c_source import body_of, fingerprint_of
from sklearn_raacmm.export._c_text import comment, plain

# What the functions return.
OK, FADED, NOT_FINITE = range(3)
_STATUS = ("OK", "FADED", "NOT_FINITE")


class Function(NamedTuple):
    """A public function in C: its head, what it does, and its body."""

    head: str
    about: str
    body: str


def sources(model, name, stem, dtype, std, card=None, notes=()):
    """Text of the C file and of the header.

    Parameters
    ----------
    model : estimator
        Fitted.
    name, stem : str
        What the functions' names begin with, and the files' names.
    dtype : {"double", "float"}
    std : bool
    card : dict, str or None
        Facts about the model; fields of a dict become macros, too.
    notes : list of str
        More facts.

    Returns
    -------
    source, header : str
    """
    body = body_of(model, dtype, std)
    digest = fingerprint_of(model)
    facts = [f"fingerprint {digest}", f"written by sklearn_raacmm {__version__}"]
    if body.arm is not None:
        label = f" {body.arm.name}" if body.arm.name else ""
        facts.append(
            f"arm{label}: {body.arm.n_joints} joints, {body.arm.convention} DH, mm and rad"
        )
    facts += [*body.steps, *notes, f"functions of math.h: {', '.join(_math_functions(body, std))}"]
    banner = comment(facts + ([] if card is None else ["", *str(card).splitlines()]))
    functions = _functions(body, name, dtype, std)
    functions.append(
        Function(
            f"const char *{name}_fingerprint(void)",
            "SHA-256 of what the model computes: the same for the same model.",
            f"    return {name.upper()}_FINGERPRINT;\n",
        )
    )
    macros = _macros(body, name, digest, card if isinstance(card, dict) else {})
    # Of all that the two files hold: one of each of two exports do not fit together.
    pair = hashlib.sha256("\0".join([banner, macros, body.text, *map(str, functions)]).encode())
    pair = f"{name.upper()}_PAIR_{pair.hexdigest()[:16]}"
    guard = f"{name.upper()}_H"
    declared = "".join(f"/* {function.about} */\n{function.head};\n\n" for function in functions)
    header = (
        f"/* {stem}.h\n{banner} */\n#ifndef {guard}\n#define {guard}\n\n#include <stddef.h>\n\n"
        f"{macros}#define {pair} 1 /* {stem}.c asks for it */\n\n"
        f'#ifdef __cplusplus\nextern "C" {{\n#endif\n\n{declared}'
        "#ifdef __cplusplus\n}\n#endif\n\n#endif\n"
    )
    defined = "".join(f"\n{function.head}\n{{\n{function.body}}}\n" for function in functions)
    source = (
        f"/* {stem}.c\n{banner} *\n"
        " * C99, needs the mathematical library alone; no memory is allocated and nothing static\n"
        " * changes, so every function may be called from any thread.\n */\n"
        f'#include "{stem}.h"\n\n#include <float.h>\n#include <math.h>\n#include <stdint.h>\n'
        "#include <string.h>\n\n"
        f"#ifndef {pair}\n"
        f'#error "{stem}.c and {stem}.h are of different exports: copy both files of one export."\n'
        "#endif\n#ifdef __FAST_MATH__\n"
        '#error "-ffast-math takes away the NaN that stands for a refusal: compile without it."\n'
        f"#endif\n\n{body.text}{defined}"
    )
    return source, header


def _math_functions(body, std):
    """Names of what the source takes from math.h, for targets that have no such library."""
    used = re.findall(
        r"\b(sin|cos|sqrt|hypot|atan2|exp|expm1|log|log1p|fabs|isfinite)f?\(", body.text
    )
    return sorted({*used, *(["sqrt"] if std else [])})


def _macros(body, name, digest, card):
    """``#define`` lines: what the caller's code may ask the compiler."""
    upper = name.upper()
    training = card.get("training", {})
    values = {
        "VERSION": f'"{__version__}"',
        "FINGERPRINT": f'"{digest}"',
        "N_INPUTS": body.n_inputs,
        "N_OUTPUTS": body.n_outputs,
        "TABLE_BYTES": body.table_bytes,
        "INPUT_UNIT": f'"{body.angle_unit}"' if body.arm is not None else None,
        "OUTPUT_UNIT": '"mm"' if body.corrects else None,
        "SERIAL_NUMBER": _quoted(card.get("serial_number")),
        "DATE": _quoted(card.get("date")),
        "DATA_FINGERPRINT": _quoted(training.get("data_fingerprint")),
    }
    values |= {status: i for i, status in enumerate(_STATUS)}
    return "".join(f"#define {upper}_{k} {v}\n" for k, v in values.items() if v is not None)


def _quoted(text):
    return None if text is None else f'"{plain(text)[:200]}"'


class _Names(NamedTuple):
    """What the public functions of one model are made of."""

    prefix: str
    real: str
    n: int  # inputs
    q: int  # outputs
    argument: str
    verb: str
    out: str
    state: str  # declarations that evaluate() needs
    arm: str  # its arguments, each with its comma, or nothing
    none: str  # instead of variances
    trust: str

    @property
    def given(self):
        return f"const {self.real} {self.argument}[{self.n}]"


def _functions(body, name, real, std):
    """Public functions that compute."""
    arm = body.arm is not None
    state = "    struct arm_state arm;\n" * arm + f"    {real} trust;\n" * body.fades
    names = _Names(
        name,
        real,
        body.n_inputs,
        body.n_outputs,
        "joint_angles" if arm else "features",
        "correct" if body.corrects else "predict",
        "correction_mm" if body.corrects else "prediction",
        state,
        "&arm, " * arm,
        ", 0" * std,
        ", &trust" * body.fades,  # where a correction fades, evaluate() says what is left of it
    )
    functions = [_one_row(names, body), _many_rows(names)]
    functions += [_point(names)] * body.corrects
    functions += [_trust(names)] * body.fades
    functions += [_one_row_with_std(names, body.corrects)] * std
    return functions


def _one_row(names, body):
    upper = names.prefix.upper()
    status = (
        f"Returns {upper}_OK, or {upper}_NOT_FINITE where all are NaN: an input\n"
        "   is NaN or infinite, or the model is not defined there."
    )
    if body.fades:
        status += (
            f" {upper}_FADED: the model\n   is less certain of this pose than the residuals that "
            "it was fitted on are large."
        )
    about = f"What the model predicts from {names.argument.replace('_', ' ')}.\n   {status}"
    if body.corrects:
        unit = "degrees" if body.angle_unit == "deg" else "rad"
        then = f";\n   then {', '.join(map(plain, body.extra))}" if body.extra else ""
        about = (
            "How far off the probe is, in the base frame, mm: subtract it from the measured\n"
            f"   point. Joint angles in {unit}, as the encoders give them{then}.\n   {status}"
        )
    return Function(
        f"int {names.prefix}_{names.verb}({names.given}, {names.real} {names.out}[{names.q}])",
        about,
        f"{names.state}    return evaluate({names.argument}, {names.arm}{names.out}{names.none}"
        f"{names.trust});\n",
    )


def _many_rows(names):
    prefix, real, n, q, argument, verb, out, *_ = names
    return Function(
        f"int {prefix}_{verb}_n(const {real} *{argument}, {real} *{out}, size_t n)",
        f"The same for n rows of {n} numbers, one after the other; {out} has n rows of {q}.\n"
        "   Returns the largest status of a row.",
        f"    int status = 0;\n    for (size_t i = 0; i < n; ++i) {{\n"
        f"        const int one = {prefix}_{verb}({argument} + i * {n}, {out} + i * {q});\n"
        "        status = one > status ? one : status;\n    }\n    return status;\n",
    )


def _point(names):
    return Function(
        f"int {names.prefix}_point({names.given}, {names.real} point_mm[3])",
        "The corrected centre of the probe in the base frame, mm; status and NaN as above.",
        f"{names.state}    {names.real} y[3];\n"
        f"    const int status = evaluate({names.argument}, {names.arm}y{names.none}"
        f"{names.trust});\n"
        "    for (int k = 0; k < 3; ++k)\n        point_mm[k] = arm.probe[k] - y[k];\n"
        "    return status;\n",
    )


def _trust(names):
    return Function(
        f"{names.real} {names.prefix}_trust({names.given})",
        "The share of the correction that the fading leaves, of its stages the smallest: 1 "
        "where\n   the model knows the pose, 0 far away, NaN as above.",
        f"{names.state}    {names.real} y[{names.q}];\n"
        f"    (void)evaluate({names.argument}, {names.arm}y{names.none}{names.trust});\n"
        "    return trust;\n",
    )


def _one_row_with_std(names, corrects):
    prefix, real, _, q, argument, verb, out, state, arm, _, trust = names
    spread = "std_mm" if corrects else "std"
    root = f"sqrt{'f' if real == 'float' else ''}"
    return Function(
        f"int {prefix}_{verb}_std({names.given}, {real} {out}[{q}], {real} {spread}[{q}])",
        "The same with its standard deviation, as predict(return_std=True) gives it: it "
        "grows\n   away from the poses that the model was fitted on.",
        f"{state}    const int status = evaluate({argument}, {arm}{out}, {spread}{trust});\n"
        f"    for (int j = 0; j < {q}; ++j)\n"
        f"        {spread}[j] = {root}({spread}[j]);\n    return status;\n",
    )
