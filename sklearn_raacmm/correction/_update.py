"""A fitted correction brought up to date with few new poses."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence
from copy import deepcopy
from datetime import date as calendar
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.correction._change import LEAST_NOISE_MM, Change, as_prior, day
from sklearn_raacmm.correction._changes import named_changes
from sklearn_raacmm.correction._rows import (
    REGISTERED_PLACE_MM,
    Expected,
    new_rows,
    place_columns,
    why_too_few,
)
from sklearn_raacmm.correction._what_is_wrong import what_is_wrong
from sklearn_raacmm.error_model import ROUNDED, ArmResidualRegressor
from sklearn_raacmm.utils import Finding, one_blas_thread, one_warning, param_checks

# Noise of the new poses, in units of the old one, that no arm in use comes to: five draws of
# ``benchmarks/bench_after_the_lab.py series`` have 1.0 to 1.9.
_STRANGE = 10.0
# Standard deviations of a coordinate of a probe that was knocked, and of another one, mm. A choice.
_KNOCKED_PROBE_MM, _ANOTHER_PROBE_MM = 1.0, 100.0


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
    expected = Expected.of(as_prior(linear), rows)
    if few := why_too_few(expected):
        said = f"{few}: the model is kept as it was."
        Finding("few-poses", said, "Register only, or measure more poses.").report()
        return updated
    for finding in what_is_wrong(model, expected):
        finding.report()
    if np.abs(_left(model, expected)).max() <= ROUNDED * linear.arm.reach_mm:
        _as_it_was(updated, expected, date)
        return updated
    change = Change(expected, named=named_changes(expected))
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
