"""Conversion to ONNX by skl2onnx, with converters for this package's estimators.

Everything is computed in float64 and cast where the model's input is float32: joint angles in
float32 are good to a nanometre of correction, kinematics in float32 is not.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import numpy as np

from sklearn_raacmm.correction import ArmResidualRegressor
from sklearn_raacmm.error_model import JointHarmonicRegressor
from sklearn_raacmm.export._onnx_arm import convert_arm_model, residual_shape
from sklearn_raacmm.export._onnx_graph import (
    MISSING,
    FloatTensorType,
    TensorProto,
    update_registered_converter,
)
from sklearn_raacmm.export._onnx_steps import (
    convert_network,
    convert_pose,
    convert_target,
    network_shape,
    pose_shape,
    target_shape,
)
from sklearn_raacmm.export._steps import leaves
from sklearn_raacmm.network import RBFNetRegressor
from sklearn_raacmm.residuals import CylindricalResidualTarget, PoseFeatures


def register():
    """Make the converters known to skl2onnx; more than once does no harm."""
    if MISSING:
        raise ImportError(
            "ONNX needs skl2onnx, which is not installed: pip install skl2onnx onnxruntime, or "
            'pip install -e ".[onnx]" in the folder of sklearn_raacmm.'
        ) from MISSING
    for model, shape, convert in (
        (PoseFeatures, pose_shape, convert_pose),
        (RBFNetRegressor, network_shape, convert_network),
        (CylindricalResidualTarget, target_shape, convert_target),
        (JointHarmonicRegressor, residual_shape, convert_arm_model),
        (ArmResidualRegressor, residual_shape, convert_arm_model),
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
    own += (JointHarmonicRegressor, ArmResidualRegressor)
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
