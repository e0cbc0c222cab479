"""Columns of the linear error model of an arm: what one arc second of each cause does to the probe.

Every column is the displacement of the probe in mm that one unit of a coefficient causes. The unit
is one arc second, or, for lengths, the length that one arc second spans at the arm's reach. So all
coefficients of a family are of one size, whatever the size of the arm.

One table says what each column is, see `Column`. `term_columns` computes the columns from it, and
the export to C writes the same table into its source.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import lru_cache
from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from sklearn_raacmm.arm import FIELDS, Arm, axis_vectors, points_of, reach_mm
from sklearn_raacmm.error_model._extra import force_on_probe, parsed

ARCSEC = np.pi / 180 / 3600
# Families of columns, each with a prior of its own; then that of harmonics that are taken for
# themselves, and that of all low orders together.
GRAVITY, KINEMATICS, WOBBLE, TEMPERATURE, DIRECTION, FORCE, HARMONICS, SMOOTH = range(8)
FAMILIES = (
    "gravity", "kinematics", "wobble", "temperature", "direction", "force", "harmonics", "smooth",
)  # fmt: skip
# The families that `ArmResidualRegressor` names in `causes`.
CAUSES = ("gravity", "kinematics", "wobble")
FAMILIES_OF_EXTRA = (TEMPERATURE, DIRECTION, FORCE)
# Kinds of columns: a small turn about an axis of a frame, a small shift along it, or a turn about
# it in proportion to the torque about that axis of a load, or of a force on the probe.
TURN, SHIFT, LOAD, PUSH = range(4)
# An axis nods once a turn where it leans, twice where its bearing is oval.
_WOBBLE_ORDERS = (1, 2)
# What places the base and is not in its table: shifts along and turns about x and y.
_BASE = ("base_x", "base_y", "base_alpha", "base_beta")
# Shorter lengths of the table do not grow: 1 mm of aluminium grows by 0.02 um per K.
_LEAST_GROWING_MM = 1.0
# Waves of one joint about one axis from which on a product per joint is faster than one selection
# of all axes: ten times with 318 harmonics of a UR10.
_LONG_RUN = 24
# What the end of a cantilever under a load F there slopes by beside the turn F L^2 / (3 E I) that
# moves it, in parts of that: F L^2 / (6 E I).
_OF_END = 0.5


class Terms(NamedTuple):
    """Which columns there are.

    harmonics (n_pairs, 2): joint from 0 and order; each is a cosine and a sine column, first of
    all. Then those of the families that are on.
    extra: name and reference of each column of X after the angles, as `with_references` makes them.
    up: direction against gravity where the data have found another one than the arm states.
    """

    harmonics: np.ndarray
    gravity: bool
    kinematics: bool
    wobble: bool
    extra: tuple[Any, ...] = ()
    up: tuple[float, ...] = ()


def vertical(arm: Arm, terms: Terms) -> np.ndarray:
    """Unit vector against gravity in the base frame, (3,): the arm's, or what the data found."""
    return np.array(terms.up) if terms.up else arm.up


class Column(NamedTuple):
    """One column that is no harmonic of an encoder: its name, and how it moves the probe."""

    name: str
    family: int
    kind: int  # TURN, SHIFT, LOAD or PUSH
    frame: int  # whose axis it is: 0 is the base
    axis: int  # 0, 1, 2: x, y, z of the frame
    unit: float  # rad or mm per unit coefficient; for LOAD per mm of lever, too
    joint: int = 0  # of the wave, from 0
    order: int = 0  # of the wave: cosine if positive, sine if negative, none if 0
    load: int = 0  # for LOAD the frame of the load, n_joints + 1: the probe
    by: int = -1  # the extra column that multiplies it, from 0; -1: none
    reference: float = 0.0  # what is taken off that column before


_NUMBERS = np.dtype([(name, kind) for name, kind in [*Column.__annotations__.items()][1:]])


def _first_frame(arm):
    """Frame whose z axis the first joint turns about."""
    return 0 if arm.convention == "standard" else 1


def _harmonics(arm, pairs):
    """Waves of the error of each joint's encoder: a cosine and a sine for each order."""
    first = _first_frame(arm)
    for j, k in pairs.tolist():
        unit = arm.joint_signs[j] * ARCSEC
        for order in (k, -k):
            yield Column("", HARMONICS, TURN, j + first, 2, unit, j, order)


def _gravity(arm):
    """Turns of each frame about each of its axes, by the torque of each load beyond.

    With e the `vertical`, the torque of unit weight about the axis u through o is
    u . (r x -e) = -(u x r) . e, with r from o to the load: in units of the reach. The end of a
    cantilever slopes, too, about the axis of the torque that a load at its beginning would have
    about its end. Hence the frame before, in a smaller unit, but for the last frame: with it a
    longer probe than the one that was learnt came out four times worse.
    """
    n, unit = arm.n_joints, ARCSEC / reach_mm(arm)
    for frame in range(n + 1):
        for axis in range(3):
            before = range(max(frame - 1, 0), frame) if frame < n else ()
            for load in [*before, *range(frame + 1, n + 2)]:
                at = "probe" if load > n else f"frame {load}"
                name = f"load at {at} bends frame {frame} about {'xyz'[axis]}"
                size = unit * (_OF_END if load < frame else 1.0)
                yield Column(name, GRAVITY, LOAD, frame, axis, size, load=load)


def _kinematics(arm):
    """Changes of the table, of where the base stands, and turns beta about y beside those about x.

    A length moves the probe along the axis that carries it; an angle turns it about that axis. A
    table has no beta, which parallel axes need (Hayati).
    """
    n, first, length = arm.n_joints, _first_frame(arm), ARCSEC * reach_mm(arm)
    # Row i goes along and about z of one of its two frames, and x of the other.
    of_x, of_z = 1 - first, first
    moves = ((SHIFT, of_x, 0), (TURN, of_x, 0), (SHIFT, of_z, 2), (TURN, of_z, 2))
    changes = [
        (f"{field}{i + 1}", kind, i + of, axis)
        for field, (kind, of, axis) in zip(FIELDS[:-1], moves, strict=True)
        for i in range(n)
    ]
    changes += [(f"probe_{'xyz'[axis]}", SHIFT, n, axis) for axis in range(3)]
    moves = ((SHIFT, 0), (SHIFT, 1), (TURN, 0), (TURN, 1))
    changes += [(name, kind, 0, axis) for name, (kind, axis) in zip(_BASE, moves, strict=True)]
    changes += [(f"beta{i + 1}", TURN, i + of_x, 1) for i in range(n)]
    for name, kind, frame, axis in changes:
        yield Column(name, KINEMATICS, kind, frame, axis, length if kind == SHIFT else ARCSEC)


def _wobble(arm):
    """Tilts of each joint's axis about the two directions across it."""
    first = _first_frame(arm)
    for j in range(arm.n_joints):
        for axis in range(2):
            for order in _WOBBLE_ORDERS:
                for part, signed in (("cos", order), ("sin", -order)):
                    name = f"joint {j + 1} tilts about {'xy'[axis]}, {part}({order} theta)"
                    yield Column(name, WOBBLE, TURN, j + first, axis, ARCSEC, j, signed)


def _temperature(arm, name, by, mean):
    """Growth of lengths and drift of offsets, of all joints or of one, per unit of temperature.

    A length grows in proportion to itself: a coefficient of 1 is one arc second in rad, 4.8 ppm.
    """
    _, joint = parsed(name, arm.n_joints)
    of_joint = {f"{field}{joint + 1}" for field in ("a", "d", "theta_offset")}
    if joint == arm.n_joints - 1:
        of_joint |= {"probe_x", "probe_y", "probe_z"}
    lengths = _lengths(arm)
    for column in _kinematics(arm):
        length = lengths.get(column.name, 0.0)
        grows = abs(length) > _LEAST_GROWING_MM
        if joint >= 0 and column.name not in of_joint:
            continue
        if grows or column.name.startswith("theta_offset"):
            unit = ARCSEC * length if grows else ARCSEC
            of = f"{column.name} by {name}"
            yield column._replace(name=of, family=TEMPERATURE, unit=unit, by=by, reference=mean)


def _force(arm):
    """Turns of each frame about each of its axes, by the torque of a force on the probe."""
    unit = ARCSEC / reach_mm(arm)
    for frame in range(arm.n_joints + 1):
        for axis in range(3):
            name = f"force bends frame {frame} about {'xyz'[axis]}"
            yield Column(name, FORCE, PUSH, frame, axis, unit)


def _extra(arm, extra):
    """What the columns of X after the angles do."""
    if any(name.startswith(("force", "payload")) for name, _ in extra):
        yield from _force(arm)
    for by, (name, reference) in enumerate(extra):
        kind, joint = parsed(name, arm.n_joints)
        if kind in ("temperature", "time"):
            yield from _temperature(arm, name, by, reference[0])
        elif kind == "direction":
            unit, frame = arm.joint_signs[joint] * ARCSEC, joint + _first_frame(arm)
            of = f"joint {joint + 1} lags"
            yield Column(of, DIRECTION, TURN, frame, 2, unit, by=by, reference=reference[0])


@lru_cache(maxsize=64)
def _columns_of_causes(arm, causes):
    """Columns that are no harmonics, in their order; `causes` are `Terms` without harmonics."""
    wanted = causes.gravity, causes.kinematics, causes.wobble
    families = compress((_gravity, _kinematics, _wobble), wanted)
    own = [column for family in families for column in family(arm)]
    return *own, *_extra(arm, causes.extra)


def other_columns(arm, terms):
    """Columns that are no harmonics, as a tuple of `Column`."""
    return _columns_of_causes(arm, terms._replace(harmonics=()))


def term_names(arm, terms):
    """Names and families of the columns that are no harmonics."""
    others = other_columns(arm, terms)
    return [c.name for c in others], np.array([c.family for c in others], dtype=int)


def column_table(arm: Arm, terms: Terms) -> np.ndarray:
    """What each column is, as a structured array of the numbers of `Column`.

    A cosine and a sine turn for each harmonic come first, then the others.
    """
    columns = [*_harmonics(arm, terms.harmonics), *other_columns(arm, terms)]
    return np.array([column[1:] for column in columns], dtype=_NUMBERS)


class _Plan:
    """A column table, arranged for whole arrays: all that does not depend on the pose."""

    def __init__(self, arm, terms):
        table = column_table(arm, terms)
        self.n_joints, n_axes = arm.n_joints, 3 * (arm.n_joints + 1)
        axis = 3 * table["frame"] + table["axis"]
        which = np.where(table["kind"] == SHIFT, n_axes, 0) + axis  # into the `axis_vectors`
        # Runs of columns (first, last, vector, unit): many waves that share one vector.
        self.runs, self.rest = [], 0
        n_waves = 2 * len(terms.harmonics)
        if n_waves and n_waves >= _LONG_RUN * len(np.unique(terms.harmonics[:, 0])):
            ends = np.flatnonzero(np.diff(which[:n_waves], append=-1)) + 1
            for start, end in zip([0, *ends[:-1].tolist()], ends.tolist(), strict=True):
                self.runs.append((start, end, int(which[start]), float(table["unit"][start])))
            self.rest = n_waves  # columns from here on are selected by `which`
        cosines = table[table["order"] > 0]  # of all waves: those of the runs, then the others
        self.wave_joint, self.wave_order = cosines["joint"], cosines["order"]
        rest, axis = table[self.rest :], axis[self.rest :]
        self.which, self.unit = which[self.rest :], rest["unit"]
        self.waves = np.flatnonzero(rest["order"])
        self.loads = np.flatnonzero(rest["kind"] == LOAD)
        self.load_x = n_axes + axis[self.loads]  # axis u of the torque, into the vectors
        self.load_at, self.load_frame = rest["load"][self.loads], rest["frame"][self.loads]
        self.pushes = np.flatnonzero(rest["kind"] == PUSH)
        self.push_turn = axis[self.pushes]  # into the vectors: what the turn does to the probe
        self.given = np.flatnonzero(rest["by"] >= 0)  # columns that an extra column multiplies
        self.by, self.reference = rest["by"][self.given], rest["reference"][self.given]
        # Growth of the probe.
        grows = [
            c.family == TEMPERATURE and c.name[:6] == "probe_" for c in other_columns(arm, terms)
        ]
        self.grown = n_waves - self.rest + np.flatnonzero(grows)
        self.grown_axis = rest["axis"][self.grown]
        self.up = vertical(arm, terms)


@lru_cache(maxsize=64)
def _planned(arm, harmonics, causes):
    """`_Plan` of an arm; `harmonics` are the bytes of those of the terms, `causes` the others."""
    pairs = np.frombuffer(harmonics, dtype=int).reshape(-1, 2)
    return _Plan(arm, causes._replace(harmonics=pairs))


def _plan(arm, terms):
    harmonics = np.ascontiguousarray(terms.harmonics, dtype=int).tobytes()
    return _planned(arm, harmonics, terms._replace(harmonics=()))


class FactoredColumns:
    """Columns of the model at n poses, those of many waves of one joint as factors.

    The waves of a joint share the vector by which a turn about its axis moves the probe. Products
    with the columns are therefore taken with the waves first: one number for each pose, not three.
    The `runs` are of (first, last column, vector (n, 3), waves (n, k)), `rest` (n, 3, m) are the
    columns after them.
    """

    def __init__(self, runs: list[Any], rest: np.ndarray) -> None:
        self.runs, self.rest = runs, rest

    def dot(self, coef):
        """``columns @ coef``, (n, 3)."""
        n, _, m = self.rest.shape
        out = (self.rest.reshape(3 * n, m) @ coef[len(coef) - m :]).reshape(n, 3)
        for start, end, vector, waves in self.runs:
            out += vector * (waves @ coef[start:end])[:, None]
        return out

    def squares(self, root):
        """Squared lengths (n, 3) of ``columns @ root`` for a root (n_columns, r)."""
        n, _, m = self.rest.shape
        # One product of all rows takes a quarter of the time of one for each pose.
        rest = self.rest.reshape(3 * n, m)
        if not self.runs:
            dots = rest @ root
            return np.einsum("nr,nr->n", dots, dots).reshape(n, 3)
        vectors = np.stack([vector for *_, vector, _ in self.runs], axis=2)
        shared = np.zeros((n, len(self.runs), root.shape[1]), dtype=root.dtype)
        for i, (start, end, _, waves) in enumerate(self.runs):
            used = _filled(root[start:end])
            shared[:, i, used] = waves @ root[start:end, used]
        dots = vectors @ shared
        own = root[len(root) - m :]
        used = _filled(own)
        dots[:, :, used] += (rest @ own[:, used]).reshape(n, 3, -1)
        return np.einsum("ncr,ncr->nc", dots, dots)


def _filled(rows):
    """Columns from the first to the last one that is not all zeros."""
    some = np.flatnonzero(rows.any(axis=0))
    return slice(some[0], some[-1] + 1) if len(some) else slice(0, 0)


def factored_columns(arm, angles, terms):
    """Columns as `term_columns` gives them, not multiplied out."""
    return _factored(arm, angles, _plan(arm, terms), terms, None)


def term_columns(arm: Arm, angles: np.ndarray, terms: Terms) -> np.ndarray:
    """Columns (n, 3, n_columns) of the model, in mm per unit coefficient.

    The angles (n, n_joints + n_extra) are in rad; then come the extra columns that `terms` names;
    then the probe of each row in the last frame, mm, where it is not the arm's.
    """
    plan = _plan(arm, terms)
    out = np.empty((len(angles), 3, plan.rest + len(plan.which)))
    found = _factored(arm, angles, plan, terms, out[:, :, plan.rest :])
    for start, end, vector, waves in found.runs:
        np.multiply(vector[:, :, None], waves[:, None], out=out[:, :, start:end])
    return out


def _parts_of_rows(n_joints, terms, rows):
    """Angles, extra columns, and the probes (n, 3) of rows that end with them, or None."""
    end = n_joints + len(terms.extra)
    probes = rows[:, end:] if rows.shape[1] > end else None
    return rows[:, :n_joints], rows[:, n_joints:end], probes


def points_of_rows(arm, terms, rows):
    """Probe points (n, 3) of rows that `term_columns` takes, mm."""
    angles, _, probes = _parts_of_rows(arm.n_joints, terms, rows)
    return points_of(arm, angles, probes)


def _factored(arm, angles, plan, terms, out):
    """`FactoredColumns` by a plan; its `rest` is written to `out`, where that is given."""
    angles, values, probes = _parts_of_rows(plan.n_joints, terms, angles)
    vectors, places = axis_vectors(arm, angles, probes)
    phase = angles[:, plan.wave_joint] * plan.wave_order
    wave = np.empty((len(angles), 2 * phase.shape[1]))
    np.cos(phase, out=wave[:, 0::2])
    np.sin(phase, out=wave[:, 1::2])
    runs = [
        (start, end, vectors[:, :, which] * unit, wave[:, start:end])
        for start, end, which, unit in plan.runs
    ]
    factor = np.tile(plan.unit, (len(angles), 1))
    if len(plan.loads):
        factor[:, plan.loads] *= _torques(plan, vectors, places)
    factor[:, plan.waves] *= wave[:, plan.rest :]
    if terms.extra:
        if probes is not None:  # each grows in proportion to itself
            factor[:, plan.grown] *= probes[:, plan.grown_axis] / arm.probe[plan.grown_axis]
        force = force_on_probe(terms.extra, values, arm.up)
        factor[:, plan.pushes] *= np.einsum("ncp,nc->np", vectors[:, :, plan.push_turn], force)
        factor[:, plan.given] *= values[:, plan.by] - plan.reference
    rest = np.multiply(np.take(vectors, plan.which, axis=2), factor[:, None], out=out)
    return FactoredColumns(runs, rest)


def _torques(plan, vectors, places):
    """Torque (n, n_loads) of each load about its axis: see `_gravity`."""
    torques = 0.0
    for k in np.flatnonzero(plan.up):
        pair = (k + 1) % 3, (k + 2) % 3
        x, y = (places[:, i, plan.load_at] - places[:, i, plan.load_frame] for i in pair)
        ux, uy = (vectors[:, i, plan.load_x] for i in pair)
        torques = torques + plan.up[k] * (uy * x - ux * y)
    return torques


def levers(arm, terms, rows):
    """What each joint's angle does to the probe at rows as of `term_columns`, (n, 3, n_joints)."""
    angles, _, probes = _parts_of_rows(arm.n_joints, terms, rows)
    z = 3 * (np.arange(arm.n_joints) + _first_frame(arm)) + 2
    return axis_vectors(arm, angles, probes)[0][:, :, z]


def scale_direction(arm, terms):
    """Coefficients that make the whole arm larger: the column of the probe's position itself."""
    lengths, others = _lengths(arm), other_columns(arm, terms)
    sizes = [lengths[c.name] / c.unit if c.name in lengths else 0.0 for c in others]
    return np.concatenate([np.zeros(2 * len(terms.harmonics)), sizes])


def _lengths(arm):
    """Lengths of the table by the names of their columns, mm."""
    lengths = {f"{field}{i + 1}": v for field in "ad" for i, v in enumerate(getattr(arm, field))}
    return lengths | dict(zip(("probe_x", "probe_y", "probe_z"), arm.probe, strict=True))
