r"""Forward selection of blocks of columns by the evidence, with priors found by the data.

The model is linear, :math:`y = A w + e` with noise variance :math:`s^2`, and each coefficient has
a normal prior of mean 0 whose variance :math:`v_f` is that of its family. A block of columns (the
cosine and the sine of one harmonic) joins if that multiplies the marginal likelihood by more than
the number of candidates: the odds that one of so many would reach by chance are then even, so that
the number of orders offered hardly matters. Selection is that of orthogonal least squares, on the
penalised Gram matrix instead of the columns, a block at a time.

The variances are MacKay's fixed point [1]_: the sum of squares of a family's coefficients over the
number of them that the data determine.

References
----------
.. [1] D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4(3), 1992, 415-447.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

_MAX_ROUNDS = 25
# Relative change of the variances at which they have settled: a few per cent of a prior's variance
# move no coefficient by more than a per cent of its standard deviation.
_SETTLED = 0.02
# Noise is known beforehand as three observations would show it, at a hundredth of the square of y:
# with fewer rows than columns the evidence else grows without limit as all noise is explained away.
_ASSUMED_ROWS, _ASSUMED_SHARE = 3.0, 0.01
# Relative increase of the Gram matrix's diagonal, some hundred times its rounding.
_JITTER = 1e-11


class Posterior(NamedTuple):
    """Coefficients of the chosen columns and what they are worth."""

    blocks: list  # chosen blocks: first those that are always in, then in order of selection
    gains: np.ndarray  # log Bayes factor of each chosen candidate when it joined
    columns: np.ndarray  # (k,) their columns
    coef: np.ndarray  # (k,)
    root: np.ndarray  # (k, k) R with covariance = inv(R.T @ R)
    prior_variance: np.ndarray  # (n_families,)
    noise_variance: float
    n_determined: float


def select_blocks(gram, moment, square, n, blocks, family, always, prior_variance, lengths=None):
    """Choose blocks and fit their coefficients.

    Parameters
    ----------
    gram : ndarray of shape (p, p)
        ``A.T @ A``.
    moment : ndarray of shape (p,)
        ``A.T @ y``.
    square : float
        ``y @ y``.
    n : float
        Number of observations less those spent on offsets.
    blocks : list of ndarray
        Columns of each block: all of them, or one or two for a candidate.
    family : ndarray of shape (n_blocks,)
        Family of each block.
    always : ndarray of shape (n_blocks,)
        Which blocks are in from the start.
    prior_variance : ndarray of shape (n_families,)
        Variances that are known; NaN for those to be found.
    lengths : Lengths, optional
        Observations whose variance is known but for their share of the noise.

    Returns
    -------
    Posterior
    """
    of_column = np.empty(len(gram), dtype=int)
    for block, f in zip(blocks, family, strict=True):
        of_column[block] = f
    known = np.isfinite(prior_variance)
    noise = square / max(n, 1.0) if square > 0 else 1.0
    variance = _first_guess(gram, of_column, noise, n, prior_variance)
    floor = 1e-8 * variance
    smallest_noise = 1e-12 * noise
    assumed = _ASSUMED_ROWS * _ASSUMED_SHARE * noise
    threshold = np.log(max(np.sum(~always), 1))
    for last in range(_MAX_ROUNDS - 1, -1, -1):
        prior = variance[of_column]
        S, r = gram / noise, moment / noise
        if lengths is not None:
            variance_of_lengths = lengths.variance + noise * lengths.share
            weighted = lengths.rows.T / variance_of_lengths
            S += weighted @ lengths.rows
            r += weighted @ lengths.errors
        # With fewer rows than columns and hardly any noise S is singular to rounding.
        S[np.diag_indices(len(S))] = (1 + _JITTER) * S.diagonal() + 1 / prior
        chosen, gains = _forward(S, r, blocks, always, prior, threshold)
        columns = np.concatenate([blocks[b] for b in chosen]) if chosen else np.empty(0, int)
        root = cholesky(S[np.ix_(columns, columns)], check_finite=False)
        coef = cho_solve((root, False), r[columns], check_finite=False)
        inverse = solve_triangular(root, np.eye(len(columns)), check_finite=False)
        determined = 1 - np.square(inverse).sum(axis=1) / prior[columns]
        members = of_column[columns]
        found = variance.copy()
        for f in np.unique(members):
            if not known[f]:
                of_f = members == f
                total = np.square(coef[of_f]).sum() / max(determined[of_f].sum(), 1e-12)
                found[f] = max(total, floor[f])
        rss = square - 2 * coef @ moment[columns] + coef @ gram[np.ix_(columns, columns)] @ coef
        free = max(n - determined.sum(), 0.0)
        new_noise = max((max(rss, 0.0) + assumed) / (free + _ASSUMED_ROWS), smallest_noise)
        change = np.abs(np.log(np.append(found / variance, new_noise / noise)))
        if change.max() < _SETTLED or last == 0:
            break
        variance, noise = found, new_noise
    return Posterior(
        chosen, np.array(gains), columns, coef, root, variance, noise, determined.sum()
    )


def _first_guess(gram, of_column, noise, n, prior_variance):
    """Variances at which the columns of a family together would explain as much as there is."""
    variance = np.where(np.isfinite(prior_variance), prior_variance, 1.0)
    diagonal = gram.diagonal()
    for f in np.unique(of_column):
        if not np.isfinite(prior_variance[f]):
            size = diagonal[of_column == f].sum() / max(n, 1.0)
            variance[f] = noise / size if size > 0 else 1.0
    return variance


def _forward(S, moment, blocks, always, prior, threshold):
    """Blocks in the order in which they raise the evidence, while each does by `threshold`.

    With S the penalised Gram matrix of what is left of the columns beside the chosen ones and r
    their products with what is left of y, a block b raises the log evidence by
    r_b' inv(S_b) r_b / 2 - log det(S_b V_b) / 2, V_b its prior variances.

    S is never downdated as a whole: as in a pivoted Cholesky factorisation, the factor's rows and
    the entries of the blocks themselves suffice.
    """
    chosen = [int(b) for b in np.flatnonzero(always)]
    candidates = np.flatnonzero(~always)
    first = np.array([blocks[b][0] for b in candidates], dtype=int)
    last = np.array([blocks[b][-1] for b in candidates], dtype=int)
    pair = first != last
    a, d, o = S[first, first], S[last, last], S[first, last]
    r = moment.copy()
    factor = np.empty((64, len(S)))
    size = 0

    def take(columns):
        nonlocal factor, size, r, a, d, o
        if size + len(columns) > len(factor):
            more = np.empty((max(len(factor), len(columns)), len(S)))
            factor = np.concatenate([factor, more])
        known = factor[:size]
        rows = S[columns] - known[:, columns].T @ known
        root = cholesky(rows[:, columns], check_finite=False)
        new = solve_triangular(root, rows, trans="T", check_finite=False)
        factor[size : size + len(columns)] = new
        size += len(columns)
        r = r - new.T @ solve_triangular(root, r[columns], trans="T", check_finite=False)
        one, two = new[:, first], new[:, last]
        a, d, o = (
            value - np.einsum("kc,kc->c", left, right)
            for value, left, right in ((a, one, one), (d, two, two), (o, one, two))
        )

    if chosen:
        take(np.concatenate([blocks[b] for b in chosen]))
    alive = np.ones(len(candidates), dtype=bool)
    gains = []
    while alive.any():
        x, z = r[first], np.where(pair, r[last], 0.0)
        determinant = np.where(pair, a * d - o * o, a)
        volume = determinant * prior[first] * np.where(pair, prior[last], 1.0)
        # A posterior wider than the prior is rounding.
        alive &= volume >= 1 - 1e-6
        safe = np.where(alive, determinant, 1.0)
        gain = np.where(pair, x * x * d - 2 * x * z * o + z * z * a, x * x)
        gain = 0.5 * gain / safe - 0.5 * np.log(np.where(alive, np.maximum(volume, 1.0), 1.0))
        best = int(np.argmax(np.where(alive, gain, -np.inf)))
        if not gain[best] > threshold:
            break
        take(blocks[candidates[best]])
        alive[best] = False
        chosen.append(int(candidates[best]))
        gains.append(float(gain[best]))
    return chosen, gains
