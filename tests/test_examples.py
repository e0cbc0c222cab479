"""The gallery: each example is one file that runs alone, and shows what its text says."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import sklearn_raacmm.datasets as datasets
from sklearn_raacmm import calibrate
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

matplotlib = pytest.importorskip("matplotlib")
plt = pytest.importorskip("matplotlib.pyplot")
pytest.importorskip("pandas")
EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
# What makes a script quicker: fewer arms, fewer positions, no search of widths.
QUICKER = {
    "plot_real_arm": ("RBFNetRegressor())", "RBFNetRegressor(20, length_scale=2.0, alpha=0.1))"),
    "plot_live_arm": ("SECONDS = 1.0", "SECONDS = 0.05"),
}


@pytest.fixture
def run_alone(monkeypatch, tmp_path):
    """Return ``run_alone(name)``: run a copy of a script in an empty folder, as downloaded."""

    def small(n_positions=10, n_poses=100, **options):
        return make_single_point(n_positions, min(n_poses, 20), **options)

    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    pictures = []

    def show():
        for number in plt.get_fignums():
            plt.figure(number).canvas.draw()
        pictures.append(len(plt.get_fignums()))

    monkeypatch.setattr(plt, "show", show)
    monkeypatch.setattr(datasets, "make_single_point", small)

    def run(name):
        pictures.clear()
        script = tmp_path / f"{name}.py"
        text = (EXAMPLES / script.name).read_text(encoding="utf-8")
        slow, quick = QUICKER.get(name, ("", ""))
        assert slow in text
        script.write_text(text.replace(slow, quick), encoding="utf-8")
        return runpy.run_path(str(script), run_name="__main__"), pictures

    yield run
    plt.close("all")


def test_a_script_runs_alone_and_ends_in_its_pictures(run_alone, capsys):
    """`.ci/run doc` runs all of them, in full, and looks at their pages (``doc/check_site.py``)."""
    _, pictures = run_alone("plot_ols_path")
    assert len(pictures) == 1
    assert "auto: " in capsys.readouterr().out


@pytest.mark.exhaustive
def test_the_page_has_the_numbers_of_the_papers_experiment(monkeypatch, capsys):
    """To 2 micrometres, by which another processor's rounding may choose other centres."""
    monkeypatch.setattr(plt, "show", lambda: None)
    matplotlib.use("Agg")
    text = (EXAMPLES / "plot_paper_figures.py").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 80
    runpy.run_path(str(EXAMPLES / "plot_paper_figures.py"))
    printed = re.findall(r"^(\w+), before|: (\d+) -> (\d+) ", capsys.readouterr().out, re.M)
    page = (EXAMPLES.parent / "doc" / "paper_and_ours.md").read_text(encoding="utf-8")
    kinds = [i for i, (kind, *_) in enumerate(printed) if kind]
    assert len(kinds) == 3
    for i in kinds:
        (row,) = re.findall(rf"^\| {printed[i][0]} \| (\d.*→.*) \|$", page, re.M)
        found = np.array([one[1:] for one in printed[i + 1 : i + 5]], dtype=int)
        said = np.array([cell.split(" → ") for cell in row.split(" | ")], dtype=int)
        assert np.abs(found - said).max() <= 2


@pytest.mark.exhaustive
def test_real_arm(run_alone, monkeypatch, data_folder, capsys):
    """The number of the uncorrected arm is what the data's own page says."""
    monkeypatch.setenv("SCIKIT_LEARN_DATA", str(data_folder("panda_ball_socket").parent))
    page, pictures = run_alone("plot_real_arm")
    assert len(pictures) == 1
    assert "calibrated, uncorrected      mean 0.197 mm" in capsys.readouterr().out
    means = {name: values.mean() for name, (values, _) in page["rows"].items()}
    assert means["ArmResidualRegressor"] < 0.9 * means["calibrated, uncorrected"]


@pytest.mark.exhaustive
def test_own_csv_is_corrected(monkeypatch, capsys):
    """What the page prints of its file is what the arrays, never written, give."""
    monkeypatch.setattr(plt, "show", lambda: None)
    matplotlib.use("Agg")
    page = runpy.run_path(str(EXAMPLES / "plot_own_csv.py"))
    data = make_single_point(10, 30, random_state=0)
    np.testing.assert_allclose(np.deg2rad(page["angles"]), data.data, atol=1e-8)
    expected = calibrate(page["nominal"], data.data, data.groups).arm.forward(data.data)
    learned = page["learned"]
    np.testing.assert_allclose(learned.arm.forward(data.data), expected, atol=1e-4)
    after = single_point_repeatability(learned.scores.left_after, data.groups)
    assert after < 0.75 * single_point_repeatability(expected, data.groups)
    output = capsys.readouterr().out
    assert learned.verdict in output
    assert f"mean 2S after: {after:.4f} mm" in output
    assert page["display"].after.mean() == pytest.approx(after)
    assert len(plt.get_fignums()) == 1


@pytest.mark.exhaustive
def test_live_arm(run_alone, capsys):
    page, pictures = run_alone("plot_live_arm")
    output = capsys.readouterr().out
    rows = [line.split() for line in output.splitlines()]
    table = {row[0]: row for row in rows if row and row[0] in ("predict", "ONNX", "C,")}
    assert ("ONNX" in table) != ("ONNX is left out" in output)
    assert ("C," in table) != ("C is left out" in output)
    for row in table.values():
        assert float(row[-1]) < 1e-12  # mm from what predict says
        median, slow = map(float, row[-4:-2])
        assert 0 < median <= slow
    # Training poses are known, and on the way out of them the model gives up.
    given_up = re.search(r"stays uncorrected: (\d+)% of the way", output)
    assert 0 < int(given_up[1]) < 100
    assert not page["refused"][0]
    assert page["refused"][-1]
    assert len(pictures) == 1
