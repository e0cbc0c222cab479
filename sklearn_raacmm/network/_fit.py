"""The network of some outputs: its structure, centres, weights and their posterior.

Centres are chosen by orthogonal least squares, or all rows are centres where a network would need
nearly as many. Then the weights are those of the Gaussian process itself, by one Cholesky factor:
with the root R of the rows' weights and B the polynomial's columns they are the solution of
``(K + alpha R^-2) w + B b = y`` for a given b, and b is that of generalised least squares
(Rasmussen and Williams, section 2.7).
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np
from scipy.linalg import lapack, solve_triangular
from sklearn.exceptions import ConvergenceWarning

from sklearn_raacmm.network._blocks import extend
from sklearn_raacmm.network._candidates import Features, candidates_of
from sklearn_raacmm.network._kernels import kernel_matrix, psd_root
from sklearn_raacmm.network._least_squares import (
    first_weights,
    nested_least_squares,
    triangular_factor,
)
from sklearn_raacmm.network._likelihood import LEAST_RIDGE, Data
from sklearn_raacmm.network._linear import without_constants
from sklearn_raacmm.network._posterior import Network, covariance_factor
from sklearn_raacmm.network._rows import prepare
from sklearn_raacmm.network._search import AUTO_KERNELS, Structure, search
from sklearn_raacmm.network._selection import forward_selection
from sklearn_raacmm.utils import stage, warn_user

# Rows drawn as candidate centres where there are more, which is also how many may all be centres:
# their kernel matrix fits in memory, 800 MB, and takes 10 s of one thread.
MOST_ROWS = 10_000
# Share of the error that noise causes anyway which leaving out candidates may add, about.
TOLERANCE = 0.02
# Share of the variance of the noise that more centres than `MODERATE` have to be worth.
MODERATE, WORTH = 300, 0.02
# Centres tried where their number is not given.
MAX_CENTERS = 2000
# Rank at which the candidates' factor is cut, 240 MB for 10 000 rows, or per centre that may be
# tried. Mean part of the prior variance outside of it that is passed over in silence.
MAX_RANK, RANK_PER_CENTER, UNSEEN = 3000, 1.5, 0.01
# The same where the number of centres is given: in centres, and at the least, of all rows and of a
# sample, where every row is multiplied by the factor's square.
RANK_PER_GIVEN, LEAST_RANK, LEAST_RANK_OF_SAMPLE = 3.5, 1000, 256
# Effective parameters of the process, per row, from which on all rows become centres: a network's
# fit then takes 4 to 35 times as long, for the same error to 1 %.
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


def fit_outputs(estimator, rows, elsewhere, outputs, kernel, width, alpha, rng):
    """The network of some outputs (m,), which share kernel, widths and centres.

    `elsewhere` is what `read_rows` returns. What is not given, in units of X, sample weights and y,
    is None or "auto". Returns what `fit_network` does, and the log likelihood where structures were
    compared.
    """
    ridged, value = isinstance(estimator.alpha, str), None

    def set_up(degree, ratio=0.0):
        sample = prepare(rows.of_outputs(outputs), degree, ridged, ratio)
        if elsewhere is None:
            return sample, sample
        return sample, extend(sample, *elsewhere, outputs=outputs)

    # A linear part that the data have to ask for is added once they have.
    degree = 0 if estimator.degree == "auto" else estimator.degree
    sample, problem = set_up(degree)
    if width is None or alpha is None or rows.codes is not None:
        of, spread = sample.varying, sample.spread[sample.varying]
        weights, Y = np.square(sample.root[:, 0]), sample.about_tail / sample.root
        data = Data(rows.X, Y, weights, sample.left_within, rows.codes)
        kernels = AUTO_KERNELS if kernel == "auto" else (kernel,)
        found = search(
            data,
            kernels if width is None else kernels[:1],  # given widths are those of one kernel
            length_scale=width,
            isotropic=width is None and estimator.length_scale == "isotropic",
            alpha=None if alpha is None else alpha[of] / sample.unit,
            may_be_linear=estimator.degree == "auto" and width is None and alpha is None,
            random_state=rng,
        )
        if alpha is None:
            of = problem.varying
            alpha = np.ones(len(outputs))
            alpha[of] = found.alpha[np.isin(sample.varying, of)] * sample.unit / problem.unit
        else:
            alpha = alpha / problem.unit
        width = found.length_scale if width is None else width
        value = float(found.log_likelihood - found.n_observations * np.log(spread).sum())
        found = found._replace(length_scale=width, alpha=alpha)
        if found.linear or found.ratio:
            sample, problem = set_up(1 if found.linear else degree, found.ratio)
    else:
        kernel = AUTO_KERNELS[0] if kernel == "auto" else kernel
        found = Structure(kernel, width, alpha / problem.unit)
    limits = estimator.n_centers, estimator.max_centers
    return fit_network(problem, outputs, found, *limits, rng), value


@stage("centres of the network")
def fit_network(problem, outputs, structure, n_centers, max_centers, rng):
    """Choose the centres, or take all rows, and fit the weights.

    Returns the network; the centres (k,), rows of the problem; the share of the variance by which
    each lowered the objective, empty if all rows are centres; the share that the objective leaves
    after 1, 2, ... centres; and why there are no more.
    """
    n = len(problem.rows.X)
    kept = np.arange(n) if n <= MOST_ROWS else np.sort(rng.permutation(n)[:MOST_ROWS])
    order, stop = None, ""
    all_rows = n_centers == "auto" and max_centers is None and takes_all_rows(problem, structure)
    if not all_rows or len(kept) > MODERATE:
        order, stop = choose_centers(problem, kept, structure, n_centers, max_centers, all_rows)
    if order is None:
        few = problem
        if len(kept) < problem.n_rows:
            degree = min(problem.n_tail, 2) - 1
            rows = problem.rows.some(kept)
            few = prepare(rows, degree, bool(problem.tail_ridge), problem.ratio)
            structure = structure._replace(alpha=structure.alpha * problem.unit / few.unit)
        none = np.empty(0)
        return process_of(few, outputs, structure), kept, none, none, "all rows"
    return network_of(problem, outputs, order, structure, n_centers, stop)


def takes_all_rows(problem, structure):
    """Whether a network would need nearly every row as a centre to be as good as the process.

    Where no noise was found each row is a parameter, whatever the function is: centres are chosen.
    """
    alpha, varying = structure.alpha, problem.varying
    n = min(len(problem.rows.X), MOST_ROWS)
    if not len(varying) or alpha.min() < 1.01 * LEAST_RIDGE * np.square(problem.root).max():
        return False
    # The output that needs most decides, as it does on the centres.
    limit = min(ALL_ROWS, MAX_CENTERS / (CENTERS_PER_PARAMETER * n))
    return share_of_parameters(problem, alpha[varying].min(), structure, n, limit) > limit


def share_of_parameters(problem, alpha, structure, n, enough=0.0):
    """Effective number of parameters of a process of n of a problem's rows, over their number.

    It falls with every row that comes in: a sample's share that is not above `enough` is returned.
    Of more than 2000 rows the last doubling is continued as a power of the number.
    """
    X, weights = problem.rows.X, np.square(problem.root[:, 0])
    Z = (X - X.mean(axis=0)) / structure.length_scale
    # The same rows whatever `random_state` is: an outcome near the limit hangs on the data alone.
    order = np.random.RandomState(0).permutation(len(Z))
    size, last = min(n, FIRST_SAMPLE), None
    while True:
        rows = np.sort(order[:size])
        factor = covariance_factor(Z[rows], structure.kernel, weights[rows], alpha)
        factor = lapack.dtrtri(factor, lower=1, overwrite_c=1)[0]
        share = 1 - alpha * np.square(factor).sum() / size
        if share <= enough or size == n:
            return share
        if size >= LARGEST_SAMPLE:
            return share * (share / last) ** np.log2(n / size)
        size, last = min(n, 2 * size), share


def choose_centers(problem, rows, structure, n_centers, max_centers, or_all):
    """Indices of centres among `rows`, in order of how much they explain, and why it ended.

    Where all rows may become centres (`or_all`) None is returned if a moderate number is too small.
    """
    alpha, asked = structure.alpha, n_centers if isinstance(n_centers, int) else None
    if asked is not None and asked > len(rows):
        warn_user(
            f"n_centers={asked}, but there are only {len(rows)} distinct candidate rows: all of "
            "them are taken."
        )
    limit = MODERATE if or_all else max_centers or MAX_CENTERS
    most, of = min(asked or limit, len(rows)), problem.varying
    if not len(of):
        # Nothing varies: no centre is needed, and any is as good as another.
        return (rows[:most], "n_centers") if asked else (rows[:0], "criterion")
    if asked:
        least = LEAST_RANK if len(rows) == problem.n_rows else LEAST_RANK_OF_SAMPLE
        rank = max(least, int(RANK_PER_GIVEN * asked))
    else:
        rank = LEAST_RANK if or_all else max(MAX_RANK, int(RANK_PER_CENTER * most))
    # Outputs that share centres see the candidates alike: as the one that needs most of them.
    ridge = float(alpha[of].min())
    coordinates, target, resolution, degrees, unseen = candidates_of(
        problem, rows, structure, ridge, rank, asked
    )
    explained, total = np.square(target).sum(axis=0), float(problem.n_total)
    # The trace of the error reduction, of targets in their own units.
    units = np.square(problem.spread[of].max() / problem.spread[of])
    enough: Any = None
    goal = np.zeros(len(of))
    if isinstance(n_centers, float):
        floor = n_centers * np.sum(total / units)

        def within_share(_, summed):
            return np.sum((total - summed) / units) <= floor

        enough = within_share

    elif asked is None:
        # Centres are enough as soon as what further ones could still gain, summed over all samples,
        # is below `TOLERANCE` times the noise variance times the effective number of parameters of
        # the network that has all candidates: leaving them out then costs about this share of the
        # error of the noise. Many of them have to be worth a share of the noise itself.
        units = np.maximum(total - explained, 1e-14 * total) / total
        if degrees > NO_FUNCTION:
            goal = explained - TOLERANCE * degrees * units

        def worth_it(k, summed):
            moderate = explained - WORTH * total * units if k >= MODERATE else goal
            return np.all(summed >= np.minimum(goal, moderate))

        enough = worth_it

    order, reduction, why = forward_selection(
        coordinates, target, resolution, most, units=units, enough=enough
    )
    if or_all and why == "n_select":
        return None, ""
    summed = np.sum(reduction, axis=0)
    missed = np.max((goal - summed)[goal > 0] / goal[goal > 0], initial=0.0)
    if why == "n_select" and max_centers is None and missed > 0:
        warn_user(
            f"The number of centres is the default limit of {len(order)}; {100 * missed:.2g} % of "
            "what they could explain is not reached. Give a larger max_centers, or set it to this "
            "number if the network is good enough.",
            ConvergenceWarning,
        )
    if unseen > UNSEEN and not or_all:
        more = (
            f"A larger max_centers raises their number, to {RANK_PER_CENTER:g} times as many."
            if asked is None
            else "They are not those of exact orthogonal least squares."
        )
        warn_user(
            f"The widths are narrow for so many rows: {100 * unseen:.2g} % of the prior variance "
            f"at the candidates lies outside the {coordinates.shape[1]} dimensions from which "
            f"centres are chosen. {more}",
            ConvergenceWarning,
        )
    free = problem.n_rows - problem.n_tail
    if alpha.min() == 0 and len(order) > free:
        return rows[order[:free]], "dependent"
    reasons = {
        "n_select": "n_centers" if asked else "max_centers",
        "enough": "criterion",
        "dependent": "rank" if unseen > 0 else "dependent",
    }
    return rows[order], reasons[why]


def _network(problem, outputs, structure, centers, solution, objective, plain=None, **rest):
    """The network of a solution (p + k, q), with variances by the likelihood, or `plain` ones."""
    alpha, n_found, p = structure.alpha, structure.n_found, problem.n_tail
    ridged = alpha > 0
    # A linear part with a ridge has a prior as the radial functions do, and takes nothing away.
    free = problem.n_total - p + len(problem.tail_rows)
    # What was found fits these rows better than others: the mean of an inverse gamma variable.
    fewest = FEWEST_DEGREES if free > 1 else OF_TWO
    degrees = max(free - n_found - 2, fewest) if n_found else max(free, 1)
    noise = objective / degrees if plain is None else np.where(ridged, objective / degrees, plain)
    known = free > 0  # one observation says nothing of its error
    noise = noise if known else np.full(len(noise), np.inf)
    return Network(
        outputs=outputs,
        kernel=structure.kernel,
        length_scale=structure.length_scale,
        centers=centers,
        coef=np.ascontiguousarray(solution[p:]),
        polynomial=problem.polynomial.coefficients.T @ solution[:p],
        alpha=alpha,
        weight_unit=float(problem.unit),
        noise_variance=noise,
        signal_variance=np.where(
            ridged & known, noise / np.where(ridged, alpha, 1.0), problem.spread**2
        ),
        tail_map=problem.polynomial.coefficients,
        ratio=float(problem.ratio),
        **rest,
    )


def network_of(problem, outputs, order, structure, n_centers, stop):
    """What `fit_network` returns, of centres in order of selection, the first that are enough."""
    p, shift = problem.n_tail, problem.rows.X.mean(axis=0)
    Z = (problem.rows.X[order] - shift) / structure.length_scale
    columns = Features(Z, shift, structure.length_scale, structure.kernel)
    width = p + len(order) + len(problem.spread)
    R = problem.triangle(
        lambda block: np.hstack([block.tail, columns(block), block.targets]), width
    )
    root = psd_root(kernel_matrix(Z, Z, structure.kernel))
    rss, objective, dof, rotated, triangles = nested_least_squares(
        R, p, root, structure.alpha, problem.within, problem.tail_dof
    )
    of = problem.varying
    unit = np.sum(np.square(problem.spread[of])) * problem.n_total if len(of) else 1.0
    left, k = objective[:, of].sum(axis=1) / unit, len(order)
    if isinstance(n_centers, float) and k:
        reached = np.flatnonzero(rss[1:, of].sum(axis=1) / unit <= n_centers)
        k, stop = (int(reached[0]) + 1, "criterion") if len(reached) else (k, stop)
    solution = first_weights(rotated, triangles, p + k)
    plain = rss[k] / np.maximum(problem.n_total - dof[k], 1)
    rows = R[: p + k, : p + k]
    # One triangle, packed, from which those of all outputs follow.
    triangle = rows[np.triu_indices(len(rows), m=p + k)]
    centers = problem.rows.X[order[:k]]
    network = _network(
        problem, outputs, structure, centers, solution, objective[k], plain, triangle=triangle
    )
    return network, order[:k], -np.diff(left)[:k], left[1:], stop


def process_of(problem, outputs, structure):
    """The network with a centre at every row: the process itself."""
    rows, alpha = problem.rows, structure.alpha
    Z = (rows.X - rows.X.mean(axis=0)) / structure.length_scale
    weights = np.square(problem.root[:, 0])
    (n, p), q = problem.tail.shape, problem.targets.shape[1]
    solution, objective = np.empty((p + n, q)), np.empty(q)
    for one in np.unique(alpha):
        of = np.flatnonzero(alpha == one)
        factor = covariance_factor(Z, structure.kernel, weights, one, rows.codes, problem.ratio)
        both = np.hstack([problem.tail, problem.targets[:, of]])
        both = solve_triangular(factor, both, lower=True, check_finite=False)
        # In units of the noise, the ridge of the polynomial as further rows.
        stacked = np.zeros((n + len(problem.tail_rows), p + len(of)))
        stacked[:n], stacked[n:, :p] = np.sqrt(one) * both, problem.tail_rows
        R = triangular_factor(stacked)
        solution[:p, of] = solve_triangular(R[:p, :p], R[:p, p:], check_finite=False)
        objective[of] = np.square(R[p:, p:]).sum(axis=0)
        left = both[:, p:] - both[:, :p] @ solution[:p, of]
        solved = solve_triangular(factor, left, lower=True, trans="T", check_finite=False)
        # The matrix that whitens rows times their root is symmetric.
        solution[p:, of] = weights[:, None] * without_constants(
            solved / problem.root, rows.codes, weights, problem.ratio
        )
        del factor  # two would not fit
    return _network(
        problem,
        outputs,
        structure,
        rows.X,
        solution,
        objective + problem.within,
        weights=weights,
        codes=rows.codes,
        tail_ridge=float(problem.tail_ridge),
    )
