"""Intervals that hold: how much wider errors that were left out are than a posterior says."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln
from scipy.stats import norm, t

# Spread of the priors of log a and log b about their means; rate of the Gamma(2) prior of the
# degrees of freedom (M. A. Juarez, M. F. J. Steel, J. Bus. Econ. Stat. 28, 2010).
_LOG_SPREAD, _PER_FREEDOM = 1.0, 0.1
_SEARCH = {"xatol": 1e-4, "fatol": 1e-6, "maxiter": 500}
# From the better of two starts the search goes on to here: fading acts on the result, which has to
# be the same for a weight of 2 and a row that is there twice.
_POLISH = {"xatol": 1e-8, "fatol": 1e-12, "maxiter": 500}


def interval_scales(
    errors: np.ndarray,
    noise: np.ndarray,
    std: np.ndarray,
    weights: np.ndarray,
    worth: float = 1.0,
    usual_log_b: float = 0.0,
) -> tuple[float, float]:
    """Factors of noise and standard deviation at which intervals of 95 % hold.

    Errors (n, q) in units of ``sqrt(a noise^2 + b std^2)`` are a Student variable: a, b and its
    degrees of freedom have the highest posterior. Both deviations (n, q) are then multiplied so
    that 1.96 of them hold 95 %. `worth` are independent errors per coordinate: those of one
    position resemble each other. `usual_log_b` is the mean of the prior of log b; that of log a is
    0.
    """
    # Rows of no deviation at all, of positions of one pose, say nothing.
    used = np.square(noise) + np.square(std) > 0
    weight = np.broadcast_to(weights[:, None], errors.shape)[used]
    e2, n2, s2 = (np.square(values[used]) for values in (errors, noise, std))
    if not len(e2):
        return 1.0, 1.0
    usual = np.array([0.0, usual_log_b])

    def loss(logs):
        a, b, freedom = np.exp(logs)
        variance = a * n2 + b * s2
        # As t.logpdf of SciPy, whose checks would take 40 % of the time of a fit to 60 rows.
        level = gammaln((freedom + 1) / 2) - gammaln(freedom / 2) - 0.5 * np.log(np.pi * freedom)
        size = np.log1p(e2 / (freedom * variance))
        density = level - 0.5 * ((freedom + 1) * size + np.log(variance))
        prior = 0.5 * np.square((logs[:2] - usual) / _LOG_SPREAD).sum() + _PER_FREEDOM * freedom
        return -worth * (weight @ density) + prior - 2 * logs[2]

    starts = ([0.0, 0.0, 3.0], [-1.0, 2.0, 1.5])
    found = [minimize(loss, start, method="Nelder-Mead", options=_SEARCH) for start in starts]
    best = min(found, key=lambda one: one.fun).x
    a, b, freedom = np.exp(minimize(loss, best, method="Nelder-Mead", options=_POLISH).x)
    widening = t.ppf(0.975, freedom) / norm.ppf(0.975)
    return float(widening * np.sqrt(a)), float(widening * np.sqrt(b))
