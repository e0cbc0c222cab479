"""A program as ONNX: every operation as a few nodes of the domain that all runtimes have.

Everything is computed in float64.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

from collections import Counter
from typing import Any

import numpy as np

from sklearn_raacmm.export._program import OPERATIONS

# Version of the operators: they stand unchanged since 13, and runtimes of 2022 know 17.
_OPSET = 17
# Types of numbers that are cast when a file is loaded.
_SMALL = (np.float32, np.int16)
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
        raise ImportError(
            "ONNX needs onnx, which is not installed: pip install onnx onnxruntime, or pip install "
            '-e ".[onnx]" in the folder of sklearn_raacmm.'
        ) from error
    return onnx


class _Graph:
    """Nodes and constants: ``graph("Mul", a, b)`` is the name of the product."""

    def __init__(self):
        self.onnx, self.nodes, self.tensors, self.names = _onnx(), [], [], Counter()

    def __call__(self, op, *inputs, into=None, **attributes):
        names = [v if isinstance(v, str) else self.constant(v) for v in inputs]
        into = into or self._unique(f"raacmm_{op.lower()}")
        self.nodes.append(self.onnx.helper.make_node(op, names, [into], **attributes))
        return into

    def _unique(self, name):
        self.names[name] += 1
        return f"{name}_{self.names[name]}"

    def constant(self, value, dtype: Any = np.float64):
        kind = getattr(value, "dtype", None)
        if dtype is np.float64 and kind in _SMALL:  # the file keeps the smaller one
            return self("Cast", self.constant(value, kind), to=self.onnx.TensorProto.DOUBLE)
        name = self._unique("raacmm_constant")
        array = np.array(value, dtype=dtype, order="C")
        self.tensors.append(self.onnx.numpy_helper.from_array(array, name))
        return name

    def whole(self, *values):
        """Name of a list of whole numbers."""
        return self.constant(values, np.int64)


class _Traced(np.lib.mixins.NDArrayOperatorsMixin):
    """Stands for an array while NumPy's functions of it are written as nodes.

    `like` is an array of its shape, for one row. Constants stay arrays until they meet one.
    """

    def __init__(self, graph, name, like):
        self.graph, self.name, self.like, self.shape = graph, name, like, like.shape

    def _node(self, like, op, *inputs, **attributes):
        names = [v.name if isinstance(v, _Traced) else v for v in inputs]
        return _Traced(self.graph, self.graph(op, *names, **attributes), like)

    def __array_ufunc__(self, ufunc, method, *inputs, **_):
        name = ufunc.__name__
        if name == "cos":  # by the sine of the half: older runtimes have no other in float64
            half = np.sin(0.5 * inputs[0])
            return 1.0 - half * half * 2.0
        if name == "arctan2":
            return _elevation(*inputs)
        return self._node(ufunc(*map(_like, inputs)), _OPERATORS[name], *inputs)

    def __array_function__(self, function, types, args, kwargs):
        if function is np.where:
            return self._node(np.where(*map(_like, args)), "Where", *args)
        (parts,) = args  # of np.concatenate: a constant becomes as many rows as there are
        nothing = next(0.0 * part[:, [0]] for part in parts if isinstance(part, _Traced))
        parts = [part if isinstance(part, _Traced) else nothing + part for part in parts]
        return self._node(np.concatenate([*map(_like, parts)], axis=1), "Concat", *parts, axis=1)

    def __getitem__(self, place):
        index, whole = np.asarray(place[1]), self.graph.whole
        if np.all(np.diff(index) == 1):
            bounds = (whole(v) for v in (index[0], index[-1] + 1, 1))
            return self._node(self.like[:, index], "Slice", self, *bounds)
        return self._node(self.like[:, index], "Gather", self, whole(*index), axis=1)

    def reshape(self, *shape):
        return self._node(self.like.reshape(shape), "Reshape", self, self.graph.whole(*shape))

    def sum(self, axis, keepdims=False):
        like, axes = self.like.sum(axis=axis, keepdims=keepdims), self.graph.whole(axis)
        return self._node(like, "ReduceSum", self, axes, keepdims=int(keepdims))


def _like(value):
    return value.like if isinstance(value, _Traced) else value


def _elevation(height, reach):
    """The arc tangent in float64, though runtimes know float32's only."""
    length = np.sqrt(height * height + reach * reach)
    sin, cos = height / length, reach / length
    graph, half = sin.graph, sin / (cos + 1.0)
    proto = graph.onnx.TensorProto
    rough = graph("Atan", graph("Cast", half.name, to=proto.FLOAT))
    rough = 2.0 * _Traced(graph, graph("Cast", rough, to=proto.DOUBLE), half.like)
    # The angle that is left is about 1e-7: its sine, and the cube's sixth below rounding.
    return rough + (sin * np.cos(rough) - cos * np.sin(rough))


def convert(program):
    """A program as an ONNX model: input X; outputs y, and std if the program has it."""
    program, graph = program.pruned("y", "std"), _Graph()
    helper, proto = graph.onnx.helper, graph.onnx.TensorProto
    values = [_Traced(graph, "X", np.zeros((1, program.n_inputs)))]
    for op in program.ops[1:]:
        inputs = [values[i] for i in op.inputs]
        values.append(OPERATIONS[op.name](*inputs, **op.given))
    outputs = []
    for name, number in program.outputs.items():
        graph("Identity", values[number].name, into=name)
        shape = [None, program.ops[number].size]
        outputs.append(helper.make_tensor_value_info(name, proto.DOUBLE, shape))
    inputs = [helper.make_tensor_value_info("X", proto.DOUBLE, [None, program.n_inputs])]
    made = helper.make_graph(graph.nodes, "sklearn_raacmm", inputs, outputs, graph.tensors)
    versions = [helper.make_opsetid("", _OPSET)]
    return helper.make_model(
        made, opset_imports=versions, producer_name="sklearn_raacmm",
        ir_version=helper.find_min_ir_version_for(versions),
    )  # fmt: skip


def run_onnx(model, X):
    """Outputs of a model by ONNX Runtime, by name; None where that is not installed."""
    try:
        import onnxruntime
    except ImportError:
        return None
    session = onnxruntime.InferenceSession(
        model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(None, {"X": X}), strict=True))
