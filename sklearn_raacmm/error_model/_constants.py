"""Constants of positions whose size the evidence finds: references that are off by something each.

A reference against a tracker or a certificate may be off by a constant in each position. Columns of
the arm can tell such constants from the arm's own differences between positions, since these are
the same function of the angles everywhere. With the variance v of the constants and s of the noise
a constant is drawn to 0 as by rows of the weight s / v.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.error_model._fit import fit_linear_model
from sklearn_raacmm.utils import Finding, group_means, group_sums, say_findings

# Rounds of the two variances, and the change of their ratio at which they have settled.
_ROUNDS, _SETTLED = 4, 0.1
# Constants count from this many times the noise of a coordinate on: a model that is not complete
# errs alike at the rows of one position, too.
_LEAST_RATIO = 1.0
# Share of the rows without weight that slips do not come to.
_MANY = 0.1


def fit_with_constants(rows, positions, terms, with_field):
    """Fit the model and, where the evidence asks for them, constants of the positions.

    `positions` (n,) count from 0; None: there are no constants. Returns a `Fitted`, whose rows are
    those given less their constants.
    """
    fitted, known, rounds = fit_linear_model(rows, terms, with_field), np.inf, 0
    if positions is None or rows.codes is not None:
        return fitted
    while True:
        # Of a position that is off as a whole no row may have any weight left.
        counts = np.mean(fitted.pose_weight == 0) < _MANY
        weights = rows.weights * (fitted.pose_weight if counts else 1.0)
        left = rows.y - fitted.model.predict(rows.X)[0]
        last, known = known, _known(left, positions, weights)
        if not known < 1 / _LEAST_RATIO**2:
            return fitted if np.isinf(last) else fit_linear_model(rows, terms, with_field)
        if abs(known - last) < _SETTLED * known:
            break
        fitted = fit_linear_model(rows._replace(codes=positions, known=known), terms, with_field)
        rounds += 1
        if rounds == _ROUNDS:
            break
    total = np.bincount(positions, weights)
    constants = group_sums(left, positions, weights) / (total + known)[:, None]
    size = float(np.sqrt(np.square(constants).sum(axis=1).mean()))
    say_findings(
        [
            Finding(
                "constants-of-positions",
                f"The references of the positions are off by {size:.2g} mm each (root mean square),"
                " beside what the arm's own errors explain.",
                "How well are the references known? The constants are not taken for the arm's.",
                size_mm=size,
            )
        ]
    )
    return fitted._replace(rows=rows._replace(y=rows.y - constants[positions]))


def _known(left, positions, weights):
    """Noise variance over that of the constants, by the analysis of variance of what is left."""
    total = np.bincount(positions, weights)
    used = total > 0
    n, n_groups = weights.sum(), used.sum()
    if np.count_nonzero(weights) < 2 * n_groups:
        return np.inf
    means = group_means(left, positions, weights)
    within = weights @ np.square(left - means[positions]).sum(axis=1) / max(n - n_groups, 1e-9)
    between = (total[:, None] * np.square(means))[used].sum() / max(n_groups, 1)
    # Expected: within + (n / n_groups) times the variance of a constant, about a mean of 0.
    variance = (between - within) / (np.square(total).sum() / n)
    return within / variance if variance > 0 and within > 0 else np.inf
