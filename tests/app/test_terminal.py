"""What the terminal shows: the verdict first, 80 columns, a look before the work, progress."""

import io
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest

from sklearn_raacmm import Arm, ArmResidualRegressor, learn_correction
from sklearn_raacmm.app import _terminal, main
from sklearn_raacmm.app._options import with_config
from sklearn_raacmm.datasets import make_single_point


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture(scope="module")
def result():
    """Of twenty positions with names that are longer than a line is wide."""
    test = make_single_point(20, 6, random_state=0)
    labels = np.array([f"{i:02d} {'in the corner ' * 6}" for i in test.groups])
    model = ArmResidualRegressor(orders=2, causes=["kinematics"])
    return learn_correction(test.nominal_arm, test.data, labels, model=model, cv=2)


def test_lines_are_as_wide_as_a_terminal(result, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "200")
    _terminal.print_verdict(result.verdict, result.helps)
    _terminal.print_scores(result.scores)
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 80
    assert " ".join(printed.split()).startswith(result.verdict)
    rows = re.findall(r"(?m)^(\d\d) .*\.\.\. +6 ", printed)
    worst = np.argsort(-result.scores.table["after"])[:12]
    assert rows == sorted(result.scores.table["position"][i][:2] for i in worst)
    assert "These are the 12 worst of 20; a report has all." in printed
    assert f"{result.scores.summary['after'][0]:.4f}" in printed


def test_a_narrow_terminal_breaks_sentences_but_no_rows(result, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "50")
    _terminal.print_scores(result.scores)
    printed = capsys.readouterr().out.splitlines()
    rows = [line for line in printed if re.match(r"\d\d .*\.\.\. ", line)]
    assert len(rows) == 12
    assert all(len(row.split()[-5:]) == 5 and row.count(".") >= 7 for row in rows)
    assert max(len(line) for line in printed[14:]) <= 50


@pytest.mark.parametrize(
    ("environment", "stream", "coloured"),
    [({}, Terminal, True), ({}, io.StringIO, False), ({"NO_COLOR": "1"}, Terminal, False)],
)
def test_colour_is_for_terminals(environment, stream, coloured, monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stdout", stream())
    _terminal.print_verdict("It helps.", True)
    printed = sys.stdout.getvalue()
    assert ("\x1b[32m" in printed) == coloured
    assert re.sub(r"\x1b\[\d+m", "", printed) == "It helps.\n\n"


def test_a_pipe_gets_whole_sentences(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    sentence = "word " * 40
    assert _terminal.filled(sentence, io.StringIO()) == sentence


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_progress_says_how_much_is_left(stream, monkeypatch):
    clock = iter([0.0, 10.0, 20.0, 30.0, *[40.0] * 9])
    monkeypatch.setattr(sys, "stderr", stream())
    monkeypatch.setattr(_terminal, "monotonic", lambda: next(clock))
    with _terminal.Progress(60) as progress:
        first = progress._line()
        progress(1, 3)  # a third of the folds, a quarter of the work, after ten seconds more
        third = progress._line()
    assert "calibrating, first folds, about 50 s left" in first
    # A bar is drawn when a fold is done, which takes one look at the clock more.
    left = "90 s" if stream is Terminal else "60 s"
    assert f"1 of 3 folds, about {left} left" in third.replace("2 min", "90 s")
    written = sys.stderr.getvalue()
    if stream is Terminal:
        assert "\r[" in first
        assert "1 of 3 folds" in written
        assert max(map(len, re.split("[\r\n]", written))) < 80
    else:  # a line a minute, and no minute has passed
        assert written == ""
        assert third.endswith("\n")
        assert "after 20 s" in third


@pytest.fixture
def folder(tmp_path):
    arm = Arm.from_name("ur10")
    arm.to_json(tmp_path / "arm.json")
    angles = np.rad2deg(np.random.default_rng(0).uniform(-2, 2, (12, 6)))
    lines = ["cone,T1," + ",".join(f"q{i}" for i in range(1, 7))]
    lines += [f"{'ABC'[i % 3]},20.5," + ",".join(map(str, row)) for i, row in enumerate(angles)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


def test_a_look_before_the_work(folder, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    words = ["learn", folder / "log.csv", "--arm", folder / "arm.json", "--out", folder / "out"]
    words += ["--extra", "temperature=T1", "--dry-run", "--folds", "3"]
    assert main(list(map(str, words))) == 0
    printed, notes = capsys.readouterr()
    assert max(map(len, (printed + notes).splitlines())) <= 80 + len(str(folder))
    for sentence in (
        "Rows: 12, of",
        "joint 6: q6",
        "Positions: 3, with 4 rows each: A, B, C.",
        "Known lengths: none",
        "Causes: T1.",
        "calibration and correction, 3 times",
        "Nothing was written.",
    ):
        assert sentence in printed
    assert not (folder / "out").exists()
    assert main([*map(str, words), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["rows"], facts["positions"], facts["angle_unit"]) == (12, ["A", "B", "C"], "deg")
    assert facts["expected_seconds"] > 0


def test_options_stand_beside_the_tables(folder, capsys):
    (folder / "raacmm.toml").write_text(
        'arm = "arm.json"\nangles = ["q1", "q2", "q3", "q4", "q5", "q6"]\nunit = "deg"\n'
        'length = ["A:B:500:0.01", "B:C:300:0.01"]\nextra = ["temperature=T1"]\nfolds = 4\n'
        'record = "of check only"\n'
    )
    words = ["learn", str(folder / "log.csv"), "--out", str(folder / "out"), "--dry-run"]
    assert main([*words, "--folds", "3"]) == 0  # the command line counts more
    printed = capsys.readouterr().out
    for sentence in ("Known lengths: 2.", "Causes: T1.", "correction, 3 times"):
        assert sentence in printed
    assert with_config(["learn", "no.csv"]) == ["learn", "no.csv"]
    # Folders, too, are named as seen from the file; words that no place has stay as they are.
    (folder / "raacmm.toml").write_text('model = "out"\nunit = "out"\n')
    (folder / "out").mkdir()
    made = with_config(["check", str(folder / "log.csv")])
    assert made[1:3] == [f"--model={folder / 'out'}", "--unit=out"]
    for text, message in (
        ("agles = 3\n", "agles is no option of raacmm. Was angles meant"),
        ("a =", ""),
    ):
        (folder / "raacmm.toml").write_text(text)
        with pytest.raises(SystemExit):
            main(words)
        printed = capsys.readouterr().err
        assert "raacmm.toml: " in printed
        assert message in printed


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("raacmm reg", {"register"}),
        ("raacmm learn --points", {"--points", "--points-sd"}),
        ("raacmm learn --unit ", {"deg", "rad"}),
        ("raacmm check --h", {"--help"}),
    ],
)
def test_a_shell_completes_words_and_options(line, words, tmp_path):
    pytest.importorskip("argcomplete", reason="argcomplete is not installed")
    place = tmp_path / "answers"
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line))}
    asked["_ARGCOMPLETE_STDOUT_FILENAME"] = str(place)
    command = [sys.executable, "-m", "sklearn_raacmm"]
    subprocess.run(command, env=os.environ | asked, check=True)
    assert {answer.strip() for answer in place.read_text().split("\013")} == words
