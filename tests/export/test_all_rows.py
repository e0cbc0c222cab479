"""A network whose centres are all rows: what leaves Python is what predict computes."""

import shutil

import numpy as np
import pytest

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.export import (
    TRUSTED_TYPES,
    _networks,
    from_json,
    load_c,
    to_json,
    to_onnx,
)

RNG = np.random.default_rng(0)
X, T = RNG.uniform(-1, 1, (150, 3)), RNG.uniform(-1.3, 1.3, (40, 3))
Y = np.column_stack([np.sin(5 * X).sum(axis=1), np.cos(4 * X[:, 0]) + X[:, 1]])
Y += 0.1 * RNG.standard_normal(Y.shape)
needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("gcc", "clang", "cc"))), reason="no C compiler is on PATH"
)


@pytest.fixture
def model():
    model = RBFNetRegressor(length_scale=0.5, alpha=[0.02, 0.03], degree=1).fit(X, Y)
    assert all(network.all_rows for network in model.networks_)
    return model


@needs_compiler
def test_c(model, tmp_path):
    compiled = load_c(model, std=True, cache_dir=tmp_path)
    mean, std = model.predict(T, return_std=True)
    np.testing.assert_allclose(compiled.predict(T), mean, rtol=0, atol=1e-11)
    of_rows = np.array([compiled.predict_std(row) for row in T])
    np.testing.assert_allclose(of_rows[:, 0], mean, rtol=0, atol=1e-11)
    np.testing.assert_allclose(of_rows[:, 1], std, rtol=1e-3)


@needs_compiler
def test_too_many_centres_for_a_table_are_told(model, tmp_path, monkeypatch):
    monkeypatch.setattr(_networks, "MOST_CENTERS", 149)
    with pytest.raises(ValueError, match="a network of 150 centres would need a table of"):
        load_c(model, std=True, cache_dir=tmp_path)
    np.testing.assert_allclose(
        load_c(model, cache_dir=tmp_path).predict(T), model.predict(T), rtol=0, atol=1e-11
    )


def test_onnx(model):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    pytest.importorskip("skl2onnx", reason="needs the extra onnx")
    session = onnxruntime.InferenceSession(
        to_onnx(model).SerializeToString(), providers=["CPUExecutionProvider"]
    )
    (got,) = session.run(None, {session.get_inputs()[0].name: T})
    np.testing.assert_allclose(got, model.predict(T), rtol=0, atol=1e-11)


def test_json(model):
    loaded = from_json(to_json(model, std=True))
    mean, std = model.predict(T, return_std=True)
    got_mean, got_std = loaded.predict(T, return_std=True)
    np.testing.assert_allclose(got_mean, mean, rtol=0, atol=1e-11)
    np.testing.assert_allclose(got_std, std, rtol=1e-6)


def test_skops(model):
    skops = pytest.importorskip("skops.io", reason="needs the extra skops")
    loaded = skops.loads(skops.dumps(model), trusted=TRUSTED_TYPES)
    np.testing.assert_array_equal(loaded.predict(T, return_std=True), model.predict(T, True))
