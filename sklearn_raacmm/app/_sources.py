"""Rows of whatever holds a table: text, spreadsheets, lines of JSON, and programs of robots."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import json
import re
from contextlib import closing, contextmanager
from functools import partial
from itertools import chain, islice
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from sklearn_raacmm.app._cells import (
    Dialect,
    TableError,
    check_installed,
    clean,
    find_dialect,
    find_encoding,
)

_LOOKED_AT = 300
# A record of a program stands within so many, or the file is none.
_HEAD_CHARACTERS = 1 << 20
SHEETS = (".xlsx", ".xlsm")
_ARRAYS = (".npy", ".npz", ".mat")
_VALUE = r"([+-]?\d*\.?\d+(?:[eE][+-]?\d+)?)"
# Programs and logs of controllers: what they are, a record with its name and its body, and the
# joints in the body. All write degrees. Names are bounded, so that no long cell takes minutes.
_PROGRAMS = (
    # KUKA System Software, KRL reference: structures AXIS and E6AXIS.
    (
        "KUKA KRL",
        r"(?:\b(\w{1,80})\s?=\s?)?\{(?:E6AXIS:|AXIS:)?\s?(A1\s[^{}]*)\}",
        rf"A\d\s+{_VALUE}",
    ),
    # KUKA.RobotSensorInterface: element AIPos, the axes' actual positions.
    ("KUKA RSI", r"<(AIPos)\s([^>]*)>", rf'A\d="{_VALUE}"'),
    # ABB, RAPID data types: jointtarget is [robax, extax].
    (
        "ABB RAPID",
        r"(?:\b(\w{1,80})\s?:=\s?)?\[\[([^][]*)\]\s?,\s?\[[^][]*\]\]",
        rf"(?:^|,)\s*{_VALUE}",
    ),
    # Fanuc: section /POS of an LS file in joint representation.
    ("Fanuc LS", r"P\[(\d+(?:\s*:\s*\"[^\"]*\")?)\]\s*\{([^{}]*)\}", rf"J\d\s*=\s*{_VALUE}\s*deg"),
)


def find_source(path, n_numbers, sheet=None):
    """How the rows of a file are read, of which those of data hold at least so many numbers.

    `sheet` is the name or number, from 1, of a spreadsheet's; None: the first with such rows.
    """
    path = Path(path)
    if not path.is_file():
        raise TableError(f"There is no file {path}.")
    if path.suffix.lower() in SHEETS:
        return _find_sheet(path, n_numbers, sheet)
    if sheet is not None:
        raise TableError(f"--sheet is for spreadsheets, and {path} is none.")
    if path.suffix.lower() in _ARRAYS:
        return _arrays(path, n_numbers)
    if path.suffix.lower() == ".jsonl":
        return _json_lines(path)
    return _program(path, n_numbers) or find_dialect(path, n_numbers)


# -- spreadsheets ---------------------------------------------------------------------------------


def _find_sheet(path, n_numbers, wanted):
    """The sheet that is wanted, or the first with rows of so many numbers; and its decimal sign."""
    with _open_book(path) as book:
        names = [sheet.title for sheet in book.worksheets]  # of charts there are none
    candidates = [name for name in names if wanted in (None, name)]
    candidates = candidates or [name for i, name in enumerate(names, 1) if wanted == str(i)]
    if not candidates:
        raise TableError(f"{path} has no sheet {wanted!r}; it has {', '.join(names)}.")
    for name in candidates:
        others = ", ".join(other for other in names if other != name)
        more = f" (--sheet takes another: {others})" if others else ""
        what = f"Spreadsheet, sheet {name!r}{more}"
        read = partial(sheet_rows, path, name)
        rows = [cells for _, cells in islice(read(), _LOOKED_AT)]
        dialects = [
            Dialect(path, separator=separator, decimal=decimal, what=what, read=read)
            for separator, decimal in ((",", "."), (";", ","))
        ]
        counts = [[dialect.count(cells) for cells in rows] for dialect in dialects]
        found = [sum(count for count in one if count >= n_numbers) for one in counts]
        if any(found):
            return dialects[found.index(max(found))]
    sheets = f"the sheet{'s' * (len(candidates) > 1)} {', '.join(candidates)}"
    raise TableError(f"{path}: no row with {n_numbers} numbers was found in {sheets}.")


def sheet_rows(path, name):
    """Yield (row number from 1, cells) of each row of a sheet that is not empty."""
    with _open_book(path) as book:
        sheet = book[name]
        sheet.reset_dimensions()  # some programs state fewer rows than they write
        for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
            cells = [clean(cell) for cell in row]
            if any(cell != "" for cell in cells):
                yield number, cells


@contextmanager
def _open_book(path):
    """A workbook, which is closed afterwards."""
    check_installed("openpyxl")
    import openpyxl

    if not path.is_file():
        raise TableError(f"There is no file {path}.")
    try:
        # A file of our own: of a sheet that is not read to its end some versions leave theirs open.
        with (
            open(path, "rb") as file,
            closing(openpyxl.load_workbook(file, read_only=True, data_only=True)) as book,
        ):
            yield book
    except TableError:
        raise
    except Exception as error:  # a zip file of anything, damaged XML, or no zip file
        raise TableError(f"{path} is not a spreadsheet that can be read: {error}.") from None


# -- lines of JSON --------------------------------------------------------------------------------


def _json_lines(path):
    """A table of messages, one a line; lists in them become columns of their own."""
    rows = []
    try:
        for line in filter(str.strip, path.read_text("utf-8-sig").splitlines()):
            rows.append(row := {})
            for name, value in json.loads(line).items():
                values = enumerate(value) if isinstance(value, list) else [("", value)]
                row |= {f"{name}{i}": clean(cell) for i, cell in values}
    except (ValueError, AttributeError) as error:  # no JSON, or no message with names
        raise TableError(f"{path} cannot be read: {error}.") from None
    names = list(dict.fromkeys(chain(*rows)))
    cells = [names, *([row.get(name, "") for name in names] for row in rows)]
    return Dialect(path, what="Lines of JSON", read=partial(enumerate, cells))


# -- arrays of NumPy and MATLAB -------------------------------------------------------------------


def _arrays(path, n_numbers):
    """A table of the arrays of a file that have as many rows as the longest one."""
    try:
        if path.suffix.lower() == ".mat":
            content = loadmat(path, squeeze_me=True)
        else:
            loaded = np.load(path, allow_pickle=False)
            content = dict(loaded) if path.suffix.lower() == ".npz" else {"": loaded}
    except NotImplementedError:  # HDF5
        raise TableError(f"{path}: files of MATLAB 7.3 are not read; save(..., '-v7').") from None
    except Exception as error:  # no such file, or one that would have to be unpickled
        raise TableError(f"{path} cannot be read: {error}.") from None
    columns: dict = {}
    for name, values in content.items():
        if name.startswith("__") or not np.ndim(values):
            continue
        if values.dtype.names:
            columns |= {field: values[field] for field in values.dtype.names}
        elif values.ndim == 1:
            columns[name] = values
        else:
            columns |= {f"{name}{i}": column for i, column in enumerate(values.T, 1)}
    n_rows = max(map(len, columns.values()), default=0)
    columns = {k: v for k, v in columns.items() if len(v) == n_rows and np.ndim(v) == 1}
    if len(columns) < n_numbers:
        raise TableError(f"{path}: no rows of {n_numbers} numbers were found in its arrays.")
    cells = [[clean(cell) for cell in column.tolist()] for column in columns.values()]
    names = list(columns) if any(name.strip("0123456789") for name in columns) else []
    rows = [(0, names)] * bool(names) + list(enumerate(map(list, zip(*cells, strict=True)), 1))
    return Dialect(path, what="Arrays", read=partial(iter, rows))


# -- programs of robots ---------------------------------------------------------------------------


def _program(path, n_joints):
    """A program or log of a robot's controller that holds joint positions; None if it is none."""
    encoding = find_encoding(path)
    with open(path, encoding=encoding, newline="") as file:
        head = file.read(_HEAD_CHARACTERS)
    for what, record, value in _PROGRAMS:
        if not re.search(record, head):
            continue
        text, rows = path.read_text(encoding), []
        for match in re.finditer(record, text):
            values = re.findall(value, match[2])
            # Coupled or external axes may follow the robot's own.
            if len(values) >= n_joints:
                line = text.count("\n", 0, match.start()) + 1
                rows.append((line, [match[1] or f"line {line}", *values[:n_joints]]))
        if rows:
            names = ["name", *(f"A{i} [deg]" for i in range(1, n_joints + 1))]
            # Points of one place are named by it: P1_1, P1_2, P2_1 and so on.
            own = (re.sub(r'^\d+\s*:\s*"(.+)"', r"\1", cells[0]) for _, cells in rows)
            places = [re.sub(r"[\W_]*\d+\W*$", "", name) for name in own]
            if min(map(places.count, places)) > 1 < len(set(places)):
                names += ["position (its name without the last number)"]
                for (_, cells), place in zip(rows, places, strict=True):
                    cells.append(place)
            rows.insert(0, (0, names))
            return Dialect(path, what=f"{what}, degrees", read=partial(iter, rows))
    return None
