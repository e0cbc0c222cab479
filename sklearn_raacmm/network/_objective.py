r"""What kernel, widths and ridge are found by: the marginal likelihood less the price of features.

With few or noisy rows the likelihood alone finds narrow widths in features that do not matter. So
every feature pays for being used, the more the more of them there are. With
:math:`\rho` the inverse width in units of the feature's spread, :math:`s^2` the signal variance and
n the number of observations, the penalty is

.. math:: A\, q / (q + \kappa^2 / n) + \log(1 + d (\rho / 1.5)^2), \qquad q = s^2 \rho^2,

where :math:`A = 0.9 \log(1 + d)` for d features and q is the variance of the function's slope. A
slope whose square is far above :math:`\kappa^2 / n`, its error from n observations, costs A,
however steep it is; one that cannot be told from 0 costs nothing.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError
from scipy.optimize import minimize

from sklearn_raacmm.network._likelihood import LEAST_RIDGE, Data, exact_likelihood
from sklearn_raacmm.network._linear import DOUBT, SILENT

ALPHA_BOUNDS = (LEAST_RIDGE, 1e6)
# In spreads of a feature: below, every sample is alone; above, a function is as good as linear.
WIDTH_BOUNDS = (1e-2, 1e3)
# Variance of groups' constants over that of an observation's noise: below, they are none; above,
# nothing is left of a group's mean. Where the search for it starts.
RATIO_BOUNDS, START_RATIO = (1e-5, 1e8), 0.1
# The penalty: size of A; kappa, and that of a first loose search, in standard errors of a slope;
# inverse width, in units of 1 over sqrt(d) spreads, at which further narrowness is penalised. A
# price that grows with the rows gave up a weak interaction (``benchmarks/bench_noise.py``).
PRICE, KAPPA, LOOSE_KAPPA, NARROW = 0.9, 2.0, 20.0, 1.5


class Task(NamedTuple):
    """What is searched for: theta, the logarithms of what is free, and what is given.

    Free are widths, in units of the spread, ridges, and the ratio of groups' constants to noise.
    """

    spread: np.ndarray  # (d,) unit of every width
    used: np.ndarray  # (d,) mask of the features; the width of the others is infinite
    n_outputs: int
    isotropic: bool = False  # one width, in units of each feature's spread
    length_scale: np.ndarray | None = None  # (d,) given widths
    alpha: np.ndarray | None = None  # (q,) given ridges
    constants: bool = False  # whether groups have constants

    @property
    def n_widths(self):
        """Number of free widths."""
        if self.length_scale is not None:
            return 0
        return 1 if self.isotropic else int(self.used.sum())

    @property
    def n_alphas(self):
        """Number of free ridges."""
        return self.n_outputs if self.alpha is None else 0

    @property
    def bounds(self):
        """Of theta, (n, 2)."""
        bounds = [WIDTH_BOUNDS] * self.n_widths + [ALPHA_BOUNDS] * self.n_alphas
        return np.log(np.reshape(bounds + [RATIO_BOUNDS] * self.constants, (-1, 2)))

    def start(self, width, alpha):
        """Theta of one width, in units of sqrt(d) spreads, and one ridge for all."""
        log_width = np.log(width * np.sqrt(self.used.sum()))
        theta = np.append(np.full(self.n_widths, log_width), np.full(self.n_alphas, np.log(alpha)))
        return np.append(theta, [np.log(START_RATIO)] * self.constants)

    def unpack(self, theta):
        """Logarithms of all widths (d,) and ridges (q,), and the ratio."""
        if self.length_scale is None:
            log_width = np.full(len(self.spread), np.inf)
            log_width[self.used] = np.log(self.spread[self.used]) + theta[: self.n_widths]
        else:
            log_width = np.log(self.length_scale)
        ratio = float(np.exp(theta[-1])) if self.constants else 0.0
        if self.alpha is None:
            return log_width, theta[self.n_widths :][: self.n_outputs], ratio
        return log_width, np.log(np.maximum(self.alpha, ALPHA_BOUNDS[0])), ratio

    def reduce(self, gradient):
        """From derivatives by all widths, ridges and the ratio to those by theta."""
        d = len(self.spread)
        by_width = gradient[:d][self.used]
        if self.isotropic:
            by_width = [by_width.sum()]
        by_alpha, by_ratio = gradient[d:][: self.n_alphas], gradient[-1:][: int(self.constants)]
        return np.concatenate([by_width[: self.n_widths], by_alpha, by_ratio])


def objective(task, theta, data, kernel, kappa=KAPPA):
    """Negative log likelihood with the penalty, in nats, and its gradient by theta."""
    log_width, log_alpha, ratio = task.unpack(theta)
    try:
        value, gradient, signals, of_signals = exact_likelihood(
            data, kernel, log_width, log_alpha, ratio
        )
    except LinAlgError:
        return np.inf, np.zeros(len(theta))
    gradient = task.reduce(gradient)
    of_signals = np.array([task.reduce(row) for row in of_signals])
    # The signal variance in units of an output's variance, on average over outputs.
    widths, alphas = theta[: task.n_widths], slice(task.n_widths, task.n_widths + task.n_alphas)
    floor = kappa**2 / data.n_total
    narrow = NARROW / np.sqrt(task.used.sum())
    penalty, of_penalty = _penalty(widths, signals.mean(), of_signals.mean(axis=0), floor, narrow)
    value += penalty
    gradient += of_penalty
    if task.n_alphas:
        # Noise below a part of the targets' variance has to be shown.
        noise = signals * np.exp(log_alpha)
        of_log_noise = of_signals / signals[:, None]
        of_log_noise[:, alphas] += np.eye(task.n_alphas)
        value += DOUBT * np.log1p(SILENT / noise).sum()
        gradient -= DOUBT * (SILENT / (SILENT + noise)) @ of_log_noise
    return value, gradient


def _penalty(log_width, signal, of_signal, floor, narrow):
    rho2 = np.exp(-2 * log_width)
    price = PRICE * np.log1p(len(log_width))
    slope = signal * rho2
    used = slope / (slope + floor)  # of every feature, between 0 and 1
    narrow = rho2 / narrow**2
    value = price * used.sum() + np.log1p(narrow).sum()
    by_slope = price * floor / (slope + floor) ** 2
    gradient = (by_slope @ rho2) * of_signal
    gradient[: len(log_width)] -= 2 * by_slope * slope + 2 * narrow / (1 + narrow)
    return value, gradient


def minimise(task, theta, data: Data, kernel, steps, kappa=KAPPA):
    """Search from a start; returns where it ends, never worse, and the objective there, nats."""
    unit = data.n_total * data.Y.shape[1]
    # Small steps along a valley of the likelihood add up: the tolerance in nats is as small as the
    # cost of a step allows.
    nats = np.clip(1e-11 * float(len(data.X)) ** 3, 1e-4, 1e-2)

    def per_observation(theta):
        value, gradient = objective(task, theta, data, kernel, kappa)
        return value / unit, gradient / unit

    theta = np.clip(theta, *task.bounds.T)
    if not len(theta):
        return theta, per_observation(theta)[0] * unit
    options = {"maxiter": steps, "ftol": nats / unit}
    found = minimize(
        per_observation, theta, method="L-BFGS-B", jac=True, bounds=task.bounds, options=options
    )
    return found.x, found.fun * unit
