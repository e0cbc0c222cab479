"""What the fields of an arm accept: numbers, bounds, names; each fault gets one clear sentence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.utils import floats

_NO_LIMITS = (-np.inf, np.inf)
# 100 m: larger than any arm, small enough to catch micrometres or encoder counts given as mm.
MAX_LENGTH_MM = 1e5
# Largest departure of a matrix from a rotation.
_ROTATION = 1e-5
# A nanometre: on any arm, shorter lengths and their directions are made of rounding.
MIN_LENGTH_MM = 1e-6


def check_types(value, n):
    """A letter for each joint, as one string: R where it turns, P where it slides."""
    types = "R" * n if value is None else "".join(map(str, value)).upper()
    if len(types) != n or set(types) - {"P", "R"}:
        raise ValueError(
            f"joint_types must have a letter for each of {n} joints, R where it turns and P where "
            f"it slides, such as {'PRRRRRRR'[:n]!r}, got {value!r:.60}."
        )
    return types


def check_couplings(value, n, types):
    """Triples of two different joints of one kind, from 1, and 1 or -1."""
    couplings = tuple(tuple(one) for one in value)
    joints = [str(i) for i in range(1, n + 1)]
    for one in couplings:
        good = len(one) == 3 and one[2] in (1, -1) and one[0] != one[1]
        if not (good and {str(one[0]), str(one[1])} <= set(joints)):
            raise ValueError(
                f"couplings must hold triples of two different joints from 1 to {n} and 1 or -1, "
                f"such as (3, 2, 1), got {one!r:.60}."
            )
        if types[int(one[0]) - 1] != types[int(one[1]) - 1]:
            raise ValueError(
                f"couplings hold {one!r:.60}, but of joints {one[0]} and {one[1]} one turns and "
                "the other slides: rad and mm have no sum."
            )
    return tuple(sorted(tuple(map(int, one)) for one in couplings))


def check_numbers(name, value, size, unit, bound, broadcast=False):
    """One finite float64 per joint, read-only."""
    # The fields of an arm that a calibration changes are such arrays: they need no conversion.
    array = value if type(value) is np.ndarray and value.dtype == float else floats(name, value)
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
            f"{bound:g}{unit and ' '}{unit}{hint}."
        )
    array = array + 0.0  # a copy of our own, in which -0.0 is 0.0: they are the same arm
    array.flags.writeable = False
    return array


def check_direction(name, value):
    """A unit vector, read-only, of a vector of any length."""
    vector = check_numbers(name, value, 3, "", MAX_LENGTH_MM)
    length = np.linalg.norm(vector)
    if not length > MIN_LENGTH_MM:
        raise ValueError(f"{name} must be a vector with a direction, got {value!r:.60}.")
    if abs(length - 1) > 4 * np.finfo(float).eps:  # a unit vector stays the same to the last bit
        vector = vector / length
        vector.flags.writeable = False
    return vector


def check_names(names, n):
    """Names of the joints: none, or a different one for each."""
    given = tuple(names) if isinstance(names, list | tuple) else ("",)
    whole = all(name and is_name(name) for name in given)
    if not whole or len(given) not in (0, n) or len(set(given)) < len(given):
        raise ValueError(f"names must be {n} different names of joints, got {names!r:.60}.")
    return given


def is_name(value):
    """Whether a value is a string of whole characters, which can be written to a file."""
    # Unpaired surrogates, which only escapes in JSON can bring, cannot.
    return isinstance(value, str) and not any("\ud800" <= c <= "\udfff" for c in value)


def check_limits(limits, n):
    """Lower and upper limit of each joint, rad or mm, read-only; None where there are none."""
    if limits is None:
        return None
    if isinstance(limits, list | tuple):  # None, where a file cannot hold infinity
        limits = [
            [end if value is None else value for end, value in zip(_NO_LIMITS, pair, strict=False)]
            for pair in limits
        ]
    limits = floats("limits", limits, (n, 2)) + 0.0
    wrong = ~(limits[:, 0] <= limits[:, 1])  # true for NaN, too
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise ValueError(f"limits of joint {i + 1} must go from low to high, got {limits[i]}.")
    if not np.isfinite(limits).any():
        return None
    limits.flags.writeable = False
    return limits


def are_rotations(turns: np.ndarray) -> np.ndarray:
    """Whether matrices (..., 3, 3) are rotations, of which six digits may have been written."""
    off = np.abs(turns @ turns.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2))
    return (off < _ROTATION) & (np.linalg.det(turns) > 0)


def check_pair(name, value, low, high):
    """Two different whole numbers."""
    pair = floats(name, value)
    fits = (pair == np.round(pair)) & (low <= pair) & (pair <= high)
    if pair.shape != (2,) or not fits.all() or pair[0] == pair[1]:
        raise ValueError(
            f"{name} must be two different whole numbers from {low} to {high}, got {value!r:.60}."
        )
    return tuple(pair.astype(int).tolist())
