"""Which orders are offered, what they cost, and what the choice makes of them."""

import numpy as np
import pytest

from sklearn_raacmm import ArmResidualRegressor
from sklearn_raacmm.error_model import Terms
from sklearn_raacmm.error_model._columns import ARCSEC, columns_of
from sklearn_raacmm.error_model._fit import Fit, offered_harmonics
from sklearn_raacmm.error_model._sums import Rows

from ._arms import ARM, draw_angles


def test_offered_orders():
    theta = draw_angles(ARM, 30)
    theta[:, 2] = np.arange(30) % 4
    offered = offered_harmonics(theta, 50)
    assert [np.count_nonzero(offered[:, 0] == j) for j in range(6)] == [30, 30, 4, 30, 30, 30]
    assert offered[:3].tolist() == [[0, 1], [0, 2], [0, 3]]
    # Scattered angles see high orders, too; four levels do not.
    offered = offered_harmonics(theta, 75)
    assert [np.count_nonzero(offered[:, 0] == j) for j in range(6)] == [33, 33, 4, 33, 33, 33]
    assert offered[:33, 1].tolist() == [*range(1, 31), 73, 74, 75]
    offered = offered_harmonics(theta, [[1], [3, 2], [], [], [], [500]])
    assert offered.tolist() == [[0, 1], [1, 2], [1, 3], [5, 500]]
    assert offered_harmonics(theta, [7, 1]).tolist() == [[j, k] for j in range(6) for k in (1, 7)]
    assert offered_harmonics(theta, 0).shape == (0, 2)


def with_gears(n, gears, seed=0, amplitude=4.0, noise=0.01):
    """Poses and residuals of an arm whose joints err by harmonics of these orders."""
    theta = draw_angles(ARM, n, seed)
    rng = np.random.default_rng(seed + 100)
    error = np.zeros_like(theta)
    for joint, order in gears:
        error[:, joint] += np.cos(order * theta[:, joint] - rng.uniform(0, 6))
    y = ARM.forward(theta + amplitude * ARCSEC * error) - ARM.forward(theta)
    return theta, y + rng.normal(0, noise, y.shape)


def test_orders_of_gears_are_found_by_default():
    gears = [(1, 128), (3, 256), (2, 100), (1, 1)]
    theta, y = with_gears(400, gears)
    model = ArmResidualRegressor(ARM).fit(theta, y)
    table = model.harmonics_
    assert sorted(table[["joint", "order"]][:4].tolist()) == sorted((j + 1, k) for j, k in gears)
    # Low orders cost little: one of chance may be among them, and small.
    assert np.all(table["order"][4:] < 10)
    assert np.all(table["amplitude_arcsec"][4:] < 2.0)
    assert model.noise_sd_ == pytest.approx(0.01, rel=0.1)


def test_a_model_is_not_sure_of_angles_where_it_has_no_poses():
    """Encoder tables of straight pieces: beside the poses, lines alone are far off and too sure."""
    rng = np.random.default_rng(1)
    knots = np.linspace(-np.pi, np.pi, 41)
    tables = np.deg2rad(rng.normal(scale=15 / 3600, size=(6, 41)))
    theta = rng.uniform(-2.5, 2.5, (500, 6))
    error = np.stack([np.interp(q, knots, t) for q, t in zip(theta.T, tables, strict=True)], axis=1)
    truth = np.einsum("nij,nj->ni", ARM.jacobian(theta), error)
    y = truth + rng.normal(scale=0.01, size=truth.shape)
    in_gap = np.any((theta > 0.4) & (theta < 0.9), axis=1)  # of any joint
    near = np.flatnonzero(~in_gap)[:80]
    train = np.setdiff1d(np.flatnonzero(~in_gap), near)
    columns = columns_of(ARM, Terms(offered_harmonics(theta[train], 48), False, False, False))
    rows = Rows(ARM, theta[train], y[train], np.ones(len(train)), None)
    model = Fit(rows, columns, with_field=True).model
    assert model.prior_sd["smooth"] > 1
    z = {}
    for name, rows in (("near", near), ("gap", np.flatnonzero(in_gap))):
        mean, std = model.predict(theta[rows], return_std=True)
        z[name] = np.sqrt(np.mean(np.square((mean - truth[rows]) / std)))
        if name == "gap":
            assert np.linalg.norm(mean - truth[rows]) < 0.8 * np.linalg.norm(truth[rows])
    assert 0.7 < z["near"] < 1.6
    assert 0.7 < z["gap"] < 1.6
