"""Lengths: the scale of an arm from cones alone, what known lengths buy, and standard deviations.

Simulated arms, ten cones of 25 poses, calibrated from descriptions that are more or less wrong.

    python benchmarks/bench_lengths.py scale        # error of the scale over its standard deviation
"""

import argparse
import os
import warnings

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np

from sklearn_raacmm import calibrate
from sklearn_raacmm.datasets import ArmErrors, SimulatedArm, make_single_point


def simulated(seed, n_positions=10):
    """A single-point test of an arm whose lengths are 0.1 to 0.7 mm from its drawing."""
    rng = np.random.default_rng([seed, 5])
    errors = ArmErrors(length_mm=rng.uniform(0.1, 0.7))
    machine = SimulatedArm(errors, random_state=seed)
    return make_single_point(n_positions, 25, machine=machine, random_state=seed)


def descriptions(test, seed):
    """The table that a user may have of an arm, by the kind of description."""
    rng, arm, true = (
        np.random.default_rng([seed, 6]),
        test.nominal_arm,
        test.simulation.machine.true_arm,
    )
    a, d = arm.a.copy(), arm.d.copy()
    link, forgotten = d.copy(), a.copy()
    link[rng.choice([2, 4])] += 20
    forgotten[rng.choice([1, 3])] = 0
    tenths, tape = (
        {
            name: getattr(true, name)
            + size * rng.uniform(-1, 1, 6) * (np.abs(getattr(arm, name)) > 1)
            for name in ("a", "d")
        }
        for size in (0.2, 3.0)
    )
    return {
        "within tenths of a millimetre": arm.replace(**tenths),
        "the drawing": arm,
        "one of two offsets forgotten": arm.replace(a=forgotten),
        "no offsets": arm.replace(a=np.zeros(6), d=np.where(d < 50, 0, d)),
        "one link wrong by 20 mm": arm.replace(d=link),
        "lengths by tape, +-3 mm": arm.replace(**tape),
        "750 and 500 for 750.7 and 500.6": arm.replace(
            a=arm.a.round(), d=np.where(d > 400, np.floor(d), d.round())
        ),
    }


def scale_error(arm, test):
    """Relative error of the distances between cones, and their rms error in mm."""
    points = arm.forward(test.data)
    n = test.groups.max() + 1
    found = np.array([points[test.groups == g].mean(axis=0) for g in range(n)])
    true = np.array([test.simulation.true_points[test.groups == g].mean(axis=0) for g in range(n)])
    i, j = np.triu_indices(n, 1)
    found, true = (np.linalg.norm(p[i] - p[j], axis=1) for p in (found, true))
    return found @ true / (true @ true) - 1, np.sqrt(np.mean((found - true) ** 2))


def scale(n_arms):
    rows = {}
    for seed in range(n_arms):
        test = simulated(seed)
        for name, arm in descriptions(test, seed).items():
            result = calibrate(arm, test.data, test.groups)
            rows.setdefault(name, []).append((*scale_error(result.arm, test), result.scale_sd))
    print(f"{'description':<32}{'scale error':>12}{'claimed':>10}{'rms z':>8}{'lengths, mm':>13}")
    for name, found in rows.items():
        error, length, sd = np.array(found).T
        print(
            f"{name:<32}{rms(error):12.5f}{rms(sd):10.5f}{rms(error / sd):8.2f}{rms(length):13.3f}"
        )
    four = np.concatenate(list(rows.values())[:4])
    print(f"the first four: rms z {rms(four[:, 0] / four[:, 2]):.2f} of {len(four)} arms")


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["scale"])
    parser.add_argument("--arms", type=int, default=10)
    options = parser.parse_args()
    warnings.simplefilter("ignore", UserWarning)
    globals()[options.what](options.arms)


if __name__ == "__main__":
    main()
