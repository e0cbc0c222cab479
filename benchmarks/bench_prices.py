"""What a harmonic should cost: rules of its order, on simulated arms only.

    python benchmarks/bench_prices.py

Single-point tests of three kinds of measuring arms, learnt at 6, 9 and 16 positions and used at
8 others; robots with gears, measured by a tracker at 60, 120 and 300 poses and used at 500 others.
Each line is a rule; each column the geometric mean over the draws of a kind of what the rule leaves
of the deviation, over what the first rule leaves.
"""

import argparse
import warnings

import numpy as np
from bench_transfer import Robot, deviation

import sklearn_raacmm.error_model._structures as structures
from sklearn_raacmm import ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import make_single_point


def stepped(order):
    """Nothing up to order 2, the odds of 432 up to 72, 10 nats more above."""
    return np.where(order <= 2, 0.0, np.where(order <= 72, np.log(432), np.log(432) + 10))


RULES = {
    "0, 6 and 16 nats": stepped,
    "flat log(2400)": lambda order: np.full(len(order), np.log(2400)),
    "1 log k": lambda order: np.log(order),
    "1.5 log k": lambda order: 1.5 * np.log(order),
    "2 log k": lambda order: 2 * np.log(order),
    "2.5 log k": lambda order: 2.5 * np.log(order),
    "3 log k": lambda order: 3 * np.log(order),
    "4 log k": lambda order: 4 * np.log(order),
}


def single_point(mix, seed, n_positions):
    """Training data at some positions, and what a prediction leaves at 8 others."""
    test = make_single_point(24, 15, machine=mix, random_state=3000 + seed)
    train, other = test.groups < n_positions, test.groups >= 16
    fit = test.data[train], test.target[train], {"groups": test.groups[train]}

    def left(model):
        rest = test.target[other] - model.predict(test.data[other])
        return deviation(position_residuals(rest, test.groups[other]))

    return test.arm, fit, left


def tracked(make, seed, n_poses):
    """The same of a robot with gears."""
    robot, rng = Robot(make, 900 + seed), np.random.default_rng([11, make, seed])
    angles, far = rng.uniform(-2, 2, (n_poses, 6)), rng.uniform(-2, 2, (500, 6))
    found = calibrate(robot.nominal, angles, points=robot.measure(angles, rng))
    true = found.residuals(far, robot.measure(far, rng, 0.0))
    return found.arm, (angles, found.residuals_mm, {}), lambda m: deviation(true - m.predict(far))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6)
    seeds = range(parser.parse_args().seeds)
    warnings.simplefilter("ignore")
    kinds = {
        f"{mix} {n}": [single_point(mix, seed, n) for seed in seeds]
        for mix in ("typical", "gravity", "eccentricity")
        for n in (6, 9, 16)
    }
    kinds |= {f"gears {n}": [tracked(s % 3, s, n) for s in seeds] for n in (60, 120, 300)}
    first = None
    print(f"{'':18}" + "".join(f"{name.replace('eccentricity', 'ecc.'):>12}" for name in kinds))
    for name, rule in RULES.items():
        structures.order_price = rule
        logs = np.array([
            np.mean([
                np.log(left(ArmResidualRegressor(arm).fit(X, y, **options)))
                for arm, (X, y, options), left in draws
            ])
            for draws in kinds.values()
        ])  # fmt: skip
        first = logs if first is None else first
        cells = "".join(f"{value:12.3f}" for value in np.exp(logs - first))
        print(f"{name:18}{cells}   all {np.exp(np.mean(logs - first)):.4f}", flush=True)


if __name__ == "__main__":
    main()
