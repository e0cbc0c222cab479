"""What the choice of poses by :func:`next_poses` is worth on a real robot, against chance.

Three tasks on the series of a UR10: to register the model of 3000 poses of series A on series B, to
calibrate the nominal table on series A, and to fit a model to series A with 80 poses known before.
Poses are chosen from some candidates, or drawn from them; the mean deviation at 1000 other poses of
the same series is printed, the mean of several draws of the candidates.

With ``--first`` a first test of 8 cones with 12 poses each, on simulated arms: mean 2S at 8 other
cones where cones and poses come by chance, where the cones are spread and poses come by chance, and
as :func:`plan_poses` has them. The other cones have poses by chance, or those of another plan.

Run it with ``python benchmarks/bench_next_poses.py`` (two minutes). The data are downloaded, or
read from the folder that SKLEARN_RAACMM_DATA names.
"""

import argparse
import os
import time
import warnings
from pathlib import Path

import numpy as np
from bench_after_the_lab import mean_deviation, read

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, next_poses, plan_poses
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

NOMINAL = Arm.from_name("ur10", probe=(0, 0, 93))
TABLE = ["base", "probe", "a", "alpha", "d", "theta_offset"]


class Task:
    """One series: candidates, the poses to judge by, and what is done with those chosen."""

    def __init__(self, data, n_candidates, n_known, seed):
        self.angles, self.points = data
        order = np.random.default_rng(seed).permutation(len(self.angles))
        self.known, rest = order[:n_known], order[n_known:]
        self.candidates, self.others = rest[:n_candidates], rest[n_candidates:][:1000]

    def registered(self, model, rows):
        """Mean deviation after a registration through the model."""
        data = {"points": self.points[rows], "free": ["probe"], "correction": model}
        found = calibrate(model.arm_, self.angles[rows], **data)
        true = found.residuals(self.angles[self.others], self.points[self.others])
        return mean_deviation(true - model.predict(self.angles[self.others]))

    def calibrated(self, _, rows):
        """Mean deviation after a calibration of all fields."""
        found = calibrate(NOMINAL, self.angles[rows], points=self.points[rows])
        return mean_deviation(found.residuals(self.angles[self.others], self.points[self.others]))

    def learned(self, _, rows):
        """Mean deviation after a fit to the known poses and these."""
        rows = np.r_[self.known, rows]
        found, model = self.fit(rows)
        true = found.residuals(self.angles[self.others], self.points[self.others])
        return mean_deviation(true - model.predict(self.angles[self.others]))

    def fit(self, rows):
        """Calibration of some poses, and the model of what it leaves."""
        found = calibrate(NOMINAL, self.angles[rows], points=self.points[rows])
        return found, ArmResidualRegressor(found.arm).fit(self.angles[rows], found.residuals_mm)


def compare(name, task_of, n, use, choose, n_chance, draws):
    """Print the deviation with the poses chosen and with others drawn."""
    chosen, chance = [], []
    for seed in range(draws):
        task = task_of(seed)
        at = choose(task, task.angles[task.candidates], n)
        chosen.append(use(task, task.candidates[at]))
        rng = np.random.default_rng([1, seed])
        drawn = [rng.choice(task.candidates, n, replace=False) for _ in range(n_chance)]
        chance.append(np.mean([use(task, rows) for rows in drawn]))
    better = np.sum(np.less(chosen, chance))
    print(
        f"{name:34}{np.mean(chosen):8.3f}{np.mean(chance):10.3f}   better in {better} of {draws}",
        flush=True,
    )


def first_tests(n_arms):
    """2S in um at cones that were not learnt, of each way to choose a first test."""
    ways = {"by chance": [], "spread cones": [], "planned": []}

    def read(machine, poses, plan, seed):
        rng, cones = np.random.RandomState(seed), plan.positions[plan.groups - 1]
        cones = cones + machine.errors.seating_um / 1000 * rng.normal(size=cones.shape)
        return machine.read(machine.solve(poses, cones), rng), plan.groups

    for seed in range(n_arms):
        machine = SimulatedArm("typical", random_state=seed)
        plan, other = (
            plan_poses(machine.nominal_arm, 8, n, random_state=s) for n, s in ((12, seed), (25, 99))
        )
        chance = make_single_point(8, 12, machine=machine, random_state=seed)
        spread = np.concatenate([machine.find_poses(place, 12, seed) for place in plan.positions])
        far = make_single_point(8, 25, machine=machine, random_state=1000 + seed)
        judged = (far.data, far.groups), read(machine, other.angles, other, 1)
        tests = (
            (chance.data, chance.groups), read(machine, spread, plan, 2),
            read(machine, plan.angles, plan, 2),
        )  # fmt: skip
        for name, (angles, labels) in zip(ways, tests, strict=True):
            found = calibrate(machine.nominal_arm, angles, labels)
            model = ArmResidualRegressor(found.arm)
            model.fit(angles, found.residuals_mm, groups=labels)
            ways[name].append([
                1000 * single_point_repeatability(found.arm.forward(q) - model.predict(q), groups)
                for q, groups in judged
            ])  # fmt: skip
    print("2S in um at other cones: with poses by chance, and planned")
    for name, values in ways.items():
        print(f"{name:14} {np.mean(values, axis=0).round(1)}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--first", type=int, default=0, metavar="ARMS", help="first tests only")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.first:
        return first_tests(options.first)
    start = time.process_time()
    root = os.environ.get("SKLEARN_RAACMM_DATA", Path.home() / "scikit_learn_data")
    series = {name: read(name, Path(root) / "ur10_tracker") for name in "AB"}
    first = Task(series["A"], 0, 3000, 0)
    model = first.fit(first.known)[1]
    print(f"{'task':34}{'chosen':>8}{'by chance':>10}")

    def registration(task, candidates, n):
        return next_poses(model, candidates, n, free=["base", "probe"])[0]

    def calibration(task, candidates, n):
        return next_poses(NOMINAL, candidates, n, free=TABLE)[0]

    def for_model(task, candidates, n):
        return next_poses(task.fit(task.known)[1], candidates, n)[0]

    for n in (6, 12):
        compare(
            f"register with {n} of 400", lambda seed: Task(series["B"], 400, 0, seed), n,
            lambda task, rows: task.registered(model, rows), registration, 4, options.draws,
        )  # fmt: skip
    for n in (20, 40):
        compare(
            f"calibrate with {n} of 600", lambda seed: Task(series["A"], 600, 0, seed), n,
            lambda task, rows: task.calibrated(model, rows), calibration, 4, options.draws,
        )  # fmt: skip
    compare(
        "learn from 60 of 920 beside 80", lambda seed: Task(series["A"], 920, 80, seed), 60,
        lambda task, rows: task.learned(model, rows), for_model, 2, options.draws,
    )  # fmt: skip
    for what, free in (("registration", ["base", "probe"]), ("model of 3000 poses", None)):
        begin = time.process_time()
        next_poses(model, series["A"][0][:1000], 20, free=free)
        print(f"20 of 1000 for a {what}: {time.process_time() - begin:.2f} s")
    print(f"{time.process_time() - start:.0f} s of processor time")


if __name__ == "__main__":
    main()
