"""Words and options of the command `raacmm`: two tables, and the parser that is made of them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import argparse
import json
import re
import tomllib
from collections.abc import Callable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from sklearn_raacmm._version import __version__

_EXIT_CODES = "Exit codes: 0 done, 1 a fault of this program, 2 bad input"
# What 3 says, and 4; other words end with 0 to 2.
_NO_HELP = ", 3 nothing that was learnt helps"
_MORE_CODES = {
    "learn": _NO_HELP,
    "demo": _NO_HELP,
    "check": ", 3 the check found a change",
    "register": ", 3 the arm itself may have changed",
    "update": ", 3 nothing was changed: too few poses",
    "accept": ", 3 a limit is missed, 4 not judged, as a finding says",
}

# Options of a logger, beside its tables.
_CONFIG = "raacmm.toml"
_COLUMNS = "--angles --position --unit --counts-per-turn --sheet"
_LEARNING = "--folds --jobs --open --force --dry-run --formulas"
_CAUSES = "--extra --tool"
_TODAY = f"table --model --points --length --lengths --length-sd {_COLUMNS}"

# Each word with the module that holds its function, a description, an example, and its options.
WORDS = {
    "learn": (
        "_commands", "calibrate an arm, learn its correction, judge both, and write a report",
        "raacmm learn cone_test.csv --arm my_arm.json --out my_arm",
        f"table --arm --base --tip --out {_LEARNING} {_COLUMNS} --points --points-sd --length "
        f"--lengths --places --length-sd --feature --kind --tip-diameter {_CAUSES} --block "
        "--station --like --take --accept --serial --operator",
    ),
    "correct": (
        "_correct", "correct a table of any length",
        "raacmm correct today.csv --model my_arm --out corrected.csv",
        f"table --model --out --std --formulas {_CAUSES} {_COLUMNS.replace(' --position', '')}",
    ),
    "check": (
        "_life", "ask whether a correction still holds today",
        "raacmm check small_test.csv --model my_arm --record checks.csv",
        f"{_TODAY} --new-base --record --accept",
    ),
    "register": (
        "_life", "find a new probe or a new place through the correction",
        "raacmm register two_cones.csv --model my_arm --out my_arm_250mm",
        f"{_TODAY} --out --accept --formulas",
    ),
    "update": (
        "_life", "bring a correction up to date with few new poses",
        "raacmm update today.csv --model my_arm --out my_arm_2026",
        f"{_TODAY} --out --accept --formulas",
    ),
    "move": (
        "_life", "move a correction to a probe whose vector is known",
        "raacmm move --model my_arm --probe 0,0,250 --out my_arm_250mm",
        "--model --probe --out",
    ),
    "export": (
        "_commands", "write a correction for other software",
        "raacmm export --model my_arm --c c_source --onnx my_arm.onnx",
        "--model --c --onnx --name --std --fade",
    ),
    "arm": (
        "_arms", "show an arm and write its file; without an arm it asks",
        "raacmm arm --lengths-222 375 750 500 100 --out my_arm.json",
        "source --base --tip --lengths-222 --lengths-223 --elbow-offset --wrist-offset --dh "
        f"--modified --probe --from-data --layout --mirrored --length --lengths "
        f"--length-sd {_COLUMNS} --up --sign --zero --into --out",
    ),
    "plan": (
        "_commands", "plan a first test of twenty minutes: a sheet with places and poses",
        "raacmm plan --arm my_arm.json --out plan",
        "--arm --out --cones --poses --bar --lean --limits",
    ),
    "watch": (
        "_watch", "follow a test while it is measured, on a page that renews itself",
        "raacmm watch cone.csv --arm my_arm.json",
        f"table --arm --model --out {_COLUMNS}",
    ),
    "accept": (
        "_accept", "judge an arm by its acceptance test, as found and as left: a sheet",
        "raacmm accept run.xlsx --model my_arm --out sheet.html",
        "run --model --arm --template --out --language --rule --dcc --open",
    ),
    "demo": (
        "_commands", "learn the correction of a simulated arm, with a report",
        "raacmm demo --open",
        f"--out {_LEARNING}",
    ),
}  # fmt: skip


def _flag(text):
    return {"action": "store_true", "help": text}


def _value(metavar, text, **more):
    return {"metavar": metavar, "help": text, **more}


def _number(metavar, text, kind: Callable[[str], object] = float, **more):
    return _value(metavar, text, type=kind, **more)


def _many(metavar, text):
    return _value(metavar, text, action="append", default=[])


def _choice(choices, text, default=None, **more):
    return {"choices": choices, "help": text, "default": default, **more}


_ARM = "arm file, URDF, or name of a built-in arm"
_FOLDER = _value("FOLDER", "folder to write into (default: the folder of --model)")
_LENGTHS = ("SHOULDER", "UPPER", "FORE", "PROBE")
# What argparse takes of each option; "word option" where it differs in a word.
OPTIONS: dict[str, dict[str, Any]] = {
    "learn table": {"help": "one row per pose: joint angles and position"},
    "correct table": {"help": "table with joint angles; - is the standard input"},
    "check table": {"help": "a small test of today: joint angles in a few cones"},
    "register table": {"help": "poses with the new probe, or in the new place: 15 in two cones"},
    "update table": {"help": "20 poses or more of the arm as it is now"},
    "watch table": {"help": "the table that the arm's logger writes, row by row"},
    "source": {"nargs": "?", "help": _ARM},
    "--arm": _value("ARM", _ARM, required=True),
    "--base": _value("LINK", "first link of a URDF's chain"),
    "--tip": _value("LINK", "last link of a URDF's chain: the probe"),
    "--model": _number("FOLDER", "folder written by raacmm learn", Path, required=True),
    "--out": _value("FOLDER", "folder to write into", required=True),
    "correct --out": _value("CSV", "table to write; - is the standard output", required=True),
    **dict.fromkeys(("register --out", "update --out", "move --out"), _FOLDER),
    "demo --out": _value("FOLDER", "folder to write into (raacmm-demo)", default="raacmm-demo"),
    "arm --out": _value("FILE", "JSON, or what --into names; - is the standard output"),
    # -- the table
    "--angles": _number("Q1,Q2,...", "columns of the joint angles", lambda text: text.split(",")),
    "--position": _value("NAME", "column of the positions' labels"),
    "--unit": _choice(("deg", "rad"), "unit of the joint angles", dest="angle_unit"),
    "--counts-per-turn": _value("N", "counts of the encoders in a turn, one or one for each joint"),
    "--sheet": _value(
        "NAME", "name or number of the sheet of a spreadsheet; topics of a log of ROS"
    ),
    "--points": _value("X,Y,Z", "columns of a tracker's points, or a file of points"),
    "--points-sd": _number("MM", "sd of one coordinate of the tracker's points", default=0.0),
    "--length": _many(
        "FROM:TO:MM:SD[@DEGC]",
        "a known distance in mm, its sd in mm, and the temperature of the bar",
    ),
    "--lengths": _value("CSV", "file of known lengths, with the columns from, to, mm, sd in mm"),
    "--places": _value("CSV", "file of a plate's known points: position, x, y, z, sd in mm"),
    "--length-sd": _number("MM", "sd of the known lengths that state none"),
    "--feature": _many(
        "LABEL:KIND[:SIZE:SD]",
        "positions that are touches of a plane or sphere, perhaps of known diameter in mm",
    ),
    "--kind": _value("COLUMN", "column that says what was touched: plane, sphere or cone"),
    "--tip-diameter": _number("MM", "diameter of the probe's own ball, for --feature", default=0.0),
    "--extra": _value(
        "NAME[=COLUMN]", "columns of other causes: temperature=T1, payload, time", nargs="+"
    ),
    "correct --std": _choice(
        ("no", "point", "all"),
        "standard deviations to write: none, of coordinates, or also within a position and of 1 m",
        "all",
    ),
    "--formulas": _flag("write cells such as =A1 as they are, not behind an apostrophe"),
    "--tool": _value("COLUMN", "column that names the probe of each row, where there are several"),
    "--block": _value("COLUMN", "column that names groups of positions, each left out as a whole"),
    "--station": _value(
        "COLUMN", "column that names the set-up of each row, if tracker or arm were moved"
    ),
    # -- learning
    "--folds": _number("N", "how many times some positions are left out (5)", int),
    "--jobs": _number("N", "folds computed at the same time (1)", int),
    "--open": _flag("open the report in the browser"),
    "accept --open": _flag("open the sheet in the browser"),
    "--dry-run": _flag("say what was read and what would be done, and stop"),
    "--force": _flag("replace the correction that the folder holds"),
    "--like": _number("FOLDER", "corrections of earlier arms of this make", Path, nargs="+"),
    "--take": _many(
        "CODE", "change the arm as learn proposes, such as reversed-2-4 or coupled-2-3"
    ),
    "--serial": _value("TEXT", "serial number, for the report"),
    "--operator": _value("NAME", "name of the operator, for the report"),
    # -- the life of a correction
    "--new-base": _flag("the tracker was set up anew: find the base from these poses"),
    "--record": _value("CSV", "file to which a line on this check is appended"),
    "--accept": _many(
        "CODE", "go on in spite of the finding of this code, such as corrected-already"
    ),
    "move --probe": _value(
        "X,Y,Z",
        "centre of the probe in the last frame, mm, such as --probe=-5,0,250",
        required=True,
    ),
    "--c": _value("FOLDER", "folder for C source and header"),
    "--onnx": _value("FILE", "ONNX file to write"),
    "--name": _value("NAME", "name of the C functions (arm_correction)", default="arm_correction"),
    "--std": _flag("write standard deviations in C, too"),
    "--fade": _choice(
        ("small", "exact", "no"),
        "how a correction fades where the model knows little: nearly as in Python from small "
        "tables, exactly so, or not at all (small)",
        "small",
    ),
    # -- acceptance
    "run": {"help": "spreadsheet or folder of CSV: readings, artefacts, limits and sheet"},
    "accept --model": _number("FOLDER", "folder written by raacmm learn: the arm as left", Path),
    "accept --arm": _value(
        "ARM", "the arm as found (default: the table of --model without its correction)"
    ),
    "accept --out": _value("HTML", "sheet to write (sheet.html)", default="sheet.html"),
    "watch --arm": _value("ARM", _ARM),
    "watch --model": _number("FOLDER", "correction that is in use: it is checked", Path),
    "watch --out": _value("HTML", "page to write (watch.html)", default="watch.html"),
    "--template": _flag("write the spreadsheet RUN for this arm, to be filled in"),
    "--language": _choice(("en", "de"), "language of the sheet (en)", "en"),
    "--rule": _choice(
        ("guarded", "simple"),
        "decide with a guard of 1.645 standard uncertainties, or without",
        "guarded",
    ),
    "--dcc": _value("XML", "also write a Digital Calibration Certificate"),
    # -- arms
    "--lengths-222": _number(_LENGTHS, "lengths in mm of a 2-2-2 arm", nargs=4),
    "--lengths-223": _number(_LENGTHS, "lengths in mm of a 2-2-3 arm", nargs=4),
    "--elbow-offset": _number("MM", "how far the elbow's axes pass each other (0)", default=0.0),
    "--wrist-offset": _number("MM", "how far the wrist's axes pass each other (0)", default=0.0),
    "--dh": _value("TABLE", "table of a, alpha, d and theta offset"),
    "--modified": _flag("the table of --dh is in the modified convention"),
    "arm --probe": _value("X,Y,Z", "probe centre in the last frame, mm, for --dh"),
    "--from-data": _value("TABLE", "a test in ten cones, of an arm of which --layout is known"),
    "--layout": _choice(("2-2-2", "2-2-3"), "joints at shoulder, elbow and wrist, for --from-data"),
    "--mirrored": _flag("take the mirror image of the arm that --from-data finds"),
    "--up": _value("X,Y,Z", "direction against gravity in the base frame; 0,0,1: upright"),
    "--sign": _value("S1,S2,...", "-1 where an encoder counts against its joint, else 1"),
    "--zero": _value("Q1,Q2,...", "degrees that the encoders show at the zero of the arm"),
    "--into": _value("FILE", "write into a copy of the robot's own URDF or UR kinematics"),
    "--cones": _number("N", "number of cones (8)", int, default=8),
    "--poses": _number("N", "poses in each cone (12)", int, default=12),
    "--bar": _number("MM", "length of the bar between two of the cones (by the reach); 0: no bar"),
    "--lean": _number("DEG", "how far the probe may lean from the vertical (no limit)"),
    "--limits": _value("LOW1,HIGH1,...", "limits of the joints in degrees, where ARM has none"),
    "--json": _flag("print the result as JSON"),
    "--quiet": _flag("print errors only"),
}


def with_config(words):
    """Words of a command line, behind the options of ``raacmm.toml`` beside the table they name.

    What the command line says counts more, and options of other words of the command are passed
    over. Paths are those of the file's folder.
    """
    tables = [Path(word) for word in words[1:] if not word.startswith("-") and Path(word).is_file()]
    if not tables or words[0] not in WORDS or not (tables[0].parent / _CONFIG).is_file():
        return words
    path = tables[0].parent / _CONFIG
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:  # no TOML, or no UTF-8
        raise ValueError(f"{path}: {error}") from None
    more: list[str] = []
    for name, value in given.items():
        option = f"--{name.replace('_', '-')}"
        if option not in OPTIONS:
            near = get_close_matches(option, OPTIONS, 1)
            meant = f" Was {near[0].removeprefix('--')} meant?" if near else ""
            raise ValueError(f"{path}: {name} is no option of raacmm.{meant}")
        if option not in WORDS[words[0]][3].split():
            continue
        kind = OPTIONS.get(f"{words[0]} {option}") or OPTIONS[option]
        values = list(map(str, value if isinstance(value, list) else [value]))
        is_place = Path.exists if kind.get("type") is Path else Path.is_file  # folders, too
        values = [str(at) if is_place(at := path.parent / one) else one for one in values]
        if kind.get("action") == "store_true":
            more += [option] * bool(value)
        elif kind.get("nargs"):
            more += [option, *values]
        else:
            several = values if kind.get("action") == "append" else [",".join(values)]
            more += [f"{option}={one}" for one in several]
    return [words[0], *more, *words[1:]]


class _Parser(argparse.ArgumentParser):
    """A parser that asks whether a similar word was meant, in JSON if that is asked for."""

    as_json = False

    def error(self, message):
        wrong = re.search(r"unrecognized arguments: ([^\s=]+)|invalid choice: '([^']*)'", message)
        if wrong:
            given = wrong[1] or wrong[2]
            words = [word for word, (*_, names) in WORDS.items() if given in names.split()]
            if words:
                message = f"{given} is an option of {', '.join(words)} only"
            elif near := get_close_matches(given, [*WORDS, *OPTIONS], 1):
                message = f"{message}. Was {near[0]} meant?"
        if _Parser.as_json:
            print(json.dumps({"exit_code": 2, "error": message}))
        super().error(message)


def make_parser(as_json=False):
    """The parser of the command."""
    _Parser.as_json = as_json
    parser = _Parser(
        "raacmm",
        description="Residual correction for articulated arm coordinate measuring machines.",
        epilog=f"{_EXIT_CODES}. raacmm WORD --help shows the options of a word, and further codes.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    words = parser.add_subparsers(dest="word", required=True, metavar="WORD")
    for word, (module, text, example, names) in WORDS.items():
        codes = f"{_EXIT_CODES}{_MORE_CODES.get(word, '')}."
        own = words.add_parser(
            word, help=text, description=text, epilog=f"example:\n  {example}\n\n{codes}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        # Lists of numbers may begin with a negative one: --up -1,0,0.
        own._negative_number_matcher = re.compile(r"^-\.?\d[-\d.,e]*$")
        own.set_defaults(module=module)
        for option in (*names.split(), "--json", "--quiet"):
            own.add_argument(option, **(OPTIONS.get(f"{word} {option}") or OPTIONS[option]))
    return parser
