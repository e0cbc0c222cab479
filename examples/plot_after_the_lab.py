"""
After the tracker has moved and a joint was knocked
===================================================

A correction was fitted in the laboratory. Later the tracker stands elsewhere, the arm carries
another probe, and joint 2 was knocked. From a few new poses base and probe are found in three ways,
and the mean deviation at poses that nobody has measured is drawn:

- the natural way: fit base and probe, then subtract the correction;
- through the correction: fit base and probe to corrected points,
  ``calibrate(..., correction=model)``;
- updated: bring the correction itself up to date with :func:`~sklearn_raacmm.update_correction`.

The data are simulated: an arm whose encoders 1, 2 and 4 are eccentric.
"""

import matplotlib.pyplot as plt
import numpy as np

from sklearn_raacmm import Arm, JointHarmonicRegressor, calibrate, update_correction

ARM = Arm.from_name("ur10", probe=(0, 0, 93))
LABORATORY = {"arcsec": (40, 60, 0, 50), "probe": (0, 0, 93), "shift": (2000, 0, 0)}
LATER = {"arcsec": (40, 80, 0, 50), "probe": (5, 0, 120), "shift": (1500, 300, -200)}


def measured(angles, arcsec, probe, shift, rng):
    """Points of a tracker at some poses of an arm with eccentric encoders, mm."""
    error = np.zeros_like(angles)
    error[:, :4] = np.deg2rad(np.array(arcsec) / 3600) * np.cos(angles[:, :4] - 1)
    arm = ARM.replace(probe=probe)
    points = arm.forward(angles) - np.einsum("nij,nj->ni", arm.jacobian(angles), error)
    return points + shift + rng.normal(scale=0.02, size=points.shape)


# %%
# In the laboratory: 500 poses, a calibrated arm, a model of what calibration leaves.

rng = np.random.default_rng(0)
angles = rng.uniform(-2.5, 2.5, (500, 6))
first = calibrate(ARM, angles, points=measured(angles, **LABORATORY, rng=rng))
model = JointHarmonicRegressor(first.arm, max_order=10).fit(angles, first.residuals_mm)

# %%
# Later: ever more new poses, and 500 others to judge by.

COUNTS = [10, 15, 20, 40, 80]
far = rng.uniform(-2.5, 2.5, (500, 6))
far_points = measured(far, **LATER, rng=rng)
ways = {"no correction": [], "the natural way": [], "through the correction": [], "updated": []}
for n in COUNTS:
    new = rng.uniform(-2.5, 2.5, (n, 6))
    points = measured(new, **LATER, rng=rng)
    alone = calibrate(first.arm, new, points=points, free=["probe"])
    through = calibrate(first.arm, new, points=points, correction=model, free=["probe"])
    updated = update_correction(model, new, through.residuals(new, points))
    bare, registered = (r.residuals(far, far_points) for r in (alone, through))
    old, now = model.predict(far), updated.predict(far)
    for way, left in zip(ways, (bare, bare - old, registered - old, registered - now), strict=True):
        ways[way].append(np.linalg.norm(left, axis=1).mean())

fig, ax = plt.subplots(figsize=(6, 3.6), layout="constrained")
for (way, left), style in zip(ways.items(), (":", "--", "-.", "-"), strict=True):
    ax.plot(COUNTS, left, style, marker="o", label=way)
ax.set(xlabel="new poses", ylabel="mean deviation at other poses, mm", ylim=(0, None))
ax.legend()
plt.show()
