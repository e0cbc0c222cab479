"""An arm whose third joint counts from the horizontal is the arm whose third joint does not."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import ArmResidualRegressor, calibrate, check_correction, position_residuals
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.export._models import build_program


@pytest.fixture(scope="module")
def fitted():
    """Models of the joints' own angles, and of what a controller shows of the same poses."""
    test = make_single_point(n_positions=8, n_poses=40, random_state=4)  # simulated
    shown = test.data.copy()
    shown[:, 2] -= shown[:, 1]
    arm = test.nominal_arm.replace(couplings=[(3, 2, 1)])
    results = (
        calibrate(test.nominal_arm, test.data, test.groups),
        calibrate(arm, shown, test.groups),
    )
    models = []
    for result, angles in zip(results, (test.data, shown), strict=True):
        y = position_residuals(result.arm.forward(angles), test.groups)
        models.append(ArmResidualRegressor(result.arm, orders=6).fit(angles, y, groups=test.groups))
    return results, models, test.data, shown


def test_calibration_and_model_are_the_same(fitted):
    results, models, own, shown = fitted
    for field in ("a", "alpha", "d", "theta_offset", "probe"):
        values = (getattr(result.arm, field) for result in results)
        assert_allclose(*values, atol=1e-7, rtol=1e-7)
    first, second = (
        model.linear_model_.predict(X, return_std=True)
        for model, X in zip(models, (own, shown), strict=True)
    )
    assert np.abs(first[0]).max() > 0.01
    for one, other in zip(second, first, strict=True):
        assert_allclose(one, other, rtol=1e-5, atol=1e-6)
    # How much of a correction is used is found at folds, by numbers that round otherwise.
    assert_allclose(models[1].predict(shown), models[0].predict(own), rtol=1e-3, atol=1e-6)


def test_a_check_names_the_same_change(fitted):
    """The encoder of the joint that is coupled has become eccentric."""
    _, models, own, shown = fitted
    wave = np.deg2rad(60 / 3600) * np.cos(own[:40, 2])
    y = models[0].predict(own[:40]) + models[0].arm_.jacobian(own[:40])[:, :, 2] * wave[:, None]
    y += np.random.default_rng(0).normal(0, 0.005, y.shape)
    first, second = (
        check_correction(model, X[:40], y, groups=np.arange(40) // 20)
        for model, X in zip(models, (own, shown), strict=True)
    )
    assert (first.suspect, second.suspect) == ("harmonics of joint 3",) * 2
    assert_allclose(second.tests["statistic"], first.tests["statistic"], rtol=1e-3)


def test_the_program_has_the_sums(fitted):
    """What is exported computes what the model predicts, for C and for ONNX alike."""
    _, (_, model), _, shown = fitted
    with np.errstate(all="ignore"):
        for fade in ("exact", "small", False):
            found = build_program(model, std=True, fade=fade).run(shown)
            y, std = model.predict(shown, return_std=True)
            if fade == "exact":
                assert_allclose(found["y"], y, atol=1e-9)
                assert_allclose(found["std"], std, rtol=1e-6)
            assert_allclose(found["point"] + found["y"], model.arm_.forward(shown), atol=1e-9)
            assert_allclose(found["y"], y, atol=0.02 * np.abs(y).max() if fade else np.inf)


def test_a_correction_is_not_moved_to_an_arm_of_other_sums(fitted):
    _, (model, other), _, _ = fitted
    with pytest.raises(
        ValueError, match=r"couplings of the correction's arm are \(\) and those of"
    ):
        model.with_arm(other.arm_.replace(probe=model.arm_.probe))
