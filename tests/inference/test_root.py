"""The Cholesky factor says what it could not factor."""

import numpy as np
import pytest
from scipy.linalg import LinAlgError

from sklearn_raacmm.inference._linear import root_of


def test_a_matrix_without_a_factor_is_described():
    matrix = np.diag([4.0, 1.0, -0.5])
    with pytest.raises(LinAlgError, match=r"equations of 3 coefficients .* -0\.5 to 4, .*3-th"):
        root_of(matrix)


def test_what_rounding_has_eaten_is_given_back():
    matrix = np.ones((3, 3)) + 1e-9 * np.eye(3)
    root = root_of(matrix)
    np.testing.assert_allclose(root.T @ root, matrix, atol=1e-7)
