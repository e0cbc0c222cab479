"""Words and options of the command `raacmm`: two tables, and the parser that is made of them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import argparse
import json
import re
from difflib import get_close_matches
from typing import Any

from sklearn_raacmm._version import __version__

_EPILOG = (
    "Exit codes: 0 done, 2 bad input, 3 the correction does not help, or a check found a change, "
    "4 not judged: first repair what was found in the data."
)


_COLUMNS = "--angles --position --unit --counts-per-turn --sheet"
_LEARNING = "--limit-2s --folds --jobs --open --force"
_CAUSES = "--extra --in-order --tool"
_TODAY = f"table --model --points --length --lengths --length-sd {_COLUMNS}"

# Each word with the module that holds its function, a description, an example, and its options.
WORDS = {
    "learn": (
        "_commands", "calibrate an arm, learn a correction, judge it, report",
        "raacmm learn cone_test.csv --arm my_arm.json --out my_arm --limit-2s 0.05",
        f"table --arm --base --tip --out {_LEARNING} {_COLUMNS} --points --points-sd --length "
        f"--lengths --places --length-sd {_CAUSES} --like --take --serial --operator",
    ),
    "correct": (
        "_commands", "correct a table of any length",
        "raacmm correct today.csv --model my_arm --out corrected.csv",
        f"table --model --out --std {_CAUSES} {_COLUMNS.replace(' --position', '')}",
    ),
    "check": (
        "_life", "ask whether a correction still holds today",
        "raacmm check small_test.csv --model my_arm --record checks.csv",
        f"{_TODAY} --new-base --record",
    ),
    "register": (
        "_life", "find a new probe or a new place through the correction",
        "raacmm register two_cones.csv --model my_arm --out my_arm_250mm",
        f"{_TODAY} --out",
    ),
    "update": (
        "_life", "bring a correction up to date with few new poses",
        "raacmm update today.csv --model my_arm --out my_arm_2026",
        f"{_TODAY} --out --date --accept",
    ),
    "move": (
        "_life", "move a correction to a probe whose vector is known",
        "raacmm move --model my_arm --probe 0,0,250 --out my_arm_250mm",
        "--model --probe --out",
    ),
    "export": (
        "_commands", "write a correction for other software",
        "raacmm export --model my_arm --c c_source --onnx my_arm.onnx",
        "--model --c --onnx --name --std --any-probe --fade",
    ),
    "arm": (
        "_arms", "show an arm and write its file; without an arm it asks",
        "raacmm arm --lengths-222 375 750 500 100 --out my_arm.json",
        "source --base --tip --lengths-222 --lengths-223 --elbow-offset --wrist-offset --dh "
        "--modified --probe --up --sign --zero --into --out --picture",
    ),
    "plan": (
        "_commands", "plan a first test of twenty minutes: a sheet with places and poses",
        "raacmm plan --arm my_arm.json --out plan",
        "--arm --out --cones --poses --lean",
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


_FOLDER = {"help": "folder to write into (default: the folder of --model)"}
_LENGTHS: dict[str, Any] = {
    "type": float, "nargs": 4, "metavar": ("SHOULDER", "UPPER", "FORE", "PROBE"),
}  # fmt: skip
_OFFSET: dict[str, Any] = {"type": float, "default": 0.0, "metavar": "MM"}
# What argparse takes of each option; "word option" where it differs in a word.
OPTIONS: dict[str, dict[str, Any]] = {
    "learn table": {"help": "one row per pose: joint angles and position"},
    "correct table": {"help": "table with joint angles; - is the standard input"},
    "check table": {"help": "a small test of today"},
    "register table": {
        "help": "poses with the new probe, or in the new place: 15 in two cones will do"
    },
    "update table": {"help": "20 poses or more of the arm as it is now"},
    "source": {"nargs": "?", "help": "arm file, URDF, or name of a built-in arm"},
    "--arm": {"required": True, "help": "arm file, URDF, or name of a built-in arm"},
    "--base": {"metavar": "LINK", "help": "first link of a URDF's chain"},
    "--tip": {"metavar": "LINK", "help": "last link of a URDF's chain: the probe"},
    "--model": {"required": True, "help": "folder written by raacmm learn"},
    "--out": {"required": True, "help": "folder to write into"},
    "correct --out": {"required": True, "help": "CSV to write; - is the standard output"},
    **dict.fromkeys(("register --out", "update --out", "move --out"), _FOLDER),
    "demo --out": {"default": "raacmm-demo", "help": "folder to write into (raacmm-demo)"},
    "arm --out": {"help": "file to write, JSON or what --into names; - is the standard output"},
    # -- the table
    "--angles": {"metavar": "Q1,Q2,...", "help": "columns of the joint angles"},
    "--position": {"metavar": "NAME", "help": "column of the positions' labels"},
    "--unit": {"choices": ("deg", "rad"), "help": "unit of the joint angles"},
    "--counts-per-turn": {
        "metavar": "N", "help": "counts of the encoders in a turn, one number or one for each joint"
    },
    "--sheet": {"metavar": "NAME", "help": "sheet of a spreadsheet, name or number"},
    "--points": {"metavar": "X,Y,Z", "help": "columns of a tracker's points, or a file of points"},
    "--points-sd": {
        "type": float, "metavar": "MM", "default": 0.0,
        "help": "sd of a tracker's coordinate, which is not the arm's",
    },
    "--length": {
        "action": "append", "metavar": "FROM:TO:MM:SD",
        "help": "a known distance in mm and its sd: of a bar in two cones, or of a cone plate "
        "moved",
    },
    "--lengths": {"metavar": "CSV", "help": "known lengths: from, to, mm, sd in mm"},
    "--places": {"metavar": "CSV", "help": "a plate of known points: position, x, y, z, sd in mm"},
    "--length-sd": {"type": float, "metavar": "MM", "help": "sd of all known lengths"},
    "--extra": {
        "nargs": "+", "metavar": "NAME[=COLUMN]",
        "help": "a cause that a column holds, such as temperature=T1, payload, time",
    },
    "correct --std": {
        "choices": ("no", "point", "all"), "default": "all",
        "help": "standard deviations to write: none, of the coordinates, or also within a position "
        "and of a distance of 1 m (all)",
    },
    "--in-order": _flag("rows are in the order of measurement: use the directions of the joints"),
    "--tool": {"metavar": "COLUMN", "help": "column of the probe's name, where several took turns"},
    # -- learning
    "--limit-2s": {"type": float, "metavar": "MM", "help": "limit of the mean 2S to judge by"},
    "--folds": {"type": int, "help": "times that some positions are left out (5)"},
    "--jobs": {"type": int, "help": "folds computed at the same time (1)"},
    "--open": _flag("open the report in the browser"),
    "--force": _flag("replace the correction that the folder holds"),
    "--like": {
        "nargs": "+", "metavar": "FOLDER",
        "help": "folders of corrections of earlier arms of this make",
    },
    "--take": {
        "action": "append", "metavar": "CODE",
        "help": "change the arm as a finding proposes: reversed-2-4, other-convention",
    },
    "--serial": {"help": "serial number, for the report"},
    "--operator": {"help": "name, for the report"},
    # -- the life of a correction
    "--new-base": _flag("the tracker was set up anew: find the base from these poses"),
    "--record": {"metavar": "CSV", "help": "file to append the line of this check to"},
    "--accept": {
        "action": "append", "metavar": "CODE",
        "help": "go on in spite of a finding, such as corrected-already",
    },
    "--date": {"help": "when they were measured (today)"},
    "move --probe": {
        "metavar": "X,Y,Z", "required": True,
        "help": "vector of the new probe in the last frame, mm; --probe=-5,0,250 before a sign",
    },
    "--c": {"metavar": "FOLDER", "help": "C source and header"},
    "--onnx": {"metavar": "FILE", "help": "ONNX file to write"},
    "--name": {"default": "arm_correction", "help": "name of the C functions"},
    "--std": _flag("standard deviations in C, too"),
    "--any-probe": _flag("functions in C take the vector of the probe, too"),
    "--fade": {
        "choices": ("small", "exact", "none"), "default": "small",
        "help": "how the correction fades where little is known: from small tables (small), as in "
        "Python (exact), not at all (none)",
    },
    # -- acceptance
    "run": {
        "help": "spreadsheet or folder of CSV with readings, artefacts, limits and entries of the "
        "sheet"
    },
    "accept --model": {"help": "folder written by raacmm learn: the arm as left"},
    "accept --arm": {"help": "the arm as found (the table of --model, without its correction)"},
    "accept --out": {"default": "sheet.html", "help": "sheet to write (sheet.html)"},
    "--template": _flag("write RUN without numbers, .xlsx or a folder of CSV, for this arm"),
    "--language": {"choices": ("en", "de"), "default": "en", "help": "of the sheet (en)"},
    "--rule": {
        "choices": ("guarded", "simple"), "default": "guarded",
        "help": "decision rule: with a guard of 1.645 u, or without (guarded)",
    },
    "--dcc": {"metavar": "FILE", "help": "Digital Calibration Certificate (XML) to write, too"},
    # -- arms
    "--lengths-222": _LENGTHS | {"help": "lengths in mm of a 2-2-2 arm"},
    "--lengths-223": _LENGTHS | {"help": "lengths in mm of a 2-2-3 arm"},
    "--elbow-offset": _OFFSET | {
        "help": "distance in mm at which the axes of the elbow pass each other (0)"
    },
    "--wrist-offset": _OFFSET | {
        "help": "distance in mm at which the axes of the wrist pass each other (0)"
    },
    "--dh": {"metavar": "TABLE", "help": "table of a, alpha, d and theta offset"},
    "--modified": _flag("the table of --dh is in the modified convention"),
    "arm --probe": {"metavar": "X,Y,Z", "help": "probe centre in the last frame, mm, for --dh"},
    "--up": {
        "metavar": "X,Y,Z",
        "help": "direction against gravity in the base frame; 0,0,1: the arm stands upright",
    },
    "--sign": {
        "metavar": "S1,S2,...",
        "help": "1 where a joint's encoder counts as the joint turns, -1 where it does not",
    },
    "--zero": {
        "metavar": "Q1,Q2,...",
        "help": "what each encoder shows where its joint stands at the zero of the arm, degrees",
    },
    "--into": {
        "metavar": "FILE",
        "help": "write the arm's numbers into a copy of the robot's own URDF or UR kinematics",
    },
    "--picture": {"metavar": "SVG", "help": "picture of the arm and its axes"},
    "--cones": {"type": int, "default": 8, "help": "number of cones (8)"},
    "--poses": {"type": int, "default": 12, "help": "poses in each cone (12)"},
    "--lean": {
        "type": float, "default": 60.0, "metavar": "DEG",
        "help": "how far the probe may lean from the vertical in a cone, degrees (60)",
    },
    "--json": _flag("print the result as JSON"),
    "--quiet": _flag("print errors only"),
}  # fmt: skip


class _Parser(argparse.ArgumentParser):
    """A parser that asks whether a similar word was meant."""

    known: Any = ()
    as_json = False

    def refuse_unknown(self, words):
        """Refuse a mistyped option before the right one is reported as missing."""
        _Parser.as_json = "--json" in words
        for name in (word.split("=")[0] for word in words):
            if name.startswith("--") and not any(one.startswith(name) for one in self.known):
                self.error(f"unrecognized arguments: {name}")

    def error(self, message):
        wrong = re.search(r"unrecognized arguments: (\S+)|invalid choice: '([^']*)'", message)
        if wrong:
            given = (wrong[1] or wrong[2]).split("=")[0]
            words = [word for word, (*_, names) in WORDS.items() if given in names.split()]
            near = get_close_matches(given, self.known, 1)
            if words:
                message = f"{given} is an option of {', '.join(words)} only"
            elif near:
                message = f"{message}. Was {near[0]} meant?"
        if self.as_json:
            print(json.dumps({"exit_code": 2, "error": message}))
        super().error(message)


def make_parser():
    """The parser of the command; its `known` are all options and words."""
    parser = _Parser(
        "raacmm",
        description="Residual correction for articulated arm coordinate measuring machines.",
        epilog=f"{_EPILOG} raacmm WORD --help shows the options of a word.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    words = parser.add_subparsers(dest="word", required=True, metavar="WORD")
    known = {"--help", "--version"}
    for word, (module, text, example, names) in WORDS.items():
        own = words.add_parser(
            word, help=text, description=text, epilog=f"example:\n  {example}\n\n{_EPILOG}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        for option in (*names.split(), "--json", "--quiet"):
            own.add_argument(option, **(OPTIONS.get(f"{word} {option}") or OPTIONS[option]))
        # Lists of numbers may begin with a negative one: --up -1,0,0.
        own._negative_number_matcher = re.compile(r"^-\.?\d[-\d.,e]*$")
        own.set_defaults(module=module)
        own.known = (word, *own._option_string_actions)
        known.update(own.known)
    parser.known = sorted(known)
    return parser
