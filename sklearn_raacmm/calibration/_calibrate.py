"""The arm's static parameters, identified from what its user can measure."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import warnings
from dataclasses import dataclass, field
from numbers import Real

import numpy as np

from sklearn_raacmm.arm import FIELDS, MAX_LENGTH_MM, Arm, check_angles, reach_mm
from sklearn_raacmm.calibration._identification import MAX_ROUNDS, WEIGHTS, Fit, Problem, pack
from sklearn_raacmm.utils import encode_groups, floats, one_blas_thread, refuse_huge

# Standard deviations of a coordinate: a normal error is longer once in 65 000.
_OUTLIER = 5.0
# A parameter whose standard deviation the data did not halve is the prior's, not the data's.
_IDENTIFIED = 0.5
# A picometre: smaller than any length is known, large enough to divide by.
_LEAST_SD_MM = 1e-9
# What no calibration of an arm comes to: prior standard deviations of a parameter; scatter, as a
# part of the reach; a reach.
_FAR = 10.0
_SHARE_OF_REACH = 0.02
_LEAST_REACH_MM = 20.0
# Priors beyond these are a slip of the pen, or would overflow: hold a field by leaving it out.
_LARGEST_PRIOR = 1e9


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """What a calibration found, and what it could not find.

    Attributes
    ----------
    arm : Arm
        The calibrated arm.
    names : tuple of str
        Names of the parameters: the field of `Arm` and the row of the table from 1, such as
        ``"a2"`` or ``"theta_offset4"``, and ``"probe_x"`` to ``"probe_z"``.
    nominal, values : ndarray of shape (n_parameters,)
        Before and after, mm and rad.
    standard_deviations : ndarray of shape (n_parameters,)
        Of `values`, the prior included, mm and rad; 0 for parameters that were not free. They
        suppose independent errors: where the arm bends, they are too small.
    unidentified : tuple of str
        Parameters that stay where the prior has them because the data do not know better, and
        ``"scale"`` if this is so of the common scale of all links.
    scale_sd : float
        Relative standard deviation of the common scale of all links.
    scatter_given_mm : float
        Scatter with the arm as it was given.
    scatter_before_mm : float
        Scatter with nothing but the probe fitted (and the base, for measured points).
    scatter_after_mm : float
        Scatter of the calibrated arm: the mean distance of the points, outliers included, from the
        mean of their group, or from their measured positions.
    residuals_mm : ndarray of shape (n_samples, 3)
        Those differences, in the arm's base frame.
    length_errors_mm : ndarray of shape (n_lengths,)
        Distances between the centres of groups less the known lengths.
    sigma_mm : float
        Standard deviation of one coordinate that the fit found and weighted with.
    outliers : tuple of int
        Rows farther than 5 `sigma_mm` from where they belong (the weighted mean of their group,
        which they hardly pull), the farthest first.
    groups : ndarray of shape (n_samples,) or None
        The labels, as given.
    base_rotation, base_translation : ndarray of shape (3, 3) and (3,), or None
        For measured points, the arm's base in their frame:
        ``points = arm.forward(angles) @ base_rotation.T + base_translation``.
    converged : bool
        Whether weights and parameters settled.

    See Also
    --------
    calibrate : Makes one.
    """

    arm: Arm
    names: tuple = field(repr=False)
    nominal: np.ndarray = field(repr=False)
    values: np.ndarray = field(repr=False)
    standard_deviations: np.ndarray = field(repr=False)
    unidentified: tuple
    scale_sd: float
    scatter_given_mm: float
    scatter_before_mm: float
    scatter_after_mm: float
    residuals_mm: np.ndarray = field(repr=False)
    length_errors_mm: np.ndarray = field(repr=False)
    sigma_mm: float
    outliers: tuple
    groups: np.ndarray | None = field(repr=False)
    base_rotation: np.ndarray | None = field(repr=False)
    base_translation: np.ndarray | None = field(repr=False)
    converged: bool

    def __str__(self):
        lines = [
            f"Calibration of {self.arm!r}, {len(self.residuals_mm)} points",
            f"mean scatter: {self.scatter_given_mm:.4g} mm as given, "
            f"{self.scatter_before_mm:.4g} mm with the probe fitted, "
            f"{self.scatter_after_mm:.4g} mm calibrated",
            f"common scale of the links: +-{100 * self.scale_sd:.2g} %",
            f"{'parameter':<15}{'nominal':>12}{'value':>12}{'sd':>11}",
        ]
        for name, nominal, value, sd in zip(
            self.names, self.nominal, self.values, self.standard_deviations, strict=True
        ):
            angle = name.startswith(("alpha", "theta"))
            factor, unit = (180 / np.pi, "deg") if angle else (1.0, "mm")
            note = "  not identified" if name in self.unidentified else ""
            numbers = f"{nominal * factor:12.4f}{value * factor:12.4f}"
            sd_text = f"{sd * factor:11.4f}" if sd else f"{'held':>11}"
            lines.append(f"{name:<15}{numbers}{sd_text} {unit}{note}")
        distance = np.linalg.norm(self.residuals_mm, axis=1)
        lines.append(f"outliers beyond {_OUTLIER * self.sigma_mm:.3g} mm: {len(self.outliers)}")
        for row in self.outliers[:10]:
            label = "" if self.groups is None else f" ({self.groups[row]})"
            lines.append(f"  row {row}{label}: {distance[row]:.3g} mm")
        if len(self.outliers) > 10:
            lines.append(f"  and {len(self.outliers) - 10} more")
        return "\n".join(lines)


@one_blas_thread
def calibrate(
    arm,
    angles,
    groups=None,
    *,
    points=None,
    lengths=(),
    free=FIELDS,
    loss="soft_l1",
    prior_length=2.0,
    prior_angle=0.02,
    prior_probe=1000.0,
    angle_unit="rad",
):
    """Identify the static parameters of an arm.

    Either from a single-point test, where the points of one group coincide (a ball in a socket, a
    probe in a cone), with or without known lengths between groups; or from positions that a
    tracker measured, in an unknown frame, of an unknown point of the last link.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    angles : array-like of shape (n_samples, n_joints)
        Joint angles.
    groups : array-like of shape (n_samples,), default=None
        Label of the fixed point of each sample. Needed unless `points` is given.
    points : array-like of shape (n_samples, 3), default=None
        Measured positions in mm, instead of `groups`.
    lengths : iterable of (label, label, length, standard deviation), default=()
        Known distances between the fixed points of two groups, mm.
    free : iterable of str, default=("a", "alpha", "d", "theta_offset", "probe")
        Fields of `arm` that may change.
    loss : {"soft_l1", "huber", "cauchy", "linear"}, default="soft_l1"
        How the distance of a point counts; "linear" is plain least squares.
    prior_length, prior_angle, prior_probe : float, default=2 mm, 0.02 rad, 1000 mm
        Standard deviations of the true `a` and `d`, `alpha` and `theta_offset`, and `probe` about
        those of `arm`. They decide only what the data leave open.
    angle_unit : {"rad", "deg"}, default="rad"
        Unit of `angles`.

    Returns
    -------
    CalibrationResult
        The calibrated arm, the parameters with their standard deviations, those that could not be
        identified, the scatter before and after, and the outliers.

    Raises
    ------
    ValueError
        If shapes, labels or numbers do not fit together.

    Warns
    -----
    UserWarning
        If groups of one point say nothing, if a known length disagrees with the rest of the data,
        if the fit did not converge, or if it makes no sense: points that scatter by more than 2 %
        of the reach or twice as much as before, a parameter ten prior standard deviations from its
        nominal value, an arm that reaches less than 20 mm.

    Notes
    -----
    Minimised are the squared distances of the points from the mean of their group (variable
    projection: the fixed points are no parameters), over the variance of a coordinate, which is
    found along with the rest, plus the squares of the errors of the known lengths and of the
    departures from the nominal arm over theirs. Robust losses weigh whole points, so that the
    result does not depend on the directions of the axes, and known lengths.

    A single-point test cannot see the common scale of all lengths, but a smaller arm scatters
    less, so that least squares alone would shrink it. The distances are therefore divided by the
    scale of the links: the prior, or known lengths, alone decide the scale.

    The parameters of two parallel axes in a row (UR10) depend on each other; the prior chooses.
    A fifth parameter for such axes (Hayati) is left out: on a UR10 measured by a tracker it
    lowered the mean deviation by 0.6 %.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, calibrate
    >>> truth = Arm.from_name("aacmm6")
    >>> nominal = truth.replace(a=truth.a.round(0), d=truth.d.round(0))
    >>> rng = np.random.default_rng(0)
    >>> angles = rng.uniform(-2, 2, (200, 6))
    >>> tracker = truth.forward(angles)[:, [1, 2, 0]] + [1000, 0, 0]
    >>> tracker += rng.normal(0, 0.02, tracker.shape)
    >>> result = calibrate(nominal, angles, points=tracker)
    >>> result.scatter_before_mm > 0.2, result.scatter_after_mm < 0.04
    (True, True)
    >>> bool(np.abs(result.arm.d[2] - truth.d[2]) < 0.02)
    True
    """
    lengths = _listed("lengths", lengths)
    free = _listed("free", free)
    angles, problem = _check(
        arm, angles, groups, points, lengths, free, loss, angle_unit,
        {"prior_length": prior_length, "prior_angle": prior_angle, "prior_probe": prior_probe},
    )  # fmt: skip
    n = arm.n_joints
    prior_sd = np.repeat([prior_length, prior_angle] * 2 + [prior_probe], [n, n, n, n, 3])
    names = tuple(f"{f}{i + 1}" for f in FIELDS[:-1] for i in range(n))
    names += ("probe_x", "probe_y", "probe_z")
    is_free = np.repeat([f in set(free) for f in FIELDS], [n, n, n, n, 3])
    is_probe = np.arange(len(names)) >= 4 * n
    nominal = pack(arm)

    fit = Fit(arm, angles, problem, nominal, prior_sd, loss)
    fit.run(np.zeros_like(is_free))
    given = fit.distances().mean()
    fit.run(is_free & is_probe)
    before = fit.distances().mean()
    # The deviations of an uncalibrated arm are no noise: forget their size and weights.
    fit.reset_weights()
    fit.run(is_free)

    sd, scale_sd, scale_prior_sd = fit.uncertainty(is_free)
    open_ = is_free & (sd > _IDENTIFIED * prior_sd)
    unidentified = tuple(name for name, is_open in zip(names, open_, strict=True) if is_open)
    if scale_sd > _IDENTIFIED * scale_prior_sd:
        unidentified += ("scale",)
    if not fit.converged:
        warnings.warn(
            f"the calibration did not settle in {MAX_ROUNDS} rounds; "
            f"its scatter is {fit.distances().mean():.4g} mm.",
            UserWarning,
            stacklevel=3,  # past the decorator
        )
    length_errors = fit.length_errors()
    _warn_of_wrong_lengths(lengths, length_errors, fit.sigma)
    distance = fit.distances()
    _warn_of_what_no_arm_is(
        arm, names, nominal, fit.x[: len(names)], np.where(is_free & ~is_probe, prior_sd, np.inf),
        before, distance.mean(),
    )  # fmt: skip
    # Outliers are farther from their weighted mean: the plain one, they draw towards themselves.
    robust = fit.robust_distances()
    farthest = np.argsort(-robust, kind="stable")
    return CalibrationResult(
        arm=fit.arm(),
        names=names,
        nominal=nominal,
        values=fit.x[: len(names)],
        standard_deviations=sd,
        unidentified=unidentified,
        scale_sd=scale_sd,
        scatter_given_mm=float(given),
        scatter_before_mm=float(before),
        scatter_after_mm=float(distance.mean()),
        residuals_mm=fit.residuals(),
        length_errors_mm=length_errors,
        sigma_mm=float(fit.sigma),
        outliers=tuple(int(i) for i in farthest if robust[i] > _OUTLIER * fit.sigma),
        groups=None if groups is None else np.asarray(groups),
        base_rotation=None if points is None else fit.rotation,
        base_translation=None if points is None else fit.x[len(names) + 3 :].copy(),
        converged=fit.converged,
    )


def _warn_of_wrong_lengths(lengths, errors, sigma):
    wrong = [
        f"{first} to {second} is {length + error:.6g} mm, given as {length:g} +- {sd:g} mm"
        for (first, second, length, sd), error in zip(lengths, errors, strict=True)
        if abs(error) > _OUTLIER * max(sd, sigma)
    ]
    if wrong:
        warnings.warn(
            f"{len(wrong)} of {len(lengths)} known lengths disagree with the rest of the data: "
            f"{'; '.join(wrong[:3])}{'; ...' if len(wrong) > 3 else ''}.",
            UserWarning,
            stacklevel=4,
        )


def _warn_of_what_no_arm_is(arm, names, nominal, values, prior_sd, before, after):
    """Say that a fit which has settled makes no sense: wrong input can be fitted, too."""
    signs = []
    reach = reach_mm(arm)
    if reach < _LEAST_REACH_MM:
        signs.append(
            f"The nominal arm reaches {reach:.3g} mm: are its lengths in metres, not millimetres?"
        )
    departure = np.abs(values - nominal) / prior_sd
    worst = int(np.argmax(departure))
    if departure[worst] > _FAR:
        angle = names[worst].startswith(("alpha", "theta"))
        unit = "rad" if angle else "mm"
        signs.append(
            f"{names[worst]} is {values[worst]:.6g} {unit}, nominally {nominal[worst]:.6g} {unit}, "
            f"{departure[worst]:.3g} times the prior standard deviation away: look at the known "
            "lengths, their unit, and the nominal table."
        )
    if after > min(_SHARE_OF_REACH * reach, 2 * before + 1e-6 * reach):
        signs.append(
            f"The points still scatter by {after:.4g} mm ({before:.4g} mm before; the arm reaches "
            f"{reach:.4g} mm): look at the labels, known lengths, the order and sense of the "
            "joints, the convention of the table, and the unit of the angles."
        )
    if signs:
        warnings.warn(" ".join(signs), UserWarning, stacklevel=4)


def _check(arm, angles, groups, points, lengths, free, loss, angle_unit, priors):
    if not isinstance(arm, Arm):
        raise TypeError(f"arm must be an Arm, got {type(arm).__name__}.")
    angles = check_angles(angles, arm.n_joints, angle_unit, stacklevel=5)
    # Within one turn, lest a warning of far angles be said again by everything that follows.
    angles = np.remainder(angles + np.pi, 2 * np.pi) - np.pi
    n = len(angles)
    if n == 0:
        raise ValueError("angles are empty: there is nothing to calibrate with.")
    if (groups is None) == (points is None):
        raise ValueError("give either groups, or points measured by a tracker.")
    if not all(isinstance(name, str) and name in FIELDS for name in free):
        raise ValueError(f"free must name some of {FIELDS}, got {free!r}.")
    if not (isinstance(loss, str) and loss in WEIGHTS):
        raise ValueError(f"loss must be one of {sorted(WEIGHTS)}, got {loss!r}.")
    for name, value in priors.items():
        if not (isinstance(value, Real) and 1 / _LARGEST_PRIOR <= value <= _LARGEST_PRIOR):
            raise ValueError(
                f"{name} must be a positive number from {1 / _LARGEST_PRIOR:g} to "
                f"{_LARGEST_PRIOR:g}, got {value!r}."
            )
    if points is not None:
        points = floats("points", points)
        if points.shape != (n, 3):
            raise ValueError(f"points must have shape ({n}, 3), got {points.shape}.")
        if not np.all(np.isfinite(points)):
            row = np.argwhere(~np.isfinite(points))[0, 0]
            raise ValueError(f"points hold NaN or infinity, first in row {row}.")
        refuse_huge("points", points)
        if lengths:
            raise ValueError("lengths are between groups; measured points have no use for them.")
        return angles, Problem(None, points, [])
    labels, index = encode_groups(groups, n)
    labels = labels.tolist()
    lengths = [check_length(entry, labels) for entry in lengths]
    problem = Problem(index, None, lengths)
    if problem.n_informative == 0:
        raise ValueError(f"each of the {len(labels)} groups has one point: none can scatter.")
    tied = {i for entry in lengths for i in entry[:2]}
    lonely = [i for i, c in enumerate(np.bincount(index)) if c == 1 and i not in tied]
    if lonely:
        warnings.warn(
            f"{len(lonely)} groups have one point and say nothing, such as {labels[lonely[0]]}.",
            UserWarning,
            stacklevel=4,
        )
    return angles, problem


def _listed(name, value):
    """Several, as a list; one text is not several letters."""
    try:
        return [value] if isinstance(value, str) else list(value)
    except TypeError:
        raise ValueError(f"{name} must be a list, got {value!r}.") from None


def check_length(entry, labels):
    try:
        first, second, length, sd = entry
        length, sd = float(length), float(sd)
    except (TypeError, ValueError):
        raise ValueError(
            f"each of lengths must be (label, label, length, standard deviation), got {entry!r}."
        ) from None
    for label in (first, second):
        if label not in labels:
            raise ValueError(f"lengths name the group {label!r}, which has no samples.")
    in_bounds = 0 < length <= 2 * MAX_LENGTH_MM and _LEAST_SD_MM <= sd < np.inf
    if not in_bounds or first == second:
        raise ValueError(
            f"a length must join two different groups, it must be positive and at most "
            f"{2 * MAX_LENGTH_MM:g} mm and its standard deviation at least {_LEAST_SD_MM:g} mm, "
            f"got {entry!r}."
        )
    return labels.index(first), labels.index(second), length, sd
