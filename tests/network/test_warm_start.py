"""A refit that starts from the last one: where it may, and where it must not."""

import numpy as np
import pytest

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import _width_objective


def waves(n, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-2, 2, (n, 3))
    f = np.sin(3 * X[:, 0]) + np.cos(2 * X[:, 1])
    return X, f + 0.1 * rng.standard_normal(n), f


def error(model, T, f):
    return np.sqrt(np.mean((model.predict(T).ravel() - f) ** 2))


@pytest.fixture
def evaluations(monkeypatch):
    """Rows of every likelihood that is computed."""
    seen, exact = [], _width_objective.exact_likelihood
    monkeypatch.setattr(
        _width_objective,
        "exact_likelihood",
        lambda data, *args: seen.append(len(data.X)) or exact(data, *args),
    )
    return seen


@pytest.mark.parametrize("given", [{}, {"alpha": 0.02}, {"length_scale": [0.7, 0.9, 5.0]}])
def test_a_few_rows_more_cost_little(evaluations, given):
    X, y, _ = waves(303)
    T, _, f = waves(1000, seed=1)
    warm = RBFNetRegressor(warm_start=True, random_state=0, **given).fit(X[:300], y[:300])
    before, n_cold = warm.posterior_, len(evaluations)
    evaluations.clear()
    warm.fit(X, y)
    assert len(evaluations) < 0.2 * n_cold or given
    assert warm.kernel_ == before.kernel
    np.testing.assert_array_equal(warm.length_scale_, before.length_scale)
    cold = RBFNetRegressor(random_state=0, **given).fit(X, y)
    assert error(warm, T, f) < 1.03 * error(cold, T, f)
    # The ridge is that of the last fit, the noise variance that of these rows.
    assert warm.noise_variance_ == pytest.approx(cold.noise_variance_, rel=0.1)
    assert warm.log_marginal_likelihood_value_ == pytest.approx(
        cold.log_marginal_likelihood_value_, abs=3
    )


def test_rows_from_where_there_were_none_become_centres():
    X, y, f = waves(400)
    left = X[:, 0] < 0.5
    warm = RBFNetRegressor(warm_start=True, random_state=0).fit(X[left], y[left])
    poor = error(warm, X[~left], f[~left])
    warm.fit(X, y)
    assert error(warm, X[~left], f[~left]) < 0.2 * poor
    assert np.sum(warm.centers_[:, 0] > 0.5) > 5


def test_other_data_are_searched_anew():
    X, y, _ = waves(80)
    warm = RBFNetRegressor(warm_start=True, random_state=0).fit(X, y)
    Z = np.random.default_rng(2).uniform(-2, 2, (80, 3))
    other = np.sin(8 * Z[:, 2]) + 0.01 * Z[:, 0]
    cold = RBFNetRegressor(random_state=0).fit(Z, other)
    np.testing.assert_array_equal(warm.fit(Z, other).predict(X), cold.predict(X))
    # Other numbers of features or outputs, and noise in which nothing was found before.
    for A, b in (
        (Z[:, 1:], other),
        (Z, np.column_stack([other, -other])),
        (Z, np.random.default_rng(3).standard_normal(80)),
        (Z, other),
    ):
        cold = RBFNetRegressor(random_state=0).fit(A, b)
        np.testing.assert_allclose(warm.fit(A, b).predict(A), cold.predict(A), atol=1e-12)


def test_parameters_may_change_between_fits():
    X, y, _ = waves(150)
    warm = RBFNetRegressor(warm_start=True, kernel="gaussian", random_state=0).fit(X, y)
    assert warm.set_params(kernel="matern52").fit(X, y).kernel_ == "matern52"
    warm.set_params(length_scale="isotropic").fit(X, y)
    assert np.ptp(warm.length_scale_ / X.std(axis=0)) < 1e-3
    # More centres than there are candidates near the last ones: all rows are candidates again.
    assert len(warm.set_params(n_centers=140, alpha=1.0).fit(X, y).centers_) == 140


def test_every_row_may_be_a_centre_already():
    """There was no row left to add, which ended in an error of NumPy."""
    X = np.random.default_rng(0).uniform(-1, 1, (12, 2))
    y = np.sin(3 * X[:, 0])
    model = RBFNetRegressor(12, length_scale=1.0, alpha=1e-3, warm_start=True).fit(X, y)
    assert len(model.centers_) == 12
    first = model.predict(X)
    np.testing.assert_allclose(model.fit(X, y).predict(X), first, atol=1e-9)
