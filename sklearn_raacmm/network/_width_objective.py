r"""What kernel, widths and ridge are found by: the marginal likelihood less the price of features.

With few or noisy rows the likelihood alone finds narrow widths in features that do not matter. So
every feature pays for being used, the more the more of them there are. With
:math:`\rho` the inverse width in units of the feature's spread, :math:`s^2` the signal variance and
n the number of observations, the penalty is

.. math:: A\, q / (q + \kappa^2 / n) + \log(1 + (\rho / 0.3)^2), \qquad q = s^2 \rho^2,

where :math:`A = 0.9 \log(1 + d)` for d features and q is the variance of the function's slope. A
slope whose square is far above :math:`\kappa^2 / n`, its error from n observations, costs A,
however steep it is; one that cannot be told from 0 costs nothing.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError
from scipy.optimize import minimize

from sklearn_raacmm.network._group_noise import group_likelihood
from sklearn_raacmm.network._likelihood import exact_likelihood, projected_likelihood

ALPHA_BOUNDS = (1e-12, 1e6)
# Variance of the groups' own functions over that of the other noise: below, they are none; above,
# nothing else.
RATIO_BOUNDS = (1e-3, 1e3)
# In spreads of a feature: below, every sample is alone; above, a function is as good as linear.
WIDTH_BOUNDS = (1e-2, 1e3)
# The penalty: size of A; kappa, and that of a first loose search, in standard errors of a slope;
# inverse width at which further narrowness is penalised. The likelihood weighs the size of the data
# by itself; what it does not know is from how many features one was picked. With A of 0.45
# (log(n) / 2 + log(d) + 1) the weak interaction of noise twice the signal, 6 features and 300 rows
# was given up (0.66 of the deviation was left, now 0.51); noise in 5, 20 and 50 features and weak
# signals in 20 are told apart as before (benchmarks of simulated tables, two or three draws each).
PRICE, KAPPA, LOOSE_KAPPA, NARROW = 0.9, 2.0, 20.0, 0.3
# The prior of the noise variance: below this share of an output's variance each power of e costs so
# many nats, as much as two observations say.
SILENT, DOUBT = 0.05, 1.0
# Parameters up to which their curvatures are looked at, on the rows of the first stage: each costs
# an evaluation there, a fifteenth of one on 1000 rows. The step of the difference, a logarithm; and
# the least curvature, as a share of the largest.
CURVATURES, CURVATURE_STEP, LEAST_CURVATURE = 30, 0.05, 1e-3


class End(NamedTuple):
    """Where a search has ended."""

    kernel: str
    theta: np.ndarray
    value: float  # objective, nats
    start: float  # the same at the start


class Task:
    """What is searched for, and the objective.

    The parameters theta are the logarithms of the free widths, in units of the features' spread,
    of the free ridges, and of the ratio of the groups' own functions to the other noise.

    Parameters
    ----------
    data : Data
    spread : ndarray of shape (d,)
    length_scale : ndarray of shape (d,) or None
    isotropic : bool
    alpha : ndarray of shape (q,) or None
    used : ndarray of shape (d,), optional
        Mask of the features; the width of the others is infinite.
    own : bool
        Whether groups have functions of their own (`_group_noise`).
    """

    def __init__(self, data, spread, length_scale, isotropic, alpha, used=None, own=False):
        self.data, self.spread, self.isotropic = data, spread, isotropic
        self.length_scale, self.alpha, self.own = length_scale, alpha, own
        d = data.X.shape[1]
        self.used = np.ones(d, dtype=bool) if used is None else used
        self.n_widths = 0 if length_scale is not None else 1 if isotropic else self.used.sum()
        self.n_alphas = data.Y.shape[1] if alpha is None else 0
        bounds = [np.log(WIDTH_BOUNDS)] * self.n_widths + [np.log(ALPHA_BOUNDS)] * self.n_alphas
        bounds += [np.log(RATIO_BOUNDS)] * own
        self.bounds = np.reshape(bounds, (-1, 2))

    def unpack(self, theta):
        """Logarithms of all widths and ridges, (d,) and (q,)."""
        if self.length_scale is None:
            log_width = np.full(len(self.spread), np.inf)
            log_width[self.used] = np.log(self.spread[self.used]) + theta[: self.n_widths]
        else:
            log_width = np.log(self.length_scale)
        if self.n_alphas:
            return log_width, theta[self.n_widths :][: self.n_alphas]
        return log_width, np.log(np.maximum(self.alpha, ALPHA_BOUNDS[0]))

    def start(self, width, alpha):
        """Theta of one width, in units of sqrt(d) spreads, and one ridge for all."""
        log_width = np.log(width * np.sqrt(self.data.X.shape[1]))
        return np.append(np.full(self.n_widths, log_width), np.full(self.n_alphas, np.log(alpha)))

    def rows(self, rows):
        """Data of some rows."""
        return self.data.rows(rows)

    def objective(self, theta, data, kernel, inducing=None, kappa=KAPPA):
        """Negative log likelihood with the penalty, in nats, and its gradient."""
        log_width, log_alpha = self.unpack(theta)
        try:
            if self.own:
                found = group_likelihood(data, kernel, log_width, log_alpha, theta[-1])
            elif inducing is None:
                found = exact_likelihood(data, kernel, log_width, log_alpha)
            else:
                found = projected_likelihood(data, inducing, kernel, log_width, log_alpha)
        except LinAlgError:
            return np.inf, np.zeros(len(theta))
        gradient = self._reduce(found.gradient)
        of_signal = np.array([self._reduce(row) for row in found.signal_gradient])
        # The signal variance in units of an output's variance, on average over outputs.
        penalty, of_penalty = self._penalty(
            theta[: self.n_widths],
            found.signal.mean(),
            of_signal.mean(axis=0),
            data.n_total,
            kappa,
        )
        value = found.value + penalty
        gradient += of_penalty
        if self.n_alphas:
            # Noise below a part of the targets' variance has to be shown.
            noise = found.signal * np.exp(log_alpha)
            doubt = SILENT / (SILENT + noise)
            value += DOUBT * np.log1p(SILENT / noise).sum()
            gradient -= DOUBT * (doubt / found.signal) @ of_signal
            gradient[self.n_widths :][: self.n_alphas] -= DOUBT * doubt
        return value, gradient

    def _reduce(self, gradient):
        """From derivatives by (log_width, log_alpha, log_ratio) to those by theta."""
        d, q = len(self.spread), self.data.Y.shape[1]
        by_width = gradient[:d][self.used]
        if self.isotropic:
            by_width = [by_width.sum()]
        by_alpha, by_ratio = gradient[d:][: self.n_alphas], gradient[d + q :]
        return np.concatenate([by_width[: self.n_widths], by_alpha, by_ratio])

    def variant(self, **changes):
        """The same task but for some of its parameters."""
        names = ("data", "spread", "length_scale", "isotropic", "alpha", "used", "own")
        return Task(**{name: getattr(self, name) for name in names} | changes)

    def _penalty(self, log_width, signal, of_signal, n_total, kappa):
        rho2 = np.exp(-2 * log_width)
        price = PRICE * np.log1p(self.n_widths)
        floor = kappa**2 / n_total
        slope = signal * rho2
        used = slope / (slope + floor)  # of every feature, between 0 and 1
        narrow = rho2 / NARROW**2
        value = price * used.sum() + np.log1p(narrow).sum()
        by_slope = price * floor / (slope + floor) ** 2
        gradient = (by_slope @ rho2) * of_signal
        gradient[: self.n_widths] -= 2 * by_slope * slope + 2 * narrow / (1 + narrow)
        return value, gradient

    def used_share(self, end, data):
        """How far every free width is paid for, between 0 (no slope) and 1, (n_widths,)."""
        signal = exact_likelihood(data, end.kernel, *self.unpack(end.theta)).signal
        slope = signal.mean() * np.exp(-2 * end.theta[: self.n_widths])
        return slope / (slope + KAPPA**2 / data.n_total)

    def curvature(self, theta, rows, kernel):
        """Second derivatives of the objective per observation, by differences of its gradient."""
        data, n = self.rows(rows), len(theta)
        here = self.objective(theta, data, kernel)[1]
        up = theta + CURVATURE_STEP < self.bounds[:, 1]
        steps = np.where(up, CURVATURE_STEP, -CURVATURE_STEP)
        there = [self.objective(theta + row, data, kernel)[1] for row in np.diag(steps)]
        H = (np.reshape(there, (n, n)) - here) / steps[:, None] / data.n_total
        return 0.5 * (H + H.T)

    def step_units(self, theta, rows, kernel):
        """Unit of a step along each parameter: the root of the objective's curvature, inverted.

        Found on a few rows. In these units a search on more rows takes a half to three quarters of
        the evaluations.
        """
        if not 0 < len(theta) <= CURVATURES:
            return np.ones(len(theta))
        curvature = np.abs(self.curvature(theta, rows, kernel).diagonal())
        if not 0 < curvature.max() < np.inf:
            return np.ones(len(theta))
        # Relative to the steepest: the search itself finds the scale of all.
        return np.sqrt(1 / np.maximum(curvature / curvature.max(), LEAST_CURVATURE))

    def gain(self, theta, few, many, kernel):
        """Nats by which a step of Newton's method would improve theta on many rows.

        The second derivatives are those on a few rows.
        """
        data = self.rows(many)
        value, gradient = self.objective(theta, data, kernel)
        if not np.isfinite(value):
            return np.inf
        low, high = self.bounds.T
        held = ((theta <= low) & (gradient > 0)) | ((theta >= high) & (gradient < 0))
        gradient[held] = 0.0
        values, vectors = np.linalg.eigh(self.curvature(theta, few, kernel))
        if not values.max(initial=0.0) > 0:
            return 0.0 if not len(theta) else np.inf
        along = vectors.T @ gradient
        values = np.maximum(np.abs(values), LEAST_CURVATURE * values.max())
        return float(0.5 * np.sum(along**2 / values) / data.n_total)

    def minimise(self, theta, rows, kernel, steps, inducing=None, kappa=KAPPA, units=1.0):
        """Search from a start, with steps in some units.

        Returns
        -------
        End
            Never worse than the start.
        """
        data, q = self.rows(rows), self.data.Y.shape[1]
        unit = data.n_total * q
        # Small steps along a valley of the likelihood add up: the tolerance in nats is as small as
        # the cost of a step allows.
        cost = len(rows) * float(len(rows if inducing is None else inducing)) ** 2
        nats = np.clip(1e-11 * cost, 1e-4, 1e-2)
        values = []

        def scaled(steps):
            value, gradient = self.objective(steps * units, data, kernel, inducing, kappa)
            values.append(value)
            return value / unit, gradient * units / unit

        theta = np.clip(theta, *self.bounds.T) if len(theta) else theta
        units = np.broadcast_to(units, len(theta))
        if not len(theta):
            value = scaled(theta)[0] * unit
            return End(kernel, theta, value, value)
        options = {"maxiter": steps, "ftol": nats / unit}
        bounds = self.bounds / units[:, None]
        found = minimize(
            scaled, theta / units, method="L-BFGS-B", jac=True, bounds=bounds, options=options
        )
        if not found.fun * unit < values[0]:
            return End(kernel, theta, values[0], values[0])
        return End(kernel, found.x * units, found.fun * unit, values[0])
