"""The order of measurement: directions, what the angles tell of it, and drift."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sklearn_raacmm import Arm, directions_of
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.measurements import drift_of, find_dwells, order_explained_by

ARM = Arm.from_name("aacmm6")


def test_directions_are_those_of_the_simulation():
    """A simulated arm knows where its joints came from; of the first row nobody else does."""
    test = make_single_point(4, 30, random_state=0)
    found = directions_of(test.data)
    moved = np.abs(np.diff(test.data, axis=0)) > 1e-3
    same_position = np.diff(test.groups) == 0
    agree = (found == test.directions)[1:][same_position][moved[same_position]]
    assert agree.mean() > 0.99
    assert_array_equal(found[0], 0)


def test_a_joint_that_stands_still_keeps_its_direction():
    angles = np.zeros((5, 1))
    angles[:, 0] = [0.0, 0.2, 0.2, 0.2 + 1e-7, 0.1]
    assert_array_equal(directions_of(angles)[:, 0], [0, 1, 1, 1, -1])
    across = directions_of([[np.deg2rad(359.0)], [np.deg2rad(1.0)]])
    assert across[1, 0] == 1  # the short way


def test_of_a_stream_a_joint_may_turn_round_between_two_poses():
    """A joint with play knows; noise of some arc seconds turns nothing round."""
    rng = np.random.default_rng(0)
    turns = np.cumsum(rng.uniform(0.05, 0.6, (40, 3)) * rng.choice([-1, 1], (40, 3)), axis=0)
    stream = np.concatenate([np.linspace(a, b, 400) for a, b in pairwise(turns)])  # slow
    stream = np.concatenate([stream, np.repeat(stream[-1:], 50, axis=0)])
    at = np.sort(rng.choice(np.arange(400, len(stream) - 50), 60, replace=False))
    came = np.sign(np.diff(turns, axis=0))[(at - 1) // 400]  # into each row
    noisy = stream + rng.normal(0, 1e-5, stream.shape)
    settled = (at - 1) % 400 > 5  # the first steps are as small as the noise
    assert_array_equal(directions_of(noisy, at=at)[settled], came[settled])
    # Poses alone do not show it.
    assert np.mean(directions_of(noisy[at])[1:] == came[1:]) < 0.9
    for rows in ([0.5], [len(stream)], [[0]], [-1]):
        with pytest.raises(ValueError, match=f"rows of the stream, 0 to {len(stream) - 1}"):
            directions_of(stream, at=rows)


def test_angles_tell_the_order_of_a_single_point_test_only():
    test = make_single_point(8, 20, random_state=0)  # one position after the other
    assert order_explained_by(test.data, test.groups) > 0.2
    mixed = np.random.default_rng(0).permutation(len(test.data))
    assert order_explained_by(test.data[mixed], test.groups[mixed]) < 0.2


def drifting(seed, mrad):
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-2, 2, (300, 6))
    turn = np.zeros_like(angles)
    turn[:, 1] = np.linspace(-0.5, 0.5, 300) * 1e-3 * mrad
    moved = np.einsum("nij,nj->ni", ARM.jacobian(angles), turn)
    return angles, moved + rng.normal(0, 0.005, moved.shape)


def test_drift_of_a_zero_angle_is_found():
    angles, left = drifting(0, 0.1)
    size = np.sqrt(np.square(ARM.jacobian(angles)[:, :, 1] * 1e-4).sum(axis=1).mean())
    (found,) = drift_of(ARM, angles, left, None)
    assert found.size_mm == pytest.approx(size, rel=0.06)
    assert (found.code, found.weight) == ("drift-of-run", "note")


def test_where_nothing_drifted_nothing_is_said():
    """At most one of 100, and of five without time for other orders none."""
    assert sum(bool([*drift_of(ARM, *drifting(seed, 0.0), None)]) for seed in range(60)) <= 1
    angles, left = drifting(0, 0.1)
    codes = np.arange(300) // 60
    assert not [*drift_of(ARM, angles, left, codes)]


def test_misfit_of_positions_is_no_drift():
    """Deviations that differ from position to position, in 60 orders of 12 positions."""
    test = make_single_point(12, 20, random_state=0)
    left, n_found = test.target, 0
    for seed in range(60):
        order = np.random.default_rng(seed).permutation(12)
        rows = np.concatenate([np.flatnonzero(test.groups == label) for label in order])
        n_found += bool([*drift_of(test.arm, test.data[rows], left[rows], test.groups[rows])])
    assert n_found <= 2


def test_no_rows_of_a_real_series_are_merged(panda, ur10, ur10_b):
    """Limits of a dwell: 14 352 poses of real robots, one after the other, stay poses."""
    series = (panda("panda_2"), panda("panda_3"), ur10, ur10_b)
    assert sum(len(data.angles) for data in series) == 14_352
    assert not any(find_dwells(data.angles).merges for data in series)
