"""RBFNetRegressor against Gaussian processes, closed forms and its own promises."""

import numpy as np
import pytest
from scipy.stats import norm
from sklearn.base import clone
from sklearn.datasets import make_friedman1
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel
from sklearn.kernel_ridge import KernelRidge

from sklearn_raacmm import RBFNetRegressor

from ._data import smooth


@pytest.mark.parametrize(
    ("name", "reference"),
    [
        ("gaussian", RBF(0.9)),
        ("matern52", Matern(0.9, nu=2.5)),
        ("matern32", Matern(0.9, nu=1.5)),
        ("matern12", Matern(0.9, nu=0.5)),
    ],
)
def test_kernels_are_those_of_scikit_learn(name, reference):
    X, y, _ = smooth(40)
    model = RBFNetRegressor(40, kernel=name, length_scale=0.9, alpha=0.2, degree=-1).fit(X, y)
    ridge = KernelRidge(alpha=0.2, kernel=reference).fit(X, y)
    np.testing.assert_allclose(model.predict(X), ridge.predict(X), atol=1e-8)


@pytest.mark.filterwarnings("ignore:The optimal value found:sklearn.exceptions.ConvergenceWarning")
def test_defaults_are_as_accurate_as_a_gaussian_process():
    X, f = make_friedman1(700, random_state=0)
    rng = np.random.default_rng(0)
    y = f[:300] + rng.standard_normal(300)
    scale = X.std(axis=0)
    kernel = ConstantKernel() * RBF(np.ones(10), (1e-2, 1e3)) + WhiteKernel(0.1)
    process = GaussianProcessRegressor(kernel, normalize_y=True).fit(X[:300] / scale, y)
    model = RBFNetRegressor(random_state=0).fit(X[:300], y)
    error = np.sqrt(np.mean((model.predict(X[300:]) - f[300:]) ** 2))
    error_ref = np.sqrt(np.mean((process.predict(X[300:] / scale) - f[300:]) ** 2))
    assert error < 1.05 * error_ref
    assert len(model.centers_) < 100
    # Five of the ten features have no effect: their widths say so.
    assert model.length_scale_[5:].min() > 5 * model.length_scale_[:3].max()


def test_intervals_cover_what_they_claim():
    X, y, _ = smooth(400, noise=0.2)
    T, t, _ = smooth(2000, seed=1, noise=0.2)
    model = RBFNetRegressor(random_state=0).fit(X, y)
    mean, std = model.predict(T, return_std=True)
    for level in (0.5, 0.9, 0.99):
        covered = np.mean(np.abs(t - mean) < norm.ppf(0.5 + level / 2) * std)
        # Five standard errors of a share of 2000, and the noise variance known to 7 %.
        assert covered == pytest.approx(level, abs=0.05 * (1 - level) + 0.055 * level)
    # Far away nothing is known but the signal's own variance; an unknown constant adds to it.
    far = np.array([[400.0, 400.0]])
    prior = np.sqrt(model.signal_variance_ + model.noise_variance_)
    assert model.predict(far, return_std=True)[1][0] > prior
    plain = RBFNetRegressor(degree=-1, random_state=0).fit(X, y)
    prior = np.sqrt(plain.signal_variance_ + plain.noise_variance_)
    assert plain.predict(far, return_std=True)[1][0] == pytest.approx(prior)


def test_given_widths_and_ridge_are_respected():
    X, y, _ = smooth(80)
    model = RBFNetRegressor(length_scale=[0.5, 0.9], alpha=0.01).fit(X, y)
    np.testing.assert_array_equal(model.length_scale_, [0.5, 0.9])
    assert model.alpha_ == 0.01
    model = RBFNetRegressor(length_scale=[0.5, 0.9]).fit(X, y)
    np.testing.assert_array_equal(model.length_scale_, [0.5, 0.9])
    assert RBFNetRegressor(alpha=0.02).fit(X, y).alpha_ == 0.02
    Y = np.column_stack([y, -y])
    np.testing.assert_array_equal(RBFNetRegressor(alpha=[0.02, 1]).fit(X, Y).alpha_, [0.02, 1])
    # As a search over np.arange gives it.
    model = RBFNetRegressor(np.int64(5), length_scale=0.8, alpha=0.01).fit(X, y)
    assert len(model.centers_) == 5


@pytest.mark.parametrize("share", [0.5, 0.1, 0.03])
def test_a_share_is_what_the_centres_leave_of_the_variance(share):
    X, y, _ = smooth(300)
    Y = np.column_stack([y, 1e3 * np.cos(3 * X[:, 1])])
    for shared, y_of in ((True, Y), (False, Y), (False, y)):
        model = RBFNetRegressor(share, length_scale=0.8, alpha=1e-3, shared=shared).fit(X, y_of)
        left = np.mean((y_of - model.predict(X)) ** 2, axis=0)
        # Of outputs that share centres the trace counts: those with large numbers most.
        assert np.sum(left) <= share * np.sum(np.var(y_of, axis=0))
        if not shared:
            assert np.all(left <= share * np.var(y_of, axis=0))
        k = [len(network.centers) for network in model.networks_]
        if min(k) > 1 and y_of.ndim == 1:
            fewer = RBFNetRegressor(k[0] - 1, length_scale=0.8, alpha=1e-3).fit(X, y)
            assert np.mean((y - fewer.predict(X)) ** 2) > share * np.var(y)


def test_what_is_left_out_costs_little_beside_the_noise():
    X, y, _ = smooth(300)
    model = RBFNetRegressor(length_scale=0.8, alpha=0.01).fit(X, y)
    everywhere = RBFNetRegressor(300, length_scale=0.8, alpha=0.01).fit(X, y)
    lost = np.sum((model.predict(X) - everywhere.predict(X)) ** 2)
    K = RBF(0.8)(X)
    dof = np.trace(np.linalg.solve(K + 0.01 * np.eye(300), K))
    assert 0 < lost <= 0.02 * everywhere.noise_variance_ * dof * 1.02


@pytest.mark.parametrize("seed", range(5))
def test_a_ridge_bounds_predictions_everywhere(seed):
    # The objective is no larger than with all weights 0, so that c'Kc <= |y|^2 / alpha, and by
    # Cauchy and Schwarz |f(x)|^2 <= c'Kc. The second output, without noise, wants widths and
    # centres that the first one's weights must not follow into directions the kernel cannot tell.
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((150, 2)) * [1, 10]
    Y = np.column_stack([rng.standard_normal(150), X[:, 0]])
    model = RBFNetRegressor(degree=0, random_state=0).fit(X, Y)
    bound = np.sqrt(np.square(Y - Y.mean(axis=0)).sum(axis=0) / model.alpha_)
    away = np.abs(model.predict(X * 1.5 + 3 * X.std(axis=0)) - model.intercept_)
    assert np.all(away < bound)


def test_feature_that_never_varied_is_ignored():
    X, y, _ = smooth(100)
    still = np.column_stack([X, np.full(100, 3.0)])
    model = RBFNetRegressor(random_state=0).fit(still, y)
    assert model.length_scale_[2] == np.inf
    moved = np.column_stack([X, np.linspace(-5, 5, 100)])
    np.testing.assert_array_equal(model.predict(moved), model.predict(still))
    np.testing.assert_allclose(
        model.predict(still), RBFNetRegressor(random_state=0).fit(X, y).predict(X), atol=1e-6
    )
    # Widths that were found can be given, infinite ones, too.
    again = clone(model).set_params(length_scale=model.length_scale_).fit(moved, y)
    np.testing.assert_array_equal(again.length_scale_, model.length_scale_)
    np.testing.assert_allclose(again.predict(moved), model.predict(moved), atol=0.01)


def test_nearly_noise_free_data_are_fitted_down_to_their_noise():
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (700, 3))
    f = np.sin(3 * X[:, 0]) + X[:, 1] ** 2 + 0.5 * X[:, 0] * X[:, 2]
    y = f + 1e-4 * rng.standard_normal(700)
    model = RBFNetRegressor(random_state=0).fit(X[:500], y[:500])
    assert np.sqrt(np.mean((model.predict(X[500:]) - f[500:]) ** 2)) < 1e-4
    assert np.sqrt(model.noise_variance_) == pytest.approx(1e-4, rel=0.3)


@pytest.mark.parametrize("what", ["twice", "drawn with replacement"])
def test_a_row_that_is_there_twice_does_not_show_that_there_is_no_noise(what):
    X, y, f = smooth(200, seed=4, noise=0.2)
    rng = np.random.default_rng(0)
    rows = np.tile(np.arange(200), 2) if what == "twice" else rng.integers(0, 200, 200)
    model = RBFNetRegressor(random_state=0).fit(X[rows], y[rows])
    assert np.sqrt(model.noise_variance_) == pytest.approx(0.2, rel=0.2)
    assert np.sqrt(np.mean((model.predict(X) - f) ** 2)) < 0.1


def test_replicates_that_differ_show_the_noise():
    # Five measurements at each of 15 places: the variance within places is an estimate of its own.
    X, _, f = smooth(15, seed=5)
    X, f = np.repeat(X, 5, axis=0), np.repeat(f, 5)
    y = f + 0.3 * np.random.default_rng(0).standard_normal(75)
    within = y.reshape(15, 5).var(axis=1, ddof=1).mean()
    model = RBFNetRegressor(random_state=0).fit(X, y)
    assert model.noise_variance_ == pytest.approx(within, rel=0.3)


def test_more_centres_than_candidates_takes_all_and_says_so():
    X, y, _ = smooth(30)
    with pytest.warns(
        UserWarning, match="n_centers=31, but there are only 30 distinct candidate"
    ) as caught:
        model = RBFNetRegressor(31, length_scale=0.5, alpha=0.1).fit(X, y)
    assert caught[0].filename == __file__  # the line of the call
    every = RBFNetRegressor(30, length_scale=0.5, alpha=0.1).fit(X, y)
    np.testing.assert_array_equal(model.predict(X), every.predict(X))


@pytest.mark.parametrize(("name", "units"), [("X", (1e-200, 1)), ("y", (1, 1e-200))])
def test_numbers_whose_squares_underflow_are_refused(name, units):
    X, y, _ = smooth(30)
    with pytest.raises(ValueError, match=f"{name} holds a column of numbers no larger than"):
        RBFNetRegressor().fit(X * units[0], y * units[1])
    # Small ones are not.
    model = RBFNetRegressor().fit(X * units[0] ** 0.4, y * units[1] ** 0.4)
    assert model.score(X * units[0] ** 0.4, y * units[1] ** 0.4) > 0.9


def test_log_likelihood_is_that_of_scikit_learns_process():
    X, y, _ = smooth(80)
    y = 1000 * y
    model = RBFNetRegressor(kernel="matern52", degree=-1, random_state=0).fit(X, y)
    K = Matern(model.length_scale_, nu=2.5)(X) + model.alpha_ * np.eye(80)
    signal = y @ np.linalg.solve(K, y) / 80
    kernel = ConstantKernel(signal, (1e-9, 1e12)) * Matern(model.length_scale_, nu=2.5)
    kernel += WhiteKernel(signal * model.alpha_, (1e-9, 1e12))
    process = GaussianProcessRegressor(kernel, optimizer=None, alpha=0).fit(X, y)
    assert model.log_marginal_likelihood_value_ == pytest.approx(
        process.log_marginal_likelihood_value_, abs=1e-3
    )
    model.set_params(length_scale=1.0, alpha=0.1).fit(X, y)
    assert not hasattr(model, "log_marginal_likelihood_value_")
