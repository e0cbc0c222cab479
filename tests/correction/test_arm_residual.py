"""The guarded two-stage model: what it uses, how far it goes, and that it does no harm."""

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_validate

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    JointHarmonicRegressor,
    RBFNetRegressor,
    position_residuals,
)
from sklearn_raacmm.datasets import ArmErrors, make_gauge, make_single_point

ARM = Arm.from_name("aacmm6")
ARCSEC = np.pi / 180 / 3600


def small(**params):
    """A model that is quick to fit."""
    return ArmResidualRegressor(
        ARM,
        harmonics=JointHarmonicRegressor(max_order=4, gravity=False, wobble=False),
        network=RBFNetRegressor(15, length_scale=1.0, alpha=1e-2, degree=-1, shared=True),
        **params,
    )


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


def test_the_stages_add_up(cones):
    theta, y, _, truth = cones
    model = small(use="harmonics+network", fade=0, cap=None).fit(theta, y)
    first = model.linear_model_.predict(theta)[0]
    azimuth = ARM.azimuth(theta)
    radial, tangential, axial = model.network_.predict(theta).T
    second = np.stack(
        [
            radial * np.cos(azimuth) - tangential * np.sin(azimuth),
            radial * np.sin(azimuth) + tangential * np.cos(azimuth),
            axial,
        ],
        axis=1,
    )
    assert_allclose(model.predict(theta), first + second, atol=1e-12)
    assert np.square(first + second - truth).sum() < 0.7 * np.square(first - truth).sum()


def test_it_says_which_model_to_use(cones):
    theta, y, groups, _ = cones
    model = small().fit(theta, y, groups=groups)
    assert model.use_ in ("harmonics", "harmonics+network")
    assert model.check_["model"].tolist() == ["none", "harmonics", "harmonics+network"]
    assert model.check_["mean_mm"][0] == pytest.approx(np.linalg.norm(y, axis=1).mean())
    assert model.check_["gain_mm"][1] > 3 * model.check_["gain_se_mm"][1]
    assert model.check_["gain_mm"][0] == 0


def test_noise_is_not_corrected(cones):
    """Nothing to learn: in most of the cases nothing is used, and never is much harm done."""
    theta, _, groups, _ = cones
    unused = 0
    for seed in range(6):
        y = np.random.default_rng(seed).normal(0, 0.05, (len(theta), 3))
        model = small().fit(theta, y, groups=groups)
        unused += model.use_ == "none"
        prediction = model.predict(theta)
        if model.use_ == "none":
            assert_array_equal(prediction, 0)
        assert np.linalg.norm(prediction, axis=1).mean() < 0.02
    assert unused >= 4


def test_no_correction_is_longer_than_the_cap(cones):
    theta, y, _, _ = cones
    model = small(use="harmonics+network", cap=0.5).fit(theta, y)
    lengths = np.sort(np.linalg.norm(y, axis=1))
    assert model.cap_mm_ == lengths[len(lengths) // 2 - 1]
    far = np.random.default_rng(1).uniform(-3, 3, (500, 6))
    for X in (theta, far):
        assert np.linalg.norm(model.predict(X), axis=1).max() <= model.cap_mm_ * (1 + 1e-12)
    free = clone(model).set_params(cap=None).fit(theta, y)
    assert np.linalg.norm(free.predict(far), axis=1).max() > model.cap_mm_


def test_weights_are_repeats(cones):
    """With the check, the cap and the offsets, as scikit-learn's own check has it without."""
    theta, y, groups, _ = cones
    y = position_residuals(y, groups)
    weights = np.random.default_rng(0).integers(0, 3, len(y))
    repeat = np.repeat(np.arange(len(y)), weights)
    network = RBFNetRegressor(5, length_scale=1.0, alpha=0.1, degree=-1)
    first = JointHarmonicRegressor(max_order=2, offsets=True)
    model = ArmResidualRegressor(ARM, harmonics=first, network=network, n_folds=2, cap=0.9)
    weighted = clone(model).fit(theta, y, sample_weight=weights, groups=groups)
    repeated = clone(model).fit(theta[repeat], y[repeat], groups=groups[repeat])
    assert weighted.cap_mm_ == pytest.approx(repeated.cap_mm_, rel=1e-6)
    for name in weighted.check_.dtype.names[1:]:
        assert_allclose(weighted.check_[name], repeated.check_[name], rtol=1e-6)
    assert_allclose(weighted.predict(theta), repeated.predict(theta), atol=1e-7)


def test_corrections_fade_away_from_the_data(cones):
    theta, y, _, _ = cones
    model = small(use="harmonics+network").fit(theta, y)
    free = clone(model).set_params(fade=0).fit(theta, y)
    shares = [
        fading.share(std)
        for fading, (_, std) in zip(
            model.fadings_,
            [
                model.linear_model_.predict(theta, return_std=True),
                model.network_.predict(theta, return_std=True, with_noise=False),
            ],
            strict=True,
        )
    ]
    assert_allclose(model.fading(theta), np.min(shares, axis=0), rtol=1e-6)
    assert model.fading(theta).mean() > 0.8
    assert model.fading(theta + 1.5).mean() < model.fading(theta).mean()
    assert_array_equal(free.fading(theta), 1)
    first = JointHarmonicRegressor(max_order=1)
    model = ArmResidualRegressor(ARM, harmonics=first, use="harmonics", fade=50.0)
    model.fit(theta[:40], y[:40])
    with pytest.warns(UserWarning, match="60 of 60 poses lie where the model knows little") as seen:
        model.predict(theta[-60:] + 3)
    assert seen[0].filename == __file__


CORNERS = {
    "one side of its base": lambda x, y, z: np.abs(np.arctan2(y, x)),
    "near": lambda x, y, z: x**2 + y**2 + z**2,
    "far": lambda x, y, z: -(x**2 + y**2 + z**2),
    "low": lambda x, y, z: z,
    "high": lambda x, y, z: -z,
}


@pytest.mark.filterwarnings("ignore:.*poses lie where the model knows little")
@pytest.mark.parametrize("corner", CORNERS)
def test_trained_in_one_corner_used_elsewhere_on_another_day(corner):
    """Simulated: a third of the positions teaches; the others are measured 4 K warmer."""
    network = RBFNetRegressor(10, length_scale=1.0, alpha=0.1, degree=-1)
    gains = []
    for mix in ("gravity", "typical", "eccentricity"):
        errors = ArmErrors.from_name(mix)
        warm = replace(errors, warming_k=errors.warming_k + 4.0)
        day, other_day = (
            make_single_point(24, 15, machine=machine, random_state=1) for machine in (errors, warm)
        )
        assert day.arm == other_day.arm
        where = CORNERS[corner](*(day.simulation.positions - day.simulation.machine.shoulder).T)
        trained = np.isin(day.groups, np.argsort(where)[:8])
        for absolute in (False, True):
            y = day.points - day.simulation.true_points if absolute else day.target
            model = ArmResidualRegressor(
                day.arm, harmonics=JointHarmonicRegressor(max_order=8), network=network, n_folds=3
            )
            model.fit(day.data[trained], y[trained], groups=day.groups[trained])
            assert model.linear_model_.offsets != absolute
            elsewhere = ~trained
            left = other_day.points - model.predict(other_day.data)
            left = position_residuals(left[elsewhere], other_day.groups[elsewhere])
            before = np.linalg.norm(other_day.target[elsewhere], axis=1).mean()
            gains.append(1 - np.linalg.norm(left, axis=1).mean() / before)
    assert min(gains) > 0
    assert np.mean(gains) > 0.3


def test_known_lengths_reach_the_first_stage():
    gauge = make_gauge(300, 8, 8, random_state=2)
    known = [(a, b, 300.0, 0.003) for a, b in gauge.pairs]
    first = JointHarmonicRegressor(gauge.arm, max_order=2)
    model = ArmResidualRegressor(gauge.arm, harmonics=first, use="harmonics")
    model.fit(gauge.data, gauge.target, groups=gauge.groups, lengths=known)
    first.fit(gauge.data, gauge.target, groups=gauge.groups, lengths=known)
    assert_array_equal(model.linear_model_.coef, first.coef_)


def test_fading_is_that_of_the_formula(cones):
    theta, y, _, _ = cones
    model = small(use="harmonics", fade=3.0, cap=None).fit(theta, y)
    value, std = model.linear_model_.predict(theta, return_std=True)
    size, doubt = np.square(y).sum(axis=1).mean(), np.square(std).sum(axis=1)
    assert model.fade_ == 3.0
    assert_allclose(model.predict(theta), value * (size / (size + 9 * doubt))[:, None], atol=1e-12)


def test_is_a_scikit_learn_estimator(cones):
    theta, y, groups, _ = cones
    search = GridSearchCV(
        small(use="harmonics"), {"harmonics__max_order": [1, 4]}, cv=GroupKFold(3)
    ).fit(theta, y, groups=groups)
    assert search.best_params_ == {"harmonics__max_order": 4}
    model = search.best_estimator_
    assert_array_equal(pickle.loads(pickle.dumps(model)).predict(theta), model.predict(theta))
    mean, std = model.predict(theta, return_std=True)
    assert_array_equal(mean, model.predict(theta))
    assert std.shape == y.shape
    assert np.all(std > 0)
    with config_context(enable_metadata_routing=True):
        routed = small().set_fit_request(groups=True)
        result = cross_validate(
            routed, theta, y, cv=GroupKFold(3), params={"groups": groups}, return_estimator=True
        )
    assert all(fitted.check_ is not None for fitted in result["estimator"])


def test_parameters_are_left_alone(cones):
    theta, y, _, _ = cones
    model = small(use="harmonics")
    before = clone(model).get_params()
    model.fit(theta, y)
    assert model.harmonics.arm is None
    assert {k: repr(v) for k, v in model.get_params().items()} == {
        k: repr(v) for k, v in before.items()
    }
    assert not hasattr(model.network, "centers_")


@pytest.mark.parametrize("joints", ["all", "pose"])
def test_degrees_are_warned_of_once_and_where_they_come_from(cones, joints):
    theta, y, groups, _ = cones
    model = small(use="harmonics+network", joints=joints, fade=0.5)
    degrees = np.rad2deg(theta)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        model.fit(degrees, y, groups=groups)
    assert [w.filename for w in seen if "degrees" in str(w.message)] == [__file__]
    model.fit(theta, y, groups=groups)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        model.predict(degrees)
    assert [w.filename for w in seen] == [__file__]


def test_a_joint_that_is_locked_is_no_matter():
    # The network ignores what never varied: in the check, too, which gives it the widths it found.
    rng = np.random.default_rng(0)
    angles = rng.uniform(-0.5, 0.5, (80, 6))
    angles[:, 3] = 0.2
    bend = 0.05 * np.cos(3 * angles[:, 1:2]) * [0.0, 0.0, 1.0]
    noise = 0.002 * rng.standard_normal((80, 3))
    model = ArmResidualRegressor(ARM).fit(angles, bend + noise, groups=np.repeat(np.arange(8), 10))
    left = bend - model.predict(angles)
    assert model.use_ != "none"
    assert np.linalg.norm(left, axis=1).mean() < 0.3 * np.linalg.norm(bend, axis=1).mean()


@pytest.mark.parametrize("model", [ArmResidualRegressor(ARM), JointHarmonicRegressor(ARM)])
def test_positions_are_not_taken_for_weights(cones, model):
    theta, y, groups, _ = cones
    with pytest.raises(TypeError, match="positional argument"):
        model.fit(theta, y, groups)


def test_positions_at_one_place_cannot_be_left_out():
    angles = np.tile([[0.1, -0.4, 0.9, 0.2, 0.7, -0.3]], (30, 1))
    residuals = 0.05 * np.random.default_rng(0).standard_normal((30, 3))
    model = ArmResidualRegressor(ARM).fit(angles, residuals, groups=np.repeat(np.arange(6), 5))
    assert model.check_ is None
