r"""
Coming from MATLAB's newrb
==========================

``net = newrb(P, T, goal, spread, MN)`` adds radial neurons until the mean squared error is down to
``goal``. Its code is orthogonal least squares with three particularities. The targets are not
centred. Several outputs count by the sum of their squared error-reduction ratios. The bias joins in
the last fit only. Here it is in a few lines, beside ``RBFNetRegressor``, which finds goal
and spread by itself. How the arguments translate:

=========  ==================================================================================
newrb      RBFNetRegressor
=========  ==================================================================================
P, T       ``fit(P.T, T.T)``: samples are rows here
goal       ``n_centers=goal / np.var(T)``: the share of the variance that may be left
spread     ``length_scale=spread / sqrt(2 * log(2))``
MN         ``max_centers=MN``; or ``n_centers=MN`` for exactly so many, without a goal
DF         no display; ``criterion_path_`` has the share left after 1, 2, ... centres
\          ``alpha=0``: plain least squares
=========  ==================================================================================

About the width: a neuron of ``newrb`` gives ``radbas(b * d)`` with ``radbas(n) = exp(-n^2)`` and
``b = sqrt(log(2)) / spread``. That is :math:`e^{-\ln 2\,(d / spread)^2}`, one half at distance
``spread``. A Gaussian :math:`e^{-d^2 / (2 \sigma^2)}` is the same with
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
# newrb itself
# ------------


def radial(P, centers, spread):
    """Neurons of newrb, one column each."""
    gaps = np.square(P[:, :, None] - centers[:, None, :]).sum(axis=0)
    return np.exp(-np.log(2) * gaps / spread**2)


def newrb(P, T, goal, spread, MN):
    """Indices of centres, and the function that they make."""
    W, target, chosen = radial(P, P, spread), T.T, []
    while len(chosen) < MN:
        lengths = np.sum(W**2, axis=0)
        lengths[chosen] = np.inf
        ratios = (T @ W) ** 2 / lengths / np.sum(T**2, axis=1, keepdims=True)  # of every output
        chosen.append(int(np.argmax(np.sum(ratios**2, axis=0))))
        w = W[:, chosen[-1]] / np.linalg.norm(W[:, chosen[-1]])
        W -= np.outer(w, w @ W)  # what is left of all others
        columns = np.column_stack([radial(P, P[:, chosen], spread), np.ones(P.size)])
        weights = np.linalg.lstsq(columns, target, rcond=None)[0]
        if np.mean((target - columns @ weights) ** 2) <= goal:
            break

    def network(x):
        return radial(np.atleast_2d(x), P[:, chosen], spread) @ weights[:-1] + weights[-1]

    return chosen, network


goal, spread, MN = 0.02, 0.4, 30
centers, network = newrb(P, T, goal, spread, MN)
print(f"{len(centers)} neurons, mean squared error {np.mean((T - network(P).T) ** 2):.3f}")

# %%
# ``RBFNetRegressor`` with the same width and goal centres the targets first, so that its choice is
# another one:

model = RBFNetRegressor(
    goal / np.var(T), length_scale=spread / np.sqrt(2 * np.log(2)), alpha=0, max_centers=MN
).fit(P.T, T.ravel())
print(f"{len(model.centers_)} centres, {model.stop_reason_}")

# %%
# Without the guesses
# -------------------
# Goal and spread have to be guessed. A spread of 0.4 is a good guess here, even better than what
# the defaults find. With a spread of 0.05 the network follows the noise. Both reach the goal on the
# samples, so that the error there does not show which one is right. The defaults find width, ridge
# and size from the data, and the band shows two standard deviations.

default = RBFNetRegressor(random_state=0).fit(P.T, T.ravel())
x = np.linspace(-1, 1, 500)
figure, axes = plt.subplots(3, 1, figsize=(6, 8.5), sharex=True, layout="constrained")
for ax, width in zip(axes, (0.05, 0.4), strict=False):
    centers, network = newrb(P, T, 0.005, width, MN)
    error = np.sqrt(np.mean((network(x)[:, 0] - truth(x)) ** 2))
    ax.plot(x, network(x), color="#D55E00")
    ax.set_title(f"newrb, spread {width:g}, goal 0.005:\n{len(centers)} neurons, error {error:.3f}")
mean, std = default.predict(x[:, None], return_std=True, with_noise=False)
error = np.sqrt(np.mean((mean - truth(x)) ** 2))
axes[2].fill_between(x, mean - 2 * std, mean + 2 * std, color="#0072B2", alpha=0.25, lw=0)
axes[2].plot(x, mean, color="#0072B2")
axes[2].set_title(f"RBFNetRegressor():\n{len(default.centers_)} neurons, error {error:.3f}")
for ax in axes:
    ax.plot(P.ravel(), T.ravel(), ".", color="0.4", ms=4)
    ax.plot(x, truth(x), "--", color="0.6", lw=1)
    ax.set(ylabel="T", ylim=(-1.8, 1.8))
axes[2].set_xlabel("P")
plt.show()
