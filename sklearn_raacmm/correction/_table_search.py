"""What is wrong where points scatter by centimetres: sense, zero, order, unit, or rows shifted."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain, combinations, permutations, product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import calibrate
from sklearn_raacmm.correction._zeros import with_found_zeros
from sklearn_raacmm.measurements import Explanation
from sklearn_raacmm.utils import Finding, Groups, align

# Rows that candidates are ranked on, how many are then looked at, and how many of each hand of them
# are calibrated: for speed. With all numbers here the tables of
# tests/correction/test_table_search.py, of one and of two faults, are named, and none is for a
# right table or for no arm at all.
_RANKED_ROWS = 400
_LOOKED_AT, _CALIBRATED = 60, 3
# A change is proposed where it leaves less than this share of the scatter and of the reach; of
# several that leave about the same, up to this factor, that of the lowest price.
_WORTH_SAYING, _COINCIDE = 0.2, 0.01
_ABOUT_THE_SAME = 1.5
# Rows that a move of the base is first looked for at, of all: for speed.
_SPLITS = 25
# Price of another zero, beside 1 of any other change: makers count joints from upright or from
# horizontal more often than backwards.
_ZERO = 0.9
# Codes of joints whose own angle is a sum or a difference, and what is in `Arm.couplings` for them.
_SUMS = {"coupled": 1, "uncoupled": -1}
_OTHER_CONVENTION = {"standard": "modified", "modified": "standard"}
# A shift is named where the steps between points then differ from those of the poses by less than
# this share of what they differ by as they stand, and those before them do: half of a metre and
# some centimetres, where the arm is known badly, are a tenth.
_LEFT = 0.2
# Axes of a tracker's points as they are, and with two exchanged.
_AXES, _MIRRORED = (0, 1, 2), (1, 0, 2)


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
        Other changes with which the points coincide as well.
    axes : tuple of int
        Columns of `points`, from 0, in the order that makes them right-handed.
    is_mirror : bool
        Whether this one of `equals` is the mirror image of the first; else it is the same arm seen
        from elsewhere.
    questions : tuple of str
        What to look at on the arm itself to know which of `equals` it is, as no data tell.
    answers : tuple of str
        What the questions are answered with if it is this one.
    """

    change: str
    scatter_mm: float
    scatter_given_mm: float
    arm: Arm
    columns: tuple[int, ...]
    angle_unit: str
    options: str = ""
    first_point: tuple[float, ...] = ()
    equals: "tuple[TableChange, ...]" = ()
    axes: tuple[int, ...] = (0, 1, 2)
    is_mirror: bool = False
    questions: tuple[str, ...] = ()
    answers: tuple[str, ...] = ()

    def __str__(self) -> str:
        said = (
            f"With {self.change} the points scatter by {self.scatter_mm:.2g} mm instead of "
            f"{self.scatter_given_mm:.3g} (raacmm learn {self.options})."
        )
        for is_mirror, what in enumerate(("The same arm seen from elsewhere", "Its mirror image")):
            if equals := [one for one in self.equals if one.is_mirror == is_mirror]:
                said += f" {what}: {'; '.join(f'{one.change} ({one.options})' for one in equals)}."
        if self.questions:
            said += f" The arm itself tells which is right. {' '.join(self.questions)} "
            ones = (f"{one.change}: {', '.join(one.answers)}" for one in (self, *self.equals))
            said += f"{'; '.join(ones)}."
        return said


@Finding.ignored()  # of the wrong tables, nearly all have something to be said
def search_table(
    arm: Arm,
    angles: ArrayLike,
    positions: ArrayLike | None = None,
    points: ArrayLike | None = None,
    *,
    angle_unit: str = "rad",
    others: Mapping[str, ArrayLike] | None = None,
) -> TableChange | None:
    """Search for what is wrong with an arm whose points scatter much after calibration.

    Tried are all senses of the joints, quarter and half turns of their zeros, joints whose angle is
    the sum or the difference of two, two joints exchanged and all in reverse order, the other
    convention of the table, the other unit of the angles, and a tracker's points that are mirrored.
    Where none of these helps, a base that moved between two rows, an external axis that moves it,
    and zeros of all joints, from random starts, are looked for.

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
    others : dict of str to array-like of shape (n_samples,), default=None
        Further columns by name, of which one may be a linear axis that moves the base, as E1 of a
        robot does. Needs `points`.

    Returns
    -------
    TableChange or None
        The change with which the points coincide best, the simplest of equals; None where none
        leaves less than a fifth of the scatter, or all leave more than 1 % of the arm's reach.

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
    Arm.check(arm)
    given = _calibrated(arm, angles, positions, points, angle_unit).typical_scatter_mm
    raw = np.asarray(angles, dtype=float)
    points = None if points is None else np.asarray(points, dtype=float)
    rows, codes, few_points = _few_rows(len(raw), positions, points)
    largest = np.abs(raw * arm.by_type(1.0, 0.0)).max()
    candidates = _candidates(arm, angle_unit, largest, points is not None)
    few = raw[rows], codes, few_points
    quick = [
        (price, replace(one, scatter_mm=_quick_scatter(one, *few))) for price, one in candidates
    ]
    ranked = sorted(quick, key=lambda entry: (entry[1].scatter_mm, entry[0], entry[1].change))
    # Of those that coincide about as well as the best of their hand, the simple ones first. A
    # mirror image coincides as well, but for what calibration has to find.
    place, tried = _places(ranked[0][1], raw), ranked[:1]
    mirrored = [_are_mirrored(place, _places(one, raw)) for _, one in ranked[:_LOOKED_AT]]
    for hand in (False, True):
        of_hand = [entry for entry, other in zip(ranked, mirrored, strict=False) if other == hand]
        limit = _ABOUT_THE_SAME * min((one.scatter_mm for _, one in of_hand), default=0.0)
        near = [entry for entry in of_hand if entry[1].scatter_mm <= limit]
        tried += sorted(near, key=lambda entry: (entry[0], entry[1].change))[:_CALIBRATED]

    def calibrated(price, one, **measured):
        """The change, and its price: one for each thing changed, and the size of what is left.

        Two changes may differ by what calibration finds only, such as the probe. The likelier one
        leaves less to be found: of a size of which nothing is known by its logarithm.
        """
        measured = {"positions": positions, "points": points} | measured
        if points is not None:
            measured["points"] = measured["points"][:, one.axes]
        result = _calibrated(one.arm, raw[:, one.columns], unit=one.angle_unit, **measured)
        scatter, places = result.typical_scatter_mm, _places(one, raw)
        others = _places(replace(one, arm=result.arm), raw)
        turn, shift = align(places, others)
        moved = np.sqrt(np.mean(np.square(places @ turn.T + shift - others)))
        found = {"scatter_mm": scatter, "first_point": tuple(places[0].tolist())}
        return price + np.log(moved + scatter), replace(one, scatter_given_mm=given, **found)

    different = {one.change: (price, one) for price, one in tried}.values()
    found = [calibrated(price, replace(one, arm=one.arm.replace())) for price, one in different]
    least, limit = min(one.scatter_mm for _, one in found), _COINCIDE * arm.reach_mm
    limit = min(_WORTH_SAYING * given, limit)
    rarer = _rarer_changes(arm, (raw, positions, points, angle_unit), others or {})
    while least > limit:  # no simple change
        if (one := next(rarer, None)) is None:
            return None
        change, options, other, measured = one
        found = [calibrated(0, _changed(other, angle_unit, change, options), **measured)]
        least = found[0][1].scatter_mm
    found = sorted(found, key=lambda entry: (entry[0], entry[1].change))
    first, *equals = (one for _, one in found if one.scatter_mm <= _ABOUT_THE_SAME * least)
    place = _places(first, raw)
    equals = [replace(one, is_mirror=_are_mirrored(place, _places(one, raw))) for one in equals]
    first, *equals = _with_questions([first, *equals], raw)
    return replace(first, equals=tuple(equals))


def _rarer_changes(arm, measured, others):
    """Yield what may be wrong beside a table, then zeros: words, options, arm, what differs.

    `measured` are angles, positions, points and the unit of the angles, `others` further columns
    by name; what differs is what `_calibrated` takes instead.
    """
    angles, positions, points, unit = measured
    n, as_given = len(angles), _changed(arm, unit)
    codes: Any = None if positions is None else Groups.encoded(positions, n)[1]

    def left(row):  # where from this row on the base, or all cones, are elsewhere
        late = np.arange(n) >= row
        if points is None:
            return _quick_scatter(as_given, angles, 2 * codes + late, None)
        parts = [_quick_scatter(as_given, angles[m], None, points[m]) for m in (~late, late)]
        return float(np.average(parts, weights=[row, n - row]))

    least = Explanation.LEAST_ROWS
    if n >= 2 * least:
        rows = np.unique(np.linspace(least, n - least, _SPLITS).astype(int)).tolist()
        k = rows.index(min(rows, key=left))
        row = min(range(rows[max(k - 1, 0)], rows[min(k + 1, len(rows) - 1)] + 1), key=left)
        late, (before, behind) = np.arange(n) >= row, Finding.row_numbers([row - 1, row])
        what, word, labels = "tracker", "--station", {"stations": late}
        if points is None:
            what, word, labels = "cones", "--position", {"positions": 2 * codes + late}
        option = f"{word} with other labels from row {behind} on"
        yield (
            f"the base or the {what} moved between rows {before} and {behind}",
            option,
            arm,
            labels,
        )
    for name, column in others.items() if points is not None else ():
        x = np.asarray(column, dtype=float) - np.mean(column)
        if x @ x > 0:
            # What goes with it is taken out of both, then what the axis does is left.
            both = [
                part - part.mean(axis=0) for part in (_places(as_given, angles), np.asarray(points))
            ]
            turn, _ = align(*(part - np.outer(x, x @ part) / (x @ x) for part in both))
            way = x @ (both[1] - both[0] @ turn.T) / (x @ x)
            by = ", ".join(f"{mm:.6g}" for mm in way)
            change = f"{name} as an axis that moves the base by ({by}) mm a unit"
            option = "--points without that movement"
            yield change, option, arm, {"points": points - np.outer(x, way)}
    other = with_change(arm, "zeros", measured)
    turns = np.rad2deg(np.angle(np.exp(1j * (other.theta_offset - arm.theta_offset))))
    shown = [f"joint {j + 1} by {turns[j]:.4g}" for j in np.flatnonzero(np.abs(turns) > 0.5)]
    yield f"the zeros turned, {', '.join(shown)} degrees", "--take zeros", other, {}


def _few_rows(n, positions, points):
    """Some of n rows, for speed, the codes of their positions, and their points."""
    if points is None:  # whole positions, as many as fit
        codes = Groups.encoded(positions, n)[1]
        rows = np.argsort(codes, kind="stable")[:_RANKED_ROWS]
        return rows, codes[rows], None
    rows = np.linspace(0, n - 1, min(n, _RANKED_ROWS)).astype(int)  # some from everywhere
    return rows, None, np.asarray(points, dtype=float)[rows]


def with_change(arm: Arm, code: str, measured: tuple[Any, Any, Any, str]) -> Arm:
    """The arm changed as a finding proposes, see `TableChange.options`.

    `measured` are angles, positions, points and the unit of the angles: "zeros" are found there.
    """
    Arm.check(arm)
    if code == "zeros":
        angles, positions, points, unit = measured
        if positions is None and points is None:
            raise ValueError(
                "zeros are found from labels of positions, or from a tracker's points."
            )
        angles = arm.check_angles(angles, unit)
        rows, codes, few_points = _few_rows(len(angles), positions, points)
        return with_found_zeros(arm, angles[rows], codes, few_points)
    word, *numbers = code.split("-")
    joints = [str(i + 1) for i in range(arm.n_joints)]
    if code == "other-convention":
        return arm.replace(convention=_OTHER_CONVENTION[arm.convention])
    if word == "reversed" and numbers and set(numbers) <= set(joints):
        return arm.replace(joint_signs=arm.joint_signs * np.where(np.isin(joints, numbers), -1, 1))
    if word in _SUMS and len(numbers) == 2 and numbers[0] != numbers[1] and {*numbers} <= {*joints}:
        other, joint = map(int, numbers)
        return arm.replace(couplings=(*arm.couplings, (joint, other, _SUMS[word])))
    if word == "zero" and len(numbers) == 2 and numbers[0] in joints and numbers[1].isdigit():
        turns = np.isin(joints, numbers[:1]) * float(numbers[1])
        return arm.replace(theta_offset=_turned(arm, turns))
    raise ValueError(
        f"take needs reversed with joints of 1 to {arm.n_joints}, such as reversed-2-4, zero with "
        f"a joint and degrees, such as zero-2-180, coupled or uncoupled with two joints, such as "
        f"coupled-2-3 for J3 + J2, zeros, or other-convention, got {code!r}."
    )


def _turned(arm, degrees):
    """Zeros of an arm, rad; of the joints that are turned within half a turn."""
    offset = arm.theta_offset + np.deg2rad(degrees)
    return np.where(degrees, np.angle(np.exp(1j * offset)), arm.theta_offset)


def ask_whether_mirrored(
    given: Arm, arm: Arm, angles: Any, positions: Any, points: Any, angle_unit: str
) -> None:
    """Say that what was taken may be the mirror image of the arm, if the data cannot tell."""
    change = search_table(given, angles, positions, points, angle_unit=angle_unit)
    if change is None:
        return
    own = _changed(arm, angle_unit)
    place = _places(own, angles)
    for other in (change, *change.equals):
        if _are_mirrored(place, _places(other, angles)):
            own, other = _with_questions([own, other], angles)
            answer = ", ".join(own.answers) or "that it is as taken"
            Finding(
                "mirror-image",
                "The data fit the arm as it was taken and its mirror image alike, that with "
                f"{other.change}.",
                f"{' '.join(own.questions)} If the answer is {answer}, accept "
                f'"mirror-image"; else learn with {other.options}.',
            ).report()
            return


def _places(one, angles):
    """Points (n, 3), in the base frame, of an arm that was changed."""
    return one.arm.forward(angles[:, one.columns], angle_unit=one.angle_unit)


def _are_mirrored(places, others):
    """Whether points (n, 3) are next to the mirror image of others, rather than to them turned."""
    others = others - others.mean(axis=0)
    return bool(np.linalg.det((places - places.mean(axis=0)).T @ others) < 0)


def _with_questions(ones, angles):
    """Changed arms with the questions that tell them apart, and with their answers."""
    grows, heights = [], []
    for one in ones:
        arm, unit = one.arm, one.angle_unit
        frames = arm.frames(np.zeros((1, arm.n_joints)))[0]
        axis = frames[int(arm.convention == "modified"), :, 2]
        up = frames[arm.up_frame, :, :3] @ arm.up
        # A table that carries the part turns the other way than what is seen from it.
        turn = arm.joint_signs[0] * axis @ up * (-1 if arm.up_frame else 1)
        grows.append(round(turn) > 0)
        # Of the probe, from the frame that stands still.
        still = arm.frames(angles[:, one.columns], angle_unit=unit)[:, arm.up_frame]
        off = _places(one, angles) - still[..., 3]
        heights.append(np.einsum("ni,nij,j->n", off, still[..., :3], arm.up))
    high, low = np.argmax(heights[0]), np.argmin(heights[0])
    asked = {
        "Turn joint 1 counter-clockwise, seen from above: does its angle grow?": grows,
        "Was the probe higher in row {} than in row {}?".format(
            *Finding.row_numbers([high, low])
        ): [height[high] > height[low] for height in heights],
    }
    asked = {question: said for question, said in asked.items() if len({*said}) > 1}
    found = []
    for i, one in enumerate(ones):
        answers = tuple("yes" if said[i] else "no" for said in asked.values())
        found.append(replace(one, questions=tuple(asked), answers=answers))
    return found


def _calibrated(arm, angles, positions, points, unit, stations=None):
    """The calibration by what was measured."""
    where = {"groups": positions} if points is None else {"points": points, "stations": stations}
    return calibrate(arm, angles, angle_unit=unit, **where)


def _changed(arm, unit, change="", options="", columns=None, axes=_AXES):
    """A change whose scatter is not known."""
    columns = tuple(range(arm.n_joints) if columns is None else columns)
    return TableChange(change, np.inf, np.inf, arm, columns, unit, options, axes=axes)


def _candidates(arm, unit, largest, has_points):
    """Yield the price and the change of every candidate, the arm as it is given left out.

    Each is one of the changes of joints, of the convention, of the unit and of the points' hand:
    words, options of `raacmm learn`, price, and what is changed.
    """
    n, straight, types = arm.n_joints, [*range(arm.n_joints)], arm.joint_types
    # Orders with the given senses, and senses in the given order: both wrong at once is rare.
    alike = [(i, j) for i, j in permutations(range(n), 2) if types[i] == types[j]]
    orders = [(f"joints {i + 1} and {j + 1} exchanged", {i: j, j: i}) for i, j in alike if i < j]
    if types == types[::-1]:  # rad and mm are not exchanged, nor added
        orders.append(("the joints in reverse order", dict(enumerate(straight[::-1]))))
    joints: list[Any] = []
    for words, order in orders:
        columns = [order.get(column, column) for column in straight]
        shown = ",".join(str(column + 1) for column in columns)
        joints.append(([words], [f"--angles with the columns {shown}"], 1, (columns, {})))
    # Zeros of the first joint and the last are free: base and probe go with them.
    turning = [j for j in straight[1:-1] if types[j] == "R"]
    single = [{j: degrees} for j in turning for degrees in (90, 180, 270)]
    pairs = [{**a, **b} for a, b in combinations(single, 2) if a.keys() != b.keys()]
    for signs in product((1.0, -1.0), repeat=n):  # the first are those given
        which = [str(i + 1) for i in range(n) if signs[i] < 0]
        zeros = [{}, *single * (len(which) <= 2), *pairs * (len(which) == 0)]
        for turned in zeros:
            words = [f"joint{'s' * (len(which) > 1)} {' and '.join(which)} reversed"] * bool(which)
            words += [f"the zero of joint {j + 1} turned by {turned[j]} degrees" for j in turned]
            options = ["--take " + "-".join(["reversed", *which])] * bool(which)
            options += [f"--take zero-{j + 1}-{turned[j]}" for j in sorted(turned)]
            offset = _turned(arm, np.array([turned.get(j, 0) for j in straight]))
            changed = {"joint_signs": arm.joint_signs * signs, "theta_offset": offset}
            price = len(which) + _ZERO * len(turned)
            joints.append((words, options, price, (straight, changed)))
    for (i, j), (code, factor), sign in product(alike, _SUMS.items(), (1, -1)):
        text = f"{'-' * (sign < 0)}J{i + 1} {'- +'[1 + sign * factor]} J{j + 1}"
        options = [f"--take reversed-{i + 1}"] * (sign < 0) + [f"--take {code}-{j + 1}-{i + 1}"]
        signs = arm.joint_signs * np.where(np.arange(n) == i, sign, 1)
        changed = {"joint_signs": signs, "couplings": (*arm.couplings, (i + 1, j + 1, factor))}
        joints.append(([f"joint {i + 1} at {text}"], options, 1 + (sign < 0), (straight, changed)))
    other = _OTHER_CONVENTION[arm.convention]
    conventions: Any = [([], [], 0, arm.convention)]
    conventions.append(([f"the {other} convention"], ["--take other-convention"], 1, other))
    units: Any = [([], [], 0, unit)]
    # Read as degrees, an arm in radians hardly moves, and its points scatter little for that.
    if (largest > 2 * np.pi) == (unit == "rad"):
        word, other = {"rad": ("degrees", "deg"), "deg": ("radians", "rad")}[unit]
        units.append(([f"the angles in {word}"], [f"--unit {other}"], 1, other))
    # Two exchanged columns make left-handed points right-handed, whatever mirrored them.
    hands: Any = [([], [], 0, _AXES)]
    if has_points:
        said = ["the points mirrored (an axis negated, or two exchanged)"]
        hands.append((said, ["--points with two of its columns exchanged"], 1, _MIRRORED))
    for each in product(joints, conventions, units, hands):
        words, options, prices, ((columns, changed), form, angle_unit, axes) = zip(
            *each, strict=True
        )
        if words := [*chain(*words)]:
            said = " and ".join(words), " ".join(chain(*options))
            other = arm.on_trial(convention=form, **changed)
            yield sum(prices), _changed(other, angle_unit, *said, columns, axes)


def _quick_scatter(one, angles, codes, points):
    """Mean distance with nothing but the probe fitted, and the base for a tracker's points."""
    angles = angles[:, one.columns]
    if one.angle_unit == "deg":
        angles = angles * one.arm.by_type(np.pi / 180)
    if points is None:
        # Points are linear in the probe: origin + turn @ probe.
        ends = [(one.arm.n_joints, x) for x in np.vstack([np.zeros(3), np.eye(3)]).tolist()]
        origin, *shifted = one.arm.carried(angles, ends)
        parts = Groups(codes).centred(np.stack([origin, *(shifted - origin)]).transpose(2, 1, 0))
        A, left = parts[:, :, 1:].reshape(-1, 3), parts[:, :, 0]
        left = left - (A @ np.linalg.lstsq(A, left.ravel(), rcond=None)[0]).reshape(-1, 3)
    else:
        ours, points = one.arm.points_at(angles), points[:, one.axes]
        rotation, shift = align(ours, points)
        left = ours @ rotation.T + shift - points
    return float(np.linalg.norm(left, axis=1).mean())


def shifted_rows(arm: Arm, angles: np.ndarray, points: np.ndarray) -> Finding | None:
    """Finding of points (n, 3), mm, that are those of the next or the last pose (n, n_joints), rad.

    Distances between points of neighbouring rows are compared with those that the arm has between
    their poses, so that neither the frame of the points nor the arm has to be known well.
    """
    n = len(angles)
    if n < Explanation.LEAST_ROWS:
        return None
    measured, known = (
        np.linalg.norm(np.diff(p, axis=0), axis=1) for p in (points, arm.forward(angles))
    )
    most = np.median(known)  # a step that belongs to no pose counts so much
    as_given = np.minimum(np.abs(measured - known), most)
    found = []
    for shift in (1, -1):
        moved = np.minimum(np.abs(measured - np.roll(known, -shift)), most)
        moved[-1 if shift > 0 else 0] = most
        # From point k on: the steps before it, but for the last, which leads there, and from it on.
        before = np.r_[0.0, 0.0, np.cumsum(as_given)[:-1]]
        left = before + np.r_[np.cumsum(moved[::-1])[::-1], 0.0]
        k = int(np.argmin(left[: n - Explanation.LEAST_ROWS // 2]))
        found.append((float(left[k]), k, shift, moved))
    _, k, shift, moved = min(found, key=lambda one: one[0])
    size = _LEFT * np.median(as_given[k:])
    if np.median(moved[k:]) > size or (k > 1 and np.median(as_given[: k - 1]) > size):
        return None
    k = 0 if k == 1 and moved[0] <= size else k
    row = Finding.row_numbers([k])[0]
    of, what = "last", "a point is there twice, or a pose is missing"
    if shift > 0:
        of, what = "next", "a point is missing there"
    said = f"From row {row} on each point is that of the {of} row: {what}."
    advice = "Give both files a column of names, or mend the rows."
    return Finding("shifted-rows", said, advice, "refuse", rows=(row,))
