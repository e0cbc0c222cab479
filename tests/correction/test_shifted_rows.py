"""Points that stand a row off their poses are named as such; right ones, and other faults, not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, FindingError, learn_correction
from sklearn_raacmm.correction._table_search import shifted_rows
from sklearn_raacmm.utils import Finding

ARM = Arm.from_name("ur10")
N = 40
ANGLES = np.random.default_rng(0).uniform(-1.2, 1.2, (N, 6))
# In a tracker's frame, of an arm whose joint 2 is off by two degrees.
WRONG = ARM.replace(theta_offset=ARM.theta_offset + np.deg2rad([0, 2, 0, 0, 0, 0]))
POINTS = WRONG.forward(ANGLES) @ Rotation.from_rotvec([0.1, 0.2, 2]).as_matrix() + [900, 80, -7]


@pytest.mark.parametrize("k", [0, 1, 17, N - 6])
@pytest.mark.parametrize("lost", [True, False])
def test_a_lost_or_doubled_point_is_named_by_its_row(k, lost):
    if lost:
        points = np.vstack([np.delete(POINTS, k, axis=0), POINTS[-1]])
    else:
        points = np.insert(POINTS, k, POINTS[k - 1], axis=0)[:N]
    finding = shifted_rows(ARM, ANGLES, points)
    # Of a file that begins with a foreign point, the second is the first that is another row's.
    assert finding.rows == (1 if not lost and k == 0 else k,)
    assert ("of the next row" if lost else "of the last row") in finding.text


def test_other_faults_are_no_shift():
    right = POINTS
    order = np.random.default_rng(1).permutation(N)
    mirrored = POINTS * [1, -1, 1]
    for points in (right, POINTS[order], POINTS / 25.4, mirrored, POINTS[::-1]):
        assert shifted_rows(ARM, ANGLES, points) is None
    assert shifted_rows(ARM, ANGLES[:4], POINTS[:4]) is None


def test_learning_says_so():
    points = np.vstack([np.delete(POINTS, 11, axis=0), POINTS[-1]])
    said = "From row 11 on each point is that of the next row"
    with Finding.ignored(), pytest.raises(FindingError, match=said):
        learn_correction(ARM, ANGLES, points=points)


def test_an_arm_that_stood_still_is_refused():
    angles = ANGLES[:1] + np.random.default_rng(2).normal(0, 1e-6, (N, 6))
    with pytest.raises(FindingError, match="did not move: 40 rows are 1 pose"):
        learn_correction(ARM, angles, points=POINTS)
