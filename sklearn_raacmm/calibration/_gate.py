"""What the gate does at the door of `calibrate`: poses before the fit, findings after it."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace

import numpy as np

from sklearn_raacmm.arm import parameter_jacobian, reach_mm
from sklearn_raacmm.calibration._problem import points_and_jacobian
from sklearn_raacmm.measurements import (
    base_motions,
    coarse_angles,
    find_poses,
    moved_positions,
    moved_set_up,
)
from sklearn_raacmm.utils import Finding, say_findings, slip_factors

# Poses anywhere that the standard deviation is computed at, and the part of what the table alone
# leaves there from which on too little is known: 0.02 in clean tests of 60 poses, 0.2 along a path.
_TRIED, _OPEN = 100, 0.1
# Points that scatter by more than a part of that promise nothing.
_FAR = 5.0
# Spread of measured points over that of the arm's: beyond, one of them is in another unit.
_SPREAD = 1.5
_UNITS = {25.4: "inches", 10.0: "centimetres", 1e3: "metres", 1e-3: "micrometres"}
# Share of rows far off that slips do not come to. A choice.
_MOST_OUTLIERS = 0.1
# Measuring arms reach from half a metre on, robots are not much smaller.
_LEAST_REACH_MM = 200.0


def one_row_a_pose(angles, problem):
    """Poses that rows are of, their angles, and the problem with one row each."""
    labels = [v for v in (problem.index, problem.tools, problem.stations) if v is not None]
    codes = np.unique(np.column_stack(labels), axis=0, return_inverse=True)[1] if labels else None
    poses = find_poses(angles, None if codes is None else codes.ravel(), problem.points)
    if not poses.merges:
        return poses, angles, problem
    say_findings(poses.findings())
    names = ("index", "points", "correction", "tools", "stations")
    parts = {name: poses.mean(getattr(problem, name)) for name in names}
    problem = replace(problem, **parts)
    if problem.points is None and problem.n_informative == 0:
        raise ValueError("each group has one pose: none can scatter.")
    return poses, poses.mean_angles(angles), problem


def slips(fit):
    """Factors by which rows count in the means of their groups, as in `residuals`."""
    index = fit.problem.index
    return None if index is None else slip_factors(fit.points(), index)


def per_row(result, poses):
    """The result with one entry for each row that was given."""
    if not poses.merges:
        return result
    rows = [np.flatnonzero(poses.pose == i) for i in result.outliers]
    return replace(
        result,
        residuals_mm=result.residuals_mm[poses.pose],
        sample_weight=result.sample_weight[poses.pose],
        outliers=tuple(np.concatenate(rows).tolist()) if rows else (),
    )


def named_outliers(result):
    """Rows far from where they belong."""
    rows, n = result.outliers, len(result.residuals_mm)
    if rows:
        far = np.linalg.norm(result.residuals_mm[list(rows)], axis=1).max()
        many = len(rows) > _MOST_OUTLIERS * n
        yield Finding(
            "outliers",
            f"{len(rows)} of {n} rows lie farther than {result.outlier_limit_mm:.3g} mm from where "
            f"they belong, up to {far:.3g} mm.",
            "They are not learnt from. " + "Look at their labels and at the seat." * many,
            "doubt" if many else "note",
            rows=rows,
            size_mm=far,
        )


def positions_moved(fit, groups, poses):
    """The fixed point of a position moved during the test."""
    if groups is None:
        return
    groups, left = np.asarray(groups)[poses.first], fit.residuals(slips(fit))
    every, noise = np.ones(len(left)), fit.sigma**2
    yield from moved_positions(left, fit.angles, every, groups, noise, poses.first)


def wrong_units(arm, angles, problem):
    """Measured points, or the arm's table, are in another unit."""
    reach, points = reach_mm(arm), problem.points
    if angles is not None:
        yield from coarse_angles(angles, reach)
    if points is not None and len(points) > 1:
        shown = arm.forward(angles)
        sizes = [np.sqrt(np.square(p - p.mean(axis=0)).sum(axis=1).mean()) for p in (shown, points)]
        ratio = sizes[0] / max(sizes[1], 1e-300)
        unit = min(_UNITS, key=lambda u: abs(np.log(ratio / u)))
        if abs(np.log(ratio / unit)) < np.log(_SPREAD):
            yield Finding(
                "unit-of-points",
                f"The measured points spread over {sizes[1]:.4g}, the arm's over {sizes[0]:.4g} "
                f"mm: they are most likely in {_UNITS[unit]}.",
                "Give millimetres.",
                "refuse",
            )
        elif np.abs(shown - points).max() < 1e-9 * reach:
            yield Finding(
                "points-of-the-arm",
                "The measured points are those that the arm itself shows.",
                "Give the points that a tracker has measured, or the labels of positions.",
                "repair",
            )
    if reach < _LEAST_REACH_MM:
        yield Finding(
            "unit-of-table",
            f"The nominal arm reaches {reach:.3g} mm:",
            "are its lengths in inches, in centimetres or in metres, not millimetres?",
            "repair",
        )


def set_up_moved(fit, mask, poses):
    """The tracker, the base or the tool moved during the measurement."""
    problem, n = fit.problem, 4 * fit.nominal_arm.n_joints + 3
    if problem.points is None or problem.n_stations > 1 or problem.n_tools > 1:
        return
    points, columns = points_and_jacobian(fit.nominal_arm, fit.angles, fit.x[:n], problem)
    turns = fit.arm().frames(fit.angles)[:, -1, :3, :3]
    columns = columns[:, :, mask[:n]]
    ridge = np.square(fit.sigma / fit.prior_sd[:n][mask[:n]])
    parts = fit.residuals(), columns, ridge, points, turns, fit.weights, poses.first
    yield from moved_set_up(*parts)


def poses_alike(fit, mask):
    """Away from the poses of the test little more is known of the arm than its table says."""
    arm, n = fit.arm(), 4 * fit.nominal_arm.n_joints + 3
    # Of too few rows another finding tells.
    if not mask[: n - 3].any() or fit.problem.n_coordinates < 2 * mask.sum():
        return
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (_TRIED, arm.n_joints))
    points, jac = parameter_jacobian(arm, angles)
    free = [jac[:, :, -3:], base_motions(points, reach_mm(arm))]
    if fit.problem.points is None:  # which cannot see the scale
        free.append(points[:, :, None] / reach_mm(arm))
    # What a registration takes away again: base and probe.
    base = np.linalg.qr(np.concatenate(free, axis=2).reshape(3 * _TRIED, -1))[0]
    jac = jac.reshape(3 * _TRIED, -1)
    jac = (jac - base @ (base.T @ jac))[:, mask[:n]]
    covariance = fit.covariance(mask)[: mask[:n].sum(), : mask[:n].sum()]
    if not np.all(np.isfinite(covariance)):
        return
    known = np.sqrt(np.einsum("np,pq,nq->n", jac, covariance, jac).mean() * 3)
    table = np.sqrt(np.square(jac * fit.prior_sd[:n][mask[:n]]).sum(axis=1).mean() * 3)
    if known > max(_OPEN * table, _FAR * fit.sigma):
        yield Finding(
            "poses-alike",
            f"At other poses the calibrated arm is known to {known:.2g} mm only, where the table "
            f"alone leaves {table:.2g} mm: the poses of this test are too much alike.",
            "Swing every joint through its range, at places all over the volume.",
            size_mm=known,
        )


def check_fit(fit, mask, poses, groups):
    """Findings on a calibration that has settled."""
    checks = (
        positions_moved(fit, groups, poses),
        set_up_moved(fit, mask, poses),
        poses_alike(fit, mask),
    )
    say_findings(finding for check in checks for finding in check)
