"""The examples in the pages of doc/ run, links lead to files, and the reference is complete."""

import doctest
import importlib
import re
import runpy
import sys
import types
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sklearn_raacmm import __version__

DOC = Path(__file__).resolve().parent.parent / "doc"
PAGES = sorted([*DOC.glob("*.md"), *DOC.glob("user_guide/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_examples_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where the pages write their files
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    failed, _ = doctest.testfile(str(page), module_relative=False, optionflags=flags)
    assert failed == 0


def test_get_started_runs_for_a_reader_with_a_file_of_his_own(tmp_path, monkeypatch):
    """The part that may be skipped is skipped, and a file of this form is there."""
    monkeypatch.chdir(tmp_path)
    text = (DOC / "get_started.md").read_text(encoding="utf-8")
    start = text.index("### A file to try with")
    skipped = text[start : text.index("## Read", start)]
    assert "Skip this part" in skipped
    doctest.run_docstring_examples(skipped, {"np": np, "pd": pd})
    assert Path("cone_test.csv").exists()
    page = tmp_path / "page.md"
    page.write_text(text.replace(skipped, ""), encoding="utf-8")
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    failed, tried = doctest.testfile(str(page), module_relative=False, optionflags=flags)
    assert failed == 0
    assert tried > 20


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files(page):
    text = page.read_text(encoding="utf-8")
    local = [link for link in re.findall(r"\]\(([^)#]+)", text) if "://" not in link]
    # Pages of the gallery are made of scripts.
    local = [re.sub(r"auto_examples/(\w+)\.rst", r"../examples/\1.py", link) for link in local]
    assert [link for link in local if not (page.parent / link).exists()] == []
    scripts = re.findall(r"(?:examples|benchmarks)/\w+\.py", text)
    assert [name for name in scripts if not (DOC.parent / name).exists()] == []


@pytest.mark.parametrize("module", ["", ".app", ".datasets", ".display", ".export", ".metrics"])
def test_every_public_name_is_in_the_reference(module):
    text = (DOC / "api.rst").read_text(encoding="utf-8")
    sections = re.split(r"\.\. currentmodule:: (\S+)\n", text)
    name = f"sklearn_raacmm{module}"
    listed = [
        entry
        for module_name, section in zip(sections[1::2], sections[2::2], strict=True)
        if module_name == name
        for entry in re.findall(r"^   (\w+)$", section, flags=re.MULTILINE)
    ]
    public = set(importlib.import_module(name).__all__) - {"__version__"}
    assert sorted(listed) == sorted(public)


def test_the_version_is_said_once_and_cited_right():
    citation = (DOC.parent / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (\S+)$", citation, flags=re.MULTILINE)[1] == __version__


@pytest.mark.parametrize("address", [None, "https://example.org/v1/"])
def test_the_readme_leads_somewhere_from_a_package_index(address, monkeypatch):
    interface = types.ModuleType("interface")
    interface.MetadataHookInterface = object
    monkeypatch.setitem(sys.modules, "hatchling.metadata.plugin.interface", interface)
    build = runpy.run_path(str(DOC.parent / "hatch_build.py"))
    for_the_index = build["for_the_index"]
    urls = build["project_urls"](address)
    assert all(url.startswith("https://") for url in urls.values())
    assert ("Source" in urls) == (address is not None)
    assert all((DOC.parent / file).exists() for file in build["FILES"].values())
    text = (DOC.parent / "README.md").read_text(encoding="utf-8")
    shown = for_the_index(text, address)
    links = re.findall(r"\]\(([^)#]+)\)", shown)
    assert links
    assert all("://" in link for link in links)
    assert ("https://example.org/v1/doc/images/" in shown) == (address is not None)
    # All else stays.
    assert shown.count(">>>") == text.count(">>>")
    assert "Licence" in shown or "licence" in shown


def test_every_benchmark_is_on_its_page():
    text = (DOC / "benchmarks.md").read_text(encoding="utf-8")
    scripts = {path.name for path in (DOC.parent / "benchmarks").glob("bench_*.py")}
    assert scripts <= set(re.findall(r"^\| `(\w+\.py)`", text, flags=re.MULTILINE))
