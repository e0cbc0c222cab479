"""Records of checks in a file: the lines of a control chart."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import csv
import json
from os import PathLike
from pathlib import Path
from typing import Any

# What a record holds, in the order of the columns, and what each value is.
_FIELDS = {
    "date": str,
    "n_poses": int,
    "mean_mm": float,
    "mean_low_mm": float,
    "mean_high_mm": float,
    "range_mm": float,
    "range_low_mm": float,
    "range_high_mm": float,
    "p_value": float,
    "suspect": str,
}


def append_record(path, record):
    """Append one record to a CSV file, or to one of a JSON object in each line."""
    path = Path(path)
    is_new = not path.exists() or path.stat().st_size == 0
    if not is_new:
        read_check_records(path)  # refuses a file of anything else
    with path.open("a", encoding="utf-8", newline="") as file:
        if path.suffix.lower() != ".csv":
            file.write(json.dumps(record) + "\n")
            return
        writer = csv.DictWriter(file, _FIELDS)
        if is_new:
            writer.writeheader()
        writer.writerow(record)


def read_check_records(path: str | PathLike[str]) -> list[Any]:
    """Read the records of checks that :meth:`~sklearn_raacmm.CorrectionCheck.append_to` wrote.

    Parameters
    ----------
    path : str or path-like
        A CSV file if its name ends in .csv, else one JSON object in each line.

    Returns
    -------
    list of dict
        In the order of the file.

    Raises
    ------
    ValueError
        If a line is no such record.

    Examples
    --------
    >>> from sklearn_raacmm import read_check_records
    >>> records = read_check_records("checks_of_arm_7.csv")  # doctest: +SKIP
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is not the record of checks: it is no text in UTF-8.") from None
    records = []
    is_csv = path.suffix.lower() == ".csv"
    lines: Any = csv.DictReader(text.splitlines()) if is_csv else text.splitlines()
    for number, line in enumerate(lines, start=2 if is_csv else 1):
        try:
            line = line if is_csv else json.loads(line)
            records.append({name: kind(line[name]) for name, kind in _FIELDS.items()})
        except (ValueError, KeyError, TypeError):
            raise ValueError(f"line {number} of {path} is not the record of a check.") from None
    return records
