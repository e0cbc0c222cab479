"""The model of an arm: what it finds, what it refuses to do, and what it is worth on real arms."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sklearn.base import clone

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import make_gauge, make_single_point
from sklearn_raacmm.error_model import _fit
from sklearn_raacmm.error_model._columns import ARCSEC
from sklearn_raacmm.error_model._fit import KINEMATICS_SD
from sklearn_raacmm.metrics import gauge_lengths

from ._arms import ARM, displaced, draw_angles

ALONE = {"causes": []}


@pytest.fixture(scope="module")
def eccentric():
    """Simulated: eccentric encoders and teeth, 400 poses, 3 micrometres of noise."""
    theta = draw_angles(ARM, 400, seed=1)
    error = np.zeros_like(theta)
    error[:, 1] = 6 * np.cos(theta[:, 1] - np.deg2rad(40))
    error[:, 3] = 4 * np.cos(17 * theta[:, 3] + np.deg2rad(100))
    error[:, 5] = 9 * np.sin(2 * theta[:, 5])
    y = displaced(ARM, theta, error)
    return ARM, theta, y + np.random.default_rng(2).normal(0, 0.003, y.shape), y


def test_finds_what_was_put_in(eccentric):
    arm, theta, y, truth = eccentric
    model = ArmResidualRegressor(arm, **ALONE).fit(theta, y)
    table = np.sort(model.harmonics_, order="joint")
    assert table[["joint", "order"]].tolist() == [(2, 1), (4, 17), (6, 2)]
    sd = table["cos_sd_arcsec"]
    assert_allclose(table["amplitude_arcsec"], [6, 4, 9], atol=4 * sd.max())
    off = (table["phase_deg"] - [40, -100, 90] + 180) % 360 - 180
    assert np.all(np.abs(off) < 4 * np.rad2deg(sd / table["amplitude_arcsec"]))
    assert 0.0027 < model.noise_sd_ < 0.0033
    rms = np.sqrt(np.mean((model.predict(theta) - truth) ** 2))
    assert rms < 2 * model.noise_sd_ * np.sqrt(6 / y.size)


def gauge_errors(gauge, correction, length):
    errors = gauge_lengths(gauge.points - correction, gauge.groups, gauge.pairs) - gauge.lengths
    return errors[gauge.lengths == length]


@pytest.fixture(
    scope="module",
    params=[
        "gravity",
        *(pytest.param(m, marks=pytest.mark.exhaustive) for m in ("typical", "eccentricity")),
    ],
)
def gauges(request):
    """Simulated: cones, and gauges of 300 and 500 mm in other places."""
    options = {"machine": request.param, "random_state": 4}
    return make_single_point(10, 30, **options), make_gauge(n_poses=6, **options)


def test_scale_stays_that_of_the_calibration(gauges):
    cone, gauge = gauges
    model = ArmResidualRegressor(cone.arm, orders=4)
    model.fit(cone.data, cone.target, groups=cone.groups)
    before, after = (
        np.stack([points[cone.groups == i].mean(axis=0) for i in range(10)])
        for points in (cone.points, cone.points - model.predict(cone.data))
    )
    # The best similarity from one to the other, by Umeyama's formula: its scale is 1.
    a, b = before - before.mean(axis=0), after - after.mean(axis=0)
    scale = np.linalg.svd(a.T @ b, compute_uv=False).sum() / np.square(a).sum()
    assert scale == pytest.approx(1, abs=1e-7)
    assert np.abs(after - before).max() > 1e-2
    errors = [
        np.abs(gauge_errors(gauge, correction, 500)).mean()
        for correction in (0.0, model.predict(gauge.data))
    ]
    assert errors[1] < 0.8 * errors[0]
    # What is said of the coefficients is said after this.
    table = model.terms_["family"] == "kinematics"
    assert_allclose(model.terms_["value"][table], model.coef_[-len(table) :][table])
    _, std = model.predict(cone.data[:5], return_std=True)
    assert np.all(std > 0)


def test_without_kinematics_lengths_are_not_promised(gauges):
    cone, _ = gauges
    model = ArmResidualRegressor(cone.arm, orders=1, causes=[])
    with pytest.warns(UserWarning, match="nothing holds the distances between positions") as seen:
        model.fit(cone.data, cone.target, groups=cone.groups)
    assert seen[0].filename == __file__
    # No offsets, or known lengths: no warning of distances. Without their causes the errors of the
    # arm are constants of positions.
    warnings.filterwarnings("ignore", "The positions differ by constants")
    model.fit(cone.data, cone.points - cone.simulation.true_points, groups=cone.groups)
    means = cone.simulation.positions
    known = [(0, 1, float(np.linalg.norm(means[0] - means[1])), 0.01)]
    model.fit(cone.data, cone.target, groups=cone.groups, lengths=known)


def test_known_lengths_join_the_fit(gauges):
    """Trained with the gauges of 300 mm, judged by those of 500 mm."""
    cone, gauge = gauges
    short = np.isin(gauge.groups, gauge.pairs[gauge.lengths == 300])
    theta = np.vstack([cone.data, gauge.data[short]])
    y = np.vstack([cone.target, gauge.target[short]])
    groups = np.r_[cone.groups, 100 + gauge.groups[short]]
    known = [(100 + a, 100 + b, 300.0, 0.003) for a, b in gauge.pairs[gauge.lengths == 300]]
    model = ArmResidualRegressor(cone.arm, orders=4)
    errors = [
        np.abs(gauge_errors(gauge, correction, 500)).mean()
        for correction in (
            0.0,
            clone(model).fit(theta, y, groups=groups, lengths=known).predict(gauge.data),
        )
    ]
    assert errors[1] < 0.5 * errors[0]


def test_slipped_poses_are_left_out(eccentric):
    """As good as without them; where there are none, none is taken for one."""
    arm, theta, y, truth = eccentric
    groups = np.arange(len(y)) % 20
    rng = np.random.default_rng(4)
    bad = rng.random(len(y)) < 0.05
    slipped = y + np.where(bad[:, None], rng.normal(0, 0.5, y.shape), 0.0)
    model = ArmResidualRegressor(arm, orders=[1, 2, 17], causes=["kinematics"])
    new = draw_angles(arm, 200, seed=8)
    for offsets in (False, True):
        model.set_params(offsets=offsets)
        clean = clone(model).fit(theta[~bad], y[~bad], groups=groups[~bad])
        robust = clone(model).fit(theta, slipped, groups=groups)
        assert np.all(robust.pose_weight_[bad & (np.abs(slipped - y).max(axis=1) > 0.1)] == 0)
        assert np.mean(robust.pose_weight_[~bad]) > 0.8
        assert robust.noise_sd_ == pytest.approx(clean.noise_sd_, rel=0.02)
        expected = clean.predict(new)
        # By less than the noise of one good pose, where a slip is 170 times as large.
        assert np.abs(robust.predict(new) - expected).mean() < 0.001
    same = model.set_params(offsets=False).fit(
        theta, truth + np.random.default_rng(5).normal(0, 0.003, y.shape)
    )
    assert_array_equal(same.pose_weight_, 1)


def test_few_poses_without_noise_are_no_reason_to_fail():
    """Fifteen poses, hundreds of columns, a residual that they explain entirely."""
    for seed in range(2):
        theta = draw_angles(ARM, 15, seed=seed)
        y = displaced(ARM, theta, np.tile([0, 5.0, -3.0, 0, 0, 0], (15, 1)))
        model = ArmResidualRegressor(ARM).fit(theta, y)
        assert np.linalg.norm(model.predict(theta) - y) < 0.05 * np.linalg.norm(y)


def test_offsets_are_free(eccentric):
    """A constant in every position, however large, changes nothing; without offsets it would."""
    arm, theta, y, _ = eccentric
    groups = np.arange(len(y)) % 20
    rng = np.random.default_rng(3)
    moved = y + rng.normal(0, 1.0, (20, 3))[groups]
    model = ArmResidualRegressor(arm, offsets=True, orders=4, causes=["kinematics"])
    expected = clone(model).fit(theta, y, groups=groups)
    found = clone(model).fit(theta, moved, groups=groups)
    assert found.offsets_
    assert_allclose(found.predict(theta), expected.predict(theta), atol=1e-6)
    free = clone(model).set_params(offsets=False).fit(theta, moved, groups=groups)
    assert np.abs(free.linear_model_.predict(theta)[0] - expected.predict(theta)).max() > 0.01


@pytest.mark.filterwarnings("ignore:Within a position")  # of a tracker's residuals
def test_offsets_auto(eccentric):
    arm, theta, y, _ = eccentric
    groups = np.array(list("abcde"))[np.arange(len(y)) % 5]
    model = ArmResidualRegressor(arm, orders=1, causes=["kinematics"])
    assert not model.fit(theta, y).offsets_
    assert not model.fit(theta, y, groups=groups).offsets_
    centred = position_residuals(y, groups)
    assert model.fit(theta, centred, groups=groups, accept="rows-unrelated").offsets_
    # Deviations from a median know as little of the arm.
    codes = np.arange(len(y)) % 20
    medians = np.array([np.median(y[codes == code], axis=0) for code in range(20)])
    assert model.fit(theta, y - medians[codes], groups=codes).offsets_
    # Constants beside the arm's own errors have a size that is found.
    size = 0.05 * np.random.default_rng(1).normal(size=(5, 3))
    with pytest.warns(UserWarning, match=r"positions differ by constants of 0\.0"):
        assert not model.fit(theta, y + size[np.arange(len(y)) % 5], groups=groups).offsets_


@pytest.mark.filterwarnings("ignore:The positions differ by constants")
@pytest.mark.parametrize("size_mm", [0.0, 0.003, 0.1])
def test_no_size_of_constants_is_missed_where_the_search_for_it_ends(size_mm, monkeypatch):
    """The evidence has one top: with all sizes tried the predictions are the same."""
    theta = draw_angles(ARM, 160)
    rng = np.random.default_rng(2)
    groups = np.arange(len(theta)) % 16
    y = displaced(ARM, theta, np.tile([0, 5.0, -3.0, 0, 0, 0], (160, 1)))
    y += rng.normal(0, 0.003, y.shape) + size_mm * rng.normal(size=(16, 3))[groups]
    model, found = ArmResidualRegressor(ARM, orders=1, causes=["kinematics"]), []
    for nats in (_fit._FAR_BELOW, np.inf):
        monkeypatch.setattr(_fit, "_FAR_BELOW", nats)
        found.append(clone(model).fit(theta, y, groups=groups))
    assert_array_equal(found[0].predict(theta), found[1].predict(theta))
    codes = [finding.code for finding in found[0].findings_]
    assert ("constants-of-positions" in codes) == (size_mm > 0.01)


def test_kinematic_errors_come_back_in_their_units():
    theta = draw_angles(ARM, 300)
    d, alpha = ARM.d.copy(), ARM.alpha.copy()
    d[2] += 0.05
    alpha[3] += 12 * ARCSEC
    true = ARM.replace(d=d, alpha=alpha)
    y = ARM.forward(theta) - true.forward(theta)
    y += np.random.default_rng(0).normal(0, 0.002, y.shape)
    model = ArmResidualRegressor(ARM, causes=["kinematics"]).fit(theta, y)
    value = dict(zip(model.terms_["name"], model.terms_["value"], strict=True))
    sd = dict(zip(model.terms_["name"], model.terms_["sd"], strict=True))
    length = ARCSEC * ARM.reach_mm
    # Of each length alone as much is open as others may make up for; less than the drawing leaves.
    assert abs(value["d3"] * length + 0.05) < 0.02
    assert abs(value["d3"] * length + 0.05) < 4 * sd["d3"] * length
    assert sd["d3"] < 0.05 * KINEMATICS_SD
    assert abs(value["alpha4"] + 12) < 4 * sd["alpha4"] < 4
    assert len(model.harmonics_) <= 1


def leave_placements_out(data):
    """Mean deviation in every other placement, uncorrected and by models that never saw it."""
    before, after = [], []
    for placement in np.unique(data.placements)[::2]:
        train = data.placements != placement
        lengths = [(f"{p}/0", f"{p}/1", 50.0, 0.1) for p in np.unique(data.placements[train])]
        nominal = Arm.from_name("panda", probe=(0, 0, 138))
        given = data.angles[train], data.groups[train]
        arm = calibrate(nominal, *given, lengths=lengths, accept="moved-position").arm
        y = position_residuals(arm.forward(data.angles), data.groups)
        model = ArmResidualRegressor(arm)
        model.fit(data.angles[train], y[train], groups=data.groups[train])
        assert model.offsets_
        left = y[~train] - model.predict(data.angles[~train])
        left = position_residuals(left, data.groups[~train])
        before.append(np.linalg.norm(y[~train], axis=1))
        after.append(np.linalg.norm(left, axis=1))
    return np.concatenate(before).mean(), np.concatenate(after).mean()


@pytest.mark.filterwarnings("ignore:The fixed point seems to have moved")  # of panda_2
@pytest.mark.parametrize(
    ("name", "share"), [("panda_3", 0.85), pytest.param("panda_2", 1, marks=pytest.mark.exhaustive)]
)
def test_a_real_arm_at_unseen_placements(panda, name, share):
    before, after = leave_placements_out(panda(name))
    assert after < share * before


@pytest.mark.exhaustive
def test_a_real_robot_at_unseen_goals(ur10):
    """Every sixth pose; goal positions are either for training or for testing."""
    rows = slice(None, None, 6)
    theta, points, goals = ur10.angles[rows], ur10.points[rows], ur10.groups[rows]
    train = np.random.default_rng(0).permutation(goals.max() + 1)[goals] % 4 > 0
    nominal = Arm.from_name("ur10", probe=(0, 0, 109))
    result = calibrate(nominal, theta[train], points=points[train])
    y = result.residuals(theta, points)
    model = ArmResidualRegressor(result.arm).fit(theta[train], y[train], groups=goals[train])
    assert not model.offsets_
    left = (y - model.predict(theta))[~train]
    assert np.linalg.norm(left, axis=1).mean() < 0.3 * np.linalg.norm(y[~train], axis=1).mean()
    # The teeth of the gears: 17 to the turn in shoulder and elbow.
    found = set(model.harmonics_[["joint", "order"]].tolist())
    assert {(1, 17), (2, 17), (3, 17)} <= found


def test_score_is_that_of_deviations_within_positions():
    """With the positions, and without them, for rows of one position are from one point."""
    test = make_single_point(n_positions=8, n_poses=15)
    known = test.groups < 5
    model = ArmResidualRegressor(test.arm, orders=4)
    model.fit(test.data[known], test.target[known], groups=test.groups[known])
    X, y, groups = test.data[~known], test.target[~known], test.groups[~known]
    left = y - model.predict(X)
    for label in np.unique(groups):
        left[groups == label] -= left[groups == label].mean(axis=0)
    expected = 1 - np.square(left).sum() / np.square(y).sum()  # y are deviations themselves
    assert model.score(X, y, groups) == pytest.approx(expected, rel=1e-6)
    assert model.score(X, y) == pytest.approx(expected, rel=1e-6)
    assert expected > 0.5
    scattered = y + np.random.default_rng(0).normal(size=y.shape)
    with pytest.raises(ValueError, match="score got no groups"):
        model.score(X, scattered)
