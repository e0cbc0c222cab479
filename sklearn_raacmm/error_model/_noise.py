r"""Noise of each joint's angle, and of the rows themselves, by restricted likelihood.

The noise of a row has the covariance :math:`C = r I + \sum_j v_j J_j J_j'`, with :math:`J_j` what
the angle of joint j does to the probe. With p the residuals times :math:`C^{-1}` and P what
coefficients and unknowns leave of it, a variance is stationary where :math:`v^2 \sum (J'p)^2` is
:math:`v\, \mathrm{tr}(P J J')`: the sum of squares and how many numbers the data determine.
Joints are alike beforehand: see `joint_noise`.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import NamedTuple, Self

import numpy as np

from sklearn_raacmm.inference import evidence_variance
from sklearn_raacmm.utils import stage

# The guess that joints are alike counts as so many observations of each joint's noise.
_COUNTS = 3.0
# Steps of the variances at most, and what they change of the shares in all noise that ends them.
_STEPS, _SETTLED = 200, 1e-4
# Least share of the rows themselves, for J J' has rank 2 at some poses. Least lever, of the largest
# one, of a joint that shows anything. Most that coefficients and unknowns take of a joint's noise.
_LEAST_OF_ROWS, _LEAST_LEVER, _MOST_TAKEN = 0.02, 1e-4, 0.9
_TINY = 1e-300


class Noise(NamedTuple):
    """Noise by where it comes from: it grows with the distance from the joints to the probe."""

    of_joints: np.ndarray  # (n_joints,) variance of each angle, rad^2
    of_rows: float  # variance of a coordinate beside that, mm^2
    lever_mm: (
        np.ndarray
    )  # (n_joints,) root mean square of what a radian of it moves a coordinate by

    @property
    def shares(self) -> np.ndarray:
        """Variances of a coordinate by the joints and by the rows, the mean over poses, mm^2."""
        return np.append(np.square(self.lever_mm) * self.of_joints, self.of_rows)

    def scaled(self, factor: float) -> Self:
        """So many times the variances."""
        return self._replace(of_joints=factor * self.of_joints, of_rows=factor * self.of_rows)

    def roots(self, levers: np.ndarray, shown: np.ndarray | None = None) -> np.ndarray:
        """Inverses (n, 3, 3) of the symmetric roots of the covariances: those of I are I.

        Along the axes that are `shown` (n, 3, 3), rows of zeros among them, where not all are.
        """
        covariance = (self.of_joints * levers) @ levers.swapaxes(1, 2) + self.of_rows * np.eye(3)
        if shown is not None:
            covariance = shown @ covariance @ shown.swapaxes(1, 2) + _beside(shown)
        value, axes = np.linalg.eigh(covariance)
        roots = (axes / np.sqrt(value)[:, None]) @ axes.swapaxes(1, 2)
        return roots if shown is None else roots @ shown


def even_noise(levers: np.ndarray, weights: np.ndarray) -> Noise:
    """Noise of the rows alone, of variance 1, at poses of these `levers` (n, 3, n_joints)."""
    squares = np.einsum("n,ncj->j", weights, np.square(levers)) / (3 * weights.sum())
    return Noise(np.zeros(len(squares)), 1.0, np.sqrt(squares))


def _beside(shown):
    """Ones (n, 3, 3) on the diagonal for the axes along which a row shows nothing."""
    return (1 - np.square(shown).sum(axis=2).round())[:, :, None] * np.eye(3)


@stage("noise of each joint")
def joint_noise(
    left: np.ndarray,
    levers: np.ndarray,
    weights: np.ndarray,
    taken: np.ndarray,
    shown: np.ndarray | None = None,
) -> Noise:
    """The likeliest noise of each joint and of the rows, of which a coordinate has 1 in the mean.

    `left` (n, 3) are residuals in mm, `levers` (n, 3, n_joints) what one radian of each joint does.
    `taken` (n_joints + 1,) are the shares of each noise that the fit has followed. The guess of all
    joints is their harmonic mean, which has the highest likelihood of inverse gamma priors: joints
    without noise stay so beside one that has much of it, and one without lever gets that mean.
    `shown` (n, 3, 3) are the axes along which a row shows something, where that is not all.
    """
    n, _, n_joints = levers.shape
    even, rank, beside = even_noise(levers, weights), 3.0, 0.0
    if shown is not None:
        beside, rank = _beside(shown), np.square(shown).sum(axis=(1, 2))
        left, levers = np.einsum("nij,nj->ni", shown, left), shown @ levers
    size = np.append(np.square(even.lever_mm), 1.0)
    seen = size[:-1] > _LEAST_LEVER**2 * size[:-1].max(initial=0.0)
    scale = np.average(np.square(left).sum(axis=1), weights=weights)
    scale /= np.average(rank + np.zeros(n), weights=weights)
    if not (scale > 0 and seen.any()):
        return even
    # Of each noise the covariance that one of it has at each row, which is the last index; it is
    # symmetric, so that a product of nine numbers is a trace.
    shapes = np.empty((n_joints + 1, 3, 3, n))
    np.einsum("nij,nkj->jikn", levers, levers, out=shapes[:-1])
    others = np.moveaxis(np.broadcast_to(beside, (n, 3, 3)), 0, 2)
    shapes[-1] = np.eye(3)[:, :, None] - others
    flat, left = shapes.reshape(n_joints + 1, -1), left.T / np.sqrt(scale)
    one, other = np.array([1, 2, 0]), np.array([2, 0, 1])
    free = 1 - np.minimum(taken, _MOST_TAKEN)
    v = 0.5 / np.where(np.append(seen, True), size, np.inf)
    v[:-1] /= np.count_nonzero(seen)
    v[:-1][~seen] = v[:-1][seen].mean()
    share = v * size
    for _ in range(_STEPS):
        covariance = (v @ flat).reshape(3, 3, n) + others
        precision = covariance[one][:, one] * covariance[other][:, other]
        precision -= covariance[one][:, other] * covariance[other][:, one]  # its cofactors
        precision /= (covariance[0] * precision[0]).sum(axis=0)
        pull = (precision * left).sum(axis=1)
        squares = flat @ (weights * pull[:, None] * pull).ravel()
        determined = free * (flat @ (weights * precision).ravel())
        guess = float(1 / np.mean(1 / v[:-1]))
        squares, determined = v**2 * squares, v * determined
        v = evidence_variance(squares, np.maximum(determined, _TINY))
        v[:-1] = evidence_variance(squares[:-1], determined[:-1], guess, _COUNTS)
        v[-1] = max(v[-1], _LEAST_OF_ROWS * (v @ size))
        before, share = share, v * size
        if np.abs(share - before).sum() < _SETTLED * share.sum():
            break
    return even._replace(of_joints=v[:-1], of_rows=v[-1]).scaled(float(1 / (v @ size)))
