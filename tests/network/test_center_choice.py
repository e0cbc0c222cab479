"""What ends the choice of centres is what is said to have ended it."""

import numpy as np
import pytest
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF

from sklearn_raacmm import RBFNetRegressor
from sklearn_raacmm.network import _centers, _fit

from ._data import rough

GIVEN = {"length_scale": 0.5, "alpha": 0.01}


def test_a_cut_factor_does_not_end_the_choice(monkeypatch):
    # What the factor leaves out says nothing of the candidates within its span: with a rank of 200
    # of 500 the choice used to end after a few dozen, as if the others depended on them.
    X, y, _ = rough(500, 4, 4)
    monkeypatch.setattr(_centers, "MAX_RANK", 200)
    with pytest.warns(ConvergenceWarning, match="lies outside the 200 dimensions"):
        model = RBFNetRegressor(**GIVEN, max_centers=130).fit(X, y)
    assert model.stop_reason_ == "max_centers"
    assert len(model.centers_) == 130
    with pytest.warns(ConvergenceWarning):
        more = RBFNetRegressor(**GIVEN, max_centers=133).fit(X, y)
    assert len(more.centers_) == 133


def test_the_rank_is_named_where_it_ended_the_choice(monkeypatch):
    X, y, _ = rough(300, 4, 4)
    monkeypatch.setattr(_centers, "MAX_RANK", 100)
    monkeypatch.setattr(_centers, "RANK_PER_CENTER", 0.1)
    with pytest.warns(ConvergenceWarning, match="of the prior variance at the candidates"):
        RBFNetRegressor(**GIVEN, max_centers=300).fit(X, y)
    # This has no goal that rounding might reach one centre earlier.
    with pytest.warns(ConvergenceWarning, match="of the prior variance at the candidates"):
        model = RBFNetRegressor(1e-9, **GIVEN).fit(X, y)
    assert model.stop_reason_ == "rank"
    assert len(model.centers_) == 100


def test_more_centres_on_demand_raise_the_rank(monkeypatch):
    X, y, _ = rough(500, 4, 4)
    monkeypatch.setattr(_centers, "MAX_RANK", 100)
    monkeypatch.setattr(_centers, "MAX_CENTERS", 60)
    monkeypatch.setattr(_fit, "takes_all_rows", lambda *args: False)
    T, _, truth = rough(400, 4, 4, seed=1)
    with pytest.warns(ConvergenceWarning) as record:
        few = RBFNetRegressor(**GIVEN).fit(X, y)
    assert any("Give a larger max_centers" in str(w.message) for w in record)
    assert len(few.centers_) == 60
    many = RBFNetRegressor(**GIVEN, max_centers=500).fit(X, y)  # and no warning
    assert many.stop_reason_ == "criterion"
    process = GaussianProcessRegressor(RBF(0.5), alpha=0.01, optimizer=None)
    exact = process.fit(X, y - y.mean()).predict(T) + y.mean()

    def error(prediction):
        return np.sqrt(np.mean((prediction - truth) ** 2))

    errors = [error(p) for p in (few.predict(T), many.predict(T), exact)]
    assert errors[1] < 1.02 * errors[2] < errors[0]
