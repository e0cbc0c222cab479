"""
A simulated arm, before and after
=================================

The single-point test of a measuring arm: the probe sits in a cone while the elbow swings, and all
points should coincide. The arm has been calibrated; what is left comes from eccentric encoders,
bending tubes and heat. Two models learn it from the joint angles: the paper's network, which sees
three angles of the pose, and :class:`~sklearn_raacmm.ArmResidualRegressor`, which knows the arm's
geometry and guards itself.

Each position is corrected by models that were fitted on the other positions. The data are
simulated: 10 positions with 40 poses each. The script takes about 20 seconds.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

data = make_single_point(n_positions=10, n_poses=40, random_state=0)
print(data.arm)

# %%
# Two models
# ----------
# Both take joint angles in rad and return the residual dx, dy, dz in mm.
# :class:`~sklearn_raacmm.ArmResidualRegressor` is told which rows belong to one position
# (`groups`): each position has an unknown offset, and the model checks itself at positions that it
# leaves out.

network = CylindricalResidualTarget(
    make_pipeline(PoseFeatures(data.arm), StandardScaler(), RBFNetRegressor(random_state=0)),
    azimuth=data.arm.azimuth,
)
whole = ArmResidualRegressor(data.arm)
folds = list(GroupKFold(5).split(data.data, groups=data.groups))
corrections = {
    "after, network on three pose angles": cross_val_predict(
        network, data.data, data.target, cv=folds
    ),
    "after, ArmResidualRegressor": cross_val_predict(
        whole, data.data, data.target, cv=folds, params={"groups": data.groups}
    ),
}

# %%
# What a position gains
# ---------------------
# 2S is the single-point repeatability, twice the standard deviation of a point about the mean of
# its position. In a simulation the noise floor is known, too: a perfect model would reach it.

spread = {"before": single_point_repeatability(data.points, data.groups, aggregate=None)}
for name, correction in corrections.items():
    corrected = data.points - correction
    spread[name] = single_point_repeatability(corrected, data.groups, aggregate=None)
perfect = data.points - data.simulation.perfect_correction
spread["noise floor"] = single_point_repeatability(perfect, data.groups, aggregate=None)
for name, values in spread.items():
    print(f"{name:<36} 2S mean {1e3 * values.mean():5.1f} um, largest {1e3 * values.max():5.1f} um")

# %%
# The figure
# ----------
# To the left, the points of one position seen from the side; to the right, all positions.

shown = int(np.argsort(spread["after, ArmResidualRegressor"])[5])  # neither the best nor the worst
rows = data.groups == shown
figure, (left, right) = plt.subplots(
    1, 2, figsize=(10, 4), width_ratios=[1, 1.5], layout="constrained"
)
after = data.points - corrections["after, ArmResidualRegressor"]
for points, color, marker, label in (
    (data.points, "tab:orange", "o", "before"),
    (after, "tab:blue", "D", "after"),
):
    deviation = 1e3 * (points[rows] - points[rows].mean(axis=0))
    left.scatter(deviation[:, 0], deviation[:, 2], 18, color=color, marker=marker, label=label)
left.set(
    xlabel="x less its mean (um)",
    ylabel="z less its mean (um)",
    title=f"Points in one cone (position {shown + 1})",
    aspect="equal",
)
left.legend(fontsize="small")
styles = [("tab:orange", "o"), ("0.45", "s"), ("tab:blue", "D"), ("black", "_")]
place = np.arange(1, len(spread["before"]) + 1)
for (name, values), (color, marker) in zip(spread.items(), styles, strict=True):
    right.plot(place, 1e3 * values, marker, color=color, label=name)
right.set(
    xlabel="position of the cone, from near to far",
    ylabel="repeatability 2S (um)",
    title="Each position corrected by models of the others (simulated)",
    xticks=place,
)
right.set_ylim(0, 1.45e3 * spread["before"].max())
right.legend(fontsize="small", ncols=2, loc="upper left")
plt.show()
