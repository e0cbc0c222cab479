"""The pages of doc/: what they name is there, what is written is what was measured."""

import ast
import importlib
import json
import re
import runpy
import sys
import types
from pathlib import Path

import pytest

import sklearn_raacmm
from sklearn_raacmm import RBFNetRegressor, __version__
from sklearn_raacmm._version import documentation_of
from sklearn_raacmm.measurements._explanations import WORDS
from sklearn_raacmm.utils._estimators import VersionedEstimator, link_template
from sklearn_raacmm.utils._findings import TO_ACCEPT

ROOT = Path(__file__).resolve().parent.parent
DOC = ROOT / "doc"
PAGES = sorted([*DOC.glob("*.md"), *DOC.glob("user_guide/*.md")])


def read(path):
    return path.read_text(encoding="utf-8")


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


def test_every_example_is_in_a_section_of_the_gallery(script):
    sphinx = script("_sphinx")
    shown = [name for names in sphinx.SECTIONS.values() for name in names]
    assert sorted(shown) == sorted(path.stem for path in (ROOT / "examples").glob("plot_*.py"))


def test_a_script_of_the_gallery_has_to_print_what_it_shows(script):
    site = script("check_site")
    picture = '<img src="../_images/sphx_glr_plot_ols_path_001.png">'
    code = '<div class="highlight"><div>print("auto: ")</div></div>'
    output = '<div class="sphx-glr-script-out notranslate"><div><pre>{}</pre></div></div>'
    shown = picture + output.format("auto: 9") + code
    assert list(site.missing("plot_ols_path", site.Page(shown))) == []
    silent = picture + output.format("9") + code
    assert list(site.missing("plot_ols_path", site.Page(silent))) == [
        "plot_ols_path: it does not print 'auto: '"
    ]
    assert len(list(site.missing("plot_ols_path", site.Page("")))) == 2


@pytest.fixture
def results(script):
    return script("_results")


def test_terms_are_linked_where_a_page_uses_them_first(script):
    nodes = pytest.importorskip("docutils.nodes")
    glossary = script("_glossary")
    definitions = [nodes.term(text=words) for words in ("eccentricity", "2S", "gauge, ball bar")]
    terms = glossary.terms_of(nodes.definition_list("", *definitions))
    assert terms["ball bar"] == terms["gauge"] == definitions[2]["ids"][0] == "term-gauge"
    page = nodes.section(
        "",
        nodes.title(text="A gauge"),
        nodes.paragraph("", "", nodes.literal(text="2S"), nodes.Text(" of two Gauges; 2S, 12S")),
        nodes.paragraph(text="a ball bar, eccentricity, 2S"),
    )
    text = page.astext()
    glossary.link_terms(page, terms, "glossary.html")
    links = [(link.astext(), link["refuri"]) for link in page.findall(nodes.reference)]
    assert links == [("Gauges", "glossary.html#term-gauge"), ("2S", "glossary.html#term-2s"),
                     ("eccentricity", "glossary.html#term-eccentricity")]  # fmt: skip
    assert page.astext() == text


def test_numbers_of_the_readme_are_those_of_the_results(results):
    text = read(ROOT / "README.md")
    assert results.filled(text, results.read()) == text, "run `benchmarks/make_results.py`"
    # The check sees a number that was typed: another result gives another text.
    contents = json.loads(read(results.FILE))
    contents["comparisons"]["real, ur10"]["models"][results.LINEAR]["mean_mm"] *= 2
    assert results.filled(text, results.Results(contents)) != text


def test_numbers_that_pages_take_from_the_results_are_there(results):
    made = results.substitutions()
    used = {name for page in PAGES for name in re.findall(r"\{\{ (\w+) \}\}", read(page))}
    assert len(used) > 40
    assert used - set(made) == set()
    assert {name for name in made if name.startswith("table_")} - used == set()


def test_what_the_pages_say_of_the_results_is_true(results):
    """Sentences without a number of their own that the next measurement could make false."""
    found, better = results.read(), []
    for data in results.REAL:
        models = found.comparisons[data]["models"]
        others = [name for name in models if name != results.LINEAR]
        best = min(models[name]["mean_mm"] for name in others)
        assert models[results.LINEAR]["mean_mm"] < best
        three, every = (models[name]["mean_mm"] for name in (results.THREE, results.ALL))
        better.append(every < three)
    assert 2 * sum(better) > len(better)  # "On most arms all joints are better."
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


def test_pages_and_docstrings_are_within_their_limits(script, capsys):
    assert script("count_words").main() == 0, capsys.readouterr().out


def test_codes_in_the_glossary_are_those_of_findings():
    page = read(DOC / "glossary.md")
    table = page[page.index("\n|", page.index("## Codes of findings")) :]
    source = "".join(map(read, (ROOT / "sklearn_raacmm").rglob("*.py")))
    codes = re.findall(r"`([a-z-]+)`", table)
    assert [code for code in codes if f'"{code}"' not in source] == []
    assert set(re.findall(r'Finding\(\s*"([a-z]+(?:-[a-z]+)+)"', source)) - {*codes} == set()


def test_codes_that_may_be_accepted_are_those_of_findings_to_repair():
    """The glossary has them all."""
    # Of weights that a caller gives, of codes that are named by a variable, and of a question.
    found = {*WORDS, "strange-poses", "moved-station", "moved-tool", "mirror-image"}
    found |= {"wrong-length", "unit-of-lengths"}
    for path in (ROOT / "sklearn_raacmm").rglob("*.py"):
        if path.parent.name in ("acceptance", "utils"):  # its tests have no `accept`
            continue
        functions = [one for one in ast.walk(ast.parse(read(path)))
                     if isinstance(one, ast.FunctionDef)]  # fmt: skip
        for function in functions:
            calls = [one for one in ast.walk(function) if isinstance(one, ast.Call) and one.args]
            for call in calls if "'repair'" in ast.unparse(function) else ():
                code, *rest = map(ast.unparse, call.args)
                is_fixed = {"'note'", "'doubt'", "'refuse'"} & {*rest} or len(rest) < 3
                if ast.unparse(call.func) == "Finding" and code[0] == "'" and not is_fixed:
                    found.add(code.strip("'"))
    assert sorted(found) == sorted(TO_ACCEPT)
    assert {*TO_ACCEPT} <= {*re.findall(r"`([a-z-]+)`", read(DOC / "glossary.md"))}
