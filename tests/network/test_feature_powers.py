"""Features that span powers of ten: when a network sees them through a power, and which."""

import numpy as np
import pytest
from scipy.linalg import LinAlgError
from scipy.stats import boxcox, yeojohnson
from sklearn.exceptions import ConvergenceWarning
from sklearn.preprocessing import PowerTransformer

from sklearn_raacmm import PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.network import _rbf_net, _width_search
from sklearn_raacmm.network._feature_powers import likely_powers
from sklearn_raacmm.network._training_data import merge, prepare


def spanning(n, seed=0):
    """A feature of three powers of ten, counts, and one that is uniform; the function of them."""
    rng = np.random.default_rng(seed)
    counts = np.floor(np.exp(1.2 * rng.standard_normal(n)))
    X = np.column_stack([np.exp(1.5 * rng.standard_normal(n)), rng.uniform(-1, 1, n), counts])
    f = np.sin(1.5 * np.log(X[:, 0])) + X[:, 1] ** 2 + np.log1p(X[:, 2])
    return X, f + 0.05 * rng.standard_normal(n), f


def problem_of(X, weights=None):
    weights = np.ones(len(X)) if weights is None else weights
    return prepare(merge(X, np.zeros((len(X), 1)), weights), 0)


def powers_of(X, weights=None):
    return likely_powers(RBFNetRegressor(), problem_of(X, weights))


@pytest.fixture(scope="module")
def fitted():
    X, y, _ = spanning(150)
    return RBFNetRegressor(random_state=0).fit(X, y)


def test_a_function_of_logarithms_is_found(fitted):
    X, y, _ = spanning(150)
    T, _, f = spanning(500, seed=1)
    plain = RBFNetRegressor(power_transform=None, random_state=0).fit(X, y)
    assert np.std(fitted.predict(T) - f) < 0.4 * np.std(plain.predict(T) - f)
    assert fitted.log_marginal_likelihood_value_ > plain.log_marginal_likelihood_value_ + 10
    assert fitted.lambdas_[0] == pytest.approx(0, abs=0.1)
    assert fitted.lambdas_[1] == 1
    assert 0 <= fitted.lambdas_[2] < 1
    np.testing.assert_array_equal(plain.lambdas_, np.ones(3))
    np.testing.assert_allclose(fitted.centers_, X[fitted.center_indices_], rtol=1e-12, atol=1e-13)
    # It is the network of these powers.
    own = RBFNetRegressor(power_transform=None, random_state=0)
    own.fit(fitted.powers_.transform(X), y)
    np.testing.assert_array_equal(own.predict(fitted.powers_.transform(T)), fitted.predict(T))


def test_exponents_are_those_of_scikit_learn(fitted):
    X, _, _ = spanning(150)
    powers = fitted.powers_
    Z, unit = powers.transform(X), powers.unit
    for j, method in ((0, "box-cox"), (2, "yeo-johnson")):
        u = X[:, [j]] / unit[j]
        other = PowerTransformer(method).fit(u).lambdas_[0]
        assert powers.lambdas[j] == pytest.approx(np.clip(other, 0, 1), abs=0.0051)
    seen = unit[0] * (1 + boxcox(X[:, 0] / unit[0], powers.lambdas[0]))
    np.testing.assert_allclose(Z[:, 0], seen, rtol=1e-12)
    seen = unit[2] * yeojohnson(X[:, 2] / unit[2], powers.lambdas[2])
    np.testing.assert_allclose(Z[:, 2], seen, rtol=1e-12)
    np.testing.assert_array_equal(Z[:, 1], X[:, 1])


def test_units_do_not_matter(fitted):
    X, y, _ = spanning(150)
    T, _, _ = spanning(50, seed=1)
    unit = np.array([1000.0, 25.4, 1e-3])
    other = RBFNetRegressor(random_state=0).fit(unit * X, 1000 * y)
    np.testing.assert_array_equal(other.lambdas_, fitted.lambdas_)
    # Widths are found to four digits.
    np.testing.assert_allclose(other.predict(unit * T) / 1000, fitted.predict(T), atol=1e-4)


def test_weights_are_repeats():
    X, _, _ = spanning(60)
    times = np.random.default_rng(0).integers(0, 4, 60)
    repeated, weighted = powers_of(np.repeat(X, times, axis=0)), powers_of(X, times.astype(float))
    for name in ("lambdas", "unit", "start", "low"):
        np.testing.assert_array_equal(getattr(repeated, name), getattr(weighted, name))


def test_ordinary_features_are_not_looked_at():
    rng = np.random.default_rng(0)
    angles = rng.uniform(-np.pi, np.pi, (400, 3))
    bounded = [
        angles,
        np.abs(angles),
        np.cos(angles / 4),
        np.sin(angles),
        rng.normal(5, 1, (400, 3)),
    ]
    years = 1990 + rng.exponential(5, (400, 1))  # lopsided, but of any power all but straight
    marks = (rng.uniform(size=(400, 2)) < 0.1).astype(float)
    X = np.hstack([*bounded, years, marks, -rng.exponential(5, (400, 1)), np.ones((400, 1))])
    assert powers_of(X) is None
    data = make_single_point(n_positions=10, n_poses=20, random_state=0)
    assert powers_of(PoseFeatures(data.arm).fit_transform(data.data)) is None
    assert powers_of(rng.exponential(5, (400, 1))) is not None


def test_functions_of_the_features_themselves_keep_them():
    rng = np.random.default_rng(0)
    X = np.exp(1.5 * rng.standard_normal((150, 3)))
    y = X[:, 0] - 0.5 * X[:, 1] + 0.2 * X[:, 0].std() * rng.standard_normal(150)
    assert powers_of(X) is not None
    auto, plain = (RBFNetRegressor(power_transform=p, random_state=0) for p in ("auto", None))
    np.testing.assert_array_equal(auto.fit(X, y).predict(X), plain.fit(X, y).predict(X))
    np.testing.assert_array_equal(auto.lambdas_, np.ones(3))


@pytest.mark.parametrize(
    "given",
    [{"length_scale": 1.0}, {"degree": 1}, {"selection": "newrb", "n_centers": 5}],
    ids=lambda given: next(iter(given)),
)
def test_where_widths_are_given_or_likelihoods_cannot_be_compared(given):
    X, y, _ = spanning(60)
    model = RBFNetRegressor(random_state=0, **given).fit(X, y)
    np.testing.assert_array_equal(model.lambdas_, np.ones(3))


@pytest.mark.parametrize("of_variance", [False, True])
def test_gradient_is_that_of_differences(fitted, of_variance):
    T, _, _ = spanning(20, seed=2)
    T[0], T[1, 0] = [-2.0, 0.5, -3.0], 0.3 * spanning(150)[0][:, 0].min()  # below all rows
    step = 1e-5 * np.maximum(np.abs(T), 0.1)

    def value(X):
        if of_variance:
            return fitted.predict(X, return_std=True)[1] ** 2
        return fitted.predict(X)

    found = fitted.predict_gradient(T, return_variance=True)[int(of_variance)]
    for j in range(3):
        h = step[:, j, None] * np.eye(3)[j]
        differences = (value(T + h) - value(T - h)) / (2 * step[:, j])
        np.testing.assert_allclose(found[:, j], differences, rtol=1e-4, atol=1e-5)


def test_far_from_the_rows_it_is_the_prior(fitted):
    T = np.array([[1e49, 0, 0], [-1e49, 0, 0], [1, 0, -1e49], [0.5, 1e49, 1e49]])
    mean, std = fitted.predict(T, return_std=True, with_noise=False)
    np.testing.assert_allclose(std, np.sqrt(fitted.signal_variance_), rtol=0.2)  # and the mean's
    np.testing.assert_allclose(mean, fitted.intercept_, atol=1e-6)
    gradient = fitted.predict_gradient(T)
    assert np.all(np.isfinite(gradient))
    # Smoothly from the last row through 0 to numbers for which there is no power.
    z = fitted.powers_.transform(np.column_stack([np.linspace(-1, 1, 2001), *np.zeros((2, 2001))]))
    assert np.all(np.diff(z[:, 0]) > 0)


def test_a_refit_keeps_them_while_they_are_right():
    X, y, _ = spanning(206)
    warm = RBFNetRegressor(warm_start=True, random_state=0).fit(X[:200], y[:200])
    before = warm.powers_
    warm.fit(X, y)
    assert warm.powers_ is before
    cold = RBFNetRegressor(random_state=0).fit(X, y)
    T, _, f = spanning(500, seed=1)
    assert np.std(warm.predict(T) - f) < 1.03 * np.std(cold.predict(T) - f)
    # Other targets, which want the features as they are.
    y = X[:, 0] + X[:, 2] + np.random.default_rng(0).standard_normal(206)
    warm.fit(X, y)
    np.testing.assert_array_equal(warm.lambdas_, np.ones(3))
    cold.fit(X, y)
    np.testing.assert_allclose(warm.predict(T), cold.predict(T), atol=0.2 * y.std())


def test_outliers_do_not_hide_them():
    X, y, f = spanning(120)
    y[::10] += 20
    model = RBFNetRegressor(random_state=0).fit(X, y)
    np.testing.assert_array_equal(model.lambdas_, np.ones(3))
    model.set_params(loss="tukey").fit(X, y)
    assert model.lambdas_[0] < 0.5
    assert np.all(model.row_weight_[::10] == 0)
    assert np.std(model.predict(X) - f) < 0.1


def test_labels_that_say_nothing_change_nothing():
    X, y, _ = spanning(120)
    y -= y.mean()
    rank = np.argsort(np.argsort(y))
    pairs = np.minimum(rank, 119 - rank)  # a low and a high target: their means are all 0
    plain, grouped = (RBFNetRegressor(random_state=0).fit(X, y, groups=g) for g in (None, pairs))
    assert not grouped.offsets_
    assert plain.powers_.changed.size
    np.testing.assert_array_equal(grouped.predict(X), plain.predict(X))


def test_only_the_search_that_wins_warns(monkeypatch):
    X, y, _ = spanning(150)
    monkeypatch.setattr("sklearn_raacmm.network._width_objective.WIDTH_BOUNDS", (0.3, 1e3))
    monkeypatch.setattr(_width_search, "WIDTH_BOUNDS", (0.3, 1e3))
    plain = RBFNetRegressor(power_transform=None, random_state=0)
    with pytest.warns(ConvergenceWarning, match="ended at its lower bound"):
        plain.fit(X, y)
    RBFNetRegressor(random_state=0).fit(X, y)  # warnings are errors
    monkeypatch.setattr("sklearn_raacmm.network._width_objective.WIDTH_BOUNDS", (0.8, 1e3))
    monkeypatch.setattr(_width_search, "WIDTH_BOUNDS", (0.8, 1e3))
    X = np.sort(np.random.default_rng(0).exponential(1, (200, 1)), axis=0)
    with pytest.warns(ConvergenceWarning, match="ended at its lower bound") as said:
        RBFNetRegressor(random_state=0).fit(X, np.sin(12 * X[:, 0]))
    assert said[0].filename == __file__  # the line of the call


def test_powers_of_which_no_kernel_can_be_made_are_no_candidate(monkeypatch):
    X, y, _ = spanning(60)
    search, calls = _rbf_net.tuned_groups, []

    def fails_at_the_second(problem, **options):
        calls.append(problem)
        if len(calls) == 2:
            raise LinAlgError("not positive definite")
        return search(problem, **options)

    monkeypatch.setattr(_rbf_net, "tuned_groups", fails_at_the_second)
    model = RBFNetRegressor(random_state=0).fit(X, y)
    assert len(calls) == 2
    np.testing.assert_array_equal(model.lambdas_, np.ones(3))


def test_a_generator_is_left_as_one_search_leaves_it():
    rng = np.random.default_rng(0)
    X = np.exp(1.5 * rng.standard_normal((400, 1)))
    y = X[:, 0] + 0.1 * rng.standard_normal(400)
    states = []
    for power_transform in ("auto", None):
        rng = np.random.RandomState(0)
        RBFNetRegressor(power_transform=power_transform, random_state=rng).fit(X, y)
        states.append(rng.get_state()[1])
    np.testing.assert_array_equal(*states)
