"""ONNX graphs of the arm's own error model: its columns, its fading, and the sum of its stages."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.error_model import LOAD, PUSH, SHIFT, column_table, given_factors
from sklearn_raacmm.export._onnx_graph import Graph, TensorProto, angle, point, transforms
from sklearn_raacmm.export._onnx_steps import azimuth, network, pose_angles, to_cartesian
from sklearn_raacmm.export._steps import arm_of, fadings_of, force_of, posterior_spectrum

# Entry [j, 3 k + i] of the product that makes the matrix of ``u -> u x r`` of r: (u x r)_k is the
# sum over i and j of it times u_i r_j.
_CROSS = np.zeros((3, 9))
for _k in range(3):
    _i, _j = (_k + 1) % 3, (_k + 2) % 3
    _CROSS[_j, 3 * _k + _i], _CROSS[_i, 3 * _k + _j] = 1.0, -1.0


def residual_shape(operator):
    """Residuals have three columns."""
    kind = type(operator.inputs[0].type)
    operator.outputs[0].type = kind([operator.inputs[0].get_first_dimension(), 3])


def _frames(graph, arm, poses):
    """Axes (n, F, 3, 3) as columns, and places (n, F + 1, 3): all origins, then the probe."""
    one = graph.integers(1)
    base = graph("Add", graph("Mul", poses[0], 0.0), np.eye(4))
    frames = [graph("Unsqueeze", pose, one) for pose in (base, *poses)]
    frames = graph("Concat", *frames, axis=1)
    upper = graph("Slice", frames, *(graph.integers(v) for v in (0, 3, 2)))
    axes = graph("Slice", upper, *(graph.integers(v) for v in (0, 3, 3)))
    origins = graph("Gather", upper, graph.constant(3, np.int64), axis=3)
    probe = graph("Unsqueeze", point(graph, poses[-1], arm.probe), one)
    return axes, graph("Concat", origins, probe, axis=1)


def _vectors(graph, axes, places, n_frames):
    """Turns about every axis, then shifts along them, (n, 3, 6 F): mm per rad, or 1."""
    origins = graph("Slice", places, *(graph.integers(v) for v in (0, n_frames, 1)))
    probe = graph("Slice", places, *(graph.integers(v) for v in (n_frames, n_frames + 1, 1)))
    cross = graph("MatMul", graph("Sub", probe, origins), _CROSS)
    cross = graph("Reshape", cross, graph.integers(0, n_frames, 3, 3))
    moves = []
    for vectors in (graph("MatMul", cross, axes), axes):
        rows = graph("Transpose", vectors, perm=[0, 2, 1, 3])
        moves.append(graph("Reshape", rows, graph.integers(0, 3, 3 * n_frames)))
    return graph("Concat", *moves, axis=2)


def _waves(graph, table, angles):
    """Cosine or sine of each column, 1 where it has none, (n, m)."""
    of_wave = np.flatnonzero(table.order)
    pairs = np.stack([table.of, np.abs(table.order)])[:, of_wave]
    pairs, place = np.unique(pairs, axis=1, return_inverse=True)
    which = np.zeros(len(table.order), dtype=int)
    which[of_wave] = 1 + place.ravel() + (table.order[of_wave] < 0) * pairs.shape[1]
    phase = graph("Gather", angles, graph.integers(*pairs[0]), axis=1)
    phase = graph("Mul", phase, pairs[1].astype(float))
    ones = graph("Add", graph.refusal(angles), 1.0)
    waves = graph("Concat", ones, graph.cos(phase), graph("Sin", phase), axis=1)
    return graph("Gather", waves, graph.integers(*which), axis=1)


def _at_columns(graph, m, parts):
    """Factor of each of m columns, (n, m): of parts (columns, name of (n, len)); 1 elsewhere."""
    which, n = np.zeros(m, dtype=int), 1
    for columns, _ in parts:
        which[columns] = n + np.arange(len(columns))
        n += len(columns)
    ones = graph("Add", graph.refusal(parts[0][1]), 1.0)
    both = graph("Concat", ones, *(factors for _, factors in parts), axis=1)
    return graph("Gather", both, graph.integers(*which), axis=1)


def _torques(graph, table, vectors, places, n_frames):
    """Columns of loads, and their torques about their axes, mm."""
    loaded = np.flatnonzero(table.kind == LOAD)
    axis = (3 * n_frames + 3 * table.frame + table.axis)[loaded]  # gravity is along -z
    axis = graph("Gather", vectors, graph.integers(*axis), axis=2)
    ends = [
        graph("Gather", places, graph.integers(*of[loaded]), axis=1)
        for of in (table.of, table.frame)
    ]
    lever = graph("Transpose", graph("Sub", *ends), perm=[0, 2, 1])
    ux, uy = (graph("Gather", axis, graph.constant(i, np.int64), axis=1) for i in (0, 1))
    rx, ry = (graph("Gather", lever, graph.constant(i, np.int64), axis=1) for i in (0, 1))
    return loaded, graph("Sub", graph("Mul", uy, rx), graph("Mul", ux, ry))


def _pushes(graph, table, vectors, values, extra):
    """Columns of a force on the probe, and its torques about their axes."""
    pushed = np.flatnonzero(table.kind == PUSH)
    mean = np.array([[reference[0] for _, reference in extra]])
    force = graph("MatMul", graph("Sub", values, mean), force_of(extra).T)
    turns = (3 * table.frame + table.axis)[pushed]
    turns = graph("Gather", vectors, graph.integers(*turns), axis=2)
    torque = graph("MatMul", graph("Unsqueeze", force, graph.integers(1)), turns)
    return pushed, graph("Squeeze", torque, graph.integers(1))


def _given(graph, factors, values):
    """Columns that extra columns multiply, and by what: 1 or 0 for a tool, else a difference."""
    parts = []
    for of_tool in np.unique(factors.of_tool):
        column, by, reference, _ = (field[factors.of_tool == of_tool] for field in factors)
        value = graph("Gather", values, graph.integers(*by), axis=1)
        operation = "Equal" if of_tool else "Sub"
        value = graph(operation, value, reference[None, :])
        parts.append((column, graph("Cast", value, to=TensorProto.DOUBLE)))
    return parts


def _unknown_tools(graph, values, extra):
    """A column of zeros, NaN where a tool is none of the fit's, which predict refuses."""
    total = graph.refusal(values)
    for i, (name, known) in enumerate(extra):
        if name == "tool":
            same = graph("Equal", graph.columns(values, i, i + 1), np.array([known]))
            same = graph("Cast", same, to=TensorProto.DOUBLE)
            count = graph("ReduceSum", same, graph.integers(1), keepdims=1)
            total = graph.where(graph("Less", count, 0.5), np.nan, total)
    return total


def _sizes(graph, linear, table, angles, values, vectors, places):
    """Size of each column, (n, m): unit, wave, torque, and what an extra column says."""
    m, n_frames = len(table.kind), linear.arm.n_joints + 1
    size = graph("Add", graph.refusal(angles), table.unit[None, :])
    if np.any(table.order):
        size = graph("Mul", size, _waves(graph, table, angles))
    parts = []
    if np.any(table.kind == LOAD):
        parts.append(_torques(graph, table, vectors, places, n_frames))
    if np.any(table.kind == PUSH):
        parts.append(_pushes(graph, table, vectors, values, linear.terms.extra))
    if parts:
        size = graph("Mul", size, _at_columns(graph, m, parts))
    factors = given_factors(linear.arm, linear.terms)
    if len(factors.column):
        parts = _given(graph, factors, values)
        size = graph("Mul", size, _at_columns(graph, m, parts))
    return size


def _linear_model(graph, linear, angles, values, poses, doubted):
    """Correction (n, 3) of a `LinearModel`, and the sum of its variances (n, 1) if `doubted`."""
    table, n_frames = column_table(linear.arm, linear.terms), linear.arm.n_joints + 1
    if not len(table.kind):
        nothing = graph.refusal(angles)
        return graph("Add", nothing, np.zeros((1, 3))), nothing
    axes, places = _frames(graph, linear.arm, poses)
    vectors = _vectors(graph, axes, places, n_frames)
    size = _sizes(graph, linear, table, angles, values, vectors, places)
    which = np.where(table.kind == SHIFT, 3 * n_frames, 0) + 3 * table.frame + table.axis
    columns = graph("Gather", vectors, graph.integers(*which), axis=2)
    columns = graph("Mul", columns, graph("Unsqueeze", size, graph.integers(1)))
    y = graph("MatMul", columns, linear.coef[:, None])
    y = graph("Squeeze", y, graph.integers(2))
    if not doubted:
        return y, None
    dots = graph("MatMul", columns, linear.gauge_free_half)
    squares = graph("ReduceSum", graph("Mul", dots, dots), graph.integers(1, 2), keepdims=1)
    return y, graph("Squeeze", squares, graph.integers(2))


def _network_variance(graph, parts, x):
    """Sum over the outputs of a network's variances, (n, 1), without noise."""
    total, *others = (_group_variance(graph, step, x, phi) for step, phi in parts)
    for variance in others:
        total = graph("Add", total, variance)
    return total


def _group_variance(graph, step, x, phi):
    """The same of outputs that share centres."""
    turn, shift, tail, shrunk = posterior_spectrum(step)
    noise, signal = step.noise_variance, step.signal_variance
    one = graph.integers(1)
    total = graph("Add", graph.refusal(x), 0.0)
    u = g = None
    if len(tail):
        u = graph("Add", graph("MatMul", x, tail[:, 1:].T), tail[None, :, 0])
        squares = graph("ReduceSum", graph("Mul", u, u), one, keepdims=1)
        total = graph("Add", total, graph("Mul", squares, noise.sum()))
    if phi is None:
        return graph("Add", total, signal.sum())
    g = graph("MatMul", phi, turn.T)
    inside = graph("ReduceSum", graph("Mul", g, g), one, keepdims=1)
    outside = graph("Max", graph("Sub", 1.0, inside), 0.0)
    h = g if u is None else graph("Sub", g, graph("MatMul", u, shift.T))
    weights = (noise[:, None] * shrunk).sum(axis=0)[:, None]
    known = graph("MatMul", graph("Mul", h, h), weights)
    return graph("Add", graph("Add", total, known), graph("Mul", outside, signal.sum()))


def _faded(graph, y, variance, fading):
    """A stage times the share of it that `Fading` leaves."""
    if variance is None or not (fading.factor > 0 and fading.size_mm > 0):
        return y
    size = fading.size_mm**2
    doubt = graph("Max", graph("Sub", variance, fading.known_mm**2), 0.0)
    total = graph("Add", graph("Mul", doubt, fading.factor**2), size)
    return graph("Mul", y, graph("Div", size, graph("Max", total, 1e-300)))


def _capped(graph, y, cap_mm):
    """No longer than `cap_mm`."""
    squares = graph("ReduceSum", graph("Mul", y, y), graph.integers(1), keepdims=1)
    length = graph("Max", graph("Sqrt", squares), 1e-300)
    return graph("Mul", y, graph("Min", graph("Div", cap_mm, length), 1.0))


def convert_arm_model(scope, operator, container):
    """Either of the arm's estimators: their stages, each faded, and the cap of their sum."""
    step, graph = operator.raw_operator, Graph(scope, container)
    arm, unit = arm_of(step)
    given, extra = graph.as_double(operator.inputs[0]), step.linear_model_.terms.extra
    values = None
    if extra:
        values = graph.columns(given, arm.n_joints, arm.n_joints + len(extra))
        given = graph.columns(given, 0, arm.n_joints)
    angles = graph.radians(given, unit)
    use, fadings = getattr(step, "use_", "harmonics"), fadings_of(step)
    total = graph("Add", graph.refusal(angles), np.zeros((1, 3)))
    if extra:
        total = graph("Add", total, _unknown_tools(graph, values, extra))
    doubted = fadings[0].factor > 0
    if use != "none":
        poses = transforms(graph, arm, angles)
        y, variance = _linear_model(graph, step.linear_model_, angles, values, poses, doubted)
        total = graph("Add", total, _faded(graph, y, variance, fadings[0]))
    if use == "harmonics+network":
        x = angles
        if step.joints == "pose":
            used, elevation = pose_angles(graph, arm, angles, poses)
            x = graph("Concat", used, angle(graph, *elevation), axis=1)
        y, parts = network(graph, step.network_, x)
        variance = _network_variance(graph, parts, x) if doubted else None
        y = to_cartesian(graph, y, azimuth(graph, arm, poses))
        total = graph("Add", total, _faded(graph, y, variance, fadings[1]))
    cap_mm = getattr(step, "cap_mm_", np.inf)
    graph.put(_capped(graph, total, cap_mm) if np.isfinite(cap_mm) else total, operator.outputs[0])
