"""Noise by the pose: what comes through the angles against what the probe has by itself."""

import numpy as np
import pytest

from sklearn_raacmm import Arm, ArmResidualRegressor
from sklearn_raacmm.error_model._columns import Terms, columns_of
from sklearn_raacmm.error_model._fit import structures_of
from sklearn_raacmm.error_model._sums import Noise, Rows, even_noise, joint_noise
from sklearn_raacmm.inference import Problem

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
        squares = np.square(ARM.jacobian(angles)).mean(axis=(0, 1))
        by_angle = np.deg2rad(angle_arcsec / 3600) ** 2 * squares.sum()
        true.append(by_angle / (by_angle + point_mm**2))
        found.append(1 - linear.noise_of_rows / linear.noise_variance)
        np.testing.assert_allclose(linear.lever_mm, np.sqrt(squares), rtol=0.03)
    assert np.mean(found) == pytest.approx(np.mean(true), abs=0.08)


@pytest.mark.parametrize("arcsec", [[1, 1, 1, 20, 20, 40], [3, 3, 3, 3, 3, 3]])
def test_noise_of_each_joint_is_found(arcsec):
    """By the variances that it was drawn with, and whatever the unit of all noise."""
    rng, sd = np.random.default_rng(1), np.deg2rad(np.divide(arcsec, 3600))
    angles = rng.uniform(-2, 2, (600, 6))
    noise = np.einsum("ncj,nj->nc", ARM.jacobian(angles), sd * rng.normal(size=(600, 6)))
    noise += rng.normal(0, 0.003, noise.shape)
    even = even_noise(ARM.jacobian(angles), np.ones(600))
    found = joint_noise(noise, ARM.jacobian(angles), np.ones(600), np.zeros(7))
    ratio = np.sqrt(found.shares.sum() / even.shares.sum())
    assert ratio == pytest.approx(1.0)  # a coordinate has the variance 1 in the mean
    size = np.square(noise).mean()
    sees = found.shares > 0.05
    of_joints = np.sqrt(size * found.of_joints)
    np.testing.assert_allclose(of_joints[sees[:-1]], sd[sees[:-1]], rtol=0.15)
    again = joint_noise(1e3 * noise, ARM.jacobian(angles), np.ones(600), np.zeros(7))
    np.testing.assert_allclose(again.of_joints, found.of_joints, rtol=1e-9)


def test_a_joint_without_lever_has_the_noise_of_the_others():
    """Its own axis runs through the probe: nothing is seen of it."""
    rng = np.random.default_rng(2)
    J = np.concatenate([rng.normal(0, 400, (500, 3, 3)), np.zeros((500, 3, 1))], axis=2)
    y = np.einsum("ncj,nj->nc", J, rng.normal(0, 1e-5, (500, 4))) + rng.normal(0, 1e-3, (500, 3))
    found = joint_noise(y, J, np.ones(500), np.zeros(5)).of_joints
    assert found[3] == pytest.approx(1 / np.mean(1 / found[:3]), rel=1e-3)


def test_residuals_that_a_fit_has_followed_are_less_than_the_noise():
    """Of restricted likelihood: what columns have taken is given back to each joint."""
    rng = np.random.default_rng(3)
    n, sd = 60, np.array([2e-5, 5e-6])
    J = rng.normal(0, 400, (n, 3, 2))
    A = np.einsum("ncj,njk->nckj", J, rng.normal(size=(n, 2, 12))).reshape(3 * n, -1)
    found = []
    for _ in range(40):
        y = np.einsum("ncj,nj->nc", J, sd * rng.normal(size=(n, 2)))
        y += rng.normal(0, 3e-3, (n, 3))
        C = np.einsum("j,ncj,ndj->ncd", sd**2, J, J) + 9e-6 * np.eye(3)
        root = Noise(sd**2, 9e-6, sd).roots(J)
        eyes = np.broadcast_to(np.eye(3), (n, 3, 3))
        np.testing.assert_allclose(root @ C @ root, eyes, atol=1e-9)
        white = (root @ A.reshape(n, 3, -1)).reshape(3 * n, -1)
        Q = np.linalg.qr(white)[0]
        left = (root @ y[:, :, None]).ravel()
        left = np.linalg.solve(root, (left - Q @ (Q.T @ left)).reshape(n, 3, 1))[:, :, 0]
        seen = root @ np.concatenate([J, eyes], axis=2)
        taken = np.square(Q.reshape(n, 3, -1).swapaxes(1, 2) @ seen).sum(axis=(0, 1))
        taken /= np.square(seen).sum(axis=(0, 1))
        taken = np.append(taken[:2], taken[2:].mean())
        noise = joint_noise(left, J, np.ones(n), taken)
        followed = joint_noise(left, J, np.ones(n), np.zeros(3))
        found.append([one.of_joints / one.of_rows for one in (noise, followed)])
    found, followed = np.mean(found, axis=0) / (sd**2 / 9e-6)
    np.testing.assert_allclose(found[0], 1.0, atol=0.1)  # the smaller one is drawn to it
    assert followed[0] < 0.8


def test_noise_of_even_joints_eats_no_wobble():
    """Axes that tilt with the angle look like noise of their joints, and are not taken for it."""
    rng = np.random.default_rng(4)
    columns = columns_of(ARM, Terms(np.empty((0, 2), int), False, False, True))
    angles, y = noisy(4, 0.003, 2.0)
    y = y + columns.at(angles) @ rng.normal(0, 4, len(columns.others))
    linear = ArmResidualRegressor(ARM, orders=2).fit(angles, y, groups=False).linear_model_
    shares = np.square(linear.lever_mm) * linear.noise_of_joints / linear.noise_variance
    sd = np.rad2deg(np.sqrt(linear.noise_of_joints)) * 3600
    assert np.count_nonzero(shares > 0.05) >= 4
    assert np.all(np.abs(np.log(sd[shares > 0.05] / 2)) < np.log(1.5))


def test_the_size_of_all_noise_changes_no_choice():
    """With the root of every row twice as large only the noise variance changes."""
    angles, y = noisy(5, 0.003, 2.0, n=200)
    y = y + ARM.jacobian(angles)[:, :, 1] * 2e-5 * np.cos(5 * angles[:, 1:2])
    offered = np.array([(j, k) for j in range(6) for k in range(1, 9)])
    columns = columns_of(ARM, Terms(offered, True, True, False))
    noise, found = Noise(np.full(6, 1e-10), 1e-5, np.ones(6)), []
    for size in (1.0, 2.0):
        root = size * noise.roots(ARM.jacobian(angles))
        rows = Rows(ARM, angles, y, np.ones(200), np.arange(200) // 20, root=root)
        structures = structures_of(columns, True, [])
        found.append(Problem(rows.sums(columns), structures).search())
    one, two = found
    assert [1, 5] in offered[one.lines].tolist()
    np.testing.assert_array_equal(two.lines, one.lines)
    np.testing.assert_allclose(two.coef, one.coef, atol=1e-4 * np.abs(one.coef).max())
    assert two.noise_variance == pytest.approx(4 * one.noise_variance, rel=1e-4)


def test_root_is_of_the_covariance():
    """Root, ratio, covariance and draws are of r I + sum_j v_j J_j J_j'."""
    angles, y = noisy(0, 0.003, 1.0)
    model = ArmResidualRegressor(ARM, orders=0, causes=["gravity"]).fit(angles, y)
    linear, X = model.linear_model_, angles[:4]
    J = ARM.jacobian(X)
    of_pose = linear.noise_of_rows * np.eye(3) + (linear.noise_of_joints * J) @ J.swapaxes(1, 2)
    ratio = linear.noise_ratio(X)
    variance = np.square(linear.noise_sd * ratio)
    np.testing.assert_allclose(variance, np.diagonal(of_pose, 0, 1, 2), rtol=1e-9)
    size = np.square(linear.noise_scale)
    bare, whole = (model.predict(X, return_cov=True, with_noise=w)[1] for w in (False, True))
    added = (whole - bare).reshape(4, 3, 4, 3)
    for i in range(4):
        for j in range(4):
            expected = size * of_pose[i] * (i == j)
            atol = 1e-9 * size * of_pose.max()
            np.testing.assert_allclose(added[i, :, j], expected, atol=atol)
    std = model.predict(X, return_std=True, with_noise=True)[1]
    bare = model.predict(X, return_std=True)[1]
    np.testing.assert_allclose(np.square(std) - np.square(bare), size * variance, rtol=1e-9)
    draws = model.sample_y(X, 40_000, 0, with_noise=True) - model.predict(X)[:, :, None]
    found = np.cov(draws.reshape(12, -1))
    np.testing.assert_allclose(found, whole, atol=0.03 * whole.diagonal().max())
