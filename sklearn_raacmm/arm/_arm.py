"""The arm as a value: its Denavit-Hartenberg table, its probe, and its forward kinematics."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, fields
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm._built_in import BUILT_IN, TWISTS
from sklearn_raacmm.arm._checks import (
    MAX_LENGTH_MM,
    MIN_LENGTH_MM,
    check_angles,
    floats,
    is_name,
    limits_of,
    names_of,
    numbers,
    pair_of,
)
from sklearn_raacmm.arm._files import JsonMixin
from sklearn_raacmm.arm._kinematics import (
    CHUNK_ROWS,
    cross,
    dh_theta,
    frame_columns,
    points_of,
    probe_of,
)
from sklearn_raacmm.arm._urdf import UrdfMixin
from sklearn_raacmm.utils import chunks, html_table


@dataclass(frozen=True, eq=False, repr=False)
class Arm(JsonMixin, UrdfMixin):
    """An articulated arm: Denavit-Hartenberg table, probe, and the joints that make its pose.

    An immutable value, equal and hashable by content. Lengths are in mm, angles in rad.

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
        Direction in which each encoder counts: -1 where it counts against the table's angle.
    pose_joints : tuple of two int, default=(3, 4)
        Numbers, from 1, of the joints that make the pose: swivel and elbow.
    pose_frames : tuple of two int, default=(2, 5)
        Numbers of the frames, from 0 (the base) to `n_joints`, whose origins are the shoulder and
        the wrist.
    name : str, default=""
        Name of the arm, shown where the arm is printed.
    names : sequence of str, default=()
        Names of the joints, as in the robot's own description.
    limits : array-like of shape (n_joints, 2), default=None
        Lower and upper limit of each joint angle in rad; infinite where a joint has none.

    Attributes
    ----------
    n_joints : int
        Number of joints.

    Notes
    -----
    ``forward`` is equation (1) of Gao et al. (2020), doi 10.1177/1729881420925638, with a free
    probe vector instead of ``(0, 0, l)``; the equation itself is a reconstruction.

    Examples
    --------
    >>> from sklearn_raacmm import Arm
    >>> arm = Arm.from_degrees(
    ...     a=[0, 62, 0, 62, 0, 0], alpha=[-90, -90, 90, -90, 90, -90],
    ...     d=[376.5, 0, 750, 0, 500, 15], probe=(0, 0, 100), name="nominal")
    >>> arm
    <Arm 'nominal': 6 joints, standard DH, probe (0, 0, 100) mm>
    >>> arm.forward([[0, 90, 0, 90, 0, 0]], angle_unit="deg").round(6)
    array([[-812. ,   15. ,  914.5]])
    """

    a: np.ndarray
    alpha: np.ndarray
    d: np.ndarray
    theta_offset: Any = 0.0
    _: KW_ONLY
    probe: Any = (0.0, 0.0, 0.0)
    convention: str = "standard"
    joint_signs: Any = 1
    pose_joints: tuple[Any, ...] = (3, 4)
    pose_frames: tuple[Any, ...] = (2, 5)
    name: str = ""
    names: tuple[Any, ...] = ()
    limits: np.ndarray | None = None

    if TYPE_CHECKING:  # what may be given; the fields say what it has become

        def __init__(
            self,
            a: ArrayLike,
            alpha: ArrayLike,
            d: ArrayLike,
            theta_offset: ArrayLike = 0.0,
            *,
            probe: ArrayLike = (0.0, 0.0, 0.0),
            convention: str = "standard",
            joint_signs: ArrayLike = 1,
            pose_joints: Sequence[int] = (3, 4),
            pose_frames: Sequence[int] = (2, 5),
            name: str = "",
            names: Sequence[str] = (),
            limits: ArrayLike | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        a = numbers("a", self.a, None, "mm", MAX_LENGTH_MM)
        n = a.size
        checked = {
            "a": a,
            "alpha": numbers("alpha", self.alpha, n, "rad", 2 * np.pi),
            "d": numbers("d", self.d, n, "mm", MAX_LENGTH_MM),
            "theta_offset": numbers("theta_offset", self.theta_offset, n, "rad", 2 * np.pi, True),
            "probe": numbers("probe", self.probe, 3, "mm", MAX_LENGTH_MM),
            "joint_signs": numbers("joint_signs", self.joint_signs, n, "", 1, True),
            "pose_joints": pair_of("pose_joints", self.pose_joints, 1, n),
            "pose_frames": pair_of("pose_frames", self.pose_frames, 0, n),
            "names": names_of(self.names, n),
            "limits": limits_of(self.limits, n),
        }
        if np.any(np.abs(checked["joint_signs"]) != 1):
            raise ValueError(f"joint_signs must be -1 or 1 each, got {self.joint_signs!r:.60}.")
        if not (isinstance(self.convention, str) and self.convention in ("standard", "modified")):
            raise ValueError(
                f"convention must be 'standard' or 'modified', got {self.convention!r:.60}."
            )
        if not is_name(self.name):
            raise ValueError(f"name must be a string of whole characters, got {self.name!r:.60}.")
        if not any(np.any(np.abs(checked[field]) > MIN_LENGTH_MM) for field in ("a", "d", "probe")):
            raise ValueError(
                f"a, d and probe hold no length above {MIN_LENGTH_MM:g} mm: an arm without any "
                "length does not move its probe."
            )
        for field, value in checked.items():
            object.__setattr__(self, field, value)

    # -- a value: equality, copies, representation ------------------------------------------

    def _key(self):
        values = self.__getstate__().values()
        return tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in values)

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, Arm) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: Any) -> Self:
        return self

    def __reduce__(self) -> Any:
        # Through the constructor: arrays restored by pickle would be writable.
        return _rebuild, (self.__getstate__(),)

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __setstate__(self, state: Any) -> None:
        # The same for formats that restore an object by its state, as skops does.
        type(self).__init__(self, **state)

    def __repr__(self) -> str:
        name = f" {self.name!r}" if self.name else ""
        probe = ", ".join(f"{value:g}" for value in self.probe)
        return f"<Arm{name}: {self.n_joints} joints, {self.convention} DH, probe ({probe}) mm>"

    def __str__(self) -> str:
        header = "joint  sign      a/mm   alpha/deg      d/mm  offset/deg"
        widths = (5, 6, 10, 12, 10, 12)
        rows = (
            "".join(f"{cell:>{width}}" for cell, width in zip(row, widths, strict=True))
            for row in self._cells()
        )
        return "\n".join([repr(self), header, *rows])

    def _cells(self):
        """Number, sign, a, alpha, d and theta offset of each joint as text; mm and degrees."""
        columns = (self.a, np.rad2deg(self.alpha), self.d, np.rad2deg(self.theta_offset))
        for i, values in enumerate(zip(*columns, strict=True)):
            sign = f"{self.joint_signs[i]:+.0f}"
            yield str(i + 1), sign, *(f"{value:.4f}" for value in values)

    def _repr_html_(self):
        header = ["joint", "sign", "a / mm", "alpha / deg", "d / mm", "theta offset / deg"]
        return html_table(repr(self), header, self._cells())

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return self.a.size

    def replace(self, **changes: Any) -> "Arm":
        """Return a new arm with some fields changed.

        Parameters
        ----------
        **changes : dict
            Parameters of `Arm` and their new values.

        Returns
        -------
        Arm

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> Arm.from_name("panda").replace(probe=(0, 0, 138), name="with a ball")
        <Arm 'with a ball': 7 joints, modified DH, probe (0, 0, 138) mm>
        """
        known = self.__getstate__()
        unknown = sorted(set(changes) - set(known))
        if unknown:
            raise TypeError(f"Arm has no parameter {', '.join(unknown)}; it has {list(known)}.")
        return Arm(**{**known, **changes})

    # -- constructors -----------------------------------------------------------------------

    @classmethod
    def from_degrees(
        cls,
        a: ArrayLike,
        alpha: ArrayLike,
        d: ArrayLike,
        theta_offset: ArrayLike = 0.0,
        **params: Any,
    ) -> "Arm":
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
        """
        alpha = np.deg2rad(floats("alpha", alpha))
        return cls(a, alpha, d, np.deg2rad(floats("theta_offset", theta_offset)), **params)

    @classmethod
    def from_name(cls, name: str, /, **changes: Any) -> "Arm":
        """Return one of the built-in arms.

        Parameters
        ----------
        name : str
            - "aacmm6": a six-joint arm CMM of about 1.35 m reach with its identified parameters,
              Table 2 of article 1760190, Mathematical Problems in Engineering 2018;
            - "panda", "iiwa7", "iiwa14": the Franka Panda and the KUKA LBR iiwa, nominal;
            - "ur3", "ur5", "ur10", "ur3e", "ur5e", "ur10e", "ur16e": Universal Robots, nominal.
              Three axes are parallel, so that the pose is joint 4 and joint 3;
            - "irb120": the ABB IRB 120, nominal.

            The probe of the robots is the centre of their flange.
        **changes : dict
            Parameters of `Arm` to change, such as ``probe`` or ``name``.

        Returns
        -------
        Arm

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> Arm.from_name("aacmm6")
        <Arm 'aacmm6': 6 joints, standard DH, probe (0, 0, 97.811) mm>
        """
        if not (isinstance(name, str) and name in BUILT_IN):
            raise ValueError(f"name must be one of {sorted(BUILT_IN)}, got {name!r}.")
        return cls.from_degrees(name=name, **BUILT_IN[name]).replace(**changes)

    @classmethod
    def from_lengths(
        cls,
        layout: str,
        shoulder: float,
        upper: float,
        fore: float,
        probe: float,
        *,
        elbow_offset: float = 0.0,
        wrist_offset: float = 0.0,
        **params: Any,
    ) -> "Arm":
        """Build an arm of a usual layout from the lengths of a maker's drawing.

        Neighbouring axes cross at right angles, or pass each other at the offsets. With all angles
        at zero upper arm, forearm and probe lie along one line, as a picture on the page "Arms" of
        the documentation shows. For encoders with another zero give ``theta_offset``.

        Parameters
        ----------
        layout : {"2-2-2", "2-2-3"}
            Joints at shoulder, elbow and wrist; the seventh turns the probe about its own axis.
        shoulder, upper, fore, probe : float
            Lengths in mm: of the shoulder above the base, from there to the elbow, on to the wrist,
            and from its last axis across to the centre of the probe.
        elbow_offset, wrist_offset : float, default=0
            Distances between the two axes at the shoulder and the upper arm, and between those at
            the elbow and the forearm, mm.
        **params : dict
            Other parameters of `Arm`, such as ``theta_offset`` in degrees.

        Returns
        -------
        Arm

        Raises
        ------
        ValueError
            If the layout is unknown, or a length is not a number.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> Arm.from_lengths("2-2-2", 375, 750, 500, 100)
        <Arm '2-2-2 arm': 6 joints, standard DH, probe (0, 0, 100) mm>
        """
        if not (isinstance(layout, str) and layout in TWISTS):
            raise ValueError(f"layout must be one of {sorted(TWISTS)}, got {layout!r}.")
        twists = TWISTS[layout]
        rest = [0.0] * (len(twists) - 6)
        return cls.from_degrees(
            a=[0.0, elbow_offset, 0.0, wrist_offset, 0.0, 0.0, *rest],
            alpha=twists,
            d=[shoulder, 0.0, upper, 0.0, fore, 0.0, *rest],
            **{"probe": (0.0, 0.0, probe), "name": f"{layout} arm", **params},
        )

    # -- kinematics -------------------------------------------------------------------------

    def forward(self, angles: ArrayLike, *, angle_unit: str = "rad") -> np.ndarray:
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
            If an angle is more than two turns, or if all degrees are below 2 pi: most likely
            another unit.
        """
        return points_of(self, check_angles(angles, self.n_joints, angle_unit))

    def azimuth(self, angles: ArrayLike, *, angle_unit: str = "rad") -> np.ndarray:
        """Azimuth of the probe about the base's z axis.

        Parameters
        ----------
        angles, angle_unit
            As in :meth:`forward`.

        Returns
        -------
        ndarray of shape (n_samples,)
            ``atan2(y, x)`` of the probe in rad, from -pi to pi.
        """
        points = self.forward(angles, angle_unit=angle_unit)
        return np.arctan2(points[:, 1], points[:, 0])

    def frames(self, angles: ArrayLike, *, angle_unit: str = "rad") -> np.ndarray:
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
        angles = check_angles(angles, self.n_joints, angle_unit)
        frames = np.empty((len(angles), self.n_joints + 1, 3, 4))
        for rows in chunks(len(angles), CHUNK_ROWS):
            frames[rows] = frame_columns(self, dh_theta(self, angles[rows])).transpose(3, 0, 2, 1)
        return frames

    def jacobian(self, angles: ArrayLike, *, angle_unit: str = "rad") -> np.ndarray:
        """Compute the derivative of the probe's position by each joint angle.

        Parameters
        ----------
        angles, angle_unit
            As in :meth:`forward`; the derivative is per rad in either case.

        Returns
        -------
        ndarray of shape (n_samples, 3, n_joints)
            ``d probe / d angle`` in mm/rad: for each joint the cross product of its axis with the
            vector from the axis to the probe.
        """
        angles = check_angles(angles, self.n_joints, angle_unit)
        result = np.empty((len(angles), 3, self.n_joints))
        # The axis of joint i is the z axis of frame i - 1 (standard) or i (modified).
        first = 0 if self.convention == "standard" else 1
        for rows in chunks(len(angles), CHUNK_ROWS):
            columns = frame_columns(self, dh_theta(self, angles[rows]))
            probe = probe_of(self, columns)
            for i, sign in enumerate(self.joint_signs):
                frame = columns[i + first]
                result[rows, :, i] = sign * cross(frame[2], probe - frame[3]).T
        return result


def _rebuild(params):
    return Arm(**params)
