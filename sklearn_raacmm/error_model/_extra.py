"""Columns of X after the joint angles: temperatures, directions and forces."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from typing import Any

import numpy as np

from sklearn_raacmm.utils import Finding, row_numbers

# What a column may be: the word, and behind some the number of a joint or an axis.
_NAME = re.compile(
    r"(?:temperature|time|payload)|(?:temperature|direction)\s+(?P<joint>\d+)|force\s+(?P<axis>[xyz])"
)
_FORMS = (
    '"temperature", "temperature J", "direction J" (J the number of a joint from 1), "time", '
    '"payload", "force x", "force y", "force z"'
)

# Part of the range of a column in the fit by which values may lie beyond it without a word.
_BEYOND = 0.5
# For names that are read before the arm is known.
_MOST_JOINTS = 10**6


def parsed(name, n_joints):
    """Kind of an extra column, and which joint (from 0) or axis (0 to 2) it is of; -1: of all."""
    found = _NAME.fullmatch(name.strip()) if isinstance(name, str) else None
    if found is None:
        raise ValueError(f"extra must hold names of columns, {_FORMS}; got {name!r:.60}.")
    kind, joint, axis = name.split()[0], found["joint"], found["axis"]
    if joint and not 1 <= int(joint) <= n_joints:
        raise ValueError(f"extra names {name!r}, but the arm has joints 1 to {n_joints}.")
    return kind, "xyz".index(axis) if axis else int(joint or 0) - 1


def check_extra(extra: Any, n_joints: int = _MOST_JOINTS) -> Any:
    """Names of the extra columns as a tuple: each is known, and none stands there twice."""
    if isinstance(extra, str):
        raise ValueError(f"extra must be a list of names, one for each column, got {extra!r:.60}.")
    names = tuple(extra)
    found = [parsed(name, n_joints) for name in names]
    for i, one in enumerate(found):
        if one in found[:i]:
            raise ValueError(f"extra names {names[i]!r} twice.")
    return names


def with_references(extra, values, weights):
    """Names of the extra columns with what the training data (n, n_extra) say of them.

    Pairs of a name and numbers: the weighted mean, from which the model counts, the least and the
    largest value.
    """
    used, found = weights > 0, []
    for name, column in zip(extra, values[used].T, strict=True):
        numbers = np.average(column, weights=weights[used]), column.min(), column.max()
        found.append((name, tuple(map(float, numbers))))
    return tuple(found)


def warn_of_constants(extra, values, weights):
    """Warn of extra columns from which nothing can be learnt."""
    for name, column in zip(extra, values[weights > 0].T, strict=True):
        if np.ptp(column) == 0:
            said = (
                f"The extra column {name!r} is {column[0]:g} in all rows: nothing can be learnt "
                "of it, and predictions will not depend on it."
            )
            Finding("constant-column", said, "Does the sensor work?").report()


def check_values(extra, values):
    """Name values far beyond those of the fit.

    `extra` is as `with_references` has made it; `values` (n, n_extra).
    """
    for (name, known), column in zip(extra, values.T, strict=True):
        if len(known) < 3:  # the mean of many arms
            continue
        _, low, high = known
        margin = _BEYOND * (high - low)
        far = np.flatnonzero((column < low - margin) | (column > high + margin))
        if margin > 0 and len(far):
            rows = row_numbers(far)
            said = (
                f"The column {name!r} is {column[far[0]]:g} in row {rows[0]}, and in the fit it "
                f"was from {low:g} to {high:g}."
            )
            advice = "Does the sensor work, and is the unit the same as in the fit?"
            Finding("column-out-of-range", said, advice, rows=rows).report()
