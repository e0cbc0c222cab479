r"""Smooth functions of each joint's angle beside the harmonics that are chosen for themselves.

Harmonics that were not chosen are not known to be absent: that each is small is all that is known.
Where the data ask for it, all low orders therefore join together, with one small variance that
falls with the order. They are a Gaussian process on the circle of every joint. A few lines that
are chosen one by one fit such a function where the poses are, but between and beside them they are
far off, and far too sure.

Chosen lines stay beside it where they are worth their price, and the whole has to raise the
evidence, less the prices, by the price of one line.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.linalg import LinAlgError

from sklearn_raacmm.error_model._harmonic_selection import (
    MAX_CHOICES,
    Leftover,
    Problem,
    alone,
    extend,
    gains_of,
    posterior_of,
)

# A smooth function is tried where it may bring this share of the least price; sizes of its variance
# that are tried for that, relative to that of the harmonics.
_LEAST_PROMISE, _SMOOTH_SIZES = 0.5, 10.0 ** np.arange(-4.0, 0.5, 0.5)


def add_smooth(sums, family, harmonic, prior_variance, prices, lengths, found, shares):
    """Let all low orders join with small variances, where the data speak for it.

    Harmonics that the smooth function makes needless leave. What is left has to raise the evidence,
    less the prices of the harmonics that are taken for themselves, by the price of one of them.

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
    least = float(prices(found.pairs[:0]).min())
    at, rise = _promise(problem, base, shares)
    if rise < _LEAST_PROMISE * least:
        return None
    variance = base.prior_variance.copy()
    variance[-1] = at
    new = _beside_smooth(
        problem, base.pairs, variance, base.noise_variance, prices, shares, fixed=False
    )
    before = base.log_evidence - prices(base.pairs)[base.pairs].sum()
    chosen = new.pairs[~new.smooth]
    if new.log_evidence - prices(chosen)[chosen].sum() < before + least:
        return None
    return new


def choose_beside_smooth(sums, family, harmonic, prior_variance, prices, lengths, found, shares):
    """Choose anew beside a smooth function, for sums that have changed a little.

    Parameters and result are those of :func:`add_smooth`.
    """
    problem = Problem(sums, family, harmonic, prior_variance, lengths)
    start = found.prior_variance, found.noise_variance
    pairs = found.pairs[~found.smooth]
    return _beside_smooth(problem, pairs, *start, prices, shares, fixed=False)


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
    none = np.empty(0, dtype=int)
    return _beside_smooth(problem, none, *start, prices, shares, fixed=True)


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
    free = np.setdiff1d(np.flatnonzero(shares > 0), found.pairs)
    size = np.maximum(left.own[:2, free] - 1 / left.prior, 0.0)
    seen = np.square(left.r.reshape(-1, 2)[free].T)
    sizes = variance[problem.harmonic] * shares[free] * _SMOOTH_SIZES[:, None, None]
    rises = seen * sizes / (1 + size * sizes) - np.log1p(size * sizes)
    rises = 0.5 * rises.sum(axis=(1, 2))
    best = int(np.argmax(rises))
    return variance[problem.harmonic] * _SMOOTH_SIZES[best], float(rises[best])


def _joined(pairs, shares):
    """Chosen pairs and those of the smooth function, sorted; which are of it; their shares."""
    every = np.union1d(pairs, np.flatnonzero(shares > 0)).astype(int)
    smooth = ~np.isin(every, pairs)
    return every, smooth, np.where(smooth, shares[every], 1.0)


def _beside_smooth(problem, pairs, variance, noise, prices, shares, fixed):
    """Posterior of chosen pairs and a smooth function, from given variances.

    Pairs that it makes needless leave, and others that are worth their price beside it join.
    """
    tried = set()
    for _ in range(MAX_CHOICES):
        joined = _joined(pairs, shares)
        if fixed:
            every, smooth, _ = joined
            found = posterior_of(problem.part(*joined), variance, noise)
            found = found._replace(pairs=every, smooth=smooth)
        else:
            found = problem.find_variances(*joined, variance, noise)
            variance, noise = found.prior_variance, found.noise_variance
        found = found._replace(gains=gains_of(found))
        worth = found.gains[~found.smooth] > prices(pairs)[pairs]
        tried.add(frozenset(pairs.tolist()))
        pairs = pairs[worth]
        pairs = extend(problem, pairs, variance, noise, prices, _joined(pairs, shares))
        if frozenset(pairs.tolist()) in tried:
            break
    return found
