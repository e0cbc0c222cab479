"""What an arm accepts: numbers, bounds, angles; each fault gets one clear sentence."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_scalar

from sklearn_raacmm.utils import Finding, Floats, Weight, check_option, floats

# Two whole turns: multi-turn encoders pass, a log in degrees hardly ever does.
_WARN_RAD = 4 * np.pi
# Degrees of real poses are larger than one turn in radians in some joint. Joints of less than 0.2
# degrees stand still, and an arm that moves one joint only may stay near its zero.
_WARN_DEG, _STANDS_STILL_DEG = 2 * np.pi, 0.2
_NO_LIMITS = (-np.inf, np.inf)
# Ten turns: no arm's encoder counts as many, and no log in degrees holds them.
_ABSURD_DEG = 3600.0
# What slides without limits is taken to go so far to either side, mm: the longest usual tracks.
_TRAVEL_MM = 2000.0
# No scale of a rail is off by as much: it would be in another unit.
_MOST_SCALE = 0.1
# 100 m: larger than any arm, small enough to catch micrometres or encoder counts given as mm.
MAX_LENGTH_MM = 1e5
# Largest departure of a matrix from a rotation.
_ROTATION = 1e-5
# A nanometre: on any arm, shorter lengths and their directions are made of rounding.
MIN_LENGTH_MM = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class DHTable:
    """The fields of an `Arm`, which says what they are, checked: each fault gets one sentence."""

    a: Floats
    alpha: Floats
    d: Floats
    theta_offset: Floats = 0.0  # type: ignore[assignment]
    _: KW_ONLY
    probe: Floats = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    convention: str = "standard"
    joint_signs: Floats = 1  # type: ignore[assignment]
    pose_joints: tuple[int, int] = (3, 4)
    pose_frames: tuple[int, int] = (2, 5)
    name: str = ""
    names: tuple[str, ...] = ()
    limits: Floats | None = None
    up: Floats = (0.0, 0.0, 1.0)  # type: ignore[assignment]
    couplings: tuple[tuple[int, int, int], ...] = ()
    joint_types: str = None  # type: ignore[assignment]
    up_frame: int = 0

    def __post_init__(self) -> None:
        a = check_numbers("a", self.a, None, "mm", MAX_LENGTH_MM)
        n = a.size
        alpha = check_numbers("alpha", self.alpha, n, "rad", 2 * np.pi)
        types = check_types(self.joint_types, n)
        checked = {
            "a": a,
            "alpha": alpha,
            "d": check_numbers("d", self.d, n, "mm", MAX_LENGTH_MM),
            "theta_offset": check_numbers(
                "theta_offset", self.theta_offset, n, "rad", 2 * np.pi, True
            ),
            "probe": check_numbers("probe", self.probe, 3, "mm", MAX_LENGTH_MM),
            "joint_signs": check_numbers("joint_signs", self.joint_signs, n, "", 2, True),
            # A table that turns in one joint has no two.
            "pose_joints": (1, 1) if n == 1 else check_pair("pose_joints", self.pose_joints, 1, n),
            "pose_frames": check_pair("pose_frames", self.pose_frames, 0, n),
            "names": check_names(self.names, n),
            "limits": check_limits(self.limits, n),
            "up": check_direction("up", self.up),
            "couplings": check_couplings(self.couplings, n, types),
            "joint_types": types,
            "up_frame": int(
                check_scalar(self.up_frame, "up_frame", Integral, min_val=0, max_val=n)
            ),
        }
        off = np.abs(np.abs(checked["joint_signs"]) - 1)
        if np.any(off > scale_of(types, 0.0, _MOST_SCALE)):
            raise ValueError(
                "joint_signs must be -1 or 1 each, or of a joint that slides within "
                f"{_MOST_SCALE:.0%} of it, got {self.joint_signs!r:.60}."
            )
        check_option("convention", self.convention, ("standard", "modified"))
        if not is_name(self.name):
            raise ValueError(f"name must be a string of whole characters, got {self.name!r:.60}.")
        lengths = (checked[field] for field in ("a", "d", "probe"))
        if "P" not in types and not any(np.any(np.abs(one) > MIN_LENGTH_MM) for one in lengths):
            raise ValueError(
                f"a, d and probe hold no length above {MIN_LENGTH_MM:g} mm: an arm without any "
                "length does not move its probe."
            )
        for field, value in checked.items():
            object.__setattr__(self, field, value)

    @cached_property
    def n_joints(self) -> int:
        """Number of joints."""
        return self.a.size

    @cached_property
    def slides(self) -> list[int]:
        """Numbers, from 0, of the joints that slide."""
        return slides_of(self.joint_types)

    @property
    def bounds(self) -> np.ndarray:
        """Lowest and highest angle of each joint (2, n_joints), rad or mm; infinite without one."""
        if self.limits is None:
            return np.full((2, self.n_joints), [[-np.inf], [np.inf]])
        return self.limits.T

    @property
    def spans(self) -> np.ndarray:
        """From where to where joints are taken to go, (2, n_joints): a turn; what a slide may."""
        spans = np.array([[-np.pi], [np.pi]]) * np.ones(len(self.a))
        for i in self.slides:
            limits = self.bounds[:, i]
            known = np.isfinite(limits)
            spans[:, i] = np.where(known, limits, (-_TRAVEL_MM, _TRAVEL_MM))
            if known.sum() == 1:  # so far from the end that is known
                end = 1 - int(np.argmax(known))
                spans[end, i] = limits[1 - end] + (2 * end - 1) * 2 * _TRAVEL_MM
        return spans

    @cached_property
    def reach_mm(self) -> float:
        """Length of the stretched arm with its slides run out, an upper bound of its reach."""
        at_ends = np.abs(self.d + self.joint_signs * self.spans).max(axis=0)
        d = np.where(self.by_type(0.0) > 0, at_ends, self.d)
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
        return scale_of(self.joint_types, of_turns, of_slides)

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
        own = angles.copy()
        for joint, other, factor in self.couplings:
            own[:, joint - 1] += factor * angles[:, other - 1]
        return own


def check_types(value, n):
    """A letter for each joint, as one string: R where it turns, P where it slides."""
    types = "R" * n if value is None else "".join(map(str, value)).upper()
    if len(types) != n or set(types) - {"P", "R"}:
        raise ValueError(
            f"joint_types must have a letter for each of {n} joints, R where it turns and P where "
            f"it slides, such as {'PRRRRRRR'[:n]!r}, got {value!r:.60}."
        )
    return types


def check_couplings(value, n, types):
    """Triples of two different joints of one kind, from 1, and 1 or -1."""
    couplings = tuple(tuple(one) for one in value)
    joints = [str(i) for i in range(1, n + 1)]
    for one in couplings:
        good = len(one) == 3 and one[2] in (1, -1) and one[0] != one[1]
        if not (good and {str(one[0]), str(one[1])} <= set(joints)):
            raise ValueError(
                f"couplings must hold triples of two different joints from 1 to {n} and 1 or -1, "
                f"such as (3, 2, 1), got {one!r:.60}."
            )
        if types[int(one[0]) - 1] != types[int(one[1]) - 1]:
            raise ValueError(
                f"couplings hold {one!r:.60}, but of joints {one[0]} and {one[1]} one turns and "
                "the other slides: rad and mm have no sum."
            )
    return tuple(sorted(tuple(map(int, one)) for one in couplings))


def check_numbers(name, value, size, unit, bound, broadcast=False):
    """One finite float64 per joint, read-only."""
    # The fields of an arm that a calibration changes are such arrays: they need no conversion.
    array = value if type(value) is np.ndarray and value.dtype == float else floats(name, value)
    if broadcast and array.ndim == 0:
        array = np.broadcast_to(array, size)
    if array.ndim != 1 or not array.size or size not in (None, array.size):
        wanted = "one number per joint" if size is None else f"{size} numbers"
        raise ValueError(f"{name} must hold {wanted}, got shape {array.shape}.")
    if not np.all(np.abs(array) <= bound):  # false for NaN, too
        i = int(np.argmin(np.abs(array) <= bound))
        hint = ", or are they degrees? See Arm.from_degrees" if unit == "rad" else ""
        raise ValueError(
            f"{name}[{i}] = {array[i]:g} is out of bounds: it must be finite and at most "
            f"{bound:g}{unit and ' '}{unit}{hint}."
        )
    array = array + 0.0  # a copy of our own, in which -0.0 is 0.0: they are the same arm
    array.flags.writeable = False
    return array


def check_direction(name, value):
    """A unit vector, read-only, of a vector of any length."""
    vector = check_numbers(name, value, 3, "", MAX_LENGTH_MM)
    length = np.linalg.norm(vector)
    if not length > MIN_LENGTH_MM:
        raise ValueError(f"{name} must be a vector with a direction, got {value!r:.60}.")
    if abs(length - 1) > 4 * np.finfo(float).eps:  # a unit vector stays the same to the last bit
        vector = vector / length
        vector.flags.writeable = False
    return vector


def check_names(names, n):
    """Names of the joints: none, or a different one for each."""
    given = tuple(names) if isinstance(names, list | tuple) else ("",)
    whole = all(name and is_name(name) for name in given)
    if not whole or len(given) not in (0, n) or len(set(given)) < len(given):
        raise ValueError(f"names must be {n} different names of joints, got {names!r:.60}.")
    return given


def is_name(value):
    """Whether a value is a string of whole characters, which can be written to a file."""
    # Unpaired surrogates, which only escapes in JSON can bring, cannot.
    return isinstance(value, str) and not any("\ud800" <= c <= "\udfff" for c in value)


def check_limits(limits, n):
    """Lower and upper limit of each joint, rad or mm, read-only; None where there are none."""
    if limits is None:
        return None
    if isinstance(limits, list | tuple):  # None, where a file cannot hold infinity
        limits = [
            [end if value is None else value for end, value in zip(_NO_LIMITS, pair, strict=False)]
            for pair in limits
        ]
    limits = floats("limits", limits) + 0.0
    if limits.shape != (n, 2):
        raise ValueError(f"limits must have shape ({n}, 2), got {limits.shape}.")
    wrong = ~(limits[:, 0] <= limits[:, 1])  # true for NaN, too
    if np.any(wrong):
        i = int(np.argmax(wrong))
        raise ValueError(f"limits of joint {i + 1} must go from low to high, got {limits[i]}.")
    if not np.isfinite(limits).any():
        return None
    limits.flags.writeable = False
    return limits


def are_rotations(turns: np.ndarray) -> np.ndarray:
    """Whether matrices (..., 3, 3) are rotations, of which six digits may have been written."""
    off = np.abs(turns @ turns.swapaxes(-1, -2) - np.eye(3)).max(axis=(-1, -2))
    return (off < _ROTATION) & (np.linalg.det(turns) > 0)


def check_pair(name, value, low, high):
    """Two different whole numbers."""
    pair = floats(name, value)
    fits = (pair == np.round(pair)) & (low <= pair) & (pair <= high)
    if pair.shape != (2,) or not fits.all() or pair[0] == pair[1]:
        raise ValueError(
            f"{name} must be two different whole numbers from {low} to {high}, got {value!r:.60}."
        )
    return tuple(pair.astype(int).tolist())


def check_angles(angles: ArrayLike, joints: int | str, angle_unit: str) -> np.ndarray:
    """Angles (n_samples, n_joints) as float64 in rad; warns where the unit is likely another.

    `joints` are how many there are, or the `joint_types` of an arm: what slides is in mm, whatever
    the unit of the angles.
    """
    check_option("angle_unit", angle_unit, ("rad", "deg"))
    angles = floats("angles", angles)
    n_joints = joints if isinstance(joints, int) else len(joints)
    if angles.ndim != 2 or angles.shape[1] != n_joints:
        raise ValueError(
            f"angles must have shape (n_samples, {n_joints}) for an arm of "
            f"{n_joints} joints, got {angles.shape}."
        )
    if not len(angles):
        return angles
    if slides := slides_of(joints):
        turned, mm = angles.copy(), angles[:, slides]
        largest = np.abs(mm).max(axis=0)
        if not np.all(largest <= MAX_LENGTH_MM):  # false for NaN, too
            i = int(np.argmin(largest <= MAX_LENGTH_MM))
            row = int(np.argmin(np.abs(mm[:, i]) <= MAX_LENGTH_MM))
            raise ValueError(
                f"joint {slides[i] + 1} slides, and is at {mm[row, i]:g} mm in row {row}: a finite "
                f"number of at most {MAX_LENGTH_MM:g} mm is needed."
            )
        turned[:, slides] = 0.0
        turned = check_angles(turned, n_joints, angle_unit)
        turned[:, slides] = mm
        return turned
    # Max and min carry NaN along: one pass each, and no mask of the size of the data.
    if angle_unit == "rad" and max(angles.max(), -angles.min()) <= _WARN_RAD:  # false for NaN
        return angles
    largest = np.maximum(angles.max(axis=0), -angles.min(axis=0))
    if not np.all(np.isfinite(largest)):
        bad = np.argwhere(~np.isfinite(angles))
        row, column = bad[0]
        raise ValueError(
            f"angles hold {len(bad)} NaN or infinite values; the first is "
            f"{angles[row, column]} in row {row}, joint {column + 1}."
        )
    most, joint = float(largest.max()), int(largest.argmax()) + 1
    at = f"(joint {joint})"
    weight: Weight = "doubt"
    if angle_unit == "rad":
        text = f"angles reach {most:g} rad {at}, more than two turns:"
        advice = 'if they are degrees, convert them or pass angle_unit="deg" (raacmm: --unit deg).'
    elif most > _ABSURD_DEG:
        text = f"angles reach {most:g} degrees {at}, more than ten turns:"
        advice, weight = "are they counts of the encoders? Convert them to degrees.", "repair"
    elif most < _WARN_DEG and np.sum(largest > _STANDS_STILL_DEG) > 1:
        text = f"angles in degrees reach {most:g} only {at}:"
        advice = 'if they are radians, pass angle_unit="rad" (raacmm: --unit rad).'
    else:
        return np.deg2rad(angles)
    Finding("angle-unit", text, advice, weight, joints=(joint,)).report()
    return angles if angle_unit == "rad" else np.deg2rad(angles)


def slides_of(joints: int | str) -> list[int]:
    """Numbers, from 0, of the joints that slide, of how many there are or their types."""
    if isinstance(joints, int) or "P" not in joints:  # nearly all, and a pose takes 20 us
        return []
    return [i for i, kind in enumerate(joints) if kind == "P"]


def scale_of(types: str, of_turns: float, of_slides: float = 1.0) -> np.ndarray:
    """A number for each joint, (n_joints,): one for those that turn, one for those that slide."""
    return np.where([kind == "P" for kind in types], of_slides, of_turns)
