"""Sums of all orders at once, the choice of harmonics by evidence, and which orders are offered."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

from sklearn_raacmm import Arm, ArmResidualRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.error_model import (
    LinearOptions,
    _order_scan,
    fit_linear_model,
)
from sklearn_raacmm.error_model._columns import ARCSEC, Terms, term_columns
from sklearn_raacmm.error_model._harmonic_selection import refit, select_harmonics
from sklearn_raacmm.error_model._order_scan import (
    CandidateSums,
    candidate_sums,
    columns_of,
    sums_of_both,
    sums_of_pairs,
    sums_of_the_others,
    sums_with_other_weights,
)
from sklearn_raacmm.error_model._orders import offered_harmonics, order_prices
from sklearn_raacmm.error_model._position_means import Lengths
from sklearn_raacmm.error_model._smooth_functions import add_smooth
from sklearn_raacmm.error_model._wave_sums import waves

ARM = Arm.from_name("aacmm6", joint_signs=[1, -1, 1, 1, -1, 1])
ALONE = {"causes": []}


def draw_angles(n, seed=0, width=2.0):
    return np.random.default_rng(seed).uniform(-width, width, (n, ARM.n_joints))


# -- sums -----------------------------------------------------------------------------------------


def explicit_sums(theta, y, weights, codes, offered, terms):
    """Gram matrix and moments from all columns, offsets taken out by dummies."""
    always = term_columns(ARM, theta, terms._replace(harmonics=np.empty((0, 2), int)))
    waves = term_columns(ARM, theta, Terms(offered, False, False, False))
    A = np.concatenate([always, waves, y[:, :, None]], axis=2)
    if codes is not None:
        dummies = np.sqrt(weights)[:, None] * (codes[:, None] == np.unique(codes))
        Q = np.linalg.qr(dummies)[0]
    gram = 0.0
    for component in range(3):
        part = np.sqrt(weights)[:, None] * A[:, component]
        if codes is not None:
            part = part - Q @ (Q.T @ part)
        gram = gram + part.T @ part
    return gram, always.shape[2]


@pytest.mark.parametrize("chunk", [1024, 7])
@pytest.mark.parametrize("with_offsets", [False, True])
@pytest.mark.parametrize("some_orders", [False, True])
def test_sums_are_those_of_all_columns(with_offsets, some_orders, chunk, monkeypatch):
    monkeypatch.setattr(_order_scan, "_CHUNK", chunk)
    rng = np.random.default_rng(3)
    n = 60
    theta, y, weights = draw_angles(n), rng.normal(size=(n, 3)), rng.uniform(0.5, 2, n)
    codes = rng.permutation(np.arange(n) % 6) if with_offsets else None
    orders = [2, 5, 300] if some_orders else range(1, 12)
    offered = np.array([(j, k) for j in (0, 2, 5) for k in orders])
    # Without kinematics nothing is taken out.
    terms = Terms(offered, True, False, True)
    found = candidate_sums(ARM, theta, y, weights, codes, offered, terms)
    gram, m = explicit_sums(theta, y, weights, codes, offered, terms)
    size = np.sqrt(gram.diagonal())
    size = np.where(size > 1e-9, size, 1.0)

    def close(found, expected, left, right):
        scale = np.outer(size[left], size[right])
        assert_allclose(found / scale, expected / scale, atol=1e-11)

    always, waves, last = slice(m), slice(m, -1), slice(-1, None)
    close(found.gram, gram[always, always], always, always)
    close(found.cross, gram[always, waves], always, waves)
    close(found.moment[:, None], gram[always, last], always, last)
    close(found.candidate_moment[:, None], gram[waves, last], waves, last)
    close(found.square, gram[last, last], last, last)
    rows = gram[waves, waves]
    i = np.arange(len(offered))
    expected = rows[2 * i, 2 * i], rows[2 * i + 1, 2 * i + 1], rows[2 * i, 2 * i + 1]
    assert_allclose(found.own, expected, atol=1e-11 * rows.max())
    asked = [4, 0, len(offered) - 1]
    columns = np.stack([np.multiply(asked, 2), np.multiply(asked, 2) + 1], axis=1).ravel()
    for _ in range(2):  # summed up, and remembered
        assert_allclose(found.rows(asked, [1, 2]), rows[columns], atol=1e-11 * rows.max())
    assert found.n_observations == pytest.approx(3 * (weights.sum() - 6 * with_offsets))


def test_sums_of_the_others_are_those_of_their_poses():
    rng = np.random.default_rng(5)
    theta, y, weights = draw_angles(80), rng.normal(size=(80, 3)), rng.uniform(0.5, 2, 80)
    codes, block = np.arange(80) // 10, np.arange(80) // 30
    offered = np.array([(j, k) for j in range(6) for k in range(1, 20)])
    terms = Terms(offered, True, True, True)

    def sums(rows):
        own = np.unique(codes[rows], return_inverse=True)[1]
        return candidate_sums(ARM, theta[rows], y[rows], weights[rows], own, offered, terms)

    for number, found in enumerate(sums_of_the_others([sums(block == i) for i in range(3)])):
        others = sums(block != number)
        for name in CandidateSums._fields[:-1]:
            expected = getattr(others, name)
            atol = 1e-10 * np.abs(expected).max()
            assert_allclose(getattr(found, name), expected, atol=atol, err_msg=name)
        for asked in ([3, 40], [40, 7]):
            assert_allclose(found.rows(asked), others.rows(asked), atol=1e-10 * others.own.max())


@pytest.mark.parametrize("with_offsets", [False, True])
def test_sums_follow_weights_that_change(with_offsets):
    """Two sums over the poses concerned, and a choice of candidates, are a sum from the start."""
    rng = np.random.default_rng(6)
    theta, y, old = draw_angles(80), rng.normal(size=(80, 3)), rng.uniform(0.5, 2, 80)
    codes = np.arange(80) // 10
    touched = codes < 3
    new = np.where(touched, rng.uniform(0.5, 2, 80), old)
    new[:10] = 0  # a whole position is lost
    offered = np.array([(j, k) for j in range(6) for k in range(1, 20)])
    terms = Terms(offered, True, True, True)

    def sums(weights, rows):
        rows = rows & (weights > 0)
        own = np.unique(codes[rows], return_inverse=True)[1] if with_offsets else None
        return candidate_sums(ARM, theta[rows], y[rows], weights[rows], own, offered, terms)

    every = np.ones(80, dtype=bool)
    found = sums_with_other_weights(sums(old, every), sums(old, touched), sums(new, touched))
    follow_weights(found, sums(new, every))
    if not with_offsets:  # sums are in proportion to the weights
        poses = theta[touched], y[touched], (new - old)[touched]
        change = candidate_sums(ARM, *poses, None, offered, terms)
        follow_weights(sums_of_both(sums(old, every), change), sums(new, every))


def follow_weights(found, expected):
    pairs = np.array([2, 50, 51])
    columns = np.stack([2 * pairs, 2 * pairs + 1], axis=1).ravel()
    assert found.n_observations == pytest.approx(expected.n_observations)
    for name in ("gram", "moment", "square"):
        value = getattr(expected, name)
        assert_allclose(getattr(found, name), value, atol=1e-10 * np.abs(value).max())
    some = sums_of_pairs(found, pairs)
    size = expected.own.max()
    assert_allclose(some.cross, expected.cross[:, columns], atol=1e-10 * np.abs(some.cross).max())
    assert_allclose(some.own, expected.own[:, pairs], atol=1e-10 * size)
    assert_allclose(some.candidate_moment, expected.candidate_moment[columns], atol=1e-9)
    for asked in ([2, 0], [0, 1]):
        rows = expected.rows(pairs[asked])[:, columns]
        assert_allclose(some.rows(asked), rows, atol=1e-10 * size)


@pytest.mark.parametrize("name", ["aacmm6", "panda"])
def test_a_single_point_test_knows_nothing_of_base_and_scale(name):
    """What is taken out moves all points as a rigid body of another size does, in seven ways."""
    arm = Arm.from_name(name, probe=(10.0, -20.0, 150.0))
    rng = np.random.default_rng(0)
    theta = rng.uniform(-2, 2, (60, arm.n_joints))
    terms = Terms(np.array([(2, 1)]), False, True, False)
    out = _order_scan._motions(arm, terms)
    moved = (term_columns(arm, theta, terms)[:, :, 2:] @ out).reshape(180, -1)
    points, one = arm.forward(theta), np.ones((60, 1))
    motions = [np.kron(one, e[:, None]) for e in np.eye(3)]
    motions += [np.cross(e, points).reshape(-1, 1) for e in np.eye(3)]
    motions = np.column_stack([*motions, points.ravel()])
    motions /= np.linalg.norm(motions, axis=0)
    left = moved - motions @ np.linalg.lstsq(motions, moved, rcond=None)[0]
    assert np.abs(left).max() < 1e-9 * np.abs(moved).max()
    assert np.linalg.matrix_rank(moved, tol=1e-9 * np.linalg.norm(moved)) == 7
    codes = np.arange(60) // 15
    y = rng.normal(size=(60, 3))
    sums = candidate_sums(arm, theta, y, np.ones(60), codes, terms.harmonics, terms)
    assert_allclose(sums.gram @ out, 0, atol=1e-12 * sums.gram.max())
    assert_allclose(sums.moment @ out, 0, atol=1e-12 * np.abs(sums.moment).max())
    assert_allclose(out.T @ sums.cross, 0, atol=1e-12 * np.abs(sums.cross).max())


# -- choice ---------------------------------------------------------------------------------------


def sums_of(A, H, y):
    """Sums of explicit columns."""
    gram = H.T @ H
    i = np.arange(H.shape[1] // 2)

    def rows(pairs, likely=(), beside=None):
        beside = np.arange(len(i)) if beside is None else beside
        return gram[np.ix_(columns_of(pairs), columns_of(beside))]

    own = np.array([gram[2 * i, 2 * i], gram[2 * i + 1, 2 * i + 1], gram[2 * i, 2 * i + 1]])
    return CandidateSums(A.T @ A, A.T @ y, A.T @ H, own, H.T @ y, y @ y, len(y), rows)


def flat_prices(n_pairs):
    return lambda chosen, beside_smooth=False: np.full(n_pairs, np.log(n_pairs))


def toy_problem(seed, n=80, n_pairs=12):
    """Pairs 2 and 5 of 12 and all four columns that are always in matter."""
    rng = np.random.default_rng(seed)
    A, H = rng.normal(size=(n, 4)), rng.normal(size=(n, 2 * n_pairs))
    w = np.zeros(2 * n_pairs)
    w[[4, 5, 10, 11]] = [1.0, -0.5, 0.3, 0.8]
    y = A @ (0.3 * rng.normal(size=4)) + H @ w + 0.5 * rng.normal(size=n)
    found = select_harmonics(
        sums_of(A, H, y), np.ones(4, int), 0, np.full(3, np.nan), flat_prices(n_pairs)
    )
    return A, H, y, found


def log_evidence(A, H, y, pairs, v, noise):
    columns = np.stack([2 * np.array(pairs, int), 2 * np.array(pairs, int) + 1], axis=1).ravel()
    cov = noise * np.eye(len(y)) + v[1] * A @ A.T + v[0] * H[:, columns] @ H[:, columns].T
    return multivariate_normal(np.zeros(len(y)), cov).logpdf(y)


def test_choice_raises_the_evidence_by_more_than_its_price():
    A, H, y, found = toy_problem(0)
    v, noise = found.prior_variance, found.noise_variance
    assert_array_equal(found.pairs, [2, 5])
    whole = log_evidence(A, H, y, found.pairs, v, noise)
    for other in set(range(12)) - {2, 5}:
        assert log_evidence(A, H, y, [2, 5, other], v, noise) - whole < np.log(12)
    # The gains are differences of log evidences.
    once = select_harmonics(
        sums_of(A, H, y), np.ones(4, int), 0, np.full(3, np.nan), flat_prices(12),
        start=(v, noise), fixed=True,
    )  # fmt: skip
    without = [log_evidence(A, H, y, [other], v, noise) for other in (5, 2)]
    assert_array_equal(once.pairs, [2, 5])
    assert_allclose(once.gains, whole - without, rtol=1e-6)
    assert_allclose(once.log_evidence - whole, found.log_evidence - whole, rtol=1e-9)


def test_evidence_is_that_of_the_normal_distribution():
    """Up to a constant, and the weak prior on the noise."""
    A, H, y, _ = toy_problem(3)
    sums, nan = sums_of(A, H, y), np.full(3, np.nan)
    values = []
    for v, noise in (([0.5, 0.1, 1.0], 0.3), ([2.0, 0.02, 1.0], 0.1)):
        one = select_harmonics(
            sums, np.ones(4, int), 0, nan, flat_prices(12), start=(np.array(v), noise), fixed=True
        )
        prior = -1.5 * np.log(noise) - 0.5 * 0.03 * np.mean(y**2) / noise
        values.append(one.log_evidence - prior - log_evidence(A, H, y, one.pairs, v, noise))
    assert values[0] == pytest.approx(values[1], abs=1e-6)


def test_variances_are_a_maximum_of_the_evidence():
    A, H, y, found = toy_problem(1)
    best = log_evidence(A, H, y, found.pairs, found.prior_variance, found.noise_variance)
    for which in range(3):
        for factor in (0.6, 1.6):
            v, noise = found.prior_variance.copy(), found.noise_variance
            if which < 2:
                v[which] *= factor
            else:
                noise *= factor
            assert log_evidence(A, H, y, found.pairs, v, noise) < best


def test_posterior_is_ridge_in_closed_form():
    A, H, y, found = toy_problem(2)
    columns = np.column_stack(
        [A, H[:, np.stack([2 * found.pairs, 2 * found.pairs + 1], 1).ravel()]]
    )
    prior = np.r_[
        np.full(4, found.prior_variance[1]), np.full(len(found.coef) - 4, found.prior_variance[0])
    ]
    precision = columns.T @ columns / found.noise_variance + np.diag(1 / prior)
    coef = np.linalg.solve(precision, columns.T @ y / found.noise_variance)
    assert_allclose(found.coef, coef, rtol=1e-8)
    covariance = np.linalg.inv(precision)
    assert_allclose(found.half @ found.half.T, covariance, rtol=1e-8, atol=1e-8 * covariance.max())
    waves = columns[:, 4:]
    again = refit(
        sums_of(A, waves, y), np.ones(4, int), 0, np.full(3, np.nan), found, np.ones(2), None,
        (found.prior_variance, found.noise_variance),
    )  # fmt: skip
    assert_allclose(again.coef, coef, rtol=0.01)


def test_known_lengths_are_rows_of_their_own_variance():
    A, H, y, _ = toy_problem(2)
    rng = np.random.default_rng(7)
    rows, errors = rng.normal(size=(5, 28)), rng.normal(size=5)
    lengths = Lengths(rows, errors, np.full(5, 0.3), np.linspace(0.1, 2.0, 5))
    found = select_harmonics(
        sums_of(A, H, y), np.ones(4, int), 0, np.full(3, np.nan), flat_prices(12), lengths
    )
    scale = np.r_[
        np.full(len(y), found.noise_variance),
        lengths.variance + found.noise_variance * lengths.share,
    ]
    waves = np.stack([2 * found.pairs, 2 * found.pairs + 1], axis=1).ravel()
    B = np.vstack([np.column_stack([A, H[:, waves]]), rows[:, np.r_[24:28, waves]]])
    B /= np.sqrt(scale)[:, None]
    prior = np.r_[np.full(4, found.prior_variance[1]), np.full(len(waves), found.prior_variance[0])]
    coef = np.linalg.solve(B.T @ B + np.diag(1 / prior), B.T @ (np.r_[y, errors] / np.sqrt(scale)))
    assert_allclose(found.coef, coef, rtol=1e-8)


def test_a_candidate_that_repeats_another_is_not_taken_twice():
    """As at angles on a coarse grid, where the waves of two orders are equal."""
    rng = np.random.default_rng(0)
    H = rng.normal(size=(60, 4))
    H = np.column_stack([H, H])
    y = H[:, :2] @ [2.0, 1.0] + 0.1 * rng.normal(size=60)
    found = select_harmonics(
        sums_of(np.empty((60, 0)), H, y), np.empty(0, int), 0, np.full(2, np.nan), flat_prices(4)
    )
    assert found.pairs.tolist() in ([0], [2])


@pytest.mark.parametrize(("n_rows", "offsets"), [(3000, True), (3000, False), (12_000, True)])
def test_evidence_does_not_run_away(n_rows, offsets):
    """It preferred an arm of no size, whose points all lie together, from 12 000 rows on."""
    d = make_single_point(n_positions=n_rows // 30, n_poses=30, random_state=0)
    y = d.target if offsets else d.points - d.simulation.true_points
    model = ArmResidualRegressor(d.arm, orders=4).fit(d.data, y, groups=d.groups)
    assert 2 < model.prior_sd_["kinematics"] < 30
    assert 30 < model.prior_sd_["gravity"] < 300
    assert model.prior_sd_["wobble"] < 5
    assert 0.002 < model.noise_sd_ < 0.006


# -- smooth functions -----------------------------------------------------------------------------


def toy_with_smooth(seed, lines):
    """All pairs of 30 a little, two of them more; or those two alone."""
    rng = np.random.default_rng(seed)
    A, H = rng.normal(size=(400, 4)), rng.normal(size=(400, 60))
    w = np.zeros(60) if lines else rng.normal(scale=0.08, size=60)
    w[[4, 5, 10, 11]] = [1.0, -0.5, 0.3, 0.8]
    y = A @ (0.3 * rng.normal(size=4)) + H @ w + rng.normal(size=400)
    shares = np.linspace(1.0, 0.4, 30)
    shares[7] = 0.0  # offered as a line only
    problem = sums_of(A, H, y), np.ones(4, int), 0, np.full(3, np.nan), flat_prices(30)
    found = select_harmonics(*problem)
    return A, H, y, shares, found, add_smooth(*problem, None, found, shares)


def test_smooth_function_has_the_evidence_of_its_own_prior():
    A, H, y, shares, lines, found = toy_with_smooth(0, lines=False)
    chosen = found.pairs[~found.smooth]
    assert {2, 5} <= set(chosen.tolist())
    assert_array_equal(found.pairs, np.flatnonzero(shares > 0))
    v, noise = found.prior_variance, found.noise_variance

    def evidence(of_smooth, pairs, v, noise):
        prior = np.where(np.isin(np.arange(30), pairs), v[0], of_smooth * shares)
        waves = np.repeat(prior, 2)
        cov = noise * np.eye(len(y)) + v[1] * A @ A.T + (H * waves) @ H.T
        of_noise = -1.5 * np.log(noise) - 0.5 * 0.03 * np.mean(y**2) / noise
        return multivariate_normal(np.zeros(len(y)), cov).logpdf(y) + of_noise

    alone = evidence(0.0, lines.pairs, lines.prior_variance, lines.noise_variance)
    rise = evidence(v[2], chosen, v, noise) - alone
    assert rise - (len(chosen) - len(lines.pairs)) * np.log(30) > 16
    assert found.log_evidence - lines.log_evidence == pytest.approx(rise, abs=1e-6)
    for factor in (0.6, 1.6):
        assert evidence(factor * v[2], chosen, v, noise) < evidence(v[2], chosen, v, noise)
    prior = np.concatenate([np.full(4, v[1]), np.repeat(np.where(found.smooth, v[2], v[0]), 2)])
    prior[4:] *= np.repeat(np.where(found.smooth, shares[found.pairs], 1.0), 2)
    columns = np.column_stack([A, H[:, np.repeat(shares > 0, 2)]])
    coef = np.linalg.solve(columns.T @ columns / noise + np.diag(1 / prior), columns.T @ y / noise)
    assert_allclose(found.coef, coef, rtol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_no_smooth_function_where_there_are_lines_only(seed):
    assert toy_with_smooth(seed, lines=True)[-1] is None


def test_a_model_is_not_sure_of_angles_where_it_has_no_poses():
    """Encoder tables of straight pieces: beside the poses, lines alone are far off and too sure."""
    rng = np.random.default_rng(1)
    knots = np.linspace(-np.pi, np.pi, 41)
    tables = np.deg2rad(rng.normal(scale=15 / 3600, size=(6, 41)))
    theta = rng.uniform(-2.5, 2.5, (500, 6))
    error = np.stack([np.interp(q, knots, t) for q, t in zip(theta.T, tables, strict=True)], axis=1)
    truth = np.einsum("nij,nj->ni", ARM.jacobian(theta), error)
    y = truth + rng.normal(scale=0.01, size=truth.shape)
    in_gap = np.any((theta > 0.4) & (theta < 0.9), axis=1)  # of any joint
    near = np.flatnonzero(~in_gap)[:80]
    train = np.setdiff1d(np.flatnonzero(~in_gap), near)
    options = LinearOptions(48, None, None, False, False, False, "auto", "squared")
    poses = theta[train], y[train], np.ones(len(train))
    model, _ = fit_linear_model(ARM, *poses, None, [], options)
    assert model.prior_sd["smooth"] > 1
    z = {}
    for name, rows in (("near", near), ("gap", np.flatnonzero(in_gap))):
        mean, std = model.predict(theta[rows], return_std=True)
        z[name] = np.sqrt(np.mean(np.square((mean - truth[rows]) / std)))
        if name == "gap":
            assert np.linalg.norm(mean - truth[rows]) < 0.8 * np.linalg.norm(truth[rows])
    assert 0.7 < z["near"] < 1.6
    assert 0.7 < z["gap"] < 1.6


# -- orders ---------------------------------------------------------------------------------------


def with_gears(n, gears, seed=0, amplitude=4.0, noise=0.01):
    """Poses and residuals of an arm whose joints err by harmonics of these orders."""
    theta = draw_angles(n, seed)
    rng = np.random.default_rng(seed + 100)
    error = np.zeros_like(theta)
    for joint, order in gears:
        error[:, joint] += np.cos(order * theta[:, joint] - rng.uniform(0, 6))
    y = ARM.forward(theta + amplitude * ARCSEC * error) - ARM.forward(theta)
    return theta, y + rng.normal(0, noise, y.shape)


def test_orders_of_gears_are_found_by_default():
    gears = [(1, 128), (3, 256), (2, 100), (1, 1)]
    theta, y = with_gears(400, gears)
    model = ArmResidualRegressor(ARM).fit(theta, y)
    found = set(map(tuple, (model.column_harmonics_ - [1, 0]).tolist()))
    # Orders 1 and 2 need no price: one of chance is among them, and next to nothing.
    assert {pair for pair in found if pair[1] > 2} | {(1, 1)} == set(gears)
    assert (1, 1) in found
    assert model.noise_sd_ == pytest.approx(0.01, rel=0.1)


def test_multiples_of_a_known_gear_are_taken_more_easily():
    """A wave too weak to be believed alone is taken where another joint has half its order."""
    weak = 1.5
    theta, y = with_gears(400, [(1, 128)], seed=1)
    error = np.zeros_like(theta)
    error[:, 3] = weak * np.cos(256 * theta[:, 3])
    y_of_both = y + ARM.forward(theta + ARCSEC * error) - ARM.forward(theta)
    _, y_alone = with_gears(400, [], seed=1)
    y_alone += ARM.forward(theta + ARCSEC * error) - ARM.forward(theta)

    def high(y):
        table = ArmResidualRegressor(ARM, **ALONE).fit(theta, y).harmonics_
        return {(j, k) for j, k in table[["joint", "order"]].tolist() if k > 72}

    assert high(y_of_both) == {(2, 128), (4, 256)}
    assert high(y_alone) == set()
    named = ArmResidualRegressor(ARM, gear_ratio=[0, 0, 0, 128, 0, 0], **ALONE)
    assert (4, 256) in named.fit(theta, y_alone).harmonics_[["joint", "order"]].tolist()
    named.set_params(gear_ratio=None, orders=[256])
    assert named.fit(theta, y_alone).harmonics_[["joint", "order"]].tolist() == [(4, 256)]


def test_offered_orders():
    theta = draw_angles(30)
    theta[:, 2] = np.arange(30) % 4
    offered, expected = offered_harmonics(theta, 50)
    assert [np.count_nonzero(offered[:, 0] == j) for j in range(6)] == [30, 30, 4, 30, 30, 30]
    assert not expected.any()
    offered, expected = offered_harmonics(theta, 3, gear_ratio=[0, 40.5, 0, 0, 2, 0])
    assert [k for j, k in offered.tolist() if j == 1] == [1, 2, 3, 81, 162]
    assert [k for j, k in offered.tolist() if j == 4] == [1, 2, 3, 4, 6, 8]
    assert offered[expected].tolist() == [[1, 81], [1, 162], [4, 2], [4, 4], [4, 6], [4, 8]]
    offered, expected = offered_harmonics(theta, 400, orders=[[1], [2, 3], [], [], [], [500]])
    assert offered.tolist() == [[0, 1], [1, 2], [1, 3], [5, 500]]
    assert expected.all()
    assert len(offered_harmonics(theta, 0)[0]) == 0


def test_prices_of_orders():
    offered = np.array([(0, k) for k in (1, 50, 80, 160, 240, 241, 400)])
    prices = order_prices(offered, np.array([False] * 6 + [True]))
    low = np.log(3)  # 1, 50 and the one that is named
    extra = np.array([0, 0, 10, 10, 10, 10, 0])
    free = np.array([0, 1, 1, 1, 1, 1, 1])  # every encoder is a little eccentric
    assert_allclose(prices(np.array([], int)), free * (low + extra))
    assert_allclose(prices(np.array([], int), beside_smooth=True), low + extra)
    assert_allclose(prices(np.array([1])), free * (low + extra))
    # 80 is half of 160, of which 240 is no multiple.
    assert_allclose(prices(np.array([3])), free * (low + extra * [1, 1, 0, 0, 1, 1, 1]))
    assert_allclose(prices(np.array([4])), free * (low + extra * [1, 1, 0, 1, 0, 1, 1]))


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"orders": [[1], [2]]}, "orders has 2 lists, but the arm has 6 joints"),
        ({"orders": [1, 2.5]}, "whole numbers of 1 or more, got 2.5 for joint 1"),
        ({"orders": [0]}, "whole numbers of 1 or more, got 0"),
        ({"gear_ratio": [100, 50]}, r"gear_ratio has shape \(2,\), but the arm has 6 joints"),
        ({"gear_ratio": [1, 1, 1, 1, 1, np.nan]}, "gear_ratio must be finite and 0 or more"),
    ],
)
def test_orders_and_ratios_are_checked(params, message):
    theta, y = with_gears(20, [])
    with pytest.raises(ValueError, match=message):
        ArmResidualRegressor(ARM, **params).fit(theta, y)


def test_high_orders_are_exact():
    """Waves by doubling against cosines and sines, at the highest order of all."""
    theta = draw_angles(500, width=6.0)[:, 0]
    found = waves(theta, np.arange(1, 1001))
    phase = np.arange(1, 1001) * theta[:, None]
    assert np.abs(found - (np.cos(phase) + 1j * np.sin(phase))).max() < 2e-12
