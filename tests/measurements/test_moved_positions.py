"""Steps of a position's residuals: where a socket moved they are named, elsewhere never."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.measurements import _moved_positions, moved_positions
from sklearn_raacmm.measurements._moved_positions import MOVED, find_steps
from sklearn_raacmm.utils import Finding

NOISE = 0.01
# In the order of the rows; what is left of the poses is random.
CODES = np.repeat(np.arange(6), 20)


def poses_and_noise(seed=0, n=120):
    rng = np.random.default_rng(seed)
    return rng.uniform(-2, 2, (n, 6)), rng.normal(0, NOISE, (n, 3))


def rows_of(steps):
    return [(step.code, step.before, step.after) for step in steps]


def test_nothing_in_noise():
    for seed in range(20):
        angles, left = poses_and_noise(seed)
        assert find_steps(left, angles, CODES) == []


def test_steps_there_and_back_are_found_where_they_are():
    angles, left = poses_and_noise()
    left[46:54] += [0.0, 0.3, 0.1]
    steps = find_steps(left, angles, CODES)
    assert rows_of(steps) == [(2, 45, 46), (2, 53, 54)]
    assert_allclose([step.size_mm for step in steps], np.hypot(0.3, 0.1), atol=0.02)


def test_rows_of_positions_may_be_interleaved():
    """Only their order within a position counts."""
    angles, left = poses_and_noise()
    left[50:60] += [0.2, 0.0, 0.0]
    order = np.argsort(np.tile(np.arange(20), 6), kind="stable")  # one row of each in turn
    (step,) = find_steps(left[order], angles[order], CODES[order])
    assert step.code == 2
    assert [order[step.before], order[step.after]] == [49, 50]


def test_a_constant_of_each_position_plays_no_part():
    angles, left = poses_and_noise()
    left[90:] += 0.2
    moved = left + np.random.default_rng(1).normal(0, 50, (6, 3))[CODES]
    assert rows_of(find_steps(left, angles, CODES)) == [(4, 89, 90)]
    assert rows_of(find_steps(moved, angles, CODES)) == [(4, 89, 90)]


def test_an_order_that_means_nothing_is_seen():
    """Rows of two levels, shuffled: by chance there are runs of both."""
    angles, left = poses_and_noise()
    left[40:48] += 0.5
    assert rows_of(find_steps(left, angles, CODES)) == [(2, 47, 48)]
    rng, named = np.random.default_rng(0), 0
    for _ in range(40):
        order = np.r_[:40, rng.permutation(20) + 40, 60:120]
        named += bool(find_steps(left[order], angles[order], CODES))
    assert named == 0


@pytest.mark.parametrize("joint", [0, 3])
def test_an_error_of_the_arm_is_no_step(joint):
    """Smooth in a joint's angle and large, with the rows sorted by it, or one half turned over."""
    angles, left = poses_and_noise()
    left = left + 10 * NOISE * np.sin(angles[:, [joint]]) * [1, 1, -1]
    order = np.lexsort((angles[:, joint], CODES))
    assert find_steps(left[order], angles[order], CODES) == []
    order = np.lexsort((angles[:, joint] > 0, CODES))
    assert find_steps(left[order], angles[order], CODES) == []


def test_slipped_poses_are_no_step():
    angles, left = poses_and_noise()
    slipped = np.random.default_rng(0).random(len(left)) < 0.06
    left[slipped] += np.random.default_rng(1).normal(0, 1, (slipped.sum(), 3))
    left[[70, 71]] += [0, 0, 2.0]  # twice in a row
    assert find_steps(left, angles, CODES) == []


def test_a_pose_that_was_recorded_many_times_is_one():
    """Ten readings of a slipped probe do not make a socket move."""
    angles, left = poses_and_noise()
    left[50] += 1.0
    rng = np.random.default_rng(0)
    burst = np.repeat(angles, 10, axis=0) + rng.normal(0, 1e-5, (1200, 6))
    assert find_steps(np.repeat(left, 10, axis=0), burst, np.repeat(CODES, 10)) == []
    left[51:60] += 1.0
    steps = find_steps(np.repeat(left, 10, axis=0), burst, np.repeat(CODES, 10))
    assert rows_of(steps) == [(2, 499, 500)]


@pytest.mark.parametrize("n", [0, 1, 5, 6])
def test_few_rows(n):
    angles, left = poses_and_noise()
    left[n // 2 :] += 1.0
    assert find_steps(left[:n], angles[:n], np.zeros(n, dtype=int)) == []
    left[0] += 100.0  # and one of them an outlier
    assert find_steps(left[:n], angles[:n], np.zeros(n, dtype=int)) == []


def test_exact_residuals():
    angles, _ = poses_and_noise()
    assert find_steps(np.zeros((120, 3)), angles, CODES) == []


def test_likelihood_of_a_step_against_two_normal_densities():
    """Of seven poses of one position, beside the noise of all: the ratio of two t densities."""
    rng = np.random.default_rng(0)
    angles, left = rng.uniform(-2, 2, (7, 6)), np.zeros((7, 3))
    left[:, 0] = rng.normal(0, NOISE, 7) + 0.03 * (np.arange(7) >= 4)
    (poses,) = _moved_positions._sorted_poses(left, angles, np.zeros(7, dtype=int))
    squares, usual = _moved_positions._squares(poses), np.full((2, 1), NOISE**2)
    found = {k: nats for nats, k in _moved_positions._nats(squares, usual, 1)}
    apart = np.square(poses.place[:, None] - poses.place).sum(axis=2)
    expected = []
    for size, fades in _moved_positions._MISFITS:
        inverse = np.linalg.inv(np.eye(7) + size * np.exp(-apart / 2 / fades**2))
        squares = []
        for columns in (np.ones((7, 1)), np.c_[np.ones(7), np.arange(7) >= 4]):
            weigh = inverse - inverse @ columns @ np.linalg.solve(
                columns.T @ inverse @ columns, columns.T @ inverse
            )
            squares.append(left[:, 0] @ weigh @ left[:, 0] + 10 * NOISE**2)
        expected.append((5 + 10) / 2 * np.log(squares[0] / squares[1]))
    assert_allclose(found[4], min(expected), rtol=1e-9)


# -- what users see -------------------------------------------------------------------------------


def moved_test(machine="none", n_positions=5):
    """A simulated test whose third socket moved by 0.4 mm after its 11th pose."""
    test = make_single_point(n_positions, 20, machine=machine, random_state=1)
    angles, groups = test.data.copy(), test.groups
    rows = np.flatnonzero(groups == np.unique(groups)[2])[11:]
    move = np.linalg.pinv(test.arm.jacobian(angles[rows])) @ [0.0, 0.4, 0.0]
    angles[rows] += move
    return test, angles, groups, rows[0]


def test_the_warning_names_position_rows_and_size():
    test, angles, groups, first = moved_test()
    left = test.arm.forward(angles) - test.arm.forward(test.data)
    left += np.random.default_rng(0).normal(0, NOISE, left.shape)
    expected = rf"position 2 by 0\.\d+ mm between rows {first - 1} and {first}\."
    numbers = np.arange(len(left))
    (found,) = moved_positions(left, angles, groups, numbers)
    assert re.match(f"^{MOVED} {expected}", str(found))
    assert (found.weight, found.positions, found.rows) == ("repair", (2,), (first,))
    with Finding.numbered(np.arange(len(left)) + 100):
        (found,) = moved_positions(left, angles, groups, numbers)
    assert f"between rows {first + 99} and {first + 100}." in found.text
    assert found.rows == (first + 100,)
    some = (numbers < first) | (groups != 2)
    given = (part[some] for part in (left, angles, groups))
    assert not list(moved_positions(*given, numbers[some]))
    # Labels of their own after each step are the way out.
    labels = np.array([f"cone {label}" for label in groups], dtype=object)
    (found,) = moved_positions(left, angles, labels, numbers)
    assert "position 'cone 2' by" in found.text
    labels[first:][groups[first:] == 2] = "cone 2, moved"
    assert not list(moved_positions(left, angles, labels, numbers))


@pytest.mark.filterwarnings("ignore:The fixed point seems to have moved")  # of calibrate
def test_of_two_real_arms_one_had_a_socket_that_moved(panda):
    nominal = Arm.from_name("panda", probe=(0, 0, 138))
    found = {}
    for name in ("panda_2", "panda_3"):
        data = panda(name)
        result = calibrate(nominal, data.angles, data.groups, accept="moved-position")
        left = result.residuals_mm
        left = left - ArmResidualRegressor(result.arm, orders=20, fade=0).fit(
            data.angles, left, groups=data.groups
        ).predict(data.angles)
        numbers = np.arange(len(left))
        found[name] = [*map(str, moved_positions(left, data.angles, data.groups, numbers))]
    assert found["panda_3"] == []
    (sentence,) = found["panda_2"]
    assert sentence.count("position '") == 2
    assert "position 'high/0'" in sentence
    assert "position 'high/1'" in sentence
