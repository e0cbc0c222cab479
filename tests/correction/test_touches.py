"""Touches of planes, balls and cones at the one call, judged at features left out."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from sklearn.base import clone
from sklearn.model_selection import GroupKFold
from sklearn.neighbors import KNeighborsRegressor

from sklearn_raacmm import (
    ArmResidualRegressor,
    Measurements,
    calibrate,
    learn_correction,
    position_residuals,
)
from sklearn_raacmm.correction._scores import predict_with_std
from sklearn_raacmm.datasets import SimulatedArm, make_features, make_single_point
from sklearn_raacmm.metrics import fit_sphere, single_point_repeatability

MODEL = ArmResidualRegressor(orders=2, causes=["kinematics", "wobble"])


def touched(*n, **given):
    machine = SimulatedArm("eccentricity", random_state=1)
    return make_features(*n, machine=machine, **{"random_state": 1} | given)


@pytest.fixture(scope="module")
def test():
    return touched(3, 3, 2, 20)


@pytest.fixture(scope="module")
def learned(test):
    given = {"features": test.features, "model": MODEL, "cv": 4}
    return learn_correction(test.nominal_arm, test.data, test.groups, **given)


def distances(kind, points):
    """Of touches from the form that fits them best, by an independent fit, and the directions."""
    if kind == "sphere":
        centre, radius = fit_sphere(points)[:2]
        away = points - centre
        size = np.linalg.norm(away, axis=1)
        return size - radius, away / size[:, None]
    away = points - points.mean(axis=0)
    normal = np.linalg.svd(away)[2][2]
    return away @ normal, np.broadcast_to(normal, away.shape)


def test_judged_as_by_hand_at_features_left_out(test, learned):
    scores, kinds = learned.scores, {entry[0]: entry[1] for entry in test.features}
    assert not len(scores.outliers)
    place = {label: i for i, label in enumerate(scores.table["position"].tolist())}
    ratios = []  # of deviations over standard deviations, in coordinates that touches show
    for train, out in GroupKFold(4).split(test.data, groups=test.groups):
        known = [entry for entry in test.features if entry[0] in test.groups[train]]
        given = {"groups": test.groups[train], "features": known}
        arm = calibrate(test.nominal_arm, test.data[train], **given).arm
        shown = arm.forward(test.data[train])
        model = clone(MODEL).set_params(arm=arm)
        model.fit(test.data[train], position_residuals(shown, **given), **given)
        left = position_residuals(shown - model.predict(test.data[train]), **given)
        n_shown = [1 if label in kinds else 3 for label in test.groups[train].tolist()]
        noise = np.sqrt(np.square(left).sum() / np.sum(n_shown))
        mean, std = predict_with_std(model, test.data[out], noise)
        shown = arm.forward(test.data[out])
        for label in np.unique(test.groups[out]).tolist():
            rows, kind = test.groups[out] == label, kinds.get(label)
            for when, points in (("before", shown[rows]), ("after", (shown - mean)[rows])):
                n, away = len(points), points - points.mean(axis=0)
                if kind is None:
                    ratio = away / std[rows]
                else:
                    away, along = distances(kind, points)
                    free = 1 - (4 if kind == "sphere" else 3) / n
                    ratio = away / np.sqrt(free * np.square(along * std[rows]).sum(axis=1))
                expected = 2 * np.sqrt(np.square(away).sum() / (n - 1))
                assert scores.table[when][place[label]] == pytest.approx(expected, rel=1e-3)
            ratios.append(ratio.ravel())
    ratios = np.abs(np.concatenate(ratios))
    assert scores.std_factor == pytest.approx(np.quantile(ratios, 0.95) / 1.959964, rel=1e-3)
    assert learned.verdict.startswith("It")
    assert "at new features: 2S from forms" in learned.verdict
    assert "8 of 8 features better" in learned.verdict


def test_corrects_new_cones(test, learned):
    new = make_single_point(6, 20, machine=test.simulation.machine, random_state=7)
    points = learned.calibration.arm.forward(new.data), learned.correct(new.data)[0]
    before, after = (single_point_repeatability(one, new.groups) for one in points)
    assert after < 0.6 * before


@pytest.mark.exhaustive  # of cones: tests/measurements
def test_measurements_say_the_same(test, learned):
    measured = Measurements.of(test.data, test.groups, features=test.features)
    found = learn_correction(test.nominal_arm, measured, model=MODEL, cv=4)
    assert found.verdict == learned.verdict
    assert_array_equal(found.correct(test.data)[0], learned.correct(test.data)[0])


def test_blocks_sizes_and_the_probes_ball():
    """A slipped touch is no lesson; a block is judged by its own length, by another one."""
    # Of the touches of seed 1 a good one has a weight of 0.01 beside the model, or of 0.
    given = {"blocks": [100.0, 500.0, 300.0], "tip_diameter": 6.0, "random_state": 2}
    test = touched(3, 0, 2, 20, **given)
    slipped = test.data.copy()
    slipped[5, 1] += 1e-3
    given = {"features": test.features, "lengths": test.lengths, "tip_diameter": 6.0}
    given |= {"model": MODEL, "cv": 4}
    found = learn_correction(test.nominal_arm, slipped, test.groups, **given)
    assert found.helps
    assert_array_equal(found.scores.outliers, [5])
    assert sorted(entry[2] for entry in found.scores.lengths) == [100, 300, 500]
    assert np.abs(found.scores.length_errors_after).max() < 0.1


def test_what_features_cannot_have(test):
    given = test.nominal_arm, test.data, test.groups
    known = {"features": test.features}
    with pytest.raises(ValueError, match="like and features cannot"):
        learn_correction(*given, **known, like=[MODEL])
    with pytest.raises(ValueError, match="take needs positions or measured points"):
        learn_correction(*given, **known, take="zeros")
    with pytest.raises(ValueError, match="features need an ArmResidualRegressor"):
        learn_correction(*given, **known, model=KNeighborsRegressor())
    with pytest.raises(ValueError, match="features are of groups"):
        learn_correction(*given[:2], **known)
    # Three touches of a plane say nothing of the arm, and nothing is judged by them.
    few = np.flatnonzero(test.groups == 4)[3:]
    kept = np.delete(np.arange(len(test.data)), few)
    with pytest.warns(UserWarning, match="The plane 4 has 3 touches"):
        found = learn_correction(
            test.nominal_arm, test.data[kept], test.groups[kept], **known, model=MODEL, cv=2
        )
    assert 4 not in found.scores.table["position"]


@pytest.mark.filterwarnings("ignore:1 of 6 known lengths disagree")
@pytest.mark.parametrize("wrong", [pytest.param(False, marks=pytest.mark.exhaustive), True])
def test_a_size_is_judged_beside_what_a_model_explains(wrong):
    """Of a typical arm the table alone leaves as much as the size of a ball is off by."""
    machine = SimulatedArm("typical", random_state=101)
    test = make_features(6, 0, 2, 25, machine=machine, random_state=101)
    label, kind, size, sd = test.features[2]
    features = [*test.features[:2], (label, kind, size + 0.1 * wrong, sd), *test.features[3:]]
    given = {"features": features, "model": ArmResidualRegressor(orders=1), "cv": 2}
    learned = learn_correction(test.nominal_arm, test.data, test.groups, **given)
    named = [one.text for one in learned.scores.findings if one.code == "wrong-length"]
    assert len(named) == wrong
    if wrong:
        assert named[0].startswith("1 of 6 known lengths disagree")
        assert f"the size of {label} is 30.0" in named[0]
