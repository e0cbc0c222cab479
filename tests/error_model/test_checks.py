"""Checks of what the linear model is fitted on: offsets that are not used, ranges, no residuals."""

import numpy as np
import pytest

from sklearn_raacmm import Arm, ArmResidualRegressor, position_residuals
from sklearn_raacmm.utils import Groups

ARM = Arm.from_name("aacmm6")
RNG = np.random.default_rng(0)
ANGLES = RNG.uniform(-2, 2, (300, 6))
GROUPS = np.arange(300) // 10
NOISE = 0.05 * RNG.normal(size=(300, 3))


def model(**options):
    return ArmResidualRegressor(ARM, orders=1, causes=["kinematics"], **options)


def test_positions_of_one_pose_each_have_no_offsets():
    """Their deviations from themselves are rounding; means of one row say nothing of a mean."""
    rng = np.random.default_rng(1)
    for weights in (np.ones(300), rng.uniform(0.1, 3, 300), np.full(300, 0.3)):
        groups = rng.permutation(300)
        assert Groups(groups).share_of_means(NOISE, weights) == np.inf
        found = model().fit(ANGLES, NOISE, groups=groups, sample_weight=weights)
        assert not found.offsets_
        assert found.noise_sd_ == pytest.approx(0.05, rel=0.1)


@pytest.mark.filterwarnings("ignore:Within a position")  # of noise
@pytest.mark.parametrize("scale", [0.2, 10.0])
def test_small_weights_do_not_decide_on_offsets(scale):
    weights = np.full(300, scale)
    for y, offsets in ((NOISE, False), (position_residuals(NOISE, GROUPS), True)):
        given = {"groups": GROUPS, "sample_weight": weights}
        found = model().fit(ANGLES, y, accept="rows-unrelated", **given)
        assert found.offsets_ is offsets


@pytest.mark.parametrize("size", [0.0, 1e-200])
def test_noise_is_not_made_from_nothing(size):
    found = model().fit(ANGLES[:40], size * NOISE[:40])
    assert found.noise_sd_ < 1e-10
    mean, std = found.predict(ANGLES, return_std=True)
    assert np.abs(mean).max() < 1e-25
    assert np.all(np.isfinite(std))
    assert std.max() < 1e-8


@pytest.mark.filterwarnings("ignore:.*they have no weight")  # nothing is noise
@pytest.mark.parametrize("scale", [1 / 300, 1e-200, 1e4, 1e6])
def test_weights_that_are_no_repeats_are_named(scale):
    """With inverse variances nothing would be noise; too large ones ended in a LinAlgError."""
    weights = scale * np.arange(1.0, 41)
    estimator = ArmResidualRegressor(ARM, orders=2)
    with pytest.warns(UserWarning, match=r"the 40 rows are worth .* rows"):
        estimator.fit(ANGLES[:40], NOISE[:40], sample_weight=weights)
    with pytest.raises(ValueError, match=r"sample_weight holds 4e\+10, but a weight"):
        estimator.fit(ANGLES[:40], NOISE[:40], sample_weight=1e9 * np.arange(1.0, 41))


@pytest.mark.filterwarnings("ignore:The pose of row 10 has 30 of all weights")
def test_residuals_of_which_most_are_zero_do_not_overflow():
    """Their median distance is 0, so that no scale tells who is far off: all rows count."""
    y = np.zeros((40, 3))
    y[:10] = 0.1
    angles = ANGLES[:40].copy()
    angles[10:] = 0.0
    fitted = ArmResidualRegressor(ARM, orders=3, causes=["gravity", "wobble"])
    fitted.fit(angles, y, accept="weight-of-one-pose")
    assert np.isfinite(fitted.predict(ANGLES)).all()
    np.testing.assert_array_equal(fitted.pose_weight_ <= 1, True)
