"""
A real arm, before and after
============================

Two Franka Panda arms held a ball in sockets and moved through many poses: the single-point test
of a measuring arm, done with real arms by the authors of MUKCa. Each placement of the sockets is
left out once. On the other placements the arm is calibrated and the models are trained; what they
predict for the placement left out is subtracted there. Nothing of a placement is used before it
is judged.

The data are not part of this package: they are downloaded the first time.
"""

import argparse
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
from _comparison import (
    ALL,
    PAPER,
    UNCORRECTED,
    Table,
    fetched,
    figure_file,
    fit,
    in_parallel,
    models_to_compare,
    processes,
)

from sklearn_raacmm import calibrate, position_residuals
from sklearn_raacmm.datasets import fetch_panda_ball_socket
from sklearn_raacmm.metrics import gauge_lengths, repeatability_report, repeatability_scorer

THREE, SEVEN = (PAPER, "RBF network"), (ALL, "RBF network")


def without(data, placement, keep_outliers=False):
    """Calibrate on the other placements: the arm, its points, and the rows to learn from."""
    train = data.placements != placement
    known = [length for length in data.lengths if not length[0].startswith(f"{placement}/")]
    result = calibrate(data.nominal_arm, data.data[train], data.groups[train], lengths=known)
    learn = np.flatnonzero(train)
    if not keep_outliers:
        # Calibration weighs outliers down by itself; least squares of the residuals would not.
        learn = learn[result.sample_weight > 0]
    return SimpleNamespace(
        arm=result.arm,
        learn=learn,
        test=~train,
        points=result.arm.forward(data.data),
        calibration=result,
    )


def corrected_points(data, fold, name):
    """Points of the placement left out, corrected by one of the models."""
    learn, test = fold.learn, fold.test
    angles, sockets, placements = data.data[learn], data.groups[learn], data.placements[learn]
    n_splits = min(5, len(np.unique(placements)))
    scoring = repeatability_scorer(angles, sockets)
    model = models_to_compare(fold.arm, scoring, n_splits)[name]
    residuals = position_residuals(fold.points[learn], sockets)
    fit(model, angles, residuals, placements, sockets)
    return fold.points[test] - model.predict(data.data[test])


def compare(data, folds, jobs):
    """Print the table of models; return the report of every socket, by model."""
    order = np.concatenate([np.flatnonzero(fold.test) for fold in folds])
    sockets = data.groups[order]
    pairs = [(first, second) for first, second, *_ in data.lengths]
    holes_mm = np.array([length for _, _, length, _ in data.lengths])
    table = Table(
        ("inputs", 24, ""),
        ("regressor", 22, ""),
        ("mean", 6, ".3f"),
        ("max", 6, ".3f"),
        ("2S mean", 7, ".3f"),
        ("2S max", 6, ".3f"),
        ("explained", 9, ".0%"),
        ("holes", 6, ".3f"),
        ("seconds", 7, ".1f"),
    )
    reports, squares = {}, {}
    for name in [UNCORRECTED, *models_to_compare(folds[0].arm)]:
        if name == UNCORRECTED:
            points, seconds = [fold.points[fold.test] for fold in folds], None
        else:
            calls = [(data, fold, name) for fold in folds]
            points, seconds = in_parallel(corrected_points, calls, jobs, ", ".join(name))
        points = np.concatenate(points)
        deviation = np.linalg.norm(position_residuals(points, sockets), axis=1)
        report = reports[name] = repeatability_report(points, sockets)
        squares[name] = np.sum(deviation**2)
        spread = report.repeatability_2s
        table.row(
            *name,
            deviation.mean(),
            deviation.max(),
            spread.mean(),
            spread.max(),
            None if seconds is None else 1 - squares[name] / squares[UNCORRECTED],
            np.abs(gauge_lengths(points, sockets, pairs) - holes_mm).mean(),
            seconds,
        )
    return reports


def print_sockets(reports):
    """Print deviation and repeatability of every socket, before and after."""
    columns = {"before": UNCORRECTED, "pose": THREE, "all": SEVEN}
    measures = {"mean": "deviation_mean", "max": "deviation_max", "2S": "repeatability_2s"}
    table = Table(
        ("socket", 16, ""),
        ("points", 6, "d"),
        *((f"{short}, {name}", 12, ".3f") for short in measures for name in columns),
    )
    first = reports[UNCORRECTED]
    for i, socket in enumerate(first.position):
        values = [reports[c][m][i] for m in measures.values() for c in columns.values()]
        table.row(str(socket), int(first.n_points[i]), *values)


def plot(reports, title):
    """Draw the repeatability of every socket, before and after."""
    figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
    styles = {
        UNCORRECTED: ("calibrated, uncorrected", "0.6", "o"),
        (PAPER, "Gaussian process"): ("Gaussian process, pose angles", "tab:green", "^"),
        THREE: ("RBF network, pose angles", "tab:orange", "s"),
        SEVEN: ("RBF network, all joints", "tab:blue", "D"),
    }
    positions = np.arange(len(reports[UNCORRECTED].position))
    for name, (label, color, marker) in styles.items():
        axes.plot(
            positions, reports[name].repeatability_2s, marker, color=color, label=label, ls=":"
        )
    axes.set_xticks(positions, reports[UNCORRECTED].position, rotation=45, ha="right")
    axes.set(xlabel="socket", ylabel="repeatability 2S (mm)", title=title)
    axes.set_ylim(bottom=0)
    axes.legend(fontsize="small")
    return figure


def main(argv=None):
    """Run the job."""
    parser = argparse.ArgumentParser(description="A real arm, before and after the correction.")
    parser.add_argument("--arm", default="panda_3", choices=["panda_3", "panda_2"])
    parser.add_argument("--data-home", help="folder of the data (default: scikit-learn's)")
    parser.add_argument(
        "--keep-outliers",
        action="store_true",
        help="let the models learn from the rows that calibration names as outliers, too",
    )
    parser.add_argument(
        "--jobs", type=processes, default=-1, help="processes (default: one per core)"
    )
    parser.add_argument(
        "--output", type=figure_file, default="real_arm.png", help="file of the figure"
    )
    args = parser.parse_args(argv)

    data = fetched(fetch_panda_ball_socket, args.arm, data_home=args.data_home)
    names = np.unique(data.placements)
    folds = [without(data, placement, args.keep_outliers) for placement in names]
    print(
        f"{args.arm}, real data: {len(data.data)} poses in {len(np.unique(data.groups))} "
        f"sockets at {len(names)} placements."
    )
    print()
    print("Each placement is left out once; calibrated and trained on the others. Their points:")
    print()
    table = Table(
        ("placement left out", 18, ""),
        ("nominal", 7, ".3f"),
        ("calibrated", 10, ".3f"),
        ("left out", 8, ".3f"),
        ("outliers", 8, "d"),
    )
    for name, fold in zip(names, folds, strict=True):
        residuals = position_residuals(fold.points[fold.test], data.groups[fold.test])
        left_out = np.linalg.norm(residuals, axis=1).mean()
        c = fold.calibration
        table.row(str(name), c.scatter_before_mm, c.scatter_after_mm, left_out, len(c.outliers))
    print()
    print("Mean distance from the mean of the socket, mm: on the placements calibrated on, with")
    print("nominal parameters (and fitted probe) and calibrated; on the placement left out.")
    kept = "are learnt from all the same" if args.keep_outliers else "are not learnt from"
    print(f"Outliers, by calibration, among those calibrated on: they {kept}.")
    print("At the placement left out every point counts.")
    print()
    print("At the placements left out, mm; mean, max: distance from the mean of the socket;")
    print("2S: repeatability of a socket; explained: share of the squares that the correction")
    print("takes away; holes: mean error of the 50 mm between two sockets.")
    print()
    reports = compare(data, folds, args.jobs)
    print()
    print("By socket, mm; pose, all: corrected by the RBF network on pose angles, on all joints:")
    print()
    print_sockets(reports)
    plot(reports, f"{args.arm} (real): placements that calibration and model never saw").savefig(
        args.output, dpi=100
    )
    print()
    print(f"Figure: {args.output}")


if __name__ == "__main__":
    main()
