"""A known length between two positions, checked where it enters."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np

from sklearn_raacmm.arm import MAX_LENGTH_MM

# A picometre: smaller than any length is known, large enough to divide by.
_LEAST_SD_MM = 1e-9
# Lengths are stated at 20 degrees C (ISO 1). Steel grows by 11.5e-6 of itself per K (ISO 3650). No
# length is used so far from there, and no solid grows faster.
_REFERENCE_C, _STEEL = 20.0, 11.5e-6
_MOST_KELVIN, _MOST_EXPANSION = 60.0, 3e-4
_NO_GROWTH = (_REFERENCE_C, _STEEL)  # of an entry without temperature
# Labels that a message lists.
_LABELS_SHOWN = 12


def check_length(entry: Any, labels: Any) -> Any:
    """A known length as (position, position, length, sd), positions by their index.

    The length is that at the temperature of the entry, if it has one.
    """
    try:
        first, second, *numbers = entry
        length, sd, celsius, per_kelvin = map(float, [*numbers, *_NO_GROWTH[len(numbers) - 2 :]])
    except (TypeError, ValueError):
        raise ValueError(
            "each of lengths must be (label, label, length, standard deviation), and perhaps its "
            f"temperature and expansion, got {entry!r:.60}."
        ) from None
    if not (abs(celsius - _REFERENCE_C) <= _MOST_KELVIN and 0 <= per_kelvin <= _MOST_EXPANSION):
        raise ValueError(
            f"a length can be at {_REFERENCE_C - _MOST_KELVIN:g} to "
            f"{_REFERENCE_C + _MOST_KELVIN:g} degrees C and grow by 0 to {_MOST_EXPANSION:g} of "
            f"itself per K, got {entry!r:.60}."
        )
    length *= 1 + per_kelvin * (celsius - _REFERENCE_C)
    for label in (first, second):
        if label not in labels:
            some = ", ".join(map(str, labels[:_LABELS_SHOWN]))
            some += ", ..." * (len(labels) > _LABELS_SHOWN)
            raise ValueError(
                f"lengths name the group {label!r}, which has no samples; groups are {some}."
            )
    in_bounds = 0 < length <= 2 * MAX_LENGTH_MM and _LEAST_SD_MM <= sd < np.inf
    if not in_bounds or first == second:
        raise ValueError(
            f"a length must join two different groups, it must be positive and at most "
            f"{2 * MAX_LENGTH_MM:g} mm and its standard deviation at least {_LEAST_SD_MM:g} mm, "
            f"got {entry!r:.60}."
        )
    return labels.index(first), labels.index(second), length, sd
