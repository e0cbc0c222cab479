"""Which columns of a table hold what: tables of names as loggers, robots and people use them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from collections import Counter
from itertools import chain, islice, zip_longest
from typing import Any

import numpy as np

from sklearn_raacmm.app._sources import TableError, find_source, strip_mark, unit_in

# An angle beyond two whole turns in rad is in degrees, as `Arm.forward` supposes when it warns; one
# beyond a hundred turns in degrees is an encoder's count.
_SURELY_DEGREES, _SURELY_COUNTS = 4 * np.pi, 36_000
# Words of loggers and people for a unit, in the languages that they write.
_WORDS = {
    "deg": "deg degree degrees degrees. degs ° º grad 度 도 degré degrés grado grados gradi градус "
    "град градусы stopnie graus grau derece",
    "rad": "rad rads radian radians radianes radianti bogenmaß 弧度 ラジアン рад",
    "gon": "gons grades neugrad",
    "mm": "毫米 millimeter millimeters millimetre millimetres",
    "m": "米 meter meters metre metres",
    "um": "µm μm",
    "inch": "in inches",
    "ft": "feet",
    "counts": "count counts pulses pulse ticks inc inkremente",
}
_UNIT_OF_WORD = {word: unit for unit, words in _WORDS.items() for word in words.split()}
# Units of angles: degrees or radians, and how many of them each is.
_ANGLES = {
    "deg": ("deg", 1.0), "rad": ("rad", 1.0), "gon": ("deg", 0.9), "mrad": ("rad", 1e-3),
    "mdeg": ("deg", 1e-3), "arcsec": ("deg", 1 / 3600), "turns": ("deg", 360.0),
}  # fmt: skip
MM_PER_UNIT = {
    "": 1.0, "mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "inch": 25.4, "ft": 304.8,
}  # fmt: skip
# A unit that stands above the table for all of it: "// Units: Inches, Degrees", "LINEAR  METRE",
# "points in m". Of words that mean other things, too, the sentence's part has to end there.
_STATED = re.compile(
    r"\b(?:(?:units?|linear|angular|angles?)(?:[\s:=,]+(?:are|is|in)\b)?|in)[\s:=,]+"
    r"(?!(?:m|in|turns|ft)\b(?!\s*(?:[,;/)]|and\b|$)))([^\W\d]+)(?:[\s,;/]+(?:and\s+)?([^\W\d]+))?",
    re.IGNORECASE,
)
_UNITS = (*_UNIT_OF_WORD, *_ANGLES, *filter(None, MM_PER_UNIT), "s", "ms", "-", "°c")
# No number in brackets is a unit: j[0].
_UNIT = re.compile(
    r"^(.*?)\s*[\[(/]\s*(?!\d+\s*[\])]?$)([^\])/]+?)\s*[\])]?$|^(.*?)(°)$|"
    r"^(.*?)[\s_]+(deg|rad|mm|m|gon|mrad|mdeg)$"
)
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
_TIME_NAMES = re.compile(r"_*(time|timestamp|date|datetime|zeit|datum|uhrzeit|utc)(stamp)?")
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
# Angles of columns without names that are beyond this many degrees are no angles of joints.
_TWO_TURNS = 720
_NOT_COMMANDED = re.compile(r"^(?!.*(target|command|cmd|desired|setpoint|reference|goal|soll))")
_OF_JOINTS = re.compile(r"(?<![a-z])(q|j|joint|axis|axe|achse|eje|theta|angle|enc|encoder)[\W_]*\d")
MEASURED = re.compile(r"actual|meas|encoder|feedback|(?<![a-z])(ist|act)(?![a-z])")
# Units that a format states without writing them into the file: UR RTDE guide, actual_q and
# target_q; ROS, sensor_msgs/JointState.
_IN_RADIANS = re.compile(r"(actual|target)_q[_.\s]*\d|field\.position|joint_?states?\W")
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
    rows = []
    for number, cells in islice(source.rows(), _LOOKED_AT):
        bare = strip_mark(cells)
        rows.append((number, cells, cells if bare is None else bare, bare is not None))
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
        (number, cells)
        for (number, cells, _, is_comment), kind in zip(rows, kinds, strict=True)
        if sum(kind) >= n_numbers or not (is_comment or sum(cell != "" for cell in cells) == 1)
    ]
    row = rows[n_above - 1][0] if n_above else 0
    data = [one for one in data if one[0] > row]
    names = _names_of_columns(above, len(usual), n_numbers)
    if not names:
        names = _fields_of_joint_states(data[0][1], source, n_numbers)
    if len(names) == len(usual) - 1 and _is_index(source, [cells[0] for _, cells in data]):
        names = ["", *names]  # as R and pandas write names of rows
    names += [""] * (len(usual) - len(names))
    return [name or f"column {i}" for i, name in enumerate(names, 1)], row, data, rows


def _texts(source, cells):
    """Cells of text that is no number, nor a line under a header."""
    texts = [cell for cell in cells if isinstance(cell, str) and cell.strip(":-")]
    return [cell for cell in texts if source.number(cell) is None]


def _is_index(source, cells):
    """Whether the cells of a column are words, or count the rows."""
    values = [source.number(cell) for cell in cells]
    if all(value is None for value in values):
        return True
    return None not in values and len(values) > 1 and bool(np.all(np.diff(values) == 1))


def _names_of_columns(above, width, n_numbers):
    """Names in the last of the rows above the data, with units from a row of their own."""
    if not above:
        return []
    names = above[-1]
    texts = [cell for cell in names if isinstance(cell, str) and cell]
    if len(above) > 1 and texts and all(text.strip("[]()").lower() in _UNITS for text in texts):
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


def split_unit(name):
    """Name of a column and the unit in it: "q1 [deg]" -> "q1", "deg"."""
    name = str(name).strip()
    match = None if name.startswith("/") else _UNIT.fullmatch(name)  # a topic of ROS
    if not match:
        return name.lower(), ""
    name, unit = (part.strip(" _").lower() for part in match.groups() if part is not None)
    return name, _UNIT_OF_WORD.get(unit, unit)


def _heading(source, cells, n_numbers):
    """Text of a row that is a heading of the rows below it: a comment, or one cell; or None."""
    bare = strip_mark(cells)
    filled = [str(cell) for cell in (cells if bare is None else bare) if cell != ""]
    if source.count(cells) >= n_numbers or (bare is None and len(filled) != 1):
        return None
    return " ".join(filled).strip(" :=-*") or None


def _are_sections(source, rows, n_numbers):
    """Whether headings such as "Position P1" stand above rows, the first ones too."""
    if source.table is not None:
        return False
    forms: dict[str, str] = {}
    is_data = [source.count(cells) >= n_numbers for _, cells, *_ in rows]
    for i, ((_, cells, *_), below) in enumerate(zip(rows, is_data[1:], strict=False)):
        heading = _heading(source, cells, n_numbers)
        if heading is not None and below:
            if not forms and any(is_data[:i]):
                return False
            forms[heading] = re.sub(r"[\W_]*\d+$|\W+\w{1,2}\d*$", "", heading).lower()
    return len(forms) > 1 and len(set(forms.values())) == 1


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
        of_cells = [{*map(unit_in, self.cells(i))} for i in range(len(units))]
        behind = [_UNIT_OF_WORD.get(u := min(one), u) if len(one) == 1 else "" for one in of_cells]
        self.units = tuple(unit or other for unit, other in zip(units, behind, strict=True))
        above = (
            ", ".join(map(str, bare))
            for number, _, bare, is_comment in rows
            if number <= self.header_row or is_comment
        )
        self.stated = set()
        for pair in (pair for line in above for pair in _STATED.findall(line)):
            first, second = (_UNIT_OF_WORD.get(word.lower(), word.lower()) for word in pair)
            if first in _UNITS:  # else it is a sentence: "in Berlin in May"
                self.stated |= {first, second}
        where = f"header in row {self.header_row}" if self.header_row else "no header"
        self.notes, self.factor = [f"{self.source}; {where}."], 1.0
        self.label_columns = [i for i, name in enumerate(self.names) if name in _POSITION_NAMES]

    def _headed(self, rows):
        """Yield rows, each with the heading above it as a further cell if they have headings."""
        label = ""
        for number, cells in rows:
            if cells == self.top:
                continue
            if not self.sections:
                yield number, cells
            elif (heading := _heading(self.source, cells, self.n_joints)) is None:
                yield number, [*cells, label]
            else:
                label = heading

    def column(self, wanted, option):
        """Column of this name, its unit left out or not; or of this number, from 1."""
        wanted = str(wanted).strip()
        for given in (self.header, self.names):
            found = [i for i, name in enumerate(given) if name.lower() == wanted.lower()]
            if len(found) == 1:
                return found[0]
            if found:
                many = f"{len(found)} columns {wanted!r}"
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
        held, found, before, statistics = [], False, [], []
        # Statistics are named in the first column, or in one that has other cells than numbers.
        first = enumerate(zip_longest(*(cells for _, cells in self.first), fillvalue=""))
        texts_at = [i for i, of in first if not i or None in map(self.source.number, of)]
        is_statistic = _STATISTICS.fullmatch
        for number, cells in self._headed(self.source.rows()):
            texts = [cells[i] for i in texts_at if i < len(cells) and str(cells[i])[:1].isalpha()]
            word = None
            if texts != before:
                word = next((t for t in texts if t not in before and is_statistic(t)), None)
            # A statistic has one row: what is in two is a label.
            if statistics and statistics[-1][2] in before and statistics[-1][2] in texts:
                held.append(statistics.pop()[:2])
            before = texts
            has_number = self._has_number(cells, columns)
            if number <= self.header_row or not (has_number or strip_mark(cells) is None):
                continue
            if word is not None and has_number:
                statistics.append((number, cells, word))
                continue
            held.append((number, cells))
            if has_number:
                yield from map(self._check_width, held)
                held, found = [], True
        if not found:
            yield from map(self._check_width, held)
        elif held:
            number, cells = held[0]
            text = next(str(cell) for cell in cells if cell != "")
            self._note(f"Left out from row {number} on, where the angles end: {text!r}.")
        if statistics:
            named = ", ".join(f"{number} ({word})" for number, _, word in statistics[:4])
            self._note(f"Rows of statistics, left out: {len(statistics)}, such as {named}.")

    def _note(self, text):
        if text not in self.notes:  # the rows may be read twice
            self.notes.append(text)

    def _has_number(self, cells, columns):
        return any(i < len(cells) and self.source.number(cells[i]) is not None for i in columns)

    def _check_width(self, row):
        number, cells = row
        width = len(self.header)
        while len(cells) > width and cells[-1] == "":
            cells.pop()
        if self.width <= len(cells) < width:  # such as a comment that few rows have
            cells = [*cells, *[""] * (width - len(cells))]
            row = number, cells
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
                what = f"{cells[i]!r} is not a number" if cells[i] != "" else "is empty"
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
        units = sorted({self.units[i] for i in columns})
        if units == [""] and (stated := self._stated(MM_PER_UNIT)):
            units = [stated]
            self.notes.append(f"Points in {stated}, as {self.path} says above them.")
        if len(units) != 1 or units[0] not in MM_PER_UNIT:
            raise TableError(f"{self.path}: the points are in {', '.join(units)}, not in mm.")
        return MM_PER_UNIT[units[0]] * self.numbers(rows, columns)

    def mm_per_unit(self, column):
        """Millimetres in the unit of a column of a joint that slides."""
        unit = self.units[column]
        if not unit and column in self._fields("position").values() and self._fields("name"):
            unit = "m"  # sensor_msgs/JointState
        if unit and unit in MM_PER_UNIT:
            return MM_PER_UNIT[unit]
        said = f"its header says {unit!r}" if unit else "its header does not say"
        name = self.header[column]
        raise TableError(
            f"{self.path}: in which unit of length is the column {name!r} of a joint that slides? "
            f"Name it in the header, such as {self.names[column]} [mm]; {said}."
        )

    def labels(self, rows, column):
        """Labels (n_rows,) of some rows, as text; the first that is missing is named."""
        labels = [str(cells[column]) for _, cells in rows]
        if "" in labels:
            raise self.fault(rows[labels.index("")][0], column, "the label is missing")
        return np.array(labels)

    def fault(self, number, column, what):
        """Error that names a row and a column."""
        return TableError(f"{self.path}: row {number}, column {self.header[column]!r}: {what}.")

    # -- joint angles -----------------------------------------------------------------------

    def find_angles(self, wanted, joint_names, taken=(), slides=()):
        """Columns of the joint angles in the order of the arm, each another one; not those taken.

        The columns `taken` hold other things. Joints of the numbers `slides`, from 0, slide.
        """
        found = self._find_angles(wanted, joint_names, taken, slides)
        names = [name.lower() for name in self.header]
        for i in found:
            if found.count(i) > 1 or (wanted is None and names.count(names[i]) > 1):
                raise TableError(
                    f"{self.path}: the column {self.header[i]!r} is named twice, and no two joints "
                    f"have the same: say with --angles, by numbers, which to take of {self}."
                )
        return found

    def _find_angles(self, wanted, joint_names, taken, slides=()):
        if wanted is not None:
            if len(wanted) != self.n_joints:
                columns = f"--angles names {len(wanted)} columns"
                raise TableError(f"{columns}, the arm has {self.n_joints} joints.")
            return [self.column(name, "--angles") for name in wanted]
        found = self._by_names_of_joints(joint_names) or self._by_names_in_cells(joint_names)
        if found:
            shown = ", ".join(self.header[i] for i in found)
            self.notes.append(f"Joint angles, by the names of the arm's joints: {shown}.")
            return found
        # Axes that the arm calls as controllers do, such as E2 and E1 of a positioner.
        names = [name.lower() for name in joint_names or ()]
        beside = [i for i, name in enumerate(names) if _EXTERNAL.fullmatch(name)]
        ways = [self.names.index(names[i]) for i in beside if names[i] in self.names]
        what = "Axes beside the robot's own"
        if not beside or len(ways) < len(beside):
            beside, ways, what = slides, [], "Joints that slide"
        for pattern in (_EXTERNAL, _WAY) if beside else ():  # x may be a point's, E1 is an axis
            if len(ways) != len(beside):
                named = enumerate(self.names)
                ways = [i for i, name in named if pattern.fullmatch(name) and i not in taken]
        if beside and len(ways) == len(beside):
            shown = ", ".join(self.header[i] for i in ways)
            self.notes.append(f"{what}: {shown}.")
            found, n = np.zeros(self.n_joints, dtype=int), self.n_joints
            found[beside], self.n_joints = ways, n - len(beside)
            if self.n_joints:
                rest = np.setdiff1d(np.arange(n), beside)
                found[rest] = self._find_angles(None, (), {*taken, *ways})
            self.n_joints = n
            return found.tolist()
        fitting, what = self._series(), ""
        # Columns without names are numbered by us, and such numbers mean nothing.
        unnamed = all(re.fullmatch(r"column \d+", self.header[i]) for i in range(self.width))
        if not fitting or unnamed:
            numeric, poses = self.columns_of_numbers(taken), self.pose_columns()
            joints = [i for i in numeric if i not in poses]
            if len(joints) == self.n_joints + 1:  # and the first counts rows, or times
                steps = np.diff(self.source.numbers(self.cells(joints[0])))
                even = len(steps) > 1 and steps[0] > 0 and np.ptp(steps) <= 1e-6 * steps[0]
                joints = joints[1:] if even else joints
            fitting, what = [joints] * (len(joints) == self.n_joints), "the columns of numbers, "
            if not fitting and poses and len(joints) < self.n_joints:
                named = ", ".join(self.header[i] for i in poses)
                raise TableError(
                    f"{self.path}: the columns {named} are poses of the tool. Joint angles are "
                    "needed, as the encoders show them: export those, or name their columns with "
                    "--angles."
                )
        if len(fitting) == 1:
            first, last = (self.header[fitting[0][i]] for i in (0, -1))
            self.notes.append(f"Joint angles: {what}{first} to {last}.")
            return fitting[0]
        example = ",".join(f"q{i}" for i in range(1, self.n_joints + 1))
        raise TableError(
            f"{self.path}: which {self.n_joints} columns hold the joint angles? Say it with "
            f"--angles {example} (names or numbers of columns); the columns are {self}."
        )

    def columns_of_numbers(self, taken=()):
        """Columns that hold numbers only, and by their names neither times nor other quantities."""
        rows = [cells for _, cells in self.first[:20]]
        return [
            i
            for i, name in enumerate(self.names)
            if i not in taken
            and not _TIME_NAMES.fullmatch(name)
            and not _OTHER_QUANTITY.search(name)
            and not _EXTERNAL.fullmatch(name)
            and all(self._has_number(cells, [i]) for cells in rows)
        ]

    def pose_columns(self):
        """Columns of poses of the tool: x, y and z, and what stands for its direction beside."""
        place = {name: i for i, name in enumerate(self.names)}
        found = []
        for name in self.names:
            for k in (k for k, letter in enumerate(name) if letter == "x"):
                x, y, z, w = (name[:k] + letter + name[k + 1 :] for letter in "xyzw")
                if y in place and z in place:
                    found += [place[one] for one in (x, y, z, w) if one in place]
        for group in _ORIENTATIONS if found else ():
            last = {re.split(r"[\W_]+", name)[-1]: i for name, i in place.items()}
            if last.keys() >= set(group):
                found += [last[one] for one in group]
        return sorted(set(found))

    def external_axes(self, used):
        """A note on each column of an external axis that moves and is not used."""
        self.external: dict[str, int] = {}
        for i in (i for i, name in enumerate(self.names) if i not in used):
            if not _EXTERNAL.fullmatch(self.names[i]):
                continue
            values = self.source.numbers(self.cells(i))
            if np.ptp(values) > _MOVES * max(1.0, float(np.abs(values).max())):
                self.external[self.header[i]] = i
                yield (
                    f"Column {self.header[i]} varies by {np.ptp(values):.4g}: an external axis "
                    "moves the base, and the model of the arm has none. Measure with this axis at "
                    "rest, or take its movement out of the points."
                )

    def _by_names_of_joints(self, joint_names):
        """One column for each joint of the arm whose name holds that of the joint."""
        found = []
        for joint in joint_names or ():
            word = re.escape(joint.lower().removesuffix("_joint"))
            pattern = re.compile(rf"(?<![a-z0-9_]){word}(?![a-z0-9])")
            columns = [i for i, name in enumerate(self.names) if pattern.search(name)]
            columns = self._measured_angles(columns)
            if len(columns) != 1:
                return None
            found += columns
        return found if len(set(found)) == self.n_joints else None

    def _by_names_in_cells(self, joint_names):
        """Positions of JointState messages, whose names stand in cells of each row."""
        names, positions = self._fields("name"), self._fields("position")
        names = {k: self.cells(i) for k, i in names.items() if k in positions}
        numbers = self.source.count(chain(*names.values()))
        if len(names) < self.n_joints or numbers:
            return None
        if any(len(set(cells)) != 1 for cells in names.values()):
            raise TableError(f"{self.path}: the names of the joints differ from row to row.")
        in_file = {str(cells[0]).lower(): positions[k] for k, cells in names.items()}
        joint_names = [name.lower() for name in joint_names or ()]
        if joint_names and in_file.keys() >= set(joint_names):
            return [in_file[name] for name in joint_names]
        numbered: Any = {name: re.search(r"\d+", name) for name in in_file}
        if len(in_file) == self.n_joints and all(numbered.values()):
            return [in_file[name] for name in sorted(in_file, key=lambda n: int(numbered[n][0]))]
        order = ", ".join(f"{self.header[i]} ({name})" for name, i in in_file.items())
        raise TableError(
            f"{self.path} names its joints, and the arm's joints have other names or none: say the "
            f"order from the base on with --angles. The columns are {order}."
        )

    def _fields(self, field):
        """Columns of a field of messages by their numbers: position0, position[1], positions[2]."""
        pattern = re.compile(rf"(?:.*\W)?(?:joint_)?{field}s?[\[_.]?(\d+)\]?")
        found = [pattern.fullmatch(name) for name in self.names]
        return {int(match[1]): i for i, match in enumerate(found) if match}

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
        for pattern in (MEASURED, re.compile("position"), _NOT_COMMANDED, _OF_JOINTS):
            wanted = [i for i in columns if pattern.search(self.names[i])]
            if len(columns) > 1 and wanted:
                columns = wanted
        return columns

    def find_unit(self, columns):
        """Unit of the angles: from the header, the kind of columns, or their size."""
        found = {self.units[i] for i in columns}
        if len(found) == 1 and (unit := min(found)) in _ANGLES:
            known, self.factor = _ANGLES[unit]
            if any(re.search(r"\bgrad\b", self.header[i], re.IGNORECASE) for i in columns):
                self.notes.append(
                    "The unit grad is taken as degrees; name it gon if 400 are a turn."
                )
            if unit != known:
                self.notes.append(f"Angles in {unit}, {self.factor:.6g} {known} each.")
            return known
        if found == {"counts"}:
            raise TableError(
                f"{self.path}: the angles are counts of the encoders: say how many make a turn of "
                "each joint with --counts-per-turn N1,N2,..., or N for all."
            )
        if found == {""} and (stated := self._stated(_ANGLES)):
            known, self.factor = _ANGLES[stated]
            self.notes.append(f"Angles in {stated}, as the file says above them.")
            return known
        if found != {""}:
            units = ", ".join(self.header[i] for i in columns)
            raise TableError(
                f"{self.path}: the angles must all be in degrees or all in radians, but the "
                f"columns are {units}; say it with --unit deg or --unit rad if these are wrong."
            )
        cells = (cell for i in columns for cell in self.cells(i))
        values = map(self.source.number, cells)
        largest = max((abs(value) for value in values if value is not None), default=0.0)
        if largest > _SURELY_COUNTS:
            raise TableError(
                f"{self.path}: the angles reach {largest:.6g}. If they are counts of the encoders, "
                "say how many make a turn with --counts-per-turn N."
            )
        if largest > _TWO_TURNS:
            raise TableError(
                f"{self.path}: the numbers reach {largest:.4g}, more than two turns in degrees. "
                "Are these poses of the tool? Joint angles are needed: name their columns with "
                "--angles and their unit with --unit."
            )
        if largest > _SURELY_DEGREES:
            self.notes.append(f"Angles in degrees: they reach {largest:.4g}.")
            return "deg"
        if set(columns) <= set(self._fields("position").values()) and self._fields("name"):
            return "rad"  # sensor_msgs/JointState
        if all(_IN_RADIANS.search(self.names[i]) for i in columns):
            self.notes.append("Angles in rad, as such columns are defined.")
            return "rad"
        raise TableError(
            f"{self.path}: are the angles in degrees or in radians? They reach {largest:.4g} in "
            "the first rows, and the header does not say; say it with --unit deg or --unit rad."
        )

    def _stated(self, units):
        """The one of these units that the lines of text state; "" without any."""
        stated = sorted(unit for unit in units if unit in self.stated and unit)
        if len(stated) > 1:
            raise TableError(
                f"{self.path}: its lines of text name the units {' and '.join(stated)}: say in the "
                "names of the columns which is whose, such as q1 [deg] and x [mm]."
            )
        return stated[0] if stated else ""

    def cells(self, column):
        """Cells of the first rows."""
        return [cells[column] for _, cells in self.first if len(cells) > column]

    # -- labels -----------------------------------------------------------------------------

    def find_position(self, wanted, taken, needed=True):
        """Column of the label of the position; `taken` are columns of other things."""
        if wanted is not None:
            return self.column(wanted, "--position")
        found = [i for i in self.label_columns if i not in taken] or self._columns_of_text(taken)
        if len(found) == 1:
            self.notes.append(f"Labels of the positions: {self.header[found[0]]}.")
            return found[0]
        if not found and not needed:
            return None
        raise TableError(
            f"{self.path}: which column holds the label of the position? Say it with --position "
            f"NAME; the columns are {self}."
        )

    def _columns_of_text(self, taken):
        """Columns that may hold labels: if there are any, those with one in every row."""
        found, varies = {}, {}
        for i, name in enumerate(self.names):
            # A label that is missing here and there is a fault, which is reported on reading.
            given = [cell for cell in self.cells(i) if cell != ""]
            is_other = i in taken or _TIME_NAMES.fullmatch(name) or _NO_LABEL.search(name)
            is_time = any(_TIME.search(str(cell)) for cell in given)
            if given and not (is_other or is_time or self.source.count(given)):
                found[i] = len(given) == len(self.cells(i))
                varies[i] = len(set(given)) > 1
        if any(varies.values()):  # what is the same in all rows tells no positions apart
            found = {i: whole for i, whole in found.items() if varies[i]}
        return [i for i, whole in found.items() if whole] or list(found)
