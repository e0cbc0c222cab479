"""A program as ONNX: every operation as a few nodes of the domain that all runtimes have.

Everything is computed in float64 and cast where the input is float32: joint angles in float32 are
good to a nanometre of correction, kinematics in float32 is not. Chains with steps that no program
has are converted by skl2onnx, to which this package's estimators are made known.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections import Counter
from typing import Any

import numpy as np

from sklearn_raacmm.export import _models, _steps
from sklearn_raacmm.export._program import OPERATIONS
from sklearn_raacmm.residuals import CylindricalResidualTarget

# Operators as of this version, and of every later one; the version that is written by default, and
# the least version of the file's own format that has it.
_OPSET, _DEFAULT_OPSET, _LATEST_OPSET = 13, 17, 22
_NEEDS = (
    '{} is not installed: pip install skl2onnx onnxruntime, or pip install -e ".[onnx]" in the '
    "folder of sklearn_raacmm."
)
_OPERATORS = {
    "add": "Add", "subtract": "Sub", "multiply": "Mul", "divide": "Div", "maximum": "Max",
    "minimum": "Min", "matmul": "MatMul", "sqrt": "Sqrt", "sin": "Sin", "exp": "Exp",
    "negative": "Neg", "less": "Less", "less_equal": "LessOrEqual",
    "greater_equal": "GreaterOrEqual", "bitwise_and": "And",
}  # fmt: skip


def _onnx():
    try:
        import onnx
    except ImportError as error:
        raise ImportError("ONNX needs onnx, which " + _NEEDS.format("it")[3:]) from error
    return onnx


class Graph:
    """Nodes: ``graph("Mul", a, b)`` is the name of the product. Arrays become constants.

    ``node(op, inputs, output, attributes)`` and ``tensor(name, array)`` put one into a model,
    ``unique(name)`` makes a name that nothing has.
    """

    def __init__(self, node, tensor, unique):
        self._node, self._tensor, self._unique = node, tensor, unique
        self.proto = _onnx().TensorProto

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

    def program(self, program, given):
        """Names of a program's outputs; `given` is that of its input, in float64."""
        values: Any = [_Traced(self, given, np.zeros((1, program.n_inputs)))]
        for op in program.ops[1:]:
            inputs = [values[i] for i in op.inputs]
            values.append(OPERATIONS[op.name].compute(op.given, *inputs))
        return {name: values[i].name for name, i in program.outputs.items()}


class _Traced(np.lib.mixins.NDArrayOperatorsMixin):
    """Stands for an array while NumPy's functions of it are written as nodes.

    `like` is an array of its shape, for one row. Constants stay arrays until they meet one.
    """

    def __init__(self, graph, name, like):
        self.graph, self.name, self.like, self.shape = graph, name, like, like.shape

    def _node(self, like, op, *inputs, **attributes):
        names = [v.name if isinstance(v, _Traced) else v for v in inputs]
        return _Traced(self.graph, self.graph(op, *names, **attributes), like)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **_: Any) -> Any:
        name = ufunc.__name__
        if name == "cos":
            return _cosine(*inputs)
        if name == "arctan2":
            return _elevation(*inputs)
        return self._node(ufunc(*map(_like, inputs)), _OPERATORS[name], *inputs)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        if function is np.where:
            return self._node(np.where(*map(_like, args)), "Where", *args)
        (parts,) = args  # of np.concatenate: a constant becomes as many rows as there are
        nothing = next(0.0 * part[:, [0]] for part in parts if isinstance(part, _Traced))
        parts = [part if isinstance(part, _Traced) else nothing + part for part in parts]
        return self._node(np.concatenate([*map(_like, parts)], axis=1), "Concat", *parts, axis=1)

    def __getitem__(self, place: tuple[slice, Any]) -> Any:
        index, whole = np.asarray(place[1]), self.graph.whole
        if np.all(np.diff(index) == 1):
            bounds = (whole(v) for v in (index[0], index[-1] + 1, 1))
            return self._node(self.like[:, index], "Slice", self, *bounds)
        return self._node(self.like[:, index], "Gather", self, whole(*index), axis=1)

    def reshape(self, *shape: int) -> Any:
        return self._node(self.like.reshape(shape), "Reshape", self, self.graph.whole(*shape))

    def sum(self, axis: int, keepdims: bool = False) -> Any:
        like, axes = self.like.sum(axis=axis, keepdims=keepdims), self.graph.whole(axis)
        return self._node(like, "ReduceSum", self, axes, keepdims=int(keepdims))


def _like(value):
    return value.like if isinstance(value, _Traced) else value


def _cosine(x):
    """By the sine of the half: older runtimes have no other in float64."""
    half = np.sin(0.5 * x)
    return 1.0 - half * half * 2.0


def _elevation(height, reach):
    """The arc tangent in float64, though runtimes know float32's only."""
    length = np.sqrt(height * height + reach * reach)
    sin, cos = height / length, reach / length
    graph, half = sin.graph, sin / (cos + 1.0)
    rough = graph("Atan", graph("Cast", half.name, to=graph.proto.FLOAT))
    rough = 2.0 * _Traced(graph, graph.double(rough), half.like)
    # The angle that is left is about 1e-7: its sine, and the cube's sixth below rounding.
    return rough + (sin * np.cos(rough) - cos * np.sin(rough))


# -- files ----------------------------------------------------------------------------------------


def converted(program, dtype, target_opset):
    """A program as an ONNX model: input X; outputs y, and std if the program has it."""
    onnx = _onnx()
    helper, proto = onnx.helper, onnx.TensorProto
    opset = _version(target_opset)
    real = proto.DOUBLE if dtype == "double" else proto.FLOAT
    nodes, tensors = [], []

    def node(op, inputs, output, attributes):
        nodes.append(helper.make_node(op, inputs, [output], **attributes))

    def tensor(name, array):
        tensors.append(onnx.numpy_helper.from_array(np.array(array, order="C"), name))

    graph = Graph(node, tensor, _unique_names())
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


def _unique_names():
    """A function that makes of a name one that it has not given."""
    names = Counter()

    def unique(name):
        names[name] += 1
        return f"{name}_{names[name]}"

    return unique


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


def register_onnx() -> None:
    """Register the package's converters with skl2onnx, as the import of this module does.

    After that ``skl2onnx.to_onnx`` converts this package's estimators wherever they stand: in
    pipelines, searches, column transformers. To call it again does no harm.

    Raises
    ------
    ImportError
        Without skl2onnx: ``pip install -e ".[onnx]"`` in the project's folder installs it.
    """
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
    register_onnx()
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
    for one in made.node:
        for names in (one.input, one.output):
            for i, text in enumerate(names):
                if text == name:
                    names[i] = f"{name}_raacmm"
    real = np.float64 if out.type.tensor_type.elem_type == TensorProto.DOUBLE else np.float32

    def node(op, inputs, output, attributes):
        made.node.append(helper.make_node(op, inputs, [output], output, **attributes))

    def tensor(name, array):
        made.initializer.append(numpy_helper.from_array(array, name))

    graph = Graph(node, tensor, _unique_names())
    nan, zero = (graph.constant([value], real) for value in (np.nan, 0.0))
    marks = graph("Where", graph("IsInf", given.name), nan, zero)
    refusal = graph("ReduceSum", marks, graph.whole(1), keepdims=1)
    graph("Add", f"{name}_raacmm", refusal, into=name)


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
        both = graph("Concat", graph.double(given.full_name), y, axis=1)
        y = graph.program(_models.turning_program(step), both)["y"]
    _put(graph, y, operator.outputs[0])
