"""Guards of the arm's model: judged where it was left out, faded, and what changes nothing."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone

from sklearn_raacmm import Arm, ArmResidualRegressor, position_residuals
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.error_model import Fading, judge
from sklearn_raacmm.utils import Finding

ARM = Arm.from_name("aacmm6")
ARCSEC = np.pi / 180 / 3600


def small(**options):
    """A model that is quick to fit."""
    return ArmResidualRegressor(ARM, orders=4, causes=["kinematics"], **options)


@pytest.fixture(scope="module")
def cones():
    """Simulated: 24 positions by 20 poses; an eccentric encoder, a smooth error, noise."""
    rng = np.random.default_rng(0)
    centre = rng.uniform(-0.8, 0.8, (24, 6))
    theta = np.repeat(centre, 20, axis=0) + rng.uniform(-0.4, 0.4, (480, 6))
    groups = np.repeat(np.arange(24), 20)
    error = np.zeros_like(theta)
    error[:, 3] = 12 * ARCSEC * np.cos(3 * theta[:, 3])
    truth = np.einsum("nij,nj->ni", ARM.jacobian(theta), error)
    truth[:, 2] += 0.03 * np.exp(-np.square(theta[:, [2, 4]]).sum(axis=1))
    return theta, truth + rng.normal(0, 0.01, truth.shape), groups, truth


def test_a_correction_that_helps_is_judged_by_what_was_left_out(cones):
    theta, y, groups, _ = cones
    model = small().fit(theta, y, groups=groups)
    found = model.judgement_
    assert model.helps_
    assert found.helps
    assert found.n_positions == 24
    # Without correction these are the residuals themselves, position by position of equal size.
    assert found.mean_before_mm == pytest.approx(np.linalg.norm(y, axis=1).mean())
    assert found.mean_before_mm - found.mean_after_mm > 3 * found.gain_se_mm
    # Less than at the training poses, and about what new noise would show there.
    left = np.linalg.norm(y - model.predict(theta), axis=1).mean()
    assert left < found.mean_after_mm < 1.3 * left
    assert small().fit(theta, y).judgement_ is None  # nobody said what a position is


def test_robust_weights_alone_are_those_of_the_whole_fit(cones):
    """As `learn_correction` asks for them where it looks for outliers."""
    theta, y, groups, _ = cones
    y = y + np.where(np.arange(len(y))[:, None] % 50 == 0, 1.0, 0.0)
    whole, weights = small(), small()
    weights._judged = False
    for model in (whole, weights):
        model.fit(theta, y, groups=groups)
    assert_array_equal(weights.pose_weight_, whole.pose_weight_)
    assert weights.pose_weight_.min() == 0
    assert whole.judgement_ is not None
    assert weights.judgement_ is None


def test_noise_is_not_corrected(cones):
    """Nothing to learn: no harm is done, and where nothing is used everyone is warned."""
    theta, _, groups, _ = cones
    for seed in range(4):
        y = np.random.default_rng(seed).normal(0, 0.05, (len(theta), 3))
        model = small().fit(theta, y, groups=groups)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            prediction, std = model.predict(theta, return_std=True)
        assert any("The correction is 0" in str(w.message) for w in caught) != model.helps_
        assert np.linalg.norm(prediction, axis=1).mean() < 0.02
        assert np.all(std > 0)


def test_what_does_harm_elsewhere_is_refused():
    """Each position errs by an angle of its own, which the next one does not have."""
    rng = np.random.default_rng(1)
    theta = np.repeat(rng.uniform(-1.5, 1.5, (6, 6)), 10, axis=0)
    theta += rng.uniform(-0.05, 0.05, theta.shape)
    groups = np.repeat(np.arange(6), 10)
    error = 40 * ARCSEC * rng.normal(size=(6, 6))[groups]
    y = np.einsum("nij,nj->ni", ARM.jacobian(theta), error)
    y += rng.normal(0, 0.002, y.shape)
    model = small(offsets=False).fit(theta, y, groups=groups)
    fitted = model.linear_model_.predict(theta)[0]
    assert np.linalg.norm(y - fitted, axis=1).mean() < 0.5 * np.linalg.norm(y, axis=1).mean()
    assert model.fading_.most < 0.5
    with Finding.ignored():  # it may be refused altogether
        assert np.linalg.norm(model.predict(theta)) < 0.5 * np.linalg.norm(fitted)


def test_the_share_is_of_the_doubt():
    """Three paths whose errors no column describes: between known positions all of it is right.

    Blocks of neighbouring positions left out are not as well known as a position between others.
    """
    rng = np.random.default_rng(0)
    starts, position = rng.uniform(-1.5, 1.5, (3, 6)), np.repeat(np.arange(36), 8)
    way = np.linspace(0, 1, 96)[:, None] * rng.uniform(-0.6, 0.6, (3, 1, 6))
    theta = (starts[:, None] + way).reshape(-1, 6) + rng.uniform(-0.05, 0.05, (288, 6))
    turns = 20 * ARCSEC * np.cos(theta) * np.sin(4 * np.roll(theta, 1, axis=1))
    y = np.einsum("nij,nj->ni", ARM.jacobian(theta), turns) + rng.normal(
        0, 0.002, theta[:, :3].shape
    )
    known = position % 3 != 1
    model = small().fit(theta[known], y[known], groups=position[known])
    whole, _, doubt = model.linear_model_.predict_with_doubt(theta[~known])
    fading = model.fading_
    alone, used = (
        np.linalg.norm(y[~known] - one)
        for one in (fading.most * fading.far * whole, model.predict(theta[~known]))
    )
    left = np.linalg.norm(y[~known] - whole)
    assert fading.far < 1
    assert used < 1.02 * left < 0.9 * alone < 0.2 * np.linalg.norm(y[~known])
    assert_allclose(
        model.fading(theta[~known]), fading.found(doubt), rtol=0.01
    )  # Wiener's is almost 1
    assert fading.found(np.array([0.0]))[0] == pytest.approx(fading.most)


def test_intervals_of_few_positions_with_offsets():
    """Three cones: as wide as their number asks for, or where nothing helps as the residuals."""
    test = make_single_point(12, 20, random_state=1)
    known = test.groups < 3
    model = ArmResidualRegressor(test.arm)
    model.fit(test.data[known], test.target[known], groups=test.groups[known])
    linear = model.linear_model_
    assert (linear.std_scale, linear.noise_scale) == (1 + 1 / 3, 1 + 1 / 3)
    errors = test.target[~known] - model.predict(test.data[~known])
    errors = np.abs(position_residuals(errors, test.groups[~known]))
    std = model.predict(test.data[~known], return_std=True, with_noise=True)[1]
    assert np.mean(errors < 1.96 * std) > 0.9
    assert 0.4 < np.sqrt(np.mean(np.square(errors / std))) < 1.0  # and they are no wider than that
    model.fading_ = replace(model.fading_, most=0.0)
    least = np.linalg.norm(test.target[known]) / np.sqrt(3 * known.sum())
    with pytest.warns(UserWarning, match="The correction is 0"):
        std = model.predict(test.data[known], return_std=True)[1]
    assert std.min() == pytest.approx(least, rel=0.2)  # robust weights leave some rows out


@pytest.mark.parametrize(("n_places", "n_positions"), [(40, 1), (1, 6)])
def test_one_position_or_one_place_is_not_left_out(cones, n_places, n_positions):
    theta, y, *_ = cones
    angles = np.resize(theta[:n_places], (40, 6))
    model = small().fit(angles, y[:40], groups=np.arange(40) % n_positions)
    assert model.judgement_ is None
    assert model.helps_


def test_fading_is_that_of_the_formula(cones):
    theta, y, _, _ = cones
    model = small(fade=3.0).fit(theta, y)
    value, std = model.linear_model_.predict(theta, return_std=True)
    size, doubt = np.square(y).sum(axis=1).mean(), np.square(std).sum(axis=1)
    share = size / (size + 9 * doubt)
    assert_allclose(model.predict(theta), value * share[:, None], atol=1e-12)
    assert_allclose(model.fading(theta), share)
    assert_array_equal(model.predict(theta, return_std=True)[0], model.predict(theta))


def test_corrections_fade_away_from_the_data(cones):
    theta, y, _, _ = cones
    model = small().fit(theta, y)
    assert model.fading(theta).mean() > 0.8
    assert model.fading(theta + 1.5).mean() < model.fading(theta).mean()
    assert_array_equal(small(fade=0).fit(theta, y).fading(theta), 1)
    model = small(fade=50.0).fit(theta[:40], y[:40])
    with pytest.warns(UserWarning, match="60 of 60 poses lie where the model knows little") as seen:
        model.predict(theta[-60:] + 3)
    assert seen[0].filename == __file__


@pytest.mark.filterwarnings("ignore:Within a position")  # whatever the points are
@pytest.mark.parametrize("offsets", [False, True])
def test_rows_of_weight_0_change_nothing(cones, offsets):
    """Whatever is in them: positions of their own, slipped poses, other labels."""
    theta, y, groups, _ = cones
    y = position_residuals(y, groups)
    rng, rows = np.random.default_rng(0), groups < 10
    model = small(offsets=offsets)
    accepted = {"accept": "rows-unrelated"}
    expected = clone(model).fit(theta[rows], y[rows], groups=groups[rows], **accepted)
    new = rng.uniform(-2, 2, (150, 6))
    X = np.vstack([new, theta[rows]])
    Y = np.vstack([rng.normal(0, 1.0, (150, 3)), y[rows]])
    labels = np.concatenate([rng.integers(0, 40, 150), groups[rows]])
    weights = np.repeat([0.0, 1.0], [150, rows.sum()])
    found = clone(model).fit(X, Y, sample_weight=weights, groups=labels, **accepted)
    assert_array_equal(found.pose_weight_, np.r_[np.zeros(150), expected.pose_weight_])
    assert found.judgement_ == expected.judgement_
    assert found.fading_ == expected.fading_
    for one, other in zip(
        found.predict(theta, return_std=True), expected.predict(theta, return_std=True), strict=True
    ):
        assert_array_equal(one, other)


def judged(y, correction, positions, **options):
    n = len(y)
    fading = Fading(size_mm=1.0, factor=0.0)
    return judge(
        y,
        correction,
        np.zeros(n),
        fading,
        np.ones(n),
        lambda values, _: values,
        positions,
        **options,
    )


def test_the_share_is_that_of_least_squares_with_less_wrong_of_more_positions():
    rng = np.random.default_rng(0)
    correction, positions = rng.normal(size=(200, 3)), np.arange(200) // 10
    y = 0.6 * correction + 0.1 * rng.normal(size=(200, 3))
    slope = np.linalg.lstsq(correction.reshape(-1, 1), y.ravel(), rcond=None)[0].item()
    fading, found = judged(y, correction, positions)
    # What is wrong over what is right: the models that were judged had 19 of the 20 positions.
    assert 1 / fading.most - 1 == pytest.approx((1 / slope - 1) * 0.95**4)
    assert found.helps
    assert found.mean_after_mm < np.linalg.norm(y - correction, axis=1).mean()
    for factor, expected in ((-1.0, 0.0), (5.0, 1.0)):
        fading, found = judged(factor * y, correction, positions)
        assert fading.most == expected
        assert found.helps == (expected > 0)
    # A share that was known moves only as far as it is contradicted.
    assert judged(y, correction, positions, before=slope + 1e-3)[0].most == slope + 1e-3
    assert slope < judged(y, correction, positions, before=1.0)[0].most < slope + 0.05


def test_with_fewer_than_four_positions_each_has_to_gain():
    correction, positions = np.random.default_rng(1).normal(size=(30, 3)), np.arange(30) // 10
    y = 0.8 * correction
    assert judged(y, correction, positions)[0].most == 1.0
    y[20:] *= -1
    assert judged(y, correction, positions)[0].most == 0.0
