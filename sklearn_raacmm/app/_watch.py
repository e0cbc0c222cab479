"""The word `watch`: what a table that still grows shows by now, on a page that renews itself."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep, strftime, thread_time
from typing import Any

import numpy as np

from sklearn_raacmm.app._files import check_outputs, load_arm, load_correction
from sklearn_raacmm.app._given import Given, in_rad
from sklearn_raacmm.app._report import render
from sklearn_raacmm.app._sources import TableError, check_installed
from sklearn_raacmm.calibration import calibrate
from sklearn_raacmm.correction import learn_correction
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.utils import one_blas_thread, robust_scale, write_whole

# Seconds: without a new row, after which it stops; between two looks; after which a last line that
# has no end is read. Share of a core that looking takes at most; a try of a correction, beside it,
# costs seconds.
_SILENCE_S, _LOOK_S, _HALF_LINE_S, _SHARE = 3600.0, 0.1, 1.0, 0.2
# A slip is so many standard deviations away, as in `slip_factors`. Farther than so many mm a row is
# in another place: no two cones stand closer.
_SLIP_SDS, _APART_MM = 11.0, 20.0
# Rows from which on an arm is calibrated, and by which factor they grow until the next time.
_FIRST_ROWS, _GROWTH = 20, 1.1
# What is enough: cones, poses in each, and 2S at cones left out over that at cones learnt from. A
# choice.
_CONES, _POSES, _NEAR_ENOUGH = 8, 10, 1.2
# Finished cones from which on a correction is tried, or checked; parts of them, each of which is
# left out once.
_LEAST_LEARNT, _LEAST_CHECKED, _FOLDS = 5, 2, 3
# Degrees of a bin of a joint's range, and rows of the strip.
_BIN_DEG, _STRIP = 15, 60


def watch(options):
    """Follow a growing table until Ctrl-C, or until no row has come for an hour."""
    check_installed("jinja2")
    if not (options.arm or options.model):
        raise TableError("say which arm it is: --arm ARM, or --model FOLDER.")
    check_outputs(options, [options.out])
    saved = load_correction(options.model) if options.model else None
    seen = _Seen(saved.arm if saved else load_arm(options.arm), saved)
    table, layout, size, read, grown = Path(options.table), None, 0, 0, monotonic()
    named: list[str] = []
    print(f"Open {options.out} in a browser: the page renews itself. Ctrl-C ends this.", flush=True)
    with warnings.catch_warnings(), ThreadPoolExecutor(1) as pool:
        warnings.simplefilter("ignore")  # what there is to say is on the page
        try:
            while seen.job or monotonic() - grown < _SILENCE_S:
                begun, now = thread_time(), table.stat().st_size if table.is_file() else 0
                if now != size:
                    size, grown = now, monotonic()
                quiet = monotonic() - grown > _HALF_LINE_S
                is_new = size != read and (quiet or table.read_bytes()[-1:] in (b"\n", b"\r"))
                if is_new:
                    try:
                        if layout is None or layout.source.table is not None:
                            layout = Given(options, seen.arm).layout
                            layout.labelled = False  # the last label may be in one row so far
                        seen.take(layout.read())
                        read = size
                    except ValueError as error:
                        if quiet:  # or a line is being written: it is read again
                            read, seen.said = size, str(error)
                if seen.work(pool) or is_new:
                    shown = vars(seen) | {"title": table.name, "time": strftime("%H:%M:%S")}
                    write_whole({options.out: render("_watch.html", **shown)})
                for row, text in seen.wrong:
                    if row not in named:
                        print(f"{strftime('%H:%M:%S')} {row} {text}", flush=True)
                        named.append(row)
                sleep(max(_LOOK_S, (thread_time() - begun) * (1 / _SHARE - 1)))
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
    print(f"{seen.n_rows} rows in {len(seen.cones)} cones. {seen.said}")
    return 0, {"rows": seen.n_rows, "cones": len(seen.cones), "wrong": named, "enough": seen.enough}


class _Seen:
    """What a test that goes on has shown so far; its page shows the public attributes."""

    def __init__(self, arm, saved):
        self.arm, self._nominal, self._saved = arm, arm, saved
        self.n_rows, self.cones, self.wrong, self.strip, self.joints = 0, [], [], [], []
        self.said, self.enough, self.least_poses = "Waiting for the first rows.", False, _POSES
        self._next_rows, self._judged = _FIRST_ROWS, 0
        self.job: Future[tuple[bool, str]] | None = None

    def take(self, table):
        """Judge all rows of the table as it is now."""
        self._angles, self.n_rows = in_rad(table), len(table.angles)
        labels, first, codes = np.unique(table.positions, return_index=True, return_inverse=True)
        order = np.argsort(first)  # cones are counted as they came
        labels, self._codes = labels[order], np.argsort(order)[codes]
        change = 0.0
        if self._saved is not None:
            change = self._saved.model.predict(self._saved.inputs(self._angles))
        elif self.n_rows >= self._next_rows:
            self._next_rows = _GROWTH * self.n_rows
            with suppress(ValueError):  # what no calibration explains leaves the arm as it was
                self.arm = calibrate(self._nominal, self._angles, self._codes).arm
        self._judge(self.arm.forward(self._angles) - change, labels, table.rows)
        bins = np.floor(np.rad2deg(self.arm.phases(self._angles)) / _BIN_DEG).astype(int)
        self.joints = [np.unique(column).tolist() for column in bins.T]

    def _judge(self, points, labels, rows):
        """Find slips and wrong labels."""
        codes, counts, each = self._codes, np.bincount(self._codes), range(len(labels))
        centres = np.array([np.median(points[codes == i], axis=0) for i in each])
        apart = np.linalg.norm(points[:, None] - centres, axis=2)
        away = apart[np.arange(self.n_rows), codes]
        own = np.array([robust_scale(away[codes == i], 3) for i in each])
        # One or two points show no scatter of their cone: all together do.
        limit = _SLIP_SDS * np.maximum(robust_scale(away, 3), own * (counts > 2))[codes]
        limit = np.minimum(limit, _APART_MM)
        apart[np.arange(self.n_rows), codes] = np.inf
        other = apart.argmin(axis=1)
        # Of two cones at one place the one with fewer rows has the wrong name.
        fewer = (counts[codes] < counts[other]) | (away > limit)
        elsewhere = (apart.min(axis=1) < limit) & fewer
        self._kept = (away <= limit) & ~elsewhere
        self.wrong = []
        for i in np.flatnonzero(~self._kept):
            text = f"is {away[i]:.1f} mm from its cone: a slip, or a wrong label? Repeat it."
            if elsewhere[i]:
                text = f"is where {labels[other[i]]} is: is its label wrong?"
            self.wrong.append((f"row {rows[i]} ({labels[codes[i]]})", text))
        self.cones = [*zip(labels.tolist(), *centres.T.tolist(), counts.tolist(), strict=True)]
        strip = rows.tolist(), away.tolist(), limit.tolist(), self._kept.tolist()
        self.strip = [*zip(*strip, strict=True)][-_STRIP:]

    def work(self, pool):
        """Try a correction of the finished cones, or check one, with each further cone."""
        done = self.job is not None and self.job.done()
        if self.job and done:
            self.enough, self.said = self.job.result()
            self.job = None
        finished = len(self.cones) - 1
        least = _LEAST_LEARNT if self._saved is None else _LEAST_CHECKED
        if not self.job and finished >= max(least, self._judged + 1):
            self._judged = finished
            counts = np.bincount(self._codes[self._kept], minlength=finished + 1)
            rows = self._kept & (self._codes < finished) & (counts[self._codes] > 2)
            self.job = pool.submit(self._tried, self._angles[rows], self._codes[rows])
        return done

    @one_blas_thread
    def _tried(self, angles, codes):
        """Whether rows of finished cones are enough, and why: by a check, or by learning.

        What a correction leaves at cones left out is compared with what it leaves at its own.
        """
        n_cones = len(np.unique(codes))
        try:
            if self._saved is not None:
                result = self._saved.check(angles, codes)
                said = (
                    "it holds." if result.holds else f"suspect: {result.suspect}. {result.advice}"
                )
                return True, f"Checked with {len(angles)} poses in {n_cones} cones: {said}"
            learned: Any = learn_correction(self._nominal, angles, codes, cv=_FOLDS)
        except ValueError as error:
            return False, str(error)
        own = single_point_repeatability(learned.correct(angles)[0], codes)
        was, now = (learned.scores.summary[when][0] for when in ("before", "after"))
        near, few = bool(now <= _NEAR_ENOUGH * own), n_cones < _CONES
        return near and not few, (
            f"At cones that it has not seen a correction by now leaves 2S {now:.3f} mm, where "
            f"calibration leaves {was:.3f} mm, and {own:.3f} mm at its own {n_cones}: further "
            f"cones {'gain little' if near else 'will help'}." + f" Take {_CONES} or more." * few
        )
