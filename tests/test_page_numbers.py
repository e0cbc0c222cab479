"""A sample of the numbers on the pages, computed again: what is written is what comes out."""

import json
import re
import runpy
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from sklearn_raacmm import Arm, RBFNetRegressor, calibrate, position_residuals
from sklearn_raacmm.datasets import ArmErrors, make_single_point

ROOT = Path(__file__).resolve().parent.parent
DOC = ROOT / "doc"
NUMBER = r"(-?\d+(?:\.\d+)?)"
TABLE = re.compile(r"^\|.*\n\|[-|: ]+\|\n(?:\|.*\n)+", re.MULTILINE)
DAY = r"20\d\d-\d\d-\d\d"


def numbers(page, pattern):
    """Numbers of a page where the pattern has an @, which has to be there once."""
    text = (DOC / page).read_text(encoding="utf-8")
    made = runpy.run_path(str(DOC / "_results.py"))["substitutions"]()
    text = re.sub(r"\{\{ (\w+) \}\}", lambda found: made[found[1]], text)
    text = re.sub(r"\s+", " ", text)
    (found,) = re.findall(re.escape(pattern).replace("@", NUMBER), text)
    return [float(number) for number in ([found] if isinstance(found, str) else found)]


def assert_said(page, pattern, values, rel=0.02):
    """What is said is the value, to a relative tolerance or to the last digit that is written."""
    said = numbers(page, pattern)
    assert len(said) == len(values)
    np.testing.assert_allclose(said, values, rtol=rel, err_msg=f"{page}: {pattern}")


def measured_tables(text):
    """Where tables of a page begin and end of which half of the cells are numbers."""
    for table in TABLE.finditer(text):
        rows = [row.strip("| ").split("|") for row in table[0].splitlines()[2:]]
        cells = [cell.strip() for row in rows for cell in row[1:] if cell.strip()]
        if 2 * sum(bool(re.match(r"[-+<]?\d", cell)) for cell in cells) > len(cells):
            yield table.start(), table.end()


def geometric_means(rows):
    """Geometric mean of each column."""
    return np.exp(np.mean(np.log([*rows]), axis=0))


def test_every_measured_table_says_when_and_by_which_command():
    """It comes from a file of results, or is history of the log, whose line below has the commit.

    The three tables of "The paper's experiment and ours" have tests of their own.
    """
    made = runpy.run_path(str(DOC / "_results.py"))["substitutions"]()
    for name, table in made.items():
        if name.startswith("table_"):
            assert re.search(rf"\n\n\*Measured on {DAY}(?: to {DAY})?\.\*$", table), name
    typed = []
    for page in (*DOC.glob("*.md"), *DOC.glob("user_guide/*.md")):
        text = page.read_text(encoding="utf-8")
        typed += [page.name for _ in measured_tables(text)]
        if page.name != "log.md":
            continue
        for start, end in measured_tables(text):
            below = rf"\n\*Measured on {DAY}, at [0-9a-f]{{8}}\.\*\n|\nx86_64, .*{DAY}"
            assert re.match(below, text[end:]), text[start:end]
            section = text[text.rindex("\n#", 0, start) :]
            section = section[: section.find("\n#", 1)]
            assert re.search(r"bench_\w+\.py|by a trial", section), text[start:end]
    others = Counter(typed)
    assert others.pop("log.md") > 10
    assert others == {"paper_and_ours.md": 2, "maintenance.md": 2}


def test_versions_and_counts_of_checks_are_those_of_the_project():
    page = (DOC / "maintenance.md").read_text(encoding="utf-8")
    needs = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    oldest = dict(re.findall(r"^\| ([\w-]+) \| ([\d.]+) \| [\d.]+ \| .* \|$", page, re.MULTILINE))
    assert len(oldest) == 4
    assert f'requires-python = ">={oldest.pop("Python")}"' in needs
    for name, version in oldest.items():
        assert f'"{name.lower()}>={version}"' in needs
    checks = (ROOT / "tests" / "test_common.py").read_text(encoding="utf-8")
    counts = re.findall(r"^\| `(\w+)` \| (\d+) \| (\d+) \| (\d+) \|$", page, re.MULTILINE)
    assert len(counts) == 4
    for name, *numbers_of_checks in counts:
        assert f'"{name}": ({", ".join(numbers_of_checks)})' in checks


def test_figures_show_the_numbers_of_today(script):
    """Else ``python doc/draw_benchmarks.py`` has to draw them again."""
    pytest.importorskip("matplotlib")
    drawn = script("draw_benchmarks")
    measured = json.loads(drawn.BENCHMARKS.read_text(encoding="utf-8"))
    for name, (_, _, shown) in drawn.FIGURES.items():
        picture = (DOC / "images" / f"bench_{name}.svg").read_text(encoding="utf-8")
        assert drawn.digest(shown, measured, drawn.read()) in picture, name


def test_sentences_on_the_network_follow_from_their_file(script):
    measured = json.loads((DOC / "benchmarks.json").read_text(encoding="utf-8"))
    problems, page = measured["problems"], "benchmarks.md"
    error = problems["over_gaussian_process"]["of"]
    means = geometric_means(values for name, values in error.items() if name != "periodic3")
    assert_said(page, "(@ to @ of its error", [min(means), max(means)], 0.005)
    seconds = problems["cpu_seconds_network_and_process"]
    share = geometric_means(np.divide(*np.transpose(every)) for every in seconds["of"].values())
    assert share[0] == pytest.approx(1 / 4, rel=0.1)  # "a quarter of the time"
    assert_said(page, "at 300 rows, and 1/@ at 3000", [1 / share[-1]], 0.1)
    large = [one["cpu_seconds"] for one in measured["rows"]["found_by_itself"]]
    assert_said(page, "time grows from @ to @ s", [large[0], large[-1]], 0.05)
    peers = problems["peers_over_network_300_rows"]
    perceptron = peers["of"]["kinks2"][peers["peers"].index("perceptron")]
    assert_said(page, "A perceptron left @ of the error on", [perceptron])
    tables = measured["tables"]
    over = script("draw_benchmarks").over_the_network(measured)
    means = {name: geometric_means(ratios[:, None])[0] for name, ratios in over.items()}
    row = list(tables["error"]).index("wooldridge/return")
    assert_said(page, "extra trees @ on", [over["extra trees"][row]])
    (best,) = geometric_means(np.min(list(over.values()), axis=0)[:, None])
    assert_said(
        page, "of the five peers which turns out to be best on a table leaves @ times", [best]
    )
    said = ["KernelRidge", "gradient boosting", "extra trees", "linear ridge"]
    pattern = "kernel ridge @, boosting @, extra trees @, linear ridge @."
    assert_said("log.md", pattern, [means[name] for name in said], 0.003)
    pattern = "extra trees left @ of the deviation, the network @, a linear ridge @."
    found = dict(zip(tables["regressors"], tables["error"]["wooldridge/return"], strict=True))
    named = ["extra trees", "RBFNet", "linear ridge"]
    assert_said("log.md", pattern, [found[name] for name in named])


def test_times_of_one_row_in_the_figure_are_those_of_the_log():
    measured = json.loads((DOC / "benchmarks.json").read_text(encoding="utf-8"))["one_row"]
    text = (DOC / "log.md").read_text(encoding="utf-8")
    table = text[text.index("| \u00b5s per row |") :]
    ways = {"predict": "`predict`, one row per call", "ONNX": "ONNX, one row per call",
            "load_c": "`load_c`, one row per call", "C, gcc -O2": "C, gcc -O2"}  # fmt: skip
    for way, row in ways.items():
        cells = re.search(rf"^\| {row} \| (.*) \|$", table, re.MULTILINE)[1].split(" | ")
        times = [measured["microseconds"][model][way] for model in measured["microseconds"]]
        assert times == [float(cells[0]), float(cells[2])]
    assert_said("log.md", "bare `Ridge` @ \u00b5s", [measured["ridge_predict"]])


def test_reductions_of_length_errors_are_those_of_the_log():
    text = (DOC / "log.md").read_text(encoding="utf-8")
    cells = re.findall(r"^\| sim-\w+ \|.*% \| ([\d.]+), ([\d.]+), ([\d.]+) \|$", text, re.MULTILINE)
    before, model, known = np.array(cells, dtype=float).T
    assert len(before) == 3
    less = [100 * (1 - left / before) for left in (model, known)]
    ranges = [end for share in less for end in (share.min(), share.max())]
    assert_said("log.md", "takes @ to @ % off the error of 500 mm gauges", ranges[:2], 0.01)
    assert_said("log.md", "known to 3 \u00b5m, it is @ to @ %", ranges[2:], 0.01)
    pattern = "Length errors shrink by @ to @ %, and by @ to @ %"
    assert_said("beyond_the_paper.md", pattern, ranges, 0.01)


def test_reductions_of_the_paper_follow_from_its_millimetres():
    page = "paper_and_ours.md"
    for row in ("| @ / @ | @ / @ | 22.5 % / 15 % |", "| @ / @ | @ / @ | 50 % / 55.5 % |",
                "| @ / @ | @ / @ | 51.1 % / 49.1 % |"):  # fmt: skip
        before, after = np.reshape(numbers(page, row), (2, 2))
        less = 100 * (1 - after / before)
        said = [float(number) for number in re.findall(NUMBER, row)]
        np.testing.assert_allclose(said, less, atol=0.06)
    spread = numbers(page, "| 46 / @ | 23 /")[0], numbers(page, "| 45 / @ | 22 /")[0]
    assert_said(page, "only @ to @ times their mean", [46 / spread[0], 45 / spread[1]], rel=0.03)
    errors = np.abs(np.random.default_rng(0).standard_normal((20_000, 10)))
    often = np.mean(errors.max(axis=1) / errors.mean(axis=1))
    assert_said(page, "have about @ times", [often], rel=0.1)


def test_numbers_of_geometry_and_of_the_normal_distribution():
    arc_second = np.deg2rad(1 / 3600)
    assert_said("user_guide/limits.md", "at one metre is @ micrometres", [1e6 * arc_second], 1e-3)
    median = scipy.stats.chi.ppf(0.5, 3)
    assert_said("numerics.md", "is @ standard deviations of a coordinate", [median], 1e-4)
    scale = 0.1 / 50 / np.sqrt(5)
    assert_said("log.md", "to @ %, which is @ mm at 270 mm", [100 * scale, 270 * scale])


def test_links_that_are_short_by_one_share_carry_it_to_lengths():
    page = "user_guide/lengths.md"
    shares = 1000 * np.array([0.7 / 750.7, 0.6 / 500.6])  # mm in 1 m
    error, over_sd = numbers(page, "750 and 500 for 750.7 and 500.6: both 0.1 % short | @ | @ |")
    assert shares.min() < error < 1.1 * shares.max()
    drawing, over_drawing = numbers(page, "off by 0.1 to 0.7 mm at random | @ | @ |")
    # `scale_sd` is that of the drawing: it cannot know.
    assert error / over_sd == pytest.approx(drawing / over_drawing, rel=0.15)


def test_a_step_of_ols_lowers_the_error_more_than_one_of_omp():
    rng = np.random.default_rng(0)
    X = rng.uniform(-2, 2, (60, 1))
    y = np.sin(3 * X[:, 0]) + 0.05 * rng.standard_normal(60)
    columns = np.exp(-((X - X.T) ** 2) / (2 * 0.5**2))
    chosen = RBFNetRegressor(4, length_scale=0.5, alpha=0).fit(X, y).center_indices_.tolist()

    def left(some):
        A = np.column_stack([np.ones(60), columns[:, some]])
        return y - A @ np.linalg.lstsq(A, y, rcond=None)[0]

    centred = columns - columns.mean(axis=0)
    by_omp = np.argmax(np.abs(left(chosen) @ centred) / np.linalg.norm(centred, axis=0))
    errors = [np.sum(left([*chosen, j]) ** 2) for j in range(60)]
    assert errors[by_omp] > 1.5 * min(errors)  # of columns that overlap, as the page says


def test_the_simulated_joint_lags_as_is_said():
    test = make_single_point(10, 20, machine=ArmErrors(play_arcsec=6), random_state=0)
    readings = np.zeros((1, 6))
    machine = test.simulation.machine
    forth, back = (machine.forward(readings, directions=side * np.eye(6)[:1]) for side in (1, -1))
    radius = np.hypot(*machine.forward(readings)[0, :2])
    lag = np.rad2deg(np.linalg.norm(forth - back) / radius / 2) * 3600
    assert_said("user_guide/extra_causes.md", "arm was made with @.", [lag])


def test_numbers_of_the_real_data(panda, ur10, data_folder):
    said = numbers("evidence.md", "of the socket, all @ poses")
    data = panda("panda_3")
    assert said == [len(data.angles)]
    authors = json.loads((DOC / "results.json").read_text(encoding="utf-8"))["authors"]["ours"]
    arm = calibrate(Arm.from_name("panda"), data.angles, data.groups).arm
    left = np.linalg.norm(position_residuals(arm.forward(data.angles), data.groups), axis=1)
    assert left.mean() == pytest.approx(authors["mean_mm"], rel=0.02)
    assert left.max() == pytest.approx(authors["max_mm"], rel=0.02)
    text = (DOC / "after_the_lab.md").read_text(encoding="utf-8")
    assert f"{len(ur10.angles):,} poses".replace(",", " ") in text
