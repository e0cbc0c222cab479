"""An arm that was moved between its poses: learnt at one call as by hand, in one base frame."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    Correction,
    calibrate,
    learn_correction,
    update_correction,
)
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.utils import FindingError, align

ARM = Arm.from_name("ur10", probe=(0, 0, 93))
MODEL = ArmResidualRegressor(orders=2, causes=["kinematics"])
STATIONS = np.array(["door", "middle", "window"])


def true_points(angles):
    """Of an arm whose table and whose second encoder are a little off, mm in its base frame."""
    moved = angles + 3e-4 * np.sin(angles[:, [1]] + 0.4) * (np.arange(6) == 1)
    return ARM.replace(d=ARM.d + 0.3 * (ARM.d != 0)).forward(moved)


@pytest.fixture(scope="module")
def measured():
    """Angles, points in the tracker's frame, stations, and the base at each of these."""
    rng = np.random.default_rng(0)
    angles, which = rng.uniform(-2, 2, (150, 6)), np.arange(150) // 50
    bases = Rotation.random(3, random_state=1).as_matrix(), rng.normal(0, 2000, (3, 3))
    points = np.einsum("nij,nj->ni", bases[0][which], true_points(angles)) + bases[1][which]
    return angles, points + rng.normal(0, 0.02, points.shape), STATIONS[which], bases


@pytest.fixture(scope="module")
def learned(measured):
    angles, points, stations, _ = measured
    return learn_correction(ARM, angles, None, points, model=MODEL, cv=3, stations=stations)


def test_one_call_learns_what_the_two_steps_do(measured, learned):
    angles, points, stations, _ = measured
    by_hand = calibrate(ARM, angles, points=points, stations=stations)
    y = by_hand.residuals(angles, points, stations=stations)
    model = ArmResidualRegressor(by_hand.arm, orders=2, causes=["kinematics"]).fit(angles, y)
    new = np.random.default_rng(5).uniform(-2, 2, (200, 6))
    truth, own = true_points(new), learned.correct(new)[0]
    errors = (own - truth, by_hand.arm.forward(new) - model.predict(new) - truth)
    left, right, bare = (
        np.linalg.norm(e - e.mean(axis=0), axis=1).mean()
        for e in (*errors, learned.arm.forward(new) - truth)
    )
    assert left < 1.05 * right
    assert left < 0.3 * bare
    assert learned.helps
    # Judged at what was left out, in the frame of each row's station.
    assert left < learned.scores.summary["after"][0] < 0.5 * learned.scores.summary["before"][0]


def test_bases_of_stations_do_not_pass_for_constants_of_positions():
    """Three stations with six positions each teach what one station with all of them does."""
    machine = SimulatedArm("typical", random_state=3)
    test, new = (
        make_single_point(n, 12, machine=machine, random_state=seed)
        for n, seed in ((18, 1), (8, 2))
    )
    rng, station = np.random.default_rng(0), test.groups % 3
    one = test.simulation.true_points + rng.normal(0, 0.01, test.points.shape)
    bases = Rotation.random(3, random_state=1).as_matrix(), rng.normal(0, 2000, (3, 3))
    three = np.einsum("nij,nj->ni", bases[0][station], one) + bases[1][station]
    model = ArmResidualRegressor(orders=4)
    learned = learn_correction(
        machine.nominal_arm, test.data, test.groups, three, model=model, cv=6, stations=station
    )
    assert learned.helps
    by_one = calibrate(machine.nominal_arm, test.data, points=one)
    y = by_one.residuals(test.data, one)
    fitted = ArmResidualRegressor(by_one.arm, orders=4).fit(test.data, y)

    def left(points):
        rotation, shift = align(new.simulation.true_points, points)
        off = points - new.simulation.true_points @ rotation.T - shift
        return np.sqrt(np.square(off).sum(axis=1).mean())

    of_one = left(by_one.arm.forward(new.data) - fitted.predict(new.data))
    assert left(learned.correct(new.data)[0]) < 1.1 * of_one


def test_corrected_points_are_in_the_arms_frame_and_stations_know_the_trackers(
    measured, learned, tmp_path
):
    angles, points, stations, bases = measured
    learned.save(tmp_path)
    for saved in (learned, Correction.load(tmp_path)):
        corrected = saved.correct(angles)[0]
        for i, station in enumerate(STATIONS):
            own = stations == station
            one = saved.at_station(station)
            rotation, translation = one.base
            assert_allclose(rotation, bases[0][i], atol=1e-3)
            seen = corrected[own] @ rotation.T + translation
            assert np.linalg.norm(seen - points[own], axis=1).mean() < 0.1
            assert np.abs(one.residuals(angles[own], points[own])).max() < 2
        with pytest.raises(ValueError, match="no station 'attic'; it was learnt at door, middle"):
            saved.at_station("attic")


@pytest.mark.filterwarnings("ignore::UserWarning")  # of a fit to what is then refused
def test_stations_are_checked(measured):
    angles, points, stations, bases = measured
    data = (ARM, angles, None, points)
    with pytest.raises(ValueError, match="stations are of measured points"):
        learn_correction(ARM, angles, np.arange(150) % 5, stations=stations)
    lost = np.r_[["dor"], stations[1:]]
    with pytest.raises(ValueError, match="station 'dor' are left out together"):
        learn_correction(
            *data, model=MODEL, cv=3, stations=lost.astype(object), accept=["moved-station"]
        )
    # What is said to be one station may be two.
    two, moved = np.where(stations == "window", "middle", stations), points.copy()
    moved[100:] = (moved[100:] - bases[1][2]) @ bases[0][2] @ bases[0][1].T + bases[1][1] + 0.8
    with pytest.raises(FindingError, match="stations=labels") as caught:
        learn_correction(ARM, angles, None, moved, model=MODEL, cv=3, stations=two)
    assert caught.value.finding.code == "moved-station"
    assert caught.value.finding.rows == (100,)


def test_residuals_of_a_base_that_moved_are_named(measured):
    angles, points, stations, _ = measured
    result = calibrate(ARM, angles, points=points, stations=stations)
    y = result.residuals(angles, points, stations=stations)
    model = ArmResidualRegressor(result.arm, orders=2, causes=["kinematics"])
    model.fit(angles[:110], y[:110])
    new, left = angles[110:], y[110:].copy()
    left[17:] += np.cross([2e-4, -1e-4, 3e-4], result.arm.forward(new[17:]))
    left[17:] += (0.2, -0.4, 0.3)
    with pytest.raises(FindingError, match="moved, from row 17 on") as caught:
        update_correction(model, new, left)
    assert caught.value.finding.code == "moved-station"
    update_correction(model, new, y[110:])  # of one place nothing is said
