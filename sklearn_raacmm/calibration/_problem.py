"""What a calibration has to explain: data, parameters, and what is known of them before."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass
from typing import Any

import numpy as np

from sklearn_raacmm.arm import FIELDS
from sklearn_raacmm.measurements import KINDS

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


@dataclass
class Problem:
    """Checked data of one calibration."""

    index: Any  # (n,) number of the fixed point of each row; None for measured points
    points: np.ndarray | None  # (n, 3) measured, mm
    lengths: list  # of (point, point, length, sd): known ones between two fixed points, mm
    correction: np.ndarray | None = None  # (n, 3) mm, subtracted from the arm's points
    tools: np.ndarray | None = None  # (n,) numbers; None where all rows share one
    stations: np.ndarray | None = None
    tool_labels: tuple = ()  # what the numbers stand for
    station_labels: tuple = ()
    features: list | None = None  # of (kind, None): what each index is; None where all are cones
    # Of each length, by how many mm it may be longer or shorter for the centre of the probe's ball.
    offsets: list | None = None

    def __post_init__(self) -> None:
        self.n_tools = 1 if self.tools is None else int(self.tools.max()) + 1
        self.n_stations, n_unknown = 0, 0
        self.n_shown: Any = 3  # coordinates that a row shows, one for all or (n,)
        self.offsets = [np.zeros(1)] * len(self.lengths) if self.offsets is None else self.offsets
        if self.points is not None:
            self.n_stations = 1 if self.stations is None else int(self.stations.max()) + 1
            self.informative = np.ones(len(self.points), dtype=bool)
        else:
            count = np.bincount(self.index)
            kinds = [KINDS[kind] for kind, _ in self.features or [("cone", None)] * len(count)]
            shown = np.array([kind.n_shown for kind in kinds])
            unknown = np.array([kind.n_unknowns for kind in kinds])
            # One point is its own mean: its zero residual must not pass for precision.
            used = count * shown > unknown
            self.informative, n_unknown = used[self.index], int(unknown[used].sum())
            if self.features:
                self.n_shown = shown[self.index]
        self.n_informative = int(self.informative.sum())
        # Coordinates that were measured, less those that the unknowns of what was touched take.
        of_rows = np.broadcast_to(self.n_shown, len(self.informative))
        self.n_coordinates = int(of_rows[self.informative].sum()) - n_unknown


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
