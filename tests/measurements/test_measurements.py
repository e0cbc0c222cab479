"""One record of what was measured: the same results as from its parts, and what it checks."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sklearn_raacmm import ArmResidualRegressor, Measurements, calibrate, learn_correction
from sklearn_raacmm.datasets import make_features, make_single_point


def test_calibrate_takes_it_in_place_of_its_parts():
    """To the last digit: fixed points with lengths, a tracker with tools, and touches."""
    test = make_single_point(4, 12, bars=[400.0], random_state=1)
    tracker = test.points + np.array([1000.0, 0.0, 0.0])
    tools = np.arange(len(tracker)) % 2
    touched = make_features(2, 2, 1, 12, random_state=1)
    parts = [
        (test, {"groups": test.groups, "lengths": test.lengths}),
        (test, {"points": tracker, "tools": tools}),
        (touched, {"groups": touched.groups, "features": touched.features}),
    ]
    for data, given in parts:
        of_parts = calibrate(data.nominal_arm, data.data, **given)
        of_one = calibrate(data.nominal_arm, Measurements.of(data.data, **given))
        assert_array_equal(of_one.values, of_parts.values)
        assert_array_equal(of_one.residuals_mm, of_parts.residuals_mm)
        assert of_one.features == of_parts.features


def test_learn_correction_takes_it_with_causes():
    test = make_single_point(5, 12, random_state=1)
    given = {"extra": {"temperature": 20 + np.sin(np.arange(60.0))}}
    how = {"model": ArmResidualRegressor(orders=2, extra=["temperature"]), "cv": 2}
    one = learn_correction(test.nominal_arm, test.data, test.groups, **given, **how)
    other = learn_correction(
        test.nominal_arm, Measurements.of(test.data, test.groups, **given), **how
    )
    assert_array_equal(one.scores.left_after, other.scores.left_after)
    with pytest.raises(ValueError, match="extra are in the measurements already"):
        learn_correction(test.nominal_arm, Measurements.of(test.data, test.groups), **given, **how)


def test_a_correction_is_registered_checked_and_updated_by_it():
    test = make_single_point(5, 12, random_state=1)
    new = make_single_point(4, 10, machine=test.simulation.machine, random_state=7)
    how = {"model": ArmResidualRegressor(orders=2), "cv": 2}
    learned = learn_correction(test.nominal_arm, test.data, test.groups, **how)
    measured = Measurements.of(np.rad2deg(new.data), new.groups, angle_unit="deg")
    today = measured.angles, new.groups
    assert learned.check(measured).p_value == learned.check(*today).p_value
    for verb in ("register", "update"):
        one, other = (getattr(learned, verb)(*given) for given in ((measured,), today))
        assert_array_equal(one.model.predict(test.data), other.model.predict(test.data))
    tools = Measurements.of(new.data, new.groups, tools=np.arange(len(new.data)) % 2)
    with pytest.raises(ValueError, match="tools and stations are for"):
        learned.register(tools)


def test_rows_in_which_the_arm_stood_still_are_one():
    """Means of three rows; the tool, the set-up and the position part rows that are alike."""
    rng = np.random.default_rng(0)
    few = rng.uniform(-2, 2, (10, 6))
    angles = np.repeat(few, 3, axis=0) + rng.normal(0, 1e-6, (30, 6))
    points = rng.normal(0, 500, (30, 3))
    groups = np.repeat(np.arange(10), 3)
    measured = Measurements.of(angles, groups, points=points, extra={"load": np.arange(30.0)})
    assert_array_equal(measured.poses.pose, groups)
    np.testing.assert_allclose(measured.angles, few, atol=1e-5)
    np.testing.assert_allclose(measured.points[0], points[:3].mean(axis=0))
    assert_array_equal(measured.extra["load"], np.arange(0, 30, 3))
    tools = np.arange(30) % 3
    assert len(Measurements.of(angles, points=points, tools=tools).angles) == 30


def test_some_rows_keep_what_belongs_to_them():
    test = make_features(2, 1, 2, 30, blocks=[100.0], random_state=1)
    measured = Measurements.of(
        test.data, test.groups, features=test.features, lengths=test.lengths, tools=test.groups
    )
    assert len(measured.lengths) == 3  # a block and two sizes
    rows = np.flatnonzero(np.isin(test.groups, [1, 3, 5]))
    some = measured.at(rows)
    assert some.labels.tolist() == [1, 3, 5]
    assert some.tool_labels == (1, 3, 5)
    assert some.features == ["sphere", "cone", "plane"]
    assert some.lengths == [(0, 0, 30.0, 0.001)]
    assert [one[0] for one in some.stated] == [1, 5]
    # As from these rows alone.
    alone = calibrate(
        test.nominal_arm, test.data[rows], test.groups[rows], tools=test.groups[rows],
        features=[one for one in test.features if one[0] in (1, 5)],
    )  # fmt: skip
    assert_array_equal(calibrate(test.nominal_arm, some).values, alone.values)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"points": np.zeros((3, 3))}, r"points must have shape \(20, 3\)"),
        ({"groups": np.zeros(20), "stations": np.zeros(20)}, "stations are of measured points"),
        ({"lengths": [(0, 1, 100.0, 0.01)]}, "lengths and features are of groups"),
        ({"groups": np.zeros(19)}, r"groups \(positions\) names 19 samples, but there are 20"),
        ({"groups": np.zeros(20), "extra": {"load": [1, 2]}}, r"extra\['load'\] must have shape"),
        ({"points": np.zeros((20, 3)), "features": [(0, "plane")]}, "features are groups of"),
    ],
)
def test_parts_that_do_not_fit_together_are_refused(given, words):
    with pytest.raises(ValueError, match=words):
        Measurements.of(np.zeros((20, 6)), **given)


def test_measurements_that_do_not_fit_a_call_are_refused():
    test = make_single_point(3, 10, random_state=1)
    measured = Measurements.of(test.data, test.groups)
    for given, name in (
        ({"points": test.points}, "points"),
        ({"groups": test.groups}, "groups"),
        ({"lengths": [(0, 1, 100.0, 0.1)]}, "lengths"),
        ({"tip_diameter": 3.0}, "tip_diameter"),
    ):
        with pytest.raises(ValueError, match=f"{name} are in the measurements already"):
            calibrate(test.nominal_arm, measured, **given)
    with pytest.raises(ValueError, match="neither groups nor points"):
        calibrate(test.nominal_arm, Measurements.of(test.data))
    seven = Measurements.of(np.zeros((20, 7)), np.arange(20) % 2)
    with pytest.raises(ValueError, match="6 joints"):
        calibrate(test.nominal_arm, seven)


def test_tools_and_stations_need_no_labels():
    """They are counted by their numbers."""
    test = make_single_point(6, 20, random_state=1)
    numbers = np.arange(len(test.data)) % 2
    for name in ("tools", "stations"):
        named = Measurements.of(test.data, points=test.points, **{name: numbers})
        plain = Measurements(named.angles, points=named.points, **{name: numbers})
        assert (plain.n_tools, plain.n_stations) == (named.n_tools, named.n_stations)
        assert plain.n_tools + plain.n_stations == 3
