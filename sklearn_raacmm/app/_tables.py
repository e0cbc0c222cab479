"""Tables of joint angles: which columns hold what, in which unit, and what is wrong where."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import chain

import numpy as np

from sklearn_raacmm.app._cells import SEPARATOR_NAMES, Dialect, TableError, find_dialect

# Two whole turns in rad: an angle beyond is in degrees, as `Arm.forward` supposes when it warns.
_SURELY_DEGREES = 4 * np.pi
_DEGREES = ("deg", "degree", "degrees", "°", "º")
_RADIANS = ("rad", "radian", "radians")
_UNIT = re.compile(
    r"^(.*?)\s*[\[(/]\s*([^\])/]+?)\s*[\])]?$|^(.*?)[\s_]+(deg|rad|mm|m)$|^(.*?)(°)$"
)
_POSITION_NAMES = (
    "position", "pos", "positions", "cone", "seat", "socket", "hole", "place", "placement",
    "point", "label", "group", "station", "location", "nest",
    "kegel", "messpunkt", "punkt", "ort", "stelle",
)  # fmt: skip
_TIME = re.compile(r"\d{1,4}[-./:]\d{1,2}[-./:]\d{1,4}|\d{1,2}:\d{2}")
_TIME_NAMES = ("time", "timestamp", "date", "datetime", "zeit", "datum", "uhrzeit", "utc")
# Rows looked at to find text columns and the unit.
_LOOKED_AT = 200


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
    """

    angles: np.ndarray
    angle_unit: str
    positions: np.ndarray | None
    points: np.ndarray | None
    rows: np.ndarray
    notes: list = field(default_factory=list)


def read_table(
    path, n_joints, *, angles=None, position=None, points=None, angle_unit=None, labelled=True
):
    r"""Read a table of joint angles as a logger or a spreadsheet program wrote it.

    Separator (semicolons, tabs, commas, bars, blanks), decimal sign, encoding (UTF-8 with or
    without its mark, UTF-16, Windows-1252), lines above the header, and columns are found; what
    was guessed is in the notes.

    Parameters
    ----------
    path : str or path-like
        A text file, or a spreadsheet (.xlsx, with openpyxl).
    n_joints : int
        Number of joints of the arm.
    angles : list of str, default=None
        Names of the columns of the joint angles. None: columns numbered from 1, such as q1 to q6.
    position : str, default=None
        Name of the column of the positions' labels. None: one called so, or the only one of text;
        with `points` one called so, or none.
    points : list of three str, default=None
        Names of the columns of a tracker's x, y and z. None: there are none.
    angle_unit : {"rad", "deg"}, default=None
        None: from the header, such as "q1 [deg]", or degrees if an angle is beyond two turns.
    labelled : bool, default=True
        Whether positions are needed.

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
        labelled=labelled,
    )  # fmt: skip
    blocks = list(layout.blocks(100_000))
    table = Table(
        angles=np.concatenate([block.angles for block in blocks]),
        angle_unit=layout.angle_unit,
        positions=None
        if layout.position_column is None
        else np.concatenate([block.positions for block in blocks]),
        points=np.concatenate([block.points for block in blocks]) if points else None,
        rows=np.concatenate([block.rows for block in blocks]),
        notes=layout.notes,
    )
    if labelled and points is None:
        _refuse_lonely_labels(path, table)
    return table


def _refuse_lonely_labels(path, table):
    labels, first, counts = np.unique(table.positions, return_index=True, return_counts=True)
    several = labels[counts > 1].tolist()
    for label, row in zip(labels[counts == 1].tolist(), first[counts == 1], strict=True):
        near = get_close_matches(label, several, 1)
        hint = f" Was {near[0]!r} meant?" if near else ""
        raise TableError(
            f"{path}: row {table.rows[row]}: the position {label!r} occurs in this row only.{hint}"
        )


# -- what is where --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Layout:
    """Where a file holds what: found once, then rows are read block by block."""

    dialect: Dialect
    header: list
    header_row: int
    angle_columns: list
    position_column: int | None
    point_columns: list
    angle_unit: str
    point_factor: float
    notes: list

    def raw_rows(self):
        """Yield (row number, cells) of the data, each with as many cells as the header."""
        width = len(self.header)
        for number, cells in self.dialect.rows():
            if number <= self.header_row:
                continue
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
            yield number, cells

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
        return Table(
            angles=self._numbers(numbers, cells, self.angle_columns),
            angle_unit=self.angle_unit,
            positions=positions,
            points=points * self.point_factor if self.point_columns else None,
            rows=np.array(numbers),
        )

    def _numbers(self, numbers, cells, columns):
        values = np.empty((len(cells), len(columns)))
        for j, column in enumerate(columns):
            for i, row in enumerate(cells):
                value = self.dialect.number(row[column])
                if value is None or not np.isfinite(value):
                    what = f"{row[column]!r} is not a number" if row[column] != "" else "is empty"
                    if isinstance(row[column], str) and re.search(r"\d[.,]\d", row[column]):
                        sign = {".": "point", ",": "comma"}[self.dialect.decimal]
                        what += f" with a decimal {sign}, which the others have"
                    raise self._fault(numbers[i], self.header[column], what)
                values[i, j] = value
        return values

    def _fault(self, number, name, what):
        return TableError(f"{self.dialect.path}: row {number}, column {name!r}: {what}.")


def find_layout(
    path, n_joints, *, angles=None, position=None, points=None, angle_unit=None, labelled=True
):
    """Find where a file holds what; parameters as for `read_table`."""
    dialect = find_dialect(path, n_joints)
    header, header_row, looked_at = _find_header(dialect, n_joints)
    names, units = zip(*map(split_unit, header), strict=True)
    notes = [_note_of_dialect(dialect, header_row)]
    angle_columns = _find_angles(path, header, names, looked_at, dialect, n_joints, angles, notes)
    point_columns = [_named(path, header, names, name, "--points") for name in points or ()]
    position_column = None
    # A tracker's points need no labels: those that are there are taken.
    if labelled and not (points and position is None and not _has_labels(names)):
        taken = {*angle_columns, *point_columns}
        position_column = _find_position(
            path, header, names, looked_at, dialect, position, taken, notes
        )
    if angle_unit is None:
        angle_unit = _find_unit(path, header, units, looked_at, dialect, angle_columns, notes)
    point_units = {units[i] for i in point_columns} - {""}
    if point_units - {"mm", "m"} or len(point_units) > 1:
        raise TableError(f"{path}: the points are in {', '.join(sorted(point_units))}, not in mm.")
    used = {*angle_columns, *point_columns, position_column}
    unused = [name for i, name in enumerate(header) if i not in used]
    if unused:
        notes.append(f"Columns not used: {', '.join(unused)}.")
    return Layout(
        dialect, header, header_row, angle_columns, position_column, point_columns,
        angle_unit, 1000.0 if point_units == {"m"} else 1.0, notes,
    )  # fmt: skip


def split_unit(name):
    """Name of a column and the unit in it: "q1 [deg]" -> "q1", "deg"."""
    match = _UNIT.fullmatch(str(name).strip())
    if not match:
        return str(name).strip().lower(), ""
    name, unit = [part for part in match.groups() if part is not None][:2] or ("", "")
    unit = unit.strip().lower()
    unit = "deg" if unit in _DEGREES else "rad" if unit in _RADIANS else unit
    return name.strip(" _").lower(), unit


def _note_of_dialect(dialect, header_row):
    if dialect.is_sheet:
        how = "Spreadsheet, first sheet"
    else:
        signs = {".": "points", ",": "commas"}
        how = (
            f"Columns parted by {SEPARATOR_NAMES[dialect.separator]}, decimal "
            f"{signs[dialect.decimal]}, {dialect.encoding}"
        )
    return f"{how}; " + (f"header in row {header_row}." if header_row else "no header.")


def _find_header(dialect, n_joints):
    """Names of the columns, the row they stand in (0: none), and the first rows of data."""
    above, data = [], []
    for number, cells in dialect.rows():
        n_numbers = sum(dialect.number(cell) is not None for cell in cells)
        if not data and n_numbers < n_joints:
            above.append((number, cells))
            continue
        data.append((number, cells))
        if len(data) == _LOOKED_AT:
            break
    if not data:
        raise TableError(f"{dialect.path}: no row with {n_joints} numbers was found.")
    width = len(data[0][1])
    above, damaged = _without_damaged(above, dialect, n_joints)
    data = damaged + data
    if above:
        number, cells = above[-1]
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
            return [str(cell) or f"column {i}" for i, cell in enumerate(cells, 1)], number, data
        return [f"column {i}" for i in range(1, width + 1)], number, data
    return [f"column {i}" for i in range(1, width + 1)], 0, data


def _without_damaged(above, dialect, n_joints):
    """Rows down to the names, and those below: data with a fault, which is reported on reading."""
    named = 0
    for i, (_, cells) in enumerate(above):
        n_numbers = sum(dialect.number(cell) is not None for cell in cells)
        n_texts = sum(isinstance(cell, str) and cell != "" for cell in cells) - n_numbers
        if n_texts >= n_joints and n_numbers == 0:
            named = i + 1
        elif named and n_numbers:
            return above[:named], above[named:]
    return above, []


def _is_unit(cell):
    return cell.strip("[]()").lower() in (*_DEGREES, *_RADIANS, "mm", "m", "s", "ms", "-", "°c")


def _named(path, header, names, wanted, option):
    """Column of this name, its unit left out or not; or of this number, from 1."""
    wanted = str(wanted).strip()
    for given in (header, names):
        found = [i for i, name in enumerate(given) if name.lower() == wanted.lower()]
        if len(found) == 1:
            return found[0]
        if found:
            raise TableError(f"{path} has {len(found)} columns {wanted!r}; {option} needs one.")
    if wanted.isdigit() and 1 <= int(wanted) <= len(header):
        return int(wanted) - 1
    raise TableError(f"{path} has no column {wanted!r} ({option}); it has {', '.join(header)}.")


def _find_angles(path, header, names, rows, dialect, n_joints, wanted, notes):
    if wanted is not None:
        if len(wanted) != n_joints:
            raise TableError(
                f"--angles names {len(wanted)} columns, the arm has {n_joints} joints."
            )
        return [_named(path, header, names, name, "--angles") for name in wanted]
    series = {}
    for i, name in enumerate(names):
        match = re.fullmatch(r"(\D*?)[\s_.-]*(\d+)(\D*)", name)
        if match:
            series.setdefault((match[1], match[3]), {})[int(match[2])] = i
    fitting = [
        [found[k] for k in sorted(found)]
        for found in series.values()
        if sorted(found) in (list(range(1, n_joints + 1)), list(range(n_joints)))
    ]
    # Columns without names are numbered by us: that says nothing.
    if len(fitting) == 1 and header[fitting[0][0]] != "column 1":
        first, last = header[fitting[0][0]], header[fitting[0][-1]]
        notes.append(f"Joint angles: {first} to {last}.")
        return fitting[0]
    numeric = [
        i
        for i in range(len(header))
        if names[i] not in _TIME_NAMES
        and all(len(c) > i and dialect.number(c[i]) is not None for _, c in rows[:20])
    ]
    if not fitting and len(numeric) == n_joints:
        notes.append(f"Joint angles: the columns of numbers, {header[numeric[0]]} to "
                     f"{header[numeric[-1]]}.")  # fmt: skip
        return numeric
    example = ",".join(f"q{i}" for i in range(1, n_joints + 1))
    raise TableError(
        f"{path}: which {n_joints} columns hold the joint angles? Say it with --angles {example} "
        f"(names or numbers of columns); the columns are {', '.join(header)}."
    )


def _find_position(path, header, names, rows, dialect, wanted, taken, notes):
    if wanted is not None:
        return _named(path, header, names, wanted, "--position")
    called = [i for i, name in enumerate(names) if name in _POSITION_NAMES and i not in taken]
    if not called:
        free = [i for i in range(len(header)) if i not in taken and names[i] not in _TIME_NAMES]
        columns = {i: [cells[i] for _, cells in rows if len(cells) > i] for i in free}
        # A label that is missing here and there is a fault to be told later.
        text = {i: [_is_label(cell, dialect) for cell in columns[i] if cell != ""] for i in free}
        called = [i for i in free if text[i] and all(text[i])]
        whole = [i for i in called if len(text[i]) == len(columns[i])]
        called = whole or called
    if len(called) == 1:
        notes.append(f"Labels of the positions: {header[called[0]]}.")
        return called[0]
    raise TableError(
        f"{path}: which column holds the label of the position? Say it with --position NAME; the "
        f"columns are {', '.join(header)}."
    )


def _has_labels(names):
    return any(name in _POSITION_NAMES for name in names)


def _is_label(cell, dialect):
    return isinstance(cell, str) and dialect.number(cell) is None and not _TIME.search(cell)


def _find_unit(path, header, units, rows, dialect, columns, notes):
    found = {units[i] for i in columns}
    if len(found) == 1 and found <= {"deg", "rad"}:
        return found.pop()
    if found != {""}:
        told = ", ".join(header[i] for i in columns)
        raise TableError(
            f"{path}: the angles must all be in degrees or all in radians, but the columns are "
            f"{told}; say it with --unit deg or --unit rad if these are wrong."
        )
    values = (dialect.number(cells[i]) for _, cells in rows for i in columns if len(cells) > i)
    largest = max(chain([0.0], (abs(value) for value in values if value is not None)))
    if largest > _SURELY_DEGREES:
        notes.append(f"Angles in degrees: they reach {largest:.4g}.")
        return "deg"
    raise TableError(
        f"{path}: are the angles in degrees or in radians? They reach {largest:.4g} in the first "
        "rows, and the header does not say; say it with --unit deg or --unit rad."
    )


# -- known lengths --------------------------------------------------------------------------------


def read_lengths(path, sd=None):
    """Read known lengths: two labels, a length and its standard deviation a row, mm.

    Parameters
    ----------
    path : str or path-like
        A table of three or four columns, with or without a header.
    sd : float, default=None
        Standard deviation in mm where the table has no fourth column.

    Returns
    -------
    list of (label, label, length, standard deviation)
        As `learn_correction` takes them.

    Raises
    ------
    TableError
        If a row does not hold these; the sentence has its number.
    """
    dialect = find_dialect(path, 1)
    lengths = []
    for number, cells in dialect.rows():
        values = [dialect.number(cell) for cell in cells[2:4]]
        if not lengths and (not values or values[0] is None):
            continue  # the header, or what stands above it
        if not values or values[0] is None:
            raise TableError(f"{path}: row {number} must hold two labels and a length in mm.")
        if len(values) == 1 or values[1] is None:
            values = [values[0], sd]
        if values[1] is None:
            raise TableError(
                f"{path}: row {number} has no standard deviation in mm in its fourth column; say "
                "it with --length-sd 0.005."
            )
        lengths.append((str(cells[0]), str(cells[1]), *values))
    if not lengths:
        raise TableError(f"{path} holds no row of two labels and a length in mm.")
    return lengths
