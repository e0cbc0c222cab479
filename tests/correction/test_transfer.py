"""A new arm that starts from earlier arms of the same make: trust where it is due."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from sklearn_raacmm import Arm, ArmResidualRegressor, RBFNetRegressor
from sklearn_raacmm.correction._change import _pooled, transferred_model

ARM = Arm.from_name("ur10", probe=(0, 0, 93))
ARCSEC = np.pi / 180 / 3600
OPTIONS = {"orders": 60, "causes": ["gravity", "kinematics"]}


def errors(angles, arm, gear=50, yields=40):
    """Of one arm of a make: gears and compliance are common, phases are its own."""
    turn = np.zeros_like(angles)
    turn[:, 1] = 12 * np.cos(gear * angles[:, 1] - arm) + 15 * np.cos(angles[:, 1] - 2 * arm)
    turn[:, 2] = 8 * np.cos(gear * angles[:, 2] - 3 * arm)
    jacobian = ARM.jacobian(angles)
    turn += yields * jacobian[:, 2] / 1200  # the torque of a weight at the probe
    return np.einsum("nij,nj->ni", jacobian, turn * ARCSEC)


def rows(n, seed, arm, noise_mm=0.02, **make):
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-2, 2, (n, 6))
    return angles, errors(angles, arm, **make) + rng.normal(0, noise_mm, (n, 3))


@pytest.fixture(scope="module")
def earlier():
    return [ArmResidualRegressor(ARM, **OPTIONS).fit(*rows(250, i, i)) for i in range(3)]


def left(model, arm, **make):
    angles, true = rows(300, 99, arm, noise_mm=0, **make)
    return np.linalg.norm(true - model.predict(angles), axis=1).mean()


def alone(n, **make):
    return ArmResidualRegressor(ARM, **OPTIONS).fit(*rows(n, 7, 7, **make))


@pytest.mark.parametrize(
    ("n", "share"), [(20, 0.8), pytest.param(40, 0.6, marks=pytest.mark.exhaustive)]
)
def test_few_poses_of_a_new_arm_are_enough(earlier, n, share):
    new = transferred_model(earlier, ARM, *rows(n, 7, 7))
    assert left(new, 7) < share * left(alone(n), 7)
    (entry,) = new.updates_
    assert (entry["n_poses"], entry["n_arms"]) == (n, 3)
    assert entry["gain_nats"] > 0
    assert all(not hasattr(model, "updates_") for model in earlier)


def test_a_misleading_make_is_not_believed(earlier):
    """Other gears, and joints that yield the other way: the result is that of the poses alone."""
    make = {"gear": 37, "yields": -120}
    X, y = rows(40, 7, 7, **make)
    new = transferred_model(earlier, ARM, X, y)
    assert new.updates_[0]["gain_nats"] < 0
    assert new.updates_[0]["tau"] == {}
    assert_allclose(new.predict(X), alone(40, **make).predict(X), rtol=0, atol=1e-12)


def test_many_poses_are_a_fit_of_their_own(earlier):
    # 0.0050 and 0.0045 mm: to a tenth of the noise.
    assert left(transferred_model(earlier, ARM, *rows(600, 7, 7)), 7) < left(alone(600), 7) + 2e-3


ORDER = {"causes": [], "orders": [[], [], [1], [], [], []]}


def of_joint_3(n, seed, arcsec, noise_mm):
    """Poses of an arm whose encoder 3 is eccentric, and nothing else."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-2, 2, (n, 6))
    turn = np.zeros_like(angles)
    turn[:, 2] = arcsec * np.cos(angles[:, 2])
    y = np.einsum("nij,nj->ni", ARM.jacobian(angles), turn * ARCSEC)
    return angles, y + rng.normal(0, noise_mm, y.shape)


def test_prior_against_the_textbook():
    """Two models of one coefficient pair each: mean and variance by hand."""
    of_both = (of_joint_3(200, seed, size, 1e-4) for seed, size in ((0, 10.0), (1, 14.0)))
    models = [ArmResidualRegressor(ARM, **ORDER).fit(*data) for data in of_both]
    start = _pooled([model.linear_model_ for model in models], models[0].linear_model_.layout)
    # Squares of cosine and sine together: scatter 2 * 2^2 / 2, guess half of (100 + 196) / 4.
    variance = (4.0 + 0.5 * 74.0) / 2
    common = 0.5 * 12.0**2 - variance / 2
    trust = common / (common + variance / 2)
    assert_allclose(start.coef, [trust * 12.0, 0.0], atol=0.05)
    assert_allclose(np.diag(start.half @ start.half.T), variance * (1 + trust / 2), rtol=0.01)


@pytest.fixture
def credulous(monkeypatch):
    """Earlier arms are believed whatever the evidence, and used as a whole."""
    monkeypatch.setattr("sklearn_raacmm.correction._change.LEAST_GAIN_NATS", -np.inf)
    monkeypatch.setattr(
        "sklearn_raacmm.correction._change.Change.judged", lambda _, fading, weights: (fading, None)
    )


def test_gain_is_that_of_two_normal_densities(credulous):
    """Models of one order of joint 3; orders 1 and 2 of every joint may appear. By hand."""
    of_both = (of_joint_3(100, seed, size, 0.01) for seed, size in ((0, 10.0), (1, 11.0)))
    earlier = [ArmResidualRegressor(ARM, **ORDER).fit(*data) for data in of_both]
    angles, y = of_joint_3(20, 7, 10.5, 0.01)
    (entry,) = transferred_model(earlier, ARM, angles, y).updates_
    start = _pooled([model.linear_model_ for model in earlier], earlier[0].linear_model_.layout)
    alone = ArmResidualRegressor(ARM, **ORDER).fit(angles, y)
    jacobian, first = ARM.jacobian(angles), np.exp(1j * angles)
    parts = [part(turns) for turns in (first, first**2) for part in (np.real, np.imag)]
    waves = np.stack([jacobian * part[:, None] * ARCSEC for part in parts], axis=3)
    # Base and tool may be 5 mm off; a turn of the base by as much at the arm's reach.
    points, reach = ARM.forward(angles), np.hypot(ARM.a, ARM.d).sum() + 93
    place = [np.cross(axis, points) / reach for axis in np.eye(3)]
    place += [np.broadcast_to(axis, points.shape) for axis in np.eye(3)]
    place = np.concatenate([np.stack(place, 2), ARM.frames(angles)[:, -1, :3, :3]], axis=2)
    place = place.reshape(60, 9)

    def log_density(columns, mean, covariance, noise_sd):
        A = columns.reshape(60, -1)
        S = A @ covariance @ A.T + 25 * place @ place.T + noise_sd**2 * np.eye(60)
        return multivariate_normal(A @ mean, S).logpdf(y.ravel())

    tau = [entry["tau"][f"harmonics of joint {j + 1}"] for j in range(6)]
    covariance = np.diag(np.repeat(np.square(tau) * start.prior_sd["harmonics"] ** 2, 4))
    mean, at = np.zeros(24), slice(8, 10)  # of joint 3 the first order
    mean[at] = start.coef
    covariance[at, at] += start.half @ start.half.T
    of_make = log_density(waves, mean, covariance, entry["noise_sd_mm"])
    prior = alone.prior_sd_["harmonics"] ** 2 * np.eye(2)
    of_poses = log_density(waves[:, :, 2, :2], np.zeros(2), prior, alone.noise_sd_)
    assert entry["gain_nats"] == pytest.approx(of_make - of_poses, abs=1e-3)


def test_options_are_those_of_the_first_model(earlier):
    X, y = rows(250, 0, 0)
    first = ArmResidualRegressor(ARM, angle_unit="deg", **OPTIONS).fit(np.rad2deg(X), y)
    new = transferred_model([first, *earlier[1:]], ARM, *rows(40, 7, 7))
    assert (new.angle_unit, new.orders) == ("rad", 60)
    assert left(new, 7) < 0.6 * left(alone(40), 7)
    loaded = pickle.loads(pickle.dumps(new))
    assert_allclose(loaded.predict(X), new.predict(X), rtol=0)
    assert new.pose_weight_.shape == (40,)


def test_arms_that_do_not_fit_are_named_and_passed_over(earlier):
    X, y = rows(40, 7, 7)
    panda = Arm.from_name("panda")
    seven = ArmResidualRegressor(panda, orders=1, causes=[])
    seven.fit(np.random.default_rng(0).uniform(-2, 2, (30, 7)), y[:30])
    network = RBFNetRegressor(max_centers=5).fit(X, y)
    other = ArmResidualRegressor(ARM, orders=2).fit(X, y)
    for model, why in (
        (network, "RBFNetRegressor holds no linear model"),
        (seven, "it has other joints, or another convention, than the new arm"),
        (other, "it has other families of columns"),
        (earlier[0], "it is a copy of another"),
    ):
        with pytest.warns(UserWarning, match=f"Earlier arm 4 of 4 is passed over: {why}"):
            new = transferred_model([*earlier, model], ARM, X, y)
        assert new.updates_[0]["n_arms"] == 3
    with pytest.warns(UserWarning, match="Earlier arm 1 of 1 is passed over"):
        assert transferred_model([network], ARM, X, y) is None


WARM = {"orders": 4, "causes": ["kinematics"], "extra": ["temperature"]}
PER_KELVIN = 23e-6  # aluminium


def warm_rows(n, seed, arm, mean, spread=5.0, noise_mm=0.02):
    """An arm that grows, calibrated at the mean temperature of its rows."""
    angles, _ = rows(n, seed, arm)
    kelvin = np.random.default_rng([seed, 1]).uniform(-spread, spread, n)
    kelvin -= kelvin.mean()
    turn = np.zeros_like(angles)
    turn[:, 1] = 15 * np.cos(angles[:, 1] - 2 * arm)
    y = np.einsum("nij,nj->ni", ARM.jacobian(angles), turn * ARCSEC)
    y += PER_KELVIN * kelvin[:, None] * ARM.forward(angles)
    y += np.random.default_rng([seed, 2]).normal(0, noise_mm, y.shape)
    return np.column_stack([angles, mean + kelvin]), y


@pytest.fixture(scope="module")
def earlier_warm():
    """Each arm was measured at another temperature."""
    of_arms = (warm_rows(150, i, i, mean) for i, mean in enumerate((18.0, 21.0, 30.0)))
    return [ArmResidualRegressor(ARM, **WARM).fit(*data) for data in of_arms]


def test_what_a_degree_does_is_common_to_the_make(earlier_warm, credulous):
    """Twenty poses at nearly one temperature do not show how the arm grows."""
    few = warm_rows(20, 7, 7, 24.0, spread=0.3)
    new = transferred_model(earlier_warm, ARM, *few)
    alone = ArmResidualRegressor(ARM, **WARM).fit(*few)
    assert new.updates_[0]["gain_nats"] > 0
    pose = few[0][:1].repeat(2, axis=0)
    pose[1, -1] += 10  # kelvin
    grown = 10 * PER_KELVIN * ARM.forward(pose[:1, :6])[0]
    cold, warm = new.linear_model_.predict(pose)[0]  # ten degrees away corrections fade
    assert np.linalg.norm(warm - cold - grown) < 0.15 * np.linalg.norm(grown)
    cold, warm = alone.linear_model_.predict(pose)[0]
    assert np.linalg.norm(warm - cold - grown) > 0.5 * np.linalg.norm(grown)
    assert new.linear_model_.terms.extra[0][1][0] == pytest.approx(24.0)
    other = ArmResidualRegressor(ARM, **WARM | {"extra": ["payload"]})
    other.fit(*warm_rows(60, 1, 1, 5.0))
    with pytest.warns(UserWarning, match="it has other families of columns"):
        transferred_model([*earlier_warm, other], ARM, *few)
    with pytest.warns(UserWarning, match="it has other causes beside the angles"):
        assert transferred_model([other], ARM, few[0][:, :6], few[1]) is None
