"""New rows of a fitted model: checked, and what they show beside what is unknown of features."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import chi

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model import (
    ArmResidualRegressor,
    LinearModel,
    Rows,
    check_poses,
    known_lengths,
    touched_rows,
)
from sklearn_raacmm.measurements import Measurements, base_motions, check_length
from sklearn_raacmm.utils import Groups, floats, listed

# How far base and tool may be from where they were registered, mm at the probe: six times what the
# worst way of registering leaves in ``benchmarks/bench_after_the_lab.py series``.
REGISTERED_PLACE_MM = 5.0
# Poses that the check names as slipped: this many on the average in a set without slips. If more
# than the second share of all poses lie that far off, they are no slips. Both are chosen by hand.
_FALSE_NAMES, _MOST_SLIPS = 0.01, 0.1
# Poses farther off than this share of all, if errors were normal, count as though they were there:
# those of a real arm have longer tails, of which a single pose must not raise an alarm. Without
# this 4 % of 400 checks of the UR10 raised one at a rate of 1 %, with it 2.5 %
# (``benchmarks/bench_check.py changes --real``). With 0.9 fewer knocks were found.
_USUAL = 0.95
# Part of a column that is rounding. Part that unknowns leave of a cause that cannot be told from
# them: a hundredth of it would be called metres.
_ROUNDING, TAKEN_UP = 1e-9, 1e-2


def new_rows(
    model: ArmResidualRegressor,
    X: ArrayLike,
    y: ArrayLike | None,
    groups: ArrayLike | None = None,
    lengths: Iterable[Sequence[object]] = (),
    features: Iterable[Sequence[object]] = (),
) -> Rows:
    """New poses of a fitted model as the rows of a fit; each fault gets one clear sentence.

    Without groups no position has an unknown offset. Touches of surfaces are about the forms of the
    corrected points, to which `y` has nothing to say.
    """
    if not isinstance(model, ArmResidualRegressor):
        raise TypeError(
            f"{type(model).__name__} holds no linear model and cannot be updated or checked: "
            "it has no posterior of causes. It can be registered, by "
            "calibrate(..., correction=model)."
        )
    X, linear = check_poses(model, X), model.linear_model_
    residuals, arm = floats("y", y, 3), linear.arm
    lengths, features = listed("lengths", lengths), listed("features", features)
    if len(residuals) != len(X):
        raise ValueError(f"X has {len(X)} rows, but y has {len(residuals)}.")
    if groups is None and linear.offsets:
        raise ValueError(
            "The model has an unknown offset at every position: give groups, the position of "
            "each new pose."
        )
    weights = np.ones(len(residuals))
    if groups is None:
        if lengths or features:
            what = "lengths are between" if lengths else "features are labels of"
            raise ValueError(f"{what} positions: give groups, the position of each pose.")
        return Rows(arm, X, residuals, weights, None)
    labels, codes = Groups.encoded(groups, len(residuals))
    known = [check_length(entry, labels.tolist()) for entry in lengths]
    of_touches: dict[str, Any] = {}
    if features:
        expected = linear.predict(X)[0]
        points = arm.forward(X[:, : arm.n_joints]) - expected
        touches = touched_rows(features, labels, codes, points, residuals - expected, weights)
        residuals, of_touches = touches[0] + expected, touches[1]
        of_touches.pop("held")
        known += of_touches.pop("sizes")
    return Rows(arm, X, residuals, weights, codes, tuple(known), **of_touches)


def for_centres(measured: Measurements, points: np.ndarray) -> dict[str, Any]:
    """Groups, lengths and features as a model takes them: those of the centre of the probe.

    Of lengths that may be longer for the probe's own ball, those that fit the points (n, 3) best.
    """
    labels, lengths, sizes = measured.labels.tolist(), [], {}
    forms = measured.touched.linearised(points).forms if measured.lengths else []
    for (i, j, mm, sd), longer in zip(measured.lengths, measured.offsets, strict=True):
        off = forms[i].length_to(forms[j])[0] - mm
        centres = mm + float(longer[np.argmin(np.abs(off - longer))]), sd
        if i == j:
            sizes[i] = centres
        else:
            lengths.append((labels[i], labels[j], *centres))
    kinds = enumerate(measured.touched.kinds)
    features = [(labels[i], kind, *sizes.get(i, ())) for i, kind in kinds if kind != "cone"]
    groups = measured.labels[measured.index]
    return {"groups": groups, "lengths": lengths, "features": features}


def positions_of(rows: Rows) -> np.ndarray:
    """Numbers (n,) of what is left out together: positions, or each row where there are none."""
    return np.arange(len(rows.X)) if rows.codes is None else rows.codes


def place_columns(arm: Arm, angles: np.ndarray, with_base: bool) -> np.ndarray:
    """What moves of the tool and shifts and turns of the base do to the probe, (n, 3, 3 or 9).

    Each of the size that a registration may be wrong by. Of positions with offsets the base shows
    nothing.
    """
    angles = angles[:, : arm.n_joints]  # without extra columns
    tool = REGISTERED_PLACE_MM * arm.frames(angles)[:, -1, :3, :3]
    if not with_base:
        return tool
    base = base_motions(arm.forward(angles), arm.reach_mm)
    return np.concatenate([tool, REGISTERED_PLACE_MM * base], axis=2)


class Expected:
    """What a linear model expects of some rows, checked by `new_rows`, in mm."""

    def __init__(self, linear: LinearModel, rows: Rows) -> None:
        self.linear, self.rows = linear, rows

    def times(self, root: np.ndarray) -> np.ndarray:
        """The columns times a root (p, r) of a covariance of the coefficients, (n, 3, r)."""
        # One product of matrices is three times as fast as one for each row.
        flat = self.columns.reshape(-1, len(root)) @ root
        return flat.reshape(*self.columns.shape[:2], root.shape[1])

    @cached_property
    def columns(self) -> np.ndarray:
        """The model's columns there, (n, 3, p)."""
        return self.linear.columns(self.rows.X)

    @cached_property
    def spread(self) -> np.ndarray:
        """Root of the covariance of what is expected, (n, 3, r)."""
        return self.times(self.linear.half)

    @cached_property
    def doubts(self) -> np.ndarray:
        """The same of what corrections fade by, (n, 3, q)."""
        return self.times(self.linear.fading_half)

    @cached_property
    def mean(self) -> np.ndarray:
        """The correction, (n, 3)."""
        return self.columns @ self.linear.coef

    @cached_property
    def std(self) -> np.ndarray:
        """Standard deviation (n, 3) of the correction, of what a test can show."""
        return np.linalg.norm(self.times(self.linear.gauge_free_half), axis=2)

    @cached_property
    def shown(self) -> "Shown":
        """What the rows show."""
        return Shown(self)

    def at(self, which: np.ndarray | slice) -> "Expected":
        """The same of some of the rows."""
        return Expected(self.linear, self.rows.at(which))

    def widened(self) -> "Expected":
        """The same by a model that is as uncertain as positions left out of this arm ask for.

        Never narrower than the posterior: tests of squares bear no tails that are longer than
        normal ones, which a factor below 1 makes up for in intervals.
        """
        linear, wider = self.linear, max(self.linear.std_scale, 1.0)
        noise = np.square(max(linear.noise_scale, 1.0)) * linear.noise_variance
        half, seen = wider * linear.half, wider * linear.seen
        return Expected(replace(linear.with_noise(noise), half=half, seen=seen), self.rows)


class Shown:
    """What rows show of columns in mm, beside the unknowns of what was touched: see `Whitening`.

    Every coordinate has the same noise, that of the model: with the noise of each joint checks of
    the UR10 found 0.65 of the knocks that they find so 0.7 of, and updates with 10 poses left 2 %
    more (``benchmarks/golden.py --only update check``). Known lengths are rows of one
    coordinate behind the others. `y` (n + l, 3) is what the rows say before any correction, mm, and
    `weights` (n + l,) what they count; `rank` (n + l,) how many coordinates each has;
    `n_coordinates` are all less the unknowns, of which there are `n_unknown`.
    """

    def __init__(self, expected: Expected) -> None:
        rows, n_lengths = expected.rows, len(expected.rows.lengths)
        self.noise_sd, self.expected = expected.linear.noise_sd, expected.mean
        self.weights, self.rank = (
            np.r_[np.broadcast_to(one, len(rows.X)), np.ones(n_lengths)]
            for one in (rows.weights, rows.rank)
        )
        self.rows = rows = rows._replace(root=rows.shown, weights=np.ones(len(rows.X)))
        self.whitened: Any = rows.whitening()
        self.n_coordinates = round(self.whitened.n_observations) + n_lengths
        self.n_unknown = int(self.rank.sum()) - self.n_coordinates
        if rows.lengths:
            points = rows.arm.forward(rows.X[:, : rows.arm.n_joints]) - self.expected
            given = np.stack([points, rows.y - self.expected], axis=2)
            unknowns = np.moveaxis(self.whitened.unknowns(given), 2, 0)
            *ends, length, sd = map(np.array, zip(*rows.lengths, strict=True))
            measured, slopes = known_lengths(rows.forms, np.array(ends), *unknowns)
            self.errors = measured - length
            unit, n = self.whitened.unit, np.arange(n_lengths)
            # What each length has of the unknowns of every feature, (l, features, q).
            self.of_unknowns = np.zeros((n_lengths, *unit.shape[:2]))
            for end, slope in zip(ends, slopes, strict=True):
                self.of_unknowns[n, end] += slope
            own = np.einsum("lgq,gqk->lgk", self.of_unknowns, unit).reshape(n_lengths, -1)
            covariance = own @ own.T + np.diag(np.square(sd) / self.noise_sd**2)
            self.of_lengths = cholesky(covariance, lower=True, check_finite=False)
        self.y = self.left(rows.y, np.zeros((len(rows.X), 3)))

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        """Columns (n, 3, k) in mm as whitened rows, (n + l, 3, k)."""
        return self._with_lengths(columns, columns)

    def left(self, left: np.ndarray, correction: np.ndarray) -> np.ndarray:
        """What a correction (n, 3) leaves of rows, `left`, and of lengths, whitened (n + l, 3)."""
        moved = self.expected - correction
        return self._with_lengths(left[:, :, None], moved[:, :, None], True)[:, :, 0]

    def flat(self, columns: np.ndarray, least: float = _ROUNDING) -> np.ndarray:
        """Columns (n, 3, k) as whitened coordinates over their noise, (3 (n + l), k).

        Those of which unknowns leave less than the `least` part are 0.
        """
        found = self(columns).reshape(3 * len(self.rank), columns.shape[2]) / self.noise_sd
        alone = np.linalg.norm(columns, axis=(0, 1)) / self.noise_sd
        return np.where(np.linalg.norm(found, axis=0) > least * alone, found, 0.0)

    def _with_lengths(self, columns, moves, with_errors=False):
        """Columns (n, 3, k), whitened, then of each length what `moves` of the probe do to it."""
        found = self.whitened.deviations(columns)
        if not self.rows.lengths:
            return found
        values = np.einsum("lgq,gqk->lk", self.of_unknowns, self.whitened.unknowns(moves))
        values += with_errors * self.errors[:, None]
        of_lengths = np.zeros((*values.shape, 3)).swapaxes(1, 2)
        of_lengths[:, 2] = solve_triangular(self.of_lengths, values, lower=True, check_finite=False)
        return np.concatenate([found, of_lengths])


def why_too_few(expected: Expected) -> str:
    """Why nothing can be learnt from these rows, or an empty string."""
    rows, n = expected.rows, expected.shown.n_coordinates
    n_free = 9 if rows.codes is None else 3
    if n > n_free:  # of base and tool; cones show the tool's alone
        return ""
    return (
        f"{len(rows.X)} new poses give {n} coordinates, fewer than would "
        f"show more than the {n_free} freedoms of base and tool"
    )


def slipped_rows(expected: Expected, left: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows too far off for their own expected spread, if they are few, and residuals without tails.

    Where the distances of all are larger than expected, by a change of the arm, farther ones are
    usual in proportion.
    """
    rows = expected.rows
    rank = rows.rank
    sd = np.sqrt(np.square(expected.std).max(axis=1) + expected.linear.noise_variance)
    # Touches of a surface are about their form already.
    middle = np.where(np.reshape(rank, (-1, 1)) == 3, Groups(rows.codes).medians(left), 0.0)
    distance = np.linalg.norm(rows.along(left - middle), axis=1) / sd
    far = distance > chi.isf(_FALSE_NAMES / len(left), rank)
    slipped = far & (far.sum() <= _MOST_SLIPS * len(left))
    larger = max(np.median(distance / chi.median(rank)), 1.0)
    share = np.minimum(chi.ppf(_USUAL, rank) * larger / np.maximum(distance, 1e-300), 1.0)
    return slipped, middle + share[:, None] * (left - middle)
