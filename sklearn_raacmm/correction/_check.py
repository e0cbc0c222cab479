"""The check: which stages of a correction help at positions that were left out of their fit."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from sklearn.cluster import KMeans

from sklearn_raacmm.utils import centred, group_means, stage

CHECK_DTYPE = np.dtype(
    [
        ("model", "U17"),
        ("fade", "f8"),
        ("mean_mm", "f8"),
        ("gain_mm", "f8"),
        ("gain_se_mm", "f8"),
    ]
)
# What fade="auto" chooses from.
FADES = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
# How much larger the mean deviation of a stronger fading may be. Where positions have offsets,
# fading also shrinks their part of the correction, by another factor at every pose: there it has to
# cost next to nothing.
_FADE_COST, _FADE_COST_OF_OFFSETS = 1.05, 1.01


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
    means = group_means(points, positions, weights)
    n_blocks = min(n_blocks, len(np.unique(means, axis=0)))
    if n_blocks < 2:
        return None
    return KMeans(n_blocks, n_init=4, random_state=0).fit_predict(means)[positions]


@stage("check at positions left out")
def errors_left_out(fit, data, positions, blocks, n_models, fades):
    """Mean deviation of each position when its block is left out, by each model and fading.

    Parameters
    ----------
    fit : callable
        From training data to stages and their guard.
    data : TrainingData
    positions, blocks : ndarray of shape (n,)
    n_models : list of int
        How many of the stages each model uses: 0 for no correction.
    fades : sequence of float

    Returns
    -------
    ndarray of shape (n_models, n_fades, n_positions)
        In mm.
    """
    left = np.tile(data.y, (len(n_models), len(fades), 1, 1))
    for block in np.unique(blocks):
        test = blocks == block
        stages, guard = fit(data.rows(~test))
        rows = data.rows(test)
        parts = stages.parts(rows.angles, inputs=rows.network)
        for i, n_stages in enumerate(n_models):
            for j, fade in enumerate(fades):
                left[i, j, test] -= guard(fade).apply(parts[:n_stages], test.sum())
    errors = np.empty((*left.shape[:2], positions.max() + 1))
    for i, j in np.ndindex(errors.shape[:2]):
        deviation = np.linalg.norm(centred(left[i, j], data.codes, data.weights), axis=1)
        errors[i, j] = group_means(deviation, positions, data.weights)
    return errors


def verdict(errors, models, fades, offsets, choose):
    """Table of the check, and which of the models to use.

    Parameters
    ----------
    errors : ndarray of shape (n_models, n_fades, n_positions)
    models : sequence of str
        The first is no correction.
    fades : sequence of float
    offsets : bool
        Whether positions have offsets.
    choose : bool
        Whether the check chooses; otherwise the last model is taken.

    Returns
    -------
    table : structured ndarray of shape (n_models,)
    chosen : int
    """
    # Of fadings nearly as good as the best the strongest: a premium on what the check, inside
    # the training region, cannot see.
    means = errors.mean(axis=2)
    allowed = _FADE_COST_OF_OFFSETS if offsets else _FADE_COST
    cheap = means <= allowed * means.min(axis=1, keepdims=True)
    fading = [int(np.flatnonzero(row).max()) for row in cheap]
    errors = errors[np.arange(len(models)), fading]
    table = np.empty(len(models), dtype=CHECK_DTYPE)
    table["model"], table["mean_mm"] = models, errors.mean(axis=1)
    table["fade"] = np.take(fades, fading)
    gains = errors[0] - errors
    table["gain_mm"] = gains.mean(axis=1)
    table["gain_se_mm"] = gains.std(axis=1, ddof=1) / np.sqrt(errors.shape[1])
    if not choose:
        return table, len(models) - 1
    chosen = 0
    for i in range(1, len(models)):
        if _clearly_better(errors[i], errors[chosen]):
            chosen = i
    return table, chosen


def _clearly_better(errors, others):
    """Whether errors (n_positions,) are smaller by more than the standard error of the gain.

    And by a thousandth, for a network that does next to nothing is not worth its centres.
    """
    gain = others - errors
    return gain.mean() > max(gain.std(ddof=1) / np.sqrt(len(gain)), 1e-3 * others.mean())
