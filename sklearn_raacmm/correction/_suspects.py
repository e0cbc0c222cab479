"""What may have changed of an arm, and which of it new rows make likely: one table of changes.

Residuals that are divided by their noise, r, have under a model that holds the covariance ``f^2 I +
G G'``, with G the columns of the model's uncertainty and f how much larger the noise is today. A
change of k numbers adds ``v^2 U U'``. The noise is an axis of every change: else rows that scatter
more than before would be believed to be a change. In the axes of G, with ``D = 1 / (f^2 + lambda)``
the diagonal precision, ``K = U' D U`` of the eigenvalues e and a what ``U' D r`` is along its axes,
a change of the size v raises the log likelihood by ``sum(v^2 a^2 / (1 + v^2 e) - log(1 + v^2 e)) /
2``. The mean likelihood over grids of f and of v / f, less the logarithm of how many changes there
are, is compared with that of no change. Changes far smaller than the noise would be none.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import logsumexp

from sklearn_raacmm.correction._change import changes_of, parts_of, with_names
from sklearn_raacmm.correction._posterior import thin
from sklearn_raacmm.correction._rows import TAKEN_UP, Expected, place_columns, slipped_rows
from sklearn_raacmm.error_model import Rows
from sklearn_raacmm.measurements import Explanation
from sklearn_raacmm.utils import Groups

# Orders of the harmonics that a knocked or loosened encoder shows first.
_ORDERS = (1, 2)

# Noise of the new rows, in units of the model's, and sizes of a change, root mean square over the
# rows in units of that noise. Equally likely; finer or wider grids name the same changes.
_NOISES, _SIZES = 2.0 ** np.arange(7), 2.0 ** np.arange(-1, 9)
# Changes of which an update names so many, one after another, before whole families may change: a
# choice. Names of those that have columns in the model; of others the families tell.
_MOST_NAMED = 3
# What a change is called where the noise explains more than any.
NOISE = "noise"


def likeliest_change(
    residual: np.ndarray,
    known: np.ndarray,
    causes: Mapping[str, np.ndarray],
    freedom: int,
    least_nats: float = 0.0,
) -> tuple[str, np.ndarray | None, float]:
    """The change of highest evidence, its columns times its size, and how much that is, nats.

    Where none is likelier than noise by `least_nats`, "noise", None and `least_nats`.

    `residual` (m,), the root `known` (m, r) of the model's covariance, and the columns (m, k) of
    the `causes` are divided by the noise and have no part along nuisances, which leave the rows so
    many degrees of `freedom`.
    """
    axes, root, _ = np.linalg.svd(thin(known), full_matrices=False)
    axes, value = axes[:, root > 0], np.square(root[root > 0])
    along = axes.T @ residual
    rest = residual @ residual - along @ along
    precision = 1 / (np.square(_NOISES)[:, None] + value)
    noise = 1 / np.square(_NOISES)
    whole = precision @ np.square(along) + noise * rest - np.log(precision).sum(axis=1)
    whole = -0.5 * (whole - (freedom - len(value)) * np.log(noise))
    nothing = logsumexp(whole) - np.log(len(whole))
    best, columns, highest = NOISE, None, nothing + least_nats
    for name, cause in causes.items():
        size = np.linalg.norm(cause)
        if not size > 0:
            continue
        unit = thin(cause) * (np.sqrt(freedom) / size)
        own = axes.T @ unit
        outside, shares = noise[:, None, None], own.T * precision[:, None]
        spread, turn = np.linalg.eigh(outside * (unit.T @ unit - own.T @ own) + shares @ own)
        pull = noise[:, None] * (unit.T @ residual - own.T @ along) + shares @ along
        pull, spread = pull[:, None] @ turn, np.maximum(spread, 0.0)[:, None]
        variance = np.square(_SIZES)[:, None] / outside
        wider = 1 + variance * spread
        gains = 0.5 * (variance * np.square(pull) / wider - np.log(wider)).sum(axis=2)
        logs = whole[:, None] + gains
        evidence = logsumexp(logs) - np.log(logs.size) - np.log(len(causes))
        if evidence > highest:
            size = np.outer(_NOISES, _SIZES).flat[np.argmax(logs)]
            best, columns, highest = name, size * unit, evidence
    return best, columns, float(highest - nothing)


class Suspects:
    """What each change does to rows that count, whitened: one table for checks and for updates.

    `slipped` (n,) are the rows that do not count. Of the others are `left` (n, 3) what a correction
    leaves, without tails, mm, and `causes` by their names, columns (n, 3, k); `residual` (m,), the
    root `known` (m, r) of what the model expects and `seen`, the causes, are over the noise.
    """

    def __init__(self, expected: Expected, correction: np.ndarray) -> None:
        self.slipped, left = slipped_rows(expected, expected.rows.y - correction)
        used = ~self.slipped & (expected.rows.weights > 0)
        self.expected, self.left, correction = expected.at(used), left[used], correction[used]
        self.rows, self.shown = self.expected.rows, self.expected.shown
        self.causes = causes_of(self.rows)
        self.known = self.shown.flat(self.expected.spread)
        self.seen = {name: self.shown.flat(one, TAKEN_UP) for name, one in self.causes.items()}
        self.residual = self.shown.left(self.left, correction).ravel() / self.shown.noise_sd


def named_changes(
    expected: Expected,
    refitted: Sequence[str] = ("base", "probe"),
    least_nats: float = Explanation.EQUAL,
    only: Sequence[str] = (),
) -> list[str] | None:
    """Changes that new rows name, one after another; None: all columns may.

    The change of the highest evidence becomes a part of what the model expects, and the next is
    looked for beside it. That all columns have changed a little is one of them. An empty list:
    nothing is likelier by `least_nats` than that only noise is there; one of 20 jitters of joints
    had 0.6 for a change of all columns, which left 182 um for 29. Before a tracker what was
    `refitted` may be off beside any change (``benchmarks/bench_after_the_lab.py knocks``). If
    `only` some changes are possible, no others are looked for.
    """
    suspects, linear = Suspects(expected.widened(), expected.mean), expected.linear
    causes, known, shown = suspects.seen, suspects.known, suspects.shown
    if suspects.rows.codes is None:
        place = place_columns(linear.arm, suspects.rows.X, with_base=True)
        known = np.hstack([known, shown.flat(place[:, :, 0 if "probe" in refitted else 3 :])])
        taken = "base turned", *refitted
        causes = {name: one for name, one in causes.items() if name not in taken}
    causes["arm"] = shown.flat(suspects.expected.columns * changes_of(linear)[1])
    causes = {name: one for name, one in causes.items() if not only or name in only}
    names: list[str] = []
    held = {*with_names(linear, parts_of(linear)).tolist()}
    while True:
        given = suspects.residual, known, causes, shown.n_coordinates, least_nats
        name, change, _ = likeliest_change(*given)
        if change is None:
            return names
        if len(names) == _MOST_NAMED or name not in held:
            return None
        names.append(name)
        known = np.hstack([known, change])
        del causes[name]


def causes_of(rows: Rows) -> dict[str, np.ndarray]:
    """What each cause would do to the probe in some rows: columns (n, 3, k) by name.

    Zeros and waves are those of the joints themselves, as the model has them, where what the
    encoders give is coupled.
    """
    arm, codes = rows.arm.replace(couplings=()), rows.codes
    angles = rows.arm.own_angles(rows.X[:, : arm.n_joints])
    jacobian, place = arm.jacobian(angles), place_columns(arm, angles, with_base=True)
    causes = {"probe": place[:, :, :3]}
    # Of a single-point test the base shows nothing, and within a position time is the order of
    # its poses: of 50 checks of arms that wobble 31 had p < .05 for a drift.
    if codes is None:
        # Together they are six numbers, too many for what three explain: of 40 bases of the
        # UR10 that settled by 40 um none was named, apart 27 are
        # (``benchmarks/bench_check.py kinds --real``). About z it is an offset of joint 1.
        causes |= {"base": place[:, :, 3:6], "base turned": place[:, :, 6:8]}
        causes["drift"] = np.linspace(-1, 1, len(angles))[:, None, None] * place[:, :, 3:6]
    points = arm.forward(angles)
    if codes is not None:  # a position is one point: what it shows about it is no scale
        held = np.reshape(rows.rank, (-1, 1)) == 3
        points = np.where(held, Groups(codes).means(points)[codes], points)
    causes["scale"] = points[:, :, None]
    for j in range(arm.n_joints):
        causes[f"offset of joint {j + 1}"] = jacobian[:, :, [j]]
        phase = arm.phases(angles)[:, [j]] * np.array(_ORDERS)
        waves = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
        causes[f"harmonics of joint {j + 1}"] = jacobian[:, :, j, None] * waves[:, None]
    for j in arm.slides:
        causes[f"scale of joint {j + 1}"] = jacobian[:, :, [j]] * angles[:, None, [j]]
    return causes
