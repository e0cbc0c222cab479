"""The command `raacmm`: its words, and what all of them share.

Plain argparse: no further packages, and the same help on every terminal. What a word does is
imported when it is run, so that help is there at once.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import contextlib
import importlib
import io
import json
import os
import re
import shutil
import sys
import tempfile
import warnings
from pathlib import Path

from sklearn_raacmm.app._options import make_parser, with_config
from sklearn_raacmm.app._terminal import say

BAD_INPUT, INTERRUPTED = 2, 130
# Words whose `--out` is a file; that of all others is a folder.
_TO_STANDARD_OUTPUT = ("arm", "correct")


def main(arguments: list[str] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    arguments : list of str, default=None
        Arguments after the command's name. None: the arguments of the command line.

    Returns
    -------
    int
        0: done; 2: bad input, named in one sentence; 3: the correction does not help, or a
        check found that it no longer holds or that something has changed; 4: of `accept`,
        not judged, for something in the run has to be repaired first.
    """
    words = sys.argv[1:] if arguments is None else arguments
    parser = make_parser("--json" in words)
    if "_ARGCOMPLETE" in os.environ:  # a shell asks what may follow
        import argcomplete

        argcomplete.autocomplete(parser)
    try:
        options = parser.parse_args(with_config(words))
    except ValueError as error:  # of the file of options
        parser.error(str(error))
    for stream in (sys.stdout, sys.stderr):
        # Labels that a terminal cannot show must not end the work.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        return _run(options)
    except BrokenPipeError:  # whoever read our output, such as `head`, has enough
        with contextlib.suppress(OSError):  # or the interpreter complains at its end
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    # ImportError: an extra is missing, and the sentence says which.
    except (OSError, ValueError, TypeError, ImportError) as error:
        text = str(error)
        if isinstance(error, OSError) and error.strerror and error.filename is not None:
            # Files are written under another name first.
            name = re.sub(r"(\.[0-9a-f]+)+\.tmp$", "", str(error.filename))
            text = f"{name}: {error.strerror.lower()}."
        if options.json:
            print(json.dumps({"exit_code": BAD_INPUT, "error": text}, ensure_ascii=False))
        say(f"raacmm {options.word}: {text}", sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("raacmm: interrupted", file=sys.stderr)
        return INTERRUPTED


def _run(options):
    """Run a word; its messages go beside what it writes to the standard output."""
    options.stdout = sys.stdout
    if getattr(options, "out", None) == "-" and options.word not in _TO_STANDARD_OUTPUT:
        raise ValueError("--out is a folder here, and - is none: give its name.")
    module = importlib.import_module(f"sklearn_raacmm.app.{options.module}")
    if getattr(options, "accept", None):  # before anything is read, and in a dry run, too
        from sklearn_raacmm.utils import Finding

        Finding.check_accepted(options.accept)
    with contextlib.ExitStack() as stack:
        if getattr(options, "table", None) == "-":
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            options.table = str(Path(folder, "standard-input"))
            with open(options.table, "wb") as file:
                shutil.copyfileobj(sys.stdin.buffer, file)
        if options.quiet or options.json or getattr(options, "out", None) == "-":
            aside = None if options.quiet else sys.stderr
            stack.enter_context(contextlib.redirect_stdout(aside))
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore" if options.quiet else "always", UserWarning)
        warnings.showwarning = lambda message, *_: say(f"note: {message}", sys.stderr)
        code, facts = getattr(module, options.word)(options)
    if options.json:
        text = json.dumps({"exit_code": code, **facts}, indent=1, ensure_ascii=False)
        print(text, file=options.stdout)
    return code
