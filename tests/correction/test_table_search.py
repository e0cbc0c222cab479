"""Arms described wrongly on purpose: the search names what was done to them."""

import numpy as np
import pytest

from sklearn_raacmm import Arm, calibrate, search_table
from sklearn_raacmm.datasets import make_single_point


@pytest.fixture(scope="module")
def data():
    return make_single_point(n_positions=8, n_poses=15)


EXCHANGED = [0, 1, 4, 3, 2, 5]


@pytest.mark.parametrize(
    ("signs", "columns", "factor", "change"),
    [
        ([1, -1, 1, 1, 1, 1], None, 1, "joint 2 reversed"),
        ([1, 1, -1, -1, 1, 1], None, 1, "joints 3 and 4 reversed"),
        (1, EXCHANGED, 1, "joints 3 and 5 exchanged"),
        (1, [5, 4, 3, 2, 1, 0], 1, "the joints in reverse order"),
        (1, None, 180 / np.pi, "the angles in degrees"),
        ([1, 1, 1, -1, 1, 1], None, 180 / np.pi, "joint 4 reversed and the angles in degrees"),
    ],
)
def test_what_was_done_is_named(data, signs, columns, factor, change):
    wrong = data.nominal_arm.replace(joint_signs=signs)
    angles = factor * data.data[:, columns or range(6)]
    found = search_table(wrong, angles, data.groups)
    assert found.change == change
    # What is proposed does what it says.
    result = calibrate(
        found.arm, angles[:, found.columns], data.groups, angle_unit=found.angle_unit
    )
    assert found.scatter_mm == pytest.approx(result.scatter_after_mm, rel=1e-6)
    assert found.scatter_mm < 0.1 < 20 < found.scatter_given_mm
    assert str(found).startswith(f"With {change} the points scatter by 0.0")
    reversed_ = [str(i + 1) for i in range(6) if np.resize(signs, 6)[i] < 0]
    assert ("-".join(["--take reversed", *reversed_]) in found.options) == bool(reversed_)
    assert ("--unit deg" in found.options) == (factor != 1)
    assert (f"columns {','.join(str(i + 1) for i in columns or ())}" in found.options) == (
        columns is not None
    )


def test_the_mirror_image_is_named_beside_it(data):
    """Roll joints turned round and y the other way: no scatter tells, a place does."""
    wrong = data.nominal_arm.replace(joint_signs=[1, -1, 1, 1, 1, 1])
    found = search_table(wrong, data.data, data.groups)
    (mirror,) = found.equals
    assert mirror.options == "--take reversed-1-2-3-5"
    assert mirror.scatter_mm == pytest.approx(found.scatter_mm, rel=0.01)
    x, y, z = data.arm.forward(data.data[:1])[0]
    np.testing.assert_allclose(found.first_point, [x, y, z], atol=10)
    apart = np.linalg.norm(np.subtract(found.first_point, mirror.first_point))
    assert apart > 20
    assert f"joint 2 reversed, {found.first_point[0]:.0f}, " in str(found)
    assert "Others do it as well; x, y and z of the first row in mm tell which is" in str(found)


def test_the_other_convention_against_a_tracker():
    """A table in Craig's form given as a standard one."""
    rng = np.random.default_rng(0)
    truth = Arm.from_name("panda", probe=(0, 0, 240))
    angles = rng.uniform(-1.5, 1.5, (150, 7))
    points = truth.forward(angles)[:, [2, 0, 1]] + rng.normal(scale=0.05, size=(150, 3)) + 1000
    found = search_table(truth.replace(convention="standard"), angles, points=points)
    assert found.change == "the modified convention"
    assert found.arm == truth
    assert 0.05 < found.scatter_mm < 0.1


def test_small_swings_are_not_taken_for_degrees(data):
    """Radians read as degrees hardly move the arm: its points scatter little, and mean nothing."""
    wrong = data.nominal_arm.replace(joint_signs=[1, 1, 1, -1, 1, 1])
    assert search_table(wrong, data.data, data.groups).angle_unit == "rad"
    degrees = np.rad2deg(data.data)
    found = search_table(wrong, degrees, data.groups, angle_unit="deg")
    assert (found.change, found.angle_unit) == ("joint 4 reversed", "deg")


def test_nothing_is_proposed_for_a_right_table_or_no_arm_at_all(data):
    assert search_table(data.nominal_arm, data.data, data.groups) is None
    rng = np.random.default_rng(1)
    assert search_table(data.nominal_arm, rng.uniform(-2, 2, (60, 6)), np.arange(60) // 10) is None
