"""Arms described wrongly on purpose: the search names what was done to them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sklearn_raacmm import (
    Arm,
    ArmResidualRegressor,
    arm_from_data,
    calibrate,
    learn_correction,
    search_table,
)
from sklearn_raacmm.correction._table_search import with_change
from sklearn_raacmm.datasets import make_single_point


@pytest.fixture(scope="module")
def data():
    return make_single_point(n_positions=8, n_poses=15)


def take(arm, code):
    """The arm changed by a code that needs no data."""
    return with_change(arm, code, (None, None, None, "rad"))


EXCHANGED = [0, 1, 4, 3, 2, 5]


def more(*values):
    """Further values of a test, of the same kind as the first."""
    return pytest.param(*values, marks=pytest.mark.exhaustive)


@pytest.mark.parametrize(
    ("signs", "columns", "factor", "change"),
    [
        more([1, -1, 1, 1, 1, 1], None, 1, "joint 2 reversed"),
        more([1, 1, -1, -1, 1, 1], None, 1, "joints 3 and 4 reversed"),
        (1, EXCHANGED, 1, "joints 3 and 5 exchanged"),
        more(1, [5, 4, 3, 2, 1, 0], 1, "the joints in reverse order"),
        more(1, None, 180 / np.pi, "the angles in degrees"),
        ([1, 1, 1, -1, 1, 1], None, 180 / np.pi, "joint 4 reversed and the angles in degrees"),
    ],
)
def test_what_was_done_is_named(data, signs, columns, factor, change):
    wrong = data.nominal_arm.replace(joint_signs=signs)
    angles = factor * data.data[:, columns or range(6)]
    found = search_table(wrong, angles, data.groups)
    assert found.change == change
    # What is proposed does what it says.
    result = calibrate(
        found.arm, angles[:, found.columns], data.groups, angle_unit=found.angle_unit
    )
    assert found.scatter_mm == pytest.approx(result.scatter_after_mm, rel=1e-6)
    assert found.scatter_mm < 0.1 < 20 < found.scatter_given_mm
    assert str(found).startswith(f"With {change} the points scatter by 0.0")
    reversed_ = [str(i + 1) for i in range(6) if np.resize(signs, 6)[i] < 0]
    assert ("-".join(["--take reversed", *reversed_]) in found.options) == bool(reversed_)
    assert ("--unit deg" in found.options) == (factor != 1)
    assert (f"columns {','.join(str(i + 1) for i in columns or ())}" in found.options) == (
        columns is not None
    )


def centred(points):
    return points - points.mean(axis=0)


def hand(arm, other, angles):
    """Whether the points of two arms are the same ones turned (1), or mirrored (-1): best fits."""
    return hand_of(arm.forward(angles), other.forward(angles))


def hand_of(points, others):
    first, second = centred(points), centred(others)
    left = [Rotation.align_vectors(first, sign * second)[1] for sign in (1, -1)]
    return 1 if left[0] < left[1] else -1


def test_the_mirror_image_is_named_beside_it(data):
    """Roll joints turned round and y the other way: no scatter tells, the sense of joint 1 does."""
    wrong = data.nominal_arm.replace(joint_signs=[1, -1, 1, 1, 1, 1])
    found = search_table(wrong, data.data, data.groups)
    (mirror,) = (one for one in found.equals if one.is_mirror)
    assert mirror.options == "--take reversed-1-2-3-5"
    assert mirror.scatter_mm == pytest.approx(found.scatter_mm, rel=0.01)
    np.testing.assert_allclose(found.first_point, data.arm.forward(data.data[:1])[0], atol=10)
    assert "Its mirror image: joints 1 and 2 and 3 and 5 reversed" in str(found)
    assert "joint 1 counter-clockwise, seen from above: does its angle grow?" in found.questions[0]
    assert (found.answers[0], mirror.answers[0]) == ("yes", "no")


@pytest.mark.parametrize("degrees", [90, more(180), more(270)])
def test_a_joint_that_is_counted_from_upright_or_horizontal(data, degrees):
    """Each table that explains the data is said to be of the right hand, or of the other."""
    zero = np.deg2rad([0, degrees, 0, 0, 0, 0])
    found = search_table(data.nominal_arm, data.data - zero, data.groups)
    assert found.change == f"the zero of joint 2 turned by {degrees} degrees"
    assert take(data.nominal_arm, found.options.split()[1]) == found.arm
    np.testing.assert_allclose(
        found.arm.forward(data.data - zero), data.nominal_arm.forward(data.data), atol=1e-9
    )
    hands = [one.is_mirror for one in found.equals]
    assert True in hands
    assert False in hands
    for one in found.equals:
        assert one.is_mirror == (hand(one.arm, found.arm, data.data - zero) < 0)
    # No two of them have the same answers, but for what no question can tell.
    mirrors = {one.answers for one in found.equals if one.is_mirror}
    assert found.answers not in mirrors
    assert not mirrors & {one.answers for one in found.equals if not one.is_mirror}


@pytest.mark.parametrize("frame", [more([1, -1, 1]), [0, 2, 1]])
def test_a_mirrored_tracker_comes_before_three_reversed_joints(frame):
    rng = np.random.default_rng(5)
    arm = Arm.from_name("irb120", probe=(10, 20, 100))
    angles = rng.uniform(-1.2, 1.2, (120, 6))
    points = arm.forward(angles) + rng.normal(scale=0.03, size=(120, 3)) + [700, 0, 0]
    points = points * frame if -1 in frame else points[:, frame]
    found = search_table(arm, angles, points=points)
    assert found.change.startswith("the points mirrored")
    assert (found.arm, found.axes) == (arm, (1, 0, 2))
    assert calibrate(arm, angles, points=points[:, found.axes]).typical_scatter_mm < 0.1
    assert all(one.is_mirror for one in found.equals if one.axes == (0, 1, 2))


def test_what_was_taken_asks_for_its_hand(data):
    """Until the question is answered, and not where the data tell."""
    wrong = data.nominal_arm.replace(joint_signs=[1, -1, 1, 1, 1, 1])
    given = wrong, data.data, data.groups
    small = {"model": ArmResidualRegressor(orders=1, causes=["kinematics"]), "cv": 2}
    with pytest.warns(UserWarning, match="its mirror image alike, .* joint 2 reversed") as caught:
        learned = learn_correction(*given, take="reversed-1-2-3-5", **small)
    assert "does its angle grow? If the answer is no, accept" in str(caught[0].message)
    assert "mirror-image" in {one["code"] for one in learned.facts["findings"]}
    answered = learn_correction(*given, take="reversed-2", accept="mirror-image", **small)
    assert "mirror-image" not in {one.code for one in answered.findings}
    assert answered.arm.joint_signs.tolist() == [1] * 6


@pytest.mark.parametrize(
    ("own", "change", "options"),
    [
        more(lambda q: q[:, 2] - q[:, 1], "joint 3 at J3 + J2", "--take coupled-2-3"),
        more(lambda q: q[:, 2] + q[:, 1], "joint 3 at J3 - J2", "--take uncoupled-2-3"),
        (
            lambda q: q[:, 1] - q[:, 2],
            "joint 3 at -J3 + J2",
            "--take reversed-3 --take uncoupled-2-3",
        ),
    ],
)
def test_a_joint_that_counts_from_the_horizontal(own, change, options):
    """What a controller shows as J3 is a sum, as on arms with a parallelogram."""
    rng = np.random.default_rng(8)
    arm = Arm.from_name("irb120", probe=(10, 20, 100))
    angles = rng.uniform(-1.2, 1.2, (100, 6))
    points = arm.forward(angles)[:, [1, 2, 0]] + rng.normal(scale=0.03, size=(100, 3)) + 500
    shown = angles.copy()
    shown[:, 2] = own(angles)
    found = search_table(arm, shown, points=points)
    assert (found.change, found.options) == (change, options)
    np.testing.assert_allclose(found.arm.forward(shown), arm.forward(angles), atol=1e-9)
    assert found.scatter_mm < 0.1 < 20 < found.scatter_given_mm
    for code in options.replace("--take", "").split():
        arm = take(arm, code)
    assert arm == found.arm


def test_codes_of_changes():
    arm = Arm.from_name("aacmm6")
    assert take(arm, "coupled-2-3").couplings == ((3, 2, 1),)
    assert take(arm, "uncoupled-5-6").couplings == ((6, 5, -1),)
    assert take(arm, "reversed-2-4").joint_signs.tolist() == [1, -1, 1, -1, 1, 1]
    assert take(take(arm, "other-convention"), "other-convention") == arm
    turn = np.exp(1j * (take(arm, "zero-3-270").theta_offset - arm.theta_offset))
    np.testing.assert_allclose(turn, [1, 1, -1j, 1, 1, 1], atol=1e-12)
    for code in (
        "reversed",
        "reversed-7",
        "reversed-x",
        "sign-1",
        "zero-2",
        "zero-7-90",
        "zero-2-x",
    ):
        with pytest.raises(ValueError, match=rf"joints of 1 to 6, .*, got '{code}'"):
            take(arm, code)


def test_the_other_convention_against_a_tracker():
    """A table in Craig's form given as a standard one."""
    rng = np.random.default_rng(0)
    truth = Arm.from_name("panda", probe=(0, 0, 240))
    angles = rng.uniform(-1.5, 1.5, (150, 7))
    points = truth.forward(angles)[:, [2, 0, 1]] + rng.normal(scale=0.05, size=(150, 3)) + 1000
    found = search_table(truth.replace(convention="standard"), angles, points=points)
    assert found.change == "the modified convention"
    assert found.arm == truth
    assert 0.05 < found.scatter_mm < 0.1


def test_small_swings_are_not_taken_for_degrees(data):
    """Radians read as degrees hardly move the arm: its points scatter little, and mean nothing."""
    wrong = data.nominal_arm.replace(joint_signs=[1, 1, 1, -1, 1, 1])
    assert search_table(wrong, data.data, data.groups).angle_unit == "rad"
    degrees = np.rad2deg(data.data)
    found = search_table(wrong, degrees, data.groups, angle_unit="deg")
    assert (found.change, found.angle_unit) == ("joint 4 reversed", "deg")


def test_nothing_is_proposed_for_a_right_table_or_no_arm_at_all(data):
    assert search_table(data.nominal_arm, data.data, data.groups) is None
    rng = np.random.default_rng(1)
    assert search_table(data.nominal_arm, rng.uniform(-2, 2, (30, 6)), np.arange(30) // 10) is None


@pytest.mark.parametrize("kind", ["cones", more("tracker")])
def test_zeros_anywhere(data, kind):
    """As of encoders that were built in as they came: as good as with the right table."""
    rng = np.random.default_rng(4)
    zeros = rng.uniform(-np.pi, np.pi, 6)
    where = {"positions": data.groups}
    if kind == "tracker":
        points = Rotation.from_rotvec([0.4, -0.7, 1.1]).apply(data.arm.forward(data.data))
        where = {"points": points + rng.normal(scale=0.02, size=points.shape)}
    found = search_table(data.nominal_arm, data.data - zeros, **where)
    assert found.options == "--take zeros"
    named = {"groups": data.groups} if kind == "cones" else where
    right = calibrate(data.nominal_arm, data.data, **named).typical_scatter_mm
    assert found.scatter_mm < 1.1 * right < 1 < 20 < found.scatter_given_mm
    # The first zero and the last are free: base and probe go with them.
    turn = np.exp(1j * (found.arm.theta_offset - data.nominal_arm.theta_offset - zeros))[1:-1]
    np.testing.assert_allclose(turn, 1, atol=0.01)
    measured = data.data - zeros, where.get("positions"), where.get("points"), "rad"
    assert with_change(data.nominal_arm, "zeros", measured) == found.arm
    with pytest.raises(ValueError, match="zeros are found from labels of positions, or from"):
        take(data.nominal_arm, "zeros")


def tracked(n=80):
    """A robot on a tracker, no two of whose joints count alike, and where its rows are."""
    rng = np.random.default_rng(5)
    arm = Arm.from_name("irb120", probe=(10, 20, 100))
    angles = rng.uniform(-1.2, 1.2, (n, 6))
    return arm, angles, arm.forward(angles) + rng.normal(scale=0.03, size=(n, 3)) + [700, 0, 0]


def test_a_tracker_that_was_set_up_again():
    arm, angles, points = tracked()
    turn, shift = Rotation.from_rotvec([0, 0.1, 0.5]), np.array([400, -300, 50])
    points[31:] = turn.apply(points[31:]) + shift
    found = search_table(arm, angles, points=points)
    assert found.change == "the base or the tracker moved between rows 30 and 31"
    assert found.options == "--station with other labels from row 31 on"
    assert found.arm == arm
    assert found.scatter_mm < 0.1 < 20 < found.scatter_given_mm


def test_cones_that_were_set_up_again(data):
    """Two rounds through the same cones, and the plate was turned between them."""
    order = np.r_[np.arange(0, 120, 2), np.arange(1, 120, 2)]
    angles, labels = data.data[order], data.groups[order]
    # Another cone's poses are those of the same cone elsewhere.
    labels[60:] = (labels[60:] + 3) % 8
    found = search_table(data.nominal_arm, angles, labels)
    assert found.change == "the base or the cones moved between rows 59 and 60"
    assert found.scatter_mm < 0.1 < 20 < found.scatter_given_mm


def test_an_external_axis_that_moves_the_base(monkeypatch):
    """By (0, 0.6, 0.8) mm a unit in the tracker's frame; what does not move is of no use."""
    # Zeros are searched for before, and no start finds any.
    monkeypatch.setattr("sklearn_raacmm.correction._zeros._STARTS", 5)
    arm, angles, points = tracked()
    axis, way = np.random.default_rng(6).uniform(0, 2000, len(angles)), np.array([0, 0.6, 0.8])
    others = {"E2": np.full(len(angles), 5.0), "E1": axis}
    found = search_table(arm, angles, points=points + np.outer(axis, way), others=others)
    assert found.change.startswith("E1 as an axis that moves the base by (")
    assert found.scatter_mm < 0.1 < 20 < found.scatter_given_mm
    numbers = found.change.split("(")[1].split(")")[0].split(",")
    np.testing.assert_allclose([float(value) for value in numbers], way, atol=1e-4)
    assert search_table(arm, angles, points=points + np.outer(axis, way)) is None


@pytest.mark.parametrize("seed", [0, more(1)])
def test_an_arm_of_which_only_the_layout_is_known(seed):
    """Ten cones and one bar show lengths, zeros and probe; senses are drawn, too."""
    test, rng = (
        make_single_point(10, 12, bars=[500], random_state=seed),
        np.random.default_rng(seed),
    )
    angles = rng.choice([-1, 1], 6) * test.data + rng.uniform(-np.pi, np.pi, 6)
    signs = []
    for mirrored in (False, True):
        found = arm_from_data("2-2-2", angles, test.groups, test.lengths, mirrored=mirrored)
        points, truth = found.forward(angles), test.arm.forward(test.data)
        sign = hand_of(points, truth)
        turn, _ = Rotation.align_vectors(centred(sign * points), centred(truth))
        off = centred(sign * points) - turn.apply(centred(truth))
        assert np.sqrt(np.square(off).sum(axis=1).mean()) < 0.2
        signs.append(sign)
    assert sorted(signs) == [-1, 1]
    # Nothing shows the height of the shoulder: what bends at the base turns about its foot.
    assert found.d[0] == pytest.approx(np.abs(found.d).max() / 2, rel=0.01)
    scatter = calibrate(found, angles, test.groups, lengths=test.lengths).typical_scatter_mm
    right = calibrate(test.nominal_arm, test.data, test.groups, lengths=test.lengths)
    assert scatter < 1.02 * right.typical_scatter_mm


def test_a_layout_that_points_contradict(data, monkeypatch):
    monkeypatch.setattr("sklearn_raacmm.correction._zeros._STARTS", 5)  # more find no more
    few = data.groups < 4
    angles = np.random.default_rng(1).permutation(data.data[few])
    bar = [(0, 1, 500, 0.01)]
    with pytest.raises(ValueError, match="points of no 2-2-2 arm coincide: within a position they"):
        arm_from_data("2-2-2", angles, data.groups[few], bar)
    with pytest.raises(ValueError, match="without a known distance nothing shows the scale"):
        arm_from_data("2-2-2", data.data, data.groups, [])


def test_what_leaves_centimetres_is_no_proposal():
    """Lengths of another arm, and zeros anywhere: what is better, and wrong, is not proposed."""
    test = make_single_point(n_positions=6, n_poses=8, random_state=3)
    angles = test.data - np.random.default_rng(4).uniform(-np.pi, np.pi, 6)
    other = test.nominal_arm.replace(a=test.nominal_arm.a + np.array([0, 0, 300, 0, 200, 0]))
    assert search_table(other, angles, test.groups) is None
