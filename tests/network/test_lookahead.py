"""Steps that are taken together are those that would be taken one by one."""

from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_raacmm.network import _lookahead
from sklearn_raacmm.network._candidates import HalfMatrix, SymmetricCandidates, WhitenedCandidates
from sklearn_raacmm.network._forward_selection import forward_selection, squared_ratio_score
from sklearn_raacmm.network._kernels import kernel_matrix


def views(n=120, length_scale=0.25, symmetric=False):
    """Two groups of outputs that see the same candidates with another ridge."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (n, 2))
    Y = np.column_stack([np.sin(5 * X[:, 0]), np.cos(7 * X[:, 1]), X[:, 0] * X[:, 1]])
    Y += 0.1 * rng.standard_normal(Y.shape)
    K = np.asfortranarray(kernel_matrix(X / length_scale, X / length_scale, "gaussian"))
    groups = []
    for alpha, of in ((1e-3, [0, 1]), (1e-2, [2])):
        if symmetric:
            tail = np.full((n, 1), 1 / np.sqrt(n))
            half = HalfMatrix(lambda rows, columns: K[rows][:, columns], n)
            about = Y[:, of] - Y[:, of].mean(axis=0)
            groups.append(SymmetricCandidates(half, np.ones(n), tail, about, alpha))
        else:
            root = np.linalg.cholesky(K @ K + alpha * K + 1e-10 * np.eye(n))
            groups.append(WhitenedCandidates(root, np.linalg.solve(root, K @ Y[:, of]), 1e-7))
    return groups


def one_by_one(monkeypatch, groups, n_select, **options):
    with monkeypatch.context() as patch:
        patch.setattr(_lookahead.Pool, "guess", lambda self, j, scores, room: [j])
        return forward_selection(groups, n_select, **options)


@pytest.fixture
def rounds(monkeypatch):
    """Look ahead from the first step on, and note what is guessed."""
    monkeypatch.setattr(_lookahead, "_ENTRIES_PER_READ", 1e9)
    monkeypatch.setattr(_lookahead, "_TRIALS", 1000)  # and do not give up
    guess, seen = _lookahead.Pool.guess, []

    def noted(*args):
        seen.append(guess(*args))
        return seen[-1]

    monkeypatch.setattr(_lookahead.Pool, "guess", noted)
    return seen


@pytest.mark.parametrize("symmetric", [False, True])
@pytest.mark.parametrize("score", [None, squared_ratio_score(np.array([1.0, 2.0, 0.5]))])
def test_same_choices_in_fewer_rounds(monkeypatch, rounds, symmetric, score):
    groups = views(symmetric=symmetric)
    options = {} if score is None else {"score": score}
    expected = one_by_one(monkeypatch, groups, 60, **options)
    found = forward_selection(groups, 60, **options)
    np.testing.assert_array_equal(found.indices, expected.indices)
    scale = expected.reduction.max()
    np.testing.assert_allclose(found.reduction, expected.reduction, atol=1e-10 * scale)
    assert found.stop == expected.stop == "n_select"
    assert len(rounds) < 15


def test_stops_in_the_midst_of_a_guess(monkeypatch, rounds):
    groups = views()
    reached = np.cumsum(one_by_one(monkeypatch, groups, 40).reduction, axis=0)
    for k in (1, 13, 29):
        # A hair less: sums of the same numbers may round differently.
        found = forward_selection(groups, 60, enough=(1 - 1e-9) * reached[k - 1])
        assert (len(found.indices), found.stop) == (k, "enough")


@pytest.mark.parametrize("few", [1, 8, 30])
def test_a_pool_of_some_candidates_chooses_alike(monkeypatch, rounds, few):
    monkeypatch.setattr(_lookahead, "_FEW_CANDIDATES", few)
    monkeypatch.setattr(_lookahead, "pays_for_all", lambda n, n_select: False)
    monkeypatch.setattr(_lookahead, "_ENTRANTS", 5)
    groups = views(symmetric=True)
    expected = one_by_one(monkeypatch, groups, 60)
    np.testing.assert_array_equal(forward_selection(groups, 60).indices, expected.indices)


@pytest.fixture
def sketched(monkeypatch, rounds):
    """Guess from a sketch from the first step on, and never from a Gram matrix."""
    monkeypatch.setattr(_lookahead, "_ENTRIES_PER_READ", 1e-9)
    monkeypatch.setattr(_lookahead, "_LARGE", 0)
    monkeypatch.setattr(_lookahead, "_WIDTH", 1)
    return rounds


@pytest.mark.parametrize("per_direction", [1, 2])
@pytest.mark.parametrize("score", [None, squared_ratio_score(np.array([1.0, 2.0, 0.5]))])
def test_a_sketch_makes_the_same_choices(monkeypatch, sketched, score, per_direction):
    monkeypatch.setattr(_lookahead, "_PER_DIRECTION", (per_direction, per_direction))
    groups = views(length_scale=0.5)
    options = {} if score is None else {"score": score}
    expected = one_by_one(monkeypatch, groups, 60, **options)
    found = forward_selection(groups, 60, **options)
    np.testing.assert_array_equal(found.indices, expected.indices)
    scale = expected.reduction.max()
    np.testing.assert_allclose(found.reduction, expected.reduction, atol=1e-10 * scale)
    # With as many coordinates as directions guesses are often wrong, and choices are not.
    assert len(sketched) < (15 if per_direction == 2 else 60)


def test_a_sketch_ends_where_all_that_is_left_depends(monkeypatch, sketched):
    D = np.random.default_rng(0).standard_normal((40, 7)) @ np.diag(0.5 ** np.arange(7))
    D[20:] = D[:20] + D[1]  # 40 candidates in 7 dimensions
    groups = [WhitenedCandidates(D, np.ones((7, 1)))]
    expected = one_by_one(monkeypatch, groups, 20)
    found = forward_selection(groups, 20)
    np.testing.assert_array_equal(found.indices, expected.indices)
    assert len(found.indices) == 7
    assert found.stop == "dependent"


def test_a_sketch_is_left_where_its_guesses_are_wrong(monkeypatch):
    monkeypatch.setattr(_lookahead, "_LARGE", 0)
    monkeypatch.setattr(_lookahead, "_ENTRIES_PER_READ", 1e-9)
    walks = []

    def nothing_new(self, j, length):
        walks.append(j)
        return [j]

    monkeypatch.setattr(_lookahead.Sketch, "walk", nothing_new)
    forward_selection(views(), 40)
    assert len(walks) == _lookahead._TRIALS


def test_wrong_guesses_cost_time_only(monkeypatch, rounds):
    rng = np.random.default_rng(0)

    def at_random(self, j, length):
        return [j, *rng.choice(np.delete(np.arange(120), j), length - 1, replace=False)]

    monkeypatch.setattr(_lookahead.Pool, "_walk", at_random)
    groups = views()
    expected = one_by_one(monkeypatch, groups, 40)
    found = forward_selection(groups, 40)
    np.testing.assert_array_equal(found.indices, expected.indices)
    np.testing.assert_allclose(found.reduction, expected.reduction, rtol=1e-8)
    assert len(rounds) > 30


def test_gives_up_where_guesses_are_wrong(monkeypatch):
    monkeypatch.setattr(_lookahead, "_ENTRIES_PER_READ", 1e9)
    walks = []

    def nothing_new(self, j, length):
        walks.append(j)
        return [j]

    monkeypatch.setattr(_lookahead.Pool, "_walk", nothing_new)
    forward_selection(views(), 40)
    assert len(walks) == _lookahead._TRIALS


@pytest.mark.parametrize(("rank", "free", "expected"), [(96, 0, 120), (95, 0, 0), (95, 120, 120)])
def test_memory_decides_on_the_pool(monkeypatch, rank, free, expected):
    monkeypatch.setattr(_lookahead, "_FREE", free)
    one = SimpleNamespace(norms=np.ones(120), whitened=True)
    one.candidates = SimpleNamespace(rank=rank)
    assert _lookahead.Pool([one], None, 60).size == expected
