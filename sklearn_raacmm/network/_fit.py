"""The network of some outputs: its structure, centres, weights, their posterior, and far rows.

Centres are chosen by orthogonal least squares, or all rows are centres where a network would need
nearly as many. Then the weights are those of the Gaussian process itself, by one Cholesky factor:
with the root R of the rows' weights and B the polynomial's columns they are the solution of
``(K + alpha R^-2) w + B b = y`` for a given b, and b is that of generalised least squares
(Rasmussen and Williams, section 2.7).
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from numbers import Integral

import numpy as np
from scipy.linalg import lapack, solve_triangular
from scipy.stats import yeojohnson_llf, yeojohnson_normmax

from sklearn_raacmm.network import _rows
from sklearn_raacmm.network._centers import MAX_CENTERS, MODERATE, choose_centers, features_at
from sklearn_raacmm.network._kernels import kernel_matrix, psd_root
from sklearn_raacmm.network._likelihood import ALPHA_BOUNDS, LEAST_RIDGE
from sklearn_raacmm.network._linear import (
    Problem,
    first_weights,
    nested_least_squares,
    prepare,
    triangular_factor,
    without_constants,
)
from sklearn_raacmm.network._posterior import Network, covariance_factor, pack, predict_mean
from sklearn_raacmm.network._ranks import mid_ranks
from sklearn_raacmm.network._search import EXACT_ROWS, MARGIN, MARGIN_OF_TARGET, Structure, search
from sklearn_raacmm.utils import (
    TUKEY_CUT,
    Finding,
    Groups,
    many_without_weight,
    robust_scale,
    stage,
    tukey_weights,
)

# Rows drawn as candidate centres where there are more, which is also how many may all be centres:
# their kernel matrix fits in memory, 800 MB, and takes 10 s of one thread.
MOST_ROWS = 10_000
# Effective parameters of the process, per row, from which on all rows become centres: a network's
# fit then takes 4 to 35 times as long, for the same error to 1 %.
ALL_ROWS = 0.25
# Centres of a network for each effective parameter: where they are more than may be tried, all rows
# become centres, too.
CENTERS_PER_PARAMETER = 1.5
# Rows of the first and of the largest sample from which their number is estimated.
FIRST_SAMPLE, LARGEST_SAMPLE = 500, 2000
# Degrees of freedom at the least by which the sum of squares is divided: with 1 instead 85 % of new
# observations, not 91 %, were inside the 95 % intervals of 10 rows of 20 features. Of two
# observations, which leave one degree, 95 % of Student's variable are within 12.7.
FEWEST_DEGREES, OF_TWO = 0.5, (1.96 / 12.706) ** 2
# Fits at most: slips are clear after the second, and what comes and goes near the limit is not.
MAX_FITS = 4
# Nats for each target by which the robust loss has to lead: tails lead by less, slips of 1 mm by
# more. And the share of far rows above which they are no slips.
LEAD, MOST_FAR = 1.0, 0.125
# The same after the first of these fits: slips to one side, which a function can follow
# (``tests/network/test_robust_loss.py``), led by .6 then and by 1.4 after the second fit; tails led
# by .07 to .6, and by .2 to .8.
LEAD_AT_FIRST = 0.25
# Nats for each target that leaving out the far rows has to gain before another fit is made: what
# gained less on 13 tables was not taken after that fit either.
WORTH = 0.05
# Mean change of the weights at which they have settled.
SETTLED = 5e-3
# Weighted mean square over the variance, of normal residuals: E[w z^2] / E[w] with
# w = (1 - z^2 / TUKEY_CUT^2)^2, by the moments 1, 3 and 15 (what is beyond is 4e-8).
NORMAL_SQUARE = (1 - 6 / TUKEY_CUT**2 + 15 / TUKEY_CUT**4) / (
    1 - 2 / TUKEY_CUT**2 + 3 / TUKEY_CUT**4
)


def fit_outputs(
    estimator, rows, elsewhere, outputs, kernels, width, alpha, rng, before=None, refit=0
):
    """The network of some outputs (m,), which share kernel, widths and centres.

    `elsewhere` is what `distinct_rows` returns. What is not given, in units of X, sample weights
    and y, is None or "auto". A network of other weights may come `before` a refit, see `search`.
    Returns what `fit_network` does, and the log likelihood where structures were compared.
    """
    ridged, value, rows = alpha is None, None, rows.of_outputs(outputs)

    def set_up(degree, ratio=0.0):
        sample = prepare(rows, degree, ridged, ratio)
        if elsewhere is None:
            return sample, sample
        given = rows, sample.polynomial, sample.tail_ridge
        return sample, Problem(*given, everywhere=(*elsewhere, outputs))

    # A linear part that the data have to ask for is added once they have.
    degree = 0 if estimator.degree == "auto" else estimator.degree
    sample, problem = set_up(degree)
    varying, inputs = sample.varying, [None]
    spread = sample.spread[varying]
    if estimator.inputs == "ranks" or (estimator.inputs == "auto" and width is None):
        ranks = mid_ranks(rows.X, rows.weights)
        inputs = [ranks] if estimator.inputs == "ranks" else [None, ranks]
    if width is not None and alpha is not None and rows.codes is None:
        found = Structure(kernels[0], width, alpha / problem.unit, ranks=inputs[0])
    else:
        block, of = sample.block(rows), varying
        if before is not None:  # if it has radial functions
            start = replace(before, alpha=before.alpha[of])
            before = start if start.alpha.max(initial=0.0) < ALPHA_BOUNDS[1] else None
        found = search(
            rows._replace(
                Y=sample.about_tail(block) / block.root,
                weights=rows.weights / sample.unit,
                within=rows.within[:, of] / (sample.unit * spread**2),
            ),
            kernels if width is None else kernels[:1],  # given widths are those of one kernel
            inputs,
            length_scale=width,
            isotropic=width is None and estimator.length_scale == "isotropic",
            alpha=None if alpha is None else alpha[of] / sample.unit,
            may_be_linear=estimator.degree == "auto",
            random_state=rng,
            start=before,
            refit=refit,
        )
        value = float(found.log_likelihood - found.n_observations * np.log(spread).sum())
        if alpha is None:
            alpha, of = np.full(len(outputs), problem.unit), problem.varying
            alpha[of] = found.alpha[np.isin(varying, of)] * sample.unit
        width = found.length_scale if width is None else width
        found = found._replace(length_scale=width, alpha=alpha / problem.unit)
        if found.linear or found.ratio:
            sample, problem = set_up(1 if found.linear else degree, found.ratio)
    limits, scaled = (estimator.n_centers, estimator.max_centers), estimator.shared == "scaled"
    fit = fit_network(problem, outputs, found, *limits, rng, scaled)
    if found.used is not None:
        share, left = np.ones(len(outputs)), np.zeros(len(outputs))
        share[varying], left[varying] = found.used[0], found.used[1] * spread**2
        fit = fit[0].with_share(share, left), *fit[1:]
    return fit, value


@stage("centres of the network")
def fit_network(problem, outputs, structure, n_centers, max_centers, rng, scaled=False):
    """Choose the centres, or take all rows, and fit the weights.

    Outputs count in their own units, or, if `scaled`, in units of their spread.

    Returns the network; the centres (k,), rows of the problem; the share of the variance by which
    each lowered the objective, empty if all rows are centres; the share that the objective leaves
    after 1, 2, ... centres; and why there are no more.
    """
    n = len(problem.rows.X)
    kept = np.arange(n) if n <= MOST_ROWS else np.sort(rng.permutation(n)[:MOST_ROWS])
    order, stop = None, ""
    all_rows = n_centers == "auto" and max_centers is None and takes_all_rows(problem, structure)
    if not all_rows or len(kept) > MODERATE:
        limits = n_centers, max_centers
        order, stop = choose_centers(problem, kept, structure, *limits, all_rows, scaled)
    if order is None:
        few = problem
        if len(kept) < problem.n_rows:
            degree = min(problem.n_tail, 2) - 1
            rows = problem.rows.some(kept)
            few = prepare(rows, degree, bool(problem.tail_ridge), problem.ratio)
            structure = structure._replace(alpha=structure.alpha * problem.unit / few.unit)
        none = np.empty(0)
        return process_of(few, outputs, structure), kept, none, none, "all rows"
    return network_of(problem, outputs, order, structure, n_centers, stop, scaled)


def takes_all_rows(problem, structure):
    """Whether a network would need nearly every row as a centre to be as good as the process.

    Where no noise was found each row is a parameter, whatever the function is: centres are chosen.
    """
    alpha, varying = structure.alpha, problem.varying
    n = min(len(problem.rows.X), MOST_ROWS)
    if (
        not len(varying)
        or alpha.min() < 1.01 * LEAST_RIDGE * problem.rows.weights.max() / problem.unit
    ):
        return False
    # The output that needs most decides, as it does on the centres.
    limit = min(ALL_ROWS, MAX_CENTERS / (CENTERS_PER_PARAMETER * n))
    return share_of_parameters(problem, alpha[varying].min(), structure, n, limit) > limit


def share_of_parameters(problem, alpha, structure, n, enough=0.0):
    """Effective number of parameters of a process of n of a problem's rows, over their number.

    It falls with every row that comes in: a sample's share that is not above `enough` is returned.
    Of more than 2000 rows the last doubling is continued as a power of the number.
    """
    Z, weights = problem.scaled(structure), problem.rows.weights / problem.unit
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


def _network(problem, outputs, structure, centers, solution, objective, plain=0.0, **rest):
    """The network of a solution (p + k, q), with variances by the likelihood, or `plain` ones."""
    alpha, n_found, p = structure.alpha, structure.n_found, problem.n_tail
    ridged = alpha > 0
    # A linear part with a ridge has a prior as the radial functions do, and takes nothing away.
    free = problem.n_total - p + len(problem.tail_rows)
    # What was found fits these rows better than others: the mean of an inverse gamma variable.
    fewest = FEWEST_DEGREES if free > 1 else OF_TWO
    degrees = max(free - n_found - 2, fewest) if n_found else max(free, 1)
    known = free > 0  # one observation says nothing of its error
    noise = np.where(known, np.where(ridged, objective / degrees, plain), np.inf)
    signal = noise / np.where(ridged, alpha, 1.0)
    return Network(
        outputs=outputs,
        kernel=structure.kernel,
        length_scale=structure.length_scale,
        centers=centers,
        coef=np.ascontiguousarray(solution[p:]),
        polynomial=problem.polynomial.T @ solution[:p],
        alpha=alpha,
        weight_unit=float(problem.unit),
        noise_variance=noise,
        signal_variance=np.where(ridged & known, signal, problem.spread**2),
        tail_map=problem.polynomial,
        ratio=float(problem.ratio),
        ranks=structure.ranks,
        **rest,
    )


def network_of(problem, outputs, order, structure, n_centers, stop, scaled=False):
    """What `fit_network` returns, of centres in order of selection, the first that are enough."""
    p, k, Z = problem.n_tail, len(order), problem.scaled(structure)[order]
    columns = features_at(problem, Z, structure)
    R = problem.triangle(
        lambda block: np.hstack([block.tail, columns(block), block.targets]),
        p + k + len(problem.spread),
    )
    root = psd_root(kernel_matrix(Z, Z, structure.kernel))
    found = nested_least_squares(R, p, root, structure.alpha, problem.within)
    rss, objective, rotated, triangles = found
    of = problem.varying
    size = np.square(problem.spread[of])
    unit = problem.n_total * (len(of) * size if scaled else size.sum())  # of each output
    left = (objective[:, of] / unit).sum(axis=1)
    if not isinstance(n_centers, str | Integral) and k:
        reached = np.flatnonzero((rss[1:, of] / unit).sum(axis=1) <= n_centers)
        k, stop = (int(reached[0]) + 1, "criterion") if len(reached) else (k, stop)
    solution = first_weights(rotated, triangles, p + k)
    plain = rss[k] / max(problem.n_total - p - k, 1)
    rows, order = R[: p + k, : p + k], order[:k]
    # One triangle, packed, from which those of all outputs follow.
    own = {"triangle": rows[np.triu_indices(len(rows), m=p + k)], "plain": plain}
    centers = problem.rows.X[order]
    network = _network(problem, outputs, structure, centers, solution, objective[k], **own)
    return network, order, -np.diff(left)[:k], left[1:], stop


def process_of(problem, outputs, structure):
    """The network with a centre at every row: the process itself."""
    rows, alpha = problem.rows, structure.alpha
    Z, weights = problem.scaled(structure), problem.rows.weights / problem.unit
    held = problem.block(rows)
    (n, p), q = held.tail.shape, held.targets.shape[1]
    solution, objective = np.empty((p + n, q)), np.empty(q)
    for one in np.unique(alpha):
        of = np.flatnonzero(alpha == one)
        factor = covariance_factor(Z, structure.kernel, weights, one, rows.codes, problem.ratio)
        both = np.hstack([held.tail, held.targets[:, of]])
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
            solved / held.root, rows.codes, weights, problem.ratio
        )
        del factor  # two would not fit
    objective += problem.within
    own = {"weights": weights, "codes": rows.codes, "tail_ridge": float(problem.tail_ridge)}
    return _network(problem, outputs, structure, rows.X, solution, objective, **own)


# -- weights of rows by Tukey's biweight: rows far off count less, or not at all ------------------


def biweights(residuals, weights):
    """Factors (n,) of the rows' weights, by the output in which a row is farthest off."""
    size = np.abs(residuals)
    # An output that is met exactly by half of the rows has no scale.
    known = np.median(size, axis=0) > 1e-12 * size.max(axis=0, initial=0.0)
    of_outputs = [tukey_weights(left[:, None], weights) for left in residuals.T[known]]
    return np.min([np.ones(len(size)), *of_outputs], axis=0)


def reweigh(estimator, source):
    """Fit again with weights by the residuals, until these settle; "auto" if evidence is for it."""
    auto, first = estimator.loss == "auto", dict(vars(estimator))
    large = source.n_rows > _rows.IN_MEMORY_ROWS
    if auto and (large or "log_marginal_likelihood_value_" not in first):
        return
    counted = source.weights > 0
    rows = source._replace(first=np.arange(len(counted))).some(counted)
    (n, q), factor, residuals = rows.Y.shape, np.ones(rows.n_rows), rows.Y
    lead, at_first = 0.0, (residuals, factor == 0)
    for i in range(MAX_FITS):
        residuals = rows.Y - predict_mean(pack(estimator.networks_), rows.X)
        residuals -= Groups(rows.codes).medians(residuals)  # where groups have constants
        last, factor = factor, biweights(residuals, rows.weights)
        change = np.mean(np.abs(factor - last))
        if change == 0 or (i and change < SETTLED):
            break
        if not i:
            at_first = residuals, factor == 0
        if auto and not i and _gain(residuals, residuals[factor > 0]) < WORTH * q:
            return
        weighted = rows._replace(weights=rows.weights * factor)
        estimator._fit_weighted(weighted, estimator.networks_, i + 1)
        if auto and i < 2:
            now = evidence(estimator.log_marginal_likelihood_value_, n, residuals[factor == 0])
            before = evidence(first["log_marginal_likelihood_value_"], n, residuals[:0])
            lead = max(lead, (now - before) / (n * q))
            if lead < (LEAD if i else LEAD_AT_FIRST):
                return _keep(estimator, first, rows, *at_first)
    far = factor == 0
    if auto and (far.mean() > MOST_FAR or 0 < lead < LEAD):  # 0: there was no other fit
        return _keep(estimator, first, rows, *at_first)
    if np.any(factor < 1):
        squares = np.square(residuals) * far[:, None]
        added, share = (np.average(a, axis=0, weights=rows.weights) for a in (squares, far))
        estimator.networks_ = tuple(_with_outliers(n, added, share) for n in estimator.networks_)
    estimator.row_weight_ = np.ones(len(counted))
    estimator.row_weight_[counted] = factor
    for finding in many_without_weight(factor):
        finding.report()


def _keep(estimator, first, rows, residuals, far):
    """Keep the fit of least squares, and say where targets are a power of a normal variable."""
    estimator.__dict__ = first
    for y, left in zip(rows.Y.T, residuals.T, strict=True):
        gain = yeojohnson_llf(yeojohnson_normmax(y), y) - yeojohnson_llf(1.0, y)
        if gain > MARGIN + MARGIN_OF_TARGET * len(y):
            size = np.abs(left[far]).max() / robust_scale(np.abs(left), 1)
            Finding(
                "heavy-tails",
                f"The targets have heavy tails: {far.sum()} of {len(y)} rows lie more than "
                f"{TUKEY_CUT:g} standard deviations of the others off, up to {size:.3g}.",
                "Learn a power of the targets: TransformedTargetRegressor(RBFNetRegressor(), "
                "transformer=PowerTransformer()).",
                "note",
                rows=tuple(rows.first[far].tolist()),
            ).report()
            return


def _with_outliers(network, added, share):
    """A network of rows near to it, with what far rows, a share of all, add to the variance."""
    network = network.with_noise(1 / NORMAL_SQUARE)
    of_outliers = np.maximum(added[network.outputs] - share * network.noise_variance, 0.0)
    return replace(network, outlier_variance=of_outliers)


def _gain(residuals, near):
    """Nats for each row by which rows are more probable without those that are not near."""
    all_rows, near_rows = (np.square(r).mean(axis=0) for r in (residuals, near))
    return 0.5 * np.log(all_rows / np.maximum(near_rows, 1e-300)).sum()


def evidence(value, n, far):
    """Logarithm of the evidence of n rows of which `far` (m, q) have a variance of their own.

    `value` is that of the others, or of so many of them as structures are compared on.
    """
    m = len(far)
    total = value * max((n - m) / EXACT_ROWS, 1.0)
    if m:
        variance = np.maximum(np.mean(np.square(far), axis=0), 1e-300)
        total -= 0.5 * m * np.sum(1 + np.log(2 * np.pi * variance))
        total += m * np.log(m / n) + (n - m) * np.log1p(-m / n)
    return total
