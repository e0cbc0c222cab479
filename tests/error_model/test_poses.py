"""What the model of an arm takes for X: angles in either unit, and nothing silently."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    check_correction,
    next_poses,
    update_correction,
)

ARM = Arm.from_name("aacmm6")
SMALL = {"orders": 2, "causes": ["kinematics"]}


def model(**options):
    return ArmResidualRegressor(ARM, **SMALL, **options)


@pytest.fixture(scope="module")
def poses():
    """Simulated: an encoder that is eccentric by 6 arc seconds."""
    rng = np.random.default_rng(0)
    theta = rng.uniform(-2, 2, (120, 6))
    error = np.zeros_like(theta)
    error[:, 1] = np.deg2rad(6 / 3600) * np.cos(theta[:, 1])
    y = np.einsum("nij,nj->ni", ARM.jacobian(theta), error)
    return theta, y + rng.normal(scale=0.003, size=y.shape)


def test_degrees_give_the_same_model(poses):
    theta, y = poses
    degrees = np.rad2deg(theta)
    rad, deg = model(), model(angle_unit="deg")
    rad.fit(theta, y)
    deg.fit(degrees, y)
    assert_allclose(deg.predict(degrees), rad.predict(theta), atol=1e-9)
    assert_allclose(deg.fading(degrees), rad.fading(theta), atol=1e-9)
    expected = rad.predict(theta, return_std=True)[1]
    assert_allclose(deg.predict(degrees, return_std=True)[1], expected, atol=1e-9)
    # and what plans, checks and updates asks for the same unit
    chosen = [next_poses(m, X, 2)[0] for m, X in ((rad, theta[:20]), (deg, degrees[:20]))]
    assert chosen[0].tolist() == chosen[1].tolist()
    checks = [check_correction(m, X, y).p_value for m, X in ((rad, theta), (deg, degrees))]
    assert checks[0] == pytest.approx(checks[1], rel=1e-6)
    new = [update_correction(m, X, y) for m, X in ((rad, theta), (deg, degrees))]
    assert_allclose(new[1].predict(degrees), new[0].predict(theta), atol=1e-5)
