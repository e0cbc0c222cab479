"""Arrays of a fitted object, checked when it comes out of a file."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Mapping
from typing import Any

import numpy as np


def check_shapes(
    owner: str,
    values: Mapping[str, Any],
    shapes: Mapping[str, tuple[Any, ...]],
    sizes: Mapping[str, int],
    may_be_infinite: tuple[str, ...] = (),
) -> None:
    """Refuse arrays that are missing, do not fit together, or hold NaN or infinity.

    A file that lost a row would load, and fail in the first product of matrices. Shapes are whole
    numbers or names of `sizes`; a size that is not given is that of the first array that has it.
    """
    sizes = dict(sizes)
    for name, shape in shapes.items():
        value = values.get(name)
        if value is None:
            raise ValueError(f"The file is damaged: {name} of {owner} is missing.")
        found = np.shape(value)
        if len(found) != len(shape):
            raise ValueError(f"The file is damaged: {name} of {owner} has shape {found}.")
        for have, size in zip(found, shape, strict=True):
            if isinstance(size, str):
                size = sizes.setdefault(size, have)
            if have != size:
                raise ValueError(
                    f"The file is damaged: {name} of {owner} has shape {found}, where {size} in "
                    f"place of {have} would fit the other arrays."
                )
        bad = np.isnan(value) if name in may_be_infinite else ~np.isfinite(value)
        if np.any(bad):
            raise ValueError(f"The file is damaged: {name} of {owner} holds NaN or infinity.")
