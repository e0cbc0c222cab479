"""Zeros of encoders that may be anywhere, from what coincides: random starts, least squares."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np
from scipy.optimize import least_squares

from sklearn_raacmm.arm import Arm, parameter_jacobian
from sklearn_raacmm.utils import align, centred

# Rows that zeros are found from, starts at most, and steps of each: for speed. A start has found
# them where the points coincide to this share of the reach; the best of three such starts is taken.
_ROWS, _STARTS, _STEPS = 90, 30, 60
_FOUND, _AGREE = 0.02, 3
# Sizes of a step in a zero, rad, and in the probe, mm.
_SIZES = 0.1, 10.0


def with_found_zeros(
    arm: Arm, angles: np.ndarray, codes: np.ndarray | None, points: np.ndarray | None
) -> Arm:
    """The arm with the zeros, and the probe, with which its points coincide best.

    `angles` (n, n_joints) are in rad; `codes` (n,) are the positions of a single-point test, or
    `points` (n, 3) what a tracker measured, mm. The zeros of the first joint and of the last are
    kept: base and probe go with them.
    """
    order = np.arange(len(angles)) if codes is None else np.argsort(codes, kind="stable")
    few = order[np.linspace(0, len(order) - 1, min(len(order), _ROWS)).astype(int)]
    angles, free = angles[few], np.arange(1, arm.n_joints - 1)
    codes = None if codes is None else np.unique(codes[few], return_inverse=True)[1]
    points = None if points is None else points[few]
    columns = np.r_[3 * arm.n_joints + free, 4 * arm.n_joints + np.arange(3)]

    def changed(x):
        offset = arm.theta_offset.copy()
        offset[free] = np.angle(np.exp(1j * (offset[free] + x[:-3])))
        return arm.replace(theta_offset=offset, probe=arm.probe + x[-3:])

    def left(x, with_slope=False) -> Any:
        ours, slope = parameter_jacobian(changed(x), angles)
        slope = slope[:, :, columns]
        if points is None:
            found, slope = centred(ours, codes), centred(slope, codes)
        else:
            turn, shift = align(ours, points)
            ours = ours @ turn.T + shift
            found, slope = ours - points, turn @ slope
            # What the base takes up: small turns about the points' middle, and shifts.
            turns = np.cross(np.eye(3), (ours - ours.mean(axis=0))[:, None]).transpose(0, 2, 1)
            base = np.concatenate([turns, np.tile(np.eye(3), (len(ours), 1, 1))], axis=2)
            base, slope = base.reshape(-1, 6), slope.reshape(-1, len(columns))
            slope = slope - base @ np.linalg.lstsq(base, slope)[0]
        return slope.reshape(-1, len(columns)) if with_slope else found.ravel()

    rng, scale = np.random.default_rng(0), np.repeat(_SIZES, [len(free), 3])
    best: list[Any] = []
    for _ in range(_STARTS):
        start = np.zeros(len(columns))
        if best:  # the first start is the table as it is given
            start[:-3] = rng.uniform(-np.pi, np.pi, len(free))
        found = least_squares(left, start, lambda x: left(x, True), x_scale=scale, max_nfev=_STEPS)
        best.append((np.sqrt(2 * found.cost / len(angles)), found.x))
        if sum(one[0] < _FOUND * arm.reach_mm for one in best) >= _AGREE:
            break
    return changed(min(best, key=lambda one: one[0])[1])
