"""Files of corrections of arms with joints that slide."""

import numpy as np
import pytest

from sklearn_raacmm import Arm, ArmResidualRegressor
from sklearn_raacmm.error_model._columns import Terms, columns_of
from sklearn_raacmm.export import describe, export_c

from ._chains import ways_out


@pytest.mark.parametrize("unit", ["rad", "deg"])
@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_every_file_computes_as_predict_does(tmp_path, unit, convention):
    arm = Arm.from_degrees(
        a=[0, 0, 50, 60], alpha=[20, 90, 0, -90], d=[30, 40, 20, 120], joint_types="PRPR",
        probe=(30, 20, 150), limits=[(0, 900), (-3, 3), (-100, 300), (-2, 2)],
        joint_signs=[1.0001, 1, -1, 1], convention=convention, couplings=[(4, 2, 1)],
    )  # fmt: skip
    q, rng = arm.random_poses(150), np.random.default_rng(0)
    y = 0.05 * np.sin(2 * np.pi * q[:, [0]] / 10 + np.arange(3)) + rng.normal(0, 0.01, (150, 3))
    y += arm.jacobian(q)[:, :, 1] * 1e-4 * np.cos(q[:, [1]])
    X = arm.in_unit(q, unit)
    model = ArmResidualRegressor(arm, angle_unit=unit, orders=20).fit(X, y, groups=False)
    mean, std = model.predict(X, return_std=True)
    assert np.any(mean)
    for name, found, spread in ways_out(tmp_path, model, X, std=True):
        np.testing.assert_allclose(found, mean, rtol=0, atol=1e-12, err_msg=name)
        np.testing.assert_allclose(spread, std, rtol=0, atol=1e-12, err_msg=name)


def test_header_and_card_say_which_joint_is_in_mm(tmp_path):
    arm = Arm.from_name("ur10_rail").replace(probe=(0, 0, 100))
    q = arm.random_poses(60)
    X = arm.in_unit(q, "deg")
    model = ArmResidualRegressor(arm, angle_unit="deg", orders=2)
    model.fit(X, np.random.default_rng(0).normal(0, 0.01, (60, 3)), groups=False)
    export_c(model, tmp_path / "model.c")
    header = (tmp_path / "model.h").read_text(encoding="utf-8")
    assert "degrees, mm of joint 1, which slides" in header
    assert '_INPUT_UNIT "deg, mm of joint 1, which slides"' in header
    card = describe(model, X)
    assert card["input"] == "7 joint angles in deg, mm of joint 1, which slides"
    assert card["training"]["largest_joint_angles_deg_and_mm"][0] == q[:, 0].max().round(4)


def test_an_arm_that_is_seen_from_a_positioner_computes_as_predict_does(tmp_path):
    """Its vertical turns with the table."""
    table = Arm.from_degrees([0, 0], [90, -90], [0, 300], convention="modified", probe=(0, 0, 50))
    base = np.array([[0, -1, 0, 900], [1, 0, 0, 100], [0, 0, 1, -200], [0, 0, 0, 1.0]])
    arm = Arm.from_name("irb120", probe=(10, 20, 150), up=(0.1, 0.2, 1)).seen_from(table, base)
    q, rng = arm.random_poses(150), np.random.default_rng(0)
    columns = columns_of(arm, Terms(np.empty((0, 2), int), True, False, False)).at(q)
    y = columns @ rng.normal(0, 5, columns.shape[2]) + rng.normal(0, 0.002, (150, 3))
    model = ArmResidualRegressor(arm, orders=4, causes=["gravity"]).fit(q, y, groups=False)
    mean, std = model.predict(q, return_std=True)
    assert np.std(mean) > 0.8 * np.std(y)
    for name, found, spread in ways_out(tmp_path, model, q, std=True):
        np.testing.assert_allclose(found, mean, rtol=0, atol=1e-12, err_msg=name)
        np.testing.assert_allclose(spread, std, rtol=0, atol=1e-12, err_msg=name)
