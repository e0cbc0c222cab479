"""The fitted linear error model as a value: its columns, coefficients and their covariance.

A single-point test compares poses that reach one point. It shows nothing of a motion of the base,
of a common scale of all lengths, or of a base that bends under the arm's load: they move all poses
that reach a point by the same vector.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, Self

import numpy as np

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model._columns import (
    ARCSEC,
    FAMILIES,
    KINEMATICS,
    LOAD,
    OF_LOADS,
    TEMPERATURE,
    Columns,
    Root,
    Terms,
    columns_of,
)
from sklearn_raacmm.utils import Groups, check_shapes, chunks

# Columns times poses that are held at a time: 1 MB for each coordinate, measured between 2^13 and
# 2^18 with 177 and 769 columns.
_CHUNK = 2**17
# Poses at which fields are compared with columns: three equations each, for some 200 columns.
_POSES = 150
# Poses in the range of those of a fit at which fields are told from columns: a number for speed.
_TRIED = 200
# Share of a field that columns may leave for it to be one of theirs: bending about the second
# joint's axis is one only nearly.
_LEFT = 0.01
# A combination of fields that moves the positions by less than this share of what the one that is
# shown best does stays in the standard deviations (``benchmarks/bench_few_poses.py``).
_LEAST_SHOWN = 0.05
# Standard deviation of how much the base gives way over that of joints and links, where positions
# do not show it (``benchmarks/bench_lengths.py predict --first 200 --arms 46``).
_BASE = 0.3
# Size of a column, relative to the largest, that moves nothing. Part of the difference of two
# roots that is rounding, and of what columns show together.
_NOTHING, _NEVER = 1e-6, 1e-9
# Divides the roots of a noise of 0, mm.
_NO_NOISE = 1e-150
# Fields of the table, none of which a probe changes, and by how much rounding may.
_OF_TABLE = ("a", "alpha", "d", "theta_offset", "joint_signs")
_SAME_TABLE = 1e-9
# How far from the probe others are by which the turn of the last link is found, mm: any will do,
# since all is in proportion.
_BESIDE_MM = 100.0
# Standard deviation of what poses of one probe do not show of a table, where a drawing states
# another: in units of its columns, arc seconds and what these span at the arm's reach. Angles are
# published within 0.02 degrees, which are 72. Of 32 stated probes of simulated arms, 100 to 250 mm
# away, 0.93 of the errors are inside intervals of 95 %, without it 0.38
# (``benchmarks/bench_after_the_lab.py stated``).
_DRAWING_SD = 75.0
# Families whose columns are all per reach.
_PER_REACH = ("gravity", "force", "base")

# Shapes of what a file holds. Roots of one that was written when `seen` was not in it.
_SHAPES = {
    "coef": ("columns",),
    "half": ("columns", "rank"),
    "log_bayes_factor": ("pairs",),
    "noise_of_joints": ("joints",),
    "lever_mm": ("joints",),
}
_BEFORE = {
    "half": ("columns", "rank"),
    "gauge_free_half": ("columns", "rank"),
    "fading_half": ("columns", "fading"),
}
_OF_HARMONICS = (
    "joint", "order", "amplitude_arcsec", "phase_deg", "cos_arcsec", "sin_arcsec",
    "cos_sd_arcsec", "sin_sd_arcsec", "log_bayes_factor",
)  # fmt: skip

# Of positions without offsets: they hide no field.
NOTHING_SEEN = np.zeros((0, 0))


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Posterior of a linear error model: ``columns(angles) @ coef`` is the correction in mm.

    Estimators hold it, planners and exporters read it, and files keep it. It does not change;
    ``dataclasses.replace`` makes another one.

    Attributes
    ----------
    layout : Columns
        What each column is, and how it is computed: of the calibrated `arm`, and of the `terms`.
    coef : ndarray of shape (n_columns,)
        Posterior mean of the coefficients.
    half : ndarray of shape (n_columns, r)
        Root of their covariance, which is ``half @ half.T``.
    noise_of_joints : ndarray of shape (n_joints,)
        Variance of the noise of each joint's angle, rad^2: it reaches the probe by its lever.
    noise_of_rows : float
        Variance of the noise that each coordinate has beside that, mm^2.
    lever_mm : ndarray of shape (n_joints,)
        Root mean square over the poses of the fit of what one radian of a joint moves a coordinate
        by.
    prior_sd : dict
        Standard deviation before any data of the coefficients of each family.
    offsets : bool
        Whether each position had an unknown offset.
    n_determined : float
        Effective number of coefficients that the data determine.
    log_bayes_factor : ndarray of shape (n_harmonics,)
        By how much each harmonic of `terms` raises the log evidence, beside all others.
    seen : ndarray of shape (k, r)
        How much of each field of `place_fields` columns of `half` hold: a single-point test shows
        what is left without these (see `gauge_free_half`). Empty where positions have no offsets.
    ranges : ndarray of shape (2, n_joints + n_extra)
        Least and largest value, at the poses of the fit, of the joints' own angles in rad and of
        each extra column; then of the probe in mm where rows had their own.
    informed_half : ndarray of shape (n_columns, q) or None
        Root of the covariance by which corrections fade after an update: what the new poses leave
        of the root by which they faded before. None: `gauge_free_half`.
    std_scale, noise_scale : float
        Factors of the standard deviation of the model and of the noise at which intervals hold at
        positions that were left out; 1 where that is not known.
    n_positions : float
        From how many positions these factors are; infinity where that is not known.
    shown_by : ndarray of shape (3,) or None
        Vector of the probe that poses have found last, where that of `arm` is only stated.
    """

    layout: Columns
    coef: np.ndarray
    half: np.ndarray
    noise_of_joints: np.ndarray
    noise_of_rows: float
    lever_mm: np.ndarray
    prior_sd: dict[str, float]
    offsets: bool
    n_determined: float
    log_bayes_factor: np.ndarray
    seen: np.ndarray
    ranges: np.ndarray
    informed_half: np.ndarray | None = None
    std_scale: float = 1.0
    noise_scale: float = 1.0
    n_positions: float = float("inf")
    shown_by: np.ndarray | None = None

    def __getstate__(self) -> dict[str, object]:
        of_layout = {"arm": self.arm, "terms": self.terms}
        own = {f.name: getattr(self, f.name) for f in fields(self)[1:]}
        if self.shown_by is None:
            del own["shown_by"]  # a file of a probe that poses have found does not name it
        return of_layout | own

    def __setstate__(self, state: dict[str, Any]) -> None:
        values = {"shown_by": None, **state}
        before = _BEFORE.keys() <= values.keys() and "seen" not in values
        if "noise_of_angles" in values and "noise_variance" in values:  # until 0.1.0.dev0
            share, variance = values.pop("noise_of_angles"), values.pop("noise_variance")
            n, lever = values["arm"].n_joints, values["lever_mm"]
            values["noise_of_joints"] = np.full(n, share * variance / lever**2)
            values["noise_of_rows"] = (1 - share) * variance
            values["lever_mm"] = np.full(n, lever / np.sqrt(n))
        wanted = {"arm", "terms", *(f.name for f in fields(self)[1:])}
        if before:
            wanted ^= {"seen", "ranges", "informed_half", *_BEFORE}
        # A default would be a guess at what another version knew of this model.
        if missing := sorted(wanted.difference(values)):
            raise ValueError(
                f"The file does not say {', '.join(missing)} of the linear model: another version "
                "wrote it, or it is damaged."
            )
        arm, terms = values.pop("arm"), values.pop("terms")
        pairs = np.asarray(terms.harmonics)
        check_shapes("LinearModel", {"harmonics": pairs}, {"harmonics": ("pairs", 2)}, {})
        if len(pairs) and not (0 <= pairs[:, 0].min() <= pairs[:, 0].max() < arm.n_joints):
            raise ValueError(
                f"The file is damaged: a harmonic belongs to joint {pairs[:, 0].max() + 1} of "
                f"{arm.n_joints}."
            )
        layout = columns_of(arm, terms)
        shapes: dict[str, Any] = _SHAPES | (_BEFORE if before else {"ranges": (2, "inputs")})
        if not before and len(values["seen"]):
            shapes["seen"] = ("fields", "rank")
        if values.get("informed_half") is not None:
            shapes["informed_half"] = ("columns", "informed")
        n = 2 * len(pairs) + len(layout.others)
        sizes = {"columns": n, "pairs": len(pairs), "joints": arm.n_joints}
        check_shapes("LinearModel", values, shapes, sizes)
        if before:
            values = _as_now(values, layout)
        vars(self).update(values, layout=layout)

    @property
    def arm(self) -> Arm:
        """The calibrated arm."""
        return self.layout.arm

    @property
    def terms(self) -> Terms:
        """Which columns there are."""
        return self.layout.terms

    @property
    def coef_sd(self) -> np.ndarray:
        """Standard deviations of the coefficients, (n_columns,)."""
        return np.sqrt(np.square(self.half).sum(axis=1))

    @property
    def noise_variance(self) -> float:
        """Variance of a coordinate about the model, mm^2, the mean over the poses of the fit."""
        return float(self.noise_of_rows + np.square(self.lever_mm) @ self.noise_of_joints)

    def with_noise(self, variance: float) -> Self:
        """The same model with another `noise_variance`, in the same proportions."""
        if not self.noise_variance > 0:
            return replace(self, noise_of_rows=variance)
        ratio = variance / self.noise_variance
        of_joints, of_rows = ratio * self.noise_of_joints, ratio * self.noise_of_rows
        return replace(self, noise_of_joints=of_joints, noise_of_rows=of_rows)

    @property
    def noise_sd(self) -> float:
        """Standard deviation of a coordinate about the model, mm."""
        return float(np.sqrt(self.noise_variance))

    def columns(self, angles: np.ndarray) -> np.ndarray:
        """Columns (n, 3, n_columns) of the model in mm per unit coefficient: see `Columns`."""
        return self.layout.at(angles)

    def predict(self, angles: np.ndarray, return_std: bool = False) -> tuple[np.ndarray, Any]:
        """Posterior of the correction: mean (n, 3) and standard deviation (n, 3) or None, mm.

        The standard deviation is without noise, and of what the test can show: `std_scale` makes
        intervals of it that hold.
        """
        return self.predict_with_doubt(angles, return_std, return_doubt=False)[:2]

    def predict_with_doubt(
        self, angles: np.ndarray, return_std: bool = False, return_doubt: bool = True
    ) -> tuple[np.ndarray, Any, Any]:
        """As `predict`, and what corrections fade by: the length (n,) by `fading_half` in mm."""
        roots = [self._std_root] if return_std else []
        if return_doubt and not (return_std and self.informed_half is None):  # else it is the same
            roots.append(self._fading_root)
        mean = np.empty((len(angles), 3))
        squares = [np.empty((len(angles), 3)) for _ in roots]
        for rows in chunks(len(angles), _CHUNK // max(len(self.coef), 1)):
            columns = self.layout.factored(angles[rows])
            mean[rows] = columns.dot(self.coef)
            for found, root in zip(squares, roots, strict=True):
                found[rows] = columns.squares(root)
        doubt = np.sqrt(squares[-1].sum(axis=1)) if return_doubt else None
        return mean, np.sqrt(squares[0]) if return_std else None, doubt

    @cached_property
    def gauge_free_half(self) -> np.ndarray:
        """As `half`, of what a single-point test can show, (n_columns, r): `constrained` says what.

        Standard deviations of predictions are made of it, those of lengths of `half`. The same
        where positions have no offsets.
        """
        return self.half - place_fields(self.layout) @ self.seen if len(self.seen) else self.half

    @property
    def fading_half(self) -> np.ndarray:
        """Root of the covariance by which corrections fade, (n_columns, q)."""
        return self.gauge_free_half if self.informed_half is None else self.informed_half

    @cached_property
    def scale_sd(self) -> float:
        """Standard deviation of the common scale of all distances, as a share of them."""
        return float(np.linalg.norm(self._scale_of(*self._in_ranges()) @ self.half))

    @cached_property
    def _std_root(self):
        return Root(self.gauge_free_half, self.layout.runs)

    @cached_property
    def _fading_root(self):
        if self.informed_half is None:
            return self._std_root
        return Root(self.informed_half, self.layout.runs)

    def noise_root(self, angles: np.ndarray) -> np.ndarray:
        """Root (n, 3, 3 + n_joints) of the noise's covariance at poses, over `noise_variance`."""
        root = np.zeros((len(angles), 3, 3 + self.arm.n_joints))
        size = max(self.noise_sd, _NO_NOISE)
        root[:, range(3), range(3)] = np.sqrt(self.noise_of_rows) / size
        if self.noise_of_joints.any():
            root[:, :, 3:] = np.sqrt(self.noise_of_joints) / size * self.layout.levers(angles)
        return root

    def noise_ratio(self, angles: np.ndarray) -> np.ndarray:
        """Standard deviation of each coordinate's noise at poses over `noise_sd`, (n, 3)."""
        ratio = np.ones((len(angles), 3))
        if self.noise_of_joints.any():
            for rows in chunks(len(angles), _CHUNK // 32):
                ratio[rows] = np.linalg.norm(self.noise_root(angles[rows]), axis=2)
        return ratio

    def root_at(self, angles: np.ndarray, with_unseen: bool = True) -> np.ndarray:
        """Root (3 n, r) of the posterior covariance of the coordinates of some poses, mm.

        What a single-point test shows is widened by `std_scale`, what it does not is not.
        """
        half = self.std_scale * self.gauge_free_half
        if with_unseen and len(self.seen):
            half = half + np.matmul(*self._unseen)
        out = np.empty((len(angles), 3, half.shape[1]))
        for rows in chunks(len(angles), _CHUNK // max(len(self.coef), 1)):
            columns = self.columns(angles[rows])
            every = columns.reshape(3 * len(columns), len(half)) @ half
            out[rows] = every.reshape(len(columns), 3, half.shape[1])
        return out.reshape(-1, half.shape[1])

    @cached_property
    def _unseen(self):
        """What positions with offsets do not show, as columns (n_columns, k) and a root (k, r).

        Without the motions of the base: the frame is the arm's own. What is left is the scale, and
        how the arm gives way as a function of the place.
        """
        n = _n_motions(self.layout.alone) if self.offsets else 0
        of_place = place_fields(self.layout)[:, n:].copy()
        for i, column in enumerate(self.layout.others, start=self.layout.n_waves):
            if self.offsets and column.kind == LOAD and column.frame == 0:
                of_place[i] *= _BASE
        return of_place, self.seen[n:]

    def unseen_variance(self, angles: np.ndarray) -> np.ndarray:
        """Variance of each coordinate that positions with offsets do not show, (n, 3), mm^2.

        With G the widened root of what they show and ``U = F S`` of what they do not, ``(G + U) (G
        + U)' - G G'`` is ``F S (2 G + U)'`` but for its order. F is narrow, for few fields differ.
        """
        variance = np.zeros((len(angles), 3))
        if not self.offsets or not len(self.seen):
            return variance
        of_place, seen = self._unseen
        other = (2 * self.std_scale * self.gauge_free_half + of_place @ seen) @ seen.T
        for rows in chunks(len(angles), _CHUNK // 256):
            columns = self.columns(angles[rows])
            columns = columns.reshape(3 * len(columns), len(other))
            variance[rows] = ((columns @ of_place) * (columns @ other)).sum(axis=1).reshape(-1, 3)
        return np.maximum(variance, 0.0)  # both together may be known better than what is shown

    def constrained(
        self, X: np.ndarray, weights: np.ndarray, codes: np.ndarray, keep_scale: bool = True
    ) -> Self:
        """Model by what positions with offsets show: not the scale, nor where the base stands.

        Unless known lengths show the scale, distances between positions stay on the average as the
        calibration has them (an inner constraint, as geodesists have it in free networks). Kept at
        other poses instead, lengths of simulated gauges are too short by 5 to 19 um.
        """
        coef = self.coef
        if keep_scale:
            means = Groups(codes).means(self.layout.points_and_shifts(X, coef), weights)
            coef = coef - self.layout.scale * self._scale_of(means[:, :, 0], means[:, :, 1:])
        return replace(self, coef=coef).with_seen()

    def with_seen(self) -> Self:
        """Model that knows how much of each field of `place_fields` it holds: `seen` anew.

        Other columns imitate the fields. With M the columns at poses anywhere in `ranges` and ``F =
        M W`` those of the fields W, ``G = lstsq(F, M)`` is the field in every column. Mean poses of
        few positions would leave fields in what is shown (``benchmarks/bench_few_poses.py``).
        Fields that are hardly told from others are left, but the scale of the table is taken out
        whole.
        """
        of_place, (points, columns) = place_fields(self.layout), self._in_ranges()
        columns = columns.reshape(points.size, -1)
        there = columns @ of_place
        seen = np.zeros((of_place.shape[1], self.half.shape[1]))
        if self.terms.kinematics:
            scale_of, i = self._scale_of(points, columns), _n_motions(self.layout.alone)
            seen[i] = scale_of @ self.half / (scale_of @ of_place[:, i])
        inverse = np.linalg.pinv(there, rcond=_LEAST_SHOWN)
        left = (inverse @ columns) @ self.half - (inverse @ there) @ seen
        return replace(self, seen=seen + left)

    def with_scale_sd(self, scale_sd: float) -> Self:
        """Model that knows the common scale of all distances to this standard deviation.

        It is that of the lengths of the table, which a calibration knows from the drawing.
        """
        of_place, i = place_fields(self.layout), _n_motions(self.layout.alone)
        scale_of = self._scale_of(*self._in_ranges())
        own = np.linalg.norm(scale_of @ self.half)
        if not (own > 0 and np.isfinite(scale_sd) and len(self.seen)):
            return self
        seen = np.zeros_like(self.seen)
        seen[i] = (scale_sd / own - 1) * (scale_of @ self.half) / (scale_of @ of_place[:, i])
        return replace(self, half=self.half + of_place @ seen, seen=self.seen + seen)

    def with_scale_of(self, other: Self) -> Self:
        """Model that makes distances no larger than another one of the same columns does."""
        more = self._scale_of(*self._in_ranges()) @ (self.coef - other.coef)
        return replace(self, coef=self.coef - self.layout.scale * more)

    def _in_ranges(self):
        """Points and columns, (n, 3) and (n, 3, n_columns), of poses anywhere in `ranges`."""
        return self.layout.points_and_columns(_poses_in(self.arm, self.ranges))

    def _scale_of(self, points, columns):
        """By how much a unit of each column makes distances between points larger, (n_columns,)."""
        spread = points - points.mean(axis=0)
        size = np.square(spread).sum()
        if not self.terms.kinematics or not size > 0:
            return np.zeros(columns.shape[-1])
        return spread.ravel() @ columns.reshape(spread.size, -1) / size

    def joint_covariance(
        self, angles: np.ndarray, with_noise: bool = False, with_unseen: bool = True
    ) -> np.ndarray:
        """Widened covariance (3 n, 3 n) of the coordinates of some poses, mm^2: see `root_at`."""
        root = self.root_at(angles, with_unseen)
        covariance = root @ root.T
        if with_noise:
            noise = self.noise_scale * self.noise_sd * self.noise_root(angles)
            place = np.arange(len(covariance)).reshape(-1, 3)
            covariance[place[:, :, None], place[:, None]] += noise @ noise.swapaxes(1, 2)
        return covariance

    def distance_std(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Posterior standard deviation (n,) in mm of a corrected length between two poses each."""
        line = self.layout.points(second) - self.layout.points(first)
        line = line / np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-300)
        between = self.root_at(second) - self.root_at(first)
        return np.linalg.norm(
            np.einsum("nc,ncr->nr", line, between.reshape(*line.shape, -1)), axis=1
        )

    def moved(self, arm: Arm, stated: bool = False) -> Self:
        """The same causes, seen by another probe of the same table.

        Poses find a probe's vector in the last frame as the table has it: what no pose of the old
        probe shows of the table is a part of the new vector then. Of a vector that is `stated` it
        is in doubt, until another probe is found.
        """
        linear = self
        _check_same_table(linear.arm, arm)
        if np.any(arm.up != linear.arm.up):
            # The probe first: what it does not show is of the earlier mounting.
            linear = linear.moved(arm.replace(up=linear.arm.up), stated)
            # What the data have found of the vertical was of that, too.
            layout = columns_of(arm, linear.terms._replace(up=()))
            moved = replace(linear, layout=layout, informed_half=None)
            return moved.with_seen() if len(moved.seen) else moved
        if linear.shown_by is not None:  # a probe was stated before: what the one before it shows
            stated = stated or np.array_equal(arm.probe, linear.arm.probe)
            linear = linear._at_probe(linear.arm.replace(probe=linear.shown_by))
        moved = linear._at_probe(arm, _DRAWING_SD if stated else 0.0)
        return replace(moved, shown_by=linear.arm.probe if stated else None)

    def _at_probe(self, arm, unseen_sd=None):
        """A model at another probe; None keeps how well it knows what the old one does not show.

        Coefficients are counted in units of the arm's reach, which the probe changes; growth by
        temperature is in proportion to each length.
        """
        terms = self.terms
        layout = columns_of(arm, terms)
        n_waves, others = layout.n_waves, layout.others
        old = {c.name: (i, c) for i, c in enumerate(self.layout.others)}
        matrix = np.zeros((n_waves + len(others), len(self.coef)))
        matrix[:n_waves, :n_waves] = np.eye(n_waves)
        fresh = []  # the probe has a length along an axis along which the old one had none
        for row, column in enumerate(others, start=n_waves):
            if column.name not in old:
                fresh.append(row)
                continue
            place, before = old[column.name]
            same = column.family == TEMPERATURE or before.unit == column.unit
            matrix[row, n_waves + place] = 1.0 if same else before.unit / column.unit
        unknown = np.zeros((len(matrix), len(fresh)))
        unknown[fresh, range(len(fresh))] = self.prior_sd.get("temperature", 0.0)
        ratio = arm.reach_mm / self.arm.reach_mm
        prior_sd = {
            name: sd * ratio if name in _PER_REACH else sd for name, sd in self.prior_sd.items()
        }
        roots = {}
        for name in ("gauge_free_half", "informed_half"):
            if (root := getattr(self, name)) is not None:
                if unseen_sd is not None:
                    unseen, start = unseen_of_table(self.layout.alone), self.layout.n_waves
                    root = root.copy()
                    of_table = root[start : start + len(unseen)]
                    of_table -= unseen @ (unseen.T @ of_table)
                    if unseen_sd:
                        rows = start, len(root) - start - len(unseen)
                        root = np.hstack([root, np.pad(unseen_sd * unseen, (rows, (0, 0)))])
                roots[name] = np.hstack([matrix @ root, unknown])
        # What a place hides is there for both probes: fields of the same size.
        ratio = field_sizes(layout) / field_sizes(self.layout) if len(self.seen) else np.ones(0)
        more = roots["gauge_free_half"].shape[1] - self.half.shape[1]
        seen = np.pad(ratio[:, None] * self.seen, ((0, 0), (0, more)))
        half = roots.pop("gauge_free_half")
        return replace(
            self,
            layout=layout,
            prior_sd=prior_sd,
            coef=matrix @ self.coef,
            half=half + place_fields(layout) @ seen if len(seen) else half,
            seen=seen,
            ranges=self.ranges[:, : arm.n_joints + len(terms.extra)],
            **roots,
        )

    def turns(self, rows: np.ndarray) -> np.ndarray:
        """Rotation vectors (n, 3) in rad that the model has the last link turned by at rows of X.

        Of residuals e at probes beside each other, E = de / dprobe in the base: the last link turns
        by the antisymmetric part of E R', with R its orientation. The rest is growth.
        """
        arm, own = self.arm, self.predict(rows)[0]
        beside = (arm.replace(probe=arm.probe + step) for step in _BESIDE_MM * np.eye(3))
        by_probe = [self.moved(other).predict(rows)[0] - own for other in beside]
        frame = arm.frames(rows[:, : arm.n_joints])[:, -1, :, :3]
        slope = np.stack(by_probe, axis=2) @ frame.swapaxes(1, 2) / (2 * _BESIDE_MM)
        i, j = [2, 0, 1], [1, 2, 0]
        return slope[:, i, j] - slope[:, j, i]

    def harmonic_table(self) -> np.ndarray:
        """Harmonics as a structured array, the largest first: see `ArmResidualRegressor`."""
        n = 2 * len(self.terms.harmonics)
        pairs, sds = self.coef[:n].reshape(-1, 2), self.coef_sd[:n].reshape(-1, 2)
        dtype = [*zip(_OF_HARMONICS, ["i4"] * 2 + ["f8"] * 7, strict=True)]
        size, phase = np.hypot(*pairs.T), np.rad2deg(np.arctan2(*pairs.T[::-1]))
        places = np.add(self.terms.harmonics, (1, 0)).T
        values = *places, size, phase, *pairs.T, *sds.T, self.log_bayes_factor
        table = np.array([*zip(*values, strict=True)], dtype=dtype)
        return table[np.argsort(-table["amplitude_arcsec"], kind="stable")]

    def term_table(self) -> np.ndarray:
        """The other causes as a structured array: see `ArmResidualRegressor`."""
        others, n = self.layout.others, self.layout.n_waves
        width = max([len(column.name) for column in others], default=1)
        dtype = [("family", "U11"), ("name", f"U{width}"), ("value", "f8"), ("sd", "f8")]
        # The columns of gravity are not all of one arc second: see `_gravity`.
        arcsec = ARCSEC / self.arm.reach_mm
        size = np.array([c.unit / arcsec if c.kind in OF_LOADS else 1.0 for c in others])
        family = [FAMILIES[column.family] for column in others]
        values = size * self.coef[n:], size * self.coef_sd[n:]
        return np.array([*zip(family, self.layout.names, *values, strict=True)], dtype=dtype)


def ranges_of(arm, X):
    """Least and largest value of rows: of the joints' own angles, then of each other column."""
    own = np.column_stack([arm.own_angles(X[:, : arm.n_joints]), X[:, arm.n_joints :]])
    return np.array([own.min(axis=0), own.max(axis=0)])


def _poses_in(arm, ranges):
    """Rows each number of which is anywhere in its range."""
    n, rng = arm.n_joints, np.random.default_rng(0)
    tried = rng.uniform(ranges[0], ranges[1], (_TRIED, ranges.shape[1]))
    return np.column_stack([np.linalg.solve(arm.own_by_given, tried[:, :n].T).T, tried[:, n:]])


def _as_now(values, layout):
    """The fields of a file that was written when `seen` was not among them, as they are today.

    It does not say in which ranges the model was learnt: all turns count.
    """
    half, shown, fading = (values.pop(name) for name in _BEFORE)
    values.pop("scale_sd", None)  # that of `half`
    arm, extra = layout.arm, layout.terms.extra
    of_place, seen = place_fields(layout), NOTHING_SEEN
    if not np.array_equal(half, shown):
        seen = np.linalg.lstsq(of_place, half - shown, rcond=None)[0]
        half = shown + of_place @ seen
    usual = [reference[0] for _, reference in extra]
    ranges = np.array([[turn] * arm.n_joints + usual for turn in (-np.pi, np.pi)])
    informed = None if np.array_equal(fading, shown) else fading
    return values | {"half": half, "seen": seen, "ranges": ranges, "informed_half": informed}


def place_fields(columns):
    """Coefficients (n_columns, k) whose effect is the same at all poses that reach a point.

    One column for each field that the model can make, of up to eleven: see `_fields`.
    """
    own = _fields_of_causes(columns.alone)[0]
    return np.pad(own, ((columns.n_waves, len(columns.others) - len(own)), (0, 0)))


def field_sizes(columns):
    """How far a unit of each field of `place_fields` moves the same poses of an arm, (k,)."""
    return _fields_of_causes(columns.alone)[2]


def _fields(points, up):
    """Three shifts, three turns, a scale, a stretch across z, and the base bent about its axes.

    (3 n, 10 or 11) of length 1 each, at points (n, 3). The torque of a weight at p about the axis e
    of the base is -(e x p) . up. In an upright arm to bend about the second joint's axis, which is
    horizontal and above the base, is to bend about x and y together with a stretch.
    """
    x, y, _ = points.T
    fields = [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
    fields += [np.cross(axis, points) for axis in np.eye(3)]
    fields += [points, np.column_stack([x, y, np.zeros_like(x)])]
    fields += [(turn @ up)[:, None] * turn for turn in fields[3:6]]
    flat = np.stack(fields, axis=2).reshape(3 * len(points), -1)
    size = np.linalg.norm(flat, axis=0)
    return flat[:, size > 0] / size[size > 0], size[size > 0]


@lru_cache(maxsize=64)
def unseen_of_table(columns):
    """Orthonormal combinations (m, k) of the columns without harmonics that this probe never shows.

    Of kinematic columns alone, such as turns of the last frame about the probe's own vector.
    """
    columns = columns_of(columns.arm, columns.terms._replace(extra=(), own=()))
    kinematic = np.flatnonzero([c.family == KINEMATICS for c in columns.others])
    angles = columns.arm.random_poses(_POSES)
    own = columns.at(angles)[:, :, columns.n_waves + kinematic].reshape(3 * _POSES, -1)
    size = np.linalg.norm(own, axis=0)
    size[size == 0] = 1.0
    _, shown, axes = np.linalg.svd(own / size, full_matrices=False)
    unseen = (axes[shown < _NEVER * shown.max(initial=0.0)] / size).T
    found = np.zeros((len(columns.others), unseen.shape[1]))
    found[kinematic] = np.linalg.qr(unseen)[0]
    return found


def _n_motions(columns):
    """How many of the fields of `place_fields`, the first ones, are motions of the base."""
    return int(np.count_nonzero(_fields_of_causes(columns)[1][:6]))


@lru_cache(maxsize=64)
def _fields_of_causes(columns):
    """The same for the columns that are neither harmonics nor extra; which fields they make."""
    columns = columns_of(columns.arm, columns.terms._replace(extra=(), own=()))
    angles = columns.arm.random_poses(_POSES)
    of_place, amount = _fields(columns.points(angles), columns.up)
    own = columns.at(angles).reshape(len(of_place), -1)
    size = np.linalg.norm(own, axis=0)
    size = np.where(size > _NOTHING * size.max(initial=0.0), size, np.inf)
    coef = np.linalg.lstsq(own / size, of_place, rcond=1e-10)[0]
    left = np.linalg.norm(of_place - own / size @ coef, axis=0)
    coef = (coef / size[:, None])[:, left < _LEFT]
    if columns.terms.kinematics:
        # The scale of the table alone, about the point that it leaves where it is: other
        # coefficients that do the same at this probe do not at others.
        i = np.count_nonzero(left[:6] < _LEFT)
        scale = columns.scale - coef[:, :3] @ (shoulder(columns.arm) * np.sqrt(len(angles)))
        coef[:, i] = scale / np.linalg.norm(own @ scale)
    return coef, left < _LEFT, amount[left < _LEFT]


def shoulder(arm: Arm) -> np.ndarray:
    """The point of the first axis that the scale of the links leaves where it is, (3,), mm."""
    if arm.convention == "standard":
        return np.array([0.0, 0.0, arm.d[0]])
    return arm.frames(np.zeros((1, arm.n_joints)))[0, 1, :, 3]


def _check_same_table(old, new):
    """Refuse an arm that differs from another one in more than its probe."""
    kinds = [f"{arm.n_joints} joints, {arm.convention} DH" for arm in (old, new)]
    if kinds[0] != kinds[1]:
        raise ValueError(
            f"the correction is of an arm of {kinds[0]}, and is to be moved to {kinds[1]}: only "
            "the probe may differ."
        )
    for name in ("couplings", "joint_types", "up_frame"):
        one, other = getattr(old, name), getattr(new, name)
        if one != other:
            raise ValueError(
                f"{name} of the correction's arm are {one} and those of the new arm {other}: only "
                "the probe may differ."
            )
    for name in _OF_TABLE:
        one, other = getattr(old, name), getattr(new, name)
        far = np.flatnonzero(np.abs(one - other) > _SAME_TABLE)
        if len(far):
            i = far[0]
            raise ValueError(
                f"{name}{i + 1} of the correction's arm is {one[i]:.9g} and that of the new arm "
                f"{other[i]:.9g}: only the probe may differ. Register the new probe with the "
                "correction's own table, by calibrate(model.arm_, ..., correction=model, "
                "free=['probe']), or fit the model again."
            )
