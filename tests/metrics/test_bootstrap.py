"""Bootstrap intervals of the repeatability against the chi-square distribution."""

import numpy as np
import pytest
from scipy.stats import chi2

from sklearn_raacmm.metrics import repeatability_interval, single_point_repeatability


def test_as_long_as_those_of_normal_deviations():
    rng = np.random.default_rng(0)
    n, sd = 40, np.array([0.3, 1.2])
    groups = np.repeat(["far", "near"], n)
    free = 3 * (n - 1)
    expected = 2 * np.sqrt(3) * sd * np.ptp(np.sqrt(chi2.ppf([0.025, 0.975], free) / free))
    length = np.zeros(2)
    for seed in range(8):
        points = np.repeat(sd, n)[:, None] * rng.normal(size=(2 * n, 3))
        low, high = repeatability_interval(points, groups, aggregate=None, random_state=seed).T
        value = single_point_repeatability(points, groups, aggregate=None)
        assert np.all((low < value) & (value < high))
        length += (high - low) / 8
    np.testing.assert_allclose(length, expected, rtol=0.12)


def test_the_mean_of_positions_is_known_better_and_less_probable_is_shorter():
    rng = np.random.default_rng(1)
    groups = np.repeat(np.arange(9), 20)
    points = rng.normal(size=(180, 3))
    single = np.ptp(repeatability_interval(points, groups, aggregate=None), axis=1)
    mean = np.ptp(repeatability_interval(points, groups))
    assert mean == pytest.approx(single.mean() / 3, rel=0.15)
    assert np.ptp(repeatability_interval(points, groups, probability=0.5)) < 0.5 * mean
    one = repeatability_interval(points[:20])
    np.testing.assert_allclose(one, repeatability_interval(points[:20], ["a"] * 20))


def test_many_points_are_drawn_block_by_block(monkeypatch):
    points = np.random.default_rng(2).normal(size=(60, 3))
    groups = np.repeat([0, 1, 2], 20)
    whole = repeatability_interval(points, groups, aggregate=None, n_resamples=50)
    monkeypatch.setattr("sklearn_raacmm.metrics._bootstrap._ROWS_AT_ONCE", 130)
    blocks = repeatability_interval(points, groups, aggregate=None, n_resamples=50)
    np.testing.assert_allclose(blocks, whole)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n_resamples": 1}, "n_resamples"),
        ({"groups": [0, 0, 1]}, "hold a single point"),
        ({"statistic": "3s"}, "statistic='3s'"),
    ],
)
def test_bad_input_is_named(options, message):
    with pytest.raises(ValueError, match=message):
        repeatability_interval(np.eye(3), **options)
