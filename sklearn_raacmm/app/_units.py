"""Units of angles and lengths, as loggers, robots and people write them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re

import numpy as np

from sklearn_raacmm.app._sources import TableError, unit_in

# An angle beyond two whole turns in rad is in degrees, as `Arm.forward` supposes when it warns; one
# beyond a hundred turns in degrees is an encoder's count.
_SURELY_DEGREES, _SURELY_COUNTS = 4 * np.pi, 36_000
# Angles of columns without names that are beyond this many degrees are no angles of joints.
_TWO_TURNS = 720
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


def _stated(table, units):
    """The one of these units that the lines of text state; "" without any."""
    stated = sorted(unit for unit in units if unit in table.stated and unit)
    if len(stated) > 1:
        raise TableError(
            f"{table.path}: its lines of text name the units {' and '.join(stated)}: say in the "
            "names of the columns which is whose, such as q1 [deg] and x [mm]."
        )
    return stated[0] if stated else ""


def mm_of_points(table, columns):
    """Millimetres in the unit of the columns of points."""
    units = sorted({table.units[i] for i in columns})
    if units == [""] and (stated := _stated(table, MM_PER_UNIT)):
        units = [stated]
        table.notes.append(f"Points in {stated}, as {table.path} says above them.")
    if len(units) != 1 or units[0] not in MM_PER_UNIT:
        raise TableError(f"{table.path}: the points are in {', '.join(units)}, not in mm.")
    return MM_PER_UNIT[units[0]]


def mm_of_slide(table, column):
    """Millimetres in the unit of the column of a joint that slides."""
    unit = table.units[column]
    if not unit and table.are_joint_states([column]):
        unit = "m"
    if unit and unit in MM_PER_UNIT:
        return MM_PER_UNIT[unit]
    said = f"its header says {unit!r}" if unit else "its header does not say"
    name = table.header[column]
    raise TableError(
        f"{table.path}: in which unit of length is the column {name!r} of a joint that slides? "
        f"Name it in the header, such as {table.names[column]} [mm]; {said}."
    )


def find_unit(table, columns):
    """Unit of angles, deg or rad, and how many of it each number of these columns is.

    It is known from the header, from the kind of columns, or from the size of the numbers.
    """
    units = {table.units[i] for i in columns}
    if len(units) == 1 and (unit := min(units)) in _ANGLES:
        known, factor = _ANGLES[unit]
        if any(re.search(r"\bgrad\b", table.header[i], re.IGNORECASE) for i in columns):
            table.notes.append("The unit grad is taken as degrees; name it gon if 400 are a turn.")
        if unit != known:
            table.notes.append(f"Angles in {unit}, {factor:.6g} {known} each.")
        return known, factor
    if units == {"counts"}:
        raise TableError(
            f"{table.path}: the angles are counts of the encoders: say how many make a turn of "
            "each joint with --counts-per-turn N1,N2,..., or N for all."
        )
    if units == {""} and (stated := _stated(table, _ANGLES)):
        table.notes.append(f"Angles in {stated}, as the file says above them.")
        return _ANGLES[stated]
    if units != {""}:
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
    if largest > _SURELY_COUNTS:
        raise TableError(
            f"{table.path}: the angles reach {largest:.6g}. If they are counts of the encoders, "
            "say how many make a turn with --counts-per-turn N."
        )
    if largest > _TWO_TURNS:
        raise TableError(
            f"{table.path}: the numbers reach {largest:.4g}, more than two turns in degrees. "
            "Are these poses of the tool? Joint angles are needed: name their columns with "
            "--angles and their unit with --unit."
        )
    if largest > _SURELY_DEGREES:
        table.notes.append(f"Angles in degrees: they reach {largest:.4g}.")
        return "deg"
    if table.are_joint_states(columns):
        return "rad"
    if all(_IN_RADIANS.search(table.names[i]) for i in columns):
        table.notes.append("Angles in rad, as such columns are defined.")
        return "rad"
    raise TableError(
        f"{table.path}: are the angles in degrees or in radians? They reach {largest:.4g} in "
        "the first rows, and the header does not say; say it with --unit deg or --unit rad."
    )
