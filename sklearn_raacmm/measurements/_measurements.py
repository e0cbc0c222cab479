"""What was measured with an arm: one record, checked once, for every function that takes it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import Arm, JointTypes
from sklearn_raacmm.measurements._dwells import Dwells, find_poses, within_turn
from sklearn_raacmm.measurements._features import Features, check_length, probe_offsets
from sklearn_raacmm.utils import Groups, floats, listed


@dataclass(frozen=True, eq=False)
class Measurements:
    """Joint angles, and what each row says of the probe, checked once.

    Made by :meth:`of`. Functions such as :func:`calibrate` and :func:`learn_correction` take it in
    place of the angles and of all that is measured with them.

    Attributes
    ----------
    angles : ndarray of shape (n, n_joints)
        In rad, one row for each pose: of rows in which the arm stood still the mean.
    index, labels : ndarray of shape (n,) and (n_groups,), or None
        Number of what was touched in each row, and what the numbers are called.
    points : ndarray of shape (n, 3) or None
        Positions measured by a tracker, mm.
    lengths : list of (int, int, float, float)
        Known lengths by the numbers of their ends, mm at their temperature, and their standard
        deviations; of a feature and itself, its size.
    offsets : list of ndarray
        Of each length, by how many mm it may be longer for the centre of the probe's own ball.
    features : list of str or None
        Kind of what each number of `index` is; None: fixed points.
    tools, tool_labels, stations, station_labels : ndarray of shape (n,) or None, and tuple
        Numbers of the tool and of the set-up of each row, and what they are called.
    extra : dict of str to ndarray of shape (n,)
        Causes that were written down.
    poses : Dwells
        Which of the given rows are which row.
    stated : tuple
        `features` as given.
    joint_types : str
        Those of an :class:`Arm` with joints that slide, whose `angles` are mm; empty: all turn.

    Examples
    --------
    >>> from sklearn_raacmm import Measurements, calibrate
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> test = make_single_point(n_positions=4, n_poses=20)  # simulated
    >>> measured = Measurements.of(test.data, test.groups)
    >>> measured
    Measurements(80 rows of 6 joints, 4 groups)
    >>> calibrate(test.nominal_arm, measured).scatter_after_mm < 0.05
    True
    """

    angles: np.ndarray
    index: Any = None
    points: np.ndarray | None = None
    lengths: list[tuple[int, int, float, float]] = field(default_factory=list)
    tools: np.ndarray | None = None
    stations: np.ndarray | None = None
    labels: Any = None
    tool_labels: tuple[Hashable, ...] = ()
    station_labels: tuple[Hashable, ...] = ()
    features: list[str] | None = None
    offsets: Any = None
    extra: dict[str, np.ndarray] = field(default_factory=dict)
    poses: Any = None
    stated: tuple[Any, ...] = ()
    joint_types: str = ""

    @cached_property
    def touched(self) -> Features:
        """The features that rows are touches of: cones where nothing is said."""
        return Features(self.features or ["cone"] * (int(self.index.max()) + 1), self.index)

    @property
    def n_tools(self) -> int:
        return 1 if self.tools is None else int(self.tools.max()) + 1

    @property
    def n_stations(self) -> int:
        """How many bases are unknown: none where nothing but labels was given."""
        if self.points is None:
            return 0
        return 1 if self.stations is None else int(self.stations.max()) + 1

    @cached_property
    def n_shown(self) -> np.ndarray:
        """How many coordinates each row shows, (n,)."""
        if not self.features:
            return np.full(len(self.angles), 3)
        return self.touched.n_shown[self.index]

    @cached_property
    def informative(self) -> np.ndarray:
        """Whether each row can scatter, (n,): one point is its own mean, and shows no precision."""
        if self.points is not None or self.index is None:
            return np.ones(len(self.angles), dtype=bool)
        return self.touched.scatter[self.index]

    @cached_property
    def n_coordinates(self) -> int:
        """Coordinates that rows show, less those that the unknowns of what was touched take."""
        taken = 0
        if self.points is None and self.index is not None:
            taken = self.touched.n_unknowns[self.touched.scatter].sum()
        return int(self.n_shown[self.informative].sum() - taken)

    @classmethod
    def of(
        cls,
        angles: ArrayLike,
        groups: ArrayLike | None = None,
        *,
        points: ArrayLike | None = None,
        lengths: Iterable[Sequence[Any]] = (),
        features: Iterable[Sequence[Any]] = (),
        tip_diameter: float = 0.0,
        tools: ArrayLike | None = None,
        stations: ArrayLike | None = None,
        extra: Mapping[str, ArrayLike] | None = None,
        angle_unit: str = "rad",
        n_joints: int | None = None,
        joint_types: str | None = None,
    ) -> "Measurements":
        """Check what was measured, and take rows in which the arm stood still as one.

        Parameters
        ----------
        angles, groups, points, lengths, features, tip_diameter, tools, stations, angle_unit
            As in :func:`calibrate`.
        extra : dict of str to array-like of shape (n_samples,), default=None
            As in :func:`learn_correction`.
        n_joints : int, default=None
            Joints of the arm, where a sentence shall say that their number is wrong.
        joint_types : str, default=None
            Those of an :class:`Arm` with joints that slide, which are in mm. None: all turn.

        Returns
        -------
        Measurements

        Raises
        ------
        ValueError
            If shapes, labels or numbers do not fit together.

        Warns
        -----
        FindingWarning
            If angles look as if they were in another unit.
        """
        n_joints = np.shape(angles)[-1] if n_joints is None and np.ndim(angles) else n_joints
        # Within one turn, lest a warning of far angles be repeated by everything that follows.
        types = joint_types or ""
        angles = within_turn(
            JointTypes(types or "R" * (n_joints or 0)).check_angles(angles, angle_unit), types
        )
        n = len(angles)
        found: dict[str, Any] = {"joint_types": types}
        if points is not None:
            points = floats("points", points, (n, 3), finite=True)
            if features:
                raise ValueError("features are groups of touches; measured points have none.")
        elif stations is not None:
            raise ValueError(
                "stations are of measured points. In a test without a tracker, a fixed point that "
                "is measured from another place is another group: give it a label of its own."
            )
        for name, given in (("tool", tools), ("station", stations)):
            if given is not None:
                names, found[f"{name}s"] = Groups.encoded(given, n, f"{name}s")
                found[f"{name}_labels"] = tuple(names.tolist())
        lengths, features = listed("lengths", lengths), listed("features", features)
        if groups is not None:
            found["labels"], found["index"] = Groups.encoded(groups, n, "groups (positions)")
            named = found["labels"].tolist()
            found["lengths"] = [check_length(entry, named) for entry in lengths]
            if features:
                touched = Features.stated(features, named, found["index"])
                ends = [[touched.kinds[i] for i in entry[:2]] for entry in found["lengths"]]
                offsets = [probe_offsets(pair, tip_diameter) for pair in ends]
                offsets += [
                    probe_offsets(["sphere"], tip_diameter, one[4]) for one in touched.sizes
                ]
                found["lengths"] += [one[:4] for one in touched.sizes]
                found |= {"features": touched.kinds, "offsets": offsets, "stated": tuple(features)}
        elif lengths or features:
            raise ValueError("lengths and features are of groups: give groups, labels of rows.")
        whole = cls(angles, points=points, **found, extra=given_causes(extra, n))
        parts = (whole.index, whole.tools, whole.stations)
        columns = [np.zeros(n), *(part for part in parts if part is not None)]
        codes = np.unique(np.column_stack(columns), axis=0, return_inverse=True)[1].ravel()
        poses = find_poses(angles, codes, points, types)
        values = {name: poses.mean(getattr(whole, name)) for name in _ROWS}
        causes = {name: column[poses.first] for name, column in whole.extra.items()}
        angles = poses.mean_angles(angles)
        return replace(whole, angles=angles, extra=causes, poses=poses, **values)

    def check_joints(self, arm: Arm) -> None:
        """Refuse measurements of another number of joints, or whose mm are taken for angles."""
        arm.check_angles(self.angles, "rad")
        if JointTypes(self.joint_types).slides != arm.slides:
            raise ValueError(
                f"joint_types of the arm are {arm.joint_types!r}, and of the measurements "
                f"{self.joint_types!r}: Measurements.of(..., joint_types=arm.joint_types) takes mm "
                "for no angles."
            )

    @classmethod
    def taken(
        cls, angles: ArrayLike | "Measurements", groups: ArrayLike | None = None, **given: Any
    ) -> "Measurements":
        """What a function was given: measurements, or all that :meth:`of` makes them of."""
        if not isinstance(angles, Measurements):
            return cls.of(angles, groups, **given)
        doubled = [n for n in _PARTS if (v := given.get(n)) is not None and np.shape(v) != (0,)]
        doubled += ["tip_diameter"] * bool(given.get("tip_diameter"))
        if groups is not None or doubled:
            raise ValueError(
                f"{(['groups'] if groups is not None else doubled)[0]} are in the measurements "
                "already: give them to Measurements.of."
            )
        return angles

    def without_lengths(self, out: Iterable[bool]) -> "Measurements":
        """The same without the lengths that are `out`, (n_lengths,) of bool."""
        kept = [k for k, is_out in enumerate(out) if not is_out]
        lengths, offsets = ([of[k] for k in kept] for of in (self.lengths, self.offsets))
        return replace(self, lengths=lengths, offsets=offsets)

    def at(self, rows: np.ndarray | slice) -> "Measurements":
        """Some of the rows, and the lengths whose ends are both among them."""
        some: dict[str, Any] = {
            name: None if (v := getattr(self, name)) is None else v[rows] for name in _ROWS
        }
        angles = self.angles[rows]
        extra = {name: column[rows] for name, column in self.extra.items()}
        for name in ("tool", "station"):
            if some[f"{name}s"] is not None:
                kept, some[f"{name}s"] = np.unique(some[f"{name}s"], return_inverse=True)
                some[f"{name}_labels"] = tuple(getattr(self, f"{name}_labels")[i] for i in kept)
        if self.index is not None:
            kept, some["index"] = np.unique(some["index"], return_inverse=True)
            number = {code: i for i, code in enumerate(kept.tolist())}
            own = [k for k, (i, j, *_) in enumerate(self.lengths) if i in number and j in number]
            some["lengths"] = [
                (number[i], number[j], *of) for i, j, *of in (self.lengths[k] for k in own)
            ]
            some["offsets"] = self.offsets and [self.offsets[k] for k in own]
            some["features"] = self.features and [self.features[code] for code in kept]
            some["labels"] = self.labels[kept]
            named = set(some["labels"].tolist())
            some["stated"] = tuple(one for one in self.stated if one[0] in named)
        return replace(self, angles=angles, extra=extra, poses=None, **some)

    def __post_init__(self) -> None:
        if self.offsets is None:
            object.__setattr__(self, "offsets", [np.zeros(1)] * len(self.lengths))
        if self.poses is None:
            every = np.arange(len(self.angles))
            object.__setattr__(self, "poses", Dwells(every, every))

    def __repr__(self) -> str:
        parts = [f"{len(self.angles)} rows of {self.angles.shape[1]} joints"]
        if self.points is not None:
            parts.append("measured points")
        if self.labels is not None:
            parts.append(f"{len(self.labels)} groups")
        return f"Measurements({', '.join(parts)})"


_ROWS = ("index", "points", "tools", "stations")
_PARTS = ("points", "lengths", "features", "tools", "stations", "extra")


def given_causes(extra: Mapping[str, ArrayLike] | None, n_rows: int) -> dict[str, np.ndarray]:
    """Causes that somebody gave by their names, (n_rows,) each; one number counts for all rows."""
    if extra is not None and not isinstance(extra, Mapping):
        raise ValueError(f"extra must be a dict of names and values, got {extra!r:.60}.")
    found = {}
    for name, value in (extra or {}).items():
        said = f"extra[{name!r}]"
        values = floats(said, value, finite=True)
        if values.shape not in ((), (n_rows,), (n_rows, 1)):
            raise ValueError(f"{said} must have shape ({n_rows},), got {values.shape}.")
        found[name] = np.broadcast_to(values.ravel(), n_rows)
    return found
