"""Groups of outputs with widths and centres of their own, against networks of each alone."""

import copy
import pickle

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import GroupedPosterior, networks_of
from sklearn_raacmm.network._likelihood import Data, exact_likelihood
from sklearn_raacmm.network._output_groups import output_groups
from sklearn_raacmm.network._width_search import search

ALONG = np.array([0.9, -0.4])
GROUPS = [[0, 1], [2, 4], [3]]


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
def model(data):
    return RBFNetRegressor(random_state=0).fit(*data[:2])


@pytest.fixture(scope="module")
def given():
    """Data, and a network of which kernel and widths of every output are given."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (90, 2))
    Y = np.column_stack([np.sin(k * X[:, 0]) + X[:, 1] for k in (1, 1.2, 3, 2, 3.3)])
    widths, kernels = np.empty((5, 2)), np.empty(5, dtype=object)
    ways = [(1, 2), "gaussian"], [(0.4, np.inf), "matern52"], [(0.7, 0.9), "matern32"]
    for of, (width, kernel) in zip(GROUPS, ways, strict=True):
        widths[of], kernels[of] = width, kernel
    params = {"kernel": list(kernels), "length_scale": widths, "alpha": np.arange(1, 6) / 50}
    Y += 0.05 * rng.standard_normal(Y.shape)
    return X, Y, rng.uniform(-2.5, 2.5, (40, 2)), RBFNetRegressor(**params, degree=1).fit(X, Y)


def alone(given):
    """The network of every group, fitted by itself."""
    X, Y, _, model = given
    for of in GROUPS:
        i = of[0]
        own = clone(model).set_params(
            kernel=model.kernel[i], length_scale=model.length_scale[i], alpha=model.alpha[of]
        )
        yield of, own.fit(X, Y[:, of])


def test_each_group_is_the_network_of_its_outputs(given):
    X, _, T, model = given
    np.testing.assert_array_equal(model.output_groups_, [0, 0, 1, 2, 1])
    mean, std = model.predict(T, return_std=True)
    _, covariance = model.predict(T, return_cov=True, with_noise=False)
    slope, variance_slope = model.predict_gradient(T, return_variance=True)
    start = 0
    for of, own in alone(given):
        own_mean, own_std = own.predict(T, return_std=True)
        np.testing.assert_allclose(mean[:, of], own_mean, rtol=0, atol=1e-12)
        np.testing.assert_allclose(std[:, of], own_std, rtol=1e-12)
        own_covariance = own.predict(T, return_cov=True, with_noise=False)[1]
        np.testing.assert_allclose(covariance[..., of], own_covariance, rtol=0, atol=1e-12)
        for all_of_them, of_own in zip(
            (slope, variance_slope), own.predict_gradient(T, return_variance=True), strict=True
        ):
            np.testing.assert_allclose(all_of_them[:, of], of_own, rtol=0, atol=1e-11)
        for name in ("alpha_", "noise_variance_", "signal_variance_", "intercept_", "linear_coef_"):
            np.testing.assert_allclose(getattr(model, name)[of], getattr(own, name), rtol=1e-12)
        np.testing.assert_array_equal(model.length_scale_[of], [own.length_scale_] * len(of))
        assert set(model.kernel_[of]) == {own.kernel_}
        centers = slice(start, start + len(own.centers_))
        np.testing.assert_array_equal(model.centers_[centers], own.centers_)
        np.testing.assert_array_equal(model.center_indices_[centers], own.center_indices_)
        np.testing.assert_allclose(model.coef_[of, centers], own.coef_, rtol=1e-12)
        start += len(own.centers_)
    assert start == len(model.centers_)
    np.testing.assert_array_equal(X[model.center_indices_], model.centers_)
    # A weight for each centre of an output's group, and none for the others.
    assert (
        np.count_nonzero(model.coef_)
        == sum(part.coef_.size for _, part in networks_of(model))
        < model.coef_.size
    )


def test_draws_have_the_mean_and_the_covariance_that_are_said(given):
    *_, T, model = given
    mean, covariance = model.predict(T[:3], return_cov=True)
    draws = model.sample_y(T[:3], 20_000, random_state=0)
    for i in range(5):
        sd = np.sqrt(covariance[..., i].diagonal())
        np.testing.assert_allclose(draws[:, i].mean(axis=1), mean[:, i], atol=5 * sd.max() / 140)
        np.testing.assert_allclose(
            np.cov(draws[:, i]), covariance[..., i], atol=0.05 * sd.max() ** 2
        )


def test_the_data_form_the_groups(data, model):
    X, Y, T = data
    np.testing.assert_array_equal(model.output_groups_, [0, 0, 1, 0, 1])
    error = np.std(model.predict(T) - waves(T), axis=0)
    assert error[[0, 3]].max() < 0.06
    assert error[1] < 1e-12  # the constant
    np.testing.assert_allclose(model.length_scale_[0], model.length_scale_[3])
    assert np.all(model.length_scale_[0] > 2 * model.length_scale_[2])
    # Slow and fast outputs by themselves, on the same draws: to the last digit.
    for of in ([0, 1, 3], [2, 4]):
        own = RBFNetRegressor(random_state=0).fit(X, Y[:, of])
        assert not own.output_groups_.any()
        np.testing.assert_array_equal(model.predict(T)[:, of], own.predict(T))
    # Widths that all share give up one of the two kinds.
    shared = RBFNetRegressor(
        kernel="gaussian", length_scale=model.length_scale_[2], random_state=0
    ).fit(X, Y)
    assert np.std(shared.predict(T) - waves(T), axis=0)[0] > 1.5 * error[0]


def test_sums_over_groups(data, model):
    X, Y, _ = data
    parts = [RBFNetRegressor(random_state=0).fit(X, Y[:, of]) for of in ([0, 1, 3], [2, 4])]
    assert model.n_iter_ == sum(part.n_iter_ for part in parts)
    value = sum(part.log_marginal_likelihood_value_ for part in parts)
    assert model.log_marginal_likelihood_value_ == pytest.approx(value, rel=1e-12)
    assert model.stop_reason_ == ", ".join(part.stop_reason_ for part in parts)
    assert model.relevance_.sum() == pytest.approx(1)
    assert np.argmax(model.relevance_) == 0
    # Four outputs vary, two in each group: what the centres explain is the mean over outputs.
    explained = np.mean([part.error_reduction_.sum() for part in parts])
    assert model.error_reduction_.sum() == pytest.approx(explained)
    assert len(model.criterion_path_) == sum(len(part.criterion_path_) for part in parts)


def test_the_order_of_outputs_does_not_matter(data, model):
    X, Y, T = data
    order = np.array([4, 1, 3, 0, 2])
    other = RBFNetRegressor(random_state=0).fit(X, Y[:, order])
    np.testing.assert_allclose(other.predict(T), model.predict(T)[:, order], rtol=0, atol=2e-3)
    varies = order != 1  # what is constant is of the first group
    groups, others = model.output_groups_[order][varies], other.output_groups_[varies]
    np.testing.assert_array_equal(groups[:, None] == groups, others[:, None] == others)


def test_outputs_that_agree_are_one_group_and_pay_little(monkeypatch):
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (200, 2))
    Y = np.column_stack([np.sin(X @ ALONG + k) + 0.1 * k * X[:, 0] ** 2 for k in range(3)])
    Y += [0.05, 0.3, 1.0] * rng.standard_normal(Y.shape)
    evaluations = []
    objective = "sklearn_raacmm.network._width_objective.exact_likelihood"

    def counted(data, *args):
        evaluations.append(data.Y.shape[1])
        return exact_likelihood(data, *args)

    monkeypatch.setattr(objective, counted)
    model = RBFNetRegressor(random_state=0).fit(X, Y)
    np.testing.assert_array_equal(model.output_groups_, [0, 0, 0])
    shared, single = evaluations.count(3), evaluations.count(1)
    assert 0 < single / 3 < 0.15 * shared
    evaluations.clear()
    RBFNetRegressor(random_state=0).fit(X, Y[:, 0])
    before = len(evaluations)
    monkeypatch.setattr("sklearn_raacmm.network._tuning.output_groups", None)  # not even called
    RBFNetRegressor(random_state=0).fit(X, Y[:, 0])
    assert len(evaluations) == 2 * before


def test_noise_and_weak_outputs_stay_where_they_are():
    rng = np.random.default_rng(1)
    X = rng.uniform(-2, 2, (200, 2))
    clear = np.sin(2 * X[:, 0]) * X[:, 1]
    tails = rng.standard_t(2.5, 200)
    Y = np.column_stack([clear, 0.2 * clear + tails, rng.standard_normal(200), clear + 0.1 * tails])
    model = RBFNetRegressor(random_state=0).fit(X, Y + 0.05 * rng.standard_normal(Y.shape))
    np.testing.assert_array_equal(model.output_groups_, 0)


def test_weights_and_a_given_ridge_and_one_width(data):
    X, Y, _ = data
    X, Y, weights = X, Y, np.repeat([1.0, 2.0], 60)
    for params in ({"alpha": 0.01, "kernel": "matern52"}, {"length_scale": "isotropic"}):
        model = RBFNetRegressor(random_state=0, **params).fit(X, Y[:, [0, 2]], weights)
        np.testing.assert_array_equal(model.output_groups_, [0, 1])
        for i, column in enumerate((0, 2)):
            own = RBFNetRegressor(random_state=0, **params).fit(X, Y[:, column], weights)
            np.testing.assert_allclose(model.predict(X)[:, i], own.predict(X), rtol=0, atol=1e-12)


def test_what_has_been_found_can_be_given(data, model):
    X, Y, T = data
    again = clone(model).set_params(
        kernel=model.kernel_, length_scale=model.length_scale_, alpha=model.alpha_
    )
    again = clone(again).fit(X, Y)
    np.testing.assert_array_equal(again.output_groups_, model.output_groups_)
    np.testing.assert_allclose(again.predict(T), model.predict(T), rtol=0, atol=1e-10)
    assert not hasattr(again, "log_marginal_likelihood_value_")
    alike = again.set_params(length_scale=np.ones((5, 2)), kernel=["gaussian"] * 5).fit(X, Y)
    assert alike.length_scale_.shape == (2,)


def test_a_warm_start_keeps_the_groups(data, model, monkeypatch):
    X, Y, T = data
    warm = clone(model).set_params(warm_start=True).fit(X[:-5], Y[:-5])
    groups = warm.output_groups_
    monkeypatch.setattr("sklearn_raacmm.network._tuning.search", None)  # nothing is searched for
    warm.fit(X, Y)
    np.testing.assert_array_equal(warm.output_groups_, groups)
    np.testing.assert_allclose(warm.predict(T), model.predict(T), rtol=0, atol=0.2)
    monkeypatch.undo()
    # Outputs that agree now are one group again; a number of centres is that of all.
    slow = waves(X)[:, [0, 3, 0, 3, 1]] + 0.1 * np.random.default_rng(0).standard_normal(Y.shape)
    assert not warm.fit(X, slow).output_groups_[:4].any()
    assert warm.fit(X, Y).output_groups_.any()
    assert len(warm.set_params(n_centers=30).fit(X, slow).centers_) == 30


def test_outliers_leave_the_groups():
    rng = np.random.default_rng(0)
    X = np.sort(rng.uniform(-2, 2, (120, 1)), axis=0)
    truth = np.column_stack([np.sin(X[:, 0]), np.sin(8 * X[:, 0])])
    Y, rows = truth + 0.1 * rng.standard_normal(truth.shape), rng.permutation(120)[:5]
    Y[rows, 0] += 10
    robust = RBFNetRegressor(loss="tukey", random_state=0).fit(X, Y)
    np.testing.assert_array_equal(robust.output_groups_, [0, 1])
    assert np.all(robust.row_weight_[rows] == 0)
    assert np.std(robust.predict(X) - truth, axis=0).max() < 0.06


def test_an_output_that_is_given_up_is_said():
    """A number of centres is that of all outputs."""
    rng = np.random.default_rng(3)
    X, along = rng.uniform(-3, 3, (300, 3)), np.array([0.9, -0.3, 0.3])
    slow, fast = np.sin([[1.2], [3.6]] * (X @ along)) + 0.1 * rng.standard_normal((2, 300))
    model = RBFNetRegressor(60, random_state=0)
    with pytest.warns(ConvergenceWarning, match="Output 2 is taken for noise") as said:
        model.fit(X, np.column_stack([np.ones(300), slow, fast]))
    assert said[0].filename == __file__  # the line of the call
    assert model.centers_.shape == (60, 3)
    assert not model.output_groups_.any()
    # What is noise with any widths, or has functions with these, is passed over in silence.
    noise = rng.standard_normal(300)
    model.fit(X, np.column_stack([slow, noise, np.cos(1.2 * X @ along)]))


def test_groups_of_rows_and_of_outputs(given):
    X, Y, _, model = given
    labels = np.arange(len(X)) // 10
    centred = Y - np.array([Y[labels == g].mean(axis=0) for g in labels])
    with pytest.raises(ValueError, match="without offsets of groups"):
        clone(model).fit(X, centred, groups=labels)


@pytest.mark.parametrize(
    ("params", "sentence"),
    [
        ({"length_scale": np.ones((3, 2))}, r"shape \(3, 2\).*2 features.*each of the 2 outputs"),
        ({"kernel": ["gaussian", "matern52"]}, "needs length_scale of shape"),
        ({"kernel": ["gaussian"], "length_scale": np.ones((2, 2))}, "for each of the 2 outputs"),
        (
            {"kernel": ["auto", "gaussian"], "length_scale": np.ones((2, 2))},
            "kernel must be a name",
        ),
        ({"length_scale": [[1.0, 1.0], [1.0, 0.0]]}, "length_scale must be positive"),
        ({"length_scale": [[1.0, 1.0], [1.0, 1e-9]]}, "does not resolve"),
    ],
)
def test_odd_parameters(params, sentence):
    X = np.random.default_rng(0).uniform(size=(20, 2))
    with pytest.raises(ValueError, match=sentence):
        RBFNetRegressor(**params).fit(X, X)


def test_one_output_of_one_column(given):
    X, Y, T, _ = given
    rows = RBFNetRegressor(length_scale=[[1.0, 2.0]], kernel=["gaussian"], alpha=0.1)
    plain = RBFNetRegressor(length_scale=[1.0, 2.0], kernel="gaussian", alpha=0.1).fit(X, Y[:, 0])
    np.testing.assert_array_equal(rows.fit(X, Y[:, 0]).predict(T), plain.predict(T))
    np.testing.assert_array_equal(rows.output_groups_, [0])


def test_files(given):
    *_, T, model = given
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(again.predict(T), model.predict(T))
    damaged = {
        r"are \[0, 0, 1, 2\], where its parts have \[2, 2, 1\] outputs": {
            "output_groups": np.array([0, 0, 1, 2])
        },
        r"are \[0, 0, 1, 3, 1\]": {"output_groups": np.array([0, 0, 1, 3, 1])},
        "parts of GroupedPosterior are no posteriors": {"parts": (1, 2, 3)},
        "output_groups of GroupedPosterior is missing": {"output_groups": None},
    }
    for sentence, changes in damaged.items():
        state = copy.copy(vars(model.posterior_)) | changes
        with pytest.raises(ValueError, match=sentence):
            GroupedPosterior.__new__(GroupedPosterior).__setstate__(state)
    lost = copy.deepcopy(model)
    vars(lost)["center_indices_"] = lost.center_indices_[:-1]
    with pytest.raises(ValueError, match="center_indices_ of RBFNetRegressor"):
        pickle.loads(pickle.dumps(lost))


def test_noise_is_widened_in_every_group(given):
    *_, T, model = given
    wider = model.posterior_.with_noise(4.0)
    np.testing.assert_allclose(wider.noise_variance, 4 * model.noise_variance_)
    np.testing.assert_array_equal(wider.predict(T)[0], model.predict(T))
    assert wider.weight_unit == model.posterior_.weight_unit


def test_nothing_to_group():
    rng = np.random.RandomState(0)
    X = np.ones((20, 2))  # no feature varies
    data = Data(X, rng.standard_normal((20, 3)), np.ones(20), np.zeros(3))
    found = search(data, ["gaussian"], random_state=rng)
    (one,) = output_groups(data, found)
    np.testing.assert_array_equal(one, [0, 1, 2])
