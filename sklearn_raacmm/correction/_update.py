"""A fitted correction brought up to date with few new poses, if nothing is wrong with them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from datetime import date as calendar
from functools import cache
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.correction._change import (
    LEAST_NOISE_MM,
    LOG_NOISE,
    Change,
    as_prior,
    changes_of,
    day,
    of_named,
)
from sklearn_raacmm.correction._posterior import (
    NOISE_LOG_SD,
    TAU,
    TAU_LOG_SD,
    Evidence,
    ModelWhitening,
    Posterior,
    weighted_rows,
)
from sklearn_raacmm.correction._rows import (
    REGISTERED_PLACE_MM,
    Expected,
    new_rows,
    place_columns,
    why_too_few,
)
from sklearn_raacmm.correction._suspects import named_changes
from sklearn_raacmm.error_model import LEAST_POSITIONS, ROUNDED, ArmResidualRegressor
from sklearn_raacmm.measurements import Explanation, base_motions, of_own_points
from sklearn_raacmm.utils import Finding, Groups, one_blas_thread, one_warning, param_checks

# Noise of the new poses, in units of the old one, that no arm in use comes to: five draws of
# ``benchmarks/bench_after_the_lab.py series`` have 1.0 to 1.9.
_STRANGE = 10.0
# Standard deviations of a coordinate of a probe that was knocked, and of another one, mm. A choice.
_KNOCKED_PROBE_MM, _ANOTHER_PROBE_MM = 1.0, 100.0
# Rows that are looked at, evenly from all, and how many there have to be: for speed.
_ROWS, _LEAST_ROWS = 120, 12
# Rows of which the model knows so little that less than this share of it is used say nothing.
_KNOWN_SHARE = 0.5
# Changes of the arm, in units of what was expected of it before any data.
_TAUS = np.r_[0.0, np.geomspace(0.01, 3.0, 12)]
# An arm that is another one changes by as much as an arm is expected to have.
_ANOTHER = np.geomspace(0.5, 3.0, 6)
# What a table other than the calibrated one is off by as a rule, mm and mrad; and what the
# calibrated one may be at other positions than its own.
_ANOTHER_TABLE, _CALIBRATED = 1.0, 0.1
# Of another arm all parts differ by their size, of which an update expects a tenth; and tables of
# one make by one of these, mm and mrad. Of 24 changes of simulated arms, seen by cones, another arm
# was less likely by 14 nats at least, of six other arms likelier by 58 at least.
_ALL_OF_IT, _SAME_MAKE = 10.0, (0.1, 0.3, 1.0)
# The table of an arm in use changes by less than its drawing leaves open, or any other arm of the
# make would be a change: of the parts 1, 0.3 and 0.1 this one tells both apart best, 44 nats and
# more for 20 changes, 208 and more for three other arms (two simulated arms).
_IN_USE = 0.1


@one_blas_thread
@param_checks.validate_params(
    {"date": [str, calendar, None], "accept": ["array-like", str]},
    prefer_skip_nested_validation=True,
)
@one_warning
def update_correction(
    model: ArmResidualRegressor,
    X: ArrayLike,
    y: ArrayLike,
    *,
    groups: ArrayLike | None = None,
    date: str | None = None,
    accept: str | Sequence[str] = (),
    lengths: Iterable[Sequence[object]] = (),
    features: Iterable[Sequence[object]] = (),
) -> ArmResidualRegressor:
    """Bring a fitted correction up to date with few new poses, without the old data.

    :func:`check_correction` says whether that is needed.
    Changes that the poses name, such as an offset of joint 3, one to three,
    change alone, and where nothing has changed the old model is known better. Otherwise
    coefficients change by a share tau of their prior standard deviation (a harmonic
    above order 8 by a share of its old size), base and tool by some millimetres. The evidence finds
    tau for the harmonics of each joint and for each other family of columns. With very many new
    poses the old model does not matter.

    Parameters
    ----------
    model : ArmResidualRegressor
        Fitted model; it is left as it is. With another probe ``model.with_arm(result.arm)``, of the
        registration.
    X : array-like of shape (n_samples, n_joints + n_extra)
        Joint angles of the new poses, in the model's unit; then the extra columns that it has.
    y : array-like of shape (n_samples, 3)
        Their residuals in mm, in the arm's base frame, without the correction:
        ``result.residuals(angles, points)`` of ``result = calibrate(..., correction=model,
        free=["probe"])``, or :func:`position_residuals` of a single-point test.
    groups : array-like of shape (n_samples,), default=None
        Label of the position of each sample, for the offsets of a single-point test.
    date : str, default=None
        When the new poses were measured, for the record; None: today.
    accept : str or list of str, default=()
        Codes of findings, such as "corrected-already", with which the model is handed over all the
        same.
    lengths : iterable of (label, label, length, standard deviation), default=()
        Known distances between two positions of `groups`, mm, as in :func:`calibrate`.
    features : iterable of (label, kind) or (label, kind, size, standard deviation), default=()
        As in :meth:`ArmResidualRegressor.fit`: what was touched under labels of `groups`.

    Returns
    -------
    model : ArmResidualRegressor
        To be used with the base and the tool of the registration. ``updates_`` holds a dictionary
        for every update: `date`, `n_poses`, `tau` by joint and family, `noise_sd_mm`.

    Raises
    ------
    TypeError
        If the model is no linear model: such a one can be registered, not updated.
    ValueError
        If shapes do not fit, something is NaN or infinite, or groups are missing though the model
        has offsets; if something else is likelier than that the residuals are of this arm, such as
        the wrong sign, and is not accepted.

    Warns
    -----
    UserWarning
        If there are fewer coordinates than freedoms of base and tool, in which case nothing is
        changed; if the new poses scatter about the updated model ten times as much as the
        old ones did.

    Notes
    -----
    With A the columns, w0 and S0 the old posterior, V the prior variances and B the columns of base
    and tool, ``y - A w0 = A dw + B b + e`` with ``dw ~ N(0, S0 + tau^2 V)``, b nearly free and e
    of a variance of at least the old one. The taus and that variance maximise the marginal
    likelihood times log-normal priors. Harmonics of the orders 1 and 2 are offered beside
    those that the old data needed. Where single changes explain the new rows, such as the offset of
    a joint, at most three, nothing else has changed: V is 0 but for these, and of positions b is
    left out unless the probe is one of them. Where the model has kinematic columns, b becomes a
    part of them; otherwise register again, through the updated model.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, ArmResidualRegressor, update_correction
    >>> arm = Arm.from_name("aacmm6")
    >>> rng = np.random.default_rng(0)
    >>> angles = rng.uniform(-2, 2, (400, 6))
    >>> def residuals(angles, arcsec):  # encoder 3 is eccentric
    ...     error = np.zeros_like(angles)
    ...     error[:, 2] = np.deg2rad(arcsec / 3600) * np.cos(angles[:, 2])
    ...     return np.einsum("nij,nj->ni", arm.jacobian(angles), error)
    >>> y = residuals(angles, 20) + rng.normal(scale=0.01, size=(400, 3))
    >>> model = ArmResidualRegressor(arm, orders=4).fit(angles, y)
    >>> new = rng.uniform(-2, 2, (60, 6))  # after a knock it is more so
    >>> y_new = residuals(new, 40) + rng.normal(scale=0.01, size=(60, 3))
    >>> tau = update_correction(model, new, y_new).updates_[0]["tau"]
    >>> max(tau, key=tau.get)
    'harmonics of joint 3'
    """
    rows = new_rows(model, X, y, groups, lengths, features)
    linear: Any = model.linear_model_
    updated: Any = deepcopy(model)
    expected = Expected(as_prior(linear), rows)
    if few := why_too_few(expected):
        said = f"{few}: the model is kept as it was."
        Finding("few-poses", said, "Register only, or measure more poses.").report()
        return updated
    named = named_changes(expected)
    for finding in _what_is_wrong(model, expected, named):
        finding.report()
    if np.abs(_left(model, expected)).max() <= ROUNDED * linear.arm.reach_mm:
        _as_it_was(updated, expected, date)
        return updated
    change = Change(expected, named=named)
    updated.linear_model_, entry, pose_weight = change.model(date)
    _say_if_strange(linear, entry, "updated model", "repair")
    updated.fading_, judgement = change.judged(model.fading_, rows.weights * pose_weight)
    updated.judgement_ = judgement or model.judgement_
    updated.updates_ = (*vars(model).get("updates_", ()), entry)
    return updated


def _left(model, expected):
    """What a model in use leaves of rows, (n, 3)."""
    doubt = np.linalg.norm(expected.doubts, axis=(1, 2))
    return expected.rows.y - model.fading_.share(doubt)[:, None] * expected.mean


def nothing_changed(model: ArmResidualRegressor, expected: Expected, date: object) -> bool:
    """Whether rows, with the probe as it was, show nothing but noise; `updates_` then says so.

    Noise of any size is an explanation like a change, and taken where none is clearly likelier
    (``benchmarks/bench_after_the_lab.py knocks`` has both).
    """
    if why_too_few(expected) or named_changes(expected, ["base"]) != []:
        return False
    _as_it_was(model, expected, date)
    return True


def _as_it_was(model, expected, date):
    """Note in `updates_` that rows showed noise alone."""
    rows = expected.rows
    left = rows.along(rows.whitening().centred(_left(model, expected)))
    n = expected.shown.n_coordinates - len(rows.lengths)
    noise_mm = float(np.sqrt(np.square(left).sum() / n))
    entry = {"date": day(date), "n_poses": len(left), "tau": {}, "noise_sd_mm": noise_mm}
    model.updates_ = (*vars(model).get("updates_", ()), entry)
    if _say_if_strange(model.linear_model_, entry, "correction, which stays as it was", "doubt"):
        return
    said = f"The new poses scatter by {noise_mm:.3g} mm a coordinate about the correction and show"
    Finding("nothing-changed", f"{said} no change: it stays as it was.", weight="note").report()


def _say_if_strange(linear, entry, what, weight):
    """Say that poses scatter far more about something than the old ones did, if they do."""
    noise_mm, usual_mm = entry["noise_sd_mm"], max(linear.noise_sd, LEAST_NOISE_MM)
    if noise_mm <= _STRANGE * usual_mm:
        return False
    said = (
        f"The new poses scatter by {noise_mm:.3g} mm a coordinate about the {what}, the old ones "
        f"did by {usual_mm:.3g} mm:"
    )
    advice = "are they of this arm, and residuals in its base frame, registered through the "
    Finding("strange-poses", said, f"{advice}correction?", weight, size_mm=noise_mm).report()
    return True


def probe_is_new(expected: Expected) -> bool:
    """Whether rows show another probe than the one that the model was moved to.

    One that is off by d mm is likelier a new one, ``N(0, 100^2)`` of each coordinate, than the
    same one knocked or worn, ``N(0, 1)``: from 5.3 mm on.
    """
    linear, rows = expected.linear, expected.rows
    if not linear.terms.kinematics:  # no column of the model could hold where the probe is
        return True
    place = expected.shown(place_columns(linear.arm, rows.X, with_base=rows.codes is None))
    left = expected.shown.left(rows.y - expected.mean, expected.mean)
    off = np.linalg.lstsq(place.reshape(left.size, -1), left.ravel(), rcond=1e-9)[0][:3]
    off = REGISTERED_PLACE_MM / _KNOCKED_PROBE_MM * off
    wider = _ANOTHER_PROBE_MM / _KNOCKED_PROBE_MM
    return bool(0.5 * (off @ off) * (1 - wider**-2) > 3 * np.log(wider))


def _what_is_wrong(
    model: ArmResidualRegressor, of_rows: Expected, named: Sequence[str] | None
) -> Iterator[Finding]:
    """Yield the most likely explanation of new poses, if it is likelier than that nothing is wrong.

    With r what an explanation leaves of the residuals beside the model, A the model's columns and B
    those of base and tool, ``r ~ N(B b, s^2 (A S A' + v + tau^2 A V A'))``: S is the widened
    posterior, V the variance before any data, v that of the noise, and b may be anything. As they
    are given rows may show the changes that they have `named`, too, which are larger. Its
    likelihood is the highest over s and tau times their log-normal priors: s is found in each, as
    noise that is known would prefer whatever makes residuals small. Of every explanation the
    difference to the same rows as they are given is a gain in nats; the best is said where it
    exceeds its price, beside those that are nearly as likely. Deviations of cones that are those of
    the arm's own points are of these rows and this table: the arm alone can be another one.
    """
    linear, n_joints = of_rows.linear, of_rows.linear.arm.n_joints
    numbers = np.flatnonzero(of_rows.rows.rank + np.zeros(len(of_rows.rows.X)) == 3)
    if not len(numbers):
        return
    of_rows = of_rows.at(numbers)  # touches of a surface are not of one point
    rows = of_rows.rows._replace(shown=None, unknowns=None, forms=(), lengths=())
    doubt = np.linalg.norm(of_rows.doubts, axis=(1, 2))
    as_given = False
    if rows.codes is not None:
        own = rows.y, rows.codes, linear.arm, rows.X[:, :n_joints]
        expected = model.fading_.share(doubt)[:, None] * of_rows.mean
        as_given, found = of_own_points(*own, numbers, known=expected)
        if found:
            yield from found
            return
    doubt = max(linear.std_scale, 1.0) * doubt
    used = np.flatnonzero(replace(model.fading_, most=1.0).share(doubt) >= _KNOWN_SHARE)
    if rows.codes is not None:  # a pose alone at its position shows nothing
        of_used = rows.codes[used]
        used = used[np.bincount(of_used)[of_used] > 1]
    if len(used) < _LEAST_ROWS:
        return
    of_rows, used = Expected(linear, rows).at(used), numbers[used]
    rows, expected, wider = of_rows.rows, of_rows.mean, of_rows.widened()
    given = rows.y - expected
    if _rms(given) < LEAST_NOISE_MM:  # rounding explains it
        return

    @cache  # most explanations share it
    def spread_of(some, table, changes):
        return _Spread(wider.at(np.frombuffer(some, dtype=int)), table, changes)

    every = Explanation.of_residuals(
        rows.y, expected, rows.X, n_joints, rows.codes,
        lambda angles: linear.predict(angles)[0], expected,
        base_motions(linear.arm.forward(rows.X[:, :n_joints]), linear.arm.reach_mm),
    )  # fmt: skip
    few = linear.n_positions < LEAST_POSITIONS  # of which no table is known elsewhere
    tried = islice(every, 1 if as_given else None)  # as given they are of another arm only
    fair = [one for one in tried if not (few and one.code == "other-table")]
    gains = [_gain(one, given, expected, spread_of, tuple(named or ())) for one in fair]
    likely = Explanation.likeliest(zip(gains, fair, strict=True))
    if not likely:
        nats = float("-inf") if few else _gain_of_another(of_rows, named or ())
        if nats > Explanation.PRICE:
            said = (
                f"That the new residuals, {_rms(given):.3g} mm about the model, are of another arm "
                f"is likelier by {nats:.0f} nats than that some of this one has changed."
            )
            advice = (
                "Look at the unit, order and sense of the angles, the labels, and whose arm it is."
            )
            yield Finding("another-arm", said, advice, "repair", size_mm=_rms(given))
        return
    best, *near = likely
    before, after = (_rms(left) for left in (given[best.rows], best.left))
    others = {one.code: one.said(used) for one in near[::-1] if one.code != best.code}
    yield best.finding(
        f"The new residuals leave {before:.3g} mm about the model, and {after:.3g} mm if "
        f"{best.said(used)} (likelier by {max(gains):.0f} nats)"
        f"{', or if '.join(['', *others.values()])}.",
        used,
        before,
    )


def _gain_of_another(expected, named):
    """Log evidence that the residuals are of another arm, less that this one has changed, nats.

    The noise is found in each: rows that scatter are no change. A change: ``r ~ N(B b, A S A' +
    s^2)`` as in `_what_is_wrong`, with one tau for each part, and for each of those that are
    `named`, which change by more, and the tool free or known; another arm: ``y ~ N(B b, s^2 + tau^2
    A V A' + T T')``, one tau for all parts, T what another table does.
    """
    linear, rows, shown = expected.linear, expected.rows, expected.shown
    place = place_columns(rows.arm, rows.X, rows.codes is None)
    parts = expected.columns, place, _table_columns(rows.arm, rows.X)
    columns, place, table = map(shown, parts)
    part, size = changes_of(linear)
    names, knocked = of_named(linear, part, named)
    of_change = np.where(part == "kinematics", _IN_USE, 1.0) * size
    changes = np.where(knocked > 0, names, part), np.maximum(of_change, knocked)
    after = Posterior(linear, changes, shown, columns, place, LOG_NOISE)
    weights = shown.weights * after.row_weight
    every, left = np.concatenate([columns, place, table], axis=2), shown.y - columns @ linear.coef
    flat, left = weighted_rows(every, left, weights)
    n, p, q = int(shown.rank[weights > 0].sum()) - shown.n_unknown, len(size), place.shape[2]
    own, tool, base, table = np.split(flat, [p, p + 3, p + q], axis=1)

    def of(changes, *fixed, y=left, start=None):
        given = changes, flat, np.hstack(fixed), y, linear.noise_variance, n, LOG_NOISE
        evidence = Evidence(*given)
        return -float(evidence(evidence.lowest(start))[0])

    known = own @ linear.half, base
    change = max(of(changes, *known, *free, start=after.logs) for free in ((), (tool,)))
    unknown = left + own @ linear.coef
    whole = np.full(p, "all"), _ALL_OF_IT * of_change
    tables = (of(whole, base, tool, share * table, y=unknown) for share in _SAME_MAKE)
    return max(tables) - change


def _table_columns(arm, angles):
    """What 1 mm and 1 mrad in each parameter of the table do to the probe, (n, 3, 4 n_joints)."""
    jac = arm.parameter_jacobian(angles[:, : arm.n_joints])[1][:, :, :-3]
    return jac * np.repeat([1.0, 1e-3] * 2, arm.n_joints)


def _gain(one, given, expected, spread_of, named):
    """Log likelihood of an explanation less that of the same rows as they are `given`, nats.

    Less, too, the logarithm of how many of its kind are tried. `spread_of` says the covariance of
    what is left at some rows, where changes are `named` with these; `expected` (n, 3) is what the
    model expects there, mm.
    """
    some = np.linspace(0, len(one.rows) - 1, min(_ROWS, len(one.rows))).astype(int)
    rows, other_table = one.rows[some], one.code == "other-table"
    spread = spread_of(rows.tobytes(), _ANOTHER_TABLE * other_table, ())
    taus = _ANOTHER if one.code == "another-arm" else _TAUS
    noise = 0.0
    if one.code == "rows-unrelated":  # they scatter by what the model expects of these, too
        size = np.square(spread.of(expected[rows])).sum()
        noise = 0.5 * np.log1p(size / spread.freedom)
    explained = spread.log_likelihood(one.left[some], taus, noise)
    explained += spread.freedom * np.log(one.factor)
    own = rows if one.of is None else one.of[some]  # the same residuals at their own angles
    known = {(0.0, ()), (0.0, named), (_CALIBRATED * other_table, ())}
    spreads = (spread_of(own.tobytes(), *more) for more in known)
    as_given = max(spread.log_likelihood(given[own]) for spread in spreads)
    return explained - as_given - np.log(one.n_tried)


class _Spread:
    """Covariance of the residuals of some poses about the model, along its own axes."""

    def __init__(self, expected, table, named):
        linear, rows, shown = expected.linear, expected.rows, expected.shown
        known = shown.flat(expected.spread)
        if table:
            known = np.hstack([known, shown.flat(table * _table_columns(linear.arm, rows.X))])
        if named:
            knocked = of_named(linear, changes_of(linear)[0], named)[1]
            columns = (expected.columns * knocked)[:, :, knocked > 0]
            known = np.hstack([known, shown.flat(columns)])
        place = shown.flat(place_columns(linear.arm, rows.X, rows.codes is None))
        self.shown, self.whiten = shown, ModelWhitening(known, place, shown.n_coordinates)
        self.freedom = self.whiten.freedom
        changes = self.whiten(shown.flat(expected.columns * changes_of(linear)[1]))
        size, self.axes = np.linalg.eigh(changes @ changes.T)
        self.size = np.maximum(size, 0.0)
        # Of the restricted likelihood: nuisances that are seen better cost more.
        seen = np.linalg.svd(self.whiten.scaled(place), compute_uv=False)
        seen = seen[seen > 1e-8 * seen.max()]
        self.log_volume = -self.whiten.log_root - np.log(seen).sum()
        if shown.whitened.precision is not None:
            of_places = shown.whitened.precision
            self.log_volume -= 0.5 * np.log(of_places[of_places > 0]).sum()

    def of(self, left):
        """Residuals (n, 3) over the root of their covariance."""
        return self.whiten(self.shown(left[:, :, None]).ravel() / self.shown.noise_sd)

    def log_likelihood(self, left, taus=_TAUS, noise=0.0):
        """Highest log likelihood of residuals (n, 3) over changes of the arm and the noise.

        None counts as farther from the middle of its position than some medians.
        """
        middle = Groups(self.shown.rows.codes).medians(left)
        distance = np.linalg.norm(left - middle, axis=1)
        share = np.minimum(
            1.0, Explanation.FAR * np.median(distance) / np.maximum(distance, 1e-300)
        )
        left = middle + share[:, None] * (left - middle)
        left = self.of(left)
        along = np.square(self.axes.T @ left)
        rest = max(left @ left - along.sum(), 0.0)
        wider = 1 + np.square(taus)[:, None] * self.size
        squares = rest + (along / wider).sum(axis=1)
        log_noise = 0.5 * np.log(np.maximum(squares / self.freedom, 1e-300))
        off = (log_noise - noise) / NOISE_LOG_SD
        value = -0.5 * squares * np.exp(-2 * log_noise) - self.freedom * log_noise
        value -= 0.5 * np.log(wider).sum(axis=1) + 0.5 * np.square(off)
        log_tau = np.log(np.maximum(taus, _TAUS[1]) / TAU) / TAU_LOG_SD
        return float(np.max(value - 0.5 * np.square(log_tau))) + self.log_volume


def _rms(vectors):
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean()))
