"""Which poses to measure next, by what a model or a registration does not know yet."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_scalar

from sklearn_raacmm.arm import FIELDS, Arm, check_angles, parameter_jacobian
from sklearn_raacmm.calibration import ANGLE_RAD, LENGTH_MM, UNKNOWN_PLACE_MM
from sklearn_raacmm.correction._new_poses import linear_model_of, place_columns
from sklearn_raacmm.error_model import ArmResidualRegressor, check_poses
from sklearn_raacmm.inference import narrowed
from sklearn_raacmm.utils import centred, encode_groups, listed

# Noise of a coordinate where no model says it, mm: about that of a UR10 before a tracker
# (benchmarks/bench_next_poses.py). Beside wide priors its size hardly changes the order of poses.
_NOISE_MM = 0.05
# Targets that are looked at; of more, these many spread evenly over the list. They are for speed:
# benchmarks/bench_next_poses.py gives 1000.
_MOST_TARGETS = 200


def _times(rows, matrix):
    """Product (n, m, q) of rows (n, m, k) with a matrix (k, q), as one of two large matrices."""
    n, m, k = rows.shape
    return (rows.reshape(n * m, k) @ matrix).reshape(n, m, -1)


def next_poses(
    model: ArmResidualRegressor | Arm,
    X: ArrayLike,
    n_poses: int,
    *,
    groups: ArrayLike | None = None,
    targets: ArrayLike | None = None,
    criterion: str = "I",
    free: str | list[Any] | None = None,
    measured: ArrayLike | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the poses whose measurement would tell most, one after another.

    How much a measurement would narrow the posterior of a linear model is known beforehand. With
    `free`, poses are chosen for a registration or a calibration.

    Parameters
    ----------
    model : ArmResidualRegressor or Arm
        Fitted model, of which the linear one is used. With `free` an arm suffices.
    X : array-like of shape (n_candidates, n_joints)
        Poses that could be measured: joint angles, in the unit that the model takes.
    n_poses : int
        How many to choose: poses, or positions where `groups` are given.
    groups : array-like of shape (n_candidates,), default=None
        Label of the position of each pose: positions are then chosen, with all of their poses.
        Needed where the model has offsets.
    targets : array-like of shape (n_targets, n_joints), default=None
        Poses where the arm will be used; None: the candidates. Of more than 200, 200 are taken,
        spread evenly over the list.
    criterion : {"I", "D"}, default="I"
        "I" lowers the mean variance at the targets, "D" the volume of what is possible of all that
        is to be found.
    free : list of {"base", "probe", "a", "alpha", "d", "theta_offset"}, default=None
        What the poses shall find, instead of the model's coefficients: ``["base", "probe"]`` for a
        registration, as by ``calibrate(..., correction=model, free=["probe"])``.
    measured : array-like of shape (n_measured, n_joints), default=None
        Poses that have been measured since the model was fitted, or at all where `free` is given.
        Not with `groups`.

    Returns
    -------
    chosen : ndarray of shape (n_poses,)
        Indices of rows of X in order of choice; labels of positions where `groups` are given.
    std_mm : ndarray of shape (n_poses + 1,)
        Standard deviation at the targets of what is to be found, as the length of a vector, root
        mean square over them, mm: now, and after each choice.

    Raises
    ------
    TypeError
        If the model is of another kind.
    ValueError
        If X has the wrong shape, there are fewer candidates than `n_poses`, groups are missing
        though the model has offsets, or the model has no terms.

    Notes
    -----
    Greedy I- and D-optimal design (V. V. Fedorov, Theory of Optimal Experiments, 1972), with the
    priors, the harmonics and the noise that the model found: where it lacks a term, the standard
    deviations know nothing of it.

    Examples
    --------
    >>> from sklearn_raacmm import ArmResidualRegressor, next_poses
    >>> from sklearn_raacmm.datasets import make_single_point
    >>> test = make_single_point(n_positions=12, n_poses=15, random_state=0)  # simulated
    >>> known = test.groups < 4
    >>> model = ArmResidualRegressor(test.arm, orders=4)
    >>> _ = model.fit(test.data[known], test.target[known], groups=test.groups[known])
    >>> chosen, std = next_poses(model, test.data[~known], 3, groups=test.groups[~known])
    >>> len(chosen), bool(std[-1] < std[0])
    (3, True)
    """
    if not (isinstance(criterion, str) and criterion in ("I", "D")):
        raise ValueError(f'criterion must be "I" or "D", got {criterion!r:.60}.')
    linear = None if isinstance(model, Arm) else linear_model_of(model, "planned for", in_use=False)
    if free is None:
        columns, half = _of_model(linear)
    else:
        columns, half = _of_arm(model if linear is None else linear.arm, free, groups)
    noise_sd = _NOISE_MM if linear is None else linear.noise_sd
    if free is not None:  # priors of millimetres beside no noise at all
        noise_sd = max(noise_sd, 1e-9)
    offsets = groups is not None if linear is None or free is not None else linear.offsets
    X = _check_poses(model, X)
    if groups is None:
        if offsets:
            raise ValueError(
                "The model has an unknown offset at every position: give groups, the position of "
                "each candidate."
            )
        labels, codes = np.arange(len(X)), np.arange(len(X))
    else:
        labels, codes = encode_groups(groups, len(X))
    check_scalar(
        n_poses, "n_poses", Integral, min_val=1, max_val=len(labels)
    )  # no more than there are candidates
    if measured is not None:
        if groups is not None:
            raise ValueError("measured poses count one by one: give them, or groups.")
        rows = columns(_check_poses(model, measured)) / noise_sd
        half = narrowed(half, rows.reshape(-1, len(half)))
    # What one unit of each factor, standard normal before the measurement, does to poses, mm.
    seen = _times(columns(X), half)
    aim = X if targets is None else _check_poses(model, targets)
    some = np.linspace(0, len(aim) - 1, min(len(aim), _MOST_TARGETS)).astype(int)
    aim = seen[some] if targets is None else _times(columns(aim[some]), half)
    rows = centred(seen, codes if offsets else None) / noise_sd
    chosen, variance = _greedy(
        _padded(rows, codes), aim.reshape(-1, aim.shape[2]), n_poses, criterion
    )
    return labels[chosen], np.sqrt(np.maximum(variance, 0.0) / len(aim))


def _of_model(linear):
    """Columns of a fitted model and the root of the covariance of their coefficients."""
    if linear is None:
        raise TypeError(
            "An Arm has no correction to plan for: give free, what a registration or calibration "
            "shall find."
        )
    if not len(linear.coef):
        raise ValueError(
            "The model has no terms that a measurement could narrow: choose the poses at random, "
            "or give free, what a registration or calibration shall find."
        )
    return linear.columns, linear.gauge_free_half


def _of_arm(arm, free, groups):
    """The same of base, probe and fields of an arm, as `calibrate` would find them."""
    free, known = listed("free", free), ("base", *FIELDS)
    if not free or not all(isinstance(name, str) and name in known for name in free):
        raise ValueError(f"free must name some of {', '.join(known)}, got {free!r:.60}.")
    n = arm.n_joints
    counts = [n, n, n, n, 3]  # entries of each field
    taken = np.flatnonzero(np.isin(np.repeat(np.array(FIELDS), counts), free))
    sizes = [LENGTH_MM, ANGLE_RAD, LENGTH_MM, ANGLE_RAD, UNKNOWN_PLACE_MM]
    prior = np.repeat(sizes, counts)[taken]
    # Where each position has an unknown place, the base shows nothing.
    with_base = "base" in free and groups is None

    def columns(angles):
        angles = angles[:, :n]  # without extra columns
        own = parameter_jacobian(arm, angles)[1][:, :, taken]
        if not with_base:
            return own
        return np.concatenate([own, place_columns(arm, angles, with_base=True)[:, :, 3:]], axis=2)

    return columns, np.diag(np.r_[prior, np.full(6 * with_base, UNKNOWN_PLACE_MM)])


def _padded(rows, codes):
    """Rows (n, 3, k) of each group side by side, (n_groups, 3 m, k), filled up with zeros."""
    counts = np.bincount(codes)
    order = np.argsort(codes, kind="stable")
    place = np.arange(len(codes)) - np.repeat(np.cumsum(counts) - counts, counts)
    out = np.zeros((len(counts), counts.max(), 3, rows.shape[2]))
    out[codes[order], place] = rows[order]
    return out.reshape(len(counts), -1, rows.shape[2])


def _greedy(rows, aim, n_poses, criterion):
    """Groups of rows chosen one after another, and the variance at the aim before and after each.

    With M the posterior of the factors, the identity at first, ``K = R M R'`` of each group and
    ``T = R M A'`` say what it is worth: ``log |I + K|`` (D) or ``tr (I + K)^-1 T T'`` (I). A choice
    b takes ``C (I + K_b)^-1 C'`` off K and ``C (I + K_b)^-1 T_b`` off T, with ``C = R M R_b'``: M
    itself is never formed.
    """
    identity = np.eye(rows.shape[1])
    if len(aim) > aim.shape[1]:  # no more rows than there are columns: the same A' A
        aim = np.asarray(np.linalg.qr(aim, mode="r"))
    K, T = rows @ rows.swapaxes(1, 2), _times(rows, aim.T)
    variance, chosen, taken = [np.square(aim).sum()], [], []
    open_ = np.ones(len(rows), bool)
    for _ in range(n_poses):
        if criterion == "D":
            gains = np.linalg.slogdet(identity + K)[1]
        else:
            gains = np.sum(np.linalg.inv(identity + K) * (T @ T.swapaxes(1, 2)), axis=(1, 2))
        best = int(np.argmax(np.where(open_, gains, -np.inf)))
        C = _times(rows, rows[best].T)
        for others, gain in taken:
            C -= others @ (gain @ others[best].T)
        gain = np.linalg.inv(identity + K[best])
        variance.append(variance[-1] - np.sum(T[best] * (gain @ T[best])))
        T -= C @ (gain @ T[best])
        K -= C @ gain @ C.swapaxes(1, 2)
        taken.append((C, gain))
        chosen.append(best)
        open_[best] = False
    return chosen, np.array(variance)


def _check_poses(model, X) -> np.ndarray:
    """Rows of X in rad, for an arm or a fitted model."""
    if isinstance(model, Arm):
        return check_angles(X, model.n_joints, "rad")
    return check_poses(model, X)
