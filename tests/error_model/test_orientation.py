"""Orientations: what the causes do to them, what they teach, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from sklearn import config_context
from sklearn.base import clone
from sklearn.model_selection import GroupKFold, cross_validate

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate
from sklearn_raacmm.error_model._columns import ARCSEC, Terms, term_columns, term_names

ARMS = {
    "standard": Arm.from_name("aacmm6", joint_signs=[1, -1, 1, 1, -1, 1]),
    "modified": Arm.from_name("panda", probe=(10.0, -20.0, 150.0)),
}
NONE = np.empty((0, 2), int)
SMALL = {"orders": 2, "causes": ["kinematics"]}


def orientation(arm, theta):
    return arm.frames(theta)[:, -1, :3, :3]


def turned_by(new, old):
    """Rotation vectors (n, 3) in the base frame from old to new orientations."""
    return Rotation.from_matrix(new @ np.swapaxes(old, 1, 2)).as_rotvec()


# -- columns --------------------------------------------------------------------------------------


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_columns_are_what_changes_of_the_arm_do_to_its_orientation(arm):
    theta = np.random.default_rng(0).uniform(-2, 2, (20, arm.n_joints))
    pairs = np.array([(j, 2) for j in range(arm.n_joints)])
    terms = Terms(pairs, False, True, False, target=True)
    columns = term_columns(arm, theta, terms, True)
    for joint in range(arm.n_joints):
        for part, wave in enumerate((np.cos, np.sin)):
            error = np.zeros_like(theta)
            error[:, joint] = ARCSEC * wave(2 * theta[:, joint])
            moved = turned_by(orientation(arm, theta + error), orientation(arm, theta))
            assert_allclose(columns[:, :, 2 * joint + part], moved, atol=1e-10)
    named = dict(zip(term_names(arm, terms)[0], columns[:, :, 2 * len(pairs) :].T, strict=True))
    lengths = [n for n in named if n[:-1] in ("a", "d", "base_", "probe_") and n[-2:] != "ta"]
    assert len(lengths) == 2 * arm.n_joints + 5
    assert not any(named[n].any() for n in lengths)
    for field in ("alpha", "theta_offset"):
        for joint in range(arm.n_joints):
            value = getattr(arm, field).copy()
            value[joint] += ARCSEC
            moved = turned_by(
                orientation(arm.replace(**{field: value}), theta), orientation(arm, theta)
            )
            assert_allclose(named[f"{field}{joint + 1}"].T, moved, atol=1e-12)
    target = Rotation.from_rotvec([0, ARCSEC, 0]).as_matrix()
    moved = turned_by(orientation(arm, theta) @ target, orientation(arm, theta))
    assert_allclose(named["target_y"].T, moved, atol=1e-12)
    assert_allclose(named["base_beta"].T, np.tile([0, ARCSEC, 0], (20, 1)), atol=1e-15)
    assert not term_columns(arm, theta, terms)[:, :, -3:].any()  # it moves no point


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_a_turn_moves_the_probe_by_its_lever_whatever_its_cause(arm):
    """Of turns of the last frame: what they do to a point is their vector times the probe."""
    theta = np.random.default_rng(1).uniform(-2, 2, (20, arm.n_joints))
    extra = (("direction 2", (0.0,)), ("payload", (0.0,)))
    terms = Terms(np.array([(arm.n_joints - 1, 3)]), True, False, True, extra)
    X = np.column_stack([theta, np.ones(20), np.full(20, 2.0)])
    points, turns = term_columns(arm, X, terms), term_columns(arm, X, terms, True)
    names = ["cos", "sin", *term_names(arm, terms)[0]]
    frames = arm.frames(theta)
    lever = arm.forward(theta) - frames[:, -1, :, 3]
    last = [i for i, n in enumerate(names) if f"bends frame {arm.n_joints} " in n]
    assert len(last) == 6  # by the probe's own load, and by the payload
    for i in last:
        assert_allclose(np.cross(turns[:, :, i], lever), points[:, :, i], atol=1e-12)
    lag = names.index("joint 2 lags")
    frame = 1 if arm.convention == "standard" else 2
    expected = arm.joint_signs[1] * ARCSEC * frames[:, frame, :, 2]
    assert_allclose(turns[:, :, lag], expected, atol=1e-15)


# -- what they teach ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured():
    """Simulated: three encoders err; a tracker with noise of 0.05 mm and 40 arc seconds.

    The axis of joint 6 goes through the probe: no point shows what it does.
    """
    arm, rng = Arm.from_name("ur10", probe=(0, 0, 93)), np.random.default_rng(0)
    theta = rng.uniform(-2, 2, (300, 6))

    def residuals(q):
        error = np.zeros_like(q)
        error[:, 1] = 30 * ARCSEC * np.cos(q[:, 1])
        error[:, 4] = 120 * ARCSEC * np.sin(q[:, 4])
        error[:, 5] = 150 * ARCSEC * np.cos(2 * q[:, 5])
        y = arm.forward(q + error) - arm.forward(q)
        return y, turned_by(orientation(arm, q + error), orientation(arm, q))

    y, turns = residuals(theta)
    y = y + rng.normal(scale=0.05, size=y.shape)
    turns = turns + rng.normal(scale=40 * ARCSEC, size=y.shape)
    new = rng.uniform(-2, 2, (200, 6))
    return arm, theta, y, turns, new, *residuals(new)


def rms(errors):
    return np.sqrt(np.mean(np.square(errors)))


def test_orientations_show_what_points_do_not(measured):
    arm, theta, y, turns, new, y_new, turns_new = measured
    model = ArmResidualRegressor(arm, **SMALL)
    by_points = model.fit(theta, y)
    left = turns_new - by_points.predict_orientation(new)
    assert rms(left) < 0.95 * rms(turns_new)  # joints 2 and 5 are known, 6 is not
    points_only = rms(y_new - by_points.predict(new))
    both = ArmResidualRegressor(arm, **SMALL).fit(theta, y, orientation_residuals=turns)
    error = turns_new - both.predict_orientation(new)
    assert rms(error) < 0.15 * rms(left)
    assert (6, 2) in both.harmonics_[["joint", "order"]].tolist()
    assert rms(y_new - both.predict(new)) < points_only
    # Each is weighed by its noise, and both noises are found.
    assert both.noise_sd_ == pytest.approx(0.05, rel=0.06)
    noise = both.noise_sd_ / both.linear_model_.turn_mm
    assert noise == pytest.approx(40 * ARCSEC, rel=0.06)
    mean, std = both.predict_orientation(new, return_std=True)
    assert_array_equal(mean, both.predict_orientation(new))
    assert 0.4 < rms(error / std) < 1.6
    noisy = both.predict_orientation(new, return_std=True, with_noise=True)[1]
    assert_allclose(noisy, np.hypot(std, both.linear_model_.turn_noise))


def test_orientations_fade_with_the_points(measured):
    arm, theta, y, turns, new, *_ = measured
    model = ArmResidualRegressor(arm, fade=20.0, **SMALL)
    model.fit(theta, y, orientation_residuals=turns)
    plain = clone(model).set_params(fade=0).fit(theta, y, orientation_residuals=turns)
    share = model.fading(new)
    assert share.min() < 0.9
    expected = share[:, None] * plain.predict_orientation(new)
    assert_allclose(model.predict_orientation(new), expected, rtol=1e-9)


def test_no_turn_where_the_correction_does_not_help():
    arm, rng = ARMS["standard"], np.random.default_rng(2)
    theta, groups = rng.uniform(-2, 2, (120, 6)), np.arange(120) % 8
    model = ArmResidualRegressor(arm, **SMALL)
    model.fit(theta, rng.normal(size=(120, 3)), groups=groups)
    assert not model.helps_
    found, std = model.predict_orientation(theta, return_std=True)
    assert not found.any()
    assert np.all(std > 0)


def test_points_and_orientation_have_the_same_cause():
    """Of points without noise: the orientation follows from the encoders' errors that they show."""
    arm, rng = ARMS["modified"], np.random.default_rng(3)
    theta = rng.uniform(-2, 2, (200, 7))
    error = np.zeros_like(theta)
    error[:, 2] = 20 * ARCSEC * np.cos(theta[:, 2])
    error[:, 4] = -25 * ARCSEC * np.sin(2 * theta[:, 4])
    y = arm.forward(theta + error) - arm.forward(theta)
    y += rng.normal(scale=1e-4, size=y.shape)
    model = ArmResidualRegressor(arm, orders=2, causes=[]).fit(theta, y)
    turns = turned_by(orientation(arm, theta + error), orientation(arm, theta))
    assert rms(turns - model.predict_orientation(theta)) < 0.01 * rms(turns)
    correction = Rotation.from_rotvec(model.predict_orientation(theta)).as_matrix()
    corrected = np.swapaxes(correction, 1, 2) @ orientation(arm, theta + error)
    assert rms(turned_by(corrected, orientation(arm, theta))) < 0.01 * rms(turns)


def test_from_a_calibration(measured):
    """In the frames of a tracker and of a target that nobody knows beforehand."""
    arm, theta, y, turns, *_ = measured
    tracker = Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix()
    target = Rotation.from_euler("xyz", [1.0, 0.3, -0.7]).as_matrix()
    true = np.swapaxes(Rotation.from_rotvec(turns).as_matrix(), 1, 2) @ orientation(arm, theta)
    options = {"points": (arm.forward(theta) - y) @ tracker.T + [1000.0, -500.0, 300.0]}
    options["orientations"] = tracker @ true @ target
    result = calibrate(arm, theta, free=["probe"], loss="squared", **options)
    found = result.orientation_residuals(theta, options["orientations"])
    shown = result.base_rotation @ orientation(result.arm, theta) @ result.target_rotation
    expected = turned_by(shown, options["orientations"]) @ result.base_rotation
    assert_allclose(found, expected, atol=1e-9)
    # The base and the target are fitted to them and take up a part of the rest, too.
    assert rms(found - turns) < 0.35 * rms(turns)
    degrees = result.orientation_residuals(
        np.rad2deg(theta), Rotation.from_matrix(options["orientations"]), angle_unit="deg"
    )
    assert_allclose(degrees, found, atol=1e-9)
    with pytest.raises(ValueError, match="need a calibration with orientations"):
        calibrate(arm, theta, points=options["points"]).orientation_residuals(
            theta, options["orientations"]
        )
    for several in ({"arms": {1: arm, 2: arm}}, {"bases": {1: None, 2: None}}):
        with pytest.raises(ValueError, match="of one tool and one station"):
            replace(result, **several).orientation_residuals(theta, options["orientations"])


def test_weights_folds_and_routing(measured):
    arm, theta, y, turns, *_ = measured
    groups = np.arange(len(y)) % 6
    model = ArmResidualRegressor(arm, offsets=False, **SMALL)
    weights = np.random.default_rng(0).integers(0, 3, len(y))
    weighted = model.fit(theta, y, sample_weight=weights, orientation_residuals=turns)
    expected = weighted.predict_orientation(theta)
    rows = np.repeat(np.arange(len(y)), weights)
    model.fit(theta[rows], y[rows], orientation_residuals=turns[rows])
    assert_allclose(model.predict_orientation(theta), expected, atol=1e-9)
    # Rows of it are taken with the rows of X.
    given = {"orientation_residuals": turns}
    scores = cross_validate(
        model, theta, y, cv=GroupKFold(3), groups=groups, params=given, error_score="raise"
    )
    assert np.all(np.isfinite(scores["test_score"]))
    with config_context(enable_metadata_routing=True):
        model.set_fit_request(orientation_residuals=True, groups=False)
        given["groups"] = groups
        routed = cross_validate(model, theta, y, cv=GroupKFold(3), params=given)
    assert_allclose(routed["test_score"], scores["test_score"])


def test_what_is_refused(measured):
    arm, theta, y, turns, *_ = measured
    model = ArmResidualRegressor(arm, **SMALL)
    for given, message in [
        (turns[:, :2], r"must be 300 rotation vectors in rad, shape \(300, 3\), got \(300, 2\)"),
        (turns[:5], r"got \(5, 3\)"),
        (np.full_like(turns, 3.0), "reach 5.2 rad: they must be small errors"),
        (np.full_like(turns, np.nan), "NaN or infinity"),
    ]:
        with pytest.raises(ValueError, match=message):
            model.fit(theta, y, orientation_residuals=given)
    with pytest.raises(ValueError, match="here positions have unknown offsets"):
        model.set_params(offsets=True).fit(
            theta, y, groups=np.arange(300) % 9, orientation_residuals=turns
        )
