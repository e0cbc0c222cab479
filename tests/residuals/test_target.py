import functools
import re

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array, issparse
from scipy.spatial.transform import Rotation
from sklearn import config_context
from sklearn.base import clone
from sklearn.dummy import DummyRegressor
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.exceptions import UnsetMetadataPassedError
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel
from sklearn.impute import SimpleImputer
from sklearn.linear_model import HuberRegressor, LinearRegression, Ridge
from sklearn.multioutput import MultiOutputRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, Normalizer, StandardScaler
from sklearn.utils import get_tags

from sklearn_raacmm import (
    Arm,
    CylindricalResidualTarget,
    PoseFeatures,
    cartesian_to_cylindrical,
    cylindrical_to_cartesian,
    position_residuals,
)


def first_column(X):
    """Azimuth kept in the first column, as a module-level function that pickles."""
    return np.asarray(X)[:, 0]


def first_of_any(X):
    """The same of a sparse array, or of lists."""
    return np.asarray(X[:, [0]].toarray() if issparse(X) else X)[:, 0]


def about_z(phi):
    return Rotation.from_rotvec(np.multiply.outer(phi, [0.0, 0.0, 1.0]))


@pytest.fixture
def isotropic():
    """An arm that looks the same from every side: residual = f(features), turned by azimuth."""
    rng = np.random.default_rng(0)
    phi = rng.uniform(-np.pi, np.pi, 200)
    features = rng.normal(size=(200, 2))
    coef = rng.normal(size=(2, 3))
    turn = about_z(phi)
    y = turn.apply(features @ coef)
    X = np.column_stack([features, np.cos(phi), np.sin(phi)])
    return X, y, phi, features, coef


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("labels", [list("cab"), [7, -1, 2], [0.5, 0.25, 9.0]])
def test_position_residuals_against_pandas(labels, weighted):
    rng = np.random.default_rng(1)
    groups = rng.choice(labels, 60)
    points = rng.normal(size=(60, 3)) * 1000
    weight = rng.uniform(0.1, 2, 60) if weighted else None
    w = np.ones(60) if weight is None else weight

    table = pd.DataFrame(points * w[:, None]).assign(g=groups, w=w)
    sums = table.groupby("g").transform("sum")
    totals = table.groupby("g")["w"].transform("sum")
    expected = points - sums[[0, 1, 2]].to_numpy() / totals.to_numpy()[:, None]

    assert_allclose(position_residuals(points, groups, weight), expected, rtol=0, atol=1e-10)


def test_rotation_against_scipy():
    rng = np.random.default_rng(3)
    vectors, phi = rng.normal(size=(50, 3)), rng.uniform(-7, 7, 50)
    turn = about_z(phi)
    assert_allclose(cylindrical_to_cartesian(vectors, phi), turn.apply(vectors), atol=1e-14)
    assert_allclose(cartesian_to_cylindrical(vectors, phi), turn.inv().apply(vectors), atol=1e-14)


def test_recovers_an_isotropic_arm(isotropic):
    X, y, _, features, coef = isotropic
    model = CylindricalResidualTarget().fit(X, y)
    assert_allclose(model.regressor_.coef_, coef.T, atol=1e-12)
    assert_allclose(model.predict(X), y, atol=1e-12)
    # The same regressor on the Cartesian residual has no chance: it averages over all azimuths.
    assert LinearRegression().fit(features, y).score(features, y) < 0.5


def test_the_direction_never_reaches_the_regressor(isotropic):
    X, y, *_ = isotropic
    for target in (y, y[:, :1], y[:, 0]):
        model = CylindricalResidualTarget().fit(X, target)
        assert model.n_features_in_ == 4
        assert model.regressor_.n_features_in_ == 2
    frame = pd.DataFrame(X, columns=["a", "b", "azimuth_cos", "azimuth_sin"])
    model = CylindricalResidualTarget().fit(frame, y)
    assert_array_equal(model.feature_names_in_, frame.columns)
    assert_array_equal(model.regressor_.feature_names_in_, ["a", "b"])
    expected = CylindricalResidualTarget().fit(X, y).predict(X)
    assert_allclose(model.predict(frame), expected, atol=1e-12)


@pytest.mark.parametrize(
    ("columns", "azimuth"),
    [(0, "appended"), (0, first_column), (0, None), ([0], "appended"), ([0], first_column),
     ([0], None), (range(5), "appended"), (range(5), None)],
)  # fmt: skip
def test_what_is_no_residual_passes_through(columns, azimuth):
    rng = np.random.default_rng(5)
    X, y = rng.normal(size=(30, 4)), rng.normal(size=(30, 5))[:, columns]
    model = CylindricalResidualTarget(Ridge(), azimuth=azimuth).fit(X, y)
    assert_array_equal(model.predict(X), Ridge().fit(X, y).predict(X))


def test_what_the_regressor_takes_is_left_to_it(isotropic):
    _, y, phi, features, _ = isotropic
    raw = np.column_stack([phi, features])
    turned = cartesian_to_cylindrical(y, phi)
    for form in (csr_array, csr_array.toarray, lambda X: X.toarray().tolist()):
        X = form(csr_array(raw))
        model = CylindricalResidualTarget(Ridge(), azimuth=first_of_any).fit(X, y)
        expected = about_z(phi).apply(Ridge().fit(raw, turned).predict(raw))
        assert_allclose(model.predict(X), expected, atol=1e-9)
    # Gaps in the features.
    with_gaps = np.column_stack([features, np.cos(phi), np.sin(phi)])
    with_gaps[::3, 0] = np.nan
    inner = make_pipeline(SimpleImputer(), Ridge())
    expected = clone(inner).fit(with_gaps[:, :2], turned).predict(with_gaps[:, :2])
    for given in (with_gaps, pd.DataFrame(with_gaps), with_gaps.tolist()):
        model = CylindricalResidualTarget(inner).fit(given, y)
        assert_allclose(model.predict(given), about_z(phi).apply(expected), atol=1e-9)


@pytest.mark.parametrize(
    "scaler", [StandardScaler(), MinMaxScaler(), MinMaxScaler((-1, 0.9)), Normalizer()]
)
def test_a_scaler_in_between_raises(isotropic, scaler):
    X, y, *_ = isotropic
    with pytest.raises(ValueError, match=r"have a norm other than 1 .*Put a scaler inside"):
        make_pipeline(scaler, CylindricalResidualTarget()).fit(X, y)


def test_the_direction_is_checked_at_predict_too(isotropic):
    X, y, *_ = isotropic
    model = CylindricalResidualTarget().fit(X, y)
    bad = X.copy()
    bad[3, -2:] *= 1.001
    with pytest.raises(ValueError, match=r"1 of 200 rows .*\(row 3: 1.001\)"):
        model.predict(bad)


def gaussian_process():
    kernel = RBF(1.0, "fixed") + WhiteKernel(1e-3, "fixed")
    return GaussianProcessRegressor(kernel, optimizer=None, normalize_y=True)


def test_std_is_turned_as_a_covariance(isotropic):
    X, y, phi, features, _ = isotropic
    scale = np.array([1.0, 5.0, 25.0])
    turn = about_z(phi)
    y = turn.apply(turn.inv().apply(y) * scale)  # three very different uncertainties

    model = CylindricalResidualTarget(gaussian_process()).fit(X[:80], y[:80])
    mean, std = model.predict(X, return_std=True)

    inner = gaussian_process().fit(features[:80], turn.inv().apply(y)[:80])
    inner_mean, inner_std = inner.predict(features, return_std=True)
    matrices = turn.as_matrix()
    covariance = matrices @ (inner_std[:, :, None] ** 2 * np.eye(3)) @ matrices.transpose(0, 2, 1)
    assert_allclose(mean, turn.apply(inner_mean), atol=1e-10)
    assert_allclose(std, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)), atol=1e-10)
    assert_array_equal(mean, model.predict(X))
    with pytest.raises(ValueError, match="return_cov=True is not supported"):
        model.predict(X, return_cov=True)


def test_one_std_a_row_is_the_same_in_every_frame(isotropic):
    X, y, *_ = isotropic

    class OneStd(DummyRegressor):
        def predict(self, X, return_std=False):
            mean = super().predict(X)
            return (mean, np.arange(len(X), dtype=float)) if return_std else mean

    _, std = CylindricalResidualTarget(OneStd()).fit(X, y).predict(X, return_std=True)
    assert_allclose(std, np.repeat(np.arange(200.0)[:, None], 3, axis=1), rtol=1e-14)


@pytest.mark.parametrize("routing", [False, True])
def test_return_std_and_score_are_routed(isotropic, routing):
    X, y, *_ = isotropic
    with config_context(enable_metadata_routing=routing):
        inner = gaussian_process()
        if routing:
            inner.set_predict_request(return_std=True)
        model = make_pipeline(CylindricalResidualTarget(inner)).fit(X, y)
        mean, std = model.predict(X, return_std=True)
        assert mean.shape == std.shape == y.shape
        # scikit-learn's own TransformedTargetRegressor fails here with routing on.
        assert model.score(X, y) == model[-1].score(X, y)
        if routing:
            model = CylindricalResidualTarget(gaussian_process()).fit(X, y)
            with pytest.raises(UnsetMetadataPassedError, match="return_std"):
                model.predict(X, return_std=True)


@pytest.mark.parametrize(
    "inner",
    [
        Ridge(),
        HuberRegressor(),
        make_pipeline(StandardScaler(with_mean=False), Ridge()),
        make_pipeline("passthrough", Ridge()),
        make_pipeline(StandardScaler(), make_pipeline(MaxAbsScaler(), HuberRegressor())),
    ],
)
def test_tags_are_those_of_the_regressor_within(inner):
    tags, expected = get_tags(CylindricalResidualTarget(inner)), get_tags(inner)
    assert tags.input_tags.sparse == expected.input_tags.sparse
    assert tags.target_tags.multi_output == expected.target_tags.multi_output


@pytest.mark.parametrize("scaled", [False, True])
def test_a_regressor_of_one_target_learns_what_wraps_it(scaled):
    rng = np.random.default_rng(0)
    X, y = rng.uniform(-1, 1, (30, 4)), rng.normal(size=(30, 3))
    trees = HistGradientBoostingRegressor(max_iter=2)
    inner = make_pipeline(StandardScaler(), trees) if scaled else trees
    with pytest.raises(ValueError, match=r"y has 3 columns: wrap .* in sklearn.*MultiOutputRegr"):
        CylindricalResidualTarget(inner, azimuth=first_column).fit(X, y)
    wrapped = CylindricalResidualTarget(MultiOutputRegressor(trees), azimuth=first_column)
    assert wrapped.fit(X, y).predict(X).shape == (30, 3)
    # What else is wrong with the data, the regressor itself refuses.
    with pytest.raises(ValueError, match=r"^boom$"):
        CylindricalResidualTarget(Broken(), azimuth=first_column).fit(X, y)
    inner = inner.set_params(
        **{"histgradientboostingregressor__max_iter" if scaled else "max_iter": -1}
    )
    with pytest.raises(ValueError, match=r"^The 'max_iter' parameter"):
        CylindricalResidualTarget(inner, azimuth=first_column).fit(X, y)


class Broken(Ridge):
    def fit(self, X, y):
        raise ValueError("boom")


@pytest.mark.parametrize("appended", [True, False])
@pytest.mark.parametrize(("unit", "factor"), [("rad", 60.0), ("deg", 1.0)])
def test_a_chain_warns_of_a_unit_once(unit, factor, appended):
    arm = Arm.from_name("aacmm6")
    rng = np.random.default_rng(0)
    X, y = factor * rng.uniform(-1, 1, (40, 6)), rng.normal(size=(40, 3))
    pose = PoseFeatures(arm, angle_unit=unit, append_azimuth=appended)
    if appended:
        model = make_pipeline(pose, CylindricalResidualTarget(Ridge()))
    else:
        azimuth = functools.partial(arm.azimuth, angle_unit=unit) if unit == "deg" else arm.azimuth
        model = CylindricalResidualTarget(make_pipeline(pose, Ridge()), azimuth=azimuth)
    for use in (lambda: model.fit(X, y), lambda: model.predict(np.tile(X, (300, 1)))):
        with pytest.warns(UserWarning, match="degrees") as caught:
            use()
        assert len(caught) == 1


def test_azimuth_of_an_arm_is_the_same_by_its_method_and_by_a_function():
    arm = Arm.from_name("aacmm6")
    rng = np.random.default_rng(0)
    X, y = rng.uniform(-1, 1, (40, 6)), rng.normal(size=(40, 3))
    X[3] = [0, np.pi / 2, 0, 0, 0, 0]
    direct = CylindricalResidualTarget(Ridge(), azimuth=arm.azimuth).fit(X, y)
    by_angle = CylindricalResidualTarget(Ridge(), azimuth=functools.partial(Arm.azimuth, arm))
    assert_allclose(direct.predict(X), by_angle.fit(X, y).predict(X), rtol=1e-12)


@pytest.mark.parametrize(("with_mean", "with_std"), [(True, True), (False, True), (True, False)])
def test_a_scaler_inside_is_scikit_learn_s_own(with_mean, with_std):
    rng = np.random.default_rng(0)
    X, y = rng.normal(3, 2, (40, 3)), rng.normal(size=(40, 3))
    inner = make_pipeline(StandardScaler(with_mean=with_mean, with_std=with_std), Ridge(0.1))
    model = CylindricalResidualTarget(inner, azimuth=None).fit(X, y)
    given = X.copy()
    assert_array_equal(model.predict(X), model.regressor_.predict(X))
    assert_array_equal(X, given)
    # It still refuses what it refuses, in the same words.
    with pytest.raises(ValueError, match="2 features, but"):
        model.predict(X[:, :2])
    given[3, 1] = np.nan
    with pytest.raises(ValueError) as expected:
        model.regressor_.predict(given)
    with pytest.raises(ValueError, match=re.escape(str(expected.value))):
        model.predict(given)
    # Features with names reach a regressor that was fitted on names: else it would warn.
    model.set_params(regressor=clone(inner).set_output(transform="pandas")).fit(X, y)
    assert_array_equal(model.predict(X), model.regressor_.predict(X))
    with config_context(transform_output="pandas"):
        model.set_params(regressor=clone(inner)).fit(X, y)
        assert_array_equal(model.predict(X), model.regressor_.predict(X))
