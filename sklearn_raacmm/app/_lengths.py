"""Known lengths: of the command line, and in files."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

from sklearn_raacmm.app._cells import TableError, parse_number
from sklearn_raacmm.app._sources import find_source
from sklearn_raacmm.calibration import lengths_of_places


def known_lengths(options):
    """All known lengths that the options of a word name."""
    lengths = [parse_length(text) for text in options.length or ()]
    if getattr(options, "places", None):
        lengths += read_places(options.places, options.length_sd)
    if options.lengths:
        lengths += read_lengths(options.lengths, options.length_sd)
    return lengths


def parse_length(text):
    """Known length of ``--length FROM:TO:MM:SD``, as `learn_correction` takes them."""
    try:
        first, second, length, sd = (part.strip() for part in text.split(":"))
        return first, second, parse_number(length), parse_number(sd)
    except ValueError:
        raise TableError(
            "--length needs two positions, their distance and its standard deviation in mm, such "
            f"as A:B:500.012:0.005, got {text!r}."
        ) from None


def read_lengths(path, sd=None):
    """Known lengths: two labels, a length and its standard deviation a row, mm."""
    return list(_read_rows(path, 2, 1, sd, "two labels and a length in mm"))


def read_places(path, sd=None):
    """Known lengths of a plate: label, x, y, z and the standard deviation of these a row, mm."""
    return lengths_of_places(list(_read_rows(path, 1, 3, sd, "a label, x, y and z in mm")))


def _read_rows(path, n_labels, n_numbers, sd, what):
    """Yield labels, numbers and a standard deviation of each row, the header left out."""
    dialect, begun = find_source(path, n_numbers), False
    for number, cells in dialect.rows():
        values: list[Any] = [dialect.number(cell) for cell in cells[n_labels:]]
        values = [*values, *(n_numbers + 1) * [None]][: n_numbers + 1]
        if None in values[:n_numbers]:
            if begun or any(value is not None for value in values):
                raise TableError(f"{path}: row {number} must hold {what}.")
            continue  # the header, or what stands above it
        begun = True
        if values[-1] is None and sd is None:
            raise TableError(
                f"{path}: row {number} has no standard deviation in mm in its last column; say it "
                "with --length-sd 0.005."
            )
        labels = map(str, cells[:n_labels])
        yield *labels, *values[:-1], sd if values[-1] is None else values[-1]
    if not begun:
        raise TableError(f"{path} holds no row of {what}.")
