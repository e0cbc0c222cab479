"""Noise by the pose: what comes through the angles against what the probe has by itself."""

import numpy as np
import pytest

from sklearn_raacmm import Arm, ArmResidualRegressor

ARM = Arm.from_name("aacmm6")


def noisy(seed, point_mm, angle_arcsec, n=400):
    """Poses, and residuals of noise alone: in each coordinate and of each encoder."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-2, 2, (n, 6))
    turns = np.deg2rad(angle_arcsec / 3600) * rng.normal(size=(n, 6))
    y = np.einsum("ncj,nj->nc", ARM.jacobian(angles), turns)
    return angles, y + point_mm * rng.normal(size=y.shape)


@pytest.mark.parametrize(("point_mm", "angle_arcsec"), [(0.004, 0.0), (0.003, 1.0), (0.0, 1.0)])
def test_share_of_the_angles(point_mm, angle_arcsec):
    """The share is that of the variances by which the noise was drawn."""
    found, true = [], []
    for seed in range(3):
        angles, y = noisy(seed, point_mm, angle_arcsec)
        linear = ArmResidualRegressor(ARM, orders=0, causes=["gravity"]).fit(angles, y)
        linear = linear.linear_model_
        squares = np.square(ARM.jacobian(angles)).sum(axis=(1, 2)) / 3
        by_angle = np.deg2rad(angle_arcsec / 3600) ** 2 * squares.mean()
        true.append(by_angle / (by_angle + point_mm**2))
        found.append(linear.noise_of_angles)
        assert linear.lever_mm == pytest.approx(np.sqrt(squares.mean()), rel=0.02)
    assert np.mean(found) == pytest.approx(np.mean(true), abs=0.08)


def test_root_is_of_the_covariance():
    """Root, ratio, covariance and draws are of s^2 ((1 - q) I + q J J' / l^2)."""
    angles, y = noisy(0, 0.003, 1.0)
    model = ArmResidualRegressor(ARM, orders=0, causes=["gravity"]).fit(angles, y)
    linear, X = model.linear_model_, angles[:4]
    J, share = ARM.jacobian(X), linear.noise_of_angles
    of_pose = (1 - share) * np.eye(3) + share / linear.lever_mm**2 * J @ J.swapaxes(1, 2)
    ratio = linear.noise_ratio(X)
    np.testing.assert_allclose(np.square(ratio), np.diagonal(of_pose, 0, 1, 2), rtol=1e-9)
    size = np.square(linear.noise_scale * linear.noise_sd)
    bare, whole = (model.predict(X, return_cov=True, with_noise=w)[1] for w in (False, True))
    added = (whole - bare).reshape(4, 3, 4, 3)
    for i in range(4):
        for j in range(4):
            expected = size * of_pose[i] * (i == j)
            np.testing.assert_allclose(added[i, :, j], expected, atol=1e-9 * size)
    std = model.predict(X, return_std=True, with_noise=True)[1]
    bare = model.predict(X, return_std=True)[1]
    np.testing.assert_allclose(np.square(std) - np.square(bare), size * np.square(ratio), rtol=1e-9)
    draws = model.sample_y(X, 40_000, 0, with_noise=True) - model.predict(X)[:, :, None]
    found = np.cov(draws.reshape(12, -1))
    np.testing.assert_allclose(found, whole, atol=0.03 * whole.diagonal().max())
