"""Points of known places, such as the balls of a plate, as lengths that are known."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from sklearn_raacmm.utils import floats, listed


def lengths_of_places(places: Iterable[Sequence[Any]]) -> list[Any]:
    """Known lengths between points of known places, wherever their frame stands.

    For a ball plate or a grid of cones with a certificate: where the plate lies need not be known.

    Parameters
    ----------
    places : iterable of (label, x, y, z, standard deviation)
        Position of each point in the frame of the certificate and the standard deviation of a
        coordinate, mm.

    Returns
    -------
    list of (label, label, length, standard deviation)
        Of every pair, as :func:`calibrate` and :func:`learn_correction` take them.

    Raises
    ------
    ValueError
        If an entry is not of this form, there are fewer than two, or one label comes twice.

    Notes
    -----
    Of n points the pairs are not independent. Each is given n / 2 times the variance of its own two
    ends: the sum over the pairs is then that over the points about their mean, so that the scale is
    known as well as a least-squares fit of the plate shows it.

    Examples
    --------
    >>> from sklearn_raacmm import lengths_of_places
    >>> lengths_of_places([("A", 0, 0, 0, 0.003), ("B", 300, 400, 0, 0.004)])
    [('A', 'B', 500.0, 0.005)]
    """
    places = listed("places", places)
    if not all(
        isinstance(entry, tuple | list | np.ndarray) and len(entry) == 5 for entry in places
    ):
        raise ValueError(
            f"each of places must be (label, x, y, z, standard deviation), got {places!r:.60}."
        )
    labels = [entry[0] for entry in places]
    if len(places) < 2 or len(set(labels)) < len(labels):
        raise ValueError(
            f"places need two different labels or more, each once, got {labels!r:.60}."
        )
    values = floats("places", [list(entry[1:]) for entry in places])
    if not np.all(np.isfinite(values)) or not np.all(values[:, 3] > 0):
        raise ValueError("places need finite coordinates and standard deviations above 0, in mm.")
    found = []
    for i, j in combinations(range(len(places)), 2):
        length = float(np.linalg.norm(values[i, :3] - values[j, :3]))
        sd = float(np.hypot(values[i, 3], values[j, 3]) * np.sqrt(len(places) / 2))
        found.append((labels[i], labels[j], length, sd))
    return found
