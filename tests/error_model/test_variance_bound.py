"""The bound of the variance: never below it, of use, and predict keeps its bits."""

import warnings

import numpy as np
import pytest

from sklearn_raacmm import Arm, ArmResidualRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.error_model import Terms
from sklearn_raacmm.error_model._columns import factored_columns
from sklearn_raacmm.error_model._variance_bound import bounded_std, single_root


@pytest.fixture(scope="module", params=[3, 100])
def fitted(request):
    test = make_single_point(n_positions=10, n_poses=30, random_state=0)
    model = ArmResidualRegressor(test.arm, orders=request.param)
    model.fit(test.data, test.target, groups=test.groups)
    return model, test.data


def poses(X, n=3000):
    """Training poses, wrong by little, random ones, and far ones of many turns."""
    rng = np.random.default_rng(0)
    near = X + rng.normal(scale=1e-3, size=X.shape)
    return np.concatenate([X, near, *(rng.uniform(-s, s, (n, X.shape[1])) for s in (2, np.pi, 12))])


def test_it_is_a_bound_and_a_close_one(fitted):
    model, X = fitted
    linear, X = model.linear_model_, poses(X)
    exact = np.linalg.norm(linear.predict(X, return_std=True)[1], axis=1)
    columns = factored_columns(linear.arm, X, linear.terms)
    bound = bounded_std(columns, single_root(linear._std_root))
    assert np.all(bound >= exact)
    assert np.quantile(bound / exact, 0.99) < 1.9  # 2 is what known poses have to spare
    assert np.all(bound > 1.000001 * exact)  # a bound of single precision, no equality


def test_it_holds_for_directions_that_cancel():
    """Large columns of opposite sign, of which next to nothing is left."""
    arm, rng = Arm.from_name("aacmm6"), np.random.default_rng(1)
    terms = Terms(np.array([[0, 1], [2, 3], [4, 40]]), True, True, True)
    X = rng.uniform(-3, 3, (200, 6))
    columns = factored_columns(arm, X, terms)
    m = columns.rest.shape[2] + sum(last - first for first, last, *_ in columns.runs)
    matrix = np.stack([columns.dot(row) for row in np.eye(m)], axis=2)
    nothing = np.linalg.svd(matrix.reshape(-1, m))[2][-20:].T * 1e3
    bound = bounded_std(columns, single_root(nothing))
    exact = np.sqrt(np.square(matrix @ nothing).sum(axis=(1, 2)))
    assert np.all(bound >= exact)


def test_predict_does_not_change_by_a_bit(fitted):
    model, X = fitted
    assert model.fading_.known_mm > 0
    X = poses(X, 300)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        without, with_std = model.predict(X), model.predict(X, return_std=True)[0]
    np.testing.assert_array_equal(without, with_std)
    share = model.fading(X)
    assert 0.02 < np.mean(share == 1) < 0.9  # both kinds are there
    one_by_one = np.concatenate([model.predict(row[None]) for row in X[:20]])
    np.testing.assert_allclose(one_by_one, without[:20], rtol=0, atol=1e-14)
