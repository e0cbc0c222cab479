"""A plan of a first single-point test: where cones may stand, and poses that reach them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral
from typing import NamedTuple

import numpy as np
from sklearn.utils import check_random_state, check_scalar

from sklearn_raacmm.arm import Arm, check_arm, limits_of, solve
from sklearn_raacmm.utils import Floats

# Places tried for each cone, and starts of the search for poses for each pose that is wanted.
_PLACES, _STARTS = 4, 8
# Shares of the reach between which cones stand, and up to which height.
_NEAREST, _FARTHEST, _HIGHEST = 0.25, 0.85, 0.45
# Seconds that a person takes for a pose, and to fix the next cone: a choice.
_PER_POSE_S, _PER_CONE_S = 6.0, 60.0


class PosePlan(NamedTuple):
    """A plan of a single-point test, in the order in which to measure.

    Attributes
    ----------
    positions : ndarray of shape (n_positions, 3)
        Centres of the cones in the base frame, mm: a few centimetres more or less do not matter.
    angles : ndarray of shape (n_positions * n_poses, n_joints)
        Poses in rad.
    groups : ndarray of shape (n_positions * n_poses,)
        Cone of each pose, from 1.
    minutes : float
        About how long it takes, at 6 s for a pose and a minute for a cone.
    """

    positions: Floats
    angles: Floats
    groups: np.ndarray
    minutes: float


def plan_poses(
    arm: Arm,
    n_positions: int = 8,
    n_poses: int = 12,
    *,
    lean_deg: float | None = 60.0,
    random_state: int | np.random.RandomState | None = 0,
) -> PosePlan:
    """Plan a first single-point test for an arm: cones that are spread, and poses that reach them.

    Cones stand all around the base, from a quarter to 85 % of the reach away, up to 45 % of it
    high; those that the arm does not reach within ``arm.limits`` are passed over.
    Poses are within ``arm.limits`` where the arm has some, as different from each other as the arm
    allows, and in an order of short ways (``benchmarks/bench_after_the_lab.py plan``).

    Parameters
    ----------
    arm : Arm
        Nominal or calibrated.
    n_positions, n_poses : int, default=8 and 12
        Cones, and poses in each. The defaults take about twenty minutes.
    lean_deg : float or None, default=60
        How far the probe may lean from the vertical, ``arm.up``, degrees; no frame of the wrist may
        be lower than the cone then. None: a probe that may come from anywhere, as a ball in a
        magnet.
    random_state : int, RandomState instance or None, default=0
        Draws the places and poses that are tried.

    Returns
    -------
    PosePlan

    Raises
    ------
    ValueError
        If too few places are found.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, plan_poses
    >>> arm = Arm.from_name("aacmm6")
    >>> plan = plan_poses(arm, n_positions=3, n_poses=5)
    >>> plan.angles.shape
    (15, 6)
    >>> bool(np.abs(arm.forward(plan.angles) - plan.positions[plan.groups - 1]).max() < 1e-6)
    True
    """
    check_arm(arm)
    check_scalar(n_positions, "n_positions", Integral, min_val=1)
    check_scalar(n_poses, "n_poses", Integral, min_val=2)
    rng, reach = check_random_state(random_state), arm.reach_mm
    reached = []
    for _ in range(_PLACES * n_positions):
        place = _place(rng, reach)
        poses = _poses_at(arm, place, n_poses, lean_deg, rng)
        if poses is not None:
            reached.append((place, poses))
    if len(reached) < n_positions:
        raise ValueError(
            f"only {len(reached)} of {_PLACES * n_positions} places that were tried are reached in "
            f"{n_poses} poses, and {n_positions} are needed: give a larger lean_deg, or wider "
            "limits."
        )
    cones = np.array([place for place, _ in reached])
    chosen = np.array(_spread(cones, n_positions))
    chosen = chosen[_short_way(cones[chosen], 0)]
    angles: list[np.ndarray] = []
    for own in (reached[cone][1] for cone in chosen):
        first = int(np.argmin(_travel(own, angles[-1][-1]))) if angles else 0
        angles.append(own[_short_way(own, first)])
    minutes = n_positions * (_PER_CONE_S + n_poses * _PER_POSE_S) / 60
    groups = np.repeat(np.arange(1, n_positions + 1), n_poses)
    return PosePlan(cones[chosen], np.concatenate(angles), groups, minutes)


def _place(rng, reach):
    """A place for a cone, (3,) in mm."""
    azimuth, share = rng.uniform(-np.pi, np.pi), rng.uniform(_NEAREST, _FARTHEST)
    height = rng.uniform(0, _HIGHEST) * reach
    radius = np.sqrt(max((share * reach) ** 2 - height**2, (_NEAREST * reach) ** 2))
    return np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])


def _poses_at(arm, place, n_poses, lean_deg, rng):
    """Poses that reach a place, as different as may be, or None where there are too few."""
    low, high = limits_of(arm)
    size = (_STARTS * n_poses, arm.n_joints)
    start = rng.uniform(np.maximum(low, -np.pi), np.minimum(high, np.pi), size)
    aim = np.broadcast_to(place, (len(start), 3))
    found, _ = solve(arm, aim, start)
    found = found[~np.isnan(found[:, 0])]
    if lean_deg is not None and len(found):
        found = found[_stands(arm, found, place, lean_deg)]
    if len(found) < n_poses:
        return None
    if np.isinf([low, high]).all():  # whole turns may be taken off
        found = np.remainder(found + np.pi, 2 * np.pi) - np.pi
    return found[_spread(np.hstack([np.cos(found), np.sin(found)]), n_poses)]


def _stands(arm, angles, place, lean_deg):
    """Whether the probe stands in the cone from above, the wrist above it."""
    frames = arm.frames(angles)
    line = place - frames[:, -1, :, 3]
    length = np.linalg.norm(line, axis=1)
    # A probe of no length has no direction.
    upright = (-line @ arm.up >= np.cos(np.deg2rad(lean_deg)) * length) | (length < 1.0)
    half = arm.n_joints // 2
    return upright & (frames[:, half:-1, :, 3] @ arm.up >= place @ arm.up).all(axis=1)


def _spread(points, n):
    """Numbers of n points that are far from each other: each the farthest from those before."""
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    far = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < n:
        chosen.append(int(np.argmax(far)))
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return chosen


def _travel(points, start):
    """Longest way of any coordinate from a start: what a move takes."""
    return np.abs(points - start).max(axis=1)


def _short_way(points, first):
    """An order of short steps: each time to the nearest that is left."""
    order, rest = [first], [i for i in range(len(points)) if i != first]
    while rest:
        order.append(rest.pop(int(np.argmin(_travel(points[rest], points[order[-1]])))))
    return order
