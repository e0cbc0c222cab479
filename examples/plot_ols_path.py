"""
How many centres: the path and where it stops
=============================================

Orthogonal least squares adds the centre that lowers the objective most, and then the next one. Each
further centre lowers it by less, and from some size on it only follows the noise. This page shows
the path on the radial residual of a simulated arm (16 positions, 40 poses each). It also shows the
error at positions that the network has not seen, and where each criterion stops.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import GroupShuffleSplit

from sklearn_raacmm import PoseFeatures, RBFNetRegressor, cartesian_to_cylindrical
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

data = make_single_point(n_positions=16, n_poses=40, machine="gravity", random_state=0)
pose = PoseFeatures(data.arm).fit_transform(data.data)
radial = cartesian_to_cylindrical(data.target, data.arm.azimuth(data.data))[:, 0]
split = GroupShuffleSplit(1, test_size=0.4, random_state=0)
train, test = next(split.split(pose, groups=data.groups))

# %%
# The whole path
# --------------
# Widths and ridge are found once and kept, so that only the number of centres changes.

found = RBFNetRegressor(random_state=0).fit(pose[train], radial[train])
settings = {"length_scale": found.length_scale_, "random_state": 0}
n_most = 160
sizes = np.unique(np.geomspace(1, n_most, 18).round().astype(int))
errors, plain_errors = [], []
for size in sizes:
    for alpha, of in ((found.alpha_, errors), (0.0, plain_errors)):
        model = RBFNetRegressor(int(size), alpha=alpha, **settings)
        prediction = model.fit(pose[train], radial[train]).predict(pose[test])
        left = radial[test] - prediction
        of.append(1000 * single_point_repeatability(left, data.groups[test]))
longest = RBFNetRegressor(n_most, alpha=found.alpha_, **settings).fit(pose[train], radial[train])

# %%
# Where the network stops
# -----------------------
# The network stops when further centres would gain next to nothing beside the noise. With a float
# for `n_centers` it stops when so much of the variance is left unexplained.

stops = {}
for n_centers in ("auto", 0.2):
    model = RBFNetRegressor(n_centers, alpha=found.alpha_, max_centers=n_most, **settings)
    stops[n_centers] = len(model.fit(pose[train], radial[train]).centers_)
    print(f"{n_centers}: {stops[n_centers]} centres")

# %%
# With the ridge that the marginal likelihood found, too many centres do no harm: they cost memory
# and time, not accuracy. Without a ridge (plain least squares, as MATLAB's newrb) the number of
# centres is all that keeps the network from following the noise.

figure, (above, below) = plt.subplots(2, 1, figsize=(6, 8), layout="constrained")
explained = np.cumsum(longest.error_reduction_)
above.plot(np.arange(1, len(explained) + 1), 1 - explained, ".-", color="#0072B2", ms=4)
above.set(
    xlabel="centres", ylabel="unexplained share of the variance", xscale="log", yscale="log",
    title="Training rows: one centre after the other",
)  # fmt: skip
below.plot(sizes, plain_errors, "s:", color="0.6", ms=4, label="plain least squares")
below.plot(sizes, errors, "o-", color="#0072B2", ms=4, label="with the ridge that was found")
uncorrected = single_point_repeatability(radial[test], data.groups[test])
below.axhline(1000 * uncorrected, color="0.3", ls="--", lw=1, label="uncorrected")
lines = (("k", "-"), ("#E69F00", "--"))
for (n_centers, size), (colour, style) in zip(stops.items(), lines, strict=True):
    below.axvline(size, color=colour, ls=style, lw=1.5, label=f"n_centers={n_centers!r}: {size}")
below.set(
    xlabel="centres", ylabel="radial 2S at positions left out (µm)", xscale="log",
    ylim=(0, 1.5 * 1000 * uncorrected), title="Positions left out (simulated)",
)  # fmt: skip
below.legend(fontsize="small", loc="lower left")
plt.show()
