"""A new arm of a make of which earlier arms have been measured: what their models are worth.

Simulated robots of one make share the orders and about the size of their gears' errors, the
compliance of their joints and a part of what no column describes; eccentricities, phases and the
table are the individual's own. Models of four of them, of 600 poses each, are the start for a new
one that is measured at few poses. The misleading make has other gears, hardly any eccentricity and
compliances of the other sign. Mean deviation at 500 other poses, all against a tracker.

Measuring arms of one make are simulated, too, by :class:`SimulatedArm` in single-point tests; and
with ``--panda`` one real Panda is the start for the other one, some of its placements being known.

Run it with ``python benchmarks/bench_transfer.py --panda`` (three minutes).
"""

import argparse
import os
import time
import warnings
from pathlib import Path

import numpy as np
from _arm_folds import arm_model
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, calibrate
from sklearn_raacmm.correction._transfer import transferred_model
from sklearn_raacmm.datasets import fetch_panda_ball_socket, make_single_point
from sklearn_raacmm.residuals import position_residuals

ARCSEC = np.pi / 180 / 3600
NOISE_MM = 0.03
RATIOS = (50, 80, 100, 101, 120, 128, 160)


class Robot:
    """An individual of a make; its nominal table is the UR10's."""

    def __init__(self, make, seed, misleading=False):
        common, own = (np.random.default_rng(part) for part in ([7, make], [8, make, seed]))
        self.nominal = Arm.from_name("ur10", probe=(0, 0, 93))
        change = {f: getattr(self.nominal, f) + own.normal(0, 0.2, 6) for f in ("a", "d")}
        for field, sd in (("alpha", 3e-4), ("theta_offset", 5e-4)):
            change[field] = getattr(self.nominal, field) + own.normal(0, sd, 6)
        self.arm = self.nominal.replace(**change)
        self.gears = np.repeat(common.choice(RATIOS, 2, replace=False), 3)
        self.teeth = common.uniform(6, 15, 6) * own.uniform(0.7, 1.3, 6)
        self.teeth_phase = own.uniform(0, 6.28, 6)
        self.eccentric = own.normal(0, 25, (6, 2)) * [1, 0.4]
        self.phase = own.uniform(0, 6.28, (6, 2))
        self.compliance = common.uniform(20, 80, 6) * own.uniform(0.9, 1.1, 6)
        self.cross = common.normal(0, 3, (6, 6)) + own.normal(0, 2, (6, 6))
        self.turn = Rotation.from_rotvec(own.normal(0, 0.5, 3)).as_matrix()
        if misleading:
            self.eccentric, self.teeth = 0.1 * self.eccentric, 2 * self.teeth
            self.compliance = -3 * self.compliance

    def measure(self, angles, rng, noise_mm=NOISE_MM):
        """Points in the tracker's frame."""
        turns = np.cos(angles) @ self.cross * np.sin(np.roll(angles, 1, axis=1))
        for k in range(2):
            turns += self.eccentric[:, k] * np.cos((k + 1) * angles - self.phase[:, k])
        turns += self.teeth * np.cos(self.gears * angles - self.teeth_phase)
        jacobian = self.arm.jacobian(angles)
        turns += self.compliance * jacobian[:, 2] / 1200  # torque of a weight at the probe
        points = self.arm.forward(angles) - np.einsum("nij,nj->ni", jacobian, turns * ARCSEC)
        return points @ self.turn.T + [1500, -300, 200] + rng.normal(0, noise_mm, points.shape)

    def learn(self, n, rng):
        """Model of this arm from some poses."""
        angles = rng.uniform(-2, 2, (n, 6))
        found = calibrate(self.nominal, angles, points=self.measure(angles, rng))
        return arm_model(found.arm).fit(angles, found.residuals_mm)


def deviation(residuals):
    return float(np.linalg.norm(residuals, axis=1).mean())


def show(name, table):
    """Print one line for each number of poses: means over seeds, and how often it was trusted."""
    print(name, flush=True)
    for n, rows in table.items():
        cells = [f"{way} {np.mean([row[way] for row in rows]):.3f}" for way in rows[0]]
        print(f"{n:6}  " + "  ".join(cells), flush=True)


def robots(seeds, counts):
    rng = np.random.default_rng(0)
    earlier = [Robot(0, 100 + i).learn(600, rng) for i in range(4)]
    misleading = [Robot(3, 200 + i, misleading=True).learn(600, rng) for i in range(4)]
    table = {n: [] for n in counts}
    for seed in range(seeds):
        robot, rng = Robot(0, seed), np.random.default_rng([5, seed])
        far, new = rng.uniform(-2, 2, (500, 6)), rng.uniform(-2, 2, (max(counts), 6))
        far_points, points = robot.measure(far, rng, 0.0), robot.measure(new, rng)
        for n in counts:
            found = calibrate(robot.nominal, new[:n], points=points[:n])
            true, y = found.residuals(far, far_points), found.residuals_mm
            own = arm_model(found.arm).fit(new[:n], y)
            row = {"calibrated": deviation(true), "alone": deviation(true - own.predict(far))}
            starts = (("of 4", earlier), ("of 1", earlier[:1]), ("misleading", misleading))
            for name, models in starts:
                moved = transferred_model(models, found.arm, new[:n], y)
                row[name] = deviation(true - moved.predict(far))
                row[f"{name} trusted"] = float(moved.updates_[0]["gain_nats"] > 0)
            table[n].append(row)
    show("Robots of one make, mean deviation in mm at other poses", table)


def measuring_arms(seeds, counts):
    """Single-point tests; the deviation is that within 6 other positions."""

    def test(seed, n_positions):
        data = make_single_point(n_positions, 20, random_state=seed)
        return data.arm, data.data, data.target, data.groups

    earlier = []
    for seed in range(100, 104):
        arm, angles, y, groups = test(seed, 24)
        earlier.append(arm_model(arm).fit(angles, y, groups=groups))
    table = {n: [] for n in counts}
    for seed in range(seeds):
        arm, angles, y, groups = test(seed, 16)
        far = groups >= 10
        for n in counts:
            near = groups < n
            data = angles[near], y[near]
            own = arm_model(arm).fit(*data, groups=groups[near])
            row = {"calibrated": deviation(y[far])}
            models = {"alone": own}
            for name, some in (("of 4", earlier), ("of 1", earlier[:1])):
                moved = transferred_model(some, arm, *data, groups=groups[near])
                models[name], row[f"{name} trusted"] = moved, moved.updates_[0]["gain_nats"] > 0
            for name, model in models.items():
                left = y[far] - model.predict(angles[far])
                row[name] = deviation(position_residuals(left, groups[far]))
            table[n].append(row)
    show("Measuring arms, 20 poses at each of some positions, within 6 others", table)


def pandas(draws, counts):
    """A model of one Panda as the start for the other: within placements that are not known."""
    root = os.environ.get("SKLEARN_RAACMM_DATA", Path.home() / "scikit_learn_data")
    data = {name: fetch_panda_ball_socket(name, data_home=root) for name in ("panda_2", "panda_3")}
    nominal = Arm.from_name("panda", probe=(0, 0, 138))
    for old, new in (("panda_2", "panda_3"), ("panda_3", "panda_2")):
        found = calibrate(nominal, data[old].data, data[old].groups)
        y = found.residuals(data[old].data, groups=data[old].groups)
        model = arm_model(found.arm).fit(data[old].data, y, groups=data[old].groups)
        angles, groups = data[new].data, data[new].groups
        labels, table = np.unique(groups), {n: [] for n in counts}
        for draw in range(draws):
            order = np.random.default_rng(draw).permutation(len(labels))
            for n in counts:
                known = np.isin(groups, labels[order[:n]])
                found = calibrate(nominal, angles[known], groups[known])
                near = found.residuals(angles[known], groups=groups[known])
                true = found.residuals(angles[~known], groups=groups[~known])
                own = arm_model(found.arm)
                own.fit(angles[known], near, groups=groups[known])
                moved = transferred_model(
                    [model], found.arm, angles[known], near, groups=groups[known]
                )
                row = {"calibrated": deviation(true)}
                for name, one in (("alone", own), ("of 1", moved)):
                    left = true - one.predict(angles[~known])
                    row[name] = deviation(position_residuals(left, groups[~known]))
                row["of 1 trusted"] = float(moved.updates_[0]["gain_nats"] > 0)
                table[n].append(row)
        show(f"{new} from {old}, known placements", table)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--panda", action="store_true", help="the two real robots, too")
    options = parser.parse_args()
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        robots(options.seeds, (10, 20, 40, 100, 400))
        measuring_arms(options.seeds, (1, 2, 4, 8))
        if options.panda:
            pandas(2, (1, 2, 4))
    print(f"{time.process_time() - start:.0f} s of processor time")


if __name__ == "__main__":
    main()
