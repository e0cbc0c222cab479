"""A fitted model as plain JSON: readable in any language, exact, and checked when it is read."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import hashlib
import json
from dataclasses import fields
from functools import partial
from types import MethodType

import numpy as np
import sklearn
from sklearn.base import BaseEstimator, clone
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.pipeline import Pipeline
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, RobustScaler, StandardScaler

from sklearn_raacmm._version import __version__
from sklearn_raacmm.arm import Arm
from sklearn_raacmm.correction import ArmResidualRegressor
from sklearn_raacmm.error_model import Fading, JointHarmonicRegressor, LinearModel, Terms
from sklearn_raacmm.export._c_source import fingerprint_of
from sklearn_raacmm.export._steps import STAGES, check_fitted
from sklearn_raacmm.network import Network, RBFNetRegressor
from sklearn_raacmm.residuals import CylindricalResidualTarget, PoseFeatures
from sklearn_raacmm.utils import check_shapes, show

FORMAT, FORMAT_VERSION = "sklearn_raacmm.Model", 1
# What a file may hold, by name; nothing else is ever built.
_ESTIMATORS = {
    kind.__name__: kind
    for kind in (
        PoseFeatures, RBFNetRegressor, CylindricalResidualTarget, JointHarmonicRegressor,
        ArmResidualRegressor, Pipeline, StandardScaler, MinMaxScaler, MaxAbsScaler, RobustScaler,
        LinearRegression, Ridge,
    )
}  # fmt: skip
# Fitted numbers that are values of their own.
_VALUES = {
    kind.__name__: kind
    for kind in (
        Fading, LinearModel, Network,
    )
}  # fmt: skip
# Arrays of scikit-learn's steps: d is the number of features. Those that are None are left out.
_SHAPES = {
    name: dict.fromkeys(attributes, ("d",))
    for name, attributes in {
        "StandardScaler": ("mean_", "var_", "scale_"),
        "MinMaxScaler": ("min_", "scale_", "data_min_", "data_max_", "data_range_"),
        "MaxAbsScaler": ("max_abs_", "scale_"),
        "RobustScaler": ("center_", "scale_"),
    }.items()
}
# What content that is no model raises.
_UNREADABLE = (TypeError, KeyError, IndexError, AttributeError, ValueError, RecursionError)
_DTYPES = {"float64": float, "int64": int, "bool": bool}
# What is no number in JSON.
_NOT_FINITE = {"NaN": np.nan, "Infinity": np.inf, "-Infinity": -np.inf}


def text_of(model):
    """JSON text of a fitted model; see `sklearn_raacmm.export.to_json`."""
    check_fitted(model)
    while hasattr(model, "best_estimator_"):  # of a search: what it has found
        model = model.best_estimator_
    content = _encoded(model, type(model).__name__)
    try:  # what is damaged, as by a weight that is NaN, is refused now, not in twenty years
        _decoded(content)
    except _UNREADABLE as error:
        raise ValueError(
            f"{type(model).__name__} cannot be written as JSON, which could not be read: {error}"
        ) from None
    try:
        fingerprint = fingerprint_of(model)
    except ValueError:  # a chain without a regressor at its end
        fingerprint = None
    head = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "written_by": f"sklearn_raacmm {__version__}, scikit-learn {sklearn.__version__}",
        "fingerprint": fingerprint,
        "checksum": _checksum(content),
        "model": content,
    }
    return json.dumps(head, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _checksum(content):
    """SHA-256 of the content with sorted keys and without spaces."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _encoded(value, path):
    """A value as what JSON has; `path` says where it is."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else {"number": _name(value)}
    if isinstance(value, np.ndarray):
        return _encoded_array(value, path)
    if isinstance(value, Arm):
        return {"arm": json.loads(value.to_json())}
    if isinstance(value, Terms | tuple):
        entries = [_encoded(entry, f"{path}[{i}]") for i, entry in enumerate(value)]
        return (
            {"value": "Terms", "tuple": entries} if isinstance(value, Terms) else {"tuple": entries}
        )
    if isinstance(value, list):
        return [_encoded(entry, f"{path}[{i}]") for i, entry in enumerate(value)]
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {"dict": _encoded_fields(value, path)}
    if type(value).__name__ in _ESTIMATORS and type(value) is _ESTIMATORS[type(value).__name__]:
        # A parameter is a pattern, of which fits take copies: it is not written as fitted.
        state = {
            key: clone(entry)
            if isinstance(entry, BaseEstimator) and not key.endswith("_")
            else entry
            for key, entry in vars(value).items()
        }
        return {"estimator": type(value).__name__, "state": _encoded_fields(state, path)}
    if type(value) in _VALUES.values():
        state = {field.name: getattr(value, field.name) for field in fields(value)}
        return {"value": type(value).__name__, "state": _encoded_fields(state, path)}
    unit, method = "rad", value
    if isinstance(value, partial) and set(value.keywords) == {"angle_unit"} and not value.args:
        unit, method = value.keywords["angle_unit"], value.func
    if isinstance(method, MethodType) and method.__func__ is Arm.azimuth:
        return {"azimuth": json.loads(method.__self__.to_json()), "angle_unit": unit}
    raise ValueError(
        f"{path} is a {type(value).__name__}, which cannot be written as JSON: only numbers, text, "
        f"arrays, arms and {', '.join(_ESTIMATORS)} can."
    )


def _encoded_fields(fields, path):
    return {key: _encoded(entry, f"{path}.{key}") for key, entry in fields.items()}


def _encoded_array(array, path):
    if array.dtype.names:
        columns = {name: _encoded_array(array[name], path) for name in array.dtype.names}
        return {"table": columns, "dtype": [list(entry) for entry in array.dtype.descr]}
    if array.dtype.kind in "UO":
        data = [str(entry) for entry in array.ravel()]
        return {"array": data, "dtype": "text", "shape": list(array.shape)}
    kind = {"f": "float64", "i": "int64", "u": "int64", "b": "bool"}.get(array.dtype.kind)
    if kind is None:
        raise ValueError(f"{path} is an array of {array.dtype}, which cannot be written as JSON.")
    data = array.astype(kind).ravel().tolist()
    if kind == "float64":
        data = [x if np.isfinite(x) else _name(x) for x in data]
    return {"array": data, "dtype": kind, "shape": list(array.shape)}


def _name(number):
    return "NaN" if np.isnan(number) else "Infinity" if number > 0 else "-Infinity"


def model_of(text, where="the JSON text"):
    """Fitted model of a JSON text; see `sklearn_raacmm.export.from_json`."""
    try:
        head = json.loads(text, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{where} is not valid JSON: {error}.") from None
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise ValueError(f"{where} is not a model: its format is not {FORMAT!r}.")
    if head.get("format_version") != FORMAT_VERSION:
        raise ValueError(
            f"{where} has format_version {show(head.get('format_version'))}, this version reads "
            f"{FORMAT_VERSION}."
        )
    content = head.get("model")
    if head.get("checksum") != _checksum(content):
        raise ValueError(f"{where} is damaged: its checksum is not that of its model.")
    try:
        model = _decoded(content)
        if not isinstance(model, BaseEstimator):
            raise ValueError(f"it holds {show(model)} in place of an estimator")
        check_fitted(model)
    except _UNREADABLE as error:
        # Text that whoever wrote the checksum has made, too: say what is wrong with it.
        raise ValueError(f"{where} holds no model that can be built: {error}") from None
    return model


def _refuse_constant(name):
    raise ValueError(f"{name} is no number of JSON")


def _decoded(value):
    if not isinstance(value, dict):
        return [_decoded(entry) for entry in value] if isinstance(value, list) else value
    if "array" in value:
        return _decoded_array(value)
    if "table" in value:
        columns = {name: _decoded_array(column) for name, column in value["table"].items()}
        dtype = np.dtype([tuple(entry) for entry in value["dtype"]])
        table = np.empty(len(next(iter(columns.values()))), dtype=dtype)
        for name, column in columns.items():
            table[name] = column
        return table
    if "number" in value:
        return _NOT_FINITE[value["number"]]
    if "arm" in value:
        return Arm.from_json(json.dumps(value["arm"]))
    if "azimuth" in value:
        method = Arm.from_json(json.dumps(value["azimuth"])).azimuth
        unit = value["angle_unit"]
        if unit not in ("rad", "deg"):
            raise ValueError(f"angle_unit must be 'rad' or 'deg', got {show(unit)}")
        return method if unit == "rad" else partial(method, angle_unit=unit)
    if "tuple" in value:
        entries = tuple(_decoded(entry) for entry in value["tuple"])
        return Terms(*entries) if value.get("value") == "Terms" else entries
    if "dict" in value:
        return {key: _decoded(entry) for key, entry in value["dict"].items()}
    return _decoded_object(value)


def _decoded_array(value):
    shape, dtype = value["shape"], value["dtype"]
    data = value["array"]
    if dtype == "text":
        return np.array(data, dtype=str).reshape(shape)
    kind = _DTYPES[dtype]
    numbers = [_NOT_FINITE[x] if isinstance(x, str) else x for x in data]
    if any(not isinstance(x, int | float) for x in numbers):
        raise ValueError("an array holds something that is no number")
    return np.array(numbers, dtype=kind).reshape(shape)


def _decoded_object(value):
    """An estimator or a value, by its name in the lists above."""
    name = value.get("estimator", value.get("value"))
    kind = {**_ESTIMATORS, **_VALUES}.get(name if isinstance(name, str) else "")
    if kind is None:
        raise ValueError(f"{show(name)} is none of {', '.join(_ESTIMATORS)}")
    state = {key: _decoded(entry) for key, entry in value["state"].items()}
    if kind is Fading:
        return _checked_fading(Fading(**state))
    made = kind.__new__(kind)
    if name in _VALUES:
        made.__setstate__(state)  # checks what it is given
        return made
    missing = set(kind._get_param_names()) - set(state)
    if missing:
        raise ValueError(f"{name} has no {', '.join(sorted(missing))}")
    if kind.__module__.startswith("sklearn_raacmm."):
        made.__setstate__({**state, "_sklearn_raacmm_version": __version__})
    else:
        vars(made).update(state)
        shapes = _SHAPES.get(name, {})
        shapes = {k: v for k, v in shapes.items() if state.get(k) is not None}
        check_shapes(name, state, shapes, {"d": state["n_features_in_"]} if shapes else {})
        if name in ("LinearRegression", "Ridge"):
            q = ("q",) if np.ndim(state["coef_"]) == 2 else ()
            check_shapes(name, state, {"coef_": (*q, "d")}, {"d": state["n_features_in_"]})
    made._validate_params()
    fitted = any(key.endswith("_") for key in state)  # a parameter may be an estimator, too
    if fitted and kind in (JointHarmonicRegressor, ArmResidualRegressor):
        _check_stages(name, state)
    return made


def _checked_fading(fading):
    """The fading, if it is one: a correction would be NaN, or grow where little is known."""
    for field in fields(fading):
        value = getattr(fading, field.name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < np.inf:
            raise ValueError(
                f"{field.name} of Fading must be a finite number of at least 0, got {show(value)}"
            )
    return fading


def _check_stages(name, state):
    """Refuse an estimator of the arm whose stages are not all there."""
    use = state.get("use_", "harmonics")
    if use not in STAGES:
        raise ValueError(f"use_ of {name} must be one of {', '.join(STAGES)}, got {show(use)}")
    n_stages = STAGES.index(use)
    fadings = state.get("fadings_", [state.get("fading_")])
    wanted = {"linear_model_": LinearModel}
    if n_stages > 1:
        wanted["network_"] = RBFNetRegressor
    for key, kind in wanted.items():
        if not isinstance(state.get(key), kind):
            raise ValueError(f"{key} of {name} is no {kind.__name__}")
    whole = isinstance(fadings, list) and all(isinstance(entry, Fading) for entry in fadings)
    if not whole or len(fadings) < max(n_stages, 1):
        raise ValueError(f"{name} does not say how each of its stages fades")
    cap = state.get("cap_mm_", np.inf)
    if isinstance(cap, bool) or not isinstance(cap, int | float) or not cap >= 0:
        raise ValueError(f"cap_mm_ of {name} must be a number of at least 0, got {show(cap)}")
