"""The fit of the linear error model, from arrays to a `LinearModel`.

Families of causes are always in; harmonics are lines that have to be worth their price; a smooth
function of every joint's angle, all low orders together, is the field.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral
from operator import itemgetter
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from sklearn_raacmm.error_model._columns import (
    FAMILIES,
    FAMILIES_OF_EXTRA,
    HARMONICS,
    KINEMATICS,
    LOAD,
    SMOOTH,
    Columns,
    columns_of,
    parse_extra,
)
from sklearn_raacmm.error_model._linear_model import NOTHING_SEEN, LinearModel, ranges_of
from sklearn_raacmm.error_model._sums import (
    even_noise,
    explicit_gram,
    joint_noise,
    less_constants,
    motions_of,
    of_blocks,
    without_motions,
)
from sklearn_raacmm.inference import Problem, Structures, Sums, combined, root_of
from sklearn_raacmm.utils import TUKEY_CUT, Finding, Groups, chunks, stage, tukey_weights

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

# Waves of what slides are looked for down to this length, mm: screws and racks have longer pitches.
_LEAST_PITCH_MM = 4.0

# Rounds of robust weights at one choice. A weight that changes by less than this has settled; with
# so little change of all, in the mean, a choice is the same.
_ROUNDS, _SETTLED_WEIGHT, _SETTLED_CHOICE = 4, 0.05, 0.01
# Changes of the noise's shares and of the weights, in the mean, from which on a second choice
# follows, and a third: where slips of 170 times the noise were in the first, the second one's noise
# is another; of the UR10 its shares are off by 0.2 to 0.4, and a third choice leaves the same.
_CHANGES = (0.1, _SETTLED_CHOICE), (0.5, 0.1)
# Steps of the variances where they are nearly right: others follow, with the robust weights. With
# five the UR10 at other poses is the same to 0.1 %.
_REFIT_STEPS = 1
# Where more than this share of the poses has new weights, all are summed up anew: of positions with
# offsets the old and the new ones are, which costs twice as much.
_MANY_CHANGED = 0.5
# Poses whose residuals are expected together.
_TOGETHER = 2**15
# Rows by which the noise of the joints is found: 1000 tell a standard deviation to 2 %. And those
# by which the share of it is found that coefficients follow.
_ENOUGH, _ENOUGH_FOLLOWED = 1000, 300
_TINY = 1e-300
# Of the reach: residuals below it are the rounding of points.
ROUNDED = 1e-12

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
_RIDGES, _CONSTANT_STEPS, _CONSTANT_ROUNDS = 10.0 ** np.arange(0.0, -4.5, -0.5), 3, 2
_FAR_BELOW = 20.0
# Fits along another vertical at most: of a direction that is far off a fit has taken poses for
# outliers.
_TURNS = 4
# Variance of means that are 0 but for rounding, in parts of that of the residuals. What it costs,
# in nats, that means say nothing of the arm: of four to seven positions that a calibration has
# drawn together it came to 18, of twelve and deviations from a median to 55 (same script).
_LEAST_MEANS, _PRICE_OF_DEVIATIONS = 1e-6, 30.0
# The fewest positions at which a share of the correction is found: of three the rest is hardly the
# model that is judged. With fewer it is used as a whole, if it helped at each of them.
LEAST_POSITIONS = 4

# Poses of which a direction is found at most: more take time and turn it by less than a degree.
_ENOUGH_TURNED = 600
# Log evidence that another direction has to add, in nats: of upright arms, real and simulated, it
# came to at most 10; of those inclined by 45 degrees or on a wall to at least 135. Cosine of 2
# degrees: gravity's columns change by less than 4 % (``benchmarks/bench_after_the_lab.py mounts``).
_PRICE_OF_VERTICAL, _NEAR = 20.0, np.cos(np.deg2rad(2))
# Where the fit leaves less than this share of the residuals there is nothing to be gained.
_NOTHING_LEFT = 1e-3
# Variances of gravity's columns that are compared, in square arc seconds.
_VARIANCES = 10.0 ** np.arange(-4.0, 6.5, 0.5)
_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def offered_harmonics(angles, orders, arm=None):
    """Harmonics that a fit may take, (n_pairs, 2): joint from 0 and order, sorted.

    `angles` (n, n_joints) of the poses are in rad. `orders` may be the highest order: a joint at m
    different angles is offered none above m, for on a grid the waves of lower orders are the same
    there; but all above 72 where its angles are scattered. Or the orders themselves, for all joints
    or for each. Of a joint of the `arm` that slides, whose angles are `phases`, all down to the
    shortest pitch are offered.
    """
    n_joints = angles.shape[1]
    if isinstance(orders, Integral):
        n_poses = len(np.unique(np.round(angles / _SAME_TOOTH), axis=0))
        most = np.full(n_joints, int(orders))
        if arm is not None and orders and (slides := arm.slides):
            most[slides] = np.maximum(int(orders), arm.turn_mm[slides] / _LEAST_PITCH_MM)
        named = [_seen_orders(*one, n_poses) for one in zip(angles.T, most.tolist(), strict=True)]
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


def fit_rows(rows, positions, columns, with_field, up=None):
    """Fit the model, constants of the positions and, where the data show it, another vertical.

    A reference may be off by a constant in each position. The arm's own differences between
    positions are told from these, for they are the same function of the angles everywhere. With the
    variance v of the constants and s of the noise a constant is drawn to 0 as by rows of the weight
    s / v.

    `positions` (n,) count from 0; None: there are no constants. Where more data have shown the
    vertical, it is `up` of their `Terms`. Returns a `Fit`, whose rows are those given less their
    constants, or with positions of which nothing is known.
    """
    terms, ridge, looked, turned = columns.terms, np.inf, 0, 0
    columns = columns if up is None else columns_of(rows.arm, terms._replace(up=up))
    # A force that is always there is not told from gravity in its direction.
    forced = any(parse_extra(name, rows.arm.n_joints)[0] == "force" for name, _ in terms.extra)
    may_turn = up is None and terms.gravity and not forced
    n_positions = 0 if positions is None or rows.codes is not None else int(positions.max()) + 1
    may_differ = LEAST_POSITIONS <= n_positions <= len(rows.y) / 2
    while True:
        given = rows if np.isinf(ridge) else rows._replace(codes=positions, ridge=ridge)
        fitted = Fit(given, columns, with_field)
        rows = rows._replace(noise=fitted.rows.noise, root=fitted.rows.root)
        if may_differ and looked < _CONSTANT_ROUNDS:
            last, ridge, looked = ridge, _ridge_of_constants(rows, positions, fitted), looked + 1
            if ridge != last:
                continue
        if not (may_turn and turned < _TURNS and (found := better_vertical(fitted))):
            break
        columns, turned = columns_of(rows.arm, terms._replace(up=found)), turned + 1
        # Along the other vertical gravity was noise, and perhaps constants.
        rows, ridge, looked = rows._replace(noise=None, root=rows.shown), np.inf, 0
    if turned:
        shown = [f"({x:.2f}, {y:.2f}, {z:.2f})" for x, y, z in (columns.up, rows.arm.up)]
        where = f"frame {frame}" if (frame := rows.arm.up_frame) else "the base frame"
        said = (
            f"Gravity seems to pull against {shown[0]} of {where}, not against up = "
            f"{shown[1]}: its columns follow the data."
        )
        advice = "If the arm is mounted so, state it: Arm(..., up=), or raacmm arm --up."
        Finding("vertical", said, advice).report()
    return fitted if np.isinf(ridge) else _less_constants(rows, positions, fitted, ridge)


def _less_constants(rows, positions, fitted, ridge):
    """A fit whose rows are those given less the constants of their positions, which are named."""
    whitened = rows._replace(codes=positions, ridge=ridge).whitening(fitted.pose_weight)
    left = rows.y - fitted.model.predict(rows.X)[0]
    constants = whitened.unknowns(left[:, :, None])[:, :, 0]
    size = float(np.sqrt(np.square(constants).sum(axis=1).mean()))
    # Deviations from a row of the position are as large as its rows scatter, at most.
    within = Groups(positions).centred(rows.y, rows.weights)
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
    if scatter > ROUNDED * rows.arm.reach_mm:  # else there is nothing to tell them from
        Finding("constants-of-positions", said, advice, weight, size_mm=size).report()
    if ridge:
        fitted.rows = rows._replace(y=rows.y - constants[positions])
    return fitted


def _ridge_of_constants(rows, positions, fitted):
    """Noise variance over that of the constants, by the evidence of what a fit has chosen.

    Infinite: there are none. With W the weight of a position its constant takes
    ``log(1 + W / ridge) / 2`` of the log evidence, for x, y and z each. Their variance is one more
    number, which costs half the logarithm of how many there are (Schwarz).

    0: the means of the positions say nothing of the arm, as those of deviations from a mean, a
    median or a row of their position. They are then normal by themselves, of another variance.
    """
    # As counts of rows, weights of another size would have means scatter too much or too little.
    weight = rows.weights.mean()
    rows = rows._replace(weights=rows.weights / weight)
    state = fitted.state._replace(noise_variance=fitted.state.noise_variance / weight)
    few, structures, lines = fitted.of_pairs(state.lines, state.pairs)
    gram, of_positions, precision = explicit_gram(rows._replace(codes=positions), few.at)
    assert of_positions is not None
    n, n_observations = precision.size, 3.0 * rows.weights.sum()

    def evidence(ridge):
        share = precision / np.maximum(precision + ridge, _TINY)
        left = less_constants(gram, of_positions, share)
        n_left = n_observations if ridge else n_observations - n
        sums = Sums.of_gram(left, len(state.pairs), n_left)
        problem = Problem(sums if ridge else without_motions(sums, few), structures)
        found = problem.with_variances(problem.with_lines(state, lines), _CONSTANT_STEPS)
        return found.log_evidence

    found = {np.inf: evidence(np.inf)}
    for ridge in _RIDGES.tolist():
        taken = 0.5 * np.log1p(precision / ridge).sum() + 0.5 * np.log(n)
        found[ridge] = evidence(ridge) - taken
        if found[ridge] < max(found.values()) - _FAR_BELOW:
            break
    squares = np.square(of_positions[:, :, -1])
    least = _LEAST_MEANS * gram[-1, -1] / n_observations
    variance = max(squares.mean(), least)
    taken = 0.5 * n * (np.log(variance) + squares.mean() / variance) + 0.5 * np.log(n)
    found[0.0] = evidence(0.0) - taken - _PRICE_OF_DEVIATIONS
    ridge = max(found, key=found.__getitem__)
    # Constants that are no larger than the noise are none.
    return np.inf if ridge == _RIDGES[0] else ridge * weight


class Fit:
    """Fit to rows of weights above 0, with robust weights of the poses.

    The harmonics of the columns are those that are offered; `with_field` allows a smooth function
    of each angle. Families of extra columns that are not worth their price stay out. The `state`
    is that of the `structures` that were chosen, `pose_weight` (n,) what the robust weights have
    left of each row, and `rows` are whitened by the noise that was found.
    """

    @stage("linear error model", "state", "pose_weight", "model.noise_variance")
    def __init__(self, rows: Any, columns: Columns, with_field: bool) -> None:
        self.columns: Columns = columns
        self.levers: np.ndarray = columns.levers(rows.X)
        if rows.noise is None:
            rows = rows._replace(noise=even_noise(self.levers, rows.weights))
        extra: Any = set(columns.family.tolist()) & set(FAMILIES_OF_EXTRA)
        unused: list[int | None] = []
        while True:
            self.structures: Structures = structures_of(columns, with_field, unused)
            # From the rows as they were: what is left out of the model leaves no trace in their
            # noise.
            self.rows: Any = rows
            self._choose()
            of_family = {f: np.flatnonzero(columns.family == f) for f in extra.difference(unused)}
            gains = [(self.state.gain_of(of), f) for f, of in of_family.items()]
            gain, least = min(gains, default=(np.inf, None))
            if gain >= _PRICE_OF_EXTRA:
                break
            unused.append(least)
        model = model_of(self.rows.weighted(self.pose_weight), columns, self.state)
        if np.any(self.pose_weight < 1):
            model = model.with_noise(model.noise_variance / _SHARE_OF_NOISE)
        self.model: LinearModel = model

    def _choose(self):
        """Choose structures, and again with the weights and the noise that this has shown."""
        rows, columns = self.rows, self.columns
        self.pose_weight: np.ndarray = np.ones(len(rows.weights))
        if rows.codes is not None:  # one slip of metres would shift all others of its position
            self.pose_weight = Groups(rows.codes).slip_factors(rows.y, rows.weights)
        start = self.pose_weight
        self._sum_up()
        self._search()
        if self.structures.share is not None:
            self._sum_up_changed()
            found = self._with_field_if_worth()
            if found.with_field:
                self.state: Any = found
                self._settle()
        for of_noise, of_weights in _CHANGES:
            noise = _noise_of(self.rows.weighted(self.pose_weight), columns, self.state)
            if np.abs(noise.shares - self.rows.noise.shares).sum() > of_noise:
                root = noise.roots(self.levers, rows.shown)
                self.rows = self.rows._replace(noise=noise, root=root)
                self._sum_up()
            elif np.abs(self.pose_weight - start).mean() > of_weights:
                self._sum_up_changed()
            else:
                break
            start = self.pose_weight
            self._search(self.state)
            if np.abs(self.pose_weight - start).mean() < _SETTLED_CHOICE:
                break  # of the same weights the noise is nearly the same

    def _sum_up(self):
        self.summed: np.ndarray = self.pose_weight  # the factors of the weights in `sums`
        self.sums: Sums = self.rows.weighted(self.summed).sums(self.columns)

    def _sum_up_changed(self):
        self.sums = reweighted(self.rows, self.columns, self.sums, self.summed, self.pose_weight)
        self.summed = self.pose_weight

    @stage("choice of structures", "state", "pose_weight")
    def _search(self, state=None):
        self.state = Problem(self.sums, self.structures).search(state)
        self._settle()

    @stage("variance of the field")
    def _with_field_if_worth(self):
        """The state beside the field, whose size is found with sums of the field alone."""
        state, problem = self.state, Problem(self.sums, self.structures)
        pairs = problem.pairs_and_shares(state.lines, True)[0]
        few, structures, lines = self.of_pairs(state.lines, pairs)
        if self.rows.codes is None:
            some = self.sums.of_pairs(pairs)
        else:  # rows of the Gram matrix of all candidates cost more than sums of these
            some = self.rows.weighted(self.summed).sums(few)
        alone = state._replace(lines=lines, pairs=lines)
        return problem.with_field_if_worth(state, Problem(some, structures), alone)

    def of_pairs(
        self, lines: np.ndarray, pairs: np.ndarray
    ) -> tuple[Columns, Structures, np.ndarray]:
        """Columns, structures, and which are lines, where some pairs are the only candidates."""
        few = self.columns.with_harmonics(self.columns.terms.harmonics[pairs])
        share = None if self.structures.share is None else self.structures.share[pairs]
        structures = self.structures._replace(price=self.structures.price[pairs], share=share)
        return few, structures, np.flatnonzero(np.isin(pairs, lines))

    def _settle(self):
        """Let the robust weights of a choice settle, and its variances with them."""
        rows, chosen, pairs = self.rows, self.state.lines, self.state.pairs
        few, structures, lines = self.of_pairs(chosen, pairs)
        some = self.sums.of_pairs(pairs)
        for _ in range(_ROUNDS):
            old = self.pose_weight
            left = rows.whitening(old).centred(rows.y - _expected(rows, few, self.state))
            left = left if rows.root is None else np.einsum("nij,nj->ni", rows.root, left)
            weighed = bool(np.any(old < 1))
            new = tukey_weights(left, rows.weights, weighed=weighed, n_coordinates=rows.rank)
            new = np.where(np.abs(new - old) < _SETTLED_WEIGHT, old, new)
            if np.all(new == old):
                break
            some = reweighted(rows, few, some, old, new)
            problem = Problem(some, structures)
            state = problem.with_variances(problem.with_lines(self.state, lines), _REFIT_STEPS)
            self.state, self.pose_weight = state._replace(lines=chosen, pairs=pairs), new


def _noise_of(rows, columns, state):
    """`Noise` about the choice of a state, without what coefficients and unknowns follow of it."""
    few, rows = columns.with_harmonics(columns.terms.harmonics[state.pairs]), _some(rows, _ENOUGH)
    left = rows.whitening().centred(rows.y - _expected(rows, few, state))
    some = _some(rows, _ENOUGH_FOLLOWED)
    whitened, J = some.whitening(), columns.levers(some.X)
    shapes = whitened.root @ np.concatenate([J, np.broadcast_to(np.eye(3), (len(J), 3, 3))], axis=2)
    half = np.roll(state.half, few.n_waves, axis=0) / np.sqrt(state.noise_variance)
    flat = whitened.deviations(few.at(some.X)).reshape(3 * len(J), len(half)) @ half
    followed = [flat.reshape(len(J), 3, -1).swapaxes(1, 2) @ shapes]
    if whitened.basis is not None:
        followed.append(whitened.basis.swapaxes(1, 2) @ shapes)
    taken = sum(np.square(part).sum(axis=(0, 1)) for part in followed)
    parts = np.r_[: J.shape[2] + 1]  # the last three are the noise of the rows
    taken, whole = (np.add.reduceat(v, parts) for v in (taken, np.square(shapes).sum(axis=(0, 1))))
    taken /= np.maximum(whole, _TINY)
    return joint_noise(left, columns.levers(rows.X), rows.weights, taken, rows.shown)


def _some(rows, n):
    """About n of the rows, of whole positions where these have offsets."""
    codes = np.arange(len(rows.y)) if rows.codes is None else rows.codes
    return rows.at(codes % max(len(codes) // n, 1) == 0)


def reweighted(rows: Any, columns: Columns, sums: Sums, old: np.ndarray, new: np.ndarray) -> Sums:
    """Sums at new factors of the weights, of those at old ones, by the poses that have changed.

    Where positions have offsets all rows of a position change together.
    """
    changed = old != new
    if not changed.any():
        return sums
    if rows.codes is not None:
        changed = np.isin(rows.codes, rows.codes[changed])
    if rows.lengths or changed.mean() > _MANY_CHANGED:
        return rows.weighted(new).sums(columns)
    part, old, new = rows.at(changed), old[changed], new[changed]
    if rows.codes is None:  # the difference is enough
        old, new = np.maximum(old - new, 0.0), np.maximum(new - old, 0.0)
    factors = [(factor, sign) for factor, sign in ((old, -1), (new, 1)) if factor.any()]
    parts = [part.weighted(factor).sums(columns) for factor, _ in factors]
    return combined([sums, *parts], [1, *(sign for _, sign in factors)])


def _expected(rows, columns, state):
    """The residuals (n, 3) that a state of these columns expects at the rows."""
    coef = np.roll(state.coef, columns.n_waves)
    given = [(columns, rows.X[of], coef) for of in chunks(len(rows.X), _TOGETHER)]
    return np.concatenate([*of_blocks(Columns.dot, given, rows.by_dask)])


def model_of(rows, columns, state):
    """`LinearModel` of a state, whose candidates are the harmonics of the columns.

    Harmonics come first, by joint, then the other columns.
    """
    order = np.roll(np.arange(len(state.coef)), 2 * len(state.pairs))
    offered, half = columns.terms.harmonics, state.half[order]
    families = np.unique(columns.family).tolist()
    families += [HARMONICS] * bool(len(offered)) + [SMOOTH] * state.with_field
    model = LinearModel(
        layout=columns.with_harmonics(offered[state.pairs]),
        coef=state.coef[order],
        half=half,
        noise_of_joints=state.noise_variance * rows.noise.of_joints,
        noise_of_rows=state.noise_variance * rows.noise.of_rows,
        lever_mm=rows.noise.lever_mm,
        prior_sd={FAMILIES[f]: float(np.sqrt(state.variance[f])) for f in families},
        offsets=rows.codes is not None and not rows.ridge,
        n_determined=float(state.determined.sum()),
        log_bayes_factor=state.gains,
        seen=NOTHING_SEEN,
        ranges=ranges_of(columns.arm, rows.X[rows.weights > 0]),
    )
    if rows.codes is None:
        return model
    return model.constrained(rows.X, rows.weights, rows.codes, keep_scale=not rows.lengths)


@stage("direction of gravity")
def better_vertical(fitted):
    """A direction against gravity of higher evidence than that of a fit, or ().

    Harmonics and variances of the fit stay, but that of gravity. The search follows the slope of
    the evidence, which the mean and the covariance of the coefficients along a direction have. To
    turn the direction round changes signs only: of both the one is taken along which the arm gives
    way.
    """
    rows, state = fitted.rows.weighted(fitted.pose_weight), fitted.state
    # Gravity along another direction looks like noise of the joints.
    rows = rows._replace(root=rows.shown)
    size = np.square(fitted.rows.y).mean()
    if size == 0 or state.noise_variance < _NOTHING_LEFT**2 * size:
        return ()
    if len(rows.X) > _ENOUGH_TURNED:
        rows = rows.at(np.arange(0, len(rows.X), -(-len(rows.X) // _ENOUGH_TURNED)))
    few = fitted.columns.with_harmonics(fitted.columns.terms.harmonics[state.pairs])
    loads = np.flatnonzero(few.table["kind"] == LOAD)
    if rows.y.shape[1] * len(np.unique(rows.X, axis=0)) < len(loads):
        return ()  # along any direction so many columns explain so few poses
    left = _left_of_gravity(rows, few, loads, state)

    def loss(along):
        """Less the log evidence along a direction of any length, and its slope (Fisher)."""
        size = np.linalg.norm(along)
        evidence, coef, squares = _evidence_and_coef(along / size, *left)
        weight = np.tensordot(left[0], squares, axes=([1, 3], [0, 1]))
        slope = left[1] @ coef - weight @ along / size
        return -evidence, (slope @ along / size**2 * along - slope) / size

    # One that has paid is made better. Of the axes and the stated direction one is near enough.
    stated, price = few.up, 0.0 if few.terms.up else _PRICE_OF_VERTICAL
    starts = [(_evidence_and_coef(one, *left)[0], one) for one in (stated, *np.eye(3))]
    before = starts[0][0]
    up = minimize(loss, max(starts, key=itemgetter(0))[1], jac=True, method="L-BFGS-B").x
    up = up / np.linalg.norm(up)
    evidence, coef, _ = _evidence_and_coef(up, *left)
    if evidence - before < price:
        return ()
    # A probe sags, whatever the pose: the arm measures it above where it is.
    columns = columns_of(rows.arm, few.terms._replace(up=tuple(up.tolist())))
    above = columns.at(rows.X)[:, :, loads] @ coef
    upright = columns.upright(rows.arm.axis_vectors(rows.X[:, : rows.arm.n_joints])[0])
    up = up * np.sign((above * upright).sum())
    return () if stated @ up > _NEAR else tuple(up.tolist())


def _left_of_gravity(rows, columns, loads, state):
    """What the other columns leave of those of gravity: products (3, L, 3, L), and (3, L) with y.

    Of the L columns `loads` along x, y and z each, over the noise variance. The others stay as the
    fit has them, even if they depend on the vertical.
    """
    axes = [columns_of(rows.arm, columns.terms._replace(up=axis)).alone for axis in _AXES]
    n, size, n_waves = len(columns.table), len(loads), columns.n_waves

    def columns_at(X):
        of_gravity = [axis.at(X)[:, :, loads - n_waves] for axis in axes]
        return np.concatenate([columns.at(X), *of_gravity], axis=2)

    gram = less_constants(*explicit_gram(rows, columns_at)[:2])
    if rows.codes is not None and not rows.ridge and columns.terms.kinematics:
        motions = motions_of(columns.alone)
        keep = np.eye(len(gram))
        keep[n_waves:n, n_waves:n] -= motions @ motions.T
        gram = keep @ gram @ keep
    gram /= state.noise_variance
    rest = np.setdiff1d(np.arange(n), loads)
    of_axes = np.arange(n, n + 3 * size + 1)  # and y
    S = gram[np.ix_(rest, rest)]
    S[np.diag_indices(len(S))] += 1 / np.roll(state.prior, n_waves)[rest]
    beside = gram[np.ix_(rest, of_axes)]
    beside = solve_triangular(root_of(S), beside, trans="T", check_finite=False)
    left = gram[np.ix_(of_axes, of_axes)] - beside.T @ beside
    return left[:-1, :-1].reshape(3, size, 3, size), left[:-1, -1].reshape(3, size)


def _evidence_and_coef(up, products, moments):
    """Log evidence of gravity along a direction, at its best variance, and its coefficients.

    With S the products along it and r those with y that is ``v r' inv(I + v S) r / 2 - log det(I +
    v S) / 2`` at the variance v. Of the coefficients w the means, and those of ``w w'``.
    """
    value, vectors = np.linalg.eigh(np.einsum("a,aibj,b->ij", up, products, up))
    value, r = np.maximum(value, 0.0), up @ moments @ vectors
    v = _VARIANCES[:, None]
    evidence = 0.5 * (v * np.square(r) / (1 + v * value) - np.log1p(v * value)).sum(axis=1)
    best = np.argmax(evidence)
    variance = _VARIANCES[best] / (1 + _VARIANCES[best] * value)
    coef = vectors @ (variance * r)
    return float(evidence[best]), coef, (vectors * variance) @ vectors.T + np.outer(coef, coef)
