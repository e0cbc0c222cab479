"""Fits, searches and predictions on a cluster of two local workers, and what a dead worker does."""

import os
import signal

import numpy as np
import pytest
import sklearn
from joblib import parallel_config
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_predict, cross_validate
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import CylindricalResidualTarget, PoseFeatures, RBFNetRegressor
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.network import _read

dask = pytest.importorskip("dask")
da = pytest.importorskip("dask.array")
distributed = pytest.importorskip("distributed")

pytestmark = pytest.mark.xdist_group("cluster")


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    # An error instead of waiting for ever, should all workers be lost.
    with dask.config.set({"distributed.scheduler.no-workers-timeout": "120s"}):
        cluster = distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            dashboard_address=":0",
            processes=True,
            local_directory=tmp_path_factory.mktemp("workers"),
        )
        with cluster, distributed.Client(cluster) as client:
            yield client


@pytest.fixture(autouse=True)
def few_in_memory(monkeypatch):
    monkeypatch.setattr(_read, "IN_MEMORY_ROWS", 1000)
    monkeypatch.setattr(_read, "HELD_ROWS", 400)


def rows(n=6000):
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (n, 3))
    y = np.sin(3 * X[:, 0]) + X[:, 1] * X[:, 2] + 0.1 * rng.standard_normal(n)
    return X, y, rng.uniform(0.5, 2, n)


@pytest.mark.exhaustive
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs a signal that cannot be caught")
def test_a_worker_killed_in_the_middle_of_a_fit_changes_nothing(client, tmp_path):
    X, y, weights = rows()
    model = RBFNetRegressor(25, length_scale=0.7, alpha=1e-3, random_state=0)
    expected = model.fit(X, y, sample_weight=weights).predict(X)
    chunks = da.from_array(X, chunks=(750, 3))
    targets, weights = (da.from_array(a, chunks=750) for a in (y, weights))
    flag = tmp_path / "killed"

    def die_once(block):  # in here, so that workers need not find this file
        """Kill the process that computes this block, unless that has happened before."""
        try:
            flag.touch(exist_ok=False)
        except FileExistsError:
            return block
        os.kill(os.getpid(), signal.SIGKILL)

    mortal = chunks.map_blocks(die_once, dtype=X.dtype, meta=X[:0])
    model.fit(mortal, targets, sample_weight=weights)
    assert flag.exists()
    np.testing.assert_allclose(model.predict(X), expected, atol=1e-10)


@pytest.mark.exhaustive
@pytest.mark.parametrize("backend", ["loky", "dask"])
def test_search_over_positions_with_weights_on_workers(backend, client):
    test = make_single_point(n_positions=6, n_poses=10, random_state=0)
    weights = np.random.default_rng(0).uniform(0.5, 2, len(test.data))
    with sklearn.config_context(enable_metadata_routing=True):
        scaler = StandardScaler().set_fit_request(sample_weight=False)
        network = RBFNetRegressor(length_scale=1.0, alpha=1e-2).set_fit_request(
            sample_weight=True, groups=False
        )
        target = CylindricalResidualTarget(make_pipeline(scaler, network))
        target.set_score_request(sample_weight=True)
        model = make_pipeline(PoseFeatures(test.arm, append_azimuth=True), target)
        name = "cylindricalresidualtarget__regressor__rbfnetregressor__n_centers"
        search = GridSearchCV(model, {name: [3, 6]}, cv=GroupKFold(3), n_jobs=2)
        given = {"groups": test.groups, "sample_weight": weights}
        alone = search.set_params(n_jobs=1).fit(test.data, test.target, **given)
        expected = alone.cv_results_["mean_test_score"]
        folds = {"cv": GroupKFold(3), "params": given, "n_jobs": 2}
        with parallel_config(backend=backend):
            search.set_params(n_jobs=2).fit(test.data, test.target, **given)
            scores = cross_validate(model, test.data, test.target, **folds)
            predicted = cross_val_predict(model, test.data, test.target, **folds)
        plain = cross_validate(model, test.data, test.target, **folds | {"n_jobs": 1})
        again = cross_val_predict(model, test.data, test.target, **folds | {"n_jobs": 1})
    np.testing.assert_allclose(search.cv_results_["mean_test_score"], expected, rtol=1e-10)
    np.testing.assert_allclose(scores["test_score"], plain["test_score"], rtol=1e-10)
    np.testing.assert_allclose(predicted, again, rtol=1e-8, atol=1e-12)
