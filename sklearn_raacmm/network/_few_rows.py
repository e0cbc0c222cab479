r"""Few rows: an average of the models that they do not tell apart, as one model.

Five or ten rows seldom say whether a function is smooth, linear, or not there at all. To choose one
of the three then costs more than any of them is worse than the best. So each has a weight by its
evidence [1]_. Where the function is a draw from one of several priors of mean zero with
probabilities :math:`w_j`, its covariance is the sum of theirs times :math:`w_j`, and the best
linear prediction is that of one process with this covariance: radial functions, a linear part with
a ridge, and noise. So the average is a network like any other.

References
----------
.. [1] J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, "Bayesian model averaging: a
   tutorial", Statistical Science 14 (1999), 382-417.
"""

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.network._kernels import KERNELS, squared_distances
from sklearn_raacmm.network._likelihood import (
    evidence_constant,
    exact_likelihood,
    inverses,
    leave_one_out,
    noise_likelihood,
    weigh,
)
from sklearn_raacmm.network._polynomial_tail import (
    linear_columns,
    linear_left_out,
    linear_process,
)
from sklearn_raacmm.network._width_objective import ALPHA_BOUNDS
from sklearn_raacmm.network._width_search import (
    links_nothing,
    noise_density,
    parameters_found,
    robust_spread,
)

# Rows a feature from which leave-one-out densities count in full, and one model is chosen.
TRUSTED = 10
# Nats that a linear model has to be better by, and that noise may be worse by than a process whose
# widths were fitted to the same rows: without rows to judge by, and what is added to them where one
# model is all but chosen. Decided on 45 simulated functions with 5 to 100 rows, where between 1 and
# 2, and 0 and 3, the mean error changed by 1 %; the more noise may be worse, the less is lost where
# there is nothing but noise.
LINEAR_NATS, NOISE_NATS = (1.0, 1.0), (1.0, 2.0)
# Weight below which a model is left out.
LEAST_WEIGHT = 0.05


class Average(NamedTuple):
    """A process with a linear part that has the covariance of several models."""

    weights: np.ndarray  # (3,) of the process, the linear model and noise
    kernel: str
    length_scale: np.ndarray  # (d,)
    alpha: np.ndarray  # (1,) noise variance over that of the radial functions
    tail_ridge: float  # of the linear part, in units of an observation; 0 where there is none
    log_likelihood: float
    n_found: float  # parameters that the data have decided on, on average


def trust(data):
    """How far leave-one-out densities count: the widths have been chosen on the same rows."""
    return min(1.0, data.n_total / (TRUSTED * data.X.shape[1]))


def average(data, process):
    """The process, a linear model and noise, each with the weight that the rows give it.

    Parameters
    ----------
    data : Data
        The rows on which the process was judged; targets about their mean.
    process : Process
        The best one that was found.

    Returns
    -------
    Average or None
        None where there are rows enough to choose one model, or no feature varies; and for several
        outputs, which share the ridge of the linear part: beside a function an output of noise had
        1.25 times the error (45 simulated functions).
    """
    linear = linear_process(data)
    if trust(data) >= 1 or not linear.ridge or data.Y.shape[1] > 1:
        return None
    weights = _weights(data, process, linear)
    d = data.X.shape[1]
    widths, ridges = np.log(process.length_scale), np.log(process.alpha)
    signal = exact_likelihood(data, process.kernel, widths, ridges).signal
    columns = linear_columns(data)
    of_linear = np.maximum(_linear_noise(data, columns, linear.ridge), np.finfo(float).tiny)
    total = (data.weights @ np.square(data.Y) + data.within) / data.n_total
    noise = np.exp(weights @ np.log([process.alpha * signal, of_linear, total]))
    length_scale, alpha, tail_ridge = process.length_scale, np.array([ALPHA_BOUNDS[1]]), 0.0
    if weights[0]:
        alpha = np.clip(noise / (weights[0] * signal), *ALPHA_BOUNDS)
    else:
        length_scale = silent_widths(data.X, data.weights)
    if weights[1]:
        tail_ridge = float(linear.ridge * noise[0] / of_linear[0] / weights[1])
    n_found = [process.n_found, parameters_found(1, d, 0, 1), parameters_found(0, d, 0, 1)]
    value = _log_likelihood(data, process.kernel, length_scale, alpha, tail_ridge)
    found = float(weights @ n_found)
    return Average(weights, process.kernel, length_scale, alpha, tail_ridge, value, found)


def silent_widths(X, weights):
    """Widths of radial functions that are as good as noise."""
    spread = robust_spread(X, weights)
    return np.where(spread > 0, spread * np.sqrt(X.shape[1]), np.inf)


def _weights(data, process, linear):
    """Weights of the process, the linear model and noise, (3,)."""
    share = trust(data)
    widths, ridges = np.log(process.length_scale), np.log(process.alpha)
    evidence = np.array([process.objective, linear.objective, noise_likelihood(data)])
    left_out = [
        leave_one_out(data, process.kernel, widths, ridges).negative_log_density,
        linear_left_out(data, linear.ridge).negative_log_density,
        noise_density(data),
    ]
    # A kernel that links no row to another is noise by another name.
    if links_nothing(data.X / process.length_scale, process.kernel):
        evidence[0] = np.inf
    linear_nats, noise_nats = (a + b * share for a, b in (LINEAR_NATS, NOISE_NATS))
    nats = evidence + share * np.array(left_out) + [0.0, linear_nats, -noise_nats]
    # As rows become enough to choose, the best takes all.
    weights = np.exp(-(nats - nats.min()) / (1 - share))
    weights /= weights.sum()
    weights[weights < LEAST_WEIGHT] = 0.0
    return weights / weights.sum()


def _linear_noise(data, columns, ridge):
    """Noise variance beside a linear model, (1,)."""
    targets = np.sqrt(data.weights)[:, None] * data.Y
    solved = inverses(columns @ columns.T / ridge, targets, np.ones(1))[0]
    return ((targets * solved).sum(axis=0) + data.within) / data.n_total


def _log_likelihood(data, kernel, length_scale, alpha, tail_ridge):
    """Logarithm of the marginal likelihood."""
    Xs, root = data.X / length_scale, np.sqrt(data.weights)
    K = KERNELS[kernel].function(squared_distances(Xs, Xs)) / alpha
    weigh(K, root)
    if tail_ridge:
        columns = linear_columns(data)
        K += columns @ columns.T / tail_ridge
    y = root[:, None] * data.Y
    solved, log_det, _, _ = inverses(K, y, np.ones(1))
    quadratic = max((y * solved).sum() + data.within[0], np.finfo(float).tiny)
    value = 0.5 * (log_det[0] + data.n_total * np.log(quadratic))
    return float(-value - evidence_constant(data))
