"""Columns of causes in tables: what the options `--extra` and `--in-order` name."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from datetime import datetime

import numpy as np

from sklearn_raacmm.app._cells import TableError
from sklearn_raacmm.measurements import directions_of


def columns_of_causes(options):
    """Column of the table of each cause: `--extra NAME` or `--extra NAME=COLUMN`, as a dict."""
    pairs = [text.partition("=")[::2] for text in getattr(options, "extra", None) or ()]
    return {name.strip(): column.strip() or name.strip() for name, column in pairs}


def causes_of(table, columns):
    """Numbers of the causes in a table, or in a block of one; times in seconds."""
    return {name: _numbers(table, column) for name, column in columns.items()}


def _numbers(table, column):
    values = table.others[column]
    if values.dtype.kind == "f":
        return values
    try:
        return np.array([datetime.fromisoformat(text).timestamp() for text in values.tolist()])
    except ValueError:
        bad = next(i for i, text in enumerate(values.tolist()) if not _is_time(text))
        raise TableError(
            f"row {table.rows[bad]}, column {column!r}: {values[bad]!r} is neither a number nor a "
            "time such as 2024-05-31 12:30:00."
        ) from None


def _is_time(text):
    try:
        datetime.fromisoformat(text)
    except ValueError:
        return False
    return True


def inputs_of(correction, columns, in_order):
    """Rule by which blocks of a table become what a model takes, one after the other.

    Parameters
    ----------
    correction : SavedCorrection
    columns : dict of str to str
        As `columns_of_causes` gives it.
    in_order : bool
        Whether the rows are in the order of measurement, which tells directions.

    Returns
    -------
    callable
        Takes angles in rad and the block of the table that they are from.
    """
    known, last = correction.facts["causes"], None
    columns = {name: column for name, column in columns.items() if name in known}

    def inputs(angles, block):
        nonlocal last
        extra = causes_of(block, columns)
        if in_order:
            ways, last = directions_of(angles, last), angles[-1]
            ways = {f"direction {j + 1}": way for j, way in enumerate(ways.T)}
            extra |= {name: way for name, way in ways.items() if name in known}
        return correction.inputs(angles, extra)

    return inputs
