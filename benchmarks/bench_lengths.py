"""Lengths: the scale of an arm from cones alone, and what known lengths buy.

Simulated arms, ten cones of 25 poses, calibrated from descriptions that are more or less wrong.

    python benchmarks/bench_lengths.py scale        # error of the scale, also over `scale_sd`
    python benchmarks/bench_lengths.py lengths      # what a known length buys
    python benchmarks/bench_lengths.py mistakes     # how often true and false lengths are named
    python benchmarks/bench_lengths.py intervals    # coverage of the intervals of a mean 2S
"""

import argparse
import warnings

import _one_thread  # noqa: F401
import numpy as np
from _arm_folds import rms

from sklearn_raacmm import ArmResidualRegressor, calibrate
from sklearn_raacmm.correction._scores import _summary
from sklearn_raacmm.datasets import ArmErrors, SimulatedArm, make_gauge, make_single_point
from sklearn_raacmm.metrics import gauge_lengths, single_point_repeatability


def simulated(seed, n_positions=10):
    """A single-point test of an arm whose lengths are 0.1 to 0.7 mm from its drawing."""
    rng = np.random.default_rng([seed, 5])
    errors = ArmErrors(length_mm=rng.uniform(0.1, 0.7))
    machine = SimulatedArm(errors, random_state=seed)
    return make_single_point(n_positions, 25, machine=machine, random_state=seed)


def descriptions(test, seed):
    """The table that a user may have of an arm, by the kind of description."""
    rng, arm = np.random.default_rng([seed, 6]), test.nominal_arm
    true = test.simulation.machine.true_arm
    a, d = arm.a.copy(), arm.d.copy()
    link, forgotten = d.copy(), a.copy()
    link[rng.choice([2, 4])] += 20
    forgotten[rng.choice([1, 3])] = 0

    def within(size):
        off = {name: size * rng.uniform(-1, 1, 6) for name in ("a", "d")}
        return {n: getattr(true, n) + off[n] * (np.abs(getattr(arm, n)) > 1) for n in off}

    tenths, tape = within(0.2), within(3.0)
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
    """Relative error of the distances between cones."""
    points = arm.forward(test.data)
    n = test.groups.max() + 1
    found = np.array([points[test.groups == g].mean(axis=0) for g in range(n)])
    true = np.array([test.simulation.true_points[test.groups == g].mean(axis=0) for g in range(n)])
    i, j = np.triu_indices(n, 1)
    found, true = (np.linalg.norm(p[i] - p[j], axis=1) for p in (found, true))
    return found @ true / (true @ true) - 1


def scale(n_arms):
    rows = {}
    for seed in range(n_arms):
        test = simulated(seed)
        for name, arm in descriptions(test, seed).items():
            result = calibrate(arm, test.data, test.groups)
            rows.setdefault(name, []).append((scale_error(result.arm, test), result.scale_sd))
    print(f"{'description':<32}{'mm in 1 m':>12}{'over scale_sd':>15}")
    for name, found in rows.items():
        error, sd = np.array(found).T
        print(f"{name:<32}{1000 * rms(error):12.2f}{rms(error / sd):15.2f}")


# Known lengths: bars of these lengths, mm, each at so many places.
KNOWN = {"none": ([], 0)} | {
    f"{length} mm at {name}": ([float(length)], n)
    for n, name in ((1, "one place"), (3, "three places"))
    for length in (300, 500, 1000)
}


def with_bars(seed, lengths, n_places):
    """Arm, angles, labels and known lengths of a test with bars, sd 0.01 mm, from a drawing."""
    test = simulated(seed)
    return test, *cones_and_bars(test, seed, lengths, n_places)


def cones_and_bars(test, seed, lengths, n_places):
    """Angles, labels and known lengths of a test of cones and of bars, if there are any."""
    rng, machine = np.random.default_rng([seed, 7]), test.simulation.machine
    angles, labels, known = test.data, [f"cone {g}" for g in test.groups], []
    if n_places:
        bars = make_gauge(lengths, n_places, 25, machine=machine, random_state=seed)
        angles = np.vstack([angles, bars.data])
        labels += [f"end {g}" for g in bars.groups]
        for (i, j), length in zip(bars.pairs, bars.lengths, strict=True):
            known.append((f"end {i}", f"end {j}", length + rng.normal(0, 0.01), 0.01))
    return angles, np.array(labels), known


def lengths(n_arms):
    """What a length buys: the error of 1 m at twenty other places, after learning."""
    print(f"{'known':<30}{'um, rms':>12}{'worst arm':>12}")
    for name, (sizes, places) in KNOWN.items():
        found = []
        for seed in range(n_arms):
            test, angles, labels, known = with_bars(seed, sizes, places)
            result = calibrate(test.nominal_arm, angles, labels, lengths=known)
            model = ArmResidualRegressor(result.arm)
            model.fit(angles, result.residuals(angles, groups=labels), groups=labels, lengths=known)
            bars = make_gauge(
                1000.0, 20, 5, machine=test.simulation.machine, random_state=seed + 1000
            )
            points = result.arm.forward(bars.data) - model.predict(bars.data)
            found.append(1000 * rms(gauge_lengths(points, bars.groups, bars.pairs) - 1000))
        print(f"{name:<30}{rms(found):12.0f}{max(found):12.0f}", flush=True)


def mistakes(n_arms):
    """Findings on lengths: of true ones beside every table, of false ones beside the drawing."""
    false = {
        "a bar, true": ([500], 1, lambda mm: mm),
        "three bars, true": ([500], 3, lambda mm: mm),
        "a bar, 1 mm longer": ([500], 1, lambda mm: mm + 1),
        "a bar, 3 mm longer": ([500], 1, lambda mm: mm + 3),
        "a ball of 12 mm": ([300, 500], 1, lambda mm: mm + 12),
        "a bar in inches": ([500], 1, lambda mm: mm / 25.4),
    }
    found = {}
    for seed in range(n_arms):
        for what, (sizes, places, change) in false.items():
            test, angles, labels, known = with_bars(seed, sizes, places)
            known = [(a, b, change(mm), sd) for a, b, mm, sd in known]
            tables = descriptions(test, seed) if what.endswith("true") else {}
            for name, arm in (tables | {"the drawing": test.nominal_arm}).items():
                result = calibrate(arm, angles, labels, lengths=known)
                said = [f.code for f in result.findings if "length" in f.code]
                found.setdefault((what, name), []).append(" ".join(said) or "nothing")
    for (what, name), said in found.items():
        counts = ", ".join(f"{code} {said.count(code)}" for code in sorted({*said}))
        print(f"{what:<20}{name:<34}{counts}", flush=True)


def intervals(n_arms):
    """How often the interval of a mean 2S holds the mean of 300 other positions."""
    rng = np.random.default_rng(0)
    print("share of 2000 sets whose 95 % interval holds the mean: Student's t, bootstrap")
    for seed in range(min(n_arms, 3)):
        test = make_single_point(300, 25, random_state=seed)
        every = single_point_repeatability(test.points, test.groups, aggregate=None)
        for n in (5, 10, 20):
            held = np.zeros(2)
            for _ in range(2000):
                x = rng.choice(every, n)
                means = x[rng.integers(n, size=(500, n))].mean(axis=1)
                ends = _summary(x, x, np.arange(n))["after"][1:], np.quantile(means, [0.025, 0.975])
                held += [low <= every.mean() <= high for low, high in ends]
            print(f"arm {seed}, {n:2} positions: {held[0] / 2000:.3f} {held[1] / 2000:.3f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["scale", "lengths", "mistakes", "intervals"])
    parser.add_argument("--arms", type=int, default=10)
    options = parser.parse_args()
    warnings.simplefilter("ignore", UserWarning)
    globals()[options.what](options.arms)


if __name__ == "__main__":
    main()
