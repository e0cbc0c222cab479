"""
How many positions, how many poses
==================================

How much must be measured before a correction is worth it, and where? On simulated arms
:class:`~sklearn_raacmm.ArmResidualRegressor` learns from more and more positions of the cone,
with few or many poses at each, and corrects positions that it has never seen.

The data are simulated: two arms. The script takes about a minute. The shaded areas reach from one
arm to the other. With more arms in ``SEEDS`` the curves become smoother.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

from sklearn_raacmm import ArmResidualRegressor, position_residuals
from sklearn_raacmm.datasets import make_single_point

SEEDS = [0, 1]
POSITIONS, POSES = [3, 4, 6, 8, 12, 16], [5, 10, 20]


def deviation(test, correction):
    """Mean distance of the corrected points from the mean of their position, mm."""
    left = position_residuals(test.points - correction, test.groups)
    return np.linalg.norm(left, axis=1).mean()


def fitted(pool, positions, n_poses):
    """Fit some positions of the pool, with some poses of each, evenly over the swing."""
    rows = []
    for position in positions:
        mine = np.flatnonzero(pool.groups == position)
        rows.append(mine[np.linspace(0, len(mine) - 1, n_poses).round().astype(int)])
    rows = np.concatenate(rows)
    residuals = position_residuals(pool.points[rows], pool.groups[rows])
    return ArmResidualRegressor(pool.arm).fit(pool.data[rows], residuals, groups=pool.groups[rows])


# %%
# More positions or more poses?
# -----------------------------
# 100 % is the reduction by a perfect model, which leaves nothing but noise. With few poses at three
# positions a model may find that its correction helps nowhere else. It is 0 then, with a warning
# that is not repeated here.

warnings.filterwarnings("ignore", message="The correction is 0")

by_number = np.zeros((len(SEEDS), len(POSES), len(POSITIONS)))
for k, seed in enumerate(SEEDS):
    pool = make_single_point(max(POSITIONS), max(POSES), random_state=seed)
    test = make_single_point(12, 30, machine=pool.simulation.machine, random_state=seed + 1000)
    before = deviation(test, 0.0)
    possible = before - deviation(test, test.simulation.perfect_correction)

    def share(model, test=test, before=before, possible=possible):
        """Gain at the test positions, in per cent of what is possible."""
        return 100 * (before - deviation(test, model.predict(test.data))) / possible

    order = np.random.default_rng(seed).permutation(max(POSITIONS))
    for i, n_poses in enumerate(POSES):
        for j, n in enumerate(POSITIONS):
            by_number[k, i, j] = share(fitted(pool, order[:n], n_poses))

print("poses" + "".join(f"{n:>6}" for n in POSITIONS) + "  positions")
for n_poses, row in zip(POSES, by_number.mean(axis=0), strict=True):
    print(f"{n_poses:>5}" + "".join(f"{value:>5.0f}%" for value in row))

# %%
# The curves
# ----------

figure, ax = plt.subplots(figsize=(5.5, 3.8), layout="constrained")
styles = (("#E69F00", "s"), ("#009E73", "^"), ("#0072B2", "o"))
for i, (n_poses, (color, marker)) in enumerate(zip(POSES, styles, strict=True)):
    shares = by_number[:, i]  # the mean over the arms, and their range
    ax.fill_between(
        POSITIONS, shares.min(axis=0), shares.max(axis=0), color=color, alpha=0.15, lw=0
    )
    label = f"{n_poses} poses at each"
    ax.plot(POSITIONS, shares.mean(axis=0), color=color, marker=marker, label=label)
ax.set(xlabel="positions", ylabel="reduction (% of what is possible)", xticks=POSITIONS)
ax.set_ylim(-30, 108)
ax.axhline(100, color="0.2", linestyle="--", linewidth=1)
ax.axhline(0, color="0.7", linewidth=1)
ax.legend(fontsize="small", loc="lower right")
figure.suptitle("Simulated arms, positions never seen; dashed: noise floor", fontsize="medium")
plt.show()
