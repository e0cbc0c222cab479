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

import sklearn_raacmm
from sklearn_raacmm import (
    ArmResidualRegressor,
    CylindricalResidualTarget,
    PoseFeatures,
    RBFNetRegressor,
    __version__,
)
from sklearn_raacmm._version import documentation_of
from sklearn_raacmm.utils._versioned import VersionedEstimator, link_template

DOC = Path(__file__).resolve().parent.parent / "doc"
PAGES = sorted([*DOC.glob("*.md"), *DOC.glob("user_guide/*.md")])
# Pages whose examples take five seconds or more, and the first page, which is much of README.md.
LONG = {"get_started.md", "index.md", "recipes.md", "scale.md", "metadata_routing.md"}
SHOWN = [*PAGES, DOC.parent / "README.md"]
NUMBER = re.compile(r"-?\d+\.\d*")


class Rounded(doctest.OutputChecker):
    """Numbers with a decimal point may differ by one in the last digit that a page shows.

    pytest's option NUMBER, which checks README.md and the docstrings, does the same.
    """

    def check_output(self, want, got, optionflags):
        said, found = NUMBER.findall(want), NUMBER.findall(got)
        if len(said) == len(found) and all(
            abs(float(a) - float(b)) <= 1.001 * 10.0 ** -len(a.split(".")[1])
            for a, b in zip(said, found, strict=True)
        ):
            numbers = iter(said)
            got = NUMBER.sub(lambda _: next(numbers), got)
        return super().check_output(want, got, optionflags)


def run_examples(text, name):
    """Number of failed and of run examples of a page."""
    runner = doctest.DocTestRunner(Rounded(), optionflags=doctest.NORMALIZE_WHITESPACE)
    return runner.run(doctest.DocTestParser().get_doctest(text, {}, name, name, 0))


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=pytest.mark.exhaustive if p.name in LONG else ()) for p in PAGES],
    ids=lambda page: page.name,
)
def test_examples_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where the pages write their files
    assert run_examples(page.read_text(encoding="utf-8"), page.name)[0] == 0


def test_numbers_are_compared_to_the_digits_that_are_shown(capsys):
    for got, failed in (("2S 0.0204 mm", 0), ("2S 0.0196 mm", 0), ("2S 0.0224 mm", 1), ("2S", 1)):
        assert run_examples(f">>> print({got!r})\n2S 0.020 mm\n", "page")[0] == failed


@pytest.mark.parametrize("page", SHOWN, ids=lambda page: page.name)
def test_results_are_shown_in_full(page):
    examples = doctest.DocTestParser().get_examples(page.read_text(encoding="utf-8"))
    assert [example.want for example in examples if "..." in example.want] == []


@pytest.mark.exhaustive
def test_get_started_runs_for_a_reader_with_a_file_of_his_own(tmp_path, monkeypatch):
    """The part that may be skipped is skipped, and a file of this form is there."""
    monkeypatch.chdir(tmp_path)
    text = (DOC / "get_started.md").read_text(encoding="utf-8")
    start = text.index("### A file to try with")
    skipped = text[start : text.index("### Read it", start)]
    assert "Skip this part" in skipped
    names = {"np": np, "pd": pd, "joints": [f"q{i}" for i in range(1, 7)]}
    doctest.run_docstring_examples(skipped, names)
    assert Path("cone_test.csv").exists()
    failed, tried = run_examples(text.replace(skipped, ""), "page")
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


def test_developers_find_what_their_pages_name():
    """Modules exist, and hold the functions that stand before them."""
    package = DOC.parent / "sklearn_raacmm"
    pages = [(DOC / f"{name}.md").read_text(encoding="utf-8") for name in ("numerics", "log")]
    text = "\n".join([*pages, (DOC / "how_it_is_built.md").read_text(encoding="utf-8")])
    modules = set(re.findall(r"`([a-z_]+/_[a-z_]+\.py)`", text))
    assert len(modules) > 15
    assert [name for name in modules - {"doc/_results.py"} if not (package / name).exists()] == []
    named = re.findall(r"`([\w.]+)`\s+in\s+`([a-z_]+/_[a-z_]+\.py)`", text)
    assert len(named) > 20
    assert [
        (name, module)
        for name, module in named
        if name.split(".")[-1] not in (package / module).read_text(encoding="utf-8")
    ] == []


@pytest.mark.parametrize(
    "module", ["", ".acceptance", ".app", ".datasets", ".display", ".export", ".metrics"]
)
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


def test_results_are_in_the_reference():
    """Classes that a subpackage makes and that the top level lacks, under their full names."""
    text = (DOC / "api.rst").read_text(encoding="utf-8")
    results = text[text.index("\nResults\n") : text.index("\nMeasures and scorers\n")]
    listed = re.findall(r"^   (\w+)\.(\w+)$", results, flags=re.MULTILINE)
    made = {
        (module, name)
        for module in ("calibration", "correction")
        for name, thing in vars(importlib.import_module(f"sklearn_raacmm.{module}")).items()
        if isinstance(thing, type) and not hasattr(sklearn_raacmm, name)
    }
    assert len(made) == 5
    assert sorted(listed) == sorted(made | {("utils", "Finding")})


def test_the_version_is_said_once_and_cited_right():
    citation = (DOC.parent / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (\S+)$", citation, flags=re.MULTILINE)[1] == __version__


@pytest.mark.parametrize("repository", [None, "https://github.com/someone/sklearn_raacmm"])
def test_the_readme_leads_somewhere_from_a_package_index(repository, monkeypatch):
    interface = types.ModuleType("interface")
    interface.MetadataHookInterface = object
    monkeypatch.setitem(sys.modules, "hatchling.metadata.plugin.interface", interface)
    build = runpy.run_path(str(DOC.parent / "hatch_build.py"))
    urls = build["project_urls"](repository, documentation_of(repository))
    assert all(url.startswith("https://") for url in urls.values())
    assert ("Source" in urls) == (repository is not None)
    text = (DOC.parent / "README.md").read_text(encoding="utf-8")
    shown = build["for_the_index"](text, repository, "0.1.0")
    links = re.findall(r"\]\(([^)#]+)\)", shown)
    assert links
    assert all("://" in link for link in links)
    there = f"]({repository}/raw/v0.1.0/doc/images/cone.svg)" in shown
    assert there == (repository is not None)
    for file in re.findall(r"/(?:blob|raw)/v0.1.0/([^)#]+)", shown):
        assert (DOC.parent / file).exists()
    # All else stays.
    assert shown.count(">>>") == text.count(">>>")
    assert "Licence" in shown or "licence" in shown


def test_a_release_sets_the_public_place(tmp_path):
    """The workflow's own line, with a made-up address, on a copy of the one file that has it."""
    workflow = (DOC.parent / ".github" / "workflows" / "publish.yml").read_text(encoding="utf-8")
    said = re.search(r'sed -i "s\|(.*)\|(.*)\|" (sklearn_raacmm/_version\.py)', workflow)
    text = (DOC.parent / said[3]).read_text(encoding="utf-8")
    new = said[2].replace('\\"', '"').replace("$PLACE", "https://github.com/someone/arm")
    text, n = re.subn(said[1], new, text, flags=re.MULTILINE)
    (tmp_path / "_version.py").write_text(text)
    own = runpy.run_path(str(tmp_path / "_version.py"))
    assert n == 1
    assert own["REPOSITORY"] == "https://github.com/someone/arm"
    assert own["documentation_of"](own["REPOSITORY"]) == "https://someone.github.io/arm/"


def test_estimators_in_a_notebook_link_to_their_pages(monkeypatch):
    place = documentation_of("https://github.com/someone/sklearn_raacmm")
    assert place == "https://someone.github.io/sklearn_raacmm/"
    assert RBFNetRegressor()._get_doc_link() == ""  # no public place yet
    monkeypatch.setattr(VersionedEstimator, "_doc_link_template", link_template(place))
    top = (DOC / "api.rst").read_text(encoding="utf-8").split(".. currentmodule:: ")[1]
    for estimator in (
        PoseFeatures,
        RBFNetRegressor,
        CylindricalResidualTarget,
        ArmResidualRegressor,
    ):
        page = f"{place}generated/sklearn_raacmm.{estimator.__name__}.html"
        assert estimator()._get_doc_link() == page
        assert f'href="{page}"' in estimator()._repr_html_()
        # autosummary writes a page of this name for each entry.
        assert f"\n   {estimator.__name__}\n" in top


def test_every_benchmark_is_on_its_page():
    text = (DOC / "benchmarks.md").read_text(encoding="utf-8")
    scripts = {path.name for path in (DOC.parent / "benchmarks").glob("bench_*.py")}
    assert scripts <= set(re.findall(r"^\| `(\w+\.py)`", text, flags=re.MULTILINE))
