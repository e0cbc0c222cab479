"""Many fits and predictions need no more memory than a few, and a fitted model forgets its data."""

import gc
import pickle
import tracemalloc
import weakref

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
)

ARM = Arm.from_name("aacmm6")
NETWORK = RBFNetRegressor(5, length_scale=1.0, alpha=0.01)
MODELS = {
    "network": NETWORK,
    "network that tunes itself": RBFNetRegressor(5, random_state=0),
    "chain": make_pipeline(
        PoseFeatures(ARM, append_azimuth=True), CylindricalResidualTarget(NETWORK)
    ),
    # Orders that these data never show: the number of columns stays the same.
    "harmonics": ArmResidualRegressor(ARM, orders=[50, 51], causes=["kinematics", "wobble"]),
}


def data(n):
    angles = np.arange(1, n + 1)[:, None] * np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0]) % 1 - 0.5
    return angles, 0.05 * np.cos(angles[:, :3])


def held():
    """Bytes that Python and numpy hold, once garbage is gone; the process' own size also moves with
    what other tests left in its heap."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", ["network", "chain", "harmonics"])
def test_memory_does_not_grow(name):
    model, (X, y) = MODELS[name], data(200)

    def use(times):
        for _ in range(times):
            model.fit(X, y).predict(X)
        return held()

    tracemalloc.start()
    try:
        before = use(3)
        growth = use(15) - before
    finally:
        tracemalloc.stop()
    # Two thirds of X kept by every fit would be that much; what is kept for reuse takes 50 kB.
    assert growth < 10 * X.nbytes


@pytest.mark.parametrize("name", MODELS)
def test_a_fitted_model_does_not_keep_its_data(name):
    X, y = data(80)
    kept = [weakref.ref(array) for array in (X, y)]
    model = MODELS[name].fit(X, y)
    del X, y
    gc.collect()
    assert [ref() for ref in kept] == [None, None]
    # Nor a copy of X or y, nor three numbers a row: 100 rows more would show.
    small = len(pickle.dumps(model))
    large = len(pickle.dumps(model.fit(*data(180))))
    assert large - small < 100 * 3 * 8
