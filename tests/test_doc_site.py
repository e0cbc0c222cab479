"""What holds the site and the package's pages elsewhere together: links, recipe, results."""

import json
import re
import runpy
import sys
from pathlib import Path

import pytest

from sklearn_raacmm import __version__

ROOT = Path(__file__).resolve().parent.parent
DOC = ROOT / "doc"


@pytest.fixture
def results(monkeypatch):
    monkeypatch.syspath_prepend(DOC)
    import _results

    yield _results
    del sys.modules["_results"]


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


def test_every_example_is_in_a_section_of_the_gallery(monkeypatch):
    monkeypatch.syspath_prepend(DOC)
    import _sphinx

    shown = [name for names in _sphinx.SECTIONS.values() for name in names]
    assert sorted(shown) == sorted(path.stem for path in (ROOT / "examples").glob("plot_*.py"))
    picture = '.. raw:: html\n\n    <div class="sphx-glr-thumbcontainer">\n:doc:`/x/{}`\n\n'
    pictures = "".join(picture.format(name) for name in shown)
    end = f".. thumbnail-parent-div-close\n\n{_sphinx._CLOSE}\nend"
    text = _sphinx.with_sections(f"head\n{_sphinx._OPEN}\n{pictures}{end}")
    assert [line[9:-1] for line in text.split("\n") if line[:5] == ":doc:"] == shown
    assert all(f"{title}\n---" in text for title in _sphinx.SECTIONS)
    assert text.startswith("head")
    assert text.endswith("end")
    assert text.count("<div") - text.count("</div") == len(shown)  # each picture's own is not shown
    with pytest.raises(ValueError, match="1 examples are in no section"):
        _sphinx.with_sections(f"{_sphinx._OPEN}\n{picture.format('plot_new')}{end}")


def test_numbers_of_the_readme_are_those_of_the_results(results):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert results.filled(text, results.read()) == text, "run `benchmarks/make_results.py`"
    # The check sees a number that was typed: another result gives another text.
    contents = json.loads(results.FILE.read_text(encoding="utf-8"))
    contents["comparisons"]["real, ur10"]["models"][results.LINEAR]["mean_mm"] *= 2
    assert results.filled(text, results.Results(contents)) != text


def test_every_number_that_a_page_takes_is_there(results):
    known = results.substitutions()
    for page in [*DOC.glob("*.md"), *DOC.glob("user_guide/*.md")]:
        used = re.findall(r"\{\{ ?(\w+) ?\}\}", page.read_text(encoding="utf-8"))
        assert set(used) <= set(known), page.name
    assert known["less_linear_ur10"] in known["table_headline"] or known["table_real"]


def test_the_command_says_what_has_moved(results, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import make_results

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


def test_the_version_is_cited():
    version = re.search(r"version = \{(\S+)\}", (DOC / "citing.md").read_text(encoding="utf-8"))[1]
    assert version == __version__
