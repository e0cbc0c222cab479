"""Graphs of ONNX operators in float64, and the kinematics of an arm made of them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.arm import MIN_LENGTH_MM

try:
    from onnx import TensorProto
    from skl2onnx import get_model_alias, update_registered_converter
    from skl2onnx.common.data_types import FloatTensorType, guess_proto_type
except ImportError as error:  # these modules can be looked at without, but not used
    MISSING = error
    TensorProto = FloatTensorType = guess_proto_type = None
    get_model_alias = update_registered_converter = None
else:
    MISSING = None

# Operators as of this version, and of every later one that skl2onnx knows.
_OPSET = 13


class Graph:
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
        """Name of a constant; ValueError for a table with NaN, which no refusal has."""
        value = np.asarray(value, dtype=dtype)
        if value.size > 1 and not np.isfinite(value).all():
            raise ValueError(
                "The model holds a number that is not finite: it cannot be written as ONNX."
            )
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

    def radians(self, x, unit):
        """Angles in rad."""
        return self("Mul", x, np.pi / 180) if unit == "deg" else x

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


def transforms(graph, arm, angles):
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


def point(graph, pose, place):
    """Columns (n, 3): a place in a frame, in the base frame."""
    homogeneous = np.append(place, 1.0)[:, None]
    point = graph("MatMul", pose, homogeneous)
    return graph.columns(graph("Squeeze", point, graph.integers(2)), 0, 3)


def norm(graph, x):
    squares = graph("ReduceSum", graph("Mul", x, x), graph.integers(1), keepdims=1)
    return graph("Sqrt", squares)


def direction_of_probe(graph, arm, poses):
    """Columns (n, 2): x and y of the probe by their norm; and the norm."""
    xy = graph.columns(point(graph, poses[-1], arm.probe), 0, 2)
    radius = norm(graph, xy)
    return graph("Div", xy, radius), radius


def elevation(graph, line):
    """Cosine and sine (n, 1) of the elevation of vectors (n, 3)."""
    reach = norm(graph, graph.columns(line, 0, 2))
    length = norm(graph, line)
    undefined = graph("Less", length, MIN_LENGTH_MM)
    length = graph.where(undefined, np.nan, length)
    return graph("Div", reach, length), graph("Div", graph.columns(line, 2, 3), length)


def angle(graph, cos, sin):
    """Angle of the right half plane, in float64 though runtimes know float32's arc tangent only."""
    half = graph("Div", sin, graph("Add", cos, 1.0))
    rough = graph("Atan", graph("Cast", half, to=TensorProto.FLOAT))
    rough = graph("Mul", graph("Cast", rough, to=TensorProto.DOUBLE), 2.0)
    # The angle that is left is about 1e-7: its sine, and the cube's sixth below rounding.
    left = graph("Sub", graph("Mul", sin, graph.cos(rough)), graph("Mul", cos, graph("Sin", rough)))
    return graph("Add", rough, left)
