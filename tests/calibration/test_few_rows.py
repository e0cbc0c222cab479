"""What the rows can carry: rank, open combinations, warnings, outliers, the found noise."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm, FindingError, calibrate
from sklearn_raacmm.datasets import make_single_point

ARM = Arm.from_name("aacmm6")
EXHAUSTIVE = pytest.mark.exhaustive


def tracker_rows(arm, n, noise_mm=0.1, seed=0):
    """Angles and points of a tracker whose frame is turned and shifted."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-2, 2, (n, 6))
    points = arm.forward(angles)[:, [1, 2, 0]] + [1000, 0, 0]
    return angles, points + rng.normal(0, noise_mm, (n, 3))


@pytest.mark.parametrize("n", [2, 3, 5])
def test_too_few_rows_for_base_and_probe_are_named_with_the_numbers(n):
    angles, points = tracker_rows(ARM.replace(probe=(10, 5, 120)), n)
    rank = min(9, 3 * n)
    sentence = f"{n} measured points give {3 * n} coordinates for 9 free .* show {rank}: "
    with pytest.warns(UserWarning, match=sentence):
        result = calibrate(ARM, angles, points=points, free=["probe"])
    assert (result.rank, result.n_free, result.n_coordinates) == (rank, 9, 3 * n)
    if n <= 3:  # exactly as many coordinates as parameters: nothing shows the noise
        assert np.isnan(result.standard_deviations[-9:]).all()


def test_enough_rows_are_not_doubted_and_base_and_tool_have_standard_deviations():
    z = []
    for seed in range(20):
        angles, points = tracker_rows(ARM, 40, seed=seed)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            result = calibrate(ARM, angles, points=points, free=["probe"], loss="squared")
        assert result.names[-6:] == tuple(f"base_{c}" for c in ("rx", "ry", "rz", "x", "y", "z"))
        true = np.r_[ARM.probe, [1000, 0, 0]]
        found = np.r_[result.values[-9:-6], result.values[-3:]]
        sd = np.r_[result.standard_deviations[-9:-6], result.standard_deviations[-3:]]
        z.append((found - true) / sd)
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.25
    assert np.isnan(result.nominal[-6:]).all()
    assert np.isfinite(result.condition_number)
    assert result.rank == result.n_free == 9


def test_parallel_axes_share_their_offsets():
    ur10 = Arm.from_name("ur10")
    rng = np.random.default_rng(0)
    angles = rng.uniform(-2.5, 2.5, (300, 6))
    points = ur10.forward(angles) + rng.normal(0, 0.05, (300, 3))
    result = calibrate(ur10, angles, points=points, free=["d", "probe"])
    # Of d2, d3, d4 only the sum shows: two differences stay open, and d1 is the base's height.
    expected = {"d1 - base_z", "d2 - d4", "d3 - d4", "d6 - probe_z"}
    assert set(result.unidentified_combinations) == expected
    assert "open combinations" in str(result)
    assert result.condition_number == np.inf
    assert result.rank == result.n_free - 4


def test_observability_index_against_its_definition():
    angles, points = tracker_rows(ARM, 50, noise_mm=0.0)
    result = calibrate(ARM, angles, points=points, free=["probe"], loss="squared")
    reach = np.hypot(ARM.a, ARM.d).sum() + np.linalg.norm(ARM.probe)
    # Columns by hand, in the base frame: the singular values do not depend on the frame.
    p = ARM.forward(angles)
    columns = np.zeros((50, 3, 9))
    for i in range(3):
        step = np.eye(3)[i] * 1e-3
        moved = ARM.replace(probe=ARM.probe + step).forward(angles)
        columns[:, :, i] = (moved - p) / 1e-3
        columns[:, :, 3 + i] = np.cross(np.eye(3)[i], p) / reach
        columns[:, :, 6 + i] = np.eye(3)[i]
    values = np.linalg.svd(columns.reshape(-1, 9), compute_uv=False)
    assert result.condition_number == pytest.approx(values[0] / values[-1], rel=1e-3)
    expected = np.exp(np.log(values).mean()) / np.sqrt(50)
    assert result.observability_index == pytest.approx(expected, rel=1e-3)


# -- noise and outliers ------------------------------------------------------------------------


@pytest.mark.parametrize("loss", ["soft_l1", "cauchy", "squared"])
def test_the_noise_is_found_whatever_the_loss(loss):
    found = []
    for seed in range(10):
        angles, points = tracker_rows(ARM, 100, seed=seed)
        found.append(calibrate(ARM, angles, points=points, loss=loss).sigma_mm)
    assert np.mean(found) == pytest.approx(0.1, rel=0.04)


@pytest.mark.parametrize(
    ("seed", "most"),
    [(0, 0), pytest.param(1, 1, marks=EXHAUSTIVE), pytest.param(2, 0, marks=EXHAUSTIVE)],
)
def test_names_of_outliers_are_right_where_a_smooth_error_is_left(seed, most):
    """The simulated machine has harmonics and gravity that no calibration takes."""
    data = make_single_point(n_positions=12, n_poses=30, random_state=seed)
    # It was 5 to 9 of 360 clean rows, and up to 63 beside slips.
    assert len(calibrate(data.arm, data.data, data.groups).outliers) <= most
    rng = np.random.default_rng(seed)
    bad = rng.choice(360, 14, replace=False)  # 4 % slip by 1 mm
    way = rng.normal(size=(14, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    angles = data.data.copy()
    step = np.linalg.pinv(data.arm.jacobian(angles[bad])) @ way[:, :, None]
    angles[bad] += step[:, :, 0]
    result = calibrate(data.arm, angles, data.groups)
    assert set(result.outliers) == set(bad)


# -- residuals of new rows ---------------------------------------------------------------------


def test_residuals_of_new_rows_are_the_law_of_the_base():
    angles, points = tracker_rows(ARM, 80)
    result = calibrate(ARM, angles[:40], points=points[:40])
    expected = (
        result.arm.forward(angles) - (points - result.base_translation) @ result.base_rotation
    )
    assert_allclose(result.residuals(angles, points), expected, atol=1e-12)
    assert_allclose(result.residuals(angles[:40], points[:40]), result.residuals_mm, atol=1e-9)
    degrees = result.residuals(np.rad2deg(angles), points, angle_unit="deg")
    assert_allclose(degrees, expected, atol=1e-9)


def test_residuals_of_groups_have_no_mean():
    data = make_single_point(n_positions=6, n_poses=10, random_state=0)
    result = calibrate(data.arm, data.data, data.groups)
    residuals = result.residuals(data.data, groups=data.groups)
    assert_allclose(residuals, result.residuals_mm, atol=1e-9)
    with pytest.raises(ValueError, match="knows no frame of measured points"):
        result.residuals(data.data, data.points)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "Give either points"),
        ({"points": np.zeros((4, 3)), "groups": [0] * 4}, "Give either points"),
        ({"points": np.zeros((3, 3))}, "3 points, but 4 rows"),
        ({"points": np.zeros((4, 3)), "tools": ["a"] * 4}, "tools name 'a', which"),
        ({"points": np.zeros((4, 3)), "stations": [1, 1]}, "stations names 2 samples"),
    ],
)
def test_bad_rows_get_one_clear_sentence(given, message):
    angles, points = tracker_rows(ARM, 40)
    result = calibrate(ARM, angles, points=points, free=["probe"])
    with pytest.raises(ValueError, match=message):
        result.residuals(np.zeros((4, 6)), **given)


def test_a_pose_that_is_held_long_counts_once():
    """Angles that belong to no such arm are refused by the same scatter, held long or not."""
    test = make_single_point(9, 16, machine="typical", random_state=2)
    angles = test.data + np.random.default_rng(0).normal(0, 0.05, test.data.shape)
    said = []
    for times in (1, 300):
        rows = np.repeat(np.arange(len(angles)), np.where(np.arange(len(angles)) == 1, times, 1))
        with pytest.raises(FindingError) as error:
            calibrate(test.nominal_arm, angles[rows], test.groups[rows])
        said.append(error.value.finding)
    assert [one.code for one in said] == ["no-such-arm"] * 2
    assert said[1].size_mm == pytest.approx(said[0].size_mm, rel=0.1)
