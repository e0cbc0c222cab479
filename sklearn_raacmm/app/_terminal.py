"""What the command prints: sentences and tables at most 80 columns wide, and how long it takes."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import os
import shutil
import sys
import textwrap
import threading
from time import monotonic, perf_counter

import numpy as np

_WIDTH = 80
# Positions in a table on the terminal; the report has all.
_MOST_ROWS = 12
_GREEN, _YELLOW, _BOLD, _PLAIN = "\x1b[32m", "\x1b[33m", "\x1b[1m", "\x1b[0m"
# Seconds between two lines where nobody sees a bar, and between two looks at a bar.
_LINE_EVERY, _BAR_EVERY = 60.0, 1.0
# Learning, in products of two 1500 x 1500 matrices: so many for so many rows, with this exponent.
# An order of time, by what `benchmarks/bench_speed.py` says of fits; no choice of a number.
_PRODUCTS, _ROWS, _EXPONENT = 50.0, 350, 0.55


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
    stream = stream or sys.stdout
    if stream is not None:  # --quiet
        print(filled(text, stream), file=stream)


def print_verdict(text, is_good):
    """Print what the work was for, in colour where the terminal has any and NO_COLOR is not set."""
    stream = sys.stdout
    plain = "NO_COLOR" in os.environ or os.environ.get("TERM") == "dumb"
    lines = filled(text, stream, "")
    if stream is not None and _is_terminal(stream) and not plain:
        lines = f"{_BOLD}{_GREEN if is_good else _YELLOW}{lines}{_PLAIN}"
    print(f"{lines}\n")


def print_scores(scores, rows_named="positions"):
    """Print what was measured at positions left out: the worst of them, means, and what else."""
    from sklearn_raacmm.utils import natural_order  # here: sentences alone need no scikit-learn

    table = scores.table
    worst = np.argsort(-table["after"], kind="stable")
    shown = set(worst[:_MOST_ROWS].tolist())
    order = [i for i in natural_order(table["position"]) if i in shown]
    cells = [["", "points", "before", "after", "largest before", "after"]]
    names = ("n_points", "before", "after", "before_max", "after_max")
    for i in order:
        n, *values = (table[name][i] for name in names)
        cells.append([_cut(table["position"][i]), str(n), *(f"{value:.4f}" for value in values)])
    means = [f"{scores.summary[when][0]:.4f}" for when in ("before", "after")]
    cells.append(["mean", "", *means, "", ""])
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    measure = scores.measure
    print(f"{measure[0].upper()}{measure[1:]} in mm at {rows_named} left out:")
    for first, *rest in cells:
        line = [first.ljust(widths[0]), *map(str.rjust, rest, widths[1:])]
        print("  ".join(line).rstrip())
    if len(worst) > len(order):
        say(f"These are the {len(order)} worst of {len(worst)}; the report has all.")
    for when in ("before", "after"):
        _, low, high = scores.summary[when]
        print(f"The mean {when} is {low:.4f} to {high:.4f} mm with 95 % probability.")
    if scores.lengths:
        before, after = np.abs(scores.length_errors_before), np.abs(scores.length_errors_after)
        say(
            f"Known lengths ({len(scores.lengths)}), mean error: {before.mean():.4f} mm before, "
            f"{after.mean():.4f} mm after; the largest {before.max():.4f} and {after.max():.4f} mm."
        )
    say(
        f"Of the coordinates left out, {100 * scores.coverage:.1f} % are inside the model's 95 % "
        f"intervals; its standard deviations are multiplied by {scores.std_factor:.2f}, so that "
        "95 % are."
    )
    if scores.changes:
        say(f"What calibration changed of the table: {'; '.join(scores.changes)}.")
    low, high = min(scores.fold_shares), max(scores.fold_shares)
    say(
        f"Share of the correction that is in use: {100 * scores.share:.0f} % (in the folds "
        f"{100 * low:.0f} % to {100 * high:.0f} %)."
    )
    if len(scores.outliers):
        say(f"Rows left out of all this as outliers: {len(scores.outliers)}.")
    for finding in scores.findings:
        say(f"{finding.weight}: {finding}")


def _cut(label, most=24):
    label = str(label)
    return label if len(label) <= most else f"{label[: most - 3]}..."


# -- time -----------------------------------------------------------------------------------------


def expected_seconds(n_rows):
    """About how long learning from so many rows takes here, by a product measured now, s."""
    some = np.random.default_rng(0).normal(size=(750, 750))
    np.matmul(some, some)
    start = perf_counter()
    np.matmul(some, some)
    product = 8 * (perf_counter() - start)
    return _PRODUCTS * (n_rows / _ROWS) ** _EXPONENT * product


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
        self.stream = sys.stderr
        self.bar = _is_terminal(self.stream)
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
        n_steps = self.total + 1
        whole = passed * n_steps / self.done if self.done else max(self.seconds, 1.2 * passed)
        share = min(0.99, passed / whole) if self.done == 0 else self.done / n_steps
        what = f"{self.done} of {self.total} folds" if self.done else "calibrating, first folds"
        left = f"{what}, about {in_words(max(0.0, whole - passed))} left"
        if not self.bar:
            return f"{left} after {in_words(passed)}\n"
        full = round(24 * share)
        return "\r" + f"[{'#' * full}{'.' * (24 - full)}] {left}".ljust(_WIDTH - 1)

    def _write(self, text):
        self.stream.write(text)
        self.stream.flush()
