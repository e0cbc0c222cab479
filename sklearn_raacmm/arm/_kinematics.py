"""A chain of joints and its kinematics: each quantity is one contiguous row over the samples."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm._checks import MAX_LENGTH_MM
from sklearn_raacmm.utils import Finding, Floats, Weight, check_option, chunks, floats

# Two whole turns: multi-turn encoders pass, a log in degrees hardly ever does.
_WARN_RAD = 4 * np.pi
# Degrees of real poses are larger than one turn in radians in some joint. Joints of less than 0.2
# degrees stand still, and an arm that moves one joint only may stay near its zero.
_WARN_DEG, _STANDS_STILL_DEG = 2 * np.pi, 0.2
# Ten turns: no arm's encoder counts as many, and no log in degrees holds them.
_ABSURD_DEG = 3600.0
# What slides without limits is taken to go so far to either side, mm: the longest usual tracks.
_TRAVEL_MM = 2000.0
# Rows computed at once: the working set of a chunk (about 30 rows of float64) stays in the cache.
CHUNK_ROWS = 4096
# Along x, y and z of the base: its own axes and its origin.
_BASE = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))


class JointTypes(str):
    """A letter for each joint, such as "PRRRRRR": R where it turns, P where it slides."""

    __slots__ = ()

    @property
    def slides(self) -> list[int]:
        """Numbers, from 0, of the joints that slide."""
        return [i for i, kind in enumerate(self) if kind == "P"] if "P" in self else []

    def by_type(self, of_turns: float, of_slides: float = 1.0) -> np.ndarray:
        """A number for each joint, (n_joints,): of those that turn, and of those that slide."""
        return np.where([kind == "P" for kind in self], of_slides, of_turns)

    def check_angles(self, angles: ArrayLike, angle_unit: str) -> np.ndarray:
        """Angles (n_samples, n_joints) as float64 in rad, and mm of what slides.

        Warns where the unit is likely another.
        """
        check_option("angle_unit", angle_unit, ("rad", "deg"))
        angles = floats("angles", angles)
        if angles.ndim != 2 or angles.shape[1] != len(self):
            raise ValueError(
                f"angles must have shape (n_samples, {len(self)}) for an arm of "
                f"{len(self)} joints, got {angles.shape}."
            )
        if not len(angles):
            return angles
        turned = angles
        if slides := self.slides:
            wrong = ~(np.abs(angles[:, slides]) <= MAX_LENGTH_MM)  # true for NaN, too
            if wrong.any():
                row, i = np.argwhere(wrong)[0]
                raise ValueError(
                    f"joint {slides[i] + 1} slides, and is at {angles[row, slides[i]]:g} mm in row "
                    f"{Finding.row_numbers([row])[0]}: a finite number of at most "
                    f"{MAX_LENGTH_MM:g} mm is needed."
                )
            turned = angles * self.by_type(1.0, 0.0)
        # Max and min carry NaN along: one pass each, and no mask of the size of the data.
        if angle_unit == "rad" and max(turned.max(), -turned.min()) <= _WARN_RAD:  # false for NaN
            return angles
        largest = np.maximum(turned.max(axis=0), -turned.min(axis=0))
        if not np.all(np.isfinite(largest)):
            bad = np.argwhere(~np.isfinite(turned))
            row, column = bad[0]
            raise ValueError(
                f"angles hold {len(bad)} NaN or infinite values; the first is "
                f"{angles[row, column]} in row {Finding.row_numbers([row])[0]}, joint {column + 1}."
            )
        self._check_unit(largest, angle_unit)
        return angles if angle_unit == "rad" else angles * self.by_type(np.pi / 180)

    def _check_unit(self, largest, angle_unit):
        """Report angles, of which these (n_joints,) are the largest, that seem of another unit."""
        most, joint = float(largest.max()), int(largest.argmax()) + 1
        weight: Weight = "doubt"
        if angle_unit == "rad":
            text = f"angles reach {most:g} rad (joint {joint}), more than two turns:"
            advice = "if they are degrees, convert them or pass "
            advice += 'angle_unit="deg" (raacmm: --unit deg).'
        elif most > _ABSURD_DEG:
            text = f"angles reach {most:g} degrees (joint {joint}), more than ten turns:"
            advice, weight = "are they counts of the encoders? Convert them to degrees.", "repair"
        elif most < _WARN_DEG and np.sum(largest > _STANDS_STILL_DEG) > 1:
            text = f"angles in degrees reach {most:g} only (joint {joint}):"
            advice = 'if they are radians, pass angle_unit="rad" (raacmm: --unit rad).'
        else:
            return
        Finding("angle-unit", text, advice, weight, joints=(joint,)).report()


class Chain:
    """A table whose fields have been checked, and what it does to its probe: see `Arm`."""

    a: Floats
    alpha: Floats
    d: Floats
    theta_offset: Floats
    probe: Floats
    convention: str
    joint_signs: Floats
    pose_joints: tuple[int, int]
    pose_frames: tuple[int, int]
    name: str
    names: tuple[str, ...]
    limits: Floats | None
    up: Floats
    couplings: tuple[tuple[int, int, int], ...]
    joint_types: str
    up_frame: int

    # Fields that are the static parameters, in the order of `parameter_jacobian`.
    TABLE = ("a", "alpha", "d", "theta_offset", "probe")

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in Chain.__annotations__}

    def on_trial(self, **changes: object) -> Self:
        """As :meth:`replace`, without its checks of values: for searches that try many tables.

        Parameters
        ----------
        **changes : object
            Fields as :meth:`replace` leaves them, such as arrays of one float64 per joint. Which
            joints slide stays as it is.

        Returns
        -------
        Arm

        Raises
        ------
        TypeError
            If there is no such field.
        """
        if unknown := changes.keys() - Chain.__annotations__.keys():
            raise TypeError(f"an arm has no field {min(unknown)!r} that could be changed.")
        one = object.__new__(type(self))
        vars(one).update(self.__getstate__() | {"slides": self.slides} | changes)
        return one

    # -- joints: what is said of them, and what they may be -----------------------------------

    @cached_property
    def n_joints(self) -> int:
        """Number of joints."""
        return self.a.size

    @cached_property
    def slides(self) -> list[int]:
        """Numbers, from 0, of the joints that slide."""
        return JointTypes(self.joint_types).slides

    @property
    def bounds(self) -> np.ndarray:
        """Lowest and highest angle of each joint (2, n_joints), rad or mm; infinite without one."""
        if self.limits is None:
            return np.full((2, self.n_joints), [[-np.inf], [np.inf]])
        return self.limits.T

    @property
    def spans(self) -> np.ndarray:
        """From where to where joints are taken to go, (2, n_joints): a turn; what a slide may."""
        low, high = self.bounds
        known, far = np.isfinite(self.bounds), 2 * _TRAVEL_MM  # from the end that is known
        least = np.where(known[0], low, np.where(known[1], high - far, -_TRAVEL_MM))
        most = np.where(known[1], high, np.where(known[0], low + far, _TRAVEL_MM))
        return np.where(self.by_type(False, True), [least, most], [[-np.pi], [np.pi]])

    @cached_property
    def reach_mm(self) -> float:
        """Length of the stretched arm with its slides run out, an upper bound of its reach."""
        low, high = self.spans
        middle, sums = self.own_by_given @ (low + high) / 2, np.abs(self.own_by_given)
        at_ends = np.abs(self.d + self.joint_signs * middle) + sums @ (high - low) / 2
        d = np.where(self.by_type(False, True), at_ends, self.d)
        return float(np.hypot(self.a, d).sum() + np.linalg.norm(self.probe))

    def by_type(self, of_turns: float, of_slides: float = 1.0) -> np.ndarray:
        """Give a number for each joint: one to those that turn, one to those that slide.

        Parameters
        ----------
        of_turns : float
            For joints that turn.
        of_slides : float, default=1.0
            For joints that slide.

        Returns
        -------
        ndarray of shape (n_joints,)
        """
        return JointTypes(self.joint_types).by_type(of_turns, of_slides)

    def check_angles(self, angles: ArrayLike, angle_unit: str = "rad") -> Floats:
        """Check joint angles as :meth:`forward` does.

        Parameters
        ----------
        angles, angle_unit
            As in :meth:`forward`.

        Returns
        -------
        ndarray of shape (n_samples, n_joints)
            In rad, and mm of what slides.

        Raises
        ------
        ValueError
            As :meth:`forward`.
        """
        return JointTypes(self.joint_types).check_angles(angles, angle_unit)

    def in_unit(self, angles: Floats, angle_unit: str) -> Floats:
        """Joint angles in the unit asked for.

        Parameters
        ----------
        angles : ndarray of shape (n_samples, n_joints)
            In rad, and mm of what slides; not checked.
        angle_unit : {"rad", "deg"}
            What is asked for.

        Returns
        -------
        ndarray of shape (n_samples, n_joints)
            What slides is in mm with either.
        """
        return angles if angle_unit == "rad" else angles * self.by_type(180 / np.pi)

    def random_poses(self, n: int, rng: np.random.Generator | None = None) -> Floats:
        """Draw poses at random: any angles, and what slides within its limits.

        Parameters
        ----------
        n : int
            Number of poses.
        rng : numpy.random.Generator, default=None
            Draws them. None: the same poses each time.

        Returns
        -------
        ndarray of shape (n, n_joints)
            In rad, and mm of what slides, which goes 2 m to either side where it has no limits.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> Arm.from_name("ur10").random_poses(100).shape
        (100, 6)
        """
        rng = np.random.default_rng(0) if rng is None else rng
        low, high = self.spans
        return rng.uniform(low, high, (n, self.n_joints))

    def own_angles(self, angles: np.ndarray) -> np.ndarray:
        """Angle of each joint itself, of what the encoders give.

        Parameters
        ----------
        angles : ndarray of shape (n_samples, n_joints)
            In rad, and mm of what slides; not checked.

        Returns
        -------
        ndarray of shape (n_samples, n_joints)
            The same where the arm has no `couplings`; else with the angles that are added.
        """
        if not self.couplings:
            return angles
        own = angles.copy()  # a product of matrices would spread NaN over all joints of its row
        for joint, other, factor in self.couplings:
            own[:, joint - 1] += factor * angles[:, other - 1]
        return own

    def phases(self, angles: Floats) -> Floats:
        """Angles of which harmonics of each joint's error are sines and cosines.

        Parameters
        ----------
        angles : ndarray of shape (n_samples, n_joints)
            In rad, and mm of what slides; not checked.

        Returns
        -------
        ndarray of shape (n_samples, n_joints)
            In rad: the :meth:`own_angles`. For a joint that slides a turn is twice its travel, and
            a multiple of 200 mm, so that whole numbers of waves have the pitches of usual screws
            and racks.
        """
        own = self.own_angles(angles)
        return own * self.phase_factors if self.slides else own

    @property
    def turn_mm(self) -> Floats:
        """Travel in mm (n_joints,) of what slides that counts as one turn in `phases`."""
        low, high = self.spans
        return 200.0 * np.maximum(np.ceil((high - low) / 100.0), 1.0)

    @cached_property
    def phase_factors(self) -> Floats:
        """What makes `phases` of the `own_angles` of each joint, (n_joints,): rad for rad or mm."""
        return np.where(self.by_type(False, True), 2 * np.pi / self.turn_mm, 1.0)

    @property
    def joint_axes(self) -> np.ndarray:
        """Place of what each joint does to the probe, (n_joints,), among the `axis_vectors`."""
        n, behind = self.n_joints, self.convention == "modified"
        turns = 3 * (np.arange(n) + behind) + 2
        turns[self.slides] += 3 * (n + 1)
        return turns

    def by_given_angles(self, jacobian: Floats) -> Floats:
        """Derivatives by what the encoders give, of those by theta of the table.

        Parameters
        ----------
        jacobian : ndarray of shape (..., n_joints)
            Of joints that slide by d.

        Returns
        -------
        ndarray of shape (..., n_joints)
        """
        by_own = jacobian * self.joint_signs
        return by_own @ self.own_by_given if self.couplings else by_own

    @cached_property
    def own_by_given(self) -> Floats:
        """Matrix (n_joints, n_joints) that makes the joints' own angles of those that are given."""
        sums = np.eye(self.n_joints)
        for joint, other, factor in self.couplings:
            sums[joint - 1, other - 1] += factor
        return sums

    # -- kinematics -------------------------------------------------------------------------

    def forward(self, angles: ArrayLike, *, angle_unit: str = "rad") -> Floats:
        """Position of the probe, equation (1).

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints)
            Joint angles as the encoders give them; of joints that slide, mm.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of the angles. What slides is in mm with either.

        Returns
        -------
        ndarray of shape (n_samples, 3)
            Probe points in the base frame, mm, float64.

        Raises
        ------
        ValueError
            If `angles` has another number of columns than the arm has joints, or holds NaN,
            infinity or something that is not a number, or a slide is more than 100 m away.

        Warns
        -----
        UserWarning
            If an angle is more than two turns, or if all degrees are below 2 pi: most likely
            another unit.
        """
        return self.points_at(self.check_angles(angles, angle_unit))

    def frames(self, angles: ArrayLike, *, angle_unit: str = "rad") -> Floats:
        """Pose of every frame in the base frame.

        Parameters
        ----------
        angles, angle_unit
            As in :meth:`forward`.

        Returns
        -------
        ndarray of shape (n_samples, n_joints + 1, 3, 4)
            ``[R | t]`` of frames 0 (the base) to `n_joints`; t in mm.
        """
        return self.frames_at(self.check_angles(angles, angle_unit))

    def jacobian(self, angles: ArrayLike, *, angle_unit: str = "rad") -> Floats:
        """Compute the derivative of the probe's position by each joint angle.

        Parameters
        ----------
        angles, angle_unit
            As in :meth:`forward`; the derivative is per rad in either case.

        Returns
        -------
        ndarray of shape (n_samples, 3, n_joints)
            ``d probe / d angle`` in mm/rad: for each joint the cross product of its axis with the
            vector from the axis to the probe. Of a joint that slides its axis, mm/mm.
        """
        angles = self.check_angles(angles, angle_unit)
        jac = np.empty((len(angles), 3, self.n_joints))
        # Bit for bit that of `parameter_jacobian`, of which only these columns are made.
        for rows in chunks(len(angles), CHUNK_ROWS):
            frames = self._columns(angles[rows])
            axes, turned = self._along_and_about(frames, 2, self._probe(frames))
            turned[:, self.slides] = axes[:, self.slides]
            jac[rows] = turned.transpose(2, 0, 1)
        return self.by_given_angles(jac)

    # -- kinematics, at angles that have been checked -----------------------------------------

    def _rows_of_table(self, angles):
        """Of each joint: cosines and sines of theta (n_joints, n_samples), a, d, cos and sin alpha.

        Of a joint that slides d is (n_samples,), where there are several.
        """
        theta = np.ascontiguousarray(self.own_angles(angles).T) * self.joint_signs[:, None]
        # Python's numbers: of a few rows, NumPy's cost as much as the arrays.
        links = [p.tolist() for p in (self.a, self.d, np.cos(self.alpha), np.sin(self.alpha))]
        for i in self.slides:
            d = self.d[i] + theta[i]
            links[1][i], theta[i] = float(d[0]) if len(d) == 1 else d, 0.0
        theta += self.theta_offset[:, None]
        return np.cos(theta), np.sin(theta), *links

    def carried(self, angles: Floats, fixed: list[Any]) -> Floats:
        """Points that are fixed in frames of the arm, in its base frame.

        A point through two plane rotations a joint costs about a third of the products of matrices.

        Parameters
        ----------
        angles : ndarray of shape (n_samples, n_joints)
            In rad, and mm of what slides; not checked.
        fixed : list of (int, (x, y, z))
            The number of each point's frame, and its coordinates in it, mm.

        Returns
        -------
        ndarray of shape (len(fixed), 3, n_samples)
            In the base frame, mm.
        """
        cos, sin, a, d, cos_alpha, sin_alpha = self._rows_of_table(angles)
        if len(angles) == 1:
            # Python's numbers are ten times as fast as arrays of one number, and round alike.
            cos, sin = cos[:, 0].tolist(), sin[:, 0].tolist()
        points = np.empty((len(fixed), 3, len(angles)))
        for point, (frame, (x, y, z)) in zip(points, fixed, strict=True):
            for i in reversed(range(frame)):
                c, s, ca, sa = cos[i], sin[i], cos_alpha[i], sin_alpha[i]
                if self.convention == "standard":
                    y, z = ca * y - sa * z, sa * y + ca * z
                    x, z = x + a[i], z + d[i]
                    x, y = c * x - s * y, s * x + c * y
                else:
                    x, y = c * x - s * y, s * x + c * y
                    x, z = x + a[i], z + d[i]
                    y, z = ca * y - sa * z, sa * y + ca * z
            point[0], point[1], point[2] = x, y, z
        return points

    def points_at(self, angles: Floats, probes: Floats | None = None) -> Floats:
        """Position of the probe at angles that have been checked.

        Parameters
        ----------
        angles : ndarray of shape (n_samples, n_joints)
            In rad, and mm of what slides.
        probes : ndarray of shape (n_samples, 3), default=None
            Vector of each row's probe in the last frame, mm. None: all rows have the arm's.

        Returns
        -------
        ndarray of shape (n_samples, 3)
            In the base frame, mm.
        """
        points = np.empty((len(angles), 3))
        for rows in chunks(len(angles), CHUNK_ROWS):
            own = self.probe.tolist() if probes is None else probes[rows].T
            points[rows] = self.carried(angles[rows], [(self.n_joints, own)])[0].T
        return points

    def frames_at(self, angles: Floats) -> Floats:
        """Pose of every frame in the base frame, at angles that have been checked.

        Parameters
        ----------
        angles : ndarray of shape (n_samples, n_joints)
            In rad, and mm of what slides.

        Returns
        -------
        ndarray of shape (n_samples, n_joints + 1, 3, 4)
            As those of `Arm.frames`.
        """
        frames = np.empty((len(angles), self.n_joints + 1, 3, 4))
        for rows in chunks(len(angles), CHUNK_ROWS):
            frames[rows] = self._columns(angles[rows]).transpose(3, 0, 2, 1)
        return frames

    def _columns(self, angles):
        """Frames as (n_joints + 1, 4, 3, n_samples): the columns x, y, z, origin of each frame."""
        cos, sin, *links = self._rows_of_table(angles)
        if len(angles) == 1:  # by numbers, as in `carried`: a third of the time, and equal bits
            table = cos[:, 0].tolist(), sin[:, 0].tolist(), *links
            of_axes = [[*self._frames(table, axis)] for axis in _BASE]
            return np.array(of_axes).transpose(1, 2, 0)[..., None]
        out = np.zeros((len(cos) + 1, 4, 3, len(angles)))
        out[0, [0, 1, 2], [0, 1, 2]] = 1.0
        for frame, columns in zip(out, self._frames((cos, sin, *links), out[0]), strict=True):
            frame[0], frame[1], frame[2], frame[3] = columns
        return out

    def _frames(self, table, base):
        """Yield x, y, z and origin of each frame: arrays, or numbers along one axis of the base."""
        x, y, z, origin = base
        yield x, y, z, origin
        for c, s, a, d, ca, sa in zip(*table, strict=True):
            if self.convention == "standard":
                x, y = c * x + s * y, c * y - s * x
                origin = origin + d * z + a * x
                y, z = ca * y + sa * z, ca * z - sa * y
            else:
                y, z = ca * y + sa * z, ca * z - sa * y
                origin = origin + a * x + d * z
                x, y = c * x + s * y, c * y - s * x
            yield x, y, z, origin

    def _probe(self, frames, probes=None):
        """Probe points (3, n_samples) from the columns of frames; `probes` as of `points_at`."""
        own = self.probe[:, None] if probes is None else probes.T
        return (own[:, None] * frames[-1, :3]).sum(axis=0) + frames[-1, 3]

    def axis_vectors(
        self, angles: Floats, probes: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """What turns and shifts by every axis of every frame do to the probe, and where things are.

        Parameters
        ----------
        angles : ndarray of shape (n_samples, n_joints)
            In rad, and mm of what slides; not checked.
        probes : ndarray of shape (n_samples, 3), default=None
            As of :meth:`points_at`.

        Returns
        -------
        vectors : ndarray of shape (n_samples, 3, 6 * n_frames)
            What a turn about each axis, x, y and z of the base, of frame 1 and so on, does to the
            probe, mm per rad; then the axes themselves.
        places : ndarray of shape (n_samples, 3, n_frames + 1)
            The frames' origins and the probe, mm.
        phases : ndarray of shape (n_samples, n_joints)
            Those of :meth:`phases`, rad.
        """
        frames = self._columns(angles)
        k, n = len(frames), len(angles)
        # Components first, then what there is, then rows: of one row, views are free.
        places = np.empty((3, k + 1, n))
        places[:, :k] = frames[:, 3].swapaxes(0, 1)
        places[:, k] = self._probe(frames, probes)
        # x, y, z, x, y: a cross product is two products of runs of three.
        lever, axes = np.empty((5, k, 1, n)), np.empty((5, k, 3, n))
        np.subtract(places[:, k:], places[:, :k], out=lever[:3, :, 0])
        axes[:3] = frames[:, :3].transpose(2, 0, 1, 3)
        lever[3:], axes[3:] = lever[:2], axes[:2]
        vectors = np.empty((3, 2, k, 3, n))
        np.multiply(axes[1:4], lever[2:], out=vectors[:, 0])
        vectors[:, 0] -= axes[2:] * lever[1:4]
        vectors[:, 1] = axes[:3]
        vectors = np.ascontiguousarray(vectors.reshape(3, 6 * k, n).transpose(2, 0, 1))
        return vectors, places.transpose(2, 0, 1), self.phases(angles)

    def parameter_jacobian(self, angles: Floats, **changes: object) -> tuple[Floats, Floats]:
        """Position of the probe, and its derivatives by the numbers of the table.

        Parameters
        ----------
        angles : ndarray of shape (n_samples, n_joints)
            In rad, and mm of what slides; not checked.
        **changes : object
            Fields that are others than the arm's own, as of :meth:`on_trial`.

        Returns
        -------
        points : ndarray of shape (n_samples, 3)
            In the base frame, mm.
        derivatives : ndarray of shape (n_samples, 3, 4 * n_joints + 3)
            By `a`, `alpha`, `d`, `theta_offset` and `probe`, mm per mm and mm per rad.
        """
        arm, n = self.on_trial(**changes), self.n_joints
        points = np.empty((len(angles), 3))
        jac = np.empty((len(angles), 3, 4 * n + 3))
        for rows in chunks(len(angles), CHUNK_ROWS):
            frames = arm._columns(angles[rows])
            probe = arm._probe(frames)
            points[rows] = probe.T
            of_x, of_z = (arm._along_and_about(frames, axis, probe) for axis in (0, 2))
            for i, moved in enumerate([*of_x, *of_z]):
                jac[rows, :, i * n : (i + 1) * n] = moved.transpose(2, 0, 1)
            jac[rows, :, 4 * n :] = frames[-1, :3].transpose(2, 1, 0)
        return points, jac

    def _along_and_about(self, frames, axis, probe):
        """What shifts along and turns about x or z (0 or 2) in rows of the table do to the probe.

        Both (3, n_joints, n_samples). A row goes along and about z of one of its two frames, and x
        of the other.
        """
        own = frames[1:] if (axis == 0) == (self.convention == "standard") else frames[:-1]
        u, v = own[:, axis].swapaxes(0, 1), probe[:, None] - own[:, 3].swapaxes(0, 1)
        # By hand: np.cross costs several times as much, and np.stack, of one row, as the products.
        return u, np.array(
            [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
        )
