"""
A real arm against itself
=========================

A Franka Panda held a ball in sockets and moved through many poses. The authors of MUKCa did this
single-point test with a real arm. Each of the six placements of the
sockets is left out once. The arm is calibrated and the models are fitted on the other five. Their
predictions are subtracted at the placement left out.

The data are real: 387 poses of the arm ``panda_3``. They are not part of this package and are
downloaded the first time. The script takes about half a minute.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.base import clone
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    position_residuals,
)
from sklearn_raacmm.datasets import fetch_panda_ball_socket
from sklearn_raacmm.metrics import repeatability_interval, single_point_repeatability

data = fetch_panda_ball_socket("panda_3")
names = np.unique(data.placements)
print(f"{len(data.data)} poses in {len(np.unique(data.groups))} sockets, {len(names)} placements")

# %%
# Calibrate and fit without one placement
# ---------------------------------------
# Nothing of a placement is used before it is judged: calibration, too, sees the other placements
# only. Rows that calibration names as outliers are not learnt from. At the placement left out
# every point counts.


def network(arm, inputs):
    """Build the paper's chain; with its own inputs it sees three angles of the pose."""
    steps = make_pipeline(PoseFeatures(arm, **inputs), RBFNetRegressor())
    return CylindricalResidualTarget(steps, azimuth=arm.azimuth)


def models(arm):
    """Build the models to compare, for one calibrated arm."""
    return {
        "network, three pose angles": network(arm, {}),
        "network, all joints": network(arm, {"joints": "all", "encoding": "periodic"}),
        "ArmResidualRegressor": ArmResidualRegressor(arm),
    }


corrected = {}
for name in names:
    train, test = data.placements != name, data.placements == name
    known = [length for length in data.lengths if not length[0].startswith(f"{name}/")]
    result = calibrate(data.nominal_arm, data.data[train], data.groups[train], lengths=known)
    arm, learn = result.arm, np.flatnonzero(train)[result.sample_weight > 0]
    points = arm.forward(data.data)
    residuals = position_residuals(points[learn], data.groups[learn])
    corrected.setdefault("calibrated, uncorrected", np.empty_like(points))[test] = points[test]
    for model_name, model in models(arm).items():
        model = clone(model)
        model.fit(data.data[learn], residuals, groups=data.groups[learn])
        left = points[test] - model.predict(data.data[test])
        corrected.setdefault(model_name, np.empty_like(points))[test] = left

# %%
# At the placements left out
# --------------------------
# The mean distance of a point from the mean of its socket, and the repeatability 2S. Its 95 %
# interval says what another choice of poses in the same sockets would change.

rows = {}
for name, points in corrected.items():
    distance = np.linalg.norm(position_residuals(points, data.groups), axis=1)
    spread = single_point_repeatability(points, data.groups, aggregate=None)
    ends = repeatability_interval(points, data.groups, aggregate=None)
    rows[name] = spread, np.abs(ends.T - spread)
    low, high = repeatability_interval(points, data.groups)
    print(
        f"{name:<28} mean {distance.mean():.3f} mm, "
        f"2S {spread.mean():.3f} mm ({low:.3f} to {high:.3f})"
    )

# %%
# The three angles of the paper explain a part. The geometry of the whole arm, with the harmonics of
# each joint, explains more of what is left.

figure, axes = plt.subplots(figsize=(6.4, 5), layout="constrained")
place = np.arange(len(np.unique(data.groups)))
styles = [("#D55E00", "o"), ("0.5", "s"), ("#E69F00", "^"), ("#0072B2", "D")]
for shift, (name, (spread, length)), (color, marker) in zip(
    (-0.24, -0.08, 0.08, 0.24), rows.items(), styles, strict=True
):
    label = f"{name}, mean {spread.mean():.3f} mm"
    axes.errorbar(place + shift, spread, length, fmt=marker, color=color, ms=5, lw=1, label=label)
axes.set_xticks(place, np.unique(data.groups), rotation=45, ha="right")
axes.set(
    xlabel="socket",
    ylabel="repeatability 2S (mm)",
    title="panda_3 (real): placements that no model saw",
)
axes.set_ylim(0, 1.7 * max(spread.max() for spread, _ in rows.values()))
axes.legend(fontsize="small", loc="upper left")
plt.show()
