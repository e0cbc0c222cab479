"""Deviations of a single-point test beside the arm's own points: what was done to them, exactly."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np

from sklearn_raacmm.arm import Arm, parameter_jacobian, points_of, reach_mm
from sklearn_raacmm.utils import Finding, align, row_numbers

# What deviations are made of is met by this share of the differences between two rows, to this part
# of their median; rows that are looked at have to be so many.
_SHARE, _EXACT, _LEAST_PAIRS = 0.9, 0.05, 8
# Positions that deviate by more of the reach had no cone, and of deviations that are explained by
# less than this share of their squares the rows are not related. Of four real arms and of simulated
# ones all are explained.
_ONE_CONE, _RELATED = 0.01, 0.25
UNITS = {25.4: "inches", 10.0: "centimetres", 1000.0: "metres", 1e-3: "micrometres"}
# What another model has left of deviations looks like these, and is a legitimate target of a fit.
_MAYBE_MEANT = ("other-table", "rows-unrelated")
_FILES = "Are angles and points from two files, of which one has a row more, or another order?"
WORDS = {
    "sign-of-residuals": (
        "their sign is wrong, or they were corrected twice",
        "Give measured minus reference.",
    ),
    "corrected-already": (
        "they have been corrected already",
        "Give what the arm shows without the correction: result.residuals(angles, points), not "
        "result.residuals_mm.",
    ),
    "unit-of-residuals": ("they are in {}", "Give millimetres."),
    "axes-of-residuals": (
        "their axes are others: {}",
        "Give residuals in the arm's base frame, x, y and z in this order.",
    ),
    "rows-shifted": ("they are of the row {}", _FILES),
    "rows-unrelated": ("they do not belong to the angles of their rows", _FILES),
    "joints": ("of the angles, {}", "Look at the order and the sense of the joints."),
    "other-table": (
        "they are of another table of this arm, such as the nominal one",
        "Take the arm that the model was fitted with, model.arm_.",
    ),
    "another-arm": (
        "they are of another arm",
        "Are they of this arm, and of the table that the model was fitted with?",
    ),
}


def of_own_points(
    y: np.ndarray,
    codes: np.ndarray,
    arm: Arm,
    angles: np.ndarray,
    numbers: np.ndarray,
    probes: Any = None,
    expected: Any = None,
) -> tuple[bool, list[Finding]]:
    """Whether deviations (n, 3) of a single-point test are of the arm's points, and what was done.

    They are those of the arm's own points from where each position is, to the last digit: what else
    explains their differences from row to row is what was done to them. `numbers` (n,) are what the
    rows are called; `expected` (n, 3) in mm is what a correction says; None: there is none.
    """
    code, what, first = _what_was_done(y, codes, arm, angles, probes, expected)
    if code in ("", "as given"):
        return bool(code), []
    row = row_numbers(numbers[[first]])
    what += f", from row {row[0]} on" * (first > 0)
    said, advice = WORDS[code]
    text = "Beside the arm's own points at these angles, y are deviations from positions only if"
    if code == "rows-unrelated":
        text = "y are not the deviations of the arm's own points at these angles:"
    finding = Finding(
        code,
        f"{text} {said.format(what)}.",
        advice,
        "doubt" if expected is None and code in _MAYBE_MEANT else "repair",
        rows=row if first else (),
        size_mm=float(np.sqrt(np.square(y).sum(axis=1).mean())),
    )
    return False, [finding]


def _what_was_done(y, codes, arm, angles, probes, expected):
    """Code, words and first row of what makes y of the arm's points; no code where nothing does."""
    order = np.argsort(codes, kind="stable")
    pairs = np.stack([order[:-1], order[1:]])[:, np.diff(codes[order]) == 0]
    steps = y[pairs[1]] - y[pairs[0]]
    usual = np.median(np.linalg.norm(steps, axis=1)) if steps.shape[0] >= _LEAST_PAIRS else 0.0
    if not usual > 0:
        return "", "", 0

    def explained(values):  # (n_pairs,)
        left = values[pairs[1]] - values[pairs[0]] - steps
        return np.linalg.norm(left, axis=1) < _EXACT * usual

    own = points_of(arm, angles, probes)
    as_given, shown = explained(own), own[pairs[1]] - own[pairs[0]]
    if as_given.mean() >= _SHARE:
        return "as given", "", 0
    for code, what, values in _candidates(own, shown, steps, expected):
        if explained(values).mean() >= _SHARE:
            return code, what, 0
    for words, changed in changed_joints(angles, arm.n_joints):
        if explained(points_of(arm, changed, probes)).mean() >= _SHARE:
            return "joints", words, 0
    # Any deviations are those of some table where there are few.
    jac = parameter_jacobian(arm, angles)[1]
    if pairs.shape[1] > jac.shape[2]:
        slope = (jac[pairs[1]] - jac[pairs[0]]).reshape(-1, jac.shape[2])
        table = np.linalg.lstsq(slope, (steps - shown).ravel())[0]
        if explained(own + jac @ table).mean() >= _SHARE:
            return "other-table", "", 0
    for late, word in ((1, "before"), (-1, "after")):
        rows = np.roll(np.arange(len(y)), late)
        some = np.flatnonzero(codes[rows[pairs[0]]] == codes[rows[pairs[1]]])
        some = some[np.argsort(pairs[0][some])]  # in the order of the rows
        shifted = explained(own[rows])[some]
        first = int(np.argmax(np.r_[0, np.cumsum(as_given[some].astype(int) - shifted)]))
        right = np.r_[as_given[some[:first]], shifted[first:]]
        if first < len(right) >= _LEAST_PAIRS and right.mean() >= _SHARE:
            return "rows-shifted", word, int(pairs[0][some[first]]) if first else 0
    coincide = np.median(np.linalg.norm(shown, axis=1)) < _ONE_CONE * reach_mm(arm)
    related = np.vdot(steps, shown) ** 2
    related /= max(np.vdot(shown, shown) * np.vdot(steps, steps), 1e-300)
    return ("rows-unrelated" if coincide and related < _RELATED else ""), "", 0


def _candidates(own, shown, steps, expected):
    """Yield code, words and what deviations would then be of, up to constants."""
    sizes = [np.median(np.linalg.norm(values, axis=1)) for values in (steps, shown)]
    factor = sizes[0] / max(sizes[1], 1e-300)
    sign = np.sign(np.vdot(shown, steps)) or 1.0
    unit = min(UNITS, key=lambda one: abs(np.log(factor * one)))
    named = UNITS[unit] if abs(np.log(factor * unit)) < _EXACT else f"a unit {factor:.4g} times mm"
    code = "sign-of-residuals" if sign < 0 else "unit-of-residuals"
    yield "as given" if abs(sign * factor - 1) < _EXACT else code, named, sign * factor * own
    for times, code in enumerate(("corrected-already", "sign-of-residuals"), 1):
        if expected is not None:
            yield code, "", own - times * expected
    for mirror in (1.0, -1.0):
        turn = align(mirror * shown, steps)[0] * mirror
        yield "axes-of-residuals", _in_words(turn), own @ turn.T


def _in_words(turn):
    """An exchange of axes by name, or that they are turned."""
    near = np.round(turn)
    if np.abs(turn - near).max() > _EXACT:
        return "they are turned" + " and mirrored" * bool(np.linalg.det(turn) < 0)
    return " ".join("-"[: int(row.sum() < 0)] + "xyz"[int(np.argmax(np.abs(row)))] for row in near)


def changed_joints(angles: np.ndarray, n: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield what may have been done to the angles (n_samples, n or more), and how they were."""
    for i, j in combinations(range(n), 2):
        order = np.arange(angles.shape[1])
        order[[i, j]] = j, i
        yield f"joints {i + 1} and {j + 1} are exchanged", angles[:, order]
    for i in range(n):
        signs = np.ones(angles.shape[1])
        signs[i] = -1
        yield f"joint {i + 1} is reversed", angles * signs
