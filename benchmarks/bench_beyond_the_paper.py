"""What each idea beyond the paper is worth at positions left out, and what a correction may harm.

    python benchmarks/bench_beyond_the_paper.py ideas sim-gravity panda_3 --rows 1500
    python benchmarks/bench_beyond_the_paper.py extra --real --rows 1500

``ideas``: mean deviation / maximum, mm, as each idea joins, or of the default alone
(``--defaults``); half a 95 % interval of the mean's difference to no correction, by resampling
positions; 2S; of the default the share of residuals within 1.96 standard deviations, and the mean
error of gauges of 500 mm over twelve arms, with half an interval. Simulated arms have ten positions
of 40 poses in five folds, Pandas lose each placement once, and the UR10 five folds of goal
positions or of regions.
``octants``: a UR10 learns poses of one octant of its volume, and is used in the others.
``harm``: of 42 simulated arms two thirds of the positions are learnt; of eight more the third that
lies to one side, below, near or far. Half of the arms are measured by a tracker.
``intervals``: which share of the true errors at positions left out of a single-point test lies
within 1.96 standard deviations (median, lowest and mean of eight arms of each kind), and these
deviations. What such a test cannot show (ten fields of place: motions, a scale and bends of the
whole volume) is fitted to the true errors at the training positions and taken off.
``extra``: deviations with extra columns over those without. "cause": the column says what has moved
the probe. "noise": the same arm without that cause, and a column that has nothing to do with it.
"""

import argparse
import warnings
from itertools import product

import numpy as np
from _arm_folds import (
    DATA,
    MIXES,
    TOOLED_UR10,
    learn,
    mean_deviation,
    panda_folds,
    read_ur10,
    show,
    sides,
    simulated_folds,
    ur10_folds,
    ur10b_folds,
)
from _data_sets import half_width

from sklearn_raacmm import ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import ArmErrors, fetch_ur10_tracker, make_gauge, make_single_point
from sklearn_raacmm.metrics import gauge_lengths, single_point_repeatability

# -- what each idea is worth ---------------------------------------------------------------------

NONE, MODEL = "no correction", "default"
# Arms of each kind whose gauges are measured: with a model one arm's error is from a third to twice
# the mean, and moves by a fifth between fits that are equally good.
N_GAUGES = 12
SETS = [*(f"sim-{mix}" for mix in MIXES), "panda_3", "panda_2"]
SETS += ["ur10-goal", "ur10-space", "ur10b-space"]
# Parameters of what the linear model is made of.
IDEAS = {
    "harmonics alone": {"causes": []},
    "and gravity": {"causes": ["gravity"]},
    "and kinematics": {"causes": ["gravity", "kinematics"]},
    "the default, but no offsets": {"offsets": False},
}


def statistics(left, groups, reference):
    """Mean, half width of the interval of the mean's difference to the reference, maximum, 2S."""
    length = np.linalg.norm(left, axis=1)
    _, index = np.unique(groups, return_inverse=True)
    counts = np.bincount(index)
    two_s = 2 * np.sqrt(np.bincount(index, length**2) / np.maximum(counts - 1, 1))
    half = half_width(length - reference, groups)
    return length.mean(), half, length.max(), two_s[counts > 1].mean()


def gauge_errors(mix, seed):
    """Mean absolute error of 500 mm gauges: no correction, a model, one that knows 300 mm."""
    cone = make_single_point(10, 40, machine=mix, random_state=seed)
    gauge = make_gauge(machine=mix, random_state=seed)
    long = gauge.lengths == 500
    short = np.isin(gauge.groups, gauge.pairs[~long])
    theta = np.vstack([cone.data, gauge.data])
    y = np.vstack([cone.target, gauge.target])
    groups = np.r_[cone.groups, 100 + gauge.groups]
    known = [(100 + a, 100 + b, 300.0, 0.003) for a, b in gauge.pairs[~long]]
    errors = []
    for some, given in ((False, ()), (short, known)):
        train = np.r_[np.ones(len(cone.data), bool), some & np.ones(len(gauge.data), bool)]
        model = ArmResidualRegressor(cone.arm)
        model.fit(theta[train], y[train], groups=groups[train], lengths=given)
        for correction in (0.0, model.predict(gauge.data)):
            lengths = gauge_lengths(gauge.points - correction, gauge.groups, gauge.pairs)
            errors.append(np.abs(lengths - gauge.lengths)[long].mean())
    return errors[0], errors[1], errors[3]


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

        def about(left, groups=groups, train=train):
            return left if tracked else position_residuals(left, groups[~train])

        found = {NONE: about(y[~train])}
        for title, params in IDEAS.items() if with_ideas else ():
            if not (tracked and "offsets" in params):
                found[title] = about(learn(arm, theta, y, groups, train, **params)[1])
        model, _ = learn(arm, theta, y, groups, train)
        mean, std = model.predict(theta[~train], return_std=True, with_noise=True)
        found[MODEL] = about(y[~train] - mean)
        inside.append(np.abs(found[MODEL]) < 1.96 * std)
        for title, left in found.items():
            lefts.setdefault(title, []).append(left)
    lefts = {title: np.concatenate(parts) for title, parts in lefts.items()}
    return lefts, np.concatenate(labels), 100 * np.mean(np.concatenate(inside))


def ideas(options):
    for name in options.sets:
        lefts, groups, inside = run(name, options.rows, not options.defaults)
        reference = np.linalg.norm(lefts[NONE], axis=1)
        found = {title: statistics(left, groups, reference) for title, left in lefts.items()}
        for title, (mean, half, largest, two_s) in found.items():
            print(f"{name}, {title}: {mean:.4f} / {largest:.3f}, +- {half:.4f}, 2S {two_s:.4f}")
        print(f"{name}, inside: {inside:.1f} %", flush=True)
        if name.startswith("sim"):
            found = np.array([gauge_errors(name[4:], seed) for seed in range(N_GAUGES)])
            means, halves = found.mean(axis=0), 1.96 * found.std(axis=0, ddof=1) / N_GAUGES**0.5
            errors = ", ".join(f"{m:.4f} +- {h:.4f}" for m, h in zip(means, halves, strict=True))
            print(f"{name}, 500 mm: none, model, 300 mm known: {errors}", flush=True)


def octants(options):
    theta, points, goals = read_ur10("A")
    rows = np.random.default_rng(0).permutation(len(theta))[:2500]
    theta, points, goals = theta[rows], points[rows], goals[rows]

    def calibrated(mask):
        # One octant is what `calibrate` refuses to learn from: its poses are too much alike.
        result = calibrate(TOOLED_UR10, theta[mask], points=points[mask], accept="poses-alike")
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
                ratios.setdefault(f"{n} poses, calibrated {how}", []).append(ratio)
    for name, values in ratios.items():
        print(f"{name}: mean {np.mean(values):.2f}, worst {np.max(values):.2f} of no correction")


# -- what it may harm ----------------------------------------------------------------------------

FIRST_SEED, N_ARMS, N_CORNERS = 5000, 50, 8
N_INTERVALS = 8  # arms of each kind
# The last two have causes that the model has no column for.
MACHINES = {
    "typical": ArmErrors(),
    "gravity": ArmErrors.from_name("gravity"),
    "eccentricity": ArmErrors.from_name("eccentricity"),
    "slips": ArmErrors(slip_share=0.04, slip_mm=0.5),
    "soft": ArmErrors(softening_arcsec=15.0, runout_um=10.0),
    "play": ArmErrors(play_arcsec=8.0, drift_k=5.0),
}
POSES = 15  # at each position


def training_positions(test, number, rng):
    """Positions that are learnt, and what they are called."""
    n = len(test.simulation.positions)
    if number < N_ARMS - N_CORNERS:
        return rng.permutation(n)[: 2 * n // 3], "spread"
    side, away = list(sides(test).items())[number % 4]
    return np.argsort(away)[: n // 3], side


def one_arm(number):
    """What one arm is, and the deviation at the other positions, with over without correction."""
    rng = np.random.default_rng(FIRST_SEED + number)
    n_train = int(rng.integers(10, 21))
    n_positions = 3 * n_train if number >= N_ARMS - N_CORNERS else 3 * n_train // 2
    kind = list(MACHINES)[number % len(MACHINES)]
    tracker = number // 4 % 2 == 1
    machine, seed = MACHINES[kind], FIRST_SEED + number
    test = make_single_point(n_positions, POSES, machine=machine, random_state=seed)
    kept, where = training_positions(test, number, rng)
    y = test.points - test.simulation.true_points if tracker else test.target
    train = np.isin(test.groups, kept)
    left = learn(test.arm, test.data, y, test.groups, train)[1]
    if not tracker:
        left = position_residuals(left, test.groups[~train])
    good = ~test.simulation.slipped[~train]
    ratio = mean_deviation(left[good]) / mean_deviation(y[~train][good])
    return kind, "tracker" if tracker else "single-point", where, ratio


def harm(options):
    found = {}
    for number in range(N_ARMS - options.arms, N_ARMS):
        kind, how, where, ratio = one_arm(number)
        print(number, kind, how, where, f"{ratio:.3f}", flush=True)
        found.setdefault((how, "spread" if where == "spread" else "one corner"), []).append(ratio)
    for name, ratios in found.items():
        spread = f"median {np.median(ratios):.2f}, worst {max(ratios):.2f}"
        print(f"{len(ratios)} arms, {', '.join(name)}: {spread}")


def fields_of_place(points):
    """What depends on the place alone, (n, 3, 10): motions, scale, and what the load bends."""
    x, y, z = points.T / 1000
    nothing = np.zeros_like(x)
    fields = [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
    fields += [np.cross(axis, points / 1000) for axis in np.eye(3)]
    bends = (x, y, z), (x, y, nothing), (nothing, -y * z, y * y), (x * z, nothing, -x * x)
    return np.stack(fields + [np.column_stack(bend) for bend in bends], axis=2)


def share_inside(machine, seed, n_train):
    """Percentage of true errors within 1.96 deviations at positions left out, and these in um."""
    of_arm = {"machine": MACHINES[machine], "random_state": FIRST_SEED + seed}
    test = make_single_point(3 * n_train // 2, POSES, **of_arm)
    train = test.groups % 3 > 0
    model, _ = learn(test.arm, test.data, test.target, test.groups, train)
    mean, std = model.predict(test.data, return_std=True)
    error = mean - test.simulation.perfect_correction
    fields = fields_of_place(test.points)
    of_position = [test.groups == label for label in np.unique(test.groups[train])]
    left = np.concatenate([fields[rows].mean(axis=0) for rows in of_position])
    right = np.concatenate([error[rows].mean(axis=0) for rows in of_position])
    error = error - fields @ np.linalg.lstsq(left, right, rcond=None)[0]
    return 100 * np.mean(np.abs(error / std)[~train] < 1.96), 1000 * std[~train].mean()


def intervals(options):
    for machine in ("typical", "gravity", "eccentricity", "soft"):
        for n_train in (12, 20):
            found = [share_inside(machine, seed, n_train) for seed in range(N_INTERVALS)]
            inside, width = np.transpose(found)
            shares = np.median(inside), inside.min(), inside.mean()
            shares = ", ".join(f"{share:.0f} %" for share in shares)
            print(f"{machine}, {n_train} positions: {shares}; {width.mean():.1f} um", flush=True)


# -- other columns -------------------------------------------------------------------------------

# Name of the case: what the arm has, and the extra columns.
CASES = {
    "direction": ({"play_arcsec": 6.0}, [f"direction {j}" for j in range(1, 7)]),
    "temperature": ({"drift_k": 8.0}, ["temperature"]),
    "payload": ({"payload_n": 20.0}, ["payload"]),
}


def values_of(test, extra, rng=None):
    """The extra columns of a simulated test; drawn at random where `rng` is given."""
    n, columns = len(test.data), []
    for name in extra:
        kind, *joint = name.split()
        value = test.directions[:, int(joint[0]) - 1] if kind == "direction" else test[kind]
        if rng is not None:
            value = {
                "direction": lambda: rng.choice([-1.0, 1.0], n),
                "temperature": lambda: 20 + rng.uniform(0, 8, n),
                "payload": lambda: rng.uniform(0, 20, n),
            }[kind]()
        columns.append(value)
    return np.column_stack(columns)


def with_columns(case, seed, cause, tracker):
    """Ratio of the deviations at positions left out, with over without the columns of a case."""
    sizes, extra = CASES[case]
    errors = ArmErrors(**sizes) if cause else ArmErrors()
    test = make_single_point(12, 25, machine=errors, random_state=seed)
    values = values_of(test, extra, None if cause else np.random.default_rng(seed))
    groups, deviations = test.groups, []
    y = test.points - test.simulation.true_points
    y = y if tracker else position_residuals(test.points, groups)
    train = groups % 2 == 0
    for names, X in (([], test.data), (extra, np.hstack([test.data, values]))):
        model, left = learn(test.arm, X, y, groups, train, orders=8, extra=names)
        if tracker:
            deviations.append(mean_deviation(left))
        else:
            rest = test.points[~train] - model.predict(X[~train])
            deviations.append(single_point_repeatability(rest, groups[~train]))
    return deviations[1] / deviations[0]


def of_directions(n_rows):
    """What directions of joints are worth on the UR10, at a fifth of its goals, left out."""
    data, draws = fetch_ur10_tracker(data_home=DATA), []
    for seed in range(3):
        rng, n_goals = np.random.default_rng(seed), data.groups.max() + 1
        out = np.isin(data.groups, rng.permutation(n_goals)[: n_goals // 5])
        train = np.sort(rng.permutation(np.flatnonzero(~out))[:n_rows])
        found = calibrate(data.nominal_arm, data.data[train], points=data.tracker_points[train])
        draws.append((found, train, out))
    for n in (0, 3, 6):
        X, left = np.hstack([data.data, data.directions[:, :n]]), []
        for found, train, out in draws:
            y = found.residuals(data.data, data.tracker_points)
            names = [f"direction {joint}" for joint in range(1, n + 1)]
            model = ArmResidualRegressor(found.arm, extra=names)
            model.fit(X[train], y[train], groups=data.groups[train])
            lags = model.terms_[model.terms_["family"] == "direction"]["value"]
            deviation = mean_deviation(y[out] - model.predict(X[out]))
            left.append(f"{deviation:.4f} (lags {np.round(lags, 1)})")
        print(f"directions of {n} joints: mean deviation {', '.join(left)}", flush=True)


def extra(options):
    if options.real:
        return of_directions(options.rows or 1500)
    rows = {}
    for case, how, what in product(CASES, ("single-point", "tracker"), ("cause", "noise")):
        given = what == "cause", how == "tracker"
        ratios = [with_columns(case, seed, *given) for seed in range(options.seeds)]
        rows[f"{case}, {how}, as {what}"] = np.median(ratios), max(ratios)
    return show("deviation with the columns over without", ("median", "worst"), rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = {part.__name__: part for part in (ideas, octants, harm, intervals, extra)}
    parser.add_argument("part", choices=parts)
    parser.add_argument("sets", nargs="*", default=SETS, help=", ".join(SETS))
    parser.add_argument("--rows", type=int, help="of the UR10 (default: all, for extra 1500)")
    parser.add_argument("--defaults", action="store_true", help="only the default")
    parser.add_argument("--arms", type=int, default=N_ARMS, help="the last so many of the 50")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--real", action="store_true", help="extra columns of the UR10")
    options = parser.parse_args()
    warnings.simplefilter("ignore", UserWarning)  # of what fades, and of lengths that disagree
    parts[options.part](options)


if __name__ == "__main__":
    main()
