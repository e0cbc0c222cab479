"""What a single-point test cannot show, and standard deviations of what it can."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm
from sklearn_raacmm.error_model import Terms
from sklearn_raacmm.error_model._columns import columns_of
from sklearn_raacmm.error_model._linear_model import place_fields
from sklearn_raacmm.error_model._sums import without_motions
from sklearn_raacmm.inference import Sums
from sklearn_raacmm.utils import Groups

NAMES = ("aacmm6", "panda", "ur10")


def polynomials(points, gravity=True):
    """The fields in closed form, (n, 3, k): motions, scale, and what the load at the probe bends.

    The torque of a weight at p about the base's x axis is proportional to y, and about y to x. The
    axis of the second joint is horizontal and turns with the arm: bending about it, above the base,
    is the two and a stretch across the first axis.
    """
    x, y, z = points.T
    nothing = np.zeros_like(x)
    fields = [np.broadcast_to(e, points.shape) for e in np.eye(3)]
    fields += [np.cross(e, points) for e in np.eye(3)] + [points]
    if gravity:
        fields += [
            np.column_stack(field)
            for field in ((x, y, nothing), (nothing, -y * z, y * y), (x * z, nothing, -x * x))
        ]
    return np.stack(fields, axis=2)


def poses_at_points(arm, n_positions, n_poses, rng):
    """Poses that reach the same point, by Newton's method from random ones."""
    start = rng.uniform(-1.5, 1.5, (n_positions, arm.n_joints))
    codes = np.repeat(np.arange(n_positions), n_poses)
    target = arm.forward(start)[codes]
    theta = start[codes] + rng.normal(0, 0.7, (len(codes), arm.n_joints))
    for _ in range(60):
        inverse = np.linalg.pinv(arm.jacobian(theta), rcond=0.01)
        step = np.einsum("nij,nj->ni", inverse, target - arm.forward(theta))
        theta = theta + np.clip(step, -0.2, 0.2)
    there = np.linalg.norm(arm.forward(theta) - target, axis=1) < 1e-6
    return theta[there], codes[there]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("gravity", [False, True])
def test_fields_are_motions_scale_and_bends(name, gravity):
    arm = Arm.from_name(name, probe=(5.0, -8.0, 120.0))
    extra = (("temperature", (20.0,)), ("payload", (1.0,)))
    terms = Terms(np.array([(1, 1), (2, 3)]), gravity, True, True, extra)
    rng = np.random.default_rng(1)
    theta, codes = poses_at_points(arm, 20, 6, rng)
    X = np.column_stack([theta, np.full(len(theta), 25.0), np.ones(len(theta))])
    moved = columns_of(arm, terms).at(X) @ place_fields(columns_of(arm, terms))
    size = np.linalg.norm(moved, axis=(0, 1))
    # All poses that reach a point move alike, and each field is another one.
    assert np.abs(Groups(codes).centred(moved) / size).max() < 1e-4
    moved = (moved / size).reshape(-1, len(size))
    expected = polynomials(arm.forward(theta), gravity).reshape(len(moved), -1)
    assert moved.shape == expected.shape
    left = expected - moved @ np.linalg.lstsq(moved, expected, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-3 * np.linalg.norm(expected)
    assert np.linalg.cond(moved) < 100


@pytest.mark.parametrize("name", ["aacmm6", "panda"])
def test_a_single_point_test_knows_nothing_of_base_and_scale(name):
    """What is taken out moves all points as a rigid body of another size does, in seven ways."""
    arm = Arm.from_name(name, probe=(10.0, -20.0, 150.0))
    rng = np.random.default_rng(0)
    theta = rng.uniform(-2, 2, (60, arm.n_joints))
    terms = Terms(np.array([(2, 1)]), False, True, False)
    n = len(columns_of(arm, terms).names)
    sums = Sums(np.eye(n), np.zeros(n), np.zeros((n, 2)), None, None, 0.0, 0.0, None)
    taken = np.eye(n) - without_motions(sums, columns_of(arm, terms)).gram
    size, vectors = np.linalg.eigh(taken)
    assert_allclose(size, size > 0.5, atol=1e-12)  # a projection
    out = vectors[:, size > 0.5]
    moved = (columns_of(arm, terms).at(theta)[:, :, 2:] @ out).reshape(180, -1)
    points, one = arm.forward(theta), np.ones((60, 1))
    motions = [np.kron(one, e[:, None]) for e in np.eye(3)]
    motions += [np.cross(e, points).reshape(-1, 1) for e in np.eye(3)]
    motions = np.column_stack([*motions, points.ravel()])
    motions /= np.linalg.norm(motions, axis=0)
    left = moved - motions @ np.linalg.lstsq(motions, moved, rcond=None)[0]
    assert np.abs(left).max() < 1e-9 * np.abs(moved).max()
    assert np.linalg.matrix_rank(moved, tol=1e-9 * np.linalg.norm(moved)) == 7
