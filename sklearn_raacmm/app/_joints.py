"""Which columns of a table hold the joint angles: by names of loggers and robots, or by numbers."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from itertools import chain

import numpy as np

from sklearn_raacmm.app._columns import OF_TIMES
from sklearn_raacmm.app._sources import TableError
from sklearn_raacmm.arm import Arm

# Series of other quantities than angles, of commanded angles, of joints, and of measured ones. UR
# writes target_q, actual_q, actual_qd and actual_current; JointState has position, velocity and
# effort.
_OTHER_QUANTITY = re.compile(
    r"velocity|speed|qdd?(?![a-z])|(?<![a-z])vel|accel|effort|torque|moment|current|strom|voltage|"
    r"temperature|temp(?![a-z])|force|tau|(?<![a-z])d+q(?![a-z])|tcp|mode|error|drehmoment|geschwindigkeit|header|seq|secs|"
    r"(?<!joint)(?<!joint_)poses?[\W_]*\d+\W*$|cartesian"
)
# Angles and the further numbers of a pose of the tool, beside x, y and z: robots of Kawasaki and
# Staubli, Fanuc, KUKA, Universal Robots, Epson; quaternions; and Euler's angles by their names.
_ORIENTATIONS = (
    ("o", "a", "t"), ("w", "p", "r"), ("a", "b", "c"), ("u", "v", "w"), ("r", "p", "y"),
    ("roll", "pitch", "yaw"), ("alpha", "beta", "gamma"), ("phi", "theta", "psi"),
)  # fmt: skip
# An external axis beside the robot's own: a track, a positioner.
_EXTERNAL = re.compile(r"(e|ext|ej|eax_?|ext_?axis|external_?axis|track|rail|linear_?axis)_?\d?")
# What may be the column of a joint that slides, where the arm has one.
_WAY = re.compile(rf"{_EXTERNAL.pattern}|[xyzuvw]|column|lift|quill|slide|gantry_?[xyz\d]?|s\d")
# Share by which it moves.
_MOVES = 1e-6
_NOT_COMMANDED = re.compile(r"^(?!.*(target|command|cmd|desired|setpoint|reference|goal|soll))")
_OF_JOINTS = re.compile(r"(?<![a-z])(q|j|joint|axis|axe|achse|eje|theta|angle|enc|encoder)[\W_]*\d")
MEASURED = re.compile(r"actual|meas|encoder|feedback|(?<![a-z])(ist|act)(?![a-z])")


def find_joints(table, wanted, joint_names, taken=(), slides=()):
    """Columns of the joint angles in the order of the arm, each another one; not those taken.

    The columns `taken` hold other things. Joints of the numbers `slides`, from 0, slide.
    """
    if wanted is None:
        columns = _joints(table, table.n_joints, joint_names, taken, slides)
    elif len(wanted) == table.n_joints:
        columns = [table.column(name, "--angles") for name in wanted]
    else:
        raise TableError(
            f"--angles names {len(wanted)} columns, the arm has {table.n_joints} joints."
        )
    names = [name.lower() for name in table.header]
    for i in columns:
        if columns.count(i) > 1 or (wanted is None and names.count(names[i]) > 1):
            raise TableError(
                f"{table.path}: the column {table.header[i]!r} is named twice, and no two joints "
                f"have the same: say with --angles, by numbers, which to take of {table}."
            )
    return columns


def _joints(table, n, joint_names, taken, slides):
    """Columns of n joints that nobody has named."""
    states = _joint_states(table, n)
    names = [states.get(i, "") for i in range(len(table.names))] if states else table.names
    # Of a table by hand, whose joints have no names, the order is known where a maker gives names.
    every = [own for own in (joint_names or (), Arm.from_name("ur10").names) if len(own) == n]
    tried = [_by_names_of_joints(table, names, own) for own in every]
    if joints := next(filter(None, tried + _series(table, names, n) * (len(states) == n)), None):
        shown = ", ".join(table.header[i] for i in joints)
        table.note(f"Joint angles, by the names of joints: {shown}.")
        return joints
    if states:
        order = ", ".join(f"{table.header[i]} ({name})" for i, name in states.items())
        raise TableError(
            f"{table.path} names its joints, and the arm's joints have other names or none: say "
            f"the order from the base on with --angles. The columns are {order}."
        )
    beside, ways = _axes_beside(table, joint_names, taken, slides)
    if ways:
        rest, order = np.setdiff1d(np.arange(n), beside), np.zeros(n, dtype=int)
        order[beside] = ways
        if len(rest):
            order[rest] = _joints(table, len(rest), (), {*taken, *ways}, ())
        return order.tolist()
    fitting, what = _series(table, names, n), ""
    # Columns without names are numbered by us, and such numbers mean nothing.
    unnamed = all(re.fullmatch(r"column \d+", table.header[i]) for i in range(table.width))
    if not fitting or unnamed:
        fitting, what = _only_numbers(table, n, taken), "the columns of numbers in their order, "
    if len(fitting) == 1:
        names = [table.header[i] for i in fitting[0]]
        # By their numbers alone a column with another name, mistyped or not, is one of them.
        shown = ", ".join(names) if what else f"{names[0]} to {names[-1]}"
        table.notes.append(f"Joint angles: {what}{shown}.")
        return fitting[0]
    example = ",".join(f"q{i}" for i in range(1, n + 1))
    raise table.unclear(
        f"which {n} columns hold the joint angles",
        f"--angles {example} (names or numbers of columns)",
    )


def _axes_beside(table, joint_names, taken, slides):
    """Joints beside the robot's own, from 0, and their columns; these are [] without any.

    They are axes that the arm calls as controllers do, such as E2 and E1 of a positioner, or slide.
    """
    names = [name.lower() for name in joint_names or ()]
    beside = [i for i, name in enumerate(names) if _EXTERNAL.fullmatch(name)]
    own = [table.names.index(names[i]) for i in beside if names[i] in table.names]
    tried = [(beside, own, "Axes beside the robot's own")]
    for pattern in (_EXTERNAL, _WAY):  # x may be a point's, E1 is an axis
        named = [i for i, name in enumerate(table.names) if pattern.fullmatch(name)]
        tried.append((slides, [i for i in named if i not in taken], "Joints that slide"))
    for joints, ways, what in tried:
        if 0 < len(joints) == len(ways):
            table.note(f"{what}: {', '.join(table.header[i] for i in ways)}.")
            return joints, ways
    return [], []


def _only_numbers(table, n, taken):
    """A list of the columns of numbers that are no pose of the tool, if there are n of them."""
    poses = _pose_columns(table)
    joints = [i for i in columns_of_numbers(table, taken) if i not in poses]
    if len(joints) == n + 1:  # and the first counts rows, or times
        steps = np.diff(table.source.numbers(table.cells(joints[0])))
        even = len(steps) > 1 and steps[0] > 0 and np.ptp(steps) <= 1e-6 * steps[0]
        joints = joints[1:] if even else joints
    if poses and len(joints) < n:
        raise TableError(
            f"{table.path}: the columns {', '.join(table.header[i] for i in poses)} are poses of "
            "the tool. Joint angles are needed, as the encoders show them: export those, or name "
            "their columns with --angles."
        )
    return [joints] * (len(joints) == n)


def columns_of_numbers(table, taken=()):
    """Columns that hold numbers only, and by their names neither times nor other quantities."""
    rows = [cells for _, cells in table.first[:20]]
    return [
        i
        for i, name in enumerate(table.names)
        if i not in taken
        and not OF_TIMES.fullmatch(name)
        and not _OTHER_QUANTITY.search(name)
        and not _EXTERNAL.fullmatch(name)
        and all(table.has_number(cells, [i]) for cells in rows)
    ]


def _pose_columns(table):
    """Columns of poses of the tool: x, y and z, and what stands for its direction beside."""
    columns = {i for _, axes in coordinates(table.names) for i in axes}
    last = {re.split(r"[\W_]+", name)[-1]: i for i, name in enumerate(table.names)}
    for group in _ORIENTATIONS if columns else ():
        if last.keys() >= {*group}:
            columns |= {last[one] for one in group}
    return sorted(columns)


def coordinates(names):
    """Yield columns of x, y and z, whose names differ in that only, and the letter before x.

    A fourth column may be of w.
    """
    for name in dict.fromkeys(names):
        for k in (k for k, letter in enumerate(name) if letter == "x"):
            axes = [name[:k] + letter + name[k + 1 :] for letter in "xyzw"]
            if {*axes[:3]} <= {*names}:
                yield name[k - 1 : k], [names.index(axis) for axis in axes if axis in names]


def external_axes(table, used):
    """Columns by name of external axes that move and are not used; a note tells of each."""
    column_of: dict[str, int] = {}
    for i, name in enumerate(table.names):
        if i in used or not _EXTERNAL.fullmatch(name):
            continue
        values = table.source.numbers(table.cells(i))
        if np.ptp(values) > _MOVES * max(1.0, float(np.abs(values).max())):
            column_of[table.header[i]] = i
            table.notes.append(
                f"Column {table.header[i]} varies by {np.ptp(values):.4g}: an external axis "
                "moves the base, and the model of the arm has none. Measure with this axis at "
                "rest, or take its movement out of the points."
            )
    return column_of


def _by_names_of_joints(table, names, joint_names):
    """One column for each joint, whose name holds that of the joint; None of others.

    As they are, else behind what robots of several arms put before them: ``left_elbow_joint``.
    """
    headers = [header.lower() for header in table.header]  # with units, such as the s of times
    for before in ("a-z0-9_", "a-z0-9"):
        columns = []
        for joint in map(str.lower, joint_names):
            word = r"[\W_]*".join(map(re.escape, joint.removesuffix("_joint").split("_")))
            pattern = re.compile(rf"(?<![{before}]){word}(?![a-z0-9])")
            fitting = [i for i, name in enumerate(names) if name == joint]
            for texts in (names, headers):
                fitting = fitting or [i for i, text in enumerate(texts) if pattern.search(text)]
            columns.append(_measured_angles(table, fitting))
        if len({one[0] for one in columns if len(one) == 1}) == len(joint_names):
            return [column for (column,) in columns]
    return None


def _joint_states(table, n):
    """Columns of positions of JointState messages, with the joints' names in cells of each row."""
    names, positions = table.fields("name"), table.fields("position")
    cells = {positions[k]: table.cells(i) for k, i in names.items() if k in positions}
    if len(cells) < n or table.source.count(chain(*cells.values())):
        return {}
    if any(len(set(own)) != 1 for own in cells.values()):
        raise TableError(f"{table.path}: the names of the joints differ from row to row.")
    return {i: str(own[0]).lower() for i, own in cells.items()}


def _series(table, names, n):
    """Series of n columns numbered from 0 or 1, such as q1 to q6, that may be the angles."""
    series: dict[tuple[str, str], dict[int, int]] = {}
    for i, name in enumerate(names):
        match = re.fullmatch(r"(.*?)[\s_.\[-]*(\d+)(\D*)", name)
        if match:
            series.setdefault((match[1], match[3]), {})[int(match[2])] = i
    fitting = [
        [numbered[k] for k in sorted(numbered)]
        for numbered in series.values()
        if sorted(numbered) in (list(range(1, n + 1)), list(range(n)))
    ]
    first = _measured_angles(table, [columns[0] for columns in fitting])
    return [columns for columns in fitting if columns[0] in first]


def _measured_angles(table, columns):
    """Those of these columns that are angles; of measured and commanded ones, the measured."""
    columns = [i for i in columns if not _OTHER_QUANTITY.search(table.names[i])]
    for pattern in (MEASURED, re.compile("position"), _NOT_COMMANDED, _OF_JOINTS):
        wanted = [i for i in columns if pattern.search(table.names[i])]
        if len(columns) > 1 and wanted:
            columns = wanted
    return columns
