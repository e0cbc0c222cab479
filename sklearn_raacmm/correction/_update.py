"""A fitted correction brought up to date with few new poses."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from copy import copy, deepcopy
from dataclasses import replace
from datetime import date as calendar

import numpy as np
from sklearn.utils.validation import check_is_fitted

from sklearn_raacmm.arm import one_warning
from sklearn_raacmm.correction._linear_change import (
    LEAST_NOISE_MM,
    NewPoses,
    changed_model,
    n_coordinates,
    poses_in_range,
)
from sklearn_raacmm.error_model import LinearModel, check_poses, check_turns
from sklearn_raacmm.utils import (
    check_points,
    check_weights,
    encode_groups,
    one_blas_thread,
    validate_params,
)

# Noise of the new poses, in units of the old one, that no arm in use comes to.
_STRANGE = 10.0


@one_blas_thread
@validate_params({"date": [str, calendar, None]}, prefer_skip_nested_validation=True)
@one_warning()
def update_correction(
    model, X, y, *, groups=None, sample_weight=None, orientation_residuals=None, date=None
):
    """Bring a fitted correction up to date with few new poses, without the old data.

    The linear model keeps its columns. Its coefficients may change by a part tau of what they were
    expected to be before any data (a harmonic above order 8 by a part of what it was), base and
    tool by some millimetres. How much has changed is found by the evidence, for the harmonics of
    each joint and for each other family of columns. With no new pose the result is the old model,
    with very many it is what these poses say.

    Parameters
    ----------
    model : ArmResidualRegressor
        Fitted model; it is left as it is.

    X : array-like of shape (n_samples, n_joints + n_extra)
        Joint angles of the new poses, in the unit that the model takes; then the extra columns that
        it was fitted with.

    y : array-like of shape (n_samples, 3)
        Their residuals in mm, in the arm's base frame, without the correction:
        ``result.residuals(angles, points)`` of ``result = calibrate(..., correction=model,
        free=["probe"])``, or :func:`position_residuals` of a single-point test.

    groups : array-like of shape (n_samples,), default=None
        Label of the position of each sample, where each position has an unknown offset: needed
        for a single-point test.

    sample_weight : array-like of shape (n_samples,), default=None
        Weights. Poses that lie far off are left out by themselves.

    orientation_residuals : array-like of shape (n_samples, 3), default=None
        Residuals of the orientation, as `fit` takes them, for a model that was fitted with some.
        Without them its `orientation_model_` is brought up to date by the points alone.

    date : str, default=None
        When the new poses were measured, for the record; None: today.

    Returns
    -------
    model : ArmResidualRegressor
        A model of the same type, to be used with the base and the tool of the registration.
        ``updates_`` holds a dictionary for every update: `date`, `n_poses`, `tau` by joint and
        family, `noise_sd_mm`.

    Raises
    ------
    TypeError
        If the model holds no linear model in use: such a one can be registered, not updated.
    ValueError
        If shapes do not fit, something is NaN or infinite, or groups are missing though the model
        has offsets; if X has a tool that the model does not know; if orientations are given to a
        model that was fitted without.

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
    likelihood times log-normal priors. Harmonics of the orders 1 and 2 are offered beside
    those that the old data needed. Where the model has kinematic columns, b becomes a part of them;
    otherwise register again, through the updated model.

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
    >>> model = ArmResidualRegressor(arm, max_order=4).fit(angles, y)
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
    turns = check_turns(orientation_residuals, len(angles), codes)
    if turns is not None and not linear.turn_mm:
        raise ValueError(
            "orientation_residuals were given, but the model was fitted without any: leave them "
            "out, or fit it again."
        )
    poses = NewPoses(angles, residuals, weights, codes, turns)
    n_free, n_data = 9 if codes is None else 3, n_coordinates(poses)
    if n_data <= n_free:
        warnings.warn(
            f"{len(angles)} new poses give {n_data} coordinates, fewer than would show "
            f"more than the {n_free} freedoms of base and tool: the model is kept as it was. "
            "Register only, or measure more poses.",
            UserWarning,
            stacklevel=5,
        )
        return deepcopy(model)
    poses = poses._replace(residuals=residuals - model.second_stage(angles))
    changed = changed_model(linear, poses)
    noise_sd = changed.change.noise_sd
    if noise_sd > _STRANGE * max(linear.noise_sd, LEAST_NOISE_MM):
        warnings.warn(
            f"The new poses scatter by {noise_sd:.3g} mm a coordinate about the updated "
            f"model, the old ones did by {linear.noise_sd:.3g} mm: are they of this arm, and "
            "residuals in its base frame, registered through the correction?",
            UserWarning,
            stacklevel=5,
        )
    updated = deepcopy(model)
    updated.linear_model_ = changed.model
    _keep_fading(updated, model, angles[weights > 0])
    updated.updates_ = (*getattr(model, "updates_", ()), record_of(changed, len(angles), date))
    return updated


def record_of(changed, n_poses, date):
    """What `updates_` keeps of a change."""
    return {
        "date": calendar.today().isoformat() if date is None else str(date),
        "n_poses": n_poses,
        "tau": changed.change.tau,
        "noise_sd_mm": changed.change.noise_sd,
    }


def _keep_fading(updated, model, angles):
    """Let the updated correction fade where the old one did.

    What few poses leave open of base, tool and change adds to every standard deviation. The change
    is shrunk to the old model for that already, so that it is no reason to take the whole
    correction back. It is measured at poses whose joints stand anywhere in the ranges that the new
    poses are from.
    """
    tried = poses_in_range(angles, updated.linear_model_.arm.n_joints)
    old, new = (
        np.square(m.linear_model_.predict(tried, return_std=True)[1]).sum(axis=1)
        for m in (model, updated)
    )
    added = max(np.max(new - old), 0.0)
    known = float(np.sqrt(updated.fading_.known_mm**2 + added))
    updated.fading_ = replace(updated.fading_, known_mm=known)


def linear_model_of(model, done):
    """The linear model that a fitted correction uses."""
    linear = getattr(model, "linear_model_", None)
    if hasattr(model, "fit"):
        check_is_fitted(model)
    if not isinstance(linear, LinearModel) or not model.helps_:
        raise TypeError(
            f"A {type(model).__name__} that holds no linear model in use cannot be {done}: it has "
            "no posterior of causes. It can be registered, by calibrate(..., correction=model)."
        )
    return linear


def check_new_poses(model, X, y, groups, sample_weight):
    """Angles, residuals, weights and codes of new poses; each fault gets one clear sentence."""
    angles = check_poses(model, X)
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
