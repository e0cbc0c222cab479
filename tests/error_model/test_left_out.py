"""How sure the linear model is: what a single-point test can show, and intervals that hold.

Intervals against errors that were drawn, and SciPy's own fit.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm as normal, t as student

from sklearn_raacmm import ArmResidualRegressor
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.error_model import Fading, Terms, interval_scales
from sklearn_raacmm.error_model._columns import columns_of
from sklearn_raacmm.error_model._fit import Fit
from sklearn_raacmm.error_model._left_out import (
    _blocks,
    find_fading,
    leave_out,
    with_students_quantile,
)
from sklearn_raacmm.error_model._sums import Rows
from sklearn_raacmm.utils import Groups

MACHINE = SimulatedArm("none")
LOUD = Terms(np.array([(1, 1), (2, 1), (3, 2)]), False, True, False)


def draw(seed, n_positions=16, n_poses=15):
    """An arm, its poses, and errors of which the model holds all causes; two thirds to train."""
    test = make_single_point(n_positions, n_poses, machine=MACHINE, random_state=seed)
    rng = np.random.default_rng(seed)
    columns = columns_of(test.arm, LOUD).at(test.data)
    w = rng.normal(0, 4, columns.shape[2])
    w[:6] = rng.choice([-1, 1], 6) * rng.uniform(8, 16, 6)
    truth = columns @ w
    train = np.isin(test.groups, rng.permutation(n_positions)[: n_positions * 2 // 3])
    return test, truth, truth + rng.normal(0, 0.01, truth.shape), train


def without_motion(field, points, groups, train):
    """A field less the similarity that fits it best at the positions' means of the training rows.

    Independent of the model: translation, turn and scale of the mean points, by least squares.
    """

    def motions(p):
        q = p - centre
        turns = np.stack([np.cross(axis, q) for axis in np.eye(3)], axis=2)
        shifts = np.broadcast_to(np.eye(3), (len(p), 3, 3))
        return np.concatenate([shifts, turns, q[:, :, None]], axis=2)

    labels = np.unique(groups[train])
    mean_points = np.stack([points[groups == i].mean(axis=0) for i in labels])
    mean_field = np.stack([field[groups == i].mean(axis=0) for i in labels])
    centre = mean_points.mean(axis=0)
    found = np.linalg.lstsq(motions(mean_points).reshape(-1, 7), mean_field.ravel(), rcond=None)[0]
    return field - motions(points) @ found


@pytest.mark.filterwarnings("ignore:y are not the deviations")  # they are drawn
def test_a_motion_of_the_base_is_no_uncertainty():
    """It is most of the posterior of a single-point test, and none of what the test can show."""
    test, _, y, _ = draw(3)
    model = ArmResidualRegressor(test.arm, orders=2, causes=["kinematics"])
    linear = model.fit(test.data, Groups(test.groups).centred(y), groups=test.groups).linear_model_
    columns = linear.columns(test.data)
    whole = np.sqrt(np.square(columns @ linear.half).sum(axis=2))
    assert linear.predict(test.data, return_std=True)[1].mean() < 0.5 * whole.mean()
    # One draw of the posterior at a time, its motion fitted and taken out by hand: that of poses
    # anywhere in the ranges of the joints.
    rng = np.random.default_rng(0)
    low, high = test.data.min(axis=0), test.data.max(axis=0)
    poses = np.vstack([test.data, rng.uniform(low, high, (400, 6))])
    columns, points = linear.columns(poses), test.arm.forward(poses)
    anywhere = np.arange(len(poses)) >= len(test.data)
    draws = [
        without_motion(columns @ linear.half @ rng.normal(size=linear.half.shape[1]), points,
                       np.arange(len(poses)), anywhere)[~anywhere]
        for _ in range(200)
    ]  # fmt: skip
    std = linear.predict(test.data, return_std=True)[1]
    assert_allclose(np.std(draws, axis=0).mean(), std.mean(), rtol=0.05)


@pytest.mark.parametrize("single_point", [False, True])
def test_models_without_a_block_are_those_of_a_fit_without_it(single_point):
    """Against ridge regression on the other rows in closed form, at the variances of the whole."""
    test, _, y, _ = draw(1)
    y = Groups(test.groups).centred(y) if single_point else y
    weights = np.random.default_rng(0).uniform(0.5, 2, len(y))
    rows = Rows(test.arm, test.data, y, weights, test.groups if single_point else None)
    terms = Terms(np.empty((0, 2), int), False, True, False)
    fitted = Fit(rows, columns_of(test.arm, terms), with_field=False)
    correction, doubt, deviations = leave_out(fitted, test.groups)
    model = fitted.model
    blocks = _blocks(test.arm.forward(test.data), test.groups, weights)
    assert len(np.unique(blocks)) == 10
    columns = model.columns(test.data)
    robust = weights * fitted.pose_weight
    for block in range(10):
        of, other = blocks == block, blocks != block
        assert not set(test.groups[of]) & set(test.groups[other])
        white = np.sqrt(robust)[:, None, None] * fitted.rows.root
        A = (white @ columns)[other].reshape(-1, columns.shape[2]) / model.noise_sd
        z = (white @ y[:, :, None])[other].ravel() / model.noise_sd
        if single_point:  # three constants of each position, whitened as its rows are
            own = test.groups[other][:, None] == np.unique(test.groups[other])
            dummies = np.einsum("ncd,ng->ncgd", white[other], own).reshape(len(z), -1)
            Q = np.linalg.qr(dummies)[0]
            A, z = A - Q @ (Q.T @ A), z - Q @ (Q.T @ z)
        prior = model.prior_sd["kinematics"]
        covariance = np.linalg.inv(A.T @ A + np.eye(A.shape[1]) / prior**2)
        errors = y[of] - columns[of] @ (covariance @ A.T @ z)
        if single_point:
            # The scale is held in the model and at its prior here: a position does not show it.
            codes = np.unique(test.groups[of], return_inverse=True)[1]
            left = Groups(codes).centred(y[of] - correction[of], weights[of])
            assert_allclose(left, Groups(codes).centred(errors, weights[of]), atol=2e-5)
            continue
        assert_allclose(correction[of], y[of] - errors, atol=1e-8)
        spread = np.sqrt(np.einsum("ncp,pq,ncq->nc", columns[of], covariance, columns[of]))
        assert_allclose(doubt[of], np.linalg.norm(spread, axis=1), rtol=1e-6)
        assert_allclose(deviations[of], spread, rtol=1e-6)


def test_fading_is_wieners_factor():
    doubt = np.array([0.0, 0.05, 0.5])
    assert_allclose(Fading(0.1, 2.0).share(doubt), [1, 0.5, 1 / 101])
    assert_array_equal(Fading(0.1, 0.0).share(doubt), 1)
    # Nothing fades where poses have shown so.
    fading = Fading(size_mm=1.0, factor=2.0, known_mm=0.5, most=0.8)
    shares = [0.8, 0.8, 0.8 / (1 + 4 * (1.5**2 - 0.5**2))]
    assert_allclose(fading.share(np.array([0.0, 0.5, 1.5])), shares)
    assert fading.share(np.array([1e6]))[0] < 1e-9
    # Near the data it is another share than far away, and between them at the doubt that is named.
    fading = Fading(size_mm=1e9, factor=1.0, most=0.8, far=0.5, near_mm=0.1)
    assert_allclose(fading.share(np.array([0.0, 0.1, 10.0])), [0.8, 0.6, 0.4], rtol=1e-7)
    y, weights = np.full((3, 3), 0.1), np.ones(3)

    def fading_of(factor, widening):
        return find_fading(y, weights, factor, widening, lambda values, _: values)

    assert fading_of("auto", np.inf) == Fading(pytest.approx(0.1 * np.sqrt(3)), 1.0)
    assert fading_of("auto", 1.5).factor == pytest.approx(0.45)
    assert fading_of("auto", 4.0).factor == 1.0
    assert fading_of(0.3, 1.6).factor == 0.3


def test_of_fewer_than_four_positions_nothing_is_known_of_errors_elsewhere():
    rng = np.random.default_rng(0)
    angles, places = rng.uniform(-1, 1, (40, 6)), np.arange(40)
    y = MACHINE.nominal_arm.jacobian(angles)[:, :, 1] * 1e-4 + rng.normal(0, 0.005, (40, 3))
    model = ArmResidualRegressor(MACHINE.nominal_arm, orders=2, offsets=False)
    assert model.fit(angles, y, groups=places % 3).fading_.factor == 1.0
    for n in (4, 40):
        model.fit(angles, y, groups=places % n)
        # Intervals are found once more for the share that is used, and then widened by Student's
        # quantile, which what fades does not know.
        wider = student.ppf(0.975, 3 * (n - 1)) / normal.ppf(0.975)
        expected = min(0.3 * model.linear_model_.std_scale / wider, 1.0)
        assert model.fading_.factor == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("n_positions", [4, 10])
def test_intervals_bear_that_few_positions_say_how_wide_they_are(n_positions):
    """Errors at a new position, by the scale of those at few, all drawn: 95 % are inside."""
    rng = np.random.default_rng(0)
    errors = rng.normal(size=(20000, n_positions, 3))
    errors -= errors.mean(axis=1, keepdims=True)
    scale = np.sqrt(np.square(errors).sum(axis=(1, 2)) / (3 * (n_positions - 1)))
    test, _, y, _ = draw(0, n_positions=3)
    model = ArmResidualRegressor(test.arm, orders=1).fit(test.data, y, groups=test.groups)
    linear = replace(model.linear_model_, n_positions=float(n_positions), std_scale=1.0)
    wider = with_students_quantile(linear)
    assert wider.noise_scale == linear.noise_scale
    new = np.abs(rng.normal(size=20000))
    assert np.mean(new < 1.96 * wider.std_scale * scale) == pytest.approx(0.95, abs=0.004)
    assert np.mean(new < 1.96 * scale) < 0.945  # the normal quantile holds fewer
    assert with_students_quantile(replace(linear, n_positions=3.0)).std_scale == 1.0


@pytest.mark.parametrize("freedom", [3, 100])
def test_scales_are_found(freedom):
    """Errors of known scales, drawn: intervals of 95 % hold 95 % of them."""
    rng = np.random.default_rng(0)
    noise, std = np.full((3000, 3), 0.01), rng.uniform(0.001, 0.03, (3000, 3))
    scale = np.sqrt(0.5 * noise**2 + 6.0 * std**2)
    errors = scale * rng.standard_t(freedom, (3000, 3))
    of_noise, of_std = interval_scales(errors, noise, std, np.ones(3000))
    width = np.sqrt((of_noise * noise) ** 2 + (of_std * std) ** 2)
    assert np.mean(np.abs(errors) < 1.96 * width) == pytest.approx(0.95, abs=0.01)
    assert of_std / of_noise == pytest.approx(np.sqrt(12), rel=0.3)
    once = interval_scales(errors[:500], noise[:500], std[:500], np.full(500, 2.0))
    twice = np.r_[0:500, 0:500]
    again = interval_scales(errors[twice], noise[twice], std[twice], np.ones(1000))
    assert_allclose(once, again, rtol=1e-2)


def test_rounding_in_a_position_of_one_pose_says_nothing_of_intervals():
    rng = np.random.default_rng(0)
    noise, std, ones = np.full((60, 3), 0.01), np.full((60, 3), 0.02), np.ones(60)
    errors = rng.normal(scale=0.03, size=(60, 3))
    noise[-1], std[-1], errors[-1] = 1e-10, 1e-16, 1e-17
    found = interval_scales(errors, noise, std, ones, 0.3, 0.7)
    without = interval_scales(*(values[:-1] for values in (errors, noise, std, ones)), 0.3, 0.7)
    assert_allclose(found, without, rtol=1e-7)


def test_prior_of_the_scale_gives_way_to_what_is_shown():
    """Deviations that noise hides leave the factor at its prior; clear ones find their own."""
    rng = np.random.default_rng(0)
    noise, std, ones = np.full((900, 3), 0.01), np.full((900, 3), 0.001), np.ones(900)
    errors = rng.normal(scale=0.01, size=(900, 3))
    of_noise, hidden = interval_scales(errors, noise, std, ones, 0.05, 0.7)
    assert of_noise == pytest.approx(1.0, abs=0.1)
    assert hidden / of_noise == pytest.approx(np.exp(0.35), rel=0.1)
    errors = rng.normal(scale=0.01, size=(900, 3))
    _, shown = interval_scales(errors, noise / 1000, 2 * noise, ones, 0.5, 0.7)
    assert shown == pytest.approx(0.5, rel=0.1)


def test_scale_and_tails_are_those_that_scipy_fits():
    """Noise alone: the factor is that of the most likely Student variable, found by SciPy."""
    errors = 0.02 * np.random.default_rng(0).standard_t(5, (1500, 3))
    freedom, _, scale = student.fit(errors.ravel(), floc=0)
    noise = np.full(errors.shape, 0.01)
    found, _ = interval_scales(errors, noise, np.zeros(errors.shape), np.ones(1500))
    # The prior pulls a little towards normal errors.
    width = student.ppf(0.975, freedom) / normal.ppf(0.975) * scale
    assert 0.01 * found == pytest.approx(width, rel=0.01)
