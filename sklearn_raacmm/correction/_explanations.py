"""What is most likely wrong with new residuals beside a fitted model: one table of explanations."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations, product
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cholesky

from sklearn_raacmm.arm import parameter_jacobian
from sklearn_raacmm.correction._change import LEAST_NOISE_MM, prior_of, with_low_orders
from sklearn_raacmm.correction._new_poses import place_columns
from sklearn_raacmm.error_model import LEAST_POSITIONS
from sklearn_raacmm.inference import Whitened
from sklearn_raacmm.measurements import UNITS, WORDS, changed_joints, of_own_points
from sklearn_raacmm.utils import Finding, align, row_numbers

# Nats by which an explanation has to be better than the data as given, beside the logarithm of how
# many of its kind are tried: `benchmarks/bench_check.py findings` counts what is said of real data
# that nothing is wrong with.
_PRICE = 11.0
# Nats within which nothing tells two explanations apart: both are named. A choice.
_EQUAL = 7.0
# Rows that are looked at, evenly from all, and how many there have to be: for speed.
_ROWS, _LEAST_ROWS = 120, 12
# Rows of which the model knows so little that less than this share of it is used say nothing.
_KNOWN_SHARE = 0.5
# Changes of the arm, in units of what was expected of it before any data, with the standard
# deviation of their logarithm about a tenth (as an update has them); the same of the noise.
_TAUS, _TAU, _TAU_LOG_SD = np.r_[0.0, np.geomspace(0.01, 3.0, 12)], 0.1, 1.5
_NOISE_LOG_SD, _KNOWN_LOG_SD = 1.0, 0.3
# An arm that is another one changes by as much as an arm is expected to have.
_ANOTHER = np.geomspace(0.5, 3.0, 6)
# What a table other than the calibrated one is off by as a rule, mm and mrad; and what the
# calibrated one may be at other positions than its own.
_ANOTHER_TABLE, _CALIBRATED = 1.0, 0.1
# Residuals farther off than so many medians count as though they lay there.
_FAR = 3.0


class Explanation(NamedTuple):
    """What may be wrong with residuals, and what is then left of them beside the model."""

    code: str  # of `WORDS`
    what: str  # fills the gap in the words
    left: np.ndarray  # (n, 3) mm
    rows: np.ndarray  # (n,) of the angles that it is left at
    n_tried: int = 1  # explanations of this kind
    log_scale: float = 0.0  # logarithm of the factor of each coordinate
    taus: Any = _TAUS  # changes of the arm beside it
    noise_log_sd: float = _NOISE_LOG_SD
    noise_like: Any = None  # (n, 3) mm: what is left scatters as much as this; None: as the noise
    table: float = 0.0  # what the arm's table may be off by, mm and mrad
    first: int = 0  # the first row that it is about
    alone: Any = None  # (n, 3) residuals of other rows that it looks at, mm


def what_is_wrong(model: Any, poses: Any) -> Iterator[Finding]:
    """Yield the most likely explanation of new poses, if it is likelier than that nothing is wrong.

    With r what an explanation leaves of the residuals beside the model, A the model's columns and B
    those of base and tool, ``r ~ N(B b, s^2 (A S A' + v + tau^2 A V A'))``: S is the widened
    posterior, V the variance before any data, v that of the noise, and b may be anything. Its
    likelihood is the highest over s and tau times their log-normal priors: s is found in each, as
    noise that is known would prefer whatever makes residuals small. Of every explanation the
    difference to the same rows as they are given is a gain in nats; the best is said where it
    exceeds its price, beside those that are nearly as likely. Deviations of cones that are those of
    the arm's own points are of these rows and this table: the arm alone can be another one.
    """
    linear, n_joints = with_low_orders(model.linear_model_), model.linear_model_.arm.n_joints
    of_rows, _, doubt = model.linear_model_.predict_with_doubt(poses.angles)
    as_given = False
    if poses.codes is not None:
        rows = np.flatnonzero(poses.weights > 0)
        own = poses.residuals[rows], poses.codes[rows], linear.arm, poses.angles[rows, :n_joints]
        expected = model.fading_.share(doubt)[rows, None] * of_rows[rows]
        as_given, found = of_own_points(*own, rows, expected=expected)
        if found:
            yield from found
            return
    known = replace(model.fading_, most=1.0).share(doubt) >= _KNOWN_SHARE
    used = np.flatnonzero((poses.weights > 0) & known)
    if len(used) < _LEAST_ROWS:
        return
    data = _Rows(linear, poses, used)
    if _rms(data.given) < LEAST_NOISE_MM:  # rounding explains it
        return
    tried = list(_explanations(data, as_given))
    gains = np.array([data.gain(one) - np.log(one.n_tried) for one in tried])
    best, gain = tried[int(gains.argmax())], gains.max()
    if gain < _PRICE:
        return
    said, advice = WORDS[best.code]
    before, after = (_rms(left) for left in (data.given[best.rows], best.left))
    near = {one.code: one for one, of in zip(tried, gains, strict=True) if of > gain - _EQUAL}
    others = [WORDS[code][0].format(one.what) for code, one in near.items() if code != best.code]
    yield Finding(
        best.code,
        f"The new residuals leave {before:.3g} mm about the model, and {after:.3g} mm if "
        f"{said.format(best.what)} (likelier by {gain:.0f} nats)"
        f"{', or if '.join(['', *others])}.",
        advice,
        "repair",
        rows=row_numbers(used[[best.first]]) if best.first else (),
        size_mm=before,
    )


class _Rows:
    """New poses that count, what the model expects of them, and likelihoods of what is left."""

    def __init__(self, linear, poses, used):
        self.linear, self.prior = linear, prior_of(linear)
        self.angles, self.y = poses.angles[used], poses.residuals[used]
        self.codes = None if poses.codes is None else poses.codes[used]
        self.expected = linear.predict(self.angles)[0]
        self.given = self.y - self.expected
        self.spreads = {}

    def gain(self, one):
        """Log likelihood of an explanation less that of the same rows as they are given, nats."""
        some = np.linspace(0, len(one.rows) - 1, min(_ROWS, len(one.rows))).astype(int)
        rows = one.rows[some]
        spread, left = self._spread(rows, one.table), _tamed(one.left[some], self._codes(rows))
        noise = 0.0
        if one.noise_like is not None:
            noise = spread.log_noise(one.noise_like[rows])
        explained = spread.log_likelihood(left, one.taus, one.noise_log_sd, noise)
        explained += spread.freedom * one.log_scale
        left = _tamed(self.given[rows], self._codes(rows))
        given = self._spread(rows).log_likelihood(left, _TAUS)
        if one.table:
            given = max(given, self._spread(rows, _CALIBRATED).log_likelihood(left, _TAUS))
        if one.alone is not None:  # without an outlier rows are likelier by any model
            parts = [_tamed(part, self._codes(rows)) for part in (one.alone[some], self.y[rows])]
            ahead = [spread.log_likelihood(part, _TAUS[:1]) for part in parts]
            given += max(ahead[0] - ahead[1], 0.0)
        return explained - given

    def _codes(self, rows):
        return None if self.codes is None else self.codes[rows]

    def _spread(self, rows, table=0.0):
        """Covariance of what is left at some rows; most explanations share it."""
        key = (rows.tobytes(), table)
        if key not in self.spreads:
            parts = self.angles[rows], self._codes(rows), table
            self.spreads[key] = _Spread(self.linear, self.prior, *parts)
        return self.spreads[key]


class _Spread:
    """Covariance of the residuals of some poses about the model, along its own axes."""

    def __init__(self, linear, prior, angles, codes, table):
        n_joints, n = linear.arm.n_joints, 3 * len(angles)
        columns = linear.columns(angles).reshape(n, -1)
        known = max(linear.std_scale, 1.0) * (columns @ linear.half)
        covariance = known @ known.T
        if table:
            size = np.repeat([table, 1e-3 * table] * 2, n_joints)
            other = parameter_jacobian(linear.arm, angles[:, :n_joints])[1][:, :, :-3] * size
            other = other.reshape(n, -1)
            covariance += other @ other.T
        noise = max(linear.noise_scale, 1.0) ** 2 * prior.noise_variance
        covariance[np.diag_indices(n)] += noise
        nuisance = place_columns(linear.arm, angles, codes is None).reshape(n, -1)
        if codes is not None:
            offsets = np.kron(codes[:, None] == np.unique(codes), np.eye(3))
            nuisance = np.hstack([nuisance, offsets])
        root = cholesky(covariance, lower=True, check_finite=False)
        self.whiten = Whitened(root, nuisance)
        self.freedom = self.whiten.freedom
        changes = self.whiten(columns * prior.size)
        axes, size, _ = np.linalg.svd(changes, full_matrices=False)
        self.axes, self.size = axes, np.square(size)
        # Of the restricted likelihood: nuisances that are seen better cost more.
        seen = np.linalg.svd(self.whiten.scaled(nuisance), compute_uv=False)
        seen = seen[seen > 1e-8 * seen.max()]
        self.log_volume = -np.log(root.diagonal()).sum() - np.log(seen).sum()

    def log_noise(self, vectors):
        """Logarithm of the noise that scatters as noise and some vectors (n, 3) together."""
        vectors = self.whiten(vectors.ravel())
        return 0.5 * np.log1p(vectors @ vectors / self.freedom)

    def log_likelihood(self, left, taus, noise_log_sd=_NOISE_LOG_SD, noise=0.0):
        """Highest log likelihood of residuals (n, 3) over changes of the arm and the noise."""
        left = self.whiten(left.ravel())
        along = np.square(self.axes.T @ left)
        rest = max(left @ left - along.sum(), 0.0)
        wider = 1 + np.square(taus)[:, None] * self.size
        squares = rest + (along / wider).sum(axis=1)
        log_noise = 0.5 * np.log(np.maximum(squares / self.freedom, 1e-300))
        value = -0.5 * squares * np.exp(-2 * log_noise) - self.freedom * log_noise
        value -= 0.5 * np.log(wider).sum(axis=1) + 0.5 * np.square(
            (log_noise - noise) / noise_log_sd
        )
        log_tau = np.log(np.maximum(taus, _TAUS[1]) / _TAU) / _TAU_LOG_SD
        return float(np.max(value - 0.5 * np.square(log_tau))) + self.log_volume


def _explanations(data, as_given):
    """Yield what may be wrong with residuals; if they are as given, the arm is another one."""
    y, expected, angles = data.y, data.expected, data.angles
    every = np.arange(len(y))

    def of(code, what, left, rows=every, **more):
        return Explanation(code, what, left, rows, **more)

    yield of("another-arm", "", y, taus=_ANOTHER)
    if as_given:
        return
    yield of("sign-of-residuals", "", -y - expected)
    # What is left of corrected residuals is the noise that is known.
    few = {"taus": _TAUS[_ANOTHER[0] > _TAUS], "noise_log_sd": _KNOWN_LOG_SD}
    yield of("corrected-already", "", y, **few)
    if data.linear.n_positions >= LEAST_POSITIONS:  # from fewer no table is known elsewhere
        yield of("other-table", "", data.given, table=_ANOTHER_TABLE)
    # What is left of residuals of other rows is as large as what the model expects of these.
    none = {"taus": _TAUS[:1], "noise_log_sd": _KNOWN_LOG_SD, "noise_like": expected}
    yield of("rows-unrelated", "", y, **none)
    for factor, unit in UNITS.items():
        size = {"n_tried": len(UNITS), "log_scale": np.log(factor), "noise_log_sd": _KNOWN_LOG_SD}
        yield of("unit-of-residuals", unit, factor * y - expected, **size)
    yield from _axes(of, y, expected)
    yield from _late(of, y, expected, data)
    for words, changed in changed_joints(angles, data.linear.arm.n_joints):
        left = y - data.linear.predict(changed)[0]
        yield of("joints", words, left, n_tried=20)


def _axes(of, y, expected):
    """The best of 46 exchanges and mirrors of axes, and of all rotations."""
    turns = []
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        one = np.eye(3)[list(order)] * np.array(signs)[:, None]
        if not (np.allclose(one, np.eye(3)) or np.allclose(one, -np.eye(3))):
            turns.append(one)
    best = max(turns, key=lambda one: np.vdot(y @ one.T, expected))
    names = [("-" if row.sum() < 0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in best]
    yield of("axes-of-residuals", " ".join(names), y @ best.T - expected, n_tried=len(turns))
    # Three numbers, each known to some hundredths.
    for mirror, words in ((1.0, "turned"), (-1.0, "turned and mirrored")):
        turn = align(mirror * y, expected)[0]
        left = mirror * y @ turn.T - expected
        yield of("axes-of-residuals", f"they are {words}", left, n_tried=10_000)


def _late(of, y, expected, data):
    """From some row on, residuals are of the row before or after."""
    for step, word in ((1, "before"), (-1, "after")):
        rows = np.arange(max(-step, 0), len(y) - max(step, 0))
        if data.codes is not None:
            rows = rows[data.codes[rows + step] == data.codes[rows]]
        if len(rows) < _LEAST_ROWS:
            continue
        good, late = y[rows] - expected[rows], y[rows + step] - expected[rows]
        limit = _FAR**2 * np.median(np.square(good).sum(axis=1))
        worth = [np.minimum(np.square(one).sum(axis=1), limit) for one in (good, late)]
        ahead = np.r_[0.0, np.cumsum(worth[0] - worth[1])]
        first = int(np.argmin(ahead))
        if first == len(rows):
            continue
        before = np.arange(len(rows))[:, None] < first
        what = word if first == 0 else f"{word}, from row {row_numbers(rows[[first]])[0]} on"
        tried = 4 if first == 0 else 4 * len(rows)
        parts = (good, late), (y[rows], y[rows + step])
        left, alone = (np.where(before, *part) for part in parts)
        more = {"n_tried": tried, "first": int(rows[first] * (first > 0)), "alone": alone}
        yield of("rows-shifted", what, left, rows, **more)


def _tamed(left, codes):
    """Residuals of which none is farther from the middle of its position than some medians."""
    middle = np.zeros_like(left)
    if codes is not None:
        for code in np.unique(codes):
            middle[codes == code] = np.median(left[codes == code], axis=0)
    distance = np.linalg.norm(left - middle, axis=1)
    limit = _FAR * np.median(distance)
    return middle + np.minimum(1.0, limit / np.maximum(distance, 1e-300))[:, None] * (left - middle)


def _rms(vectors):
    return float(np.sqrt(np.square(vectors).sum(axis=1).mean()))
