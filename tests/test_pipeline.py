"""The whole chain: joint angles in, Cartesian residual of the probe out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sklearn import config_context
from sklearn.base import clone
from sklearn.experimental import enable_halving_search_cv  # noqa: F401
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, GroupKFold, HalvingGridSearchCV, cross_validate
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from sklearn_raacmm import (
    Arm,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    cartesian_to_cylindrical,
    cylindrical_to_cartesian,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import repeatability_scorer, single_point_repeatability

from .export._chains import form_a, form_b

# Chains are fitted without groups: what they learn is not the question here.
pytestmark = pytest.mark.filterwarnings("ignore:No groups were given")


def network():
    return RBFNetRegressor(15, length_scale=1.0, alpha=1e-4)


def gaussian_process():
    kernel = RBF(1.0, "fixed") + WhiteKernel(1e-4, "fixed")
    return GaussianProcessRegressor(kernel, optimizer=None, normalize_y=True)


def sagging(arm, angles):
    """Simulated residual in mm: the shoulder sags by its load, the elbow by its own.

    Through the arm's Jacobian, and with no thought of pose or cylindrical frame: that they suit
    it is for the tests to show.
    """
    frames = arm.frames(angles)
    lever = np.hypot(*(frames[:, 5, :2, 3] - frames[:, 2, :2, 3]).T)
    sag = np.zeros((len(angles), arm.n_joints))
    sag[:, 1] = 3e-7 * lever  # rad, shoulder hinge
    sag[:, 3] = 2e-4 * np.sin(angles[:, 3] / 2)
    return np.einsum("nij,nj->ni", arm.jacobian(angles), sag)


@pytest.fixture(scope="module")
def cone_test():
    """Simulated: 12 positions by 15 poses of the six-joint arm CMM."""
    rng = np.random.default_rng(0)
    arm = Arm.from_name("aacmm6")
    angles = rng.uniform(-0.9, 0.9, (180, 6)) + np.array([0, -1.3, 0.2, 1.2, 0, 0.4])
    angles[:, 0] = rng.uniform(-np.pi, np.pi, 180)
    return arm, angles, sagging(arm, angles) + rng.normal(scale=0.005, size=(180, 3))


@pytest.mark.parametrize("encoding", ["angle", "periodic"])
@pytest.mark.parametrize(
    "regressor",
    [network(), Ridge(), make_pipeline(PolynomialFeatures(2), Ridge()), gaussian_process()],
    ids=["network", "ridge", "polynomial", "process"],
)
def test_both_forms_predict_the_same(cone_test, regressor, encoding):
    arm, angles, y = cone_test
    a = form_a(arm, net=regressor, encoding=encoding).fit(angles[:120], y[:120])
    b = form_b(arm, net=regressor, encoding=encoding).fit(angles[:120], y[:120])
    assert_allclose(a.predict(angles), b.predict(angles), atol=1e-9)
    assert a.score(angles[120:], y[120:]) == pytest.approx(b.score(angles[120:], y[120:]))
    if isinstance(regressor, RBFNetRegressor | GaussianProcessRegressor):
        std = a.predict(angles, return_std=True)[1]
        assert_allclose(std, b.predict(angles, return_std=True)[1], rtol=1e-6)
        assert std.shape == y.shape
        assert np.all(std > 0)


@pytest.mark.parametrize("form", [form_a, form_b])
def test_what_is_learnt_on_one_side_holds_on_the_other(cone_test, form):
    """The base is isotropic: the cylindrical target transfers across azimuths, no other does."""
    arm, angles, y = cone_test
    front = np.abs(arm.azimuth(angles)) < np.pi / 2
    truth = sagging(arm, angles)[~front]
    before = np.linalg.norm(truth, axis=1).mean()

    model = form(arm, net=network()).fit(angles[front], y[front])
    after = np.linalg.norm(truth - model.predict(angles[~front]), axis=1).mean()
    assert after < 0.2 * before

    cartesian = form_a(arm, net=network()).set_params(azimuth=None).fit(angles[front], y[front])
    worse = np.linalg.norm(truth - cartesian.predict(angles[~front]), axis=1).mean()
    assert worse > 0.8 * before


CANDIDATES = [
    network(),
    make_pipeline(StandardScaler(), PolynomialFeatures(2), Ridge()),
    make_pipeline(StandardScaler(), gaussian_process()),
]


@pytest.mark.parametrize(
    ("kind", "routing"), [(GridSearchCV, False), (GridSearchCV, True), (HalvingGridSearchCV, True)]
)
@pytest.mark.parametrize("form", [pytest.param("outermost", marks=pytest.mark.exhaustive), "last"])
def test_a_search_hands_positions_to_every_candidate(form, kind, routing):
    data = make_single_point(6, 9, machine="gravity", random_state=0)
    X, y, groups, arm = data.data, data.target, data.groups, data.arm
    regressors = CANDIDATES
    if form == "outermost":
        regressors = [make_pipeline(PoseFeatures(arm), regressor) for regressor in CANDIDATES]
        model, key = CylindricalResidualTarget(Ridge(), azimuth=arm.azimuth), "regressor"
    else:
        key = "cylindricalresidualtarget__regressor"
        pose = PoseFeatures(arm, append_azimuth=True)
        model = make_pipeline(pose, CylindricalResidualTarget())
    name = key.removesuffix("regressor") + ("groups" if form == "last" else "regressor__groups")
    words = {"groups": groups} if routing else {"groups": groups, name: groups}
    with config_context(enable_metadata_routing=routing):
        scorer = repeatability_scorer() if routing else repeatability_scorer(X, groups)
        # Halving draws rows: so many that each position has several.
        options = {"min_resources": 48, "random_state": 0} if kind is HalvingGridSearchCV else {}
        search = kind(model, {key: regressors}, cv=GroupKFold(3), scoring=scorer, **options)
        search.fit(X, y, **words)
    if kind is GridSearchCV:
        expected = [by_hand(arm, regressor, X, y, groups) for regressor in CANDIDATES]
        assert_allclose(-search.cv_results_["mean_test_score"], expected, rtol=1e-6)
    best = CANDIDATES[regressors.index(search.best_params_[key])]
    alone = CylindricalResidualTarget(make_pipeline(PoseFeatures(arm), best), azimuth=arm.azimuth)
    assert_allclose(search.predict(X), alone.fit(X, y, groups=groups).predict(X), atol=1e-9)


def by_hand(arm, regressor, X, y, groups):
    """Mean 2S at positions left out, in a loop."""
    scores = []
    for train, test in GroupKFold(3).split(X, groups=groups):
        model = CylindricalResidualTarget(
            make_pipeline(PoseFeatures(arm), clone(regressor)), azimuth=arm.azimuth
        ).fit(X[train], y[train], groups=groups[train])
        scores.append(single_point_repeatability(y[test] - model.predict(X[test]), groups[test]))
    return np.mean(scores)


def weighted(form, arm, routing):
    """The chain, and the name by which its `fit` takes the weights of the network."""
    model = form(arm, net=network())
    if not routing:
        name = "rbfnetregressor__sample_weight"
        return model, name if form is form_a else f"cylindricalresidualtarget__{name}"
    inside = (model if form is form_a else model[-1]).regressor
    inside["rbfnetregressor"].set_fit_request(sample_weight=True)
    inside["standardscaler"].set_fit_request(sample_weight=False)
    return model, "sample_weight"


@pytest.mark.parametrize("routing", [False, True])
@pytest.mark.parametrize("form", [form_a, form_b])
def test_sample_weight_reaches_the_network(cone_test, form, routing):
    arm, angles, y = cone_test
    weight = np.where(np.arange(len(y)) % 3, 1.0, 0.01)

    # The chain, link by link.
    features = StandardScaler().fit_transform(PoseFeatures(arm).fit_transform(angles))
    azimuth = arm.azimuth(angles)
    inner = network().fit(features, cartesian_to_cylindrical(y, azimuth), sample_weight=weight)
    expected = cylindrical_to_cartesian(inner.predict(features), azimuth)

    with config_context(enable_metadata_routing=routing):
        model, name = weighted(form, arm, routing)
        model.fit(angles, y, **{name: weight})
        assert_allclose(model.predict(angles), expected, atol=1e-9)
        assert not np.allclose(clone(model).fit(angles, y).predict(angles), expected, atol=1e-6)


def test_cross_validation_of_the_published_chain_is_the_steps_written_out():
    """Labels reach every fold's fit and score, in a plain and in a nested search."""
    test = make_single_point(6, 12, random_state=0)
    X, y, g = test.data, test.target, test.groups
    terms = make_pipeline(StandardScaler(), PolynomialFeatures(2), Ridge())
    chain = Pipeline([
        ("pose", PoseFeatures(test.arm, append_azimuth=True)),
        ("target", CylindricalResidualTarget(terms)),
    ])  # fmt: skip
    words = {"groups": g, "cv": GroupKFold(3), "scoring": repeatability_scorer(X, g)}
    found = cross_validate(chain, X, y, params={"target__groups": g}, **words)["test_score"]
    left = []
    for train, out in GroupKFold(3).split(X, groups=g):
        model = clone(chain).fit(X[train], y[train], target__groups=g[train])
        left.append(-single_point_repeatability(y[out] - model.predict(X[out]), g[out]))
    assert_allclose(found, left, rtol=1e-10)
    # A search inside: its own folds keep positions together, too.
    grid = {"target__regressor__ridge__alpha": [0.1, 1000.0]}
    search = GridSearchCV(chain, grid, cv=GroupKFold(2), scoring=words["scoring"])
    params = {"groups": g, "target__groups": g}
    nested = cross_validate(search, X, y, params=params, return_estimator=True, **words)
    for (train, out), one in zip(
        GroupKFold(3).split(X, groups=g), nested["estimator"], strict=True
    ):
        own = clone(search).fit(X[train], y[train], groups=g[train], target__groups=g[train])
        assert one.best_params_ == own.best_params_
        assert_allclose(one.predict(X[out]), own.predict(X[out]))
