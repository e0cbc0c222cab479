"""Weights of rows by Tukey's biweight: rows far off count less, or not at all."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.stats import yeojohnson_llf, yeojohnson_normmax

from sklearn_raacmm.network import _read
from sklearn_raacmm.network._blocks import ArrayChunks
from sklearn_raacmm.network._posterior import pack, predict_mean
from sklearn_raacmm.network._search import EXACT_ROWS, MARGIN, MARGIN_OF_TARGET
from sklearn_raacmm.utils import (
    TUKEY_CUT,
    Finding,
    many_without_weight,
    robust_scale,
    tukey_weights,
)

# Fits at most: slips are clear after the second, and what comes and goes near the limit is not.
MAX_FITS = 4
# Nats for each target by which the robust loss has to lead: tails lead by less, slips of 1 mm by
# more. And the share of far rows above which they are no slips.
LEAD, MOST_FAR = 1.0, 0.125
# Nats for each target that leaving out the far rows has to gain before another fit is made: what
# gained less on 13 tables was not taken after that fit either.
WORTH = 0.05
# Mean change of the weights at which they have settled.
SETTLED = 5e-3
# Weighted mean square over the variance, of normal residuals: E[w z^2] / E[w] with
# w = (1 - z^2 / TUKEY_CUT^2)^2, by the moments 1, 3 and 15 (what is beyond is 4e-8).
NORMAL_SQUARE = (1 - 6 / TUKEY_CUT**2 + 15 / TUKEY_CUT**4) / (
    1 - 2 / TUKEY_CUT**2 + 3 / TUKEY_CUT**4
)


def biweights(residuals, weights, codes=None):
    """Factors (n,) of the rows' weights, by the output in which a row is farthest off.

    Where groups have offsets residuals (n, q) count from their group's median.
    """
    counted = weights > 0
    for code in () if codes is None else np.unique(codes[counted]):
        own = codes == code
        residuals[own] -= np.median(residuals[own & counted], axis=0)
    size = np.abs(residuals)
    # An output that is met exactly by half of the rows has no scale.
    known = np.median(size[counted], axis=0) > 1e-12 * size.max(axis=0, initial=0.0)
    of_outputs = [tukey_weights(left[:, None], weights) for left in residuals.T[known]]
    return np.min([np.ones(len(size)), *of_outputs], axis=0)


def reweigh(estimator, blocks, codes):
    """Fit again with weights by the residuals, until these settle; "auto" if evidence is for it."""
    auto, first = estimator.loss == "auto", dict(vars(estimator))
    large = len(blocks) > _read.IN_MEMORY_ROWS
    if auto and (large or "log_marginal_likelihood_value_" not in first):
        return
    X, Y, given = blocks.X, blocks.Y, blocks.weights
    factor, counted, residuals = np.ones(len(given)), given > 0, np.zeros_like(Y)
    for i in range(MAX_FITS):
        residuals = Y - predict_mean(pack(estimator.networks_), X)
        last, factor = factor, biweights(residuals, given, codes)
        change = np.mean(np.abs(factor - last))
        if change == 0 or (i and change < SETTLED):
            break
        if auto and not i and _gain(residuals[counted], factor[counted] > 0) < WORTH * Y.shape[1]:
            return
        weighted = ArrayChunks(X, Y, given * factor)
        estimator._fit_weighted(weighted, codes, estimator.networks_, i + 1)
        if auto and i == 0:
            n, far = counted.sum(), residuals[(factor == 0) & counted]
            lead = evidence(estimator.log_marginal_likelihood_value_, n, far)
            lead -= evidence(first["log_marginal_likelihood_value_"], n, far[:0])
            if lead < LEAD * n * Y.shape[1]:
                return _keep(estimator, first, Y[counted], residuals[counted], factor[counted])
    if auto and np.sum(factor[counted] == 0) > MOST_FAR * counted.sum():
        return _keep(estimator, first, Y[counted], residuals[counted], factor[counted])
    if np.any(factor < 1):
        far = residuals * (factor == 0)[:, None]
        added = np.average(np.square(far), axis=0, weights=given)
        share = np.average(factor == 0, weights=given)
        estimator.networks_ = tuple(_with_outliers(n, added, share) for n in estimator.networks_)
    estimator.row_weight_ = factor
    for finding in many_without_weight(factor[counted]):
        finding.report()


def _keep(estimator, first, *far_rows):
    """Keep the fit of least squares, and say what the rows far off are instead of slips."""
    estimator.__dict__ = first
    for finding in _heavy_tails(*far_rows):
        finding.report()


def _with_outliers(network, added, share):
    """A network of rows near to it, with what far rows, a share of all, add to the variance."""
    network = network.with_noise(1 / NORMAL_SQUARE)
    of_outliers = np.maximum(added[network.outputs] - share * network.noise_variance, 0.0)
    return replace(network, outlier_variance=of_outliers)


def _heavy_tails(Y, residuals, factor) -> Iterator[Finding]:
    """Finding of targets (n, q) that are far more probable as a power of a normal variable."""
    n, far = len(Y), np.flatnonzero(factor == 0)
    for y, left in zip(Y.T, residuals.T, strict=True):
        gain = yeojohnson_llf(yeojohnson_normmax(y), y) - yeojohnson_llf(1.0, y)
        if gain > MARGIN + MARGIN_OF_TARGET * n:
            size = np.abs(left[far]).max() / robust_scale(np.abs(left), 1)
            yield Finding(
                "heavy-tails",
                f"The targets have heavy tails: {len(far)} of {n} rows lie more than {TUKEY_CUT:g} "
                f"standard deviations of the others off, up to {size:.3g}.",
                "Learn a power of the targets: TransformedTargetRegressor(RBFNetRegressor(), "
                "transformer=PowerTransformer()).",
                "note",
                rows=tuple(far.tolist()),
            )
            return


def _gain(residuals, near):
    """Nats for each row by which rows are more probable without those that are not near."""
    all_rows, near_rows = (np.square(r).mean(axis=0) for r in (residuals, residuals[near]))
    return 0.5 * np.log(all_rows / np.maximum(near_rows, 1e-300)).sum()


def evidence(value, n, far):
    """Logarithm of the evidence of n rows of which `far` (m, q) have a variance of their own.

    `value` is that of the others, or of so many of them as structures are compared on.
    """
    m = len(far)
    total = value * max((n - m) / EXACT_ROWS, 1.0)
    if m:
        variance = np.maximum(np.mean(np.square(far), axis=0), 1e-300)
        total -= 0.5 * m * np.sum(1 + np.log(2 * np.pi * variance))
        total += m * np.log(m / n) + (n - m) * np.log1p(-m / n)
    return total
