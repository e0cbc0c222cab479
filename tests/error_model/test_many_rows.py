"""Fits whose sums over blocks of rows are made by dask, against those in memory."""

import os
import pickle
import signal

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sklearn_raacmm import ArmResidualRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.error_model import _fit, _left_out, _sums
from sklearn_raacmm.error_model._columns import Terms, columns_of
from sklearn_raacmm.utils import Groups


@pytest.fixture
def small_blocks(monkeypatch):
    """Blocks of a few rows, so that every loop turns more than once."""
    for module, sizes in (
        (_sums, {"_PARTS": 2, "_CHUNK": 50}),
        (_fit, {"_TOGETHER": 110}),
        (_left_out, {"_TOGETHER": 20, "_OF_POSITIONS": 20}),
    ):
        for name, size in sizes.items():
            monkeypatch.setattr(module, name, size)


def fitted(test, make, **options):
    """Model of a test whose arrays `make` has made of what NumPy holds."""
    X, y, weights = (make(a) for a in (test.data, test.target, np.ones(len(test.data))))
    model = ArmResidualRegressor(test.arm, orders=6, causes=["kinematics"])
    return model.fit(X, y, sample_weight=weights, **options)


def same(model, other):
    assert_array_equal(model.column_harmonics_, other.column_harmonics_)
    assert_allclose(model.coef_, other.coef_, rtol=1e-9)
    assert_allclose(model.pose_weight_, other.pose_weight_, atol=1e-9)
    assert model.fading_ == other.fading_
    assert model.linear_model_.std_scale == other.linear_model_.std_scale


@pytest.mark.parametrize("known", [False, True])
def test_dask_gives_the_model_of_the_same_rows_in_memory(known, small_blocks, monkeypatch):
    da, dask = pytest.importorskip("dask.array"), pytest.importorskip("dask")
    test = make_single_point(6, 60, bars=[400], random_state=0)
    test.target[5] += 3.0  # a slip, so that weights are not all 1
    test.target[:] = Groups(test.groups).centred(test.target)
    options = {"groups": test.groups, "lengths": test.lengths} if known else {"groups": False}
    calls = []
    one_thread = _sums._with_one_thread
    monkeypatch.setattr(
        _sums, "_with_one_thread", lambda *given: calls.append(given) or one_thread(*given)
    )
    whole = fitted(test, np.asarray, **options)
    assert not calls
    with dask.config.set(scheduler="threads"):
        model = fitted(test, lambda a: da.from_array(a, chunks=70), **options)
    assert len({repr(function) for function, *_ in calls}) >= 4
    same(model, whole)
    assert model.pose_weight_[5] == 0 < np.median(model.pose_weight_)


def test_sums_of_blocks_are_those_of_all_rows(monkeypatch):
    # Of some arms rounding alone comes to 5e-9 mm, where weakly known directions are large.
    test = make_single_point(6, 60, random_state=3)
    whole = fitted(test, np.asarray, groups=test.groups)
    monkeypatch.setattr(_sums, "_PARTS", 2)
    monkeypatch.setattr(_sums, "_CHUNK", 50)
    blocks = fitted(test, np.asarray, groups=test.groups)
    assert_array_equal(blocks.column_harmonics_, whole.column_harmonics_)
    # Shifts of the base are not shown: they are what rounding makes of them.
    found = (Groups(test.groups).centred(model.predict(test.data)) for model in (blocks, whole))
    assert_allclose(*found, atol=1e-9)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_worker_that_is_killed_changes_nothing(small_blocks, monkeypatch):
    base, distributed = (pytest.importorskip(name) for name in ("dask.base", "distributed"))
    da = pytest.importorskip("dask.array")
    test = make_single_point(6, 60, random_state=0)
    whole = fitted(test, np.asarray, groups=test.groups)
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        sizes = {"_PARTS": 2, "_CHUNK": 50}
        client.run(lambda: [setattr(_sums, name, size) for name, size in sizes.items()])
        workers, calls, compute = client.run(os.getpid), [], base.compute

        def killing(*tasks, **options):
            calls.append(tasks)
            if len(calls) == 4:  # some blocks are held by it
                os.kill(next(iter(workers.values())), signal.SIGKILL)
            return compute(*tasks, **options)

        monkeypatch.setattr(base, "compute", killing)
        model = fitted(test, lambda a: da.from_array(a, chunks=70), groups=test.groups)
        assert len(calls) > 8
        assert client.run(os.getpid) != workers
    same(model, whole)


def test_columns_and_blocks_can_be_sent():
    test = make_single_point(3, 20, random_state=0)
    pairs = np.array([[0, 1], [2, 3]])
    columns = columns_of(test.arm, Terms(pairs, True, True, True))
    again = pickle.loads(pickle.dumps(columns))
    assert_array_equal(again.at(test.data), columns.at(test.data))
    n = len(test.data)
    block = _sums._Block(
        [slice(0, n)], 9, columns, test.data, test.target, np.tile(np.eye(3), (n, 1, 1))
    )
    (rows,) = block.gram_rows(np.array([1]))
    assert_array_equal(pickle.loads(pickle.dumps(block)).gram_rows(np.array([1]))[0], rows)
    waves = columns.at(test.data)[:, :, :4].reshape(-1, 4)
    assert_allclose(rows, waves[:, 2:].T @ waves, rtol=1e-9, atol=1e-12)
