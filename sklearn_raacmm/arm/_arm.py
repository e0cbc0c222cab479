"""The arm as a value: its Denavit-Hartenberg table, its probe, and its forward kinematics."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Sequence
from functools import cached_property
from html import escape
from numbers import Integral
from os import PathLike
from typing import Any, NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_scalar

from sklearn_raacmm.arm._built_in import BUILT_IN, TWISTS, usual_pose
from sklearn_raacmm.arm._chain import urdf_text
from sklearn_raacmm.arm._checks import (
    MAX_LENGTH_MM,
    MIN_LENGTH_MM,
    check_couplings,
    check_direction,
    check_limits,
    check_names,
    check_numbers,
    check_pair,
    check_types,
    floats,
    is_name,
)
from sklearn_raacmm.arm._files import json_text, read_fields
from sklearn_raacmm.arm._solve import ReachingChain
from sklearn_raacmm.arm._urdf import fields_of_far_axes, read_urdf, seen_from, write_into_urdf
from sklearn_raacmm.utils import Finding, Floats, check_option, check_places, write_whole

_DEFAULT = "aacmm6"
# Cosines smaller than this are rounding.
_ROUNDING = 1e-12
# No scale of a rail is off by as much: it would be in another unit.
_MOST_SCALE = 0.1
# Arms of fewer joints have no wrist where the default poses suppose it.
_FEW_JOINTS = 5


class Arm(ReachingChain):
    """An articulated arm: Denavit-Hartenberg table, probe, and the joints that make its pose.

    An immutable value, equal and hashable by content. Lengths are in mm, angles in rad. Of joints
    that slide, such as rails and columns, what the encoders give are mm: see `joint_types`.

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
        Vector from the origin of the last frame to the centre of the probe, in that frame, mm. A
        last row of a maker's table that no joint moves, that of a flange with `d` alone, is
        ``(0, 0, d)``.
    convention : {"standard", "modified"}, default="standard"
        How row ``i`` of the table takes frame ``i - 1`` to frame ``i``:

        - "standard": ``Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)``;
        - "modified" (Craig): ``Rx(alpha_i) Tx(a_i) Rz(theta_i) Tz(d_i)``, where `a` and `alpha`
          of row ``i`` are the lengths and twists usually written with the index ``i - 1``;

        with ``theta_i = joint_signs_i * angle_i + theta_offset_i``, see also `couplings`.
    joint_signs : {-1, 1} or array-like of shape (n_joints,), default=1
        Direction in which each encoder counts: -1 where it counts against the table's angle. Of a
        joint that slides with its scale, as a calibration finds it, such as 1.00003.
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
        Lower and upper limit of each joint angle in rad, or of its travel in mm; infinite where a
        joint has none. What slides without limits is taken to go 2 m to either side.
    up : array-like of shape (3,), default=(0, 0, 1)
        Direction against gravity in the base frame, of any length: kept as a unit vector. The
        default is an arm that stands upright; an arm whose base's x axis points to the ceiling,
        as on a wall, has (1, 0, 0), and one that hangs from the ceiling (0, 0, -1). The columns of
        gravity in `ArmResidualRegressor`, payloads, and the probe's lean in `plan_poses` follow it.
        The axis of azimuths and of the cylindrical frame remains the base's z axis.
    couplings : sequence of (joint, other, 1 or -1), default=()
        Joints whose own angle is a sum: ``(3, 2, 1)`` says that joint 3 stands at ``angle_3 +
        angle_2`` of what the controller gives, as on arms whose third angle counts from the
        horizontal; -1 takes the other angle off. The error of a joint's encoder is one of its own
        angle.
    joint_types : str or sequence of str, default=None
        A letter for each joint, such as "PRRRRRR" for a robot on a rail: "R" turns about the z axis
        of its row, "P" slides along it. Of a joint that slides `d` is where it stands at 0,
        ``joint_signs_i * mm_i`` is added to it, and ``theta_offset`` is a fixed angle. What the
        arm's model learns of it are the six errors of a linear axis (ISO 230-1). None: all turn.
    up_frame : int, default=0
        Number of the frame, from 0 (the base), that stands still in the world, and in which `up` is
        stated. Other than 0 only where joints before it carry the part: see :meth:`seen_from`.

    Attributes
    ----------
    n_joints : int
        Number of joints.
    reach_mm : float
        Length of the stretched arm with its slides run out, an upper bound of its reach.
    slides : list of int
        Numbers, from 0, of the joints that slide.
    bounds, spans : ndarray of shape (2, n_joints)
        Least and largest angle of each joint, rad, or mm of what slides: the `limits`, infinite
        where there is none; and where joints are taken to go, a turn or the travel of a slide.

    Notes
    -----
    An arm is made of a table by :meth:`from_degrees`, of a drawing's lengths by
    :meth:`from_lengths`, of a robot's own file by :meth:`from_urdf`, or by :meth:`from_name` and
    :meth:`from_json`. It is asked by :meth:`forward`, :meth:`frames`, :meth:`jacobian` and
    :meth:`angles_for`, changed by :meth:`replace` and :meth:`seen_from`, and kept by
    :meth:`to_json`, :meth:`to_urdf` and :meth:`update_urdf`. What else it has serves the models:
    those methods take angles in rad, and mm of what slides, as :meth:`check_angles` returns them.

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

    MAX_LENGTH_MM, MIN_LENGTH_MM = MAX_LENGTH_MM, MIN_LENGTH_MM

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
        up: ArrayLike = (0.0, 0.0, 1.0),
        couplings: Sequence[Sequence[int]] = (),
        joint_types: str | Sequence[str] | None = None,
        up_frame: int = 0,
    ) -> None:
        lengths = check_numbers("a", a, None, "mm", MAX_LENGTH_MM)
        n = lengths.size
        twists = check_numbers("alpha", alpha, n, "rad", 2 * np.pi)
        types = check_types(joint_types, n)
        vars(self).update(
            a=lengths,
            alpha=twists,
            d=check_numbers("d", d, n, "mm", MAX_LENGTH_MM),
            theta_offset=check_numbers("theta_offset", theta_offset, n, "rad", 2 * np.pi, True),
            probe=check_numbers("probe", probe, 3, "mm", MAX_LENGTH_MM),
            convention=convention,
            joint_signs=check_numbers("joint_signs", joint_signs, n, "", 2, True),
            # A table that turns in one joint has no two.
            pose_joints=(1, 1) if n == 1 else check_pair("pose_joints", pose_joints, 1, n),
            pose_frames=check_pair("pose_frames", pose_frames, 0, n),
            name=name,
            names=check_names(names, n),
            limits=check_limits(limits, n),
            up=check_direction("up", up),
            couplings=check_couplings(couplings, n, types),
            joint_types=types,
            up_frame=int(check_scalar(up_frame, "up_frame", Integral, min_val=0, max_val=n)),
        )
        if np.any(np.abs(np.abs(self.joint_signs) - 1) > self.by_type(0.0, _MOST_SCALE)):
            raise ValueError(
                "joint_signs must be -1 or 1 each, or of a joint that slides within "
                f"{_MOST_SCALE:.0%} of it, got {joint_signs!r:.60}."
            )
        check_option("convention", convention, ("standard", "modified"))
        if not is_name(name):
            raise ValueError(f"name must be a string of whole characters, got {name!r:.60}.")
        longest = max(np.abs(one).max() for one in (self.a, self.d, self.probe))
        if "P" not in types and not longest > MIN_LENGTH_MM:
            raise ValueError(
                f"a, d and probe hold no length above {MIN_LENGTH_MM:g} mm: an arm without any "
                "length does not move its probe."
            )

    # -- a value: equality, copies, representation ------------------------------------------

    @cached_property
    def _key(self):
        values = self.__getstate__().values()
        return tuple(v.tobytes() if isinstance(v, np.ndarray) else v for v in values)

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Arm) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    def __deepcopy__(self, memo: object) -> Self:
        return self

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"an arm is a value: arm.replace({name}=...) makes another one.")

    def __delattr__(self, name: str) -> NoReturn:
        self.__setattr__(name, None)

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Through the constructor: arrays restored by pickle would be writable.
        type(self).__init__(self, **state)

    def __repr__(self) -> str:
        name = f" {self.name!r}" if self.name else ""
        probe = ", ".join(f"{value:g}" for value in self.probe)
        up = ", ".join(f"{value:g}" for value in self.up)
        up = "" if up == "0, 0, 1" and not self.up_frame else f", up ({up})"
        up += f" in frame {self.up_frame}" if self.up_frame else ""
        sums = "".join(
            f", joint {i} at J{i} {'+' if factor > 0 else '-'} J{j}"
            for i, j, factor in self.couplings
        )
        types = f" ({self.joint_types})" if "P" in self.joint_types else ""
        kind = f"{self.n_joints} joints{types}, {self.convention} DH"
        return f"<Arm{name}: {kind}, probe ({probe}) mm{up}{sums}>"

    def __str__(self) -> str:
        header = "joint  sign      a/mm   alpha/deg      d/mm  offset/deg"
        widths = (5, 6, 10, 12, 10, 12)
        rows = (map(str.rjust, row, widths) for row in self._cells())
        return "\n".join([repr(self), header, *map("".join, rows)])

    def _cells(self):
        """Number, sign, a, alpha, d and theta offset of each joint as text; mm and degrees."""
        columns = (self.a, np.rad2deg(self.alpha), self.d, np.rad2deg(self.theta_offset))
        for i, values in enumerate(zip(*columns, strict=True)):
            number = f"{i + 1}{' P' * (self.joint_types[i] == 'P')}"
            sign = f" {self.joint_signs[i]:+.7g}"  # of a slide its scale
            yield number, sign, *(f"{value:.4f}" for value in values)

    def _repr_html_(self):
        header = ["joint", "sign", "a / mm", "alpha / deg", "d / mm", "theta offset / deg"]
        rows = [("th", header), *(("td", row) for row in self._cells())]
        lines = ("".join(f"<{tag}>{cell}</{tag}>" for cell in row) for tag, row in rows)
        table = "".join(f"<tr>{line}</tr>" for line in lines)
        return f"<div><p>{escape(repr(self))}</p><table>{table}</table></div>"

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
        return Arm(**{**self.__getstate__(), **changes})

    __replace__ = replace  # what `copy.replace` of Python 3.13 calls

    @staticmethod
    def check(arm: object) -> None:
        """Refuse what is no arm.

        Parameters
        ----------
        arm : object
            What was given for one.

        Raises
        ------
        TypeError
            If it is none.
        """
        if not isinstance(arm, Arm):
            raise TypeError(f"arm must be an Arm, got {type(arm).__name__}.")

    @classmethod
    def or_default(
        cls, arm: "Arm | None", owner: str, n_columns: int, extra: Sequence[str] = ()
    ) -> "Arm":
        """Return the arm itself; or, with a warning, the built-in arm CMM.

        Parameters
        ----------
        arm : Arm or None
            What an estimator was given.
        owner : str
            Name of the estimator, for the warning.
        n_columns : int
            Number of columns of X, which is to be that of the joints and of `extra`.
        extra : sequence of str, default=()
            Names of further columns.

        Returns
        -------
        Arm

        Raises
        ------
        TypeError
            If `arm` is something else.
        ValueError
            If there are more columns, or fewer.

        Warns
        -----
        FindingWarning
            If it is None.
        """
        if arm is None:
            text = f"{owner} was given no arm and takes the built-in arm {_DEFAULT!r}, whose "
            text += "lengths are not those of your arm."
            advice = f'Pass arm=, or arm=Arm.from_name("{_DEFAULT}") if you mean that one.'
            Finding("built-in-arm", text, advice).report()
            arm = cls.from_name(_DEFAULT)
        cls.check(arm)
        needed = f"the arm {arm!r} has {arm.n_joints} joints: one column of joint angles each is "
        needed += "needed"
        if extra:
            needed = f"{arm.n_joints + len(extra)} are needed: the angles of {arm.n_joints} "
            needed += f"joints, then {', '.join(map(repr, extra))}"
        if n_columns != arm.n_joints + len(extra):
            raise ValueError(f"X has {n_columns} columns, but {needed}.")
        return arm

    @staticmethod
    def usual_pose(n_joints: int, parallel: bool, convention: str) -> dict[str, Any]:
        """Joints and frames that usually make the pose of an arm of so many joints.

        Parameters
        ----------
        n_joints : int
            Number of joints.
        parallel : bool
            Whether the axes of joints 2 and 3 are parallel, as on a UR10.
        convention : {"standard", "modified"}
            Of the table.

        Returns
        -------
        dict
            `pose_joints` and `pose_frames`, as the constructor takes them.
        """
        return usual_pose(n_joints, parallel, convention)

    # In this module, as its class: skops knows a method that a model holds by both.
    def azimuth(self, angles: ArrayLike, *, angle_unit: str = "rad") -> Floats:
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
            The other parameters of `Arm`. Arms of fewer than five joints have the pose of their
            first two, and of the whole arm, unless it is given.

        Returns
        -------
        Arm
        """
        twists = np.deg2rad(floats("alpha", alpha))
        if 0 < (n := np.size(twists)) < _FEW_JOINTS:  # no elbow and wrist as the default names them
            params = usual_pose(n, False, params.get("convention", "standard")) | params
        return cls(a, twists, d, np.deg2rad(floats("theta_offset", theta_offset)), **params)

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
            - "irb120": the ABB IRB 120, nominal;
            - "ur10_rail": a UR10 on a rail of 4 m, an example of a joint that slides.

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
        check_option("layout", layout, TWISTS)
        twists = TWISTS[layout]
        rest = [0.0] * (len(twists) - 6)
        return cls.from_degrees(
            a=[0.0, elbow_offset, 0.0, wrist_offset, 0.0, 0.0, *rest],
            alpha=twists,
            d=[shoulder, 0.0, upper, 0.0, fore, 0.0, *rest],
            **{"probe": (0.0, 0.0, probe), "name": f"{layout} arm", **params},
        )

    @classmethod
    def from_far_axes(cls, table: Floats, probe: ArrayLike, **fields: Any) -> "Arm":
        """Build an arm of a standard table whose `d` may be longer than any arm.

        The common normal of two axes that are all but parallel may be a hundred metres away, as in
        a UR's own calibration.

        Parameters
        ----------
        table : ndarray of shape (n_joints, 4)
            Rows `a`, `alpha`, `d` and `theta_offset`, mm and rad.
        probe : array-like of shape (3,)
            As in `Arm`, mm.
        **fields : dict
            The other parameters of `Arm`.

        Returns
        -------
        Arm
            In the modified convention, with the same axes, but those that are taken as parallel.

        Raises
        ------
        ValueError
            If `table` or `probe` has another shape, or something is not a finite number.
        """
        table = floats("table", table, 4)
        probe = check_numbers("probe", probe, 3, "mm", MAX_LENGTH_MM)
        return cls(**fields_of_far_axes(table, probe), **fields)

    def seen_from(self, positioner: "Arm", base: ArrayLike) -> "Arm":
        """Put a positioner before the base: the arm as seen from the table that carries the part.

        A chain of joints read backwards is a chain of joints. So a table that turns the part in one
        or two joints and the arm that works on it are one arm, which `calibrate`,
        `learn_correction` and all else take as any other. Its points are in the frame of the table:
        the axes of the positioner's last frame, with the origin in its `probe`.

        Parameters
        ----------
        positioner : Arm
            The table's joints from its foot on, and in `probe` the origin of the table, mm.
        base : array-like of shape (4, 4)
            Pose of the arm's base in that of the positioner, mm. A calibration corrects it.

        Returns
        -------
        Arm
            In the modified convention. Its joints are those of the positioner from the table down
            to its foot, named "E2" and "E1" where they have no names, then those of the arm, "J1"
            and so on: of angles as controllers write them the columns of the positioner come first,
            ``angles[:, [7, 6, 0, 1, 2, 3, 4, 5]]``. Gravity keeps the arm's own `up`, which turns
            as seen from the table; what it does to the positioner has no columns.

        Raises
        ------
        ValueError
            If `base` is no pose, or one of the two has a positioner already.

        Warns
        -----
        UserWarning
            As :meth:`from_urdf`, if the first axis is not one on which a table of lengths and
            twists can begin, such as the z axis of the positioner's last frame.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> table = Arm.from_degrees([0, 0], [0, 90], [700, 0], probe=(0, 0, 300),
        ...                          convention="modified")
        >>> base = [[1, 0, 0, -1500], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        >>> arm = Arm.from_name("ur10").seen_from(table, base)
        >>> arm.n_joints, arm.names[:3]
        (8, ('E2', 'E1', 'shoulder_pan_joint'))
        """
        self.check(positioner)
        return seen_from(self, positioner, base)

    def without_first(self) -> "Arm":
        """Return the arm behind its first joint, in the base that this joint carries.

        Returns
        -------
        Arm

        Raises
        ------
        ValueError
            If there is one joint only, or a coupling with the first.
        """
        up = self.frames(np.zeros((1, self.n_joints)))[0, 1, :, :3].T @ self.up
        changes: dict[str, Any] = {"up": np.where(np.abs(up) > _ROUNDING, up, 0.0)}
        if self.up_frame:
            changes = {"up_frame": self.up_frame - 1}
        for name in ("a", "alpha", "d", "theta_offset", "joint_signs", "names", "joint_types"):
            changes[name] = getattr(self, name)[1:]
        changes["limits"] = None if self.limits is None else self.limits[1:]
        changes["couplings"] = [(i - 1, j - 1, factor) for i, j, factor in self.couplings]
        changes["pose_joints"] = tuple(np.subtract(self.pose_joints, 1))
        changes["pose_frames"] = tuple(np.subtract(self.pose_frames, 1))
        if min(changes["pose_joints"]) < 1 or min(changes["pose_frames"]) < 0:
            changes |= usual_pose(self.n_joints - 1, False, self.convention)
        return self.replace(**changes)

    # -- files ------------------------------------------------------------------------------

    @classmethod
    def from_json(cls, source: str | PathLike[str] | bytes | dict[str, object]) -> "Arm":
        """Read an arm from a JSON file.

        Parameters
        ----------
        source : str, path-like, bytes or dict
            Path of the file; or the text itself, which starts with a brace, as str or as bytes in
            UTF-8; or the dict that the text stands for. A byte-order mark is ignored.

        Returns
        -------
        Arm

        Raises
        ------
        ValueError
            If the text is not JSON, of another format or version, or a field is missing, not
            numeric or out of bounds; the sentence names the field.
        TypeError
            If `source` is of another type.
        OSError
            If the file cannot be read, or is a folder.
        """
        params, where = read_fields(source)
        try:
            return cls(**params)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{where}: {error}") from None

    def to_json(self, path: str | PathLike[str] | None = None) -> str:
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
        return _write_text(json_text(self), path)

    @classmethod
    def from_urdf(
        cls, source: str | PathLike[str], *, base: str | None = None, tip: str | None = None
    ) -> "Arm":
        """Read a chain of revolute and prismatic joints from a URDF file.

        The table follows from the common normals of the axes. Fixed joints are folded in; angles
        such as "1.5708", which are pi/2 rounded, are taken as pi/2. The order of the joints is
        that from `base` to `tip`, their zeros and senses are the file's.

        Parameters
        ----------
        source : str or path-like
            Path of the file, or the text itself; or Universal Robots' kinematics in YAML, as
            ur_calibration writes them, with the controller's base.
        base, tip : str, default=None
            Names of the links where the chain begins and ends; `tip` is the probe. None: the only
            ones there are, and of what `to_urdf` has written the arm's own base.

        Returns
        -------
        Arm
            In the modified convention. Points are in the frame of the link `base` wherever a
            Denavit-Hartenberg table can start from it; else a warning says from where. `up` is the
            z axis of the file's first link, such as "world", if only fixed joints lead from it to
            `base`.

        Raises
        ------
        ValueError
            If the file is no URDF, branches and `base` or `tip` is not given, or a joint on the
            way is planar or of another kind: the sentence names it.

        Warns
        -----
        UserWarning
            If the base frame is another, if axes are so nearly parallel that they are taken as
            parallel, or if rounded angles that are taken as pi/2 move the probe by more than 1 um:
            by how much; below that it is a note, which the command `raacmm arm` prints.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> arm = Arm.from_name("panda")
        >>> again = Arm.from_urdf(arm.to_urdf())
        >>> bool(abs(again.forward([[0.1] * 7]) - arm.forward([[0.1] * 7])).max() < 1e-9)
        True
        """
        return read_urdf(cls, source, base, tip)[0]

    def to_urdf(self, path: str | PathLike[str] | None = None) -> str:
        """Write the arm as a URDF file: links without shape, moving joints, and the probe.

        Joints have the names and limits of the arm; where there is no limit they turn a hundred
        times, or slide 100 m. Either end may have one alone.
        Where the robot has a file of its own, `update_urdf` keeps what else stands there.

        Parameters
        ----------
        path : str or path-like, default=None
            File to write. None only returns the text.

        Returns
        -------
        str
            The text: links ``base_link``, ``link1``, ... and ``probe``, in m and rad, of the
            joints' own angles: the format has no `couplings`, no scales of joints that slide and no
            `up_frame`, and a warning says so. Where the arm does not stand upright a link ``world``
            comes first, which `from_urdf` leaves out.
        """
        return _write_text(urdf_text(self), path)

    def update_urdf(
        self,
        original: str | PathLike[str],
        out: str | PathLike[str] | None = None,
        *,
        base: str | None = None,
        tip: str | None = None,
    ) -> str:
        """Write the calibrated arm back into the robot's own description.

        The origins of the joints from `base` to `tip` get new numbers, those of fixed joints where
        the arm has right angles for rounded ones. Everything else stays as it is in the file:
        names, limits, meshes, tools and comments.

        Parameters
        ----------
        original : str or path-like
            What `from_urdf` has read: a URDF or UR's kinematics, path or text.
        out : str or path-like, default=None
            File to write, which may be the original. None only returns the text.
        base, tip : str, default=None
            As for `from_urdf`.

        Returns
        -------
        str
            The text. It has the kinematics of `forward`. A tool is no part of UR's kinematics, so
            UR's file leaves out the probe's distance from the last axis. An `up` unlike the file's
            turns the fixed joint between its first link and `base`, if there is one. Where the last
            joint moves and the probe is beside its axis, a link of the probe is added, and a
            warning names it.

        Raises
        ------
        ValueError
            If this arm was not read from the file.

        Examples
        --------
        >>> from sklearn_raacmm import Arm
        >>> file = Arm.from_name("panda").to_urdf()
        >>> arm = Arm.from_urdf(file)
        >>> calibrated = arm.replace(a=arm.a + 0.1)
        >>> again = Arm.from_urdf(calibrated.update_urdf(file))
        >>> off = again.forward([[0.1] * 7]) - calibrated.forward([[0.1] * 7])
        >>> bool(abs(off).max() < 1e-9)
        True
        """
        if out is not None:
            check_places([out])
        return _write_text(write_into_urdf(self, original, base, tip), out)


# skops knows a method that a model holds by its module and its class: those of `Arm`.
for _method in (Arm.forward, Arm.frames, Arm.jacobian, Arm.angles_for):
    _method.__module__ = __name__


def _write_text(text, path):
    """The text, written to a file where a path is given."""
    if path is not None:
        write_whole({path: text})
    return text
