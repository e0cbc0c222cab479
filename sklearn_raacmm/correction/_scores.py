"""A correction judged at positions left out: calibration and model fitted anew in every fold."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import stats
from sklearn.utils.parallel import Parallel, delayed

from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.utils import Finding, Floats, Groups

# Folds of the default split: each takes a calibration and a fit of the model. A choice of time.
_N_FOLDS = 5
# That all positions improve by chance has a probability of 1/16 with four, 1/32 with five: the
# first below 5 %.
_FEWEST_POSITIONS = 5
_Z95 = 1.959964  # the standard normal quantile of 97.5 %
_WHEN = "before", "after"
_FROM_FORMS = " from forms"  # of a measure, where some positions are surfaces
_UNKNOWN_LENGTHS = "lengths-unknown"  # the code of a finding
# Positions that are shown, and characters of their labels: `table` has all.
_MOST_ROWS, _LABEL = 12, 24
# Coverage factor of uncertainties that are said in words.
_K = 2.0


@dataclass(frozen=True, eq=False)
class CorrectionScores:
    """What a correction is worth at positions that neither calibration nor model had seen.

    Made by :func:`learn_correction`.
    ``pandas.DataFrame(scores.table)`` is the table of positions.

    Attributes
    ----------
    measure : {"2S", "2S from forms", "mean deviation"}
        "2S", the single-point repeatability, where positions were only labelled, "2S from forms"
        where some are planes or spheres: the same of the distances of their touches from the form
        that fits these best. The mean distance from the tracker's points where these were given.
    table : dict of str to ndarray of shape (n_positions,)
        ``position``, ``n_points``, and in mm ``before``, ``after`` (the measure), ``before_max``
        and ``after_max`` (the largest deviation of a point).
    summary : dict of str to tuple (mean, low, high)
        For ``given``, ``before`` and ``after`` the mean over positions in mm: with the table as it
        was given, but for probe and base; calibrated; and corrected. For ``calibration`` the ratio
        of before to given, for ``ratio`` that of after to before, each with its 95 % interval
        (Student's t of the logarithm, of the ratios Fieller's theorem; positions joined by known
        lengths together).
    lengths : list of (label, label, length, standard deviation)
        The known lengths whose two ends were left out together, while another one was not: a length
        is judged by an arm whose scale is known, but not from this length.
    length_errors_before, length_errors_after : ndarray of shape (n_lengths,)
        Errors of these lengths without and with the correction, mm.
    coverage : float
        Share of the left-out coordinates inside the model's own 95 % intervals, before any factor.
    std_factor : float
        Factor of the model's standard deviations with which 95 % of these coordinates are inside.
    n_folds : int
        How many times calibration and model were fitted.
    outliers : ndarray of shape (n_outliers,)
        Rows that the calibration of all rows names as outliers and that the arm's linear error
        model (:class:`ArmResidualRegressor`) gives no weight either: slipped probes. Not counted.
    rows_by_position : list of ndarray
        Rows counted at each position of the table.
    left_before, left_after : ndarray of shape (n_samples, 3)
        Deviation of each point when it was left out, mm; NaN for outliers.
    n_blocks : int
        How many blocks of positions, each of which was left out as a whole.
    changes : tuple of str
        What calibration of all rows has changed of the table, the largest at the probe first.
    findings : tuple of Finding
        What was noticed in the data.
    share : float
        Share of its correction that the model of all rows uses: 0 for none.
    fold_shares : tuple of float
        This share of the model of each fold.
    """

    measure: str
    table: dict[str, np.ndarray]
    summary: dict[str, tuple[float, float, float]]
    lengths: list[tuple[Any, ...]]
    length_errors_before: Floats
    length_errors_after: Floats
    coverage: float
    std_factor: float
    n_folds: int
    outliers: np.ndarray
    rows_by_position: list[np.ndarray]
    left_before: Floats
    left_after: Floats
    n_blocks: int
    fold_shares: tuple[float, ...]
    changes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    share: float = 1.0

    @property
    def helps(self) -> bool:
        """Whether the correction is worth using at new positions."""
        return self._judgement[0]

    @property
    def calibration_helps(self) -> bool:
        """Whether the calibrated table is better than the given one at new positions."""
        return self.n_blocks >= _FEWEST_POSITIONS and self.summary["calibration"][2] < 1

    @property
    def verdict(self) -> str:
        """The same in one sentence, with the numbers."""
        return self._judgement[1]

    @cached_property
    def _judgement(self) -> tuple[bool, str]:
        """Whether it helps, and the sentence.

        What is handed over has to be what was judged: where the model of all rows is not in use, or
        most of those that were judged were not, the verdict says so.
        """
        helps, verdict = _verdict(self)
        if (np.median(self.fold_shares) > 0) != (self.share > 0):
            return False, (
                f"{'Do not use it. ' * helps}{verdict} But the model of all rows is another one "
                f"than those that were judged. {_shares(self.share, self.fold_shares)}."
            )
        return helps, verdict

    def __repr__(self) -> str:
        """Sentences, and a table of the worst positions that is at most 80 columns wide."""
        worst = (-self.table["after"]).argsort(kind="stable")[:_MOST_ROWS]
        cells = [["", "points", "before", "after", "largest before", "after"]]
        rows = list(zip(*self.table.values(), strict=True))
        for i in (i for i in Groups.in_order(self.table["position"]) if i in worst):
            label, n, *values = str(rows[i][0]), *rows[i][1:]
            label = label if len(label) <= _LABEL else f"{label[: _LABEL - 3]}..."
            cells.append([label, str(n), *(f"{value:.4f}" for value in values)])
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = [self.verdict, f"{self.measure}, mm, when left out:"]
        for first, *rest in cells:
            line = [first.ljust(widths[0]), *map(str.rjust, rest, widths[1:])]
            lines.append("  ".join(line).rstrip())
        if len(rows) > len(worst):
            lines.append(f"These are the {len(worst)} worst of {len(rows)}; a report has all.")
        measure = f"mean {self.measure.removeprefix('mean ')}"
        for when, words in {"given": "as given", "before": "before", "after": "after"}.items():
            mean, low, high = self.summary[when]
            lines.append(f"{measure} {words}: {mean:.4f} mm (95 %: {low:.4f} to {high:.4f})")
        if self.lengths:
            before, after = np.abs(self.length_errors_before), np.abs(self.length_errors_after)
            lines.append(
                f"Known lengths ({len(self.lengths)}), mean error: {before.mean():.4f} mm before, "
                f"{after.mean():.4f} mm after; the largest {before.max():.4f} and "
                f"{after.max():.4f} mm."
            )
        lines.append(
            f"Of the coordinates left out, {self.coverage:.1%} are inside the model's 95 % "
            f"intervals; its standard deviations are multiplied by {self.std_factor:.2f}, so that "
            "95 % are."
        )
        if self.changes:
            lines.append(f"What calibration changed of the table: {'; '.join(self.changes)}.")
        lines.append(f"{_shares(self.share, self.fold_shares)}.")
        if len(self.outliers):
            lines.append(f"Rows left out of all this as outliers: {len(self.outliers)}.")
        lines += [f"{finding.weight}: {finding}" for finding in self.findings]
        return "\n".join(lines)


def predict_with_std(model, X, noise):
    """Prediction (n, 3) and standard deviation of a new measurement (n, 3), mm."""
    try:
        mean, std = model.predict(X, return_std=True)
        std = np.broadcast_to(np.reshape(std, (len(mean), -1)), mean.shape)
    except (TypeError, ValueError):  # a regressor without standard deviations of this form
        mean = model.predict(X)
        std = np.zeros_like(mean)
    if (linear := linear_in_use(model)) is not None:
        noise = noise * linear.noise_ratio(X)
    return mean, np.hypot(std, noise)


def linear_in_use(model):
    """The linear error model, or None where there is none, or where it is of no help."""
    return getattr(model, "linear_model_", None) if getattr(model, "helps_", False) else None


def _shares(share, of_folds):
    low, high = min(of_folds), max(of_folds)
    return f"Share of the correction that is used: {share:.0%} (folds: {low:.0%} to {high:.0%})"


def scores_of(data, calibration, model, outliers, folds, n_jobs, progress):
    """Scores of checked data with the calibration of all of them; `folds` hold no outliers."""
    work = Parallel(n_jobs=n_jobs, return_as="generator")(
        delayed(_one_fold)(data, model, train, test) for train, test in folds
    )
    sides, lengths, fold_shares = np.full((4, len(data.angles), 3), np.nan), [], []
    try:
        for i, ((_, test), result) in enumerate(zip(folds, work, strict=True)):
            *parts, found, share = result
            sides[:, test] = parts
            lengths += found
            fold_shares.append(share)
            if progress is not None:
                progress(i + 1, len(folds))
    finally:  # Whoever cancels by `progress` need not hear how joblib ends its other processes.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            work.close()
    given, before, after, std = sides
    table, rows_by_position = _table(data, before, after)
    blocks = data.blocks()[[rows[0] for rows in rows_by_position]]
    coverage, factor = coverage_of(*data.as_shown(after, std))
    summary = _summary(table["before"], table["after"], blocks)
    of_given = _summary(_table(data, given, before)[0]["before"], table["before"], blocks)
    summary |= {"given": of_given["before"], "calibration": of_given["ratio"]}
    if "scale" in calibration.unidentified:  # the arm has it from its table alone
        per_metre = _K * 1000 * calibration.scale_sd_corrected
        text = f"Lengths are not known to better than {per_metre:.2g} mm per metre (k = {_K:g})."
        advice = (
            "Measure a known distance: a bar in two cones, or a cone plate moved by a known step."
        )
        Finding(_UNKNOWN_LENGTHS, text, advice, "note", size_mm=per_metre).report()
    errors = np.array([entry[1:] for entry in lengths]).reshape(-1, 2)
    measure = "2S" if data.points is None else "mean deviation"
    return CorrectionScores(
        measure=measure + _FROM_FORMS * bool(data.kinds),
        table=table,
        summary=summary,
        lengths=[entry[0] for entry in lengths],
        length_errors_before=errors[:, 0],
        length_errors_after=errors[:, 1],
        coverage=coverage,
        std_factor=factor,
        n_folds=len(folds),
        outliers=outliers,
        rows_by_position=rows_by_position,
        left_before=before,
        left_after=after,
        n_blocks=len(np.unique(blocks)),
        fold_shares=tuple(fold_shares),
        changes=tuple(calibration.changes),
    )


def share_of(model):
    """Share of its correction that a fitted model uses; 1 of models that know none."""
    return float(model.fading_.most) if hasattr(model, "fading_") else 1.0


def folds_of(data, outliers, cv):
    """Rows to fit on and rows to leave out, outliers in neither."""
    from sklearn.model_selection import GroupKFold  # here: reading a correction spares the time

    kept, blocks = np.delete(np.arange(len(data.angles)), outliers), data.blocks()
    n_blocks = len(np.unique(blocks))
    if n_blocks < 3:
        raise ValueError(
            f"at least 3 positions are needed to leave some out, got {n_blocks}; ten are a fair "
            "start."
        )
    folds = []
    left_out = blocks if data.places is None else data.places
    for train, test in GroupKFold(cv or min(_N_FOLDS, n_blocks)).split(blocks, groups=left_out):
        for what, labels in (("tool", data.tools), ("station", data.stations)):
            lost = [] if labels is None else np.setdiff1d(labels[test], labels[train])
            if len(lost):
                raise ValueError(
                    f"all positions of {what} {lost[0].item()!r} are left out together: measure "
                    f"each {what} at more positions, give blocks, or mend a mistyped label."
                )
        folds.append((np.intersect1d(train, kept), np.intersect1d(test, kept)))
    return folds


def _one_fold(data, model, train, test):
    """Deviations as given, before, after, and standard deviations at the rows left out; lengths."""
    train, lonely = data.without_lonely(train)
    with Finding.ignored():  # whatever there is to say is said of all rows
        known = np.sort(np.r_[train, lonely])
        calibration = data.calibrate(known)
        as_given = data.calibrate(known, free=["probe"])
        # Points without the correction are judged by the bases that go with them.
        corrected = data.at_stations(model, calibration, train)
        fitted, noise = data.fit(model, corrected, train)
        share, fitted = share_of(fitted), data.at_probes(fitted, calibration, test)
        correction, std = predict_with_std(fitted, data.inputs[test], noise)
    # A length is judged by another: without any, the scale would be that of the nominal table.
    is_known = data.points is not None or data.lengths_among(train)
    judged = [one for one in data.lengths_among(test) if one[0] != one[1]] if is_known else []
    points = data.shown(calibration, test)
    errors = (data.length_errors(p, test, judged) for p in (points, points - correction))
    sides = (as_given, 0.0), (calibration, 0.0), (corrected, correction)
    left = (data.residuals(one, test, less, robust=False) for one, less in sides)
    return *left, std, list(zip(judged, *errors, strict=True)), share


def _table(data, before, after):
    """Measure of every position with at least two counted rows, and these rows of each."""
    rows = data.without_lonely(np.flatnonzero(np.isfinite(before).all(axis=1)))[0]
    labels, codes, counts = np.unique(data.positions[rows], return_inverse=True, return_counts=True)
    by_position = np.split(rows[np.argsort(codes, kind="stable")], np.cumsum(counts)[:-1])
    table, maxima = {"position": labels, "n_points": counts}, {}
    for when, left in zip(_WHEN, (before, after), strict=True):
        size = np.linalg.norm(left, axis=1)
        maxima[f"{when}_max"] = np.array([size[own].max() for own in by_position])
        table[when] = Groups(codes).means(size[rows])
        if data.points is None:
            table[when] = single_point_repeatability(left[rows], codes, aggregate=None)
    return table | maxima, by_position


def _summary(before, after, blocks):
    """Means over positions and their ratio, with their 95 % intervals by independent blocks.

    By simulation better than a bootstrap (``benchmarks/bench_lengths.py intervals``).
    """
    blocks = np.unique(blocks, return_inverse=True)[1]
    counts, n = np.bincount(blocks), blocks.max() + 1
    before, after = (np.bincount(blocks, values) for values in (before, after))
    t = stats.t.ppf(0.975, n - 1)
    quantile, found = t * np.sqrt(n / (n - 1)), {}
    of = {"before": (before, counts), "after": (after, counts), "ratio": (after, before)}
    for name, (over, under) in of.items():
        value = over.sum() / max(under.sum(), 1e-300)
        error = np.linalg.norm(over - value * under) / max(over.sum(), 1e-300)
        # Beyond this many powers of e nothing is known.
        low, high = value * np.exp(np.clip(quantile * error, 0, 300) * np.array([-1, 1]))
        found[name] = (float(value), float(low), float(high))
    # Those ratios r at which the mean of after - r before is within t standard errors of zero
    # (E. C. Fieller, J. Royal Statistical Society B 16(2), 1954, 175-185), if they are bounded.
    (v_aa, v_ab), (_, v_bb) = np.cov(after, before) / n * t**2
    mean_b, mean_a = before.mean(), after.mean()
    a, b, c = mean_b**2 - v_bb, mean_a * mean_b - v_ab, mean_a**2 - v_aa
    if a > 0:
        root = np.sqrt(max(b**2 - a * c, 0.0))
        found["ratio"] = found["ratio"][0], float(max((b - root) / a, 0.0)), float((b + root) / a)
    return found


def coverage_of(left, std):
    """Share of coordinates inside raw 95 % intervals, and the factor at which 95 % are inside."""
    kept = np.isfinite(left)
    # No deviation without a standard deviation, such as exact data: those are inside.
    ratio = np.abs(left[kept]) / np.maximum(std[kept], 1e-300)
    return float(np.mean(ratio <= _Z95)), float(np.quantile(ratio, 0.95) / _Z95)


def _verdict(scores):
    """Whether it helps, and a sentence; without a known length it is no better in lengths."""
    n_blocks = scores.n_blocks
    before, after = scores.table["before"], scores.table["after"]
    n, better = len(before), int(np.sum(after < before))
    ratio, low, high = scores.summary["ratio"]
    given = scores.summary["given"][0]
    change = f"{scores.measure} {given:.3f} mm as given, {before.mean():.3f} calibrated, "
    change += f"{after.mean():.3f} corrected"
    of = "features" if scores.measure.endswith(_FROM_FORMS) else "positions"
    what = of if n_blocks == n else f"blocks of {of}"
    if n_blocks < _FEWEST_POSITIONS:
        return False, (
            f"Do not use it yet: at new {of} {change}, but {n_blocks} {what} are too few to "
            f"tell; measure at least {_FEWEST_POSITIONS}."
        )
    shown = f"{change}, {better} of {n} {of} better"
    if high < 1:
        least = np.argmax(after / np.maximum(before, 1e-300))
        unknown_lengths = [f for f in scores.findings if f.code == _UNKNOWN_LENGTHS]
        helps = "It repeats better" if unknown_lengths else "It helps"
        said = (
            f"{helps} at new {of}: {shown}; the one that "
            f"gained least went from {before[least]:.3f} to {after[least]:.3f} mm."
        )
        return True, " ".join([said, *map(str, unknown_lengths)])
    if scores.calibration_helps:
        return False, (
            f"Use the calibrated table without the correction: at new {of} {shown} than calibrated."
        )
    return False, (
        f"Do not use it: at new {of} {shown}; after is "
        f"{ratio:.2f} times before, and its 95 % interval, {low:.2f} to {high:.2f}, reaches 1."
    )
