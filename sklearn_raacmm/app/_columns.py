"""Columns of a file by their names, its rows, and the labels of positions in them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from collections import Counter
from itertools import chain, islice, pairwise, zip_longest

import numpy as np

from sklearn_raacmm.app._sources import TableError, find_source, strip_mark
from sklearn_raacmm.app._units import UNITS, mm_of_points, split_unit, stated_units, unit_of_cells

_POSITION_NAMES = (
    "position", "pos", "positions", "cone", "seat", "socket", "hole", "place", "placement",
    "point", "label", "group", "station", "location", "nest",
    "kegel", "messpunkt", "punkt", "ort", "stelle", "cône", "cone no", "posición", "posicion",
    "posizione", "punto", "ponto", "位置", "点", "测点", "測點", "点名", "座", "孔",
    "測定点", "위치",
)  # fmt: skip
_NO_LABEL = re.compile(
    r"name\W?\d+\]?$|frame_id|^(operator|user|status|quality|comment|remark|note|flag|bediener|prüfer|"
    r"bemerkung)s?$"
)
_TIME = re.compile(r"\d{1,4}[-./:]\d{1,2}[-./:]\d{1,4}|\d{1,2}:\d{2}")
OF_TIMES = re.compile(r"_*(time|timestamp|date|datetime|zeit|datum|uhrzeit|utc)(stamp)?")
# Names of rows below a table.
_STATISTICS = re.compile(
    r"(mean|average|avg|std|stdev|st(andar)?d\.? ?dev(iation|\.)?|rms|min|max|range|median|sum|"
    r"total|mittelwert|standardabweichung|spannweite|minimum|maximum|moyenne|media|promedio)\W*"
    r"(values?|of .*|min(imum)?)?\W*",
    re.IGNORECASE,
)
# What loggers write for a number that is missing.
_NOT_MEASURED = (999, 9999, 99999, 999999)
# Rows looked at to find text columns and the unit.
_LOOKED_AT = 200


def find_header(source, n_numbers):
    """Names of the columns, the row they stand in (0: none), first rows of data, and all of both.

    All rows are (number, cells, cells without the mark of a comment, is a comment).
    """
    some = islice(source.rows(), _LOOKED_AT)
    rows = [(number, cells, *strip_mark(cells)) for number, cells in some]
    # Which cells hold numbers in most rows; what stands above the first of these may hold some.
    kinds = [tuple(source.number(cell) is not None for cell in cells) for _, cells, *_ in rows]
    fitting = [kind for kind in kinds if sum(kind) >= n_numbers]
    if not fitting:
        raise TableError(f"{source.path}: no row with {n_numbers} numbers was found.")
    usual = Counter(fitting).most_common(1)[0][0]
    begin, texts = kinds.index(usual), [_texts(source, bare) for _, _, bare, _ in rows]
    heads = [i for i in range(begin) if len(texts[i]) >= max(n_numbers, len(texts[begin]) + 1)]
    named = [i for i in heads if not source.count(rows[i][2])]
    # Without names, or with a few, everything above the first numbers is above the data.
    n_above = named[-1] + 1 if named else kinds.index(fitting[0])
    above = [bare for _, _, bare, _ in rows[:n_above]]
    # Rows that say one thing of each column, such as its time between samples, are no data.
    repeated = [i for i in heads if Counter(texts[i]).most_common(1)[0][1] >= n_numbers]
    n_above = max([n_above, *(i + 1 for i in repeated)])
    data = [
        rows[i][:2]
        for i, kind in enumerate(kinds[n_above:], n_above)
        if sum(kind) >= n_numbers or not (rows[i][3] or sum(cell != "" for cell in rows[i][1]) == 1)
    ]
    row = rows[n_above - 1][0] if n_above else 0
    names = _names_of_columns(above, len(usual), n_numbers)
    names = names or _fields_of_joint_states(data[0][1], source, n_numbers)
    index = source.numbers([cells[0] for _, cells in data])
    is_index = np.isnan(index).all() or (len(index) > 1 and np.all(np.diff(index) == 1))
    if len(names) == len(usual) - 1 and is_index:
        names = ["", *names]  # as R and pandas write names of rows
    names += [""] * (len(usual) - len(names))
    return [name or f"column {i}" for i, name in enumerate(names, 1)], row, data, rows


def _texts(source, cells):
    """Cells of text that is no number, nor a line under a header."""
    texts = [cell for cell in cells if isinstance(cell, str) and cell.strip(":-")]
    return [cell for cell in texts if source.number(cell) is None]


def _names_of_columns(above, width, n_numbers):
    """Names in the last of the rows above the data, with units from a row of their own."""
    if not above:
        return []
    names = above[-1]
    texts = [cell for cell in names if isinstance(cell, str) and cell]
    if len(above) > 1 and texts and all(text.strip("[]()").lower() in UNITS for text in texts):
        pairs = zip_longest(above[-2], names, fillvalue="")
        names = [f"{name} [{unit.strip('[]()')}]" if unit else name for name, unit in pairs]
    while len(names) > width and names[-1] == "":
        names = names[:-1]
    return list(map(str, names)) if len(texts) >= n_numbers or len(names) == width else []


def _fields_of_joint_states(cells, source, n_joints):
    """Names of the columns of JointState messages, which ROS 2 writes without any (--csv)."""
    is_text = [isinstance(cell, str) and cell and source.number(cell) is None for cell in cells]
    run = re.search(rf"n{{{n_joints},}}", "".join("n" if text else "-" for text in is_text))
    if not run:
        return []
    # The frame's name may stand before those of the joints; each field is whole or empty.
    fields, rest = ("name", "position", "velocity", "effort"), len(cells) - run.end()
    for n in (len(run[0]), len(run[0]) - 1):
        if n >= n_joints and rest in (n, 2 * n, 3 * n):
            names = [f"{field}{i}" for field in fields for i in range(n)]
            return ([""] * (run.end() - n) + names)[: len(cells)]
    return []


def _heading(source, cells, n_numbers):
    """Text of a row that is a heading of the rows below it: a comment, or one cell; or ""."""
    bare, is_comment = strip_mark(cells)
    filled = [str(cell) for cell in bare if cell != ""]
    if source.count(cells) >= n_numbers or not (is_comment or len(filled) == 1):
        return ""
    return " ".join(filled).strip(" :=-*")


def _are_sections(source, rows, n_numbers):
    """Whether headings such as "Position P1" stand above rows, the first ones too."""
    is_data = [source.count(cells) >= n_numbers for _, cells, *_ in rows]
    headings = [_heading(source, cells, n_numbers) for _, cells, *_ in rows[:-1]]
    above = [(i, one) for i, one in enumerate(headings) if one and is_data[i + 1]]
    kinds = {one: re.sub(r"[\W_]*\d+$|\W+\w{1,2}\d*$", "", one).lower() for _, one in above}
    return len(kinds) > 1 and len({*kinds.values()}) == 1 and not any(is_data[: above[0][0]])


class Columns:
    """Columns of a file by their names, and its rows; `notes` says what was guessed."""

    def __init__(self, path, n_numbers, sheet=None):
        self.source, self.n_joints = find_source(path, n_numbers, sheet), n_numbers
        self.path = self.source.path
        self.header, self.header_row, self.first, rows = find_header(self.source, n_numbers)
        self.width = len(self.first[0][1])
        # Names of columns may stand again where logs were joined.
        self.top = next((cells for number, cells, *_ in rows if number == self.header_row), None)
        others = [one for one in rows if one[1] != self.top]
        self.sections = _are_sections(self.source, others, n_numbers)
        if self.sections:
            self.header.append("position (headings between the rows)")
        of_data = {number for number, _ in self.first}
        headed = self._headed((number, cells) for number, cells, *_ in rows)
        self.first = [one for one in headed if one[0] in of_data]
        self.names, units = zip(*map(split_unit, self.header), strict=True)
        self.units = [unit or unit_of_cells(self.cells(i)) for i, unit in enumerate(units)]
        heads = (bare for n, _, bare, comment in rows if comment or n <= self.header_row)
        self.stated = stated_units(", ".join(map(str, cells)) for cells in heads)
        where = f"header in row {self.header_row}" if self.header_row else "no header"
        self.notes = [f"{self.source}; {where}."]
        self.label_columns = [i for i, name in enumerate(self.names) if name in _POSITION_NAMES]

    def _headed(self, rows):
        """Yield rows, each with the heading above it as a further cell if they have headings."""
        label = ""
        for number, cells in rows:
            if cells == self.top:
                continue
            if not self.sections:
                yield number, cells
            elif heading := _heading(self.source, cells, self.n_joints):
                label = heading
            else:
                yield number, [*cells, label]

    def column(self, wanted, option):
        """Column of this name, its unit left out or not; or of this number, from 1."""
        wanted = str(wanted).strip()
        for given in (self.header, self.names):
            same = [i for i, name in enumerate(given) if name.lower() == wanted.lower()]
            if len(same) == 1:
                return same[0]
            if same:
                many = f"{len(same)} columns {wanted!r}"
                raise TableError(f"{self.path} has {many}; {option} needs one.")
        if wanted.isdigit() and 1 <= int(wanted) <= len(self.header):
            return int(wanted) - 1
        raise TableError(f"{self.path} has no column {wanted!r} ({option}); it has {self}.")

    def __str__(self):
        return ", ".join(self.header)

    # -- rows -------------------------------------------------------------------------------

    def rows(self, columns):
        """Yield (row number, cells) of the data, each with as many cells as the header.

        Comments are left out; so are rows at the end without a number in any of these columns, and
        rows of means and other statistics of the columns, which a note then names.
        """
        held, begun, before, statistics = [], False, [], []
        for (number, cells, texts), (*_, behind) in pairwise(chain(self._texts(), [(0, [], [])])):
            # A statistic has one row: what is in two is a label.
            words = [
                t for t in texts if t not in before and t not in behind and _STATISTICS.fullmatch(t)
            ]
            before, has_number = texts, self.has_number(cells, columns)
            if number <= self.header_row or not (has_number or not strip_mark(cells)[1]):
                continue
            if words and has_number:
                statistics.append(f"{number} ({words[0]})")
                continue
            held.append((number, cells))
            if has_number:
                yield from map(self._check_width, held)
                held, begun = [], True
        if not begun:
            yield from map(self._check_width, held)
        elif held:
            number, cells = held[0]
            text = next(str(cell) for cell in cells if cell != "")
            self.note(f"Left out from row {number} on, where the angles end: {text!r}.")
        if statistics:
            named = ", ".join(statistics[:4])
            self.note(f"Rows of statistics, left out: {len(statistics)}, such as {named}.")

    def _texts(self):
        """Yield number, cells and texts of rows, those of columns that may name statistics.

        Such columns are the first, and those that have other cells than numbers.
        """
        first = enumerate(zip_longest(*(cells for _, cells in self.first), fillvalue=""))
        columns = [i for i, of in first if not i or None in map(self.source.number, of)]
        for number, cells in self._headed(self.source.rows()):
            texts = [str(cells[i]) for i in columns if i < len(cells)]
            yield number, cells, [text for text in texts if text[:1].isalpha()]

    def note(self, text):
        """Say what was guessed, once: rows may be read twice, and in blocks."""
        if text not in self.notes:
            self.notes.append(text)

    def has_number(self, cells, columns):
        return any(i < len(cells) and self.source.number(cells[i]) is not None for i in columns)

    def fields(self, field):
        """Columns of a field of messages by their numbers: position0, position[1], positions[2]."""
        pattern = re.compile(rf"(?:.*\W)?(?:joint_)?{field}s?[\[_.]?(\d+)\]?")
        matches = enumerate(map(pattern.fullmatch, self.names))
        return {int(match[1]): i for i, match in matches if match}

    def are_joint_states(self, columns):
        """Whether columns are positions of sensor_msgs/JointState, which are in rad and m."""
        return {*columns} <= {*self.fields("position").values()} and bool(self.fields("name"))

    def _check_width(self, row):
        (number, cells), width = row, len(self.header)
        while len(cells) > width and cells[-1] == "":
            cells.pop()
        if self.width <= len(cells) < width:  # such as a comment that few rows have
            return number, [*cells, *[""] * (width - len(cells))]
        if len(cells) != width:
            fault = f"row {number} has {len(cells)} cells, the table {width} columns."
            if self.source.separator == "," and len(cells) > width:
                fault += " Decimal commas between commas cannot be told apart: use semicolons."
            raise TableError(f"{self.path}: {fault}")
        return row

    def numbers(self, rows, columns):
        """Numbers (n_rows, n_columns) of some rows; the first cell that holds none is named."""
        values = np.empty((len(rows), len(columns)))
        for j, column in enumerate(columns):
            cells = [cells[column] for _, cells in rows]
            values[:, j] = self.source.numbers(cells)
            for i in np.flatnonzero(~np.isfinite(values[:, j])):
                what = f"{cells[i]!r} is not a number"
                if cells[i] == "":
                    what = "is empty: fill it in, or delete the row"
                if isinstance(cells[i], str) and re.search(r"\d[.,]\d", cells[i]):
                    sign = {".": "point", ",": "comma"}[self.source.decimal]
                    what += f" with a decimal {sign}, which the others have"
                raise self.fault(rows[i][0], column, what)
        if len(columns) > 1:
            lost = np.isin(np.abs(values), _NOT_MEASURED).all(axis=1)
            for i in np.flatnonzero(lost & (np.ptp(values, axis=1) == 0)):
                what = f"{values[i, 0]:.15g} stands in all columns for what was not measured"
                raise self.fault(rows[i][0], columns[0], what)
        return values

    def points(self, rows, columns):
        """Points (n_rows, 3) of some rows, in mm."""
        return mm_of_points(self, columns) * self.numbers(rows, columns)

    def labels(self, rows, column):
        """Labels (n_rows,) of some rows, as text; the first that is missing is named."""
        labels = [str(cells[column]) for _, cells in rows]
        if "" in labels:
            raise self.fault(rows[labels.index("")][0], column, "the label is missing")
        return np.array(labels)

    def fault(self, number, column, what):
        """Error that names a row and a column."""
        return TableError(f"{self.path}: row {number}, column {self.header[column]!r}: {what}.")

    def cells(self, column):
        """Cells of the first rows."""
        return [cells[column] for _, cells in self.first if len(cells) > column]

    def unclear(self, question, option):
        """Error that asks what an option has to say of the columns."""
        text = f"{self.path}: {question}? Say it with {option}; the columns are {self}."
        return TableError(text)

    # -- labels -----------------------------------------------------------------------------

    def find_position(self, taken, needed):
        """Column of the label of the position; `taken` are columns of other things."""
        labels = [i for i in self.label_columns if i not in taken] or self._columns_of_text(taken)
        if len(labels) == 1:
            self.notes.append(f"Labels of the positions: {self.header[labels[0]]}.")
            return labels[0]
        if not labels and not needed:
            return None
        raise self.unclear("which column holds the label of the position", "--position NAME")

    def _columns_of_text(self, taken):
        """Columns that may hold labels: if there are any, those with one in every row."""
        texts = {}
        for i, name in enumerate(self.names):
            # A label that is missing here and there is a fault, which is reported on reading.
            given = [cell for cell in self.cells(i) if cell != ""]
            is_other = i in taken or OF_TIMES.fullmatch(name) or _NO_LABEL.search(name)
            is_time = any(_TIME.search(str(cell)) for cell in given)
            if given and not (is_other or is_time or self.source.count(given)):
                texts[i] = given
        # What is the same in all rows tells no positions apart.
        texts = {i: given for i, given in texts.items() if len({*given}) > 1} or texts
        whole = [i for i, given in texts.items() if len(given) == len(self.cells(i))]
        return whole or list(texts)
