"""One simulated run of all tests, and a correction that does something."""

from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_raacmm.datasets import make_acceptance

ALL = (
    "probing", "articulation", "length", "bidirectional", "diameter", "single-point", "volumetric",
)  # fmt: skip


@pytest.fixture(scope="session")
def data():
    return make_acceptance(ALL, random_state=1)


@pytest.fixture(scope="session")
def model():
    return SimpleNamespace(predict=lambda q: 0.03 * np.sin(q[:, :3] + q[:, 3:]))
