"""The word `watch`: a growing table, its slips and wrong labels, and what stops it."""

import threading
import time

import numpy as np
import pytest

from sklearn_raacmm.app import Table, _watch, main
from sklearn_raacmm.app._report import render
from sklearn_raacmm.datasets import make_single_point

pytest.importorskip("jinja2")


@pytest.fixture(scope="module")
def test():
    """A test of seven cones, of which one row slipped by 1 mm and one has another cone's label."""
    data = make_single_point(7, 12, random_state=4)
    angles, labels = data.data.copy(), data.groups + 1
    beside = data.nominal_arm.forward(angles[50:51]) + np.array([0.6, -0.6, 0.5])
    angles[50] = data.nominal_arm.solve(beside, angles[50:51])[0][0]
    labels[65] = 2
    return data.nominal_arm, angles, [f"cone {label}" for label in labels]


def as_table(angles, labels):
    return Table(angles, "rad", np.array(labels), None, np.arange(len(angles)))


def lines(angles, labels):
    yield "cone," + ",".join(f"q{i} [deg]" for i in range(1, 7)) + "\n"
    for label, row in zip(labels, np.rad2deg(angles), strict=True):
        yield ",".join([label, *(f"{value:.6f}" for value in row)]) + "\n"


@pytest.mark.filterwarnings("ignore::sklearn_raacmm.FindingWarning")
def test_each_wrong_row_is_named_within_two_rows(test):
    """Row by row, as the arm's logger writes them, without a clock."""
    arm, angles, labels = test
    seen, first = _watch._Seen(arm, None), {}
    for n in range(45, len(angles) + 1):
        seen.take(as_table(angles[:n], labels[:n]))
        for row, text in seen.wrong:
            first.setdefault(row, (n - 1, text))
    assert set(first) == {"row 50 (cone 5)", "row 65 (cone 2)"}
    n, text = first["row 50 (cone 5)"]
    assert n <= 52
    assert "is 1." in text or "is 0." in text
    n, text = first["row 65 (cone 2)"]
    assert n <= 67
    assert "is where cone 6 is" in text


@pytest.mark.parametrize("n", [1, 2, 3])
def test_the_page_of_the_first_rows(test, n):
    arm, angles, labels = test
    seen = _watch._Seen(arm, None)
    seen.take(as_table(angles[:n], labels[:n]))
    page = render("_watch.html", **vars(seen), title="cone.csv", time="12:00:00")
    assert page.count('width="7"') == n


def test_the_page_of_a_growing_table(test, tmp_path, monkeypatch, capsys, read_page):
    """It only reads the table, waits for the end of a line, and stops after a silence."""
    arm, angles, labels = test
    monkeypatch.setattr(_watch, "_SILENCE_S", 3.0)
    monkeypatch.setattr(_watch, "_SHARE", 0.9)
    arm.to_json(tmp_path / "arm.json")
    table, page = tmp_path / "cone.csv", tmp_path / "watch.html"
    text = list(lines(angles, labels))

    def measure():
        with open(table, "w", encoding="utf-8") as file:
            for part in ["".join(text[:20]), "".join(text[20:])]:
                file.write(part[:-30])
                file.flush()
                time.sleep(0.3)
                file.write(part[-30:])
                file.flush()
                time.sleep(0.3)

    thread = threading.Thread(target=measure)
    thread.start()
    words = ["watch", table, "--arm", tmp_path / "arm.json", "--out", page]
    assert main([str(word) for word in words]) == 0
    thread.join()
    assert table.read_text(encoding="utf-8") == "".join(text)
    printed = capsys.readouterr().out
    assert printed.count(" row ") == 2
    assert "84 rows in 7 cones. At cones that it has not seen" in printed
    found = read_page(page.read_text(encoding="utf-8"))
    assert "cone.csv: 84 rows in 7 cones" in "".join(found.text)
    assert found.links == []


def test_a_correction_in_use_is_checked(test, tmp_path):
    arm, angles, labels = test
    asked = []

    class Saved:
        model = type("Model", (), {"predict": staticmethod(lambda X: np.zeros((len(X), 3)))})
        inputs = staticmethod(lambda X: X)

        @staticmethod
        def check(angles, codes):
            asked.append((len(angles), len(np.unique(codes))))
            return type("Found", (), {"holds": True})

    seen = _watch._Seen(arm, Saved)
    seen.take(as_table(angles, labels))
    enough, said = seen._tried(angles[:24], np.repeat([0, 1], 12))
    assert enough
    assert said == "Checked with 24 poses in 2 cones: it holds."
    assert asked == [(24, 2)]


def test_rows_that_no_calibration_explains_are_judged_all_the_same(test, monkeypatch):
    def refuse(*_, **__):
        raise ValueError("They belong to another table.")

    monkeypatch.setattr(_watch, "calibrate", refuse)
    monkeypatch.setattr(_watch, "learn_correction", refuse)
    arm, angles, labels = test
    seen = _watch._Seen(arm, None)
    seen.take(as_table(angles, labels))
    assert seen.arm is arm
    assert "row 65 (cone 2)" in dict(seen.wrong)
    # A wrong table is told, too, where a correction is tried.
    assert seen._tried(angles, seen._codes) == (False, "They belong to another table.")


def test_which_arm_it_is_has_to_be_said(refused, tmp_path):
    refused("say which arm it is", "watch", tmp_path / "cone.csv")
