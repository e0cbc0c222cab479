r"""Sums over poses for the harmonics of every joint, many orders at once.

The columns of a harmonic of joint j are :math:`T_j \cos k\theta_j` and :math:`T_j \sin k\theta_j`,
with :math:`T_j` the joint's column of the Jacobian. All orders share :math:`T_j`, so that the inner
products with any other columns R need two steps: the contraction :math:`s = w\, T_j \cdot R` over
x, y and z, and the sums :math:`\sum_n s_n \exp(i k \theta_n)` for all orders k.

Of the Gram matrix of all candidates only the 2 x 2 blocks on its diagonal are summed up beforehand,
and the rows of those candidates that the choice asks for.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any, NamedTuple

import numpy as np

from sklearn_raacmm.error_model._columns import observed_columns
from sklearn_raacmm.inference import GramRows, Sums
from sklearn_raacmm.utils import chunk_size, chunks

# Poses whose waves are held at a time: 7 MB for 400 orders of one joint.
_CHUNK = 1024
# Divides the sums of positions without weight.
_TINY = 1e-300


def candidate_sums(arm, angles, y, weights, codes, offered, terms, turn_mm=0.0, known=0.0):
    """Sum up what the choice of harmonics needs, as `Sums`.

    `offered` (n_pairs, 2) are the candidates, joint from 0 and order, sorted by joint; the first
    column of a pair is the cosine. `terms` are the columns that are always in. Offsets of the
    positions `codes` are taken out exactly, by deviations from weighted means (Frisch-Waugh
    theorem); `known`, the noise variance over that of the offsets, draws them to 0 as rows of this
    weight would. Without offsets `weights` may be negative changes.
    """
    poses = _sorted_poses(angles, y, weights, codes, known)
    spans = _joint_spans(offered)
    n_joints = len(arm.a)
    every_turn = np.column_stack([np.arange(n_joints), np.zeros(n_joints, int)])
    terms = terms._replace(harmonics=every_turn)
    turns = np.empty((*y.shape, n_joints))
    own = np.zeros((3, len(offered)))
    gram: Any = 0.0
    cross: Any = 0.0
    for rows, starts in poses.parts:
        columns = observed_columns(arm, poses.angles[rows], terms, turn_mm)
        turns[rows] = columns[:, :, : 2 * n_joints : 2]  # the cosines of order 0
        columns = np.concatenate([columns[:, :, 2 * n_joints :], poses.y[rows, :, None]], axis=2)
        weighted = _weighted_deviations(columns, poses.weights[rows], starts, known)
        flat = columns.reshape(-1, columns.shape[2])
        gram = gram + flat.T @ weighted.reshape(flat.shape)
        shares = [np.einsum("ncm,nc->nm", weighted, turns[rows, :, j]) for j, *_ in spans]
        cross = cross + _products(shares, poses.angles[rows], spans, len(gram))
        own += _own_blocks(
            turns[rows], poses.angles[rows], poses.weights[rows], starts, spans, known
        )

    def rows_of(pairs):
        return _gram_rows(poses, turns, spans, offered[pairs])

    n_taken = 0 if known else poses.n_groups
    n_observations = float(y.shape[1]) * (poses.weights.sum() - n_taken)
    return Sums(
        gram[:-1, :-1],
        gram[:-1, -1],
        cross[:-1],
        own,
        cross[-1],
        float(gram[-1, -1] if codes is None else max(gram[-1, -1], 0.0)),
        n_observations if codes is None else max(n_observations, 0.0),
        GramRows(rows_of, 2 * len(offered)),
    )


class _Poses(NamedTuple):
    """Poses sorted by position, in chunks of whole positions."""

    angles: np.ndarray
    y: np.ndarray
    weights: np.ndarray
    parts: list  # (rows, first row of each position in the chunk or None)
    n_groups: int
    known: float  # weight by which offsets are drawn to 0


def _sorted_poses(angles, y, weights, codes, known):
    """Whole positions stay together, so that a chunk knows the means that it takes out."""
    if codes is None:
        parts = [(rows, None) for rows in chunks(len(angles), _CHUNK)]
        return _Poses(angles, y, weights, parts, 0, known)
    order = np.argsort(codes, kind="stable")
    first = np.flatnonzero(np.diff(codes[order], prepend=-1))
    ends, parts, begin = np.append(first[1:], len(angles)), [], 0
    limit = chunk_size(_CHUNK)
    for i, end in enumerate(ends):
        last = i + 1 == len(ends)
        if last or ends[i + 1] - first[begin] > limit:
            parts.append((slice(first[begin], end), first[begin : i + 1] - first[begin]))
            begin = i + 1
    return _Poses(angles[order], y[order], weights[order], parts, len(first), known)


def _joint_spans(offered):
    """(joint, orders, columns) for each joint with candidates."""
    joints = offered[:, 0]
    if np.any(np.diff(joints) < 0):
        raise ValueError("The harmonics offered must be sorted by joint.")
    spans = []
    for joint in np.unique(joints).tolist():
        low, high = np.searchsorted(joints, [joint, joint + 1])
        spans.append((joint, offered[low:high, 1], slice(low, high)))
    return spans


def _weighted_deviations(columns, weights, starts, known):
    """Weights times deviations from the position's mean: one side of a product is enough."""
    weighted = weights[:, None, None] * columns
    if starts is not None:
        total = np.maximum(np.add.reduceat(weights, starts) + known, _TINY)[:, None, None]
        mean = np.add.reduceat(weighted, starts, axis=0) / total
        counts = np.diff(starts, append=len(weights))
        weighted -= weights[:, None, None] * np.repeat(mean, counts, axis=0)
    return weighted


def _products(shares, angles, spans, m):
    """Inner products (m, 2 n_pairs) of columns with all candidates, by their shares (n, m)."""
    found = [np.empty((m, 0))]
    for share, (joint, orders, _) in zip(shares, spans, strict=True):
        found.append(share.T @ waves(angles[:, joint], orders).view(float))
    return np.concatenate(found, axis=1)


def _own_blocks(turns, angles, weights, starts, spans, known):
    """cos'cos, sin'sin and cos'sin of each candidate, (3, n_pairs)."""
    out = np.empty((3, sum(len(orders) for _, orders, _ in spans)))
    for joint, orders, pairs in spans:
        turn, theta = turns[:, :, joint], angles[:, joint]
        size = weights * np.square(turn).sum(axis=1)
        wave = waves(theta, orders)
        double = size @ np.square(wave)
        cc, ss = 0.5 * (size.sum() + double.real), 0.5 * (size.sum() - double.real)
        cs = 0.5 * double.imag
        if starts is not None:
            total = np.maximum(np.add.reduceat(weights, starts) + known, _TINY)
            for component in range(turn.shape[1]):
                sums = np.add.reduceat((weights * turn[:, component])[:, None] * wave, starts)
                sums /= np.sqrt(total)[:, None]
                cc -= np.square(sums.real).sum(axis=0)
                ss -= np.square(sums.imag).sum(axis=0)
                cs -= (sums.real * sums.imag).sum(axis=0)
        out[:, pairs] = cc, ss, cs
    return out


def _gram_rows(poses, turns, spans, pairs):
    """Inner products of the columns of some pairs with all candidates, (2 b, 2 n_pairs)."""
    found: Any = 0.0
    (joints, order), twice = pairs.T, np.repeat(pairs[:, 0], 2)
    for rows, starts in poses.parts:
        angles, turn, weights = poses.angles[rows], turns[rows], poses.weights[rows]
        phase = order * angles[:, joints]
        wave = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(phase), -1)
        columns = None
        if starts is not None:
            columns = turn[:, :, twice] * wave[:, None]
            columns = _weighted_deviations(columns, weights, starts, poses.known)
        shares = []
        for joint, _, _ in spans:
            if columns is None:  # the turns of the joints alone are contracted
                along = np.einsum("ncj,nc->nj", turn, weights[:, None] * turn[:, :, joint])
                shares.append(np.take(along, twice, axis=1) * wave)
            else:
                shares.append(np.einsum("ncm,nc->nm", columns, turn[:, :, joint]))
        found = found + _products(shares, angles, spans, 2 * len(pairs))
    return found


def waves(theta, orders):
    """exp(i k theta), (n, n_orders) complex; orders 1 to K by doubling, those beyond one by one."""
    n = np.count_nonzero(orders == np.arange(1, len(orders) + 1))
    out: Any = np.empty((len(theta), len(orders)), dtype=complex)
    if n:
        out[:, 0] = np.exp(1j * theta)
    have = 1
    while have < n:
        more = min(have, n - have)
        np.multiply(out[:, :more], out[:, have - 1 : have], out=out[:, have : have + more])
        have += more
    if n < len(orders):
        phase = theta[:, None] * orders[n:]
        np.cos(phase, out=out.real[:, n:])
        np.sin(phase, out=out.imag[:, n:])
    return out
