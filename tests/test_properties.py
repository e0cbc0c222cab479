"""Laws that hold for every arm, every set of points, every data: tried on many drawn at random.

Hypothesis draws them, the same ones every time.
"""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, CylindricalResidualTarget, RBFNetRegressor, cylindrical_to_cartesian
from sklearn_raacmm.metrics import (
    articulated_location_error,
    fit_sphere,
    gauge_lengths,
    single_point_repeatability,
    within_position_r2_score,
)

examples = settings(
    derandomize=True,
    max_examples=25,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],  # a matter of what else the machine does
)
few_examples = settings(examples, max_examples=10)

seeds = st.integers(0, 2**32 - 1)
angles = st.floats(-np.pi, np.pi)


def mm(limit=2000.0):
    return st.floats(-limit, limit)


def listed(numbers, size):
    return st.lists(numbers, min_size=size, max_size=size)


@st.composite
def arms(draw, n_joints=6, convention=None):
    """Any arm that has a length, also folded and flat."""
    a, d = draw(listed(mm(), n_joints)), draw(listed(mm(), n_joints))
    probe = draw(listed(mm(), 3))
    assume(max(map(abs, [*a, *d, *probe])) > 1e-6)
    return Arm(
        a=a,
        alpha=draw(listed(angles, n_joints)),
        d=d,
        theta_offset=draw(listed(angles, n_joints)),
        probe=probe,
        convention=convention or draw(st.sampled_from(["standard", "modified"])),
        joint_signs=draw(listed(st.sampled_from([-1, 1]), n_joints)),
        pose_joints=(1, 2),
        pose_frames=(0, n_joints),
    )


@st.composite
def motions(draw):
    """A rotation matrix and a shift in mm."""
    turn = Rotation.from_rotvec(draw(listed(angles, 3))).as_matrix()
    return turn, np.array(draw(listed(mm(), 3)))


@st.composite
def positions(draw, least=2):
    """Points (n, 3) in mm, of two to five positions with different numbers of points, shuffled."""
    rng = np.random.default_rng(draw(seeds))
    counts = draw(st.lists(st.integers(least, 9), min_size=2, max_size=5))
    groups = rng.permutation(np.repeat(np.arange(len(counts)), counts))
    centers = rng.uniform(-1000, 1000, (len(counts), 3))
    scatter = 10.0 ** draw(st.integers(-3, 2))
    return centers[groups] + scatter * rng.normal(size=(len(groups), 3)), groups, rng


@examples
@given(arms(), listed(angles, 6), angles)
def test_a_turn_of_the_base_turns_the_point_about_z(arm, q, turn):
    if arm.convention == "modified":  # its first axis is turned by its own twist first
        arm = arm.replace(alpha=[0.0, *arm.alpha[1:]])
        arm = arm.replace(a=[0.0, *arm.a[1:]])
    q = np.array([q, q])
    q[1, 0] += turn
    before, after = arm.forward(q)
    about_z = Rotation.from_euler("z", arm.joint_signs[0] * turn).as_matrix()
    assert_allclose(after, about_z @ before, atol=1e-8)


@examples
@given(arms(convention="standard"), listed(angles, 6))
def test_modified_parameters_of_a_standard_arm_are_those_of_the_row_before(arm, q):
    last = Rotation.from_euler("x", arm.alpha[-1]).as_matrix()
    modified = arm.replace(
        a=[0.0, *arm.a[:-1]],
        alpha=[0.0, *arm.alpha[:-1]],
        probe=last @ arm.probe + [arm.a[-1], 0, 0],
        convention="modified",
    )
    assert_allclose(modified.forward([q]), arm.forward([q]), atol=1e-8)
    assert_allclose(modified.jacobian([q]), arm.jacobian([q]), atol=1e-8)


@few_examples
@given(seeds, angles)
def test_turning_the_arm_with_its_residuals_turns_the_corrections(seed, turn):
    rng = np.random.default_rng(seed)
    azimuth = rng.uniform(-np.pi, np.pi, 40)
    shape = rng.uniform(-1, 1, (40, 2))
    y = cylindrical_to_cartesian(np.sin(shape @ rng.normal(size=(2, 3))), azimuth)
    model = CylindricalResidualTarget(RBFNetRegressor(6, length_scale=1.0, alpha=1e-3))

    def corrections(turn):
        X = np.column_stack([shape, np.cos(azimuth + turn), np.sin(azimuth + turn)])
        about_z = Rotation.from_euler("z", turn).as_matrix()
        return model.fit(X, y @ about_z.T).predict(X) @ about_z

    assert_allclose(corrections(turn), corrections(0.0), atol=1e-7)


@st.composite
def regressions(draw):
    rng = np.random.default_rng(draw(seeds))
    n, d, q = draw(st.integers(20, 60)), draw(st.integers(1, 3)), draw(st.integers(1, 3))
    X = rng.uniform(-1, 1, (n, d))
    Y = np.sin(3 * X @ rng.normal(size=(d, q))) + 0.1 * rng.normal(size=(n, q))
    return X, Y, rng


def ols(n_centers, X, Y, width=0.4, **params):
    params = {"alpha": 0.0, "degree": 0, "shared": True} | params
    return RBFNetRegressor(n_centers, length_scale=width, **params).fit(X, Y)


def unexplained(model, X, Y):
    """Share of the outputs' variance that is left, of all together, as the trace has it."""
    return np.sum(np.mean((Y - model.predict(X)) ** 2, axis=0)) / np.sum(np.var(Y, axis=0))


@examples
@given(regressions())
def test_every_centre_more_leaves_less_by_its_error_reduction(data):
    X, Y, _ = data
    models = [ols(k, X, Y) for k in range(1, 7)]
    left = [unexplained(model, X, Y) for model in models]
    assert np.all(np.diff(left) < 1e-9)
    assert_allclose(1 - np.cumsum(models[-1].error_reduction_), left, atol=1e-8)
    for fewer, more in pairwise(models):  # greedy: the same, and one more
        assert_array_equal(fewer.center_indices_, more.center_indices_[:-1])


@examples
@given(regressions(), st.floats(-6, 6), st.floats(-6, 6), mm(100))
def test_units_and_zero_do_not_matter(data, of_x, of_y, shift):
    X, Y, _ = data
    in_mm = ols(5, X, Y, alpha=1e-3)
    x_unit, y_unit = 10**of_x, 10**of_y
    other = ols(5, x_unit * (X + shift), y_unit * (Y - shift), width=0.4 * x_unit, alpha=1e-3)
    assert_array_equal(other.center_indices_, in_mm.center_indices_)
    prediction = other.predict(x_unit * (X + shift)) / y_unit + shift
    assert_allclose(prediction, in_mm.predict(X), atol=1e-6)


@examples
@given(regressions())
def test_row_order_does_not_matter(data):
    X, Y, rng = data
    order = rng.permutation(len(X))
    model, shuffled = ols(5, X, Y), ols(5, X[order], Y[order])
    assert_array_equal(order[shuffled.center_indices_], model.center_indices_)
    assert_array_equal(shuffled.coef_, model.coef_)


@few_examples
@given(regressions(), st.sampled_from(["gaussian", "matern52", "matern32", "matern12"]))
def test_a_centre_at_every_row_interpolates(data, kernel):
    X, Y, _ = data
    assume(X.shape[1] > 1)
    model = ols(len(X), X, Y, width=0.1, degree=-1, kernel=kernel)
    assert_allclose(model.predict(X), Y, atol=1e-6)


@examples
@given(positions(), motions(), st.sampled_from(["2s", "max", "mean"]))
def test_where_the_part_stands_does_not_matter(data, motion, statistic):
    points, groups, rng = data
    turn, shift = motion
    moved = points @ turn.T + shift
    options = {"statistic": statistic, "aggregate": None}
    measure = single_point_repeatability(points, groups, **options)
    assert_allclose(single_point_repeatability(moved, groups, **options), measure, atol=1e-9)
    pairs = [[0, 1]]
    length = gauge_lengths(points, groups, pairs)
    assert_allclose(gauge_lengths(moved, groups, pairs), length, atol=1e-8)
    diameter = articulated_location_error(points)
    assert_allclose(articulated_location_error(moved), diameter, atol=1e-8)
    # A correction turns, but does not shift, with the points.
    correction = rng.normal(size=points.shape)
    scatter = single_point_repeatability(points - correction, groups, **options)
    turned = single_point_repeatability(moved - correction @ turn.T, groups, **options)
    assert_allclose(turned, scatter, atol=1e-9)
    score = within_position_r2_score(points, correction, groups=groups)
    turned = within_position_r2_score(moved, correction @ turn.T, groups=groups)
    assert turned == pytest.approx(score, rel=1e-6)


@examples
@given(positions(), st.permutations(range(5)), st.floats(-3, 3))
def test_names_order_and_units_of_positions_do_not_matter(data, names, unit):
    points, groups, rng = data
    order = rng.permutation(len(points))
    measure = single_point_repeatability(points, groups)
    renamed = np.array(list("vwxyz"))[list(names)][groups]
    assert single_point_repeatability(points, renamed) == pytest.approx(measure, rel=1e-9)
    shuffled = single_point_repeatability(points[order], groups[order])
    assert shuffled == pytest.approx(measure, rel=1e-9)
    scaled = single_point_repeatability(points * 10**unit, groups)
    assert scaled == pytest.approx(measure * 10**unit, rel=1e-7)


@examples
@given(seeds, motions(), st.floats(0.5, 50))
def test_spheres_are_the_same_from_every_side(seed, motion, radius):
    directions = np.random.default_rng(seed).normal(size=(12, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rough = radius + 0.01 * np.random.default_rng(seed).uniform(-1, 1, (12, 1))
    turn, shift = motion
    points = rough * directions
    moved = points @ turn.T + shift
    assert_allclose(2 * fit_sphere(radius * directions + shift)[1], 2 * radius, atol=1e-7)
    (_, size, distances), (_, moved_size, moved_distances) = map(fit_sphere, (points, moved))
    assert_allclose(2 * moved_size, 2 * size, atol=1e-7)
    assert_allclose(np.ptp(moved_distances), np.ptp(distances), atol=1e-7)
