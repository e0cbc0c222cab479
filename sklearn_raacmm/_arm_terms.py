"""Columns of the linear error model of an arm: what one arc second of each cause does to the probe.

Every column is the displacement of the probe in mm that one unit of a coefficient causes. The unit
is one arc second, or, for lengths, the length that one arc second spans at the arm's reach: so all
coefficients of a family are of one size, whatever the size of the arm.
"""

from typing import NamedTuple

import numpy as np

from sklearn_raacmm._identification import FIELDS
from sklearn_raacmm._kinematics import cross, dh_theta, frame_columns, parameter_jacobian

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


def reach_mm(arm):
    """Length of the stretched arm, an upper bound of its reach."""
    return float(np.hypot(arm.a, arm.d).sum() + np.linalg.norm(arm.probe))


def term_names(arm, terms):
    """Names, families and units of the columns that are no harmonics."""
    names, family = [], []
    if terms.gravity:
        for frame, axis, load in _loads(arm):
            at = "probe" if load > arm.n_joints else f"frame {load}"
            names.append(f"load at {at} bends frame {frame} about {'xyz'[axis]}")
            family.append(GRAVITY)
    if terms.kinematics:
        names += [f"{f}{i + 1}" for f in FIELDS[:-1] for i in range(arm.n_joints)]
        names += ["probe_x", "probe_y", "probe_z", *_BASE]
        names += [f"beta{i + 1}" for i in range(arm.n_joints)]
        family += [KINEMATICS] * (5 * arm.n_joints + 3 + len(_BASE))
    if terms.wobble:
        for joint, axis, order, part in _wobbles(arm):
            names.append(f"joint {joint + 1} tilts about {'xy'[axis]}, {part}({order} theta)")
            family.append(WOBBLE)
    return names, np.array(family, dtype=int)


def _loads(arm):
    """Frame, axis and load beyond: n_joints + 1 is the probe."""
    n = arm.n_joints
    return [(j, axis, i) for j in range(n + 1) for axis in range(3) for i in range(j + 1, n + 2)]


def _wobbles(arm):
    return [
        (j, axis, order, part)
        for j in range(arm.n_joints)
        for axis in range(2)
        for order in _WOBBLE_ORDERS
        for part in ("cos", "sin")
    ]


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
    frames = frame_columns(arm, dh_theta(arm, angles))
    probe = frames[-1, 3] + np.tensordot(arm.probe, frames[-1, :3], axes=1)
    parts = [_harmonics(arm, angles, frames, probe, terms.harmonics)]
    if terms.gravity:
        parts.append(_gravity(arm, frames, probe))
    if terms.kinematics:
        parts.append(_kinematics(arm, angles, frames, probe))
    if terms.wobble:
        parts.append(_wobble(arm, angles, frames, probe))
    return np.concatenate(parts, axis=2)


def _joint_frame(arm, joint):
    """Frame whose z axis a joint (from 0) turns about."""
    return joint if arm.convention == "standard" else joint + 1


def _harmonics(arm, angles, frames, probe, pairs):
    out = np.empty((len(angles), 3, 2 * len(pairs)))
    lever = {}
    for joint in np.unique(pairs[:, 0]):
        frame = frames[_joint_frame(arm, joint)]
        turn = arm.joint_signs[joint] * ARCSEC * cross(frame[2], probe - frame[3])
        lever[joint] = turn.T
    for i, (joint, order) in enumerate(pairs):
        phase = order * angles[:, joint]
        np.multiply(lever[joint], np.cos(phase)[:, None], out=out[:, :, 2 * i])
        np.multiply(lever[joint], np.sin(phase)[:, None], out=out[:, :, 2 * i + 1])
    return out


def _gravity(arm, frames, probe):
    """Turns of each frame about each of its axes, by the torque of a load about that axis.

    With gravity along -z of the base, the torque of unit weight about the axis u through o is
    u . (r x -z) = -(u x r) . z, with r from o to the load: in units of the reach.
    """
    loads = _loads(arm)
    out = np.empty((probe.shape[1], 3, len(loads)))
    places = [*frames[:, 3], probe]
    scale = ARCSEC / reach_mm(arm)
    lever = {}
    for column, (j, axis, load) in enumerate(loads):
        u, origin = frames[j, axis], frames[j, 3]
        if (j, axis) not in lever:
            lever[j, axis] = scale * cross(u, probe - origin)
        r = places[load] - origin
        out[:, :, column] = (lever[j, axis] * (u[1] * r[0] - u[0] * r[1])).T
    return out


def _kinematics(arm, angles, frames, probe):
    """Changes of the table, of where the base stands, and turns beta about y beside those about x.

    A tracker shows where the base stands; whoever fitted it did so with the other errors there. A
    table has no beta, for most axes do without; parallel ones do not (Hayati).
    """
    n = arm.n_joints
    length = ARCSEC * reach_mm(arm)
    jacobian = parameter_jacobian(arm, angles)[1]
    jacobian *= np.repeat([length, ARCSEC, length, ARCSEC, length], [n, n, n, n, 3])
    rest = np.zeros((len(angles), 3, len(_BASE) + n))
    rest[:, [0, 1], [0, 1]] = length
    first = 1 if arm.convention == "standard" else 0  # the frame that alpha1 turns
    for column, (frame, axis) in enumerate([(0, 0), (0, 1)] + [(first + i, 1) for i in range(n)]):
        turn = cross(frames[frame, axis], probe - frames[frame, 3])
        rest[:, :, 2 + column] = ARCSEC * turn.T
    return np.concatenate([jacobian, rest], axis=2)


def scale_direction(arm, terms):
    """Coefficients that make the whole arm larger: the column of the probe's position itself."""
    n = 2 * len(terms.harmonics)
    n += len(_loads(arm)) if terms.gravity else 0
    zero = np.zeros(arm.n_joints)
    sizes = np.concatenate([arm.a, zero, arm.d, zero, arm.probe]) / (ARCSEC * reach_mm(arm))
    tail = len(_BASE) + arm.n_joints + (len(_wobbles(arm)) if terms.wobble else 0)
    return np.concatenate([np.zeros(n), sizes, np.zeros(tail)])


def _wobble(arm, angles, frames, probe):
    wobbles = _wobbles(arm)
    out = np.empty((len(angles), 3, len(wobbles)))
    for column, (joint, axis, order, part) in enumerate(wobbles):
        frame = frames[_joint_frame(arm, joint)]
        wave = getattr(np, part)(order * angles[:, joint])
        out[:, :, column] = (ARCSEC * wave * cross(frame[axis], probe - frame[3])).T
    return out
