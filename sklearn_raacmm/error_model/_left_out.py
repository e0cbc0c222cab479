"""Models without one block of positions each: what intervals and the judgement are made of.

Standard deviations of a posterior are too small where its model is not complete. Errors at
positions that had no part in a fit show by how much, and whether the correction helps at all.
Without a block the harmonics are chosen again, with the variances that the whole has found.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace

import numpy as np
from sklearn.cluster import KMeans

from sklearn_raacmm.error_model._columns import points_of_rows
from sklearn_raacmm.error_model._fading import LEAST_POSITIONS
from sklearn_raacmm.error_model._fit import model_of
from sklearn_raacmm.error_model._structures import HIGHEST_OF_FEW, structures_of
from sklearn_raacmm.inference import Problem, combined, interval_scales, search_at
from sklearn_raacmm.utils import centred, group_means, stage

# Blocks left out in turn.
N_BLOCKS = 10
# Mean of the prior of log b (see `interval_scales`) in a single-point test; with a tracker 0.
# Deviations from the means of positions show little of b: with this prior 94 % of all true errors
# are inside, with 0 it is 92 % (``benchmarks/bench_beyond_the_paper.py intervals``, 128 tests).
_USUAL_LOG_B = 0.7
# Errors of one position that count as independent, of each coordinate.
_EFFECTIVE_ROWS = 3.0
# With fewer than four positions noise and standard deviation are multiplied by one and so much of
# the inverse of their number: 0.98 and 0.94 inside 95 %, without it 0.85 and 0.67
# (``benchmarks/bench_few_poses.py``).
_PER_FEW_POSITIONS = 2.0


@stage("models without one block each")
def leave_out(fitted, terms, positions, weights):
    """Errors at the rows of each block of neighbouring positions by a model of the others.

    The harmonics of `terms` were offered to the fit, and `positions` (n,) count from 0. Outliers
    keep their `weights` in the means of their positions.

    Returns what models without the block of a row say of it: the correction (n, 3); the doubt (n,)
    that it fades by; its standard deviations (n, 3), where positions have offsets those of its
    deviation from the position's mean. All in mm. Or None where all positions are at one place, or
    all weight is in one block.
    """
    model, state, rows = fitted.model, fitted.state, fitted.rows
    points = points_of_rows(rows.arm, terms, rows.X)
    blocks = _blocks(points, positions, weights)
    kept = fitted.pose_weight > 0
    if blocks is None or not model.noise_variance > 0 or len(np.unique(blocks[kept])) < 2:
        return None
    # High orders beside the chosen ones take most of the time: on 22 simulated sets the models
    # without a block were the same with all of them offered again.
    low = terms.harmonics[:, 1] <= HIGHEST_OF_FEW
    low[state.lines] = True
    if not low.any():  # only high ones are offered
        low[:] = True
    terms = terms._replace(harmonics=terms.harmonics[low])
    structures = structures_of(rows.arm, terms, state.with_field)
    start = state._replace(noise_variance=model.noise_variance)
    used = rows._replace(weights=rows.weights * fitted.pose_weight, lengths=())
    parts = {
        block: used.at((blocks == block) & kept).sums(terms)[0]
        for block in np.unique(blocks[kept]).tolist()
    }
    whole = combined(list(parts.values()), [1.0] * len(parts))
    n = len(points)
    found = np.empty((n, 3)), np.empty(n), np.empty((n, 3))
    for block in np.unique(blocks).tolist():
        # A block of outliers alone teaches nothing, but its errors are asked for.
        sums = combined((whole, parts[block]), (1, -1)) if block in parts else whole
        best = search_at(Problem(sums, structures), start)
        rest = model_of(used.at((blocks != block) & kept), terms, best)
        of = np.flatnonzero(blocks == block)
        for values, mine in zip(found, _at_rows(rest, rows.at(of), weights[of]), strict=True):
            values[of] = mine
    return found


def _at_rows(model, rows, weights):
    """What `leave_out` returns, at some rows by a model that has not seen them."""
    mean, std, doubt = model.predict_with_doubt(rows.X, return_std=rows.codes is None)
    if rows.codes is None:
        return mean, doubt, std
    dots = centred(model.columns(rows.X), rows.codes, weights) @ model.half
    return mean, doubt, np.sqrt(np.einsum("ncr,ncr->nc", dots, dots))


def _blocks(points, positions, weights):
    """Blocks of neighbouring positions, by k-means among their mean points; None for one place."""
    means, place = np.unique(
        group_means(points, positions, weights), axis=0, return_inverse=True
    )  # repeated rows, each a position of its own, are no more places than one
    n_blocks = min(N_BLOCKS, len(means))
    if n_blocks < 2:
        return None
    blocks = np.arange(len(means))
    if n_blocks < len(means):
        blocks = KMeans(n_blocks, n_init=4, random_state=0).fit_predict(means)
    return blocks[place.ravel()[positions]]


def with_honest_intervals(model, left_out, rows, positions, share=1.0):
    """Model whose intervals are as wide as errors at positions left out ask for.

    Errors of a share of the correction in units of ``sqrt(a n^2 + b s^2)``, n the noise and s the
    posterior standard deviation, say what a and b are (see `interval_scales`). Of fewer than four
    positions a single-point test has them by their number, and a tracker's model stays as it is.
    """
    n_positions, weights, codes = len(np.unique(positions)), rows.weights, rows.codes
    if left_out is None or n_positions < LEAST_POSITIONS:
        wider = 1.0 if codes is None else 1 + _PER_FEW_POSITIONS / n_positions
        return replace(model, noise_scale=wider, std_scale=wider)
    correction, _, spread = left_out
    errors = centred(rows.y - share * correction, codes, weights)
    noise = model.noise_sd * model.noise_ratio(rows.X)
    if codes is not None:  # the position's own mean has taken its share of the noise
        taken = 1 / np.maximum(np.bincount(codes, weights)[codes], 1.0)
        noise *= np.sqrt(1 - taken)[:, None]
    worth = min(1.0, _EFFECTIVE_ROWS * n_positions / weights.sum())
    usual = 0.0 if codes is None else _USUAL_LOG_B
    scales = interval_scales(errors, noise, spread, weights, worth, usual)
    return replace(model, noise_scale=scales[0], std_scale=scales[1])
