"""scikit-learn's own checks, for every estimator, with metadata routing off and on."""

import inspect
import warnings
from collections import UserList
from types import SimpleNamespace

import numpy as np
import pytest
import sklearn
from sklearn import config_context
from sklearn.base import clone
from sklearn.datasets import make_regression
from sklearn.pipeline import make_pipeline
from sklearn.utils import estimator_checks
from sklearn.utils.estimator_checks import estimator_checks_generator, parametrize_with_checks

import sklearn_raacmm
from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.utils import _checks

# Least number of checks scikit-learn collects for each estimator, from 1.6, 1.7 and 1.9 on; newer
# releases add some. A tag set by mistake makes checks vanish silently: this is where it shows.
RELEASES = ((1, 6), (1, 7), (1, 9))
FLOORS = {
    "PoseFeatures": (46, 47, 47),
    "RBFNetRegressor": (59, 59, 60),
    "CylindricalResidualTarget": (52, 53, 53),
    "ArmResidualRegressor": (58, 58, 59),
}

# Estimators that take joint angles: as many columns as the arm has joints.
OF_ANGLES = (PoseFeatures, ArmResidualRegressor)

ESTIMATORS = [
    PoseFeatures(),
    PoseFeatures(Arm.from_name("panda"), encoding="periodic", append_azimuth=True),
    PoseFeatures(Arm.from_name("ur10"), joints="all", angle_unit="deg"),
    CylindricalResidualTarget(),
    ArmResidualRegressor(orders=1, causes=["kinematics", "wobble"]),  # gravity has most columns
    RBFNetRegressor(),
    CylindricalResidualTarget(RBFNetRegressor()),
]


# Checks that bring data of a shape of their own, past both functions that adapt it.
OWN_DATA = {
    "check_sample_weights_pandas_series",
    "check_sample_weights_not_an_array",
    "check_sample_weights_shape",
    "check_sample_weights_not_overwritten",
    "check_sample_weight_equivalence_on_dense_data",
}


def to_joints(X, n_joints):
    """X with its columns repeated or cut to the arm's number of joints."""
    return np.resize(X.T, (n_joints, len(X))).T if len(X) else np.empty((0, n_joints))


def to_vectors(y):
    """First column of y, three times over."""
    return y if y.shape[1:] == (3,) else np.tile(y.reshape(len(y), -1)[:, :1], 3)


def three_outputs(*args, n_targets=1, **options):
    """Data of scikit-learn's, a vector in mm in place of five outputs without a unit."""
    X, y = make_regression(*args, n_targets=3 if n_targets == 5 else n_targets, **options)
    return X, y / 100


def adapted(estimator, check):
    """The estimator, which resizes what it is given where the check's own data pass all else."""
    if not isinstance(estimator, ArmResidualRegressor) or check.func.__name__ not in OWN_DATA:
        return estimator
    kind, n_joints = type(estimator), Arm.from_name("aacmm6").n_joints

    class Adapted(kind):
        def fit(self, X, y, sample_weight=None):
            X, y = to_joints(np.asarray(X), n_joints), to_vectors(np.asarray(y))
            return super().fit(X, y, sample_weight=sample_weight)

        def predict(self, X):
            return super().predict(to_joints(np.asarray(X), n_joints))

    return Adapted(**estimator.get_params(deep=False))


@pytest.fixture(autouse=True)
def _as_many_columns_as_joints(monkeypatch, request):
    """Resize the checks' X to the arm's number of joints, and y to vectors where they are needed.

    The checks feed 1 to 10 columns, an arm takes as many as it has joints. scikit-learn adapts
    its data to an estimator's tags in two functions: here they learn of arms as well.
    """
    monkeypatch.setenv("SCIPY_ARRAY_API", "1")  # or checks of arrays would skip themselves
    adapt = estimator_checks._enforce_estimator_tags_X
    adapt_y = estimator_checks._enforce_estimator_tags_y

    def adapt_to_arm(estimator, X, *args, **kwargs):
        if isinstance(estimator, OF_ANGLES):
            n_joints = (estimator.arm or Arm.from_name("aacmm6")).n_joints
            X = to_joints(X, n_joints)
            # Radians within one turn: some checks draw around 100.
            if getattr(estimator, "angle_unit", "rad") == "rad":
                X = np.remainder(X, 6.0).astype(X.dtype)
            else:  # degrees beyond 2 pi, which would be taken for radians
                X = X * X.dtype.type(30)
        return adapt(estimator, X, *args, **kwargs)

    def adapt_to_space(estimator, y):
        return (
            to_vectors(y) if isinstance(estimator, ArmResidualRegressor) else adapt_y(estimator, y)
        )

    monkeypatch.setattr(estimator_checks, "_enforce_estimator_tags_X", adapt_to_arm)
    monkeypatch.setattr(estimator_checks, "_enforce_estimator_tags_y", adapt_to_space)
    params = getattr(getattr(request.node, "callspec", None), "params", {})
    if isinstance(params.get("estimator"), ArmResidualRegressor):
        monkeypatch.setattr(estimator_checks, "make_regression", three_outputs)


@parametrize_with_checks(ESTIMATORS[:-1])
def test_sklearn_checks(estimator, check):
    check(adapted(estimator, check))


@pytest.mark.exhaustive
@parametrize_with_checks(ESTIMATORS[-1:])
def test_sklearn_checks_of_a_network_in_a_frame(estimator, check):
    check(estimator)


@pytest.mark.exhaustive
@parametrize_with_checks([*{type(estimator): estimator for estimator in ESTIMATORS}.values()])
def test_sklearn_checks_with_metadata_routing(estimator, check):
    with config_context(enable_metadata_routing=True):
        check(adapted(estimator, check))


def test_every_public_estimator_is_checked():
    public = {
        name
        for name in sklearn_raacmm.__all__
        if inspect.isclass(getattr(sklearn_raacmm, name))
        and hasattr(getattr(sklearn_raacmm, name), "fit")
    }
    assert public <= {type(estimator).__name__ for estimator in ESTIMATORS}


@pytest.mark.parametrize(
    "estimator",
    [
        PoseFeatures(),
        ArmResidualRegressor(orders=2, causes=["kinematics", "wobble"]),
        make_pipeline(PoseFeatures(append_azimuth=True), CylindricalResidualTarget()),
    ],
    ids=["PoseFeatures", "ArmResidualRegressor", "chain"],
)
def test_the_arm_of_somebody_else_is_not_taken_without_a_word(estimator):
    X = np.random.default_rng(0).uniform(-1, 1, (40, 6))
    y = 0.05 * np.cos(X[:, :3])
    with pytest.warns(UserWarning, match="no arm and takes the built-in arm 'aacmm6'") as caught:
        silent = clone(estimator).fit(X, y)
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        own = clone(estimator)
        (own[0] if hasattr(own, "steps") else own).set_params(arm=Arm.from_name("aacmm6"))
        own.fit(X, y)
    if hasattr(own, "predict"):
        np.testing.assert_array_equal(silent.predict(X), own.predict(X))


class OfTorch(UserList):
    """Numbers that say of themselves, by the array API, whose they are."""

    def __array_namespace__(self):
        return SimpleNamespace(__name__="torch")


@pytest.mark.parametrize("estimator", ESTIMATORS[:5], ids=lambda e: type(e).__name__)
def test_foreign_arrays_are_refused_in_a_sentence(estimator, monkeypatch):
    n_joints = (getattr(estimator, "arm", None) or Arm.from_name("aacmm6")).n_joints
    X = np.random.default_rng(0).uniform(-1, 1, (40, n_joints))
    y = 0.05 * np.cos(X[:, :3])
    # Not by config_context, which asks for a switch of SciPy's and another package besides.
    monkeypatch.setattr(_checks, "get_config", lambda: {"array_api_dispatch": True})
    with pytest.raises(TypeError, match="X is an array of torch, and array_api_dispatch is on"):
        clone(estimator).fit(OfTorch(X), y)


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_no_check_vanishes(estimator):
    name = type(estimator).__name__
    checks = list(estimator_checks_generator(estimator, legacy=True, mark=None))
    release = tuple(int(part) for part in sklearn.__version__.split(".")[:2])
    known = FLOORS[name][sum(release >= since for since in RELEASES) - 1]
    assert len(checks) >= known, (
        f"scikit-learn collects {len(checks)} checks for {name}, {known} are known: has a tag "
        "switched some off?"
    )
