"""ONNX graphs of PoseFeatures, RBFNetRegressor and CylindricalResidualTarget."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.arm import MIN_LENGTH_MM
from sklearn_raacmm.export._onnx_graph import (
    FloatTensorType,
    Graph,
    angle,
    direction_of_probe,
    elevation,
    get_model_alias,
    norm,
    point,
    transforms,
)
from sklearn_raacmm.export._steps import azimuth_arm, n_outputs
from sklearn_raacmm.residuals import NORM_TOLERANCE


def pose_shape(operator):
    kind = type(operator.inputs[0].type)
    rows = operator.inputs[0].get_first_dimension()
    operator.outputs[0].type = kind([rows, len(operator.raw_operator._names())])


def pose_angles(graph, arm, angles, poses):
    """The pose's joints (n, k), and cosine and sine (n, 1) of the wrist's elevation."""
    joints = [joint - 1 for joint in arm.pose_joints]
    used = graph("Gather", angles, graph.integers(*joints), axis=1)
    shoulder, wrist = (
        point(graph, poses[i - 1], np.zeros(3)) if i else np.zeros((1, 3)) for i in arm.pose_frames
    )
    return used, elevation(graph, graph("Sub", wrist, shoulder))


def convert_pose(scope, operator, container):
    step, graph = operator.raw_operator, Graph(scope, container)
    arm, given = step.arm_, graph.as_double(operator.inputs[0])
    angles = graph.radians(given, step.angle_unit)
    poses = None
    if step.joints == "pose" or step.append_azimuth:
        poses = transforms(graph, arm, angles)
    used, extra = angles, []
    if step.joints == "pose":
        used, extra = pose_angles(graph, arm, angles, poses)
    if step.encoding == "angle":
        features = [used] + ([angle(graph, *extra)] if extra else [])
    else:
        cos, sin = [graph.cos(used)], [graph("Sin", used)]
        if extra:
            cos, sin = [*cos, extra[0]], [*sin, extra[1]]
        m = len(step._names()) // 2 - int(step.append_azimuth)
        order = np.arange(2 * m).reshape(2, m).T.ravel()  # cosine and sine by turns
        both = graph("Concat", *cos, *sin, axis=1)
        features = [graph("Gather", both, graph.integers(*order), axis=1)]
    if step.append_azimuth:
        direction, radius = direction_of_probe(graph, arm, poses)
        on_axis = graph("Less", radius, MIN_LENGTH_MM)
        features.append(graph.where(on_axis, np.nan, direction))
    features = graph("Concat", *features, axis=1)
    graph.put(graph("Add", features, graph.refusal(given)), operator.outputs[0])


def network_shape(operator):
    kind = type(operator.inputs[0].type)
    rows = operator.inputs[0].get_first_dimension()
    kind = kind if kind.__name__ in ("DoubleTensorType", "FloatTensorType") else FloatTensorType
    operator.outputs[0].type = kind([rows, n_outputs(operator.raw_operator)])


_SQRT3, _SQRT5 = np.sqrt(3.0), np.sqrt(5.0)


def _radial(graph, kernel, s):
    """Radial functions of squared distances s."""
    if kernel == "gaussian":
        return graph("Exp", graph("Mul", s, -0.5))
    if kernel in ("matern32", "matern52"):
        d = graph("Mul", graph("Sqrt", s), _SQRT3 if kernel == "matern32" else _SQRT5)
        factor = graph("Add", d, 1.0)
        if kernel == "matern52":
            factor = graph("Add", factor, graph("Mul", s, 5 / 3))
        return graph("Mul", factor, graph("Exp", graph("Neg", d)))
    if kernel == "rational_quadratic":
        return graph("Div", 1.0, graph("Add", graph("Mul", s, 0.5), 1.0))
    if kernel == "inverse_multiquadric":
        return graph("Div", 1.0, graph("Sqrt", graph("Add", s, 1.0)))
    raise RuntimeError(f"RBFNetRegressor with kernel={kernel!r} cannot be converted to ONNX.")


def network(graph, step, x):
    """Prediction (n, q) of an `RBFNetRegressor`.

    Returns
    -------
    y : str
    parts : list of (Network, str or None)
        Its networks, and their radial functions (n, k), None without centres.
    """
    groups = step.networks_
    found = [_group_network(graph, part, x) for part in groups]
    parts = [(part, phi) for part, (_, phi) in zip(groups, found, strict=True)]
    if len(groups) == 1:
        return found[0][0], parts
    order = np.argsort(np.concatenate([part.outputs for part in groups]))
    y = graph("Concat", *(y for y, _ in found), axis=1)
    return graph("Gather", y, graph.integers(*order), axis=1), parts


def _group_network(graph, step, x):
    """Prediction of outputs that share centres, and their radial functions or None."""
    y = graph("Add", graph.refusal(x), step.polynomial[:1])
    linear = step.polynomial[1:]
    if np.any(linear):
        y = graph("Add", y, graph("MatMul", x, linear))
    centers = step.centers
    if not len(centers):
        return y, None
    shift = centers.mean(axis=0)
    centers = (centers - shift) / step.length_scale
    z = graph("Mul", graph("Sub", x, shift), 1 / step.length_scale)
    # |z|^2 + |c|^2 - 2 z.c, as predict has it.
    squares = graph("ReduceSum", graph("Mul", z, z), graph.integers(1), keepdims=1)
    s = graph("MatMul", z, -2.0 * centers.T)
    s = graph("Add", graph("Add", s, np.square(centers).sum(axis=1)[None, :]), squares)
    phi = _radial(graph, step.kernel, graph("Max", s, 0.0))
    return graph("Add", y, graph("MatMul", phi, step.coef)), phi


def convert_network(scope, operator, container):
    step, graph = operator.raw_operator, Graph(scope, container)
    y, _ = network(graph, step, graph.as_double(operator.inputs[0]))
    graph.put(y, operator.outputs[0])


def azimuth(graph, arm, poses):
    """Cosine and sine (n, 2) of the probe's azimuth; 1 and 0 on the axis itself."""
    direction, radius = direction_of_probe(graph, arm, poses)
    return graph.where(graph("Greater", radius, 0.0), direction, np.array([[1.0, 0.0]]))


def to_cartesian(graph, y, direction):
    """Radial, tangential and axial columns as x, y and z, (n, 3)."""
    cos, sin = (graph.columns(direction, i, i + 1) for i in (0, 1))
    radial, tangential, axial = (graph.columns(y, i, i + 1) for i in (0, 1, 2))
    dx = graph("Sub", graph("Mul", radial, cos), graph("Mul", tangential, sin))
    dy = graph("Add", graph("Mul", radial, sin), graph("Mul", tangential, cos))
    return graph("Concat", dx, dy, axial, axis=1)


def target_shape(operator):
    kind = type(operator.inputs[0].type)
    rows = operator.inputs[0].get_first_dimension()
    size = 3 if operator.raw_operator._rotates else None
    operator.outputs[0].type = kind([rows, size])


def convert_target(scope, operator, container):
    step, graph = operator.raw_operator, Graph(scope, container)
    given, kind = operator.inputs[0], type(operator.inputs[0].type)
    direction = None
    inside = scope.declare_local_variable("raacmm_features", kind())
    if step._drops_direction:
        n = step.n_features_in_
        limits = [graph.integers(v) for v in (0, n - 2, 1)]
        graph("Slice", given.full_name, *limits, into=[inside.full_name])
        direction = graph.columns(graph.as_double(given), n - 2, n)
        off = graph("Abs", graph("Sub", norm(graph, direction), 1.0))
        wrong = graph("Greater", off, NORM_TOLERANCE)
        direction = graph.where(wrong, np.nan, direction)
    else:
        graph("Identity", given.full_name, into=[inside.full_name])
        if step._rotates:
            arm, unit = azimuth_arm("CylindricalResidualTarget", step.azimuth)
            angles = graph.radians(graph.as_double(given), unit)
            direction = azimuth(graph, arm, transforms(graph, arm, angles))
    rows = given.get_first_dimension()
    inside.type = kind([rows, step.n_features_in_ - 2 * int(step._drops_direction)])
    inner = scope.declare_local_operator(get_model_alias(type(step.regressor_)), step.regressor_)
    inner.inputs.append(inside)
    predicted = scope.declare_local_variable("raacmm_predicted", kind())
    inner.outputs.append(predicted)
    y = graph.as_double(predicted)
    if step._rotates:
        y = to_cartesian(graph, y, direction)
        y = graph("Add", y, graph.refusal(direction))
    graph.put(y, operator.outputs[0])
