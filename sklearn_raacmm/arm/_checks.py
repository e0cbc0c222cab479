"""What an arm accepts: numbers, bounds, angles; each fault gets one clear sentence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.utils import Finding, floats, say_findings, show

# Two whole turns: multi-turn encoders pass, a log in degrees hardly ever does.
_WARN_RAD = 4 * np.pi
# Degrees of real poses are larger than one turn in radians in some joint. Joints of less than 0.2
# degrees stand still, and an arm that moves one joint only may stay near its zero.
_WARN_DEG, _STANDS_STILL_DEG = 2 * np.pi, 0.2
# Ten turns: no arm's encoder counts as many, and no log in degrees holds them.
_ABSURD_DEG = 3600.0
# 100 m: larger than any arm, small enough to catch micrometres or encoder counts given as mm.
MAX_LENGTH_MM = 1e5
# A nanometre: on any arm, shorter lengths and their directions are made of rounding.
MIN_LENGTH_MM = 1e-6


def numbers(name, value, size, unit, bound, broadcast=False):
    """One finite float64 per joint, read-only."""
    array = floats(name, value)
    if broadcast and array.ndim == 0:
        array = np.broadcast_to(array, size)
    if array.ndim != 1 or not array.size or size not in (None, array.size):
        wanted = "one number per joint" if size is None else f"{size} numbers"
        raise ValueError(f"{name} must hold {wanted}, got shape {array.shape}.")
    if not np.all(np.abs(array) <= bound):  # false for NaN, too
        i = int(np.argmin(np.abs(array) <= bound))
        hint = ", or are they degrees? See Arm.from_degrees" if unit == "rad" else ""
        raise ValueError(
            f"{name}[{i}] = {array[i]:g} is out of bounds: it must be finite and at most "
            f"{bound:g} {unit}".rstrip()
            + f"{hint}."
        )
    array = array + 0.0  # a copy of our own, in which -0.0 is 0.0: they are the same arm
    array.flags.writeable = False
    return array


def pair_of(name, value, low, high):
    """Two different whole numbers."""
    try:
        pair = tuple(value)
        whole = all(not isinstance(v, bool | str) and int(v) == v for v in pair)
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole or len(pair) != 2 or not all(low <= v <= high for v in pair) or len({*pair}) < 2:
        raise ValueError(
            f"{name} must be two different whole numbers from {low} to {high}, got {show(value)}."
        )
    return tuple(int(v) for v in pair)


def check_angles(angles, n_joints, angle_unit):
    """Angles (n_samples, n_joints) as float64 in rad, or one clear sentence.

    Warns where the unit is most likely another one: degrees given as radians or the reverse.
    """
    if not (isinstance(angle_unit, str) and angle_unit in ("rad", "deg")):
        raise ValueError(f"angle_unit must be 'rad' or 'deg', got {show(angle_unit)}.")
    angles = floats("angles", angles)
    if angles.ndim != 2 or angles.shape[1] != n_joints:
        raise ValueError(
            f"angles must have shape (n_samples, {n_joints}) for an arm of "
            f"{n_joints} joints, got {angles.shape}."
        )
    if not len(angles):
        return angles
    # Max and min carry NaN along: one pass each, and no mask of the size of the data.
    if angle_unit == "rad" and max(angles.max(), -angles.min()) <= _WARN_RAD:  # false for NaN
        return angles
    largest = np.maximum(angles.max(axis=0), -angles.min(axis=0))
    if not np.all(np.isfinite(largest)):
        bad = np.argwhere(~np.isfinite(angles))
        row, column = bad[0]
        raise ValueError(
            f"angles hold {len(bad)} NaN or infinite values; the first is "
            f"{angles[row, column]} in row {row}, joint {column + 1}."
        )
    joint = int(largest.argmax()) + 1
    reach = f"{largest.max():g}"
    if angle_unit == "rad":  # more than two turns
        _say(
            f"angles reach {reach} rad (joint {joint}), more than two turns:",
            'if they are degrees, convert them or pass angle_unit="deg".',
            joints=(joint,),
        )
        return angles
    if largest.max() > _ABSURD_DEG:
        _say(
            f"angles reach {reach} degrees (joint {joint}), more than ten turns:",
            "are they counts of the encoders? Convert them to degrees.",
            "repair",
            joints=(joint,),
        )
    if largest.max() < _WARN_DEG and np.sum(largest > _STANDS_STILL_DEG) > 1:
        _say(
            f"angles in degrees reach {reach} only (joint {joint}):",
            'if they are radians, pass angle_unit="rad".',
            joints=(joint,),
        )
    return np.deg2rad(angles)


def _say(text, advice, weight="doubt", joints=()):
    say_findings([Finding("angle-unit", text, advice, weight, joints=joints)])
