"""The other way round: joint angles that bring a probe to a point, and a frame into a direction."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from sklearn_raacmm.arm._checks import are_rotations
from sklearn_raacmm.arm._kinematics import Chain
from sklearn_raacmm.utils import Floats, check_option, floats, warn_user

Correction = Callable[[Floats, np.ndarray], tuple[Floats, Floats | None]]

# Points are within this of the wanted ones, mm; an orientation's error counts times the reach.
_REACHED_MM = 1e-7
# Rounds, each with a correction of its own, and steps of the bare arm in each. The first round may
# come from far away; a step turns no joint further than this, in rad.
_ROUNDS, _STEPS, _LARGEST_STEP = 20, 30, 0.5
# A way ends with a round that leaves more of its gap than this share: of 17 631 ways that arrived
# .7 % stood still for as long.
_GAIN = 0.99
# Least ratio of the singular values of the Jacobian that is divided by: a stretched arm cannot move
# outwards. Nearer than this, mm, the least falls with the gap, so that singular poses are reached.
_LEAST_RATIO, _NEAR_MM = 1e-4, 0.1
# Poses tried where no start is given. How far beside a start ways begin that are tried after it,
# rad: they may end beside a singular pose or at limits. Twenty rounds for each way, and three ways
# from so near, reached .96 of 6 480 poses within limits from .05, .5 and 1.5 rad away; these reach
# .99 in a quarter of the time.
_STARTS, _ASIDE = 20, (0.1, 0.1, 0.1, 0.4, 0.6, 0.8, 1.0)


class ReachingChain(Chain):
    """A chain with the other way round: see `Arm`."""

    def angles_for(
        self,
        points: ArrayLike,
        start: ArrayLike | None = None,
        orientations: ArrayLike | None = None,
        *,
        angle_unit: str = "rad",
        correction: Correction | None = None,
    ) -> Floats:
        """Joint angles that bring the probe to wanted points, by Newton's method.

        Parameters
        ----------
        points : array-like of shape (n, 3)
            In the base frame, mm.
        start : array-like of shape (n, n_joints) or (1, n_joints), default=None
            Poses to begin at: of all the angles that reach a point those near the start are taken,
            within `limits` where the arm has some, by whole turns from a start beyond them. None:
            zero, then 19 random poses.
        orientations : array-like of shape (n, 3, 3), default=None
            Rotation matrix that the last frame is to have in the base frame. None: any.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `start` and of what is returned.
        correction : callable, default=None
            What is to be taken off the arm's points, as models of its errors predict it: of angles
            (m, n_joints) in rad and the numbers of their points, (m, 3) mm, and the rotation
            vectors to be taken off the orientations, (m, 3) rad, or None. None: nothing.

        Returns
        -------
        angles : ndarray of shape (n, n_joints)
            ``forward`` of them are the points to 1e-6 mm; NaN where there are none.

        Raises
        ------
        ValueError
            If shapes do not fit, something is not a finite number, or an orientation no rotation.

        Warns
        -----
        UserWarning
            If points are not reached: how many, the first of them, and how near the probe came.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> arm = Arm.from_name("ur10")
        >>> pose = [[0.1, -1.0, 1.2, -0.5, -1.4, 0.3]]
        >>> to_the_pose = arm.frames(pose)[:, -1, :, :3]
        >>> arm.angles_for(arm.forward(pose), [[0, -1, 1, 0, -1, 0]], to_the_pose).round(6)
        array([[ 0.1, -1. ,  1.2, -0.5, -1.4,  0.3]])
        """
        check_option("angle_unit", angle_unit, ("rad", "deg"))
        points = floats("points", points, 3)
        turns = None if orientations is None else _check_orientations(orientations, len(points))
        start = None if start is None else self._within(self.check_angles(start, angle_unit))
        if start is not None and len(start) not in (1, len(points)):
            raise ValueError(
                f"start has {len(start)} poses for {len(points)} points: give one, or one each."
            )
        rng, shape = np.random.default_rng(0), (len(points), self.n_joints)
        first, last = np.clip(self.spans, *self.bounds)  # limits may be beyond half a turn
        unit = self.by_type(1.0, self.reach_mm)
        angles, off = np.full(shape, np.nan), np.full((len(points), 2), np.inf)
        reach = self.reach_mm if np.isfinite(self.bounds[:, self.slides]).all() else np.inf
        open_, near = np.arange(len(points)), np.linalg.norm(points, axis=1) <= reach

        def of_open(angles, rows, correction: Any = correction):
            return correction(angles, open_[rows])

        for again, aside in enumerate([0.0] * _STARTS if start is None else [0.0, *_ASIDE]):
            if start is None:
                own = rng.uniform(first, last) * (again > 0)
            else:
                own = start + rng.normal(0, aside * unit, shape)
            wanted = None if turns is None else turns[open_]
            own = np.broadcast_to(own, shape)[open_]
            angles[open_], left = self.solve(points[open_], own, wanted, correction and of_open)
            nearer = left[:, 0] < off[open_, 0]
            off[open_[nearer]] = left[nearer]
            # What is beyond the stretched arm is so from any start.
            open_ = np.flatnonzero(np.isnan(angles[:, 0]) & near)
            if not len(open_):
                break
        missed = np.flatnonzero(np.isnan(angles[:, 0]))
        if len(missed):
            mm, rad = off[missed[0]]
            turned = f" and {np.rad2deg(rad):.3g} degrees" if orientations is not None else ""
            warn_user(
                f"{len(missed)} of {len(points)} points are not reached: first that of row "
                f"{missed[0]}, to which the probe came as near as {mm:.3g} mm{turned}. Their "
                "angles are NaN."
            )
        return self.in_unit(angles, angle_unit)

    def solve(
        self,
        points: Floats,
        start: Floats,
        orientations: Floats | None = None,
        correction: Correction | None = None,
    ) -> tuple[Floats, Floats]:
        """Joint angles that bring the probe to points on the way from one start, without a warning.

        Parameters
        ----------
        points, orientations, correction
            As of :meth:`angles_for`; not checked.
        start : ndarray of shape (n, n_joints)
            In rad, and mm of what slides; not checked.

        Returns
        -------
        angles : ndarray of shape (n, n_joints)
            In rad, and mm of what slides. A row that is not reached has NaN.
        off : ndarray of shape (n, 2)
            How far off each row was in the end, mm and rad.
        """
        low, high = self.bounds
        angles, off = np.clip(start, low, high), np.zeros((len(points), 2))
        open_, last = np.arange(len(points)), np.full(len(points), np.inf)
        for _ in range(_ROUNDS):
            aim, turned = points[open_], None if orientations is None else orientations[open_]
            if correction is not None:
                shift, turn = correction(angles[open_], open_)
                aim = aim + shift
                if turned is not None and turn is not None:
                    turned = Rotation.from_rotvec(turn).as_matrix() @ turned
            gap = self._gaps(aim, turned, angles[open_])
            off[open_, 0] = np.linalg.norm(gap[:, :3], axis=1)
            off[open_, 1] = np.linalg.norm(gap[:, 3:], axis=1) / self.reach_mm
            size = np.linalg.norm(gap, axis=1)
            left = size > _REACHED_MM
            going = left & (size < _GAIN * last[open_])
            angles[open_[left & ~going]] = np.nan  # as near as it comes on this way
            last[open_] = size
            open_, aim = open_[going], aim[going]
            if not len(open_):
                break
            turned = None if turned is None else turned[going]
            angles[open_] = self._bare(aim, turned, angles[open_])
        angles[open_] = np.nan
        return angles, off

    def _within(self, angles):
        """Angles by whole turns within the limits, where there are such."""
        low, high = self.bounds
        up, down = np.ceil((low - angles) / (2 * np.pi)), np.ceil((angles - high) / (2 * np.pi))
        turns = np.maximum(up, 0.0) - np.maximum(down, 0.0)
        turned = angles + turns * self.by_type(2 * np.pi, 0.0)
        return np.where((low <= turned) & (turned <= high), turned, angles)

    def _gaps(self, aim, turned, angles):
        """What is left to go, (n, 3) mm, and to orientations times the reach, (n, 6)."""
        gap = aim - self.points_at(angles)
        if turned is None:
            return gap
        own = self.frames_at(angles)[:, -1, :, :3]
        left = Rotation.from_matrix(turned @ own.swapaxes(1, 2)).as_rotvec()
        return np.hstack([gap, self.reach_mm * left])

    def _bare(self, aim, turned, angles):
        """The same for the arm without a correction, by shortest steps."""
        (low, high), moves = self.bounds, self.joint_axes
        n_turns = 3 * (self.n_joints + 1)
        about = moves % n_turns + n_turns
        unit = self.by_type(1.0, self.reach_mm)  # of a slide: as large as one radian
        angles, open_ = angles.copy(), np.arange(len(aim))
        for _ in range(_STEPS):
            own = angles[open_]
            gap = self._gaps(aim[open_], None if turned is None else turned[open_], own)
            going = np.linalg.norm(gap, axis=1) > _REACHED_MM / 10
            open_, own, gap = open_[going], own[going], gap[going]
            if not len(open_):
                break
            vectors = self.axis_vectors(own)[0]
            jacobian = self.by_given_angles(vectors[:, :, moves] * unit)
            if turned is not None:
                axes = self.by_given_angles(vectors[:, :, about] * self.by_type(1.0, 0.0))
                jacobian = np.concatenate([jacobian, self.reach_mm * axes], axis=1)
            # A joint at its limit that is pushed further does not help.
            step = _shortest(jacobian, gap)
            stuck = ((own <= low) & (step < 0)) | ((own >= high) & (step > 0))
            if stuck.any():
                step = _shortest(jacobian * ~stuck[:, None], gap)
            size = np.abs(step).max(axis=1, keepdims=True)
            step *= _LARGEST_STEP / np.maximum(size, _LARGEST_STEP)
            angles[open_] = np.clip(own + step * unit, low, high)
        return angles


def _check_orientations(orientations, n):
    """Rotations (n, 3, 3) as float64."""
    turns = floats("orientations", orientations, finite=True)
    if turns.shape != (n, 3, 3):
        raise ValueError(
            "orientations must be a rotation matrix for each point, "
            f"({n}, 3, 3), got {turns.shape}."
        )
    wrong = np.flatnonzero(~are_rotations(turns))
    if len(wrong):
        raise ValueError(
            f"{len(wrong)} of {n} orientations are no rotations; the first is that of row "
            f"{wrong[0]}: {turns[wrong[0]].round(6).tolist()}."
        )
    return turns


def _shortest(jacobian, gap):
    """Shortest steps (n, n_joints) that close gaps (n, k), as far as the Jacobian lets them."""
    gram = jacobian @ jacobian.swapaxes(1, 2)
    value, axes = np.linalg.eigh(gram)
    near = np.minimum(np.linalg.norm(gap, axis=1, keepdims=True) / _NEAR_MM, 1.0)
    value = np.maximum(value, near * _LEAST_RATIO**2 * value[:, -1:] + 1e-300)
    along = np.einsum("nij,ni->nj", axes, gap) / value
    return np.einsum("nij,ni->nj", jacobian, np.einsum("nij,nj->ni", axes, along))
