# ruff: noqa: E501, RUF005  (one line a mistake; arrays are added)
"""The table of mistakes: what tired people do to their data, and which finding each function has.

One line a mistake: the function, the mistake in words, what it does to the data, and the code of the
finding. What no data can show stands here, too, as "cannot be known, because ...".
"""

import re
import warnings
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sklearn.base import clone
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    calibrate,
    learn_correction,
    position_residuals,
    update_correction,
)
from sklearn_raacmm.correction._change import transferred_model
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.utils import FindingError, FindingWarning

TEST = make_single_point(9, 16, machine="typical", random_state=2)  # simulated
OTHER = make_single_point(9, 16, machine="typical", random_state=77)  # another arm
ARM, TRUE, N = TEST.arm, TEST.simulation.true_points, len(TEST.data)
TRACKER = Rotation.from_rotvec([0.4, -0.7, 1.1]).apply(TRUE) + [2500, -900, 400]
TRACKER += np.random.default_rng(0).normal(0, 0.01, TRACKER.shape)
HALF = np.arange(N) >= N // 2
# What calibrates and fits many times, by what other functions of the table are made of.
TAKE_LONG = ("learn_tracker", "update_tracker", "calibrate_tracker")
# What a function finds by the same steps as another mistake of the table: a unit as another unit.
AS_ANOTHER = {
    "centimetres", "metres", "micrometres", "points in centimetres", "points in metres",
    "points in micrometres", "a length in centimetres", "a length in metres", "two lengths in inches",
    "a table in metres", "one row early", "x mirrored", "axes in turn", "corrected twice",
    "-99 degrees in three rows", "999 degrees in three rows, in rad", "one cone as A and B",
    "two decimals", "sines of the angles", "joints in reverse order", "another target, 0.5 mm aside",
}  # fmt: skip
# What learn_correction is told by calibrate.
AS_CALIBRATE = {
    "labels five rows late", "two labels exchanged", "999 degrees in three rows", "whole degrees",
    "a length in inches", "the ends of two bars as one", "a table in inches",
}  # fmt: skip
LONG = pytest.mark.exhaustive


def marks_of(name, what):
    """Of a line of the table."""
    told = name == "learn_cones" and what in AS_CALIBRATE
    repeats = what in AS_ANOTHER and name != "fit_cones"  # which has all of them once
    return LONG if name in TAKE_LONG or repeats or told else ()


SMALL = ArmResidualRegressor(ARM, orders=2)


def base(**changes):
    """The data of all functions, some of them changed."""
    data = SimpleNamespace(
        arm=TEST.nominal_arm, angles=TEST.data, groups=TEST.groups, points=TRACKER, lengths=(),
        unit="rad", more={}, model=SMALL,
    )  # fmt: skip
    vars(data).update(changes)
    return data


def residuals(arm=ARM, points=None, angles=TEST.data):
    """Deviations from the means of positions, and against the truth, of an arm's points."""
    points = arm.forward(angles) if points is None else points
    return SimpleNamespace(cones=position_residuals(points, TEST.groups), tracker=points - TRUE)


OF = residuals()
WARM = np.random.default_rng(6).uniform(18, 23, N)
MODELS = {
    "cones": clone(SMALL).fit(TEST.data, OF.cones, groups=TEST.groups),
    "tracker": clone(SMALL).fit(TEST.data, OF.tracker),
}


# -- the functions: each takes data, and may warn -------------------------------------------------


def fit(d):
    d.model.fit(d.angles, d.y, groups=d.groups, **d.more)


def fit_chain(d):
    inner = make_pipeline(PoseFeatures(d.model.arm), StandardScaler(), Ridge())
    model = CylindricalResidualTarget(inner, azimuth=d.model.arm.azimuth)
    model.fit(d.angles, d.y, groups=d.groups)


def fit_pipeline(d):
    pose = PoseFeatures(d.model.arm, append_azimuth=True)
    model = make_pipeline(pose, CylindricalResidualTarget(make_pipeline(StandardScaler(), Ridge())))
    model.fit(d.angles, d.y, cylindricalresidualtarget__groups=d.groups)


def predict(column):
    model = ArmResidualRegressor(ARM, orders=2, extra=["temperature"])
    model.fit(np.column_stack([TEST.data, WARM]), OF.cones, groups=TEST.groups)
    model.predict(np.column_stack([TEST.data, column]))


FUNCTIONS = {
    "calibrate_cones": lambda d: calibrate(d.arm, d.angles, d.groups, lengths=d.lengths, angle_unit=d.unit, **d.more),
    "calibrate_tracker": lambda d: calibrate(d.arm, d.angles, points=d.points, angle_unit=d.unit, **d.more),
    "learn_cones": lambda d: learn_correction(d.arm, d.angles, d.groups, lengths=d.lengths, model=d.model, cv=3, angle_unit=d.unit),
    "learn_tracker": lambda d: learn_correction(d.arm, d.angles, d.groups, d.points, model=d.model, cv=3),
    "learn_taken": lambda d: learn_correction(d.arm, d.angles, d.groups, model=d.model, cv=2, **d.more),
    "fit_cones": fit,
    "fit_tracker": fit,
    "chain": fit_chain,
    "pipeline": fit_pipeline,
    "update_cones": lambda d: update_correction(MODELS["cones"], d.angles, d.y, groups=d.groups),
    "update_tracker": lambda d: update_correction(MODELS["tracker"], d.angles, d.y),
    "transfer": lambda d: transferred_model([MODELS["cones"]], ARM, d.angles, d.y, groups=d.groups),
    "predict": predict,
}  # fmt: skip


# -- the mistakes ---------------------------------------------------------------------------------


def columns(*order):
    return base(angles=TEST.data[:, list(order)])


def reversed_joints(*joints):
    signs = np.ones(6)
    signs[[j - 1 for j in joints]] = -1
    return base(angles=TEST.data * signs)


def table(factor, arm=TEST.nominal_arm):
    return arm.replace(a=factor * arm.a, d=factor * arm.d, probe=factor * arm.probe)


def stream(kind, n=20):
    """A logger wrote each pose n times, with jitter."""
    rows = np.repeat(np.arange(N), n)
    angles = TEST.data[rows] + np.random.default_rng(1).normal(0, 5e-6, (len(rows), 6))
    points, groups = ARM.forward(angles), TEST.groups[rows]
    y = position_residuals(points, groups) if kind == "cones" else points - TRUE[rows]
    return base(angles=angles, groups=groups, points=TRACKER[rows], y=y)


def twice():
    """The same file pasted below itself."""
    parts = (np.concatenate([v, v]) for v in (TEST.data, TEST.groups, TRACKER))
    return base(**dict(zip(("angles", "groups", "points"), parts, strict=True)))


def moved_cone(mm=6.0):
    """The third cone moved after its eighth pose: the angles that reach it are others."""
    rows = np.flatnonzero(TEST.groups == np.unique(TEST.groups)[2])[8:]
    angles = TEST.data.copy()
    angles[rows] += np.linalg.pinv(ARM.jacobian(angles[rows])) @ [0.0, mm, 0.0]
    return base(angles=angles)


def moved_tracker(mm):
    return base(points=TRACKER + HALF[:, None] * np.array([0.6, -0.6, 0.5]) * mm)


def moved_target(mm):
    """Half of the points are of another target, off by so much in the last link's frame."""
    turns = ARM.frames(TEST.data)[:, -1, :3, :3] @ [0.6 * mm, -0.6 * mm, 0.5 * mm]
    turns = Rotation.from_rotvec([0.4, -0.7, 1.1]).apply(turns)
    return base(points=TRACKER + HALF[:, None] * turns)


def path():
    start, end = np.random.default_rng(3).uniform(-1.5, 1.5, (2, 6))
    angles = start + (end - start) * np.linspace(0, 1, 200)[:, None]
    noise = np.random.default_rng(4).normal(0, 0.01, (200, 3))
    return base(angles=angles, points=ARM.forward(angles) + [900, 0, 0] + noise)


def rough_path(seed):
    """A path whose errors are not those of the table, and no jump in it."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 1, 100)[:, None]
    start, end = rng.uniform(-1.2, 1.2, (2, 6))
    angles = start + (end - start) * time
    angles += 0.3 * np.sin(2 * np.pi * 3 * time * rng.uniform(0.5, 1.5, 6))
    misfit = 0.1 * np.sin(angles[:, [1, 2, 3]] * [3, 4, 5])
    points = ARM.forward(angles) + [900, 0, 0] + misfit + rng.normal(0, 0.002, (100, 3))
    return base(arm=ARM, angles=angles, points=points, more={"free": ["probe"]})


def shifted_labels():
    return base(groups=np.roll(TEST.groups, 5))


PLACES = np.array([TRUE[TEST.groups == g].mean(axis=0) for g in range(9)])


def known(*pairs, factor=1.0, plus=0.0, ends=(), arm=TEST.nominal_arm):
    """Known lengths; `ends` are those that the last is said to have."""
    found = [[i, j, np.linalg.norm(PLACES[i] - PLACES[j]) * factor + plus, 0.01] for i, j in pairs]
    found[-1][:2] = ends or found[-1][:2]
    return base(arm=arm, lengths=[tuple(one) for one in found])


def one_too_long(mm):
    """Against two that are right; of a single length, cones and table know the scale no better."""
    lengths = known((0, 1), (2, 3), (4, 5)).lengths
    return base(lengths=[*lengths[:2], (*lengths[2][:2], lengths[2][2] + mm, 0.01)])


def mistyped(joint, factor):
    d = TEST.nominal_arm.d.copy()
    d[joint - 1] *= factor
    return TEST.nominal_arm.replace(d=d)


def contradicting(mm):
    lengths = known((0, 1)).lengths
    return base(lengths=[*lengths, (0, 1, lengths[0][2] + mm, 0.01)])


def exchanged(*rows):
    groups = TEST.groups.copy()
    groups[list(rows)] = groups[list(rows[::-1])]
    return base(groups=groups)


def no_readings(value, unit="rad"):
    """Three rows hold what a logger writes where it has no reading, degrees."""
    angles = np.rad2deg(TEST.data)
    angles[[3, 40, 77]] = value
    return base(angles=angles if unit == "deg" else np.deg2rad(angles), unit=unit)


def two_names(first, second):
    groups = np.where(TEST.groups == 0, first, np.char.add("Q", TEST.groups.astype(str)))
    groups[:8] = second
    return base(groups=groups)


def of(y, kind="cones", angles=TEST.data, groups=TEST.groups, model=None, **more):
    """Data of a fit: y, or one of the residuals of an arm."""
    y = getattr(y, kind) if isinstance(y, SimpleNamespace) else y
    return base(angles=angles, y=y, groups=groups, model=clone(model or SMALL), more=more)


def constants(mm):
    steps = np.random.default_rng(5).normal(0, mm, (9, 3))
    return OF.tracker + steps[np.unique(TEST.groups, return_inverse=True)[1]]


def extra(column):
    model = ArmResidualRegressor(ARM, orders=2, extra=["temperature"])
    return of(OF, angles=np.column_stack([TEST.data, column]), model=model)


OF_NOMINAL, OF_OTHER = residuals(TEST.nominal_arm), residuals(OTHER.arm, angles=TEST.data)
EXPECTED = MODELS["cones"].predict(TEST.data), MODELS["tracker"].predict(TEST.data)
NOMINAL = ArmResidualRegressor(TEST.nominal_arm, orders=2)
EXACT = ARM.forward(TEST.data)
BECAUSE = "cannot be known, because "


# A tracker's points may be anywhere, those of a cone are the arm's own.
ANOTHER_FILE = {"cones": "rows-unrelated", "tracker": BECAUSE + "the arm may have changed as much"}


SHUFFLED, TURN = np.random.default_rng(8).permutation(N), Rotation.from_euler("z", 60, degrees=True)
DROPPED = np.vstack([np.delete(TEST.data, 20, axis=0), TEST.data[-1:]])


# -- what makes things worse -----------------------------------------------------------------------


def straight(mm=0.2):
    """300 poses on a line, so far apart: nothing is known of the arm elsewhere."""
    step = np.linalg.pinv(ARM.jacobian(TEST.data[:1])[0]) @ [0.0, mm, 0.0]
    angles = TEST.data[0] + np.arange(300)[:, None] * step
    noise = np.random.default_rng(4).normal(0, 0.005, (300, 3))
    return base(arm=ARM, angles=angles, points=ARM.forward(angles) + [900, 0, 0] + noise)


def way(mm=5.0):
    """300 poses so far apart, the joints in proportion: lengths off by 0.3 mm would not be seen."""
    step = np.array([0.2, -0.5, 0.3, 0.4, -0.2, 0.1])
    step *= mm / np.linalg.norm(ARM.jacobian(TEST.data[:1])[0] @ step)
    angles = TEST.data[0] + (np.arange(300) - 150)[:, None] * step
    noise = np.random.default_rng(4).normal(0, 0.005, (300, 3))
    return base(arm=ARM, angles=angles, points=ARM.forward(angles) + [900, 0, 0] + noise)


def stated_too_well():
    """Two bars, of one of which the standard deviation is 100 times too small."""
    first, second = known((0, 1), (2, 3)).lengths
    return base(lengths=[first, (*second[:3], 1e-4)])


def own_file_of_another_arm(kind):
    """What the points of another arm at its own cones are with the table of this one."""
    arm = ARM.replace(probe=OTHER.arm.probe)
    points = arm.forward(OTHER.data)
    y = points - OTHER.simulation.true_points
    return of(
        y if kind == "tracker" else position_residuals(points, OTHER.groups),
        angles=OTHER.data,
        groups=OTHER.groups,
    )


WORSE = [
    ("calibrate_tracker", "poses on a line of 60 mm", straight, "poses-alike"),
    ("calibrate_tracker", "poses on a path of 1.5 m", way, "poses-alike"),
    ("calibrate_tracker", "an upper arm of three times its length", lambda: base(arm=mistyped(3, 1 / 3)), "table-off|no-such-arm"),
    ("calibrate_tracker", "606 for 500", lambda: base(arm=mistyped(3, 0.82)), "table-off"),
    ("update_cones", "another arm's own file", lambda: own_file_of_another_arm("cones"), "another-arm|other-table"),
    ("update_tracker", "another arm's own file", lambda: own_file_of_another_arm("tracker"), "another-arm|other-table"),
    ("update_tracker", "poses that scatter by 0.2 mm", lambda: of(OF.tracker + np.random.default_rng(0).normal(0, 0.2, (N, 3))), "strange-poses|another-arm"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "make", "expected"),
    [(n, *rest) for n, _, *rest in WORSE],
    ids=[w for _, w, *_ in WORSE],
)
@pytest.mark.filterwarnings("ignore")
def test_what_makes_things_worse_hands_nothing_over(name, make, expected):
    """Not only is it found: its weight is "repair"."""
    data = make()
    with pytest.raises(FindingError) as caught:
        FUNCTIONS[name](data)
    assert caught.value.finding.code in expected.split("|")


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("calibrate_cones", 1.12),
        ("calibrate_tracker", 0.89),
        pytest.param("calibrate_cones", 0.89, marks=LONG),
        pytest.param("calibrate_tracker", 1.12, marks=LONG),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_no_length_is_handed_over_that_is_a_tenth_off_its_drawing(name, factor):
    """One length after another, of the links and of the offsets, is drawn wrongly."""
    for field in ("a", "d"):
        for joint in np.flatnonzero(np.abs(getattr(TEST.nominal_arm, field)) > 20):
            values = getattr(TEST.nominal_arm, field).copy()
            values[joint] *= factor
            drawn = TEST.nominal_arm.replace(**{field: values})
            with_scale = {"lengths": known((0, 1), arm=drawn).lengths} if "cones" in name else {}
            try:
                FUNCTIONS[name](base(arm=drawn, **with_scale))
            except FindingError:
                continue
            # The height of the base shows nothing, and stays as it was drawn.
            assert (field, joint) == ("d", 0)


def update_mistakes(kind):
    """What may be wrong with the residuals that an update is given, of cones or of a tracker."""
    y, f = getattr(OF, kind), EXPECTED[kind == "tracker"]
    cases = [
        ("the wrong sign", TEST.data, -y, "sign-of-residuals"),
        ("corrected already", TEST.data, y - f, "corrected-already"),
        ("corrected twice", TEST.data, y - 2 * f, "sign-of-residuals"),
        ("another arm's residuals", TEST.data, getattr(OF_OTHER, kind), "other-table|another-arm"),
        ("inches", TEST.data, y / 25.4, "unit-of-residuals"),
        ("centimetres", TEST.data, y / 10, "unit-of-residuals"),
        ("metres", TEST.data, y / 1000, "unit-of-residuals"),
        ("micrometres", TEST.data, y * 1000, "unit-of-residuals"),
        ("one row late", TEST.data, np.roll(y, 1, axis=0), "shifted-rows"),
        ("one row early", TEST.data, np.roll(y, -1, axis=0), "shifted-rows"),
        ("a row of the angles is missing", DROPPED, y, "shifted-rows"),
        ("another order", TEST.data, y[SHUFFLED], "rows-unrelated"),
        ("y and z exchanged", TEST.data, y[:, [0, 2, 1]], "axes-of-residuals"),
        ("axes in turn", TEST.data, y[:, [1, 2, 0]], "axes-of-residuals"),
        ("x mirrored", TEST.data, y * [-1, 1, 1], "axes-of-residuals"),
        ("the tracker's frame", TEST.data, TURN.apply(y), "axes-of-residuals"),
        ("joints 2 and 3 exchanged", TEST.data[:, [0, 2, 1, 3, 4, 5]], y, "joints"),
        ("joint 4 reversed", TEST.data * [1, 1, 1, -1, 1, 1], y, "joints"),
        ("the nominal table", TEST.data, getattr(OF_NOMINAL, kind), "other-table"),
        ("the poses of another file", OTHER.data, y, ANOTHER_FILE[kind]),
    ]
    for what, angles, residuals, code in cases:
        yield f"update_{kind}", what, partial(of, residuals, kind, angles), code


def late_column():
    """One joint's angles come from a logger that is a row late."""
    angles = TEST.data.copy()
    angles[:, 3] = np.roll(angles[:, 3], 1)
    return angles


WRONG_ANGLES = {
    "angles standardised": (TEST.data - TEST.data.mean(axis=0)) / TEST.data.std(axis=0),
    "sines of the angles": np.sin(TEST.data),
    "joints in reverse order": TEST.data[:, ::-1],
    "a column one row late": late_column(),
}
OF_OTHERS = ArmResidualRegressor(OTHER.arm, orders=2)
ON_A_WALL = ArmResidualRegressor(ARM.replace(up=(1, 0, 0)), orders=2)
COARSE = [np.deg2rad(np.rad2deg(TEST.data).round(n)) for n in (0, 2)]
HEAVY = np.r_[500.0, np.ones(N - 1)]


def copied(n=500):
    """The first half of the test, and its first row again and again."""
    rows = np.r_[np.arange(N // 2), np.zeros(n, dtype=int)]
    return of(OF.cones[rows], angles=TEST.data[rows], groups=TEST.groups[rows])


def before_every_fit():
    """Angles, table and weights that cannot be, and positions that nobody has named."""
    for name in ("fit_cones", "chain", "update_cones"):
        for what, angles in WRONG_ANGLES.items():
            yield name, what, partial(of, OF, angles=angles), "rows-unrelated"
    for name in ("fit_cones", "chain"):
        yield name, "another arm's table", lambda: of(OF, model=OF_OTHERS), "rows-unrelated"
        for what, angles in zip(("whole degrees", "two decimals"), COARSE, strict=True):
            y = residuals(angles=angles)
            yield name, what, partial(of, y, angles=angles), "coarse-angles"
        yield name, "one row 500 times", copied, "weight-of-one-pose"
    yield (
        "fit_cones",
        "one row of a weight of 500",
        lambda: of(OF, sample_weight=HEAVY),
        "weight-of-one-pose",
    )
    yield "pipeline", "groups forgotten", lambda: of(OF, groups=None), "positions-found"
    yield "chain", "an arm on a wall", lambda: of(OF, model=ON_A_WALL), "up of the arm is (1, 0, 0)"


MISTAKES = [
    # function, mistake, data, finding
    ("calibrate_cones", "degrees for radians", lambda: base(angles=np.rad2deg(TEST.data)), "angle-unit"),
    ("calibrate_cones", "radians for degrees", lambda: base(unit="deg"), "angle-unit"),
    ("calibrate_cones", "counts for degrees", lambda: base(angles=3e4 * TEST.data, unit="deg"), "angle-unit"),
    ("calibrate_cones", "whole degrees", lambda: base(angles=np.rad2deg(TEST.data).round(), unit="deg"), "coarse-angles"),
    ("calibrate_cones", "two decimals", lambda: base(angles=np.rad2deg(TEST.data).round(2), unit="deg"), "coarse-angles"),
    ("calibrate_cones", "joints in reverse order", lambda: columns(5, 4, 3, 2, 1, 0), "no-such-arm"),
    ("calibrate_cones", "joints 2 and 3 exchanged", lambda: columns(0, 2, 1, 3, 4, 5), "no-such-arm"),
    ("calibrate_cones", "joint 4 reversed", lambda: reversed_joints(4), "no-such-arm"),
    ("calibrate_cones", "all joints reversed", lambda: reversed_joints(1, 2, 3, 4, 5, 6), "table-off"),
    ("calibrate_cones", "joint 1 reversed", lambda: reversed_joints(1), "no-such-arm"),
    ("calibrate_cones", "the zero of joint 1 is 10 degrees off", lambda: base(angles=TEST.data + np.deg2rad([10, 0, 0, 0, 0, 0])), BECAUSE + "where the base points is nothing that cones show"),
    ("calibrate_cones", "a table in inches", lambda: base(arm=table(1 / 25.4)), "unit-of-table"),
    ("calibrate_cones", "a table in metres", lambda: base(arm=table(1e-3)), "unit-of-table"),
    ("calibrate_cones", "all lengths 2 % too long", lambda: base(arm=table(1.02)), BECAUSE + "cones show no scale"),
    ("calibrate_cones", "no labels", lambda: base(groups=None), "places-found"),
    ("calibrate_cones", "labels five rows late", shifted_labels, "wrong-label"),
    ("calibrate_cones", "two labels exchanged", lambda: exchanged(12, 52), "wrong-label"),
    ("calibrate_cones", "one label mistyped as another", lambda: base(groups=np.r_[3, TEST.groups[1:]]), "wrong-label"),
    ("calibrate_cones", "999 degrees in three rows", lambda: no_readings(999, "deg"), "no-reading"),
    ("calibrate_cones", "999 degrees in three rows, in rad", lambda: no_readings(999), "no-reading"),
    ("calibrate_cones", "-99 degrees in three rows", lambda: no_readings(-99, "deg"), "no-reading"),
    ("calibrate_cones", "zeros in three rows", lambda: no_readings(0), "no-reading"),
    ("calibrate_cones", "one cone as P1 and p1", lambda: two_names("P1", "p1"), "one-place"),
    ("calibrate_cones", "one cone as P1 and 'P1 '", lambda: two_names("P1", "P1 "), "one-place"),
    ("calibrate_cones", "one cone as A and B", lambda: two_names("A", "B"), "one-place"),
    ("calibrate_cones", "the third cone moved by 6 mm", moved_cone, "moved-position"),
    ("calibrate_cones", "a file pasted twice", twice, "copied-rows"),
    ("calibrate_cones", "a logger's stream", lambda: stream("cones"), "dwells"),
    ("calibrate_cones", "a label mistyped once", lambda: base(groups=np.r_[99, TEST.groups[1:]]), "lonely-position"),
    ("calibrate_cones", "twelve rows", lambda: base(angles=TEST.data[::12], groups=np.arange(12) % 3), "few-rows"),
    ("calibrate_cones", "a length in centimetres", lambda: known((0, 1), factor=0.1), "unit-of-lengths"),
    ("calibrate_cones", "a length in metres", lambda: known((0, 1), factor=1e-3), "unit-of-lengths"),
    ("calibrate_cones", "a length in inches", lambda: known((0, 1), factor=1 / 25.4), "unit-of-lengths"),
    ("calibrate_cones", "two lengths in inches", lambda: known((0, 1), (2, 3), factor=1 / 25.4), "unit-of-lengths"),
    ("calibrate_cones", "a length 3 mm too long", lambda: known((0, 1), plus=3.0), "wrong-length"),
    ("calibrate_cones", "one of three lengths 0.5 mm too long", lambda: one_too_long(0.5), "wrong-length"),
    ("calibrate_cones", "a ball's diameter forgotten", lambda: known((0, 1), plus=-12.0), "wrong-length"),
    ("calibrate_cones", "a ball's diameter forgotten in three bars", lambda: known((0, 1), (2, 3), (4, 5), plus=12.0), "wrong-length"),
    ("calibrate_cones", "the ends of two bars as one", lambda: known((0, 1), ends=(0, 2)), "wrong-length"),
    ("calibrate_cones", "the ends of two bars as one, of three", lambda: known((0, 1), (2, 3), (4, 5), ends=(4, 6)), "wrong-length"),
    ("calibrate_cones", "two bars, one stated 100 times too well", stated_too_well, "sd-of-lengths"),
    ("calibrate_cones", "two lengths of one pair", lambda: contradicting(1.0), "wrong-length"),
    ("calibrate_cones", "606 for 600 with a length", lambda: known((0, 1), arm=mistyped(3, 1.01)), "table-off"),
    ("calibrate_cones", "606 for 600", lambda: base(arm=mistyped(3, 1.01)), ""),
    ("calibrate_cones", "all lengths 2 % too long, and a known length", lambda: known((0, 1), arm=table(1.02)), "wrong-length"),
    ("calibrate_cones", "a joint one turn on", lambda: base(angles=TEST.data + [0, 0, 2 * np.pi, 0, 0, 0]), ""),
    ("calibrate_tracker", "points in inches", lambda: base(points=TRACKER / 25.4), "unit-of-points"),
    ("calibrate_tracker", "points in centimetres", lambda: base(points=TRACKER / 10), "unit-of-points"),
    ("calibrate_tracker", "points in metres", lambda: base(points=TRACKER / 1000), "unit-of-points"),
    ("calibrate_tracker", "points in micrometres", lambda: base(points=TRACKER * 1000), "unit-of-points"),
    ("calibrate_tracker", "the arm's own points", lambda: base(points=TEST.nominal_arm.forward(TEST.data)), "points-of-the-arm"),
    ("calibrate_tracker", "a mirrored frame", lambda: base(points=TRACKER[:, [1, 0, 2]]), "no-such-arm"),
    ("calibrate_tracker", "degrees for radians", lambda: base(angles=np.rad2deg(TEST.data)), "angle-unit"),
    ("calibrate_tracker", "points one row late", lambda: base(points=np.roll(TRACKER, 1, axis=0)), "no-such-arm|many-outliers|outliers"),
    ("calibrate_tracker", "joints 2 and 3 exchanged", lambda: columns(0, 2, 1, 3, 4, 5), "no-such-arm"),
    ("calibrate_tracker", "joint 4 reversed", lambda: reversed_joints(4), "no-such-arm"),
    ("calibrate_tracker", "the tracker moved by 0.5 mm", lambda: moved_tracker(0.5), "moved-station"),
    ("calibrate_tracker", "the tracker moved by 50 mm", lambda: moved_tracker(50), "moved-station"),
    ("calibrate_tracker", "another target, 0.5 mm aside", lambda: moved_target(0.5), "moved-tool"),
    ("calibrate_tracker", "another target, 5 mm aside", lambda: moved_target(5), "moved-tool"),
    ("calibrate_tracker", "another target, 50 mm aside", lambda: moved_target(50), "moved-tool"),
    ("calibrate_tracker", "a path instead of poses", path, "poses-alike"),
    *(("calibrate_tracker", f"a path that no model follows, {i}", partial(rough_path, i), "") for i in range(4)),
    ("calibrate_tracker", "a logger's stream", lambda: stream("tracker"), "dwells"),
    ("calibrate_tracker", "a file pasted twice", twice, "copied-rows"),
    ("calibrate_tracker", "ten rows", lambda: base(angles=TEST.data[:10], points=TRACKER[:10]), "few-rows"),
    ("calibrate_tracker", "the correction of another arm", lambda: base(more={"correction": clone(SMALL).fit(TEST.data, -OF.tracker)}), "harmful-correction"),
    ("fit_cones", "the wrong sign", lambda: of(-OF.cones), "sign-of-residuals"),
    ("fit_cones", "inches", lambda: of(OF.cones / 25.4), "unit-of-residuals"),
    ("fit_cones", "centimetres", lambda: of(OF.cones / 10), "unit-of-residuals"),
    ("fit_cones", "metres", lambda: of(OF.cones / 1000), "unit-of-residuals"),
    ("fit_cones", "one row late", lambda: of(np.roll(OF.cones, 1, axis=0)), "shifted-rows"),
    ("fit_cones", "one row early", lambda: of(np.roll(OF.cones, -1, axis=0)), "shifted-rows"),
    ("fit_cones", "another order", lambda: of(OF.cones[SHUFFLED]), "rows-unrelated"),
    ("fit_cones", "a row of the angles is missing", lambda: of(OF, angles=DROPPED), "shifted-rows"),
    ("fit_cones", "y and z exchanged", lambda: of(OF.cones[:, [0, 2, 1]]), "axes-of-residuals"),
    ("fit_cones", "x mirrored", lambda: of(OF.cones * [-1, 1, 1]), "axes-of-residuals"),
    ("fit_cones", "a frame turned by 60 degrees", lambda: of(TURN.apply(OF.cones)), "axes-of-residuals"),
    ("fit_cones", "joints 2 and 3 exchanged", lambda: of(OF, angles=TEST.data[:, [0, 2, 1, 3, 4, 5]]), "joints"),
    ("fit_cones", "joint 4 reversed", lambda: of(OF, angles=TEST.data * [1, 1, 1, -1, 1, 1]), "joints"),
    ("fit_cones", "micrometres", lambda: of(OF.cones * 1000), "unit-of-residuals"),
    ("fit_cones", "another arm's residuals", lambda: of(OF_OTHER), "other-table"),
    ("fit_cones", "the poses of another file", lambda: of(OF, angles=OTHER.data), "rows-unrelated"),
    ("fit_cones", "points for residuals", lambda: of(EXACT), "points-for-residuals"),
    ("fit_cones", "groups forgotten", lambda: of(OF, groups=None), "positions-found"),
    ("fit_cones", "an arm that is not calibrated", lambda: of(OF_NOMINAL, model=NOMINAL), "not-calibrated"),
    ("fit_cones", "residuals of the nominal table", lambda: of(OF_NOMINAL), "other-table"),
    ("fit_cones", "degrees for radians", lambda: of(OF, angles=np.rad2deg(TEST.data)), "angle-unit"),
    ("fit_cones", "weights that add up to 1", lambda: of(OF, sample_weight=np.full(N, 1 / N)), "worth-of-rows"),
    ("fit_cones", "a logger's stream", lambda: SimpleNamespace(**vars(stream("cones")) | {"model": clone(SMALL)}), "dwells"),
    ("fit_cones", "a dead thermometer", lambda: extra(np.full(N, 20.0)), "constant-column"),
    ("predict", "Fahrenheit for Celsius", lambda: 68 + 3 * WARM, "column-out-of-range"),
    ("predict", "a thermometer that has died", lambda: 0 * WARM - 273, "column-out-of-range"),
    ("fit_cones", "a thermometer that drifts", lambda: extra(np.linspace(20, 21, N)), BECAUSE + "nothing else has measured the temperature"),
    ("fit_tracker", "another frame, near", lambda: of(OF.tracker + [5.0, 2.0, 0.0], "tracker"), "another-frame"),
    ("fit_tracker", "another frame, far", lambda: of(EXACT - TRACKER), "points-for-residuals|no-residuals"),
    ("fit_tracker", "references that are off by 0.1 mm", lambda: of(constants(0.1)), "constants-of-positions"),
    ("fit_tracker", "references that are off by 1 mm", lambda: of(constants(1.0)), "constants-of-positions"),
    ("fit_tracker", "an arm that is not calibrated", lambda: of(OF_NOMINAL, "tracker", model=NOMINAL), "not-calibrated"),
    ("fit_tracker", "the arm's own points", lambda: of(np.zeros((N, 3))), "residuals-all-zero"),
    ("fit_tracker", "the wrong sign", lambda: of(-OF.tracker), BECAUSE + "errors of the other sign are those of some arm"),
    ("fit_tracker", "inches", lambda: of(OF.tracker / 25.4), BECAUSE + "an arm may be that good"),
    ("chain", "the wrong sign", lambda: of(-OF.cones), "sign-of-residuals"),
    ("chain", "an arm that is not calibrated", lambda: of(OF_NOMINAL, model=NOMINAL), "not-calibrated"),
    ("chain", "groups forgotten", lambda: of(OF, groups=None), "positions-found"),
    ("pipeline", "points for residuals", lambda: of(EXACT), "no-residuals"),
    ("pipeline", "another frame", lambda: of(OF.tracker + [5.0, 2.0, 0.0]), "another-frame"),
    ("pipeline", "a logger's stream", lambda: stream("cones"), "dwells"),
    ("pipeline", "degrees for radians", lambda: of(OF, angles=np.rad2deg(TEST.data)), "angle-unit"),
    *before_every_fit(),
    *update_mistakes("cones"),
    *update_mistakes("tracker"),
    ("update_cones", "two rows", lambda: of(OF.cones[:2], angles=TEST.data[:2], groups=TEST.groups[:2]), "few-poses"),
    ("transfer", "the wrong sign", lambda: of(-OF.cones), "sign-of-residuals"),
    ("learn_cones", "the third cone moved by 6 mm", moved_cone, "moved-position"),
    ("learn_cones", "labels five rows late", shifted_labels, "wrong-label"),
    ("learn_cones", "two labels exchanged", lambda: exchanged(12, 52), "wrong-label"),
    ("learn_cones", "999 degrees in three rows", lambda: no_readings(999, "deg"), "no-reading"),
    ("learn_cones", "joints 2 and 3 exchanged", lambda: columns(0, 2, 1, 3, 4, 5), "another-table"),
    ("learn_cones", "a logger's stream", lambda: stream("cones", 5), "dwells"),
    ("learn_cones", "whole degrees", lambda: base(angles=np.rad2deg(TEST.data).round(), unit="deg"), "coarse-angles"),
    ("learn_cones", "a length in inches", lambda: known((0, 1), factor=1 / 25.4), "unit-of-lengths"),
    ("learn_cones", "the ends of two bars as one", lambda: known((0, 1), ends=(0, 2)), "wrong-length"),
    ("learn_tracker", "points in inches", lambda: base(points=TRACKER / 25.4), "unit-of-points"),
    ("learn_tracker", "the tracker moved by 5 mm", lambda: moved_tracker(5), "another-table"),
    ("learn_tracker", "another target, 5 mm aside", lambda: moved_target(5), "moved-tool"),
    ("learn_cones", "a table in inches", lambda: base(arm=table(1 / 25.4)), "unit-of-table"),
]  # fmt: skip


# -- what the tool itself advises, writes and reads ------------------------------------------------


def advised(zeros=0.0, axes=(0, 1, 2), signs=1, arm=TEST.nominal_arm, **given):
    """The sentence that tells what is wrong with a table, or with a tracker's points."""
    from sklearn_raacmm import search_table

    where = given or {"points": (TRACKER * signs)[:, axes]}
    return str(search_table(arm, TEST.data - np.deg2rad(zeros), **where))


def taken(**more):
    """Codes of findings where the mirror image of an arm was taken."""
    arm = TEST.nominal_arm.replace(joint_signs=[1, -1, 1, 1, 1, 1])
    given = base(arm=arm, more={"take": "reversed-1-2-3-5"} | more)
    return " ".join(find_codes("learn_taken", given))


def said_of_urdf(text):
    from sklearn_raacmm.utils import Finding

    with Finding.collected() as found:
        Arm.from_urdf(text)
    return " ".join(map(str, found))


def written_again(rpy, up=(0, 0, 1)):
    """How far a file is off that was written and is read to the letter, and by the package, um."""
    arm = Arm.from_urdf(FIXED.format(rpy)).replace(up=up)
    text = arm.to_urdf() if up != (0, 0, 1) else arm.update_urdf(FIXED.format(rpy))
    again, letters = Arm.from_urdf(text), re.findall(r'rpy="([^"]*)"', text)
    off = np.abs(again.forward(TEST.data[:, :2]) - arm.forward(TEST.data[:, :2])).max()
    off += np.abs(again.up - arm.up).max()
    angles = np.array([one.split() for one in letters], dtype=float)
    rounded = np.abs(angles - np.round(angles / (np.pi / 2)) * np.pi / 2)
    off += rounded[rounded < 1e-4].max() * arm.reach_mm
    return f"{1000 * off:.3f} um"


def table_of(tmp_path, header):
    from sklearn_raacmm.app import read_table

    (tmp_path / "log.csv").write_text(f"{header}\nA,100,2\nA,99,3\n")
    try:
        return str(read_table(tmp_path / "log.csv", 2).angles)
    except ValueError as error:
        return str(error)


FIXED = """<robot name="r"><joint name="a" type="revolute"><parent link="0"/><child link="1"/>
<axis xyz="0 0 1"/></joint><joint name="f" type="fixed"><parent link="1"/><child link="2"/>
<origin xyz="0 0 .9" rpy="{} 0 0"/></joint><joint name="b" type="revolute"><parent link="2"/>
<child link="3"/><origin xyz=".2 0 0" rpy="0 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="t" type="fixed"><parent link="3"/><child link="4"/><origin xyz=".8 0 0" rpy="0 0 0"/>
</joint></robot>"""
TWICE = TEST.nominal_arm.replace(a=2 * TEST.nominal_arm.a + 100)
FROM_UPRIGHT = {"positions": TEST.groups, "zeros": [0, 180, 0, 0, 0, 0]}
# The first twelve search tables, as test_table_search.py does.
ADVICE = [
    ("joint 2 counted from upright", lambda _: advised(**FROM_UPRIGHT), r"\(raacmm learn --take zero-2-180\)"),
    ("its mirror image is called so", lambda _: advised(**FROM_UPRIGHT), r"mirror image: [^.]*--take reversed-3-5\)"),
    ("what decides is asked", lambda _: advised(**FROM_UPRIGHT), "counter-clockwise, seen from above: does its angle grow"),
    ("joint 2 counted from horizontal", lambda _: advised([0, 90, 0, 0, 0, 0], positions=TEST.groups), "--take zero-2-90"),
    ("a tracker's y negated", lambda _: advised(signs=[1, -1, 1]), "^With the points mirrored"),
    ("a tracker's y and z exchanged", lambda _: advised(axes=[0, 2, 1]), "^With the points mirrored"),
    ("zeros anywhere", lambda _: advised([0, 50, 70, 110, 160, 0], positions=TEST.groups), r"\(raacmm learn --take zeros\)"),
    ("a proposal that leaves centimetres", lambda _: advised([0, 50, 70, 110, 160, 0], arm=TWICE, positions=TEST.groups), "^None$"),
    ("a right table, cones", lambda _: advised(positions=TEST.groups), "^None$"),
    ("a right table, tracker", lambda _: advised(), "^None$"),
    ("the mirror image taken", lambda _: taken(), "mirror-image"),
    ("the question answered", lambda _: taken(accept="mirror-image"), "^(?!.*mirror-image)"),
    ("an arm that hangs, written and read", lambda _: written_again("0.3", (0, 0, -1)), "^0.000 um"),
    ("rounded angles of a fixed joint, written", lambda _: written_again("1.5708"), "^0.000 um"),
    ("1.5708 taken for a right angle", lambda _: said_of_urdf(FIXED.format("1.5708")), r"moves the probe by up to 0\.007 mm"),
    ("a column named twice", lambda path: table_of(path, "k,q1,q1"), "'q1' is named twice"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        pytest.param(*rest, marks=LONG if i < 12 else (), id=what)
        for i, (what, *rest) in enumerate(ADVICE)
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_what_is_advised_makes_nothing_worse(make, expected, tmp_path):
    assert re.search(expected, make(tmp_path), re.DOTALL)


def find_codes(name, data):
    """Codes of all findings, notes included, and the sentence of a refusal."""
    from sklearn_raacmm.utils import Finding

    with Finding.collected() as found, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            FUNCTIONS[name](data)
        except FindingError as error:
            return {error.finding.code}
        except ValueError as error:
            return {str(error)}
    return {finding.code for finding in found}


def test_few_mistakes_are_silent_and_wrong():
    """Each of them with the reason why no data can show it."""
    silent = [(name, what) for name, what, _, code in MISTAKES if code.startswith(BECAUSE)]
    assert len(MISTAKES) >= 150
    assert len(silent) <= 6, silent
    assert len({(name, what) for name, what, *_ in MISTAKES}) == len(MISTAKES)


@pytest.mark.parametrize(
    ("name", "make", "expected"),
    [
        pytest.param(name, *rest, marks=marks_of(name, what), id=f"{name}: {what}")
        for name, what, *rest in MISTAKES
    ],
)
def test_each_mistake_is_named_by_its_function(name, make, expected):
    found = find_codes(name, make())
    if expected.startswith(BECAUSE) or not expected:
        assert not found - {"outliers"}
    else:
        assert any(code.startswith(word) for word in expected.split("|") for code in found), found


@pytest.mark.parametrize("what", [*WRONG_ANGLES, "another arm's table"])
def test_fit_refuses_angles_that_are_not_those_of_the_arm(what):
    model = OF_OTHERS if what not in WRONG_ANGLES else SMALL
    with pytest.raises(FindingError, match="Within a position the arm's own points") as refused:
        clone(model).fit(WRONG_ANGLES.get(what, TEST.data), OF.cones, groups=TEST.groups)
    assert refused.value.finding.code == "rows-unrelated"


@pytest.mark.parametrize("n", [500, 5000])
def test_copies_of_one_row_end_in_a_finding(n):
    """5000 copies ended in a LinAlgError, which is a ValueError, too."""
    data = copied(n)
    with pytest.raises(FindingError, match=rf"row 0 has {n + 1} of all weights, {n + 72}: the 71"):
        fit(data)


CLEAN = dict.fromkeys(
    ["calibrate_cones", "calibrate_tracker", "learn_cones", "learn_tracker"], base
)
CLEAN |= dict.fromkeys(
    ["fit_cones", "chain", "pipeline", "update_cones", "transfer"], lambda: of(OF)
)
CLEAN |= dict.fromkeys(["fit_tracker", "update_tracker"], lambda: of(OF, "tracker"))


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=LONG if n in TAKE_LONG else ()) for n in CLEAN]
)
def test_clean_data_raise_no_finding(name):
    notes = {"outliers", "lengths-unknown", "make-believed"}
    assert not find_codes(name, CLEAN[name]()) - notes


def test_findings_travel_with_what_is_learnt():
    """What has to be repaired hands over nothing, unless it is accepted: then it is a doubt."""
    given = TEST.nominal_arm, moved_cone().angles, TEST.groups
    with pytest.raises(FindingError, match='accept "moved-position" to go on') as refused:
        learn_correction(*given, model=SMALL, cv=3)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        learned = learn_correction(*given, model=SMALL, cv=3, accept="moved-position")
    assert {one.filename for one in caught} == {__file__}
    assert {one.category for one in caught} == {FindingWarning}
    (found,) = [finding for finding in learned.findings if finding.code == "moved-position"]
    assert found.weight == "doubt"
    assert found.text == refused.value.finding.text
    assert found.positions == (2,)
    assert found.size_mm == pytest.approx(6, rel=0.3)
    assert learned.facts["findings"][0]["code"] in {f.code for f in learned.findings}
