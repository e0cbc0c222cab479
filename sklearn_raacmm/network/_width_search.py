r"""Kernel, widths and ridge from the data, by the penalised marginal likelihood.

The network with a ridge in the kernel's norm is the posterior mean of a Gaussian process whose
noise variance is `alpha` times its signal variance. Its marginal likelihood is maximised in stages:
from several starts on a few hundred rows (`_coarse`), on up to 1000 rows by the exact process
(`_refine`), and where there are more, on up to 3000 rows by the projected one, or for a rough
function on 2000 by the exact one (`_extend`), each from where the last one has ended. A stage that
the exact likelihood of other rows finds worse than its start is not accepted. At last the process
has to be better than noise alone, and better than a process with one width for all features
(`_accept`).

The objective, with its penalty on the features that are used, is `_width_objective`'s.
"""

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from sklearn_raacmm.network._all_rows import n_parameters
from sklearn_raacmm.network._kernels import KERNELS, pivoted_cholesky
from sklearn_raacmm.network._likelihood import (
    LEAST_RIDGE,
    leave_one_out,
    log_likelihood,
    noise_likelihood,
)
from sklearn_raacmm.network._width_objective import (
    ALPHA_BOUNDS,
    LOOSE_KAPPA,
    WIDTH_BOUNDS,
    End,
    Task,
)
from sklearn_raacmm.utils import stage

# Kernels that `kernel="auto"` chooses from; the first is the one to beat.
AUTO_KERNELS = ("gaussian", "matern52", "matern32")
# Rows of the first stage; of the exact process; of the projected one.
COARSE_ROWS, EXACT_ROWS, SAMPLE_ROWS = 300, 1000, 3000
# Iterations of the three.
COARSE_STEPS, EXACT_STEPS, PROJECTED_STEPS = 60, 40, 30
# Inducing rows of the projected process, and the logarithm by which widths may fall before the
# inducing rows have to be chosen anew.
INDUCING, MARGIN = 600, 0.35
# Effective parameters of the process with 1000 rows above which so many inducing rows do not carry
# it: on six random functions with 430 to 900 of them and 3000 rows the projected process was never
# accepted. The exact one is taken instead, on so many rows and for so many iterations: the errors
# were 0.965 to 1.002 of those of 1000 rows, in less time than the projected process took.
# With 320 to 350 parameters (three functions) they were 0.988 to 1.047.
ROUGH, ROUGH_ROWS, ROUGH_STEPS = 400, 2000, 8
# Starts: all widths in units of sqrt(d) spreads, as even the nearest of many neighbours is about
# sqrt(d) spreads away; and the ridge.
START_WIDTHS, START_RIDGES = (0.05, 0.2, 0.5, 1.0, 2.5), (1e-3, 1e-1)
# Cap of the widths at the start of the second stage, in sqrt(d) spreads: it gives features that a
# few rows could not tell from noise another chance.
REVIVED = 3.0
# Nats, evidence and leave-one-out density together: by how much a kernel has to be better than the
# first, and any better than noise. Without a margin a prototype accepted a function in pure noise
# in 6 of 25 tables with three kernels, and in none with the Gaussian alone. The lead after which
# the first kernel is no longer looked at.
KERNEL_MARGIN, NOISE_MARGIN, CLEAR = 10.0, 0.0, 30.0
# Observations a feature below which one width for all features may be the better process.
FEW = 20
# Inducing rows, as a share of the rows, below which the projected process is the quicker one.
CHEAP = 0.3
# Share of its price that a feature pays below which it is left out, if that costs at most so many
# nats; ends of a search that are the same, in nats.
UNUSED, NEGLIGIBLE, SAME = 0.01, 0.5, 0.01
# For a feature's spread: quantiles, and the multiple of their distance that is far outside of them.
TENTHS, OUTLYING = (0.1, 0.9), 3.0


class Found(NamedTuple):
    """What the likelihood chose."""

    kernel: str
    length_scale: np.ndarray  # (d,)
    alpha: np.ndarray  # (q,)
    objective: float  # negative log likelihood and penalty per target value, on the rows used
    start: float  # the same where the last stage started
    log_likelihood: float = 0.0  # logarithm of the likelihood itself, of so many observations
    n_observations: float = 0.0
    n_found: float = 0.0  # parameters of each output that were found, see `parameters_found`
    at_bound: np.ndarray = np.empty(0, dtype=int)  # features whose width ended at the lower bound
    offsets: bool = False  # whether groups have unknown constants
    share: float = 0.0  # of the noise variance that groups' own functions are
    judged: np.ndarray = np.empty(0, dtype=int)  # rows on which kernels were compared
    judgement: float = -np.inf  # objective there, nats
    process: "Process | None" = None  # the best one, also where all was taken for noise


class Process(NamedTuple):
    """A process of radial functions, before it is compared with noise alone."""

    kernel: str
    length_scale: np.ndarray  # (d,)
    alpha: np.ndarray  # (q,)
    objective: float  # nats, on the rows on which kernels were compared
    n_found: float  # see `parameters_found`


@stage("widths of the network")
def search(data, kernels, *, length_scale=None, isotropic=False, alpha=None, random_state=None):
    """Maximise the penalised likelihood over what is not given.

    Parameters
    ----------
    data : Data
        Of distinct rows; targets in units of their spread.
    kernels : sequence of str
        To choose from, the one to beat first.
    length_scale : ndarray of shape (d,), optional
        Fixed widths; found where None.
    isotropic : bool
        One width, in units of each feature's spread.
    alpha : ndarray of shape (q,), optional
        Fixed ridge of every output; found where None.
    random_state : numpy.random.RandomState
        Draws the rows of a stage where there are more than it uses.

    Returns
    -------
    Found
    """
    X, Y, weights = data.X, data.Y, data.weights
    d, q = X.shape[1], Y.shape[1]
    spread = robust_spread(X, weights)
    varying = spread > 0
    if length_scale is None and not np.all(varying):
        # Of a feature that does not vary nothing can be learnt: it is ignored.
        found = search(
            data._replace(X=X[:, varying]),
            kernels,
            isotropic=isotropic,
            alpha=alpha,
            random_state=random_state,
        )
        width = np.full(d, np.inf)
        width[varying] = found.length_scale
        process = found.process
        if process is not None:
            own = np.full(d, np.inf)
            own[varying] = process.length_scale
            process = process._replace(length_scale=own)
        at_bound = np.flatnonzero(varying)[found.at_bound]
        return found._replace(length_scale=width, at_bound=at_bound, process=process)
    spread = np.where(varying, spread, 1.0)
    if not q or not d:
        # Nothing varies, nothing can be learnt.
        width = spread * np.sqrt(max(d, 1)) if length_scale is None else length_scale
        ridge = np.ones(q) if alpha is None else alpha
        return Found(kernels[0], width, ridge, 0.0, 0.0)
    center = np.average(X, axis=0, weights=weights)
    task = Task(data._replace(X=X - center), spread, length_scale, isotropic, alpha)

    def draw(size):
        return data.draw(size, random_state)

    few, many = draw(COARSE_ROWS), draw(EXACT_ROWS)
    ends = _coarse(task, kernels, few)
    if len(many) > len(few):
        ends = _refine(task, ends, few, many)
    task, end, is_noise = _accept(task, ends, many)
    whole, (task, end) = task, _leave_out(task, end, many)
    log_width, log_alpha = task.unpack(end.theta)
    searched = d if length_scale is None else 0
    n_found = parameters_found(task.n_widths, searched, task.n_alphas / q, q)
    process = Process(end.kernel, np.exp(log_width), np.exp(log_alpha), end.value, n_found)
    if is_noise:
        task, end = _noise(whole, end, many)
    judgement = end.value
    if len(X) > len(many) and end.theta.size:
        end = _extend(task, end, many, draw)
    unit = task.data.n_total * q
    log_width, log_alpha = task.unpack(end.theta)
    width, ridge = np.exp(log_width), np.exp(log_alpha)
    if task.n_widths and task.n_alphas and len(X) > 1 and links_nothing(X / width, end.kernel):
        # A kernel that links no row to another is noise by another name.
        width, ridge = spread * np.sqrt(d), np.full(q, ALPHA_BOUNDS[1])
    narrow = np.flatnonzero(width < 1.01 * WIDTH_BOUNDS[0] * spread) if task.n_widths else []
    judged = task.rows(many)
    return Found(
        end.kernel,
        width,
        ridge,
        end.value / unit,
        end.start / unit,
        log_likelihood(judged, end.kernel, np.log(width), np.log(ridge)),
        judged.n_total,
        parameters_found(task.n_widths, searched, task.n_alphas / q, q),
        np.array(narrow, dtype=int),
        judged=many,
        judgement=judgement,
        process=process,
    )


def parameters_found(n_widths, n_searched, n_alphas, n_outputs):
    """How many parameters of each output the data have decided on.

    A width is shared by all outputs. That some features were picked out of all is as good as
    log(1 + d) parameters more, which is also the form of a feature's price. With 20 features and 10
    rows 53 % of new observations were inside the 95 % intervals without any of this, 80 % where the
    choice does not count, and 91 % or more with it (two simulated functions).
    """
    return (n_widths + np.log1p(n_searched)) / n_outputs + n_alphas


def still_right(data, kernel, length_scale, alpha, *, fixed=(None, None), random_state=None):
    """Whether widths and ridges that were found on other rows are right for these, too.

    They are where the likelihood of up to 1000 rows could rise by no more than a nat for each of
    them: what parameters that are right gain by chance is half of that on average.

    Parameters
    ----------
    data : Data
        As for `search`.
    kernel : str
    length_scale : ndarray of shape (d,)
        Features of infinite width stay left out.
    alpha : ndarray of shape (q,)
    fixed : tuple of (ndarray or None, ndarray or None)
        Widths and ridges that are given, not found.
    random_state : numpy.random.RandomState
        Draws the rows.

    Returns
    -------
    right : bool
    log_likelihood : float
        Of the rows looked at.
    n_observations : float
        Of these.
    n_found : float
        See `parameters_found`.
    """
    X, Y, weights = data.X, data.Y, data.weights
    spread, used = robust_spread(X, weights), np.isfinite(length_scale)
    found = np.all(alpha < ALPHA_BOUNDS[1]) and np.all(spread[used] > 0) and np.any(used)
    if not Y.shape[1] or not found:
        return False, 0.0, 0.0, 0.0
    few, many = (data.draw(size, random_state) for size in (COARSE_ROWS, EXACT_ROWS))
    X = X - np.average(X, axis=0, weights=weights)
    spread = np.where(spread > 0, spread, 1.0)
    task = Task(data._replace(X=X), spread, fixed[0], False, fixed[1], used)
    theta = np.log(length_scale[used] / spread[used])[: task.n_widths]
    theta = np.append(theta, np.log(alpha)[: task.n_alphas])
    if np.any(theta < task.bounds[:, 0]) or np.any(theta > task.bounds[:, 1]):
        return False, 0.0, 0.0, 0.0
    judged = task.rows(many)
    if not task.gain(theta, few, many, kernel) <= len(theta):
        return False, 0.0, 0.0, 0.0
    value = log_likelihood(judged, kernel, np.log(length_scale), np.log(alpha))
    n_outputs, searched = Y.shape[1], len(spread) if fixed[0] is None else 0
    n_found = parameters_found(task.n_widths, searched, task.n_alphas / n_outputs, n_outputs)
    return True, value, judged.n_total, n_found


def _coarse(task, kernels, rows):
    """One end for each kernel, from several starts on few rows."""
    data, first = task.rows(rows), kernels[0]
    starts = [task.start(c, a) for c in START_WIDTHS for a in START_RIDGES]
    starts.sort(key=lambda theta: task.objective(theta, data, first)[0])
    # The likelihood may have several peaks: from the two best starts that differ in width.
    second = [t for t in starts if task.n_widths and t[0] != starts[0][0]][:1]
    found = [
        task.minimise(t, rows, first, COARSE_STEPS, kappa=LOOSE_KAPPA) for t in (starts[0], *second)
    ]
    if len(found) > 1 and abs(found[1].value - found[0].value) < SAME:
        found = found[:1]
    ends = [task.minimise(end.theta, rows, first, COARSE_STEPS) for end in found]
    if data.Y.shape[1] > 1 and len(ends) > 1:
        # The likelihood may give up one output for the others' sake; the error of prediction,
        # averaged over outputs, does not.
        ends.sort(key=lambda e: leave_one_out(data, first, *task.unpack(e.theta)).squared_error)
    else:
        ends.sort(key=lambda end: end.value)
    others = [task.minimise(ends[0].theta, rows, k, COARSE_STEPS) for k in kernels[1:]]
    return [ends[0], *others]


def _score(task, end, data):
    """Nats by which ends are compared: evidence, and leave-one-out density.

    Evidence alone believes a wrong process too long, leave-one-out predictions alone are noisy.
    """
    return end.value + leave_one_out(data, end.kernel, *task.unpack(end.theta)).negative_log_density


def _refine(task, ends, few, rows):
    """The ends of the kernels that may be the best, on more rows."""
    data = task.rows(few)
    scores = [_score(task, end, data) for end in ends]
    # A lead grows as the number of rows does; one this large needs no second opinion.
    needed = KERNEL_MARGIN * len(few) / len(rows)
    leading = [e for e, s in zip(ends[1:], scores[1:], strict=True) if scores[0] - s > needed]
    clear = scores[0] - min(scores) > CLEAR
    refined = []
    for end in leading if clear else [ends[0], *leading]:
        theta = end.theta.copy()
        cap = np.log(REVIVED * np.sqrt(len(task.spread)))
        theta[: task.n_widths] = np.minimum(theta[: task.n_widths], cap)
        # The projected process is as good and quicker where few rows tell all of a smooth one.
        Z = _inducing(task, theta, rows, end.kernel)
        inducing = Z if len(Z) < CHEAP * len(rows) else None
        units = task.step_units(theta, few, end.kernel)
        how = {"inducing": inducing, "units": units}
        refined.append(task.minimise(theta, rows, end.kernel, EXACT_STEPS, **how))
    return refined


def _accept(task, ends, rows):
    """The best kernel, if it is better than one width for all features; and whether it is noise."""
    data = task.rows(rows)
    scores = [_score(task, end, data) for end in ends]
    # The first to be named is the one to beat; where it is no longer there, it has been.
    scores = [
        s + KERNEL_MARGIN * (e.kernel != ends[0].kernel) for s, e in zip(scores, ends, strict=True)
    ]
    best = int(np.argmin(scores))
    end, score = ends[best], scores[best]
    noise = noise_likelihood(data) + noise_density(data)
    few = data.n_total < FEW * task.n_widths
    if task.n_alphas and task.n_widths > 1 and few:
        other = task.variant(isotropic=True)
        found = _coarse(other, [end.kernel], rows)[0]
        value = _score(other, found, data)
        if value < score:
            task, end, score = other, found, value
    # Leave-one-out predictions are fooled where the kernel links a few pairs of rows only.
    worse = noise < score or noise_likelihood(data) < end.value + NOISE_MARGIN
    return task, end, bool(task.n_alphas and task.n_widths and worse)


def _noise(task, end, rows):
    """All of the targets taken for noise."""
    log_width, log_alpha = task.unpack(task.start(1.0, ALPHA_BOUNDS[1]))
    fixed = {"length_scale": np.exp(log_width), "alpha": np.exp(log_alpha)}
    value = noise_likelihood(task.rows(rows))
    return task.variant(isotropic=False, **fixed), End(end.kernel, np.empty(0), value, end.start)


def noise_density(data):
    """Leave-one-out density where all is noise, as `leave_one_out` gives it."""
    square = data.weights[:, None] * np.square(data.Y)
    variance = np.maximum((square.sum(axis=0) + data.within) / data.n_total, 1e-300)
    n = len(data.X) if data.codes is None else len(data.X) - data.codes[-1] - 1
    return 0.5 * (np.sum(square / variance) + n * np.sum(np.log(variance)))


def _leave_out(task, end, rows):
    """Features whose slope cannot be told from 0 are left out: their width becomes infinite."""
    if not task.n_widths or task.isotropic:
        return task, end
    data = task.rows(rows)
    # A feature in which the function is linear may be as wide, but has a slope.
    out = task.used_share(end, data) < UNUSED
    if not np.any(out) or np.all(out):
        return task, end
    other = task.variant(used=~out)
    theta = end.theta[np.append(~out, np.ones(task.n_alphas, dtype=bool))]
    value = other.objective(theta, data, end.kernel)[0]
    if value > task.objective(end.theta, data, end.kernel)[0] + NEGLIGIBLE:
        return task, end
    return other, end._replace(theta=theta, value=value)


def _extend(task, end, many, draw):
    """The projected process on more rows than the exact one can take, where it can follow."""
    if _is_rough(task, end, many):
        return task.minimise(end.theta, draw(ROUGH_ROWS), end.kernel, ROUGH_STEPS)
    rows, others = draw(SAMPLE_ROWS), task.rows(draw(EXACT_ROWS))
    for _ in range(2):
        Z = _inducing(task, end.theta, rows, end.kernel)
        found = task.minimise(end.theta, rows, end.kernel, PROJECTED_STEPS, inducing=Z)
        before, after = (task.objective(e.theta, others, end.kernel)[0] for e in (end, found))
        if after > before:
            break
        fell = end.theta - found.theta
        end = found
        # The inducing rows did for what has been found, unless a width fell by more than they
        # allow for.
        if not np.any(fell > MARGIN):
            break
    return end


def _is_rough(task, end, rows):
    """Whether the process has more parameters than the inducing rows can stand for."""
    data, (log_width, log_alpha) = task.rows(rows), task.unpack(end.theta)
    alpha = np.exp(log_alpha.min(initial=np.inf))
    if not LEAST_RIDGE * data.weights.max() <= alpha < np.inf:
        return False
    root, Z = np.sqrt(data.weights), data.X / np.exp(log_width)
    return n_parameters(Z, end.kernel, root, alpha) > ROUGH


def robust_spread(X, weights):
    """Standard deviation of every feature, values far out taken as the limit of what is not.

    One sentinel value (9999 for a missing number) would otherwise set the scale of all.

    Returns
    -------
    ndarray of shape (d,)
        0 for a feature that does not vary.
    """
    low, high = np.quantile(X, TENTHS, axis=0, weights=weights, method="inverted_cdf")
    far = OUTLYING * (high - low)
    inside = np.where(far > 0, np.clip(X, low - far, high + far), X)
    mean = np.average(inside, axis=0, weights=weights)
    spread = np.sqrt(np.average((inside - mean) ** 2, axis=0, weights=weights))
    spread[spread <= 1e-13 * np.abs(inside).max(axis=0, initial=0.0)] = 0.0
    return spread


def links_nothing(Z, kernel):
    """Whether the kernel is all but 0 between most rows and their nearest neighbours."""
    some = Z[:: max(1, len(Z) // 1000)]
    nearest = cKDTree(Z).query(some, k=2)[0][:, 1]
    return np.median(KERNELS[kernel].function(nearest**2)) < 1e-3


def _inducing(task, theta, rows, kernel):
    """Rows that the kernel spreads best: the first pivots of its Cholesky factor.

    They would do for narrower widths too, lest the widths be held where they are, and are so many
    that what they leave unexplained is small beside the noise.
    """
    log_width, log_alpha = task.unpack(theta)
    X = task.data.X[rows]
    tol = min(0.03 * np.exp(log_alpha.min()), 1e-2)
    factor = pivoted_cholesky(X / np.exp(log_width - MARGIN), kernel, tol=tol, max_rank=INDUCING)
    return X[factor.pivots]
