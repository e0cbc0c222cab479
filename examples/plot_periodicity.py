"""
A joint that turns all the way round
====================================

A joint that rolls stands in the same place at -180 and at 180 degrees, and its encoder has the
same error there. A network that is given the angle does not know this: for it, the two values are
the ends of a line. With ``PoseFeatures(encoding="periodic")`` it is given the cosine and the sine,
and it learns on a circle.

In the figure the forearm of a simulated arm rolls twice about itself, while all other joints rest.
The true error repeats after one turn, and so does the prediction of the network on the circle. The
prediction of the other network does not meet its other end at 180 degrees. On the turn without
training rows less than half of the wave is left of it.

The data are simulated: 10 positions with 40 poses each. The script takes a few seconds.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import (
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    cartesian_to_cylindrical,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

data = make_single_point(n_positions=10, n_poses=40, machine="eccentricity", random_state=0)
before = single_point_repeatability(data.points, data.groups)
print(f"2S uncorrected: {1e3 * before:.1f} µm")


def chain(encoding):
    """Build the model on all joints, as angles or as cosines and sines."""
    return CylindricalResidualTarget(
        make_pipeline(
            PoseFeatures(data.arm, joints="all", encoding=encoding),
            RBFNetRegressor(random_state=0),
        ),
        azimuth=data.arm.azimuth,
    )


sweep = np.linspace(-2 * np.pi, 2 * np.pi, 400)
some = data.data[data.groups == 5][0]
angles = np.tile(some, (len(sweep), 1))
angles[:, 4] = sweep
azimuth = data.arm.azimuth(angles)
# What nobody has outside a simulation: the error of the arm at any pose.
truth = data.arm.forward(angles) - data.simulation.machine.forward(angles)

figure, axes = plt.subplots(figsize=(6.4, 4.6), layout="constrained")
curves = {"truth (simulated)": truth}
for encoding in ("angle", "periodic"):
    model = chain(encoding)
    correction = cross_val_predict(
        model, data.data, data.target, groups=data.groups, cv=GroupKFold(3)
    )
    after = single_point_repeatability(data.points - correction, data.groups)
    print(f"2S at positions left out, {encoding}: {1e3 * after:.1f} µm")
    curves[f'encoding="{encoding}"'] = model.fit(data.data, data.target).predict(angles)
for (name, residual), style in zip(curves.items(), ("k--", "#D55E00", "#0072B2"), strict=True):
    radial = cartesian_to_cylindrical(residual, azimuth)[:, 0]
    axes.plot(np.rad2deg(sweep), 1e3 * (radial - radial.mean()), style, label=name)
low, high = np.rad2deg(np.quantile(data.data[:, 4], [0, 1]))
axes.axvspan(low, high, color="0.92", zorder=0, label="readings of the training rows")
axes.set(
    xlabel="theta5 (deg), all other joints at rest",
    ylabel="radial residual less its mean (µm)",
    xticks=np.arange(-360, 361, 90),
    title="A pose and the same pose one turn later (simulated)",
)
figure.legend(fontsize="small", loc="outside lower center", ncols=2)
plt.show()
