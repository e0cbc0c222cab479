"""What a harmonic should cost: rules of its order, on simulated arms only.

    python benchmarks/bench_prices.py
    python benchmarks/bench_prices.py --field

Single-point tests of three kinds of measuring arms, learnt at 6, 9 and 16 positions and used at
8 others; robots with gears, learnt at 60, 120 and 300 poses and used at 500 others. Printed is, for
each rule and kind, the geometric mean of what it leaves over what the first rule leaves.

``--field``: the price of all low orders together as one smooth function, also on arms whose
encoders err by straight pieces between the knots of a table.
"""

import argparse
import warnings

import numpy as np
from _arm_folds import MIXES, scatter
from _arm_folds import mean_deviation as deviation
from bench_after_the_lab import Robot

import sklearn_raacmm.error_model._fit as structures
from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate
from sklearn_raacmm.datasets import make_single_point


def stepped(order):
    """Nothing up to order 2, the odds of 432 up to 72, 10 nats more above."""
    return np.where(order <= 2, 0.0, np.where(order <= 72, np.log(432), np.log(432) + 10))


RULES = {
    "0, 6 and 16 nats": stepped,
    "flat log(2400)": lambda order: np.full(len(order), np.log(2400)),
    "1.5 log k": lambda order: 1.5 * np.log(order),
    "2 log k": lambda order: 2 * np.log(order),
    "2.5 log k": lambda order: 2.5 * np.log(order),
    "2 log k/2": lambda order: 2 * np.log(np.maximum(order / 2, 1)),
    "2.5 log k/2": lambda order: 2.5 * np.log(np.maximum(order / 2, 1)),
    "3 log k/2": lambda order: 3 * np.log(np.maximum(order / 2, 1)),
}
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
    return found.arm, (angles, found.residuals_mm, {}), lambda m: deviation(true - m.predict(far))


def pieces(seed, n_poses):
    """The same of an arm whose encoders err by straight pieces between 41 knots."""
    arm, rng = Arm.from_name("aacmm6"), np.random.default_rng([13, seed])
    knots, tables = np.linspace(-np.pi, np.pi, 41), np.deg2rad(rng.normal(0, 8 / 3600, (6, 41)))

    def errors(angles):
        found = [np.interp(q, knots, table) for q, table in zip(angles.T, tables, strict=True)]
        return np.einsum("nij,jn->ni", arm.jacobian(angles), found)

    angles, far = rng.uniform(-2.5, 2.5, (n_poses, 6)), rng.uniform(-2.5, 2.5, (500, 6))
    y, true = errors(angles) + rng.normal(0, 0.01, (n_poses, 3)), errors(far)
    return arm, (angles, y, {}), lambda m: deviation(true - m.predict(far))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--field", action="store_true", help="prices of the field instead")
    options = parser.parse_args()
    seeds = range(options.seeds)
    warnings.simplefilter("ignore")
    kinds = {
        f"{mix} {n}": [single_point(mix, seed, n) for seed in seeds]
        for mix in MIXES
        for n in (6, 9, 16)
    }
    kinds |= {f"gears {n}": [tracked(s % 3, s, n) for s in seeds] for n in (60, 120, 300)}
    kinds |= {f"pieces {n}": [pieces(s, n) for s in seeds] for n in (150, 500) * options.field}
    name = "_PRICE_OF_FIELD" if options.field else "order_price"
    first, rules = None, FIELD_PRICES if options.field else RULES
    for title, rule in rules.items():
        setattr(structures, name, rule)
        logs = []
        for draws in kinds.values():
            left = [
                of(ArmResidualRegressor(arm).fit(X, y, **given)) for arm, (X, y, given), of in draws
            ]
            logs.append(np.mean(np.log(left)))
        first = logs if first is None else first
        ratios = np.exp(np.subtract(logs, first))
        cells = ", ".join(f"{kind} {value:.3f}" for kind, value in zip(kinds, ratios, strict=True))
        whole = np.exp(np.mean(np.subtract(logs, first)))
        print(f"{title}: {cells}; all {whole:.4f}", flush=True)


if __name__ == "__main__":
    main()
