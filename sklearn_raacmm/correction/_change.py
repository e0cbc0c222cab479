"""New poses of a fitted model, the linear model that they change, and a new arm of a known make.

A coefficient w has over the earlier arms the mean m and the variance v, to which half of its mean
square counts as one more arm; the mean is shrunk, for each family, as far as v allows (James and
Stein). The new arm's is ``N(m, v + v / n + S)``, S the mean posterior covariance, and may differ
from that by parts tau of what harmonics are as a rule, as in an update. Cosine and sine of a
harmonic share one variance, for phases are the individual's. Against a fit to the new poses alone
it is compared by the logarithm of the marginal likelihood of the residuals at their own variances,
base and tool being free. The harmonics of that fit are charged what each order costs in the choice;
those of the earlier arms nothing.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from datetime import date as calendar
from typing import Any

import numpy as np
from sklearn.base import clone

from sklearn_raacmm.correction._posterior import ModelWhitening, Posterior, narrowed, thin
from sklearn_raacmm.correction._rows import (
    Expected,
    new_rows,
    place_columns,
    positions_of,
    why_too_few,
)
from sklearn_raacmm.error_model import (
    FAMILIES,
    LEAST_POSITIONS,
    NOTHING_SEEN,
    interval_scales,
    judge,
    order_price,
    smooth_shares,
)
from sklearn_raacmm.utils import Finding, Groups, one_blas_thread

# Bounds of the logarithm of the noise, in units of the old model's: new poses are not less noisy.
# They may lie where the model is less complete, or be of another arm, which a warning then says.
LOG_NOISE = (0.0, 4.0)
# Noise that every measurement has, mm: without any, rounding would decide beside the millimetres
# of base and tool.
LEAST_NOISE_MM = 1e-4
# Up to this order a harmonic changes by as much as harmonics were expected to be. When all orders
# did, and the update faded, 60 poses left 0.277 mm where both rules leave 0.162
# (``benchmarks/bench_after_the_lab.py series``).
_LOW_ORDERS = 8
# Orders that every joint may show after a change, whether or not it did before; see
# `as_prior`.
_NEW_ORDERS = 2
# What a named change of one joint comes to at a tau of 1, arc seconds: a choice.
_KNOCK_ARCSEC = 100.0
# A fifth of the new poses is left out at a time. A choice, not measured.
_N_FOLDS = 5
# Before two arms have been compared, half of the mean square of a coefficient counts as common to
# the make and half as the individual's own, as firmly as one more arm would show it. A guess that
# ``benchmarks/bench_after_the_lab.py transfer`` judges: it does not choose.
_OWN_SHARE, _GUESSED_ARMS = 0.5, 1.0
# Nats of evidence for the earlier arms from which on they are believed where too few positions can
# be left out for a share: one draw of a Panda lost a third at 0.5, the sixteen draws with at least
# 5 gained (``benchmarks/bench_after_the_lab.py transfer --panda``).
LEAST_GAIN_NATS = 4.0
# Factor of the fading of a believed start: Wiener's is 1, and half of it leaves as little on Pandas
# as none (``benchmarks/bench_after_the_lab.py transfer --panda``), for the mean of the make is
# known beside it.
_FADING = 0.5
# The noise of the new arm in units of the earlier arms', by a factor of 55 either way: its model
# may be better, too.
_LOG_NOISE_OF_MAKE = (-4.0, 4.0)
# Of orders that are there only as parts of a smooth function the evidence is about 0; of lines at
# least their price. Half of it tells them apart, or of that of order 2 where it is free: no choice
# of a number.
_CHOSEN = 0.5


def day(date):
    """A date as text; of None, today."""
    return calendar.today().isoformat() if date is None else str(date)


class Change:
    """A linear model brought up to date with new rows: its posterior is their prior.

    `expected` is what the model expects of the rows, by its columns of `as_prior`. `log_noise`
    bounds the logarithm of the noise in units of the old model's. Where changes are `named`, no
    others are there: see `of_named`. `positions` (n,) are left out together.
    """

    def __init__(self, expected, log_noise=LOG_NOISE, named=None, positions=None):
        self.expected, self.log_noise = expected, log_noise
        linear, rows = expected.linear, expected.rows
        self.positions = positions_of(rows) if positions is None else positions
        self.place = place_columns(linear.arm, rows.X, rows.codes is None)
        self.changes = changes_of(linear)
        if named is not None:
            self.changes = of_named(linear, self.changes[0], named)
            if "probe" not in named and rows.codes is not None:
                self.place = self.place[:, :, :0]
        self.fold = _into_kinematics(linear, self.place.shape[2])
        self.ended: Any = None  # where the search of all rows ended

    def model(self, date: object = None) -> tuple[Any, Any, Any]:
        """The model, what `updates_` keeps of the change, and what is left of the weights, (n,).

        `tau` says how much each part has changed.
        """
        linear, rows = self.expected.linear, self.expected.rows
        coef, seen, after = self._conditioned(self.expected, self.place)
        self.ended = after.logs
        errors, noise, std = after.left_out()
        # Until new poses say otherwise errors exceed what is expected as those of the old model do.
        logs = 2 * np.log(np.maximum([linear.std_scale, linear.noise_scale], 1.0))
        scales = interval_scales(errors, noise, std, np.ones(len(errors)), 1.0, *logs)
        noise_scale, std_scale = scales
        p = len(coef)
        model = replace(
            linear.with_noise(after.noise_sd**2),
            coef=coef,
            half=after.half[:p] + self.fold @ after.half[p:],
            seen=NOTHING_SEEN,
            informed_half=narrowed(linear.fading_half, seen),
            noise_scale=noise_scale,
            std_scale=std_scale,
            n_positions=float(len(np.unique(self.positions))),
        )
        if rows.codes is not None:  # what the same test shows at other positions in the same range
            model = (model if rows.lengths else model.with_scale_of(linear)).with_seen()
        entry = {
            "date": day(date),
            "n_poses": len(rows.X),
            "tau": after.tau,
            "noise_sd_mm": after.noise_sd,
        }
        return model, entry, after.row_weight[: len(rows.X)]

    def judged(self, fading: Any, weights: np.ndarray) -> tuple[Any, Any]:
        """How much of the changed model is used, by rows of `weights` (n,) left out of the change.

        A posterior mean is shrunk by its prior already: it fades beyond the largest doubt at the
        new poses. The share that is used follows at each fifth of them by a model that was changed
        without it, from where the search of all ended.

        Returns the fading, and its `Judgement`; None where fewer than four positions are known, of
        a model that was of no use fewer than two.
        """
        rows, used = self.expected.rows._replace(weights=weights), weights > 0
        expected = Expected(self.expected.linear, rows)
        labels = np.unique(self.positions[used])
        # A share of 0 was found for what there was before the change: two positions may end it.
        if len(labels) < (LEAST_POSITIONS if fading.most > 0 else 2):
            return fading, None
        order = np.random.default_rng(0).permutation(len(labels))
        of_label = np.searchsorted(labels, self.positions) % len(labels)
        fold = (order % min(_N_FOLDS, len(labels)))[of_label]
        correction, doubts = expected.mean.copy(), expected.doubts.copy()
        with Finding.ignored():  # what there is to report is reported of all poses
            for number in range(fold.max() + 1):
                out = fold == number
                rest = expected.at(~out & used)
                if not why_too_few(rest):
                    coef, seen, _ = self._conditioned(rest, self.place[~out & used])
                    correction[out] = expected.columns[out] @ coef
                    flat = doubts[out].reshape(-1, doubts.shape[2])
                    doubts[out] = narrowed(flat, seen).reshape(doubts[out].shape)
        doubt = np.linalg.norm(doubts, axis=(1, 2))
        fading = replace(fading, known_mm=float(doubt[used].max()))
        before = float(fading.found(doubt[used]).mean())
        known = weights, rows.centre, self.positions, before
        return judge(rows.y, correction, doubt, fading, *known)

    def _conditioned(self, expected, place):
        """Coefficients, what rows show of the root of the fading, and the `Posterior`.

        What new rows leave open of base, tool and change is no reason to let the whole correction
        fade: the change is shrunk to the old model for that already.
        """
        linear, shown, p = expected.linear, expected.shown, len(expected.linear.coef)
        columns, doubts, place = map(shown, (expected.columns, expected.doubts, place))
        given = shown, columns, place, self.log_noise, self.ended
        after = Posterior(linear, self.changes, *given)
        root = np.sqrt(shown.weights * after.row_weight)[:, None, None] / after.noise_sd
        seen, free = (np.concatenate(part * root) for part in (doubts, place))
        seen = seen - free @ np.linalg.lstsq(free, seen, rcond=1e-9)[0]
        return after.mean[:p] + self.fold @ after.mean[p:], seen, after


def harmonics_of(linear):
    """Joint and order of each harmonic of a model, as a list of pairs."""
    return [*map(tuple, linear.terms.harmonics.tolist())]


def with_harmonics(linear, pairs):
    """The same model with these harmonics among its columns: 0, and known to be, where it has none.

    `pairs` are joint and order of each, those of the model and others.
    """
    place = np.array([pairs.index(pair) for pair in harmonics_of(linear)], dtype=int)
    # Column of the new model of each column of the old one.
    others = np.arange(2 * len(place), len(linear.coef)) + 2 * (len(pairs) - len(place))
    columns = np.r_[(2 * place[:, None] + [0, 1]).ravel(), others]

    def spread(values, at, n):
        new = np.zeros((n, *values.shape[1:]))
        new[at] = values
        return new

    n_new = len(columns) + 2 * (len(pairs) - len(place))
    roots = {name: getattr(linear, name) for name in ("coef", "half", "informed_half")}
    wider = {n: spread(root, columns, n_new) for n, root in roots.items() if root is not None}
    return replace(
        linear,
        layout=linear.layout.with_harmonics(np.array(pairs, dtype=int)),
        log_bayes_factor=spread(linear.log_bayes_factor, place, len(pairs)),
        **wider,
    )


def as_prior(linear):
    """The same model with some noise, and the orders 1 and 2 of every joint among its columns.

    What changes need not be an order that the old data needed: a knocked encoder is eccentric. More
    free orders cost more than they find (``benchmarks/bench_after_the_lab.py months``).
    """
    linear = linear.with_noise(max(linear.noise_variance, LEAST_NOISE_MM**2))
    if "harmonics" not in linear.prior_sd:
        return linear
    wanted = {(j, k) for j in range(linear.arm.n_joints) for k in range(1, _NEW_ORDERS + 1)}
    return with_harmonics(linear, sorted({*harmonics_of(linear), *wanted}))


def parts_of(linear, name="harmonics of joint {}"):
    """What each column may change together with: its family, or the harmonics of one joint."""
    waves = [name.format(j + 1) for j, _ in harmonics_of(linear) for _ in range(2)]
    return np.array(waves + [FAMILIES[column.family] for column in linear.layout.others])


def _prior_sds(linear):
    """Standard deviation of each coefficient before any data, by its family, (n_columns,)."""
    return np.array([linear.prior_sd[name] for name in parts_of(linear, "harmonics")])


def changes_of(linear):
    """What each column may change together with, and by how much at a tau of 1, (n_columns,) each.

    A low order may appear where there was none: it changes by what harmonics were expected to be
    before any data. A high one, the tooth of a gear, changes by as much as there is of it.
    """
    sizes = _prior_sds(linear)
    orders = linear.terms.harmonics[:, 1]
    waves = slice(0, 2 * len(orders))
    amplitude = np.linalg.norm(linear.coef[waves].reshape(-1, 2), axis=1) / np.sqrt(2)
    most = np.repeat(np.where(orders > _LOW_ORDERS, amplitude, np.inf), 2)
    sizes[waves] = np.minimum(sizes[waves], most)
    return parts_of(linear), sizes


def of_named(linear, part, named):
    """What columns may change together with, and by how much, if none but these changes are there.

    A knock turns the zero of a joint, or makes its encoder eccentric, by more than errors of an arm
    as a rule are; waves of order 2 are smaller.
    """
    orders = np.repeat(linear.terms.harmonics[:, 1], 2)
    part = with_names(linear, part)
    sizes = np.full(len(part), _KNOCK_ARCSEC)
    sizes[: len(orders)] *= np.where(orders > _NEW_ORDERS, 0.0, orders**-2.0)
    return part, np.where(np.isin(part, named), sizes, 0.0)


def with_names(linear, part):
    """Parts (n_columns,), of which offsets and probe have the names of `causes_of`."""
    part = part.astype("U32")
    for i, name in enumerate(linear.layout.names, start=linear.layout.n_waves):
        field = name.rstrip("0123456789")
        slides = name[len(field) :] in [str(j + 1) for j in linear.arm.slides]
        if field == ("d" if slides else "theta_offset"):
            part[i] = f"offset of joint {name.removeprefix(field)}"
        elif field == "scale":
            part[i] = f"scale of joint {name.removeprefix(field)}"
        elif name.startswith("probe") and part[i] == "kinematics":
            part[i] = "probe"
    return part


def doubts_of(linear, angles, codes=None):
    """Share of what is not known of points at some poses that is of each part, the largest first.

    Of the variance of all coordinates, in a single-point test about their positions: what a part
    has in common with others is halved between them, so that all shares are 1 together.
    """
    half = linear.gauge_free_half
    columns = Groups(codes).centred(linear.columns(angles))
    shares = np.einsum("ncp,ncp->p", columns, columns @ half @ half.T)
    part, place = np.unique(with_names(linear, parts_of(linear)), return_inverse=True)
    shares = np.bincount(place, shares) / max(shares.sum(), 1e-300)
    return {str(part[i]): float(shares[i]) for i in np.argsort(-shares, kind="stable")}


def _into_kinematics(linear, n_free):
    """Coefficients (n_columns, n_free) that do what a move of the tool, and of the base, does."""
    arm, terms = linear.arm, linear.terms
    fold = np.zeros((len(linear.coef), n_free))
    if not (terms.kinematics and n_free):
        return fold
    angles = np.zeros((40, arm.n_joints + len(terms.extra)))  # extra columns move no kinematics
    angles[:, : arm.n_joints] = arm.random_poses(40)
    of = parts_of(linear) == "kinematics"
    columns = linear.columns(angles)[:, :, of]
    place = place_columns(arm, angles, n_free > 3)
    rows = columns.shape[0] * columns.shape[1]
    fold[of] = np.linalg.lstsq(columns.reshape(rows, -1), place.reshape(rows, -1), rcond=1e-9)[0]
    return fold


@one_blas_thread
def transferred_model(models, arm, X, y, groups=None):
    """Model of a new arm that starts from earlier arms of its make, if the evidence is for them.

    `models` are fitted ArmResidualRegressors of these, `X` the angles of the calibrated new arm in
    rad with its extra columns, `y` its residuals. The model has the options of the first of them;
    ``updates_`` holds one dictionary, with `n_arms` and `gain_nats`, and an empty `tau` where the
    earlier arms are not believed. None if there is no arm that it could start from.
    """
    models = _suitable_models(models, arm, X.shape[1])
    if not models:
        return None
    new = clone(models[0]).set_params(arm=arm, angle_unit="rad")
    new.fit(X, y, groups=False if groups is None else groups)
    own = new.linear_model_
    # Its calibration holds what the extra columns do in the mean of its own rows.
    prior = as_prior(_pooled([model.linear_model_ for model in models], own.layout))
    rows = new_rows(new, X, y, groups)
    positions = positions_of(rows)
    rows = rows if own.offsets else rows._replace(codes=None)
    change = Change(Expected(prior, rows), _LOG_NOISE_OF_MAKE, positions=positions)
    linear, entry, pose_weight = change.model()
    weights = pose_weight * new.pose_weight_
    rows = rows.weighted(weights)
    part, size = changes_of(prior)
    sd = np.array([entry["tau"][name] for name in part]) * size
    known = prior, np.hstack([prior.half, np.diag(sd)]), rows, entry["noise_sd_mm"]
    gain = _log_evidence(*known) - _evidence_of_fit(own, rows)
    fading = replace(new.fading_, factor=_FADING, most=1.0, far=1.0)
    fading, judgement = change.judged(fading, weights)
    believed = fading.most > 0 and gain > (0.0 if judgement else LEAST_GAIN_NATS)
    if believed:
        new.linear_model_ = replace(linear, offsets=own.offsets, informed_half=None)
        new.fading_, new.judgement_, new.pose_weight_ = fading, judgement, pose_weight
    else:
        entry |= {"tau": {}, "noise_sd_mm": own.noise_sd}
    new.updates_ = (entry | {"n_arms": len(models), "gain_nats": float(gain)},)
    code, word = ("make-believed", "") if believed else ("make-not-believed", "not ")
    said = f"The {len(models)} earlier arms of this make are {word}believed: the evidence for them "
    Finding(code, f"{said}is {gain:.1f} nats.", weight="note").report()
    return new


def _suitable_models(models, arm, n_columns):
    """Those that a new arm can start from; the others are named with the reason."""
    kept: list = []
    for number, model in enumerate(models, start=1):
        linear, why = getattr(model, "linear_model_", None), ""
        if linear is None:
            why = f"{type(model).__name__} holds no linear model"
        elif (linear.arm.n_joints, linear.arm.convention) != (arm.n_joints, arm.convention):
            why = "it has other joints, or another convention, than the new arm"
        elif arm.n_joints + len(linear.terms.extra) != n_columns:
            why = "it has other causes beside the angles than the new arm"
        elif kept and _families(linear) != _families(kept[0].linear_model_):
            why = "it has other families of columns than the first: fit all with the same causes"
        elif any(np.array_equal(one.linear_model_.coef, linear.coef) for one in kept):
            why = "it is a copy of another, and two copies are no two arms"
        if why:
            said = f"Earlier arm {number} of {len(models)} is passed over: {why}."
            Finding("earlier-arm-refused", said, "Leave it out of the list.").report()
        else:
            kept.append(model)
    return kept


def _families(linear):
    """What terms of several arms have to have in common."""
    names = tuple(name for name, _ in linear.terms.extra)
    return linear.terms._replace(harmonics=None, extra=names, up=())


def _pooled(linears, layout):
    """Mean and spread of several linear models, as the prior of one more arm of a layout."""
    pairs = sorted({pair for one in linears for pair in harmonics_of(one)})
    aligned = [with_harmonics(one, pairs) for one in linears]
    waves, n = 2 * len(pairs), len(aligned)
    W = np.array([one.coef for one in aligned])
    prior_sd = {
        name: float(np.sqrt(np.mean([one.prior_sd.get(name, 0.0) ** 2 for one in linears])))
        for name in linears[0].prior_sd
        if name != "smooth"
    }

    def of_pairs(squares):  # cosine and sine of a harmonic share one variance
        means = squares[:waves].reshape(-1, 2).mean(axis=1)
        return np.r_[np.repeat(means, 2), squares[waves:]]

    mean = W.mean(axis=0)
    guess = _OWN_SHARE * of_pairs(np.square(W).mean(axis=0))
    scatter = of_pairs(np.square(W - mean).sum(axis=0))
    variance = (scatter + _GUESSED_ARMS * guess) / (n - 1 + _GUESSED_ARMS)
    trust = np.zeros(len(mean))
    part = parts_of(aligned[0])
    # What a calibration leaves of the table is nothing of the make: its prior is the drawing's.
    of_table = part == "kinematics"
    variance[of_table] = prior_sd.get("kinematics", 0.0) ** 2
    for name in set(part[~of_table].tolist()):
        of = part == name
        common = max(np.mean(np.square(mean[of]) - variance[of] / n), 0.0)
        trust[of] = common / np.maximum(common + variance[of] / n, 1e-300)
    own = np.diag(np.sqrt(variance * (1 + trust / n)))

    kept = np.where(of_table, 0.0, 1 / np.sqrt(n))[:, None]
    half = np.hstack([*(kept * one.half for one in aligned), own])
    low, high = zip(*(one.ranges for one in linears), strict=True)
    noise = float(np.median([one.noise_variance for one in linears]))
    prior = replace(
        aligned[0].with_noise(noise),
        layout=layout.with_harmonics(np.array(pairs, dtype=int)),
        coef=trust * mean,
        half=thin(half),
        ranges=np.array([np.min(low, axis=0), np.max(high, axis=0)]),
        informed_half=None,
        log_bayes_factor=np.zeros(len(pairs)),
        prior_sd=prior_sd,
        noise_scale=1.0,
        std_scale=1.0,
    )
    return prior.with_seen() if len(prior.seen) else prior


def _evidence_of_fit(linear, rows):
    """Log evidence of a fit to the new rows alone, less the prices of its lines."""
    orders = linear.terms.harmonics[:, 1]
    sd = _prior_sds(linear)
    price, is_line = order_price(orders), np.ones(len(orders), bool)
    if "smooth" in linear.prior_sd:  # which holds all low orders, lines or not
        is_line = linear.log_bayes_factor > _CHOSEN * np.maximum(price, order_price(2))
        variance = linear.prior_sd["smooth"] ** 2 * smooth_shares(orders)
        variance += is_line * linear.prior_sd["harmonics"] ** 2
        sd[: 2 * len(orders)] = np.repeat(np.sqrt(variance), 2)
    before = replace(linear, coef=np.zeros(len(sd)))
    return _log_evidence(before, np.diag(sd), rows, linear.noise_sd) - price[is_line].sum()


def _log_evidence(linear, half, rows, noise_sd):
    """Log density of the residuals, without constants: base and tool are nearly free."""
    columns, whitened = linear.columns(rows.X), rows.whitening()
    place = place_columns(linear.arm, rows.X, with_base=rows.codes is None)
    left = (rows.y - columns @ linear.coef)[:, :, None]
    every = whitened.deviations(np.concatenate([left, columns @ half, place], axis=2))
    left, *seen = every.reshape(-1, every.shape[2]).T / noise_sd
    n = 3 * (len(rows.X) - (0 if rows.codes is None else rows.codes.max() + 1))
    whiten = ModelWhitening(np.transpose(seen), np.zeros((len(left), 0)), n)
    square = float(np.square(whiten(left)).sum())
    return -0.5 * square - whiten.log_root - n * float(np.log(noise_sd))
