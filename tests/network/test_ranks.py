"""Ranks as inputs: against SciPy's ranks, a network of ranks made beforehand, and differences."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import rankdata

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network._ranks import mid_ranks, rank_slopes, to_ranks


def table(n, seed=0):
    """Amounts of which many are none, few ages far apart, a skew amount; a sum of their effects."""
    rng = np.random.default_rng(seed)
    none = rng.random(n) < 0.45
    age = rng.choice([1.0, 3, 7, 14, 28, 56, 90, 180, 365], n)
    X = np.column_stack([np.where(none, 0, rng.gamma(2, 1, n)), age, rng.lognormal(0, 1, n)])
    f = np.log1p(age) + 1.5 * np.sqrt(X[:, 0]) * (age > 14) + np.sin(2 * np.log(X[:, 2]))
    return X, f + 0.2 * rng.standard_normal(n), f


def test_mid_ranks_are_those_of_scipy():
    X, *_ = table(100)
    found = to_ranks(mid_ranks(X, np.ones(100)), X)
    assert_allclose(found, (rankdata(X, axis=0) - 0.5) / 100, rtol=1e-13)
    weights = np.random.default_rng(1).integers(1, 4, 100)
    repeated = np.repeat(X, weights, axis=0)
    knots = mid_ranks(X, weights)
    assert_allclose(knots, mid_ranks(repeated, np.ones(len(repeated))), rtol=1e-12)
    # Of many values some are kept, and those that many rows share with their neighbours.
    X, *_ = table(3000)
    knots = mid_ranks(X, np.ones(3000))
    assert len(knots) < 3 * 135
    assert_allclose(to_ranks(knots, X), (rankdata(X, axis=0) - 0.5) / 3000, atol=1 / 128)
    assert np.all(np.diff(knots[knots[:, 0] == 0, 1]) > 0)


def test_slopes_are_those_of_differences_and_the_mean_at_a_knot():
    X, *_ = table(60)
    knots = mid_ranks(X, np.ones(60))
    T = np.concatenate([X, X + 1e-3, X - 500, X + 500])
    step = 1e-7
    expected = (to_ranks(knots, T + step) - to_ranks(knots, T - step)) / (2 * step)
    assert_allclose(rank_slopes(knots, T), expected, rtol=1e-5, atol=1e-6)
    # A row far off does not look like the last one.
    far = to_ranks(knots, X.max(axis=0) + 10 * np.ptp(X, axis=0) * np.eye(3))
    assert np.all(np.diag(far) > 1.2)


@pytest.mark.parametrize("n_centers", ["auto", 20])
def test_a_network_of_ranks_is_that_of_ranks_made_beforehand(n_centers):
    X, y, _ = table(120)
    knots = mid_ranks(X, np.ones(120))
    given = {"n_centers": n_centers, "kernel": "matern32", "degree": 0, "random_state": 0}
    model = RBFNetRegressor(inputs="ranks", **given).fit(X, y)
    other = RBFNetRegressor(inputs="raw", **given).fit(to_ranks(knots, X), y)
    T, *_ = table(50, seed=1)
    expected = other.predict(to_ranks(knots, T), return_std=True)
    assert_allclose(model.predict(T, return_std=True), expected, rtol=1e-6)
    assert model.inputs_ == "ranks"
    assert_allclose(model.length_scale_, other.length_scale_, rtol=1e-6)
    assert_array_equal(X[model.center_indices_], model.centers_)
    again = RBFNetRegressor(
        n_centers, inputs="ranks", kernel="matern32", degree=0, length_scale=model.length_scale_
    )
    assert again.set_params(alpha=model.alpha_).fit(X, y).inputs_ == "ranks"
    assert_allclose(again.predict(T), expected[0], rtol=1e-6)


def test_gradients_are_those_of_differences():
    X, y, _ = table(120)
    model = RBFNetRegressor(inputs="ranks", degree=1, random_state=0)
    model.fit(X, np.column_stack([y, y**2]))
    # Near knots differences see both sides.
    rng = np.random.default_rng(0)
    T = np.column_stack([rng.uniform(-1, 9, 40), rng.uniform(0, 400, 40), rng.uniform(-1, 5, 40)])
    gradient, step = model.predict_gradient(T), 1e-6
    for j in range(3):
        shift = step * np.eye(3)[j]
        slope = (model.predict(T + shift) - model.predict(T - shift)) / (2 * step)
        assert_allclose(gradient[..., j], slope, rtol=1e-4, atol=1e-5 * np.abs(slope).max())


def test_auto_takes_what_the_data_ask_for():
    X, y, _ = table(300)
    T, _, truth = table(1000, seed=1)
    auto, raw = (RBFNetRegressor(inputs=i, random_state=0).fit(X, y) for i in ("auto", "raw"))
    assert (auto.inputs_, raw.inputs_) == ("ranks", "raw")
    left = [np.sqrt(np.mean(np.square(model.predict(T) - truth))) for model in (auto, raw)]
    assert left[0] < 0.9 * left[1]
    rng = np.random.default_rng(0)
    X = rng.standard_normal((200, 2))
    y = np.sin(X[:, 0]) + X[:, 1] ** 2 / 3 + 0.1 * rng.standard_normal(200)
    auto, raw = (RBFNetRegressor(inputs=i, random_state=0).fit(X, y) for i in ("auto", "raw"))
    assert auto.inputs_ == "raw"
    assert_array_equal(auto.predict(X), raw.predict(X))


def test_outputs_may_see_different_inputs():
    X, y, _ = table(250)
    straight = np.sin(X[:, 2]) + 0.01 * np.random.default_rng(0).standard_normal(250)
    model = RBFNetRegressor(random_state=0).fit(X, np.column_stack([y, straight]))
    assert list(model.inputs_) == ["ranks", "raw"]
    parts = [RBFNetRegressor(random_state=0).fit(X, of).predict(X) for of in (y, straight)]
    assert_allclose(model.predict(X), np.column_stack(parts), rtol=0, atol=1e-9)


def test_files_keep_ranks():
    X, y, _ = table(120)
    model = RBFNetRegressor(20, inputs="ranks", random_state=0).fit(X, y)
    assert_array_equal(pickle.loads(pickle.dumps(model)).predict(X), model.predict(X))
    network = model.networks_[0]
    for damaged in (network.ranks[:, :2], network.ranks[network.ranks[:, 0] > 0]):
        with pytest.raises(ValueError, match="The file is damaged: ranks of Network"):
            object.__new__(type(network)).__setstate__(network.__getstate__() | {"ranks": damaged})
