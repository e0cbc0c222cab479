"""Does a correction still hold? A test of new poses against what the model expects of them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from copy import copy
from dataclasses import dataclass, field, replace
from datetime import date as calendar
from numbers import Real
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import chi, chi2

from sklearn_raacmm.arm import Arm, one_warning
from sklearn_raacmm.calibration import check_length
from sklearn_raacmm.correction._linear_change import place_columns
from sklearn_raacmm.correction._records import append_record
from sklearn_raacmm.correction._update import check_new_poses, linear_model_of
from sklearn_raacmm.error_model import LinearModel
from sklearn_raacmm.utils import (
    Interval,
    encode_groups,
    group_means,
    listed,
    one_blas_thread,
    show,
    validate_params,
)

# Orders of the harmonics that a knocked or loosened encoder shows first.
_ORDERS = (1, 2)
# Poses that are named as slipped: this many on the average in a set without any; when they are more
# than this share of all, they are no slips.
_FALSE_NAMES, _MOST_SLIPS = 0.01, 0.1
# Poses farther off than this share of all, if errors were normal, count as though they were there:
# those of a real arm have longer tails, of which a single pose must not raise an alarm.
_USUAL = 0.95
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
        distances with the limits `mean_low_mm`, `mean_high_mm`, `range_low_mm` and `range_high_mm`
        that a correction which holds leaves at the same rate, `p_value`, `suspect`.
    """

    holds: bool
    p_value: float
    suspect: str
    advice: str
    tests: np.ndarray = field(repr=False)
    slipped: tuple
    record: dict = field(repr=False)

    def append_to(self, path):
        """Append the record to a file, which is made where there is none.

        Parameters
        ----------
        path : str or path-like
            A CSV file if its name ends in .csv, else one JSON object in each line.

        See Also
        --------
        read_check_records : Reads such a file.
        sklearn_raacmm.display.ControlChartDisplay : Draws it.

        Examples
        --------
        >>> check.append_to("checks_of_arm_7.csv")  # doctest: +SKIP
        """
        append_record(path, self.record)


@one_blas_thread
@validate_params(
    {
        "false_alarm_rate": [Interval(Real, 0, 0.5, closed="neither")],
        "refitted": ["array-like", str],
        "arm": [Arm, None],
        "date": [str, calendar, None],
    },
    prefer_skip_nested_validation=True,
)
@one_warning()
def check_correction(
    model,
    X,
    y,
    *,
    groups=None,
    lengths=(),
    arm=None,
    sample_weight=None,
    refitted=(),
    false_alarm_rate=0.01,
    date=None,
):
    """Say from a few poses of today whether a fitted correction still holds.

    Parameters
    ----------
    model : ArmResidualRegressor
        Fitted model.

    X : array-like of shape (n_samples, n_joints + n_extra)
        Joint angles of today's poses, in the unit that the model takes; then the extra columns that
        it was fitted with.

    y : array-like of shape (n_samples, 3)
        Their residuals in mm, in the arm's base frame, without the correction:
        ``result.residuals(angles, points)`` or :func:`position_residuals`.

    groups : array-like of shape (n_samples,), default=None
        Label of the position of each sample, where each position has an unknown offset.

    lengths : iterable of (label, label, length, standard deviation), default=()
        Known distances between two positions of `groups`, mm, such as of a gauge with poses at both
        ends: tuples or the rows of an array. They show a change of scale, as by temperature.

    arm : Arm, default=None
        The arm with today's probe, which `lengths` are computed with; None: the model's.

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
    the model's posterior and noise, both widened as positions that were left out of the fit ask for
    (`std_scale` and `noise_scale` of its linear model). A known length has one of the same form.
    One test is of the size of all against that; one of each cause, a score test of what that cause
    would do to these poses: the offset and the two lowest harmonics of each joint, the probe, a
    common scale. The smallest p-value times the number of tests is compared with the rate, so that
    the rate is an upper bound (Bonferroni). Poses in regions that the model has not seen may raise
    alarms of their own. A pose that lies farther off than 95 % do counts as though it lay there.

    What cannot be seen is not tested: a single-point test without known lengths has no scale, and
    joint 1 nothing but its harmonics.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, ArmResidualRegressor, check_correction
    >>> arm = Arm.from_name("aacmm6")
    >>> rng = np.random.default_rng(0)
    >>> angles = rng.uniform(-2, 2, (400, 6))
    >>> y = rng.normal(scale=0.01, size=(400, 3))
    >>> model = ArmResidualRegressor(arm, max_order=4).fit(angles, y)
    >>> today = rng.uniform(-2, 2, (30, 6))
    >>> check_correction(model, today, rng.normal(scale=0.01, size=(30, 3))).holds
    True
    >>> knock = arm.jacobian(today)[:, :, 1] * np.deg2rad(20 / 3600)
    >>> check_correction(model, today, knock + rng.normal(scale=0.01, size=(30, 3))).suspect
    'offset of joint 2'
    """
    linear = _widened(linear_model_of(model, "checked"))
    labels = None if groups is None else encode_groups(groups, len(X))[0].tolist()
    lengths = _check_lengths(lengths, labels)
    today = check_new_poses(model, X, y, groups, sample_weight)
    poses, slipped = _poses_of(linear, model, today, lengths, linear.arm if arm is None else arm)
    nuisance = poses.nuisance(refitted)
    n_rows = len(nuisance)
    freedom = n_rows - np.linalg.matrix_rank(nuisance) if nuisance.size else n_rows
    if freedom < 3:
        raise ValueError(
            f"{len(poses.left)} poses have {n_rows} coordinates for {n_rows - freedom} freedoms of "
            "positions, base and probe: nothing is left to check the correction with."
        )
    root = poses.root_of_covariance()
    whiten = _Whitened(root, nuisance)
    tests = _tests(poses.causes(), whiten, whiten(poses.residual()), freedom)
    p_value = min(float(tests["p_value"].min()) * len(tests), 1.0)
    holds = p_value >= false_alarm_rate
    suspect = "nothing" if holds else _suspect(tests, freedom)
    n = 3 * len(poses.left)
    record = {
        "date": calendar.today().isoformat() if date is None else str(date),
        "n_poses": len(poses.left),
        **_chart(poses.left, root[:n, :n], nuisance[:n], false_alarm_rate),
        "p_value": p_value,
        "suspect": suspect,
    }
    kind = suspect if suspect in _ADVICE else "arm"
    rows = tuple(np.flatnonzero(slipped).tolist())
    return CorrectionCheck(holds, p_value, suspect, _ADVICE[kind], tests, rows, record)


def _widened(linear):
    """The model as uncertain as positions left out ask for.

    Never narrower than the posterior: tests of squares bear no tails that are longer than normal
    ones, which a factor below 1 makes up for in intervals.
    """
    wider = max(linear.std_scale, 1.0)
    return replace(
        linear,
        half=wider * linear.half,
        gauge_free_half=wider * linear.gauge_free_half,
        noise_variance=max(linear.noise_scale, 1.0) ** 2 * linear.noise_variance,
    )


def _poses_of(linear, model, today, lengths, arm):
    """Today's poses that count, and which of the rows have slipped."""
    angles, y, weights, codes = today
    shown = arm.forward(angles[:, : arm.n_joints]) if lengths else angles[:, :3]
    correction = copy(model).set_params(angle_unit="rad").predict(angles)
    left = y - correction
    slipped, tamed = _slipped(linear, angles, left, codes, weights)
    kept = (weights > 0) & ~slipped
    poses = _Poses(
        linear, angles[kept], left[kept], tamed[kept], (shown - correction)[kept], weights[kept],
        None if codes is None else codes[kept], lengths,
    )  # fmt: skip
    return poses, slipped


def _check_lengths(lengths, labels):
    """Known lengths as (position, position, mm, mm), positions by their number."""
    lengths = listed("lengths", lengths)
    if lengths and labels is None:
        raise ValueError("lengths are between positions: give groups, the position of each pose.")
    return [check_length(entry, labels) for entry in lengths]


class _Poses(NamedTuple):
    """Poses of today: rows of coordinates, three for each pose, and one for each known length."""

    linear: LinearModel
    angles: np.ndarray  # (n, n_joints)
    left: np.ndarray  # (n, 3) residuals less the correction, mm
    tamed: np.ndarray  # (n, 3) the same without the tails
    corrected: np.ndarray  # (n, 3) points, mm
    weights: np.ndarray  # (n,)
    codes: np.ndarray | None  # (n,) position of each pose
    lengths: list  # of (position, position, mm, mm)

    def rows(self, columns):
        """Columns (n, 3, k) at the poses as rows of coordinates and lengths, (m, k)."""
        flat = columns.reshape(3 * len(columns), -1)
        if not self.lengths:
            return flat
        first, second, line = self._lines()
        difference = self._means(columns)[second] - self._means(columns)[first]
        return np.concatenate([flat, np.einsum("lc,lck->lk", line, difference)])

    def _means(self, values):
        present = np.unique(self.codes)  # all of a position's poses may have slipped
        out = np.full((self.codes.max() + 1, *values.shape[1:]), np.nan)
        dense = np.searchsorted(present, self.codes)
        out[present] = group_means(values, dense, self.weights)
        return out

    def _ends(self):
        """Lengths of which both ends are there."""
        present = set(self.codes.tolist())
        return [entry for entry in self.lengths if {entry[0], entry[1]} <= present]

    def _lines(self):
        first, second = (np.array([entry[i] for entry in self._ends()], dtype=int) for i in (0, 1))
        line = self._means(self.corrected)
        line = line[second] - line[first]
        return first, second, line / np.linalg.norm(line, axis=1, keepdims=True)

    def residual(self):
        """What is left of coordinates and lengths, (m,), mm."""
        if not self.lengths:
            return self.tamed.ravel()
        means = self._means(self.corrected)
        errors = [np.linalg.norm(means[j] - means[i]) - known for i, j, known, _ in self._ends()]
        return np.r_[self.tamed.ravel(), errors]

    def root_of_covariance(self):
        """Lower root of the covariance of what a correction that holds leaves, (m, m)."""
        half = self.rows(self.linear.columns(self.angles)) @ self.linear.half
        noise = self.linear.noise_variance
        variance = noise / np.repeat(self.weights, 3)
        if self.lengths:
            total = np.bincount(self.codes, self.weights)
            of_lengths = [
                noise * (1 / total[i] + 1 / total[j]) + sd**2 for i, j, _, sd in self._ends()
            ]
            variance = np.r_[variance, of_lengths]
        covariance = half @ half.T
        covariance[np.diag_indices(len(covariance))] += variance
        return cholesky(covariance, lower=True, check_finite=False)

    def nuisance(self, refitted):
        """Columns (m, k) of what is not known of these poses, so that it shows no change."""
        refitted = listed("refitted", refitted)
        if not all(isinstance(name, str) and name in ("base", "probe") for name in refitted):
            raise ValueError(f'refitted must name "base" or "probe", got {show(refitted)}.')
        place = place_columns(self.linear.arm, self.angles, with_base=True)
        parts = [np.empty((len(self.residual()), 0))]
        if "probe" in refitted:
            parts.append(self.rows(place[:, :, :3]))
        if "base" in refitted:
            parts.append(self.rows(place[:, :, 3:]))
        if self.codes is not None:
            # The offset of a position is that of its residuals, not of where it is.
            offsets = (self.codes[:, None] == np.unique(self.codes)).astype(float)
            offsets = np.kron(offsets, np.eye(3))
            parts.append(np.pad(offsets, ((0, len(parts[0]) - len(offsets)), (0, 0))))
        return np.concatenate(parts, axis=1)

    def causes(self):
        """What each cause would do to the poses: (m, k) columns by name."""
        arm = self.linear.arm
        angles = self.angles[:, : arm.n_joints]  # without extra columns
        jacobian = arm.jacobian(angles)
        causes = {"probe": self.rows(place_columns(arm, angles, with_base=False))}
        points = arm.forward(angles)
        if self.codes is not None:  # a position is one point: what it shows about it is no scale
            points = self._means(points)[self.codes]
        causes["scale"] = self.rows(points[:, :, None])
        for j in range(arm.n_joints):
            causes[f"offset of joint {j + 1}"] = self.rows(jacobian[:, :, [j]])
            phase = angles[:, [j]] * np.array(_ORDERS)
            waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
            causes[f"harmonics of joint {j + 1}"] = self.rows(
                jacobian[:, :, j, None] * waves[:, None]
            )
        return causes


def _slipped(linear, angles, left, codes, weights):
    """Rows too far off for their own expected spread, if they are few, and residuals without tails.

    Where the distances of all are larger than expected, by a change of the arm, farther ones are
    usual in proportion.
    """
    spread = linear.predict(angles, return_std=True)[1]
    used = weights > 0
    noise = linear.noise_variance / np.where(used, weights, 1.0)
    sd = np.sqrt(np.square(spread).max(axis=1) + noise)
    middle = np.zeros_like(left)
    if codes is not None:  # medians: a slipped pose would pull the mean of its position
        of_position = [np.median(left[codes == code], axis=0) for code in range(codes.max() + 1)]
        middle = np.stack(of_position)[codes]
    distance = np.linalg.norm(left - middle, axis=1) / sd
    far = used & (distance > chi.isf(_FALSE_NAMES / len(left), 3))
    slipped = far if far.sum() <= _MOST_SLIPS * used.sum() else np.zeros(len(left), bool)
    larger = max(np.median(distance[used]) / chi.median(3), 1.0)
    share = np.minimum(chi.ppf(_USUAL, 3) * larger / np.maximum(distance, 1e-300), 1.0)
    return slipped, middle + share[:, None] * (left - middle)


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


def _chart(left, root, nuisance, rate):
    """Mean and range of the distances, and their limits where the correction holds."""
    basis = np.linalg.qr(nuisance)[0] if nuisance.size else nuisance

    def of(values):  # (3 n, k)
        values = values - basis @ (basis.T @ values)
        distance = np.linalg.norm(values.reshape(len(left), 3, -1), axis=1)
        return distance.mean(axis=0), distance.max(axis=0) - distance.min(axis=0)

    draws = root @ np.random.default_rng(0).normal(size=(len(root), _DRAWS))
    record = {}
    found = zip(("mean", "range"), of(left.reshape(-1, 1)), of(draws), strict=True)
    for name, values, drawn in found:
        low, high = np.quantile(drawn, [rate / 2, 1 - rate / 2]).tolist()
        record |= {
            f"{name}_mm": float(values[0]),
            f"{name}_low_mm": low,
            f"{name}_high_mm": high,
        }
    return record
