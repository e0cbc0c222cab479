"""Numbers that decide something, recomputed from what they are said to be."""

import numpy as np
import pytest
from scipy.stats import sem

from sklearn_raacmm import ArmResidualRegressor, JointHarmonicRegressor, RBFNetRegressor
from sklearn_raacmm.correction._check import verdict
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


def test_the_last_model_is_taken_where_the_check_does_not_choose():
    errors = np.array([[0.10, 0.12, 0.11], [0.05, 0.04, 0.06], [0.20, 0.30, 0.25]])
    table, chosen = verdict(errors, ("none", "harmonics", "harmonics+network"), choose=False)
    assert chosen == 2
    assert verdict(errors, ("none", "harmonics", "harmonics+network"), choose=True)[1] == 1
    np.testing.assert_allclose(table["gain_se_mm"], [sem(errors[0] - e) for e in errors])
