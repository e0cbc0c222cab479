"""Mistakes in measurements: what is found of them, and how often a sound test raises an alarm.

    python benchmarks/bench_mistakes.py [dwells] [set-ups] [steps]

``dwells``: 90 poses of which a logger wrote 100 rows each, beside one row a pose; mean distances in
um at positions that no fit has seen. ``set-ups``: a tracker or a target that moved half way.
``steps``: simulated arms with eccentric encoders, gravity, backlash, warming, payloads and slipped
probes. Steps are looked for in what `ArmResidualRegressor` leaves, in the order of the test and in
others: sorted by the angle of each joint, by clusters of poses, and shuffled. Then the socket of
one position is moved halfway through its poses, and the model fitted to that. With ``--panda`` two
real Pandas are looked at, too.
"""

import argparse
import warnings
from collections import Counter
from dataclasses import replace

import numpy as np
from sklearn.cluster import KMeans

from sklearn_raacmm import ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import ArmErrors, fetch_panda_ball_socket, make_single_point
from sklearn_raacmm.measurements import find_steps
from sklearn_raacmm.utils import centred

MACHINES = ("typical", "gravity", "eccentricity")
STEPS_MM = (0.03, 0.1, 0.3)
N_POSES = (8, 12, 20, 30, 60)


def um(vectors):
    """Mean length in micrometres."""
    return f"{1e3 * np.linalg.norm(vectors, axis=1).mean():.1f}"


def dwells(options):
    for seed in range(2):
        test = make_single_point(19, 10, random_state=seed)
        train, new = test.groups < 9, test.groups >= 9
        truth = test.points - test.simulation.true_points
        rng = np.random.default_rng(seed)
        for kind in ("cones", "tracker"):
            found = []
            for n in (1, 100):
                rows = np.repeat(np.flatnonzero(train), n)
                angles = test.data[rows] + (n > 1) * rng.normal(0, 5e-6, (len(rows), 6))
                points, groups = test.arm.forward(angles), test.groups[rows]
                y = points - test.simulation.true_points[rows]
                y = position_residuals(points, groups) if kind == "cones" else y
                model = ArmResidualRegressor(test.arm).fit(angles, y, groups=groups)
                left = truth[new] - model.predict(test.data[new])
                found.append(um(centred(left, test.groups[new] - 9)))
            nothing = um(centred(truth[new], test.groups[new] - 9))
            print(f"{kind}, seed {seed}: none {nothing}, one row {found[0]}, stream {found[1]}")


def set_ups(options):
    named = Counter()
    for machine in MACHINES[:2]:
        for seed in range(2):
            test = make_single_point(12, 20, machine=machine, random_state=seed)
            rng = np.random.default_rng(seed)
            for order in ("by cone", "shuffled"):
                rows = rng.permutation(240) if order == "shuffled" else np.arange(240)
                angles, points = test.data[rows], test.simulation.true_points[rows] + [1e3, 500, 0]
                points += rng.normal(0, 0.01, points.shape)
                turns = test.arm.frames(angles)[:, -1, :3, :3]
                for size in (0.0, 0.1, 0.5, 5.0, 50.0):
                    step = size * np.array([0.6, -0.6, 0.5])
                    for what, moved in (
                        ("station", points + step),
                        ("tool", points + turns @ step),
                    ):
                        half = np.where(np.arange(240)[:, None] < 120, points, moved)
                        found = calibrate(test.nominal_arm, angles, points=half).findings
                        rightly = {(f.code, f.rows) for f in found if f.weight == "repair"}
                        named[what, order, size] += (f"moved-{what}", (120,)) in rightly
    for case, n in named.items():
        print(*case, f"mm: named, with its row, in {n} of 4")


def simulated(seed):
    """Angles, residuals, positions and the arm of one simulated test."""
    rng = np.random.default_rng(seed)
    errors = replace(
        ArmErrors.from_name(MACHINES[seed % 3]),
        play_arcsec=float(rng.choice([0, 0, 5])),
        softening_arcsec=float(rng.choice([0, 0, 20])),
        drift_k=float(rng.choice([0, 0, 3])),
        payload_n=float(rng.choice([0, 0, 20])),
        slip_share=float(rng.choice([0, 0.02, 0.08])),
    )
    n_positions, n_poses = int(rng.integers(4, 14)), int(rng.choice(N_POSES))
    test = make_single_point(n_positions, n_poses, machine=errors, random_state=seed)
    return test.data, test.target, test.groups, test.arm


def orders(angles, codes, rng):
    """Orders in which the rows of each position may stand."""
    features = np.hstack([np.cos(angles), np.sin(angles)])
    clusters = KMeans(3, n_init=1, random_state=0).fit_predict(features)
    yield "as measured", np.arange(len(codes))
    for j in range(angles.shape[1]):
        yield f"sorted by joint {j + 1}", np.lexsort((angles[:, j], codes))
    yield "by clusters of poses", np.lexsort((rng.random(len(codes)), clusters, codes))
    yield "shuffled", rng.permutation(len(codes))


def look(arm, angles, y, groups):
    """What the model leaves, positions by number, and the variance of its noise."""
    model = ArmResidualRegressor(arm).fit(angles, y, groups=groups)
    left = y - model.linear_model_.predict(angles)[0]
    return left, np.unique(groups, return_inverse=True)[1].ravel(), model.noise_sd_**2


def steps(options):
    alarms, found, noise = {}, {}, []
    for seed in range(options.first, options.first + options.arms):
        angles, y, groups, arm = simulated(seed)
        rng = np.random.default_rng([1, seed])
        left, codes, variance = look(arm, angles, y, groups)
        noise.append(np.sqrt(variance))
        for name, order in orders(angles, codes, rng):
            moved = find_steps(left[order], angles[order], codes[order], variance)
            alarms[name] = alarms.get(name, 0) + bool(moved)
        rows = np.flatnonzero(codes == rng.integers(codes.max() + 1))
        direction = rng.normal(size=3)
        size = STEPS_MM[seed // 3 % len(STEPS_MM)]
        y[rows[len(rows) // 2 :]] += size * direction / np.linalg.norm(direction)
        # The model is fitted to what was measured, the moved half included.
        left, codes, variance = look(arm, angles, y, groups)
        moved = find_steps(left, angles, codes, variance)
        right = [abs(step.after - rows[len(rows) // 2]) <= 2 for step in moved]
        found.setdefault((size, len(rows)), []).append((any(right), not all(right)))
    print(f"{options.arms} arms, noise {1000 * np.median(noise):.0f} um in the median. Alarms:")
    for name, count in alarms.items():
        print(f"  {name:<24}{count}")
    print("Found of those moved (elsewhere besides), by the number of poses of the position:")
    for size in STEPS_MM:
        cells = []
        for n in N_POSES:
            hits = np.array(found.get((size, n), np.empty((0, 2))))
            cells.append(f"{n}: {hits[:, 0].sum():.0f} of {len(hits)} ({hits[:, 1].sum():.0f})")
        print(f"  {size:g} mm  " + ", ".join(cells))
    for name in ("panda_3", "panda_2") if options.panda else ():
        data = fetch_panda_ball_socket(name, data_home=options.data_home)
        left, codes, variance = look(data.arm, data.data, data.target, data.groups)
        for step in find_steps(left, data.data, codes, variance):
            print(f"{name}, {np.unique(data.groups)[step.code]}: {step}")


PARTS = {"dwells": dwells, "set-ups": set_ups, "steps": steps}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=PARTS, default=list(PARTS))
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--first", type=int, default=5000, help="first seed")
    parser.add_argument("--panda", action="store_true", help="the real arms, too")
    parser.add_argument("--data-home", help="folder of the data (default: scikit-learn's)")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for name in options.parts:
        print(f"\n{name}", flush=True)
        PARTS[name](options)


if __name__ == "__main__":
    main()
