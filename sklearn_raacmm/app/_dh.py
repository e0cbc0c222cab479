"""Denavit-Hartenberg tables as files, and a workbook to fill in."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import io
from pathlib import Path
from typing import Any

import numpy as np

from sklearn_raacmm.app._cells import TableError
from sklearn_raacmm.app._columns import Columns
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
    table = Columns(path, 3)
    found = {field: _find_column(table, words) for field, words in _COLUMNS.items()}
    missing = [field for field in ("a", "alpha", "d") if found[field] is None]
    if missing:
        raise TableError(f"{path} has no column {missing[0]!r}; it has {table}.")
    rows = list(table.rows([found["a"]]))
    values = {}
    for field, column in found.items():
        if field == "names" and column is not None:
            values[field] = table.labels(rows, column).tolist()
        elif column is not None:
            usual = "deg" if field in _ANGLES else "mm"
            values[field] = _read_column(table, rows, column, usual)
    low, high = values.pop("low", None), values.pop("high", None)
    if low is not None and high is not None:
        values["limits"] = list(zip(low, high, strict=True))
    twists = values["alpha"] if convention == "standard" else values["alpha"][1:]
    pose = usual_pose(len(rows), len(rows) > 2 and abs(np.sin(twists[1])) < 1e-9, convention)
    return Arm(**values, **pose, convention=convention, probe=probe, name=Path(path).stem)


def _find_column(table, words):
    """The column of the first of these names that the table has, or None."""
    return next((table.names.index(word) for word in words if word in table.names), None)


def _read_column(table, rows, column, usual_unit):
    """Numbers of a column in mm or rad; the unit is that of its name, or else the usual one."""
    units = ("deg", "rad") if usual_unit == "deg" else ("mm", "m")
    unit = table.units[column] or usual_unit
    if unit not in units:
        raise TableError(f"{table.path}: the column {table.header[column]!r} is in {unit}.")
    return (_FACTORS[unit] * table.numbers(rows, [column])[:, 0]).tolist()


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
