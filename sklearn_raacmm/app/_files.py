"""Files of the command: arms by name or file, saved corrections, corrected tables."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import csv
import io
import os
import warnings
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from sklearn_raacmm.app._cells import TableError, parse_number
from sklearn_raacmm.app._tables import Layout
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.correction import Correction
from sklearn_raacmm.measurements import within_turn
from sklearn_raacmm.utils import numbered_rows

# Rows corrected at a time: some ten MB, whatever the size of the file.
_BLOCK_ROWS = 8192
# Standard deviations of coordinates in the base frame, of the deviation within a position, and of a
# distance of 1 m from here.
_NEW_COLUMNS = (
    *(f"{axis} [mm]" for axis in "xyz"),
    *(f"sd {axis} [mm]" for axis in "xyz"),
    *(f"sd {axis} within position [mm]" for axis in "xyz"),
    "sd of 1 m [mm]",
)
# What `learn` and the later words write into a folder.
WRITTEN = (
    "report.html", "model.skops", "arm.json", "correction.json", "card.md", "corrected.csv",
)  # fmt: skip
# How many of them there are by `--std`.
_N_COLUMNS = {"no": 3, "point": 6, "all": len(_NEW_COLUMNS)}


def load_arm(source, base=None, tip=None):
    """Arm from a JSON file, a URDF or the name of a built-in one."""
    path = Path(source)
    if path.suffix.lower() in (".urdf", ".yaml", ".yml"):
        return Arm.from_urdf(path, base=base, tip=tip)
    if base or tip:
        raise TableError("--base and --tip name links of a URDF, and none is given.")
    if path.exists():
        return Arm.from_json(path)
    try:
        return Arm.from_name(str(source))
    except ValueError as error:
        raise TableError(f"there is no file {source}, and as a {error}") from None


def load_correction(source) -> Any:
    """Saved correction from its folder, or from a file in it."""
    try:
        return Correction.load(correction_files(source)[0].parent)
    except (ValueError, OSError) as error:
        raise TableError(f"--model: {error}") from None


def correction_files(source):
    """Files that loading a correction reads: no output may be one of them."""
    folder = Path(source)
    folder = folder.parent if folder.is_file() else folder
    return [folder / name for name in ("correction.json", "arm.json", "model.skops")]


def write_corrected(layout, correction, options, file, std="all"):
    """Copy a table with the corrected points beside its columns, block by block.

    Each row is corrected by its probe; `std` says which standard deviations are written. Returns
    the number of rows, and the largest angle of each joint (1, n_joints) in their unit.
    """
    source, n_rows, largest = layout.source, 0, 0.0
    writer = csv.writer(file, delimiter=source.separator or " ")
    writer.writerow([*layout.header, *_NEW_COLUMNS[: _N_COLUMNS[std]]])
    columns = find_cause_columns(options)
    columns = {name: column for name, column in columns.items() if name in correction.causes}
    for block, cells in layout.blocks(_BLOCK_ROWS):
        largest = np.maximum(largest, np.abs(block.angles).max(axis=0, keepdims=True))
        X = correction.inputs(in_rad(block), read_causes(block, columns))
        new = _corrected(correction, X, block, options, std)
        for row, values in zip(cells, new.tolist(), strict=True):
            writer.writerow([*row, *map(source.text, values)])
        n_rows += len(cells)
    return n_rows, largest


def corrected_file(layout, correction, options):
    """Content of the corrected table, by the name of its file."""
    file = io.StringIO(newline="")
    write_corrected(layout, correction, options, file)
    return {"corrected.csv": file.getvalue().encode(layout.source.encoding)}


def _corrected(correction, X, block, options, std):
    """The new columns of a block, each row by its probe."""
    tools, new = read_labels(block, options, "tool"), np.empty((len(X), _N_COLUMNS[std]))
    for tool in [None] if tools is None else np.unique(tools):
        rows = slice(None) if tool is None else tools == tool
        with numbered_rows(block.rows[rows]):
            one = correction if tool is None else correction.with_tool(tool)
            if std == "no":  # without standard deviations it takes less time
                joints = X[rows, : one.arm.n_joints]
                new[rows] = one.arm.forward(joints) - one.model.predict(X[rows])
            else:
                new[rows] = one.columns(X[rows])[:, : new.shape[1]]
    return new


@contextmanager
def open_beside(path, encoding, stdout=None):
    """A text stream whose file gets its name when it is complete; without it, it is kept."""
    if path == "-":
        yield stdout
        return
    path = Path(path)
    beside = path.with_name(f"{path.name}.{os.getpid():x}.tmp")
    try:
        with open(beside, "w", encoding=encoding, newline="") as file:
            yield file
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
    try:
        beside.replace(path)
    except OSError as error:
        said = f"{path} cannot be replaced ({error}); its content is in {beside}."
        raise OSError(said) from None


def in_rad(table):
    """Angles of a table in rad, within one turn."""
    return within_turn(np.deg2rad(table.angles) if table.angle_unit == "deg" else table.angles)


def print_notes(notes):
    """Say what the user should know, beside the results; --quiet leaves it out."""
    for note in notes:
        warnings.warn(note, stacklevel=2)


def find_rows(options, arm, labelled=True):
    """Layout of the table that the options name."""
    points = getattr(options, "points", None)
    labels = getattr(options, "tool", None), getattr(options, "block", None)
    if points and not Path(points).is_file():
        points = points.split(",")
        if len(points) != 3:
            needed = "three columns, such as x,y,z, or a file that is there"
            raise TableError(f"--points needs {needed}, got {options.points!r}.")
    counts = options.counts_per_turn
    if counts is not None:
        counts = [parse_number(text) for text in counts.split(",")]
    return Layout(
        options.table,
        arm.n_joints,
        angles=options.angles.split(",") if options.angles else None,
        points=points,
        position=options.position if labelled else None,
        angle_unit=options.unit,
        labelled=labelled,
        joint_names=arm.names,
        counts_per_turn=counts,
        sheet=options.sheet,
        others=[*find_cause_columns(options).values(), *filter(None, labels)],
    )


def parse_vector(option, text):
    """The three numbers of an option such as ``--probe X,Y,Z``."""
    vector = [parse_number(cell) for cell in text.split(",")]
    if len(vector) != 3:
        raise TableError(f"{option} needs three numbers, such as 0,0,1, got {text!r}.")
    return vector


# -- causes: what the options --extra, --tool and --block name -------------------------------------


def find_cause_columns(options):
    """Column of the table of each cause: `--extra NAME` or `--extra NAME=COLUMN`, as a dict."""
    pairs = [text.partition("=")[::2] for text in getattr(options, "extra", None) or ()]
    return {name.strip(): column.strip() or name.strip() for name, column in pairs}


def read_causes(table, columns):
    """Numbers of the causes in a table, or in a block of one; times in seconds."""
    return {name: _numbers(table, column) for name, column in columns.items()}


def _numbers(table, column):
    values = table.others[column]
    if values.dtype.kind == "f":
        return values
    times = []
    for row, text in zip(table.rows, values.tolist(), strict=True):
        try:
            times.append(datetime.fromisoformat(text).timestamp())
        except ValueError:
            raise TableError(
                f"row {row}, column {column!r}: {text!r} is neither a number nor a time such as "
                "2024-05-31 12:30:00."
            ) from None
    return np.array(times)


def read_labels(table, options, name):
    """Labels in the column that the option `name`, tool or block, names, (n,); None without it."""
    column = getattr(options, name, None)
    if column is None:
        return None
    return np.array([text_of_label(label) for label in table.others[column].tolist()])


def text_of_label(cell):
    """Label in a cell, the same whether its block of the table holds numbers only or not."""
    try:
        number = float(cell)
    except ValueError:
        return cell
    return str(int(number)) if number.is_integer() else repr(number)


def find_unnamed_probe(saved):
    """Sentence for rows that do not name which of the learnt probes they are of, or ""."""
    tools, own = saved.tools, saved.arm.probe.tolist()
    if len(tools) < 2 or own not in tools.values():
        return ""
    name = next(name for name, probe in tools.items() if probe == own)
    return f"this correction was learnt with the tools {', '.join(tools)}, and {name} is in use"
