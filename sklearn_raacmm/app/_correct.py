"""The word ``correct``, and corrected tables: nothing is imported here that this does not need."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import csv
import io
import os
from contextlib import contextmanager, nullcontext
from pathlib import Path

import numpy as np

from sklearn_raacmm.app._files import check_outputs, load_correction, print_notes
from sklearn_raacmm.app._given import Given, find_cause_columns, find_unnamed_probe, in_rad
from sklearn_raacmm.app._sources import BLOCK_ROWS, TableError
from sklearn_raacmm.utils import Finding

# Endings of files that no CSV may have.
_NO_CSV = (".xlsx", ".xlsm", ".xls", ".ods", ".parquet", ".json", ".jsonl")
# Standard deviations of coordinates in the base frame, of the deviation within a position, and of a
# distance of 1 m from here.
_NEW_COLUMNS = (
    *(f"{axis} [mm]" for axis in "xyz"),
    *(f"sd {axis} [mm]" for axis in "xyz"),
    *(f"sd {axis} within position [mm]" for axis in "xyz"),
    "sd of 1 m [mm]",
)
# How many of them there are by `--std`.
_N_COLUMNS = {"no": 3, "point": 6, "all": len(_NEW_COLUMNS)}


def correct(options):
    """Correct a table of any length."""
    if options.out != "-":
        if Path(options.out).suffix.lower() in _NO_CSV:
            raise TableError(f"--out is written as CSV, and {options.out} says something else.")
        check_outputs(options, [options.out])
    saved = load_correction(options.model)
    print_notes([saved.verdict] * (not saved.helps))
    if unknown := find_cause_columns(options).keys() - saved.causes.keys():
        raise TableError(
            f"--extra names {', '.join(map(repr, sorted(unknown)))}, and this correction takes "
            f"{', '.join(saved.causes) or 'no cause'}: leave it away, or mend the name."
        )
    if not options.tool and (unnamed := find_unnamed_probe(saved)):
        raise TableError(f"{unnamed}: name the column of the tool of each row by --tool.")
    given = Given(options, saved.arm, labelled=False)
    layout = given.layout
    print_notes(layout.notes)
    to_file = open_beside(options.out, layout.source.encoding)
    with nullcontext(options.stdout) if options.out == "-" else to_file as file:
        n_rows, largest = write_corrected(given, saved, file, options.std)
    saved.arm.check_angles(largest, layout.angle_unit)
    print(f"{n_rows} rows corrected, written to {options.out}")
    return 0, {"rows": n_rows}


def write_corrected(given, correction, file, std="all"):
    """Copy a table with the corrected points beside its columns, block by block.

    Each row is corrected by its probe; `std` says which standard deviations are written. Returns
    the number of rows, and the largest angle of each joint (1, n_joints) in their unit.
    """
    layout, source, width = given.layout, given.layout.source, _N_COLUMNS[std]
    n_rows, largest = 0, 0.0
    writer = csv.writer(file, delimiter=source.separator or " ")
    plain = list if given.options.formulas else source.plain
    writer.writerow([*plain(layout.header), *_NEW_COLUMNS[:width]])
    for block, cells in layout.blocks(BLOCK_ROWS):
        largest = np.maximum(largest, np.abs(block.angles).max(axis=0, keepdims=True))
        X = correction.inputs(in_rad(block), given.causes(block))
        new = np.empty((len(X), width))
        tools = given.labels(block, "tool")
        for tool in [None] if tools is None else np.unique(tools):
            rows = slice(None) if tool is None else tools == tool
            with Finding.numbered(block.rows[rows]):
                one = correction if tool is None else correction.with_tool(tool)
                if std == "no":  # without standard deviations it takes less time
                    points = one.arm.forward(X[rows, : one.arm.n_joints])
                    new[rows] = points - one.model.predict(X[rows])
                else:
                    new[rows] = one.columns(X[rows])[:, :width]
        if isinstance(cells[0], str):  # lines, of which no cell needs quotation marks
            line = source.separator.join(["%s", *["%.6f"] * width]) + "\r\n"
            pairs = zip(cells, new.tolist(), strict=True)
            file.writelines([line % (text, *values) for text, values in pairs])
        else:
            for row, values in zip(cells, new.tolist(), strict=True):
                writer.writerow([*plain(row), *map(source.text, values)])
        n_rows += len(cells)
    return n_rows, largest


def corrected_file(given, correction):
    """Content of the corrected table, by the name of its file."""
    file = io.StringIO(newline="")
    write_corrected(given, correction, file)
    return {"corrected.csv": file.getvalue().encode(given.layout.source.encoding)}


@contextmanager
def open_beside(path, encoding):
    """A text stream whose file gets its name when it is complete; without it, it is kept."""
    beside = Path(f"{path}.{os.getpid():x}.tmp")
    try:
        with open(beside, "w", encoding=encoding, newline="") as file:
            yield file
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
    try:
        beside.replace(path)
    except OSError as error:
        text = f"{path} cannot be replaced ({error}); its content is in {beside}."
        raise OSError(text) from None
