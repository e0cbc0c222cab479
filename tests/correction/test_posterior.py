"""Coefficients conditioned on new rows, and score tests, against normal distributions."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from scipy.special import betainc
from scipy.stats import chi2, kstest, multivariate_normal, ncx2

from sklearn_raacmm.correction._posterior import (
    Evidence,
    ModelWhitening,
    Posterior,
    narrowed,
    score_tests,
)

N_FREE = 2
M = 24
MANY = [(1e7, 1.0), (1e7, 1.0)]  # independent errors from which the size of the covariance is known
FEW = [(30, 1.0), (10, 1.5)]


def problem(n=30, seed=0, changed=0.5, noise_sd=0.05):
    """Rows of three coordinates, five columns in two parts, of which the second has changed."""
    rng = np.random.default_rng(seed)
    columns, free = rng.normal(size=(n, 3, 5)), rng.normal(size=(n, 3, N_FREE))
    mean, half = rng.normal(size=5), 0.02 * rng.normal(size=(5, 4))
    prior = SimpleNamespace(coef=mean, half=half, noise_variance=0.04**2)
    changes = np.array(["a", "a", "b", "b", "b"], dtype=object), rng.uniform(0.5, 2, 5)
    change = np.r_[np.zeros(2), changed * rng.normal(size=3)]
    y = columns @ (mean + change) + 5.0 * free @ rng.normal(size=N_FREE)
    y += rng.normal(0, noise_sd, y.shape)
    return prior, changes, columns, 5.0 * free, y, np.ones(n), (-1.0, 4.0)


def condition(prior, changes, columns, free, y, weights, log_noise, start=None):
    shown = SimpleNamespace(y=y, weights=weights, rank=np.full(len(y), 3), n_unknown=0)
    return Posterior(prior, changes, shown, columns, free, log_noise, start)


def of_definition(prior, changes, columns, free, y, weights, _, tau, noise_sd):
    """Mean and covariance of all coefficients, from their joint normal distribution with y."""
    n_columns, n_free = columns.shape[2], free.shape[2]
    tau = np.array([tau[name] for name in changes[0]])
    P = np.zeros((n_columns + n_free,) * 2)
    P[:n_columns, :n_columns] = prior.half @ prior.half.T + np.diag((tau * changes[1]) ** 2)
    P[n_columns:, n_columns:] = np.eye(n_free)
    mean = np.r_[prior.coef, np.zeros(n_free)]
    kept = weights > 0
    A = np.concatenate([columns, free], axis=2)[kept].reshape(-1, len(P))
    noise = noise_sd**2 / np.repeat(weights[kept], y.shape[1])
    S = A @ P @ A.T + np.diag(noise)
    gain = np.linalg.solve(S, A @ P).T
    return mean + gain @ (y[kept].ravel() - A @ mean), P - gain @ A @ P, (A @ mean, S)


@pytest.mark.parametrize("n", [2, 30])
def test_posterior_is_that_of_the_joint_normal_distribution(n):
    """Of fewer and of more coordinates than columns, which are summed up."""
    given = problem(n)
    after = condition(*given)
    mean, covariance, _ = of_definition(*given, after.tau, after.noise_sd)
    assert_allclose(after.mean, mean, rtol=1e-7, atol=1e-9)
    assert_allclose(after.half @ after.half.T, covariance, rtol=1e-7, atol=1e-9)
    assert after.half.shape[1] <= len(mean)


def test_the_search_ends_at_the_same_place_from_another_start():
    given = problem()
    whole, fewer = condition(*given), condition(*problem(seed=0, n=24))
    assert fewer.logs.shape == whole.logs.shape
    found = condition(*given, start=fewer.logs)
    assert_allclose(found.mean, whole.mean, atol=1e-4 * np.abs(whole.mean).max())
    assert found.noise_sd == pytest.approx(whole.noise_sd, rel=1e-3)


@pytest.mark.parametrize("n", [2, 30])
def test_taus_and_noise_have_the_highest_posterior(n):
    """As high as another optimiser finds; on a flat ridge the places may differ."""
    given = problem(n)
    y, log_noise = given[4], given[6]
    after = condition(*given)

    def negative(logs):
        tau, noise_sd = dict(zip("ab", np.exp(logs[:2]), strict=True)), 0.04 * np.exp(logs[2])
        _, _, (expected, S) = of_definition(*given, tau, noise_sd)
        likelihood = multivariate_normal(expected, S).logpdf(y.ravel())
        # Medians 0.1 with a factor of 4.5, and 1 with a factor of e.
        z = np.r_[(logs[:2] - np.log(0.1)) / 1.5, logs[2]]
        return 0.5 * z @ z - likelihood

    bounds = [(-7, 0), (-7, 0), log_noise]
    best = minimize(negative, [-2.3, -2.3, 0.1], bounds=bounds, tol=1e-12).x
    found = np.log([after.tau["a"], after.tau["b"], after.noise_sd / 0.04])
    assert negative(found) < negative(best) + 1e-5


def test_rows_of_weight_zero_are_not_there():
    prior, changes, *rows, log_noise = problem()
    rows[3][::3] = 0
    rows[2][::3] = 100
    after = condition(prior, changes, *rows, log_noise)
    kept = rows[3] > 0
    same = condition(prior, changes, *(part[kept] for part in rows), log_noise)
    assert_allclose(after.mean, same.mean, rtol=1e-9)
    assert_allclose(after.left_out()[0], same.left_out()[0], rtol=1e-9)


def test_a_row_far_from_the_posterior_counts_for_nothing():
    *given, y, weights, log_noise = problem()
    clean = condition(*given, y, weights, log_noise)
    y = y.copy()
    y[[4, 9]] += [[2.0, 0, 0], [0, 3.0, 0]]
    after = condition(*given, y, weights, log_noise)
    assert_allclose(after.row_weight[[4, 9]], 0, atol=1e-3)
    assert_allclose(after.mean, clean.mean, atol=0.05)
    # A row far from the prior alone is the change.
    assert_allclose(clean.row_weight, 1)


def test_rows_left_out_are_those_of_a_fit_without_them():
    given = problem(12)
    _, _, columns, free, y, weights, _ = given
    after = condition(*given)
    A = np.concatenate([columns, free], axis=2)
    errors, noise, std = after.left_out()
    for row in (0, 7):
        others = weights.copy()
        others[row] = 0
        mean, covariance, _ = of_definition(*given[:5], others, given[6], after.tau, after.noise_sd)
        assert_allclose(errors[row], y[row] - A[row] @ mean, rtol=1e-6)
        variance = np.diag(A[row] @ covariance @ A[row].T)
        assert_allclose(std[row], np.sqrt(variance), rtol=1e-6)
    assert_allclose(noise, after.noise_sd)


def test_noise_stays_within_its_bounds():
    given = problem(noise_sd=0.001)
    free = condition(*given)
    assert free.noise_sd == pytest.approx(0.04 * np.exp(-1))
    held = condition(*given[:-1], (0.0, 4.0))
    assert held.noise_sd == pytest.approx(0.04)


def test_narrowed_is_the_inverse_of_summed_precisions():
    rng = np.random.default_rng(0)
    half, rows = rng.normal(size=(4, 4)), rng.normal(size=(7, 4))
    after = narrowed(half, rows @ half)
    expected = np.linalg.inv(np.linalg.inv(half @ half.T) + rows.T @ rows)
    assert_allclose(after @ after.T, expected, rtol=1e-9)


@pytest.mark.parametrize("k", [3, 12])
def test_log_evidence_is_that_of_scipy(k):
    """Of three more coordinates, which hold noise alone, y has summed up what is 0 of them."""
    rng = np.random.default_rng(0)
    y, seen = rng.normal(size=8), rng.normal(size=(8, k))
    covariance = np.pad(seen @ seen.T, (0, 3)) + 0.3**2 * np.eye(11)
    expected = multivariate_normal(np.zeros(11), covariance).logpdf(np.pad(y, (0, 3)))
    nothing = np.zeros(0), np.zeros(0)
    found = Evidence(nothing, seen, seen, y, 0.3**2, 11, (0.0, 0.0))(np.zeros(1))[0]
    assert -found == pytest.approx(expected + 5.5 * np.log(2 * np.pi))


@pytest.fixture(scope="module")
def drawn():
    """Columns that the model leaves open, nuisances, causes, and draws if nothing is wrong."""
    rng = np.random.default_rng(0)
    known = 3 * rng.normal(size=(M, 8))
    nuisance = rng.normal(size=(M, 4))
    causes = {"one": rng.normal(size=(M, 1)), "three": rng.normal(size=(M, 3))}
    left = known @ rng.normal(size=(8, 1500)) + rng.normal(size=(M, 1500))
    return known, nuisance, causes, left + nuisance @ rng.normal(0, 100, (4, 1500))


def test_statistics_are_chi_squared_whatever_the_nuisances_are(drawn):
    known, nuisance, causes, left = drawn
    whiten = ModelWhitening(known, nuisance, M)
    tests = [score_tests(causes, whiten, one, MANY) for one in left.T]
    assert tests[0]["cause"].tolist() == ["noise", "one", "three"]
    assert tests[0]["freedom"].tolist() == [M - 4, 1, 3]
    for i in range(3):
        p_values = [one["p_value"][i] for one in tests]
        assert kstest(p_values, "uniform").pvalue > 0.01
        of_few = score_tests(causes, whiten, left[:, i], FEW)[i]
        few, factor = FEW[min(i, 1)]
        share = few / (few + of_few["statistic"] / factor)
        assert_allclose(of_few["p_value"], betainc(few / 2, of_few["freedom"] / 2, share))


def test_a_cause_that_is_there_is_found_as_often_as_the_textbook_says(drawn):
    known, nuisance, causes, left = drawn
    whiten = ModelWhitening(known, nuisance, M)
    size = 3 / np.linalg.norm(whiten(causes["one"]))
    moved = left + size * causes["one"]
    found = [score_tests(causes, whiten, one, MANY)["p_value"][1] < 0.01 for one in moved.T]
    expected = ncx2.sf(chi2.isf(0.01, 1), 1, 9)
    assert np.mean(found) == pytest.approx(expected, abs=3 * np.sqrt(0.25 / 1500))


def test_the_statistic_is_what_least_squares_explains(drawn):
    """The fall of the sum of squares when the cause is fitted beside the nuisances."""
    known, nuisance, causes, left = drawn
    root = np.linalg.cholesky(np.eye(M) + known @ known.T)
    y = np.linalg.solve(root, left[:, 0])
    sums = []
    for columns in (nuisance, np.hstack([nuisance, causes["three"]])):
        A = np.linalg.solve(root, columns)
        sums.append(np.sum((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2))
    tests = score_tests(causes, ModelWhitening(known, nuisance, M), left[:, 0], MANY)
    assert tests["statistic"][0] == pytest.approx(sums[0])
    assert tests["statistic"][2] == pytest.approx(sums[0] - sums[1])


def test_what_the_nuisances_take_up_is_not_tested(drawn):
    known, nuisance, causes, left = drawn
    hidden = {"hidden": nuisance[:, :1] - nuisance[:, 2:3], "nothing": np.zeros((M, 1))}
    half = {"half": np.hstack([nuisance[:, :1], causes["one"]])}
    tests = score_tests(hidden | half, ModelWhitening(known, nuisance, M), left[:, 0], MANY)
    assert tests["cause"].tolist() == ["noise", "half"]
    assert tests["freedom"].tolist() == [M - 4, 1]


def test_the_root_is_that_of_the_covariance(drawn):
    known, _, _, left = drawn
    whiten = ModelWhitening(known, np.empty((M, 0)), M)
    covariance = np.eye(M) + known @ known.T
    assert_allclose(
        whiten(left).T @ whiten(left), left.T @ np.linalg.solve(covariance, left), atol=1e-6
    )
    assert whiten.log_root == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1])


def test_repeated_nuisances_are_counted_once(drawn):
    known, nuisance, _, left = drawn
    twice = ModelWhitening(known, np.hstack([nuisance, nuisance[:, ::-1]]), M)
    assert twice.freedom == M - 4
    assert_allclose(twice(left), ModelWhitening(known, nuisance, M)(left), atol=1e-8)
    assert ModelWhitening(known, np.empty((M, 0)), M).freedom == M
