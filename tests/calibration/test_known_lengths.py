"""Known lengths that are not: in another unit, of other ends, of balls without their diameter."""

import re

import numpy as np
import pytest

from sklearn_raacmm import calibrate
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.measurements import check_length
from sklearn_raacmm.utils import Finding

TEST = make_single_point(9, 16, machine="typical", random_state=2)  # simulated
POINTS, GROUPS = TEST.simulation.true_points, TEST.groups
PLACES = np.array([POINTS[g == GROUPS].mean(axis=0) for g in range(9)])
ONE, THREE = [(0, 1)], [(0, 1), (2, 3), (4, 5)]


def true_length(i, j):
    return float(np.linalg.norm(PLACES[i] - PLACES[j]))


def known(pairs, change=lambda mm: mm, only=None):
    """Known lengths, all or one of them changed."""
    lengths = [true_length(*pair) for pair in pairs]
    changed = [change(mm) if only in (None, i) else mm for i, mm in enumerate(lengths)]
    return [(*pair, mm, 0.01) for pair, mm in zip(pairs, changed, strict=True)]


def findings(lengths, arm=TEST.nominal_arm):
    with Finding.collected():
        return calibrate(arm, TEST.data, GROUPS, lengths=lengths).findings


def of_lengths(lengths, arm=TEST.nominal_arm):
    """The one finding on lengths."""
    (found,) = [one for one in findings(lengths, arm) if "length" in one.code]
    return found


@pytest.mark.parametrize("pairs", [ONE, THREE])
def test_true_lengths_are_not_named(pairs):
    assert not findings(known(pairs))


def test_a_warm_bar_is_longer_than_stated():
    """As long as it was measured, the arm is the same: by its linear expansion from 20 degrees."""
    (one,) = known(ONE)
    labels = np.unique(GROUPS).tolist()
    for growth, per_kelvin in (((25.0,), 11.5e-6), ((15.0, 0.5e-6), 0.5e-6)):
        stated = one[2] / (1 + per_kelvin * (growth[0] - 20))
        assert check_length((*one[:2], stated, 0.01, *growth), labels) == pytest.approx(one)
    # 500 mm of steel at 25 degrees.
    assert check_length((0, 1, 500, 0.01, 25), labels)[2] == pytest.approx(500.02875)
    warm = (*one[:2], one[2] / (1 + 11.5e-6 * 20), 0.01, 40)
    given = TEST.nominal_arm, TEST.data, GROUPS
    arms = [calibrate(*given, lengths=[bar]).arm for bar in (one, warm)]
    np.testing.assert_allclose(arms[1].d, arms[0].d, atol=1e-6)
    for wrong in ((300,), (25, -1e-6), (25, 1.0), (np.nan,)):
        with pytest.raises(ValueError, match=r"at -40 to 80 degrees C and grow by 0 to 0\.0003"):
            check_length((*one, *wrong), labels)
    with pytest.raises(ValueError, match="each of lengths must be"):
        check_length((*one, 25, 1e-5, 3), labels)


@pytest.mark.parametrize(("pairs", "only"), [(THREE, 1), (THREE, 2)])
def test_one_wrong_length_is_told_from_the_others(pairs, only):
    """What the cones and the other lengths say of it is right, and nothing else is as likely."""
    found = of_lengths(known(pairs, lambda mm: mm + 12, only))
    assert (found.code, found.weight) == ("wrong-length", "repair")
    i, j = pairs[only]
    said = re.fullmatch(rf".*: {i} to {j} may be ([0-9.]+) mm, not ([0-9.]+)\.", found.text)
    assert float(said[1]) == pytest.approx(true_length(i, j), abs=0.5)
    assert float(said[2]) == pytest.approx(true_length(i, j) + 12, abs=0.01)


def test_of_one_length_and_a_table_both_are_named():
    """Which of them is wrong, one length does not show; two that agree do."""
    arm = TEST.nominal_arm
    table = arm.replace(a=1.02 * arm.a, d=1.02 * arm.d)
    for found in (of_lengths(known(ONE, lambda mm: mm + 12)), of_lengths(known(ONE), table)):
        assert found.weight == "repair"
        assert "all lengths of the table may be wrong" in found.text
        assert " or 0 to 1 may be 7" in found.text
        assert "another known length tells which is right" in found.advice
    text = of_lengths(known(THREE), table).text
    assert text.endswith("): all lengths of the table may be wrong.")


def test_a_link_mistyped_is_named_with_a_known_length():
    """By cones alone it is calibrated as well, but their table is not known that well."""
    d = TEST.nominal_arm.d.copy()
    d[2] *= 1.01
    mistyped = TEST.nominal_arm.replace(d=d)
    (found,) = findings(known(ONE), mistyped)
    assert (found.code, found.joints) == ("table-off", (3,))
    assert f"(d3) is 750.4 mm, the table says {d[2]:.6g} mm" in found.text
    assert not findings((), mistyped)


@pytest.mark.parametrize(("factor", "weight"), [(1.08, "doubt"), (1.12, "repair")])
def test_a_long_link_that_is_another_one_is_not_handed_over(factor, weight):
    """A tenth of a long link is more than any tape gets wrong; a tracker knows its length."""
    rng = np.random.default_rng(0)
    angles = rng.uniform(-1.5, 1.5, (80, 6))
    points = TEST.arm.forward(angles) + rng.normal(scale=0.02, size=(80, 3)) + [500, 0, 0]
    d = TEST.nominal_arm.d * np.where(np.arange(6) == 2, factor, 1.0)
    with Finding.collected() as found:
        calibrate(TEST.nominal_arm.replace(d=d), angles, points=points)
    (table,) = (one for one in found if one.code == "table-off")
    assert (table.weight, 3 in table.joints) == (weight, True)
