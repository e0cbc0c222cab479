"""Calibration of arms with joints that slide."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm, Measurements, calibrate
from sklearn_raacmm.calibration._fit import TableFit

RAIL = Arm.from_name("ur10_rail").replace(probe=(20, 30, 100))


def test_a_scale_and_a_direction_of_a_rail_are_found_and_kept_in_the_arm():
    true = RAIL.replace(
        joint_signs=[1 + 40e-6, 1, 1, 1, 1, 1, 1], alpha=RAIL.alpha + 0.004 * (np.arange(7) == 0)
    )
    q = RAIL.random_poses(120)
    points = true.forward(q) + np.random.default_rng(1).normal(0, 0.02, (120, 3))
    result = calibrate(RAIL, q, points=points + np.array([3000, 0, 0]))
    i = result.names.index("scale1")
    off = (result.values[i] - 1 - 40e-6) / result.standard_deviations[i]
    assert abs(off) < 3
    assert result.standard_deviations[i] < 5e-6
    assert result.arm.joint_signs[0] == result.values[i]
    assert any(text.startswith("scale of joint 1 +") for text in result.changes)
    assert abs(result.values[result.names.index("alpha1")] - true.alpha[0]) < 1e-4
    assert Arm.from_json(result.arm.to_json()) == result.arm
    with pytest.warns(UserWarning, match="whoever reads the file has to multiply J1 by 1.0000"):
        result.arm.to_urdf()


def test_what_a_rail_parallel_to_another_cannot_show_is_said():
    one = Arm.from_degrees(
        [0, 0, 300, 0], [0, -90, 0, 90], [0, 0, 200, 80], joint_types="PPRR", probe=(10, 40, 60),
        limits=[(0, 3000), (0, 800), (-2, 2), (-2, 2)],
    )  # fmt: skip
    q = one.random_poses(80)
    points = one.forward(q) + np.random.default_rng(1).normal(0, 0.02, (80, 3))
    result = calibrate(one, q, points=points)
    zeros = [text for text in result.unidentified_combinations if "d1" in text or "d2" in text]
    assert len(zeros) == 2
    # Both rails move in these poses, so that each has its own scale.
    assert not any("scale" in name for name in result.unidentified)
    q[:, 1] = 100
    points = one.forward(q) + np.random.default_rng(2).normal(0, 0.02, (80, 3))
    with pytest.warns(UserWarning, match="Joint 2, which slides, stands still at 100 mm in all r"):
        held = calibrate(one, q, points=points)
    assert [finding.code for finding in held.findings] == ["slide-still"]
    assert held.standard_deviations[held.names.index("scale2")] == 0


def test_derivatives_are_those_of_differences():
    measured = Measurements(RAIL.random_poses(10), np.arange(10) // 5, joint_types="PRRRRRR")
    fit, step = TableFit(RAIL, measured, "squared"), 1e-6
    points, jacobian = fit.located_at(fit.nominal, slice(None))
    assert_allclose(points, RAIL.forward(measured.angles), atol=1e-9)
    assert jacobian.shape == (10, 3, len(fit.nominal)) == (10, 3, 32)
    for i, unit in enumerate(np.eye(32)):
        steps = (fit.nominal + way * unit for way in (step, -step))
        ends = [fit.located_at(x, slice(None))[0] for x in steps]
        assert_allclose(jacobian[:, :, i], (ends[0] - ends[1]) / (2 * step), atol=2e-5, rtol=1e-6)


def test_measurements_of_an_arm_that_slides_say_so():
    q = RAIL.random_poses(30)
    points = RAIL.forward(q) + np.random.default_rng(0).normal(0, 0.02, (30, 3))
    with pytest.warns(UserWarning, match="more than two turns"):
        wrapped = Measurements.of(q, points=points)
    with pytest.raises(ValueError, match="joint_types of the arm are 'PRRRRRR', and of the meas"):
        calibrate(RAIL, wrapped)
    measured = Measurements.of(q, points=points, joint_types=RAIL.joint_types)
    assert_allclose(measured.angles[:, 0], q[:, 0])
    assert calibrate(RAIL, measured).scatter_after_mm < 0.04


def test_where_a_rail_stands_says_nothing_of_how_long_links_are():
    """The scale of all is that of the long links: a base 5 m away along the rail is none."""
    far = RAIL.replace(d=RAIL.d + 5000 * (np.arange(7) == 0))
    q = RAIL.random_poses(60)
    noise = np.random.default_rng(0).normal(0, 0.02, (60, 3))
    kinds = [calibrate(arm, q, points=arm.forward(q) + noise).prior_sd for arm in (RAIL, far)]
    assert kinds[0].keys() == kinds[1].keys() >= {"length_mm", "slide_mm", "slide_scale"}


def test_angles_are_taken_for_no_millimetres():
    robot = Arm.from_name("panda", probe=(0, 0, 100))
    q = robot.random_poses(20)
    of_slides = Measurements.of(q, points=robot.forward(q), joint_types="PRRRRRR")
    with pytest.raises(ValueError, match="takes mm for no angles"):
        calibrate(robot, of_slides)


def test_a_rail_that_trembles_by_micrometres_stands_still():
    rng = np.random.default_rng(0)
    q = np.repeat(RAIL.random_poses(20), 5, axis=0)
    q[:, 0] += rng.uniform(-0.002, 0.002, len(q))
    measured = Measurements.of(q, points=RAIL.forward(q), joint_types=RAIL.joint_types)
    assert len(measured.angles) == 20


def test_a_stated_prior_of_lengths_is_not_that_of_slides():
    """A robot is put on a rail by eye, however well its links are known."""
    true = RAIL.replace(
        d=RAIL.d + 4 * (np.arange(7) == 1), alpha=np.add(RAIL.alpha, [0.01, *6 * [0]])
    )
    q = RAIL.random_poses(60)
    points = true.forward(q) + np.random.default_rng(1).normal(0, 0.02, (60, 3))
    result = calibrate(RAIL, q, points=points, prior_length_mm=0.1, prior_angle_rad=1e-3)
    assert result.prior_sd["length_mm"] == 0.1
    assert result.prior_sd["angle_rad"] == 1e-3
    assert result.prior_sd["slide_rad"] > 3e-3
    assert result.prior_sd["slide_mm"] != 0.1
