"""Every public function that takes an array, given arrays that are odd, and arrays that are wrong.

`DOORS` lists the functions, each with an argument that is right; `SAME` forms that hold the same
numbers, which must not matter; `WRONG` forms that are wrong, which must end in a sentence. Warnings
are errors in this suite, so that none can come from deep inside NumPy.
"""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import scipy.sparse

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    cartesian_to_cylindrical,
    check_correction,
    cross_validate_correction,
    cylindrical_to_cartesian,
    datasets,
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


def weyl(n_rows, n_columns):
    """Evenly spread numbers in (0, 1) that depend on no generator."""
    roots = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0][:n_columns])
    return np.arange(1, n_rows + 1)[:, None] * roots % 1


ARM = Arm.from_name("aacmm6")
ANGLES = 3 * (weyl(40, 6) - 0.5)
GROUPS = np.repeat(np.arange(8), 5)
POINTS = ARM.forward(ANGLES) + np.array([1.0, 0.0, 0.0])
RESIDUALS = 0.05 * np.cos(ANGLES[:, [1, 3, 2]] - ANGLES[:, [2, 1, 3]])
CENTRED = position_residuals(RESIDUALS, GROUPS)
WEIGHTS = np.arange(1.0, 41)
COLUMNS = PoseFeatures(ARM, append_azimuth=True).fit_transform(ANGLES)
MACHINE = datasets.SimulatedArm()


def network(**params):
    return RBFNetRegressor(5, **{"length_scale": 1.0, "alpha": 0.01} | params)


def harmonics():
    return ArmResidualRegressor(ARM, orders=2, causes=["kinematics"])


def both():
    return harmonics().set_params(regressor=network(), fade=0)


def cylindrical():
    return CylindricalResidualTarget(network())


def doors():
    """Name of each door, an argument that is right, and the function of it, giving numbers."""
    yield "Arm.forward", ANGLES, ARM.forward
    yield "Arm.frames", ANGLES, ARM.frames
    yield "Arm.jacobian", ANGLES, ARM.jacobian
    yield "Arm.azimuth", ANGLES, ARM.azimuth
    yield "Arm, a", ARM.a, lambda v: ARM.replace(a=v).a
    yield "Arm, alpha", ARM.alpha, lambda v: ARM.replace(alpha=v).alpha
    yield "Arm, probe", ARM.probe, lambda v: ARM.replace(probe=v).probe
    degrees = np.rad2deg(ARM.alpha)
    yield "from_degrees, alpha", degrees, lambda v: Arm.from_degrees(ARM.a, v, ARM.d).alpha
    yield "PoseFeatures.transform", ANGLES, PoseFeatures(ARM).fit(ANGLES).transform
    yield "PoseFeatures.fit", ANGLES, PoseFeatures(ARM).fit_transform
    for name, make, X in (
        ("RBFNetRegressor", network, ANGLES),
        ("ArmResidualRegressor", harmonics, ANGLES),
        ("both stages", both, ANGLES),
        ("CylindricalResidualTarget", cylindrical, COLUMNS),
    ):

        def fitted(X=X, y=RESIDUALS, weights=None, known=X, make=make):
            return make().fit(X, y, sample_weight=weights).predict(known)

        yield f"{name}.fit, X", X, fitted
        yield f"{name}.fit, y", RESIDUALS, lambda v, fitted=fitted: fitted(y=v)
        yield f"{name}.fit, sample_weight", WEIGHTS, lambda v, fitted=fitted: fitted(weights=v)
        yield f"{name}.predict", X, make().fit(X, RESIDUALS).predict
    widths = np.arange(1.0, 7.0)
    yield "length_scale", widths, lambda v: network(length_scale=v).fit(ANGLES, RESIDUALS).coef_
    free = {"free": ["probe"]}
    yield "calibrate, angles", ANGLES, lambda v: calibrate(ARM, v, points=POINTS, **free).values
    yield "calibrate, points", POINTS, lambda v: calibrate(ARM, ANGLES, points=v, **free).values
    yield "position_residuals", POINTS, lambda v: position_residuals(v, GROUPS)
    yield "its sample_weight", WEIGHTS, lambda v: position_residuals(POINTS, GROUPS, v)
    angle = ANGLES[:, 0]
    yield "cartesian_to_cylindrical", RESIDUALS, lambda v: cartesian_to_cylindrical(v, angle)
    yield "azimuth there", angle, lambda v: cartesian_to_cylindrical(RESIDUALS, v)
    yield "azimuth back", angle, lambda v: cylindrical_to_cartesian(RESIDUALS, v)
    measures = metrics
    yield "2S", POINTS, lambda v: measures.single_point_repeatability(v, GROUPS)
    interval = measures.repeatability_interval
    yield "interval", POINTS, lambda v: interval(v, GROUPS, n_resamples=9)
    yield "Dis", ANGLES, lambda v: shoulder_wrist_distance(ARM, v)
    yield "gamma", ANGLES, lambda v: elbow_angle(ARM, v)
    yield "axes", POINTS, lambda v: measures.axis_repeatability(v, GROUPS)
    yield "report", POINTS, lambda v: measures.repeatability_report(v, GROUPS).axis_2s_x
    kept = {"groups": GROUPS}
    yield "scatter", RESIDUALS, lambda v: measures.within_position_scatter(POINTS, v, **kept)
    yield "R2", POINTS, lambda v: measures.within_position_r2_score(v, RESIDUALS, **kept)
    yield "gauge", POINTS, lambda v: measures.gauge_lengths(v, GROUPS, [[0, 1]])
    yield "block", POINTS, lambda v: measures.block_lengths(v, GROUPS, [[0, 1]])
    lengths = np.array([300.0, 500.0])
    yield "measured", lengths, lambda v: measures.length_error(v, [300, 500])
    yield "calibrated", lengths, lambda v: measures.length_error([300, 500], v)
    yield "size", POINTS, lambda v: measures.probing_size_error(v, 10)
    yield "form", POINTS, measures.probing_form_error
    yield "location", POINTS, measures.articulated_location_error
    fit = network().fit(ANGLES, RESIDUALS)
    scorer = measures.repeatability_scorer
    yield "scorer", ANGLES, lambda v: scorer(v, GROUPS)(fit, np.asarray(v, float), RESIDUALS)
    yield "make_gauge", lengths, lambda v: datasets.make_gauge(v, 1, 2).lengths
    yield "SimulatedArm.forward", ANGLES, MACHINE.forward
    yield "SimulatedArm.read", ANGLES, lambda v: MACHINE.read(v, 0)
    yield "SimulatedArm.solve", ANGLES, lambda v: MACHINE.solve(v, MACHINE.forward(ANGLES))
    near = MACHINE.forward(ANGLES)
    yield "SimulatedArm.solve, points", near, lambda v: MACHINE.solve(ANGLES, v)
    cone = np.array([400.0, 0.0, 300.0])
    yield "SimulatedArm.find_poses", cone, lambda v: MACHINE.find_poses(v, 2, 0)
    rep = display.RepeatabilityDisplay.from_predictions
    yield "RepeatabilityDisplay", POINTS, lambda v: rep(v, RESIDUALS, groups=GROUPS).after
    res = display.ResidualDisplay.from_predictions
    yield "ResidualDisplay", ANGLES, lambda v: res(v, RESIDUALS, arm=ARM).before
    poses = display.ArmPosesDisplay.from_predictions
    yield "ArmPosesDisplay", ANGLES, lambda v: poses(v, RESIDUALS, arm=ARM).chains
    yield "describe", ANGLES, lambda v: export.describe(fit, v)["training"]["rows"]


def doors_to_be_refused_at():
    """More doors, which take longer where nothing is wrong: only faults are tried there."""
    linear = harmonics().fit(ANGLES, RESIDUALS)
    result = calibrate(ARM, ANGLES, points=POINTS - RESIDUALS, free=["probe"])
    yield "residuals, angles", ANGLES, lambda v: result.residuals(v, POINTS)
    yield "residuals, points", POINTS, lambda v: result.residuals(ANGLES, v)
    yield "fading", ANGLES, linear.fading
    yield "distance_std", ANGLES, lambda v: linear.distance_std(ANGLES, v)
    update = update_correction
    yield "update, X", ANGLES, lambda v: update(linear, v, RESIDUALS).coef_
    yield "update, y", RESIDUALS, lambda v: update(linear, ANGLES, v).coef_
    yield "update, weights", WEIGHTS, lambda v: update(linear, ANGLES, RESIDUALS, sample_weight=v)
    yield "check, X", ANGLES, lambda v: check_correction(linear, v, RESIDUALS)
    yield "check, y", RESIDUALS, lambda v: check_correction(linear, ANGLES, v)
    yield "search_table, angles", ANGLES, lambda v: search_table(ARM, v, GROUPS) is None
    yield "search_table, points", POINTS, lambda v: search_table(ARM, ANGLES, points=v)
    for name, learn in (("learn", learn_correction), ("judge", cross_validate_correction)):
        yield f"{name}, angles", ANGLES, lambda v, learn=learn: learn(ARM, v, GROUPS)
        yield f"{name}, points", POINTS, lambda v, learn=learn: learn(ARM, ANGLES, GROUPS, v)
    gauge = display.LengthErrorDisplay.from_predictions
    lengths = metrics.gauge_lengths(POINTS, GROUPS, [[0, 1]])
    pairs = {"groups": GROUPS, "pairs": [[0, 1]], "lengths": lengths}
    yield "LengthErrorDisplay", POINTS, lambda v: gauge(v, RESIDUALS, **pairs)
    yield "its predictions", RESIDUALS, lambda v: gauge(POINTS, v, **pairs)


def label_doors():
    """The same for labels of positions."""
    yield "ArmResidualRegressor", lambda v: harmonics().fit(ANGLES, CENTRED, groups=v).coef_
    yield "both stages", lambda v: both().fit(ANGLES, CENTRED, groups=v).predict(ANGLES)
    yield "calibrate", lambda v: calibrate(ARM, ANGLES, v, free=["probe"]).values
    yield "position_residuals", lambda v: position_residuals(POINTS, v)
    yield "2S", lambda v: metrics.single_point_repeatability(POINTS, v)
    yield "interval", lambda v: metrics.repeatability_interval(POINTS, v, n_resamples=9)
    yield "report", lambda v: metrics.repeatability_report(POINTS, v).half_range_x
    yield "gauge", lambda v: metrics.gauge_lengths(POINTS, v, [np.array(v, dtype=object)[[0, 5]]])
    yield "block", lambda v: metrics.block_lengths(POINTS, v, [np.array(v, dtype=object)[[0, 5]]])
    yield "location", lambda v: metrics.articulated_location_error(POINTS, v)
    fit = network().fit(ANGLES, RESIDUALS)
    yield "scorer", lambda v: metrics.repeatability_scorer(ANGLES, v)(fit, ANGLES, RESIDUALS)
    rep = display.RepeatabilityDisplay.from_predictions
    yield "RepeatabilityDisplay", lambda v: rep(POINTS, RESIDUALS, groups=v).after
    yield "describe", lambda v: export.describe(fit, ANGLES, groups=v)["training"]["positions"]


def label_doors_to_be_refused_at():
    linear = harmonics().fit(ANGLES, RESIDUALS)
    yield "update", lambda v: update_correction(linear, ANGLES, RESIDUALS, groups=v)
    yield "check", lambda v: check_correction(linear, ANGLES, RESIDUALS, groups=v)
    yield "search_table", lambda v: search_table(ARM, ANGLES, v)
    yield "learn", lambda v: learn_correction(ARM, ANGLES, v)
    yield "judge", lambda v: cross_validate_correction(ARM, ANGLES, v)
    yield "scatter", lambda v: metrics.within_position_scatter(POINTS, RESIDUALS, groups=v)
    yield "R2", lambda v: metrics.within_position_r2_score(POINTS, RESIDUALS, groups=v)
    yield "axes", lambda v: metrics.axis_repeatability(POINTS, v)


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
# What is wrong, and what the sentence says, at whichever door.
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
        lambda x: scipy.sparse.csr_array(x.reshape(len(x), -1) if x.ndim > 2 else np.atleast_2d(x)),
        "[Ss]parse|must hold numbers|length_scale",
    ),
    "no rows": (lambda x: x[:0], SHAPE),
    "no columns": (lambda x: np.empty((len(x), 0)), SHAPE),
    "three dimensions": (lambda x: x.reshape(1, *x.shape, *(1,) * (2 - x.ndim)), SHAPE),
    "ragged": (lambda x: [[1.0, 2.0], [1.0]], "inhomogeneous|must hold numbers|samples|features"),
}
FINE = {
    # No poses have no points.
    ("Arm.forward", "no rows"),
    ("Arm.frames", "no rows"),
    ("Arm.jacobian", "no rows"),
    ("Arm.azimuth", "no rows"),
    ("Dis", "no rows"),
    ("gamma", "no rows"),
    ("SimulatedArm.forward", "no rows"),
    ("SimulatedArm.read", "no rows"),
    # Infinitely wide is a feature that does not count; wider than can be told apart, too.
    ("length_scale", "infinity"),
    ("length_scale", "too large"),
    # No new pose is the old model. Angles in another unit are what is searched for.
    ("update, X", "no rows"),
    ("search_table, angles", "too large"),
}
DOORS = {name: (x, function) for name, x, function in doors()}
LABEL_DOORS = dict(label_doors())
REFUSED_AT = {name: (x, function) for name, x, function in doors_to_be_refused_at()}
LABELS_REFUSED_AT = dict(label_doors_to_be_refused_at())


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


@pytest.mark.parametrize("form", SAME)
@pytest.mark.parametrize("door", DOORS)
def test_form_of_the_same_numbers_does_not_matter(door, form):
    x, function = DOORS[door]
    np.testing.assert_allclose(
        function(SAME[form](x)), function(np.array(x)), rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize("form", NARROW)
@pytest.mark.parametrize("door", DOORS)
def test_narrow_types_are_worth_what_they_hold(door, form):
    x, function = DOORS[door]
    if form in ("integers", "unsigned"):
        x = np.round(np.abs(x) + 1)
    narrow = x.astype(NARROW[form])
    wide = np.array(narrow, dtype=float)
    if door.startswith("CylindricalResidualTarget") and x is COLUMNS and form != "float32":
        with pytest.raises(ValueError, match="norm other than 1"):
            function(narrow)  # no direction is left of cosine and sine
        return
    # Features in float32 come out in float32.
    tolerance = 1e-5 if door.startswith(("PoseFeatures", "ResidualDisplay")) else 1e-9
    try:
        expected = function(wide)
    except (ValueError, UserWarning) as error:  # such as integers that are no lengths
        with pytest.raises(type(error)):
            function(narrow)
        return
    np.testing.assert_allclose(function(narrow), expected, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("kind", WRONG)
@pytest.mark.parametrize("door", [*DOORS, *REFUSED_AT])
def test_wrong_arrays_get_a_sentence(door, kind):
    x, function = (DOORS | REFUSED_AT)[door]
    spoil, sentence = WRONG[kind]
    if (door, kind) in FINE:
        assert np.all(np.isfinite(function(spoil(x))))
        return
    # UserWarning: more than two turns.
    with pytest.raises((ValueError, TypeError, UserWarning)) as caught:
        function(spoil(x))
    assert caught.type.__module__ in (
        "builtins",
        "sklearn.utils._param_validation",
        "sklearn_raacmm.utils._findings",
    )
    assert re.search(sentence, str(caught.value)), str(caught.value)


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
SAME_LABELS = {
    "text": lambda g: np.array(list("abcdefgh"))[g],
    "words for nothing": lambda g: np.array(["NA", "NaT", "None", "nan", *"wxyz"])[g],
    "the same as a list": lambda g: [["NA", "NaT", "None", "nan", *"wxyz"][label] for label in g],
    "the same as objects": lambda g: pd.Series(["NA", "NaT", "None", "nan", *"wxyz"])[g],
    "float16": lambda g: g.astype(np.float16),
    "objects": lambda g: g.astype(object),
    "list": lambda g: g.tolist(),
    "series": lambda g: pd.Series(g, index=g[::-1]),
    "categories": lambda g: pd.Categorical(g),
    "dates": lambda g: np.datetime64("2020-01-01") + g,
    "read-only": read_only,
}


@pytest.mark.parametrize("kind", WRONG_LABELS)
@pytest.mark.parametrize("door", [*LABEL_DOORS, *LABELS_REFUSED_AT])
def test_wrong_labels_get_a_sentence(door, kind):
    spoil, sentence = WRONG_LABELS[kind]
    with pytest.raises(ValueError, match=sentence):
        (LABEL_DOORS | LABELS_REFUSED_AT)[door](spoil(GROUPS))


LENGTH_DOORS = {
    "calibrate": lambda v: calibrate(ARM, ANGLES, GROUPS, lengths=v),
    "linear model": lambda v: harmonics().fit(ANGLES, CENTRED, groups=GROUPS, lengths=v),
    "both stages": lambda v: both().fit(ANGLES, CENTRED, groups=GROUPS, lengths=v),
    "learn": lambda v: learn_correction(ARM, ANGLES, GROUPS, lengths=v),
    "judge": lambda v: cross_validate_correction(ARM, ANGLES, GROUPS, lengths=v),
}
WRONG_LENGTHS = {
    "no tuples": [5.0],
    "a number": 5.0,
    "text": "400 mm",
    "text in a list": ["0-1: 400"],
    "no length": [(0, 1)],
    "too many": [(0, 1, 400.0, 0.01, 3)],
    "NaN": [(0, 1, np.nan, 0.01)],
    "infinite": [(0, 1, 400.0, np.inf)],
    "negative": [(0, 1, -400.0, 0.01)],
    "no deviation": [(0, 1, 400.0, 0.0)],
    "words": [(0, 1, "400 mm", 0.01)],
    "unknown position": [(0, 99, 400.0, 0.01)],
    "one position": [(1, 1, 400.0, 0.01)],
    "lists for labels": [([0], [1], 400.0, 0.01)],
    "nothing": None,
}


@pytest.mark.parametrize("kind", WRONG_LENGTHS)
@pytest.mark.parametrize("door", LENGTH_DOORS)
def test_wrong_lengths_get_a_sentence(door, kind):
    with pytest.raises((ValueError, TypeError), match="length"):
        LENGTH_DOORS[door](WRONG_LENGTHS[kind])


@pytest.mark.filterwarnings("ignore:The points still scatter")  # of no arm
@pytest.mark.parametrize("form", SAME_LABELS)
@pytest.mark.parametrize("door", LABEL_DOORS)
def test_what_labels_are_does_not_matter(door, form):
    function = LABEL_DOORS[door]
    np.testing.assert_allclose(
        function(SAME_LABELS[form](GROUPS)), function(GROUPS), rtol=1e-9, atol=1e-12
    )
