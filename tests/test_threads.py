"""The same data and seed give the same models, whatever number of threads BLAS may use."""

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from sklearn_raacmm import Arm, ArmResidualRegressor, RBFNetRegressor


def blas_threads():
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def fitted(n_threads):
    """Bytes of models of so many rows that their products are split between threads."""
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (300, 3))
    y = np.stack([np.sin(4 * X[:, 0]) * X[:, 1], X[:, 2] ** 2], axis=1)
    y += 0.05 * rng.standard_normal(y.shape)
    angles = rng.uniform(-2, 2, (300, 6))
    bends = 0.05 * np.cos(angles[:, :3] + angles[:, 3:]) + 0.01 * rng.standard_normal((300, 3))
    with threadpool_limits(n_threads, user_api="blas"):
        if blas_threads() != {n_threads}:
            pytest.skip(f"BLAS cannot be given {n_threads} threads here")
        apart, shared = (
            RBFNetRegressor(60, shared=bool(s), random_state=0).fit(X, y) for s in (0, 1)
        )
        model = ArmResidualRegressor(Arm.from_name("aacmm6"), orders=8).fit(angles, bends)
        return [apart.coef_, apart.length_scale_, shared.coef_, shared.centers_, model.coef_]


def test_number_of_blas_threads_changes_nothing():
    for one, two in zip(fitted(1), fitted(2), strict=True):
        np.testing.assert_array_equal(one, two)
