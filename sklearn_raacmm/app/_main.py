"""The command `raacmm`: its words, and what all of them share.

Plain argparse: no further packages, and the same help on every terminal. What a word does is
imported when it is run, so that help is there at once.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import argparse
import contextlib
import importlib
import json
import os
import re
import sys
import warnings
from difflib import get_close_matches
from typing import Any, NamedTuple

from sklearn_raacmm._version import __version__
from sklearn_raacmm.app import _options

BAD_INPUT, INTERRUPTED = 2, 130
_EPILOG = (
    "Exit codes: 0 done, 2 bad input, 3 the correction does not help, or a check found a change, "
    "4 not judged: first repair what was found in the data."
)


class _Word(NamedTuple):
    """A word of the command: its function is in the room, its options in `_options`."""

    name: str
    room: str
    text: str
    example: str


_WORDS = (
    _Word(
        "learn", "_commands", "calibrate an arm, learn a correction, judge it, report",
        "raacmm learn cone_test.csv --arm my_arm.json --out my_arm --limit-2s 0.05",
    ),
    _Word(
        "correct", "_commands", "correct a table of any length",
        "raacmm correct today.csv --model my_arm --out corrected.csv",
    ),
    _Word(
        "check", "_commands", "ask whether a correction still holds today",
        "raacmm check small_test.csv --model my_arm --record checks.csv --chart chart.svg",
    ),
    _Word(
        "register", "_life", "find a new probe or a new place through the correction",
        "raacmm register two_cones.csv --model my_arm --out my_arm_250mm",
    ),
    _Word(
        "update", "_life", "bring a correction up to date with few new poses",
        "raacmm update today.csv --model my_arm --out my_arm_2026",
    ),
    _Word(
        "move", "_life", "move a correction to a probe whose vector is known",
        "raacmm move --model my_arm --probe 0,0,250 --out my_arm_250mm",
    ),
    _Word(
        "export", "_commands", "write a correction for other software",
        "raacmm export --model my_arm --c c_source --onnx my_arm.onnx",
    ),
    _Word(
        "arm", "_commands", "show an arm and write its file; without an arm it asks",
        "raacmm arm --lengths-222 375 750 500 100 --out my_arm.json",
    ),
    _Word(
        "plan", "_plan", "plan a first test of twenty minutes: a sheet with places and poses",
        "raacmm plan --arm my_arm.json --out plan",
    ),
    _Word(
        "demo", "_commands", "learn the correction of a simulated arm, with a report",
        "raacmm demo --open",
    ),
    _Word(
        "completion", "_main", "print what makes a shell complete words and options",
        'eval "$(raacmm completion)"',
    ),
)  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
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
    streams: tuple[Any, Any] = (sys.stdout, sys.stderr)
    for stream in streams:
        # Labels that a terminal cannot show must not end the work.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    try:
        return _run(options)
    except BrokenPipeError:  # whoever read our output, such as `head`, has enough
        with contextlib.suppress(OSError):  # or the interpreter complains at its end
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return _refuse(options, _sentence_of(error))
    # ImportError: an extra is missing, and the sentence says which.
    except (ValueError, TypeError, ImportError) as error:
        return _refuse(options, error)
    except KeyboardInterrupt:
        print("raacmm: interrupted", file=sys.stderr)
        return INTERRUPTED


def _run(options):
    """Run a word; what it says goes beside what it writes to the standard output."""
    options.stdout = sys.stdout
    room = importlib.import_module(f"sklearn_raacmm.app.{options.room}")
    with contextlib.ExitStack() as stack:
        if options.quiet:
            nowhere = stack.enter_context(open(os.devnull, "w", encoding="utf-8"))
            stack.enter_context(contextlib.redirect_stdout(nowhere))
        elif options.json or getattr(options, "out", None) == "-":
            stack.enter_context(contextlib.redirect_stdout(sys.stderr))
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore" if options.quiet else "always", UserWarning)
        warnings.showwarning = _show_warning
        done = getattr(room, options.word)(options)
    code, facts = done if isinstance(done, tuple) else (done, {})
    if options.json:
        print(
            json.dumps({"exit_code": code, **facts}, indent=1, ensure_ascii=False),
            file=options.stdout,
        )
    return code


def _refuse(options, error):
    if options.json:
        print(json.dumps({"exit_code": BAD_INPUT, "error": str(error)}, ensure_ascii=False))
    print(f"raacmm {options.word}: {error}", file=sys.stderr)
    return BAD_INPUT


def _sentence_of(error):
    """What an error says; of the system's own, without its number."""
    if error.strerror and error.filename is not None:
        # Files are written under another name first.
        name = re.sub(r"(\.[0-9a-f]+)+\.tmp$", "", str(error.filename))
        return f"{name}: {error.strerror.lower()}."
    return error


def _show_warning(message, category, filename, lineno, file=None, line=None):
    print(f"note: {message}", file=sys.stderr)


class _Parser(argparse.ArgumentParser):
    """A parser that asks whether a similar word was meant."""

    known: Any = ()

    def error(self, message):
        wrong = re.search(r"unrecognized arguments: (\S+)|invalid choice: '([^']*)'", message)
        near = (
            get_close_matches((wrong[1] or wrong[2]).split("=")[0], self.known, 1) if wrong else ()
        )
        super().error(f"{message}. Was {near[0]} meant?" if near else message)


def _parser():
    parser = _Parser(
        "raacmm",
        description="Residual correction for articulated arm coordinate measuring machines.",
        epilog=f"{_EPILOG} raacmm WORD --help shows the options of a word.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    words = parser.add_subparsers(dest="word", required=True, metavar="WORD")
    known = {"--help", "--version"}
    for word in _WORDS:
        own = words.add_parser(
            word.name, help=word.text, description=word.text,
            epilog=f"example:\n  {word.example}\n\n{_EPILOG}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        getattr(_options, word.name)(own)
        own.add_argument("--json", action="store_true", help="print the result as JSON")
        own.add_argument("--quiet", action="store_true", help="print errors only")
        own.set_defaults(room=word.room)
        own.known = (word.name, *own._option_string_actions)
        known.update(own.known)
    parser.known = sorted(known)
    return parser


def completion(options):
    """Print a script for bash and zsh that completes the words and the options of each."""
    parser = _parser()
    groups: Any = parser._subparsers
    words = groups._group_actions[0].choices
    cases = "\n".join(
        f'    {name}) all="{" ".join(own.known[1:])}" ;;' for name, own in words.items()
    )
    print(
        '[ -n "$ZSH_VERSION" ] && autoload -U +X bashcompinit && bashcompinit\n'
        "_raacmm() {\n"
        f'  local all="{" ".join(words)}"\n'
        '  [ "$COMP_CWORD" -gt 1 ] && case "${COMP_WORDS[1]}" in\n'
        f"{cases}\n"
        "  esac\n"
        '  COMPREPLY=($(compgen -W "$all" -- "${COMP_WORDS[COMP_CWORD]}"))\n'
        "}\n"
        "complete -o default -F _raacmm raacmm"
    )
    return 0
