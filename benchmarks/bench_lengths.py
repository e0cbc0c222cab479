"""Lengths: the scale of an arm from cones alone, and what known lengths buy.

Simulated arms, ten cones of 25 poses, calibrated from descriptions that are more or less wrong.

    python benchmarks/bench_lengths.py scale        # error of the scale, also over `scale_sd`
    python benchmarks/bench_lengths.py lengths      # what a known length buys
    python benchmarks/bench_lengths.py mistakes     # how often true and false lengths are named
    python benchmarks/bench_lengths.py intervals    # coverage of the intervals of a mean 2S
    python benchmarks/bench_lengths.py deviations --arms 24

``deviations``: errors over their standard deviations, of three kinds of arms, learnt from the cones
alone, with bars of 500 mm at one and three places, and from 250 points of a tracker: deviations of
single points within a position by zone, distances, and diameters of spheres, at other places.
"""

from dataclasses import replace

import _one_thread  # noqa: F401
import numpy as np
from _arm_folds import MIXES, rms, run_part

from sklearn_raacmm import ArmResidualRegressor, calibrate, learn_correction
from sklearn_raacmm.correction._scores import _summary
from sklearn_raacmm.datasets import (
    ArmErrors,
    SimulatedArm,
    make_acceptance,
    make_gauge,
    make_single_point,
)
from sklearn_raacmm.metrics import fit_sphere, gauge_lengths, single_point_repeatability
from sklearn_raacmm.utils import centred


def simulated(seed, mix="typical"):
    """A single-point test of an arm whose lengths are 0.1 to 0.7 mm from its drawing."""
    off = np.random.default_rng([seed, 5]).uniform(0.1, 0.7)  # as published
    errors = replace(ArmErrors.from_name(mix), length_mm=off)
    machine = SimulatedArm(errors, random_state=seed)
    return make_single_point(10, 25, machine=machine, random_state=seed)


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


def scale(options):
    rows = {}
    for seed in range(options.arms):
        test = simulated(seed)
        for name, arm in descriptions(test, seed).items():
            result = calibrate(arm, test.data, test.groups)
            rows.setdefault(name, []).append((scale_error(result.arm, test), result.scale_sd))
    for name, found in rows.items():
        error, sd = np.array(found).T
        print(f"{name}: {1000 * rms(error):.2f} mm in 1 m, {rms(error / sd):.2f} over scale_sd")


# Known lengths: bars of these lengths, mm, each at so many places.
KNOWN = {"none": ([], 0)} | {
    f"{length} mm at {name}": ([float(length)], n)
    for n, name in ((1, "one place"), (3, "three places"))
    for length in (300, 500, 1000)
}


def with_bars(seed, lengths, n_places, mix="typical"):
    """A test of cones and of bars, if there are any; its angles, labels and known lengths."""
    test = simulated(seed, mix)
    rng, machine = np.random.default_rng([seed, 7]), test.simulation.machine
    angles, labels, known = test.data, [f"cone {g}" for g in test.groups], []
    if n_places:
        bars = make_gauge(lengths, n_places, 25, machine=machine, random_state=seed)
        angles = np.vstack([angles, bars.data])
        labels += [f"end {g}" for g in bars.groups]
        for (i, j), length in zip(bars.pairs, bars.lengths, strict=True):
            known.append((f"end {i}", f"end {j}", length + rng.normal(0, 0.01), 0.01))
    return test, angles, np.array(labels), known


def lengths(options):
    """What a length buys: the error of 1 m at twenty other places, after learning."""
    for name, (sizes, places) in KNOWN.items():
        found = []
        for seed in range(options.arms):
            test, angles, labels, known = with_bars(seed, sizes, places)
            result = calibrate(test.nominal_arm, angles, labels, lengths=known)
            model = ArmResidualRegressor(result.arm)
            model.fit(angles, result.residuals(angles, groups=labels), groups=labels, lengths=known)
            bars = make_gauge(
                1000.0, 20, 5, machine=test.simulation.machine, random_state=seed + 1000
            )
            points = result.arm.forward(bars.data) - model.predict(bars.data)
            found.append(1000 * rms(gauge_lengths(points, bars.groups, bars.pairs) - 1000))
        print(f"{name}: rms {rms(found):.0f} um, worst arm {max(found):.0f}", flush=True)


def mistakes(options):
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
    for seed in range(options.arms):
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
        print(f"{what}, {name}: {counts}", flush=True)


def intervals(options):
    """How often the interval of a mean 2S holds the mean of 300 other positions."""
    rng = np.random.default_rng(0)
    print("share of 2000 sets whose 95 % interval holds the mean: Student's t, bootstrap")
    for seed in range(min(options.arms, 3)):
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


LENGTHS = (200.0, 500.0, 1000.0, 1500.0)
TRACKER_MM = 0.01  # of each coordinate


def learnt(kind, mix, seed):
    """Correction of a simulated arm from what `kind` names, and the arm."""
    places = {"cones": 0, "a bar": 1, "three bars": 3, "tracker": 0}[kind]
    test, angles, labels, known = with_bars(seed, [500.0], places, mix)
    given = {"lengths": known}
    if kind == "tracker":
        noise = np.random.default_rng([seed, 7]).normal(0, TRACKER_MM, (len(angles), 3))
        given = {"points": test.simulation.true_points + noise, "points_sd": TRACKER_MM}
    learned = learn_correction(test.nominal_arm, angles, labels, cv=3, **given)
    return learned, test.simulation.machine


def single_points(learned, machine, seed):
    """Deviations within positions over their standard deviations, by zone."""
    run = make_acceptance(["single-point"], machine=machine, random_state=seed + 1000).run
    points, std = learned.correct(run.angles, std_of="position")
    z = centred(points, np.unique(run.position, return_inverse=True)[1]) / std
    z *= np.sqrt(10 / 9)
    return {f"point {zone}": z[run.position == zone].ravel() for zone in np.unique(run.position)}


def distances(learned, machine, seed):
    """Errors of distances over their standard deviations, by length."""
    bars = make_gauge(LENGTHS, 10, 2, machine=machine, random_state=seed + 1000)
    first, second = np.arange(0, len(bars.data), 4), np.arange(2, len(bars.data), 4)
    found, sd = learned.distances(bars.data[first], bars.data[second])
    true = bars.simulation.true_points
    z = (found - np.linalg.norm(true[first] - true[second], axis=1)) / sd
    parts = zip(LENGTHS, z.reshape(len(LENGTHS), -1), strict=True)
    return {f"{length:.0f} mm": part for length, part in parts}


def diameters(learned, machine, seed):
    """Errors of diameters over their standard deviations by draws."""
    run = make_acceptance(["probing"], machine=machine, exact=True, random_state=seed + 1000)
    run, arm = run.run, learned.arm
    X, rng, found = learned.inputs(run.angles), np.random.RandomState(seed), []
    mean = learned.model.predict(X)
    draws = learned.model.sample_y(X, 200, rng, with_noise=True) - mean[:, :, None]
    scale = learned.scale_sd * rng.normal(size=200)
    points = arm.forward(run.angles) - mean
    draws += points[:, :, None] * scale
    for key in sorted(set(zip(run.artefact.tolist(), run.position.tolist(), strict=True))):
        rows = (run.artefact == key[0]) & (run.position == key[1]) & (run.test == "probing")
        size = next(a for a in run.artefacts if a.name == key[0]).size_mm + run.tip_mm
        of = [2 * fit_sphere(points[rows] + draws[rows][:, :, k])[1] for k in range(200)]
        found.append((2 * fit_sphere(points[rows])[1] - size) / np.std(of))
    return {"diameter": np.array(found)}


def deviations(options):
    for kind in ("cones", "a bar", "three bars", "tracker"):
        z = {}
        for seed in range(options.arms):
            learned, machine = learnt(kind, MIXES[seed % 3], seed)
            for ask in (single_points, distances, diameters):
                for name, values in ask(learned, machine, seed).items():
                    z.setdefault(name, []).append(values)
        print(f"{kind}: rms of error over standard deviation, share inside 95 %")
        for name, parts in z.items():
            every = np.concatenate(parts)
            inside = np.mean(np.abs(every) < 1.96)
            print(f"  {name:<14} {rms(every):6.2f} {inside:6.3f}", flush=True)


def main():
    run_part(__doc__, [scale, lengths, mistakes, intervals, deviations], arms=10)


if __name__ == "__main__":
    main()
