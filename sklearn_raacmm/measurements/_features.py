"""Features that a probe touched, and known lengths: what a touch shows, and what is unknown.

Every kind of feature is one entry of `KINDS`. A touch of a surface shows how far the probe is from
it, along its normal; a probe in a cone shows where it is in all three directions.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sklearn_raacmm.arm import MAX_LENGTH_MM
from sklearn_raacmm.utils import Finding, listed, slip_factors, tukey_weights

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


Features = Sequence[tuple[str, float | None]]  # kind and size of each, None where it is unknown


class Linearised(NamedTuple):
    """Touches of a feature about its fitted form, (n, ...), or of several features, (g, n, ...)."""

    residual: np.ndarray  # (n, 3) mm, the point less the nearest one of the form
    directions: np.ndarray  # (n, 3, 3) projection on the directions that a touch shows
    unknowns: np.ndarray  # (n, 3, q) what a unit of each unknown moves the touched point by, mm


class Form(NamedTuple):
    """What was fitted to the touches of a feature, or (g, ...) of several of one kind."""

    centre: np.ndarray  # (3,) mm; of a plane the mean of its touches
    size: Any = None  # mm, of a sphere
    axes: Any = None  # (3, 3) columns: the normal of a plane, and two directions in it


class Kind(NamedTuple):
    """What is special of one kind of feature.

    ``fit(points, size, weights, through)`` is the `Form` of least squares, or the one through as
    many points with weight as it has unknowns, and ``rows(points, form)`` are the `Linearised`
    touches. Where the touches are on a `part` of the feature that is too small, a `simpler` form
    explains them as well; they leave it in the `flat` directions in which they spread least.
    """

    fit: Callable[..., Form]
    rows: Callable[..., Linearised]
    n_unknowns: int
    n_shown: int  # coordinates that a touch shows
    has_size: bool = False
    flat: int = 0
    simpler: str = ""
    part: str = ""


def check_features(
    features: Iterable[Sequence[Any]], labels: Sequence[Hashable]
) -> tuple[list[tuple[str, None]], list[tuple[int, int, float, float, int]]]:
    """What was touched under each of the labels, and the sizes that are stated.

    `features` are (label, kind), (label, kind, size, standard deviation) or with "outside" or
    "inside", the side that was touched. The first list has (kind, None) for each label, a cone
    where nothing is said; the second (number, number, size, standard deviation, sign of the probe's
    own ball in the size, or 0 where no side is said).
    """
    found, sizes = dict.fromkeys(range(len(labels)), "cone"), []
    features, number = listed("features", features), {label: i for i, label in enumerate(labels)}
    for entry in features:
        try:
            label, kind, *stated = entry
            size, sd = (float(stated[0]), float(stated[1])) if stated else (1.0, 1.0)
            side = _SIDES[stated[2]] if stated[2:] else 0
        except (TypeError, ValueError, IndexError, KeyError):
            raise ValueError(
                "each of features must be (label, kind), perhaps with size and standard deviation "
                f'in mm, and then "outside" or "inside", got {entry!r:.80}.'
            ) from None
        if kind not in KINDS:
            raise ValueError(f"a feature is a {', '.join(KINDS)}, got {entry!r:.80}.")
        if label not in number:
            raise ValueError(f"features name {label!r}, which has no rows.")
        if stated and not KINDS[kind].has_size:
            raise ValueError(f"a {kind} has no size, got {entry!r:.80}.")
        if not (0 < size < np.inf and 0 < sd < np.inf):
            raise ValueError(
                f"size and standard deviation of a feature must be above 0, got {entry!r:.80}."
            )
        found[number[label]] = kind
        if stated:
            sizes.append((number[label], number[label], size, sd, side))
    if len({entry[0] for entry in features}) < len(features):
        raise ValueError("features name a label twice.")
    return [(kind, None) for kind in found.values()], sizes


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
    in_bounds = 0 < length <= 2 * MAX_LENGTH_MM and _LEAST_SD_MM <= sd < np.inf
    if not in_bounds or first == second:
        raise ValueError(
            f"a length must join two different groups, it must be positive and at most "
            f"{2 * MAX_LENGTH_MM:g} mm and its standard deviation at least {_LEAST_SD_MM:g} mm, "
            f"got {entry!r:.60}."
        )
    return labels.index(first), labels.index(second), length, sd


def linearise(
    kind: str, points: np.ndarray, size: ArrayLike | None = None, weights: np.ndarray | None = None
) -> Linearised:
    """Touches of a feature about the form that is fitted to them.

    Parameters
    ----------
    kind : str
        A name of `KINDS`: "cone" (a point that is held: its place is unknown, 3), "plane" (unknown
        are its shift along the normal in mm, and two turns in rad) or "sphere" (its centre in mm,
        and its size).
    points : ndarray of shape (n, 3) or (g, n, 3)
        Where the arm says that the centre of the probe was, mm; of g features of one kind.
    size : float or ndarray of shape (g,), default=None
        Diameter of the sphere on which the centre of the probe was, mm: the form has this size,
        and the last unknown is by how many mm the true one is larger. None: the form has the size
        that fits best.
    weights : ndarray of shape (n,) or (g, n), default=None
        Weights of the touches in the fit. None: all count alike, slips, too; see `touch_weights`.

    Returns
    -------
    Linearised
        Residual (n, 3) in mm, directions (n, 3, 3), and unknowns (n, 3, q); (g, n, ...) of several.
    """
    weights = np.ones(points.shape[:-1]) if weights is None else weights
    return KINDS[kind].rows(points, KINDS[kind].fit(points, size, weights))


def linearised(
    features: Features, codes: np.ndarray, points: np.ndarray, weights: np.ndarray | None = None
) -> Linearised:
    """Rows (n, 3) of several features, (kind, size) each, by the feature of each row, `codes` (n,).

    Unknowns are filled up with columns of zeros to the largest number that a feature has. Features
    of one kind are fitted together. Without weights (n,) those of `touch_weights` are taken.
    """
    return with_forms(features, codes, points, weights)[0]


def with_forms(
    features: Features, codes: np.ndarray, points: np.ndarray, weights: np.ndarray | None = None
) -> tuple[Linearised, list[Form]]:
    """Rows as `linearised` has them, and the form of each feature."""
    n, q = len(points), max((KINDS[kind].n_unknowns for kind, _ in features), default=0)
    whole = Linearised(np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3, q)))
    weights = touch_weights(features, codes, points) if weights is None else weights
    alike: dict[tuple[str, bool], list[int]] = {}
    for code, (kind, size) in enumerate(features):
        alike.setdefault((kind, size is None), []).append(code)
    order, forms = np.argsort(codes, kind="stable"), [Form(np.zeros(3))] * len(features)
    ends = np.searchsorted(codes[order], np.arange(len(features) + 1))
    for (kind, is_open), members in alike.items():
        of = np.array(members)
        counts = ends[of + 1] - ends[of]
        place = np.arange(counts.max(initial=0))
        used = place < counts[:, None]
        # Features of fewer rows are filled up with their first one, without weight.
        rows = order[ends[of][:, None] + np.where(used, place, 0)]
        sizes = None if is_open else np.array([features[code][1] for code in members])
        form = KINDS[kind].fit(points[rows], sizes, weights[rows] * used)
        part, own = KINDS[kind].rows(points[rows], form), rows[used]
        whole.residual[own], whole.directions[own] = part.residual[used], part.directions[used]
        whole.unknowns[own, :, : part.unknowns.shape[-1]] = part.unknowns[used]
        for i, code in enumerate(members):
            each: Any = (None if value is None else value[i] for value in form)
            forms[code] = Form(*each)
    return whole, forms


def touch_weights(features: Features, codes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Weights (n,) of the touches of several features, 0 for slips, without any model of the arm.

    Parameters as in `linearised`. Points of cones are weighed by `slip_factors`, touches of a
    surface by a robust fit of it.
    """
    weights = np.ones(len(points))
    cones = np.isin(codes, [i for i, (kind, _) in enumerate(features) if kind == "cone"])
    weights[cones] = slip_factors(points[cones], np.unique(codes[cones], return_inverse=True)[1])
    for code, (kind, size) in enumerate(features):
        if KINDS[kind].flat:
            own = codes == code
            weights[own] = _touch_weights(KINDS[kind], points[own], size)
    return weights


def _touch_weights(of, points, size):
    """Weights (n,) of the touches of one surface.

    The fit starts from the form through a few touches that half of all are nearest to, and then
    weighs the touches by Tukey's biweight.
    """
    n = len(points)
    if n < of.n_unknowns + 3:  # too few to say which of them is a slip
        return np.ones(n)

    def left(weights, through=False):  # (..., n) mm
        many = np.broadcast_to(points, (*weights.shape, 3))
        form = of.fit(many, size, weights, through)
        return np.linalg.norm(of.rows(many, form).residual, axis=-1)

    order = np.random.default_rng(0).random((_SAMPLES, n)).argsort(axis=1)
    off = left((order < of.n_unknowns).astype(float), through=True)
    halves = np.median(off, axis=1)
    best = int(np.argmin(halves))
    weights = (off[best] <= halves[best]).astype(float)
    for _ in range(_ROUNDS):
        before, weights = weights, tukey_weights(left(weights)[:, None])
        if np.array_equal(weights, before):
            break
    return weights


def known_length(one: Form, other: Form) -> tuple[float, np.ndarray, np.ndarray]:
    """Length between two features, mm, and its slopes by the unknowns of either, (4,) each.

    Between centres, or across planes along their common normal. Of a feature and itself it is its
    size, with the slopes in the first.
    """
    if one is other:
        return float(one.size), np.eye(4)[3], np.zeros(4)
    gap, slopes = one.centre - other.centre, np.zeros((2, 4))
    normals = [form.axes[:, 0] for form in (one, other) if form.axes is not None]
    mean = np.sum([n * np.sign(n @ normals[0]) for n in normals], axis=0) if normals else gap
    along = mean / max(np.linalg.norm(mean), 1e-12)
    along = along if along @ gap >= 0 else -along
    for form, sign, slope in zip((one, other), (1, -1), slopes, strict=True):
        if form.axes is None:
            slope[:3] = sign * along
        else:  # a turn of one of two planes turns the common normal by half
            same = form.axes[:, 0] @ along
            slope[:3] = sign * same, *(-np.sign(same) / len(normals) * (gap @ form.axes[:, 1:]))
    return float(gap @ along), slopes[0], slopes[1]


def probe_offsets(kinds: Sequence[str], tip_diameter: float, sign: int = 0) -> np.ndarray:
    """By how many mm a length is longer for the centre of the probe, as its sides may be.

    `kinds` are those of its two ends, or the one of a size, of which the `sign` of the side may be
    known. Of two planes both may be touched from one side, too.
    """
    n_planes = sum(kind == "plane" for kind in kinds)
    sides = ((0,), (-0.5, 0.5), (-1, 0, 1))[n_planes] if len(kinds) > 1 else (-1, 1)
    return tip_diameter * np.array([sign] if sign else sides, dtype=float)


def touch_findings(
    features: Features,
    codes: np.ndarray,
    points: np.ndarray | None,
    labels: Sequence[Hashable],
    lengths: Sequence[tuple[int, int, float, float]] = (),
) -> Iterator[Finding]:
    """Yield features whose touches do not show what they are: a ball on a cap, a plane on a line.

    And planes that are not parallel, though one of the `lengths` is between them. `features` are
    (kind, size) each and `labels` their names, `codes` (n,) the feature of each row. Without points
    (n, 3), of an arm that is not calibrated, those that have too few touches.
    """
    for code, ((kind, size), label) in enumerate(zip(features, labels, strict=True)):
        rows, of = np.flatnonzero(codes == code), KINDS[kind]
        n_unknown = of.n_unknowns - (of.has_size and size is not None)
        if not of.flat or (points is not None and len(rows) <= n_unknown):
            continue
        if points is None:
            if len(rows) <= n_unknown:
                text = (
                    f"The {kind} {label} has {len(rows)} touches, but {n_unknown} numbers of it "
                    "are unknown: its touches say nothing."
                )
                yield Finding("few-touches", text, "Touch it more often.", positions=(label,))
            continue
        own = points[rows]
        weights = _touch_weights(of, own, size)
        left = np.square(linearise(kind, own, size, weights).residual).sum(axis=1)
        away = own - _mean(own, None, weights)
        spread = np.linalg.eigvalsh((weights[:, None] * away).T @ away)[: of.flat].sum()
        # Standard deviations, as of fits whose unknowns have taken a part.
        free = np.maximum(weights.sum() - np.array([n_unknown, 4 - of.flat]), 1.0)
        form, simpler = np.sqrt(np.array([weights @ left, max(spread, 0.0)]) / free)
        if form + _NOTHING_MM > _TELLS_APART * simpler:
            text = (
                f"The {kind} {label} was touched on {of.part} only: a {of.simpler} leaves "
                f"{simpler:.2g} mm of its {len(own)} touches, and a {kind} {form:.2g} mm."
            )
            advice = "Touch all of it that the probe can reach."
            yield Finding("touches-alike", text, advice, positions=(label,), size_mm=form)
    ends = [entry[:2] for entry in lengths if entry[0] != entry[1]]
    pairs = [pair for pair in ends if all(features[code][0] == "plane" for code in pair)]
    if points is None or not pairs:
        return
    forms = with_forms(features, codes, points)[1]
    for pair in pairs:
        one, other = (forms[code].axes[:, 0] for code in pair)
        turn = np.arccos(min(abs(one @ other), 1.0))
        if turn > _NOT_PARALLEL:
            names = tuple(labels[code] for code in pair)
            text = (
                f"A length is known between the planes {names[0]} and {names[1]}, which are turned "
                f"by {np.rad2deg(turn):.2g} degrees to each other."
            )
            advice = "It needs parallel planes: look at the labels."
            yield Finding("planes-not-parallel", text, advice, "repair", positions=names)


def _mean(points, size, weights):
    total = weights.sum(axis=-1)[..., None]
    return np.einsum("...n,...nc->...c", weights, points) / total


def _point(points, size, weights, through=False):
    return Form(_mean(points, size, weights))


def _point_rows(points, form):
    whole = np.broadcast_to(np.eye(3), (*points.shape, 3))
    return Linearised(points - form.centre[..., None, :], whole, whole)


def _plane(points, size, weights, through=False):
    centre = _mean(points, size, weights)
    away = points - centre[..., None, :]
    spread = np.einsum("...n,...nc,...nd->...cd", weights, away, away)
    return Form(centre, axes=np.linalg.eigh(spread)[1])


def _plane_rows(points, form):
    axes = form.axes
    along = (points - form.centre[..., None, :]) @ axes  # (..., n, 3): off the plane, and in it
    normal = np.broadcast_to(axes[..., None, :, 0], points.shape)
    turned = np.concatenate([np.ones_like(along[..., :1]), along[..., 1:]], axis=-1)
    directions = normal[..., :, None] * normal[..., None, :]
    unknowns = normal[..., :, None] * turned[..., None, :]
    return Linearised(along[..., :1] * normal, directions, unknowns)


def _sphere(points, size, weights, through=False):
    """The sphere of least squares of the distances of the points from it."""
    mean = _mean(points, size, weights)
    away = points - mean[..., None, :]
    ones = np.ones_like(away[..., :1])

    def solved(columns, target, weights=weights):
        sides = np.swapaxes(weights[..., None] * columns, -1, -2)
        normal = sides @ columns
        ridge = _RIDGE * np.trace(normal, axis1=-2, axis2=-1)[..., None, None]
        normal = normal + (ridge + _LEAST_SQUARE) * np.eye(columns.shape[-1])
        return np.linalg.solve(normal, sides @ target[..., None])[..., 0]

    # |p|^2 = 2 p.c + (r^2 - |c|^2) is linear in its unknowns and starts the geometric fit. Touches
    # of something else, far away, would count by the fourth power of their distance.
    square = np.square(away).sum(axis=-1)
    usual = np.median(square, axis=-1, keepdims=True) + _LEAST_SQUARE
    less = weights / np.square(np.maximum(square / usual, 1.0))
    found = solved(np.concatenate([2 * away, ones], axis=-1), square, less)
    centre = found[..., :3]
    radius = np.sqrt(np.maximum(found[..., 3] + np.square(centre).sum(axis=-1), _LEAST_SQUARE))
    if size is not None:  # a sphere of another size through the same touches is on the same line
        centre, radius = centre * (size / 2 / radius)[..., None], size / 2 + 0 * radius
    for _ in range(0 if through else _MOST_STEPS):
        off = away - centre[..., None, :]
        distance = np.linalg.norm(off, axis=-1)
        outward = off / np.maximum(distance, _LEAST_SQUARE)[..., None]
        columns = outward if size is not None else np.concatenate([outward, ones], axis=-1)
        step = solved(columns, distance - radius[..., None])
        centre, radius = centre + step[..., :3], radius + step[..., 3:].sum(axis=-1)
        if (np.abs(step).max(axis=-1) <= _SETTLED * np.abs(radius)).all():
            break
    return Form(centre + mean, 2 * radius)


def _sphere_rows(points, form):
    off = points - form.centre[..., None, :]
    distance = np.linalg.norm(off, axis=-1)[..., None]
    outward = off / np.maximum(distance, _LEAST_SQUARE)
    directions = outward[..., :, None] * outward[..., None, :]
    shift = np.broadcast_to(np.eye(3), directions.shape)
    unknowns = np.concatenate([shift, outward[..., :, None] / 2], axis=-1)
    return Linearised((distance - form.size[..., None, None] / 2) * outward, directions, unknowns)


KINDS: dict[str, Kind] = {
    "cone": Kind(_point, _point_rows, 3, 3),
    "plane": Kind(_plane, _plane_rows, 3, 1, flat=2, simpler="line", part="a line"),
    "sphere": Kind(
        _sphere, _sphere_rows, 4, 1, has_size=True, flat=1, simpler="plane", part="a small cap"
    ),
}
