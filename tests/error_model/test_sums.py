"""Sums of many orders at once, against the columns written out."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm.error_model import _sums
from sklearn_raacmm.error_model._columns import Terms, columns_of
from sklearn_raacmm.error_model._fit import reweighted
from sklearn_raacmm.error_model._sums import (
    Rows,
    _of_orders,
    _spread,
    candidate_sums,
    explicit_gram,
    less_constants,
)

from ._arms import ARM, draw_angles


def explicit_sums(theta, y, weights, codes, offered, terms, root):
    """Gram matrix and moments from all columns, whitened, offsets taken out by dummies."""
    always = columns_of(ARM, terms._replace(harmonics=np.empty((0, 2), int))).at(theta)
    waves = columns_of(ARM, Terms(offered, False, False, False)).at(theta)
    white = np.sqrt(weights)[:, None, None] * (np.eye(3) if root is None else root)
    A = white @ np.concatenate([always, waves, y[:, :, None]], axis=2)
    A = A.reshape(-1, A.shape[2])
    if codes is not None:
        dummies = np.einsum("ncd,ng->ncgd", white, codes[:, None] == np.unique(codes))
        Q = np.linalg.qr(dummies.reshape(len(A), -1))[0]
        A = A - Q @ (Q.T @ A)
    return A.T @ A, always.shape[2]


@pytest.mark.parametrize(("chunk", "many"), [(1024, 128), (7, 1)])
@pytest.mark.parametrize("with_offsets", [False, True])
@pytest.mark.parametrize("some_orders", [False, True])
@pytest.mark.parametrize("even", [False, True])
def test_sums_are_those_of_all_columns(with_offsets, some_orders, even, chunk, many, monkeypatch):
    for name, value in {"_CHUNK": chunk, "_MANY_ORDERS": many, "_MANY_POSES": many}.items():
        monkeypatch.setattr(_sums, name, value)
    rng = np.random.default_rng(3)
    n = 60
    theta, y, weights = draw_angles(ARM, n), rng.normal(size=(n, 3)), rng.uniform(0.5, 2, n)
    codes = rng.permutation(np.arange(n) % 6) if with_offsets else None
    orders = [2, 5, 300] if some_orders else range(1, 12)
    offered = np.array([(j, k) for j in (0, 2, 5) for k in orders])
    # Without kinematics nothing is taken out.
    terms = Terms(offered, True, False, True)
    root = None if even else rng.normal(size=(n, 3, 3))
    rows = Rows(ARM, theta, y, weights, codes, root=root)
    (found,) = candidate_sums(rows, columns_of(ARM, terms), np.zeros(n, int))
    gram, m = explicit_sums(theta, y, weights, codes, offered, terms, root)
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


@pytest.mark.parametrize("codes", [None, np.arange(60) % 12])
@pytest.mark.parametrize("known", [0.0, 0.3])
def test_sums_at_new_weights_are_those_of_all_rows(codes, known):
    """Rows that lose or regain all weight among them, some of them all rows of a position."""
    rng = np.random.default_rng(5)
    theta, y = draw_angles(ARM, 60), rng.normal(size=(60, 3))
    rows = Rows(ARM, theta, y, rng.uniform(0.5, 2, 60), codes, ridge=known)
    columns = columns_of(ARM, Terms(np.array([(0, 1), (4, 300)]), True, True, True))
    factors = [np.ones(60) for _ in range(3)]
    factors[0][7] = 0.0
    factors[1][[0, 1]] = 0.0, 0.5
    factors[2][[3, 15, 27, 39, 51]] = 0.0  # position 3
    sums = rows.weighted(factors[0]).sums(columns)
    for old, new in pairwise(factors):
        sums = reweighted(rows, columns, sums, old, new)
        expected = rows.weighted(new).sums(columns)
        for found, wanted in zip(sums[:7], expected[:7], strict=True):
            assert_allclose(found, wanted, atol=1e-11 * np.abs(wanted).max())
        found, wanted = (part.rows([1, 0]) for part in (sums, expected))
        assert_allclose(found, wanted, atol=1e-11 * wanted.max())


@pytest.mark.parametrize("with_offsets", [False, True])
@pytest.mark.parametrize("chunk", [7, 1024])
def test_sums_of_parts_are_those_of_the_rows_of_each(with_offsets, chunk, monkeypatch):
    """Of parts whose rows and positions lie between one another."""
    monkeypatch.setattr(_sums, "_CHUNK", chunk)
    rng = np.random.default_rng(6)
    theta, y, codes = draw_angles(ARM, 60), rng.normal(size=(60, 3)), np.arange(60) * 7 % 12
    parts = 2 * np.array([2, 0, 1])[codes % 3]
    own = codes if with_offsets else None
    rows = Rows(ARM, theta, y, rng.uniform(0.5, 2, 60), own, root=rng.normal(size=(60, 3, 3)))
    columns = columns_of(ARM, Terms(np.array([(0, 1), (4, 300)]), True, True, True))
    for part, found in zip([0, 2, 4], rows.sums_of_parts(columns, parts), strict=True):
        expected = rows.at(parts == part).sums(columns)
        for one, wanted in zip(found[:7], expected[:7], strict=True):
            assert_allclose(one, wanted, atol=1e-11 * np.abs(wanted).max())
        one, wanted = (sums.rows([1, 0]) for sums in (found, expected))
        assert_allclose(one, wanted, atol=1e-11 * wanted.max())


@pytest.mark.parametrize("with_offsets", [False, True])
@pytest.mark.parametrize("size", [1, 5, 12, 100])
def test_chunks_hold_whole_positions_of_one_part(with_offsets, size):
    rng = np.random.default_rng(7)
    codes, part_of = np.repeat(np.arange(9), rng.integers(1, 9, 9)), None
    n = len(codes)
    rows = Rows(
        ARM, np.zeros((n, 6)), np.zeros((n, 3)), np.ones(n), codes if with_offsets else None
    )
    for part_of in (None, codes // 4):
        slices = rows.chunks(size, part_of)
        assert [one.start for one in slices] == [0, *(one.stop for one in slices[:-1])]
        assert slices[-1].stop == n
        for one in slices:
            positions = codes[one]
            if with_offsets:
                assert not set(positions) & (set(codes[: one.start]) | set(codes[one.stop :]))
            assert one.stop - one.start <= size or (with_offsets and len(set(positions)) == 1)
            assert part_of is None or len(set(part_of[one])) == 1


@pytest.mark.parametrize("known", [0.0, 0.3, np.inf])
def test_constants_are_those_of_a_ridge_on_dummies(known, monkeypatch):
    """Of the columns written out once, for any weight that draws the constants to 0."""
    monkeypatch.setattr(_sums, "_CHUNK", 7)
    rng = np.random.default_rng(4)
    n = 40
    theta, y, weights = draw_angles(ARM, n), rng.normal(size=(n, 3)), rng.uniform(0.5, 2, n)
    codes = rng.permutation(np.arange(n) % 6)
    columns = columns_of(ARM, Terms(np.array([(0, 1), (4, 300)]), True, False, True))
    rows = Rows(ARM, theta, y, weights, codes)
    gram, of_positions, precision = explicit_gram(rows, columns.at)
    found = less_constants(gram, of_positions, precision / (precision + known))
    A = np.concatenate([columns.at(theta), y[:, :, None]], axis=2)
    dummies = np.sqrt(weights)[:, None] * (codes[:, None] == np.arange(6))
    if np.isinf(known):
        dummies = dummies[:, :0]
    size = dummies.T @ dummies + (0.0 if np.isinf(known) else known) * np.eye(dummies.shape[1])
    expected = 0.0
    for component in range(3):
        part = np.sqrt(weights)[:, None] * A[:, component]
        of_constants = dummies.T @ part
        expected = expected + part.T @ part - of_constants.T @ np.linalg.solve(size, of_constants)
    assert_allclose(found, expected, atol=1e-12 * expected.max())
    assert explicit_gram(rows._replace(codes=None), columns.at)[1] is None


@pytest.mark.parametrize(
    "orders", [np.arange(1, 401), np.arange(1, 1001), np.r_[1:130, 200, 640], np.arange(3, 400, 3)]
)
def test_grid_is_exact_to_the_last_digits(orders):
    """Also where poses come in parts, and at angles of several turns of either sign."""
    rng = np.random.default_rng(len(orders))
    theta = np.r_[rng.uniform(-9, 9, 294), 0.0, -1e-17, np.pi, -np.pi, 2 * np.pi, 1e-300]
    columns = rng.normal(size=(300, 3))
    parts = [_spread(theta[i], orders).T @ columns[i] for i in (slice(7), slice(7, 300))]
    phase = theta[:, None] * orders
    expected = np.stack([np.cos(phase).T @ columns, np.sin(phase).T @ columns], axis=1)
    atol = 4e-16 * orders[-1] * np.linalg.norm(columns, axis=0).max() * 9  # of the phases
    assert_allclose(_of_orders(sum(parts), orders), expected.reshape(-1, 3), rtol=0, atol=atol)


def test_high_orders_are_exact():
    """Waves by doubling against cosines and sines, at the highest order of all."""
    theta = draw_angles(ARM, 500, width=6.0)[:, 0]
    pairs = np.column_stack([np.zeros(1000, int), np.arange(1, 1001)])
    columns = columns_of(ARM, Terms(pairs, False, False, False))
    found = columns.waves(theta[:, None]).view(complex)
    phase = np.arange(1, 1001) * theta[:, None]
    assert np.abs(found - (np.cos(phase) + 1j * np.sin(phase))).max() < 2e-12
