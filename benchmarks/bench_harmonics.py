"""What each idea of a correction is worth, at positions that no stage has seen.

    python benchmarks/bench_harmonics.py --rows 1500 sim-gravity panda_3

Sets are

- sim-gravity, sim-typical, sim-eccentricity: simulated arms, ten positions of 40 poses in five
  folds; gauges of 500 mm corrected by a model of all positions;
- panda_3, panda_2: real, every placement left out once;
- ur10-goal, ur10-space: real, five folds of goal positions, at random or of neighbours; `--rows`
  draws so many of the 11 911 poses;
- ur10b-space: another series of that robot, 1495 clustered poses, five folds of regions;
- grid: panda_3, every placement left out once: its distances to the others, and of its pair;
- octants: a UR10, trained on 60 or 200 poses of one octant of its volume and used in the others.

The real data are looked for where `_arm_folds` says. `--defaults` runs `ArmResidualRegressor`
alone, without the table of ideas; `--inputs` compares what a network alone is given instead.

Every real fold calibrates the arm on its own training rows. The settings of every method are its
defaults, or found inside the training rows. The tables are printed as the documentation has them,
in mm: mean deviation over test poses / maximum; +- is half the width of a 95 % interval of the
mean's paired difference to no correction, by resampling positions (seed 0); 2S is a mean over
positions, about zero (tracker) or about the position's mean; 500 mm the mean absolute error of
gauges. Inside is the share of the components of measured residuals that lie within 1.96 standard
deviations, noise included.
"""

import argparse
import sys
import warnings
from itertools import combinations
from operator import itemgetter

import numpy as np
from _arm_folds import panda_folds, read_panda, read_ur10, simulated_folds, ur10_folds, ur10b_folds
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    position_residuals,
)
from sklearn_raacmm.datasets import make_gauge, make_single_point
from sklearn_raacmm.metrics import gauge_lengths


def network(arm, first=0, **inputs):
    """The network on the pose's features from a number on."""
    kept = FunctionTransformer(itemgetter((slice(None), slice(first, None))))
    steps = PoseFeatures(arm, **inputs), kept, StandardScaler(), RBFNetRegressor(random_state=0)
    return CylindricalResidualTarget(make_pipeline(*steps), azimuth=arm.azimuth)


NONE, MODEL = "no correction", "`ArmResidualRegressor`"


def ideas(arm, tracked):
    """Name, estimator, and whether it takes groups, of what the linear model is made of."""
    yield "harmonics alone", ArmResidualRegressor(arm, causes=[]), True
    yield "and gravity", ArmResidualRegressor(arm, causes=["gravity"]), True
    yield "and kinematics", ArmResidualRegressor(arm, causes=["gravity", "kinematics"]), True
    if not tracked:
        yield "the default, but no offsets", ArmResidualRegressor(arm, offsets=False), True


def inputs(arm, tracked):
    """The same network with other inputs."""
    words = {"angle": "angles", "periodic": "cosines and sines"}
    for joints, name in (("pose", "pose"), ("all", "all joints")):
        for encoding, what in words.items():
            yield f"{name}, {what}", network(arm, joints=joints, encoding=encoding), False
    model = network(arm, first=2, joints="all", encoding="periodic")
    yield "all but the first, cosines and sines", model, False


def statistics(left, groups, reference):
    """Mean, half width of the interval of the mean's difference to the reference, maximum, 2S."""
    length = np.linalg.norm(left, axis=1)
    _, index = np.unique(groups, return_inverse=True)
    counts = np.bincount(index)
    sums = np.bincount(index, length - reference)
    rng = np.random.default_rng(0)
    draws = rng.integers(0, len(counts), (2000, len(counts)))
    differences = sums[draws].sum(axis=1) / counts[draws].sum(axis=1)
    low, high = np.quantile(differences, [0.025, 0.975])
    two_s = 2 * np.sqrt(np.bincount(index, length**2) / np.maximum(counts - 1, 1))
    return length.mean(), (high - low) / 2, length.max(), two_s[counts > 1].mean()


def gauge_errors(mix):
    """Mean absolute error of 500 mm gauges: no correction, a model, one that knows 300 mm."""
    cone = make_single_point(10, 40, machine=mix, random_state=0)
    gauge = make_gauge(machine=mix, random_state=0)
    long = gauge.lengths == 500

    def error(correction):
        lengths = gauge_lengths(gauge.points - correction, gauge.groups, gauge.pairs)
        return np.abs(lengths - gauge.lengths)[long].mean()

    model = ArmResidualRegressor(cone.arm).fit(cone.data, cone.target, groups=cone.groups)
    found = [error(0.0), error(model.predict(gauge.data))]
    short = np.isin(gauge.groups, gauge.pairs[~long])
    theta = np.vstack([cone.data, gauge.data[short]])
    y = np.vstack([cone.target, gauge.target[short]])
    groups = np.r_[cone.groups, 100 + gauge.groups[short]]
    known = [(100 + a, 100 + b, 300.0, 0.003) for a, b in gauge.pairs[~long]]
    model = ArmResidualRegressor(cone.arm).fit(theta, y, groups=groups, lengths=known)
    return [*found, error(model.predict(gauge.data))]


def folds_of(name, n_rows):
    if name == "ur10b-space":
        return ur10b_folds()
    if name.startswith("ur10"):
        return ur10_folds(name.split("-")[1], n_rows)
    return simulated_folds(name[4:]) if name.startswith("sim") else panda_folds(name)


def run(name, n_rows, others, with_defaults):
    """What is left by each method in all folds, their groups, and shares inside 1.96 deviations."""
    tracked = name.startswith("ur10")
    lefts, labels, inside = {}, [], []
    for arm, theta, y, groups, train in folds_of(name, n_rows):
        labels.append(groups[~train])

        def left_by(prediction, y=y, train=train, groups=groups):
            left = y[~train] - prediction
            return left if tracked else position_residuals(left, groups[~train])

        found = {NONE: y[~train] if tracked else left_by(0.0)}
        for title, model, takes_groups in others(arm, tracked):
            extra = {"groups": groups[train]} if takes_groups else {}
            model.fit(theta[train], y[train], **extra)
            found[title] = left_by(model.predict(theta[~train]))
        if with_defaults:
            model = ArmResidualRegressor(arm)
            model.fit(theta[train], y[train], groups=groups[train])
            mean, std = model.predict(theta[~train], return_std=True, with_noise=True)
            found[MODEL] = left_by(mean)
            inside.append(np.abs(found[MODEL]) < 1.96 * std)
        for title, left in found.items():
            lefts.setdefault(title, []).append(left)
    lefts = {title: np.concatenate(parts) for title, parts in lefts.items()}
    return lefts, np.concatenate(labels), 100 * np.mean(np.concatenate(inside)) if inside else None


def rows_of(name, lefts, groups, inside):
    """Rows of the two tables, as dictionaries of their cells by column."""
    reference = np.linalg.norm(lefts[NONE], axis=1)
    found = {title: statistics(left, groups, reference) for title, left in lefts.items()}
    ideas = {title: f"{found[title][0]:.4f} / {found[title][2]:.3f}" for title in found}
    if MODEL not in found:
        return ideas, {}
    mean, half, largest, _ = found[MODEL]
    defaults = {NONE: ideas[NONE], MODEL: f"{mean:.4f} ± {half:.4f} / {largest:.3f}"}
    defaults["2S: none, model"] = f"{found[NONE][3]:.4f}, {found[MODEL][3]:.4f}"
    defaults["inside"] = f"{inside:.1f} %"
    if name.startswith("sim"):
        gauges = ", ".join(f"{error:.4f}" for error in gauge_errors(name[4:]))
        defaults["500 mm: none, model, 300 mm known"] = gauges
    return ideas, defaults


def print_table(rows):
    """A table of Markdown; `rows` has a dictionary of cells for each data set."""
    heads = list(dict.fromkeys(head for cells in rows.values() for head in cells))
    # The default stands behind the ideas that it is made of, before its variants.
    heads.sort(key=lambda head: head.startswith("the default"))
    print("\n| | " + " | ".join(heads) + " |\n|" + "---|" * (len(heads) + 1))
    for name, cells in rows.items():
        print(f"| {name} | " + " | ".join(cells.get(head, "") for head in heads) + " |")
    sys.stdout.flush()


def octants():
    """A UR10 learns in one octant, with an arm calibrated there or everywhere."""
    theta, points, goals = read_ur10("A")
    rows = np.random.default_rng(0).permutation(len(theta))[:2500]
    theta, points, goals = theta[rows], points[rows], goals[rows]

    def calibrated(mask):
        nominal = Arm.from_name("ur10", probe=(0, 0, 109))
        result = calibrate(nominal, theta[mask], points=points[mask])
        measured = (points - result.base_translation) @ result.base_rotation
        return result.arm, result.arm.forward(theta) - measured

    everywhere = calibrated(np.ones(len(theta), dtype=bool))
    place = everywhere[0].forward(theta)
    octant = (place > np.median(place, axis=0)) @ [1, 2, 4]
    ratios = {}
    for here in range(8):
        inside = np.flatnonzero(octant == here)
        for n in (60, 200):
            train = np.isin(np.arange(len(theta)), inside[:n])
            for how in ("there", "everywhere"):
                arm, y = calibrated(train) if how == "there" else everywhere
                model = ArmResidualRegressor(arm).fit(theta[train], y[train], groups=goals[train])
                test = octant != here
                left = y[test] - model.predict(theta[test])
                before, after = (np.linalg.norm(part, axis=1).mean() for part in (y[test], left))
                ratios.setdefault((f"{n} poses", f"calibrated {how}"), []).append(after / before)
    print("\noctants: mean deviation elsewhere over that without correction, 8 octants of a UR10")
    _print_ratios(ratios)


# Where panda_3 stood on its grid, mm; the front left one not on it, as its distances show.
GRID = {
    f"{row}{column}": (x - 25.3 * ((row, column) == ("front", "left")), y)
    for row, y in (("front", 0.0), ("back", 150.0))
    for column, x in (("left", 0.0), ("center", 175.0), ("right", 350.0))
}


def grid():
    """Distances that one placement of panda_3 has to the others, by models of the others."""
    angles, sockets, placements = read_panda("panda_3")
    errors = {}
    for out in GRID:
        train = placements != out
        rest = [name for name in GRID if name != out]
        pairs = [(f"{name}/0", f"{name}/1", 50.0, 0.1) for name in rest]
        between = [
            (f"{a}/{hole}", f"{b}/{hole}", np.linalg.norm(np.subtract(GRID[a], GRID[b])), 0.2)
            for a, b in combinations(rest, 2)
            for hole in "01"
        ]
        nominal = Arm.from_name("panda", probe=(0, 0, 138))
        arm = calibrate(nominal, angles[train], sockets[train], lengths=pairs).arm
        points = arm.forward(angles)
        learn = angles[train], position_residuals(points[train], sockets[train])
        found = {"no correction": np.zeros_like(points)}
        for title, known in (("no lengths", ()), ("50 mm pairs", pairs), ("all", pairs + between)):
            model = ArmResidualRegressor(arm)
            model.fit(*learn, groups=sockets[train], lengths=known)
            found[f"lengths in the fit: {title}"] = model.predict(angles)
        for title, correction in found.items():
            centre = {
                label: (points - correction)[sockets == label].mean(axis=0)
                for label in np.unique(sockets)
            }

            def error(a, b, length, centre=centre):
                return abs(np.linalg.norm(centre[a] - centre[b]) - length)

            far = [
                error(
                    f"{out}/{hole}", f"{b}/{hole}", np.linalg.norm(np.subtract(GRID[out], GRID[b]))
                )
                for b in rest
                for hole in "01"
            ]
            lists = errors.setdefault(title, ([], []))
            lists[0].extend(far)
            lists[1].append(error(f"{out}/0", f"{out}/1", 50.0))
    print(f"\ngrid: mean absolute error\n{'':<40}{'others':>8}{'50 mm':>8}")
    for title, (far, pair) in errors.items():
        print(f"{title:<40}{np.mean(far):8.3f}{np.mean(pair):8.3f}")


def _print_ratios(ratios):
    print(f"{'':<40}{'mean':>8}{'worst':>8}")
    for names, values in ratios.items():
        print(f"{', '.join(names):<40}{np.mean(values):8.2f}{np.max(values):8.2f}")
    sys.stdout.flush()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=None, help="of the UR10 (default: all)")
    parser.add_argument("--inputs", action="store_true", help="compare the network's inputs")
    parser.add_argument("--defaults", action="store_true", help="only the default")
    mixes = ["sim-gravity", "sim-typical", "sim-eccentricity"]
    others = {"grid": grid, "octants": octants}
    sets = [*mixes, "panda_3", "panda_2", "ur10-goal", "ur10-space", "ur10b-space", *others]
    parser.add_argument("sets", nargs="*", default=sets, metavar="sets", help=", ".join(sets))
    args = parser.parse_args()
    warnings.filterwarnings("ignore", message=".*known lengths disagree")
    warnings.filterwarnings("ignore", message="Without the cause kinematics")
    compared = inputs if args.inputs else (lambda *_: ()) if args.defaults else ideas
    tables = {}, {}
    for name in args.sets:
        if name in others:
            others[name]()
            continue
        found = run(name, args.rows, compared, not args.inputs)
        for table, cells in zip(tables, rows_of(name, *found), strict=True):
            table[name] = cells
    if tables[0] and not args.defaults:
        print_table(tables[0])
    if tables[1] and not args.inputs:
        print_table(tables[1])


if __name__ == "__main__":
    main()
