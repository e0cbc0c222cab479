"""What a correction is worth where poses or placements are few, and what its columns should cost.

    python benchmarks/bench_few_poses.py --gears

Of thinned real Pandas some placements are drawn, and of their rows some, to learn from; the other
placements are left out. Printed is, by the number of placements, what is left of the deviation over
that without correction (geometric mean, worst draw), the share inside intervals of 95 %, and how
often the model decided for no correction.

``--gears``: single-point tests of simulated arms with a gear at one joint, every other position
left out. ``--narrow``: simulated arms in narrow ranges of their joints, 300 poses before a tracker.
Calibration has taken the easy directions out of what is left, which is where a search of the
families' variances can stay at zero. ``--constants``: deviations from the mean, the median, the
first or the last row of each position, and constants added to the errors of a tracker; 2S at eight
other positions, and of the tracker's arms the mean deviation from the truth, mm. ``--prices``: of a
harmonic by its order; measuring arms learnt at 6, 9 and 16 positions and robots with gears at 60,
120 and 300 poses; geometric mean of what a rule leaves elsewhere over what the first leaves.
``--field``: of all low orders together, also on arms whose encoders err by straight pieces.
``--paths``: robots on four paths of ten segments before a tracker. Every fifth segment is left out,
then whole paths: mean deviation, mm, without correction, with all of it, as used; inside 95 %.
``--stations``: simulated arms that a tracker sees at 18 positions, a third of them from each of
three stations, by how often the bases are found through a model: root mean square deviation at ten
other positions, um; last, of one station.
``--shares``: simulated arms learnt in 4 and in 8 cones of 15 poses. By the power of the number of
positions that what is wrong falls with: 2S at eight other cones over that at a power of 0.
"""

import argparse
import warnings
from itertools import product

import _one_thread  # noqa: F401
import numpy as np
from _arm_folds import (
    ARCSEC,
    MIXES,
    MOVED,
    NOMINAL_PANDA,
    geometric,
    learn,
    learn_tracked,
    mean_deviation,
    pairs_known,
    read_panda,
    scatter,
)
from bench_after_the_lab import Robot, cone_test, fitted, left_um
from scipy.spatial.transform import Rotation

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    calibrate,
    learn_correction,
    position_residuals,
)
from sklearn_raacmm.correction import _one_fit
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.error_model import _fit, _left_out
from sklearn_raacmm.metrics import single_point_repeatability
from sklearn_raacmm.utils import align

SETS = ("panda_2", "panda_3", "panda_6", "panda_7")
PLACEMENTS, ROWS, DRAWS = (1, 2, 3, 4), (60, 120, 200), 2
GEARS, GEAR_ARCSEC = (100, 120, 160, 200, 240), 8.0
LEAST_TEETH = 30  # gears are sought above: wobble and eccentricity have the orders below
NOISE_MM, N_OTHERS = 0.01, 400
SOURCES = ("eccentricity", "torsion", "sag", "wobble", "runout")
FROM = {
    "mean": lambda y: y.mean(axis=0),
    "median": lambda y: np.median(y, axis=0),
    "first row": lambda y: y[0],
    "last row": lambda y: y[-1],
}
CONSTANTS_MM = (0.0, 0.002, 0.004, 0.008, 0.05)
N_PATHS, SEGMENTS, OF_SEGMENT = 4, 10, 12
POWERS = (0, 2, 4, 6)


def panda_fit(angles, sockets, train):
    """Calibrate a Panda on some rows, those with a socket of their own left out, and fit a model.

    Returns it and the residuals of all rows.
    """
    used, counts = np.unique(sockets[train], return_counts=True)
    train = train[np.isin(sockets[train], used[counts > 1])]
    here = set(sockets[train])
    both = [p for p in {s.rpartition("/")[0] for s in here} if {f"{p}/0", f"{p}/1"} <= here]
    lengths = pairs_known(sorted(both))
    arm = calibrate(NOMINAL_PANDA, angles[train], sockets[train], lengths=lengths, **MOVED).arm
    y = position_residuals(arm.forward(angles), sockets)
    own = position_residuals(arm.forward(angles[train]), sockets[train])
    return ArmResidualRegressor(arm).fit(angles[train], own, groups=sockets[train]), y


def pandas():
    found = {}
    for name in SETS:
        angles, sockets, placements = read_panda(name)
        labels = np.unique(placements)
        most = len(labels) - 1
        for k in sorted({k for k in (*PLACEMENTS, most) if k <= most}):
            for n, draw in product(ROWS, range(DRAWS)):
                rng = np.random.default_rng([k, n, draw])
                inside = np.isin(placements, rng.permutation(labels)[:k])
                some = rng.permutation(np.flatnonzero(inside))
                if len(some) < 0.8 * n and n > min(ROWS):  # would be the smaller case again
                    continue
                model, y = panda_fit(angles, sockets, some[:n])
                mean, std = model.predict(angles[~inside], return_std=True, with_noise=True)
                left = position_residuals(y[~inside] - mean, sockets[~inside])
                ratio = mean_deviation(left) / mean_deviation(y[~inside])
                row = ratio, np.mean(np.abs(left) < 1.96 * std), not model.helps_
                found.setdefault(min(k, 4), []).append(row)
    print("placements, draws: left of no correction (worst); inside (least); refused")
    for k, rows in sorted(found.items()):
        ratios, inside, refused = np.transpose(rows)
        share = f"{inside.mean():.2f} ({inside.min():.2f})"
        print(f"{k}, {len(rows)}: {geometric(ratios)}; {share}; {refused.sum():.0f}")


def gears(n_arms):
    ratios, hits, false = [], 0, 0
    for seed in range(n_arms):
        rng = np.random.default_rng([9, seed])
        test = make_single_point(int(rng.choice([6, 8, 12])), 16, random_state=seed)
        joint, gear = int(rng.integers(6)), int(rng.choice(GEARS))
        turns, phase = np.zeros_like(test.data), rng.uniform(0, 2 * np.pi)
        turns[:, joint] = GEAR_ARCSEC * ARCSEC * np.cos(gear * test.data[:, joint] - phase)
        moved = np.einsum("nij,nj->ni", test.arm.jacobian(test.data), turns)
        y = position_residuals(test.points + moved, test.groups)
        train = test.groups % 2 == 0
        model, left = learn(test.arm, test.data, y, test.groups, train)
        ratios.append(scatter(left, test.groups[~train]) / mean_deviation(y[~train]))
        high = model.harmonics_[model.harmonics_["order"] > LEAST_TEETH]
        right = (high["joint"] == joint + 1) & (high["order"] == gear)
        hits, false = hits + right.sum(), false + (~right).sum()
    print(f"of no correction {geometric(ratios)}; {hits} of {n_arms} gears found, {false} false")


def narrow(n_draws, n_poses=300, width=0.25):
    ratios = []
    for seed in range(n_draws):
        rng = np.random.default_rng([21, seed])
        machine = SimulatedArm("gravity", random_state=seed)
        centre = np.array([0.0, -0.9, 0.0, 1.4, 0.0, 0.6]) + rng.uniform(-0.4, 0.4, 6)
        near, far = (centre + rng.uniform(-width, width, (n, 6)) for n in (n_poses, N_OTHERS))

        def points(angles, machine=machine):
            off = machine.deviations(angles)
            return machine.true_arm.forward(angles) + sum(off[name] for name in SOURCES)

        measured = points(near) + rng.normal(0, NOISE_MM, (n_poses, 3))
        found, model = learn_tracked(machine.nominal_arm, near, measured)
        y = found.residuals(far, points(far))
        ratio, size = mean_deviation(y - model.predict(far)) / mean_deviation(y), mean_deviation(y)
        ratios.append(ratio)
        sizes = " ".join(f"{name} {sd:.3g}" for name, sd in model.prior_sd_.items())
        print(f"{seed:3} left {ratio:.3f} of {size:.4f} mm; arc seconds: {sizes}", flush=True)
    print(f"{n_draws} arms: {geometric(ratios)}, gained in {np.sum(np.less(ratios, 1))}")


def constants(draws):
    for mix, seed in product(MIXES, range(draws)):
        test = make_single_point(20, 15, machine=mix, random_state=seed)
        train = test.groups < 12
        for name, origin in FROM.items():
            y = test.points.copy()
            for group in np.unique(test.groups):
                rows = test.groups == group
                y[rows] -= origin(y[rows])
            model, _ = learn(test.arm, test.data, y, test.groups, train)
            left = test.points[~train] - model.predict(test.data[~train])
            left = single_point_repeatability(left, test.groups[~train])
            print(f"{mix}, deviations from {name}: {left:.4f}", flush=True)
        truth = test.points - test.simulation.true_points
        moved = np.random.default_rng(seed).normal(size=(20, 3))[test.groups]
        for size in CONSTANTS_MM:
            model, _ = learn(test.arm, test.data, truth + size * moved, test.groups, train)
            left = mean_deviation(truth[~train] - model.predict(test.data[~train]))
            print(f"{mix}, constants of {size:g} mm: {left:.4f}", flush=True)


def path(rng):
    """Poses along a smooth way between two neighbouring poses, with a bend in every joint."""
    ends = rng.uniform(-1.5, 1.5, 6) + rng.uniform(-0.6, 0.6, (2, 6))
    way = np.linspace(0, 1, SEGMENTS * OF_SEGMENT)[:, None]
    bend = rng.normal(0, 0.2, (3, 6))
    waves = np.sin(np.pi * way * np.arange(1, 4)) @ bend
    return (1 - way) * ends[0] + way * ends[1] + waves


def paths(n_robots):
    segment = np.repeat(np.arange(N_PATHS * SEGMENTS), OF_SEGMENT)
    folds = {"segments": (segment % SEGMENTS) % 5, "paths": segment // SEGMENTS}
    found = {name: [] for name in folds}
    for seed in range(n_robots):
        robot, rng = Robot(seed % 3, 700 + seed), np.random.default_rng([41, seed])
        robot.cross *= 3  # what no column describes
        angles = np.concatenate([path(rng) for _ in range(N_PATHS)])
        points = robot.measure(angles, rng, NOISE_MM)
        for name, fold in folds.items():
            left, inside = [], []
            for out in (fold == k for k in np.unique(fold)):
                found_arm = calibrate(robot.nominal, angles[~out], points=points[~out])
                model = ArmResidualRegressor(found_arm.arm)
                model.fit(angles[~out], found_arm.residuals_mm, groups=segment[~out])
                y = found_arm.residuals(angles[out], points[out])
                mean, std = model.predict(angles[out], return_std=True, with_noise=True)
                whole = model.linear_model_.predict(angles[out])[0]
                left.append([mean_deviation(rest) for rest in (y, y - whole, y - mean)])
                inside.append(np.mean(np.abs(y - mean) < 1.96 * std))
            found[name].append([*np.mean(left, axis=0), np.mean(inside)])
            cells = " ".join(f"{value:.4f}" for value in found[name][-1])
            print(f"{seed:3} {name}: {cells}", flush=True)
    for name, rows in found.items():
        none, whole, used, inside = np.transpose(rows)
        print(f"{name} left out, of all of it: {geometric(used / whole)}; of none: ", end="")
        print(f"{geometric(used / none)}; inside {inside.mean():.3f} ({inside.min():.2f})")


def stepped(order):
    """Nothing up to order 2, the odds of 432 up to 72, 10 nats more above."""
    return np.where(order <= 2, 0.0, np.where(order <= 72, np.log(432), np.log(432) + 10))


def per_log(factor, start=1):
    """So many nats per logarithm of the order over a start."""
    return lambda order: factor * np.log(np.maximum(order / start, 1))


RULES = {
    "0, 6 and 16 nats": stepped,
    "flat log(2400)": lambda order: np.full(len(order), np.log(2400)),
}
RULES |= {f"{factor:g} log k": per_log(factor) for factor in (1.5, 2, 2.5)}
RULES |= {f"{factor:g} log k/2": per_log(factor, 2) for factor in (2, 2.5, 3)}
FIELD_PRICES = {f"{price:g} nats": price for price in (1e9, 0.0, 4.0, 8.0, 16.0, 32.0, 64.0)}


def single_point(mix, seed, n_positions):
    """Training data at some positions, and what a prediction leaves at 8 others."""
    test = make_single_point(24, 15, machine=mix, random_state=3000 + seed)
    train, other = test.groups < n_positions, test.groups >= 16
    fit = test.data[train], test.target[train], {"groups": test.groups[train]}

    def left(model):
        rest = test.target[other] - model.predict(test.data[other])
        return scatter(rest, test.groups[other])

    return test.arm, fit, left


def tracked(make, seed, n_poses):
    """The same of a robot with gears."""
    robot, rng = Robot(make, 900 + seed), np.random.default_rng([11, make, seed])
    angles, far = rng.uniform(-2, 2, (n_poses, 6)), rng.uniform(-2, 2, (500, 6))
    found = calibrate(robot.nominal, angles, points=robot.measure(angles, rng))
    true = found.residuals(far, robot.measure(far, rng, 0.0))
    fit = angles, found.residuals_mm, {}
    return found.arm, fit, lambda model: mean_deviation(true - model.predict(far))


def pieces(seed, n_poses):
    """The same of an arm whose encoders err by straight pieces between 41 knots."""
    arm, rng = Arm.from_name("aacmm6"), np.random.default_rng([13, seed])
    knots, tables = np.linspace(-np.pi, np.pi, 41), np.deg2rad(rng.normal(0, 8 / 3600, (6, 41)))

    def errors(angles):
        found = [np.interp(q, knots, table) for q, table in zip(angles.T, tables, strict=True)]
        return np.einsum("nij,jn->ni", arm.jacobian(angles), found)

    angles, far = rng.uniform(-2.5, 2.5, (n_poses, 6)), rng.uniform(-2.5, 2.5, (500, 6))
    y, true = errors(angles) + rng.normal(0, 0.01, (n_poses, 3)), errors(far)
    return arm, (angles, y, {}), lambda m: mean_deviation(true - m.predict(far))


def prices(of_field, draws):
    seeds = range(draws)
    kinds = {
        f"{mix} {n}": [single_point(mix, seed, n) for seed in seeds]
        for mix in MIXES
        for n in (6, 9, 16)
    }
    kinds |= {f"gears {n}": [tracked(s % 3, s, n) for s in seeds] for n in (60, 120, 300)}
    kinds |= {f"pieces {n}": [pieces(s, n) for s in seeds] for n in (150, 500) * of_field}
    first, rules = None, FIELD_PRICES if of_field else RULES
    for title, rule in rules.items():
        setattr(_fit, "_PRICE_OF_FIELD" if of_field else "order_price", rule)
        logs = []
        for of_kind in kinds.values():
            models = [ArmResidualRegressor(arm).fit(X, y, **g) for arm, (X, y, g), _ in of_kind]
            left = [of(model) for model, (_, _, of) in zip(models, of_kind, strict=True)]
            logs.append(np.mean(np.log(left)))
        first = logs if first is None else first
        ratios = np.exp(np.subtract(logs, first))
        cells = ", ".join(f"{kind} {value:.3f}" for kind, value in zip(kinds, ratios, strict=True))
        whole = np.exp(np.mean(np.subtract(logs, first)))
        print(f"{title}: {cells}; all {whole:.4f}", flush=True)


def stations(draws):
    """What is left where the base of each of three stations is found through a model, or not."""
    found = {}
    for seed in range(600, 600 + draws):
        machine, rng = SimulatedArm("typical", random_state=seed), np.random.default_rng(seed)
        test = make_single_point(18, 15, machine=machine, random_state=seed)
        new = make_single_point(10, 20, machine=machine, random_state=seed + 1000)
        points = test.simulation.true_points + rng.normal(0, NOISE_MM, test.points.shape)
        station, seen = test.groups % 3, np.empty_like(points)
        for s in range(3):
            turn, shift = Rotation.from_rotvec(rng.normal(0, 0.3, 3)), rng.normal(0, 800, 3)
            seen[station == s] = turn.apply(points[station == s]) + shift

        def left(measured, new=new, test=test, nominal=machine.nominal_arm, **given):
            learned = learn_correction(nominal, test.data, test.groups, measured, **given)
            corrected = learned.correct(new.data)[0]
            rotation, shift = align(new.simulation.true_points, corrected)
            off = corrected - new.simulation.true_points @ rotation.T - shift
            return 1000 * np.sqrt(np.square(off).sum(axis=1).mean())

        for rounds in (0, 1, 2, 3):
            _one_fit._ROUNDS_OF_STATIONS = rounds
            found.setdefault(f"{rounds} times", []).append(left(seen, stations=station))
        found.setdefault("one station", []).append(left(points))
    for name, values in found.items():
        print(f"{name}: mean {np.mean(values):.1f}, worst {max(values):.1f}")


def shares(n_arms):
    found = {}
    for seed, n in product(range(300, 300 + n_arms), (4, 8)):
        machine = SimulatedArm(MIXES[seed % len(MIXES)], random_state=seed)
        first, others = cone_test(machine, seed, n, 15), cone_test(machine, 1000 + seed, 8, 20)
        for power in POWERS:
            _left_out._POWER = power
            left = left_um(*fitted(machine.nominal_arm, *first), *others)
            found.setdefault((n, power), []).append(left)
    for (n, power), left in found.items():
        print(f"{n} cones, power {power}: {geometric(np.divide(left, found[n, POWERS[0]]))}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    which = parser.add_mutually_exclusive_group()
    for name in ("gears", "narrow", "constants", "prices", "field", "paths", "stations", "shares"):
        which.add_argument(f"--{name}", action="store_true")
    words = "20 arms, 1 of constants, 6 of prices, of paths, of shares, 4 of stations"
    parser.add_argument("--draws", type=int, help=words)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.gears or options.narrow:
        (gears if options.gears else narrow)(options.draws or 20)
    elif options.paths:
        paths(options.draws or 6)
    elif options.shares:
        shares(options.draws or 6)
    elif options.stations:
        stations(options.draws or 4)
    elif options.constants:
        constants(options.draws or 1)
    elif options.prices or options.field:
        prices(options.field, options.draws or 6)
    else:
        pandas()


if __name__ == "__main__":
    main()
