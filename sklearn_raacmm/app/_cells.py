"""Tables of text as loggers write them: encoding, separator, decimal sign, cells."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import codecs
import contextlib
import csv
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice, product
from pathlib import Path

# Lines looked at to find separator and decimal sign, and characters decoded at a time.
_SNIFFED_LINES = 300
_CHUNK = 1 << 20
# From the least ambiguous on; None is any white space.
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", None: "blanks"}
_DECIMALS = {".": "point", ",": "comma"}
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
# What a number may be made of, so that `float` takes nothing else, such as "1_0" and "nan".
_NO_NUMBER = re.compile(r"[^0-9.eE+\-\n]")
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
# Hard blanks and typographic minus signs are those of word processors.
_PLAIN = str.maketrans({"\xa0": " ", "\u2212": "-"})
# Comments of loggers, NumPy, MATLAB and SpatialAnalyzer.
_COMMENT = re.compile(r"\s*(#+|//+|%+)\s*")


class TableError(ValueError):
    """A table that cannot be read, or not without further options."""


def check_installed(*names):
    """Refuse work that needs, perhaps in its last step, packages that are missing."""
    missing = [name for name in names if find_spec(name) is None]
    if missing:
        raise TableError(
            f"{' and '.join(missing)} must be installed: pip install {' '.join(missing)}."
        )


def parse_number(text):
    """Number that somebody typed, with either decimal sign."""
    if not _NUMBER.fullmatch(text.strip()):
        raise TableError(f"{text!r} is not a number.")
    return float(text.strip().replace(",", "."))


@dataclass(frozen=True)
class Dialect:
    """How a file is written; `separator` and `decimal` of what is no text are those to write with.

    `read` yields (row number, cells) of what is no text, and `what` names its kind.
    """

    path: Path
    encoding: str = "utf-8-sig"
    separator: str | None = ","
    decimal: str = "."
    what: str = ""
    read: Callable | None = None

    def rows(self):
        """Yield (line number from 1, cells) of each line that is not empty."""
        if self.read is not None:
            yield from self.read()
            return
        with open(self.path, encoding=self.encoding, newline="") as file:
            for number, cells in self.split(file):
                if any(cells):
                    yield number, cells

    def split(self, lines):
        """Yield (line number from 1, cells) of lines of text."""
        lines = (line.translate(_PLAIN) for line in lines)
        if self.separator is None:
            yield from enumerate(map(str.split, lines), 1)
            return
        reader = csv.reader(lines, delimiter=self.separator)
        try:
            for cells in reader:
                yield reader.line_num, [cell.strip() for cell in cells]
        except csv.Error as error:  # such as a cell of 128 kB
            raise TableError(f"{self.path} cannot be read as a table: {error}.") from None

    def number(self, cell):
        """Number in a cell, or None."""
        if isinstance(cell, int | float) and not isinstance(cell, bool):
            return float(cell)
        if not isinstance(cell, str) or not _NUMBER.fullmatch(cell):
            return None
        other = "." if self.decimal == "," else ","
        return None if other in cell else float(cell.replace(",", "."))

    def count(self, cells):
        """How many cells hold numbers."""
        return sum(self.number(cell) is not None for cell in cells)

    def numbers(self, cells):
        """Numbers of a column, or None if one of them is none; fast for plain text."""
        try:
            text = "\n".join(cells)
            if self.decimal == "," and "." not in text:
                text = text.replace(",", ".")
            if not _NO_NUMBER.search(text):
                return [float(cell) for cell in text.split("\n")]
        except (TypeError, ValueError):  # cells of a spreadsheet, or no numbers after all
            pass
        values = [self.number(cell) for cell in cells]
        return None if None in values else values

    def text(self, value, digits=6):
        """Number as the file writes its numbers."""
        return f"{value:.{digits}f}".replace(".", self.decimal)

    def __str__(self):
        return self.what or (
            f"Columns parted by {_SEPARATORS[self.separator]}, decimal "
            f"{_DECIMALS[self.decimal]}s, {self.encoding}"
        )


def clean(cell):
    """Cell of a spreadsheet as text has it."""
    if isinstance(cell, str):
        return cell.translate(_PLAIN).strip()
    return "" if cell is None else cell


def strip_mark(cells):
    """Cells of a line of comment without its mark; None if the line is no comment."""
    mark = _COMMENT.match(str(cells[0]))
    if not mark:
        return None
    rest = str(cells[0])[mark.end() :]
    return [rest, *cells[1:]] if rest else cells[1:]


def find_dialect(path, n_numbers):
    """How a file of text is written, by its first rows with at least so many numbers."""
    encoding = find_encoding(path)
    with open(path, encoding=encoding, newline="") as file:
        lines = [line for line in islice(file, _SNIFFED_LINES) if line.strip()]
    # Decimal commas between commas stand in quotation marks.
    quoted = any('"' in line for line in lines)
    best, most = None, (0, 0)
    for separator, decimal in product(_SEPARATORS, _DECIMALS):
        if separator is None and best is not None:
            break  # blanks part columns only where nothing else does
        if separator == decimal and not quoted:
            continue
        dialect = Dialect(path, encoding, separator, decimal)
        counts = [dialect.count(next(dialect.split([line]), (1, []))[1]) for line in lines]
        found = sum(count >= n_numbers for count in counts), sum(counts)
        if found[0] and found > most:
            best, most = dialect, found
    if best is None:
        raise TableError(
            f"{path}: no row with {n_numbers} numbers was found; columns may be parted by "
            "semicolons, tabs, commas, bars or blanks."
        )
    return best


def find_encoding(path):
    """UTF-8 with or without its mark, UTF-16 with one, or else what Windows writes."""
    with open(path, "rb") as file:
        head = file.read(3)
    for mark, name in _MARKS:
        if head.startswith(mark):
            return name
    for encoding in ("utf-8", "cp1252"):
        with contextlib.suppress(UnicodeDecodeError), open(path, encoding=encoding) as file:
            while file.read(_CHUNK):
                pass
            return encoding
    raise TableError(
        f"{path} is no table of text in UTF-8, in UTF-16 with its mark, or in the encoding of "
        "Windows (cp1252): save it as .xlsx or CSV."
    )
