"""The marginal likelihood against scikit-learn's process, differences and its own forms."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel

from sklearn_raacmm.network._kernels import KERNELS, kernel_matrix
from sklearn_raacmm.network._likelihood import (
    Data,
    exact_likelihood,
    leave_one_out,
    noise_likelihood,
    projected_likelihood,
)


def some_data(n=40, q=2, seed=0):
    rng = np.random.default_rng(seed)
    Y = rng.standard_normal((n, q)).cumsum(axis=0)
    weights = rng.uniform(0.5, 2, n)
    return Data(rng.standard_normal((n, 3)), Y, weights, np.array([0.1, 0.2])[:q])


THETA = np.array([0.1, 0.4, -0.2, -1.0, -3.0])


def forms(data, kernel):
    Z = np.random.default_rng(1).standard_normal((12, 3))
    yield lambda t: exact_likelihood(data, kernel, t[:3], t[3:])
    yield lambda t: projected_likelihood(data, Z, kernel, t[:3], t[3:])


def test_gradient_by_ridge_where_the_triangle_is_inverted_by_halves():
    # Odd numbers of rows, above the size of the last block: the trace of the inverse is in it.
    data, kernel = some_data(n=301, q=1), "matern32"
    found = exact_likelihood(data, kernel, THETA[:3], THETA[3:4])
    Z = data.X * np.exp(-THETA[:3])
    alpha, noise = np.exp(THETA[3]), np.diag(1 / data.weights)
    C = kernel_matrix(Z, Z, kernel) + alpha * noise
    inverse, y = np.linalg.inv(C), data.Y[:, 0]
    solved = inverse @ y
    quadratic = y @ solved + data.within[0] / alpha
    fall = solved @ noise @ solved + data.within[0] / alpha**2
    more = data.n_total / len(y) - 1  # observations that merging took out
    expected = np.sum(inverse * noise) + more * len(y) / alpha - data.n_total * fall / quadratic
    assert np.isclose(found.gradient[3], 0.5 * alpha * expected, rtol=1e-9)


@pytest.mark.parametrize("small", [False, True])
@pytest.mark.parametrize("name", sorted(KERNELS))
def test_gradients_against_finite_differences(name, small):
    # Small ridges go another way, by eigenvectors.
    theta = THETA - [0, 0, 0, 15, 8] if small else THETA
    for function in forms(some_data(), name):
        found = function(theta)
        for i in (None, 0, 1):

            def part(t, f=function, i=i):
                return f(t).value if i is None else f(t).signal[i]

            numeric = approx_fprime(theta, part, 1e-7)
            gradient = found.gradient if i is None else found.signal_gradient[i]
            np.testing.assert_allclose(gradient, numeric, atol=2e-5 * np.abs(numeric).max())


@pytest.mark.parametrize("q", [1, 2, 9])
def test_exact_and_projected_agree_where_every_row_induces(q):
    data = some_data(q=2)
    data = data._replace(Y=np.resize(data.Y.T, (q, 40)).T, within=np.resize(data.within, q))
    theta = np.append(THETA[:3], np.linspace(-1, -3, q))
    one = exact_likelihood(data, "matern52", theta[:3], theta[3:])
    two = projected_likelihood(data, data.X, "matern52", theta[:3], theta[3:])
    for a, b in zip(one, two, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "reference"),
    [("gaussian", RBF([0.7, 1.3])), ("matern32", Matern([0.7, 1.3], nu=1.5))],
)
def test_value_is_that_of_scikit_learns_process(name, reference):
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (50, 2))
    y = np.sin(2 * X[:, 0]) + 0.1 * rng.standard_normal(50)
    data = Data(X, y[:, None], np.ones(50), np.zeros(1))
    differences = []
    for alpha in (0.01, 0.1):
        found = exact_likelihood(data, name, np.log([0.7, 1.3]), np.log([alpha]))
        # Its signal variance has to be told: ours is the best one.
        kernel = ConstantKernel(found.signal[0]) * reference
        kernel += WhiteKernel(found.signal[0] * alpha)
        process = GaussianProcessRegressor(kernel, optimizer=None, alpha=0).fit(X, y)
        differences.append(found.value + process.log_marginal_likelihood_value_)
    # A constant of the number of rows.
    constant = 0.5 * 50 * (np.log(50) - 1 - np.log(2 * np.pi))
    np.testing.assert_allclose(differences, constant, atol=1e-8)


def test_weights_and_repeats_have_one_likelihood():
    rng = np.random.default_rng(1)
    X, Y = rng.standard_normal((20, 2)), rng.standard_normal((20, 1))
    counts = rng.integers(1, 4, 20)
    R = np.repeat(np.arange(20), counts)
    once = Data(X, Y, counts.astype(float), np.zeros(1))
    often = Data(X[R], Y[R], np.ones(len(R)), np.zeros(1))
    theta = "matern52", np.zeros(2), np.array([-2.0])
    for one, two in (
        (exact_likelihood(once, *theta), exact_likelihood(often, *theta)),
        (projected_likelihood(once, X[:8], *theta), projected_likelihood(often, X[:8], *theta)),
    ):
        assert one.value == pytest.approx(two.value, rel=1e-10)
        np.testing.assert_allclose(one.gradient, two.gradient, rtol=1e-7)


def test_a_large_ridge_is_noise_alone():
    data = some_data()
    found = exact_likelihood(data, "gaussian", np.zeros(3), np.full(2, np.log(1e9)))
    assert found.value == pytest.approx(noise_likelihood(data), abs=1e-5)


def test_leave_one_out_by_leaving_one_out():
    data = some_data(25)
    data = data._replace(within=np.zeros(2))
    alphas = np.array([0.1, 0.5])
    K = kernel_matrix(data.X, data.X, "matern52")
    error = density = 0.0
    for output, alpha in enumerate(alphas):
        y, noise = data.Y[:, output], np.diag(alpha / data.weights)
        signal = y @ np.linalg.solve(K + noise, y) / data.n_total
        for row in range(25):
            keep = np.arange(25) != row
            gain = np.linalg.solve((K + noise)[np.ix_(keep, keep)], K[keep, row])
            left = data.weights[row] * (y[row] - gain @ y[keep]) ** 2
            variance = signal * (1 - gain @ K[keep, row] + noise[row, row]) * data.weights[row]
            error += left
            density += 0.5 * (left / variance + np.log(variance))
    found = leave_one_out(data, "matern52", np.zeros(3), np.log(alphas))
    assert found.squared_error == pytest.approx(error, rel=1e-8)
    assert found.negative_log_density == pytest.approx(density, rel=1e-8)
