"""Groups of rows whose targets are known up to a constant each."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from sklearn import config_context
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import CylindricalResidualTarget, RBFNetRegressor
from sklearn_raacmm.network import _group_search, _read
from sklearn_raacmm.network._group_noise import group_errors, group_likelihood
from sklearn_raacmm.network._kernels import kernel_matrix
from sklearn_raacmm.network._likelihood import (
    Data,
    exact_likelihood,
    leave_one_out,
    projected_likelihood,
)
from sklearn_raacmm.network._network_posterior import RadialFunctions, fit_path, posterior_of
from sklearn_raacmm.network._rows import merge, prepare, with_group_noise
from sklearn_raacmm.utils import centred, group_weights


def contrasts(codes):
    """Orthonormal columns that span all differences within groups."""
    total = np.eye(len(codes)) - np.equal.outer(codes, codes) / group_weights(codes)[codes]
    values, vectors = np.linalg.eigh(total)
    return vectors[:, values > 0.5]


def some_data(n=40, n_groups=6, q=2, seed=0, weighted=False):
    rng = np.random.default_rng(seed)
    X, codes = rng.standard_normal((n, 3)), np.sort(np.arange(n) % n_groups)
    weights = rng.uniform(0.5, 2, n) if weighted else np.ones(n)
    Y = centred(np.sin(X[:, :q]) + 0.2 * rng.standard_normal((n, q)), codes, weights)
    return Data(X, Y, weights, np.full(q, 0.1 if weighted else 0.0), codes)


THETA = np.array([0.1, 0.4, -0.2, -1.0, -3.0])


@pytest.mark.parametrize("small", [False, True])
def test_likelihood_is_that_of_differences_within_groups(small):
    data, theta = some_data(), THETA - 18.0 * small * np.eye(5)[3:].sum(axis=0)
    Q, Z = contrasts(data.codes), data.X / np.exp(theta[:3])
    expected = 0.0
    for y, alpha in zip(data.Y.T, np.exp(theta[3:]), strict=True):
        C = Q.T @ (kernel_matrix(Z, Z, "matern32") + alpha * np.eye(len(Z))) @ Q
        quadratic = y @ Q @ np.linalg.solve(C, Q.T @ y)
        expected += 0.5 * (np.linalg.slogdet(C)[1] + len(C) * np.log(quadratic))
    found = exact_likelihood(data, "matern32", theta[:3], theta[3:])
    np.testing.assert_allclose(found.value, expected, rtol=1e-7)


@pytest.mark.parametrize("inducing", [False, True])
def test_gradients_against_finite_differences(inducing):
    data = some_data(weighted=True)

    def function(t):
        if inducing:
            return projected_likelihood(data, data.X[::3], "matern52", t[:3], t[3:])
        return exact_likelihood(data, "matern52", t[:3], t[3:])

    found = function(THETA)
    for part, gradient in (
        (lambda t: function(t).value, found.gradient),
        (lambda t: function(t).signal[1], found.signal_gradient[1]),
    ):
        numeric = approx_fprime(THETA, part, 1e-7)
        np.testing.assert_allclose(gradient, numeric, atol=2e-5 * np.abs(numeric).max())


def test_groups_left_out_by_leaving_them_out():
    data = some_data(q=1)
    theta = THETA[:4]
    alpha, Z = np.exp(theta[3]), data.X / np.exp(theta[:3])
    K = kernel_matrix(Z, Z, "gaussian")
    error = 0.0
    for g in range(6):
        out = data.codes == g
        Q = contrasts(data.codes[~out])
        C = Q.T @ (K[np.ix_(~out, ~out)] + alpha * np.eye(np.sum(~out))) @ Q
        predicted = K[np.ix_(out, ~out)] @ Q @ np.linalg.solve(C, Q.T @ data.Y[~out, 0])
        error += np.sum((data.Y[out, 0] - (predicted - predicted.mean())) ** 2)
    found = leave_one_out(data, "gaussian", theta[:3], theta[3:])
    np.testing.assert_allclose(found.squared_error, error, rtol=1e-9)


def group_covariance(data, theta, share, kernel="matern52"):
    """Of one output over the signal variance, for all rows, and of the function alone."""
    Z = data.X / np.exp(theta[:3])
    K = kernel_matrix(Z, Z, kernel)
    noise = (1 - share) * np.diag(1 / data.weights) + share * K * np.equal.outer(
        data.codes, data.codes
    )
    return K + np.exp(theta[3]) * noise, K


def test_likelihood_with_functions_of_the_groups_own():
    data = some_data(weighted=True)
    weights = data.weights / data.weights.mean()  # as many observations as rows
    data, Q = data._replace(weights=weights, within=np.zeros(2)), contrasts(data.codes)

    def expected(share):
        value = 0.0
        for y, alpha in zip(data.Y.T, THETA[3:], strict=True):
            C = Q.T @ group_covariance(data, np.append(THETA[:3], alpha), share)[0] @ Q
            quadratic = y @ Q @ np.linalg.solve(C, Q.T @ y)
            value += 0.5 * (np.linalg.slogdet(C)[1] + len(C) * np.log(quadratic))
        return value

    def found(share):
        ratio = np.log(share / (1 - share))
        return group_likelihood(data, "matern52", THETA[:3], THETA[3:], ratio).value

    # They differ by a constant, the volume of the differences in units of the weights.
    np.testing.assert_allclose(found(0.7) - found(0.1), expected(0.7) - expected(0.1), rtol=1e-7)


def test_without_a_share_it_is_the_likelihood_with_offsets():
    data = some_data(weighted=True)
    found = group_likelihood(data, "matern52", THETA[:3], THETA[3:], -40.0)
    expected = exact_likelihood(data, "matern52", THETA[:3], THETA[3:])
    np.testing.assert_allclose(found.value, expected.value, rtol=1e-10)
    np.testing.assert_allclose(found.gradient[:5], expected.gradient, rtol=1e-7, atol=1e-9)


def test_gradients_with_functions_of_the_groups_own():
    data, theta = some_data(weighted=True), np.append(THETA, 0.4)

    def function(t):
        return group_likelihood(data, "matern52", t[:3], t[3:5], t[5])

    found = function(theta)
    for part, gradient in (
        (lambda t: function(t).value, found.gradient),
        (lambda t: function(t).signal[1], found.signal_gradient[1]),
    ):
        numeric = approx_fprime(theta, part, 1e-7)
        np.testing.assert_allclose(gradient, numeric, atol=2e-5 * np.abs(numeric).max())


@pytest.mark.parametrize("offsets", [False, True])
def test_errors_of_groups_by_leaving_them_out(offsets):
    data = some_data(q=1, weighted=True)
    share, theta, codes = 0.6 * offsets, THETA[:4], data.codes
    C, K = group_covariance(data, theta, share)
    expected = []
    for g in range(6):
        out, w = codes == g, data.weights
        Q = contrasts(codes[~out]) if offsets else np.eye(np.sum(~out))
        inner = Q.T @ C[np.ix_(~out, ~out)] @ Q
        predicted = K[np.ix_(out, ~out)] @ Q @ np.linalg.solve(inner, Q.T @ data.Y[~out, 0])
        left = data.Y[out, 0] - predicted
        expected.append(w[out] @ (left - np.average(left, weights=w[out])) ** 2)
    given = data if offsets else data._replace(codes=None)
    found = group_errors(given, codes, "matern52", theta[:3], theta[3:], share)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_network_with_functions_of_the_groups_own_is_generalised_least_squares():
    data, share = some_data(q=1, weighted=True), 0.6
    data = data._replace(weights=data.weights / data.weights.mean())
    C, K = group_covariance(data, THETA[:4], share)
    merged = merge(data.X, data.Y, data.weights, codes=data.codes)
    functions = RadialFunctions("matern52", np.zeros(3), np.exp(THETA[:3]))
    problem, alpha = with_group_noise(prepare(merged, 0), np.exp(THETA[3:4]), functions, share)
    every = np.arange(40)
    path = fit_path(problem, every, alpha, functions)
    posterior = posterior_of(problem, path, every, alpha, functions)
    Q = contrasts(data.codes)
    inverse = np.linalg.inv(Q.T @ C @ Q)
    expected = K @ Q @ inverse @ Q.T @ data.Y[:, 0]
    found = posterior.predict(data.X)[0][:, 0]
    np.testing.assert_allclose(found - found.mean(), expected - expected.mean(), atol=1e-8)
    # The noise is that of a deviation from the group's mean.
    signal = data.Y[:, 0] @ Q @ inverse @ Q.T @ data.Y[:, 0] / len(inverse)
    root = np.sqrt(data.weights)
    centring = (
        np.eye(40)
        - np.equal.outer(data.codes, data.codes)
        * data.weights
        / (group_weights(data.codes, data.weights)[data.codes, None])
    )
    weighed = root[:, None] * (centring @ (C - K) @ centring.T) * root
    noise = signal * np.trace(weighed) / len(inverse)
    np.testing.assert_allclose(posterior.noise_variance, noise, rtol=1e-8)
    np.testing.assert_allclose(posterior.signal_variance, signal, rtol=1e-8)


def grouped_wave(n=120, n_groups=8, seed=0):
    """Positions have a range of x of their own, so that offsets hide most of the wave."""
    rng = np.random.default_rng(seed)
    groups = np.arange(n) % n_groups
    X = rng.uniform(-1, 1, (n, 2)) + 0.4 * groups[:, None]
    f = np.sin(X[:, 0]) + 0.3 * X[:, 1]
    y = centred(f + 0.02 * rng.standard_normal(n), groups)
    return X, y, groups, f


def test_full_network_is_the_posterior_of_the_differences():
    X, y, groups, _ = grouped_wave(60)
    model = RBFNetRegressor(60, length_scale=1.5, alpha=0.01, kernel="matern52")
    model.fit(X, y, groups=groups)
    assert model.offsets_
    mean, std = model.predict(X, return_std=True)
    Q = contrasts(groups)
    K = kernel_matrix(X / 1.5, X / 1.5, "matern52")
    C = Q.T @ (K + 0.01 * np.eye(60)) @ Q
    gain = K @ Q @ np.linalg.inv(C)
    expected = gain @ Q.T @ y
    np.testing.assert_allclose(mean, expected - expected.mean(), atol=1e-8)
    # The signal variance maximises the likelihood; deviations are from the mean of the function.
    signal = y @ Q @ np.linalg.solve(C, Q.T @ y) / Q.shape[1]
    np.testing.assert_allclose(model.signal_variance_, signal, rtol=1e-8)
    about = np.eye(60) - 1 / 60
    covariance = signal * about @ (K - gain @ Q.T @ K) @ about
    variance = covariance.diagonal() + 0.01 * signal * (1 + 1 / 60)
    np.testing.assert_allclose(std**2, variance, rtol=1e-6)


def test_differences_at_new_rows_are_found_better_than_without_groups():
    X, y, groups, _ = grouped_wave()
    X_new, _, of, f = grouped_wave(seed=1)
    truth = centred(f, of)

    def error(model):
        return np.sqrt(np.mean((centred(model.predict(X_new), of) - truth) ** 2))

    known = RBFNetRegressor().fit(X, y, groups=groups)
    unknown = RBFNetRegressor().fit(X, y)
    assert error(known) < 0.25 * error(unknown)
    assert error(known) < 0.1 * truth.std()
    np.testing.assert_allclose(known.predict(X).mean(), 0, atol=1e-10)


def test_neither_order_nor_names_nor_repeats_matter():
    X, y, groups, _ = grouped_wave()
    model = RBFNetRegressor().fit(X, y, groups=groups)
    rng = np.random.default_rng(0)
    order = rng.permutation(len(y))
    names = np.array(list("abcdefgh"))[groups]
    other = RBFNetRegressor().fit(X[order], y[order], groups=names[order])
    np.testing.assert_array_equal(model.predict(X), other.predict(X))
    times = rng.integers(0, 3, len(y))
    rows = np.repeat(np.arange(len(y)), times)
    y = centred(y, groups, times.astype(float))
    once = RBFNetRegressor().fit(X, y, sample_weight=times, groups=groups)
    often = RBFNetRegressor().fit(X[rows], y[rows], groups=groups[rows])
    np.testing.assert_allclose(once.predict(X), often.predict(X), rtol=1e-6, atol=1e-8)


def test_targets_known_in_full_have_no_offsets():
    X, _, groups, f = grouped_wave()
    known = RBFNetRegressor().fit(X, f)
    model = RBFNetRegressor().fit(X, f, groups=groups)
    assert not model.offsets_
    np.testing.assert_array_equal(model.predict(X), known.predict(X))


@pytest.mark.parametrize("ridge", ["auto", 0.001])
def test_linear_part_is_that_of_the_differences(ridge):
    X, _, groups, _ = grouped_wave()
    X = np.column_stack([X, groups])  # of what is constant in every group nothing can be learnt
    y = centred(X[:, 0] - 2 * X[:, 1], groups)
    model = RBFNetRegressor(3, degree=1, length_scale=1.0, alpha=ridge).fit(X, y, groups=groups)
    np.testing.assert_allclose(model.linear_coef_, [1, -2, 0], atol=1e-4)


def test_no_ridge_takes_no_more_centres_than_there_are_differences():
    X, y, groups, _ = grouped_wave(30)
    with pytest.warns(UserWarning, match="only 30"):
        model = RBFNetRegressor(40, length_scale=0.5, alpha=0.0).fit(X, y, groups=groups)
    assert len(model.centers_) <= 30 - 8
    np.testing.assert_allclose(centred(model.predict(X), groups), y, atol=1e-6)


def test_outliers_do_not_teach():
    X, _, groups, f = grouped_wave()
    bad = f.copy()
    bad[::20] += 5.0
    model = RBFNetRegressor(kernel="gaussian", loss="tukey")
    model.fit(X, centred(bad, groups), groups=groups)
    left = centred(model.predict(X) - f, groups)
    assert np.sqrt(np.mean(left**2)) < 0.05
    assert np.all(model.row_weight_[::20] < 0.1)


def test_groups_reach_the_network_through_a_chain():
    X, y, groups, _ = grouped_wave()
    Y = np.column_stack([y, 2 * y, -y])
    direct = make_pipeline(StandardScaler(), RBFNetRegressor(10))
    direct.fit(X, Y, rbfnetregressor__groups=groups)
    assert direct[-1].offsets_
    chain = CylindricalResidualTarget(
        make_pipeline(StandardScaler(), RBFNetRegressor(10)), azimuth=None
    )
    chain.fit(X, Y, rbfnetregressor__groups=groups)
    np.testing.assert_array_equal(chain.predict(X), direct.predict(X))
    with config_context(enable_metadata_routing=True):
        network = RBFNetRegressor(10).set_fit_request(groups=True)
        chain = CylindricalResidualTarget(make_pipeline(StandardScaler(), network), azimuth=None)
        chain.fit(X, Y, groups=groups)
        np.testing.assert_array_equal(chain.predict(X), direct.predict(X))


def test_groups_that_cannot_be(monkeypatch):
    X, y, groups, _ = grouped_wave()
    with pytest.raises(ValueError, match="groups names 119 samples, but there are 120"):
        RBFNetRegressor().fit(X, y, groups=groups[1:])
    monkeypatch.setattr(_read, "IN_MEMORY_ROWS", 100)
    with pytest.raises(ValueError, match="at most 100 rows"):
        RBFNetRegressor().fit(X, y, groups=groups)


def test_a_function_of_each_groups_own_is_not_carried_to_others(monkeypatch):
    monkeypatch.setattr(_group_search, "MARGIN", 0.0)  # 12 groups are few to be sure of it
    rng = np.random.default_rng(5)
    groups = np.repeat(np.arange(24), 25)
    X = rng.uniform(-1, 1, (600, 1))
    # Functions of the same prior: one that all groups share, and a smaller one for each.
    waves = np.sin(X @ rng.normal(0, 3, (1, 40)) + rng.uniform(0, 2 * np.pi, 40)) / np.sqrt(20)
    shared, own = waves @ rng.normal(size=40), waves * rng.normal(size=(24, 40))[groups]
    y = centred(shared + 0.7 * own.sum(axis=1) + 0.05 * rng.normal(size=600), groups)
    learn, of = groups < 12, groups[groups >= 12]
    within = np.eye(len(of)) - np.equal.outer(of, of) / 25

    def judge(model):
        """Error of the shared function, the same in deviations, and coverage of the targets."""
        found, covariance = model.predict(X[~learn], return_cov=True, with_noise=False)
        error = centred(shared[~learn] - found, of)
        ratio = error / np.sqrt(np.diag(within @ covariance @ within))
        covariance = model.predict(X[~learn], return_cov=True)[1]
        left = np.abs(centred(y[~learn] - found, of))
        inside = left < 1.96 * np.sqrt(np.diag(within @ covariance @ within))
        return error.std(), np.sqrt(np.mean(ratio**2)), inside.mean()

    told = RBFNetRegressor().fit(X[learn], y[learn], groups=groups[learn])
    assert told.offsets_
    assert told.group_share_ > 0.9
    unknown = judge(RBFNetRegressor().fit(X[learn], y[learn]))
    error, ratio, inside = judge(told)
    assert error < 0.85 * unknown[0]
    assert unknown[1] > 1.5  # too sure of what it takes for 300 independent rows
    assert 0.6 < ratio < 1.3
    assert 0.93 < inside < 0.97


def test_groups_that_tell_nothing_are_as_if_not_given():
    rng = np.random.default_rng(0)
    half = rng.uniform(-1, 1, (60, 2))
    X, groups = np.vstack([half, -half]), np.tile(np.arange(60) % 10, 2)
    y = np.sin(3 * X[:, 0]) + 0.3 * centred(rng.standard_normal(120), groups)  # odd: no offsets
    model = RBFNetRegressor().fit(X, y, groups=groups)
    assert not model.offsets_
    assert model.group_share_ == 0
    expected = RBFNetRegressor().fit(X, y)
    np.testing.assert_allclose(model.predict(X), expected.predict(X), atol=1e-9)
    found, known = (m.log_marginal_likelihood_value_ for m in (model, expected))
    np.testing.assert_allclose(found, known, rtol=1e-6)
