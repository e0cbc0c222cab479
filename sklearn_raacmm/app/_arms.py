"""The word ``arm``: an arm of a file, a table, lengths or answers, shown and written."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import json
import re
import sys
from pathlib import Path

import numpy as np

from sklearn_raacmm.app._columns import Columns
from sklearn_raacmm.app._files import check_outputs, load_arm, print_notes
from sklearn_raacmm.app._given import Given, parse_numbers
from sklearn_raacmm.app._sources import TableError, parse_number
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.correction import arm_from_data
from sklearn_raacmm.utils import write_whole

# Names that drawings and papers give the columns; the first three are needed.
_COLUMNS = {
    "a": ("a", "r", "link length", "a_i", "a_i-1"),
    "alpha": ("alpha", "twist", "alpha_i", "alpha_i-1"),
    "d": ("d", "joint offset", "d_i"),
    "theta_offset": ("theta_offset", "theta offset", "offset", "theta", "theta0"),
    "joint_signs": ("sign", "joint_signs", "direction"),
    "names": ("joint", "name", "joint name"),
    "joint_types": ("type", "joint type", "joint_type"),
}
_ANGLES, _WORDS = ("alpha", "theta_offset"), ("names", "joint_types")
# How near to a quarter turn in rad a twist has to be, and the largest length in metres, by which
# units are known that no header names.
_QUARTER, _MOST_METRES = 1e-2, 10.0
_FACTORS = {"mm": 1.0, "m": 1000.0, "deg": np.pi / 180, "rad": 1.0}
_DRAWING = r"""
           elbow: axes 2 and 3 cross, or pass at the elbow offset
              o
    upper    / \    fore
            /   \
           o     o--( probe
   shoulder|     wrist: axes 4 and 5 cross, or pass at the wrist offset
    height |
         =====  base: axis 1 upright, axis 2 across it
"""
_QUESTIONS = (
    ("shoulder", "height of the shoulder above the base"),
    ("upper", "shoulder to elbow"),
    ("fore", "elbow to wrist"),
    ("probe", "wrist to the centre of the probe"),
    ("elbow_offset", "how far axes 2 and 3 pass each other, 0 if they cross"),
    ("wrist_offset", "how far axes 4 and 5 pass each other, 0 if they cross"),
)
_ADVICE = """Shoulder to elbow and elbow to wrist decide the scale of the arm: take them from a
drawing, to half a millimetre, or measure a known distance. The height of the shoulder matters
by centimetres. Calibration finds all others, offsets too, to hundredths of a millimetre."""


def arm(options):
    """Show an arm, and write its file."""
    given = [options.source, options.dh, options.lengths_222, options.lengths_223]
    named = sum(one is not None for one in (*given, options.from_data))
    if named > 1 + bool(_deltas(options.dh)):
        raise TableError(
            "give one arm: a file or name, --dh, --lengths-222, --lengths-223 or --from-data."
        )
    if bool(options.layout) != bool(options.from_data):
        raise TableError("--from-data and --layout belong together.")
    if (options.elbow_offset or options.wrist_offset) and not any(given[2:]):
        raise TableError("--elbow-offset and --wrist-offset belong to --lengths-222 or -223.")
    if (options.modified or options.probe) and not options.dh:
        raise TableError("--modified and --probe belong to --dh.")
    if options.into and not options.out:
        raise TableError("--into needs --out, the file to write; it may be the same file.")
    if options.out != "-":
        check_outputs(options, [options.out], [options.source, options.dh, options.from_data])
    shown = _meant_arm(options)
    if options.up:
        shown = shown.replace(up=parse_numbers("--up", options.up))
    shown = _with_encoders(shown, options)
    print(shown)
    text = shown.to_json()
    if options.into:
        text = shown.update_urdf(options.into, base=options.base, tip=options.tip)
    if options.out == "-":
        options.stdout.write(text)
    elif options.out:
        write_whole({options.out: text})
        print(f"Written to {options.out}")
    return 0, json.loads(shown.to_json())


def _with_encoders(shown, options):
    """The arm, read by other encoders: theta = sign (angle - zero) + offset."""
    given = shown.n_joints, "one for each joint"
    if options.sign:
        signs = parse_numbers("--sign", options.sign, *given)
        if any(abs(sign) != 1 for sign in signs):
            raise TableError(f"--sign needs 1 or -1 for each joint, got {options.sign!r}.")
        sums = [(i, j, f * signs[i - 1] * signs[j - 1]) for i, j, f in shown.couplings]
        shown = shown.replace(joint_signs=shown.joint_signs * np.array(signs), couplings=sums)
    if options.zero:
        zero = np.array([parse_numbers("--zero", options.zero, *given)])
        moved = shown.joint_signs * shown.own_angles(zero)[0]  # sums of angles, sums of zeros
        turned = shown.by_type(np.pi / 180, 0.0) * moved
        slid = shown.by_type(0.0) * moved  # mm
        shown = shown.replace(theta_offset=shown.theta_offset - turned, d=shown.d - slid)
    return shown


def _meant_arm(options):
    """The arm of a file, a table, a name or lengths; without any, of the answers of the user."""
    offsets = {"elbow_offset": options.elbow_offset, "wrist_offset": options.wrist_offset}
    for layout, lengths in (("2-2-2", options.lengths_222), ("2-2-3", options.lengths_223)):
        if lengths:
            return Arm.from_lengths(layout, *lengths, **offsets)
    if options.from_data:
        return _arm_of_layout(options)
    if deltas := _deltas(options.dh):
        return _calibrated_ur(load_arm(options.source or ""), deltas)
    if options.dh:
        convention = "modified" if options.modified else "standard"
        return read_dh(options.dh, convention, parse_numbers("--probe", options.probe or "0,0,0"))
    if options.source:
        # With --into, --base and --tip are those of the other file.
        ends = () if options.into else (options.base, options.tip)
        return load_arm(options.source, *ends)
    if not sys.stdin.isatty():
        raise TableError("give an arm: a file, a URDF, the name of a built-in one, or lengths.")
    print(_DRAWING)
    print(_ADVICE)
    layout = input("Layout, 2-2-2 or 2-2-3: ").strip()
    lengths = {name: parse_number(input(f"{text}, mm: ")) for name, text in _QUESTIONS}
    return Arm.from_lengths(layout, **lengths)


def _deltas(path):
    """Numbers of a UR's own calibration by their names, such as theta; {} of any other file."""
    if path is None or not Path(path).is_file():
        return {}
    text = Path(path).read_text(encoding="utf-8", errors="replace")
    lists = re.findall(r"(?m)^\s*delta_(theta|a|d|alpha)\s*=\s*\[([^\]]*)\]", text)
    return {name: list(map(parse_number, numbers.split(","))) for name, numbers in lists}


def _calibrated_ur(nominal, deltas):
    """A nominal arm with what its controller's file calibration.conf adds, in m and rad."""
    n = nominal.n_joints
    if {len(numbers) for numbers in deltas.values()} != {n} or nominal.convention != "standard":
        raise TableError(f"--dh holds the calibration of a UR, and {nominal!r} is none.")
    fields = {"a": 1000.0, "alpha": 1.0, "d": 1000.0, "theta": 1.0}
    added = [factor * np.array(deltas.get(name, n * [0.0])) for name, factor in fields.items()]
    table = np.add([nominal.a, nominal.alpha, nominal.d, nominal.theta_offset], added).T
    names = {"name": nominal.name, "names": nominal.names, "limits": nominal.limits}
    return Arm.from_far_axes(table, nominal.probe, **names)


def _arm_of_layout(options):
    """The arm of a layout that a single-point test shows; what no data show is asked."""
    options.table, options.points = options.from_data, None
    measured = Given(options, Arm.from_lengths(options.layout, *[1.0] * 4))
    table = measured.layout.read()
    print_notes(table.notes)
    unit, lengths = table.angle_unit, measured.lengths()
    given = options.layout, table.angles, table.positions, lengths
    arm = arm_from_data(*given, angle_unit=unit, mirrored=options.mirrored)
    height = arm.forward(table.angles, angle_unit=unit)[:, 2]
    high, low = table.rows[[np.argmax(height), np.argmin(height)]]
    print(
        "No data show what two questions decide. Turn joint 1 counter-clockwise, seen from above: "
        f"does its angle grow? Was the probe higher in row {high} than in row {low}? One yes and "
        "one no: it is the mirror image, take the other one of --mirrored and without it. If the "
        f"angle falls, add --up 0,0,-1. Its shoulder is taken to be {arm.d[0]:.0f} mm high: mend "
        "d1 in the file if that is wrong by a decimetre."
    )
    return arm.replace(name=Path(options.table).stem)


def read_dh(path, convention="standard", probe=(0.0, 0.0, 0.0)):
    """Arm of a table, text or a spreadsheet, with one row for each joint.

    Columns are a, alpha, d and, if there are any, theta_offset, sign and joint, in mm and degrees
    or what the header says; the probe (3,) is in mm. Without a unit, twists of a quarter turn in
    rad and lengths below ten show that they are in rad and in metres, and a note says so.
    """
    table = Columns(path, 3)
    where, guessed = {}, {}
    names = [name.rpartition(".")[2].removeprefix("dh_") for name in table.names]
    for field, words in _COLUMNS.items():
        if words := [word for word in words if word in names]:
            where[field] = names.index(words[0])
        elif field in ("a", "alpha", "d"):
            raise TableError(f"{path} has no column {field!r}; it has {table}.")
    rows, values = list(table.rows([where["a"]])), {}
    for field, i in where.items():
        read = table.labels(rows, i) if field in _WORDS else table.numbers(rows, [i])[:, 0]
        values[field] = read.tolist()
    a, alpha, d = (np.abs(values[field]) for field in ("a", "alpha", "d"))
    if np.any(np.abs(alpha - np.pi / 2) < _QUARTER) and alpha.max() < 2 * np.pi:
        guessed |= dict.fromkeys(_ANGLES, "rad")
    # Of axes that are nearly parallel d may be a hundred metres; a says how large the arm is.
    if 0 < (a.max() or d.max()) < _MOST_METRES:
        guessed |= dict.fromkeys(("a", "d"), "m")
    guessed = {f: unit for f, unit in guessed.items() if f in where and not table.units[where[f]]}
    if guessed:
        shown = ", ".join(f"{table.header[where[f]]} in {unit}" for f, unit in guessed.items())
        print_notes([f"Taken by their size, for the header names no unit: {shown}."])
    if convention == "standard":
        print_notes(["Taken as the standard convention; --modified takes the other one."])
    for field in where.keys() - _WORDS:
        units, unit = ("deg", "rad") if field in _ANGLES else ("mm", "m"), table.units[where[field]]
        unit = unit or guessed.get(field, units[0])
        if unit not in units:
            raise TableError(f"{path}: the column {table.header[where[field]]!r} is in {unit}.")
        values[field] = np.multiply(_FACTORS[unit], values[field])
    twists = values["alpha"] if convention == "standard" else values["alpha"][1:]
    pose = Arm.usual_pose(len(rows), len(rows) > 2 and abs(np.sin(twists[1])) < 1e-9, convention)
    if convention == "standard" and np.abs(values["d"]).max() > Arm.MAX_LENGTH_MM:
        offsets = values.get("theta_offset", np.zeros(len(rows)))
        table = np.column_stack([values["a"], values["alpha"], values["d"], offsets])
        values = {field: values[field] for field in ("joint_signs", "names") if field in values}
        return Arm.from_far_axes(table, probe, name=Path(path).stem, **values)
    return Arm(**values, **pose, convention=convention, probe=probe, name=Path(path).stem)
