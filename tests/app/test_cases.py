"""What people bring and ask about, in inputs of the same shape: each is answered at once.

Readers of files have tests of their own; here the command is asked, and what it says is judged.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm
from sklearn_raacmm.app import main

ARM = Arm.from_name("irb120")
TURN, SHIFT = Rotation.from_rotvec([0.1, -0.2, 0.9]).as_matrix(), np.array([900.0, 80.0, -7.0])
N = 40


def measured(arm=ARM, probe=(1.0, -2.0, 6.0)):
    """Poses in degrees, and points of a tracker somewhere else, of an arm that is a little off.

    Its probe is elsewhere by a vector in mm.
    """
    rng = np.random.default_rng(0)
    angles = rng.uniform(-1.2, 1.2, (N, arm.n_joints))
    own = arm.replace(
        a=arm.a + rng.normal(0, 0.2, arm.n_joints),
        alpha=arm.alpha + rng.normal(0, 1e-3, arm.n_joints),
        probe=np.add(arm.probe, probe),
    )
    points = own.forward(angles) @ TURN + SHIFT + rng.normal(0, 0.02, (N, 3))
    return np.rad2deg(angles), points


@pytest.fixture
def asked(tmp_path, capsys, monkeypatch, quick_model):
    """What runs `raacmm learn` on columns, at 80 columns, and returns code and what it said."""

    def asked(columns, *words, arm=ARM, points="X,Y,Z"):
        monkeypatch.setenv("COLUMNS", "80")
        arm.to_json(tmp_path / "arm.json")
        rows = zip(*columns.values(), strict=True)
        lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
        (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
        words = [*words, *(["--points", points] if points else [])]
        files = ["--arm", str(tmp_path / "arm.json"), "--out", str(tmp_path / "out")]
        code = main(["learn", str(tmp_path / "log.csv"), *files, "--folds", "2", "--force", *words])
        said, notes = capsys.readouterr()
        lines = [line for line in (said + notes).splitlines() if str(tmp_path) not in line]
        assert max(map(len, lines)) <= 80
        return code, " ".join((said + " " + notes).split())

    return asked


def table(angles, points=None):
    columns = {f"J{i} [deg]": column for i, column in enumerate(angles.T, 1)}
    if points is not None:
        columns |= dict(zip(("X [mm]", "Y [mm]", "Z [mm]"), points.T, strict=True))
    return columns


def test_a_joint_that_counts_from_the_horizontal_is_named(asked):
    angles, points = measured()
    angles[:, 2] += angles[:, 1]  # as Fanuc's J3
    code, said = asked(table(angles, points))
    assert code == 2
    assert "coupled-2-3" in said


def test_an_arm_that_stood_still_has_one_pose(asked):
    angles, points = measured()
    still = table(angles[:1] + np.zeros((N, 1)), points)
    for words in ((), ("--dry-run",)):
        code, said = asked(still, *words)
        assert code == 2
        assert "arm did not move: 40 rows are 1 pose" in said


def test_a_lost_row_is_named(asked):
    angles, points = measured()
    points = np.vstack([np.delete(points, 10, axis=0), points[-1:]])
    code, said = asked(table(angles, points))
    assert code == 2
    assert "From row 12 on each point is that of the next row" in said


def test_a_mirrored_tracker_is_named(asked):
    angles, points = measured()
    code, said = asked(table(angles, points * [1, -1, 1]))
    assert code == 2
    # First; that of its mirror image, another arm, is named for the user to decide.
    named, _, other = said.partition("Its mirror image")
    assert "With the points mirrored (an axis negated, or two exchanged)" in named
    assert "reversed" not in named
    assert "Was the probe higher in row" in other


def test_an_encoder_that_was_mounted_anew_is_named(asked):
    """Calibration finds it; the correction on top adds nothing, and that is no failure."""
    angles, points = measured(probe=(10.0, -20.0, 60.0))
    angles[:, 4] += 5.0
    code, said = asked(table(angles, points))
    assert code == 0
    assert "zero of joint 5 -" in said
    assert "as given" in said


def test_names_of_single_poses_change_nothing(asked):
    """`learn_correction` is asked in test_learn.py whether the verdict is that without names."""
    code, said = asked({"point": [f"P{i}" for i in range(N)]} | table(*measured()))
    assert code in (0, 3)
    assert "Column point names each row: it says nothing of positions." in said
    assert "nan" not in said.lower()


def test_counts_from_another_zero(asked):
    """Encoders that count from half a turn away: five joints, and cones."""
    rng = np.random.default_rng(0)
    arm = Arm.from_degrees(
        [0, 250, 250, 0, 0], [-90, 0, 0, -90, 0], [120, 0, 0, 0, 60], probe=(0, 0, 80)
    )
    labels, rows = np.repeat(["A", "B", "C", "D"], 12), []
    for place in ([300, 50, 100], [-200, 250, 150], [100, -320, 60], [250, 200, 250]):
        start = rng.uniform(-2, 2, (12, 5))
        found = arm.angles_for(np.tile(np.array(place, float), (12, 1)), start=start)
        rows.append(found)
    angles = (np.concatenate(rows) + np.pi) / (2 * np.pi) * 4096
    assert np.isfinite(angles).all()
    counts = {f"enc{i}": column.round().astype(int) for i, column in enumerate(angles.T, 1)}
    code, said = asked({"cone": labels} | counts, "--counts-per-turn", "4096", arm=arm, points=None)
    assert code == 2
    assert "zero of joint 3 turned by 180 degrees" in said


def test_two_joints_are_an_arm(asked):
    """Of which a tracker shows the twist between them, and nothing that was wrong here."""
    arm = Arm.from_degrees([0, 0], [90, 0], [500, 120], probe=(200, 80, 30))
    angles, points = measured(arm)
    code, said = asked(table(angles, points), arm=arm)
    assert code == 3
    assert "Do not use it: at new positions mean deviation 0.0" in said
