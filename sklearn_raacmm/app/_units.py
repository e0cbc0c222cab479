"""Units of angles and lengths, as loggers, robots and people write them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re

import numpy as np

from sklearn_raacmm.app._sources import TableError, unit_in

# An angle beyond two whole turns in rad is in degrees, as `Arm.forward` supposes when it warns; one
# beyond two turns in degrees is none of a joint.
_SURELY_DEGREES, _TWO_TURNS = 4 * np.pi, 720
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
UNITS = (*_UNIT_OF_WORD, *_ANGLES, *filter(None, MM_PER_UNIT), "s", "ms", "-", "°c")
# No number in brackets is a unit: j[0].
_UNIT = re.compile(
    r"^(.*?)\s*[\[(/]\s*(?!\d+\s*[\])]?$)([^\])/]+?)\s*[\])]?$|^(.*?)(°)$|"
    r"^(.*?)[\s_]+(deg|rad|mm|m|gon|mrad|mdeg)$"
)
# Units that a format states without writing them into the file: UR RTDE guide, actual_q and
# target_q; ROS, sensor_msgs/JointState.
_IN_RADIANS = re.compile(r"(actual|target)_q[_.\s]*\d|field\.position|joint_?states?\W")


def split_unit(name):
    """Name of a column and the unit in it: "q1 [deg]" -> "q1", "deg"."""
    name = str(name).strip()
    match = None if name.startswith("/") else _UNIT.fullmatch(name)  # a topic of ROS
    if not match:
        return name.lower(), ""
    name, unit = (part.strip(" _").lower() for part in match.groups() if part is not None)
    return name, _UNIT_OF_WORD.get(unit, unit)


def unit_of_cells(cells):
    """Unit that stands behind the number in each of these cells, or ""."""
    units = {*map(unit_in, cells)}
    unit = units.pop() if len(units) == 1 else ""
    return _UNIT_OF_WORD.get(unit, unit)


def stated_units(lines):
    """Units that lines of text state for a whole table."""
    units = set()
    for pair in (pair for line in lines for pair in _STATED.findall(line)):
        first, second = (_UNIT_OF_WORD.get(word.lower(), word.lower()) for word in pair)
        if first in UNITS:  # else it is a sentence: "in Berlin in May"
            units |= {first, second}
    return units


def _units(table, columns, known, what):
    """Units of these columns, of the header; or else the one of those known that text states."""
    stated = sorted(unit for unit in known if unit in table.stated and unit)
    units = sorted({table.units[i] for i in columns})
    if units != [""] or not stated:
        return units
    if len(stated) > 1:
        raise TableError(
            f"{table.path}: its lines of text name the units {' and '.join(stated)}: say in the "
            "names of the columns which is whose, such as q1 [deg] and x [mm]."
        )
    table.note(f"{what} in {stated[0]}, as {table.path} says above them.")
    return stated


def mm_of_points(table, columns):
    """Millimetres in the unit of the columns of points."""
    units = _units(table, columns, MM_PER_UNIT, "Points")
    if len(units) != 1 or units[0] not in MM_PER_UNIT:
        raise TableError(f"{table.path}: the points are in {', '.join(units)}, not in mm.")
    return MM_PER_UNIT[units[0]]


def mm_of_slide(table, column):
    """Millimetres in the unit of the column of a joint that slides."""
    unit = table.units[column] or "m" * table.are_joint_states([column])
    if unit and unit in MM_PER_UNIT:
        return MM_PER_UNIT[unit]
    raise TableError(
        f"{table.path}: in which unit of length is the column {table.header[column]!r} of a joint "
        f"that slides? Name it in the header, such as {table.names[column]} [mm]; its header says "
        f"{unit or 'none'}."
    )


def find_unit(table, columns):
    """Unit of angles, deg or rad, and how many of it each number of these columns is.

    It is known from the header, from the kind of columns, or from the size of the numbers.
    """
    unit, *others = _units(table, columns, _ANGLES, "Angles")
    if unit in _ANGLES and not others:
        known, factor = _ANGLES[unit]
        if any(re.search(r"\bgrad\b", table.header[i], re.IGNORECASE) for i in columns):
            table.notes.append("The unit grad is taken as degrees; name it gon if 400 are a turn.")
        if unit != known:
            table.notes.append(f"Angles in {unit}, {factor:.6g} {known} each.")
        return known, factor
    if unit == "counts" and not others:
        raise TableError(
            f"{table.path}: the angles are counts of the encoders: say how many make a turn of "
            "each joint with --counts-per-turn N1,N2,..., or N for all."
        )
    if unit or others:
        named = ", ".join(table.header[i] for i in columns)
        raise TableError(
            f"{table.path}: the angles must all be in degrees or all in radians, but the "
            f"columns are {named}; say it with --unit deg or --unit rad if these are wrong."
        )
    return _unit_by_size(table, columns), 1.0


def _unit_by_size(table, columns):
    """Unit of angles of which no text says it."""
    values = (table.source.number(cell) for i in columns for cell in table.cells(i))
    largest = max((abs(value) for value in values if value is not None), default=0.0)
    if largest > _TWO_TURNS:
        raise TableError(
            f"{table.path}: the numbers reach {largest:.4g}, more than two turns in degrees. Are "
            "these poses of the tool? Joint angles are needed: name their columns with --angles "
            "and their unit with --unit; of encoders, say how many counts make a turn with "
            "--counts-per-turn N."
        )
    if largest > _SURELY_DEGREES:
        table.notes.append(f"Angles in degrees: they reach {largest:.4g}.")
        return "deg"
    if table.are_joint_states(columns) or all(_IN_RADIANS.search(table.names[i]) for i in columns):
        table.notes.append("Angles in rad, as such columns are defined.")
        return "rad"
    raise TableError(
        f"{table.path}: are the angles in degrees or in radians? They reach {largest:.4g} in "
        "the first rows, and the header does not say; say it with --unit deg or --unit rad."
    )
