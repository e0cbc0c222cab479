"""What positions do not show: motions of the base, the scale, and fields that depend on the place.

A single-point test compares poses that reach one point. It shows nothing of a motion of the base,
of a common scale of all lengths, or of a base that bends under the arm's load: they move all poses
that reach a point by the same vector. Known lengths between positions show a part of it.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import qr

from sklearn_raacmm.arm import Arm, points_of
from sklearn_raacmm.error_model._columns import (
    LOAD,
    Terms,
    other_columns,
    points_of_rows,
    scale_direction,
    term_columns,
    term_names,
    vertical,
)
from sklearn_raacmm.inference import Extra
from sklearn_raacmm.utils import chunks, group_means, group_sums

# Columns that move the arm as a whole, the first axis standing still in the base.
_BASE_MOTIONS = ("d1", "theta_offset1", "base_x", "base_y", "base_alpha", "base_beta")
# Poses whose columns are held at a time: 60 MB for all harmonics of six joints up to order 400.
_CHUNK = 512
# Part of the difference of two roots that is rounding.
_ROUNDING = 1e-12
# Poses at which fields are compared with columns: three equations each, for some 200 columns.
_POSES = 150
# Share of a field that columns may leave for it to be one of theirs: bending about the second
# joint's axis is one only nearly.
_LEFT = 0.01
# A combination of fields that moves the positions by less than this share of what the one that is
# shown best does stays in the standard deviations (``benchmarks/bench_few_poses.py``).
_LEAST_SHOWN = 0.05
# Standard deviation of how much the base gives way over that of joints and links, where positions
# do not show it (``benchmarks/bench_acceptance.py predict --first 200 --arms 46``).
_BASE = 0.3
# Size of a column, relative to the largest, that moves nothing.
_NOTHING = 1e-6


def without_motions(sums, arm, terms):
    """Sums that know nothing of a motion of the base and of a common scale of all lengths.

    To first order in the errors a single-point test shows neither. Of its deviations, which a scale
    multiplies, the evidence would prefer an arm of no size.
    """
    if not terms.kinematics:
        return sums
    terms = terms._replace(harmonics=np.empty((0, 2), dtype=int))
    names, _ = term_names(arm, terms)
    # The latter come before the first joint.
    moving = [*_BASE_MOTIONS, *["a1", "alpha1", "beta1"] * (arm.convention == "modified")]
    columns = np.eye(len(names))[:, [names.index(name) for name in moving]]
    motions = np.linalg.qr(np.column_stack([columns, scale_direction(arm, terms)]))[0]
    keep = np.eye(len(motions)) - motions @ motions.T
    return sums._replace(
        gram=keep @ sums.gram @ keep, moment=keep @ sums.moment, cross=keep @ sums.cross
    )


def length_equations(arm, angles, weights, codes, terms, lengths):
    """Known lengths between positions as rows of the linear model, an `Extra`.

    The difference of the corrections of two positions along the line between them is what the
    measured length is too long. `lengths` hold two positions, their distance and its standard
    deviation, mm.
    """
    first, second, length, sd = (np.array(part) for part in zip(*lengths, strict=True))
    used, ends = np.unique([first, second], return_inverse=True)
    ends = ends.reshape(2, -1)
    rows = np.isin(codes, used)
    angles, weights, codes = angles[rows], weights[rows], np.searchsorted(used, codes[rows])
    total = np.bincount(codes, weights)
    points = group_means(points_of_rows(arm, terms, angles), codes, weights)
    columns = _mean_columns(arm, angles, weights, codes, terms)
    line = points[ends[1]] - points[ends[0]]
    measured = np.linalg.norm(line, axis=1)
    line /= measured[:, None]
    difference = columns[ends[1]] - columns[ends[0]]
    return Extra(
        np.einsum("lc,lcp->lp", line, difference),
        measured - length,
        np.square(sd),
        1 / total[ends[0]] + 1 / total[ends[1]],
    )


def _mean_columns(arm, angles, weights, codes, terms):
    """Mean of the model's columns over each position, (n_positions, 3, n_columns)."""
    total = np.bincount(codes, weights)
    sums = 0.0
    for rows in chunks(len(angles), _CHUNK):
        columns = term_columns(arm, angles[rows], terms)
        sums = sums + group_sums(columns, codes[rows], weights[rows], len(total))
    return sums / total[:, None, None]


def constrained(
    model: Any,
    X: np.ndarray,
    weights: np.ndarray,
    codes: np.ndarray | None,
    keep_scale: bool = True,
) -> Any:
    """Model without what positions with offsets cannot show: the scale, and where the base stands.

    Unless known lengths show the scale, distances between positions stay on the average as the
    calibration has them (an inner constraint, as geodesists have it in free networks).

    Other columns imitate the fields of `place_fields` at the positions of the test. With M the mean
    columns over the positions and F = M W those of the fields W, ``G = lstsq(F, M)`` is the field
    in every column, and ``A - A W G`` are the columns without it: `gauge_free_half` is the root
    with these. Fields that the positions hardly tell from others are left: with few positions G
    would explode.
    """
    if codes is None:
        return model
    arm, terms = model.arm, model.terms
    columns = _mean_columns(arm, X, weights, codes, terms)
    if terms.kinematics:
        points = group_means(points_of_rows(arm, terms, X), codes, weights)
        spread = points - points.mean(axis=0)
        size = np.square(spread).sum()
        if size > 0:
            scale_of = np.einsum("gc,gcp->p", spread, columns) / size
            along, unit = scale_of @ model.half, scale_direction(arm, terms)
            if keep_scale:
                coef = model.coef - unit * (scale_of @ model.coef)
                model = replace(model, coef=coef, half=model.half - np.outer(unit, along))
            else:
                model = replace(model, scale_sd=float(np.linalg.norm(along)))
    fields = place_fields(arm, terms)
    half = model.half
    if fields.shape[1]:
        flat = columns.reshape(-1, columns.shape[2])
        half = half - fields @ np.linalg.lstsq(flat @ fields, flat @ half, rcond=_LEAST_SHOWN)[0]
    return replace(model, gauge_free_half=half, fading_half=half)


def unseen_half(model: Any) -> np.ndarray:
    """What positions with offsets do not show, as columns to add to `gauge_free_half`.

    What the posterior has beside it, without the motions of the base: the frame is the arm's own.
    What is left is how the arm gives way as a function of the place.
    """
    unseen, others = model.half - model.gauge_free_half, other_columns(model.arm, model.terms)
    if model.offsets:
        for i, column in enumerate(others):
            if column.name in _BASE_MOTIONS:
                unseen[i - len(others)] = -model.gauge_free_half[i - len(others)]
            elif column.kind == LOAD and column.frame == 0:
                unseen[i - len(others)] *= _BASE
    return unseen


def unseen_variance(model: Any, X: np.ndarray) -> np.ndarray:
    """Variance of each coordinate that positions with offsets do not show, (n, 3), mm^2.

    With G the widened root of what they show and U of what they do not, ``(G + U)(G + U)' - G G'``
    is ``U (2 G + U)'`` but for its order. U is narrow, for few fields differ.
    """
    variance = np.zeros((len(X), 3))
    if not model.offsets:
        return variance
    unseen = unseen_half(model)
    basis, triangle, _ = qr(unseen, mode="economic", pivoting=True, check_finite=False)
    size = np.abs(triangle.diagonal())
    basis = basis[:, size > _ROUNDING * size.max(initial=0.0)]
    other = (2 * model.std_scale * model.gauge_free_half + unseen) @ (unseen.T @ basis)
    for rows in chunks(len(X), _CHUNK):
        columns = model.columns(X[rows])
        columns = columns.reshape(3 * len(columns), len(unseen))
        variance[rows] = ((columns @ basis) * (columns @ other)).sum(axis=1).reshape(-1, 3)
    return np.maximum(variance, 0.0)  # both together may be known better than what is shown alone


def place_fields(arm, terms):
    """Coefficients (n_columns, k) whose effect is the same at all poses that reach a point.

    One column for each field that the model can make, of up to eleven: see `_fields`.
    """
    own = _fields_of_others(arm, terms._replace(harmonics=(), extra=()))
    before, n = 2 * len(terms.harmonics), len(other_columns(arm, terms))
    return np.pad(own, ((before, n - len(own)), (0, 0)))


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
    return flat[:, size > 0] / size[size > 0]


@lru_cache(maxsize=64)
def _fields_of_others(arm: Arm, causes: Terms):
    """The same for the columns that are neither harmonics nor extra."""
    terms = causes._replace(harmonics=np.empty((0, 2), dtype=int))
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSES, arm.n_joints))
    fields = _fields(points_of(arm, angles), vertical(arm, terms))
    columns = term_columns(arm, angles, terms).reshape(len(fields), -1)
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > _NOTHING * size.max(initial=0.0), size, np.inf)
    coef = np.linalg.lstsq(columns / size, fields, rcond=1e-10)[0]
    left = np.linalg.norm(fields - columns / size @ coef, axis=0)
    found = (coef / size[:, None])[:, left < _LEFT]
    found.setflags(write=False)
    return found
