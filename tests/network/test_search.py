"""The search of kernel, widths and ridge: what it has to find, and what it must not."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import approx_fprime
from sklearn.linear_model import RidgeCV

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network._kernels import KERNELS
from sklearn_raacmm.network._likelihood import Task, minimise, objective
from sklearn_raacmm.network._rows import Rows

from ._data import smooth


def data_of(X, y):
    Y = np.reshape(y - np.mean(y, axis=0), (len(X), -1))
    return Rows(X, Y / Y.std(axis=0), np.ones(len(X))).merged()


def task_of(data, **changes):
    spread = data.X.std(axis=0)
    return Task(spread, changes.pop("used", spread > 0), data.Y.shape[1], **changes)


@pytest.mark.parametrize("constants", [False, True])
@pytest.mark.parametrize("isotropic", [False, True])
@pytest.mark.parametrize("name", sorted(KERNELS))
def test_gradient_of_the_objective(name, isotropic, constants):
    X, y, _ = smooth(40)
    data = data_of(np.column_stack([X, X[:, 0] ** 3]), np.column_stack([y, y**2]))
    theta = np.append([0.3] if isotropic else [0.3, 1.0], [-2.0, -3.0])
    changes = {"isotropic": isotropic}
    changes["used"] = np.ones(3, dtype=bool) if isotropic else np.array([True, False, True])
    if constants:
        data = data._replace(codes=np.sort(np.arange(40) % 8))
        changes |= {"constants": True}
        theta = np.append(theta, -0.5)
    task = task_of(data, **changes)
    _, gradient = objective(task, theta, data, name)
    numeric = approx_fprime(theta, lambda t: objective(task, t, data, name)[0], 1e-7)
    np.testing.assert_allclose(gradient, numeric, rtol=5e-4, atol=1e-4)


@pytest.mark.parametrize("isotropic", [False, True])
@pytest.mark.parametrize("name", sorted(KERNELS))
def test_never_ends_worse_than_it_started(name, isotropic):
    X, y, f = smooth(400)
    data = data_of(X, y)
    task = task_of(data, isotropic=isotropic)
    start = task.start(0.5, 0.1)
    end = minimise(task, start, data, name, 5)
    values = [objective(task, theta, data, name)[0] for theta in (end, start)]
    assert values[0] <= values[1]
    length_scale = "isotropic" if isotropic else "auto"
    model = RBFNetRegressor(kernel=name, length_scale=length_scale, random_state=0).fit(X, y)
    if isotropic:
        ratio = model.length_scale_ / X.std(axis=0)
        assert ratio[0] == pytest.approx(ratio[1])
    # Noise 0.1, and a few dozen parameters from 400 rows; exp(-r) is rougher than this function.
    most = 0.09 if name == "matern12" else 0.05
    assert np.sqrt(np.mean((model.predict(X) - f) ** 2)) < most


@pytest.mark.parametrize(("n", "d"), [(60, 20), (120, 50), (120, 100), (200, 30)])
def test_pure_noise_in_many_features_is_noise(n, d):
    inside, r2 = [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        X, y = rng.standard_normal((n, d)), rng.standard_normal(n)
        X_new, new = rng.standard_normal((500, d)), rng.standard_normal(500)
        mean, std = RBFNetRegressor(random_state=0).fit(X, y).predict(X_new, return_std=True)
        inside.append(np.mean(np.abs(new - mean) < 1.96 * std))
        r2.append(1 - np.mean((new - mean) ** 2) / new.var())
    # Of 1500 intervals; the noise of 60 rows is known to 9 % only.
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)
    assert np.mean(r2) > -0.05


def test_a_weak_signal_in_many_features_is_found():
    rng = np.random.default_rng(0)
    X = rng.standard_normal((300, 20))
    y = 0.6 * np.sin(2 * X[:, 3]) + 0.6 * X[:, 7] + rng.standard_normal(300)
    model = RBFNetRegressor(random_state=0).fit(X, y)
    T = rng.standard_normal((500, 20))
    error = model.predict(T) - 0.6 * np.sin(2 * T[:, 3]) - 0.6 * T[:, 7]
    assert np.sqrt(np.mean(error**2)) < 0.5 * np.sqrt(0.18 + 0.36)
    assert np.all(np.isfinite(model.length_scale_[[3, 7]]))


@pytest.mark.parametrize(
    ("kernel", "rough"), [("matern32", True), ("gaussian", False)], ids=["rough", "smooth"]
)
def test_auto_takes_the_kernel_the_data_come_from(kernel, rough):
    rng = np.random.default_rng(0)
    X = np.sort(rng.uniform(-3, 3, (250, 1)), axis=0)
    f = np.abs(X[:, 0]) - 2 * np.abs(np.sin(3 * X[:, 0])) if rough else np.sin(2 * X[:, 0])
    y = f + 0.02 * rng.standard_normal(250)
    model = RBFNetRegressor(random_state=0).fit(X, y)
    assert (model.kernel_ == "gaussian") is not rough
    given = RBFNetRegressor(kernel=model.kernel_, random_state=0).fit(X, y)
    np.testing.assert_allclose(given.predict(X), model.predict(X), atol=0.02)


@pytest.mark.parametrize("far", [1e7, 1e12])
def test_numbers_too_far_from_all_others_are_refused(far):
    rng = np.random.default_rng(0)
    X = rng.standard_normal((100, 8))
    y = np.sin(X[:, 0])
    X[:2] = far
    with pytest.raises(
        ValueError, match=rf"Feature 0 has numbers from -\d.* to {far:g}".replace("+", "\\+")
    ):
        RBFNetRegressor().fit(X, y)
    # The largest that is let through: distances of the others are right to a hundredth of a spread.
    X[:2] = 1e6
    model = RBFNetRegressor(random_state=0).fit(X, y)
    assert np.mean(np.square(model.predict(X[2:]) - y[2:])) < 0.01 * y.var()


def test_where_no_noise_is_left_rows_left_out_say_whether_it_is_linear():
    """Twenty features of heavy tails and a nearly linear target, which radial functions follow."""
    rng = np.random.default_rng(0)
    X = rng.standard_t(1.5, (213, 20))
    y = X @ rng.standard_normal(20)
    y += 1e-3 * np.abs(y) * rng.standard_normal(213)
    model = RBFNetRegressor(random_state=0).fit(X[:160], y[:160])
    left = y[160:] - model.predict(X[160:])
    peer = y[160:] - RidgeCV(np.logspace(-6, 3, 10)).fit(X[:160], y[:160]).predict(X[160:])
    assert np.mean(left**2) < 1.5 * np.mean(peer**2)


def test_of_targets_without_noise_features_that_say_nothing_are_left_out():
    rng = np.random.default_rng(0)
    X, new = rng.normal(size=(80, 8)), rng.normal(size=(200, 8))
    model = RBFNetRegressor(random_state=0).fit(X, X[:, 2] ** 2)
    assert np.isfinite(model.length_scale_).tolist() == [i == 2 for i in range(8)]
    # Slopes that are left along the others would be followed by a centre at every row.
    assert len(model.centers_) < 30
    inside = np.abs(new[:, 2]) < 2
    assert_allclose(model.predict(new[inside]), new[inside, 2] ** 2, atol=2e-3)
