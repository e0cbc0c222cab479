"""Tables as loggers and spreadsheets write them: encoding, separator, decimal sign, cells."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import codecs
import csv
import re
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from sklearn_raacmm.utils import check_path

# Lines looked at to find separator and decimal sign, and bytes decoded at a time.
_SNIFFED_LINES = 300
_CHUNK_BYTES = 1 << 20
# From the least ambiguous on; None is any white space, where nothing else fits.
_SEPARATORS = (";", "\t", "|", ",", None)
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
SEPARATOR_NAMES = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", None: "blanks"}


class TableError(ValueError):
    """A table that cannot be read, or not without being told more."""


@dataclass(frozen=True)
class Dialect:
    """How a file is written; `separator` and `decimal` of a spreadsheet are those to write with."""

    path: Path
    encoding: str
    separator: str | None
    decimal: str
    is_sheet: bool = False

    def rows(self):
        """Yield (line number from 1, cells) of each line that is not empty."""
        if self.is_sheet:
            yield from _sheet_rows(self.path)
            return
        with open(self.path, encoding=self.encoding, newline="") as file:
            if self.separator is None:
                lines = ((i, line.split()) for i, line in enumerate(file, 1))
            else:
                reader = csv.reader(file, delimiter=self.separator)
                lines = ((reader.line_num, cells) for cells in reader)
            try:
                for number, cells in lines:
                    cells = [clean(cell) for cell in cells]
                    if any(cells):
                        yield number, cells
            except csv.Error as error:
                raise TableError(f"{self.path}: {error}.") from None

    def number(self, cell):
        """Number in a cell, or None."""
        if isinstance(cell, int | float) and not isinstance(cell, bool):
            return float(cell)
        if not isinstance(cell, str) or not _NUMBER.fullmatch(cell):
            return None
        if "," in cell:
            return float(cell.replace(",", ".")) if self.decimal == "," else None
        if "." in cell and self.decimal == ",":
            return None
        return float(cell)

    def text(self, value, digits=6):
        """Number as the file writes its numbers."""
        return f"{value:.{digits}f}".replace(".", self.decimal)


def clean(cell):
    """Cell without the blanks, hard blanks and typographic minus signs of word processors."""
    if not isinstance(cell, str):
        return "" if cell is None else cell
    return cell.replace("\xa0", " ").replace("\u2212", "-").strip()


def find_dialect(path, n_numbers):
    """Look into a file and find how it is written.

    Parameters
    ----------
    path : str or path-like
    n_numbers : int
        How many numbers a row of data has at least.

    Returns
    -------
    Dialect

    Raises
    ------
    TableError
        If there is no such file or no row with so many numbers.
    """
    path = check_path("path", path)
    if not path.is_file():
        raise TableError(f"There is no file {path}.")
    if path.suffix.lower() in (".xlsx", ".xlsm"):
        return Dialect(path, "utf-8-sig", ",", ".", True)
    encoding = _find_encoding(path)
    with open(path, encoding=encoding, newline="") as file:
        lines = [line for line in islice(file, _SNIFFED_LINES) if line.strip()]
    best, most = None, (0, 0)
    for separator in _SEPARATORS:
        if separator is None and best is not None:
            break
        for decimal in ".," if separator != "," else ".":
            dialect = Dialect(path, encoding, separator, decimal)
            counts = [_count_numbers(dialect, line) for line in lines]
            found = sum(count >= n_numbers for count in counts), sum(counts)
            if found[0] and found > most:
                best, most = dialect, found
    if best is None:
        raise TableError(
            f"{path}: no row with {n_numbers} numbers was found; columns may be parted by "
            "semicolons, tabs, commas, bars or blanks."
        )
    return best


def _count_numbers(dialect, line):
    cells = (
        line.split()
        if dialect.separator is None
        else next(csv.reader([line], delimiter=dialect.separator), [])
    )
    return sum(dialect.number(clean(cell)) is not None for cell in cells)


def _find_encoding(path):
    """UTF-8 with or without its mark, UTF-16 with one, or else what Windows writes."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    with open(path, "rb") as file:
        chunk = file.read(_CHUNK_BYTES)
        for mark, name in _MARKS:
            if chunk.startswith(mark):
                return name
        try:
            while chunk:
                decoder.decode(chunk)
                chunk = file.read(_CHUNK_BYTES)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return _checked_windows(path)
    return "utf-8"


def _checked_windows(path):
    """The encoding of Windows, if the file is text in it."""
    try:
        with open(path, encoding="cp1252") as file:
            while file.read(_CHUNK_BYTES):
                pass
    except UnicodeDecodeError:
        raise TableError(
            f"{path} is no table of text: it holds bytes that are no letters in UTF-8, in UTF-16 "
            "with its mark, or in the encoding of Windows (cp1252)."
        ) from None
    return "cp1252"


def _sheet_rows(path):
    try:
        import openpyxl
    except ImportError:
        raise TableError(
            f"{path}: to read spreadsheets, install openpyxl (pip install openpyxl), or save the "
            "sheet as CSV."
        ) from None
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    except Exception as error:  # a zip file of anything, or none
        raise TableError(f"{path} is not a spreadsheet that can be read: {error}.") from None
    try:
        for number, cells in enumerate(book.worksheets[0].iter_rows(values_only=True), 1):
            cells = [clean(cell) for cell in cells]
            if any(cell != "" for cell in cells):
                yield number, cells
    finally:
        book.close()
