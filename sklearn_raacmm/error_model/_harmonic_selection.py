r"""Choice of harmonics by the evidence, with priors found by the data.

The model is linear, :math:`y = A w + H u + e` with noise variance :math:`s^2`. The columns A are
always in; those of H are in pairs, the cosine and the sine of one harmonic, of which few are taken.
Each coefficient has a normal prior of mean 0 whose variance is that of its family.

A harmonic joins if that multiplies the marginal likelihood by more than its price, the prior odds
against it (:func:`order_prices`). Selection is that of orthogonal least squares, on the penalised
Gram matrix instead of the columns, a pair at a time. Variances and choice take turns: on a fixed
choice the variances follow MacKay's fixed point [1]_, the sum of squares of a family's
coefficients over the number of them that the data determine; then harmonics join at these
variances, and those that the others have made needless leave, while the evidence less the prices
rises.

Harmonics that were not taken are not known to be absent: see `_smooth_functions`.

References
----------
.. [1] D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4(3), 1992, 415-447.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_solve

from sklearn_raacmm.error_model._leftover import Leftover, root_of
from sklearn_raacmm.error_model._order_scan import columns_of
from sklearn_raacmm.utils import invert_triangle

# Rounds of the choice, and steps of the variances in each, at most. Both stop by the evidence:
# few problems take more than 5 and 30.
MAX_CHOICES, MAX_STEPS = 10, 100
# Rise of the evidence, in nats, that is not worth another step: it moves no coefficient by more
# than a few per cent of its standard deviation.
_SMALL_RISE = 0.01
# Steps of the variances where they are nearly right: others follow, with the robust weights.
_REFIT_STEPS = 5
# Noise is known beforehand as three observations would show it, at a hundredth of the square of y:
# with fewer rows than columns the evidence else grows without limit as all noise is explained away.
_ASSUMED_ROWS, _ASSUMED_SHARE = 3.0, 0.01
# Bounds of a family's variance. Below: relative to the first guess. Above: one degree, in square
# arc seconds, beyond which an arm's errors are not linear; directions that the data do not show
# would carry the variance beyond all bounds by their rounding.
_LEAST_SHARE, _LARGEST_VARIANCE = 1e-8, 3600.0**2
# Least mean square of residuals, mm^2: its square is a number yet.
_NO_NOISE = 1e-120
# Least noise variance, relative to the mean square of y; halvings of a step that lowers evidence.
_LEAST_NOISE, _HALVINGS = 1e-12, 5
# Share of the largest eigenvalue of the always-in columns' scaled Gram matrix below which a
# direction is rounding, not data.
_ROUNDING = 1e-12
# Size of a column, relative to the largest, that is rounding, too.
_NO_SIZE = 1e-7
# Harmonics are guessed to be so many, for the first choice.
_GUESSED_PAIRS = 12
# Of the next best candidates, how many are named as likely to be asked for next.
_LIKELY = 48


class Posterior(NamedTuple):
    """Coefficients of the chosen columns and what they are worth."""

    pairs: np.ndarray  # (k,) candidates in the model, sorted
    smooth: np.ndarray  # (k,) which of them are there as parts of a smooth function only
    gains: np.ndarray  # (k,) log Bayes factor of each, beside all others
    coef: np.ndarray  # (m + 2 k,) of the columns that are always in, then of the chosen pairs
    half: np.ndarray  # (m + 2 k, m + 2 k) with covariance = half @ half.T
    prior_variance: np.ndarray  # (n_families + 1,) the last one of the smooth function
    prior: np.ndarray  # (m + 2 k,) variance of each coefficient before any data
    noise_variance: float
    n_determined: float
    log_evidence: float  # up to a constant of the data
    determined: np.ndarray  # (m + 2 k,) share of each coefficient that the data determine
    n_always: int  # m


def select_harmonics(
    sums,
    family,
    harmonic,
    prior_variance,
    prices,
    lengths=None,
    start=None,
    fixed=False,
):
    """Choose harmonics and fit all coefficients.

    Parameters
    ----------
    sums : CandidateSums
    family : ndarray of shape (m,)
        Family of each column that is always in.
    harmonic : int
        Family of the candidates.
    prior_variance : ndarray of shape (n_families + 1,)
        Variances that are known; NaN for those to be found. The last one is that of a smooth
        function, which is not used here.
    prices : callable
        From the candidates chosen so far, an array of indices, to the price of every candidate in
        nats, (n_pairs,).
    lengths : Lengths, optional
        Observations whose variance is known but for their share of the noise. Columns: those of
        the candidates, then those that are always in.
    start : (ndarray of shape (n_families + 1,), float), optional
        Variances of the families and of the noise to begin with, such as those of a fit to nearly
        the same data.
    fixed : bool, default=False
        Choose once, at the variances of `start`, and leave these as they are.

    Returns
    -------
    Posterior
    """
    problem = Problem(sums, family, harmonic, prior_variance, lengths)
    pairs = np.empty(0, dtype=int)
    if start is None:
        # Without harmonics their variance stays at its guess; noise and other families are found.
        found = problem.choice(pairs, *problem.first_guess())
        start = found.prior_variance, found.noise_variance
    if fixed:
        return _prune(problem, extend(problem, pairs, *start, prices), *start, prices)[0]
    best, best_value, tried = None, -np.inf, set()
    for _ in range(MAX_CHOICES):
        pairs = extend(problem, pairs, *start, prices)
        found = problem.choice(pairs, *start)
        start = found.prior_variance, found.noise_variance
        found, paid = _prune(problem, pairs, *start, prices)
        pairs = found.pairs
        if found.log_evidence - paid > best_value + _SMALL_RISE:
            best, best_value = found, found.log_evidence - paid
        elif best is not None:
            break
        if frozenset(pairs.tolist()) in tried:
            break
        tried.add(frozenset(pairs.tolist()))
    return best


def refit(sums, family, harmonic, prior_variance, found, shares, lengths, start):
    """Variances and coefficients of all candidates of `sums`, from variances nearly right.

    Parameters
    ----------
    sums, family, harmonic, prior_variance, lengths
        As in :func:`select_harmonics`; the candidates are the pairs of `found`.
    found : Posterior
    shares : ndarray of shape (k,)
        Of `smooth_shares`.
    start : (ndarray of shape (n_families + 1,), float)

    Returns
    -------
    Posterior
    """
    problem = Problem(sums, family, harmonic, prior_variance, lengths)
    every = np.arange(len(found.pairs))
    share = np.where(found.smooth, shares, 1.0)
    new = problem.find_variances(every, found.smooth, share, start, max_steps=_REFIT_STEPS)
    return new._replace(pairs=found.pairs, gains=gains_of(new))


class Problem:
    """Sums over poses, known lengths and priors."""

    def __init__(self, sums, family, harmonic, prior_variance, lengths):
        self.sums = _without_rounding(sums)
        self.family, self.harmonic = family, harmonic
        self.known = np.isfinite(prior_variance)
        self.given = prior_variance
        self.lengths = lengths
        self.n = max(sums.n_observations, 1.0)
        noise = max(sums.square / self.n, _NO_NOISE)
        self.start = noise
        self.assumed = _ASSUMED_ROWS * _ASSUMED_SHARE * noise
        self.guess = self._first_guess()
        self._last_pairs = self._last_products = None  # most choices have the columns of the last

    def first_guess(self):
        """Variances of the families and of the noise before anything is known."""
        return np.minimum(self.guess, _LARGEST_VARIANCE), self.start

    def _first_guess(self):
        """Variances at which the columns of a family together would explain as much as there is."""
        variance = np.where(self.known, self.given, 1.0)
        diagonal = self.sums.gram.diagonal()
        sizes = {f: diagonal[self.family == f].sum() for f in np.unique(self.family)}
        if self.sums.own.size:
            sizes[self.harmonic] = _GUESSED_PAIRS * self.sums.own[:2].sum(axis=0).mean()
        for f, size in sizes.items():
            if not self.known[f]:
                variance[f] = self.start * self.n / size if size > 0 else 1.0
        return variance

    def find_variances(self, pairs, smooth, share, start, max_steps=MAX_STEPS):
        """Coefficients of a fixed choice at the variances of highest evidence.

        `start` are variances and noise, or the posterior of this choice where it is known.
        """
        part = self.part(pairs, smooth, share)
        found = start if isinstance(start, Posterior) else posterior_of(part, *start)
        for _ in range(max_steps):
            last = found
            found = self._step(part, last)
            if not found.log_evidence > last.log_evidence + _SMALL_RISE:
                break
        best = max(found, last, key=lambda one: one.log_evidence)
        return best._replace(pairs=pairs, smooth=smooth)

    def choice(self, pairs, variance, noise):
        """Coefficients of chosen pairs alone at the variances of highest evidence."""
        return self.find_variances(pairs, *alone(pairs), (variance, noise))

    def part(self, pairs, smooth, share):
        """Normal equations of some pairs; the variance of those of `smooth` is a share of its."""
        columns, lengths = columns_of(pairs), self.lengths
        if lengths is not None:
            n_waves = self.sums.cross.shape[1]
            mine = [lengths.rows[:, n_waves:], lengths.rows[:, columns]]
            lengths = lengths._replace(rows=np.concatenate(mine, axis=1))
        of_pair = np.where(smooth, len(self.given) - 1, self.harmonic)
        family = np.concatenate([self.family, np.repeat(of_pair, 2)])
        m = len(self.family)
        share = np.concatenate([np.ones(m), np.repeat(share, 2)])
        if not np.array_equal(pairs, self._last_pairs):
            self._last_pairs, self._last_products = pairs, self._products(pairs, columns)
        sizes = self.sums.square, self.n, self.assumed
        return _Part(*self._last_products, *sizes, family, share, lengths, m)

    def _products(self, pairs, columns):
        """Gram matrix of the columns that are always in and of some pairs, and products with y."""
        sums, m = self.sums, len(self.family)
        gram = np.empty((m + len(columns), m + len(columns)))
        gram[:m, :m], gram[:m, m:] = sums.gram, sums.cross[:, columns]
        gram[m:, :m] = gram[:m, m:].T
        rows = sums.rows(pairs, beside=pairs)
        np.add(rows, rows.T, out=gram[m:, m:])
        gram[m:, m:] *= 0.5
        moment = np.concatenate([sums.moment, sums.candidate_moment[columns]])
        return gram, np.ascontiguousarray(gram[::-1, ::-1]), moment

    def _step(self, part, last):
        """MacKay's step, half of it and so on (in logarithms) where the evidence falls."""
        variance, noise = _fixed_point(part, last)
        least = _LEAST_SHARE * self.guess
        variance = np.clip(variance, least, np.maximum(least, _LARGEST_VARIANCE))
        variance = np.where(self.known, self.given, variance)
        noise = max(noise, _LEAST_NOISE * self.start)
        for _ in range(_HALVINGS):
            found = posterior_of(part, variance, noise)
            if found.log_evidence >= last.log_evidence:
                break
            variance = np.sqrt(variance * last.prior_variance)
            noise = np.sqrt(noise * last.noise_variance)
        return found


class _Part(NamedTuple):
    """Normal equations of a fixed choice of columns."""

    gram: np.ndarray
    backwards: np.ndarray  # the same, from the last row and column to the first
    moment: np.ndarray
    square: float
    n: float
    assumed: float
    family: np.ndarray
    share: np.ndarray  # of its family's variance, of each coefficient
    lengths: object
    n_always: int


def posterior_of(part, variance, noise):
    """Coefficients and evidence at given variances."""
    prior = variance[part.family] * part.share
    # The last column is eliminated first: those that are always in then have the shortest rows of
    # `half`, which makes standard deviations cheap (see `FactoredColumns`).
    S, r = part.backwards / noise, part.moment / noise
    fixed = (part.n + _ASSUMED_ROWS) * np.log(noise) + (part.square + part.assumed) / noise
    if part.lengths is not None:
        precision = 1 / (part.lengths.variance + noise * part.lengths.share)
        weighted = part.lengths.rows.T * precision
        S += (weighted @ part.lengths.rows)[::-1, ::-1]
        r = r + weighted @ part.lengths.errors
        fixed += precision @ np.square(part.lengths.errors) - np.log(precision).sum()
    S[np.diag_indices(len(S))] += 1 / prior[::-1]
    coef, half, volume = r, S, np.log(prior).sum()
    if len(S):
        root = root_of(S.T, lower=True)  # of which S.T is the same, in the order of Fortran
        coef = cho_solve((root, True), r[::-1], check_finite=False)[::-1]
        volume += 2 * np.log(root.diagonal()).sum()
        invert_triangle(root)
        half = root.T[::-1]
    determined = 1 - np.einsum("ij,ij->i", half, half) / prior
    return Posterior(
        pairs=None,
        smooth=None,
        gains=None,
        coef=coef,
        half=half,
        prior_variance=variance,
        prior=prior,
        noise_variance=float(noise),
        n_determined=float(determined.sum()),
        log_evidence=float(-0.5 * (fixed - r @ coef + volume)),
        determined=determined,
        n_always=part.n_always,
    )


def _fixed_point(part, found):
    """MacKay's variances of the families and of the noise."""
    variance = found.prior_variance.copy()
    for f in np.unique(part.family):
        of_f = part.family == f
        total = (np.square(found.coef[of_f]) / part.share[of_f]).sum()
        variance[f] = total / max(found.determined[of_f].sum(), 1e-12)
    coef = found.coef
    rss = part.square - 2 * coef @ part.moment + coef @ part.gram @ coef
    free = max(part.n - found.n_determined, 0.0)
    return variance, (max(rss, 0.0) + part.assumed) / (free + _ASSUMED_ROWS)


def _without_rounding(sums):
    """Sums without the directions of the always-in columns that hold only rounding.

    A single-point test does not show where the base stands: the exact sums vanish along such
    directions, the computed ones do not quite, and a wide prior would take that for information.
    """
    size = np.sqrt(np.maximum(sums.gram.diagonal(), 0.0))
    if not size.any():
        return sums
    size = np.maximum(size, _NO_SIZE * size.max())
    value, vectors = np.linalg.eigh(sums.gram / np.outer(size, size))
    kept = value > _ROUNDING * value[-1]
    seen = vectors[:, kept]
    root = size[:, None] * seen * np.sqrt(value[kept])
    to_seen = seen.T / size

    def clean(products):
        return size.reshape(-1, *[1] * (products.ndim - 1)) * (seen @ (to_seen @ products))

    return sums._replace(gram=root @ root.T, moment=clean(sums.moment), cross=clean(sums.cross))


def extend(problem, pairs, variance, noise, prices, known=None):
    """Chosen pairs and those that raise the evidence by more than their price, at given variances.

    With S the penalised Gram matrix of what is left of the columns beside the chosen ones and r
    their products with what is left of y, a pair b raises the log evidence by
    r_b' inv(S_b) r_b / 2 - log det(v S_b) / 2, v its prior variance.

    S is never formed nor downdated as a whole: as in a pivoted Cholesky factorisation, the factor's
    rows and the pairs' own 2 x 2 blocks suffice.
    """
    known = (pairs, *alone(pairs)) if known is None else known
    try:
        left = Leftover(problem, *known, variance, noise)
    except LinAlgError:  # so little noise that only rounding is left of the others
        return pairs
    chosen = pairs.tolist()
    alive = np.ones(len(left.free), dtype=bool)
    while alive.any():
        gain, sound = left.gains()
        alive &= sound
        price = prices(np.array(chosen, dtype=int))[left.free]
        net = np.where(alive, gain - price, -np.inf)
        best = int(np.argmax(net))
        if not net[best] > 0:
            break
        likely = np.argsort(-net, kind="stable")[: min(_LIKELY, np.count_nonzero(net > 0))]
        alive[best] = False
        try:
            left.take(best, likely.tolist())
        except LinAlgError:
            continue
        chosen.append(int(left.free[best]))
    return np.sort(np.array(chosen, dtype=int))


def _prune(problem, pairs, variance, noise, prices):
    """Drop pairs, the least one first, whose loss the others make good; at given variances.

    Returns
    -------
    found : Posterior
    paid : float
        Sum of the prices of the pairs that are left.
    """
    while True:
        smooth, share = alone(pairs)
        found = posterior_of(problem.part(pairs, smooth, share), variance, noise)
        gains = gains_of(found)
        price = prices(pairs)[pairs] if len(pairs) else gains
        net = gains - price
        if not len(net) or net.min() > 0:
            return found._replace(pairs=pairs, smooth=smooth, gains=gains), float(price.sum())
        pairs = np.delete(pairs, np.argmin(net))


def alone(pairs):
    """No pair is a part of a smooth function, and each has the whole variance of its family."""
    return np.zeros(len(pairs), dtype=bool), np.ones(len(pairs))


def gains_of(found):
    """Rise of the log evidence by each pair, beside all others."""
    n_waves = len(found.coef) - found.n_always
    first = found.n_always
    if not n_waves:
        return np.empty(0)
    half = found.half[first:].reshape(n_waves // 2, 2, -1)
    covariance = half @ half.swapaxes(1, 2)
    coef = found.coef[first:].reshape(-1, 2)
    fit = np.einsum("bi,bij,bj->b", coef, np.linalg.inv(covariance), coef)
    shrunk = np.linalg.slogdet(covariance)[1] - 2 * np.log(found.prior[first::2])
    return 0.5 * (fit + shrunk)
