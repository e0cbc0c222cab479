"""Weights of rows by Tukey's biweight: rows far off count less, or not at all.

References
----------
.. [1] A. E. Beaton, J. W. Tukey, "The fitting of power series, meaning polynomials, illustrated on
   band-spectroscopic data", Technometrics 16 (1974).
"""

import numpy as np

from sklearn_raacmm.network._blocks import is_dask
from sklearn_raacmm.utils import check_weights, encode_groups, many_without_weight, report_findings

# Residual, in standard deviations, from which a row has no weight; while none is as far off, all
# rows have theirs in full. 4e-8 of normal residuals are: one table of 10 000 rows in 2600 has one.
CUT = 5.5
# Fits at most. Of 16 simulated tables of 200 rows with 1 to 20 % of outliers 9 had settled after
# five and 15 after six; in one a row near the limit came and went.
MAX_FITS = 4
# Rows at most by which the squared and the robust loss are compared.
MOST_JUDGES = 1000
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

    With ``loss="auto"`` the first fit stays where it predicts rows that are left out as well.
    """
    if is_dask(X):
        if estimator.loss == "auto":
            return
        X, y = X.compute(), np.asarray(y)
    given = check_weights(sample_weight, X)
    targets = np.asarray(y, dtype=np.float64).reshape(len(given), -1)
    factor = np.ones(len(given))
    codes = None if groups is None else encode_groups(groups)[1]
    first, expected = None, 0.0
    for _ in range(MAX_FITS):
        residuals = targets - estimator.predict(X).reshape(targets.shape)
        last, factor = factor, biweights(residuals, given, codes)
        if np.mean(np.abs(factor - last)) < SETTLED:
            break
        if first is None:
            some = _judges(given)
            first = dict(vars(estimator))
            expected = _left_out_density(estimator, X, targets, given, factor, codes, some, True)
        estimator._fit_weighted(X, y, given * factor, groups, group_std, True)
    if np.any(factor < 1):
        parts = (network.with_noise(1 / NORMAL_SQUARE) for network in estimator.networks_)
        estimator.networks_ = tuple(parts)
        if estimator.loss == "auto":
            found = _left_out_density(estimator, X, targets, given, factor, codes, some, False)
            if found < expected:
                vars(estimator).clear()
                vars(estimator).update(first)
                return
    estimator.row_weight_ = factor
    report_findings(many_without_weight(factor[given > 0]))


def _judges(weights):
    """Rows that a loss is chosen by: of many a part, the same whatever the seed."""
    rows = np.flatnonzero(weights > 0)
    return np.sort(np.random.RandomState(0).permutation(rows)[:MOST_JUDGES])


def _left_out_density(estimator, X, targets, weights, factor, codes, rows, squared):
    """Logarithm of the density of some targets, each as if it were left out, over outputs.

    For a fit that has left rows out they are a mixture: far ones have a variance of their own.
    """
    mean, std = estimator.predict(X[rows], return_std=True, with_noise=False)
    residuals = targets[rows] - mean.reshape(len(rows), -1)
    for code in () if codes is None else np.unique(codes[rows]):
        own = codes[rows] == code
        residuals[own] -= np.median(residuals[own], axis=0)
    unit = weights[rows] / np.mean(weights[rows])
    own = unit if squared else unit * factor[rows]
    noise = np.reshape(estimator.noise_variance_, (1, -1)) / unit[:, None]
    of_function = np.square(std.reshape(residuals.shape))
    # The share of a row in its own prediction.
    share = np.minimum(of_function / noise * (own / unit)[:, None], 0.999)
    variance = noise + of_function / (1 - share)
    square = np.square(residuals / (1 - share))
    density = -0.5 * (square / variance + np.log(variance))
    if squared:
        return density.sum()
    far = factor[rows] == 0
    amount = np.clip(np.mean(far), 1 / len(rows), 0.5)
    wide = np.maximum(np.mean(square[far], axis=0) if np.any(far) else square.max(axis=0), variance)
    other = -0.5 * (square / wide + np.log(wide))
    # A row is far off in all outputs or in none.
    one, two = density.sum(axis=1) + np.log(1 - amount), other.sum(axis=1) + np.log(amount)
    return np.logaddexp(one, two).sum()
