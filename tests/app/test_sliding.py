"""Tables of robots on rails, of gantries and columns."""

import json

import numpy as np
import pytest

from sklearn_raacmm import Arm, Correction
from sklearn_raacmm.app import main, read_table
from sklearn_raacmm.app._sources import TableError

RAIL = Arm.from_name("ur10_rail").replace(probe=(20, 30, 100))
ARCSEC = np.pi / 180 / 3600


def table_of(header, rows):
    return "\n".join([",".join(header), *(",".join(f"{v:.9g}" for v in row) for row in rows)])


@pytest.mark.parametrize(
    ("name", "per_unit"), [("E1 [mm]", 1.0), ("rail [m]", 1000.0), ("x [in]", 25.4)]
)
def test_a_column_of_an_axis_is_a_joint_where_the_arm_has_one(tmp_path, name, per_unit):
    q = RAIL.random_poses(5)
    rows = np.column_stack([np.rad2deg(q[:, 1:]), q[:, 0] / per_unit])
    header = [*(f"J{i} [deg]" for i in range(1, 7)), name]
    (tmp_path / "log.csv").write_text(table_of(header, rows))
    given = {"labelled": False, "joint_names": RAIL.names, "joint_types": RAIL.joint_types}
    table = read_table(tmp_path / "log.csv", 7, **given)
    assert table.angle_unit == "deg"
    np.testing.assert_allclose(RAIL.forward(table.angles, angle_unit="deg"), RAIL.forward(q))


def test_the_unit_of_what_slides_is_asked_where_nothing_says_it(tmp_path):
    header = [*(f"J{i} [deg]" for i in range(1, 7)), "E1"]
    (tmp_path / "log.csv").write_text(table_of(header, np.rad2deg(RAIL.random_poses(5))))
    with pytest.raises(TableError, match=r"the column 'E1' of a joint that slides\? Name it in th"):
        read_table(tmp_path / "log.csv", 7, labelled=False, joint_types=RAIL.joint_types)


def test_a_gantry_has_columns_x_y_and_z(tmp_path):
    gantry = Arm.from_degrees([0] * 5, [-90, 90, 0, -90, 0], [0] * 5, joint_types="PPPRR")
    q = gantry.random_poses(4)
    rows = np.column_stack([q[:, :3], np.rad2deg(q[:, 3:])])
    header = ["x [mm]", "y [mm]", "z [mm]", "A1 [deg]", "A2 [deg]"]
    (tmp_path / "log.csv").write_text(table_of(header, rows))
    table = read_table(tmp_path / "log.csv", 5, labelled=False, joint_types="PPPRR")
    np.testing.assert_allclose(table.angles, rows, rtol=1e-8)


def test_an_axis_is_told_from_a_trackers_point(tmp_path):
    rows = np.column_stack([RAIL.random_poses(5), np.ones((5, 3))])
    header = ["E1 [mm]", *(f"J{i} [rad]" for i in range(1, 7)), "X", "Y", "Z"]
    (tmp_path / "log.csv").write_text(table_of(header, rows))
    table = read_table(tmp_path / "log.csv", 7, labelled=False, joint_types=RAIL.joint_types)
    np.testing.assert_allclose(table.angles, rows[:, :7], rtol=1e-8)


def test_a_table_of_lengths_says_what_slides_and_zeros_are_in_its_unit(tmp_path, capsys):
    (tmp_path / "dh.csv").write_text("type,a,alpha,d\nP,0,-90,100\nR,300,0,50\nR,200,0,0\n")
    words = ["--dh", str(tmp_path / "dh.csv"), "--zero", "7,90,0", "--out", "-"]
    assert main(["arm", *words]) == 0
    arm = Arm.from_json(capsys.readouterr().out)
    assert arm.joint_types == "PRR"
    assert arm.d.tolist() == [93.0, 50.0, 0.0]
    np.testing.assert_allclose(arm.theta_offset, [0, -np.pi / 2, 0])


def test_behind_its_first_joint_a_robot_on_a_rail_is_the_robot():
    bare = Arm.from_name("ur10").replace(probe=RAIL.probe, name="ur10_rail")
    assert RAIL.without_first() == bare


@pytest.mark.usefixtures("quick_model")
def test_a_rail_that_stands_still_is_as_none_to_the_last_bit(tmp_path, capsys):
    pytest.importorskip("jinja2")
    pytest.importorskip("matplotlib")
    pytest.importorskip("skops")
    arm, rng = RAIL.without_first(), np.random.default_rng(0)
    q = arm.random_poses(60, rng) * [1, 0.4, 0.6, 1, 1, 1]
    points = arm.forward(q + 20 * ARCSEC * np.cos(q)) + rng.normal(0, 0.02, (60, 3))
    rows = np.column_stack([np.full(60, 1500.0), np.rad2deg(q), points])
    header = ["E1 [mm]", *(f"J{i} [deg]" for i in range(1, 7)), "X", "Y", "Z"]
    (tmp_path / "log.csv").write_text(table_of(header, rows))
    found = []
    for name, one in (("rail", RAIL), ("none", arm)):
        (tmp_path / f"{name}.json").write_text(one.to_json())
        words = ["--arm", str(tmp_path / f"{name}.json"), "--points", "X,Y,Z", "--folds", "2"]
        words += ["--out", str(tmp_path / name), "--accept", "poses-alike"]
        assert main(["learn", str(tmp_path / "log.csv"), *words]) in (0, 3)
        said = " ".join(capsys.readouterr().err.split())
        assert ("E1 [mm], along which joint 1 slides, stands still at 1500 mm" in said) == (
            name == "rail"
        )
        found.append(Correction.load(tmp_path / name))
    assert found[0].arm == found[1].arm.replace(name=found[0].arm.name)
    np.testing.assert_array_equal(*(one.model.predict(q) for one in found))
    facts = [json.loads((tmp_path / name / "arm.json").read_text()) for name in ("rail", "none")]
    assert facts[0]["a_mm"] == facts[1]["a_mm"]


def test_columns_of_a_positioner_are_its_joints_whatever_their_order(tmp_path):
    turntable = Arm.from_degrees([0, 0], [90, -90], [0, 300], convention="modified")
    base = np.diag([1.0, 1, 1, 1]) + 900 * np.outer(np.eye(4)[0], np.eye(4)[3])
    arm = Arm.from_name("panda", names=(), probe=(0, 0, 100)).seen_from(turntable, base)
    q = arm.random_poses(5)
    rows = np.rad2deg(np.column_stack([q[:, 2:], q[:, 1], q[:, 0]]))
    header = [*(f"q{i} [deg]" for i in range(1, 8)), "E1 [deg]", "E2 [deg]"]
    (tmp_path / "log.csv").write_text(table_of(header, rows))
    table = read_table(tmp_path / "log.csv", 9, labelled=False, joint_names=arm.names)
    assert table.angle_unit == "deg"
    np.testing.assert_allclose(table.angles, np.rad2deg(q), atol=1e-6)
