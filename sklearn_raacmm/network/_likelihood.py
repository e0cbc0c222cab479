r"""What kernel, widths and ridge are found by: the marginal likelihood less the price of features.

With kernel matrix K, weights w and ridge :math:`\alpha` (noise variance over signal variance) the
targets of an output have the covariance :math:`s^2 (K + \alpha (W^{-1} + r G))`, where G is 1
within a group of rows whose targets have a common constant (`_rows`). The signal variance
:math:`s^2` of every output is set to its optimum, so that outputs of any scale count alike
(Rasmussen and Williams, sections 5.4 and 8.3).

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

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, lapack
from scipy.optimize import minimize

from sklearn_raacmm.network._kernels import Kernel, radial, squared_distances
from sklearn_raacmm.network._linear import DOUBT, SILENT
from sklearn_raacmm.utils import Groups

# Least ridge for which a Cholesky factor of all rows is taken. Below, the rounding of a kernel
# matrix of 1000 rows (1e-13 of an eigenvalue of up to 1000) is no longer small beside the ridge.
LEAST_RIDGE = 1e-9
ALPHA_BOUNDS = (LEAST_RIDGE, 1e6)
# In spreads of a feature: below, every sample is alone; above, a function is as good as linear.
WIDTH_BOUNDS = (1e-2, 1e3)
# Variance of groups' constants over that of an observation's noise: below, they are none; above,
# nothing is left of a group's mean. Where the search for it starts.
RATIO_BOUNDS, START_RATIO = (1e-5, 1e8), 0.1
# The penalty: size of A; kappa, and that of a first loose search, in standard errors of a slope;
# inverse width, in units of 1 over sqrt(d) spreads, at which further narrowness is penalised. A
# price that grows with the rows gave up a weak interaction (see
# ``benchmarks/bench_accuracy.py --noise``).
PRICE, KAPPA, LOOSE_KAPPA, NARROW = 0.9, 2.0, 20.0, 1.5
# Standard errors by which the share of a function that is used is smaller than what groups left out
# show. Of 48 tests of arms whose encoders alone err, which three inputs hardly show, 2 made four
# worse by 4 to 10 %, 3 made three worse by 3 to 5 %, and both leave .997 on average; of typical
# arms with 8 cones 2 leaves .85, 3 leaves .87. What 8 to 10 groups show is at times not what others
# do: tests of the gain, of all outputs together, errors by jackknife and medians of groups did no
# better on arms that had not chosen them (``benchmarks/bench_chain.py --few``, seeds 300 to 315 and
# 400 to 407).
SHARE_ERRORS = 2.0
# Groups at the least of which that share is found: of three the rest is hardly the same function.
LEAST_GROUPS = 4
TINY = np.finfo(float).tiny


def log_likelihood(data, value):
    """Logarithm of a marginal likelihood, with its constants, summed over outputs."""
    n = data.n_total
    constant = 0.5 * n * (1 + np.log(2 * np.pi / n)) - 0.5 * np.log(data.weights).sum()
    return -value - data.Y.shape[1] * constant


def of_noise(data):
    """Negative log likelihood where all is noise, and what `likelihoods` says of rows left out."""
    square = np.square(data.targets)
    total = square.sum(axis=0) + data.lost
    value = 0.5 * np.sum(data.n_total * np.log(np.maximum(total, TINY)))
    variance = np.maximum(total / data.n_total, 1e-300)
    return value, 0.5 * (np.sum(square / variance) + len(square) * np.sum(np.log(variance)))


def covariance(data, kernel, log_width, slope=False):
    """Kernel matrix times root weights; with its `slope` by squared distances and scaled rows."""
    root, Xs = np.sqrt(data.weights), data.X * np.exp(-log_width)
    found = radial(kernel, squared_distances(Xs, Xs), slope)
    for matrix in (found if slope else (found,)) if np.any(root != 1.0) else ():
        matrix *= root[:, None]
        matrix *= root
    return (*found, Xs) if slope else found


def exact_likelihood(data, kernel, log_width, log_alpha, ratio=0.0):
    """Negative log marginal likelihood of the process, up to a constant.

    Returns the value; its gradient by log_width, log_alpha and the logarithm of `ratio`, that of
    groups' constants to the noise, (d + q + 1,); the signal variance (q,); and its gradient.
    """
    (n, d), q = data.X.shape, len(log_alpha)
    n_total, lost, constants = data.n_total, data.lost, data.constants(ratio)
    K, slope, Xs = covariance(data, kernel, log_width, slope=True)
    value, gradient, signals = 0.0, np.zeros(d + q + 1), np.empty(q)
    by_theta = np.zeros((q, d + q + 1))
    solutions = of_outputs(data, K, np.exp(log_alpha), ratio)
    for i, (alpha, part, signals[i], solved, half) in enumerate(solutions):
        value += part
        of_noise = lost[i] / alpha
        # Of the inverse, which is the half and its transpose, and of the square of what is solved:
        # the parts that each row's own noise has, and those of groups' constants.
        trace, square = 2 * np.trace(half), solved @ solved
        of_groups = 2 * sum(root @ half[rows, rows] @ root for rows, root in constants)
        between = sum((root @ solved[rows]) ** 2 for rows, root in constants)
        gradient[d + i] = 0.5 * (alpha * (trace + of_groups) + n_total - n)
        gradient[-1] += 0.5 * alpha * of_groups
        by_theta[i, d + i] = -alpha * (square + between) - of_noise
        by_theta[i, -1] = -alpha * between
        half *= slope.T  # symmetric, and the half is in Fortran's order
        gradient[:d] += width_gradient(half, Xs)
        # Of the quadratic form: a'K'a, the weights a being the solution.
        by_theta[i, :d] = -rank_one_gradient(slope, solved, Xs)
        gradient += 0.5 * by_theta[i] / signals[i]
    return value, gradient, signals, by_theta / n_total


def solve_and_invert(C, y, invert=True) -> tuple[np.ndarray, float, Any]:
    """Solution of C x = y, log determinant, and half of the inverse: with its transpose all.

    C, symmetric, is overwritten.
    """
    factor, failed = lapack.dpotrf(C.T, lower=1, overwrite_a=1)
    if failed:
        raise LinAlgError(f"The covariance is not positive definite at row {failed}.")
    log_det = 2 * np.log(factor.diagonal()).sum()
    solved = lapack.dpotrs(factor, y, lower=1)[0]
    if not invert:  # which takes two thirds of the time
        return solved, log_det, None
    factor = lapack.dtrtri(factor, lower=1, overwrite_c=1)[0]
    half = lapack.dlauum(factor, lower=1, overwrite_c=1)[0]  # the lower triangle of the inverse
    half[np.diag_indices(len(C))] *= 0.5
    return solved, log_det, half


def of_outputs(data, K, alphas, ratio=0.0, invert=True):
    """Yield what one factor gives of each output.

    The ridge, the negative log likelihood, the signal variance, and what `solve_and_invert` gives.
    """
    for y, lost, alpha in zip(data.targets.T, data.lost, alphas, strict=True):
        solved, log_det, half = solve_and_invert(data.add_noise(K, alpha, ratio), y, invert)
        quadratic = max(y @ solved + lost / alpha, TINY * data.n_total)
        log_det += (data.n_total - len(K)) * np.log(alpha)
        value = 0.5 * (log_det + data.n_total * np.log(quadratic))
        yield alpha, value, quadratic / data.n_total, solved, half


def likelihoods(data, K, alphas, ratio=0.0, leave_out=True):
    """Negative log likelihood as `exact_likelihood` has it, and of rows left out, by one factor.

    The second is the density of each row, or group with a constant, given all the others, in closed
    form (section 5.4.2 of Rasmussen and Williams), up to a constant, or 0 without `leave_out`.
    Returns, third, the signal variance (q,).
    """
    value, density, signals = 0.0, 0.0, []
    for _, part, signal, solved, half in of_outputs(data, K, alphas, ratio, leave_out):
        value += part
        signals.append(signal)
        if half is None:
            continue
        if data.codes is None:
            share = 2 * half.diagonal()
            square, log_det = np.sum(np.square(solved) / share), np.log(share).sum()
        else:
            square = log_det = 0.0
            for rows in data.groups:
                root = np.linalg.cholesky(half[rows, rows] + half[rows, rows].T)
                along = np.linalg.solve(root, solved[rows])
                square += along @ along
                log_det += 2 * np.log(root.diagonal()).sum()
        density += 0.5 * (square / signal - log_det + len(K) * np.log(signal))
    return value, density, np.array(signals)


def used_share(data, K, alphas, ratio=0.0):
    """Share (q,) of a function that is used, by the deviations from the means of groups left out.

    With y these deviations and f those predicted it is ``sum y.f / sum f.f`` less twice its
    standard error over groups, from 0 to 1. Returns with it the mean square (q,) of what it leaves;
    None if groups are few.
    """
    if data.codes is None or data.codes[-1] + 1 < LEAST_GROUPS:
        return None
    found, weights = data.targets, data.weights[:, None]
    for i, (*_, solved, half) in enumerate(of_outputs(data, K, alphas, ratio)):
        for rows in data.groups:
            inverse = half[rows, rows] + half[rows, rows].T
            found[rows, i] -= np.linalg.solve(inverse, solved[rows])
    y, f = (Groups(data.codes).centred(a, data.weights) for a in (data.Y, found / np.sqrt(weights)))
    starts = [rows.start for rows in data.groups]
    products, squares = (np.add.reduceat(weights * a * f, starts) for a in (y, f))
    size = np.maximum(squares.sum(axis=0), TINY)
    share = products.sum(axis=0) / size
    error = np.linalg.norm(products - share * squares, axis=0) / size
    share = np.clip(share - SHARE_ERRORS * error, 0.0, 1.0)
    free = max(data.n_total - len(products), 1)
    return share, (weights * np.square(y - share * f)).sum(axis=0) / free


def width_gradient(G, A):
    """Sum over pairs of rows of G_ij times d s_ij / d log width, for every feature."""
    square = A * A
    sums = G.sum(axis=1) @ square + G.sum(axis=0) @ square
    return -2 * (sums - 2 * np.einsum("ik,ik->k", A, G @ A))


def rank_one_gradient(slope, a, A):
    """The same of the symmetric G = slope * a a', without forming it."""
    aA = a[:, None] * A
    along = slope @ np.column_stack([a, aA])
    return -2 * (2 * (a * along[:, 0]) @ (A * A) - 2 * np.einsum("ik,ik->k", aA, along[:, 1:]))


@dataclass(frozen=True, eq=False)
class Task:
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
    ranks: np.ndarray | None = None  # if these are the inputs, as `mid_ranks` makes them

    @property
    def n_widths(self):
        """Number of free widths."""
        return 0 if self.length_scale is not None else 1 if self.isotropic else self.used.sum()

    @property
    def n_alphas(self):
        """Number of free ridges."""
        return self.n_outputs if self.alpha is None else 0

    @cached_property
    def bounds(self):
        """Of theta, (n, 2)."""
        bounds = [WIDTH_BOUNDS] * self.n_widths + [ALPHA_BOUNDS] * self.n_alphas
        return np.log(np.reshape(bounds + [RATIO_BOUNDS] * self.constants, (-1, 2)))

    @cached_property
    def given(self):
        """Logarithms of all widths, ridges and the ratio, (d + q + 1,), where theta is 0."""
        width, alpha = self.length_scale, self.alpha
        width = np.where(self.used, self.spread, np.inf) if width is None else width
        alpha = np.ones(self.n_outputs) if alpha is None else np.maximum(alpha, ALPHA_BOUNDS[0])
        return np.append(np.log([*width, *alpha]), 0.0 if self.constants else -np.inf)

    @cached_property
    def free(self):
        """Which of these each theta changes, (n, d + q + 1)."""
        of_alpha = np.full(self.n_outputs, self.alpha is None)
        of_width = self.used & (self.length_scale is None)
        free = np.eye(len(self.given))[[*of_width, *of_alpha, self.constants]]
        k = self.used.sum() if self.isotropic else 0
        return np.vstack([free[:k].sum(axis=0), free[k:]]) if k else free

    def start(self, width, alpha):
        """Theta of one width, in units of sqrt(d) spreads, and one ridge for all."""
        widths = [width * np.sqrt(self.used.sum())] * self.n_widths
        return np.log(widths + [alpha] * self.n_alphas + [START_RATIO] * self.constants)

    def pack(self, structure):
        """Theta of a structure, or near it: what is infinite or nothing is at its bound."""
        values = np.append(structure.length_scale, structure.alpha)
        values = np.log(np.append(values, max(structure.ratio, RATIO_BOUNDS[0])))
        theta = [np.min(values[own] - self.given[own]) for own in self.free > 0]
        return np.clip(theta, *self.bounds.T)

    def unpack(self, theta):
        """Logarithms of all widths (d,) and ridges (q,), and the ratio."""
        d, values = len(self.spread), self.given + theta @ self.free
        return values[:d], values[d:-1], np.exp(values[-1])


def objective(task, theta, data, kernel, kappa=KAPPA):
    """Negative log likelihood with the penalty, in nats, and its gradient by theta."""
    log_width, log_alpha, ratio = task.unpack(theta)
    try:
        value, gradient, signals, of_signals = exact_likelihood(
            data, kernel, log_width, log_alpha, ratio
        )
    except LinAlgError:
        return np.inf, np.zeros(len(theta))
    gradient, of_signals = task.free @ gradient, of_signals @ task.free.T
    penalty, of_penalty = _penalty(task, theta, data, kappa, signals, of_signals)
    return value + penalty, gradient + of_penalty


def _penalty(task, theta, data, kappa, signals, of_signals):
    """The penalty of an end of a search, in nats, and its gradient by theta."""
    # The signal variance in units of an output's variance, on average over outputs.
    rho2, floor = np.exp(-2 * theta[: task.n_widths]), kappa**2 / data.n_total
    price, slope = PRICE * np.log1p(len(rho2)), signals.mean() * rho2
    used = slope / (slope + floor)  # of every feature, between 0 and 1
    narrow = rho2 / (NARROW / np.sqrt(task.used.sum())) ** 2
    value = price * used.sum() + np.log1p(narrow).sum()
    by_slope = price * floor / (slope + floor) ** 2
    gradient = (by_slope @ rho2) * of_signals.mean(axis=0)
    gradient[: len(rho2)] -= 2 * by_slope * slope + 2 * narrow / (1 + narrow)
    if task.n_alphas:
        # Noise below a part of the targets' variance has to be shown.
        noise = signals * np.exp(task.unpack(theta)[1])
        of_log_noise = of_signals / signals[:, None]
        of_log_noise[:, task.n_widths :][:, : task.n_alphas] += np.eye(task.n_alphas)
        value += DOUBT * np.log1p(SILENT / noise).sum()
        gradient -= DOUBT * (SILENT / (SILENT + noise)) @ of_log_noise
    return value, gradient


class End(NamedTuple):
    """Where a search for a kernel ended, and how good that is: all in nats, less is better."""

    kernel: Kernel
    theta: np.ndarray
    likelihood: float  # negative log likelihood
    value: float  # with the penalty
    density: float  # of what is left out

    @property
    def score(self):
        """What ends are compared by: evidence believes too long, left-out density is noisy."""
        return self.value + self.density


def judge(task, kernel, theta, data, leave_out=True):
    """How good an end is, by one factor for all that is asked; see `likelihoods`."""
    log_width, log_alpha, ratio = task.unpack(theta)
    K, alphas = covariance(data, kernel, log_width), np.exp(log_alpha)
    try:
        value, density, signals = likelihoods(data, K, alphas, ratio, leave_out)
    except LinAlgError:
        return End(kernel, theta, np.inf, np.inf, 0.0)
    no_slopes = np.zeros((len(signals), len(theta)))
    penalty = _penalty(task, theta, data, KAPPA, signals, no_slopes)[0]
    return End(kernel, theta, value, value + penalty, density)


def minimise(task, theta, data, kernel, steps, kappa=KAPPA, nats=0.0):
    """Search from a start until two steps gain less than some nats; where it ends, never worse."""
    unit = data.n_total * data.Y.shape[1]
    # Small steps along a valley of the likelihood add up: the tolerance is as small as the cost of
    # a step allows.
    least = np.clip(1e-11 * float(len(data.X)) ** 3, 1e-4, 1e-2)
    values = [np.inf, np.inf]

    def per_observation(theta):
        value, gradient = objective(task, theta, data, kernel, kappa)
        return value / unit, gradient / unit

    def stop(intermediate_result):
        values.append(intermediate_result.fun * unit)
        if values[-3] - values[-1] < nats:  # the first step is a small one
            raise StopIteration

    theta = np.clip(theta, *task.bounds.T)
    if not len(theta):
        return theta
    options = {"maxiter": steps, "ftol": least / unit}
    how = {"method": "L-BFGS-B", "jac": True, "bounds": task.bounds, "options": options}
    return minimize(per_observation, theta, callback=stop, **how).x
