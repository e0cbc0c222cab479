"""Tables of text as loggers write them: encoding, separator, decimal sign, cells."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import codecs
import csv
import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

# Lines looked at to find separator and decimal sign, and bytes decoded at a time.
_SNIFFED_LINES = 300
_CHUNK_BYTES = 1 << 20
# From the least ambiguous on; None is any white space, where nothing else fits.
_SEPARATORS = (";", "\t", "|", ",", None)
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
# What a number may be made of, so that `float` takes nothing else, such as "1_0" and "nan".
_NO_NUMBER = re.compile(r"[^0-9.eE+\-\n]")
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_SEPARATOR_NAMES = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", None: "blanks"}
# Comments of loggers, NumPy, MATLAB and SpatialAnalyzer.
_COMMENT = re.compile(r"\s*(#+|//+|%+)\s*")
# Advice of the package, and the same of the command.
_SAID_TO_PYTHON = (
    ('convert them or pass angle_unit="deg"', "say --unit deg"),
    ('pass angle_unit="rad"', "say --unit rad"),
    ("calibrate(..., correction=model, free=['probe'])", "raacmm register"),
    ("calibrate(..., correction=model)", "raacmm register"),
    ("update_correction", "raacmm update"),
    ("extra must hold names of columns,", "--extra takes CAUSE or CAUSE=COLUMN; causes are"),
)


class TableError(ValueError):
    """A table that cannot be read, or not without being told more."""


def number_of(text):
    """Number that somebody typed, with either decimal sign."""
    if not _NUMBER.fullmatch(text.strip()):
        raise TableError(f"{text!r} is not a number.")
    return float(text.strip().replace(",", "."))


def as_said(message, rows=None):
    """What is said of rows counted from 0, and to Python, as this command says it of a file."""

    def numbers(match):
        return re.sub(r"\d+", lambda m: str(_at(rows, int(m[0]))), match[0])

    text = str(message)
    for python, here in _SAID_TO_PYTHON:
        text = text.replace(python, here)
    if rows is None or isinstance(message, TableError):
        return text
    text = re.sub(r"\brows? \d+(?:(?:,| and| to) \d+)*", numbers, text)
    return text.replace(" (rows counted from 0)", "")


def _at(rows, row):
    return rows[row] if row < len(rows) else row


@dataclass(frozen=True)
class Dialect:
    """How a file is written; `separator` and `decimal` of what is no text are those to write with.

    `read` yields (row number, cells) of what is no text, and `what` says what that is.
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
            # Hard blanks and typographic minus signs are those of word processors.
            lines = (line.replace("\xa0", " ").replace("\u2212", "-") for line in file)
            if self.separator is None:
                found = ((i, line.split()) for i, line in enumerate(lines, 1))
            else:
                reader = csv.reader(lines, delimiter=self.separator)
                found = ((reader.line_num, [c.strip() for c in cells]) for cells in reader)
            try:
                for number, cells in found:
                    if any(cells):
                        yield number, cells
            except csv.Error as error:
                raise self.broken(error) from None

    def broken(self, error):
        """Sentence for what the reader of CSV cannot take, such as a cell of 128 kB."""
        return TableError(f"{self.path} cannot be read as a table: {error}.")

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
        signs = {".": "points", ",": "commas"}
        return self.what or (
            f"Columns parted by {_SEPARATOR_NAMES[self.separator]}, decimal "
            f"{signs[self.decimal]}, {self.encoding}"
        )


def clean(cell):
    """Cell of a spreadsheet as text has it."""
    if not isinstance(cell, str):
        return "" if cell is None else cell
    return cell.replace("\xa0", " ").replace("\u2212", "-").strip()


def without_mark(cells):
    """Cells of a line of comment without its mark; None if the line is no comment."""
    mark = _COMMENT.match(str(cells[0]))
    if not mark:
        return None
    rest = str(cells[0])[mark.end() :]
    return [rest, *cells[1:]] if rest else cells[1:]


def text_dialect(path, n_numbers):
    """How a file of text is written, told by its first rows with at least so many numbers."""
    encoding = find_encoding(path)
    with open(path, encoding=encoding, newline="") as file:
        lines = [line for line in islice(file, _SNIFFED_LINES) if line.strip()]
    best, most = None, (0, 0)
    for separator in _SEPARATORS:
        if separator is None and best is not None:
            break
        for decimal in ".,":
            # Decimal commas between commas stand in quotation marks.
            if separator == decimal and not any('"' in line for line in lines):
                continue
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
    try:
        cells = (
            line.split()
            if dialect.separator is None
            else next(csv.reader([line], delimiter=dialect.separator), [])
        )
    except csv.Error as error:
        raise dialect.broken(error) from None
    return dialect.count(map(clean, cells))


def find_encoding(path):
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
