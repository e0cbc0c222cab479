"""What the options of a word say was measured: a table, and what its rows and positions are."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from datetime import datetime
from typing import Any

import numpy as np

from sklearn_raacmm.app._files import parse_feature, parse_length, read_lengths, read_places
from sklearn_raacmm.app._sources import TableError, parse_number
from sklearn_raacmm.app._tables import Layout, split_points, text_of_label
from sklearn_raacmm.arm import JointTypes
from sklearn_raacmm.measurements import within_turn

# Options that `Layout` has under the same names.
_OF_LAYOUT = ("angles", "position", "points", "angle_unit", "counts_per_turn", "sheet")


class Given:
    """The layout of the table that the options of a word name, and what else they say of it."""

    def __init__(self, options, arm, labelled=True, needed=True):
        """Labels may be missing where none are needed."""
        given: dict[str, Any] = {name: getattr(options, name, None) for name in _OF_LAYOUT}
        if given["points"] and not split_points(given["points"])[0].is_file():
            given["points"] = given["points"].split(",")
            if len(given["points"]) != 3:
                needed = "three columns, such as x,y,z, or a file that is there"
                raise TableError(f"--points needs {needed}, got {options.points!r}.")
        if given["counts_per_turn"] is not None:
            given["counts_per_turn"] = list(map(parse_number, given["counts_per_turn"].split(",")))
        labels = [getattr(options, name, None) for name in ("tool", "block", "station", "kind")]
        given["others"] = [*find_cause_columns(options).values(), *filter(None, labels)]
        given |= {"labelled": labelled, "needed": needed}
        given |= {"joint_names": arm.names, "joint_types": arm.joint_types}
        self.options, self.layout = options, Layout(options.table, arm.n_joints, **given)

    def causes(self, table):
        """Numbers of the causes in the table, or in a block of it; times in seconds."""
        columns = find_cause_columns(self.options)
        return {name: _numbers(table, column) for name, column in columns.items()}

    def labels(self, table, name):
        """Labels in the column that an option, such as tool, names, (n,); None without it."""
        column = getattr(self.options, name, None)
        if column is None:
            return None
        return np.array([text_of_label(label) for label in table.others[column].tolist()])

    def lengths(self):
        """All known lengths."""
        options = self.options
        lengths = [parse_length(text) for text in options.length]
        if getattr(options, "places", None):
            lengths += read_places(options.places, options.length_sd)
        if options.lengths:
            lengths += read_lengths(options.lengths, options.length_sd)
        return lengths

    def features(self, table):
        """What was touched: as the options name it, and of other positions as their rows do."""
        features = [parse_feature(text) for text in self.options.feature]
        kinds = self.labels(table, "kind")
        if kinds is None:
            return features
        if table.positions is None:
            raise TableError("--kind is of positions: name their column with --position.")
        named = {label for label, *_ in features}
        pairs = set(zip(table.positions.tolist(), map(str.lower, kinds.tolist()), strict=True))
        return features + sorted(pair for pair in pairs if pair[0] not in named)


def in_rad(table):
    """Joints of a table in rad, within one turn; and in mm, what slides."""
    types = table.joint_types or "R" * table.angles.shape[1]
    factor = JointTypes(types).by_type(np.pi / 180 if table.angle_unit == "deg" else 1.0)
    return within_turn(table.angles * factor, types)


def parse_numbers(option, text, n=3, such="such as 0,0,1"):
    """The numbers of an option such as ``--probe X,Y,Z``."""
    numbers = [parse_number(cell) for cell in text.split(",")]
    if len(numbers) != n:
        raise TableError(f"{option} needs {n} numbers, {such}, got {text!r}.")
    return numbers


def find_cause_columns(options):
    """Column of the table of each cause: `--extra NAME` or `--extra NAME=COLUMN`, as a dict."""
    pairs = [text.partition("=")[::2] for text in getattr(options, "extra", None) or ()]
    return {name.strip(): column.strip() or name.strip() for name, column in pairs}


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


def find_unnamed_probe(saved):
    """Sentence for rows that do not name which of the learnt probes they are of, or ""."""
    tools = saved.tools
    own = [name for name, probe in tools.items() if probe == saved.arm.probe.tolist()]
    if len(tools) < 2 or not own:
        return ""
    return f"this correction was learnt with the tools {', '.join(tools)}, and {own[0]} is in use"
