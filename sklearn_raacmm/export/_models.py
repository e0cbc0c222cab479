"""Fitted models as programs: the only file that knows what a model computes.

One function for each kind of step: it adds the step's operations to those before it.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import cached_property

import numpy as np
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm.arm import MIN_LENGTH_MM, phase_factors
from sklearn_raacmm.error_model import OF_LOADS, ArmResidualRegressor, Effect, torque_axis
from sklearn_raacmm.export._networks import network
from sklearn_raacmm.export._program import Builder, Program, hash_program, pruned, run
from sklearn_raacmm.export._small_doubt import (
    INT16,
    axis_numbers,
    of_many_waves,
    poses_from_far_to_near,
    small_doubt,
    units_of_rows,
)
from sklearn_raacmm.export._steps import (
    KNOWN,
    REGRESSORS,
    check_fitted,
    described,
    extra_columns,
    find_arm,
    leaves,
    n_inputs,
)
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.residuals import NORM_TOLERANCE, CylindricalResidualTarget, PoseFeatures

# In place of a length that is nothing.
_TINY = 1e-30
# By which share of themselves 16 bits a number may move deviations: half of what is promised. So
# many poses in the ranges of the fit and each so manieth from far to near are looked at: half of
# them make the rounding good (so little, as a share of its size, where none is), half judge.
# Deviations at a UR10's own poses are 5.8e-4 off at most, 1.2e-3 by rounding alone.
_OFF, _NEAR, _SEEN, _UNSEEN = 5e-4, 400, 5, 0.1


# -- the whole chain ------------------------------------------------------------------------------


class _Chain:
    """A chain that adds its operations to a program, and the arm that its angles belong to."""

    def __init__(self, model, p, std, fade, poses):
        self.p, self.std, self.x = p, std, p.x
        self.fade, self.poses = fade, poses
        self.model, (self.arm, self.unit) = model, find_arm(model)
        self.trust = None

    def angles(self):
        """Joint angles in rad, and mm of what slides."""
        n = self.arm.n_joints
        angles = self.x if self.p.size(self.x) == n else self.p.take(self.x, np.arange(n))
        if self.unit == "rad":
            return angles
        per_degree = np.pi / 180
        if "P" in self.arm.joint_types:
            per_degree = self.arm.by_type(per_degree)
        return self.p("mul", angles, per_degree)

    def own_angles(self):
        """Angle of each joint itself in rad, where some are sums of what is given."""
        angles = self.angles()
        if not self.arm.couplings:
            return angles
        unit = np.eye(self.arm.n_joints)
        return self.p.affine(angles, self.arm.own_angles(unit).T)

    def phases(self):
        """What waves of each joint's error are waves of, rad."""
        own = self.own_angles()
        if not self.arm.slides:
            return own
        return self.p("mul", own, phase_factors(self.arm))

    @cached_property
    def frames(self):
        """Axes and origin of every frame, 12 numbers each, the base first."""
        p, arm, own = self.p, self.arm, self.own_angles()
        signs = arm.joint_signs * arm.by_type(1.0, 0.0)
        theta = p("add", p("mul", own, signs), arm.theta_offset)
        table = np.stack([np.cos(arm.alpha), np.sin(arm.alpha), arm.a, arm.d], axis=1)
        frames = p("frames", theta, table=table, convention=arm.convention)
        for j in arm.slides:  # all origins behind it go along its axis
            axis = 12 * (j + (arm.convention == "modified")) + 6 + np.arange(3)
            way = p("mul", p("mul", p.take(own, [j] * 3), arm.joint_signs[j]), p.take(frames, axis))
            behind = np.zeros((12 * (arm.n_joints + 1), 3))
            behind.reshape(-1, 12, 3)[j + 1 :, 9:] = np.eye(3)
            frames = p("add", frames, p.affine(way, behind))
        return frames

    @cached_property
    def probe(self):
        """Centre of the probe in the base frame, mm."""
        last = self.p.take(self.frames, 12 * self.arm.n_joints + np.arange(12))
        return self.p.affine(last, np.kron([*self.arm.probe, 1.0], np.eye(3)))

    def direction(self):
        """Cosine and sine of the probe's azimuth, and the probe's distance from the axis."""
        p = self.p
        xy = p.take(self.probe, [0, 1])
        radius = p.length(xy)
        # On the axis itself 1 and 0, as atan2(0, 0) would have it.
        on_axis = p("mul", p("less", radius, _TINY), [1.0, 0.0])
        return p("add", p("div", xy, p("max", radius, _TINY)), on_axis), radius


def build_program(model, std=False, fade="exact", poses=None):
    """The program of a fitted model; ValueError names a step that cannot be exported.

    With `fade` "small" the share of a correction that fades is nearly that of ``predict``, also at
    `poses` (n, n_inputs), and from few numbers; with False nothing fades. The fingerprint is that
    of the exact program.

    Its outputs are ``y``; ``point``, the corrected point in mm, where there is an arm and y has
    three numbers; ``trust``, the share of the correction that is left, where it fades; ``std``, if
    asked for.
    """
    check_fitted(model)
    p = Builder(n_inputs(model))
    chain, steps = _Chain(model, p, std, fade, poses), list(leaves(model))
    y, v = _read(chain, steps, p.x)
    y = p("finite", y, p("join", p.x, y))
    outputs = {"y": y}
    corrects = chain.arm is not None and p.size(y) == 3
    if corrects:
        outputs["point"] = p("sub", chain.probe, y)
    if chain.trust is not None:
        outputs["trust"] = p("finite", chain.trust, y)
    if std:
        outputs["std"] = p("finite", p("sqrt", v), y)
    about = {"steps": [described(step) for _, step in steps], "corrects": corrects}
    if chain.arm is not None:
        label = f" {chain.arm.name}" if chain.arm.name else ""
        n = chain.arm.n_joints
        about["arm"] = f"arm{label}: {n} joints, {chain.arm.convention} DH, mm and rad"
        about["slides"] = chain.arm.slides
        about |= {"angle_unit": chain.unit, "extra": [name for name, _ in extra_columns(model)]}
    if chain.fade != "exact":
        about["fingerprint"] = hash_program(build_program(model))
    return pruned(Program(tuple(p.ops), outputs, about), outputs)


def _read(chain, steps, x):
    """Prediction and variance (or None) of steps, the last of which is a regressor."""
    for number, (path, step) in enumerate(steps):
        rest = steps[number + 1 :]
        if isinstance(step, CylindricalResidualTarget):
            return _cylindrical(chain, path, step, rest, x)
        if isinstance(step, PoseFeatures):
            _needs_angles(chain, path, x)
            x = pose_features(chain, step)
        elif isinstance(step, StandardScaler):
            x = chain.p("sub", x, step.mean_) if step.with_mean else x
            x = chain.p("div", x, step.scale_) if step.with_std else x
        elif isinstance(step, REGRESSORS):
            return _regressor(chain, path, step, x)
        else:
            raise ValueError(
                f"{path} is a {type(step).__name__}, which cannot be exported: only "
                f"{', '.join(kind.__name__ for kind in KNOWN)} and pipelines of these can."
            )
    names = ", ".join(kind.__name__ for kind in REGRESSORS)
    raise ValueError(f"The model has no regressor at its end: none of {names}.")


def _needs_angles(chain, path, x):
    if x != chain.x:
        raise ValueError(
            f"{path} comes after another transformer, which cannot be exported: it has to see the "
            "joint angles."
        )


def _regressor(chain, path, step, x):
    if isinstance(step, RBFNetRegressor):
        return network(chain.p, step, x, chain.std)
    if isinstance(step, ArmResidualRegressor):
        _needs_angles(chain, path, x)
        return arm_model(chain, step)
    if chain.std:
        raise ValueError(
            f"{path} is a {type(step).__name__}, which has no standard deviation: export it with "
            "std=False."
        )
    matrix = np.atleast_2d(step.coef_)
    shift = np.broadcast_to(np.atleast_1d(step.intercept_), (len(matrix),)).astype(float)
    return chain.p.affine(x, matrix, shift), None


def _cylindrical(chain, path, step, rest, x):
    """A regressor in the cylindrical frame of the probe's azimuth."""
    p, n = chain.p, step.n_features_in_ - 2
    direction = None
    if step._drops_direction:
        # A direction that comes with the features becomes NaN where its norm is not 1.
        given, x = p.take(x, [n, n + 1]), p.take(x, np.arange(n))
        low, high = 1 - NORM_TOLERANCE, 1 + NORM_TOLERANCE
        direction = p("within", given, p.length(given), low=low, high=high)
    elif step._rotates:
        _needs_angles(chain, path, x)
        direction = chain.direction()[0]
    y, v = _read(chain, rest, x)
    if not step._rotates:
        return y if direction is None else p("finite", y, direction), v
    along, across = p.take(direction, [0, 1]), p.take(direction, [1, 0])
    across_signed = p("mul", across, [-1.0, 1.0])

    def turned(values, first, second):
        a = p("mul", p.take(values, [0, 0]), first)
        b = p("mul", p.take(values, [1, 1]), second)
        return p("join", p("add", a, b), p.take(values, [2]))

    # x is radial cos - tangential sin, y radial sin + tangential cos; the variances are those of
    # independent radial, tangential and axial numbers.
    both = p("join", p.take(along, [0]), p.take(along, [1]))
    y = turned(y, both, across_signed)
    return y, None if v is None else turned(v, p("mul", along, along), p("mul", across, across))


# -- transformers ---------------------------------------------------------------------------------


def pose_features(chain, step):
    """What `PoseFeatures` makes of the joint angles."""
    p = chain.p
    columns = chain.angles()
    if step.encoding == "angle":  # into the turn around its middle
        middle = step.turn_start_ + np.pi
        turned = p("sub", columns, middle)
        columns = p("add", p("elevation", p("sin", turned), p("cos", turned)), middle)
    if step.joints == "pose":
        columns = pose_angles(chain, columns)
    if step.encoding == "periodic":
        n = p.size(columns)
        both = p("join", p("cos", columns), p("sin", columns))
        columns = p.take(both, np.arange(2 * n).reshape(2, n).T.ravel())
    columns = p("finite", columns, chain.x)
    if not step.append_azimuth:
        return columns
    direction, radius = chain.direction()
    return p("join", columns, p("within", direction, radius, low=MIN_LENGTH_MM, high=_FAR))


# Lengths above which there is no arm, mm.
_FAR = 1e30


def pose_angles(chain, angles):
    """Given angles of the pose's joints, and the elevation of the line shoulder to wrist, rad."""
    p, arm, frames = chain.p, chain.arm, chain.frames
    shoulder, wrist = (p.take(frames, 12 * i + 9 + np.arange(3)) for i in arm.pose_frames)
    line = p("sub", wrist, shoulder)
    reach = p.length(p.take(line, [0, 1]))
    elevation = p("elevation", p.take(line, [2]), reach)
    elevation = p("within", elevation, p.length(line), low=MIN_LENGTH_MM, high=_FAR)
    used = p.take(angles, np.array(arm.pose_joints) - 1)
    return p("join", used, elevation)


# -- the arm's own error model --------------------------------------------------------------------


def arm_model(chain, step):
    """Correction and variance (or None) of an `ArmResidualRegressor`, faded."""
    p, linear, fading = chain.p, step.linear_model_, step.fading_
    y, v, doubt = linear_model(chain, linear, fading)
    y = p("mul", y, fading.most) if fading.most > 0 else p.constant(np.zeros(3))
    if doubt is not None:
        share = p.constant(1.0)
        if fading.size_mm > 0:
            size = fading.size_mm**2
            beyond = doubt
            if fading.known_mm > 0:
                beyond = p("max", p("sub", doubt, fading.known_mm**2), 0.0)
            share = p("div", size, p("add", p("mul", beyond, fading.factor**2), size))
            if fading.far < 1:
                near = fading.near_mm**4
                nearness = p("div", near, p("add", p("mul", doubt, doubt), near))
                found = p("add", p("mul", nearness, 1 - fading.far), fading.far)
                share = p("mul", share, found)
        chain.trust, y = share, p("mul", y, share)
    v = p("mul", v, linear.std_scale**2) if chain.std else None
    return y, v if step.helps_ or v is None else p("max", v, fading.size_mm**2 / 3)


def linear_model(chain, linear, fading):
    """Correction of a `LinearModel`, variances, and squared doubt; each None where not needed."""
    p, arm = chain.p, linear.arm
    table = linear.layout.table
    m, n_axes = len(table), 3 * (arm.n_joints + 1)
    if not m:
        return p.constant(np.zeros(3)), p.constant(np.zeros(3)), p.constant(0.0)
    # Columns that share a vector stand together; large groups and those of many waves last, where
    # rows of a triangle are long anyway.
    vector = axis_numbers(table, arm.n_joints)
    waves = of_many_waves(table, vector)
    order = np.lexsort([vector, np.bincount(vector)[vector], waves])
    n_others = m - np.count_nonzero(waves)
    vectors = _vectors(chain)
    vector, sizes = vector[order], _sizes(chain, linear, table[order[:n_others]], vectors)
    if n_others < m:
        own = table[order[n_others:]]
        waves = p("waves", chain.phases(), joint=own["joint"], order=own["order"])
        sizes = p("join", sizes, p("mul", waves, own["unit"]))
    matrix = np.zeros((2 * n_axes, m))
    matrix[vector, np.arange(m)] = linear.coef[order]
    y = p("dots", vectors, p.affine(sizes, matrix))
    small = chain.fade != "exact"

    def variances(root, rounded=None, **given):
        used = np.flatnonzero(np.any(root, axis=1))
        if not len(used):
            return p.constant(np.zeros(3))
        root, of_rows = root[used], p.take(sizes, used)
        if rounded is not None:
            root, of_rows = rounded[0][used], p("mul", of_rows, rounded[1][used])
        elif small:  # seven digits do where no correction depends on more
            root = root.astype(np.float32)
        return p("variances", vectors, of_rows, vector=vector[used], root=root, **given)

    def triangle(half):
        # Any root gives the same variances; a triangle has half the entries.
        return np.asarray(np.linalg.qr(half[order].T, mode="r")).T

    fades = fading.factor > 0 and chain.fade
    poses = _poses(chain, linear) if small and fades else None
    v = None
    if chain.std:
        root = triangle(linear.gauge_free_half)
        v = variances(
            root, None if poses is None else _in_16_bits(root, *_seen(linear, poses, order))
        )
    if not fades:
        return y, v, None
    found = None if poses is None else small_doubt(linear, fading, poses)
    if found is not None:
        root, rounded, less, constant, waves = found
        doubt = p.sum(variances(root[order], rounded and [of[order] for of in rounded], less=less))
        if len(waves[0]):
            doubt = p("add", doubt, _of_joints(chain, vectors, *waves))
        doubt = p("max", p("add", doubt, constant), 0.0)
    else:
        same = v is not None and np.array_equal(linear.fading_half, linear.gauge_free_half)
        doubt = p.sum(v if same else variances(triangle(linear.fading_half)))
    return y, v, doubt


def _seen(linear, poses, order):
    """The model's columns (n, m) in this order, at poses that judge and at others, near and far."""
    low, high = linear.ranges
    near = np.random.default_rng(0).uniform(low, high, (_NEAR, len(low)))
    poses = np.concatenate([near, poses[::_SEEN]])
    return [
        linear.columns(at)[:, :, order].reshape(-1, len(order)) for at in (poses[::2], poses[1::2])
    ]


def _in_16_bits(root, columns, others):
    """Whole numbers for a root and the unit of each row, or None where deviations feel it.

    They do where columns that are known together only, such as lengths and zeros of joints, nearly
    cancel; not among waves, of which large models have most. What the rounding of a row changes at
    the `others` is made good by the rows behind it (nearest plane, Babai 1986): that halves it.
    `columns` (n, m) at other poses judge.
    """
    m, unit = len(root), units_of_rows(root)
    others = others / np.linalg.norm(others @ root, axis=1)[:, None]  # shares of deviations count
    size = np.linalg.norm(others, axis=0)
    held = np.diag(np.where(size > 0, _UNSEEN * size, 1.0))
    plane = np.asarray(np.linalg.qr(np.vstack([others, held])[:, ::-1], mode="r"))
    left, whole = plane @ root[::-1], np.zeros(root.shape)
    for row, i in enumerate(reversed(range(m))):
        wanted = left[i] / (plane[i, i] * unit[row])
        whole[row] = np.where(root[row], np.clip(np.rint(wanted), -INT16, INT16), 0.0)
        left[:i] -= np.outer(plane[:i, i], whole[row] * unit[row])
    exact, near = (np.linalg.norm(columns @ r, axis=1) for r in (root, whole * unit[:, None]))
    return (whole.astype(np.int16), unit) if np.all(abs(near - exact) <= _OFF * exact) else None


def _poses(chain, linear):
    """Poses from far to near in rad, with the extra columns; then those that are given."""
    factors = np.ones(chain.p.size(chain.x))
    unit = np.pi / 180 if chain.unit == "deg" else 1.0
    factors[: chain.arm.n_joints] = chain.arm.by_type(unit)
    poses = poses_from_far_to_near(
        chain.model, lambda rows: linear.predict_with_doubt(rows * factors)[2]
    )
    if chain.poses is not None:
        poses = np.concatenate([poses, chain.poses])
    return poses * factors


def compare_shares(model, exact, program):
    """By how much the shares of a correction differ: a sentence for the file."""
    exact, program = (pruned(p, ("trust",)) for p in (exact, program))
    poses = poses_from_far_to_near(
        model, lambda rows: -run(exact, rows)["trust"][:, 0], n=60, seed=10_000
    )
    off = run(program, poses)["trust"] - run(exact, poses)["trust"]
    return (
        f"fade small: the share of the correction is within {np.abs(off).max():.1e} of predict's "
        f"at {len(poses)} poses, root mean square {np.sqrt(np.mean(off**2)):.1e}"
    )


def _of_joints(chain, vectors, joints, about, series, means):
    """What the waves of joints add to the squared doubt, by the series of each."""
    p, n = chain.p, len(series)
    axes = p.size(vectors) // 3
    at = about[:, None] + axes * np.arange(3)
    turns = p.take(vectors, at.ravel())
    squares = p.affine(p("mul", turns, turns), np.kron(np.eye(n), np.ones((1, 3))))
    of, place = np.nonzero(series)
    if not len(of):
        return p("dots", squares, means)
    half = series.shape[1] // 2  # cosines, then sines
    order = place % half + 1
    waves = p(
        "waves", chain.phases(), joint=joints[of], order=np.where(place < half, order, -order)
    )
    matrix = np.zeros((n, len(of)))
    matrix[of, np.arange(len(of))] = series[of, place]
    return p("dots", squares, p.affine(waves, matrix, means))


def _vectors(chain):
    """Turns about every axis of every frame, then shifts along them: x of all, then y, then z.

    mm of the probe per rad, or per mm.
    """
    p, n_axes, frames = chain.p, 3 * (chain.arm.n_joints + 1), chain.frames
    axis = np.arange(n_axes)
    of_axis = 12 * (axis // 3) + 3 * (axis % 3)
    of_origin = 12 * (axis // 3) + 9
    k = np.repeat(np.arange(3), n_axes)
    lever = p("sub", p.take(chain.probe, k), p.take(frames, np.tile(of_origin, 3) + k))

    def part(shift):
        at = (k + shift) % 3
        return p.take(frames, np.tile(of_axis, 3) + at), p.take(
            lever, n_axes * at + np.tile(axis, 3)
        )

    (u1, r1), (u2, r2) = part(1), part(2)
    turns = p("sub", p("mul", u1, r2), p("mul", u2, r1))
    both = p("join", turns, part(0)[0])
    return p.take(both, np.arange(6 * n_axes).reshape(2, 3, n_axes).transpose(1, 0, 2).ravel())


def _sizes(chain, linear, table, vectors):
    """Size of each column: unit, wave, torque, and what an extra column says."""
    p, arm, m = chain.p, linear.arm, len(table)
    n_axes, extra = 3 * (arm.n_joints + 1), linear.terms.extra
    sizes = p.constant(table["unit"])
    waved = np.flatnonzero(table["order"])
    if len(waved):
        joint, orders = (table[name][waved] for name in ("joint", "order"))
        waves = p("waves", chain.phases(), joint=joint, order=orders)
        sizes = p("mul", sizes, _at_columns(p, m, waved, waves))
    loaded = np.flatnonzero(np.isin(table["kind"], OF_LOADS))
    if len(loaded):
        # The torque of a load, as `error_model` has it.
        places = p("join", chain.frames, chain.probe)
        of, frame = (12 * table[name][loaded] + 9 for name in ("load", "frame"))
        of = np.where(table["load"][loaded] > arm.n_joints, 12 * (arm.n_joints + 1), of)
        axis = torque_axis(table[loaded])
        axis = 12 * (axis // 3) + 3 * (axis % 3)
        up, torque = linear.layout.up, None
        for c in range(3) if arm.up_frame else np.flatnonzero(up).tolist():
            pair = (c + 1) % 3, (c + 2) % 3
            x, y = (p("sub", p.take(places, of + k), p.take(places, frame + k)) for k in pair)
            ux, uy = (p.take(places, axis + k) for k in pair)
            part = p("sub", p("mul", uy, x), p("mul", ux, y))
            if arm.up_frame:  # as seen from a positioner the vertical turns with a frame
                axes = p.take(chain.frames, 12 * arm.up_frame + np.arange(9))
                upright = p.affine(axes, np.kron(up, np.eye(3)))
                part = p("mul", part, p.take(upright, np.full(len(loaded), c)))
            elif up[c] != 1:
                part = p("mul", part, p.constant(up[c]))
            torque = part if torque is None else p("add", torque, part)
        sizes = p("mul", sizes, _at_columns(p, m, loaded, torque))
    grown = np.flatnonzero(table["kind"] == Effect.GROW)
    if len(grown):
        places, to, way = chain.frames, 12 * table["load"][grown] + 9, None
        axis = 12 * table["frame"][grown] + 3 * table["axis"][grown]
        for k in range(3):
            far = p("sub", p.take(places, to + k), p.take(places, to - 12 + k))
            part = p("mul", p.take(places, axis + k), far)
            way = part if way is None else p("add", way, part)
        sizes = p("mul", sizes, _at_columns(p, m, grown, way))
    values = p.take(chain.x, arm.n_joints + np.arange(len(extra)))
    pushed = np.flatnonzero(table["kind"] == Effect.PUSH)
    if len(pushed):
        mean = np.array([reference[0] for _, reference in extra])
        force = p.affine(p("sub", values, mean), linear.layout.forces.T)
        turns = 3 * table["frame"][pushed] + table["axis"][pushed]
        at = np.arange(3) * 2 * n_axes + turns[:, None]
        torque = p("dots", p.take(vectors, at.ravel()), force)
        sizes = p("mul", sizes, _at_columns(p, m, pushed, torque))
    given = np.flatnonzero(table["by"] >= 0)
    if not len(given):
        return sizes
    factors = p("sub", p.take(values, table["by"][given]), table["reference"][given])
    return p("mul", sizes, _at_columns(p, m, given, factors))


def _at_columns(p, m, columns, factors):
    """Factors of m columns: those of some, 1 elsewhere."""
    place = np.full(m, len(columns))
    place[columns] = np.arange(len(columns))
    return p.take(p("join", factors, 1.0), place)
