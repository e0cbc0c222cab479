"""What a fitted model is, and what it was fitted on."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import contextlib
import hashlib
import json
import re
from typing import Any

import numpy as np
import sklearn
from numpy.typing import ArrayLike
from sklearn.utils import check_consistent_length

from sklearn_raacmm._version import __version__
from sklearn_raacmm.export._models import build_program
from sklearn_raacmm.export._steps import Chain
from sklearn_raacmm.utils import Groups, floats

# Characters shown of a text that comes from outside.
_LONGEST = 1000


class ModelCard(dict[str, Any]):
    """Facts about a model: plain numbers, text, lists and dicts, fit for ``json.dumps``.

    ``str(card)`` is Markdown. Text is escaped there and stays on its line: a name cannot pass for
    another fact.
    """

    def __str__(self) -> str:
        lines = ["# Residual correction of an arm", ""]
        for key, value in self.items():
            # The arm to 1e-9 mm and rad: its table is what the corrections belong to.
            digits = 17 if key == "arm" else 6
            if key in ("updates", "findings"):
                facts = map(_short, value)
            elif isinstance(value, dict):
                facts = _named(value, digits)
            else:
                lines += [f"- {fact}" for fact in _named({key: value})]
                continue
            lines += ["", f"## {_words(key)}", "", *(f"- {fact}" for fact in facts)]
        return "\n".join(lines) + "\n"


def _words(key):
    """A key as words; units stay as they are written."""
    words = escaped(key).split("_")
    unit = f", {words.pop()}" if words[-1] in ("mm", "rad", "deg") else ""
    return " ".join(words) + unit


def _named(facts, digits=6):
    return [f"{_words(name)}: {_short(fact, digits)}" for name, fact in facts.items()]


def _short(value, digits=6):
    if isinstance(value, float):
        return repr(round(value, 9) + 0.0) if digits >= 17 else f"{value:.{digits}g}"
    if isinstance(value, list):
        return ", ".join(_short(entry, digits) for entry in value)
    if isinstance(value, dict):
        return "; ".join(_named(value, digits))
    return "unknown" if value is None else escaped(value)


def escaped(text):
    """Text on one line, without control characters, that neither Markdown nor HTML reads as code.

    Of a longer one `_LONGEST` characters are shown, then "...".
    """
    # Nor ends of lines, surrogates, and formats that turn the direction of writing.
    line = "".join(c if c.isprintable() else " " for c in str(text))
    line = line if len(line) <= _LONGEST else line[:_LONGEST] + "..."
    line = re.sub(r"([\\`*\[\]|~#!]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9]))", r"\\\1", line)
    return line.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").strip()


def describe(
    model: object,
    X: ArrayLike | None = None,
    y: ArrayLike | None = None,
    groups: ArrayLike | None = None,
) -> ModelCard:
    """Say what a fitted model is, so that whoever receives its file knows.

    A fitted model does not keep the poses that it was fitted on: give them here, and pass the card
    on with the file.

    Parameters
    ----------
    model : estimator
        Fitted.

    X : array-like of shape (n_samples, n_features), default=None
        What the model was fitted on, usually joint angles in the unit it takes: for the number of
        rows, the range of every joint, and of the probe's distance and height.

    y : array-like of shape (n_samples, 3) or (n_samples,), default=None
        Residuals in mm that it was fitted on: for the fingerprint of the data.

    groups : array-like of shape (n_samples,), default=None
        Label of the position of each row.

    Returns
    -------
    ModelCard
        A dict of plain values, fit for JSON, to which more facts may be added, such as errors at
        positions left out: ``card["error"] = learned.scores.summary``. ``str`` of it is Markdown.
        ``data_fingerprint`` is the SHA-256 of the rows given.

    Raises
    ------
    ValueError
        If the arrays do not fit together or the model, or hold NaN or infinity.
    sklearn.exceptions.NotFittedError
        If the model is not fitted.

    Examples
    --------
    >>> from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> from sklearn_raacmm.export import describe
    >>> from sklearn.pipeline import make_pipeline
    >>> test = make_single_point(n_positions=6, n_poses=20, random_state=0)  # simulated
    >>> model = make_pipeline(
    ...     PoseFeatures(test.arm, append_azimuth=True),
    ...     CylindricalResidualTarget(RBFNetRegressor(20)),
    ... ).fit(test.data, test.target, cylindricalresidualtarget__groups=test.groups)
    >>> card = describe(model, test.data, test.target, test.groups)
    >>> card["training"]["positions"], card["input"]
    (6, '6 joint angles in rad')
    >>> print(str(card)[:32])
    # Residual correction of an arm
    """
    chain = Chain(model)
    if X is None and (y is not None or groups is not None):
        raise ValueError("y and groups describe rows of X, which is None.")
    try:
        arm, _ = chain.arm_and_unit
    except ValueError:  # an azimuth that is not an arm's, or two arms: not what can be described
        arm = None
    then = "".join(f", then {name}" for name, _ in chain.extra)
    card = ModelCard(
        written_by=f"sklearn_raacmm {__version__}, scikit-learn {sklearn.__version__}",
        fingerprint=None,
        steps=chain.described(),
        input=f"{chain.n_inputs} columns"
        if arm is None
        else f"{arm.n_joints} joint angles in {chain.units}{then}",
        output="residual of the probe in the base frame, mm: subtract it from the measured point"
        if arm is not None
        else "as fitted",
    )
    with contextlib.suppress(ValueError):  # a model that cannot be exported has none
        card["fingerprint"] = build_program(model).fingerprint
    if arm is not None:
        table = json.loads(arm.to_json())
        card["arm"] = {k: v for k, v in table.items() if not k.startswith("format")}
    last = chain.steps[-1][1]
    findings = vars(model).get("findings_") or vars(last).get("findings_", ())
    if findings:
        card["findings"] = [f"{finding.weight}: {finding}" for finding in findings]
    if updates := getattr(last, "updates_", ()):
        card["updates"] = [dict(entry) for entry in updates]
    if X is not None:
        card["training"] = _training(chain, arm, X, y, groups)
    return card


def _training(chain, arm, X, y, groups):
    """What the model was fitted on."""
    X = floats("X", X, -1)
    if X.shape[1] != chain.n_inputs:
        raise ValueError(
            f"X has {X.shape[1]} columns, but the model was fitted on {chain.n_inputs}."
        )
    codes = None if groups is None else Groups.encoded(groups, len(X))[1]
    if y is not None:
        y = floats("y", y, finite=True)
        check_consistent_length(X, y)
    # The numbers that the model was fitted on: float64 and int64, little-endian.
    digest = hashlib.sha256()
    for values, kind in ((X, "<f8"), (y, "<f8"), (codes, "<i8")):
        digest.update(repr(None if values is None else values.shape).encode())
        if values is not None:
            digest.update(np.ascontiguousarray(values, dtype=kind).tobytes())
    facts = {
        "rows": len(X),
        "positions": None if codes is None else int(codes.max()) + 1,
        "data_fingerprint": digest.hexdigest(),
    }
    if arm is None:
        return facts
    X, given = np.split(X, [arm.n_joints], axis=1)
    unit = chain.arm_and_unit[1]
    units = f"{unit}_and_mm" if arm.slides else unit
    facts[f"smallest_joint_angles_{units}"] = X.min(axis=0).round(4).tolist()
    facts[f"largest_joint_angles_{units}"] = X.max(axis=0).round(4).tolist()
    points = arm.forward(X, angle_unit=unit)
    names = (f"range_of_{name.replace(' ', '_')}" for name, _ in chain.extra)
    ranges = dict(zip(names, given.T, strict=True))
    ranges["distance_from_the_base_axis_mm"] = np.hypot(*points[:, :2].T)
    ranges["height_mm"] = points[:, 2]
    return facts | {key: [float(v.min()), float(v.max())] for key, v in ranges.items()}
