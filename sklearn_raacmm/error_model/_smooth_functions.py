r"""Smooth functions of each joint's angle beside the harmonics that are chosen for themselves.

Harmonics that were not chosen are not known to be absent: that each is small is all that is known.
Where the data ask for it, all low orders therefore join together, with one small variance that
falls with the order. They are a Gaussian process on the circle of every joint. A few lines that
are chosen one by one fit such a function where the poses are, but between and beside them they are
far off, and far too sure.

Chosen lines stay beside it where they are worth their price, and the whole has to raise the
evidence, less the prices, clearly.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import partial

import numpy as np
from scipy.linalg import LinAlgError

from sklearn_raacmm.error_model._harmonic_selection import (
    MAX_CHOICES,
    MAX_STEPS,
    Problem,
    alone,
    extend,
    gains_of,
    posterior_of,
)
from sklearn_raacmm.error_model._leftover import Leftover

# Rise of the evidence, less the prices, that a smooth function has to bring, in nats. Eight
# simulated arms without one show 5 to 10: they gain nothing by it, and their intervals become too
# wide. Of four with such functions in their joints three show 57 to 99, one 5.
_LEAST_RISE = 16.0
# It is tried where that much of it is promised; sizes of its variance that are tried for that,
# relative to that of the harmonics.
_LEAST_PROMISE, _SMOOTH_SIZES = 10.0, 10.0 ** np.arange(-4.0, 0.5, 0.5)
# Steps of the variances between two looks at which pairs have become needless.
_STEPS_WHILE_LEAVING = 1


def add_smooth(sums, family, harmonic, prior_variance, prices, lengths, found, shares):
    """Let all low orders join with small variances, where the data speak for it.

    Harmonics that the smooth function makes needless leave. What is left has to raise the evidence,
    less the prices of the harmonics that are taken for themselves, by 16 nats.

    Parameters
    ----------
    sums, family, harmonic, prior_variance, prices, lengths
        As in :func:`select_harmonics`.
    found : Posterior
        Of the harmonics chosen.
    shares : ndarray of shape (n_pairs,)
        Of `smooth_shares`.

    Returns
    -------
    Posterior or None
        None where the smooth function is not worth it.
    """
    problem = Problem(sums, family, harmonic, prior_variance, lengths)
    base = problem.choice(found.pairs, found.prior_variance, found.noise_variance)
    at, rise = _promise(problem, base, shares)
    if rise < _LEAST_PROMISE:
        return None
    variance = base.prior_variance.copy()
    variance[-1] = at
    before = base.log_evidence - prices(base.pairs)[base.pairs].sum()
    prices = partial(prices, beside_smooth=True)
    new = _beside_smooth(problem, base.pairs, variance, base.noise_variance, prices, shares)
    chosen = new.pairs[~new.smooth]
    if new.log_evidence - prices(chosen)[chosen].sum() < before + _LEAST_RISE:
        return None
    return new


def choose_beside_smooth(sums, family, harmonic, prior_variance, prices, lengths, found, shares):
    """Choose anew beside a smooth function, for sums that have changed a little.

    Parameters and result are those of :func:`add_smooth`.
    """
    problem = Problem(sums, family, harmonic, prior_variance, lengths)
    start = found.prior_variance, found.noise_variance
    pairs, prices = found.pairs[~found.smooth], partial(prices, beside_smooth=True)
    return _beside_smooth(problem, pairs, *start, prices, shares)


def left_out_beside_smooth(sums, family, harmonic, prices, start, shares):
    """Choose from nothing beside a smooth function, at the variances of a fit to more poses.

    Parameters
    ----------
    sums, family, harmonic, prices
        As in :func:`select_harmonics`.
    start : (ndarray of shape (n_families + 1,), float)
        Variances of the families, that of the smooth function last, and of the noise.
    shares : ndarray of shape (n_pairs,)
        Of `smooth_shares`.

    Returns
    -------
    Posterior
    """
    problem = Problem(sums, family, harmonic, start[0], None)
    pairs, prices = np.empty(0, dtype=int), partial(prices, beside_smooth=True)
    pairs = extend(problem, pairs, *start, prices, _joined(pairs, shares))
    while True:
        every, smooth, share = _joined(pairs, shares)
        found = posterior_of(problem.part(every, smooth, share), *start)
        found = found._replace(pairs=every, smooth=smooth, gains=gains_of(found))
        worth = _worth(found, prices)
        if worth.all():
            return found
        pairs = pairs[worth]


def _promise(problem, found, shares):
    """Variance of a smooth function beside chosen pairs, and rise of the evidence it may bring.

    As though its columns were independent of each other: what one shows is counted again for those
    that resemble it, so that the rise is rather too large, and one product per column is enough.
    """
    variance = found.prior_variance
    known = found.pairs, *alone(found.pairs)
    try:
        left = Leftover(problem, *known, variance, found.noise_variance)
    except LinAlgError:  # so little noise that only rounding is left
        return 1.0, -np.inf
    shares = shares[left.free]
    some = shares > 0
    size = np.maximum(left.own[:2, some] - 1 / left.prior, 0.0)
    seen = np.square(left.r.reshape(-1, 2)[some].T)
    sizes = variance[problem.harmonic] * shares[some] * _SMOOTH_SIZES[:, None, None]
    rises = seen * sizes / (1 + size * sizes) - np.log1p(size * sizes)
    rises = 0.5 * rises.sum(axis=(1, 2))
    best = int(np.argmax(rises))
    return variance[problem.harmonic] * _SMOOTH_SIZES[best], float(rises[best])


def _joined(pairs, shares):
    """Chosen pairs and those of the smooth function, sorted; which are of it; their shares."""
    every = np.union1d(pairs, np.flatnonzero(shares > 0)).astype(int)
    smooth = ~np.isin(every, pairs)
    return every, smooth, np.where(smooth, shares[every], 1.0)


def _beside_smooth(problem, pairs, variance, noise, prices, shares):
    """Posterior of chosen pairs and a smooth function, from given variances.

    Pairs that it makes needless leave, and others that are worth their price beside it join.
    """
    tried = set()
    for _ in range(MAX_CHOICES):
        found = _without_needless(problem, pairs, variance, noise, prices, shares)
        variance, noise = found.prior_variance, found.noise_variance
        pairs = found.pairs[~found.smooth]
        tried.add(frozenset(pairs.tolist()))
        pairs = extend(problem, pairs, variance, noise, prices, _joined(pairs, shares))
        if frozenset(pairs.tolist()) in tried:
            break
    return found


def _without_needless(problem, pairs, variance, noise, prices, shares):
    """Posterior of a smooth function and those of some pairs that are worth their price beside it.

    The variances follow a few steps at a time while pairs leave, and settle at the end.
    """
    steps, start = _STEPS_WHILE_LEAVING, (variance, noise)
    while True:
        found = problem.find_variances(*_joined(pairs, shares), start, max_steps=steps)
        found = found._replace(gains=gains_of(found))
        worth = _worth(found, prices)
        if not worth.all():
            start = found.prior_variance, found.noise_variance
            pairs, steps = pairs[worth], _STEPS_WHILE_LEAVING
        elif steps < MAX_STEPS:
            start, steps = found, MAX_STEPS
        else:
            return found


def _worth(found, prices):
    """Which of the chosen pairs are worth their price."""
    chosen = found.pairs[~found.smooth]
    return found.gains[~found.smooth] > prices(chosen)[chosen]
