"""What is no residual is refused, and what is one in another frame is warned of, by every fit."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import Arm, ArmResidualRegressor, CylindricalResidualTarget, PoseFeatures
from sklearn_raacmm.utils import FindingError, FindingWarning

ARM = Arm.from_name("aacmm6")
ANGLES = np.random.default_rng(0).uniform(-2, 2, (60, 6))
RESIDUALS = 0.05 * np.cos(ANGLES[:, :3])
POINTS = ARM.forward(ANGLES)
TRACKER = Rotation.from_rotvec([0.4, -0.7, 1.1])
SHIFT = np.array([2500.0, -900.0, 400.0])

ESTIMATORS = {
    "linear model": ArmResidualRegressor(ARM, orders=1, causes=["kinematics"]),
    "on angles": CylindricalResidualTarget(azimuth=ARM.azimuth),
    "in a pipeline": make_pipeline(
        PoseFeatures(ARM, append_azimuth=True), CylindricalResidualTarget()
    ),
}
KNOW_THE_ARM = [name for name in ESTIMATORS if name != "in a pipeline"]


def measured(turn, shift):
    """Differences between the arm's points and references that are in a frame of their own."""
    return POINTS - (turn.apply(POINTS - RESIDUALS) + shift)


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize(
    "y",
    [
        POINTS,
        POINTS - RESIDUALS,
        TRACKER.apply(POINTS) + SHIFT,
        measured(TRACKER, SHIFT),
        measured(Rotation.from_rotvec([0, 0, 0.35]), 0.0),
        1e3 * RESIDUALS + 200,  # micrometres from somewhere
    ],
    ids=["points", "references", "tracker", "differences", "turned", "too large"],
)
def test_points_and_differences_between_frames_are_refused(name, y):
    with pytest.raises(ValueError, match=r"y are (points, not|no) residuals.*\d mm"):
        ESTIMATORS[name].fit(ANGLES, y)


@pytest.mark.parametrize(("share", "said"), [(0.045, "points, not"), (0.06, "no")])
def test_points_are_known_by_a_twentieth_of_their_spread(share, said):
    spread = np.sqrt(np.square(POINTS - POINTS.mean(axis=0)).sum(axis=1).mean())
    off = np.random.default_rng(0).normal(size=(60, 3))
    off *= share * spread / np.linalg.norm(off, axis=1)[:, None]
    with pytest.raises(ValueError, match=f"y are {said} residuals"):
        ESTIMATORS["linear model"].fit(ANGLES, TRACKER.apply(POINTS + off) + SHIFT)


@pytest.mark.parametrize("name", KNOW_THE_ARM)
def test_small_motions_of_the_base_are_refused_unless_accepted(name):
    y = measured(Rotation.from_rotvec([0, 0.006, 0.007]), [1.0, 2.0, 0.0])
    said = r"nearly one motion of the base, which leaves 0\.0"
    with pytest.raises(FindingError, match=said):
        ESTIMATORS[name].fit(ANGLES, y)
    with pytest.warns(FindingWarning, match=said):
        ESTIMATORS[name].fit(ANGLES, y, accept="another-frame")


def test_without_the_arm_a_shift_is_refused():
    with pytest.raises(FindingError, match=r"one motion of the base, which leaves 0\.0"):
        ESTIMATORS["in a pipeline"].fit(ANGLES, np.add(RESIDUALS, [5.0, 0, 0]))


@pytest.mark.parametrize("name", ESTIMATORS)
def test_residuals_of_any_size_and_number_are_taken(name):
    near = ANGLES[:1] + 0.01 * ANGLES  # an error that is the same all over a small region is one
    ESTIMATORS[name].fit(near, 0.05 * np.cos(near[:, :3]) + 0.3)
    for rows, size in itertools.product([1, 3, 6, 60], [0.0, 1e-3, 1.0, 100.0]):
        ESTIMATORS[name].fit(ANGLES[:rows], size * RESIDUALS[:rows])  # warnings are errors


def test_deviations_from_one_position_are_residuals():
    """The points of one position are its deviations, but for a shift."""
    near = ANGLES[:1] + 1e-5 * ANGLES
    y = ARM.forward(near)
    ESTIMATORS["linear model"].fit(near, y - y.mean(axis=0), groups=np.zeros(len(y)))


def test_offsets_may_be_of_any_size():
    """References in a drawing's frame: what is left within positions are residuals."""
    groups = np.arange(60) % 6
    offsets = 300.0 * np.random.default_rng(1).normal(size=(6, 3))
    model = ArmResidualRegressor(ARM, orders=1, causes=["kinematics", "wobble"], offsets=True)
    model.fit(ANGLES, RESIDUALS + offsets[groups], groups=groups)
    with pytest.raises(ValueError, match="y are no residuals"):
        model.fit(ANGLES, POINTS[::-1], groups=groups)
