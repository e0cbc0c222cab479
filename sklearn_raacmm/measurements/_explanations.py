"""What may be wrong with residuals: one table of explanations, for every function that asks.

`WORDS` says what each is called and what to do about it, `Explanation.of_residuals` what it does to
the data. Where a model says how residuals scatter, likelihoods are compared by
`Explanation.likeliest`; deviations of a single-point test are those of the arm's own points to the
last digit, and compared with them.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement, permutations, product
from typing import ClassVar, TypeVar

import numpy as np

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.utils import Finding, Groups, Weight, align, tukey_weights

What = TypeVar("What")

UNITS = {25.4: "inches", 10.0: "centimetres", 1000.0: "metres", 1e-3: "micrometres"}
_FILES = "Are angles and points from two files, of which one has a row more, or another order?"
WORDS = {
    "sign-of-residuals": (
        "their sign is wrong, or they were corrected twice",
        "Give measured minus reference.",
    ),
    "corrected-already": (
        "they have been corrected already",
        "Give what the arm shows without the correction: result.residuals(angles, points), not "
        "result.residuals_mm.",
    ),
    "unit-of-residuals": ("they are in {}", "Give millimetres."),
    "axes-of-residuals": (
        "their axes are others: {}",
        "Give residuals in the arm's base frame, x, y and z in this order.",
    ),
    "shifted-rows": ("they are of the row {}", _FILES),
    "moved-station": (
        "the base or the tracker moved{}",
        "Give each part by itself, after a registration of its own.",
    ),
    "rows-unrelated": ("they do not belong to the angles of their rows", _FILES),
    "joints": ("of the angles, {}", "Look at the order and the sense of the joints."),
    "other-table": (
        "they are of another table of this arm, such as the nominal one",
        "Take the arm that the model was fitted with, model.arm_.",
    ),
    "another-arm": (
        "they are of another arm",
        "Are they of this arm, and of the table that the model was fitted with?",
    ),
}
# Exchanges and mirrors of axes beside the given ones and all mirrored; of a turn three numbers,
# each known to some hundredths.
_EXCHANGES = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3))
    if order != (0, 1, 2) or len(set(signs)) > 1
]
_TURNS, _JOINTS = 10_000, 20
# Rows that an order can be seen of.
_LEAST_ROWS = 12
# Rows at the end from which on they are late. With fewer, 3 of 24 simulated updates with one slip
# in the last row but one were refused; see ``tests/correction/test_update.py``.
_LEAST_LATE = 5
# What deviations are made of is met by this share of the differences between two rows, to this part
# of their median; rows that are looked at have to be so many.
_SHARE, _EXACT, _LEAST_PAIRS = 0.9, 0.05, 8
# Positions that deviate by more of the reach had no cone, and of deviations that are explained by
# less than this share of their squares the rows are not related. Of four real arms and of simulated
# ones all are explained.
_ONE_CONE, _RELATED = 0.01, 0.25
# Deviations from means have means of less than this part of their differences. The arm's own points
# never differ by so many times as much: those of another arm of the same drawing do by 45 to 78
# times, and what a model has left of deviations is not as small.
_NO_MEAN, _OTHERS = 1e-3, 10.0
# What another model has left of deviations looks like these, and is a legitimate target of a fit.
_MAYBE_MEANT = ("other-table", "rows-unrelated")

# Part of the squares of a move that is added: rows at one place cannot show a turn.
_RIDGE = 1e-4


@dataclass(frozen=True, eq=False)
class Explanation:
    """What may be wrong with residuals, and what is then left of them beside what is expected."""

    code: str  # of `WORDS`
    what: str  # fills the gap in the words
    left: np.ndarray  # (n, 3) mm
    rows: np.ndarray  # (n,) of the angles that it is left at
    n_tried: int = 1  # explanations of this kind
    factor: float = 1.0  # of each coordinate
    first: int = 0  # the first row that it is about
    of: np.ndarray | None = None  # (n,) rows of the residuals, where they are others

    # Nats by which an explanation has to be better than the data as given, beside the logarithm of
    # how many of its kind are tried: `benchmarks/bench_check.py findings` counts what is said of
    # real data that nothing is wrong with. Within `EQUAL` nothing tells two apart: a choice.
    PRICE: ClassVar[float] = 11.0
    EQUAL: ClassVar[float] = 7.0
    # Residuals farther off than so many medians count as though they lay there.
    FAR: ClassVar[float] = 3.0
    # Rows on either side of a change.
    LEAST_ROWS: ClassVar[int] = 8

    def said(self, numbers: np.ndarray) -> str:
        """The words, with the row from which on it is so; `numbers` are what rows are called."""
        row = Finding.row_numbers(numbers[[self.first]])[0]
        what = self.what + f", from row {row} on" * (self.first > 0)
        return WORDS[self.code][0].format(what)

    def finding(
        self, text: str, numbers: np.ndarray, size_mm: float, weight: Weight = "repair"
    ) -> Finding:
        """That it is so; `text` says how it was found."""
        rows = Finding.row_numbers(numbers[[self.first]]) if self.first else ()
        return Finding(self.code, text, WORDS[self.code][1], weight, rows=rows, size_mm=size_mm)

    @staticmethod
    def likeliest(explained: Iterable[tuple[float, What]], given: float = PRICE) -> list[What]:
        """The best of (nats, explanation) and all that are as likely, the best first.

        None where the data as given are likelier than the best, or its gain is less than its price.
        """
        ranked = sorted(explained, key=lambda one: -one[0])
        best = ranked[0][0]
        return [one for nats, one in ranked if nats > best - Explanation.EQUAL and best > given]

    @classmethod
    def of_residuals(
        cls,
        y: np.ndarray,
        expected: np.ndarray,
        angles: np.ndarray,
        n_joints: int,
        codes: np.ndarray | None,
        predict: Callable[[np.ndarray], np.ndarray],
        correction: np.ndarray | None,
        motions: np.ndarray | None = None,
    ) -> Iterator["Explanation"]:
        """Yield what may have been done to residuals (n, 3), in mm: of another arm first.

        `expected` (n, 3) is what they should be at the angles, and `predict` says so for others; a
        `correction` (n, 3) may have been taken away. `codes` (n,) are the positions, where these
        have offsets; `motions` (n, 3, 6) is what a base that moves does to them.
        """
        every = np.arange(len(y))
        yield cls("another-arm", "", y, every)
        yield cls("other-table", "", y - expected, every)
        yield cls("rows-unrelated", "", y, every)
        yield cls("sign-of-residuals", "", -y - expected, every)
        for factor, unit in UNITS.items():
            left = factor * y - expected
            yield cls("unit-of-residuals", unit, left, every, len(UNITS), factor)
        if correction is not None:
            yield cls("corrected-already", "", y + correction - expected, every)
            yield cls("sign-of-residuals", "", y + 2 * correction - expected, every)
        best = max(_EXCHANGES, key=lambda one: np.vdot(y @ one.T, expected))
        names = [f"{'-' if row.sum() < 0 else ''}{'xyz'[np.abs(row).argmax()]}" for row in best]
        turns = [(best, " ".join(names), len(_EXCHANGES))]
        for mirror, words in ((1.0, "they are turned"), (-1.0, "they are turned and mirrored")):
            turns.append((mirror * align(mirror * y, expected)[0], words, _TURNS))
        for turn, words, n_tried in turns:
            yield cls("axes-of-residuals", words, y @ turn.T - expected, every, n_tried)
        # Two joints exchanged, or one and the same reversed.
        for i, j in combinations_with_replacement(range(n_joints), 2):
            changed = angles.copy()
            changed[:, [i, j]] = angles[:, [j, i]] * (-1 if i == j else 1)
            words = f"joints {i + 1} and {j + 1} are exchanged"
            words = f"joint {i + 1} is reversed" if i == j else words
            yield cls("joints", words, y - predict(changed), every, _JOINTS)
        yield from _late(y, expected, codes)
        if codes is None and motions is not None and len(y) >= 3 * cls.LEAST_ROWS:
            row, left = _moved_from(y - expected, motions)
            # A slipped row is no move, though one may explain a part of it.
            kept, some = every, every[tukey_weights(left) > 0]
            if 3 * cls.LEAST_ROWS <= len(some) < len(every):
                kept = some
                row, left = _moved_from((y - expected)[kept], motions[kept])
            taken = _TURNS**2 * len(kept)
            yield cls("moved-station", "", left, kept, taken, first=int(kept[row]))


def _moved_from(left, motions):
    """The row from which on a base or tracker stood elsewhere, and what it leaves (n, 3)."""
    own = left - motions @ np.linalg.lstsq(motions.reshape(left.size, 6), left.ravel())[0]
    _, row, _, left = best_split(own, motions, np.zeros(6), motions, np.arange(len(left)))
    return row, left


def _late(y, expected, codes):
    """From some row on, residuals are of the row before or after."""
    for step, word in ((1, "before"), (-1, "after")):
        rows = np.arange(max(-step, 0), len(y) - max(step, 0))
        if codes is not None:
            rows = rows[codes[rows + step] == codes[rows]]
        if len(rows) < _LEAST_ROWS:
            continue
        parts = [y[of] - expected[rows] for of in (rows, rows + step)]
        middles = (Groups(None if codes is None else codes[rows]).medians(one) for one in parts)
        good, late = (np.square(a - b).sum(axis=1) for a, b in zip(parts, middles, strict=True))
        limit = Explanation.FAR**2 * max(np.median(good), np.median(late))
        ahead = np.cumsum(np.minimum(good, limit) - np.minimum(late, limit))
        ahead = np.r_[0.0, ahead]
        ahead[1 - _LEAST_LATE : -1] = np.inf  # the last rows alone are slips
        first = int(np.argmin(ahead))
        if first == len(rows):
            continue
        is_late = np.arange(len(rows)) >= first
        left, of = np.where(is_late[:, None], *parts[::-1]), rows + step * is_late
        n_tried, row = (4 * len(rows), int(rows[first])) if first else (4, 0)
        yield Explanation("shifted-rows", word, left, rows, n_tried, first=row, of=of)


def of_own_points(
    y: np.ndarray,
    codes: np.ndarray,
    arm: Arm,
    angles: np.ndarray,
    numbers: np.ndarray,
    probes: np.ndarray | None = None,
    known: np.ndarray | None = None,
) -> tuple[bool, list[Finding]]:
    """Whether deviations (n, 3) of a single-point test are of the arm's points, and what was done.

    They are those of the arm's own points from where each position is, to the last digit: what else
    explains their differences from row to row is what was done to them. `numbers` (n,) are what the
    rows are called; `known` (n, 3) in mm is what a correction says; None: there is none.
    """

    def steps(values, rows=slice(None)):  # from row to row of one position
        order = np.argsort(codes[rows], kind="stable")
        return np.diff(values[order], axis=0)[np.diff(codes[rows][order]) == 0]

    size = np.linalg.norm(steps(y), axis=1)
    usual = np.median(size) if len(size) >= _LEAST_PAIRS else 0.0
    if not usual > 0:
        return False, []

    def explains(one):
        left = np.linalg.norm(steps(one.left, one.rows), axis=1)
        right = left < _EXACT * usual * one.factor
        return len(left) >= _LEAST_PAIRS and right.mean() >= _SHARE

    def own_of(angles):
        return arm.points_at(angles, probes)

    every, given, own = (
        np.arange(len(y)),
        Groups(codes).centred(y),
        Groups(codes).centred(own_of(angles)),
    )
    as_given = Explanation("", "", given - own, every)
    if explains(as_given):
        return True, []
    tried = [*Explanation.of_residuals(given, own, angles, arm.n_joints, codes, own_of, known)]
    # Any deviations are those of some table where there are few.
    jac = arm.parameter_jacobian(angles)[1]
    slope, shown = steps(jac.reshape(len(y), -1)), steps(own)
    if len(slope) > jac.shape[2]:
        table = np.linalg.lstsq(slope.reshape(-1, jac.shape[2]), (steps(y) - shown).ravel())[0]
        tried.append(Explanation("other-table", "", as_given.left - jac @ table, every))
    found = next((one for one in tried if explains(one)), None)
    text = "Beside the arm's own points at these angles, y are deviations from positions only if"
    if found is None:
        related = np.vdot(given, own) ** 2
        related /= max(np.vdot(own, own) * np.vdot(given, given), 1e-300)
        apart = float(np.median(np.linalg.norm(shown, axis=1)))
        if np.median(np.abs(given - y)) < _NO_MEAN * usual and apart > _OTHERS * usual:
            text = (
                f"Within a position the arm's own points at these angles are {apart:.2g} mm apart, "
                f"but y only {usual:.2g} mm: the angles are others, or of another arm."
            )
            found = Explanation("rows-unrelated", "", y, every)
            return False, [found.finding(text, numbers, apart, "repair")]
        coincide = apart < _ONE_CONE * arm.reach_mm
        if not coincide or related >= _RELATED:
            return False, []
        text = "y are not the deviations of the arm's own points at these angles:"
        found = Explanation("rows-unrelated", "", y, every)
    maybe_meant = known is None and found.code in _MAYBE_MEANT
    size = float(np.sqrt(np.square(y).sum(axis=1).mean()))
    weight: Weight = "doubt" if maybe_meant else "repair"
    return False, [found.finding(f"{text} {found.said(numbers)}.", numbers, size, weight)]


def best_split(
    left: np.ndarray, columns: np.ndarray, ridge: np.ndarray, extra: np.ndarray, own: np.ndarray
) -> tuple[float, int, np.ndarray, np.ndarray]:
    r"""Share of the squares of `own` rows that a move behind one takes away, and where it does.

    Behind every row in turn what was left (n, 3) is given a move of its own: with H the normal
    matrix of the `columns` C (n, 3, p) of what was fitted, on its diagonal the `ridge` (p,), and E
    those `extra` (n, 3, q) of the move the squares fall by :math:`g' S^{-1} g`, :math:`g = E'r` and
    :math:`S = E'E - E'C H^{-1} C'E`.

    Returns the share, the number among the `own` rows (n_own,), three times `LEAST_ROWS` or more,
    the move (q,) and what is then left of all rows (n, 3).
    """
    flat = columns.reshape(-1, columns.shape[2])
    inverse = np.linalg.pinv(flat.T @ flat + np.diag(ridge), hermitian=True)
    move_of = extra[own]

    def behind(values):  # sums over the row and all after it
        return np.cumsum(values[::-1], axis=0)[::-1]

    squares = behind(np.einsum("ncq,ncr->nqr", move_of, move_of))
    shared = behind(np.einsum("ncq,ncp->nqp", move_of, columns[own]))
    slope = behind(np.einsum("ncq,nc->nq", move_of, left[own]))
    rows = np.arange(Explanation.LEAST_ROWS, len(own) - Explanation.LEAST_ROWS)
    rest = squares[rows] - shared[rows] @ inverse @ shared[rows].transpose(0, 2, 1)
    # What the rows cannot tell from the fit is no move.
    scale = np.trace(squares[rows], axis1=1, axis2=2)[:, None, None] * np.eye(extra.shape[2])
    moves = np.linalg.solve(rest + _RIDGE * scale, slope[rows][:, :, None])[:, :, 0]
    gains = np.einsum("nq,nq->n", slope[rows], moves)
    best = int(np.argmax(gains))
    row, move = int(rows[best]), moves[best]
    rest = left + columns @ (inverse @ (move @ shared[row]))
    rest[own[row:]] -= move_of[row:] @ move
    return float(gains[best] / max(np.square(left[own]).sum(), 1e-300)), row, move, rest
