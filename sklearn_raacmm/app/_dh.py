"""Denavit-Hartenberg tables as files, and a workbook to fill in."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import io
from pathlib import Path
from typing import Any

import numpy as np

from sklearn_raacmm.app._cells import TableError
from sklearn_raacmm.app._columns import find_header, split_unit
from sklearn_raacmm.app._sources import find_source
from sklearn_raacmm.arm import Arm, usual_pose
from sklearn_raacmm.utils import write_whole

# Names that drawings and papers give the columns; the first three are needed.
_COLUMNS = {
    "a": ("a", "r", "link length", "a_i", "a_i-1"),
    "alpha": ("alpha", "twist", "alpha_i", "alpha_i-1"),
    "d": ("d", "joint offset", "d_i"),
    "theta_offset": ("theta_offset", "theta offset", "offset", "theta", "theta0"),
    "joint_signs": ("sign", "joint_signs", "direction"),
    "low": ("lower", "min", "low"),
    "high": ("upper", "max", "high"),
    "names": ("joint", "name", "joint name"),
}
_ANGLES = ("alpha", "theta_offset", "low", "high")
_FACTORS = {"mm": 1.0, "m": 1000.0, "deg": np.pi / 180, "rad": 1.0}


def read_dh(path, convention="standard", probe=(0.0, 0.0, 0.0)):
    """Arm of a table, text or a spreadsheet, with one row for each joint.

    Columns are a, alpha, d and, if there are any, theta_offset, sign, lower, upper and joint, in mm
    and degrees or what the header says; the probe (3,) is in mm.
    """
    dialect = find_source(path, 3)
    header, header_row, _ = find_header(dialect, 3)
    names, units = zip(*map(split_unit, header), strict=True)
    found = {
        field: next((names.index(word) for word in words if word in names), None)
        for field, words in _COLUMNS.items()
    }
    missing = [field for field in ("a", "alpha", "d") if found[field] is None]
    if missing:
        raise TableError(f"{path} has no column {missing[0]!r}; it has {', '.join(header)}.")
    rows = [(number, cells) for number, cells in dialect.rows() if number > header_row]
    values = {}
    for field, column in found.items():
        if column is None:
            continue
        if field == "names":
            values[field] = [str(cells[column]) for _, cells in rows if column < len(cells)]
            continue
        unit = units[column] or ("deg" if field in _ANGLES else "mm")
        if unit not in (("deg", "rad") if field in _ANGLES else ("mm", "m")):
            raise TableError(f"{path}: the column {header[column]!r} is in {unit}.")
        numbers = []
        for number, cells in rows:
            value = dialect.number(cells[column]) if column < len(cells) else None
            if value is None:
                raise TableError(f"{path}: row {number}, column {header[column]!r}: no number.")
            numbers.append(_FACTORS[unit] * value)
        values[field] = numbers
    ends = [values.pop(end, None) for end in ("low", "high")]
    if all(ends):
        values["limits"] = list(zip(*ends, strict=True))
    twists = values["alpha"] if convention == "standard" else values["alpha"][1:]
    pose = usual_pose(len(rows), len(rows) > 2 and abs(np.sin(twists[1])) < 1e-9, convention)
    return Arm(**values, **pose, convention=convention, probe=probe, name=Path(path).stem)


def write_template(path):
    """Write a workbook to fill in: the arm's table, and the poses of a single-point test."""
    try:
        import openpyxl
    except ImportError:
        raise TableError("To write a workbook, install openpyxl: pip install openpyxl.") from None
    book = openpyxl.Workbook()
    sheet: Any = book.active
    sheet.title = "arm"
    sheet.append(["joint", "a [mm]", "alpha [deg]", "d [mm]", "theta offset [deg]", "sign"])
    example = Arm.from_lengths("2-2-2", 375, 750, 500, 100)
    for i in range(6):
        alpha = float(np.rad2deg(example.alpha[i]))
        sheet.append([f"q{i + 1}", float(example.a[i]), alpha, float(example.d[i]), 0.0, 1])
    poses = book.create_sheet("poses")
    poses.append(["cone", *(f"q{i} [deg]" for i in range(1, 7))])
    sheet.freeze_panes = poses.freeze_panes = "B2"
    content = io.BytesIO()
    book.save(content)
    write_whole({path: content.getvalue()})
