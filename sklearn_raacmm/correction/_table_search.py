"""What is wrong with a table whose points scatter by centimetres: sense, order, unit."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass, replace
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import Arm, check_arm
from sklearn_raacmm.calibration import calibrate
from sklearn_raacmm.utils import align, centred, encode_groups, ignored_findings

# Rows that candidates are ranked on, and how many of them are then calibrated: for speed. With all
# numbers here the tables of tests/correction/test_table_search.py, of one and of two faults, are
# named, and none is for a right table or for no arm at all.
_RANKED_ROWS = 400
_CALIBRATED = 6
# A change is proposed where it leaves less than this share of the scatter; of several that leave
# about the same, up to this factor, the one with the fewest changes.
_WORTH_SAYING = 0.2
_ABOUT_THE_SAME = 1.5


@dataclass(frozen=True, eq=False)
class TableChange:
    """A change of the arm's description that makes points coincide.

    Attributes
    ----------
    change : str
        What was changed, such as ``"joint 4 reversed"``.
    scatter_mm : float
        Mean scatter after calibration with the change, without outliers.
    scatter_given_mm : float
        Mean scatter after calibration without it.
    arm : Arm
        The changed nominal arm.
    columns : tuple of int
        Columns of the angles, from 0, in the order that the arm has its joints.
    angle_unit : {"rad", "deg"}
        Unit that the angles then are in.
    options : str
        What to add to ``raacmm learn`` for it.
    first_point : tuple of float
        Where the first row then is in the base frame, mm.
    equals : tuple of TableChange
        Other changes with which the points coincide as well, such as the one to the mirror image of
        the arm. `first_point` shows which is right.
    """

    change: str
    scatter_mm: float
    scatter_given_mm: float
    arm: Arm
    columns: tuple[Any, ...]
    angle_unit: str
    options: str = ""
    first_point: tuple[float, ...] = ()
    equals: tuple[Any, ...] = ()

    def __str__(self) -> str:
        said = (
            f"With {self.change} the points scatter by {self.scatter_mm:.2g} mm instead of "
            f"{self.scatter_given_mm:.3g} (raacmm learn {self.options})."
        )
        places = []
        for one in (self, *self.equals):
            where = ", ".join(f"{mm:.0f}" for mm in one.first_point)
            places.append(f"{one.change}, {where} ({one.options})")
        if self.equals:
            said += " Others do it as well; x, y and z of the first row in mm tell which is right: "
            said += f"{'; '.join(places)}."
        return said


@ignored_findings()  # of the wrong tables, nearly all have something to be said
def search_table(
    arm: Arm,
    angles: ArrayLike,
    positions: ArrayLike | None = None,
    points: ArrayLike | None = None,
    *,
    angle_unit: str = "rad",
) -> TableChange | None:
    """Search for what is wrong with an arm whose points scatter much after calibration.

    Tried are all senses of the joints, two joints exchanged and all in reverse order, the other
    convention of the table, and the other unit of the angles.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    angles : array-like of shape (n_samples, n_joints)
        Joint angles.
    positions : array-like of shape (n_samples,), default=None
        Label of the position of each row. Needed unless `points` is given.
    points : array-like of shape (n_samples, 3), default=None
        Positions measured by a tracker, mm.
    angle_unit : {"rad", "deg"}, default="rad"
        Unit that `angles` are taken to be in.

    Returns
    -------
    TableChange or None
        The change with which the points coincide best, the simplest of equals; None where none
        leaves less than a fifth of the scatter.

    Raises
    ------
    ValueError
        As :func:`calibrate`.

    Examples
    --------
    >>> from sklearn_raacmm import search_table
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> test = make_single_point(n_positions=6, n_poses=15, random_state=0)  # simulated
    >>> wrong = test.nominal_arm.replace(joint_signs=[1, 1, 1, -1, 1, 1])
    >>> search_table(wrong, test.data, test.groups).change
    'joint 4 reversed'
    """
    check_arm(arm)
    given = _scatter(arm, angles, positions, points, angle_unit)
    raw = np.asarray(angles, dtype=float)
    codes = few_points = None
    if points is None:  # whole positions, as many as fit
        codes = encode_groups(positions, len(raw))[1]
        rows = np.argsort(codes, kind="stable")[:_RANKED_ROWS]
        codes = codes[rows]
    else:  # some from everywhere
        rows = np.linspace(0, len(raw) - 1, min(len(raw), _RANKED_ROWS)).astype(int)
        few_points = np.asarray(points, dtype=float)[rows]
    ranked = []
    for entry in _candidates(arm, angle_unit, np.abs(raw).max()):
        ranked.append((_quick_scatter(entry[2:], raw[rows], codes, few_points), *entry))
    ranked.sort(key=lambda entry: entry[:2])
    # Of those that coincide about as well as the best, the simple ones first.
    best = [entry for entry in ranked if entry[0] <= _ABOUT_THE_SAME * ranked[0][0]]
    best = sorted(best, key=lambda entry: entry[1:3])[:_CALIBRATED]
    # A mirror image of the arm coincides as well, but for what calibration has to find.
    best += [entry for entry in ranked[:3] if entry not in best]
    found = []
    for _, _, change, other, columns, unit in best:
        scatter = _scatter(other, raw[:, columns], positions, points, unit)
        where = other.forward(raw[:1, columns], angle_unit=unit)[0].tolist()
        options = _options(arm, other, columns, None if unit == angle_unit else unit)
        parts = change, scatter, given, other, tuple(columns), unit, options, tuple(where)
        found.append(TableChange(*parts))
    least = min(entry.scatter_mm for entry in found)
    if least > _WORTH_SAYING * given:
        return None
    first, *equals = (one for one in found if one.scatter_mm <= _ABOUT_THE_SAME * least)
    return replace(first, equals=tuple(equals))


def _options(arm, other, columns, unit):
    """Options of `raacmm learn` that change an arm, the order of its angles and their unit."""
    reversed_ = np.flatnonzero(arm.joint_signs != other.joint_signs) + 1
    order = ",".join(str(i + 1) for i in columns)
    words = [
        ("--take " + "-".join(["reversed", *map(str, reversed_)])) * bool(len(reversed_)),
        "--take other-convention" * (arm.convention != other.convention),
        f"--angles with the columns {order}" * (columns != sorted(columns)),
        f"--unit {unit}" * bool(unit),
    ]
    return " ".join(word for word in words if word)


def _scatter(arm, angles, positions, points, unit):
    """Mean scatter after calibration, mm."""
    where = {"groups": positions} if points is None else {"points": points}
    return calibrate(arm, angles, angle_unit=unit, **where).typical_scatter_mm


def _candidates(arm, unit, largest):
    """Yield (number of changes, words, arm, order of columns, unit) of every candidate."""
    n, as_given, straight = arm.n_joints, np.ones(arm.n_joints), [*range(arm.n_joints)]
    # Orders with the given senses, and senses in the given order: both wrong at once is rare.
    joints: list[Any] = [(1, "the joints in reverse order", straight[::-1], as_given)]
    for i, j in combinations(range(n), 2):
        columns = [{i: j, j: i}.get(column, column) for column in straight]
        joints.append((1, f"joints {i + 1} and {j + 1} exchanged", columns, as_given))
    for signs in product((1.0, -1.0), repeat=n):  # the first are those given
        which = [str(i + 1) for i in range(n) if signs[i] < 0]
        words = f"joint{'s' * (len(which) > 1)} {' and '.join(which)} reversed" * bool(which)
        joints.append((len(which), words, straight, signs))
    other = {"standard": "modified", "modified": "standard"}[arm.convention]
    conventions = [("", arm.convention), (f"the {other} convention", other)]
    units = [("", unit)]
    # Read as degrees, an arm in radians hardly moves, and its points scatter little for that.
    if (largest > 2 * np.pi) == (unit == "rad"):
        words = {"rad": ("the angles in degrees", "deg"), "deg": ("the angles in radians", "rad")}
        units.append(words[unit])
    for (n_changes, *moved), form, angle_unit in product(joints, conventions, units):
        words = [one for one in (moved[0], form[0], angle_unit[0]) if one]
        if words:
            changed = arm.replace(joint_signs=arm.joint_signs * moved[2], convention=form[1])
            n_changes += bool(form[0]) + bool(angle_unit[0])
            yield n_changes, " and ".join(words), changed, moved[1], angle_unit[1]


def _quick_scatter(candidate, angles, codes, points):
    """Mean distance with nothing but the probe fitted, and the base for a tracker's points."""
    arm, columns, unit = candidate
    angles = np.deg2rad(angles[:, columns]) if unit == "deg" else angles[:, columns]
    if points is None:
        frames = arm.frames(angles)[:, -1]
        # Points are linear in the probe: origin + turn @ probe.
        parts = centred(frames[:, :3], codes)
        A, left = parts[:, :, :3].reshape(-1, 3), parts[:, :, 3]
        left = left - (A @ np.linalg.lstsq(A, left.ravel(), rcond=None)[0]).reshape(-1, 3)
    else:
        ours = arm.forward(angles)
        rotation, shift = align(ours, points)
        left = ours @ rotation.T + shift - points
    return float(np.linalg.norm(left, axis=1).mean())
