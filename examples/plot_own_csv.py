"""
Bring your own CSV
==================

From a table of joint angles to corrected points, with pandas. What you need:

- one row a pose, one column a joint, in degrees or in radians;
- one column with a label of the position at which the probe was held: the same label means the same
  point. Ten positions, a few dozen poses at each, is a fair start;
- the arm's nominal Denavit-Hartenberg table, from its maker or its drawings.

You do not need coordinates: they follow from the angles. The table here is simulated, written the
way many loggers do, with semicolons and decimal commas, in degrees.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    Arm,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    position_residuals,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.display import RepeatabilityDisplay
from sklearn_raacmm.metrics import repeatability_report

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
# The arm, calibrated
# -------------------
# Lengths in mm, twists in degrees. Calibration needs no coordinates either: points of one position
# have to coincide. If you have measured a gauge, its two ends are two positions, and
# ``lengths=[("left end", "right end", 500.0, 0.01)]`` gives the arm its scale, which no cone can.

nominal = Arm.from_degrees(
    a=[0, 62, 0, 62, 0, 0],
    alpha=[-90, -90, 90, -90, 90, -90],
    d=[376.5, 0, 750, 0, 500, 15],
    probe=(0, 0, 98),
    name="by its drawing",
)
result = calibrate(nominal, angles, positions, angle_unit="deg")
print(f"mean scatter: {result.scatter_before_mm:.3f} mm by the drawing (probe fitted),", end=" ")
print(f"{result.scatter_after_mm:.3f} mm calibrated")
print("not identified:", ", ".join(result.unidentified))

# %%
# The model, judged at positions that it has not seen
# ---------------------------------------------------
# Everything stays in degrees: ``PoseFeatures`` alone has to know.

arm = result.arm
points = arm.forward(angles, angle_unit="deg")
residuals = position_residuals(points, positions)
model = make_pipeline(
    PoseFeatures(arm, angle_unit="deg", joints="all", encoding="periodic", append_azimuth=True),
    CylindricalResidualTarget(make_pipeline(StandardScaler(), RBFNetRegressor(random_state=0))),
)
correction = cross_val_predict(model, angles, residuals, groups=positions, cv=GroupKFold(5))
for name, measured in {"before": points, "after": points - correction}.items():
    report = pd.DataFrame(repeatability_report(measured, positions))
    columns = ["repeatability_2s", "deviation_max"]
    print(f"{name}, mean over positions (mm):", report[columns].mean().round(4).to_dict())

# %%
# Correct what you measure from now on
# ------------------------------------
# Fit once on all positions. Then: joint angles in, corrected point out.

model.fit(angles, residuals)
reading = angles.iloc[[0]]
print("corrected point (mm):", arm.forward(reading, angle_unit="deg") - model.predict(reading))

display = RepeatabilityDisplay.from_predictions(
    points, correction, groups=positions, name="after, position left out"
)
display.ax_.set_title("Your cone-hole test (here: simulated)")
folder.cleanup()
plt.show()
