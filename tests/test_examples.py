"""The gallery: each example is one file that runs alone, and shows what its text says."""

import runpy
from pathlib import Path

import pytest

import sklearn_raacmm.datasets as datasets
from sklearn_raacmm.datasets import make_single_point

matplotlib = pytest.importorskip("matplotlib")
plt = pytest.importorskip("matplotlib.pyplot")
pytest.importorskip("pandas")
EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
# Pictures of each script, and what it prints.
SHOWN = {
    "plot_after_the_lab": (2, "week 7, suspect: harmonics of joint 2"),
    "plot_grid_search": (1, "predictions in the other process: equal"),
    "plot_how_many_poses": (1, "poses"),
    "plot_learn_correction": (1, "It repeats better at new positions"),
    "plot_live_arm": (1, "stays uncorrected: "),
    "plot_newrb": (1, "neurons, mean squared error"),
    "plot_ols_path": (1, "auto: "),
    "plot_own_csv": (1, "It repeats better at new positions"),
    "plot_paper_figures": (3, ""),
    "plot_periodicity": (1, "periodic"),
    "plot_rbf_network": (1, "2-D"),
    # What the page of these data says of the uncorrected arm.
    "plot_real_arm": (1, "calibrated, uncorrected      mean 0.197 mm"),
    "plot_simulated_arm": (1, "noise floor"),
}

# `.ci/run doc` runs all of them, in full.
QUICK = ("plot_newrb", "plot_ols_path", "plot_rbf_network")
# What makes a script quicker: fewer arms, fewer positions, no search of widths.
QUICKER = {
    "plot_grid_search": (
        "[RBFNetRegressor(random_state=0)]",
        "[RBFNetRegressor(20, length_scale=2.0, alpha=0.1)]",
    ),
    "plot_how_many_poses": ("SEEDS = [0, 1]", "SEEDS = [0]"),
    "plot_paper_figures": ("n_positions=10", "n_positions=5"),
    "plot_real_arm": ("RBFNetRegressor())", "RBFNetRegressor(20, length_scale=2.0, alpha=0.1))"),
    "plot_live_arm": ("SECONDS = 1.0", "SECONDS = 0.05"),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n in QUICK else pytest.mark.exhaustive) for n in sorted(SHOWN)],
)
def test_a_script_runs_alone_and_ends_in_its_pictures(
    name, monkeypatch, tmp_path, capsys, data_folder
):
    """A copy of the script runs in an empty folder, as downloaded, on fewer poses."""
    pictures, (n_pictures, printed) = [], SHOWN[name]

    def small(n_positions=10, n_poses=100, **options):
        return make_single_point(n_positions, min(n_poses, 20), **options)

    def show():
        for number in plt.get_fignums():
            plt.figure(number).canvas.draw()
        pictures.append(len(plt.get_fignums()))
        plt.close("all")

    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plt, "show", show)
    monkeypatch.setattr(datasets, "make_single_point", small)
    if name == "plot_real_arm":
        folder = data_folder("panda_ball_socket").parent
        monkeypatch.setenv("SCIKIT_LEARN_DATA", str(folder))
    script = tmp_path / f"{name}.py"
    text = (EXAMPLES / script.name).read_text(encoding="utf-8")
    slow, quick = QUICKER.get(name, ("", ""))
    assert slow in text
    script.write_text(text.replace(slow, quick), encoding="utf-8")
    runpy.run_path(str(script), run_name="__main__")
    assert sum(pictures) == n_pictures
    assert printed in capsys.readouterr().out
