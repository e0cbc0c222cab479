"""How often a check of a correction raises an alarm, and whether it names the cause.

A simulated six-joint measuring arm with eccentric encoders, whose model has learned 500 poses, is
checked with 40 poses of another day against a tracker (noise 15 um): without a change, after a
knock of one joint (1 to 5 in turn), with a loose probe, and 5 K warmer. With ``--real`` the same
changes are planted into the residuals of a real UR10, other poses of the series that its model has
learned: no model of it is complete.

Run it with ``python benchmarks/bench_check.py --real`` (two minutes). The data are downloaded, or
read from the folder that SKLEARN_RAACMM_DATA names.
"""

import argparse
import os
import warnings
from functools import partial
from pathlib import Path

import numpy as np
from _arm_folds import arm_model
from bench_after_the_lab import read

from sklearn_raacmm import Arm, calibrate, check_correction

ARCSEC = np.pi / 180 / 3600
RATE = 0.01


def knock(arm, arcsec):
    def change(angles, rng, run):
        return arm.jacobian(angles)[
            :, :, run % 5
        ] * arcsec * ARCSEC, f"offset of joint {run % 5 + 1}"

    return change


def changes(arm, noise_mm):
    """Name, function of the change, and what is fitted to the same poses."""
    both = ("base", "probe")
    yield "none", lambda q, rng, run: (0.0, "nothing"), ()
    yield "none, base and probe refitted", lambda q, rng, run: (0.0, "nothing"), both
    for arcsec in (5, 10, 20):
        yield f"knock of {arcsec} arc seconds", knock(arm, arcsec), ()
    yield "knock of 20 arc seconds, base and probe refitted", knock(arm, 20), both
    loose = 4 / 3 * noise_mm
    yield f"loose probe, {1000 * loose:.0f} um more noise", lambda q, rng, run: (
        rng.normal(0, loose, (len(q), 3)), "noise"), ()  # fmt: skip
    yield "5 K warmer, steel", lambda q, rng, run: (-arm.forward(q) * 11.7e-6 * 5, "scale"), ()


def table(arm, model, poses, noise_mm, runs):
    """Print the rates; `poses(run)` gives angles and residuals of another day."""
    print(f"{'change':50}{'alarms':>9}{'named rightly':>16}")
    for name, change, refitted in changes(arm, noise_mm):
        n_runs = 4 * runs if name.startswith("none") else runs
        alarms = right = 0
        for run in range(n_runs):
            rng = np.random.default_rng([1, run])
            angles, y = poses(run)
            # Of a knock of joint 1 or 5 nothing may be left beside a fitted base and probe.
            moved, cause = change(angles, rng, 1 + run % 3 if refitted else run)
            check = check_correction(
                model, angles, y + moved, refitted=refitted, false_alarm_rate=RATE
            )
            alarms += not check.holds
            right += not check.holds and check.suspect == cause
        print(f"{name:50}{alarms / n_runs:8.1%}{f'{right} of {alarms}':>17}", flush=True)


def poses_of_simulated_arm(arm, seed, n=40):
    """Angles and residuals of an arm with eccentric encoders."""
    rng = np.random.default_rng([2, seed])
    angles = rng.uniform(-2, 2, (n, 6))
    turn = np.zeros_like(angles)
    turn[:, 0] = 8 * np.sin(angles[:, 0])
    turn[:, 1] = 12 * np.cos(angles[:, 1])
    turn[:, 3] = 8 * np.cos(2 * angles[:, 3] - 1)
    y = np.einsum("nij,nj->ni", arm.jacobian(angles), turn * ARCSEC)
    return angles, y + rng.normal(0, 0.015, y.shape)


def simulated(runs):
    arm = Arm.from_name("aacmm6")
    poses = partial(poses_of_simulated_arm, arm)
    model = arm_model(arm, orders=12).fit(*poses(10**6, 500))
    print("Simulated measuring arm, 40 poses")
    table(arm, model, poses, 0.015, runs)


def real(runs):
    root = os.environ.get("SKLEARN_RAACMM_DATA", Path.home() / "scikit_learn_data")
    angles, points = read("A", Path(root) / "ur10_tracker")
    order = np.random.default_rng(0).permutation(len(angles))
    rows, others = order[:3000], order[3000:]
    first = calibrate(Arm.from_name("ur10", probe=(0, 0, 93)), angles[rows], points=points[rows])
    model = arm_model(first.arm).fit(angles[rows], first.residuals_mm)

    def poses(run):
        some = np.random.default_rng([3, run]).choice(others, 40, replace=False)
        return angles[some], first.residuals(angles[some], points[some])

    noise_mm = model.linear_model_.noise_scale * model.noise_sd_
    print(f"UR10, 40 other poses of its series, noise {1000 * noise_mm:.0f} um")
    table(first.arm, model, poses, noise_mm, runs)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=60, help="of each change; without one, 4 times")
    parser.add_argument("--real", action="store_true", help="the UR10, too")
    options = parser.parse_args()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        simulated(options.runs)
        if options.real:
            real(options.runs)


if __name__ == "__main__":
    main()
