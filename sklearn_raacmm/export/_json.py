"""A program as JSON: readable in any language, exact, and checked when it is read."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._program import Builder, fingerprint_of, run
from sklearn_raacmm.export._proof import rows_of_dict

FORMAT, FORMAT_VERSION = "sklearn_raacmm.Program", 2
# What content that is no program raises.
_UNREADABLE = (TypeError, KeyError, IndexError, AttributeError, ValueError, OverflowError)


class ExportedModel:
    """A model that was read from JSON: it predicts, and that is all that it does.

    Attributes
    ----------
    fingerprint : str
        As :func:`fingerprint` gives it.

    n_features_in_, n_outputs_ : int
        Numbers of a row of X, and of a prediction.

    about : dict
        Plain facts: steps, arm, angle unit, names of columns after the angles.

    test_rows : dict
        X, y and, where the file has it, std: rows with what ``predict`` gave for them; NaN where
        it refuses.
    """

    def __init__(self, program: Any, test_rows: dict[str, Any]) -> None:
        self._program = program
        self.test_rows: dict[str, Any] = test_rows
        self.about: dict[str, Any] = program.about
        self.fingerprint: str = fingerprint_of(program)
        self.n_features_in_: int = program.n_inputs
        self.n_outputs_: int = program.n_outputs

    def predict(self, X: ArrayLike, return_std: bool = False) -> Any:
        """What ``predict`` of the model gave.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)

        return_std : bool, default=False
            Also return standard deviations, if the file has them.

        Returns
        -------
        y, std : ndarray of shape (n_samples, n_outputs), or (n_samples,)
            NaN in rows where ``predict`` raises; std where asked for.

        Raises
        ------
        ValueError
            If X has another number of columns, or there is no standard deviation in the file.
        """
        found = self._run(X)
        if return_std and "std" not in found:
            raise ValueError("The file has no standard deviation: write it with std=True.")
        return (found["y"], found["std"]) if return_std else found["y"]

    def trust(self, X: ArrayLike) -> Any:
        """Share of each correction that its fading leaves, (n_samples,); 1 where nothing fades."""
        found = self._run(X)
        return found["trust"][:, 0] if "trust" in found else np.ones(len(found["y"]))

    def _run(self, X):
        X = np.asarray(X, dtype=float)
        if X.ndim != 2 or X.shape[1] != self.n_features_in_:
            n = self.n_features_in_
            raise ValueError(f"The model takes rows of {n} numbers, (n, {n}); got shape {X.shape}.")
        found = run(self._program, X)
        if self.about.get("flat"):
            found |= {name: found[name][:, 0] for name in ("y", "std") if name in found}
        return found


def text_of(program, rows):
    """JSON text of a program, with test rows."""
    arrays, places, operations = [], {}, []
    for op in program.ops[1:]:
        given = {}
        for key, value in op.given.items():
            if isinstance(value, str):
                given[key] = value
                continue
            mark = (value.shape, value.dtype.kind, value.tobytes())
            if mark not in places:
                places[mark] = len(arrays)
                arrays.append(value.tolist())
            given[key] = places[mark]
        operations.append([op.name, list(op.inputs), given])
    head = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "written_by": f"sklearn_raacmm {__version__}",
        "about": program.about,
        "fingerprint": fingerprint_of(program),
        "n_inputs": program.n_inputs,
        "outputs": program.outputs,
        "test_rows": rows,
        "operations": operations,
        "arrays": arrays,
    }
    lines = {key: json.dumps(value, allow_nan=False) for key, value in checked(head).items()}
    for key in ("operations", "arrays"):  # a line for each of them
        entries = (json.dumps(entry, allow_nan=False) for entry in head[key])
        lines[key] = "[\n  " + ",\n  ".join(entries) + "\n ]"
    return "{\n" + ",\n".join(f' "{key}": {line}' for key, line in lines.items()) + "\n}\n"


def checked(head):
    """The content with its checksum."""
    return {**head, "checksum": _checksum(head)}


def _checksum(head):
    """SHA-256 of all else in the file, with sorted keys and without spaces."""
    content = {key: value for key, value in head.items() if key != "checksum"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _content(text, where):
    """The content of a file, if it is whole."""
    try:
        head = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{where} is not valid JSON: {error}.") from None
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise ValueError(f"{where} is not a model: its format is not {FORMAT!r}.")
    if head.get("format_version") != FORMAT_VERSION:
        raise ValueError(
            f"{where} has format_version {head.get('format_version')!r:.60}, this version reads "
            f"{FORMAT_VERSION}."
        )
    try:
        found = _checksum(head)
    except (ValueError, RecursionError) as error:  # as 1e999, which is read as infinity
        raise ValueError(f"{where} holds a number that is not finite: {error}.") from None
    if head.get("checksum") != found:
        raise ValueError(f"{where} is damaged: its checksum is not that of its content.")
    return head


def program_of_text(text, where="the JSON text"):
    """Program and test rows of a JSON text; ValueError with one sentence."""
    head = _content(text, where)
    try:
        program, rows = _program(head), rows_of_dict(head["test_rows"])
    except _UNREADABLE as error:
        # Text that whoever wrote the checksum has made, too: say what is wrong with it.
        said = f"{error}" if isinstance(error, ValueError) else f"{type(error).__name__} {error}"
        raise ValueError(f"{where} holds no model that can be built: {said}") from None
    return program, rows


def _program(head):
    arrays = [np.asarray(value) for value in head["arrays"]]
    for number, array in enumerate(arrays):
        if array.dtype.kind not in "if":
            raise ValueError(f"array {number} holds something that is no number")
    n_inputs = head["n_inputs"]
    if not (isinstance(n_inputs, int) and n_inputs > 0):
        raise ValueError(f"n_inputs must be a positive whole number, got {n_inputs!r:.60}")
    builder = Builder(n_inputs)
    for number, (name, inputs, given) in enumerate(head["operations"], start=1):
        for i in inputs:
            if not (isinstance(i, int) and 0 <= i < number):
                raise ValueError(
                    f"operation {number} takes value {i!r:.60}, which is not before it"
                )
        given = {k: v if isinstance(v, str) else arrays[v] for k, v in given.items()}
        builder.append(name, tuple(inputs), given)
    outputs = head["outputs"]
    for name, i in outputs.items():
        if not (isinstance(i, int) and 0 <= i < len(builder.ops)):
            raise ValueError(f"output {name!r:.60} is value {i!r:.60} of {len(builder.ops)}")
    if "y" not in outputs or not isinstance(head["about"], dict):
        raise ValueError("there is no output y, or nothing about the model")
    program = builder.program(outputs, head["about"])
    if head["fingerprint"] != fingerprint_of(program):
        raise ValueError(
            f"its fingerprint is {head['fingerprint']!r:.60}, that of its operations is "
            f"{fingerprint_of(program)}"
        )
    return program


def _refuse_constant(name):
    raise ValueError(f"{name} is no number of JSON")
