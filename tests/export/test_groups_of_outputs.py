"""A network whose outputs have centres of their own, as C, ONNX, JSON and in words."""

import shutil

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import TRUSTED_TYPES, describe, export_c, from_json, load_c, to_json
from sklearn_raacmm.network import networks_of

WIDTHS = {"gaussian": (1.0, 2.0), "rational_quadratic": (0.6, np.inf), "matern32": (1.5, 0.8)}
KERNELS = ["gaussian", "rational_quadratic", "gaussian", "matern32", "rational_quadratic"]
needs_compiler = pytest.mark.skipif(
    not (shutil.which("gcc") or shutil.which("clang")), reason="neither gcc nor clang is on PATH"
)


def network(kernels=KERNELS, n_features=2, **params):
    """Outputs of three groups, whose columns are not side by side."""
    widths = np.array([np.resize(WIDTHS[kernel], n_features) for kernel in kernels])
    return RBFNetRegressor(**{"kernel": kernels, "length_scale": widths, "alpha": 0.02, **params})


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (80, 2))
    Y = np.column_stack([np.sin((1 + k) * X[:, 0] + X[:, 1]) for k in range(5)])
    return X, Y + 0.05 * rng.standard_normal(Y.shape), rng.uniform(-3, 3, (50, 2))


@pytest.fixture(scope="module")
def arm():
    return make_single_point(n_positions=8, n_poses=15, random_state=0)


@pytest.fixture(scope="module")
def of_arm(arm):
    """The published chain, and the arm's own model, each with groups of outputs."""
    kernels = ["gaussian", "matern32", "gaussian"]
    inner = network(kernels, 3, alpha=0.05)
    steps = make_pipeline(PoseFeatures(arm.arm), StandardScaler(), inner)
    chain = CylindricalResidualTarget(steps, azimuth=arm.arm.azimuth)
    whole = ArmResidualRegressor(
        arm.arm, network=network(kernels, 6, degree=-1), use="harmonics+network", fade=1.0
    )
    return chain.fit(arm.data, arm.target), whole.fit(arm.data, arm.target, groups=arm.groups)


@needs_compiler
@pytest.mark.parametrize("degree", [-1, 0, 1])
def test_c(data, degree):
    X, Y, T = data
    model = network(degree=degree).fit(X, Y)
    assert len(networks_of(model)) == 3
    mean, std = model.predict(T, return_std=True)
    loaded = load_c(model, std=True)
    np.testing.assert_allclose(loaded.predict(T), mean, rtol=0, atol=1e-11)
    got = [loaded.predict_std(row) for row in T]
    np.testing.assert_allclose([one[-1] for one in got], std, rtol=1e-3)
    np.testing.assert_allclose(load_c(model).predict(T), mean, rtol=0, atol=1e-11)


@needs_compiler
def test_c_of_an_arm(arm, of_arm):
    for model in of_arm:
        std = isinstance(model, ArmResidualRegressor)
        loaded = load_c(model, std=std)
        np.testing.assert_allclose(
            loaded.correct(arm.data), model.predict(arm.data), rtol=0, atol=1e-9
        )


def test_c_in_single_precision_has_each_name_once(data, tmp_path):
    X, Y, _ = data
    source, header = export_c(
        network().fit(X, Y), tmp_path / "net.c", std=True, dtype="float", poses=X
    )
    text = source.read_text()
    for number in (1, 2, 3):
        for name in ("network", "network_variance", "weight", "center", "turn"):
            assert text.count(f" {name}_{number}(const") + text.count(f" {name}_{number}[") >= 1
    assert text.count("static float falling_exp(") == 2  # one for other processors
    said = "RBFNetRegressor: outputs 0, 2: gaussian"
    assert said in text or said in header.read_text()
    if shutil.which("gcc") or shutil.which("clang"):
        assert "net_predict" in header.read_text()


def test_onnx(data, arm, of_arm):
    onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
    pytest.importorskip("skl2onnx", reason="needs the extra onnx")
    from sklearn_raacmm.export import to_onnx

    X, Y, T = data
    cases = [(network(degree=d).fit(X, Y), T) for d in (0, 1)]
    for model, rows in [*cases, *((model, arm.data) for model in of_arm)]:
        session = onnxruntime.InferenceSession(
            to_onnx(model).SerializeToString(), providers=["CPUExecutionProvider"]
        )
        got = session.run(None, {session.get_inputs()[0].name: rows})[0]
        np.testing.assert_allclose(got, model.predict(rows), rtol=0, atol=1e-11)


def test_json_and_skops(data):
    X, Y, T = data
    model = network().fit(X, Y)
    again = from_json(to_json(model))
    np.testing.assert_array_equal(again.predict(T), model.predict(T))
    np.testing.assert_array_equal(
        again.predict(T, return_std=True)[1], model.predict(T, return_std=True)[1]
    )
    np.testing.assert_array_equal(again.output_groups_, [0, 1, 0, 2, 1])
    skops = pytest.importorskip("skops.io", reason="needs the extra skops")
    read = skops.loads(skops.dumps(model), trusted=TRUSTED_TYPES)
    np.testing.assert_array_equal(read.predict(T), model.predict(T))


def test_words(of_arm):
    card = describe(of_arm[0])
    parts = networks_of(of_arm[0].regressor_[-1])
    first, second = (len(part.centers_) for _, part in parts)
    expected = f"outputs 0, 2: gaussian, {first} centres; outputs 1: matern32, {second} centres"
    assert f"RBFNetRegressor ({expected})" in card["steps"]
