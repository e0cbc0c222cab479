"""Data at the edge of what has an answer: each case ends in a sentence, or in the right answer.

The right answers come from elsewhere: a closed form, a law the model obeys, NumPy's least squares.
"""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize
from sklearn.exceptions import ConvergenceWarning
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    position_residuals,
)
from sklearn_raacmm.datasets import (
    ArmErrors,
    SimulatedArm,
    make_single_point,
)
from sklearn_raacmm.display import ArmPosesDisplay, LengthErrorDisplay, RepeatabilityDisplay
from sklearn_raacmm.export import describe, fingerprint
from sklearn_raacmm.metrics import (
    articulated_location_error,
    axis_repeatability,
    gauge_lengths,
    length_error,
    probing_form_error,
    probing_size_error,
    repeatability_report,
    single_point_repeatability,
)

X = np.arange(1, 61)[:, None] * np.sqrt([2.0, 3.0]) % 1
Y = np.sin(5 * X[:, 0]) + X[:, 1]
ARM = Arm.from_name("aacmm6")
ANGLES = np.arange(1, 41)[:, None] * np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0]) % 1 - 0.5
POINTS = ARM.forward(ANGLES)
GROUPS = np.repeat(np.arange(8), 5)
RESIDUALS = 0.05 * np.cos(ANGLES[:, :3])
OCTAHEDRON = 5.0 * np.vstack([np.eye(3), -np.eye(3)])
LINE = np.arange(5.0)[:, None] * [0, 0, 1]


def rbf(X_train, y, X_new=None, sample_weight=None, **params):
    """Predictions of a network at its own rows or others; its deviations must be numbers, too."""
    model = RBFNetRegressor(**{"random_state": 0} | params).fit(X_train, y, sample_weight)
    mean, std = model.predict(X_train if X_new is None else X_new, return_std=True)
    assert np.all(np.isfinite(std))
    assert np.all(std >= 0)
    return mean


def warned_of_widths(X_train, y):
    """Predictions where labels vary faster than any width can follow, which is said."""
    with pytest.warns(ConvergenceWarning, match="width of feature"):
        return rbf(X_train, y)


def unknown(X_train, y, X_new=None, sample_weight=None):
    """Predictions from one observation: nothing is known of any deviation."""
    model = RBFNetRegressor(random_state=0).fit(X_train, y, sample_weight)
    mean, std = model.predict(X_train if X_new is None else X_new, return_std=True)
    assert np.all(std == np.inf)
    return mean


def harmonics(**params):
    return ArmResidualRegressor(ARM, **{"orders": 2} | params)


def jhr(angles, y, sample_weight=None, **params):
    return harmonics(**params).fit(angles, y, sample_weight=sample_weight).predict(ANGLES)


def pipeline():
    return make_pipeline(
        PoseFeatures(ARM, append_azimuth=True),
        CylindricalResidualTarget(RBFNetRegressor(5, length_scale=1.0)),
    )


def plane(columns):
    """Least-squares plane through Y, by NumPy."""
    A = np.column_stack([np.ones(60), columns])
    return A @ np.linalg.lstsq(A, Y, rcond=1e-10)[0]


def best_radius(points):
    """Radius of the least-squares sphere, found without slopes."""

    def spread(center):
        return np.var(np.linalg.norm(points - center, axis=1))

    options = {"xatol": 1e-10, "fatol": 1e-16, "maxiter": 4000, "maxfev": 4000}
    start = points.mean(axis=0) + 0.3
    center = minimize(spread, start, method="Nelder-Mead", options=options).x
    return np.linalg.norm(points - center, axis=1).mean()


OWN = rbf(X, Y)
_RNG = np.random.default_rng(5)
LABEL = _RNG.integers(0, 60, 300).astype(float)
LABELS = np.column_stack(
    [
        _RNG.standard_normal(60)[LABEL.astype(int)],
        *_RNG.integers(0, [[40], [3], [2]], (3, 300)),
    ]
)
BLOB = np.array([[1.1, 2.2, 3.3], [-3, 1, 2], [2, -3, 1], [-1, -2, -3], [3, -1, -2], [-2, 3, -1]])
WITH_CENTRE = np.vstack([BLOB, BLOB.mean(axis=0)])
SEEN_TWICE = np.repeat(X[:6], 2, axis=0)
ALONE = np.eye(60)[7]
TINY = 1e-310  # denormal

# What is done, and what comes out.
RIGHT = {
    "network: constant column of another size": (
        lambda: rbf(np.c_[X, np.full(60, 1e12)], Y),
        OWN,
    ),
    "network: all rows the same": (lambda: rbf(np.ones((60, 2)), Y), np.full(60, Y.mean())),
    "network: constant target": (lambda: rbf(X, np.full(60, 3.0)), np.full(60, 3.0)),
    "network: zero target": (lambda: rbf(X, np.zeros(60)), np.zeros(60)),
    "network: repeated rows": (
        lambda: rbf(SEEN_TWICE, Y[:12], X[:6], n_centers=6, length_scale=0.2, alpha=0),
        Y[:12].reshape(6, 2).mean(axis=1),
    ),
    "network: collinear columns": (
        lambda: rbf(np.c_[X, X @ [1, 2]], Y, n_centers=1, length_scale=1e5, alpha=1e12, degree=1),
        plane(X),
    ),
    "network: one output constant": (
        lambda: rbf(X, np.c_[Y, np.ones(60)])[:, 1],
        np.ones(60),
    ),
    # A label decides, through a column of sixty values that no order explains; others say nothing.
    "network: a table of labels": (
        lambda: warned_of_widths(LABELS, LABEL),
        LABEL,
    ),
    "network: tiny rows": (lambda: rbf(X * 2.0**-300, Y), OWN),
    "network: large rows": (lambda: rbf(X * 2.0**150, Y), OWN),
    "network: rows far from zero": (lambda: rbf(X + 2.0**20, Y), OWN),
    "network: tiny target": (lambda: rbf(X, Y * 2.0**-300) * 2.0**300, OWN),
    "network: large target": (lambda: rbf(X, Y * 2.0**150) * 2.0**-150, OWN),
    "network: tiny weights": (lambda: rbf(X, Y, sample_weight=np.full(60, 2.0**-150)), OWN),
    "network: large weights": (lambda: rbf(X, Y, sample_weight=np.full(60, 2.0**150)), OWN),
    "network: weight on one row": (
        lambda: unknown(X, Y, sample_weight=ALONE),
        np.full(60, Y[7]),
    ),
    "network: new rows far away": (
        lambda: rbf(X, Y, [[1e50, -1e50]], kernel="matern52", degree=-1),
        [0.0],
    ),
    "harmonics: zero residuals": (lambda: jhr(ANGLES, RESIDUALS * 0), np.zeros((40, 3))),
    "harmonics: denormal angles": (
        lambda: jhr(ANGLES * TINY, RESIDUALS),
        jhr(ANGLES * 0, RESIDUALS),
    ),
    "harmonics: large residuals": (
        lambda: jhr(ANGLES, RESIDUALS * 2.0**4) * 2.0**-4,
        jhr(ANGLES, RESIDUALS),
    ),
    "harmonics: tiny residuals": (
        lambda: jhr(ANGLES, RESIDUALS * 2.0**-150) * 2.0**150,
        jhr(ANGLES, RESIDUALS),
    ),
    "harmonics: weight on one row": (
        lambda: jhr(ANGLES, RESIDUALS, np.eye(40)[7]),
        jhr(ANGLES[7:8], RESIDUALS[7:8]),
    ),
    "correction: zero residuals": (
        lambda: ArmResidualRegressor(ARM).fit(ANGLES, RESIDUALS * 0).predict(ANGLES),
        np.zeros((40, 3)),
    ),
    "arm: no poses": (lambda: ARM.forward(np.empty((0, 6))), np.empty((0, 3))),
    "arm: denormal angles": (
        lambda: ARM.forward(ANGLES * TINY),
        ARM.forward(ANGLES * 0),
    ),
    "arm: denormal length": (lambda: ARM.replace(a=ARM.a * TINY).a, ARM.a * TINY),
    "arm: a frame of pandas": (lambda: ARM.forward(pd.DataFrame(ANGLES)), POINTS),
    "calibrate: nothing is free": (
        lambda: calibrate(ARM, ANGLES, points=POINTS + 1, free=()).values[:27],
        np.concatenate([ARM.a, ARM.alpha, ARM.d, ARM.theta_offset, ARM.probe]),
    ),
    "calibrate: nothing is wrong": (
        lambda: calibrate(ARM, ANGLES, GROUPS * 0, free=["probe"]).arm.a,
        ARM.a,
    ),
    "residuals: far from zero": (
        lambda: position_residuals(LINE + 2.0**40, [0] * 5),
        LINE - [0, 0, 2],
    ),
    "residuals: denormal weights": (
        lambda: position_residuals(POINTS, GROUPS, np.full(40, 5e-324)),
        position_residuals(POINTS, GROUPS),
    ),
    "residuals: no scatter": (
        lambda: position_residuals(np.ones((4, 3)), [0, 0, 1, 1]),
        np.zeros((4, 3)),
    ),
    "2S: no scatter": (lambda: single_point_repeatability(np.ones((5, 3))), 0.0),
    # Deviations -2 to 2: twice the root of 10 / 4.
    "2S: far from zero": (lambda: single_point_repeatability(LINE + 2.0**40), 2 * np.sqrt(2.5)),
    "2S: large": (lambda: single_point_repeatability(LINE * 1e49) / 1e49, 2 * np.sqrt(2.5)),
    "2S: one coordinate": (lambda: single_point_repeatability(LINE[:, 2]), 2 * np.sqrt(2.5)),
    "axes: denormal": (lambda: axis_repeatability(LINE * TINY) / TINY, [0, 0, 2.0]),
    "report: one group": (lambda: repeatability_report(LINE).deviation_max, [2.0]),
    "sphere: a point at its centre": (
        lambda: probing_size_error(WITH_CENTRE, 10),
        2 * best_radius(WITH_CENTRE) - 10,
    ),
    "sphere: a point at the start of the search": (
        lambda: np.isfinite(probing_form_error(np.vstack([OCTAHEDRON, [0, 0, 0]]))),
        True,
    ),
    "sphere: large": (lambda: probing_size_error(OCTAHEDRON * 1e40, 1e41) / 1e40, 0.0),
    "sphere: tiny": (lambda: probing_form_error(OCTAHEDRON * 1e-150) * 1e150, 0.0),
    "sphere: repeated points": (lambda: probing_form_error(np.repeat(OCTAHEDRON, 3, axis=0)), 0),
    "location: on a line": (lambda: articulated_location_error(LINE), 4.0),
    "location: no scatter": (lambda: articulated_location_error(np.ones((5, 3))), 0.0),
    "gauge: none": (lambda: gauge_lengths(POINTS, GROUPS, np.empty((0, 2))), np.empty(0)),
    "gauge: from a place to itself": (lambda: gauge_lengths(POINTS, GROUPS, [[0, 0]]), [0.0]),
    "poses: none": (lambda: SimulatedArm().find_poses([400, 0, 300], 0, 0), np.empty((0, 6))),
}


@pytest.mark.filterwarnings("ignore:The points still scatter")  # of no arm
@pytest.mark.parametrize("case", RIGHT)
def test_edge_has_its_answer(case):
    act, expected = RIGHT[case]
    # Relative to the answer, whatever its unit.
    size = np.max(np.abs(expected), initial=0.0) or 1.0
    # Widths are found to a few digits, as is the sphere to compare with.
    tolerance = 1e-4 if case.startswith("network") else 1e-7
    np.testing.assert_allclose(act(), expected, rtol=0, atol=tolerance * size)


far = partial(RBFNetRegressor, 5, alpha=0.1)
make = partial(make_single_point, 2, 5)
fit_pipeline = partial(pipeline().fit, ANGLES, RESIDUALS)
# What is done, and what the sentence says.
SENTENCES = {
    "network: too narrow": (lambda: far(length_scale=1e-8).fit(X, Y), "1e-08 for feature"),
    "network: as narrow as nothing": (
        lambda: far(length_scale=5e-324).fit(X, Y),
        "at least 1e-50",
    ),
    "network: kernel": (lambda: far(kernel="gauss").fit(X, Y), "'kernel' parameter"),
    "network: alpha": (lambda: RBFNetRegressor(alpha=np.nan).fit(X, Y), "'alpha' parameter"),
    "network: length_scale": (lambda: far(length_scale="auto ").fit(X, Y), "'length_scale'"),
    "network: loss": (lambda: far(loss="huber").fit(X, Y), "'loss' parameter"),
    "network: negative weight": (lambda: far().fit(X, Y, -ALONE), "must not be negative"),
    "target: a class": (
        lambda: CylindricalResidualTarget(RBFNetRegressor).fit(ANGLES, RESIDUALS),
        "'regressor' parameter|estimator instance",
    ),
    "harmonics: no columns": (
        lambda: jhr(ANGLES, RESIDUALS, orders=0, causes=[]),
        "no columns",
    ),
    "calibrate: no rows": (lambda: calibrate(ARM, ANGLES[:0], []), "empty|0 sample"),
    "calibrate: arm by name": (lambda: calibrate("aacmm6", ANGLES, GROUPS), "must be an instance"),
    "calibrate: free": (lambda: calibrate(ARM, ANGLES, GROUPS, free=["as"]), "must name some"),
    "calibrate: free of numbers": (lambda: calibrate(ARM, ANGLES, GROUPS, free=3), "a list"),
    "calibrate: loss": (lambda: calibrate(ARM, ANGLES, GROUPS, loss=["linear"]), "'loss' param"),
    "calibrate: prior": (
        lambda: calibrate(ARM, ANGLES, GROUPS, prior_angle_rad=1e-300),
        "'prior_angle_rad' parameter",
    ),
    "calibrate: complex prior": (
        lambda: calibrate(ARM, ANGLES, GROUPS, prior_length_mm=2 + 0j),
        "'prior_length_mm' parameter",
    ),
    "calibrate: lengths": (lambda: calibrate(ARM, ANGLES, GROUPS, lengths=300), "a list"),
    "calibrate: too long": (
        lambda: calibrate(ARM, ANGLES, GROUPS, lengths=[(0, 1, 1e300, 1)]),
        "at most 200000 mm",
    ),
    "calibrate: too sure": (
        lambda: calibrate(ARM, ANGLES, GROUPS, lengths=[(0, 1, 300, 1e-300)]),
        "at least 1e-09 mm",
    ),
    "sphere: one place": (lambda: probing_form_error(POINTS * 0), "one plane"),
    "sphere: diameters": (lambda: probing_size_error(OCTAHEDRON, [10, 10]), "one number"),
    "gauge: text for numbers": (
        lambda: gauge_lengths(POINTS, GROUPS.astype(str), [[0, 1]]),
        "group 0",
    ),
    "length: none": (lambda: length_error([], []), r"\(0,\)"),
    "length: statistic": (lambda: length_error([300], 300, statistic="rms"), "'rms' is not"),
    "made: warming": (lambda: SimulatedArm().forward(ANGLES, warming_k=np.nan), "warming_k"),
    "made: poses": (lambda: SimulatedArm().find_poses([400, 0, 300], -1), "n_poses"),
    "made: source": (lambda: ArmErrors.only(sag=1), "unexpected keyword argument 'sag'"),
    "figure: statistic": (
        lambda: RepeatabilityDisplay.from_predictions(
            POINTS, RESIDUALS, groups=GROUPS, statistic="3s"
        ),
        "'3s' is not",
    ),
    "figure: residuals for points": (
        lambda: LengthErrorDisplay.from_predictions(
            RESIDUALS, RESIDUALS, groups=GROUPS, pairs=[[0, 1]], lengths=300
        ),
        "not residuals",
    ),
    "figure: no poses": (
        lambda: ArmPosesDisplay.from_predictions(ANGLES, RESIDUALS, max_poses=0),
        "max_poses",
    ),
    "figure: magnification": (
        lambda: ArmPosesDisplay.from_predictions(ANGLES, RESIDUALS, magnification="big"),
        "magnification='big'",
    ),
    "figure: arm by name": (
        lambda: ArmPosesDisplay.from_predictions(ANGLES, RESIDUALS, arm="panda"),
        "must be an Arm",
    ),
    "export: nothing": (lambda: fingerprint(None), "fitted estimator"),
    "describe: two columns": (
        lambda: describe(fit_pipeline(), ANGLES, RESIDUALS[:, :2]),
        "model predicts 3",
    ),
}


@pytest.mark.parametrize("case", SENTENCES)
def test_no_answer_gets_a_sentence(case):
    act, sentence = SENTENCES[case]
    with pytest.raises((ValueError, TypeError), match=sentence):
        act()
