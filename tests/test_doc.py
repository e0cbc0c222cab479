"""The pages of doc/: examples run, links lead somewhere, what is written is what was measured."""

import doctest
import importlib
import json
import re
import runpy
import sys
import types
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import sklearn_raacmm
from sklearn_raacmm import RBFNetRegressor, __version__
from sklearn_raacmm._version import documentation_of
from sklearn_raacmm.utils._estimators import VersionedEstimator, link_template

ROOT = Path(__file__).resolve().parent.parent
DOC = ROOT / "doc"
PAGES = sorted([*DOC.glob("*.md"), *DOC.glob("user_guide/*.md")])
# Pages whose examples take five seconds or more, and the first page, which is much of README.md.
LONG = {"get_started.md", "index.md", "recipes.md", "scale.md", "metadata_routing.md"}
NUMBER = re.compile(r"-?\d+\.\d*")


def read(path):
    return path.read_text(encoding="utf-8")


# -- examples and links ----------------------------------------------------------------------------


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
    assert run_examples(read(page), page.name)[0] == 0


def test_numbers_are_compared_to_the_digits_that_are_shown(capsys):
    for got, failed in (("2S 0.0204 mm", 0), ("2S 0.0196 mm", 0), ("2S 0.0224 mm", 1), ("2S", 1)):
        assert run_examples(f">>> print({got!r})\n2S 0.020 mm\n", "page")[0] == failed


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda page: page.name)
def test_results_are_shown_in_full_and_links_lead_to_files(page):
    text = read(page)
    examples = doctest.DocTestParser().get_examples(text)
    assert [example.want for example in examples if "..." in example.want] == []
    local = [link for link in re.findall(r"\]\(([^)#]+)", text) if "://" not in link]
    # Pages of the gallery are made of scripts.
    local = [re.sub(r"auto_examples/(\w+)\.rst", r"../examples/\1.py", link) for link in local]
    assert [link for link in local if not (page.parent / link).exists()] == []
    assert [
        name for name in re.findall(r"examples/\w+\.py", text) if not (ROOT / name).exists()
    ] == []


@pytest.mark.exhaustive
def test_get_started_runs_for_a_reader_with_a_file_of_his_own(tmp_path, monkeypatch):
    """The part that may be skipped is skipped, and a file of this form is there."""
    monkeypatch.chdir(tmp_path)
    text = read(DOC / "get_started.md")
    start = text.index("### A file to try with")
    skipped = text[start : text.index("### Read it", start)]
    assert "Skip this part" in skipped
    names = {"np": np, "pd": pd, "joints": [f"q{i}" for i in range(1, 7)]}
    doctest.run_docstring_examples(skipped, names)
    assert Path("cone_test.csv").exists()
    failed, tried = run_examples(text.replace(skipped, ""), "page")
    assert failed == 0
    assert tried > 20


def test_developers_find_what_their_pages_name():
    """Modules exist, and hold the functions that stand before them."""
    package = ROOT / "sklearn_raacmm"
    text = "\n".join(read(DOC / f"{name}.md") for name in ("numerics", "log", "how_it_is_built"))
    modules = set(re.findall(r"`([a-z_]+/_[a-z_]+\.py)`", text))
    assert len(modules) > 15
    assert [name for name in modules - {"doc/_results.py"} if not (package / name).exists()] == []
    named = re.findall(r"`([\w.]+)`\s+in\s+`([a-z_]+/_[a-z_]+\.py)`", text)
    assert len(named) > 20
    assert [
        (name, module)
        for name, module in named
        if name.split(".")[-1] not in read(package / module)
    ] == []


# -- the reference, versions and addresses ---------------------------------------------------------


@pytest.mark.parametrize(
    "module", ["", ".acceptance", ".app", ".datasets", ".display", ".export", ".metrics"]
)
def test_every_public_name_is_in_the_reference(module):
    text = read(DOC / "api.rst")
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
    text = read(DOC / "api.rst")
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


def test_the_version_is_cited():
    assert re.search(r"^version: (\S+)$", read(ROOT / "CITATION.cff"), flags=re.M)[1] == __version__
    assert re.search(r"version = \{(\S+)\}", read(DOC / "citing.md"))[1] == __version__


@pytest.mark.parametrize("repository", [None, "https://github.com/someone/sklearn_raacmm"])
def test_the_readme_leads_somewhere_from_a_package_index(repository, monkeypatch):
    interface = types.ModuleType("interface")
    interface.MetadataHookInterface = object
    monkeypatch.setitem(sys.modules, "hatchling.metadata.plugin.interface", interface)
    build = runpy.run_path(str(ROOT / "hatch_build.py"))
    urls = build["project_urls"](repository, documentation_of(repository))
    assert all(url.startswith("https://") for url in urls.values())
    assert ("Source" in urls) == (repository is not None)
    text = read(ROOT / "README.md")
    shown = build["for_the_index"](text, repository, "0.1.0")
    links = re.findall(r"\]\(([^)#]+)\)", shown)
    assert links
    assert all("://" in link for link in links)
    there = f"]({repository}/raw/v0.1.0/doc/images/cone.svg)" in shown
    assert there == (repository is not None)
    for file in re.findall(r"/(?:blob|raw)/v0.1.0/([^)#]+)", shown):
        assert (ROOT / file).exists()
    # All else stays.
    assert shown.count(">>>") == text.count(">>>")
    assert "Licence" in shown or "licence" in shown


def test_a_release_sets_the_public_place(tmp_path):
    """The workflow's own line, with a made-up address, on a copy of the one file that has it."""
    workflow = read(ROOT / ".github" / "workflows" / "publish.yml")
    said = re.search(r'sed -i "s\|(.*)\|(.*)\|" (sklearn_raacmm/_version\.py)', workflow)
    text = read(ROOT / said[3])
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
    top = read(DOC / "api.rst").split(".. currentmodule:: ")[1]
    names = [n for n in sklearn_raacmm.__all__ if hasattr(getattr(sklearn_raacmm, n), "fit")]
    assert len(names) == 4
    for name in names:
        page = f"{place}generated/sklearn_raacmm.{name}.html"
        assert f'href="{page}"' in getattr(sklearn_raacmm, name)()._repr_html_()
        # autosummary writes a page of this name for each entry.
        assert f"\n   {name}\n" in top


# -- the site --------------------------------------------------------------------------------------


def test_the_check_of_the_site_sees_what_is_broken(tmp_path):
    findings = runpy.run_path(str(DOC / "check_site.py"))["findings"]
    good = '<h1 id="top">A</h1><a href="b.html#there">b</a><a href="https://example.org/x">x</a>'
    (tmp_path / "index.html").write_text(good, encoding="utf-8")
    (tmp_path / "b.html").write_text('<p id="there"><a href="#top2">up</a>', encoding="utf-8")
    assert list(findings(tmp_path)) == ["b.html: no anchor for the link #top2"]
    bad = f'<a href="gone.html">g</a><img src="no.png"><p>{{{{ less }}}} {ROOT}/x</p>'
    (tmp_path / "b.html").write_text(f'<p id="there">{bad}', encoding="utf-8")
    found = list(findings(tmp_path))
    assert len(found) == 4
    assert sum("no file" in line for line in found) == 2
    assert any("building machine" in line for line in found)
    assert any("not filled in" in line for line in found)
    assert list(findings(tmp_path / "empty")) != []


def test_every_example_is_in_a_section_of_the_gallery(script):
    sphinx = script("_sphinx")
    shown = [name for names in sphinx.SECTIONS.values() for name in names]
    assert sorted(shown) == sorted(path.stem for path in (ROOT / "examples").glob("plot_*.py"))
    picture = '.. raw:: html\n\n    <div class="sphx-glr-thumbcontainer">\n:doc:`/x/{}`\n\n'
    pictures = "".join(picture.format(name) for name in shown)
    end = f".. thumbnail-parent-div-close\n\n{sphinx._CLOSE}\nend"
    text = sphinx.with_sections(f"head\n{sphinx._OPEN}\n{pictures}{end}")
    assert [line[9:-1] for line in text.split("\n") if line[:5] == ":doc:"] == shown
    assert all(f"{title}\n---" in text for title in sphinx.SECTIONS)
    assert text.count("<div") - text.count("</div") == len(shown)  # each picture's own is not shown
    with pytest.raises(ValueError, match="1 examples are in no section"):
        sphinx.with_sections(f"{sphinx._OPEN}\n{picture.format('plot_new')}{end}")


# -- measured numbers ------------------------------------------------------------------------------


@pytest.fixture
def results(script):
    return script("_results")


def test_numbers_of_the_readme_are_those_of_the_results(results):
    text = read(ROOT / "README.md")
    assert results.filled(text, results.read()) == text, "run `benchmarks/make_results.py`"
    # The check sees a number that was typed: another result gives another text.
    contents = json.loads(read(results.FILE))
    contents["comparisons"]["real, ur10"]["models"][results.LINEAR]["mean_mm"] *= 2
    assert results.filled(text, results.Results(contents)) != text


def test_every_number_that_a_page_takes_is_there(results):
    known = results.substitutions()
    for page in PAGES:
        used = re.findall(r"\{\{ ?(\w+) ?\}\}", read(page))
        assert set(used) <= set(known), page.name
    assert known["less_linear_ur10"] in known["table_headline"] or known["table_real"]


def test_the_command_says_what_has_moved(results, script):
    make_results = script("make_results")
    old = {"arm": {"model": {"mean_mm": 1.0, "max_mm": 2.0, "fit_seconds": 1.0, "made": "a"}}}
    new = {"arm": {"model": {"mean_mm": 1.02, "max_mm": 2.01, "fit_seconds": 9.0, "made": "b"}}}
    assert list(make_results.moved(old, new)) == ["arm / model / mean_mm: 1 -> 1.02"]
    new["arm"]["other"] = {"mean_mm": 3.0}
    assert list(make_results.moved(old, new))[1:] == ["arm / other / mean_mm: 3 (new)"]
    assert make_results.rounded({"mean_mm": 0.1234567, "fit_seconds": 1.26, "r2": None}) == {
        "mean_mm": 0.12346,
        "fit_seconds": 1.3,
    }
    # All that the pages show is made by --all.
    made = {(title, ": ".join(name)) for title, *_, names in make_results.data_sets(True, None)
            for name in names}  # fmt: skip
    assert {results.simulated(m, s) for m in results.MIXES for s in range(results.SEEDS)} <= {
        title for title, _ in made
    }
    for data in results.REAL:
        assert {(data, name) for name in (results.THREE, results.ALL, results.LINEAR)} <= made


def test_what_the_pages_say_of_the_results_is_true(results):
    """Sentences without a number of their own that the next measurement could make false."""
    found = results.read()
    for data in results.REAL:
        models = found.comparisons[data]["models"]
        others = [name for name in models if name != results.LINEAR]
        best = min(models[name]["mean_mm"] for name in others)
        assert models[results.LINEAR]["mean_mm"] < best
        # "All joints were better on every arm that we have tried but `panda_2`, where they left 3 %
        # more."
        three, every = (models[name]["mean_mm"] for name in (results.THREE, results.ALL))
        assert 1 < every / three < 1.04 if data == "real, panda_2" else every < three
    # "The paper's 15 % lies in this range."
    low, high = map(int, results.substitutions()["span_three_typical"].split(" to "))
    assert low <= 15 <= high
    for mix in results.MIXES:
        data = results.simulated(mix)
        # "All joints helped in every mix", "the two best models have by far the worst plain R2".
        assert found.less(data, results.ALL, "two_s_mean_mm") > 20
        assert found.of(data, results.ALL)["mean_mm"] < found.of(data, results.THREE)["mean_mm"]
        others = [found.of(data, name)["r2"] for name in (results.THREE, results.ALL)]
        assert found.of(data, results.LINEAR)["r2"] < min(*others, 0)


# -- words -----------------------------------------------------------------------------------------


def test_pages_and_docstrings_are_within_their_limits(script, capsys):
    assert script("count_words").main() == 0, capsys.readouterr().out


def test_the_script_sees_what_is_long(script):
    counts = script("count_words")
    long = "One " + "word " * counts.LONG_SENTENCE + "more."
    text = f"# A head of many words\n\n{long} Short one. Another?\n\n```\ncode. Is not read.\n```\n"
    sizes = [len(sentence.split()) for sentence in counts.sentences(text)]
    assert sizes == [counts.LONG_SENTENCE + 2, 2]  # a single word is no sentence
    listed = (
        "- First item of a list\n- Second one, with $x. Y$ and [a link](page.md)\n\n| a. B | c |\n"
    )
    assert [len(sentence.split()) for sentence in counts.sentences(listed)] == [5, 7]
    assert {page for kind in counts.pages().values() for page in kind} >= {"index.md", "log.md"}
    assert counts.docstrings()["RBFNetRegressor.fit"] > 100
