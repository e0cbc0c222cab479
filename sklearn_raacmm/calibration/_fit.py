"""The fit under `calibrate`: parameters, residuals, weights, and what they are worth."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.spatial.transform import Rotation
from scipy.special import chdtri
from scipy.stats import chi, norm

from sklearn_raacmm.arm import FIELDS, slides_of
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
from sklearn_raacmm.inference import evidence_variance, whitening
from sklearn_raacmm.measurements import (
    STILL_MM,
    known_length,
    linearised,
    touch_weights,
    with_forms,
)
from sklearn_raacmm.utils import align, centred, group_means, robust_scale, slip_factors

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
# Steps of one iteration at the start, of a base: rad and mm.
_STEP_RAD, _STEP_MM = 1e-2, 10.0
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
        self.still = [i for i in slides_of(arm.joint_types) if ways[i] < STILL_MM]
        self._name_parameters(free)
        nominal = self.nominal
        self.x = nominal.copy()
        self.converged = False
        self.sigma = 1.0  # mm, until rows are weighed
        self.evaluated: Any = None
        points, jac = self.points_and_jacobian(self.x)
        places = []  # first guess of every base
        for s in range(problem.n_stations):
            rows = rows_of(problem.stations, s)
            places.append(align(points[rows], problem.points[rows]))
        self.rotations = np.array([rotation for rotation, _ in places])
        self.x = np.concatenate([self.x, *([0, 0, 0, *shift] for _, shift in places)])
        # The common scale of the long links, each as much as the data feel it: an offset along the
        # first axis, which a single-point test cannot feel, has no say.
        if problem.features:
            left = self._touched(points, jac, np.ones(len(points)))[1]
        else:
            tracked = problem.points is not None
            left = jac - jac.mean(axis=0) if tracked else centred(jac, problem.index)
        felt = np.sum(left**2, axis=(0, 1))
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
        slides = slides_of(arm.joint_types)
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
        self.weights: Any = np.ones(len(self.angles))
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
        return self

    def _judge(self, mask, find_priors):
        """New weights and variances; returns whether the prior variances have settled."""
        if not mask.any():
            self._weigh()
            return True
        is_free = mask[: len(self.nominal)]
        rows, jac = self._residuals_and_jacobian(self.x, mask)
        covariance = inverse_normal(jac)
        share = np.ones(len(is_free))  # of the prior's variance that the data leave
        share[is_free] = np.diag(covariance)[: is_free.sum()] / self.prior_sd[is_free] ** 2
        share = np.minimum(share, 1.0)
        self._weigh(self._spread(covariance, rows, jac))
        settled = True
        departure = self.x[: len(is_free)] - self.nominal
        for kind, (guess, counts, least, most) in self.found.items() if find_priors else ():
            members = is_free & (self.kind == kind)
            if members.any():
                seen, square = np.sum(1 - share[members]), np.sum(departure[members] ** 2)
                sd = np.sqrt(evidence_variance(square, seen, guess**2, counts))
                sd = np.clip(sd, least, most)
                settled &= bool(abs(np.log(sd / self.prior_sd[members][0])) < 0.05)
                self.prior_sd[members] = sd
        return settled

    def _spread(self, covariance, rows, jac):
        """Lengths (n,) that the residuals would have had the fit not followed them.

        The covariance of a row's residual is that of the noise less its block of the hat matrix;
        the inverse root of the two takes a residual back to the size of the noise, in standard
        deviations.
        """
        n = len(self.angles)
        jac = jac[: 3 * n].reshape(n, 3, -1)
        finite = np.where(np.isfinite(covariance), covariance, 0.0)
        taken = (jac.reshape(-1, jac.shape[2]) @ finite).reshape(jac.shape) @ jac.swapaxes(1, 2)
        if self.problem.features:
            basis: Any = self._touched(self.points(), jac, self.weights)[-1].basis
            taken += basis @ basis.swapaxes(1, 2)
        elif self.problem.points is None:
            index = self.problem.index
            own = self.weights / np.bincount(index, self.weights)[index]
            taken += own[:, None, None] * np.eye(3)
        values, axes = np.linalg.eigh(taken)
        along = np.einsum("nji,nj->ni", axes, rows[: 3 * n].reshape(-1, 3))
        along /= np.sqrt(1 - np.clip(values, 0, _MOST_LEVERAGE))
        return np.linalg.norm(along, axis=1)

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
        bases = self.problem.n_stations
        unit = np.r_[self.prior_sd, np.tile([_STEP_RAD] * 3 + [_STEP_MM] * 3, bases)][mask]
        rows, jac = self._residuals_and_jacobian(self.x, mask)
        damping = 0.0
        for _ in range(_MAX_STEPS):
            step, gain = gauss_newton_step(jac * unit, rows, damping)
            x = self.x.copy()
            x[mask] += unit * step
            if gain <= _SMALL_GAIN * (rows @ rows):
                self._take(x)
                break
            new_rows, new_jac = self._residuals_and_jacobian(x, mask)
            if new_rows @ new_rows <= rows @ rows:
                rows, jac = new_rows, new_jac
                self._take(x)
                damping = damping / 10 if damping > _DAMPING else 0.0
            elif damping > _MOST_DAMPING:
                break
            else:
                damping = max(100 * damping, _DAMPING)

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

    def points_and_jacobian(self, x):
        """Corrected points (n, 3) in the base frame, and their derivatives (n, 3, n_parameters).

        By table and probes, mm and rad; the last are kept.
        """
        x, arm, problem = x[: len(self.nominal)], self.nominal_arm, self.problem
        if self.evaluated is not None and np.array_equal(self.evaluated[0], x):
            return self.evaluated[1:]
        n_table, n = len(pack(arm)) - 3, len(self.angles)
        # On trial: an `Arm` would check its fields at every step.
        trial = SimpleNamespace(
            convention=arm.convention, joint_signs=arm.joint_signs, couplings=arm.couplings,
            joint_types=arm.joint_types,
        )  # fmt: skip
        points, jac = np.empty((n, 3)), np.zeros((n, 3, len(x)))
        for tool in range(problem.n_tools):
            rows, start = rows_of(problem.tools, tool), n_table + 3 * tool
            vars(trial).update(unpack(x, arm, tool))
            points[rows], own = table_jacobian(trial, self.angles[rows])
            jac[rows, :, :n_table] = own[:, :, :n_table]
            jac[rows, :, start : start + 3] = own[:, :, n_table:]
        if self.correction is not None:
            points -= self.correction
        self.evaluated = x.copy(), points, jac
        return points, jac

    def data_residuals(self, x, mask):
        """Residuals (n, 3) in mm of the data, their Jacobian, and what was touched with its own.

        Of cones these are the fixed points; of other features, the forms, what the parameters move
        their unknowns by, and the root of the covariance of these. Derivatives by the turn of a
        base are those by a small turn after it.
        """
        problem, n = self.problem, len(self.nominal)
        points, jac = self.points_and_jacobian(x)
        jac = np.take(jac, np.flatnonzero(mask[:n]), axis=2)
        if problem.points is None:
            if problem.features:
                residuals, jac, forms, moves, of = self._touched(points, jac, self.weights)
                at: Any = [forms, moves, of.unit]
            else:
                both = np.concatenate([points[:, :, None], jac], axis=2)
                means = group_means(both, problem.index, self.weights)
                at = [means[:, :, 0], means[:, :, 1:]]
                residuals = points - at[0][problem.index]
                jac -= at[1][problem.index]
            scale, by_length = self.scale @ x, np.flatnonzero(self.scale[mask])
            if scale > 0:
                jac /= scale
                slope = self.scale[mask][by_length] / scale**2
                jac[:, :, by_length] -= residuals[:, :, None] * slope
                residuals /= scale
            return residuals, jac, at
        place = np.cumsum(mask) - 1  # of each parameter among those that are free
        whole, n_free = np.zeros((len(points), 3, mask.sum())), jac.shape[2]
        residuals = np.empty_like(points)
        for s in range(problem.n_stations):
            rows, columns = rows_of(problem.stations, s), self.base_columns(s)
            turn = self._rotation(x, s)
            turned = points[rows] @ turn.T
            residuals[rows] = turned + x[columns[3:]] - problem.points[rows]
            whole[rows, :, :n_free] = turn @ jac[rows]
            for column, axis in zip(place[columns[:3]], np.eye(3), strict=True):
                whole[rows, :, column] = np.cross(axis, turned)
            whole[rows, :, place[columns[3]] : place[columns[5]] + 1] = np.eye(3)
        return residuals, whole, None

    def _touched(self, points, jac, weights):
        """Touches about their features: residuals (n, 3) and their Jacobian, forms, and moves.

        And the `Whitening` of the rows, which takes the unknowns of the features out.
        """
        features, index = self.problem.features, self.problem.index
        rows, forms = with_forms(features, index, points, weights)
        whitened = whitening(weights, rows.directions, index, rows.directions @ rows.unknowns)
        jac = rows.directions @ jac
        return rows.residual, whitened.centred(jac), forms, whitened.unknowns(jac), whitened

    def known(self, lengths, at):
        """Known lengths as they are found: (n,) mm, their slopes (n, p), and sds of their ends.

        `at` is what was touched, of `data_residuals`.
        """
        one, other = np.array([entry[:2] for entry in lengths], dtype=int).reshape(-1, 2).T
        if not self.problem.features:
            gap = at[0][one] - at[0][other]
            found = np.maximum(np.linalg.norm(gap, axis=1), 1e-12)
            slopes = np.einsum("kc,kcp->kp", gap / found[:, None], at[1][one] - at[1][other])
            # What the table does not explain is much the same in all poses of one position.
            return found, slopes, np.full(len(found), np.sqrt(2) * self.sigma)
        forms, moves, unit = at
        found, slopes, variance = np.zeros(len(one)), np.zeros((len(one), moves.shape[2])), []
        for k, (i, j) in enumerate(zip(one, other, strict=True)):
            found[k], *sides = known_length(forms[i], forms[j])
            sides = [side[: moves.shape[1]] for side in sides]
            slopes[k] = sides[0] @ moves[i] + sides[1] @ moves[j]
            ends = zip((i, j), sides, strict=True)
            variance.append(sum(np.square(side @ unit[end]).sum() for end, side in ends))
        return found, slopes, self.sigma * np.sqrt(np.array(variance))

    def _residuals_and_jacobian(self, x, mask):
        """Weighted residuals of data, known lengths and prior, and their Jacobian."""
        residuals, jac, at = self.data_residuals(x, mask)
        weight = np.sqrt(self.weights)[:, None] / self.sigma
        jac *= weight[:, :, None]
        rows, jacs = [(weight * residuals).ravel()], [jac.reshape(3 * len(jac), jac.shape[2])]
        sds = self.length_sd / np.sqrt(self.length_weights)
        if self.problem.lengths:
            found, slopes, _ = self.known(self.problem.lengths, at)
            rows.append(self._off(found) / sds)
            jacs.append(slopes / sds[:, None])
        is_free = mask[: len(self.nominal)]
        prior = np.eye(is_free.sum(), mask.sum()) / self.prior_sd[is_free][:, None]
        departure = ((x[: len(is_free)] - self.nominal) / self.prior_sd)[is_free]
        return np.concatenate([*rows, departure]), np.concatenate([*jacs, prior])

    def data_jacobian(self, mask):
        """Derivatives of the weighted data, in standard deviations, by the free parameters."""
        jac = self._residuals_and_jacobian(self.x, mask)[1]
        return jac[: len(jac) - mask[: len(self.nominal)].sum()]

    def points(self):
        """Corrected points (n, 3) in mm, in the arm's base frame."""
        return self.points_and_jacobian(self.x)[0].copy()

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
        return self.known(self.problem.lengths, self.data_residuals(self.x, none)[2])

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
        jac = self._residuals_and_jacobian(self.x, mask)[1]
        covariance = inverse_normal(jac)
        if self.problem.lengths and not self.problem.features:
            first = len(jac) - mask[: len(self.nominal)].sum() - len(self.problem.lengths)
            sd = np.array([entry[3] for entry in self.problem.lengths])
            centres = self.centres()
            ends = np.zeros((len(sd), *centres.shape))
            for k, (i, j, *_) in enumerate(self.problem.lengths):
                gap = centres[i] - centres[j]
                ends[k, i] = gap / max(np.linalg.norm(gap), 1e-12)
                ends[k, j] = -ends[k, i]
            ends *= (np.sqrt(self.length_weights) * self.sigma / sd)[:, None, None]
            finite = np.where(np.isfinite(covariance), covariance, 0.0)
            spread = finite @ jac[first : first + len(sd)].T @ ends.reshape(len(sd), -1)
            covariance = covariance + spread @ spread.T
        return covariance


def gauss_newton_step(jac, rows, damping):
    """Step of least squares (p,), and by how much it lowers the sum of squares if all is linear.

    The damping, as a part of the squares of each column, is Marquardt's.
    """
    normal, slope = jac.T @ jac, jac.T @ rows
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
        whole = np.concatenate([jac / size, np.sqrt(damping) * np.eye(len(size))])
        target = -np.r_[rows, np.zeros(len(size))]
        step = np.linalg.lstsq(whole, target, rcond=1e-12)[0] / size
    return step, float(-slope @ step)


def doubt_limit(distances, sigma):
    """Distance beyond which a row is better not learned from, though it may be sound.

    As `outlier_limit`, with the slope of the tail as it was found: three in ten of small sets
    without outliers have a row beyond it, which costs a fit next to nothing.
    """
    return outlier_limit(distances, sigma, _FALSE_NAMES, 0.0)


def inverse_normal(jac):
    """Inverse of ``jac.T @ jac``, with infinite variances where it is singular."""
    size = np.linalg.norm(jac, axis=0)
    size[size == 0] = 1
    # The singular values of scaled columns: mm and rad differ by orders of magnitude.
    _, values, vectors = np.linalg.svd(np.linalg.qr(jac / size, mode="r"))
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
