r"""
Coming from MATLAB's newrb
==========================

``net = newrb(P, T, goal, spread, MN)`` adds radial neurons until the mean squared error is down to
``goal``. ``RBFNetRegressor`` does the same when told to, and finds by itself what
``newrb`` leaves to you. How the arguments translate:

=========  ==================================================================================
newrb      RBFNetRegressor
=========  ==================================================================================
P, T       ``fit(P.T, T.T)``: samples are rows here
goal       ``criterion="mse", tol=goal``
spread     ``length_scale=spread / sqrt(2 * log(2))``
MN         ``max_centers=MN``; or ``n_centers=MN`` for exactly so many, without a goal
DF         no display; ``criterion_path_`` has the error after 1, 2, ... centres
\          ``selection="newrb", alpha=0``: its order of centres, plain least squares
=========  ==================================================================================

About the width: a neuron of ``newrb`` gives ``radbas(b * d)`` with ``radbas(n) = exp(-n^2)`` and
``b = sqrt(log(2)) / spread = 0.8326 / spread``, hence :math:`e^{-\ln 2\,(d / spread)^2}`, one half
at distance ``spread``. A Gaussian :math:`e^{-d^2 / (2 \sigma^2)}` is the same with
:math:`\sigma = spread / \sqrt{2 \ln 2} = 0.8493\,spread`.
"""

import matplotlib.pyplot as plt
import numpy as np

from sklearn_raacmm import RBFNetRegressor

rng = np.random.default_rng(0)
P = np.sort(rng.uniform(-1, 1, 60))[None, :]  # MATLAB's way: one column per sample


def truth(x):
    """Slow to the left, fast to the right."""
    return np.sin(3 * (x + 1.5) ** 2)


T = truth(P) + 0.1 * rng.standard_normal(P.shape)

# %%
# The same network
# ----------------
# ``newrb(P, T, 0.02, 0.4, 30)``:

goal, spread, MN = 0.02, 0.4, 30
newrb = RBFNetRegressor(
    length_scale=spread / np.sqrt(2 * np.log(2)),
    criterion="mse",
    tol=goal,
    max_centers=MN,
    alpha=0,
    selection="newrb",
).fit(P.T, T.ravel())
print(f"{len(newrb.centers_)} neurons, {newrb.stop_reason_}")
print("mean squared error after 1, 2, ... neurons:", newrb.criterion_path_.round(3), sep="\n")

# %%
# Its weights are those of plain least squares on newrb's radial functions, by newrb's formula:

b = np.sqrt(np.log(2)) / spread
columns = np.exp(-((b * np.abs(P.T - newrb.centers_.T)) ** 2))
columns = np.column_stack([columns, np.ones(P.size)])
weights = np.linalg.lstsq(columns, T.ravel(), rcond=None)[0]
difference = np.abs(columns @ weights - newrb.predict(P.T)).max()
print(f"largest difference to least squares on radbas: {difference:.1e}")

# %%
# Without the guesses
# -------------------
# Goal and spread have to be guessed. A spread of 0.4 is a good guess here, even better than what
# the defaults find. With a spread of 0.05 the network follows the noise. Both reach the goal on the
# samples, so that the error there does not show which one is right. The defaults find width, ridge
# and size from the data, and the band shows two standard deviations.

default = RBFNetRegressor(random_state=0).fit(P.T, T.ravel())
x = np.linspace(-1, 1, 500)
figure, axes = plt.subplots(1, 3, figsize=(10, 3.4), sharey=True, layout="constrained")
for ax, width in zip(axes, (0.05, 0.4), strict=False):
    model = RBFNetRegressor(
        length_scale=width / np.sqrt(2 * np.log(2)),
        criterion="mse",
        tol=0.005,
        max_centers=MN,
        alpha=0,
        selection="newrb",
    ).fit(P.T, T.ravel())
    error = np.sqrt(np.mean((model.predict(x[:, None]) - truth(x)) ** 2))
    ax.plot(x, model.predict(x[:, None]), color="#D55E00")
    ax.set_title(
        f"newrb, spread {width:g}, goal 0.005:\n{len(model.centers_)} neurons, error {error:.3f}"
    )
mean, std = default.predict(x[:, None], return_std=True, with_noise=False)
error = np.sqrt(np.mean((mean - truth(x)) ** 2))
axes[2].fill_between(x, mean - 2 * std, mean + 2 * std, color="#0072B2", alpha=0.25, lw=0)
axes[2].plot(x, mean, color="#0072B2")
axes[2].set_title(f"RBFNetRegressor():\n{len(default.centers_)} neurons, error {error:.3f}")
for ax in axes:
    ax.plot(P.ravel(), T.ravel(), ".", color="0.4", ms=4)
    ax.plot(x, truth(x), "--", color="0.6", lw=1)
    ax.set(xlabel="P", ylim=(-1.8, 1.8))
axes[0].set_ylabel("T")
plt.show()
