"""A correction learnt with one probe, used with others: 2S at new cones.

A simulated arm is calibrated and learnt with a probe of 100 mm at 14 cones. Then it gets longer
probes, each registered through the correction in two cones, 15 poses in all. At 8 other cones the
mean 2S is printed: without a correction; with that of the old probe, registered; with the same
causes through the Jacobian of the new probe (``model.with_arm``, which `calibrate` does by itself);
moved in the same way, but learnt with probes of 100 and 250 mm together, 7 cones each; and with a
new fit on 14 cones of the new probe.

Run it with ``python benchmarks/bench_probes.py`` (three minutes).
"""

import argparse
import warnings
from copy import copy

import numpy as np

from sklearn_raacmm import ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

PROBES_MM = (100, 150, 250, 400)


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


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=4)
    options = parser.parse_args()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = np.mean([one_arm(seed) for seed in range(options.arms)], axis=0)
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


if __name__ == "__main__":
    main()
