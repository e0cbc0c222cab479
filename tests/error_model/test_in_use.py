"""A fitted model in use: moved to a probe, uncertain together, and the other way round."""

import dataclasses
import pickle
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, check_correction, update_correction
from sklearn_raacmm.datasets import make_single_point

ARM = Arm.from_name("aacmm6")
LONG = ARM.replace(probe=(20.0, -10.0, 350.0))
ARCSEC = np.pi / 180 / 3600
EXTRA = ["temperature", "force x"]


def errors(arm, X):
    """Eccentric encoders, one link that grows, and a force that bends joint 3."""
    angles, warm, force = X[:, :6], X[:, 6] - 20, X[:, 7] - 5
    turn = np.zeros_like(angles)
    turn[:, 1] = 12 * np.cos(angles[:, 1])
    turn[:, 4] = 30 * np.sin(2 * angles[:, 4])
    jacobian = arm.jacobian(angles)
    y = np.einsum("nij,nj->ni", jacobian, turn * ARCSEC)
    y += 11.7e-6 * warm[:, None] * arm.forward(angles)
    torque = jacobian[:, 0, 2] * force
    return y + jacobian[:, :, 2] * (1e-7 * torque)[:, None]


def rows(n, seed, noise_mm=0.002):
    rng = np.random.default_rng(seed)
    X = np.column_stack([rng.uniform(-2, 2, (n, 6)), rng.normal(20, 3, n), rng.normal(5, 2, n)])
    return X, errors(ARM, X) + rng.normal(0, noise_mm, (n, 3))


@pytest.fixture(scope="module")
def model():
    return ArmResidualRegressor(ARM, orders=4, extra=EXTRA, fade=0).fit(*rows(600, 0))


def test_the_same_causes_move_another_probe(model):
    """Against the simulation, and against the columns of the new arm in physical units."""
    X = rows(300, 1)[0]
    true = errors(LONG, X)
    moved = model.with_arm(LONG)
    assert moved.arm_ == LONG
    assert model.arm_ == ARM
    old, new = (np.linalg.norm(true - m.predict(X), axis=1).mean() for m in (model, moved))
    # 0.0030 of 0.077 mm; the old probe leaves 0.021.
    assert new < 0.005
    assert new < 0.3 * old
    back = moved.with_arm(ARM)
    assert_allclose(back.predict(X), model.predict(X), atol=1e-9)
    # What the long probe never shows of the table is not doubted after it any more.
    std = model.predict(X, return_std=True)[1]
    assert_allclose(back.predict(X, return_std=True)[1], std, rtol=5e-3)


def test_degrees_give_the_same_model():
    """What stands beside the angles stays what it is."""
    X, y = rows(120, 8)
    degrees = np.column_stack([np.rad2deg(X[:, :6]), X[:, 6:]])
    small = {"orders": 2, "causes": ["kinematics"], "extra": EXTRA}
    rad = ArmResidualRegressor(ARM, **small).fit(X, y)
    deg = ArmResidualRegressor(ARM, angle_unit="deg", **small).fit(degrees, y)
    for found, expected in zip(deg.predict(degrees, True), rad.predict(X, True), strict=True):
        assert_allclose(found, expected, atol=1e-9)
    assert_allclose(deg.fading(degrees), rad.fading(X), atol=1e-9)
    # and what checks and updates asks for the same unit
    both = (rad, X), (deg, degrees)
    checks = [check_correction(one, known, y).p_value for one, known in both]
    assert checks[0] == pytest.approx(checks[1], rel=1e-6)
    new = [update_correction(one, known, y).predict(known) for one, known in both]
    assert_allclose(new[1], new[0], atol=1e-5)


def test_an_exchanged_arm_is_not_ignored(model):
    X, y = rows(200, 4)
    exchanged = ArmResidualRegressor(ARM, orders=2, extra=EXTRA).fit(X, y).set_params(arm=LONG)
    for ask in (exchanged.predict, exchanged.correct, exchanged.fading):
        with pytest.raises(ValueError, match="moved to another probe by with_arm"):
            ask(X)
    assert exchanged.fit(X, y).arm_ == LONG


def test_a_registration_finds_the_probe_through_the_moved_model():
    """A tracker with a new probe: as well as with a model that knew it from the start."""
    rng = np.random.default_rng(5)
    X, y = rows(400, 6)
    model = ArmResidualRegressor(ARM, orders=4, fade=0).fit(X[:, :6], errors_bare(ARM, X))
    new = rng.uniform(-2, 2, (40, 6))
    points = LONG.forward(new) - errors_bare(LONG, new) + [500, 0, 0]
    found = calibrate(ARM, new, points=points, correction=model, free=["probe"])
    assert np.abs(found.arm.probe - LONG.probe).max() < 0.002
    y = found.residuals(new, points)
    moved = model.with_arm(found.arm)
    assert np.abs(y - moved.predict(new)).max() < 0.003
    updated = update_correction(moved, new, y)
    assert updated.arm_ == found.arm
    assert np.abs(y - updated.predict(new)).max() < 0.003


def test_a_stated_probe_is_in_doubt_by_how_the_last_frame_is_turned(model):
    """A turn of 75 arc seconds about any axis, times how far the probe is from the old one."""
    X, old = rows(100, 9)[0], np.array(ARM.probe)

    def variance(model):
        return np.square(model.predict(X, return_std=True)[1]).sum(axis=1)

    for more in ([0, 0, 100], [100, 0, 0], [0, 100, 0], [70, -80, 120]):
        far = ARM.replace(probe=old + more)
        found, stated = model.with_arm(far), model.with_arm(far, stated=True)
        assert_allclose(stated.predict(X), found.predict(X), atol=1e-12)
        doubt = np.sqrt(np.mean(variance(stated) - variance(found)))
        turned = model.linear_model_.std_scale * 75 * ARCSEC * np.sqrt(2) * np.linalg.norm(more)
        assert 0.6 * turned < doubt < 1.5 * turned
    # Mounted elsewhere it is in doubt as before.
    wall = stated.with_arm(far.replace(up=(1, 0, 0))).with_arm(far)
    assert_allclose(variance(wall), variance(stated), rtol=1e-6)
    # What is found or stated after it does not depend on it, whatever was kept of it.
    again = pickle.loads(pickle.dumps(stated))
    for last in (False, True):
        of_both = (one.with_arm(LONG, stated=last) for one in (again, model))
        assert_allclose(*map(variance, of_both), rtol=1e-9)


def errors_bare(arm, X):
    X = np.column_stack([X[:, :6], np.full(len(X), 20.0), np.full(len(X), 5.0)])
    return errors(arm, X)


@pytest.fixture(scope="module")
def cones():
    test = make_single_point(n_positions=8, n_poses=15)
    model = ArmResidualRegressor(test.arm, orders=4)
    return test, model.fit(test.data, test.target, groups=test.groups)


def test_the_joint_covariance_contains_the_single_ones(cones):
    test, model = cones
    X = test.data[:12]
    mean, std = model.predict(X, return_std=True)
    again, cov = model.predict(X, return_cov=True, with_unseen=False)
    assert_allclose(again, mean)
    assert_allclose(np.sqrt(cov.diagonal()), std.ravel(), rtol=1e-6)
    noisy = model.predict(X, return_cov=True, with_noise=True, with_unseen=False)[1]
    both = model.predict(X, return_std=True, with_noise=True)[1]
    assert_allclose(np.sqrt(noisy.diagonal()), both.ravel(), rtol=1e-6)
    # A length, by one product, is what distance_std has of it.
    first, second = X[:1], test.data[-1:]
    pair = np.vstack([first, second])
    cov = model.predict(pair, return_cov=True)[1]
    line = np.subtract(*test.arm.forward(pair)[::-1])
    g = np.r_[-line, line] / np.linalg.norm(line)
    assert_allclose(np.sqrt(g @ cov @ g), model.distance_std(first, second), rtol=1e-6)
    with pytest.raises(ValueError, match="X1 has 12 poses and X2 has 11"):
        model.distance_std(X, X[1:])
    with pytest.raises(ValueError, match="cannot both be True"):
        model.predict(X, return_std=True, return_cov=True)


@pytest.mark.parametrize("std_scale", [0.2, 1.0, 2.0])
def test_what_positions_do_not_show_is_the_rest_of_the_covariance(cones, std_scale):
    """By products with the whole roots; of a narrow root what is shown may be more than both."""
    test, model = cones
    linear = dataclasses.replace(model.linear_model_, std_scale=std_scale)
    X = test.data[::3]
    both, shown = (
        linear.joint_covariance(X, with_unseen=some).diagonal() for some in (True, False)
    )
    found = linear.unseen_variance(X)
    assert_allclose(found.ravel(), np.maximum(both - shown, 0), atol=1e-9 * both.max())
    assert found.max() > 0.1 * both.max()


@pytest.mark.parametrize("unit", [pytest.param("rad", marks=pytest.mark.exhaustive), "deg"])
def test_angles_for_points_are_those_of_the_corrected_probe(unit):
    rng = np.random.default_rng(7)
    X = rng.uniform(-2, 2, (300, 6))
    model = ArmResidualRegressor(ARM, orders=30, angle_unit=unit)
    turned = np.rad2deg(X) if unit == "deg" else X
    model.fit(turned, errors_bare(ARM, X) + rng.normal(0, 0.002, (300, 3)))
    wanted, start = ARM.forward(X), turned + rng.normal(0, 0.01, X.shape)
    found = model.angles_for(wanted, start)
    assert np.abs(model.correct(found) - wanted).max() < 1e-6
    # One start for all, far away: what is found is right, or is said to be missing.
    with pytest.warns(UserWarning, match=r"2 of 6 points are not reached: first that of row 4"):
        far = model.angles_for(np.vstack([wanted[:4], [[9000, 0, 0]] * 2]), turned[:6])
    assert np.isnan(far).all(axis=1).tolist() == [False] * 4 + [True] * 2


def test_starts_are_warned_of_in_the_unit_of_the_model():
    test = make_single_point(5, 12, random_state=0)
    model = ArmResidualRegressor(test.arm, orders=2, angle_unit="deg")
    model.fit(np.rad2deg(test.data), test.target, groups=test.groups)
    start = np.rad2deg(test.data[:1])
    start[:, 0] += 3 * 360.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # 20 rad are many, but 1100 degrees are not
        found = model.angles_for(model.correct(start), start)
    assert_allclose(model.correct(found), model.correct(start), atol=1e-6)


def test_angles_for_orientations_are_those_of_the_true_arm():
    """Encoders with errors turn the last link: the true arm's own frames say how much is left."""
    rng = np.random.default_rng(8)
    X, amplitude = rng.uniform(-2, 2, (400, 6)), np.array([1, -2, 1.5, 2, -1, 3]) * 1e-4

    def true(angles):  # the angles that the joints really have
        return angles - amplitude * np.cos(angles)

    y = ARM.forward(X) - ARM.forward(true(X)) + rng.normal(0, 0.001, X[:, :3].shape)
    model = ArmResidualRegressor(ARM, orders=3).fit(X, y)
    wanted = X[:40]
    points, turned = ARM.forward(wanted), ARM.frames(wanted)[:, -1, :, :3]

    def arc_seconds(angles):
        off = ARM.frames(true(angles))[:, -1, :, :3].swapaxes(1, 2) @ turned
        return np.rad2deg(Rotation.from_matrix(off).magnitude()) * 3600

    found = model.angles_for(points, wanted, turned)
    assert np.abs(model.correct(found) - points).max() < 1e-6
    assert np.median(arc_seconds(wanted)) > 50
    assert np.median(arc_seconds(model.angles_for(points, wanted))) > 20
    assert np.max(arc_seconds(found)) < 5


@pytest.mark.filterwarnings("ignore:.* points are not reached")
def test_angles_for_take_each_row_its_extra_columns():
    """Some rows are tried again: their temperature and force must still be their own."""
    X, y = rows(300, 9)
    model = ArmResidualRegressor(ARM, orders=2, extra=EXTRA).fit(X, y)
    points, start = ARM.forward(X[:30, :6]), X[:30].copy()
    start[::3, :6] += 0.8
    turned = ARM.frames(X[:30, :6])[:, -1, :, :3]
    for wanted in (None, turned):
        found = model.angles_for(points, start, wanted)
        there = np.isfinite(found[:, 0])
        assert there.sum() >= 28
        left = model.correct(np.hstack([found, X[:30, 6:]])[there]) - points[there]
        assert np.abs(left).max() < 1e-6
    one = model.angles_for(points, start[1:2])
    same = np.hstack([one, np.repeat(start[1:2, 6:], 30, axis=0)])
    assert np.abs(model.correct(same) - points).max() < 1e-6
