"""Zeros that may be anywhere, and arms of unknown lengths: random starts, least squares."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.calibration import calibrate
from sklearn_raacmm.measurements import base_motions, check_length
from sklearn_raacmm.utils import Groups, align, listed

# Rows that zeros are found from, starts at most, and steps of each: for speed. A start has found
# them where the points coincide to this share of the reach; the best of three such starts is taken.
_ROWS, _STARTS, _STEPS = 90, 30, 60
_FOUND, _AGREE = 0.02, 3
# Frame of the elbow in the layouts of `Arm.from_lengths`.
_ELBOW = 3
# Height of the shoulder for the longest link, where nobody has said it: what bends at the base
# turns about its foot. A choice; built-in arms have 0.2 to 1. A simulated arm of 0.5 repeats by
# 17 % worse with 0, by 8 % with 0.27, by 2 % with 0.9.
_HEIGHT = 0.5
# Sizes of a step in a zero, rad, and in the probe, mm.
_SIZES = 0.1, 10.0


def with_found_zeros(
    arm: Arm, angles: np.ndarray, codes: np.ndarray | None, points: np.ndarray | None
) -> Arm:
    """The arm with the zeros, and the probe, with which its points coincide best.

    `angles` (n, n_joints) are in rad; `codes` (n,) are the positions of a single-point test, or
    `points` (n, 3) what a tracker measured, mm. The zeros of the first joint and of the last are
    kept: base and probe go with them.
    """
    order = np.arange(len(angles)) if codes is None else np.argsort(codes, kind="stable")
    few = order[np.linspace(0, len(order) - 1, min(len(order), _ROWS)).astype(int)]
    angles, free = angles[few], np.setdiff1d(range(1, arm.n_joints - 1), arm.slides)
    codes = None if codes is None else np.unique(codes[few], return_inverse=True)[1]
    points = None if points is None else points[few]
    columns = np.r_[3 * arm.n_joints + free, 4 * arm.n_joints + np.arange(3)]

    def fields(x):
        offset = arm.theta_offset.copy()
        offset[free] = np.angle(np.exp(1j * (offset[free] + x[:-3])))
        return {"theta_offset": offset, "probe": arm.probe + x[-3:]}

    def left(x):
        ours = arm.on_trial(**fields(x)).points_at(angles)
        if points is None:
            return Groups(codes).centred(ours).ravel()
        turn, shift = align(ours, points)
        return (ours @ turn.T + shift - points).ravel()

    def slope_of(x):
        ours, slope = arm.on_trial(**fields(x)).parameter_jacobian(angles)
        slope = slope[:, :, columns]
        if points is None:
            return Groups(codes).centred(slope).reshape(-1, len(columns))
        turn, shift = align(ours, points)
        slope = (turn @ slope).reshape(-1, len(columns))
        base = base_motions(ours @ turn.T + shift, arm.reach_mm).reshape(-1, 6)
        return slope - base @ np.linalg.lstsq(base, slope)[0]  # the base takes up its part

    start = np.zeros(len(columns))  # the table as it is given
    good = 0.5 * len(angles) * (_FOUND * arm.reach_mm) ** 2
    scale = np.repeat(_SIZES, [len(free), 3])
    return arm.replace(**fields(_best_of_starts(left, start, len(free), good, slope_of, scale)))


def _best_of_starts(left, start, n_free, good, jac, scale):
    """Where squares are least, from a start and from random ones of the first `n_free` numbers."""
    rng = np.random.default_rng(0)
    found: list[Any] = []
    for _ in range(_STARTS):
        found.append(least_squares(left, start, jac, x_scale=scale, max_nfev=_STEPS))
        if sum(one.cost < good for one in found) >= _AGREE:
            break
        start = np.r_[rng.uniform(-np.pi, np.pi, n_free), np.zeros(len(start) - n_free)]
    return min(found, key=lambda one: one.cost).x


def arm_from_data(
    layout: str,
    angles: ArrayLike,
    positions: ArrayLike,
    lengths: Iterable[Sequence[object]],
    *,
    angle_unit: str = "rad",
    mirrored: bool = False,
) -> Arm:
    """Find the arm, its lengths, zeros and probe, of which only the layout is known.

    From a single-point test in ten cones or so and one known length. Angles and lengths of links
    are found from what coincides, then all of the table by :func:`calibrate`. No cones show how
    high the shoulder stands above the foot of the arm, ``d[0]``: half of the longest link is taken.

    Parameters
    ----------
    layout : {"2-2-2", "2-2-3"}
        Joints at shoulder, elbow and wrist, whose neighbouring axes cross at right angles.
    angles : array-like of shape (n_samples, n_joints)
        What the encoders show, whatever their zeros and senses.
    positions : array-like of shape (n_samples,)
        Label of the position of each row.
    lengths : iterable of (label, label, length, standard deviation)
        One known distance between two positions or more, mm, as in :func:`calibrate`: nothing else
        shows the scale.
    angle_unit : {"rad", "deg"}, default="rad"
        Unit of `angles`.
    mirrored : bool, default=False
        Take the mirror image, which explains the same data. Of the two the arm is the one whose
        elbow is above its probe most often, if joint 1 grows counter-clockwise, seen from above.

    Returns
    -------
    Arm

    Raises
    ------
    ValueError
        If nothing is known of the layout, there are no lengths, or points of no such arm coincide;
        else as :func:`calibrate`.

    Notes
    -----
    With given zeros, points are linear in lengths and probe, w: ``L w``. The zeros are those for
    which the least of ``|L w|`` about the positions over ``|L w|`` between them is the smallest
    (variable projection). Senses of joints need no search: at right angles an axis turned round is
    a zero that is half a turn on, and lengths of the other sign.

    Examples
    --------
    >>> from sklearn_raacmm import arm_from_data
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> test = make_single_point(10, 12, bars=[500], random_state=0)  # simulated
    >>> arm = arm_from_data("2-2-2", test.data, test.groups, test.lengths)
    >>> bool(abs(arm.reach_mm - test.nominal_arm.reach_mm) < 500)
    True
    """
    arm, lengths = Arm.from_lengths(layout, *[100.0] * 4), listed("lengths", lengths)
    n = arm.n_joints
    if not lengths:
        raise ValueError("lengths are empty: without a known distance nothing shows the scale.")
    angles = arm.check_angles(angles, angle_unit)
    labels, codes = Groups.encoded(positions, len(angles))
    known = [check_length(entry, labels.tolist()) for entry in lengths]
    order = np.argsort(codes, kind="stable")
    few = order[np.linspace(0, len(order) - 1, min(len(order), 2 * _ROWS)).astype(int)]
    # The height of the base, and what the probe has, too, show nothing.
    columns = np.r_[: n - 1, 2 * n + 1 : 3 * n - 1, 4 * n : 4 * n + 3]
    last = np.zeros(len(columns))

    def parts(zeros, rows):
        one = arm.on_trial(theta_offset=np.r_[0.0, zeros, 0.0])
        slope = one.parameter_jacobian(angles[rows])[1][:, :, columns]
        means = Groups(codes[rows]).means(slope)[codes[rows]]
        return [
            part.reshape(-1, len(columns)) for part in (slope - means, means - means.mean(axis=0))
        ]

    def left(zeros):
        nonlocal last
        within, between = parts(zeros, few)
        size, turn = np.linalg.eigh(between.T @ between)
        root = turn[:, size > 1e-9 * size[-1]] / np.sqrt(size[size > 1e-9 * size[-1]])
        w = root @ np.linalg.eigh(root.T @ (within.T @ within) @ root)[1][:, 0]
        last = w if w @ last >= 0 else -w  # lest steps end in its negative
        return within @ last

    good = 0.5 * _FOUND**2
    zeros = _best_of_starts(left, np.zeros(n - 2), n - 2, good, "2-point", 1.0)
    if (ratio := np.linalg.norm(left(zeros))) > _FOUND:
        raise ValueError(
            f"points of no {layout} arm coincide: within a position they scatter by {ratio:.2g} of "
            "what positions are apart. Look at the labels, and the order and unit of the angles."
        )
    found = {"theta_offset": np.r_[0.0, zeros, 0.0]}
    slope = arm.replace(**found).parameter_jacobian(angles)[1][:, :, columns]
    places = Groups(codes).means(slope @ last)
    last *= np.mean([mm / np.linalg.norm(places[i] - places[j]) for i, j, mm, _ in known])

    def scaled(w):
        a, d, probe = np.split(w, [n - 1, 2 * n - 3])
        height = _HEIGHT * np.abs(d).max()
        return arm.replace(a=np.r_[a, 0.0], d=np.r_[height, d, 0.0], probe=probe, **found)

    frames = scaled(last).frames(angles)
    above = frames[:, _ELBOW, 2, 3] - scaled(last).forward(angles)[:, 2]
    one = scaled(-last if (above.mean() < 0) != mirrored else last)
    return calibrate(one, angles, positions, lengths=lengths, accept="table-off").arm
