"""
The paper's three figures, redrawn
==================================

Gao et al. (2020) show the single-point repeatability at ten positions and the lengths of 300 mm and
500 mm gauges, before and after the correction. A third figure has the residuals against the three
angles of the pose. Here are the same figures from a simulated arm, with the paper's three inputs.
The model never saw the position that it corrects, nor any gauge.

The data are simulated: an arm whose errors come from gravity above all, 10 positions with 60 poses
each. The script takes about half a minute.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_gauge, make_single_point
from sklearn_raacmm.display import RepeatabilityDisplay
from sklearn_raacmm.metrics import gauge_lengths, length_error
from sklearn_raacmm.residuals import cartesian_to_cylindrical

cone = make_single_point(n_positions=10, n_poses=60, machine="gravity", random_state=0)
gauge = make_gauge(machine="gravity", random_state=0)
model = CylindricalResidualTarget(
    make_pipeline(PoseFeatures(cone.arm), RBFNetRegressor(random_state=0)),
    azimuth=cone.arm.azimuth,
)
positions = {"groups": cone.groups}  # which rows are of one position
correction = cross_val_predict(
    model, cone.data, cone.target, groups=cone.groups, cv=LeaveOneGroupOut(), params=positions
)

# %%
# Single-point repeatability
# --------------------------
# Each position is corrected by a model of the other nine.

display = RepeatabilityDisplay.from_predictions(
    cone.points, correction, groups=cone.groups + 1, perfect=cone.simulation.perfect_correction
)
display.figure_.suptitle("Simulated arm (gravity), three inputs")
plt.show()

# %%
# Lengths
# -------
# A cone shows a residual only up to one constant for each position. The lengths between positions
# are therefore seen worse than the scatter within them.

model.fit(cone.data, cone.target, **positions)
corrections = {
    "before": 0.0,
    "after": model.predict(gauge.data),
    "noise floor": gauge.simulation.perfect_correction,
}
sizes = np.unique(gauge.lengths)
figure, axes = plt.subplots(1, len(sizes), figsize=(8.4, 3.8), sharey=True, layout="constrained")
for name, marker in zip(corrections, "oD_", strict=True):
    measured = gauge_lengths(gauge.points - corrections[name], gauge.groups, gauge.pairs)
    error = 1000 * length_error(measured, gauge.lengths)
    for ax, size in zip(axes, sizes, strict=True):
        some = error[gauge.lengths == size]
        label = f"{name}: mean |error| {np.abs(some).mean():.1f} µm"
        ax.plot(np.arange(1, len(some) + 1), some, marker, label=label)
        ax.set(xlabel="placement", title=f"{size:g} mm")
        ax.legend(fontsize="small")
axes[0].set_ylabel("measured - calibrated (µm)")
figure.suptitle("Simulated arm (gravity), three inputs")
plt.show()

# %%
# Residuals against the pose
# --------------------------

pose = np.rad2deg(PoseFeatures(cone.arm).fit_transform(cone.data))
azimuth = cone.arm.azimuth(cone.data)
figure, axes = plt.subplots(3, 3, figsize=(8, 6.5), sharex="col", sharey=True, layout="constrained")
for name, left in (("before", cone.target), ("after", cone.target - correction)):
    parts = 1000 * cartesian_to_cylindrical(left, azimuth)
    for i, j in np.ndindex(3, 3):
        axes[i, j].plot(pose[:, j], parts[:, i], ".", markersize=4, alpha=0.5, label=name)
for row, component in zip(axes, ("radial", "tangential", "axial"), strict=True):
    row[0].set_ylabel(f"{component} residual (µm)")
for ax, angle in zip(axes[-1], ("theta3", "theta4", "theta_dis"), strict=True):
    ax.set_xlabel(f"{angle} (deg)")
axes[0, 2].legend(fontsize="small", markerscale=3)
figure.suptitle("Simulated arm (gravity), three inputs")
plt.show()
