"""Kernel, widths and ridge of a network, found by the likelihood where they are not given."""

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.network._group_search import search_groups
from sklearn_raacmm.network._likelihood import Data
from sklearn_raacmm.network._network_posterior import RadialFunctions
from sklearn_raacmm.network._parameters import leading_bits, warn_of_bound
from sklearn_raacmm.network._width_search import AUTO_KERNELS, search, still_right


class Tuned(NamedTuple):
    """What the centres are chosen with."""

    functions: RadialFunctions
    alpha: np.ndarray  # (q,) ridge of every output, in units of an observation
    log_likelihood: float | None = None  # of the rows on which kernels were compared
    n_found: float = 0.0  # parameters of each output that the data have decided on
    offsets: bool = True  # whether groups that were given have unknown constants
    share: float = 0.0  # of the noise variance that groups' own functions are


def last_network(estimator, problem):
    """The network of an estimator's last fit, if it is one of as many features and outputs."""
    last = vars(estimator).get("posterior_")
    shape = problem.X.shape[1], len(problem.spread)
    if last is None or (len(last.length_scale), last.coef.shape[1]) != shape:
        return None
    return last


def tune(problem, kernel, length_scale, alpha, isotropic, rng, last=None):
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
    units = np.log(view.scale).sum()
    given = None if alpha is None else alpha[view.outputs] / sample.unit
    if last is not None and last.kernel in kernels and data.codes is None:
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
            return Tuned(functions, ridge, float(value - n_observations * units), n_found)
    options = {"length_scale": length_scale, "isotropic": isotropic, "alpha": given}
    options |= {"random_state": rng}
    if data.codes is None:
        found = search(data, kernels, **options)
    else:
        found = search_groups(data, kernels, linear=sample.n_tail > 0, **options)
    if alpha is None:
        alphas[view.outputs] = leading_bits(found.alpha * sample.unit / problem.unit)
    if length_scale is None:
        warn_of_bound(found.at_bound)
        unit = sample.X.std(axis=0)
        unit[unit == 0] = 1.0
        length_scale = unit * leading_bits(found.length_scale / unit)
    functions = RadialFunctions(found.kernel, shift, length_scale)
    value = float(found.log_likelihood - found.n_observations * units)
    ratio = float(leading_bits(found.share / (1 - found.share)))  # keeps the digits of 1 - share
    share = ratio / (1 + ratio)
    return Tuned(functions, alphas, value, found.n_found, found.offsets, share)
