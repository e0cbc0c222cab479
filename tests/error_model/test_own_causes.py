"""Causes that a user writes: friction that grows with the torque of a joint."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm, ArmResidualRegressor
from sklearn_raacmm.error_model import OWN, Column, Effect

from ..export._chains import ways_out

ARM = Arm.from_name("aacmm6")
EXTRA = ["direction 2"]
RAD_PER_N_MM = 2e-9


def friction(arm, extra):
    """Joint 2 stops short by its direction times the torque of what hangs on it."""
    turn = OWN, Effect.LOAD, 1, 2, 5e-6 / arm.reach_mm  # about z of frame 1, which is joint 2's
    for load in range(2, arm.n_joints + 2):
        yield Column(f"friction by load {load}", *turn, load=load, by=extra.index("direction 2"))


def shown(arm, X):
    """What friction does at the probe (n, 3), by moments about the second joint's axis, mm."""
    angles, frames = X[:, :6], arm.frames(X[:, :6])
    axis, origin = frames[:, 1, :, 2], frames[:, 1, :, 3]
    moment = sum(
        np.cross(frames[:, k, :, 3] - origin, -weight * arm.up)
        for k, weight in ((3, 9.0), (5, 6.0))
    )
    turn = RAD_PER_N_MM * np.einsum("nc,nc->n", axis, moment) * X[:, 6]
    return turn[:, None] * arm.jacobian(angles)[:, :, 1]


def rows(n, seed):
    rng = np.random.default_rng(seed)
    return np.column_stack([ARM.random_poses(n, rng), rng.choice([-1.0, 1.0], n)])


@pytest.fixture(scope="module")
def fitted():
    X = rows(300, 0)
    y = shown(ARM, X) + np.random.default_rng(1).normal(0, 0.003, (300, 3))
    causes = ["gravity", "kinematics", friction]
    models = [
        ArmResidualRegressor(ARM, extra=EXTRA, orders=2, causes=own).fit(X, y, groups=False)
        for own in (causes, causes[:2])
    ]
    return X, y, *models


def test_it_is_learnt_where_other_causes_cannot_hold_it(fitted):
    _, _, model, without = fitted
    X = rows(1000, 2)
    wanted = shown(ARM, X)
    left, other = (np.sqrt(np.mean((one.predict(X) - wanted) ** 2)) for one in (model, without))
    assert left < 1e-3 < 5 * left < other
    terms = model.terms_[model.terms_["family"] == "own"]
    assert len(terms) == 6
    assert model.prior_sd_["own"] > 1e-2


def test_it_is_left_out_where_there_is_none(fitted):
    X = fitted[0]
    y = np.random.default_rng(5).normal(0, 0.003, (len(X), 3))
    model = ArmResidualRegressor(ARM, extra=EXTRA, orders=2, causes=[friction])
    model.fit(X, y, groups=False)
    assert np.abs(model.terms_["value"]).max() < 1e-3


def test_it_is_exported_pickled_and_moved_to_another_probe(fitted, tmp_path):
    X, _, model, _ = fitted
    mean, std = model.predict(X, return_std=True)
    for name, found, spread in ways_out(tmp_path, model, X, std=True):
        assert_allclose(found, mean, rtol=0, atol=1e-12, err_msg=name)
        assert_allclose(spread, std, rtol=0, atol=1e-12, err_msg=name)
    again = pickle.loads(pickle.dumps(model))
    assert_allclose(again.predict(X), mean, rtol=0, atol=0)
    longer = ARM.replace(probe=np.add(ARM.probe, [0, 0, 150]))
    moved, wanted = model.with_arm(longer).predict(X), shown(longer, X)
    assert np.sqrt(np.mean((moved - wanted) ** 2)) < 2e-3


def test_faults_have_one_sentence():
    X, turn = rows(50, 0), (OWN, Effect.LOAD, 1, 2, 1e-9)

    def fit(*columns):
        model = ArmResidualRegressor(ARM, extra=EXTRA, causes=[lambda arm, extra: columns])
        model.fit(X, np.zeros((50, 3)), groups=False)

    with pytest.raises(
        ValueError, match=r"A cause has Column\(name='a'.*: its load must be 2 to 7"
    ):
        fit(Column("a", *turn, load=8))
    with pytest.raises(ValueError, match=r"its by must be -1, or number one of \['direction 2'\]"):
        fit(Column("a", *turn, load=3, by=1))
    with pytest.raises(ValueError, match="another column has its name"):
        fit(Column("a", *turn, load=3), Column("a", *turn, load=4))
    with pytest.raises(ValueError, match="its family must be OWN; its axis must be 0, 1 or 2"):
        fit(Column("a", 0, Effect.TURN, 1, 3, 1e-9))
    with pytest.raises(ValueError, match="A cause gives None: it must yield `Column`s"):
        ArmResidualRegressor(ARM, causes=[lambda arm, extra: None]).fit(X[:, :6], np.zeros((50, 3)))
    with pytest.raises(ValueError, match="wobble, or functions, got 'friction'"):
        ArmResidualRegressor(ARM, causes=["friction"]).fit(X[:, :6], np.zeros((50, 3)))
