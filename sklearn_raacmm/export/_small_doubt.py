"""What a correction fades by, with a tenth of the numbers: for controllers with little memory.

The squared doubt at a pose is ``sum over x, y, z of a' P a``, a the model's columns and P their
covariance: m columns need m^2 / 2 numbers. Here the waves of one joint are taken for themselves:
they turn the probe about one axis, so that what they add is the squared displacement per turn times
a periodic function of that joint's angle, a Fourier series. What is left of P, between joints and
of all other columns, is nearly of low rank where poses are reached: the largest of its eigenvalues,
positive and negative, in the metric of columns at poses from far to near.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.error_model import Effect

# Waves of one joint about one axis that are taken for themselves, if there are so many.
_MANY = 24
# Orders of the series of a joint, of which models have up to 400.
_ORDERS = 100
# Terms of a series below such a share of its mean are left out: of a UR10 520 of 1200. Where waves
# nearly cancel, only those that are next to nothing.
_LITTLE = (1e-3, 1e-6)
# By how much a share may be off at the poses that choose the rank.
_OFF = 0.006
# By how much more it may be off there because the root is kept in 16 bits a number, a thirtieth of
# it (a choice); the largest of these numbers.
_ROUNDED, _INT16 = 2e-4, 2**15 - 1
# Columns that together add no more than this share of the residuals are left out of the root.
_NOTHING = 0.01
# Poses at which the rank is chosen: so many far ones, and where each has gone by so many steps.
_POSES, _STEPS = 150, 16
# By which share of themselves 16 bits a number may move deviations: half of what is promised. So
# many poses in the ranges of the fit and each so manieth from far to near are looked at: half of
# them make the rounding good (so little, as a share of its size, where none is), half judge.
# Deviations at a UR10's own poses are 5.8e-4 off at most, 1.2e-3 by rounding alone.
_OFF_DEVIATION, _NEAR, _SEEN, _UNSEEN = 5e-4, 400, 5, 0.1
# Angles at which a joint's periodic function is evaluated for its series.
_ANGLES = 4096


def axis_numbers(table, n_joints):
    """Which axis each column of a table turns about or goes along: turns first."""
    shifts = np.isin(table["kind"], (Effect.SHIFT, Effect.LEAN, Effect.GROW))
    return 3 * (n_joints + 1) * shifts + 3 * table["frame"] + table["axis"]


def blocks_of_waves(table, of_axis):
    """Columns of the waves of each joint's turn about each axis, where there are `_MANY`."""
    waves = (table["kind"] == Effect.TURN) & (table["order"] != 0) & (table["by"] < 0)
    waves = np.flatnonzero(waves)
    keys = np.stack([of_axis[waves], table["joint"][waves]])
    _, place, n = np.unique(keys, axis=1, return_inverse=True, return_counts=True)
    return [waves[place.ravel() == i] for i in np.flatnonzero(n >= _MANY)]


def poses_from_far_to_near(chain, doubt, n=_POSES, seed=0):
    """Poses (rows of X): random ones, and where each goes to have less doubt, an input at a time.

    `doubt` is a function of rows. A fitted model does not keep its poses: they were where it has
    little doubt. Each step draws all inputs anew and changes the one that lowers the doubt most.
    """
    rows, *steps = chain.typical_rows(n * (1 + _STEPS), seed).reshape(1 + _STEPS, n, -1)
    known, found, of_row = doubt(rows), [rows], np.arange(n)
    one_input = np.eye(rows.shape[1], dtype=bool)[:, None]
    for drawn in steps:
        moved = np.where(one_input, drawn, rows)
        doubts = doubt(moved.reshape(-1, rows.shape[1])).reshape(-1, n)
        best = doubts.argmin(axis=0)
        least = doubts[best, of_row]
        rows = np.where((least < known)[:, None], moved[best, of_row], rows)
        known = np.minimum(known, least)
        found.append(rows)
    return np.concatenate(found)


def small_doubt(linear, fading, angles):
    """The smallest that is as good at poses (angles in rad and extra columns), or None.

    None where it would have no fewer numbers than the whole. Squared lengths of ``root' columns``,
    root (m, r), are added, but those of its `less` last columns taken off; the unit of each row of
    a root of whole numbers of 16 bits, or None where these will not do; a constant in mm^2; and of
    each series of a joint's waves which joint, from 0, which axis it turns about, cosines and then
    sines of order 1 and up, (2 * _ORDERS,), and the mean.
    """
    table, half = linear.layout.table, linear.fading_half
    of_axis = axis_numbers(table, linear.arm.n_joints)
    blocks, covariance = blocks_of_waves(table, of_axis), half @ half.T
    columns = np.concatenate([linear.columns(part) for part in np.array_split(angles, 4)])
    flat = columns.reshape(-1, len(table))
    exact = _over_axes(np.square(flat @ half)).sum(axis=1)
    share = fading.share(np.sqrt(exact))
    # The share changes by so much with the squared doubt.
    weights = 1.0 / np.square(fading.size_mm**2 + fading.factor**2 * exact)
    weights /= weights.sum()
    values, directions = _between_joints(covariance, blocks, flat, weights)
    along = np.cumsum(values * _over_axes(np.square(flat @ directions)), axis=1)
    most = max(len(table) // 2 - 1, 0)
    firsts = np.array([block[0] for block in blocks], dtype=int)
    joints, phases = table["joint"][firsts], linear.arm.phases(angles)
    for least in _LITTLE:  # the shortest series that do
        parts = [_series(table, block, covariance, least) for block in blocks]
        means = np.array([mean for mean, _ in parts])
        series = np.reshape([row for _, row in parts], (len(blocks), 2 * _ORDERS))
        of_blocks = np.zeros(len(angles))
        for block, joint, mean, row in zip(blocks, joints, means, series, strict=True):
            phase = np.outer(phases[:, joint], np.arange(1, _ORDERS + 1))
            waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
            of_blocks += _squared_turn(table, block, columns) * (mean + waves @ row)
        sums = of_blocks[:, None] + along
        constants = weights @ (exact[:, None] - sums)
        found = fading.share(np.sqrt(np.maximum(sums + constants, 0.0)[:, :most]))
        does = np.abs(found - share[:, None]).max(axis=0) <= _OFF
        if np.any(does):
            break
    else:
        return None
    rank = int(np.argmax(does)) + 1
    signs = np.argsort(values[:rank] < 0, kind="stable")
    sign = np.where(values[signs] < 0, -1.0, 1.0)
    root = directions[:, signs] * np.sqrt(np.abs(values[signs]))
    # What a column of the model adds, mm: those that add next to nothing have no row.
    sizes = np.linalg.norm(root, axis=1) * np.sqrt(3 * np.square(flat).mean(axis=0))
    ascending = np.argsort(sizes)
    little = np.cumsum(np.square(sizes[ascending])) < (_NOTHING * fading.size_mm) ** 2
    root[ascending[little]] = 0.0
    unit = _units_of_rows(root)
    whole = np.rint(root / unit[:, None])
    squares = [np.square(flat @ numbers) for numbers in (whole * unit[:, None], root)]
    moved = exact + _over_axes((squares[0] - squares[1]) @ sign)
    off = np.abs(fading.share(np.sqrt(np.maximum(moved, 0.0))) - share).max()
    root, unit = (whole.astype(np.int16), unit) if off <= _ROUNDED else (root, None)
    less, constant = np.count_nonzero(sign < 0), float(constants[rank - 1])
    return root, unit, less, constant, (joints, of_axis[firsts], series, means)


def _between_joints(covariance, blocks, flat, weights):
    """Eigenvalues of what is left of a covariance without blocks, and their directions."""
    between = covariance.copy()
    for block in blocks:
        between[np.ix_(block, block)] = 0.0
    values, turned = np.linalg.eigh((flat * np.repeat(weights, 3)[:, None]).T @ flat)
    root = np.sqrt(np.maximum(values, 1e-10 * values.max()))
    half, inverse = (turned * root) @ turned.T, (turned / root) @ turned.T
    values, turned = np.linalg.eigh(half @ between @ half)
    order = np.argsort(-np.abs(values))
    return values[order], inverse @ turned[:, order]


def seen_columns(linear, poses, order):
    """The model's columns (n, m) in this order, at poses that judge and at others, near and far."""
    low, high = linear.ranges
    near = np.random.default_rng(0).uniform(low, high, (_NEAR, len(low)))
    poses = np.concatenate([near, poses[::_SEEN]])
    return [
        linear.columns(at)[:, :, order].reshape(-1, len(order)) for at in (poses[::2], poses[1::2])
    ]


def in_16_bits(root, columns, others):
    """Whole numbers for a root and the unit of each row; itself, None where deviations feel it.

    They do where columns that are known together only, such as lengths and zeros of joints, nearly
    cancel; not among waves, of which large models have most. What the rounding of a row changes at
    the `others` is made good by the rows behind it (nearest plane, Babai 1986): that halves it.
    `columns` (n, m) at other poses judge.
    """
    m, unit = len(root), _units_of_rows(root)
    others = others / np.linalg.norm(others @ root, axis=1)[:, None]  # shares of deviations count
    size = np.linalg.norm(others, axis=0)
    held = np.diag(np.where(size > 0, _UNSEEN * size, 1.0))
    plane = np.asarray(np.linalg.qr(np.vstack([others, held])[:, ::-1], mode="r"))
    left, whole = plane @ root[::-1], np.zeros(root.shape)
    for row, i in enumerate(reversed(range(m))):
        wanted = left[i] / (plane[i, i] * unit[row])
        whole[row] = np.where(root[row], np.clip(np.rint(wanted), -_INT16, _INT16), 0.0)
        left[:i] -= np.outer(plane[:i, i], whole[row] * unit[row])
    exact, near = (np.linalg.norm(columns @ r, axis=1) for r in (root, whole * unit[:, None]))
    fine = np.all(abs(near - exact) <= _OFF_DEVIATION * exact)
    return (whole.astype(np.int16), unit) if fine else (root, None)


def _units_of_rows(root):
    """Unit of each row of a root in which its largest number has 16 bits."""
    largest = np.abs(root).max(axis=1)
    return np.where(largest > 0, largest, 1.0) / _INT16


def _over_axes(values):
    """Sums over x, y and z of rows (3 n, m)."""
    return values.reshape(-1, 3, *values.shape[1:]).sum(axis=1)


def _series(table, block, covariance, least):
    """Mean, cosines and sines of what a joint's waves add at its angles, per rad^2 of a turn."""
    angles, order = 2 * np.pi * np.arange(_ANGLES) / _ANGLES, table["order"][block]
    phase = np.outer(angles, np.abs(order))
    waves = np.where(order > 0, np.cos(phase), np.sin(phase)) * table["unit"][block]
    values = ((waves @ covariance[np.ix_(block, block)]) * waves).sum(axis=1)
    found = np.fft.rfft(values) / _ANGLES
    low = 2 * found[1 : _ORDERS + 1]
    low[np.abs(low) < least * found[0].real] = 0.0
    return found[0].real, np.concatenate([low.real, -low.imag])


def _squared_turn(table, block, columns):
    """Squared displacement (n,) of the probe per rad about the axis of a block."""
    order, unit = table["order"][block], table["unit"][block]
    # A cosine and the sine of the same order.
    pair = [np.flatnonzero(order == k)[0] for k in (order[0], -order[0])]
    return np.square(columns[:, :, block[pair]] / unit[pair]).sum(axis=(1, 2))
