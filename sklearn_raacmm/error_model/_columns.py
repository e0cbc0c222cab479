"""Columns of the linear error model of an arm: what one arc second of each cause does to the probe.

Every column is the displacement of the probe in mm that one unit of a coefficient causes. The unit
is one arc second, or, for lengths, the length that one arc second spans at the arm's reach: so all
coefficients of a family are of one size, whatever the size of the arm.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sklearn_raacmm.arm import FIELDS, cross, dh_theta, frame_columns, probe_of, reach_mm

ARCSEC = np.pi / 180 / 3600
# Families of columns, each with a prior of its own.
HARMONIC, GRAVITY, KINEMATICS, WOBBLE = range(4)
FAMILIES = ("harmonics", "gravity", "kinematics", "wobble")
# An axis nods once a turn where it leans, twice where its bearing is oval.
_WOBBLE_ORDERS = (1, 2)
# What places the base and is not in its table: shifts along and turns about x and y.
_BASE = ("base_x", "base_y", "base_alpha", "base_beta")


class Terms(NamedTuple):
    """Which columns there are.

    harmonics (n_pairs, 2): joint from 0 and order; each is a cosine and a sine column, first of
    all. Then those of the families that are on.
    """

    harmonics: np.ndarray
    gravity: bool
    kinematics: bool
    wobble: bool


def term_names(arm, terms):
    """Names, families and units of the columns that are no harmonics."""
    names, family = [], []
    if terms.gravity:
        for frame, axis, load in loads(arm.n_joints):
            at = "probe" if load > arm.n_joints else f"frame {load}"
            names.append(f"load at {at} bends frame {frame} about {'xyz'[axis]}")
            family.append(GRAVITY)
    if terms.kinematics:
        names += [f"{f}{i + 1}" for f in FIELDS[:-1] for i in range(arm.n_joints)]
        names += ["probe_x", "probe_y", "probe_z", *_BASE]
        names += [f"beta{i + 1}" for i in range(arm.n_joints)]
        family += [KINEMATICS] * (5 * arm.n_joints + 3 + len(_BASE))
    if terms.wobble:
        for joint, axis, order, part in wobbles(arm.n_joints):
            names.append(f"joint {joint + 1} tilts about {'xy'[axis]}, {part}({order} theta)")
            family.append(WOBBLE)
    return names, np.array(family, dtype=int)


@lru_cache
def loads(n):
    """Frame, axis and load beyond, of n joints: n + 1 is the probe."""
    return [(j, axis, i) for j in range(n + 1) for axis in range(3) for i in range(j + 1, n + 2)]


@lru_cache
def wobbles(n):
    """Joint from 0, axis, order and function of each column, of n joints."""
    return [
        (j, axis, order, part)
        for j in range(n)
        for axis in range(2)
        for order in _WOBBLE_ORDERS
        for part in ("cos", "sin")
    ]


class _Axes(NamedTuple):
    """Axes of all frames at some poses: x, y and z of the base, of frame 1, and so on.

    Whole families of columns are picked from these arrays at once: of one pose, loops over columns
    would cost twenty times the arithmetic.
    """

    unit: np.ndarray  # (n, 3, 3 n_frames) the axes
    turn: np.ndarray  # (n, 3, 3 n_frames) what a turn about each does to the probe, mm per rad
    place: np.ndarray  # (n, 3, n_frames + 1) the frames' origins and the probe

    @classmethod
    def of(cls, arm, angles):
        frames = frame_columns(arm, dh_theta(arm, angles))
        probe = probe_of(arm, frames)
        axes = np.moveaxis(frames[:, :3], 2, 0)  # (3, n_frames, 3, n)
        lever = np.moveaxis(probe - frames[:, 3], 1, 0)[:, :, None]
        n_axes = 3 * len(frames)
        unit, turn = (
            np.moveaxis(part.reshape(3, n_axes, -1), 2, 0) for part in (axes, cross(axes, lever))
        )
        place = np.concatenate([frames[:, 3], probe[None]]).transpose(2, 1, 0)
        return cls(np.ascontiguousarray(unit), np.ascontiguousarray(turn), place)


def term_columns(arm, angles, terms):
    """Columns of the model at some poses.

    Parameters
    ----------
    arm : Arm
    angles : ndarray of shape (n, n_joints)
        In rad.
    terms : Terms

    Returns
    -------
    ndarray of shape (n, 3, n_columns)
        mm per unit coefficient.
    """
    axes = _Axes.of(arm, angles)
    rest = [_gravity(arm, axes)] if terms.gravity else []
    rest += [_kinematics(arm, axes)] if terms.kinematics else []
    rest += [_wobble(arm, angles, axes)] if terms.wobble else []
    n_waves = 2 * len(terms.harmonics)
    out = np.empty((len(angles), 3, n_waves + sum(part.shape[2] for part in rest)))
    _harmonics(arm, angles, axes, terms.harmonics, out[:, :, :n_waves])
    if rest:
        np.concatenate(rest, axis=2, out=out[:, :, n_waves:])
    return out


def _first_frame(arm):
    """Frame whose z axis the first joint turns about."""
    return 0 if arm.convention == "standard" else 1


def _harmonics(arm, angles, axes, pairs, out):
    """Written to `out`, a joint at a time: with all orders offered they are most of the model."""
    joint, order = pairs.T
    turn = axes.turn[:, :, 3 * (np.arange(arm.n_joints) + _first_frame(arm)) + 2]
    turn *= arm.joint_signs * ARCSEC
    ends = np.append(np.flatnonzero(np.diff(joint)) + 1, len(pairs)) if len(pairs) else []
    start = 0
    for end in ends:
        j = joint[start]
        phase = order[start:end] * angles[:, j, None]
        wave = np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(len(angles), 1, -1)
        np.multiply(turn[:, :, j, None], wave, out=out[:, :, 2 * start : 2 * end])
        start = end


def _gravity(arm, axes):
    """Turns of each frame about each of its axes, by the torque of a load about that axis.

    With gravity along -z of the base, the torque of unit weight about the axis u through o is
    u . (r x -z) = -(u x r) . z, with r from o to the load: in units of the reach.
    """
    frame, axis, load = np.array(loads(arm.n_joints)).T
    which = 3 * frame + axis
    ux, uy = axes.unit[:, :2, which].transpose(1, 0, 2)
    x, y = (axes.place[:, :2, load] - axes.place[:, :2, frame]).transpose(1, 0, 2)
    torque = (ARCSEC / reach_mm(arm)) * (uy * x - ux * y)
    return axes.turn[:, :, which] * torque[:, None]


def _kinematics(arm, axes):
    """Changes of the table, of where the base stands, and turns beta about y beside those about x.

    A length moves the probe along the axis that carries it; an angle turns it about that axis. A
    tracker shows where the base stands; whoever fitted it did so with the other errors there. A
    table has no beta, for most axes do without; parallel ones do not (Hayati).
    """
    n, first = arm.n_joints, _first_frame(arm)
    length = ARCSEC * reach_mm(arm)
    # Row i goes along and about z of one of its two frames, and x of the other.
    of_z = 3 * (np.arange(n) + first) + 2
    of_x = 3 * (np.arange(n) + 1 - first)
    along_x, along_z, along_probe, along_base = (
        length * axes.unit[:, :, which] for which in (of_x, of_z, slice(3 * n, None), slice(2))
    )
    about_x, about_z, about_base, about_y = (
        ARCSEC * axes.turn[:, :, which] for which in (of_x, of_z, slice(2), of_x + 1)
    )
    columns = [along_x, about_x, along_z, about_z, along_probe, along_base, about_base, about_y]
    return np.concatenate(columns, axis=2)


def scale_direction(arm, terms):
    """Coefficients that make the whole arm larger: the column of the probe's position itself."""
    n = 2 * len(terms.harmonics)
    n += len(loads(arm.n_joints)) if terms.gravity else 0
    zero = np.zeros(arm.n_joints)
    sizes = np.concatenate([arm.a, zero, arm.d, zero, arm.probe]) / (ARCSEC * reach_mm(arm))
    tail = len(_BASE) + arm.n_joints + (len(wobbles(arm.n_joints)) if terms.wobble else 0)
    return np.concatenate([np.zeros(n), sizes, np.zeros(tail)])


def _wobble(arm, angles, axes):
    joint, axis, order, _ = zip(*wobbles(arm.n_joints), strict=True)
    joint = np.array(joint)
    phase = np.array(order) * angles[:, joint]
    # Cosines and sines take turns.
    wave = np.where(np.arange(len(joint)) % 2, np.sin(phase), np.cos(phase))
    turn = axes.turn[:, :, 3 * (joint + _first_frame(arm)) + np.array(axis)]
    return turn * (ARCSEC * wave)[:, None]
