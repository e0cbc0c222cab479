"""Labels by geometry: places found from points, rows that bear another's label, one place twice."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from sklearn.base import clone
from sklearn.metrics import adjusted_rand_score

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, learn_correction
from sklearn_raacmm.calibration._labels import places_of
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.utils import Finding, FindingError, FindingWarning

TEST = make_single_point(9, 16, machine="typical", random_state=2)  # simulated
PANDA = Arm.from_name("panda", probe=(0, 0, 138))
SMALL = ArmResidualRegressor(TEST.arm, orders=2)


def found(arm, angles, groups):
    """Findings of a calibration by their codes."""
    with Finding.collected():
        return {finding.code: finding for finding in calibrate(arm, angles, groups).findings}


@pytest.mark.parametrize("name", ["panda_2", "panda_3"])
def test_places_of_real_arms_are_the_sockets(panda, name):
    """Without labels and without a probe: as many as there are, in the order of the rows."""
    data, flange = panda(name), PANDA.replace(probe=(0, 0, 0))
    with pytest.raises(FindingError, match=f"at {len(set(data.groups))} places, of"):
        calibrate(flange, data.angles)
    with Finding.collected():  # two sockets of panda_2 did move
        result = calibrate(flange, data.angles, accept="places-found")
    (found,) = [finding for finding in result.findings if finding.code == "places-found"]
    assert found.weight == "doubt"
    assert adjusted_rand_score(data.groups, result.groups) == 1
    assert result.groups[0] == "1"
    assert adjusted_rand_score(data.groups, places_of(result.arm.forward(data.angles))) == 1


def test_rows_alone_belong_to_the_nearest_place():
    angles = np.vstack([TEST.data, TEST.data[:1] + 0.2])
    with Finding.collected() as found:
        groups = calibrate(TEST.nominal_arm, np.repeat(angles, 30, axis=0)).groups[::30]
    assert "places-found" in {finding.code for finding in found}
    assert adjusted_rand_score(TEST.groups, groups[:-1]) == 1
    assert groups[-1] in groups[:-1]
    with pytest.raises(ValueError, match="give groups, the label of each row"):
        calibrate(TEST.nominal_arm, TEST.data[::16])


def test_no_two_points_of_a_place_are_farther_apart():
    points = np.random.default_rng(0).uniform(0, 200, (80, 3))
    places = places_of(points, 50.0)
    assert max(pdist(points[places == place]).max(initial=0) for place in set(places)) <= 50
    assert sorted(set(places)) == list(range(places.max() + 1))


@pytest.mark.parametrize("name", ["panda_2", "panda_3", "panda_6", "panda_7"])
def test_two_exchanged_labels_of_a_real_arm_are_named(panda, name):
    data = panda(name)
    groups, n = data.groups.copy(), len(data.groups)
    groups[[3, n - 5]] = groups[[n - 5, 3]]
    finding = found(PANDA, data.angles, groups)["wrong-label"]
    assert finding.rows == (3, n - 5)
    assert f"rows 3 and {n - 5} look exchanged" in finding.text
    assert finding.weight == "doubt"
    assert "wrong-label" not in found(PANDA, data.angles, data.groups)


@pytest.mark.parametrize("name", ["panda_2", "panda_3", "panda_6", "panda_7"])
def test_labels_of_a_real_arm_that_are_rows_late_are_named(panda, name):
    data = panda(name)
    late = np.roll(data.groups, 4)
    finding = found(PANDA, data.angles, late)["wrong-label"]
    assert finding.rows == tuple(np.flatnonzero(late != data.groups)[:100])
    assert finding.weight == "repair"


@pytest.mark.parametrize("name", ["panda_3", "panda_6"])
def test_one_place_of_a_real_arm_under_two_names(panda, name):
    data = panda(name)
    groups = data.groups.astype(object)
    groups[np.flatnonzero(groups == groups[0])[::2]] += " "
    finding = found(PANDA, data.angles, groups.astype(str))["one-place"]
    assert finding.positions == (data.groups[0], f"{data.groups[0]} ")
    assert finding.size_mm < 0.1


def test_one_place_under_two_names_is_left_out_as_one():
    groups = np.where(TEST.groups == 0, "P1", np.char.add("Q", TEST.groups.astype(str)))
    groups[:8] = "p1 "
    learned = learn_correction(TEST.nominal_arm, TEST.data, groups, model=SMALL, cv=3)
    (said,) = [finding for finding in learned.findings if finding.code == "one-place"]
    assert said.positions == ("P1", "p1 ")
    assert learned.scores.n_blocks == 9


def test_exchanged_labels_and_marks_of_missing_values_are_named_by_their_rows():
    """They do not count, so that all other rows have the arm of the clean data."""
    groups, angles = TEST.groups.copy(), TEST.data.copy()
    groups[[12, 52]] = groups[[52, 12]]
    angles[[3, 40, 77]] = np.deg2rad(999 - 720)
    with pytest.warns(FindingWarning) as caught:
        found = calibrate(TEST.nominal_arm, angles, groups)
    clean = calibrate(TEST.nominal_arm, TEST.data, TEST.groups).arm.forward(TEST.data)
    assert {w.message.finding.code: w.message.finding.rows for w in caught} == {
        "wrong-label": (12, 52),
        "no-reading": (3, 40, 77),
    }
    assert np.linalg.norm(found.arm.forward(TEST.data) - clean, axis=1).max() < 0.2
    with Finding.collected():
        model = clone(SMALL).fit(angles, found.residuals(angles, groups=groups), groups=groups)
    assert np.flatnonzero(model.pose_weight_ == 0).tolist() == [3, 12, 40, 52, 77]


def test_labels_of_a_data_frame_are_named_as_those_of_an_array():
    """pandas hands on text as objects, which have no `item`."""
    names = np.char.add("cone ", TEST.groups.astype(str))
    exchanged, twice = names.copy(), names.copy()
    exchanged[[12, 52]] = names[[52, 12]]
    twice[:8] = "cone 0, too"
    for labels in (exchanged, twice):
        given = found(TEST.nominal_arm, TEST.data, labels)
        assert given == found(TEST.nominal_arm, TEST.data, labels.astype(object))
        assert {"wrong-label", "one-place"} & set(given)
    names[5] = "cone O"
    with pytest.raises(ValueError, match="position 'cone O' has a single row, row 5: is its"):
        learn_correction(TEST.nominal_arm, TEST.data, names.astype(object))
