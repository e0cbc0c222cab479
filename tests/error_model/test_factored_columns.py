"""Columns that are kept as factors, and standard deviations that are made of them."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sklearn_raacmm import Arm
from sklearn_raacmm.error_model import LinearModel, Terms
from sklearn_raacmm.error_model._columns import Root, columns_of

ARM = Arm.from_name("ur10", joint_signs=[1, -1, 1, 1, 1, -1], probe=(3.0, -8.0, 120.0))
EXTRA = (("temperature", (20.0,)), ("direction 2", (0.0,)), ("force x", (1.5,)))


def some_model(n_orders, rng, triangle=True, extra=()):
    """Model of random numbers with so many orders of each joint."""
    pairs = np.array([(j, k) for j in range(6) for k in range(1, n_orders + 1)])
    terms = Terms(pairs.reshape(-1, 2), True, True, True, extra)
    n = columns_of(ARM, terms).at(np.zeros((1, 6 + len(extra)))).shape[2]
    half = np.triu(rng.normal(size=(n, n)))[::-1]
    half = np.concatenate([half[-2 * len(pairs) :], half[: -2 * len(pairs)]])
    if not triangle:
        half = half @ np.linalg.qr(rng.normal(size=(n, n)))[0]
    coef = rng.normal(size=n)
    gains = np.zeros(len(pairs))
    none, layout = np.zeros(ARM.n_joints), columns_of(ARM, terms)
    # Positions without offsets hide nothing.
    seen, ranges = np.zeros((0, n)), np.array([[-3.0] * 6, [3.0] * 6])
    return LinearModel(layout, coef, half, none, 1.0, none, {}, False, 0.0, gains, seen, ranges)


@pytest.mark.parametrize("n_orders", [0, 3, 30])  # few and many: two ways of computing
@pytest.mark.parametrize("extra", [(), EXTRA])
def test_factors_are_the_columns(n_orders, extra):
    rng = np.random.default_rng(n_orders)
    model = some_model(n_orders, rng, extra=extra)
    values = [rng.uniform(15, 30, 40), rng.choice([-1.0, 1.0], 40), rng.choice([1.0, 2.0], 40)]
    X = np.column_stack([rng.uniform(-3, 3, (40, 6)), *values[: len(extra)]])
    columns = columns_of(ARM, model.terms)
    explicit, found = columns.at(X), columns.factored(X)
    mean = explicit @ model.coef
    assert_allclose(found.dot(model.coef), mean, atol=1e-12 * np.abs(mean).max())
    # Roots of full and of lower rank: below that of the columns without runs of waves, too.
    for rank in (len(model.coef), len(model.coef) - 5, 7):
        half = model.half[:, :rank]
        squares = np.square(explicit @ half).sum(axis=2)
        assert_allclose(found.squares(Root(half, columns.runs)), squares, rtol=1e-11)


@pytest.mark.parametrize("n_orders", [3, 30])
def test_standard_deviations_need_no_full_root(n_orders):
    """A root that is full, as after a gauge was taken out, becomes a triangle."""
    rng = np.random.default_rng(5)
    model = some_model(n_orders, rng, triangle=False)
    X = rng.uniform(-3, 3, (300, 6))
    expected = np.sqrt(np.square(model.columns(X) @ model.half).sum(axis=2))
    assert_allclose(model.predict(X, return_std=True)[1], expected, rtol=1e-11)
    assert np.all(np.triu(model._std_root.own, 1) == 0)
    other = replace(
        model, half=2 * model.half, informed_half=model.half
    )  # what was kept belongs to one model
    _, std, doubt = other.predict_with_doubt(X, return_std=True)
    assert_allclose(std, 2 * expected, rtol=1e-11)
    assert_allclose(doubt, np.linalg.norm(expected, axis=1), rtol=1e-11)  # by a root of its own
    assert_allclose(model.predict_with_doubt(X)[2], doubt, rtol=1e-11)
    again = pickle.loads(pickle.dumps(model))
    assert "_std_root" not in vars(again)
    assert_allclose(again.predict(X, return_std=True)[1], expected, rtol=1e-11)
