"""ONNX of the arm's own error model: columns, fading and stages as predict has them."""

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import to_onnx

onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
pytest.importorskip("onnx", reason="needs the extra onnx")
pytestmark = pytest.mark.filterwarnings("ignore:.*poses lie where the model knows little")


@pytest.fixture(scope="module")
def data():
    return make_single_point(n_positions=8, n_poses=15, random_state=0)


def run(converted, X):
    session = onnxruntime.InferenceSession(
        converted.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    return session.run(None, {session.get_inputs()[0].name: X})[0]


def of_arm(arm, *causes, **params):
    return ArmResidualRegressor(arm, **{"orders": 3, "causes": list(causes), **params})


def network(**params):
    return RBFNetRegressor(**{"n_centers": 20, "length_scale": 1.5, "alpha": 0.03, **params})


def everywhere(n_joints, n=60):
    rng = np.random.default_rng(0)
    near = rng.uniform(-np.pi, np.pi, (n, n_joints))
    return np.concatenate([near, near + 2 * np.pi, rng.uniform(-12, 12, (n, n_joints))])


def agree(model, X, **params):
    """To a share of the terms' size: coefficients may nearly cancel far from the poses."""
    linear = model.linear_model_
    terms = np.abs(linear.columns(X)) @ np.abs(linear.coef)
    expected = model.predict(X)
    got = run(to_onnx(model, **params), X)
    atol = 1e-12 + 1e-13 * terms.max(initial=0)
    np.testing.assert_allclose(got, expected, rtol=0, atol=atol)
    return expected


@pytest.mark.parametrize(
    ("name", "families", "fade"),
    [
        *(("aacmm6", family, 0) for family in ("gravity", "kinematics", "wobble", "", "all")),
        *((name, "all", "auto") for name in ("aacmm6", "panda")),
        ("panda", "gravity", 0),
        ("panda", "", "auto"),
    ],
)
def test_models_of_the_arm(name, families, fade):
    arm = Arm.from_name(name, joint_signs=-1, theta_offset=0.3, probe=(3, -8, 120))
    X = np.random.default_rng(0).uniform(-2, 2, (100, arm.n_joints))
    y = np.stack([np.sin(X[:, 1]), np.cos(2 * X[:, 2]), np.sin(X[:, 3])], axis=1) * 0.05
    causes = ("gravity", "kinematics", "wobble") if families == "all" else families.split()
    model = of_arm(arm, *causes, fade=fade).fit(X, y)
    assert (model.fading_.factor > 0) == (fade == "auto")
    expected = agree(model, np.concatenate([X[:20], everywhere(arm.n_joints)]))
    assert np.ptp(expected, axis=0).min() > 1e-3
    one = run(to_onnx(model), X[:1])
    np.testing.assert_allclose(one, model.predict(X[:1]), rtol=0, atol=1e-12)


@pytest.mark.parametrize("fade", [0.0, 0.5, 2.0])
@pytest.mark.parametrize("degree", [-1, 1])
def test_both_stages(data, fade, degree):
    second = make_pipeline(PoseFeatures(data.arm), network(degree=degree))
    model = of_arm(data.arm, "kinematics", "wobble", orders=2, regressor=second, fade=fade)
    model.fit(data.data, data.target)
    X = np.concatenate([data.data, everywhere(6)])
    agree(model, X)
    # float32 in and out; the model itself in float64.
    single = X.astype(np.float32)
    got = run(to_onnx(model, dtype="float"), single)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, model.predict(single.astype(float)), rtol=1e-6, atol=1e-8)
    assert (model.fading(X).min() < 0.5 < 0.9 < model.fading(X).max()) == (fade > 0)


def test_standard_deviations(data):
    second = make_pipeline(PoseFeatures(data.arm), network())
    model = of_arm(data.arm, "kinematics", regressor=second).fit(data.data, data.target)
    X = np.concatenate([data.data, everywhere(6)])
    for one in (model, second.fit(data.data, data.target)):
        session = onnxruntime.InferenceSession(to_onnx(one, std=True).SerializeToString())
        mean, std = session.run(["y", "std"], {"X": X})
        expected = one.predict(X, return_std=True)
        np.testing.assert_allclose(mean, expected[0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(std, expected[1], rtol=1e-6)


def test_a_model_of_zero_terms(data):
    y = 1e-3 * np.random.default_rng(0).normal(size=data.target.shape)
    model = of_arm(data.arm, orders=[50]).fit(data.data, y)
    assert len(model.coef_) == 0
    assert not run(to_onnx(model), data.data).any()


def test_in_the_frame_of_the_azimuth(data):
    inner = of_arm(data.arm, "kinematics")
    model = CylindricalResidualTarget(inner, azimuth=data.arm.azimuth).fit(data.data, data.target)
    got = run(to_onnx(model), data.data)
    np.testing.assert_allclose(got, model.predict(data.data), rtol=0, atol=1e-12)


@pytest.mark.parametrize("target_opset", [13, 21, 22])
def test_opsets(data, target_opset):
    model = of_arm(data.arm, "gravity", "kinematics").fit(data.data, data.target)
    converted = to_onnx(model, target_opset=target_opset)
    assert converted.opset_import[0].version <= target_opset
    assert {node.domain for node in converted.graph.node} == {""}  # ai.onnx
    np.testing.assert_allclose(run(converted, data.data), model.predict(data.data), atol=1e-12)


def test_what_predict_refuses_is_nan(data):
    first = of_arm(data.arm, "kinematics", orders=2)
    both = of_arm(data.arm, "kinematics", orders=2, regressor=network())
    for model in (first, both):
        model.fit(data.data, data.target)
        X = np.tile(data.data[:1], (19, 1))
        for i, bad in enumerate([np.nan, np.inf, -np.inf]):
            X[1 + np.arange(6) + 6 * i, np.arange(6)] = bad
        got = run(to_onnx(model), X)
        assert np.isfinite(got[0]).all()
        assert np.isnan(got[1:]).all()
