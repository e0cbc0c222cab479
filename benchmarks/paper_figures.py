"""
The paper's three figures, redrawn
==================================

Gao et al. (2020) show single-point repeatability at ten positions, the lengths of 300 mm and 500 mm
gauges, each before and after the correction, and the residuals against the three angles of the
pose. Here are the same figures from a simulated arm, with the paper's inputs: the model never saw
the position that it corrects, nor any gauge.
"""

import argparse
from pathlib import Path

from _comparison import PAPER, chain, figure_file
from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.datasets import make_gauge, make_single_point
from sklearn_raacmm.display import LengthErrorDisplay, RepeatabilityDisplay, ResidualDisplay


def main(argv=None):
    """Run the job."""
    parser = argparse.ArgumentParser(description="The paper's three figures, simulated.")
    parser.add_argument(
        "--machine", default="gravity", choices=["typical", "gravity", "eccentricity"]
    )
    parser.add_argument("--positions", type=int, default=10, help="of the cone (default: 10)")
    parser.add_argument("--poses", type=int, default=60, help="at each position (default: 60)")
    parser.add_argument("--seed", type=int, default=0, help="another number, another arm")
    parser.add_argument(
        "--output",
        type=figure_file,
        default=Path("paper.png"),
        help="files of the figures: paper_repeatability.png, paper_lengths.png, ...",
    )
    args = parser.parse_args(argv)
    if args.positions < 3:
        parser.error(f"--positions must be at least 3 to hold one out, got {args.positions}.")
    settings = {"machine": args.machine, "random_state": args.seed}
    cone, gauge = make_single_point(args.positions, args.poses, **settings), make_gauge(**settings)
    model = chain(cone.arm, RBFNetRegressor(random_state=0), PAPER)

    told = {"groups": cone.groups}  # which rows are of one position
    correction = cross_val_predict(
        model, cone.data, cone.target, groups=cone.groups, cv=LeaveOneGroupOut(), params=told
    )
    repeatability = RepeatabilityDisplay.from_predictions(
        cone.points,
        correction,
        groups=cone.groups + 1,
        perfect=cone.simulation.perfect_correction,
    )
    lengths = LengthErrorDisplay.from_estimator(
        model.fit(cone.data, cone.target, **told),
        gauge.data,
        gauge.points,
        groups=gauge.groups,
        pairs=gauge.pairs,
        lengths=gauge.lengths,
        perfect=gauge.simulation.perfect_correction,
    )
    residuals = ResidualDisplay.from_predictions(
        cone.data, cone.target, correction, arm=cone.arm, groups=cone.groups
    )
    shown = {"repeatability": repeatability, "lengths": lengths, "residuals": residuals}
    for name, display in shown.items():
        figure = display.figure_
        figure.suptitle(f"Simulated arm ({args.machine}), three inputs")
        path = args.output.with_stem(f"{args.output.stem}_{name}")
        figure.savefig(path, dpi=80)
        print(f"Figure: {path}")


if __name__ == "__main__":
    main()
