"""Whitened rows against explicit block matrices of all rows at once."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm.utils import Whitening


def draw(seed=0, n=40, n_features=5, q=4):
    """Rows that show one to three directions, their noise, and the unknowns of their features."""
    rng = np.random.default_rng(seed)
    feature, weights = rng.permutation(np.arange(n) % n_features), rng.uniform(0.5, 2, n)
    turn = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    rank = rng.integers(1, 4, n)
    shown = turn * (np.arange(3) < rank[:, None])[:, None]
    D = shown @ shown.swapaxes(1, 2)
    covariance = rng.normal(size=(n, 3, 3))
    covariance = covariance @ covariance.swapaxes(1, 2) + 0.1 * np.eye(3)
    # Of D C D the inverse along what is shown, and its symmetric root.
    value, axes = np.linalg.eigh(D @ covariance @ D)
    size = np.where(value > 1e-9, 1 / np.sqrt(np.maximum(value, 1e-9)), 0.0)
    root = (axes * size[:, None]) @ axes.swapaxes(1, 2)
    unknowns = rng.normal(size=(n, 3, q))
    unknowns[feature == 1, :, 3] = unknowns[feature == 1, :, 2]  # two that are not told apart
    return rng.normal(size=(n, 3, 6)), root, unknowns, feature, weights, rank, D @ covariance @ D


@pytest.mark.parametrize("known", [0.0, 0.3])
@pytest.mark.parametrize("shifts", [False, True])
def test_what_is_left_is_that_of_one_large_covariance(known, shifts):
    """Products of deviations are those by the covariance that unknowns of any size add to."""
    columns, root, unknowns, feature, weights, rank, covariance = draw()
    B = np.broadcast_to(np.eye(3), (len(feature), 3, 3)) if shifts else unknowns
    given = None if shifts else unknowns
    found = Whitening(weights, root, feature, given, ridge=known, rank=rank)
    n, q = len(feature), B.shape[2]
    whole = np.zeros((3 * n, 3 * n))
    precision = np.zeros((3 * n, 3 * n))
    moves = np.zeros((3 * n, 5 * q))
    for i in range(n):
        of = slice(3 * i, 3 * i + 3)
        precision[of, of] = weights[i] * np.linalg.pinv(covariance[i], 1e-9, hermitian=True)
        moves[of, feature[i] * q : (feature[i] + 1) * q] = B[i]
    T = moves.T @ precision @ moves + known * np.eye(5 * q)
    whole = (
        precision
        - precision @ moves @ np.linalg.pinv(T, 1e-10, hermitian=True) @ moves.T @ precision
    )
    flat = columns.reshape(3 * n, -1)
    expected = flat.T @ whole @ flat
    white = (found.root @ columns).reshape(3 * n, -1)
    assert_allclose(white.T @ found.deviations(columns).reshape(3 * n, -1), expected, atol=1e-9)
    centred = found.centred(columns)
    assert_allclose(found.root @ centred, found.deviations(columns), atol=1e-9)
    assert_allclose(found.centred(columns[:, :, 0]), centred[:, :, 0], atol=1e-12)
    left = columns - B @ found.unknowns(columns)[feature]
    assert_allclose(centred, left, atol=1e-9)
    if not known:
        free = weights @ rank - np.linalg.matrix_rank(T, 1e-9, hermitian=True)
        assert found.n_observations == pytest.approx(free)


def test_order_of_rows_and_size_of_all_noise_change_nothing():
    columns, root, unknowns, feature, weights, rank, _ = draw(1)
    order = np.random.default_rng(0).permutation(len(feature))
    found = Whitening(weights, root, feature, unknowns, rank=rank)
    mixed = Whitening(weights[order], root[order], feature[order], unknowns[order])
    assert_allclose(mixed.centred(columns[order]), found.centred(columns)[order], atol=1e-9)
    twice = Whitening(weights, 2 * root, feature, unknowns, rank=rank)
    assert_allclose(twice.deviations(columns), 2 * found.deviations(columns), atol=1e-9)


def test_rows_without_unknowns_are_only_whitened():
    columns, root, _, _, weights, *_ = draw(2)
    found = Whitening(weights, root)
    expected = np.sqrt(weights)[:, None, None] * (root @ columns)
    assert_allclose(found.deviations(columns), expected)
    assert found.centred(columns) is columns
