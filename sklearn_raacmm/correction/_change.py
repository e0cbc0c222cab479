"""A linear error model that has changed: conditioned on new poses, in its own columns."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from datetime import date as calendar

import numpy as np

from sklearn_raacmm.calibration import REGISTERED_PLACE_MM
from sklearn_raacmm.correction._new_poses import place_columns
from sklearn_raacmm.error_model import LEAST_POSITIONS, interval_scales, judge
from sklearn_raacmm.inference import Prior, condition, narrowed
from sklearn_raacmm.utils import centred, ignored_findings

# Bounds of the logarithm of the noise, in units of the old model's: new poses are not less noisy.
# They may lie where the model is less complete, or be of another arm, which a warning then says.
_LOG_NOISE = (0.0, 4.0)
# Noise that every measurement has, mm: without any, rounding would decide beside the millimetres
# of base and tool.
LEAST_NOISE_MM = 1e-4
# Up to this order a harmonic changes by as much as harmonics were expected to be. When all orders
# did, and the update faded, 60 poses left 0.277 mm where both rules leave 0.162
# (``benchmarks/bench_after_the_lab.py series``).
_LOW_ORDERS = 8
# Orders that every joint may show after a change, whether or not it did before; see
# `with_low_orders`.
_NEW_ORDERS = 2
# A fifth of the new poses is left out at a time. A choice, not measured.
_N_FOLDS = 5
# Poses in the range of the new ones that are tried for how much a change leaves open there: a
# number for speed.
_TRIED = 200


def changed_model(linear, poses, log_noise=_LOG_NOISE, date=None):
    """Linear model brought up to date with new poses: its posterior is the prior.

    `log_noise` bounds the logarithm of the noise in units of the old model's. Returned are the
    model, what `updates_` keeps of the change (`tau` says how much each part has changed), and
    what the loss left of the weight of each pose, (n,).
    """
    linear = with_low_orders(linear)
    arm, angles, weights, codes = linear.arm, poses.angles, poses.weights, poses.codes
    columns, place = linear.columns(angles), place_columns(arm, angles, codes is None)
    parts = columns, place, poses.residuals
    columns, place, shown = (centred(part, codes, weights) for part in parts)
    after = condition(prior_of(linear, log_noise), columns, place, shown, weights)
    seen_weights = weights * after.row_weight / after.noise_sd**2
    p, fold = len(linear.coef), _into_kinematics(linear, codes is None)
    half = after.half[:p] + fold @ after.half[p:]
    # As many columns as rows hold the same covariance.
    half = np.asarray(np.linalg.qr(half.T, mode="r")).T if half.shape[1] > p else half
    noise_scale, std_scale = interval_scales(*after.left_out, np.ones(len(after.left_out[0])))
    model = replace(
        linear,
        coef=after.mean[:p] + fold @ after.mean[p:],
        half=half,
        gauge_free_half=half,
        fading_half=_informed(linear.fading_half, columns, place, seen_weights),
        noise_variance=after.noise_sd**2,
        noise_scale=noise_scale,
        std_scale=std_scale,
        n_positions=float(len(np.unique(np.arange(len(weights)) if codes is None else codes))),
    )
    if codes is not None:  # what the same test shows at other positions in the same range
        tried = poses_in_range(angles[weights > 0], arm.n_joints)
        free = model.constrained(tried, np.ones(len(tried)), np.arange(len(tried)))
        model = replace(model, gauge_free_half=free.gauge_free_half)
    entry = {
        "date": calendar.today().isoformat() if date is None else str(date),
        "n_poses": len(angles),
        "tau": after.tau,
        "noise_sd_mm": after.noise_sd,
    }
    return model, entry, after.row_weight


def judged_fading(linear, poses, fading, positions=None, log_noise=_LOG_NOISE):
    """How much of a changed model is used, by new poses left out of the change.

    A posterior mean is shrunk by its prior already: what fades beyond the doubt at the new poses
    is compared with what fades from no doubt on, and the share that is used follows, at each fifth
    of the poses by a model that was changed without it.

    Returns the fading, and its `Judgement`; None where fewer than four positions are known.
    """
    positions = poses.positions if positions is None else positions
    labels = np.unique(positions[poses.weights > 0])
    if len(labels) < LEAST_POSITIONS:
        return fading, None
    order = np.random.default_rng(0).permutation(len(labels))
    fold = (order % min(_N_FOLDS, len(labels)))[np.searchsorted(labels, positions) % len(labels)]
    correction, doubt = np.zeros_like(poses.residuals), np.zeros(len(positions))
    with ignored_findings():  # what there is to report is reported of all poses
        for number in range(fold.max() + 1):
            out = fold == number
            rest = poses.at(~out)
            model = linear if rest.too_few else changed_model(linear, rest, log_noise)[0]
            correction[out], _, doubt[out] = model.predict_with_doubt(poses.angles[out])
    judged = poses.residuals, correction, doubt
    known = poses.weights, poses.codes, positions, fading.most
    fadings = fadings_for(fading, doubt[poses.weights > 0])
    found = [judge(*judged, one, *known) for one in fadings]
    return min(found, key=lambda one: one[1].mean_after_mm)


def fadings_for(fading, doubt):
    """Fading beyond the largest doubt at some poses, and from no doubt on."""
    return replace(fading, known_mm=float(doubt.max())), replace(fading, known_mm=0.0)


def _informed(half, columns, place, weights):
    """Root of the covariance that new poses leave of an old one.

    What they leave open of base, tool and change is no part of it: the change is shrunk to the old
    model for that already, so that it is no reason to let the whole correction fade.
    """
    root = np.sqrt(weights)[:, None, None]
    seen, free = (np.concatenate(part * root) for part in (columns, place))
    return narrowed(half, seen - free @ np.linalg.lstsq(free, seen, rcond=1e-9)[0])


def prior_of(linear, log_noise=_LOG_NOISE):
    """What is known before new poses of the coefficients of a model `with_low_orders`."""
    return Prior(
        mean=linear.coef,
        half=linear.half,
        part=parts_of(linear),
        size=_change_sizes(linear),
        free_sd=REGISTERED_PLACE_MM,
        noise_variance=max(linear.noise_variance, LEAST_NOISE_MM**2),
        log_noise=log_noise,
    )


def poses_in_range(angles, n_joints):
    """Poses whose joints stand anywhere in the ranges that some poses are from.

    Extra columns are as they were.
    """
    low, high = angles.min(axis=0), angles.max(axis=0)
    # Of n uniform numbers the extremes lie this far inside their range on the average.
    beyond = (high - low) / max(len(angles) - 1, 1)
    rng = np.random.default_rng(0)
    tried = rng.uniform(low - beyond, high + beyond, (_TRIED, angles.shape[1]))
    tried[:, n_joints:] = angles[rng.integers(len(angles), size=_TRIED), n_joints:]
    return tried


def harmonics_of(linear):
    """Joint and order of each harmonic of a model, as a list of pairs."""
    return [tuple(pair) for pair in np.asarray(linear.terms.harmonics).tolist()]


def with_harmonics(linear, pairs):
    """The same model with these harmonics among its columns: 0, and known to be, where it has none.

    `pairs` are joint and order of each, those of the model and others.
    """
    place = np.array([pairs.index(pair) for pair in harmonics_of(linear)], dtype=int)
    n_rest = len(linear.coef) - 2 * len(place)
    # Column of the new model of each column of the old one.
    waves = (2 * place[:, None] + [0, 1]).ravel()
    columns = np.r_[waves, 2 * len(pairs) + np.arange(n_rest)]

    def spread(values, at, n):
        new = np.zeros((n, *values.shape[1:]))
        new[at] = values
        return new

    names = ("coef", "half", "gauge_free_half", "fading_half")
    wider = {n: spread(getattr(linear, n), columns, 2 * len(pairs) + n_rest) for n in names}
    return replace(
        linear,
        terms=linear.terms._replace(harmonics=np.array(pairs, dtype=int).reshape(-1, 2)),
        log_bayes_factor=spread(linear.log_bayes_factor, place, len(pairs)),
        **wider,
    )


def with_low_orders(linear):
    """The same model with the orders 1 and 2 of every joint among its columns.

    What changes need not be an order that the old data needed: a knocked encoder is eccentric. More
    free orders cost more than they find (``benchmarks/bench_after_the_lab.py months``).
    """
    if "harmonics" not in linear.prior_sd:
        return linear
    wanted = {(j, k) for j in range(linear.arm.n_joints) for k in range(1, _NEW_ORDERS + 1)}
    return with_harmonics(linear, sorted({*harmonics_of(linear), *wanted}))


def families_of(linear):
    """Family of each column, (n_columns,)."""
    waves = ["harmonics"] * (2 * len(linear.terms.harmonics))
    return np.array(waves + linear.term_table()["family"].tolist())


def parts_of(linear):
    """What each column may change together with: its family, or the harmonics of one joint."""
    parts = families_of(linear).astype(object)
    joints = np.repeat(np.asarray(linear.terms.harmonics).reshape(-1, 2)[:, 0], 2)
    parts[: len(joints)] = [f"harmonics of joint {joint + 1}" for joint in joints]
    return parts


def _change_sizes(linear):
    """What a tau of 1 lets each column change by, (n_columns,).

    A low order may appear where there was none: it changes by what harmonics were expected to be
    before any data. A high one, the tooth of a gear, changes by as much as there is of it.
    """
    sizes = np.array([linear.prior_sd[name] for name in families_of(linear)])
    pairs = np.asarray(linear.terms.harmonics, dtype=int).reshape(-1, 2)
    waves = slice(0, 2 * len(pairs))
    amplitude = np.linalg.norm(linear.coef[waves].reshape(-1, 2), axis=1) / np.sqrt(2)
    high = np.repeat(pairs[:, 1] > _LOW_ORDERS, 2)
    sizes[waves] = np.where(high, np.minimum(np.repeat(amplitude, 2), sizes[waves]), sizes[waves])
    return sizes


def _into_kinematics(linear, with_base):
    """Coefficients (n_columns, 3 or 9) that do what a move of tool and base does."""
    arm, terms = linear.arm, linear.terms
    fold = np.zeros((len(linear.coef), 9 if with_base else 3))
    if not terms.kinematics:
        return fold
    angles = np.zeros((40, arm.n_joints + len(terms.extra)))  # extra columns move no kinematics
    angles[:, : arm.n_joints] = np.random.default_rng(0).uniform(-np.pi, np.pi, (40, arm.n_joints))
    of = families_of(linear) == "kinematics"
    columns = linear.columns(angles)[:, :, of]
    place = place_columns(arm, angles, with_base)
    rows = columns.shape[0] * columns.shape[1]
    fold[of] = np.linalg.lstsq(columns.reshape(rows, -1), place.reshape(rows, -1), rcond=1e-9)[0]
    return fold
