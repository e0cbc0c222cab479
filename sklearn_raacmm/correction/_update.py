"""A fitted correction brought up to date with few new poses."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from copy import copy, deepcopy
from dataclasses import replace
from datetime import date as calendar
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import one_warning, reach_mm
from sklearn_raacmm.error_model import LinearModel, check_poses, interval_scales
from sklearn_raacmm.utils import (
    centred,
    check_points,
    check_weights,
    encode_groups,
    one_blas_thread,
    validate_params,
)

# Prior of tau: its median, and the standard deviation of its logarithm. A tenth is what
# wears; a factor of 4.5 either way leaves room for nothing at all and for an exchanged joint.
_TAU, _TAU_LOG_SD = 0.1, 1.5
# Bounds of log tau: a part changes by as much as it was at most. Bounds of the logarithm of the
# noise in units of the old model's: new poses are not less noisy. The standard deviation of its
# prior: they may lie where the model is less complete.
_LOG_TAU, _LOG_NOISE, _NOISE_LOG_SD = (-7.0, 0.0), (0.0, 4.0), 1.0
# How far base and tool may be from where they were registered, mm at the probe.
_PLACE_MM = 5.0
# Noise that every measurement has, mm: without any, rounding would decide beside those millimetres.
_LEAST_NOISE_MM = 1e-4
# What changes need not be an order that the old data needed: these low ones are offered, too.
_LOW_ORDERS = 8
# Tukey's biweight, as in the first fit: standard deviations without weight, median distance of
# normal errors, rounds, and when to stop.
_OUTLIER, _MEDIAN_OF_CHI3, _ROUNDS, _SETTLED_WEIGHT = 5.5, 1.5382, 4, 0.05
# Noise of the new poses, in units of the old one, that no arm in use comes to.
_STRANGE = 10.0
# A pose that the fit follows freely says nothing when it is left out.
_LEAST_FREE = 1e-6
# Poses in the range of the new ones that are tried for how much an update leaves open there.
_TRIED = 200


class _Change(NamedTuple):
    """Posterior of a change of the coefficients."""

    coef: np.ndarray  # (p,)
    half: np.ndarray  # (p, p) root of the covariance of old coefficients and change together
    tau: dict
    noise_sd: float


@one_blas_thread
@validate_params({"date": [str, calendar, None]}, prefer_skip_nested_validation=True)
@one_warning()
def update_correction(model, X, y, *, groups=None, sample_weight=None, date=None):
    """Bring a fitted correction up to date with few new poses, without the old data.

    The linear model keeps its columns. Its coefficients may change by a part tau of what they were
    expected to be before any data (a harmonic above order 8 by a part of what it was), base and
    tool by some millimetres. How much has changed is found by the evidence, for the harmonics of
    each joint and for each other family of columns. With no new pose the result is the old model,
    with very many it is what these poses say.

    Parameters
    ----------
    model : JointHarmonicRegressor or ArmResidualRegressor
        Fitted model; it is left as it is.

    X : array-like of shape (n_samples, n_joints)
        Joint angles of the new poses, in the unit that the model takes.

    y : array-like of shape (n_samples, 3)
        Their residuals in mm, in the arm's base frame, without the correction:
        ``result.residuals(angles, points)`` of ``result = calibrate(..., correction=model,
        free=["probe"])``, or :func:`position_residuals` of a single-point test.

    groups : array-like of shape (n_samples,), default=None
        Label of the position of each sample, where each position has an unknown offset: needed
        for a single-point test.

    sample_weight : array-like of shape (n_samples,), default=None
        Weights. Poses that lie far off are left out by themselves.

    date : str, default=None
        When the new poses were measured, for the record; None: today.

    Returns
    -------
    model : JointHarmonicRegressor or ArmResidualRegressor
        A model of the same type, to be used with the base and the tool of the registration.
        ``updates_`` holds a dictionary for every update: `date`, `n_poses`, `tau` by joint and
        family, `noise_sd_mm`.

    Raises
    ------
    TypeError
        If the model holds no linear model in use: such a one can be registered, not updated.
    ValueError
        If shapes do not fit, something is NaN or infinite, or groups are missing though the model
        has offsets.

    Warns
    -----
    UserWarning
        If there are fewer coordinates than freedoms of base and tool, in which case nothing is
        changed; if the new poses scatter about the updated model ten times as much as the
        old ones did.

    See Also
    --------
    calibrate : Registers: fits base and tool through the correction.
    check_correction : Says whether an update is needed.

    Notes
    -----
    With A the columns, w0 and S0 the old posterior, V the prior variances and B the columns of base
    and tool, ``y - A w0 = A dw + B b + e`` with ``dw ~ N(0, S0 + tau^2 V)``, b nearly free and e
    of a variance of at least the old one. The taus and that variance maximise the marginal
    likelihood times log-normal priors. Harmonics of the orders 1 to 8 are offered beside those that
    the old data needed. Where the model has kinematic columns, b becomes a part of them; otherwise
    register again, through the updated model.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, JointHarmonicRegressor, update_correction
    >>> arm = Arm.from_name("aacmm6")
    >>> rng = np.random.default_rng(0)
    >>> angles = rng.uniform(-2, 2, (400, 6))
    >>> def residuals(angles, arcsec):  # encoder 3 is eccentric
    ...     error = np.zeros_like(angles)
    ...     error[:, 2] = np.deg2rad(arcsec / 3600) * np.cos(angles[:, 2])
    ...     return np.einsum("nij,nj->ni", arm.jacobian(angles), error)
    >>> y = residuals(angles, 20) + rng.normal(scale=0.01, size=(400, 3))
    >>> model = JointHarmonicRegressor(arm, max_order=4).fit(angles, y)
    >>> new = rng.uniform(-2, 2, (60, 6))  # after a knock it is more so
    >>> y_new = residuals(new, 40) + rng.normal(scale=0.01, size=(60, 3))
    >>> updated = update_correction(model, new, y_new)
    >>> far = rng.uniform(-2, 2, (500, 6))
    >>> left = [residuals(far, 40) - m.predict(far) for m in (model, updated)]
    >>> bool(np.abs(left[1]).mean() < 0.4 * np.abs(left[0]).mean())
    True
    """
    linear = linear_model_of(model, "updated")
    if not isinstance(X, str | dict) and hasattr(X, "__len__") and len(X) == 0:
        return deepcopy(model)
    angles, residuals, weights, codes = check_new_poses(model, X, y, groups, sample_weight)
    place = place_columns(linear.arm, angles, with_base=codes is None)
    n_free = place.shape[2]
    n_data = 3 * (np.sum(weights > 0) - (0 if codes is None else len(np.unique(codes))))
    if n_data <= n_free:
        warnings.warn(
            f"{len(angles)} new poses give {max(n_data, 0)} coordinates, fewer than would show "
            f"more than the {n_free} freedoms of base and tool: the model is kept as it was. "
            "Register only, or measure more poses.",
            UserWarning,
            stacklevel=5,
        )
        return deepcopy(model)
    linear = with_low_orders(linear)
    linear = replace(linear, noise_variance=max(linear.noise_variance, _LEAST_NOISE_MM**2))
    columns = centred(linear.columns(angles), codes, weights)
    place = centred(place, codes, weights)
    residuals = centred(residuals - _unfaded(model, angles), codes, weights)
    change, scales = _robust_change(linear, columns, place, residuals, weights)
    if change.noise_sd > _STRANGE * linear.noise_sd:
        warnings.warn(
            f"The new poses scatter by {change.noise_sd:.3g} mm a coordinate about the updated "
            f"model, the old ones did by {linear.noise_sd:.3g} mm: are they of this arm, and "
            "residuals in its base frame, registered through the correction?",
            UserWarning,
            stacklevel=5,
        )
    updated = deepcopy(model)
    updated.linear_model_ = replace(
        linear,
        coef=linear.coef + change.coef,
        half=change.half,
        gauge_free_half=change.half,
        noise_variance=change.noise_sd**2,
        noise_scale=scales[0],
        std_scale=scales[1],
    )
    _keep_fading(updated, model, angles[weights > 0])
    entry = {
        "date": calendar.today().isoformat() if date is None else str(date),
        "n_poses": len(angles),
        "tau": change.tau,
        "noise_sd_mm": change.noise_sd,
    }
    updated.updates_ = (*getattr(model, "updates_", ()), entry)
    return updated


def _keep_fading(updated, model, angles):
    """Let the updated correction fade where the old one did.

    What few poses leave open of base, tool and change adds to every standard deviation. The change
    is shrunk to the old model for that already, so that it is no reason to take the whole
    correction back. It is measured at poses whose joints stand anywhere in the ranges that the new
    poses are from.
    """
    low, high = angles.min(axis=0), angles.max(axis=0)
    # Of n uniform numbers the extremes lie this far inside their range on the average.
    beyond = (high - low) / max(len(angles) - 1, 1)
    shape = (_TRIED, angles.shape[1])
    tried = np.random.default_rng(0).uniform(low - beyond, high + beyond, shape)
    old, new = (
        np.square(m.linear_model_.predict(tried, return_std=True)[1]).sum(axis=1)
        for m in (model, updated)
    )
    added = max(np.max(new - old), 0.0)
    fadings = list(getattr(updated, "fadings_", None) or [updated.fading_])
    fadings[0] = replace(fadings[0], known_mm=float(np.sqrt(fadings[0].known_mm ** 2 + added)))
    if hasattr(updated, "fadings_"):
        updated.fadings_ = fadings
    else:
        updated.fading_ = fadings[0]


def _unfaded(model, angles):
    """What a model predicts at angles in rad before it fades."""
    model = copy(model).set_params(angle_unit="rad")
    if hasattr(model, "fadings_"):
        model.fadings_ = [replace(fading, factor=0.0) for fading in model.fadings_]
    else:
        model.fading_ = replace(model.fading_, factor=0.0)
    return model.predict(angles)


def linear_model_of(model, done):
    """The linear model that a fitted correction uses."""
    linear = getattr(model, "linear_model_", None)
    if hasattr(model, "fit"):
        check_is_fitted(model)
    if not isinstance(linear, LinearModel) or getattr(model, "use_", "") == "none":
        raise TypeError(
            f"A {type(model).__name__} that holds no linear model in use cannot be {done}: it has "
            "no posterior of causes. It can be registered, by calibrate(..., correction=model)."
        )
    if linear.terms.extra:
        raise ValueError(
            f"A model with extra columns ({', '.join(name for name, _ in linear.terms.extra)}) "
            f"cannot be {done} yet: fit it again."
        )
    return linear


def check_new_poses(model, X, y, groups, sample_weight):
    """Angles, residuals, weights and codes of new poses; each fault gets one clear sentence."""
    angles = check_poses(model, X, stacklevel=8)
    y = check_points(y, 3)
    if len(y) != len(angles):
        raise ValueError(f"X has {len(angles)} rows, but y has {len(y)}.")
    if groups is None and model.linear_model_.offsets:
        raise ValueError(
            "The model has an unknown offset at every position: give groups, the position of each "
            "new pose."
        )
    codes = None if groups is None else encode_groups(groups, len(y))[1]
    return angles, y, check_weights(sample_weight, angles), codes


def place_columns(arm, angles, with_base):
    """What moves of the tool and turns and shifts of the base do to the probe, (n, 3, 3 or 9)."""
    tool = arm.frames(angles)[:, -1, :3, :3]
    if not with_base:  # of a single-point test the base shows nothing
        return tool
    points = arm.forward(angles)
    shift = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    turn = np.stack([np.cross(axis, points) for axis in np.eye(3)], axis=2) / reach_mm(arm)
    return np.concatenate([tool, shift, turn], axis=2)


def with_low_orders(linear):
    """The same model with the low orders of every joint among its columns."""
    known = [tuple(pair) for pair in np.asarray(linear.terms.harmonics).tolist()]
    if "harmonics" not in linear.prior_sd:
        return linear
    wanted = {(j, k) for j in range(linear.arm.n_joints) for k in range(1, _LOW_ORDERS + 1)}
    pairs = sorted({*known, *wanted})
    place = {pair: i for i, pair in enumerate(pairs)}
    # Column of the new model of each column of the old one.
    waves = np.array([[2 * place[pair], 2 * place[pair] + 1] for pair in known], dtype=int).ravel()
    n_rest = len(linear.coef) - len(waves)
    columns = np.r_[waves, 2 * len(pairs) + np.arange(n_rest)]
    size = 2 * len(pairs) + n_rest
    coef, half = np.zeros(size), np.zeros((size, linear.half.shape[1]))
    coef[columns], half[columns] = linear.coef, linear.half
    gains = np.zeros(len(pairs))
    gains[[place[pair] for pair in known]] = linear.log_bayes_factor
    harmonics = np.array(pairs, dtype=int).reshape(-1, 2)
    return replace(
        linear,
        terms=linear.terms._replace(harmonics=harmonics),
        coef=coef,
        half=half,
        gauge_free_half=half,
        log_bayes_factor=gains,
    )


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


def _robust_change(linear, columns, place, residuals, weights):
    """Change found again without the poses that are too far from it, and factors of intervals.

    Poses far from the old model show the change: only those count as outliers that stay far off.
    """
    factor = np.ones(len(weights))
    for _ in range(_ROUNDS):
        change, left, spread = _change(linear, columns, place, residuals, weights * factor)
        # Few poses are followed closely: what is left of them is less than the noise.
        before, factor = factor, _tukey(left, weights, change.noise_sd)
        if np.abs(factor - before).max() < _SETTLED_WEIGHT:
            break
    return change, _honest_scales(left, spread, weights * before, change.noise_sd)


def _tukey(residuals, weights, noise_sd):
    """Tukey's biweight; all poses count fully where none is too far."""
    distance = np.linalg.norm(residuals, axis=1)
    scale = max(np.median(distance[weights > 0]) / _MEDIAN_OF_CHI3, noise_sd)
    share = np.square(distance / (_OUTLIER * scale))
    if not np.any(share[weights > 0] >= 1):
        return np.ones(len(weights))
    return np.square(np.maximum(1 - share, 0.0))


def _largest_change(linear):
    """What a tau of 1 lets each column change by, (n_columns,).

    A low order may appear where there was none: it changes by what harmonics were expected to be
    before any data. A high one, the tooth of a gear, changes by as much as there is of it.
    """
    prior = np.array([linear.prior_sd[name] for name in families_of(linear)])
    pairs = np.asarray(linear.terms.harmonics, dtype=int).reshape(-1, 2)
    waves = slice(0, 2 * len(pairs))
    amplitude = np.linalg.norm(linear.coef[waves].reshape(-1, 2), axis=1) / np.sqrt(2)
    high = np.repeat(pairs[:, 1] > _LOW_ORDERS, 2)
    prior[waves] = np.where(high, np.minimum(np.repeat(amplitude, 2), prior[waves]), prior[waves])
    return prior


def _change(linear, columns, place, residuals, weights):
    """Posterior of the change, what it leaves of the residuals, and its root at the poses."""
    prior = _largest_change(linear)
    part = parts_of(linear)
    names = sorted(set(part.tolist()))
    kept = weights > 0
    root = np.repeat(np.sqrt(weights[kept]), 3)
    A = columns[kept].reshape(-1, columns.shape[2]) * root[:, None]
    B = place[kept].reshape(-1, place.shape[2]) * root[:, None]
    r = residuals[kept].ravel() * root
    n_data = len(r)
    if n_data > A.shape[1] + B.shape[1] + 1:  # no more rows than there are columns
        R = np.linalg.qr(np.column_stack([A, B, r]), mode="r")
        A, B, r = R[:, : A.shape[1]], R[:, A.shape[1] : -1], R[:, -1]
    old = A @ linear.half
    members = [part == name for name in names]
    kernels = [(A[:, m] * prior[m]) @ (A[:, m] * prior[m]).T for m in members]
    fixed = old @ old.T + _PLACE_MM**2 * B @ B.T
    tau, noise_sd = _evidence(kernels, fixed, r, n_data, linear.noise_variance)
    variance = np.zeros(len(prior))
    for m, value in zip(members, tau, strict=True):
        variance[m] = np.square(value * prior[m])
    # All columns at once: those of the model, and those of base and tool behind them.
    both = np.concatenate([A, B], axis=1)
    p, q = A.shape[1], B.shape[1]
    half = np.zeros((p + q, linear.half.shape[1] + p + q))
    half[:p, : linear.half.shape[1]] = linear.half
    half[:, linear.half.shape[1] :] = np.diag(np.r_[np.sqrt(variance), np.full(q, _PLACE_MM)])
    half = half[:, np.any(half != 0, axis=0)]
    seen = both @ half / noise_sd
    # Posterior of the factors of half: (I + seen' seen)^-1, the square of I + V (d - 1) V'.
    U, size, Vt = np.linalg.svd(seen, full_matrices=False)
    along = half @ Vt.T
    mean = along @ (size / (1 + size**2) * (U.T @ r)) / noise_sd
    half = half + (along * (1 / np.sqrt(1 + size**2) - 1)) @ Vt
    left = residuals - columns @ mean[:p] - place @ mean[p:]
    spread = np.concatenate([columns, place], axis=2) @ half
    fold = _into_kinematics(linear, with_base=q > 3)
    coef, half = mean[:p] + fold @ mean[p:], half[:p] + fold @ half[p:]
    # As many columns as rows hold the same covariance.
    half = np.linalg.qr(half.T, mode="r").T if half.shape[1] > p else half
    found = dict(zip(names, np.asarray(tau).tolist(), strict=True))
    return _Change(coef, half, found, float(noise_sd)), left, spread


def _honest_scales(left, spread, weights, noise_sd):
    """Factors of noise and standard deviation at which intervals hold at poses left out.

    With C the columns at one pose times a root of the posterior's covariance, ``H = C C' / s^2`` is
    the part of its own noise that the fit follows. Without this pose it would be off by
    ``(I - H)^-1`` times what the fit leaves, of the covariance ``s^2 (I - H)^-1``.
    """
    kept = weights > 0
    left, spread, weights = left[kept], spread[kept], weights[kept]
    variance = noise_sd**2 / weights
    own = spread @ spread.swapaxes(1, 2) / variance[:, None, None]
    free, axes = np.linalg.eigh(np.eye(3) - own)
    inverse = axes / np.maximum(free, _LEAST_FREE)[:, None] @ axes.swapaxes(1, 2)
    errors = np.einsum("nij,nj->ni", inverse, left)
    total = variance[:, None] * np.einsum("nii->ni", inverse)
    noise = np.broadcast_to(np.sqrt(variance)[:, None], total.shape)
    std = np.sqrt(np.maximum(total - noise**2, 0.0))
    return interval_scales(errors, noise, std, np.ones(len(left)))


def _into_kinematics(linear, with_base):
    """Coefficients (n_columns, 3 or 9) that do what a move of tool and base does."""
    size = 9 if with_base else 3
    fold = np.zeros((len(linear.coef), size))
    if not linear.terms.kinematics:
        return fold
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (40, linear.arm.n_joints))
    of = families_of(linear) == "kinematics"
    columns = linear.columns(angles)[:, :, of].reshape(120, -1)
    place = place_columns(linear.arm, angles, with_base).reshape(120, -1)
    fold[of] = np.linalg.lstsq(columns, place, rcond=1e-9)[0]
    return fold


def _evidence(kernels, fixed, r, n_data, noise_variance):
    """Tau of each part and standard deviation of the noise that the evidence prefers."""
    identity, n_rest = np.eye(len(r)), n_data - len(r)  # the rest is noise that r has summed up

    def negative(t):
        scale = np.exp(2 * t)
        cov = fixed + scale[-1] * noise_variance * identity
        for value, kernel in zip(scale, kernels, strict=False):
            cov += value * kernel
        factor = cho_factor(cov, lower=True, check_finite=False)
        a, inverse = cho_solve(factor, r), cho_solve(factor, identity)
        slopes = [
            value * (np.sum(inverse * kernel) - a @ kernel @ a)
            for value, kernel in zip(scale, kernels, strict=False)
        ]
        slopes.append(scale[-1] * noise_variance * (np.trace(inverse) - a @ a) + n_rest)
        z = np.r_[(t[:-1] - np.log(_TAU)) / _TAU_LOG_SD, t[-1] / _NOISE_LOG_SD]
        sd = np.r_[np.full(len(kernels), _TAU_LOG_SD), _NOISE_LOG_SD]
        value = np.log(np.diag(factor[0])).sum() + n_rest * t[-1] + 0.5 * (r @ a + z @ z)
        return value, np.array(slopes) + z / sd

    bounds = [_LOG_TAU] * len(kernels) + [_LOG_NOISE]
    start = np.r_[np.full(len(kernels), np.log(_TAU)), 0.1]
    best = minimize(
        negative, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 50}
    ).x
    return np.exp(best[:-1]), float(np.exp(best[-1]) * np.sqrt(noise_variance))
