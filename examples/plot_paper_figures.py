"""
The paper's experiment, with its three figures
==============================================

Gao et al. (2020) learn the residuals of ten cones from three angles of the pose. They show the
repeatability in each cone, the lengths of gauges of 300 and 500 mm, and poses in a place that was
not learnt, before and after the correction. This is the same experiment on three simulated arms.

Three angles see much of what gravity does, whose arm the figures show, and of eccentric encoders
next to nothing. Where no window can open, put `plt.savefig(...)` in front of each `plt.show()`.
"""

import matplotlib.pyplot as plt
import numpy as np
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import SimulatedArm, make_features, make_single_point
from sklearn_raacmm.display import RepeatabilityDisplay
from sklearn_raacmm.metrics import single_point_repeatability

KINDS = ["eccentricity", "typical", "gravity"]  # what the errors come from; figures of the last
PLANE = ["theta3", "theta4", "theta_dis"]  # the angles that the network sees
GAUGES = np.repeat([300.0, 500.0], 10)  # mm, ten placements of each


def measured_lengths(points, faces):
    """Length of each gauge, from ten touches of each of its two faces, which are parallel."""
    found = []
    for first in range(0, faces.max(), 2):
        ends = [points[faces == face] for face in (first, first + 1)]
        flat = np.concatenate([end - end.mean(axis=0) for end in ends])
        normal = np.linalg.svd(flat)[2][2]
        found.append(abs(normal @ (ends[1].mean(axis=0) - ends[0].mean(axis=0))))
    return np.array(found)


for kind in KINDS:
    machine = SimulatedArm(kind, random_state=0)
    cone = make_single_point(n_positions=10, n_poses=60, machine=machine, random_state=0)
    new = make_single_point(1, 300, machine=machine, random_state=1)
    gauge = make_features(0, 0, 0, 10, blocks=GAUGES, machine=machine, random_state=2)
    network = make_pipeline(PoseFeatures(cone.arm), RBFNetRegressor(random_state=0))
    chain = CylindricalResidualTarget(network, azimuth=cone.arm.azimuth)
    words = {"groups": cone.groups, "cv": GroupKFold(5), "params": {"groups": cone.groups}}
    correction = cross_val_predict(chain, cone.data, cone.target, **words)  # by other cones
    chain.fit(cone.data, cone.target, groups=cone.groups)
    print(f"{kind}, before -> after, micrometres")
    for what, data, points, by in (
        ("2S, ten cones", cone, cone.points, correction),
        ("2S, a new place", new, cone.arm.forward(new.data), chain.predict(new.data)),
    ):
        was, now = (single_point_repeatability(p, data.groups) for p in (points, points - by))
        print(f"  {what}: {1e3 * was:.0f} -> {1e3 * now:.0f} ({100 * (now / was - 1):+.0f} %)")
    touches = cone.arm.forward(gauge.data)
    ends = touches, touches - chain.predict(gauge.data)
    errors = [measured_lengths(points, gauge.groups) - GAUGES for points in ends]
    for length in (300, 500):
        was, now = (1e3 * np.abs(error[length == GAUGES]).mean() for error in errors)
        print(f"  gauges of {length} mm: {was:.0f} -> {now:.0f} ({100 * (now / was - 1):+.0f} %)")

RepeatabilityDisplay.from_predictions(cone.points, correction, groups=cone.groups + 1)
plt.show()

figure, axes = plt.subplots(1, 2, sharey=True, layout="constrained")
for ax, length in zip(axes, (300, 500), strict=True):
    both = 1e3 * np.transpose(errors)[length == GAUGES]
    ax.plot(np.arange(1, 11), both, "o", label=["before", "after"])
    ax.set(title=f"{length} mm gauge", xlabel="placement", ylabel="length error (µm)")
axes[0].legend()
plt.show()

figure, axes = plt.subplots(1, 3, sharey=True, layout="constrained", figsize=(9, 3.5))
both = [1e3 * np.linalg.norm(p - p.mean(axis=0), axis=1) for p in (points, points - by)]
for ax, angle, name in zip(axes, chain.regressor_[0].transform(new.data).T, PLANE, strict=True):
    ax.plot(np.rad2deg(angle), np.transpose(both), ".", label=["before", "after"])
    ax.set(xlabel=f"{name} (degrees)", ylabel="deviation in the new place (µm)")
axes[0].legend()
plt.show()
