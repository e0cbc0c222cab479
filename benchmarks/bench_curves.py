"""Learning curves of the arm's model: what more poses leave, and whether they ever leave more.

    python benchmarks/bench_curves.py
    python benchmarks/bench_curves.py --narrow

The first draws 60 to 400 poses of a real UR10 and a tracker, of real Pandas in single-point tests
(by placements), and of three kinds of simulated arms in wide and narrow ranges of their joints.
Calibration and model learn from these poses; others judge. Printed is the mean deviation that the
correction leaves, over that of the calibrated arm without it.

The second takes simulated arms in narrow ranges only: random poses within 0.25 rad of a centre,
gravity and eccentric encoders, a tracker's noise of 0.01 mm. Calibration has taken the easy
directions out of what is left, which is where a search of the families' variances can stay at zero.
"""

import argparse
import os
import time
import warnings

os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np
from _arm_folds import read_panda, read_ur10

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import SimulatedArm

NOISE_MM, N_OTHERS = 0.01, 400
COUNTS = (60, 90, 125, 200, 300, 400)
SOURCES = ("eccentricity", "torsion", "sag", "wobble", "runout")
KINDS = ("typical", "gravity", "eccentricity")


def deviation(left):
    return float(np.linalg.norm(left, axis=1).mean())


def ranged_arm(seed, width, kind):
    """An arm measured by a tracker in a range of its joints: draws angles, and measures points."""
    rng = np.random.default_rng([21, seed])
    machine = SimulatedArm(kind, random_state=seed)
    centre = np.array([0.0, -0.9, 0.0, 1.4, 0.0, 0.6]) + rng.uniform(-0.4, 0.4, 6)

    def draw(n):
        return centre + rng.uniform(-width, width, (n, 6))

    def measure(angles, noise):
        off = machine.deviations(angles)
        points = machine.true_arm.forward(angles) + sum(off[name] for name in SOURCES)
        return points + rng.normal(0, noise, points.shape)

    return machine.nominal_arm, draw, measure


def tracked(arm, angles, points, train, others):
    """What a model of some rows leaves at others, over nothing; and the model."""
    found = calibrate(arm, angles[train], points=points[train])
    model = ArmResidualRegressor(found.arm).fit(angles[train], found.residuals_mm)
    y = found.residuals(angles[others], points[others])
    return deviation(y - model.predict(angles[others])) / deviation(y), deviation(y), model


def narrow(n_draws, n_poses, width=0.25):
    """One line a draw: what is left, and the deviations that the families were given."""
    ratios, start = [], time.process_time()
    for seed in range(n_draws):
        arm, draw, measure = ranged_arm(seed, width, "gravity")
        angles = np.concatenate([draw(n_poses), draw(N_OTHERS)])
        points = measure(angles, NOISE_MM)
        points[n_poses:] = measure(angles[n_poses:], 0.0)
        rows = np.arange(len(angles))
        ratio, size, model = tracked(arm, angles, points, rows < n_poses, rows >= n_poses)
        ratios.append(ratio)
        sizes = " ".join(f"{name} {sd:.3g}" for name, sd in model.prior_sd_.items())
        print(f"{seed:3} left {ratio:.3f} of {size:.4f} mm; arc seconds: {sizes}", flush=True)
    mean, seconds = np.exp(np.mean(np.log(ratios))), time.process_time() - start
    print(
        f"{n_draws} arms, {n_poses} poses: geometric mean {mean:.3f}, worst {max(ratios):.3f}, "
        f"gained in {np.sum(np.less(ratios, 1))}; {seconds:.0f} CPU s"
    )


def ur10_curve(seed):
    """Ratio by number of poses of series A."""
    angles, points, goals = read_ur10("A")
    rng = np.random.default_rng([22, seed])
    order = rng.permutation(goals.max() + 1)
    others = np.flatnonzero(np.isin(goals, order[: len(order) // 5]))
    rest = rng.permutation(np.flatnonzero(~np.isin(goals, order[: len(order) // 5])))
    nominal = Arm.from_name("ur10", probe=(0, 0, 93))
    return [tracked(nominal, angles, points, rest[:n], others)[0] for n in COUNTS]


def panda_curve(name, seed):
    """The same of a Panda: a third of the placements is left out, at least one."""
    angles, sockets, placements = read_panda(name)
    rng = np.random.default_rng([23, seed])
    labels = rng.permutation(np.unique(placements))
    out = np.isin(placements, labels[: max(1, len(labels) // 3)])
    rest, ratios = rng.permutation(np.flatnonzero(~out)), []
    for n in COUNTS:
        train = rest[:n]
        used, counts = np.unique(sockets[train], return_counts=True)
        train = train[np.isin(sockets[train], used[counts > 1])]
        here = set(sockets[train])
        both = [p for p in np.unique(placements) if {f"{p}/0", f"{p}/1"} <= here]
        lengths = [(f"{p}/0", f"{p}/1", 50.0, 0.1) for p in both]
        nominal = Arm.from_name("panda", probe=(0, 0, 138))
        arm = calibrate(nominal, angles[train], sockets[train], lengths=lengths).arm
        y = position_residuals(arm.forward(angles), sockets)
        own = position_residuals(arm.forward(angles[train]), sockets[train])
        model = ArmResidualRegressor(arm).fit(angles[train], own, groups=sockets[train])
        left = position_residuals(y[out] - model.predict(angles[out]), sockets[out])
        ratios.append(deviation(left) / deviation(y[out]))
    return ratios


def simulated_curve(kind, width, seed):
    """The same of a simulated arm and a tracker."""
    arm, draw, measure = ranged_arm(100 + seed, width, kind)
    angles = draw(max(COUNTS) + N_OTHERS)
    points = measure(angles, NOISE_MM)
    rows = np.arange(len(angles))
    return [tracked(arm, angles, points, rows < n, rows >= max(COUNTS))[0] for n in COUNTS]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--narrow", action="store_true", help="simulated arms in narrow ranges")
    parser.add_argument("--draws", type=int, default=0, help="20 narrow ones, 3 of each curve")
    parser.add_argument("--poses", type=int, default=300, help="of each narrow arm")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.narrow:
        narrow(options.draws or 20, options.poses)
        return
    curves = {"UR10 A": ur10_curve}
    for name in ("panda_2", "panda_3", "panda_6", "panda_7"):
        curves[name] = lambda seed, name=name: panda_curve(name, seed)
    for kind in KINDS:
        for width in (0.25, 2.0):
            curves[f"{kind}, +-{width:g} rad"] = lambda seed, kind=kind, width=width: (
                simulated_curve(kind, width, seed)
            )
    print(f"{'poses':22}" + "".join(f"{n:>8}" for n in COUNTS) + "  worst rise")
    for name, curve in curves.items():
        ratios = np.exp(np.mean([np.log(curve(s)) for s in range(options.draws or 3)], axis=0))
        rise = (ratios[1:] / ratios[:-1]).max()
        print(f"{name:22}" + "".join(f"{v:8.3f}" for v in ratios) + f"{rise:12.2f}", flush=True)


if __name__ == "__main__":
    main()
