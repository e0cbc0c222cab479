"""What a plan of a first test by :func:`plan_poses` is worth on simulated arms, against chance.

Mean 2S in um at 8 other cones after a first test of 8 cones with 12 poses each: where cones and
poses come by chance, where the cones are spread and poses come by chance, and as
:func:`plan_poses` has them, with a probe that leans at most 60 degrees or comes from anywhere. The
other cones have poses by chance, or those of another plan with a lean of 60.

Run it with ``python benchmarks/bench_first_test.py`` (two minutes).
"""

import argparse
import warnings

import numpy as np

from sklearn_raacmm import ArmResidualRegressor, calibrate, plan_poses
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability


def read(machine, plan, seed, angles=None):
    """Angles and labels of a plan as the machine reads them, the probe seated anew each time."""
    angles = plan.angles if angles is None else angles
    rng, cones = np.random.RandomState(seed), plan.positions[plan.groups - 1]
    cones = cones + machine.errors.seating_um / 1000 * rng.normal(size=cones.shape)
    return machine.read(machine.solve(angles, cones), rng), plan.groups


def main():
    """Print a line for each way to choose a first test."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=8)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    found = {}
    for seed in range(options.arms):
        machine = SimulatedArm("typical", random_state=seed)
        plans = {
            lean: plan_poses(machine.nominal_arm, 8, 12, lean_deg=lean, random_state=seed)
            for lean in (60.0, None)
        }
        other = plan_poses(machine.nominal_arm, 8, 25, lean_deg=60, random_state=99)
        chance = make_single_point(8, 12, machine=machine, random_state=seed)
        cones = plans[60.0].positions
        spread = np.concatenate([machine.find_poses(place, 12, seed) for place in cones])
        far = make_single_point(8, 25, machine=machine, random_state=1000 + seed)
        judged = (far.data, far.groups), read(machine, other, 1)
        tests = {
            "by chance": (chance.data, chance.groups),
            "spread cones": read(machine, plans[60.0], 2, spread),
            "planned, lean 60": read(machine, plans[60.0], 2),
            "planned": read(machine, plans[None], 2),
        }
        for name, (angles, labels) in tests.items():
            result = calibrate(machine.nominal_arm, angles, labels)
            model = ArmResidualRegressor(result.arm)
            model.fit(angles, result.residuals_mm, groups=labels)
            found.setdefault(name, []).append([
                1000 * single_point_repeatability(result.arm.forward(q) - model.predict(q), groups)
                for q, groups in judged
            ])  # fmt: skip
    print("2S in um at other cones: with poses by chance, and planned")
    for name, values in found.items():
        print(f"{name:18} {np.mean(values, axis=0).round(1)}")


if __name__ == "__main__":
    main()
