"""Networks that see features through powers, in every form in which they leave Python."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.export import (
    TRUSTED_TYPES,
    describe,
    export_c,
    from_json,
    load_c,
    to_json,
    to_onnx,
)

COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
needs_compiler = pytest.mark.skipif(not COMPILERS, reason="neither gcc nor clang is on PATH")


def rows(n, seed):
    rng = np.random.default_rng(seed)
    counts = np.floor(np.exp(1.2 * rng.standard_normal(n)))
    sizes = np.exp(1.5 * rng.standard_normal((n, 2)))
    return np.column_stack([sizes[:, 0], rng.uniform(-1, 1, n), counts, sizes[:, 1]])


# Rows as in the fit, and far outside: no power may overflow there.
T = np.vstack([rows(60, 1), [[0, 0, -5, 1], [-3, 2, 1e3, 1e4], [1e8, 0, 0, 0]]])


@pytest.fixture(scope="module", params=["radial", "linear", "groups"])
def model(request):
    X, rng = rows(150, 0), np.random.default_rng(0)
    if request.param == "linear":
        y = np.column_stack([np.log(X[:, 0] * X[:, 3]), np.log(X[:, 0]) + X[:, 1]])
    elif request.param == "groups":
        y = np.column_stack([np.sin(1.2 * np.log(X[:, 0])), np.sin(6 * X[:, 1]) + np.log(X[:, 3])])
    else:
        y = np.sin(1.5 * np.log(X[:, 0])) + X[:, 1] ** 2 + np.log1p(X[:, 2]) + np.cbrt(X[:, 3])
    # Weights so small that single precision is good to five digits.
    options = {"kernel": "matern32", "alpha": 0.05} if request.param != "linear" else {}
    model = RBFNetRegressor(random_state=0, **options)
    model.fit(X, y + 0.2 * rng.standard_normal(y.shape))
    assert len(model.powers_.changed) >= 2
    assert np.any(model.linear_coef_) == (request.param == "linear")
    assert np.any(model.output_groups_) == (request.param == "groups")
    return model


@needs_compiler
def test_c(model, tmp_path):
    compiled = load_c(model, std=True, cache_dir=tmp_path)
    mean, std = model.predict(T, return_std=True)
    got = compiled.predict(T).reshape(mean.shape)
    np.testing.assert_allclose(got, mean, rtol=1e-12, atol=1e-12)
    of_rows = np.array([compiled.predict_std(row) for row in T])
    np.testing.assert_allclose(of_rows[:, 0].reshape(mean.shape), mean, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(of_rows[:, 1].reshape(std.shape), std, rtol=1e-3)


@needs_compiler
def test_c_in_single_precision(model, tmp_path):
    source, _ = export_c(model, tmp_path / "arm.c", dtype="float")
    strict = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wdouble-promotion"]
    command = [COMPILERS[0], "-std=c99", *strict, "-shared", "-fPIC", source, "-lm", "-o"]
    subprocess.run([*command, tmp_path / "arm.so"], check=True)
    loaded = ctypes.CDLL(str(tmp_path / "arm.so"))
    x = T.astype(np.float32)
    expected = model.predict(x.astype(float))
    got = np.empty(expected.shape, dtype=np.float32)
    place = ctypes.c_void_p
    loaded.arm_predict_n(place(x.ctypes.data), place(got.ctypes.data), ctypes.c_size_t(len(T)))
    np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5)
    assert "expm1, isfinite, log, log1p" in source.read_text()  # of math.h


def test_onnx(model):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    pytest.importorskip("skl2onnx", reason="needs the extra onnx")
    session = onnxruntime.InferenceSession(
        to_onnx(model).SerializeToString(), providers=["CPUExecutionProvider"]
    )
    (got,) = session.run(None, {session.get_inputs()[0].name: T})
    expected = model.predict(T).reshape(got.shape)
    np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)


def test_json(model):
    text = to_json(model)
    np.testing.assert_array_equal(from_json(text).predict(T), model.predict(T))
    assert '"value": "FeaturePowers"' in text


def test_skops(model):
    skops = pytest.importorskip("skops.io", reason="needs the extra skops")
    loaded = skops.loads(skops.dumps(model), trusted=TRUSTED_TYPES)
    np.testing.assert_array_equal(loaded.predict(T), model.predict(T))


def test_the_card_says_so(model):
    (step,) = describe(model)["steps"]
    assert step.endswith(f", powers of {len(model.powers_.changed)} features)")


def test_a_damaged_file_is_refused(model):
    powers = model.powers_
    state = vars(powers) | {"low": powers.low[:3]}
    with pytest.raises(ValueError, match=r"low of FeaturePowers has shape \(3,\)"):
        type(powers).__new__(type(powers)).__setstate__(state)
    fewer = type(powers)(*(value[:3] for value in vars(powers).values()))
    state = model.__getstate__() | {"powers_": fewer}
    with pytest.raises(ValueError, match=r"lambdas of FeaturePowers has shape \(3,\)"):
        RBFNetRegressor().__setstate__(state)
