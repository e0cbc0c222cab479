"""Files of the command: arms, saved corrections, tables of readings, corrected ones, lengths."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from sklearn_raacmm.app._columns import Columns
from sklearn_raacmm.app._sources import TableError, parse_number
from sklearn_raacmm.app._tables import Layout, split_points, text_of_label
from sklearn_raacmm.app._units import MM_PER_UNIT
from sklearn_raacmm.arm import Arm, scale_of
from sklearn_raacmm.calibration import lengths_of_places
from sklearn_raacmm.correction import Correction
from sklearn_raacmm.measurements import within_turn

# What `learn` and the later words write into a folder.
WRITTEN = (
    "report.html", "model.skops", "arm.json", "correction.json", "card.md", "corrected.csv",
)  # fmt: skip
# Options that `Layout` has under the same names.
_OF_LAYOUT = ("angles", "position", "points", "angle_unit", "counts_per_turn", "sheet")


def load_arm(source, base=None, tip=None):
    """Arm from a JSON file, a URDF or the name of a built-in one."""
    path, head = Path(source), b""
    if path.is_file():
        with open(path, "rb") as file:
            head = file.read(200).lstrip(b"\xef\xbb\xbf \r\n\t")
    # XML is a URDF whatever its name, or what somebody takes for one.
    if path.suffix.lower() in (".urdf", ".yaml", ".yml") or head.startswith(b"<"):
        return Arm.from_urdf(path, base=base, tip=tip)
    if base or tip:
        raise TableError("--base and --tip name links of a URDF, and none is given.")
    if path.exists():
        if "delta_theta" in path.read_text(encoding="utf-8", errors="replace"):
            raise TableError(
                f"{source} holds what a UR's own calibration adds to a nominal arm, and not which "
                f"arm that is: name it, such as raacmm arm ur10e --dh {source}."
            )
        return Arm.from_json(path)
    try:
        return Arm.from_name(str(source))
    except ValueError as error:
        raise TableError(f"there is no file {source}, and as a {error}") from None


def load_correction(folder) -> Any:
    """Saved correction from its folder."""
    try:
        return Correction.load(folder)
    except (ValueError, OSError) as error:
        raise TableError(f"--model: {error}") from None


def correction_files(folder):
    """Files that loading a correction reads: no output may be one of them."""
    return [folder / name for name in ("correction.json", "arm.json", "model.skops")]


def in_rad(table):
    """Joints of a table in rad, within one turn; and in mm, what slides."""
    types = table.joint_types or "R" * table.angles.shape[1]
    factor = scale_of(types, np.pi / 180 if table.angle_unit == "deg" else 1.0)
    return within_turn(table.angles * factor, types)


def print_notes(notes):
    """Say what the user should know, beside the results; --quiet leaves it out."""
    for note in notes:
        warnings.warn(note, stacklevel=2)


def find_rows(options, arm, labelled=True, needed=True):
    """Layout of the table that the options name; labels may be missing where none are needed."""
    given: dict[str, Any] = {name: getattr(options, name, None) for name in _OF_LAYOUT}
    if given["points"] and not split_points(given["points"])[0].is_file():
        given["points"] = given["points"].split(",")
        if len(given["points"]) != 3:
            needed = "three columns, such as x,y,z, or a file that is there"
            raise TableError(f"--points needs {needed}, got {options.points!r}.")
    if given["counts_per_turn"] is not None:
        given["counts_per_turn"] = [parse_number(n) for n in given["counts_per_turn"].split(",")]
    labels = [getattr(options, name, None) for name in ("tool", "block", "station", "kind")]
    others = [*find_cause_columns(options).values(), *filter(None, labels)]
    given |= {"labelled": labelled, "needed": needed, "joint_names": arm.names, "others": others}
    given["joint_types"] = arm.joint_types
    return Layout(options.table, arm.n_joints, **given)


def parse_numbers(option, text, n=3, such="such as 0,0,1"):
    """The numbers of an option such as ``--probe X,Y,Z``."""
    numbers = [parse_number(cell) for cell in text.split(",")]
    if len(numbers) != n:
        raise TableError(f"{option} needs {n} numbers, {such}, got {text!r}.")
    return numbers


# -- causes: what the options --extra, --tool, --block and --station name --------------------------


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


def read_labels(table, options, name):
    """Labels in the column that the option `name`, such as tool, names, (n,); None without it."""
    column = getattr(options, name, None)
    if column is None:
        return None
    return np.array([text_of_label(label) for label in table.others[column].tolist()])


def find_unnamed_probe(saved):
    """Sentence for rows that do not name which of the learnt probes they are of, or ""."""
    tools = saved.tools
    own = [name for name, probe in tools.items() if probe == saved.arm.probe.tolist()]
    if len(tools) < 2 or not own:
        return ""
    return f"this correction was learnt with the tools {', '.join(tools)}, and {own[0]} is in use"


# -- known lengths: of the command line, and in files ----------------------------------------------


def known_lengths(options):
    """All known lengths that the options of a word name."""
    lengths = [parse_length(text) for text in options.length or ()]
    if getattr(options, "places", None):
        lengths += read_places(options.places, options.length_sd)
    if options.lengths:
        lengths += read_lengths(options.lengths, options.length_sd)
    return lengths


def parse_length(text):
    """Known length of ``--length FROM:TO:MM:SD``, as `learn_correction` takes them.

    Behind the standard deviation may stand its temperature and its expansion: ``@25:11.5e-6``.
    """
    try:
        first, second, length, sd, *growth = (part.strip() for part in text.split(":"))
        sd, at, celsius = sd.partition("@")
        numbers = length, sd, *[celsius] * bool(at), *growth
        if len(growth) > bool(at):
            raise ValueError
        return first, second, *map(parse_number, numbers)
    except ValueError:
        raise TableError(
            "--length needs two positions, their distance and its standard deviation in mm, such "
            "as A:B:500.012:0.005, and where they are not those at 20 degrees C the temperature "
            f"and perhaps the expansion per K, such as A:B:500.012:0.005@25:11.5e-6, got {text!r}."
        ) from None


def known_features(options, table):
    """What was touched: as the options name it, and of other positions as their rows do."""
    features = [parse_feature(text) for text in options.feature or ()]
    kinds = read_labels(table, options, "kind")
    if kinds is None:
        return features
    if table.positions is None:
        raise TableError("--kind is of positions: name their column with --position.")
    named = {label for label, *_ in features}
    pairs = set(zip(table.positions.tolist(), map(str.lower, kinds.tolist()), strict=True))
    return features + sorted(pair for pair in pairs if pair[0] not in named)


def parse_feature(text):
    """What was touched, of ``--feature LABEL:KIND[:SIZE:SD[:SIDE]]``, as `calibrate` takes it."""
    try:
        label, kind, *size = (part.strip() for part in text.split(":"))
        if len(size) == 1:
            raise ValueError
        return label, kind, *map(parse_number, size[:2]), *size[2:]
    except ValueError:
        raise TableError(
            "--feature needs the label of a position and plane, sphere or cone, and where its size "
            "is known the diameter and its standard deviation in mm, such as ball:sphere:30:0.001, "
            f"got {text!r}."
        ) from None


def read_lengths(path, sd=None):
    """Known lengths: two labels, a length and its standard deviation a row, mm."""
    return list(_read_rows(path, 2, 1, sd, "two labels and a length in mm"))


def read_places(path, sd=None):
    """Known lengths of a plate: label, x, y, z and the standard deviation of these a row, mm."""
    return lengths_of_places(list(_read_rows(path, 1, 3, sd, "a label, x, y and z in mm")))


def _read_rows(path, n_labels, n_numbers, sd, what):
    """Yield labels, numbers and standard deviation of each row, mm; a header names other units."""
    table, n = Columns(path, n_numbers), n_labels + n_numbers
    mm = [MM_PER_UNIT.get(unit, 1.0) for unit in [*table.units, *n * [""]]][n_labels : n + 1]
    for number, cells in (row for row in table.source.rows() if row[0] > table.header_row):
        values = [table.source.number(cell) for cell in [*cells[n_labels:], *n * [""]]]
        values = [value and value * one for value, one in zip(values, mm, strict=False)]
        if None in values[:n_numbers]:
            raise TableError(f"{path}: row {number} must hold {what}.")
        if values[-1] is None and sd is None:
            raise TableError(
                f"{path}: row {number} has no standard deviation in mm in its last column; say it "
                "with --length-sd 0.005."
            )
        yield *map(str, cells[:n_labels]), *values[:-1], sd if values[-1] is None else values[-1]
