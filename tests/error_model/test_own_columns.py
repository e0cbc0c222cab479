"""Columns that somebody adds to the table: those that depend on the vertical, and the others."""

import numpy as np
import pytest

from sklearn_raacmm import ArmResidualRegressor, position_residuals
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.error_model import _columns
from sklearn_raacmm.error_model._columns import ARCSEC, TURN, WOBBLE, Column, Columns, columns_of


@pytest.fixture(scope="module")
def test():
    return make_single_point(9, 16, machine="gravity", random_state=2)  # simulated


def add_column(monkeypatch, power):
    """A turn in the elbow that grows with a power of the slope of the third frame's x axis."""
    wobble, factored = _columns._wobble, Columns.factored

    def with_own(arm):
        yield from wobble(arm)
        yield Column("own", WOBBLE, TURN, 2, 0, ARCSEC)

    def with_slope(self, rows, out=None):
        found = factored(self, rows, out)
        if "own" in self.names:
            slope = self.arm.frames(rows[:, : self.arm.n_joints])[:, 2, :3, 0] @ self.up
            found.rest[:, :, self.names.index("own") - len(self.names)] *= slope[:, None] ** power
        return found

    monkeypatch.setattr(_columns, "_wobble", with_own)
    monkeypatch.setattr(Columns, "factored", with_slope)
    _columns._without_harmonics.cache_clear()
    _columns._with_harmonics.cache_clear()


@pytest.fixture(autouse=True)
def _without_own_columns():
    yield
    _columns._without_harmonics.cache_clear()
    _columns._with_harmonics.cache_clear()


@pytest.mark.parametrize("power", [1, 2])
def test_a_column_that_depends_on_the_vertical_is_fitted_along_any(monkeypatch, test, power):
    """Whether it is linear in it or not: the search turns gravity alone."""
    add_column(monkeypatch, power)
    tilted = test.arm.replace(up=(0.6, 0.0, 0.8))  # of data of an upright arm
    model = ArmResidualRegressor(tilted, orders=2)
    with pytest.warns(UserWarning, match="Gravity seems to pull against"):
        model.fit(test.data, test.target, groups=test.groups)
    terms = model.linear_model_.terms
    assert "own" in columns_of(tilted, terms).names
    assert terms.up[2] > np.cos(np.deg2rad(3))
    left = position_residuals(test.target - model.predict(test.data), test.groups)
    assert np.square(left).mean() < 0.5 * np.square(test.target).mean()
