"""Fitted models as programs: the only file that knows what a model computes.

One method for each kind of step: it adds the step's operations to those before it.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm.arm import Arm
from sklearn_raacmm.error_model import OF_LOADS, ArmResidualRegressor, Effect, torque_axis
from sklearn_raacmm.export._networks import network
from sklearn_raacmm.export._program import Program
from sklearn_raacmm.export._small_doubt import (
    axis_numbers,
    blocks_of_waves,
    in_16_bits,
    poses_from_far_to_near,
    seen_columns,
    small_doubt,
)
from sklearn_raacmm.export._steps import REGRESSORS, Chain
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.residuals import NORM_TOLERANCE, CylindricalResidualTarget, PoseFeatures

# In place of a length that is nothing; lengths above which there is no arm, mm.
_TINY, _FAR = 1e-30, 1e30


def build_program(model, std=False, fade="exact", poses=None):
    """The program of a fitted model; ValueError names a step that cannot be exported.

    With `fade` "small" the share of a correction that fades is nearly that of ``predict``, also at
    `poses` (n, n_inputs), and from few numbers; with False nothing fades.

    Its outputs are ``y``; ``point``, the corrected point in mm, where there is an arm and y has
    three numbers; ``trust``, the share of the correction that is left, where it fades; ``std``, if
    asked for.
    """
    return nearly(_Reader(Chain(model), std).whole(), fade, poses)


def nearly(exact, fade, poses=None):
    """A program that fades otherwise: the exact one where nothing fades, or that is asked for."""
    if fade == "exact" or "trust" not in exact.outputs:
        return exact
    return _Reader(exact.chain, "std" in exact.outputs, exact, fade, poses).whole()


def compare_shares(program):
    """By how much the shares of a correction differ: a sentence for the file."""
    exact = program.exact.pruned("trust")
    poses = poses_from_far_to_near(
        program.chain, lambda rows: -exact.run(rows)["trust"][:, 0], n=60, seed=10_000
    )
    off = program.pruned("trust").run(poses)["trust"] - exact.run(poses)["trust"]
    return (
        f"fade small: the share of the correction is within {np.abs(off).max():.1e} of predict's "
        f"at {len(poses)} poses, root mean square {np.sqrt(np.mean(off**2)):.1e}"
    )


class _Reader:
    """Reads a chain of steps: it adds their operations to a program."""

    def __init__(self, chain, std, exact: Any = None, fade: Any = "exact", poses=None):
        self.chain, self.std = chain, std
        self.fade, self.given_poses = fade, poses
        self.arm, self.unit = chain.arm_and_unit
        self.p = Program(chain.n_inputs, chain, exact)
        self.x, self.trust = self.p.x, None

    def whole(self):
        """The program."""
        p = self.p
        y, v = self.read(self.chain.steps, self.x)
        y = p("finite", y, p("join", self.x, y))
        outputs = {"y": y}
        if self.arm is not None and y.size == 3:
            outputs["point"] = self.probe - y
        if self.trust is not None:
            outputs["trust"] = p("finite", self.trust, y)
        if self.std:
            outputs["std"] = p("finite", np.sqrt(v), y)
        p.outputs = {name: value.number for name, value in outputs.items()}
        return p.pruned(*outputs)

    def read(self, steps, x) -> tuple[Any, Any]:
        """Prediction and variance (or None) of steps, the last of which is a regressor."""
        for number, (path, step) in enumerate(steps):
            if isinstance(step, CylindricalResidualTarget):
                return self.cylindrical(path, step, steps[number + 1 :], x)
            if isinstance(step, PoseFeatures):
                self.needs_angles(path, x)
                x = self.pose_features(step)
            elif isinstance(step, StandardScaler):
                x = x - step.mean_ if step.with_mean else x
                x = x / step.scale_ if step.with_std else x
            elif isinstance(step, REGRESSORS):
                return self.regressor(path, step, x)
            else:
                known = (PoseFeatures, StandardScaler, CylindricalResidualTarget, *REGRESSORS)
                raise ValueError(
                    f"{path} is a {type(step).__name__}, which cannot be exported: only "
                    f"{', '.join(kind.__name__ for kind in known)} and pipelines of these can."
                )
        names = ", ".join(kind.__name__ for kind in REGRESSORS)
        raise ValueError(f"The model has no regressor at its end: none of {names}.")

    def needs_angles(self, path, x):
        if x is not self.x:
            raise ValueError(
                f"{path} comes after another transformer, which cannot be exported: it has to see "
                "the joint angles."
            )

    def regressor(self, path, step, x):
        if isinstance(step, RBFNetRegressor):
            return network(self.p, step, x, self.std)
        if isinstance(step, ArmResidualRegressor):
            self.needs_angles(path, x)
            return self.arm_model(step)
        if self.std:
            raise ValueError(
                f"{path} is a {type(step).__name__}, which has no standard deviation: export it "
                "with std=False."
            )
        matrix = np.atleast_2d(step.coef_)
        return x.affine(matrix, np.full(len(matrix), step.intercept_, dtype=float)), None

    def cylindrical(self, path, step, rest, x):
        """A regressor in the cylindrical frame of the probe's azimuth."""
        p, n = self.p, step.n_features_in_ - 2
        direction: Any = None
        if step._drops_direction:
            # A direction that comes with the features becomes NaN where its norm is not 1.
            given, x = x[[n, n + 1]], x[np.arange(n)]
            direction = given.within(given.length(), 1 - NORM_TOLERANCE, 1 + NORM_TOLERANCE)
        elif step._rotates:
            self.needs_angles(path, x)
            direction = self.direction[0]
        y, v = self.read(rest, x)
        if not step._rotates:
            return y if direction is None else p("finite", y, direction), v
        along, across = direction[[0, 1]], direction[[1, 0]]
        signed = across * [-1.0, 1.0]

        def turned(values, first, second):
            a, b = values[[0, 0]] * first, values[[1, 1]] * second
            return p("join", a + b, values[[2]])

        # x is radial cos - tangential sin, y radial sin + tangential cos; the variances are those
        # of independent radial, tangential and axial numbers.
        y = turned(y, p("join", along[0], along[1]), signed)
        return y, None if v is None else turned(v, along * along, across * across)

    # -- the arm ------------------------------------------------------------------------------

    @cached_property
    def angles(self):
        """Joint angles in rad, and mm of what slides."""
        n = self.arm.n_joints
        angles = self.x if self.x.size == n else self.x[np.arange(n)]
        if self.unit == "rad":
            return angles
        per_degree = np.pi / 180
        return angles * (self.arm.by_type(per_degree) if self.arm.slides else per_degree)

    @cached_property
    def own_angles(self):
        """Angle of each joint itself in rad, where some are sums of what is given."""
        if not self.arm.couplings:
            return self.angles
        return self.angles.affine(self.arm.own_angles(np.eye(self.arm.n_joints)).T)

    @cached_property
    def phases(self):
        """What waves of each joint's error are waves of, rad."""
        return self.own_angles * self.arm.phase_factors if self.arm.slides else self.own_angles

    @cached_property
    def frames(self):
        """Axes and origin of every frame, 12 numbers each, the base first."""
        arm, own = self.arm, self.own_angles
        theta = own * (arm.joint_signs * arm.by_type(1.0, 0.0)) + arm.theta_offset
        table = np.stack([np.cos(arm.alpha), np.sin(arm.alpha), arm.a, arm.d], axis=1)
        frames = self.p("frames", theta, table=table, convention=arm.convention)
        for j in arm.slides:  # all origins behind it go along its axis
            axis = 12 * (j + (arm.convention == "modified")) + 6 + np.arange(3)
            way = own[[j] * 3] * arm.joint_signs[j] * frames[axis]
            behind = np.zeros((12 * (arm.n_joints + 1), 3))
            behind.reshape(-1, 12, 3)[j + 1 :, 9:] = np.eye(3)
            frames = frames + way.affine(behind)
        return frames

    @cached_property
    def probe(self):
        """Centre of the probe in the base frame, mm."""
        last = self.frames[12 * self.arm.n_joints + np.arange(12)]
        return last.affine(np.kron([*self.arm.probe, 1.0], np.eye(3)))

    @cached_property
    def direction(self):
        """Cosine and sine of the probe's azimuth, and the probe's distance from the axis."""
        xy = self.probe[[0, 1]]
        radius = xy.length()
        # On the axis itself 1 and 0, as atan2(0, 0) would have it.
        on_axis = np.less(radius, _TINY) * [1.0, 0.0]
        return xy / np.maximum(radius, _TINY) + on_axis, radius

    def pose_features(self, step):
        """What `PoseFeatures` makes of the joint angles."""
        p, columns = self.p, self.angles
        if step.encoding == "angle":  # into the turn around its middle
            middle = step.turn_start_ + np.pi
            turned = columns - middle
            columns = p("elevation", np.sin(turned), np.cos(turned)) + middle
        if step.joints == "pose":
            elevation = self.elevation()
            columns = p("join", columns[np.array(self.arm.pose_joints) - 1], elevation)
        if step.encoding == "periodic":
            n = columns.size
            both = p("join", np.cos(columns), np.sin(columns))
            columns = both[np.arange(2 * n).reshape(2, n).T.ravel()]
        columns = p("finite", columns, self.x)
        if not step.append_azimuth:
            return columns
        direction, radius = self.direction
        return p("join", columns, direction.within(radius, Arm.MIN_LENGTH_MM, _FAR))

    def elevation(self):
        """Elevation of the line from shoulder to wrist, rad."""
        shoulder, wrist = (self.frames[12 * i + 9 + np.arange(3)] for i in self.arm.pose_frames)
        line = wrist - shoulder
        reach = line[[0, 1]].length()
        elevation = self.p("elevation", line[2], reach)
        return elevation.within(line.length(), Arm.MIN_LENGTH_MM, _FAR)

    # -- the arm's own error model ------------------------------------------------------------

    def arm_model(self, step):
        """Correction and variance (or None) of an `ArmResidualRegressor`, faded."""
        linear, fading = step.linear_model_, step.fading_
        y, v, doubt = self.linear_model(linear, fading)
        y = y * fading.most if fading.most > 0 else self.p.constant(np.zeros(3))
        if doubt is not None:
            share = self.p.constant(1.0)
            if fading.size_mm > 0:
                size = fading.size_mm**2
                known = fading.known_mm**2
                beyond = np.maximum(doubt - known, 0.0) if known else doubt
                share = size / (beyond * fading.factor**2 + size)
                if fading.far < 1:
                    near = fading.near_mm**4
                    nearness = near / (doubt * doubt + near)
                    share = share * (nearness * (1 - fading.far) + fading.far)
            self.trust, y = share, y * share
        if v is not None:
            v = v * linear.std_scale**2
            v = v if step.helps_ else np.maximum(v, fading.size_mm**2 / 3)
        return y, v

    def linear_model(self, linear, fading):
        """Correction of a `LinearModel`, variances and squared doubt, None where not needed."""
        p, table = self.p, linear.layout.table
        m, n_axes = len(table), 3 * (self.arm.n_joints + 1)
        if not m:
            nothing = p.constant(np.zeros(3))
            return nothing, nothing if self.std else None, p.constant(0.0)
        # Columns that share a vector stand together; large groups and those of many waves last,
        # where rows of a triangle are long anyway.
        vector, waves = axis_numbers(table, self.arm.n_joints), np.zeros(m, dtype=bool)
        for block in blocks_of_waves(table, vector):
            waves[block] = True
        order = np.lexsort([vector, np.bincount(vector)[vector], waves])
        vector = vector[order]
        vectors = self.vectors()
        sizes = self.sizes(linear, table[order], np.count_nonzero(waves), vectors)
        matrix = np.zeros((2 * n_axes, m))
        matrix[vector, np.arange(m)] = linear.coef[order]
        y = vectors.dots(sizes.affine(matrix))
        small, fades = self.fade != "exact", fading.factor > 0 and self.fade
        poses = self.poses(linear) if small and fades else None

        def variances(root, unit=None, **given):
            used = np.flatnonzero(np.any(root, axis=1))
            if not len(used):
                return p.constant(np.zeros(3))
            root, of_rows = root[used], sizes[used]
            if unit is not None:
                of_rows = of_rows * unit[used]
            elif small:  # seven digits do where no correction depends on more
                root = root.astype(np.float32)
            return p("variances", vectors, of_rows, vector=vector[used], root=root, **given)

        def triangle(half):
            # Any root gives the same variances; a triangle has half the entries.
            return np.asarray(np.linalg.qr(half[order].T, mode="r")).T

        v: Any = None
        if self.std:
            root = triangle(linear.gauge_free_half)
            seen = () if poses is None else seen_columns(linear, poses, order)
            v = variances(*in_16_bits(root, *seen) if seen else (root,))
        if not fades:
            return y, v, None
        if poses is not None and (found := small_doubt(linear, fading, poses)) is not None:
            root, unit, less, constant, waves = found
            unit = None if unit is None else unit[order]
            doubt = variances(root[order], unit, less=less).dots(np.ones(3))
            if len(waves[0]):
                doubt = doubt + self.of_joints(vectors, *waves)
            return y, v, np.maximum(doubt + constant, 0.0)
        squares = v
        if v is None or not np.array_equal(linear.fading_half, linear.gauge_free_half):
            squares = variances(triangle(linear.fading_half))
        return y, v, squares.dots(np.ones(3))

    def poses(self, linear):
        """Poses from far to near in rad, with the extra columns; then those that are given."""
        factors = np.ones(self.x.size)
        unit = np.pi / 180 if self.unit == "deg" else 1.0
        factors[: self.arm.n_joints] = self.arm.by_type(unit)
        poses = poses_from_far_to_near(
            self.chain, lambda rows: linear.predict_with_doubt(rows * factors)[2]
        )
        if self.given_poses is not None:
            poses = np.concatenate([poses, self.given_poses])
        return poses * factors

    def of_joints(self, vectors, joints, about, series, means):
        """What the waves of joints add to the squared doubt, by the series of each."""
        n, axes = len(series), vectors.size // 3
        turns = vectors[(about[:, None] + axes * np.arange(3)).ravel()]
        squares = (turns * turns).affine(np.kron(np.eye(n), np.ones((1, 3))))
        of, place = np.nonzero(series)
        if not len(of):
            return squares.dots(means)
        half = series.shape[1] // 2  # cosines, then sines
        order = place % half + 1
        order = np.where(place < half, order, -order)
        matrix = np.zeros((n, len(of)))
        matrix[of, np.arange(len(of))] = series[of, place]
        waves = self.p("waves", self.phases, joint=joints[of], order=order)
        return squares.dots(waves.affine(matrix, means))

    def vectors(self):
        """Turns about every axis of every frame, then shifts along them: x of all, then y, then z.

        mm of the probe per rad, or per mm.
        """
        p, n_axes, frames = self.p, 3 * (self.arm.n_joints + 1), self.frames
        axis = np.arange(n_axes)
        of_axis, of_origin = 12 * (axis // 3) + 3 * (axis % 3), 12 * (axis // 3) + 9
        k = np.repeat(np.arange(3), n_axes)
        lever = self.probe[k] - frames[np.tile(of_origin, 3) + k]

        def part(shift):
            at = (k + shift) % 3
            return frames[np.tile(of_axis, 3) + at], lever[n_axes * at + np.tile(axis, 3)]

        (u1, r1), (u2, r2) = part(1), part(2)
        both = p("join", u1 * r2 - u2 * r1, part(0)[0])
        return both[np.arange(6 * n_axes).reshape(2, 3, n_axes).transpose(1, 0, 2).ravel()]

    def sizes(self, linear, table, n_waves, vectors):
        """Size of each column: unit, wave, torque, and what an extra column says.

        The last `n_waves` columns are waves and nothing else.
        """
        p, others = self.p, table[: len(table) - n_waves]
        sizes = p.constant(others["unit"])
        for columns, factor in (
            (others["order"] != 0, self.waves),
            (np.isin(others["kind"], OF_LOADS), self.torques),
            (others["kind"] == Effect.GROW, self.growths),
            (others["kind"] == Effect.PUSH, self.pushes),
            (others["by"] >= 0, self.extra_factors),
        ):
            some = others[columns]
            if len(some):  # factors of these, 1 elsewhere
                place = np.where(columns, np.cumsum(columns) - 1, len(some))
                sizes = sizes * p("join", factor(some, linear, vectors), 1.0)[place]
        if n_waves:
            some = table[len(others) :]
            sizes = p("join", sizes, self.waves(some) * some["unit"])
        return sizes

    def waves(self, table, *_):
        """Sine or cosine of a multiple of each column's angle."""
        return self.p("waves", self.phases, joint=table["joint"], order=table["order"])

    def torques(self, table, linear, vectors):
        """The torque of a load, as `error_model` has it."""
        places, n = self.p("join", self.frames, self.probe), self.arm.n_joints
        of, frame = (12 * table[name] + 9 for name in ("load", "frame"))
        of = np.where(table["load"] > n, 12 * (n + 1), of)
        axis = torque_axis(table)
        axis = 12 * (axis // 3) + 3 * (axis % 3)
        up = linear.layout.up

        def along(c):
            pair = (c + 1) % 3, (c + 2) % 3
            x, y = (places[of + k] - places[frame + k] for k in pair)
            ux, uy = (places[axis + k] for k in pair)
            part = uy * x - ux * y
            if self.arm.up_frame:  # as seen from a positioner the vertical turns with a frame
                axes = self.frames[12 * self.arm.up_frame + np.arange(9)]
                part = part * axes.affine(np.kron(up, np.eye(3)))[np.full(len(table), c)]
            elif up[c] != 1:
                part = part * self.p.constant(up[c])
            return part

        return reduce(add, map(along, range(3) if self.arm.up_frame else np.flatnonzero(up)))

    def growths(self, table, linear, vectors):
        """How long the way to a frame is, along an axis."""
        places, to = self.frames, 12 * table["load"] + 9
        axis = 12 * table["frame"] + 3 * table["axis"]
        ways = (places[axis + k] * (places[to + k] - places[to - 12 + k]) for k in range(3))
        return reduce(add, ways)

    def extra_values(self):
        return self.x[self.arm.n_joints + np.arange(len(self.chain.extra))]

    def pushes(self, table, linear, vectors):
        """The torque of a force at the probe that an extra column says."""
        mean = np.array([reference[0] for _, reference in self.chain.extra])
        force = (self.extra_values() - mean).affine(linear.layout.forces.T)
        turns = 3 * table["frame"] + table["axis"]
        at = np.arange(3) * (vectors.size // 3) + turns[:, None]
        return vectors[at.ravel()].dots(force)

    def extra_factors(self, table, linear, vectors):
        """What an extra column is off its reference."""
        return self.extra_values()[table["by"]] - table["reference"]
