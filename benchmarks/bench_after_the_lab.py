"""A correction on another day, and with another probe: register, update, and what not to do.

A model is fitted to series A of a real UR10 and used on series B: the tracker was set up anew and
its target sits elsewhere on the flange. From some poses of B base and tool are found, and more; the
mean deviation at all other poses of B is printed, for five draws of these poses.

With ``--probes`` a simulated arm is calibrated and learnt with a probe of 100 mm at 14 cones. Then
it gets longer probes, each registered through the correction in two cones, 15 poses in all. At 8
other cones the mean 2S is printed: without a correction; with that of the old probe, registered;
with the same causes through the Jacobian of the new probe (``model.with_arm``, which `calibrate`
does by itself); moved in the same way, but learnt with probes of 100 and 250 mm together, 7 cones
each; and with a new fit on 14 cones of the new probe.

Run it with ``python benchmarks/bench_after_the_lab.py [--probes]`` (two to three minutes).
The data are downloaded, or read from the folder that SKLEARN_RAACMM_DATA names.
"""

import argparse
import os
import time
import warnings
from copy import copy
from pathlib import Path
from urllib.request import urlretrieve

import numpy as np
from _arm_folds import arm_model

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    calibrate,
    position_residuals,
    update_correction,
)
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

URL = (
    "https://raw.githubusercontent.com/christianlandgraf/ipa-robot-accuracy/"
    "507fba69bdaf6c43c2faf306e70a7e37c5e39b89/"
)
FILES = {
    "A": ("Series_A/measurements_grid.csv", (14, 15, 16)),
    "B": ("Series_B/measurements_joint_configurations.csv", (14, 16, 18)),
}
PROBES_MM = (100, 150, 250, 400)
WAYS = ("no correction", "the natural way", "through the correction", "updated")


def read(series, folder):
    """Joint angles in rad and points in mm of one series."""
    name, columns = FILES[series]
    path = folder / Path(name).name
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        urlretrieve(URL + name, path)
    lines = path.read_text(encoding="utf-8-sig").replace(",", ".").splitlines()[1:]
    table = np.array([[float(field) for field in line.split(";")] for line in lines])
    return table[:, 7:13], table[:, columns]


def mean_deviation(residuals):
    return float(np.linalg.norm(residuals, axis=1).mean())


def one_draw(model, arm, angles, points, known):
    """Mean deviation in mm at the poses that are not `known`, each way, and processor seconds."""
    rest = ~known
    data = {"points": points[known], "free": ["probe"]}
    alone = calibrate(arm, angles[known], **data)
    start = time.process_time()
    through = calibrate(arm, angles[known], **data, correction=model)
    seconds = [time.process_time() - start]
    start = time.process_time()
    y = through.residuals(angles[known], points[known])
    updated = update_correction(model, angles[known], y)
    seconds.append(time.process_time() - start)
    bare = alone.residuals(angles[rest], points[rest])
    registered = through.residuals(angles[rest], points[rest])
    old, new = (m.predict(angles[rest]) for m in (model, updated))
    left = (bare, bare - old, registered - old, registered - new)
    return [mean_deviation(r) for r in left], seconds


class OldProbe:
    """A model that stays with the probe that it was fitted with."""

    def __init__(self, model):
        self.predict = model.predict


def with_probe(machine, length):
    """The same simulated arm with another probe."""
    other, more = copy(machine), np.array([0.0, 0.0, length - 100.0])
    for name in ("nominal_arm", "true_arm"):
        arm = getattr(machine, name)
        setattr(other, name, arm.replace(probe=arm.probe + more))
    other.reach = machine.reach + more[2]
    return other


def cone_test(machine, seed, n_positions, n_poses):
    test = make_single_point(
        machine=machine, n_positions=n_positions, n_poses=n_poses, random_state=seed
    )
    return test.data, test.groups


def left(arm, model, angles, groups):
    points = arm.forward(angles)
    if model is not None:
        points = points - model.predict(angles)
    return 1000 * single_point_repeatability(points, groups)


def fitted(arm, angles, groups):
    found = calibrate(arm, angles, groups)
    y = position_residuals(found.arm.forward(angles), groups)
    return found.arm, ArmResidualRegressor(found.arm).fit(angles, y, groups=groups)


def fitted_to_two(machine, seed):
    """The model of 7 cones with a probe of 100 mm and 7 others with one of 250 mm."""
    tests = [
        cone_test(with_probe(machine, length), seed + 50 * i, 7, 30)
        for i, length in enumerate((100, 250))
    ]
    angles = np.concatenate([test[0] for test in tests])
    groups = np.concatenate([test[1] + 7 * i for i, test in enumerate(tests)])
    tools = np.repeat([0, 1], [len(test[0]) for test in tests])
    found = calibrate(machine.nominal_arm, angles, groups, tools=tools)
    y = found.residuals(angles, groups=groups, tools=tools)
    probes = np.array([found.arms[tool].probe for tool in tools])
    return ArmResidualRegressor(found.arm).fit(angles, y, groups=groups, probes=probes)


def one_arm(seed):
    """2S in um for each probe and way."""
    machine = SimulatedArm("typical", random_state=seed)
    arm, model = fitted(machine.nominal_arm, *cone_test(machine, seed, 14, 30))
    of_two = fitted_to_two(machine, seed)
    rows = []
    for length in PROBES_MM:
        own = with_probe(machine, length)
        angles, groups = cone_test(own, 100 + seed, 2, 8)
        start = arm.replace(probe=arm.probe + np.array([0, 0, length - 100.0]))
        alone, old, moved = (
            calibrate(start, angles[:15], groups[:15], correction=way, free=["probe"]).arm
            for way in (None, OldProbe(model), model)
        )
        longer = of_two.arm_.replace(probe=of_two.arm_.probe + np.array([0, 0, length - 100.0]))
        both = calibrate(longer, angles[:15], groups[:15], correction=of_two, free=["probe"]).arm
        test = cone_test(own, 200 + seed, 8, 25)
        new_arm, new = fitted(own.nominal_arm, *cone_test(own, 300 + seed, 14, 30))
        rows.append([
            left(alone, None, *test), left(old, model, *test),
            left(moved, model.with_arm(moved), *test), left(both, of_two.with_arm(both), *test),
            left(new_arm, new, *test),
        ])  # fmt: skip
    return rows


def probes(n_arms):
    """Print 2S in um for each probe and way."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = np.mean([one_arm(seed) for seed in range(n_arms)], axis=0)
    ways = (
        "uncorrected",
        "old probe, registered",
        "moved",
        "learnt with two, moved",
        "new fit of 14 cones",
    )
    print("probe / mm" + "".join(f"{way:>24}" for way in ways) + "    2S, um")
    for length, values in zip(PROBES_MM, table, strict=True):
        print(f"{length:10}" + "".join(f"{value:24.1f}" for value in values))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=None, help="poses of A (default all)")
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--probes", action="store_true", help="longer probes, simulated")
    parser.add_argument("--arms", type=int, default=4, help="with other probes")
    options = parser.parse_args()
    if options.probes:
        return probes(options.arms)
    root = os.environ.get("SKLEARN_RAACMM_DATA", Path.home() / "scikit_learn_data")
    folder = Path(root) / "ur10_tracker"
    angles, points = read("A", folder)
    rows = np.random.default_rng(0).permutation(len(angles))[: options.rows]
    first = calibrate(Arm.from_name("ur10", probe=(0, 0, 93)), angles[rows], points=points[rows])
    model = arm_model(first.arm).fit(angles[rows], first.residuals_mm)
    angles, points = read("B", folder)
    print(f"Model of {len(rows)} poses of A, used on B. Mean deviation, mm: median (largest)")
    print("poses  " + "".join(f"{way:>26}" for way in WAYS) + "    seconds: register, update")
    for n in (10, 20, 60, 200):
        draws = []
        for seed in range(options.draws):
            known = np.zeros(len(angles), bool)
            known[np.random.default_rng(seed).permutation(len(angles))[:n]] = True
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                draws.append(one_draw(model, first.arm, angles, points, known))
        left, seconds = (np.array([draw[i] for draw in draws]) for i in range(2))
        cells = [f"{np.median(c):.3f} ({c.max():.3f})" for c in left.T]
        print(f"{n:5}  " + "".join(f"{cell:>26}" for cell in cells), end="")
        print("    " + ", ".join(f"{s:.2f}" for s in np.median(seconds, axis=0)))


if __name__ == "__main__":
    main()
