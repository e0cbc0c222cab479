"""The linear tail, its ridge and when it is chosen, against closed forms and linear models."""

from functools import partial

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from sklearn.linear_model import LinearRegression, RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import _rows
from sklearn_raacmm.network._kernels import kernel_matrix
from sklearn_raacmm.network._likelihood import likelihoods, log_likelihood
from sklearn_raacmm.network._linear import RIDGES, Problem, linear_evidence, prepare
from sklearn_raacmm.network._rows import Rows, distinct_rows


def linear(n, d, noise, seed=0, q=1):
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((n, d)) * rng.uniform(0.1, 10, d) + 5
    Y = X / X.std(axis=0) @ rng.standard_normal((d, q)) + 3
    return X, Y + noise * rng.standard_normal((n, q))


def linear_ridge(columns, targets, within, n):
    return linear_evidence(columns, targets, within, n, n)[0]


@pytest.mark.parametrize("noise", [0.1, 3.0])
def test_ridge_makes_the_targets_most_probable(noise):
    X, Y = linear(30, 8, noise, q=2)
    Z, about = (X - X.mean(axis=0)) / X.std(axis=0), Y - Y.mean(axis=0)

    def probability(ridge):
        covariance = Z @ Z.T / ridge + np.eye(30)
        total = 0.0
        for y in about.T:
            variance = y @ np.linalg.solve(covariance, y) / 30
            total += multivariate_normal.logpdf(y, cov=variance * covariance)
        return total

    expected = max(RIDGES[20:61], key=probability)
    assert linear_ridge(Z, about, np.zeros(2), 30) == expected
    assert 0.01 < expected / (8 * noise**2 / 8) < 100


def test_full_network_is_the_posterior_with_linear_functions():
    # Penalised least squares in closed form; the ridge of the tail is that of the linear model.
    X, Y = linear(150, 3, 0.5, q=2)
    Y += np.sin(3 * X[:, :1] / X[:, 0].std())
    width = 0.3 * X.std(axis=0)
    model = RBFNetRegressor(130, kernel="gaussian", length_scale=width, degree=1, shared=True)
    model.fit(X, Y)

    def columns(T):
        radial = kernel_matrix(T / width, model.centers_ / width, "gaussian")
        return np.hstack([np.ones((len(T), 1)), (T - X.mean(axis=0)) / X.std(axis=0), radial])

    penalty = np.zeros((134, 134))
    penalty[1:4, 1:4] = np.eye(3) * linear_ridge(
        columns(X)[:, 1:4], Y - Y.mean(axis=0), np.zeros(2), 150
    )
    gram, T = columns(X).T @ columns(X), X[:20] + 0.1
    rows = model.networks_[0].design_triangle()
    np.testing.assert_allclose(rows.T @ rows, gram + penalty, atol=1e-9 * gram.max())
    mean = model.predict(T)
    for i, alpha in enumerate(model.alpha_):
        penalty[4:, 4:] = alpha * columns(model.centers_)[:, 4:]
        weights = np.linalg.solve(gram + penalty, columns(X).T @ Y[:, i])
        np.testing.assert_allclose(mean[:, i], columns(T) @ weights, rtol=1e-7)
        left = Y[:, i] - columns(X) @ weights
        objective = left @ left + weights @ penalty @ weights
        # The ridge has been found, and an inverse gamma variable has its mean.
        assert model.noise_variance_[i] == pytest.approx(objective / (149 - 1 - 2), rel=1e-8)


def test_rows_in_blocks_have_the_ridge_of_their_sample(monkeypatch):
    X, Y = linear(400, 5, 2.0, q=2)
    Y[:, 1] *= 1e3
    weights = np.random.default_rng(0).uniform(0.5, 2, 400)
    monkeypatch.setattr(_rows, "IN_MEMORY_ROWS", 300)
    monkeypatch.setattr(_rows, "HELD_ROWS", 150)
    rows, everywhere = distinct_rows(Rows(X, Y, weights), 5, np.random.RandomState(1))
    sample = prepare(rows, 1, ridged=True)
    given = sample.polynomial, sample.tail_ridge
    problem = Problem(rows, *given, everywhere=(*everywhere, np.arange(2)))
    assert problem.tail_ridge == sample.tail_ridge > 0
    for one in (problem, sample):
        total, gram, projection = one.reduce(
            partial(products, one), lambda a, b: tuple(map(np.add, a, b)), 12
        )
        np.testing.assert_allclose(gram, np.eye(6), atol=1e-10)
        np.testing.assert_allclose(one.projection, projection, rtol=1e-8)
        left = total - np.square(projection).sum(axis=0)
        np.testing.assert_allclose(one.n_total * one.spread**2, left, rtol=1e-8)


def products(problem, block):
    basis, targets = problem.basis(block), block.targets
    return np.square(targets).sum(axis=0), basis.T @ basis, basis.T @ targets


def test_a_given_ridge_leaves_the_linear_part_free():
    X, Y = linear(60, 3, 1.0)
    model = RBFNetRegressor(1, length_scale=1.0, alpha=1e9, degree=1).fit(X, Y)
    np.testing.assert_allclose(model.predict(X), LinearRegression().fit(X, Y).predict(X), rtol=1e-7)
    found = RBFNetRegressor(degree=1).fit(X, np.full(60, 2.0))
    np.testing.assert_allclose(found.predict(X), np.full(60, 2.0), rtol=1e-14)


def test_evidence_of_a_linear_model_is_the_density_of_a_normal_variable():
    X, Y = linear(30, 8, 1.0, q=2)
    weights = np.random.default_rng(2).uniform(0.5, 2, 30)
    data = Rows(X, Y - np.average(Y, axis=0, weights=weights), weights).merged()
    X, Y, weights = data.X, data.Y, data.weights
    center = np.average(X, axis=0, weights=weights)
    Z = (X - center) / np.sqrt(np.average((X - center) ** 2, axis=0, weights=weights))
    root, n = np.sqrt(weights)[:, None], weights.sum()
    ridge, _, value = linear_evidence(root * Z, data.targets, np.zeros(2), n - 1, n)
    C = Z @ Z.T / ridge + np.diag(1 / weights)
    density, alone = 0.0, 0.0
    for y in Y.T:
        # The variance at its optimum of as many observations as the weights say.
        variance = y @ np.linalg.solve(C, y) / weights.sum()
        quadratic = y @ np.linalg.solve(C, y) / variance
        density -= 0.5 * (n * np.log(2 * np.pi * variance) + np.linalg.slogdet(C)[1] + quadratic)
        for i in range(30):
            others = np.arange(30) != i
            gain = np.linalg.solve(C[np.ix_(others, others)], C[others, i])
            error = (y[i] - gain @ y[others]) ** 2 * weights[i]
            spread = variance * (C[i, i] - gain @ C[others, i]) * weights[i]
            alone += 0.5 * (error / spread + np.log(spread))
    assert log_likelihood(data, value) == pytest.approx(density, rel=1e-9)
    K = root * (Z @ Z.T) * root.T / ridge
    assert likelihoods(data, K, np.ones(2))[1] == pytest.approx(alone, rel=1e-8)


@pytest.mark.parametrize(("n", "d", "noise"), [(20, 4, 0.1), (40, 12, 0.3), (150, 5, 1.0)])
def test_default_is_as_good_as_a_linear_model_where_the_data_are_linear(n, d, noise):
    peer = make_pipeline(StandardScaler(), RidgeCV(np.logspace(-4, 4, 17)))
    models = [RBFNetRegressor(random_state=0), RBFNetRegressor(degree=0, random_state=0), peer]
    errors = np.zeros((3, 3))
    for seed in range(3):
        X, Y = linear(n + 500, d, 0.0, seed)
        y = Y[:, 0] / Y.std()
        observed = y + noise * np.random.default_rng(seed).standard_normal(len(y))
        learn, test = slice(0, n), slice(n, n + 500)
        for i, model in enumerate(models):
            found = model.fit(X[learn], observed[learn]).predict(X[test])
            errors[i, seed] = np.sqrt(np.mean((found - y[test]) ** 2))
    default, constant, ridge = errors.mean(axis=1)
    assert default < 1.15 * ridge
    assert default < 1.02 * constant


@pytest.mark.parametrize("settings", [{}, {"alpha": 0.1}, {"length_scale": 2.0}])
def test_default_is_a_constant_and_radial_functions_elsewhere(settings):
    rng = np.random.default_rng(3)
    X = rng.uniform(-2, 2, (40, 2))
    y = X[:, 0] if settings else X[:, 0] + np.sin(3 * X[:, 1])
    y = y + 0.1 * rng.standard_normal(40)
    models = (RBFNetRegressor(degree=degree, **settings).fit(X, y) for degree in ("auto", 0))
    found, constant = (model.predict(X) for model in models)
    np.testing.assert_array_equal(found, constant)


def test_no_linear_function_in_noise():
    found = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        model = RBFNetRegressor().fit(rng.standard_normal((40, 4)), rng.standard_normal(40))
        found += np.any(model.linear_coef_)
    assert found <= 2


def test_rows_in_blocks_may_be_linear_too(monkeypatch):
    monkeypatch.setattr(_rows, "IN_MEMORY_ROWS", 100)
    monkeypatch.setattr(_rows, "HELD_ROWS", 150)
    X, Y = linear(400, 2, 0.3, q=2)
    found = RBFNetRegressor(random_state=0).fit(X, Y)
    assert np.all(np.any(found.linear_coef_, axis=1))
    expected = LinearRegression().fit(X, Y)
    np.testing.assert_allclose(found.predict(X), expected.predict(X), atol=0.02 * Y.std())
