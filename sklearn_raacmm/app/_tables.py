"""Tables of joint angles: rows of numbers and labels, and what is wrong where."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from itertools import islice
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.app._columns import Columns
from sklearn_raacmm.app._sources import TableError


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
        Text, a spreadsheet (.xlsx, with openpyxl), arrays (.npy, .npz, .mat) or a robot's program.
    n_joints : int
        Number of joints of the arm.
    angles : list of str, default=None
        Names of the columns of the joint angles. None: the names of the arm's joints, or columns
        numbered from 0 or 1, such as q1 to q6.
    position : str, default=None
        Name of the column of the positions' labels. None: one called so, or the only one of text;
        with `points` one called so, or none. In a robot's program the names of points without their
        last number, P1 of P1_1 and P1_2, where there are several of each.
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
    ):  # fmt: skip
        super().__init__(path, n_joints, sheet)
        self.angle_columns = self.find_angles(angles, joint_names)
        self.points_file = points if isinstance(points, str | PathLike) else None
        named: Any = () if self.points_file else points or ()
        self.point_columns = [self.column(name, "--points") for name in named]
        self.labelled, self.position_column = labelled and points is None, None
        # A tracker's points need no labels: those that are there are taken.
        if labelled and (not points or position is not None or self.label_columns):
            taken = {*self.angle_columns, *self.point_columns}
            self.position_column = self.find_position(position, taken, needed)
        self.turns = np.ones(1)
        if counts_per_turn is not None:
            self.turns, angle_unit = np.asarray(counts_per_turn, dtype=float), "deg"
            self.factor = 360.0
        if not (self.turns.shape in ((), (1,), (n_joints,)) and np.all(self.turns > 0)):
            each = f"one for each of {n_joints} joints"
            raise TableError(f"--counts-per-turn needs a positive number, or {each}.")
        self.angle_unit = angle_unit or self.find_unit(self.angle_columns)
        self.others = {name: self.column(name, "others") for name in others}
        used = {*self.angle_columns, *self.point_columns, *self.others.values()}
        used.add(self.position_column)
        if unused := [name for i, name in enumerate(self.header) if i not in used]:
            self.notes.append(f"Columns not used: {', '.join(unused)}.")

    def read(self):
        """All rows as one table."""
        table = self._table(list(self.rows(self.angle_columns)))
        if self.points_file:
            return _with_points(self, table, self.points_file)
        if self.labelled and table.positions is not None:
            _refuse_lonely_labels(self.path, table)
        return table

    def blocks(self, n_rows):
        """Yield tables of at most so many rows, and their cells as they are in the file."""
        rows = self.rows(self.angle_columns)
        while block := list(islice(rows, n_rows)):
            yield self._table(block), [cells for _, cells in block]

    def _table(self, rows):
        """The table of some rows."""
        positions = points = None
        if self.position_column is not None:
            positions = self.labels(rows, self.position_column)
        if self.point_columns:
            points = self.points(rows, self.point_columns)
        angles = self.factor * self.numbers(rows, self.angle_columns) / self.turns
        others = {}
        for name, column in self.others.items():
            cells = [cells[column] for _, cells in rows]
            values = self.source.numbers(cells)
            others[name] = np.array(list(map(str, cells))) if np.isnan(values).any() else values
        numbers = np.array([number for number, _ in rows])
        return Table(angles, self.angle_unit, positions, points, numbers, self.notes, others)


def _refuse_lonely_labels(path, table):
    labels, first, counts = np.unique(table.positions, return_index=True, return_counts=True)
    several = labels[counts > 1].tolist()
    lonely = counts == 1
    for label, row in zip(labels[lonely].tolist(), table.rows[first[lonely]], strict=True):
        near = get_close_matches(label, several, 1)
        hint = f" Was {near[0]!r} meant?" if near else ""
        raise TableError(f"{path}: row {row}: the position {label!r} is in this row only.{hint}")


# -- points of a tracker --------------------------------------------------------------------------


def read_points(path):
    """Names, None if no column holds any, and points (n, 3), mm, as trackers export them.

    The columns are x, y and z by name, or else names and then three numbers in each row.
    """
    columns = Columns(path, 3)
    if set("xyz") <= set(columns.names):
        found = [columns.names.index(name) for name in "xyz"]
    else:  # names, then x, y, z, then what else is known of a point
        _, cells = columns.first[0]
        found = [i for i, cell in enumerate(cells) if columns.source.number(cell) is not None]
        found = found[len(found) == 4 and found[0] == 0 :][:3]
    if len(found) != 3:
        raise TableError(f"{path}: which columns are x, y and z? It has {columns}.")
    rows = list(columns.rows(found))
    # Names stand before the points.
    names = columns.labels(rows, found[0] - 1).tolist() if found[0] else None
    return names, columns.points(rows, found)


def _with_points(layout, table, source):
    """The table with points of another file: matched by their names, or else by their order."""
    names, points = read_points(source)
    order, how = np.arange(len(points)), "in the order of the rows"
    row_of_name = {name: i for i, name in enumerate(names or ())}
    if len(row_of_name) == len(points):
        rows = (map(str, cells) for _, cells in layout.rows(layout.angle_columns))
        for name, cells in zip(layout.header, zip(*rows, strict=True), strict=True):
            if row_of_name.keys() >= set(cells) and len(set(cells)) == len(cells):
                order = np.array([row_of_name[cell] for cell in cells])
                how = f"matched by the column {name}"
                break
    if len(order) != len(table.angles):
        raise TableError(
            f"{source} holds {len(points)} points, {layout.path} {len(table.angles)} rows, "
            "and no column of names says which belong together."
        )
    table.notes.append(f"Points of {source}, {how}.")
    return replace(table, points=points[order])
