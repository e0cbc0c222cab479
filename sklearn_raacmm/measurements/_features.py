"""Features that a probe touched, and known lengths: what a touch shows, and what is unknown.

Every kind of feature is one class in `KINDS`. A touch of a surface shows how far the probe is from
it, along its normal; a probe in a cone shows where it is in all three directions.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Hashable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.utils import Finding, Groups, listed, tukey_weights

# Samples of touches that a first fit starts from, of which the one wins that half of all touches
# are nearest to, and rounds of weights. Of 200 simulated planes and balls of 12 touches, three of
# them slips, 197 kept no slip (``tests/measurements/test_features.py``).
_SAMPLES, _ROUNDS = 30, 6
# Steps of a sphere, and the part of its size below which a step is the last.
_MOST_STEPS, _SETTLED = 20, 1e-10
# Part of the squares of a step's columns that is added: touches of a flat cap show no sphere.
_RIDGE = 1e-13
# A form has to leave less than this part of what a simpler one leaves of the same touches: a plane
# of a line, a sphere of a plane; and so many mm are nothing. A choice.
_TELLS_APART, _NOTHING_MM = 0.5, 1e-6
# Turn of two planes to each other, rad, from which on no length is between them: of the blocks of
# 36 simulated tests it came to 0.011 (``datasets.make_features``, 15 or 25 touches of each face).
_NOT_PARALLEL = 0.05
_LEAST_SQUARE = 1e-300  # of a distance: no division by 0

# The probe's own ball makes an outside larger for its centre, and an inside smaller.
_SIDES = {"outside": 1, "inside": -1}

# A picometre: smaller than any length is known, large enough to divide by.
_LEAST_SD_MM = 1e-9
# Lengths are stated at 20 degrees C (ISO 1). Steel grows by 11.5e-6 of itself per K (ISO 3650). No
# length is used so far from there, and no solid grows faster.
_REFERENCE_C, _STEEL = 20.0, 11.5e-6
_MOST_KELVIN, _MOST_EXPANSION = 60.0, 3e-4
_NO_GROWTH = (_REFERENCE_C, _STEEL)  # of an entry without temperature
# Labels that a message lists.
_LABELS_SHOWN = 12


class Linearised(NamedTuple):
    """Touches of features about their fitted forms, (n, ...) or (g, n, ...) of g of one kind."""

    residual: np.ndarray  # (n, 3) mm, the point less the nearest one of the form
    directions: np.ndarray  # (n, 3, 3) projection on the directions that a touch shows
    unknowns: np.ndarray  # (n, 3, q) what a unit of each unknown moves the touched point by, mm
    forms: Any = ()  # the `Form` of each feature


class Form(NamedTuple):
    """What was fitted to the touches of a feature, or (g, ...) of several of one kind."""

    centre: np.ndarray  # (3,) mm; of a plane the mean of its touches
    size: Any = None  # mm, of a sphere
    axes: Any = None  # (3, 3) columns: the normal of a plane, and two directions in it

    def length_to(self, other: "Form") -> tuple[float, np.ndarray, np.ndarray]:
        """Length to another feature, mm, and its slopes by the unknowns of either, (4,) each.

        Between centres, or across planes along their common normal. Of a feature to itself it is
        its size, with the slopes in the first.
        """
        if other is self:
            return float(self.size), np.eye(4)[3], np.zeros(4)
        gap, slopes = self.centre - other.centre, np.zeros((2, 4))
        normals = [form.axes[:, 0] for form in (self, other) if form.axes is not None]
        mean = np.sum([n * np.sign(n @ normals[0]) for n in normals], axis=0) if normals else gap
        along = mean / max(np.linalg.norm(mean), 1e-12)
        along = along if along @ gap >= 0 else -along
        for form, sign, slope in zip((self, other), (1, -1), slopes, strict=True):
            if form.axes is None:
                slope[:3] = sign * along
            else:  # a turn of one of two planes turns the common normal by half
                same = form.axes[:, 0] @ along
                slope[:3] = sign * same, *(-np.sign(same) / len(normals) * (gap @ form.axes[:, 1:]))
        return float(gap @ along), slopes[0], slopes[1]


class Features:
    """What rows are touches of: features of one kind or several, fitted without a model of the arm.

    `kinds` are names of `KINDS`, and `codes` (n,) number the feature of each row. Of what was
    stated, `sizes` are (number, number, size, standard deviation, sign of the probe's own ball in
    the size, or 0 where no side is said), mm.
    """

    def __init__(self, kinds: Sequence[str], codes: np.ndarray) -> None:
        self.kinds: list[str] = list(kinds)
        self.codes: np.ndarray = codes
        self.sizes: list[tuple[int, int, float, float, int]] = []

    @classmethod
    def stated(
        cls, features: Iterable[Sequence[Any]], labels: Sequence[Hashable], codes: np.ndarray
    ) -> "Features":
        """What was touched under each of the labels, a cone where nothing is said.

        `features` are (label, kind), (label, kind, size, standard deviation) or with "outside" or
        "inside", the side that was touched.
        """
        found, named = cls(["cone"] * len(labels), codes), set()
        number = {label: i for i, label in enumerate(labels)}
        for entry in listed("features", features):
            try:
                label, kind, *stated = entry
                size, sd = (float(stated[0]), float(stated[1])) if stated else (1.0, 1.0)
                side = _SIDES[stated[2]] if stated[2:] else 0
            except (TypeError, ValueError, IndexError, KeyError):
                raise ValueError(
                    "each of features must be (label, kind), perhaps with size and standard "
                    f'deviation in mm, and then "outside" or "inside", got {entry!r:.80}.'
                ) from None
            if kind not in KINDS:
                raise ValueError(f"a feature is a {', '.join(KINDS)}, got {entry!r:.80}.")
            if label not in number:
                raise ValueError(f"features name {label!r}, which has no rows.")
            if label in named:
                raise ValueError("features name a label twice.")
            if stated and not KINDS[kind].has_size:
                raise ValueError(f"a {kind} has no size, got {entry!r:.80}.")
            if not (0 < size < np.inf and 0 < sd < np.inf):
                raise ValueError(
                    f"size and standard deviation of a feature must be above 0, got {entry!r:.80}."
                )
            named.add(label)
            i = number[label]
            found.kinds[i] = kind
            if stated:
                found.sizes.append((i, i, size, sd, side))
        return found

    @property
    def n_shown(self) -> np.ndarray:
        """How many coordinates a touch of each feature shows, (n_features,)."""
        return np.array([KINDS[kind].n_shown for kind in self.kinds], dtype=int)

    @property
    def n_unknowns(self) -> np.ndarray:
        """How many numbers of each feature are unknown, (n_features,)."""
        return np.array([KINDS[kind].n_unknowns for kind in self.kinds], dtype=int)

    @property
    def scatter(self) -> np.ndarray:
        """Whether touches of each feature can scatter about it, (n_features,)."""
        count = np.bincount(self.codes, minlength=len(self.kinds))
        return count * self.n_shown > self.n_unknowns

    @cached_property
    def _alike(self):
        """Of each kind its features, the rows (g, n) of each, and which of these are used.

        Features of one kind are fitted together. Those of fewer rows are filled up with their first
        one, without weight.
        """
        order, found = np.argsort(self.codes, kind="stable"), {}
        ends = np.searchsorted(self.codes[order], np.arange(len(self.kinds) + 1))
        for kind in dict.fromkeys(self.kinds):
            members = np.flatnonzero([one == kind for one in self.kinds])
            counts = ends[members + 1] - ends[members]
            place = np.arange(counts.max(initial=0))
            used = place < counts[:, None]
            found[kind] = members, order[ends[members][:, None] + np.where(used, place, 0)], used
        return found

    def linearised(self, points: np.ndarray, weights: np.ndarray | None = None) -> Linearised:
        """The rows about the forms that are fitted to their points (n, 3), mm.

        Unknowns are filled up with columns of zeros to the largest number that a feature has.
        Without weights (n,) those of `weights` are taken.
        """
        n, q = len(points), self.n_unknowns.max(initial=0)
        forms: list[Any] = [None] * len(self.kinds)
        whole = Linearised(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, q)), forms)
        weights = self.weights(points) if weights is None else weights
        for kind, (members, rows, used) in self._alike.items():
            form = KINDS[kind].fit(points[rows], weights[rows] * used)
            part, own = KINDS[kind].rows(points[rows], form), rows[used]
            whole.residual[own], whole.directions[own] = part.residual[used], part.directions[used]
            whole.unknowns[own, :, : part.unknowns.shape[-1]] = part.unknowns[used]
            for i, code in enumerate(members.tolist()):
                parts: Any = (value if value is None else value[i] for value in form)
                forms[code] = Form(*parts)
        return whole

    def weights(self, points: np.ndarray) -> np.ndarray:
        """Weights (n,) of the touches, 0 for slips, without any model of the arm.

        Points of cones are weighed by `slip_factors`, touches of a surface by a robust fit of it.
        """
        weights = np.ones(len(points))
        cones = np.isin(self.codes, [i for i, kind in enumerate(self.kinds) if kind == "cone"])
        codes = np.unique(self.codes[cones], return_inverse=True)[1]
        weights[cones] = Groups(codes).slip_factors(points[cones])
        for code, kind in enumerate(self.kinds):
            if KINDS[kind].flat:
                own = self.codes == code
                weights[own] = _weights_of_surface(KINDS[kind], points[own])
        return weights

    def few(self, labels: Sequence[Hashable]) -> Iterator[Finding]:
        """Yield surfaces that have too few touches; `labels` are the names of the features."""
        for code in np.flatnonzero(~self.scatter).tolist():
            kind, label = self.kinds[code], labels[code]
            if kind != "cone":
                text = (
                    f"The {kind} {label} has {np.sum(self.codes == code)} touches, but "
                    f"{self.n_unknowns[code]} numbers of it are unknown: its touches say nothing."
                )
                yield Finding("few-touches", text, "Touch it more often.", positions=(label,))

    def findings(
        self,
        points: np.ndarray,
        labels: Sequence[Hashable],
        lengths: Sequence[tuple[int, int, float, float]] = (),
    ) -> Iterator[Finding]:
        """Yield features whose touches do not show what they are, such as a ball touched on a cap.

        And planes that are not parallel, though one of the `lengths` is between them. `labels` are
        the names of the features, and `points` (n, 3) those of an arm that is calibrated.
        """
        for code in np.flatnonzero(self.scatter).tolist():
            if not (of := KINDS[kind := self.kinds[code]]).flat:
                continue
            own, label = points[self.codes == code], labels[code]
            weights = _weights_of_surface(of, own)
            left = np.square(of.rows(own, of.fit(own, weights)).residual).sum(axis=1)
            away = own - _mean(own, weights)
            spread = np.linalg.eigvalsh((weights[:, None] * away).T @ away)[: of.flat].sum()
            # Standard deviations, as of fits whose unknowns have taken a part.
            free = np.maximum(weights.sum() - np.array([of.n_unknowns, 4 - of.flat]), 1.0)
            form, simpler = np.sqrt(np.array([weights @ left, max(spread, 0.0)]) / free)
            if form + _NOTHING_MM > _TELLS_APART * simpler:
                text = (
                    f"The {kind} {label} was touched on {of.part} only: a {of.simpler} leaves "
                    f"{simpler:.2g} mm of its {len(own)} touches, and a {kind} {form:.2g} mm."
                )
                advice = "Touch all of it that the probe can reach."
                yield Finding("touches-alike", text, advice, positions=(label,), size_mm=form)
        ends = [(i, j) for i, j, *_ in lengths if i != j]
        pairs = [pair for pair in ends if all(self.kinds[code] == "plane" for code in pair)]
        forms = self.linearised(points).forms if pairs else []
        for pair in pairs:
            one, other = (forms[code].axes[:, 0] for code in pair)
            turn = np.arccos(min(abs(one @ other), 1.0))
            if turn > _NOT_PARALLEL:
                names = tuple(labels[code] for code in pair)
                text = (
                    f"A length is known between the planes {names[0]} and {names[1]}, which are "
                    f"turned by {np.rad2deg(turn):.2g} degrees to each other."
                )
                advice = "It needs parallel planes: look at the labels."
                yield Finding("planes-not-parallel", text, advice, "repair", positions=names)


def check_length(entry: Sequence[Any], labels: Sequence[Hashable]) -> tuple[int, int, float, float]:
    """A known length as (position, position, length, sd), positions by their index.

    The length is that at the temperature of the entry, if it has one.
    """
    try:
        first, second, *numbers = entry
        length, sd, celsius, per_kelvin = map(float, [*numbers, *_NO_GROWTH[len(numbers) - 2 :]])
    except (TypeError, ValueError):
        raise ValueError(
            "each of lengths must be (label, label, length, standard deviation), and perhaps its "
            f"temperature and expansion, got {entry!r:.60}."
        ) from None
    if not (abs(celsius - _REFERENCE_C) <= _MOST_KELVIN and 0 <= per_kelvin <= _MOST_EXPANSION):
        raise ValueError(
            f"a length can be at {_REFERENCE_C - _MOST_KELVIN:g} to "
            f"{_REFERENCE_C + _MOST_KELVIN:g} degrees C and grow by 0 to {_MOST_EXPANSION:g} of "
            f"itself per K, got {entry!r:.60}."
        )
    length *= 1 + per_kelvin * (celsius - _REFERENCE_C)
    for label in (first, second):
        if label not in labels:
            some = ", ".join(map(str, labels[:_LABELS_SHOWN]))
            some += ", ..." * (len(labels) > _LABELS_SHOWN)
            raise ValueError(
                f"lengths name the group {label!r}, which has no samples; groups are {some}."
            )
    in_bounds = 0 < length <= 2 * Arm.MAX_LENGTH_MM and _LEAST_SD_MM <= sd < np.inf
    if not in_bounds or first == second:
        raise ValueError(
            f"a length must join two different groups, it must be positive and at most "
            f"{2 * Arm.MAX_LENGTH_MM:g} mm and its standard deviation at least "
            f"{_LEAST_SD_MM:g} mm, got {entry!r:.60}."
        )
    return labels.index(first), labels.index(second), length, sd


def probe_offsets(kinds: Sequence[str], tip_diameter: float, sign: int = 0) -> np.ndarray:
    """By how many mm a length is longer for the centre of the probe, as its sides may be.

    `kinds` are those of its two ends, or the one of a size, of which the `sign` of the side may be
    known. Of two planes both may be touched from one side, too.
    """
    n_planes = sum(kind == "plane" for kind in kinds)
    sides = ((0,), (-0.5, 0.5), (-1, 0, 1))[n_planes] if len(kinds) > 1 else (-1, 1)
    return tip_diameter * np.array([sign] if sign else sides, dtype=float)


def _weights_of_surface(of, points):
    """Weights (n,) of the touches of one surface.

    The fit starts from the form through a few touches that half of all are nearest to, and then
    weighs the touches by Tukey's biweight.
    """
    n = len(points)
    if n < of.n_unknowns + 3:  # too few to say which of them is a slip
        return np.ones(n)

    def left(weights):  # (..., n) mm
        many = np.broadcast_to(points, (*weights.shape, 3))
        return np.linalg.norm(of.rows(many, of.fit(many, weights)).residual, axis=-1)

    order = np.random.default_rng(0).random((_SAMPLES, n)).argsort(axis=1)
    off = left((order < of.n_unknowns).astype(float))
    halves = np.median(off, axis=1)
    best = int(np.argmin(halves))
    weights = (off[best] <= halves[best]).astype(float)
    for _ in range(_ROUNDS):
        before, weights = weights, tukey_weights(left(weights)[:, None])
        if np.array_equal(weights, before):
            break
    return weights


def _mean(points, weights):
    return np.einsum("...n,...nc->...c", weights, points) / weights.sum(axis=-1)[..., None]


def _on_surface(off, normal, by):
    """Touches `off` (..., n) mm along a normal, on which unknowns move them `by` (..., n, q)."""
    along = normal[..., :, None]
    residual = off[..., None] * normal
    return Linearised(residual, along * normal[..., None, :], along * by[..., None, :])


class Cone:
    """A point that is held: its place is unknown.

    As of every kind ``fit(points, weights)`` is the `Form` of least squares, and
    ``rows(points, form)`` are the `Linearised` touches. Where the touches are on a `part` of the
    feature that is too small, a `simpler` form explains them as well; they leave it in the `flat`
    directions in which they spread least.
    """

    n_unknowns, n_shown = 3, 3  # `n_shown`: coordinates that a touch shows
    has_size, flat, simpler, part = False, 0, "", ""

    def fit(self, points, weights):
        return Form(_mean(points, weights))

    def rows(self, points, form):
        whole = np.broadcast_to(np.eye(3), (*points.shape, 3))
        return Linearised(points - form.centre[..., None, :], whole, whole)


class Plane:
    """Unknown are its shift along the normal in mm, and two turns in rad."""

    n_unknowns, n_shown = 3, 1
    has_size, flat, simpler, part = False, 2, "line", "a line"

    def fit(self, points, weights):
        centre = _mean(points, weights)
        away = points - centre[..., None, :]
        spread = np.einsum("...n,...nc,...nd->...cd", weights, away, away)
        return Form(centre, axes=np.linalg.eigh(spread)[1])

    def rows(self, points, form):
        along = (points - form.centre[..., None, :]) @ form.axes  # off the plane, and in it
        normal = np.broadcast_to(form.axes[..., None, :, 0], points.shape)
        turned = np.concatenate([np.ones_like(along[..., :1]), along[..., 1:]], axis=-1)
        return _on_surface(along[..., 0], normal, turned)


class Sphere:
    """Unknown are its centre and its size, mm: the diameter of the sphere of the probe's centre."""

    n_unknowns, n_shown = 4, 1
    has_size, flat, simpler, part = True, 1, "plane", "a small cap"

    def fit(self, points, weights):
        """The sphere of least squares of the distances of the points from it."""
        mean = _mean(points, weights)
        away = points - mean[..., None, :]
        ones = np.ones_like(away[..., :1])

        def solved(columns, target, weights=weights):
            sides = np.swapaxes(weights[..., None] * columns, -1, -2)
            normal = sides @ columns
            ridge = _RIDGE * np.trace(normal, axis1=-2, axis2=-1)[..., None, None]
            normal = normal + (ridge + _LEAST_SQUARE) * np.eye(4)
            return np.linalg.solve(normal, sides @ target[..., None])[..., 0]

        # |p|^2 = 2 p.c + (r^2 - |c|^2) is linear in its unknowns and starts the geometric fit.
        # Touches of something else, far away, would count by the fourth power of their distance.
        square = np.square(away).sum(axis=-1)
        usual = np.median(square, axis=-1, keepdims=True) + _LEAST_SQUARE
        less = weights / np.square(np.maximum(square / usual, 1.0))
        found = solved(np.concatenate([2 * away, ones], axis=-1), square, less)
        centre = found[..., :3]
        radius = np.sqrt(np.maximum(found[..., 3] + np.square(centre).sum(axis=-1), _LEAST_SQUARE))
        for _ in range(_MOST_STEPS):
            outward, distance = _outward(away, centre)
            step = solved(np.concatenate([outward, ones], axis=-1), distance - radius[..., None])
            centre, radius = centre + step[..., :3], radius + step[..., 3]
            if (np.abs(step).max(axis=-1) <= _SETTLED * np.abs(radius)).all():
                break
        return Form(centre + mean, 2 * radius)

    def rows(self, points, form):
        outward, distance = _outward(points, form.centre)
        by = np.concatenate([outward, np.full_like(outward[..., :1], 0.5)], axis=-1)
        return _on_surface(distance - form.size[..., None] / 2, outward, by)


def _outward(points, centre):
    """Unit vectors (..., n, 3) from a centre to points, and their distances (..., n)."""
    off = points - centre[..., None, :]
    distance = np.linalg.norm(off, axis=-1)
    return off / np.maximum(distance, _LEAST_SQUARE)[..., None], distance


KINDS: dict[str, Any] = {"cone": Cone(), "plane": Plane(), "sphere": Sphere()}
