"""Weights of rows by Tukey's biweight: rows far off count less, or not at all.

References
----------
.. [1] A. E. Beaton, J. W. Tukey, "The fitting of power series, meaning polynomials, illustrated on
   band-spectroscopic data", Technometrics 16 (1974).
"""

import numpy as np

from sklearn_raacmm.network._blocks import is_dask
from sklearn_raacmm.network._read import IN_MEMORY_ROWS
from sklearn_raacmm.network._search import EXACT_ROWS
from sklearn_raacmm.utils import check_weights, encode_groups, many_without_weight, report_findings

# Residual, in standard deviations, from which a row has no weight; while none is as far off, all
# rows have theirs in full. 4e-8 of normal residuals are: one table of 10 000 rows in 2600 has one.
CUT = 5.5
# Fits at most: slips are clear after the second, and what comes and goes near the limit is not.
MAX_FITS = 4
# Share of far rows above which the robust loss is not taken by itself: so many are no slips but the
# tail of a skewed target, whose mean they are a part of. A choice; with none the error was up to
# 1.17 times as large on tables of survival times.
MOST_FAR = 0.125
# Mean change of the weights at which they have settled.
SETTLED = 5e-3
# Weighted mean square over the variance, of normal residuals: E[w z^2] / E[w] with
# w = (1 - z^2 / CUT^2)^2, by the moments 1, 3 and 15 (what is beyond CUT is 4e-8).
NORMAL_SQUARE = (1 - 6 / CUT**2 + 15 / CUT**4) / (1 - 2 / CUT**2 + 3 / CUT**4)
# Standard deviation of a normal variable over its median absolute value.
_SD_OF_MEDIAN = 1.482602218505602


def biweights(residuals, weights, codes=None):
    """Factors (n,) of the rows' weights, 1 where no row is far off.

    Each is by the output of the residuals (n, q) in which a row is farthest off. Rows of weight 0
    do not count for the scale. Where groups have offsets residuals count from their group's median.
    """
    counted = weights > 0
    for code in () if codes is None else np.unique(codes[counted]):
        own = codes == code
        residuals[own] -= np.median(residuals[own & counted], axis=0)
    size = np.abs(residuals)
    scale = _SD_OF_MEDIAN * np.median(size[counted], axis=0)
    # An output that is met exactly by half of the rows has no scale.
    known = scale > 1e-12 * size.max(axis=0, initial=0.0)
    far = (size[:, known] / scale[known]).max(axis=1, initial=0.0)
    if not np.any(far[counted] > CUT):
        return np.ones(len(size))
    return np.square(np.maximum(1 - np.square(far / CUT), 0.0))


def reweigh(estimator, X, y, sample_weight, groups, group_std):
    """Fit a fitted network again with weights by the residuals, until these have settled.

    With ``loss="auto"`` the first fit stays unless the evidence is for the other one.
    """
    auto, first = estimator.loss == "auto", dict(vars(estimator))
    if auto and "log_marginal_likelihood_value_" not in first:
        return
    if is_dask(X):
        if auto:
            return
        X, y = X.compute(), np.asarray(y)
    given = check_weights(sample_weight, X)
    if auto and len(given) > IN_MEMORY_ROWS:
        return
    targets = np.asarray(y, dtype=np.float64).reshape(len(given), -1)
    codes = None if groups is None else encode_groups(groups)[1]
    factor, residuals = np.ones(len(given)), targets
    for _ in range(MAX_FITS):
        residuals = targets - estimator.predict(X).reshape(targets.shape)
        last, factor = factor, biweights(residuals, given, codes)
        if np.mean(np.abs(factor - last)) < SETTLED:
            break
        estimator._fit_weighted(X, y, given * factor, groups, group_std, True)
    if np.any(factor < 1):
        parts = (network.with_noise(1 / NORMAL_SQUARE) for network in estimator.networks_)
        estimator.networks_ = tuple(parts)
    if auto and np.any(factor < 1):
        far = residuals[(factor == 0) & (given > 0)]
        one, two = first["log_marginal_likelihood_value_"], estimator.log_marginal_likelihood_value_
        n = np.sum(given > 0)
        if len(far) > MOST_FAR * n or evidence(two, n, far) < evidence(one, n, far[:0]):
            vars(estimator).clear()
            vars(estimator).update(first)
            return
    estimator.row_weight_ = factor
    report_findings(many_without_weight(factor[given > 0]))


def evidence(value, n, far):
    """Logarithm of the evidence of n rows, of which some have been left out.

    `value` is that of the others, or of so many of them as structures are compared on; those left
    out have residuals `far` (m, q), with a variance of their own for each output. Each row is one
    of them with the probability that they are.
    """
    m = len(far)
    total = value * max((n - m) / EXACT_ROWS, 1.0)
    if m:
        variance = np.maximum(np.mean(np.square(far), axis=0), 1e-300)
        total -= 0.5 * m * np.sum(1 + np.log(2 * np.pi * variance))
        total += m * np.log(m / n) + (n - m) * np.log1p(-m / n)
    return total
