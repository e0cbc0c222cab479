"""The fit under `calibrate`: parameters, residuals, and the weights and variances they imply."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi, norm

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration._result import ANGLES
from sklearn_raacmm.measurements import STILL_MM, base_motions
from sklearn_raacmm.utils import Groups, Whitening, align, chunks, robust_scale

# Kinds of parameters, by the name of their prior standard deviation, and how it is found: a guess,
# how many parameters that were seen the guess is worth, and its bounds
# (``benchmarks/bench_lengths.py scale``).
FOUND: dict[str, Any] = {
    "length_mm": (0.4, 1.0, 0.01, 10.0),
    "angle_rad": (0.003, 4.0, 1e-4, 0.02),
    "probe_mm": None,
    "short_length_mm": (0.3, 4.0, 0.01, 100.0),
    # Where an axis that slides begins, and its direction: a robot is put on a rail by eye.
    "slide_mm": (3.0, 1.0, 0.01, 100.0),
    "slide_rad": (0.005, 1.0, 1e-4, 0.1),
    "slide_scale": None,
}
# Standard deviation of the scale of a joint that slides, as a part of it: a choice.
_SLIDE_SCALE = 3e-4
# A long length has at least this part of the longest.
_LONG_SHARE = 0.25
# What counts as knowing nothing of the place of base and probe, mm at the probe. Any larger number
# gives the same: nine freedoms that a few poses determine.
UNKNOWN_PLACE_MM = 1000.0
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
# Directions that the normal equations show by less than this part are rounding: no step goes there.
_ROUNDING = 1e-14
# Rows whose Jacobian is made at a time, and most rows of which it is held for the next look: 11 MB
# for 27 parameters. Of more rows sums over blocks are held, and a few numbers of each row.
_BLOCK, _HELD = 4096, 2**14
# Where the search for the size of what the table does not explain begins, rad, and its steps.
_MISFIT_RAD, _MISFIT_ROUNDS = 1e-4, 30
# Places that are all within this part of the reach show nothing of the scale.
_NEAR_SHARE = 0.1
# A row that a fit can follow freely shows no noise: its distance is enlarged tenfold at most.
_MOST_LEVERAGE = 0.99
# Share of the sets without outliers in which rows may be named: half by chance, and 0.01 where the
# tail may be longer than it is taken to be. 4 of 200 simulated sets are named.
_FALSE_NAMES, _SDS_OF_TAILS = 0.05, norm.isf(0.01)
# Beyond the limit of these a row is better not learned from, though it may be sound: with the slope
# of the tail as it was found three in ten of small sets without outliers have such a row, which
# costs a fit next to nothing.
DOUBTED = {"false_names": _FALSE_NAMES, "n_sd": 0.0}
# The part of the distances whose size tells how long the tail of the others is.
_TAIL = 0.9


class TableFit:
    """State of the fit.

    The parameters x are the table, scales of what slides, the probe of each tool, and the base
    (rotation vector and shift) of each station; beside them stand the weights of the rows, `sigma`
    (mm), and the prior standard deviations.

    `priors` are standard deviations of lengths (mm), angles (rad) and the probe (mm); "auto" is
    found by the evidence.
    """

    def __init__(
        self, arm, measured, loss, free=Arm.TABLE, priors=("auto", "auto", UNKNOWN_PLACE_MM),
        correction=None,
    ):  # fmt: skip
        self.nominal_arm, self.measured, self.angles = arm, measured, measured.angles
        self.loss, self.free, self.priors = loss, free, priors
        self.n_tools, self.n_stations = measured.n_tools, measured.n_stations
        # Where points were measured all rows are beside one mean.
        self.index = np.zeros(len(self.angles), int) if self.n_stations else measured.index
        self.groups = Groups(self.index)
        n, n_groups = len(self.angles), self.index.max() + 1
        # Blocks of rows, and what sums up the rows of each position in them.
        self.blocks = chunks(n, _BLOCK)
        self.summing = [Groups(self.index[part], n_groups).total for part in self.blocks]
        self.correct(correction)
        self.slides, every = arm.slides, np.arange(arm.n_joints)
        self.turning = np.setdiff1d(every, self.slides)
        # Joints that slide, but stand still in all rows.
        self.still = [i for i in self.slides if np.ptp(self.angles[:, i]) < STILL_MM]
        self._name_parameters()
        self.x, self.sigma, self.converged = self.nominal.copy(), 1.0, False
        self.weights: Any = np.ones(n)
        self.scale = self._common_scale()
        points, places = self.points(), []  # first guess of every base
        for s in range(self.n_stations):
            rows = rows_with(measured.stations, s)
            places.append(align(points[rows], measured.points[rows]))
        self.rotations = np.array([rotation for rotation, _ in places])
        self.x = np.concatenate([self.x, *([0, 0, 0, *shift] for _, shift in places)])
        self.reset_weights()

    def _name_parameters(self):
        """Names, nominal values, kinds and priors of the table and of the probe of each tool."""
        arm, slides, measured = self.nominal_arm, self.slides, self.measured
        probes = in_brackets(measured.tool_labels, self.n_tools)
        self.names = [f"{f}{i + 1}" for f in Arm.TABLE[:-1] for i in range(arm.n_joints)]
        table = np.concatenate([getattr(arm, name) for name in Arm.TABLE[:-1]])
        is_length = np.array([not name.startswith(ANGLES) for name in self.names])
        of_slides = np.isin(np.arange(len(table)) % arm.n_joints, slides)
        # Where a slide stands says nothing of how long links are.
        size = np.where(is_length & ~of_slides, np.abs(table), 0.0)
        kind = np.where(size >= _LONG_SHARE * size.max(), "length_mm", "short_length_mm")
        kind = np.where(is_length, kind, "angle_rad").astype(object)
        kind[of_slides] = np.where(is_length, "slide_mm", "slide_rad")[of_slides]
        is_free = np.repeat(np.isin(Arm.TABLE[:-1], list(self.free)), arm.n_joints).tolist()
        self.names += [f"scale{i + 1}" for i in slides]
        self.names += [f"probe_{axis}{label}" for label in probes for axis in "xyz"]
        self.kind = np.r_[kind, ["slide_scale"] * len(slides), ["probe_mm"] * 3 * len(probes)]
        is_free += [i not in self.still and "d" in self.free for i in slides]
        self.is_free = np.array(is_free + ["probe" in self.free] * 3 * len(probes))
        scales = np.abs(arm.joint_signs[slides])
        self.nominal = np.concatenate([table, scales, *[arm.probe] * len(probes)])
        self.n_table = len(table) + len(slides)
        # Kinds whose common prior standard deviation is found by the evidence, and what counts.
        length, *_ = self.priors
        given = *self.priors, length, "auto", "auto", _SLIDE_SCALE
        priors = dict(zip(FOUND, given, strict=True))
        self.found = {kind: FOUND[kind] for kind, sd in priors.items() if sd == "auto"}
        sds = priors | {kind: guess for kind, (guess, *_) in self.found.items()}
        self.prior_sd = np.array([sds[kind] for kind in self.kind], dtype=float)

    def _common_scale(self):
        """Parts (n_parameters,) of the common scale of the long links, by which residuals count.

        Each link as much as the data feel it: an offset along the first axis, which a single-point
        test cannot feel, has no say.
        """
        every = np.ones(len(self.nominal), dtype=bool)
        parts = self._beside_touched(self.x, every, self.touched(self.x, every))
        felt: Any = sum(np.square(left[:, :, :-1]).sum(axis=(0, 1)) for _, left in parts)
        slides = self.kind == "slide_scale"
        length = np.where(slides | (self.kind == "length_mm"), felt * self.nominal, 0.0)
        if slides.any():  # beside the ways that they go short links carry no scale
            carried = length * self.nominal
            length[carried < _LONG_SHARE**2 * carried.max()] = 0.0
        total = length @ self.nominal
        return length / total if total > 0 else length

    @property
    def mask(self):
        """Free parameters of x."""
        return self._with_bases(self.is_free)

    def _with_bases(self, is_free):
        """Free parameters of x: bases always are."""
        return np.r_[is_free, np.ones(len(self.x) - len(is_free), bool)]

    def base_columns(self, station):
        """Columns of a station's base: rotation, then shift."""
        return len(self.nominal) + 6 * station + np.arange(6)

    def correct(self, correction):
        """Take other corrections (n, 3) of the points, mm, or None."""
        self.correction: Any = correction
        # Parameters that were looked at, the points there, and blocks of derivatives.
        self.evaluated: Any = None, None, None

    def reset_weights(self):
        self.weights = np.ones(len(self.angles))
        if self.measured.features:
            # One touch of another feature bends a sphere, where it hardly moves a mean.
            self.weights = self.first_weights()
        self.length_weights = self._new_length_weights()
        self._weigh()

    def first_weights(self):
        """Weights of the rows by what they touched, without slips; None for measured points."""
        if self.measured.features:
            return self.measured.touched.weights(self.points())
        return None if self.n_stations else self.groups.slip_factors(self.points())

    def of(self, loss=None, free=None, **changes):
        """A fit of the same rows that has settled, with some of what was measured changed."""
        correction = changes.pop("correction", self.correction)
        measured, how = replace(self.measured, **changes), (loss or self.loss, free or self.free)
        return TableFit(self.nominal_arm, measured, *how, self.priors, correction).run()

    def arm(self, tool=0):
        return self.nominal_arm.replace(**self._fields(self.x, tool))

    def _fields(self, x, tool) -> dict[str, Any]:
        """The fields of an arm, with the probe of a tool, by the parameters."""
        ends = np.append(np.arange(1, 5) * len(self.nominal_arm.a), self.n_table)
        *parts, scales, probes = np.split(x[: len(self.nominal)], ends)
        signs = np.sign(self.nominal_arm.joint_signs)
        signs[self.slides] *= scales
        parts.append(probes[3 * tool :][:3])
        return dict(zip(Arm.TABLE, parts, strict=True)) | {"joint_signs": signs}

    def run(self, is_free=None):
        """Alternate least squares, and the weights and variances they imply, until they settle."""
        mask = self._with_bases(self.is_free if is_free is None else is_free)
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
        if self.measured.features and mask[: -3 * self.n_tools].any():
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
        finite = np.where(np.isfinite(covariance), covariance, 0.0)
        at: Any = None if self.n_stations else self.touched(self.x, mask)
        spread = np.empty(len(self.angles))
        total = np.bincount(self.index, self.weights)
        for part, rows in self._data(self.x, mask, at):
            columns, left = rows[:, :, :-1], rows[:, :, -1]
            taken = (columns.reshape(-1, len(finite)) @ finite).reshape(columns.shape)
            taken = taken @ columns.swapaxes(1, 2)
            if self.measured.features:
                basis = at[-1].basis[part]
                taken += basis @ basis.swapaxes(1, 2)
            elif not self.n_stations:
                own = self.weights[part] / total[self.index[part]]
                taken += own[:, None, None] * np.eye(3)
            values, axes = np.linalg.eigh(taken)
            along = np.einsum("nji,nj->ni", axes, left)
            along /= np.sqrt(1 - np.clip(values, 0, _MOST_LEVERAGE))
            spread[part] = np.linalg.norm(along, axis=1)
        return spread

    def _weigh(self, spread=None):
        """Standard deviations of the data, and the weights of the rows."""
        distances, used = self.robust_distances(), self.measured.informative
        seen = distances if spread is None else spread * self.sigma / np.sqrt(self.weights)
        if self.loss == "squared":
            sigma = np.sqrt(np.mean(seen[used] ** 2) / self.measured.n_shown[used].mean())
        else:
            # Outliers would shift the median to larger ones of the others.
            three = self.as_of_three(seen)
            near = used & (three <= outlier_limit(three[used], 0.0, **DOUBTED))
            sigma = robust_scale(seen[near], self.measured.n_shown[near])
        self.sigma = max(sigma, _MIN_SIGMA_MM)
        self.weights = WEIGHTS[self.loss](self.as_of_three(distances) / self.sigma)

    def as_of_three(self, distances):
        r"""Distances (n,) as rare among normal errors in space as those of their rows are.

        Of k coordinates chi-squared is about :math:`k (1 - 2/9k + z \sqrt{2/9k})^3`, z normal
        (Wilson and Hilferty, Proc. National Academy of Sciences 17, 1931).
        """
        k, used = self.measured.n_shown, self.measured.informative
        if np.all(k == 3):
            return distances
        sigma = max(robust_scale(distances[used], k[used]), _MIN_SIGMA_MM)
        part = 2 / (9 * k)
        z = (np.cbrt(np.square(distances / sigma) / k) - (1 - part)) / np.sqrt(part)
        longer = sigma * np.sqrt(3 * (1 - 2 / 27 + z * np.sqrt(2 / 27)) ** 3)
        return np.where(k < 3, longer, distances)

    def _solve(self, mask):
        """Gauss-Newton steps at given weights, damped where they do not lower the squares."""
        sums, damping = self._sums(self.x, mask), 0.0
        for _ in range(_MAX_STEPS):
            step, gain = gauss_newton_step(sums, damping)
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
        for s in range(self.n_stations):
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
        for part in self.blocks:
            block = (part, *self.located_at(x, part))
            points[part] = block[1]
            if n <= _HELD:
                held.append(block)
            yield block
        self.evaluated = x.copy(), points, held

    def located_at(self, x, rows):
        """Corrected points (m, 3) of some rows, and their derivatives by table and probes."""
        measured, angles, n_table = self.measured, self.angles[rows], self.n_table
        points, jac = np.empty((len(angles), 3)), np.zeros((len(angles), 3, len(self.nominal)))
        tools = None if measured.tools is None else measured.tools[rows]
        for tool in range(self.n_tools):
            of, start = rows_with(tools, tool), n_table + 3 * tool
            points[of], own = self.table_jacobian(angles[of], x, tool)
            jac[of, :, :n_table], jac[of, :, start : start + 3] = np.split(own, [n_table], axis=2)
        if self.correction is not None:
            points -= self.correction[rows]
        return points, jac

    def table_jacobian(self, angles, x, tool=0):
        """Points (n, 3) that the arm shows, mm, and their derivatives (n, 3, n_table + 3).

        By the table, the scales of what slides, and the probe of a tool.
        """
        arm = self.nominal_arm
        points, jac = arm.parameter_jacobian(angles, **self._fields(x, tool))
        if slides := self.slides:
            n = len(arm.a)
            along = jac[:, :, 2 * n : 3 * n][:, :, slides]
            scales = along * (np.sign(arm.joint_signs) * arm.own_angles(angles))[:, None, slides]
            jac = np.concatenate([jac[:, :, : 4 * n], scales, jac[:, :, 4 * n :]], axis=2)
        return points, jac

    def free_columns(self, x, mask):
        """Yield blocks of rows, and derivatives by what is free, the points as the last column.

        Where the mask is longer than x, those by what `misfit` tries stand between.
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

    def touched(self, x, mask) -> Any:
        """What was touched, and what the free parameters move it by.

        Of cones these are the fixed points (n_points, 3) and their derivatives. Of other features,
        the forms, what the parameters move their unknowns by, the root of the covariance of these,
        and for `_beside_touched` what is left of the rows, what the unknowns explain of a Jacobian,
        and the `Whitening`.
        """
        weights, index = self.weights, self.index
        if self.measured.features:
            rows = self.measured.touched.linearised(self.points(x), weights)
            whitened: Any = Whitening(weights, rows.directions, index, rows.unknowns)
            explained: Any = 0.0
            for part, columns in self.free_columns(x, mask):
                columns = whitened.basis[part].swapaxes(1, 2) @ (whitened.root[part] @ columns)
                explained = explained + self.summed(part, columns)
            moves = whitened.unit @ explained[:, :, :-1]
            return rows.forms, moves, whitened.unit, rows, explained, whitened
        means = self._means(self.free_columns(x, mask), weights)
        return means[:, :, -1], means[:, :, :-1], means

    def _means(self, blocks, weights):
        """Weighted means (n_points, 3, k) of the rows of each position, of blocks (m, 3, k)."""
        # Sums of differences from the first row, so that a large mean costs no digits.
        total = np.maximum(np.bincount(self.index, weights), 1e-300)[:, None, None]
        first: Any = None
        sums: Any = 0.0
        for part, columns in blocks:
            first = columns[0] if first is None else first
            sums = sums + self.summed(part, weights[part, None, None] * (columns - first))
        return sums / total + first

    def summed(self, part, values):
        """Sums over the rows of each position in a block, of values (m, ...)."""
        matrix = self.summing[self.blocks.index(part)]
        sums = matrix @ values.reshape(len(values), -1)
        return sums.reshape(len(sums), *values.shape[1:])

    def _beside_touched(self, x, mask, at):
        """Yield blocks of rows, and their residuals (m, 3) as the last column of their Jacobian."""
        for part, rows in self.free_columns(x, mask):
            if self.measured.features:
                *_, touched, explained, whitened = at
                rows = touched.directions[part] @ rows
                rows -= whitened.moves[part] @ explained[self.index[part]]
                rows[:, :, -1] = touched.residual[part]
            else:
                rows -= at[2][self.index[part]]
            yield part, rows

    def _beside_points(self, x, mask):
        """The same of measured points. Derivatives by the turn of a base are those after it."""
        measured, n_table = self.measured, np.count_nonzero(mask[: len(self.nominal)])
        for part, columns in self.free_columns(x, mask):
            rows = np.insert(columns, [n_table] * 6 * self.n_stations, 0.0, axis=2)
            stations = None if measured.stations is None else measured.stations[part]
            for s in range(self.n_stations):
                of, shift = rows_with(stations, s), x[self.base_columns(s)[3:]]
                rows[of] = self._rotation(x, s) @ rows[of]
                first = n_table + 6 * s
                turns = base_motions(rows[of, :, -1], 1.0)
                rows[of, :, first : first + 6] = np.roll(turns, 3, axis=2)
                rows[of, :, -1] += shift - measured.points[part][of]
            yield part, rows

    def _data(self, x, mask, at):
        """Yield blocks of rows, and their residuals as the last column of the Jacobian.

        In standard deviations of the rows; `at` is what was `touched`.
        """
        slope = self.scale[mask[: len(self.scale)]]
        scale, by_length = self.scale @ x[: len(self.scale)], np.flatnonzero(slope)
        parts = (
            self._beside_points(x, mask) if self.n_stations else self._beside_touched(x, mask, at)
        )
        for part, rows in parts:
            if scale > 0 and not self.n_stations:
                rows /= scale
                rows[:, :, by_length] -= rows[:, :, -1:] * (slope[by_length] / scale)
            rows *= (np.sqrt(self.weights[part]) / self.sigma)[:, None, None]
            yield part, rows

    def known(self, lengths, at):
        """Known lengths as they are found: (n,) mm, their slopes (n, p), and sds of their ends.

        `at` is what was `touched`.
        """
        one, other = np.array([entry[:2] for entry in lengths], dtype=int).reshape(-1, 2).T
        if not self.measured.features:
            gap = at[0][one] - at[0][other]
            found = np.maximum(np.linalg.norm(gap, axis=1), 1e-12)
            slopes = np.einsum("kc,kcp->kp", gap / found[:, None], at[1][one] - at[1][other])
            # What the table does not explain is much the same in all poses of one position.
            return found, slopes, np.full(len(found), np.sqrt(2) * self.sigma)
        forms, moves, unit, *_ = at
        found, slopes, variance = np.zeros(len(one)), np.zeros((len(one), moves.shape[2])), []
        for k, (i, j) in enumerate(zip(one, other, strict=True)):
            found[k], *sides = forms[i].length_to(forms[j])
            sides = [side[: moves.shape[1]] for side in sides]
            slopes[k] = sides[0] @ moves[i] + sides[1] @ moves[j]
            ends = zip((i, j), sides, strict=True)
            variance.append(sum(np.square(side @ unit[end]).sum() for end, side in ends))
        return found, slopes, self.sigma * np.sqrt(np.array(variance))

    def rows(self, x, mask, with_prior=True):
        """Yield the Jacobian, in blocks (m, k + 1), in standard deviations, the residuals last.

        Of the data, then of the known lengths, then of the prior.
        """
        at = None if self.n_stations else self.touched(x, mask)
        for _, rows in self._data(x, mask, at):
            yield rows.reshape(-1, rows.shape[2])
        if self.measured.lengths:
            yield self.length_rows(at)
        is_free = mask[: len(self.nominal)]
        if with_prior and is_free.any():
            prior = np.zeros((is_free.sum(), mask.sum() + 1))
            np.fill_diagonal(prior, 1 / self.prior_sd[is_free])
            prior[:, -1] = ((x[: len(is_free)] - self.nominal) / self.prior_sd)[is_free]
            yield prior

    def length_rows(self, at):
        """The rows of the known lengths, as `rows` yields them."""
        found, slopes, _ = self.known(self.measured.lengths, at)
        sds = self.length_sd / np.sqrt(self.length_weights)
        return np.column_stack([slopes, self._off(found)]) / sds[:, None]

    def points(self, x=None):
        """Corrected points (n, 3) in mm, in the arm's base frame; they are held for the next look.

        Of the parameters of the fit, or of others.
        """
        x = (self.x if x is None else x)[: len(self.nominal)]
        if not np.array_equal(self.evaluated[0], x):
            deque(self.located(x), maxlen=0)
        return self.evaluated[1].copy()

    def residuals(self, weights=None):
        """Differences (n, 3) in mm, in the arm's frame, not divided by the scale."""
        points, measured = self.points(), self.measured
        weights = np.ones(len(points)) if weights is None else weights
        if measured.features:
            return measured.touched.linearised(points, weights).residual
        if not self.n_stations:
            blocks = ((part, points[part, :, None]) for part in self.blocks)
            return points - self._means(blocks, weights)[self.index, :, 0]
        for s in range(self.n_stations):
            rows, shift = rows_with(measured.stations, s), self.x[self.base_columns(s)[3:]]
            points[rows] -= (measured.points[rows] - shift) @ self.rotations[s]
        return points

    def distances(self):
        """Distances (n,) in mm from the plain mean of the group: what scatter is made of."""
        return np.linalg.norm(self.residuals(), axis=1)

    def robust_distances(self):
        """Distances (n,) in mm from the weighted mean of the group, which outliers do not pull."""
        return np.linalg.norm(self.residuals(self.weights), axis=1)

    def lengths_found(self):
        """Errors of known lengths, between the centres of groups, and of sizes, mm.

        And the standard deviations of their ends, mm, which the touches leave.
        """
        if not self.measured.lengths:
            return np.empty(0), np.empty(0)
        none = np.zeros(len(self.x), dtype=bool)
        found, _, sd_of_ends = self.known(self.measured.lengths, self.touched(self.x, none))
        return self._off(found), sd_of_ends

    def _off(self, found):
        """Errors (n,) of lengths as found, mm: of the side of the probe's ball that fits best."""
        each = zip(found, self.measured.lengths, self.measured.offsets, strict=True)
        return np.array([min(mm - entry[2] - by, key=abs) for mm, entry, by in each])

    @property
    def stated_sd(self):
        """Standard deviations (n,) of the known lengths as they are stated, mm."""
        return np.array([entry[3] for entry in self.measured.lengths], dtype=float)

    def _new_length_weights(self):
        # A wrong length (one hole of a plate beside the right one) must not bend the arm.
        errors, sd_of_ends = self.lengths_found()
        # Of fewer touches, of one coordinate each, sizes are not as sure as they are stated.
        self.length_sd = np.hypot(self.stated_sd, sd_of_ends * bool(self.measured.features))
        return WEIGHTS[self.loss](np.abs(errors) / self.length_sd)

    def misfit(self, mask):
        r"""What the table does not explain, and what it moves the free parameters by.

        It is no noise: at poses that are alike it is much the same. Angles of joints that turn are
        taken to be off by a cosine and a sine of themselves, as an eccentric scale makes them, and
        by the lever of gravity: A w, of one variance by the evidence. With C their covariance the
        parameters move by :math:`-C J'A w`. Returned are w, its standard deviation before the data,
        rad, C J'A (k, n_w), and the mask of parameters with w behind them.
        """
        k, every = np.count_nonzero(mask), np.r_[mask, np.ones(3 * len(self.turning), dtype=bool)]
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
        return -axes @ found, sd, covariance @ root[:k, :k].T @ root[:k, k:-1], every

    def scaled_by_misfit(self):
        """By which parts what the table does not explain enlarges distances between the points.

        Of each of w of one standard deviation, with what the parameters do against it, (n_w,).
        """
        _, sd, moved, every = self.misfit(self.mask)
        points, n_table = self.points(), np.count_nonzero(self.is_free)
        away = points - points.mean(axis=0)
        slopes: Any = sum(
            np.einsum("nc,ncp->p", away[part], columns[:, :, :-1])
            for part, columns in self.free_columns(self.x, every)
        )
        least = len(away) * (_NEAR_SHARE * self.nominal_arm.reach_mm) ** 2
        slopes /= max(np.square(away).sum(), least)
        return sd * (slopes[n_table:] - slopes[:n_table] @ moved[:n_table])

    def covariance(self):
        """Posterior covariance of the free parameters; infinite where nothing is known.

        What the table does not explain is much the same in all poses of one position. A position at
        the end of known lengths is therefore no better known than one of its points.
        """
        mask, lengths = self.mask, self.measured.lengths
        covariance = inverse_normal(triangle(self.rows(self.x, mask))[:, :-1])
        if lengths and not self.measured.features:
            centres, *_ = at = self.touched(self.x, mask)
            every = np.arange(len(lengths))
            one, other = np.array([entry[:2] for entry in lengths]).T
            gap = centres[one] - centres[other]
            along = gap / np.maximum(np.linalg.norm(gap, axis=1), 1e-12)[:, None]
            ends = np.zeros((len(lengths), *centres.shape))
            ends[every, one], ends[every, other] = along, -along
            ends *= (np.sqrt(self.length_weights) * self.sigma / self.stated_sd)[:, None, None]
            finite = np.where(np.isfinite(covariance), covariance, 0.0)
            spread = finite @ self.length_rows(at)[:, :-1].T @ ends.reshape(len(lengths), -1)
            covariance = covariance + spread @ spread.T
        return covariance

    def _take_best_table(self, mask):
        """Of touches, go on to the table that serves best at their poses.

        Surfaces show some directions only, and fitted to these a table follows what it does not
        explain along them. Where both are told apart, the table is that which moves the points as
        both do: within every feature, and between their means, beside a motion of the base. Known
        lengths count, and the prior.
        """
        misfit, _, pulled, every = self.misfit(mask)
        index, k = self.index, pulled.shape[0]
        sums: Any = sum(self.summed(*block) for block in self.free_columns(self.x, every))
        means = sums / np.bincount(index)[:, None, None]
        base = base_motions(means[:, :, -1], self.nominal_arm.reach_mm).reshape(-1, 6)
        base, flat = np.linalg.qr(base)[0], means.reshape(-1, means.shape[2])

        def rows():
            yield (flat - base @ (base.T @ flat)) / self.sigma
            for part, columns in self.free_columns(self.x, every):
                yield (columns - means[index[part]]).reshape(-1, flat.shape[1]) / self.sigma
            if self.measured.lengths:
                yield self.length_rows(self.touched(self.x, every))

        root = triangle(rows())[:, :-1]
        both = np.vstack([root[:, :k], np.diag(1 / self.prior_sd[mask])])
        target = np.r_[root[:, k:] @ misfit, np.zeros(k)]
        x = self.x.copy()
        x[mask] += np.linalg.lstsq(both, target, rcond=1e-12)[0] - pulled @ misfit
        self._take(x)


def rows_with(numbers, one):
    """Rows of one tool or station, by the number of each row (n,), or None: all are."""
    return slice(None) if numbers is None else np.flatnonzero(numbers == one)


def in_brackets(labels, n):
    """What follows the names of the parameters of each of n tools or stations."""
    return [f"[{label}]" for label in labels] or [""] * n


def triangle(blocks):
    """Triangular factor of the rows of all blocks, as the QR decomposition of all has it."""
    root: Any = None
    for rows in blocks:
        root = np.linalg.qr(rows if root is None else np.vstack([root, rows]), mode="r")
    return root


def gauss_newton_step(sums, damping):
    """Step of least squares (k,), and by how much it lowers the sum of squares if all is linear.

    `sums` (k + 1, k + 1) are the products of the Jacobian's columns, and of the residuals, which
    are the last one. The damping, as a part of the squares of each column, is Marquardt's.
    """
    normal, slope = sums[:-1, :-1], sums[:-1, -1]
    size = np.sqrt(np.diag(normal))
    size[size == 0] = 1
    normal = normal / np.outer(size, size) + max(damping, _ROUNDING) * np.eye(len(size))
    step = -np.linalg.solve(normal, slope / size) / size
    return step, float(-slope @ step)


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
