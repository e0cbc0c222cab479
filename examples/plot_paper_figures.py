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
from sklearn.model_selection import LeaveOneGroupOut, cross_val_predict
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_gauge, make_single_point
from sklearn_raacmm.display import LengthErrorDisplay, RepeatabilityDisplay, ResidualDisplay

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

display = LengthErrorDisplay.from_estimator(
    model.fit(cone.data, cone.target, **positions),
    gauge.data,
    gauge.points,
    groups=gauge.groups,
    pairs=gauge.pairs,
    lengths=gauge.lengths,
    perfect=gauge.simulation.perfect_correction,
)
display.figure_.suptitle("Simulated arm (gravity), three inputs")
plt.show()

# %%
# Residuals against the pose
# --------------------------

display = ResidualDisplay.from_predictions(
    cone.data, cone.target, correction, arm=cone.arm, groups=cone.groups
)
display.figure_.suptitle("Simulated arm (gravity), three inputs")
plt.show()
