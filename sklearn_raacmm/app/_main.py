"""The command `raacmm`: its words and options.

Plain argparse: no further packages, and the same help on every terminal.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import argparse
import re
import sys
import warnings

from sklearn_raacmm._version import __version__
from sklearn_raacmm.app import _commands

_EPILOG = (
    "Exit codes: 0 done, 2 bad input, 3 the correction does not help, or a check found a change, "
    "4 not judged: first repair what was found in the data."
)


def main(arguments=None):
    """Run the command.

    Parameters
    ----------
    arguments : list of str, default=None
        None: those of the command line.

    Returns
    -------
    int
        0: done; 2: bad input, said in one sentence; 3: the correction does not help, or a
        check found that it no longer holds or that something has changed; 4: not judged, for
        something in the data has to be repaired first.
    """
    options = _parser().parse_args(arguments)
    for stream in (sys.stdout, sys.stderr):
        # Labels that a terminal cannot show must not end the work.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = _show_warning
        try:
            return options.run(options)
        # ImportError: an extra is missing, and the sentence says which.
        except (ValueError, TypeError, OSError, ImportError) as error:
            print(f"raacmm {options.word}: {_sentence_of(error)}", file=sys.stderr)
            return _commands.BAD_INPUT
        except KeyboardInterrupt:
            print("raacmm: interrupted", file=sys.stderr)
            return 130


def _sentence_of(error):
    """What an error says; of the system's own, without its number."""
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        # Files are written under another name first.
        name = re.sub(r"\.[0-9a-f]+\.tmp$", "", str(error.filename))
        return f"{name}: {error.strerror.lower()}."
    return error


def _show_warning(message, category, filename, lineno, file=None, line=None):
    print(f"note: {message}", file=sys.stderr)


def _parser():
    parser = argparse.ArgumentParser(
        "raacmm",
        description="Residual correction for articulated arm coordinate measuring machines.",
        epilog=_EPILOG,
    )
    parser.add_argument("--version", action="version", version=__version__)
    words = parser.add_subparsers(dest="word", required=True, metavar="WORD")
    learn = _word(words, "learn", "calibrate an arm, learn a correction, judge it, report")
    learn.add_argument("table", help="CSV or XLSX, one row per pose: joint angles and position")
    learn.add_argument("--arm", required=True, help="arm file, URDF, or name of a built-in arm")
    _add_learning(learn, out=None)
    _add_columns(learn)
    learn.add_argument("--points", metavar="X,Y,Z", help="columns of a tracker's points")
    learn.add_argument("--lengths", metavar="CSV", help="known lengths: from, to, mm, sd in mm")
    learn.add_argument("--length-sd", type=float, metavar="MM", help="sd of all known lengths")
    learn.add_argument("--serial", help="serial number, for the report")
    learn.add_argument("--operator", help="name, for the report")

    correct = _word(words, "correct", "correct a table of any length")
    correct.add_argument("table", help="CSV or XLSX with joint angles")
    _add_model(correct)
    correct.add_argument("--out", required=True, help="CSV to write")
    _add_columns(correct, labelled=False)

    check = _word(words, "check", "ask whether a correction still holds today")
    check.add_argument("table", help="a small single-point test of today")
    _add_model(check)
    check.add_argument("--record", metavar="CSV", help="file to append the line of this check to")
    check.add_argument("--chart", metavar="SVG", help="control chart of the record to write")
    _add_columns(check)

    export = _word(words, "export", "write a correction for other software")
    _add_model(export)
    export.add_argument("--c", metavar="FOLDER", help="C source and header")
    export.add_argument("--onnx", metavar="FILE", help="ONNX file to write")
    export.add_argument("--name", default="arm_correction", help="name of the C functions")
    export.add_argument("--std", action="store_true", help="standard deviations in C, too")

    _add_arm(words)

    demo = _word(words, "demo", "learn the correction of a simulated arm, with a report")
    _add_learning(demo, out="raacmm-demo")
    demo.set_defaults(
        angles=None, position=None, unit=None, points=None, lengths=None, length_sd=None,
        serial="simulated", operator=None,
    )  # fmt: skip
    return parser


def _word(words, name, text):
    parser = words.add_parser(name, help=text, description=text, epilog=_EPILOG)
    parser.set_defaults(run=getattr(_commands, name))
    return parser


def _add_arm(words):
    arm = _word(words, "arm", "show an arm and write its file; without an arm it asks")
    arm.add_argument("source", nargs="?", help="arm file, URDF, or name of a built-in arm")
    arm.add_argument("--base", help="first link of a URDF's chain")
    arm.add_argument("--tip", help="last link of a URDF's chain")
    for layout in ("222", "223"):
        arm.add_argument(
            f"--lengths-{layout}", type=float, nargs=4,
            metavar=("SHOULDER", "UPPER", "FORE", "PROBE"),
            help=f"lengths in mm of a {'-'.join(layout)} arm",
        )  # fmt: skip
    for place in ("elbow", "wrist"):
        text = f"distance in mm at which the axes of the {place} pass each other (0)"
        arm.add_argument(f"--{place}-offset", type=float, default=0.0, metavar="MM", help=text)
    arm.add_argument("--out", help="JSON file to write")
    arm.add_argument("--picture", metavar="SVG", help="picture of the arm and its axes")


def _add_learning(parser, out):
    parser.add_argument("--out", required=out is None, default=out, help="folder to write into")
    parser.add_argument(
        "--limit-2s", type=float, metavar="MM", help="limit of the mean 2S to judge by"
    )
    parser.add_argument("--folds", type=int, help="times that some positions are left out (5)")
    parser.add_argument("--jobs", type=int, help="folds computed at the same time (1)")
    parser.add_argument("--open", action="store_true", help="open the report in the browser")


def _add_columns(parser, labelled=True):
    parser.add_argument("--angles", metavar="Q1,Q2,...", help="columns of the joint angles")
    if labelled:
        parser.add_argument("--position", metavar="NAME", help="column of the positions' labels")
    parser.add_argument("--unit", choices=("deg", "rad"), help="unit of the joint angles")


def _add_model(parser):
    parser.add_argument("--model", required=True, help="folder written by raacmm learn")
