"""
One call, and a verdict
=======================

From a logger's table to a calibrated arm, a correction and a verdict: ``learn_correction``
calibrates, learns what calibration leaves, and judges both at positions that neither has seen. The
same is done by ``raacmm learn`` in the shell.

The table here is simulated: 8 positions with 20 poses each. In one pose the probe slips out of its
seat. The script takes a few seconds.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from sklearn_raacmm import ArmResidualRegressor, learn_correction
from sklearn_raacmm.app import read_table
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.display import RepeatabilityDisplay

# %%
# A file such as yours
# --------------------

simulated = make_single_point(n_positions=8, n_poses=20, random_state=0)
angles = np.rad2deg(simulated.data)
angles[42, 3] += 0.3
written = pd.DataFrame(angles, columns=[f"q{i} [deg]" for i in range(1, 7)])
written.insert(0, "cone", [f"C{label + 1}" for label in simulated.groups])
folder = TemporaryDirectory()
path = Path(folder.name, "cone_test.csv")
written.to_csv(path, sep=";", decimal=",", index=False, encoding="utf-8-sig")

# %%
# Read it
# -------
# ``read_table`` says what it has guessed.

table = read_table(path, n_joints=6)
print(*table.notes, sep="\n")

# %%
# Learn, and see whether it helps
# -------------------------------
# Without ``model=`` an :class:`~sklearn_raacmm.ArmResidualRegressor` is fitted. This page offers it
# fewer harmonics, which is faster. Any regressor of joint angles can take its place, and it is
# judged in the same way.

learned = learn_correction(
    simulated.nominal_arm,
    table.angles,
    table.positions,
    angle_unit=table.angle_unit,
    model=ArmResidualRegressor(orders=12),
)
print(learned)

# %%
# Correct what you measure from now on
# ------------------------------------

points, std = learned.correct(table.angles[:3], angle_unit="deg")
print("corrected points (mm):", points.round(3), sep="\n")
print("standard deviations (mm):", std.round(4), sep="\n")

# %%
# Every position, before and after
# --------------------------------
# ``left_before`` and ``left_after`` are the deviations of every point when it was left out. Rows
# that calibration named as outliers are not counted, such as the one at which the probe slipped.
# The vertical lines are 95 % intervals over the choice of poses.

scores = learned.scores
counted = np.concatenate(scores.rows_by_position)
display = RepeatabilityDisplay.from_predictions(
    scores.left_before[counted],
    scores.left_before[counted] - scores.left_after[counted],
    groups=table.positions[counted],
)
display.ax_.set_title("Positions left out (simulated)")
plt.show()
folder.cleanup()
