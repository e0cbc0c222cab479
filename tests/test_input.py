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
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import scipy.sparse
from numpy.testing import assert_allclose
from scipy.optimize import minimize
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
    calibrate,
    cartesian_to_cylindrical,
    check_correction,
    cross_validate_correction,
    cylindrical_to_cartesian,
    display,
    elbow_angle,
    export,
    learn_correction,
    metrics,
    plan_poses,
    position_residuals,
    search_table,
    shoulder_wrist_distance,
    update_correction,
)
from sklearn_raacmm.datasets import ArmErrors, SimulatedArm, make_gauge, make_single_point


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


BARS = {"groups": GROUPS, "pairs": [[0, 1]]}
BARS["lengths"] = metrics.gauge_lengths(POINTS, GROUPS, [[0, 1]])
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
        lambda groups: harmonics().fit(ANGLES, CENTRED, groups=groups).coef_,
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
    ("block", partial(pairs, metrics.block_lengths), "points groups"),
    ("length_error", metrics.length_error, "mm mm_too"),
    ("size", partial(metrics.probing_size_error, diameter=10), "points"),
    ("form", metrics.probing_form_error, "points"),
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
    ("ResidualDisplay", partial(shown, display.ResidualDisplay, "before", arm=ARM), "angles"),
    ("ArmPosesDisplay", partial(shown, display.ArmPosesDisplay, "chains", arm=ARM), "angles"),
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
        lambda q, y, g, w: update_correction(LINEAR, q, y, groups=g, sample_weight=w).coef_,
        "angles residuals groups weights",
    ),
    (
        "check",
        lambda q, y, g: check_correction(LINEAR, q, y, groups=g),
        "angles residuals groups",
    ),
    ("search_table", lambda q, g: search_table(ARM, q, g) is None, "angles groups"),
    ("search_table, points", lambda p: search_table(ARM, ANGLES, points=p), "points"),
    ("learn", partial(learn_correction, ARM), "angles groups points"),
    ("judge", partial(cross_validate_correction, ARM), "angles groups points"),
    (
        "LengthErrorDisplay",
        lambda p, y: display.LengthErrorDisplay.from_predictions(p, y, **BARS),
        "points residuals",
    ),
    ("R2, of labels", lambda g: metrics.within_position_r2_score(POINTS, RESIDUALS, groups=g),
     "groups"),
    ("axes, of labels", partial(metrics.axis_repeatability, POINTS), "groups"),
]  # fmt: skip
CALLS = {name: (function, values.split()) for name, function, values in FUNCTIONS + REFUSING}


def table(functions, without=None):
    """Pairs of a function's name and one of the values that it takes."""
    pairs = [(name, value) for name, _, values in functions for value in values.split()]
    return [pytest.param(*pair, id="-".join(pair)) for pair in pairs if pair[1] != without]


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
    "read-only": read_only,
    "every other row of a larger array": lambda x: np.repeat(x, 2, axis=0)[::2],
    "backwards": lambda x: np.ascontiguousarray(x[::-1])[::-1],
    "Fortran": np.asfortranarray,
    "big-endian": lambda x: x.astype(x.dtype.newbyteorder(">")),
    "list": lambda x: x.tolist(),
    "objects": lambda x: x.astype(object),
    "long double": lambda x: x.astype(np.longdouble),
    "nothing masked": np.ma.array,
    "frame": lambda x: pd.DataFrame(x) if x.ndim == 2 else pd.Series(x),
}
NARROW = {"float32": np.float32, "float16": np.float16, "integers": int, "unsigned": np.uint16}
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
# No poses have no points, and no new poses leave the old model. Infinitely wide is a feature that
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
    "update-angles": ["no rows"],
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


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


@pytest.mark.parametrize(("name", "argument"), table(FUNCTIONS))
def test_form_of_the_same_values_does_not_matter(name, argument):
    expected = call(name)
    for form, changed in (SAME_LABELS if argument == "groups" else SAME).items():
        found = call(name, **{argument: changed(RIGHT[argument])})
        assert_allclose(found, expected, rtol=1e-9, atol=1e-12, err_msg=form)


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "argument"), table(FUNCTIONS, without="groups"))
def test_narrow_types_are_worth_what_they_hold(name, argument):
    # Features in float32 come out in float32.
    tolerance = 1e-5 if name.startswith(("PoseFeatures", "ResidualDisplay")) else 1e-9
    for form, kind in NARROW.items():
        x = RIGHT[argument]
        if form in ("integers", "unsigned"):
            x = np.round(np.abs(x) + 1)
        narrow = x.astype(kind)
        if argument == "columns" and form != "float32":
            with pytest.raises(ValueError, match="norm other than 1"):
                call(name, columns=narrow)  # no direction is left of cosine and sine
            continue
        try:
            expected = call(name, **{argument: narrow.astype(float)})
        except (ValueError, UserWarning) as error:  # such as integers that are no lengths
            with pytest.raises(type(error)):
                call(name, **{argument: narrow})
            continue
        found = call(name, **{argument: narrow})
        assert_allclose(found, expected, rtol=tolerance, atol=tolerance, err_msg=form)


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
judge = partial(cross_validate_correction, *DATA)
calibrated = partial(calibrate, ARM, ANGLES, GROUPS)
updated = partial(update_correction, LINEAR, ANGLES, CENTRED, groups=GROUPS)
checked = partial(check_correction, LINEAR, ANGLES, CENTRED, groups=GROUPS)
interval = partial(metrics.repeatability_interval, TEST.points, TEST.groups)
poses = partial(display.ArmPosesDisplay.from_predictions, ANGLES, RESIDUALS)


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
    for function in (learn, judge):
        yield function, "angle_unit", [MANY], "'angle_unit' parameter of .* a str among"
        yield function, "model", [[]], r"'model' parameter of .* an object implementing 'fit'"
        yield function, "model", [ArmResidualRegressor], "provide an instance"
        yield function, "model", [ArmResidualRegressor(orders=-1)], "'orders' parameter of ArmResi"
        yield function, "cv", [1], "'cv' parameter of .* an int in the range"
        yield function, "cv", ["folds"], "'cv' parameter"
        yield function, "cv", [[1]], r"cv must be a whole number, a splitter, or pairs .* got \[1\]"
        yield function, "cv", [np.array(3)], r"cv must be a list, got array\(3\)"
        for folds in ([0, 1], [2], [3]), ([0, 1], [48]), ([0.0, 1.0], [2.0, 3.0]):
            yield function, "cv", [[folds]], "pairs of the rows"
        yield function, "n_jobs", ["all"], "'n_jobs' parameter of .* an instance of 'int'"
        yield function, "progress", ["yes"], "'progress' parameter of .* a callable"
    yield ARM.replace, "convention", [LARGE], "convention"
    yield ARM.replace, "name", [LARGE], "name"
    yield partial(ARM.forward, ANGLES), "angle_unit", [LARGE], "angle_unit"
    yield interval, "aggregate", [LARGE], "aggregate"
    yield partial(plan_poses, TEST.arm, 4, 4), "region", [LARGE], "region"
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
        partial(harmonics().fit, ANGLES, CENTRED, groups=GROUPS),
        partial(learn_correction, ARM, ANGLES, GROUPS),
        partial(cross_validate_correction, ARM, ANGLES, GROUPS),
    ):
        no_lists = [[5.0], 5.0, "400 mm", ["0-1: 400"], None]
        yield function, "lengths", no_lists, "length"
        no_lengths = [(0, 1), (0, 1, 400.0, 0.01, 3), (0, 1, np.nan, 0.01), (0, 1, 400.0, np.inf)]
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
    yield interval, "statistic", ["max"], "'max' is not"
    yield partial(metrics.probing_size_error, OCTAHEDRON), "diameter", [[10, 10]], "one number"
    yield metrics.probing_form_error, "points", [POINTS * 0], "one plane"
    gauges = partial(metrics.gauge_lengths, POINTS, GROUPS.astype(str))
    yield gauges, "pairs", [[[0, 1]]], "group 0"
    yield partial(metrics.length_error, calibrated=[]), "measured", [[]], r"\(0,\)"
    yield lambda warming: MACHINE.forward(ANGLES, warming_k=warming), "warming", [np.nan], "warming"
    yield lambda n_poses: MACHINE.find_poses([400, 0, 300], n_poses), "n_poses", [-1], "n_poses"
    yield ArmErrors.only, "sag", [1], "unexpected keyword argument 'sag'"
    repeatability = partial(display.RepeatabilityDisplay.from_predictions, POINTS, RESIDUALS)
    yield partial(repeatability, groups=GROUPS), "statistic", ["3s"], "'3s' is not"
    bars = partial(display.LengthErrorDisplay.from_predictions, y_pred=RESIDUALS, **BARS)
    yield bars, "points", [RESIDUALS], "not residuals"
    yield poses, "max_poses", [0], "max_poses"
    yield poses, "magnification", ["big"], "magnification must be"
    yield poses, "arm", ["panda"], "must be an Arm"
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


@pytest.mark.parametrize(
    "function",
    [
        partial(learn_correction, DATA[0], positions=TEST.groups),
        partial(cross_validate_correction, DATA[0], positions=TEST.groups),
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
OWN, OF_WAVES = rbf(X, Y), jhr(SMALL, WAVES)
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
    "arm's model: large residuals": (lambda: jhr(SMALL, WAVES * 2.0**4) * 2.0**-4, OF_WAVES),
    "arm's model: tiny residuals": (lambda: jhr(SMALL, WAVES * 2.0**-150) * 2.0**150, OF_WAVES),
    "arm's model: weight on one row": (
        lambda: jhr(SMALL, WAVES, np.eye(40)[7]), jhr(SMALL[7:8], WAVES[7:8])
    ),
    "update: no new pose": (
        lambda: update_correction(LINEAR, [], []).predict(ANGLES), LINEAR.predict(ANGLES)
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
        lambda: metrics.probing_size_error(WITH_CENTRE, 10), 2 * best_radius(WITH_CENTRE) - 10
    ),
    "sphere: a point at the start of the search": (
        lambda: np.isfinite(metrics.probing_form_error(np.vstack([OCTAHEDRON, [0, 0, 0]]))), True
    ),
    "sphere: large": (lambda: metrics.probing_size_error(OCTAHEDRON * 1e40, 1e41) / 1e40, 0.0),
    "sphere: tiny": (lambda: metrics.probing_form_error(OCTAHEDRON * 1e-150) * 1e150, 0.0),
    "sphere: repeated": (lambda: metrics.probing_form_error(np.repeat(OCTAHEDRON, 3, 0)), 0.0),
    "location: on a line": (lambda: metrics.articulated_location_error(LINE), 4.0),
    "location: no scatter": (lambda: metrics.articulated_location_error(np.ones((5, 3))), 0.0),
    "gauge: none": (lambda: metrics.gauge_lengths(POINTS, GROUPS, np.empty((0, 2))), np.empty(0)),
    "gauge: to itself": (lambda: metrics.gauge_lengths(POINTS, GROUPS, [[0, 0]]), [0.0]),
    "poses: none": (lambda: MACHINE.find_poses([400, 0, 300], 0, 0), np.empty((0, 6))),
}  # fmt: skip


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
