"""The correction of a new arm that starts from those of earlier arms of the same make.

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

from copy import deepcopy
from dataclasses import replace

import numpy as np
from sklearn.base import clone

from sklearn_raacmm.calibration import REGISTERED_PLACE_MM
from sklearn_raacmm.correction._change import (
    NewPoses,
    changed_model,
    families_of,
    harmonics_of,
    judged_fading,
    parts_of,
    place_columns,
    prior_of,
    with_harmonics,
    with_low_orders,
)
from sklearn_raacmm.error_model import order_price, smooth_shares
from sklearn_raacmm.inference import log_density
from sklearn_raacmm.utils import (
    Finding,
    centred,
    one_blas_thread,
    report_findings,
)

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
_LOG_NOISE = (-4.0, 4.0)
# Of orders that are there only as parts of a smooth function the evidence is about 0; of lines at
# least their price. Half of it tells them apart, or of that of order 2 where it is free: no choice
# of a number.
_CHOSEN = 0.5


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
    prior = _pooled([model.linear_model_ for model in models], arm)
    own = clone(models[0]).set_params(arm=arm, angle_unit="rad")
    own.fit(X, y, groups=False if groups is None else groups)
    # Its calibration holds what the extra columns do in the mean of its own rows.
    of_own = own.linear_model_.terms
    prior = replace(prior, terms=prior.terms._replace(extra=of_own.extra, up=of_own.up))
    poses = NewPoses(own, X, y, groups, None)
    if not own.linear_model_.offsets:
        poses.codes = None
    linear, entry, pose_weight = changed_model(prior, poses, _LOG_NOISE)
    poses.weights = poses.weights * pose_weight * own.pose_weight_
    gain = _evidence_of_change(prior, entry, poses) - _evidence_of_fit(own.linear_model_, poses)
    new = deepcopy(own)
    fading = replace(own.fading_, factor=_FADING, most=1.0)
    fading, judgement = judged_fading(prior, poses, fading, _LOG_NOISE)
    believed = fading.most > 0 and gain > (0.0 if judgement else LEAST_GAIN_NATS)
    if believed:
        linear = replace(linear, offsets=poses.codes is not None)
        new.linear_model_ = replace(linear, fading_half=linear.gauge_free_half)
        new.fading_, new.judgement_ = fading, judgement
        new.pose_weight_ = pose_weight
    else:
        entry |= {"tau": {}, "noise_sd_mm": own.noise_sd_}
    new.updates_ = (entry | {"n_arms": len(models), "gain_nats": float(gain)},)
    code, word = ("make-believed", "") if believed else ("make-not-believed", "not ")
    said = f"The {len(models)} earlier arms of this make are {word}believed: the evidence for them "
    report_findings([Finding(code, f"{said}is {gain:.1f} nats.", weight="note")])
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
            report_findings([Finding("earlier-arm-refused", said, "Leave it out of the list.")])
        else:
            kept.append(model)
    return kept


def _families(linear):
    """What terms of several arms have to have in common."""
    names = tuple(name for name, _ in linear.terms.extra)
    return linear.terms._replace(harmonics=None, extra=names, up=())


def _pooled(linears, arm):
    """Mean and spread of several linear models, as the prior of one more arm."""
    pairs = sorted({pair for one in linears for pair in harmonics_of(one)})
    aligned = [with_harmonics(one, pairs) for one in linears]
    waves, n = 2 * len(pairs), len(aligned)
    W = np.array([one.coef for one in aligned])
    prior_sd = {
        name: float(np.sqrt(np.mean([one.prior_sd.get(name, 0.0) ** 2 for one in linears])))
        for name in linears[0].prior_sd
        if name != "smooth"
    }
    model = replace(
        aligned[0],
        arm=arm,
        log_bayes_factor=np.zeros(len(pairs)),
        prior_sd=prior_sd,
        noise_variance=float(np.median([one.noise_variance for one in linears])),
        noise_scale=1.0,
        std_scale=1.0,
        scale_sd=0.0,  # that is of known lengths of another arm
    )

    def of_pairs(squares):  # cosine and sine of a harmonic share one variance
        means = squares[:waves].reshape(-1, 2).mean(axis=1)
        return np.r_[np.repeat(means, 2), squares[waves:]]

    mean = W.mean(axis=0)
    guess = _OWN_SHARE * of_pairs(np.square(W).mean(axis=0))
    scatter = of_pairs(np.square(W - mean).sum(axis=0))
    variance = (scatter + _GUESSED_ARMS * guess) / (n - 1 + _GUESSED_ARMS)
    trust = np.zeros(len(mean))
    part = parts_of(model)
    for name in set(part.tolist()):
        of = part == name
        common = max(np.mean(np.square(mean[of]) - variance[of] / n), 0.0)
        trust[of] = common / np.maximum(common + variance[of] / n, 1e-300)
    own = np.diag(np.sqrt(variance * (1 + trust / n)))

    # Both roots together: their difference is what a single-point test does not show.
    roots = [np.vstack([one.half, one.gauge_free_half]) / np.sqrt(n) for one in aligned]
    pooled = np.linalg.qr(np.hstack([*roots, np.vstack([own, own])]).T, mode="r")
    half, gauge_free = np.vsplit(np.asarray(pooled).T, 2)
    return replace(
        model,
        coef=trust * mean,
        half=half,
        gauge_free_half=gauge_free,
        fading_half=gauge_free,
    )


def _evidence_of_change(prior, entry, poses):
    """Log evidence under the prior of the earlier arms."""
    prior = with_low_orders(prior)
    known = prior_of(prior)
    sd = np.array([entry["tau"][name] for name in known.part]) * known.size
    return _log_evidence(prior, np.hstack([known.half, np.diag(sd)]), poses, entry["noise_sd_mm"])


def _evidence_of_fit(linear, poses):
    """Log evidence of a fit to the new poses alone, less the prices of its lines."""
    orders = np.asarray(linear.terms.harmonics, dtype=int).reshape(-1, 2)[:, 1]
    sd = np.array([linear.prior_sd[name] for name in families_of(linear)])
    price, is_line = order_price(orders), np.ones(len(orders), bool)
    if "smooth" in linear.prior_sd:  # which holds all low orders, lines or not
        is_line = linear.log_bayes_factor > _CHOSEN * np.maximum(price, order_price(2))
        variance = linear.prior_sd["smooth"] ** 2 * smooth_shares(orders)
        variance += is_line * linear.prior_sd["harmonics"] ** 2
        sd[: 2 * len(orders)] = np.repeat(np.sqrt(variance), 2)
    before = replace(linear, coef=np.zeros(len(sd)))
    return _log_evidence(before, np.diag(sd), poses, linear.noise_sd) - price[is_line].sum()


def _log_evidence(linear, half, poses, noise_sd):
    """Log density of the residuals, without constants: base and tool are nearly free."""
    angles, weights, codes = poses.angles, poses.weights, poses.codes
    columns = linear.columns(angles)
    place = REGISTERED_PLACE_MM * place_columns(linear.arm, angles, with_base=codes is None)
    left = centred(poses.residuals - columns @ linear.coef, codes, weights)
    seen = centred(np.concatenate([columns @ half, place], axis=2), codes, weights)
    root = np.sqrt(weights)
    seen = (seen * root[:, None, None]).reshape(3 * len(left), -1)
    return log_density((left * root[:, None]).ravel(), seen, noise_sd, poses.n_coordinates)
