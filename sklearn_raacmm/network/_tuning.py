"""Kernel, widths and ridge of a network, found by the likelihood where they are not given.

Where the degree of the tail is left open, a linear model is one more candidate: the linear part
with its ridge, and no radial functions. With few rows the candidates are averaged (`_few_rows`).
"""

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.network._few_rows import average, silent_widths, trust
from sklearn_raacmm.network._group_search import search_groups
from sklearn_raacmm.network._likelihood import Data, leave_one_out
from sklearn_raacmm.network._network_posterior import RadialFunctions
from sklearn_raacmm.network._output_groups import output_groups, outputs_given_up
from sklearn_raacmm.network._parameters import (
    leading_bits,
    refuse_far,
    warn_of_bound,
    warn_of_unlike,
)
from sklearn_raacmm.network._polynomial_tail import linear_left_out, linear_process
from sklearn_raacmm.network._width_objective import ALPHA_BOUNDS
from sklearn_raacmm.network._width_search import (
    AUTO_KERNELS,
    parameters_found,
    robust_spread,
    search,
    still_right,
)

# Nats by which a linear model has to be better than what else was found, for being one candidate
# more. On 45 simulated functions with 5 to 250 rows, 1 gained more on linear ones and lost up to
# 7 % of the error on average over smooth ones with 8 to 12 rows, where 2 lost 1 %.
LINEAR_MARGIN = 2.0


class Tuned(NamedTuple):
    """What the centres are chosen with."""

    functions: RadialFunctions
    alpha: np.ndarray  # (q,) ridge of every output, in units of an observation
    log_likelihood: float | None = None  # of the rows on which kernels were compared
    n_found: float = 0.0  # parameters of each output that the data have decided on
    linear: bool = False  # whether there is a linear part
    tail_ridge: float = 0.0  # its ridge, in units of an observation; 0: to be found
    several: bool = False  # whether it is an average of several models
    offsets: bool = True  # whether groups that were given have unknown constants
    share: float = 0.0  # of the noise variance that groups' own functions are
    kept: bool = False  # from the last fit
    apart: tuple = ()  # arrays of outputs that are better with kernel and widths of their own


def last_network(estimator, problem):
    """The network of an estimator's last fit, if it is one of as many features and outputs."""
    last = vars(estimator).get("posterior_")
    if last is None or last.polynomial.shape != (1 + problem.X.shape[1], len(problem.spread)):
        return None
    return last


def tune(
    problem,
    kernel,
    length_scale,
    alpha,
    isotropic,
    rng,
    last=None,
    may_be_linear=False,
    split=None,
):
    """Kernel, widths and ridges, found where they are not given.

    Parameters
    ----------
    problem : Problem
    kernel : str
        May be "auto".
    length_scale : ndarray of shape (d,) or None
        None: to be found.
    alpha : ndarray of shape (q,) or None
        Ridges in units of the sample weights. None: to be found.
    isotropic : bool
        One width for all features.
    rng : numpy.random.RandomState
        Draws the rows of the search.
    last : NetworkPosterior, optional
        Of other rows; its kernel, widths and ridges are kept where they are right for these. With
        groups they are always searched for.
    may_be_linear : bool, default=False
        Whether a linear model is a candidate, too, if widths and ridges are found.
    split : bool, default=None
        If widths are found: whether to look for outputs that are better with widths of their own,
        or to warn of those that are given up without. None: neither.

    Returns
    -------
    Tuned
    """
    shift = problem.X.mean(axis=0)
    alphas = np.ones(len(problem.spread)) if alpha is None else alpha / problem.unit
    # Given widths are those of one kernel.
    kernels = (kernel,) if kernel != "auto" else AUTO_KERNELS
    if length_scale is not None:
        kernels = kernels[:1]
        if alpha is not None:
            return Tuned(RadialFunctions(kernels[0], shift, length_scale), alphas)
    sample = problem.sample
    view, rows = sample.view(), sample.block(slice(None))
    weights = np.square(sample.root[:, 0])
    targets = view.of(rows)[1] / sample.root
    data = Data(sample.X, targets, weights, view.within, sample.codes)
    if length_scale is None:
        refuse_far(data.X, robust_spread(data.X, weights))
    units = np.log(view.scale).sum()
    given = None if alpha is None else alpha[view.outputs] / sample.unit
    # Of an average of models the radial functions alone would be kept.
    averaged = may_be_linear and last is not None and len(last.tail_map) > 1
    if last is not None and last.kernel in kernels and data.codes is None and not averaged:
        width = last.length_scale if length_scale is None else length_scale
        ridge = last.alpha if alpha is None else alphas
        alike = not isotropic or np.ptp(width / sample.X.std(axis=0)) == 0
        right, value, n_observations, n_found = still_right(
            data,
            last.kernel,
            width,
            ridge[view.outputs] * problem.unit / sample.unit,
            fixed=(length_scale, given),
            random_state=rng,
        )
        if right and alike:
            functions = RadialFunctions(last.kernel, shift, width)
            value = float(value - n_observations * units)
            return Tuned(functions, ridge, value, n_found, kept=True)
    options = {"length_scale": length_scale, "isotropic": isotropic, "alpha": given}
    options |= {"random_state": rng}
    if data.codes is None:
        found = search(data, kernels, **options)
    else:
        n_total = data.n_total
        found, data = search_groups(data, kernels, linear=sample.n_tail > 0, **options)
        # Without offsets the unit of the targets is another one.
        units += 0.5 * data.Y.shape[1] * np.log(n_total / data.n_total)
    apart = ()
    if split and length_scale is None and len(view.outputs) > 1:
        apart = output_groups(data, found, isotropic, given)
        apart = _with_constants(apart, view.outputs, len(problem.spread)) if apart[1:] else ()
    open_all = may_be_linear and length_scale is None and alpha is None
    several = None
    # Of rows that are not held in memory the tail cannot be made anew.
    if open_all and sample is problem and len(found.judged) and not found.share:
        judged = data.rows(found.judged)
        if data.codes is None and len(judged.X) == len(data.X):
            several = average(judged, found.process)
        value = _linear_likelihood(judged, found) if several is None else None
        if value is not None:
            value = float(value - found.n_observations * units)
            model = _linear(problem, found.kernel, value)
            return model._replace(offsets=found.offsets, apart=apart)
    searched, linear = found, {}
    if several is not None:
        names = "length_scale", "alpha", "log_likelihood", "n_found"
        found = found._replace(**{name: getattr(several, name) for name in names})
        linear = {"linear": several.tail_ridge > 0, "several": several.weights.max() < 1}
        linear["tail_ridge"] = float(leading_bits(several.tail_ridge))
    if alpha is None:
        alphas[view.outputs] = leading_bits(found.alpha * sample.unit / problem.unit)
    if length_scale is None:
        warn_of_bound(found.at_bound)
        if split is False and alpha is None and data.codes is None:
            warn_of_unlike(view.outputs[outputs_given_up(data, searched, isotropic)])
        unit = sample.X.std(axis=0)
        unit[unit == 0] = 1.0
        length_scale = unit * leading_bits(found.length_scale / unit)
    functions = RadialFunctions(found.kernel, shift, length_scale)
    value = float(found.log_likelihood - found.n_observations * units)
    ratio = float(leading_bits(found.share / (1 - found.share)))  # keeps the digits of 1 - share
    groups = {"offsets": found.offsets, "share": ratio / (1 + ratio)}
    return Tuned(functions, alphas, value, found.n_found, **groups, **linear, apart=apart)


def _with_constants(groups, varying, n_outputs):
    """Groups of outputs that vary as those of all outputs: what is constant joins the first."""
    constant = np.setdiff1d(np.arange(n_outputs), varying)
    first, *others = (varying[of] for of in groups)
    return (np.sort(np.append(first, constant)), *others)


def _linear_likelihood(data, found):
    """Logarithm of the likelihood of a linear model, where it is the better one; else None.

    It has to lead in evidence, and in evidence and leave-one-out density together. The latter
    counts as far as there are rows for the widths: these have been chosen on the same rows.
    """
    linear = linear_process(data)
    lead = found.judgement - linear.objective
    if not lead > LINEAR_MARGIN:
        return None
    widths, ridges = np.log(found.length_scale), np.log(found.alpha)
    radial = leave_one_out(data, found.kernel, widths, ridges).negative_log_density
    density = linear_left_out(data, linear.ridge).negative_log_density
    lead += trust(data) * (radial - density)
    return linear.log_likelihood if lead > LINEAR_MARGIN else None


def _linear(problem, kernel, log_likelihood):
    """A network whose radial functions are as good as noise, so that its tail alone remains."""
    X, q = problem.X, len(problem.spread)
    width = silent_widths(X, np.square(problem.root[:, 0]))
    functions = RadialFunctions(kernel, X.mean(axis=0), width)
    ridges = np.full(q, ALPHA_BOUNDS[1])
    # The ridge of the linear part is shared by all outputs. Ten rows of 20 features held 74 % in
    # the 95 % intervals where it alone counts, as if the model had not been chosen by the data.
    n_found = parameters_found(1, X.shape[1], 0, q)
    return Tuned(functions, ridges, log_likelihood, n_found, linear=True)
