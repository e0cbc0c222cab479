"""The fit of the linear error model, from arrays to a `LinearModel`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sklearn_raacmm.arm import Arm, points_of
from sklearn_raacmm.error_model._columns import (
    FAMILIES,
    HARMONIC,
    Terms,
    factored_columns,
    scale_direction,
    term_names,
)
from sklearn_raacmm.error_model._extra import with_references
from sklearn_raacmm.error_model._families import IDLE_VARIANCE, least_of_the_idle
from sklearn_raacmm.error_model._harmonic_selection import refit, select_harmonics
from sklearn_raacmm.error_model._linear_model import LinearModel
from sklearn_raacmm.error_model._order_scan import (
    candidate_sums,
    sums_of_both,
    sums_of_pairs,
    sums_with_other_weights,
)
from sklearn_raacmm.error_model._orders import (
    offered_harmonics,
    order_prices,
    smooth_shares,
)
from sklearn_raacmm.error_model._place_fields import place_fields
from sklearn_raacmm.error_model._position_means import length_equations, mean_columns
from sklearn_raacmm.error_model._smooth_functions import add_smooth, choose_beside_smooth
from sklearn_raacmm.utils import centred, chunks, group_means, stage

# Name of the smooth function among the families: of low orders that are not taken for themselves.
SMOOTH = "smooth"
# Columns that move the arm as a whole: the first axis stands still in the base.
BASE_MOTIONS = ("d1", "theta_offset1", "base_x", "base_y", "base_alpha", "base_beta")
# Farther off than this, in standard deviations of a coordinate, a pose has no weight: of normal
# errors in space one in 200 000 is. The median distance of such errors; rounds; when to stop.
_OUTLIER = 5.5
_MEDIAN_OF_CHI = {3: 1.5382, 6: 2.3126}  # of three coordinates; with three of a turn
_ROBUST_ROUNDS = 4
# Harmonics are chosen from scratch, with what the robust weights have become, at most so often:
# those chosen while outliers counted fully are a worse beginning than none.
_MAX_CHOICES = 3
_SETTLED_WEIGHT = 0.05
# Where less than this share of the poses is concerned, sums over them cost less than new ones: of
# candidates that are asked for later both are needed.
_FEW_POSES = 0.4
# Columns of the poses are kept between the rounds where they are at most so many numbers (80 MB).
_KEPT_COLUMNS, _POSES = 10_000_000, 256
# Points and turns are weighed anew by what the model leaves of them, at most so often, and until
# the ratio of their noises changes by less than this share.
_TURN_ROUNDS = 4
_SETTLED_TURNS = 0.1


class LinearOptions(NamedTuple):
    """Options of the fit, as :class:`JointHarmonicRegressor` explains them."""

    max_order: int
    orders: object
    gear_ratio: object
    gravity: bool
    kinematics: bool
    wobble: bool
    prior_sd: float | str
    loss: str
    extra: tuple = ()

    @classmethod
    def of(cls, estimator):
        """Read the options from the parameters of a `JointHarmonicRegressor`."""
        return cls(*(getattr(estimator, name) for name in cls._fields))


@stage("linear error model")
def fit_linear_model(arm, X, y, weights, codes, lengths, options, turns=None):
    """Fit the model, and fit it again without the poses that are too far off.

    Parameters
    ----------
    arm : Arm
    X : ndarray of shape (n, n_joints + n_extra)
        Angles in rad, then the extra columns.
    y : ndarray of shape (n, 3)
        Residuals in mm.
    weights : ndarray of shape (n,)
    codes : ndarray of shape (n,) or None
        Position of each row, from 0, where positions have unknown offsets.
    lengths : list of (int, int, float, float)
        Two positions, their known distance and its standard deviation, mm.
    options : LinearOptions
    turns : ndarray of shape (n, 3), default=None
        Residuals of the orientation, rotation vectors in rad.

    Returns
    -------
    model : LinearModel
    pose_weight : ndarray of shape (n,)
        What the loss left of the weight of each row: 0 for outliers.

    Raises
    ------
    ValueError
        If the options leave no columns.
    """
    extra = with_references(options.extra, X[:, arm.n_joints :], weights)
    data = FitData(arm, X, y, weights, codes, lengths, options, extra)
    model, factor, data = _fit_with_turns(data, turns)
    while (least := least_of_the_idle(model, data.idle)) is not None:
        data = data._replace(idle=data.idle | {least})
        model, factor = _fit(data)
    if np.any(factor < 1):
        noise = model.noise_variance / _share_of_noise(data.y.shape[1])
        model = replace(model, noise_variance=noise)
    return model, factor


def _share_of_noise(n):
    """What the weights of the poses leave of the noise variance, of normal errors in n coordinates.

    E[w d^2] / (n E[w]) with w = (1 - d^2 / c^2)^2 and d^2 of the chi-squared distribution; beyond
    the limit c the density is next to nothing.
    """
    c2 = _OUTLIER**2
    moment = np.cumprod([1.0, n, n + 2, n + 4])  # E[d^0], E[d^2], E[d^4], E[d^6]
    whole = moment[0] - 2 * moment[1] / c2 + moment[2] / c2**2
    return float((moment[1] - 2 * moment[2] / c2 + moment[3] / c2**2) / (n * whole))


def _fit_with_turns(data, turns):
    """Fit points, and turns where there are some, each by the noise that it shows."""
    if turns is None:
        return *_fit(data), data
    left, size = (data.y, turns), 0.0
    factor, points = np.ones(len(turns)), data.y
    for _ in range(_TURN_ROUNDS):
        weights = data.weights * factor
        rms = [np.sqrt(weights @ np.square(part).sum(axis=1)) for part in left]
        last, size = size, rms[0] / max(rms[1], 1e-12 * max(rms[0], 1e-300))
        if abs(size - last) < _SETTLED_TURNS * size:
            break
        data = data._replace(y=np.hstack([points, size * turns]), turn_mm=size)
        model, factor = _fit(data)
        left = points - model.predict(data.X)[0], turns - model.predict_turn(data.X)[0]
    return model, factor, data


def _fit(data):
    """Choose harmonics and weights by turns: the model, and the factors of the weights."""
    X, weights, options = data.X, data.weights, data.options
    offered, expected = offered_harmonics(
        X[weights > 0, : data.arm.n_joints], options.max_order, options.orders, options.gear_ratio
    )
    offer = _Offer.of(data, offered, expected)
    factor = np.ones(len(weights))
    sums = data.sums(factor, offer.terms)
    found = None
    for _ in range(_MAX_CHOICES):
        found = offer.choose(*sums, found)
        model, settled, found = _settle(data, factor, sums, found, offer)
        sums = data.sums_after(sums, factor, settled, offer.terms)
        moved, factor = np.any(settled != factor), settled
        smooth = offer.with_smooth(*sums, found)
        if smooth is not None:
            return _settle_smooth(data, factor, sums, smooth, offer)
        if not moved:
            break
    return model, factor


def _settle_smooth(data, factor, sums, found, offer):
    """Model beside a smooth function, and the weights of the poses; lines are chosen once more."""
    for rounds in (_ROBUST_ROUNDS // 2, _ROBUST_ROUNDS):
        model, settled, found = _settle(data, factor, sums, found, offer, rounds)
        if rounds < _ROBUST_ROUNDS and np.any(settled != factor):
            sums = data.sums_after(sums, factor, settled, offer.terms)
            found = offer.choose_beside_smooth(*sums, found)
        elif np.all(settled == factor):
            break
        factor = settled
    return model, settled


class FitData(NamedTuple):
    arm: Arm
    X: np.ndarray
    y: np.ndarray
    weights: np.ndarray
    codes: np.ndarray
    lengths: list
    options: LinearOptions
    extra: tuple = ()  # with references
    turn_mm: float = 0.0  # see `observed_columns`
    idle: frozenset = frozenset()  # families of it that are not worth their price

    def weighted(self, factor):
        """Rows that have weight, and positions and lengths that have such rows."""
        weights = self.weights * factor
        kept = weights > 0
        codes, lengths = self.codes, self.lengths
        if codes is not None:
            present, codes = np.unique(codes[kept], return_inverse=True)
            codes = codes.ravel()
            place = {code: i for i, code in enumerate(present.tolist())}
            lengths = [
                (place[i], place[j], *rest) for i, j, *rest in lengths if i in place and j in place
            ]
        return self.X[kept], self.y[kept], weights[kept], codes, lengths

    def sums(self, factor, terms):
        """Sums over poses with `terms.harmonics` as candidates, and known lengths."""
        X, y, weights, codes, lengths = self.weighted(factor)
        sums = candidate_sums(self.arm, X, y, weights, codes, terms.harmonics, terms, self.turn_mm)
        if not lengths:
            return sums, None
        return sums, length_equations(self.arm, X, weights, codes, terms, lengths)

    def sums_after(self, sums, old, new, terms):
        """`sums` at the factors `new`, from those at `old`: few poses are summed up again."""
        touched = old != new
        if not touched.any():
            return sums
        if self.codes is not None:
            touched = np.isin(self.codes, self.codes[touched])
        # Poses that all had no weight, or all lose it, have no sums of their own.
        empty = any(not np.any(self.weights * factor * touched) for factor in (old, new))
        if self.lengths or empty or touched.mean() > _FEW_POSES:
            return self.sums(new, terms)
        if self.codes is None:  # sums are in proportion to the weights
            poses = self.X[touched], self.y[touched], (self.weights * (new - old))[touched]
            change = candidate_sums(self.arm, *poses, None, terms.harmonics, terms, self.turn_mm)
            return sums_of_both(sums[0], change), None
        less, more = (self.sums(factor * touched, terms)[0] for factor in (old, new))
        return sums_with_other_weights(sums[0], less, more), None

    def prior_variance(self):
        """Variance of each family, NaN where it is to be found."""
        variance = np.full(len(FAMILIES) + 1, np.nan)  # the last: of a smooth function
        if not isinstance(self.options.prior_sd, str):
            variance[HARMONIC] = self.options.prior_sd**2
        variance[list(self.idle)] = IDLE_VARIANCE
        return variance


class _Offer(NamedTuple):
    """The harmonics that a fit may take, and what they cost."""

    terms: Terms  # whose harmonics are all those that are offered
    family: np.ndarray  # of the columns that are always in
    prior_variance: np.ndarray  # of each family, NaN where it is to be found
    prices: Callable
    shares: np.ndarray | None  # of a smooth function, None where it is not to be tried

    @classmethod
    def of(cls, data, offered, expected):
        options = data.options
        terms = Terms(offered, options.gravity, options.kinematics, options.wobble, data.extra)
        terms = terms._replace(target=data.turn_mm > 0)
        family = term_names(data.arm, terms)[1]
        if not len(offered) and not len(family):
            raise ValueError(
                "The model has no columns: no orders are offered and gravity, kinematics and "
                "wobble are all False."
            )
        # Not where the user has said which orders there are, or how large they are.
        free = options.orders is None and isinstance(options.prior_sd, str) and len(offered)
        shares = smooth_shares(offered[:, 1]) if free else None
        return cls(terms, family, data.prior_variance(), order_prices(offered, expected), shares)

    def choose(self, sums, lengths, last):
        """Posterior of the harmonics that are worth their price, with variances from the last."""
        known = self.family, HARMONIC, self.prior_variance, self.prices
        start = None if last is None else (last.prior_variance, last.noise_variance)
        return select_harmonics(sums, *known, lengths, start)

    def choose_beside_smooth(self, sums, lengths, last):
        """The same beside a smooth function that the last one has."""
        known = self.family, HARMONIC, self.prior_variance, self.prices
        return choose_beside_smooth(sums, *known, lengths, last, self.shares)

    def with_smooth(self, sums, lengths, found):
        """Posterior with a smooth function of each angle, or None where it is not worth it."""
        if self.shares is None:
            return None
        known = self.family, HARMONIC, self.prior_variance, self.prices
        return add_smooth(sums, *known, lengths, found, self.shares)

    def terms_of(self, found):
        return self.terms._replace(harmonics=self.terms.harmonics[found.pairs])


def constrained(model, X, weights, codes, keep_scale=True):
    """Model without what positions with offsets cannot show: the scale, and where the base stands.

    Parameters
    ----------
    model : LinearModel
    X : ndarray of shape (n, n_joints)
        Training poses.
    weights : ndarray of shape (n,)
    codes : ndarray of shape (n,) or None
        Position of each row, from 0; None where positions have no offsets.
    keep_scale : bool, default=True
        Whether no known lengths show the scale.

    Returns
    -------
    LinearModel
        The same one where positions have no offsets or it has no columns of the kinematics.
    """
    if codes is None:
        return model
    columns = mean_columns(model.arm, X, weights, codes, model.terms)
    if keep_scale and model.terms.kinematics:
        points = points_of(model.arm, X[:, : model.arm.n_joints])
        model = _keep_scale(model, columns, group_means(points, codes, weights))
    fields = place_fields(model.arm, model.terms) if keep_scale else _base_motions(model)
    return _without_gauge(model, columns, fields)


def _settle(data, factor, sums, found, offer, rounds=_ROBUST_ROUNDS):
    """Weights of the poses, and the model at these weights, harmonics being chosen.

    `sums` are those of all that is offered, at the weights `factor`.
    """
    terms = offer.terms_of(found)
    family = term_names(data.arm, terms)[1]
    shares = smooth_shares(terms.harmonics[:, 1])
    model = model_of(data, factor, found, terms)
    if data.options.loss == "squared":
        return model, factor, found
    sums, expected = (sums_of_pairs(sums[0], found.pairs), None), _expected_of(data, terms)
    for _ in range(rounds):
        old, new = factor, _pose_weights(data, expected(model), factor)
        factor = np.where(np.abs(new - old) < _SETTLED_WEIGHT, old, new)
        if np.all(factor == old):
            break
        sums = data.sums_after(sums, old, factor, terms)
        start, known = (found.prior_variance, found.noise_variance), data.prior_variance()
        found = refit(sums[0], family, HARMONIC, known, found, shares, sums[1], start)
        model = model_of(data, factor, found, terms)
    return model, factor, found


def _pose_weights(data, expected, factor):
    """Tukey's weights of the poses; those at hand where none is far off."""
    left = data.y - expected
    distance = np.linalg.norm(centred(left, data.codes, data.weights * factor), axis=1)
    used = data.weights > 0
    median = np.quantile(distance[used], 0.5, weights=data.weights[used], method="inverted_cdf")
    scale = float(median) / _MEDIAN_OF_CHI[left.shape[1]]
    limit = _OUTLIER * scale
    far = np.any((distance >= limit) & used)
    if not limit > 0 or (np.all(factor == 1) and not far):
        return factor
    share = np.square(np.minimum(distance, limit) / limit)  # of next to nothing, no overflow
    # Rows without weight keep theirs: they must not decide when the others have settled.
    return np.where(used, np.square(np.maximum(1 - share, 0.0)), factor)


def _expected_of(data, terms):
    """Rule by which models of these terms expect the residuals that they were fitted to."""
    if data.turn_mm:
        return lambda model: np.hstack(
            [model.predict(data.X)[0], data.turn_mm * model.predict_turn(data.X)[0]]
        )
    n_columns = 2 * len(terms.harmonics) + 3 * len(term_names(data.arm, terms)[0])
    if len(data.X) * n_columns > _KEPT_COLUMNS:
        return lambda model: model.predict(data.X)[0]
    parts = chunks(len(data.X), _POSES)
    kept = [factored_columns(data.arm, data.X[rows], terms) for rows in parts]
    return lambda model: np.concatenate([columns.dot(model.coef) for columns in kept])


def model_of(data, factor, found, terms):
    """Value of a posterior, with columns in the order harmonics by joint, other terms."""
    n_pairs = len(terms.harmonics)
    order = np.roll(np.arange(len(found.coef)), 2 * n_pairs)
    half = found.half[order]
    families = set(term_names(data.arm, terms)[1].tolist())
    if data.options.max_order or n_pairs:
        families.add(HARMONIC)
    prior_sd = {FAMILIES[f]: float(np.sqrt(found.prior_variance[f])) for f in sorted(families)}
    if found.smooth.any():
        prior_sd[SMOOTH] = float(np.sqrt(found.prior_variance[-1]))
    model = LinearModel(
        arm=data.arm,
        terms=terms,
        coef=found.coef[order],
        half=half,
        noise_variance=found.noise_variance,
        prior_sd=prior_sd,
        offsets=data.codes is not None,
        n_determined=found.n_determined,
        log_bayes_factor=found.gains,
        gauge_free_half=half,
        turn_mm=data.turn_mm,
    )
    X, _, weights, codes, lengths = data.weighted(factor)
    return constrained(model, X, weights, codes, keep_scale=not lengths)


def _keep_scale(model, columns, points):
    """Leave the distances between positions as the calibration has them, on the average.

    Positions with offsets do not show a common scale of all lengths, and whatever the prior
    makes of it would be an error in proportion to every length. `columns` and `points` are means
    over the positions.
    """
    spread = points - points.mean(axis=0)
    size = np.square(spread).sum()
    if not size > 0:
        return model
    scale_of = np.einsum("gc,gcp->p", spread, columns) / size
    unit = scale_direction(model.arm, model.terms)
    return replace(
        model,
        coef=model.coef - unit * (scale_of @ model.coef),
        half=model.half - np.outer(unit, scale_of @ model.half),
    )


def _base_motions(model):
    """Coefficients of the six motions of the base, (n_columns, 6)."""
    names, _ = term_names(model.arm, model.terms)
    n_waves = 2 * len(model.terms.harmonics)
    base = [n_waves + names.index(name) for name in BASE_MOTIONS if name in names]
    return np.eye(len(model.coef))[:, base]


def _without_gauge(model, columns, fields):
    """Take fields that the positions do not show out of the covariance of predictions.

    A single-point test does not show what is the same at all poses that reach a point: along such
    fields, motions of the base for one, the posterior is the prior, and other columns imitate them
    at the positions of the test. With M the mean columns over the positions and F = M W those of
    the fields W, ``G = lstsq(F, M)`` is the field in every column, and ``A - A W G`` are the
    columns without it (inner constraints).
    """
    if not fields.shape[1]:
        return model
    flat = columns.reshape(-1, columns.shape[2])
    imitated = np.linalg.lstsq(flat @ fields, flat @ model.half, rcond=1e-9)[0]
    return replace(model, gauge_free_half=model.half - fields @ imitated)
