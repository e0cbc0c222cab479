"""The long comparisons run, small, and their numbers are those of loops written out by hand."""

import numpy as np
import pytest
from sklearn.linear_model import Ridge
from sklearn.model_selection import GroupKFold
from sklearn.preprocessing import StandardScaler
from sklearn.utils import Bunch

from sklearn_raacmm import Arm
from sklearn_raacmm.datasets import make_gauge, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability


def placements_of(data, some):
    """Some rows of a Panda's series, as fetched."""
    placements = data.placements[some]
    return Bunch(
        data=data.angles[some],
        groups=data.groups[some],
        placements=placements,
        lengths=[(f"{p}/0", f"{p}/1", 50, 0.1) for p in np.unique(placements)],
        nominal_arm=Arm.from_name("panda", probe=(0, 0, 241)),
    )


def goals_of(ur10, some):
    """Some rows of the UR10's series, as fetched."""
    return Bunch(
        data=ur10.angles[some],
        tracker_points=ur10.points[some],
        groups=np.unique(ur10.groups[some], return_inverse=True)[1],
        nominal_arm=Arm.from_name("ur10", probe=(0, 0, 93)),
    )


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
        model = Ridge(alpha).fit(scaler.transform(X[train]), y[train])
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


@pytest.mark.filterwarnings("ignore:At other poses")  # few goals are alike
def test_compare_regressors_on_real_data(script, panda, ur10, monkeypatch):
    """Small pieces of the real series: what is uncorrected is what calibration left."""
    module = script("_data_sets")
    data = panda("panda_3")
    some = np.isin(data.placements, ["backleft", "frontcenter", "frontright"])
    some &= np.arange(len(some)) % 2 == 0
    few = placements_of(data, some)
    monkeypatch.setattr(module, "fetch_panda_ball_socket", lambda arm, data_home: few)
    problem = module.panda("panda_3", None)
    results = module.assess(problem, [0 * points for points in problem.measured])
    spread = [
        single_point_repeatability(points[fold.positions[fold.test] == socket])
        for fold, points in zip(problem.folds, problem.measured, strict=True)
        for socket in np.unique(fold.positions[fold.test])
    ]
    assert results["two_s_mean_mm"] == pytest.approx(np.mean(spread))
    for fold in problem.folds:
        held_out = np.unique(fold.splits[fold.test])
        assert len(held_out) == 1
        assert held_out[0] not in fold.splits[fold.learn]

    some = np.isin(ur10.groups, np.arange(0, 619, 60))
    few = goals_of(ur10, some)
    monkeypatch.setattr(module, "fetch_ur10_tracker", lambda data_home: few)
    problem = module.ur10(len(few.groups), None)
    results = module.assess(problem, [0 * points for points in problem.measured])
    left = np.concatenate([fold.residuals[fold.test] for fold in problem.folds])
    assert results["mean_mm"] == pytest.approx(np.mean(np.linalg.norm(left, axis=1)))
    prediction, costs = script("_regressors").run(
        ("pose angles", "Gaussian process"), problem.folds[0], max_gp_rows=40
    )
    assert prediction.shape == (len(problem.folds[0].test), 3)
    assert len(costs) == 3
