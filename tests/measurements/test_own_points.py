"""Deviations of real single-point tests beside the arm's own points: what was done is named."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.measurements import of_own_points
from sklearn_raacmm.utils import Finding, Groups

MORE = [pytest.param(name, marks=pytest.mark.exhaustive) for name in ("panda_6", "panda_7")]
ARMS = {}


@pytest.fixture(params=["panda_2", "panda_3", *MORE])
def real(request, panda):
    """Arm, angles, deviations and codes of a real test, calibrated once."""
    data = panda(request.param)
    if request.param not in ARMS:
        with Finding.collected():
            nominal = Arm.from_name("panda", probe=(0, 0, 138))
            ARMS[request.param] = calibrate(nominal, data.angles, data.groups).arm
    arm = ARMS[request.param]
    y = position_residuals(arm.forward(data.angles), data.groups)
    return arm, data.angles, y, np.unique(data.groups, return_inverse=True)[1]


def done(arm, angles, y, codes, **more):
    """Code of what was done, and whether nothing was."""
    as_given, found = of_own_points(y, codes, arm, angles, np.arange(len(y)), **more)
    return found[0].code if found else as_given


def test_nothing_was_done(real):
    arm, angles, y, codes = real
    order = np.random.default_rng(0).permutation(len(y))
    assert done(*real) is True
    assert done(arm, angles[order], y[order], codes[order]) is True


def test_each_change_is_named(real):
    arm, angles, y, codes = real
    n = len(y)
    rng = np.random.default_rng(1)
    turn = Rotation.from_rotvec([0.3, -0.5, 1.0])
    reversed_, exchanged = angles.copy(), angles.copy()
    reversed_[:, 3] *= -1
    exchanged[:, [1, 2]] = exchanged[:, [2, 1]]
    table = arm.replace(d=arm.d + rng.normal(0, 0.5, 7), theta_offset=rng.normal(0, 1e-3, 7))
    f = Groups(codes).centred(rng.normal(0, 0.1, (n, 3)))
    cases = [
        (angles, -y, "sign-of-residuals"),
        (angles, y / 25.4, "unit-of-residuals"),
        (angles, 1e3 * y, "unit-of-residuals"),
        (angles, y[:, [2, 0, 1]], "axes-of-residuals"),
        (angles, y * [1, -1, 1], "axes-of-residuals"),
        (angles, turn.apply(y), "axes-of-residuals"),
        (angles, np.roll(y, 1, axis=0), "shifted-rows"),
        (angles, np.roll(y, -1, axis=0), "shifted-rows"),
        (np.vstack([np.delete(angles, n // 3, axis=0), angles[:1]]), y, "shifted-rows"),
        (angles, y[rng.permutation(n)], "rows-unrelated"),
        (reversed_, y, "joints"),
        (exchanged, y, "joints"),
        (angles, position_residuals(table.forward(angles), codes), "other-table"),
        (angles, y - f, "corrected-already"),
        (angles, y - 2 * f, "sign-of-residuals"),
    ]
    assert [done(arm, q, v, codes, known=f) for q, v, _ in cases] == [c for *_, c in cases]


def test_the_row_from_which_on_they_are_shifted_is_named(real):
    arm, angles, y, codes = real
    row = len(y) // 3
    dropped = np.vstack([np.delete(angles, row, axis=0), angles[:1]])
    (finding,) = of_own_points(y, codes, arm, dropped, 10 + np.arange(len(y)))[1]
    assert abs(finding.rows[0] - 10 - row) <= 1  # one without a neighbour of its position
    assert f"of the row before, from row {finding.rows[0]} on" in finding.text


def test_what_is_no_deviation_of_these_points_has_no_finding():
    """Errors against a reference at points all over the volume, and noise beside a cone's."""
    test = make_single_point(9, 16, random_state=3)  # simulated
    angles = np.random.default_rng(0).uniform(-2, 2, (144, 6))
    y = np.cos(angles[:, :3])
    assert done(test.arm, angles, y, test.groups) is False
    noisy = test.points + np.random.default_rng(1).normal(0, 0.01, test.points.shape)
    y = position_residuals(noisy, test.groups)
    assert done(test.arm, test.data, y, test.groups) is False
    assert done(test.arm, test.data, 0 * y, test.groups) is False


def test_what_another_model_left_is_a_doubt():
    """A second model of what a first one leaves is fitted, and the finding goes with it."""
    test = make_single_point(8, 25, random_state=3)
    wave = position_residuals(0.006 * np.sin(test.data[:, :3]), test.groups)
    model = ArmResidualRegressor(test.arm, orders=4)
    with Finding.collected():
        model.fit(test.data, test.target - wave, groups=test.groups)
    assert {found.weight for found in model.findings_ if found.code == "other-table"} == {"doubt"}
    with Finding.collected():
        model.fit(test.data, -test.target, groups=test.groups)
    assert [found.weight for found in model.findings_] == ["repair"]


def test_medians_are_those_of_each_position():
    rng = np.random.default_rng(0)
    values, codes = rng.normal(size=(40, 3)), rng.choice([2, 5, 6, 9], 40)
    found = Groups(codes).medians(values)
    for code in (2, 5, 6, 9):
        own = values[codes == code]
        assert_array_equal(found[codes == code], np.tile(np.median(own, axis=0), (len(own), 1)))
    assert_array_equal(Groups(None).medians(values), 0)
