"""The marginal likelihood against scikit-learn's process, differences and its own forms."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal

from sklearn_raacmm.network._kernels import KERNELS, kernel_matrix
from sklearn_raacmm.network._likelihood import (
    Task,
    covariance,
    exact_likelihood,
    judge,
    likelihoods,
    objective,
)
from sklearn_raacmm.network._rows import Rows


def some_data(n=40, q=2, within=(0.1, 0.2), seed=0):
    rng = np.random.default_rng(seed)
    Y = rng.standard_normal((n, q)).cumsum(axis=0)
    weights = rng.uniform(0.5, 2, n)
    lost = np.full((n, q), np.divide(within, n)[:q])
    return Rows(rng.standard_normal((n, 3)), Y, weights, within=lost)


THETA = np.array([0.1, 0.4, -0.2, -1.0, -3.0])


def covariance_of(data, alpha, ratio, kernel="matern52"):
    """Of the targets over the signal variance, with a constant of each group."""
    same = np.equal.outer(data.codes, data.codes)
    noise = np.diag(1 / data.weights) + ratio * same
    return kernel_matrix(data.X, data.X, kernel) + alpha * noise


def test_value_with_constants_is_the_density_of_a_normal_variable():
    data = some_data(q=1, within=(0.0,))._replace(codes=np.sort(np.arange(40) % 6))
    values, densities = [], []
    for ratio in (0.0, 0.01, 1.0, 50.0):
        C = covariance_of(data, 0.3, ratio)
        value, _, found, _ = exact_likelihood(data, "matern52", np.zeros(3), np.log([0.3]), ratio)
        # The variance is that of as many observations as the weights say.
        signal = data.Y[:, 0] @ np.linalg.solve(C, data.Y[:, 0]) / data.n_total
        assert found[0] == pytest.approx(signal, rel=1e-9)
        values.append(value)
        extra = 0.5 * (len(C) - data.n_total) * np.log(signal)
        density = multivariate_normal.logpdf(data.Y[:, 0], cov=signal * C)
        densities.append(-density - extra)
    # Neither constants of 2 pi and the weights nor the quadratic form, which is n.
    np.testing.assert_allclose(np.diff(values), np.diff(densities), rtol=1e-9)


@pytest.mark.parametrize("ratio", [None, 0.0, 3.0])
def test_what_is_left_out_by_leaving_it_out(ratio):
    """Row by row, or groups as a whole, whose rows have a common constant."""
    data = some_data(25, within=(0.0, 0.0))
    codes = np.arange(25) if ratio is None else np.sort(np.arange(25) % 4)
    alphas, density = np.array([0.1, 0.5]), 0.0
    for y, alpha in zip(data.Y.T, alphas, strict=True):
        C = covariance_of(data._replace(codes=codes), alpha, ratio or 0.0)
        signal = y @ np.linalg.solve(C, y) / data.n_total
        for one in np.unique(codes):
            out, keep = codes == one, codes != one
            gain = np.linalg.solve(C[np.ix_(keep, keep)], C[np.ix_(keep, out)]).T
            root = np.sqrt(data.weights[out])
            left = root * (y[out] - gain @ y[keep])
            of_left = C[np.ix_(out, out)] - gain @ C[np.ix_(keep, out)]
            of_left = signal * root[:, None] * of_left * root
            density += 0.5 * (left @ np.linalg.solve(of_left, left) + np.linalg.slogdet(of_left)[1])
    data = data if ratio is None else data._replace(codes=codes)
    found = likelihoods(data, covariance(data, "matern52", np.zeros(3)), alphas, ratio or 0.0)[1]
    assert found == pytest.approx(density, rel=1e-8)


@pytest.mark.parametrize("constants", [False, True])
@pytest.mark.parametrize("name", sorted(KERNELS))
def test_gradients_against_finite_differences(name, constants):
    theta = np.append(THETA, -1.0)
    data = some_data()
    data = data._replace(codes=np.sort(np.arange(40) % 7)) if constants else data

    def function(t):
        return exact_likelihood(data, name, t[:3], t[3:5], np.exp(t[5]) if constants else 0.0)

    _, gradient, _, of_signal = function(theta)
    for found, part in (
        (gradient, lambda t: function(t)[0]),
        (of_signal[0], lambda t: function(t)[2][0]),
        (of_signal[1], lambda t: function(t)[2][1]),
    ):
        numeric = approx_fprime(theta, part, 1e-7)
        np.testing.assert_allclose(found, numeric, atol=2e-5 * np.abs(numeric).max())


@pytest.mark.parametrize("codes", [None, np.sort(np.arange(40) % 6)])
def test_starts_are_compared_by_what_the_search_lowers(codes):
    data = some_data()._replace(codes=codes)
    task = Task(np.ones(3), np.ones(3, dtype=bool), 2, constants=codes is not None)
    for theta in (task.start(0.2, 0.1), task.start(1.0, 0.01)):
        alone = judge(task, "matern32", theta, data, leave_out=False)
        assert alone.value == pytest.approx(objective(task, theta, data, "matern32")[0], rel=1e-12)
        assert alone.value == judge(task, "matern32", theta, data).value
