"""The network with given kernel, widths and ridges: its centres, weights and their posterior."""

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.network._all_rows import process_of
from sklearn_raacmm.network._center_choice import choose_centers, choose_size, takes_all_rows
from sklearn_raacmm.network._grouped_posterior import GroupedPosterior
from sklearn_raacmm.network._network_posterior import (
    NetworkPosterior,
    Posterior,
    fit_path,
    posterior_of,
)
from sklearn_raacmm.network._parameters import slopes
from sklearn_raacmm.network._training_data import with_group_noise, with_tail


class FittedNetwork(NamedTuple):
    """What `RBFNetRegressor` keeps of its last fit."""

    posterior: Posterior | GroupedPosterior
    slopes: np.ndarray  # (d,) squared, see `_parameters.slopes`
    centers: np.ndarray  # (k,) rows of the problem
    n_tried: int  # number of centres tried
    scores: np.ndarray  # the criterion after 1, 2, ... centres, where it decides on their number
    error_reduction: np.ndarray  # (k,) share of the variance by centre; empty if all rows are
    stop_reason: str


def fit_network(problem, tuned, settings, rng, last=None):
    """Choose the centres, or take all rows, and fit the weights.

    Parameters
    ----------
    problem : Problem or ChunkedProblem
        Before a linear part or noise of groups that `tuned` asks for.
    tuned : Tuned
        Kernel, widths and ridges.
    settings : CenterSettings
    rng : numpy.random.RandomState
        Draws the candidates.
    last : Posterior, optional
        Of other rows, for a warm start.

    Returns
    -------
    FittedNetwork
    """
    functions, alpha, n_found = tuned.functions, tuned.alpha, tuned.n_found
    settings = settings._replace(several=tuned.several)
    if tuned.linear:
        problem = with_tail(problem, 1, ridged=tuned.tail_ridge or True)
    if tuned.share > 0:
        problem, alpha = with_group_noise(problem, alpha, functions, tuned.share)
    if takes_all_rows(problem, alpha, functions, settings):
        process, n = process_of(problem, alpha, functions, n_found), problem.n_rows
        squares = slopes(problem, process)
        return FittedNetwork(process, squares, np.arange(n), n, *np.empty((2, 0)), "all rows")
    # That all rows were centres says nothing of which are needed.
    last = last if isinstance(last, NetworkPosterior) else None
    order, stop_reason = choose_centers(problem, alpha, functions, settings, rng, last)
    path = fit_path(problem, order, alpha, functions)
    k, scores, reached = choose_size(problem, alpha, path, settings)
    posterior = posterior_of(problem, path, order[:k], alpha, functions, n_found)
    varying = problem.spread > 0
    share = -np.diff(path.objective, axis=0)[:k, varying] / problem.spread[varying] ** 2
    share = share.sum(axis=1) / (problem.n_total * max(1, varying.sum()))
    reason = "criterion" if reached else stop_reason
    squares = slopes(problem, posterior)
    return FittedNetwork(posterior, squares, order[:k], len(order), scores, share, reason)
