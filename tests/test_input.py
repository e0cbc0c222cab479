"""Every public function, given arguments that are odd, and arguments that are wrong.

`FUNCTIONS` is the table of public functions, with the names of the right values that each takes.
`SAME` lists forms that hold the same numbers and must not matter, `WRONG` forms that end in one
sentence, `refused` options that do, and `EDGES` data at the edge of
what has an answer, with the answer. Warnings are errors in this suite, so that none can come from
deep inside NumPy.
"""

import contextlib
import re
import warnings
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import scipy.sparse
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    app,
    arm_from_data,
    calibrate,
    cartesian_to_cylindrical,
    check_correction,
    cylindrical_to_cartesian,
    display,
    elbow_angle,
    export,
    learn_correction,
    metrics,
    position_residuals,
    search_table,
    shoulder_wrist_distance,
    update_correction,
)
from sklearn_raacmm.acceptance import (
    AcceptanceRun,
    Artefact,
    evaluate_acceptance,
    predict_acceptance,
)
from sklearn_raacmm.datasets import (
    ArmErrors,
    SimulatedArm,
    fetch_panda_ball_socket,
    fetch_ur10_tracker,
    make_gauge,
    make_single_point,
)
from sklearn_raacmm.utils import Finding

# Chains are fitted without groups: what they learn is not the question here.
pytestmark = pytest.mark.filterwarnings("ignore:No groups were given")


def spread(n_rows, n_columns):
    """Evenly spread numbers in (0, 1) that depend on no generator."""
    roots = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0][:n_columns])
    return np.arange(1, n_rows + 1)[:, None] * roots % 1


ARM = Arm.from_name("aacmm6")
ANGLES = 3 * (spread(40, 6) - 0.5)
GROUPS = np.repeat(np.arange(8), 5)
POINTS = ARM.forward(ANGLES) + np.array([1.0, 0.0, 0.0])
RESIDUALS = 0.05 * np.cos(ANGLES[:, [1, 3, 2]] - ANGLES[:, [2, 1, 3]])
CENTRED = position_residuals(RESIDUALS, GROUPS)
MACHINE = SimulatedArm()
NEAR = MACHINE.forward(ANGLES)
RIGHT = {
    "angles": ANGLES,
    "columns": PoseFeatures(ARM, append_azimuth=True).fit_transform(ANGLES),
    "points": POINTS,
    "residuals": RESIDUALS,
    "weights": np.arange(1.0, 41),
    "groups": GROUPS,
    "azimuth": ANGLES[:, 0],
    "widths": np.arange(1.0, 7.0),
    "mm": np.array([300.0, 500.0]),
    "mm_too": np.array([300.0, 500.0]),
    "cone": np.array([400.0, 0.0, 300.0]),
    "near": NEAR,
    "a": ARM.a,
    "alpha": ARM.alpha,
    "alpha_deg": np.rad2deg(ARM.alpha),
    "probe": ARM.probe,
}


def network(**params):
    return RBFNetRegressor(5, **{"length_scale": 1.0, "alpha": 0.01} | params)


def harmonics(**params):
    return ArmResidualRegressor(ARM, **{"orders": 2, "causes": ["kinematics"]} | params)


FITTED = network().fit(ANGLES, RESIDUALS)
LINEAR = harmonics().fit(ANGLES, RESIDUALS)
NO_ARM = {"accept": "no-such-arm"}
UNRELATED = {"accept": "rows-unrelated"}
RESULT = calibrate(ARM, ANGLES, points=POINTS - RESIDUALS, free=["probe"])


def fit(make, columns, residuals, weights):
    return make().fit(columns, residuals, sample_weight=weights).predict(columns)


def fit_rows(make, known, rows):
    return make().fit(rows, RESIDUALS).predict(known)


def pairs(measure, points, groups):
    return measure(points, groups, [np.array(groups, dtype=object)[[0, 5]]])


def scored(angles, groups):
    scorer = metrics.repeatability_scorer(angles, groups)
    return scorer(FITTED, np.asarray(angles, float), RESIDUALS)


def shown(kind, attribute, rows, **options):
    """What a display has computed of rows of points or angles."""
    return getattr(kind.from_predictions(rows, RESIDUALS, **options), attribute)


def cylindrical():
    return CylindricalResidualTarget(network())


COLUMNS = RIGHT["columns"]
# Name, function, and the right values that it takes, in order; its result is compared, as numbers,
# for every form of the same numbers.
FUNCTIONS = [
    ("Arm.forward", ARM.forward, "angles"),
    ("Arm.frames", ARM.frames, "angles"),
    ("Arm.jacobian", ARM.jacobian, "angles"),
    ("Arm.azimuth", ARM.azimuth, "angles"),
    ("Arm, a", lambda a: ARM.replace(a=a).a, "a"),
    ("Arm, alpha", lambda alpha: ARM.replace(alpha=alpha).alpha, "alpha"),
    ("Arm, probe", lambda probe: ARM.replace(probe=probe).probe, "probe"),
    ("Arm.from_degrees", lambda v: Arm.from_degrees(ARM.a, v, ARM.d).alpha, "alpha_deg"),
    ("PoseFeatures.transform", PoseFeatures(ARM).fit(ANGLES).transform, "angles"),
    ("PoseFeatures.fit", PoseFeatures(ARM).fit_transform, "angles"),
    ("RBFNetRegressor.fit", partial(fit, network, ANGLES), "residuals weights"),
    ("RBFNetRegressor.fit, X", partial(fit_rows, network, ANGLES), "angles"),
    ("RBFNetRegressor.predict", FITTED.predict, "angles"),
    ("length_scale", lambda v: network(length_scale=v).fit(ANGLES, RESIDUALS).coef_, "widths"),
    ("ArmResidualRegressor.fit", partial(fit, harmonics, ANGLES), "residuals weights"),
    ("ArmResidualRegressor.fit, X", partial(fit_rows, harmonics, ANGLES), "angles"),
    (
        "ArmResidualRegressor.fit, positions",
        lambda groups: harmonics().fit(ANGLES, CENTRED, groups=groups, **UNRELATED).coef_,
        "groups",
    ),
    ("ArmResidualRegressor.predict", LINEAR.predict, "angles"),
    ("CylindricalResidualTarget.fit", partial(fit, cylindrical, COLUMNS), "residuals weights"),
    ("CylindricalResidualTarget.fit, X", partial(fit_rows, cylindrical, COLUMNS), "columns"),
    ("CylindricalResidualTarget.predict", cylindrical().fit(COLUMNS, RESIDUALS).predict, "columns"),
    ("calibrate", lambda q, p: calibrate(ARM, q, points=p, free=["probe"]).values, "angles points"),
    (
        "calibrate, positions",
        lambda groups: calibrate(ARM, ANGLES, groups, free=["probe"], **NO_ARM).values,
        "groups",
    ),
    ("position_residuals", position_residuals, "points groups weights"),
    ("cartesian_to_cylindrical", cartesian_to_cylindrical, "residuals azimuth"),
    ("cylindrical_to_cartesian", cylindrical_to_cartesian, "residuals azimuth"),
    ("shoulder_wrist_distance", partial(shoulder_wrist_distance, ARM), "angles"),
    ("elbow_angle", partial(elbow_angle, ARM), "angles"),
    ("2S", metrics.single_point_repeatability, "points groups"),
    ("interval", metrics.repeatability_interval, "points groups"),
    ("sphere", lambda points: metrics.fit_sphere(points)[2], "points"),
    ("axes", lambda points: metrics.axis_repeatability(points, GROUPS), "points"),
    ("R2", lambda p: metrics.within_position_r2_score(p, RESIDUALS, groups=GROUPS), "points"),
    ("gauge", partial(pairs, metrics.gauge_lengths), "points groups"),
    ("length_error", metrics.length_error, "mm mm_too"),
    ("location", metrics.articulated_location_error, "points"),
    ("location, of labels", partial(metrics.articulated_location_error, POINTS), "groups"),
    ("scorer", scored, "angles groups"),
    ("make_gauge", lambda mm: make_gauge(mm, 1, 2).lengths, "mm"),
    ("SimulatedArm.forward", MACHINE.forward, "angles"),
    ("SimulatedArm.read", lambda angles: MACHINE.read(angles, 0), "angles"),
    ("SimulatedArm.solve", MACHINE.solve, "angles near"),
    ("SimulatedArm.find_poses", lambda cone: MACHINE.find_poses(cone, 2, 0), "cone"),
    (
        "RepeatabilityDisplay",
        lambda p, g: shown(display.RepeatabilityDisplay, "after", p, groups=g),
        "points groups",
    ),
    ("describe", lambda q: export.describe(FITTED, q)["training"]["rows"], "angles"),
    (
        "describe, positions",
        lambda g: export.describe(FITTED, ANGLES, groups=g)["training"]["positions"],
        "groups",
    ),
]
# Functions that take longer where nothing is wrong: only faults are tried.
REFUSING = [
    ("CalibrationResult.residuals", RESULT.residuals, "angles points"),
    ("fading", LINEAR.fading, "angles"),
    ("distance_std", partial(LINEAR.distance_std, ANGLES), "angles"),
    (
        "update",
        lambda q, y, g: update_correction(LINEAR, q, y, groups=g).coef_,
        "angles residuals groups",
    ),
    (
        "check",
        lambda q, y, g: check_correction(LINEAR, q, y, groups=g),
        "angles residuals groups",
    ),
    ("search_table", lambda q, g: search_table(ARM, q, g) is None, "angles groups"),
    ("from_data", partial(arm_from_data, "2-2-2", lengths=[(0, 1, 500, 0.01)]), "angles groups"),
    ("search_table, points", lambda p: search_table(ARM, ANGLES, points=p), "points"),
    ("learn", partial(learn_correction, ARM), "angles groups points"),
    ("R2, of labels", lambda g: metrics.within_position_r2_score(POINTS, RESIDUALS, groups=g),
     "groups"),
    ("axes, of labels", partial(metrics.axis_repeatability, POINTS), "groups"),
]  # fmt: skip
CALLS = {name: (function, values.split()) for name, function, values in FUNCTIONS + REFUSING}


def table(functions):
    """Pairs of a function's name and one of the values that it takes."""
    pairs = [(name, value) for name, _, values in functions for value in values.split()]
    return [pytest.param(*pair, id="-".join(pair)) for pair in pairs]


def call(name, **changed):
    """Call a function of the table with its right values, of which some are changed."""
    function, names = CALLS[name]
    values = RIGHT | changed
    return function(*(values[argument] for argument in names))


def with_second(value):
    """A form with something else in the second place."""

    def put(x):
        x = np.array(x, dtype=object if isinstance(value, str | None) else None)
        x.flat[1] = value
        return x

    return put


def masked(x):
    x = np.ma.array(x)
    x[1] = np.ma.masked
    return x


def read_only(x):
    x = np.array(x)
    x.flags.writeable = False
    return x


SAME = {
    "every other row of an array that is read-only": lambda x: read_only(x.repeat(2, axis=0))[::2],
    "backwards": lambda x: np.ascontiguousarray(x[::-1])[::-1],
    "Fortran, big-endian": lambda x: np.asfortranarray(x.astype(x.dtype.newbyteorder(">"))),
    "list": lambda x: x.tolist(),
    "objects": lambda x: x.astype(object),
    "long double": lambda x: x.astype(np.longdouble),
    "nothing masked": np.ma.array,
    "frame": lambda x: pd.DataFrame(x) if x.ndim == 2 else pd.Series(x),
}
# What is wrong, and what the sentence says, of whichever function.
SHAPE = "shape|dim|columns|features|number|array|must hold|sample|empty|rows|must be between"
NO_ARRAY = "must be an array|must hold numbers|'length_scale' parameter"
WRONG = {
    "NaN": (with_second(np.nan), "NaN|nan|finite"),
    "infinity": (with_second(np.inf), "inf|finite"),
    "minus infinity": (with_second(-np.inf), "inf|finite|egative"),
    "too large": (with_second(1e300), r"1e\+|two turns|bounds|between|numbers above"),
    "masked": (masked, "masked"),
    "complex": (lambda x: x + 1j, "omplex|must hold numbers"),
    "dates": (lambda x: np.full(x.shape, np.datetime64("2020-01-01")), "dates or times"),
    "durations": (lambda x: np.full(x.shape, np.timedelta64(1, "s")), "dates or times"),
    "None inside": (with_second(None), "NaN|must hold numbers|missing"),
    "text inside": (with_second("one"), "must hold numbers|could not convert|float"),
    "text": (lambda x: "angles", "must hold|convert|scalar|array|1 dimension|str|samples|features"),
    "a data set": (lambda x: {"data": x}, "must be an array, got dict"),
    "a path": (lambda x: Path("angles.csv"), NO_ARRAY),
    "a generator": (iter, NO_ARRAY),
    "a number of many digits": (lambda x: 10**400, r"above 1e\+50|must hold numbers"),
    "sparse": (
        lambda x: scipy.sparse.csr_array(np.atleast_2d(x)),
        "[Ss]parse|must hold numbers|length_scale",
    ),
    "no rows": (lambda x: x[:0], SHAPE),
    "no columns": (lambda x: np.empty((len(x), 0)), SHAPE),
    "three dimensions": (lambda x: x.reshape(1, *x.shape, *(1,) * (2 - x.ndim)), SHAPE),
    "ragged": (lambda x: [[1.0, 2.0], [1.0]], "inhomogeneous|must hold numbers|samples|features"),
}
# No poses have no points. Infinitely wide is a feature that
# does not count. Angles in another unit are what is searched for.
FINE = {
    "Arm.forward-angles": ["no rows"],
    "Arm.frames-angles": ["no rows"],
    "Arm.jacobian-angles": ["no rows"],
    "Arm.azimuth-angles": ["no rows"],
    "shoulder_wrist_distance-angles": ["no rows"],
    "elbow_angle-angles": ["no rows"],
    "SimulatedArm.forward-angles": ["no rows"],
    "SimulatedArm.read-angles": ["no rows"],
    "length_scale-widths": ["infinity", "too large"],
    "search_table-angles": ["too large"],
}
WRONG_LABELS = {
    "NaN": (lambda g: np.where(np.arange(40) == 1, np.nan, g), "missing label"),
    "None": (with_second(None), "missing label"),
    "masked": (masked, "masked"),
    "pandas' NA": (lambda g: pd.Series(g, dtype="Int64").where(g != 3), "missing label"),
    "empty text": (lambda g: np.where(g == 2, "", g.astype(str)), "missing label"),
    "numbers and text": (with_second("A"), "one kind"),
    "too few": (lambda g: g[:-1], "39"),
    "two columns": (lambda g: np.stack([g, g], axis=1), "groups .*shape"),
    "NaN in a list of text": (lambda g: ["A", float("nan"), *["B"] * 38], "1 missing label"),
    "a number in a list of text": (lambda g: [*["A"] * 39, 3], "one kind"),
    "not a time": (
        lambda g: np.append(np.full(39, "2020", "M8[D]"), np.datetime64("NaT", "D")),
        "missi",
    ),
    "tuples": (lambda g: [("A", int(label)) for label in g], "one text each"),
    "objects of tuples": (lambda g: pd.Series([(int(label), 1) for label in g]), "one text each"),
    "of different lengths": (lambda g: [[1], [1, 2]] * 20, "different lengths"),
}
WORDS = np.array(["NA", "NaT", "None", "nan", *"wxyz"])  # for nothing, elsewhere
SAME_LABELS = {
    "text": lambda g: np.array(list("abcdefgh"))[g],
    "words for nothing": lambda g: WORDS[g],
    "the same as a list": lambda g: WORDS[g].tolist(),
    "the same as objects": lambda g: pd.Series(WORDS)[g],
    "float16": lambda g: g.astype(np.float16),
    "objects": lambda g: g.astype(object),
    "list": lambda g: g.tolist(),
    "series": lambda g: pd.Series(g, index=g[::-1]),
    "categories": lambda g: pd.Categorical(g),
    "dates": lambda g: np.datetime64("2020-01-01") + g,
    "read-only": read_only,
}


@pytest.fixture(scope="module", autouse=True)
def _few_starts():
    """Of searches for zeros, which find none in wrong values however often they start anew."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sklearn_raacmm.correction._zeros._STARTS", 3)
        yield


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


@pytest.mark.filterwarnings("ignore:The points still scatter")  # of no arm
@pytest.mark.filterwarnings("ignore:Within a position")
@pytest.mark.parametrize(("name", "argument"), table(FUNCTIONS))
def test_form_of_the_same_values_does_not_matter(name, argument):
    expected = call(name)
    for form, changed in (SAME_LABELS if argument == "groups" else SAME).items():
        found = call(name, **{argument: changed(RIGHT[argument])})
        assert_allclose(found, expected, rtol=1e-9, atol=1e-12, err_msg=form)
    if argument != "groups":
        narrow = RIGHT[argument].astype(np.float32)
        found, expected = (call(name, **{argument: x}) for x in (narrow, narrow.astype(float)))
        # Features in float32 come out in float32.
        tolerance = 1e-5 if name.startswith("PoseFeatures") else 1e-9
        assert_allclose(found, expected, rtol=tolerance, atol=tolerance, err_msg="float32")


@pytest.mark.parametrize(("name", "argument"), table(FUNCTIONS + REFUSING))
def test_wrong_values_get_a_sentence(name, argument):
    for kind, (spoil, sentence) in (WRONG_LABELS if argument == "groups" else WRONG).items():
        changed = {argument: spoil(RIGHT[argument])}
        if kind in FINE.get(f"{name}-{argument}", ()):
            assert np.all(np.isfinite(call(name, **changed))), kind
            continue
        # UserWarning: more than two turns.
        with pytest.raises((ValueError, TypeError, UserWarning)) as caught:
            call(name, **changed)
        assert caught.type.__module__ in (
            "builtins",
            "sklearn.utils._param_validation",
            "sklearn_raacmm.utils._findings",
        ), kind
        assert re.search(sentence, str(caught.value)), f"{kind}: {caught.value}"


# -- options ---------------------------------------------------------------------------------------

TEST = make_single_point(6, 8, random_state=0)
DATA = TEST.nominal_arm, TEST.data, TEST.groups
MANY, LARGE = np.zeros((24, 9)), np.ones((24, 9))
CHAIN = make_pipeline(
    PoseFeatures(ARM, append_azimuth=True),
    CylindricalResidualTarget(RBFNetRegressor(5, length_scale=1.0)),
).fit(ANGLES, RESIDUALS)
OCTAHEDRON = 5.0 * np.vstack([np.eye(3), -np.eye(3)])


learn = partial(learn_correction, *DATA)
calibrated = partial(calibrate, ARM, ANGLES, GROUPS)
updated = partial(update_correction, LINEAR, ANGLES, CENTRED, groups=GROUPS)
checked = partial(check_correction, LINEAR, ANGLES, CENTRED, groups=GROUPS)
interval = partial(metrics.repeatability_interval, TEST.points, TEST.groups)


def fitted(**params):
    return harmonics(**params).fit(ANGLES, RESIDUALS)


def chain(X=ANGLES, y=RESIDUALS, regressor=None):
    target = CylindricalResidualTarget(regressor or Ridge(), azimuth=ARM.azimuth)
    return target.fit(X, y)


def regression(weights=None, **params):
    model = RBFNetRegressor(**{"n_centers": 5, "alpha": 0.1} | params)
    return model.fit(ANGLES, RESIDUALS, weights)


def refused():
    """Functions, an option of each, values that it cannot take, and what the sentence says."""
    yield learn, "angle_unit", [MANY], "'angle_unit' parameter of .* a str among"
    yield learn, "model", [[]], r"'model' parameter of .* an object implementing 'fit'"
    yield learn, "model", [ArmResidualRegressor], "provide an instance"
    yield learn, "model", [ArmResidualRegressor(orders=-1)], "'orders' parameter of ArmResi"
    yield learn, "cv", [1], "'cv' parameter of .* an int in the range"
    yield learn, "cv", ["folds", [1], np.array(3), [([0, 1], [2])]], "'cv' parameter"
    yield learn, "n_jobs", ["all"], "'n_jobs' parameter of .* an instance of 'int'"
    yield learn, "progress", ["yes"], "'progress' parameter of .* a callable"
    yield partial(ARM.forward, ANGLES), "angle_unit", [LARGE], "angle_unit"
    yield interval, "aggregate", [LARGE], "aggregate"
    yield ArmErrors, "sag_um", [LARGE], "sag_um"
    for function in (
        lambda arm: learn_correction(arm, *DATA[1:]),
        lambda arm: search_table(arm, *DATA[1:]),
        lambda arm: elbow_angle(arm, TEST.data),
    ):
        yield function, "arm", [None, "aacmm6", MANY], "arm must be an Arm, got (None|str|ndarr)"
    for function in (updated, checked):
        dates = [20240131, ["2024-01-31"], np.datetime64("2024-01-31")]
        yield function, "date", dates, "'date' parameter"
    for function in (
        calibrated,
        partial(harmonics().fit, ANGLES, CENTRED, groups=GROUPS, **UNRELATED),
        partial(learn_correction, ARM, ANGLES, GROUPS),
    ):
        no_lists = [[5.0], 5.0, "400 mm", ["0-1: 400"], None]
        yield function, "lengths", no_lists, "length"
        no_lengths = [(0, 1), (0, 1, np.nan, 0.01), (0, 1, 400.0, np.inf)]
        no_lengths += [(0, 1, 400.0, 0.01, 20.0, 1e-5, 3)]
        no_lengths += [(0, 1, -400.0, 0.01), (0, 1, 400.0, 0.0), (0, 1, "400 mm", 0.01)]
        no_lengths += [(0, 99, 400.0, 0.01), (1, 1, 400.0, 0.01), ([0], [1], 400.0, 0.01)]
        yield function, "lengths", [[length] for length in no_lengths], "length"
    yield checked, "lengths", [""], "each of lengths must be"
    yield checked, "refitted", [3], "'refitted' parameter"
    yield calibrated, "lengths", [[(0, 1, 1e300, 1)]], "at most 200000 mm"
    yield calibrated, "lengths", [[(0, 1, 300, 1e-300)]], "at least 1e-09 mm"
    yield calibrated, "free", [["as"]], "must name some"
    yield calibrated, "free", [3], "a list"
    yield calibrated, "loss", [["linear"]], "'loss' parameter"
    yield calibrated, "prior_angle_rad", [1e-300], "'prior_angle_rad' parameter"
    yield calibrated, "prior_length_mm", [2 + 0j], "'prior_length_mm' parameter"
    yield lambda arm: calibrate(arm, ANGLES, GROUPS), "arm", ["aacmm6"], "must be an instance"
    yield regression, "length_scale", [1e-8], "1e-08 for feature"
    yield regression, "length_scale", [5e-324], "at least 1e-50"
    yield regression, "length_scale", ["auto "], "'length_scale'"
    yield regression, "kernel", ["gauss"], "'kernel' parameter"
    yield regression, "alpha", [np.nan], "'alpha' parameter"
    yield regression, "loss", ["huber"], "'loss' parameter"
    yield regression, "weights", [-np.eye(40)[7]], "must not be negative"
    yield chain, "regressor", [RBFNetRegressor], "'regressor' parameter|estimator instance"
    yield chain, "X", [[]], "X has no rows"
    yield chain, "y", [[1, "a", None] + [0] * 37], "y must hold numbers"
    yield chain().predict, "X", [[]], "X has no rows"
    yield partial(fitted, orders=0), "causes", [[]], "no columns"
    several = [None, "0.9", [0.9], np.array([0.9, 0.5]), 1, np.nan]
    yield interval, "probability", several, "probability must be between 0 and 1, got"
    yield lambda warming: MACHINE.forward(ANGLES, warming_k=warming), "warming", [np.nan], "warming"
    yield lambda n_poses: MACHINE.find_poses([400, 0, 300], n_poses), "n_poses", [-1], "n_poses"
    yield ArmErrors.only, "sag", [1], "unexpected keyword argument 'sag'"
    repeatability = partial(
        display.RepeatabilityDisplay.from_predictions, POINTS, RESIDUALS, groups=GROUPS
    )
    flat = [POINTS[:, :2], POINTS[:, 0]]  # 2S is of points in space
    one = partial(display.RepeatabilityDisplay.from_predictions, y_pred=RESIDUALS, groups=GROUPS)
    yield one, "points", flat, r"\(n_rows, 3\) is needed"
    yield repeatability, "perfect", flat, r"perfect has shape \(40,.*\(n_rows, 3\) is needed"
    yield (
        repeatability,
        "perfect",
        [POINTS[1:]],
        r"points has shape \(40, 3\), but perfect \(39, 3\)",
    )
    yield repeatability, "statistic", ["3s"], "'3s' is not"
    yield repeatability, "interval", [95], "between 0 and 1, got 95"
    yield repeatability, "ax", ["axes", 3.5, np.ones(1), [None]], "Axes of matplotlib are needed"
    yield repeatability, "name", [["axes"], [None]], "name must be a text for the legend, got"
    of_model = partial(
        display.RepeatabilityDisplay.from_estimator, X=ANGLES, y=POINTS, groups=GROUPS
    )
    yield of_model, "estimator", [None, "model", LARGE], "estimator must be a fitted model, got"
    yield of_model, "estimator", [Ridge()], "not fitted"
    yield export.fingerprint, "model", [None], "not an estimator"
    yield partial(export.export_c, LINEAR, "a.c"), "card", [True, 3, ["card"]], "describe gives"
    for function in (partial(export.export_c, LINEAR), partial(app.read_table, n_joints=6)):
        yield function, "path", [3, ["a.csv"], b"a.c", {}], "PathLike"
    for function in (update_correction, check_correction):
        rows = partial(function, LINEAR, y=RESIDUALS)
        yield rows, "X", ["", {}], r"X must (be an array|hold numbers), got"
    for predict in (LINEAR.predict, FITTED.predict):
        for flag in ("return_std", "with_noise"):
            no_flags = ["yes", None, 2, 0.5, GROUPS, [True]]  # such as labels in the second place
            yield partial(predict, ANGLES), flag, no_flags, f"{flag} must be True or False, got "
    yield from refused_in_arm()
    yield from refused_in_metrics()
    yield from refused_in_models()
    yield from refused_in_residuals()
    yield from refused_in_correction()
    yield from refused_in_export()
    yield from refused_in_datasets()
    yield from refused_in_acceptance()


def refused_in_arm():
    six, pair, change = np.zeros(6), [[0, 1]], ARM.replace
    yield change, "a", [[1, 2, 3]], r"alpha must hold 3 numbers, got shape \(6,\)"
    yield change, "d", [[0, 0, np.inf, 0, 0, 0]], r"d\[2\] = inf is out of bounds.*100000 mm"
    yield change, "alpha", [90 + six], r"alpha\[0\] = 90 is out of bounds.*from_degrees"
    yield change, "probe", [(0, 0)], r"probe must hold 3 numbers, got shape \(2,\)"
    sign = r"^joint_signs must be -1 or 1 each, .* got -2\.$"
    yield change, "joint_signs", [-2], sign
    yield change, "joint_signs", [0.5], "joint_signs must be -1 or 1"
    kinds = "(?s)convention=.* is not one of 'standard', "
    yield change, "convention", ["khalil", LARGE], kinds
    numbers = r"pose_joints must be two different whole numbers from 1 to 6, got \(3(, 7|\.5, 4)\)"
    yield change, "pose_joints", [(3, 7), (3.5, 4)], numbers
    yield change, "pose_frames", [(2, 2)], r"pose_frames .* from 0 to 6, got \(2, 2\)"
    yield change, "name", [3, LARGE], "name must be a string"
    yield change, "name", ["half \ud800"], "whole characters"
    of_six, differ = "must be 6 different names of joints, got", ["a", "a", "b", "c", "d", "e"]
    yield change, "names", [["a"], differ, [*differ[1:], 3]], of_six
    yield change, "limits", [pair], r"limits must have shape \(6, 2\), got \(1, 2\)"
    yield change, "limits", [[[1, 0], *pair * 5]], "limits of joint 1 must go from low to high"
    yield change, "limits", [[*pair * 5, [np.nan, 0]]], "limits"
    yield change, "up", [(0, 0, 0)], "up must be a vector with a direction"
    yield change, "up", [(0, 1)], "up must hold 3 numbers"
    yield change, "up", [(0, np.nan, 1)], r"up\[1\] = nan is out of bounds"
    yield change, "prob", [(0, 0, 1)], "unexpected keyword argument .prob"
    nowhere = partial(ARM.replace, d=six, probe=(0, 0, 0))
    yield nowhere, "a", [six], "no length above 1e-06 mm"
    known = r"\['aacmm6', .*, 'ur5e'\], got .*(kuka|panda)"
    yield lambda arm: Arm.from_name(arm), "arm", ["kuka", ["panda"]], known
    yield partial(Arm.from_degrees, six, d=six), "alpha", ["x"], "^alpha must hold numbers"
    in_degrees = partial(Arm.from_degrees, six, six, six)
    yield in_degrees, "theta_offset", ["x"], "^theta_offset must hold numbers"
    yield ARM.forward, "angles", [np.zeros((4, 7))], r"6 joints, got \(4, 7\)"
    no_angle = "1 NaN or infinite values; .* nan in row 0, joint 4"
    yield ARM.forward, "angles", [[[0, 0, 0, np.nan, 0, 0]]], no_angle
    yield ARM.forward, "angles", [[[0] * 6, [*[0] * 5, -np.inf]]], "first is -inf in row 1, joint 6"
    no_text = "source must be a path or the text of a URDF file, got"
    yield Arm.from_urdf, "source", [None, 3, b"<robot/>", ["arm.urdf"], {}], no_text
    yield Arm.from_json, "source", [None, 3, ["a"]], "got (NoneType|int|list)"
    longer = r"d3 of the correction's arm is 750\.7422 .* 751\.7422"
    yield LINEAR.with_arm, "arm", [ARM.replace(d=ARM.d + np.eye(6)[2])], longer
    yield LINEAR.with_arm, "arm", [Arm.from_name("panda")], "only the probe may differ"


def refused_in_metrics():
    points, groups = np.zeros((4, 3)), [1, 1, 2, 2]
    of_one = partial(metrics.single_point_repeatability, points)
    alone = r"2 of 3 positions hold a single point \(the first: p\)"
    yield of_one, "groups", [list("pqqr")], alone
    axes = partial(metrics.axis_repeatability, points)
    for measure, statistic, aggregate in (
        (of_one, "3s", "sum"),
        (axes, "max", "min"),
        (interval, "max", "max"),
        (metrics.repeatability_scorer, "3s", None),
    ):
        yield measure, "statistic", [statistic], f"^statistic='{statistic}' is not"
        yield measure, "aggregate", [aggregate], f"^aggregate={aggregate!r} is not"
    score = partial(metrics.within_position_r2_score, points)
    yield score, "y_pred", [points[:, :1]], r"shape \(4, 3\), but y_pred \(4, 1\)"
    yield partial(score, points), "groups", [groups], "does not vary"
    gauges = partial(metrics.gauge_lengths, points, groups)
    yield gauges, "pairs", [[[1, 3]]], "group 3, which has no points"
    yield gauges, "pairs", [[1, 2]], r"shape \(2,\)"
    yield partial(metrics.gauge_lengths, points, list("0011")), "pairs", [[[0, 1]]], "group 0"
    length = metrics.length_error
    yield partial(length, calibrated=[]), "measured", [[]], r"\(0,\)"
    yield partial(length, calibrated=[300] * 3), "measured", [[300] * 2], "2 measured .* 3 calibr"
    yield partial(length, calibrated=300), "measured", [[300, -300]], "1 of 2 values"
    yield metrics.fit_sphere, "points", [np.eye(3)], "at least 4 points, got 3"
    yield metrics.fit_sphere, "points", [POINTS * 0, np.eye(4)[:, :3] * [1, 1, 0]], "one plane"
    location = metrics.articulated_location_error
    yield location, "points", [[[0, 0, 0]]], "2 centres are compared, got 1"
    flat = partial(location, np.zeros((8, 3)))
    yield flat, "groups", [np.repeat([1, 2], 4)], "Articulation 1: .* one plane"


def refused_in_models():
    yield regression, "n_centers", [None], "'n_centers' parameter"
    yield regression, "alpha", [[0.1, 0.2]], r"alpha has shape \(2,\).*3 outputs"
    yield regression, "alpha", [[-0.1, 1, 1]], "alpha must be finite and not negative"
    tuned = partial(regression, n_centers="auto")
    yield tuned, "alpha", [0.0], 'n_centers="auto" needs alpha > 0.*least alpha of 0'
    too_wide = "more than 1e.07 times the range of every feature"
    yield partial(regression, alpha=0.0), "length_scale", [1e9], too_wide
    yield regression, "length_scale", [[1.0, 2.0, 3.0]], r"shape \(3,\).*6 features"
    yield regression, "length_scale", [np.ones((2, 2))], r"shape \(2, 2\).*6 features"
    yield regression, "length_scale", [[-2.0, *[1.0] * 5], [np.nan] * 6], "must be positive"
    yield regression, "length_scale", [[1e-9, *[1.0] * 5]], "does not resolve"
    no_angles = "X has 5 columns, but the arm .* has 6 joints"
    yield partial(harmonics().fit, y=RESIDUALS), "X", [ANGLES[:, :5]], no_angles
    no_vectors = r"y has shape \(40,( 2)?\); Cartesian residuals \(n_samples, 3\)"
    yield partial(harmonics().fit, ANGLES), "y", [RESIDUALS[:, :2], RESIDUALS[:, 0]], no_vectors
    yield fitted, "causes", [["gears"]], "wobble, or functions, got 'gears'"
    yield fitted, "causes", ["gravity"], "'causes' parameter"
    absolute = partial(harmonics(offsets=False).fit, ANGLES, RESIDUALS, groups=GROUPS)
    yield absolute, "lengths", [[(0, 1, 100, 1)]], "lengths are for positions with offsets"
    yield partial(harmonics(offsets=True).fit, ANGLES), "y", [RESIDUALS], "True needs groups"
    yield fitted, "orders", [[[1], [2]]], "orders has 2 lists, but the arm has 6 joints"
    yield fitted, "orders", [[1, 2.5]], "whole numbers of 1 or more, got 2.5 for joint 1"
    yield fitted, "orders", [[0]], "whole numbers of 1 or more, got 0"
    yield fitted, "extra", ["temperature"], "'extra' parameter"
    no_name = r"extra must hold names of columns, .*got '(humidity|direction|force w)'"
    yield fitted, "extra", [["humidity"], ["direction"], ["force w"]], no_name
    no_joint = partial(harmonics(extra=["direction 7"]).fit, y=RESIDUALS)
    of_six = "'direction 7', but the arm has joints 1 to 6"
    yield no_joint, "X", [np.column_stack([ANGLES, GROUPS])], of_six
    yield fitted, "extra", [[3]], "got 3"
    yield fitted, "extra", [["time", "time"]], "names 'time' twice"
    too_few = "X has 6 columns, but 7 are needed: the angles of 6 joints, then 'time'"
    yield fitted, "extra", [["time"]], too_few
    for function in (ARM.angles_for, LINEAR.angles_for):
        near, turns = partial(function, POINTS[:3], ANGLES[:3]), np.tile(np.eye(3), (3, 1, 1))
        yield partial(function, POINTS[:3]), "start", [ANGLES[:2]], "start has 2 poses for 3 points"
        yield near, "orientations", [-turns], "3 of 3 orientations are no rotations; .* row 0"
        too_few = r"for each point, \(3, 3, 3\), got \(2, 3, 3\)"
        yield near, "orientations", [turns[:2]], too_few
    yield partial(ARM.angles_for, POINTS[:3]), "angle_unit", ["grad"], "'grad' is not one of"


def refused_in_residuals():
    ones = np.ones((4, 3))
    of_points = partial(position_residuals, ones)
    yield of_points, "groups", [["A", "A", "B", "C"]], r"2 of 3 positions .*'B', 'C'"
    yield of_points, "groups", [None], "got None"
    alone = r"1 of 2 positions .* non-zero weight: 'B'"
    yield partial(of_points, list("AABB")), "sample_weight", [[1, 1, 1, 0]], alone
    target = CylindricalResidualTarget().fit
    yield partial(target, ones), "y", [None], "requires y to be passed"
    yield partial(target, ones), "y", [ones[1:]], r"inconsistent numbers of samples: \[4, 3\]"
    yield partial(target, np.sqrt(0.5) * ones), "y", [ones[:, 1:]], "y has 2 columns, but a residu"
    no_features = r"X has shape \(4,( 2)?\), but needs at least one feature"
    yield partial(target, y=ones), "X", [ones[:, 1:], ones[:, 0]], no_features

    def by_azimuth(azimuth, y=ones):
        return CylindricalResidualTarget(azimuth=azimuth).fit(ones, y)

    yield by_azimuth, "azimuth", [lambda X: X[:, :2]], r"shape \(4, 2\), but \(4,\) is needed"
    yield by_azimuth, "azimuth", [lambda X: X[1:, 0]], r"shape \(3,\), but \(4,\) is needed"
    nothing = "azimuth holds 4 values that are missing, NaN"
    yield by_azimuth, "azimuth", [lambda X: X[:, 0] * np.nan], nothing
    yield partial(by_azimuth, lambda X: X[:, 0]), "y", [np.ones((4, 5))], "y has 5 columns, but a"


def refused_in_correction():
    of_rows = partial(learn_correction, *DATA[:2])
    single = [*"AAAAAAAa", *"B" * 40]
    yield of_rows, "positions", [single], "'a' has a single row, row 7"
    places = 'own points are at 6 places, of 8 to 8 rows each.*accept "places-found"'
    yield of_rows, "positions", [None], places
    two = partial(learn_correction, TEST.nominal_arm, TEST.data[:16])
    too_few = "at least 3 positions are needed to leave some out, got 2"
    yield two, "positions", [TEST.groups[:16]], too_few
    yield learn, "points", [np.zeros((3, 3))], r"points must have shape \(48, 3\)"
    unknown = "the group 99, which has no samples; groups are 0, 1, "
    yield learn, "lengths", [[(0, 99, 400, 0.1)]], unknown
    warm, kelvin = "temperature", np.full(len(TEST.data), 20.0)
    yield learn, "extra", [{warm: kelvin[:3]}], r"extra\['temperature'\] must have shape \(48,\)"
    missing = r"extra\['temperature'\] holds 1 values that are missing, NaN"
    yield learn, "extra", [{warm: [np.nan, *kelvin[1:]]}], missing
    yield learn, "extra", [{warm: ["20"] * 48}], r"extra\['temperature'\] must hold numbers"
    yield learn, "extra", [[warm]], "extra must be a dict of names and values"
    yield checked, "refitted", [["table"], ANGLES], "refitted must name"
    yield checked, "false_alarm_rate", [0], "'false_alarm_rate' parameter"
    yield checked, "lengths", [[(0, 99, 100.0, 0.01)]], "lengths name the group 99"
    bare = partial(check_correction, LINEAR, ANGLES, RESIDUALS)
    yield bare, "lengths", [[(0, 1, 100.0, 0.01)]], "lengths are between positions: give groups"
    few = partial(check_correction, LINEAR, y=RESIDUALS[:3], refitted=["base", "probe"])
    yield few, "X", [ANGLES[:3]], "3 poses have 9 coordinates for 9 freedoms"
    checks = partial(check_correction, X=ANGLES, y=RESIDUALS)
    yield checks, "model", [FITTED], "cannot be updated or checked"


def refused_in_export():
    in_c, describe = partial(export.export_c, FITTED), partial(export.describe, FITTED)
    named = partial(in_c, path="arm.c")
    no_names = ["", "2d", "a b", "a;b", "a-b", "_a", "a__b", "é", "a\n", "x" * 41, 3]
    yield named, "name", [*no_names, "a(void){}", 'a"', "a/*"], "name must"
    no_paths = ["arm", "arm.cpp", "arm.h", 'a".c', "a\n.c", "a b.c", "é.c"]
    yield partial(in_c, name="arm"), "path", no_paths, r"path must name a file .* ends in \.c"
    yield in_c, "path", ["arm-7.c"], "name must be a C identifier.*arm-7"
    yield named, "dtype", ["float64"], "dtype must be"
    yield named, "fade", [True], "fade must be 'small', 'exact' or False, got True"
    for function in (named, partial(export.load_c, FITTED)):
        yield function, "std", ["yes"], "std must be"
    no_poses = [ANGLES[:, :5], ANGLES[0], ANGLES[:0], ANGLES * np.nan]
    yield named, "poses", no_poses, r"poses (has shape .* \(n_rows, 6\)|is empty|holds .* NaN)"
    for function in (partial(export.export_c, path="arm.c"), partial(export.describe, X=ANGLES)):
        yield function, "model", [network(), clone(CHAIN)], "not fitted"
    function = partial(export.export_c, path="arm.c")
    yield function, "model", [RBFNetRegressor], "is a class, not an instance"
    yield function, "model", [PoseFeatures(ARM).fit(ANGLES)], "regressor at its end"
    yield partial(describe, y=RESIDUALS), "X", [None], "X, which is None"
    yield partial(describe, ANGLES), "y", [RESIDUALS[:-1]], "inconsistent numbers"


def refused_in_datasets():
    yield fetch_panda_ball_socket, "arm", ["panda_1"], "panda_2"
    for fetch in (fetch_panda_ball_socket, fetch_ur10_tracker):
        yield fetch, "download_if_missing", [2], "'download_if_missing' parameter"
    for field in fields(ArmErrors):
        yield ArmErrors, field.name, ["1", np.nan, (1, 2, 3), None, -np.inf], field.name
    yield ArmErrors, "counterbalance", [1.2], r"\[0, 1\], got 1.2"
    yield ArmErrors, "seating_um", [-1], "got -1"
    yield partial(make_single_point, 2), "n_poses", [1], "n_poses == 1, must be >= 2"
    machines = "'eccentricity', 'gravity'.* got 'perfect'"
    yield make_single_point, "machine", ["perfect"], machines
    yield make_gauge, "lengths", [3000, []], "between 0 and 2159 mm"
    yield partial(MACHINE.find_poses, n_poses=5), "point", [[2000, 0, 0]], "0 poses reach .* 151%"
    yield partial(MACHINE.solve, ANGLES[:2]), "points", [[[2e3] * 3] * 2], "2 of 2 points"


def refused_in_acceptance():
    run = AcceptanceRun(test=["length"], artefact=["bar"], points=[[0, 0, 0]])
    yield partial(replace, run), "points", [None], "needs angles or points"
    yield partial(replace, run), "end", [["a", "b"]], "end has 2 rows, test has 1"
    yield partial(replace, run), "tip_mm", [-1], "tip_mm must be a diameter"
    bar = partial(Artefact, name="bar")
    yield bar, "size_mm", [0.0], "size_mm must be positive"
    yield bar, "fixture_mm", [-0.1], "fixture_mm must be a number of 0 or more, got -0.1"
    weighed = replace(run, test=["weight"])
    yield evaluate_acceptance, "run", [weighed], "has the test 'weight'; known are probing"
    evaluated = partial(evaluate_acceptance, run)
    yield evaluated, "limits", [{"P_Sise": 0.1}], "limits names 'P_Sise'"
    limits = [{"P_Size": -0.1}, {"P_Size": (0.1, 0.2)}]
    yield evaluated, "limits", limits, "must be a positive number or A, s, B"
    yield evaluated, "rule", ["half"], "'half' is not"
    yield partial(predict_acceptance, LINEAR), "plan", [run], "a plan needs joint angles"
    plan = replace(run, points=None, angles=ANGLES[:1])
    yield partial(predict_acceptance, plan=plan), "model", [CHAIN], "Pipeline has no sample_y"
    yield partial(predict_acceptance, LINEAR, plan), "n_draws", [1], "n_draws"


@pytest.mark.filterwarnings("ignore:Within a position")
@pytest.mark.parametrize(("function", "option", "values", "sentence"), refused())
def test_what_an_option_cannot_take_gets_a_sentence(
    function, option, values, sentence, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    for value in values:
        with pytest.raises((ValueError, TypeError), match=sentence) as caught:
            function(**{option: value})
        # A large value does not fill the screen.
        assert value is not LARGE or len(str(caught.value)) < 200
    assert not list(tmp_path.iterdir())
    assert not plt.get_fignums()


@pytest.mark.parametrize(
    "function",
    [
        partial(learn_correction, DATA[0], positions=TEST.groups),
        partial(update_correction, LINEAR, y=TEST.target, groups=TEST.groups),
        partial(check_correction, LINEAR, y=TEST.target, groups=TEST.groups),
        partial(elbow_angle, TEST.arm),
    ],
    ids=lambda function: function.func.__name__,
)
def test_degrees_are_warned_of_once_on_the_line_of_the_call(function):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with contextlib.suppress(ValueError):  # such data are of no arm
            function(np.rad2deg(TEST.data))
    of_unit = [warning for warning in caught if "more than two turns" in str(warning.message)]
    assert [Path(warning.filename).name for warning in of_unit] == [Path(__file__).name]


# -- edges -----------------------------------------------------------------------------------------

X = spread(60, 2)
Y = np.sin(5 * X[:, 0]) + X[:, 1]
SMALL = ANGLES / 3
LINE = np.arange(5.0)[:, None] * [0, 0, 1]
TINY = 1e-310  # denormal


def rbf(rows, y, new=None, weights=None, unknown=False, **params):
    """Predictions of a network at its own rows or others; its deviations are numbers, too."""
    fit = RBFNetRegressor(**{"random_state": 0} | params).fit(rows, y, weights)
    mean, std = fit.predict(rows if new is None else new, return_std=True)
    assert np.all(std == np.inf) if unknown else np.all(std >= 0) and np.all(np.isfinite(std))
    return mean


def jhr(angles, y, weights=None, **params):
    with Finding.ignored():  # poses that are all the same show little
        fit = ArmResidualRegressor(ARM, orders=2, **params).fit(angles, y, sample_weight=weights)
        return fit.predict(SMALL)


def of_labels():
    """A table of labels, and predictions of the first of them, through a column of sixty values.

    The column that decides jumps from label to label as no width can follow; the others are noise.
    """
    rng = np.random.default_rng(5)
    label = rng.integers(0, 60, 300)
    columns = rng.standard_normal(60)[label], *rng.integers(0, [[40], [3], [2]], (3, 300))
    with pytest.warns(ConvergenceWarning, match="width of feature"):
        return rbf(np.column_stack(columns), label.astype(float)) - label


def plane():
    """Least-squares plane through Y, by NumPy."""
    A = np.column_stack([np.ones(60), X])
    return A @ np.linalg.lstsq(A, Y, rcond=1e-10)[0]


def best_radius(points):
    """Radius of the least-squares sphere, found without slopes."""

    def varies(center):
        return np.var(np.linalg.norm(points - center, axis=1))

    options = {"xatol": 1e-10, "fatol": 1e-16, "maxiter": 4000, "maxfev": 4000}
    start = points.mean(axis=0) + 0.3
    center = minimize(varies, start, method="Nelder-Mead", options=options).x
    return np.linalg.norm(points - center, axis=1).mean()


BLOB = np.array([[1.1, 2.2, 3.3], [-3, 1, 2], [2, -3, 1], [-1, -2, -3], [3, -1, -2], [-2, 3, -1]])
WITH_CENTRE = np.vstack([BLOB, BLOB.mean(axis=0)])
TWICE = np.repeat(X[:6], 2, axis=0)
WAVES = 0.05 * np.cos(SMALL[:, :3])
OWN = rbf(X, Y)
# A cause whose size is found, not given as that of the table, and far from its limit: it follows
# any unit of y.
WOBBLES = {"causes": ["wobble"]}
FAR = {"kernel": "matern52", "degree": -1}
ONE = {"n_centers": 1, "length_scale": 1e5, "alpha": 1e12, "degree": 1}
EXACT = {"n_centers": 6, "length_scale": 0.2, "alpha": 0}
RESIDUALS_OF = position_residuals
TWO_S = metrics.single_point_repeatability
# What is done, and its right answer: a closed form, a law, or NumPy's least squares.
EDGES = {
    "network: constant column of another size": (lambda: rbf(np.c_[X, np.full(60, 1e12)], Y), OWN),
    "network: all rows the same": (lambda: rbf(np.ones((60, 2)), Y), np.full(60, Y.mean())),
    "network: constant target": (lambda: rbf(X, np.full(60, 3.0)), np.full(60, 3.0)),
    "network: zero target": (lambda: rbf(X, np.zeros(60)), np.zeros(60)),
    "network: repeated rows": (
        lambda: rbf(TWICE, Y[:12], X[:6], **EXACT), Y[:12].reshape(6, 2).mean(axis=1)
    ),
    "network: collinear columns": (lambda: rbf(np.c_[X, X @ [1, 2]], Y, **ONE), plane()),
    "network: one output constant": (lambda: rbf(X, np.c_[Y, np.ones(60)])[:, 1], np.ones(60)),
    "network: a table of labels": (lambda: of_labels() / 60, np.zeros(300)),
    "network: tiny rows": (lambda: rbf(X * 2.0**-300, Y), OWN),
    "network: large rows": (lambda: rbf(X * 2.0**150, Y), OWN),
    "network: rows far from zero": (lambda: rbf(X + 2.0**20, Y), OWN),
    "network: tiny target": (lambda: rbf(X, Y * 2.0**-300) * 2.0**300, OWN),
    "network: large target": (lambda: rbf(X, Y * 2.0**150) * 2.0**-150, OWN),
    "network: tiny weights": (lambda: rbf(X, Y, weights=np.full(60, 2.0**-150)), OWN),
    "network: large weights": (lambda: rbf(X, Y, weights=np.full(60, 2.0**150)), OWN),
    "network: weight on one row": (
        lambda: rbf(X, Y, weights=np.eye(60)[7], unknown=True), np.full(60, Y[7])
    ),
    "network: new rows far away": (lambda: rbf(X, Y, [[1e50, -1e50]], **FAR), [0.0]),
    "arm's model: zero residuals": (lambda: jhr(SMALL, WAVES * 0), np.zeros((40, 3))),
    "arm's model: denormal angles": (lambda: jhr(SMALL * TINY, WAVES), jhr(SMALL * 0, WAVES)),
    "arm's model: large residuals": (
        lambda: jhr(SMALL, WAVES * 2.0**4, **WOBBLES) * 2.0**-4, jhr(SMALL, WAVES, **WOBBLES)
    ),
    "arm's model: tiny residuals": (
        lambda: jhr(SMALL, WAVES * 2.0**-150, **WOBBLES) * 2.0**150, jhr(SMALL, WAVES, **WOBBLES)
    ),
    "arm's model: weight on one row": (
        lambda: jhr(SMALL, WAVES, np.eye(40)[7]), jhr(SMALL[7:8], WAVES[7:8])
    ),
    "arm: denormal angles": (lambda: ARM.forward(SMALL * TINY), ARM.forward(SMALL * 0)),
    "arm: denormal length": (lambda: ARM.replace(a=ARM.a * TINY).a, ARM.a * TINY),
    "calibrate: nothing is free": (
        lambda: calibrate(ARM, SMALL, points=ARM.forward(SMALL) + 1, free=()).values[:27],
        np.concatenate([ARM.a, ARM.alpha, ARM.d, ARM.theta_offset, ARM.probe]),
    ),
    "calibrate: nothing is wrong": (
        lambda: calibrate(ARM, SMALL, GROUPS * 0, free=["probe"], **NO_ARM).arm.a, ARM.a
    ),
    "residuals: far from zero": (lambda: RESIDUALS_OF(LINE + 2.0**40, [0] * 5), LINE - [0, 0, 2]),
    "residuals: denormal weights": (
        lambda: RESIDUALS_OF(POINTS, GROUPS, np.full(40, 5e-324)), RESIDUALS_OF(POINTS, GROUPS)
    ),
    "residuals: no scatter": (
        lambda: RESIDUALS_OF(np.ones((4, 3)), [0, 0, 1, 1]), np.zeros((4, 3))
    ),
    # Deviations -2 to 2: twice the root of 10 / 4.
    "2S: no scatter": (lambda: TWO_S(np.ones((5, 3))), 0.0),
    "2S: far from zero": (lambda: TWO_S(LINE + 2.0**40), 2 * np.sqrt(2.5)),
    "2S: large": (lambda: TWO_S(LINE * 1e49) / 1e49, 2 * np.sqrt(2.5)),
    "2S: one coordinate": (lambda: TWO_S(LINE[:, 2]), 2 * np.sqrt(2.5)),
    "axes: denormal": (lambda: metrics.axis_repeatability(LINE * TINY) / TINY, [0, 0, 2.0]),
    "sphere: a point at its centre": (
        lambda: 2 * metrics.fit_sphere(WITH_CENTRE)[1], 2 * best_radius(WITH_CENTRE)
    ),
    "sphere: a point at the start of the search": (
        lambda: np.isfinite(metrics.fit_sphere(np.vstack([OCTAHEDRON, [0, 0, 0]]))[1]), True
    ),
    "sphere: large": (lambda: metrics.fit_sphere(OCTAHEDRON * 1e40)[1] / 1e40, 5.0),
    "sphere: tiny": (lambda: np.ptp(metrics.fit_sphere(OCTAHEDRON * 1e-150)[2]) * 1e150, 0.0),
    "sphere: repeated": (lambda: np.ptp(metrics.fit_sphere(np.repeat(OCTAHEDRON, 3, 0))[2]), 0.0),
    "location: on a line": (lambda: metrics.articulated_location_error(LINE), 4.0),
    "location: no scatter": (lambda: metrics.articulated_location_error(np.ones((5, 3))), 0.0),
    "gauge: none": (lambda: metrics.gauge_lengths(POINTS, GROUPS, np.empty((0, 2))), np.empty(0)),
    "gauge: to itself": (lambda: metrics.gauge_lengths(POINTS, GROUPS, [[0, 0]]), [0.0]),
    "poses: none": (lambda: MACHINE.find_poses([400, 0, 300], 0, 0), np.empty((0, 6))),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:The points still scatter")  # of no arm
@pytest.mark.parametrize("edge", EDGES)
def test_edge_has_its_answer(edge):
    act, expected = EDGES[edge]
    # Relative to the answer, whatever its unit.
    size = np.max(np.abs(expected), initial=0.0) or 1.0
    # Widths are found to a few digits, as is the sphere to compare with.
    tolerance = 1e-4 if edge.startswith("network") else 1e-7
    if edge == "arm's model: tiny residuals":  # another way to the same evidence: Nehalem 3e-6
        tolerance = 1e-5
    assert_allclose(act(), expected, rtol=0, atol=tolerance * size)
