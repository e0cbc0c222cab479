"""Residuals known up to a constant at each position, in the chain."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn import config_context
from sklearn.base import clone
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.linear_model import Ridge
from sklearn.metrics import r2_score
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability, within_position_r2_score
from sklearn_raacmm.utils import Groups


@pytest.fixture(scope="module")
def test():
    """Simulated: an arm that gravity bends."""
    return make_single_point(12, 15, machine="gravity")


def deviations(n=90, n_positions=6, seed=0):
    """Targets that are a function of two features, less their means at positions."""
    rng = np.random.default_rng(seed)
    groups = rng.permutation(np.arange(n) % n_positions)
    X = rng.uniform(-1, 1, (n, 2)) + 0.4 * groups[:, None]
    f = np.column_stack([np.sin(X[:, 0]), X @ [0.3, 1], X[:, 0] * X[:, 1]])
    return X, Groups(groups).centred(f + 0.02 * rng.standard_normal((n, 3))), groups


def plain(regressor):
    return CylindricalResidualTarget(regressor, azimuth=None)


def chain(test, *steps):
    inner = make_pipeline(PoseFeatures(test.arm), *steps)
    return CylindricalResidualTarget(inner, azimuth=test.arm.azimuth)


@pytest.mark.parametrize("regressor", [Ridge(), ExtraTreesRegressor(20, random_state=0)])
def test_others_are_fitted_as_without_labels(regressor):
    X, y, groups = deviations()
    known, unknown = plain(regressor).fit(X, y, groups=groups), plain(regressor).fit(X, y)
    assert known.by_position_
    assert_array_equal(known.predict(X), unknown.predict(X))


def test_constants_that_features_imitate_are_not_handed_on():
    X, y, groups = deviations()
    network = RBFNetRegressor(10, random_state=0)
    wide = make_pipeline(PolynomialFeatures(2, include_bias=False), network)  # 5 features
    for n_positions, known in ((6, True), (5, False)):
        rows = groups < n_positions
        model = plain(wide).fit(X[rows], y[rows], groups=groups[rows])
        labels = {"rbfnetregressor__groups": groups[rows]} if known else {}
        expected = clone(wide).fit(X[rows], y[rows], **labels)
        assert_array_equal(model.predict(X), expected.predict(X))
        assert np.any(model.regressor_[-1].group_std_ > 0) == known


@pytest.mark.parametrize("regressor", [Ridge(), RBFNetRegressor(10), None])
def test_residuals_known_in_full_have_no_constants(regressor):
    X, y, groups = deviations()
    y = y + np.random.default_rng(0).normal(size=(6, 3))[groups]
    known, unknown = plain(regressor).fit(X, y, groups=groups), plain(regressor).fit(X, y)
    assert not known.by_position_
    assert_array_equal(known.predict(X), unknown.predict(X))


def test_a_search_within_splits_by_position():
    X, y, groups = deviations()
    search = GridSearchCV(Ridge(), {"alpha": [0.1, 10.0]}, cv=GroupKFold(3))
    for routing in (False, True):
        with config_context(enable_metadata_routing=routing):
            model = plain(search).fit(X, y, groups=groups)
            assert model.regressor_.n_splits_ == 3
    best = plain(Ridge(**model.regressor_.best_params_)).fit(X, y, groups=groups)
    assert_allclose(model.predict(X), best.predict(X), atol=1e-12)


def test_score_of_the_chain(test):
    X, y, groups = test.data, test.target, test.groups
    pose = PoseFeatures(test.arm, append_azimuth=True)
    b = make_pipeline(pose, CylindricalResidualTarget(Ridge()))
    a = chain(test, Ridge()).fit(X, y, groups=groups)
    b.fit(X, y, cylindricalresidualtarget__groups=groups)
    expected = within_position_r2_score(y, a.predict(X), groups=groups)
    assert a.score(X, y) == pytest.approx(expected)
    assert a.score(X, y, groups=groups) == pytest.approx(expected)
    rng = np.random.default_rng(2)
    times = rng.integers(1, 4, len(y))
    once = a.score(X, y, groups=groups, sample_weight=times)
    often = (np.repeat(values, times, axis=0) for values in (X, y, groups))
    assert a.score(*often) == pytest.approx(once)
    full = y + rng.normal(size=(12, 3))[groups]  # the constants count
    assert a.score(X, full, groups=groups) == pytest.approx(r2_score(full, a.predict(X)))
    assert b[-1].score(b[:-1].transform(X), y, groups=groups) == pytest.approx(expected)
    with pytest.raises(ValueError, match=r"score got no groups: take\s+scoring=sklearn_raacmm"):
        b.score(X, y)
    with config_context(enable_metadata_routing=True):
        assert b.score(X, y, groups=groups) == pytest.approx(expected)


def test_cross_validation_without_a_scorer_picks_the_right_model(test):
    """Plain R2 prefers the model that does nothing."""
    X, y, groups = test.data, test.target, test.groups
    steps = PolynomialFeatures(2), StandardScaler()
    models = {alpha: chain(test, *steps, Ridge(alpha)) for alpha in (1.0, 1e6)}
    options = {"cv": GroupKFold(4), "return_estimator": True, "return_indices": True}
    for routing in (False, True):
        with config_context(enable_metadata_routing=routing):
            # Off: `groups` reaches the splitter, and params the fit. On: one word does for all.
            words = {"params": {"groups": groups}} | ({} if routing else {"groups": groups})
            results = {
                alpha: cross_validate(model, X, y, **words, **options)
                for alpha, model in models.items()
            }
        assert results[1.0]["test_score"].mean() > results[1e6]["test_score"].mean() + 0.1
        for i, model in enumerate(results[1.0]["estimator"]):
            assert model.by_position_
            rows = results[1.0]["indices"]["test"][i]
            predicted = model.predict(X[rows])
            expected = within_position_r2_score(y[rows], predicted, groups=groups[rows])
            assert results[1.0]["test_score"][i] == pytest.approx(expected)


def test_positions_are_found_unless_there_are_none(test):
    assert chain(test, Ridge()).fit(test.data, test.target).by_position_
    assert not chain(test, Ridge()).fit(test.data, test.target, groups=False).by_position_


def test_correct(test):
    X, y, groups = test.data, test.target, test.groups
    model = chain(test, RBFNetRegressor(10, length_scale=1.0, alpha=0.1)).fit(X, y, groups=groups)
    corrected = model.correct(X, test.points)
    assert_allclose(corrected + model.predict(X), test.points, rtol=1e-14)
    assert_allclose(model.correct(X), corrected, atol=1e-9)
    spread = model.correct(X, test.points, return_std=True)[1]
    assert_allclose(spread, model.predict(X, return_std=True)[1])
    before = single_point_repeatability(test.points, groups)
    assert single_point_repeatability(corrected, groups) < 0.8 * before
    with pytest.raises(ValueError, match=r"points has shape \(1, 3\), but predictions \(180, 3\)"):
        model.correct(X, test.points[:1])
    with pytest.raises(ValueError, match=r"points has shape \(180, 2\)"):
        model.correct(X, test.points[:, :2])
    with pytest.raises(ValueError, match="points must be given"):
        plain(Ridge()).fit(X, y).correct(X)
