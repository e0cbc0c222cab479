"""Tables of joint angles: rows of numbers and labels, and what is wrong where."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.app._cells import Dialect, TableError, without_mark
from sklearn_raacmm.app._columns import Columns, find_header, split_unit
from sklearn_raacmm.app._sources import find_source

_MM_PER_UNIT = {"": 1.0, "mm": 1.0, "m": 1000.0, "in": 25.4, "inch": 25.4, "inches": 25.4}


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
    """

    angles: np.ndarray
    angle_unit: str
    positions: Any
    points: np.ndarray | None
    rows: np.ndarray
    notes: list[Any] = field(default_factory=list)
    others: dict[str, Any] = field(default_factory=dict)


def read_table(
    path: str | PathLike[str],
    n_joints: int,
    *,
    angles: list[str] | None = None,
    position: str | None = None,
    points: list[Any] | str | PathLike[str] | None = None,
    angle_unit: str | None = None,
    labelled: bool = True,
    joint_names: Sequence[Any] = (),
    counts_per_turn: ArrayLike | None = None,
    sheet: str | None = None,
    others: Iterable[str] = (),
) -> Table:
    r"""Read a table of joint angles as a logger, a robot or a spreadsheet program wrote it.

    Separator, decimal sign, encoding, lines above the header and columns are found; what was
    guessed is in the notes. See the page "The command raacmm" for the kinds of files.

    Parameters
    ----------
    path : str or path-like
        Text, a spreadsheet (.xlsx, with openpyxl), .parquet or .jsonl (with pandas), or a robot's
        program.
    n_joints : int
        Number of joints of the arm.
    angles : list of str, default=None
        Names of the columns of the joint angles. None: those of the arm's joints, or columns
        numbered from 0 or 1, such as q1 to q6.
    position : str, default=None
        Name of the column of the positions' labels. None: one called so, or the only one of text;
        with `points` one called so, or none.
    points : list of three str or path-like, default=None
        Names of the columns of a tracker's x, y and z; or a file of points, which are matched by
        their names, or else by their order. None: there are none.
    angle_unit : {"rad", "deg"}, default=None
        None: from the header, such as "q1 [deg]", or degrees if an angle is beyond two turns.
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

    Returns
    -------
    Table
        Angles, labels, points and row numbers.

    Raises
    ------
    TableError
        If something cannot be told, or is wrong: the sentence has the row and the column.

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
    layout = find_layout(
        path, n_joints, angles=angles, position=position, points=points, angle_unit=angle_unit,
        labelled=labelled, joint_names=joint_names, counts_per_turn=counts_per_turn, sheet=sheet,
        others=others,
    )  # fmt: skip
    blocks = list(layout.blocks(100_000))
    parts = ("angles", "positions", "points", "rows")
    whole: dict[str, Any] = {
        part: _joined([getattr(block, part) for block in blocks]) for part in parts
    }
    found = {name: _joined([block.others[name] for block in blocks]) for name in layout.others}
    table = Table(**whole, angle_unit=layout.angle_unit, notes=layout.notes, others=found)
    if isinstance(points, str | PathLike):
        return _with_points(path, table, layout, points)
    if labelled and points is None:
        _refuse_lonely_labels(path, table)
    return table


def _joined(parts):
    return None if parts[0] is None else np.concatenate(parts)


def _refuse_lonely_labels(path, table):
    labels, first, counts = np.unique(table.positions, return_index=True, return_counts=True)
    several = labels[counts > 1].tolist()
    for label, row in zip(labels[counts == 1].tolist(), first[counts == 1], strict=True):
        near = get_close_matches(label, several, 1)
        hint = f" Was {near[0]!r} meant?" if near else ""
        raise TableError(
            f"{path}: row {table.rows[row]}: the position {label!r} occurs in this row only.{hint}"
        )


# -- points of a tracker in a file of their own ---------------------------------------------------


def read_points(path):
    """Names, None if no column holds any, and points (n, 3), mm, as trackers export them.

    The columns are x, y and z by name, or else names and then three numbers in each row.
    """
    dialect = find_source(path, 3)
    header, header_row, rows = find_header(dialect, 3)
    names, units = zip(*map(split_unit, header), strict=True)
    number = [dialect.number(cell) is not None for cell in rows[0][1]]
    if {"x", "y", "z"} <= set(names):
        columns = [names.index(name) for name in "xyz"]
    else:  # names, then x, y, z, then what else is known of a point
        columns = [i for i, is_number in enumerate(number) if is_number]
        columns = columns[len(columns) == 4 and columns[0] == 0 :][:3]
    if len(columns) != 3:
        raise TableError(f"{path}: which columns are x, y and z? It has {', '.join(header)}.")
    unit = {units[i] for i in columns}
    if len(unit) != 1 or not unit <= set(_MM_PER_UNIT):
        raise TableError(f"{path}: the points are in {', '.join(sorted(unit))}, not in mm.")
    before = [i for i in range(len(header)) if i < columns[0]]
    layout = Layout(
        dialect, header, header_row, columns, before[-1] if before else None, [], "",
        _MM_PER_UNIT[unit.pop()], {}, [],
    )  # fmt: skip
    blocks = list(layout.blocks(100_000))
    labels = None if not before else [str(n) for block in blocks for n in block.positions]
    return labels, np.concatenate([block.angles for block in blocks]) * layout.point_factor


def _with_points(path, table, layout, source):
    """The table with points of another file: matched by their names, or else by their order."""
    names, points = read_points(source)
    order, how = np.arange(len(points)), "in the order of the rows"
    place = {name: i for i, name in enumerate(names or ())}
    if len(place) == len(points):
        columns = zip(*(map(str, cells) for _, cells in layout.raw_rows()), strict=True)
        for header, cells in zip(layout.header, columns, strict=True):
            if place.keys() >= set(cells) and len(set(cells)) == len(cells):
                order = np.array([place[cell] for cell in cells])
                how = f"matched by the column {header}"
                break
    if len(order) != len(table.angles):
        raise TableError(
            f"{source} holds {len(points)} points, {path} {len(table.angles)} rows, and no column "
            "of names says which belong together."
        )
    table.notes.append(f"Points of {source}, {how}.")
    return replace(table, points=points[order])


# -- what is where --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Layout:
    """Where a file holds what: found once, then rows are read block by block."""

    dialect: Dialect
    header: list[Any]
    header_row: int
    angle_columns: list[Any]
    position_column: int | None
    point_columns: list[Any]
    angle_unit: str
    point_factor: float
    others: dict[str, Any]
    notes: list[Any]
    turns: np.ndarray | None = None

    def raw_rows(self):
        """Yield (row number, cells) of the data, each with as many cells as the header.

        Comments are left out, and rows at the end without any angle, which a note then names.
        """
        width, n_rows = len(self.header), 0
        held: list[tuple[int, Any]] = []
        for number, cells in self.dialect.rows():
            if number <= self.header_row:
                continue
            if self._has_no_angle(cells):
                if not without_mark(cells):
                    held.append((number, cells))
                continue
            for n, row in [*held, (number, cells)]:
                yield self._checked(n, row, width)
                n_rows += 1
            held = []
        if not n_rows:
            yield from (self._checked(n, row, width) for n, row in held)
        elif held:
            number, cells = held[0]
            text = next(str(cell) for cell in cells if cell != "")
            note = f"Left out from row {number} on, where the angles end: {text!r}."
            if note not in self.notes:
                self.notes.append(note)

    def _has_no_angle(self, cells):
        return not any(
            i < len(cells) and self.dialect.number(cells[i]) is not None for i in self.angle_columns
        )

    def _checked(self, number, cells, width):
        while len(cells) > width and cells[-1] == "":
            cells.pop()
        if len(cells) != width:
            hint = ""
            if self.dialect.separator == "," and len(cells) > width:
                hint = " Decimal commas between commas cannot be told apart: use semicolons."
            raise TableError(
                f"{self.dialect.path}: row {number} has {len(cells)} cells, the table "
                f"{width} columns.{hint}"
            )
        return number, cells

    def blocks(self, n_rows):
        """Yield tables of at most so many rows."""
        for block, _ in self.blocks_with_cells(n_rows):
            yield block

    def blocks_with_cells(self, n_rows):
        """Yield tables of at most so many rows, and their cells as they are in the file."""
        numbers, cells = [], []
        for number, row in self.raw_rows():
            numbers.append(number)
            cells.append(row)
            if len(cells) == n_rows:
                yield self._table(numbers, cells), cells
                numbers, cells = [], []
        if cells:
            yield self._table(numbers, cells), cells

    def _table(self, numbers, cells):
        positions = None
        if self.position_column is not None:
            positions = [str(row[self.position_column]) for row in cells]
            if "" in positions:
                name = self.header[self.position_column]
                raise self._fault(numbers[positions.index("")], name, "the label is missing")
            positions = np.array(positions)
        points = self._numbers(numbers, cells, self.point_columns)
        angles = self._numbers(numbers, cells, self.angle_columns)
        others = {}
        for name, column in self.others.items():
            values = [row[column] for row in cells]
            found = self.dialect.numbers(values)
            others[name] = np.array(list(map(str, values)) if found is None else found)
        return Table(
            angles=angles if self.turns is None else 360.0 * angles / self.turns,
            angle_unit=self.angle_unit,
            positions=positions,
            points=points * self.point_factor if self.point_columns else None,
            rows=np.array(numbers),
            others=others,
        )

    def _numbers(self, numbers, cells, columns):
        values = np.empty((len(cells), len(columns)))
        for j, column in enumerate(columns):
            found = self.dialect.numbers([row[column] for row in cells])
            values[:, j] = np.nan if found is None else found
            if not np.all(np.isfinite(values[:, j])):
                raise self._first_fault(numbers, cells, column)
        return values

    def _first_fault(self, numbers, cells, column) -> Any:
        for number, row in zip(numbers, cells, strict=True):
            cell, value = row[column], self.dialect.number(row[column])
            if value is None or not np.isfinite(value):
                what = f"{cell!r} is not a number" if cell != "" else "is empty"
                if isinstance(cell, str) and re.search(r"\d[.,]\d", cell):
                    sign = {".": "point", ",": "comma"}[self.dialect.decimal]
                    what += f" with a decimal {sign}, which the others have"
                return self._fault(number, self.header[column], what)
        return None

    def _fault(self, number, name, what):
        return TableError(f"{self.dialect.path}: row {number}, column {name!r}: {what}.")


def find_layout(
    path, n_joints, *, angles=None, position=None, points=None, angle_unit=None, labelled=True,
    joint_names=(), counts_per_turn=None, sheet=None, others=(),
):  # fmt: skip
    """Find where a file holds what; parameters as for `read_table`."""
    columns = Columns(find_source(path, n_joints, sheet), n_joints)
    angle_columns = columns.find_angles(angles, joint_names)
    is_file = isinstance(points, str | PathLike)
    named = () if is_file else points or ()
    point_columns = [columns.named(name, "--points") for name in named]
    position_column = None
    # A tracker's points need no labels: those that are there are taken.
    if labelled and not (points and position is None and not columns.labelled):
        taken = {*angle_columns, *point_columns}
        position_column = columns.find_position(position, taken)
    turns = None
    if counts_per_turn is not None:
        turns, angle_unit = np.asarray(counts_per_turn, dtype=float), "deg"
        if turns.ndim > 1 or turns.size not in (1, n_joints) or not np.all(turns > 0):
            raise TableError(
                f"--counts-per-turn needs a positive number, or one for each of {n_joints} joints."
            )
    if angle_unit is None:
        angle_unit = columns.find_unit(angle_columns)
    units = {columns.units[i] for i in point_columns}
    if units - set(_MM_PER_UNIT) or len(units) > 1:
        raise TableError(f"{path}: the points are in {', '.join(sorted(units))}, not in mm.")
    handed_on = {name: columns.named(name, "others") for name in others}
    used = {*angle_columns, *point_columns, position_column, *handed_on.values()}
    unused = [name for i, name in enumerate(columns.header) if i not in used]
    if unused:
        columns.notes.append(f"Columns not used: {', '.join(unused)}.")
    return Layout(
        columns.dialect, columns.header, columns.header_row, angle_columns, position_column,
        point_columns, angle_unit, _MM_PER_UNIT[units.pop()] if units else 1.0, handed_on,
        columns.notes, turns,
    )  # fmt: skip
