"""Structure, kernel, widths and ridge from the data, by the penalised marginal likelihood.

The network with a ridge in the kernel's norm is the posterior mean of a Gaussian process whose
noise variance is `alpha` times its signal variance. Candidates are noise alone, a linear part, and
radial functions of four kernels, of the features or of their ranks. The likelihood of these is
maximised from several starts on a few hundred rows (`_first_stage`), then on up to 1000 for kernels
that may be the best (`_second_stage`). Compared are the objective of `_likelihood` and
leave-one-out predictions on these rows (`judge`).
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from sklearn.exceptions import ConvergenceWarning

from sklearn_raacmm.network._kernels import Kernel
from sklearn_raacmm.network._likelihood import (
    ALPHA_BOUNDS,
    LOOSE_KAPPA,
    WIDTH_BOUNDS,
    End,
    Task,
    covariance,
    judge,
    likelihoods,
    log_likelihood,
    minimise,
    of_noise,
    used_share,
)
from sklearn_raacmm.network._linear import (
    linear_evidence,
    polynomial_at,
    polynomial_of,
    without_constants,
)
from sklearn_raacmm.network._ranks import are_alike, to_ranks
from sklearn_raacmm.network._rows import Rows
from sklearn_raacmm.utils import stage, warn_user

# Rows and iterations of the first stage, and of the second: with 2000 rows for rough functions of 8
# and 6 features 2 and 3 % less error took 2.5 and 3 times as long. Of up to `WHOLE_ROWS` the first
# takes all (``benchmarks/bench_rows.py --cliffs``).
COARSE_ROWS, WHOLE_ROWS, EXACT_ROWS = 300, 400, 1000
COARSE_STEPS, EXACT_STEPS = 60, 40
# Nats that two steps gain at the least where a search goes on from the end: five times as many take
# noise for a signal (``tests/network/test_search.py``). And, as a share of the margin below, where
# the end is only compared with another one.
GOES_ON, COMPARED = 0.02, 0.02
# Iterations after which ranks as inputs have to lead on the first stage's rows to be searched.
TRIAL_STEPS = 15
# Starts: all widths, in units of sqrt(d) spreads, and the ridge.
START_WIDTHS, START_RIDGES = (0.05, 0.2, 0.5, 1.0, 2.5), (1e-3, 1e-1)
# Width from which on a start is that of a smooth function; and the difference of logarithms of
# widths and ridge below which two starts have led to the same place.
WIDE, ALIKE = 0.7, 0.1
# Nats for each observation by which the start of a search may trail.
HOPELESS = 0.3
# Cap of the widths at the start of the second stage, in sqrt(d) spreads: it gives features that a
# few rows could not tell from noise another chance.
REVIVED = 3.0
# Nats by which any other choice than the first has to lead, and for each target: a rougher kernel,
# ranks as inputs, constants of groups, features left out whose width ended at its upper bound. Lest
# noise be followed, and centres be taken by the hundred for 1 % of the error
# (``benchmarks/bench_accuracy.py --margins``). What trails by as much is not searched further.
MARGIN, MARGIN_OF_TARGET = 10.0, 0.02
# Observations a feature below which leave-one-out densities count in part: the widths have been
# chosen on the same rows.
TRUSTED = 10
# Nats by which a linear model has to be better than what else was found, for being one candidate
# more: on smooth functions of 8 to 12 rows 1 lost 7 % of the error, 2 lost 1 %.
LINEAR_MARGIN = 2.0
# Variances of groups' constants over that of the noise that are tried beside a linear part.
RATIOS = np.append(0.0, 4.0 ** np.arange(-6, 5))
# Range of a feature, in spreads, from which squared distances are off by 2e-3.
_MAX_SPREADS = 3e6
# For a feature's spread: quantiles, and the multiple of their distance that is far outside of them.
TENTHS, OUTLYING = (0.1, 0.9), 3.0


class Structure(NamedTuple):
    """What the likelihood chose."""

    kernel: Kernel
    length_scale: np.ndarray  # (d,)
    alpha: np.ndarray  # (q,)
    ratio: float = 0.0  # variance of groups' constants over that of an observation's noise
    linear: bool = False  # a linear part in place of radial functions, which are as good as noise
    log_likelihood: float = 0.0  # of the rows on which structures were compared
    n_observations: float = 0.0
    n_found: float = 0.0  # parameters of each output that were found
    ranks: np.ndarray | None = None  # if these are the inputs, as `mid_ranks` makes them
    # Where groups have been left out: what `used_share` returns.
    used: tuple[np.ndarray, np.ndarray] | None = None


@stage("widths of the network")
def search(
    data: Rows,
    kernels: Sequence[Kernel],
    inputs: Sequence[np.ndarray | None],
    *,
    length_scale: np.ndarray | None = None,
    isotropic: bool = False,
    alpha: np.ndarray | None = None,
    may_be_linear: bool = False,
    random_state: np.random.RandomState | None = None,
    start: Any = None,
    refit: int = 0,
) -> Structure:
    """Maximise the penalised likelihood over what is not given.

    The data are distinct rows with targets in units of their spread. Inputs are features as they
    are (None), or their ranks as `mid_ranks` makes them; of two, the more probable. Given may be
    widths (d,) or ridges (q,). A `start`, a structure or a network, is what was found for other
    weights of the rows. Slips bend a function, and rough kernels follow them: the first refit has
    the first kernel, and looks far off; the others stay near the one before, and the second decides
    anew on kernel, inputs and groups' constants.
    """
    (n, d), q = data.X.shape, data.Y.shape[1]
    drawn = [
        data.draw(size, random_state)
        for size in (COARSE_ROWS if n > WHOLE_ROWS else WHOLE_ROWS, EXACT_ROWS)
    ]
    constants = data.codes is not None and bool(data.codes.any())
    # On kernel, inputs and groups' constants.
    decides = refit != 1 and (start is None or refit == 2)
    if not decides:
        raw = start is None or start.ranks is None
        inputs = [knots for knots in inputs if (knots is None) == raw] or inputs
        kernels = kernels[:1] if start is None or refit == 1 else (start.kernel,)
        constants = constants and (start is None or start.ratio > 0)

    def seen(ranks):
        """The task for features as they are, or their ranks, and rows of both stages as seen."""
        X = to_ranks(ranks, data.X)
        spread = robust_spread(X, data.weights)
        used = np.full(len(spread), length_scale is not None)
        if length_scale is None:
            _refuse_far(X, spread)
            used = spread > 0
        spread = np.where(used, spread, 1.0)
        rows = data._replace(X=X - np.average(X, axis=0, weights=data.weights))
        task = Task(spread, used, q, isotropic, length_scale, alpha, constants, ranks)
        few, many = map(rows.some, drawn)
        return task, few, many

    def look(task, few, many):
        near = start is not None and (start.ranks is None) == (task.ranks is None)
        task, ends = _first_stage(task, kernels, few, start if near else None, decides, refit > 1)
        more = len(many.X) > len(few.X)
        ends = _second_stage(task, ends, many) if more else ends
        # The first kernel, unless another one leads clearly.
        end = min(ends, key=_handicapped(kernels[0], many))
        return task, end if more or not decides else _end(task, end.kernel, end.theta, few, 0.0)

    task, few, many = seen(inputs[0])
    # Widths of radial functions that are as good as noise.
    silent = np.where(task.used, task.spread * np.sqrt(max(task.used.sum(), 1)), np.inf)
    if not q or not task.used.any():  # nothing varies, nothing can be learnt
        return Structure(kernels[0], silent, np.ones(q), ranks=inputs[0])
    task, end = look(task, few, many)
    if len(inputs) > 1 and task.n_widths:
        other = seen(inputs[1])
        if _may_win(task, end, few, *other[:2]):
            ranked, found = look(*other)
            if found.score < end.score - margin(many):
                task, many, end = ranked, other[2], found
    if task.n_alphas and task.n_widths:
        plain = many._replace(X=data.X[drawn[1]])
        simple = _simpler(task, end, plain, silent, may_be_linear)
        if simple is not None:
            return simple
    # Parameters that the data have decided on. That some features were picked out of all counts as
    # log(1 + d) more: with 20 features and 10 rows 91 % of new observations are inside the 95 %
    # intervals with it, 80 % without.
    n_found = task.n_widths + np.log1p(d * (length_scale is None)) + task.constants + task.n_alphas
    task, end = _leave_out_flat(task, end, many)
    log_width, log_alpha, ratio = task.unpack(end.theta)
    width, ridge = np.exp(log_width), np.exp(log_alpha)
    _warn_of_narrow(task, width)
    return Structure(
        end.kernel,
        width,
        ridge,
        ratio,
        log_likelihood=log_likelihood(many, end.likelihood),
        n_observations=many.n_total,
        n_found=n_found / q,
        ranks=task.ranks,
        used=used_share(many, covariance(many, end.kernel, log_width), ridge, ratio),
    )


def _may_win(task, end, few, other, ranked_few):
    """Whether ranks may be the better inputs: by a short search on few rows, if they say more."""
    if are_alike(few.X, ranked_few.X):
        return False
    ranked, least = replace(task, spread=other.spread), margin(few)
    nats = COMPARED * least
    theta = minimise(ranked, end.theta, ranked_few, end.kernel, TRIAL_STEPS, nats=nats)
    lead = judge(task, end.kernel, end.theta, few).score
    return lead - judge(ranked, end.kernel, theta, ranked_few).score > least


def _first_stage(task, kernels, few, start, decides, near):
    """The task, with groups' constants or without, and an end on few rows for each kernel.

    From smooth to rough, until one trails far behind: no rougher one would lead then.
    """
    first, *others = kernels

    def find(task):
        if start is None or not near:
            return _coarse(task, first, few, start)
        return _end(task, first, task.pack(start), few)

    end = find(task)
    if task.constants and decides:
        # Constants explain what a function does between groups, too, and need not be there.
        plain = replace(task, constants=False)
        other = find(plain)
        if end.score > other.score - margin(few):
            task, end = plain, other
    ends = [end]
    for kernel in others:
        ends.append(_end(task, kernel, ends[0].theta, few, COMPARED * margin(few)))
        if ends[-1].score > ends[-2].score + margin(few):
            break
    return task, ends


def _end(task, kernel, theta, data, nats=GOES_ON):
    """Where a search for a kernel ends, from a start."""
    theta = minimise(task, theta, data, kernel, COARSE_STEPS, nats=nats)
    return judge(task, kernel, theta, data)


def _second_stage(task, ends, many):
    """Ends on many rows, of the kernels that may be the best there."""
    ends = [judge(task, end.kernel, end.theta, many) for end in ends]
    handicapped = _handicapped(ends[0].kernel, many)
    limit = min(map(handicapped, ends)) + margin(many)
    hopeful = [end for end in ends if handicapped(end) <= limit]
    for i, end in enumerate(hopeful):
        theta = minimise(task, _revived(task, end.theta), many, end.kernel, EXACT_STEPS)
        hopeful[i] = judge(task, end.kernel, theta, many)
    return hopeful


def _handicapped(first, data):
    """A function of an end: its score, and the margin if its kernel is not the first."""
    return lambda end: end.score + margin(data) * (end.kernel != first)


def margin(data):
    """Nats by which a choice other than the first has to lead."""
    return MARGIN + MARGIN_OF_TARGET * data.n_total * data.Y.shape[1]


def _revived(task, theta):
    """Theta with widths that are no wider than a feature needs to be found again."""
    caps = np.full(len(theta), np.inf)
    caps[: task.n_widths] = np.log(REVIVED * np.sqrt(task.used.sum()))
    return np.minimum(theta, caps)


def _warn_of_narrow(task, width):
    narrow = np.flatnonzero(width < 1.01 * WIDTH_BOUNDS[0] * task.spread)
    if task.n_widths and len(narrow):
        warn_user(
            f"The width of feature {', '.join(map(str, narrow))} ended at its lower bound, "
            f"{WIDTH_BOUNDS[0]:g} of the feature's spread: the function may vary faster than the "
            "rows can show, or a few values lie far from all others.",
            ConvergenceWarning,
        )


def _coarse(task, kernel, data, start=None):
    """Where the search for one kernel ends on few rows, from several starts and a given one."""
    starts = [task.start(*at) for at in product(START_WIDTHS, START_RIDGES)]
    if start is not None:
        starts.append(_revived(task, task.pack(start)))
    found = [judge(task, kernel, theta, data, leave_out=False) for theta in starts]
    # The likelihood may have two peaks, of functions as rough as the rows can show and of smooth
    # ones with more noise: what is left out decides, too.
    middle = task.start(WIDE, 1.0)[0] if task.n_widths else None
    found.sort(key=lambda end: end.value)
    limit = found[0].value + HOPELESS * data.n_total * task.n_outputs
    best: dict[bool, np.ndarray] = {}
    for end in found:
        if end.value <= limit:
            best.setdefault(middle is not None and bool(end.theta[0] < middle), end.theta)
    ends: list[End] = []
    for theta in best.values():
        if start is None:
            # At the price of many features a weak signal in a few of them is not found from far off
            # (tests/network/test_search.py): it has to stand out first.
            theta = minimise(task, theta, data, kernel, COARSE_STEPS, LOOSE_KAPPA, GOES_ON)
        if not any(np.allclose(theta, end.theta, rtol=0, atol=ALIKE) for end in ends):
            ends.append(_end(task, kernel, theta, data))
    return min(ends, key=lambda end: end.score)


def _leave_out_flat(task, end, data):
    """Leave out the features whose width ended at its upper bound, where evidence asks for it."""
    flat = end.theta[: task.n_widths] == np.log(WIDTH_BOUNDS[1])
    if task.isotropic or not flat.any() or flat.all():
        return task, end
    used = task.used.copy()
    used[used] = ~flat
    fewer = replace(task, used=used)
    without = judge(fewer, end.kernel, np.delete(end.theta, np.flatnonzero(flat)), data)
    return (fewer, without) if without.value < end.value - margin(data) else (task, end)


def _simpler(task, end, data, silent, may_be_linear):
    """Noise alone or a linear model, where that is better than radial functions; or None."""
    d, q = data.X.shape[1], task.n_outputs
    own, value, (noise, density_of_noise) = end.value, end.score, of_noise(data)
    # Neighbours within a group deviate alike by what no feature shows, too, and count as if they
    # did not: a function that led by 7 nats made an arm 10 % worse at other positions
    # (``benchmarks/bench_chain.py --few``).
    lead = 0.0 if data.codes is None else margin(data)
    # Leave-one-out predictions are fooled where the kernel links a few pairs of rows only.
    is_noise = noise + density_of_noise < value or noise < own + lead
    # Where radial functions seem to have no noise at all they predict neighbours of rows far from
    # most others too well: there the density of what is left out does not count.
    trusted = is_noise or task.unpack(end.theta)[1].min() > np.log(ALPHA_BOUNDS[0]) + 1
    other, density = (noise, density_of_noise) if is_noise else (own, end.density)
    lead = max(lead * is_noise, LINEAR_MARGIN)
    linear = _linear(data, other, density if trusted else None, lead) if may_be_linear else None
    if linear is None and not is_noise:
        return None
    # The ridge of the linear part is shared by all outputs. Ten rows of 20 features held 74 % in
    # the 95 % intervals where it alone counts, as if nothing had been chosen.
    n_found = np.log1p(d) if linear is None else 1 + np.log1p(d) + task.constants
    ratio, evidence, used = linear or (0.0, noise, None)
    return Structure(
        end.kernel,
        silent,
        np.full(q, ALPHA_BOUNDS[1]),
        ratio,
        linear=linear is not None,
        log_likelihood=log_likelihood(data, evidence),
        n_observations=data.n_total,
        n_found=n_found / q,
        used=used,
    )


def _linear(data, value, density, margin):
    """Ratio, evidence and share of a linear model that is better by a margin; or None."""
    linear = polynomial_of(data.X, data.weights, 1, ridged=True)[1:]
    columns = polynomial_at(linear, data.X)
    root, weights = np.sqrt(data.weights)[:, None], data.weights

    def at(ratio):
        arrays = (columns, data.Y)
        flat, targets = (root * without_constants(a, data.codes, weights, ratio) for a in arrays)
        found = linear_evidence(flat, targets, data.lost, data.n_total - 1, data.n_total)
        extra = 0.0
        if ratio:
            extra = np.log1p(ratio * np.bincount(data.codes, weights)).sum() * data.Y.shape[1] / 2
        return found[1] + extra, float(ratio), found[0], found[2] + extra

    goal, ratio, ridge, evidence = min(map(at, RATIOS if data.codes is not None else RATIOS[:1]))
    if not ridge:
        return None
    lead = together = value - goal
    K, alphas = (root * columns) @ (root * columns).T / ridge, np.ones(data.Y.shape[1])
    if density is not None:
        own_density = likelihoods(data, K, alphas, ratio)[1]
        together += min(1.0, data.n_total / (TRUSTED * data.X.shape[1])) * (density - own_density)
    if min(lead, together) <= margin:
        return None
    return ratio, evidence, used_share(data, K, alphas, ratio)


def robust_spread(X, weights):
    """Standard deviation of features (d,), values far out taken as the limit of what is not."""
    low, high = np.quantile(X, TENTHS, axis=0, weights=weights, method="inverted_cdf")
    far = OUTLYING * (high - low)
    inside = np.where(far > 0, np.clip(X, low - far, high + far), X)
    mean = np.average(inside, axis=0, weights=weights)
    spread = np.sqrt(np.average((inside - mean) ** 2, axis=0, weights=weights))
    spread[spread <= 1e-13 * np.abs(inside).max(axis=0, initial=0.0)] = 0.0
    return spread


def _refuse_far(X, spread):
    """Refuse numbers so far from the others that the distances of these are lost in rounding."""
    low, high = X.min(axis=0), X.max(axis=0)
    found = np.flatnonzero((spread > 0) & (high - low > _MAX_SPREADS * spread))
    if len(found):
        i = found[0]
        raise ValueError(
            f"Feature {i} has numbers from {low[i]:g} to {high[i]:g}, but most lie within a "
            f"spread of {spread[i]:g}: beyond {_MAX_SPREADS:g} spreads distances between the "
            "other rows are lost in rounding. If these are codes of missing values, leave their "
            "rows out; else clip the feature or give its logarithm."
        )
