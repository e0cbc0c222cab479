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
    # Where an axis that slides begins, and its direction: a robot is put on a rail by eye.
    "slide_mm": (3.0, 1.0, 0.01, 100.0),
    "slide_rad": (0.005, 1.0, 1e-4, 0.1),
    "slide_scale": None,
}
# Standard deviation of the scale of a joint that slides, as a part of it: a choice.
SLIDE_SCALE = 3e-4
# A long length has at least this part of the longest.
LONG_SHARE = 0.25
# What counts as knowing nothing of the place of base and probe, mm at the probe. Any larger number
# gives the same: nine freedoms that a few poses determine.
UNKNOWN_PLACE_MM = 1000.0


def rows_of(numbers, one):
    """Rows of one tool or station, by the number of each row (n,), or None: all are."""
    return slice(None) if numbers is None else np.flatnonzero(numbers == one)


def pack(arm):
    """The arm's parameters as one vector: the table, scales of what slides, and the probe."""
    table = [getattr(arm, name) for name in FIELDS[:-1]]
    return np.concatenate([*table, np.abs(arm.joint_signs[arm.slides]), arm.probe])


def unpack(x, arm, tool=0) -> dict[str, Any]:
    """The parameters of one vector by their names; further tools follow the first one's probe."""
    start, slides = 4 * arm.n_joints, arm.slides
    parts = [*np.split(x[:start], 4), x[start + len(slides) + 3 * tool :][:3]]
    found: dict[str, Any] = dict(zip(FIELDS, parts, strict=True))
    if slides:
        signs = np.sign(arm.joint_signs)
        signs[slides] *= x[start : start + len(slides)]
        found["joint_signs"] = signs
    return found


def table_jacobian(arm, angles):
    """Points (n, 3) in mm, and their derivatives (n, 3, n_parameters) by what `pack` holds."""
    points, jac = arm.parameter_jacobian(angles)
    if slides := arm.slides:
        n = len(arm.a)
        along = jac[:, :, 2 * n : 3 * n][:, :, slides]
        scales = along * (np.sign(arm.joint_signs) * arm.own_angles(angles))[:, None, slides]
        jac = np.concatenate([jac[:, :, : 4 * n], scales, jac[:, :, 4 * n :]], axis=2)
    return points, jac


def in_brackets(labels, n):
    """What follows the names of the parameters of each of n tools or stations."""
    return [f"[{label}]" for label in labels] or [""] * n


def are_long(lengths):
    """Which of the lengths of a table carry its scale, (n,); mm."""
    size = np.abs(lengths)
    return size >= LONG_SHARE * size.max()
