"""The report: every number in it is one of the result's, and it needs no network."""

import re

import numpy as np
import pytest
from sklearn.linear_model import Ridge

from sklearn_raacmm import ArmResidualRegressor, learn_correction
from sklearn_raacmm.app import write_report
from sklearn_raacmm.datasets import make_gauge, make_single_point

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def result():
    data = make_gauge(400, n_placements=6, n_poses=12, random_state=3)
    lengths = [(int(a), int(b), 400.0, 0.01) for a, b in data.pairs]
    angles = data.data.copy()
    angles[17, 2] += 0.004
    model = ArmResidualRegressor(orders=4, causes=["kinematics"])
    return learn_correction(
        data.nominal_arm, angles, data.groups, lengths=lengths, model=model, cv=2
    )


@pytest.fixture(scope="module")
def page(result, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    facts = {"serial number": "<17>"}
    text = write_report(result, path, facts=facts, row_numbers=np.arange(144) + 500)
    assert path.read_text(encoding="utf-8") == text
    return text


def numbers_of(result):
    """All numbers that a reader may see, in the units they are shown in."""
    scores, calibration = result.scores, result.calibration
    um = [1000 * v for name in ("given", "before", "after") for v in scores.summary[name]]
    for name, column in scores.table.items():
        if name not in ("position", "n_points"):
            um += (1000 * column).tolist()
    for errors in (scores.length_errors_before, scores.length_errors_after):
        size = np.abs(errors).max(), np.ptp(errors), 2 * np.sqrt(np.mean(errors**2))
        um += [1000 * v for v in size]
    within = result.correct(result.angles, std_of="position")[1]
    base = result.correct(result.angles)[1]
    k = result.calibration.scale_sd_corrected
    of_metre = np.sqrt(2 / 3 * np.mean(np.sum(within**2, axis=1)) + (1000 * k) ** 2)
    um += [1000 * np.sqrt(np.mean(v**2)) for v in (within, base)] + [1000 * of_metre, 1e6 * k, 1]
    um += (1000 * result.outliers["distance"]).tolist()
    um += [1000 * calibration.scatter_before_mm, 1000 * calibration.scatter_after_mm]
    angle = np.array([name.startswith(("alpha", "theta")) for name in calibration.names])
    factor = np.where(angle, 180 / np.pi, 1)
    table = [factor * v for v in (calibration.nominal, calibration.values)]
    table.append(factor * calibration.standard_deviations)
    harmonics = result.model.harmonics_
    found = [*harmonics["amplitude_arcsec"], *harmonics["order"], *harmonics["joint"]]
    c, s = harmonics["cos_arcsec"], harmonics["sin_arcsec"]
    sds = np.hypot(c * harmonics["cos_sd_arcsec"], s * harmonics["sin_sd_arcsec"])
    found += (sds / np.hypot(c, s)).tolist()
    counts = [*scores.table["n_points"], *range(12), 144, 12, scores.n_folds, 0]
    counts += (result.outliers["row"] + 500).tolist()
    counts.append(np.nanargmax(np.linalg.norm(scores.left_after, axis=1)) + 500)
    shown = [100 * scores.coverage, scores.std_factor, *scores.summary["ratio"], 40.0, 400, 0.01]
    shown += [len(result.calibration.length_errors_mm) - 3]  # lengths that are not named
    return np.concatenate([um, *table, found, counts, shown])


def test_every_number_is_one_of_the_result(read_page, result, page):
    text = " ".join(read_page(page).text)
    # Sentences of the result itself.
    texts = (finding.text for finding in result.findings)
    for sentence in (result.verdict, *texts, *result.scores.changes):
        text = text.replace(sentence, "")
    # Names, dates and versions are no numbers of the result.
    for fixed in (
        r"ASME B89\.4\.22", r"\b95 %", r"\b2S\b", r"\b2 rms", r"aacmm6", r"<17>",
        r"\b(a|alpha|d|theta_offset)\d\b", r"\d{4}-\d\d-\d\d", r"\b[0-9a-f]{16}\b",
        r"(sklearn_raacmm|scikit-learn|NumPy|SciPy|Python) [\d.a-z]+",
    ):  # fmt: skip
        assert re.search(fixed, text), fixed
        text = re.sub(fixed, " ", text)
    known = numbers_of(result)
    seen = re.findall(r"-?\d+(?:\.\d+)?", text)
    assert len(seen) > 150
    for word in seen:
        digits = len(word.partition(".")[2])
        assert np.abs(known - float(word)).min() <= 0.5001 * 10.0**-digits, word


def test_the_page_says_what_it_is_about(read_page, result, page):
    text = " ".join(" ".join(read_page(page).text).split())
    summary = result.scores.summary
    given, before, after = (summary[when][0] for when in ("given", "before", "after"))
    for shown in (
        f"2S {given:.3f} mm as given, {before:.3f} calibrated, {after:.3f} corrected",
        "<17>", "serial number",
        "no statement of conformance", "517 1", "of a distance of 1 m",
        "error of known lengths, largest", "Harmonics of the encoders",
    ):  # fmt: skip
        assert shown in text, shown
    assert "Scale: points of one position" not in text  # lengths are known
    # In this order: what it is of, whether it holds, what it gained, what set the scale.
    order = [
        "Correction of aacmm6, serial number <17>", "Not checked since it was learnt", "as given",
        "What set the scale of the arm: 0 to 1, 400.000 mm (sd 0.01 mm)", "Each position",
    ]  # fmt: skip
    places = [text.index(part) for part in order]
    assert places == sorted(places)


def test_no_network_and_no_names_twice(read_page, page):
    found = read_page(page)
    assert [link for link in found.links if not link.startswith("#")] == []
    assert len(found.ids) == len(set(found.ids))
    assert not re.search("@import|<script", page)
    # Only names of XML's own grammar look like addresses.
    addresses = set(re.findall(r"https?://[^\s\"'<]+", page))
    assert all("w3.org" in a or "purl.org" in a or "creativecommons" in a for a in addresses)


def test_a_tracker_and_a_model_without_harmonics(read_page, tmp_path):
    data = make_single_point(5, 10, random_state=2)
    tracker = data.simulation.true_points[:, [1, 2, 0]]
    labels = np.array([f"$x^{{${i}" for i in range(5)])[data.groups]  # text, and no formulae
    result = learn_correction(data.nominal_arm, data.data, labels, tracker, model=Ridge(), cv=3)
    page = write_report(result, tmp_path / "report.html")
    text = " ".join(read_page(page).text)
    assert "$x^{$3" in page
    assert "mean deviation before" in text
    # Nobody has stated where the base stands; and zero has no sign.
    assert text.count("not stated") == 6
    # The base's rotation vector is in degrees, its translation in mm.
    units = [re.search(rf"<td>base_{n}</td>.*?<td>(°|mm)</td>", page)[1] for n in ("rz", "z")]
    assert units == ["°", "mm"]
    assert not re.search(r"\bnan\b|-0\.0+\b", text)
    with_labels = max(map(len, str(result.scores).split("\n")[1:7]))
    assert with_labels <= 80
    assert "Harmonics" not in text
    assert "Scale:" not in text
    assert "What set the scale of the arm: the points of a tracker." in text


def test_what_a_screen_reader_needs_is_there(page):
    figures = re.findall(r"<svg[^>]*>\s*<title>[^<]+</title>", page)
    assert len(figures) == page.count("<svg ") == 2
    assert all('role="img"' in figure for figure in figures)
    assert page.count("<caption>") == page.count("<table")
    assert page.count('<th scope="col"') == len(re.findall(r"<th[ >]", page))


def test_a_notebook_shows_verdict_and_bars(result, read_page):
    page = read_page(result._repr_html_())
    text = "".join(page.text)
    assert result.verdict in text
    before, after = (result.scores.table[name] for name in ("before", "after"))
    cells = [row[1] for row in page.rows[1:]]
    worst = np.argsort(-before, kind="stable")[: len(cells) // 2]
    assert cells[0::2] == [f"{before[i]:.4f}" for i in worst]
    assert cells[1::2] == [f"{after[i]:.4f}" for i in worst]
