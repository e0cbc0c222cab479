"""The arm's static parameters, identified from what its user can measure."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import chain
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration._checks import (
    check_measured,
    inputs_of_model,
    predicted,
    wrong_units,
)
from sklearn_raacmm.calibration._findings import findings_of_fit, outliers
from sklearn_raacmm.calibration._fit import UNKNOWN_PLACE_MM, WEIGHTS, TableFit
from sklearn_raacmm.calibration._labels import MOST_ROWS, places_of
from sklearn_raacmm.calibration._result import CalibrationResult
from sklearn_raacmm.calibration._worth import result_of
from sklearn_raacmm.measurements import Measurements, find_poses, within_turn
from sklearn_raacmm.utils import Finding, listed, one_blas_thread, one_warning, param_checks, stage

# Priors beyond these are a slip of the pen, or would overflow: hold a field by leaving it out.
_LEAST_PRIOR, _LARGEST_PRIOR = 1e-9, 1e9
# A correction depends on the probe that is fitted through it: two rounds as a rule.
_MOST_MOVES, _SETTLED_MM = 5, 1e-6
_NO_LABELS = "give groups, the label of each row, or points that were measured."
_PRIOR = [
    param_checks.Interval(Real, _LEAST_PRIOR, _LARGEST_PRIOR, closed="both"),
    param_checks.StrOptions({"auto"}),
]


@one_blas_thread
@param_checks.validate_params(
    {
        "arm": [Arm],
        "loss": [param_checks.StrOptions(set(WEIGHTS))],
        "prior_length_mm": _PRIOR,
        "prior_angle_rad": _PRIOR,
        "angle_unit": [param_checks.StrOptions({"rad", "deg"})],
        "tip_diameter": [param_checks.Interval(Real, 0, None, closed="left")],
        "accept": ["array-like", str],
    },
    prefer_skip_nested_validation=True,
)
@one_warning
@stage("calibration")
def calibrate(
    arm: Arm,
    angles: ArrayLike | Measurements,
    groups: ArrayLike | None = None,
    *,
    points: ArrayLike | None = None,
    lengths: Iterable[Sequence[object]] = (),
    tools: ArrayLike | None = None,
    stations: ArrayLike | None = None,
    features: Iterable[Sequence[object]] = (),
    tip_diameter: float = 0.0,
    correction: object = None,
    free: Iterable[str] = Arm.TABLE,
    loss: str = "soft_l1",
    prior_length_mm: float | str = "auto",
    prior_angle_rad: float | str = "auto",
    angle_unit: str = "rad",
    accept: str | Sequence[str] = (),
) -> CalibrationResult:
    """Identify the static parameters of an arm.

    Either from a single-point test, where the points of one group coincide (a ball in a socket, a
    probe in a cone), with or without known lengths between groups; or from positions that a tracker
    measured, in an unknown frame, of an unknown point of the last link.

    Parameters
    ----------
    arm : Arm
        The nominal arm.
    angles : array-like of shape (n_samples, n_joints) or Measurements
        Joint angles, or all that was measured.
    groups : array-like of shape (n_samples,), default=None
        Label of the fixed point of each sample. Without it and without `points`, places at which
        the arm's points lie together are found and called "1", "2" and so on, if "places-found"
        is accepted.
    points : array-like of shape (n_samples, 3), default=None
        Measured positions in mm, instead of `groups`.
    lengths : iterable of (label, label, length, standard deviation), default=()
        Known distances between the fixed points of two groups, mm: tuples or the rows of an array.
        They are stated at 20 degrees C; one more number is the temperature in degrees C, a second
        the expansion per K (without: steel, 11.5e-6): ``("A", "B", 500.012, 0.005, 25)`` is 29 um
        longer.
    tools : array-like of shape (n_samples,), default=None
        Label of the tool of each sample, where several probes or targets were used in turn.
    stations : array-like of shape (n_samples,), default=None
        Label of the set-up of each sample, where the tracker or the arm was moved: each has a base
        of its own. For `points` only.
    features : iterable of (label, kind) or (label, kind, size, standard deviation), default=()
        Groups that are touches of a "plane" or "sphere", perhaps of known diameter, mm:
        ``("ball 1", "sphere", 30.0, 0.001)``. `lengths` may join centres and planes, such as those
        of a gauge block.
    tip_diameter : float, default=0.0
        Diameter of the probe's own ball, mm: for its centre spheres and blocks are so much larger
        or smaller. The side is found, or stated by a fifth entry, "outside" or "inside".
    correction : object, default=None
        Fitted model of the arm's residuals, such as :class:`ArmResidualRegressor`: what its
        ``predict(angles)`` gives, (n_samples, 3) in mm, is subtracted from the arm's points. Needed
        wherever the correction will be used with the result.
    free : iterable of str, default=("a", "alpha", "d", "theta_offset", "probe")
        Fields of `arm` that may change; with "d" the scales of joints that slide.
    loss : {"soft_l1", "huber", "cauchy", "squared"}, default="soft_l1"
        How the distance of a point counts; "squared" is plain least squares.
    prior_length_mm, prior_angle_rad : float or "auto", default="auto"
        Standard deviations of the true `a` and `d`, and `alpha` and `theta_offset`, about those of
        `arm`. They decide only what the data leave open. "auto", always for slides: found by the
        evidence, long and short lengths apart.
    angle_unit : {"rad", "deg"}, default="rad"
        Unit of `angles`.
    accept : str or list of str, default=()
        Codes of findings with which the result is handed over all the same.

    Returns
    -------
    CalibrationResult
        The calibrated arm, the parameters with their standard deviations, the scatter before and
        after, and the outliers.

    Raises
    ------
    ValueError
        If shapes, labels or numbers do not fit together; FindingError, if something has to be put
        right before and is not accepted.
    TypeError
        If `arm` is not an Arm, or `correction` has no method predict.

    Warns
    -----
    FindingWarning
        Of what is found in the data, such as too few rows, labels that do not fit where the probe
        was, a known length that disagrees, a set-up that has moved, a table that is far off, or
        poses that are too much alike; see ``result.findings``.

    Notes
    -----
    Minimised are the squared distances of the points from the mean of their group (variable
    projection: the fixed points are no parameters), over the variance of a coordinate, which is
    found along with the rest, plus the squares of the errors of the known lengths and of the
    departures from the nominal arm over theirs. Robust losses weigh whole points, so that the
    result does not depend on the directions of the axes, and known lengths.

    Touches count by their distance from the plane or sphere, whose unknowns are projected out, too.
    A stated size counts as a known length.

    A single-point test cannot see the common scale of all lengths, but a smaller arm scatters less,
    so that least squares alone would shrink it. The distances are therefore divided by the scale of
    the links: the prior, or known lengths, alone decide the scale.

    Prior standard deviations follow from MacKay's fixed point: a variance is the sum of squares of
    the departures over the number of parameters that the data determine. Long lengths, of at least
    a quarter of the longest, and short lengths have one prior standard deviation each: a forgotten
    offset of 60 mm must not widen what is believed of the links, which carry the scale. With few
    data these prior standard deviations are drawn to 0.4 mm, 0.3 mm and 0.003 rad
    (``benchmarks/bench_lengths.py scale``).

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
    free = listed("free", free)
    if not all(isinstance(name, str) and name in Arm.TABLE for name in free):
        raise ValueError(f"free must name some of {', '.join(Arm.TABLE)}, got {free!r:.60}.")
    asked: Any = angles.angles if isinstance(angles, Measurements) else angles
    asked = None if correction is None else inputs_of_model(correction, asked, angle_unit, arm)
    if groups is not None and points is not None:
        raise ValueError("give either groups, or points that were measured.")
    lengths = listed("lengths", lengths)
    if points is not None and lengths:
        raise ValueError("lengths are between groups; measured points have no use for them.")
    given: dict[str, Any] = {"points": points, "lengths": lengths, "features": features}
    given |= {"tip_diameter": tip_diameter, "tools": tools, "stations": stations}
    if groups is None and points is None and not isinstance(angles, Measurements):
        angles = arm.check_angles(angles, angle_unit)
        angles = within_turn(angles, arm.joint_types)
        groups, angle_unit = find_places(arm, angles), "rad"
    given |= {"angle_unit": angle_unit, "joint_types": arm.joint_types}
    measured = Measurements.taken(angles, groups, **given)
    if measured.points is not None:
        measured = replace(measured, lengths=[], offsets=None)
    check_measured(arm, measured)
    poses = measured.poses
    for finding in chain(poses.findings(), wrong_units(arm, measured)):
        finding.report()
    corrected: Any = None
    if asked is not None:
        asked = asked if len(asked) == len(poses.first) else asked[poses.first]
        corrected = predicted(correction, asked, measured, [arm.probe] * measured.n_tools)

    priors = (prior_length_mm, prior_angle_rad, UNKNOWN_PLACE_MM)
    fit = TableFit(arm, measured, loss, free, priors, corrected)
    before_all = fit.run(np.zeros_like(fit.is_free)).distances().mean()
    before = fit.run(fit.is_free & (fit.kind == "probe_mm")).distances().mean()
    # The deviations of an uncalibrated arm are no noise: forget their size and weights.
    fit.reset_weights()
    fit.run()
    bare = None
    if asked is not None:
        _settle(fit, correction, asked)
        bare = fit.of(correction=None)
    result = result_of(fit, before_all, before)
    if not Finding.are_ignored():
        for finding in chain(findings_of_fit(fit, result, bare), outliers(result)):
            finding.report()
    return result


def find_places(arm: Arm, angles: np.ndarray) -> np.ndarray:
    """Labels "1", "2", ... (n,) by the places that the arm's own points are at.

    Of a row and the next nearly all are of one place, which shows the probe. Rows that are alone
    belong to the nearest place.
    """
    poses = find_poses(angles, joint_types=arm.joint_types)
    few, n = poses.mean_angles(angles), len(poses.first)
    if n < 2:
        raise ValueError(_NO_LABELS)
    pairs = Measurements(few, np.arange(n) // 2, joint_types=arm.joint_types)
    points = TableFit(arm, pairs, "cauchy", ["probe"]).run().points()
    some = np.linspace(0, n - 1, min(n, MOST_ROWS)).astype(int)
    places: Any = places_of(points[some])
    several = np.bincount(places)[places] > 1
    if not several.any():
        raise ValueError(_NO_LABELS)
    nearest = places[several][KDTree(points[some][several]).query(points)[1]]
    _, first, codes = np.unique(nearest, return_index=True, return_inverse=True)
    places = np.argsort(np.argsort(first))[codes][poses.pose]  # from 0, as they come
    rows = np.bincount(places)
    text = (
        f"There are no labels of positions. The arm's own points are at {len(rows)} places, of "
        f"{rows.min()} to {rows.max()} rows each: 1 to {len(rows)}, as they come in the rows."
    )
    advice = "If these are not the positions, give the label of each row."
    Finding("places-found", text, advice, "repair").report()
    return (places + 1).astype(str)


def _settle(fit, correction, asked):
    """Fit again with the correction of the probes that were found, until it stays."""
    measured = fit.measured
    for _ in range(_MOST_MOVES):
        probes = [fit.arm(tool).probe for tool in range(measured.n_tools)]
        moved = predicted(correction, asked, measured, probes)
        if np.abs(moved - fit.correction).max() < _SETTLED_MM:
            return
        fit.correct(moved)
        fit.run()
