"""What each idea of a correction is worth, at positions that no stage has seen.

    python benchmarks/bench_harmonics.py --rows 1500 sim-gravity panda_3

Sets are

- sim-gravity, sim-typical, sim-eccentricity: simulated arms, ten positions of 40 poses in five
  folds; gauges of 500 mm corrected by a model of all positions;
- panda_3, panda_2: real, every placement left out once;
- ur10-goal, ur10-space: real, five folds of goal positions, at random or of neighbours; `--rows`
  draws so many of the 11 911 poses;
- ur10b-space: another series of that robot, 1495 clustered poses, five folds of regions;
- octants: a UR10, trained on 60 or 200 poses of one octant of its volume and used in the others.

The real data are looked for where `_arm_folds` says. `--defaults` runs `ArmResidualRegressor`
alone, without the table of ideas.

Every real fold calibrates the arm on its own training rows. The settings of every method are its
defaults, or found inside the training rows. The tables are printed as the documentation has them,
in mm: mean deviation over test poses / maximum; +- is half the width of a 95 % interval of the
mean's paired difference to no correction, by resampling positions (seed 0); 2S is a mean over
positions, about zero (tracker) or about the position's mean; 500 mm the mean absolute error of
gauges. Inside is the share of the components of measured residuals that lie within 1.96 standard
deviations, noise included.
"""

import argparse
import warnings

import numpy as np
from _arm_folds import (
    mean_deviation,
    panda_folds,
    read_ur10,
    simulated_folds,
    ur10_folds,
    ur10b_folds,
)

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import make_gauge, make_single_point
from sklearn_raacmm.metrics import gauge_lengths

NONE, MODEL = "no correction", "`ArmResidualRegressor`"


def ideas(arm, tracked):
    """Name and estimator of what the linear model is made of."""
    yield "harmonics alone", ArmResidualRegressor(arm, causes=[])
    yield "and gravity", ArmResidualRegressor(arm, causes=["gravity"])
    yield "and kinematics", ArmResidualRegressor(arm, causes=["gravity", "kinematics"])
    if not tracked:
        yield "the default, but no offsets", ArmResidualRegressor(arm, offsets=False)


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


def run(name, n_rows, with_ideas):
    """What is left by each method in all folds, their groups, and shares inside 1.96 deviations."""
    tracked = name.startswith("ur10")
    lefts, labels, inside = {}, [], []
    for arm, theta, y, groups, train in folds_of(name, n_rows):
        labels.append(groups[~train])

        def left_by(prediction, y=y, train=train, groups=groups):
            left = y[~train] - prediction
            return left if tracked else position_residuals(left, groups[~train])

        found = {NONE: y[~train] if tracked else left_by(0.0)}
        for title, model in ideas(arm, tracked) if with_ideas else ():
            model.fit(theta[train], y[train], groups=groups[train])
            found[title] = left_by(model.predict(theta[~train]))
        model = ArmResidualRegressor(arm).fit(theta[train], y[train], groups=groups[train])
        mean, std = model.predict(theta[~train], return_std=True, with_noise=True)
        found[MODEL] = left_by(mean)
        inside.append(np.abs(found[MODEL]) < 1.96 * std)
        for title, left in found.items():
            lefts.setdefault(title, []).append(left)
    lefts = {title: np.concatenate(parts) for title, parts in lefts.items()}
    return lefts, np.concatenate(labels), 100 * np.mean(np.concatenate(inside))


def rows_of(name, lefts, groups, inside):
    """Rows of the two tables, as dictionaries of their cells by column."""
    reference = np.linalg.norm(lefts[NONE], axis=1)
    found = {title: statistics(left, groups, reference) for title, left in lefts.items()}
    ideas = {title: f"{found[title][0]:.4f} / {found[title][2]:.3f}" for title in found}
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


def octants():
    """A UR10 learns in one octant, with an arm calibrated there or everywhere."""
    theta, points, goals = read_ur10("A")
    rows = np.random.default_rng(0).permutation(len(theta))[:2500]
    theta, points, goals = theta[rows], points[rows], goals[rows]

    def calibrated(mask):
        nominal = Arm.from_name("ur10", probe=(0, 0, 109))
        result = calibrate(nominal, theta[mask], points=points[mask])
        return result.arm, result.residuals(theta, points)

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
                ratio = mean_deviation(left) / mean_deviation(y[test])
                ratios.setdefault((f"{n} poses", f"calibrated {how}"), []).append(ratio)
    print("\noctants: mean deviation elsewhere over that without correction, 8 octants of a UR10")
    print(f"{'':<40}{'mean':>8}{'worst':>8}")
    for names, values in ratios.items():
        print(f"{', '.join(names):<40}{np.mean(values):8.2f}{np.max(values):8.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=None, help="of the UR10 (default: all)")
    parser.add_argument("--defaults", action="store_true", help="only the default")
    sets = ["sim-gravity", "sim-typical", "sim-eccentricity", "panda_3", "panda_2"]
    sets += ["ur10-goal", "ur10-space", "ur10b-space", "octants"]
    parser.add_argument("sets", nargs="*", default=sets, metavar="sets", help=", ".join(sets))
    args = parser.parse_args()
    warnings.filterwarnings("ignore", message=".*known lengths disagree")
    warnings.filterwarnings("ignore", message="Without the cause kinematics")
    tables = {}, {}
    for name in args.sets:
        if name == "octants":
            octants()
            continue
        cells = rows_of(name, *run(name, args.rows, not args.defaults))
        for table, of_set in zip(tables, cells, strict=True):
            table[name] = of_set
    for table in tables[args.defaults :] if tables[0] else ():
        print_table(table)


if __name__ == "__main__":
    main()
