"""The parameters of a calibration, and what is known of them before."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np

from sklearn_raacmm.arm import FIELDS

# Kinds of parameters, by the name of their prior standard deviation, and how it is found: a guess,
# how many parameters that were seen the guess is worth, and its bounds
# (``benchmarks/bench_lengths.py scale``).
FOUND: dict[str, Any] = {
    "length_mm": (0.4, 1.0, 0.01, 10.0),
    "angle_rad": (0.003, 4.0, 1e-4, 0.02),
    "probe_mm": None,
    "short_length_mm": (0.3, 4.0, 0.01, 100.0),
}
# A long length has at least this part of the longest.
_LONG_SHARE = 0.25
# What counts as knowing nothing of the place of base and probe, mm at the probe. Any larger number
# gives the same: nine freedoms that a few poses determine.
UNKNOWN_PLACE_MM = 1000.0


def rows_of(numbers, one):
    """Rows of one tool or station, by the number of each row (n,), or None: all are."""
    return slice(None) if numbers is None else np.flatnonzero(numbers == one)


def pack(arm):
    """The arm's parameters as one vector (4 n_joints + 3,)."""
    return np.concatenate([getattr(arm, name) for name in FIELDS])


def unpack(x, n_joints, tool=0) -> dict[str, Any]:
    """The parameters of one vector by their names; further tools follow the first one's probe."""
    start = 4 * n_joints
    parts = [*np.split(x[:start], 4), x[start + 3 * tool :][:3]]
    return dict(zip(FIELDS, parts, strict=True))


def in_brackets(labels, n):
    """What follows the names of the parameters of each of n tools or stations."""
    return [f"[{label}]" for label in labels] or [""] * n


def are_long(lengths):
    """Which of the lengths of a table carry its scale, (n,); mm."""
    size = np.abs(lengths)
    return size >= _LONG_SHARE * size.max()
