"""Sums of many orders on a grid of angles, against the sums as they stand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm
from sklearn_raacmm.error_model import _wave_sums
from sklearn_raacmm.error_model._columns import Terms
from sklearn_raacmm.error_model._order_scan import candidate_sums
from sklearn_raacmm.error_model._wave_sums import WaveSums, sums_of_doubles


@pytest.mark.parametrize(
    "orders", [np.arange(1, 401), np.arange(1, 1001), np.r_[1:130, 200, 640], np.arange(3, 400, 3)]
)
def test_grid_is_exact_to_the_last_digits(orders):
    """Also where poses come in parts, and at angles of several turns of either sign."""
    rng = np.random.default_rng(len(orders))
    theta = np.r_[rng.uniform(-9, 9, 294), 0.0, -1e-17, np.pi, -np.pi, 2 * np.pi, 1e-300]
    columns = rng.normal(size=(300, 3))
    sums = WaveSums(orders, 300)
    assert sums._grid is not None
    for rows in (slice(7), slice(7, 300)):
        sums.add(theta[rows], columns[rows])
    phase = theta[:, None] * orders
    expected = np.stack([columns.T @ np.cos(phase), columns.T @ np.sin(phase)], axis=2)
    atol = 4e-16 * orders[-1] * np.linalg.norm(columns, axis=0).max() * 9  # of the phases
    assert_allclose(sums.result(), expected.reshape(3, -1), rtol=0, atol=atol)
    double = sums_of_doubles(theta, columns[:, 0], orders)
    assert_allclose(double, columns[:, 0] @ np.exp(2j * phase), rtol=0, atol=2 * atol)


@pytest.mark.parametrize("with_offsets", [False, True])
def test_sums_of_candidates_are_the_same_on_the_grid(with_offsets, monkeypatch):
    arm = Arm.from_name("aacmm6")
    rng = np.random.default_rng(1)
    theta, y, weights = (
        rng.uniform(-2, 2, (300, 6)),
        rng.normal(size=(300, 3)),
        rng.uniform(1, 2, 300),
    )
    codes = np.arange(300) // 10 if with_offsets else None
    offered = np.array([(j, k) for j in (1, 4) for k in range(1, 201)] + [(5, 3), (5, 9)])
    terms = Terms(offered, True, True, False)
    grid = candidate_sums(arm, theta, y, weights, codes, offered, terms)
    of_grid = grid.rows([3, 250, 401])
    monkeypatch.setattr(_wave_sums, "_MANY_POSES", 1000)
    plain = candidate_sums(arm, theta, y, weights, codes, offered, terms)
    for name in ("cross", "own", "candidate_moment"):
        value = getattr(plain, name)
        assert_allclose(getattr(grid, name), value, atol=1e-12 * np.abs(value).max(), rtol=0)
    assert_allclose(of_grid, plain.rows([3, 250, 401]), atol=1e-12 * plain.own.max(), rtol=0)
