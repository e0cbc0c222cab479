"""The fit under `calibrate`: parameters, residuals, weights, and what they are worth."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections import deque
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.spatial.transform import Rotation
from scipy.special import chdtri
from scipy.stats import chi, norm

from sklearn_raacmm.arm import FIELDS
from sklearn_raacmm.calibration._problem import (
    FOUND,
    LONG_SHARE,
    SLIDE_SCALE,
    UNKNOWN_PLACE_MM,
    are_long,
    in_brackets,
    pack,
    rows_of,
    table_jacobian,
    unpack,
)
from sklearn_raacmm.calibration._result import ANGLES
from sklearn_raacmm.measurements import (
    STILL_MM,
    base_motions,
    known_length,
    linearised,
    touch_weights,
    whitening,
    with_forms,
)
from sklearn_raacmm.utils import (
    align,
    centred,
    chunks,
    group_means,
    group_sums,
    robust_scale,
    slip_factors,
)

# Weight of a point whose distance is u standard deviations of one coordinate.
WEIGHTS = {
    "squared": np.ones_like,
    "soft_l1": lambda u: 1 / np.sqrt(1 + (u / 2) ** 2),
    "huber": lambda u: 2.5 / np.maximum(u, 2.5),
    "cauchy": lambda u: 1 / (1 + (u / 4) ** 2),
}
_MIN_SIGMA_MM = 1e-7  # noise-free simulated data must not divide by zero
MAX_ROUNDS = 20
# Rounds in which prior standard deviations are found; two digits of them are enough.
_EVIDENCE_ROUNDS = 8
# Gauss-Newton steps of one round, which ends where the next would lower the squares by less than
# this part. Least damping, and where a step is given up.
_MAX_STEPS, _SMALL_GAIN = 100, 1e-10
_DAMPING, _MOST_DAMPING = 1e-8, 1e8
# Normal equations whose Cholesky factor has a smaller pivot than this are solved by the QR
# decomposition: their condition is squared.
_LEAST_PIVOT = 1e-8
# Rows whose Jacobian is made at a time, and most rows of which it is held for the next look: 11 MB
# for 27 parameters. Of more rows sums over blocks are held, and a few numbers of each row.
_BLOCK, _HELD = 4096, 2**14
# Where the search for the size of what the table does not explain begins, rad, and its steps; a
# part of the reach that is near.
_MISFIT_RAD, _MISFIT_ROUNDS, _NEAR_SHARE = 1e-4, 30, 0.1
# What is held of parameters that were looked at, before any was: see `Fit.located`.
NOT_EVALUATED: Any = None, None, None
# A row that a fit can follow freely shows no noise: its distance is enlarged tenfold at most.
_MOST_LEVERAGE = 0.99
# Share of the sets without outliers in which rows may be named: half by chance, and 0.01 where the
# tail may be longer than it is taken to be. 4 of 200 simulated sets are named.
_FALSE_NAMES, _SDS_OF_TAILS = 0.05, norm.isf(0.01)
# The part of the distances whose size tells how long the tail of the others is.
_TAIL = 0.9


class Fit:
    """State of the fit.

    The parameters x are the table, the probe of each tool, and the base (rotation vector and shift)
    of each station; beside them stand the weights of the rows, `sigma` (mm), and the prior standard
    deviations.

    `priors` are standard deviations of lengths (mm), angles (rad) and the probe (mm); "auto" is
    found by the evidence.
    """

    def __init__(
        self, arm, problem, loss, free=FIELDS, priors=("auto", "auto", UNKNOWN_PLACE_MM),
        correction=None,
    ):  # fmt: skip
        self.nominal_arm, self.angles = arm, problem.angles
        self.problem: Any = problem
        self.correction: Any = correction
        self.loss, self.free, self.priors = loss, free, priors
        # Joints that slide, but stand still in all rows.
        ways = np.ptp(self.angles, axis=0) if len(self.angles) else np.zeros(arm.n_joints)
        self.turning = np.setdiff1d(np.arange(arm.n_joints), arm.slides)
        self.still = [i for i in arm.slides if ways[i] < STILL_MM]
        self._name_parameters(free)
        nominal = self.nominal
        self.x = nominal.copy()
        self.converged = False
        self.sigma = 1.0  # mm, until rows are weighed
        self.weights: Any = np.ones(len(self.angles))
        self.evaluated: Any = NOT_EVALUATED
        # The common scale of the long links, each as much as the data feel it: an offset along the
        # first axis, which a single-point test cannot feel, has no say. Where points were measured
        # all rows are beside one mean.
        every = np.ones(len(nominal), dtype=bool)
        index = np.zeros(len(self.angles), dtype=int) if problem.n_stations else problem.index
        at = self.touched(self.x, every, index)
        parts = self._beside_touched(self.x, every, at, index)
        felt: Any = sum(np.square(left[:, :, :-1]).sum(axis=(0, 1)) for _, left in parts)
        points, places = self.points(), []  # first guess of every base
        for s in range(problem.n_stations):
            rows = rows_of(problem.stations, s)
            places.append(align(points[rows], problem.points[rows]))
        self.rotations = np.array([rotation for rotation, _ in places])
        self.x = np.concatenate([self.x, *([0, 0, 0, *shift] for _, shift in places)])
        length = np.zeros_like(nominal)
        long = self.kind == "length_mm"
        length[long] = felt[long] * nominal[long]
        slides = self.kind == "slide_scale"
        if slides.any():  # beside the ways that they go short links carry no scale
            length[slides] = felt[slides] * nominal[slides]
            carried = length * nominal
            length[carried < LONG_SHARE**2 * carried.max()] = 0.0
        total = length @ nominal
        self.scale = length / total if total > 0 else length
        self.reset_weights()

    def _name_parameters(self, free):
        """Names, nominal values, kinds and priors of the table and of the probe of each tool."""
        arm, problem = self.nominal_arm, self.problem
        tools = in_brackets(problem.tool_labels, problem.n_tools)
        self.names = [f"{f}{i + 1}" for f in FIELDS[:-1] for i in range(arm.n_joints)]
        self.nominal = np.concatenate([pack(arm), *[arm.probe] * (len(tools) - 1)])
        lengths = np.array([not name.startswith(ANGLES) for name in self.names])
        kind = np.full(len(lengths), "angle_rad", dtype=object)
        slides = arm.slides
        of_slides = np.isin(np.arange(len(kind)) % arm.n_joints, slides)
        # Where a slide stands says nothing of how long links are.
        long = are_long(np.where(of_slides, 0.0, pack(arm)[: len(lengths)])[lengths])
        kind[lengths] = np.where(long, "length_mm", "short_length_mm")
        is_free = np.repeat(np.isin(FIELDS[:-1], list(free)), arm.n_joints)
        if slides:
            kind[of_slides] = np.where(lengths, "slide_mm", "slide_rad")[of_slides]
            self.names += [f"scale{i + 1}" for i in slides]
            kind = np.r_[kind, ["slide_scale"] * len(slides)]
            scales = [i not in self.still and "d" in free for i in slides]
            is_free = np.r_[is_free, np.array(scales, dtype=bool)]
        n_probes = 3 * len(tools)
        self.names += [f"probe_{axis}{label}" for label in tools for axis in "xyz"]
        self.kind = np.r_[kind, ["probe_mm"] * n_probes]
        self.is_free = np.r_[is_free, np.full(n_probes, "probe" in free)]
        # Kinds whose common prior standard deviation is found by the evidence, and what counts.
        length, *_ = self.priors
        given = *self.priors, length, "auto", "auto", SLIDE_SCALE
        priors = dict(zip(FOUND, given, strict=True))
        self.found = {kind: FOUND[kind] for kind, sd in priors.items() if sd == "auto"}
        sds = priors | {kind: guess for kind, (guess, *_) in self.found.items()}
        self.prior_sd = np.array([sds[kind] for kind in self.kind], dtype=float)

    def base_columns(self, station):
        """Columns of a station's base: rotation, then shift."""
        return len(self.nominal) + 6 * station + np.arange(6)

    def reset_weights(self):
        self.weights = np.ones(len(self.angles))
        if self.problem.features:
            # One touch of another feature bends a sphere, where it hardly moves a mean.
            self.weights = self.first_weights()
        self.length_weights = self._new_length_weights()
        self._weigh()

    def first_weights(self):
        """Weights of the rows by what they touched, without slips; None for measured points."""
        index, points = self.problem.index, self.points()
        if self.problem.features:
            return touch_weights(self.problem.features, index, points)
        return None if self.problem.points is not None else slip_factors(points, index)

    def of(self, loss=None, free=None, **changes):
        """A fit of the same rows that has settled, with some of the problem changed."""
        correction = changes.pop("correction", self.correction)
        problem, how = replace(self.problem, **changes), (loss or self.loss, free or self.free)
        return Fit(self.nominal_arm, problem, *how, self.priors, correction).run()

    def arm(self, tool=0):
        return self.nominal_arm.replace(**unpack(self.x, self.nominal_arm, tool))

    def free_mask(self, is_free):
        """Free parameters of x: bases always are."""
        return np.r_[is_free, np.ones(len(self.x) - len(is_free), bool)]

    def run(self, is_free=None):
        """Alternate least squares, and the weights and variances they imply, until they settle."""
        mask = self.free_mask(self.is_free if is_free is None else is_free)
        for rounds in range(MAX_ROUNDS):
            before = self.sigma
            if mask.any():
                self._solve(mask)
            settled = self._judge(mask, find_priors=rounds < _EVIDENCE_ROUNDS)
            weights, self.length_weights = self.length_weights, self._new_length_weights()
            change = np.max(np.abs(weights - self.length_weights), initial=0.0)
            self.converged = bool(
                abs(self.sigma - before) <= 1e-3 * before and change <= 0.02 and settled
            )
            if self.converged:
                break
        if self.problem.features and mask[: -3 * self.problem.n_tools].any():
            self._take_best_table(mask)
        return self

    def _judge(self, mask, find_priors):
        """New weights and variances; returns whether the prior variances have settled."""
        if not mask.any():
            self._weigh()
            return True
        is_free = mask[: len(self.nominal)]
        covariance = inverse_normal(triangle(self.rows(self.x, mask))[:, :-1])
        share = np.ones(len(is_free))  # of the prior's variance that the data leave
        share[is_free] = np.diag(covariance)[: is_free.sum()] / self.prior_sd[is_free] ** 2
        share = np.minimum(share, 1.0)
        self._weigh(self._spread(covariance, mask))
        settled = True
        departure = self.x[: len(is_free)] - self.nominal
        for kind, (guess, counts, least, most) in self.found.items() if find_priors else ():
            members = is_free & (self.kind == kind)
            if members.any():
                seen, square = np.sum(1 - share[members]), np.sum(departure[members] ** 2)
                # MacKay's fixed point, with a guess that is worth so many numbers.
                sd = np.sqrt((square + counts * guess**2) / (seen + counts))
                sd = np.clip(sd, least, most)
                settled &= bool(abs(np.log(sd / self.prior_sd[members][0])) < 0.05)
                self.prior_sd[members] = sd
        return settled

    def _spread(self, covariance, mask):
        """Lengths (n,) that the residuals would have had the fit not followed them.

        The covariance of a row's residual is that of the noise less its block of the hat matrix;
        the inverse root of the two takes a residual back to the size of the noise, in standard
        deviations.
        """
        finite = np.zeros((len(covariance) + 1,) * 2)  # the last column are the residuals
        finite[:-1, :-1] = np.where(np.isfinite(covariance), covariance, 0.0)
        at, index = self.touched(self.x, mask), self.problem.index
        spread = np.empty(len(self.angles))
        total = np.zeros(0) if index is None else np.bincount(index, self.weights)
        for part, rows in self._weighted(self.x, mask, at):
            taken = (rows.reshape(-1, len(finite)) @ finite).reshape(rows.shape)
            taken = taken @ rows.swapaxes(1, 2)
            if self.problem.features:
                basis = at[-1].basis[part]
                taken += basis @ basis.swapaxes(1, 2)
            elif self.problem.points is None:
                own = self.weights[part] / total[self.problem.index[part]]
                taken += own[:, None, None] * np.eye(3)
            values, axes = np.linalg.eigh(taken)
            along = np.einsum("nji,nj->ni", axes, rows[:, :, -1])
            along /= np.sqrt(1 - np.clip(values, 0, _MOST_LEVERAGE))
            spread[part] = np.linalg.norm(along, axis=1)
        return spread

    def _weigh(self, spread=None):
        """Standard deviations of the data, and the weights of the rows."""
        distances = self.robust_distances()
        seen = distances if spread is None else spread * self.sigma / np.sqrt(self.weights)
        shown = np.broadcast_to(self.problem.n_shown, len(seen))
        seen, shown = seen[self.problem.informative], shown[self.problem.informative]
        if self.loss == "squared":
            sigma = np.sqrt(np.mean(seen**2) / shown.mean())
        else:
            # Outliers would shift the median to larger ones of the others.
            seen = self._of_three(seen, shown)
            sigma = robust_scale(seen[seen <= doubt_limit(seen, 0.0)], 3)
        self.sigma = max(sigma, _MIN_SIGMA_MM)
        self.weights = WEIGHTS[self.loss](self.as_of_three(distances) / self.sigma)

    @staticmethod
    def _of_three(distances, shown):
        """Distances (n,) of rows that show so many coordinates, with the median of three."""
        if np.all(shown == 3):
            return distances
        return distances * np.sqrt(chdtri(3, 0.5) / chdtri(shown, 0.5))

    def as_of_three(self, distances):
        r"""Distances (n,) as rare among normal errors in space as those of their rows are.

        Of k coordinates chi-squared is about :math:`k (1 - 2/9k + z \sqrt{2/9k})^3`, z normal
        (Wilson and Hilferty, Proc. National Academy of Sciences 17, 1931).
        """
        k, used = self.problem.n_shown, self.problem.informative
        if np.ndim(k) == 0:
            return distances
        sigma = max(robust_scale(self._of_three(distances, k)[used], 3), _MIN_SIGMA_MM)
        part = 2 / (9 * k)
        z = (np.cbrt(np.square(distances / sigma) / k) - (1 - part)) / np.sqrt(part)
        longer = sigma * np.sqrt(3 * (1 - 2 / 27 + z * np.sqrt(2 / 27)) ** 3)
        return np.where(k < 3, longer, distances)

    def _solve(self, mask):
        """Gauss-Newton steps at given weights, damped where they do not lower the squares."""
        sums, damping = self._sums(self.x, mask), 0.0
        for _ in range(_MAX_STEPS):
            step, gain = gauss_newton_step(sums, damping, lambda: self.rows(self.x, mask))
            x = self.x.copy()
            x[mask] += step
            if gain <= _SMALL_GAIN * sums[-1, -1]:
                self._take(x)
                break
            new = self._sums(x, mask)
            if new[-1, -1] <= sums[-1, -1]:
                sums = new
                self._take(x)
                damping = damping / 10 if damping > _DAMPING else 0.0
            elif damping > _MOST_DAMPING:
                break
            else:
                damping = max(100 * damping, _DAMPING)

    def _sums(self, x, mask) -> Any:
        """Products of the `rows` with one another, (k + 1, k + 1), summed up over blocks."""
        return sum(rows.T @ rows for rows in self.rows(x, mask))

    def _take(self, x):
        """Go on from these parameters; turns of the bases are small ones about the last."""
        self.x = x
        for s in range(self.problem.n_stations):
            self.rotations[s] = self._rotation(x, s)
            x[self.base_columns(s)[:3]] = 0

    def _rotation(self, x, station):
        """Rotation matrix of a base: the rotation vector of x after the last matrix."""
        turn = Rotation.from_rotvec(x[self.base_columns(station)[:3]]).as_matrix()
        return turn @ self.rotations[station]

    def located(self, x):
        """Yield blocks of rows, their corrected points (m, 3) in the base frame, and derivatives.

        The latter (m, 3, n_parameters) are those by table and probes, mm and rad. Of few rows they
        are held for the next look.
        """
        x, n = x[: len(self.nominal)], len(self.angles)
        at, _, held = self.evaluated
        if held and np.array_equal(at, x):
            yield from held
            return
        points, held = np.empty((n, 3)), []
        for part in chunks(n, _BLOCK):
            block = (part, *self.located_at(x, part))
            points[part] = block[1]
            if n <= _HELD:
                held.append(block)
            yield block
        self.evaluated = x.copy(), points, held

    def located_at(self, x, rows):
        """Corrected points (m, 3) of some rows, and their derivatives by table and probes."""
        arm, problem, angles = self.nominal_arm, self.problem, self.angles[rows]
        n_table, n_parameters = len(pack(arm)) - 3, len(self.nominal)
        points, jac = np.empty((len(angles), 3)), np.zeros((len(angles), 3, n_parameters))
        tools = None if problem.tools is None else problem.tools[rows]
        for tool in range(problem.n_tools):
            of, start = rows_of(tools, tool), n_table + 3 * tool
            one = arm.on_trial(**unpack(x, arm, tool))
            points[of], own = table_jacobian(one, angles[of])
            jac[of, :, :n_table] = own[:, :, :n_table]
            jac[of, :, start : start + 3] = own[:, :, n_table:]
        if self.correction is not None:
            points -= self.correction[rows]
        return points, jac

    def _free_columns(self, x, mask):
        """Yield blocks of rows, and derivatives by what is free, the points as the last column.

        Where the mask is longer than x, those by what `_misfit` tries stand between.
        """
        free, joints = np.flatnonzero(mask[: len(self.nominal)]), self.turning
        for part, points, jac in self.located(x):
            columns = [np.take(jac, free, axis=2), points[:, :, None]]
            if len(mask) > len(self.x):
                turns = jac[:, :, 3 * self.angles.shape[1] + joints]
                angles = self.angles[part, None][:, :, joints]
                lever = self.nominal_arm.up @ turns / (self.nominal_arm.reach_mm / 2)
                by = np.cos(angles), np.sin(angles), lever[:, None]
                columns[1:1] = [turns * factor for factor in by]
            yield part, np.concatenate(columns, axis=2)

    def touched(self, x, mask, index=None) -> Any:
        """What was touched, and what the free parameters move it by; None for measured points.

        Of cones these are the fixed points (n_points, 3) and their derivatives. Of other features,
        the forms, what the parameters move their unknowns by, the root of the covariance of these,
        and for `_beside_touched` what is left of the rows, what the unknowns explain of a Jacobian,
        and the `Whitening`. `index` (n,) numbers the fixed points, where it is not the problem's.
        """
        problem, weights = self.problem, self.weights
        if index is None:
            if problem.n_stations:
                return None
            index = problem.index
        if problem.features:
            rows, forms = with_forms(problem.features, index, self.points(x), weights)
            known = rows.directions @ rows.unknowns
            whitened: Any = whitening(weights, rows.directions, index, known)
            explained: Any = 0.0
            for part, columns in self._free_columns(x, mask):
                columns = whitened.basis[part].swapaxes(1, 2) @ (whitened.root[part] @ columns)
                explained = explained + group_sums(columns, index[part], None, len(whitened.unit))
            moves = whitened.unit @ explained[:, :, :-1]
            return forms, moves, whitened.unit, rows, explained, whitened
        # Sums of differences from the first row, so that a large mean costs no digits.
        total = np.maximum(np.bincount(index, weights), 1e-300)[:, None, None]
        first: Any = None
        sums: Any = 0.0
        for part, columns in self._free_columns(x, mask):
            first = columns[0] if first is None else first
            sums = sums + group_sums(columns - first, index[part], weights[part], len(total))
        means = sums / total + first
        return means[:, :, -1], means[:, :, :-1], means

    def _beside_touched(self, x, mask, at, index):
        """Yield blocks of rows, and their residuals (m, 3) as the last column of their Jacobian."""
        for part, rows in self._free_columns(x, mask):
            if self.problem.features:
                *_, touched, explained, whitened = at
                rows = touched.directions[part] @ rows
                rows -= whitened.moves[part] @ explained[index[part]]
                rows[:, :, -1] = touched.residual[part]
            else:
                rows -= at[2][index[part]]
            yield part, rows

    def _data(self, x, mask, at):
        """Yield blocks of rows, and residuals in mm of the data as the last column of the Jacobian.

        Derivatives by the turn of a base are those by a small turn after it.
        """
        problem = self.problem
        if problem.points is None:
            slope = self.scale[mask[: len(self.scale)]]
            scale, by_length = self.scale @ x, np.flatnonzero(slope)
            for part, rows in self._beside_touched(x, mask, at, problem.index):
                if scale > 0:
                    rows /= scale
                    rows[:, :, by_length] -= rows[:, :, -1:] * (slope[by_length] / scale)
                yield part, rows
            return
        n_table = np.count_nonzero(mask[: len(self.nominal)])
        for part, columns in self._free_columns(x, mask):
            rows = np.insert(columns, [n_table] * 6 * problem.n_stations, 0.0, axis=2)
            stations = None if problem.stations is None else problem.stations[part]
            for s in range(problem.n_stations):
                of, shift = rows_of(stations, s), x[self.base_columns(s)[3:]]
                rows[of] = self._rotation(x, s) @ rows[of]
                turned, first = rows[of, :, -1], n_table + 6 * s
                for i, axis in enumerate(np.eye(3)):
                    rows[of, :, first + i] = np.cross(axis, turned)
                rows[of, :, first + 3 : first + 6] = np.eye(3)
                rows[of, :, -1] += shift - problem.points[part][of]
            yield part, rows

    def known(self, lengths, at):
        """Known lengths as they are found: (n,) mm, their slopes (n, p), and sds of their ends.

        `at` is what was `touched`.
        """
        one, other = np.array([entry[:2] for entry in lengths], dtype=int).reshape(-1, 2).T
        if not self.problem.features:
            gap = at[0][one] - at[0][other]
            found = np.maximum(np.linalg.norm(gap, axis=1), 1e-12)
            slopes = np.einsum("kc,kcp->kp", gap / found[:, None], at[1][one] - at[1][other])
            # What the table does not explain is much the same in all poses of one position.
            return found, slopes, np.full(len(found), np.sqrt(2) * self.sigma)
        forms, moves, unit, *_ = at
        found, slopes, variance = np.zeros(len(one)), np.zeros((len(one), moves.shape[2])), []
        for k, (i, j) in enumerate(zip(one, other, strict=True)):
            found[k], *sides = known_length(forms[i], forms[j])
            sides = [side[: moves.shape[1]] for side in sides]
            slopes[k] = sides[0] @ moves[i] + sides[1] @ moves[j]
            ends = zip((i, j), sides, strict=True)
            variance.append(sum(np.square(side @ unit[end]).sum() for end, side in ends))
        return found, slopes, self.sigma * np.sqrt(np.array(variance))

    def _weighted(self, x, mask, at):
        """As `_data`, in standard deviations of the rows."""
        for part, rows in self._data(x, mask, at):
            rows *= (np.sqrt(self.weights[part]) / self.sigma)[:, None, None]
            yield part, rows

    def rows(self, x, mask, with_prior=True):
        """Yield the Jacobian, in blocks (m, k + 1), in standard deviations, the residuals last.

        Of the data, then of the known lengths, then of the prior.
        """
        at = self.touched(x, mask)
        for _, rows in self._weighted(x, mask, at):
            yield rows.reshape(-1, rows.shape[2])
        if self.problem.lengths:
            yield self._length_rows(at)
        is_free = mask[: len(self.nominal)]
        if with_prior and is_free.any():
            prior = np.zeros((is_free.sum(), mask.sum() + 1))
            np.fill_diagonal(prior, 1 / self.prior_sd[is_free])
            prior[:, -1] = ((x[: len(is_free)] - self.nominal) / self.prior_sd)[is_free]
            yield prior

    def _length_rows(self, at):
        """The rows of the known lengths, as `rows` yields them."""
        found, slopes, _ = self.known(self.problem.lengths, at)
        sds = self.length_sd / np.sqrt(self.length_weights)
        return np.column_stack([slopes, self._off(found)]) / sds[:, None]

    def points(self, x=None):
        """Corrected points (n, 3) in mm, in the arm's base frame; they are held for the next look.

        Of the parameters of the fit, or of others.
        """
        x = (self.x if x is None else x)[: len(self.nominal)]
        if not np.array_equal(self.evaluated[0], x):
            deque(self.located(x), maxlen=0)
        held: Any = self.evaluated
        return held[1].copy()

    def residuals(self, weights=None):
        """Differences (n, 3) in mm, in the arm's frame, not divided by the scale."""
        points, problem = self.points(), self.problem
        if problem.features:
            weights = np.ones(len(points)) if weights is None else weights
            return linearised(problem.features, problem.index, points, weights).residual
        if problem.points is None:
            return centred(points, problem.index, weights)
        for s in range(problem.n_stations):
            rows, shift = rows_of(problem.stations, s), self.x[self.base_columns(s)[3:]]
            points[rows] -= (problem.points[rows] - shift) @ self.rotations[s]
        return points

    def distances(self):
        """Distances (n,) in mm from the plain mean of the group: what scatter is made of."""
        return np.linalg.norm(self.residuals(), axis=1)

    def robust_distances(self):
        """Distances (n,) in mm from the weighted mean of the group, which outliers do not pull."""
        return np.linalg.norm(self.residuals(self.weights), axis=1)

    def length_errors(self):
        """Lengths between the centres of groups less the known ones, and sizes, mm."""
        if not self.problem.lengths:
            return np.empty(0)
        return self._off(self._found()[0])

    def _found(self):
        """Known lengths and sizes as they are found, their slopes, and the sds of their ends."""
        none = np.zeros(len(self.x), dtype=bool)
        return self.known(self.problem.lengths, self.touched(self.x, none))

    def _off(self, found):
        """Errors (n,) of lengths as found, mm: of the side of the probe's ball that fits best."""
        errors = []
        for value, entry, by in zip(found, self.problem.lengths, self.problem.offsets, strict=True):
            off = value - entry[2] - by
            errors.append(off[np.argmin(np.abs(off))])
        return np.array(errors)

    def centres(self):
        """The fixed points (n_points, 3) in mm."""
        return group_means(self.points(), self.problem.index, self.weights)

    def _new_length_weights(self):
        # A wrong length (one hole of a plate beside the right one) must not bend the arm.
        self.length_sd = np.array([entry[3] for entry in self.problem.lengths])
        if self.problem.features and self.problem.lengths:
            # Of fewer touches, of one coordinate each, sizes are not as sure as they are stated.
            self.length_sd = np.hypot(self.length_sd, self._found()[2])
        return WEIGHTS[self.loss](np.abs(self.length_errors()) / self.length_sd)

    def sd_of_errors(self):
        """Standard deviations of the errors of known lengths, of the two ends as well, mm."""
        if not self.problem.lengths:
            return np.empty(0)
        sd = np.hypot([entry[3] for entry in self.problem.lengths], self._found()[2])
        # What the table does not explain is much the same in all touches of a feature.
        return np.hypot(sd, self.sigma) if self.problem.features else sd

    def covariance(self, mask):
        """Posterior covariance of the free parameters; infinite where nothing is known.

        What the table does not explain is much the same in all poses of one position. A position at
        the end of known lengths is therefore no better known than one of its points.
        """
        covariance = inverse_normal(triangle(self.rows(self.x, mask))[:, :-1])
        if self.problem.lengths and not self.problem.features:
            slopes = self._length_rows(self.touched(self.x, mask))[:, :-1]
            sd = np.array([entry[3] for entry in self.problem.lengths])
            centres = self.centres()
            ends = np.zeros((len(sd), *centres.shape))
            for k, (i, j, *_) in enumerate(self.problem.lengths):
                gap = centres[i] - centres[j]
                ends[k, i] = gap / max(np.linalg.norm(gap), 1e-12)
                ends[k, j] = -ends[k, i]
            ends *= (np.sqrt(self.length_weights) * self.sigma / sd)[:, None, None]
            finite = np.where(np.isfinite(covariance), covariance, 0.0)
            spread = finite @ slopes.T @ ends.reshape(len(sd), -1)
            covariance = covariance + spread @ spread.T
        return covariance

    def _misfit(self, mask):
        r"""What the table does not explain, and what it moves the free parameters by.

        It is no noise: at poses that are alike it is much the same. Angles of joints that turn are
        taken to be off by a cosine and a sine of themselves, as an eccentric scale makes them, and
        by the lever of gravity: A w, of one variance by the evidence. With C their covariance the
        parameters move by :math:`-C J'A w`. Returned are w, its standard deviation before the data,
        rad, and C J'A (k, n_w).
        """
        k, every = np.count_nonzero(mask), self._with_misfit(mask)
        root = triangle(self.rows(self.x, every))
        # Beside the parameters; the last row is what neither explains.
        axes, size, seen_by = np.linalg.svd(root[k:, k:-1].T, full_matrices=False)
        strength, seen = np.square(size), seen_by @ root[k:, -1]
        variance, share, found = _MISFIT_RAD**2, np.ones(1), seen
        for _ in range(_MISFIT_ROUNDS):
            share = variance * strength / (1 + variance * strength)  # beside noise
            found = variance * size * seen / (1 + variance * strength)
            variance = np.square(found).sum() / max(share.sum(), 1e-300)
        # Of a variance that so many numbers show the mean is larger than the likeliest.
        sd = np.sqrt(variance * (1 + 2 / max(share.sum(), 1e-300)))
        covariance = inverse_normal(root[:, :k])
        covariance = np.where(np.isfinite(covariance), covariance, 0.0)
        return -axes @ found, sd, covariance @ root[:k, :k].T @ root[:k, k:-1]

    def _with_misfit(self, mask):
        """A mask of parameters and of what `_misfit` tries beside them."""
        return np.r_[mask, np.ones(3 * len(self.turning), dtype=bool)]

    def _take_best_table(self, mask):
        """Of touches, go on to the table that serves best at their poses.

        Surfaces show some directions only, and fitted to these a table follows what it does not
        explain along them. Where both are told apart, the table is that which moves the points as
        both do: within every feature, and between their means, beside a motion of the base. Known
        lengths count, and the prior.
        """
        misfit, _, pulled = self._misfit(mask)
        every, index, k = self._with_misfit(mask), self.problem.index, pulled.shape[0]
        count = np.bincount(index)[:, None, None]
        means: Any = sum(
            group_sums(columns, index[part], None, len(count))
            for part, columns in self._free_columns(self.x, every)
        )
        means = means / count
        base = base_motions(means[:, :, -1], self.nominal_arm.reach_mm).reshape(-1, 6)
        base, flat = np.linalg.qr(base)[0], means.reshape(-1, means.shape[2])

        def rows():
            yield (flat - base @ (base.T @ flat)) / self.sigma
            for part, columns in self._free_columns(self.x, every):
                yield (columns - means[index[part]]).reshape(-1, flat.shape[1]) / self.sigma
            if self.problem.lengths:
                yield self._length_rows(self.touched(self.x, every))

        root = triangle(rows())[:, :-1]
        both = np.vstack([root[:, :k], np.diag(1 / self.prior_sd[mask])])
        target = np.r_[root[:, k:] @ misfit, np.zeros(k)]
        x = self.x.copy()
        x[mask] += np.linalg.lstsq(both, target, rcond=1e-12)[0] - pulled @ misfit
        self._take(x)

    def scaled_by_misfit(self, mask):
        """By which parts what the table does not explain enlarges distances between the points.

        Of each of w of one standard deviation, with what the parameters do against it, (n_w,).
        """
        _, sd, moved = self._misfit(mask)
        points, n_table = self.points(), np.count_nonzero(mask[: len(self.nominal)])
        away = points - points.mean(axis=0)
        slopes: Any = sum(
            np.einsum("nc,ncp->p", away[part], columns[:, :, :-1])
            for part, columns in self._free_columns(self.x, self._with_misfit(mask))
        )
        # Places that are all near one another show nothing of the scale.
        least = len(away) * (_NEAR_SHARE * self.nominal_arm.reach_mm) ** 2
        slopes /= max(np.square(away).sum(), least)
        larger = slopes[n_table:] - slopes[:n_table] @ moved[:n_table]
        return sd * larger


def triangle(blocks):
    """Triangular factor of the rows of all blocks, as the QR decomposition of all has it."""
    root: Any = None
    for rows in blocks:
        root = np.linalg.qr(rows if root is None else np.vstack([root, rows]), mode="r")
    return root


def gauss_newton_step(sums, damping, blocks):
    """Step of least squares (k,), and by how much it lowers the sum of squares if all is linear.

    `sums` (k + 1, k + 1) are the products of the Jacobian's columns, and of the residuals, which
    are the last one; `blocks()` are the rows themselves. The damping, as a part of the squares of
    each column, is Marquardt's.
    """
    normal, slope = sums[:-1, :-1].copy(), sums[:-1, -1]
    size = np.sqrt(np.diag(normal))
    size[size == 0] = 1
    normal /= np.outer(size, size)
    normal[np.diag_indices(len(size))] += damping
    factor: Any = None
    with suppress(LinAlgError):
        factor = cho_factor(normal, lower=True, check_finite=False)
    if factor and np.square(np.diag(factor[0])).min(initial=1.0) > _LEAST_PIVOT:
        step = -cho_solve(factor, slope / size, check_finite=False) / size
    else:
        root = triangle(blocks())
        whole = np.concatenate([root[:, :-1] / size, np.sqrt(damping) * np.eye(len(size))])
        target = -np.r_[root[:, -1], np.zeros(len(size))]
        step = np.linalg.lstsq(whole, target, rcond=1e-12)[0] / size
    return step, float(-slope @ step)


def doubt_limit(distances, sigma):
    """Distance beyond which a row is better not learned from, though it may be sound.

    As `outlier_limit`, with the slope of the tail as it was found: three in ten of small sets
    without outliers have a row beyond it, which costs a fit next to nothing.
    """
    return outlier_limit(distances, sigma, _FALSE_NAMES, 0.0)


def inverse_normal(root):
    """Inverse of ``root.T @ root`` of a `triangle`; infinite variances where it is singular."""
    size = np.linalg.norm(root, axis=0)
    size[size == 0] = 1
    # The singular values of scaled columns: mm and rad differ by orders of magnitude.
    _, values, vectors = np.linalg.svd(root / size)
    values = np.r_[values, np.zeros(len(vectors) - len(values))]
    known = values > 1e-12 * values.max(initial=0.0)
    root = vectors[known].T / values[known] / size[:, None]
    covariance = root @ root.T
    open_ = np.abs(vectors[~known]).max(axis=0, initial=0.0) > 1e-6
    covariance[open_, open_] = np.inf
    return covariance


def outlier_limit(distances, sigma, false_names=_FALSE_NAMES / 2, n_sd=_SDS_OF_TAILS):
    """Distance beyond which a row is an outlier.

    Of vectors of three normal numbers the longest of n is at the quantile 1 - 1 / n of the chi
    distribution. What an arm does beside its noise makes the tail longer: the logarithm of the
    distance is taken as linear in that of chi, through the median and the 90 % quantile. The two
    quantiles are those of n rows, so that the slope is not known well: its upper limit is taken,
    so many standard deviations up.
    """
    n = len(distances)
    if not n:
        return np.inf
    middle, tail, far = chi.ppf([0.5, _TAIL, 1 - false_names / n], 3)
    at_middle, at_tail = np.quantile(distances, [0.5, _TAIL])
    if not at_middle > 0:
        return np.inf
    power = max(np.log(at_tail / at_middle) / np.log(tail / middle), 1.0)
    # Variances of the logarithms of the two quantiles of n numbers, and their covariance.
    steep = n * np.array([middle, tail]) * chi.pdf([middle, tail], 3)
    p = np.array([0.5, _TAIL])
    variance = n * p * (1 - p) / steep**2
    shared = n * p[0] * (1 - p[1]) / steep.prod()
    sd = np.sqrt(variance.sum() - 2 * shared) / np.log(tail / middle)
    return max(at_middle * (far / middle) ** (power * (1 + n_sd * sd)), far * sigma)
