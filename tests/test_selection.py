"""The forward selection against fits of every candidate, fastcan, and extended precision."""

from functools import reduce

import mpmath
import numpy as np
import pytest
from fastcan import FastCan
from scipy.spatial.distance import cdist

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm._candidates import candidate_groups
from sklearn_raacmm._kernels import KERNELS, kernel_matrix, pivoted_cholesky, squared_distances
from sklearn_raacmm._path import (
    leave_one_out,
    nested_least_squares,
    stack_triangles,
    triangular_factor,
)
from sklearn_raacmm._preparation import merge, prepare
from sklearn_raacmm._selection import exchange, forward_selection


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
    root = np.sqrt(weights)[:, None]
    about = root * Y
    if degree >= 0:
        about = about - root * tail @ np.linalg.lstsq(root * tail, root * Y, rcond=None)[0]
    spread = np.sqrt(np.sum(about**2, axis=0))
    K = np.exp(-0.5 * cdist(X, X, "sqeuclidean") / length_scale**2)
    expected = brute_force(K, Y / spread, weights, tail, alpha, 8)
    model = RBFNetRegressor(8, length_scale=length_scale, alpha=alpha, degree=degree)
    model.fit(X, Y, sample_weight=weights)
    np.testing.assert_array_equal(model.center_indices_, expected)


@pytest.mark.parametrize("length_scale", [0.1, 0.7])
def test_same_centres_as_fastcan(length_scale):
    X, Y, _ = problem(n=300, seed=3)
    K = np.exp(-0.5 * cdist(X, X, "sqeuclidean") / length_scale**2)
    expected = FastCan(25, verbose=0).fit(K, Y).indices_
    model = RBFNetRegressor(25, length_scale=length_scale, alpha=0).fit(X, Y[:, 0])
    np.testing.assert_array_equal(model.center_indices_, expected)


@pytest.mark.parametrize("alpha", [0.0, 1e-3])
def test_both_representations_choose_alike(alpha):
    X, Y, weights = problem(2, n=200)
    problem_ = prepare(merge(X, Y, weights), 0)
    view = problem_.view()
    members = [np.arange(2)]
    args = (problem_, view, np.arange(200), 0.0, 0.5, members, "gaussian", [alpha])
    # One step is cheapest on the matrix itself; many steps on the factor.
    symmetric, _ = candidate_groups(*args, 1)
    whitened, _ = candidate_groups(*args, None)
    assert type(symmetric[0]) is not type(whitened[0])
    a, b = forward_selection(symmetric, 20), forward_selection(whitened, 20)
    np.testing.assert_array_equal(a.indices, b.indices)
    # The factor leaves 1e-6 of the kernel matrix out.
    np.testing.assert_allclose(a.reduction, b.reduction, atol=1e-6 * np.sum(view.total))


@pytest.mark.parametrize("n_select", [1, None])  # on the matrix itself, and on the factor
def test_a_candidate_whose_running_figures_are_wrong_is_looked_at_again(n_select):
    X, Y, weights = problem(2, n=80)
    problem_ = prepare(merge(X, Y, weights), 0)
    view = problem_.view()
    args = (problem_, view, np.arange(80), 0.0, 0.5, [np.arange(2)], "gaussian", [1e-3])

    def select(misjudged):
        (candidates,), _ = candidate_groups(*args, n_select)
        norms, correlations = candidates.squared_norms(), candidates.correlations()
        norms[misjudged] *= 2.0
        correlations[misjudged] *= 3.0  # 4.5 times its gain: it is tried long before its turn
        candidates.squared_norms = lambda: norms
        candidates.correlations = lambda: correlations
        return forward_selection([candidates], 8)

    honest = select([])
    wrong = select(np.arange(0, 80, 2))
    np.testing.assert_array_equal(wrong.indices[:1], honest.indices[:1])
    np.testing.assert_allclose(wrong.reduction[0], honest.reduction[0], rtol=1e-9)


@pytest.mark.parametrize("n_select", [1, None])
def test_reductions_are_by_how_much_the_objective_falls(n_select):
    X, Y, weights = problem(2, n=80)
    problem_ = prepare(merge(X, Y, weights), 0)
    view = problem_.view()
    args = (problem_, view, np.arange(80), 0.0, 0.5, [np.arange(2)], "gaussian", [0.0])
    (candidates,), _ = candidate_groups(*args, n_select)
    chosen = forward_selection([candidates], 6)
    root = np.sqrt(weights)[:, None]
    order = problem_.first[chosen.indices]  # rows are sorted there
    K = kernel_matrix(X / 0.5, X[order] / 0.5, "gaussian")
    left = []
    for k in range(7):
        A = root * np.hstack([np.ones((80, 1)), K[:, :k]])
        left.append(np.square(root * Y - A @ np.linalg.lstsq(A, root * Y, rcond=None)[0]).sum(0))
    falls = -np.diff(left, axis=0)
    shares = chosen.reduction / chosen.reduction[0]
    np.testing.assert_allclose(shares, falls / falls[0], rtol=1e-4)


def test_residual_is_that_of_extended_precision_on_wide_widths():
    # 40 rows, widths so wide that the kernel matrix has condition far beyond 1e16.
    rng = np.random.default_rng(1)
    x = np.sort(rng.uniform(-1, 1, 40))
    y = np.cos(3 * x) + 0.01 * rng.standard_normal(40)
    K = np.exp(-0.5 * (x[:, None] - x) ** 2 / 2.0**2)
    assert np.linalg.cond(K) > 1e16
    model = RBFNetRegressor("auto", length_scale=2.0, alpha=0, criterion="mse", tol=0, degree=-1)
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
    claimed = model.criterion_path_[k - 1] * 40
    assert claimed == pytest.approx(exact, rel=1e-6)
    reached = float(np.sum((y - model.predict(x[:, None])) ** 2))
    assert reached == pytest.approx(exact, rel=1e-4)


def test_order_is_that_of_extended_precision_where_columns_are_nearly_dependent():
    X, Y, _ = problem(n=300, seed=8)
    model = RBFNetRegressor(45, length_scale=1.2, alpha=0).fit(X, Y[:, 0])
    # Explicit Gram-Schmidt on all columns, with three more digits.
    P = X.astype(np.longdouble)
    W = np.exp(-np.sum((P[:, None] - P) ** 2, axis=2) / (2 * np.longdouble(1.2) ** 2))
    W -= W.mean(axis=0)
    t = Y[:, 0].astype(np.longdouble)
    t -= t.mean()
    chosen, lengths = [], []
    first = np.sum(W * W, axis=0)
    for _ in range(45):
        norms = np.sum(W * W, axis=0)
        norms[chosen] = np.inf
        j = int(np.argmax((t @ W) ** 2 / norms))
        chosen.append(j)
        lengths.append(float(np.sqrt(norms[j] / first[j])))
        q = W[:, j] / np.sqrt(norms[j])
        W -= np.outer(q, q @ W)
        t -= q * (q @ t)
    # So little is left of the last columns that their squares are below machine epsilon.
    assert min(lengths) < 1e-8
    np.testing.assert_array_equal(model.center_indices_, chosen)


def test_stops_at_dependent_candidates_where_fastcan_goes_on():
    rng = np.random.default_rng(2)
    x = rng.uniform(-1, 1, 50)
    y = np.sin(5 * x) + 0.05 * rng.standard_normal(50)
    K = np.exp(-0.5 * (x[:, None] - x) ** 2 / 3.0**2)
    chosen = FastCan(30, verbose=0).fit(K, y[:, None]).indices_
    model = RBFNetRegressor(30, length_scale=3.0, alpha=0).fit(x[:, None], y)
    assert model.stop_reason_ == "dependent"

    def condition(S):
        columns = K[:, S] - K[:, S].mean(axis=0)
        return np.linalg.cond(columns / np.linalg.norm(columns, axis=0))

    assert condition(model.center_indices_) < 1e13 < 1e15 < condition(chosen)


@pytest.mark.parametrize("name", [k for k, v in KERNELS.items() if v.positive_definite])
def test_pivoted_cholesky_reaches_its_tolerance(name):
    Z = np.random.default_rng(0).uniform(-2, 2, (300, 2))
    K = kernel_matrix(Z, Z, name)
    for tol in (1e-2, 1e-5):
        factor = pivoted_cholesky(Z, name, tol=tol)
        assert factor.complete
        assert np.abs(K - factor.rows @ factor.rows.T).max() <= tol * (1 + 1e-9)
        assert len(np.unique(factor.pivots)) == len(factor.pivots)
    cut = pivoted_cholesky(Z, name, tol=1e-9, max_rank=10)
    assert cut.rows.shape == (300, 10)
    assert not cut.complete
    assert cut.residual == pytest.approx(np.max(1 - np.sum(cut.rows**2, axis=1)))


@pytest.mark.parametrize("name", list(KERNELS))
def test_kernel_slope_is_the_derivative(name):
    s = np.linspace(0.05, 9, 40)
    h = 1e-6
    function, slope = KERNELS[name].function, KERNELS[name].slope
    numeric = (function(s + h) - function(s - h)) / (2 * h)
    np.testing.assert_allclose(slope(s.copy()), numeric, rtol=1e-6, atol=1e-9)


def test_squared_distances():
    rng = np.random.default_rng(0)
    A, B = rng.standard_normal((30, 4)), rng.standard_normal((20, 4))
    np.testing.assert_allclose(
        squared_distances(A, B), cdist(A, B, "sqeuclidean"), rtol=1e-12, atol=1e-13
    )


@pytest.mark.parametrize("alphas", [[0.0, 0.0], [0.3, 0.3], [0.02, 0.7]])
def test_path_is_that_of_separate_fits(alphas):
    X, Y, weights = problem(2, n=60)
    root = np.sqrt(weights)[:, None]
    tail = root * np.ones((60, 1))
    K = np.exp(-0.5 * cdist(X, X[:9], "sqeuclidean") / 0.4**2)
    U = np.linalg.cholesky(K[:9]).T
    within = np.array([0.5, 0.25])
    rows = np.hstack([tail, root * K, root * Y])
    # In blocks, some shorter than wide.
    R = reduce(stack_triangles, map(triangular_factor, (rows[:5], rows[5:40], rows[40:])))
    path = nested_least_squares(R, 1, U, np.array(alphas), within)
    parts = (slice(0, 25), slice(25, 60))
    press = sum(leave_one_out(tail[p], root[p] * K[p], root[p] * Y[p], path) for p in parts)
    for m in (0, 1, 4, 9):
        A = np.hstack([tail, root * K[:, :m]])
        for i in range(2):
            R = np.zeros((m + 1, m + 1))
            R[1:, 1:] = alphas[i] * K[:m, :m]
            b = root[:, 0] * Y[:, i]
            inverse = np.linalg.inv(A.T @ A + R)
            w = inverse @ A.T @ b
            rss = np.sum((b - A @ w) ** 2)
            np.testing.assert_allclose(path.coefficients(m)[:, i], w, rtol=1e-8, atol=1e-8)
            assert path.rss[m, i] == pytest.approx(rss + within[i])
            assert path.objective[m, i] == pytest.approx(rss + w @ R @ w + within[i])
            assert path.dof[m, i] == pytest.approx(np.trace(A @ inverse @ A.T))
            # Leave-one-out by its definition: with the ridge fixed, drop a row and predict it.
            loo = 0.0
            for row in range(60):
                keep = np.arange(60) != row
                part = A[keep]
                loo += (b[row] - A[row] @ np.linalg.solve(part.T @ part + R, part.T @ b[keep])) ** 2
            assert press[m, i] == pytest.approx(loo, rel=1e-7)


def test_exchange_reaches_a_local_optimum_never_worse_than_the_forward_pass():
    X, Y, _ = problem(1, n=120, seed=5)
    problem_ = prepare(merge(X, Y, np.ones(120)), 0)
    X, targets = problem_.X, problem_.targets - problem_.targets.mean(axis=0)
    members = [np.arange(1)]
    args = (problem_.view(), np.arange(120), 0.0, 0.4, members, "gaussian", [0.0], None)
    candidates, _ = candidate_groups(problem_, *args)
    forward = forward_selection(candidates, 6).indices
    better, n_swaps = exchange(candidates, forward, tol=0)
    K = np.exp(-0.5 * cdist(X, X, "sqeuclidean") / 0.4**2)
    K -= K.mean(axis=0)

    def rss(S):
        return float(
            np.sum((targets - K[:, S] @ np.linalg.lstsq(K[:, S], targets, rcond=None)[0]) ** 2)
        )

    assert n_swaps > 0
    assert rss(better) < rss(forward)
    for position in range(6):
        rest = np.delete(better, position)
        trials = [rss([*rest, j]) for j in range(120) if j not in rest]
        assert min(trials) >= rss(better) * (1 - 1e-9)
