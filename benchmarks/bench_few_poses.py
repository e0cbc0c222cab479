"""What a correction is worth where poses or placements are few.

    python benchmarks/bench_few_poses.py
    python benchmarks/bench_few_poses.py --gears
    python benchmarks/bench_few_poses.py --narrow
    python benchmarks/bench_few_poses.py --constants

Of thinned real Pandas some placements are drawn, and of their rows some, to learn from; the other
placements are left out. Printed is, by the number of placements, what is left of the deviation over
that without correction (geometric mean, worst draw), the share inside intervals of 95 %, and how
often the model decided for no correction.

``--gears``: single-point tests of simulated arms with a gear at one joint, every other position
left out. ``--narrow``: simulated arms in narrow ranges of their joints, 300 poses before a tracker.
Calibration has taken the easy directions out of what is left, which is where a search of the
families' variances can stay at zero.

``--constants``: deviations from the mean, the median, the first or the last row of each position,
and constants added to the errors of a tracker; printed is what the model leaves at eight other
positions, mm: 2S, and of the tracker's arms the mean deviation from the truth.
"""

import argparse
import warnings

import _one_thread  # noqa: F401
import numpy as np
from _arm_folds import (
    ARCSEC,
    MIXES,
    NOMINAL_PANDA,
    geometric,
    learn,
    learn_tracked,
    mean_deviation,
    pairs_known,
    read_panda,
    scatter,
)

from sklearn_raacmm import ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

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


def panda_fit(angles, sockets, train):
    """Calibrate a Panda on some rows, those with a socket of their own left out, and fit a model.

    Returns it and the residuals of all rows.
    """
    used, counts = np.unique(sockets[train], return_counts=True)
    train = train[np.isin(sockets[train], used[counts > 1])]
    here = set(sockets[train])
    both = [p for p in {s.rpartition("/")[0] for s in here} if {f"{p}/0", f"{p}/1"} <= here]
    lengths = pairs_known(sorted(both))
    arm = calibrate(NOMINAL_PANDA, angles[train], sockets[train], lengths=lengths).arm
    y = position_residuals(arm.forward(angles), sockets)
    own = position_residuals(arm.forward(angles[train]), sockets[train])
    return ArmResidualRegressor(arm).fit(angles[train], own, groups=sockets[train]), y


def pandas():
    """Print a line for each number of placements."""
    found = {}
    for name in SETS:
        angles, sockets, placements = read_panda(name)
        labels = np.unique(placements)
        most = len(labels) - 1
        for k in sorted({k for k in (*PLACEMENTS, most) if k <= most}):
            for n, draw in ((n, draw) for n in ROWS for draw in range(DRAWS)):
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
    """Print what is left on simulated arms, gears found, and high orders that are none."""
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
    """One line a draw: what is left, and the deviations that the families were given."""
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


def twenty_positions(mix, seed):
    """A simulated test, and its rows at twelve positions."""
    test = make_single_point(20, 15, machine=mix, random_state=seed)
    return test, test.groups < 12


def constants(draws):
    """Deviations from something else than the mean, and small constants."""
    drawn = [(mix, seed) for mix in MIXES for seed in range(draws)]
    for mix, seed in drawn:
        test, train = twenty_positions(mix, seed)
        for name, origin in FROM.items():
            y = test.points.copy()
            for group in np.unique(test.groups):
                rows = test.groups == group
                y[rows] -= origin(y[rows])
            model, _ = learn(test.arm, test.data, y, test.groups, train)
            left = test.points[~train] - model.predict(test.data[~train])
            left = single_point_repeatability(left, test.groups[~train])
            print(f"{mix}, deviations from {name}: {left:.4f}", flush=True)
    for mix, seed in drawn:
        test, train = twenty_positions(mix, seed)
        truth = test.points - test.simulation.true_points
        moved = np.random.default_rng(seed).normal(size=(20, 3))[test.groups]
        for size in CONSTANTS_MM:
            model, _ = learn(test.arm, test.data, truth + size * moved, test.groups, train)
            left = mean_deviation(truth[~train] - model.predict(test.data[~train]))
            print(f"{mix}, constants of {size:g} mm: {left:.4f}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    which = parser.add_mutually_exclusive_group()
    for name in ("gears", "narrow", "constants"):
        which.add_argument(f"--{name}", action="store_true")
    parser.add_argument("--draws", type=int, help="20 arms, 1 of constants")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.gears or options.narrow:
        (gears if options.gears else narrow)(options.draws or 20)
    elif options.constants:
        constants(options.draws or 1)
    else:
        pandas()


if __name__ == "__main__":
    main()
