"""The word ``accept``: a run of acceptance tests judged, on one sheet; and templates for it.

The certificate is XML for PTB's schema of Digital Calibration Certificates, 3.3.0. A sheet may have
blanks, a certificate has none: what the schema asks for has to be stated.
"""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

import io
import itertools
import json
import re
import webbrowser
from datetime import date
from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from sklearn_raacmm._version import __version__
from sklearn_raacmm.acceptance import (
    LABELS,
    LAYOUTS,
    VALUES,
    AcceptanceRun,
    Artefact,
    evaluate_acceptance,
    predict_acceptance,
)
from sklearn_raacmm.app._columns import Columns
from sklearn_raacmm.app._files import check_outputs, load_arm, load_correction, print_notes
from sklearn_raacmm.app._given import in_rad
from sklearn_raacmm.app._report import render
from sklearn_raacmm.app._sources import (
    SHEETS,
    Dialect,
    TableError,
    check_installed,
    find_encoding,
    parse_number,
    read_sheets,
)
from sklearn_raacmm.app._tables import Layout, text_of_label
from sklearn_raacmm.app._units import MM_PER_UNIT, split_unit
from sklearn_raacmm.export import describe
from sklearn_raacmm.utils import Finding, digest_of, write_whole

OK, FAILED, NOT_JUDGED = 0, 3, 4
_TABLES = ("readings", "artefacts", "limits", "sheet")
# Columns of the table of artefacts: attribute, heading, factor to its unit; None is text.
_ARTEFACT = (
    ("name", "name", None), ("serial", "serial number", None), ("certificate", "certificate", None),
    ("size_mm", "size [mm]", 1.0), ("expanded_mm", "U [um], k = 2", 1e-3),
    ("form_mm", "form [um]", 1e-3), ("expansion_per_k", "expansion [1e-6/K]", 1e-6),
    ("u_expansion_per_k", "u of expansion [1e-6/K]", 1e-6),
    ("temperature_degc", "temperature [degC]", 1.0),
    ("u_temperature_k", "u of temperature [K]", 1.0), ("fixture_mm", "u of fixture [um]", 1e-3),
)  # fmt: skip
_LIMITS = ("value", "A [um]", "K: A + L / K [mm/um]", "at most [um]")
_TIP = "diameter of the probe's ball, mm"
# Entries of the sheet by their names, and its words: English ones are their own keys.
WORDS = json.loads(files("sklearn_raacmm.app").joinpath("_accept_words.json").read_text("utf-8"))
ENTRIES = WORDS["entries"]
# Entries that a certificate needs.
_NEEDED = (
    "number", "laboratory", "country", "customer", "place", "item", "serial", "tested",
    "temperature", "authorised",
)  # fmt: skip
_ANGLE = re.compile(r"(q|j|a|theta|joint|axis)[\s_.\[-]*\d+\]?")


def accept(options):
    """Judge a run as found and as left, and write its sheet; or write a template."""
    saved = load_correction(options.model) if options.model else None
    arm = load_arm(options.arm) if options.arm else None
    path, out = Path(options.run), Path(options.out)
    left_arm = saved.arm if saved else arm
    if options.template:
        return _write_template(path, left_arm)
    check_installed("jinja2")
    check_outputs(options, [out, options.dcc], [path / f"{name}.csv" for name in _TABLES])
    run, rows, entries, limits, digest = _read_run(path, left_arm)
    given = {"found": arm if saved else None, "limits": limits, "rule": options.rule}
    with Finding.numbered(rows):
        result = evaluate_acceptance(run, left_arm, saved, **given)
    expected, words = {}, WORDS[options.language]
    software = {"software": f"sklearn_raacmm {__version__}", "fingerprint of the readings": digest}
    if saved:
        software["fingerprint of the model"] = describe(saved.model)["fingerprint"] or ""
        if not result.findings and run.angles is not None and hasattr(saved.model, "sample_y"):
            expected = predict_acceptance(saved, run)
    shown = {"result": result, "run": run, "entries": entries, "labels": ENTRIES, "limits": limits}
    shown |= {"expected": expected, "software": software, "left": saved is not None}
    shown |= {"language": options.language, "t": lambda text: words.get(text, text)}
    # Of text that comes from outside, what a string of CSS may hold.
    number = re.sub(r"[^\w .,/#:-]", "", entries["number"], flags=re.ASCII)
    made = {out: render("_accept.html", page_number=number or "_" * 10, **shown)}
    if options.dcc:
        made[Path(options.dcc)] = _certificate(shown)
    write_whole(made)
    print(result)
    print(f"Written to {', '.join(map(str, made))}")
    if options.open:
        webbrowser.open(out.resolve().as_uri())
    findings = [finding.facts() for finding in result.findings]
    facts = {"values": list(map(vars, result.values)), "findings": findings, "expected": expected}
    last = [one.decision_after if saved else one.decision_before for one in result.values]
    failed = FAILED if any("fail" in decision for decision in last) else OK
    return (NOT_JUDGED if findings else failed), facts


def _certificate(shown):
    """What the sheet shows as XML."""
    entries = shown["entries"]
    if missing := [ENTRIES[name] for name in _NEEDED if not entries[name]]:
        raise TableError(f"The certificate needs of the table sheet: {'; '.join(missing)}.")
    country = entries["country"]
    if not re.fullmatch("[A-Z]{2}", country):
        raise TableError(f"{ENTRIES['country']}: two capitals, such as DE, got {country}.")
    days = {name: _days(ENTRIES[name], entries[name]) for name in ("received", "tested", "issued")}
    methods = {one.standard: one for one in shown["result"].values}
    page = render("_accept.xml", plain=_plain, days=days, methods=methods, **shown)
    try:
        ElementTree.fromstring(page)
    except ElementTree.ParseError as error:  # such as of control characters
        raise TableError(f"The certificate would be no XML: {error}.") from None
    return page


def _days(label, text):
    """First and last day, as ISO 8601 has them; blanks for none."""
    try:
        days = [date.fromisoformat(day.strip()) for day in text.split("/")] if text else []
        if len(days) > 2 or days != sorted(days):
            raise ValueError
    except ValueError:
        raise TableError(
            f"{label}: a day such as 2026-11-23, or two, 2026-11-20/2026-11-23, got {text!r}."
        ) from None
    return [day.isoformat() for day in days] or [""]


def _plain(text):
    """A number as XML has it, "" for other text."""
    try:
        return f"{parse_number(text):g}"
    except TableError:
        return ""


# -- reading --------------------------------------------------------------------------------------


def _read_run(path, arm):
    """A run, numbers of its rows, entries of the sheet, limits, fingerprint of the readings."""
    tables = _read_tables(path)
    file, sheet = (path / "readings.csv", None) if path.is_dir() else (path, "readings")
    columns, numbers = _read_readings(file, arm, sheet, tables["readings"])
    entries, tip = dict.fromkeys(ENTRIES, ""), 0.0
    known = {word: key for key, label in ENTRIES.items() for word in (key, label.lower())}
    for row in tables["sheet"]:
        name, text = row.get("entry", "").lower(), row.get("value", "")
        if name == _TIP:
            tip = parse_number(text) if text else 0.0
        elif name in known:
            entries[known[name]] = text
        elif name:
            raise TableError(f"{path}: the table sheet has the entry {name!r}, which is unknown.")
    artefacts = []
    for row in tables["artefacts"]:
        given: dict[str, Any] = {
            key: _number(path, row, heading, factor) if factor else row.get(_heading(heading), "")
            for key, heading, factor in _ARTEFACT
        }
        # What is not stated keeps its default.
        artefacts.append(Artefact(**{k: value for k, value in given.items() if value is not None}))
    run = AcceptanceRun(**columns, artefacts=artefacts, tip_mm=tip)
    limits = dict(filter(None, (_limit(path, row) for row in tables["limits"])))
    return run, numbers, entries, limits, digest_of(file.read_bytes())


def _read_tables(path):
    """Rows of each table by its headings without units; those of a folder may be missing."""
    tables: dict[str, Any] = dict.fromkeys(_TABLES, ()) if path.is_dir() else read_sheets(path)
    if missing := set(_TABLES) - tables.keys():
        raise TableError(f"{path} has no sheet {', no sheet '.join(sorted(missing))}.")
    for file in (path / f"{name}.csv" for name in _TABLES):
        if file.is_file():
            encoding = find_encoding(file)
            with open(file, encoding=encoding) as lines:
                separator = max(";\t,", key=next(lines, "").count)
            tables[file.stem] = Dialect(file, encoding, separator).rows()
    meant = {_heading(head): head for head in (*_LIMITS, *(one[1] for one in _ARTEFACT))}
    for name, rows in tables.items():
        # A day in a spreadsheet is its midnight.
        texts = [[str(c).strip().removesuffix(" 00:00:00") for c in cells] for _, cells in rows]
        first, *rest = texts or [[]]
        heads = list(map(_heading, first))
        for cell, head in zip(first, heads, strict=True):
            units = {_unit(cell), _unit(meant.get(head, ""))} - {""}
            if name != "readings" and len(units) == 2 and units <= MM_PER_UNIT.keys():
                raise TableError(f"{path}: in the table {name} {cell!r} has to be {meant[head]!r}.")
        pairs = (itertools.zip_longest(heads, row[: len(heads)], fillvalue="") for row in rest)
        tables[name] = list(map(dict, pairs))
    return tables


def _read_readings(path, arm, sheet, rows):
    """Columns of the table of readings, whose cells are in `rows`, too, and numbers of its rows."""
    if rows and not any(cell for row in rows for name, cell in row.items() if name not in LABELS):
        raise TableError(
            f"{path}: none of the {len(rows)} rows of the table readings holds numbers: fill in "
            "what you measured, and delete the rows of tests that you leave out."
        )
    columns = Columns(path, 3, sheet)
    has_points = set("xyz") <= set(columns.names)
    has_angles = {"deg", "rad"} & set(columns.units) or any(map(_ANGLE.fullmatch, columns.names))
    given = [name for name in LABELS if name in columns.names]
    if missing := {"test", "artefact"} - set(given):
        raise TableError(f"{path} has no column {' and no column '.join(sorted(missing))}.")
    points = ["x", "y", "z"] if has_points else None
    options = {"labelled": False, "others": given, "sheet": sheet, "points": points}
    if has_points and not has_angles:  # the reader of angles reads any three columns of numbers
        table = Layout(path, 3, angles=points, angle_unit="deg", **options).read()
        measured = {"points": table.points}
    else:
        if arm is None:
            raise TableError(f"{path} holds joint angles: name --model or --arm, whose they are.")
        options |= {"joint_names": arm.names, "joint_types": arm.joint_types}
        table = Layout(path, arm.n_joints, **options).read()
        measured = {"angles": in_rad(table), "points": table.points}
    print_notes(table.notes)
    labels = {name: [text_of_label(cell) for cell in table.others[name].tolist()] for name in given}
    return labels | measured, table.rows


def _heading(text):
    """A heading without its unit and in small letters."""
    return re.split(r"[\[:]", text)[0].strip().lower()


def _unit(heading):
    """The unit in square brackets of a heading, or ""."""
    brackets = re.search(r"\[[^\]/]*\]", heading)
    return split_unit(f"x {brackets[0]}")[1] if brackets else ""


def _number(path, row, heading, factor):
    """Number of a cell, None where it is empty."""
    text = row.get(_heading(heading), "")
    try:
        return parse_number(text) * factor if text else None
    except TableError as error:
        first = next(iter(row.values()))
        raise TableError(f"{path}: {first}, column {heading!r}: {error}") from None


def _limit(path, row):
    """Name of a value and its limit A, s, B in mm; None where none is stated."""
    a, k, b = (_number(path, row, heading, 1.0) for heading in _LIMITS[1:])
    if a is None:
        return None
    k, b = (np.inf if one is None else one for one in (k, b))
    if k <= 0:
        raise TableError(f"{path}: K of the limit of {row['value']} must be positive, got {k}.")
    return row["value"], (a / 1e3, 1e-3 / k, b / 1e3)


# -- the template ---------------------------------------------------------------------------------


def _write_template(path, arm):
    """Write a spreadsheet with the tables of a whole run, without its numbers."""
    check_installed("openpyxl")
    import openpyxl

    if path.suffix.lower() not in SHEETS:
        raise TableError(f"a template is a spreadsheet, such as run.xlsx, got {path}.")
    if path.exists():
        raise TableError(f"{path} is there already: a template never replaces readings.")
    numbers = ["x [mm]", "y [mm]", "z [mm]"]
    if arm is not None:
        numbers = [f"q{i} [deg]" for i in range(1, arm.n_joints + 1)]
    readings, names = [[*LABELS, *numbers]], []
    for test, (levels, n, _) in LAYOUTS.items():
        artefact = {"single-point": "seat", "volumetric": "bar"}.get(test, "sphere")
        columns = [column for column, _ in levels]
        ranges = [n if isinstance(n, tuple) else range(1, n + 1) for _, n in levels]
        for labels in itertools.product(*ranges) if test != "pose" else ():
            row = {"test": test, "artefact": artefact, **dict(zip(columns, labels, strict=True))}
            if isinstance(row["artefact"], int):
                row["artefact"] = f"length {row['artefact']}"
            readings += n * [[row.get(name) for name in LABELS]]
            names.append(row["artefact"])
    tables = {
        "readings": readings,
        "artefacts": [[head for _, head, _ in _ARTEFACT], *([n] for n in dict.fromkeys(names))],
        "limits": [list(_LIMITS), *([name] for name in VALUES)],
        "sheet": [["entry", "value"], *([label] for label in ENTRIES.values()), [_TIP]],
    }
    book, stream = openpyxl.Workbook(write_only=True), io.BytesIO()
    for name, rows in tables.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(stream)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole({path: stream.getvalue()})
    print(f"Written: {path}")
    print("Fill in what you measure, and delete the rows of tests that you leave out.")
    return OK, {"files": [str(path)]}
