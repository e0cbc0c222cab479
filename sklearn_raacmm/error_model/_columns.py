"""Columns of the linear error model of an arm: what one arc second of each cause does to the probe.

Every column is the displacement of the probe in mm that one unit of a coefficient causes. The unit
is one arc second, or, for lengths, the length that one arc second spans at the arm's reach. So all
coefficients of a family are of one size, whatever the size of the arm.

One table says what each column is, see `Column`. `Columns` computes the columns from it, and the
export to C writes the same table into its source.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import re
from collections.abc import Callable
from enum import IntEnum
from functools import cached_property, lru_cache
from itertools import compress, product
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.blas import dtrmm

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.utils import chunks

ARCSEC = np.pi / 180 / 3600
# Families of columns, each with a prior of its own, that of the causes of users among them; then
# that of harmonics that are taken for themselves, and that of all low orders together.
(
    GRAVITY, KINEMATICS, WOBBLE, GUIDE, TEMPERATURE, DIRECTION, FORCE, BASE, OWN, HARMONICS, SMOOTH,
) = range(11)  # fmt: skip
FAMILIES = (
    "gravity", "kinematics", "wobble", "guide", "temperature", "direction", "force", "base", "own",
    "harmonics", "smooth",
)  # fmt: skip
# The families that `ArmResidualRegressor` names in `causes`.
CAUSES = ("gravity", "kinematics", "wobble")
# Those that stay out where they are not worth their price.
FAMILIES_OF_EXTRA = (TEMPERATURE, DIRECTION, FORCE, BASE, OWN)
# An axis nods once a turn where it leans, twice where its bearing is oval.
_WOBBLE_ORDERS = (1, 2)
# Half waves along its travel by which a guide is not straight; higher ones are smaller by the
# square of their number. Up to 8 half waves, or smaller by their number alone, left 18 % more of a
# gantry and as much of a rail (errors of ``tests/error_model/test_sliding.py``, three seeds).
_GUIDE_ORDERS = (1, 2, 3, 4)
# What counts as one radian where the noise of joints is compared, mm.
_METRE = 1000.0
# What places the base and is not in its table: shifts along and turns about x and y. Columns that
# move the arm as a whole, the first axis standing still in the base.
_BASE = ("base_x", "base_y", "base_alpha", "base_beta")
BASE_MOTIONS = ("d1", "theta_offset1", *_BASE)
# Shorter lengths of the table do not grow: 1 mm of aluminium grows by 0.02 um per K.
_LEAST_GROWING_MM = 1.0
# Waves of one joint from which on a product per joint is faster than the columns themselves: ten
# times with 318 harmonics of a UR10; of one row and few waves half as fast.
_LONG_RUN = 24
# What the end of a cantilever under a load F there slopes by beside the turn F L^2 / (3 E I) that
# moves it, in parts of that: F L^2 / (6 E I).
_OF_END = 0.5
# What a bending base shifts by where it turns by one arc second: over this length, mm. Any will do.
_OF_BASE_MM = 500.0
# Poses of which all axes are held at a time, to take the levers of the joints from them: 4 MB.
_CHUNK = 4096
# Poses whose columns are made at a time for their product with coefficients.
_POSES = 512
# What a column may be: the word, and behind some the number of a joint or an axis.
_NAME = re.compile(
    r"temperature|time|payload|base height"
    r"|(?:temperature|direction)\s+(?P<joint>\d+)|force\s+(?P<axis>[xyz])"
)
_FORMS = (
    '"temperature", "temperature J", "direction J" (J the number of a joint from 1), "time", '
    '"payload", "base height", "force x", "force y", "force z"'
)


class Effect(IntEnum):
    """What a column does: a small turn about an axis of a frame, or a small shift along it.

    Or a turn about it in proportion to the torque about that axis of a load, or of a force on the
    probe, which pushes; or a shift along x or y in proportion to the torque about y or x: what
    bends leans. Or a shift along it in proportion to how far along it one frame is from the last.
    """

    TURN = 0
    SHIFT = 1
    LOAD = 2
    PUSH = 3
    LEAN = 4
    GROW = 5


TURN, SHIFT, LOAD, PUSH, LEAN, GROW = Effect
# Those of loads: along the vertical, in which they are linear.
OF_LOADS = LOAD, LEAN


class Terms(NamedTuple):
    """Which columns there are.

    harmonics (n_pairs, 2): joint from 0 and order; each is a cosine and a sine column, first of
    all. Then those of the families that are on.
    extra: name and reference of each column of X after the angles, as `with_references` makes them.
    up: direction against gravity where the data have found another one than the arm states.
    own: functions that make columns, the causes of a user.
    """

    harmonics: np.ndarray
    gravity: bool
    kinematics: bool
    wobble: bool
    extra: tuple[Any, ...] = ()
    up: tuple[float, ...] = ()
    own: tuple[Callable[..., Any], ...] = ()


class Column(NamedTuple):
    """One column that is no harmonic of an encoder: its name, and how it moves the probe.

    A cause of your own is a function of the arm and of the names of the extra columns that yields
    such columns, of the family `OWN`. That of a module, not a lambda, can be pickled. Joint j, from
    1, turns about z of frame j - 1, in the modified convention of frame j. A joint whose friction
    grows with gravity's torque stops short by its direction times the torque:

    >>> from sklearn_raacmm import ArmResidualRegressor
    >>> from sklearn_raacmm.error_model import OWN, Column, Effect
    >>> def friction(arm, extra):
    ...     turn = OWN, Effect.LOAD, 1, 2, 5e-6 / arm.reach_mm  # about z of frame 1: of joint 2
    ...     by = extra.index("direction 2")
    ...     for load in range(2, arm.n_joints + 2):  # at further frames, and at the probe
    ...         yield Column(f"friction by load {load}", *turn, load=load, by=by)
    >>> model = ArmResidualRegressor(extra=["direction 2"], causes=["kinematics", friction])
    """

    name: str
    family: int
    kind: int  # of `Effect`
    frame: int  # whose axis it is: 0 is the base
    axis: int  # 0, 1, 2: x, y, z of the frame
    unit: float  # rad or mm per unit coefficient; for LOAD per mm of lever, too
    joint: int = 0  # of the wave, from 0
    order: int = 0  # of the wave: cosine if positive, sine if negative, none if 0
    load: int = 0  # for LOAD the frame of the load, n_joints + 1: the probe; for GROW the next one
    by: int = -1  # the extra column that multiplies it, from 0; -1: none
    reference: float = 0.0  # what is taken off that column before


_NUMBERS = np.dtype([(name, kind) for name, kind in [*Column.__annotations__.items()][1:]])


def _first_frame(arm):
    """Frame whose z axis the first joint turns about."""
    return 0 if arm.convention == "standard" else 1


def _of_encoder(arm, j):
    """Effect and unit of an error of a joint's encoder."""
    if arm.joint_types[j] == "P":
        return SHIFT, np.sign(arm.joint_signs[j]) * ARCSEC * arm.reach_mm
    return TURN, arm.joint_signs[j] * ARCSEC


def _harmonics(arm, pairs):
    """Waves of the error of each joint's encoder: a cosine and a sine for each order."""
    waves, joint = np.zeros(2 * len(pairs), dtype=_NUMBERS), np.repeat(pairs[:, 0], 2)
    kinds, units = zip(*(_of_encoder(arm, j) for j in range(arm.n_joints)), strict=True)
    waves["family"], waves["axis"], waves["by"] = HARMONICS, 2, -1
    waves["kind"], waves["unit"] = np.take(kinds, joint), np.take(units, joint)
    waves["joint"], waves["frame"] = joint, joint + _first_frame(arm)
    waves["order"] = np.column_stack([pairs[:, 1], -pairs[:, 1]]).ravel()
    return waves


def _gravity(arm):
    """Turns of each frame about each of its axes, by the torque of each load beyond.

    With e the `vertical`, the torque of unit weight about the axis u through o is
    u . (r x -e) = -(u x r) . e, with r from o to the load: in units of the reach. The end of a
    cantilever slopes, too, about the axis of the torque that a load at its beginning would have
    about its end. Hence the frame before, in a smaller unit, but for the last frame: with it a
    longer probe than the one that was learnt came out four times worse. What carries the part
    instead of the probe, see `Arm.seen_from`, has no columns.
    """
    n, first, unit = arm.n_joints, arm.up_frame, ARCSEC / arm.reach_mm
    for frame, axis in product(range(first, n + 1), range(3)):
        before = range(max(frame - 1, first), frame) if frame < n else ()
        for load in [*before, *range(frame + 1, n + 2)]:
            at = "probe" if load > n else f"frame {load}"
            name = f"load at {at} bends frame {frame} about {'xyz'[axis]}"
            size = unit * (_OF_END if load < frame else 1.0)
            yield Column(name, GRAVITY, LOAD, frame, axis, size, load=load)


def _kinematics(arm):
    """Changes of the table, of where the base stands, and turns beta about y beside those about x.

    A length moves the probe along the axis that carries it; an angle turns it about that axis. A
    table has no beta, which parallel axes need (Hayati). What slides has a scale.
    """
    n, first, length = arm.n_joints, _first_frame(arm), ARCSEC * arm.reach_mm
    # Row i goes along and about z of one of its two frames, and x of the other.
    of_x, of_z = 1 - first, first
    moves = ((SHIFT, of_x, 0), (TURN, of_x, 0), (SHIFT, of_z, 2), (TURN, of_z, 2))
    changes = [
        (f"{field}{i + 1}", kind, i + of, axis)
        for field, (kind, of, axis) in zip(Arm.TABLE[:-1], moves, strict=True)
        for i in range(n)
    ]
    changes += [(f"probe_{'xyz'[axis]}", SHIFT, n, axis) for axis in range(3)]
    moves = ((SHIFT, 0), (SHIFT, 1), (TURN, 0), (TURN, 1))
    changes += [(name, kind, 0, axis) for name, (kind, axis) in zip(_BASE, moves, strict=True)]
    changes += [(f"beta{i + 1}", TURN, i + of_x, 1) for i in range(n)]
    for name, kind, frame, axis in changes:
        yield Column(name, KINEMATICS, kind, frame, axis, length if kind == SHIFT else ARCSEC)
    for j in arm.slides:  # what a millimetre of its scale is longer by
        yield Column(f"scale{j + 1}", KINEMATICS, GROW, j + of_z, 2, ARCSEC, load=j + 1)


def _wobble(arm):
    """Tilts of each joint's axis about the two directions across it."""
    waves, first = (("cos", 1), ("sin", -1)), _first_frame(arm)
    joints = [j for j in range(arm.n_joints) if arm.joint_types[j] == "R"]
    for j, axis, order, (part, sign) in product(joints, range(2), _WOBBLE_ORDERS, waves):
        name = f"joint {j + 1} tilts about {'xy'[axis]}, {part}({order} theta)"
        yield Column(name, WOBBLE, TURN, j + first, axis, ARCSEC, j, sign * order)
    # Straightness along x and y, pitch, yaw and roll: with the waves along z the six errors of a
    # linear axis (ISO 230-1).
    moves = [(SHIFT, axis, "is off along") for axis in range(2)]
    moves += [(TURN, axis, "tilts about") for axis in range(3)]
    slides: list[int] = arm.slides
    of = slides, moves, _GUIDE_ORDERS, waves
    for j, (kind, axis, does), order, (part, sign) in product(*of):
        name = f"joint {j + 1} {does} {'xyz'[axis]}, {part}({order} way)"
        unit = ARCSEC / order**2 * (arm.reach_mm if kind == SHIFT else 1.0)
        yield Column(name, GUIDE, kind, j + first, axis, unit, j, sign * order)


def _temperature(arm, name, by, mean):
    """Growth of lengths and drift of offsets, of all joints or of one, per unit of temperature.

    A length grows in proportion to itself: a coefficient of 1 is one arc second in rad, 4.8 ppm.
    """
    _, joint = parse_extra(name, arm.n_joints)
    of_joint = {f"{field}{joint + 1}" for field in ("a", "d", "theta_offset", "scale")}
    if joint == arm.n_joints - 1:
        of_joint |= {"probe_x", "probe_y", "probe_z"}
    lengths = _lengths(arm)
    for column in _kinematics(arm):
        length = lengths.get(column.name, 0.0)
        grows = abs(length) > _LEAST_GROWING_MM or column.kind == GROW
        if joint >= 0 and column.name not in of_joint:
            continue
        if grows or (column.kind, column.axis) == (TURN, 2):
            unit = ARCSEC * length if grows else ARCSEC
            of = f"{column.name} by {name}"
            yield column._replace(name=of, family=TEMPERATURE, unit=unit, by=by, reference=mean)


def _base(arm, name, by, reference):
    """How what the base stands on gives way, more the higher it stands.

    The end of a column of the height h turns by M h / (E I) and shifts by M h^2 / (2 E I), M the
    torque of each load. With the turn at the mean height, which is gravity's, these are lines in h;
    so is where the base has been found with a part of them.
    """
    unit = ARCSEC / arm.reach_mm  # of all, as a longer probe has it
    # Of half the range of heights, so that all coefficients are of one size.
    per_mm = 2 / ((max(reference) - min(reference)) or 2.0)
    moves = [
        Column(f"base {word} {'xyz'[axis]}", BASE, kind, 0, axis, size * unit)
        for (word, kind, size) in (("along", SHIFT, _OF_BASE_MM**2), ("about", TURN, _OF_BASE_MM))
        for axis in range(3)
    ]
    for load, axis in product(range(1, arm.n_joints + 2), range(2)):
        at = f"load at {'probe' if load > arm.n_joints else f'frame {load}'}"
        lean = f"{at} shifts the base along {'xy'[axis]}"
        leans = Column(lean, BASE, LEAN, 0, axis, _OF_BASE_MM * unit, load=load)
        turn = f"{at} turns the base about {'xy'[axis]}"
        moves += [leans, leans._replace(name=turn, kind=LOAD, unit=unit)]
        yield leans
    for one in moves:
        own = {"name": f"{one.name} by {name}", "unit": per_mm * one.unit}
        yield one._replace(**own, by=by, reference=reference[0])


def _of_extra(arm, extra):
    """What the columns of X after the angles do."""
    if any(parse_extra(name, arm.n_joints)[0] in ("force", "payload") for name, _ in extra):
        # Turns of each frame about each of its axes, by the torque of a force on the probe.
        for frame, axis in product(range(arm.n_joints + 1), range(3)):
            name = f"force bends frame {frame} about {'xyz'[axis]}"
            yield Column(name, FORCE, PUSH, frame, axis, ARCSEC / arm.reach_mm)
    for by, (name, reference) in enumerate(extra):
        kind, joint = parse_extra(name, arm.n_joints)
        if arm.up_frame and kind in ("payload", "base"):
            raise ValueError(
                f"extra names {name!r}, which needs a vertical that stands still in the base: as "
                "seen from a positioner it turns."
            )
        if kind in ("temperature", "time"):
            yield from _temperature(arm, name, by, reference[0])
        elif kind == "base":
            yield from _base(arm, name, by, reference)
        elif kind == "direction":
            (effect, unit), frame = _of_encoder(arm, joint), joint + _first_frame(arm)
            of = f"joint {joint + 1} lags"
            yield Column(of, DIRECTION, effect, frame, 2, unit, by=by, reference=reference[0])


def _of_users(arm, terms, taken):
    """The columns of the causes of users, checked; `taken` are the names of the others."""
    n, known = arm.n_joints, [name for name, _ in terms.extra]
    for cause in terms.own:
        made = cause(arm, known)
        for column in made if np.iterable(made) else [made]:
            if not isinstance(column, Column):
                raise ValueError(f"A cause gives {column!r:.60}: it must yield `Column`s.")
            least, most = (column.frame + 1, n + 1) if column.kind in OF_LOADS else (0, n + 1)
            if column.kind == GROW:
                least = most = column.frame + 1
            rules = {
                "its family must be OWN": column.family == OWN,
                "its kind must be one of Effect": column.kind in list(Effect),
                f"its frame must be 0 to {n}": 0 <= column.frame <= n,
                "its axis must be 0, 1 or 2": column.axis in (0, 1, 2),
                "its unit must be finite": np.isfinite(column.unit),
                f"its joint must be 0 to {n - 1}": 0 <= column.joint < n,
                f"its load must be {least} to {most}": least <= column.load <= most,
                f"its by must be -1, or number one of {known}": -1 <= column.by < len(known),
                "another column has its name": column.name not in taken,
            }
            if broken := [rule for rule, holds in rules.items() if not holds]:
                raise ValueError(f"A cause has {column}: {'; '.join(broken)}.")
            taken.add(column.name)
            mean = terms.extra[column.by][1][0] if column.by >= 0 else 0.0
            yield column._replace(reference=mean)


def _lengths(arm):
    """Lengths of the table by the names of their columns, mm."""
    lengths = {f"{field}{i + 1}": v for field in "ad" for i, v in enumerate(getattr(arm, field))}
    for j in arm.slides:  # grows by its scale, with the way that it goes
        lengths |= {f"d{j + 1}": 0.0, f"scale{j + 1}": 1.0}
    return lengths | dict(zip(("probe_x", "probe_y", "probe_z"), arm.probe, strict=True))


def parse_extra(name, n_joints):
    """Kind of an extra column, and which joint (from 0) or axis (0 to 2) it is of; -1: of all."""
    found = _NAME.fullmatch(name.strip()) if isinstance(name, str) else None
    if found is None:
        raise ValueError(f"extra must hold names of columns, {_FORMS}; got {name!r:.60}.")
    kind, joint, axis = name.split()[0], found["joint"], found["axis"]
    if joint and not 1 <= int(joint) <= n_joints:
        raise ValueError(f"extra names {name!r}, but the arm has joints 1 to {n_joints}.")
    return kind, "xyz".index(axis) if axis else int(joint or 0) - 1


class FactoredColumns:
    """Columns of the model at n poses, those of many waves of one joint as factors.

    The waves of a joint share the vector by which a turn about its axis moves the probe. Products
    with the columns are therefore taken with the waves first: one number for each pose, not three.
    The waves (n, n_waves) come in runs, of which `spans` are the first and last columns and
    `vectors` (n, 3, n_runs) what they share; `rest` (n, 3, m) are the columns after them. `points`
    (n, 3) are those of the probe, mm, and `phases` (n, n_joints) those of the joints.
    """

    def __init__(
        self,
        spans: list[tuple[int, int]],
        vectors: np.ndarray,
        waves: np.ndarray,
        rest: np.ndarray,
        points: np.ndarray,
        phases: np.ndarray,
    ) -> None:
        self.spans: list[tuple[int, int]] = spans
        self.vectors: np.ndarray = vectors
        self.waves: np.ndarray = waves
        self.rest: np.ndarray = rest
        self.points: np.ndarray = points
        self.phases: np.ndarray = phases

    def dot(self, coef: np.ndarray) -> np.ndarray:
        """``columns @ coef``, (n, 3)."""
        n, _, m = self.rest.shape
        out = (self.rest.reshape(3 * n, m) @ coef[len(coef) - m :]).reshape(n, 3)
        for i, (start, end) in enumerate(self.spans):
            out += self.vectors[:, :, i] * (self.waves[:, start:end] @ coef[start:end])[:, None]
        return out

    def squares(self, root: "Root") -> np.ndarray:
        """Squared lengths (n, 3) of ``columns @ half``, of which `root` is made."""
        n, _, m = self.rest.shape
        # One product of all rows takes a quarter of the time of one for each pose.
        dots = root.product(self.rest.reshape(3 * n, m)).reshape(n, 3, -1)
        if not self.spans:
            return np.einsum("ncr,ncr->nc", dots, dots)
        runs = [slice(*span) for span in self.spans]
        shared = np.stack([self.waves[:, run] @ root.shared[run] for run in runs], axis=1)
        dots += self.vectors @ shared
        squares = np.einsum("ncr,ncr->nc", dots, dots)
        for i, (run, covariance) in enumerate(zip(runs, root.beside, strict=True)):
            products = self.waves[:, run] @ covariance
            products *= self.waves[:, run.start :]
            starts = [start - run.start for start, _ in self.spans[i:]]
            of_pairs = np.add.reduceat(products, starts, axis=1)
            both = self.vectors[:, :, i:] @ of_pairs[:, :, None]
            squares += self.vectors[:, :, i] * both[:, :, 0]
        return np.maximum(squares, 0.0, out=squares)


class Root:
    """A root (n_columns, r) of a covariance, arranged for `FactoredColumns.squares`.

    Any root gives the same squares, and a triangle takes half of the products. Where waves come in
    runs, the first columns of the triangle are those that the other columns of the model have:
    `own` and, of the waves, `shared`. What the waves have beside that is taken by its covariance:
    products of two waves are one number for each pose, not three. `beside` has a part for each run,
    its rows and the columns from its first on: what stands behind the run counts twice.
    """

    def __init__(self, half: np.ndarray, spans: list[tuple[int, int]]) -> None:
        m = len(half)
        n_waves = spans[-1][1] if spans else 0
        order = np.roll(np.arange(m), -n_waves)
        root = np.asarray(np.linalg.qr(half[order].T, mode="r")).T
        n_own = m - n_waves
        self.own: np.ndarray = np.ascontiguousarray(root[:n_own, :n_own])
        self.shared: np.ndarray = np.ascontiguousarray(root[n_own:, :n_own])
        alone = root[n_own:, n_own:]
        self.beside: list[np.ndarray] = []
        for start, end in spans:
            part = alone[start:end] @ alone[start:].T
            part[:, end - start :] *= 2.0
            self.beside.append(part)

    def product(self, rows: np.ndarray) -> np.ndarray:
        """``rows @ own``: of a triangle, half of the products are none."""
        if self.own.shape[0] != self.own.shape[1]:
            return rows @ self.own
        return np.asarray(dtrmm(1.0, self.own.T, rows.T)).T


def columns_of(arm: Arm, terms: Terms) -> "Columns":
    """Columns of an arm, which are made once."""
    return _without_harmonics(arm, *terms[1:]).with_harmonics(terms.harmonics)


@lru_cache(maxsize=64)
def _without_harmonics(arm, *causes):
    """Columns without harmonics; `causes` are the other fields of `Terms`."""
    return Columns(arm, Terms(np.empty((0, 2), dtype=int), *causes))


@lru_cache(maxsize=64)
def _with_harmonics(alone, harmonics):
    """Columns with harmonics, of which `harmonics` are the bytes."""
    pairs = np.frombuffer(harmonics, dtype=int).reshape(-1, 2)
    return Columns(alone.arm, alone.terms._replace(harmonics=pairs), alone)


class Columns:
    """The columns of a model, in mm per unit coefficient: see `columns_of`.

    A cosine and a sine for each harmonic come first, `n_waves` in all, then the `others`, of which
    `names` and `family` (m,) are those of `Column`; `alone` are the latter without harmonics.
    Rows are angles (n, n_joints) in rad; then the extra columns that the terms name; then the probe
    of each row in the last frame, mm, where it is not the arm's.
    """

    def __init__(self, arm: Arm, terms: Terms, alone: Any = None) -> None:
        self.arm: Arm = arm
        self.terms: Terms = terms
        self.n_waves: int = 2 * len(terms.harmonics)
        self.alone: Columns = self if alone is None else alone
        if alone is None:
            wanted = terms.gravity, terms.kinematics, terms.wobble
            of_causes = compress((_gravity, _kinematics, _wobble), wanted)
            own = [column for columns in of_causes for column in columns(arm)]
            own += _of_extra(arm, terms.extra)
            self.others: tuple[Column, ...] = (*own, *_of_users(arm, terms, {c.name for c in own}))
        else:
            self.others = alone.others
        self.names: list[str] = [column.name for column in self.others]
        self.family: np.ndarray = np.array([c.family for c in self.others], dtype=int)
        # Unit vector against gravity in `up_frame`: the arm's, or what the data have found.
        self.up: np.ndarray = np.array(terms.up) if terms.up else arm.up

    def __reduce__(self) -> tuple[object, ...]:
        return columns_of, (self.arm, self.terms)

    def with_harmonics(self, pairs: np.ndarray) -> "Columns":
        """The same others with other harmonics (n_pairs, 2)."""
        return _with_harmonics(self.alone, np.ascontiguousarray(pairs, dtype=int).tobytes())

    @cached_property
    def table(self) -> np.ndarray:
        """What each column is, as a structured array of the numbers of `Column`."""
        if self.alone is self:
            return np.array([column[1:] for column in self.others], dtype=_NUMBERS)
        return np.concatenate([_harmonics(self.arm, self.terms.harmonics), self.alone.table])

    @cached_property
    def scale(self) -> np.ndarray:
        """Coefficients that make the whole arm larger: the column of the probe's position."""
        lengths = _lengths(self.arm)
        sizes = [lengths.get(c.name, 0.0) / c.unit for c in self.others]
        return np.concatenate([np.zeros(self.n_waves), sizes])

    @cached_property
    def forces(self) -> np.ndarray:
        """Force on the probe in the base frame by one of each extra column, (n_extra, 3)."""
        forces = np.zeros((len(self.terms.extra), 3))
        for force, (name, _) in zip(forces, self.terms.extra, strict=True):
            kind, axis = parse_extra(name, self.arm.n_joints)
            if kind == "force":
                force[axis] = 1.0
            elif kind == "payload":  # a weight pulls against the vertical
                force -= self.arm.up
        return forces

    @cached_property
    def _plan(self):
        return _Plan(self)

    @cached_property
    def spans(self) -> list[Any]:
        """First and last column of each run of waves, those of a joint."""
        return self._plan.spans

    @cached_property
    def runs(self) -> list[Any]:
        """The spans that `factored` leaves as factors: none where all are short."""
        return self._plan.runs

    def _parts(self, rows):
        """Angles, extra columns, and the probes (n, 3) of rows that end with them, or None."""
        n, end = self.arm.n_joints, self.arm.n_joints + len(self.terms.extra)
        return rows[:, :n], rows[:, n:end], rows[:, end:] if rows.shape[1] > end else None

    def points(self, rows: np.ndarray) -> np.ndarray:
        """Probe points (n, 3) of rows, mm."""
        angles, _, probes = self._parts(rows)
        return self.arm.points_at(angles, probes)

    def levers(self, rows: np.ndarray) -> np.ndarray:
        """What a radian of each joint does to the probe at rows, or a metre, (n, 3, n_joints)."""
        angles, _, probes = self._parts(rows)
        levers, axes = np.empty((len(rows), 3, self.arm.n_joints)), self._plan.joint_axes
        for part in chunks(len(rows), _CHUNK):
            own = None if probes is None else probes[part]
            levers[part] = self.arm.axis_vectors(angles[part], own)[0][:, :, axes]
        if "P" in self.arm.joint_types:
            levers *= self.arm.by_type(1.0, _METRE)
        return levers

    def upright(self, vectors: np.ndarray) -> np.ndarray:
        """Directions against gravity in the base frame, (n, 3), of the `axis_vectors` of poses."""
        start = 3 * (self.arm.n_joints + 1 + self.arm.up_frame)
        return vectors[:, :, start : start + 3] @ self.up

    def at(self, rows: np.ndarray) -> np.ndarray:
        """Columns at rows, (n, 3, n_columns)."""
        return self.points_and_columns(rows)[1]

    def points_and_columns(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Probe points (n, 3) of rows, mm, and the columns there, (n, 3, n_columns)."""
        out = np.empty((len(rows), 3, self.n_waves + len(self.others)))
        found = self.factored(rows, out[:, :, self._plan.rest :])
        for i, (start, end) in enumerate(found.spans):
            vector, waves = found.vectors[:, :, i, None], found.waves[:, None, start:end]
            np.multiply(vector, waves, out=out[:, :, start:end])
        return found.points, out

    def dot(self, rows: np.ndarray, coef: np.ndarray) -> np.ndarray:
        """``columns @ coef`` at rows, (n, 3), a few of them at a time."""
        return self.points_and_shifts(rows, coef)[:, :, 1]

    def points_and_shifts(self, rows: np.ndarray, coef: np.ndarray) -> np.ndarray:
        """Probe points of rows, mm, and ``columns @ coef`` there, side by side, (n, 3, 2)."""
        both = np.empty((len(rows), 3, 2))
        for part in chunks(len(rows), _POSES):
            found = self.factored(rows[part])
            both[part, :, 0], both[part, :, 1] = found.points, found.dot(coef)
        return both

    @cached_property
    def _with_turns(self):
        """The others behind a cosine of order 0, which is the turn of a joint itself, of each."""
        joints = np.arange(self.arm.n_joints)
        return self.with_harmonics(np.column_stack([joints, np.zeros_like(joints)]))

    def parts(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What the columns at rows are made of.

        What waves of each joint share, (n, 3, n_joints); the others, (n, 3, m); the phases of the
        joints, (n, n_joints); and of each harmonic its wave as a complex number, (n, n_pairs).
        """
        found, n = self.alone._with_turns.factored(rows), 2 * self.arm.n_joints
        turns, others = found.rest[:, :, :n:2], found.rest[:, :, n:]
        return turns, others, found.phases, self.waves(found.phases).view(complex)

    def waves(self, phases: np.ndarray) -> np.ndarray:
        """Cosine and sine of each harmonic, (n, n_waves), at phases (n, n_joints) of the joints.

        Orders 1 to K come by doubling, those beyond one by one.
        """
        waves: Any = np.empty((len(phases), self.n_waves // 2), dtype=complex)
        for start, end in self.spans:
            joint, orders = self.terms.harmonics[start // 2 : end // 2].T
            theta, out = phases[:, joint[0]], waves[:, start // 2 : end // 2]
            n = int(np.count_nonzero(orders == np.arange(1, len(orders) + 1)))
            if n:
                out.real[:, 0], out.imag[:, 0] = np.cos(theta), np.sin(theta)
            have = 1
            while have < n:
                more = min(have, n - have)
                np.multiply(out[:, :more], out[:, have - 1 : have], out=out[:, have : have + more])
                have += more
            if n < len(orders):
                phase = theta[:, None] * orders[n:]
                np.cos(phase, out=out.real[:, n:])
                np.sin(phase, out=out.imag[:, n:])
        return waves.view(float)

    def factored(self, rows: np.ndarray, out: np.ndarray | None = None) -> FactoredColumns:
        """Columns at rows: long runs of waves stay factors, the others may go into `out`."""
        plan = self._plan
        angles, values, probes = self._parts(rows)
        vectors, places, wave_phase = self.arm.axis_vectors(angles, probes)
        factor = plan.unit[None].repeat(len(angles), axis=0)
        if len(plan.load_at):
            up = self.upright(vectors).T[:, :, None] if self.arm.up_frame else self.up
            factor[:, plan.loads] *= _torques(plan, up, vectors, places)
        if len(plan.grows):
            along = np.take(vectors, plan.which[plan.grows], axis=2)
            far = places[:, :, plan.grows_to] - places[:, :, plan.grows_to - 1]
            factor[:, plan.grows] *= np.einsum("ncp,ncp->np", along, far)
        phase = wave_phase[:, plan.wave_joint] * plan.wave_order
        wave = np.empty((len(rows), 2 * len(plan.wave_order)))
        np.cos(phase, out=wave[:, ::2])
        np.sin(phase, out=wave[:, 1::2])
        factor[:, plan.waves] *= wave
        if self.terms.extra:
            if probes is not None:  # each grows in proportion to itself
                grown = plan.grown_axis
                factor[:, plan.grown] *= probes[:, grown] / self.arm.probe[grown]
            force = (values - plan.means) @ self.forces
            factor[:, plan.pushes] *= np.einsum("ncp,nc->np", vectors[:, :, plan.push_turn], force)
            factor[:, plan.given] *= values[:, plan.by] - plan.means[plan.by]
        rest = np.multiply(vectors.take(plan.which, axis=2), factor[:, None], out=out)
        along = waves = np.empty((len(rows), 0))
        if plan.runs:
            along = vectors.take(plan.run_which, axis=2) * plan.run_unit
            waves = self.waves(wave_phase)
        return FactoredColumns(plan.runs, along, waves, rest, places[:, :, -1], wave_phase)


def torque_axis(table: np.ndarray) -> np.ndarray:
    """Axis of the torque that loads of a table of columns have, 3 frame + axis."""
    leans = table["kind"] == LEAN
    return 3 * table["frame"] + np.where(leans, 1 - table["axis"], table["axis"])


class _Plan:
    """A column table, arranged for whole arrays."""

    def __init__(self, columns):
        table, n_waves, n_axes = columns.table, columns.n_waves, 3 * (columns.arm.n_joints + 1)
        axis = 3 * table["frame"] + table["axis"]
        shifts = np.isin(table["kind"], (SHIFT, LEAN, GROW))
        which = axis + n_axes * shifts  # into the `axis_vectors`
        # First and last column of each span, the waves of a joint, which share one vector.
        firsts = np.flatnonzero(np.diff(which[:n_waves], prepend=-1))
        ends = [*firsts[1:].tolist(), n_waves]
        self.spans = list(zip(firsts.tolist(), ends, strict=True)) if n_waves else []
        self.run_which, self.run_unit = which[firsts], table["unit"][firsts]
        # Those that stay factors, or none; columns from `rest` on are selected by `which`.
        self.runs = self.spans if n_waves >= _LONG_RUN * len(self.spans) else []
        self.rest = n_waves if self.runs else 0
        rest, axis = table[self.rest :], axis[self.rest :]
        cosines = rest[rest["order"] > 0]
        self.wave_joint, self.wave_order = cosines["joint"], cosines["order"]
        self.which, self.unit = which[self.rest :], rest["unit"]
        self.joint_axes = columns.arm.joint_axes
        self.waves = _places(rest["order"])
        self.loads = _places(np.isin(rest["kind"], OF_LOADS))
        self.load_x = n_axes + torque_axis(rest[self.loads])  # axis u, into the vectors
        self.load_at, self.load_frame = rest["load"][self.loads], rest["frame"][self.loads]
        self.grows = np.flatnonzero(rest["kind"] == GROW)
        self.grows_to = rest["load"][self.grows]
        self.pushes = np.flatnonzero(rest["kind"] == PUSH)
        self.push_turn = axis[self.pushes]  # into the vectors: what the turn does to the probe
        self.given = np.flatnonzero(rest["by"] >= 0)  # columns that an extra column multiplies
        self.by = rest["by"][self.given]
        self.means = np.array([reference[0] for _, reference in columns.terms.extra])
        # Growth of the probe.
        grows = [c.family == TEMPERATURE and c.name[:6] == "probe_" for c in columns.others]
        self.grown = n_waves - self.rest + np.flatnonzero(grows)
        self.grown_axis = rest["axis"][self.grown]


def _torques(plan, up, vectors, places):
    """Torque (n, n_loads) of each load about its axis: see `_gravity`."""
    torques, u = 0.0, vectors.take(plan.load_x, axis=2)
    lever = places.take(plan.load_at, axis=2)
    lever -= places.take(plan.load_frame, axis=2)
    for k in (0, 1, 2):
        if up.ndim == 1 and up[k] == 0:
            continue  # of an upright arm two of three products are none
        i, j = (k + 1) % 3, (k + 2) % 3
        torques = torques + up[k] * (u[:, j] * lever[:, i] - u[:, i] * lever[:, j])
    return torques


def _places(wanted):
    """Places of what is not 0, as a slice where they follow each other: that takes no copies."""
    found = np.flatnonzero(wanted)
    whole = len(found) and found[-1] - found[0] == len(found) - 1
    return slice(found[0], found[-1] + 1) if whole else found
