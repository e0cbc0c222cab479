"""Extra columns: what they do to the probe, what they are worth, and what is refused."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer

from sklearn_raacmm import Arm, ArmResidualRegressor
from sklearn_raacmm.datasets import ArmErrors, make_single_point
from sklearn_raacmm.error_model._columns import ARCSEC, Terms, columns_of
from sklearn_raacmm.measurements import base_motions

from ._arms import ARMS, columns_by_name, displaced, draw_angles


def by_name(arm, theta, values, extra):
    """Columns of an extra, one for each name."""
    return columns_by_name(arm, np.column_stack([theta, values]), False, False, False, extra)


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_an_arm_that_grows_as_a_whole_stays_similar(arm):
    """All lengths by 4.8 ppm per K move every point along its radius; those below 1 mm stay."""
    arm = arm.replace(a=np.where(np.abs(arm.a) > 1, arm.a, 0), d=np.where(arm.d > 1, arm.d, 0))
    theta, kelvin = draw_angles(arm, 20), np.linspace(-3, 5, 20)
    columns = by_name(arm, theta, kelvin + 20, (("temperature", (20.0,)),))
    lengths = [c for name, c in columns.items() if not name.startswith("theta_offset")]
    grown = ARCSEC * kelvin[:, None] * arm.forward(theta)
    assert_allclose(sum(lengths), grown, atol=1e-9)
    assert len(lengths) == np.count_nonzero(np.r_[arm.a, arm.d, arm.probe])
    assert len(columns) == len(lengths) + arm.n_joints


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_temperature_near_one_joint_moves_that_joint_and_its_link(arm):
    theta, kelvin = draw_angles(arm, 20), np.full(20, 2.0)
    columns = by_name(arm, theta, kelvin, (("temperature 3", (0.0,)),))
    for name, column in columns.items():
        field = name.split()[0].removesuffix("3")
        assert name == f"{field}3 by temperature 3"
        value = getattr(arm, field).copy()
        value[2] += 2 * ARCSEC * (1.0 if field == "theta_offset" else value[2])
        moved = arm.replace(**{field: value}).forward(theta) - arm.forward(theta)
        assert_allclose(column, moved, atol=1e-7)
    assert "theta_offset3 by temperature 3" in columns
    last = by_name(arm, theta, kelvin, ((f"temperature {arm.n_joints}", (0.0,)),))
    assert "probe_z by" in " ".join(last)


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_direction_turns_its_joint_either_way(arm):
    theta, came = draw_angles(arm, 20), np.resize([1.0, -1.0, 0.0], 20)
    (column,) = by_name(arm, theta, came, (("direction 2", (0.5,)),)).values()
    error = np.zeros_like(theta)
    error[:, 1] = came - 0.5
    assert_allclose(column, displaced(arm, theta, error), atol=1e-7)


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_a_force_turns_every_frame_by_its_torque(arm):
    """The torque of a force about an axis is its work in a small turn about that axis."""
    theta, rng = draw_angles(arm, 20), np.random.default_rng(1)
    force = rng.normal(size=(20, 3))
    extra = tuple((f"force {axis}", (0.25,)) for axis in "xyz")
    frames, probe = arm.frames(theta), arm.forward(theta)
    columns = by_name(arm, theta, force + 0.25, extra)
    for name, column in columns.items():
        frame, axis = int(name.split()[3]), "xyz".index(name[-1])
        origin, along = frames[:, frame, :, 3], frames[:, frame, :, axis]
        moved = Rotation.from_rotvec(1e-6 * along).apply(probe - origin) + origin - probe
        torque = (moved * force).sum(axis=1) / 1e-6 / arm.reach_mm
        turn = Rotation.from_rotvec(ARCSEC * torque[:, None] * along)
        assert_allclose(column, turn.apply(probe - origin) + origin - probe, atol=1e-6)
    assert len(columns) == 3 * (arm.n_joints + 1)
    # A payload is a weight: it pulls along -z, as the loads of gravity do.
    payload = by_name(arm, theta, -force[:, 2] + 3, (("payload", (3.0,)),))
    only_z = by_name(arm, theta, force[:, 2], (("force z", (0.0,)),))
    for name in only_z:
        assert_allclose(payload[name], only_z[name], atol=1e-12)
    loads = columns_by_name(arm, theta, True, False, False)
    one = by_name(arm, theta, np.ones(20), (("payload", (0.0,)),))
    expected = loads["load at probe bends frame 2 about y"]
    assert_allclose(one["force bends frame 2 about y"], expected, atol=1e-12)


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_a_base_on_a_column_turns_and_shifts_by_the_torque_of_each_load(arm):
    """By the vector of each torque and Rodrigues; the higher, the more."""
    arm = arm.replace(up=(0.0, 0.6, 0.8))
    theta, height = draw_angles(arm, 20), np.linspace(400, 900, 20)
    columns = by_name(arm, theta, height, (("base height", (600.0, 400.0, 900.0)),))
    probe, share = arm.forward(theta), (height - 600) / 250
    places = np.concatenate([arm.frames(theta)[:, 1:, :, 3], probe[:, None]], axis=1)
    n = arm.n_joints
    for load in range(1, n + 2):
        torque = np.cross(places[:, load - 1], -arm.up) / arm.reach_mm * ARCSEC
        at = f"load at {'probe' if load > n else f'frame {load}'}"
        for axis, other in ((0, 1), (1, 0)):
            leans = 500.0 * torque[:, [other]] * np.eye(3)[axis]
            name = f"{at} shifts the base along {'xy'[axis]}"
            assert_allclose(columns[name], leans, atol=1e-12)
            assert_allclose(columns[f"{name} by base height"], share[:, None] * leans, atol=1e-12)
            turn = Rotation.from_rotvec(torque[:, [axis]] * np.eye(3)[axis])
            moved = share[:, None] * (turn.apply(probe) - probe)
            name = f"{at} turns the base about {'xy'[axis]} by base height"
            assert_allclose(columns[name], moved, atol=2e-5)
    # Where the base has been found is another place at every height.
    sizes = np.array([500.0**2, 500.0]) / arm.reach_mm * ARCSEC
    shift = columns["base along z by base height"]
    assert_allclose(shift, sizes[0] * share[:, None] * [0, 0, 1], atol=1e-12)
    turn = Rotation.from_rotvec(np.outer(share * sizes[1], [0, 0, 1]))
    assert_allclose(columns["base about z by base height"], turn.apply(probe) - probe, atol=2e-5)
    assert len(columns) == 6 * (n + 1) + 6


def column_displacement(arm, angles, height, stiffness):
    """What the top of a column of so many mm does to the probe, by the textbook's cantilever."""
    frames, force = arm.frames(angles), np.array([0, 0, -1.0])
    weights = zip((2, 3, 6), (60.0, 40.0, 30.0), strict=True)  # N at three frames
    torque = sum(w * np.cross(frames[:, k, :, 3], force) for k, w in weights)
    turn = torque * (height / stiffness)[:, None]
    shift = np.cross(torque, [0, 0, 1.0]) * (height**2 / (2 * stiffness))[:, None]
    return np.cross(turn, arm.forward(angles)) + shift


def test_an_arm_on_a_column_is_corrected_at_unseen_heights_and_places():
    arm, rng = ARMS["standard"], np.random.default_rng(0)
    stations, unseen = np.linspace(300, 1100, 5), np.array([400.0, 700.0, 1000.0])

    def measured(heights, n, noise):
        theta = draw_angles(arm, n * len(heights), len(heights))
        height = np.repeat(heights, n)
        y = column_displacement(arm, theta, height, 6e10)
        y += noise * rng.normal(size=y.shape)
        for one in heights:  # each base has been found with what a motion takes of it
            own, here = height == one, arm.forward(theta[height == one])
            moves = base_motions(here, arm.reach_mm).reshape(-1, 6)
            y[own] -= (moves @ np.linalg.lstsq(moves, y[own].ravel())[0]).reshape(-1, 3)
        return np.column_stack([theta, height]), y

    (X, y), (new, truth) = measured(stations, 30, 0.02), measured(unseen, 60, 0.0)
    sizes = []
    for extra, n in ((["base height"], 7), ([], 6)):
        model = ArmResidualRegressor(arm, extra=extra, orders=2).fit(X[:, :n], y)
        left = truth - model.predict(new[:, :n])
        for one in unseen:
            own = new[:, 6] == one
            moves = base_motions(arm.forward(new[own, :6]), arm.reach_mm).reshape(-1, 6)
            moved = moves @ np.linalg.lstsq(moves, left[own].ravel())[0]
            left[own] -= moved.reshape(-1, 3)
        sizes.append(np.linalg.norm(left, axis=1).mean())
    assert sizes[0] < 0.3 * sizes[1]


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_rows_may_have_probes_of_their_own(arm):
    """The columns are those of an arm with that probe, in units of the model's own arm."""
    extra = (("temperature", (20.0,)), ("base height", (500.0,)))
    terms = Terms(np.array([(1, 1), (3, 2)]), True, True, True, extra)
    values = np.linspace([15, 300], [30, 900], 20)
    rows = np.column_stack([draw_angles(arm, 20), values])
    for length in (-40.0, 400.0):
        own = arm.replace(probe=arm.probe + np.array([5.0, -8.0, length]))
        found = columns_of(arm, terms).at(np.hstack([rows, np.tile(own.probe, (20, 1))]))
        expected = columns_of(own, terms).at(rows)
        ratio, waves = arm.reach_mm / own.reach_mm, 2 * len(terms.harmonics)
        places = {name: waves + i for i, name in enumerate(columns_of(own, terms).names)}
        for i, name in enumerate(columns_of(arm, terms).names):
            is_length = name[:-1] in ("a", "d", "probe_", "base_")
            unit = ratio if is_length else 1 / ratio if name.startswith(("load", "base a")) else 1.0
            assert_allclose(found[:, :, waves + i], unit * expected[:, :, places[name]], atol=1e-12)
        assert_allclose(found[:, :, :waves], expected[:, :, :waves], atol=1e-12)


# What the arm has, the extra columns, and how much of the deviation is left at most.
CAUSES = {
    "direction": ({"play_arcsec": 6.0}, [f"direction {j}" for j in range(1, 7)], 0.85),
    "temperature": ({"drift_k": 8.0}, ["temperature"], 0.7),
    "payload": ({"payload_n": 20.0}, ["payload"], 0.35),
}


def left_at_unseen_positions(test, values, extra):
    """Mean distance to the truth at positions left out, with and without the extra columns."""
    y, train = test.points - test.simulation.true_points, test.groups % 2 == 0
    left = []
    for names, X in ((extra, np.column_stack([test.data, values])), ([], test.data)):
        model = ArmResidualRegressor(test.arm, orders=3, extra=names)
        model.fit(X[train], y[train], groups=test.groups[train])
        left.append(np.linalg.norm(y[~train] - model.predict(X[~train]), axis=1).mean())
    return left


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n == "payload" else pytest.mark.exhaustive) for n in CAUSES],
)
def test_a_cause_is_found_and_noise_costs_nothing(name):
    sizes, extra, share = CAUSES[name]
    test = make_single_point(16, 10, machine=ArmErrors(**sizes), random_state=1)
    values = test.directions if name == "direction" else test[name]
    with_it, without = left_at_unseen_positions(test, values, extra)
    assert with_it < share * without
    # The same arm without that cause, and numbers that have nothing to do with it.
    test = make_single_point(16, 10, machine=ArmErrors(), random_state=1)
    noise = np.random.default_rng(0).permutation(values)
    with_it, without = left_at_unseen_positions(test, noise, extra)
    assert with_it < 1.01 * without


def test_causes_are_learnt_from_several_probes():
    """An eccentric encoder 5: 100 and 250 mm together tell what a probe of 400 mm will show."""
    arm, rng = Arm.from_name("aacmm6"), np.random.default_rng(0)
    theta = draw_angles(arm, 240)
    lengths = np.repeat([100.0, 250.0], 120)
    probes = np.column_stack([np.zeros((240, 2)), lengths])

    def shown(theta, arm):
        error = np.zeros_like(theta)
        error[:, 4] = 8 * np.cos(theta[:, 4] - 1)
        return displaced(arm, theta, error)

    arms = {length: arm.replace(probe=(0, 0, length)) for length in (100.0, 250.0, 400.0)}
    y = np.concatenate([shown(theta[lengths == k], arms[k]) for k in (100.0, 250.0)])
    y += rng.normal(scale=0.001, size=y.shape)
    model = ArmResidualRegressor(arms[100.0], orders=2)
    far = draw_angles(arm, 100, 1)
    true = shown(far, arms[400.0])
    left = [
        np.linalg.norm(true - model.fit(theta, y, probes=given).with_arm(arms[400.0]).predict(far))
        for given in (probes, None)
    ]
    assert left[0] < 0.1 * np.linalg.norm(true) < 0.5 * left[1]
    with pytest.raises(ValueError, match=r"probes must have shape \(240, 3\), in mm, got \(240,\)"):
        model.fit(theta, y, probes=lengths)


@pytest.fixture(scope="module")
def lagging():
    """Simulated: joint 2 lags by 10 arc seconds, and a temperature that does nothing."""
    arm, rng = ARMS["standard"], np.random.default_rng(0)
    theta = draw_angles(arm, 160)
    came = rng.choice([-1.0, 1.0], 160)
    error = np.zeros_like(theta)
    error[:, 1] = 10 * came
    y = displaced(arm, theta, error) + rng.normal(scale=0.003, size=(160, 3))
    return arm, np.column_stack([theta, came, rng.normal(20, 1, 160)]), y, np.arange(160) % 8


SMALL = {"orders": 2, "causes": ["kinematics"]}
EXTRA = ["direction 2", "temperature"]


def test_through_pipelines_and_searches(lagging):
    arm, X, y, groups = lagging
    model = ArmResidualRegressor(arm, extra=EXTRA, **SMALL)
    pipe = make_pipeline(FunctionTransformer(), clone(model))
    scores = cross_val_score(pipe, X, y, cv=GroupKFold(3), groups=groups)
    assert scores.min() > 0.9
    search = GridSearchCV(
        model, {"extra": [["direction 3", "temperature"], EXTRA]}, cv=GroupKFold(4)
    )
    search.fit(X, y, groups=groups)
    assert search.best_params_ == {"extra": EXTRA}
    best = search.best_estimator_
    assert best.n_features_in_ == 8
    assert best.terms_["family"].tolist().count("direction") == 1
    lag = best.terms_[best.terms_["name"] == "joint 2 lags"]
    assert abs(lag["value"][0] - 10) < 4 * lag["sd"][0] < 2
    assert best.prior_sd_["temperature"] < 0.2
    again = pickle.loads(pickle.dumps(best))
    assert_array_equal(again.predict(X), best.predict(X))
    # Whatever the direction, the lengths of standard deviations and of the fading are there.
    assert best.distance_std(X[:5], X[5:10]).shape == best.fading(X[:5]).shape == (5,)


def test_what_is_refused(lagging):
    arm, X, y, _ = lagging
    model = ArmResidualRegressor(arm, extra=["payload"], **SMALL).fit(X[:, :7], y)
    with pytest.raises(ValueError, match="expecting 7 features"):
        model.predict(X[:, :6])
    constant = np.column_stack([X[:, :6], np.full(160, 20.0)])
    model.set_params(extra=["temperature"])
    with pytest.warns(UserWarning, match="'temperature' is 20 in all rows") as seen:
        model.fit(constant, y)
    assert seen[0].filename == __file__
    warm = constant + np.r_[np.zeros(6), 10.0]
    assert_allclose(model.predict(warm), model.predict(constant), atol=1e-9)
