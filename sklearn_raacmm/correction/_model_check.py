"""Does a correction still hold? A test of new poses against what the model expects of them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from copy import copy
from dataclasses import dataclass, field
from datetime import date as calendar
from numbers import Real

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import chi, chi2

from sklearn_raacmm.correction._update import check_new_poses, linear_model_of, place_columns
from sklearn_raacmm.utils import Interval, one_blas_thread, validate_params

# Orders of the harmonics that a knocked or loosened encoder shows first.
_ORDERS = (1, 2)
# Poses that are named as slipped: this many on the average in a set without any; when they are more
# than this share of all, they are no slips.
_FALSE_NAMES, _MOST_SLIPS = 0.01, 0.1
# Sets of poses drawn for the limits of the control chart.
_DRAWS = 1000
# A direction that the poses show by less than this part of the strongest is not tested.
_UNSEEN = 1e-8
_ADVICE = {
    "nothing": "Nothing: the correction holds.",
    "probe": "Register again, by calibrate(..., correction=model, free=['probe']).",
    "scale": "Bring the arm to its usual temperature, or check its scale by a known length.",
    "noise": "Look for a loose probe, a dirty seat or an unsteady stand, and measure anew.",
    "arm": "Update the correction by update_correction; if that does not hold, measure anew.",
}


@dataclass(frozen=True, eq=False)
class CorrectionCheck:
    """What a check found.

    Attributes
    ----------
    holds : bool
        Whether nothing speaks against the correction at the rate that was asked for.
    p_value : float
        How often a correction that holds looks as bad as this, all tests together.
    suspect : str
        What explains the poses best: "nothing", "offset of joint 2", "harmonics of joint 2",
        "probe", "scale", or "noise" if nothing else does.
    advice : str
        What to do, in one sentence.
    tests : structured ndarray of shape (n_tests,)
        `cause`, `statistic`, `freedom` and `p_value` of each test, before they are put together.
    slipped : tuple of int
        Rows that lie too far off to count, at most a tenth of all: measure them again.
    record : dict
        One line for a control chart: `date`, `n_poses`, `mean_mm` and `range_mm` of the corrected
        distances with the limits `mean_limits_mm` and `range_limits_mm` that a correction which
        holds leaves at the same rate, `p_value`, `suspect`.
    """

    holds: bool
    p_value: float
    suspect: str
    advice: str
    tests: np.ndarray = field(repr=False)
    slipped: tuple
    record: dict = field(repr=False)


@one_blas_thread
@validate_params(
    {"false_alarm_rate": [Interval(Real, 0, 0.5, closed="neither")], "refitted": ["array-like"]},
    prefer_skip_nested_validation=True,
)
def check_correction(
    model,
    X,
    y,
    *,
    groups=None,
    sample_weight=None,
    refitted=(),
    false_alarm_rate=0.01,
    date=None,
):
    """Say from a few poses of today whether a fitted correction still holds.

    Parameters
    ----------
    model : JointHarmonicRegressor or ArmResidualRegressor
        Fitted model.

    X : array-like of shape (n_samples, n_joints)
        Joint angles of today's poses, in the unit that the model takes.

    y : array-like of shape (n_samples, 3)
        Their residuals in mm, in the arm's base frame, without the correction:
        ``result.residuals(angles, points)`` or :func:`position_residuals`.

    groups : array-like of shape (n_samples,), default=None
        Label of the position of each sample, where each position has an unknown offset.

    sample_weight : array-like of shape (n_samples,), default=None
        Weights.

    refitted : list of {"base", "probe"}, default=()
        What has been fitted to these same poses: that has taken up a part of any change.

    false_alarm_rate : float, default=0.01
        How often a correction that holds may be called into question.

    date : str, default=None
        When the poses were measured, for the record; None: today.

    Returns
    -------
    CorrectionCheck

    Raises
    ------
    TypeError
        If the model holds no linear model in use.
    ValueError
        If shapes do not fit, something is NaN or infinite, groups are missing though the model has
        offsets, or there are no more coordinates than freedoms.

    See Also
    --------
    update_correction : Brings the model up to date.

    Notes
    -----
    If the correction holds, ``y - predict(X)`` is normal with the covariance ``A S A' + s^2 I`` of
    the model's posterior and noise. One test is of its size against that; one of each cause, a
    score test of what that cause would do to these poses: the offset and the two lowest harmonics
    of each joint, the probe, a common scale. The smallest p-value times the number of tests is
    compared with the rate, so that the rate is an upper bound (Bonferroni). It supposes that the
    model is complete: where it is not, poses in new regions raise alarms of their own.

    What cannot be seen is not tested: a single-point test without known lengths has no scale, and
    joint 1 nothing but its harmonics.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, JointHarmonicRegressor, check_correction
    >>> arm = Arm.from_name("aacmm6")
    >>> rng = np.random.default_rng(0)
    >>> angles = rng.uniform(-2, 2, (400, 6))
    >>> y = rng.normal(scale=0.01, size=(400, 3))
    >>> model = JointHarmonicRegressor(arm, max_order=4).fit(angles, y)
    >>> today = rng.uniform(-2, 2, (30, 6))
    >>> check_correction(model, today, rng.normal(scale=0.01, size=(30, 3))).holds
    True
    >>> knock = arm.jacobian(today)[:, :, 1] * np.deg2rad(20 / 3600)
    >>> check_correction(model, today, knock + rng.normal(scale=0.01, size=(30, 3))).suspect
    'offset of joint 2'
    """
    linear = linear_model_of(model, "checked")
    angles, y, weights, codes = check_new_poses(model, X, y, groups, sample_weight)
    left = y - copy(model).set_params(angle_unit="rad").predict(angles)
    kept = weights > 0
    slipped = _slipped(linear, angles, left, codes, kept)
    kept &= ~slipped
    angles, left, weights = angles[kept], left[kept], weights[kept]
    if codes is not None:
        codes = np.unique(codes[kept], return_inverse=True)[1].ravel()
    nuisance = _nuisance(linear.arm, angles, codes, refitted)
    freedom = 3 * len(left) - np.linalg.matrix_rank(nuisance) if nuisance.size else 3 * len(left)
    if freedom < 3:
        raise ValueError(
            f"{len(left)} poses have {3 * len(left)} coordinates for "
            f"{3 * len(left) - freedom} freedoms of positions, base and probe: nothing is left to "
            "check the correction with."
        )
    root = _root_of_covariance(linear, angles, weights)
    whiten = _Whitened(root, nuisance)
    residual = whiten(left.ravel())
    tests = _tests(_causes(linear.arm, angles), whiten, residual, freedom)
    p_value = min(float(tests["p_value"].min()) * len(tests), 1.0)
    holds = p_value >= false_alarm_rate
    suspect = "nothing" if holds else _suspect(tests, freedom)
    record = {
        "date": calendar.today().isoformat() if date is None else str(date),
        "n_poses": len(left),
        **_chart(left, codes, weights, root, nuisance, false_alarm_rate),
        "p_value": p_value,
        "suspect": suspect,
    }
    kind = suspect if suspect in _ADVICE else "arm"
    rows = tuple(np.flatnonzero(slipped).tolist())
    return CorrectionCheck(holds, p_value, suspect, _ADVICE[kind], tests, rows, record)


def _root_of_covariance(linear, angles, weights):
    """Lower root of the covariance of what a correction that holds leaves, (3 n, 3 n)."""
    half = (linear.columns(angles) @ linear.half).reshape(3 * len(angles), -1)
    covariance = half @ half.T
    covariance[np.diag_indices(len(covariance))] += linear.noise_variance / np.repeat(weights, 3)
    return cholesky(covariance, lower=True, check_finite=False)


def _slipped(linear, angles, left, codes, kept):
    """Rows too far off for their own expected spread, if they are few."""
    spread = linear.predict(angles, return_std=True)[1]
    sd = np.sqrt(np.square(spread).max(axis=1) + linear.noise_variance)
    own = left
    if codes is not None:  # medians: a slipped pose would pull the mean of its position
        middle = np.stack(
            [np.median(left[codes == code], axis=0) for code in range(codes.max() + 1)]
        )
        own = left - middle[codes]
    far = np.linalg.norm(own, axis=1) > sd * chi.isf(_FALSE_NAMES / len(left), 3)
    far &= kept
    return far if far.sum() <= _MOST_SLIPS * kept.sum() else np.zeros(len(left), bool)


def _nuisance(arm, angles, codes, refitted):
    """Columns (3 n, k) of what is not known of these poses, so that it shows no change."""
    refitted = set(refitted)
    if not refitted <= {"base", "probe"}:
        raise ValueError(f'refitted must name "base" or "probe", got {sorted(refitted)!r}.')
    n = len(angles)
    place = place_columns(arm, angles, with_base=True).reshape(3 * n, 9)
    parts = [np.empty((3 * n, 0))]
    if "probe" in refitted:
        parts.append(place[:, :3])
    if "base" in refitted:
        parts.append(place[:, 3:])
    if codes is not None:
        offsets = (codes[:, None] == np.arange(codes.max() + 1)).astype(float)
        parts.append(np.kron(offsets, np.eye(3)))
    return np.concatenate(parts, axis=1)


class _Whitened:
    """Divide by a root of the covariance, and take out the nuisances."""

    def __init__(self, root, nuisance):
        self.root = root
        basis = solve_triangular(root, nuisance, lower=True, check_finite=False)
        u, size, _ = np.linalg.svd(basis, full_matrices=False)
        self.basis = u[:, size > 1e-10 * size.max(initial=0.0)] if size.size else basis

    def __call__(self, values):
        values = solve_triangular(self.root, values, lower=True, check_finite=False)
        return values - self.basis @ (self.basis.T @ values)


def _causes(arm, angles):
    """What each cause would do to the poses: (3 n, k) columns by name."""
    n, jacobian = len(angles), arm.jacobian(angles)
    causes = {"probe": place_columns(arm, angles, with_base=False).reshape(3 * n, 3)}
    causes["scale"] = arm.forward(angles).reshape(3 * n, 1)
    for j in range(arm.n_joints):
        causes[f"offset of joint {j + 1}"] = jacobian[:, :, j].reshape(3 * n, 1)
        phase = angles[:, [j]] * np.array(_ORDERS)
        waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
        columns = jacobian[:, :, j, None] * waves[:, None]
        causes[f"harmonics of joint {j + 1}"] = columns.reshape(3 * n, -1)
    return causes


def _tests(causes, whiten, residual, freedom):
    """The test of the size of all residuals, and a score test of each cause."""
    rows = [("noise", residual @ residual, freedom)]
    for name, columns in causes.items():
        bare = np.linalg.norm(solve_triangular(whiten.root, columns, lower=True))
        u, size, _ = np.linalg.svd(whiten(columns), full_matrices=False)
        # What the nuisances take up all of is rounding.
        seen = u[:, size > max(1e-6 * bare, _UNSEEN * size.max(initial=0.0))]
        if seen.shape[1]:
            rows.append((name, np.square(seen.T @ residual).sum(), seen.shape[1]))
    dtype = [("cause", "U24"), ("statistic", "f8"), ("freedom", "i4"), ("p_value", "f8")]
    tests = np.array([(*row, 0.0) for row in rows], dtype=dtype)
    tests["p_value"] = chi2.sf(tests["statistic"], tests["freedom"])
    return tests


def _suspect(tests, freedom):
    """The cause that explains most for its numbers (BIC), or "noise" if what it leaves is too much.

    Where the best cause leaves residuals no better than before it is not the cause.
    """
    causes = tests[1:]
    worth = causes["statistic"] - causes["freedom"] * np.log(freedom)
    best = int(np.argmax(worth))
    whole = tests[0]["statistic"]
    too_much = whole - freedom  # what the residuals exceed their expectation by
    if worth[best] <= 0 or causes["statistic"][best] < 0.3 * too_much:
        return "noise"
    return str(causes["cause"][best])


def _chart(left, codes, weights, root, nuisance, rate):
    """Mean and range of the distances, and their limits where the correction holds."""
    basis = np.linalg.qr(nuisance)[0] if nuisance.size else nuisance

    def of(values):  # (3 n, k)
        values = values - basis @ (basis.T @ values)
        distance = np.linalg.norm(values.reshape(len(left), 3, -1), axis=1)
        return distance.mean(axis=0), distance.max(axis=0) - distance.min(axis=0)

    draws = root @ np.random.default_rng(0).normal(size=(len(root), _DRAWS))
    limits = [np.quantile(values, [rate / 2, 1 - rate / 2]).tolist() for values in of(draws)]
    (mean,), (extent,) = of(left.reshape(-1, 1))
    return {
        "mean_mm": float(mean),
        "mean_limits_mm": tuple(limits[0]),
        "range_mm": float(extent),
        "range_limits_mm": tuple(limits[1]),
    }
