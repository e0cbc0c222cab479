"""The command `raacmm accept`: tables in, a sheet out whose numbers are those of the evaluation."""

import csv
import io
import json
import os
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from sklearn_raacmm import ArmResidualRegressor, learn_correction
from sklearn_raacmm.acceptance import LABELS, VALUES, evaluate_acceptance, predict_acceptance
from sklearn_raacmm.app import _accept, main
from sklearn_raacmm.app._accept import ENTRIES, WORDS
from sklearn_raacmm.datasets import make_acceptance, make_single_point

pytest.importorskip("jinja2")
pytest.importorskip("skops")
openpyxl = pytest.importorskip("openpyxl")
LIMITS = {
    "P_Size": (0.03, 0.0, np.inf), "E_Uni": (0.06, 1 / 10_000, 0.15), "2S far": (0.2, 0.0, np.inf),
}  # fmt: skip
ENTRY = {"number": '7"; } body { display: none }', "laboratory": "<Labor>", "tested": "2026-11-23"}


def tables_of(run, limits=LIMITS, entries=ENTRY):
    """The tables of a run, as numbers and text."""
    numbers, heads = np.rad2deg(run.angles), [f"q{i} [deg]" for i in range(1, 7)]
    if run.points is not None:
        numbers, heads = run.points, ["x [mm]", "y [mm]", "z [mm]"]
    labels = zip(*(getattr(run, name).tolist() for name in LABELS), strict=True)
    readings = [[*LABELS, *heads]]
    readings += [[*a, *b] for a, b in zip(labels, numbers.tolist(), strict=True)]
    artefacts = [["name", "serial number", "certificate", "size [mm]", "U [um], k = 2", "form [um]",
                  "expansion [1e-6/K]", "temperature [degC]", "u of fixture [um]"]]  # fmt: skip
    for a in run.artefacts:
        numbers = (a.size_mm, 1), (a.expanded_mm, 1e3), (a.form_mm, 1e3), (a.expansion_per_k, 1e6)
        numbers += (a.temperature_degc, 1), (a.fixture_mm, 1e3)
        numbers = ["" if value is None else value * factor for value, factor in numbers]
        artefacts.append([a.name, a.serial, a.certificate, *numbers])
    shown = [["value", "A [um]", "K: A + L / K [mm/um]", "at most [um]"]]
    for name, (a, slope, most) in limits.items():
        k = 1e-3 / slope if slope else ""
        shown.append([name, 1e3 * a, k, 1e3 * most if np.isfinite(most) else ""])
    sheet = [["entry", "value"], *entries.items(), ["Diameter of the probe's ball, mm", run.tip_mm]]
    return {"readings": readings, "artefacts": artefacts, "limits": shown, "sheet": sheet}


def write_folder(folder, tables):
    """As a German spreadsheet program writes CSV."""
    folder.mkdir()
    for name, rows in tables.items():
        stream = io.StringIO()
        texts = [[str(c).replace(".", ",") if isinstance(c, float) else c for c in r] for r in rows]
        csv.writer(stream, delimiter=";").writerows(texts)
        (folder / f"{name}.csv").write_text(stream.getvalue(), encoding="utf-8-sig")
    return folder


def write_book(path, tables):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in tables.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append([None if cell == "" else cell for cell in row])
    book.save(path)
    return path


@pytest.fixture(scope="module", autouse=True)
def few_draws():
    """The expected values of 20 runs: 200 take five seconds in every call."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_accept, "predict_acceptance", partial(predict_acceptance, n_draws=20))
        yield


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    test = make_single_point(8, 20, bars=[500], random_state=0)
    model = ArmResidualRegressor(orders=4)
    found = learn_correction(
        test.nominal_arm, test.data, test.groups, lengths=test.lengths, model=model, cv=2
    )
    folder = tmp_path_factory.mktemp("model")
    found.save(folder)
    return found, folder


@pytest.fixture(scope="module")
def data():
    return make_acceptance(random_state=0)


@pytest.fixture(scope="module")
def judged(learned, data, tmp_path_factory):
    """The result, the exit code, and the sheet in both languages."""
    correction, folder = learned
    place = tmp_path_factory.mktemp("run")
    run = write_folder(place / "run", tables_of(data.run))
    pages = {}
    for language in ("en", "de"):
        out = place / f"{language}.html"
        words = ["accept", str(run), "--model", str(folder), "--out", str(out)]
        code = main([*words, "--language", language, "--quiet"])
        pages[language] = out.read_text(encoding="utf-8")
    return evaluate_acceptance(data.run, model=correction, limits=LIMITS), code, pages


@pytest.mark.parametrize("language", ["en", "de"])
def test_every_number_of_the_sheet_is_one_of_the_result(read_page, judged, language):
    result, code, pages = judged
    page = read_page(pages[language])

    def t(text):
        return WORDS[language].get(text, text)

    assert page.links == []
    rows = {row[0]: row for row in page.rows if len(row) == 9 and row[0] != "sphere"}

    def um(value):
        text = f"{1000 * value:.1f}"
        return text.replace(".", ",") if language == "de" else text

    for one in result.values:
        row = rows[t(one.name)]
        assert row[2:4] == [um(one.before), um(2 * one.u_before)]
        assert row[5:7] == [um(one.after), um(2 * one.u_after)]
        assert [row[4], row[7].strip()] == [t(one.decision_before), t(one.decision_after)]
        chi = one.interval_after is not None
        assert ("χ²" in row[8]) == chi
        if chi:
            assert row[8] == f"{um(one.interval_after[0])} … {um(one.interval_after[1])} χ²"
        else:
            low, high = (float(v.replace(",", ".")) for v in row[8].split(" … "))
            assert 0 <= low < high < 1000
    limit = {"en": "60.0 + L / 10 ≤ 150.0", "de": "60,0 + L / 10 ≤ 150,0"}
    assert rows["E_Uni"][1] == limit[language]
    assert rows["L_Dia"][1] == "-"
    failed = any("fail" in one.decision_after for one in result.values)
    assert code == (3 if failed else 0)


def test_what_nobody_stated_is_a_visible_blank(read_page, judged):
    page = read_page(judged[2]["en"])
    # Entries without number and country, the seat's two numbers, who authorises, and the signature.
    assert page.blanks == len(ENTRIES) - len(ENTRY) - 2 + 2 + 1 + 1
    for text in ("This is no statement of conformance", "k = 2", "this item only", "1.645 u"):
        assert text in judged[2]["en"]


def test_the_sheet_shows_what_its_uncertainties_are_made_of(read_page, judged, data):
    rows = {row[0]: row for row in read_page(judged[2]["de"]).rows}
    (bar,) = (one for one in data.run.artefacts if one.name == "bar 600")
    assert [bar.expansion_per_k, bar.u_expansion_per_k, bar.u_temperature_k] == [11.5e-6, 1e-6, 0.3]
    assert rows["bar 600"][4:] == ["4,00", "-", "11,5 (1,0)", "21,0 (0,3)", "1,0"]
    methods = [row for row in read_page(judged[2]["en"]).rows if len(row) == 6]
    assert {row[0]: int(row[1]) for row in methods[1:]} == {
        test: np.sum(data.run.test == test) for test in dict.fromkeys(data.run.test.tolist())
    }
    assert "<dd>6.0000</dd>" in judged[2]["en"]  # the probe's ball


def test_text_of_the_user_is_no_code_of_the_page(judged):
    for page in judged[2].values():
        style = page[: page.index("</head>")]
        assert "&lt;Labor&gt;" in page
        assert "<Labor>" not in page
        line = re.search(r'@top-right \{ content: "([^"]*)"', style)[1]
        assert re.sub(r"[\w .,/#:-]", "", line) == ""
        assert "counter(page)" in style
        assert "size: A4" in style


def test_everything_has_a_german_word():
    from importlib.resources import files

    text = files("sklearn_raacmm.app").joinpath("_accept.html").read_text("utf-8")
    used = set(re.findall(r't\("([^"]+)"\)', text)) | set(ENTRIES.values()) | set(WORDS["en"])
    # A formula may be the same in both.
    used |= {part for test, formula, _, read in VALUES.values() for part in (test, read)}
    used |= {formula for _, formula, *_ in VALUES.values() if re.search(r"[a-z]{4}", formula)}
    used |= {name for name in VALUES if " " in name}
    same = {"2 sqrt(sum d^2 / (n - 1))"}
    assert used - set(WORDS["de"]) - same == set()


def test_a_spreadsheet_says_the_same_as_json(learned, data, judged, tmp_path, capsys):
    path = write_book(tmp_path / "run.xlsx", tables_of(data.run))
    out = ["--out", f"{tmp_path}/sheet.html", "--json"]
    code = main(["accept", str(path), "--model", str(learned[1]), *out])
    said = json.loads(capsys.readouterr().out)
    assert code == judged[1] == said["exit_code"]
    for one, value in zip(judged[0].values, said["values"], strict=True):
        assert value["after"] == pytest.approx(one.after, abs=1e-9)
        assert value["decision_after"] == one.decision_after
    assert set(said["expected"]) == {one.name for one in judged[0].values}


@pytest.mark.parametrize(("table", "column", "wrong"), [
    ("artefacts", 4, "U [mm], k = 2"), ("artefacts", 3, "size [m]"), ("limits", 1, "A [mm]"),
])  # fmt: skip
def test_a_heading_in_another_unit_is_refused(data, tmp_path, refused, table, column, wrong):
    tables = tables_of(data.run)
    right = tables[table][0][column]
    tables[table][0][column] = wrong
    run = write_folder(tmp_path / "run", tables)
    refused(f"{wrong!r} has to be {right!r}", "accept", run, "--arm", "aacmm6")
    tables[table][0][column] = right.replace("[um]", "[µm]")
    run = write_folder(tmp_path / "same", tables)
    assert list(_accept._read_tables(run)) == list(tables)


def test_points_without_an_arm_and_a_limit_that_is_missed(data, tmp_path, capsys):
    run = replace(data.run, points=data.arm.forward(data.run.angles))
    path = write_folder(tmp_path / "run", tables_of(run, {"2S far": (1e-4, 0.0, np.inf)}))
    words = ["accept", str(path), "--out", f"{tmp_path}/s.html"]
    assert main([*words, "--rule", "simple"]) == 3
    assert re.search(r"2S far: [\d.]+ um \(U = 2.0 um\) fail\n", capsys.readouterr().out)
    page = (tmp_path / "s.html").read_text(encoding="utf-8")
    assert "simple acceptance" in page
    assert "as left, µm" not in page
    readings = path / "readings.csv"
    text = readings.read_text("utf-8-sig")
    for unit, code, sentence in (
        ("in", 4, "the stated size, or the heading of the points, is in inches"),
        ("foot", 2, "the points are in foot, not in mm"),
    ):
        readings.write_text(text.replace("[mm]", f"[{unit}]"), "utf-8-sig")
        assert main(words) == code
        assert sentence in "".join(capsys.readouterr())


def test_a_template_is_a_whole_run_but_for_its_numbers(learned, data, tmp_path, capsys, refused):
    path = tmp_path / "new" / "run.xlsx"
    words = ["accept", str(path), "--model", str(learned[1])]
    assert main([*words, "--template"]) == 0
    for wrong, said in (
        ([*words, "--template"], "is there already"),
        (["accept", str(tmp_path / "run"), "--template"], "a template is a spreadsheet"),
        (words, "none of the 592 rows of the table readings holds numbers"),
    ):
        refused(said, *wrong, "--out", tmp_path / "s.html")
    book = openpyxl.load_workbook(path)
    assert book.sheetnames == ["readings", "artefacts", "limits", "sheet"]
    rows = [["" if cell is None else str(cell) for cell in row] for row in book["readings"].values]
    assert rows[0] == [*LABELS, *(f"q{i} [deg]" for i in range(1, 7))]
    # Filled with the angles of a simulated run, in its order, every test of it is whole.
    run, order = data.run, {}
    for i, test in enumerate(run.test):
        order.setdefault(test, []).append(i)
    book["readings"].delete_rows(2, len(rows))
    for row in rows[1:]:
        if order.get(row[0]) and not (row[0] == "articulation" and row[2] not in "12"):
            angles = np.rad2deg(run.angles[order[row[0]].pop(0)])
            book["readings"].append([*row[:6], *angles.tolist()])
    book.save(path)
    assert main([*words, "--out", f"{tmp_path}/s.html"]) == 4
    said = capsys.readouterr().out
    assert "is not stated: size_mm, expanded_mm, expansion_per_k, temperature_degc, cert" in said
    assert "readings, " not in said
    assert re.search(r"2S far: [\d.]+ um", said)


# -- the certificate --------------------------------------------------------------------------

SPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
STATED = ENTRY | {
    "number": "2026-117", "country": "DE", "customer": "A & B", "place": "customer", "item": "arm",
    "serial": "7", "probe": "6 mm", "tested": "2026-11-20/2026-11-23", "temperature": "20,4",
    "humidity": "40 to 50", "authorised": "Dr. <K>", "received": "2026-11-19",
}  # fmt: skip
# What may stand in an element, in order, by dcc.xsd 3.2.1 and 3.3.0; ! has to be there.
ORDERS = {
    "digitalCalibrationCertificate": "administrativeData! measurementResults!",
    "administrativeData": "dccSoftware! coreData! items! calibrationLaboratory! respPersons! "
    "customer! statements",
    "software": "name! release! type description",
    "coreData": "countryCodeISO3166_1! usedLangCodeISO639_1! mandatoryLangCodeISO639_1! "
    "uniqueIdentifier! identifications receiptDate beginPerformanceDate! endPerformanceDate! "
    "performanceLocation! issueDate",
    "item": "name! description manufacturer model identifications!",
    "identification": "issuer! value! name",
    "contact": "name! eMail phone fax location!",
    "customer": "name! eMail phone fax location!",
    "respPerson": "person! description role mainSigner",
    "statement": "name description norm reference declaration",
    "measurementResult": "name! description usedMethods usedSoftware measuringEquipments "
    "influenceConditions results! measurementMetaData",
    "usedMethod": "name! description norm reference",
    "measuringEquipment": "name! description identifications measuringEquipmentQuantities",
    "influenceCondition": "name! description status certificate data!",
    "result": "name! description data!",
    "quantity": "name description noQuantity real measurementMetaData",
    "metaData": "name description declaration conformity data",
    "real": "label value! unit! expandedUnc",
    "expandedUnc": "uncertainty! coverageFactor! coverageProbability! distribution",
}


def check_orders(element):
    """Children are those of the schema, in its order; no element is empty."""
    name = element.tag.rpartition("}")[2]
    children = [child.tag.rpartition("}")[2] for child in element]
    assert children or (element.text and element.text == element.text.strip()), name
    if name in ORDERS:
        order = ORDERS[name].split()
        assert {one[:-1] for one in order if one.endswith("!")} <= set(children)
        places = [[one.rstrip("!") for one in order].index(child) for child in children]
        assert places == sorted(set(places)), name
    for child in element:
        check_orders(child)


@pytest.fixture(scope="module")
def certified(learned, data, tmp_path_factory):
    """The folder of sheets and certificates."""
    place = tmp_path_factory.mktemp("certified")
    run = write_folder(place / "run", tables_of(data.run, entries=STATED))
    words = ["accept", str(run), "--model", str(learned[1]), "--quiet"]
    for language in ("en", "de"):
        files = ["--out", f"{place}/{language}.html", "--dcc", f"{place}/{language}.xml"]
        assert main([*words, "--language", language, *files]) in (0, 3)
    return place


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_certificate_says_what_the_sheet_says(read_page, judged, certified, language):
    result, _, _ = judged
    assert result["E_Uni"].limit_before != result["E_Uni"].limit_after  # of other lengths
    root = ElementTree.parse(certified / f"{language}.xml").getroot()
    check_orders(root)
    page = read_page((certified / f"{language}.html").read_text(encoding="utf-8"))
    rows = {row[0]: row for row in page.rows if len(row) == 9 and row[0] != "sphere"}
    sides = root.findall(".//dcc:measurementResult", SPACES)
    for side, column, found in zip(("before", "after"), (2, 5), sides, strict=True):
        status = found.find(".//dcc:influenceCondition/dcc:status", SPACES).text
        assert status == f"{side}Adjustment"
        quantities = found.findall("dcc:results/dcc:result/dcc:data/dcc:quantity", SPACES)
        names = [one.find("dcc:name/dcc:content", SPACES).text for one in quantities]
        assert sorted(names) == sorted(WORDS[language].get(v.name, v.name) for v in result.values)
        for name, one in zip(names, quantities, strict=True):
            real = one.find("si:real", SPACES)
            shown = [cell.replace(",", ".") for cell in rows[name]]
            assert real.find("si:value", SPACES).text == shown[column]
            assert real.find("si:unit", SPACES).text == r"\micro\metre"
            assert real.find("si:expandedUnc/si:uncertainty", SPACES).text == shown[column + 1]
            assert real.find("si:expandedUnc/si:coverageFactor", SPACES).text == "2"
        for value in result.values:
            one = quantities[names.index(WORDS[language].get(value.name, value.name))]
            said = one.find(".//dcc:conformity", SPACES)
            decision = getattr(value, f"decision_{side}")
            at = getattr(value, f"limit_{side}")
            assert (said is None) == (at is None)
            if said is not None:
                assert re.sub("([A-Z])", lambda m: " " + m[1].lower(), said.text) == decision
                limit = one.find(".//dcc:metaData/dcc:data/dcc:quantity/si:real/si:value", SPACES)
                assert limit.text == f"{1000 * at:.1f}"
    core = {
        child.tag.rpartition("}")[2]: child.text for child in root.find(".//dcc:coreData", SPACES)
    }
    days = [core[name] for name in ("receiptDate", "beginPerformanceDate", "endPerformanceDate")]
    assert days == ["2026-11-19", "2026-11-20", "2026-11-23"]
    assert core["usedLangCodeISO639_1"] == language
    assert core["performanceLocation"] == ("customer" if language == "en" else "other")
    text = " ".join(root.itertext())
    assert all(one in text for one in ("A & B", "Dr. <K>", "40 to 50", "bar 600", "600.00000"))
    assert WORDS[language]["ONLY"] in text
    celsius = [real for real in root.iterfind(".//si:real", SPACES) if "celsius" in real[1].text]
    assert [real[0].text for real in celsius] == ["20.4", "20.4"]


def words_for_points(data, folder, entries=STATED):
    """The command for the same run as points: quicker, as there is no model."""
    run = replace(data.run, points=data.arm.forward(data.run.angles))
    path = write_folder(folder / "run", tables_of(run, entries=entries))
    return ["accept", str(path), "--out", f"{folder}/s.html", "--dcc", f"{folder}/s.xml"]


@pytest.mark.parametrize(
    ("entry", "text", "sentence"),
    [
        ("country", "", "needs of the table sheet: country of the laboratory, two letters."),
        ("country", "Germany", "two capitals, such as DE, got Germany"),
        ("tested", "23.11.2026", "tested: a day such as 2026-11-23, or two"),
        ("tested", "2026-11-23/2026-11-20", "or two, 2026-11-20/2026-11-23, got '2026-11-23/"),
        ("remarks", "\x01", "The certificate would be no XML"),
    ],
)
def test_what_a_certificate_lacks_is_said_and_nothing_written(
    data, tmp_path, refused, entry, text, sentence
):
    refused(sentence, *words_for_points(data, tmp_path, STATED | {entry: text}))
    assert not [*tmp_path.glob("s.*")]


def test_a_test_that_is_not_whole_has_no_value(data, tmp_path, capsys):
    words = words_for_points(data, tmp_path)
    readings = tmp_path / "run" / "readings.csv"
    lines = readings.read_text("utf-8-sig").splitlines()
    del lines[next(i for i, line in enumerate(lines) if line.startswith("length"))]
    readings.write_text("\n".join(lines), "utf-8-sig")
    assert main(words) == 4
    assert "E_Uni: no value" in capsys.readouterr().out
    page = (tmp_path / "s.html").read_text(encoding="utf-8")
    root = ElementTree.parse(tmp_path / "s.xml").getroot()
    check_orders(root)
    (lost,) = root.iterfind(".//dcc:noQuantity", SPACES)
    assert "".join(lost.itertext()) == "no value"
    for text in (page, " ".join(root.itertext())):
        assert "has 0 readings, 1 are needed" in text


def test_the_schema_of_the_ptb_takes_certificates(data, tmp_path):
    schema = os.environ.get("SKLEARN_RAACMM_DCC_SCHEMA")
    if not schema:
        pytest.skip("SKLEARN_RAACMM_DCC_SCHEMA names no dcc.xsd")
    etree = pytest.importorskip("lxml.etree")
    assert main(words_for_points(data, tmp_path)) in (0, 3)
    text = Path(schema).read_text(encoding="utf-8")
    text = re.sub(r'schemaLocation="http[^"]*/', 'schemaLocation="', text)  # is beside it
    root = etree.fromstring(text.encode(), base_url=schema)
    etree.XMLSchema(root).assertValid(etree.parse(tmp_path / "s.xml"))


@pytest.mark.parametrize(
    ("name", "old", "new", "sentence"),
    [
        ("sheet", "laboratory", "laboratry", "entry 'laboratry', which is unknown"),
        ("limits", "P_Size", "P_Sise", "limits names 'P_Sise'"),
        ("limits", ";10,0;", ";-10,0;", "K of the limit of E_Uni must be positive, got -10.0"),
        ("artefacts", "bar 600;simulated;600,0", "bar 600;simulated;x", "column 'size [mm]': 'x'"),
        ("artefacts", "sphere;S1;simulated;25,0", "sphere;S1;simulated;-1", "number of 0 or more"),
        ("readings", "test;", "tset;", "has no column test"),
        ("readings", "probing", "prob", "the run has the test 'prob'"),
    ],
)
def test_a_table_that_is_wrong_is_named(learned, data, tmp_path, refused, name, old, new, sentence):
    path = write_folder(tmp_path / "run", tables_of(data.run))
    file = path / f"{name}.csv"
    text = file.read_text("utf-8-sig")
    assert old in text
    file.write_text(text.replace(old, new), "utf-8-sig")
    refused(sentence, "accept", path, "--model", learned[1], "--out", tmp_path / "s.html")
    assert not (tmp_path / "s.html").exists()


def test_joint_angles_need_an_arm(data, tmp_path, refused):
    path = write_folder(tmp_path / "run", tables_of(data.run))
    sheet = tmp_path / "s.html"
    refused("name --model or --arm, whose they are", "accept", path, "--out", sheet)
    data.arm.to_json(tmp_path / "arm.json")
    arm = ["--arm", f"{tmp_path}/arm.json", "--out", str(sheet)]
    assert main(["accept", str(path), *arm]) in (0, 3)
