"""The fit of the linear error model, from arrays to a `LinearModel`."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from sklearn_raacmm.arm import points_of
from sklearn_raacmm.error_model._block_selection import select_blocks
from sklearn_raacmm.error_model._columns import (
    FAMILIES,
    HARMONIC,
    Terms,
    scale_direction,
    term_names,
)
from sklearn_raacmm.error_model._linear_model import LinearModel
from sklearn_raacmm.error_model._normal_equations import (
    length_equations,
    mean_columns,
    normal_equations,
)
from sklearn_raacmm.utils import centred, group_means

# Columns that move the arm as a whole: the first axis stands still in the base.
BASE_MOTIONS = ("d1", "theta_offset1", "base_x", "base_y", "base_alpha", "base_beta")
# Farther off than this, in standard deviations of a coordinate, a pose has no weight: of normal
# errors in space one in 200 000 is. The median distance of such errors; rounds; when to stop.
_OUTLIER = 5.5
_MEDIAN_OF_CHI3 = 1.5382
_ROBUST_ROUNDS = 4
_SETTLED_WEIGHT = 0.05


class LinearOptions(NamedTuple):
    """Options of the fit, as :class:`JointHarmonicRegressor` explains them."""

    n_harmonics: int
    gravity: bool
    kinematics: bool
    wobble: bool
    prior_sd: float | str
    loss: str

    @classmethod
    def of(cls, estimator):
        """Read the options from the parameters of a `JointHarmonicRegressor`."""
        return cls(*(getattr(estimator, name) for name in cls._fields))


def fit_linear_model(arm, X, y, weights, codes, lengths, options):
    """Fit the model, and fit it again without the poses that are too far off.

    Parameters
    ----------
    arm : Arm
    X : ndarray of shape (n, n_joints)
        Angles in rad.
    y : ndarray of shape (n, 3)
        Residuals in mm.
    weights : ndarray of shape (n,)
    codes : ndarray of shape (n,) or None
        Position of each row, from 0, where positions have unknown offsets.
    lengths : list of (int, int, float, float)
        Two positions, their known distance and its standard deviation, mm.
    options : LinearOptions

    Returns
    -------
    model : LinearModel
    pose_weight : ndarray of shape (n,)
        What the loss left of the weight of each row: 0 for outliers.

    Raises
    ------
    ValueError
        If the options leave no columns.
    """
    factor = np.ones(len(y))
    for rounds_left in range(_ROBUST_ROUNDS, -1, -1):
        model = _fit_weighted(arm, X, y, weights * factor, codes, lengths, options)
        if options.loss == "squared" or not rounds_left:
            break
        left = y - model.predict(X)[0]
        distance = np.linalg.norm(centred(left, codes, weights * factor), axis=1)
        scale = quantile(distance, 0.5, weights) / _MEDIAN_OF_CHI3
        share = np.square(distance / max(_OUTLIER * scale, 1e-300))
        new = np.square(np.maximum(1 - share, 0.0))
        far = np.any((share >= 1) & (weights > 0))
        settled = np.abs(new - factor).max() < _SETTLED_WEIGHT
        if not scale > 0 or settled or (rounds_left == _ROBUST_ROUNDS and not far):
            break
        factor = new
    return model, factor


def _fit_weighted(arm, X, y, weights, codes, lengths, options):
    kept = weights > 0
    X, y, weights = X[kept], y[kept], weights[kept]
    offsets = codes is not None
    if offsets:
        present, codes = np.unique(codes[kept], return_inverse=True)
        codes = codes.ravel()
        place = {code: i for i, code in enumerate(present.tolist())}
        lengths = [
            (place[i], place[j], *rest) for i, j, *rest in lengths if i in place and j in place
        ]
    offered = np.array(
        [(j, k) for j in range(arm.n_joints) for k in range(1, options.n_harmonics + 1)], dtype=int
    ).reshape(-1, 2)
    terms = Terms(offered, options.gravity, options.kinematics, options.wobble)
    names, of_term = term_names(arm, terms)
    if not len(offered) and not names:
        raise ValueError(
            "The model has no columns: n_harmonics is 0 and gravity, kinematics and wobble are "
            "all False."
        )
    equations = normal_equations(arm, X, y, weights, codes, terms)
    n_pairs = len(offered)
    blocks = [np.array([2 * i, 2 * i + 1]) for i in range(n_pairs)]
    families = np.unique(of_term)
    blocks += [2 * n_pairs + np.flatnonzero(of_term == f) for f in families]
    family = np.r_[np.full(n_pairs, HARMONIC), families]
    prior_variance = np.full(len(FAMILIES), np.nan)
    if not isinstance(options.prior_sd, str):
        prior_variance[HARMONIC] = options.prior_sd**2
    found = select_blocks(
        equations.gram,
        equations.moment,
        equations.square,
        equations.n_observations,
        blocks,
        family,
        np.arange(len(blocks)) >= n_pairs,
        prior_variance,
        length_equations(arm, X, weights, codes, terms, lengths) if lengths else None,
    )
    present = {HARMONIC, *of_term.tolist()} if n_pairs else set(of_term.tolist())
    model = _model_of(arm, terms, found, offsets, sorted(present))
    return constrained(model, X, weights, codes, keep_scale=not lengths)


def constrained(model, X, weights, codes, keep_scale=True):
    """Model without what positions with offsets cannot show: the scale, and where the base stands.

    Parameters
    ----------
    model : LinearModel
    X : ndarray of shape (n, n_joints)
        Training poses.
    weights : ndarray of shape (n,)
    codes : ndarray of shape (n,) or None
        Position of each row, from 0; None where positions have no offsets.
    keep_scale : bool, default=True
        Whether no known lengths show the scale.

    Returns
    -------
    LinearModel
        The same one where positions have no offsets or it has no columns of the kinematics.
    """
    if codes is None or not model.terms.kinematics:
        return model
    columns = mean_columns(model.arm, X, weights, codes, model.terms)
    if keep_scale:
        model = _keep_scale(model, columns, group_means(points_of(model.arm, X), codes, weights))
    return _without_gauge(model, columns)


def _model_of(arm, offered, found, offsets, families):
    """Value of a posterior, with columns in the order harmonics, other terms."""
    n_pairs = len(offered.harmonics)
    order = np.argsort(found.columns, kind="stable")
    chosen = np.array([block for block in found.blocks if block < n_pairs], dtype=int)
    by_column = np.argsort(chosen, kind="stable")
    half = solve_triangular(found.root, np.eye(len(order)), check_finite=False)[order]
    return LinearModel(
        arm=arm,
        terms=offered._replace(harmonics=offered.harmonics[chosen[by_column]]),
        coef=found.coef[order],
        half=half,
        noise_variance=float(found.noise_variance),
        prior_sd={FAMILIES[f]: float(np.sqrt(found.prior_variance[f])) for f in families},
        offsets=offsets,
        n_determined=float(found.n_determined),
        log_bayes_factor=np.asarray(found.gains, dtype=float)[by_column],
        gauge_free_half=half,
    )


def _keep_scale(model, columns, points):
    """Leave the distances between positions as the calibration has them, on the average.

    Positions with offsets do not show a common scale of all lengths, and whatever the prior
    makes of it would be an error in proportion to every length. `columns` and `points` are means
    over the positions.
    """
    spread = points - points.mean(axis=0)
    size = np.square(spread).sum()
    if not size > 0:
        return model
    scale_of = np.einsum("gc,gcp->p", spread, columns) / size
    unit = scale_direction(model.arm, model.terms)
    return replace(
        model,
        coef=model.coef - unit * (scale_of @ model.coef),
        half=model.half - np.outer(unit, scale_of @ model.half),
    )


def _without_gauge(model, columns):
    """Take motions of the base out of the covariance that predictions are judged by.

    A single-point test does not show where the base stands: along the six columns that move it the
    posterior is the prior, and other columns imitate a motion at the positions of the test. With M
    the mean columns over the positions and B the six of them, ``G = lstsq(B, M)`` is the motion in
    every column, and ``A - A[:, base] @ G`` are the columns without it (inner constraints).
    """
    names, _ = term_names(model.arm, model.terms)
    n_waves = 2 * len(model.terms.harmonics)
    base = [n_waves + names.index(name) for name in BASE_MOTIONS]
    flat = columns.reshape(-1, columns.shape[2])
    motion = np.linalg.lstsq(flat[:, base], flat, rcond=1e-9)[0]
    half = model.half.copy()
    half[base] -= motion @ model.half
    return replace(model, gauge_free_half=half)


def quantile(values, share, weights):
    """Least of the values below or at which lies this share of the weights."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(below, share * below[-1] * (1 - 1e-12))]])
