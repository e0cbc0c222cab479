"""Normal equations of the linear error model: sums over poses, without holding the columns."""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from sklearn_raacmm.arm import points_of
from sklearn_raacmm.error_model._columns import term_columns
from sklearn_raacmm.utils import chunks, group_means, group_sums, group_weights

# Poses whose columns are held at a time: 12 MB for 1000 columns.
_CHUNK = 512


class Smooth(NamedTuple):
    """A smooth error beside the linear model, in the cylindrical frame of the probe's azimuth.

    basis : callable
        From angles (n, n_joints) to an orthonormal basis of its prior (n, k): each component is
        ``basis @ u`` with u normal of variance 1 / alpha, in units of the noise.
    alpha : ndarray of shape (3,)
    """

    basis: object
    alpha: np.ndarray


class NormalEquations(NamedTuple):
    gram: np.ndarray  # (p, p)
    moment: np.ndarray  # (p,)
    square: float
    n_observations: float  # coordinates, less those that offsets spent


def normal_equations(arm, angles, y, weights, codes, terms, smooth=None):
    """Sum up ``A.T @ C @ A`` and ``A.T @ C @ y`` for the columns A of the model.

    C weighs the rows, takes the mean out of every group (one free offset per position: exact for
    a linear model, by the Frisch-Waugh theorem) and, with `smooth`, is the inverse covariance of
    noise and smooth error together (generalised least squares).

    Parameters
    ----------
    arm : Arm
    angles : ndarray of shape (n, n_joints)
    y : ndarray of shape (n, 3)
    weights : ndarray of shape (n,)
    codes : ndarray of shape (n,) or None
        Group of each row, from 0; None for no offsets.
    terms : Terms
    smooth : Smooth, optional

    Returns
    -------
    NormalEquations
    """
    n_groups = 0 if codes is None else codes.max() + 1
    sums, basis_sums, squares, shared, own = 0.0, 0.0, 0.0, None, None
    for rows in chunks(len(angles), _CHUNK):
        vectors = term_columns(arm, angles[rows], terms)
        vectors = np.concatenate([vectors, y[rows, :, None]], axis=2)
        if smooth is not None:
            x, y, _ = points_of(arm, angles[rows]).T
            azimuth = np.arctan2(y, x)
            vectors = _turned(vectors, azimuth)
            basis = smooth.basis(angles[rows])
        weight = weights[rows]
        rooted = (np.sqrt(weight)[:, None, None] * vectors).reshape(-1, vectors.shape[2])
        squares = squares + rooted.T @ rooted
        if smooth is not None:
            weighted = weight[:, None] * basis
            cross_part = np.einsum("nk,ncp->ckp", weighted, vectors, optimize=True)
            shared = cross_part if shared is None else shared + cross_part
            own = basis.T @ weighted if own is None else own + basis.T @ weighted
        if n_groups:
            sums = sums + group_sums(vectors, codes[rows], weight, n_groups)
            if smooth is not None:
                basis_sums = basis_sums + group_sums(basis, codes[rows], weight, n_groups)
    if n_groups:
        total = group_weights(codes, weights, n_groups)
        rooted = (sums / np.sqrt(total)[:, None, None]).reshape(-1, sums.shape[2])
        squares -= rooted.T @ rooted
        if smooth is not None:
            mean = basis_sums / total[:, None]
            shared -= np.einsum("gk,gcp->ckp", mean, sums, optimize=True)
            own -= mean.T @ basis_sums
    if smooth is not None:
        for component, alpha in enumerate(smooth.alpha):
            if not np.isfinite(alpha):
                continue  # a component without a smooth part
            factor = cho_factor(own + alpha * np.eye(len(own)), lower=True)
            squares -= shared[component].T @ cho_solve(factor, shared[component])
    return NormalEquations(
        squares[:-1, :-1],
        squares[:-1, -1],
        float(max(squares[-1, -1], 0.0)),
        3.0 * (weights.sum() - n_groups),
    )


def mean_columns(arm, angles, weights, codes, terms):
    """Mean of the model's columns over each position, (n_positions, 3, n_columns)."""
    total = group_weights(codes, weights)
    sums = 0.0
    for rows in chunks(len(angles), _CHUNK):
        columns = term_columns(arm, angles[rows], terms)
        sums = sums + group_sums(columns, codes[rows], weights[rows], len(total))
    return sums / total[:, None, None]


class Lengths(NamedTuple):
    """Known lengths as observations of the coefficients w: ``rows @ w`` is `errors` and noise."""

    rows: np.ndarray  # (n_lengths, p)
    errors: np.ndarray  # (n_lengths,) measured less known length, mm
    variance: np.ndarray  # (n_lengths,) of the known length, mm^2
    share: np.ndarray  # (n_lengths,) of the noise variance that the two mean points keep


def length_equations(arm, angles, weights, codes, terms, lengths):
    """Known lengths between positions as rows of the linear model.

    The mean points of two positions, corrected, are a known length apart: the difference of their
    corrections along the line between them is what the measured length is too long.

    Parameters
    ----------
    arm, angles, weights, codes, terms
        As :func:`normal_equations`.
    lengths : list of (int, int, float, float)
        Two positions, their known distance and its standard deviation, mm.

    Returns
    -------
    Lengths
    """
    first, second, length, sd = (np.array(part) for part in zip(*lengths, strict=True))
    used, ends = np.unique([first, second], return_inverse=True)
    ends = ends.reshape(2, -1)
    rows = np.isin(codes, used)
    angles, weights, codes = angles[rows], weights[rows], np.searchsorted(used, codes[rows])
    total = group_weights(codes, weights)
    points = group_means(points_of(arm, angles), codes, weights)
    columns = mean_columns(arm, angles, weights, codes, terms)
    line = points[ends[1]] - points[ends[0]]
    measured = np.linalg.norm(line, axis=1)
    line /= measured[:, None]
    difference = columns[ends[1]] - columns[ends[0]]
    return Lengths(
        np.einsum("lc,lcp->lp", line, difference),
        measured - length,
        np.square(sd),
        1 / total[ends[0]] + 1 / total[ends[1]],
    )


def _turned(vectors, azimuth):
    """Columns (n, 3, p) in the cylindrical frame."""
    cos, sin = np.cos(azimuth)[:, None], np.sin(azimuth)[:, None]
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.stack([x * cos + y * sin, y * cos - x * sin, z], axis=1)
