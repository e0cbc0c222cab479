"""Files of the command: arms by name or file, saved corrections, corrected tables."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import csv
import os
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sklearn_raacmm.app._cells import TableError
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.correction import predict_with_std, read_correction, with_causes
from sklearn_raacmm.export import TRUSTED_TYPES

# Rows corrected at a time: some ten MB, whatever the size of the file.
_BLOCK_ROWS = 8192
_NEW_COLUMNS = ("x [mm]", "y [mm]", "z [mm]", "sd x [mm]", "sd y [mm]", "sd z [mm]")


def load_arm(source, base=None, tip=None):
    """Arm from a JSON file, a URDF or the name of a built-in one."""
    path = Path(source)
    if path.suffix.lower() == ".urdf":
        return Arm.from_urdf(path, base=base, tip=tip)
    if base or tip:
        raise TableError("--base and --tip name links of a URDF, and none is given.")
    if path.exists():
        return Arm.from_json(path)
    try:
        return Arm.from_name(str(source))
    except ValueError as error:
        raise TableError(f"--arm: there is no file {source}, and as a {error}") from None


@dataclass(frozen=True, eq=False)
class SavedCorrection:
    """What `LearnedCorrection.save` wrote."""

    arm: Arm
    model: object
    facts: dict

    def inputs(self, angles, extra=None):
        """What the model takes: angles in rad and causes, those that it knows."""
        usual = self.facts.get("causes", {})
        return with_causes(angles, usual, {k: v for k, v in (extra or {}).items() if k in usual})

    def correct(self, angles, extra=None):
        """Measured and corrected points (n, 3), and standard deviations; angles in rad."""
        measured = self.arm.forward(angles)
        X = self.inputs(angles, extra)
        correction, std = predict_with_std(self.model, X, self.facts["noise_mm"])
        return measured, measured - correction, self.facts["std_factor"] * std


def load_correction(source):
    """Saved correction from its folder, or from a file in it."""
    folder = Path(source)
    if folder.is_file():
        folder = folder.parent
    if (folder / "model.joblib").is_file() and not (folder / "model.skops").is_file():
        raise TableError(
            f"--model: {folder} has no model.skops. Only these are loaded, since other files can "
            "run code: install skops (pip install skops) and learn again."
        )
    try:
        facts, (arm, model) = read_correction(folder, ["arm.json", "model.skops"])
    except (ValueError, OSError) as error:
        raise TableError(f"--model: {error}") from None
    try:
        import skops.io
    except ImportError:
        raise TableError("To load a model, install skops: pip install skops.") from None
    try:
        model = skops.io.loads(model, trusted=TRUSTED_TYPES)
    except Exception as error:  # of a file of another version, anything
        raise TableError(f"--model: {folder} cannot be loaded: {error}") from None
    return SavedCorrection(Arm.from_json(arm), model, facts)


def files_of(source):
    """Files that loading a correction reads: no output may be one of them."""
    folder = Path(source)
    folder = folder.parent if folder.is_file() else folder
    return [folder / name for name in ("correction.json", "arm.json", "model.skops")]


def write_corrected(layout, correct, file):
    """Copy a table with the corrected points beside its columns, block by block.

    Parameters
    ----------
    layout : Layout
        Of the table.
    correct : callable
        Takes angles in rad and their block of the table, returns points and standard deviations
        (n, 3).
    file : text stream
        Written to, with the line ends that the stream makes.

    Returns
    -------
    int
        Number of rows.
    """
    dialect, n_rows = layout.dialect, 0
    writer = csv.writer(file, delimiter=dialect.separator or " ")
    writer.writerow([*layout.header, *_NEW_COLUMNS])
    for block, cells in layout.blocks_with_cells(_BLOCK_ROWS):
        numbers = np.hstack(correct(in_rad(block), block))
        for row, values in zip(cells, numbers.tolist(), strict=True):
            writer.writerow([*row, *map(dialect.text, values)])
        n_rows += len(cells)
    return n_rows


@contextmanager
def open_beside(path, encoding):
    """A text stream whose file gets its name when it is complete."""
    path = Path(path)
    beside = path.with_name(f"{path.name}.{os.getpid():x}.tmp")
    try:
        with open(beside, "w", encoding=encoding, newline="") as file:
            yield file
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def in_rad(table):
    """Angles of a table in rad, within one turn."""
    angles = np.deg2rad(table.angles) if table.angle_unit == "deg" else table.angles
    return np.remainder(angles + np.pi, 2 * np.pi) - np.pi
