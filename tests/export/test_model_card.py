"""The card says what is so, and its numbers are those of independent computations."""

import hashlib
import json
import re

import numpy as np
import pytest
from scipy.spatial import Delaunay
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GroupKFold, cross_val_predict
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVR

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export import ModelCard, describe, export_c, fingerprint
from sklearn_raacmm.metrics import single_point_repeatability


@pytest.fixture(scope="module")
def model(data):
    network = RBFNetRegressor(12, length_scale=1.5, alpha=0.01)
    return make_pipeline(
        PoseFeatures(data.arm, append_azimuth=True),
        CylindricalResidualTarget(make_pipeline(StandardScaler(), network)),
    ).fit(data.data, data.target)


def test_facts(model, data):
    card = describe(model, data.data, data.target, data.groups)
    assert card["fingerprint"] == fingerprint(model)
    text = json.dumps({"format": "sklearn_raacmm.Arm", "format_version": 1, **card["arm"]})
    assert Arm.from_json(text) == data.arm
    training = card["training"]
    assert (training["rows"], training["positions"]) == (120, 8)
    points = data.arm.forward(data.data)
    assert training["height_mm"] == [points[:, 2].min(), points[:, 2].max()]
    # All poses lie in the hull of its corners, which are rounded to 0.01 mm.
    corners = np.array(training["hull_corners_mm"])
    middle = corners.mean(axis=0)
    outward, inward = (Delaunay(middle + f * (corners - middle)) for f in (1.001, 0.999))
    assert (outward.find_simplex(points) >= 0).all()
    assert (inward.find_simplex(points) < 0).any()
    assert 0 < training["hull_volume_litre"] * 1e6 < np.prod(np.ptp(points, axis=0))

    error = card["error"]
    left = data.target - cross_val_predict(
        clone(model), data.data, data.target, groups=data.groups, cv=GroupKFold(5)
    )
    # Single-point data: what is left has no position's mean, either.
    for position in np.unique(data.groups):
        left[data.groups == position] -= left[data.groups == position].mean(axis=0)
    assert error["position_means_are_taken_off"]
    assert error["mean_after_mm"] == pytest.approx(np.linalg.norm(left, axis=1).mean(), rel=1e-9)
    expected = single_point_repeatability(left, data.groups)
    assert error["mean_2S_after_mm"] == pytest.approx(expected, rel=1e-9)
    assert error["largest_before_mm"] == pytest.approx(np.linalg.norm(data.target, axis=1).max())
    assert "not seen" in error["after_is_measured_at"]


def test_an_error_at_the_training_rows_is_called_that(model, data):
    target = data.target + np.array([0.02, 0, 0])  # measured against a reference: means are errors
    for params in ({}, {"groups": data.groups, "n_folds": 0}):
        error = describe(model, data.data, target, **params)["error"]
        left = target - model.predict(data.data)
        assert not error["position_means_are_taken_off"]
        assert error["largest_after_mm"] == np.linalg.norm(left, axis=1).max()
        assert "these rows" in error["after_is_measured_at"]


def test_as_json_and_markdown(model, data, tmp_path):
    card = describe(model, data.data, data.target, data.groups, n_folds=2)
    again = ModelCard(json.loads(json.dumps(card)))
    assert again == card
    text = str(again)
    assert text == str(card)
    assert "positions: 8" in text
    assert f"{card['error']['mean_2S_before_mm']:.6g}" in text
    assert "hull corners" not in text
    source, header = export_c(model, tmp_path / "arm.c", card=card)
    assert "positions: 8" in source.read_text()
    assert "positions: 8" in header.read_text()


def test_models_that_are_fitted_with_groups(data):
    model = ArmResidualRegressor(data.arm, orders=2, causes=["kinematics"])
    model.fit(data.data, data.target, groups=data.groups)
    card = describe(model, data.data, data.target, data.groups, n_folds=2)
    left = np.empty_like(data.target)
    for train, test in GroupKFold(2).split(data.data, groups=data.groups):
        copy = clone(model)
        copy.fit(data.data[train], data.target[train], groups=data.groups[train])
        left[test] = data.target[test] - copy.predict(data.data[test])
    expected = single_point_repeatability(left, data.groups)
    assert card["error"]["mean_2S_after_mm"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.exhaustive
def test_the_best_model_is_not_said_to_do_harm():
    """Where each position has an offset, its size is no error of the model."""
    test = make_single_point(n_positions=12, n_poses=30, random_state=0)
    model = ArmResidualRegressor(test.arm, orders=3)
    model.fit(test.data, test.target, groups=test.groups)
    # As they are in a file with micrometres.
    for target in (test.target, test.target.round(3)):
        error = describe(model, test.data, target, test.groups, n_folds=4)["error"]
        assert error["position_means_are_taken_off"]
        assert error["mean_2S_after_mm"] < 0.6 * error["mean_2S_before_mm"]
        assert error["mean_after_mm"] < 0.6 * error["mean_before_mm"]
    # The same poses against a tracker, noise alone: nothing is taken off.
    rng = np.random.default_rng(0)
    for _ in range(20):
        y = rng.normal(size=test.target.shape)
        error = describe(model, test.data, y, test.groups, n_folds=0)["error"]
        assert not error["position_means_are_taken_off"]


def test_a_table_with_names(data):
    pandas = pytest.importorskip("pandas")
    X = pandas.DataFrame(data.data, columns=[f"joint {i}" for i in range(6)])
    network = RBFNetRegressor(12, length_scale=1.5, alpha=0.01)
    model = make_pipeline(PoseFeatures(data.arm, joints="all"), network).fit(X, data.target)
    plain = clone(model).fit(data.data, data.target)
    # A warning of missing or unexpected names would be an error here.
    cards = [
        describe(fitted, table, data.target, data.groups, n_folds=2)
        for fitted, table in ((model, X), (plain, X), (plain, data.data))
    ]
    assert cards[0]["error"] == cards[1]["error"] == cards[2]["error"]


def test_the_fingerprint_of_the_data(model, data, tmp_path):
    card = describe(model, data.data, data.target, data.groups, n_folds=0)
    codes = np.unique(data.groups, return_inverse=True)[1]
    digest = hashlib.sha256()
    for values, kind in ((data.data, "<f8"), (data.target, "<f8"), (codes, "<i8")):
        digest.update(str(values.shape).encode() + values.astype(kind).tobytes())
    assert card["training"]["data_fingerprint"] == digest.hexdigest()
    header = export_c(model, tmp_path / "arm.c", card=card)[1].read_text()
    assert f'#define ARM_DATA_FINGERPRINT "{digest.hexdigest()}"' in header


def test_the_arm_to_the_last_digit_that_means_something(data):
    arm = data.arm.replace(a=np.array([600.0224371, 1 / 3, 8.02978570737851e-11, 0, 0, 0]))
    model = PoseFeatures(arm).fit(data.data)
    text = str(describe(model))
    assert "- a, mm: 600.0224371, 0.333333333, 0.0" in text


def test_a_name_cannot_forge_a_line(data, tmp_path):
    names = ["Arm 7\n- mean 2S after, mm: 0.0010", "Arm 7\r\n## error", "a\u2028- b", "a\x0b- b"]
    names += ["<script>alert(1)</script>", "[x](javascript:alert(1))", "`a` *b* _c_ ![d](e)"]
    names += ["\u202egnirts", "x" * 200]
    for name in names:
        arm = data.arm.replace(name=name)
        network = RBFNetRegressor(3, length_scale=1.5, alpha=0.01)
        model = make_pipeline(PoseFeatures(arm), network).fit(data.data, data.target)
        card = describe(model)
        assert card["arm"]["name"] == name  # as it is, for JSON
        text = str(card)
        plain = describe(make_pipeline(PoseFeatures(data.arm), network).fit(data.data, data.target))
        assert len(text.splitlines()) == len(str(plain).splitlines())
        assert "<" not in text
        assert not re.search(r"(?<!\\)[`*\[]|\u202e", text)
        for path in export_c(model, tmp_path / "arm.c", card=card):
            content = path.read_text(encoding="ascii")
            assert not re.search(r"^ \* - mean 2S", content, re.MULTILINE)
            assert content.count("/*") == content.count("*/")


def test_without_an_arm_and_without_volume():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(40, 3)), rng.normal(size=40)
    card = describe(LinearSVR(random_state=0).fit(X, y), X, y)
    assert card["fingerprint"] is None
    assert "arm" not in card
    assert (card["training"]["rows"], card["training"]["positions"]) == (40, None)
    assert card["error"]["mean_before_mm"] == np.abs(y).mean()
    assert "unknown" in str(card)
    arm = Arm(a=[300, 200], alpha=[0, 0], d=[100, 0], pose_joints=(1, 2), pose_frames=(0, 2))
    X = rng.uniform(0.1, 1, (30, 2))  # a plane
    pose = make_pipeline(PoseFeatures(arm), LinearSVR(random_state=0)).fit(X, X[:, 0])
    assert describe(pose, X)["training"]["hull_volume_litre"] == 0


def test_bad_calls_are_refused(model, data):
    with pytest.raises(NotFittedError):
        describe(clone(model), data.data)
    with pytest.raises(ValueError, match="X, which is None"):
        describe(model, y=data.target)
    with pytest.raises(ValueError, match="inconsistent numbers"):
        describe(model, data.data, data.target[:-1])
    for n_folds in (1, -1, 2.5, True, "5"):
        with pytest.raises(ValueError, match="n_folds must be 0 or a whole number"):
            describe(model, data.data, n_folds=n_folds)
