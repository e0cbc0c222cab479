"""
Bring your own CSV
==================

From a table of joint angles to corrected points, with pandas. What you need:

- one row for each pose and one column for each joint, in degrees or in radians;
- one column with a label of the position at which the probe was held: the same label means the same
  point. Ten positions with a few dozen poses each are a fair start;
- the arm's nominal Denavit-Hartenberg table, from its maker or its drawings.

You do not need coordinates: they follow from the angles. The table here is simulated: 10 positions
with 30 poses each, written as many loggers do it, with semicolons and decimal commas, in degrees.
The script takes about a minute.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from sklearn_raacmm import Arm, learn_correction
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.display import RepeatabilityDisplay

# %%
# A file such as yours
# --------------------
# Skip this part: it writes the file that you already have.

folder = TemporaryDirectory()
path = Path(folder.name, "cone_test.csv")
simulated = make_single_point(n_positions=10, n_poses=30, random_state=0)
written = pd.DataFrame(np.rad2deg(simulated.data), columns=[f"q{i}" for i in range(1, 7)])
written["position"] = [f"cone {label + 1:02d}" for label in simulated.groups]
written.to_csv(path, sep=";", decimal=",", index=False, float_format="%.6f")
print(path.read_text().splitlines()[0])
print(path.read_text().splitlines()[1])

# %%
# Read it, and look at it
# -----------------------
# Angles of more than two turns in a file that is said to be in radians are degrees. The package
# warns of them, but a small swing in degrees passes for a large one in radians: look.

table = pd.read_csv(path, sep=";", decimal=",")
angles, positions = table[[f"q{i}" for i in range(1, 7)]], table["position"]
print(angles.describe().loc[["min", "max"]].round(1))
print(positions.value_counts(sort=False).to_string())

# %%
# The arm
# -------
# Lengths in mm, twists in degrees. The table need not be exact, for calibration corrects it.

nominal = Arm.from_degrees(
    a=[0, 62, 0, 62, 0, 0],
    alpha=[-90, -90, 90, -90, 90, -90],
    d=[376.5, 0, 750, 0, 500, 15],
    probe=(0, 0, 98),
    name="by its drawing",
)

# %%
# Calibrate, learn, and ask whether it helps
# ------------------------------------------
# One call does all three. Calibration asks that the points of one position coincide. The model
# learns what calibration leaves. Both are judged at positions that were left out. If you have
# measured a gauge, its two ends are two positions, and
# ``lengths=[("left end", "right end", 500.0, 0.01)]`` gives the arm its scale, which no cone can.

learned = learn_correction(nominal, angles, positions, angle_unit="deg")
print(learned)

# %%
# The figure shows every position before and after. The lines are 95 % intervals over the choice of
# poses.

scores = learned.scores
counted = np.concatenate(scores.rows_by_position)
display = RepeatabilityDisplay.from_predictions(
    scores.left_before[counted],
    scores.left_before[counted] - scores.left_after[counted],
    groups=positions.to_numpy()[counted],
    name="after, position left out",
)
display.ax_.set_title("Your cone-hole test (here: simulated)")
plt.show()

# %%
# Correct what you measure from now on
# ------------------------------------
# Joint angles in, corrected points and their standard deviations out. ``learned.save("my_arm")``
# keeps the arm, the model and the scores in a folder.

points, std = learned.correct(angles.iloc[:2], angle_unit="deg")
print("corrected points (mm):", points.round(3), "standard deviations:", std.round(4), sep="\n")
folder.cleanup()
