"""Rows in blocks, from files or other machines, against the same rows in memory."""

import tracemalloc

import numpy as np
import pytest
from sklearn.linear_model import LinearRegression

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import _rows


@pytest.fixture
def few_in_memory(monkeypatch):
    monkeypatch.setattr(_rows, "HELD_ROWS", 600)
    monkeypatch.setattr(_rows, "IN_MEMORY_ROWS", 1000)


def data(n=6000, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, 3))
    Y = np.column_stack([np.sin(3 * X[:, 0]), X[:, 1] * X[:, 2]])
    weights = rng.uniform(0.5, 2, n)
    weights[:50] = 0
    return X, Y + 0.1 * rng.standard_normal(Y.shape), weights


SETTINGS = {
    "defaults": {},
    "linear tail": {"degree": 1},
    "no tail, plain": {"degree": -1, "n_centers": 20, "length_scale": 0.5, "alpha": 0.0},
    "shared, a share": {"n_centers": 0.1, "shared": True},
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.exhaustive if name != "shared, a share" else ())
        for name in SETTINGS
    ],
)
def test_neither_order_nor_splits_matter(name, few_in_memory):
    da = pytest.importorskip("dask.array")
    X, Y, weights = data(2400)
    model = RBFNetRegressor(loss="squared", random_state=0, max_centers=300)
    model.set_params(**SETTINGS[name])
    expected = model.fit(X, Y, sample_weight=weights).predict(X)
    np.testing.assert_array_equal(X[model.center_indices_], model.centers_)
    order = np.random.default_rng(1).permutation(len(X))
    other = model.fit(X[order], Y[order], sample_weight=weights[order]).predict(X)
    # A hundredth of the noise: sums in another order decide between near ties.
    np.testing.assert_allclose(other, expected, atol=1e-3)
    chunked = da.from_array(X, chunks=(1750, 2)), da.from_array(Y, chunks=1250)
    other = model.fit(*chunked, sample_weight=weights).predict(X)
    np.testing.assert_allclose(other, expected, atol=1e-3)
    np.testing.assert_array_equal(X[model.center_indices_], model.centers_)


@pytest.mark.parametrize("degree", [-1, 0, 1])
def test_same_network_as_in_memory_where_the_candidates_are_the_same(degree, monkeypatch):
    X, Y, weights = data(4000)
    settings = {"n_centers": 30, "length_scale": 0.7, "alpha": 1e-3, "degree": degree}
    settings |= {"random_state": 0, "shared": True}
    whole = RBFNetRegressor(**settings).fit(X, Y, sample_weight=weights)
    # All rows are candidates here too, but seen through sums over blocks.
    monkeypatch.setattr(_rows, "IN_MEMORY_ROWS", 1000)
    monkeypatch.setattr(_rows, "HELD_ROWS", 3949)
    blocks = RBFNetRegressor(**settings).fit(X, Y, sample_weight=weights)
    np.testing.assert_array_equal(blocks.center_indices_, whole.center_indices_)
    np.testing.assert_allclose(blocks.predict(X), whole.predict(X), atol=1e-9)
    std = [m.predict(X[:99], return_std=True)[1] for m in (blocks, whole)]
    np.testing.assert_allclose(*std, rtol=1e-6)


def test_centres_chosen_by_a_coarse_factor_leave_hardly_more(few_in_memory):
    X, Y, _ = data()
    settings = {"n_centers": 40, "length_scale": 0.8, "alpha": 0.0, "shared": True}
    coarse = RBFNetRegressor(**settings, random_state=0).fit(X, Y)
    # The exact choice among as many candidates, on a quarter of the rows.
    exact = RBFNetRegressor(**settings, random_state=0).fit(X[:1000], Y[:1000])
    refit = LinearRegression().fit(kernel(exact, X), Y)
    best = np.mean((refit.predict(kernel(exact, X)) - Y) ** 2)
    assert np.mean((coarse.predict(X) - Y) ** 2) < 1.03 * best


def kernel(model, X):
    gap = np.square((X[:, None] - model.centers_) / model.length_scale_).sum(axis=2)
    return np.exp(-0.5 * gap)


def test_rows_that_repeat_are_merged_where_they_all_fit(few_in_memory):
    X, Y, _ = data(400)
    rows = np.random.default_rng(0).integers(0, 400, 3000)
    weights = np.bincount(rows, minlength=400).astype(float)
    settings = {"n_centers": 12, "length_scale": 0.7, "alpha": 1e-2, "random_state": 0}
    many = RBFNetRegressor(**settings).fit(X[rows], Y[rows])
    few = RBFNetRegressor(**settings).fit(X, Y, sample_weight=weights)
    np.testing.assert_array_equal(many.centers_, few.centers_)
    np.testing.assert_allclose(many.predict(X), few.predict(X), atol=1e-10)


def test_rows_of_a_file_are_not_read_into_memory(tmp_path, monkeypatch):
    n = 200_000
    # Blocks as small beside this file as the usual ones are beside one that is worth a file.
    monkeypatch.setattr(_rows, "SMALL_BLOCK", 2**16)
    rng = np.random.default_rng(0)
    X = np.memmap(tmp_path / "X", dtype=np.float64, mode="w+", shape=(n, 12))
    X[:] = rng.uniform(-1, 1, X.shape)
    y = np.memmap(tmp_path / "y", dtype=np.float64, mode="w+", shape=n)
    y[:] = np.sin(2 * X[:, 0]) + 0.1 * rng.standard_normal(n)
    X.flush()
    y.flush()
    X, y = (np.memmap(f.filename, dtype=np.float64, mode="r", shape=f.shape) for f in (X, y))
    width = np.full(12, 1e3)
    width[0] = 0.7
    monkeypatch.setattr(_rows, "HELD_ROWS", 100)
    model = RBFNetRegressor(8, length_scale=width, alpha=1e-3, random_state=0)
    tracemalloc.start()
    model.fit(X, y)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # Weights of all rows are made, one number beside twelve.
    assert peak < X.nbytes / 2
    grid = np.zeros((50, 12))
    grid[:, 0] = np.linspace(-0.9, 0.9, 50)
    np.testing.assert_allclose(model.predict(grid), np.sin(2 * grid[:, 0]), atol=0.01)


def test_dask_arrays_with_wrong_shapes_are_refused():
    da = pytest.importorskip("dask.array")
    X, Y, weights = (da.from_array(a, chunks=1000) for a in data(3000))
    model = RBFNetRegressor(5, length_scale=1.0, alpha=0.1)
    with pytest.raises(ValueError, match=r"y has shape \(2999, 2\), but X has 3000 rows"):
        model.fit(X, Y[:-1])
    with pytest.raises(ValueError, match=r"sample_weight has shape \(10,\), but X has 3000"):
        model.fit(X, Y, sample_weight=weights[:10])
    with pytest.raises(ValueError, match=r"compute_chunk_sizes"):
        model.fit(X[X[:, 0] > 0], Y)
    with pytest.raises(ValueError, match=r"X must be of shape"):
        model.fit(X[:, 0], Y)


@pytest.mark.parametrize(
    ("which", "rows", "bad", "message"),
    [
        (0, 2345, np.nan, "Input X contains"),
        (1, 2345, np.inf, "Input y contains"),
        (2, 2345, -1.0, "Negative values in data passed to sample_weight"),
        (2, slice(None), 0.0, "Sample weights must contain at least one non-zero"),
    ],
)
def test_bad_values_in_one_chunk_are_named(which, rows, bad, message, few_in_memory):
    da = pytest.importorskip("dask.array")
    given = data(3000)
    given[which][rows] = bad
    X, Y, weights = (da.from_array(a, chunks=500) for a in given)
    with pytest.raises(ValueError, match=message):
        RBFNetRegressor(5, length_scale=1.0, alpha=0.1).fit(X, Y, sample_weight=weights)


def test_centres_of_reweighed_blocks_are_rows_of_the_data(few_in_memory, monkeypatch):
    monkeypatch.setattr(_rows, "SMALL_BLOCK", 2**13)  # several blocks
    X, Y, _ = data(3000)
    Y[::50] += 5.0
    settings = {"n_centers": 8, "length_scale": 0.5, "alpha": 1e-2, "random_state": 0}
    model = RBFNetRegressor(**settings, loss="tukey", shared=True).fit(X, Y)
    np.testing.assert_array_equal(X[model.center_indices_], model.centers_)
