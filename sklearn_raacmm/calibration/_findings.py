"""Findings on a calibration that has settled."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.calibration._fit import FOUND, MAX_ROUNDS
from sklearn_raacmm.calibration._labels import MUCH_SCATTER_MM, label_findings
from sklearn_raacmm.calibration._lengths import wrong_lengths
from sklearn_raacmm.calibration._result import ANGLES
from sklearn_raacmm.calibration._set_ups import moved_set_up, thinned
from sklearn_raacmm.measurements import Explanation, base_motions, moved_positions
from sklearn_raacmm.utils import Finding

# Standard deviations by which a parameter is off the table: once in 1.7 million by chance.
_SDS_OFF = 5.0
# Standard errors by which a correction has to enlarge the scatter: of corrections that change
# nothing on the average one in forty does by chance.
_HARM = 2.0
# What no calibration of an arm comes to: a scatter, as a part of the reach.
SHARE_OF_REACH = 0.02
_MOST_NAMED = 4
_MEANING = {
    "a": "the length of link",
    "d": "the offset of joint",
    "alpha": "the twist of link",
    "theta_offset": "the zero of joint",
}
# Departures from the table that are worth a word, mm and rad: more than a tape and a protractor get
# wrong; and the same in standard deviations of a prior that was given.
_FAR_MM, _FAR_RAD, _FAR_PRIORS = 10.0, 0.1, 10.0
# Of its drawing, or of the reach where that is 0, and mm: no length of an arm is off by more.
_OTHER_LENGTH, _TOLERANCE_MM = 0.1, 2.0
# A length that was typed wrong is off by up to this, mm; a parameter is seen where its standard
# deviation is less than this part of the prior's.
_TYPED_MM, _SEEN = 100.0, 0.5
# Poses anywhere that the standard deviation is computed at, and the part of what the table alone
# leaves there from which on too little is known: 0.02 in clean tests of 60 poses, 0.2 along a path.
_TRIED, _OPEN = 100, 0.1
# Points that scatter by more than a part of that promise nothing.
_FAR = 5.0
# Share of rows far off that slips do not come to. A choice.
_MOST_OUTLIERS = 0.1


def findings_of_fit(fit, result, bare):
    """All findings, but that of outliers; `bare` is the fit without the correction, or None."""
    numbers = fit.measured.poses.first  # of the rows as they were given
    if not fit.converged:
        scatter = result.scatter_after_mm
        text = f"the calibration did not settle in {MAX_ROUNDS} rounds; its scatter is"
        yield Finding("not-settled", f"{text} {scatter:.4g} mm.", size_mm=scatter)
    for i in fit.still:
        text = (
            f"Joint {i + 1}, which slides, stands still at {fit.angles[0, i]:.6g} mm in all rows: "
            "it is taken as fixed, and its scale is not looked for."
        )
        advice = (
            "What is learnt holds there. To learn more, measure with this joint elsewhere, too."
        )
        yield Finding("slide-still", text, advice, joints=(i + 1,))
    yield from _few_rows(fit.measured, result.rank, result.n_free)
    kept = numbers[~np.isin(numbers, result.outliers)]  # a pose once, however long it was held
    scatter = float(np.linalg.norm(result.residuals_mm[kept], axis=1).mean())
    for part in (label_findings(fit, result, numbers, scatter), _lengths(fit, result)):
        found = list(part)
        yield from found
        if any(finding.weight == "repair" for finding in found):
            return  # of a fit with such labels or lengths all else means nothing
    sd = result.standard_deviations[: len(fit.names)]
    yield from list(_no_such_arm(fit, result, scatter)) or _wrong_table(fit, sd, scatter)
    if bare is not None:
        yield from _harm(fit.distances(), bare.distances())
    if result.groups is not None:
        held = np.flatnonzero(fit.measured.n_shown == 3)  # no touches
        held = held[thinned(fit.index[held], len(held))]
        turns, rows = fit.nominal_arm.phases(fit.angles[held]), numbers[held]
        yield from moved_positions(result.residuals_mm[rows], turns, result.groups[rows], rows)
    yield from moved_set_up(fit, numbers)
    yield from _poses_alike(fit)


def _lengths(fit, result):
    """Known lengths that disagree, unless cones and table make no sense without them either."""
    if fit.measured.lengths:
        cones = fit.of(lengths=[], offsets=None)
        if not [*_no_such_arm(fit, result, cones.distances().mean())]:
            yield from wrong_lengths(fit, result, cones)


def _few_rows(measured, rank, n_free):
    """The rows cannot carry what is asked of them."""
    n, spare = measured.n_coordinates, measured.n_coordinates - rank
    if not n_free or spare >= rank:
        return
    n_points = np.count_nonzero(measured.informative)
    rows = int(np.ceil((n + rank - spare) / n * n_points))
    what = "measured points" if measured.points is not None else "groups of points"
    known = "The noise, and with it every standard deviation, is unknown."
    if spare > 0:
        known = "Noise and standard deviations are hardly known; other poses may be far off."
    text = (
        f"{n_points} {what} give {max(n, 0)} coordinates for {n_free} free "
        f"parameters, of which they could show {rank}: {max(spare, 0)} are left to check them "
        f"with. {known}"
    )
    advice = f"Measure about {rows} rows or more, or let fewer fields change (free=)."
    yield Finding("few-rows", text, advice)


def _no_such_arm(fit, result, after):
    """A fit that has settled, and leaves a scatter of so many mm, makes no sense."""
    reach, before = fit.nominal_arm.reach_mm, result.scatter_before_mm
    if after > min(SHARE_OF_REACH * reach, 2 * before + 1e-6 * reach):
        text = (
            f"The points still scatter by {after:.4g} mm ({before:.4g} mm before; the arm reaches "
            f"{reach:.4g} mm)."
        )
        advice = (
            "Look at the labels, known lengths, the order and sense of the joints, the convention "
            "of the table, and the unit of the angles."
        )
        yield Finding("no-such-arm", text, advice, "repair", size_mm=after)


def _far(fit, sd):
    r"""Departures from the table (n_parameters,) that are worth a word, mm and rad.

    A length that was typed wrong is anywhere within 100 mm. Of one that was not, the n other
    lengths that the data show and a guess say the variance :math:`\tau^2`: it has Student's t of n
    + 1 degrees of freedom, whose tail is below that of the typing error by so many nats.
    """
    length, angle, _ = fit.priors
    far_mm = _FAR_MM if length == "auto" else _FAR_PRIORS * length
    far_rad = _FAR_RAD if angle == "auto" else _FAR_PRIORS * angle
    far = np.where(fit.kind == "angle_rad", far_rad, far_mm)
    far[np.isin(fit.kind, ["probe_mm", "slide_mm", "slide_rad", "slide_scale"])] = np.inf
    is_seen = fit.is_free & (sd < _SEEN * fit.prior_sd)
    seen = np.flatnonzero(is_seen & np.isin(fit.kind, ["length_mm", "short_length_mm"]))
    if length == "auto" and len(seen) > 1:
        square, n = np.square(fit.x[seen] - fit.nominal[seen]), len(seen)
        size = np.sqrt((FOUND["length_mm"][0] ** 2 + square.sum() - square) / n)
        wider = (2 * _TYPED_MM / size) ** (2 / (n + 1)) * np.exp(2 * Explanation.PRICE / (n + 1))
        far[seen] = np.minimum(far[seen], size * np.sqrt(n * (wider - 1)))
    far[~fit.is_free] = np.inf
    return far


def _wrong_table(fit, sd, scatter):
    """A table that the data contradict: an offset forgotten, a link mistyped.

    `sd` (n_parameters,) are the standard deviations of what was fitted, mm and rad. Known lengths
    may be what is wrong.
    """
    names, nominal, values, far = fit.names, fit.nominal, fit.x[: len(sd)], _far(fit, sd)
    departure = np.abs(values - nominal)
    # Parameters that only others determine wander: an offset along the last axis and the probe. Not
    # long lengths, of whatever standard deviation.
    is_length = fit.is_free & np.isin(fit.kind, ["length_mm", "short_length_mm"])
    drawing = np.where(nominal == 0.0, fit.nominal_arm.reach_mm, np.abs(nominal))
    off = is_length & (departure > np.maximum(_OTHER_LENGTH * drawing, _TOLERANCE_MM))
    is_seen = ~(departure < _SDS_OFF * sd) | (off & (fit.kind == "length_mm"))
    is_wrong = ((departure > far) | off) & is_seen
    wrong = [i for i in np.argsort(-departure / far) if is_wrong[i]]
    if not wrong:
        return
    parts, joints = [], []
    for i in wrong:
        field = names[i].rstrip("0123456789")
        joints.append(int(names[i].removeprefix(field)))
        factor, unit = (180 / np.pi, "°") if names[i].startswith(ANGLES) else (1.0, " mm")
        parts.append(
            f"{_MEANING[field]} {joints[-1]} ({names[i]}) is {factor * values[i]:.1f}{unit}, "
            f"the table says {factor * nominal[i]:.6g}{unit}"
        )
    advice = "If it is built so, take the calibrated arm as the new table (arm.json)"
    advice += "; if not, look at the known lengths and their unit." if fit.measured.lengths else "."
    if scatter > MUCH_SCATTER_MM:
        advice = (
            f"But with it the points scatter by {scatter:.1f} mm: search_table finds joints "
            "that are reversed or exchanged."
        )
    text = f"The arm is not that of the table: {'; '.join(parts[:_MOST_NAMED])}."
    size = max((departure[i] for i in wrong if not names[i].startswith(ANGLES)), default=0)
    yield Finding(
        "table-off",
        text,
        advice,
        "repair" if off[wrong].any() else "doubt",
        joints=tuple(sorted({*joints})),
        size_mm=size,
    )


def _harm(corrected, bare):
    """The points scatter more with a correction than without it, distances (n,) in mm."""
    more = corrected - bare
    size = corrected.mean()
    if more.mean() > _HARM * more.std() / np.sqrt(len(more)) + 1e-9 * bare.mean():
        text = f"With the correction the points scatter by {size:.4g} mm, without it by"
        advice = "Is it of this arm, and is the table that of the arm that it was learnt with?"
        text = f"{text} {bare.mean():.4g} mm: do not use it here."
        yield Finding("harmful-correction", text, advice, size_mm=size)


def _poses_alike(fit):
    """Away from the poses of the test little more is known of the arm than its table says."""
    arm, n = fit.arm(), fit.n_table + 3
    is_free = fit.is_free[:n]
    # Of too few rows another finding tells.
    if not is_free[:-3].any() or fit.measured.n_coordinates < 2 * fit.mask.sum():
        return
    angles = arm.random_poses(_TRIED)
    angles[:, fit.still] = fit.angles[0, fit.still]
    points, jac = fit.table_jacobian(angles, fit.x)
    free = [jac[:, :, -3:], base_motions(points, arm.reach_mm)]
    if fit.measured.points is None:  # which cannot see the scale
        free.append(points[:, :, None] / arm.reach_mm)
    # What a registration takes away again: base and probe.
    base = np.linalg.qr(np.concatenate(free, axis=2).reshape(3 * _TRIED, -1))[0]
    jac = jac.reshape(3 * _TRIED, -1)
    jac = (jac - base @ (base.T @ jac))[:, is_free]
    covariance = fit.covariance()[: is_free.sum(), : is_free.sum()]
    if not np.all(np.isfinite(covariance)):
        return
    known, table = (
        np.sqrt(np.einsum("np,pq,nq->n", jac, spread, jac).mean() * 3)
        for spread in (covariance, np.diag(fit.prior_sd[:n][is_free] ** 2))
    )
    if known > max(_OPEN * table, _FAR * fit.sigma):
        moved = jac @ (fit.x[:n] - fit.nominal[:n])[is_free]
        moved = np.sqrt(np.square(moved).mean() * 3)
        text = (
            f"At other poses calibration moves the probe by {moved:.2g} mm, and that is known to "
            f"{known:.2g} mm only: the poses of this test are too much alike."
        )
        advice = "Swing every joint through its range, at places all over the volume."
        # The square of what it moves is, in the mean, that of what the table was wrong by and its
        # own variance together: below twice the variance the table was nearer than calibration.
        yield Finding(
            "poses-alike",
            text,
            advice,
            "repair" if moved**2 < 2 * known**2 else "note",
            size_mm=known,
        )


def outliers(result):
    """Rows far from where they belong."""
    rows, n = result.outliers, len(result.residuals_mm)
    if rows:
        far = np.linalg.norm(result.residuals_mm[list(rows)], axis=1).max()
        many = len(rows) > _MOST_OUTLIERS * n
        text = (
            f"{len(rows)} of {n} rows lie farther than {result.outlier_limit_mm:.3g} mm from where "
            f"they belong, up to {far:.3g} mm."
        )
        advice = "They are not learnt from. " + "Look at their labels and at the cone." * many
        yield Finding(
            "outliers",
            text,
            advice,
            "doubt" if many else "note",
            rows=Finding.row_numbers(rows),
            size_mm=far,
        )
