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
from sklearn_raacmm.app._joints import MEASURED, columns_of_numbers, external_axes, find_joints
from sklearn_raacmm.app._records import NUMBER
from sklearn_raacmm.app._sources import BLOCK_ROWS, TableError
from sklearn_raacmm.app._units import find_unit, mm_of_slide
from sklearn_raacmm.arm import slides_of
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
        taken = {*self.point_columns, *self.others.values()}
        if position is not None:
            taken.add(self.column(position, "--position"))
        self.types, slides = joint_types, slides_of(joint_types)
        self.angle_columns = find_joints(self, angles, joint_names, taken, slides)
        self.labelled, self.position_column, self.needed = labelled and points is None, None, needed
        # A tracker's points need no labels: those that are there are taken.
        if labelled and (not points or position is not None or self.label_columns):
            taken = {*self.angle_columns, *self.point_columns}
            self.position_column = self.find_position(position, taken, needed)
        self.angle_unit, self.factor, self.turns = angle_unit or "rad", 1.0, np.ones(1)
        turning = [c for i, c in enumerate(self.angle_columns) if i not in slides]
        if counts_per_turn is not None:
            self.turns = np.asarray(counts_per_turn, dtype=float)
            self.angle_unit, self.factor = "deg", 360.0
        elif turning and not angle_unit:
            self.angle_unit, self.factor = find_unit(self, turning)
        if not (self.turns.shape in ((), (1,), (n_joints,)) and np.all(self.turns > 0)):
            each = f"one for each of {n_joints} joints"
            raise TableError(f"--counts-per-turn needs a positive number, or {each}.")
        if slides:
            unit = np.broadcast_to(self.factor / self.turns, n_joints).copy()
            unit[slides] = [mm_of_slide(self, self.angle_columns[i]) for i in slides]
            self.factor, self.turns = unit, np.ones(1)
        used = {*self.angle_columns, *self.point_columns, *self.others.values()}
        used.add(self.position_column)
        self.external = external_axes(self, used)
        if unused := [name for i, name in enumerate(self.header) if i not in used]:
            self.notes.append(named_first("Columns not used", unused))

    def read(self):
        """All rows as one table."""
        table = self._table(list(self.rows(self.angle_columns)))
        labels, by_tracker = table.positions, self.points_file or self.point_columns
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
        return _with_points(self, table, self.points_file) if self.points_file else table

    def blocks(self, n_rows):
        """Yield tables of at most so many rows, and their cells as they are in the file."""
        is_plain = self.position_column is None and not self.point_columns
        lines = self.plain_lines() if is_plain else None
        if lines is None:
            rows = self.rows(self.angle_columns)
            while block := list(islice(rows, n_rows)):
                yield self._table(block), [cells for _, cells in block]
            return
        number, separator = self.header_row + 1, str(self.source.separator)
        while block := list(islice(lines, n_rows)):
            rows = [(i, line.split(separator)) for i, line in enumerate(block, number)]
            yield self._table(rows), block
            number += len(block)

    def plain_lines(self):
        """Lines of data, without their ends, of a table of nothing but plain cells; None of others.

        Plain are numbers with a decimal point, and words in columns that hold no angles. All lines
        are looked at before the first is handed on: a pattern does so faster than cells are parted.
        """
        source = self.source
        is_other = source.table is not None or source.separator is None or source.decimal != "."
        if is_other or self.sections or self.width != len(self.header):
            return None
        of_angles = [i in self.angle_columns for i in range(self.width)]
        cells = [NUMBER if own else _PLAIN_CELL for own in of_angles]
        separator = re.escape(str(source.separator))
        line = re.compile(rf"{separator.join(cells)}(?:\r?\n|\Z)")
        with open(source.path, encoding=source.encoding, newline="") as file:
            next(islice(file, self.header_row, self.header_row), None)
            while text := "".join(islice(file, BLOCK_ROWS)):
                if line.sub("", text):
                    return None
        return self._lines()

    def _lines(self):
        with open(self.source.path, encoding=self.source.encoding, newline="") as file:
            for line in islice(file, self.header_row, None):
                yield line.rstrip("\r\n")

    def _table(self, rows):
        """The table of some rows."""
        positions = points = None
        if self.position_column is not None:
            positions = self.labels(rows, self.position_column)
        if self.point_columns:
            points = self.points(rows, self.point_columns)
        angles = self.factor * self.numbers(rows, self.angle_columns) / self.turns
        others = {}
        for name, i in self.others.items():
            given = [cells[i] for _, cells in rows]
            values = self.source.numbers(given)
            others[name] = np.array(list(map(str, given))) if np.isnan(values).any() else values
        numbers = np.array([number for number, _ in rows])
        read = positions, points, numbers, self.notes, others, self.types
        return Table(angles, self.angle_unit, *read)


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
    """Names, None if no column holds any; points (n, 3), mm, as trackers export them; and notes.

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
    rows = list(columns.rows(xyz))
    notes = []
    if empty := [cells for _, cells in rows if all(cells[i] == "" for i in xyz)]:
        notes.append(f"Points of {path} without coordinates, left out: {len(empty)}.")
        rows = [row for row in rows if row[1] not in empty]
    points = columns.points(rows, xyz)
    # The names stand before the points, or in a column that is called so, and tell them apart.
    called = [columns.names.index(name) for name in _NAMES if name in columns.names]
    names = None
    for i in [xyz[0] - 1, *columns.label_columns, *called]:
        if i >= 0 and i not in xyz:
            own = [text_of_label(cells[i]) for _, cells in rows]
            names = own if names is None or len(set(names)) < len(set(own)) == len(own) else names
    return names, points, notes + columns.notes[1:]


def _points_by_coordinate(columns, axis):
    """Names and points of a table that has a row for each coordinate, as reports have them."""
    numbers = columns_of_numbers(columns)
    value = ([i for i in numbers if MEASURED.search(columns.names[i])] or numbers)[0]
    rows = list(columns.rows([value]))
    names = [text_of_label(cells[axis - 1]) for _, cells in rows]
    if [str(cells[axis]).lower() for _, cells in rows] != [*"xyz"] * (len(rows) // 3):
        raise TableError(f"{columns.path}: a point needs its x, y and z in rows one after another.")
    columns.notes.append(f"Coordinates of {columns.path}: {columns.header[value]}.")
    return names[::3] if axis else None, columns.points(rows, [value]).reshape(-1, 3)


def _columns_of_points(columns, wanted):
    """Columns of x, y and z."""
    if wanted:
        return [columns.column(name, "--points") for name in wanted]
    at = {name: columns.names.index(name) for name in columns.names}
    by_name = [[at[name] for name in words if name in at] for words in _COORDINATES]
    if all(by_name):
        return [axes[0] for axes in by_name]
    likewise = [
        [name.replace("x", c, 1) for c in "xyz"] for name in at if re.search("(?<![rq])x", name)
    ]
    triples = [[at[name] for name in three] for three in likewise if at.keys() >= set(three)]
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


def _with_points(layout, table, source):
    """The table with points of another file: matched by their names, or else by their order."""
    path, wanted = split_points(source)
    names, points, notes = read_points(path, wanted)
    table.notes.extend(notes)
    cells = [cells for _, cells in layout.rows(layout.angle_columns)]
    kept, order, column = _match(layout, cells, names)
    if len(kept):
        lost = np.delete(np.arange(len(cells)), kept)
        spare = np.delete(np.arange(len(points)), order)
        table.notes.append(
            f"Points of {path}, matched by the column {layout.header[column]}."
            + named_first(" Rows without a point, left out", [str(cells[i][column]) for i in lost])
            + named_first(" Points without a row", [list(names or ())[i] for i in spare])
        )
        parts = {name: getattr(table, name)[kept] for name in ("angles", "rows")}
        others = {name: values[kept] for name, values in table.others.items()}
        positions = None if table.positions is None else table.positions[kept]
        return replace(table, **parts, others=others, positions=positions, points=points[order])
    if len(points) != len(table.angles):
        raise TableError(
            f"{path} holds {len(points)} points, {layout.path} {len(table.angles)} rows, "
            "and no column of names says which belong together."
        )
    table.notes.append(f"Points of {path}, in the order of the rows.")
    return replace(table, points=points)


def _match(layout, cells, names):
    """Rows whose name is one of a point, these points, and the column of the names.

    Names must tell all rows and all points apart, and most of the fewer must have a partner.
    """
    row_of_name: dict[str, int] = {name: i for i, name in enumerate(names or ())}
    best: tuple[list[int], list[int], int] = ([], [], -1)
    for column in range(len(layout.header)):
        own = [text_of_label(row[column]) for row in cells]
        if column in layout.angle_columns or len(set(own)) < len(own):
            continue
        kept = [i for i, name in enumerate(own) if name in row_of_name]
        if len(kept) > len(best[0]):
            best = kept, [row_of_name[own[i]] for i in kept], column
    enough = 2 * len(best[0]) > min(len(cells), len(names or ()))
    return best if enough and len(row_of_name) == len(names or ()) else ([], [], -1)


def named_first(what, names):
    """A sentence that names these, the first of them if they are many; "" without any."""
    if not names:
        return ""
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return f"{what}: {', '.join(names[:_MOST_NAMED])}{more}."
