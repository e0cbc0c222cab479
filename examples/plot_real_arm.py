"""
A real arm, before and after
============================

Two Franka Panda arms held a ball in sockets and moved through many poses: the single-point test
of a measuring arm, done with real arms by the authors of MUKCa. Each placement of the sockets is
left out once. On the other placements the arm is calibrated and the models are trained; what they
predict for the placement left out is subtracted there. Nothing of a placement is used before it
is judged.

The data are not part of this package. Get them as the message says that this script prints
without ``--data``.
"""

import argparse
import sys
from pathlib import Path
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
from _comparison import (
    ALL,
    PAPER,
    UNCORRECTED,
    Table,
    figure_file,
    fit,
    in_parallel,
    models_to_compare,
)

from sklearn_raacmm import Arm, calibrate, position_residuals
from sklearn_raacmm.metrics import gauge_lengths, repeatability_report, repeatability_scorer

WHERE = """\
Give the folder of the data with --data. To get them:

  git clone https://github.com/platonics-delft/kinematics_calibration
  git -C kinematics_calibration checkout 05a05ab4cbbe328c8f5bfcc76479c752ed07b82e
  python examples/plot_real_arm.py --data kinematics_calibration/data
"""
N_JOINTS = 7
HOLES_MM, HOLES_SD_MM = 50.0, 0.1  # between the two sockets of a placement
THREE, SEVEN = (PAPER, "RBF network"), (ALL, "RBF network")


def read_angles(path, unit):
    """Read the joint angles of one file, in rad."""
    try:
        angles = np.loadtxt(path, delimiter=",", ndmin=2)
    except ValueError as error:
        raise SystemExit(f"{path} cannot be read: {error}") from None
    if not np.isfinite(angles).all():
        row = np.argwhere(~np.isfinite(angles))[0, 0]
        raise SystemExit(f"{path} holds NaN or infinity, first in line {row + 1}.")
    if angles.shape[1] != N_JOINTS:
        raise SystemExit(f"{path} has {angles.shape[1]} columns; {N_JOINTS} joint angles needed.")
    if unit == "deg":
        return np.deg2rad(angles)
    if np.abs(angles).max() > 2 * np.pi:  # no joint of this arm turns once around
        raise SystemExit(
            f"{path} holds angles of up to {np.abs(angles).max():.1f} rad, more than a turn: "
            "if they are degrees, say --angle-unit deg."
        )
    return angles


def read(folder, unit="rad"):
    """Read angles (rad), sockets and placements; points of one socket should coincide."""
    paths = sorted(folder.glob("*/hole_[01].csv"))
    if not paths:
        raise SystemExit(f"No file like <placement>/hole_0.csv in {folder}.\n\n{WHERE}")
    tables = [read_angles(path, unit) for path in paths]
    counts = [len(table) for table in tables]
    return SimpleNamespace(
        angles=np.concatenate(tables),
        sockets=np.repeat([f"{path.parent.name}/{path.stem[-1]}" for path in paths], counts),
        placements=np.repeat([path.parent.name for path in paths], counts),
    )


def without(data, placement, keep_outliers=False):
    """Calibrate on the other placements: the arm, its points, and the rows to learn from."""
    train = data.placements != placement
    known = [
        (f"{name}/0", f"{name}/1", HOLES_MM, HOLES_SD_MM)
        for name in np.unique(data.placements[train])
    ]
    # The ball sits about 138 mm along the last axis; calibration finds where exactly.
    nominal = Arm.from_name("panda", probe=(0, 0, 138))
    result = calibrate(nominal, data.angles[train], data.sockets[train], lengths=known)
    learn = np.flatnonzero(train)
    if not keep_outliers:
        # Calibration weighs outliers down by itself; least squares of the residuals would not.
        learn = np.delete(learn, result.outliers)
    return SimpleNamespace(
        arm=result.arm,
        learn=learn,
        test=~train,
        points=result.arm.forward(data.angles),
        calibration=result,
    )


def corrected_points(data, fold, name):
    """Points of the placement left out, corrected by one of the models."""
    learn, test = fold.learn, fold.test
    angles, sockets, placements = data.angles[learn], data.sockets[learn], data.placements[learn]
    n_splits = min(5, len(np.unique(placements)))
    scoring = repeatability_scorer(angles, sockets)
    model = models_to_compare(fold.arm, scoring, n_splits)[name]
    fit(model, angles, position_residuals(fold.points[learn], sockets), placements)
    return fold.points[test] - model.predict(data.angles[test])


def compare(data, folds, jobs):
    """Print the table of models; return the report of every socket, by model."""
    order = np.concatenate([np.flatnonzero(fold.test) for fold in folds])
    sockets = data.sockets[order]
    pairs = [(f"{name}/0", f"{name}/1") for name in np.unique(data.placements)]
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
            np.abs(gauge_lengths(points, sockets, pairs) - HOLES_MM).mean(),
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
    parser.add_argument("--data", type=Path, help="folder of panda_2 and panda_3")
    parser.add_argument("--arm", default="panda_3", help="panda_3 (default) or panda_2")
    parser.add_argument("--angle-unit", choices=["rad", "deg"], default="rad", help="of the files")
    parser.add_argument(
        "--keep-outliers",
        action="store_true",
        help="let the models learn from the rows that calibration names as outliers, too",
    )
    parser.add_argument("--jobs", type=int, default=-1, help="processes (default: one per core)")
    parser.add_argument(
        "--output", type=figure_file, default="real_arm.png", help="file of the figure"
    )
    args = parser.parse_args(argv)
    if args.data is None:
        print(WHERE, file=sys.stderr, end="")
        raise SystemExit(2)

    data = read(args.data / args.arm, args.angle_unit)
    names = np.unique(data.placements)
    if len(names) < 3:
        raise SystemExit(f"{len(names)} placements in {args.data / args.arm}; 3 or more needed.")
    folds = [without(data, placement, args.keep_outliers) for placement in names]
    print(
        f"{args.arm}, real data: {len(data.angles)} poses in {len(np.unique(data.sockets))} "
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
        residuals = position_residuals(fold.points[fold.test], data.sockets[fold.test])
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
    print(f"takes away; holes: mean error of the {HOLES_MM:g} mm between two sockets.")
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
