"""The arm's static parameters, identified from what its user can measure."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence
from dataclasses import replace
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from sklearn_raacmm.arm import FIELDS, Arm, reach_mm
from sklearn_raacmm.calibration._checks import (
    check_arm_angles,
    check_free,
    check_problem,
    checked_correction,
    table_findings,
    warn_of_few_rows,
    warn_of_harm,
    warn_of_what_no_arm_is,
    warn_of_wrong_lengths,
)
from sklearn_raacmm.calibration._fit import MAX_ROUNDS, WEIGHTS, Fit, doubt_limit, outlier_limit
from sklearn_raacmm.calibration._gate import (
    check_fit,
    named_outliers,
    one_row_a_pose,
    per_row,
    slips,
    wrong_units,
)
from sklearn_raacmm.calibration._observability import observability
from sklearn_raacmm.calibration._problem import (
    ANGLES_RAD,
    LONG_MM,
    SHORT_MM,
    UNKNOWN_PLACE_MM,
    are_long,
    pack,
)
from sklearn_raacmm.calibration._result import CalibrationResult, is_angle
from sklearn_raacmm.utils import (
    Finding,
    Interval,
    StrOptions,
    listed,
    one_blas_thread,
    say_findings,
    validate_params,
    with_findings,
)

# A parameter whose standard deviation the data did not halve is the prior's, not the data's.
_IDENTIFIED = 0.5
# Kinds of parameters, by the name of their prior standard deviation, and how it is found.
_KINDS = ("length_mm", "angle_rad", "probe_mm", "short_length_mm")
_FOUND = (LONG_MM, ANGLES_RAD, None, SHORT_MM)
# Departures from the table that are said, mm and rad: more than a tape and a protractor get wrong.
_FAR_MM, _FAR_RAD = 10.0, 0.1
# The same, in standard deviations of a prior that was given.
_FAR_PRIORS = 10.0
# Priors beyond these are a slip of the pen, or would overflow: hold a field by leaving it out.
_LEAST_PRIOR, _LARGEST_PRIOR = 1e-9, 1e9
# What counts as knowing nothing of a base, a reach and a turn of one radian.
_BASE_MM, _BASE_RAD = UNKNOWN_PLACE_MM, 1.0
_BASE_COORDINATES = ("rx", "ry", "rz", "x", "y", "z")
# A correction depends on the probe that is fitted through it: two rounds as a rule.
_MOST_MOVES, _SETTLED_MM = 5, 1e-6
_PRIOR = [Interval(Real, _LEAST_PRIOR, _LARGEST_PRIOR, closed="both")]


@one_blas_thread
@validate_params(
    {
        "arm": [Arm],
        "loss": [StrOptions(set(WEIGHTS))],
        "prior_length_mm": [*_PRIOR, StrOptions({"auto"})],
        "prior_angle_rad": [*_PRIOR, StrOptions({"auto"})],
        "prior_probe_mm": _PRIOR,
        "angle_unit": [StrOptions({"rad", "deg"})],
    },
    prefer_skip_nested_validation=True,
)
@with_findings
def calibrate(
    arm: Arm,
    angles: ArrayLike,
    groups: ArrayLike | None = None,
    *,
    points: ArrayLike | None = None,
    lengths: Iterable[Sequence[Any]] = (),
    tools: ArrayLike | None = None,
    stations: ArrayLike | None = None,
    correction: Any = None,
    free: Iterable[str] = FIELDS,
    loss: str = "soft_l1",
    prior_length_mm: float | str = "auto",
    prior_angle_rad: float | str = "auto",
    prior_probe_mm: float = UNKNOWN_PLACE_MM,
    angle_unit: str = "rad",
) -> CalibrationResult:
    """Identify the static parameters of an arm.

    Either from a single-point test, where the points of one group coincide (a ball in a socket, a
    probe in a cone), with or without known lengths between groups; or from positions that a tracker
    measured, in an unknown frame, of an unknown point of the last link.

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
        Known distances between the fixed points of two groups, mm: tuples or the rows of an array.
    tools : array-like of shape (n_samples,), default=None
        Label of the tool of each sample, where several probes or targets were used in turn: each
        has a probe vector of its own.
    stations : array-like of shape (n_samples,), default=None
        Label of the set-up of each sample, where the tracker or the arm was moved: each has a base
        of its own. For `points` only.
    correction : object, default=None
        Fitted model of the arm's residuals, such as :class:`ArmResidualRegressor`: what its
        ``predict(angles)`` gives, (n_samples, 3) in mm, is subtracted from the arm's points. Needed
        wherever the correction will be used with the result.
    free : iterable of str, default=("a", "alpha", "d", "theta_offset", "probe")
        Fields of `arm` that may change.
    loss : {"soft_l1", "huber", "cauchy", "squared"}, default="soft_l1"
        How the distance of a point counts; "squared" is plain least squares.
    prior_length_mm, prior_angle_rad : float or "auto", default="auto"
        Standard deviations of the true `a` and `d`, and `alpha` and `theta_offset`, about those of
        `arm`. They decide only what the data leave open. "auto" finds them by the evidence, for
        long and short lengths apart.
    prior_probe_mm : float, default=1000
        Standard deviation of the true probe about that of `arm`.
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
    TypeError
        If `arm` is not an Arm, or `correction` has no method predict.

    Warns
    -----
    FindingWarning
        Of what is found in the data, such as too few rows for the free parameters, a known length
        that disagrees, poses that are too much alike, a set-up that has moved, a correction that
        does harm, a table that is far off, or a fit that makes no sense; see ``result.findings``.

    Notes
    -----
    Minimised are the squared distances of the points from the mean of their group (variable
    projection: the fixed points are no parameters), over the variance of a coordinate, which is
    found along with the rest, plus the squares of the errors of the known lengths and of the
    departures from the nominal arm over theirs. Robust losses weigh whole points, so that the
    result does not depend on the directions of the axes, and known lengths.

    A single-point test cannot see the common scale of all lengths, but a smaller arm scatters less,
    so that least squares alone would shrink it. The distances are therefore divided by the scale of
    the links: the prior, or known lengths, alone decide the scale.

    Prior standard deviations are those of MacKay's fixed point: the sum of squares of the
    departures over the number of parameters that the data determine. Long lengths, of at least a
    quarter of the longest, and short ones have one each: a forgotten offset of 60 mm must not widen
    what is believed of the links, which carry the scale. With few data they are drawn to 0.4 mm,
    0.3 mm and 0.003 rad (``benchmarks/bench_lengths.py scale``).

    The parameters of two parallel axes in a row (UR10) depend on each other; the prior chooses.

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
    lengths, free = listed("lengths", lengths), check_free(free)
    if correction is not None:
        correction = checked_correction(correction, angles, angle_unit)
    angles = check_arm_angles(arm, angles, angle_unit)
    problem, tool_labels, station_labels = check_problem(
        angles, groups, points, lengths, tools, stations
    )
    poses, angles, problem = one_row_a_pose(angles, problem)
    say_findings(wrong_units(arm, angles, problem))
    if correction is not None:
        correction = correction.of_poses(poses)
        problem.correction = correction.at([arm.probe] * problem.n_tools, problem)

    priors = (prior_length_mm, prior_angle_rad, prior_probe_mm)
    wanted = _Parameters.of(arm, tool_labels, free, priors)
    fit, given, before = _fitted(arm, angles, problem, wanted, loss)
    if correction is not None:
        _settle(fit, wanted, correction)
    if not fit.converged:
        said = (
            f"the calibration did not settle in {MAX_ROUNDS} rounds; "
            f"its scatter is {fit.distances().mean():.4g} mm."
        )
        say_findings([Finding("not-settled", said, size_mm=fit.distances().mean())])
    warn_of_wrong_lengths(lengths, fit.length_errors(), fit.sigma)
    result = _result(fit, wanted, tool_labels, station_labels, given, before, groups)
    if not warn_of_what_no_arm_is(arm, before, result.scatter_after_mm):
        values, sd = (v[: len(wanted.names)] for v in (result.values, result.standard_deviations))
        far = wanted.far(priors)
        say_findings(
            table_findings(
                wanted.names, wanted.nominal, values, sd, far, lengths, result.scatter_after_mm
            )
        )
    if correction is not None:
        bare, *_ = _fitted(arm, angles, replace(problem, correction=None), wanted, loss)
        warn_of_harm(fit.distances(), bare.distances())
    check_fit(fit, fit.mask_of(wanted.is_free), poses, groups)
    result = per_row(result, poses)
    say_findings(named_outliers(result))
    return result


class _Parameters(NamedTuple):
    """The parameters of table and probes: arrays with one entry for each."""

    names: list
    nominal: np.ndarray
    kind: np.ndarray  # number in KINDS
    is_free: np.ndarray
    prior_sd: np.ndarray
    families: list  # of those whose prior is found, as `Fit` takes them

    @classmethod
    def of(cls, arm, tool_labels, free, priors):
        names, nominal = _parameters(arm, tool_labels)
        kind = np.array([2 if n.startswith("probe") else int(is_angle(n)) for n in names])
        kind[kind == 0] = np.where(are_long(nominal[kind == 0]), 0, 3)
        length, angle, probe_mm = priors
        wanted = list(enumerate(zip((length, angle, probe_mm, length), _FOUND, strict=True)))
        sd = [found[0] if sd == "auto" and found else sd for _, (sd, found) in wanted]
        families = [(np.flatnonzero(kind == i), found) for i, (sd, found) in wanted if sd == "auto"]
        field_of = np.array([name.split("[")[0].rstrip("0123456789") for name in names])
        is_free = np.isin(field_of, list(set(free) - {"probe"}))
        is_free |= (kind == 2) & ("probe" in free)
        return cls(names, nominal, kind, is_free, np.array(sd, dtype=float)[kind], families)

    def far(self, priors):
        """Departure of each parameter from the table that is worth a word."""
        length, angle, _ = priors
        far_mm = _FAR_MM if length == "auto" else _FAR_PRIORS * length
        far_rad = _FAR_RAD if angle == "auto" else _FAR_PRIORS * angle
        far = np.array([far_mm, far_rad, np.inf, far_mm])[self.kind]
        return np.where(self.is_free, far, np.inf)


def _fitted(arm, angles, problem, wanted, loss):
    """The fit, and the scatter of the arm as given and with nothing but probe and base fitted."""
    fit = Fit(arm, angles, problem, wanted.nominal, wanted.prior_sd, loss, wanted.families)
    fit.run(np.zeros_like(wanted.is_free))
    given = fit.distances().mean()
    fit.run(wanted.is_free & (wanted.kind == 2))
    before = fit.distances().mean()
    # The deviations of an uncalibrated arm are no noise: forget their size and weights.
    fit.reset_weights()
    fit.run(wanted.is_free)
    return fit, given, before


def _settle(fit, wanted, correction):
    """Fit again with the correction of the probes that were found, until it stays."""
    problem = fit.problem
    for _ in range(_MOST_MOVES):
        probes = [fit.arm(tool).probe for tool in range(problem.n_tools)]
        moved = correction.at(probes, problem)
        if np.abs(moved - problem.correction).max() < _SETTLED_MM:
            return
        fit.correct_by(moved)
        fit.run(wanted.is_free)


def _parameters(arm, tool_labels):
    """Names and nominal values of the table and the probes."""
    n = arm.n_joints
    names = [f"{f}{i + 1}" for f in FIELDS[:-1] for i in range(n)]
    labels = [""] if tool_labels is None else [f"[{label}]" for label in tool_labels]
    names += [f"probe_{axis}{label}" for label in labels for axis in "xyz"]
    return names, np.concatenate([pack(arm), *[arm.probe] * (len(labels) - 1)])


def _result(fit, wanted, tool_labels, station_labels, given, before, groups):
    """Everything that is to be known of a fit that has settled."""
    problem, names, kind = fit.problem, wanted.names, wanted.kind
    mask = fit.mask_of(wanted.is_free)
    all_names = _all_names(fit, names, station_labels)
    rows, limit, weight = _outliers(fit)
    values = fit.x.copy()
    for s in range(problem.n_stations):
        values[fit.base_columns(s)[:3]] = Rotation.from_matrix(fit.rotations[s]).as_rotvec()
    shifts = [values[fit.base_columns(s)[3:]] for s in range(problem.n_stations)]
    stations = list(zip(fit.rotations, shifts, strict=True))
    return CalibrationResult(
        arm=fit.arm(),
        names=tuple(all_names),
        nominal=np.r_[fit.nominal, np.full(len(all_names) - len(names), np.nan)],
        values=values,
        prior_sd={
            name: float(fit.prior_sd[kind == i][0])
            for i, name in enumerate(_KINDS)
            if np.any(kind == i)
        },
        n_coordinates=max(problem.n_coordinates, 0),
        scatter_given_mm=float(given),
        scatter_before_mm=float(before),
        scatter_after_mm=float(fit.distances().mean()),
        residuals_mm=fit.residuals(slips(fit)),
        length_errors_mm=fit.length_errors(),
        sigma_mm=float(fit.sigma),
        outliers=rows,
        outlier_limit_mm=limit,
        sample_weight=weight,
        groups=None if groups is None else np.asarray(groups),
        arms=_by_label(tool_labels, map(fit.arm, range(problem.n_tools))),
        bases=_by_label(station_labels, stations),
        base_rotation=stations[0][0] if stations else None,
        base_translation=stations[0][1] if stations else None,
        converged=fit.converged,
        **_identified(fit, mask, all_names),
    )


def _all_names(fit, names, station_labels):
    """Names of all parameters x: of the table, the probes and the bases."""
    labels = [""] if station_labels is None else [f"[{label}]" for label in station_labels]
    labels = labels[: fit.problem.n_stations]
    return [*names, *(f"base_{c}{at}" for at in labels for c in _BASE_COORDINATES)]


def _identified(fit, mask, x_names):
    """What the data say of the free parameters, as fields of a `CalibrationResult`."""
    free_names = [name for name, is_in in zip(x_names, mask, strict=True) if is_in]
    angle = np.array([is_angle(name) for name in x_names])
    wide = np.where(angle, _BASE_RAD, _BASE_MM)
    wide[: len(fit.nominal)] = fit.prior_sd
    unit = np.where(angle, 1 / max(reach_mm(fit.nominal_arm), 1e-3), 1.0)
    seen = observability(fit.data_jacobian(mask), free_names, wide[mask], unit[mask], fit.sigma)
    warn_of_few_rows(seen, free_names, fit.problem)
    sd, scale_sd, scale_is_open = _standard_deviations(fit, mask)
    if seen.rank and fit.problem.n_coordinates <= seen.rank:  # nothing to tell the noise from
        sd[mask], scale_sd = np.nan, np.nan
    is_open = mask & ~(sd <= _IDENTIFIED * wide) & ~np.isnan(sd)
    unidentified = tuple(name for name, is_in in zip(x_names, is_open, strict=True) if is_in)
    return {
        "standard_deviations": sd,
        "unidentified": unidentified + (("scale",) if scale_is_open else ()),
        "unidentified_combinations": seen.open_combinations,
        "rank": seen.rank,
        "n_free": len(free_names),
        "condition_number": seen.condition_number,
        "observability_index": seen.o1,
        "scale_sd": scale_sd,
    }


def _outliers(fit):
    """Outliers, the farthest first, from which distance on, and the weight of each row."""
    # Outliers are farther from their weighted mean: the plain one, they draw towards themselves.
    robust = fit.robust_distances()
    informative = robust[fit.problem.informative]
    limit = outlier_limit(informative, fit.sigma)
    farthest = np.argsort(-robust, kind="stable")
    rows = tuple(int(i) for i in farthest if robust[i] > limit)
    weight = np.where(robust > min(limit, doubt_limit(informative, fit.sigma)), 0.0, 1.0)
    return rows, float(limit), weight


def _by_label(labels, values):
    return {} if labels is None else dict(zip(labels.tolist(), values, strict=True))


def _standard_deviations(fit, mask):
    """Of all parameters x and of their common scale, and whether the scale is the prior's."""
    sd = np.zeros(len(mask))
    if not mask.any():
        return sd, 0.0, False
    covariance = fit.covariance(mask)
    sd[mask] = np.sqrt(np.diag(covariance))
    n = len(fit.nominal)
    is_free = mask[:n]
    if not is_free.any():
        return sd, 0.0, False
    scale, of_free = fit.scale[is_free], slice(0, is_free.sum())
    scale_sd = float(np.sqrt(scale @ covariance[of_free, of_free] @ scale))
    prior = float(np.linalg.norm(scale * fit.prior_sd[is_free]))
    return sd, scale_sd, prior > 0 and scale_sd > _IDENTIFIED * prior
