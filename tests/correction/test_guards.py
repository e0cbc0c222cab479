"""Fading and cap on the sum of the stages, by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm.correction._guards import guarded
from sklearn_raacmm.error_model import Fading


def test_a_cap_shortens_what_is_longer_and_nothing_else():
    """Directions stay; corrections below the cap are untouched, however short they are."""
    parts = [
        (np.array([[0.3, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.0]]), None),
        (np.array([[0.0, 0.4, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.0]]), None),
    ]
    fadings = [Fading(1.0, 0.0), Fading(1.0, 0.0)]
    correction, share = guarded(parts, fadings, 0.1, 3)
    assert_allclose(correction, [[0.06, 0.08, 0], [0, 0.03, 0], [0, 0, 0]], rtol=1e-12)
    assert_allclose(share, 1.0)
    assert_allclose(guarded(parts, fadings, np.inf, 3)[0], parts[0][0] + parts[1][0])


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_each_stage_fades_by_itself_and_the_smallest_share_is_told(order):
    std = np.array([[0.3, 0.0, 0.4]])  # of length 0.5
    known = Fading(size_mm=0.5, factor=1.0), Fading(size_mm=0.5, factor=2.0)
    parts = [(np.array([[1.0, 0, 0]]), std), (np.array([[0, 1.0, 0]]), std)]
    correction, share = guarded([parts[i] for i in order], [known[i] for i in order], np.inf, 1)
    assert_allclose(correction, [[0.5, 0.2, 0.0]], rtol=1e-12)
    assert_allclose(share, 0.2, rtol=1e-12)
