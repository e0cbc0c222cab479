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

The data are not part of this package: they are downloaded the first time. All rows take some
minutes, ``--rows 1500`` less than one.
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
from sklearn.model_selection import GroupKFold
from sklearn.utils import Bunch

from sklearn_raacmm import calibrate
from sklearn_raacmm.datasets import fetch_ur10_tracker
from sklearn_raacmm.metrics import single_point_repeatability


def some_goals(data, n_rows):
    """Keep goal positions drawn at random, with about so many rows."""
    order = np.random.default_rng(0).permutation(data.groups.max() + 1)
    kept = order[: max(3, n_rows * len(order) // len(data.groups))]
    some = np.isin(data.groups, kept)
    rows = {name: data[name][some] for name in ("data", "tracker_points", "groups")}
    return Bunch(**rows, nominal_arm=data.nominal_arm)


def calibrated(data, train, test):
    """Calibrate on the training rows: the arm, and the residuals of all rows in its base frame."""
    result = calibrate(data.nominal_arm, data.data[train], points=data.tracker_points[train])
    true = (data.tracker_points - result.base_translation) @ result.base_rotation
    residuals = result.arm.forward(data.data) - true
    return SimpleNamespace(
        arm=result.arm, train=train, test=test, residuals=residuals, calibration=result
    )


def left_over(data, fold, name, gp_rows):
    """Residuals of the test rows less what one of the models predicts."""
    train = fold.train
    if "Gaussian" in name[1] and len(train) > gp_rows:  # its cost is cubic
        train = np.sort(np.random.default_rng(0).choice(train, gp_rows, replace=False))
    model = models_to_compare(fold.arm)[name]
    fit(model, data.data[train], fold.residuals[train], data.groups[train])
    return fold.residuals[fold.test] - model.predict(data.data[fold.test])


def compare(data, folds, jobs, gp_rows):
    """Print the table of models; return the distance of every row from the truth, by model."""
    goals = data.groups[np.concatenate([fold.test for fold in folds])]
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
    parser.add_argument("--data-home", help="folder of the data (default: scikit-learn's)")
    parser.add_argument("--rows", type=int, help="use about so many rows only, of random goals")
    parser.add_argument("--folds", type=int, default=3, help="of goal positions (default: 3)")
    parser.add_argument(
        "--gp-rows", type=int, default=1500, help="to train a Gaussian process (default: 1500)"
    )
    parser.add_argument(
        "--jobs", type=processes, default=-1, help="processes (default: one per core)"
    )
    parser.add_argument(
        "--output", type=figure_file, default="real_tracker.png", help="file of the figure"
    )
    args = parser.parse_args(argv)

    data = fetched(fetch_ur10_tracker, data_home=args.data_home)
    if args.rows is not None:
        data = some_goals(data, args.rows)
    n_goals = len(np.unique(data.groups))
    splits = GroupKFold(args.folds).split(data.data, groups=data.groups)
    folds = [calibrated(data, train, test) for train, test in splits]
    print(f"UR10, real data: {len(data.data)} poses at {n_goals} goal positions.")
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
