"""Does a correction still hold? A test of new poses against what the model expects of them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import date as calendar
from io import StringIO
from numbers import Real
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import orth
from scipy.stats import f as fisher

from sklearn_raacmm.correction._change import day
from sklearn_raacmm.correction._posterior import UNSEEN, ModelWhitening, score_tests
from sklearn_raacmm.correction._rows import Expected, new_rows, place_columns
from sklearn_raacmm.correction._suspects import NOISE, Suspects, likeliest_change
from sklearn_raacmm.error_model import ArmResidualRegressor
from sklearn_raacmm.utils import (
    Finding,
    listed,
    one_blas_thread,
    one_warning,
    param_checks,
    write_whole,
)

# How far new positions exceed what a model expects of them along one cause: what arms have in
# common of it, the mean factor of the variance and the number of positions that it is worth. Of 41
# arms of the kinds of ``benchmarks/bench_check.py`` with 12 positions and 44 with 5 this is by 18
# nats likelier than a prior worth 5: with 5 positions 7 of 440 checks raise a false alarm, with
# that 14; of 1000 knocks 876 are found, with that 884. Over all directions it averages out: the
# size of all is as the own positions say, each worth so many errors (eight arms of each kind).
_FACTOR_OF_ARMS, _POSITIONS_OF_ARMS = 1.5, 1
_ERRORS_OF_POSITION = 5
# Of a model that does not say from how many positions it was learnt.
_MANY_POSITIONS = 1e6
# Sets of poses drawn for the freedoms of a mean.
_DRAWS = 1000
# What is suspected, and what to do. A turn of the base about z is the same as an offset of joint 1.
_MOVED = "The base or the tracker has moved: register again (Correction.register, raacmm register)."
_ADVICE = {
    "nothing": "Nothing: the correction holds.",
    "base": _MOVED,
    "base turned": _MOVED,
    "drift": "Base or tracker move while you measure: let them settle, fix the stand, and measure "
    "anew.",
    "probe": "Register again (Correction.register, raacmm register).",
    "scale": "Bring the arm to its usual temperature, or check its scale by a known length.",
    "corrected already": "Give what the arm shows without the correction, measured minus "
    "reference. If you did, update the correction (Correction.update, raacmm update).",
    "noise": "Look for a loose probe, a dirty seat or an unsteady stand, and measure anew.",
    "offset of joint 1": "Register again: a base that has turned looks the same. If that does not "
    "hold, update the correction (Correction.update, raacmm update).",
    "arm": "Update the correction (Correction.update, raacmm update); if that does not hold, "
    "measure anew.",
}
# Beside what a correction that holds leaves, half of that adds an eighth to the error: a choice.
_WORTH = 0.5


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
        "scale of joint 1" (which slides), "probe", "base" (shifted), "base turned", "drift" (a base
        that moves from the first row to the last), "scale", "corrected already" (the residuals), or
        "noise" if nothing else does.
    advice : str
        What to do, in one sentence.
    size_mm : float
        What the suspect does to the probe at these poses, root mean square; of a single-point test
        about the means of the positions. 0 for "nothing".
    usual_mm : float
        Root mean square of the errors that a correction that holds leaves at the probe.
    matters : bool
        Whether it is worth acting on: `size_mm` is more than half of `usual_mm`. Of many poses a
        test finds changes that are real and harm nobody.
    tests : structured ndarray of shape (n_tests,)
        `cause`, `statistic`, `freedom` and `p_value` of each test, before they are put together.
    slipped : tuple of int
        Rows that lie too far off to count, at most a tenth of all: measure them again.
    record : dict
        One line for a control chart: `date`, `n_poses`, `mean_mm` and `range_mm` of the corrected
        distances with the limits `mean_low_mm`, `mean_high_mm`, `range_low_mm` and `range_high_mm`
        of the test itself, `p_value`, `suspect`.
    findings : tuple of Finding
        What was found in the poses: "little-known" if most lie where the model knows little, and
        the check says next to nothing of them.
    """

    holds: bool
    p_value: float
    suspect: str
    advice: str
    size_mm: float
    usual_mm: float
    matters: bool
    tests: np.ndarray = field(repr=False)
    slipped: tuple[int, ...]
    record: dict[str, object] = field(repr=False)
    findings: tuple[Finding, ...] = field(default=(), repr=False)

    def append_to(self, path: str | PathLike[str]) -> None:
        """Append the record to a CSV file, a line for each check: the data of a control chart.

        Parameters
        ----------
        path : str or path-like
            Made, with a header, if it does not exist.

        Raises
        ------
        ValueError
            If the file has another header.

        Examples
        --------
        >>> check.append_to("checks_of_arm_7.csv")  # doctest: +SKIP
        """
        path = Path(path)
        header = path.read_bytes().splitlines()[:1] if path.exists() else []
        if header and header != [",".join(self.record).encode()]:
            raise ValueError(f"{path} is not the record of checks: its first line is no header.")
        file = StringIO(newline="")
        writer = csv.DictWriter(file, self.record)
        if not header:
            writer.writeheader()
        writer.writerow(self.record)
        lines = path.read_bytes() if header else b""
        write_whole({path: lines + file.getvalue().encode()})


@one_blas_thread
@param_checks.validate_params(
    {
        "false_alarm_rate": [param_checks.Interval(Real, 0, 0.5, closed="neither")],
        "refitted": ["array-like", str],
        "date": [str, calendar, None],
    },
    prefer_skip_nested_validation=True,
)
@one_warning
def check_correction(
    model: ArmResidualRegressor,
    X: ArrayLike,
    y: ArrayLike,
    *,
    groups: ArrayLike | None = None,
    lengths: Iterable[Sequence[object]] = (),
    refitted: str | Sequence[str] = (),
    false_alarm_rate: float = 0.01,
    date: str | None = None,
    features: Iterable[Sequence[object]] = (),
) -> CorrectionCheck:
    """Say from a few poses of today whether a fitted correction still holds.

    Parameters
    ----------
    model, X, y, groups
        As in :func:`update_correction`; of today's poses.
    lengths : iterable of (label, label, length, standard deviation), default=()
        Known distances between two positions of `groups`, mm, such as of a gauge with poses at both
        ends: tuples or the rows of an array. They show a change of scale, as by temperature.
    date
        As in :func:`update_correction`.
    refitted : list of {"base", "probe"}, default=()
        What has been fitted to these same poses: that has taken up a part of any change.
    false_alarm_rate : float, default=0.01
        How often a correction that holds may be called into question.
    features : iterable of (label, kind) or (label, kind, size, standard deviation), default=()
        As in :meth:`ArmResidualRegressor.fit`: what was touched under labels of `groups`. Known
        sizes show a change of scale as lengths do.

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

    Notes
    -----
    If the correction holds, ``y - predict(X)`` is normal with the covariance ``A S A' + s^2 I`` of
    the model's posterior and noise, both widened by `std_scale` and `noise_scale` of its linear
    model. One test is of the size of all against that, one of their mean distance; one of each
    cause, a score test. The widening is known from the arm's own positions, for one cause with one
    more of other arms: the freedoms of the denominator of Fisher's F. The tests share the rate
    (Bonferroni): a cause of k numbers has 1 / k of what the size, the mean and a cause of one
    number have each. A pose that lies farther off than 95 % do counts as though it lay there.
    That residuals were corrected already is tested where it is likelier than that they were not.

    A single-point test shows no drift, no scale without known lengths, and of joint 1 nothing but
    harmonics; a moved base shows in residuals of an earlier registration.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_raacmm import Arm, ArmResidualRegressor, check_correction
    >>> arm = Arm.from_name("aacmm6")
    >>> rng = np.random.default_rng(0)
    >>> angles = rng.uniform(-2, 2, (400, 6))
    >>> y = rng.normal(scale=0.01, size=(400, 3))
    >>> model = ArmResidualRegressor(arm, orders=4).fit(angles, y)
    >>> today = rng.uniform(-2, 2, (30, 6))
    >>> knock = arm.jacobian(today)[:, :, 1] * np.deg2rad(20 / 3600)
    >>> check_correction(model, today, knock + rng.normal(scale=0.01, size=(30, 3))).suspect
    'offset of joint 2'
    """
    refitted = listed("refitted", refitted)
    if not all(isinstance(name, str) and name in ("base", "probe") for name in refitted):
        raise ValueError(f'refitted must name "base" or "probe", got {refitted!r:.60}.')
    rows = new_rows(model, X, y, groups, lengths, features)
    correction = model.predict(X)
    suspects = Suspects(Expected(model.linear_model_, rows).widened(), correction)
    rows, shown, known, seen = suspects.rows, suspects.shown, suspects.known, suspects.seen
    linear = suspects.expected.linear
    place = place_columns(linear.arm, rows.X, rows.codes is None)
    kept = np.repeat(["probe" in refitted, "base" in refitted], [3, 6])
    place = place[:, :, kept[: place.shape[2]]]
    nuisance, residual = shown.flat(place), suspects.residual
    correction = correction[~suspects.slipped]
    whiten = ModelWhitening(known, nuisance, shown.n_coordinates)
    if whiten.freedom < 3:
        n = int(shown.rank.sum())
        raise ValueError(
            f"{len(rows.X)} poses have {n} coordinates for "
            f"{n - whiten.freedom} freedoms of positions, base and probe: nothing is left "
            "to check the correction with."
        )
    n_positions = min(linear.n_positions, _MANY_POSITIONS)
    freedom, of_arms = _ERRORS_OF_POSITION * n_positions, n_positions + _POSITIONS_OF_ARMS
    factor = (n_positions + _POSITIONS_OF_ARMS * _FACTOR_OF_ARMS) / of_arms
    already = shown.flat(-correction[:, :, None])
    left, whole = whiten(residual), whiten(already)[:, 0]
    if whole @ left > 0.5 * (whole @ whole):  # likelier by all of the correction than by none
        seen["corrected already"] = already
        suspects.causes["corrected already"] = -correction[:, :, None]
    tests = score_tests(seen, whiten, residual, [(freedom, 1.0), (of_arms, factor)])
    # Of 560 knocks of 10 arc seconds equal shares found 487, these 497 (arms with other seeds than
    # those of ``benchmarks/bench_check.py kinds``): misfit looks like causes of many numbers.
    shares = np.r_[1.0, 1 / tests["freedom"][1:], 1.0]
    shares /= shares.sum()
    rate = false_alarm_rate * shares[-1]
    mean, chart = _chart(linear, suspects, nuisance, whiten, freedom, rate)
    tests = np.append(tests, np.array(mean, dtype=tests.dtype))
    p_value = min(float(np.min(tests["p_value"] / shares)), 1.0)
    holds, suspect, size_mm = p_value >= false_alarm_rate, "nothing", 0.0
    # Of what the rows can show.
    spread = np.square(suspects.expected.std).sum(axis=1)
    usual = rows.rank / 3 * (spread + 3 * linear.noise_variance)
    usual_mm = float(np.sqrt(usual.mean()))
    if not holds:
        given = residual, np.hstack([known, nuisance]), seen, shown.n_coordinates
        suspect = likeliest_change(*given)[0]
    if suspect in seen:
        # By its most likely size; what base and probe do as well is no part of it.
        cause = seen[suspect]
        size = np.linalg.lstsq(whiten(cause), whiten(residual), rcond=UNSEEN)[0]
        taken = np.linalg.lstsq(whiten.scaled(nuisance), whiten.scaled(cause), rcond=UNSEEN)[0]
        size_mm = _rms(shown, (suspects.causes[suspect] - place @ taken) @ size)
    elif suspect == NOISE:  # as much as all exceed what is expected of them
        size_mm = float(np.sqrt(max(np.square(_rms(shown, suspects.left)) - usual_mm**2, 0.0)))
    matters = size_mm > _WORTH * usual_mm
    advice = _ADVICE.get(suspect, _ADVICE["arm"])
    if not (holds or matters):
        advice = (
            f"It is real and small, {size_mm:.2g} mm beside the {usual_mm:.2g} mm that the "
            f"correction leaves: nothing needs to be done. {advice}"
        )
    record = {"date": day(date), "n_poses": len(rows.X)}
    record |= {**chart, "p_value": p_value, "suspect": suspect}
    far = tuple(np.flatnonzero(suspects.slipped).tolist())
    return CorrectionCheck(
        holds, p_value, suspect, advice, size_mm, usual_mm, matters, tests, far, record
    )


def _rms(shown, vectors):
    """Root mean square of vectors (n, 3) about their position, along what the rows show."""
    about = shown(vectors[:, :, None])[: len(vectors)]
    return float(np.sqrt(np.square(about).sum() / len(vectors)))


def _chart(linear, suspects, nuisance, whiten, freedom, rate):
    """The test of the mean distance, and mean and range with the limits of that same test.

    The square of a mean or a range of distances is about a multiple of a chi-squared variable,
    whose freedoms follow from draws; that of the factor of the noise has `freedom` itself. The
    `nuisance` has been fitted. `whiten` is by what the model expects.
    """
    n, rng = suspects.left.size, np.random.default_rng(0)
    basis = orth(nuisance[:n])
    record, tests = {}, []

    def distances(values):  # of coordinates and lengths over the noise, (m, k)
        values = values[:n] - basis @ (basis.T @ values[:n])
        return linear.noise_sd * np.linalg.norm(values.reshape(n // 3, 3, -1), axis=1)

    found = distances(suspects.residual[:, None])
    noise = suspects.shown(rng.normal(size=(n // 3, 3, _DRAWS))).reshape(-1, _DRAWS)
    drawn = distances(whiten.as_known(rng.normal(size=noise.shape)) + noise)
    for name, of in (("mean", np.mean), ("range", np.ptp)):
        square, value = np.square(of(drawn, axis=0)), float(of(found, axis=0)[0])
        k, unit = 2 * np.square(square.mean()) / square.var(), square.mean()
        law = fisher(k, freedom)
        low, high = np.sqrt(unit * law.ppf([rate, 1 - rate])).tolist()
        record |= {f"{name}_mm": value, f"{name}_low_mm": low, f"{name}_high_mm": high}
        ratio = value**2 / unit
        tests.append((name, k * ratio, round(k), law.sf(ratio)))
    return tests[0], record
