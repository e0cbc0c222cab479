"""Months later: a model brought up to date with a fifth of the poses of a new fit.

A simulated robot with eccentric encoders, gears, gravity and errors that no column describes is
measured by a tracker and learned. Months later every joint's offset has moved by 10 arc seconds,
the eccentricity of every joint by 4, the arm is 3 K warmer, and base and tool are new. The model
brought up to date with a fifth of the poses is compared with a new fit of all of them, which knows
nothing of the old ones, at 500 other poses. Both have their base and tool from the same tracker.

Run it with ``python benchmarks/bench_months.py`` (two minutes).
"""

import argparse
import warnings

import numpy as np
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, update_correction

ARCSEC = np.pi / 180 / 3600
NOISE_MM = 0.03


class Robot:
    """A robot with errors of its own, before and after the months."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.arm = Arm.from_name("ur10", probe=(0, 0, 93))
        self.amplitude, self.phase = rng.normal(0, 30, (6, 3)), rng.uniform(0, 6, (6, 3))
        self.cross = rng.normal(0, 3, (6, 6))
        self.offsets = rng.choice([-10.0, 10.0], 6)
        self.wear, self.wear_phase = rng.normal(0, 4, 6), rng.uniform(0, 6, 6)
        self.tool = rng.normal(0, 20, 3)
        self.turn = Rotation.from_rotvec(rng.normal(0, 0.5, 3)).as_matrix()

    def measure(self, angles, rng, months):
        """Points in the tracker's frame."""
        turns = np.cos(angles) @ self.cross * np.sin(np.roll(angles, 1, axis=1))
        for k in range(3):
            turns += self.amplitude[:, k] / (k + 1) * np.cos((k + 1) * angles - self.phase[:, k])
        turns[:, 0] += 10 * np.sin(17 * angles[:, 0])
        turns[:, 2] += 8 * np.cos(100 * angles[:, 2])
        arm = self.arm
        if months:
            turns += self.offsets + self.wear * np.cos(angles - self.wear_phase)
            arm = arm.replace(probe=arm.probe + self.tool)
        points = arm.forward(angles)
        points = points - np.einsum("nij,nj->ni", arm.jacobian(angles), turns * ARCSEC)
        points *= 1 + 11.7e-6 * 3 * months
        if months:
            points = points @ self.turn.T + [1500, -300, 200]
        return points + rng.normal(0, NOISE_MM, points.shape)


def deviation(residuals, model):
    return float(np.linalg.norm(residuals[1] - model.predict(residuals[0]), axis=1).mean())


def one_robot(seed, n_new):
    """Mean deviation, mm: no correction, registered, updated, new fits of a fifth and of all."""
    robot, rng = Robot(seed), np.random.default_rng([1, seed])
    old, new, far = (rng.uniform(-2, 2, (n, 6)) for n in (1500, n_new, 500))
    first = calibrate(robot.arm, old, points=robot.measure(old, rng, 0))
    model = ArmResidualRegressor(first.arm).fit(old, first.residuals_mm)
    points, true = robot.measure(new, rng, 1), robot.measure(far, rng, 1)
    few = slice(0, n_new // 5)
    bare = calibrate(first.arm, new[few], points=points[few], free=["probe"])
    through = calibrate(first.arm, new[few], points=points[few], free=["probe"], correction=model)
    updated = update_correction(model, new[few], through.residuals(new[few], points[few]))
    left = [np.linalg.norm(bare.residuals(far, true), axis=1).mean()]
    left += [deviation((far, through.residuals(far, true)), m) for m in (model, updated)]
    for rows in (few, slice(None)):
        fresh = calibrate(robot.arm, new[rows], points=points[rows])
        own = ArmResidualRegressor(fresh.arm).fit(new[rows], fresh.residuals_mm)
        left.append(deviation((far, fresh.residuals(far, true)), own))
    return left


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=5)
    options = parser.parse_args()
    names = ("no correction", "registered", "updated", "new fit, a fifth", "new fit, all")
    print("poses" + "".join(f"{name:>18}" for name in names) + "   updated / new fit of all")
    for n_new in (100, 300, 500):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            left = np.array([one_robot(seed, n_new) for seed in range(options.robots)])
        ratio = left[:, 2] / left[:, 4]
        cells = "".join(f"{value:18.3f}" for value in left.mean(axis=0))
        print(
            f"{n_new // 5:2} of {n_new}{cells}   {np.mean(ratio):.2f} ({ratio.max():.2f})",
            flush=True,
        )


if __name__ == "__main__":
    main()
