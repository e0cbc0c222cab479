"""Rows of whatever holds a table: text, spreadsheets and arrays; records are of `_records`.

Of text encoding, separator and decimal sign are found.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import codecs
import contextlib
import csv
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np

from sklearn_raacmm.app._records import HEAD_CHARACTERS, find_records
from sklearn_raacmm.utils import check_unpacked

# Lines looked at to find separator and decimal sign, and characters decoded at a time.
_LOOKED_AT = 300
_CHUNK = 1 << 20
# From the least ambiguous on; None is any white space.
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", None: "blanks"}
_DECIMALS = {".": "point", ",": "comma"}
# Fortran writes exponents with a D.
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][+-]?\d+)?")
_FLOAT = str.maketrans(",dD", ".ee")
# A number with a unit in its cell.
_WITH_UNIT = re.compile(
    rf"({_NUMBER.pattern})\s*(?P<unit>deg|degrees?|°|º|rad|mrad|gon|mm|m|inch|in)", re.IGNORECASE
)
# An angle in degrees, minutes and seconds, and a number whose thousands are parted.
_SEXAGESIMAL = re.compile(r"""([+-]?)(\d+)\s?°\s?(\d+)\s?'\s?(\d+(?:[.,]\d*)?)\s?"?""")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:([.,' ])\d{3})(?:\1\d{3})*(?!\1)[.,]\d+")
_FORMULA = re.compile(r"[=+\-@].")
# What a number may be made of, so that `float` takes nothing else, such as "1_0" and "nan".
_NO_NUMBER = re.compile(r"[^0-9.eE+\-\n]")
_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
# Encodings of other scripts, each with signs of headers: degree, axis, joint, angle, place, point.
_SCRIPTS = {
    "gb18030": "度轴关节角位置点坐标序号", "cp932": "度軸関節角位置点座標番号",
    "big5": "度軸關節角位置點座標序號", "cp949": "도축관절각위치점좌표번호",
}  # fmt: skip
# Hard blanks, minus signs and primes are those of word processors, wide brackets of Asian ones.
_PLAIN = str.maketrans("\xa0\u2212\uff08\uff09\u2019\u2032\u2033", " -()''\"")
# A line under the header of a table in Markdown, whose rows may begin and end with bars.
_RULE = re.compile(r"[\s|:+-]*--[\s|:+-]*")
_BARS = re.compile(r"^\s*\|(.*)\|\s*$")
# Comments of loggers, NumPy, MATLAB and SpatialAnalyzer.
_COMMENT = re.compile(r"\s*(#+|//+|%+)\s*")
# Cells of a table: a choice, which 20 columns reach in the last row of a spreadsheet.
_MOST_CELLS = 20_000_000
# Rows or lines of a table that are in memory at a time: some MB.
BLOCK_ROWS = 8192
# Columns for each row of a table that has a line for each joint, at least.
_WIDER = 3
SHEETS = (".xlsx", ".xlsm")
_ARRAYS = (".npy", ".npz", ".mat")
# Logs of ROS 1 and ROS 2.
_BAGS = (".bag", ".mcap", ".db3")


Row = tuple[int, Sequence[Any]]  # its number and its cells


class TableError(ValueError):
    """A table that cannot be read, or not without further options."""


def check_installed(*names):
    """Refuse work that needs, perhaps in its last step, packages that are missing."""
    missing = [name for name in names if find_spec(name) is None]
    if missing:
        packages = " ".join(missing).replace("yaml", "pyyaml")
        raise TableError(f"{' and '.join(missing)} must be installed: pip install {packages}.")


def parse_number(text):
    """Number that somebody typed, with either decimal sign."""
    if not _NUMBER.fullmatch(text.strip()):
        raise TableError(f"{text!r} is not a number.")
    return float(text.strip().translate(_FLOAT))


@dataclass(frozen=True)
class Dialect:
    """How a file is written; `separator` and `decimal` of what is no text are those to write with.

    `table` has the rows, (row number, cells), of what is no text, or makes them when it is called;
    `what` names its kind.
    """

    path: Path
    encoding: str = "utf-8-sig"
    separator: str | None = ","
    decimal: str = "."
    what: str = ""
    table: Iterable[Row] | Callable[[], Iterable[Row]] | None = None

    def rows(self):
        """Yield (row number, cells) of each row that is not empty; lines of text count from 1."""
        if self.table is not None:
            yield from self.table() if callable(self.table) else self.table
            return
        with open(self.path, encoding=self.encoding, newline="") as file:
            yield from (row for row in self.split(file) if any(row[1]))

    def split(self, lines):
        """Yield (line number from 1, cells) of lines of text."""
        lines = (line.translate(_PLAIN) for line in lines)
        if self.separator == "|":
            lines = ("\n" if _RULE.fullmatch(line) else _BARS.sub(r"\1", line) for line in lines)
        if self.separator is None:
            # MATLAB ends the rows of a matrix by semicolons.
            yield from enumerate((line.rstrip("\r\n ;]").split() for line in lines), 1)
            return
        reader = csv.reader(lines, delimiter=self.separator, skipinitialspace=True)
        try:
            for cells in reader:
                yield reader.line_num, [cell.strip() for cell in cells]
        except csv.Error as error:  # such as a cell of 128 kB
            raise TableError(f"{self.path} cannot be read as a table: {error}.") from None

    def number(self, cell):
        """Number in a cell, or None."""
        if not isinstance(cell, str):
            return float(cell) if type(cell) in (int, float) else None
        if not _NUMBER.fullmatch(cell):
            if angle := _SEXAGESIMAL.fullmatch(cell):
                parts = (float(part.translate(_FLOAT)) for part in angle.groups()[1:])
                return float(f"{angle[1]}1") * sum(x / 60**i for i, x in enumerate(parts))
            if with_unit := _WITH_UNIT.fullmatch(cell):
                cell = with_unit[1]
            elif parted := _THOUSANDS.fullmatch(cell):
                cell = cell.replace(parted[1], "")
            else:
                return None
        if ("." if self.decimal == "," else ",") in cell:
            return None
        # As `_FLOAT` does, which takes four times as long.
        return float(cell.replace(",", ".").replace("d", "e").replace("D", "e"))

    def count(self, cells):
        """How many cells hold numbers."""
        return sum(self.number(cell) is not None for cell in cells)

    def numbers(self, cells):
        """Numbers of a column, NaN for a cell that holds none; fast for plain text."""
        with contextlib.suppress(TypeError, ValueError):  # of a spreadsheet, or no numbers
            text = "\n".join(cells)
            if self.decimal == "," and "." not in text:
                text = text.replace(",", ".")
            if not _NO_NUMBER.search(text):
                return np.fromiter(map(float, text.split("\n")), dtype=float)
        return np.array([self.number(cell) for cell in cells], dtype=float)

    def plain(self, cells):
        """Cells that no spreadsheet takes for formulas: what looks like one gets an apostrophe."""
        return [
            f"'{cell}" if _FORMULA.match(str(cell)) and not _NUMBER.fullmatch(str(cell)) else cell
            for cell in cells
        ]

    def text(self, value, digits=6):
        """Number as the file writes its numbers."""
        return f"{value:.{digits}f}".replace(".", self.decimal)

    def __str__(self):
        return self.what or (
            f"Columns parted by {_SEPARATORS[self.separator]}, decimal "
            f"{_DECIMALS[self.decimal]}s, {self.encoding}"
        )


def unit_in(cell):
    """Unit that stands behind the number in a cell, or ""."""
    match = _WITH_UNIT.fullmatch(str(cell))
    return match["unit"].lower() if match else "deg" * bool(_SEXAGESIMAL.fullmatch(str(cell)))


def clean(cell):
    """Cell of a spreadsheet as text has it."""
    if isinstance(cell, str):
        return cell.translate(_PLAIN).strip()
    return "" if cell is None else cell


def _check_size(n_cells):
    """Refuse what no table of measurements is as large as."""
    if n_cells > _MOST_CELLS:
        raise TableError(f"{n_cells} cells, more than the {_MOST_CELLS} that a table may have")


def strip_mark(cells: Sequence[object]) -> tuple[Sequence[object], bool]:
    """Cells of a line without the mark of a comment, and whether it has one."""
    mark = _COMMENT.match(str(cells[0]))
    if not mark:
        return cells, False
    rest = str(cells[0])[mark.end() :]
    return [*filter(None, [rest]), *cells[1:]], True


def find_source(path, n_numbers, sheet=None):
    """How the rows of a file are read, of which those of data hold at least so many numbers.

    `sheet` is the name or number, from 1, of a spreadsheet's; None: the first with such rows.
    """
    path, suffix = Path(path), Path(path).suffix.lower()
    is_bag = suffix in _BAGS or (path / "metadata.yaml").is_file()
    if not (is_bag or path.is_file()):
        raise TableError(f"There is no file {path}.")
    if suffix in SHEETS:
        return _find_sheet(path, n_numbers, sheet)
    if sheet is not None and not is_bag:
        raise TableError(f"--sheet is for spreadsheets, and {path} is none.")
    check_installed(*["yaml"] * (suffix in (".yaml", ".yml")), *["rosbags"] * is_bag)
    if suffix in _ARRAYS:
        return _arrays(path, n_numbers)
    try:
        if is_bag:
            from sklearn_raacmm.app._bags import read_bag

            read = read_bag(path, n_numbers, (sheet or "").split(","))
        else:
            encoding = find_encoding(path)
            with open(path, encoding=encoding, newline="") as file:
                head = file.read(HEAD_CHARACTERS)
            read = find_records(head, partial(path.read_text, encoding), n_numbers)
    except ValueError as error:
        raise TableError(f"{path}: {error}") from None
    if read is None:
        return find_dialect(path, n_numbers)
    what, names, rows = read
    return Dialect(path, what=what, table=[(0, names), *rows] if names else rows)


# -- text and spreadsheets ------------------------------------------------------------------------


def find_dialect(path, n_numbers):
    """How a file of text is written, by its first rows with at least so many numbers."""
    encoding = find_encoding(path)
    with open(path, encoding=encoding, newline="") as file:
        lines = [line for line in islice(file, _LOOKED_AT) if line.strip()]
    # Decimal commas between commas stand in quotation marks.
    quoted = any('"' in line for line in lines)
    dialects = [
        Dialect(path, encoding, separator, decimal)
        for separator, decimal in product(_SEPARATORS, _DECIMALS)
        if separator != decimal or quoted
    ]
    rows = [[next(one.split([line]), (1, []))[1] for line in lines] for one in dialects]
    best = _most_numbers(zip(dialects, rows, strict=True), n_numbers)
    if best is None:
        raise TableError(
            f"{path}: no row with {n_numbers} numbers was found; columns may be parted by "
            "semicolons, tabs, commas, bars or blanks."
        )
    return _turned(best, n_numbers)


def _turned(source, n_numbers):
    """The source; of a table with a line for each joint, its name first, that of its columns."""
    rows = [cells for _, cells in islice(source.rows(), _LOOKED_AT)]
    if len(rows) * _WIDER > min(map(len, rows)) or len({*map(len, rows)}) > 1:
        return source
    kinds = ["".join("n-"[source.number(cell) is None] for cell in cells) for cells in rows]
    n_joints = sum(bool(re.fullmatch("-n+", kind)) for kind in kinds)
    if n_joints < n_numbers or not all(re.fullmatch("-(n+|-+)", kind) for kind in kinds):
        return source
    columns = list(enumerate(zip(*rows, strict=True)))
    return replace(source, what="A line for each joint", table=columns)


def _most_numbers(candidates, n_numbers):
    """Of dialects, each with its rows, that with most rows of so many numbers; None without any."""

    def found(candidate):
        dialect, rows = candidate
        counts = [dialect.count(cells) for cells in rows]
        fitting = sum(count >= n_numbers for count in counts)
        # Blanks part columns only where nothing else does.
        return fitting > 0 and dialect.separator is not None, fitting, sum(counts)

    most, best = max(((found(one), one[0]) for one in candidates), key=lambda pair: pair[0])
    return best if most[1] else None


def find_encoding(path):
    """UTF-8 with or without its mark, UTF-16 with one, or else what Windows writes somewhere."""
    with open(path, "rb") as file:
        head = file.read(_CHUNK)
    marked = [name for mark, name in _MARKS.items() if head.startswith(mark)]
    for encoding in marked or ("utf-8", *_other_script(head), "cp1252"):
        with contextlib.suppress(UnicodeDecodeError), open(path, encoding=encoding) as file:
            while file.read(_CHUNK):
                pass
            return encoding
    raise TableError(
        f"{path} is no table of text in UTF-8, in UTF-16 with its mark, or in the encoding of "
        "Windows (cp1252): save it as .xlsx or CSV."
    )


def _other_script(head):
    """The encoding in which a file's beginning has most signs of headers in its script, if any.

    Latin letters with accents, decoded so, hardly ever give one of these signs.
    """
    shares = {}
    for encoding, signs in _SCRIPTS.items() if not head.isascii() else ():
        text = codecs.getincrementaldecoder(encoding)("replace").decode(head)
        known = [sign in signs for sign in text if not sign.isascii()]
        if any(known) and "\ufffd" not in text:
            shares[encoding] = np.mean(known)
    return sorted(shares, key=shares.__getitem__)[-1:]


def _find_sheet(path, n_numbers, wanted):
    """The sheet that is wanted, or the first with rows of so many numbers; and its decimal sign."""
    sheets = read_sheets(path)
    candidates = [name for name in sheets if wanted in (None, name)]
    candidates = candidates or [name for i, name in enumerate(sheets, 1) if wanted == str(i)]
    if not candidates:
        raise TableError(f"{path} has no sheet {wanted!r}; it has {', '.join(sheets)}.")
    for name in candidates:
        others = ", ".join(other for other in sheets if other != name)
        more = f" (--sheet takes another: {others})" if others else ""
        what, rows = f"Spreadsheet, sheet {name!r}{more}", sheets[name]
        some = [cells for _, cells in rows[:_LOOKED_AT]]
        point = Dialect(path, what=what, table=rows)
        comma = replace(point, separator=";", decimal=",")
        if best := _most_numbers([(point, some), (comma, some)], n_numbers):
            return best
    several = ", nor in ".join(candidates)
    raise TableError(f"{path}: no row with {n_numbers} numbers was found in the sheet {several}.")


def read_sheets(path):
    """Rows of each sheet of a spreadsheet by its name, each (row number from 1, cells)."""
    check_installed("openpyxl")
    import openpyxl

    if not path.is_file():
        raise TableError(f"There is no file {path}.")
    sheets, n_cells = {}, 0
    try:
        with open(path, "rb") as file:
            check_unpacked("the file", file)
            book = openpyxl.load_workbook(file, read_only=True, data_only=True)
            for sheet in book.worksheets:  # of charts there are none
                sheet.reset_dimensions()  # some programs state fewer rows than they write
                rows = sheets[sheet.title] = []
                for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
                    n_cells += len(row)
                    _check_size(n_cells)
                    cells = [clean(cell) for cell in row]
                    if any(cell != "" for cell in cells):
                        rows.append((number, cells))
    except Exception as error:  # a zip file of anything, damaged XML, or no zip file
        why = str(error).rstrip(".")
        raise TableError(f"{path} is not a spreadsheet that can be read: {why}.") from None
    return sheets


# -- arrays of NumPy and MATLAB -------------------------------------------------------------------


def _arrays(path, n_numbers):
    """A table of the arrays of a file that have as many rows as the longest one."""
    try:
        if path.suffix.lower() == ".mat":
            from scipy.io import loadmat, whosmat  # which takes half a second to import

            _check_size(sum(int(np.prod(shape)) for _, shape, _ in whosmat(path)))
            content = loadmat(path, squeeze_me=True)
        else:
            if path.suffix.lower() == ".npz":
                check_unpacked("the file", path)
            loaded = np.load(path, allow_pickle=False)
            content = {"": loaded} if isinstance(loaded, np.ndarray) else dict(loaded)
        columns = dict(_columns_of(content))
    except NotImplementedError:  # HDF5
        raise TableError(f"{path}: files of MATLAB 7.3 are not read; save(..., '-v7').") from None
    except Exception as error:  # no such file, or one that would have to be unpickled
        raise TableError(f"{path} cannot be read: {str(error).rstrip('.')}.") from None
    n_rows = max(map(len, columns.values()), default=0)
    columns = {name: values for name, values in columns.items() if len(values) == n_rows}
    if len(columns) < n_numbers:
        raise TableError(f"{path}: no rows of {n_numbers} numbers were found in its arrays.")
    names = list(columns) if any(name.strip("0123456789") for name in columns) else []
    rows = partial(_rows_of_arrays, names, list(columns.values()))
    return Dialect(path, what="Arrays", table=rows)


def _columns_of(content):
    """Yield names and columns (n,) of arrays: those of structures, too, and of rows for joints."""
    for name, values in content.items():
        values = np.asarray(values)  # a file of MATLAB has a few other things
        if fields := values.dtype.names:
            parts = (values[field] if values.ndim else values[field].item() for field in fields)
            yield from _columns_of(dict(zip(fields, parts, strict=True)))
        elif values.ndim == 1:
            yield name, values
        elif values.ndim == 2:
            columns = values if len(values) * _WIDER <= values.shape[1] else values.T
            yield from ((f"{name}{i}", column) for i, column in enumerate(columns, 1))


def _rows_of_arrays(names, columns):
    """Yield (row number, cells) of arrays (n,): a block at a time is made of objects.

    The names, if there are any, are row 0.
    """
    if names:
        yield 0, names
    for start in range(0, len(columns[0]), BLOCK_ROWS):
        some = (column[start : start + BLOCK_ROWS].tolist() for column in columns)
        for number, cells in enumerate(zip(*some, strict=True), start + 1):
            yield number, [clean(cell) for cell in cells]
