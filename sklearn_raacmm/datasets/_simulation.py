"""The physics of the simulated arm: where its probe really is, and poses that reach a point."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from functools import partial
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_random_state, check_scalar

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.datasets._arm_errors import ArmErrors
from sklearn_raacmm.utils import floats

_ARCSEC = np.pi / (180 * 3600)  # rad

# What the arm weighs, N: tubes with what runs inside them, and the joints at their ends.
_TUBE_WEIGHT_N_PER_M = 15.6
_ELBOW_WEIGHT_N = 9.8
_WRIST_WEIGHT_N = 5.9
# Thermal expansion, 1/K: carbon-fibre tubes, and aluminium for everything else.
_TUBE_EXPANSION = 0.5e-6
_BODY_EXPANSION = 23e-6
# The probe cannot lean further from a cone's axis than this.
_MAX_LEAN = np.deg2rad(60)
# Range of joints 3 to 6: the swing, the elbow, any turn of the forearm, and the fold of the wrist.
_LOW, _HIGH = np.deg2rad([[-110, 8, -180, -110], [110, 165, 180, 110]])


class SimulatedArm:
    """A six-joint arm CMM with physical errors: what it reads, and where its probe really is.

    Parameters
    ----------
    errors : ArmErrors or str, default="typical"
        Sizes of the error sources, or the name of a mix, see :meth:`ArmErrors.from_name`.
    random_state : int, RandomState instance or None, default=0
        Draws the individual: the same one has the same draws whatever the sizes.
    up : array-like of shape (3,), default=(0, 0, 1)
        Direction against gravity in the base frame, see `Arm`. Poses do not depend on it:
        cones open towards the base's z axis whatever its direction.

    Attributes
    ----------
    errors : ArmErrors
        Sizes of the error sources.
    nominal_arm : Arm
        The drawing: what the maker believes before calibration.
    true_arm : Arm
        The geometry that was really built. Only a simulation knows it.
    shoulder : ndarray of shape (3,)
        Crossing of the first two axes, mm.
    reach : float
        Radial reach of the stretched arm from its shoulder, mm.
    calibration_seed : int
        Draws the measurements that this individual is calibrated with.

    Notes
    -----
    Sources other than the geometry are of first order and add up: what is of second order stays
    below a micrometre at the default sizes.

    With z the axis of a joint, O its origin and P the probe, a turn by a small angle e moves the
    probe by e z x (P - O). A joint i under gravity turns by its compliance times
    z_i . sum (r_k - O_i) x F_k, over the weights F_k at r_k beyond it. A tube of length L with
    its own weight w per length and a load F at its end sinks by (w L^4 / 8 + F L^3 / 3) / EI and
    slopes by (w L^3 / 6 + F L^2 / 2) / EI, times the cosine of its elevation (the textbook's
    cantilever); EI follows from the sag.

    Examples
    --------
    >>> from sklearn_raacmm.datasets import SimulatedArm
    >>> machine = SimulatedArm("typical", random_state=0)
    >>> angles = [[0.0, -1.5, 0.2, 1.5, 0.0, 0.1]]
    >>> sorted(machine.deviations(angles))[:5]
    ['eccentricity', 'payload', 'play', 'runout', 'sag']
    """

    def __init__(
        self,
        errors: ArmErrors | str = "typical",
        *,
        random_state: int | np.random.RandomState | None = 0,
        up: ArrayLike = (0.0, 0.0, 1.0),
    ) -> None:
        self.errors: ArmErrors = (
            errors if isinstance(errors, ArmErrors) else ArmErrors.from_name(errors)
        )
        # RandomState, not Generator: its stream is frozen, so a seed means the same data for ever.
        rng = check_random_state(random_state)
        nominal = Arm.from_name("aacmm6", up=up)
        self.nominal_arm: Arm = nominal
        self.reach: float = float(nominal.d[[2, 4]].sum() + np.linalg.norm(nominal.probe))
        self.shoulder: np.ndarray = np.array([0.0, 0.0, nominal.d[0]])
        length, angle = self.errors.length_mm, np.deg2rad(self.errors.angle_deg)
        # Base height and the first encoder's zero define the base frame: they have no error.
        free = np.arange(6) > 0
        self.true_arm: Arm = nominal.replace(
            a=nominal.a + length * rng.normal(size=6),
            d=nominal.d + length * rng.normal(size=6) * free,
            alpha=nominal.alpha + angle * rng.normal(size=6),
            theta_offset=nominal.theta_offset + angle * rng.normal(size=6) * free,
            probe=nominal.probe + length * rng.normal(size=3),
            name="true (simulated)",
        )
        self._amplitudes = rng.uniform(0.5, 1.5, size=(2, 6))
        self._phases = rng.uniform(-np.pi, np.pi, size=(4, 6))
        self.calibration_seed: int = rng.randint(2**31 - 1)
        # A stream of its own: sources that are off by default do not move the draws of the others.
        own = np.random.RandomState([self.calibration_seed, 1])
        self._play = own.uniform(0.5, 1.5, size=6) * self.errors.play_arcsec * _ARCSEC

    def __repr__(self) -> str:
        return f"SimulatedArm({self.errors})"

    def deviations(
        self,
        angles: ArrayLike,
        *,
        warming_k: ArrayLike | None = None,
        directions: ArrayLike | None = None,
        payload_n: ArrayLike = 0.0,
    ) -> dict[str, np.ndarray]:
        """How far each source moves the probe from where the true geometry alone would have it.

        Parameters
        ----------
        angles : array-like of shape (n_samples, 6)
            Encoder angles free of noise, rad.
        warming_k : float or array-like of shape (n_samples,), default=None
            Warming in K; None takes the warming of `errors`.
        directions : array-like of shape (n_samples, 6), default=None
            Direction from which each joint came: 1 from smaller angles, -1 from larger ones, 0 in
            the middle of its play. None: all in the middle.
        payload_n : float or array-like of shape (n_samples,), default=0
            Weight at the probe in N.

        Returns
        -------
        deviations : dict of str to ndarray of shape (n_samples, 3)
            In mm, by source.
        """
        errors = self.errors
        frames = self.true_arm.frames(angles)
        angles = np.asarray(angles, dtype=np.float64)
        rotation, origin = frames[..., :3], frames[..., 3]
        axes, bases = rotation[:, :-1, :, 2], origin[:, :-1]
        probe = origin[:, -1] + rotation[:, -1] @ self.true_arm.probe
        levers = probe[:, None] - bases

        def turned(joint_errors):
            return np.einsum("nj,njk->nk", joint_errors, np.cross(axes, levers))

        amplitudes = self._amplitudes * np.array(errors.eccentricity_arcsec)[:, None] * _ARCSEC
        eccentricity = sum(
            amplitudes[k] * np.cos((k + 1) * angles + self._phases[k]) for k in range(2)
        )
        compliance = np.full(6, errors.joint_compliance_urad_per_nm * 1e-6)
        compliance[1] *= 1 - errors.counterbalance
        # Joint i turns the x axis of frame i about the z axis of frame i - 1.
        x = rotation[:, 1:, :, 0]
        y = np.cross(axes, x)
        tilt, shift = (
            np.cos(angles + p)[..., None] * x + np.sin(angles + p)[..., None] * y
            for p in self._phases[2:]
        )
        tubes = (origin[:, 3] - origin[:, 2]) + (origin[:, 5] - origin[:, 4])
        body = (probe - origin[:, 0]) - tubes
        warming = errors.warming_k if warming_k is None else warming_k
        warming = _per_row("warming_k", warming, len(angles))
        torques = self._torques(axes, origin)
        payload = _per_row("payload_n", payload_n, len(angles))
        pulled = (axes * np.cross(levers / 1e3, -self.true_arm.up)).sum(axis=2) * payload
        lag, softening = np.zeros(angles.shape), np.zeros(angles.shape)
        if directions is not None:
            lag = -self._play / 2 * floats("directions", directions, angles.shape, finite=True)
        _, _, forearm, wrist = self._loads()
        # Torque about the elbow over that of the horizontal forearm.
        load = torques[:, 3] / ((forearm / 2 + wrist) * self.nominal_arm.d[4] / 1e3)
        softening[:, 3] = errors.softening_arcsec * _ARCSEC * load**3
        return {
            "eccentricity": turned(eccentricity),
            "torsion": turned(compliance * torques),
            "sag": self._bending(origin, probe),
            "wobble": errors.wobble_arcsec * _ARCSEC * np.cross(tilt, levers).sum(axis=1),
            "runout": errors.runout_um * 1e-3 * shift.sum(axis=1),
            "warming": warming * (_TUBE_EXPANSION * tubes + _BODY_EXPANSION * body),
            "play": turned(lag),
            "softening": turned(softening),
            "payload": turned(compliance * pulled) + self._bending(origin, probe, 0, payload),
        }

    def _loads(self):
        """Weights of the upper tube, the elbow, the forearm tube and the wrist, N."""
        upper, forearm = (_TUBE_WEIGHT_N_PER_M * self.nominal_arm.d[[2, 4]] / 1e3).tolist()
        return upper, _ELBOW_WEIGHT_N, forearm, _WRIST_WEIGHT_N

    def _torques(self, axes, origin):
        upper, elbow, forearm, wrist = self._loads()
        # A tube has the torque of two halves of its weight at its ends; frame k hangs on joints
        # 1 to k.
        weights = {2: upper / 2, 3: upper / 2 + elbow, 4: forearm / 2, 5: forearm / 2 + wrist}
        torques = np.zeros(axes.shape[:2])
        for k, weight in weights.items():
            levers = (origin[:, k, None] - origin[:, :k]) / 1e3  # m
            moments = np.cross(levers, -weight * self.true_arm.up)
            torques[:, :k] += (axes[:, :k] * moments).sum(axis=2)
        return torques

    def _bending(self, origin, probe, own_weight=1, payload: float | np.ndarray = 0.0):
        """How far the tubes bend under their own weight (0 or 1 times) and a payload in N."""
        upper, elbow, forearm, wrist = self._loads()
        moved, up = np.zeros_like(probe), self.true_arm.up
        for k, (start, end, load) in enumerate(((2, 3, elbow + forearm + wrist), (4, 5, wrist))):
            tube = origin[:, end] - origin[:, start]
            length = np.linalg.norm(tube, axis=1, keepdims=True)
            along = tube / length
            across = (along @ up)[:, None] * along - up
            weight = (upper, forearm)[k]  # w L
            # sag_um is that of the horizontal tube under its own weight and load.
            unit = self.errors.sag_um[k] * 1e-3 / (weight / 8 + load / 3)
            weight, load = own_weight * weight, own_weight * load + payload
            sag = unit * (weight / 8 + load / 3)
            slope = unit / length * (weight / 6 + load / 2)
            moved += sag * across
            moved += np.cross(slope * np.cross(along, across), probe - origin[:, end])
        return moved

    def forward(self, angles: ArrayLike, **state: ArrayLike) -> np.ndarray:
        """Where the probe really is.

        Parameters
        ----------
        angles : array-like of shape (n_samples, 6)
            In rad.
        **state : dict
            `warming_k`, `directions` and `payload_n` of :meth:`deviations`.

        Returns
        -------
        points : ndarray of shape (n_samples, 3)
            True centres of the probe, mm.
        """
        return self.true_arm.forward(angles) + sum(self.deviations(angles, **state).values())

    def read(
        self, angles: ArrayLike, random_state: int | np.random.RandomState | None = None
    ) -> np.ndarray:
        """Read the encoders: noise and quantisation on top of the angles.

        Parameters
        ----------
        angles
            As in :meth:`deviations`.
        random_state : int, RandomState instance or None, default=None
            Draws the noise.

        Returns
        -------
        readings : ndarray of shape (n_samples, 6)
            In rad.
        """
        rng = check_random_state(random_state)
        angles = self.true_arm.check_angles(angles)
        noise = self.errors.encoder_noise_arcsec * _ARCSEC
        readings = angles + noise * rng.normal(size=angles.shape)
        step = self.errors.quantisation_arcsec * _ARCSEC
        return np.round(readings / step) * step if step else readings

    def find_poses(
        self,
        point: ArrayLike,
        n_poses: int,
        random_state: int | np.random.RandomState | None = None,
    ) -> np.ndarray:
        """Find poses that a person would take with the probe in a cone, sorted by joint 3.

        Parameters
        ----------
        point : array-like of shape (3,)
            Centre of the cone in the base frame, mm. The cone opens upwards.
        n_poses : int
            Number of poses.
        random_state : int, RandomState instance or None, default=None
            Draws the poses.

        Returns
        -------
        angles : ndarray of shape (n_poses, 6)
            In rad. The nominal arm's probe is within 1e-6 mm of the point and leans at most 60
            degrees from the cone's axis; elbow and wrist are above the cone.

        Raises
        ------
        ValueError
            If so many poses cannot be found.
        """
        rng = check_random_state(random_state)
        point = floats("point", point, (3,), finite=True)
        check_scalar(n_poses, "n_poses", Integral, min_val=0)
        arm = self.nominal_arm
        poses = np.empty((0, 6))
        for _ in range(10):
            candidates = self._candidates(point, 4 * n_poses + 40, rng)
            reached = _reach(arm.forward, arm, candidates, point)
            poses = np.vstack([poses, reached[self._is_handy(reached, point)]])
            # More than asked for, so that even steps from left to right can be chosen.
            if len(poses) >= 1.5 * n_poses:
                poses = poses[np.argsort(poses[:, 2], kind="stable")]
                return poses[np.linspace(0, len(poses) - 1, n_poses).astype(int)]
        raise ValueError(
            f"Only {len(poses)} poses reach the point {point.round(1)} mm, {n_poses} are needed: "
            f"it is {np.linalg.norm(point - self.shoulder) / self.reach:.0%} of the reach away."
        )

    def solve(self, angles: np.ndarray, points: np.ndarray, **state: ArrayLike) -> np.ndarray:
        """Move poses a little until the true probe is at the points.

        Parameters
        ----------
        angles : ndarray of shape (n_samples, 6)
            Poses nearby, rad.
        points : ndarray of shape (n_samples, 3)
            Where the true probe shall be, mm.
        **state : dict
            `warming_k`, `directions` and `payload_n` of :meth:`deviations`.

        Returns
        -------
        angles : ndarray of shape (n_samples, 6)
            In rad; the true probe is within 1e-6 mm of the points.

        Raises
        ------
        ValueError
            If some points are out of reach.
        """
        angles = self.true_arm.check_angles(angles)
        points = floats("points", points, (len(angles), 3), finite=True)
        forward: Callable[..., np.ndarray] = partial(self.forward, **state)
        angles = _reach(forward, self.true_arm, angles, points)
        missed = np.linalg.norm(forward(angles) - points, axis=1) > 1e-6
        if missed.any():
            raise ValueError(f"{missed.sum()} of {len(missed)} points are out of the arm's reach.")
        return angles

    def _candidates(self, point, n, rng):
        """Rough poses towards a point: swing, elbow and wrist at random, the rest to match."""
        angles = np.zeros((n, 6))
        angles[:, 1] = -np.pi / 2  # upper arm horizontal
        angles[:, 2:] = rng.uniform(_LOW[:, None], _HIGH[:, None], (4, n)).T
        here = self.nominal_arm.forward(angles) - self.shoulder
        there = point - self.shoulder
        # Turn the shoulder until the probe's height is right, then the base.
        angles[:, 1] += np.arctan2(here[:, 2], np.hypot(here[:, 0], here[:, 1]))
        angles[:, 1] -= np.arctan2(there[2], np.hypot(there[0], there[1]))
        here = self.nominal_arm.forward(angles)
        angles[:, 0] = np.arctan2(point[1], point[0]) - np.arctan2(here[:, 1], here[:, 0])
        return angles

    def _is_handy(self, angles, point):
        frames = self.nominal_arm.frames(angles)
        probe = frames[:, -1, :, :3] @ self.nominal_arm.probe
        lean = -probe[:, 2] / np.linalg.norm(probe, axis=1)
        heights = frames[:, 3:6, 2, 3]
        handy = (angles[:, 2:] >= _LOW) & (angles[:, 2:] <= _HIGH)
        return (
            (np.linalg.norm(frames[:, -1, :, 3] + probe - point, axis=1) < 1e-6)
            & (lean > np.cos(_MAX_LEAN))
            & (heights > point[2]).all(axis=1)
            & handy.all(axis=1)
        )


def _per_row(name, value, n_rows):
    """A column of one number for each row, (n_rows, 1), or one row of it for all."""
    numbers = floats(name, value)
    if numbers.shape not in ((), (n_rows,)) or not np.all(np.isfinite(numbers)):
        raise ValueError(f"{name} must be a finite number, or {n_rows} of them, got {value!r:.60}.")
    return numbers.reshape(-1, 1)


def directions_of(angles: np.ndarray) -> np.ndarray:
    """Direction from which each joint came, (n, n_joints), in this order; the first as the next."""
    steps = np.diff(angles, axis=0)
    signs = np.sign((steps + np.pi) % (2 * np.pi) - np.pi)
    return np.concatenate([signs[:1], signs])


def directions_at(height, azimuth):
    """Unit vectors (n, 3) of this height and azimuth."""
    across = np.sqrt(1 - height**2)
    return np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), height])


def _reach(forward, arm, angles, points):
    """Newton steps of least norm towards the points; poses that do not reach them end nearby."""
    for _ in range(25):
        missing = points - forward(angles)
        if np.abs(missing).max() < 1e-10:
            break
        jacobian = arm.jacobian(angles)
        normal = jacobian @ jacobian.transpose(0, 2, 1)
        # A stretched arm is singular: 1e-9 of the trace keeps its steps finite.
        normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        solved = np.linalg.solve(normal, missing[..., None])[..., 0]
        step = np.einsum("nij,ni->nj", jacobian, solved)
        largest = np.abs(step).max(axis=1, keepdims=True)
        angles = angles + step * np.minimum(1, 0.3 / np.maximum(largest, 1e-300))
    return (angles + np.pi) % (2 * np.pi) - np.pi
