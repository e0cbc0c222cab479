"""The fit of the linear error model, from arrays to a `LinearModel`.

Families of causes are always in; harmonics are lines that have to be worth their price; a smooth
function of every joint's angle, all low orders together, is the field.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from numbers import Integral
from typing import Any, NamedTuple

import numpy as np

from sklearn_raacmm.error_model._columns import (
    FAMILIES,
    FAMILIES_OF_EXTRA,
    KINEMATICS,
    Columns,
    Terms,
    columns_of,
)
from sklearn_raacmm.error_model._linear_model import NOTHING_SEEN, LinearModel, ranges_of
from sklearn_raacmm.error_model._sums import Rows, explicit_gram, less_constants, without_motions
from sklearn_raacmm.inference import (
    Problem,
    State,
    Structures,
    beside_field,
    combined,
    refit,
    search,
    sums_of_gram,
    sums_of_pairs,
)
from sklearn_raacmm.utils import (
    TUKEY_CUT,
    Finding,
    centred,
    chunks,
    group_means,
    group_sums,
    slip_factors,
    stage,
    tukey_weights,
)

# What a harmonic costs per logarithm of its order.
_PRICE_PER_LOG_ORDER = 2.0
# Orders up to this may be there all together, smaller the higher they are: a smooth function of the
# joint's angle. Order at which the decay begins; price in nats
# (``benchmarks/bench_few_poses.py --field``).
_FIELD_ORDER, _DECAY_FROM, _PRICE_OF_FIELD = 48, 16.0, 16.0
# Log evidence that a family of extra columns has to add, in nats: noise came to at most 5, a true
# cause that helped to 22 or more (``benchmarks/bench_beyond_the_paper.py extra``).
_PRICE_OF_EXTRA = 10.0
# Prior standard deviation of a family that is not worth its price: its coefficients are nothing.
UNUSED_SD = 1e-6
# One degree, in square arc seconds: beyond it an arm's errors are not linear; directions that the
# data do not show would carry the variance beyond all bounds by their rounding.
_LARGEST_VARIANCE = 3600.0**2
# Prior standard deviation of the kinematic columns, what a drawing leaves open: in arc seconds, and
# for lengths what these span at the arm's reach. It is given, not found: a calibration has taken
# these directions out of the residuals, which then say that it is 0. From 50 to 100 the errors of
# real Pandas and simulated cones are the same within 1 % (``benchmarks/golden.py``); with 100 three
# simulated arms that a tracker saw at seven places were corrected worse than with nothing given.
KINEMATICS_SD = 50.0
# Angles nearer to each other than this, in rad, count as one: the rounding of files.
_SAME_ANGLE = 1e-6
# Orders above this are offered where a joint's angles, those nearer than 0.001 rad counted as one,
# are at least half as many as the poses (``benchmarks/bench_few_poses.py``).
HIGHEST_OF_FEW, _SAME_TOOTH, _SCATTERED = 72, 1e-3, 0.5

# Rounds of robust weights at one choice, and choices with what they have become. A weight that
# changes by less than this has settled; with so little change of all, in the mean, a choice is the
# same.
_ROUNDS, _MAX_CHOICES, _SETTLED_WEIGHT, _SETTLED_CHOICE = 4, 3, 0.05, 0.01
# Steps of the variances where they are nearly right: others follow, with the robust weights.
_REFIT_STEPS = 5
# Where more than this share of the poses has new weights, all are summed up anew: of positions with
# offsets the old and the new ones are, which costs twice as much.
_MANY_CHANGED = 0.5
# Poses whose columns are made at a time, and most poses of which all are held: some 50 MB.
_POSES, _HELD_POSES = 256, 5000
# Shares of the noise that may come through the angles: not all, for J J' has rank 2 at some poses.
_SHARES = np.arange(0.0, 0.99, 0.02)
# Rows of which that is compared at a time: 5 MB for an array of all shares.
_ROWS_OF_NOISE = 4096

# What the weights leave of the noise variance, of normal errors in three coordinates: E[w d^2] /
# (3 E[w]) with w = (1 - d^2 / c^2)^2 and d^2 of the chi-squared distribution, whose moments are 1,
# 3, 15 and 105; beyond the limit c the density is next to nothing.
_C2 = TUKEY_CUT**2
_SHARE_OF_NOISE = (3 - 30 / _C2 + 105 / _C2**2) / (3 * (1 - 6 / _C2 + 15 / _C2**2))

# Noise variances over those of constants of positions that are compared: smaller constants than the
# noise are not told from what a model that is not complete leaves alike at the rows of a position.
# Steps of the other variances at each, and rounds with a fit at what was found
# (``benchmarks/bench_few_poses.py --constants``). The evidence has one top over the sizes, as that
# of a variance has as a rule: where it has fallen by so many nats, larger constants are not tried.
_KNOWN, _CONSTANT_STEPS, _CONSTANT_ROUNDS = 10.0 ** np.arange(0.0, -4.5, -0.5), 3, 2
_FAR_BELOW = 20.0
# Variance of means that are 0 but for rounding, in parts of that of the residuals. What it costs,
# in nats, that means say nothing of the arm: of four to seven positions that a calibration has
# drawn together it came to 18, of twelve and deviations from a median to 55 (same script).
_LEAST_MEANS, _PRICE_OF_DEVIATIONS = 1e-6, 30.0
# The fewest positions at which a share of the correction is found: of three the rest is hardly the
# model that is judged. With fewer it is used as a whole, if it helped at each of them.
LEAST_POSITIONS = 4


def offered_harmonics(angles, orders):
    """Harmonics that a fit may take, (n_pairs, 2): joint from 0 and order, sorted.

    `angles` (n, n_joints) of the poses are in rad. `orders` may be the highest order: a joint at m
    different angles is offered none above m, for on a grid the waves of lower orders are the same
    there; but all above 72 where its angles are scattered. Or the orders themselves, for all joints
    or for each.
    """
    n_joints = angles.shape[1]
    if isinstance(orders, Integral):
        n_poses = len(np.unique(np.round(angles / _SAME_TOOTH), axis=0))
        named = [_seen_orders(column, orders, n_poses) for column in angles.T]
    else:
        named = list(orders)
        if not any(np.iterable(order) for order in named):
            named = [named] * n_joints
    if len(named) != n_joints:
        raise ValueError(
            f"orders has {len(named)} lists, but the arm has {n_joints} joints: give one for all, "
            "or one for each."
        )
    for joint, own in enumerate(named, start=1):
        bad = [k for k in own if not isinstance(k, Integral) or isinstance(k, bool) or k < 1]
        if bad:
            raise ValueError(
                f"orders must be whole numbers of 1 or more, got {bad[0]!r} for joint {joint}."
            )
    pairs = sorted({(joint, int(order)) for joint, own in enumerate(named) for order in own})
    return np.array(pairs, dtype=int).reshape(-1, 2)


def _seen_orders(angles, most, n_poses):
    """Orders up to `most` that the angles of a joint can tell apart."""
    n, n_teeth = (len(np.unique(np.round(angles / same))) for same in (_SAME_ANGLE, _SAME_TOOTH))
    low = list(range(1, min(most, n) + 1))
    high = range(max(HIGHEST_OF_FEW, len(low)) + 1, most + 1)
    return [*low, *high] if n_teeth >= _SCATTERED * n_poses else low


def structures_of(columns, with_field, unused):
    """Families, lines and field of a model that is offered some columns.

    Variances are in the order of `FAMILIES`. The families `unused` have proved not to be worth
    their price.
    """
    order, given = columns.terms.harmonics[:, 1], np.full(len(FAMILIES), np.nan)
    if not len(order) and not len(columns.family):
        raise ValueError("The model has no columns: no orders are offered and no causes are named.")
    given[KINEMATICS], given[unused] = KINEMATICS_SD**2, UNUSED_SD**2
    return Structures(
        family=columns.family,
        price=order_price(order),
        share=smooth_shares(order) if with_field and len(order) else None,
        field_price=_PRICE_OF_FIELD,
        given=given,
        largest=_LARGEST_VARIANCE,
    )


def order_price(order: Any) -> Any:
    """Price in nats of harmonics of the orders k: ``2 log(k)``, for the odds fall with its square.

    Every encoder is a little eccentric, so that order 1 is free. On simulated arms factors from 1.5
    to 2.5 leave the same within 0.5 % (``benchmarks/bench_few_poses.py --prices``).
    """
    return _PRICE_PER_LOG_ORDER * np.log(order)


def smooth_shares(order: np.ndarray) -> np.ndarray:
    """Prior variance of each order as a part of the field, relative to that of order 0.

    ``(1 + (k / 16)^2)^-2``, the spectrum of functions that can be differentiated; 0 above order 48.
    """
    share = (1 + np.square(order / _DECAY_FROM)) ** -2.0
    return np.where(order <= _FIELD_ORDER, share, 0.0)


class Fitted(NamedTuple):
    """A fitted model, how it was found, and of what."""

    model: LinearModel
    state: State
    pose_weight: np.ndarray  # (n,) what the robust weights left of each row
    rows: Rows
    columns: Columns  # their harmonics are those that were offered
    structures: Structures


def fit_with_constants(rows, positions, columns, with_field):
    """Fit the model, and constants of the positions of the variance that the evidence asks for.

    A reference may be off by a constant in each position. The arm's own differences between
    positions are told from these, for they are the same function of the angles everywhere. With the
    variance v of the constants and s of the noise a constant is drawn to 0 as by rows of the weight
    s / v.

    `positions` (n,) count from 0; None: there are no constants. Returns a `Fitted`, whose rows are
    those given less their constants, or with positions of which nothing is known.
    """
    fitted = fit_linear_model(rows, columns, with_field)
    if positions is None or rows.codes is not None:
        return fitted
    n_positions = int(positions.max()) + 1
    if n_positions < LEAST_POSITIONS or len(positions) < 2 * n_positions:
        return fitted
    known: Any = np.inf
    for _ in range(_CONSTANT_ROUNDS):
        last, known = known, _known_of_constants(rows, positions, fitted)
        if known == last:
            break
        given = rows if np.isinf(known) else rows._replace(codes=positions, known=known)
        fitted = fit_linear_model(given, columns, with_field)
    if np.isinf(known):
        return fitted
    weights = rows.weights * fitted.pose_weight
    total = np.bincount(positions, weights)
    left = rows.y - fitted.model.predict(rows.X)[0]
    constants = group_sums(left, positions, weights) / np.maximum(total + known, 1e-9)[:, None]
    size = float(np.sqrt(np.square(constants).sum(axis=1).mean()))
    # Deviations from a row of the position are as large as its rows scatter, at most.
    within = centred(rows.y, positions, rows.weights)
    scatter = float(np.sqrt(np.average(np.square(within).sum(axis=1), weights=rows.weights)))
    said = (
        f"The positions differ by constants of {size:.2g} mm each (root mean square) that the "
        "causes of the model do not explain."
    )
    advice = (
        "How well are the references known, and is a cause missing? The constants are not taken "
        "for the arm's."
    )
    weight = "doubt" if size > 2 * scatter else "note"
    Finding("constants-of-positions", said, advice, weight, size_mm=size).report()
    if not known:
        return fitted
    return fitted._replace(rows=rows._replace(y=rows.y - constants[positions]))


def _known_of_constants(rows, positions, fitted):
    """Noise variance over that of the constants, by the evidence of what a fit has chosen.

    Infinite: there are none. With W the weight of a position its constant takes
    ``log(1 + W / known) / 2`` of the log evidence, for x, y and z each. Their variance is one more
    number, which costs half the logarithm of how many there are (Schwarz).

    0: the means of the positions say nothing of the arm, as those of deviations from a mean, a
    median or a row of their position. They are then normal by themselves, of another variance.
    """
    # As counts of rows, weights of another size would have means scatter too much or too little.
    weight = rows.weights.mean()
    rows = rows._replace(weights=rows.weights / weight)
    state = fitted.state._replace(noise_variance=fitted.state.noise_variance / weight)
    few, structures, lines = of_pairs(fitted.columns, fitted.structures, state.lines, state.pairs)

    total = np.bincount(positions, rows.weights)
    n, n_observations = 3 * len(total), 3.0 * rows.weights.sum()
    gram, of_positions = explicit_gram(rows, few.at, positions)

    def evidence(known):
        left = less_constants(gram, of_positions, total, known)
        n_left = n_observations if known else n_observations - n
        sums = sums_of_gram(left, len(state.pairs), n_left)
        sums = sums if known else without_motions(sums, few)
        return refit(sums, structures, state, lines, _CONSTANT_STEPS).log_evidence

    found = {np.inf: evidence(np.inf)}
    for known in _KNOWN.tolist():
        taken = 1.5 * np.log1p(total / known).sum() + 0.5 * np.log(n)
        found[known] = evidence(known) - taken
        if found[known] < max(found.values()) - _FAR_BELOW:
            break
    squares = np.square(group_means(rows.y, positions, rows.weights)) * total[:, None]
    least = _LEAST_MEANS * np.average(np.square(rows.y).mean(axis=1), weights=rows.weights)
    variance = max(squares.mean(), least)
    taken = 0.5 * n * (np.log(variance) + squares.mean() / variance) + 0.5 * np.log(n)
    found[0.0] = evidence(0.0) - taken - _PRICE_OF_DEVIATIONS
    known = max(found, key=found.__getitem__)
    # Constants that are no larger than the noise are none.
    return np.inf if known == _KNOWN[0] else known * weight


@stage("linear error model")
def fit_linear_model(rows, columns, with_field) -> Any:
    """Fit the model to rows of weights above 0, with robust weights of the poses: a `Fitted`.

    The harmonics of the columns are those that are offered; `with_field` allows a smooth function
    of each angle. Families of extra columns that are not worth their price stay out.
    """
    extra: Any = set(columns.family.tolist()) & set(FAMILIES_OF_EXTRA)
    unused: list[Any] = []
    while True:
        structures = structures_of(columns, with_field, unused)
        state, factor = _fit(rows, columns, structures)
        of_family = {f: np.flatnonzero(columns.family == f) for f in extra.difference(unused)}
        gains = [(state.gain_of(of), f) for f, of in of_family.items()]
        gain, least = min(gains, default=(np.inf, None))
        if gain >= _PRICE_OF_EXTRA:
            break
        unused.append(least)
    used = rows.weighted(factor)
    model = model_of(used, columns, state)
    if np.any(factor < 1):
        model = replace(model, noise_variance=model.noise_variance / _SHARE_OF_NOISE)
    model = _with_noise_of_angles(model, used)
    return Fitted(model, state, factor, rows, columns, structures)


def _with_noise_of_angles(model, rows):
    """Model with the share of the noise that comes through the joints' angles.

    With J what the angles do to the probe, the noise of a pose is ``(1 - q) I + q J J' / l^2`` of
    the usual, with l^2 the mean square of J. Its likelihood over a grid of shares q, the size of
    the noise being the likeliest for each, gives the mean of q: there is nothing to decide.
    """
    squares = np.empty((len(rows.X), 3, 3))
    for part in chunks(len(rows.X), _ROWS_OF_NOISE):
        J = model.layout.levers(rows.X[part])
        squares[part] = J @ J.swapaxes(1, 2)
    lever = np.average(np.einsum("nii->n", squares), weights=rows.weights) / 3
    if not lever > 0:
        return model
    size, axes = np.linalg.eigh(squares / lever)
    left = centred(rows.y - model.predict(rows.X)[0], rows.codes, rows.weights)
    left = np.square(np.einsum("nca,nc->na", axes, left))
    total, fit, volume = 3 * rows.weights.sum(), np.zeros(len(_SHARES)), np.zeros(len(_SHARES))
    for part in chunks(len(rows.X), _ROWS_OF_NOISE):
        variance = 1 - _SHARES[:, None, None] * (1 - size[part])
        fit += np.einsum("n,qna->q", rows.weights[part], left[part] / variance) / total
        volume += np.einsum("n,qna->q", rows.weights[part], np.log(variance))
    if not fit.all():  # no noise
        return model
    logs = -0.5 * (total * np.log(fit) + volume)
    odds = np.exp(logs - logs.max())
    share = float(odds @ _SHARES / odds.sum())
    return replace(model, noise_of_angles=share, lever_mm=float(np.sqrt(lever)))


def _fit(rows, columns, structures) -> tuple[Any, Any]:
    """Choose structures and weights by turns: the state, and the factors of the weights."""
    factor = np.ones(len(rows.weights))
    if rows.codes is not None:  # one slip of metres would shift all others of its position
        factor = slip_factors(rows.y, rows.codes, rows.weights)
    sums, state = rows.weighted(factor).sums(columns), None
    for _ in range(_MAX_CHOICES):
        start = factor
        state = search(Problem(sums, structures), state)
        state, factor, sums = _settled(rows, columns, structures, sums, state, factor)
        if structures.share is not None and not state.with_field:
            beside = _beside_field(rows, columns, structures, sums, state, factor)
            if beside is not None:
                state, factor, sums = _settled(rows, columns, structures, sums, beside, factor)
        if np.abs(factor - start).mean() < _SETTLED_CHOICE:
            break
    return state, factor


def _beside_field(rows, columns, structures, sums, state, factor):
    """The choice beside the field, or None; sums of the field alone say whether it is searched."""
    problem = Problem(sums, structures)
    pairs = problem.pairs_and_shares(state.lines, True)[0]
    few, of_field, lines = of_pairs(columns, structures, state.lines, pairs)
    some = sums_of_pairs(sums, pairs)
    if rows.codes is not None:
        # With offsets, rows of the Gram matrix of all candidates cost more than a matrix of these.
        rows = rows.weighted(factor)
        waves = columns_of(rows.arm, Terms(few.terms.harmonics, False, False, False))
        of_extra = rows.arm.n_joints + np.arange(len(few.terms.extra))

        def waves_at(X):
            return waves.at(np.delete(X, of_extra, axis=1))

        total = np.bincount(rows.codes, rows.weights)
        gram = less_constants(*explicit_gram(rows, waves_at, rows.codes), total, rows.known)
        some = some._replace(rows=sums_of_gram(gram, len(pairs), sums.n_observations).rows)
    alone = state._replace(lines=lines, pairs=lines)
    return beside_field(problem, state, Problem(some, of_field), alone)


def of_pairs(columns, structures, lines, pairs):
    """Columns, structures, and which are lines, where some pairs are the only candidates."""
    few = columns.with_harmonics(columns.terms.harmonics[pairs])
    share = None if structures.share is None else structures.share[pairs]
    structures = structures._replace(price=structures.price[pairs], share=share)
    return few, structures, np.flatnonzero(np.isin(pairs, lines))


def _settled(rows, columns, structures, sums, state, factor):
    """A choice with robust weights that have settled: state, weights, and sums at these weights."""
    pairs, before = state.pairs, factor
    few, structures, lines = of_pairs(columns, structures, state.lines, pairs)
    some, expected = sums_of_pairs(sums, pairs), _expected(rows, few)
    for _ in range(_ROUNDS):
        left = centred(rows.y - expected(state), rows.codes, rows.weights * factor)
        old, new = factor, tukey_weights(left, rows.weights, weighed=bool(np.any(factor < 1)))
        factor = np.where(np.abs(new - old) < _SETTLED_WEIGHT, old, new)
        if np.all(factor == old):
            break
        some = _reweighted(rows, few, some, old, factor)
        found = refit(some, structures, state, lines, _REFIT_STEPS)
        state = found._replace(lines=state.lines, pairs=pairs)
    if np.any(factor != before):
        sums = _reweighted(rows, columns, sums, before, factor)
    return state, factor, sums


def _reweighted(rows, columns, sums, old, new):
    """Sums at new factors of the weights, of those at old ones, by the poses that have changed.

    Where positions have offsets all rows of a position change together.
    """
    changed = old != new
    if rows.codes is not None:
        changed = np.isin(rows.codes, rows.codes[changed])
    if rows.lengths or changed.mean() > _MANY_CHANGED:
        return rows.weighted(new).sums(columns)
    part, old, new = rows.at(changed), old[changed], new[changed]
    if rows.codes is None:
        more = part._replace(weights=part.weights * (new - old)).sums(columns)
        return combined((sums, more), (1, 1))
    parts = [(sums, 1)]
    for factor, sign in ((old, -1), (new, 1)):
        if factor.any():
            parts.append((part.weighted(factor).sums(columns), sign))
    return combined(*zip(*parts, strict=True))


def _expected(rows, columns):
    """Function of a state of these columns: the residuals (n, 3) that it expects at the rows.

    The columns are held, not multiplied out, unless there are very many poses.
    """

    def made():
        return ((part, columns.factored(rows.X[part])) for part in chunks(len(rows.X), _POSES))

    held = list(made()) if len(rows.X) <= _HELD_POSES else None

    def expected(state):
        coef, found = np.roll(state.coef, columns.n_waves), np.empty_like(rows.y)
        for part, factored in made() if held is None else held:
            found[part] = factored.dot(coef)
        return found

    return expected


def model_of(rows, columns, state):
    """`LinearModel` of a state, whose candidates are the harmonics of the columns.

    Harmonics come first, by joint, then the other columns.
    """
    order = np.roll(np.arange(len(state.coef)), 2 * len(state.pairs))
    offered, half, line = columns.terms.harmonics, state.half[order], len(FAMILIES) - 2
    families = np.unique(columns.family).tolist()
    families += [line] * bool(len(offered)) + [line + 1] * state.with_field
    model = LinearModel(
        layout=columns.with_harmonics(offered[state.pairs]),
        coef=state.coef[order],
        half=half,
        noise_variance=state.noise_variance,
        prior_sd={FAMILIES[f]: float(np.sqrt(state.variance[f])) for f in families},
        offsets=rows.codes is not None and not rows.known,
        n_determined=float(state.determined.sum()),
        log_bayes_factor=state.gains,
        seen=NOTHING_SEEN,
        ranges=ranges_of(columns.arm, rows.X[rows.weights > 0]),
    )
    if rows.codes is None:
        return model
    return model.constrained(rows.X, rows.weights, rows.codes, keep_scale=not rows.lengths)
