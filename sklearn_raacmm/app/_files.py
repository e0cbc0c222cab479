"""Files of the command: arms by name or file, saved corrections, corrected tables."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import csv
import os
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from sklearn_raacmm.app._causes import columns_of_causes
from sklearn_raacmm.app._cells import TableError
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.correction import SavedCorrection, corrected_columns
from sklearn_raacmm.measurements import within_turn

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
        raise TableError(f"--arm: there is no file {source}, and as a {error}") from None


def load_correction(source):
    """Saved correction from its folder, or from a file in it."""
    folder = Path(source)
    if folder.is_file():
        folder = folder.parent
    if (folder / "model.joblib").is_file() and not (folder / "model.skops").is_file():
        raise TableError(
            f"--model: {folder} has no model.skops. Only these are loaded, since other files can "
            "run code: install skops (pip install skops) and learn again."
        )
    try:
        return SavedCorrection.load(folder)
    except (ValueError, OSError) as error:
        raise TableError(f"--model: {error}") from None


def files_of(source):
    """Files that loading a correction reads: no output may be one of them."""
    folder = Path(source)
    folder = folder.parent if folder.is_file() else folder
    return [folder / name for name in ("correction.json", "arm.json", "model.skops")]


def write_corrected(layout, correction, inputs, file):
    """Copy a table with the corrected points beside its columns, block by block.

    Parameters
    ----------
    layout : Layout
        Of the table.
    correction : SavedCorrection
    inputs : callable
        Takes angles in rad and their block of the table, returns what the model takes.
    file : text stream
        Written to, with the line ends that the stream makes.

    Returns
    -------
    int
        Number of rows.
    """
    dialect, n_rows = layout.dialect, 0
    writer = csv.writer(file, delimiter=dialect.separator or " ")
    writer.writerow([*layout.header, *_NEW_COLUMNS])
    for block, cells in layout.blocks_with_cells(_BLOCK_ROWS):
        X = inputs(in_rad(block), block)
        numbers = corrected_columns(correction.arm, correction.model, correction.facts, X)
        for row, values in zip(cells, numbers.tolist(), strict=True):
            writer.writerow([*row, *map(dialect.text, values)])
        n_rows += len(cells)
    return n_rows


@contextmanager
def open_beside(path, encoding):
    """A text stream whose file gets its name when it is complete."""
    path = Path(path)
    beside = path.with_name(f"{path.name}.{os.getpid():x}.tmp")
    try:
        with open(beside, "w", encoding=encoding, newline="") as file:
            yield file
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def in_rad(table):
    """Angles of a table in rad, within one turn."""
    angles = np.deg2rad(table.angles) if table.angle_unit == "deg" else table.angles
    return within_turn(angles)


def table_options(options, arm, points=None, labelled=True):
    """Options of `read_table` as the command line has them."""
    if points and not Path(points).is_file():
        points = points.split(",")
        if len(points) != 3:
            raise TableError(
                f"--points needs three columns, such as x,y,z, or a file that is there, got "
                f"{options.points!r}."
            )
    counts = options.counts_per_turn
    if counts is not None:
        counts = [number_of(text) for text in counts.split(",")]
        counts = counts[0] if len(counts) == 1 else counts
    return {
        "angles": options.angles.split(",") if options.angles else None,
        "points": points,
        "position": options.position if labelled else None,
        "angle_unit": options.unit,
        "labelled": labelled,
        "joint_names": arm.names,
        "counts_per_turn": counts,
        "sheet": options.sheet,
        "others": columns_of_causes(options).values(),
    }


def number_of(text):
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise TableError(f"{text!r} is not a number.") from None
