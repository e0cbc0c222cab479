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
    """Refuse arrays that do not fit together, or hold NaN or infinity.

    A file that lost a row would load, and fail in the first product of matrices.

    Parameters
    ----------
    owner : str
        Whose arrays they are, for the message.
    values : dict of str to ndarray
    shapes : dict of str to tuple
        Dimensions of each array: whole numbers, or names of sizes. A size that is not given is that
        of the first array that has it.
    sizes : dict of str to int
        Sizes that are known.
    may_be_infinite : tuple of str
        Arrays in which infinity is allowed.

    Raises
    ------
    ValueError
        If an array is missing, has another shape, or holds what it must not.
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
