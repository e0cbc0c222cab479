"""How far errors at positions left out exceed what the posterior says, and intervals that hold.

A posterior knows only of the causes that are in its model, so that its standard deviations are too
small wherever the model is not complete. Errors at positions that had no part in a fit show by how
much. Without a block the harmonics are chosen again, with the variances that the whole has found.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln
from scipy.stats import norm, t
from sklearn.cluster import KMeans

from sklearn_raacmm.arm import points_of
from sklearn_raacmm.error_model._columns import FAMILIES, HARMONIC, term_names
from sklearn_raacmm.error_model._harmonic_selection import select_harmonics
from sklearn_raacmm.error_model._linear_fit import SMOOTH, FitData, model_of
from sklearn_raacmm.error_model._order_scan import candidate_sums, sums_of_the_others
from sklearn_raacmm.error_model._orders import offered_harmonics, order_prices, smooth_shares
from sklearn_raacmm.error_model._smooth_functions import left_out_beside_smooth
from sklearn_raacmm.utils import centred, group_means, group_weights

# Blocks left out in turn, and the fewest positions that are worth leaving some out: of three the
# rest is hardly the model that is judged.
N_BLOCKS, LEAST_POSITIONS = 10, 4
# Spread of the priors of log a and log b about their means; rate of the Gamma(2) prior of the
# degrees of freedom (M. A. Juarez, M. F. J. Steel, J. Bus. Econ. Stat. 28, 2010); limits of the
# search.
_LOG_SPREAD, _PER_FREEDOM = 1.0, 0.1
# Mean of the prior of log b in a single-point test; with a tracker it is 0. What matters there are
# errors that a whole position has in common. Deviations from its mean do not show them, and with 12
# or 20 positions show little of b: over 128 simulated tests (typical, gravity, eccentricity, soft)
# what they showed had no correlation with what the true errors needed, which was 2.0 in the mean.
# With this prior 94 % of all true errors lie inside, and 15 of the 128 tests hold less than 85 %;
# with 0 it is 92 %, and 26. Where the model is complete the deviations are then 7 % too large.
_USUAL_LOG_B = 0.7
_SEARCH = {"xatol": 1e-4, "fatol": 1e-6, "maxiter": 500}
# From the better of two starts the search goes on to here: fading acts on the result, which has to
# be the same for a weight of 2 and a row that is there twice.
_POLISH = {"xatol": 1e-8, "fatol": 1e-12, "maxiter": 500}
# Orders offered to the models without a block, beside those that the whole has chosen: the choice
# of low orders is made anew, high ones take most of the time. They have to be worth the price of a
# high order again: on 22 simulated sets (tracker, single-point, causes without columns, weak gears)
# the models without a block were the same to the last digit with all orders offered again.
_HIGHEST_ORDER = 72
# Errors of one position that count as independent, of each coordinate.
_EFFECTIVE_ROWS = 3.0


def leave_out(model, options, X, y, weights, codes, positions, n_blocks=N_BLOCKS):
    """Models of the rows outside each block of neighbouring positions.

    Parameters
    ----------
    model : LinearModel
        Fitted on all rows.
    options : LinearOptions
    X : ndarray of shape (n, n_joints)
    y : ndarray of shape (n, 3) or (n, 6)
        As `candidate_sums` takes it, for the `turn_mm` of the model.
    weights : ndarray of shape (n,)
        Those of the fit. Rows of weight 0 teach nothing.
    codes : ndarray of shape (n,) or None
        Position of each row, where positions have offsets.
    positions : ndarray of shape (n,)
        Position of each row.
    n_blocks : int, default=10

    Returns
    -------
    list of (ndarray, LinearModel)
        Indices of the rows of each block, and the model of the others; empty where all positions
        are at one place, or all weight is in one block.
    """
    positions = np.unique(positions, return_inverse=True)[1].ravel()
    # Weights of equal size: a position without weight is still at its place.
    angles = X[:, : model.arm.n_joints]
    points = points_of(model.arm, angles)
    blocks = blocks_of_positions(points, positions, np.ones(len(X)), n_blocks)
    if blocks is None or not model.noise_variance > 0:
        return []
    offered, expected = offered_harmonics(
        angles, options.max_order, options.orders, options.gear_ratio
    )
    chosen = {tuple(pair) for pair in model.terms.harmonics.tolist()}
    low = offered[:, 1] <= _HIGHEST_ORDER
    used = [i or tuple(p) in chosen for i, p in zip(low, offered.tolist(), strict=True)]
    offered, expected = offered[used], expected[used]
    terms, family = model.terms._replace(harmonics=offered), term_names(model.arm, model.terms)[1]
    variance = np.array([model.prior_sd.get(name, 1.0) ** 2 for name in (*FAMILIES, SMOOTH)])
    shares = smooth_shares(offered[:, 1]) if SMOOTH in model.prior_sd else None
    prices, start = order_prices(offered, expected), (variance, model.noise_variance)
    kept = weights > 0
    labels = np.unique(blocks)
    if len(np.unique(blocks[kept])) < 2:
        return []  # all that has weight is in one block
    parts = []
    for block in labels:
        rows = (blocks == block) & kept
        if not rows.any():  # they count for nothing, but their errors are asked for
            rows = blocks == block
        own = _codes_of(codes, rows)
        poses = X[rows], y[rows], weights[rows]
        sums = candidate_sums(model.arm, *poses, own, offered, terms, model.turn_mm)
        parts.append(sums._replace(n_observations=max(sums.n_observations, 0.0)))
    found = []
    for block, sums in zip(labels, sums_of_the_others(parts), strict=True):
        rest = (blocks != block) & kept
        if shares is None:
            fixed = prices, None, start, True
            best = select_harmonics(sums, family, HARMONIC, variance, *fixed)
        else:
            best = left_out_beside_smooth(sums, family, HARMONIC, prices, start, shares)
        own = _codes_of(codes, rest)
        data = FitData(model.arm, X[rest], y[rest], weights[rest], own, [], options)
        data = data._replace(turn_mm=model.turn_mm)
        rest_terms = terms._replace(harmonics=offered[best.pairs])
        every = np.ones(rest.sum())
        found.append((np.flatnonzero(blocks == block), model_of(data, every, best, rest_terms)))
    return found


def _codes_of(codes, rows):
    """Positions of some rows, from 0, where positions have offsets."""
    return None if codes is None else np.unique(codes[rows], return_inverse=True)[1].ravel()


def errors_left_out(left_out, X, y, codes, weights=None):
    """Errors and standard deviations at the rows of each block, by the model of the others.

    Parameters
    ----------
    left_out : list
        Of `leave_out`.
    X, y, codes
        As there.
    weights : ndarray of shape (n,), default=None
        Of the rows in the means of their positions.

    Returns
    -------
    errors, std : ndarray of shape (n, 3)
        In mm; where positions have offsets, of deviations from the position's mean. `std` is that
        of the model, without noise.
    """
    errors, std = np.empty_like(y), np.empty_like(y)
    for rows, rest in left_out:
        if codes is None:
            mean, std[rows] = rest.predict(X[rows], return_std=True)
            errors[rows] = y[rows] - mean
            continue
        own, worth = _codes_of(codes, rows), None if weights is None else weights[rows]
        columns = centred(rest.columns(X[rows]), own, worth)
        errors[rows] = centred(y[rows], own, worth) - columns @ rest.coef
        dots = columns @ rest.half
        std[rows] = np.sqrt(np.einsum("ncr,ncr->nc", dots, dots))
    return errors, std


def with_honest_intervals(model, left_out, X, y, weights, codes, positions):
    """Model whose intervals are as wide as its errors at positions left out ask for.

    Errors e at positions left out, in units of ``sqrt(a n^2 + b s^2)`` with n the noise and s the
    posterior standard deviation, are a Student variable: a, b and its degrees of freedom have the
    highest posterior. Weak priors about a = b = 1 keep these values where there is no evidence
    against them; in a single-point test, which shows little of b, its prior is about 2. Both
    deviations are then multiplied so that 1.96 of them hold 95 %.

    Parameters
    ----------
    model : LinearModel
    left_out : list
        Of `leave_out`.
    X, y, codes, positions
        As there.
    weights : ndarray of shape (n,)
        Of the rows as measured: outliers count, too.

    Returns
    -------
    LinearModel
        The same one where there are too few positions to leave some out.
    """
    n_positions = len(np.unique(positions))
    if not left_out or n_positions < LEAST_POSITIONS:
        return model
    errors, std = errors_left_out(left_out, X, y, codes, weights)
    noise = np.full(errors.shape, model.noise_sd)
    if codes is not None:  # the position's own mean has taken its share of the noise
        share = 1 / np.maximum(group_weights(codes, weights)[codes], 1.0)
        noise *= np.sqrt(1 - share)[:, None]
    worth = min(1.0, _EFFECTIVE_ROWS * n_positions / weights.sum())
    usual = 0.0 if codes is None else _USUAL_LOG_B
    noise_scale, std_scale = interval_scales(errors, noise, std, weights, worth, usual)
    return replace(model, noise_scale=noise_scale, std_scale=std_scale)


def interval_scales(errors, noise, std, weights, worth=1.0, usual_log_b=0.0):
    """Factors of noise and standard deviation at which intervals of 95 % hold.

    Parameters
    ----------
    errors, noise, std : ndarray of shape (n, 3)
        Errors, and what the noise and the model say of them.
    weights : ndarray of shape (n,)
    worth : float
        Independent errors per coordinate: those of one position resemble each other.
    usual_log_b : float
        Mean of the prior of the logarithm of b (see `with_honest_intervals`).

    Returns
    -------
    noise_scale, std_scale : float
    """
    # Rows of no deviation at all, of positions of one pose, say nothing.
    used = np.square(noise) + np.square(std) > 0
    weight = np.broadcast_to(weights[:, None], errors.shape)[used]
    e2, n2, s2 = (np.square(values[used]) for values in (errors, noise, std))
    if not len(e2):
        return 1.0, 1.0

    def level(freedom):
        """Logarithm of a Student variable's density at 0."""
        return gammaln((freedom + 1) / 2) - gammaln(freedom / 2) - 0.5 * np.log(np.pi * freedom)

    usual = np.array([0.0, usual_log_b])

    def loss(logs):
        a, b, freedom = np.exp(logs)
        variance = a * n2 + b * s2
        # As t.logpdf of SciPy, whose checks would take 40 % of the time of a fit to 60 rows.
        size = np.log1p(e2 / (freedom * variance))
        density = level(freedom) - 0.5 * ((freedom + 1) * size + np.log(variance))
        prior = 0.5 * np.square((logs[:2] - usual) / _LOG_SPREAD).sum() + _PER_FREEDOM * freedom
        return -worth * (weight @ density) + prior - 2 * logs[2]

    starts = ([0.0, 0.0, 3.0], [-1.0, 2.0, 1.5])
    found = [minimize(loss, start, method="Nelder-Mead", options=_SEARCH) for start in starts]
    best = min(found, key=lambda one: one.fun).x
    a, b, freedom = np.exp(minimize(loss, best, method="Nelder-Mead", options=_POLISH).x)
    widening = t.ppf(0.975, freedom) / norm.ppf(0.975)
    return float(widening * np.sqrt(a)), float(widening * np.sqrt(b))


def blocks_of_positions(points, positions, weights, n_blocks):
    """Blocks of neighbouring positions, by k-means among their mean points.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
    positions : ndarray of shape (n,)
        Position of each row, from 0.
    weights : ndarray of shape (n,)
    n_blocks : int

    Returns
    -------
    ndarray of shape (n,) or None
        Block of each row; None where all positions are at one place.
    """
    means, place = np.unique(
        group_means(points, positions, weights), axis=0, return_inverse=True
    )  # repeated rows, each a position of its own, are no more places than one
    n_blocks = min(n_blocks, len(means))
    if n_blocks < 2:
        return None
    blocks = np.arange(len(means))
    if n_blocks < len(means):
        blocks = KMeans(n_blocks, n_init=4, random_state=0).fit_predict(means)
    return blocks[place.ravel()[positions]]
