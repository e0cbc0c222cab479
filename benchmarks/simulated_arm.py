"""
A simulated arm, before and after
=================================

The cone-hole test of a measuring arm: the probe sits in a conical hole while the elbow swings
from left to right, so that all points should coincide. They do not. A model learns from some
positions of the cone by how much the arm is wrong in which pose, and corrects the points at a
position that it has never seen.

Everything here is simulated, with errors as in a real arm: eccentric encoders, wobbling axes,
tubes that bend, joints that twist, noise. The arm was calibrated beforehand, on other simulated
data. Data come with the package; nothing is downloaded.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np
from _comparison import (
    ALL,
    ONE_WIDTH,
    PAPER,
    UNCORRECTED,
    Table,
    figure_file,
    fit,
    in_parallel,
    models_to_compare,
    processes,
)
from sklearn.model_selection import LeaveOneGroupOut

from sklearn_raacmm.datasets import make_gauge, make_single_point
from sklearn_raacmm.metrics import (
    gauge_lengths,
    length_error,
    repeatability_scorer,
    single_point_repeatability,
)

THREE, SIX = (PAPER, "RBF network"), (ALL, "RBF network")
FLOOR = ("-", "perfect model")


def held_out_correction(model, angles, residuals, groups, train, test):
    """Prediction for the rows of one position by a model fitted on the other positions."""
    fit(model, angles[train], residuals[train], groups[train], groups[train])
    return test, model.predict(angles[test])


def corrections(title, model, cone, gauge, jobs):
    """Corrections of the cone's points, each by the other positions, and of the gauges' points."""
    rows = (cone.data, cone.target, cone.groups)
    splits = LeaveOneGroupOut().split(*rows)
    folds, seconds = in_parallel(
        held_out_correction, [(model, *rows, train, test) for train, test in splits], jobs, title
    )
    at_cone = np.empty_like(cone.points)
    for test, predicted in folds:
        at_cone[test] = predicted
    return at_cone, fit(model, *rows, cone.groups).predict(gauge.data), seconds


def compare(cone, gauge, jobs):
    """Print the table of models; return the 2S of every position and the corrected points."""
    n = len(np.unique(cone.groups))
    scoring = repeatability_scorer(cone.data, cone.groups)
    models = models_to_compare(cone.arm, scoring, n_splits=min(5, n - 1))
    del models[ONE_WIDTH]  # to keep within a minute
    before = single_point_repeatability(cone.points, cone.groups)
    floor = single_point_repeatability(
        cone.points - cone.simulation.perfect_correction, cone.groups
    )
    sizes = np.unique(gauge.lengths)
    table = Table(
        ("inputs", 24, ""),
        ("regressor", 22, ""),
        ("2S mean", 7, ".4f"),
        ("2S max", 7, ".4f"),
        ("less", 5, ".0%"),
        ("of possible", 11, ".0%"),
        *((f"{size:g} mm gauge", 12, ".4f") for size in sizes),
        ("seconds", 7, ".1f"),
    )
    spread, corrected = {}, {}

    def show(name, at_cone, at_gauge, seconds=None):
        corrected[name] = cone.points - at_cone
        values = single_point_repeatability(corrected[name], cone.groups, aggregate=None)
        spread[name] = values
        lengths = gauge_lengths(gauge.points - at_gauge, gauge.groups, gauge.pairs)
        errors = [
            length_error(lengths[gauge.lengths == size], size, statistic="mean") for size in sizes
        ]
        gain = None if name == UNCORRECTED else before - values.mean()
        less, possible = (None, None) if gain is None else (gain / before, gain / (before - floor))
        table.row(*name, values.mean(), values.max(), less, possible, *errors, seconds)

    show(UNCORRECTED, 0.0, 0.0)
    for name, model in models.items():
        show(name, *corrections(", ".join(name), model, cone, gauge, jobs))
    show(FLOOR, cone.simulation.perfect_correction, gauge.simulation.perfect_correction)
    return spread, corrected


def print_positions(cone, spread):
    """Print the repeatability of every position."""
    columns = {
        "before": UNCORRECTED,
        "after, pose angles": THREE,
        "after, all joints": SIX,
        "noise floor": FLOOR,
    }
    simulated = cone.simulation
    distance = np.linalg.norm(simulated.positions - simulated.machine.shoulder, axis=1)
    table = Table(
        ("position", 8, "d"),
        ("from the shoulder (mm)", 22, ".0f"),
        *((name, 11, ".4f") for name in columns),
    )
    for i, label in enumerate(np.unique(cone.groups)):
        table.row(int(label) + 1, distance[i], *(spread[name][i] for name in columns.values()))


def plot(cone, spread, corrected):
    """Draw the points in one cone before and after, and the repeatability of every position."""
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(9, 3.6), width_ratios=[1, 1.6], layout="constrained"
    )
    # The position in the middle of the ranking: neither the best example nor the worst.
    shown = np.argsort(spread[SIX] / spread[UNCORRECTED])[len(spread[SIX]) // 2]
    rows = cone.groups == np.unique(cone.groups)[shown]
    styles = {
        UNCORRECTED: ("before", "0.6", "o"),
        THREE: ("after, three pose angles", "tab:orange", "s"),
        SIX: ("after, all joints", "tab:blue", "D"),
        FLOOR: ("noise floor", "0.25", None),
    }
    for name in (UNCORRECTED, SIX):
        label, color, _ = styles[name]
        deviation = corrected[name][rows] - corrected[name][rows].mean(axis=0)
        left.plot(deviation[:, 0], deviation[:, 2], ".", color=color, ms=5, label=label)
    left.set(
        xlabel="x - mean (mm)",
        ylabel="z - mean (mm)",
        title=f"Points in one cone (position {shown + 1})",
    )
    left.set_aspect("equal", adjustable="datalim")
    left.legend(loc="best", fontsize="small")
    positions = np.arange(1, len(spread[SIX]) + 1)
    for name, (label, color, marker) in styles.items():
        line = "--" if name == FLOOR else "-"
        right.plot(positions, spread[name], line, color=color, marker=marker, ms=5, label=label)
    right.set(
        xlabel="position of the cone, from near to far",
        ylabel="repeatability 2S (mm)",
        title="Each position corrected by the others",
        xticks=positions,
    )
    right.set_ylim(bottom=0)
    right.legend(loc="upper left", fontsize="small")
    figure.suptitle("Single-point repeatability of a simulated measuring arm")
    return figure


def main(argv=None):
    """Run the job."""
    parser = argparse.ArgumentParser(
        description="A simulated arm, before and after the correction."
    )
    parser.add_argument("--positions", type=int, default=10, help="of the cone (default: 10)")
    parser.add_argument("--poses", type=int, default=60, help="at each position (default: 60)")
    parser.add_argument("--seed", type=int, default=0, help="another number, another arm")
    parser.add_argument(
        "--machine", default="typical", choices=["typical", "gravity", "eccentricity"]
    )
    parser.add_argument(
        "--jobs", type=processes, default=-1, help="processes (default: one per core)"
    )
    parser.add_argument(
        "--output", type=figure_file, default="simulated_arm.png", help="file of the figure"
    )
    args = parser.parse_args(argv)
    if args.positions < 3:
        parser.error(f"--positions must be at least 3 to hold one out, got {args.positions}.")

    settings = {"machine": args.machine, "random_state": args.seed}
    try:
        cone = make_single_point(args.positions, args.poses, **settings)
        gauge = make_gauge(**settings)
    except ValueError as error:
        parser.error(str(error))

    print(f"Simulated measuring arm, calibrated: {cone.arm!r}")
    print(f"Simulated cone-hole test: {args.positions} positions, {args.poses} poses at each.")
    print()
    print("Each position is corrected by a model that has seen only the other positions.")
    print("2S: single-point repeatability in mm, mean and maximum over the positions;")
    print("less: reduction of its mean; of possible: share of what a perfect model reduces;")
    print("gauge: mean absolute error in mm of a gauge's length, in placements never trained on.")
    print()
    spread, corrected = compare(cone, gauge, args.jobs)
    print()
    print("Repeatability 2S (mm) of every position, by the RBF network:")
    print()
    print_positions(cone, spread)
    plot(cone, spread, corrected).savefig(args.output, dpi=100)
    print()
    print(f"Figure: {args.output}")


if __name__ == "__main__":
    main()
