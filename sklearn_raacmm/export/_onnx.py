"""Converters for skl2onnx: PoseFeatures, RBFNetRegressor and CylindricalResidualTarget.

Everything is computed in float64 and cast where the model's input is float32: joint angles in
float32 are good to a nanometre of correction, kinematics in float32 is not.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.arm import MIN_LENGTH_MM
from sklearn_raacmm.export._steps import azimuth_arm, leaves, n_outputs
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.residuals import NORM_TOLERANCE, CylindricalResidualTarget, PoseFeatures

try:
    from onnx import TensorProto
    from skl2onnx import get_model_alias, update_registered_converter
    from skl2onnx.common.data_types import FloatTensorType, guess_proto_type
except ImportError as error:  # this module can be looked at without, but not used
    MISSING = error
else:
    MISSING = None

# Operators as of this version, and of every later one that skl2onnx knows.
_OPSET = 13


class _Graph:
    """Adds nodes to a converter's container: ``graph("Mul", a, b)`` is the name of the product.

    Inputs are names, or numbers, which become float64 constants.
    """

    def __init__(self, scope, container):
        if container.target_opset < _OPSET:
            raise RuntimeError(
                f"sklearn_raacmm's converters need target_opset {_OPSET} or newer, got "
                f"{container.target_opset}."
            )
        self._scope, self._container = scope, container

    def constant(self, value, dtype=np.float64):
        """Name of a constant."""
        value = np.asarray(value, dtype=dtype)
        kind = TensorProto.DOUBLE if dtype is np.float64 else TensorProto.INT64
        name = self._scope.get_unique_variable_name("raacmm_constant")
        self._container.add_initializer(name, kind, list(value.shape), value.ravel().tolist())
        return name

    def integers(self, *values):
        """Name of a list of integers."""
        return self.constant(values, np.int64)

    def __call__(self, op, *inputs, outputs=1, into=None, **attributes):
        names = [v if isinstance(v, str) else self.constant(v) for v in inputs]
        into = into or [
            self._scope.get_unique_variable_name(f"raacmm_{op.lower()}") for _ in range(outputs)
        ]
        self._container.add_node(
            op,
            names,
            into,
            op_version=_OPSET,
            name=self._scope.get_unique_operator_name(f"raacmm_{op}"),
            **attributes,
        )
        return into[0] if len(into) == 1 else into

    def as_double(self, variable):
        """An input of the converted step, in float64."""
        return self("Cast", variable.full_name, to=TensorProto.DOUBLE)

    def put(self, name, variable):
        """Write the result in the type of the step's output."""
        self("Cast", name, into=[variable.full_name], to=guess_proto_type(variable.type))

    def columns(self, x, first, last):
        """Columns `first` to before `last`."""
        limits = (self.integers(v) for v in (first, last, 1))
        return self("Slice", x, *limits)

    def refusal(self, x):
        """A column of zeros, NaN where a row of x is not finite."""
        return self("Mul", self("ReduceSum", x, self.integers(1), keepdims=1), 0.0)

    def cos(self, x):
        """Cosine, by the sine of the half: older runtimes have no other in float64."""
        half = self("Sin", self("Mul", x, 0.5))
        return self("Sub", 1.0, self("Mul", self("Mul", half, half), 2.0))

    def where(self, condition, yes, no):
        """Elementwise choice."""
        return self("Where", condition, yes, no)


def _transforms(graph, arm, angles):
    """Name of (n, 4, 4) poses of every frame but the base, from angles (n, n_joints) in rad."""
    turn = np.zeros((3, 4, 4))  # what a rotation about z is made of: cosine, sine and the rest
    turn[0, 0, 0] = turn[0, 1, 1] = turn[1, 1, 0] = turn[2, 2, 2] = turn[2, 3, 3] = 1.0
    turn[1, 0, 1] = -1.0
    parts = np.empty((3, arm.n_joints, 4, 4))
    for i in range(arm.n_joints):
        c, s = np.cos(arm.alpha[i]), np.sin(arm.alpha[i])
        rx = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]], dtype=float)
        tx, tz = np.eye(4), np.eye(4)
        tx[0, 3], tz[2, 3] = arm.a[i], arm.d[i]
        left, right = (np.eye(4), tz @ tx @ rx)
        if arm.convention == "modified":
            left, right = rx @ tx, tz
        parts[:, i] = left @ turn @ right
    theta = graph("Add", graph("Mul", angles, arm.joint_signs), arm.theta_offset)
    theta = graph("Reshape", theta, graph.integers(-1, arm.n_joints, 1, 1))
    cos, sin = graph.cos(theta), graph("Sin", theta)
    steps = graph("Add", graph("Mul", cos, parts[0]), graph("Mul", sin, parts[1]))
    steps = graph("Add", steps, parts[2])
    sizes = graph.integers(*[1] * arm.n_joints)
    steps = graph("Split", steps, sizes, outputs=arm.n_joints, axis=1)
    steps = [steps] if isinstance(steps, str) else steps
    poses = []
    for step in steps:
        step = graph("Squeeze", step, graph.integers(1))
        poses.append(graph("MatMul", poses[-1], step) if poses else step)
    return poses


def _point(graph, pose, place):
    """Columns (n, 3): a place in a frame, in the base frame."""
    homogeneous = np.append(place, 1.0)[:, None]
    point = graph("MatMul", pose, homogeneous)
    return graph.columns(graph("Squeeze", point, graph.integers(2)), 0, 3)


def _norm(graph, x):
    squares = graph("ReduceSum", graph("Mul", x, x), graph.integers(1), keepdims=1)
    return graph("Sqrt", squares)


def _direction(graph, arm, poses):
    """Columns (n, 2): x and y of the probe by their norm; and the norm."""
    xy = graph.columns(_point(graph, poses[-1], arm.probe), 0, 2)
    radius = _norm(graph, xy)
    return graph("Div", xy, radius), radius


def _elevation(graph, line):
    """Cosine and sine (n, 1) of the elevation of vectors (n, 3)."""
    reach = _norm(graph, graph.columns(line, 0, 2))
    length = _norm(graph, line)
    undefined = graph("Less", length, MIN_LENGTH_MM)
    length = graph.where(undefined, np.nan, length)
    return graph("Div", reach, length), graph("Div", graph.columns(line, 2, 3), length)


def _angle(graph, cos, sin):
    """Angle of the right half plane, in float64 though runtimes know float32's arc tangent only."""
    half = graph("Div", sin, graph("Add", cos, 1.0))
    rough = graph("Atan", graph("Cast", half, to=TensorProto.FLOAT))
    rough = graph("Mul", graph("Cast", rough, to=TensorProto.DOUBLE), 2.0)
    # The angle that is left is about 1e-7: its sine, and the cube's sixth below rounding.
    left = graph("Sub", graph("Mul", sin, graph.cos(rough)), graph("Mul", cos, graph("Sin", rough)))
    return graph("Add", rough, left)


def _pose_shape(operator):
    kind = type(operator.inputs[0].type)
    rows = operator.inputs[0].get_first_dimension()
    operator.outputs[0].type = kind([rows, len(operator.raw_operator._names())])


def _convert_pose(scope, operator, container):
    step, graph = operator.raw_operator, _Graph(scope, container)
    arm, given = step.arm_, graph.as_double(operator.inputs[0])
    angles = graph("Mul", given, np.pi / 180) if step.angle_unit == "deg" else given
    poses = None
    if step.joints == "pose" or step.append_azimuth:
        poses = _transforms(graph, arm, angles)
    used, cos, sin = angles, [], []
    extra = []
    if step.joints == "pose":
        joints = [joint - 1 for joint in arm.pose_joints]
        used = graph("Gather", angles, graph.integers(*joints), axis=1)
        shoulder, wrist = (
            _point(graph, poses[i - 1], np.zeros(3)) if i else np.zeros((1, 3))
            for i in arm.pose_frames
        )
        extra = _elevation(graph, graph("Sub", wrist, shoulder))
    if step.encoding == "angle":
        features = [used] + ([_angle(graph, *extra)] if extra else [])
    else:
        cos, sin = [graph.cos(used)], [graph("Sin", used)]
        if extra:
            cos, sin = [*cos, extra[0]], [*sin, extra[1]]
        m = len(step._names()) // 2 - int(step.append_azimuth)
        order = np.arange(2 * m).reshape(2, m).T.ravel()  # cosine and sine by turns
        both = graph("Concat", *cos, *sin, axis=1)
        features = [graph("Gather", both, graph.integers(*order), axis=1)]
    if step.append_azimuth:
        direction, radius = _direction(graph, arm, poses)
        on_axis = graph("Less", radius, MIN_LENGTH_MM)
        features.append(graph.where(on_axis, np.nan, direction))
    features = graph("Concat", *features, axis=1)
    graph.put(graph("Add", features, graph.refusal(given)), operator.outputs[0])


def _network_shape(operator):
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


def _convert_network(scope, operator, container):
    step, graph = operator.raw_operator, _Graph(scope, container)
    x = graph.as_double(operator.inputs[0])
    y = graph("Add", graph.refusal(x), np.atleast_1d(step.intercept_)[None, :])
    linear = np.atleast_2d(step.linear_coef_)
    if np.any(linear):
        y = graph("Add", y, graph("MatMul", x, linear.T))
    if len(step.centers_):
        shift = step.centers_.mean(axis=0)
        centers = (step.centers_ - shift) / step.length_scale_
        z = graph("Mul", graph("Sub", x, shift), 1 / step.length_scale_)
        # |z|^2 + |c|^2 - 2 z.c, as predict has it.
        squares = graph("ReduceSum", graph("Mul", z, z), graph.integers(1), keepdims=1)
        s = graph("MatMul", z, -2.0 * centers.T)
        s = graph("Add", graph("Add", s, np.square(centers).sum(axis=1)[None, :]), squares)
        phi = _radial(graph, step.kernel_, graph("Max", s, 0.0))
        y = graph("Add", y, graph("MatMul", phi, np.atleast_2d(step.coef_).T))
    graph.put(y, operator.outputs[0])


def _target_shape(operator):
    kind = type(operator.inputs[0].type)
    rows = operator.inputs[0].get_first_dimension()
    size = 3 if operator.raw_operator._rotates else None
    operator.outputs[0].type = kind([rows, size])


def _convert_target(scope, operator, container):
    step, graph = operator.raw_operator, _Graph(scope, container)
    given, kind = operator.inputs[0], type(operator.inputs[0].type)
    direction = None
    inside = scope.declare_local_variable("raacmm_features", kind())
    if step._drops_direction:
        n = step.n_features_in_
        limits = [graph.integers(v) for v in (0, n - 2, 1)]
        graph("Slice", given.full_name, *limits, into=[inside.full_name])
        direction = graph.columns(graph.as_double(given), n - 2, n)
        off = graph("Abs", graph("Sub", _norm(graph, direction), 1.0))
        wrong = graph("Greater", off, NORM_TOLERANCE)
        direction = graph.where(wrong, np.nan, direction)
    else:
        graph("Identity", given.full_name, into=[inside.full_name])
        if step._rotates:
            arm, unit = azimuth_arm("CylindricalResidualTarget", step.azimuth)
            angles = graph.as_double(given)
            angles = graph("Mul", angles, np.pi / 180) if unit == "deg" else angles
            direction, radius = _direction(graph, arm, _transforms(graph, arm, angles))
            off_axis = graph("Greater", radius, 0.0)
            direction = graph.where(off_axis, direction, np.array([[1.0, 0.0]]))
    rows = given.get_first_dimension()
    inside.type = kind([rows, step.n_features_in_ - 2 * int(step._drops_direction)])
    inner = scope.declare_local_operator(get_model_alias(type(step.regressor_)), step.regressor_)
    inner.inputs.append(inside)
    predicted = scope.declare_local_variable("raacmm_predicted", kind())
    inner.outputs.append(predicted)
    y = graph.as_double(predicted)
    if step._rotates:
        cos, sin = (graph.columns(direction, i, i + 1) for i in (0, 1))
        radial, tangential, axial = (graph.columns(y, i, i + 1) for i in (0, 1, 2))
        dx = graph("Sub", graph("Mul", radial, cos), graph("Mul", tangential, sin))
        dy = graph("Add", graph("Mul", radial, sin), graph("Mul", tangential, cos))
        y = graph("Concat", dx, dy, axial, axis=1)
        y = graph("Add", y, graph.refusal(direction))
    graph.put(y, operator.outputs[0])


def register():
    """Make the converters known to skl2onnx; more than once does no harm."""
    if MISSING:
        raise ImportError(
            "ONNX needs skl2onnx, which is not installed: pip install skl2onnx onnxruntime, or "
            'pip install -e ".[onnx]" in the folder of sklearn_raacmm.'
        ) from MISSING
    for model, shape, convert in (
        (PoseFeatures, _pose_shape, _convert_pose),
        (RBFNetRegressor, _network_shape, _convert_network),
        (CylindricalResidualTarget, _target_shape, _convert_target),
    ):
        update_registered_converter(model, f"SklearnRaacmm{model.__name__}", shape, convert)


def convert(model, dtype, target_opset):
    """Converted model; ValueError with one sentence where skl2onnx has none."""
    register()
    from skl2onnx import to_onnx
    from skl2onnx.common.data_types import DoubleTensorType
    from skl2onnx.common.exceptions import MissingConverter, MissingShapeCalculator

    kind = DoubleTensorType if dtype == "double" else FloatTensorType
    first = next(leaves(model)).estimator
    types = [("X", kind([None, first.n_features_in_]))]
    names = sorted({type(step).__name__ for _, step in leaves(model)})
    try:
        converted = to_onnx(model, initial_types=types, target_opset=target_opset)
    except (MissingConverter, MissingShapeCalculator) as error:
        missing = [name for name in names if f"{name}'" in str(error)]
        raise ValueError(
            f"{' and '.join(missing) or type(model).__name__} cannot be converted to ONNX: "
            "skl2onnx knows no converter."
        ) from error
    except Exception as error:
        if _raised_here(error):
            raise
        said = " ".join(str(error).split())[:300]
        raise ValueError(
            f"skl2onnx fails to convert a chain of {', '.join(names)}: {type(error).__name__}, "
            f"{said}"
        ) from error
    # Our own steps refuse by themselves. A scaler before them may clip, and hide it.
    own = (PoseFeatures, RBFNetRegressor, CylindricalResidualTarget)
    hidden = not isinstance(first, own) and any(isinstance(step, own) for _, step in leaves(model))
    if hidden:
        _refuse_infinity(converted.graph)
    return converted


def _raised_here(error):
    """Whether a function of this package raised it: its sentence is for the caller."""
    trace = error.__traceback__
    while trace.tb_next is not None:
        trace = trace.tb_next
    return trace.tb_frame.f_globals.get("__name__", "").startswith("sklearn_raacmm.")


def _refuse_infinity(graph):
    """Make rows NaN where an input is infinite; NaN itself an imputer may have use for."""
    from onnx import helper, numpy_helper

    (given,), (out,) = graph.input, graph.output
    name, kind = out.name, out.type.tensor_type.elem_type
    for node in graph.node:
        for names in (node.input, node.output):
            for i, text in enumerate(names):
                if text == name:
                    names[i] = f"{name}_raacmm"
    real = np.float64 if kind == TensorProto.DOUBLE else np.float32
    for constant, value in (
        ("raacmm_columns", np.array([1])),
        ("raacmm_zero", np.zeros(1, dtype=real)),
        ("raacmm_nan", np.full(1, np.nan, dtype=real)),
    ):
        graph.initializer.append(numpy_helper.from_array(value, constant))
    steps = (
        ("IsInf", [given.name], "raacmm_infinite", {}),
        ("Where", ["raacmm_infinite", "raacmm_nan", "raacmm_zero"], "raacmm_marks", {}),
        ("ReduceSum", ["raacmm_marks", "raacmm_columns"], "raacmm_refusal", {"keepdims": 1}),
        ("Add", [f"{name}_raacmm", "raacmm_refusal"], name, {}),
    )
    for op, inputs, output, attributes in steps:
        graph.node.append(helper.make_node(op, inputs, [output], output, **attributes))
