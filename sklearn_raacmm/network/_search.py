r"""Structure, kernel, widths and ridge from the data, by the penalised marginal likelihood.

The network with a ridge in the kernel's norm is the posterior mean of a Gaussian process whose
noise variance is `alpha` times its signal variance. What it is made of comes from a short list: a
constant and noise alone; a linear part besides; or radial functions of one of three kernels, with a
width for each feature or one for all. Where groups of rows have constants, so do all of these.

The likelihood of radial functions is maximised in stages: from several starts on a few hundred rows
(`_coarse`), then on up to 1000 rows for every kernel that may be the best one there (`_refine`).
Structures are compared on these rows (`_choose`), by the objective of `_objective`, and by
leave-one-out predictions.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sklearn_raacmm.network._kernels import KERNELS
from sklearn_raacmm.network._likelihood import (
    Data,
    exact_likelihood,
    leave_one_out,
    left_out,
    log_likelihood,
    noise_density,
    noise_likelihood,
)
from sklearn_raacmm.network._linear import linear_evidence, polynomial_of
from sklearn_raacmm.network._objective import (
    ALPHA_BOUNDS,
    LOOSE_KAPPA,
    WIDTH_BOUNDS,
    Task,
    minimise,
    objective,
    used_share,
)
from sklearn_raacmm.utils import stage

# Kernels that `kernel="auto"` chooses from.
AUTO_KERNELS = ("gaussian", "matern52", "matern32")
# Rows and iterations of the first stage, and of the second. Of up to `WHOLE_ROWS` the first takes
# all: there the second would take as long as that costs (benchmarks/bench_rows.py --cliffs).
COARSE_ROWS, WHOLE_ROWS, EXACT_ROWS = 300, 400, 1000
COARSE_STEPS, EXACT_STEPS = 60, 40
# Starts: all widths in units of sqrt(d) spreads, as even the nearest of many neighbours is about
# sqrt(d) spreads away; and the ridge.
START_WIDTHS, START_RIDGES = (0.05, 0.2, 0.5, 1.0, 2.5), (1e-3, 1e-1)
# Cap of the widths at the start of the second stage, in sqrt(d) spreads: it gives features that a
# few rows could not tell from noise another chance.
REVIVED = 3.0
# Nats, evidence and leave-one-out density together, by which a kernel may trail on the rows of the
# second stage before its search there: one trailed by 1.4 on 300 rows and led by 150 on 1000.
TRAILING = 20.0
# Nats by which a kernel other than the first has to lead in the end, lest noise be followed: with
# none a function was found in pure noise in 6 of 25 tables; errors with 3, 6 and 10 differ by less
# than 2 % (benchmarks/bench_noise.py --margins).
KERNEL_MARGIN = 10.0
# Observations a feature below which one width for all features may be the better process, and
# below which leave-one-out densities count in part: the widths have been chosen on the same rows.
FEW, TRUSTED = 20, 10
# Nats by which a linear model has to be better than what else was found, for being one candidate
# more. On 45 simulated functions with 5 to 250 rows, 1 gained more on linear ones and lost up to
# 7 % of the error on average over smooth ones with 8 to 12 rows, where 2 lost 1 %.
LINEAR_MARGIN = 2.0
# Variances of groups' constants over that of the noise that are tried beside a linear part.
RATIOS = np.append(0.0, 4.0 ** np.arange(-6, 5))
# Share of its price that a feature pays below which it is left out, if that costs at most so many
# nats; ends of a loose search that are the same, and to how many nats they are found.
UNUSED, NEGLIGIBLE, SAME, LOOSE = 0.01, 0.5, 0.5, 0.05
# For a feature's spread: quantiles, and the multiple of their distance that is far outside of them.
TENTHS, OUTLYING = (0.1, 0.9), 3.0


class Structure(NamedTuple):
    """What the likelihood chose."""

    kernel: str
    length_scale: np.ndarray  # (d,)
    alpha: np.ndarray  # (q,)
    ratio: float = 0.0  # variance of groups' constants over that of an observation's noise
    linear: bool = False  # a linear part in place of radial functions, which are as good as noise
    log_likelihood: float = 0.0  # of the rows on which structures were compared
    n_observations: float = 0.0
    n_found: float = 0.0  # parameters of each output that were found, see `parameters_found`
    at_bound: np.ndarray = np.empty(0, dtype=int)  # features whose width ended at the lower bound


@stage("widths of the network")
def search(
    data: Data,
    kernels: Sequence[Any],
    *,
    length_scale: np.ndarray | None = None,
    isotropic: bool = False,
    alpha: np.ndarray | None = None,
    constant_std: np.ndarray | None = None,
    may_be_linear: bool = False,
    random_state: Any = None,
) -> Structure:
    """Maximise the penalised likelihood over what is not given.

    The data are distinct rows with targets in units of their spread; the rows of a stage are drawn
    from them. Given may be widths (d,), ridges (q,) and standard deviations of groups' constants
    (q,). `isotropic` is one width, in units of each feature's spread.
    """
    X, (d, q) = data.X, (data.X.shape[1], data.Y.shape[1])
    spread = robust_spread(X, data.weights)
    used = spread > 0 if length_scale is None else np.ones(d, dtype=bool)
    spread = np.where(spread > 0, spread, 1.0)
    if not q or not used.any():  # nothing varies, nothing can be learnt
        width = silent_widths(spread, used) if length_scale is None else length_scale
        return Structure(kernels[0], width, np.ones(q) if alpha is None else alpha)
    data = data._replace(X=X - np.average(X, axis=0, weights=data.weights))
    constants = data.codes is not None and bool(data.codes.any() or constant_std is not None)
    task = Task(spread, used, q, isotropic, length_scale, alpha, constants, constant_std)
    sizes = COARSE_ROWS if len(X) > WHOLE_ROWS else WHOLE_ROWS, EXACT_ROWS
    few, many = (data.rows(data.draw(size, random_state)) for size in sizes)
    ends = _coarse(task, kernels, few)
    if len(many.X) > len(few.X):
        ends = _refine(ends, many)
    end = min(ends, key=lambda end: score(end, many) + KERNEL_MARGIN * (end.kernel != kernels[0]))
    found = _choose(end, many, may_be_linear)
    if isinstance(found, Structure):
        return found
    end = _leave_out(found, many)
    log_width, log_alpha, ratio = end.task.unpack(end.theta)
    width = np.exp(log_width)
    narrow = end.task.n_widths and width < 1.01 * WIDTH_BOUNDS[0] * spread
    value = exact_likelihood(many, end.kernel, log_width, log_alpha, ratio).value
    return Structure(
        end.kernel,
        width,
        np.exp(log_alpha),
        ratio,
        log_likelihood=log_likelihood(many, value),
        n_observations=many.n_total,
        n_found=parameters_found(end.task, d),
        at_bound=np.flatnonzero(narrow),
    )


def parameters_found(task, n_features):
    """How many parameters of each output the data have decided on.

    A width is shared by all outputs. That some features were picked out of all is as good as
    log(1 + d) parameters more, which is also the form of a feature's price. With 20 features and 10
    rows 53 % of new observations were inside the 95 % intervals without any of this, 80 % where the
    choice does not count, and 91 % or more with it (two simulated functions).
    """
    searched = n_features if task.length_scale is None else 0
    q = task.n_outputs
    return (task.n_widths + np.log1p(searched) + task.constants + task.n_alphas) / q


def silent_widths(spread, used):
    """Widths of radial functions that are as good as noise."""
    return np.where(used, spread * np.sqrt(max(used.sum(), 1)), np.inf)


def score(end, data):
    """Nats by which ends are compared: evidence, and leave-one-out density.

    Evidence alone believes a wrong process too long, leave-one-out predictions alone are noisy.
    """
    value = objective(end.task, end.theta, data, end.kernel)[0]
    return value + _left_out(end, data).negative_log_density if np.isfinite(value) else np.inf


def _left_out(end, data):
    return leave_one_out(data, end.kernel, *end.task.unpack(end.theta))


def _coarse(task, kernels, data):
    """One end for each kernel, from several starts on few rows."""
    first = kernels[0]
    starts = [task.start(c, a) for c in START_WIDTHS for a in START_RIDGES]
    starts.sort(key=lambda theta: objective(task, theta, data, first)[0])
    # The likelihood may have several peaks: from the two best starts that differ in width.
    second = [t for t in starts if task.n_widths and t[0] != starts[0][0]][:1]
    found = [
        minimise(task, t, data, first, COARSE_STEPS, kappa=LOOSE_KAPPA, nats=LOOSE)
        for t in (starts[0], *second)
    ]
    if len(found) > 1 and abs(found[1].value - found[0].value) < SAME:
        found = found[:1]
    ends = [minimise(task, end.theta, data, first, COARSE_STEPS) for end in found]
    if task.n_outputs > 1 and len(ends) > 1:
        # The likelihood may give up one output for the others' sake; the error of prediction,
        # averaged over outputs, does not.
        ends.sort(key=lambda end: _left_out(end, data).squared_error)
    else:
        ends.sort(key=lambda end: end.value)
    others = [minimise(task, ends[0].theta, data, k, COARSE_STEPS) for k in kernels[1:]]
    return [ends[0], *others]


def _refine(ends, many):
    """The ends of the kernels that may be the best, on more rows."""
    scores = [score(end, many) for end in ends] if len(ends) > 1 else [0.0]
    refined = []
    for end, value in zip(ends, scores, strict=True):
        if value > min(scores) + TRAILING:
            continue
        theta, task = end.theta.copy(), end.task
        cap = np.log(REVIVED * np.sqrt(task.used.sum()))
        theta[: task.n_widths] = np.minimum(theta[: task.n_widths], cap)
        refined.append(minimise(task, theta, many, end.kernel, EXACT_STEPS))
    return refined


def _choose(end, data, may_be_linear):
    """The radial functions of an end, the better of them and one width; or a simpler structure."""
    task, d = end.task, data.X.shape[1]
    free = bool(task.n_alphas and task.n_widths)
    value = score(end, data)
    if free and task.n_widths > 1 and data.n_total < FEW * task.n_widths:
        alike = _coarse(task._replace(isotropic=True), [end.kernel], data)[0]
        if score(alike, data) < value:
            end, task, value = alike, alike.task, score(alike, data)
    if not free:
        return end
    noise = noise_likelihood(data)
    # Leave-one-out predictions are fooled where the kernel links a few pairs of rows only.
    is_noise = noise + noise_density(data) < value or noise < end.value
    # A kernel that links no row to another is noise by another name.
    is_noise = is_noise or _links_nothing(data.X, end)
    silent = Structure(
        end.kernel, silent_widths(task.spread, task.used), np.full(task.n_outputs, ALPHA_BOUNDS[1])
    )
    silent = silent._replace(n_observations=data.n_total)
    if may_be_linear:
        other = noise if is_noise else end.value
        density = noise_density(data) if is_noise else value - end.value
        linear = _linear(data, other, density, None if is_noise else end)
        if linear is not None:
            ratio, evidence = linear
            # The ridge of the linear part is shared by all outputs. Ten rows of 20 features held
            # 74 % in the 95 % intervals where it alone counts, as if nothing had been chosen.
            n_found = (1 + np.log1p(d) + task.constants) / task.n_outputs
            value = log_likelihood(data, evidence)
            return silent._replace(ratio=ratio, linear=True, log_likelihood=value, n_found=n_found)
    if is_noise:
        n_found = np.log1p(d) / task.n_outputs
        return silent._replace(log_likelihood=log_likelihood(data, noise), n_found=n_found)
    return end


def _linear(data, value, density, end):
    """Ratio and evidence of a linear model, where it is better than what else there is; or None.

    It has to lead in evidence, and in evidence and leave-one-out density together. Where radial
    functions are said to have no noise at all, evidence is not to be trusted: then it has to lead
    in the error of what is left out.
    """
    columns = polynomial_of(data.X, data.weights, 1, ridged=True).columns(data.X)[:, 1:]
    columns = np.sqrt(data.weights)[:, None] * columns

    def at(ratio):
        rows = data.whiten(columns, ratio), data.whiten(data.targets, ratio)
        found = linear_evidence(*rows, data.within, data.n_total - 1, data.n_total)
        extra = 0.5 * data.Y.shape[1] * data.log_det(ratio)
        return found._replace(objective=found.objective + extra, value=found.value + extra)

    ratio = min(RATIOS if data.codes is not None else RATIOS[:1], key=lambda r: at(r).objective)
    found = at(ratio)
    if not found.ridge:
        return None
    K = data.whiten(columns, ratio)
    left = left_out(data, K @ K.T / found.ridge, np.ones(data.Y.shape[1]), ratio)
    lead = value - found.objective
    share = min(1.0, data.n_total / (TRUSTED * data.X.shape[1]))
    together = lead + share * (density - left.negative_log_density)
    if min(lead, together) > LINEAR_MARGIN:
        return float(ratio), found.value
    if end is not None:
        _, log_alpha, _ = end.task.unpack(end.theta)
        floor = log_alpha.min() < np.log(ALPHA_BOUNDS[0]) + 1
        if floor and left.squared_error < _left_out(end, data).squared_error:
            return float(ratio), found.value
    return None


def _leave_out(end, data):
    """Features whose slope cannot be told from 0 are left out: their width becomes infinite."""
    task = end.task
    if not task.n_widths or task.isotropic:
        return end
    # A feature in which the function is linear may be as wide, but has a slope.
    out = used_share(end, data) < UNUSED
    if not np.any(out) or np.all(out):
        return end
    used = task.used.copy()
    used[np.flatnonzero(used)[out]] = False
    kept = np.append(~out, np.ones(len(end.theta) - len(out), dtype=bool))
    other = end._replace(task=task._replace(used=used), theta=end.theta[kept])
    value = objective(other.task, other.theta, data, end.kernel)[0]
    before = objective(task, end.theta, data, end.kernel)[0]
    return end if value > before + NEGLIGIBLE else other._replace(value=value)


def robust_spread(X, weights):
    """Standard deviation of every feature (d,), values far out taken as the limit of what is not.

    One sentinel value (9999 for a missing number) would otherwise set the scale of all. 0 for a
    feature that does not vary.
    """
    low, high = np.quantile(X, TENTHS, axis=0, weights=weights, method="inverted_cdf")
    far = OUTLYING * (high - low)
    inside = np.where(far > 0, np.clip(X, low - far, high + far), X)
    mean = np.average(inside, axis=0, weights=weights)
    spread = np.sqrt(np.average((inside - mean) ** 2, axis=0, weights=weights))
    spread[spread <= 1e-13 * np.abs(inside).max(axis=0, initial=0.0)] = 0.0
    return spread


def _links_nothing(X, end):
    """Whether the kernel is all but 0 between most rows and their nearest neighbours."""
    if len(X) < 2:
        return False
    Z = X * np.exp(-end.task.unpack(end.theta)[0])
    some = Z[:: max(1, len(Z) // 1000)]
    nearest = cKDTree(Z).query(some, k=2)[0][:, 1]
    return bool(np.median(KERNELS[end.kernel].function(nearest**2)) < 1e-3)
