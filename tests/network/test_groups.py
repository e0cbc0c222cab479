"""Groups of rows whose targets are known up to a constant each."""

import numpy as np
import pytest

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import _rows
from sklearn_raacmm.network._linear import without_constants
from sklearn_raacmm.utils import Groups


def grouped_wave(n=120, n_groups=8, seed=0):
    """Positions have a range of x of their own, so that offsets hide most of the wave."""
    rng = np.random.default_rng(seed)
    groups = np.arange(n) % n_groups
    X = rng.uniform(-1, 1, (n, 2)) + 0.4 * groups[:, None]
    f = np.sin(X[:, 0]) + 0.3 * X[:, 1]
    y = Groups(groups).centred(f + 0.02 * rng.standard_normal(n))
    return X, y, groups, f


def test_differences_at_new_rows_are_found_better_than_without_groups():
    X, y, groups, _ = grouped_wave()
    X_new, _, of, f = grouped_wave(seed=1)
    truth = Groups(of).centred(f)

    def error(model):
        return np.sqrt(np.mean((Groups(of).centred(model.predict(X_new)) - truth) ** 2))

    known = RBFNetRegressor().fit(X, y, groups=groups)
    unknown = RBFNetRegressor().fit(X, y)
    assert error(known) < 0.25 * error(unknown)
    assert error(known) < 0.1 * truth.std()
    assert known.group_std_ > 0.5 * truth.std()
    assert unknown.group_std_ == 0


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
    y = Groups(groups).centred(y, times.astype(float))
    once = RBFNetRegressor().fit(X, y, sample_weight=times, groups=groups)
    often = RBFNetRegressor().fit(X[rows], y[rows], groups=groups[rows])
    np.testing.assert_allclose(once.predict(X), often.predict(X), rtol=1e-6, atol=1e-8)


def test_targets_known_in_full_have_no_offsets():
    X, _, groups, f = grouped_wave()
    known = RBFNetRegressor().fit(X, f)
    model = RBFNetRegressor().fit(X, f, groups=groups)
    assert model.group_std_ == 0
    np.testing.assert_array_equal(model.predict(X), known.predict(X))


def test_outliers_do_not_teach():
    X, _, groups, f = grouped_wave()
    bad = f.copy()
    bad[::20] += 5.0
    model = RBFNetRegressor(kernel="gaussian", loss="tukey")
    model.fit(X, Groups(groups).centred(bad), groups=groups)
    left = Groups(groups).centred(model.predict(X) - f)
    assert np.sqrt(np.mean(left**2)) < 0.05
    assert np.all(model.row_weight_[::20] < 0.1)


def test_groups_that_cannot_be(monkeypatch):
    X, y, groups, _ = grouped_wave()
    with pytest.raises(ValueError, match="groups names 119 samples, but there are 120"):
        RBFNetRegressor().fit(X, y, groups=groups[1:])
    monkeypatch.setattr(_rows, "IN_MEMORY_ROWS", 100)
    with pytest.raises(ValueError, match="at most 100 rows"):
        RBFNetRegressor().fit(X, y, groups=groups)


@pytest.mark.parametrize("ratio", [0.0, 0.01, 1.0, 1e6])
def test_rows_without_constants_have_independent_noise(ratio):
    rng = np.random.default_rng(0)
    codes, weights = np.sort(rng.integers(0, 5, 30)), rng.uniform(0.5, 2, 30)
    noise = np.diag(1 / weights) + ratio * np.equal.outer(codes, codes)
    T = np.sqrt(weights)[:, None] * without_constants(np.eye(30), codes, weights, ratio)
    np.testing.assert_allclose(T @ noise @ T.T, np.eye(30), atol=1e-7 if ratio > 1 else 1e-12)
    if ratio == 1e6:  # exact constants: what is left is the deviation from the group's mean
        T = without_constants(np.eye(30), codes, weights, ratio)
        np.testing.assert_allclose(T, Groups(codes).centred(np.eye(30), weights), atol=2e-3)
