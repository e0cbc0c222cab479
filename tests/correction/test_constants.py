"""Numbers that decide something, recomputed from what they are said to be."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm, sem

from sklearn_raacmm import ArmResidualRegressor, JointHarmonicRegressor, RBFNetRegressor
from sklearn_raacmm.correction._check import verdict
from sklearn_raacmm.correction._scores import _coverage
from sklearn_raacmm.datasets import make_single_point


def test_the_cap_of_positions_with_offsets_is_three_times_the_fitted_corrections():
    data = make_single_point(6, 8, random_state=0)
    model = ArmResidualRegressor(
        data.arm,
        harmonics=JointHarmonicRegressor(max_order=1, gravity=False, offsets=True),
        network=RBFNetRegressor(4, length_scale=1.0, alpha=0.1, degree=-1),
        use="harmonics+network",
        fade=0,
        cap=0.5,
    )
    free = ArmResidualRegressor(**{**model.get_params(deep=False), "cap": None})
    model.fit(data.data, data.target, groups=data.groups)
    own = free.fit(data.data, data.target, groups=data.groups).predict(data.data)
    median = {"q": 0.5, "method": "inverted_cdf"}
    of_data = np.quantile(np.linalg.norm(data.target, axis=1), **median)
    of_fit = 3 * np.quantile(np.linalg.norm(own, axis=1), **median)
    assert of_fit > of_data
    assert model.cap_mm_ == pytest.approx(of_fit, rel=1e-12)


def test_coverage_counts_what_lies_inside_with_the_factor_of_the_other_folds():
    rng = np.random.default_rng(0)
    std = rng.uniform(0.1, 2, (4000, 3))
    left = 2.5 * std * rng.standard_normal((4000, 3))
    folds = np.split(np.arange(4000), 5)
    share, factor = _coverage(left, std, folds)
    assert factor == pytest.approx(2.5, rel=0.04)  # two standard deviations of the quantile
    assert share == pytest.approx(0.95, abs=0.01)
    # In one fold all errors are three times as large. Its factor comes from the others: that of
    # the others, from a mixture in which it is a quarter.
    left[folds[0]] *= 3

    def inside(z):
        return 2 * norm.cdf(z) - 1

    wide = brentq(lambda z: 0.75 * inside(z) + 0.25 * inside(z / 3) - 0.95, 1, 10)
    expected = (inside(norm.ppf(0.975) / 3) + 4 * inside(wide)) / 5
    assert _coverage(left, std, folds)[0] == pytest.approx(expected, abs=0.01)


def test_the_last_model_is_taken_where_the_check_does_not_choose():
    errors = np.array([[0.10, 0.12, 0.11], [0.05, 0.04, 0.06], [0.20, 0.30, 0.25]])
    table, chosen = verdict(errors, ("none", "harmonics", "harmonics+network"), choose=False)
    assert chosen == 2
    assert verdict(errors, ("none", "harmonics", "harmonics+network"), choose=True)[1] == 1
    np.testing.assert_allclose(table["gain_se_mm"], [sem(errors[0] - e) for e in errors])
