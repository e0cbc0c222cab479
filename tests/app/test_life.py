"""The words for the life of an arm: register, update, move, check; by cones and by a tracker."""

import functools
import io
import json
import os
import re
import shutil
import subprocess
import sys
from copy import copy
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from sklearn_raacmm import Arm, ArmResidualRegressor, Correction, learn_correction
from sklearn_raacmm.app import _report, main, read_table
from sklearn_raacmm.app._life import highest_mean, save_step
from sklearn_raacmm.app._tables import Layout
from sklearn_raacmm.datasets import SimulatedArm, make_single_point
from sklearn_raacmm.export import describe

MACHINE = SimulatedArm("typical", random_state=1)
TURN, SHIFT = Rotation.from_rotvec([0.1, 0.2, 1]).as_matrix(), np.array([1500.0, 300.0, -100.0])


@functools.cache
def with_probe(length):
    """The same simulated arm with a longer probe."""
    other = copy(MACHINE)
    for name in ("nominal_arm", "true_arm"):
        arm = getattr(MACHINE, name)
        setattr(other, name, arm.replace(probe=arm.probe + np.array([0, 0, length - 100.0])))
    other.reach = MACHINE.reach + length - 100
    return other


def seen(test, moved=(0.0, 0.0, 0.0)):
    """Points of a tracker that sees the true probe to 10 um."""
    noise = np.random.default_rng(0).normal(0, 0.01, test.points.shape)
    return test.simulation.true_points @ TURN.T + SHIFT + noise + moved


def write(path, test, points=None, jitter_rad=0.0):
    header = ["cone", *(f"q{i} [deg]" for i in range(1, 7)), *("xyz" if points is not None else "")]
    noise = np.random.default_rng(0).normal(0, jitter_rad, test.data.shape)
    table = [np.rad2deg(test.data + noise), *([points] if points is not None else [])]
    rows = np.hstack(table)
    lines = [";".join(header)]
    for label, row in zip(test.groups, rows, strict=True):
        lines.append(";".join([f"cone {label}", *(f"{value:.7f}" for value in row)]))
    path.write_text("\n".join(lines) + "\n")
    return str(path)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Corrections learnt from cones and from a tracker, and tables of a probe of 250 mm."""
    folder = tmp_path_factory.mktemp("life")
    test = make_single_point(8, 16, machine=MACHINE, random_state=1)
    model = ArmResidualRegressor(orders=4)
    for name, points in (("cones", None), ("tracker", seen(test))):
        found = learn_correction(
            test.nominal_arm, test.data, test.groups, points, model=model, cv=2
        )
        found.save(folder / name)
    # An encoder that follows a temperature, which nobody measures later.
    warm, extra = test.data.copy(), {"temperature 3": np.random.default_rng(0).normal(size=128)}
    warm[:, 2] += 3e-4 * extra["temperature 3"]
    found = learn_correction(test.nominal_arm, warm, test.groups, model=model, cv=2, extra=extra)
    assert list(found.causes) == ["temperature 3"]
    found.save(folder / "warm")
    long = with_probe(250)
    new = make_single_point(2, 8, machine=long, random_state=5)
    more = make_single_point(5, 8, machine=long, random_state=6)
    write(folder / "new.csv", new)
    spread = make_single_point(4, 5, machine=long, random_state=7)
    write(folder / "new_points.csv", spread, seen(spread))
    write(folder / "on_a_line.csv", new, seen(new))
    write(folder / "more.csv", more)
    write(folder / "more_points.csv", more, seen(more))
    write(folder / "settled.csv", more, seen(more, (0.3, 0.2, 0.0)))
    return folder


@pytest.fixture
def folder(made, tmp_path_factory):
    """The same for one test: every check adds a step to the history of the folder it looks at."""
    return shutil.copytree(made, tmp_path_factory.mktemp("life") / "own")


def run(capsys, *words):
    code = main([str(word) for word in words])
    printed = capsys.readouterr()
    return code, printed.out + printed.err


POINTS = ("--points", "x,y,z")


@pytest.mark.parametrize(("learnt", "table", "more"), [
    ("cones", "new_points.csv", POINTS), ("tracker", "new.csv", ()), ("warm", "new.csv", ()),
])  # fmt: skip
def test_a_new_probe_is_registered_by_either(folder, tmp_path, capsys, learnt, table, more):
    words = ["register", folder / table, "--model", folder / learnt, "--out", tmp_path, *more]
    code, printed = run(capsys, *words)
    assert code == 0, printed
    saved = Correction.load(tmp_path)
    # Of the vector that was built: two cones show it to some hundredths, the table to some tenths.
    assert abs(saved.arm.probe - with_probe(250).true_arm.probe)[2] < 0.2
    assert saved.model.arm_ == saved.arm
    assert saved.facts["history"][-1]["what"] == "register"
    assert "mm from where it was" in printed
    # Other poses scatter less with it than without.
    more = make_single_point(4, 10, machine=with_probe(250), random_state=9)
    bare, corrected = (
        np.linalg.norm(points - np.repeat(points.reshape(4, 10, 3).mean(axis=1), 10, axis=0))
        for points in (saved.arm.forward(more.data), saved.correct(more.data)[0])
    )
    # Of a probe that is 150 mm longer 128 rows of eight cones leave 0.55 on this arm.
    assert corrected < 0.6 * bare


def test_a_check_elsewhere_does_not_say_that_it_holds(tmp_path, capsys):
    # Learnt in a narrow range of the joints, checked in all: errors there are larger than it knows.
    rng = np.random.default_rng(0)
    middle = np.array([0.3, 0.2, 1.0, 0.3, 0.8, 0.1])
    near = middle + rng.uniform(-0.4, 0.4, (160, 6))
    far = rng.uniform(-2.5, 2.5, (40, 6))
    seen_there = [
        MACHINE.forward(q) @ TURN.T + SHIFT + rng.normal(0, 0.005, (len(q), 3)) for q in (near, far)
    ]
    model = ArmResidualRegressor(orders=4)
    names = np.arange(160) // 8
    learn_correction(MACHINE.nominal_arm, near, names, seen_there[0], model=model, cv=2).save(
        tmp_path / "near"
    )
    header = ",".join([*(f"q{i} [deg]" for i in range(1, 7)), *"xyz"])
    np.savetxt(
        table := tmp_path / "far.csv", np.c_[np.rad2deg(far), seen_there[1]], delimiter=",",
        header=header, comments="",
    )  # fmt: skip
    code, printed = run(capsys, "check", table, "--model", tmp_path / "near", *POINTS)
    saved = Correction.load(tmp_path / "near")
    off = saved.residuals(far, seen_there[1])
    mean = [np.linalg.norm(y, axis=1).mean() for y in (off, off - saved.model.predict(far))]
    assert code == 3
    assert "Whether it holds does not show" in printed
    assert "farther off than the model can tell" in printed
    assert f"mean distance {mean[0]:.3f} -> {mean[1]:.3f} mm" in printed
    step = saved.facts["history"][-1]
    assert not step["holds"]
    assert_allclose([step["before_mm"], step["after_mm"]], mean, rtol=1e-9)


def test_a_slip_in_a_code_is_refused_by_a_check_that_registers_nothing(folder):
    saved, more = Correction.load(folder / "cones"), make_single_point(2, 4, machine=MACHINE)
    with pytest.raises(ValueError, match=r"'moved-postion' is no code .* are: moved-position"):
        saved.check(more.data, more.groups, accept="moved-postion")


def test_points_of_a_longer_probe_may_scatter_more(folder, tmp_path, capsys):
    saved = Correction.load(folder / "cones")
    step = {"what": "learn", "date": "2026-01-05", "probe_mm": saved.arm.probe.tolist()}
    replace(saved, facts=saved.facts | {"history": [step]}).save(tmp_path)
    plain = highest_mean(saved.facts["positions"], np.full(5, 8), 0.005)
    for word, table in (("register", "new.csv"), ("check", "more.csv")):
        code, printed = run(capsys, word, folder / table, "--model", tmp_path)
    checked = Correction.load(tmp_path).facts["history"][-1]
    # Errors of joints move the end of an arm by its lever: here up to 150 mm in 900 more.
    assert 1.05 * plain < checked["expected_below_mm"] < 2 * plain
    assert (code, checked["holds"]) == (0, True), printed


def test_a_base_that_has_moved_is_named_and_registered(folder, tmp_path, capsys):
    out = tmp_path / "registered"
    start = ["register", folder / "new_points.csv", "--model", folder / "tracker", "--out", out]
    assert run(capsys, *start, *POINTS)[0] == 0
    table = folder / "settled.csv"
    code, printed = run(capsys, "check", table, "--model", out, *POINTS, "--json")
    facts = json.loads(printed[printed.index("{") : printed.rindex("}") + 1])
    assert code == 3
    assert facts["suspect"] == "base"
    assert facts["size_mm"] == pytest.approx(0.36, abs=0.1)
    assert "register again" in printed
    code, printed = run(capsys, "register", table, "--model", out, *POINTS)
    assert code == 0
    assert "Base: moved by 0." in printed
    assert run(capsys, "check", table, "--model", out, *POINTS)[0] == 0


@pytest.mark.parametrize("learnt", ["cones", "warm"])
def test_one_story_of_whatever_changes_the_model(folder, tmp_path, capsys, learnt):
    out = tmp_path / "out"
    Correction.load(folder / learnt).save(out, {"report.html": "<body>\n<h1>Learnt</h1></body>"})
    (out / "corrected.csv").write_text("points of before")
    code, printed = run(capsys, "update", folder / "more.csv", "--model", out)
    assert (code, "mean deviation" in printed) == (0, True)
    saved = Correction.load(out)
    assert len(saved.model.updates_) == 1
    step = saved.facts["history"][-1]
    assert (step["what"], step["n_poses"]) == ("update", 40)
    assert step["after_mm"] < step["before_mm"]
    # Report, card and points are those of the new model; the points of before are kept.
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.index("<h1>Learnt") < page.index(f"Updated on {step['date']}: mean deviation")
    for when in ("before", "after"):
        assert f">{1000 * step[f'{when}_mm']:.1f}</td>" in page
    fingerprint = describe(saved.model)["fingerprint"]
    assert fingerprint in (out / "card.md").read_text(encoding="utf-8")
    points = read_table(out / "corrected.csv", 6, position="cone", points=["x", "y", "z"]).points
    angles = np.deg2rad(read_table(folder / "more.csv", 6).angles)
    assert_allclose(points, saved.correct(angles)[0], atol=1e-6)
    (before,) = out.glob("corrected_before_update_20*.csv")
    assert before.read_text() == "points of before"
    code, printed = run(capsys, "move", "--model", out, "--probe", "0,0,250")
    assert (code, "register the probe" in printed) == (0, True)
    moved = Correction.load(out)
    assert moved.arm.probe.tolist() == [0, 0, 250]
    assert list(out.glob("corrected_before_move_20*.csv"))
    assert not (out / "corrected.csv").exists()
    code, printed = run(capsys, "check", folder / "new.csv", "--model", out, "--json")
    assert [step["what"] for step in Correction.load(out).facts["history"]] == [
        "update", "move", "check",
    ]  # fmt: skip
    page = (out / "report.html").read_text(encoding="utf-8")
    assert re.findall(r"<h\d>(.*?)</h\d>", page) == ["Learnt", "Since it was learnt"]
    assert re.findall(r"<tr><td>(.*?)</td>", page) == ["update", "move", "check"]
    # The sentence of the check stands below the title, and its point in the chart.
    (sentence,) = re.findall(r"<strong>(.*?)</strong>", page)
    checked = Correction.load(out).facts["history"][-1]
    assert sentence == f"Checked on {step['date']}. {checked['said'].replace('->', '→')}"
    assert checked["said"] in printed
    assert ('class="verdict good"' in page) == checked["holds"]
    assert page.count("<circle") == checked["holds"]
    assert page.count('var(--bad)" stroke') == (not checked["holds"])


def test_without_the_extra_for_pages(folder, tmp_path, capsys, monkeypatch):
    """Nothing is begun that cannot be written; a check has its answer all the same."""
    out = tmp_path / "out"
    Correction.load(folder / "cones").save(out)
    before = (out / "correction.json").read_bytes()
    monkeypatch.setitem(sys.modules, "jinja2", None)
    _report._environment.cache_clear()  # of pages that other tests have made
    monkeypatch.setattr(Correction, "update", None)
    code, printed = run(capsys, "update", folder / "more.csv", "--model", out)
    assert (code, "jinja2 must be installed: pip install jinja2." in printed) == (2, True)
    code, printed = run(capsys, "check", folder / "new.csv", "--model", out)
    assert code in (0, 3)
    assert "This check is not in the history of" in printed
    assert (out / "correction.json").read_bytes() == before


def test_the_same_poses_update_a_correction_once(folder, tmp_path, capsys):
    """In another order, with other digits and in a table that has grown they are the same."""
    words = ["--model", folder / "cones", "--out", tmp_path / "out"]
    code, printed = run(capsys, "update", folder / "more.csv", *words, "--json")
    assert (code, '"rows"' in printed) == (0, False)  # of use to the next update only
    head, *rows = (folder / "more.csv").read_text().splitlines()
    new = (folder / "new.csv").read_text().splitlines()[1:]
    again = tmp_path / "again.csv"
    before = (tmp_path / "out" / "correction.json").read_text()
    for lines, used in (([f"{row}01" for row in rows[::-1]], 40), ([*rows[:15], *new], 15)):
        again.write_text("\n".join([head, *lines]) + "\n")
        code, printed = run(capsys, "update", again, "--model", tmp_path / "out")
        said = f"{used} of these {len(lines)} poses have updated this correction on 20"
        assert (code, said in printed) == (2, True)
    assert (tmp_path / "out" / "correction.json").read_text() == before
    printed = run(capsys, "check", folder / "more.csv", "--model", tmp_path / "out")[1]
    assert "40 of these 40 poses have updated" in printed


def test_a_robot_may_repeat_its_poses(folder, tmp_path, capsys):
    """A tracker has seen them anew: other measurements of the same angles."""
    out = tmp_path / "out"
    words = [*POINTS, "--model", folder / "tracker", "--out", out]
    assert run(capsys, "update", folder / "more_points.csv", *words)[0] == 0
    head, *rows = (folder / "more_points.csv").read_text().splitlines()
    noise = np.random.default_rng(1).normal(0, 0.01, len(rows))
    cells = [row.split(";") for row in rows]
    rows = [";".join([*c[:-1], str(float(c[-1]) + e)]) for c, e in zip(cells, noise, strict=True)]
    again = tmp_path / "again.csv"
    again.write_text("\n".join([head, *rows]) + "\n")
    assert run(capsys, "update", again, *POINTS, "--model", out)[0] == 0
    code, printed = run(capsys, "update", again, *POINTS, "--model", out)
    assert (code, "have updated this correction on 20" in printed) == (2, True)


def test_two_that_update_at_once_lose_nothing(folder, tmp_path, capsys, monkeypatch):
    """Whoever read what another has replaced meanwhile writes nothing."""
    out = tmp_path / "out"
    Correction.load(folder / "cones").save(out)
    update = Correction.update

    def meanwhile(self, *args, **options):
        found = update(self, *args, **options)
        monkeypatch.setattr(Correction, "update", update)
        assert main(["move", "--model", str(out), "--probe", "0,0,250"]) == 0
        return found

    monkeypatch.setattr(Correction, "update", meanwhile)
    code, printed = run(capsys, "update", folder / "more.csv", "--model", out)
    assert code == 2
    assert "was changed by another process meanwhile: run this again" in printed
    assert [step["what"] for step in Correction.load(out).facts["history"]] == ["move"]


@pytest.fixture
def two_tools(folder, tmp_path):
    """A correction that knows two probes, of which the first is in use."""
    saved = Correction.load(folder / "cones")
    tools = {"1": saved.arm.probe.tolist(), "long": [0.0, 0.0, 250.0]}
    replace(saved, facts=saved.facts | {"tools": tools}).save(tmp_path / "model")
    return saved, tools, ("--model", tmp_path / "model")


def test_each_row_is_corrected_by_its_own_probe(folder, two_tools, tmp_path, capsys, refused):
    saved, tools, model = two_tools
    head, *lines = (folder / "new.csv").read_text().splitlines()
    names = np.resize(["long", "1"], len(lines)).tolist()
    rows = [f"{line};{name}" for line, name in zip(lines, names, strict=True)]
    table, out = tmp_path / "today.csv", tmp_path / "out.csv"
    table.write_text("\n".join([f"{head};stylus", *rows]) + "\n")
    words = ["correct", table, *model, "--out", out]
    assert run(capsys, *words, "--tool", "stylus")[0] == 0
    found = read_table(out, 6, position="cone", points=["x", "y", "z"])
    for name, probe in tools.items():
        of_name = np.array(names) == name
        own = saved.arm.replace(probe=probe)
        angles = np.deg2rad(found.angles[of_name])
        expected = own.forward(angles) - saved.model.with_arm(own).predict(angles)
        np.testing.assert_allclose(found.points[of_name], expected, atol=1e-3)
    refused("knows no tool 'cone 0'; it was learnt with 1, long", *words, "--tool", "cone")


def test_a_probe_that_no_row_names_is_not_guessed(folder, two_tools, tmp_path, capsys, refused):
    """Which of two probes the rows are of is asked for; one registered since is meant."""
    model, table, out = two_tools[2], folder / "new.csv", tmp_path / "out.csv"
    words = "correct", table, *model, "--out", out
    refused("learnt with the tools 1, long, and 1 is in use", *words)
    assert not out.exists()
    for words in (["check", table, *model], ["export", *model, "--c", tmp_path / "c"]):
        assert "and 1 is in use" in run(capsys, *words)[1]
    new = tmp_path / "registered"
    code, printed = run(capsys, "register", table, *model, "--out", new)
    assert code == 0
    assert "tools 1, long stay as they were learnt" in printed
    assert run(capsys, "correct", table, "--model", new, "--out", out)[0] == 0


@pytest.mark.parametrize(("learnt", "words", "sentence"), [
    ("cones", "correct new.csv --extra payload", "names 'payload', and this correction takes no c"),
    ("warm", "correct new.csv --extra temperature=cone", "'temperature', and this correction"),
    ("cones", "register new_points.csv --points x,y", "needs three columns"),
    ("cones", "register on_a_line.csv --points x,y,z", "spread in all directions"),
    ("cones", "update more_points.csv --points x,y,z --length 0:1:500:0.01", "--lengths are betw"),
    ("cones", "register new.csv --length 0:1:500:0.01", "no samples; groups are cone 0, cone 1."),
    ("cones", "move --probe 0,250", "--probe needs 3 numbers, such as"),
])  # fmt: skip
def test_faults_get_one_sentence(folder, tmp_path, refused, learnt, words, sentence):
    words = [str(folder / word) if word.endswith(".csv") else word for word in words.split()]
    refused(sentence, *words, "--model", folder / learnt, "--out", tmp_path / "out.csv")
    assert not (tmp_path / "out.csv").exists()


def test_a_plan_that_the_arm_reaches(tmp_path, capsys):
    """The table is one that `raacmm learn` reads, and its poses do reach their cones."""
    words = ["plan", "--arm", "aacmm6", "--out", tmp_path, "--cones", "3", "--poses", "5"]
    limits = "-170,170,-120,20,-150,150,-170,170,-120,120,-170,170"
    code, printed = run(capsys, *words, f"--limits={limits}")
    assert code == 0
    assert "spread" in printed
    table = read_table(tmp_path / "plan.csv", 6)
    points = Arm.from_name("aacmm6").forward(np.deg2rad(table.angles))
    for label in np.unique(table.positions):
        own = points[table.positions == label]
        # Angles are written to 0.01 degrees: 0.3 mm at the reach of 1.9 m, several joints.
        assert np.abs(own - own.mean(axis=0)).max() < 1.5
    low, high = np.array(limits.split(","), dtype=float).reshape(-1, 2).T
    assert ((low - 0.01 <= table.angles) & (table.angles <= high + 0.01)).all()
    ends = [points[table.positions == f"bar {end}"].mean(axis=0) for end in ("left", "right")]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(500, abs=1)
    page = (tmp_path / "plan.html").read_text()
    assert page.count("<tr>") == 3 + 15 + 2
    assert "<svg" in page
    assert "For the arm aacmm6 with 6 joints" in page
    assert page.count('<td class="blank">') == 15


@pytest.fixture
def in_radians(folder):
    """A table of radians under the header of degrees."""
    header, *rows = (folder / "more.csv").read_text().splitlines()
    rows = [row.split(";") for row in rows]
    lines = [";".join([row[0], *(f"{np.deg2rad(float(v)):.9f}" for v in row[1:])]) for row in rows]
    path = folder / "radians.csv"
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def test_a_longer_probe_is_to_be_registered_and_no_unit_is_doubted(folder, capsys):
    code, printed = run(capsys, "check", folder / "more.csv", "--model", folder / "cones")
    assert code == 3
    assert "that ends 150 mm elsewhere explains it: run raacmm register.\n" in printed
    assert "Look at the unit" not in printed


@pytest.mark.parametrize(
    ("word", "code"), [("correct", 0), ("check", 3), ("register", 2), ("update", 2)]
)
def test_radians_under_a_header_of_degrees(folder, in_radians, tmp_path, capsys, word, code):
    """Each word names them, and nothing is registered by them."""
    out = tmp_path / "out.csv"
    words = [word, in_radians, "--model", folder / "cones"]
    found, printed = run(capsys, *words, *([] if word == "check" else ["--out", out]))
    assert found == code, printed
    assert printed.count("(raacmm: --unit rad)") == 1
    if code:
        assert "Look at the unit, order and sense of the angles" in printed
        assert "Update the correction" not in printed  # one answer says what to do once
        assert not out.exists()
    words = ["correct", in_radians, "--model", folder / "cones", "--unit", "rad", "--out", out]
    found, printed = run(capsys, *words)
    assert found == 0
    assert "if they are" not in printed


def test_correct_reads_its_standard_input(folder, tmp_path, capsys, monkeypatch):
    words = ["--model", folder / "cones", "--std", "no", "--out"]
    assert run(capsys, "correct", folder / "new.csv", *words, tmp_path / "of_file.csv")[0] == 0
    with open(folder / "new.csv", "rb") as file:
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(file))
        assert run(capsys, "correct", "-", *words, tmp_path / "of_stream.csv")[0] == 0
    assert (tmp_path / "of_file.csv").read_text() == (tmp_path / "of_stream.csv").read_text()


def test_fewer_columns_are_the_first_of_all(folder, tmp_path, capsys):
    found = {}
    for std in ("no", "point", "all"):
        out = tmp_path / f"{std}.csv"
        words = ["correct", folder / "new.csv", "--model", folder / "cones", "--std", std]
        assert run(capsys, *words, "--out", out, "--quiet") == (0, "")
        found[std] = pd.read_csv(out, sep=";")
    assert [len(found[std].columns) for std in found] == [10, 13, 17]
    for std in ("no", "point"):
        pd.testing.assert_frame_equal(found[std], found["all"][found[std].columns])


@pytest.mark.parametrize("couplings", [(), [(3, 2, 1), (4, 3, -1)]], ids=["alone", "sums"])
def test_senses_and_zeros_of_encoders_are_options(couplings, tmp_path, capsys):
    """Readings of other encoders of the same arm give the same points."""
    signs, zeros = [-1, 1, 1, -1, 1, 1], [-10.0, 0, 5, 20, 0, 3.5]
    lists = [",".join(map(str, values)) for values in (signs, zeros)]
    plain, out = Arm.from_name("aacmm6", couplings=couplings), tmp_path / "arm.json"
    plain.to_json(tmp_path / "plain.json")
    words = ["--up", "-1,0,0", "--sign", lists[0], "--zero", lists[1], "--out", out]
    assert run(capsys, "arm", tmp_path / "plain.json", *words)[0] == 0
    arm = Arm.from_json(out.read_text())
    true = np.random.default_rng(0).uniform(-2, 2, (5, 6))
    assert_allclose(arm.forward(true * signs + np.deg2rad(zeros)), plain.forward(true), atol=1e-9)
    assert_allclose(arm.up, (-1, 0, 0))


def test_columns_are_written_as_cells_are(folder, tmp_path, monkeypatch):
    """A table of plain cells is cut by columns; the file is the same to the byte."""
    rng = np.random.default_rng(0)
    n = 300
    angles = np.rad2deg(rng.uniform(-3, 3, (n, 6)))
    cells = [
        [f"{v:.4f}" if i % 3 else f"{v:+.3e}" for i, v in enumerate(row)] for row in angles.tolist()
    ]
    rows = [[f"cone {i % 7}", f"{i * 0.1:.1f}", *row, ""] for i, row in enumerate(cells)]
    header = "place,t,q1 [deg],q2 [deg],q3 [deg],q4 [deg],q5 [deg],q6 [deg],remark"
    text = "\n".join(["# a log", header, *map(",".join, rows)])
    plain = []
    for end, by_columns in (("\n", True), ("\r\n", True), ("\n", False)):
        (tmp_path / "log.csv").write_bytes(text.replace("\n", end).encode())
        if not by_columns:
            monkeypatch.setattr(Layout, "is_plain", lambda _: False)
        else:
            assert Layout(tmp_path / "log.csv", 6, labelled=False).is_plain()
        out = tmp_path / "corrected.csv"
        words = [tmp_path / "log.csv", "--model", folder / "cones", "--out", out]
        assert main(["correct", *map(str, words)]) == 0
        plain.append(out.read_bytes())
    assert plain[0] == plain[1] == plain[2]
    assert len(plain[0].split(b"\r\n")) == n + 2


@pytest.mark.parametrize(
    "row",
    ['"a",1,2,3,4,5,6', "=a,1,2,3,4,5,6", "a, 1,2,3,4,5,6", "# a,1,2,3,4,5,6", "a,1,2,3,4,5,x"],
)
def test_what_needs_a_look_at_cells_is_not_cut_by_columns(row, tmp_path):
    header = ",".join(["place", *(f"q{i} [deg]" for i in range(1, 7))])
    path = tmp_path / "log.csv"
    path.write_text("\n".join([header, "a,1,2,3,4,5,6", "b,7,8,9,1,2,3", row, ""]))
    assert not Layout(path, 6, labelled=False).is_plain()


def test_short_commands_leave_skops_alone(folder, tmp_path):
    """It takes longer to import than all else that they do."""
    code = """
import sys
from sklearn_raacmm.app import main
table, model, out = sys.argv[1:]
main(["correct", table, "--model", model, "--out", out])
main(["check", table, "--model", model])
print(sorted({"skops", "sklearn.ensemble", "matplotlib"} & sys.modules.keys()))
"""
    words = [folder / "more.csv", folder / "cones", tmp_path / "out.csv"]
    command = [sys.executable, "-c", code, *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]", done.stdout + done.stderr
    history = json.loads((folder / "cones" / "correction.json").read_text())["history"]
    assert history[-1]["what"] == "check"
    Correction.load(folder / "cones")


def contents_of(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_noise_is_no_change(folder, tmp_path, capsys):
    """Angles that are noisy by 1e-5 to 3e-4 rad leave probe and model as they were."""
    saved = Correction.load(folder / "cones")
    test = make_single_point(4, 12, machine=with_probe(100), random_state=11)
    for jitter_rad in (1e-5, 3e-4):
        write(tmp_path / "noisy.csv", test, jitter_rad=jitter_rad)
        out = tmp_path / f"{jitter_rad}"
        words = ["update", tmp_path / "noisy.csv", "--model", folder / "cones", "--out", out]
        code, printed = run(capsys, *words)
        assert (code, "and no change beside it" in printed) == (0, True), printed
        new = Correction.load(out)
        assert new.arm == saved.arm
        assert_allclose(new.correct(test.data)[0], saved.correct(test.data)[0], rtol=0, atol=1e-9)


def test_another_arm_replaces_nothing(folder, tmp_path, capsys):
    other = make_single_point(4, 12, machine=SimulatedArm("typical", random_state=77))
    write(tmp_path / "other.csv", other)
    before = contents_of(folder / "cones")
    for word, ends in (("register", (2, 3)), ("update", (2,))):
        code, printed = run(capsys, word, tmp_path / "other.csv", "--model", folder / "cones")
        assert code in ends, printed
        assert contents_of(folder / "cones") == before


def test_a_probe_in_metres_is_asked_for(folder, capsys):
    before = contents_of(folder / "cones")
    code, printed = run(capsys, "move", "--model", folder / "cones", "--probe", "0,0,0.2")
    assert (code, "are these metres?" in printed) == (2, True)
    assert contents_of(folder / "cones") == before


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_step_killed_before_any_name_is_given_loses_no_points(folder, tmp_path):
    """The old points and, once the correction is the new one, the new ones are kept."""
    saved, n_killed = Correction.load(folder / "cones"), 0
    for n in range(8):
        out, replace_file, given = tmp_path / f"{n}", os.replace, []
        saved.save(out, {"corrected.csv": "points 0"})
        child = os.fork()
        if not child:

            def dies(source, place, given=given, n=n, replace_file=replace_file):
                given.append(place)
                if len(given) > n:
                    os._exit(9)
                replace_file(source, place)

            os.replace = dies
            save_step(
                saved, out, {"what": "register"}, None, contents={"corrected.csv": "points 1"}
            )
            os._exit(0)
        n_killed += os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
        known = Correction.load(out)
        save_step(known, out, {"what": "register"}, None, contents={"corrected.csv": "points 2"})
        kept = {path.read_text() for path in out.glob("corrected*.csv")}
        assert kept == {"points 0", "points 2", *["points 1"] * ("history" in known.facts)}
        assert not list(out.glob("*.tmp"))
    assert n_killed == 7  # of eight, as seven files are renamed


def test_labels_are_no_formulas(folder, tmp_path, capsys):
    """They get an apostrophe, numbers none; the option leaves it out."""
    head, *rows = (folder / "new.csv").read_text().splitlines()
    rows = [
        ";".join(["=1+1" if i % 2 else "@A", *row.split(";")[1:]]) for i, row in enumerate(rows)
    ]
    (tmp_path / "t.csv").write_text("\n".join([head, *rows]) + "\n")
    for more, label in (((), "'=1+1"), (("--formulas",), "=1+1")):
        words = ["correct", tmp_path / "t.csv", "--model", folder / "cones", *more]
        assert run(capsys, *words, "--out", tmp_path / "c.csv")[0] == 0
        new = (tmp_path / "c.csv").read_text().splitlines()
        assert new[2].startswith(f"{label};")
        assert not re.search("'-?[0-9.]", "".join(new))


def test_a_record_that_cannot_be_written_is_no_empty_file(folder, tmp_path, capsys, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    record = tmp_path / "record.csv"
    words = ["check", folder / "new.csv", "--model", folder / "cones", "--record", record]
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        code, printed = run(capsys, *words)
    assert code in (0, 3)
    assert f"This check is not in {record}: [Errno 28]" in printed
    assert not record.exists()
    for n in (2, 3):  # lines
        run(capsys, *words)
        assert len(record.read_text().splitlines()) == n
