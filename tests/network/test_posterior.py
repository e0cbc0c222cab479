"""Covariances, draws and gradients of the network, against its process and differences."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import KERNELS

RNG = np.random.default_rng(3)
X = RNG.uniform(-2, 2, (60, 2)) * [1, 50]
Y = np.column_stack([np.sin(2 * X[:, 0]) + 0.02 * X[:, 1], 1e3 * np.cos(X[:, 0])])
Y += RNG.standard_normal(Y.shape) * [0.1, 30]
T = np.random.default_rng(4).uniform(-2.5, 2.5, (20, 2)) * [1, 50]


@pytest.mark.parametrize(("n_centers", "digits"), [(60, 1e-6), ("auto", 1e-10)])
def test_covariance_and_draws_are_those_of_the_gaussian_process(n_centers, digits):
    """With all rows as centres, chosen one by one, or because the function is so rough."""
    alpha, width, y = 0.03, np.array([0.3, 10.0]), Y[:, 0]
    model = RBFNetRegressor(n_centers, length_scale=width, alpha=alpha, degree=-1).fit(X, y)
    if n_centers == "auto":
        assert model.stop_reason_ == "all rows"
        assert model.networks_[0].all_rows
        assert model.error_reduction_.shape == model.criterion_path_.shape == (0,)
    np.testing.assert_array_equal(model.centers_, X[model.center_indices_])
    assert len(model.centers_) == model.n_iter_ == len(X)
    signal = model.signal_variance_
    assert model.noise_variance_ == pytest.approx(alpha * signal)
    C = RBF(width)(X) + alpha * np.eye(60)
    assert signal == pytest.approx(y @ np.linalg.solve(C, y) / 60, rel=digits)
    kernel = ConstantKernel(signal) * RBF(width) + WhiteKernel(signal * alpha)
    process = GaussianProcessRegressor(kernel, optimizer=None, alpha=0).fit(X, y)
    mean, covariance = model.predict(T, return_cov=True)
    mean_ref, covariance_ref = process.predict(T, return_cov=True)
    np.testing.assert_allclose(mean, mean_ref, atol=digits)
    np.testing.assert_allclose(covariance, covariance_ref, atol=digits * signal)
    for with_noise in (True, False):
        _, std = model.predict(T, return_std=True, with_noise=with_noise)
        variance = covariance_ref.diagonal() - (0 if with_noise else signal * alpha)
        np.testing.assert_allclose(std**2, variance, atol=digits * signal)
    _, of_mean = model.predict(T, return_cov=True, with_noise=False)
    np.testing.assert_allclose(
        covariance - of_mean, signal * alpha * np.eye(20), atol=1e-12 * signal
    )
    draws = model.sample_y(T[:5], 4000, random_state=0)
    assert draws.shape == process.sample_y(T[:5], 4000).shape
    # Means to four standard errors; covariances, whose error is their size over the root of 2000.
    error = np.sqrt(covariance[:5, :5].diagonal() / 4000)
    assert np.all(np.abs(draws.mean(axis=1) - mean[:5]) < 4 * error)
    np.testing.assert_allclose(
        np.cov(draws), covariance[:5, :5], atol=0.1 * covariance.diagonal()[:5].max()
    )
    np.testing.assert_array_equal(draws, model.sample_y(T[:5], 4000, random_state=0))
    assert not np.array_equal(draws, model.sample_y(T[:5], 4000, random_state=1))


@pytest.mark.parametrize("degree", [-1, 0, 1])
def test_covariance_has_the_standard_deviation_on_its_diagonal(degree):
    model = RBFNetRegressor(7, length_scale=[0.7, 60], alpha=0.1, degree=degree, shared=True)
    model.fit(X, Y)
    for with_noise in (True, False):
        _, std = model.predict(T, return_std=True, with_noise=with_noise)
        _, covariance = model.predict(T, return_cov=True, with_noise=with_noise)
        assert covariance.shape == (20, 20, 2)
        variance = np.einsum("iio->io", covariance)
        np.testing.assert_allclose(variance, std**2, rtol=1e-9)
        for one in np.moveaxis(covariance, 2, 0):
            assert np.linalg.eigvalsh(one).min() > -1e-9 * one.max()
    assert model.sample_y(T, 3).shape == (20, 2, 3)
    with pytest.raises(ValueError, match="one of return_std and return_cov"):
        model.predict(T, return_std=True, return_cov=True)
    with pytest.raises(ValueError, match="n_samples"):
        model.sample_y(T, 0)


def test_a_constant_has_a_covariance_and_no_slope():
    model = RBFNetRegressor().fit([[0.0], [1.0], [2.0]], [5.0, 5.0, 5.0])
    assert len(model.centers_) == 0
    np.testing.assert_array_equal(model.predict_gradient([[0.5], [9.0]]), [[0.0], [0.0]])
    assert model.sample_y([[0.5]]).shape == (1, 1)
    one = RBFNetRegressor().fit([[0.0]], [5.0])
    with pytest.raises(ValueError, match="noise variance is infinite"):
        one.sample_y([[0.5]])
    np.testing.assert_array_equal(one.predict_gradient([[0.5]]), [[0.0]])


@pytest.mark.parametrize("kernel", list(KERNELS))
@pytest.mark.parametrize("degree", [-1, 0, 1])
@pytest.mark.parametrize("y", [Y, Y[:, 0]], ids=["two outputs", "one output"])
def test_gradients_are_those_of_differences(kernel, degree, y):
    width = [0.7, 60.0]
    model = RBFNetRegressor(25, kernel=kernel, length_scale=width, alpha=[0.1] * y.ndim)
    model.set_params(alpha=[0.1, 0.01] if y.ndim == 2 else 0.1, degree=degree).fit(X, y)
    gradient = model.predict_gradient(T)
    assert gradient.shape == (20, *y.shape[1:], 2)
    for j, step in enumerate([1e-5, 5e-4]):
        there, back = T.copy(), T.copy()
        there[:, j] += step
        back[:, j] -= step
        slope = (model.predict(there) - model.predict(back)) / (2 * step)
        scale = np.abs(slope).max(axis=0)
        np.testing.assert_allclose(gradient[..., j] / scale, slope / scale, atol=1e-6)


def test_variances_are_the_means_of_their_posterior():
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (15, 2))
    y = np.sin(X[:, 0]) + 0.1 * rng.standard_normal(15)
    found = RBFNetRegressor(kernel="gaussian", max_centers=15).fit(X, y)
    n_widths = np.isfinite(found.length_scale_).sum()
    given = RBFNetRegressor(
        len(found.centers_), kernel="gaussian", length_scale=found.length_scale_, alpha=found.alpha_
    ).fit(X, y)
    np.testing.assert_array_equal(given.centers_, found.centers_)
    # Of 14 degrees of freedom the widths, their choice and the ridge take some away.
    degrees = 14 - (n_widths + np.log1p(2) + 1) - 2
    assert found.noise_variance_ == pytest.approx(given.noise_variance_ * 14 / degrees, rel=1e-9)
