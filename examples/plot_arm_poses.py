"""
The poses of a single-point test
================================

The probe sits in a cone while the elbow swings. The arm takes many poses, and all of them should
end at one point. Lines from that point show the residuals, two thousand times as long as they are.
Below are the residuals that are left after a correction by a model that has not seen this
position. With a window (or ``%matplotlib widget`` in a notebook) the mouse turns the arm.

The data are simulated: one of 10 positions, with 60 poses. The script takes a few seconds.
"""

import matplotlib.pyplot as plt

from sklearn_raacmm import ArmResidualRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.display import ArmPosesDisplay

data = make_single_point(n_positions=10, n_poses=60, random_state=0)
here = data.groups == 5
X, y, groups = data.data[here], data.target[here], data.groups[here]
model = ArmResidualRegressor(data.arm)
model.fit(data.data[~here], data.target[~here], groups=data.groups[~here])

figure = plt.figure(figsize=(6, 9))
above, below = (figure.add_subplot(2, 1, i, projection="3d") for i in (1, 2))
figure.subplots_adjust(left=0, right=0.92, bottom=0.04, top=0.95)
before = ArmPosesDisplay.from_predictions(X, y, arm=data.arm, max_poses=15, ax=above)
ArmPosesDisplay.from_estimator(
    model, X, y, arm=data.arm, groups=groups, max_poses=3, magnification=before.magnification_,
    ax=below,
)  # fmt: skip
for axes in (above, below):
    axes.view_init(elev=18, azim=-60)
plt.show()
