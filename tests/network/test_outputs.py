"""Each output's own network, and one hidden layer for all, against networks of each alone."""

import copy
import pickle

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from sklearn.base import clone

from sklearn_raacmm import RBFNetRegressor

ALONG = np.array([0.9, -0.4])


def waves(X):
    """Slow outputs 0 and 3, a constant, and outputs 2 and 4 that are three times as fast."""
    slow, fast = 1.2 * X @ ALONG, 3.6 * X @ ALONG
    return np.column_stack(
        [np.sin(slow), np.ones(len(X)), np.sin(fast), np.cos(slow), np.cos(fast)]
    )


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(3)
    X = rng.uniform(-3, 3, (120, 2))
    noise = 0.1 * rng.standard_normal((120, 5))
    return X, waves(X) + noise * [1, 0, 1, 1, 1], rng.uniform(-3, 3, (300, 2))


@pytest.fixture(scope="module")
def networks(data):
    """With hidden layers of their own, and with one that they share."""
    return [RBFNetRegressor(shared=some, random_state=0).fit(*data[:2]) for some in (False, True)]


@pytest.fixture(scope="module")
def given():
    """Data of outputs that differ in roughness, and their networks."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (90, 2))
    Y = np.column_stack([np.sin(k * X[:, 0]) + X[:, 1] for k in (1, 3, 2)])
    Y[:, 2] = np.abs(X).sum(axis=1)
    Y += 0.05 * rng.standard_normal(Y.shape)
    model = RBFNetRegressor(alpha=[0.02, 0.04, 0.02], degree=1, random_state=0).fit(X, Y)
    return X, Y, rng.uniform(-2.5, 2.5, (40, 2)), model


def test_each_output_has_the_network_that_it_would_have_alone(given):
    X, Y, T, model = given
    mean, std = model.predict(T, return_std=True)
    _, covariance = model.predict(T, return_cov=True, with_noise=False)
    slope = model.predict_gradient(T)
    assert len(set(model.kernel_)) == 2
    start = 0
    for i in range(3):
        own = clone(model).set_params(alpha=model.alpha[i]).fit(X, Y[:, i])
        own_mean, own_std = own.predict(T, return_std=True)
        np.testing.assert_allclose(mean[:, i], own_mean, rtol=0, atol=1e-12)
        np.testing.assert_allclose(std[:, i], own_std, rtol=1e-12)
        own_covariance = own.predict(T, return_cov=True, with_noise=False)[1]
        np.testing.assert_allclose(covariance[..., i], own_covariance, rtol=0, atol=1e-12)
        np.testing.assert_allclose(slope[:, i], own.predict_gradient(T), rtol=0, atol=1e-11)
        for name in ("alpha_", "noise_variance_", "signal_variance_", "intercept_", "linear_coef_"):
            np.testing.assert_allclose(getattr(model, name)[i], getattr(own, name), rtol=1e-12)
        np.testing.assert_array_equal(model.length_scale_[i], own.length_scale_)
        assert model.kernel_[i] == own.kernel_
        centers = slice(start, start + len(own.centers_))
        np.testing.assert_array_equal(model.centers_[centers], own.centers_)
        np.testing.assert_array_equal(model.center_indices_[centers], own.center_indices_)
        np.testing.assert_allclose(model.coef_[i, centers], own.coef_, rtol=1e-12)
        start += len(own.centers_)
    assert start == len(model.centers_)
    np.testing.assert_array_equal(X[model.center_indices_], model.centers_)
    # A weight for each centre of an output, and none for the others.
    assert np.count_nonzero(model.coef_) == start
    for i, (kernel, width) in enumerate(zip(model.kernel_, model.length_scale_, strict=True)):
        r = cdist(T / width, model.centers_ / width)
        phi = {
            "gaussian": np.exp(-0.5 * r**2),
            "matern52": (1 + np.sqrt(5) * r + 5 / 3 * r**2) * np.exp(-np.sqrt(5) * r),
            "matern32": (1 + np.sqrt(3) * r) * np.exp(-np.sqrt(3) * r),
            "matern12": np.exp(-r),
        }[kernel]
        linear = model.intercept_[i] + T @ model.linear_coef_[i]
        np.testing.assert_allclose(mean[:, i], phi @ model.coef_[i] + linear)


def test_widths_are_found_for_each_output(data, networks):
    (X, Y, T), (model, shared) = data, networks
    error = np.std(model.predict(T) - waves(T), axis=0)
    assert error[[0, 3]].max() < 0.06
    assert error[[2, 4]].max() < 0.25
    assert error[1] < 1e-12  # the constant
    assert np.all(model.length_scale_[0] > 2 * model.length_scale_[2])
    parts = [RBFNetRegressor(random_state=0).fit(X, y) for y in Y.T]  # on the same draws
    for i, own in enumerate(parts):
        np.testing.assert_allclose(model.predict(T)[:, i], own.predict(T), atol=1e-10)
    assert model.n_iter_ == sum(part.n_iter_ for part in parts)
    value = sum(part.log_marginal_likelihood_value_ for part in parts)
    assert model.log_marginal_likelihood_value_ == pytest.approx(value, rel=1e-12)
    assert model.stop_reason_ == ", ".join(part.stop_reason_ for part in parts)
    # Widths that all share give up one of the two kinds, or follow the noise of the other.
    assert len(shared.networks_) == 1
    assert np.max(np.std(shared.predict(T) - waves(T), axis=0) / np.fmax(error, 1e-3)) > 1.3


@pytest.mark.parametrize("shared", [True, False])
def test_the_order_of_outputs_does_not_matter(data, networks, shared):
    X, Y, T = data
    order, one = np.array([4, 1, 3, 0, 2]), networks[shared]
    other = RBFNetRegressor(shared=shared, random_state=0).fit(X, Y[:, order])
    atol = 2e-3 if shared else 1e-12
    np.testing.assert_allclose(other.predict(T), one.predict(T)[:, order], rtol=0, atol=atol)


@pytest.mark.parametrize("n_centers", [12, 0.3])
def test_scaled_outputs_count_alike_whatever_their_units(n_centers):
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (80, 2))
    Y = np.column_stack([np.sin(3 * X[:, 0]), 1000 * np.sin(3 * X[:, 1])])
    given = {"length_scale": 0.5, "alpha": 0.01, "kernel": "gaussian"}
    scaled = RBFNetRegressor(n_centers, shared="scaled", **given).fit(X, Y)
    raw = RBFNetRegressor(n_centers, shared=True, **given).fit(X, Y)
    known = RBFNetRegressor(n_centers, shared=True, **given).fit(X, Y / Y.std(axis=0))
    np.testing.assert_array_equal(scaled.center_indices_, known.center_indices_)
    np.testing.assert_allclose(scaled.criterion_path_, known.criterion_path_, rtol=1e-9)
    np.testing.assert_allclose(scaled.predict(X), known.predict(X) * Y.std(axis=0), rtol=1e-7)
    assert not np.array_equal(scaled.center_indices_, raw.center_indices_)


def test_what_has_been_found_can_be_given(data, networks):
    X, Y, T = data
    model = networks[True]
    again = clone(model).set_params(
        kernel=model.kernel_, length_scale=model.length_scale_, alpha=model.alpha_
    )
    again = clone(again).fit(X, Y)
    np.testing.assert_allclose(again.predict(T), model.predict(T), rtol=0, atol=1e-8)
    assert not hasattr(again, "log_marginal_likelihood_value_")


def test_outliers_in_one_of_the_outputs():
    rng = np.random.default_rng(0)
    X = np.sort(rng.uniform(-2, 2, (120, 1)), axis=0)
    truth = np.column_stack([np.sin(X[:, 0]), np.sin(8 * X[:, 0])])
    Y, rows = truth + 0.1 * rng.standard_normal(truth.shape), rng.permutation(120)[:5]
    Y[rows, 0] += 10
    robust = RBFNetRegressor(loss="tukey", random_state=0).fit(X, Y)
    assert np.all(robust.row_weight_[rows] == 0)
    assert np.std(robust.predict(X) - truth, axis=0).max() < 0.06


def test_files(given):
    *_, T, model = given
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(again.predict(T), model.predict(T))
    for sentence, changes in {
        r"its networks predict the outputs \[1, 2\]": {"networks_": model.networks_[1:]},
        "networks_ holds something else": {"networks_": (1, 2, 3)},
        "center_indices_ of RBFNetRegressor": {"center_indices_": model.center_indices_[:-1]},
    }.items():
        lost = copy.deepcopy(model)
        vars(lost).update(changes)
        with pytest.raises(ValueError, match=sentence):
            pickle.loads(pickle.dumps(lost))
