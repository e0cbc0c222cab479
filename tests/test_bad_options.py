"""Options of the public functions given what they cannot take: one sentence, on the caller's line.

Arrays are in ``test_bad_input.py``.
"""

import contextlib
import warnings
from pathlib import Path

import numpy as np
import pytest
from sklearn.linear_model import Ridge

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    RBFNetRegressor,
    app,
    check_correction,
    cross_validate_correction,
    elbow_angle,
    export,
    learn_correction,
    search_table,
    update_correction,
)
from sklearn_raacmm.datasets import ArmErrors, make_single_point
from sklearn_raacmm.metrics import repeatability_interval, single_point_repeatability

TEST = make_single_point(6, 8, random_state=0)
DATA = TEST.nominal_arm, TEST.data, TEST.groups
MANY = np.zeros((24, 9))


@pytest.fixture(scope="module")
def model():
    small = ArmResidualRegressor(TEST.arm, orders=1, causes=["kinematics"])
    return small.fit(TEST.data, TEST.target, groups=TEST.groups)


@pytest.mark.parametrize(
    ("option", "value", "sentence"),
    [
        ("angle_unit", MANY, "'angle_unit' parameter of .* a str among"),
        ("model", [], r"'model' parameter of .* an object implementing 'fit'"),
        ("model", ArmResidualRegressor, "provide an instance"),
        ("model", ArmResidualRegressor(orders=-1), "'orders' parameter of ArmResidualRegr"),
        ("cv", 1, "'cv' parameter of .* an int in the range"),
        ("cv", "folds", "'cv' parameter"),
        ("cv", [1], r"cv must be a whole number, a splitter, or pairs .* got \[1\]"),
        ("cv", np.array(3), r"cv must be a list, got array\(3\)"),
        ("cv", [([0, 1], [2], [3])], "pairs of the rows"),
        ("cv", [([0, 1], [48])], "pairs of the rows"),
        ("cv", [([0.0, 1.0], [2.0, 3.0])], "pairs of the rows"),
        ("n_jobs", "all", "'n_jobs' parameter of .* an instance of 'int'"),
        ("progress", "yes", "'progress' parameter of .* a callable"),
    ],
)
@pytest.mark.parametrize("judge", [learn_correction, cross_validate_correction])
def test_the_doors_that_judge(judge, option, value, sentence):
    with pytest.raises((ValueError, TypeError), match=sentence):
        judge(*DATA, **{option: value})


@pytest.mark.parametrize("arm", [None, "aacmm6", MANY])
@pytest.mark.parametrize(
    "door",
    [
        lambda arm: learn_correction(arm, *DATA[1:]),
        lambda arm: search_table(arm, *DATA[1:]),
        lambda arm: elbow_angle(arm, TEST.data),
    ],
)
def test_what_is_no_arm(door, arm):
    with pytest.raises(TypeError, match=f"arm must be an Arm, got {type(arm).__name__}"):
        door(arm)


@pytest.mark.parametrize("date", [20240131, ["2024-01-31"], np.datetime64("2024-01-31")])
@pytest.mark.parametrize("door", [update_correction, check_correction])
def test_what_is_no_date(model, door, date):
    with pytest.raises(ValueError, match="'date' parameter"):
        door(model, TEST.data, TEST.target, groups=TEST.groups, date=date)


@pytest.mark.parametrize("nothing", ["", {}])
def test_only_an_array_without_rows_is_no_new_pose(model, nothing):
    np.testing.assert_array_equal(
        update_correction(model, [], []).predict(TEST.data), model.predict(TEST.data)
    )
    with pytest.raises((ValueError, TypeError), match=r"X must (be an array|hold numbers), got"):
        update_correction(model, nothing, TEST.target)


def test_text_is_no_list(model):
    options = {"groups": TEST.groups}
    with pytest.raises(ValueError, match="each of lengths must be"):
        check_correction(model, TEST.data, TEST.target, **options, lengths="")
    with pytest.raises(ValueError, match="'refitted' parameter"):
        check_correction(model, TEST.data, TEST.target, **options, refitted=3)


@pytest.mark.parametrize("path", [3, ["a.csv"], b"a.c", {}])
@pytest.mark.parametrize(
    "door",
    [
        lambda model, path: export.export_c(model, path),
        lambda model, path: export.load_c(model, cache_dir=path),
        lambda model, path: app.read_table(path, 6),
    ],
    ids=["export_c", "load_c", "table"],
)
def test_what_is_no_path(model, door, path):
    with pytest.raises(TypeError, match="PathLike"):
        door(model, path)


@pytest.mark.parametrize("card", [True, 3, ["card"]])
def test_what_is_no_card(model, card, tmp_path):
    with pytest.raises(TypeError, match="card must be what describe gives, or text, got"):
        export.export_c(model, tmp_path / "arm.c", card=card)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("probability", [None, "0.9", [0.9], np.array([0.9, 0.5]), 1, np.nan])
def test_what_is_no_probability(probability):
    with pytest.raises(ValueError, match="probability must be between 0 and 1, got"):
        repeatability_interval(TEST.points, TEST.groups, probability=probability)


@pytest.mark.parametrize(
    "call",
    [
        lambda: Arm.from_name("aacmm6").replace(convention=MANY),
        lambda: Arm.from_name("aacmm6").replace(name=MANY),
        lambda: TEST.arm.forward(TEST.data, angle_unit=MANY),
        lambda: single_point_repeatability(TEST.points, TEST.groups, aggregate=MANY),
        lambda: ArmErrors(sag_um=MANY),
    ],
)
def test_a_large_value_does_not_fill_the_screen(call):
    with pytest.raises(ValueError) as caught:
        call()
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    "door",
    [
        lambda model, X: learn_correction(DATA[0], X, TEST.groups),
        lambda model, X: cross_validate_correction(DATA[0], X, TEST.groups),
        lambda model, X: update_correction(model, X, TEST.target, groups=TEST.groups),
        lambda model, X: check_correction(model, X, TEST.target, groups=TEST.groups),
        lambda model, X: elbow_angle(TEST.arm, X),
    ],
    ids=["learn", "judge", "update", "check", "elbow"],
)
def test_degrees_are_warned_of_once_on_the_line_of_the_call(model, door):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with contextlib.suppress(ValueError):  # such data are of no arm
            door(model, np.rad2deg(TEST.data))
    told = [warning for warning in caught if "more than two turns" in str(warning.message)]
    assert [Path(warning.filename).name for warning in told] == [Path(__file__).name]


@pytest.mark.parametrize("flag", ["return_std", "with_noise"])
@pytest.mark.parametrize("value", ["yes", None, 2, 0.5, TEST.groups, [True]])
def test_what_is_neither_true_nor_false(model, flag, value):
    """Such as labels in the second place of predict."""
    network = RBFNetRegressor(2).fit(TEST.data, TEST.target)
    for door in (model.predict, network.predict):
        with pytest.raises(TypeError, match=f"{flag} must be True or False, got "):
            door(TEST.data, **{flag: value})
    for good in (True, np.True_, 1):
        assert len(model.predict(TEST.data, return_std=good)) == 2


def test_the_chain_says_what_is_no_row_and_no_number():
    chain = CylindricalResidualTarget(Ridge(), azimuth=TEST.arm.azimuth)
    with pytest.raises(ValueError, match="X has no rows"):
        chain.fit([], TEST.target)
    with pytest.raises(ValueError, match="y must hold numbers"):
        chain.fit(TEST.data, [1, "a", None] + [0] * (len(TEST.data) - 3))
    chain.fit(TEST.data, TEST.target)
    with pytest.raises(ValueError, match="X has no rows"):
        chain.predict([])
