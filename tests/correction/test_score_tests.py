"""Score tests of causes, against draws whose distribution is known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import betainc
from scipy.stats import chi2, kstest, ncx2

from sklearn_raacmm.correction._condition import Whitened, best_cause, score_tests

M = 24
MANY = [(1e7, 1.0), (1e7, 1.0)]  # independent errors from which the size of the covariance is known
FEW = [(30, 1.0), (10, 1.5)]


@pytest.fixture(scope="module")
def drawn():
    """Root of a covariance, nuisances, causes, and draws of what is left if nothing is wrong."""
    rng = np.random.default_rng(0)
    root = np.tril(rng.normal(size=(M, M))) + 4 * np.eye(M)
    nuisance = rng.normal(size=(M, 4))
    causes = {"one": rng.normal(size=(M, 1)), "three": rng.normal(size=(M, 3))}
    left = root @ rng.normal(size=(M, 1500)) + nuisance @ rng.normal(0, 100, (4, 1500))
    return root, nuisance, causes, left


def test_statistics_are_chi_squared_whatever_the_nuisances_are(drawn):
    root, nuisance, causes, left = drawn
    whiten = Whitened(root, nuisance)
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
    root, nuisance, causes, left = drawn
    whiten = Whitened(root, nuisance)
    size = 3 / np.linalg.norm(whiten(causes["one"]))
    moved = left + size * causes["one"]
    found = [score_tests(causes, whiten, one, MANY)["p_value"][1] < 0.01 for one in moved.T]
    expected = ncx2.sf(chi2.isf(0.01, 1), 1, 9)
    assert np.mean(found) == pytest.approx(expected, abs=3 * np.sqrt(0.25 / 1500))


def test_the_statistic_is_what_least_squares_explains(drawn):
    """The fall of the sum of squares when the cause is fitted beside the nuisances."""
    root, nuisance, causes, left = drawn
    y = np.linalg.solve(root, left[:, 0])
    sums = []
    for columns in (nuisance, np.hstack([nuisance, causes["three"]])):
        A = np.linalg.solve(root, columns)
        sums.append(np.sum((y - A @ np.linalg.lstsq(A, y, rcond=None)[0]) ** 2))
    tests = score_tests(causes, Whitened(root, nuisance), left[:, 0], MANY)
    assert tests["statistic"][0] == pytest.approx(sums[0])
    assert tests["statistic"][2] == pytest.approx(sums[0] - sums[1])


def test_what_the_nuisances_take_up_is_not_tested(drawn):
    root, nuisance, causes, left = drawn
    hidden = {"hidden": nuisance[:, :1] - nuisance[:, 2:3], "nothing": np.zeros((M, 1))}
    half = {"half": np.hstack([nuisance[:, :1], causes["one"]])}
    tests = score_tests(hidden | half, Whitened(root, nuisance), left[:, 0], MANY)
    assert tests["cause"].tolist() == ["noise", "half"]
    assert tests["freedom"].tolist() == [M - 4, 1]
    assert best_cause(score_tests(hidden, Whitened(root, nuisance), left[:, 0], MANY)) == "noise"


def test_the_best_cause_explains_what_is_too_much(drawn):
    root, nuisance, causes, left = drawn
    whiten = Whitened(root, nuisance)
    for name, columns in causes.items():
        moved = left[:, 0] + 20 * columns.sum(axis=1)
        assert best_cause(score_tests(causes, whiten, moved, MANY)) == name
    # More noise is none of the causes: "three" explains 3 of 20 directions, 0.3 of what is too much
    # in one draw of seven (chi2.sf(5.3, 3)).
    names = [best_cause(score_tests(causes, whiten, 3 * one, MANY)) for one in left[:, :200].T]
    assert np.mean(np.array(names) == "noise") > 0.75
    assert_array_equal(best_cause(score_tests({}, whiten, left[:, 0], MANY)), "noise")


def test_repeated_nuisances_are_counted_once(drawn):
    root, nuisance, _, left = drawn
    twice = Whitened(root, np.hstack([nuisance, nuisance[:, ::-1]]))
    assert twice.freedom == M - 4
    assert_allclose(twice(left), Whitened(root, nuisance)(left), atol=1e-8)
    assert Whitened(root, np.empty((M, 0))).freedom == M
