"""What the tests of all formats share."""

import pytest

from sklearn_raacmm.datasets import make_single_point

from ._chains import form_b


@pytest.fixture(scope="session")
def data():
    return make_single_point(n_positions=8, n_poses=15, random_state=0)


@pytest.fixture(scope="session")
def chain(data):
    """A fitted chain of pose, cylindrical frame and network, which no test may change."""
    return form_b(data.arm).fit(data.data, data.target)
