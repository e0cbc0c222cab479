"""The word ``correct``: a module of its own, so that it imports nothing that it does not need."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from contextlib import nullcontext
from pathlib import Path

from sklearn_raacmm.app._files import (
    correction_files,
    find_cause_columns,
    find_rows,
    find_unnamed_probe,
    load_correction,
    open_beside,
    print_notes,
    write_corrected,
)
from sklearn_raacmm.app._sources import TableError
from sklearn_raacmm.arm import check_angles
from sklearn_raacmm.utils import check_places

# Endings of files that no CSV may have.
_NO_CSV = (".xlsx", ".xlsm", ".xls", ".ods", ".parquet", ".json", ".jsonl")


def correct(options):
    """Correct a table of any length."""
    if options.out != "-":
        if Path(options.out).suffix.lower() in _NO_CSV:
            raise TableError(f"--out is written as CSV, and {options.out} says something else.")
        check_places([options.out], [options.table, *correction_files(options.model)])
    saved = load_correction(options.model)
    print_notes([saved.verdict] * (not saved.helps))
    if unknown := find_cause_columns(options).keys() - saved.causes.keys():
        raise TableError(
            f"--extra names {', '.join(map(repr, sorted(unknown)))}, and this correction takes "
            f"{', '.join(saved.causes) or 'no cause'}: leave it away, or mend the name."
        )
    if not options.tool and (unnamed := find_unnamed_probe(saved)):
        raise TableError(f"{unnamed}: name the column of the tool of each row by --tool.")
    layout = find_rows(options, saved.arm, labelled=False)
    print_notes(layout.notes)
    to_file = open_beside(options.out, layout.source.encoding)
    with nullcontext(options.stdout) if options.out == "-" else to_file as file:
        n_rows, largest = write_corrected(layout, saved, options, file, options.std)
    check_angles(largest, saved.arm.joint_types, layout.angle_unit)
    print(f"{n_rows} rows corrected, written to {options.out}")
    return 0, {"rows": n_rows}
