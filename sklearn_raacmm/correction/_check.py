"""The check: which stages of a correction help at positions that were left out of their fit."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.spatial import cKDTree

from sklearn_raacmm.utils import centred, group_means, stage

CHECK_DTYPE = np.dtype(
    [("model", "U17"), ("mean_mm", "f8"), ("gain_mm", "f8"), ("gain_se_mm", "f8")]
)
# Share of the variance that neighbours have to have in common for a network to be tried: what it
# could take off is about half of that, as a share of the deviation.
_LEAST_SHARED = 0.03
# Standard deviations above zero that the share has to be at least, of uncorrelated residuals.
_SURELY = 2.0


def shared_by_neighbours(features, left, weights):
    """Correlation of what a model leaves at each pose with what it leaves at the nearest other one.

    A smooth error is nearly the same at neighbours; noise is not.

    Parameters
    ----------
    features : ndarray of shape (n, n_features)
    left : ndarray of shape (n, 3)
        In mm.
    weights : ndarray of shape (n,)

    Returns
    -------
    shared : float
    enough : bool
        Whether it is more than chance and more than a network needs to be worth its centres.
    """
    used = weights > 0
    F, left = features[used], left[used]
    F, first = np.unique(F / np.maximum(F.std(axis=0), 1e-12), axis=0, return_index=True)
    left = left[first]
    size = np.square(left).sum()
    if len(F) < 3 or not size > 0:
        return 0.0, False
    nearest = cKDTree(F).query(F, k=2)[1][:, 1]
    shared = float((left * left[nearest]).sum() / size)
    return shared, shared > max(_LEAST_SHARED, _SURELY / np.sqrt(left.size))


@stage("check at positions left out")
def errors_left_out(fit, data, positions, blocks, n_models, guard):
    """Mean deviation of each position when its block is left out, by each model.

    Parameters
    ----------
    fit : callable
        From the number of a block and the training data of the others to their stages.
    data : TrainingData
        Its weights are those that the fit has left.
    positions : ndarray of shape (n,)
        Position of each row, from 0.
    blocks : list of ndarray
        Rows of each block.
    n_models : list of int
        How many of the stages each model uses: 0 for no correction.
    guard : callable
        From the parts of a correction and the number of rows to the correction.

    Returns
    -------
    ndarray of shape (n_models, n_positions)
        In mm; 0 for positions without weight.
    """
    left = np.tile(data.y, (len(n_models), 1, 1))
    for number, test in enumerate(blocks):
        rest = np.ones(len(data.y), dtype=bool)
        rest[test] = False
        stages, rows = fit(number, data.rows(rest)), data.rows(test)
        parts = stages.parts(rows.angles, inputs=rows.network)
        for i, n_stages in enumerate(n_models):
            left[i, test] -= guard(parts[:n_stages], len(test))
    deviations = [np.linalg.norm(centred(e, data.codes, data.weights), axis=1) for e in left]
    return np.stack([group_means(d, positions, data.weights) for d in deviations])


def verdict(errors, models, choose, everywhere=False):
    """Table of the check, and which of the models to use.

    Parameters
    ----------
    errors : ndarray of shape (n_models, n_positions)
    models : sequence of str
        The first is no correction.
    choose : bool
        Whether the check chooses; otherwise the last model is taken.
    everywhere : bool, default=False
        Whether a model has to be better at every position rather than in the mean.

    Returns
    -------
    table : structured ndarray of shape (n_models,)
    chosen : int
    """
    table = np.empty(len(models), dtype=CHECK_DTYPE)
    table["model"], table["mean_mm"] = models, errors.mean(axis=1)
    gains = errors[0] - errors
    table["gain_mm"] = gains.mean(axis=1)
    table["gain_se_mm"] = gains.std(axis=1, ddof=1) / np.sqrt(errors.shape[1])
    chosen = 0 if choose else len(models) - 1
    for i in range(1, len(models) if choose else 0):
        worst = np.min(errors[chosen] - errors[i]) if everywhere else np.inf
        if worst > 0 and _clearly_better(errors[i], errors[chosen]):
            chosen = i
    return table, chosen


def _clearly_better(errors, others):
    """Whether errors (n_positions,) are smaller by more than the standard error of the gain.

    And by a thousandth, for a network that does next to nothing is not worth its centres.
    """
    gain = others - errors
    return gain.mean() > max(gain.std(ddof=1) / np.sqrt(len(gain)), 1e-3 * others.mean())
