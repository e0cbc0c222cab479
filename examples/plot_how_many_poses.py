"""
How many positions, how many poses
==================================

How much must be measured before a correction is worth it, and where? On simulated arms, a model of
the arm itself (:class:`~sklearn_raacmm.JointHarmonicRegressor`) learns from ever more positions of
the cone, with few or many poses at each, and corrects positions that it has never seen. Then
:func:`~sklearn_raacmm.next_poses` chooses the positions from those in reach, instead of chance.
"""

import argparse
import time

import numpy as np
from _comparison import figure_file
from matplotlib import pyplot as plt

from sklearn_raacmm import JointHarmonicRegressor, next_poses, position_residuals
from sklearn_raacmm.datasets import SimulatedArm, make_single_point

POSITIONS = [3, 4, 6, 8, 12, 16, 24]
POSES = [5, 10, 20, 40]
FIRST, ROUNDS = 4, 8


def deviation(test, correction):
    """Mean distance of the corrected points from the mean of their position, mm."""
    left = position_residuals(test.points - correction, test.groups)
    return np.linalg.norm(left, axis=1).mean()


def fitted(pool, positions, n_poses):
    """Model of some positions of the pool, with some poses of each, evenly over the swing."""
    rows = []
    for position in positions:
        mine = np.flatnonzero(pool.groups == position)
        rows.append(mine[np.linspace(0, len(mine) - 1, n_poses).round().astype(int)])
    rows = np.concatenate(rows)
    residuals = position_residuals(pool.points[rows], pool.groups[rows])
    model = JointHarmonicRegressor(pool.arm, n_harmonics=12)
    return model.fit(pool.data[rows], residuals, groups=pool.groups[rows])


def curves(machine, seed):
    """Share of what is possible, by positions and poses; and with chosen and random positions."""
    pool = make_single_point(max(POSITIONS), max(POSES), machine=machine, random_state=seed)
    test = make_single_point(12, 30, machine=machine, random_state=seed + 1000)
    before, floor = deviation(test, 0.0), deviation(test, test.simulation.perfect_correction)

    def share(model):
        return (before - deviation(test, model.predict(test.data))) / (before - floor)

    rng = np.random.default_rng(seed)
    order = rng.permutation(max(POSITIONS))
    grid = [[share(fitted(pool, order[:n], k)) for n in POSITIONS] for k in POSES]

    # One position at a time: by the posterior of what is known, or at random.
    chosen = order[:FIRST].tolist()
    by_posterior = [share(fitted(pool, chosen, 20))]
    for _ in range(ROUNDS):
        rest = ~np.isin(pool.groups, chosen)
        model = fitted(pool, chosen, 20)
        chosen += next_poses(model, pool.data[rest], 1, groups=pool.groups[rest])[0].tolist()
        by_posterior.append(share(fitted(pool, chosen, 20)))
    by_chance = []
    for _ in range(3):
        others = [*order[:FIRST], *rng.permutation(order[FIRST:])]
        by_chance.append([share(fitted(pool, others[: FIRST + i], 20)) for i in range(ROUNDS + 1)])
    return grid, by_posterior, np.mean(by_chance, axis=0)


def main(argv=None):
    """Run the job."""
    parser = argparse.ArgumentParser(description="How many positions and poses.")
    parser.add_argument("--machines", type=int, default=4, help="simulated arms (default: 4)")
    parser.add_argument("--figure", type=figure_file, help="file to save the figure to")
    args = parser.parse_args(argv)
    start = time.perf_counter()
    found = [curves(SimulatedArm("typical", random_state=s), s) for s in range(args.machines)]
    grid, chosen, chance = (np.array(part) for part in zip(*found, strict=True))

    print(f"Share of what a perfect model takes off, mean of {args.machines} simulated arms.")
    print(f"{'poses':>6}" + "".join(f"{n:>7}" for n in POSITIONS) + "  positions")
    for k, row in zip(POSES, grid.mean(axis=0), strict=True):
        print(f"{k:>6}" + "".join(f"{value:>7.0%}" for value in row))
    print(f"\n{'positions':<10}" + "".join(f"{FIRST + i:>7}" for i in range(ROUNDS + 1)))
    for name, rows in (("chosen", chosen), ("random", chance)):
        print(f"{name:<10}" + "".join(f"{value:>7.0%}" for value in rows.mean(axis=0)))
    print(f"{time.perf_counter() - start:.0f} s")

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained", sharey=True)
    for k, row in zip(POSES, grid.mean(axis=0), strict=True):
        left.plot(POSITIONS, 100 * row, marker="o", label=f"{k} poses at each")
    left.set(xscale="log", xlabel="positions", ylabel="deviation taken off (% of possible)")
    left.set_xticks(POSITIONS, POSITIONS)
    left.minorticks_off()
    x = FIRST + np.arange(ROUNDS + 1)
    right.plot(x, 100 * chosen.mean(axis=0), marker="o", label="chosen by next_poses")
    right.plot(x, 100 * chance.mean(axis=0), marker="o", color="0.5", label="at random")
    right.set(xlabel="positions, 20 poses at each")
    for ax in (left, right):
        ax.axhline(100, color="0.2", linestyle="--", linewidth=1)
        ax.axhline(0, color="0.7", linewidth=1)
        ax.legend(fontsize="small", loc="lower right")
    left.set_ylim(-30, 108)
    figure.suptitle("Simulated arms, positions never seen; dashed: noise floor", fontsize="medium")
    if args.figure is not None:
        figure.savefig(args.figure, dpi=120)
    plt.show()


if __name__ == "__main__":
    main()
