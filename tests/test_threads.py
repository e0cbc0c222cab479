"""The same data and seed give the same models, whatever number of threads BLAS may use."""

import os
import subprocess
import sys

import pytest

FIT = """
import hashlib
import numpy as np
from threadpoolctl import threadpool_info
from sklearn_raacmm import Arm, ArmResidualRegressor, RBFNetRegressor

rng = np.random.default_rng(0)
X = rng.uniform(-1, 1, (700, 3))
y = np.stack([np.sin(4 * X[:, 0]) * X[:, 1], X[:, 2] ** 2], axis=1)
y += 0.05 * rng.standard_normal(y.shape)
blas = max([p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas"], default=0)
for shared in (False, True):
    model = RBFNetRegressor(shared=shared, random_state=0).fit(X, y)
    digest = hashlib.sha256()
    for array in (model.center_indices_, model.length_scale_, model.alpha_, model.coef_):
        digest.update(np.ascontiguousarray(array).tobytes())
    print(blas, len(model.centers_), digest.hexdigest())
angles = rng.uniform(-2, 2, (700, 6))
y = 0.05 * np.cos(angles[:, :3] + angles[:, 3:]) + 0.01 * rng.standard_normal((700, 3))
model = ArmResidualRegressor(Arm.from_name("aacmm6"), orders=12).fit(angles, y)
print(blas, 0, hashlib.sha256(model.predict(angles[:50]).tobytes()).hexdigest())
"""


def _fit(n_threads):
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    done = subprocess.run(
        [sys.executable, "-c", FIT],
        env=os.environ | dict.fromkeys(names, str(n_threads)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [line.split(maxsplit=1) for line in done.stdout.splitlines()]


def test_number_of_blas_threads_changes_nothing():
    one, two = _fit(1), _fit(2)
    if int(one[0][0]) == int(two[0][0]):
        pytest.skip("BLAS cannot be given another number of threads here")
    assert [digest for _, digest in one] == [digest for _, digest in two]
