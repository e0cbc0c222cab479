import pickle

import numpy as np
import pytest
import sklearn
from numpy.testing import assert_allclose
from scipy.optimize import minimize, nnls
from scipy.stats import chi2
from sklearn.linear_model import Ridge
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_score

from sklearn_raacmm import metrics
from sklearn_raacmm.metrics import _acceptance


@pytest.fixture
def scattered():
    """Points at four places of unequal size, far from the origin, rows shuffled."""
    rng = np.random.default_rng(3)
    groups = rng.permutation(np.repeat(["a", "b", "c", "d"], [5, 9, 30, 2]))
    centers = {label: rng.uniform(-1000, 1000, 3) for label in "abcd"}
    points = np.array([centers[g] for g in groups]) + rng.normal(scale=0.03, size=(46, 3))
    return points, groups


@pytest.mark.parametrize("statistic", ["2s", "max", "mean"])
def test_repeatability_is_its_textbook_formula_position_by_position(scattered, statistic):
    points, groups = scattered
    expected = []
    for label in "abcd":
        own = points[groups == label]
        if statistic == "2s":
            # sum of the variances of the coordinates = variance of the distance from the mean
            expected.append(2 * np.sqrt(np.trace(np.cov(own.T))))
        else:
            delta = np.linalg.norm(own - own.mean(axis=0), axis=1)
            expected.append(getattr(np, statistic)(delta))
    values = metrics.single_point_repeatability(points, groups, statistic=statistic, aggregate=None)
    assert_allclose(values, expected, rtol=1e-9)
    for aggregate in ("mean", "max"):
        assert metrics.single_point_repeatability(
            points, groups, statistic=statistic, aggregate=aggregate
        ) == pytest.approx(getattr(np, aggregate)(expected), rel=1e-9)


def test_axis_repeatability_against_numpy(scattered):
    points, groups = scattered
    own = [points[groups == label] for label in "abcd"]
    halves = np.array([np.ptp(p, axis=0) / 2 for p in own])
    found = metrics.axis_repeatability(points, groups, aggregate=None)
    assert_allclose(found, halves, rtol=1e-9)
    found = metrics.axis_repeatability(points, groups, statistic="2s", aggregate="max")
    expected = np.max([2 * p.std(axis=0, ddof=1) for p in own], axis=0)
    assert_allclose(found, expected, rtol=1e-9)
    mean = halves.mean(axis=0)
    for options in ({}, {"aggregate": "mean"}, {"statistic": "half_range"}):
        assert_allclose(metrics.axis_repeatability(points, groups, **options), mean)


def test_r2_is_that_of_a_regression_with_a_dummy_variable_per_position(scattered):
    points, groups = scattered
    x = np.random.default_rng(1).normal(size=(len(points), 2))
    dummies = (groups[:, None] == np.unique(groups)).astype(float)
    y = points
    coef, full, *_ = np.linalg.lstsq(np.hstack([x, dummies]), y, rcond=None)
    only = np.linalg.lstsq(dummies, y, rcond=None)[1]
    score = metrics.within_position_r2_score(y, x @ coef[:2], groups=groups)
    assert score == pytest.approx(1 - full.sum() / only.sum(), rel=1e-6)


def _regression_problem():
    rng = np.random.default_rng(5)
    X, groups = rng.uniform(-1, 1, (80, 3)), np.repeat(np.arange(8), 10)
    offset = rng.normal(size=8)[groups]
    y = X @ rng.normal(size=(3, 3)) + offset[:, None] + 0.01 * rng.normal(size=(80, 3))
    return X, y, groups


def _scores_by_hand(estimator, X, y, groups, **options):
    return [
        -metrics.single_point_repeatability(
            y[test] - sklearn.clone(estimator).fit(X[train], y[train]).predict(X[test]),
            groups[test],
            **options,
        )
        for train, test in GroupKFold(4).split(X, y, groups)
    ]


@pytest.mark.parametrize("routing", [True, False])
@pytest.mark.parametrize("container", ["numpy", "pandas"])
def test_scorer_in_cross_validation_and_search(routing, container):
    X, y, groups = _regression_problem()
    by_hand = {a: _scores_by_hand(Ridge(a), X, y, groups) for a in (0.01, 100.0)}
    if container == "pandas":
        X = pytest.importorskip("pandas").DataFrame(X, columns=list("abc"))
    with sklearn.config_context(enable_metadata_routing=routing):
        known = () if routing else (X, groups)
        scoring = metrics.repeatability_scorer(*known)
        passed = {"params": {"groups": groups}} if routing else {"groups": groups}
        scores = cross_val_score(Ridge(0.01), X, y, cv=GroupKFold(4), scoring=scoring, **passed)
        search = GridSearchCV(
            Ridge(), {"alpha": list(by_hand)}, cv=GroupKFold(4), scoring=scoring, n_jobs=1
        ).fit(X, y, groups=groups)
    assert_allclose(scores, by_hand[0.01])
    assert_allclose(search.cv_results_["mean_test_score"], [np.mean(s) for s in by_hand.values()])


@pytest.mark.parametrize("routing", [True, False])
def test_scorer_travels_to_other_processes_and_keeps_its_options(routing):
    X, y, groups = _regression_problem()
    expected = -metrics.single_point_repeatability(y, groups, statistic="max", aggregate="max")
    known = () if routing else (X, groups)
    zero = Ridge(1e30, fit_intercept=False).fit(X, y)
    with sklearn.config_context(enable_metadata_routing=routing):
        scorer = metrics.repeatability_scorer(*known, statistic="max", aggregate="max")
        scorer = pickle.loads(pickle.dumps(scorer))
        score = scorer(zero, X, y, groups=groups) if routing else scorer(zero, X, y)
    assert score == pytest.approx(expected)


@pytest.mark.parametrize(("first", "then"), [(int, float), (float, int), (float, np.float32)])
def test_scorer_knows_a_row_in_another_number_type(first, then):
    X, y, groups = np.arange(24).reshape(12, 2), np.ones((12, 3)), np.repeat([0, 1, 2], 4)
    scorer = metrics.repeatability_scorer(X.astype(first), groups, statistic="mean")
    model = Ridge(1e-9).fit(X, y)
    assert scorer(model, X.astype(then), y) == pytest.approx(0, abs=1e-6)


def test_scorer_refuses_to_guess_the_groups():
    X, y, groups = _regression_problem()
    model = Ridge().fit(X, y)
    with pytest.raises(RuntimeError, match="needs metadata routing, which is off"):
        metrics.repeatability_scorer()
    with sklearn.config_context(enable_metadata_routing=True):
        scorer = metrics.repeatability_scorer()
        with pytest.raises(ValueError, match="got no groups"):
            scorer(model, X, y)
    with pytest.raises(ValueError, match="2 of 80 rows were not in the X"):
        metrics.repeatability_scorer(X[2:], groups[2:])(model, X, y)
    with pytest.raises(ValueError, match="belongs to the groups 0 and 1"):
        metrics.repeatability_scorer(X[[0, 1, 0]], [0, 0, 1])
    with pytest.raises(ValueError, match="together"):
        metrics.repeatability_scorer(X)


def test_gauge_lengths_and_errors_by_hand():
    points = np.array([[0.0, 0, 0.1], [0, 0, -0.1], [0, 300.03, 0], [400, 300, 0], [400, 0, 0]])
    groups = ["origin", "origin", "y", "xy", "x"]
    pairs = [("origin", "y"), ("origin", "xy"), ("xy", "x")]
    lengths = metrics.gauge_lengths(points, groups, pairs)
    assert_allclose(lengths, [300.03, 500, 300])
    calibrated = [300, 500.04, 300.01]
    assert_allclose(metrics.length_error(lengths, calibrated), [0.03, -0.04, -0.01])
    assert_allclose(metrics.length_error([300.1, 299.9], 300), [0.1, -0.1])


def test_sphere_fit_is_the_optimum_that_a_general_optimizer_finds():
    rng = np.random.default_rng(8)
    directions = rng.normal(size=(25, 3)) * [1, 1, 0.6]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = [700, -300, 150] + (12.7 + 0.02 * rng.normal(size=(25, 1))) * directions

    def cost(x):
        return ((np.linalg.norm(points - x[:3], axis=1) - x[3]) ** 2).sum()

    options = {"xatol": 1e-9, "fatol": 1e-15, "maxiter": 5000, "maxfev": 5000}
    best = minimize(cost, [700, -300, 150, 12.7], method="Nelder-Mead", options=options)
    center, radius, _ = _acceptance.fit_sphere(points)
    assert cost([*center, radius]) <= best.fun + 1e-12
    assert_allclose([*center, radius], best.x, atol=2e-6)


@pytest.mark.parametrize(
    ("points", "radius"),
    [
        ([[0, 0, 0], [2, 0, 0]], 1),
        ([[0, 0, 0], [2, 0, 0], [1, 0.5, 0]], 1),  # obtuse: the long side decides
        ([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0]], 1 / np.sqrt(3)),
        ([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.sqrt(3)),
        ([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.sqrt(3) / 2),
        ([[3, 3, 3]] * 4, 0),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0], [5, 0, 0]], 2.5),
    ],
)
def test_minimum_enclosing_sphere_in_closed_form(points, radius):
    center, found = _acceptance.minimum_enclosing_sphere(np.asarray(points, dtype=float))
    assert found == pytest.approx(radius, abs=1e-12)
    assert np.linalg.norm(points - center, axis=1).max() == pytest.approx(radius, abs=1e-9)


@pytest.mark.parametrize("n", [5, 8, 200])
def test_no_smaller_sphere_holds_all_points(n):
    """All lie within, and the centre is a mean of those on it: the condition of an optimum."""
    rng = np.random.default_rng(n)
    for _ in range(5):
        points = rng.normal(size=(n, 3)) * [1, 0.4, 0.1]
        center, radius = _acceptance.minimum_enclosing_sphere(points)
        away = (points - center) / radius
        far = np.linalg.norm(away, axis=1)
        assert far.max() <= 1 + 1e-9
        on = away[far >= 1 - 1e-9].T
        assert nnls(np.vstack([on, np.ones(on.shape[1])]), [0, 0, 0, 1])[1] < 1e-7


def test_articulated_location_from_probed_points_is_that_of_the_centres():
    rng = np.random.default_rng(2)
    centers = rng.normal([800, 100, 50], 0.02, size=(5, 3))
    five = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]])
    points = (centers[:, None] + 12.5 * five).reshape(-1, 3)
    groups = np.repeat(list("vwxyz"), 5)
    from_centers = metrics.articulated_location_error(centers)
    assert metrics.articulated_location_error(points, groups) == pytest.approx(from_centers)
    farthest = max(np.linalg.norm(a - b) for a in centers for b in centers)
    # Jung's theorem: the diameter lies between the largest distance and sqrt(3/2) of it.
    assert farthest * (1 - 1e-9) <= from_centers <= farthest * np.sqrt(1.5)


def test_a_scorer_refuses_masked_rows():
    rows = np.arange(12.0).reshape(4, 3)
    scorer = metrics.repeatability_scorer(rows, [1, 1, 2, 2])
    with pytest.raises(ValueError, match=r"^X has 1 of 12 values masked"):
        scorer(Ridge(), np.ma.masked_equal(rows, 5), np.zeros((4, 3)))


def test_the_ends_are_those_of_chi_squared():
    rng = np.random.default_rng(0)
    n, sds = 25, np.array([[0.3, 0.3, 0.3], [1.2, 0.2, 0.4]])
    groups = np.repeat(["far", "near"], n)
    points = np.repeat(sds, n, axis=0) * rng.normal(size=(2 * n, 3))
    found = metrics.repeatability_interval(points, groups, aggregate=None)
    for label, (low, high) in zip(("far", "near"), found, strict=True):
        values = np.linalg.eigvalsh(np.cov(points[groups == label].T))
        free = (n - 1) * values.sum() ** 2 / np.sum(values**2)
        assert low == pytest.approx(2 * np.sqrt(values.sum() * free / chi2.ppf(0.975, free)))
        assert high == pytest.approx(2 * np.sqrt(values.sum() * free / chi2.ppf(0.025, free)))
    # Of one direction only: n - 1 degrees of freedom, exactly.
    line = points[:, :1]
    low, high = metrics.repeatability_interval(line[:n])
    sd = line[:n].std(ddof=1)
    assert low == pytest.approx(2 * sd * np.sqrt((n - 1) / chi2.ppf(0.975, n - 1)))
    low, high = metrics.repeatability_interval(line[:n], ["a"] * n, probability=0.5)
    assert high == pytest.approx(2 * sd * np.sqrt((n - 1) / chi2.ppf(0.25, n - 1)))
    assert_allclose(metrics.repeatability_interval(np.ones((4, 3))), 0.0, atol=1e-300)


@pytest.mark.parametrize("statistic", ["2s", "mean"])
@pytest.mark.parametrize(("n_positions", "n"), [(3, 10), (4, 12), (10, 20)])
def test_intervals_hold_what_they_promise(statistic, n_positions, n):
    rng = np.random.default_rng(1)
    sds = np.linspace(0.5, 1.5, n_positions)[:, None] * [2.0, 1.0, 0.7]
    groups = np.repeat(np.arange(n_positions), n)
    many = np.random.default_rng(2).normal(size=(100_000, 3)) * [2.0, 1.0, 0.7]
    size = {"2s": 2 * np.sqrt(5.49), "mean": np.linalg.norm(many, axis=1).mean()}[statistic]
    true = size * np.linspace(0.5, 1.5, n_positions)
    held, held_mean = [], []
    for _ in range(400):
        points = sds[groups] * rng.normal(size=(len(groups), 3))
        each = metrics.repeatability_interval(points, groups, statistic=statistic, aggregate=None)
        held.append(np.mean((each[:, 0] < true) & (true < each[:, 1])))
        low, high = metrics.repeatability_interval(points, groups, statistic=statistic)
        held_mean.append(low < true.mean() < high)
    # Four standard errors of 400 about what ``benchmarks/bench_lengths.py repeatability`` shows.
    assert 0.92 < np.mean(held) < 0.985
    assert 0.90 < np.mean(held_mean) < 0.995
