"""What the tests of all formats share."""

import pytest

from sklearn_raacmm.datasets import make_single_point


@pytest.fixture(scope="session")
def data():
    return make_single_point(n_positions=8, n_poses=15, random_state=0)
