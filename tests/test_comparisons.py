"""The long comparisons run, small, and their numbers are those of loops written out by hand."""

import numpy as np
import pytest
from sklearn.linear_model import Ridge
from sklearn.model_selection import GroupKFold
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm.datasets import make_gauge, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability


def nested_fourier(cone, module, n_folds):
    """Fourier ridge in nested cross-validation by position, without scikit-learn's tools for it."""
    phi = cone.arm.azimuth(cone.data)
    turn = np.zeros((len(phi), 3, 3))  # Cartesian to radial, tangential, axial
    turn[:, 0, :2] = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    turn[:, 1, :2] = np.stack([-np.sin(phi), np.cos(phi)], axis=1)
    turn[:, 2, 2] = 1
    y = np.einsum("nij,nj->ni", turn, cone.target)

    def predict(train, test, order, alpha):
        X = module.fourier_terms(cone.data, order, [1, 2, 3])
        scaler = StandardScaler().fit(X[train])
        # Constants of positions drop out of what is centred at each.
        labels = np.equal.outer(cone.groups[train], np.unique(cone.groups[train]))
        within = np.eye(len(train)) - labels @ (labels / labels.sum(axis=0)).T
        model = Ridge(alpha, fit_intercept=False)
        model.fit(within @ scaler.transform(X[train]), within @ y[train])
        return np.einsum("nji,nj->ni", turn[test], model.predict(scaler.transform(X[test])))

    def left(train, test, *setting):
        after = cone.target[test] - predict(train, test, *setting)
        return single_point_repeatability(after, cone.groups[test])

    settings = [(order, alpha) for order in (1, 2, 3) for alpha in module.ALPHAS]
    correction = np.zeros_like(y)
    for train, test in GroupKFold(n_folds).split(y, groups=cone.groups):
        inner = GroupKFold(min(3, len(np.unique(cone.groups[train]))))
        splits = [(train[a], train[b]) for a, b in inner.split(train, groups=cone.groups[train])]
        scores = [np.mean([left(a, b, *s) for a, b in splits]) for s in settings]
        correction[test] = predict(train, test, *settings[np.argmin(scores)])
    return single_point_repeatability(cone.target - correction, cone.groups, aggregate=None)


@pytest.mark.exhaustive
def test_quick_comparison(script, capsys):
    module, data_sets = script("_regressors"), script("_data_sets")
    problem = data_sets.simulated("typical", 0, 4, 32, 2)
    records = data_sets.compare(problem, list(module.MODELS), jobs=1)
    printed = capsys.readouterr().out

    rows = {(record["inputs"], record["regressor"]): record for record in records}
    assert len(rows) == len(module.MODELS) + 2
    assert all(f"{inputs:<24}  {name}" in printed for inputs, name in rows)
    cone = make_single_point(4, 32)
    before = single_point_repeatability(cone.points, cone.groups, aggregate=None)
    after = nested_fourier(cone, module, 2)
    uncorrected, fourier = rows["-", "uncorrected"], rows["theta2 to theta4", "Fourier ridge"]
    assert uncorrected["two_s_mean_mm"] == pytest.approx(before.mean())
    assert fourier["two_s_mean_mm"] == pytest.approx(after.mean())
    assert fourier["two_s_max_mm"] == pytest.approx(after.max())
    assert fourier["less"] == pytest.approx(1 - after.mean() / before.mean())
    perfect = rows["-", "perfect model"]
    gain, possible = (before.mean() - left for left in (after.mean(), perfect["two_s_mean_mm"]))
    assert fourier["of_possible"] == pytest.approx(gain / possible)
    assert perfect["of_possible"] == 1

    # A gauge's length by hand.
    gauge = make_gauge()
    errors = [
        np.linalg.norm(np.subtract(*(gauge.points[gauge.groups == end].mean(axis=0) for end in p)))
        for p in gauge.pairs[:10]
    ] - gauge.lengths[:10]
    assert uncorrected["length_300_mean_mm"] == pytest.approx(np.abs(errors).mean())


def test_fourier_terms_span_products_of_waves(script):
    module = script("_regressors")
    angles = np.random.default_rng(0).uniform(-3, 3, (500, 6))
    X = module.fourier_terms(angles, 3, [1, 2, 3])
    assert X.shape[1] == 62  # half of the 62 triples of whole numbers of size 1 to 3, twice
    a, b, c = angles[:, 1:4].T
    product = np.cos(a) * np.sin(b) * np.cos(c)
    coef = np.linalg.lstsq(X, product, rcond=None)[0]
    np.testing.assert_allclose(X @ coef, product, atol=1e-12)
    beyond = np.cos(4 * a)
    left = beyond - X @ np.linalg.lstsq(X, beyond, rcond=None)[0]
    assert np.std(left) > 0.5
