"""Causes beside the angles and a make, in the one call."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm, ArmResidualRegressor, Correction, directions_of, learn_correction
from sklearn_raacmm.datasets import ArmErrors, make_single_point

SMALL = ArmResidualRegressor(orders=3)


@pytest.mark.exhaustive
def test_directions_are_worth_something_where_joints_have_play():
    """Simulated: joints that lag behind the direction from which they came."""
    test = make_single_point(8, 20, machine=ArmErrors(play_arcsec=8.0), random_state=1)
    given = test.nominal_arm, test.data, test.groups
    plain = learn_correction(*given, model=SMALL, cv=3)
    ways = {f"direction {joint}": way for joint, way in enumerate(directions_of(test.data).T, 1)}
    learned = learn_correction(*given, model=SMALL, cv=3, extra=ways)
    assert learned.scores.summary["after"][0] < 0.8 * plain.scores.summary["after"][0]
    assert list(learned.causes) == [f"direction {joint}" for joint in range(1, 7)]
    assert "drift-of-run" not in [finding.code for finding in learned.findings]
    # Where they are not known they count as none.
    none = {name: np.zeros(5) for name in learned.causes}
    points = learned.correct(test.data[:5])[0]
    assert_allclose(points, learned.correct(test.data[:5], extra=none)[0], rtol=0)
    with pytest.raises(ValueError, match="extra names 'payload', of which the model knows nothing"):
        learned.correct(test.data[:5], extra={"payload": 1.0})


@pytest.mark.exhaustive
def test_a_cause_that_is_none_does_next_to_nothing():
    test = make_single_point(8, 20, random_state=1)
    noise = np.random.default_rng(0).normal(20, 2, len(test.data))
    learned = learn_correction(
        test.nominal_arm, test.data, test.groups, model=SMALL, cv=3, extra={"temperature": noise}
    )
    others = (learned.correct(test.data, extra={"temperature": kelvin})[0] for kelvin in (18, 22))
    assert np.abs(np.subtract(*others)).max() < 0.003
    with pytest.raises(ValueError, match=r"extra\['temperature'\] must have shape \(160,\), got"):
        learned.correct(test.data, extra={"temperature": noise[:3]})


def test_time_is_refused_where_the_angles_tell_it():
    test = make_single_point(8, 20)  # one position after the other
    with pytest.raises(ValueError, match=r"the angles explain the number of the row \(R2 0\.\d\d"):
        learn_correction(
            test.nominal_arm, test.data, test.groups, extra={"time": np.arange(len(test.data))}
        )


def test_unknown_causes_have_their_usual_value():
    usual = {"temperature": 21.0, "time": 9.0, "direction 2": 0.0}
    saved = Correction(Arm.from_name("aacmm6"), None, None, {"causes": usual})
    X = saved.inputs(np.zeros((2, 6)), {"time": [3.0, 4.0]})
    assert_allclose(X[:, 6:], [[21.0, 3.0, 0.0], [21.0, 4.0, 0.0]])
