r"""Sums over poses for the harmonics of every joint, many orders at once.

The columns of a harmonic of joint j are :math:`T_j \cos k\theta_j` and :math:`T_j \sin k\theta_j`,
with :math:`T_j` the joint's column of the Jacobian. All orders share :math:`T_j`, so that the inner
products with any other columns R need two steps: the contraction :math:`s = w\, T_j \cdot R` over
x, y and z, and the product of s with the powers of :math:`\exp(i\theta_j)`. Of the Gram matrix of
all candidates only the 2 x 2 blocks on its diagonal are summed up beforehand, and the rows of those
candidates that the selection asks for.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import NamedTuple

import numpy as np

from sklearn_raacmm.error_model._columns import observed_columns, scale_direction, term_names
from sklearn_raacmm.error_model._wave_sums import WaveSums, sums_of_doubles, waves
from sklearn_raacmm.utils import chunk_size, chunks

# Poses whose waves are held at a time: 7 MB for 400 orders of one joint.
_CHUNK = 1024
# Gram rows summed up together: those of the next best candidates are likely asked for next. At
# most so many at a time: 40 MB of grids for 400 orders of six joints.
_BATCH, _LARGEST_BATCH = 48, 192
# Divides the sums of positions without weight.
_TINY = 1e-300


class CandidateSums(NamedTuple):
    """Inner products of the columns that are always in (A), of the candidates (H) and of y.

    The columns of H are the cosine and the sine of the first pair, then those of the second, and
    so on. Rows have weights; where positions have offsets, all columns are centred per position.
    """

    gram: np.ndarray  # (m, m) A'A
    moment: np.ndarray  # (m,) A'y
    cross: np.ndarray  # (m, 2 n_pairs) A'H
    own: np.ndarray  # (3, n_pairs) cos'cos, sin'sin and cos'sin of each pair
    candidate_moment: np.ndarray  # (2 n_pairs,) H'y
    square: float  # y'y
    n_observations: float  # coordinates, less those that offsets spent
    rows: object  # callable: (pairs, likely, beside) to rows of H'H, see `_GramRows`


def candidate_sums(arm, angles, y, weights, codes, offered, terms, turn_mm=0.0):
    """Sum up what the selection of harmonics needs.

    Parameters
    ----------
    arm : Arm
    angles : ndarray of shape (n, n_joints)
        In rad.
    y : ndarray of shape (n, 3) or (n, 6)
        Residuals in mm; then those of the orientation in rad times `turn_mm`.
    weights : ndarray of shape (n,)
        Where positions have no offsets also changes of weights, which may be negative.
    codes : ndarray of shape (n,) or None
        Position of each row, from 0, where positions have offsets. Offsets are taken out exactly,
        by the deviations from weighted means (Frisch-Waugh theorem).
    offered : ndarray of shape (n_pairs, 2)
        Joint from 0 and order of each candidate, sorted by joint.
    terms : Terms
        The columns that are always in; its harmonics are not used.
    turn_mm : float, default=0
        See :func:`observed_columns`.

    Returns
    -------
    CandidateSums
    """
    poses = _sorted_poses(angles, y, weights, codes)
    spans = _joint_spans(offered)
    every_turn = np.column_stack([np.arange(arm.n_joints), np.zeros(arm.n_joints, int)])
    terms = terms._replace(harmonics=every_turn)
    n_turns = 2 * arm.n_joints
    turns = np.empty((*y.shape, arm.n_joints))
    gram, own, cross = 0.0, np.zeros((3, len(offered))), _sums_of_joints(spans, len(y))
    for rows, starts in poses.parts:
        columns = observed_columns(arm, poses.angles[rows], terms, turn_mm)
        turns[rows] = columns[:, :, :n_turns:2]  # the cosines of order 0
        columns = np.concatenate([columns[:, :, n_turns:], poses.y[rows, :, None]], axis=2)
        weighted = _weighted_deviations(columns, poses.weights[rows], starts)
        flat = columns.reshape(-1, columns.shape[2])
        gram = gram + flat.T @ weighted.reshape(flat.shape)
        _add_products(cross, spans, poses.angles[rows], _shares(weighted, turns[rows]))
        own += _own_blocks(turns[rows], poses.angles[rows], poses.weights[rows], starts, spans)

    cross = _products(cross, len(gram))

    def rows_of(pairs):
        return _rows_in_batches(poses, turns, spans, offered[pairs])

    sums = CandidateSums(
        gram[:-1, :-1],
        gram[:-1, -1],
        cross[:-1],
        own,
        cross[-1],
        float(gram[-1, -1] if codes is None else max(gram[-1, -1], 0.0)),
        float(y.shape[1]) * (poses.weights.sum() - poses.n_groups),
        _GramRows(rows_of, 2 * len(offered)),
    )
    return sums if codes is None else _without_motions(sums, arm, terms)


def sums_of_the_others(parts):
    """Sums over all parts but one, for each of them.

    Every product is summed up over the poses once, however many parts there are.

    Parameters
    ----------
    parts : list of CandidateSums
        Over disjoint poses, of the same columns; where positions have offsets, of whole positions.

    Returns
    -------
    list of CandidateSums
    """
    whole = [sum(products) for products in zip(*(part[:-1] for part in parts), strict=True)]

    every = _GramRows(lambda pairs: _sum_of_rows(parts, pairs), parts[0].cross.shape[1])
    found = []
    for part in parts:

        def rows(pairs, likely=(), beside=None, part=part):
            whole = every(pairs, likely, beside)
            whole -= part.rows(pairs, beside=beside)
            return whole

        found.append(CandidateSums(*(a - b for a, b in zip(whole, part[:-1], strict=True)), rows))
    return found


def sums_with_other_weights(sums, less, more):
    """Sums after the weights of some poses have changed.

    Parameters
    ----------
    sums : CandidateSums
        Over all poses.
    less, more : CandidateSums
        Over the poses whose weights have changed, with their old and their new ones; of the same
        columns, and of whole positions where these have offsets.

    Returns
    -------
    CandidateSums
    """
    parts = [a - b + c for a, b, c in zip(sums[:-1], less[:-1], more[:-1], strict=True)]
    rows = _GramRows(
        lambda pairs: sums.rows(pairs) - less.rows(pairs) + more.rows(pairs), sums.cross.shape[1]
    )
    return CandidateSums(*parts, rows)


def sums_of_both(first, second):
    """Sums over two sets of poses.

    Parameters
    ----------
    first, second : CandidateSums
        Of the same columns.

    Returns
    -------
    CandidateSums
    """
    parts = [a + b for a, b in zip(first[:-1], second[:-1], strict=True)]
    rows = _GramRows(lambda pairs: _sum_of_rows((first, second), pairs), first.cross.shape[1])
    return CandidateSums(*parts, rows)


def _sum_of_rows(parts, pairs):
    """Rows of the Gram matrix over the poses of some sums together."""
    out = parts[0].rows(pairs)
    for part in parts[1:]:
        out += part.rows(pairs)
    return out


def sums_of_pairs(sums, pairs):
    """Sums with some of the candidates only.

    Parameters
    ----------
    sums : CandidateSums
    pairs : ndarray of shape (k,)
        Indices of the candidates.

    Returns
    -------
    CandidateSums
    """
    columns = columns_of(pairs)

    def rows(some, likely=(), beside=None):
        beside = pairs if beside is None else pairs[beside]
        return sums.rows(pairs[np.asarray(some, dtype=int)], beside=beside)

    return sums._replace(
        cross=sums.cross[:, columns],
        own=sums.own[:, pairs],
        candidate_moment=sums.candidate_moment[columns],
        rows=rows,
    )


def columns_of(pairs):
    """Cosine and sine columns of some candidates."""
    pairs = np.asarray(pairs, dtype=int)
    return np.stack([2 * pairs, 2 * pairs + 1], axis=1).ravel()


class _GramRows:
    """Rows of the candidates' Gram matrix, summed up when first asked for and kept."""

    def __init__(self, sum_up, n_columns):
        self._sum_up, self._place = sum_up, {}
        self._rows = np.empty((0, n_columns))

    def __call__(self, pairs, likely=(), beside=None):
        """Products of `pairs` with those of `beside`, (2 b, 2 k); with all where it is None.

        Those of `likely` are summed up on the way.
        """
        pairs = np.asarray(pairs, dtype=int).tolist()
        missing = [p for p in pairs if p not in self._place]
        if missing:
            missing += [p for p in likely if p not in self._place and p not in missing]
            self._keep(missing[: max(_BATCH, len(pairs))])
        rows = columns_of([self._place[p] for p in pairs])
        if beside is None:
            return self._rows[rows]
        return self._rows.view(complex)[np.ix_(rows, beside)].view(float)  # cosine and sine at once

    def _keep(self, pairs):
        known, needed = len(self._place), len(self._place) + len(pairs)
        if 2 * needed > len(self._rows):  # to the double, so that each row is copied once or twice
            larger = np.empty((2 * max(needed, 2 * known), self._rows.shape[1]))
            larger[: 2 * known] = self._rows[: 2 * known]
            self._rows = larger
        self._rows[2 * known : 2 * needed] = self._sum_up(np.array(pairs))
        self._place |= {pair: known + i for i, pair in enumerate(pairs)}


def _without_motions(sums, arm, terms):
    """Sums that know nothing of a motion of the base and of a common scale of all lengths.

    Residuals of a single-point test are the deviations of the points themselves. A turn of the base
    turns them, and a scale multiplies them: an arm of no size would explain them all, and with many
    rows and a wide prior the evidence prefers it. To first order in the errors neither can be seen,
    so both are taken out.
    """
    motions = _motions(arm, terms)
    if not motions.size:
        return sums
    keep = np.eye(len(motions)) - motions @ motions.T
    return sums._replace(
        gram=keep @ sums.gram @ keep, moment=keep @ sums.moment, cross=keep @ sums.cross
    )


def _motions(arm, terms):
    """Orthonormal coefficients (m, k) that move all points as one body, or scale them."""
    terms = terms._replace(harmonics=np.empty((0, 2), dtype=int))
    names, _ = term_names(arm, terms)
    if not terms.kinematics:
        return np.empty((len(names), 0))
    moving = ["base_x", "base_y", "base_alpha", "base_beta", "d1", "theta_offset1"]
    if arm.convention == "modified":  # these come before the first joint
        moving += ["a1", "alpha1", "beta1"]
    columns = np.eye(len(names))[:, [names.index(name) for name in moving]]
    return np.linalg.qr(np.column_stack([columns, scale_direction(arm, terms)]))[0]


class _Poses(NamedTuple):
    """Poses sorted by position, in chunks of whole positions."""

    angles: np.ndarray
    y: np.ndarray
    weights: np.ndarray
    parts: list  # (rows, first row of each position in the chunk or None)
    n_groups: int


def _sorted_poses(angles, y, weights, codes):
    """Whole positions stay together, so that a chunk knows the means that it takes out."""
    if codes is None:
        parts = [(rows, None) for rows in chunks(len(angles), _CHUNK)]
        return _Poses(angles, y, weights, parts, 0)
    order = np.argsort(codes, kind="stable")
    first = np.flatnonzero(np.diff(codes[order], prepend=-1))
    ends, parts, begin = np.append(first[1:], len(angles)), [], 0
    limit = chunk_size(_CHUNK)
    for i, end in enumerate(ends):
        last = i + 1 == len(ends)
        if last or ends[i + 1] - first[begin] > limit:
            parts.append((slice(first[begin], end), first[begin : i + 1] - first[begin]))
            begin = i + 1
    return _Poses(angles[order], y[order], weights[order], parts, len(first))


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


def _weighted_deviations(columns, weights, starts):
    """Weights times deviations from the position's mean: one side of a product is enough."""
    weighted = weights[:, None, None] * columns
    if starts is not None:
        total = np.maximum(np.add.reduceat(weights, starts), _TINY)[:, None, None]
        mean = np.add.reduceat(weighted, starts, axis=0) / total
        counts = np.diff(starts, append=len(weights))
        weighted -= weights[:, None, None] * np.repeat(mean, counts, axis=0)
    return weighted


def _sums_of_joints(spans, n_poses):
    """A `WaveSums` for each joint with candidates."""
    return [WaveSums(orders, n_poses) for _, orders, _ in spans]


def _add_products(sums, spans, angles, share_of):
    """Add some poses to sums; `share_of` gives the columns (n, m) times the turn of a joint."""
    for joint_sums, (joint, _, _) in zip(sums, spans, strict=True):
        joint_sums.add(angles[:, joint], share_of(joint))


def _products(sums, n_columns):
    """Inner products of the columns with all candidates, (m, 2 n_pairs)."""
    if not sums:
        return np.empty((n_columns, 0))
    return np.concatenate([joint_sums.result() for joint_sums in sums], axis=1)


def _own_blocks(turns, angles, weights, starts, spans):
    """cos'cos, sin'sin and cos'sin of each candidate, (3, n_pairs)."""
    out = np.empty((3, sum(len(orders) for _, orders, _ in spans)))
    for joint, orders, pairs in spans:
        turn = turns[:, :, joint]
        size = weights * np.square(turn).sum(axis=1)
        double = sums_of_doubles(angles[:, joint], size, orders)
        cc, ss = 0.5 * (size.sum() + double.real), 0.5 * (size.sum() - double.real)
        cs = 0.5 * double.imag
        if starts is not None:
            means = waves(angles[:, joint], orders)
            total = np.maximum(np.add.reduceat(weights, starts), _TINY)
            for component in range(turn.shape[1]):
                sums = np.add.reduceat((weights * turn[:, component])[:, None] * means, starts)
                sums /= np.sqrt(total)[:, None]
                cc -= np.square(sums.real).sum(axis=0)
                ss -= np.square(sums.imag).sum(axis=0)
                cs -= (sums.real * sums.imag).sum(axis=0)
        out[:, pairs] = cc, ss, cs
    return out


def _rows_in_batches(poses, turns, spans, pairs):
    """As `_gram_rows`, for any number of pairs."""
    parts = [pairs[some] for some in chunks(len(pairs), _LARGEST_BATCH)]
    return np.concatenate([_gram_rows(poses, turns, spans, part) for part in parts])


def _gram_rows(poses, turns, spans, pairs):
    """Inner products of the columns of some pairs with all candidates, (2 b, 2 n_pairs)."""
    sums = _sums_of_joints(spans, len(poses.angles))
    (joint, order), twice = pairs.T, np.repeat(pairs[:, 0], 2)
    for rows, starts in poses.parts:
        angles, turn, weights = poses.angles[rows], turns[rows], poses.weights[rows]
        phase = order * angles[:, joint]
        wave = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(phase), -1)
        if starts is None:
            share_of = _shares_of_waves(wave, twice, turn, weights)
        else:
            columns = turn[:, :, twice] * wave[:, None]
            share_of = _shares(_weighted_deviations(columns, weights, starts), turn)
        _add_products(sums, spans, angles, share_of)
    return _products(sums, 2 * len(pairs))


def _shares(weighted, turns):
    """Columns (n, c, m) with weights, contracted with the turn of a joint: (n, m)."""
    return lambda joint: np.einsum("ncm,nc->nm", weighted, turns[:, :, joint])


def _shares_of_waves(wave, joints, turns, weights):
    """The same for waves (n, m) of some joints (m,): their turns alone are contracted."""

    def share_of(joint):
        turn = weights[:, None] * turns[:, :, joint]
        return np.take(np.einsum("ncj,nc->nj", turns, turn), joints, axis=1) * wave

    return share_of
