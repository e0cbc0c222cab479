"""
A real robot against a laser tracker
====================================

A UR10 went to 619 goal positions in up to 24 orientations each while a laser tracker measured
where it really was: 11 911 poses, by the authors of "A Hybrid Neural Network Approach for
Increasing the Absolute Accuracy of Industrial Robots" (IEEE CASE 2021). Here the residual is known
in full, not only up to one constant per position.

Goal positions are split into folds, never poses, because poses of one goal resemble each other.
Calibration and models see the training goals only. The shoulder and elbow axes of this robot are
parallel, so that its pose is made of other joints than that of a measuring arm: joints 4 and 3 and
the elevation of the line from shoulder to wrist, as ``Arm.from_name("ur10")`` has them.

The data are not part of this package. Get them as the message says that this script prints
without ``--data``. It takes some minutes.
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
from sklearn.model_selection import GroupKFold

from sklearn_raacmm import Arm, calibrate
from sklearn_raacmm.metrics import single_point_repeatability

FILE = "measurements_grid.csv"
WHERE = f"""\
Give the folder of the data, or the file, with --data. To get them:

  curl -O https://raw.githubusercontent.com/christianlandgraf/ipa-robot-accuracy/\
507fba69bdaf6c43c2faf306e70a7e37c5e39b89/Series_A/{FILE}
  python examples/plot_real_tracker.py --data {FILE}
"""
GOAL, JOINTS, POINT = slice(1, 4), slice(7, 13), slice(14, 17)  # columns of the file


def read(path):
    """Read angles (rad), measured points (mm) and the number of the goal position."""
    path = path / FILE if path.is_dir() else path
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()[1:]
        # Semicolons between fields, decimal commas.
        rows = np.array([[float(f.replace(",", ".")) for f in line.split(";")] for line in lines])
        if rows.ndim != 2 or rows.shape[1] < POINT.stop:
            raise ValueError(f"expected {POINT.stop} columns or more, separated by semicolons")
    except (OSError, ValueError) as error:
        raise SystemExit(f"{path} cannot be read: {error}.\n\n{WHERE}") from None
    goals = np.unique(rows[:, GOAL].round(6), axis=0, return_inverse=True)[1].ravel()
    return SimpleNamespace(angles=rows[:, JOINTS], points=rows[:, POINT], goals=goals)


def some_goals(data, n_rows):
    """Keep goal positions drawn at random, with about so many rows."""
    order = np.random.default_rng(0).permutation(data.goals.max() + 1)
    kept = order[: max(3, n_rows * len(order) // len(data.goals))]
    some = np.isin(data.goals, kept)
    return SimpleNamespace(**{name: values[some] for name, values in vars(data).items()})


def calibrated(data, train, test):
    """Calibrate on the training rows: the arm, and the residuals of all rows in its base frame."""
    # The tracker's target sits about 109 mm along the last axis; calibration finds where exactly.
    nominal = Arm.from_name("ur10", probe=(0, 0, 109))
    result = calibrate(nominal, data.angles[train], points=data.points[train])
    true = (data.points - result.base_translation) @ result.base_rotation
    residuals = result.arm.forward(data.angles) - true
    return SimpleNamespace(
        arm=result.arm, train=train, test=test, residuals=residuals, calibration=result
    )


def left_over(data, fold, name, gp_rows):
    """Residuals of the test rows less what one of the models predicts."""
    train = fold.train
    if "Gaussian" in name[1] and len(train) > gp_rows:  # its cost is cubic
        train = np.sort(np.random.default_rng(0).choice(train, gp_rows, replace=False))
    model = models_to_compare(fold.arm)[name]
    fit(model, data.angles[train], fold.residuals[train], data.goals[train])
    return fold.residuals[fold.test] - model.predict(data.angles[fold.test])


def compare(data, folds, jobs, gp_rows):
    """Print the table of models; return the distance of every row from the truth, by model."""
    goals = data.goals[np.concatenate([fold.test for fold in folds])]
    repeated = np.bincount(goals)[goals] > 1
    table = Table(
        ("inputs", 24, ""),
        ("regressor", 22, ""),
        ("mean", 6, ".3f"),
        ("95 %", 6, ".3f"),
        ("max", 6, ".3f"),
        ("2S mean", 7, ".3f"),
        ("2S max", 6, ".3f"),
        ("explained", 9, ".0%"),
        ("seconds", 7, ".1f"),
    )
    distances = {}
    for name in [UNCORRECTED, *models_to_compare(folds[0].arm)]:
        if name == UNCORRECTED:
            parts, seconds = [fold.residuals[fold.test] for fold in folds], None
        else:
            calls = [(data, fold, name, gp_rows) for fold in folds]
            parts, seconds = in_parallel(left_over, calls, jobs, ", ".join(name))
        residuals = np.concatenate(parts)
        distance = distances[name] = np.linalg.norm(residuals, axis=1)
        spread = single_point_repeatability(residuals[repeated], goals[repeated], aggregate=None)
        explained = 1 - np.sum(distance**2) / np.sum(distances[UNCORRECTED] ** 2)
        table.row(
            *name,
            distance.mean(),
            np.quantile(distance, 0.95),
            distance.max(),
            spread.mean(),
            spread.max(),
            None if name == UNCORRECTED else explained,
            seconds,
        )
    return distances


def plot(distances):
    """Draw the share of poses that are nearer than a distance, by model."""
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    share = (np.arange(len(distances[UNCORRECTED])) + 1) / len(distances[UNCORRECTED])
    styles = {
        UNCORRECTED: ("calibrated, uncorrected", "0.6", "-"),
        (PAPER, "Gaussian process"): ("Gaussian process, pose angles", "tab:green", "--"),
        (PAPER, "RBF network"): ("RBF network, pose angles", "tab:orange", "-"),
        (ALL, "RBF network"): ("RBF network, all joints", "tab:blue", "-"),
    }
    for name, (label, color, line) in styles.items():
        axes.plot(np.sort(distances[name]), share, line, color=color, label=label)
    axes.set(
        xlabel="distance from the tracker's point (mm)",
        ylabel="share of poses",
        title="UR10 (real), goal positions never trained on",
        ylim=(0, 1),
        xlim=(0, np.quantile(distances[UNCORRECTED], 0.999)),
    )
    axes.legend(fontsize="small", loc="lower right")
    return figure


def main(argv=None):
    """Run the job."""
    parser = argparse.ArgumentParser(description="A real robot against a laser tracker.")
    parser.add_argument("--data", type=Path, help=f"{FILE}, or its folder")
    parser.add_argument("--rows", type=int, help="use about so many rows only, of random goals")
    parser.add_argument("--folds", type=int, default=3, help="of goal positions (default: 3)")
    parser.add_argument(
        "--gp-rows", type=int, default=1500, help="to train a Gaussian process (default: 1500)"
    )
    parser.add_argument("--jobs", type=int, default=-1, help="processes (default: one per core)")
    parser.add_argument(
        "--output", type=figure_file, default="real_tracker.png", help="file of the figure"
    )
    args = parser.parse_args(argv)
    if args.data is None:
        print(WHERE, file=sys.stderr, end="")
        raise SystemExit(2)

    data = read(args.data)
    if args.rows is not None:
        data = some_goals(data, args.rows)
    n_goals = len(np.unique(data.goals))
    splits = GroupKFold(args.folds).split(data.angles, groups=data.goals)
    folds = [calibrated(data, train, test) for train, test in splits]
    print(f"UR10, real data: {len(data.angles)} poses at {n_goals} goal positions.")
    for fold in folds:
        c = fold.calibration
        print(
            f"Mean deviation of {len(fold.train)} training poses: {c.scatter_before_mm:.3f} mm "
            f"nominal (base and tool fitted), {c.scatter_after_mm:.3f} mm calibrated."
        )
    print()
    print(f"At goal positions left out ({args.folds} folds), mm. mean, 95 %, max: distance from")
    print(
        "the tracker's point; 2S: of the differences at one goal; explained: share of the squares"
    )
    print(f"that the correction takes away. Gaussian processes learn from {args.gp_rows} rows.")
    print()
    distances = compare(data, folds, args.jobs, args.gp_rows)
    plot(distances).savefig(args.output, dpi=100)
    print()
    print(f"Figure: {args.output}")


if __name__ == "__main__":
    main()
