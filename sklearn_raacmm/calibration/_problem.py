"""What a calibration has to explain: checked data, and how parameters are laid out."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sklearn_raacmm.arm import FIELDS, parameter_jacobian
from sklearn_raacmm.utils import encode_groups


@dataclass
class Problem:
    """Checked data of one calibration."""

    index: Any  # (n,) number of the fixed point of each row; None for measured points
    points: np.ndarray | None  # (n, 3) measured, mm
    lengths: list  # of (point, point, length, sd): known ones between two fixed points, mm
    correction: np.ndarray | None = None  # (n, 3) mm, subtracted from the arm's points
    tools: np.ndarray | None = None  # (n,) numbers; None where all rows share one
    stations: np.ndarray | None = None
    turns: np.ndarray | None = None  # (n, 3, 3) orientations of the target beside `points`
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
            return (3 if self.turns is None else 6) * self.n_informative
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


def encode_labels(name, labels, n):
    """Different labels and the number of each row's, as `encode_groups`, for another name."""
    try:
        return encode_groups(labels, n)
    except ValueError as error:
        raise ValueError(str(error).replace("groups", name, 1)) from None


def pack(arm):
    """The arm's parameters as one vector (4 n_joints + 3,)."""
    return np.concatenate([getattr(arm, name) for name in FIELDS])


def unpack(arm, x, tool=0):
    """The arm with the parameters of one vector; further tools follow the first one's probe."""
    n = arm.n_joints
    start = 4 * n + 3 * tool
    return arm.replace(
        a=x[:n],
        alpha=x[n : 2 * n],
        d=x[2 * n : 3 * n],
        theta_offset=x[3 * n : 4 * n],
        probe=x[start : start + 3],
    )


def points_and_jacobian(arm, angles, x, problem):
    """Corrected points (n, 3) in the base frame, and their derivatives (n, 3, len(x)).

    By table and probes, mm and rad.
    """
    n_table = 4 * arm.n_joints
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
    return (
        np.eye(3)
        + (1 - np.cos(angle)) / angle**2 * cross
        + (angle - np.sin(angle)) / angle**3 * cross @ cross
    )
