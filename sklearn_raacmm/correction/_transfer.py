"""The correction of a new arm that starts from those of earlier arms of the same make."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, clone

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import REGISTERED_PLACE_MM
from sklearn_raacmm.correction._change import (
    changed_model,
    families_of,
    harmonics_of,
    parts_of,
    prior_of,
    with_harmonics,
    with_low_orders,
)
from sklearn_raacmm.correction._new_poses import NewPoses, linear_model_of, place_columns
from sklearn_raacmm.correction._update import record_of
from sklearn_raacmm.error_model import (
    ArmResidualRegressor,
    Fading,
    LinearModel,
    order_price,
    smooth_shares,
)
from sklearn_raacmm.inference import log_density
from sklearn_raacmm.utils import Finding, centred, listed, one_blas_thread, say_findings

# Before two arms have been compared, half of the mean square of a coefficient counts as common to
# the make and half as the individual's own, as firmly as one more arm would show it. A guess that
# benchmarks/bench_transfer.py judges: it does not choose.
_OWN_SHARE, _GUESSED_ARMS = 0.5, 1.0
# Nats of evidence for the earlier arms from which on they are believed: one draw of a Panda lost a
# third at 0.5, the sixteen draws with at least 5 gained (``benchmarks/bench_transfer.py --panda``).
LEAST_GAIN_NATS = 4.0
# Factor of the fading of a believed start: Wiener's is 1, and half of it leaves as little on Pandas
# as none (``benchmarks/bench_transfer.py --panda``), for the mean of the make is known beside it.
_FADING = 0.5
# The noise of the new arm in units of the earlier arms', by a factor of 55 either way: its model
# may be better, too.
_LOG_NOISE = (-4.0, 4.0)
# Of orders that are there only as parts of a smooth function the evidence is about 0; of lines at
# least their price. Half of it tells them apart, or of that of order 2 where it is free: no choice
# of a number.
_CHOSEN = 0.5


@one_blas_thread
def transfer_correction(
    models: ArmResidualRegressor | list[Any],
    arm: Arm,
    X: ArrayLike | None = None,
    y: ArrayLike | None = None,
    *,
    groups: ArrayLike | None = None,
    sample_weight: ArrayLike | None = None,
    date: str | None = None,
) -> ArmResidualRegressor:
    """Correct a new arm from few poses, starting from earlier arms of the same make.

    The mean and the spread of their coefficients are the prior of the new arm's, where the evidence
    of the new poses is for it, against a model that is fitted to these poses alone.

    Parameters
    ----------
    models : ArmResidualRegressor or list of them
        Fitted models of earlier arms, one for each arm. They may have the same extra columns, which
        count from the mean over the rows of each arm.
    arm : Arm
        The new arm, calibrated.
    X : array-like of shape (n_samples, n_joints + n_extra), default=None
        Joint angles of the new arm, in the first model's unit; then the extra columns that the
        models have. None: it has not been measured yet.
    y : array-like of shape (n_samples, 3), default=None
        Their residuals in mm, in the arm's base frame: ``result.residuals_mm``, or
        :func:`position_residuals` of a single-point test.
    groups, sample_weight, date
        As in :func:`update_correction`.

    Returns
    -------
    model : ArmResidualRegressor
        With the options of the first model. Without poses it is the mean of the earlier arms, with
        their spread as standard deviation. ``updates_`` holds one dictionary: `date`, `n_poses`,
        `tau` and `noise_sd_mm` as of :func:`update_correction`, `n_arms`, and `gain_nats`, the
        evidence for the earlier arms; where that is less than 4, the model is the one that was
        fitted to the new poses alone, and `tau` is empty.

    Raises
    ------
    TypeError
        If `arm` is not an Arm, or a model holds no linear model in use.
    ValueError
        If there are no models, they do not fit together or to the arm, or `X` and `y` do not fit.

    Warns
    -----
    UserWarning
        If there are fewer coordinates than freedoms of base and tool, in which case the mean of the
        earlier arms is returned.

    Notes
    -----
    A coefficient w has over the earlier arms the mean m and the variance v, to which half of its
    mean square counts as one more arm; the mean is shrunk, for each family, as far as v allows
    (James and Stein). The new arm's is ``N(m, v + v / n + S)``, S the mean posterior covariance,
    and may differ from that by parts tau of what harmonics are as a rule, as in
    :func:`update_correction`. Cosine and sine of a harmonic share one variance, for phases are the
    individual's. Both models are compared by the logarithm of the marginal likelihood of `y` at
    their own variances, base and tool being free. The harmonics of the fit to the new poses alone
    are charged what each order costs in the choice; those of the earlier arms nothing.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, ArmResidualRegressor, transfer_correction
    >>> arm = Arm.from_name("aacmm6")
    >>> rng = np.random.default_rng(0)
    >>> def measured(n, phase):  # joint 3 has a gear of 30 teeth, joint 2 is eccentric
    ...     angles, error = rng.uniform(-2, 2, (n, 6)), np.zeros((n, 6))
    ...     error[:, 1] = 15 * np.cos(angles[:, 1] - phase)
    ...     error[:, 2] = 10 * np.cos(30 * angles[:, 2] - 2 * phase)
    ...     y = np.einsum("nij,nj->ni", arm.jacobian(angles), np.deg2rad(error / 3600))
    ...     return angles, y + rng.normal(scale=0.01, size=(n, 3))
    >>> options = {"orders": 40, "causes": ["kinematics"]}
    >>> earlier = [ArmResidualRegressor(arm, **options).fit(*measured(300, i)) for i in range(3)]
    >>> new = transfer_correction(earlier, arm, *measured(20, 5))
    >>> new.updates_[0]["gain_nats"] > 4
    True
    """
    models = [models] if isinstance(models, BaseEstimator) else listed("models", models)
    linears = _without_copies(_checked(models, arm))
    prior = _pooled(linears, arm)
    template = clone(models[0]).set_params(arm=arm)
    if X is None and y is None:
        return _of_prior(template, prior)
    own = template.fit(X, y, groups=groups, sample_weight=sample_weight)
    # Its calibration holds what the extra columns do in the mean of its own rows.
    prior = replace(prior, terms=prior.terms._replace(extra=own.linear_model_.terms.extra))
    groups = groups if own.linear_model_.offsets else None
    poses = NewPoses.checked(own, X, y, groups, sample_weight)
    if poses.too_few:
        said = f"{poses.too_few}: the correction is the mean of the earlier arms."
        say_findings([Finding("few-poses", said)])
        return _of_prior(own, prior)
    changed = changed_model(prior, poses, _LOG_NOISE)
    entry = record_of(changed, len(poses.angles), date)
    poses = poses._replace(weights=poses.weights * changed.pose_weight * own.pose_weight_)
    gain = _evidence_of_change(prior, changed, poses) - _evidence_of_fit(own.linear_model_, poses)
    new = deepcopy(own)
    if gain >= LEAST_GAIN_NATS:
        linear = replace(changed.model, offsets=poses.codes is not None)
        new.linear_model_ = replace(linear, fading_half=linear.gauge_free_half)
        new.fading_ = replace(own.fading_, factor=_FADING)
        new.helps_, new.judgement_ = True, None  # what was judged is the fit to the new poses alone
        new.pose_weight_ = changed.pose_weight
    else:
        entry |= {"tau": {}, "noise_sd_mm": own.noise_sd_}
    new.updates_ = (entry | {"n_arms": len(linears), "gain_nats": float(gain)},)
    return new


def _checked(models, arm):
    """Linear models of the earlier arms, which have to fit together."""
    if not isinstance(arm, Arm):
        raise TypeError(f"arm must be an Arm, got {type(arm).__name__}.")
    if not models:
        raise ValueError("models are empty: give the fitted models of one earlier arm or more.")
    linears = [linear_model_of(model, "transferred") for model in models]
    for i, linear in enumerate(linears):
        old, new = ((a.n_joints, a.convention) for a in (linear.arm, arm))
        if old != new:
            raise ValueError(
                f"models[{i}] is of an arm with {old[0]} joints in the {old[1]} convention; the "
                f"new arm has {new[0]} in the {new[1]} one."
            )
        if _families(linear.terms) != _families(linears[0].terms):
            raise ValueError(
                f"models[{i}] has other families of columns than models[0]: fit all with the same "
                "causes and extra columns."
            )
    return linears


def _without_copies(linears):
    """Each linear model once: two copies of an arm are no two arms."""
    kept: list[LinearModel] = []
    for linear in linears:
        if not any(np.array_equal(one.coef, linear.coef) for one in kept):
            kept.append(linear)
    if len(kept) < len(linears):
        said = f"Of {len(linears)} models {len(linears) - len(kept)} are copies: they count once."
        say_findings([Finding("copied-models", said)])
    return kept


def _families(terms):
    """What terms of several arms have to have in common."""
    return terms._replace(harmonics=None, extra=tuple(name for name, _ in terms.extra))


def _of_prior(estimator, prior):
    """Fitted estimator that knows nothing but the earlier arms."""
    new = deepcopy(estimator)
    new.linear_model_, new.fading_ = prior, Fading(0.0, 0.0)
    new.helps_, new.judgement_ = True, None
    new.n_features_in_ = prior.arm.n_joints + len(prior.terms.extra)
    new.pose_weight_ = np.empty(0)
    return new


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
        terms=aligned[0].terms._replace(extra=_mean_references(linears)),
        log_bayes_factor=np.zeros(len(pairs)),
        prior_sd=prior_sd,
        noise_variance=float(np.median([one.noise_variance for one in linears])),
        noise_scale=1.0,
        std_scale=1.0,
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

    def pooled_root(roots):
        return np.asarray(
            np.linalg.qr(np.hstack([*(r / np.sqrt(n) for r in roots), own]).T, mode="r")
        ).T

    gauge_free = pooled_root([one.gauge_free_half for one in aligned])
    return replace(
        model,
        coef=trust * mean,
        half=pooled_root([one.half for one in aligned]),
        gauge_free_half=gauge_free,
        fading_half=gauge_free,
    )


def _mean_references(linears):
    """Extra columns, counted from the mean over the arms: for an arm that was not measured yet."""
    names = [name for name, _ in linears[0].terms.extra]
    values = np.mean([[by[0] for _, by in one.terms.extra] for one in linears], axis=0)
    return tuple((name, (value,)) for name, value in zip(names, values.tolist(), strict=True))


def _evidence_of_change(prior, changed, poses):
    """Log evidence under the prior of the earlier arms."""
    prior = with_low_orders(prior)
    known = prior_of(prior)
    sd = np.array([changed.tau[name] for name in known.part]) * known.size
    return _log_evidence(prior, np.hstack([known.half, np.diag(sd)]), poses, changed.noise_sd)


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
