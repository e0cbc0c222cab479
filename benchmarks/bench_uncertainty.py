"""Standard deviations of single points, distances and diameters: errors over them.

Simulated arms of three kinds, learnt from ten cones of 25 poses alone, with bars of 500 mm at one
and three places, and from 250 points of a tracker. Asked for are deviations of single points within
a position by zone, distances, and diameters of spheres, at places that were never measured.

    python benchmarks/bench_uncertainty.py --arms 24
"""

import argparse
import warnings
from dataclasses import replace

import _one_thread  # noqa: F401
import numpy as np
from _arm_folds import rms
from bench_lengths import cones_and_bars

from sklearn_raacmm import learn_correction
from sklearn_raacmm.datasets import (
    ArmErrors,
    SimulatedArm,
    make_acceptance,
    make_gauge,
    make_single_point,
)
from sklearn_raacmm.metrics import fit_sphere
from sklearn_raacmm.utils import centred

MIXES = ("typical", "gravity", "eccentricity")
LENGTHS = (200.0, 500.0, 1000.0, 1500.0)
TRACKER_MM = 0.01  # of each coordinate


def learnt(kind, machine, seed):
    """Correction of a simulated arm from what `kind` names."""
    cones = make_single_point(10, 25, machine=machine, random_state=seed)
    places = {"cones": 0, "a bar": 1, "three bars": 3, "tracker": 0}[kind]
    angles, labels, known = cones_and_bars(cones, seed, [500.0], places)
    given = {"lengths": known}
    if kind == "tracker":
        noise = np.random.default_rng([seed, 7]).normal(0, TRACKER_MM, (len(angles), 3))
        given = {"points": cones.simulation.true_points + noise, "points_sd": TRACKER_MM}
    return learn_correction(cones.nominal_arm, angles, labels, cv=3, **given)


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


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=24)
    options = parser.parse_args()
    warnings.simplefilter("ignore", UserWarning)
    for kind in ("cones", "a bar", "three bars", "tracker"):
        z = {}
        for seed in range(options.arms):
            off = np.random.default_rng([seed, 5]).uniform(0.1, 0.7)  # as published, mm
            errors = replace(ArmErrors.from_name(MIXES[seed % 3]), length_mm=off)
            machine = SimulatedArm(errors, random_state=seed)
            learned = learnt(kind, machine, seed)
            for ask in (single_points, distances, diameters):
                for name, values in ask(learned, machine, seed).items():
                    z.setdefault(name, []).append(values)
        print(f"{kind}: rms of error over standard deviation, share inside 95 %")
        for name, parts in z.items():
            every = np.concatenate(parts)
            inside = np.mean(np.abs(every) < 1.96)
            print(f"  {name:<14} {rms(every):6.2f} {inside:6.3f}", flush=True)


if __name__ == "__main__":
    main()
