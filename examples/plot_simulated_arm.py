"""
A simulated arm, before and after
=================================

In the single-point test of a measuring arm the probe sits in a cone while the elbow swings, and all
points should coincide. The arm has been calibrated. What is left comes from eccentric encoders,
bending tubes and heat. Two models learn it from the joint angles. The paper's network sees three
angles of the pose. :class:`~sklearn_raacmm.ArmResidualRegressor` knows the arm's geometry, and
corrects only where this helps.

Each position is corrected by models that were fitted on the other positions. The data are
simulated: 10 positions with 40 poses each. The script takes about 20 seconds.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.display import RepeatabilityDisplay
from sklearn_raacmm.metrics import repeatability_interval, single_point_repeatability

data = make_single_point(n_positions=10, n_poses=40, random_state=0)
print(data.arm)

# %%
# Two models
# ----------
# Both take joint angles in rad and return the residual dx, dy, dz in mm. Both are given which rows
# belong to one position (``groups``), because each position has an unknown offset.
# :class:`~sklearn_raacmm.ArmResidualRegressor` also checks itself at positions that it leaves out.

network = CylindricalResidualTarget(
    make_pipeline(PoseFeatures(data.arm), RBFNetRegressor(random_state=0)),
    azimuth=data.arm.azimuth,
)
whole = ArmResidualRegressor(data.arm)
folds = list(GroupKFold(5).split(data.data, groups=data.groups))
models = {
    "after, network on three pose angles": (network, "groups"),
    "after, ArmResidualRegressor": (whole, "groups"),
}
corrections = {
    name: cross_val_predict(model, data.data, data.target, cv=folds, params={key: data.groups})
    for name, (model, key) in models.items()
}

# %%
# What a position gains
# ---------------------
# 2S is the single-point repeatability, twice the standard deviation of a point about the mean of
# its position. In a simulation the noise floor is known, too: a perfect model would reach it.

perfect = data.simulation.perfect_correction
rows = {"before": 0.0, **corrections, "noise floor": perfect}
for name, correction in rows.items():
    corrected = data.points - correction
    low, high = repeatability_interval(corrected, data.groups)
    mean = single_point_repeatability(corrected, data.groups)
    print(f"{name:<36} mean 2S {1e3 * mean:5.1f} µm (95 %: {1e3 * low:.1f} to {1e3 * high:.1f})")

# %%
# The figure
# ----------
# Above, the points of one position seen from the side. Below, all positions, with 95 % intervals:
# what another choice of poses at the same positions would change.

after = data.points - corrections["after, ArmResidualRegressor"]
spread = single_point_repeatability(after, data.groups, aggregate=None)
shown = int(np.argsort(spread)[5])  # neither the best nor the worst position
rows = data.groups == shown
figure, axes = plt.subplots(3, 1, figsize=(6, 11), layout="constrained")
for points, color, marker, label in (
    (data.points, "#D55E00", "o", "before"),
    (after, "#0072B2", "D", "after"),
):
    deviation = 1e3 * (points[rows] - points[rows].mean(axis=0))
    axes[0].scatter(deviation[:, 0], deviation[:, 2], 18, color=color, marker=marker, label=label)
axes[0].set(
    xlabel="x less its mean (µm)",
    ylabel="z less its mean (µm)",
    title=f"Points in one cone (position {shown + 1})",
    aspect="equal",
)
axes[0].legend(fontsize="small")
titles = ("Network on three pose angles", "ArmResidualRegressor")
for ax, title, correction in zip(axes[1:], titles, corrections.values(), strict=True):
    RepeatabilityDisplay.from_predictions(
        data.points, correction, groups=data.groups + 1, perfect=perfect, ax=ax
    )
    ax.set_title(title)
axes[2].set_ylim(axes[1].get_ylim())
figure.suptitle("Simulated: each position corrected by models of the others")
plt.show()
