"""The arm as a value: its Denavit-Hartenberg table, its probe, and its forward kinematics."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import json
import os
import warnings
from dataclasses import KW_ONLY, dataclass, fields
from pathlib import Path

import numpy as np

__all__ = ["Arm"]

# Rows computed at once: the working set of a chunk (about 30 rows of float64) stays in the cache.
_CHUNK_ROWS = 4096
# Two whole turns: multi-turn encoders pass, a log in degrees hardly ever does.
_WARN_RAD = 4 * np.pi
# 100 m: larger than any arm, small enough to catch micrometres or encoder counts given as mm.
_MAX_LENGTH_MM = 1e5
_FORMAT = "sklearn_raacmm.Arm"
_FORMAT_VERSION = 1
# Field of the class -> key of the JSON file; the units are part of the file's keys.
_JSON_KEYS = {
    "name": "name",
    "convention": "convention",
    "a": "a_mm",
    "alpha": "alpha_rad",
    "d": "d_mm",
    "theta_offset": "theta_offset_rad",
    "probe": "probe_mm",
    "joint_signs": "joint_signs",
    "pose_joints": "pose_joints",
    "pose_frames": "pose_frames",
}


@dataclass(frozen=True, eq=False, repr=False)
class Arm:
    """An articulated arm: Denavit-Hartenberg table, probe, and the joints that make its pose.

    An immutable value: equal and hashable by content, picklable, and safe to use as a parameter
    of an estimator. Lengths are in mm, angles in rad.

    Parameters
    ----------
    a : array-like of shape (n_joints,)
        Link lengths in mm.
    alpha : array-like of shape (n_joints,)
        Link twists in rad.
    d : array-like of shape (n_joints,)
        Joint offsets in mm.
    theta_offset : float or array-like of shape (n_joints,), default=0
        Angle in rad added to each (signed) joint angle.
    probe : array-like of shape (3,), default=(0, 0, 0)
        Vector from the origin of the last frame to the centre of the probe, in that frame, mm.
    convention : {"standard", "modified"}, default="standard"
        How row ``i`` of the table takes frame ``i - 1`` to frame ``i``:

        - "standard": ``Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)``;
        - "modified" (Craig): ``Rx(alpha_i) Tx(a_i) Rz(theta_i) Tz(d_i)``, where `a` and `alpha`
          of row ``i`` are those usually written with the index ``i - 1``;

        with ``theta_i = joint_signs_i * angle_i + theta_offset_i``.
    joint_signs : {-1, 1} or array-like of shape (n_joints,), default=1
        Sense in which each encoder counts.
    pose_joints : tuple of two int, default=(3, 4)
        Numbers, from 1, of the joints that make the pose: swivel and elbow. Arms without a roll
        before the elbow name other joints.
    pose_frames : tuple of two int, default=(2, 5)
        Numbers of the frames, from 0 (the base) to `n_joints`, whose origins are the shoulder and
        the wrist.
    name : str, default=""
        For people.

    Attributes
    ----------
    n_joints : int
        Number of joints.

    See Also
    --------
    Arm.from_name : The arms that are built in.
    Arm.from_degrees : From a table whose angles are in degrees.

    Notes
    -----
    ``forward`` is equation (1) of Gao et al. (2020), doi 10.1177/1729881420925638, with a free
    probe vector instead of ``(0, 0, l)``; the equation itself is a reconstruction.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import Arm
    >>> arm = Arm.from_degrees(
    ...     a=[0, 62, 0, 62, 0, 0], alpha=[-90, -90, 90, -90, 90, -90],
    ...     d=[376.5, 0, 750, 0, 500, 15], probe=(0, 0, 100), name="nominal")
    >>> arm
    <Arm 'nominal': 6 joints, standard DH, probe (0, 0, 100) mm>
    >>> arm.forward(np.deg2rad([[0, 90, 0, 90, 0, 0]])).round(6)
    array([[-812. ,   15. ,  914.5]])
    >>> arm.forward([[0, 90, 0, 90, 0, 0]], angle_unit="deg").round(6)
    array([[-812. ,   15. ,  914.5]])
    """

    a: np.ndarray
    alpha: np.ndarray
    d: np.ndarray
    theta_offset: np.ndarray = 0.0
    _: KW_ONLY
    probe: np.ndarray = (0.0, 0.0, 0.0)
    convention: str = "standard"
    joint_signs: np.ndarray = 1
    pose_joints: tuple = (3, 4)
    pose_frames: tuple = (2, 5)
    name: str = ""

    def __post_init__(self):
        a = _numbers("a", self.a, None, "mm", _MAX_LENGTH_MM)
        n = a.size
        checked = {
            "a": a,
            "alpha": _numbers("alpha", self.alpha, n, "rad", 2 * np.pi),
            "d": _numbers("d", self.d, n, "mm", _MAX_LENGTH_MM),
            "theta_offset": _numbers("theta_offset", self.theta_offset, n, "rad", 2 * np.pi, True),
            "probe": _numbers("probe", self.probe, 3, "mm", _MAX_LENGTH_MM),
            "joint_signs": _numbers("joint_signs", self.joint_signs, n, "", 1, True),
            "pose_joints": _pair("pose_joints", self.pose_joints, 1, n),
            "pose_frames": _pair("pose_frames", self.pose_frames, 0, n),
        }
        if np.any(np.abs(checked["joint_signs"]) != 1):
            raise ValueError(f"joint_signs must be -1 or 1 each, got {_show(self.joint_signs)}.")
        if not (isinstance(self.convention, str) and self.convention in ("standard", "modified")):
            raise ValueError(
                f"convention must be 'standard' or 'modified', got {self.convention!r}."
            )
        if not isinstance(self.name, str):
            raise ValueError(f"name must be a string, got {self.name!r}.")
        for field, value in checked.items():
            object.__setattr__(self, field, value)

    # -- a value: equality, copies, representation ------------------------------------------

    def _key(self):
        return tuple(
            value.tobytes() if isinstance(value, np.ndarray) else value
            for value in (getattr(self, field.name) for field in fields(self))
        )

    def __eq__(self, other):
        return self._key() == other._key() if isinstance(other, Arm) else NotImplemented

    def __hash__(self):
        return hash(self._key())

    def __copy__(self):
        return self

    def __deepcopy__(self, memo):
        return self

    def __reduce__(self):
        # Through the constructor: arrays restored by pickle would be writable.
        return _rebuild, ({field.name: getattr(self, field.name) for field in fields(self)},)

    def __repr__(self):
        name = f" {self.name!r}" if self.name else ""
        probe = ", ".join(f"{value:g}" for value in self.probe)
        return f"<Arm{name}: {self.n_joints} joints, {self.convention} DH, probe ({probe}) mm>"

    def __str__(self):
        rows = ["joint  sign      a/mm   alpha/deg      d/mm  offset/deg"]
        for i in range(self.n_joints):
            rows.append(
                f"{i + 1:5d}  {self.joint_signs[i]:+4.0f}{self.a[i]:10.4f}"
                f"{np.rad2deg(self.alpha[i]):12.4f}{self.d[i]:10.4f}"
                f"{np.rad2deg(self.theta_offset[i]):12.4f}"
            )
        return "\n".join([repr(self), *rows])

    @property
    def n_joints(self):
        """Number of joints."""
        return self.a.size

    def replace(self, **changes):
        """Return a new arm with some fields changed.

        Parameters
        ----------
        **changes : dict
            Parameters of `Arm` and their new values.

        Returns
        -------
        Arm
            The changed arm.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> Arm.from_name("panda").replace(probe=(0, 0, 138), name="with a ball")
        <Arm 'with a ball': 7 joints, modified DH, probe (0, 0, 138) mm>
        """
        known = {field.name: getattr(self, field.name) for field in fields(self)}
        unknown = sorted(set(changes) - set(known))
        if unknown:
            raise TypeError(f"Arm has no parameter {', '.join(unknown)}; it has {list(known)}.")
        return Arm(**{**known, **changes})

    # -- constructors -----------------------------------------------------------------------

    @classmethod
    def from_degrees(cls, a, alpha, d, theta_offset=0.0, **params):
        """Build an arm from a table in mm and degrees.

        Parameters
        ----------
        a, d : array-like of shape (n_joints,)
            Lengths in mm.
        alpha, theta_offset : array-like of shape (n_joints,)
            Angles in degrees.
        **params : dict
            The other parameters of `Arm`.

        Returns
        -------
        Arm
            The arm; its attributes are in mm and rad.
        """
        alpha, theta_offset = (
            np.deg2rad(_floats(name, value))
            for name, value in (("alpha", alpha), ("theta_offset", theta_offset))
        )
        return cls(a, alpha, d, theta_offset, **params)

    @classmethod
    def from_name(cls, name, **changes):
        """Return one of the built-in arms.

        Parameters
        ----------
        name : {"aacmm6", "panda", "ur10"}
            - "aacmm6": a six-joint arm CMM of about 1.35 m reach with its identified parameters,
              Table 2 of "A Novel Kinematic Parameters Identification Method for AACMM Using
              Repeatability and Scaling Factor", Mathematical Problems in Engineering 2018,
              article 1760190;
            - "panda": the Franka Panda, nominal, seven joints, modified convention; the probe is
              the centre of the flange, (0, 0, 107) mm;
            - "ur10": the Universal Robots UR10, nominal, six joints; the probe is the centre of
              the flange. Its shoulder, elbow and first wrist axes are parallel, so there is no
              swivel between shoulder and elbow: its pose is joint 4 and joint 3 (which, with the
              elevation of the line from shoulder to wrist, make the whole shape of the arm in its
              vertical plane; joints 2 and 3 would repeat what the elevation says already).
        **changes : dict
            Parameters of `Arm` to change, such as ``probe``.

        Returns
        -------
        Arm
            The arm.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> Arm.from_name("aacmm6")
        <Arm 'aacmm6': 6 joints, standard DH, probe (0, 0, 97.811) mm>
        """
        if not (isinstance(name, str) and name in _BUILT_IN):
            raise ValueError(f"name must be one of {sorted(_BUILT_IN)}, got {name!r}.")
        return cls.from_degrees(name=name, **_BUILT_IN[name]).replace(**changes)

    @classmethod
    def from_json(cls, source):
        """Read an arm from a JSON file.

        Parameters
        ----------
        source : str or path-like
            Path of the file, or the text itself if it starts with a brace.

        Returns
        -------
        Arm
            The arm, equal to the one that was written.

        Raises
        ------
        ValueError
            If the text is not JSON, of another format or version, or a field is missing, not
            numeric or out of bounds; the sentence names the field.
        """
        if isinstance(source, str) and source.lstrip().startswith("{"):
            text, where = source, "the JSON text"
        else:
            text, where = Path(source).read_text(encoding="utf-8"), str(source)
        try:
            content = json.loads(text)
        except ValueError as error:
            raise ValueError(f"{where} is not valid JSON: {error}.") from None
        if not isinstance(content, dict) or content.get("format") != _FORMAT:
            raise ValueError(f'{where} is not an arm: it needs "format": "{_FORMAT}".')
        if content.get("format_version") != _FORMAT_VERSION:
            raise ValueError(
                f"{where} has format_version {content.get('format_version')!r}, "
                f"this version reads {_FORMAT_VERSION}."
            )
        missing = [key for key in _JSON_KEYS.values() if key not in content]
        if missing:
            raise ValueError(f"{where} lacks the field {missing[0]!r}.")
        for key in _JSON_KEYS.values():  # true and false would pass for 1 and 0
            if any(isinstance(v, bool) for v in np.ravel(np.array(content[key], dtype=object))):
                raise ValueError(f"{where}: {key} must hold numbers, got {_show(content[key])}.")
        try:
            return cls(**{field: content[key] for field, key in _JSON_KEYS.items()})
        except ValueError as error:
            raise ValueError(f"{where}: {error}") from None

    def to_json(self, path=None):
        """Write the arm as JSON, with the units in the names of the fields.

        Parameters
        ----------
        path : str or path-like, default=None
            File to write. It is written beside and renamed, so that a file of this name is always
            whole. None only returns the text.

        Returns
        -------
        str
            The text.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> arm = Arm.from_name("panda")
        >>> Arm.from_json(arm.to_json()) == arm
        True
        """
        content = {"format": _FORMAT, "format_version": _FORMAT_VERSION}
        for field, key in _JSON_KEYS.items():
            value = getattr(self, field)
            content[key] = value.tolist() if isinstance(value, np.ndarray) else value
        text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
        if path is not None:
            path = Path(path).resolve()
            beside = path.with_name(f"{path.name}.{os.getpid()}.tmp")
            try:
                beside.write_text(text, encoding="utf-8")
                beside.replace(path)
            finally:
                beside.unlink(missing_ok=True)
        return text

    # -- kinematics -------------------------------------------------------------------------

    def forward(self, angles, *, angle_unit="rad"):
        """Position of the probe, equation (1).

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints)
            Joint angles as the encoders give them.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `angles`.

        Returns
        -------
        ndarray of shape (n_samples, 3)
            Probe points in the base frame, mm, float64.

        Raises
        ------
        ValueError
            If `angles` has another number of columns than the arm has joints, or holds NaN,
            infinity or something that is not a number.

        Warns
        -----
        UserWarning
            If an angle is more than two turns: most likely another unit.
        """
        angles = self._check_angles(angles, angle_unit)
        points = np.empty((len(angles), 3))
        for rows in _chunks(len(angles)):
            points[rows] = _probe_points(self, _theta(self, angles[rows])).T
        return points

    def azimuth(self, angles, *, angle_unit="rad"):
        """Azimuth of the probe about the base's z axis.

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints)
            Joint angles.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `angles`.

        Returns
        -------
        ndarray of shape (n_samples,)
            ``atan2(y, x)`` of the probe in rad, from -pi to pi.
        """
        points = self.forward(angles, angle_unit=angle_unit)
        return np.arctan2(points[:, 1], points[:, 0])

    def frames(self, angles, *, angle_unit="rad"):
        """Pose of every frame in the base frame.

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints)
            Joint angles.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `angles`.

        Returns
        -------
        ndarray of shape (n_samples, n_joints + 1, 3, 4)
            ``[R | t]`` of frames 0 (the base) to `n_joints`; t in mm.
        """
        angles = self._check_angles(angles, angle_unit)
        frames = np.empty((len(angles), self.n_joints + 1, 3, 4))
        for rows in _chunks(len(angles)):
            frames[rows] = _frame_columns(self, _theta(self, angles[rows])).transpose(3, 0, 2, 1)
        return frames

    def jacobian(self, angles, *, angle_unit="rad"):
        """Compute the derivative of the probe's position by each joint angle.

        Parameters
        ----------
        angles : array-like of shape (n_samples, n_joints)
            Joint angles.
        angle_unit : {"rad", "deg"}, default="rad"
            Unit of `angles`; the derivative is per rad in either case.

        Returns
        -------
        ndarray of shape (n_samples, 3, n_joints)
            ``d probe / d angle`` in mm/rad: for each joint the cross product of its axis with the
            vector from the axis to the probe.
        """
        angles = self._check_angles(angles, angle_unit)
        result = np.empty((len(angles), 3, self.n_joints))
        # The axis of joint i is the z axis of frame i - 1 (standard) or i (modified).
        first = 0 if self.convention == "standard" else 1
        for rows in _chunks(len(angles)):
            columns = _frame_columns(self, _theta(self, angles[rows]))
            probe = columns[-1, 3] + np.tensordot(self.probe, columns[-1, :3], axes=1)
            for i, sign in enumerate(self.joint_signs):
                frame = columns[i + first]
                result[rows, :, i] = sign * _cross(frame[2], probe - frame[3]).T
        return result

    def _check_angles(self, angles, angle_unit):
        if not (isinstance(angle_unit, str) and angle_unit in ("rad", "deg")):
            raise ValueError(f"angle_unit must be 'rad' or 'deg', got {angle_unit!r}.")
        angles = _floats("angles", angles)
        if angles.ndim != 2 or angles.shape[1] != self.n_joints:
            raise ValueError(
                f"angles must have shape (n_samples, {self.n_joints}) for an arm of "
                f"{self.n_joints} joints, got {angles.shape}."
            )
        if not len(angles):
            return angles
        # max and min carry NaN along: one pass each, and no mask of the size of the data.
        largest = np.maximum(angles.max(axis=0), -angles.min(axis=0))
        if not np.all(np.isfinite(largest)):
            bad = np.argwhere(~np.isfinite(angles))
            row, column = bad[0]
            raise ValueError(
                f"angles hold {len(bad)} NaN or infinite values; the first is "
                f"{angles[row, column]} in row {row}, joint {column + 1}."
            )
        if angle_unit == "deg":
            angles = np.deg2rad(angles)
        elif largest.max() > _WARN_RAD:
            warnings.warn(
                f"angles reach {largest.max():g} rad (joint {largest.argmax() + 1}), more than "
                'two turns: if they are degrees, convert them or pass angle_unit="deg".',
                UserWarning,
                stacklevel=3,
            )
        return angles


def _rebuild(params):
    return Arm(**params)


# -- checks -----------------------------------------------------------------------------------


def _show(value, limit=60):
    text = repr(value)
    return text if len(text) <= limit else text[:limit] + "..."


def _floats(name, value):
    try:
        array = np.asarray(value)
        # Strings and booleans convert, but nobody means them; complex numbers lose a part.
        if array.dtype.kind in "iuf":
            return array.astype(np.float64, copy=False)
        if array.dtype.kind == "O" and not any(
            x is None or isinstance(x, str | bool) for x in array.flat
        ):
            return array.astype(np.float64)
    except (TypeError, ValueError):
        pass
    raise ValueError(f"{name} must hold numbers, got {_show(value)}.")


def _numbers(name, value, size, unit, bound, broadcast=False):
    """One finite float64 per joint, read-only."""
    array = _floats(name, value)
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
            f"{bound:g} {unit}".rstrip()
            + f"{hint}."
        )
    array = array + 0.0  # a copy of our own, in which -0.0 is 0.0: they are the same arm
    array.flags.writeable = False
    return array


def _pair(name, value, low, high):
    try:
        pair = tuple(value)
        whole = all(not isinstance(v, bool | str) and int(v) == v for v in pair)
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole or len(pair) != 2 or not all(low <= v <= high for v in pair) or len({*pair}) < 2:
        raise ValueError(
            f"{name} must be two different whole numbers from {low} to {high}, got {_show(value)}."
        )
    return tuple(int(v) for v in pair)


# -- kinematics on arrays: each quantity is one contiguous row over the samples of a chunk --------


def _chunks(n_samples):
    return (slice(i, i + _CHUNK_ROWS) for i in range(0, n_samples, _CHUNK_ROWS))


def _theta(arm, angles):
    """Angles (n_samples, n_joints) -> theta of the DH table (n_joints, n_samples)."""
    return np.ascontiguousarray(angles.T) * arm.joint_signs[:, None] + arm.theta_offset[:, None]


def _probe_points(arm, theta):
    """Probe points (3, n_samples): the probe's vector carried from the last frame to the base.

    A vector through 2 plane rotations a joint costs about a third of the products of 3x4 matrices.
    """
    cos, sin = np.cos(theta), np.sin(theta)
    cos_alpha, sin_alpha = np.cos(arm.alpha), np.sin(arm.alpha)
    x, y, z = arm.probe
    for i in reversed(range(arm.n_joints)):
        if arm.convention == "standard":
            y, z = cos_alpha[i] * y - sin_alpha[i] * z, sin_alpha[i] * y + cos_alpha[i] * z
            x, z = x + arm.a[i], z + arm.d[i]
            x, y = cos[i] * x - sin[i] * y, sin[i] * x + cos[i] * y
        else:
            x, y = cos[i] * x - sin[i] * y, sin[i] * x + cos[i] * y
            x, z = x + arm.a[i], z + arm.d[i]
            y, z = cos_alpha[i] * y - sin_alpha[i] * z, sin_alpha[i] * y + cos_alpha[i] * z
    return np.stack(np.broadcast_arrays(x, y, z))


def _frame_columns(arm, theta):
    """Frames as (n_joints + 1, 4, 3, n_samples): the columns x, y, z, origin of each frame."""
    cos, sin = np.cos(theta), np.sin(theta)
    cos_alpha, sin_alpha = np.cos(arm.alpha), np.sin(arm.alpha)
    out = np.zeros((arm.n_joints + 1, 4, 3, theta.shape[1]))
    for axis in range(3):
        out[0, axis, axis] = 1.0
    for i in range(arm.n_joints):
        x, y, z, origin = out[i]
        if arm.convention == "standard":
            x, y = cos[i] * x + sin[i] * y, cos[i] * y - sin[i] * x
            origin = origin + arm.d[i] * z + arm.a[i] * x
            y, z = cos_alpha[i] * y + sin_alpha[i] * z, cos_alpha[i] * z - sin_alpha[i] * y
        else:
            y, z = cos_alpha[i] * y + sin_alpha[i] * z, cos_alpha[i] * z - sin_alpha[i] * y
            origin = origin + arm.a[i] * x + arm.d[i] * z
            x, y = cos[i] * x + sin[i] * y, cos[i] * y - sin[i] * x
        out[i + 1] = x, y, z, origin
    return out


def _cross(u, v):
    """Cross product of (3, n_samples) arrays; np.cross costs several times as much."""
    return np.stack(
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    )


# -- built-in arms, mm and deg ------------------------------------------------------------------

_BUILT_IN = {
    "aacmm6": {
        "a": [-0.0226, 62.1163, -0.0061, 62.1025, 0.0049, 0.0],
        "alpha": [-89.9683, -90.0312, 90.0071, -90.0338, 90.0373, -90.0],
        "d": [376.5, -0.0525, 750.7422, 0.0597, 500.5566, 15.0695],
        "theta_offset": [0.0, 0.0040, 0.0466, -0.0374, 0.0127, -0.0060],
        "probe": (0.0, 0.0, 97.8110),
    },
    "panda": {
        "a": [0.0, 0.0, 0.0, 82.5, -82.5, 0.0, 88.0],
        "alpha": [0.0, -90.0, 90.0, 90.0, -90.0, 90.0, 90.0],
        "d": [333.0, 0.0, 316.0, 0.0, 384.0, 0.0, 0.0],
        "probe": (0.0, 0.0, 107.0),
        "convention": "modified",
    },
    "ur10": {
        "a": [0.0, -612.0, -572.3, 0.0, 0.0, 0.0],
        "alpha": [90.0, 0.0, 0.0, 90.0, -90.0, 0.0],
        "d": [127.3, 0.0, 0.0, 163.941, 115.7, 92.2],
        "pose_joints": (4, 3),
        "pose_frames": (1, 3),
    },
}
