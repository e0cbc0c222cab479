"""What a correction is worth where poses or placements are few: thinned real Pandas.

Of each set some placements are drawn, and of their rows as many as asked for. Calibration and model
learn from these; all rows of the other placements are left out. Printed is, by the number of
placements, what is left of the mean deviation from a socket's mean over that without correction
(geometric mean, worst draw), the share of coordinates inside intervals of 95 %, how often the model
decided for no correction, and the CPU seconds of the fits.

    python benchmarks/bench_few_poses.py
    python benchmarks/bench_few_poses.py --against OTHER/.venv/bin/python

measures a second installation of the package in the same run. ``--gears`` asks simulated arms with
a gear at one joint instead: single-point tests of 6 to 12 positions, every other one left out.
"""

import argparse
import json
import os
import subprocess
import sys
import time
import warnings

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np
from _arm_folds import read_panda

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import make_single_point

SETS = ("panda_2", "panda_3", "panda_6", "panda_7")
PLACEMENTS, ROWS, DRAWS = (1, 2, 3, 4), (60, 120, 200), 2
GEARS = (100, 120, 160, 200, 240)
GEAR_ARCSEC, N_ARMS = 8.0, 20
LEAST_TEETH = 30  # gears are sought above: wobble and eccentricity have the orders below


def deviation(left, groups):
    return float(np.linalg.norm(position_residuals(left, groups), axis=1).mean())


def case_of(model, arm, angles, groups, train, known):
    """Fit to some rows and judge at the others; `known` are the model's options of fit."""
    y = position_residuals(arm.forward(angles), groups)
    start = time.process_time()
    model.fit(angles[train], y[train], groups=groups[train], **known)
    seconds = time.process_time() - start
    start = time.process_time()
    mean, std = model.predict(angles[~train], return_std=True, with_noise=True)
    left = position_residuals(y[~train] - mean, groups[~train])
    return {
        "ratio": deviation(left, groups[~train]) / deviation(y[~train], groups[~train]),
        "mm": deviation(left, groups[~train]),
        "inside": float(np.mean(np.abs(left) < 1.96 * std)),
        "helps": bool(model.helps_),
        "seconds": seconds,
    }


def panda_cases(names, counts, rows, draws):
    """Yield the result of each draw."""
    for name in names:
        angles, sockets, placements = read_panda(name)
        labels = np.unique(placements)
        most = len(labels) - 1
        for k in sorted({k for k in (*counts, most) if k <= most}):
            for n in rows:
                for draw in range(draws):
                    rng = np.random.default_rng([k, n, draw])
                    chosen = rng.permutation(labels)[:k]
                    inside = np.isin(placements, chosen)
                    some = rng.permutation(np.flatnonzero(inside))
                    if len(some) < 0.8 * n and n > min(rows):  # would be the smaller case again
                        continue
                    used, counts_of = np.unique(sockets[some[:n]], return_counts=True)
                    used = used[counts_of >= 2]
                    train = np.zeros(len(angles), bool)
                    train[some[:n]] = np.isin(sockets[some[:n]], used)
                    both = [p for p in chosen if {f"{p}/0", f"{p}/1"} <= set(used)]
                    lengths = [(f"{p}/0", f"{p}/1", 50.0, 0.1) for p in both]
                    nominal = Arm.from_name("panda", probe=(0, 0, 138))
                    arm = calibrate(nominal, angles[train], sockets[train], lengths=lengths).arm
                    # Rows of placements that were drawn and not taken are no judges.
                    kept = train | ~inside
                    found = case_of(
                        ArmResidualRegressor(arm), arm, angles[kept], sockets[kept], train[kept], {}
                    )
                    yield found | {"name": name, "k": int(k), "n": int(n), "draw": draw}


def gear_cases(n_arms):
    """Yield the result of each simulated arm; gears found, and high orders that are none."""
    for seed in range(n_arms):
        rng = np.random.default_rng([9, seed])
        test = make_single_point(int(rng.choice([6, 8, 12])), 16, random_state=seed)
        joint, gear = int(rng.integers(6)), int(rng.choice(GEARS))
        turns = np.zeros_like(test.data)
        phase = rng.uniform(0, 2 * np.pi)
        turns[:, joint] = np.deg2rad(GEAR_ARCSEC / 3600) * np.cos(
            gear * test.data[:, joint] - phase
        )
        moved = np.einsum("nij,nj->ni", test.arm.jacobian(test.data), turns)
        y = position_residuals(test.points + moved, test.groups)
        train = test.groups % 2 == 0
        model = ArmResidualRegressor(test.arm)
        model.fit(test.data[train], y[train], groups=test.groups[train])
        left = y[~train] - model.predict(test.data[~train])
        high = model.harmonics_[model.harmonics_["order"] > LEAST_TEETH]
        right = (high["joint"] == joint + 1) & (high["order"] == gear)
        yield {
            "ratio": deviation(left, test.groups[~train])
            / deviation(y[~train], test.groups[~train]),
            "found": int(right.sum()),
            "false": int((~right).sum()),
        }


def shown(results, label):
    """Lines of one installation."""
    by_count = {}
    for one in results:
        by_count.setdefault(min(one["k"], 4), []).append(one)
    for k, some in sorted(by_count.items()):
        ratios = np.array([one["ratio"] for one in some])
        print(
            f"| {label} | {k}{' and more' * (k == 4)} | {len(some)} "
            f"| {np.exp(np.log(ratios).mean()):.3f} ({ratios.max():.2f}) "
            f"| {np.mean([one['inside'] for one in some]):.2f} "
            f"({min(one['inside'] for one in some):.2f}) "
            f"| {sum(not one['helps'] for one in some)} "
            f"| {sum(one['seconds'] for one in some):.0f} |"
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--against", metavar="PYTHON", help="Python of another installation")
    parser.add_argument("--sets", nargs="*", default=list(SETS))
    parser.add_argument("--placements", nargs="*", type=int, default=list(PLACEMENTS))
    parser.add_argument("--rows", nargs="*", type=int, default=list(ROWS))
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--gears", action="store_true", help="simulated arms with a gear instead")
    parser.add_argument("--arms", type=int, default=N_ARMS, help="simulated arms")
    parser.add_argument("--json", action="store_true", help="print one result a line")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    cases = (
        gear_cases(options.arms)
        if options.gears
        else panda_cases(options.sets, options.placements, options.rows, options.draws)
    )
    if options.json:
        for one in cases:
            print(json.dumps(one), flush=True)
        return
    runs = {"now": list(cases)}
    if options.against:
        arguments = [part for part in sys.argv[1:] if part not in ("--against", options.against)]
        out = subprocess.run(
            [options.against, __file__, *arguments, "--json"], capture_output=True, check=True
        ).stdout
        runs = {"before": [json.loads(line) for line in out.splitlines()]} | runs
    if options.gears:
        print("| | of no correction, geometric mean (worst) | gears found | false ones |")
        for label, some in runs.items():
            ratios = np.array([one["ratio"] for one in some])
            print(
                f"| {label} | {np.exp(np.log(ratios).mean()):.3f} ({ratios.max():.2f}) "
                f"| {sum(one['found'] for one in some)} of {len(some)} "
                f"| {sum(one['false'] for one in some)} |"
            )
        return
    print("| | placements | draws | of no correction (worst) | inside (least) | refused | s |")
    for label, some in runs.items():
        shown(some, label)


if __name__ == "__main__":
    main()
