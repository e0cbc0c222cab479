"""The guarded two-stage model: what it uses, how far it goes, and that it does no harm."""

import pickle

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
from sklearn_raacmm.datasets import make_single_point

ARM = Arm.from_name("aacmm6")
ARCSEC = np.pi / 180 / 3600


def small(**params):
    """A model that is quick to fit."""
    return ArmResidualRegressor(
        ARM,
        harmonics=JointHarmonicRegressor(n_harmonics=4, gravity=False, wobble=False),
        network=RBFNetRegressor(15, length_scale=1.0, alpha=1e-2, degree=-1),
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
    model = small(use="harmonics+network", fade=False, cap=None).fit(theta, y)
    first = model.harmonics_.predict(theta)
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
    assert np.square(first + second - truth).sum() < 0.6 * np.square(first - truth).sum()


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
    assert model.cap_mm_ == pytest.approx(np.median(np.linalg.norm(y, axis=1)))
    far = np.random.default_rng(1).uniform(-3, 3, (500, 6))
    for X in (theta, far):
        assert np.linalg.norm(model.predict(X), axis=1).max() <= model.cap_mm_ * (1 + 1e-12)
    free = clone(model).set_params(cap=None).fit(theta, y)
    assert np.linalg.norm(free.predict(far), axis=1).max() > model.cap_mm_


def test_corrections_fade_away_from_the_data(cones):
    theta, y, _, _ = cones
    model = small(use="harmonics+network", cap=None).fit(theta, y)
    free = clone(model).set_params(fade=False).fit(theta, y)
    share = [
        np.linalg.norm(model.predict(X), axis=1).sum()
        / np.linalg.norm(free.predict(X), axis=1).sum()
        for X in (theta, theta + 1.5)
    ]
    assert share[0] > 0.8
    assert share[1] < share[0]


def test_joint_fit_lets_the_network_keep_what_is_its_own(cones):
    """The first stage's coefficients are nearer the truth when it knows of the smooth error."""
    theta, y, _, _ = cones
    errors = []
    for joint in (False, True):
        model = small(use="harmonics+network", joint=joint).fit(theta, y)
        table = model.harmonics_.harmonics_
        third = table[(table["joint"] == 4) & (table["order"] == 3)]
        errors.append(np.hypot(third["cos_arcsec"] - 12, third["sin_arcsec"])[0])
    assert errors[1] < errors[0] + 0.1
    assert errors[1] < 1.5


def test_another_corner():
    """Simulated arm, trained on one side of its base and used on the other."""
    before, after = [], []
    for seed in (1, 2):
        test = make_single_point(n_positions=16, n_poses=25, random_state=seed)
        azimuth = ARM.azimuth(test.data)
        side = np.abs(azimuth) < np.pi / 2
        side = np.bincount(test.groups, side)[test.groups] > 12
        if not 100 < side.sum() < 300:
            continue
        model = ArmResidualRegressor(test.arm, use="harmonics")
        model.fit(test.data[side], test.target[side], groups=test.groups[side])
        left = test.target[~side] - model.predict(test.data[~side])
        left = position_residuals(left, test.groups[~side])
        before.append(np.linalg.norm(test.target[~side], axis=1).mean())
        after.append(np.linalg.norm(left, axis=1).mean())
    assert before
    assert np.sum(after) < 0.9 * np.sum(before)


def test_is_a_scikit_learn_estimator(cones):
    theta, y, groups, _ = cones
    search = GridSearchCV(
        small(use="harmonics"), {"harmonics__n_harmonics": [1, 4]}, cv=GroupKFold(3)
    ).fit(theta, y, groups=groups)
    assert search.best_params_ == {"harmonics__n_harmonics": 4}
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
