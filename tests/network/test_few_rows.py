"""The average of models with few rows: its weights, its numbers in closed form, what it gains."""

import numpy as np
import pytest
from scipy.special import softmax
from scipy.stats import t as student

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import _few_rows
from sklearn_raacmm.network._few_rows import average
from sklearn_raacmm.network._kernels import kernel_matrix
from sklearn_raacmm.network._likelihood import Data
from sklearn_raacmm.network._width_search import Process


def few(n=9, d=3, q=2, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, d)) * rng.uniform(0.5, 3, d)
    Y = X @ rng.standard_normal((d, q)) + np.sin(3 * X[:, :1])
    Y += 0.3 * rng.standard_normal((n, q))
    weights = rng.uniform(0.5, 2, n)
    return X, Y - np.average(Y, axis=0, weights=weights), weights


def scaled(X, weights):
    about = X - np.average(X, axis=0, weights=weights)
    return about / np.sqrt(np.average(about**2, axis=0, weights=weights))


def test_average_has_the_covariance_of_its_models(monkeypatch):
    # Three given models with equal weights: the covariance of the average is the mean of theirs,
    # but for its scale, which is that of the data.
    X, Y, weights = few(q=1)
    n = weights.sum()
    data = Data(X, Y, weights, np.zeros(1))
    width, alpha, y = np.array([1.0, 2.0, 3.0]), np.array([0.2]), Y[:, 0]
    monkeypatch.setattr(_few_rows, "_weights", lambda *args: np.full(3, 1 / 3))
    found = average(data, Process("matern52", width, alpha, 0.0, 4.0))
    radial = kernel_matrix(X / width, X / width, "matern52")
    Z, noise = scaled(X, weights), np.diag(1 / weights)
    ridge = _few_rows.linear_process(data).ridge

    def variance(C):
        return y @ np.linalg.solve(C, y) / n

    signal = variance(radial + 0.2 * noise)
    of_linear, total = variance(Z @ Z.T / ridge + noise), variance(noise)
    left = np.exp(np.mean(np.log([0.2 * signal, of_linear, total])))
    expected = (signal * radial + of_linear / ridge * Z @ Z.T) / 3 / left + noise
    C = radial / found.alpha[0] + Z @ Z.T / found.tail_ridge + noise
    np.testing.assert_allclose(C, expected, rtol=1e-9)
    # Twice the noise of an observation is not twice the observations: the density has n of them.
    v = variance(C)
    density = -0.5 * (n * np.log(2 * np.pi * v) + np.linalg.slogdet(C)[1] + n)
    assert found.log_likelihood == pytest.approx(density, rel=1e-9)


def test_weights_are_those_of_the_evidence():
    # Few rows a feature: leave-one-out densities hardly count, and the margins are those at 0.
    X, Y, _ = few(n=5, d=40, q=1)
    data = Data(X, Y, np.ones(5), np.zeros(1))
    linear = _few_rows.linear_process(data)
    nats = linear.objective
    process = Process("gaussian", np.full(40, 9.0), np.array([0.1]), nats, 4.0)
    found = average(data, process).weights
    total = 5 * np.mean(Y**2)
    evidence = -np.array([nats, nats + _few_rows.LINEAR_NATS[0], 0.5 * 5 * np.log(total)])
    evidence[2] += _few_rows.NOISE_NATS[0]
    np.testing.assert_allclose(found, softmax(evidence), atol=0.05)
    assert np.all(found > 0)


def test_one_model_where_it_is_clear_and_with_many_rows():
    X, Y, _ = few(n=40, d=4, q=1)
    process = Process("gaussian", np.full(4, 2.0), np.array([0.1]), 0.0, 5.0)
    assert average(Data(X, Y, np.ones(40), np.zeros(1)), process) is None
    two = np.hstack([Y[:30], Y[:30] ** 2])
    assert average(Data(X[:30], two, np.ones(30), np.zeros(2)), process) is None
    data = Data(X[:30], Y[:30] - Y[:30].mean(), np.ones(30), np.zeros(1))
    sure = average(data, process._replace(objective=-1e3))
    np.testing.assert_array_equal(sure.weights, [1, 0, 0])
    assert sure.tail_ridge == 0
    np.testing.assert_allclose(sure.alpha, [0.1], rtol=1e-9)
    assert sure.n_found == process.n_found
    never = average(data, process._replace(objective=1e3))
    assert never.weights[0] == 0
    assert np.all(never.alpha == 1e6)


def test_prediction_is_that_of_one_process():
    # All rows are centres: the network is the process with radial and linear covariance, whose
    # constant is found by generalised least squares.
    X, Y, _ = few(n=12, d=4, q=1, seed=17)
    T = few(n=200, d=4, seed=5)[0]
    model = RBFNetRegressor(12).fit(X, Y[:, 0])
    assert np.all(model.linear_coef_ != 0)
    assert len(model.centers_) == 12
    assert model.alpha_ < 1
    ones = np.ones(12)
    rows = model.posterior_.design_triangle()
    ridge = (rows.T @ rows)[1, 1] - 12  # below the columns, whose mean square is 1
    shift, scale, width = X.mean(axis=0), X.std(axis=0), model.length_scale_

    def covariance(A, B):
        linear = ((A - shift) / scale) @ ((B - shift) / scale).T
        radial = kernel_matrix(A / width, B / width, model.kernel_)
        return radial / model.alpha_ + linear / ridge

    C, across = covariance(X, X) + np.eye(12), covariance(T, X)
    a, b = np.linalg.solve(C, np.column_stack([ones, Y[:, 0]])).T
    constant = b.sum() / a.sum()
    mean, std = model.predict(T, return_std=True)
    np.testing.assert_allclose(mean, constant + across @ (b - constant * a), rtol=1e-6)
    left = 1 - across @ a
    variance = 1 + np.diag(covariance(T, T)) - np.sum(across * np.linalg.solve(C, across.T).T, 1)
    variance += left**2 / a.sum()
    np.testing.assert_allclose(std, np.sqrt(variance * model.noise_variance_), rtol=1e-6)


def test_better_than_a_choice_with_few_rows():
    # Half of the functions are linear: whoever chooses one model errs on the others. The choice by
    # the data that was made before had 0.82 of the error of radial functions alone.
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        X = rng.uniform(-1.7, 1.7, (405, 4))
        f = X @ rng.standard_normal(4) / 2 if seed % 2 else np.sin(1.5 * X[:, 0]) + 0.5 * X[:, 1]
        y = f[:5] + 0.1 * rng.standard_normal(5)
        found = [RBFNetRegressor(degree=d).fit(X[:5], y).predict(X[5:]) for d in ("auto", 0)]
        errors.append([np.sqrt(np.mean((p - f[5:]) ** 2)) for p in found])
    average, constant = np.exp(np.log(errors).mean(axis=0))
    assert average < 0.75 * constant


def test_linear_part_sees_all_features_where_rows_are_fewer():
    # Six rows show no more than five directions, but any five features would be an odd choice.
    rng = np.random.default_rng(0)
    X = rng.standard_normal((6, 12))
    y = X @ np.ones(12) + 0.1 * rng.standard_normal(6)
    model = RBFNetRegressor(degree=1, n_centers=1, length_scale=1e6, kernel="gaussian").fit(X, y)
    Z, T = (X - X.mean(axis=0)) / X.std(axis=0), rng.standard_normal((50, 12))
    rows = model.posterior_.design_triangle()
    ridge = (rows.T @ rows)[1, 1] - 6
    assert np.all(model.linear_coef_ != 0)
    weights = Z.T @ np.linalg.solve(Z @ Z.T + ridge * np.eye(6), y - y.mean())
    expected = y.mean() + (T - X.mean(axis=0)) / X.std(axis=0) @ weights
    np.testing.assert_allclose(model.predict(T), expected, rtol=1e-6)


def test_a_warm_start_keeps_the_average():
    X, Y, _ = few(n=13, d=4, q=1, seed=1)
    model = RBFNetRegressor(warm_start=True).fit(X[:12], Y[:12, 0])
    assert np.all(model.linear_coef_ != 0)
    again = model.fit(X, Y[:, 0])
    new = RBFNetRegressor().fit(X, Y[:, 0])
    np.testing.assert_allclose(again.predict(X), new.predict(X), rtol=1e-9)


def test_interval_of_two_rows_is_that_of_one_degree_of_freedom():
    # Two observations of what is taken for noise: Student's variable with one degree.
    y = np.array([1.0, 1.5])
    model = RBFNetRegressor(degree=0).fit([[0.0], [1.0]], y)
    assert model.alpha_ > 1e3
    mean, std = model.predict([[0.5]], return_std=True)
    half = student.ppf(0.975, 1) * np.std(y, ddof=1) * np.sqrt(1 + 1 / 2)
    assert mean[0] == pytest.approx(1.25)
    assert 1.96 * std[0] == pytest.approx(half, rel=1e-2)
