"""
The network outside metrology
=============================

``RBFNetRegressor`` knows nothing of arms. Here it learns two functions. The first has one variable,
and the data have a gap. The second has two variables, and it changes more slowly along the second
one. The network finds its widths, its ridge and its centres by itself. The band shows two standard
deviations of the mean.

The data are generated, 123 and 366 rows. The script takes a few seconds.
"""

import matplotlib.pyplot as plt
import numpy as np

from sklearn_raacmm import RBFNetRegressor

rng = np.random.default_rng(0)

# %%
# One variable, and a gap
# -----------------------
# In the gap the band is wide, because the function may take other values there.

x = rng.uniform(-4, 4, 150)
x = x[(x < 0.5) | (x > 2)][:, None]
y = np.sin(2 * x[:, 0]) * np.exp(-0.1 * x[:, 0] ** 2) + 0.1 * rng.standard_normal(len(x))
one = RBFNetRegressor(random_state=0).fit(x, y)
noise = np.sqrt(one.noise_variance_)
print(f"1-D: {len(one.centers_)} centres of {len(x)} rows, width {one.length_scale_[0]:.2f}")
print(f"noise {noise:.3f} (true 0.1)")

# %%
# Two variables, two widths
# -------------------------
# The function changes five times faster along the first variable than along the second, and so do
# the widths.

X = rng.uniform(-2, 2, (400, 2))
X = X[np.hypot(X[:, 0] - 1, X[:, 1] - 1) > 0.6]  # no data in one corner
z = np.sin(2.5 * X[:, 0]) + np.cos(0.5 * X[:, 1]) + 0.1 * rng.standard_normal(len(X))
two = RBFNetRegressor(random_state=0).fit(X, z)
print(f"2-D: {len(two.centers_)} centres of {len(X)} rows, widths {two.length_scale_.round(2)}")

# %%
# The mean and its standard deviation. Red: the centres. The standard deviation grows outside the
# data, and a little in the gap around x1 = x2 = 1.

figure, axes = plt.subplots(3, 1, figsize=(6, 11), height_ratios=[5, 7, 7], layout="constrained")
line = np.linspace(-5, 5, 400)[:, None]
mean, std = one.predict(line, return_std=True, with_noise=False)
axes[0].fill_between(
    line[:, 0], mean - 2 * std, mean + 2 * std, color="#0072B2", alpha=0.25, lw=0, label="2 sd"
)
axes[0].plot(line[:, 0], mean, color="#0072B2", label="mean")
truth = np.sin(2 * line[:, 0]) * np.exp(-0.1 * line[:, 0] ** 2)
axes[0].plot(line[:, 0], truth, "--", color="0.5", label="truth")
axes[0].plot(x[:, 0], y, ".", color="0.3", ms=4)
centres = one.centers_[:, 0]
axes[0].plot(centres, np.full_like(centres, -1.6), "|", color="#D55E00", ms=9, label="centres")
axes[0].set(title="One variable", xlabel="x", ylim=(-1.8, 1.8))
axes[0].legend(fontsize="small", ncols=4, loc="upper center", columnspacing=1, handlelength=1.3)
grid = np.stack(np.meshgrid(*[np.linspace(-2.5, 2.5, 90)] * 2), axis=-1)
mean, std = (v.reshape(90, 90) for v in two.predict(grid.reshape(-1, 2), True, with_noise=False))
for ax, values, title in (
    (axes[1], mean, "Two variables: mean"),
    (axes[2], std, "Two variables: 1 sd"),
):
    colours = ax.contourf(grid[..., 0], grid[..., 1], values, 15, cmap="viridis")
    figure.colorbar(colours, ax=ax, shrink=0.8)
    ax.plot(*two.centers_.T, ".", color="#D55E00", ms=4)
    ax.set(title=title, xlabel="x1", ylabel="x2", aspect="equal")
plt.show()
