"""A program as ONNX: every operation as a few nodes of the domain that all runtimes have.

Everything is computed in float64 and cast where the input is float32: joint angles in float32 are
good to a nanometre of correction, kinematics in float32 is not. Chains with steps that no program
has are converted by skl2onnx, to which this package's estimators are made known.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from typing import Any

import numpy as np

from sklearn_raacmm.export import _models, _steps
from sklearn_raacmm.residuals import CylindricalResidualTarget

# Operators as of this version, and of every later one; the version that is written by default, and
# the least version of the file's own format that has it.
_OPSET, _DEFAULT_OPSET, _LATEST_OPSET = 13, 17, 22
_NEEDS = (
    '{} is not installed: pip install skl2onnx onnxruntime, or pip install -e ".[onnx]" in the '
    "folder of sklearn_raacmm."
)
_SIMPLE = {
    "add": "Add", "sub": "Sub", "mul": "Mul", "div": "Div", "max": "Max", "min": "Min",
    "sqrt": "Sqrt", "sin": "Sin",
}  # fmt: skip


def _onnx():
    try:
        import onnx
    except ImportError as error:
        raise ImportError("ONNX needs onnx, which " + _NEEDS.format("it")[3:]) from error
    return onnx


class Graph:
    """Nodes: ``graph("Mul", a, b)`` is the name of the product. Arrays become constants.

    Parameters
    ----------
    node, tensor : callable
        ``node(op, inputs, output, attributes)`` and ``tensor(name, array)`` put one into a model.
    unique : callable
        Makes a name that nothing has.
    """

    def __init__(self, node, tensor, unique):
        self._node, self._tensor, self._unique = node, tensor, unique
        self.proto = _onnx().TensorProto
        self._x, self._rows = None, set()  # the input, and constants that are a single row

    def __call__(self, op, *inputs, into=None, **attributes):
        names = [v if isinstance(v, str) else self.constant(v) for v in inputs]
        into = into or self._unique(f"raacmm_{op.lower()}")
        self._node(op, names, into, attributes)
        return into

    def constant(self, value, dtype: Any = np.float64):
        name = self._unique("raacmm_constant")
        self._tensor(name, np.asarray(value, dtype=dtype))
        return name

    def whole(self, *values):
        """Name of a list of whole numbers."""
        return self.constant(values, np.int64)

    def double(self, name):
        return self("Cast", name, to=self.proto.DOUBLE)

    def row_sum(self, x, axis=1):
        return self("ReduceSum", x, self.whole(axis), keepdims=1)

    def cos(self, x):
        """Cosine, by the sine of the half: older runtimes have no other in float64."""
        half = self("Sin", self("Mul", x, 0.5))
        return self("Sub", 1.0, self("Mul", self("Mul", half, half), 2.0))

    def columns(self, x, index):
        if np.all(np.diff(index) == 1):
            return self("Slice", x, *(self.whole(v) for v in (index[0], index[-1] + 1, 1)))
        return self("Gather", x, self.whole(*index), axis=1)

    # -- a program

    def program(self, program, given):
        """Names of a program's outputs; `given` is that of its input, in float64."""
        values, self._x = [given], given
        for op in program.ops[1:]:
            inputs = [values[i] for i in op.inputs]
            if op.name == "constant":
                values.append(self.constant(op.given["value"][None, :]))
                self._rows.add(values[-1])
            elif op.name in _SIMPLE:
                values.append(self(_SIMPLE[op.name], *inputs))
            else:
                sizes = [program.ops[i].size for i in op.inputs]
                values.append(getattr(self, f"_{op.name}")(op.given, sizes, *inputs))
        return {name: values[i] for name, i in program.outputs.items()}

    def _cos(self, given, sizes, x):
        return self.cos(x)

    def _less(self, given, sizes, a, b):
        return self.double(self("Less", a, b))

    def _elevation(self, given, sizes, height, reach):
        """In float64 though runtimes know float32's arc tangent only."""
        squares = self("Add", self("Mul", height, height), self("Mul", reach, reach))
        length = self("Sqrt", squares)
        sin, cos = self("Div", height, length), self("Div", reach, length)
        half = self("Div", sin, self("Add", cos, 1.0))
        rough = self("Atan", self("Cast", half, to=self.proto.FLOAT))
        rough = self("Mul", self.double(rough), 2.0)
        # The angle that is left is about 1e-7: its sine, and the cube's sixth below rounding.
        left = self("Sub", self("Mul", sin, self.cos(rough)), self("Mul", cos, self("Sin", rough)))
        return self("Add", rough, left)

    def _take(self, given, sizes, x):
        return self.columns(x, given["index"])

    def _join(self, given, sizes, *parts):
        if any(part in self._rows for part in parts):
            nothing = self("Mul", self.columns(self._x, [0]), 0.0)
            parts = [self("Add", p, nothing) if p in self._rows else p for p in parts]
        return self("Concat", *parts, axis=1)

    def _dots(self, given, sizes, rows, x):
        if sizes[0] == sizes[1]:
            return self.row_sum(self("Mul", rows, x))
        rows = self("Reshape", rows, self.whole(-1, sizes[0] // sizes[1], sizes[1]))
        product = self("MatMul", rows, self("Unsqueeze", x, self.whole(2)))
        return self("Squeeze", product, self.whole(2))

    def _affine(self, given, sizes, x):
        y = self("MatMul", x, given["matrix"].T)
        return self("Add", y, given["shift"][None, :])

    def _finite(self, given, sizes, y, x):
        return self("Add", y, self.row_sum(self("Mul", x, 0.0)))

    def _within(self, given, sizes, y, x):
        outside = self("Or", self("Less", x, given["low"]), self("Greater", x, given["high"]))
        wrong = self("Greater", self.row_sum(self.double(outside)), 0.0)
        return self("Where", wrong, np.nan, y)

    def _frames(self, given, sizes, theta):
        """Each frame's pose, (n, 4, 4), is the one before times a constant turn of its angle."""
        parts = _pose_parts(**given)
        n = len(parts[0])
        theta = self("Reshape", theta, self.whole(-1, n, 1, 1))
        cos, sin = self.cos(theta), self("Sin", theta)
        steps = self("Add", self("Mul", cos, parts[0]), self("Mul", sin, parts[1]))
        steps = self("Add", steps, parts[2])
        pose, first = None, self.whole(1)
        rows = [self("Add", self("Mul", self._one(steps, 0, first), 0.0), np.eye(4))]
        rows = [self("Unsqueeze", rows[0], first)]
        for i in range(n):
            step = self._one(steps, i, first)
            pose = step if pose is None else self("MatMul", pose, step)
            rows.append(self("Unsqueeze", pose, first))
        poses = self("Concat", *rows, axis=1)
        poses = self("Slice", poses, self.whole(0), self.whole(3), self.whole(2))
        poses = self("Transpose", poses, perm=[0, 1, 3, 2])
        return self("Reshape", poses, self.whole(-1, 12 * (n + 1)))

    def _one(self, steps, i, axis):
        return self("Gather", steps, self.constant(i, np.int64), axis=1)

    def _waves(self, given, sizes, angles):
        joint, order = given["joint"], given["order"]
        of_wave = np.flatnonzero(order)
        pairs = np.stack([joint, np.abs(order)])[:, of_wave]
        pairs, place = np.unique(pairs, axis=1, return_inverse=True)
        which = np.zeros(len(order), dtype=int)
        which[of_wave] = 1 + place.ravel() + (order[of_wave] < 0) * pairs.shape[1]
        phase = self("Gather", angles, self.whole(*pairs[0]), axis=1)
        phase = self("Mul", phase, pairs[1][None, :].astype(float))
        ones = self("Add", self("Mul", self.columns(angles, [0]), 0.0), 1.0)
        waves = self("Concat", ones, self.cos(phase), self("Sin", phase), axis=1)
        return self("Gather", waves, self.whole(*which), axis=1)

    def _radial(self, given, sizes, x):
        centers = given["centers"]
        z = self("Mul", self("Sub", x, given["shift"][None]), given["inverse_width"][None])
        # |z|^2 + |c|^2 - 2 z.c, as predict has it.
        s = self("MatMul", z, -2.0 * centers.T)
        s = self("Add", s, np.square(centers).sum(axis=1)[None, :])
        s = self("Max", self("Add", s, self.row_sum(self("Mul", z, z))), 0.0)
        kernel = given["kernel"]
        if kernel == "gaussian":
            return self("Exp", self("Mul", s, -0.5))
        if kernel in ("matern32", "matern52"):
            d = self("Sqrt", self("Mul", s, 3.0 if kernel == "matern32" else 5.0))
            factor = self("Add", d, 1.0)
            if kernel == "matern52":
                factor = self("Add", factor, self("Mul", s, 5 / 3))
            return self("Mul", factor, self("Exp", self("Neg", d)))
        if kernel == "rational_quadratic":
            return self("Div", 1.0, self("Add", self("Mul", s, 0.5), 1.0))
        return self("Div", 1.0, self("Sqrt", self("Add", s, 1.0)))

    def _variances(self, given, shapes, vectors, sizes):
        vectors = self("Reshape", vectors, self.whole(-1, 3, shapes[0] // 3))
        columns = self("Gather", vectors, self.whole(*given["vector"]), axis=2)
        columns = self("Mul", columns, self("Unsqueeze", sizes, self.whole(1)))
        dots = self("MatMul", columns, given["root"])
        squares = self.row_sum(self("Mul", dots, dots), 2)
        return self("Squeeze", squares, self.whole(2))


def _pose_parts(table, convention):
    """What the turns of all joints are made of: cosine, sine and the rest, (3, n, 4, 4)."""
    turn = np.zeros((3, 4, 4))
    turn[0, 0, 0] = turn[0, 1, 1] = turn[1, 1, 0] = turn[2, 2, 2] = turn[2, 3, 3] = 1.0
    turn[1, 0, 1] = -1.0
    parts = np.empty((3, len(table), 4, 4))
    for i, (c, s, a, d) in enumerate(table):
        rx = np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]], dtype=float)
        tx, tz = np.eye(4), np.eye(4)
        tx[0, 3], tz[2, 3] = a, d
        left, right = (np.eye(4), tz @ tx @ rx)
        if convention == "modified":
            left, right = rx @ tx, tz
        parts[:, i] = left @ turn @ right
    return parts


# -- files ----------------------------------------------------------------------------------------


def converted(program, dtype, target_opset):
    """A program as an ONNX model: input X; outputs y, and std if the program has it."""
    onnx = _onnx()
    helper, proto = onnx.helper, onnx.TensorProto
    opset = _version(target_opset)
    real = proto.DOUBLE if dtype == "double" else proto.FLOAT
    nodes, tensors, names = [], [], {}

    def unique(name):
        names[name] = names.get(name, 0) + 1
        return f"{name}_{names[name]}"

    def node(op, inputs, output, attributes):
        nodes.append(helper.make_node(op, inputs, [output], **attributes))

    def tensor(name, array):
        tensors.append(onnx.numpy_helper.from_array(np.array(array, order="C"), name))

    graph = Graph(node, tensor, unique)
    found = graph.program(program, graph.double("X"))
    outputs = []
    for name in ("y", "std"):
        if name in found:
            graph("Cast", found[name], into=name, to=real)
            size = program.ops[program.outputs[name]].size
            outputs.append(helper.make_tensor_value_info(name, real, [None, size]))
    inputs = [helper.make_tensor_value_info("X", real, [None, program.n_inputs])]
    made = helper.make_graph(nodes, "sklearn_raacmm", inputs, outputs, tensors)
    versions = [helper.make_opsetid("", opset)]
    return helper.make_model(
        made, opset_imports=versions, producer_name="sklearn_raacmm",
        ir_version=helper.find_min_ir_version_for(versions),
    )  # fmt: skip


def _version(target_opset):
    opset = target_opset.get("", None) if isinstance(target_opset, dict) else target_opset
    opset = _DEFAULT_OPSET if opset is None else opset
    if not opset >= _OPSET:
        raise ValueError(f"ONNX needs target_opset {_OPSET} or newer, got {opset}.")
    return min(opset, _LATEST_OPSET)


def run_onnx(model, X):
    """Outputs of a model by ONNX Runtime as a list of arrays; None where that is not installed."""
    try:
        import onnxruntime
    except ImportError:
        return None
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    (given,) = session.get_inputs()
    real = np.float32 if given.type == "tensor(float)" else np.float64
    return session.run(None, {given.name: X.astype(real)})


# -- skl2onnx -------------------------------------------------------------------------------------


def register():
    """Make this package's estimators known to skl2onnx; more than once does no harm."""
    try:
        from skl2onnx import update_registered_converter
    except ImportError as error:
        raise ImportError("ONNX of such a chain needs skl2onnx, which " + _NEEDS[3:]) from error
    for kind in _steps.OWN:
        target = kind is CylindricalResidualTarget
        convert = _convert_target if target else _convert_step
        update_registered_converter(kind, f"SklearnRaacmm{kind.__name__}", _shape, convert)


def by_skl2onnx(model, dtype, target_opset):
    """A chain that is no program, converted by skl2onnx; ValueError with one sentence."""
    register()
    _version(target_opset)
    from skl2onnx import to_onnx
    from skl2onnx.common.data_types import DoubleTensorType, FloatTensorType
    from skl2onnx.common.exceptions import MissingConverter, MissingShapeCalculator

    kind = DoubleTensorType if dtype == "double" else FloatTensorType
    steps = [step for _, step in _steps.leaves(model)]
    types = [("X", kind([None, steps[0].n_features_in_]))]
    names = sorted({type(step).__name__ for step in steps})
    try:
        found = to_onnx(model, initial_types=types, target_opset=target_opset)
    except (MissingConverter, MissingShapeCalculator) as error:
        missing = [name for name in names if f"{name}'" in str(error)]
        raise ValueError(
            f"{' and '.join(missing) or type(model).__name__} cannot be converted to ONNX: "
            "skl2onnx knows no converter."
        ) from error
    except Exception as error:
        if _raised_here(error):
            raise
        raise ValueError(
            f"skl2onnx fails to convert a chain of {', '.join(names)}: {type(error).__name__}, "
            f"{' '.join(str(error).split())[:300]}"
        ) from error
    # Our own steps refuse by themselves. A step before them may clip, and hide it.
    if not isinstance(steps[0], _steps.OWN) and any(isinstance(s, _steps.OWN) for s in steps):
        _refuse_infinity(found.graph)
    return found


def _raised_here(error):
    """Whether a function of this package raised it: its sentence is for the caller."""
    trace = error.__traceback__
    while trace.tb_next is not None:
        trace = trace.tb_next
    return trace.tb_frame.f_globals.get("__name__", "").startswith("sklearn_raacmm.")


def _refuse_infinity(made):
    """Make rows NaN where an input is infinite; NaN itself an imputer may have use for."""
    from onnx import TensorProto, helper, numpy_helper

    (given,), (out,) = made.input, made.output
    name = out.name
    for node in made.node:
        for names in (node.input, node.output):
            for i, text in enumerate(names):
                if text == name:
                    names[i] = f"{name}_raacmm"
    real = np.float64 if out.type.tensor_type.elem_type == TensorProto.DOUBLE else np.float32
    for constant, value in (
        ("raacmm_columns", np.array([1])),
        ("raacmm_zero", np.zeros(1, dtype=real)),
        ("raacmm_nan", np.full(1, np.nan, dtype=real)),
    ):
        made.initializer.append(numpy_helper.from_array(value, constant))
    nodes: Any = (
        ("IsInf", [given.name], "raacmm_infinite", {}),
        ("Where", ["raacmm_infinite", "raacmm_nan", "raacmm_zero"], "raacmm_marks", {}),
        ("ReduceSum", ["raacmm_marks", "raacmm_columns"], "raacmm_refusal", {"keepdims": 1}),
        ("Add", [f"{name}_raacmm", "raacmm_refusal"], name, {}),
    )
    for op, inputs, output, attributes in nodes:
        made.node.append(helper.make_node(op, inputs, [output], output, **attributes))


def _graph_of(scope, container):
    if container.target_opset < _OPSET:
        raise ValueError(
            f"sklearn_raacmm's converters need target_opset {_OPSET} or newer, got "
            f"{container.target_opset}."
        )

    def node(op, inputs, output, attributes):
        name = scope.get_unique_operator_name(f"raacmm_{op}")
        container.add_node(op, inputs, [output], op_version=_OPSET, name=name, **attributes)

    def tensor(name, array):
        proto = _onnx().TensorProto
        kind = proto.DOUBLE if array.dtype == np.float64 else proto.INT64
        container.add_initializer(name, kind, list(array.shape), array.ravel().tolist())

    return Graph(node, tensor, scope.get_unique_variable_name)


def _put(graph, name, variable):
    """Write a result in the type of a step's output."""
    from skl2onnx.common.data_types import guess_proto_type

    graph("Cast", name, into=variable.full_name, to=guess_proto_type(variable.type))


def _shape(operator):
    """Rows of the input, and as many columns as the step gives."""
    from skl2onnx.common.data_types import DoubleTensorType, FloatTensorType

    step, given = operator.raw_operator, operator.inputs[0]
    kind = type(given.type)
    kind = kind if kind in (DoubleTensorType, FloatTensorType) else FloatTensorType
    if isinstance(step, CylindricalResidualTarget):
        size = 3 if step._rotates else None
    else:
        size = _models.step_program(step).n_outputs
    operator.outputs[0].type = kind([given.get_first_dimension(), size])


def _convert_step(scope, operator, container):
    graph = _graph_of(scope, container)
    given = graph.double(operator.inputs[0].full_name)
    found = graph.program(_models.step_program(operator.raw_operator), given)
    _put(graph, found["y"], operator.outputs[0])


def _convert_target(scope, operator, container):
    """The regressor inside may be anything that skl2onnx knows."""
    from skl2onnx import get_model_alias

    step, graph = operator.raw_operator, _graph_of(scope, container)
    given, kind = operator.inputs[0], type(operator.inputs[0].type)
    inside = scope.declare_local_variable("raacmm_features", kind())
    n = step.n_features_in_ - 2 * int(step._drops_direction)
    graph("Slice", given.full_name, *(graph.whole(v) for v in (0, n, 1)), into=inside.full_name)
    inside.type = kind([given.get_first_dimension(), n])
    inner = scope.declare_local_operator(get_model_alias(type(step.regressor_)), step.regressor_)
    inner.inputs.append(inside)
    predicted = scope.declare_local_variable("raacmm_predicted", kind())
    inner.outputs.append(predicted)
    y = graph.double(predicted.full_name)
    if step._rotates:
        x = graph.double(given.full_name)
        direction = graph.program(_models.direction_program(step), x)["y"]
        both = graph("Concat", direction, y, axis=1)
        y = graph.program(_models.turning_program(), both)["y"]
    _put(graph, y, operator.outputs[0])
