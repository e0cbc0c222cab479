# pyright: strict
"""A program of somebody who checks types: mypy and pyright know every result.

`.ci/run types` reads this file with ``mypy --strict`` and ``pyright``.
"""

from pathlib import Path
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    Correction,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    check_correction,
    learn_correction,
    plan_poses,
    position_residuals,
    search_table,
    update_correction,
)
from sklearn_raacmm.calibration import CalibrationResult
from sklearn_raacmm.correction import CorrectionCheck, CorrectionScores, PosePlan, TableChange
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import axis_repeatability, fit_sphere, single_point_repeatability
from sklearn_raacmm.utils import Finding

Floats = NDArray[np.float64]
Pair = tuple[Floats, Floats]


def the_arm() -> None:
    """Kinematics, files and plans."""
    arm = Arm.from_name("aacmm6")
    angles = np.full((3, 6), 0.3)
    points = assert_type(arm.forward(angles), Floats)
    assert_type(arm.frames(angles), Floats)
    assert_type(arm.jacobian(angles), Floats)
    assert_type(arm.azimuth(angles), Floats)
    found = assert_type(arm.angles_for(points, start=angles), Floats)
    assert np.allclose(arm.forward(found), points)
    assert_type(arm.a, Floats)
    assert_type(arm.probe, Floats)
    assert_type(arm.limits, Floats | None)
    assert_type(Arm.from_json(arm.to_json()), Arm)
    plan = plan_poses(arm, 2, 3)
    assert_type(plan, PosePlan)
    assert_type(plan.angles, Floats)


def models_of_residuals() -> None:
    """Estimators, and what is done with fitted ones."""
    test = make_single_point(5, 20, random_state=0)
    X, y, groups = assert_type(test.data, Floats), assert_type(test.target, Floats), test.groups
    assert_type(position_residuals(test.points, groups), Floats)
    model = ArmResidualRegressor(test.arm, orders=2).fit(X, y, groups=groups)
    assert_type(model, ArmResidualRegressor)
    assert_type(model.predict(X), Floats)
    assert_type(model.predict(X, return_std=True), Pair)
    assert_type(model.predict(X[:2], return_cov=True, with_unseen=True), Pair)
    corrected = assert_type(model.correct(X), Floats)
    assert_type(model.correct(X, return_std=True), Pair)
    assert_type(model.correct(X, test.points), Floats)
    assert_type(model.angles_for(corrected[:1], X[:1]), Floats)
    assert_type(model.with_arm(test.arm.replace(probe=(0, 0, 150))), ArmResidualRegressor)
    assert_type(model.score(X, y), float)
    assert_type(update_correction(model, X[:40], y[:40], groups=groups[:40]), ArmResidualRegressor)
    check = check_correction(model, X, y, groups=groups)
    assert_type(check, CorrectionCheck)

    net = RBFNetRegressor(8, length_scale=2.0, alpha=0.1)
    poses = PoseFeatures(test.arm).fit_transform(X)
    assert_type(poses, Floats)
    assert_type(net.fit(poses, y), RBFNetRegressor)
    assert_type(net.predict(poses), Floats)
    assert_type(net.predict(poses, return_std=True), Pair)
    assert_type(net.predict(poses, return_cov=True), Pair)
    assert_type(net.predict_gradient(poses), Floats)
    assert_type(net.sample_y(poses[:5]), Floats)
    chain = CylindricalResidualTarget(net, azimuth=test.arm.azimuth)
    assert_type(chain.fit(X, y, groups=groups), CylindricalResidualTarget)
    assert_type(chain.predict(X), Floats)
    assert_type(chain.predict(X, return_std=True), Pair)


def one_call(tmp_path: Path) -> None:
    """From measurements to a correction in a folder."""
    test = make_single_point(6, 12, random_state=0)
    learned = learn_correction(
        test.nominal_arm, test.data, test.groups, model=ArmResidualRegressor(orders=2), cv=3
    )
    assert_type(learned, Correction)
    assert_type(learned.model.predict(test.data), Floats)
    assert_type(learned.helps, bool)
    assert_type(learned.correct(test.data), Pair)
    assert_type(learned.calibration, CalibrationResult | None)
    assert_type(learned.scores, CorrectionScores | None)
    assert_type(learned.findings, tuple[Finding, ...])
    learned.save(tmp_path / "arm")
    again = assert_type(Correction.load(tmp_path / "arm"), Correction)
    points, _ = again.correct(test.data)
    assert_type(single_point_repeatability(points, test.groups), float)
    assert_type(single_point_repeatability(points, test.groups, aggregate=None), Floats)
    assert_type(axis_repeatability(points, test.groups), Floats)
    assert_type(fit_sphere([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]])[0], Floats)

    result = calibrate(test.nominal_arm, test.data, test.groups)
    assert_type(result, CalibrationResult)
    assert_type(result.arm, Arm)
    assert_type(search_table(result.arm, test.data, test.groups), TableChange | None)
    assert_type(result.residuals(test.data, groups=test.groups), Floats)
