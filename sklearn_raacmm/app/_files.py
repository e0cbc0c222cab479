"""Files of the command: arms, saved corrections, known lengths, and what it writes."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from pathlib import Path
from typing import Any

from sklearn_raacmm.app._columns import Columns
from sklearn_raacmm.app._sources import TableError, parse_number
from sklearn_raacmm.app._units import MM_PER_UNIT
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import lengths_of_places
from sklearn_raacmm.correction import Correction
from sklearn_raacmm.utils import check_places

# What `learn` and the later words write into a folder.
WRITTEN = (
    "report.html", "model.skops", "arm.json", "correction.json", "card.md", "corrected.csv",
)  # fmt: skip
# Options that name files to read, beside --model.
_READ = ("table", "arm", "lengths", "places", "run")


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


def check_outputs(options, outputs, read=()):
    """Refuse files that could not be written, or that a word reads: before the work."""
    read = [*read, *(getattr(options, name, None) for name in _READ)]
    # Without --out a folder of --model is brought up to date.
    if getattr(options, "model", None) and getattr(options, "out", "") is not None:
        read += [options.model / name for name in ("correction.json", "arm.json", "model.skops")]
    check_places(filter(None, outputs), filter(None, read))


def print_notes(notes):
    """Say what the user should know, beside the results; --quiet leaves it out."""
    for note in notes:
        warnings.warn(note, stacklevel=2)


# -- known lengths: of the command line, and in files ----------------------------------------------


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
