"""The network of given kernel, widths and ridges: its centres, weights and their posterior.

Centres are chosen by orthogonal least squares, or all rows are centres where a network would need
nearly as many. Then the weights are those of the Gaussian process itself, by one Cholesky factor:
with the root R of the rows' weights and B the polynomial's columns they are the solution of
``(K + alpha R^-2) w + B b = y`` for a given b, and b is that of generalised least squares [1]_.

References
----------
.. [1] C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT Press
   2006, section 2.7.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack, solve_triangular
from sklearn.exceptions import ConvergenceWarning

from sklearn_raacmm.network._candidates import Features, candidates_of
from sklearn_raacmm.network._kernels import kernel_matrix, psd_root
from sklearn_raacmm.network._least_squares import (
    beside_centers,
    nested_least_squares,
    stack_triangles,
    triangle_of_all,
    triangular_factor,
)
from sklearn_raacmm.network._likelihood import LEAST_RIDGE
from sklearn_raacmm.network._linear import without_constants
from sklearn_raacmm.network._posterior import Network, covariance_factor
from sklearn_raacmm.network._selection import forward_selection
from sklearn_raacmm.utils import stage, warn_user

# Rows drawn as candidate centres where there are more, which is also how many may all be centres:
# their kernel matrix fits in memory, 800 MB, and takes 10 s of one thread.
MOST_ROWS = 10_000
# Share of the error that noise causes anyway which leaving out candidates may add, about.
TOLERANCE = 0.02
# Centres tried where their number is not given.
MAX_CENTERS = 2000
# Rank at which the candidates' factor is cut: 240 MB for 10 000 rows, and a step costs as much
# memory traffic; or per centre that may be tried, to be chosen from more dimensions than centres
# take up. Mean part of the prior variance outside of it that is passed over in silence.
MAX_RANK, RANK_PER_CENTER, UNSEEN = 3000, 1.5, 0.01
# The same where the number of centres is given: in centres, and at the least, of all rows and of a
# sample, where every row is multiplied by the factor's square. Errors over those of an exact factor
# were 0.99 to 1.02 on two real arms, and up to 1.05 on simulated waves with widths that were found.
RANK_PER_GIVEN, LEAST_RANK, LEAST_RANK_OF_SAMPLE = 3.5, 1000, 256
# Effective parameters of the process, per row, from which on all rows become centres. On 21 random
# functions a network's fit, without the search, then took 4 to 35 times as long as that of all
# rows, for a third or more of their centres and the same error to 1 %.
ALL_ROWS = 0.25
# Centres of a network for each effective parameter: where they are more than may be tried, all rows
# become centres, too.
CENTERS_PER_PARAMETER = 1.5
# Rows of the first and of the largest sample from which their number is estimated.
FIRST_SAMPLE, LARGEST_SAMPLE = 500, 2000
# Parameters of the process below which its function is none.
NO_FUNCTION = 0.5
# Degrees of freedom at the least by which the sum of squares is divided: with 1 instead 85 % of new
# observations, not 91 %, were inside the 95 % intervals of 10 rows of 20 features. Of two
# observations, which leave one degree, 95 % of Student's variable are within 12.7.
FEWEST_DEGREES, OF_TWO = 0.5, (1.96 / 12.706) ** 2


class Fitted(NamedTuple):
    """A network, and how its centres were found."""

    network: Network
    centers: np.ndarray  # (k,) rows of the problem
    error_reduction: np.ndarray  # (k,) share of the variance by centre; empty if all rows are
    path: np.ndarray  # (n_tried,) share that the objective leaves after 1, 2, ... centres
    n_tried: int
    stop_reason: str


@stage("centres of the network")
def fit_network(problem, outputs, functions, alpha, n_found, n_centers, max_centers, rng):
    """Choose the centres, or take all rows, and fit the weights.

    `outputs` (q,) are the targets' columns that the problem has, `alpha` (q,) their ridges in units
    of an observation, `n_found` the parameters of each that the data have decided on beside the
    variances. `n_centers` is their number, or the share of the variance that they may leave, or
    None for as many as make the network about as good as the process; `max_centers` None is the
    default, or all rows. `rng` draws the candidates.

    It warns of more centres than candidates, and (ConvergenceWarning) of a limit that the user has
    not set and that decided on their number.
    """
    if n_centers is None and max_centers is None and takes_all_rows(problem, alpha, functions):
        sample = problem.sample
        if sample.n_rows > MOST_ROWS:
            rows = np.sort(rng.permutation(sample.n_rows)[:MOST_ROWS])
            kept, sample = rows, sample.some(rows)
        else:
            kept = np.arange(sample.n_rows)
        network = process_of(sample, outputs, alpha, functions, n_found)
        none = np.empty(0)
        return Fitted(network, kept, none, none, len(kept), "all rows")
    order, stop = choose_centers(problem, alpha, functions, n_centers, max_centers, rng)
    path = fit_path(problem, order, alpha, functions)
    varying = problem.spread > 0
    unit = problem.spread[varying] ** 2 * problem.n_total * max(1, varying.sum())
    left = (path.objective[:, varying] / unit).sum(axis=1)
    k = len(order)
    if isinstance(n_centers, float) and k:
        share = (path.rss[1:, varying] / unit).sum(axis=1)
        reached = np.flatnonzero(share <= n_centers)
        k, stop = (int(reached[0]) + 1, "criterion") if len(reached) else (k, stop)
    network = network_of(problem, outputs, path, order[:k], alpha, functions, n_found)
    return Fitted(network, order[:k], -np.diff(left)[:k], left[1:], len(order), stop)


def takes_all_rows(problem, alpha, functions):
    """Whether every row becomes a centre, because a network would need nearly as many.

    Of more than `MOST_ROWS` so many are looked at, and become centres.
    """
    varying = problem.spread > 0
    n = min(len(problem.X), MOST_ROWS)
    if not np.any(varying) or alpha.min() < LEAST_RIDGE * np.square(problem.sample.root).max():
        return False
    # The output that needs most decides, as it does on the centres.
    limit = min(ALL_ROWS, MAX_CENTERS / (CENTERS_PER_PARAMETER * n))
    return share_of_parameters(problem.sample, alpha[varying].min(), functions, n, limit) > limit


def share_of_parameters(problem, alpha, functions, n, enough=0.0):
    """Effective number of parameters of a process of n of a problem's rows, over their number.

    It falls with every row that comes in. So a sample whose share is not above `enough` decides
    already: then it is an upper bound. Where it is large in a sample of 2000 rows, the last
    doubling is continued as a power of the number: with 6000 rows of three rough functions 6 to 14
    % too many.
    """
    kernel, shift, length_scale = functions
    Z, weights = (problem.X - shift) / length_scale, np.square(problem.root[:, 0])
    # The same rows whatever `random_state` is: an outcome near the limit hangs on the data alone.
    order = np.random.RandomState(0).permutation(len(Z))
    size, last = min(n, FIRST_SAMPLE), None
    while True:
        rows = np.sort(order[:size])
        factor = covariance_factor(Z[rows], kernel, weights[rows], alpha)
        factor[:] = lapack.dtrtri(factor, lower=1, overwrite_c=1)[0]
        share = 1 - alpha * np.square(factor).sum() / size
        if share <= enough or size == n:
            return share
        if size >= LARGEST_SAMPLE:
            return share * (share / last) ** np.log2(n / size)
        size, last = min(n, 2 * size), share


def choose_centers(problem, alpha, functions, n_centers, max_centers, rng):
    """Indices of centres in order of how much they lower the objective, and why it ended."""
    n = len(problem.X)
    rows = np.arange(n) if n <= MOST_ROWS else np.sort(rng.permutation(n)[:MOST_ROWS])
    asked = n_centers if isinstance(n_centers, int) else None
    if asked is not None and asked > len(rows):
        warn_user(
            f"n_centers={asked}, but there are only {len(rows)} distinct candidate rows: all of "
            "them are taken."
        )
    most = min(asked or max_centers or MAX_CENTERS, len(rows))
    view = problem.view()
    if not len(view.outputs):
        # Nothing varies: no centre is needed, and any is as good as another.
        return (rows[:most], "n_centers") if asked else (rows[:0], "criterion")
    if asked:
        least = LEAST_RANK if len(rows) == problem.n_rows else LEAST_RANK_OF_SAMPLE
        rank = max(least, int(RANK_PER_GIVEN * asked))
    else:
        rank = max(MAX_RANK, int(RANK_PER_CENTER * most))
    # Outputs that share centres see the candidates alike: as the one that needs most of them.
    ridge = float(alpha[view.outputs].min())
    candidates = candidates_of(problem, view, rows, functions, ridge, rank, asked)
    units, goal, enough = 1.0, None, None
    if isinstance(n_centers, float):
        total = view.total + view.within
        floor = n_centers * len(total) * problem.n_total

        def few_are_left(summed):
            return np.sum(total - summed) <= floor

        enough = few_are_left
    elif asked is None:
        units, goal = posterior_goal(problem, view, candidates)

        def all_are_reached(summed):
            return np.all(summed >= goal)

        enough = all_are_reached
    found = forward_selection(*candidates[:3], most, units=units, enough=enough)
    if goal is not None:
        _warn_of_limits(found, candidates, max_centers, goal)
    indices = found.indices
    room = problem.n_rows - problem.n_tail
    if alpha.min() == 0 and len(indices) > room:
        return rows[indices[:room]], "dependent"
    reasons = {
        "n_select": "n_centers" if asked else "max_centers",
        "enough": "criterion",
        "dependent": "rank" if candidates.unseen > 0 else "dependent",
    }
    return rows[indices], reasons[found.stop]


def posterior_goal(problem, view, candidates):
    """Noise (q,) of every output, the unit of its gains, and the reduction (q,) that is enough.

    Centres are enough as soon as what further ones could still gain, summed over all samples, is
    below `TOLERANCE` times the noise variance times the effective number of parameters of the
    network that has all candidates: leaving them out then costs about this share of the error of
    the noise.
    """
    explained = np.square(candidates.target).sum(axis=0)
    degrees = candidates.degrees_of_freedom
    left = view.total + view.within - explained
    noise = np.maximum(left, 1e-14 * problem.n_total) / problem.n_total
    return noise, explained - TOLERANCE * degrees * noise if degrees > NO_FUNCTION else 0 * noise


def _warn_of_limits(found, candidates, max_centers, goal):
    """Warn where a limit that the user has not set decided on the network."""
    if found.stop == "n_select" and max_centers is None:
        reached = np.sum(found.reduction, axis=0)
        share = np.max((goal - reached)[goal > 0] / goal[goal > 0], initial=0.0)
        if share > 0:
            warn_user(
                f"The number of centres is the default limit of {len(found.indices)}; "
                f"{100 * share:.2g} % of what they could explain is not reached. Give a larger "
                "max_centers, or set it to this number if the network is good enough.",
                ConvergenceWarning,
            )
    if candidates.unseen > UNSEEN:
        rank = candidates.coordinates.shape[1]
        warn_user(
            f"The widths are narrow for so many rows: {100 * candidates.unseen:.2g} % of the prior "
            f"variance at the candidates lies outside the {rank} dimensions "
            "from which centres are chosen. A larger max_centers raises their number, to "
            f"{RANK_PER_CENTER:g} times as many.",
            ConvergenceWarning,
        )


def fit_path(problem, order, alpha, functions):
    """Fits with the first 0, 1, ... of some rows, in order of selection, as centres."""
    kernel, shift, length_scale = functions
    Z = (problem.X[order] - shift) / length_scale
    columns, p = Features(Z, shift, length_scale, kernel), problem.n_tail
    beside = partial(beside_centers, columns)
    R = triangle_of_all(problem, beside, p + len(order) + len(problem.spread))
    if len(problem.tail_rows):
        below = np.zeros((len(problem.tail_rows), R.shape[1]))
        below[:, :p] = problem.tail_rows
        R = stack_triangles(R, below)
    root = psd_root(kernel_matrix(Z, Z, kernel))
    return nested_least_squares(R, p, root, alpha, problem.within, problem.tail_dof)


def variances(problem, alpha, objective, n_found, plain=None):
    """Variances (q,) of the noise and of the signal, by the likelihood.

    `objective` (q,) is the sum of squares with the penalty; `plain` (q,) the variance of the noise
    where there is no ridge.
    """
    # Without a ridge the residual, and the targets' own variance.
    ridged = alpha > 0
    # A linear part with a ridge has a prior as the radial functions do, and takes nothing away.
    free = problem.n_total - problem.n_tail + len(problem.tail_rows)
    # What was found fits these rows better than others: the mean of an inverse gamma variable.
    fewest = FEWEST_DEGREES if free > 1 else OF_TWO
    degrees = max(free - n_found - 2, fewest) if n_found else max(free, 1)
    noise = objective / degrees if plain is None else np.where(ridged, objective / degrees, plain)
    known = free > 0  # one observation says nothing of its error
    noise = noise if known else np.full(len(noise), np.inf)
    signal = np.where(ridged & known, noise / np.where(ridged, alpha, 1.0), problem.spread**2)
    return noise, signal


def network_of(problem, outputs, path, centers, alpha, functions, n_found=0.0):
    """The network of the first centres, rows of the problem, of a path."""
    p, k = problem.n_tail, len(centers)
    solution = path.coefficients(k)
    plain = path.rss[k] / np.maximum(problem.n_total - path.dof[k], 1)
    noise, signal = variances(problem, alpha, path.objective[k], n_found, plain)
    rows = path.rows[: p + k, : p + k]
    return Network(
        outputs,
        functions.kernel,
        functions.length_scale,
        problem.X[centers],
        np.ascontiguousarray(solution[p:]),
        problem.tail_map.T @ solution[:p],
        alpha,
        float(problem.unit),
        noise,
        signal,
        problem.tail_map,
        float(problem.ratio),
        # One triangle, packed, from which those of all outputs follow.
        rows[np.triu_indices(len(rows), m=p + k)],
    )


def process_of(problem, outputs, alpha, functions, n_found=0.0):
    """The network with a centre at every row: the process itself."""
    kernel, shift, length_scale = functions
    Z, weights = (problem.X - shift) / length_scale, np.square(problem.root[:, 0])
    constants = problem.codes, problem.ratio
    (n, p), q = problem.tail.shape, problem.targets.shape[1]
    coef, polynomial, objective = np.empty((n, q)), np.empty((p, q)), np.empty(q)
    for one in np.unique(alpha):
        of = np.flatnonzero(alpha == one)
        factor = covariance_factor(Z, kernel, weights, one, *constants)
        both = np.hstack([problem.tail, problem.targets[:, of]])
        both = solve_triangular(factor, both, lower=True, check_finite=False)
        # In units of the noise, the ridge of the polynomial as further rows.
        rows = np.zeros((n + len(problem.tail_rows), p + len(of)))
        rows[:n], rows[n:, :p] = np.sqrt(one) * both, problem.tail_rows
        R = triangular_factor(rows)
        polynomial[:, of] = solve_triangular(R[:p, :p], R[:p, p:], check_finite=False)
        objective[of] = np.square(R[p:, p:]).sum(axis=0)
        left = both[:, p:] - both[:, :p] @ polynomial[:, of]
        solved = solve_triangular(factor, left, lower=True, trans="T", check_finite=False)
        # The matrix that whitens rows times their root is symmetric.
        coef[:, of] = weights[:, None] * without_constants(
            solved / problem.root, problem.codes, weights, problem.ratio
        )
        del factor  # two would not fit
    noise, signal = variances(problem, alpha, objective + problem.within, n_found)
    return Network(
        outputs,
        kernel,
        length_scale,
        problem.X,
        coef,
        problem.tail_map.T @ polynomial,
        alpha,
        float(problem.unit),
        noise,
        signal,
        problem.tail_map,
        float(problem.ratio),
        weights=weights,
        codes=problem.codes,
        tail_ridge=float(problem.tail_ridge),
    )
