"""The choice of lines and of the field by evidence, against normal densities of SciPy."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_raacmm.inference import Problem
from sklearn_raacmm.inference._linear import _Leftover, pair_columns


def test_a_line_raises_the_evidence_by_more_than_its_price(toys):
    toy = toys.drawn(0)
    found = toy.problem.search()
    v, noise = found.variance, found.noise_variance
    assert_array_equal(found.lines, [2, 5])
    whole = toys.evidence_of_lines(toy, found.lines, v, noise)
    for other in set(range(12)) - {2, 5}:
        assert toys.evidence_of_lines(toy, [2, 5, other], v, noise) - whole < np.log(12)
    assert np.all(found.gains > np.log(12))
    assert toy.problem.net_evidence(found) == found.log_evidence - 2 * np.log(12)
    once = toy.problem.search_at(found)
    assert_array_equal(once.lines, [2, 5])
    assert_allclose(once.coef, found.coef)


def test_a_choice_of_more_data_loses_what_is_needless_and_takes_what_is_missing(toys):
    toy = toys.drawn(3)
    found = toy.problem.search()
    assert found.lines.tolist() == [2, 5]
    other = found._replace(lines=np.array([2, 7]), pairs=np.array([2, 7]))
    assert toy.problem.search_at(other).lines.tolist() == [2, 5]


@pytest.mark.parametrize("price", [0.0, 1e9])
def test_a_price_decides(toys, price):
    toy = toys.drawn(0)
    found = Problem(toy.problem.sums, toys.structures(4, 12, price)).search()
    assert {2, 5} <= set(found.lines.tolist()) if price == 0 else len(found.lines) == 0


def test_all_of_several_that_are_repeated_are_found_once(toys):
    """As at angles on a coarse grid, where the waves of two orders are equal."""
    rng = np.random.default_rng(1)
    H = rng.normal(size=(120, 12))
    y = H @ np.repeat([2.0, 0.0, 1.0, 0.0, 0.5, 0.0], 2) + 0.1 * rng.normal(size=120)
    sums = toys.sums_of(rng.normal(size=(120, 2)), np.column_stack([H, H]), y)
    found = Problem(sums, toys.structures(2, 12)).search()
    assert sorted(found.lines % 6) == [0, 2, 4]


def with_field(toys, seed, lines_only):
    """All pairs of 30 a little, two of them more; or those two alone."""
    rng = np.random.default_rng(seed)
    A, H = rng.normal(size=(400, 4)), rng.normal(size=(400, 60))
    w = np.zeros(60) if lines_only else rng.normal(scale=0.08, size=60)
    w[[4, 5, 10, 11]] = [1.0, -0.5, 0.3, 0.8]
    y = A @ (0.3 * rng.normal(size=4)) + H @ w + rng.normal(size=400)
    share = np.linspace(1.0, 0.4, 30)
    share[7] = 0.0  # offered as a line only
    problem = Problem(toys.sums_of(A, H, y), toys.structures(4, 30, share=share))
    lines = problem.search()
    return (
        SimpleNamespace(A=A, H=H, y=y),
        share,
        lines,
        problem.with_field_if_worth(lines, problem, lines),
    )


def test_the_field_has_the_evidence_of_its_own_prior(toys):
    toy, share, lines, found = with_field(toys, 0, lines_only=False)
    assert {2, 5} <= set(found.lines.tolist())
    assert_array_equal(found.pairs, np.flatnonzero(share > 0))
    v, noise = found.variance, found.noise_variance

    def evidence(of_field, chosen, v, noise):
        of_pairs = np.where(np.isin(np.arange(30), chosen), v[1], 0.0) + of_field * share
        of_noise = -1.5 * np.log(noise) - 0.5 * 0.03 * np.mean(toy.y**2) / noise
        return toys.log_evidence(toy, (v[0], of_pairs), noise) + of_noise

    alone = evidence(0.0, lines.lines, lines.variance, lines.noise_variance)
    rise = evidence(v[2], found.lines, v, noise) - alone
    assert rise - (len(found.lines) - len(lines.lines)) * np.log(30) > 16
    assert found.log_evidence - lines.log_evidence == pytest.approx(rise, abs=1e-6)
    best = evidence(v[2], found.lines, v, noise)
    for factor in (0.6, 1.6):
        assert evidence(factor * v[2], found.lines, v, noise) < best
    of_pairs = np.where(np.isin(found.pairs, found.lines), v[1], 0.0) + v[2] * share[found.pairs]
    prior = np.r_[np.full(4, v[0]), np.repeat(of_pairs, 2)]
    columns = np.column_stack([toy.A, toy.H[:, pair_columns(found.pairs)]])
    precision = columns.T @ columns / noise + np.diag(1 / prior)
    assert_allclose(found.coef, np.linalg.solve(precision, columns.T @ toy.y / noise), rtol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_no_field_where_there_are_lines_only(toys, seed):
    assert not with_field(toys, seed, lines_only=True)[-1].with_field


@pytest.mark.parametrize("chosen", [(), (3,), (1, 4)])
def test_gains_of_candidates_are_those_of_the_evidence(toys, chosen):
    """Of a pair beside others and chosen pairs: the log ratio of two normal densities of y."""
    rng = np.random.default_rng(len(chosen))
    A = rng.normal(size=(60, 4))
    H = rng.normal(size=(60, 10)) + A[:, :1] + 0.5 * rng.normal(size=(60, 1))
    y = H[:, :4] @ [0.5, -0.3, 0.2, 0.4] + 0.3 * rng.normal(size=60)
    toy = SimpleNamespace(A=A, H=H, y=y)
    problem = Problem(toys.sums_of(A, H, y), toys.structures(4, 5))
    variance, noise = np.array([0.7, 0.4, 0.1]), 0.09
    state = problem.state(np.array(chosen, dtype=int), False, variance, noise)
    left = _Leftover(problem, state)
    gain, sound = left.gains()

    def evidence(pairs):
        return toys.evidence_of_lines(toy, pairs, variance, noise)

    free = [p for p in range(5) if p not in chosen]
    expected = [evidence([*chosen, p]) - evidence(chosen) for p in free]
    assert left.free.tolist() == free
    assert sound.all()
    assert_allclose(gain, expected, rtol=1e-9, atol=1e-9)
    # The same by taking the pairs one after another.
    step = _Leftover(problem, problem.state(np.array([], dtype=int), False, variance, noise))
    for pair in chosen:
        step.take(pair, ())
    assert_allclose(step.gains()[0][free], gain, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("field", [False, True])
def test_a_state_without_needless_lines_is_that_of_the_others(toys, field):
    """Taken from the posterior of all, and found anew from the equations of the lines left."""
    rng = np.random.default_rng(4)
    A, H = rng.normal(size=(90, 4)), rng.normal(size=(90, 20))
    H[:, 6:8] = H[:, 4:6] + 1e-3 * rng.normal(size=(90, 2))  # pair 3 says what pair 2 does
    y = A[:, 0] + H[:, 4:8] @ [1.0, 0.5, 1.0, 0.5] + 0.3 * rng.normal(size=90)
    share = np.linspace(1.0, 0.2, 10)
    share[[2, 7]] = 0.0  # these are out where they are no lines
    problem = Problem(toys.sums_of(A, H, y), toys.structures(4, 10, share=share))
    variance, lines = np.array([0.7, 0.4, 0.01]), np.array([2, 3, 5, 7, 8])
    found = problem._pruned(problem.state(lines, field, variance, 0.09))
    assert 0 < len(found.lines) < 5
    anew = problem.with_lines(found, found.lines)
    assert_array_equal(found.pairs, anew.pairs)
    assert found.log_evidence == pytest.approx(anew.log_evidence, abs=1e-9)
    for name in ("coef", "prior", "determined"):
        assert_allclose(getattr(found, name), getattr(anew, name), rtol=1e-9, atol=1e-12)
    covariances = (one.half @ one.half.T for one in (found, anew))
    assert_allclose(*covariances, rtol=1e-9, atol=1e-12)
