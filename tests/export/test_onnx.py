"""ONNX: what the runtime computes is what predict computes."""

import builtins

import numpy as np
import pytest
from sklearn.compose import TransformedTargetRegressor
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline, make_union
from sklearn.preprocessing import (
    FunctionTransformer,
    MinMaxScaler,
    QuantileTransformer,
    StandardScaler,
)

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.export import _onnx, fingerprint, register_onnx, to_onnx
from sklearn_raacmm.network._kernels import KERNELS

onnx = pytest.importorskip("onnx", reason="needs the extra onnx")
onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
pytest.importorskip("skl2onnx", reason="needs the extra onnx")
pytestmark = pytest.mark.filterwarnings("ignore:.*poses lie where the model knows little")


def run(converted, X):
    session = onnxruntime.InferenceSession(
        converted.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    return session.run(None, {session.get_inputs()[0].name: X})[0]


def network(**params):
    return RBFNetRegressor(**{"n_centers": 20, "length_scale": 1.5, "alpha": 0.03, **params})


def form_a(arm, scaler=None, net=None, **pose):
    steps = [PoseFeatures(arm, **pose), scaler or StandardScaler(), net or network()]
    return CylindricalResidualTarget(make_pipeline(*steps), azimuth=arm.azimuth)


def form_b(arm, scaler=None, net=None, **pose):
    inner = make_pipeline(scaler or StandardScaler(), net or network())
    pose = PoseFeatures(arm, append_azimuth=True, **pose)
    return make_pipeline(pose, CylindricalResidualTarget(inner))


def angles_everywhere(n_joints, n=300):
    rng = np.random.default_rng(0)
    near = rng.uniform(-np.pi, np.pi, (n, n_joints))
    turns = 2 * np.pi * rng.integers(-1, 2, (n, n_joints))
    return np.concatenate([near, near + turns, rng.uniform(-12, 12, (n, n_joints))])


@pytest.mark.parametrize("form", [form_a, form_b])
@pytest.mark.parametrize("joints", ["pose", "all"])
@pytest.mark.parametrize("encoding", ["angle", "periodic"])
def test_agrees_with_predict(data, form, joints, encoding):
    model = form(data.arm, joints=joints, encoding=encoding).fit(data.data, data.target)
    X = np.concatenate([data.data, angles_everywhere(6)])
    got = run(to_onnx(model), X)
    assert got.dtype == np.float64
    np.testing.assert_allclose(got, model.predict(X), rtol=0, atol=1e-12)
    X = X.astype(np.float32)
    got = run(to_onnx(model, dtype="float"), X)
    assert got.dtype == np.float32
    # A nanometre of the model itself, which is what float32 angles leave of it at best.
    np.testing.assert_allclose(got, model.predict(X.astype(float)), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("kernel", "degree"),
    [*((kernel, 0) for kernel in KERNELS), ("gaussian", -1), ("matern32", 1)],
)
def test_every_kernel_and_tail_alone(kernel, degree):
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (60, 4))
    X[:, 2] = 5.0  # does not vary
    Y = np.stack([np.sin(X[:, 0]), X[:, 1] * X[:, 3]], axis=1)
    new = np.concatenate([X[:5], rng.uniform(-4, 4, (100, 4))])
    for y in (Y, Y[:, 0]):
        model = network(kernel=kernel, degree=degree).fit(X, y)
        expected = model.predict(new).reshape(len(new), -1)
        np.testing.assert_allclose(run(to_onnx(model), new), expected, rtol=1e-12, atol=1e-12)


def test_the_base_may_be_the_shoulder():
    arm = Arm.from_name("panda", pose_frames=(0, 5))
    X = angles_everywhere(7)
    pose = PoseFeatures(arm).fit(X)
    np.testing.assert_allclose(run(to_onnx(pose), X), pose.transform(X), rtol=0, atol=1e-12)


def test_elevation_to_the_last_digits():
    # The runtime has no arc tangent in float64: straight up, straight down and level, too.
    arm = Arm(
        a=[0, 300, 200], alpha=[np.pi / 2, 0, 0], d=[100, 0, 0],
        pose_joints=(2, 3), pose_frames=(1, 3),
    )  # fmt: skip
    elbow = np.r_[np.linspace(-np.pi, np.pi, 401), np.pi / 2 + np.array([-1e-8, 0, 1e-8])]
    X = np.column_stack([np.zeros_like(elbow), elbow, np.zeros_like(elbow)])
    pose = PoseFeatures(arm).fit(X)
    expected = np.where(np.abs(elbow) > np.pi / 2, np.sign(elbow) * np.pi - elbow, elbow)
    np.testing.assert_allclose(run(to_onnx(pose), X)[:, 2], expected, rtol=0, atol=1e-14)


def test_inside_other_estimators(data):
    X, y = data.data, data.target
    arm = data.arm
    models = [
        make_pipeline(make_union(PoseFeatures(arm), StandardScaler()), Ridge()),
        make_pipeline(PoseFeatures(arm, encoding="periodic"), MinMaxScaler(), LinearRegression()),
        form_b(arm, net=Ridge()),
        CylindricalResidualTarget(network(), azimuth=None),
        form_a(arm, net=Ridge()),
        make_pipeline(form_a(arm)),
        GridSearchCV(form_b(arm), {"posefeatures__joints": ["pose", "all"]}, cv=3),
        make_pipeline(PoseFeatures(arm), CylindricalResidualTarget(network(), azimuth=None)),
    ]
    for model in models:
        model.fit(X, y)
        np.testing.assert_allclose(run(to_onnx(model), X), model.predict(X), rtol=0, atol=1e-11)


def test_skl2onnx_itself_knows_the_converters_once_registered(data):
    import skl2onnx

    register_onnx()
    register_onnx()
    model = form_b(data.arm).fit(data.data, data.target)
    converted = skl2onnx.to_onnx(model, data.data[:1])
    np.testing.assert_allclose(run(converted, data.data), model.predict(data.data), atol=1e-12)


@pytest.mark.parametrize("form", [form_a, form_b])
@pytest.mark.parametrize("kernel", ["gaussian", "rational_quadratic"])
def test_refuses_with_nan_what_predict_refuses(data, form, kernel):
    model = form(data.arm, net=network(kernel=kernel)).fit(data.data, data.target)
    X = np.tile(data.data[:1], (18, 1))
    for i, bad in enumerate([np.nan, np.inf, -np.inf]):
        X[np.arange(6) + 6 * i, np.arange(6)] = bad
    X = np.concatenate([data.data[:1], X])
    got = run(to_onnx(model), X)
    assert np.isfinite(got[0]).all()
    assert np.isnan(got[1:]).all()


@pytest.mark.parametrize("dtype", ["double", "float"])
@pytest.mark.parametrize(
    "first",
    [MinMaxScaler(clip=True), QuantileTransformer(n_quantiles=10), StandardScaler()],
    ids=lambda first: type(first).__name__,
)
def test_a_step_that_clips_does_not_hide_what_predict_refuses(first, dtype):
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(60, 3)), rng.normal(size=(60, 2))
    model = make_pipeline(first, network(n_centers=5)).fit(X, y)
    bad = np.tile(X[:1], (10, 1)).astype(np.float64 if dtype == "double" else np.float32)
    bad[np.arange(9), np.arange(9) % 3] = np.repeat([np.nan, np.inf, -np.inf], 3)
    got = run(to_onnx(model, dtype=dtype), bad)
    assert np.isnan(got[:9]).all()
    expected = model.predict(bad[9:].astype(float))
    np.testing.assert_allclose(got[9:], expected, rtol=0, atol=1e-12 if dtype == "double" else 1e-4)
    for row in bad[:9]:
        with pytest.raises(ValueError, match=r"NaN|infinity"):
            model.predict(row[None])


def test_a_failure_of_skl2onnx_is_one_sentence():
    X = np.random.default_rng(0).normal(size=(60, 3))
    model = make_pipeline(FunctionTransformer(np.sin), network(n_centers=3)).fit(X, X[:, 0])
    with pytest.raises(ValueError, match="fails to convert a chain of FunctionTransformer, RBF"):
        to_onnx(model)
    broken = make_pipeline(StandardScaler(), network(n_centers=3)).fit(X, X[:, 0])
    del broken[0].scale_  # what a converter runs into: an AttributeError of its own
    with pytest.raises(ValueError, match=r"fails to convert a chain of .*AttributeError") as error:
        to_onnx(broken)
    assert "\n" not in str(error.value)


def test_the_file(data, tmp_path):
    model = form_b(data.arm).fit(data.data, data.target)
    for name in ("first.onnx", "second.onnx"):
        to_onnx(model, tmp_path / name, card="what it is: ü")
    onnx.checker.check_model(tmp_path / "first.onnx", full_check=True)
    text = (tmp_path / "first.onnx").read_bytes()
    assert text == (tmp_path / "second.onnx").read_bytes()
    session = onnxruntime.InferenceSession(text, providers=["CPUExecutionProvider"])
    facts = session.get_modelmeta().custom_metadata_map
    assert facts["model_card"] == "what it is: ü"
    assert session.get_inputs()[0].shape[1] == 6


def test_says_what_cannot_be_converted(data):
    X, y = data.data, data.target
    with pytest.raises(ValueError, match="KernelRidge cannot be converted to ONNX"):
        to_onnx(KernelRidge().fit(X, y))
    other = form_a(data.arm).set_params(azimuth=_azimuth).fit(X, y)
    with pytest.raises(ValueError, match="only the method of an Arm can"):
        to_onnx(other)
    with pytest.raises(ValueError, match="target_opset 13 or newer, got 12"):
        to_onnx(form_a(data.arm).fit(X, y), target_opset=12)
    with pytest.raises(ValueError, match="dtype must be 'double' or 'float', got 'float64'"):
        to_onnx(form_a(data.arm).fit(X, y), dtype="float64")
    target = TransformedTargetRegressor(network()).fit(X, y)
    with pytest.raises(ValueError, match="TransformedTargetRegressor cannot be converted"):
        to_onnx(target)


def _azimuth(X):
    return np.zeros(len(X))


def test_without_onnx_the_error_says_what_to_install(monkeypatch, data):
    model = network().fit(data.data, data.target)
    importing = builtins.__import__

    def nothing(name, *args, **kwargs):
        if name.partition(".")[0] in ("skl2onnx", "onnx"):
            raise ImportError(name)
        return importing(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", nothing)
    with pytest.raises(ImportError, match=r"pip install -e \"\.\[onnx\]\""):
        to_onnx(model)
    with pytest.raises(ImportError, match="skl2onnx, which is not installed"):
        register_onnx()


def test_what_the_metadata_say(data, tmp_path):
    """Test rows with answers: the check of the page, in a runtime that knows nothing of us."""
    import json

    model = form_b(data.arm).fit(data.data, data.target)
    to_onnx(model, tmp_path / "arm.onnx", std=True, poses=data.data)
    session = onnxruntime.InferenceSession(tmp_path / "arm.onnx")
    facts = session.get_modelmeta().custom_metadata_map
    assert facts["fingerprint"] == fingerprint(model)
    rows = json.loads(facts["test_rows"])
    X, y, std = (np.array(rows[key][:28], dtype=float) for key in ("X", "y", "std"))
    assert rows["y"][28:] == [[None] * 3] * 4
    got = session.run(None, {"X": X})
    np.testing.assert_allclose(got[0], y, rtol=0, atol=1e-12)
    np.testing.assert_allclose(got[1], std, rtol=1e-9)
    np.testing.assert_allclose(y, model.predict(X), rtol=0, atol=1e-14)
    assert {tuple(row) for row in X[:20]} <= {tuple(row) for row in data.data}


def test_openvino(data):
    """With its two options; without them it computes in bfloat16 where the processor can."""
    openvino = pytest.importorskip("openvino", reason="OpenVINO is not installed")
    model = form_b(data.arm).fit(data.data, data.target)
    core = openvino.Core()
    options = {"INFERENCE_PRECISION_HINT": "f32", "EXECUTION_MODE_HINT": "ACCURACY"}
    compiled = core.compile_model(
        core.read_model(to_onnx(model).SerializeToString()), "CPU", options
    )
    X = np.concatenate([data.data, angles_everywhere(6, 50)])
    got = compiled([X])[0]
    assert np.abs(got - model.predict(X)).max() < 1e-5


def test_a_file_that_does_not_keep_its_promise_is_refused(data, monkeypatch):
    model = form_b(data.arm).fit(data.data, data.target)
    compute = _onnx.run_onnx
    monkeypatch.setattr(_onnx, "run_onnx", lambda *args: [1.001 * out for out in compute(*args)])
    with pytest.raises(ValueError, match=r"the ONNX file is up to .* away from predict, 0.001 of"):
        to_onnx(model)


# -- the arm's own error model --------------------------------------------------------------------


def of_arm(arm, *causes, **params):
    return ArmResidualRegressor(arm, **{"orders": 3, "causes": list(causes), **params})


@pytest.mark.parametrize("fade", [0.0, 0.5, 2.0])
def test_faded_corrections(data, fade):
    model = of_arm(data.arm, "kinematics", "wobble", orders=2, fade=fade)
    model.fit(data.data, data.target)
    X = np.concatenate([data.data, angles_everywhere(6, 60)])
    terms = np.abs(model.linear_model_.columns(X)) @ np.abs(model.linear_model_.coef)
    atol = 1e-12 + 1e-13 * terms.max()  # coefficients may nearly cancel far from the poses
    np.testing.assert_allclose(run(to_onnx(model), X), model.predict(X), rtol=0, atol=atol)
    # float32 in and out; the model itself in float64.
    single = X.astype(np.float32)
    got = run(to_onnx(model, dtype="float"), single)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, model.predict(single.astype(float)), rtol=1e-6, atol=1e-8)
    assert (model.fading(X).min() < 0.5 < 0.9 < model.fading(X).max()) == (fade > 0)


@pytest.mark.parametrize("target_opset", [13, 21, 22])
def test_opsets(data, target_opset):
    model = of_arm(data.arm, "gravity", "kinematics").fit(data.data, data.target)
    converted = to_onnx(model, target_opset=target_opset)
    assert converted.opset_import[0].version <= target_opset
    assert {node.domain for node in converted.graph.node} == {""}  # ai.onnx
    np.testing.assert_allclose(run(converted, data.data), model.predict(data.data), atol=1e-12)
