"""Kernels that a user writes: the rational quadratic, and a wave that fades."""

import io
import pickle

import joblib
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, RationalQuadratic, WhiteKernel

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.export import TRUSTED_TYPES, export_c

from ..export._chains import ways_out


def quadratic(s, slope=False):
    K = 1 / (1 + 0.5 * s)
    return (K, -0.5 * K * K) if slope else K


def wave(s, slope=False):
    """Of one feature, but of no more: the transform of two normal densities."""
    r = np.sqrt(s + 1e-12)
    decay = np.exp(-0.01 * s)
    K = decay * np.cos(2 * r)
    return (K, -0.01 * K - decay * np.sin(2 * r) / r) if slope else K


def powers(s, slope=False):
    K = (1 + s / 3) ** -1.5
    return (K, -0.5 * (1 + s / 3) ** -2.5) if slope else K


def exponential(s, slope=False):
    K = 2.0**-s
    return (K, -np.log(2) * K) if slope else K


def log_kernel(s, slope=False):
    K = np.exp(-np.log1p(s))
    return (K, -K * K) if slope else K


RNG = np.random.default_rng(0)
X = RNG.uniform(-3, 3, (80, 2)) * [1, 10]
Y = np.sin(2 * X[:, 0]) + 0.05 * X[:, 1] + 0.1 * RNG.standard_normal(80)
T = RNG.uniform(-4, 4, (30, 2)) * [1, 10]


@pytest.fixture(scope="module")
def fitted():
    return RBFNetRegressor(kernel=quadratic, random_state=0).fit(X, Y)


def test_it_is_the_process_of_scikit_learn():
    alpha, width = 0.05, 0.8
    model = RBFNetRegressor(80, kernel=quadratic, length_scale=width, alpha=alpha, degree=-1)
    mean, std = model.fit(X, Y).predict(T, return_std=True)
    signal = model.signal_variance_
    kernel = ConstantKernel(signal) * RationalQuadratic(width, alpha=1) + WhiteKernel(
        signal * alpha
    )
    process = GaussianProcessRegressor(kernel, optimizer=None, alpha=0).fit(X, Y)
    mean_ref, std_ref = process.predict(T, return_std=True)
    assert_allclose(mean, mean_ref, atol=1e-7)
    assert_allclose(std, std_ref, atol=1e-7)


def test_a_list_is_searched_by_evidence():
    x = np.linspace(0, 12, 120)[:, None]
    noise = 0.2 * np.random.default_rng(1).standard_normal(120)
    kernels = ["gaussian", wave]
    waves = RBFNetRegressor(kernel=kernels, random_state=0).fit(x, np.sin(7 * x[:, 0]) + noise)
    assert waves.kernel_ is wave
    later = np.linspace(12, 13, 20)[:, None]
    assert np.std(waves.predict(later) - np.sin(7 * later[:, 0])) < 0.2
    smooth = RBFNetRegressor(kernel=kernels, random_state=0).fit(x, (x[:, 0] - 6) ** 2 / 9 + noise)
    alone = RBFNetRegressor(kernel="gaussian", random_state=0).fit(
        x, (x[:, 0] - 6) ** 2 / 9 + noise
    )
    assert smooth.kernel_ == "gaussian"
    assert_array_equal(smooth.predict(later), alone.predict(later))


def test_outputs_with_other_kernels_and_gradients():
    x = np.linspace(0, 12, 120)[:, None]
    rng = np.random.default_rng(1)
    Y = np.column_stack([np.sin(7 * x[:, 0]), np.cos(x[:, 0])]) + 0.1 * rng.standard_normal(
        (120, 2)
    )
    model = RBFNetRegressor(kernel=["gaussian", wave], random_state=0).fit(x, Y)
    assert model.kernel_.tolist() == [wave, "gaussian"]
    at, step = x[5:50] + 0.01, 1e-6
    numeric = (model.predict(at + step) - model.predict(at - step)) / (2 * step)
    assert_allclose(model.predict_gradient(at)[:, :, 0], numeric, atol=1e-4)


def test_it_is_written_as_c_and_onnx(fitted, tmp_path):
    mean, std = fitted.predict(T, return_std=True)
    for name, found, spread in ways_out(tmp_path, fitted, T, std=True):
        assert_allclose(found[:, 0], mean, rtol=0, atol=1e-11, err_msg=name)
        assert_allclose(spread[:, 0], std, rtol=1e-7, err_msg=name)
    x = np.linspace(0, 12, 120)[:, None]
    waves = RBFNetRegressor(kernel=wave, random_state=0).fit(x, np.sin(7 * x[:, 0]))
    for name, found, _ in ways_out(tmp_path, waves, x):
        assert_allclose(found[:, 0], waves.predict(x), rtol=0, atol=1e-11, err_msg=name)
    of_powers = RBFNetRegressor(20, kernel=powers, random_state=0).fit(X, Y)
    for name, found, _ in ways_out(tmp_path, of_powers, T):
        assert_allclose(found[:, 0], of_powers.predict(T), rtol=0, atol=1e-11, err_msg=name)
    for kernel, said in (
        (log_kernel, r"uses numpy\.log1p, which cannot be written as C or ONNX; less"),
        (exponential, r"uses numpy\.power, .* C or ONNX but to whole numbers and halves; less"),
    ):
        unknown = RBFNetRegressor(5, kernel=kernel).fit(X, Y)
        with pytest.raises(ValueError, match=said):
            export_c(unknown, tmp_path / "unknown.c")


def test_it_is_kept_by_its_name(fitted):
    mean = fitted.predict(T)
    file = io.BytesIO()
    joblib.dump(fitted, file)
    file.seek(0)
    for again in (pickle.loads(pickle.dumps(fitted)), joblib.load(file)):
        assert again.kernel_ is quadratic
        assert_array_equal(again.predict(T), mean)
    assert clone(fitted).kernel is quadratic
    own = f"{quadratic.__module__}.quadratic"
    skops = pytest.importorskip("skops.io", reason="needs the extra skops")
    text = skops.dumps(fitted)
    assert own in skops.get_untrusted_types(data=text)
    with pytest.raises(TypeError, match="Untrusted types found"):
        skops.loads(text, trusted=TRUSTED_TYPES)
    assert_array_equal(skops.loads(text, trusted=[*TRUSTED_TYPES, own]).predict(T), mean)
    with pytest.raises((pickle.PicklingError, AttributeError), match="lambda"):
        pickle.dumps(RBFNetRegressor(kernel=lambda s, slope=False: quadratic(s, slope)))


def test_faults_have_one_sentence():
    def of(function):
        return RBFNetRegressor(kernel=function).fit(X, Y)

    with pytest.raises(ValueError, match="wave is not positive definite for 2 features: its m"):
        of(wave)
    with pytest.raises(
        ValueError,
        match=r"1 at distance 0, and with slope=True two; for \(61,\) it returns \(61,\), from 2,",
    ):
        of(lambda s, slope=False: (2 * np.exp(-s), -2 * np.exp(-s)) if slope else 2 * np.exp(-s))
    with pytest.raises(
        ValueError, match=r"its slope at the squared distance 0\.5 is -0\.6065.* it "
    ):
        of(lambda s, slope=False: (np.exp(-s), -np.exp(-s)) if slope else np.exp(-0.5 * s))
    with pytest.raises(ValueError, match=r"for \(61,\) it returns \(\), from 1, and \(\)\."):
        of(lambda s, slope=False: (1.0, 0.0) if slope else 1.0)
    with pytest.raises(ValueError, match="must be 'auto', functions, or of gaussian, matern52, "):
        of(["gaussian", "cubic"])
