"""The correction of a new arm that starts from those of earlier arms of the same make."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from copy import deepcopy
from dataclasses import replace

import numpy as np
from sklearn.base import clone
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.correction._linear_change import (
    PLACE_MM,
    NewPoses,
    changed_model,
    families_of,
    n_coordinates,
    parts_of,
    place_columns,
    prior_half,
)
from sklearn_raacmm.correction._update import check_new_poses, linear_model_of, record_of
from sklearn_raacmm.error_model import (
    ArmResidualRegressor,
    Fading,
    smooth_shares,
)
from sklearn_raacmm.utils import centred, listed, one_blas_thread

# Before two arms have been compared, half of the mean square of a coefficient counts as common to
# the make and half as the individual's own, as firmly as one more arm would show it.
_OWN_SHARE, _GUESSED_ARMS = 0.5, 1.0
# The noise of the new arm in units of the earlier arms': its model may be better, too.
_LOG_NOISE = (-4.0, 4.0)
# Orders that a new fit has to choose from, for each joint: the price of a choice is the logarithm.
_OFFERED = 72
# Of orders that are there only as parts of a smooth function the evidence is about 0; of chosen
# ones at least their price. Half of it tells them apart.
_CHOSEN = 0.5


@one_blas_thread
def transfer_correction(models, arm, X=None, y=None, *, groups=None, sample_weight=None, date=None):
    """Correct a new arm from few poses, starting from earlier arms of the same make.

    Arms of one make share the orders of their gears, the compliance of their links and the size of
    their eccentricities. The mean and the spread of the earlier models' coefficients are the prior
    of the new arm's. Whether they are believed is decided by the evidence of the new poses, against
    a model that is fitted to these poses alone.

    Parameters
    ----------
    models : ArmResidualRegressor, or list of them
        Fitted models of earlier arms, one for each arm. Their linear models are used. They may
        have the same extra columns: what a degree or a newton does is common to the make, and
        counts from the mean over the rows of each arm. The numbers of tools are not: they must not
        be among them.

    arm : Arm
        The new arm, calibrated: ``result.arm`` of ``result = calibrate(nominal, angles,
        points=points)``.

    X : array-like of shape (n_samples, n_joints + n_extra), default=None
        Joint angles of the new arm, in the unit that the first of the models takes; then the extra
        columns that the models were fitted with. None: it has not been measured yet.

    y : array-like of shape (n_samples, 3), default=None
        Their residuals in mm, in the arm's base frame: ``result.residuals_mm``, or
        :func:`position_residuals` of a single-point test.

    groups : array-like of shape (n_samples,), default=None
        Label of the position of each sample, for the offsets of a single-point test.

    sample_weight : array-like of shape (n_samples,), default=None
        Weights. Poses that lie far off are left out by themselves.

    date : str, default=None
        When the new poses were measured, for the record; None: today.

    Returns
    -------
    model : ArmResidualRegressor
        With the options of the first model. Without poses it is the mean of the earlier arms, with
        their spread as standard deviation. ``updates_`` holds one dictionary: `date`, `n_poses`,
        `tau` and `noise_sd_mm` as of :func:`update_correction`, `n_arms`, and `gain_nats`, the
        evidence for the earlier arms; where that is not positive, the model is the one that was
        fitted to the new poses alone, and `tau` is empty.

    Raises
    ------
    TypeError
        If `arm` is not an Arm, or a model holds no linear model in use.
    ValueError
        If there are no models, the arms have other numbers of joints or conventions, the models
        have tools among their extra columns or are not of the same families; if `X` and `y` do not
        fit.

    Warns
    -----
    UserWarning
        If there are fewer coordinates than freedoms of base and tool, in which case the mean of the
        earlier arms is returned.

    See Also
    --------
    update_correction : Brings the model of one arm up to date.

    Notes
    -----
    A coefficient w has over the earlier arms the mean m and the variance v, to which half of its
    mean square counts as one more arm; the mean is shrunk, for each family, as far as v allows
    (James and Stein). The new arm's is ``N(m, v + v / n + S)``, S the mean posterior covariance,
    and may differ from that by parts tau of what harmonics are as a rule, as in
    :func:`update_correction`. Cosine and sine of a harmonic share one variance, for phases are the
    individual's. Both models are compared by the logarithm of the marginal likelihood of `y` at
    their own variances, base and tool being free. The harmonics of the fit to the new poses alone
    are charged the logarithm of the number of those offered, but orders 1 and 2 nothing, as in the
    choice; nor are those of the earlier arms.

    It is a function and not an option of `fit`: what it needs is fitted models, which neither a
    clone nor a search over parameters should carry along.

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
    >>> options = {"max_order": 40, "gravity": False, "wobble": False}
    >>> earlier = [ArmResidualRegressor(arm, **options).fit(*measured(300, i)) for i in range(3)]
    >>> few, far = measured(20, 5), measured(300, 5)
    >>> new = transfer_correction(earlier, arm, *few)
    >>> alone = ArmResidualRegressor(arm, **options).fit(*few)
    >>> left = [np.abs(far[1] - m.predict(far[0])).mean() for m in (alone, new)]
    >>> bool(left[1] < 0.7 * left[0])
    True
    """
    linears, template = _checked(models, arm)
    prior = _pooled(linears, arm)
    template.set_params(arm=arm)
    if X is None and y is None:
        return _of_prior(template, prior)
    own = template.fit(X, y, groups=groups, sample_weight=sample_weight)
    # Its calibration holds what the extra columns do in the mean of its own rows.
    prior = replace(prior, terms=prior.terms._replace(extra=own.linear_model_.terms.extra))
    groups = groups if own.linear_model_.offsets else None
    angles, residuals, weights, codes = check_new_poses(own, X, y, groups, sample_weight)
    poses = NewPoses(angles, residuals, weights, codes)
    n_free = 9 if codes is None else 3
    if n_coordinates(poses) <= n_free:
        warnings.warn(
            f"{len(angles)} new poses give {n_coordinates(poses)} coordinates, fewer than would "
            f"show more than the {n_free} freedoms of base and tool: the correction is the mean of "
            "the earlier arms.",
            UserWarning,
            stacklevel=3,
        )
        return _of_prior(own, prior)
    changed = changed_model(prior, poses, _LOG_NOISE)
    poses = poses._replace(weights=weights * changed.pose_weight * own.pose_weight_)
    gain = _evidence_of_change(prior, changed, poses) - _evidence_of_fit(own.linear_model_, poses)
    new = deepcopy(own)
    entry = record_of(changed, len(angles), date)
    if gain > 0:
        new.linear_model_ = replace(changed.model, offsets=codes is not None)
        new.pose_weight_ = changed.pose_weight
        # Where the new poses say nothing, the mean of the make stands.
        new.fading_ = replace(own.fading_, factor=0.0)
    else:
        entry |= {"tau": {}, "noise_sd_mm": own.noise_sd_}
    new.updates_ = (entry | {"n_arms": len(linears), "gain_nats": float(gain)},)
    return new


def _checked(models, arm):
    """Linear models of the earlier arms, and an estimator with the options of the first."""
    if not isinstance(arm, Arm):
        raise TypeError(f"arm must be an Arm, got {type(arm).__name__}.")
    models = [models] if hasattr(models, "predict") else listed("models", models)
    if not models:
        raise ValueError("models are empty: give the fitted models of one earlier arm or more.")
    linears = [linear_model_of(model, "transferred") for model in models]
    first = linears[0]
    for i, linear in enumerate(linears):
        if "tool" in dict(linear.terms.extra):
            raise ValueError(
                f"models[{i}] has tools among its extra columns: their offsets are those of one "
                "arm. Fit the models without them."
            )
        old, new = ((a.n_joints, a.convention) for a in (linear.arm, arm))
        if old != new:
            raise ValueError(
                f"models[{i}] is of an arm with {old[0]} joints in the {old[1]} convention; the "
                f"new arm has {new[0]} in the {new[1]} one."
            )
        if _families(linear.terms) != _families(first.terms):
            raise ValueError(
                f"models[{i}] has other families of columns than models[0]: fit all with the same "
                "gravity, kinematics, wobble and extra, with orientations or without."
            )
    return linears, clone(models[0])


def _families(terms):
    """What terms of several arms have to have in common."""
    return terms._replace(harmonics=None, extra=tuple(name for name, _ in terms.extra))


def _of_prior(estimator, prior):
    """Fitted estimator that knows nothing but the earlier arms."""
    new = deepcopy(estimator)
    new.linear_model_, new.helps_, new.regressor_ = prior, True, None
    new.fading_ = Fading(0.0, 0.0, 0.0)
    new.n_features_in_ = prior.arm.n_joints + len(prior.terms.extra)
    if not hasattr(new, "pose_weight_"):
        new.pose_weight_ = np.empty(0)
    check_is_fitted(new)
    return new


def _pooled(linears, arm):
    """Mean and spread of several linear models, as the prior of one more arm."""
    pairs = sorted({tuple(p) for one in linears for p in np.asarray(one.terms.harmonics).tolist()})
    harmonics = np.array(pairs, dtype=int).reshape(-1, 2)
    waves = 2 * len(pairs)
    aligned = [_aligned(one, pairs) for one in linears]
    W = np.array([coef for coef, *_ in aligned])
    n = len(W)
    prior_sd = {
        name: float(np.sqrt(np.mean([one.prior_sd.get(name, 0.0) ** 2 for one in linears])))
        for name in linears[0].prior_sd
        if name != "smooth"
    }
    model = replace(
        linears[0],
        arm=arm,
        terms=linears[0].terms._replace(harmonics=harmonics, extra=_mean_references(linears)),
        coef=W[0],
        half=np.zeros((W.shape[1], 0)),
        gauge_free_half=np.zeros((W.shape[1], 0)),
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
    roots = []
    for i in (1, 2):
        half = np.hstack([*(one[i] / np.sqrt(n) for one in aligned), own])
        roots.append(np.linalg.qr(half.T, mode="r").T)
    return replace(model, coef=trust * mean, half=roots[0], gauge_free_half=roots[1])


def _mean_references(linears):
    """Extra columns, counted from the mean over the arms: for an arm that was not measured yet."""
    names = [name for name, _ in linears[0].terms.extra]
    values = np.mean([[by[0] for _, by in one.terms.extra] for one in linears], axis=0)
    return tuple((name, (value,)) for name, value in zip(names, values.tolist(), strict=True))


def _aligned(linear, pairs):
    """Coefficients and both roots of their covariance with these harmonics: 0 where it has none."""
    place = {tuple(p): i for i, p in enumerate(np.asarray(linear.terms.harmonics).tolist())}
    waves, new = 2 * len(place), 2 * len(pairs)
    to = np.array([[2 * pairs.index(p), 2 * pairs.index(p) + 1] for p in place], dtype=int).ravel()
    to = np.r_[to, new + np.arange(len(linear.coef) - waves)]
    size = new + len(linear.coef) - waves
    found = []
    for values in (linear.coef, linear.half, linear.gauge_free_half):
        found.append(np.zeros((size, *values.shape[1:])))
        found[-1][to] = values
    return found


def _evidence_of_change(prior, changed, poses):
    """Log evidence of the new poses under the prior of the earlier arms."""
    linear, half = prior_half(prior, changed.change.tau)
    return _log_evidence(linear, linear.coef, half, poses, changed.change.noise_sd)


def _evidence_of_fit(linear, poses):
    """Log evidence of a fit to the new poses alone, less the price that its harmonics had."""
    price = np.log(_OFFERED * linear.arm.n_joints)
    sd = np.array([linear.prior_sd[name] for name in families_of(linear)])
    if "smooth" in linear.prior_sd:
        joined = linear.log_bayes_factor < _CHOSEN * price
        share = np.repeat(np.sqrt(smooth_shares(linear.terms.harmonics[:, 1])), 2)
        waves = slice(0, len(share))
        of_smooth = np.repeat(joined, 2)
        sd[waves] = np.where(of_smooth, linear.prior_sd["smooth"] * share, sd[waves])
        n_chosen = np.count_nonzero(~joined)
    else:
        n_chosen = np.count_nonzero(linear.terms.harmonics[:, 1] > 2)
    evidence = _log_evidence(linear, np.zeros(len(sd)), np.diag(sd), poses, linear.noise_sd)
    return evidence - n_chosen * price


def _log_evidence(linear, mean, half, poses, noise_sd):
    """Log density of the residuals, without constants: base and tool are nearly free.

    Of the covariance ``s^2 I + H H'`` the k columns of H are fewer than the rows, as a rule:
    determinant and inverse are those of ``s^2 I + H' H``.
    """
    angles, weights, codes = poses.angles, poses.weights, poses.codes
    columns = linear.columns(angles)
    place = PLACE_MM * place_columns(linear.arm, angles, with_base=codes is None)
    r = centred(poses.residuals - columns @ mean, codes, weights)
    H = centred(np.concatenate([columns @ half, place], axis=2), codes, weights)
    root = np.sqrt(weights)
    r = (r * root[:, None]).ravel() / noise_sd
    H = (H * root[:, None, None]).reshape(len(r), -1) / noise_sd
    value, axes = np.linalg.eigh(H.T @ H)
    value = 1 + np.maximum(value, 0.0)
    seen = (H.T @ r) @ axes
    fit = r @ r - np.square(seen) @ (1 / value)
    return -0.5 * (fit + np.log(value).sum()) - n_coordinates(poses) * np.log(noise_sd)
