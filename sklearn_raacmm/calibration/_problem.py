"""What a calibration has to explain: data, parameters, and what is known of them before."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sklearn_raacmm.arm import FIELDS, parameter_jacobian

# What `calibrate` starts from: standard deviation, how many parameters it is worth, and its bounds.
# Of long lengths, of short ones, and of angles (``benchmarks/bench_lengths.py scale``).
LONG_MM, SHORT_MM, ANGLES_RAD = (
    (0.4, 1.0, 0.01, 10.0),
    (0.3, 4.0, 0.01, 100.0),
    (0.003, 4.0, 1e-4, 0.02),
)
# A long length has at least this part of the longest.
_LONG_SHARE = 0.25
# What counts as knowing nothing of the place of base and probe, mm at the probe. Any larger number
# gives the same: nine freedoms that a few poses determine.
UNKNOWN_PLACE_MM = 1000.0
# How far base and tool may be from where they were registered, mm at the probe: six times what the
# worst way of registering leaves in ``benchmarks/bench_after_the_lab.py series``.
REGISTERED_PLACE_MM = 5.0


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
    n_tools: int = field(init=False)
    n_stations: int = field(init=False)

    def __post_init__(self) -> None:
        self.n_tools = 1 if self.tools is None else int(self.tools.max()) + 1
        if self.points is not None:
            self.informative: Any = slice(None)
            self.n_informative = len(self.points)
            self.n_stations = 1 if self.stations is None else int(self.stations.max()) + 1
            return
        self.n_stations = 0
        self.order = np.argsort(self.index, kind="stable")
        count = np.bincount(self.index)
        self.starts = np.r_[0, np.cumsum(count)[:-1]]
        # One point is its own mean: its zero residual must not pass for precision.
        self.informative = count[self.index] > 1
        self.n_useful = int((count > 1).sum())
        self.n_informative = int(self.informative.sum())

    @property
    def n_coordinates(self) -> int:
        """Coordinates that were measured, less those that the unknown fixed points take."""
        if self.points is not None:
            return 3 * self.n_informative
        return 3 * (self.n_informative - self.n_useful)

    def rows_of_tool(self, tool: int) -> Any:
        return slice(None) if self.tools is None else np.flatnonzero(self.tools == tool)

    def rows_of_station(self, station: int) -> Any:
        return slice(None) if self.stations is None else np.flatnonzero(self.stations == station)

    def sums(self, values: np.ndarray, weights: np.ndarray) -> Any:
        """Weighted mean of each group, (n_groups, ...)."""
        weights = weights[self.order].reshape(-1, *[1] * (values.ndim - 1))
        total = np.add.reduceat(weights * values[self.order], self.starts)
        return total / np.add.reduceat(weights, self.starts)

    def mean(self, values: np.ndarray, weights: np.ndarray) -> Any:
        """Weighted mean of each sample's group, (n, ...), or the mean of all samples."""
        if self.index is None:
            return values.mean(axis=0)
        return self.sums(values, weights)[self.index]


def pack(arm):
    """The arm's parameters as one vector (4 n_joints + 3,)."""
    return np.concatenate([getattr(arm, name) for name in FIELDS])


def unpack(arm, x, tool=0):
    """The arm with the parameters of one vector; further tools follow the first one's probe."""
    start = 4 * len(arm.a)
    parts = [*np.split(x[:start], 4), x[start + 3 * tool :][:3]]
    return arm.replace(**dict(zip(FIELDS, parts, strict=True)))


def points_and_jacobian(arm, angles, x, problem):
    """Corrected points (n, 3) in the base frame, and their derivatives (n, 3, len(x)).

    By table and probes, mm and rad.
    """
    n_table = 4 * len(arm.a)
    points, jac = np.empty((len(angles), 3)), np.zeros((len(angles), 3, len(x)))
    for tool in range(problem.n_tools):
        rows, start = problem.rows_of_tool(tool), n_table + 3 * tool
        points[rows], own = parameter_jacobian(unpack(arm, x, tool), angles[rows])
        jac[rows, :, :n_table] = own[:, :, :n_table]
        jac[rows, :, start : start + 3] = own[:, :, n_table:]
    return (points if problem.correction is None else points - problem.correction), jac


def left_jacobian(rotvec):
    """Rotation that a small change of a rotation vector adds on the left, (3, 3)."""
    angle = np.linalg.norm(rotvec)
    x, y, z = rotvec
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if angle < 1e-6:
        return np.eye(3) + cross / 2
    first, second = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.eye(3) + first * cross + second * cross @ cross


def in_brackets(labels, n):
    """What follows the names of the parameters of each of n tools or stations."""
    return [f"[{label}]" for label in labels] or [""] * n


def are_long(lengths):
    """Which of the lengths of a table carry its scale, (n,); mm."""
    size = np.abs(lengths)
    return size >= _LONG_SHARE * size.max()
