"""Tables of joint angles: rows of numbers and labels, and what is wrong where."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.app._columns import Columns
from sklearn_raacmm.app._joints import (
    MEASURED,
    columns_of_numbers,
    coordinates,
    external_axes,
    find_joints,
)
from sklearn_raacmm.app._records import NUMBER
from sklearn_raacmm.app._sources import BLOCK_ROWS, TableError
from sklearn_raacmm.app._units import find_unit, mm_of_slide
from sklearn_raacmm.arm import JointTypes
from sklearn_raacmm.utils import Floats

# Cells that a table may hold to be read by columns: numbers, and words that no writer of cells
# puts into quotation marks.
_PLAIN_CELL = rf"(?:{NUMBER}|[^\W_](?:[\w .:/+-]*[\w.:/+-])?)?"


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of a table.

    Attributes
    ----------
    angles : ndarray of shape (n, n_joints)
        In `angle_unit`.
    angle_unit : {"rad", "deg"}
    positions : ndarray of shape (n,) of str, or None
    points : ndarray of shape (n, 3) or None
        In mm.
    rows : ndarray of shape (n,)
        Numbers of the rows in the file, from 1.
    notes : list of str
        What was guessed, one sentence each.
    others : dict of str to ndarray of shape (n,)
        Further columns by name: numbers, or text where one cell is no number.
    joint_types : str
        Those of the arm: what slides is in mm.
    """

    angles: Floats
    angle_unit: str
    positions: Any
    points: Floats | None
    rows: np.ndarray
    notes: list[str] = field(default_factory=list)
    others: dict[str, np.ndarray] = field(default_factory=dict)
    joint_types: str = ""


def read_table(
    path: str | PathLike[str],
    n_joints: int,
    *,
    angles: list[str] | None = None,
    position: str | None = None,
    points: list[str] | str | PathLike[str] | None = None,
    angle_unit: str | None = None,
    labelled: bool = True,
    joint_names: Sequence[str] = (),
    counts_per_turn: ArrayLike | None = None,
    sheet: str | None = None,
    others: Iterable[str] = (),
    joint_types: str = "",
) -> Table:
    r"""Read a table of joint angles as a logger, a robot or a spreadsheet program wrote it.

    Separator, decimal sign, encoding, lines above the header and columns are found; what was
    guessed is in the notes. See the page "The command raacmm" for the kinds of files.

    Parameters
    ----------
    path : str or path-like
        Text, a spreadsheet (.xlsx, with openpyxl), arrays (.npy, .npz, .mat) or a robot's program.
    n_joints : int
        Number of joints of the arm.
    angles : list of str, default=None
        Names of the columns of the joint angles. None: the names of the arm's joints, or columns
        numbered from 0 or 1, such as q1 to q6.
    position : str, default=None
        Name of the column of the positions' labels. None: one called so, or the only one of text;
        with `points` one called so, or none. Where each row has a name of its own, these without
        their last number, P1 of P1_1 and P1_2, where there are several of each.
    points : list of three str or path-like, default=None
        Names of the columns of a tracker's x, y and z; or a file of points, which are matched by
        their names, or else by their order. None: there are none.
    angle_unit : {"rad", "deg"}, default=None
        None: from the header, such as "q1 [deg]", or degrees if an angle is beyond two turns.
        Angles in gon, mrad, arc seconds or turns are converted.
    labelled : bool, default=True
        Whether positions are needed.
    joint_names : sequence of str, default=()
        Names of the arm's joints: columns of these names may stand in any order.
    counts_per_turn : float or array-like of shape (n_joints,), default=None
        Counts of the encoders in a turn, where the table has counts.
    sheet : str, default=None
        Name or number of a spreadsheet's sheet. None: the first with such rows.
    others : iterable of str, default=()
        Names of further columns to hand on, such as a temperature.
    joint_types : str, default=""
        Those of an arm with joints that slide. Their columns have the names of its joints, or of an
        external axis, such as E1 or rail, and their unit in the header, such as "E1 [mm]".

    Returns
    -------
    Table
        Angles, labels, points and row numbers.

    Raises
    ------
    TableError
        If something cannot be decided, or is wrong: the sentence names the row and the column.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from sklearn_raacmm.app import read_table
    >>> text = "cone;q1 [deg];q2 [deg]\nA;12,5;-3\nA;13;-2,5\n"
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder, "log.csv")
    ...     _ = path.write_text(text)
    ...     table = read_table(path, 2)
    >>> table.angle_unit, table.positions.tolist(), table.angles.tolist()
    ('deg', ['A', 'A'], [[12.5, -3.0], [13.0, -2.5]])
    """
    return Layout(**locals()).read()


class Layout(Columns):
    """Where a file holds what: found once, then rows are read block by block.

    Parameters as for `read_table`.
    """

    def __init__(
        self, path, n_joints, *, angles=None, position=None, points=None, angle_unit=None,
        labelled=True, joint_names=(), counts_per_turn=None, sheet=None, others=(), needed=True,
        joint_types="",
    ):  # fmt: skip
        super().__init__(path, n_joints, sheet)
        self.points_file = points if isinstance(points, str | PathLike) else None
        named: Any = () if self.points_file else points or ()
        self.point_columns = [self.column(name, "--points") for name in named]
        self.others = {name: self.column(name, "others") for name in others}
        named = None if position is None else self.column(position, "--position")
        taken = {*self.point_columns, *self.others.values(), named}
        self.types, slides = joint_types, JointTypes(joint_types).slides
        self.angle_columns = find_joints(self, angles, joint_names, taken, slides)
        self.labelled, self.needed = labelled and points is None, needed
        self.position_column = named if labelled else None
        # A tracker's points need no labels: those that are there are taken.
        if labelled and named is None and (not points or self.label_columns):
            taken = {*self.angle_columns, *self.point_columns}
            self.position_column = self.find_position(taken, needed)
        factor: float | np.ndarray = 1.0
        turning = [c for i, c in enumerate(self.angle_columns) if i not in slides]
        if counts_per_turn is not None:
            turns = np.asarray(counts_per_turn, dtype=float)
            if not (turns.shape in ((), (1,), (n_joints,)) and np.all(turns > 0)):
                each = f"one for each of {n_joints} joints"
                raise TableError(f"--counts-per-turn needs a positive number, or {each}.")
            angle_unit, factor = "deg", 360.0 / turns
        elif turning and not angle_unit:
            angle_unit, factor = find_unit(self, turning)
        self.angle_unit, self.factor = angle_unit or "rad", np.full(n_joints, factor)
        self.factor[slides] = [mm_of_slide(self, self.angle_columns[i]) for i in slides]
        used = {*self.angle_columns, *self.point_columns, *self.others.values()}
        used.add(self.position_column)
        self.external = external_axes(self, used)
        if unused := [name for i, name in enumerate(self.header) if i not in used]:
            self.notes.append(named_first("Columns not used", unused))

    def read(self):
        """All rows as one table."""
        rows, points = list(self.rows(self.angle_columns)), None
        if self.points_file:
            rows, points = self._with_points(rows)
        table = self._table(rows, points)
        labels, by_tracker = table.positions, table.points is not None
        # A name for each row is the pose's, where places are found without labels.
        of_each = labels is not None and len(set(labels.tolist())) == len(labels) > 1
        places = _places_in(labels) if of_each and not by_tracker else None
        if of_each and (by_tracker or places is not None or not self.needed):
            column: Any = self.position_column
            name = self.header[column]
            labelled = f"Labels of the positions: {name}."
            said = f"Column {name} names each row: it says nothing of positions."
            if places is not None:
                said = f"Labels of the positions: {name}, without the last number."
            self.notes[:] = [said if note == labelled else note for note in self.notes]
            table = replace(table, positions=places)
        counts = Counter(() if table.positions is None else table.positions.tolist())
        for label in sorted(one for one in counts if self.labelled and counts[one] == 1):
            near = get_close_matches(label, [one for one in counts if counts[one] > 1], 1)
            hint = f" Was {near[0]!r} meant?" if near else ""
            row = f"row {table.rows[table.positions == label][0]}"
            raise TableError(
                f"{self.path}: {row}: the position {label!r} is in this row only.{hint}"
            )
        return table

    def blocks(self, n_rows):
        """Yield tables of at most so many rows, and their cells as they are in the file.

        Of a table of nothing but plain cells these are whole lines, which is faster.
        """
        if not self.is_plain():
            rows = self.rows(self.angle_columns)
            while block := list(islice(rows, n_rows)):
                yield self._table(block), [cells for _, cells in block]
            return
        with open(self.path, encoding=self.source.encoding, newline="") as file:
            lines = enumerate(islice(file, self.header_row, None), self.header_row + 1)
            while block := [(i, line.rstrip("\r\n")) for i, line in islice(lines, n_rows)]:
                rows = [(i, line.split(self.source.separator)) for i, line in block]
                yield self._table(rows), [line for _, line in block]

    def is_plain(self):
        """Whether all cells are plain and nothing but rows stands below the header.

        Plain are numbers with a decimal point, and words in columns that hold no angles. All lines
        are looked at before the first is handed on: a pattern does so faster than cells are parted.
        """
        source, is_tracked = self.source, self.position_column is not None or self.point_columns
        is_other = source.table is not None or source.separator is None or source.decimal != "."
        if is_other or is_tracked or self.sections or self.width != len(self.header):
            return False
        cells = [NUMBER if i in self.angle_columns else _PLAIN_CELL for i in range(self.width)]
        line = re.compile(rf"{re.escape(str(source.separator)).join(cells)}(?:\r?\n|\Z)")
        with open(self.path, encoding=source.encoding, newline="") as file:
            lines = islice(file, self.header_row, None)
            blocks = iter(lambda: "".join(islice(lines, BLOCK_ROWS)), "")
            return not any(line.sub("", text) for text in blocks)

    def _table(self, rows, points=None):
        """The table of some rows."""
        column = self.position_column
        positions = None if column is None else self.labels(rows, column)
        if self.point_columns:
            points = self.points(rows, self.point_columns)
        angles, others = self.factor * self.numbers(rows, self.angle_columns), {}
        for name, i in self.others.items():
            given = [cells[i] for _, cells in rows]
            values = self.source.numbers(given)
            others[name] = np.array(list(map(str, given))) if np.isnan(values).any() else values
        numbers = np.array([number for number, _ in rows])
        read = positions, points, numbers, self.notes, others, self.types
        return Table(angles, self.angle_unit, *read)

    def _with_points(self, rows):
        """Rows and points of another file: matched by their names, or else by their order.

        Names must tell all rows and all points apart, and most of the fewer must have a partner.
        """
        path, wanted = split_points(self.points_file)
        names, points, notes = read_points(path, wanted)
        self.notes.extend(notes)
        at, matched, column = {name: i for i, name in enumerate(names)}, {}, -1
        for i in (i for i in range(len(self.header)) if i not in self.angle_columns):
            own = {text_of_label(cells[i]): k for k, (_, cells) in enumerate(rows)}
            found = {name: k for name, k in own.items() if name in at}
            if len(own) == len(rows) and len(found) > len(matched):
                matched, column = found, i
        if len(at) == len(names) and 2 * len(matched) > min(len(rows), len(names)):
            kept = {*matched.values()}
            lost = [str(cells[column]) for k, (_, cells) in enumerate(rows) if k not in kept]
            self.notes.append(
                f"Points of {path}, matched by the column {self.header[column]}."
                + named_first(" Rows without a point, left out", lost)
                + named_first(" Points without a row", [one for one in names if one not in matched])
            )
            return [rows[k] for k in matched.values()], points[[at[name] for name in matched]]
        if len(points) != len(rows):
            raise TableError(
                f"{path} holds {len(points)} points, {self.path} {len(rows)} rows, "
                "and no column of names says which belong together."
            )
        self.notes.append(f"Points of {path}, in the order of the rows.")
        return rows, points


def _places_in(labels):
    """Labels without the last number, P1 of P1_1 and P1_2; None unless each then has some rows.

    A Fanuc writes the number of a point before its name, 1:"P1".
    """
    own = [re.sub(r'^\d+\s*:\s*"(.+)"', r"\1", label) for label in labels.tolist()]
    for places in (own, [re.sub(r"[\W_]*\d+\W*$", "", label) for label in own]):
        counts = Counter(places)
        if len(counts) > 1 and min(counts.values()) > 1:
            return np.array(places)
    return None


# -- points of a tracker --------------------------------------------------------------------------


# Names that surveyors and trackers have for x, y and z.
_COORDINATES = (
    ("x", "east", "easting", "e", "rechtswert", "r"),
    ("y", "north", "northing", "n", "hochwert"),
    ("z", "elevation", "height", "h", "up", "elev", "höhe", "hoehe", "u"),
)
# Names of a column of names, the surest first.
_NAMES = (
    "point name", "pointid", "point id", "ptid", "name", "id", "point", "target", "no", "nr", "n",
)  # fmt: skip
# Points, rows and columns that are named in a note.
_MOST_NAMED = 8


def read_points(path, wanted=None):
    """Names, [] if no column holds any; points (n, 3), mm, as trackers export them; and notes.

    The columns are `wanted`, or x, y and z by name, or else names and then three numbers in each
    row. Points without coordinates are left out.
    """
    columns = Columns(path, 3)
    axes = [
        i for i in range(columns.width) if {str(c).lower() for c in columns.cells(i)} == {*"xyz"}
    ]
    if axes and not wanted:
        return *_points_by_coordinate(columns, axes[0]), columns.notes[1:]
    xyz = _columns_of_points(columns, wanted)
    every = list(columns.rows(xyz))
    rows = [row for row in every if any(row[1][i] != "" for i in xyz)]
    if len(rows) < len(every):
        lost = len(every) - len(rows)
        columns.note(f"Points of {path} without coordinates, left out: {lost}.")
    # The names stand before the points, or in a column that is called so, and tell them apart.
    called = [columns.names.index(name) for name in _NAMES if name in columns.names]
    beside = [i for i in (xyz[0] - 1, *columns.label_columns, *called) if i >= 0 and i not in xyz]
    named = [[text_of_label(cells[i]) for _, cells in rows] for i in beside]
    names = max(named, key=lambda names: len({*names}) == len(names), default=[])
    return names, columns.points(rows, xyz), columns.notes[1:]


def _points_by_coordinate(columns, axis):
    """Names and points of a table that has a row for each coordinate, as reports have them."""
    numbers = columns_of_numbers(columns)
    value = ([i for i in numbers if MEASURED.search(columns.names[i])] or numbers)[0]
    rows = list(columns.rows([value]))
    names = [text_of_label(cells[axis - 1]) for _, cells in rows]
    if [str(cells[axis]).lower() for _, cells in rows] != [*"xyz"] * (len(rows) // 3):
        raise TableError(f"{columns.path}: a point needs its x, y and z in rows one after another.")
    columns.notes.append(f"Coordinates of {columns.path}: {columns.header[value]}.")
    return names[::3] if axis else [], columns.points(rows, [value]).reshape(-1, 3)


def _columns_of_points(columns, wanted):
    """Columns of x, y and z."""
    if wanted:
        return [columns.column(name, "--points") for name in wanted]
    at = {name: columns.names.index(name) for name in columns.names}
    by_name = [[at[name] for name in words if name in at] for words in _COORDINATES]
    if all(by_name):
        return [axes[0] for axes in by_name]
    triples = [axes[:3] for before, axes in coordinates(columns.names) if before not in ("r", "q")]
    measured = [axes for axes in triples if MEASURED.search(columns.names[axes[0]])]
    triples = measured if len(triples) > 1 and measured else triples
    if len(triples) == 1:
        return triples[0]
    # Names, then x, y, z, then what else is known of a point.
    _, cells = columns.first[0]
    axes = [i for i, cell in enumerate(cells) if columns.source.number(cell) is not None]
    axes = [i for i in axes if i not in columns.label_columns and columns.names[i] not in _NAMES]
    axes = axes[len(axes) == 4 and axes[0] == 0 :][:3]
    if len(axes) != 3 or len(triples) > 1:
        raise columns.unclear("which columns are x, y and z", f"--points {columns.path.name}:X,Y,Z")
    return axes


def split_points(source):
    """File of points, and the names of its columns of ``FILE:X,Y,Z`` or None."""
    path, _, names = str(source).rpartition(":")
    if path and Path(path).is_file() and not Path(source).is_file():
        return Path(path), names.split(",")
    return Path(source), None


def text_of_label(cell):
    """Label in a cell, the same whether it was written 7, 7.0 or by a spreadsheet."""
    text = str(cell).strip()
    try:
        number = float(text)
    except ValueError:
        return text
    return str(int(number)) if number.is_integer() else repr(number)


def named_first(what, names):
    """A sentence that names these, the first of them if they are many; "" without any."""
    if not names:
        return ""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return f"{what}: {', '.join(names[:_MOST_NAMED])}{more}."
