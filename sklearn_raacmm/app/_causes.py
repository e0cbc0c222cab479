"""Columns of causes in tables: what the options `--extra` and `--in-order` name."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from datetime import datetime

import numpy as np

from sklearn_raacmm.app._cells import TableError


def find_cause_columns(options):
    """Column of the table of each cause: `--extra NAME` or `--extra NAME=COLUMN`, as a dict."""
    pairs = [text.partition("=")[::2] for text in getattr(options, "extra", None) or ()]
    return {name.strip(): column.strip() or name.strip() for name, column in pairs}


def read_causes(table, columns):
    """Numbers of the causes in a table, or in a block of one; times in seconds."""
    return {name: _numbers(table, column) for name, column in columns.items()}


def _numbers(table, column):
    values = table.others[column]
    if values.dtype.kind == "f":
        return values
    times = []
    for row, text in zip(table.rows, values.tolist(), strict=True):
        try:
            times.append(datetime.fromisoformat(text).timestamp())
        except ValueError:
            raise TableError(
                f"row {row}, column {column!r}: {text!r} is neither a number nor a time such as "
                "2024-05-31 12:30:00."
            ) from None
    return np.array(times)


def read_tools(table, options):
    """Labels of the probes in the column that `--tool` names, (n,); None without it."""
    column = getattr(options, "tool", None)
    if column is None:
        return None
    return np.array([_tool_label(label) for label in table.others[column].tolist()])


def _tool_label(cell):
    """Label of a probe, the same whether its block of the table holds numbers only or not."""
    try:
        number = float(cell)
    except ValueError:
        return cell
    return str(int(number)) if number.is_integer() else repr(number)


def find_unnamed_probe(saved):
    """Sentence for rows that do not name which of the learnt probes they are of, or ""."""
    tools, own = saved.tools, saved.arm.probe.tolist()
    if len(tools) < 2 or own not in tools.values():
        return ""
    name = next(name for name, probe in tools.items() if probe == own)
    return f"this correction was learnt with the tools {', '.join(tools)}, and {name} is in use"
