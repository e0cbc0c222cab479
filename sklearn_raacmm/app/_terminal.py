"""What the command prints: sentences and tables at most 80 columns wide, and how long it takes."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import os
import shutil
import sys
import textwrap
import threading
from functools import partial
from time import monotonic

_WIDTH = 80
_GREEN, _YELLOW, _BOLD, _PLAIN = "\x1b[32m", "\x1b[33m", "\x1b[1m", "\x1b[0m"
# Seconds between two lines where nobody sees a bar, and between two looks at a bar.
_LINE_EVERY, _BAR_EVERY = 60.0, 1.0


def _is_terminal(stream):
    return bool(getattr(stream, "isatty", lambda: False)())


def filled(text, stream, indent="  "):
    """A sentence in lines that a terminal can show, or as COLUMNS says; as it is in a file."""
    if not (os.environ.get("COLUMNS", "").isdigit() or _is_terminal(stream)):
        return text
    width = min(_WIDTH, max(20, shutil.get_terminal_size().columns))  # which looks at COLUMNS
    return textwrap.fill(
        text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def say(text="", stream=None):
    """Print a sentence in lines that the terminal can show."""
    print(filled(text, stream or sys.stdout), file=stream)


def print_verdict(text, is_good):
    """Print what the work was for, in colour where the terminal has any and NO_COLOR is not set."""
    plain = "NO_COLOR" in os.environ or os.environ.get("TERM") == "dumb"
    lines = filled(text, sys.stdout, "")
    if _is_terminal(sys.stdout) and not plain:
        lines = f"{_BOLD}{_GREEN if is_good else _YELLOW}{lines}{_PLAIN}"
    print(f"{lines}\n")


def print_scores(scores, rows_named="positions"):
    """Print what was measured at positions left out, without the verdict, and what else."""
    measure, lines = scores.measure, str(scores).split("\n")
    print(f"{measure[0].upper()}{measure[1:]} in mm at {rows_named} left out:")
    for line in lines[2:]:
        # Two spaces part the columns of a table, whose rows stay whole.
        (print if "  " in line else say)(line)


# -- time -----------------------------------------------------------------------------------------


def in_words(seconds):
    """A time that is only known about."""
    if seconds < 90:
        return f"{max(5, 5 * round(seconds / 5)):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Progress:
    """Shows on the standard error how far learning is: ``with Progress(n_rows) as progress``.

    A bar with the time left on a terminal, else a line every minute. `progress(done, total)` is
    called by `learn_correction`; fitting to all rows comes after the last fold.
    """

    def __init__(self, seconds):
        self.seconds, self.done, self.total = seconds, 0, 0
        self.bar = _is_terminal(sys.stderr)
        self._write = partial(print, end="", file=sys.stderr, flush=True)
        self._end = threading.Event()

    def __enter__(self):
        self.start = monotonic()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()
        if self.bar:
            self._write("\r" + " " * (_WIDTH - 1) + "\r")

    def __call__(self, done, total):
        self.done, self.total = done, total
        if self.bar:
            self._write(self._line())

    def _watch(self):
        while not self._end.wait(_BAR_EVERY if self.bar else _LINE_EVERY):
            self._write(self._line())

    def _line(self):
        passed = monotonic() - self.start
        # What was measured counts, as soon as something was; the fit to all rows is one more.
        share = self.done / (self.total + 1)
        whole = passed / share if share else max(self.seconds, 1.2 * passed)
        what = f"{self.done} of {self.total} folds" if self.done else "calibrating, first folds"
        left = f"{what}, about {in_words(max(0.0, whole - passed))} left"
        if not self.bar:
            return f"{left} after {in_words(passed)}\n"
        full = round(24 * (share or passed / whole))
        return "\r" + f"[{'#' * full}{'.' * (24 - full)}] {left}".ljust(_WIDTH - 1)
