"""Kernel, widths and ridge where groups have unknown offsets, and whether to believe in these.

Three processes are found by their likelihoods: of the targets as they are, of their deviations from
groups' means, and of these where each group has a smooth function of its own besides
(`_group_noise`). Their likelihoods cannot be compared, since they are of different data or believe
too much in themselves. What users measure can be compared: the scatter that a process leaves within
a group which it has not seen. The inverse of the covariance gives it for every group at once.
"""

import numpy as np
from scipy.special import ndtr
from scipy.stats import t as student

from sklearn_raacmm.network._group_noise import group_errors, group_likelihood
from sklearn_raacmm.network._likelihood import Data, evidence_constant
from sklearn_raacmm.network._width_objective import ALPHA_BOUNDS, Task
from sklearn_raacmm.network._width_search import EXACT_ROWS, EXACT_STEPS, robust_spread, search

# Rows on which the groups' own functions are found: an evaluation takes 0.15 s with three outputs.
OWN_ROWS = 600
# Most numbers in the matrices of all groups, 256 MB.
LARGEST_GROUPS = 2**25
# Ratio of their variance to that of the other noise from which the search starts.
START_RATIO = np.e
# Standard errors by which less scatter has to be left than without groups, where groups have
# offsets alone; the share of their own functions is taken off. Of 30 tests of simulated arms,
# offsets that won by one to two of them left 0.90 to 1.05 times the scatter at new positions; where
# own functions left the least, it was 0.83 to 1.00 times.
MARGIN = 2.0


def search_groups(data, kernels, *, length_scale, isotropic, alpha, random_state, linear=False):
    """Maximise the likelihoods, and choose by the scatter left in groups that are left out.

    Parameters
    ----------
    data : Data
        Of deviations from groups' means, with their `codes`.
    kernels, length_scale, isotropic, alpha, random_state
        As for `search`.
    linear : bool
        Whether the targets are less a linear part that was found within groups. They have offsets
        then: without them that part would be another one.

    Returns
    -------
    found : Found
    data : Data
        What it was found of: without groups the rows are sorted as they are where none are given,
        and targets have the unit that they have there.
    """
    options = {"length_scale": length_scale, "isotropic": isotropic, "alpha": alpha}
    options |= {"random_state": random_state}
    several, plain = data.codes.any(), data if linear else _without_groups(data)
    base = search(plain, kernels, **options) if several and not linear else None
    known = search(data, kernels, **options)._replace(offsets=True)
    if not several or not data.Y.shape[1]:
        return known, data
    base = known if base is None else base
    own = _with_own_functions(data, known, **options)
    rows = data.draw(EXACT_ROWS, random_state)
    codes = np.unique(data.codes[rows], return_inverse=True)[1]
    if not codes.any():
        return known, data
    left = _errors(data, rows, codes, base)
    best, least = base, left.sum()
    for found in (known, own):
        if found is None or found is base:
            continue
        errors = _errors(data, rows, codes, found)
        gain = left - errors
        # As sure as a normal variable is, where the deviation is known from few groups only.
        margin = student.ppf(ndtr(MARGIN - found.share), len(gain) - 1)
        sure = gain.sum() > margin * gain.std(ddof=1) * np.sqrt(len(gain))
        if sure and errors.sum() < least:
            best, least = found, errors.sum()
    return best, data if best.offsets else plain


def _without_groups(data):
    """The same data where nothing is said of groups."""
    order, n = np.lexsort(data.X.T[::-1]), data.weights.sum()
    unit = np.sqrt(n / data.n_total)  # targets have unit variance, and offsets no part in it
    return Data(data.X, data.Y * unit, data.weights, data.within * unit**2).rows(order)


def _errors(data, rows, codes, found):
    """Squared deviations that are left in each group by a process that has not seen it."""
    data = data if found.offsets else data._replace(codes=None)
    where = found.kernel, np.log(found.length_scale), np.log(found.alpha), found.share
    return group_errors(data.rows(rows), codes, *where)


def _with_own_functions(data, known, *, length_scale, isotropic, alpha, random_state):
    """The process where groups have functions of their own, from that where they have none.

    Returns
    -------
    Found or None
        None where there is no function that groups could share, a group is too large, or the noise
        is given.
    """
    too_large = np.square(np.bincount(data.codes), dtype=float).sum() > LARGEST_GROUPS
    if alpha is not None or too_large:
        return None
    used = np.isfinite(known.length_scale)
    spread = robust_spread(data.X, data.weights)
    if np.all(known.alpha >= ALPHA_BOUNDS[1]) or not np.any(used & (spread > 0)):
        return None
    spread = np.where(spread > 0, spread, 1.0)
    X = data.X - np.average(data.X, axis=0, weights=data.weights)
    task = Task(data._replace(X=X), spread, length_scale, isotropic, alpha, used, own=True)
    theta = np.log(known.length_scale[used] / spread[used])[: task.n_widths]
    theta = np.concatenate([theta, np.log(known.alpha)[: task.n_alphas], [np.log(START_RATIO)]])
    rows = data.draw(OWN_ROWS, random_state)
    end = task.minimise(theta, rows, known.kernel, EXACT_STEPS)
    if not np.isfinite(end.value):
        return None
    log_width, log_alpha = task.unpack(end.theta)
    judged = task.rows(rows)
    value = group_likelihood(judged, known.kernel, log_width, log_alpha, end.theta[-1]).value
    return known._replace(
        length_scale=np.exp(log_width),
        alpha=np.exp(log_alpha),
        share=1 / (1 + np.exp(-end.theta[-1])),
        log_likelihood=-value - data.Y.shape[1] * evidence_constant(judged),
        n_observations=judged.n_total,
        n_found=known.n_found + 1 / data.Y.shape[1],
    )
