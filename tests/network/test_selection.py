"""The forward selection and its algebra against refits, fastcan, and extended precision."""

import mpmath
import numpy as np
import pytest
from fastcan import FastCan
from scipy.spatial.distance import cdist

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network._kernels import KERNELS, kernel_matrix, pivoted_cholesky
from sklearn_raacmm.network._linear import stack_triangles, triangular_factor


def brute_force(K, Y, weights, tail, alpha, n_select):
    """Refit with every candidate in turn; the one with the least penalised objective wins."""
    root = np.sqrt(weights)[:, None]
    chosen = []
    for _ in range(n_select):
        best, best_value = None, np.inf
        for j in range(K.shape[1]):
            if j in chosen:
                continue
            S = [*chosen, j]
            A = root * np.hstack([tail, K[:, S]])
            R = np.zeros((A.shape[1], A.shape[1]))
            R[tail.shape[1] :, tail.shape[1] :] = alpha * K[np.ix_(S, S)]
            B = root * Y
            w = np.linalg.lstsq(A.T @ A + R, A.T @ B, rcond=None)[0] if alpha else None
            if w is None:
                w = np.linalg.lstsq(A, B, rcond=None)[0]
            value = np.sum((B - A @ w) ** 2) + np.sum(w * (R @ w))
            if value < best_value:
                best, best_value = j, value
        chosen.append(best)
    return chosen


def problem(n_outputs=1, n=70, seed=0, scale=None):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, 2))
    Y = np.column_stack([np.sin((2 + i) * X[:, 0]) + X[:, 1] ** (i + 1) for i in range(n_outputs)])
    Y += 0.1 * rng.standard_normal(Y.shape)
    return X, Y * (1.0 if scale is None else scale), rng.uniform(0.2, 3, n)


@pytest.mark.parametrize("length_scale", [0.15, 0.6])  # a full-rank kernel, and a smooth one
@pytest.mark.parametrize("alpha", [0.0, 0.05])
@pytest.mark.parametrize("degree", [-1, 0, 1])
@pytest.mark.parametrize("n_outputs", [1, 3])
@pytest.mark.parametrize("weighted", [False, True])
def test_same_centres_as_refitting_every_candidate(
    length_scale, alpha, degree, n_outputs, weighted
):
    X, Y, weights = problem(n_outputs)
    weights = weights if weighted else np.ones(len(X))
    tail = np.hstack([np.ones((len(X), 1)), X])[:, : {-1: 0, 0: 1, 1: 3}[degree]]
    K = np.exp(-0.5 * cdist(X, X, "sqeuclidean") / length_scale**2)
    expected = brute_force(K, Y, weights, tail, alpha, 8)
    model = RBFNetRegressor(8, length_scale=length_scale, alpha=alpha, degree=degree, shared=True)
    model.fit(X, Y, sample_weight=weights)
    np.testing.assert_array_equal(model.center_indices_, expected)


@pytest.mark.parametrize("length_scale", [0.1, 0.7])
def test_same_centres_as_fastcan(length_scale):
    X, Y, _ = problem(n=300, seed=3)
    K = np.exp(-0.5 * cdist(X, X, "sqeuclidean") / length_scale**2)
    expected = FastCan(25, verbose=0).fit(K, Y).indices_
    model = RBFNetRegressor(25, length_scale=length_scale, alpha=0).fit(X, Y[:, 0])
    np.testing.assert_array_equal(model.center_indices_, expected)


def extended_precision(W, t, n_select):
    """Explicit Gram-Schmidt on all columns with three more digits: order, and what was left."""
    W, t = W.astype(np.longdouble), t.astype(np.longdouble)
    chosen, lengths = [], []
    first = np.sum(W * W, axis=0)
    for _ in range(n_select):
        norms = np.sum(W * W, axis=0)
        norms[chosen] = np.inf
        j = int(np.argmax((t @ W) ** 2 / norms))
        chosen.append(j)
        lengths.append(float(np.sqrt(norms[j] / first[j])))
        q = W[:, j] / np.sqrt(norms[j])
        W = W - np.outer(q, q @ W)
        t = t - q * (q @ t)
    return chosen, min(lengths)


def test_residual_is_that_of_extended_precision_on_wide_widths():
    # 40 rows, widths so wide that the kernel matrix has condition far beyond 1e16.
    rng = np.random.default_rng(1)
    x = np.sort(rng.uniform(-1, 1, 40))
    y = np.cos(3 * x) + 0.01 * rng.standard_normal(40)
    K = np.exp(-0.5 * (x[:, None] - x) ** 2 / 2.0**2)
    assert np.linalg.cond(K) > 1e16
    model = RBFNetRegressor(1e-12, length_scale=2.0, alpha=0, degree=-1)
    model.fit(x[:, None], y)
    k = len(model.centers_)
    assert model.stop_reason_ == "dependent"
    assert 5 <= k <= 15
    with mpmath.workdps(60):
        A = mpmath.matrix(40, k)
        for i in range(40):
            for j in range(k):
                gap = mpmath.mpf(x[i]) - mpmath.mpf(model.centers_[j, 0])
                A[i, j] = mpmath.exp(-gap * gap / 8)
        b = mpmath.matrix([mpmath.mpf(v) for v in y])
        w = mpmath.lu_solve(A.T * A, A.T * b)
        exact = float(mpmath.norm(b - A * w) ** 2)
    claimed = model.criterion_path_[k - 1] * np.sum(y**2)
    assert claimed == pytest.approx(exact, rel=1e-6)
    reached = float(np.sum((y - model.predict(x[:, None])) ** 2))
    assert reached == pytest.approx(exact, rel=1e-4)


def test_order_is_that_of_extended_precision_where_columns_are_nearly_dependent():
    X, Y, _ = problem(n=300, seed=8)
    model = RBFNetRegressor(45, length_scale=1.2, alpha=0).fit(X, Y[:, 0])
    P = X.astype(np.longdouble)
    W = np.exp(-np.sum((P[:, None] - P) ** 2, axis=2) / (2 * np.longdouble(1.2) ** 2))
    t = Y[:, 0].astype(np.longdouble)
    chosen, least = extended_precision(W - W.mean(axis=0), t - t.mean(), 45)
    # So little is left of the last columns that their squares are below machine epsilon.
    assert least < 1e-8
    np.testing.assert_array_equal(model.center_indices_, chosen)


@pytest.mark.parametrize("name", list(KERNELS))
def test_pivoted_cholesky_reaches_its_tolerance(name):
    Z = np.random.default_rng(0).uniform(-2, 2, (300, 2))
    K = kernel_matrix(Z, Z, name)
    for tol in (1e-2, 1e-5):
        rows, pivots, _, complete = pivoted_cholesky(Z, name, tol=tol)
        assert complete
        assert np.abs(K - rows @ rows.T).max() <= tol * (1 + 1e-9)
        assert len(np.unique(pivots)) == len(pivots)
    rows, _, residual, complete = pivoted_cholesky(Z, name, tol=1e-9, max_rank=10)
    assert rows.shape == (300, 10)
    assert not complete
    assert residual == pytest.approx(np.max(1 - np.sum(rows**2, axis=1)))


def test_pivoted_cholesky_where_distances_lose_digits():
    # Six places, thousands of widths apart; rows at one place differ by less than distances err.
    rng = np.random.default_rng(0)
    Z = np.column_stack([1e3 * rng.integers(0, 6, 300), 1e-5 * rng.standard_normal((300, 2))])
    Z -= Z.mean(axis=0)
    rows, pivots, _, complete = pivoted_cholesky(Z, "gaussian", tol=1e-13)
    exact = np.exp(-0.5 * cdist(Z, Z, "sqeuclidean"))
    assert complete
    assert len(pivots) == 6
    assert np.abs(exact - rows @ rows.T).max() < 1e-8


@pytest.mark.parametrize("sizes", [(50, 7), (7, 7), (3, 7), (200, 80), (0, 5)])
@pytest.mark.parametrize("further", [3, 7, 90])
def test_factors_of_two_blocks_are_those_of_all_rows(sizes, further):
    rng = np.random.default_rng(0)
    upper, lower = rng.normal(size=sizes), rng.normal(size=(further, sizes[1]))
    expected = np.abs(np.linalg.qr(np.vstack([upper, lower]), mode="r"))
    found = stack_triangles(triangular_factor(upper), triangular_factor(lower))
    assert not np.any(np.tril(found, -1))
    np.testing.assert_allclose(np.abs(found), expected, rtol=1e-9, atol=1e-12)
