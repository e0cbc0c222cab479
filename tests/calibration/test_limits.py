"""Limits of the warnings of a calibration: one side of each is quiet, the other is not."""

import numpy as np
import pytest

from sklearn_raacmm import Arm
from sklearn_raacmm.arm import FIELDS
from sklearn_raacmm.calibration._findings import wrong_lengths, wrong_table

ARM = Arm.from_name("aacmm6")


@pytest.mark.parametrize("moved", [-62.1025, 10.1])
def test_a_table_that_is_off_is_named_in_plain_words(moved):
    names = [f"{field}{i + 1}" for field in FIELDS[:-1] for i in range(6)]
    nominal = np.concatenate([getattr(ARM, field) for field in FIELDS[:-1]])
    far, sd = np.full(len(names), 10.0), np.full(len(names), 0.1)
    a4 = names.index("a4")
    given = nominal.copy()
    given[a4] += 0.98 * np.sign(moved) * 10
    assert not [*wrong_table(names, given, nominal, sd, far, [])]
    given[a4] = nominal[a4] + moved
    (found,) = wrong_table(names, given, nominal, sd, far, [])
    assert found.code == "table-off"
    assert found.joints == (4,)
    assert found.size_mm == pytest.approx(abs(moved))
    says = f"the length of link 4 (a4) is 62.1 mm, the table says {given[a4]:.6g} mm"
    assert says in found.text
    assert not [*wrong_table(names, given, nominal, 200 * sd, far, [])]  # not known so well
    (found,) = wrong_table(names, given, nominal, sd, far, [], scatter_mm=32.9)
    assert "the points scatter by 32.9 mm: search_table" in str(found)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(
    ("sd", "sigma", "limit"), [(0.01, 0.001, 0.05), (0.001, 0.02, 0.1)], ids=["length", "points"]
)
def test_a_length_disagrees_beyond_five_standard_deviations(sd, sigma, limit, sign):
    """Of the length as it was given, or of the points, whichever knows less."""
    lengths = [("A", "B", 400.0, sd)]
    assert not [*wrong_lengths(lengths, [sign * 0.99 * limit], sigma)]
    (found,) = wrong_lengths(lengths, [sign * 1.01 * limit], sigma)
    assert "1 of 1 known lengths disagree" in found.text
    assert "A to B is" in found.text
