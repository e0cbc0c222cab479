"""Where gravity points, where the data show that it is not where the arm says.

The columns of gravity are linear in the direction, so that of all other columns, eliminated once at
the variances of a fit, few products of gravity's columns along x, y and z are left: the evidence of
any direction follows from these.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from sklearn_raacmm.arm import axis_vectors
from sklearn_raacmm.error_model._columns import LOAD, columns_of
from sklearn_raacmm.error_model._sums import explicit_gram, less_constants, motions_of
from sklearn_raacmm.inference import root_of
from sklearn_raacmm.utils import stage

# Poses of which a direction is found at most: more take time and turn it by less than a degree.
_ENOUGH = 600
# Log evidence that another direction has to add, in nats: of upright arms, real and simulated, it
# came to at most 10; of those inclined by 45 degrees or on a wall to at least 135. Cosine of 2
# degrees: gravity's columns change by less than 4 % (``benchmarks/bench_after_the_lab.py mounts``).
_PRICE, _NEAR = 20.0, np.cos(np.deg2rad(2))
# Where the fit leaves less than this share of the residuals there is nothing to be gained.
_NOTHING_LEFT = 1e-3
# Variances of gravity's columns that are compared, in square arc seconds.
_VARIANCES = 10.0 ** np.arange(-4.0, 6.5, 0.5)
# Directions that are compared, on a spiral over half a sphere, for opposite ones count as the same.
# From the best one the search goes in steps that begin and end at these angles, rad.
_HEIGHT = (np.arange(48) + 0.5) / 48
_TURN = np.pi * (1 + 5**0.5) * 48 * _HEIGHT
_DIRECTIONS = np.column_stack([np.cos(_TURN), np.sin(_TURN), np.zeros(48)])
_DIRECTIONS = np.sqrt(1 - _HEIGHT**2)[:, None] * _DIRECTIONS + np.outer(_HEIGHT, [0, 0, 1])
_FIRST_STEP, _LAST_STEP = 0.2, 0.002
_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@stage("direction of gravity")
def better_vertical(fitted):
    """A direction against gravity of higher evidence than that of a fit, or ().

    Harmonics and variances of the fit stay, but that of gravity. To turn the direction round
    changes signs only: of both the one is taken along which the arm gives way.
    """
    rows, state = fitted.rows.weighted(fitted.pose_weight), fitted.state
    # Gravity along another direction looks like noise of the joints.
    rows = rows._replace(root=rows.shown)
    size = np.square(fitted.rows.y).mean()
    if size == 0 or state.noise_variance < _NOTHING_LEFT**2 * size:
        return ()
    if len(rows.X) > _ENOUGH:
        rows = rows.at(np.arange(0, len(rows.X), -(-len(rows.X) // _ENOUGH)))
    few = fitted.columns.with_harmonics(fitted.columns.terms.harmonics[state.pairs])
    loads = np.flatnonzero(few.table["kind"] == LOAD)
    if rows.y.shape[1] * len(np.unique(rows.X, axis=0)) < len(loads):
        return ()  # along any direction so many columns explain so few poses
    left = _left_of_gravity(rows, few, loads, state)

    def evidence(up):
        return _evidence_and_coef(up, *left)[0]

    stated, price = few.up, 0.0 if few.terms.up else _PRICE  # one that has paid is made better
    up = max([stated, *_DIRECTIONS], key=evidence)
    across = _FIRST_STEP * np.linalg.svd(up[None])[2][1:]

    def turned(two):
        there = up + two @ across
        return there / np.linalg.norm(there)

    simplex = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {"initial_simplex": simplex, "xatol": _LAST_STEP / _FIRST_STEP, "fatol": 0.01}
    up = turned(
        minimize(lambda two: -evidence(turned(two)), simplex[0], method="Nelder-Mead",
                 options=options).x
    )  # fmt: skip
    higher, coef = _evidence_and_coef(up, *left)
    if higher - evidence(stated) < price:
        return ()
    # A probe sags, whatever the pose: the arm measures it above where it is.
    columns = columns_of(rows.arm, few.terms._replace(up=tuple(up.tolist())))
    above = columns.at(rows.X)[:, :, loads] @ coef
    upright = columns.upright(axis_vectors(rows.arm, rows.X[:, : rows.arm.n_joints])[0])
    up = up * np.sign((above * upright).sum())
    return () if stated @ up > _NEAR else tuple(up.tolist())


def _left_of_gravity(rows, columns, loads, state):
    """What the other columns leave of those of gravity: products (3, L, 3, L), and (3, L) with y.

    Of the L columns `loads` along x, y and z each, over the noise variance. The others stay as the
    fit has them, even if they depend on the vertical.
    """
    axes = [columns_of(rows.arm, columns.terms._replace(up=axis)).alone for axis in _AXES]
    n, size, n_waves = len(columns.table), len(loads), columns.n_waves

    def columns_at(X):
        of_gravity = [axis.at(X)[:, :, loads - n_waves] for axis in axes]
        return np.concatenate([columns.at(X), *of_gravity], axis=2)

    gram = less_constants(*explicit_gram(rows, columns_at)[:2])
    if rows.codes is not None and not rows.known and columns.terms.kinematics:
        motions = motions_of(columns.alone)
        keep = np.eye(len(gram))
        keep[n_waves:n, n_waves:n] -= motions @ motions.T
        gram = keep @ gram @ keep
    gram /= state.noise_variance
    rest = np.setdiff1d(np.arange(n), loads)
    of_axes = np.arange(n, n + 3 * size + 1)  # and y
    S = gram[np.ix_(rest, rest)]
    S[np.diag_indices(len(S))] += 1 / np.roll(state.prior, n_waves)[rest]
    beside = gram[np.ix_(rest, of_axes)]
    beside = solve_triangular(root_of(S), beside, trans="T", check_finite=False)
    left = gram[np.ix_(of_axes, of_axes)] - beside.T @ beside
    return left[:-1, :-1].reshape(3, size, 3, size), left[:-1, -1].reshape(3, size)


def _evidence_and_coef(up, products, moments):
    """Log evidence of gravity along a direction, at its best variance, and the coefficients.

    With S the products along it and r those with y that is ``v r' inv(I + v S) r / 2 - log det(I +
    v S) / 2`` at the variance v.
    """
    value, vectors = np.linalg.eigh(np.einsum("a,aibj,b->ij", up, products, up))
    value, r = np.maximum(value, 0.0), up @ moments @ vectors
    v = _VARIANCES[:, None]
    evidence = 0.5 * (v * np.square(r) / (1 + v * value) - np.log1p(v * value)).sum(axis=1)
    best = np.argmax(evidence)
    v = _VARIANCES[best]
    return float(evidence[best]), vectors @ (v * r / (1 + v * value))
