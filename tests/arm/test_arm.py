import copy
import json
import pickle
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from sklearn.base import clone

from sklearn_raacmm import Arm


def random_angles(arm, n=50, seed=0):
    return np.random.default_rng(seed).uniform(-np.pi, np.pi, (n, arm.n_joints))


def random_arm(convention, n_joints=6, seed=0):
    rng = np.random.default_rng(seed)
    return Arm(
        a=rng.normal(0, 300, n_joints),
        alpha=rng.uniform(-np.pi, np.pi, n_joints),
        d=rng.normal(0, 300, n_joints),
        theta_offset=rng.uniform(-1, 1, n_joints),
        probe=rng.normal(0, 100, 3),
        joint_signs=rng.choice([-1, 1], n_joints),
        convention=convention,
    )


def screw(axis, angle, length):
    """4x4 matrix of a turn about an axis of the frame and a shift along it."""
    out = np.eye(4)
    out[:3, :3] = Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()
    out[axis, 3] = length
    return out


def frames_by_matrices(arm, angles):
    """Frames of one pose by products of 4x4 matrices, as the conventions are written."""
    out = [np.eye(4)]
    theta = angles * arm.joint_signs + arm.theta_offset
    for a, alpha, d, t in zip(arm.a, arm.alpha, arm.d, theta, strict=True):
        about_z, about_x = screw(2, t, d), screw(0, alpha, a)
        step = about_z @ about_x if arm.convention == "standard" else about_x @ about_z
        out.append(out[-1] @ step)
    return np.array(out)


@pytest.mark.parametrize("n_joints", [6, 7])
@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_kinematics_against_products_of_matrices(convention, n_joints):
    arm = random_arm(convention, n_joints)
    angles = random_angles(arm, 20)
    expected = np.array([frames_by_matrices(arm, q) for q in angles])
    frames = arm.frames(angles)
    assert frames.shape == (20, n_joints + 1, 3, 4)
    assert_allclose(frames, expected[:, :, :3], atol=1e-9)
    points = (expected[:, -1] @ np.append(arm.probe, 1))[:, :3]
    assert_allclose(arm.forward(angles), points, atol=1e-9)
    assert_allclose(arm.azimuth(angles), np.arctan2(points[:, 1], points[:, 0]), atol=1e-12)


ARMS = {kind: random_arm(kind) for kind in ("standard", "modified")}
ARMS["rail"] = Arm.from_name("ur10_rail")


@pytest.mark.parametrize("arm", ARMS.values(), ids=ARMS)
def test_one_row_is_that_row_of_many_to_the_last_bit(arm):
    """It is computed by Python's numbers, where many rows are arrays."""
    angles = random_angles(arm, 5)
    for ask in (arm.frames, arm.forward, arm.jacobian):
        many = ask(angles)
        for row, expected in zip(angles, many, strict=True):
            assert_array_equal(ask(row[None])[0], expected)


def test_panda_against_the_controllers_own_poses(panda):
    data = panda("panda_3")
    known = np.isfinite(data.tool_poses[:, 0])
    angles, points = data.angles[known], 1000 * data.tool_poses[known, :3]
    w, x, y, z = data.tool_poses[known, 3:].T
    axis = np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    assert len(points) > 300
    # The tool point lies 103.4 mm beyond the flange.
    arm = Arm.from_name("panda", probe=(0, 0, 107 + 103.4))
    gap = np.linalg.norm(arm.forward(angles) - points, axis=1)
    assert np.median(gap) < 0.03
    assert np.quantile(gap, 0.95) < 0.1
    turn = np.linalg.norm(arm.frames(angles)[:, -1, :, 2] - axis, axis=1)
    assert np.median(turn) < 3e-4


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_jacobian_against_central_differences(convention):
    arm = random_arm(convention, 7, seed=3)
    angles = random_angles(arm, 30)
    step = 1e-6
    for i in range(arm.n_joints):
        delta = step * np.eye(arm.n_joints)[i]
        slope = (arm.forward(angles + delta) - arm.forward(angles - delta)) / (2 * step)
        assert_allclose(arm.jacobian(angles)[:, :, i], slope, atol=1e-5)


def test_the_unit_is_given():
    arm = Arm.from_name("panda")
    angles = random_angles(arm)
    degrees = np.rad2deg(angles)
    for method in ("forward", "frames", "azimuth", "jacobian"):
        f = getattr(arm, method)
        assert_allclose(f(degrees, angle_unit="deg"), f(angles), atol=1e-9)
    with pytest.warns(UserWarning, match=r"rad.*degrees"):
        arm.forward(degrees)
    arm.forward(np.full((1, 7), 3.9 * np.pi))  # a multi-turn encoder
    with pytest.raises(ValueError, match="angle_unit='grad' is not one of 'rad', 'deg'"):
        arm.forward(angles, angle_unit="grad")


def test_arm_is_a_value():
    arm, same = Arm.from_name("panda"), Arm.from_name("panda")
    assert arm == same
    assert hash(arm) == hash(same)
    assert {arm: 1}[same] == 1
    assert arm != "panda"
    for changes in ({"probe": (0, 0, 1)}, {"name": "x"}, {"pose_joints": (2, 4)}, {"d": arm.d + 1}):
        other = arm.replace(**changes)
        assert other != arm
        assert hash(other) != hash(arm)
    a = np.ones(6)
    built = Arm(a, np.zeros(6), np.zeros(6))
    a[0] = 2  # the arm does not follow its arguments
    assert built.a[0] == 1
    # -0.0 and 0.0 are the same length
    assert arm.replace(theta_offset=-0.0) == arm
    for field in ("name", "naem"):  # a misspelt one would have no effect
        with pytest.raises(AttributeError):
            setattr(arm, field, "mine")
    for restored in (arm, pickle.loads(pickle.dumps(arm))):
        with pytest.raises(ValueError, match="read-only"):
            restored.a[0] = 1.0


@pytest.mark.parametrize(
    "copied",
    [
        lambda arm: pickle.loads(pickle.dumps(arm)),
        copy.copy,
        copy.deepcopy,
        lambda arm: clone(arm, safe=False),
        lambda arm: Arm.from_json(arm.to_json()),
        lambda arm: arm.replace(),
    ],
)
def test_copies_are_equal(copied):
    # Beside an umlaut the characters next to the halves, and one that is made of two.
    name = "Ä \ud7ff\ue000\U0001f9be"
    arm = random_arm("modified", 7).replace(name=name, pose_joints=(2, 4), pose_frames=(1, 6))
    again = copied(arm)
    assert again == arm
    assert repr(again) == repr(arm)
    angles = random_angles(arm)
    assert_array_equal(again.forward(angles), arm.forward(angles))


def test_str_shows_the_table():
    arm = Arm.from_name("aacmm6", joint_signs=[1, -1, 1, 1, -1, 1])
    first, head, *rows = str(arm).splitlines()
    assert first == repr(arm)
    assert head.split() == ["joint", "sign", "a/mm", "alpha/deg", "d/mm", "offset/deg"]
    degrees = np.rad2deg(arm.alpha), np.rad2deg(arm.theta_offset)
    table = np.column_stack([range(1, 7), arm.joint_signs, arm.a, degrees[0], arm.d, degrees[1]])
    assert_allclose([[float(cell) for cell in row.split()] for row in rows], table, atol=5e-5)
    assert {len(row) for row in rows} == {len(head)}  # columns stand below their names


@pytest.mark.parametrize(
    ("field", "bound"),
    [("alpha", 2 * np.pi), ("theta_offset", 2 * np.pi), ("a", 1e5), ("d", 1e5), ("probe", 1e5)],
)
def test_bounds_are_where_the_messages_have_them(field, bound):
    arm = random_arm("standard")
    values = np.array(getattr(arm, field))
    for sign in (-1, 1):
        values[1] = sign * bound
        assert getattr(arm.replace(**{field: values}), field)[1] == sign * bound
        values[1] = sign * bound * (1 + 1e-9)
        unit = "rad" if field in ("alpha", "theta_offset") else "mm"
        sentence = rf"^{field}\[1\] = .* is out of bounds.* at most \S+ {unit}\W"
        with pytest.raises(ValueError, match=sentence):
            arm.replace(**{field: values})


@pytest.mark.parametrize(
    "form",
    [
        str.encode,
        lambda text: ("\ufeff" + text).encode(),
        lambda text: "\ufeff" + text,
        lambda text: " \n" + text,
        json.loads,
    ],
    ids=["bytes", "bytes with a mark", "a byte-order mark", "white space", "dict"],
)
def test_forms_of_json(form, tmp_path):
    arm = Arm.from_name("ur10", name="Prüfarm")
    source = form(arm.to_json())
    assert Arm.from_json(source) == arm
    if not isinstance(source, dict):
        path = tmp_path / "arm.json"
        path.write_bytes(source.encode() if isinstance(source, str) else source)
        assert Arm.from_json(path) == arm


@pytest.mark.parametrize(
    "angles",
    [
        np.eye(6) * [[3.0], [0.1], [0.1], [0.1], [0.1], [0.1]],  # one joint swings, the rest stand
        np.array([[6.3, 1.0, 1.0, 1.0, 1.0, 1.0]]),
        np.full((3, 6), 0.2),
        np.empty((0, 6)),
    ],
)
def test_small_degrees_are_degrees(angles):
    arm = Arm.from_name("ur10")
    expected = arm.forward(np.deg2rad(angles))
    assert_array_equal(arm.forward(angles, angle_unit="deg"), expected)


def test_html_of_an_arm_is_a_table_of_its_joints_in_which_nothing_runs():
    arm = Arm.from_name("panda", name="<script>alert(1)</script>")
    text, table = ElementTree.fromstring(arm._repr_html_())  # well-formed, and no other element
    assert text.text == repr(arm)
    cells = [[cell.text for cell in row] for row in table]
    assert cells[0] == ["joint", "sign", "a / mm", "alpha / deg", "d / mm", "theta offset / deg"]
    expected = [np.arange(1, 8), arm.joint_signs, arm.a, np.rad2deg(arm.alpha), arm.d, np.zeros(7)]
    assert_allclose(np.array(cells[1:], dtype=float), np.transpose(expected), atol=1e-4)


@pytest.mark.parametrize("up", [(0, 0, 1), (3, 0, 0), (0.3, -0.5, 0.2), (0, 0, -1)])
def test_up_is_a_part_of_the_value(up):
    arm = Arm.from_name("panda", up=up)
    assert_allclose(arm.up, np.array(up) / np.linalg.norm(up), atol=1e-15)
    for same in (pickle.loads(pickle.dumps(arm)), Arm.from_json(arm.to_json()), arm.replace()):
        assert (same, hash(same)) == (arm, hash(arm))
    upright = Arm.from_name("panda")
    assert (arm == upright) == (up == (0, 0, 1)) == ("up (" not in repr(arm))
    content = json.loads(arm.to_json())
    content.pop("up", None)  # files of earlier versions have none
    assert Arm.from_json(content) == upright


# -- joints whose angle is a sum -------------------------------------------------------------------

SUMS = [(3, 2, 1), (6, 5, -1)]


def with_sums(angles):
    """The angles of the joints themselves: J3 + J2 and J6 - J5."""
    own = angles.copy()
    own[:, 2] += angles[:, 1]
    own[:, 5] -= angles[:, 4]
    return own


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_joints_that_are_sums(convention):
    bare = random_arm(convention)
    arm, angles = bare.replace(couplings=SUMS), random_angles(bare, 20)
    assert_allclose(arm.forward(angles), bare.forward(with_sums(angles)), atol=1e-9)
    assert_allclose(arm.frames(angles), bare.frames(with_sums(angles)), atol=1e-9)
    by_hand = [arm.forward(angles + h) - arm.forward(angles - h) for h in 1e-6 * np.eye(6)]
    assert_allclose(arm.jacobian(angles), np.stack(by_hand, axis=2) / 2e-6, atol=1e-5)
    wanted = arm.forward(angles[:5])
    assert_allclose(arm.forward(arm.angles_for(wanted, angles[:5] + 0.05)), wanted, atol=1e-6)
    assert Arm.from_json(arm.to_json()) == arm != bare
    assert pickle.loads(pickle.dumps(arm)) == arm
    assert repr(arm).endswith("joint 3 at J3 + J2, joint 6 at J6 - J5>")
    with pytest.warns(UserWarning, match=r"the angles of the joints themselves, J3 \+ J2, J6 - J5"):
        assert arm.to_urdf() == bare.to_urdf()


@pytest.mark.parametrize("wrong", [[(3, 3, 1)], [(3, 7, 1)], [(3, 2, 0.5)], [(3, 2)], [(0, 2, 1)]])
def test_what_is_no_sum_is_refused(wrong):
    with pytest.raises(
        ValueError, match=r"triples of two different joints from 1 to 6 and 1 or -1"
    ):
        random_arm("standard").replace(couplings=wrong)


@pytest.mark.parametrize("n_joints", [2, 3, 4])
def test_arms_of_few_joints_have_a_pose_of_their_own(n_joints):
    """As from a URDF: nobody gave joints 3 and 4."""
    arm = Arm.from_degrees([0.0] * n_joints, [90.0] * n_joints, [500.0, *[120.0] * (n_joints - 1)])
    assert (arm.pose_joints, arm.pose_frames) == ((1, 2), (0, n_joints))
    assert Arm.from_degrees([0, 0], [90, 0], [500, 120], pose_frames=(0, 1)).pose_frames == (0, 1)


def test_an_arm_on_trial_moves_as_the_checked_one():
    arm = random_arm("modified").replace(couplings=[(3, 2, 1)], joint_types="PRRRRR")
    angles, d = arm.random_poses(20), arm.d + 1
    trial, checked = arm.on_trial(d=d, probe=arm.probe - 2), arm.replace(d=d, probe=arm.probe - 2)
    for found in (
        trial.parameter_jacobian(angles),
        arm.parameter_jacobian(angles, d=d, probe=arm.probe - 2),
    ):
        for ours, theirs in zip(found, checked.parameter_jacobian(angles), strict=True):
            assert_array_equal(ours, theirs)
    assert_array_equal(trial.points_at(angles), checked.forward(angles))
    assert trial.slides == [0]
    with pytest.raises(TypeError, match="an arm has no field 'theta_ofset' that could be changed"):
        arm.on_trial(theta_ofset=arm.theta_offset)


def test_a_missing_angle_is_missing_where_it_is_a_part_of_a_sum_only():
    arm, angles = random_arm("standard").replace(couplings=SUMS), np.ones((2, 6))
    angles[1, 1] = np.nan
    found = arm.own_angles(angles)
    assert np.argwhere(np.isnan(found)).tolist() == [[1, 1], [1, 2]]
    assert_array_equal(found[0], [1, 1, 2, 1, 1, 0])
