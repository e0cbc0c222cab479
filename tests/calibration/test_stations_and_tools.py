"""Several set-ups, several tools, and a correction in one fit."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, calibrate

from .test_calibration import poses_at

ARM = Arm.from_name("ur10", probe=(0, 0, 93))


class Bend:
    """A correction that is no model of ours: the arm sinks as it reaches out."""

    def __init__(self, size=-1e-6):
        self.size = size

    def predict(self, angles):
        points = ARM.forward(angles)
        out = np.zeros_like(points)
        out[:, 2] = self.size * (points[:, 0] ** 2 + points[:, 1] ** 2)
        return out


def set_ups(arm, n, seed=0, noise_mm=0.02):
    """Angles, points, labels, and the bases of two stations."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-2.5, 2.5, (n, 6))
    labels = np.where(np.arange(n) % 2, "tracker left", "tracker right")
    turns = Rotation.random(2, random_state=seed).as_matrix()
    shifts = rng.normal(0, 2000, (2, 3))
    which = (labels == "tracker right").astype(int)
    points = np.einsum("nij,nj->ni", turns[which], arm.forward(angles)) + shifts[which]
    return angles, points + rng.normal(0, noise_mm, (n, 3)), labels, turns, shifts


def test_stations_in_one_fit():
    angles, points, labels, turns, shifts = set_ups(ARM, 120)
    result = calibrate(ARM, angles, points=points, stations=labels, free=["probe"])
    assert result.scatter_after_mm < 0.04
    assert list(result.bases) == ["tracker left", "tracker right"]
    for (rotation, shift), turn, true in zip(result.bases.values(), turns, shifts, strict=True):
        assert_allclose(rotation, turn, atol=1e-4)
        assert_allclose(shift, true, atol=0.1)
    assert "base_x[tracker left]" in result.names
    residuals = result.residuals(angles, points, stations=labels)
    assert_allclose(residuals, result.residuals_mm, atol=1e-9)
    with pytest.raises(ValueError, match="has 2 stations: give stations=labels"):
        result.residuals(angles, points)
    with pytest.raises(ValueError, match="stations name 'attic', which"):
        result.residuals(angles[:1], points[:1], stations=["attic"])


def test_a_probe_each():
    rng = np.random.default_rng(0)
    angles = rng.uniform(-2.5, 2.5, (120, 6))
    labels = np.repeat(["long", "short"], 60)
    probes = {"long": (3, -2, 200.0), "short": (0, 0, 50.0)}
    points = np.concatenate(
        [ARM.replace(probe=p).forward(angles[labels == t]) for t, p in probes.items()]
    )
    points += rng.normal(0, 0.02, points.shape)
    result = calibrate(ARM, angles, points=points, tools=labels, free=["probe"])
    for label, probe in probes.items():
        assert_allclose(result.arms[label].probe, probe, atol=0.03)
    assert {"probe_z[long]", "probe_z[short]"} <= set(result.names)
    assert_allclose(result.residuals(angles, points, tools=labels), result.residuals_mm, atol=1e-9)
    # The same points as fixed points that both probes touch: groups.
    groups = np.arange(120) % 2
    with pytest.raises(ValueError, match="stations are of measured points"):
        calibrate(ARM, angles, groups, stations=labels)


def test_tools_of_a_single_point_test():
    arm = Arm.from_name("aacmm6")
    longer = arm.replace(probe=arm.probe + np.array([0, 0, 60.0]))
    groups, labels = np.arange(150) // 25, np.tile(["a", "b"], 75)
    targets = np.stack([np.full(150, 500), 100 * groups - 200, np.full(150, 300)], axis=1)
    angles, rng = np.empty((150, 6)), np.random.default_rng(0)
    for own, rows in ((arm, labels == "a"), (longer, labels == "b")):
        angles[rows] = poses_at(own, targets[rows], 1, rng)
    result = calibrate(arm, angles, groups, tools=labels, free=["probe"])
    difference = result.arms["b"].probe - result.arms["a"].probe
    assert_allclose(difference, [0, 0, 60], atol=1e-3)
    assert result.scatter_after_mm < 1e-3


def test_base_and_tool_are_fitted_through_the_correction():
    """Without noise the base and the tool come out exactly, and uncorrected they do not."""
    rng = np.random.default_rng(0)
    angles = rng.uniform(-1.5, 1.5, (60, 6))
    true = ARM.replace(probe=(5, -3, 110))
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 2]).as_matrix()
    # The arm shows what is there and its own error on top: the tracker sees the first.
    points = (true.forward(angles) - Bend().predict(angles)) @ turn.T + [100, 200, 300]
    through = calibrate(ARM, angles, points=points, correction=Bend(), free=["probe"])
    assert_allclose(through.arm.probe, true.probe, atol=1e-5)
    assert_allclose(through.base_rotation, turn, atol=1e-7)
    assert through.scatter_after_mm < 1e-5
    naive = calibrate(ARM, angles, points=points, free=["probe"])
    assert np.linalg.norm(naive.arm.probe - true.probe) > 0.05
    assert np.linalg.norm(naive.base_translation - [100, 200, 300]) > 0.05
    with pytest.warns(UserWarning, match="do not use it here. Is it of this arm"):
        calibrate(ARM, angles, points=points, correction=Bend(1e-6), free=["probe"])
    # `residuals` are those of the arm alone: what the correction has to predict.
    assert_allclose(through.residuals(angles, points), Bend().predict(angles), atol=1e-4)
    degrees = calibrate(
        ARM, np.rad2deg(angles), points=points, correction=Bend(), free=["probe"], angle_unit="deg"
    )
    assert_allclose(degrees.arm.probe, through.arm.probe, atol=1e-9)


def test_a_correction_must_be_one():
    angles, points, *_ = set_ups(ARM, 20)
    with pytest.raises(TypeError, match=r"predict\(angles\), got str"):
        calibrate(ARM, angles, points=points, correction="model")

    class Flat:
        def predict(self, X):
            return np.zeros(len(X))

    with pytest.raises(ValueError, match=r"shape \(20, 3\) in mm, got shape \(20,\)"):
        calibrate(ARM, angles, points=points, correction=Flat())
