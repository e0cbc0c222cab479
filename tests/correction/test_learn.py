"""The one call against the same steps written out, planted slips, and arms it cannot help."""

import gc
import json
import pickle
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF
from sklearn.model_selection import GroupKFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    CylindricalResidualTarget,
    Measurements,
    PoseFeatures,
    RBFNetRegressor,
    calibrate,
    learn_correction,
    position_residuals,
)
from sklearn_raacmm.correction._one_fit import Data
from sklearn_raacmm.correction._scores import coverage_of, folds_of
from sklearn_raacmm.datasets import make_gauge, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

MODEL = ArmResidualRegressor(orders=4)
# Where the numbers do not matter.
QUICK = ArmResidualRegressor(orders=2, causes=["kinematics"])
NETWORK = RBFNetRegressor(20, length_scale=1.0, alpha=0.1)


@pytest.fixture(scope="module")
def test_data():
    return make_single_point(n_positions=7, n_poses=20, random_state=1)


@pytest.fixture(scope="module")
def learned(test_data):
    labels = np.array(list("ABCDEFG"))[test_data.groups]
    return learn_correction(test_data.nominal_arm, test_data.data, labels, model=MODEL, cv=3)


def by_hand(test, folds, model):
    """Points of an arm that was calibrated without them, and what a model leaves of each."""
    X, groups = test.data, test.groups
    points, corrected = np.empty((2, len(X), 3))
    for train, rows in folds:
        arm = calibrate(test.nominal_arm, X[train], groups[train]).arm
        y = position_residuals(arm.forward(X[train]), groups[train])
        fitted = clone(model).set_params(arm=arm).fit(X[train], y, groups=groups[train])
        points[rows] = arm.forward(X[rows])
        corrected[rows] = points[rows] - fitted.predict(X[rows])
    return points, corrected


def test_scores_are_those_of_the_steps_written_out(test_data, learned):
    """Calibration and model know nothing of the positions that they are judged at."""
    groups = test_data.groups
    both = by_hand(test_data, GroupKFold(3).split(groups, groups=groups), MODEL)
    before, after = (single_point_repeatability(one, groups, aggregate=None) for one in both)
    assert len(learned.outliers) == 0
    assert learned.scores.table["position"].tolist() == list("ABCDEFG")
    assert_allclose(learned.scores.table["before"], before, rtol=1e-9)
    # The folds begin with the direction of gravity and the weights of the whole.
    assert_allclose(learned.scores.table["after"], after, rtol=1e-6)
    assert learned.helps
    better, least = np.sum(after < before), np.argmax(after / before)
    assert (
        f", {before.mean():.3f} calibrated, {after.mean():.3f} corrected, {better} of 7"
        in learned.verdict
    )
    assert f"least went from {before[least]:.3f} to {after[least]:.3f} mm" in learned.verdict


def test_intervals_are_those_of_student_of_the_logarithm(learned):
    table = learned.scores.table
    for name in ("before", "after"):
        x = table[name]
        relative = stats.t.interval(0.95, len(x) - 1, scale=stats.sem(x) / x.mean())
        value, low, high = learned.scores.summary[name]
        assert (value, low, high) == pytest.approx((x.mean(), *x.mean() * np.exp(relative)))
    value, low, high = learned.scores.summary["ratio"]
    assert value == pytest.approx(table["after"].mean() / table["before"].mean())
    # By definition (Fieller): those ratios at which a t test does not refuse a mean of zero.
    limit = stats.t.ppf(0.975, len(x) - 1)
    for end, expected in ((low, limit), (high, -limit)):
        left = table["after"] - end * table["before"]
        assert stats.ttest_1samp(left, 0).statistic == pytest.approx(expected, rel=1e-6)


def test_coverage_is_that_of_the_raw_deviations():
    """Ten times as large deviations hold more, by the normal distribution."""
    rng = np.random.default_rng(0)
    std = rng.uniform(0.1, 2, (4000, 3))
    left = 2.5 * std * rng.standard_normal((4000, 3))
    left[:10] = np.nan  # outliers are not counted
    for times in (0.5, 1.0, 10.0):
        share, factor = coverage_of(left, times * std)
        assert share == pytest.approx(2 * stats.norm.cdf(1.96 * times / 2.5) - 1, abs=0.01)
        assert factor == pytest.approx(2.5 / times, rel=0.04)  # two deviations of the quantile


def test_corrected_points_are_nearer_to_the_truth(test_data, learned):
    """A new test of the same arm: the correction and its intervals hold at other places."""
    other = make_single_point(
        n_positions=5, n_poses=30, machine=test_data.simulation.machine, random_state=77
    )
    points, std = learned.correct(np.rad2deg(other.data), angle_unit="deg")
    before = single_point_repeatability(learned.arm.forward(other.data), other.groups)
    assert single_point_repeatability(points, other.groups) < 0.6 * before
    left = position_residuals(points, other.groups)
    assert 0.85 < np.mean(np.abs(left) < 1.96 * std) <= 1


def test_slipped_probes_are_found_and_nothing_else(test_data):
    X = test_data.data.copy()
    X[[7, 100], [2, 4]] += [0.005, -0.01]
    learned = learn_correction(test_data.nominal_arm, X, test_data.groups, model=QUICK, cv=3)
    assert learned.outliers["row"].tolist() == [7, 100]
    assert learned.outliers["position"].tolist() == test_data.groups[[7, 100]].tolist()
    assert np.all(learned.outliers["distance"] > 0.3)
    assert np.flatnonzero(np.isnan(learned.scores.left_after[:, 0])).tolist() == [7, 100]
    assert learned.scores.table["before"].max() < 0.2
    assert "row 7 (0)" in str(learned)


def test_positions_of_one_block_are_left_out_together(test_data):
    blocks = np.array(["left", "right", "top", "back"])[test_data.groups % 4]
    given = test_data.nominal_arm, test_data.data, test_data.groups
    scores = learn_correction(*given, model=QUICK, cv=4, blocks=blocks).scores
    _, corrected = by_hand(test_data, GroupKFold(4).split(blocks, groups=blocks), QUICK)
    expected = position_residuals(corrected, test_data.groups)
    assert_allclose(scores.left_after, expected, rtol=1e-7, atol=1e-7)  # a tenth of a nanometre
    # Seven positions would be enough to tell; four blocks are not.
    assert scores.n_blocks == 4
    assert "4 blocks of positions are too few" in scores.verdict
    with pytest.raises(ValueError, match="at least 3 positions"):
        learn_correction(*given, model=QUICK, blocks=test_data.groups % 2)
    with pytest.raises(ValueError, match="blocks"):
        learn_correction(*given, model=QUICK, blocks=blocks[:-1])


@pytest.mark.exhaustive
def test_lengths_are_judged_where_both_ends_were_left_out():
    data = make_gauge(400, n_placements=6, n_poses=12, random_state=3)
    lengths = [(int(a), int(b), 400.0, 0.01) for a, b in data.pairs]
    scores = learn_correction(
        data.nominal_arm, data.data, data.groups, lengths=lengths, model=QUICK, cv=3
    ).scores
    assert sorted(entry[:2] for entry in scores.lengths) == [tuple(p) for p in data.pairs.tolist()]
    # By hand, for the placements of the first fold.
    blocks = data.groups // 2
    train, test = next(GroupKFold(3).split(data.data, groups=blocks))
    known = [entry for entry in lengths if entry[0] // 2 in blocks[train]]
    arm = calibrate(data.nominal_arm, data.data[train], data.groups[train], lengths=known).arm
    first = data.groups[test][0] // 2 * 2
    ends = [arm.forward(data.data[data.groups == first + i]).mean(axis=0) for i in (0, 1)]
    error = np.linalg.norm(ends[0] - ends[1]) - 400
    place = [entry[0] for entry in scores.lengths].index(first)
    assert scores.length_errors_before[place] == pytest.approx(error, abs=1e-6)
    assert "Known lengths (6), mean error" in str(scores)
    # The two ends of a placement resemble each other: placements are independent, not ends.
    pairs = scores.table["after"].reshape(6, 2).mean(axis=1)
    relative = stats.t.interval(0.95, 5, scale=stats.sem(pairs) / pairs.mean())
    assert scores.summary["after"][1:] == pytest.approx(pairs.mean() * np.exp(relative))
    # A length is not judged by an arm that was calibrated without any.
    scores = learn_correction(
        data.nominal_arm, data.data, data.groups, lengths=lengths[:1], model=QUICK, cv=3
    ).scores
    assert scores.lengths == []


def test_a_plate_of_known_distances_still_leaves_positions_out(test_data):
    """All positions joined by lengths make one block: they are then left out one by one."""
    truth = test_data.simulation.positions
    lengths = [(0, i, float(np.linalg.norm(truth[0] - truth[i])), 0.05) for i in range(1, 7)]
    scores = learn_correction(
        test_data.nominal_arm, test_data.data, test_data.groups, lengths=lengths, model=QUICK, cv=3
    ).scores
    assert scores.n_folds == 3
    assert scores.summary["ratio"][0] < 1
    assert len(scores.lengths) < 6


def test_against_a_tracker(test_data):
    """True points in a frame of their own: deviations from them, base fitted in every fold."""
    truth = test_data.simulation.true_points
    tracker = truth[:, [1, 2, 0]] + [1500, -20, 300]
    learned = learn_correction(
        test_data.nominal_arm, test_data.data, test_data.groups, tracker, model=MODEL, cv=3
    )
    assert learned.scores.measure == "mean deviation"
    assert learned.scores.summary["ratio"][0] < 0.8
    result = learned.calibration
    corrected = learned.correct(test_data.data)[0]
    error = corrected @ result.base_rotation.T + result.base_translation - tracker
    assert np.linalg.norm(error, axis=1).mean() < 0.02
    left = np.linalg.norm(learned.scores.left_after, axis=1)
    means = [left[test_data.groups == i].mean() for i in range(7)]
    assert_allclose(learned.scores.table["after"], means)


def two_probes():
    """Two probes of an arm CMM with an oval encoder 5, 8 positions each, simulated."""
    arm, rng = Arm.from_name("aacmm6"), np.random.default_rng(0)
    theta = rng.uniform(-2, 2, (320, 6))
    turned = theta.copy()
    turned[:, 4] += np.deg2rad(40 / 3600) * np.cos(2 * theta[:, 4] - 1)
    tools = np.repeat(["short", "long"], 160)
    arms = {"short": arm.replace(probe=(0, 0, 100)), "long": arm.replace(probe=(3, 0, 250))}
    points = np.concatenate([arms[tool].forward(turned[tools == tool]) for tool in arms])
    points = points + np.array([1000.0, 0, 0]) + rng.normal(scale=0.003, size=points.shape)
    return theta, np.arange(320) % 8, points, tools, arms, turned


@pytest.mark.exhaustive
def test_several_probes_are_learnt_together(tmp_path):
    """The model belongs to all of them, whichever is named first; each has its own vector."""
    theta, groups, points, tools, arms, turned = two_probes()
    arm, model = arms["short"], ArmResidualRegressor(orders=2)
    learned = learn_correction(arm, theta, groups, points, model=model, tools=tools)
    assert learned.helps
    assert learned.scores.summary["after"][0] < 0.6 * learned.scores.summary["before"][0]
    assert set(learned.tools) == {"short", "long"}
    learned.save(tmp_path)
    for saved in (learned, learned.load(tmp_path)):
        for tool, own in arms.items():
            rows, moved = tools == tool, saved.with_tool(tool)
            assert_allclose(moved.arm.probe, own.probe, atol=0.02)
            left = moved.correct(theta[rows])[0] - own.forward(turned[rows])
            bare = moved.arm.forward(theta[rows]) - own.forward(turned[rows])
            assert np.linalg.norm(left) < 0.5 * np.linalg.norm(bare)
    with pytest.raises(ValueError, match="knows no tool 'other'; it was learnt with long, short"):
        learned.with_tool("other")


def test_faults_of_tools_get_one_sentence():
    theta, groups, points, tools, arms, _ = two_probes()
    data = arms["short"], theta, groups, points
    alone = np.where((groups == 3) & (tools == "short"), "third", tools)
    for message, options in (
        ("all positions of tool 'third' are left out together", {"tools": alone}),
        (r"tools has 5 labels|tools .*320", {"tools": tools[:5]}),
        ("like and tools cannot be given together", {"tools": tools, "like": [MODEL]}),
        ("tools need an ArmResidualRegressor", {"tools": tools, "model": RBFNetRegressor()}),
        ("or mend a mistyped label", {"tools": np.r_[["shrot"], tools[1:]]}),
    ):
        with pytest.raises(ValueError, match=message):
            learn_correction(*data, **({"model": QUICK} | options))


def test_tracker_points_without_labels_are_left_out_by_region():
    rng = np.random.default_rng(2)
    arm = Arm.from_name("ur10")
    X = rng.uniform(-2, 2, (200, 6))
    tracker = arm.forward(X) + 0.1 * np.cos(X[:, [0]]) * np.array([0, 0, 1.0])
    with warnings.catch_warnings():  # no cause of the model does this
        warnings.simplefilter("ignore")
        learned = learn_correction(arm, X, points=tracker, model=QUICK, cv=3)
    labels = learned.scores.table["position"].tolist()
    assert labels == [f"region {i:02d}" for i in range(1, 31)]
    # Neighbours share a region: its points are nearer to their centre than the cloud is wide.
    spread = [np.ptp(tracker[learned.positions == label], axis=0).max() for label in labels]
    assert max(spread) < np.ptp(tracker, axis=0).max()


def test_names_of_single_poses_are_judged_as_without_names():
    rng = np.random.default_rng(3)
    arm = Arm.from_name("ur10")
    X = rng.uniform(-2, 2, (60, 6))
    tracker = arm.forward(X) + rng.normal(0, 0.05, (60, 3))
    names = np.array([f"P{i}" for i in range(60)])
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)  # SciPy warns of means of one number
        warnings.simplefilter("ignore", UserWarning)
        with_names, without = (
            learn_correction(arm, X, given, tracker, model=QUICK, cv=2) for given in (names, None)
        )
    assert with_names.verdict == without.verdict
    assert len(with_names.scores.table["position"]) == 15  # of four poses each
    assert with_names.scores.table["n_points"].min() > 1
    for learned, why in ((with_names, "name single poses"), (without, "are no labels")):
        (said,) = [f.text for f in learned.findings if f.code == "judged-at-regions"]
        assert said.startswith("Judged at 15 regions of neighbouring points: the")
        assert why in said
    # Two poses of a name are a position; blocks hold names of single poses.
    two = Measurements.of(X, np.repeat(names[:30], 2), points=tracker)
    assert len(np.unique(Data(arm, two).positions)) == 30
    blocks = np.repeat(["left", "right", "top"], 20)
    single = Measurements.of(X, names, points=tracker)
    assert_array_equal(Data(arm, single, blocks=blocks).positions, blocks)


def test_places_without_labels_are_left_out_as_a_whole():
    rng = np.random.default_rng(4)
    arm = Arm.from_name("ur10")
    nest = rng.permutation(np.repeat(np.arange(12), 6))
    X = rng.uniform(-2, 2, (72, 6))
    points = rng.uniform(-800, 800, (12, 3))[nest] + rng.normal(0, 0.1, (72, 3))
    data = Data(arm, Measurements.of(X, points=points))
    pairs = np.unique(np.column_stack([nest, data.places]), axis=0)
    assert len(pairs) == len(np.unique(data.places)) == 12
    for train, test in folds_of(data, np.arange(0), None):
        assert not set(nest[train]) & set(nest[test])


@pytest.mark.parametrize(
    "model",
    [
        make_pipeline(
            PoseFeatures(angle_unit="deg", append_azimuth=True, joints="all", encoding="periodic"),
            CylindricalResidualTarget(make_pipeline(StandardScaler(), NETWORK)),
        ),
        CylindricalResidualTarget(
            make_pipeline(PoseFeatures(joints="all", encoding="periodic"), NETWORK),
            azimuth=Arm.from_name("ur10").azimuth,
        ),
        make_pipeline(
            StandardScaler(), GaussianProcessRegressor(1e-3 * RBF(2), alpha=1e-4, optimizer=None)
        ),
    ],
    ids=["pipeline", "target", "process"],
)
def test_any_regressor_is_judged_and_given_the_arm(test_data, model):
    learned = learn_correction(
        test_data.nominal_arm, test_data.data, test_data.groups, model=model, cv=3
    )
    params = learned.model.get_params(deep=True)
    assert all(params[name] == learned.arm for name in params if name.endswith("__arm"))
    if "azimuth" in params:
        assert params["azimuth"].__self__ == learned.arm
    assert {params[name] for name in params if name.endswith("angle_unit")} <= {"rad"}
    points, std = learned.correct(test_data.data[:3])
    assert points.shape == std.shape == (3, 3)
    assert np.all(std > 0)
    assert learned.scores.table["after"].mean() < learned.scores.table["before"].mean()


def test_the_default_is_the_arms_model_and_the_verdict_says_when_it_does_not_help():
    """An arm whose points scatter by noise alone: nothing to learn."""
    rng = np.random.default_rng(5)
    arm = Arm.from_name("ur10")
    X, groups = rng.uniform(-2, 2, (60, 6)), np.repeat(np.arange(6), 10)
    tracker = arm.forward(X) + rng.normal(scale=0.05, size=(60, 3))
    with pytest.warns(UserWarning, match="The correction is 0"):
        learned = learn_correction(arm, X, groups, tracker, cv=3)
    assert learned.model.get_params().keys() == ArmResidualRegressor().get_params().keys()
    assert not learned.helps
    assert learned.verdict.startswith("Do not use it: at new positions mean deviation")
    assert "reaches 1" in learned.verdict
    with pytest.warns(UserWarning, match="The correction is 0"):
        few = learn_correction(arm, X[:40], groups[:40], tracker[:40], model=QUICK, cv=3)
    assert "4 positions are too few to tell; measure at least 5" in few.verdict


def test_saved_and_loaded(tmp_path, learned, test_data):
    skops_io = pytest.importorskip("skops.io")
    from sklearn_raacmm.export import TRUSTED_TYPES

    facts, arm, model = learned.save(tmp_path / "new")
    assert Arm.from_json(arm) == learned.arm
    loaded = skops_io.load(model, trusted=TRUSTED_TYPES)
    expected = learned.model.predict(test_data.data)
    assert_array_equal(loaded.predict(test_data.data), expected)
    content = json.loads(facts.read_text(encoding="utf-8"))
    assert content["positions"]["after"] == learned.scores.table["after"].tolist()
    assert pickle.loads(pickle.dumps(learned)).verdict == content["verdict"] == learned.verdict
    saved, (one, other) = learned.load(tmp_path / "new"), np.split(test_data.data, 2)
    assert_array_equal(saved.distances(one, other), learned.distances(one, other))
    for correction in (learned, saved):
        with pytest.raises(ValueError, match="'temp', of which the model knows nothing"):
            correction.correct(one, extra={"temp": 25.0})


@pytest.mark.exhaustive
def test_progress_and_processes_change_nothing(test_data, learned):
    seen = []
    scores = learn_correction(
        test_data.nominal_arm, np.rad2deg(test_data.data), test_data.groups, angle_unit="deg",
        model=MODEL, cv=3, progress=lambda *done: seen.append(done), n_jobs=2,
    ).scores  # fmt: skip
    assert seen == [(i, 3) for i in range(1, 4)]
    assert_allclose(scores.table["after"], learned.scores.table["after"], atol=1e-7)


@pytest.mark.exhaustive
def test_what_progress_raises_ends_the_call_and_nothing_else_is_said(test_data):
    def cancel(*done):
        raise KeyboardInterrupt

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        with pytest.raises(KeyboardInterrupt):
            learn_correction(
                test_data.nominal_arm, test_data.data, test_data.groups, model=MODEL, cv=6,
                progress=cancel, n_jobs=2,
            )  # fmt: skip
        gc.collect()  # joblib speaks when its generator is closed
    assert [str(one.message) for one in said if "joblib" in one.filename] == []


@pytest.mark.filterwarnings("ignore::UserWarning")  # said beside the refusal
@pytest.mark.parametrize(
    ("signs", "unit", "change"),
    [
        pytest.param([1, 1, 1, -1, 1, 1], "rad", "joint 4 reversed", marks=pytest.mark.exhaustive),
        (None, "deg", "the angles in radians"),
    ],
)
def test_an_arm_of_another_table_is_refused_and_named(test_data, signs, unit, change):
    """Radians read as degrees, too: an arm that hardly moves scatters by little of its reach."""
    arm = test_data.nominal_arm
    arm = arm if signs is None else arm.replace(joint_signs=signs)
    message = rf"mm after calibration.*With {change} the points scatter by 0\.0\d+ mm instead"
    with pytest.raises(ValueError, match=message):
        learn_correction(arm, test_data.data, test_data.groups, model=QUICK, angle_unit=unit)


def test_a_joint_that_is_five_degrees_off_is_mended_by_calibration():
    """The verdict has what the table left, and says which joint; the correction adds nothing."""
    rng = np.random.default_rng(7)
    arm = Arm.from_name("irb120", probe=(10, 20, 100))
    X = rng.uniform(-1.2, 1.2, (80, 6))
    tracker = arm.forward(X)[:, [2, 0, 1]] + rng.normal(scale=0.03, size=(80, 3))
    off = X + np.deg2rad([0, 0, 0, 0, 5, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        learned = learn_correction(arm, off, points=tracker, model=QUICK, cv=2)
    assert learned.scores.calibration_helps
    given, before = (learned.scores.summary[when][0] for when in ("given", "before"))
    assert before < 0.06 < 1 < given
    assert f"mean deviation {given:.3f} mm as given, {before:.3f} calibrated, " in learned.verdict
    first, _, last = learned.scores.changes[0].partition(" degrees")
    name, _, change = first.rpartition(" ")
    assert (name, float(change)) == ("zero of joint 5", pytest.approx(-5, abs=0.05))
    assert last.startswith(" (sd 0.0")
    if not learned.helps:
        assert learned.verdict.startswith("Use the calibrated table without the correction")
