"""Posterior and evidence at given structures, against closed forms and SciPy's densities."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_raacmm.inference import Extra, GramRows, Problem, Structures, Sums
from sklearn_raacmm.inference._linear import pair_columns


def test_evidence_is_that_of_the_normal_distribution(toys):
    """Up to a constant, and the weak prior on the noise."""
    toy, values = toys.drawn(3), []
    for variance, noise in (([0.1, 0.5, 1.0], 0.3), ([0.02, 2.0, 1.0], 0.1)):
        lines = np.array([2, 5, 7])
        one = toy.problem.state(lines, False, np.array(variance), noise)
        prior = -1.5 * np.log(noise) - 0.5 * 0.03 * np.mean(toy.y**2) / noise
        expected = toys.evidence_of_lines(toy, lines, variance, noise)
        values.append(one.log_evidence - prior - expected)
    assert values[0] == pytest.approx(values[1], abs=1e-6)


@pytest.mark.parametrize("with_field", [False, True])
def test_posterior_is_ridge_in_closed_form(toys, with_field):
    """Also where a pair is a line and a part of the field: its prior variances add up."""
    toy = toys.drawn(2)
    share = np.linspace(1.0, 0.0, 12)
    problem = Problem(toy.problem.sums, toys.structures(4, 12, share=share))
    state = problem.state(np.array([2, 5]), with_field, np.array([0.2, 0.8, 0.05]), 0.25)
    pairs = np.arange(11) if with_field else np.array([2, 5])
    assert_array_equal(state.pairs, pairs)
    of_pairs = 0.8 * np.isin(pairs, [2, 5]) + 0.05 * with_field * share[pairs]
    prior = np.r_[np.full(4, 0.2), np.repeat(of_pairs, 2)]
    assert_allclose(state.prior, prior)
    columns = np.column_stack([toy.A, toy.H[:, pair_columns(pairs)]])
    covariance = np.linalg.inv(columns.T @ columns / 0.25 + np.diag(1 / prior))
    assert_allclose(state.coef, covariance @ columns.T @ toy.y / 0.25, rtol=1e-8)
    found = state.half @ state.half.T
    assert_allclose(found, covariance, rtol=1e-8, atol=1e-8 * covariance.max())
    # What the data determine is what they leave of the prior's doubt.
    assert_allclose(state.determined, 1 - covariance.diagonal() / prior, rtol=1e-8)


def test_variances_are_a_maximum_of_the_evidence(toys):
    toy = toys.drawn(1)
    found = toy.problem.search()
    best = toys.evidence_of_lines(toy, found.lines, found.variance, found.noise_variance)
    for which in range(3):
        for factor in (0.6, 1.6):
            variance, noise = found.variance.copy(), found.noise_variance
            if which < 2:
                variance[which] *= factor
            else:
                noise *= factor
            assert toys.evidence_of_lines(toy, found.lines, variance, noise) < best


def test_variances_that_are_given_stay(toys):
    toy = toys.drawn(1)
    structures = toy.problem.structures
    given = structures._replace(given=np.array([0.07, np.nan, np.nan]))
    assert Problem(toy.problem.sums, given).search().variance[0] == 0.07


def test_gains_are_differences_of_the_evidence(toys):
    """Of each pair beside all others, and of some columns together."""
    toy, variance, noise = toys.drawn(4), np.array([0.3, 0.6, 1.0]), 0.2
    lines = np.array([1, 2, 5])
    state = toy.problem.state(lines, False, variance, noise)
    whole = toys.evidence_of_lines(toy, lines, variance, noise)
    without = [toys.evidence_of_lines(toy, np.delete(lines, i), variance, noise) for i in range(3)]
    assert_allclose(state.gains, whole - without, rtol=1e-7)
    both = toys.evidence_of_lines(toy, lines[:1], variance, noise)
    assert state.gain_of(np.arange(6, 10)) == pytest.approx(whole - both, rel=1e-7)
    toy.A = toy.A[:, :0]
    family = toys.evidence_of_lines(toy, lines, variance, noise)
    assert state.gain_of(np.arange(4)) == pytest.approx(whole - family, rel=1e-7)


def test_other_observations_are_rows_of_their_own_variance(toys):
    toy, rng = toys.drawn(2), np.random.default_rng(7)
    rows, values = rng.normal(size=(5, 28)), rng.normal(size=5)
    extra = Extra(rows, values, np.full(5, 0.3), np.linspace(0.1, 2.0, 5))
    found = Problem(toy.problem.sums._replace(extra=extra), toy.problem.structures).search()
    own = extra.variance + found.noise_variance * extra.share
    scale = np.sqrt(np.r_[np.full(len(toy.y), found.noise_variance), own])
    waves = pair_columns(found.lines)
    B = np.vstack([np.column_stack([toy.A, toy.H[:, waves]]), rows[:, np.r_[24:28, waves]]])
    B /= scale[:, None]
    coef = np.linalg.solve(B.T @ B + np.diag(1 / found.prior), B.T @ (np.r_[toy.y, values] / scale))
    assert_allclose(found.coef, coef, rtol=1e-8)


def test_sums_of_one_gram_matrix_are_those_of_its_columns(toys):
    toy = toys.drawn(6)
    both = np.column_stack([toy.H, toy.A, toy.y])
    found, expected = Sums.of_gram(both.T @ both, 12, 80.0), toys.sums_of(toy.A, toy.H, toy.y)
    for name in ("gram", "moment", "cross", "own", "candidate_moment", "square", "n_observations"):
        assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)
    assert_allclose(found.rows([7, 0]), expected.rows([7, 0]), atol=1e-12)


def test_sums_of_some_pairs_are_those_of_their_columns(toys):
    toy, pairs = toys.drawn(6), np.array([2, 5, 11])
    rng = np.random.default_rng(1)
    extra = Extra(rng.normal(size=(2, 28)), np.ones(2), np.ones(2), np.ones(2))
    sums = toys.sums_of(toy.A, toy.H, toy.y)._replace(extra=extra)
    some = toy.H[:, pair_columns(pairs)]
    found, expected = sums.of_pairs(pairs), toys.sums_of(toy.A, some, toy.y)
    for name in ("gram", "moment", "cross", "own", "candidate_moment", "square", "n_observations"):
        assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-12)
    assert_allclose(found.rows([2, 0]), expected.rows([2, 0]), atol=1e-12)
    always = np.arange(24, 28)
    assert_array_equal(found.extra.rows, extra.rows[:, np.r_[pair_columns(pairs), always]])


def test_directions_of_rounding_are_no_information():
    """A column that is the sum of two others up to rounding, under a wide prior."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(200, 2))
    A = np.column_stack([A, A.sum(axis=1) * (1 + 1e-15 * rng.normal(size=200))])
    y = A[:, 0] + 0.1 * rng.normal(size=200)
    none = np.empty((200, 0))
    own = np.empty((3, 0))
    sums = Sums(A.T @ A, A.T @ y, A.T @ none, own, none.T @ y, y @ y, 200.0, GramRows(None, 0))
    structures = Structures(np.zeros(3, int), np.empty(0), None, 16.0, np.full(3, np.nan), 1e12)
    state = Problem(sums, structures).state(np.empty(0, int), False, np.full(3, 1e10), 0.01)
    assert np.isfinite(state.log_evidence)
    assert_allclose(A @ state.coef, A[:, :2] @ np.linalg.lstsq(A[:, :2], y)[0], atol=1e-4)
    assert np.linalg.norm(state.half @ state.half.T @ [1, 1, -1]) > 1e9  # still unknown
