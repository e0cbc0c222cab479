"""Which columns of a table hold what: tables of names as loggers, robots and people use them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from itertools import chain

import numpy as np

from sklearn_raacmm.app._cells import TableError, without_mark

# An angle beyond two whole turns in rad is in degrees, as `Arm.forward` supposes when it warns; one
# beyond a hundred turns in degrees is an encoder's count.
_SURELY_DEGREES, _SURELY_COUNTS = 4 * np.pi, 36_000
_DEGREES = ("deg", "degree", "degrees", "°", "º", "grad")
_RADIANS = ("rad", "radian", "radians")
_UNIT = re.compile(
    r"^(.*?)\s*[\[(/]\s*([^\])/]+?)\s*[\])]?$|^(.*?)[\s_]+(deg|rad|mm|m)$|^(.*?)(°)$"
)
_POSITION_NAMES = (
    "position", "pos", "positions", "cone", "seat", "socket", "hole", "place", "placement",
    "point", "label", "group", "station", "location", "nest",
    "kegel", "messpunkt", "punkt", "ort", "stelle",
)  # fmt: skip
_NO_LABEL = re.compile(r"name\d+$|frame_id")
_TIME = re.compile(r"\d{1,4}[-./:]\d{1,2}[-./:]\d{1,4}|\d{1,2}:\d{2}")
_TIME_NAMES = re.compile(r"_*(time|timestamp|date|datetime|zeit|datum|uhrzeit|utc)(stamp)?")
# Series of other quantities than angles, of commanded angles, and of measured ones. UR writes
# target_q, actual_q, actual_qd and actual_current; JointState has position, velocity and effort.
_OTHER_QUANTITY = re.compile(
    r"velocity|speed|qdd?(?![a-z])|(?<![a-z])vel|accel|effort|torque|moment|current|strom|voltage|"
    r"temperature|temp(?![a-z])|force|tcp|mode|error|drehmoment|geschwindigkeit|header|seq|secs"
)
_COMMANDED = re.compile(r"target|command|desired|setpoint|reference|goal|soll")
_MEASURED = re.compile(r"actual|measured|encoder|feedback|(?<![a-z])ist(?![a-z])")
# Units that a format states without writing them into the file: UR RTDE guide, actual_q and
# target_q; ROS, sensor_msgs/JointState.
_KNOWN_UNITS = (
    (re.compile(r"(actual|target)_q[_.\s]*\d|field\.position|joint_?states?\W"), "rad"),
)
# Rows looked at to find text columns and the unit.
_LOOKED_AT = 200


def find_header(dialect, n_joints):
    """Names of the columns, the row they stand in (0: none), and the first rows of data."""
    above, data = [], []
    for number, cells in dialect.rows():
        n_numbers = dialect.count(cells)
        if not data and n_numbers < n_joints:
            above.append((number, without_mark(cells) or cells))
            continue
        data.append((number, cells))
        if len(data) == _LOOKED_AT:
            break
    if not data:
        raise TableError(f"{dialect.path}: no row with {n_joints} numbers was found.")
    width = len(data[0][1])
    above, damaged = _without_damaged(above, dialect, n_joints)
    data = damaged + data
    header, row = [], 0
    if above:
        row, cells = above[-1]
        texts = [cell for cell in cells if isinstance(cell, str) and cell]
        if len(above) > 1 and texts and all(_is_unit(cell) for cell in texts):
            # Units in a row of their own below the names.
            names = above[-2][1] + [""] * (len(cells) - len(above[-2][1]))
            units = cells + [""] * (len(names) - len(cells))
            cells = [
                f"{n} [{u.strip('[]()')}]" if u else n for n, u in zip(names, units, strict=True)
            ]
        while len(cells) > width and cells[-1] == "":
            cells = cells[:-1]
        if len(texts) >= n_joints or len(cells) == width:
            header = [str(cell) for cell in cells]
    if not header:
        header = _fields_of_joint_states(data[0][1], dialect, n_joints)
    header += [""] * (width - len(header))
    return [name or f"column {i}" for i, name in enumerate(header, 1)], row, data


def _fields_of_joint_states(cells, dialect, n_joints):
    """Names of the columns of JointState messages, which ROS 2 writes without any (--csv)."""
    texts = [isinstance(cell, str) and dialect.number(cell) is None and cell for cell in cells]
    marks = "".join("n" if text else "-" for text in texts)
    run = re.search(rf"n{{{n_joints},}}", marks)
    if not run:
        return []
    # The frame's name may stand before those of the joints; each field is whole or empty.
    fields, rest = ("name", "position", "velocity", "effort"), len(cells) - run.end()
    for n in (len(run[0]), len(run[0]) - 1):
        if n >= n_joints and rest in (n, 2 * n, 3 * n):
            names = [f"{field}{i}" for field in fields for i in range(n)]
            return ([""] * (run.end() - n) + names)[: len(cells)]
    return []


def _without_damaged(above, dialect, n_joints):
    """Rows down to the names, and those below: data with a fault, which is reported on reading."""
    named = 0
    for i, (_, cells) in enumerate(above):
        n_numbers = dialect.count(cells)
        n_texts = sum(isinstance(cell, str) and cell != "" for cell in cells) - n_numbers
        if n_texts >= n_joints and n_numbers == 0:
            named = i + 1
        elif named and n_numbers:
            return above[:named], above[named:]
    return above, []


def _is_unit(cell):
    return cell.strip("[]()").lower() in (*_DEGREES, *_RADIANS, "mm", "m", "s", "ms", "-", "°c")


def split_unit(name):
    """Name of a column and the unit in it: "q1 [deg]" -> "q1", "deg"."""
    name = str(name).strip()
    match = None if name.startswith("/") else _UNIT.fullmatch(name)  # a topic of ROS
    if not match:
        return name.lower(), ""
    name, unit = [part for part in match.groups() if part is not None][:2] or ("", "")
    unit = unit.strip().lower()
    unit = "deg" if unit in _DEGREES else "rad" if unit in _RADIANS else unit
    return name.strip(" _").lower(), unit


class Columns:
    """Columns of a table by their names; `notes` says what was guessed."""

    def __init__(self, dialect, n_joints):
        self.path, self.dialect, self.n_joints = dialect.path, dialect, n_joints
        self.header, self.header_row, self.rows = find_header(dialect, n_joints)
        self.names, self.units = zip(*map(split_unit, self.header), strict=True)
        self.unit = None
        where = f"header in row {self.header_row}" if self.header_row else "no header"
        self.notes = [f"{dialect}; {where}."]

    def named(self, wanted, option):
        """Column of this name, its unit left out or not; or of this number, from 1."""
        wanted = str(wanted).strip()
        for given in (self.header, self.names):
            found = [i for i, name in enumerate(given) if name.lower() == wanted.lower()]
            if len(found) == 1:
                return found[0]
            if found:
                raise TableError(
                    f"{self.path} has {len(found)} columns {wanted!r}; {option} needs one."
                )
        if wanted.isdigit() and 1 <= int(wanted) <= len(self.header):
            return int(wanted) - 1
        raise TableError(f"{self.path} has no column {wanted!r} ({option}); it has {self}.")

    def __str__(self):
        return ", ".join(self.header)

    def cells(self, column):
        """Cells of the first rows."""
        return [cells[column] for _, cells in self.rows if len(cells) > column]

    # -- joint angles -----------------------------------------------------------------------

    def find_angles(self, wanted, joint_names):
        """Columns of the joint angles in the order of the arm."""
        if wanted is not None:
            if len(wanted) != self.n_joints:
                raise TableError(
                    f"--angles names {len(wanted)} columns, the arm has {self.n_joints} joints."
                )
            return [self.named(name, "--angles") for name in wanted]
        found = self._by_names_of_joints(joint_names) or self._by_names_in_cells(joint_names)
        if found:
            shown = ", ".join(self.header[i] for i in found)
            self.notes.append(f"Joint angles, by the names of the arm's joints: {shown}.")
            return found
        fitting = self._series()
        # Columns without names are numbered by us: that says nothing.
        if len(fitting) == 1 and self.header[fitting[0][0]] != "column 1":
            first, last = (self.header[fitting[0][i]] for i in (0, -1))
            self.notes.append(f"Joint angles: {first} to {last}.")
            return fitting[0]
        numeric = [
            i
            for i in range(len(self.header))
            if not _TIME_NAMES.fullmatch(self.names[i])
            and not _OTHER_QUANTITY.search(self.names[i])
            and all(
                len(cells) > i and self.dialect.number(cells[i]) is not None
                for _, cells in self.rows[:20]
            )
        ]
        if not fitting and len(numeric) == self.n_joints:
            first, last = self.header[numeric[0]], self.header[numeric[-1]]
            self.notes.append(f"Joint angles: the columns of numbers, {first} to {last}.")
            return numeric
        example = ",".join(f"q{i}" for i in range(1, self.n_joints + 1))
        raise TableError(
            f"{self.path}: which {self.n_joints} columns hold the joint angles? Say it with "
            f"--angles {example} (names or numbers of columns); the columns are {self}."
        )

    def _by_names_of_joints(self, joint_names):
        """One column for each joint of the arm whose name holds that of the joint."""
        found = []
        for joint in joint_names or ():
            words = {joint.lower(), joint.lower().removesuffix("_joint")}
            columns = [
                i
                for i, name in enumerate(self.names)
                if any(re.search(rf"(?<![a-z0-9_]){re.escape(w)}(?![a-z0-9])", name) for w in words)
            ]
            columns = self._measured_angles(columns)
            if len(columns) != 1:
                return None
            found += columns
        return found if len(set(found)) == self.n_joints else None

    def _by_names_in_cells(self, joint_names):
        """Positions of JointState messages, whose names stand in cells of each row."""
        fields = {
            field: {int(m[1]): i for i, name in enumerate(self.names)
                    if (m := re.fullmatch(rf"(?:.*\W)?{field}[\[_.]?(\d+)\]?", name))}
            for field in ("name", "position")
        }  # fmt: skip
        names = {k: self.cells(i) for k, i in fields["name"].items() if k in fields["position"]}
        if len(names) < self.n_joints or any(
            self.dialect.number(c) is not None for c in chain(*names.values())
        ):
            return None
        if any(len(set(cells)) != 1 for cells in names.values()):
            raise TableError(f"{self.path}: the names of the joints differ from row to row.")
        self.unit = "rad"  # sensor_msgs/JointState
        in_file = {str(cells[0]).lower(): fields["position"][k] for k, cells in names.items()}
        if joint_names and all(name.lower() in in_file for name in joint_names):
            return [in_file[name.lower()] for name in joint_names]
        numbered = [re.search(r"\d+", name) for name in in_file]
        if len(in_file) == self.n_joints and all(numbered):
            order = sorted(in_file, key=lambda name: int(re.findall(r"\d+", name)[0]))
            return [in_file[name] for name in order]
        order = ", ".join(f"{self.header[i]} ({name})" for name, i in in_file.items())
        raise TableError(
            f"{self.path} names its joints, and the arm's joints have other names or none: say the "
            f"order from the base on with --angles. The columns are {order}."
        )

    def _series(self):
        """Series of columns numbered from 0 or 1, such as q1 to q6, that may be the angles."""
        series = {}
        for i, name in enumerate(self.names):
            match = re.fullmatch(r"(.*?)[\s_.\[-]*(\d+)(\D*)", name)
            if match:
                series.setdefault((match[1], match[3]), {})[int(match[2])] = i
        n = self.n_joints
        fitting = [
            [found[k] for k in sorted(found)]
            for found in series.values()
            if sorted(found) in (list(range(1, n + 1)), list(range(n)))
        ]
        first = self._measured_angles([columns[0] for columns in fitting])
        return [columns for columns in fitting if columns[0] in first]

    def _measured_angles(self, columns):
        """Those of these columns that are angles; of measured and commanded ones, the measured."""
        columns = [i for i in columns if not _OTHER_QUANTITY.search(self.names[i])]
        for wanted in (
            lambda i: _MEASURED.search(self.names[i]),
            lambda i: "position" in self.names[i],
            lambda i: not _COMMANDED.search(self.names[i]),
        ):
            if len(columns) > 1 and any(map(wanted, columns)):
                columns = [i for i in columns if wanted(i)]
        return columns

    def find_unit(self, columns):
        """Unit of the angles: from the header, the kind of columns, or their size."""
        found = {self.units[i] for i in columns}
        if len(found) == 1 and found <= {"deg", "rad"}:
            return found.pop()
        if found != {""}:
            told = ", ".join(self.header[i] for i in columns)
            raise TableError(
                f"{self.path}: the angles must all be in degrees or all in radians, but the "
                f"columns are {told}; say it with --unit deg or --unit rad if these are wrong."
            )
        if self.unit is not None:
            return self.unit
        values = (self.dialect.number(cell) for i in columns for cell in self.cells(i))
        largest = max(chain([0.0], (abs(value) for value in values if value is not None)))
        if largest > _SURELY_COUNTS:
            raise TableError(
                f"{self.path}: the angles reach {largest:.6g}. If they are counts of the encoders, "
                "say how many make a turn with --counts-per-turn N."
            )
        if largest > _SURELY_DEGREES:
            self.notes.append(f"Angles in degrees: they reach {largest:.4g}.")
            return "deg"
        for pattern, unit in _KNOWN_UNITS:
            if all(pattern.search(self.names[i]) for i in columns):
                self.notes.append(f"Angles in {unit}, as such columns are defined.")
                return unit
        raise TableError(
            f"{self.path}: are the angles in degrees or in radians? They reach {largest:.4g} in "
            "the first rows, and the header does not say; say it with --unit deg or --unit rad."
        )

    # -- labels -----------------------------------------------------------------------------

    def find_position(self, wanted, taken):
        """Column of the label of the position."""
        if wanted is not None:
            return self.named(wanted, "--position")
        called = [i for i in self.labelled if i not in taken]
        if not called:
            free = [i for i, name in enumerate(self.names) if not _TIME_NAMES.fullmatch(name)]
            free = [i for i in free if i not in taken and not _NO_LABEL.search(self.names[i])]
            columns = {i: self.cells(i) for i in free}
            # A label that is missing here and there is a fault to be told later.
            text = {i: [self._is_label(c) for c in columns[i] if c != ""] for i in free}
            called = [i for i in free if text[i] and all(text[i])]
            whole = [i for i in called if len(text[i]) == len(columns[i])]
            called = whole or called
        if len(called) == 1:
            self.notes.append(f"Labels of the positions: {self.header[called[0]]}.")
            return called[0]
        raise TableError(
            f"{self.path}: which column holds the label of the position? Say it with --position "
            f"NAME; the columns are {self}."
        )

    @property
    def labelled(self):
        """Columns whose names are those of labels."""
        return [i for i, name in enumerate(self.names) if name in _POSITION_NAMES]

    def _is_label(self, cell):
        is_text = isinstance(cell, str) and self.dialect.number(cell) is None
        return is_text and not _TIME.search(cell)
