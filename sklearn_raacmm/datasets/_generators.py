"""Simulated single-point tests and gauges; public in `sklearn_raacmm.datasets`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from functools import lru_cache, partial
from numbers import Integral
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils import Bunch, check_random_state, check_scalar

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import calibrate
from sklearn_raacmm.datasets._arm_errors import ArmErrors
from sklearn_raacmm.datasets._simulation import SimulatedArm, directions_of
from sklearn_raacmm.measurements import position_residuals
from sklearn_raacmm.utils import Floats, floats, param_checks

_SHARE_OF_REACH = (0.2, 0.8)
_MAX_ELEVATION = np.deg2rad(35)
# The reference temperature of dimensional metrology (ISO 1).
_CALIBRATED_AT_DEGC = 20.0
# A usual standard uncertainty of a gauge with cones at its ends.
_LENGTH_SD_MM = 0.01
# Numbers and lengths are checked with the machine at hand.
_CONSTRAINTS = {"machine": [SimulatedArm, ArmErrors, str], "random_state": ["random_state"]}

if TYPE_CHECKING:  # scikit-learn's Bunch has no types

    class SimulatedTest(dict[str, object]):
        data: Floats
        target: Floats
        groups: NDArray[np.int_]
        lengths: Any
        points: Floats
        arm: Arm
        nominal_arm: Arm
        feature_names: list[str]
        target_names: list[str]
        directions: Floats
        temperature: Floats
        payload: Floats
        simulation: Any


@param_checks.validate_params(_CONSTRAINTS, prefer_skip_nested_validation=True)
def make_single_point(
    n_positions: int = 10,
    n_poses: int = 100,
    *,
    bars: ArrayLike = (),
    machine: SimulatedArm | ArmErrors | str = "typical",
    random_state: int | np.random.RandomState | None = 0,
) -> "SimulatedTest":
    """Simulate the cone-hole test: the probe in one cone, the elbow swung from left to right.

    Parameters
    ----------
    n_positions : int, default=10
        Positions of the cone, spread over 20 to 80 % of the radial reach and all azimuths.
    n_poses : int, default=100
        Number of poses at each position, at least 2.
    bars : array-like of shape (n_bars,), default=()
        Lengths in mm of bars with a cone at each end, which are two more positions each.
    machine : SimulatedArm or ArmErrors or str, default="typical"
        The arm; or the sizes of its error sources, or the name of a mix of them ("typical",
        "gravity", "eccentricity", "none"), of which `random_state` draws an individual.
    random_state : int, RandomState instance or None, default=0
        Draws positions, poses and noise, the same everywhere but for rounding. :func:`make_gauge`
        with the same int and `machine` measures with the same individual, at other places.

    Returns
    -------
    data : :class:`~sklearn.utils.Bunch`
        What the arm's user has:

        data : ndarray of shape (n_rows, 6)
            Encoder readings, rad, in the order in which they were taken.
        target : ndarray of shape (n_rows, 3)
            Residuals dx, dy, dz, mm: point minus mean point of its position.
        groups : ndarray of shape (n_rows,)
            Number of the position, by which to split.
        lengths : list of (int, int, float, float)
            Known lengths, as :func:`calibrate` takes them: the two ends of each bar, its length
            with an error, and the standard deviation of that, 0.01 mm.
        points : ndarray of shape (n_rows, 3)
            Points that the calibrated arm shows, mm.
        arm : Arm
            The arm as calibrated on simulated data of its own, at another temperature.
        nominal_arm : Arm
            The arm before calibration.
        feature_names, target_names : list of str
            Names of the columns.
        directions : ndarray of shape (n_rows, 6)
            Direction from which each joint came: 1 from smaller angles, -1 from larger ones.
        temperature : ndarray of shape (n_rows,)
            Temperature of the arm, degC; it was calibrated at 20 degC.
        payload : ndarray of shape (n_rows,)
            Weight at the probe, N; it was calibrated without.
        simulation : Bunch
            What is known in a simulation only: ``machine`` (SimulatedArm), ``positions``
            (centres of the cones, mm), ``true_points`` (where the probe really was, mm),
            ``perfect_correction`` (what the best possible model predicts from the readings, mm) and
            ``slipped`` (whether the probe had slipped out of its cone).

    Raises
    ------
    ValueError
        If a number is too small, the machine unknown, or no reachable place is found.

    Examples
    --------
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> from sklearn_raacmm.metrics import single_point_repeatability
    >>> test = make_single_point(n_positions=3, n_poses=20)
    >>> test.data.shape, test.target.shape
    ((60, 6), (60, 3))
    >>> 0 < single_point_repeatability(test.points, test.groups) < 0.2
    True
    """
    check_scalar(n_positions, "n_positions", Integral, min_val=1)
    check_scalar(n_poses, "n_poses", Integral, min_val=2)
    machine, rng = machine_and_stream(machine, random_state, stream=1)
    positions, poses = draw_cones(machine, n_positions, n_poses, rng)
    known = []
    if np.size(bars):
        bars = _check_lengths(bars, machine)
        ends, more = draw_gauges(machine, bars, n_poses, rng)
        positions, poses = np.vstack([positions, ends]), poses + more
        given = (bars + _LENGTH_SD_MM * rng.normal(size=len(bars))).tolist()
        first = range(n_positions, n_positions + len(ends), 2)
        known = [(i, i + 1, size, _LENGTH_SD_MM) for i, size in zip(first, given, strict=True)]
    data = measure(machine, positions, poses, rng)
    data.update(lengths=known)
    return data


@param_checks.validate_params(_CONSTRAINTS, prefer_skip_nested_validation=True)
def make_gauge(
    lengths: ArrayLike = (300.0, 500.0),
    n_placements: int = 10,
    n_poses: int = 10,
    *,
    machine: SimulatedArm | ArmErrors | str = "typical",
    random_state: int | np.random.RandomState | None = 0,
) -> Any:
    """Simulate measurements of gauges: two cones at a known distance, in many placements.

    Parameters
    ----------
    lengths : float or array-like of shape (n_lengths,), default=(300.0, 500.0)
        Lengths of the gauges, mm.
    n_placements : int, default=10
        Placements of each gauge, at random in 20 to 80 % of the radial reach, in all directions.
    n_poses : int, default=10
        Number of poses at each end, at least 2.
    machine, random_state
        As in :func:`make_single_point`.

    Returns
    -------
    data : :class:`~sklearn.utils.Bunch`
        As :func:`make_single_point`, where a position is an end of a placed gauge, and:

        pairs : ndarray of shape (n_lengths * n_placements, 2)
            Groups of the two ends of each placement.
        lengths : ndarray of shape (n_lengths * n_placements,)
            Calibrated length of each placement, mm.

    Raises
    ------
    ValueError
        If a number is too small, a length does not fit, or the machine is unknown.

    Examples
    --------
    >>> from sklearn_raacmm.datasets import make_gauge
    >>> from sklearn_raacmm.metrics import gauge_lengths, length_error
    >>> test = make_gauge(300, n_placements=3)
    >>> measured = gauge_lengths(test.points, test.groups, test.pairs)
    >>> bool(abs(length_error(measured, test.lengths)).max() < 0.2)
    True
    """
    check_scalar(n_placements, "n_placements", Integral, min_val=1)
    check_scalar(n_poses, "n_poses", Integral, min_val=2)
    machine, rng = machine_and_stream(machine, random_state, stream=2)
    lengths = np.repeat(_check_lengths(lengths, machine), n_placements)
    ends, poses = draw_gauges(machine, lengths, n_poses, rng)
    data = measure(machine, ends, poses, rng)
    data.update(pairs=np.arange(2 * len(lengths)).reshape(-1, 2), lengths=lengths)
    return data


@lru_cache(maxsize=64)
def calibrated_arm(machine):
    """Calibrate the arm as its user would, before it warms, with cones and gauges of its own."""
    rng = np.random.RandomState(machine.calibration_seed)
    positions, poses = draw_cones(machine, 14, 40, rng)
    lengths = np.repeat([300.0, 500.0], 6)
    ends, end_poses = draw_gauges(machine, lengths, 10, rng)
    cones = np.vstack([positions, ends])
    # At one temperature, and by a careful user whose probe never slips.
    angles, groups, _ = take_readings(machine, cones, poses + end_poses, rng)
    first = len(positions) + 2 * np.arange(len(lengths))
    known = [(i, i + 1, length, _LENGTH_SD_MM) for i, length in zip(first, lengths, strict=True)]
    with warnings.catch_warnings():
        # The gauges are exact here. They disagree because the arm is wrong, by up to 0.1 mm.
        warnings.filterwarnings("ignore", ".*known lengths disagree", UserWarning)
        result = calibrate(
            machine.nominal_arm,
            angles,
            groups,
            lengths=known,
            # Fixed, so that the simulated data stay what they are.
            prior_length_mm=2.0,
            prior_angle_rad=0.02,
            accept=["wrong-length", "moved-position"],
        )
    return result.arm.replace(name="calibrated (simulated)")


def take_readings(
    machine, cones, poses, rng, warming_k=0.0, slipped: ArrayLike = 0.0, payload_n: ArrayLike = 0.0
):
    """Read the encoders in all poses at all cones: angles, each row's cone, and true points."""
    groups = np.repeat(np.arange(len(cones)), [len(p) for p in poses])
    seating = machine.errors.seating_um * 1e-3 * rng.normal(size=(len(groups), 3))
    true_points = cones[groups] + seating + slipped
    poses = np.vstack(poses)
    state = {"warming_k": warming_k, "directions": directions_of(poses), "payload_n": payload_n}
    return machine.read(machine.solve(poses, true_points, **state), rng), groups, true_points


def measure(machine, cones, poses, rng, groups=None, features=()):
    """What the user of an arm has after a test, and what only the simulation knows.

    Of touches of features each row has a place of its own, and `groups` (n_rows,) name the feature.
    """
    n_rows, errors = sum(map(len, poses)), machine.errors
    # Three time constants of an arm that has been switched on.
    warm = (1 - np.exp(-np.linspace(0, 3, n_rows))) / (1 - np.exp(-3))
    warming = errors.warming_k + errors.drift_k * warm
    slips, payload = np.zeros((n_rows, 3)), np.zeros(n_rows)
    # Without these sources nothing is drawn: the noise after them stays what it was.
    if errors.slip_share:
        slipped = rng.uniform(size=n_rows) < errors.slip_share
        away = rng.normal(size=(n_rows, 3))
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        slips = errors.slip_mm * slipped[:, None] * away
    directions = directions_of(np.vstack(poses))
    if errors.payload_n:
        payload = rng.uniform(0, errors.payload_n, n_rows)
    angles, own, true_points = take_readings(machine, cones, poses, rng, warming, slips, payload)
    groups = own if groups is None else groups
    arm = calibrated_arm(machine)
    points = arm.forward(angles)
    return Bunch(
        data=angles,
        target=position_residuals(points, groups, features=features),
        groups=groups,
        points=points,
        arm=arm,
        nominal_arm=machine.nominal_arm,
        feature_names=[f"theta{i}" for i in range(1, 7)],
        target_names=["dx", "dy", "dz"],
        directions=directions,
        temperature=_CALIBRATED_AT_DEGC + warming,
        payload=payload,
        simulation=Bunch(
            machine=machine,
            positions=cones,
            true_points=true_points,
            perfect_correction=points
            - machine.forward(angles, warming_k=warming, directions=directions, payload_n=payload),
            slipped=np.any(slips, axis=1),
        ),
    )


def draw_cones(machine, n, n_poses, rng):
    """Cones spread evenly over the radial reach, and poses that reach them."""
    low, high = _SHARE_OF_REACH

    def draw(stratum):
        share = low + (high - low) * (stratum + rng.uniform()) / n
        return [_in_direction(machine, share, rng)]

    draws = [(partial(draw, i), f"cone {i + 1} of {n}") for i in range(n)]
    return _reachable(machine, n_poses, rng, draws, 100)


def draw_gauges(machine, lengths, n_poses, rng):
    """Place the gauges: their ends, two rows each, and poses that reach them."""

    def draw(length):
        middle = _in_direction(machine, rng.uniform(*_SHARE_OF_REACH), rng)
        direction = rng.normal(size=3)
        half = length / 2 * direction / np.linalg.norm(direction)
        return [middle - half, middle + half]

    draws = [(partial(draw, length), f"a gauge of {length:g} mm") for length in lengths]
    return _reachable(machine, n_poses, rng, draws, 1000)


def _reachable(machine, n_poses, rng, draws, n_tries):
    """Points, each drawn again until there are poses that reach it, and these poses."""
    places, reached = [], []
    for draw, name in draws:
        for _ in range(n_tries):
            points, poses = draw(), []
            shares = [np.linalg.norm(at - machine.shoulder) / machine.reach for at in points]
            low, high = _SHARE_OF_REACH
            try:
                for point, share in zip(points, shares, strict=True):
                    if not low <= share <= high or point[2] < 0:
                        break  # out of the shell, or below the table
                    poses.append(machine.find_poses(point, n_poses, rng))
            except ValueError:
                continue
            if len(poses) == len(points):
                break
        else:
            raise ValueError(f"No place for {name} was found.")
        places += points
        reached += poses
    return np.array(places), reached


def _in_direction(machine, share, rng):
    azimuth, elevation = rng.uniform(-np.pi, np.pi), rng.uniform(-_MAX_ELEVATION, _MAX_ELEVATION)
    across, up = np.cos(elevation), np.sin(elevation)
    direction = np.array([across * np.cos(azimuth), across * np.sin(azimuth), up])
    return machine.shoulder + share * machine.reach * direction


_individual = lru_cache(maxsize=64)(SimulatedArm)


def machine_and_stream(machine, random_state, stream) -> tuple[SimulatedArm, np.random.RandomState]:
    # An instance of RandomState gives the next int, so that both uses below agree on it.
    if isinstance(random_state, int | np.integer):
        seed = int(random_state)
    else:
        seed = check_random_state(random_state).randint(2**31 - 1)
    if not isinstance(machine, SimulatedArm):
        machine = _individual(machine, random_state=seed)
    return machine, np.random.RandomState([seed, stream])


def _check_lengths(lengths, machine) -> np.ndarray:
    lengths = np.atleast_1d(floats("lengths", lengths))
    # Both ends in the shell: the longest gauge spans it.
    longest = 2 * _SHARE_OF_REACH[1] * machine.reach
    if lengths.ndim != 1 or not lengths.size or not ((lengths > 0) & (lengths < longest)).all():
        raise ValueError(f"lengths must be between 0 and {longest:.0f} mm, got {lengths!r:.60}.")
    return lengths
