"""A plan of a first single-point test: where cones and a bar may stand, and poses for them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral, Real
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state, check_scalar

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.measurements import within_turn
from sklearn_raacmm.utils import Floats

# Places tried for each cone, and starts of the search for poses for each pose that is wanted.
_PLACES, _STARTS = 4, 8
# Places tried for a bar.
_BARS = 50
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
    bar : tuple of int
        The two cones, from 1, that are the seats of the bar; empty without one.
    """

    positions: Floats
    angles: Floats
    groups: np.ndarray
    minutes: float
    bar: tuple[int, ...] = ()


def plan_poses(
    arm: Arm,
    n_positions: int = 8,
    n_poses: int = 12,
    *,
    lean_deg: float | None = None,
    bar_mm: float | None = None,
    random_state: int | np.random.RandomState | None = 0,
) -> PosePlan:
    """Plan a first single-point test for an arm: cones that are spread, and poses that reach them.

    A first test teaches most where the places of its cones and the angles of its poses are as
    different as possible. Cones stand all around the base, from a quarter to 85 % of the reach
    away, up to 45 % of it high. Poses are within ``arm.limits`` where the arm has some, as
    different from each other as the arm allows, and in an order of short ways. Cones that the arm
    does not reach in so many poses are passed over.

    Parameters
    ----------
    arm : Arm
        Nominal or calibrated.
    n_positions, n_poses : int, default=8 and 12
        Cones, and poses in each. The defaults take about twenty minutes.
    lean_deg : float or None, default=None
        How far the probe may lean from the vertical, ``arm.up``, degrees; no frame of the wrist may
        be lower than the cone then. None: the probe may come from anywhere, as with a ball in
        a magnet.
    bar_mm : float or None, default=None
        Length of a bar that lies level and whose two seats are two of the cones. None: no bar. The
        length of one bar sets the scale of the arm, which cones do not show.
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
    Arm.check(arm)
    check_scalar(n_positions, "n_positions", Integral, min_val=1 if bar_mm is None else 2)
    check_scalar(n_poses, "n_poses", Integral, min_val=2)
    rng = check_random_state(random_state)
    reached: list[Any] = []
    if bar_mm is not None:
        check_scalar(bar_mm, "bar_mm", Real, min_val=0, include_boundaries="neither")
        reached = _bar(arm, float(bar_mm), n_poses, lean_deg, rng)
    n_bar = len(reached)
    for _ in range(_PLACES * n_positions):
        place = _place(arm, rng)
        poses = _poses_at(arm, place, n_poses, lean_deg, rng)
        if poses is not None:
            reached.append((place, poses))
    if len(reached) < n_positions:
        raise ValueError(
            f"only {len(reached)} of {_PLACES * n_positions} places that were tried are reached in "
            f"{n_poses} poses, and {n_positions} are needed: give wider limits, or a larger "
            "lean_deg."
        )
    cones = np.array([place for place, _ in reached])
    chosen = np.array(_spread(cones, n_positions, [*range(n_bar)]))
    chosen = chosen[_short_way(cones[chosen], 0)]
    angles: list[np.ndarray] = []
    for own in (reached[cone][1] for cone in chosen):
        first = int(np.argmin(_travel(own, angles[-1][-1]))) if angles else 0
        angles.append(own[_short_way(own, first)])
    minutes = n_positions * (_PER_CONE_S + n_poses * _PER_POSE_S) / 60
    groups = np.repeat(np.arange(1, n_positions + 1), n_poses)
    bar = tuple((np.flatnonzero(chosen < n_bar) + 1).tolist())
    return PosePlan(cones[chosen], np.concatenate(angles), groups, minutes, bar)


def _bar(arm, length, n_poses, lean_deg, rng):
    """Place and poses of both seats of a bar that lies level."""
    for _ in range(_BARS):
        middle, turn = _place(arm, rng), rng.uniform(0, np.pi)
        half = 0.5 * length * np.array([np.cos(turn), np.sin(turn), 0.0])
        places = [middle - half, middle + half]
        away = np.linalg.norm(places, axis=1) / arm.reach_mm
        if not (away.min() >= _NEAREST and away.max() <= _FARTHEST):
            continue
        poses = [_poses_at(arm, place, n_poses, lean_deg, rng) for place in places]
        if all(own is not None for own in poses):
            return list(zip(places, poses, strict=True))
    raise ValueError(
        f"no place was found where the arm, which reaches {arm.reach_mm:.0f} mm, reaches both ends "
        f"of a bar of {length:.0f} mm in {n_poses} poses: give a shorter bar_mm."
    )


def _place(arm, rng):
    """A place for a cone, (3,) in mm."""
    if "P" in arm.joint_types:  # not round about the base: where some pose is
        return arm.points_at(arm.random_poses(1, rng))[0]
    reach = arm.reach_mm
    azimuth, share = rng.uniform(-np.pi, np.pi), rng.uniform(_NEAREST, _FARTHEST)
    height = rng.uniform(0, _HIGHEST) * reach
    radius = np.sqrt(max((share * reach) ** 2 - height**2, (_NEAREST * reach) ** 2))
    return np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])


def _poses_at(arm, place, n_poses, lean_deg, rng):
    """Poses that reach a place, as different as may be, or None where there are too few."""
    low, high = arm.bounds
    size = (_STARTS * n_poses, arm.n_joints)
    start = rng.uniform(*np.clip(arm.spans, low, high), size)
    aim = np.broadcast_to(place, (len(start), 3))
    found, _ = arm.solve(aim, start)
    found = found[~np.isnan(found[:, 0])]
    if lean_deg is not None and len(found):
        found = found[_stands(arm, found, place, lean_deg)]
    if len(found) < n_poses:
        return None
    if np.isinf([low, high]).all():  # whole turns may be taken off
        found = within_turn(found, arm.joint_types)
    phase = arm.phases(found)
    return found[_spread(np.hstack([np.cos(phase), np.sin(phase)]), n_poses)]


def _stands(arm, angles, place, lean_deg):
    """Whether the probe stands in the cone from above, the wrist above it."""
    frames = arm.frames(angles)
    line = place - frames[:, -1, :, 3]
    length = np.linalg.norm(line, axis=1)
    # A probe of no length has no direction.
    up = frames[:, arm.up_frame, :, :3] @ arm.up
    leaning = np.einsum("ni,ni->n", line, up)
    upright = (-leaning >= np.cos(np.deg2rad(lean_deg)) * length) | (length < 1.0)
    wrist = frames[:, (arm.n_joints + arm.up_frame) // 2 : -1, :, 3] - place
    return upright & (np.einsum("nfi,ni->nf", wrist, up) >= 0).all(axis=1)


def _spread(points, n, first=()):
    """Numbers of n points that are far from each other: each the farthest from those before."""
    chosen = list(first) or [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    far = np.min([np.linalg.norm(points - points[i], axis=1) for i in chosen], axis=0)
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
