"""Triangular factors of blocks of rows, against NumPy's QR of all rows at once."""

import numpy as np
import pytest

from sklearn_raacmm.network._least_squares import stack_triangles, triangular_factor


def magnitudes(rows):
    return np.abs(np.linalg.qr(rows, mode="r"))


@pytest.mark.parametrize("sizes", [(50, 7), (7, 7), (3, 7), (200, 80), (0, 5)])
@pytest.mark.parametrize("further", [3, 7, 90])
def test_factors_of_two_blocks_are_those_of_all_rows(sizes, further):
    rng = np.random.default_rng(0)
    upper, lower = rng.normal(size=sizes), rng.normal(size=(further, sizes[1]))
    expected = magnitudes(np.vstack([upper, lower]))
    R = triangular_factor(upper.copy())
    # Rows that are a triangle themselves, and rows that are none, as those of a ridge.
    for below in (triangular_factor(lower.copy()), lower):
        found = stack_triangles(R, below)
        assert not np.any(np.tril(found, -1))
        np.testing.assert_allclose(np.abs(found), expected, rtol=1e-9, atol=1e-12)


def test_small_columns_keep_their_digits():
    # A Gram matrix would lose columns below 1e-8 of the largest.
    rng = np.random.default_rng(1)
    scale = 10.0 ** -np.arange(14)
    rows = rng.normal(size=(300, 14))
    found = triangular_factor(rows * scale) / scale
    np.testing.assert_allclose(np.abs(found), magnitudes(rows), rtol=1e-9, atol=1e-13)
