"""What the order of the rows says: where joints came from, and the drift of a run."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import Arm, JointTypes
from sklearn_raacmm.measurements._dwells import within_turn
from sklearn_raacmm.utils import Finding, Groups

# Angles that differ by less than this have not moved: the joint keeps its direction, rad. In a
# stream a joint that has come back by less than twice the second has not turned round: encoders
# have noise of some arc seconds, and no hand moves by less than 40.
_STANDS_STILL, _NOISE_OF_STREAM = 1e-5, 1e-4
_TREES, _FOLDS = 100, 5
# Other orders of the visits of places in none of which as much may be explained: by chance in one
# run of 300. Rows that are looked at, for speed; visits that rows without labels are divided into,
# and the fewest, with 720 orders.
_ORDERS, _MOST_ROWS, _VISITS, _LEAST_VISITS = 299, 1500, 30, 6


def directions_of(
    angles: ArrayLike, *, at: ArrayLike | None = None, joint_types: str | None = None
) -> np.ndarray:
    """Direction from which each joint came, from the order of the poses.

    Parameters
    ----------
    angles : array-like of shape (n_samples, n_joints)
        Joint angles in rad, in the order in which they were taken.
    at : array-like of shape (n_poses,), default=None
        Rows of the poses that were logged, where `angles` are a stream of all that the encoders
        have shown: between two poses a joint may turn round. None: each row is a pose.
    joint_types : str, default=None
        Those of an :class:`Arm` with joints that slide, which are in mm. None: all turn.

    Returns
    -------
    ndarray of shape (n_samples, n_joints) or (n_poses, n_joints)
        1 where the joint came from smaller angles and -1 from larger ones; a joint that stands
        still keeps its direction. 0 where nothing is known.

    Raises
    ------
    ValueError
        If the angles are no numbers, or `at` are not numbers of their rows.

    Examples
    --------
    >>> from sklearn_raacmm import directions_of
    >>> directions_of([[0.1, 0.0], [0.3, 0.0], [0.3, -0.2]]).tolist()
    [[0.0, 0.0], [1.0, 0.0], [1.0, -1.0]]
    >>> directions_of([[0.1], [0.5], [0.3]], at=[0, 2]).tolist()  # beyond the pose, and back
    [[0.0], [-1.0]]
    """
    angles = np.asarray(angles, dtype=float)
    types = joint_types or ""
    angles = JointTypes(types or "R" * (angles.shape[1] if angles.ndim == 2 else 0)).check_angles(
        angles, "rad"
    )
    # From 359 to 1 degree a joint has most likely gone the short way.
    steps = within_turn(np.diff(angles, axis=0, prepend=angles[:1]), types)
    if at is not None:
        rows = np.asarray(at)
        if (
            rows.ndim != 1
            or rows.dtype.kind not in "iu"
            or not np.isin(rows, range(len(steps))).all()
        ):
            raise ValueError(f"at must hold rows of the stream, 0 to {len(steps) - 1}.")
        # A joint with play: what it drives moves where the play is used up.
        driven = np.cumsum(steps, axis=0)
        for before, now in pairwise(driven):
            np.clip(before, now - _NOISE_OF_STREAM, now + _NOISE_OF_STREAM, out=now)
        steps = np.diff(driven, axis=0, prepend=driven[:1])
        return _kept(np.sign(steps))[rows]
    return _kept(np.where(np.abs(steps) > _STANDS_STILL, np.sign(steps), 0.0))


def _kept(moved):
    """Directions of rows that have moved, (n, n_joints), those of the last such where not."""
    last = np.maximum.accumulate(np.where(moved != 0, np.arange(len(moved))[:, None], 0), axis=0)
    return np.take_along_axis(moved, last, axis=0)


def order_explained_by(angles: np.ndarray, codes: np.ndarray) -> float:
    """Share of the variance of the row number that the angles explain at positions left out.

    At most 1; about 0 or less where the run mixes its poses. `angles` are (n, n_joints), `codes`
    (n,) the positions, from 0.
    """
    # Here: they take a third of a second, and few need them.
    from sklearn.ensemble import ExtraTreesRegressor
    from sklearn.model_selection import GroupKFold, cross_val_predict

    number = np.arange(len(angles), dtype=float)
    trees = ExtraTreesRegressor(_TREES, min_samples_leaf=3, random_state=0)
    folds = GroupKFold(min(_FOLDS, int(codes.max()) + 1))
    features = np.hstack([np.cos(angles), np.sin(angles)])
    guessed = cross_val_predict(trees, features, number, groups=codes, cv=folds)
    return float(1 - np.square(number - guessed).mean() / number.var())


def drift_of(
    arm: Arm, angles: np.ndarray, left: np.ndarray, codes: np.ndarray | None
) -> Iterator[Finding]:
    """What drifted during a run, from the first to the last row, of what a model leaves (n, 3), mm.

    Zero angles, the scale and, with a reference for every pose, the base move in proportion to the
    time. What no model of the arm explains is alike at one place, and places differ: time counts by
    visits of a place, and the drift has to explain more than in nearly all other orders of the
    visits. `codes` (n,) are the positions where these have offsets; None: so many rows after one
    another are one visit.
    """
    some = np.linspace(0, len(angles) - 1, min(len(angles), _MOST_ROWS)).astype(int)
    places = some * _VISITS // len(angles) if codes is None else codes[some]
    angles, left = angles[some], left[some]
    codes = None if codes is None else np.unique(places, return_inverse=True)[1]
    visit = np.cumsum(np.diff(places, prepend=places[:1]) != 0)
    n_visits, n = visit[-1] + 1, len(angles)
    if n_visits < _LEAST_VISITS:
        return
    points = arm.points_at(angles)
    columns = [arm.jacobian(angles), points[:, :, None]]
    if codes is None:
        columns.append(np.broadcast_to(np.eye(3), (n, 3, 3)))
    effect = np.concatenate(columns, axis=2)
    effect = effect / np.sqrt(np.square(effect).sum(axis=(0, 1)))
    y = Groups(codes).centred(left).ravel()
    # Middle of each visit, from -1/2 at the first row to 1/2 at the last.
    times = Groups(visit).means(np.linspace(-0.5, 0.5, n)[:, None]).ravel()

    def explained(times):
        seen = Groups(codes).centred(times[visit][:, None, None] * effect).reshape(3 * n, -1)
        normal, slope = seen.T @ seen, seen.T @ y
        coef = np.linalg.lstsq(normal, slope, rcond=1e-12)[0]
        return slope @ coef, coef

    found, coef = explained(times)
    rng = np.random.default_rng(0)
    if any(explained(rng.permutation(times))[0] >= found for _ in range(_ORDERS)):
        return
    size = float(np.sqrt(np.square(Groups(codes).centred(effect @ coef)).sum(axis=1).mean()))
    text = f"This run drifted by {1000 * size:.0f} um from its first row to its last."
    yield Finding("drift-of-run", text, weight="note", size_mm=size)
