"""Known lengths of the command line."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from sklearn_raacmm.app._cells import TableError
from sklearn_raacmm.app._sources import find_source
from sklearn_raacmm.calibration import lengths_of_places


def length_of(text):
    """Known length of ``--length FROM:TO:MM:SD``, as `learn_correction` takes them.

    Raises
    ------
    TableError
        If these are not two labels and two numbers.
    """
    parts = text.split(":")
    try:
        first, second, length, sd = parts
        return first.strip(), second.strip(), float(length), float(sd)
    except ValueError:
        raise TableError(
            "--length needs two positions, their distance and its standard deviation in mm, such "
            f"as A:B:500.012:0.005, got {text!r}."
        ) from None


def read_places(path, sd=None):
    """Known lengths of a plate: label, x, y, z and the standard deviation of these a row, mm.

    Parameters
    ----------
    path : str or path-like
        A table of four or five columns, with or without a header.
    sd : float, default=None
        Standard deviation in mm where the table has no fifth column.

    Returns
    -------
    list of (label, label, length, standard deviation)

    Raises
    ------
    TableError
        If a row does not hold these.
    """
    dialect, places = find_source(path, 3), []
    for number, cells in dialect.rows():
        values = [dialect.number(cell) for cell in cells[1:5]]
        values += [sd] * (4 - len(values))
        if None not in values:
            places.append((str(cells[0]), *values))
        elif places or None not in values[:3]:  # not the header
            raise TableError(
                f"{path}: row {number} must hold a label, x, y, z and their standard deviation in "
                "mm; one for all rows is said with --length-sd 0.005."
            )
    try:
        return lengths_of_places(places)
    except ValueError as error:
        raise TableError(f"{path}: {error}") from None
