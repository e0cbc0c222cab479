"""
A real robot against a laser tracker
====================================

A UR10 went to 619 goal positions in up to 24 orientations each, while a laser tracker measured
where it really was. The 11 911 poses are published with "A Hybrid Neural Network Approach for
Increasing the Absolute Accuracy of Industrial Robots" (IEEE CASE 2021). Here the residual is known
in full, not only up to one constant per position.

This page uses about 1500 of the poses, at goals drawn at random, and takes about a minute. The
:doc:`evidence </evidence>` is from another such draw, so that its numbers differ a little. The data
are real. They are not part of this package and are downloaded the first time.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import GroupKFold
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
)
from sklearn_raacmm.datasets import fetch_ur10_tracker

data = fetch_ur10_tracker()
goals = np.random.default_rng(0).permutation(data.groups.max() + 1)[:80]
rows = np.isin(data.groups, goals)
angles, points, groups = data.data[rows], data.tracker_points[rows], data.groups[rows]
print(f"{len(angles)} of {len(data.data)} poses, at {len(goals)} goal positions")

# %%
# Goals are left out, never single poses
# --------------------------------------
# Poses of one goal resemble each other. Whoever draws test poses at random therefore promises more
# than the correction will keep. Calibration, too, sees the training goals only; it fits the place
# of the robot's base in the tracker's frame, and the tracker's target on the flange.

left = {name: np.empty_like(points) for name in ("uncorrected", "network", "harmonics")}
for train, test in GroupKFold(3).split(angles, groups=groups):
    result = calibrate(data.nominal_arm, angles[train], points=points[train])
    arm = result.arm
    true = (points - result.base_translation) @ result.base_rotation
    residuals = arm.forward(angles) - true
    features = PoseFeatures(arm, joints="all", encoding="periodic")
    models = {
        "network": CylindricalResidualTarget(
            make_pipeline(features, RBFNetRegressor(random_state=0)),
            azimuth=arm.azimuth,
        ),
        "harmonics": ArmResidualRegressor(arm),
    }
    left["uncorrected"][test] = residuals[test]
    for name, model in models.items():
        model.fit(angles[train], residuals[train])
        left[name][test] = residuals[test] - model.predict(angles[test])

# %%
# At goals never trained on
# -------------------------
# The interval in brackets is what other goals would change (95 %, bootstrap over goals).

names = {
    "uncorrected": "calibrated, uncorrected",
    "network": "RBF network, all joints",
    "harmonics": "ArmResidualRegressor",
}
figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
lines = ("--", ":", "-")
for (key, name), line, color in zip(
    names.items(), lines, ("#D55E00", "0.45", "#0072B2"), strict=True
):
    distance = np.linalg.norm(left[key], axis=1)
    of_goals = np.array([distance[groups == goal].mean() for goal in goals])
    drawn = np.random.default_rng(0).choice(of_goals, (2000, len(goals)))
    low, high = np.quantile(drawn.mean(axis=1), [0.025, 0.975])
    print(
        f"{name:<24} mean {distance.mean():.3f} mm ({low:.3f} to {high:.3f}), "
        f"95 % of poses below {np.quantile(distance, 0.95):.3f} mm"
    )
    share = np.arange(1, len(distance) + 1) / len(distance)
    axes.plot(
        np.sort(distance), share, line, color=color, label=f"{name}: {distance.mean():.3f} mm"
    )
axes.set(
    xlabel="distance from the tracker's point (mm)",
    ylabel="share of poses",
    title="UR10 (real), at goals that no model has seen",
    ylim=(0, 1),
    xlim=(0, np.quantile(np.linalg.norm(left["uncorrected"], axis=1), 0.999)),
)
axes.legend(fontsize="small", loc="lower right", title="mean distance")
plt.show()
