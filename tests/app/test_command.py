"""The command on the log of an arm of another make, and of one that no correction helps.

The arm shares nothing with the package. Seven joints (2-2-3): its encoders are eccentric, its upper
arm sags, and its lengths are not those of the drawing. Poses at a cone are found by Gauss-Newton
from random starts.
"""

import csv
import functools
import json
import re
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, ArmResidualRegressor, calibrate, learn_correction
from sklearn_raacmm.app import _arms, _commands, _correct, _files, _life, main
from sklearn_raacmm.app._files import parse_length, read_places
from sklearn_raacmm.app._sources import TableError
from sklearn_raacmm.datasets import make_features, make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")
skops_io = pytest.importorskip("skops.io")

JOINTS = [
    (0, 0.3, "0 0 1"), (0, 0, "0 1 0"), (0, 0, "1 0 0"), (0.42, 0, "0 1 0"), (0, 0, "1 0 0"),
    (0.38, 0, "0 1 0"), (0, 0, "1 0 0"),
]  # fmt: skip
URDF = "".join(
    f'<joint name="A{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/>'
    f'<origin xyz="{x} 0 {z}"/><axis xyz="{axis}"/></joint>'
    for i, (x, z, axis) in enumerate(JOINTS, 1)
)
URDF = (
    f'<robot name="other make">{URDF}<joint name="tip" type="fixed"><parent link="l7"/>'
    '<child link="tip"/><origin xyz="0.12 0 0"/></joint></robot>'
)


DRAWING = {"shoulder": 300.0, "upper": 420.0, "fore": 380.0, "probe": 120.0}


class OtherMake:
    """The arm: true points from what its encoders read."""

    def __init__(self, seed, error=1.0, off_mm=0.3):
        rng = np.random.default_rng(seed)
        self.rng = rng
        self.lengths = {k: v + rng.normal(scale=off_mm) for k, v in DRAWING.items()}
        arcsec = np.pi / 180 / 3600
        self.amplitude = error * arcsec * rng.uniform(8, 20, 7)
        self.phase = rng.uniform(0, 2 * np.pi, 7)
        self.sag = error * 15 * arcsec

    def points(self, readings):
        """True points (n, 3) for encoder readings (n, 7) in rad."""
        q = readings + self.amplitude * np.cos(readings - self.phase)
        q = np.array(q)
        q[:, 1] += self.sag * np.cos(readings[:, 1])
        place = np.zeros((len(q), 3))
        turn = np.tile(np.eye(3), (len(q), 1, 1))
        for axis, angle, along in (
            ("z", q[:, 0], 0.0), ("y", q[:, 1], self.lengths["upper"]), ("x", q[:, 2], 0.0),
            ("y", q[:, 3], self.lengths["fore"]), ("x", q[:, 4], 0.0),
            ("y", q[:, 5], self.lengths["probe"]), ("x", q[:, 6], 0.0),
        ):  # fmt: skip
            turn = turn @ Rotation.from_euler(axis, angle[:, None]).as_matrix()
            place = place + along * turn[:, :, 0]
        place[:, 2] += self.lengths["shoulder"]
        return place

    def cone(self, place, n):
        """Readings (n, 7) of poses whose probe is in the cone, but for 5 micrometres of seating."""
        found = []
        while len(found) < n:
            q = self.rng.uniform(-1, 1, 7) * [3, 1, 2.5, 1, 2.5, 1.2, 3]
            q[3] = 0.9 + 0.5 * q[3]
            target = place + self.rng.normal(scale=0.005, size=3)
            for _ in range(40):
                steps = q + np.r_[np.zeros((1, 7)), 1e-6 * np.eye(7)]
                p = self.points(steps)
                jac = (p[1:] - p[0]).T / 1e-6
                step = np.linalg.lstsq(jac[:, :6], target - p[0], rcond=None)[0]
                q[:6] += step * 0.5 / max(0.5, np.abs(step).max())
                if np.abs(step).max() < 1e-10:
                    break
            if np.abs(step).max() < 1e-8 and np.all(np.abs(q) < np.pi):
                found.append(q)
        return np.array(found)

    def test(self, n_cones, n_poses):
        """Readings and cone number of a single-point test."""
        readings, cones, self.places = [], [], []
        for i in range(n_cones):
            azimuth, radius = 2.4 * i, 350 + 350 * (i + 0.5) / n_cones
            place = [radius * np.cos(azimuth), radius * np.sin(azimuth), 100 + 60 * (i % 5)]
            self.places.append(np.array(place))
            readings.append(self.cone(self.places[-1], n_poses))
            cones += [i] * n_poses
        return np.concatenate(readings), np.array(cones)


def write_log(path, readings, cones):
    """Degrees, decimal commas, cp1252 and two lines above the header, as its logger writes."""
    lines = ["Meßgerät;Gelenkarm Größe 7", "Datum;21.11.2026;Prüfer;Jürgen"]
    lines.append("Zeit;Kegel;" + ";".join(f"A{i} [°]" for i in range(1, 8)))
    for k, (row, cone) in enumerate(zip(np.rad2deg(readings), cones, strict=True)):
        cells = ";".join(f"{v:.5f}".replace(".", ",") for v in row)
        lines.append(f"13:{k // 60 % 60:02d}:{k % 60:02d};Kegel Süd {cone + 1};{cells}")
    path.write_bytes("\r\n".join([*lines, ""]).encode("cp1252"))


@pytest.fixture(scope="module", autouse=True)
def quick_model():
    """The first stage alone: the whole default takes half a minute, and is tested elsewhere."""
    with pytest.MonkeyPatch.context() as patch:
        quick = functools.partial(learn_correction, model=ArmResidualRegressor(orders=3))
        patch.setattr(_commands, "learn_correction", quick)
        yield


@pytest.fixture(scope="module")
def machine():
    return OtherMake(1)


@pytest.fixture(scope="module")
def learned(tmp_path_factory, machine):
    """Folder that ``raacmm learn`` has written for the other make, and what it was given."""
    folder = tmp_path_factory.mktemp("other")
    readings, cones = machine.test(8, 16)
    readings[37, 3] += 0.004  # a slipped probe
    write_log(folder / "log.csv", readings, cones)
    (folder / "arm.urdf").write_text(URDF)
    arguments = f"learn {folder}/log.csv --arm {folder}/arm.urdf --out {folder}/out --folds 3"
    code = main([*arguments.split(), "--serial", "S 17", "--operator", "Jö"])
    return folder / "out", code, readings, cones


def read_csv(path, encoding="cp1252"):
    with open(path, encoding=encoding, newline="") as file:
        header, *rows = csv.reader(file, delimiter=";")
    numbers = [[float(cell.replace(",", ".")) for cell in row[-10:]] for row in rows]
    return header, rows, np.array(numbers)


def test_learn_writes_everything_and_finds_the_slip(learned):
    folder, code, readings, _ = learned
    assert code == 0
    assert {path.name for path in folder.iterdir()} == {
        "report.html", "arm.json", "model.skops", "correction.json", "card.md", "corrected.csv",
    }  # fmt: skip
    facts = json.loads((folder / "correction.json").read_text(encoding="utf-8"))
    assert facts["helps"]
    assert [row[:2] for row in facts["outliers"]] == [[37, "Kegel Süd 3"]]
    # Findings and the report name the row of the file.
    found = {finding["code"]: finding["rows"] for finding in facts["findings"]}
    assert found["outliers"] == [41]
    report = (folder / "report.html").read_text(encoding="utf-8")
    for shown in ("S 17", "Jö", '<td class="n">41</td><td>Kegel Süd 3</td>'):
        assert shown in report
    header, rows, numbers = read_csv(folder / "corrected.csv")
    assert [header[1], *header[-10:-7]] == ["Kegel", "x [mm]", "y [mm]", "z [mm]"]
    assert len(rows) == len(readings)
    assert np.all(numbers[:, 3:] > 0)


def test_the_verdict_is_true(learned, machine, tmp_path):
    """On new readings of the simulated arm the correction does what the verdict promises."""
    folder, *_ = learned
    facts = json.loads((folder / "correction.json").read_text(encoding="utf-8"))
    machine.rng = np.random.default_rng(8)
    readings, cones = machine.test(6, 15)
    write_log(tmp_path / "today.csv", readings, cones)
    arguments = f"correct {tmp_path}/today.csv --model {folder} --out {tmp_path}/corrected.csv"
    assert main(arguments.split()) == 0
    _, _, numbers = read_csv(tmp_path / "corrected.csv")
    after = single_point_repeatability(numbers[:, :3], cones)
    arm = Arm.from_json(folder / "arm.json")
    before = single_point_repeatability(arm.forward(readings), cones)
    assert after < 0.6 * before
    assert after < 1.3 * facts["summary"]["after"][2]
    # Whole points are near to the truth, but for the base and the scale, which no cone shows.
    truth = machine.points(readings)
    a, b = numbers[:, :3] - numbers[:, :3].mean(axis=0), truth - truth.mean(axis=0)
    u, size, vt = np.linalg.svd(b.T @ a)
    scale = size.sum() / np.square(a).sum()
    assert abs(scale - 1) < 2e-3
    off = np.linalg.norm(scale * a @ (u @ vt).T - b, axis=1)
    assert off.mean() < 0.1


def test_correct_streams_and_repeats_itself(learned, monkeypatch, tmp_path, capsys):
    """Blocks of any size give the same file, and one block is in memory at a time."""
    folder, *_ = learned
    monkeypatch.setattr(_correct, "BLOCK_ROWS", 7)
    words = f"correct {folder.parent}/log.csv --model {folder} --out {tmp_path}/many.csv"
    assert main(words.split()) == 0
    assert (tmp_path / "many.csv").read_bytes() == (folder / "corrected.csv").read_bytes()
    assert "128 rows corrected" in capsys.readouterr().out


def test_check_holds_today_and_not_after_a_knock(learned, machine, tmp_path, capsys, monkeypatch):
    folder, *_ = learned
    machine.rng = np.random.default_rng(9)
    readings, cones = machine.test(5, 12)
    for change, code, printed in (
        (0.0, 0, "It holds"),
        (2e-3, 3, "It does not hold|It helps less"),
        (2.5e-4, 3, "It still helps, but something has changed"),
    ):
        if change == 2.5e-4:  # the mean 2S alone is taken to pass, and the suspect decides
            monkeypatch.setattr(_life, "highest_mean", lambda *_: 1.0)
        knocked = readings.copy()
        knocked[:, 3] += change * np.cos(readings[:, 3])
        write_log(tmp_path / "today.csv", knocked, cones)
        kept = ["--record", f"{tmp_path}/checks.csv"]
        assert main(["check", f"{tmp_path}/today.csv", "--model", str(folder), *kept]) == code
        out = capsys.readouterr().out
        assert re.search(printed, out)
        # The encoder of joint 4 has become eccentric.
        assert ("Suspect: harmonics of joint 4" in out) == (code == 3)
    records = pd.read_csv(tmp_path / "checks.csv")
    assert records["suspect"].tolist() == ["nothing", *["harmonics of joint 4"] * 2]
    assert records["mean_mm"][1] > records["mean_high_mm"][1]
    assert records["holds"].tolist() == [True, False, False]
    assert records["said"].str.startswith("It ").all()


@pytest.mark.parametrize("word", ["learn", "check", "register", "update"])
def test_a_code_that_no_finding_has_is_refused_before_anything_is_read(word, capsys):
    needed = ("--arm", "none.json", "--out", "none") if word == "learn" else ("--model", "none")
    assert main([word, "none.csv", *needed, "--accept", "corected-already"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "'corected-already' is no code of a finding that can be accepted." in said
    assert "nearest are: corrected-already" in said
    arm = Arm.from_name("aacmm6")
    with pytest.raises(ValueError, match=r"'few-poses' is no code .* nearest are: strange-poses"):
        calibrate(arm, np.zeros((8, 6)), np.arange(8) // 4, accept=["table-off", "few-poses"])


@pytest.mark.parametrize(("n_cones", "n_poses"), [(1, 20), (5, 20), (2, 10), (6, 10)])
def test_checks_raise_a_false_alarm_once_in_a_hundred(n_cones, n_poses):
    """At most, and not much less often: of 2S as readings have it, at cones that differ."""
    rng, alarms = np.random.default_rng(0), 0
    poses = np.r_[np.full(12, 20), np.full(n_cones, n_poses)]
    for _ in range(4000):
        own = 0.02 * np.exp(0.2 * rng.normal(size=len(poses)))
        two_s = own * np.sqrt(rng.chisquare(3 * (poses - 1)) / (3 * (poses - 1)))
        learnt = {"after": two_s[:12], "n_points": poses[:12]}
        alarms += two_s[12:].mean() > _life.highest_mean(learnt, poses[12:], 0.01)
    assert 0.006 < alarms / 4000 < 0.014


def test_export_writes_what_it_names(learned, tmp_path, capsys):
    """Whether C says the same as Python is tested with `export_c`."""
    folder = learned[0]
    assert main(["export", "--model", str(folder), "--c", str(tmp_path)]) == 0
    printed = capsys.readouterr().out.strip().removeprefix("Written: ").split()
    assert sorted(printed) == sorted(map(str, tmp_path.iterdir()))
    facts = json.loads((folder / "correction.json").read_text(encoding="utf-8"))
    line = f"#define ARM_CORRECTION_SCALE_SD {facts['scale_sd']!r}\n"
    small = (tmp_path / "arm_correction.h").read_text()
    assert line in small
    assert "fade small" in small
    assert main(["export", "--model", str(folder), "--c", str(tmp_path), "--fade", "exact"]) == 0
    exact = (tmp_path / "arm_correction.h").read_text()
    assert "fade small" not in exact
    sizes = [int(re.search(r"TABLE_BYTES (\d+)", text)[1]) for text in (small, exact)]
    assert sizes[0] < 0.8 * sizes[1]


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("off_mm", "code", "verdict", "box"),
    [
        (0.3, 3, "Do not use it: at new positions 2S", "verdict bad"),
        (1.0, 0, "Use the calibrated table without the correction: at new", "verdict "),
    ],
)
def test_an_arm_that_no_correction_helps(off_mm, code, verdict, box, tmp_path, capsys):
    """Its encoders are noisy, its lengths off, and there is nothing else.

    By noise alone points scatter 0.1 mm: to find lengths that are 0.3 mm off costs as much as it
    gains; that of lengths that are 1 mm off is most of what there is.
    """
    machine = OtherMake(2, error=0, off_mm=off_mm)
    readings, cones = machine.test(6, 12)
    readings += machine.rng.normal(scale=5e-5, size=readings.shape)
    write_log(tmp_path / "log.csv", readings, cones)
    (tmp_path / "arm.urdf").write_text(URDF)
    length = np.linalg.norm(machine.places[0] - machine.places[1])
    lengths = f"von;bis;L [mm]\nKegel Süd 1;Kegel Süd 2;{length:.4f}\n".replace(".", ",")
    (tmp_path / "lengths.csv").write_bytes(lengths.encode("cp1252"))
    arguments = f"learn {tmp_path}/log.csv --arm {tmp_path}/arm.urdf --out {tmp_path} --folds 3"
    gauges = ["--lengths", f"{tmp_path}/lengths.csv", "--length-sd", "0.01"]
    assert main([*arguments.split(), *gauges]) == code
    printed = capsys.readouterr().out
    assert printed.count(verdict) == 1
    assert re.search(r"calibration changed .*length [ad] of joint \d [+-]0\.\d+ mm \(sd 0", printed)
    assert "known lengths" not in printed  # one cannot be judged by another
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f'<p class="{box}">When it was learnt: <strong>{verdict}' in report
    # Whoever uses it all the same is told so.
    assert main(["export", "--model", str(tmp_path), "--c", str(tmp_path / "c")]) == 0
    assert f"note: {verdict}" in capsys.readouterr().err


@pytest.mark.exhaustive
def test_learn_against_a_tracker_without_labels(tmp_path, capsys, refused):
    machine = OtherMake(3, error=3.0)
    readings = machine.rng.uniform(-1.2, 1.2, (120, 7))
    points = machine.points(readings)[:, [1, 2, 0]] + [0, 0, 2000]
    table = np.c_[np.rad2deg(readings), points / 1000]
    header = ",".join([*(f"q{i}_deg" for i in range(1, 8)), "X [m]", "Y [m]", "Z [m]"])
    np.savetxt(tmp_path / "t.csv", table, "%.7f", ",", header=header, comments="")
    (tmp_path / "arm.urdf").write_text(URDF)
    arguments = f"learn {tmp_path}/t.csv --arm {tmp_path}/arm.urdf --out {tmp_path} --points x,y,z"
    assert main([*arguments.split(), "--folds", "2"]) == 0
    printed = capsys.readouterr().out
    assert "It helps at new positions: mean deviation" in printed
    assert "region 0" in printed
    refused("with --position NAME", "check", tmp_path / "t.csv", "--model", tmp_path)


def test_learn_takes_the_places_of_rows_without_labels(tmp_path, capsys, refused):
    test = make_single_point(5, 12, bars=[500], random_state=0)
    test.nominal_arm.to_json(tmp_path / "arm.json")
    header = ",".join(f"q{i} [rad]" for i in range(1, 7))
    np.savetxt(tmp_path / "log.csv", test.data, "%.9f", ",", header=header, comments="")
    given = f"{tmp_path}/log.csv --arm {tmp_path}/arm.json --out {tmp_path}/out"
    words = ["learn", *given.split(), "--folds", "2"]
    refused("points are at 7 places, of 12 to 12 rows each: 1 to 7, as they come", *words)
    words += ["--length", "6:7:500:0.01"]  # cones come first, then the two ends of the bar
    assert main([*words, "--accept", "places-found"]) == 0
    printed = capsys.readouterr().out
    assert "7 of 7 positions better" in printed
    assert "Lengths are not known" not in printed


def test_demo(monkeypatch, tmp_path, capsys):
    small, opened = make_single_point(5, 12, bars=[500], random_state=0), []
    monkeypatch.setattr(_commands, "make_single_point", lambda **_: small)
    monkeypatch.setattr(_commands.webbrowser, "open", opened.append)
    main(["demo", "--out", str(tmp_path / "demo"), "--open"])
    printed = capsys.readouterr()
    assert "A simulated single-point test" in printed.out
    assert "decimal commas, utf-8; header in row 2" in printed.err
    assert opened == [(tmp_path / "demo" / "report.html").as_uri()]


@pytest.mark.exhaustive
def test_the_readme_shows_what_the_demo_prints(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["demo"]) == 0
    printed = capsys.readouterr().out.splitlines()
    page = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"raacmm demo\n```\n\n```text\n(.*?)```", page, re.DOTALL)
    lines = [line for line in shown.splitlines() if line != "..."]
    assert len(lines) == 3
    assert [line for line in lines if line not in printed] == []


def test_arm_from_every_source(tmp_path, capsys, monkeypatch):
    (tmp_path / "arm.urdf").write_text(URDF)
    for source in ([f"{tmp_path}/arm.urdf", "--tip", "tip"], ["ur10"]):
        assert main(["arm", *source, "--out", f"{tmp_path}/arm.json"]) == 0
    assert Arm.from_json(tmp_path / "arm.json") == Arm.from_name("ur10")
    assert main(["arm", "--lengths-223", "300", "420", "380", "120"]) == 0
    assert "2-2-3 arm" in capsys.readouterr().out
    offsets = ["--elbow-offset", "62", "--wrist-offset", "40", "--out", f"{tmp_path}/own.json"]
    assert main(["arm", "--lengths-222", "376", "750", "500", "98", *offsets]) == 0
    assert Arm.from_json(tmp_path / "own.json").a.tolist() == [0, 62, 0, 40, 0, 0]
    answers = iter(["2-2-2", "300", "420,5", "380", "120", "62", "0"])
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda _: next(answers))
    assert main(["arm"]) == 0
    printed = capsys.readouterr().out
    assert "420.5" in printed
    assert "decide the scale of the arm" in printed


@pytest.mark.parametrize("words", ["learn log.csv --arm ur10", "plan --arm ur10", "accept no.xlsx"])
def test_missing_extras_are_said_before_the_work(monkeypatch, tmp_path, capsys, words):
    for name in ("jinja2", "skops"):
        monkeypatch.setitem(sys.modules, name, None)
    (tmp_path / "log.csv").write_text("cone,q1\n")
    monkeypatch.chdir(tmp_path)
    assert main([*words.split(), "--out", "out"]) == 2
    assert re.search("jinja2 (and skops )?must be installed", capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_an_error_of_the_system_is_a_sentence(monkeypatch, capsys):
    def full(options):
        raise OSError(28, "No space left on device", "/out/arm.json.bba5d764bf6cf999.tmp")

    monkeypatch.setattr(_arms, "arm", full)
    assert main(["arm", "aacmm6"]) == 2
    assert capsys.readouterr().err == "raacmm arm: /out/arm.json: no space left on device.\n"


def test_a_code_that_names_no_change_is_refused(tmp_path, refused):
    readings, cones = OtherMake(2, error=0).test(6, 4)
    write_log(tmp_path / "log.csv", readings, cones)
    (tmp_path / "arm.urdf").write_text(URDF)
    words = "--arm", tmp_path / "arm.urdf", "--out", tmp_path / "out", "--take"
    for code in ("sign-1", "coupled-3-3", "reversed-8"):
        refused(f"or other-convention, got '{code}'", "learn", tmp_path / "log.csv", *words, code)
    assert not (tmp_path / "out").exists()


def test_an_arm_from_a_table_and_into_the_robots_own_file(tmp_path, refused):
    table = tmp_path / "dh.csv"
    table.write_text(
        "Joint;r [m];alpha [deg];d [m];theta;sign\n"
        + "".join(
            f"A{i};{a / 1000};{alpha};{d / 1000};{offset};-1\n".replace(".", ",")
            for i, (a, alpha, d, offset) in enumerate(
                [(0, -90, 290, 0), (270, 0, 0, -90), (70, -90, 0, 0)], 1
            )
        )
    )
    out = ["--out", str(tmp_path / "arm.json")]
    assert main(["arm", "--dh", str(table), "--probe", "1,2,3", *out]) == 0
    arm = Arm.from_json(tmp_path / "arm.json")
    np.testing.assert_allclose(arm.a, [0, 270, 70])
    assert (arm.names, arm.joint_signs.tolist()) == (("A1", "A2", "A3"), [-1, -1, -1])
    for text, message in (
        ("a;alpha;x\n1;2;3\n", "has no column 'd'; it has a, alpha, x"),
        ("a;alpha;d\n1;2;3\n1;x;3\n", "row 3, column 'alpha': 'x' is not a number"),
        ("a [deg];alpha;d\n1;2;3\n", "the column 'a [deg]' is in deg"),
    ):
        table.write_text(text)
        refused(message, "arm", "--dh", table)
    # Written into the robot's own file.
    (tmp_path / "arm.urdf").write_text(URDF)
    own = Arm.from_urdf(URDF)
    own.replace(d=own.d + 0.25).to_json(tmp_path / "arm.json")
    new = str(tmp_path / "new.urdf")
    into = ["--into", str(tmp_path / "arm.urdf"), "--tip", "tip"]
    assert main(["arm", str(tmp_path / "arm.json"), *into, "--out", new]) == 0
    angles = np.random.default_rng(0).uniform(-2, 2, (5, 7))
    np.testing.assert_allclose(
        Arm.from_urdf(new, tip="tip").forward(angles),
        own.replace(d=own.d + 0.25).forward(angles), atol=1e-9,
    )  # fmt: skip


def test_labels_of_stations_and_warm_lengths_reach_the_one_call(tmp_path, monkeypatch, refused):
    rows = [f"{i},2,3,4,5,6,{i},0,0,{'door' if i < 9 else 3}" for i in range(12)]
    names = [*(f"q{i} [deg]" for i in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]", "where"]
    (tmp_path / "t.csv").write_text("\n".join([",".join(names), *rows]) + "\n")

    def learn(*data, **options):
        assert options["stations"].tolist() == ["door"] * 9 + ["3"] * 3
        assert data[4] == [("A", "B", 500.0, 0.005, 25.0)]
        raise ValueError("that is all")

    monkeypatch.setattr("sklearn_raacmm.app._commands.learn_correction", learn)
    words = f"learn {tmp_path}/t.csv --arm aacmm6 --out {tmp_path}/out --points X,Y,Z"
    options = "--station where --length A:B:500:0.005@25"
    refused("that is all", *words.split(), *options.split())


def test_known_lengths_and_places_of_the_command_line(tmp_path):
    for text in ("A:B: 500.012:0.005", "A:B:500,012:0,005"):
        assert parse_length(text) == ("A", "B", 500.012, 0.005)
    with pytest.raises(TableError, match="such as A:B"):
        parse_length("A:B:500")
    warm = ("A", "B", 500.012, 0.005, 25.5)
    assert parse_length("A:B:500,012:0,005@25,5") == warm
    assert parse_length("A:B:500.012:0.005@25.5:0.5e-6") == (*warm, 0.5e-6)
    for wrong in ("A:B:500:0.005:1e-5", "A:B:500:0.005@", "A:B:500:0.005@20:1e-5:1"):
        with pytest.raises(TableError, match=r"A:B:500\.012:0\.005@25:11\.5e-6"):
            parse_length(wrong)
    path = tmp_path / "plate.csv"
    path.write_text("ball;x;y;z\nA;0;0;0\nB;300;400;0\nC;0;0;100\n")
    found = read_places(path, 0.004)
    assert (found[0][:3], len(found)) == (("A", "B", 500.0), 3)
    for text, sd, message in (
        ("ball;x;y;z\nA;0;0;0\n", None, "row 2 has no standard deviation in mm in its last"),
        # A damaged row is no header.
        ("ball;x;y;z\nA;0;O;0\nB;3;4;0\n", 0.004, "row 2 must hold a label, x, y and z in mm"),
        ("A;0;0;0;0.004\nA;300;400;0;0.004\n", None, "two different labels"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            read_places(path, sd)


@pytest.mark.parametrize(
    ("text", "a_mm", "alpha_deg"),
    [
        ("robot:\n  a: [0, -0.425]\n  d: [0.0892, 0]\n  alpha: [1.5708, 0]\n", -425, 90),
        ("dh_theta: [0 0]\ndh_a: [0 -0.425]\ndh_d: [0.0892 0]\ndh_alpha: [1.5708 0]\n", -425, 90),
        ("a,alpha,d\n0,90,89.2\n-425,0,0\n", -425, 90),
        ("a,alpha,d\n0,1.5,89.2\n-425,0,0\n", -425, 1.5),
        ("a [mm],alpha [deg],d [mm]\n0,1.5708,0.0892\n-0.425,0,0\n", -0.425, 1.5708),
    ],
)
def test_units_of_a_table_of_an_arm(text, a_mm, alpha_deg, tmp_path, capsys):
    (tmp_path / "dh.yaml").write_text(text)
    assert (
        main(["arm", "--dh", str(tmp_path / "dh.yaml"), "--out", str(tmp_path / "arm.json")]) == 0
    )
    arm = Arm.from_json(tmp_path / "arm.json")
    np.testing.assert_allclose(arm.a, [0, a_mm])
    np.testing.assert_allclose(np.rad2deg(arm.alpha), [alpha_deg, 0], atol=1e-3)
    said = capsys.readouterr().err
    assert "Taken as the standard convention" in said
    assert ("in rad" in said) == ("0.0892" in text and "[mm]" not in text)


def test_an_arm_from_its_data(tmp_path, capsys, refused):
    """Of a simulated test in six cones and a bar, with nothing but the layout."""
    test = make_single_point(6, 10, bars=[500], random_state=0)
    (a, b, length, _) = test.lengths[0]
    rows = np.column_stack([test.groups, np.rad2deg(test.data).round(6)]).tolist()
    lines = [f"K{int(row[0])},{','.join(map(str, row[1:]))}" for row in rows]
    names = ",".join(f"q{i} [deg]" for i in range(1, 7))
    table, out = tmp_path / "log.csv", tmp_path / "arm.json"
    table.write_text("\n".join([f"cone,{names}", *lines]) + "\n")
    words = ["arm", "--from-data", str(table), "--layout", "2-2-2"]
    assert main([*words, "--length", f"K{a}:K{b}:{length}:0.01", "--out", str(out)]) == 0
    found, said = Arm.from_json(out), " ".join(capsys.readouterr().out.split())
    assert np.sort(np.abs(found.d))[-2:] == pytest.approx([500, 750], abs=2)
    assert "seen from above: does its angle grow? Was the probe higher in row" in said
    refused("--from-data and --layout belong together", *words[:3])
    refused("without a known distance", *words)


@pytest.mark.parametrize(
    ("root", "sentence"),
    [("mujoco", "MuJoCo's MJCF: take the URDF"), ("sdf", "Gazebo's SDF: take the URDF")],
)
def test_other_descriptions_of_robots_are_named(root, sentence, tmp_path, refused):
    (tmp_path / "m.xml").write_text(f"<{root}><worldbody/></{root}>")
    refused(sentence, "arm", tmp_path / "m.xml")


# What a UR's controller stores of its own arm: changes of the nominal table, m and rad.
UR_CHANGES = {
    "theta": [4.5e-05, -0.2651, 0.6214, -0.3559, 1.2e-04, -9.1e-06],
    "a": [0.000112, 0.0121, 0.0019, 0.000023, 0.0000045, 0],
    "d": [0.00021, 118.35, -121.02, 2.661, 0.000145, -0.00031],
    "alpha": [-0.00031, 0.00087, -0.00105, 0.00021, -0.00044, 0],
}


def of_definition(table, angles):
    """Probe points of a standard table: the product of its transformations."""
    points = []
    for row in angles:
        pose = np.eye(4)
        for (a, alpha, d, offset), angle in zip(table, row, strict=True):
            c, s, ca, sa = (f(v) for v in (angle + offset, alpha) for f in (np.cos, np.sin))
            pose = pose @ [
                [c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d],
                [0, 0, 0, 1],
            ]  # fmt: skip
        points.append(pose[:3, 3])
    return np.array(points)


def test_the_calibration_of_a_ur_itself(tmp_path, capsys, refused):
    """Two axes 0.00087 rad from parallel have a common normal 118 m away: taken as parallel."""
    conf, made = tmp_path / "calibration.conf", tmp_path / "arm.json"
    lines = [f"delta_{name} = {numbers}" for name, numbers in UR_CHANGES.items()]
    conf.write_text("[mounting]\n" + "\n".join(lines) + "\njoint_checksum = [ 0x1, 0x2 ]\n")
    refused("name it, such as raacmm arm ur10e --dh", "arm", conf)
    refused("and <Arm 'panda'", "arm", "panda", "--dh", conf)
    assert main(["arm", "ur10", "--dh", str(conf), "--out", str(made)]) == 0
    assert "moves the probe by up to 1.5 mm" in capsys.readouterr().err
    nominal, arm = Arm.from_name("ur10"), Arm.from_json(made)
    added = [UR_CHANGES[name] for name in ("a", "alpha", "d", "theta")] * np.c_[[1e3, 1, 1e3, 1]]
    table = np.add([nominal.a, nominal.alpha, nominal.d, nominal.theta_offset], added).T
    angles = np.random.default_rng(0).uniform(-3, 3, (50, 6))
    points = of_definition(table, angles)
    assert np.linalg.norm(arm.forward(angles) - points, axis=1).max() < 1.5
    assert np.linalg.norm(nominal.forward(angles) - points, axis=1).max() > 100
    assert arm.names == nominal.names
    rows = [["a [mm]", "alpha [deg]", "d [mm]", "theta offset [deg]"]]
    rows += (table * [1, 180 / np.pi, 1, 180 / np.pi]).tolist()
    (tmp_path / "dh.csv").write_text("\n".join(",".join(map(str, row)) for row in rows))
    assert main(["arm", "--dh", str(tmp_path / "dh.csv"), "--out", str(made)]) == 0
    same = Arm.from_json(made)
    np.testing.assert_allclose(same.forward(angles), arm.forward(angles), atol=1e-9)


def test_touches_are_learnt_through_the_command(tmp_path, capsys, refused):
    """Balls of known size by an option, a plane and a cone by a column, and a block."""
    test = make_features(
        4, 2, 1, 15, blocks=[300.0], tip_diameter=4, machine="eccentricity", random_state=1
    )
    test.nominal_arm.to_json(tmp_path / "arm.json")
    kinds = {label: kind for label, kind, *_ in test.features}
    lines = [",".join([*(f"q{i} [rad]" for i in range(1, 7)), "position", "what"])]
    for angles, label in zip(test.data, test.groups, strict=True):
        what = kinds.get(label, "Cone")
        cells = [*(f"{q:.9f}" for q in angles), f"F{label}", "plane" if label < 4 else what]
        lines.append(",".join(cells))
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n")
    first = ["learn", f"{tmp_path}/t.csv", "--arm", f"{tmp_path}/arm.json", "--out"]
    words = [*first, f"{tmp_path}/out", "--folds", "3", "--kind", "what", "--tip-diameter", "4"]
    for ball in range(4):  # what an option says goes before the column
        words += ["--feature", f"F{ball}:sphere:30:0.001:outside"]
    refused("--feature needs the label", *words, "--feature", "F5:sphere:30")
    refused("a feature is a cone, plane, sphere", *words, "--feature", "F5:hole")
    ((one, other, length, sd),) = test.lengths
    assert main([*words, "--length", f"F{one}:F{other}:{length}:{sd}"]) == 0
    printed = capsys.readouterr().out
    assert "It helps at new features: 2S from forms" in printed
    assert "2S from forms in mm at features left out:" in printed
    facts = json.loads((tmp_path / "out" / "correction.json").read_text(encoding="utf-8"))
    assert facts["measure"] == "2S from forms"
    new = make_single_point(5, 15, machine=test.simulation.machine, random_state=7)
    saved = _files.load_correction(tmp_path / "out")
    before, after = (
        single_point_repeatability(points, new.groups)
        for points in (saved.arm.forward(new.data), saved.correct(new.data)[0])
    )
    assert after < 0.7 * before
