"""Every row a centre: the posterior of the process itself, and when there are no fewer centres."""

import pickle

import numpy as np
import pytest
from mpmath import mp, mpf

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import _centers, _fit
from sklearn_raacmm.network._kernels import kernel_matrix
from sklearn_raacmm.network._linear import prepare
from sklearn_raacmm.network._rows import Rows
from sklearn_raacmm.network._search import Structure
from sklearn_raacmm.utils import Groups

from ._data import rough

GIVEN = {"length_scale": [0.4, 0.5, 0.6], "alpha": 0.02}
X, Y, _ = rough(120, 3, 5)
T = np.random.default_rng(1).uniform(-1.5, 1.5, (15, 3))


def test_weights_repeats_outputs_and_tail_against_extended_precision():
    """Conditioning of the joint normal distribution, the constant with a variance of 1e30."""
    rng = np.random.default_rng(2)
    A = rng.uniform(-1, 1, (22, 2))
    B = np.column_stack([np.sin(7 * A[:, 0]) + 3 * A[:, 1], np.cos(9 * A[:, 1])])
    B += 0.1 * rng.standard_normal(B.shape)
    A, B = np.vstack([A, A[:2]]), np.vstack([B, B[:2] + 0.1])
    weights = rng.uniform(0.2, 3, len(A))
    model = RBFNetRegressor(length_scale=[0.3, 0.4], kernel="gaussian", degree=1, shared=True)
    model.fit(A, B, sample_weight=weights)
    (posterior,) = model.networks_
    assert model.stop_reason_ == "all rows"
    assert posterior.tail_ridge > 0
    assert np.ptp(posterior.alpha) > 0
    x, center = T[:2, :2], np.average(A, axis=0, weights=weights)
    spread = np.sqrt(np.average((A - center) ** 2, axis=0, weights=weights))

    def prior(P, Q, noise, signal):
        """Covariance of the values at two sets of points: function, line and constant."""
        of_slope, cov = mpf(noise) / mpf(posterior.tail_ridge), mp.matrix(len(P), len(Q))
        for i, j in np.ndindex(len(P), len(Q)):
            a, b = ([mpf(v) for v in (P[i], Q[j])[m]] for m in (0, 1))
            s = sum(((a[m] - b[m]) / mpf([0.3, 0.4][m])) ** 2 for m in (0, 1))
            line = sum(
                (a[m] - center[m]) * (b[m] - center[m]) / mpf(spread[m]) ** 2 for m in (0, 1)
            )
            cov[i, j] = mpf(signal) * mp.exp(-s / 2) + of_slope * line + mpf(10) ** 30
        return cov

    mean, covariance = model.predict(x, return_cov=True, with_noise=False)
    for i in range(2):
        noise, signal = model.noise_variance_[i], model.signal_variance_[i]
        with mp.workdps(120):  # the constant's variance squares to 1e60
            C = prior(A, A, noise, signal)
            for j, weight in enumerate(weights):
                C[j, j] += mpf(noise) / mpf(weight) * mpf(posterior.weight_unit)
            across = prior(x, A, noise, signal)
            known = across * mp.inverse(C)
            expected = known * mp.matrix(B[:, i].tolist())
            left = prior(x, x, noise, signal) - known * across.T
            expected, left = (np.array(m.tolist(), dtype=float) for m in (expected, left))
        np.testing.assert_allclose(mean[:, i], expected[:, 0], rtol=1e-9)
        np.testing.assert_allclose(covariance[:, :, i], left, atol=1e-9 * signal)


@pytest.mark.parametrize("degree", [-1, 0, 1])
def test_it_is_the_network_with_all_centres(degree):
    y = np.column_stack([Y, Y**2])
    options = GIVEN | {"alpha": [0.02, 0.1], "degree": degree}
    weights = np.random.default_rng(3).uniform(0.5, 2, len(X))
    options["shared"] = True
    process = RBFNetRegressor(**options).fit(X, y, sample_weight=weights)
    network = RBFNetRegressor(len(X), **options).fit(X, y, sample_weight=weights)
    assert (process.stop_reason_, network.stop_reason_) == ("all rows", "n_centers")
    pairs = [(process.predict(T), network.predict(T))]
    both = [(*m.predict(T, return_cov=True), m.predict_gradient(T)) for m in (process, network)]
    pairs += zip(*both, strict=True)
    for name in ("intercept_", "linear_coef_", "noise_variance_", "signal_variance_"):
        pairs.append((getattr(process, name), getattr(network, name)))
    for ours, other in pairs:
        np.testing.assert_allclose(ours, other, atol=1e-9 * np.abs(other).max(), rtol=1e-8)


@pytest.mark.parametrize(
    "asked",
    [
        {"n_centers": 120},
        {"max_centers": 500},
        {"n_centers": 0.05},
        {"alpha": 1e-10},
        {"length_scale": 3.0},
    ],
)
def test_centres_are_chosen_where_asked_for_or_where_few_do(asked):
    model = RBFNetRegressor(**(GIVEN | asked)).fit(X, Y)
    assert model.stop_reason_ != "all rows"
    assert not model.networks_[0].all_rows


def test_of_too_many_rows_as_many_as_there_is_room_for_are_centres(monkeypatch):
    monkeypatch.setattr(_fit, "MOST_ROWS", 100)
    model = RBFNetRegressor(**GIVEN, random_state=0).fit(X, Y)
    assert model.stop_reason_ == "all rows"
    assert len(model.centers_) == 100
    np.testing.assert_array_equal(X[model.center_indices_], model.centers_)
    few = RBFNetRegressor(**GIVEN).fit(model.centers_, Y[model.center_indices_])
    np.testing.assert_allclose(model.predict(T), few.predict(T), atol=1e-9)


@pytest.mark.parametrize("rough", [True, False])
def test_rows_with_constants_are_generalised_least_squares(rough):
    """The same posterior from a covariance that has the groups' constants in it."""
    rng = np.random.default_rng(0)
    groups = np.arange(120) % 12
    weights = rng.uniform(0.5, 2, 120)
    y = Groups(groups).centred(Y, weights)
    given = GIVEN | {"kernel": "matern52", "n_centers": "auto" if rough else 120}
    model = RBFNetRegressor(**given)
    model.fit(X, y, sample_weight=weights, groups=groups)
    (network,) = model.networks_
    assert network.all_rows == rough
    assert model.group_std_ > 0
    Z = X / GIVEN["length_scale"]
    noise = np.diag(network.weight_unit / weights) + network.ratio * np.equal.outer(groups, groups)
    C = kernel_matrix(Z, Z, "matern52") + network.alpha[0] * noise
    one = np.ones(120)
    constant = one @ np.linalg.solve(C, y) / (one @ np.linalg.solve(C, one))
    across = kernel_matrix(T / GIVEN["length_scale"], Z, "matern52")
    gain = np.linalg.solve(C, across.T).T
    mean, covariance = model.predict(T, return_cov=True, with_noise=False)
    np.testing.assert_allclose(mean, constant + gain @ (y - constant), atol=1e-8)
    left = kernel_matrix(*[T / GIVEN["length_scale"]] * 2, "matern52") - gain @ across.T
    unknown = 1 - gain.sum(axis=1)
    left += np.outer(unknown, unknown) / (one @ np.linalg.solve(C, one))
    np.testing.assert_allclose(covariance, model.signal_variance_ * left, atol=1e-8)


def test_share_of_parameters_is_the_trace_of_the_smoother(monkeypatch):
    A, y, _ = rough(600, 3, 5)
    weights = np.random.default_rng(0).uniform(0.5, 2, 600)
    problem = prepare(Rows(A, y[:, None], weights).merged(), 0)
    functions = Structure("matern32", np.array([0.5, 1.0, 2.0]), np.array([0.1]))
    share = _fit.share_of_parameters(problem, 0.1, functions, 600)
    Z = problem.rows.X / functions.length_scale
    root = problem.block(problem.rows).root
    d = np.sqrt(3) * np.linalg.norm(Z[:, None] - Z, axis=2)
    values = np.linalg.eigvalsh(root * (1 + d) * np.exp(-d) * root.T)
    assert share == pytest.approx(np.mean(values / (values + 0.1)), rel=1e-9)
    # From samples of 100 and 200 rows: a little too large, and an upper bound once it is small.
    monkeypatch.setattr(_fit, "FIRST_SAMPLE", 100)
    monkeypatch.setattr(_fit, "LARGEST_SAMPLE", 200)
    assert share < _fit.share_of_parameters(problem, 0.1, functions, 600) < 1.3 * share
    assert _fit.share_of_parameters(problem, 0.1, functions, 600, 0.999) < 0.999


def test_a_kept_model_is_small_and_the_same():
    model = RBFNetRegressor(**GIVEN).fit(X, Y)
    size = len(pickle.dumps(model))
    expected = model.predict(T, return_std=True)
    assert len(pickle.dumps(model)) == size
    assert size < 8 * len(X) ** 2 / 2
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(model)).predict(T, True), expected)


def test_a_few_more_than_a_moderate_number_of_centres_do_not_lead_to_all_rows(monkeypatch):
    for module in (_centers, _fit):
        monkeypatch.setattr(module, "MODERATE", 30)
    monkeypatch.setattr(_centers, "MOST_TRIED", 50)
    numbers = []
    for alpha in np.geomspace(0.02, 2, 13):
        given = {"length_scale": [0.5, 0.6, 0.7], "alpha": alpha}
        model = RBFNetRegressor(**given).fit(X, Y)
        numbers.append(len(model.centers_))
        process = RBFNetRegressor(len(X), **given).fit(X, Y)
        left = model.predict(X) - process.predict(X)
        assert np.mean(np.square(left)) < 0.02 * process.noise_variance_
    assert max(numbers) == len(X)
    assert any(30 < n < 50 for n in numbers)
    assert not any(50 < n < len(X) for n in numbers)
