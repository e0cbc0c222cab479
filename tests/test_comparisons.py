"""The long comparisons run, small, and print what the package says of the same data."""

import functools
import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from sklearn.utils import Bunch

from sklearn_raacmm import Arm, calibrate, position_residuals
from sklearn_raacmm.datasets import make_single_point
from sklearn_raacmm.metrics import single_point_repeatability

matplotlib = pytest.importorskip("matplotlib")
plt = pytest.importorskip("matplotlib.pyplot")
pytest.importorskip("pandas")
SCRIPTS = Path(__file__).resolve().parent.parent / "benchmarks"
PNG = b"\x89PNG"
OURS = ("_comparison", "real_arm", "real_tracker", "simulated_arm")


@pytest.fixture
def example(monkeypatch, tmp_path):
    """Return ``example(name)``: the module of an example, as though run from its folder."""
    monkeypatch.syspath_prepend(SCRIPTS)
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    yield importlib.import_module
    plt.close("all")
    for name in [name for name in sys.modules if name in OURS]:
        del sys.modules[name]


def cells(output, *start):
    """Numbers of the first line of a table that starts with these words."""
    for line in output.splitlines():
        texts = [text for text in line.split("  ") if text]
        if tuple(text.strip() for text in texts[: len(start)]) == start:
            return [float(text.strip().rstrip("%")) for text in texts[len(start) :]]
    raise AssertionError(f"no line starts with {start}:\n{output}")


def test_simulated_arm(example, capsys):
    example("simulated_arm").main(["--positions", "4", "--poses", "12", "--jobs", "1"])
    output = capsys.readouterr().out

    data = make_single_point(4, 12)
    before = single_point_repeatability(data.points, data.groups, aggregate=None)
    uncorrected = cells(output, "-", "uncorrected")
    assert uncorrected[:2] == pytest.approx([before.mean(), before.max()], abs=1e-4)
    floor = cells(output, "-", "perfect model")
    assert floor[0] < 0.5 * before.mean()
    assert floor[3:] == [100, *floor[4:]]
    assert [cells(output, str(i + 1))[1] for i in range(4)] == pytest.approx(before, abs=1e-4)
    for inputs in ("pose angles", "all joints, cos and sin"):
        for regressor in ("polynomial ridge", "Gaussian process", "RBF network"):
            mean, _, less, share, *_ = cells(output, inputs, regressor)
            assert less == pytest.approx(100 * (1 - mean / before.mean()), abs=1)
            gain = (before.mean() - mean) / (before.mean() - floor[0])
            assert share == pytest.approx(100 * gain, abs=1)
    assert Path("simulated_arm.png").read_bytes().startswith(PNG)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--positions 2", "at least 3 to hold one out, got 2"),
        ("--poses 1", "n_poses must be a whole number of at least 2, got 1"),
        ("--output nowhere/figure.png", "no such folder"),
        ("--output figure.pngg", "figure.pngg must end in one of"),
    ],
)
def test_simulated_arm_refuses_before_the_work(example, capsys, arguments, message):
    with pytest.raises(SystemExit, match="2"):
        example("simulated_arm").main(arguments.split())
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("name", ["real_arm", "real_tracker"])
def test_without_data_says_where_to_get_them(example, tmp_path, name, monkeypatch):
    module = example(name)
    fetch = "fetch_panda_ball_socket" if name == "real_arm" else "fetch_ur10_tracker"
    offline = functools.partial(getattr(module, fetch), download_if_missing=False)
    monkeypatch.setattr(module, fetch, offline)
    with pytest.raises(SystemExit, match=r"(?s)elsewhere.*is not there.*github"):
        module.main(["--data-home", str(tmp_path / "elsewhere")])


@pytest.mark.parametrize("name", ["simulated_arm", "real_arm", "real_tracker"])
def test_no_processes_are_refused(example, capsys, name):
    with pytest.raises(SystemExit, match="2"):
        example(name).main(["--jobs", "0"])
    assert "--jobs: 0 processes cannot work" in capsys.readouterr().err


@pytest.fixture
def few_rows(panda):
    """Three placements of panda_3, the first twelve rows of every socket, as fetched."""
    data = panda("panda_3")
    some = []
    for placement in ("backleft", "frontcenter", "frontright"):
        for hole in (0, 1):
            some.append(np.flatnonzero(data.groups == f"{placement}/{hole}")[:12])
    some = np.concatenate(some)
    placements = data.placements[some]
    return Bunch(
        data=data.angles[some],
        groups=data.groups[some],
        placements=placements,
        lengths=[(f"{p}/0", f"{p}/1", 50, 0.1) for p in np.unique(placements)],
        nominal_arm=Arm.from_name("panda", probe=(0, 0, 241)),
    )


def test_real_arm(example, capsys, few_rows, monkeypatch):
    module = example("real_arm")
    data = few_rows
    monkeypatch.setattr(module, "fetch_panda_ball_socket", lambda arm, data_home: data)
    module.main(["--jobs", "1"])
    output = capsys.readouterr().out
    left_out = []
    for placement in np.unique(data.placements):
        train = data.placements != placement
        known = [(f"{p}/0", f"{p}/1", 50, 0.1) for p in np.unique(data.placements[train])]
        nominal = Arm.from_name("panda", probe=(0, 0, 138))
        arm = calibrate(nominal, data.data[train], data.groups[train], lengths=known).arm
        y = position_residuals(arm.forward(data.data[~train]), data.groups[~train])
        left_out.append(np.linalg.norm(y, axis=1))
        assert cells(output, placement)[2] == pytest.approx(left_out[-1].mean(), abs=1e-3)
    everything = np.concatenate(left_out)
    mean, largest, *_ = cells(output, "-", "uncorrected")
    assert (mean, largest) == pytest.approx((everything.mean(), everything.max()), abs=1e-3)
    for inputs in ("pose angles", "all joints, cos and sin"):
        assert len(cells(output, inputs, "RBF network")) == 7
    assert Path("real_arm.png").read_bytes().startswith(PNG)


def test_real_tracker(example, capsys, ur10, monkeypatch):
    module = example("real_tracker")
    some = np.isin(ur10.groups, np.arange(0, 619, 40))
    data = Bunch(
        data=ur10.angles[some],
        tracker_points=ur10.points[some],
        groups=np.unique(ur10.groups[some], return_inverse=True)[1],
        nominal_arm=Arm.from_name("ur10", probe=(0, 0, 93)),
    )
    monkeypatch.setattr(module, "fetch_ur10_tracker", lambda data_home: data)
    module.main(["--gp-rows", "60", "--folds", "2", "--jobs", "1"])
    output = capsys.readouterr().out
    assert f"{some.sum()} poses at 16 goal positions" in output
    mean, high, largest, *_ = cells(output, "-", "uncorrected")
    assert 0.2 < mean < high < largest < 3
    for inputs in ("pose angles", "all joints, cos and sin"):
        assert len(cells(output, inputs, "RBF network")) == 7
    assert Path("real_tracker.png").read_bytes().startswith(PNG)
