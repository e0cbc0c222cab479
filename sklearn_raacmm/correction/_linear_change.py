"""How a linear error model has changed: the posterior of the change, found from few new poses."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from sklearn_raacmm.arm import reach_mm
from sklearn_raacmm.error_model import LinearModel, constrained, observed_columns
from sklearn_raacmm.inference import interval_scales
from sklearn_raacmm.utils import centred

# Prior of tau: its median, and the standard deviation of its logarithm. A tenth is what
# wears; a factor of 4.5 either way leaves room for nothing at all and for an exchanged joint.
_TAU, _TAU_LOG_SD = 0.1, 1.5
# Bounds of log tau: a part changes by as much as it was at most. Bounds of the logarithm of the
# noise in units of the old model's: new poses are not less noisy. The standard deviation of its
# prior: they may lie where the model is less complete.
_LOG_TAU, _LOG_NOISE, _NOISE_LOG_SD = (-7.0, 0.0), (0.0, 4.0), 1.0
# How far base and tool may be from where they were registered, mm at the probe.
PLACE_MM = 5.0
# Noise that every measurement has, mm: without any, rounding would decide beside those millimetres.
LEAST_NOISE_MM = 1e-4
# Up to this order a harmonic changes by as much as harmonics were expected to be.
_LOW_ORDERS = 8
# Tukey's biweight, as in the first fit: standard deviations without weight, median distance of
# normal errors in three coordinates and with three of a turn, rounds, and when to stop.
_OUTLIER, _MEDIAN_OF_CHI, _ROUNDS, _SETTLED_WEIGHT = 5.5, {3: 1.5382, 6: 2.3126}, 4, 0.05
# Poses in the range of the new ones that are tried for how much a change leaves open there.
_TRIED = 200
# A pose that the fit follows freely says nothing when it is left out.
_LEAST_FREE = 1e-6


class NewPoses(NamedTuple):
    """New poses, checked: what a change is found from."""

    angles: np.ndarray  # (n, n_joints + n_extra) rad, then the extra columns
    residuals: np.ndarray  # (n, 3) mm, without the correction
    weights: np.ndarray  # (n,)
    codes: np.ndarray | None  # (n,) position of each, where positions have unknown offsets
    turns: np.ndarray | None = None  # (n, 3) residuals of the orientation, rad


class Change(NamedTuple):
    """Posterior of a change of the coefficients."""

    coef: np.ndarray  # (p,)
    half: np.ndarray  # (p, p) root of the covariance of old coefficients and change together
    tau: dict
    noise_sd: float


class Changed(NamedTuple):
    """A linear model that has changed."""

    model: LinearModel
    change: Change
    pose_weight: np.ndarray  # (n,) what the loss left of the weight of each pose


def changed_model(linear, poses, log_noise=_LOG_NOISE):
    """Linear model brought up to date with new poses.

    Parameters
    ----------
    linear : LinearModel
        The old one: its posterior is the prior.
    poses : NewPoses
        Turns are used where the model was fitted to turns, too.
    log_noise : (float, float)
        Bounds of the logarithm of the noise in units of the old model's.

    Returns
    -------
    Changed
    """
    linear = with_low_orders(linear)
    linear = replace(linear, noise_variance=max(linear.noise_variance, LEAST_NOISE_MM**2))
    angles, weights, codes = poses.angles, poses.weights, poses.codes
    turn_mm = linear.turn_mm if poses.turns is not None else 0.0
    residuals = poses.residuals - linear.predict(angles)[0]
    if turn_mm:
        turned = poses.turns - linear.predict_turn(angles)[0]
        residuals = np.hstack([residuals, turn_mm * turned])
    columns = observed_columns(linear.arm, angles, linear.terms, turn_mm)
    place = _place_seen(linear.arm, angles, codes is None, turn_mm)
    fold = _into_kinematics(linear, codes is None, turn_mm)
    columns, place = (centred(part, codes, weights) for part in (columns, place))
    residuals = centred(residuals, codes, weights)
    change, scales, factor = _robust_change(
        linear, columns, place, residuals, weights, fold, log_noise
    )
    model = replace(
        linear,
        coef=linear.coef + change.coef,
        half=change.half,
        gauge_free_half=change.half,
        noise_variance=change.noise_sd**2,
        noise_scale=scales[0],
        std_scale=scales[1],
    )
    if codes is not None:  # what the same test shows at other positions in the same range
        tried = poses_in_range(angles[weights > 0], linear.arm.n_joints)
        free = constrained(model, tried, np.ones(len(tried)), np.arange(len(tried)))
        model = replace(model, gauge_free_half=free.gauge_free_half)
    return Changed(model, change, factor)


def poses_in_range(angles, n_joints):
    """Poses whose joints stand anywhere in the ranges that some poses are from.

    Extra columns, of tools perhaps, are as they were.
    """
    low, high = angles.min(axis=0), angles.max(axis=0)
    # Of n uniform numbers the extremes lie this far inside their range on the average.
    beyond = (high - low) / max(len(angles) - 1, 1)
    rng = np.random.default_rng(0)
    tried = rng.uniform(low - beyond, high + beyond, (_TRIED, angles.shape[1]))
    tried[:, n_joints:] = angles[rng.integers(len(angles), size=_TRIED), n_joints:]
    return tried


def place_columns(arm, angles, with_base):
    """What moves of the tool and turns and shifts of the base do to the probe, (n, 3, 3 or 9)."""
    angles = angles[:, : arm.n_joints]  # without extra columns
    tool = arm.frames(angles)[:, -1, :3, :3]
    if not with_base:  # of a single-point test the base shows nothing
        return tool
    points = arm.forward(angles)
    shift = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    turn = np.stack([np.cross(axis, points) for axis in np.eye(3)], axis=2) / reach_mm(arm)
    return np.concatenate([tool, shift, turn], axis=2)


def _place_seen(arm, angles, with_base, turn_mm):
    """The same of points and, if `turn_mm` is not 0, of turns: (n, 3 or 6, 3 or 9)."""
    place = place_columns(arm, angles, with_base)
    if not turn_mm:
        return place
    turns = np.zeros_like(place)
    if with_base:
        turns[:, :, 6:] = turn_mm / reach_mm(arm) * np.eye(3)
    return np.concatenate([place, turns], axis=1)


def with_low_orders(linear):
    """The same model with the orders 1 and 2 of every joint among its columns.

    What changes need not be an order that the old data needed: a knocked encoder is eccentric. More
    free orders cost more than they find. With 8 of them a change of one eccentricity left 1.1 to 2
    times as much; 33 updates of simulated robots that change in many ways were equal in the mean.
    """
    known = [tuple(pair) for pair in np.asarray(linear.terms.harmonics).tolist()]
    if "harmonics" not in linear.prior_sd:
        return linear
    wanted = {(j, k) for j in range(linear.arm.n_joints) for k in range(1, 3)}
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


def _robust_change(linear, columns, place, residuals, weights, fold, log_noise):
    """Change found again without the poses that are too far from it, and factors of intervals.

    Poses far from the old model show the change: only those count as outliers that stay far off.
    """
    factor = np.ones(len(weights))
    for _ in range(_ROUNDS):
        change, left, spread = _change(
            linear, columns, place, residuals, weights * factor, fold, log_noise
        )
        # Few poses are followed closely: what is left of them is less than the noise.
        before, factor = factor, _tukey(left, weights, change.noise_sd)
        if np.abs(factor - before).max() < _SETTLED_WEIGHT:
            break
    return change, _honest_scales(left, spread, weights * before, change.noise_sd), before


def _tukey(residuals, weights, noise_sd):
    """Tukey's biweight; all poses count fully where none is too far."""
    distance = np.linalg.norm(residuals, axis=1)
    median = _MEDIAN_OF_CHI[residuals.shape[1]]
    scale = max(np.median(distance[weights > 0]) / median, noise_sd)
    share = np.square(distance / (_OUTLIER * scale))
    if not np.any(share[weights > 0] >= 1):
        return np.ones(len(weights))
    return np.square(np.maximum(1 - share, 0.0))


def n_coordinates(poses):
    """Coordinates of the poses that count, less three for each unknown offset."""
    used = poses.weights > 0
    n_offsets = 0 if poses.codes is None else len(np.unique(poses.codes[used]))
    return int(3 * (np.count_nonzero(used) - n_offsets))


def prior_half(linear, tau):
    """The model with all columns that may change, and the root of their covariance before `tau`."""
    linear = with_low_orders(linear)
    sd = np.array([tau[name] for name in parts_of(linear)]) * _largest_change(linear)
    return linear, np.hstack([linear.half, np.diag(sd)])


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


def _change(linear, columns, place, residuals, weights, fold, log_noise):
    """Posterior of the change, what it leaves of the residuals, and its root at the poses."""
    prior = _largest_change(linear)
    part = parts_of(linear)
    names = sorted(set(part.tolist()))
    kept = weights > 0
    root = np.repeat(np.sqrt(weights[kept]), columns.shape[1])
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
    fixed = old @ old.T + PLACE_MM**2 * B @ B.T
    tau, noise_sd = _evidence(kernels, fixed, r, n_data, linear.noise_variance, log_noise)
    variance = np.zeros(len(prior))
    for m, value in zip(members, tau, strict=True):
        variance[m] = np.square(value * prior[m])
    # All columns at once: those of the model, and those of base and tool behind them.
    both = np.concatenate([A, B], axis=1)
    p, q = A.shape[1], B.shape[1]
    half = np.zeros((p + q, linear.half.shape[1] + p + q))
    half[:p, : linear.half.shape[1]] = linear.half
    half[:, linear.half.shape[1] :] = np.diag(np.r_[np.sqrt(variance), np.full(q, PLACE_MM)])
    half = half[:, np.any(half != 0, axis=0)]
    seen = both @ half / noise_sd
    # Posterior of the factors of half: (I + seen' seen)^-1, the square of I + V (d - 1) V'.
    U, size, Vt = np.linalg.svd(seen, full_matrices=False)
    along = half @ Vt.T
    mean = along @ (size / (1 + size**2) * (U.T @ r)) / noise_sd
    half = half + (along * (1 / np.sqrt(1 + size**2) - 1)) @ Vt
    left = residuals - columns @ mean[:p] - place @ mean[p:]
    spread = np.concatenate([columns, place], axis=2) @ half
    coef, half = mean[:p] + fold @ mean[p:], half[:p] + fold @ half[p:]
    # As many columns as rows hold the same covariance.
    half = np.linalg.qr(half.T, mode="r").T if half.shape[1] > p else half
    found = dict(zip(names, np.asarray(tau).tolist(), strict=True))
    return Change(coef, half, found, float(noise_sd)), left, spread


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
    free, axes = np.linalg.eigh(np.eye(left.shape[1]) - own)
    inverse = axes / np.maximum(free, _LEAST_FREE)[:, None] @ axes.swapaxes(1, 2)
    errors = np.einsum("nij,nj->ni", inverse, left)
    total = variance[:, None] * np.einsum("nii->ni", inverse)
    noise = np.broadcast_to(np.sqrt(variance)[:, None], total.shape)
    std = np.sqrt(np.maximum(total - noise**2, 0.0))
    return interval_scales(errors, noise, std, np.ones(len(left)))


def _into_kinematics(linear, with_base, turn_mm=0.0):
    """Coefficients (n_columns, 3 or 9) that do what a move of tool and base does."""
    size = 9 if with_base else 3
    fold = np.zeros((len(linear.coef), size))
    if not linear.terms.kinematics:
        return fold
    arm, terms = linear.arm, linear.terms
    angles = np.zeros((40, arm.n_joints + len(terms.extra)))  # extra columns move no kinematics
    angles[:, : arm.n_joints] = np.random.default_rng(0).uniform(-np.pi, np.pi, (40, arm.n_joints))
    of = families_of(linear) == "kinematics"
    columns = observed_columns(arm, angles, terms, turn_mm)[:, :, of]
    place = _place_seen(arm, angles, with_base, turn_mm)
    rows = columns.shape[0] * columns.shape[1]
    fold[of] = np.linalg.lstsq(columns.reshape(rows, -1), place.reshape(rows, -1), rcond=1e-9)[0]
    return fold


def _evidence(kernels, fixed, r, n_data, noise_variance, log_noise):
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

    bounds = [_LOG_TAU] * len(kernels) + [log_noise]
    start = np.r_[np.full(len(kernels), np.log(_TAU)), 0.1]
    best = minimize(
        negative, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 50}
    ).x
    return np.exp(best[:-1]), float(np.exp(best[-1]) * np.sqrt(noise_variance))
