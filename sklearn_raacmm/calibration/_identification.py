"""The fit under `calibrate`: parameters, residuals, weights, and what they are worth."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from sklearn_raacmm.arm import FIELDS, parameter_jacobian

# Weight of a point whose distance is u standard deviations of one coordinate.
WEIGHTS = {
    "linear": np.ones_like,
    "soft_l1": lambda u: 1 / np.sqrt(1 + (u / 2) ** 2),
    "huber": lambda u: 2.5 / np.maximum(u, 2.5),
    "cauchy": lambda u: 1 / (1 + (u / 4) ** 2),
}
# Median length of a vector of three standard normal numbers.
_MEDIAN_NORM = 1.5382
_MIN_SIGMA_MM = 1e-7  # noise-free simulated data must not divide by zero
MAX_ROUNDS = 20


class Fit:
    """State of the fit: parameters x = table, probe[, base], weights, sigma."""

    def __init__(self, arm, angles, problem, nominal, prior_sd, loss):
        self.nominal_arm, self.angles, self.problem = arm, angles, problem
        self.nominal, self.prior_sd, self.loss = nominal, prior_sd, loss
        self.x = nominal.copy()
        self.rotation = np.eye(3)
        self.converged = False
        points, jac = parameter_jacobian(arm, angles)
        if problem.points is not None:
            self.rotation, shift = align(points, problem.points)
            self.x = np.r_[self.x, 0, 0, 0, shift]
        # The common scale of the links, each as much as the data feel it: an offset along the
        # first axis, which a single-point test cannot feel, has no say.
        n = arm.n_joints
        felt = np.sum((jac - problem.mean(jac, np.ones(len(angles)))) ** 2, axis=(0, 1))
        length = np.zeros_like(nominal)
        for rows in (slice(0, n), slice(2 * n, 3 * n)):
            length[rows] = felt[rows] * nominal[rows]
        total = length @ nominal
        self.scale = length / total if total > 0 else length
        self.reset_weights()

    def reset_weights(self):
        self.weights = np.ones(len(self.angles))
        self.length_weights = self._new_length_weights()
        self.sigma = None

    def arm(self, x=None):
        return unpack(self.nominal_arm, self.x if x is None else x)

    def run(self, is_free):
        """Alternate least squares, and the weights and sigma they imply, until sigma settles."""
        mask = np.r_[is_free, np.ones(len(self.x) - len(is_free), bool)]
        for _ in range(MAX_ROUNDS):
            if self.sigma is None:
                self.sigma = self._new_sigma(0.0)
            before = self.sigma
            if mask.any():
                self._solve(mask)
            self.sigma = self._new_sigma(self._effective_parameters(mask))
            self.weights = WEIGHTS[self.loss](self.robust_distances() / self.sigma)
            weights, self.length_weights = self.length_weights, self._new_length_weights()
            change = np.max(np.abs(weights - self.length_weights), initial=0.0)
            self.converged = bool(abs(self.sigma - before) <= 1e-3 * before and change <= 0.02)
            if self.converged:
                break

    def _solve(self, mask):
        if self.problem.points is not None:  # a small rotation about the last one
            self.x[len(self.nominal) : len(self.nominal) + 3] = 0
        step = np.r_[self.prior_sd, [1e-2] * 3 + [10.0] * 3][: len(self.x)]
        x0, memory = self.x.copy(), {}

        def evaluate(z):
            if memory.get("z") != z.tobytes():
                x = x0.copy()
                x[mask] += step[mask] * z
                residuals, jac = self._residuals_and_jacobian(x, mask)
                memory.update(z=z.tobytes(), x=x, r=residuals, j=jac * step[mask])
            return memory

        solution = least_squares(
            lambda z: evaluate(z)["r"],
            np.zeros(mask.sum()),
            jac=lambda z: evaluate(z)["j"],
            xtol=1e-10,
            ftol=1e-10,
            max_nfev=100,
        )
        self.x = evaluate(solution.x)["x"].copy()
        if self.problem.points is not None:
            i = len(self.nominal)
            self.rotation = Rotation.from_rotvec(self.x[i : i + 3]).as_matrix() @ self.rotation
            self.x[i : i + 3] = 0

    def _data_residuals(self, x):
        """Residuals (n, 3) in mm of the data, their Jacobian, and the two of the fixed points."""
        points, jac = parameter_jacobian(self.arm(x), self.angles)
        problem, n_arm = self.problem, len(self.nominal)
        if problem.points is None:
            centres, centres_jac = (problem.sums(v, self.weights) for v in (points, jac))
            residuals, jac = points - centres[problem.index], jac - centres_jac[problem.index]
            scale = self.scale @ x
            if scale > 0:
                jac = jac / scale - residuals[:, :, None] * (self.scale / scale**2)
                residuals = residuals / scale
            return residuals, jac, centres, centres_jac
        turn = Rotation.from_rotvec(x[n_arm : n_arm + 3]).as_matrix() @ self.rotation
        turned = points @ turn.T
        base = np.zeros((*turned.shape, 6))
        left = left_jacobian(x[n_arm : n_arm + 3])
        base[:, :, :3] = np.stack([np.cross(column, turned) for column in left.T], axis=2)
        base[:, :, 3:] = np.eye(3)
        residuals = turned + x[n_arm + 3 :] - problem.points
        return residuals, np.concatenate([turn @ jac, base], axis=2), None, None

    def _residuals_and_jacobian(self, x, mask):
        residuals, jac, centres, centres_jac = self._data_residuals(x)
        weight = np.sqrt(self.weights)[:, None] / self.sigma
        n_arm, is_free = len(self.nominal), mask[: len(self.nominal)]
        rows = [(weight * residuals).ravel()]
        jacs = [(weight[:, :, None] * jac).reshape(-1, len(x))[:, mask]]
        for (i, j, length, sd), length_weight in zip(
            self.problem.lengths, self.length_weights, strict=True
        ):
            sd = sd / np.sqrt(length_weight)
            gap = centres[i] - centres[j]
            distance = max(np.linalg.norm(gap), 1e-12)
            rows.append([(distance - length) / sd])
            jacs.append((gap @ (centres_jac[i] - centres_jac[j]) / (distance * sd))[None, mask])
        rows.append(((x[:n_arm] - self.nominal) / self.prior_sd)[is_free])
        prior = np.zeros((is_free.sum(), mask.sum()))
        prior[:, : is_free.sum()] = np.diag(1 / self.prior_sd[is_free])
        jacs.append(prior)
        return np.concatenate(rows), np.concatenate(jacs)

    def residuals(self, weights=None):
        """Differences (n, 3) in mm, in the arm's frame, not divided by the scale."""
        points = self.arm().forward(self.angles)
        if self.problem.points is None:
            weights = np.ones(len(points)) if weights is None else weights
            return points - self.problem.mean(points, weights)
        shift = self.x[len(self.nominal) + 3 :]
        return points - (self.problem.points - shift) @ self.rotation

    def distances(self):
        """Distances (n,) in mm from the plain mean of the group: what scatter is made of."""
        return np.linalg.norm(self.residuals(), axis=1)

    def robust_distances(self):
        """Distances (n,) in mm from the weighted mean of the group, which outliers do not pull."""
        return np.linalg.norm(self.residuals(self.weights), axis=1)

    def length_errors(self):
        """Lengths between the centres of groups less the known ones, mm."""
        if not self.problem.lengths:
            return np.empty(0)
        centres = self.problem.sums(self.arm().forward(self.angles), self.weights)
        i, j, length, _ = zip(*self.problem.lengths, strict=True)
        return np.linalg.norm(centres[list(i)] - centres[list(j)], axis=1) - length

    def _new_length_weights(self):
        # A wrong length (one hole of a plate beside the right one) must not bend the arm.
        sd = np.array([entry[3] for entry in self.problem.lengths])
        return WEIGHTS[self.loss](np.abs(self.length_errors()) / sd)

    def _new_sigma(self, n_parameters):
        n_data = 3 * self.problem.n_informative
        lost = n_parameters + (0 if self.problem.points is not None else 3 * self.problem.n_useful)
        freedom = max(n_data - lost, 1.0) / n_data
        informative = self.problem.informative
        distances = self.robust_distances()[informative]
        if self.loss == "linear":
            sigma = np.sqrt(np.mean(distances**2) / 3)
        else:
            sigma = np.median(distances) / _MEDIAN_NORM
        return max(sigma / np.sqrt(freedom), _MIN_SIGMA_MM)

    def _covariance(self, mask):
        _, jac = self._residuals_and_jacobian(self.x, mask)
        size = np.linalg.norm(jac, axis=0)
        size[size == 0] = 1
        # pinv of the scaled columns: mm and rad differ by orders of magnitude
        root = np.linalg.pinv(jac / size, rcond=1e-12) / size[:, None]
        return root @ root.T

    def _effective_parameters(self, mask):
        """Count parameters that the data, not the prior, decide."""
        if not mask.any():
            return 0.0
        is_free = mask[: len(self.nominal)]
        variance = np.diag(self._covariance(mask))[: is_free.sum()]
        return mask.sum() - np.sum(variance / self.prior_sd[is_free] ** 2)

    def uncertainty(self, is_free):
        """Standard deviations of the arm's parameters, of their scale, and the scale's a priori."""
        mask = np.r_[is_free, np.ones(len(self.x) - len(is_free), bool)]
        sd = np.zeros(len(is_free))
        scale = self.scale[is_free]
        if not is_free.any():
            return sd, 0.0, np.inf
        covariance = self._covariance(mask)[: is_free.sum(), : is_free.sum()]
        sd[is_free] = np.sqrt(np.diag(covariance))
        scale_sd = np.sqrt(scale @ covariance @ scale)
        prior = np.linalg.norm(scale * self.prior_sd[is_free])
        return sd, float(scale_sd), float(prior) if prior > 0 else np.inf


@dataclass
class Problem:
    """Checked data: groups as numbers, or measured points; lengths between numbers of groups."""

    index: np.ndarray | None
    points: np.ndarray | None
    lengths: list

    def __post_init__(self):
        if self.points is not None:
            self.n_informative, self.informative = len(self.points), slice(None)
            return
        self.order = np.argsort(self.index, kind="stable")
        count = np.bincount(self.index)
        self.starts = np.r_[0, np.cumsum(count)[:-1]]
        # One point is its own mean: its zero residual must not pass for precision.
        self.informative = count[self.index] > 1
        self.n_useful = int((count > 1).sum())
        self.n_informative = int(self.informative.sum())

    def sums(self, values, weights):
        """Weighted mean of each group, (n_groups, ...)."""
        weights = weights[self.order].reshape(-1, *[1] * (values.ndim - 1))
        total = np.add.reduceat(weights * values[self.order], self.starts)
        return total / np.add.reduceat(weights, self.starts)

    def mean(self, values, weights):
        """Weighted mean of each sample's group, (n, ...), or the mean of all samples."""
        if self.index is None:
            return values.mean(axis=0)
        return self.sums(values, weights)[self.index]


def pack(arm):
    return np.concatenate([getattr(arm, name) for name in FIELDS])


def unpack(arm, x):
    n = arm.n_joints
    return arm.replace(
        a=x[:n],
        alpha=x[n : 2 * n],
        d=x[2 * n : 3 * n],
        theta_offset=x[3 * n : 4 * n],
        probe=x[4 * n : 4 * n + 3],
    )


def align(points, target):
    """Rotation and shift that take points to target with the least squares of what is left."""
    centre, target_centre = points.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((target - target_centre).T @ (points - centre))
    rotation = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ vt))]) @ vt
    return rotation, target_centre - rotation @ centre


def left_jacobian(rotvec):
    """Rotation that a small change of a rotation vector adds on the left, (3, 3)."""
    angle = np.linalg.norm(rotvec)
    x, y, z = rotvec
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    if angle < 1e-6:
        return np.eye(3) + cross / 2
    return (
        np.eye(3)
        + (1 - np.cos(angle)) / angle**2 * cross
        + (angle - np.sin(angle)) / angle**3 * cross @ cross
    )
