"""The page of the month: its commands run, and the command says what the page names."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from sklearn_raacmm import ArmResidualRegressor, learn_correction
from sklearn_raacmm.app import main
from sklearn_raacmm.datasets import SimulatedArm, make_single_point

pytest.importorskip("jinja2")
pytest.importorskip("skops")
pytest.importorskip("matplotlib")

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "doc" / "month.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^raacmm .*$", PAGE, flags=re.MULTILINE)
# Rows of its tables: the cells before what to do.
ANSWERS = [
    [re.findall(r'"([^"]+)"', cell) or cell.strip() for cell in line.strip("|").split("|")[:-1]]
    for line in re.findall(r"^\| .*$", PAGE, flags=re.MULTILINE)
]
MACHINE = SimulatedArm("typical", random_state=1)
KNOCK = np.deg2rad(60 / 3600) * np.eye(6)[1]


def operator(name, seed, knock=0.0, probe=None, slip=None, machine=MACHINE):
    """Write what the arm shows in six cones, two of them the seats of a bar."""
    test = make_single_point(4, 10, bars=[500], machine=machine, random_state=seed)
    angles = test.data + knock
    if probe is not None:  # what the longer probe shows at the same points
        longer = test.arm.replace(probe=test.arm.probe + probe)
        angles = longer.solve(test.arm.forward(angles), angles)[0]
    if slip is not None:
        beside = test.arm.forward(angles[slip : slip + 1]) + np.array([0.6, -0.6, 0.5])
        angles[slip] = test.arm.solve(beside, angles[slip : slip + 1])[0][0]
    names = [*(f"cone {i}" for i in range(1, 5)), "bar left", "bar right"]
    rows = ["cone," + ",".join(f"q{i} [deg]" for i in range(1, 7))]
    for label, row in zip(test.groups, np.rad2deg(angles), strict=True):
        rows.append(",".join([names[label], *(f"{value:.6f}" for value in row)]))
    Path(name).write_text("\n".join(rows) + "\n", encoding="utf-8")


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    test = make_single_point(10, 20, bars=[500], machine=MACHINE, random_state=1)
    model = ArmResidualRegressor(orders=4)
    found = learn_correction(
        test.nominal_arm, test.data, test.groups, model=model, lengths=test.lengths, cv=2
    )
    folder = tmp_path_factory.mktemp("month")
    found.save(folder / "my_arm")
    return folder


@pytest.fixture
def said(learnt, monkeypatch, capsys):
    """What runs a command of the page, and returns its exit code and all that it says."""
    monkeypatch.chdir(learnt)

    def run(word, *more):
        (command,) = (line for line in COMMANDS if line.split()[1] == word)
        words = shlex.split(command)[1:]
        if "--length" in words:
            words[words.index("--length") + 1] = "bar left:bar right:500:0.01"
        code = main([*words, *more])
        printed = capsys.readouterr()
        return code, printed.out + printed.err

    return run


def named(code, answer, word="check"):
    """Whether the page has a row of this exit code for the answer of a word of the command."""
    rows = [row for row in ANSWERS if len(row) == (3 if word != "check" else 2)]
    rows = [row[1:] for row in rows if row[0] == word] if word != "check" else rows
    return any(
        str(code) in codes and any(one.split(": row")[0] in answer for one in answers)
        for codes, answers in rows
        if isinstance(answers, list)
    )


def test_a_month_without_and_with_a_change(said, monkeypatch):
    from sklearn_raacmm.app import _watch

    assert said("plan")[0] == 0
    monkeypatch.setattr(_watch, "_SILENCE_S", 0.5)
    operator("today.csv", 11)
    assert said("watch")[0] == 0
    code, text = said("check")
    assert (code, named(code, text)) == (0, True)
    assert "It holds" in Path("my_arm/report.html").read_text(encoding="utf-8")
    operator("today.csv", 12, slip=7)
    code, text = said("check")
    assert named(code, text)
    assert "slipped: row 9" in text
    operator("today.csv", 13, knock=KNOCK)
    code, text = said("check")
    assert (code, named(code, text)) == (3, True)
    code, text = said("update")
    assert (code, named(code, text, "update")) == (0, True)
    operator("today.csv", 14, knock=KNOCK)
    code, text = said("check")
    assert (code, named(code, text)) == (0, True)
    Path("today.csv").write_text("cone,q1\nA,1\n", encoding="utf-8")
    assert said("check")[0] == 2
    assert len(Path("checks.csv").read_text(encoding="utf-8").splitlines()) == 5


def test_another_probe_and_another_arm(said):
    operator("today.csv", 15, probe=np.array([0, 0, 30.0]), knock=KNOCK)
    code, text = said("check")
    assert code == 3
    assert "run raacmm register" in text
    code, text = said("register")
    assert (code, named(code, text, "register")) == (0, True)
    operator("today.csv", 16, machine=SimulatedArm("typical", random_state=9))
    code, text = said("check")
    assert code == 3
    assert named(code, text)


def test_every_answer_of_the_page_is_one_of_the_program():
    sources = "".join(path.read_text(encoding="utf-8")
                      for folder in ("app", "correction")
                      for path in (ROOT / "sklearn_raacmm" / folder).glob("*.py"))  # fmt: skip
    sources = re.sub(r'"\s*\n\s*f?"', "", sources)  # sentences go on in the next line
    answers = [one.split(": row")[0] for row in ANSWERS for cell in row
               if isinstance(cell, list) for one in cell]  # fmt: skip
    assert len(answers) > 10
    assert [answer for answer in answers if answer not in sources] == []
