"""Outliers in the targets: Tukey's biweight."""

import numpy as np
import pytest
from scipy.stats import median_abs_deviation
from sklearn.datasets import make_friedman1

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network._fit import NORMAL_SQUARE
from sklearn_raacmm.utils import TUKEY_CUT, Finding


def truth(X):
    return np.sin(3 * X[:, 0]) + X[:, 1] ** 2


def table(share, n=250):
    """Rows, targets, the truth, and which of the targets are far off."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (n, 2))
    f = truth(X)
    y = f + 0.05 * rng.standard_normal(n)
    bad = rng.random(n) < share
    y[bad] += rng.normal(0, 5, bad.sum())
    return X, y, f, bad


def rms(model):
    X = np.random.default_rng(99).uniform(-1, 1, (1000, 2))
    return np.sqrt(np.mean((model.predict(X) - truth(X)) ** 2))


def test_outliers_cost_little():
    X, y, f, bad = table(0.1)
    clean = RBFNetRegressor(random_state=0).fit(X, f + (y - f) * ~bad)
    robust = RBFNetRegressor(random_state=0).fit(X, y)
    plain = RBFNetRegressor(loss="squared", random_state=0).fit(X, y)
    assert rms(robust) < 2 * rms(clean)
    assert rms(plain) > 3 * rms(robust)
    # An error that is no larger than the noise is no outlier.
    assert np.mean(robust.row_weight_[bad] == 0) > 0.85
    assert np.mean(robust.row_weight_[~bad] > 0.5) > 0.98
    assert np.sqrt(robust.noise_variance_) == pytest.approx(0.05, rel=0.15)


@pytest.mark.parametrize("seed", [1, 7, 13])
def test_slips_to_one_side_that_a_function_can_follow_are_found(seed):
    """After one fit without the farthest of them the others still bend it."""
    X, f = make_friedman1(150, noise=0.0, random_state=seed)
    rng = np.random.default_rng(seed)
    slips = rng.permutation(150)[:5]
    y = f + rng.standard_normal(150)
    y[slips] += 40
    model = RBFNetRegressor(random_state=0).fit(X, y)
    np.testing.assert_array_equal(np.flatnonzero(model.row_weight_ == 0), np.sort(slips))
    assert np.sqrt(np.mean(np.square(model.predict(X) - f))) < 1.0


def test_without_outliers_nothing_changes():
    X, y, *_ = table(0)
    plain = RBFNetRegressor(loss="squared", random_state=0).fit(X, y)
    robust = RBFNetRegressor(random_state=0).fit(X, y)
    np.testing.assert_array_equal(robust.row_weight_, 1.0)
    np.testing.assert_array_equal(robust.predict(X), plain.predict(X))
    assert not hasattr(plain, "row_weight_")


def test_constant_of_the_noise_by_quadrature():
    z = np.linspace(-TUKEY_CUT, TUKEY_CUT, 200_001)
    density, weight = np.exp(-0.5 * z**2), (1 - (z / TUKEY_CUT) ** 2) ** 2
    expected = np.sum(density * weight * z**2) / np.sum(density * weight)
    assert expected == pytest.approx(NORMAL_SQUARE, rel=1e-5)


def test_deviations_hold_for_new_rows():
    """Of rows with outliers as many and as large as those of the fit."""
    X, y, *_ = table(0.1, 400)
    model = RBFNetRegressor(random_state=0).fit(X, y)
    rng = np.random.default_rng(5)
    T = rng.uniform(-1, 1, (4000, 2))
    left = truth(T) + rng.choice(y - truth(X), 4000) - model.predict(T)
    std, near = (model.predict(T, True, with_outliers=with_)[1] for with_ in (True, False))
    assert np.mean(np.square(left / std)) == pytest.approx(1, abs=0.2)
    assert np.median(near) < 0.1 < std.min()
    of_mean = [model.predict(T, True, with_noise=False, with_outliers=w)[1] for w in (True, False)]
    np.testing.assert_array_equal(*of_mean)
    added = model.predict(T[:3], return_cov=True)[1].diagonal() - near[:3] ** 2
    np.testing.assert_allclose(added, float(model.networks_[0].outlier_variance[0]), rtol=1e-9)


def test_heavy_tails_are_named_with_what_helps():
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (300, 2))
    y = np.exp(2 * np.sin(3 * X[:, 0]) + 0.7 * rng.standard_normal(300))
    with Finding.collected() as found:
        model = RBFNetRegressor(random_state=0).fit(X, y)
    (finding,) = found
    assert finding.code == "heavy-tails"
    left = y - model.predict(X)
    far = np.abs(left) > 5.5 * median_abs_deviation(
        left, center=lambda a, axis: 0.0, scale="normal"
    )
    np.testing.assert_array_equal(finding.rows, np.flatnonzero(far))
    assert "PowerTransformer" in finding.advice
    # Rows are numbered as they were given, those without weight among them.
    unused = np.ones(10)
    with Finding.collected() as found:
        weights = np.append(0 * unused, np.ones(300))
        again = RBFNetRegressor(random_state=0)
        again.fit(np.vstack([X[:10] + 3, X]), np.append(unused, y), sample_weight=weights)
    np.testing.assert_array_equal(found[0].rows, 10 + np.flatnonzero(far))
    # Errors that are not normal are something else.
    with Finding.collected() as found:
        noise = 0.1 * rng.standard_t(3, 300)
        RBFNetRegressor(random_state=0).fit(X, np.sin(3 * X[:, 0]) + noise)
    assert not found
