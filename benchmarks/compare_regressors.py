"""
Regressors side by side
=======================

Which regressor corrects a measuring arm best, from which inputs, and at what price? Polynomials,
Fourier terms, Gaussian processes, RBF networks, kernel ridge, nearest neighbours, trees and linear
models of the arm itself learn on some positions and correct others that they have never seen.

Outer folds keep positions (placements, goals) together; every setting is chosen by inner folds of
the training rows, which keep them together, too. Simulated arms come with the package; real data
are added with ``--panda`` and ``--ur10``, downloaded the first time. There calibration, too, sees
the training rows only.
"""

import argparse
import csv
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from _comparison import UNCORRECTED, Table, fetched, in_parallel, processes
from _regressors import MODELS, Fold, run
from sklearn.metrics import r2_score
from sklearn.model_selection import GroupKFold
from sklearn.utils import Bunch

from sklearn_raacmm import calibrate, position_residuals
from sklearn_raacmm.datasets import (
    fetch_panda_ball_socket,
    fetch_ur10_tracker,
    make_gauge,
    make_single_point,
)
from sklearn_raacmm.metrics import (
    gauge_lengths,
    length_error,
    single_point_repeatability,
    within_position_r2_score,
)

MIXES = ["typical", "gravity", "eccentricity"]
PERFECT = ("-", "perfect model")
UR10_ROWS = 1500


class Problem(NamedTuple):
    """A data set, split, and what was measured at the test rows of each fold."""

    name: str
    folds: list
    measured: list  # of arrays (n_test, 3): points, or residuals where they are known in full
    pairs: np.ndarray = None  # labels of the ends of known lengths
    lengths: np.ndarray = None  # mm
    gauge: bool = False  # the last fold's test rows are gauges, apart from the positions
    perfect: list = None  # what a perfect model would predict, fold by fold


def simulated(mix, seed, n_positions, n_poses, n_folds):
    """Cones in five folds, and gauges corrected by a model that learns from all cones."""
    cone = make_single_point(n_positions, n_poses, machine=mix, random_state=seed)
    gauge = make_gauge(machine=mix, random_state=seed)
    n = len(cone.data)
    angles, residuals = np.vstack([cone.data, gauge.data]), np.vstack([cone.target, gauge.target])
    labels = np.concatenate([cone.groups, cone.groups.max() + 1 + gauge.groups])
    perfect = [cone.simulation.perfect_correction, gauge.simulation.perfect_correction]
    perfect, points = np.vstack(perfect), np.vstack([cone.points, gauge.points])
    rows = [*GroupKFold(n_folds).split(cone.data, groups=cone.groups)]
    rows.append((np.arange(n), np.arange(n, len(angles))))
    folds = [Fold(cone.arm, angles, residuals, labels, labels, *r, absolute=False) for r in rows]
    return Problem(
        f"simulated, {mix}, seed {seed}",
        folds,
        [points[fold.test] for fold in folds],
        cone.groups.max() + 1 + gauge.pairs,
        gauge.lengths,
        gauge=True,
        perfect=[perfect[fold.test] for fold in folds],
    )


def calibrated_without(data, placement):
    """Calibrate on the other placements: the arm, its points, and the rows to learn from."""
    train = data.placements != placement
    known = [length for length in data.lengths if not length[0].startswith(f"{placement}/")]
    result = calibrate(data.nominal_arm, data.data[train], data.groups[train], lengths=known)
    learn = np.flatnonzero(train)
    # Calibration weighs outliers down by itself; least squares of the residuals would not.
    learn = learn[result.sample_weight > 0]
    return SimpleNamespace(
        arm=result.arm,
        learn=learn,
        test=~train,
        points=result.arm.forward(data.data),
    )


def some_goals(data, n_rows):
    """Keep goal positions drawn at random, with about so many rows."""
    order = np.random.default_rng(0).permutation(data.groups.max() + 1)
    kept = order[: max(3, n_rows * len(order) // len(data.groups))]
    some = np.isin(data.groups, kept)
    rows = {name: data[name][some] for name in ("data", "tracker_points", "groups")}
    return Bunch(**rows, nominal_arm=data.nominal_arm)


def calibrated(data, train):
    """Calibrate on the training rows: the arm, and the residuals of all rows in its base frame."""
    result = calibrate(data.nominal_arm, data.data[train], points=data.tracker_points[train])
    true = (data.tracker_points - result.base_translation) @ result.base_rotation
    residuals = result.arm.forward(data.data) - true
    return SimpleNamespace(arm=result.arm, residuals=residuals)


def panda(arm, data_home):
    """Every placement of the sockets left out once, by calibration, too."""
    data = fetched(fetch_panda_ball_socket, arm, data_home=data_home)
    names = np.unique(data.placements)
    folds, measured = [], []
    for name in names:
        without = calibrated_without(data, name)
        residuals = np.zeros((len(data.data), 3))
        residuals[without.learn] = position_residuals(
            without.points[without.learn], data.groups[without.learn]
        )
        labels = (data.groups, data.placements)
        rows = (without.learn, np.flatnonzero(without.test))
        folds.append(Fold(without.arm, data.data, residuals, *labels, *rows, absolute=False))
        measured.append(without.points[without.test])
    pairs = np.array([(first, second) for first, second, *_ in data.lengths])
    holes = np.array([length for _, _, length, _ in data.lengths])
    return Problem(f"real, {arm}", folds, measured, pairs, holes)


def ur10(n_rows, data_home):
    """Three folds of goal positions; residuals against the tracker."""
    data = fetched(fetch_ur10_tracker, data_home=data_home)
    data = some_goals(data, n_rows)
    folds, measured = [], []
    for train, test in GroupKFold(3).split(data.data, groups=data.groups):
        fold = calibrated(data, train)
        labels = (data.groups, data.groups)
        folds.append(Fold(fold.arm, data.data, fold.residuals, *labels, train, test, absolute=True))
        measured.append(fold.residuals[test])
    return Problem("real, ur10", folds, measured)


def half_width(gain, places, n_draws=2000):
    """Half of a 95 % interval of a mean gain: a bootstrap over places that stay together."""
    index = np.unique(places, return_inverse=True)[1]
    sums, counts = np.bincount(index, gain), np.bincount(index)
    draws = np.random.default_rng(0).integers(0, len(counts), (n_draws, len(counts)))
    low, high = np.quantile(sums[draws].sum(1) / counts[draws].sum(1), [0.025, 0.975])
    return (high - low) / 2


def assess(problem, corrections):
    """Every measure of a correction, given for the test rows of each fold; 2S and lengths apart."""
    n = len(problem.folds) - problem.gauge
    labels = np.concatenate([fold.positions[fold.test] for fold in problem.folds[:n]])
    before = np.concatenate(problem.measured[:n])
    prediction = np.concatenate(corrections[:n])
    after = before - prediction
    absolute = problem.folds[0].absolute
    deviation = np.linalg.norm(after if absolute else position_residuals(after, labels), axis=1)
    target = before if absolute else position_residuals(before, labels)
    gain = np.linalg.norm(target, axis=1) - deviation
    places = np.concatenate([fold.splits[fold.test] for fold in problem.folds[:n]])
    codes = np.unique(labels, return_inverse=True)[1]
    repeated = np.bincount(codes)[codes] > 1  # a goal may have one pose only
    spread = single_point_repeatability(after[repeated], labels[repeated], aggregate=None)
    results = {
        "mean_mm": deviation.mean(),
        "half_mm": half_width(gain, places),
        "max_mm": deviation.max(),
        "two_s_mean_mm": spread.mean(),
        "two_s_max_mm": spread.max(),
        "r2": r2_score(target, prediction, multioutput="variance_weighted"),
        "r2_within": within_position_r2_score(
            target[repeated], prediction[repeated], groups=labels[repeated]
        ),
    }
    shown = [("2S", str(g), v) for g, v in zip(np.unique(labels[repeated]), spread, strict=True)]
    if problem.pairs is not None:
        if problem.gauge:
            after = problem.measured[-1] - corrections[-1]
            labels = problem.folds[-1].positions[problem.folds[-1].test]
        lengths = gauge_lengths(after, labels, problem.pairs)
        sizes = np.unique(problem.lengths)
        for size in sizes:
            some = length_error(lengths[problem.lengths == size], size)
            results[f"length_{size:g}_mean_mm"] = np.abs(some).mean()
            results[f"length_{size:g}_max_mm"] = np.abs(some).max()
            shown += [(f"{size:g} mm", str(i + 1), e) for i, e in enumerate(some)]
        if len(sizes) > 1:
            # A cone test cannot see the scale: find it with the shorter gauges, judge the longest.
            longest = problem.lengths == sizes[-1]
            scale = lengths[~longest] @ problem.lengths[~longest] / np.sum(lengths[~longest] ** 2)
            results["scaled_mean_mm"] = np.abs(scale * lengths[longest] - sizes[-1]).mean()
    return results, shown


def compare(problem, names, jobs):
    """Print the table of one data set; return a record of every model, and of every place."""
    sizes = [] if problem.lengths is None else np.unique(problem.lengths)
    table = Table(
        ("inputs", 24, ""),
        ("regressor", 26, ""),
        ("mean", 6, ".4f"),
        ("max", 6, ".4f"),
        ("2S mean", 7, ".4f"),
        ("2S max", 7, ".4f"),
        ("less", 5, ".0%"),
        ("of possible", 11, ".0%"),
        *((f"{size:g} mm", 6, ".4f") for size in sizes),
        *([("scaled", 6, ".4f")] if len(sizes) > 1 else []),
        ("R2", 6, ".2f"),
        ("R2 within", 9, ".2f"),
        ("fit s", 7, ".2f"),
        ("us/row", 6, ".1f"),
        ("kB", 6, ".0f"),
        ("numbers", 7, ".0f"),
    )
    records, details = [], []
    # What a correction is judged by: the deviation where it is known, else 2S.
    measure = "mean_mm" if problem.folds[0].absolute else "two_s_mean_mm"
    nothing = [np.zeros_like(points) for points in problem.measured]
    base, places_before = assess(problem, nothing)
    floor = 0.0
    if problem.perfect is not None:
        floor = assess(problem, problem.perfect)[0][measure]

    def show(name, corrections, costs=None):
        results, places = assess(problem, corrections)
        gain = base[measure] - results[measure]
        results["less"] = None if name == UNCORRECTED else gain / base[measure]
        known = problem.perfect is not None and name != UNCORRECTED
        results["of_possible"] = gain / (base[measure] - floor) if known else None
        costs = [None] * 4 if costs is None else np.mean(costs, axis=0)
        seconds, per_row, size, numbers = costs
        results |= {"fit_seconds": seconds, "predict_seconds_per_row": per_row}
        results |= {"pickle_bytes": size, "numbers": numbers}
        shown = ["mean_mm", "max_mm", "two_s_mean_mm", "two_s_max_mm", "less", "of_possible"]
        shown += [f"length_{size:g}_mean_mm" for size in sizes]
        shown += ["scaled_mean_mm"] if len(sizes) > 1 else []
        cells = [results[key] for key in [*shown, "r2", "r2_within", "fit_seconds"]]
        cells += [None if per_row is None else 1e6 * per_row]
        table.row(*name, *cells, None if size is None else size / 1000, numbers)
        label = {"data": problem.name, "inputs": name[0], "regressor": name[1]}
        records.append(label | results)
        for (what, place, before), (*_, after) in zip(places_before, places, strict=True):
            row = {"measure": what, "place": place, "before_mm": before, "after_mm": after}
            details.append(label | row)

    show(UNCORRECTED, nothing)
    for i, name in enumerate(names):
        title = f"{problem.name}, model {i + 1} of {len(names)}: {', '.join(name)}"
        if not sys.stderr.isatty():
            print(title, file=sys.stderr, flush=True)
        results, _ = in_parallel(run, [(name, fold) for fold in problem.folds], jobs, title)
        show(name, *(list(part) for part in zip(*results, strict=True)))
    if problem.perfect is not None:
        show(PERFECT, problem.perfect)
    return records, details


def write(path, records):
    """Write records as CSV; a field that does not apply is left empty."""
    fields = list(dict.fromkeys(key for record in records for key in record))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fields)
        writer.writeheader()
        writer.writerows(records)


def problems(args):
    """Each data set in turn, made or read when its time comes."""
    mixes, seeds = args.machine, range(args.seed, args.seed + args.seeds)
    for mix in mixes:
        for seed in seeds:
            yield simulated(mix, seed, args.positions, args.poses, args.folds)
    for arm in args.panda:
        yield panda(arm, args.data_home)
    if args.ur10:
        yield ur10(args.rows, args.data_home)


def main(argv=None):
    """Run the job."""
    parser = argparse.ArgumentParser(description="Regressors side by side.")
    parser.add_argument(
        "--machine", nargs="*", default=MIXES, choices=MIXES, help="simulated arms (default: all)"
    )
    parser.add_argument("--positions", type=int, default=10, help="simulated (default: 10)")
    parser.add_argument("--poses", type=int, default=60, help="at each (default: 60)")
    parser.add_argument("--folds", type=int, default=5, help="of positions (default: 5)")
    parser.add_argument("--seed", type=int, default=0, help="of the first simulated arm")
    parser.add_argument("--seeds", type=int, default=1, help="simulated arms of each kind")
    parser.add_argument(
        "--panda", nargs="*", default=[], choices=["panda_3", "panda_2"], help="real arms"
    )
    parser.add_argument("--ur10", action="store_true", help="a real robot and a laser tracker")
    parser.add_argument("--data-home", help="folder of real data (default: scikit-learn's)")
    parser.add_argument(
        "--rows", type=int, default=UR10_ROWS, help=f"of the UR10 (default: {UR10_ROWS})"
    )
    parser.add_argument("--models", nargs="*", help="only those whose name holds one of these")
    parser.add_argument("--quick", action="store_true", help="one small simulated arm")
    parser.add_argument(
        "--jobs", type=processes, default=-1, help="processes (default: one per core)"
    )
    parser.add_argument(
        "--output", type=Path, default=Path("comparison.csv"), help="file of the table"
    )
    args = parser.parse_args(argv)
    if args.quick:
        args.machine, args.positions, args.poses, args.folds = ["typical"], 4, 32, 2
    if not 2 <= args.folds <= args.positions:
        parser.error(f"--folds must be 2 to {args.positions} (--positions), got {args.folds}.")
    if not args.output.resolve().parent.is_dir():
        parser.error(f"no such folder: {args.output.resolve().parent}")
    names = [
        name
        for name in MODELS
        if not args.models or any(word in ", ".join(name) for word in args.models)
    ]
    if not names:
        parser.error(f"no model's name holds {' or '.join(args.models)}.")

    print("Positions never trained on, nor used to choose a setting. Lengths in mm.")
    print("mean, max: deviation from the position's mean point (UR10: from the tracker's point);")
    print("2S: single-point repeatability; less: reduction of its mean (UR10: of the deviation);")
    print("of possible: share of what a perfect model reduces, which knows all but the noise;")
    print(
        "mm mean, max: error of known lengths; R2: plain, and with one free constant per position"
    )
    print("(within); fit s: CPU seconds with the choice of settings; us/row: CPU to predict;")
    print("kB: pickled; numbers: kept by the model in order to predict.")
    start, records, details = time.perf_counter(), [], []
    for problem in problems(args):
        n_folds = len(problem.folds) - problem.gauge
        rows = sum(len(points) for points in problem.measured[:n_folds])
        print(f"\n{problem.name}: {rows} rows, {n_folds} folds\n")
        found = compare(problem, names, args.jobs)
        records += found[0]
        details += found[1]
        # After each data set: who stops the job keeps what it found.
        write(args.output, records)
        write(args.output.with_stem(args.output.stem + "_places"), details)
    print(f"\n{time.perf_counter() - start:.0f} s. Tables: {args.output} and ", end="")
    print(f"{args.output.with_stem(args.output.stem + '_places')} (by position and placement).")


if __name__ == "__main__":
    main()
