"""How far a model can be trusted: by models without one block of positions each.

Standard deviations of a posterior are too small where its model is not complete. Errors at
positions that had no part in a fit show by how much, whether the correction helps at all, and how
much of it is used. Without a block the harmonics are chosen again, with the variances that the
whole has found.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.optimize import minimize
from scipy.special import digamma, gammaln
from scipy.stats import norm, t

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model._columns import Terms, columns_of
from sklearn_raacmm.error_model._fit import HIGHEST_OF_FEW, LEAST_POSITIONS, model_of
from sklearn_raacmm.error_model._sums import of_blocks
from sklearn_raacmm.inference import Problem, combined
from sklearn_raacmm.utils import Finding, Groups, stage

# Blocks left out in turn; and parts of all positions, each between others, in their order along x.
N_BLOCKS, N_PARTS = 10, 5
# Mean of the prior of log b (see `interval_scales`) in a single-point test; with a tracker 0.
# Deviations from the means of positions show little of b: with this prior 94 % of all true errors
# are inside, with 0 it is 92 % (``benchmarks/bench_beyond_the_paper.py intervals``, 128 tests).
_USUAL_LOG_B = 0.7
# Errors of one position that count as independent, of each coordinate.
_EFFECTIVE_ROWS = 3.0
# With fewer than four positions noise and standard deviation are multiplied by one and so much of
# the inverse of their number: of simulated cones 0.98 (two) and 0.93 (three) are inside 95 %, of
# real Pandas 0.92 to 0.97; without it 0.93, 0.87, and 0.83 to 0.93
# (``benchmarks/bench_few_poses.py``).
_PER_FEW_POSITIONS = 1.0
# Freedoms that the estimate of `std_scale` has of each position beside one. With them .963 and .918
# of the errors of a panda_3 and a panda_2 are inside 95 %, learnt from two sockets at each of two
# placements, without .951 and .899; of true errors of 16 simulated arms learnt from eight positions
# (as ``benchmarks/bench_beyond_the_paper.py intervals`` judges them) .946 and .934.
_PER_POSITION = 3

# Factor of the standard deviation: Wiener's. With 2 instead 25 simulated errors at poses of real
# arms leave 3 % and 11 % more. So many times the factor by which errors at positions left out have
# widened the standard deviation, where that is less (``benchmarks/bench_few_poses.py``): of a UR10
# learnt from 30, 60 and 100 poses it leaves 0.98, 0.95 and 0.98 of what Wiener's leaves, of
# simulated robots 0.96, 0.99 and 0.99.
_MOST, _OF_WIDENED = 1.0, 0.3
# Rows left out that are predicted together, and where positions have offsets, so that all columns
# of whole positions are held.
_TOGETHER, _OF_POSITIONS = 2**15, 2**12
# Part of what a table does most to touches. What does less is the scale, whose column are the
# residuals themselves.
_LEAST_OF_TABLE = 1e-3
# What a correction is wrong by falls with the number of positions that it is learnt from: the
# square of it by this power. With 4 cones 2, 4 and 6 leave 0.93, 0.89 and 0.87 of what 0 does, the
# worst of six arms 1.03, 1.05 and 1.08 (``benchmarks/bench_few_poses.py --shares``).
_POWER = 4
# A gain of less than this share of the deviation is none.
_LEAST_GAIN = 1e-3
# predict warns where less than this share is left of more than half of the corrections.
_WARN_SHARE = 0.1

# Spread of the priors of log a and log b about their means; rate of the Gamma(2) prior of the
# degrees of freedom (M. A. Juarez, M. F. J. Steel, J. Bus. Econ. Stat. 28, 2010).
_LOG_SPREAD, _PER_FREEDOM = 1.0, 0.1
# Share of the largest squared deviation below which one is rounding: a position takes its own noise
# from that of its only pose, which leaves some 1e-16.
_NO_DEVIATION = 1e-12
# The search goes on to the last digits: fading acts on the result, which has to be the same for a
# weight of 2 and a row that is there twice. Logarithms that it stays between.
_SEARCH, _LOGS = {"ftol": 1e-15, "gtol": 1e-9, "maxiter": 500}, (-50.0, 50.0)


@dataclass(frozen=True)
class Fading:
    """Share of a correction that is used, by how little is known: of any model of residuals.

    With s the doubt at a pose, mm, it is ``m size^2 / (size^2 + factor^2 max(0, s^2 - known^2))``:
    Wiener's factor for errors of the size of the residuals, known to this uncertainty. What
    positions left out say beside that is ``m = most (near^4 + far s^4) / (near^4 + s^4)``: one
    share near the data, another far away.

    Attributes
    ----------
    size_mm : float
        Root mean square length of the training residuals.
    factor : float
        Factor of the doubt; 0 for no fading.
    known_mm : float
        Doubt up to which nothing fades: the largest at poses that have shown so.
    most : float
        Share near the data: found at positions left out, 0 where the correction did not help.
    far : float
        Part of `most` that is left far from the data, where blocks of positions were left out.
    near_mm : float
        Doubt where the share is in the middle between both; 0: it is ``most far`` everywhere.
    """

    size_mm: float
    factor: float
    known_mm: float = 0.0
    most: float = 1.0
    far: float = 1.0
    near_mm: float = 0.0

    def share(self, doubt: np.ndarray) -> np.ndarray:
        """Share from 0 to 1 of each correction by its doubt in mm; both have any shape."""
        if not (self.factor > 0 and self.size_mm > 0):
            return np.full(np.shape(doubt), self.most)
        size = max(self.size_mm**2, 1e-300)
        beyond = np.maximum(np.square(doubt) - self.known_mm**2, 0.0)
        return self.found(doubt) * (size / (size + self.factor**2 * beyond))

    def found(self, doubt: np.ndarray) -> np.ndarray:
        """What positions left out have said of it, (n,): Wiener's factor is not in it."""
        if self.far == 1:
            return np.full(np.shape(doubt), self.most)
        near = self.near_mm**4
        nearness = near / np.maximum(near + doubt**4, 1e-300)
        return self.most * (self.far + (1 - self.far) * nearness)

    def moved(self, old: Arm, new: Arm) -> Self:
        """Fading that takes no more of a correction than with the old probe.

        A longer probe makes every standard deviation larger, and the errors with it: that is no
        reason to take the correction back. Those of the last joint grow as its lever does, others
        less.
        """
        levers = [np.hypot(arm.a[-1], arm.d[-1]) + np.linalg.norm(arm.probe) for arm in (old, new)]
        ratio = max(float(levers[1] / levers[0]), 1.0) if levers[0] > 0 else 1.0
        lengths = {name: ratio * getattr(self, name) for name in ("size_mm", "known_mm", "near_mm")}
        return replace(self, **lengths)


class Judgement(NamedTuple):
    """Whether a correction helps at positions that were left out; means over positions."""

    mean_before_mm: float  # without correction
    mean_after_mm: float  # with it
    gain_se_mm: float  # standard error over positions of the difference
    n_positions: int
    helps: bool


def find_fading(y, weights, factor: Any, widening, centre):
    """Fading of a correction of residuals (n, 3) in mm.

    Errors at positions left out are `widening` times as large as the standard deviation says;
    infinite where there are too few to know. `centre` takes out what positions explain, as that of
    `Rows` does.
    """
    y = centre(y, weights)
    if factor == "auto":
        # A flat optimum has few reliable digits; corrections must not depend on the others.
        factor = min(round(_OF_WIDENED * widening, 3), _MOST)
    size = np.sqrt(np.average(np.square(y).sum(axis=1), weights=weights))
    return Fading(float(size), float(factor))


@stage("share of the correction")
def judge(
    y: np.ndarray,
    correction: np.ndarray,
    doubt: np.ndarray,
    fading: Fading,
    weights: np.ndarray,
    centre: Callable[[np.ndarray, np.ndarray], np.ndarray],
    positions: np.ndarray,
    before: float | None = None,
) -> tuple[Fading, Judgement]:
    """How much of a correction is used, by positions that were left out of the fit.

    With y the residuals (n, 3) and f what of the `correction` has not faded, the share is ``sum
    y.f / sum f.f``, from 0 to 1: that of least squares. Poses that slipped have no `weights` (n,).
    The model of all n `positions` knows more than those that were judged. Of a share ``S / (S +
    E)``, with S the square of what is right and E of what is wrong, E is then ``(1 - 1/n)^4 E``.
    With fewer than four positions it is 1 or 0, by whether the mean deviation falls at each. A
    share that was known `before` moves as far as it is more than a standard error away.

    `centre` is as `find_fading` takes it.

    Returns the fading with this share at every doubt, and how well it did.
    """
    kept = weights > 0
    fading = replace(fading, most=1.0, far=1.0, near_mm=0.0)
    used = fading.share(doubt)[:, None] * correction
    used, y = centre(used, weights), centre(y, weights)
    places = np.unique(positions[kept], return_inverse=True)[1].ravel()
    n = int(places.max()) + 1

    by_place = Groups(places)

    def deviations(left):
        return by_place.means(np.linalg.norm(left, axis=1)[kept], weights[kept])

    def gains_of(share):
        gains = without - deviations(y - share * used)
        return gains, gains.std(ddof=1) / np.sqrt(n) if n > 1 else np.inf

    without = deviations(y)
    if n < LEAST_POSITIONS:
        gains, error = gains_of(1.0)
        most = float(gains.mean() > max(error, _LEAST_GAIN * without.mean()) and gains.min() > 0)
    else:
        size = max(weights @ np.square(used).sum(axis=1), 1e-300)
        most = weights @ (y * used).sum(axis=1) / size
        if before is not None:
            pulls = np.bincount(places, (weights * ((y - most * used) * used).sum(axis=1))[kept])
            error = np.linalg.norm(pulls) / size
            most = np.clip(before, most - error, most + error)
        most = float(np.clip(most, 0.0, 1.0))
    gains, error = gains_of(most)
    means = float(without.mean()), float((without - gains).mean())
    judgement = Judgement(*means, float(error), n, most > 0)
    if before is None and n >= LEAST_POSITIONS:
        most /= most + (1 - most) * (1 - 1 / n) ** _POWER
    return replace(fading, most=most), judgement


def centre_beside_table(rows):
    """`centre`, as `judge` takes it, of rows that the arm was calibrated with.

    Of touches the calibration has taken out what its table explains, right or wrong: of so few
    numbers that is much. How far a correction of the table is right at other places they do not
    say.
    """
    if rows.shown is None:
        return rows.centre
    kinematics = columns_of(rows.arm, Terms(np.empty((0, 2), dtype=int), False, True, False))
    table = kinematics.at(rows.X[:, : rows.arm.n_joints])

    def centre(values, weights):
        scale = np.sqrt(weights)[:, None, None]
        own, left = (scale * rows.centre(part, weights) for part in (table, values[:, :, None]))
        unit, size, _ = np.linalg.svd(own.reshape(-1, own.shape[2]), full_matrices=False)
        unit = unit[:, size > _LEAST_OF_TABLE * size.max(initial=0.0)]
        flat = left.ravel()
        left = (flat - unit @ (unit.T @ flat)).reshape(left.shape)
        return (left / np.where(scale > 0, scale, 1.0))[:, :, 0]

    return centre


def share_near_and_far(fading, fitted, left_out, positions, centre):
    """Fading whose share far from the data is that of blocks left out, near them of positions.

    The share of `fading` is that of the blocks. In the middle between both are doubts between those
    at positions left out singly and those at blocks.
    """
    rows, weights = fitted.rows, fitted.rows.weights * fitted.pose_weight
    if not (fading.most < 1 and fading.factor > 0 and positions.max() + 1 >= 2 * N_BLOCKS):
        return fading  # of few positions the blocks are the positions, or nearly so
    near = leave_out(fitted, positions, between=True)
    if near is None:
        return fading
    most = judge(rows.y, *near[:2], fading, weights, centre, positions)[0].most
    if not most > fading.most:
        return fading
    squares = (np.average(np.square(doubt), weights=weights) for doubt in (near[1], left_out[1]))
    near_mm = float(np.prod([*squares]) ** 0.25)
    return replace(fading, most=most, far=fading.most / most, near_mm=near_mm)


def warn_where_unknown(share, most):
    """Warn where nothing, or next to nothing, is left of most corrections."""
    if most == 0:
        said = "The correction is 0: it did not help at positions that were left out."
        advice = "Update it with new poses, or learn again."
        Finding("share-of-zero", said, advice).report()
        return
    faded = np.count_nonzero(share < _WARN_SHARE * most)
    if 2 * faded > len(share):
        said = (
            f"{faded} of {len(share)} poses lie where the model knows little: their corrections "
            "are reduced to less than a tenth."
        )
        advice = (
            "Measure there and update it; large standard deviations show which poses these are."
        )
        Finding("little-known", said, advice).report()


@stage("models without one block each")
def leave_out(fitted, positions, between=False):
    """Errors at the rows of each block of neighbouring positions by a model of the others.

    `positions` (n,) count from 0. `between`: of every fifth position instead, whose neighbours are
    known. Outliers keep their weights in the means of their positions.

    Returns what models without the block of a row say of it: the correction (n, 3); the doubt (n,)
    that it fades by; its standard deviations (n, 3), where positions have offsets those of its
    deviation from the position's mean. All in mm. Or None where all positions are at one place, or
    all weight is in one block.
    """
    model, state, rows, offered = fitted.model, fitted.state, fitted.rows, fitted.columns
    blocks = _blocks(offered.points(rows.X), positions, rows.weights, between)
    kept = fitted.pose_weight > 0
    if blocks is None or not model.noise_variance > 0 or len(np.unique(blocks[kept])) < 2:
        return None
    # High orders beside the chosen ones take most of the time: on 22 simulated sets the models
    # without a block were the same with all of them offered again.
    low = offered.terms.harmonics[:, 1] <= HIGHEST_OF_FEW
    low[state.lines] = True
    if not low.any():  # only high ones are offered
        low[:] = True
    pairs = np.flatnonzero(low)
    columns, structures, lines = fitted.of_pairs(state.lines, pairs)
    start = state._replace(noise_variance=model.noise_variance, lines=lines)
    used = rows._replace(weights=rows.weights * fitted.pose_weight, lengths=()).at(kept)
    sums_of_blocks = used.sums_of_parts(columns, blocks[kept])
    parts = dict(zip(np.unique(blocks[kept]).tolist(), sums_of_blocks, strict=True))
    whole, models = combined(sums_of_blocks, [1.0] * len(parts)), {}
    for block in np.unique(blocks).tolist():
        # A block of outliers alone teaches nothing, but its errors are asked for.
        sums = combined((whole, parts[block]), (1, -1)) if block in parts else whole
        best = Problem(sums, structures).search_at(start)
        models[block] = model_of(used.at(blocks[kept] != block), columns, best)
    n = len(rows.y)
    order = np.arange(n) if rows.codes is None else np.argsort(rows.codes, kind="stable")
    size = _TOGETHER if rows.codes is None else _OF_POSITIONS
    together = [order[part] for part in rows.at(order).chunks(size)]
    given = [(models, blocks[of], rows.at(of)) for of in together]
    found = np.empty((n, 3)), np.empty(n), np.empty((n, 3))
    for of, mine in zip(together, of_blocks(_at_rows, given, rows.by_dask), strict=True):
        for values, own in zip(found, mine, strict=True):
            values[of] = own
    return found


def _at_rows(models, blocks, rows):
    """What `leave_out` returns, at some rows by the models that have not seen their blocks."""
    n = len(rows.X)
    correction, doubt, std = np.empty((n, 3)), np.empty(n), np.empty((n, 3))
    own = [(models[block], blocks == block) for block in np.unique(blocks).tolist()]
    pairs = [model.layout.terms.harmonics for model, _ in own]
    every = np.unique(np.concatenate(pairs), axis=0)
    columns: Any = None
    left: Any = None
    if rows.codes is not None:
        # Columns of all models at once: what positions explain of them is taken out once.
        columns = own[0][0].layout.with_harmonics(every).at(rows.X)
        left = rows.along(rows.whitening().centred(columns))
    for (model, of), chosen in zip(own, pairs, strict=True):
        # What makes predictions fast costs as much as those of a row for each coefficient.
        if columns is None and np.count_nonzero(of) > len(model.coef):
            correction[of], std[of], doubt[of] = model.predict_with_doubt(rows.X[of], True)
            continue
        if columns is None:
            here = model.columns(rows.X[of])
            doubts = dots = np.tensordot(here, model.gauge_free_half, 1)
        else:
            chosen = (every[:, None] == chosen).all(axis=2).any(axis=1)
            chosen = np.r_[np.repeat(chosen, 2), np.ones(len(model.layout.others), dtype=bool)]
            here = columns[of][:, :, chosen]
            doubts = np.tensordot(here, model.gauge_free_half, 1)
            dots = np.tensordot(left[of][:, :, chosen], model.half, 1)
        correction[of] = here @ model.coef
        doubt[of], std[of] = np.linalg.norm(doubts, axis=(1, 2)), np.linalg.norm(dots, axis=2)
    return correction, doubt, std


def _blocks(points, positions, weights, between=False):
    """Blocks of neighbouring positions, by k-means among their mean points; None for one place.

    `between`: every fifth of the positions, in the order of their x.
    """
    means, place = np.unique(
        Groups(positions).means(points, weights), axis=0, return_inverse=True
    )  # repeated rows, each a position of its own, are no more places than one
    n_blocks = min(N_BLOCKS, len(means))
    if n_blocks < 2:
        return None
    blocks = np.arange(len(means))
    if between:
        blocks %= N_PARTS
    elif n_blocks < len(means):
        from sklearn.cluster import KMeans  # here: predicting spares the time of importing it

        blocks = KMeans(n_blocks, n_init=4, random_state=0).fit_predict(means)
    return blocks[place.ravel()[positions]]


def with_interval_scales(model, left_out, rows, positions, share: Any = 1.0):
    """Model whose intervals are as wide as errors at positions left out ask for.

    Errors of a share of the correction in units of ``sqrt(a n^2 + b s^2)``, n the noise and s the
    posterior standard deviation, say what a and b are (see `interval_scales`). Of fewer than four
    positions a single-point test has them by their number, and a tracker's model stays as it is.
    """
    n_positions, weights, codes = len(np.unique(positions)), rows.weights, rows.codes
    if left_out is None or n_positions < LEAST_POSITIONS:
        wider = 1.0 if codes is None else 1 + _PER_FEW_POSITIONS / n_positions
        return replace(model, noise_scale=wider, std_scale=wider, n_positions=float(n_positions))
    correction, _, spread = left_out
    whitened = rows.whitening()
    errors = rows.along(whitened.centred(rows.y - share * correction))
    if rows.shown is None:
        variance = np.square(model.noise_ratio(rows.X))
    else:
        variance = np.square(rows.along(model.noise_root(rows.X))).sum(axis=2)
    if codes is not None:  # the position's own constant has taken its share of the noise
        taken = np.square(rows.along(whitened.moves)).sum(axis=2)
        variance = np.maximum(variance - np.minimum(taken, variance), 0.0)
    noise = model.noise_sd * np.sqrt(variance)
    worth = min(1.0, _EFFECTIVE_ROWS * n_positions / weights.sum())
    usual = 0.0 if codes is None else _USUAL_LOG_B
    noise_scale, std_scale = interval_scales(errors, noise, spread, weights, worth, usual)
    return replace(
        model, noise_scale=noise_scale, std_scale=std_scale, n_positions=float(n_positions)
    )


def with_students_quantile(model):
    """Model whose intervals bear that its `std_scale` is an estimate from few positions.

    The factor of the normal quantile of 95 % is Student's, with three freedoms, the coordinates, of
    each position beside one. The noise is known from all poses and stays. How much of a correction
    fades is found before this.
    """
    if model.n_positions < LEAST_POSITIONS:  # see `_PER_FEW_POSITIONS`
        return model
    wider = t.ppf(0.975, _PER_POSITION * (model.n_positions - 1)) / norm.ppf(0.975)
    return replace(model, std_scale=float(wider * model.std_scale))


@stage("factors of intervals")
def interval_scales(
    errors: np.ndarray,
    noise: np.ndarray,
    std: np.ndarray,
    weights: np.ndarray,
    worth: float = 1.0,
    usual_log_b: float = 0.0,
    usual_log_a: float = 0.0,
) -> tuple[float, float]:
    """Factors of noise and standard deviation at which intervals of 95 % hold.

    Errors (n, q) in units of ``sqrt(a noise^2 + b std^2)`` are a Student variable: a, b and its
    degrees of freedom have the highest posterior. Both deviations (n, q) are then multiplied so
    that 1.96 of them hold 95 %. `worth` are independent errors per coordinate: those of one
    position resemble each other. `usual_log_b` and `usual_log_a` are the means of the priors of
    log b and log a.
    """
    # Deviations in positions of one pose are rounding, and say nothing.
    size = np.square(noise) + np.square(std)
    used = size > _NO_DEVIATION * size.max(initial=0.0)
    weight = np.broadcast_to(weights[:, None], errors.shape)[used]
    e2, n2, s2 = (np.square(values[used]) for values in (errors, noise, std))
    if not len(e2):
        return 1.0, 1.0
    usual = np.array([usual_log_a, usual_log_b])

    def loss(logs):
        """Less the log posterior, and its slope."""
        a, b, freedom = np.exp(logs)
        of_noise, of_model = a * n2, b * s2
        variance, half = of_noise + of_model, freedom / 2
        u = e2 / (freedom * variance)
        size, far = np.log1p(u), (freedom + 1) * u / (1 + u)
        # As t.logpdf of SciPy, whose checks would take 40 % of the time of a fit to 60 rows.
        level = gammaln(half + 0.5) - gammaln(half) - 0.5 * np.log(np.pi * freedom)
        density = level - 0.5 * ((freedom + 1) * size + np.log(variance))
        off = (logs[:2] - usual) / _LOG_SPREAD
        value = 0.5 * off @ off + _PER_FREEDOM * freedom - 2 * logs[2] - worth * weight @ density
        pull = weight * (far - 1) / variance
        of_freedom = half * (digamma(half + 0.5) - digamma(half)) - 0.5
        of_freedom += 0.5 * (far - freedom * size)
        slope = np.array([pull @ of_noise / 2, pull @ of_model / 2, weight @ of_freedom])
        return value, np.append(off / _LOG_SPREAD, _PER_FREEDOM * freedom - 2) - worth * slope

    starts = ([0.0, 0.0, 3.0], [-1.0, 2.0, 1.5])
    found = [
        minimize(loss, start, jac=True, method="L-BFGS-B", bounds=[_LOGS] * 3, options=_SEARCH)
        for start in starts
    ]
    a, b, freedom = np.exp(min(found, key=lambda one: one.fun).x)
    widening = t.ppf(0.975, freedom) / norm.ppf(0.975)
    return float(widening * np.sqrt(a)), float(widening * np.sqrt(b))
